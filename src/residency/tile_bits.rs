//! One bit a tile.

use crate::tile::{TileAddress, TileIndex};

/// A bit for every square of every level, all levels in one table.
///
/// Each row begins with a word of its own, so that rows can be counted and compared 64 tiles at
/// once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct TileBits {
    levels: Vec<LevelBits>,
    words: Vec<u64>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct LevelBits {
    tiles: [u32; 2],
    /// Where the level's first row begins in the table.
    first: usize,
    /// Words a row.
    stride: usize,
}

impl TileBits {
    /// A table with a square for every tile that `index` has room for, no bit set.
    pub(super) fn new(index: &TileIndex) -> Self {
        let mut first = 0;
        let levels = index
            .levels()
            .iter()
            .map(|level| {
                let tiles = level.tiles();
                let stride = tiles[0].div_ceil(u64::BITS) as usize;
                let bits = LevelBits {
                    tiles,
                    first,
                    stride,
                };
                first += stride * tiles[1] as usize;
                bits
            })
            .collect();
        Self {
            levels,
            words: vec![0; first],
        }
    }

    /// Number of levels.
    pub(super) fn levels(&self) -> u8 {
        self.levels.len() as u8
    }

    /// Squares of a level in x and z; none where there is no such level.
    pub(super) fn tiles(&self, level: u8) -> [u32; 2] {
        self.levels
            .get(usize::from(level))
            .map_or([0, 0], |level| level.tiles)
    }

    fn holds(&self, address: TileAddress) -> bool {
        let tiles = self.tiles(address.level);
        address.x < tiles[0] && address.z < tiles[1]
    }

    /// The words of a row; none beyond the terrain.
    pub(super) fn row(&self, level: u8, z: u32) -> &[u64] {
        let Some(bits) = self.levels.get(usize::from(level)) else {
            return &[];
        };
        if z >= bits.tiles[1] {
            return &[];
        }
        let first = bits.first + z as usize * bits.stride;
        &self.words[first..first + bits.stride]
    }

    fn row_mut(&mut self, level: u8, z: u32) -> &mut [u64] {
        let Some(bits) = self.levels.get(usize::from(level)) else {
            return &mut [];
        };
        if z >= bits.tiles[1] {
            return &mut [];
        }
        let first = bits.first + z as usize * bits.stride;
        &mut self.words[first..first + bits.stride]
    }

    /// A tile's bit; unset beyond the terrain.
    pub(super) fn get(&self, address: TileAddress) -> bool {
        let word = self.row(address.level, address.z);
        bit(word, address.x)
    }

    /// Sets or clears a tile's bit. An address beyond the terrain is ignored.
    pub(super) fn set(&mut self, address: TileAddress, value: bool) {
        if !self.holds(address) {
            return;
        }
        let word = &mut self.row_mut(address.level, address.z)[(address.x / u64::BITS) as usize];
        let mask = 1 << (address.x % u64::BITS);
        if value {
            *word |= mask;
        } else {
            *word &= !mask;
        }
    }

    /// Clears the bits of the columns `low..high` of a row.
    pub(super) fn clear_span(&mut self, level: u8, z: u32, low: u32, high: u32) {
        let high = high.min(self.tiles(level)[0]);
        let row = self.row_mut(level, z);
        for (word, mask) in words_of(low, high) {
            if let Some(word) = row.get_mut(word) {
                *word &= !mask;
            }
        }
    }

    /// Number of set bits.
    pub(super) fn count(&self) -> usize {
        self.words
            .iter()
            .map(|word| word.count_ones() as usize)
            .sum()
    }

    pub(super) fn clear(&mut self) {
        self.words.fill(0);
    }
}

/// Bit `x` of a row; unset past its end.
pub(super) fn bit(row: &[u64], x: u32) -> bool {
    row.get((x / u64::BITS) as usize)
        .is_some_and(|word| word >> (x % u64::BITS) & 1 != 0)
}

/// The words that hold the columns `low..high`, each with the mask of those columns.
pub(super) fn words_of(low: u32, high: u32) -> impl Iterator<Item = (usize, u64)> {
    let words = if low < high {
        low / u64::BITS..(high - 1) / u64::BITS + 1
    } else {
        0..0
    };
    words.map(move |word| {
        let start = word * u64::BITS;
        let mut mask = u64::MAX;
        if low > start {
            mask <<= low - start;
        }
        if high - start < u64::BITS {
            mask &= (1 << (high - start)) - 1;
        }
        (word as usize, mask)
    })
}
