//! The ground seen on a coarser grid: how that bends, and how far the ground is from it.

use super::REACH;
use super::boxes::PAD;
use super::window::{MARGIN, SIDE, Window};
use pulp::Simd;
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
    /// Both planes, the high one first.
    #[inline(always)]
    pub(super) fn planes(&self) -> [&[f32]; 2] {
        [&self.high, &self.low]
    }

    fn resize(&mut self, length: usize) {
        for plane in [&mut self.high, &mut self.low] {
            plane.resize(length + PAD, 0.0);
        }
    }

    /// Extremes of nothing in all cells.
    fn clear(&mut self) {
        self.high.fill(NOTHING);
        self.low.fill(-NOTHING);
    }

    /// The extremes of cells of twice the side, from planes with `stride` cells a row.
    #[inline(always)]
    fn halve(&self, out: &mut Self, stride: usize, side: usize) {
        out.resize(side * side);
        halve::<true>(&self.high, stride, side, &mut out.high);
        halve::<false>(&self.low, stride, side, &mut out.low);
    }
}

/// The largest (or smallest) of two by two values, from every second one on in x and z.
#[inline(always)]
fn halve<const HIGH: bool>(plane: &[f32], stride: usize, side: usize, out: &mut [f32]) {
    let mut column = [0.0_f32; SIDE];
    let column = &mut column[..2 * side];
    for (z, out) in out.chunks_exact_mut(side).take(side).enumerate() {
        fold_rows::<HIGH, 2>(plane, stride, 2 * z, column);
        fold_pairs::<HIGH>(column, out);
    }
}

/// The largest (or smallest) of `R` rows' values from `row` on, column by column.
#[inline(always)]
fn fold_rows<const HIGH: bool, const R: usize>(
    plane: &[f32],
    stride: usize,
    row: usize,
    out: &mut [f32],
) {
    let width = out.len();
    let first = &plane[row * stride..][..width];
    if R == 1 {
        out.copy_from_slice(first);
        return;
    }
    let second = &plane[(row + 1) * stride..][..width];
    if R == 2 {
        for ((out, &a), &b) in out.iter_mut().zip(first).zip(second) {
            *out = pick::<HIGH>(a, b);
        }
        return;
    }
    let third = &plane[(row + 2) * stride..][..width];
    for (((out, &a), &b), &c) in out.iter_mut().zip(first).zip(second).zip(third) {
        *out = pick::<HIGH>(pick::<HIGH>(a, b), c);
    }
}

/// The larger (or smaller) of the first two values, of the next two, and so on.
#[inline(always)]
fn fold_pairs<const HIGH: bool>(row: &[f32], out: &mut [f32]) {
    for (out, pair) in out.iter_mut().zip(row.chunks_exact(2)) {
        *out = pick::<HIGH>(pair[0], pair[1]);
    }
}

/// The same of three values, of which the third is the next ones' first: `row` is one longer.
#[inline(always)]
fn fold_threes<const HIGH: bool>(row: &[f32], out: &mut [f32]) {
    let pairs = row.chunks_exact(2).zip(row[1..].chunks_exact(2));
    for (out, (first, last)) in out.iter_mut().zip(pairs) {
        *out = pick::<HIGH>(pick::<HIGH>(first[0], first[1]), last[1]);
    }
}

/// What bounds the error in a cell of two steps: by how much the surface turns at the grid's lines in x
/// and in z, how much it twists, and how far the ground is from it.
#[derive(Clone, Debug, Default)]
pub(super) struct Cells {
    /// Cells along a side of the square.
    pub side: usize,
    /// At the line in the cell's middle; and at that in its west, too. Never at that in its east,
    /// which the next cell has. So a box has all lines in it without those at its rim.
    pub bend_x: [Extremes; 2],
    /// The same in the middle and in the north.
    pub bend_z: [Extremes; 2],
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
    /// Second differences at points, 0 where the line through it is no ground's inside. At the planes'
    /// rims, they are never used.
    pub bend_x: Vec<f32>,
    pub bend_z: Vec<f32>,
    /// Twist of the cell that begins at a point.
    pub twist: Vec<f32>,
    /// The ground less the surface, in the cell that begins at a point.
    pub rest: Extremes,
    /// The ground, smoothed as far as suits the spacing, all over the window.
    smooth: Vec<f32>,
    finer: Vec<f32>,
    sum: Vec<f32>,
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
        let sum = &mut self.sum;
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

    /// Measures the part of the window that lies at most `margin` samples from the tile. `SPACING` is
    /// the grid's.
    #[inline(always)]
    pub(super) fn measure<S: Simd, const SPACING: usize>(
        &mut self,
        simd: S,
        window: &Window,
        margin: usize,
    ) {
        let origin = MARGIN - margin;
        let cells = (SIDE - 1 - 2 * origin) / SPACING;
        let stride = cells + 1;
        self.cells = cells;
        let [columns, rows] =
            [0, 1].map(|axis| window.cells_on_terrain(axis, origin, SPACING, cells));
        let all = columns.len() == cells && rows.len() == cells;
        for plane in [&mut self.bend_x, &mut self.bend_z, &mut self.twist] {
            plane.resize(stride * stride + PAD, 0.0);
            if !all {
                plane.fill(0.0);
            }
        }
        if SPACING > 1 {
            self.rest.resize(stride * stride);
            if !all {
                self.rest.clear();
            }
        }
        if columns.is_empty() || rows.is_empty() {
            return;
        }
        let points = Points {
            heights: if SPACING == 1 {
                &window.heights
            } else {
                &self.smooth
            },
            side: (SIDE - 1) / SPACING + 1,
            first: origin / SPACING,
        };
        // A kink counts where its line runs on the terrain's inside.
        let (from, to) = (columns.start.max(1), columns.end);
        for row in rows.start..=rows.end {
            let out = row * stride + from..row * stride + to.max(from);
            let west = points.row(row, from - 1, out.len());
            let here = points.row(row, from, out.len());
            let east = points.row(row, from + 1, out.len());
            bend([west, here, east], &mut self.bend_x[out]);
        }
        for row in rows.start.max(1)..rows.end {
            let out = row * stride + columns.start..row * stride + columns.end + 1;
            let north = points.row(row - 1, columns.start, out.len());
            let here = points.row(row, columns.start, out.len());
            let south = points.row(row + 1, columns.start, out.len());
            bend([north, here, south], &mut self.bend_z[out]);
        }
        for row in rows.clone() {
            let out = row * stride + columns.start..row * stride + columns.end;
            let a = points.row(row, columns.start, out.len());
            let b = points.row(row, columns.start + 1, out.len());
            let c = points.row(row + 1, columns.start, out.len());
            let d = points.row(row + 1, columns.start + 1, out.len());
            let out = &mut self.twist[out];
            for ((((out, a), b), c), d) in out.iter_mut().zip(a).zip(b).zip(c).zip(d) {
                *out = (a - b) + (d - c);
            }
        }
        if SPACING > 1 {
            measure_rest::<S, SPACING>(
                simd,
                window,
                &points,
                [columns, rows],
                stride,
                &mut self.rest,
            );
        }
    }

    /// Cells of two steps.
    #[inline(always)]
    pub(super) fn halve(&self, out: &mut Cells, with_rest: bool) {
        let (stride, side) = (self.cells + 1, self.cells / 2);
        out.side = side;
        for extremes in out.bend_x.iter_mut().chain(&mut out.bend_z) {
            extremes.resize(side * side);
        }
        for z in 0..side {
            let cells = z * side..(z + 1) * side;
            let [middle, all] = &mut out.bend_x;
            halve_x::<true>(
                (&self.bend_x, stride, 2 * z),
                &mut middle.high[cells.clone()],
                &mut all.high[cells.clone()],
            );
            halve_x::<false>(
                (&self.bend_x, stride, 2 * z),
                &mut middle.low[cells.clone()],
                &mut all.low[cells.clone()],
            );
            let [middle, all] = &mut out.bend_z;
            halve_z::<true>(
                (&self.bend_z, stride, 2 * z),
                &mut middle.high[cells.clone()],
                &mut all.high[cells.clone()],
            );
            halve_z::<false>(
                (&self.bend_z, stride, 2 * z),
                &mut middle.low[cells.clone()],
                &mut all.low[cells],
            );
        }
        out.twist.resize(side * side);
        halve::<true>(&self.twist, stride, side, &mut out.twist.high);
        halve::<false>(&self.twist, stride, side, &mut out.twist.low);
        if with_rest {
            self.rest.halve(&mut out.rest, stride, side);
        }
    }
}

/// The extremes of kinks in x, from a plane, its stride and a row: at the lines in the cells' middle,
/// and at those in the west, too, from one row of cells' north to its south.
#[inline(always)]
fn halve_x<const HIGH: bool>(
    (plane, stride, row): (&[f32], usize, usize),
    middle: &mut [f32],
    all: &mut [f32],
) {
    let mut column = [0.0_f32; SIDE];
    let column = &mut column[..2 * middle.len()];
    fold_rows::<HIGH, 3>(plane, stride, row, column);
    fold_pairs::<HIGH>(column, all);
    for (out, pair) in middle.iter_mut().zip(column.chunks_exact(2)) {
        *out = pair[1];
    }
}

/// The same of kinks in z.
#[inline(always)]
fn halve_z<const HIGH: bool>(
    (plane, stride, row): (&[f32], usize, usize),
    middle: &mut [f32],
    all: &mut [f32],
) {
    let mut column = [0.0_f32; SIDE];
    let column = &mut column[..2 * middle.len() + 1];
    fold_rows::<HIGH, 1>(plane, stride, row + 1, column);
    fold_threes::<HIGH>(column, middle);
    fold_rows::<HIGH, 2>(plane, stride, row, column);
    fold_threes::<HIGH>(column, all);
}

/// A grid's points from `first` on in x and z.
struct Points<'a> {
    heights: &'a [f32],
    side: usize,
    first: usize,
}

impl Points<'_> {
    #[inline(always)]
    fn row(&self, row: usize, column: usize, length: usize) -> &[f32] {
        &self.heights[(self.first + row) * self.side + self.first + column..][..length]
    }
}

/// Second differences.
#[inline(always)]
fn bend([before, here, after]: [&[f32]; 3], out: &mut [f32]) {
    for (((out, before), here), after) in out.iter_mut().zip(before).zip(here).zip(after) {
        *out = (before - here) + (after - here);
    }
}

/// Room for a row of samples in whole vectors.
const ROOM: usize = SIDE + PAD;

/// The extremes of the ground less the surface through `points` in those of its cells that begin in
/// `columns` and `rows`.
#[inline(always)]
fn measure_rest<S: Simd, const SPACING: usize>(
    simd: S,
    window: &Window,
    points: &Points<'_>,
    [columns, rows]: [Range<usize>; 2],
    stride: usize,
    rest: &mut Extremes,
) {
    let count = columns.len();
    let vectors = (count * SPACING + 1).div_ceil(S::F32_LANES);
    let origin = points.first * SPACING;
    let (mut above, mut below) = ([0.0_f32; ROOM], [0.0_f32; ROOM]);
    let (mut high, mut low) = ([0.0_f32; ROOM], [0.0_f32; ROOM]);
    spread::<SPACING>(points.row(rows.start, columns.start, count + 1), &mut below);
    for row in rows {
        std::mem::swap(&mut above, &mut below);
        spread::<SPACING>(points.row(row + 1, columns.start, count + 1), &mut below);
        let first = (origin + row * SPACING) * SIDE + origin + columns.start * SPACING;
        let above = &S::as_simd_f32s(&above).0[..vectors];
        let below = &S::as_simd_f32s(&below).0[..vectors];
        let high_of = &mut S::as_mut_simd_f32s(&mut high).0[..vectors];
        let low_of = &mut S::as_mut_simd_f32s(&mut low).0[..vectors];
        for x in 0..vectors {
            let block = &window.heights[first + x * S::F32_LANES..];
            // All rows of the block at once, so that no more is checked within.
            let block = &block[..SPACING * SIDE + S::F32_LANES];
            let part = simd.splat_f32s(1.0 / SPACING as f32);
            let step = simd.mul_f32s(simd.sub_f32s(below[x], above[x]), part);
            let mut most = simd.splat_f32s(NOTHING);
            let mut least = simd.splat_f32s(-NOTHING);
            for number in 0..=SPACING {
                let height = S::as_simd_f32s(&block[number * SIDE..][..S::F32_LANES]).0[0];
                let surface = simd.mul_f32s(step, simd.splat_f32s(number as f32));
                let rest = simd.sub_f32s(height, simd.add_f32s(above[x], surface));
                most = simd.max_f32s(most, rest);
                least = simd.min_f32s(least, rest);
            }
            (high_of[x], low_of[x]) = (most, least);
        }
        let first = row * stride + columns.start;
        let cells = first..first + count;
        runs::<true, SPACING>(&high, &mut rest.high[cells.clone()]);
        runs::<false, SPACING>(&low, &mut rest.low[cells]);
    }
}

/// A row of points as straight lines between them, of `SPACING` samples each.
#[inline(always)]
fn spread<const SPACING: usize>(points: &[f32], out: &mut [f32; ROOM]) {
    let part = 1.0 / SPACING as f32;
    let (pieces, _) = out.as_chunks_mut::<SPACING>();
    for (pair, out) in points.windows(2).zip(pieces) {
        let step = (pair[1] - pair[0]) * part;
        for (number, out) in out.iter_mut().enumerate() {
            *out = pair[0] + step * number as f32;
        }
    }
    out[SPACING * (points.len() - 1)] = points[points.len() - 1];
}

/// The ground's own lowest and highest in cells of two samples, as far as boxes reach.
#[inline(always)]
pub(super) fn measure_range(window: &Window, out: &mut Extremes) -> usize {
    let origin = MARGIN - REACH;
    let side = (SIDE - 1) / 2 - origin;
    out.resize(side * side);
    let [columns, rows] = [0, 1].map(|axis| window.cells_on_terrain(axis, origin, 2, side));
    if columns.len() < side || rows.len() < side {
        out.clear();
    }
    if columns.is_empty() {
        return side;
    }
    let mut column = [0.0_f32; SIDE];
    let column = &mut column[..2 * columns.len() + 1];
    let start = origin + 2 * columns.start;
    let heights = &window.heights[start..];
    for z in rows {
        let first = z * side + columns.start;
        let cells = first..first + columns.len();
        fold_rows::<true, 3>(heights, SIDE, origin + 2 * z, column);
        fold_threes::<true>(column, &mut out.high[cells.clone()]);
        fold_rows::<false, 3>(heights, SIDE, origin + 2 * z, column);
        fold_threes::<false>(column, &mut out.low[cells]);
    }
    side
}

/// [`Extremes`] of cells of twice the side.
#[inline(always)]
pub(super) fn halve_range(fine: &Extremes, side: usize, out: &mut Extremes) -> usize {
    fine.halve(out, side, side / 2);
    side / 2
}

/// For cells of `SPACING` values each, the largest (or smallest) of their own and the next one's first.
#[inline(always)]
fn runs<const HIGH: bool, const SPACING: usize>(row: &[f32; ROOM], out: &mut [f32]) {
    // Of one value, of two from each on, of four, and so on: into another row, as loops that change a
    // row in its place come out slower.
    let (mut first, mut second) = ([0.0_f32; ROOM], [0.0_f32; ROOM]);
    first[..ROOM].copy_from_slice(row);
    let (mut row, mut spare) = (&mut first, &mut second);
    let width = SPACING * out.len() + 1;
    let mut reach = 1;
    while reach < SPACING {
        let pairs = row[..width].iter().zip(&row[reach..]);
        for (out, (&a, &b)) in spare.iter_mut().zip(pairs) {
            *out = pick::<HIGH>(a, b);
        }
        std::mem::swap(&mut row, &mut spare);
        reach *= 2;
    }
    for (out, cell) in out.iter_mut().zip(row.windows(2).step_by(SPACING)) {
        *out = pick::<HIGH>(cell[0], cell[1]);
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
