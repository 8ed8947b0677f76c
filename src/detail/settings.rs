//! What detail may be told.

#[cfg(feature = "ecs")]
use bevy::prelude::{ReflectComponent, ReflectDefault};
use std::ops::RangeInclusive;
use thiserror::Error;

/// Noise that is added to a terrain's stored heights, so that the ground has shape between its
/// samples; [`detail`](crate::detail) has the formulas.
///
/// The defaults make subtle rock of slopes: bumps of at most 40 cm, most of them below 10 cm,
/// and nothing on gentle ground.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "ecs",
    derive(bevy::prelude::Component, bevy::prelude::Reflect),
    reflect(Component, Default, Debug, Clone, PartialEq)
)]
pub struct TerrainDetail {
    /// The most that all octaves together raise or lower the ground, in metres. In
    /// [`AMPLITUDE_RANGE`](Self::AMPLITUDE_RANGE); 0 turns detail off.
    pub amplitude_m: f32,
    /// Wavelength of the coarsest octave, in metres. Each further octave has half of it. They are
    /// rounded to powers of two of lattice units, see
    /// [`DetailKernel::new`](super::DetailKernel::new). In
    /// [`WAVELENGTH_RANGE`](Self::WAVELENGTH_RANGE).
    pub wavelength_m: f32,
    /// How many octaves there are. In [`OCTAVES_RANGE`](Self::OCTAVES_RANGE).
    pub octaves: u32,
    /// Amplitude of an octave over that of the next coarser one. At 0.5 all octaves are as steep as
    /// each other: rock; less makes softer ground, more makes rubble. In
    /// [`GAIN_RANGE`](Self::GAIN_RANGE).
    pub gain: f32,
    /// Which of the noises that are alike in all of this. The same on all machines.
    pub seed: u32,
    /// How much of the detail the ground gets, by its stored shape.
    pub rule: DetailRule,
}

impl Default for TerrainDetail {
    fn default() -> Self {
        Self {
            amplitude_m: 0.4,
            wavelength_m: 6.0,
            octaves: 6,
            gain: 0.5,
            seed: 0,
            rule: DetailRule::Slope {
                from_deg: 15.0,
                to_deg: 40.0,
            },
        }
    }
}

/// How much of the detail the ground gets, by its stored shape: a weight from 0, none, to 1, all of
/// it, with a smoothstep in between.
///
/// The first two rules may run either way: with `from` above `to`, gentle or low ground gets the
/// detail.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "ecs", derive(bevy::prelude::Reflect))]
#[non_exhaustive]
pub enum DetailRule {
    /// All ground gets all of it.
    Everywhere,
    /// By the angle of the stored ground, 0 being level, in degrees from 0 to 90. The smoothstep
    /// runs in the squared sine of the angle.
    Slope {
        /// None up to this angle.
        from_deg: f32,
        /// All of it from this angle on.
        to_deg: f32,
    },
    /// By the stored height above the terrain's origin, in metres.
    Height {
        /// None up to this height.
        from_m: f32,
        /// All of it from this height on.
        to_m: f32,
    },
    /// By the inverse of the stored height, in metres: low ground is rough, and detail fades the
    /// higher the stored ground lies, as in Cantlay 2011, where detail is scaled by the inverse of
    /// the coarse displacement.
    InverseHeight {
        /// All of it up to this height. Below `none_m`.
        full_m: f32,
        /// None from this height on.
        none_m: f32,
    },
}

/// What is wrong with a [`TerrainDetail`].
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum TerrainDetailError {
    /// A number is out of its range.
    #[error("TerrainDetail::{name} is {value}: use a number from {least} to {most}")]
    Number {
        /// The field.
        name: &'static str,
        /// Its value.
        value: f32,
        /// The least that it may be.
        least: f32,
        /// The most that it may be.
        most: f32,
    },
    /// The two ends of a rule are as good as equal, which would make a wall.
    #[error("TerrainDetail::rule goes from {from} to {to}: set the two at least {least} apart")]
    RuleTooNarrow {
        /// Where the weight is 0.
        from: f32,
        /// Where the weight is 1.
        to: f32,
        /// The least distance between the two.
        least: f32,
    },
    /// The inverse height is full above where it is none.
    #[error(
        "TerrainDetail::rule.full_m is {full_m} and none_m {none_m}: use a none_m above full_m, or \
         DetailRule::Height for detail on high ground"
    )]
    RuleUpsideDown {
        /// Where the weight is 1.
        full_m: f32,
        /// Where the weight is 0.
        none_m: f32,
    },
}

impl TerrainDetail {
    /// Amplitudes that are accepted, in metres.
    pub const AMPLITUDE_RANGE: RangeInclusive<f32> = 0.0..=100.0;
    /// Wavelengths of the coarsest octave that are accepted, in metres.
    pub const WAVELENGTH_RANGE: RangeInclusive<f32> = 0.01..=10_000.0;
    /// Numbers of octaves that are accepted.
    pub const OCTAVES_RANGE: RangeInclusive<u32> = 1..=8;
    /// Gains that are accepted.
    pub const GAIN_RANGE: RangeInclusive<f32> = 0.0..=1.0;

    /// Checks that every number can be used.
    ///
    /// # Errors
    /// For the first that can't.
    pub fn validate(&self) -> Result<(), TerrainDetailError> {
        let mut first = Ok(());
        let _ = self.checked(|error| {
            if first.is_ok() {
                first = Err(error);
            }
        });
        first
    }

    /// These settings with every value that can't be used replaced by its default, each of which
    /// is given to `refused`.
    #[must_use = "the settings themselves stay as they are"]
    pub fn checked(&self, mut refused: impl FnMut(TerrainDetailError)) -> Self {
        let default = Self::default();
        let mut number = |name, value: f32, range: RangeInclusive<f32>, default: f32| {
            in_range(name, value, range).unwrap_or_else(|error| {
                refused(error);
                default
            })
        };
        let amplitude_m = number(
            "amplitude_m",
            self.amplitude_m,
            Self::AMPLITUDE_RANGE,
            default.amplitude_m,
        );
        let wavelength_m = number(
            "wavelength_m",
            self.wavelength_m,
            Self::WAVELENGTH_RANGE,
            default.wavelength_m,
        );
        let gain = number("gain", self.gain, Self::GAIN_RANGE, default.gain);
        let octaves = if Self::OCTAVES_RANGE.contains(&self.octaves) {
            self.octaves
        } else {
            refused(TerrainDetailError::Number {
                name: "octaves",
                value: self.octaves as f32,
                least: *Self::OCTAVES_RANGE.start() as f32,
                most: *Self::OCTAVES_RANGE.end() as f32,
            });
            default.octaves
        };
        let mut rule = self.rule;
        for error in self.rule.faults() {
            refused(error);
            rule = default.rule;
        }
        Self {
            amplitude_m,
            wavelength_m,
            octaves,
            gain,
            seed: self.seed,
            rule,
        }
    }
}

impl DetailRule {
    /// Angles that are accepted, in degrees.
    pub const ANGLE_RANGE: RangeInclusive<f32> = 0.0..=90.0;
    /// Heights that are accepted, in metres.
    pub const HEIGHT_RANGE: RangeInclusive<f32> = -100_000.0..=100_000.0;
    /// Two angles of a rule have to be this far apart, in degrees.
    pub const LEAST_DEG: f32 = 0.1;
    /// Two heights of a rule have to be this far apart, in metres.
    pub const LEAST_M: f32 = 0.1;

    /// Checks that every number can be used.
    ///
    /// # Errors
    /// For the first that can't.
    pub fn validate(self) -> Result<(), TerrainDetailError> {
        self.faults().next().map_or(Ok(()), Err)
    }

    /// Everything that is wrong with it: its two numbers, or where both are good what they make
    /// together.
    fn faults(self) -> impl Iterator<Item = TerrainDetailError> {
        let apart = |from: f32, to: f32, least| {
            let is_apart = (to - from).abs() >= least;
            (!is_apart).then_some(TerrainDetailError::RuleTooNarrow { from, to, least })
        };
        let (first, second, together) = match self {
            Self::Everywhere => (None, None, None),
            Self::Slope { from_deg, to_deg } => (
                in_range("rule.from_deg", from_deg, Self::ANGLE_RANGE).err(),
                in_range("rule.to_deg", to_deg, Self::ANGLE_RANGE).err(),
                apart(from_deg, to_deg, Self::LEAST_DEG),
            ),
            Self::Height { from_m, to_m } => (
                in_range("rule.from_m", from_m, Self::HEIGHT_RANGE).err(),
                in_range("rule.to_m", to_m, Self::HEIGHT_RANGE).err(),
                apart(from_m, to_m, Self::LEAST_M),
            ),
            Self::InverseHeight { full_m, none_m } => (
                in_range("rule.full_m", full_m, Self::HEIGHT_RANGE).err(),
                in_range("rule.none_m", none_m, Self::HEIGHT_RANGE).err(),
                if full_m > none_m {
                    Some(TerrainDetailError::RuleUpsideDown { full_m, none_m })
                } else {
                    apart(none_m, full_m, Self::LEAST_M)
                },
            ),
        };
        let together = together.filter(|_| first.is_none() && second.is_none());
        [first, second, together].into_iter().flatten()
    }
}

/// The value, if it lies in its range.
fn in_range(
    name: &'static str,
    value: f32,
    range: RangeInclusive<f32>,
) -> Result<f32, TerrainDetailError> {
    // Not a number is in no range.
    if range.contains(&value) {
        return Ok(value);
    }
    Err(TerrainDetailError::Number {
        name,
        value,
        least: *range.start(),
        most: *range.end(),
    })
}
