//! Tiles: the unit in which heights, densities and error bounds are stored, streamed and edited.
//!
//! A tile covers [`TILE_SAMPLES`]² samples of one level and carries a border of its neighbours'
//! samples, so that whoever holds one tile can filter, interpolate and tessellate inside it
//! without asking for another. Neighbouring tiles hold identical border samples, bit for bit.

mod address;
mod density;
mod error;
mod format;
mod height;
mod index;
#[cfg(feature = "ecs")]
mod loader;
#[cfg(feature = "archive")]
mod packed;
mod whole;

pub use address::TileAddress;
pub use density::DensityTile;
pub use error::{ERROR_UNIT, ErrorTile, decode_error, encode_error};
pub(crate) use format::of_terrain;
pub use format::{TileFormatError, TileKind};
pub use height::HeightTile;
pub use index::{LevelIndex, TileIndex, TileRange};
#[cfg(all(feature = "ecs", feature = "archive"))]
pub(crate) use loader::address_of;
#[cfg(feature = "ecs")]
pub use loader::{TerrainTileLoader, TileLoadError};
#[cfg(feature = "archive")]
pub use packed::PackError;
pub use whole::TerrainTile;
pub(crate) use whole::is_packed;

/// The file in a terrain's folder that holds a tile.
#[must_use]
pub fn tile_path(address: TileAddress) -> String {
    let TileAddress { level, x, z } = address;
    format!("tile/{level}/{x}_{z}.tile")
}

/// The bytes of a tile's file: its heights' section, its densities', and that of its error bounds.
/// One file and not three, because on many disks a file costs more than what is in it. `stamp` is
/// that of the terrain, [`ManifestFile::stamp`](crate::terrain::ManifestFile::stamp).
#[must_use]
pub fn encode_tile(
    address: TileAddress,
    stamp: u32,
    heights: &HeightTile,
    densities: &DensityTile,
    errors: &ErrorTile,
) -> Vec<u8> {
    let mut bytes = heights.encode(address, stamp);
    bytes.extend(densities.encode(address, stamp));
    bytes.extend(errors.encode(address, stamp));
    bytes
}

/// Samples along a tile's side, borders not counted; also the distance in samples between the
/// origins of two neighbouring tiles of a level.
pub const TILE_SAMPLES: u32 = 128;
/// Border samples before a tile's first own sample, in each direction.
pub const TILE_BORDER: u32 = 2;
/// Samples along a tile's stored side: 2 before, 128 own, 3 after (one of them closes the last
/// quad, two are border).
pub const TILE_STORED: u32 = TILE_SAMPLES + 2 * TILE_BORDER + 1;
/// Samples along the side of one density texel.
pub const DENSITY_CELL: u32 = 4;
/// Density texels along a tile's side, borders not counted.
pub const DENSITY_TEXELS: u32 = TILE_SAMPLES / DENSITY_CELL;
/// Border texels before a density tile's first own texel.
pub const DENSITY_BORDER: u32 = 1;
/// Density texels along a stored side: 1 before, 32 own, 2 after.
pub const DENSITY_STORED: u32 = DENSITY_TEXELS + 2 * DENSITY_BORDER + 1;
/// Spacings for which a texel's error is bounded: `2^0 ..= 2^6` samples of the tile's level.
pub const ERROR_SPACINGS: usize = 7;
