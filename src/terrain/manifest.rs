//! What a terrain is: its size, its scale and how its densities were made.

use crate::density::{DensitySettings, DensitySettingsError};
use crate::tile::{ERROR_UNIT, TILE_SAMPLES, TileFormatError, TileIndex};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// What the manifest's `format` field must say.
pub const MANIFEST_MAGIC: &str = "tessera-terrain";
/// The manifest version that this crate writes and reads.
pub const MANIFEST_VERSION: u32 = 4;
/// Name of the manifest in a terrain's folder.
pub const MANIFEST_FILE: &str = "terrain.ron";
/// Name of the tile index in a terrain's folder.
pub const INDEX_FILE: &str = "tiles.index";
/// The fewest samples that a terrain has a side.
pub const MIN_SIZE: u32 = 2;
/// The most samples that a terrain has a side, 2^24: beyond it, `f32` no longer holds every
/// sample's number.
pub const MAX_SIZE: u32 = 1 << 24;
/// The most tiles of level 0 that a terrain has, 2^20 (131072² samples where it is square).
pub const MAX_LEAF_TILES: u64 = 1 << 20;
/// The most levels that a terrain has: as many as [`MAX_SIZE`] needs.
pub const MAX_LEVELS: u8 = 18;

/// Describes a baked terrain; stored as `terrain.ron` beside the tiles.
///
/// Horizontal sizes count samples of level 0. A stored height `h` stands
/// `height_min_m + h * height_step_m` metres above the terrain's origin.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ManifestFile {
    /// Always [`MANIFEST_MAGIC`].
    pub format: String,
    /// Version of the format, [`MANIFEST_VERSION`].
    pub version: u32,
    /// Samples of level 0 in x and z; the terrain reaches from sample 0 to sample `size - 1`.
    pub size: [u32; 2],
    /// Metres between neighbouring samples of level 0, in x and z alike.
    pub spacing_m: f64,
    /// Height in metres of a stored 0.
    pub height_min_m: f64,
    /// Metres between two neighbouring stored heights.
    pub height_step_m: f64,
    /// Number of levels; the last one is a single tile.
    pub levels: u8,
    /// How the densities were made.
    pub density: DensitySettings,
    /// CRC-32 of the tile index, so that a manifest and an index of two bakes are not mixed.
    pub index_crc32: u32,
}

/// A terrain's manifest together with the index of its tiles: everything that is known before
/// the first tile has loaded.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "ecs", derive(bevy::asset::Asset, bevy::reflect::TypePath))]
pub struct TerrainManifest {
    /// What `terrain.ron` says: size, scale, levels, and how densities were made.
    pub file: ManifestFile,
    /// Which tiles exist, and the range of their heights.
    pub index: TileIndex,
}

impl ManifestFile {
    /// Tiles in x and z at `level`.
    #[must_use]
    pub fn tiles(&self, level: u8) -> [u32; 2] {
        self.size.map(|samples| {
            let leaf_tiles = samples.saturating_sub(1).div_ceil(TILE_SAMPLES).max(1);
            leaf_tiles.div_ceil(1_u32.checked_shl(level.into()).unwrap_or(u32::MAX))
        })
    }

    /// What tells the terrain's tiles from those of others: the CRC-32 of size, spacing, lowest
    /// height and step of heights. Every tile holds it, so that a tile of another terrain is not
    /// taken for one of this. Follows from what a bake knows before it begins, so that its parts
    /// may be made apart; two terrains of the same scale have the same.
    #[must_use]
    pub fn stamp(&self) -> u32 {
        let mut hasher = crc32fast::Hasher::new();
        for samples in self.size {
            hasher.update(&samples.to_le_bytes());
        }
        for metres in [self.spacing_m, self.height_min_m, self.height_step_m] {
            hasher.update(&metres.to_le_bytes());
        }
        hasher.finalize()
    }

    /// How many units of stored [error bounds](crate::tile::ErrorTile) make a metre.
    #[must_use]
    pub fn error_units_per_m(&self) -> f64 {
        f64::from(ERROR_UNIT) / self.height_step_m
    }

    /// Metres above the terrain's origin of a stored height.
    #[must_use]
    pub fn height_m(&self, stored: u16) -> f64 {
        self.height_min_m + f64::from(stored) * self.height_step_m
    }

    /// Levels that a terrain of `size` samples has: as many as it takes to reach a single tile.
    #[must_use]
    pub fn levels_for(size: [u32; 2]) -> u8 {
        let leaf_tiles = size
            .map(|samples| samples.saturating_sub(1).div_ceil(TILE_SAMPLES))
            .into_iter()
            .fold(1, u32::max);
        let mut levels = 1;
        while leaf_tiles.div_ceil(1 << (levels - 1)) > 1 {
            levels += 1;
        }
        levels
    }

    /// Samples of `level` in x and z. Sample `k` lies on sample `k << level` of level 0; the last
    /// one lies on the terrain's edge or, where that falls between two samples, just beyond it.
    #[must_use]
    pub fn samples(&self, level: u8) -> [u32; 2] {
        self.size.map(|samples| {
            let stride = 1_u32.checked_shl(level.into()).unwrap_or(u32::MAX);
            samples.saturating_sub(1).div_ceil(stride) + 1
        })
    }

    /// Checks that the numbers describe a terrain that this crate can hold, so that whatever reads
    /// them later may count on it.
    ///
    /// # Errors
    /// For another format or version, a size outside [`MIN_SIZE`]`..=`[`MAX_SIZE`] or of more
    /// than [`MAX_LEAF_TILES`] tiles, a number of levels that doesn't fit the size, and numbers
    /// that aren't finite or positive where they must be.
    pub fn validate(&self) -> Result<(), ManifestError> {
        if self.format != MANIFEST_MAGIC {
            return Err(ManifestError::Format {
                found: self.format.chars().take(40).collect(),
            });
        }
        if self.version != MANIFEST_VERSION {
            return Err(ManifestError::Version {
                found: self.version,
            });
        }
        check_size(self.size)?;
        let wanted = Self::levels_for(self.size);
        if self.levels != wanted {
            return Err(ManifestError::Levels {
                found: self.levels,
                wanted,
                size: self.size,
            });
        }
        let number = |name, value: f64, positive: bool| {
            if value.is_finite() && (!positive || value > 0.0) {
                Ok(())
            } else {
                Err(ManifestError::Number { name, value })
            }
        };
        number("spacing_m", self.spacing_m, true)?;
        number("height_min_m", self.height_min_m, false)?;
        number("height_step_m", self.height_step_m, true)?;
        self.density.validate().map_err(ManifestError::Density)
    }
}

/// Checks a terrain's size against the limits; takes no memory however much is promised.
pub(crate) fn check_size(size: [u32; 2]) -> Result<(), ManifestError> {
    let leaf_tiles: u64 = size
        .iter()
        .map(|samples| u64::from(samples.saturating_sub(1).div_ceil(TILE_SAMPLES)))
        .product();
    let fits = size.iter().all(|side| (MIN_SIZE..=MAX_SIZE).contains(side));
    if fits && leaf_tiles <= MAX_LEAF_TILES {
        Ok(())
    } else {
        Err(ManifestError::Size { found: size })
    }
}

impl TerrainManifest {
    /// Puts together what `terrain.ron` (its text) and `tiles.index` (its bytes) say.
    ///
    /// # Errors
    /// Where either can't be read or the two aren't of the same bake.
    pub fn decode(ron: &str, index: &[u8]) -> Result<Self, ManifestError> {
        let file: ManifestFile =
            ron::from_str(ron).map_err(|error| ManifestError::Syntax(error.to_string()))?;
        file.validate()?;
        let checksum = crc32fast::hash(index);
        let decoded = TileIndex::decode(index).map_err(ManifestError::Index)?;
        if checksum != file.index_crc32 {
            return Err(ManifestError::IndexChecksum {
                found: checksum,
                wanted: file.index_crc32,
            });
        }
        let found: Vec<_> = decoded.levels().iter().map(|level| level.tiles()).collect();
        let wanted: Vec<_> = (0..file.levels).map(|level| file.tiles(level)).collect();
        if found != wanted {
            return Err(ManifestError::IndexTiles {
                found: found.first().copied().unwrap_or_default(),
                wanted: wanted.first().copied().unwrap_or_default(),
            });
        }
        Ok(Self {
            file,
            index: decoded,
        })
    }

    /// Reads the manifest and the index of the terrain in the folder `dir`.
    ///
    /// # Errors
    /// Where a file can't be read, and where [`decode`](Self::decode) refuses them.
    pub fn read(dir: &Path) -> Result<Self, ManifestError> {
        // A manifest takes some hundred bytes and an index at most 6 MiB: what is much larger is
        // something else, and isn't worth the memory to find that out.
        let read = |name: &str, limit: u64| {
            let path = dir.join(name);
            let failed = |reason: std::io::Error| ManifestError::Read {
                path: path.clone(),
                reason,
            };
            let length = std::fs::metadata(&path).map_err(failed)?.len();
            if length > limit {
                return Err(ManifestError::TooLong {
                    path,
                    found: length,
                    limit,
                });
            }
            std::fs::read(&path).map_err(failed)
        };
        let ron = read(MANIFEST_FILE, 1 << 20)?;
        let ron = String::from_utf8(ron)
            .map_err(|_| ManifestError::Syntax("it is not text".to_owned()))?;
        Self::decode(&ron, &read(INDEX_FILE, 1 << 24)?)
    }
}

/// Why a folder, or a pair of files, is not a terrain that this crate can use.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ManifestError {
    /// A file can't be read.
    #[error("{} can't be read: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        reason: std::io::Error,
    },
    /// A file is longer than it can be.
    #[error(
        "{} has {found} bytes where at most {limit} belong: it is something else",
        path.display()
    )]
    TooLong {
        /// The file.
        path: PathBuf,
        /// Its length in bytes.
        found: u64,
        /// The most bytes that it may have.
        limit: u64,
    },
    /// `terrain.ron` is not RON, or not a manifest.
    #[error("terrain.ron can't be understood: {0}")]
    Syntax(String),
    /// `terrain.ron` is another program's.
    #[error("terrain.ron has the format {found:?} where \"{MANIFEST_MAGIC}\" is wanted")]
    Format {
        /// The format found, at most 40 characters of it.
        found: String,
    },
    /// Written by another version of this crate.
    #[error(
        "terrain.ron has version {found} where this program reads version {MANIFEST_VERSION}; \
         bake again"
    )]
    Version {
        /// The version found.
        found: u32,
    },
    /// Too small or too large.
    #[error(
        "a terrain of {} x {} samples is out of bounds: each side has 2 to 16777216 samples, and \
         the whole at most 1048576 tiles of 128 x 128 samples",
        found[0],
        found[1]
    )]
    Size {
        /// Samples in x and z.
        found: [u32; 2],
    },
    /// The number of levels doesn't follow from the size.
    #[error(
        "terrain.ron has {found} levels where a terrain of {} x {} samples has {wanted}",
        size[0],
        size[1]
    )]
    Levels {
        /// Levels found.
        found: u8,
        /// Levels that the size needs.
        wanted: u8,
        /// Samples in x and z.
        size: [u32; 2],
    },
    /// A number that is not finite, or not positive where it must be.
    #[error("terrain.ron has {name} = {value}, which can't be")]
    Number {
        /// The field.
        name: &'static str,
        /// Its value.
        value: f64,
    },
    /// The density settings can't be.
    #[error("terrain.ron can't be used: {0}")]
    Density(#[source] DensitySettingsError),
    /// The index is damaged.
    #[error("tiles.index can't be used: {0}")]
    Index(#[source] TileFormatError),
    /// Manifest and index were not written by the same bake.
    #[error(
        "tiles.index has the checksum {found:08x} where terrain.ron wants {wanted:08x}: they are \
         of different bakes"
    )]
    IndexChecksum {
        /// Checksum of the index found.
        found: u32,
        /// Checksum that the manifest wants.
        wanted: u32,
    },
    /// The index has another number of tiles than the manifest's size needs.
    #[error(
        "tiles.index has {} x {} tiles of level 0 where terrain.ron wants {} x {}",
        found[0],
        found[1],
        wanted[0],
        wanted[1]
    )]
    IndexTiles {
        /// Tiles of level 0 found.
        found: [u32; 2],
        /// Tiles of level 0 that the manifest wants.
        wanted: [u32; 2],
    },
}

/// The manifest of a terrain that exists in tests only.
#[cfg(test)]
pub(crate) fn test_manifest_file(size: [u32; 2]) -> ManifestFile {
    ManifestFile {
        format: MANIFEST_MAGIC.to_owned(),
        version: MANIFEST_VERSION,
        size,
        spacing_m: 1.0,
        height_min_m: -100.0,
        height_step_m: 0.05,
        levels: ManifestFile::levels_for(size),
        density: DensitySettings::default(),
        index_crc32: 0,
    }
}
