//! Snapshots of changed tiles, so that what is replayed over a tile is bounded.

use super::{SampleRect, touch_rect};
use crate::tile::TileAddress;
use std::collections::HashMap;
use std::sync::Arc;

/// A tile as it is with all active edits up to a number of the log applied.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TileSnapshot {
    /// The tile whose state it is.
    pub address: TileAddress,
    /// The log's last sequence number when it was taken.
    pub sequence: u64,
    /// The tile's state, in whatever form the one who took it reads again.
    pub bytes: Arc<[u8]>,
}

/// At most one snapshot for each tile.
#[derive(Clone, Debug, Default)]
pub(super) struct Snapshots {
    tiles: HashMap<TileAddress, TileSnapshot>,
}

impl Snapshots {
    pub(super) fn get(&self, address: TileAddress) -> Option<&TileSnapshot> {
        self.tiles.get(&address)
    }

    /// Keeps the newer of the tile's two; returns whether that is the given one.
    pub(super) fn keep(&mut self, snapshot: TileSnapshot) -> bool {
        let newer = |old: &TileSnapshot| old.sequence > snapshot.sequence;
        if self.tiles.get(&snapshot.address).is_some_and(newer) {
            return false;
        }
        self.tiles.insert(snapshot.address, snapshot);
        true
    }

    pub(super) fn remove(&mut self, address: TileAddress) -> Option<TileSnapshot> {
        self.tiles.remove(&address)
    }

    /// Drops those that hold, or should hold, an edit.
    pub(super) fn drop_stale(&mut self, sequence: u64, rect: &SampleRect) {
        self.tiles
            .retain(|_, snapshot| !is_stale(snapshot, sequence, rect));
    }

    pub(super) fn len(&self) -> usize {
        self.tiles.len()
    }

    /// All of them, by tile.
    pub(super) fn sorted(&self) -> Vec<&TileSnapshot> {
        let mut all: Vec<_> = self.tiles.values().collect();
        all.sort_by_key(|snapshot| snapshot.address);
        all
    }
}

/// Whether a snapshot is no longer what the log makes of the tile, an edit with this number and
/// rectangle having been undone or redone since it was taken.
pub(super) fn is_stale(snapshot: &TileSnapshot, sequence: u64, rect: &SampleRect) -> bool {
    sequence <= snapshot.sequence && !touch_rect(snapshot.address).intersection(rect).is_empty()
}
