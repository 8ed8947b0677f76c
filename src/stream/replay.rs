//! Giving a tile its edits, on any thread.

use super::content::TileContent;
use super::state::TerrainState;
use crate::edit::{Edit, EditGround, EditLog, EditScratch, EditedTile, Footprint, TileSnapshot};
use crate::tile::{TerrainTile, TileAddress};
use bevy::tasks::Task;
use bevy::tasks::futures::check_ready;
use std::collections::HashMap;
use std::sync::{Arc, PoisonError, RwLock};

/// Where a log's edits reach, as far as somebody has asked.
#[derive(Debug, Default)]
pub(super) struct Footprints(RwLock<HashMap<u64, Arc<Footprint>>>);

impl Footprints {
    pub(super) fn insert(&self, sequence: u64, footprint: Arc<Footprint>) {
        let mut known = self.0.write().unwrap_or_else(PoisonError::into_inner);
        known.insert(sequence, footprint);
    }

    pub(super) fn of(
        &self,
        (sequence, edit): &(u64, Arc<Edit>),
        ground: &EditGround,
        scratch: &mut EditScratch,
    ) -> Arc<Footprint> {
        let known = self.0.read().unwrap_or_else(PoisonError::into_inner);
        if let Some(footprint) = known.get(sequence) {
            return Arc::clone(footprint);
        }
        drop(known);
        let footprint = Arc::new(ground.raster(edit, scratch).into_footprint());
        self.insert(*sequence, Arc::clone(&footprint));
        footprint
    }
}

/// What it takes to give a tile its edits, on any thread.
pub(super) struct Replay {
    ground: Arc<EditGround>,
    footprints: Arc<Footprints>,
    address: TileAddress,
    base: TerrainTile,
    snapshot: Option<TileSnapshot>,
    /// Those that the snapshot doesn't have, in order.
    pub(super) edits: Vec<(u64, Arc<Edit>)>,
}

impl Replay {
    /// Of a tile of `state`, with the edits of its own log.
    pub(super) fn new(
        state: &TerrainState,
        address: TileAddress,
        base: TerrainTile,
        log: &EditLog,
        takes_snapshot: bool,
    ) -> Self {
        let (snapshot, edits) = if takes_snapshot {
            log.replay_of(address)
        } else {
            (None, log.active_touching(address))
        };
        Self {
            ground: Arc::clone(&state.edits.ground),
            footprints: Arc::clone(&state.edits.footprints),
            address,
            base,
            snapshot: snapshot.cloned(),
            edits: edits
                .into_iter()
                .map(|(sequence, edit)| (sequence, Arc::clone(edit)))
                .collect(),
        }
    }

    pub(super) fn is_trivial(&self) -> bool {
        self.edits.is_empty() && self.snapshot.is_none()
    }

    /// The tile with its edits; `None` where the snapshot can't be used.
    pub(super) fn run(self, scratch: &mut EditScratch) -> Option<TileContent> {
        if self.is_trivial() {
            return Some(TileContent::Baked(self.base));
        }
        let mut tile = match &self.snapshot {
            Some(snapshot) => EditedTile::thaw(self.address, self.base, &snapshot.bytes)?,
            None => EditedTile::new(self.address, self.base),
        };
        apply_all(
            &mut tile,
            &self.ground,
            &self.footprints,
            &self.edits,
            scratch,
        );
        Some(TileContent::Edited {
            tile: Box::new(tile),
            since_snapshot: self.edits.len() as u32,
        })
    }
}

/// Applies edits to a tile, in order.
pub(super) fn apply_all(
    tile: &mut EditedTile,
    ground: &EditGround,
    footprints: &Footprints,
    edits: &[(u64, Arc<Edit>)],
    scratch: &mut EditScratch,
) {
    let reaching: Vec<_> = edits
        .iter()
        .map(|edit| footprints.of(edit, ground, scratch))
        .collect();
    let reaching = edits.iter().zip(&reaching);
    let reaching = reaching.map(|((_, edit), footprint)| (&**edit, &**footprint));
    tile.apply_all(ground, reaching, scratch);
}

/// A tile that has loaded, and which edits it has.
#[derive(Debug)]
pub(super) struct Arrival {
    pub(super) progress: Progress,
    /// The last of the log's records that it has.
    pub(super) sequence: u64,
    pub(super) epoch: u64,
}

/// How far a tile is that has loaded.
#[derive(Debug)]
pub(super) enum Progress {
    Done(TileContent),
    Running(Task<Option<TileContent>>),
    /// Its snapshot is damaged.
    Failed,
}

impl Arrival {
    /// Whether nothing is left to wait for.
    pub(super) const fn is_done(&self) -> bool {
        !matches!(self.progress, Progress::Running(_))
    }

    /// Sees how far it is.
    pub(super) fn poll(&mut self) {
        if let Progress::Running(task) = &mut self.progress
            && let Some(content) = check_ready(task)
        {
            self.progress = content.map_or(Progress::Failed, Progress::Done);
        }
    }
}
