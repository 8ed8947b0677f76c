//! What streaming may use: memory, and time a frame.

use crate::tile::{DENSITY_STORED, DENSITY_TEXELS, TILE_STORED};
use bevy::prelude::*;
use std::ops::RangeInclusive;
use thiserror::Error;

/// Bytes that a page takes on the GPU: heights, gradients, densities and error bounds.
pub const PAGE_BYTES: u64 = {
    let (heights, texels) = (TILE_STORED as u64, DENSITY_TEXELS as u64);
    heights * heights * (2 + 4) + texels * texels * (1 + 8)
};

/// Bytes that a loaded tile takes in main memory.
pub const TILE_BYTES: u64 = {
    let (heights, densities, errors) = (
        TILE_STORED as u64,
        DENSITY_STORED as u64,
        DENSITY_TEXELS as u64,
    );
    heights * heights * 2 + densities * densities + errors * errors * 8
};

/// The most pages that there can be: WebGPU's 256 texture layers of 64 pages.
const MAX_PAGES: u64 = 1 << 14;

/// What all terrains and cameras together may use; a resource that may change at any time. What
/// can't be used is logged and replaced by its default.
///
/// Where the views want more tiles than the memory holds, each level loses its farthest tiles, so
/// that detail falls evenly; [`TerrainState::levels_short`] says by how much.
///
/// [`TerrainState::levels_short`]: super::TerrainState::levels_short
#[derive(Resource, Clone, Debug, PartialEq, Reflect)]
#[reflect(Resource, Default, Debug, Clone, PartialEq)]
pub struct TerrainStreaming {
    /// Bytes of GPU memory for pages, at least one page of 113 KiB ([`PAGE_BYTES`]) and at most
    /// 16 384 of them. Memory is taken as pages come into use.
    pub page_bytes: u64,
    /// Bytes of main memory for tiles, at least one of 44 KiB ([`TILE_BYTES`]), besides those that are
    /// on their way. Every tile that has a page is held here too; what is left keeps tiles that have
    /// lost theirs, so that coming back reads nothing.
    pub tile_bytes: u64,
    /// The most tiles that are read at once, 1 to 1024.
    pub loads_in_flight: u32,
    /// Bytes that are uploaded to the GPU in one frame at most, at least one page. Bounds what a
    /// burst of arrivals costs a frame.
    pub upload_bytes_per_frame: u64,
    /// How far ahead along their velocity eyes are followed, 0 to 60 s: tiles are asked for that
    /// long before they are needed.
    pub lookahead_s: f32,
    /// How long a tile may take to load before it counts as failed, seconds, above 0. A source that never
    /// answers would block all others.
    pub load_timeout_s: f32,
    /// After how long a tile or a manifest that could not be read is asked for again, seconds, above 0.
    /// Doubles with every failure, up to 32 times as long.
    pub retry_s: f32,
}

impl Default for TerrainStreaming {
    fn default() -> Self {
        Self {
            page_bytes: 128 << 20,
            tile_bytes: 128 << 20,
            loads_in_flight: 16,
            upload_bytes_per_frame: 2 << 20,
            lookahead_s: 2.0,
            load_timeout_s: 30.0,
            retry_s: 2.0,
        }
    }
}

/// What is wrong with a [`TerrainStreaming`].
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum TerrainStreamingError {
    /// A size or count is out of its range.
    #[error("TerrainStreaming::{name} is {value}: use a number from {least} to {most}")]
    Size {
        /// The field.
        name: &'static str,
        /// Its value.
        value: u64,
        /// The least that it may be.
        least: u64,
        /// The most that it may be.
        most: u64,
    },
    /// A time is out of its range.
    #[error("TerrainStreaming::{name} is {value} s: use a time from {least} to {most} s")]
    Time {
        /// The field.
        name: &'static str,
        /// Its value.
        value: f32,
        /// The least that it may be.
        least: f32,
        /// The most that it may be.
        most: f32,
    },
}

impl TerrainStreaming {
    /// Bytes of GPU memory that are accepted.
    pub const PAGE_BYTES_RANGE: RangeInclusive<u64> = PAGE_BYTES..=MAX_PAGES * PAGE_BYTES;
    /// Bytes of main memory that are accepted.
    pub const TILE_BYTES_RANGE: RangeInclusive<u64> = TILE_BYTES..=u64::MAX;
    /// Numbers of tiles read at once that are accepted.
    pub const LOADS_RANGE: RangeInclusive<u32> = 1..=1 << 10;
    /// Bytes uploaded in a frame that are accepted.
    pub const UPLOAD_BYTES_RANGE: RangeInclusive<u64> = PAGE_BYTES..=u64::MAX;
    /// Times ahead of eyes that are accepted, in seconds.
    pub const LOOKAHEAD_RANGE: RangeInclusive<f32> = 0.0..=60.0;
    /// What is accepted as `load_timeout_s` and `retry_s`, in seconds.
    pub const PATIENCE_RANGE: RangeInclusive<f32> = f32::MIN_POSITIVE..=1e9;

    /// The defaults with room for so many pages, and for as many tiles.
    #[must_use]
    pub fn with_pages(pages: u32) -> Self {
        let default = Self::default();
        Self {
            page_bytes: u64::from(pages) * PAGE_BYTES,
            tile_bytes: u64::from(pages) * TILE_BYTES,
            ..default
        }
    }

    /// Pages that there is room for.
    #[must_use]
    pub fn pages(&self) -> u32 {
        (self.page_bytes / PAGE_BYTES).min(MAX_PAGES) as u32
    }

    /// Tiles that there is room for.
    #[must_use]
    pub const fn tiles(&self) -> u64 {
        self.tile_bytes / TILE_BYTES
    }

    /// Tiles that may become resident in a frame.
    #[must_use]
    pub const fn activations_per_frame(&self) -> u64 {
        self.upload_bytes_per_frame / PAGE_BYTES
    }

    /// These settings with every value that can't be used replaced by its default, each of which
    /// is given to `refused`.
    #[must_use]
    pub fn checked(&self, mut refused: impl FnMut(TerrainStreamingError)) -> Self {
        let default = Self::default();
        let mut size = |name, value: u64, range: RangeInclusive<u64>, default: u64| {
            if range.contains(&value) {
                return value;
            }
            let (least, most) = range.into_inner();
            refused(TerrainStreamingError::Size {
                name,
                value,
                least,
                most,
            });
            default
        };
        let page_bytes = size(
            "page_bytes",
            self.page_bytes,
            Self::PAGE_BYTES_RANGE,
            default.page_bytes,
        );
        let tile_bytes = size(
            "tile_bytes",
            self.tile_bytes,
            Self::TILE_BYTES_RANGE,
            default.tile_bytes,
        );
        let loads_in_flight = size(
            "loads_in_flight",
            self.loads_in_flight.into(),
            (*Self::LOADS_RANGE.start()).into()..=(*Self::LOADS_RANGE.end()).into(),
            default.loads_in_flight.into(),
        ) as u32;
        let upload_bytes_per_frame = size(
            "upload_bytes_per_frame",
            self.upload_bytes_per_frame,
            Self::UPLOAD_BYTES_RANGE,
            default.upload_bytes_per_frame,
        );
        let mut time = |name, value: f32, range: RangeInclusive<f32>, default: f32| {
            // Not a number is in no range.
            if range.contains(&value) {
                return value;
            }
            let (least, most) = range.into_inner();
            refused(TerrainStreamingError::Time {
                name,
                value,
                least,
                most,
            });
            default
        };
        let lookahead_s = time(
            "lookahead_s",
            self.lookahead_s,
            Self::LOOKAHEAD_RANGE,
            default.lookahead_s,
        );
        let load_timeout_s = time(
            "load_timeout_s",
            self.load_timeout_s,
            Self::PATIENCE_RANGE,
            default.load_timeout_s,
        );
        let retry_s = time(
            "retry_s",
            self.retry_s,
            Self::PATIENCE_RANGE,
            default.retry_s,
        );
        Self {
            page_bytes,
            tile_bytes,
            loads_in_flight,
            upload_bytes_per_frame,
            lookahead_s,
            load_timeout_s,
            retry_s,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_settings_are_named_and_replaced() {
        let settings = TerrainStreaming {
            page_bytes: 0,
            tile_bytes: TILE_BYTES - 1,
            loads_in_flight: 0,
            upload_bytes_per_frame: 1,
            lookahead_s: f32::NAN,
            load_timeout_s: 0.0,
            retry_s: -1.0,
        };
        let mut errors = Vec::new();
        let checked = settings.checked(|error| errors.push(error.to_string()));
        assert_eq!(checked, TerrainStreaming::default());
        assert_eq!(errors.len(), 7, "{errors:?}");
        let fine = TerrainStreaming::with_pages(1);
        assert_eq!(fine.checked(|error| panic!("{error}")), fine);
        assert_eq!((fine.pages(), fine.tiles()), (1, 1));
    }
}
