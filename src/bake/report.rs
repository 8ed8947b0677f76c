//! What a bake says: while it runs, when it is done, and when it can't be.

use super::SourceError;
use crate::density::DensitySettingsError;
use crate::edit::EditLogError;
use crate::terrain::ManifestError;
use std::ops::RangeInclusive;
use std::path::PathBuf;
use std::time::Duration;
use thiserror::Error;

/// What a bake is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
pub enum BakeStage {
    /// Reading the source for its lowest and highest sample and for samples without data.
    Survey,
    /// Reading the source to fill in samples without data.
    Fill,
    /// Making tiles.
    Bake,
    /// Making densities anew; counted in tiles.
    Density,
    /// Checking the tiles of parts that are merged, or gone on with; counted in tiles.
    Merge,
    /// Packing tiles into an archive; counted in tiles.
    Pack,
    /// Unpacking tiles of an archive; counted in tiles.
    Unpack,
    /// Applying edits; counted in tiles.
    Apply,
    /// Putting the finished terrain in its place.
    Finish,
}

/// Hears how far a bake has come, some times a second.
pub trait BakeProgress: Sync {
    /// A stage begins that will go through `samples` samples (0: no telling, but soon over).
    fn stage(&self, stage: BakeStage, samples: u64) {
        let _ = (stage, samples);
    }

    /// So many samples more are done.
    fn advance(&self, samples: u64) {
        let _ = samples;
    }
}

/// Nobody listens.
impl BakeProgress for () {}

/// What a bake made.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct BakeReport {
    /// Samples in x and z.
    pub size: [u32; 2],
    /// Levels, the finest and the root included.
    pub levels: u8,
    /// Tiles of all levels; each has a file of heights and one of densities.
    pub tiles: u64,
    /// Bytes of all files that were written.
    pub bytes: u64,
    /// Metres between samples of level 0.
    pub spacing_m: f64,
    /// Heights of the stored 0 and 65535, in metres.
    pub height_range_m: RangeInclusive<f64>,
    /// Metres between neighbouring stored heights.
    pub height_step_m: f64,
    /// The source's lowest and highest sample in metres, where they were looked for.
    pub source_range_m: Option<(f64, f64)>,
    /// Samples that lay outside the height range and were clamped.
    pub clamped: u64,
    /// Samples without data that were filled from their surroundings.
    pub filled: u64,
    /// Side in samples of the blocks whose means the filling came from; 1 where it came from the
    /// samples themselves.
    pub fill_block: u32,
    /// How long the bake took.
    pub elapsed: Duration,
}

impl BakeReport {
    /// Samples of the source baked per second, everything included.
    #[must_use]
    pub fn samples_per_second(&self) -> f64 {
        f64::from(self.size[0]) * f64::from(self.size[1]) / self.elapsed.as_secs_f64().max(1e-9)
    }
}

/// Why there is no new terrain. Each message is a sentence that names the file and the cause and
/// says what to do about it; whatever stood in the output's place still stands there.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum BakeError {
    /// The source can't be read.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The source is too small or too large.
    #[error(
        "{name}: {} x {} samples are out of bounds: a terrain has 2 to 16777216 samples a side and \
         at most 1048576 tiles of 128 x 128",
        size[0],
        size[1]
    )]
    Size {
        /// What the source calls itself.
        name: String,
        /// Samples in x and z.
        size: [u32; 2],
    },
    /// A sample is infinite.
    #[error(
        "{name}: the sample in column {x}, row {z} is infinite; mark samples without data with NaN \
         or a no-data value"
    )]
    Infinite {
        /// What the source calls itself.
        name: String,
        /// Column, from 0.
        x: u32,
        /// Row, from 0.
        z: u32,
    },
    /// A sample is further from 0 than any height.
    #[error(
        "{name}: the sample in column {x}, row {z} is {found:e} m, which is no height; if it marks \
         missing data, name it with --no-data"
    )]
    Implausible {
        /// What the source calls itself.
        name: String,
        /// Column, from 0.
        x: u32,
        /// Row, from 0.
        z: u32,
        /// The sample.
        found: f32,
    },
    /// Not one sample holds a height.
    #[error("{name}: no sample has data, so there is nothing to bake")]
    AllNoData {
        /// What the source calls itself.
        name: String,
    },
    /// The height range is empty, upside down or not finite.
    #[error(
        "the height range {low}..{high} m can't be used: it must reach from a lower to a higher \
         height, both within a million metres of 0"
    )]
    HeightRange {
        /// Its lower end in metres.
        low: f64,
        /// Its upper end in metres.
        high: f64,
    },
    /// The headroom is negative or not finite.
    #[error("a headroom of {found} m can't be used: it must be between 0 and a million metres")]
    Headroom {
        /// The headroom in metres.
        found: f64,
    },
    /// The distance between samples is out of bounds.
    #[error(
        "a spacing of {found} m between samples can't be used: it must be between 0.0001 and \
         1000000 m"
    )]
    Spacing {
        /// The spacing in metres.
        found: f64,
    },
    /// A density setting is out of bounds.
    #[error(transparent)]
    Density(#[from] DensitySettingsError),
    /// The folder whose densities should be made holds no terrain.
    #[error("{} is no terrain that can be used: {reason}", path.display())]
    Terrain {
        /// The folder.
        path: PathBuf,
        /// What is wrong with it.
        reason: Box<ManifestError>,
    },
    /// A tile of the terrain whose densities should be made can't be used.
    #[error("{} can't be used: {reason}; bake the terrain again", path.display())]
    Tile {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// The edits can't be baked into the terrain.
    #[error(transparent)]
    Edits {
        /// Why not.
        reason: EditLogError,
    },
    /// Another bake put its terrain there while densities of the old one were made.
    #[error("{} was replaced meanwhile, so nothing was changed; run it again", path.display())]
    Replaced {
        /// The folder.
        path: PathBuf,
    },
    /// The manifest that would be written couldn't be read again.
    #[error("the terrain can't be described: {reason}")]
    Manifest {
        /// What is wrong with it.
        reason: ManifestError,
    },
    /// Something stands where the terrain should go.
    #[error("{} exists already; choose another --out, or say --force to replace it", path.display())]
    OutputExists {
        /// The output folder.
        path: PathBuf,
    },
    /// Something that isn't a terrain stands where the terrain should go.
    #[error(
        "{} exists and is not a terrain, so --force doesn't remove it; choose another --out",
        path.display()
    )]
    OutputNotTerrain {
        /// The output folder.
        path: PathBuf,
    },
    /// The output's path names no folder that can be renamed to (`/`, `..`).
    #[error("{} can't be a terrain's folder; give --out a name of its own", path.display())]
    OutputName {
        /// The output folder.
        path: PathBuf,
    },
    /// A file or folder of the output can't be written.
    #[error("{} can't be written: {reason}; nothing was left behind", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        reason: std::io::Error,
    },
}
