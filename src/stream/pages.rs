//! Which page holds which tile.

use crate::terrain::ManifestFile;
use crate::tile::TileAddress;

/// For every tile of every level the page that holds it, or [`NONE`](Self::NONE).
///
/// All levels lie in one flat table, the finest first, each row by row, so that a GPU can take it
/// as one buffer. 4 bytes a tile, stored or not.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PageTable {
    levels: Vec<LevelPages>,
    flat: Vec<u32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct LevelPages {
    offset: u32,
    tiles: [u32; 2],
}

impl PageTable {
    /// What stands for a tile that is not resident.
    pub const NONE: u32 = u32::MAX;

    /// A table for the terrain that `file` describes, with no tile resident.
    #[must_use]
    pub fn new(file: &ManifestFile) -> Self {
        let mut offset = 0;
        let levels = (0..file.levels)
            .map(|level| {
                let tiles = file.tiles(level);
                let pages = LevelPages { offset, tiles };
                offset += tiles[0] * tiles[1];
                pages
            })
            .collect();
        Self {
            levels,
            flat: vec![Self::NONE; offset as usize],
        }
    }

    /// The whole table: the page of tile `(level, x, z)` stands at
    /// `level_offset(level) + z * tiles(level)[0] + x`.
    #[must_use]
    pub fn flat(&self) -> &[u32] {
        &self.flat
    }

    /// Number of levels, those of the terrain's tiles.
    #[must_use]
    pub fn levels(&self) -> u8 {
        self.levels.len() as u8
    }

    /// Where `level` begins in [`flat`](Self::flat).
    ///
    /// # Panics
    /// Where there is no such level.
    #[must_use]
    pub fn level_offset(&self, level: u8) -> u32 {
        self.levels[usize::from(level)].offset
    }

    /// Tiles of `level` in x and z.
    ///
    /// # Panics
    /// Where there is no such level.
    #[must_use]
    pub fn tiles(&self, level: u8) -> [u32; 2] {
        self.levels[usize::from(level)].tiles
    }

    /// The page that holds a tile, or `None` where it is not resident or lies beyond the terrain.
    #[must_use]
    pub fn get(&self, address: TileAddress) -> Option<u32> {
        let page = self.flat[self.index(address)?];
        (page != Self::NONE).then_some(page)
    }

    /// The tile at a place in [`flat`](Self::flat).
    #[cfg(feature = "render")]
    pub(crate) fn address_at(&self, index: u32) -> Option<TileAddress> {
        let mut levels = (0u8..self.levels()).zip(&self.levels).rev();
        let (level, pages) =
            levels.find(|(_, pages)| pages.offset <= index && index < self.flat.len() as u32)?;
        let place = index - pages.offset;
        let across = pages.tiles[0];
        Some(TileAddress::new(level, place % across, place / across))
    }

    /// Says which page holds a tile. Returns the place of that in [`flat`](Self::flat); `None`, and
    /// nothing done, for an address beyond the terrain.
    pub(crate) fn set(&mut self, address: TileAddress, page: Option<u32>) -> Option<u32> {
        let index = self.index(address)?;
        self.flat[index] = page.unwrap_or(Self::NONE);
        Some(index as u32)
    }

    /// Whether the terrain has a square at this address, stored or not.
    pub(crate) fn holds(&self, address: TileAddress) -> bool {
        self.index(address).is_some()
    }

    /// The place of a tile in [`flat`](Self::flat).
    pub(crate) fn index(&self, address: TileAddress) -> Option<usize> {
        let level = self.levels.get(usize::from(address.level))?;
        let inside = address.x < level.tiles[0] && address.z < level.tiles[1];
        inside.then(|| (level.offset + address.z * level.tiles[0] + address.x) as usize)
    }
}
