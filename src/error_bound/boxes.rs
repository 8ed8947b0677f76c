//! Bounds for all triangles in a box, for boxes so dense that every triangle lies in one.

use super::grid::{Cells, Extremes, Grid, NOTHING, larger, pick};
use std::ops::Range;

/// What rounding in single precision can have taken from the ground's distance to a grid's surface,
/// in steps of stored heights: less than eight times half of 2^-6, numbers being below 2^18, to either
/// side.
const REST_ROUNDING: f32 = 1.0 / 8.0;

/// All boxes for one spacing: rows and columns of boxes, one a cell, each of some cells a side.
#[derive(Clone, Debug, Default)]
pub(super) struct Family {
    /// Boxes along a side; the first begins `before` cells before the tile.
    pub side: usize,
    /// Bounds at the family's spacing.
    pub bound: Vec<f32>,
    /// Bounds at half of it, for the triangles in the same box.
    pub finer: Vec<f32>,
    rows: [Vec<f32>; 9],
}

/// Which lines and cells of a grid a box has, counted from its first cell in x and z.
struct Spans {
    bend_x: [Range<usize>; 2],
    bend_z: [Range<usize>; 2],
    cells: [Range<usize>; 2],
}

/// Planes of a grid, high and low. For points the two are one.
struct Planes<'a> {
    stride: usize,
    bend_x: [&'a [f32]; 2],
    bend_z: [&'a [f32]; 2],
    twist: [&'a [f32]; 2],
    rest: Option<&'a Extremes>,
    spans: Spans,
}

impl Family {
    /// Begins with what holds for any triangle in the box: its error is no larger than what lies
    /// between the lowest and the highest ground. `range` has `stride` cells (or samples, of which a
    /// box has one more than cells) a row, and boxes begin at its cell `first`.
    #[inline(always)]
    pub(super) fn begin(
        &mut self,
        side: usize,
        range: [&[f32]; 2],
        stride: usize,
        first: usize,
        count: usize,
    ) {
        self.side = side;
        for plane in [&mut self.bound, &mut self.finer] {
            plane.clear();
            plane.resize(side * side, 0.0);
        }
        let [spare, high, low, ..] = &mut self.rows;
        let span = || [0..count, 0..count];
        for row in 0..side {
            let from = [first, first + row];
            extreme::<true>(range[0], stride, from, &span(), side, spare, high);
            extreme::<false>(range[1], stride, from, &span(), side, spare, low);
            for x in 0..side {
                let range = larger(high[x] - low[x], 0.0);
                self.bound[row * side + x] = range;
                self.finer[row * side + x] = range;
            }
        }
    }

    /// Begins with a bound that everything is below.
    pub(super) fn begin_empty(&mut self, side: usize) {
        self.side = side;
        for plane in [&mut self.bound, &mut self.finer] {
            plane.clear();
            plane.resize(side * side, -NOTHING);
        }
    }

    /// Takes what follows from a grid whose cells are as large as the family's, `count` a side of
    /// a box, the first box beginning at the grid's cell `first`. `spacing` is the family's in steps
    /// of the grid.
    #[inline(always)]
    pub(super) fn consider_grid(&mut self, grid: &Grid, first: usize, count: usize, spacing: f32) {
        let planes = Planes {
            stride: grid.stride(),
            bend_x: [&grid.bend_x; 2],
            bend_z: [&grid.bend_z; 2],
            twist: [&grid.twist; 2],
            rest: (grid.spacing > 1).then_some(&grid.rest),
            spans: Spans {
                // Kinks at a box's rim turn nothing inside of it; along it, they reach to its ends.
                bend_x: [1..count, 0..count + 1],
                bend_z: [0..count + 1, 1..count],
                cells: [0..count, 0..count],
            },
        };
        self.consider(&planes, first, spacing);
    }

    /// The same for cells of more than one step of a grid, `with_rest` where the grid is not the
    /// ground itself.
    #[inline(always)]
    pub(super) fn consider_cells(
        &mut self,
        cells: &Cells,
        with_rest: bool,
        first: usize,
        count: usize,
        spacing: f32,
    ) {
        fn both(extremes: &Extremes) -> [&[f32]; 2] {
            [&extremes.high, &extremes.low]
        }
        let span = || [0..count, 0..count];
        let planes = Planes {
            stride: cells.side,
            bend_x: both(&cells.bend_x),
            bend_z: both(&cells.bend_z),
            twist: both(&cells.twist),
            rest: with_rest.then_some(&cells.rest),
            spans: Spans {
                bend_x: span(),
                bend_z: span(),
                cells: span(),
            },
        };
        self.consider(&planes, first, spacing);
    }

    #[inline(always)]
    fn consider(&mut self, planes: &Planes<'_>, first: usize, spacing: f32) {
        let side = self.side;
        let stride = planes.stride;
        let squares = [spacing * spacing, 0.25 * spacing * spacing];
        let Spans {
            bend_x,
            bend_z,
            cells,
        } = &planes.spans;
        let [spare, xh, xl, zh, zl, th, tl, rh, rl] = &mut self.rows;
        for row in [&mut *rh, &mut *rl] {
            row.clear();
            row.resize(side, 0.0);
        }
        for row in 0..side {
            let from = [first, first + row];
            extreme::<true>(planes.bend_x[0], stride, from, bend_x, side, spare, xh);
            extreme::<false>(planes.bend_x[1], stride, from, bend_x, side, spare, xl);
            extreme::<true>(planes.bend_z[0], stride, from, bend_z, side, spare, zh);
            extreme::<false>(planes.bend_z[1], stride, from, bend_z, side, spare, zl);
            extreme::<true>(planes.twist[0], stride, from, cells, side, spare, th);
            extreme::<false>(planes.twist[1], stride, from, cells, side, spare, tl);
            if let Some(rest) = planes.rest {
                extreme::<true>(&rest.high, stride, from, cells, side, spare, rh);
                extreme::<false>(&rest.low, stride, from, cells, side, spare, rl);
            }
            let rounding = if planes.rest.is_some() {
                REST_ROUNDING
            } else {
                0.0
            };
            let bound = &mut self.bound[row * side..][..side];
            let finer = &mut self.finer[row * side..][..side];
            let (xh, xl, zh, zl) = (&xh[..side], &xl[..side], &zh[..side], &zl[..side]);
            let (th, tl, rh, rl) = (&th[..side], &tl[..side], &rh[..side], &rl[..side]);
            for x in 0..side {
                let twist = 0.5 * (th[x] + tl[x]);
                let spread = 0.5 * (th[x] - tl[x]);
                let above = Bend::new(larger(xh[x], 0.0), larger(zh[x], 0.0), twist, spread);
                let below = Bend::new(larger(-xl[x], 0.0), larger(-zl[x], 0.0), twist, spread);
                let rest = (rh[x] - rl[x]) + rounding;
                // Not by way of a closure, which the compiler may leave as a call.
                let at = larger(above.at(squares[0]), below.at(squares[0]));
                let half = larger(above.at(squares[1]), below.at(squares[1]));
                let (at, half) = (larger(at + rest, 0.0), larger(half + rest, 0.0));
                let better = at + 2.0 * half < bound[x] + 2.0 * finer[x];
                bound[x] = if better { at } else { bound[x] };
                finer[x] = if better { half } else { finer[x] };
            }
        }
    }
}

/// The error of a surface, to one side, for spacings of at least one step of its grid:
/// `fixed + slope · spacing²`.
struct Bend {
    fixed: f32,
    slope: f32,
}

impl Bend {
    /// Of kinks up to `x` and `z` and twists from `twist - spread` to `twist + spread`.
    #[inline(always)]
    fn new(x: f32, z: f32, twist: f32, spread: f32) -> Self {
        let (a, b) = (x + spread, z + spread);
        let (middle, half) = (0.5 * (a + b), 0.5 * (a - b));
        // Half the eigenvalues are middle ± radius.
        let radius = (half * half + twist * twist).sqrt();
        let second = larger(middle - radius, 0.0);
        Self {
            fixed: 0.125 * (x + z),
            slope: 0.125 * ((middle + radius) + second * (1.0 / 3.0)),
        }
    }

    #[inline(always)]
    fn at(&self, square: f32) -> f32 {
        self.fixed + self.slope * square
    }
}

/// For `side` boxes in a row, the first of them at column and row `from`, the largest (or smallest)
/// value of the plane in columns `spans[0]` and rows `spans[1]` of the box.
#[inline(always)]
fn extreme<const HIGH: bool>(
    plane: &[f32],
    stride: usize,
    from: [usize; 2],
    spans: &[Range<usize>; 2],
    side: usize,
    spare: &mut Vec<f32>,
    out: &mut Vec<f32>,
) {
    let [columns, rows] = spans;
    let width = side + columns.len() - 1;
    let row =
        |number: usize| &plane[(from[1] + number) * stride + from[0] + columns.start..][..width];
    spare.clear();
    spare.extend_from_slice(row(rows.start));
    for number in rows.start + 1..rows.end {
        for (out, &value) in spare.iter_mut().zip(row(number)) {
            *out = pick::<HIGH>(*out, value);
        }
    }
    out.clear();
    out.extend_from_slice(&spare[..side]);
    for shift in 1..columns.len() {
        for (out, &value) in out.iter_mut().zip(&spare[shift..shift + side]) {
            *out = pick::<HIGH>(*out, value);
        }
    }
}
