//! Fractal noises: pointwise functions of position and seed. Their formulas are in
//! [`GeneratorKind`]'s documentation.

use super::hash::fold;
use super::{GenerateSettings, GeneratorKind};
use fastnoise_lite::{FastNoiseLite, NoiseType};

/// The hybrid's octaves of ridges.
const COARSE_OCTAVES: u32 = 4; // GeneratorKind::Hybrid says so.
/// How far crests are bent, in wavelengths of what bends them.
const BEND: f64 = 0.2;
/// Wavelengths over which a noise is blended into its repetition where the terrain wraps.
const BLEND_WAVELENGTHS: f64 = 2.0;
/// From how far out, of 1, values are squeezed so as to stay within their range. Squeezed ground
/// loses its detail, and so few values may come that far.
const SHOULDER: f32 = 0.9;

/// One octave of gradient noise.
struct Octave {
    noise: FastNoiseLite,
    /// In samples.
    wavelength: f64,
    /// What takes a position in samples to one in the noise's cells: a turn, a scale and a shift.
    /// Every octave is turned and shifted differently, so that their lattices don't line up.
    axis: [f64; 2],
    offset: [f64; 2],
    /// `g^o`
    amplitude: f32,
    /// The period in samples in x and z, where the terrain wraps.
    period: Option<[u32; 2]>,
}

impl Octave {
    fn new(
        settings: &GenerateSettings,
        key: u64,
        wavelength: f64,
        axis: [f64; 2],
        amplitude: f32,
    ) -> Self {
        let mut noise = FastNoiseLite::with_seed(fold(key, 0) as i32);
        noise.set_noise_type(Some(NoiseType::OpenSimplex2S));
        noise.set_frequency(Some(1.0));
        // Up to 65536 cells: far apart, and yet positions keep all their digits.
        let offset = |at| (fold(key, at) >> 28) as f64 / (1_u64 << 20) as f64;
        Self {
            noise,
            wavelength,
            axis: axis.map(|part| part / wavelength),
            offset: [offset(1), offset(2)],
            amplitude,
            period: settings
                .wrap
                .then(|| settings.size.map(|samples| samples - 1)),
        }
    }

    /// The noise at a sample, from -1 to 1, read `shift` samples from there.
    fn at(&self, x: u32, z: u32, shift: [f64; 2]) -> f32 {
        let Some(period) = self.period else {
            return self
                .plain(f64::from(x) + shift[0], f64::from(z) + shift[1])
                .clamp(-1.0, 1.0);
        };
        let columns = Copies::new(x, period[0], self.wavelength);
        let rows = Copies::new(z, period[1], self.wavelength);
        let mut sum = 0.0;
        for (z, row_weight) in rows.iter() {
            for (x, column_weight) in columns.iter() {
                sum += row_weight * column_weight * self.plain(x + shift[0], z + shift[1]);
            }
        }
        sum.clamp(-1.0, 1.0)
    }

    fn plain(&self, x: f64, z: f64) -> f32 {
        let [cos, sin] = self.axis;
        self.noise.get_noise_2d(
            cos * x - sin * z + self.offset[0],
            sin * x + cos * z + self.offset[1],
        )
    }
}

/// Where the noise is read for a column (or row) of a terrain that wraps, and what each reading
/// weighs: the column itself, and near the far edge the one a period before it, which takes over
/// by the edge. The squares of the weights add up to 1, so that the ground is as rough there as
/// elsewhere.
struct Copies {
    at: [(f64, f32); 2],
    count: usize,
}

impl Copies {
    fn new(index: u32, period: u32, wavelength: f64) -> Self {
        let blend = (BLEND_WAVELENGTHS * wavelength).min(f64::from(period));
        // The far edge is the near one.
        let at = f64::from(index % period);
        let into = (at - (f64::from(period) - blend)) / blend;
        if into <= 0.0 {
            return Self {
                at: [(at, 1.0); 2],
                count: 1,
            };
        }
        let there = into * into * into * (into * (into * 6.0 - 15.0) + 10.0);
        let here = 1.0 - there;
        let length = (here * here + there * there).sqrt();
        Self {
            at: [
                (at, (here / length) as f32),
                (at - f64::from(period), (there / length) as f32),
            ],
            count: 2,
        }
    }

    fn iter(&self) -> impl Iterator<Item = (f64, f32)> {
        self.at.into_iter().take(self.count)
    }
}

/// A height as a function of column and row.
pub(super) struct Noise {
    shape: Shape,
    octaves: Vec<Octave>,
    /// The sum of all amplitudes.
    sum: f32,
}

enum Shape {
    Fbm,
    Ridged,
    Hybrid {
        /// Of the noise's octaves, how many are ridges; the finer ones are fBm.
        ridges: usize,
        /// The sum of the ridges' amplitudes.
        sum: f32,
        /// fBm as coarse as the ridges, which also bends the crests.
        hills: Vec<Octave>,
    },
}

impl Noise {
    pub(super) fn new(settings: &GenerateSettings) -> Self {
        let octaves = octaves(settings, 0, settings.octaves);
        let coarse = COARSE_OCTAVES.min(settings.octaves);
        let shape = match settings.kind {
            GeneratorKind::Ridged => Shape::Ridged,
            GeneratorKind::Hybrid => Shape::Hybrid {
                ridges: octaves.len().min(coarse as usize),
                sum: amplitudes(settings, coarse).sum(),
                hills: self::octaves(settings, 1, coarse),
            },
            _ => Shape::Fbm,
        };
        Self {
            shape,
            octaves,
            sum: amplitudes(settings, settings.octaves).sum(),
        }
    }

    /// The height of a sample, from 0 to 1.
    pub(super) fn at(&self, x: u32, z: u32) -> f32 {
        match &self.shape {
            Shape::Fbm => (0.5 + 0.5 * fbm(&self.octaves, x, z) / self.sum).clamp(0.0, 1.0),
            Shape::Ridged => (ridged(&self.octaves, x, z, [0.0; 2]) / self.sum).clamp(0.0, 1.0),
            Shape::Hybrid { ridges, sum, hills } => {
                let (ridges, detail) = self.octaves.split_at(*ridges);
                let (hill, bend) = bent_fbm(hills, x, z);
                let coarse = 0.25 + 0.5 * (ridged(ridges, x, z, bend) + hill) / sum;
                let detail = fbm(detail, x, z) / sum;
                squeeze(coarse + (1.0 - coarse).max(0.0) * detail)
            }
        }
    }
}

/// `g^o` for the first `count` octaves.
fn amplitudes(settings: &GenerateSettings, count: u32) -> impl Iterator<Item = f32> {
    let roughness = settings.roughness;
    (0..count).map(move |octave| libm::exp2(-roughness * f64::from(octave)) as f32)
}

/// The first `count` octaves of one of the independent noises, `stream`, that a kind needs.
///
/// What is finer than two samples would only be a hiss and is left out. It counts in the sums of
/// amplitudes all the same, so that a smaller spacing shows the same ground in more detail.
fn octaves(settings: &GenerateSettings, stream: u64, count: u32) -> Vec<Octave> {
    let key = fold(settings.seed, stream);
    let mut axis = [1.0, 0.0];
    let mut octaves = Vec::new();
    for (number, amplitude) in (0..count).zip(amplitudes(settings, count)) {
        let wavelength = settings.wavelength_m / settings.spacing_m / (1_u64 << number) as f64;
        if wavelength < 2.0 {
            break;
        }
        let key = fold(key, u64::from(number));
        octaves.push(Octave::new(settings, key, wavelength, axis, amplitude));
        // The angle in a right triangle with the sides 3, 4 and 5, which never comes full circle.
        axis = [0.8 * axis[0] - 0.6 * axis[1], 0.6 * axis[0] + 0.8 * axis[1]];
    }
    octaves
}

fn fbm(octaves: &[Octave], x: u32, z: u32) -> f32 {
    let mut sum = 0.0;
    for octave in octaves {
        sum += octave.amplitude * octave.at(x, z, [0.0; 2]);
    }
    sum
}

/// fBm, and by how many samples it bends crests: those are a noise's zeros, and would be smooth
/// closed curves. Every other octave bends them in x and in z.
fn bent_fbm(octaves: &[Octave], x: u32, z: u32) -> (f32, [f64; 2]) {
    let (mut sum, mut bend) = (0.0, [0.0; 2]);
    for (number, octave) in octaves.iter().enumerate() {
        let noise = octave.at(x, z, [0.0; 2]);
        sum += octave.amplitude * noise;
        bend[number % 2] += BEND * octave.wavelength * f64::from(noise);
    }
    (sum, bend)
}

fn ridged(octaves: &[Octave], x: u32, z: u32, shift: [f64; 2]) -> f32 {
    let (mut sum, mut weight) = (0.0, 1.0);
    for octave in octaves {
        let ridge = 1.0 - octave.at(x, z, shift).abs();
        let signal = weight * ridge * ridge;
        sum += octave.amplitude * signal;
        weight = (2.0 * signal).min(1.0);
    }
    sum
}

/// Leaves values from 0 to 1 as they are, except near either end, where they bend so that what lies
/// beyond stays within.
fn squeeze(value: f32) -> f32 {
    let centred = 2.0 * value - 1.0;
    let over = (centred.abs() - SHOULDER) / (1.0 - SHOULDER);
    let bent = if over > 0.0 {
        (SHOULDER + (1.0 - SHOULDER) * over / (1.0 + over)).copysign(centred)
    } else {
        centred
    };
    0.5 + 0.5 * bent
}
