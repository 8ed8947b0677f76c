//! Detail of one terrain, ready to be evaluated.

use super::noise::{self, TURN_LOG2, TURNS};
use super::{DetailRule, TerrainDetail};
use crate::density::DensityFilter;
use crate::lattice::{Lattice, ONE};
use crate::tessellate::DENSITY_ONE;
use glam::{IVec2, Vec2};

/// Octaves that there is room for.
pub const DETAIL_OCTAVES: usize = 8;

/// [`DetailKernel::rule`]: the weight is 1.
pub const DETAIL_EVERYWHERE: u32 = 0;
/// [`DetailKernel::rule`]: by the squared sine of the slope.
pub const DETAIL_SLOPE: u32 = 1;
/// [`DetailKernel::rule`]: by the height in metres.
pub const DETAIL_HEIGHT: u32 = 2;

/// The finest wavelength, as a power of two lattice units.
const FINEST_LOG2: u32 = 2;
/// The coarsest.
const COARSEST_LOG2: u32 = 20;

/// An octave of noise; WGSL `DetailOctave`.
///
/// The noise lives in square cells on a lattice of its own, onto which a point `(x, z)` is turned
/// and shifted: `(a x - b z, b x + a z) + offset`, with `(a, b)` the octave's `turn`. All of that is
/// in integers that wrap, and so are the cells: those of the last column have the first one as their
/// neighbour. An octave hence repeats after `2^32 / 65` lattice units, in a direction of its own;
/// the sum of two octaves doesn't.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "render", derive(bytemuck::Pod, bytemuck::Zeroable))]
#[repr(C)]
pub struct DetailOctave {
    /// What points are multiplied by, as complex numbers; of length 65.
    pub turn: [i32; 2],
    /// What is then added, so that octaves don't all vanish at the terrain's first sample.
    pub offset: [u32; 2],
    /// Side of a cell in turned units, as a power of two: 6 more than the wavelength's in lattice
    /// units.
    pub cell_shift: u32,
    /// One over the side of a cell; exact.
    pub per_cell: f32,
    /// The most that the octave raises or lowers the ground, in metres.
    pub amplitude_m: f32,
    /// What the hash of a cell's corner is told besides the corner; from seed and octave.
    pub salt: u32,
}

/// Detail of one terrain, ready to be evaluated; WGSL `Detail`.
///
/// The same in Rust and WGSL but for rounding: the GPU may fuse multiplications with additions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "render", derive(bytemuck::Pod, bytemuck::Zeroable))]
#[repr(C)]
pub struct DetailKernel {
    /// The octaves, coarse ones first; those from [`octave_count`](Self::octave_count) on are zero.
    pub octaves: [DetailOctave; DETAIL_OCTAVES],
    /// How many of them there are, 0 where detail is off.
    pub octave_count: u32,
    /// One of [`DETAIL_EVERYWHERE`], [`DETAIL_SLOPE`] and [`DETAIL_HEIGHT`].
    pub rule: u32,
    /// Where the rule's weight is 0: squared sine or metres.
    pub rule_from: f32,
    /// One over the way from there to where the weight is 1.
    pub rule_rate: f32,
    /// Metres per lattice unit.
    pub unit_m: f32,
    /// The density, 1 being all triangles, that detail of weight 1 needs; may be above 1.
    pub density_per_weight: f32,
    /// The most that all octaves raise or lower the ground, in metres.
    pub amplitude_m: f32,
    /// Nothing; makes the struct a multiple of 16 bytes long.
    pub unused: u32,
}

impl DetailKernel {
    /// The vertex spacing that fades nothing, for [`height_m`](Self::height_m): a lattice unit.
    /// For queries and colliders.
    pub const EVERYTHING: i32 = 0;

    /// The detail of a terrain on `lattice` whose samples of level 0 stand `spacing_m` metres apart.
    /// Settings that can't be used count as their defaults.
    ///
    /// Wavelengths become 64/65 of powers of two of lattice units: the nearest one for the coarsest
    /// octave, and half as much for each further one. The coarsest is brought to within 4 and 2^20
    /// units; octaves finer than 4 units are dropped. The amplitudes of those that are left make up
    /// [`amplitude_m`](TerrainDetail::amplitude_m), exactly.
    #[must_use]
    pub fn new(settings: &TerrainDetail, lattice: &Lattice, spacing_m: f64) -> Self {
        let settings = settings.checked(|_| {});
        let unit_m = lattice.unit_m(spacing_m);
        let wanted_log2 = libm::log2(f64::from(settings.wavelength_m) / unit_m);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "clamped; not a number becomes 0 and is clamped too"
        )]
        let coarsest_log2 = (libm::round(wanted_log2) as u32).clamp(FINEST_LOG2, COARSEST_LOG2);
        let (rule, rule_from, rule_rate) = rule(settings.rule);
        #[expect(clippy::cast_possible_truncation, reason = "a float is enough")]
        let mut kernel = Self {
            rule,
            rule_from,
            rule_rate,
            unit_m: unit_m as f32,
            ..Self::default()
        };
        if settings.amplitude_m == 0.0 {
            return kernel;
        }
        kernel.amplitude_m = settings.amplitude_m;
        kernel.octave_count = settings.octaves.min(coarsest_log2 - FINEST_LOG2 + 1);
        let amplitudes_m = amplitudes_m(settings.amplitude_m, settings.gain, kernel.octave_count);
        let mut salt = noise::mix(settings.seed ^ 0x7e55_e7a0);
        let mut turn_squared = 0.0;
        for (index, octave) in kernel
            .octaves
            .iter_mut()
            .take(kernel.octave_count as usize)
            .enumerate()
        {
            let mut next = || {
                salt = noise::mix(salt.wrapping_add(0x9e37_79b9));
                salt
            };
            #[expect(clippy::cast_possible_truncation, reason = "below 8")]
            let cell_shift = coarsest_log2 - index as u32 + TURN_LOG2;
            *octave = DetailOctave {
                turn: TURNS[index],
                offset: [next(), next()],
                cell_shift,
                per_cell: 1.0 / (1_u32 << cell_shift) as f32,
                amplitude_m: amplitudes_m[index],
                salt: next(),
            };
            let wavelength_m = octave.wavelength_units() * unit_m;
            let apart_m = spacing_m.min(wavelength_m / 4.0);
            let wave = std::f64::consts::TAU / wavelength_m;
            turn_squared += (f64::from(octave.amplitude_m) * wave * wave * apart_m).powi(2);
        }
        #[expect(clippy::cast_possible_truncation, reason = "a float is enough")]
        let turn = turn_squared.sqrt() as f32;
        kernel.density_per_weight = DensityFilter::Mean.scale() * turn;
        kernel
    }

    /// The octaves that there are, coarse ones first.
    #[must_use]
    pub fn octaves(&self) -> &[DetailOctave] {
        &self.octaves[..(self.octave_count as usize).min(DETAIL_OCTAVES)]
    }

    /// The most that detail raises or lowers the ground anywhere, in metres.
    #[must_use]
    pub fn bound_m(&self) -> f32 {
        self.amplitude_m
    }

    /// Wavelength of the finest octave, in metres; `None` where detail is off.
    #[must_use]
    pub fn finest_wavelength_m(&self) -> Option<f32> {
        let octave = self.octaves().last()?;
        #[expect(clippy::cast_possible_truncation, reason = "a float is enough")]
        let units = octave.wavelength_units() as f32;
        Some(units * self.unit_m)
    }

    /// `log2` of a vertex spacing, counted in lattice units, in 16.16 fixed point: what
    /// [`height_m`](Self::height_m) takes for a mesh whose vertices stand `spacing_m` metres apart.
    #[must_use]
    pub fn finest_log2(&self, spacing_m: f32) -> i32 {
        #[expect(clippy::cast_possible_truncation, reason = "saturates, as it should")]
        let log2 = (libm::log2f(spacing_m / self.unit_m) * ONE as f32) as i32;
        log2
    }

    /// How much of an octave is left, 0..=1, where vertices stand `2^finest_log2` lattice units
    /// apart (16.16 fixed point).
    ///
    /// All of it from four vertices a wavelength on, nothing up to two, which could show no more
    /// than its flicker; linear in the logarithm in between.
    #[must_use]
    pub fn fade(octave: &DetailOctave, finest_log2: i32) -> f32 {
        let wave_log2 = octave.cell_shift.cast_signed() - TURN_LOG2.cast_signed();
        // Beyond 64 either way nothing changes, and nothing can overflow.
        let finest_log2 = finest_log2.clamp(-64 * ONE, 64 * ONE);
        let above = (wave_log2 - 1) * ONE - finest_log2;
        above.clamp(0, ONE) as f32 * (1.0 / ONE as f32)
    }

    /// What detail adds to the stored height at `p`, in metres; at most
    /// [`bound_m`](Self::bound_m) either way.
    ///
    /// `weight` is the [rule's](Self::weight), 0..=1. `finest_log2` is the spacing of vertices at
    /// `p`, as `log2` of lattice units in 16.16 fixed point; octaves that they can't show
    /// [fade out](Self::fade). Both have to follow from point and view alone.
    #[must_use]
    pub fn height_m(&self, p: IVec2, weight: f32, finest_log2: i32) -> f32 {
        let mut sum_m = 0.0;
        for octave in self.octaves() {
            let fade = Self::fade(octave, finest_log2);
            // All others are finer still.
            if fade == 0.0 {
                break;
            }
            sum_m += octave.amplitude_m * fade * noise::noise(octave, p).x;
        }
        sum_m * weight
    }

    /// The slope of [`height_m`](Self::height_m) in x and z, rise per metre.
    ///
    /// That `weight` and `finest_log2` change from place to place doesn't count: they do so over
    /// many wavelengths.
    #[must_use]
    pub fn gradient(&self, p: IVec2, weight: f32, finest_log2: i32) -> Vec2 {
        let mut sum = Vec2::ZERO;
        for octave in self.octaves() {
            let fade = Self::fade(octave, finest_log2);
            if fade == 0.0 {
                break;
            }
            let noise = noise::noise(octave, p);
            sum += octave.amplitude_m * fade * Vec2::new(noise.y, noise.z);
        }
        sum * (weight / self.unit_m)
    }

    /// The rule: how much detail ground gets, 0..=1, by its stored height in metres and its stored
    /// slope in x and z, rise per metre.
    #[must_use]
    pub fn weight(&self, height_m: f32, gradient: Vec2) -> f32 {
        let measure = match self.rule {
            // The squared sine of the angle, which needs no arctangent.
            DETAIL_SLOPE => 1.0 - 1.0 / (1.0 + (gradient.x * gradient.x + gradient.y * gradient.y)),
            DETAIL_HEIGHT => height_m,
            _ => return 1.0,
        };
        let t = ((measure - self.rule_from) * self.rule_rate).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    }

    /// The least density of ground with detail of this weight, in units of [`DENSITY_ONE`]; the
    /// formula stands in [`detail`](crate::detail#density).
    #[must_use]
    pub fn density(&self, weight: f32) -> u32 {
        let density = (weight * self.density_per_weight).clamp(0.0, 1.0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "0..=DENSITY_ONE"
        )]
        let fixed = (density * DENSITY_ONE as f32).ceil() as u32;
        fixed
    }
}

impl DetailOctave {
    /// Length of a wave in lattice units.
    fn wavelength_units(&self) -> f64 {
        f64::from(1_u32 << self.cell_shift) / f64::from(noise::TURN_LENGTH)
    }
}

/// A rule as the kernel has it: its kind, where the weight is 0, and one over the way to 1.
fn rule(rule: DetailRule) -> (u32, f32, f32) {
    let (kind, from, to) = match rule {
        DetailRule::Everywhere => return (DETAIL_EVERYWHERE, 0.0, 0.0),
        DetailRule::Slope { from_deg, to_deg } => {
            let squared_sine = |degrees: f32| libm::sin(f64::from(degrees).to_radians()).powi(2);
            (DETAIL_SLOPE, squared_sine(from_deg), squared_sine(to_deg))
        }
        DetailRule::Height { from_m, to_m } => (DETAIL_HEIGHT, from_m.into(), to_m.into()),
        DetailRule::InverseHeight { full_m, none_m } => {
            (DETAIL_HEIGHT, none_m.into(), full_m.into())
        }
    };
    #[expect(clippy::cast_possible_truncation, reason = "a float is enough")]
    let (from, rate) = (from as f32, (1.0 / (to - from)) as f32);
    (kind, from, rate)
}

/// Amplitudes that each are `gain` times the one before and add up to `total_m`, whatever the order
/// that they are added in.
fn amplitudes_m(total_m: f32, gain: f32, count: u32) -> [f32; DETAIL_OCTAVES] {
    let mut amplitudes_m = [0.0; DETAIL_OCTAVES];
    let gain = f64::from(gain);
    let powers = || std::iter::successors(Some(1.0), |power| Some(power * gain));
    let first_m = f64::from(total_m) / powers().take(count as usize).sum::<f64>();
    // All but the first are whole multiples of the last bit of the total, and so the first is too:
    // no sum of some of them is ever rounded.
    let step_m = f64::from(total_m - total_m.next_down());
    let mut rest_m = f64::from(total_m);
    for (amplitude_m, power) in amplitudes_m
        .iter_mut()
        .zip(powers())
        .take(count as usize)
        .skip(1)
    {
        let whole_m = libm::floor(first_m * power / step_m) * step_m;
        rest_m -= whole_m;
        #[expect(clippy::cast_possible_truncation, reason = "exact")]
        let exact_m = whole_m as f32;
        *amplitude_m = exact_m;
    }
    #[expect(clippy::cast_possible_truncation, reason = "exact")]
    let exact_m = rest_m as f32;
    amplitudes_m[0] = exact_m;
    amplitudes_m
}
