//! Which tiles a terrain has, and between which heights each of them lies.

use super::{TileAddress, TileFormatError, TileKind, format};
use crate::terrain::{MAX_LEAF_TILES, MAX_LEVELS, ManifestFile};

/// The lowest and the highest stored height in a tile's square, both included.
///
/// A parent's range covers its children's, so that whatever lies outside a tile's range lies
/// outside everything below it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileRange {
    /// Lowest stored height, in the manifest's height steps.
    pub min: u16,
    /// Highest stored height, in the manifest's height steps.
    pub max: u16,
}

impl TileRange {
    /// How a tile that isn't stored is written: a range that holds nothing.
    const ABSENT: Self = Self { min: 1, max: 0 };

    /// The least range that covers both.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self {
            min: self.min.min(other.min),
            max: self.max.max(other.max),
        }
    }

    /// Whether `other` lies within.
    #[must_use]
    pub const fn covers(self, other: Self) -> bool {
        self.min <= other.min && other.max <= self.max
    }
}

/// The tiles of one level.
#[derive(Clone, Debug, PartialEq)]
pub struct LevelIndex {
    tiles: [u32; 2],
    ranges: Box<[TileRange]>,
}

impl LevelIndex {
    fn new(tiles: [u32; 2]) -> Self {
        Self {
            tiles,
            ranges: vec![TileRange::ABSENT; tiles[0] as usize * tiles[1] as usize].into(),
        }
    }

    /// Tiles of this level in x and z, stored or not.
    #[must_use]
    pub const fn tiles(&self) -> [u32; 2] {
        self.tiles
    }

    fn at(&self, x: u32, z: u32) -> Option<usize> {
        (x < self.tiles[0] && z < self.tiles[1])
            .then(|| z as usize * self.tiles[0] as usize + x as usize)
    }
}

/// Which tiles a terrain has, and the range of each one's heights; stored as `tiles.index`.
///
/// Takes 4 bytes a tile. Look-ups cost one multiplication and one read.
#[derive(Clone, Debug, PartialEq)]
pub struct TileIndex {
    levels: Vec<LevelIndex>,
}

impl TileIndex {
    /// An index with room for every tile of the terrain that `file` describes, none of them
    /// stored yet. `file` should be [valid](ManifestFile::validate).
    #[must_use]
    pub fn new(file: &ManifestFile) -> Self {
        Self {
            levels: (0..file.levels)
                .map(|level| LevelIndex::new(file.tiles(level)))
                .collect(),
        }
    }

    /// All levels, the finest first.
    #[must_use]
    pub fn levels(&self) -> &[LevelIndex] {
        &self.levels
    }

    /// The range of a tile's heights; `None` where no such tile is stored or where the address
    /// lies beyond the terrain.
    #[must_use]
    pub fn get(&self, address: TileAddress) -> Option<TileRange> {
        let level = self.levels.get(usize::from(address.level))?;
        let range = level.ranges[level.at(address.x, address.z)?];
        (range.min <= range.max).then_some(range)
    }

    /// Sets a tile's range, or says that it isn't stored. An address beyond the terrain is
    /// ignored.
    pub fn set(&mut self, address: TileAddress, range: Option<TileRange>) {
        if let Some(level) = self.levels.get_mut(usize::from(address.level))
            && let Some(at) = level.at(address.x, address.z)
        {
            level.ranges[at] = range.unwrap_or(TileRange::ABSENT);
        }
    }

    /// All stored tiles, the finest level first, row by row.
    pub fn iter(&self) -> impl Iterator<Item = (TileAddress, TileRange)> {
        self.levels.iter().zip(0u8..).flat_map(|(level, number)| {
            let columns = level.tiles[0].max(1) as usize;
            level
                .ranges
                .iter()
                .enumerate()
                .filter(|(_, range)| range.min <= range.max)
                .map(move |(at, &range)| {
                    let (x, z) = ((at % columns) as u32, (at / columns) as u32);
                    (TileAddress::new(number, x, z), range)
                })
        })
    }

    /// Widens every tile's range to cover its stored children's, from the finest level up.
    pub(crate) fn cover_children(&mut self) {
        for level in 1..self.levels.len() {
            let (finer, coarser) = self.levels.split_at_mut(level);
            let (finer, coarser) = (&finer[level - 1], &mut coarser[0]);
            for z in 0..finer.tiles[1] {
                for x in 0..finer.tiles[0] {
                    let (Some(child), Some(parent)) = (finer.at(x, z), coarser.at(x / 2, z / 2))
                    else {
                        continue;
                    };
                    let (child, parent) = (finer.ranges[child], &mut coarser.ranges[parent]);
                    // An absent range would widen nothing where the parent is stored, and an
                    // absent parent must stay absent.
                    if child.min <= child.max && parent.min <= parent.max {
                        *parent = parent.union(child);
                    }
                }
            }
        }
    }

    /// The bytes of the index's file.
    #[must_use]
    pub fn encode(&self) -> Vec<u8> {
        let tiles: usize = self.levels.iter().map(|level| level.ranges.len()).sum();
        let numbers = [self.levels.len() as u32, 0, 0];
        let mut bytes = format::start(
            TileKind::Index,
            numbers,
            0,
            tiles * 4 + self.levels.len() * 8,
        );
        for level in &self.levels {
            for count in level.tiles {
                bytes.extend_from_slice(&count.to_le_bytes());
            }
            for range in &level.ranges {
                bytes.extend_from_slice(&range.min.to_le_bytes());
                bytes.extend_from_slice(&range.max.to_le_bytes());
            }
        }
        format::finish(bytes)
    }

    /// Reads what [`encode`](Self::encode) wrote.
    ///
    /// # Errors
    /// Where the bytes are short, damaged, of another format or version, or describe levels that
    /// no terrain has. Nothing is allocated before the promised sizes have been checked.
    pub fn decode(bytes: &[u8]) -> Result<Self, TileFormatError> {
        let opened = format::open(bytes, TileKind::Index)?;
        let ([count, ..], mut payload) = (opened.numbers, opened.payload);
        if count == 0 || count > u32::from(MAX_LEVELS) {
            return Err(TileFormatError::LevelCount {
                found: count,
                limit: u32::from(MAX_LEVELS),
            });
        }
        let mut levels: Vec<LevelIndex> = Vec::new();
        for number in 0..count {
            let short = |wanted: u64| TileFormatError::Length {
                found: bytes.len() as u64,
                wanted,
            };
            let (head, rest) = payload
                .split_at_checked(8)
                .ok_or_else(|| short(bytes.len() as u64 + 8))?;
            let number_at = |at: usize| {
                u32::from_le_bytes([head[at], head[at + 1], head[at + 2], head[at + 3]])
            };
            let found = [number_at(0), number_at(4)];
            let product = u64::from(found[0]) * u64::from(found[1]);
            let wanted = match levels.last() {
                Some(finer) => finer.tiles.map(|tiles| tiles.div_ceil(2)),
                None if product == 0 || product > MAX_LEAF_TILES => [1, 1],
                None => found,
            };
            let last = number + 1 == count;
            if found != wanted || (last && found != [1, 1]) {
                return Err(TileFormatError::Levels {
                    level: number,
                    found,
                    wanted: if last { [1, 1] } else { wanted },
                });
            }
            let length = product as usize * 4;
            let (ranges, rest) = rest
                .split_at_checked(length)
                .ok_or_else(|| short((bytes.len() + length - rest.len()) as u64))?;
            payload = rest;
            levels.push(LevelIndex {
                tiles: found,
                ranges: ranges
                    .chunks_exact(4)
                    .map(|four| TileRange {
                        min: u16::from_le_bytes([four[0], four[1]]),
                        max: u16::from_le_bytes([four[2], four[3]]),
                    })
                    .collect(),
            });
        }
        if !payload.is_empty() {
            return Err(TileFormatError::Length {
                found: bytes.len() as u64,
                wanted: (bytes.len() - payload.len()) as u64,
            });
        }
        Ok(Self { levels })
    }
}
