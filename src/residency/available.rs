//! Which tiles can be had, and which are there.

use super::tile_bits::TileBits;
use crate::tile::{TileAddress, TileIndex};

/// Which tiles of a terrain can be had.
///
/// A tile can be had if it and all its ancestors are stored and none of them is forbidden: a tile
/// without its parent is of no use, as heights are blended between a level and the next. Three
/// bits a tile (rows are rounded up to 64 tiles); a look-up costs a few nanoseconds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Availability {
    stored: TileBits,
    forbidden: TileBits,
    available: TileBits,
}

impl Availability {
    /// What can be had of a terrain with this index. Cost: some 10 ns a tile.
    #[must_use]
    pub fn new(index: &TileIndex) -> Self {
        let mut stored = TileBits::new(index);
        let forbidden = stored.clone();
        let available = stored.clone();
        for (address, _) in index.iter() {
            stored.set(address, true);
        }
        let mut new = Self {
            stored,
            forbidden,
            available,
        };
        if let Some(root_level) = new.levels().checked_sub(1) {
            new.derive(TileAddress::new(root_level, 0, 0));
        }
        new
    }

    /// Number of levels, those of the terrain's tiles.
    #[must_use]
    pub fn levels(&self) -> u8 {
        self.stored.levels()
    }

    /// Whether a tile can be had; false beyond the terrain.
    #[must_use]
    pub fn has(&self, address: TileAddress) -> bool {
        self.available.get(address)
    }

    /// Number of tiles that can be had. Cost: a pass over the table.
    #[must_use]
    pub fn count(&self) -> usize {
        self.available.count()
    }

    /// Takes out a tile whose file has failed, and all below it. Cost: a few nanoseconds for each
    /// row of tiles below it.
    pub fn forbid(&mut self, address: TileAddress) {
        self.forbidden.set(address, true);
        for level in (0..=address.level.min(self.levels())).rev() {
            let Some([x, z]) = self.square(address, level) else {
                continue;
            };
            for z in z.0..z.1 {
                self.available.clear_span(level, z, x.0, x.1);
            }
        }
    }

    /// Takes back what [`forbid`](Self::forbid) said of this tile, so that it may be tried again.
    /// What is forbidden above or below it stays so. Cost: some 10 ns for each tile below it.
    pub fn permit(&mut self, address: TileAddress) {
        self.forbidden.set(address, false);
        self.derive(address);
    }

    /// Columns and rows of `level` that lie in a tile's square.
    fn square(&self, address: TileAddress, level: u8) -> Option<[(u32, u32); 2]> {
        let down = u32::from(address.level.checked_sub(level)?);
        let tiles = self.stored.tiles(level);
        let span = |at: u32, count: u32| {
            let low = u64::from(at).checked_shl(down)?;
            let high = (u64::from(at) + 1).checked_shl(down)?;
            let count = u64::from(count);
            // Not above `count`, which has 32 bits.
            Some((low.min(count) as u32, high.min(count) as u32))
        };
        Some([span(address.x, tiles[0])?, span(address.z, tiles[1])?])
    }

    /// Finds anew what can be had of a tile's square, the coarsest level first.
    fn derive(&mut self, top: TileAddress) {
        let root_level = self.levels().saturating_sub(1);
        for level in (0..=top.level.min(root_level)).rev() {
            let Some([columns, rows]) = self.square(top, level) else {
                continue;
            };
            for z in rows.0..rows.1 {
                for x in columns.0..columns.1 {
                    let address = TileAddress::new(level, x, z);
                    let can = self.stored.get(address)
                        && !self.forbidden.get(address)
                        && (level == root_level || self.available.get(address.parent()));
                    self.available.set(address, can);
                }
            }
        }
    }

    pub(super) fn bits(&self) -> &TileBits {
        &self.available
    }
}

/// Which tiles of a terrain are resident: closed towards the root, as no tile comes before its
/// parent and none leaves before its children.
///
/// A bit a tile (rows are rounded up to 64 tiles); every call costs a few nanoseconds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ResidentTiles {
    bits: TileBits,
}

impl ResidentTiles {
    /// None, of a terrain with this index.
    #[must_use]
    pub fn new(index: &TileIndex) -> Self {
        Self {
            bits: TileBits::new(index),
        }
    }

    /// Whether a tile is resident.
    #[must_use]
    pub fn contains(&self, address: TileAddress) -> bool {
        self.bits.get(address)
    }

    /// Notes that a tile has become resident. False, and nothing noted, where its parent is not
    /// resident or where the terrain has no such square.
    pub fn insert(&mut self, address: TileAddress) -> bool {
        let is_root = address.level + 1 == self.bits.levels();
        if !is_root && !self.contains(address.parent()) {
            return false;
        }
        self.bits.set(address, true);
        self.contains(address)
    }

    /// Notes that a tile is no longer resident. False, and nothing noted, where it wasn't, or
    /// where one of its children still is.
    pub fn remove(&mut self, address: TileAddress) -> bool {
        let mut children = address.children().into_iter().flatten();
        if !self.contains(address) || children.any(|child| self.contains(child)) {
            return false;
        }
        self.bits.set(address, false);
        true
    }

    /// Notes that no tile is resident.
    pub fn clear(&mut self) {
        self.bits.clear();
    }

    /// Number of resident tiles. Cost: a pass over the table.
    #[must_use]
    pub fn count(&self) -> usize {
        self.bits.count()
    }

    pub(super) fn bits(&self) -> &TileBits {
        &self.bits
    }
}
