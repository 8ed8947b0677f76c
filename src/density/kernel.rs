//! From a window of stored heights to densities.

use super::curvature::{self, Ring};
use super::{DensityFilter, DensitySettings};
use crate::tile::DENSITY_CELL;
use pulp::{Arch, NullaryFnOnce};
use std::marker::PhantomData;
use std::ops::Range;

const CELL: usize = DENSITY_CELL as usize;

/// The largest step between stored heights that is told from a larger one, in sample spacings.
/// Beyond it every step is a cliff, and products of heights would overflow.
const MAX_STEP: f32 = 1000.0;

/// What turns heights into densities: settings, and what a step of the stored heights is worth.
#[derive(Clone, Debug, PartialEq)]
pub struct DensityKernel {
    filter: DensityFilter,
    step: f32,
    noise: f32,
    factor: f32,
    exponent: f32,
}

/// Memory that [`DensityKernel::run`] works in. Kept, it is not allocated again.
#[derive(Clone, Debug, Default)]
pub struct DensityScratch {
    rows: [Vec<f32>; 3],
    largest: Vec<f32>,
    shared: Vec<f32>,
}

/// A window of stored heights: the samples of some texels, and one more on every side.
///
/// Texel `(x, z)` covers samples `4 x ..= 4 x + 4` by `4 z ..= 4 z + 4`, so that neighbouring texels
/// share a row of samples and nothing lies between two. `heights` starts with the sample one west
/// and one north of the first texel's first, and the next row follows `stride` samples later.
#[derive(Clone, Debug)]
pub struct DensityWindow<'a> {
    /// The heights, row by row: `4 texels[1] + 3` rows of `4 texels[0] + 3`.
    pub heights: &'a [u16],
    /// Samples from one row to the next.
    pub stride: usize,
    /// Texels in x and z.
    pub texels: [usize; 2],
    /// Which of the window's samples lie on the terrain, in x and z, at least two. The others' heights
    /// don't matter: where a sample on the rim lacks a neighbour, the ground goes on straight there,
    /// so that a plane has no curvature on its rim either.
    pub terrain: [Range<usize>; 2],
}

impl DensityKernel {
    /// The kernel for tiles of level `level` whose stored heights lie `step_m` metres apart and
    /// whose samples of level 0 `spacing_m`.
    #[must_use]
    pub fn new(settings: &DensitySettings, step_m: f64, spacing_m: f64, level: u8) -> Self {
        let spacing_m = spacing_m * 2_f64.powi(level.into());
        let step = ((step_m / spacing_m) as f32).clamp(0.0, MAX_STEP);
        Self {
            filter: settings.filter,
            step,
            noise: settings.filter.rounding_noise(step),
            factor: settings.gain * settings.filter.scale(),
            exponent: settings.exponent,
        }
    }

    /// What one step of the stored heights is worth in sample spacings.
    #[must_use]
    pub fn step(&self) -> f32 {
        self.step
    }

    /// The curvature that rounded heights may show on a plane.
    #[must_use]
    pub fn noise(&self) -> f32 {
        self.noise
    }

    /// The density of curvature 1, before it is clamped and without an exponent.
    #[must_use]
    pub fn factor(&self) -> f32 {
        self.factor
    }

    /// The stored density of ground whose largest curvature is `curvature`, never rounded down:
    /// only ground without any curvature beyond that of rounded heights is stored as 0. What is
    /// not a number counts as none.
    #[must_use]
    #[inline(always)]
    pub fn quantise(&self, curvature: f32) -> u8 {
        // As it is above twice the noise, nothing up to the noise, and a ramp in between.
        let beyond = curvature - self.noise;
        let doubled = beyond + beyond;
        let sure = if doubled < curvature {
            doubled
        } else {
            curvature
        };
        let scaled = sure * self.factor;
        // In this order, what is not a number becomes 0.
        let positive = if scaled > 0.0 { scaled } else { 0.0 };
        let clamped = if positive < 1.0 { positive } else { 1.0 };
        let density = if self.exponent == 1.0 {
            f64::from(clamped)
        } else {
            // The standard library's power differs from platform to platform.
            libm::pow(f64::from(clamped), f64::from(self.exponent))
        };
        // In f64, where the product is exact: rounded to f32 it could fall onto a whole number, and
        // the density be rounded down after all.
        let levels = density * 255.0;
        let below = levels as i32;
        let above = below + i32::from(f64::from(below) < levels);
        // A high exponent takes what is small to 0 altogether.
        above.max(i32::from(clamped > 0.0)) as u8
    }

    /// Writes the densities of the window's texels to `out`, row by row, `out_stride` apart. Any
    /// machine and any choice of vector instructions writes the same bytes. Allocates only where
    /// `scratch` has seen no window as wide.
    ///
    /// # Panics
    /// Where a slice is shorter than its size says.
    pub fn run(
        &self,
        window: &DensityWindow<'_>,
        scratch: &mut DensityScratch,
        out: &mut [u8],
        out_stride: usize,
    ) {
        let sweep = Sweep {
            kernel: self,
            window,
            scratch,
            out,
            out_stride,
            filter: PhantomData::<Mean>,
        };
        let arch = Arch::new();
        match self.filter {
            DensityFilter::SecondOrder => arch.dispatch(sweep.with::<SecondOrder>()),
            DensityFilter::Gaussian => arch.dispatch(sweep.with::<Gaussian>()),
            DensityFilter::Mean => arch.dispatch(sweep),
            DensityFilter::LaplaceBeltrami => arch.dispatch(sweep.with::<LaplaceBeltrami>()),
            DensityFilter::LaplaceBeltramiVoronoi => {
                arch.dispatch(sweep.with::<LaplaceBeltramiVoronoi>());
            }
            DensityFilter::Principal => arch.dispatch(sweep.with::<Principal>()),
        }
    }
}

/// A filter that the loop over samples is made for. Not a closure, which the compiler may leave as
/// a call, and the loop scalar.
trait Filter {
    fn curvature(ring: &Ring<f32>, unit: f32) -> f32;
}

macro_rules! filters {
    ($($filter:ident: $curvature:expr;)*) => {$(
        struct $filter;

        impl Filter for $filter {
            #[inline(always)]
            fn curvature(ring: &Ring<f32>, unit: f32) -> f32 {
                $curvature(ring, unit).abs()
            }
        }
    )*};
}

filters! {
    SecondOrder: curvature::second_order;
    Gaussian: curvature::gaussian;
    Mean: curvature::mean;
    LaplaceBeltrami: curvature::laplace_beltrami;
    LaplaceBeltramiVoronoi: curvature::laplace_beltrami_voronoi;
    Principal: curvature::principal;
}

/// The arguments of [`sweep`], which is compiled for several instruction sets; the best that the
/// machine has is taken at run time. Rust never fuses a multiplication with an addition on its own,
/// and so all of them compute the same bits.
struct Sweep<'a, 'b, F> {
    kernel: &'a DensityKernel,
    window: &'a DensityWindow<'b>,
    scratch: &'a mut DensityScratch,
    out: &'a mut [u8],
    out_stride: usize,
    filter: PhantomData<F>,
}

impl<'a, 'b, F> Sweep<'a, 'b, F> {
    fn with<G>(self) -> Sweep<'a, 'b, G> {
        Sweep {
            kernel: self.kernel,
            window: self.window,
            scratch: self.scratch,
            out: self.out,
            out_stride: self.out_stride,
            filter: PhantomData,
        }
    }
}

impl<F: Filter> NullaryFnOnce for Sweep<'_, '_, F> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self {
            kernel,
            window,
            scratch,
            out,
            out_stride,
            ..
        } = self;
        sweep::<F>(kernel, window, scratch, out, out_stride);
    }
}

#[inline(always)]
fn sweep<F: Filter>(
    kernel: &DensityKernel,
    window: &DensityWindow<'_>,
    scratch: &mut DensityScratch,
    out: &mut [u8],
    out_stride: usize,
) {
    let [columns, rows] = window.texels;
    if columns == 0 || rows == 0 {
        return;
    }
    let width = CELL * columns + 1;
    let DensityScratch {
        rows: floats,
        largest,
        shared,
    } = scratch;
    for row in floats.iter_mut() {
        row.resize(width + 2, 0.0);
    }
    for row in [&mut *largest, &mut *shared] {
        row.clear();
        row.resize(width, 0.0);
    }
    let [on_x, on_z] = &window.terrain;
    let on_x = on_x.start..on_x.end.min(width + 2);
    let on_z = on_z.start..on_z.end.min(CELL * rows + 3);
    let heights = |z: usize| &window.heights[z * window.stride..][..width + 2];
    // Beyond the rim, ground goes on straight; whole numbers of this size are exact.
    let load = |row: &mut [f32], z: usize| {
        if on_z.contains(&z) {
            for (float, &height) in row.iter_mut().zip(heights(z)) {
                *float = f32::from(height);
            }
        } else {
            let (rim, inner) = if z < on_z.start {
                (on_z.start, on_z.start + 1)
            } else {
                (on_z.end - 1, on_z.end - 2)
            };
            for ((float, &rim), &inner) in row.iter_mut().zip(heights(rim)).zip(heights(inner)) {
                *float = 2.0 * f32::from(rim) - f32::from(inner);
            }
        }
        if on_x.start > 0 {
            row[on_x.start - 1] = 2.0 * row[on_x.start] - row[on_x.start + 1];
        }
        if on_x.end < row.len() {
            row[on_x.end] = 2.0 * row[on_x.end - 1] - row[on_x.end - 2];
        }
    };
    let [above, middle, below] = floats;
    load(above, 0);
    load(middle, 1);
    // Samples that are asked for, from the first texel's first.
    let (left, right) = (on_x.start.max(1) - 1, (on_x.end - 1).min(width));
    let asked = on_z.start.max(1) - 1..(on_z.end - 1).min(CELL * rows + 1);
    for row in 0..=CELL * rows {
        load(below, row + 2);
        // The last row of a texel is the next one's first.
        let ends = row > 0 && row % CELL == 0;
        if asked.contains(&row) {
            let heights = [&*above, &*middle, &*below].map(|row| &row[left..right + 2]);
            let target = if ends { &mut *shared } else { &mut *largest };
            fold_row::<F>(heights, kernel.step, &mut target[left..right]);
        }
        if ends {
            for (largest, &shared) in largest.iter_mut().zip(&*shared) {
                *largest = larger(*largest, shared);
            }
            let target = &mut out[(row / CELL - 1) * out_stride..][..columns];
            let cells = largest.windows(CELL + 1).step_by(CELL);
            for (density, cell) in target.iter_mut().zip(cells) {
                let pairs = larger(larger(cell[0], cell[1]), larger(cell[2], cell[3]));
                *density = kernel.quantise(larger(pairs, cell[4]));
            }
            std::mem::swap(largest, shared);
            shared.fill(0.0);
        }
        std::mem::swap(above, middle);
        std::mem::swap(middle, below);
    }
}

/// A comparison that is one instruction, and takes `a` where `b` is not a number.
#[inline(always)]
fn larger(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}

/// Takes the curvatures of a row into the largest so far. The three rows have two samples more
/// than `largest`.
#[inline(always)]
fn fold_row<F: Filter>(rows: [&[f32]; 3], unit: f32, largest: &mut [f32]) {
    let width = largest.len();
    // Slices of one length each, so that the loop runs without bounds checks in vector registers.
    let [above, middle, below] =
        rows.map(|row| (&row[..width], &row[1..=width], &row[2..width + 2]));
    for (x, largest) in largest.iter_mut().enumerate() {
        let ring = Ring {
            north_west: above.0[x],
            north: above.1[x],
            north_east: above.2[x],
            west: middle.0[x],
            centre: middle.1[x],
            east: middle.2[x],
            south_west: below.0[x],
            south: below.1[x],
            south_east: below.2[x],
        };
        *largest = larger(*largest, F::curvature(&ring, unit));
    }
}
