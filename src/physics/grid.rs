//! One terrain's colliders: which there are, which are on their way, which have to be made anew.

use super::bodies::LocalBox;
use super::shape::{Ground, Place};
use crate::edit::SampleRect;
use crate::stream::TerrainState;
use crate::terrain::TerrainManifest;
use crate::tile::{TILE_SAMPLES, TileAddress};
use avian3d::parry::shape::SharedShape;
use bevy::math::DVec2;
use bevy::platform::collections::{HashMap, HashSet};
use bevy::prelude::*;
use bevy::tasks::Task;
use std::collections::VecDeque;
use std::sync::Arc;

/// Column and row of a chunk.
pub(super) type Key = [u32; 2];

/// The most steps in which a body's path is followed.
const MAX_STEPS: f32 = 64.0;
/// The most chunks a side that one body gets at one place, however large it is.
const MAX_SIDE: u32 = 16;

/// Chunks from a first to a last one, both included.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Chunks {
    pub(super) first: Key,
    pub(super) last: Key,
}

impl Chunks {
    pub(super) fn iter(self) -> impl Iterator<Item = Key> {
        (self.first[1]..=self.last[1])
            .flat_map(move |row| (self.first[0]..=self.last[0]).map(move |column| [column, row]))
    }
}

/// A shape that has been made on another thread.
pub(super) struct Built {
    pub(super) shape: SharedShape,
    pub(super) base_m: f32,
    pub(super) level: u8,
}

impl Built {
    pub(super) fn of(ground: &Ground, place: &Place) -> Self {
        let base_m = ground.base_m(place);
        Self {
            shape: ground.shape(place, base_m),
            base_m,
            level: ground.address.level,
        }
    }
}

/// How far a chunk is.
pub(super) enum Stage {
    /// Nothing is resident under it, or its turn hasn't come.
    Waiting,
    /// Its shape is being made; `true` where the ground has changed since.
    Building(Task<Built>, bool),
    /// There is an entity, with a shape of this level's heights above this base.
    Made(Entity, u8, f32),
}

pub(super) struct Chunk {
    pub(super) place: Place,
    pub(super) stage: Stage,
    /// Until when it stays although no pin wants it, seconds.
    pub(super) until_s: f64,
    pub(super) is_pinned: bool,
    /// Whether it keeps its tile resident, for a body.
    pub(super) is_keeping: bool,
    /// Whether it waits in [`Grid::stale`].
    pub(super) is_stale: bool,
}

pub(super) struct Grid {
    pub(super) instance: u64,
    pub(super) manifest: Arc<TerrainManifest>,
    pub(super) cells: u32,
    pub(super) chunks: HashMap<Key, Chunk>,
    /// Chunks in [`Stage::Waiting`], in the order of their turns.
    pub(super) waiting: VecDeque<Key>,
    /// Chunks whose tile has changed, in that order.
    pub(super) stale: VecDeque<Key>,
    /// What edits have changed of chunks since the last step.
    pub(super) dirty: HashMap<Key, SampleRect>,
    /// Chunks that were made of coarser levels: what changes far from them may concern them.
    pub(super) coarse: HashSet<Key>,
    /// Pins on tiles under bodies, and how many chunks want each.
    pub(super) tiles: HashMap<[u32; 2], (Entity, u32)>,
    /// The pinned regions when chunks were last marked as pinned.
    pub(super) pinned: Vec<Chunks>,
}

impl Grid {
    pub(super) fn new(state: &TerrainState, cells: u32) -> Self {
        Self {
            instance: state.instance(),
            manifest: Arc::clone(state.manifest()),
            cells,
            chunks: HashMap::default(),
            waiting: VecDeque::new(),
            stale: VecDeque::new(),
            dirty: HashMap::default(),
            coarse: HashSet::default(),
            tiles: HashMap::default(),
            pinned: Vec::new(),
        }
    }

    /// A chunk's side in metres of the terrain.
    fn chunk_m(&self) -> f64 {
        f64::from(self.cells) * self.manifest.file.spacing_m
    }

    /// The chunks that a rectangle of the terrain's own x and z touches; `None` where it lies
    /// elsewhere, or isn't one.
    pub(super) fn touched(&self, min_m: DVec2, max_m: DVec2) -> Option<Chunks> {
        let last = self.manifest.file.size.map(|samples| samples - 1);
        let end = DVec2::from(last.map(f64::from)) * self.manifest.file.spacing_m;
        // Not a number compares with nothing.
        if !(min_m.cmple(max_m).all() && min_m.cmple(end).all() && max_m.cmpge(DVec2::ZERO).all()) {
            return None;
        }
        let chunk = |at: DVec2| {
            let at = (at.clamp(DVec2::ZERO, end) / self.chunk_m()).floor();
            [(at.x, last[0]), (at.y, last[1])]
                .map(|(at, last)| (at as u32).min(last.div_ceil(self.cells) - 1))
        };
        Some(Chunks {
            first: chunk(min_m),
            last: chunk(max_m),
        })
    }

    /// Gives the chunks to `want` that a body needs that moves by `sweep` soon, with `margin` around
    /// it: all in metres of the terrain. `true` where the body is there already.
    pub(super) fn near(
        &self,
        state: &TerrainState,
        body: LocalBox,
        sweep: Vec3,
        margin: f32,
        mut want: impl FnMut(Key, bool),
    ) {
        if !(body.centre.is_finite() && body.half.is_finite() && sweep.is_finite()) {
            return;
        }
        let lowest = body.centre.y - body.half.y + sweep.y.min(0.0) - margin;
        let is_over = |key: Key| {
            let tile = key.map(|at| at * self.cells / TILE_SAMPLES);
            let bounds = state.bounds(TileAddress::new(0, tile[0], tile[1]));
            bounds.is_some_and(|bounds| lowest > bounds.max_m.y)
        };
        let square = |step: Vec3, margin: f32| {
            let centre = body.centre + step;
            let reach = body.half.xz() + margin;
            let most = (f64::from(MAX_SIDE - 2) * 0.5 * self.chunk_m()) as f32;
            let reach = reach.min(Vec2::splat(most));
            let [min, max] = [centre.xz() - reach, centre.xz() + reach].map(|at| at.as_dvec2());
            self.touched(min, max)
        };
        for key in square(Vec3::ZERO, 0.5).into_iter().flat_map(Chunks::iter) {
            if !is_over(key) {
                want(key, true);
            }
        }
        let length = sweep.xz().abs().max_element();
        let steps = (length / self.chunk_m() as f32)
            .ceil()
            .clamp(0.0, MAX_STEPS);
        let mut known = None;
        for step in 0..=steps as u32 {
            let chunks = square(sweep * (step as f32 / steps.max(1.0)), margin);
            if chunks == known {
                continue;
            }
            known = chunks;
            for key in chunks.into_iter().flat_map(Chunks::iter) {
                if !is_over(key) {
                    want(key, false);
                }
            }
        }
    }

    /// The chunks among `chunks` that there are; may name some that there aren't.
    fn known(&self, chunks: Chunks) -> Vec<Key> {
        let Chunks { first, last } = chunks;
        let across = [0, 1].map(|axis| u64::from(last[axis].saturating_sub(first[axis])) + 1);
        if across[0] * across[1] <= self.chunks.len() as u64 {
            return chunks.iter().collect();
        }
        let is_inside =
            |key: &Key| (0..2).all(|axis| (first[axis]..=last[axis]).contains(&key[axis]));
        self.chunks.keys().copied().filter(is_inside).collect()
    }

    /// An edit has changed `rect`.
    pub(super) fn edited(&mut self, rect: SampleRect) {
        let whole = SampleRect::new(
            [0; 2],
            self.manifest.file.size.map(|samples| samples as i32),
        );
        let inside = rect.intersection(&whole);
        if inside.is_empty() {
            return;
        }
        // Chunks hold their neighbours' first samples too.
        let first = inside.min.map(|at| (at - 1).max(0) as u32 / self.cells);
        let last = inside.max.map(|end| (end - 1) as u32 / self.cells);
        for key in self.known(Chunks { first, last }) {
            self.touch(key, inside);
        }
        let coarse: Vec<_> = self.coarse.iter().copied().collect();
        for key in coarse {
            let Some(chunk) = self.chunks.get(&key) else {
                continue;
            };
            if let Stage::Made(_, level, _) = chunk.stage {
                // What a coarser level is made of reaches this far at most.
                let reach = 4_i32 << level.min(24);
                if !inside
                    .grown(reach)
                    .intersection(&chunk.place.rect)
                    .is_empty()
                {
                    self.touch(key, whole);
                }
            }
        }
    }

    fn touch(&mut self, key: Key, rect: SampleRect) {
        let Some(chunk) = self.chunks.get_mut(&key) else {
            return;
        };
        let rect = rect.intersection(&chunk.place.rect);
        if rect.is_empty() {
            return;
        }
        match &mut chunk.stage {
            Stage::Waiting => {}
            Stage::Building(_, is_outdated) => *is_outdated = true,
            Stage::Made(..) => {
                let known = self.dirty.entry(key).or_default();
                *known = known.union(&rect);
            }
        }
    }

    /// A chunk's entity is gone; where the chunk is wanted, it gets another.
    pub(super) fn removed(&mut self, entity: Entity, rect: SampleRect) {
        let key = rect.min.map(|first| first as u32 / self.cells);
        if let Some(chunk) = self.chunks.get_mut(&key)
            && let Stage::Made(own, ..) = chunk.stage
            && own == entity
        {
            chunk.stage = Stage::Waiting;
            self.coarse.remove(&key);
            self.waiting.push_back(key);
        }
    }

    /// A tile has come, gone, or changed as a whole.
    pub(super) fn tile_changed(&mut self, address: TileAddress, has_arrived: bool) {
        let side = u64::from(TILE_SAMPLES) << address.level;
        let across = side / u64::from(self.cells);
        let along = |tile: u32, last: u32| {
            let first = u64::from(tile) * across;
            let end = first + across - 1;
            [
                first.min(u64::from(u32::MAX)) as u32,
                end.min(last.into()) as u32,
            ]
        };
        let last = self
            .manifest
            .file
            .size
            .map(|samples| (samples - 1).div_ceil(self.cells) - 1);
        let [x, z] = [along(address.x, last[0]), along(address.z, last[1])];
        let chunks = Chunks {
            first: [x[0], z[0]],
            last: [x[1], z[1]],
        };
        for key in self.known(chunks) {
            let Some(chunk) = self.chunks.get_mut(&key) else {
                continue;
            };
            match &mut chunk.stage {
                Stage::Waiting => {}
                Stage::Building(_, is_outdated) => *is_outdated = true,
                Stage::Made(_, level, _) => {
                    let matters = if has_arrived {
                        address.level < *level
                    } else {
                        address.level == *level
                    };
                    if matters && !chunk.is_stale {
                        chunk.is_stale = true;
                        self.stale.push_back(key);
                    }
                }
            }
        }
    }
}
