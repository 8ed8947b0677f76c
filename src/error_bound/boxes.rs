//! Bounds for all triangles in a box, for boxes so dense that every triangle lies in one.

use super::grid::{Cells, Extremes, Grid, NOTHING};
use super::window::SIDE;
use pulp::Simd;

/// What rounding in single precision can have taken from the ground's distance to a grid's surface,
/// in steps of stored heights: less than eight times half of 2^-6, numbers being below 2^18, to either
/// side.
const REST_ROUNDING: f32 = 1.0 / 8.0;
/// What planes have behind their last value: boxes are taken in whole vectors, of which some reach
/// beyond a row's end. What is read there counts for nothing.
pub(super) const PAD: usize = 32;
/// Rows of boxes are a multiple of this long, as much as the widest vectors hold.
const LANES: usize = 16;

/// All boxes for one spacing: rows and columns of boxes, one a cell, each of some cells a side.
#[derive(Clone, Debug, Default)]
pub(super) struct Family {
    /// Boxes along a side; the first begins `before` cells before the tile.
    pub side: usize,
    /// From one row of boxes to the next.
    pub stride: usize,
    /// Bounds at the family's spacing.
    pub bound: Vec<f32>,
    /// Bounds at half of it, for the triangles in the same box.
    pub finer: Vec<f32>,
}

/// The largest and the smallest kink and twist in a box.
struct Bends<V> {
    x: [V; 2],
    z: [V; 2],
    twist: [V; 2],
}

/// For vectors of boxes in a row, the values of which they are made: of `C` columns and `R` rows.
type Values<'a, V, const C: usize, const R: usize> = [[&'a [V]; C]; R];

/// Values of a plane with `stride` a row, for boxes that begin at its place `at`, in so many vectors.
#[inline(always)]
fn values<S: Simd, const C: usize, const R: usize>(
    plane: &[f32],
    stride: usize,
    at: usize,
    vectors: usize,
) -> Values<'_, S::f32s, C, R> {
    let mut out: Values<'_, S::f32s, C, R> = [[&[]; C]; R];
    for (row, out) in out.iter_mut().enumerate() {
        for (column, out) in out.iter_mut().enumerate() {
            let plane = &plane[at + row * stride + column..][..vectors * S::F32_LANES];
            *out = &S::as_simd_f32s(plane).0[..vectors];
        }
    }
    out
}

/// The same of two planes.
#[inline(always)]
fn both<'a, S: Simd, const C: usize, const R: usize>(
    planes: [&'a [f32]; 2],
    stride: usize,
    at: usize,
    vectors: usize,
) -> [Values<'a, S::f32s, C, R>; 2] {
    [
        values::<S, C, R>(planes[0], stride, at, vectors),
        values::<S, C, R>(planes[1], stride, at, vectors),
    ]
}

/// The largest (or smallest) of a vector's values.
#[inline(always)]
fn extreme<S: Simd, const HIGH: bool, const C: usize, const R: usize>(
    simd: S,
    values: &Values<'_, S::f32s, C, R>,
    vector: usize,
) -> S::f32s {
    let mut out = values[0][0][vector];
    for row in values {
        for value in row {
            out = if HIGH {
                simd.max_f32s(out, value[vector])
            } else {
                simd.min_f32s(out, value[vector])
            };
        }
    }
    out
}

impl Family {
    fn resize(&mut self, side: usize) {
        self.side = side;
        self.stride = side.next_multiple_of(LANES);
        for plane in [&mut self.bound, &mut self.finer] {
            plane.resize(side * self.stride, 0.0);
        }
    }

    /// A row's bounds at the spacing and at half of it.
    #[inline(always)]
    fn row_mut<S: Simd>(&mut self, row: usize) -> [&mut [S::f32s]; 2] {
        let stride = self.stride;
        let [bound, finer] = [&mut self.bound, &mut self.finer];
        [bound, finer].map(|plane| S::as_mut_simd_f32s(&mut plane[row * stride..][..stride]).0)
    }

    /// Begins with what holds for any triangle in the box: its error is no larger than what lies
    /// between the lowest and the highest ground. `range` has `stride` cells (or samples, of which a
    /// box has one more than cells) a row, and boxes begin at its cell `first`, `COUNT` a side.
    #[inline(always)]
    pub(super) fn begin<S: Simd, const COUNT: usize>(
        &mut self,
        simd: S,
        side: usize,
        range: [&[f32]; 2],
        stride: usize,
        first: usize,
    ) {
        self.resize(side);
        let vectors = self.stride / S::F32_LANES;
        for row in 0..side {
            let at = (first + row) * stride + first;
            let [high, low] = both::<S, COUNT, COUNT>(range, stride, at, vectors);
            let [bound, finer] = self.row_mut::<S>(row);
            for (vector, (bound, finer)) in bound.iter_mut().zip(finer).enumerate() {
                let high = extreme::<S, true, COUNT, COUNT>(simd, &high, vector);
                let low = extreme::<S, false, COUNT, COUNT>(simd, &low, vector);
                *bound = simd.max_f32s(simd.sub_f32s(high, low), simd.splat_f32s(0.0));
                *finer = *bound;
            }
        }
    }

    /// Begins with a bound that everything is below.
    pub(super) fn begin_empty(&mut self, side: usize) {
        self.resize(side);
        for plane in [&mut self.bound, &mut self.finer] {
            plane.fill(-NOTHING);
        }
    }

    /// Takes what follows from a grid whose cells are as large as the family's, `COUNT` a side of
    /// a box (`INNER` one less, `ALONG` one more), the first box beginning at the grid's cell `first`.
    /// `spacing` is the family's in steps of the grid. `REST` where the grid is not the ground itself.
    #[inline(always)]
    pub(super) fn consider_grid<
        S: Simd,
        const INNER: usize,
        const COUNT: usize,
        const ALONG: usize,
        const REST: bool,
    >(
        &mut self,
        simd: S,
        grid: &Grid,
        first: usize,
        spacing: f32,
    ) {
        let stride = grid.stride();
        let vectors = self.stride / S::F32_LANES;
        for row in 0..self.side {
            let at = (first + row) * stride + first;
            // Kinks at a box's rim turn nothing inside of it; along it, they reach to its ends.
            let x = values::<S, INNER, ALONG>(&grid.bend_x, stride, at + 1, vectors);
            let z = values::<S, ALONG, INNER>(&grid.bend_z, stride, at + stride, vectors);
            let twist = values::<S, COUNT, COUNT>(&grid.twist, stride, at, vectors);
            let rest = rests::<S, COUNT, REST>(&grid.rest, stride, at, vectors);
            let [bound, finer] = self.row_mut::<S>(row);
            for (vector, (bound, finer)) in bound.iter_mut().zip(finer).enumerate() {
                let bends = Bends {
                    x: [
                        extreme::<S, true, INNER, ALONG>(simd, &x, vector),
                        extreme::<S, false, INNER, ALONG>(simd, &x, vector),
                    ],
                    z: [
                        extreme::<S, true, ALONG, INNER>(simd, &z, vector),
                        extreme::<S, false, ALONG, INNER>(simd, &z, vector),
                    ],
                    twist: [
                        extreme::<S, true, COUNT, COUNT>(simd, &twist, vector),
                        extreme::<S, false, COUNT, COUNT>(simd, &twist, vector),
                    ],
                };
                let rest = rest_of::<S, COUNT, REST>(simd, &rest, vector);
                take(simd, &bends, rest, spacing, [bound, finer]);
            }
        }
    }

    /// The same for cells of two steps of a grid, three a side of a box.
    #[inline(always)]
    pub(super) fn consider_cells<S: Simd, const REST: bool>(
        &mut self,
        simd: S,
        cells: &Cells,
        first: usize,
        spacing: f32,
    ) {
        let stride = cells.side;
        let vectors = self.stride / S::F32_LANES;
        for row in 0..self.side {
            let at = (first + row) * stride + first;
            // The first line of the first cells is the box's rim.
            let [x_begin, x] = &cells.bend_x;
            let [z_begin, z] = &cells.bend_z;
            let x_begin = both::<S, 1, 3>(x_begin.planes(), stride, at, vectors);
            let x = both::<S, 2, 3>(x.planes(), stride, at + 1, vectors);
            let z_begin = both::<S, 3, 1>(z_begin.planes(), stride, at, vectors);
            let z = both::<S, 3, 2>(z.planes(), stride, at + stride, vectors);
            let twist = both::<S, 3, 3>(cells.twist.planes(), stride, at, vectors);
            let rest = rests::<S, 3, REST>(&cells.rest, stride, at, vectors);
            let [bound, finer] = self.row_mut::<S>(row);
            for (vector, (bound, finer)) in bound.iter_mut().zip(finer).enumerate() {
                let bends = Bends {
                    x: [
                        simd.max_f32s(
                            extreme::<S, true, 1, 3>(simd, &x_begin[0], vector),
                            extreme::<S, true, 2, 3>(simd, &x[0], vector),
                        ),
                        simd.min_f32s(
                            extreme::<S, false, 1, 3>(simd, &x_begin[1], vector),
                            extreme::<S, false, 2, 3>(simd, &x[1], vector),
                        ),
                    ],
                    z: [
                        simd.max_f32s(
                            extreme::<S, true, 3, 1>(simd, &z_begin[0], vector),
                            extreme::<S, true, 3, 2>(simd, &z[0], vector),
                        ),
                        simd.min_f32s(
                            extreme::<S, false, 3, 1>(simd, &z_begin[1], vector),
                            extreme::<S, false, 3, 2>(simd, &z[1], vector),
                        ),
                    ],
                    twist: [
                        extreme::<S, true, 3, 3>(simd, &twist[0], vector),
                        extreme::<S, false, 3, 3>(simd, &twist[1], vector),
                    ],
                };
                let rest = rest_of::<S, 3, REST>(simd, &rest, vector);
                take(simd, &bends, rest, spacing, [bound, finer]);
            }
        }
    }
}

/// The highest and the lowest rests, where there are any.
#[inline(always)]
fn rests<'a, S: Simd, const COUNT: usize, const REST: bool>(
    rest: &'a Extremes,
    stride: usize,
    at: usize,
    vectors: usize,
) -> Option<[Values<'a, S::f32s, COUNT, COUNT>; 2]> {
    if REST {
        Some(both::<S, COUNT, COUNT>(rest.planes(), stride, at, vectors))
    } else {
        None
    }
}

/// What the ground's distance from a grid's surface adds to the error.
#[inline(always)]
fn rest_of<S: Simd, const COUNT: usize, const REST: bool>(
    simd: S,
    rest: &Option<[Values<'_, S::f32s, COUNT, COUNT>; 2]>,
    vector: usize,
) -> S::f32s {
    if REST && let Some([high, low]) = rest {
        let high = extreme::<S, true, COUNT, COUNT>(simd, high, vector);
        let low = extreme::<S, false, COUNT, COUNT>(simd, low, vector);
        simd.add_f32s(simd.sub_f32s(high, low), simd.splat_f32s(REST_ROUNDING))
    } else {
        simd.splat_f32s(0.0)
    }
}

/// Takes the bounds at `spacing` and at half of it where they are better than those so far.
#[inline(always)]
fn take<S: Simd>(
    simd: S,
    bends: &Bends<S::f32s>,
    rest: S::f32s,
    spacing: f32,
    [bound, finer]: [&mut S::f32s; 2],
) {
    // Without closures, which the compiler may leave as calls.
    let (zero, half) = (simd.splat_f32s(0.0), simd.splat_f32s(0.5));
    let [high, low] = bends.twist;
    let twist = [
        simd.mul_f32s(half, simd.add_f32s(high, low)),
        simd.mul_f32s(half, simd.sub_f32s(high, low)),
    ];
    let ([xh, xl], [zh, zl]) = (bends.x, bends.z);
    let (xh, zh) = (simd.max_f32s(xh, zero), simd.max_f32s(zh, zero));
    let (xl, zl) = (simd.min_f32s(xl, zero), simd.min_f32s(zl, zero));
    let above = Bend::new(simd, [xh, zh], twist);
    let below = Bend::new(
        simd,
        [simd.sub_f32s(zero, xl), simd.sub_f32s(zero, zl)],
        twist,
    );
    let at = worst(simd, [&above, &below], rest, spacing * spacing);
    let fine = worst(simd, [&above, &below], rest, 0.25 * (spacing * spacing));
    let sum = simd.add_f32s(at, simd.add_f32s(fine, fine));
    let so_far = simd.add_f32s(*bound, simd.add_f32s(*finer, *finer));
    let better = simd.less_than_f32s(sum, so_far);
    *bound = simd.select_f32s(better, at, *bound);
    *finer = simd.select_f32s(better, fine, *finer);
}

/// The error to the worse side.
#[inline(always)]
fn worst<S: Simd>(
    simd: S,
    [above, below]: [&Bend<S::f32s>; 2],
    rest: S::f32s,
    square: f32,
) -> S::f32s {
    let square = simd.splat_f32s(square);
    let worst = simd.max_f32s(above.at(simd, square), below.at(simd, square));
    simd.max_f32s(simd.add_f32s(worst, rest), simd.splat_f32s(0.0))
}

/// The error of a surface, to one side, for spacings of at least one step of its grid:
/// `fixed + slope · spacing²`.
struct Bend<V> {
    fixed: V,
    slope: V,
}

impl<V: Copy> Bend<V> {
    /// Of kinks up to `x` and `z` and twists from `twist - spread` to `twist + spread`.
    #[inline(always)]
    fn new<S: Simd<f32s = V>>(simd: S, [x, z]: [V; 2], [twist, spread]: [V; 2]) -> Self {
        let (half, eighth) = (simd.splat_f32s(0.5), simd.splat_f32s(0.125));
        let (a, b) = (simd.add_f32s(x, spread), simd.add_f32s(z, spread));
        let middle = simd.mul_f32s(half, simd.add_f32s(a, b));
        let half = simd.mul_f32s(half, simd.sub_f32s(a, b));
        // Half the eigenvalues are middle ± radius.
        let squares = simd.add_f32s(simd.mul_f32s(half, half), simd.mul_f32s(twist, twist));
        let radius = simd.sqrt_f32s(squares);
        let second = simd.max_f32s(simd.sub_f32s(middle, radius), simd.splat_f32s(0.0));
        let second = simd.mul_f32s(second, simd.splat_f32s(1.0 / 3.0));
        let sum = simd.add_f32s(simd.add_f32s(middle, radius), second);
        Self {
            fixed: simd.mul_f32s(eighth, simd.add_f32s(x, z)),
            slope: simd.mul_f32s(eighth, sum),
        }
    }

    #[inline(always)]
    fn at<S: Simd<f32s = V>>(&self, simd: S, square: V) -> V {
        simd.add_f32s(self.fixed, simd.mul_f32s(self.slope, square))
    }
}

const _: () = assert!(PAD >= LANES + 4 && SIDE > LANES);
