//! Densities of whole tiles, their spreading, and the coarser levels.

use super::kernel::{DensityKernel, DensityScratch, DensityWindow};
use super::{DensityBorder, DensitySettings};
use crate::tile::{DENSITY_CELL, DENSITY_TEXELS, TILE_BORDER, TILE_SAMPLES};
use std::ops::Range;

const CELL: u32 = DENSITY_CELL;

/// Rows of a level's stored heights, or the part of them that matters.
pub struct DensityRows<F> {
    /// The level's samples in x and z.
    pub samples: [u32; 2],
    /// The column of the first height of every row.
    pub first_column: i64,
    /// Gives the heights of row `z`, for z below `samples[1]`.
    pub row: F,
}

/// The densities of a rectangle of texels, before they spread: those in `columns` and `rows` of a
/// level. Returns them row by row.
///
/// # Panics
/// Where the rectangle reaches beyond the level's texels, or a row doesn't reach as far as it.
#[must_use]
pub fn densities<'a, F: Fn(u32) -> &'a [u16]>(
    kernel: &DensityKernel,
    source: &DensityRows<F>,
    columns: Range<u32>,
    rows: Range<u32>,
    scratch: &mut DensityScratch,
) -> Vec<u8> {
    let samples = source.samples;
    let texels = [columns.len(), rows.len()];
    assert!(columns.end <= texels_of(samples[0]) && rows.end <= texels_of(samples[1]));
    let width = CELL as usize * texels[0] + 3;
    let mut heights = Vec::with_capacity(width * (CELL as usize * texels[1] + 3));
    // Window sample 0 lies before the first texel's first.
    let sample = |at: u32, axis: usize| at.saturating_sub(1).min(samples[axis] - 1);
    let (west, east) = (CELL * columns.start, CELL * columns.end + 2);
    for z in CELL * rows.start..=CELL * rows.end + 2 {
        let row = (source.row)(sample(z, 1));
        let at = |x: u32| (i64::from(x) - source.first_column) as usize;
        if west > 0 && east <= samples[0] {
            heights.extend_from_slice(&row[at(west - 1)..at(east)]);
        } else {
            heights.extend((west..=east).map(|x| row[at(sample(x, 0))]));
        }
    }
    let window = DensityWindow {
        heights: &heights,
        stride: width,
        texels,
        terrain: [
            on_terrain(columns.start, samples[0]),
            on_terrain(rows.start, samples[1]),
        ],
    };
    let mut out = vec![0; texels[0] * texels[1]];
    kernel.run(&window, scratch, &mut out, texels[0]);
    out
}

/// How far a level reaches, as far as densities go.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DensityExtent {
    /// Samples in x and z that lie on the terrain, at least two. A level may have one more, just
    /// beyond the rim, whose height is a guess.
    pub samples: [u32; 2],
    /// Texels in x and z.
    pub texels: [u32; 2],
}

impl DensityExtent {
    /// Of level `level` of a terrain with `size` samples.
    #[must_use]
    pub fn new(size: [u32; 2], level: u8) -> Self {
        let log2 = u32::from(level).min(31);
        Self {
            samples: size.map(|samples| (((samples - 1) >> log2) + 1).max(2)),
            texels: size.map(|samples| texels_of((samples - 1).div_ceil(1 << log2) + 1)),
        }
    }
}

/// Texels of a level along a side of `samples` samples.
#[must_use]
pub fn texels_of(samples: u32) -> u32 {
    (samples - 1).div_ceil(CELL)
}

/// Which samples of a window that starts with texel `first` lie on a terrain of `samples` samples.
fn on_terrain(first: u32, samples: u32) -> Range<usize> {
    // Window sample 0 lies before the texel's first.
    let start = usize::from(first == 0);
    start..(samples - CELL * first) as usize + 1
}

/// The densities of a tile's own 32 by 32 texels, before they spread, from the tile's stored
/// heights alone: its border holds what the filter needs of its neighbours. Texels beyond the
/// terrain are 0. `extent` is the level's, `first` the tile's first own sample.
///
/// # Panics
/// Where `heights` are not 133 by 133.
pub fn tile_densities(
    kernel: &DensityKernel,
    extent: &DensityExtent,
    first: [u32; 2],
    heights: &[u16],
    scratch: &mut DensityScratch,
    out: &mut [u8; (DENSITY_TEXELS * DENSITY_TEXELS) as usize],
) {
    let stride = (TILE_SAMPLES + 2 * TILE_BORDER + 1) as usize;
    assert_eq!(
        heights.len(),
        stride * stride,
        "a tile has 133 x 133 heights"
    );
    out.fill(0);
    let side = |axis: usize| {
        let first = first[axis] / CELL;
        first..(first + DENSITY_TEXELS).min(extent.texels[axis]).max(first)
    };
    let (columns, rows) = (side(0), side(1));
    if columns.is_empty() || rows.is_empty() {
        return;
    }
    let skip = (TILE_BORDER - 1) as usize * (stride + 1);
    let window = DensityWindow {
        heights: &heights[skip..],
        stride,
        texels: [columns.len(), rows.len()],
        terrain: [
            on_terrain(columns.start, extent.samples[0]),
            on_terrain(rows.start, extent.samples[1]),
        ],
    };
    kernel.run(&window, scratch, out, DENSITY_TEXELS as usize);
}

/// The densities of some of a tile's own texels, as [`tile_densities`] gives them: those in `columns`
/// and `rows`, which lie on the terrain. Writes them row by row.
pub(crate) fn some_tile_densities(
    kernel: &DensityKernel,
    extent: &DensityExtent,
    first: [u32; 2],
    [columns, rows]: [Range<u32>; 2],
    heights: &[u16],
    scratch: &mut DensityScratch,
    out: &mut [u8],
) {
    let stride = (TILE_SAMPLES + 2 * TILE_BORDER + 1) as usize;
    let skip = [&columns, &rows].map(|range| (TILE_BORDER - 1 + CELL * range.start) as usize);
    let window = DensityWindow {
        heights: &heights[skip[1] * stride + skip[0]..],
        stride,
        texels: [columns.len(), rows.len()],
        terrain: [
            on_terrain(first[0] / CELL + columns.start, extent.samples[0]),
            on_terrain(first[1] / CELL + rows.start, extent.samples[1]),
        ],
    };
    kernel.run(&window, scratch, out, columns.len());
}

/// Spreads a row of densities: each texel takes the largest of the square around it that
/// [`DensitySettings::filter_size`] sets, or of the larger one for texels on a tile's border.
/// `row(z)` gives the rows before; it is asked for rows `0..rows` only.
pub(crate) fn spread_row<'a>(
    settings: &DensitySettings,
    z: u32,
    rows: u32,
    row: impl Fn(u32) -> &'a [u8],
) -> Vec<u8> {
    let (reach, border_reach) = (settings.reach(), settings.border_reach());
    let mut out = spread(
        z,
        rows,
        &row,
        if on_border(z) { border_reach } else { reach },
    );
    if border_reach > reach && !on_border(z) {
        // The few columns of texels that lie on a border.
        let wide = vertical(z, rows, &row, border_reach);
        for x in (0..out.len()).step_by(DENSITY_TEXELS as usize) {
            out[x] = largest_around(&wide, x, border_reach as usize);
        }
    }
    out
}

/// Whether row or column `at` of texels is a tile's first.
fn on_border(at: u32) -> bool {
    at.is_multiple_of(DENSITY_TEXELS)
}

fn vertical<'a>(z: u32, rows: u32, row: &impl Fn(u32) -> &'a [u8], reach: u32) -> Vec<u8> {
    let mut out = row(z).to_vec();
    for other in z.saturating_sub(reach)..(z + reach + 1).min(rows) {
        for (out, &density) in out.iter_mut().zip(row(other)) {
            *out = density.max(*out);
        }
    }
    out
}

fn largest_around(row: &[u8], x: usize, reach: usize) -> u8 {
    let around = &row[x.saturating_sub(reach)..(x + reach + 1).min(row.len())];
    around.iter().copied().max().unwrap_or_default()
}

fn spread<'a>(z: u32, rows: u32, row: &impl Fn(u32) -> &'a [u8], reach: u32) -> Vec<u8> {
    let column = vertical(z, rows, row, reach);
    if reach == 0 {
        return column;
    }
    let mut out = column.clone();
    for step in 1..=(reach as usize).min(column.len().saturating_sub(1)) {
        let inner = column.len() - step;
        for (out, &density) in out[..inner].iter_mut().zip(&column[step..]) {
            *out = density.max(*out);
        }
        for (out, &density) in out[step..].iter_mut().zip(&column[..inner]) {
            *out = density.max(*out);
        }
    }
    out
}

/// Row `z` of a level's densities from the two rows of the finer level that it covers: the largest
/// of four, but on borders that are point-sampled.
pub(crate) fn coarser_row(
    settings: &DensitySettings,
    z: u32,
    above: &[u8],
    below: &[u8],
) -> Vec<u8> {
    let point = settings.border == DensityBorder::PointSampled;
    let pairs = above.chunks(2).zip(below.chunks(2));
    let mut out: Vec<u8> = pairs
        .map(|(a, b)| a.iter().chain(b).copied().fold(0, u8::max))
        .collect();
    if point && on_border(z) {
        for (out, pair) in out.iter_mut().zip(above.chunks(2)) {
            *out = pair[0];
        }
    } else if point {
        for x in (0..out.len()).step_by(DENSITY_TEXELS as usize) {
            out[x] = above[2 * x];
        }
    }
    out
}
