//! Heights of one tile.

use super::{
    TILE_BORDER, TILE_SAMPLES, TILE_STORED, TileAddress, TileFormatError, TileKind, TileRange,
    format,
};
use std::sync::Arc;

const SIDE: usize = TILE_STORED as usize;
const BORDER: i32 = TILE_BORDER as i32;

/// The heights of one tile with its borders: 133 × 133 `u16`, row by row.
///
/// A stored height becomes metres through [`ManifestFile::height_m`]. Samples beyond the terrain's
/// last sample repeat the edge.
///
/// [`ManifestFile::height_m`]: crate::terrain::ManifestFile::height_m
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct HeightTile {
    /// Shared by all clones until one is changed.
    samples: Arc<[u16]>,
}

impl HeightTile {
    /// A tile of 133 × 133 `samples` in row order, borders included; `None` where there are more
    /// or fewer.
    #[must_use]
    pub fn from_samples(samples: Box<[u16]>) -> Option<Self> {
        (samples.len() == SIDE * SIDE).then(|| Self {
            samples: samples.into(),
        })
    }

    /// All samples, row by row, borders included.
    #[must_use]
    pub fn samples(&self) -> &[u16] {
        &self.samples
    }

    /// All samples, to be changed.
    ///
    /// Whoever changes a sample that other tiles hold too (own samples near an edge, borders)
    /// changes it there as well, or the surface tears.
    #[must_use]
    pub fn samples_mut(&mut self) -> &mut [u16] {
        Arc::make_mut(&mut self.samples)
    }

    /// The sample in column `x` and row `z`, counted from the tile's first own sample: own samples
    /// are `0..=127`, 128 closes the last quad, and -2, -1, 129 and 130 are border.
    ///
    /// # Panics
    /// Where `x` or `z` lies outside `-2..=130`.
    #[must_use]
    pub fn get(&self, x: i32, z: i32) -> u16 {
        let side = SIDE as i32;
        let (column, row) = (x + BORDER, z + BORDER);
        assert!(
            (0..side).contains(&column) && (0..side).contains(&row),
            "a tile has no sample ({x}, {z})"
        );
        self.samples[(row * side + column) as usize]
    }

    /// The lowest and the highest of the 129 × 129 samples on the tile's own square, its far edges
    /// included and its borders not.
    #[must_use]
    pub fn range(&self) -> TileRange {
        let (first, count) = (TILE_BORDER as usize, TILE_SAMPLES as usize + 1);
        let mut range = TileRange {
            min: u16::MAX,
            max: u16::MIN,
        };
        for row in self.samples.chunks_exact(SIDE).skip(first).take(count) {
            for &sample in &row[first..first + count] {
                range.min = range.min.min(sample);
                range.max = range.max.max(sample);
            }
        }
        range
    }

    /// The bytes of this tile's section: 36 of header, then the samples, little endian.
    #[must_use]
    pub fn encode(&self, address: TileAddress, stamp: u32) -> Vec<u8> {
        let numbers = [u32::from(address.level), address.x, address.z];
        let mut bytes = format::start(TileKind::Height, numbers, stamp, SIDE * SIDE * 2);
        bytes.extend(self.samples.iter().flat_map(|s| s.to_le_bytes()));
        format::finish(bytes)
    }

    /// Reads what [`encode`](Self::encode) wrote, alone or beside the tile's other sections.
    ///
    /// # Errors
    /// Where the bytes are short, damaged, of another format or version, or another tile's than
    /// `expected`.
    pub fn decode(bytes: &[u8], expected: TileAddress) -> Result<Self, TileFormatError> {
        Self::decode_stamped(bytes, expected).map(|(tile, _)| tile)
    }

    /// [`decode`](Self::decode), with the stamp of the terrain that the section belongs to.
    pub(crate) fn decode_stamped(
        bytes: &[u8],
        expected: TileAddress,
    ) -> Result<(Self, u32), TileFormatError> {
        let (stamp, payload) =
            format::open_tile(bytes, TileKind::Height, expected, SIDE * SIDE * 2)?;
        let tile = Self {
            samples: payload
                .chunks_exact(2)
                .map(|pair| u16::from_le_bytes([pair[0], pair[1]]))
                .collect(),
        };
        Ok((tile, stamp))
    }
}
