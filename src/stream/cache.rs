//! Loaded tiles that have no page.

use crate::tile::TerrainTile;
use bevy::asset::{AssetId, Handle};
use std::collections::VecDeque;

/// Keeps tiles loaded that were evicted, or that nobody wants any more, as far as there is memory:
/// the latest ones.
#[derive(Debug, Default)]
pub(crate) struct TileCache {
    /// The oldest first.
    tiles: VecDeque<Handle<TerrainTile>>,
}

impl TileCache {
    pub(crate) fn len(&self) -> usize {
        self.tiles.len()
    }

    pub(crate) fn keep(&mut self, tile: Handle<TerrainTile>) {
        self.forget(tile.id());
        self.tiles.push_back(tile);
    }

    /// For a tile that somebody else holds now.
    pub(crate) fn forget(&mut self, tile: AssetId<TerrainTile>) {
        if let Some(at) = self.tiles.iter().position(|kept| kept.id() == tile) {
            self.tiles.remove(at);
        }
    }

    /// Drops the oldest until at most `most` are left.
    pub(crate) fn shrink(&mut self, most: usize) {
        while self.tiles.len() > most {
            self.tiles.pop_front();
        }
    }
}
