//! All that is stored of one tile.

use super::{DensityTile, ErrorTile, HeightTile, TileAddress, TileFormatError};

/// One tile: what its file holds, and what streaming loads.
#[derive(Clone, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "ecs", derive(bevy::asset::Asset, bevy::reflect::TypePath))]
pub struct TerrainTile {
    /// The tile's heights.
    pub heights: HeightTile,
    /// How finely its ground deserves to be tessellated.
    pub densities: DensityTile,
    /// How far triangles may be from its ground.
    pub errors: ErrorTile,
}

impl TerrainTile {
    /// The bytes of the tile's file: a section each, the heights' first.
    #[must_use]
    pub fn encode(&self, address: TileAddress) -> Vec<u8> {
        super::encode_tile(address, &self.heights, &self.densities, &self.errors)
    }

    /// Reads what [`encode`](Self::encode) wrote.
    ///
    /// # Errors
    /// Where a section is missing, short, damaged, of another format or version, or another tile's
    /// than `expected`; the first such section in the file's order is named.
    pub fn decode(bytes: &[u8], expected: TileAddress) -> Result<Self, TileFormatError> {
        Ok(Self {
            heights: HeightTile::decode(bytes, expected)?,
            densities: DensityTile::decode(bytes, expected)?,
            errors: ErrorTile::decode(bytes, expected)?,
        })
    }

    /// The file in the terrain's folder that holds the tile.
    #[must_use]
    pub fn path(address: TileAddress) -> String {
        super::tile_path(address)
    }
}
