//! What densities may be told.

use serde::{Deserialize, Serialize};
use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;
use thiserror::Error;

/// How densities follow from heights (after Cervin, *Adaptive Hardware-accelerated Terrain
/// Tessellation*, section 3.3); [`density`](crate::density) has the formulas.
///
/// A terrain's manifest keeps the settings that it was baked with; `tessera density` bakes them
/// anew.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "ecs", derive(bevy::reflect::Reflect))]
pub struct DensitySettings {
    /// The estimate of curvature.
    pub filter: DensityFilter,
    /// Scale of curvature before it is clamped to 0..1, 1 being the filter's own
    /// [scale](DensityFilter::scale). In [`GAIN_RANGE`](Self::GAIN_RANGE).
    pub gain: f32,
    /// Exponent applied to the clamped curvature; 1 stays 1, and a high exponent keeps triangles
    /// for the sharpest crests. In [`EXPONENT_RANGE`](Self::EXPONENT_RANGE).
    pub exponent: f32,
    /// Whether densities spread to their surroundings, as `filter_size` says, before the coarser
    /// levels are made. Without, the map shows what the filter sees and nothing else.
    pub preprocess: bool,
    /// Side of the square, in texels of level 0, whose largest density a texel takes. The square
    /// reaches `filter_size / 2` texels to every side, and so even sizes count as the next odd one: 1
    /// leaves densities where they are, 2 and 3 spread them by one texel. In [`FILTER_SIZE_RANGE`](Self::FILTER_SIZE_RANGE).
    pub filter_size: u32,
    /// How the texels along tiles' borders come about in the coarser levels.
    pub border: DensityBorder,
    /// With [`DensityBorder::PointSampled`], the level at which borders are about right: they take
    /// the largest density of a square with the side `filter_size * 2^lod_skip` (equation 3.8). In
    /// [`LOD_SKIP_RANGE`](Self::LOD_SKIP_RANGE).
    pub lod_skip: u32,
}

impl Default for DensitySettings {
    fn default() -> Self {
        Self {
            filter: DensityFilter::default(),
            gain: 1.0,
            exponent: 1.0,
            preprocess: true,
            filter_size: 1,
            border: DensityBorder::default(),
            lod_skip: 1,
        }
    }
}

impl DensitySettings {
    /// Gains that are accepted.
    pub const GAIN_RANGE: RangeInclusive<f32> = 0.001..=1000.0;
    /// Exponents that are accepted.
    pub const EXPONENT_RANGE: RangeInclusive<f32> = 0.05..=20.0;
    /// Filter sizes that are accepted, in texels.
    pub const FILTER_SIZE_RANGE: RangeInclusive<u32> = 1..=32;
    /// Skipped levels that are accepted.
    pub const LOD_SKIP_RANGE: RangeInclusive<u32> = 0..=4;
    /// The longest side that a border's square may have, in texels.
    pub const MAX_BORDER_SIZE: u32 = 64;

    /// Checks that every number lies in its range.
    ///
    /// # Errors
    /// For the first number that doesn't.
    pub fn validate(&self) -> Result<(), DensitySettingsError> {
        self.faults().next().map_or(Ok(()), Err)
    }

    /// Everything that is wrong with them.
    pub(crate) fn faults(&self) -> impl Iterator<Item = DensitySettingsError> {
        let check = |name, inside: bool, found: f64, low: f64, high: f64| {
            let error = DensitySettingsError::Range {
                name,
                found,
                low,
                high,
            };
            (!inside).then_some(error)
        };
        // NaN lies in no range.
        let real = |name, value: f32, range: RangeInclusive<f32>| {
            let (low, high) = (decimal(*range.start()), decimal(*range.end()));
            check(name, range.contains(&value), decimal(value), low, high)
        };
        let whole = |name, value: u32, range: RangeInclusive<u32>| {
            let (low, high) = ((*range.start()).into(), (*range.end()).into());
            check(name, range.contains(&value), value.into(), low, high)
        };
        let filter_size = whole("filter_size", self.filter_size, Self::FILTER_SIZE_RANGE);
        let lod_skip = whole("lod_skip", self.lod_skip, Self::LOD_SKIP_RANGE);
        let spreads = self.preprocess && self.border == DensityBorder::PointSampled;
        // Follows from two numbers, each of which has to make sense first.
        let is_told = filter_size.is_some() || lod_skip.is_some();
        let border =
            (!is_told && spreads && self.border_size() > Self::MAX_BORDER_SIZE).then(|| {
                DensitySettingsError::BorderSize {
                    filter_size: self.filter_size,
                    lod_skip: self.lod_skip,
                    found: self.border_size(),
                }
            });
        let gain = real("gain", self.gain, Self::GAIN_RANGE);
        let exponent = real("exponent", self.exponent, Self::EXPONENT_RANGE);
        [gain, exponent, filter_size, lod_skip, border]
            .into_iter()
            .flatten()
    }

    /// Side of the square whose largest density a texel on a tile's border takes, equation 3.8.
    #[must_use]
    pub fn border_size(&self) -> u32 {
        self.filter_size
            .saturating_mul(1_u32.checked_shl(self.lod_skip).unwrap_or(u32::MAX))
    }

    /// How many texels of level 0 densities spread to every side.
    pub(crate) fn reach(&self) -> u32 {
        if self.preprocess {
            self.filter_size / 2
        } else {
            0
        }
    }

    /// The same for texels on a tile's border.
    pub(crate) fn border_reach(&self) -> u32 {
        match self.border {
            DensityBorder::PointSampled if self.preprocess => self.border_size() / 2,
            _ => self.reach(),
        }
    }
}

/// The number as it was written: 0.1 and not 0.10000000149.
fn decimal(value: f32) -> f64 {
    value.to_string().parse().unwrap_or(f64::from(value))
}

/// The estimate of curvature that densities come from. All of them look at a sample and its eight
/// neighbours, and all count in sample spacings; see [`density::curvature`](crate::density::curvature)
/// for the formulas.
///
/// | filter | sees | is blind to | relative cost |
/// |---|---|---|---|
/// | `SecondOrder` | bends and walls, more on slopes than they deserve | symmetric saddles | 1 |
/// | `Gaussian` | peaks, pits, saddles | straight crests and valleys, walls | 1.4 |
/// | `Mean` | crests, valleys, peaks, pits | symmetric saddles, walls | 1.6 |
/// | `LaplaceBeltrami` | what `Mean` sees, from triangles | the same | 5.6 |
/// | `LaplaceBeltramiVoronoi` | the same, with the area that is nearest to each sample | the same | 7 |
/// | `Principal` | bends in any direction | walls | 2.2 |
///
/// Walls are steps of many spacings from one sample to the next, see
/// [`density`](crate::density#cliffs).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "ecs", derive(bevy::reflect::Reflect))]
#[non_exhaustive]
pub enum DensityFilter {
    /// The sum of the second differences, equation 2.19. The fastest, and too high on slopes.
    SecondOrder,
    /// Gaussian curvature, equation 2.27. A crest that runs straight has none.
    Gaussian,
    /// Mean curvature, equation 2.26.
    #[default]
    Mean,
    /// Mean curvature by the Laplace-Beltrami operator over the ring's triangles, equation 2.30.
    LaplaceBeltrami,
    /// The same over the ring's mixed Voronoi area, equations 2.31 and 2.32.
    LaplaceBeltramiVoronoi,
    /// The larger of the two principal curvatures, equation 2.34. A saddle whose two bends cancel
    /// out in the mean counts.
    Principal,
}

impl DensityFilter {
    /// All filters, in the order in which the tool lists them.
    pub const ALL: [Self; 6] = [
        Self::SecondOrder,
        Self::Gaussian,
        Self::Mean,
        Self::LaplaceBeltrami,
        Self::LaplaceBeltramiVoronoi,
        Self::Principal,
    ];

    /// The filter's name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::SecondOrder => "second-order",
            Self::Gaussian => "gaussian",
            Self::Mean => "mean",
            Self::LaplaceBeltrami => "laplace-beltrami",
            Self::LaplaceBeltramiVoronoi => "laplace-beltrami-voronoi",
            Self::Principal => "principal",
        }
    }
}

impl fmt::Display for DensityFilter {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.pad(self.name())
    }
}

impl FromStr for DensityFilter {
    type Err = DensitySettingsError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::ALL
            .into_iter()
            .find(|filter| filter.name() == text)
            .ok_or_else(|| DensitySettingsError::Filter {
                found: text.chars().take(40).collect(),
            })
    }
}

/// How the texels along tiles' borders come about in the coarser levels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "ecs", derive(bevy::reflect::Reflect))]
#[non_exhaustive]
pub enum DensityBorder {
    /// Like all others: the largest density of the ground that they cover. Where two levels meet,
    /// the view blends them, so nothing else is needed.
    #[default]
    None,
    /// The texels of a tile's first row and column take the density of the first of the texels
    /// that they cover, at all levels, so that a border is the same at all levels (section 3.3.3).
    /// What the other texels hold is lost there; `lod_skip` makes up for some of it.
    PointSampled,
}

impl DensityBorder {
    /// All schemes, in the order in which the tool lists them.
    pub const ALL: [Self; 2] = [Self::None, Self::PointSampled];

    /// The scheme's name on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::PointSampled => "point-sampled",
        }
    }
}

impl fmt::Display for DensityBorder {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.pad(self.name())
    }
}

impl FromStr for DensityBorder {
    type Err = DensitySettingsError;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        Self::ALL
            .into_iter()
            .find(|border| border.name() == text)
            .ok_or_else(|| DensitySettingsError::Border {
                found: text.chars().take(40).collect(),
            })
    }
}

/// Why density settings can't be used.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum DensitySettingsError {
    /// A number lies outside its range.
    #[error("the density's {name} is {found}, and has to lie in {low}..={high}")]
    Range {
        /// The field.
        name: &'static str,
        /// Its value.
        found: f64,
        /// The least that is accepted.
        low: f64,
        /// The most that is accepted.
        high: f64,
    },
    /// The border's square is too large.
    #[error(
        "a density filter size of {filter_size} with {lod_skip} skipped levels makes a border \
         filter of {found} texels, and at most {} are possible: lower one of the two",
        DensitySettings::MAX_BORDER_SIZE
    )]
    BorderSize {
        /// Side of the filter's square.
        filter_size: u32,
        /// Levels skipped.
        lod_skip: u32,
        /// Side of the border's square.
        found: u32,
    },
    /// No filter has that name.
    #[error(
        "there is no density filter {found:?}: it is one of second-order, gaussian, mean, \
         laplace-beltrami, laplace-beltrami-voronoi and principal"
    )]
    Filter {
        /// The name found, at most 40 characters of it.
        found: String,
    },
    /// No border scheme has that name.
    #[error("there is no density border {found:?}: it is none or point-sampled")]
    Border {
        /// The name found, at most 40 characters of it.
        found: String,
    },
}
