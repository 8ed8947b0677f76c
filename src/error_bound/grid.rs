//! The ground seen on a coarser grid: how that bends, and how far the ground is from it.

use super::REACH;
use super::window::{MARGIN, SIDE, Window};
use std::ops::Range;

/// Stands for a largest value of nothing; its negative for a smallest. Not infinite, so that
/// differences are numbers.
pub(super) const NOTHING: f32 = -1.0e9;

/// For each cell of a square grid, the largest and the smallest of something in it.
#[derive(Clone, Debug, Default)]
pub(super) struct Extremes {
    pub high: Vec<f32>,
    pub low: Vec<f32>,
}

impl Extremes {
    fn reset(&mut self, length: usize, high: f32) {
        for (plane, value) in [(&mut self.high, high), (&mut self.low, -high)] {
            plane.clear();
            plane.resize(length, value);
        }
    }

    /// The extremes of cells of twice the side, from planes with `stride` cells a row.
    #[inline(always)]
    fn halve(&self, out: &mut Self, stride: usize, side: usize) {
        out.reset(side * side, 0.0);
        pairs::<true>(&self.high, stride, [2, 2], side, &mut out.high);
        pairs::<false>(&self.low, stride, [2, 2], side, &mut out.low);
    }
}

/// The largest (or smallest) of `reach[0]` by `reach[1]` values, two or three, from every second one
/// on in x and z.
#[inline(always)]
fn pairs<const HIGH: bool>(
    plane: &[f32],
    stride: usize,
    reach: [usize; 2],
    side: usize,
    out: &mut [f32],
) {
    let mut column = [0.0_f32; SIDE];
    let width = 2 * (side - 1) + reach[0];
    let column = &mut column[..width];
    for (z, out) in out.chunks_exact_mut(side).enumerate() {
        let row = |number: usize| &plane[(2 * z + number) * stride..][..width];
        column.copy_from_slice(row(0));
        for number in 1..reach[1] {
            for (column, &value) in column.iter_mut().zip(row(number)) {
                *column = pick::<HIGH>(*column, value);
            }
        }
        for (out, pair) in out.iter_mut().zip(column.chunks_exact(2)) {
            *out = pick::<HIGH>(pair[0], pair[1]);
        }
        if reach[0] == 3 {
            for (out, pair) in out.iter_mut().zip(column[1..].chunks_exact(2)) {
                *out = pick::<HIGH>(*out, pair[1]);
            }
        }
    }
}

/// What bounds the error in a cell: by how much the surface turns at the grid's lines in x and in z,
/// how much it twists, and how far the ground is from it.
#[derive(Clone, Debug, Default)]
pub(super) struct Cells {
    /// Cells along a side of the square.
    pub side: usize,
    pub bend_x: Extremes,
    pub bend_z: Extremes,
    pub twist: Extremes,
    pub rest: Extremes,
}

/// A bilinear surface with a point at every `spacing`-th sample.
#[derive(Clone, Debug, Default)]
pub(super) struct Grid {
    /// Samples from one point to the next.
    pub spacing: usize,
    /// Cells along a side; the planes of points have a row and a column more.
    pub cells: usize,
    /// Second differences at points, 0 where the line through it is no ground's inside.
    pub bend_x: Vec<f32>,
    pub bend_z: Vec<f32>,
    /// Twist of the cell that begins at a point.
    pub twist: Vec<f32>,
    /// The ground less the surface, in the cell that begins at a point.
    pub rest: Extremes,
    /// The ground, smoothed as far as suits the spacing, all over the window.
    smooth: Vec<f32>,
    finer: Vec<f32>,
    points: Vec<f32>,
    rows: [Vec<f32>; 6],
}

impl Grid {
    /// Points along a side, which is the planes' stride.
    pub(super) fn stride(&self) -> usize {
        self.cells + 1
    }

    /// Begins with the ground itself, a point a sample.
    pub(super) fn begin(&mut self) {
        self.spacing = 1;
    }

    /// Goes on to a grid of twice the spacing, whose points are means of those around them with the
    /// weights 1 4 6 4 1 in x and z, in whole sixteenths: few enough bits that second differences
    /// are exact.
    #[inline(always)]
    pub(super) fn coarsen(&mut self, window: &Window) {
        let side = (SIDE - 1) / self.spacing + 1;
        self.spacing *= 2;
        let half = (side - 1) / 2 + 1;
        std::mem::swap(&mut self.smooth, &mut self.finer);
        self.smooth.resize(half * half, 0.0);
        let sum = &mut self.rows[0];
        // What lies at the window's border is never used.
        sum.resize(SIDE + 4, 0.0);
        let finer = if self.spacing == 2 {
            &window.heights
        } else {
            &self.finer
        };
        let row = |z: usize| &finer[z.clamp(2, side + 1) * side - 2 * side..][..side];
        for z in 0..half {
            let five: [&[f32]; 5] = std::array::from_fn(|number| row(2 * z + number));
            let [a, b, c, d, e] = five;
            for (x, sum) in sum[2..side + 2].iter_mut().enumerate() {
                *sum = (a[x] + e[x]) + 4.0 * (b[x] + d[x]) + 6.0 * c[x];
            }
            (sum[0], sum[1]) = (sum[2], sum[2]);
            (sum[side + 2], sum[side + 3]) = (sum[side + 1], sum[side + 1]);
            let sum = &sum[..side + 4];
            let out = &mut self.smooth[z * half..][..half];
            for (out, s) in out.iter_mut().zip(sum.windows(5).step_by(2)) {
                let mean = (s[0] + s[4]) + 4.0 * (s[1] + s[3]) + 6.0 * s[2];
                // Adding this and taking it off again leaves a whole number.
                const WHOLE: f32 = 12_582_912.0;
                *out = ((mean * (1.0 / 16.0) + WHOLE) - WHOLE) * (1.0 / 16.0);
            }
        }
    }

    /// Measures the part of the window that lies at most `margin` samples from the tile.
    #[inline(always)]
    pub(super) fn measure(&mut self, window: &Window, margin: usize) {
        let spacing = self.spacing;
        let origin = MARGIN - margin;
        let cells = (SIDE - 1 - 2 * origin) / spacing;
        let stride = cells + 1;
        self.cells = cells;
        let (side, first) = ((SIDE - 1) / spacing + 1, origin / spacing);
        self.points.clear();
        let smooth = if spacing == 1 {
            &window.heights
        } else {
            &self.smooth
        };
        for row in smooth.chunks_exact(side).skip(first).take(stride) {
            self.points.extend_from_slice(&row[first..first + stride]);
        }
        for plane in [&mut self.bend_x, &mut self.bend_z, &mut self.twist] {
            plane.clear();
            plane.resize(stride * stride, 0.0);
        }
        let [columns, rows] =
            [0, 1].map(|axis| window.cells_on_terrain(axis, origin, spacing, cells));
        if columns.is_empty() || rows.is_empty() {
            self.rest.reset(stride * stride, NOTHING);
            return;
        }
        let point = |row: usize| &self.points[row * stride..][..stride];
        // A kink counts where its line runs inside of the window and of the terrain.
        let (from, to) = (columns.start.max(1), columns.end);
        let width = to.saturating_sub(from);
        for row in rows.start..=rows.end {
            let heights = &point(row)[from - 1..];
            let (west, here, east) = (&heights[..width], &heights[1..], &heights[2..]);
            let out = &mut self.bend_x[row * stride + from..][..width];
            for x in 0..width {
                out[x] = (west[x] - here[x]) + (east[x] - here[x]);
            }
        }
        let width = columns.len();
        let part = |row: usize, shift: usize| &point(row)[columns.start + shift..][..width];
        for row in rows.start.max(1)..rows.end {
            let (north, here, south) = (
                &point(row - 1)[columns.start..][..=width],
                &point(row)[columns.start..][..=width],
                &point(row + 1)[columns.start..][..=width],
            );
            let out = &mut self.bend_z[row * stride + columns.start..][..=width];
            for x in 0..=width {
                out[x] = (north[x] - here[x]) + (south[x] - here[x]);
            }
        }
        for row in rows.clone() {
            let (a, b) = (part(row, 0), part(row, 1));
            let (c, d) = (part(row + 1, 0), part(row + 1, 1));
            let out = &mut self.twist[row * stride + columns.start..][..width];
            for x in 0..width {
                out[x] = (a[x] - b[x]) + (d[x] - c[x]);
            }
        }
        self.rest.reset(stride * stride, NOTHING);
        if spacing > 1 {
            self.measure_rest(window, origin, [columns, rows]);
        }
    }

    #[inline(always)]
    fn measure_rest(&mut self, window: &Window, origin: usize, [columns, rows]: [Range<usize>; 2]) {
        let (spacing, stride) = (self.spacing, self.cells + 1);
        let width = columns.len() * spacing + 1;
        let part = 1.0 / spacing as f32;
        let [above, below, step, high, low, spare] = &mut self.rows;
        for row in [&mut *above, below, step, high, low, spare] {
            row.resize(SIDE, 0.0);
        }
        let points = &self.points;
        let spread = |row: usize, out: &mut [f32]| {
            let points = &points[row * stride + columns.start..][..=columns.len()];
            for (pair, out) in points.windows(2).zip(out.chunks_exact_mut(spacing)) {
                let step = (pair[1] - pair[0]) * part;
                for (number, out) in out.iter_mut().enumerate() {
                    *out = pair[0] + step * number as f32;
                }
            }
            out[width - 1] = points[columns.len()];
        };
        spread(rows.start, below);
        for row in rows {
            std::mem::swap(above, below);
            spread(row + 1, below);
            let above = &above[..width];
            for ((step, &above), &below) in step.iter_mut().zip(above).zip(&below[..width]) {
                *step = (below - above) * part;
            }
            let (step, high, low) = (&step[..width], &mut high[..width], &mut low[..width]);
            high.fill(NOTHING);
            low.fill(-NOTHING);
            for number in 0..=spacing {
                let first = (origin + row * spacing + number) * SIDE;
                let heights = &window.heights[first + origin + columns.start * spacing..][..width];
                let number = number as f32;
                for x in 0..width {
                    let rest = heights[x] - (above[x] + step[x] * number);
                    high[x] = larger(high[x], rest);
                    low[x] = smaller(low[x], rest);
                }
            }
            let first = row * stride + columns.start;
            let cells = first..first + columns.len();
            runs::<true>(high, spare, spacing, &mut self.rest.high[cells.clone()]);
            runs::<false>(low, spare, spacing, &mut self.rest.low[cells]);
        }
    }

    /// Cells of twice the spacing. A cell has the lines in its west and north, and no other border;
    /// where lines cross its borders, it has all of them.
    #[inline(always)]
    pub(super) fn halve(&self, out: &mut Cells) {
        let (stride, side) = (self.cells + 1, self.cells / 2);
        out.side = side;
        for (plane, extremes, reach) in [
            (&self.bend_x, &mut out.bend_x, [2, 3]),
            (&self.bend_z, &mut out.bend_z, [3, 2]),
            (&self.twist, &mut out.twist, [2, 2]),
        ] {
            extremes.reset(side * side, 0.0);
            pairs::<true>(plane, stride, reach, side, &mut extremes.high);
            pairs::<false>(plane, stride, reach, side, &mut extremes.low);
        }
        self.rest.halve(&mut out.rest, stride, side);
    }
}

/// The ground's own lowest and highest in cells of two samples, as far as boxes reach.
#[inline(always)]
pub(super) fn measure_range(window: &Window, out: &mut Extremes) -> usize {
    let origin = MARGIN - REACH;
    let side = (SIDE - 1) / 2 - origin;
    out.reset(side * side, NOTHING);
    let [columns, rows] = [0, 1].map(|axis| window.cells_on_terrain(axis, origin, 2, side));
    if columns.is_empty() {
        return side;
    }
    let width = 2 * columns.len() + 1;
    let mut column = [[0.0_f32; SIDE]; 2];
    let [high, low] = &mut column;
    for z in rows {
        let start = origin + 2 * columns.start;
        let row =
            |number: usize| &window.heights[(origin + 2 * z + number) * SIDE + start..][..width];
        let (above, middle, below) = (row(0), row(1), row(2));
        let (high, low) = (&mut high[..width], &mut low[..width]);
        for x in 0..width {
            high[x] = larger(larger(above[x], middle[x]), below[x]);
            low[x] = smaller(smaller(above[x], middle[x]), below[x]);
        }
        let first = z * side + columns.start;
        let cells = first..first + columns.len();
        pairs::<true>(
            high,
            width,
            [3, 1],
            columns.len(),
            &mut out.high[cells.clone()],
        );
        pairs::<false>(low, width, [3, 1], columns.len(), &mut out.low[cells]);
    }
    side
}

/// [`Extremes`] of cells of twice the side.
#[inline(always)]
pub(super) fn halve_range(fine: &Extremes, side: usize, out: &mut Extremes) -> usize {
    fine.halve(out, side, side / 2);
    side / 2
}

/// For cells of `spacing` values each, the largest (or smallest) of their own and the next one's first.
#[inline(always)]
fn runs<const HIGH: bool>(row: &mut [f32], spare: &mut [f32], spacing: usize, out: &mut [f32]) {
    // Of one value, of two from each on, of four, and so on.
    let mut length = row.len();
    let mut reach = 1;
    while reach < spacing {
        length -= reach;
        let both = row.iter().zip(&row[reach..]);
        for (spare, (&a, &b)) in spare[..length].iter_mut().zip(both) {
            *spare = pick::<HIGH>(a, b);
        }
        row[..length].copy_from_slice(&spare[..length]);
        reach *= 2;
    }
    for (cell, out) in out.iter_mut().enumerate() {
        *out = pick::<HIGH>(row[cell * spacing], row[cell * spacing + 1]);
    }
}

/// The larger or the smaller one.
#[inline(always)]
pub(super) fn pick<const HIGH: bool>(a: f32, b: f32) -> f32 {
    if HIGH { larger(a, b) } else { smaller(a, b) }
}

/// A comparison that is one instruction.
#[inline(always)]
pub(super) fn larger(a: f32, b: f32) -> f32 {
    if b > a { b } else { a }
}

/// A comparison that is one instruction.
#[inline(always)]
pub(super) fn smaller(a: f32, b: f32) -> f32 {
    if b < a { b } else { a }
}
