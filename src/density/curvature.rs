//! Curvature of a height field at a sample, from its eight neighbours.
//!
//! All distances, heights included, count in sample spacings, so curvatures are pure numbers: the
//! curvature per metre times the spacing (its square, for the Gaussian). Equations are numbered as
//! in Cervin, *Adaptive Hardware-accelerated Terrain Tessellation*, 2012. Where one is misprinted,
//! what stands here is what a sphere of radius `r` confirms (mean `1/r`, Gaussian `1/r²`):
//!
//! | equation | as printed | here |
//! |---|---|---|
//! | 2.13, 2.14, 2.26, 2.27 | `K` and `H` change meaning between them | `H` is the mean, `K` the Gaussian curvature |
//! | 2.27 | half the determinant in the first line, the whole in the second | the whole |
//! | 2.30 | divides by the area of the whole ring: 2/3 of the curvature | by a third of it, the sample's share |
//! | 2.31 | no cotangents | `½ · 1/A · Σ (cot α + cot β)(v_j − v)`, `α` and `β` opposite the edge |
//! | 2.32 | negative where a triangle is obtuse | the mixed area: half of a triangle that is obtuse at the sample, a quarter of one that is obtuse elsewhere |
//! | 3.5 | divides by `4 Δ` | by `4 Δ²` |
//!
//! Derivatives are central differences; with `h(x, z)` the height, and `d` for the sample's
//! neighbours minus the sample,
//!
//! ```text
//! h_x  = (h(1, 0) - h(-1, 0)) / 2          h_xx = h(1, 0) - 2 h(0, 0) + h(-1, 0)
//! h_z  = (h(0, 1) - h(0, -1)) / 2          h_zz = h(0, 1) - 2 h(0, 0) + h(0, -1)
//! h_xz = (h(1, 1) - h(-1, 1) - h(1, -1) + h(-1, -1)) / 4
//! ```
//!
//! Triangles are those of the regular triangulation whose diagonals run from (0, 0) to (1, 1): six
//! to a sample, over the ring (1, 0), (1, 1), (0, 1), (-1, 0), (-1, -1), (0, -1).
//!
//! Every function is exact to second order: the error falls to a quarter when the spacing is
//! halved. None fuses a multiplication with an addition, so that all machines get the same bits.

use super::DensityFilter;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// `f32`, in which densities are made, or `f64`, for whoever wants to know better.
pub trait Real:
    Copy
    + PartialOrd
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    /// A constant that both types hold exactly.
    fn constant(value: f32) -> Self;
    /// The absolute value.
    #[must_use]
    fn magnitude(self) -> Self;
    /// The square root, correctly rounded.
    #[must_use]
    fn root(self) -> Self;
    /// 1 below zero and 0 above, without a branch: a loop with one stays scalar.
    #[must_use]
    fn below_zero(self) -> Self;
}

macro_rules! real {
    ($float:ty, $bits:ty, $signed:ty) => {
        impl Real for $float {
            #[inline(always)]
            fn constant(value: f32) -> Self {
                value.into()
            }

            #[inline(always)]
            fn magnitude(self) -> Self {
                self.abs()
            }

            #[inline(always)]
            fn root(self) -> Self {
                self.sqrt()
            }

            #[inline(always)]
            fn below_zero(self) -> Self {
                (self.to_bits() >> (<$bits>::BITS - 1)) as $signed as Self
            }
        }
    };
}

real!(f32, u32, i32);
real!(f64, u64, i64);

/// Heights of a sample and its neighbours, named after the compass: x grows to the east, z to the
/// south. In any unit: what one is worth in sample spacings, the functions are told.
#[derive(Clone, Copy, Debug, PartialEq)]
#[expect(missing_docs, reason = "the compass")]
pub struct Ring<T> {
    pub north_west: T,
    pub north: T,
    pub north_east: T,
    pub west: T,
    pub centre: T,
    pub east: T,
    pub south_west: T,
    pub south: T,
    pub south_east: T,
}

impl<T: Real> Ring<T> {
    /// The heights that `height(x, z)` gives, for x and z in -1, 0, 1.
    pub fn new(height: impl Fn(i32, i32) -> T) -> Self {
        Self {
            north_west: height(-1, -1),
            north: height(0, -1),
            north_east: height(1, -1),
            west: height(-1, 0),
            centre: height(0, 0),
            east: height(1, 0),
            south_west: height(-1, 1),
            south: height(0, 1),
            south_east: height(1, 1),
        }
    }
}

/// First and second derivatives in sample spacings.
struct Derivatives<T> {
    x: T,
    z: T,
    xx: T,
    zz: T,
    xz: T,
}

impl<T: Real> Derivatives<T> {
    /// Differences of whole numbers below 2^22 are exact, and so each derivative is rounded once.
    #[inline(always)]
    fn new(ring: &Ring<T>, unit: T) -> Self {
        let half = unit * T::constant(0.5);
        let quarter = unit * T::constant(0.25);
        let twice = ring.centre + ring.centre;
        Self {
            x: (ring.east - ring.west) * half,
            z: (ring.south - ring.north) * half,
            xx: (ring.east + ring.west - twice) * unit,
            zz: (ring.south + ring.north - twice) * unit,
            xz: ((ring.south_east + ring.north_west) - (ring.south_west + ring.north_east))
                * quarter,
        }
    }

    /// `1 + h_x² + h_z²`.
    #[inline(always)]
    fn square(&self) -> T {
        T::constant(1.0) + (self.x * self.x + self.z * self.z)
    }

    #[inline(always)]
    fn mean(&self, square: T) -> T {
        let one = T::constant(1.0);
        let (x2, z2) = (self.x * self.x, self.z * self.z);
        let cross = self.xz * (self.x * self.z);
        let trace = (self.xx * (one + z2) + self.zz * (one + x2)) - (cross + cross);
        trace / ((square + square) * square.root())
    }

    #[inline(always)]
    fn gaussian(&self, square: T) -> T {
        (self.xx * self.zz - self.xz * self.xz) / (square * square)
    }
}

/// The sum of the second differences, equation 2.19: `h_xx + h_zz`. Twice the mean curvature where
/// the ground is level, and too high on slopes, by the cube of `√(1 + slope²)` at worst.
#[inline(always)]
pub fn second_order<T: Real>(ring: &Ring<T>, unit: T) -> T {
    let twice = ring.centre + ring.centre;
    ((ring.east + ring.west - twice) + (ring.south + ring.north - twice)) * unit
}

/// Gaussian curvature, equation 2.27: `(h_xx h_zz − h_xz²) / (1 + h_x² + h_z²)²`. Positive on peaks
/// and in pits, negative on saddles, zero on whatever is straight in one direction.
#[inline(always)]
pub fn gaussian<T: Real>(ring: &Ring<T>, unit: T) -> T {
    let derivatives = Derivatives::new(ring, unit);
    derivatives.gaussian(derivatives.square())
}

/// Mean curvature, equation 2.26:
/// `(h_xx (1 + h_z²) − 2 h_xz h_x h_z + h_zz (1 + h_x²)) / (2 (1 + h_x² + h_z²)^(3/2))`. Positive in
/// pits and valleys, negative on peaks and crests, zero on saddles whose two bends are equal.
#[inline(always)]
pub fn mean<T: Real>(ring: &Ring<T>, unit: T) -> T {
    let derivatives = Derivatives::new(ring, unit);
    derivatives.mean(derivatives.square())
}

/// The magnitude of the larger principal curvature, from equation 2.34: `|H| + √(H² − K)`.
#[inline(always)]
pub fn principal<T: Real>(ring: &Ring<T>, unit: T) -> T {
    let derivatives = Derivatives::new(ring, unit);
    let square = derivatives.square();
    let mean = derivatives.mean(square);
    let below = mean * mean - derivatives.gaussian(square);
    // Rounding takes it below zero where the two curvatures are equal.
    let zero = T::constant(0.0);
    let below = if below > zero { below } else { zero };
    mean.magnitude() + below.root()
}

/// A triangle of the ring: the sample and two of its neighbours, `a` and `b`.
struct Triangle<T> {
    /// Cotangent of the angle at `a`.
    cot_a: T,
    /// Cotangent of the angle at `b`.
    cot_b: T,
    /// Twice the triangle's area, or eight times the part of it that belongs to the sample.
    area: T,
}

impl<T: Real> Triangle<T> {
    /// `flat` holds the horizontal parts of the products `a·a`, `b·b` and `a·b` of the edges to `a`
    /// and `b`, which lie `a` and `b` above the sample; `slope_x` and `slope_z` are the triangle's
    /// slopes. Cotangents are dot products over the cross product's length, equation 3.7.
    #[inline(always)]
    fn new<const MIXED: bool>(flat: [f32; 3], a: T, b: T, slope_x: T, slope_z: T) -> Self {
        let aa = T::constant(flat[0]) + a * a;
        let bb = T::constant(flat[1]) + b * b;
        let ab = T::constant(flat[2]) + a * b;
        let one = T::constant(1.0);
        let double_area = (one + (slope_x * slope_x + slope_z * slope_z)).root();
        let inverse = one / double_area;
        let (cot_a, cot_b) = ((aa - ab) * inverse, (bb - ab) * inverse);
        let area = if MIXED {
            // The sample's Voronoi cell; half of a triangle that is obtuse there, a quarter of one
            // that is obtuse elsewhere.
            let voronoi = aa * cot_b + bb * cot_a;
            let here = ab.below_zero();
            // At most one angle is obtuse.
            let elsewhere = cot_a.below_zero() + cot_b.below_zero();
            let share = (here + here) + elsewhere;
            voronoi * (one - (here + elsewhere)) + double_area * share
        } else {
            double_area
        };
        Self { cot_a, cot_b, area }
    }
}

/// Length of `Σ (cot α + cot β)(v_j − v)` over the ring, and the sum of the triangles' areas.
#[inline(always)]
fn cotangent_sum<T: Real, const MIXED: bool>(ring: &Ring<T>, unit: T) -> (T, T) {
    let centre = ring.centre;
    let (e, se) = (
        (ring.east - centre) * unit,
        (ring.south_east - centre) * unit,
    );
    let (s, w) = ((ring.south - centre) * unit, (ring.west - centre) * unit);
    let (nw, n) = (
        (ring.north_west - centre) * unit,
        (ring.north - centre) * unit,
    );
    let t0 = Triangle::new::<MIXED>([1.0, 2.0, 1.0], e, se, e, se - e);
    let t1 = Triangle::new::<MIXED>([2.0, 1.0, 1.0], se, s, se - s, s);
    let t2 = Triangle::new::<MIXED>([1.0, 1.0, 0.0], s, w, w, s);
    let t3 = Triangle::new::<MIXED>([1.0, 2.0, 1.0], w, nw, w, nw - w);
    let t4 = Triangle::new::<MIXED>([2.0, 1.0, 1.0], nw, n, nw - n, n);
    let t5 = Triangle::new::<MIXED>([1.0, 1.0, 0.0], n, e, e, n);
    // An edge's two cotangents lie opposite it, in the triangles to its sides.
    let (to_e, to_se) = (t5.cot_a + t0.cot_b, t0.cot_a + t1.cot_b);
    let (to_s, to_w) = (t1.cot_a + t2.cot_b, t2.cot_a + t3.cot_b);
    let (to_nw, to_n) = (t3.cot_a + t4.cot_b, t4.cot_a + t5.cot_b);
    let x = (to_e - to_w) + (to_se - to_nw);
    let z = (to_s - to_n) + (to_se - to_nw);
    let y = ((to_e * e + to_w * w) + (to_s * s + to_n * n)) + (to_se * se + to_nw * nw);
    let area = ((t0.area + t1.area) + (t2.area + t3.area)) + (t4.area + t5.area);
    ((y * y + (x * x + z * z)).root(), area)
}

/// Mean curvature by the Laplace-Beltrami operator, equation 2.30 put right:
/// `½ |Δ_S v|` with `Δ_S v = ½ · 3/A · Σ (cot α + cot β)(v_j − v)`, `A` the area of the ring. Never
/// negative.
#[inline(always)]
pub fn laplace_beltrami<T: Real>(ring: &Ring<T>, unit: T) -> T {
    let (sum, area) = cotangent_sum::<T, false>(ring, unit);
    T::constant(1.5) * sum / area
}

/// Mean curvature by the Laplace-Beltrami operator over the mixed Voronoi area, equations 2.31 and
/// 2.32 put right: `½ |Δ_S v|` with `Δ_S v = ½ · 1/A_v · Σ (cot α + cot β)(v_j − v)`, and
/// `A_v = ⅛ Σ (cot α + cot β) |v_j − v|²` where no triangle is obtuse. Never negative.
#[inline(always)]
pub fn laplace_beltrami_voronoi<T: Real>(ring: &Ring<T>, unit: T) -> T {
    let (sum, area) = cotangent_sum::<T, true>(ring, unit);
    (sum + sum) / area
}

impl DensityFilter {
    /// The magnitude of the curvature that the filter sees at the ring's centre. `unit` is what one
    /// of the ring's units is worth in sample spacings.
    #[must_use]
    pub fn curvature<T: Real>(self, ring: &Ring<T>, unit: T) -> T {
        match self {
            Self::SecondOrder => second_order(ring, unit).magnitude(),
            Self::Gaussian => gaussian(ring, unit).magnitude(),
            Self::Mean => mean(ring, unit).magnitude(),
            Self::LaplaceBeltrami => laplace_beltrami(ring, unit),
            Self::LaplaceBeltramiVoronoi => laplace_beltrami_voronoi(ring, unit),
            Self::Principal => principal(ring, unit),
        }
    }
}
