//! The heights that a tile's bounds follow from.

use super::ERROR_REACH;
use super::boxes::PAD;
use crate::tile::TILE_SAMPLES;

/// Samples before a tile's first own one.
pub(super) const MARGIN: usize = ERROR_REACH as usize;
/// Samples along a window's side.
pub(super) const SIDE: usize = TILE_SAMPLES as usize + 2 * MARGIN + 1;
/// How far beyond the rim the grids need heights: a cell of the widest that begins on the terrain
/// ends at most 15 samples outside, and its points are means of what lies at most 30 further.
const BEYOND: i64 = 48;
/// What heights beyond the rim are clamped to: twice a height less another lies within.
const LOWEST: f32 = -65_536.0;
const HIGHEST: f32 = 131_071.0;

/// Heights of a tile and [`MARGIN`] samples around it, in steps of stored heights.
#[derive(Clone, Debug, Default)]
pub(super) struct Window {
    /// [`SIDE`]² heights, row by row, and what vectors may reach beyond them.
    pub heights: Vec<f32>,
    /// The first and the last sample on the terrain in x and z, counted from the window's first;
    /// they may lie outside of it.
    pub terrain: [[i64; 2]; 2],
    spare: [Vec<f32>; 2],
}

/// A height on or beyond the rim as a sum: `sign · h(at) + last · h(n) + first · h(0)`. Beyond the
/// rim the ground is turned about it by half a turn, so that planes stay planes and slopes go on.
#[derive(Clone, Copy)]
struct Place {
    sign: f32,
    at: u32,
    last: f32,
    first: f32,
}

impl Place {
    /// Of sample `at` where the last one is `last`.
    fn new(at: i64, last: i64) -> Self {
        let at = at.clamp(-BEYOND, last + BEYOND);
        let (turns, rest) = (at.div_euclid(2 * last), at.rem_euclid(2 * last));
        let turned = rest > last;
        let turns = (2 * turns) as f32;
        Self {
            sign: if turned { -1.0 } else { 1.0 },
            at: if turned { 2 * last - rest } else { rest } as u32,
            last: turns + if turned { 2.0 } else { 0.0 },
            first: -turns,
        }
    }

    fn is_inside(self) -> bool {
        self.sign > 0.0 && self.last == 0.0
    }
}

/// Columns of a window, the first of them column `start` of a level whose last one is `last`.
#[derive(Clone, Copy)]
struct Columns {
    start: i64,
    last: i64,
}

impl Columns {
    /// Takes a row of the level: the part on the terrain, then what lies beyond either end.
    #[inline(always)]
    fn load(self, row: &[u16], out: &mut [f32]) {
        let Self { start, last } = self;
        let from = (-start).clamp(0, SIDE as i64);
        let to = (last - start + 1).clamp(from, SIDE as i64);
        let inside = &row[(start + from) as usize..(start + to) as usize];
        for (out, &height) in out[from as usize..to as usize].iter_mut().zip(inside) {
            *out = f32::from(height);
        }
        if inside.len() < SIDE {
            self.load_beyond(row, out, [from, to]);
        }
    }

    /// Takes all but the columns `inside`, which lie on the terrain.
    fn load_beyond(self, row: &[u16], out: &mut [f32], inside: [i64; 2]) {
        let height = |at: u32| f32::from(row[at as usize]);
        for at in (0..inside[0]).chain(inside[1]..SIDE as i64) {
            let place = Place::new(self.start + at, self.last);
            let sum = place.sign * height(place.at)
                + place.last * height(self.last as u32)
                + place.first * height(0);
            out[at as usize] = sum.clamp(LOWEST, HIGHEST);
        }
    }
}

impl Window {
    /// Fills the window of the tile whose first own sample is `first`, of a level with `samples`
    /// samples. `row(z)` gives the level's rows.
    #[inline(always)]
    pub(super) fn fill<'a>(
        &mut self,
        samples: [u32; 2],
        first: [u32; 2],
        row: impl Fn(u32) -> &'a [u16],
    ) {
        self.heights.resize(SIDE * SIDE + PAD, 0.0);
        let start = first.map(|first| i64::from(first) - MARGIN as i64);
        let last = samples.map(|samples| i64::from(samples) - 1);
        self.terrain = [0, 1].map(|axis| [-start[axis], last[axis] - start[axis]]);
        let columns = Columns {
            start: start[0],
            last: last[0],
        };
        let [last_row, first_row] = &mut self.spare;
        for row in [&mut *last_row, &mut *first_row] {
            row.resize(SIDE, 0.0);
        }
        for (out, z) in self.heights.chunks_exact_mut(SIDE).zip(start[1]..) {
            let place = Place::new(z, last[1]);
            columns.load(row(place.at), out);
            if place.is_inside() {
                continue;
            }
            // Rows far off are asked for only where they count.
            for (far, weight, z) in [
                (&mut *last_row, place.last, last[1]),
                (&mut *first_row, place.first, 0),
            ] {
                if weight == 0.0 {
                    far.fill(0.0);
                } else {
                    columns.load(row(z as u32), far);
                }
            }
            for ((out, &last), &first) in out.iter_mut().zip(&*last_row).zip(&*first_row) {
                let sum = place.sign * *out + place.last * last + place.first * first;
                *out = sum.clamp(LOWEST, HIGHEST);
            }
        }
    }

    /// Which of `cells` cells in a row with sides of `side` samples, the first of them beginning at
    /// sample `origin` of the window, begin on the terrain and before its last sample.
    pub(super) fn cells_on_terrain(
        &self,
        axis: usize,
        origin: usize,
        side: usize,
        cells: usize,
    ) -> std::ops::Range<usize> {
        let [first, last] = self.terrain[axis].map(|sample| sample - origin as i64);
        let cell = |sample: i64| {
            let side = side as i64;
            ((sample + side - 1).div_euclid(side)).clamp(0, cells as i64) as usize
        };
        let start = cell(first);
        start..cell(last).max(start)
    }
}
