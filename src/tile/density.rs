//! Densities of one tile.

use super::{
    DENSITY_BORDER, DENSITY_STORED, DENSITY_TEXELS, TileAddress, TileFormatError, TileKind, format,
};
use std::sync::Arc;

const SIDE: usize = DENSITY_STORED as usize;
const OWN: usize = DENSITY_TEXELS as usize;
const BORDER: i32 = DENSITY_BORDER as i32;

/// The densities of one tile with their border: 35 × 35 `u8`, row by row.
///
/// 0 stands for ground that needs no more triangles than its control faces have, 255 for ground
/// that deserves all that the settings allow. Texel `(x, z)` covers the tile's samples
/// `4 x ..= 4 x + 4` by `4 z ..= 4 z + 4`. Texels beyond the terrain repeat the edge.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DensityTile {
    /// Shared by all clones until one is changed.
    texels: Arc<[u8]>,
}

impl DensityTile {
    /// A tile of 35 × 35 `texels` in row order, border included; `None` where there are more or
    /// fewer.
    #[must_use]
    pub fn from_samples(texels: Box<[u8]>) -> Option<Self> {
        (texels.len() == SIDE * SIDE).then(|| Self {
            texels: texels.into(),
        })
    }

    /// All texels, row by row, border included.
    #[must_use]
    pub fn samples(&self) -> &[u8] {
        &self.texels
    }

    /// All texels, to be changed; those that neighbours hold too must change there as well.
    #[must_use]
    pub fn samples_mut(&mut self) -> &mut [u8] {
        Arc::make_mut(&mut self.texels)
    }

    /// The tile's own 32 × 32 texels, row by row, without the border.
    #[must_use]
    pub fn own_texels(&self) -> [u8; OWN * OWN] {
        let mut own = [0; OWN * OWN];
        for (z, row) in own.chunks_exact_mut(OWN).enumerate() {
            let first = (z + DENSITY_BORDER as usize) * SIDE + DENSITY_BORDER as usize;
            row.copy_from_slice(&self.texels[first..first + OWN]);
        }
        own
    }

    /// The texel in column `x` and row `z`, counted from the tile's first own texel: own texels
    /// are `0..=31`; -1, 32 and 33 are border.
    ///
    /// # Panics
    /// Where `x` or `z` lies outside `-1..=33`.
    #[must_use]
    pub fn get(&self, x: i32, z: i32) -> u8 {
        let side = SIDE as i32;
        let (column, row) = (x + BORDER, z + BORDER);
        assert!(
            (0..side).contains(&column) && (0..side).contains(&row),
            "a density tile has no texel ({x}, {z})"
        );
        self.texels[(row * side + column) as usize]
    }

    /// The bytes of this tile's section: 36 of header, then the texels.
    #[must_use]
    pub fn encode(&self, address: TileAddress, stamp: u32) -> Vec<u8> {
        let numbers = [u32::from(address.level), address.x, address.z];
        let mut bytes = format::start(TileKind::Density, numbers, stamp, SIDE * SIDE);
        bytes.extend_from_slice(&self.texels);
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
        let (stamp, payload) = format::open_tile(bytes, TileKind::Density, expected, SIDE * SIDE)?;
        let tile = Self {
            texels: payload.into(),
        };
        Ok((tile, stamp))
    }
}
