//! Terrains made of nothing: for tests, for demonstrations, and for those who have no data yet.
//!
//! A [`GeneratedSource`] is baked like any other [`HeightSource`]. The same settings give the same
//! heights, bit for bit, on every platform and however many threads work on them: all arithmetic is
//! that of IEEE 754, and random numbers are hashes of the seed and of what they are for.
//!
//! ```
//! use bevy_tessera::bake::generate::{GenerateSettings, GeneratedSource, GeneratorKind};
//! use bevy_tessera::bake::{BakeSettings, bake};
//!
//! # let folder = tempfile::tempdir()?;
//! # let out = folder.path().join("hills");
//! let mut settings = GenerateSettings::new(GeneratorKind::Hybrid, [257, 257]);
//! settings.seed = 7;
//! let mut source = GeneratedSource::new(settings)?;
//! bake(&mut source, &out, &BakeSettings::default(), &())?;
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod diamond_square;
mod hash;
mod noise;

use super::source::{HeightSource, SourceError};
use super::{MAX_HEIGHT_M, SPACING_RANGE_M};
use crate::terrain::check_size;
use diamond_square::Grid;
use noise::Noise;
use rayon::prelude::*;
use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;
use thiserror::Error;

/// The largest wavelength of a noise's features, in metres.
pub const MAX_WAVELENGTH_M: f64 = 1.0e9;
/// How many octaves a noise may have.
pub const OCTAVES_RANGE: RangeInclusive<u32> = 1..=32;
/// How smooth the ground may be told to be.
pub const ROUGHNESS_RANGE: RangeInclusive<f64> = 0.0..=4.0;
/// The most samples a side of a diamond-square terrain, which is held in memory: 1 GiB then, and a
/// quarter more while it is made.
pub const MAX_DIAMOND_SQUARE_SIZE: u32 = (1 << 14) + 1;

/// Samples of noise that are made at once (or a row of them, where that is more): enough to keep
/// all cores busy, few enough to stay in 4 MiB.
const BLOCK_SAMPLES: usize = 1 << 20;
/// Samples that one task makes.
const TASK_SAMPLES: usize = 1 << 12;

/// How a terrain is made.
///
/// Below, `r` is [`GenerateSettings::roughness`], `g = 2^-r`, and `n_o` is octave `o` of gradient
/// noise (OpenSimplex2S), from -1 to 1, whose wavelength is `wavelength_m / 2^o`. Sums are divided
/// by the most that they can be and scaled to [`GenerateSettings::relief_m`]; of the hybrid, the
/// few heights that lie beyond are squeezed in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[non_exhaustive]
pub enum GeneratorKind {
    /// The diamond-square algorithm (Fournier, Fussell and Carpenter, 1982): from four random
    /// corners, the middles of the squares become the mean of their four corners and
    /// `rand(±d)`, then the middles of the edges the mean of their ends, the middles of the squares
    /// beside them and `rand(±d)`; `d *= 2^-r`; and again, on squares of half the size.
    ///
    /// The largest features are as wide as the terrain. Edges have one square beside them, or with
    /// [`wrap`](GenerateSettings::wrap) the one at the opposite edge. Made on a square of 2^n + 1
    /// samples that covers the terrain and held in memory, 4 bytes a sample of that square.
    DiamondSquare,
    /// Fractional Brownian motion: the sum of `g^o n_o`. Rolling ground that is equally rough high
    /// and low.
    Fbm,
    /// Ridged multifractal (Musgrave in "Texturing and Modeling: A Procedural Approach", 2002,
    /// with his offset of 1 and gain of 2): the sum of `g^o s_o` with `s_o = w_o (1 - |n_o|)^2`,
    /// `w_0 = 1` and `w_o = min(2 s_(o-1), 1)`. Sharp crests with side ridges, and smooth valleys.
    Ridged,
    /// Crests among hills, after the "hybrid" of ridge noise and fBm in Cantlay, "DirectX 11
    /// Terrain Tessellation" (2011), whose detail is scaled by the inverse of the coarse
    /// displacement: `c + (1 - c) d`. The coarse displacement `c = (R + 1/2 + F) / 2` is the mean
    /// of the first four octaves as ridges, `R`, and of four octaves of another fBm, `F`, both
    /// divided by `G = 1 + g + g^2 + g^3`; the detail `d` is the fBm of the finer octaves, divided
    /// by `G`. Ridges are read at positions that each octave of `F` shifts by up to a fifth of
    /// its wavelength, which bends the crests.
    Hybrid,
}

impl GeneratorKind {
    /// All kinds, in the order in which the tool lists them.
    pub const ALL: [Self; 4] = [Self::DiamondSquare, Self::Fbm, Self::Ridged, Self::Hybrid];

    /// The name that [`FromStr`] reads: `diamond-square`, `fbm`, `ridged` or `hybrid`.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::DiamondSquare => "diamond-square",
            Self::Fbm => "fbm",
            Self::Ridged => "ridged",
            Self::Hybrid => "hybrid",
        }
    }
}

impl fmt::Display for GeneratorKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.as_str())
    }
}

impl FromStr for GeneratorKind {
    type Err = UnknownKind;

    fn from_str(name: &str) -> Result<Self, UnknownKind> {
        Self::ALL
            .into_iter()
            .find(|kind| kind.as_str() == name)
            .ok_or_else(|| UnknownKind {
                name: name.to_owned(),
            })
    }
}

/// No [`GeneratorKind`] has this name.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error(
    "{name:?} is no kind of terrain that can be generated: there are diamond-square, fbm, ridged \
     and hybrid"
)]
pub struct UnknownKind {
    name: String,
}

/// What a terrain is made from.
///
/// [`new`](Self::new) fills in what makes believable ground of a kind; change what you like.
#[derive(Clone, Debug, PartialEq)]
pub struct GenerateSettings {
    /// How it is made.
    pub kind: GeneratorKind,
    /// Samples in x (along a row) and z (rows): 2 to 16777216 a side, and no more than a terrain
    /// may have. For a noise that doesn't wrap, a larger size shows the same ground and more of it.
    pub size: [u32; 2],
    /// What tells this ground from others. Neighbouring seeds have nothing in common.
    pub seed: u64,
    /// Metres between neighbouring samples, within [`SPACING_RANGE_M`]. For a noise, a smaller
    /// spacing shows the same ground in more detail.
    pub spacing_m: f64,
    /// Metres between which heights spread: they lie from 0 to here, up to a million metres. A
    /// diamond-square terrain (the square that it is cut from) reaches both ends, a noise seldom
    /// comes near them.
    pub relief_m: f64,
    /// Metres that the largest features of a noise are wide: from twice the spacing to
    /// [`MAX_WAVELENGTH_M`]. Diamond-square ignores it.
    pub wavelength_m: f64,
    /// How many noises, each of half the wavelength of the one before, are added up, within
    /// [`OCTAVES_RANGE`]. Those finer than two samples are left out, and so it costs nothing to
    /// have plenty. Diamond-square ignores it.
    pub octaves: u32,
    /// How fast features become lower as they become smaller, within [`ROUGHNESS_RANGE`]: each
    /// half as wide is `2^-roughness` as high. This is what papers call the roughness constant,
    /// and yet the larger it is, the *smoother* is the ground.
    pub roughness: f64,
    /// Whether opposite edges are equal and the ground goes on smoothly from one to the other, so
    /// that copies can be laid side by side. A diamond-square terrain then has 2^n + 1 samples on
    /// both sides; a noise blends into its own repetition near the far edges, up to two
    /// wavelengths of each octave from them.
    pub wrap: bool,
}

impl GenerateSettings {
    /// Believable ground of a kind: samples a metre apart, features of a kilometre that rise at
    /// most 160 m (ridged), 200 m (hybrid) or 240 m (fbm), a roughness of 1.1. Diamond-square, whose features are as wide as the
    /// terrain, rises 15 m for every hundred samples of the longer side.
    #[must_use]
    pub fn new(kind: GeneratorKind, size: [u32; 2]) -> Self {
        let relief_m = match kind {
            GeneratorKind::DiamondSquare => 0.15 * f64::from(size[0].max(size[1])),
            GeneratorKind::Fbm => 240.0,
            GeneratorKind::Ridged => 160.0,
            GeneratorKind::Hybrid => 200.0,
        };
        Self {
            kind,
            size,
            seed: 0,
            spacing_m: 1.0,
            relief_m,
            wavelength_m: 1024.0,
            octaves: 16,
            roughness: 1.1,
            wrap: false,
        }
    }

    fn name(&self) -> String {
        let what = match self.kind {
            GeneratorKind::DiamondSquare => "terrain",
            _ => "noise",
        };
        format!("{} {what}, seed {}", self.kind, self.seed)
    }

    /// Checks every parameter.
    ///
    /// # Errors
    /// For the first that is outside its range.
    pub fn validate(&self) -> Result<(), GenerateError> {
        check_size(self.size).map_err(|_| GenerateError::Size { found: self.size })?;
        if self.kind == GeneratorKind::DiamondSquare {
            if self.size.iter().any(|&side| side > MAX_DIAMOND_SQUARE_SIZE) {
                return Err(GenerateError::TooLarge { found: self.size });
            }
            let [width, height] = self.size;
            if self.wrap && !(width == height && (width - 1).is_power_of_two()) {
                return Err(GenerateError::Wrap { found: self.size });
            }
        }
        if !SPACING_RANGE_M.contains(&self.spacing_m) {
            return Err(GenerateError::Spacing {
                found: self.spacing_m,
            });
        }
        if !(0.0..=MAX_HEIGHT_M).contains(&self.relief_m) {
            return Err(GenerateError::Relief {
                found: self.relief_m,
            });
        }
        if !ROUGHNESS_RANGE.contains(&self.roughness) {
            return Err(GenerateError::Roughness {
                found: self.roughness,
            });
        }
        if self.kind != GeneratorKind::DiamondSquare {
            let shortest = 2.0 * self.spacing_m;
            if !(shortest..=MAX_WAVELENGTH_M).contains(&self.wavelength_m) {
                return Err(GenerateError::Wavelength {
                    found: self.wavelength_m,
                    shortest,
                });
            }
            if !OCTAVES_RANGE.contains(&self.octaves) {
                return Err(GenerateError::Octaves {
                    found: self.octaves,
                });
            }
        }
        Ok(())
    }
}

impl Default for GenerateSettings {
    /// The hybrid, a kilometre wide.
    fn default() -> Self {
        Self::new(GeneratorKind::Hybrid, [1025, 1025])
    }
}

/// Why a terrain can't be generated: a sentence that names the parameter and its range.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum GenerateError {
    /// Too few or too many samples.
    #[error(
        "a size of {} x {} samples can't be used: a terrain has 2 to 16777216 samples a side and \
         at most 1048576 tiles of 128 x 128",
        found[0],
        found[1]
    )]
    Size {
        /// Samples in x and z.
        found: [u32; 2],
    },
    /// More samples than diamond-square holds in memory.
    #[error(
        "a size of {} x {} samples can't be used: diamond-square holds the whole terrain in memory \
         and takes at most {MAX_DIAMOND_SQUARE_SIZE} samples a side; fbm, ridged and hybrid take \
         more",
        found[0],
        found[1]
    )]
    TooLarge {
        /// Samples in x and z.
        found: [u32; 2],
    },
    /// A diamond-square terrain of this size can't wrap.
    #[error(
        "a size of {} x {} samples can't wrap: a diamond-square terrain that does has 2^n + 1 \
         samples on both sides alike, from 2 to {MAX_DIAMOND_SQUARE_SIZE} (257, 513, 1025); fbm, \
         ridged and hybrid wrap at any size",
        found[0],
        found[1]
    )]
    Wrap {
        /// Samples in x and z.
        found: [u32; 2],
    },
    /// The distance between samples is out of bounds.
    #[error(
        "a spacing of {found:?} m between samples can't be used: it must be between 0.0001 and \
         1000000 m"
    )]
    Spacing {
        /// The spacing in metres.
        found: f64,
    },
    /// The relief is out of bounds.
    #[error("a relief of {found:?} m can't be used: it must be between 0 and 1000000 m")]
    Relief {
        /// The relief in metres.
        found: f64,
    },
    /// The wavelength is out of bounds.
    #[error(
        "a wavelength of {found:?} m can't be used: it must be between twice the spacing, \
         {shortest:?} m, and 1000000000 m"
    )]
    Wavelength {
        /// The wavelength in metres.
        found: f64,
        /// The shortest at this spacing.
        shortest: f64,
    },
    /// The number of octaves is out of bounds.
    #[error("{found} octaves can't be used: there must be between 1 and 32")]
    Octaves {
        /// How many octaves.
        found: u32,
    },
    /// The roughness is out of bounds.
    #[error("a roughness of {found:?} can't be used: it must be between 0 and 4")]
    Roughness {
        /// The roughness.
        found: f64,
    },
}

/// What heights are read from.
enum Ground {
    Noise(Noise),
    /// Made when it is first read.
    DiamondSquare(Option<(Grid, [f32; 2])>),
}

/// A generated terrain, to be baked.
///
/// A noise is made while it is read and takes 4 MiB (or a row of samples, where that is more),
/// anew at every reading; diamond-square is made at the first reading and kept. All cores work on
/// both.
pub struct GeneratedSource {
    settings: GenerateSettings,
    ground: Ground,
    next_row: u32,
    /// Rows of noise made ahead, from `block_row` on.
    block: Vec<f32>,
    block_row: u32,
}

impl GeneratedSource {
    /// A terrain made from `settings`. Cheap: heights are made when they are read.
    ///
    /// # Errors
    /// Where a setting is outside its range; see [`GenerateError`].
    pub fn new(settings: GenerateSettings) -> Result<Self, GenerateError> {
        settings.validate()?;
        let ground = match settings.kind {
            GeneratorKind::DiamondSquare => Ground::DiamondSquare(None),
            _ => Ground::Noise(Noise::new(&settings)),
        };
        Ok(Self {
            settings,
            ground,
            next_row: 0,
            block: Vec::new(),
            block_row: 0,
        })
    }

    /// What it is made from.
    #[must_use]
    pub fn settings(&self) -> &GenerateSettings {
        &self.settings
    }

    /// Makes the rows from `first` on, as many as make a block.
    fn fill_block(noise: &Noise, settings: &GenerateSettings, first: u32, block: &mut Vec<f32>) {
        let [width, height] = settings.size;
        let rows = (BLOCK_SAMPLES as u32 / width).clamp(1, height - first);
        // A block's samples fit a usize: they are 2^20, or one row.
        block.resize(rows as usize * width as usize, 0.0);
        let relief_m = settings.relief_m as f32;
        block
            .par_chunks_mut(TASK_SAMPLES)
            .enumerate()
            .for_each(|(task, samples)| {
                let start = task * TASK_SAMPLES;
                let mut x = (start % width as usize) as u32;
                let mut z = first + (start / width as usize) as u32;
                for sample in samples {
                    *sample = relief_m * noise.at(x, z);
                    x += 1;
                    if x == width {
                        (x, z) = (0, z + 1);
                    }
                }
            });
    }

    /// The grid and its range.
    fn grid(settings: &GenerateSettings) -> Result<(Grid, [f32; 2]), SourceError> {
        let longest = settings.size[0].max(settings.size[1]) - 1;
        let cells = longest.next_power_of_two() as usize;
        let gain = libm::exp2(-settings.roughness);
        let grid = Grid::generate(cells, settings.seed, gain, settings.wrap).map_err(|_| {
            let mebibytes = (cells * cells) >> 18;
            let reason = format!("it takes {mebibytes} MiB of memory and a quarter more");
            SourceError::new(settings.name(), reason)
        })?;
        let range = grid.range();
        Ok((grid, range))
    }
}

impl fmt::Debug for GeneratedSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("GeneratedSource")
            .field("settings", &self.settings)
            .field("next_row", &self.next_row)
            .finish_non_exhaustive()
    }
}

impl HeightSource for GeneratedSource {
    fn name(&self) -> String {
        self.settings.name()
    }

    fn size(&self) -> [u32; 2] {
        self.settings.size
    }

    fn spacing_m(&self) -> Option<f64> {
        Some(self.settings.spacing_m)
    }

    fn may_lack_data(&self) -> bool {
        false
    }

    fn rewind(&mut self) -> Result<(), SourceError> {
        self.next_row = 0;
        Ok(())
    }

    fn skip_rows(&mut self, rows: u32) -> Result<(), SourceError> {
        self.next_row = self.next_row.saturating_add(rows);
        Ok(())
    }

    fn read_row(&mut self, row: &mut [f32]) -> Result<(), SourceError> {
        let [width, height] = self.settings.size;
        let width = width as usize;
        let z = self.next_row;
        if z >= height {
            return Err(SourceError::new(self.name(), "it has no more rows"));
        }
        if row.len() != width {
            let reason = format!("a row has {width} samples and not {}", row.len());
            return Err(SourceError::new(self.name(), reason));
        }
        match &mut self.ground {
            Ground::Noise(noise) => {
                let made = (self.block.len() / width) as u32;
                if !(self.block_row..self.block_row + made).contains(&z) {
                    Self::fill_block(noise, &self.settings, z, &mut self.block);
                    self.block_row = z;
                }
                let start = (z - self.block_row) as usize * width;
                row.copy_from_slice(&self.block[start..][..width]);
            }
            Ground::DiamondSquare(made) => {
                if made.is_none() {
                    *made = Some(Self::grid(&self.settings)?);
                }
                if let Some((grid, [low, high])) = made {
                    let low = f64::from(*low);
                    let span = f64::from(*high) - low;
                    // Two corners can be all there is, and equal.
                    let scale = if span > 0.0 {
                        self.settings.relief_m / span
                    } else {
                        0.0
                    };
                    for (sample, &height) in row.iter_mut().zip(grid.row(z as usize)) {
                        *sample = ((f64::from(height) - low) * scale) as f32;
                    }
                }
            }
        }
        self.next_row += 1;
        Ok(())
    }
}
