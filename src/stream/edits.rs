//! Edits on the ground that is resident, and on the ground that comes.

use super::content::TileContent;
use super::replay::{Arrival, Footprints, Progress, Replay, apply_all};
use super::state::TerrainState;
use super::tile::TileBounds;
use crate::edit::{
    Edit, EditGround, EditLog, EditScratch, EditedTile, SampleRect, TerrainEdits, TileSnapshot,
    ground_hash, touch_rect,
};
use crate::stream::TerrainRegion;
use crate::terrain::{ManifestFile, TileReloaded};
use crate::tile::{TILE_BORDER, TILE_SAMPLES, TerrainTile, TileAddress, TileRange};
use bevy::prelude::*;
use bevy::tasks::futures::check_ready;
use bevy::tasks::{AsyncComputeTaskPool, ComputeTaskPool, Task, TaskPool};
use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;

/// Samples of its level that an edit's error bounds reach beyond what it changes, and one more.
const ERROR_MARGIN: i32 = 66;

/// Edits since a resident tile's last snapshot after which it gets another one...
const SNAPSHOT_EVERY: u32 = 256;
/// ...and after which it gets one when it goes.
const SNAPSHOT_AT_LEAST: u32 = 32;

/// Edits, tile by tile, beyond which resident tiles are made anew in the background.
const EDITS_AT_ONCE: usize = 4096;

/// What a terrain knows of edits.
#[derive(Debug)]
pub(super) struct GroundEdits {
    pub(super) ground: Arc<EditGround>,
    /// Version of the log that the resident ground has; 0 before there was one.
    version: u64,
    /// The last of its records.
    sequence: u64,
    /// Rises when another log takes this one's place: what was being replayed before is replayed anew.
    epoch: u64,
    /// Resident tiles that are being made anew in the background. They change all at once, or their
    /// borders would differ meanwhile.
    remade: Vec<(TileAddress, Arrival)>,
    pub(super) footprints: Arc<Footprints>,
    /// Ranges of tiles' own heights where edits may have changed them.
    own: HashMap<TileAddress, TileRange>,
    /// Snapshots that are being made.
    snapshots: Vec<Task<TileSnapshot>>,
    /// Tiles whose snapshot can't be used.
    bad_snapshots: Vec<TileAddress>,
    scratch: EditScratch,
}

impl GroundEdits {
    pub(super) fn new(file: &ManifestFile) -> Self {
        Self {
            ground: Arc::new(EditGround::new(file)),
            version: 0,
            sequence: 0,
            epoch: 0,
            remade: Vec::new(),
            footprints: Arc::default(),
            own: HashMap::new(),
            snapshots: Vec::new(),
            bad_snapshots: Vec::new(),
            scratch: EditScratch::default(),
        }
    }

    /// Makes a snapshot of a tile that has all edits up to number `sequence`, in the background.
    fn snapshot(&mut self, tile: EditedTile, sequence: u64) {
        let pool = AsyncComputeTaskPool::get_or_init(TaskPool::default);
        self.snapshots.push(pool.spawn(async move {
            TileSnapshot {
                address: tile.address(),
                sequence,
                bytes: tile.freeze(),
            }
        }));
    }
}

impl TerrainState {
    /// Whether no resident tile is being made anew.
    pub(super) fn has_its_edits(&self) -> bool {
        self.edits.remade.is_empty()
    }

    /// The log, where it is this terrain's.
    pub(super) fn own_log<'a>(&self, log: Option<&'a EditLog>) -> Option<&'a EditLog> {
        log.filter(|log| log.check_terrain(&self.manifest.file).is_ok())
    }

    /// Makes resident ground follow a log that has taken another's place. Where that is long, it takes
    /// some frames.
    pub(crate) fn catch_up(&mut self, terrain: Entity, log: &EditLog, commands: &mut Commands) {
        if self.edits.version == log.version() {
            return;
        }
        self.note_log(log);
        self.edits.epoch += 1;
        self.edits.footprints = Arc::default();
        self.edits.remade.clear();
        // What was kept of another log is none of this one's.
        self.edits.snapshots.clear();
        self.edits.bad_snapshots.clear();
        for loading in &mut self.loading {
            loading.arrival = None;
        }
        let mut changed: BTreeSet<_> = self.edits.own.keys().copied().collect();
        // What is resident keeps its own until it is another.
        let pages = &self.residency.pages;
        self.edits.own.retain(|tile, _| pages.get(*tile).is_some());
        let empty = EditLog::new(&self.manifest.file);
        // A foreign log counts as none.
        let log = self.own_log(Some(log)).unwrap_or(&empty);
        for (_, edit) in log.active() {
            self.widen_by(edit, &mut changed);
        }
        self.refresh_bounds(changed, commands);
        let all: Vec<_> = self.residency.residents().collect();
        let touched: Vec<_> = all
            .into_iter()
            .filter(|&(page, address)| {
                let edited = self
                    .slot(page)
                    .is_some_and(|slot| matches!(slot.tile, TileContent::Edited { .. }));
                edited || !log.active_in(touch_rect(address)).is_empty()
            })
            .collect();
        for &(page, address) in &touched {
            self.tell_reloaded(terrain, page, address, commands);
        }
        self.replay(touched, log, commands);
        self.measure_all(log);
    }

    /// Tells whoever follows tiles that one is another.
    fn tell_reloaded(
        &self,
        terrain: Entity,
        page: u32,
        address: TileAddress,
        commands: &mut Commands,
    ) {
        if let Some(slot) = self.slot(page) {
            commands.trigger(TileReloaded {
                entity: terrain,
                tile: slot.entity,
                address,
            });
        }
    }

    /// The resident ground has all of the log, or is about to.
    pub(crate) fn note_log(&mut self, log: &EditLog) {
        self.edits.version = log.version();
        self.edits.sequence = log.last_sequence();
    }

    /// Applies an edit that has just been added to the log. Says whether heights were cut off.
    pub(crate) fn apply_edit(
        &mut self,
        sequence: u64,
        edit: &Edit,
        log: &EditLog,
        commands: &mut Commands,
    ) -> bool {
        let ground = Arc::clone(&self.edits.ground);
        let raster = ground.raster(edit, &mut self.edits.scratch);
        let mut changed = BTreeSet::new();
        let mut to_keep = Vec::new();
        let mut clamped = false;
        for level in 0..ground.levels() {
            let heights = raster.footprint().level(level).heights;
            if heights.is_empty() {
                continue;
            }
            let tiles = self.pages().tiles(level);
            for address in tiles_around(tiles, level, heights.grown(ERROR_MARGIN)) {
                let page = self.pages().get(address);
                let is_stale = !self.edits.remade.is_empty() && self.is_remade(address);
                let slot = page.and_then(|page| self.slots.get_mut(page as usize)?.as_mut());
                let Some(slot) = slot else {
                    continue;
                };
                let change = slot.apply(address, &ground, &raster, &mut self.edits.scratch);
                clamped |= change.clamped;
                let TileContent::Edited {
                    tile,
                    since_snapshot,
                } = &mut slot.tile
                else {
                    continue;
                };
                if !change.heights.is_empty() {
                    self.edits.own.insert(address, tile.range());
                    changed.insert(address);
                }
                if !change.is_empty() {
                    *since_snapshot += 1;
                    if *since_snapshot >= SNAPSHOT_EVERY && !is_stale {
                        *since_snapshot = 0;
                        to_keep.push((**tile).clone());
                    }
                }
            }
        }
        self.widen_by(edit, &mut changed);
        let footprint = Arc::new(raster.into_footprint());
        self.edits.footprints.insert(sequence, footprint);
        self.ground_changed(changed, commands);
        self.note_log(log);
        for tile in to_keep {
            self.edits.snapshot(tile, sequence);
        }
        clamped
    }

    /// Makes all resident tiles that some edits may touch anew, from how they were baked: after these
    /// have been taken back, or made again in their old places, or many have come.
    pub(crate) fn replay_around(
        &mut self,
        edits: &[Arc<Edit>],
        log: &EditLog,
        commands: &mut Commands,
    ) {
        self.note_log(log);
        let rects: Vec<_> = edits.iter().map(|edit| edit.rect()).collect();
        let touches = |address: TileAddress| {
            let own = touch_rect(address);
            rects.iter().any(|rect| !own.intersection(rect).is_empty())
        };
        // What is on its way has been given other edits.
        for loading in &mut self.loading {
            if touches(loading.address) {
                loading.arrival = None;
            }
        }
        self.measure_absent(&rects, log, commands);
        let all: Vec<_> = self.residency.residents().collect();
        let touched = all.into_iter().filter(|&(_, address)| touches(address));
        let touched = touched.collect();
        self.replay(touched, log, commands);
    }

    /// Makes resident tiles anew with all edits of the log: at once, or in the background where that
    /// takes long.
    fn replay(&mut self, tiles: Vec<(u32, TileAddress)>, log: &EditLog, commands: &mut Commands) {
        let jobs: Vec<_> = tiles
            .iter()
            .filter_map(|&(page, address)| {
                let base = self.slot(page)?.tile.base().clone();
                let replay = Replay::new(self, address, base.clone(), log, true);
                Some((page, address, base, replay))
            })
            .collect();
        let edits: usize = jobs.iter().map(|(.., replay)| replay.edits.len()).sum();
        if edits > EDITS_AT_ONCE || !self.edits.remade.is_empty() {
            let mut wide = BTreeSet::new();
            for (_, address, base, _) in jobs {
                self.stop_remaking(address);
                let arrival = self.arrive(address, &base, Some(log));
                self.edits.remade.push((address, arrival));
                // Until then its ground lies somewhere between what it was and what it will be.
                for (_, edit) in log.active_touching(address) {
                    let (least, most) = edit.change.limits();
                    self.widen(address, least, most, &mut wide);
                }
            }
            self.refresh_bounds(wide, commands);
            return;
        }
        let pool = ComputeTaskPool::get_or_init(TaskPool::default);
        let made = pool.scope(|scope| {
            for (page, address, base, replay) in jobs {
                scope.spawn(async move {
                    (page, address, base, replay.run(&mut EditScratch::default()))
                });
            }
        });
        let made = made.into_iter().map(|(page, address, base, content)| {
            let content = content.unwrap_or_else(|| {
                self.edits.bad_snapshots.push(address);
                self.with_edits(address, base, Some(log))
            });
            (page, address, content)
        });
        let made: Vec<_> = made.collect();
        self.take_contents(made, commands);
    }

    /// Swaps in the tiles that were made anew in the background, once all of them are there.
    pub(super) fn take_remade(
        &mut self,
        terrain: Entity,
        log: Option<&EditLog>,
        commands: &mut Commands,
    ) {
        if self.edits.remade.is_empty() {
            return;
        }
        let mut is_done = true;
        for (_, arrival) in &mut self.edits.remade {
            arrival.poll();
            is_done &= arrival.is_done();
        }
        if !is_done {
            return;
        }
        let mut made = Vec::new();
        let mut again = Vec::new();
        for (address, arrival) in std::mem::take(&mut self.edits.remade) {
            let Some(page) = self.pages().get(address) else {
                continue;
            };
            match self.finish_arrival(address, arrival, log) {
                Some(content) => made.push((page, address, content)),
                None => again.push((page, address)),
            }
        }
        if again.is_empty() {
            for &(page, address, _) in &made {
                self.tell_reloaded(terrain, page, address, commands);
            }
            self.take_contents(made, commands);
            return;
        }
        // A snapshot was damaged: all once more.
        let all = made.iter().map(|(page, address, _)| (*page, *address));
        for (page, address) in all.chain(again) {
            if let Some(base) = self.slot(page).map(|slot| slot.tile.base().clone()) {
                let arrival = self.arrive(address, &base, log);
                self.edits.remade.push((address, arrival));
            }
        }
    }

    /// Resident tiles have other contents.
    fn take_contents(
        &mut self,
        contents: Vec<(u32, TileAddress, TileContent)>,
        commands: &mut Commands,
    ) {
        let mut changed = BTreeSet::new();
        for (page, address, mut content) in contents {
            self.snapshot_long(&mut content);
            let Some(slot) = self.slots[page as usize].as_mut() else {
                continue;
            };
            match &content {
                TileContent::Baked(_) => self.edits.own.remove(&address),
                TileContent::Edited { tile, .. } => self.edits.own.insert(address, tile.range()),
            };
            slot.take(content);
            changed.insert(address);
        }
        self.ground_changed(changed, commands);
    }

    /// Makes a snapshot of a tile that was given many edits, so that nobody has to again.
    pub(super) fn snapshot_long(&mut self, content: &mut TileContent) {
        if let TileContent::Edited {
            tile,
            since_snapshot,
        } = content
            && *since_snapshot >= SNAPSHOT_EVERY
        {
            *since_snapshot = 0;
            let sequence = self.edits.sequence;
            self.edits.snapshot((**tile).clone(), sequence);
        }
    }

    /// Whether a resident tile is being made anew: what it shows isn't what the log says.
    fn is_remade(&self, address: TileAddress) -> bool {
        self.edits.remade.iter().any(|(tile, _)| *tile == address)
    }

    /// Forgets that a tile is being made anew; says whether it was.
    pub(super) fn stop_remaking(&mut self, address: TileAddress) -> bool {
        let known = self.edits.remade.len();
        self.edits.remade.retain(|(tile, _)| *tile != address);
        self.edits.remade.len() < known
    }

    /// What happens when a tile has loaded: the log's edits are applied to it, in the background where
    /// there are some.
    pub(super) fn arrive(
        &mut self,
        address: TileAddress,
        base: &TerrainTile,
        log: Option<&EditLog>,
    ) -> Arrival {
        let log = self.own_log(log);
        let is_good = !self.edits.bad_snapshots.contains(&address);
        let replay = log.map(|log| Replay::new(self, address, base.clone(), log, is_good));
        let progress = match replay.filter(|replay| !replay.is_trivial()) {
            None => Progress::Done(TileContent::Baked(base.clone())),
            Some(replay) => {
                let pool = AsyncComputeTaskPool::get_or_init(TaskPool::default);
                let task = pool.spawn(async move { replay.run(&mut EditScratch::default()) });
                Progress::Running(task)
            }
        };
        Arrival {
            progress,
            sequence: log.map_or(0, EditLog::last_sequence),
            epoch: self.edits.epoch,
        }
    }

    /// What a tile holds that arrived, with the edits that have been made since; `None` where it must
    /// arrive once more.
    pub(super) fn finish_arrival(
        &mut self,
        address: TileAddress,
        arrival: Arrival,
        log: Option<&EditLog>,
    ) -> Option<TileContent> {
        let content = match arrival.progress {
            Progress::Done(content) => content,
            Progress::Running(_) => return None,
            Progress::Failed => {
                self.edits.bad_snapshots.push(address);
                return None;
            }
        };
        if arrival.epoch != self.edits.epoch {
            return None;
        }
        let Some(log) = self.own_log(log) else {
            return Some(content);
        };
        let since = log.active_in_after(touch_rect(address), arrival.sequence);
        if since.is_empty() {
            return Some(content);
        }
        let since: Vec<_> = since
            .into_iter()
            .map(|(sequence, edit)| (sequence, Arc::clone(edit)))
            .collect();
        let (mut tile, edits) = match content {
            TileContent::Baked(base) => (Box::new(EditedTile::new(address, base)), 0),
            TileContent::Edited {
                tile,
                since_snapshot,
            } => (tile, since_snapshot),
        };
        let GroundEdits {
            ground,
            footprints,
            scratch,
            ..
        } = &mut self.edits;
        apply_all(&mut tile, ground, footprints, &since, scratch);
        Some(TileContent::Edited {
            tile,
            since_snapshot: edits + since.len() as u32,
        })
    }

    /// What has just arrived, kept for a later frame.
    pub(super) fn kept(&self, content: TileContent, log: Option<&EditLog>) -> Arrival {
        Arrival {
            progress: Progress::Done(content),
            sequence: self.own_log(log).map_or(0, EditLog::last_sequence),
            epoch: self.edits.epoch,
        }
    }

    /// What a tile's file holds that was read again, with all edits.
    pub(super) fn with_edits(
        &mut self,
        address: TileAddress,
        base: TerrainTile,
        log: Option<&EditLog>,
    ) -> TileContent {
        let Some(log) = self.own_log(log) else {
            return TileContent::Baked(base);
        };
        let replay = Replay::new(self, address, base.clone(), log, false);
        let content = replay.run(&mut self.edits.scratch);
        content.unwrap_or(TileContent::Baked(base))
    }

    /// A resident tile has another content than before.
    pub(super) fn tile_replaced(&mut self, address: TileAddress, commands: &mut Commands) {
        let page = self.pages().get(address);
        let range = match page.and_then(|page| self.slot(page)).map(|slot| &slot.tile) {
            Some(TileContent::Edited { tile, .. }) => Some(tile.range()),
            _ => None,
        };
        let before = match range {
            Some(range) => self.edits.own.insert(address, range),
            None => self.edits.own.remove(&address),
        };
        if before != range {
            self.refresh_bounds(BTreeSet::from([address]), commands);
        }
    }

    /// Finds out where all edits of a log reach that has just come, in the background.
    fn measure_all(&self, log: &EditLog) {
        let edits: Vec<_> = log
            .active()
            .map(|(sequence, edit)| (sequence, Arc::clone(edit)))
            .collect();
        if edits.is_empty() {
            return;
        }
        let ground = Arc::clone(&self.edits.ground);
        let footprints = Arc::clone(&self.edits.footprints);
        let pool = AsyncComputeTaskPool::get_or_init(TaskPool::default);
        let task = pool.spawn(async move {
            let mut scratch = EditScratch::default();
            for edit in &edits {
                // Nobody is left who would ask.
                if Arc::strong_count(&footprints) == 1 {
                    return;
                }
                footprints.of(edit, &ground, &mut scratch);
            }
        });
        task.detach();
    }

    /// The manifest has changed under the terrain, and with it what edits follow from.
    pub(super) fn restart_edits(&mut self) {
        self.edits.ground = Arc::new(EditGround::new(&self.manifest.file));
        // No log has had this version.
        self.edits.version = u64::MAX;
    }

    /// A tile isn't resident any more: what its edits have made of it is kept, where making it again
    /// would take long.
    pub(super) fn keep_edits(&mut self, address: TileAddress, content: TileContent) {
        if self.stop_remaking(address) {
            return;
        }
        if let TileContent::Edited {
            tile,
            since_snapshot,
        } = content
            && since_snapshot >= SNAPSHOT_AT_LEAST
        {
            let sequence = self.edits.sequence;
            self.edits.snapshot(*tile, sequence);
        }
    }

    /// Hands the log the snapshots that have been made.
    pub(super) fn keep_snapshots(&mut self, edits: &mut TerrainEdits) {
        let has_news = !(self.edits.snapshots.is_empty() && self.edits.bad_snapshots.is_empty());
        let file = &self.manifest.file;
        if !has_news {
            return;
        }
        let log = edits.log_mut();
        let Some(log) = log.filter(|log| log.check_terrain(file).is_ok()) else {
            self.edits.snapshots.clear();
            self.edits.bad_snapshots.clear();
            return;
        };
        for address in self.edits.bad_snapshots.drain(..) {
            log.remove_snapshot(address);
        }
        self.edits.snapshots.retain_mut(|task| {
            let Some(snapshot) = check_ready(task) else {
                return true;
            };
            log.keep_snapshot(snapshot);
            false
        });
    }

    /// Makes the bounds of tiles around `rects` (of level 0) that aren't resident follow from the log's
    /// edits.
    fn measure_absent(&mut self, rects: &[SampleRect], log: &EditLog, commands: &mut Commands) {
        let Some(log) = self.own_log(Some(log)) else {
            return;
        };
        let mut absent = BTreeSet::new();
        for level in 0..self.manifest.file.levels {
            for rect in rects {
                let rect = reach_of(rect, level);
                let around = tiles_around(self.pages().tiles(level), level, rect);
                absent.extend(around.filter(|&address| self.pages().get(address).is_none()));
            }
        }
        for &address in &absent {
            self.edits.own.remove(&address);
            for (_, edit) in log.active_touching(address) {
                let tiles = self.pages().tiles(address.level);
                let mut reached =
                    tiles_around(tiles, address.level, reach_of(&edit.rect(), address.level));
                if reached.any(|tile| tile == address) {
                    let (least, most) = edit.change.limits();
                    self.widen(address, least, most, &mut BTreeSet::new());
                }
            }
        }
        self.refresh_bounds(absent, commands);
    }

    /// Widens the bounds of all tiles that aren't resident by what an edit does to them at most.
    fn widen_by(&mut self, edit: &Edit, changed: &mut BTreeSet<TileAddress>) {
        let (least, most) = edit.change.limits();
        let rect = edit.rect();
        for level in 0..self.manifest.file.levels {
            let tiles = self.pages().tiles(level);
            for address in tiles_around(tiles, level, reach_of(&rect, level)) {
                if self.pages().get(address).is_none() {
                    self.widen(address, least, most, changed);
                }
            }
        }
    }

    /// Widens the bounds of a tile that isn't resident.
    fn widen(
        &mut self,
        address: TileAddress,
        least: i32,
        most: i32,
        changed: &mut BTreeSet<TileAddress>,
    ) {
        let Some(baked) = self.manifest.index.get(address) else {
            return;
        };
        let own = self.edits.own.entry(address).or_insert(baked);
        let by = |height: u16, by: i32| (i32::from(height) + by).clamp(0, u16::MAX.into()) as u16;
        *own = TileRange {
            min: by(own.min, least),
            max: by(own.max, most),
        };
        changed.insert(address);
    }

    /// Brings up to date what follows from heights that have changed.
    fn ground_changed(&mut self, changed: BTreeSet<TileAddress>, commands: &mut Commands) {
        for &address in &changed {
            let below = address.children().into_iter().flatten();
            for tile in below.chain([address]) {
                let page = self.pages().get(tile);
                if let Some(slot) = page.and_then(|page| self.slots[page as usize].as_mut()) {
                    slot.forget_rise();
                }
            }
        }
        self.refresh_bounds(changed, commands);
        self.residency.page_log.touch();
    }

    /// Makes the bounds of tiles follow from their own ranges and their children's bounds, and so on
    /// up to the root.
    pub(super) fn refresh_bounds(
        &mut self,
        mut changed: BTreeSet<TileAddress>,
        commands: &mut Commands,
    ) {
        while let Some(address) = changed.pop_first() {
            let (Some(baked), Some(known)) = (
                self.manifest.index.get(address),
                self.bounds.index.get(address),
            ) else {
                continue;
            };
            // The index's range of a tile covers its children's, too; so does a former manifest's.
            let own = self.edits.own.get(&address).copied().unwrap_or(baked);
            let children = address.children().into_iter().flatten();
            let below = children.filter_map(|child| self.bounds.index.get(child));
            let mut range = below.fold(own, TileRange::union);
            if self.has_wide_bounds {
                range = range.union(known);
            }
            if range == known {
                continue;
            }
            Arc::make_mut(&mut self.bounds)
                .index
                .set(address, Some(range));
            if let Some(index) = self.pages().index(address) {
                self.bounds_log.note(index as u32..index as u32 + 1);
            }
            if let Some(entity) = self.tile(address) {
                let bounds = TileBounds::new(&self.manifest.file, address, range);
                commands.entity(entity).try_insert(bounds);
            }
            if address != self.root() {
                changed.insert(address.parent());
            }
        }
    }

    /// Bounds are those of the manifest again, with what edits have changed.
    pub(super) fn reset_bounds(&mut self, commands: &mut Commands) {
        self.bounds = Arc::clone(&self.manifest);
        self.note_all_bounds();
        let edited = self.edits.own.keys().copied().collect();
        self.refresh_bounds(edited, commands);
    }

    /// A number that follows from all that a region's tiles hold, of all levels, edits included: the
    /// same on every machine that has the same terrain and the same edits. `None` while a stored tile
    /// that the region touches isn't resident, or where it lies beyond the terrain. Reads all
    /// of them: about 10 µs a tile.
    #[must_use]
    pub fn ground_hash(&self, region: &TerrainRegion) -> Option<u128> {
        let file = &self.manifest.file;
        let samples = |at: f32| (f64::from(at) / file.spacing_m).clamp(-1.0, f64::from(1 << 25));
        let rect = SampleRect::new(
            [region.min_m.x, region.min_m.y].map(|at| samples(at).floor() as i32),
            [region.max_m.x, region.max_m.y].map(|at| samples(at).ceil() as i32 + 1),
        );
        let mut hashes = Vec::new();
        for level in 0..file.levels {
            let rect = SampleRect::new(
                rect.min.map(|at| at >> level),
                rect.max.map(|at| ((at - 1) >> level) + 1),
            );
            for address in tiles_around(self.pages().tiles(level), level, rect) {
                if self.manifest.index.get(address).is_none() {
                    continue;
                }
                if self.is_remade(address) {
                    return None;
                }
                let hash = ground_hash(address, self.tile_data(address)?);
                hashes.extend_from_slice(&hash.to_le_bytes());
            }
        }
        (!hashes.is_empty()).then(|| xxhash_rust::xxh3::xxh3_128(&hashes))
    }
}

/// The samples of a level that an edit of `rect` (of level 0) may change, and some more: coarser ones
/// around it have a part in it.
fn reach_of(rect: &SampleRect, level: u8) -> SampleRect {
    SampleRect::new(
        rect.min.map(|at| (at >> level) - 2),
        rect.max.map(|end| (end >> level) + 3),
    )
}

/// The tiles of a level, of which there are `tiles` in x and z, that hold one of the samples in `rect`,
/// in their borders too.
fn tiles_around(
    tiles: [u32; 2],
    level: u8,
    rect: SampleRect,
) -> impl Iterator<Item = TileAddress> + use<> {
    // A tile has two samples more before its first, and three behind its last.
    let border = TILE_BORDER as i32;
    let side = TILE_SAMPLES as i32;
    let range = move |axis: usize| {
        let low = (rect.min[axis] - border - 1).div_euclid(side).max(0);
        let high = (rect.max[axis] - 1 + border).div_euclid(side) + 1;
        low as u32..(high.max(0) as u32).min(tiles[axis])
    };
    range(1).flat_map(move |z| range(0).map(move |x| TileAddress::new(level, x, z)))
}
