//! What happens when files change under a running program: tiles are read again, and states replaced.

use super::start::NextTerrain;
use super::state::{Slot, TerrainState};
use super::systems::Outside;
use crate::edit::EditLog;
use crate::residency::Availability;
use crate::terrain::{TerrainManifest, TileFailed, TileReloaded};
use crate::tile::{TerrainTile, TileAddress};
use bevy::asset::AssetId;
use bevy::log::{info, warn};
use bevy::prelude::*;
use std::collections::VecDeque;
use std::sync::Arc;

impl TerrainState {
    /// Follows a changed manifest, where what is resident may stay: where sizes and heights mean
    /// the same. Says whether it does.
    pub(super) fn take_manifest(&mut self, manifest: &TerrainManifest) -> bool {
        let (old, new) = (&self.manifest.file, &manifest.file);
        if old.stamp() != new.stamp() || old.levels != new.levels {
            return false;
        }
        let mut bounds = manifest.clone();
        for (address, range) in self.bounds.index.iter() {
            let range = manifest
                .index
                .get(address)
                .map_or(range, |new| new.union(range));
            bounds.index.set(address, Some(range));
        }
        self.bounds = Arc::new(bounds);
        self.note_all_bounds();
        self.has_wide_bounds = true;
        self.manifest = Arc::new(manifest.clone());
        self.restart_edits();
        self.has_strays = true;
        self.available = Availability::new(&self.manifest.index);
        self.failed.clear();
        self.must_plan = true;
        self.refresh();
        true
    }

    /// Says that any tile's bounds may have changed.
    pub(super) fn note_all_bounds(&mut self) {
        let tiles = self.pages().flat().len() as u32;
        self.bounds_log.note(0..tiles);
    }

    /// Reads all tiles again that are there or on their way.
    pub(super) fn refresh(&mut self) {
        self.was_refreshed = true;
        let residents = self.residency.residents();
        let mut tiles: VecDeque<_> = residents.map(|(_, address)| address).collect();
        // The coarsest first: they are seen most.
        tiles
            .make_contiguous()
            .sort_unstable_by_key(|tile| (u8::MAX - tile.level, tile.z, tile.x));
        for loading in &mut self.loading {
            loading.arrival = None;
            loading.is_stale = true;
            tiles.push_front(loading.address);
        }
        self.to_refresh = tiles;
    }

    /// Loads nothing more: another state is about to take this one's place.
    pub(super) fn await_next(&mut self) {
        self.has_next = true;
        self.loading.clear();
        self.to_refresh.clear();
        self.refreshing.clear();
    }

    /// Asks for up to `most` tiles that are to be read again; returns how many were.
    pub(super) fn request_refreshed(
        &mut self,
        most: usize,
        now_s: f64,
        server: &AssetServer,
    ) -> usize {
        let mut asked = 0;
        while asked < most
            && let Some(address) = self.to_refresh.pop_front()
        {
            let page = self.pages().get(address);
            let slot = page.and_then(|page| self.slot(page));
            let loading = self.loading.iter().find(|l| l.address == address);
            let handle = slot
                .map(|slot| &slot.handle)
                .or(loading.map(|loading| &loading.handle));
            if let Some(id) = handle.map(Handle::id) {
                server.reload(self.tile_path(address));
                self.refreshing.push((id, now_s));
                asked += 1;
            }
        }
        asked
    }

    /// Whether a tile is this terrain's, resident or on its way.
    pub(super) fn is_holding(&self, id: AssetId<TerrainTile>) -> bool {
        let mut slots = self.slots.iter().flatten();
        slots.any(|slot| slot.handle.id() == id)
            || self.loading.iter().any(|loading| loading.handle.id() == id)
    }

    /// The page and the place of a resident tile.
    fn resident_of(&self, id: AssetId<TerrainTile>) -> Option<(u32, TileAddress)> {
        let is_it = |slot: &Option<Slot>| slot.as_ref().is_some_and(|slot| slot.handle.id() == id);
        let page = self.slots.iter().position(is_it)? as u32;
        Some((page, self.residency.tile_on(page)?))
    }

    /// A tile's file has been read again.
    pub(super) fn tile_changed(
        &mut self,
        entity: Entity,
        id: AssetId<TerrainTile>,
        tile: &TerrainTile,
        log: Option<&EditLog>,
        commands: &mut Commands,
    ) {
        self.refreshing.retain(|&(other, _)| other != id);
        if let Some(loading) = self.loading.iter_mut().find(|l| l.handle.id() == id) {
            // Checked when it is polled.
            if loading.is_stale && tile.check(&self.manifest, loading.address).is_ok() {
                loading.is_stale = false;
            } else if loading.is_stale {
                // Polled once more, it fails with what is wrong.
                loading.since_s = f64::NEG_INFINITY;
            }
            loading.arrival = None;
            return;
        }
        let Some((page, address)) = self.resident_of(id) else {
            return;
        };
        if let Err(error) = tile.check(&self.manifest, address) {
            let reason = self.of_file(address, &error.to_string());
            self.tile_change_failed(entity, id, reason, commands);
            return;
        }
        let Some(slot) = self.slots[page as usize].as_mut() else {
            return;
        };
        slot.complaint.clear();
        slot.retry_at_s = None;
        if slot.tile.base() == tile {
            return;
        }
        self.stop_remaking(address);
        let content = self.with_edits(address, tile.clone(), log);
        let Some(slot) = self.slots[page as usize].as_mut() else {
            return;
        };
        slot.take(content);
        let tile = slot.entity;
        self.tile_replaced(address, commands);
        self.residency.page_log.touch();
        self.failed.remove(&address);
        info!("tile {address} of terrain {entity} has been read again");
        commands.trigger(TileReloaded {
            entity,
            tile,
            address,
        });
    }

    /// A resident tile's file has changed and can't be used: what was read before stays.
    pub(super) fn tile_change_failed(
        &mut self,
        entity: Entity,
        id: AssetId<TerrainTile>,
        reason: String,
        commands: &mut Commands,
    ) {
        self.refreshing.retain(|&(other, _)| other != id);
        if let Some(loading) = self.loading.iter_mut().find(|l| l.handle.id() == id) {
            // Polled once more, what was there before does or doesn't do.
            loading.since_s = f64::NEG_INFINITY;
        }
        let Some((page, address)) = self.resident_of(id) else {
            return;
        };
        self.has_complaints = true;
        if let Some(slot) = self.slots[page as usize].as_mut()
            && slot.complaint != reason
        {
            slot.complaint.clone_from(&reason);
            warn!("tile {address} of terrain {entity} stays as it was: {reason}");
            commands.trigger(TileFailed {
                entity,
                address,
                reason,
            });
        }
    }

    /// Whether the coarsest tiles have loaded, as far as they can be had.
    pub(super) fn has_its_roots(&self) -> bool {
        let root = self.root();
        self.loading
            .iter()
            .any(|l| l.address == root && l.is_ready())
            && self.root_tiles().all(|address| {
                !self.available.has(address)
                    || self
                        .loading
                        .iter()
                        .any(|l| l.address == address && l.is_ready())
            })
    }

    fn root_tiles(&self) -> impl Iterator<Item = TileAddress> + use<> {
        let root_level = self.root().level;
        let coarsest = root_level.saturating_sub(self.settings.root_levels - 1)..=root_level;
        let tiles: Vec<_> = coarsest
            .rev()
            .map(|level| (level, self.pages().tiles(level)))
            .collect();
        tiles.into_iter().flat_map(|(level, [across, down])| {
            (0..down).flat_map(move |z| (0..across).map(move |x| TileAddress::new(level, x, z)))
        })
    }

    /// Asks for the coarsest tiles of a terrain that isn't drawn yet.
    pub(super) fn request_roots(&mut self, outside: &Outside) {
        let now_s = outside.time.elapsed_secs_f64();
        self.retry(now_s);
        for (rank, address) in (0..).zip(self.root_tiles()) {
            self.request(address, rank, now_s, outside);
        }
    }

    /// Lets another state take this one's place.
    pub(super) fn give_way(&mut self, next: &mut Self, entity: Entity, commands: &mut Commands) {
        next.eyes.clone_from(&self.eyes);
        next.fades.clone_from(&self.fades);
        next.pins.clone_from(&self.pins);
        next.must_plan = true;
        next.is_next = false;
        std::mem::swap(self, next);
        let residents: Vec<_> = next.residency.residents().collect();
        for (page, address) in residents {
            if let Some(slot) = next.slot(page) {
                slot.evict(entity, address, commands);
            }
        }
        commands.entity(entity).try_remove::<NextTerrain>();
        info!("terrain {entity} is another one now: its manifest has changed");
    }
}
