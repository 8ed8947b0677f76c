//! The diamond-square algorithm, level by level.
//!
//! Every level is made from the one above it as a new grid. A row of it depends on nothing but two
//! rows above and on hashes of positions, so that all rows are made at once and in any order.

use super::hash::{fold, signed_unit};
use rayon::prelude::*;
use std::collections::TryReserveError;

/// Pairs of rows that one task makes: enough that making the row of centres above the first pair
/// twice costs little.
const TASK_PAIRS: usize = 16;

/// A square grid whose sides have `cells + 1` heights.
pub(super) struct Grid {
    cells: usize,
    heights: Vec<f32>,
}

/// What one iteration adds.
#[derive(Clone, Copy)]
struct Iteration {
    key: u64,
    displacement: f32,
    wrap: bool,
}

impl Iteration {
    /// A displacement of the point (`x`, `z`) of the finer grid.
    fn rand(&self, x: usize, z: usize) -> f32 {
        self.displacement * signed_unit(fold(self.key, (z as u64) << 32 | x as u64))
    }
}

impl Grid {
    /// Makes a grid of `cells` (a power of two) cells a side, whose displacements shrink by `gain`
    /// an iteration. Where it wraps, opposite edges are equal.
    pub(super) fn generate(
        cells: usize,
        seed: u64,
        gain: f64,
        wrap: bool,
    ) -> Result<Self, TryReserveError> {
        let corner = |x: u64, z: u64| {
            let at = if wrap { 0 } else { z << 1 | x };
            signed_unit(fold(fold(seed, 0), at))
        };
        let mut grid = Self::zero(1)?;
        grid.heights = vec![corner(0, 0), corner(1, 0), corner(0, 1), corner(1, 1)];
        let mut displacement = 1.0;
        let mut level = 1;
        while grid.cells < cells {
            grid = grid.finer(Iteration {
                key: fold(seed, level),
                displacement: displacement as f32,
                wrap,
            })?;
            displacement *= gain;
            level += 1;
        }
        Ok(grid)
    }

    fn zero(cells: usize) -> Result<Self, TryReserveError> {
        let count = (cells + 1) * (cells + 1);
        let mut heights = Vec::new();
        heights.try_reserve_exact(count)?;
        heights.resize(count, 0.0);
        Ok(Self { cells, heights })
    }

    /// A row of heights.
    pub(super) fn row(&self, z: usize) -> &[f32] {
        let width = self.cells + 1;
        &self.heights[z * width..][..width]
    }

    /// The lowest and the highest height.
    pub(super) fn range(&self) -> [f32; 2] {
        // A total order, so that the two zeros can't be told apart by the order of the threads.
        let low = |a: f32, b: f32| if b.total_cmp(&a).is_lt() { b } else { a };
        let high = |a: f32, b: f32| if b.total_cmp(&a).is_gt() { b } else { a };
        self.heights
            .par_chunks(1 << 16)
            .map(|chunk| {
                chunk
                    .iter()
                    .fold([f32::INFINITY, f32::NEG_INFINITY], |range, &height| {
                        [low(range[0], height), high(range[1], height)]
                    })
            })
            .reduce(
                || [f32::INFINITY, f32::NEG_INFINITY],
                |a, b| [low(a[0], b[0]), high(a[1], b[1])],
            )
    }

    /// One iteration: a grid of twice the cells.
    fn finer(&self, iteration: Iteration) -> Result<Self, TryReserveError> {
        let mut fine = Self::zero(2 * self.cells)?;
        let width = fine.cells + 1;
        fine.heights
            .par_chunks_mut(2 * width * TASK_PAIRS)
            .enumerate()
            .for_each(|(task, rows)| {
                let first = task * TASK_PAIRS;
                let mut above = self.centres(first.checked_sub(1), iteration);
                for (k, pair) in (first..).zip(rows.chunks_mut(2 * width)) {
                    let below = self.centres(Some(k), iteration);
                    let (even, odd) = pair.split_at_mut(width);
                    self.even_row(k, above.as_deref(), below.as_deref(), iteration, even);
                    if let Some(centres) = &below
                        && !odd.is_empty()
                    {
                        self.odd_row(k, centres, iteration, odd);
                    }
                    above = below;
                }
            });
        Ok(fine)
    }

    /// The diamond step for a row of cells: their centres. `None` beyond the grid's edges, unless
    /// it wraps.
    fn centres(&self, row: Option<usize>, iteration: Iteration) -> Option<Vec<f32>> {
        let k = match row {
            Some(k) if k < self.cells => k,
            _ if !iteration.wrap => return None,
            Some(_) => 0,
            None => self.cells - 1,
        };
        let (north, south) = (self.row(k), self.row(k + 1));
        let centre = |j: usize| {
            let mean = (north[j] + north[j + 1] + south[j] + south[j + 1]) * 0.25;
            mean + iteration.rand(2 * j + 1, 2 * k + 1)
        };
        Some((0..self.cells).map(centre).collect())
    }

    /// The finer row that lies on row `k`: its heights, and the square step between them.
    fn even_row(
        &self,
        k: usize,
        above: Option<&[f32]>,
        below: Option<&[f32]>,
        iteration: Iteration,
        fine: &mut [f32],
    ) {
        let row = self.row(k);
        // Where the grid wraps, its last row is its first one.
        let z = if iteration.wrap { k % self.cells } else { k };
        for (j, ends) in row.windows(2).enumerate() {
            let sides = ends[0] + ends[1];
            let mean = match (above, below) {
                (Some(above), Some(below)) => (sides + above[j] + below[j]) * 0.25,
                (Some(only), None) | (None, Some(only)) => (sides + only[j]) / 3.0,
                (None, None) => sides * 0.5,
            };
            fine[2 * j] = ends[0];
            fine[2 * j + 1] = mean + iteration.rand(2 * j + 1, 2 * z);
        }
        fine[2 * self.cells] = row[self.cells];
    }

    /// The finer row that runs through the `centres` below row `k`: the centres, and the square
    /// step between them.
    fn odd_row(&self, k: usize, centres: &[f32], iteration: Iteration, fine: &mut [f32]) {
        let (north, south) = (self.row(k), self.row(k + 1));
        let last = self.cells - 1;
        for j in 0..=self.cells {
            let ends = north[j] + south[j];
            let inside = j > 0 && j <= last;
            let mean = if inside {
                (ends + centres[j - 1] + centres[j]) * 0.25
            } else if iteration.wrap {
                (ends + centres[last] + centres[0]) * 0.25
            } else {
                (ends + centres[j.min(last)]) / 3.0
            };
            let x = if iteration.wrap { j % self.cells } else { j };
            fine[2 * j] = mean + iteration.rand(2 * x, 2 * k + 1);
        }
        for (j, &centre) in centres.iter().enumerate() {
            fine[2 * j + 1] = centre;
        }
    }
}
