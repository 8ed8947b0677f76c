//! The pyramid of levels, from bands of level 0 to finished tiles.

use super::curvature::{mean_curvature, quantise_density};
use super::quantise::ConvertedBand;
use super::{BakeError, writer};
use crate::terrain::{DensitySettings, ManifestFile};
use crate::tile::{
    DENSITY_BORDER, DENSITY_CELL, DENSITY_STORED, DENSITY_TEXELS, DensityTile, HeightTile,
    TILE_BORDER, TILE_SAMPLES, TILE_STORED, TileAddress, TileIndex,
};
use rayon::prelude::*;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};

/// Rows of a level that something still needs: the newest, and some before.
struct Rows<T> {
    first: u32,
    rows: VecDeque<Vec<T>>,
}

impl<T> Rows<T> {
    fn new() -> Self {
        Self {
            first: 0,
            rows: VecDeque::new(),
        }
    }

    /// One past the newest row.
    fn end(&self) -> u32 {
        self.first + self.rows.len() as u32
    }

    /// Row `number`, which must still be there.
    fn row(&self, number: u32) -> &[T] {
        &self.rows[(number - self.first) as usize]
    }

    fn extend(&mut self, rows: impl IntoIterator<Item = Vec<T>>) {
        self.rows.extend(rows);
    }

    fn drop_before(&mut self, number: u32) {
        while self.first < number && self.rows.pop_front().is_some() {
            self.first += 1;
        }
    }
}

struct Level {
    /// Samples in x and z.
    samples: [u32; 2],
    /// Density texels in x and z.
    texels: [u32; 2],
    /// Tiles in x and z.
    tiles: [u32; 2],
    heights: Rows<u16>,
    densities: Rows<u8>,
    next_tile_row: u32,
}

impl Level {
    /// Whether all rows are there that the next row of tiles takes.
    fn tile_row_ready(&self) -> bool {
        let [last_row, last_texel] = [self.samples[1] - 1, self.texels[1] - 1];
        let z = self.next_tile_row;
        z < self.tiles[1]
            && self.heights.end() > last_row.min(TILE_SAMPLES * (z + 1) + TILE_BORDER)
            && self.densities.end() > last_texel.min(DENSITY_TEXELS * (z + 1) + DENSITY_BORDER)
    }
}

/// Takes rows of level 0 and writes tiles of all levels as soon as their rows are complete.
pub(super) struct Pyramid {
    levels: Vec<Level>,
    /// Unrounded rows of level 0, for curvature.
    relief: Rows<f32>,
    density: DensitySettings,
    index: TileIndex,
    dir: PathBuf,
    bytes: u64,
}

impl Pyramid {
    pub(super) fn new(file: &ManifestFile, dir: &Path) -> Self {
        let level = |level| {
            let samples = file.samples(level);
            Level {
                samples,
                texels: samples.map(|count| (count - 1).div_ceil(DENSITY_CELL)),
                tiles: file.tiles(level),
                heights: Rows::new(),
                densities: Rows::new(),
                next_tile_row: 0,
            }
        };
        Self {
            levels: (0..file.levels).map(level).collect(),
            relief: Rows::new(),
            density: file.density.clone(),
            index: TileIndex::new(file),
            dir: dir.to_owned(),
            bytes: 0,
        }
    }

    /// The finished index, in which parents don't cover their children yet, and the number of
    /// bytes written.
    pub(super) fn finish(self) -> (TileIndex, u64) {
        debug_assert!(
            self.levels
                .iter()
                .all(|level| level.next_tile_row == level.tiles[1]),
            "every row of tiles is written"
        );
        (self.index, self.bytes)
    }

    /// Takes the next rows of level 0 and does all that they make possible.
    pub(super) fn push(&mut self, band: ConvertedBand) -> Result<(), BakeError> {
        self.levels[0].heights.extend(band.heights);
        self.relief.extend(band.relief);
        self.make_densities();
        for level in 1..self.levels.len() {
            self.make_level(level);
        }
        self.write_tiles()?;
        self.forget();
        Ok(())
    }

    /// Densities of level 0 from the relief.
    fn make_densities(&mut self) {
        let level = &self.levels[0];
        let [width, height] = level.samples;
        let first = level.densities.end();
        // Texel row t takes the curvature of sample rows 4 t ..= 4 t + 4, and that of the last one
        // takes the row after it.
        let mut end = first;
        while end < level.texels[1]
            && self.relief.end() > (height - 1).min(DENSITY_CELL * (end + 1) + 1)
        {
            end += 1;
        }
        let rows: Vec<Vec<u8>> = (first..end)
            .into_par_iter()
            .map(|texel| {
                let mut curvature = vec![0.0; width as usize];
                let mut largest = vec![0_f32; width as usize];
                let rows = DENSITY_CELL * texel..=(DENSITY_CELL * (texel + 1)).min(height - 1);
                for row in rows {
                    curvature_row(|z| self.relief.row(z), row, height, &mut curvature);
                    for (largest, &curvature) in largest.iter_mut().zip(&curvature) {
                        *largest = largest.max(curvature);
                    }
                }
                largest_by_cell(&largest)
                    .map(|curvature| quantise_density(curvature, &self.density))
                    .collect()
            })
            .collect();
        self.levels[0].densities.extend(rows);
        let keep = (DENSITY_CELL * end)
            .saturating_sub(1)
            .min(height.saturating_sub(3));
        self.relief.drop_before(keep);
    }

    /// Rows of a level from those of the level below it.
    fn make_level(&mut self, number: usize) {
        let (finer, coarser) = self.levels.split_at_mut(number);
        let (finer, coarser) = (&finer[number - 1], &mut coarser[0]);

        let last = finer.samples[1] - 1;
        let first = coarser.heights.end();
        let mut end = first;
        while end < coarser.samples[1] && finer.heights.end() > last.min(2 * end + 1) {
            end += 1;
        }
        let width = coarser.samples[0] as usize;
        let rows: Vec<Vec<u16>> = (first..end)
            .into_par_iter()
            .map(|row| {
                let finer_row = |z: u32| finer.heights.row(z.min(last));
                let mut out = vec![0; width];
                let above = finer_row((2 * row).saturating_sub(1));
                tent_row(above, finer_row(2 * row), finer_row(2 * row + 1), &mut out);
                out
            })
            .collect();
        coarser.heights.extend(rows);

        let last = finer.texels[1] - 1;
        let first = coarser.densities.end();
        let mut end = first;
        while end < coarser.texels[1] && finer.densities.end() > last.min(2 * end + 1) {
            end += 1;
        }
        let width = coarser.texels[0] as usize;
        let rows: Vec<Vec<u8>> = (first..end)
            .into_par_iter()
            .map(|row| {
                let above = finer.densities.row((2 * row).min(last));
                let below = finer.densities.row((2 * row + 1).min(last));
                let pairs = above.chunks(2).zip(below.chunks(2));
                let largest = pairs.map(|(a, b)| a.iter().chain(b).copied().max());
                let out: Vec<u8> = largest.map(Option::unwrap_or_default).collect();
                debug_assert_eq!(out.len(), width);
                out
            })
            .collect();
        coarser.densities.extend(rows);
    }

    /// Writes every tile whose rows are complete.
    fn write_tiles(&mut self) -> Result<(), BakeError> {
        let mut ready = Vec::new();
        for (level, number) in self.levels.iter_mut().zip(0u8..) {
            while level.tile_row_ready() {
                let z = level.next_tile_row;
                ready.extend((0..level.tiles[0]).map(|x| TileAddress::new(number, x, z)));
                level.next_tile_row += 1;
            }
        }
        let written: Vec<_> = ready
            .into_par_iter()
            .map(|address| {
                let level = &self.levels[usize::from(address.level)];
                let heights = height_window(level, address);
                let densities = density_window(level, address);
                let bytes = writer::write_tile(&self.dir, address, &heights, &densities)?;
                Ok::<_, BakeError>((address, heights.range(), bytes))
            })
            .collect::<Result<_, _>>()?;
        for (address, range, bytes) in written {
            self.index.set(address, Some(range));
            self.bytes += bytes;
        }
        Ok(())
    }

    /// Drops rows that neither a tile nor the level above needs any more.
    fn forget(&mut self) {
        for number in 0..self.levels.len() {
            let (height_done, density_done) = match self.levels.get(number + 1) {
                Some(coarser) => (
                    (2 * coarser.heights.end()).saturating_sub(1),
                    2 * coarser.densities.end(),
                ),
                None => (u32::MAX, u32::MAX),
            };
            let level = &mut self.levels[number];
            // Rows beyond the last stand for the last, so that one stays.
            let tile_row = level.next_tile_row;
            let heights = height_done
                .min((TILE_SAMPLES * tile_row).saturating_sub(TILE_BORDER))
                .min(level.samples[1] - 1);
            level.heights.drop_before(heights);
            let densities = density_done
                .min((DENSITY_TEXELS * tile_row).saturating_sub(DENSITY_BORDER))
                .min(level.texels[1] - 1);
            level.densities.drop_before(densities);
        }
    }
}

/// The absolute mean curvature of row `row` of `height` rows that `relief` gives, in heights over
/// spacing. The first and the last row take their neighbours' curvature where they have one.
pub fn curvature_row<'a>(
    relief: impl Fn(u32) -> &'a [f32],
    row: u32,
    height: u32,
    out: &mut [f32],
) {
    let last = height - 1;
    let centre = if height < 3 {
        row
    } else {
        row.clamp(1, last - 1)
    };
    mean_curvature(
        relief(centre.saturating_sub(1)),
        relief(centre),
        relief((centre + 1).min(last)),
        out,
    );
}

/// The largest of every texel's samples along a row: 4 own and the next texel's first.
fn largest_by_cell(row: &[f32]) -> impl Iterator<Item = f32> {
    let cell = DENSITY_CELL as usize;
    let texels = (row.len() - 1).div_ceil(cell);
    (0..texels).map(move |texel| {
        let samples = &row[cell * texel..row.len().min(cell * (texel + 1) + 1)];
        samples.iter().copied().fold(0.0, f32::max)
    })
}

/// One row of the coarser level from three of the finer: the mean with the weights 1 2 1, 2 4 2,
/// 1 2 1, rounded to the nearest, halves up. Samples beyond either end repeat it. The finer rows
/// have one length `n`, and `out` has `ceil((n - 1) / 2) + 1`. Takes about a third of a nanosecond a
/// sample of the finer row.
///
/// # Panics
/// Where the lengths don't match.
pub fn tent_row(above: &[u16], row: &[u16], below: &[u16], out: &mut [u16]) {
    let width = row.len();
    assert!(above.len() == width && below.len() == width);
    assert_eq!(out.len(), (width - 1).div_ceil(2) + 1);
    let column = |x: usize| {
        let x = x.min(width - 1);
        u32::from(above[x]) + 2 * u32::from(row[x]) + u32::from(below[x])
    };
    let mean = |left: u32, middle: u32, right: u32| ((left + 2 * middle + right + 8) >> 4) as u16;
    let last = out.len() - 1;
    out[0] = mean(column(0), column(0), column(1));
    out[last] = mean(column(2 * last - 1), column(2 * last), column(2 * last + 1));
    // Samples 1, 2, 3 make the second sample of the coarser row, 3, 4, 5 the third, and so on.
    let windows = above[1..]
        .windows(3)
        .step_by(2)
        .zip(row[1..].windows(3).step_by(2))
        .zip(below[1..].windows(3).step_by(2));
    for (out, ((a, r), b)) in out[1..last].iter_mut().zip(windows) {
        let column = |x: usize| u32::from(a[x]) + 2 * u32::from(r[x]) + u32::from(b[x]);
        *out = mean(column(0), column(1), column(2));
    }
}

/// Copies `stored` samples of each of `stored` rows, the first of them `border` before `first`;
/// what lies beyond a row's or the level's end repeats it.
fn window<T: Copy + Default>(
    rows: &Rows<T>,
    size: [u32; 2],
    first: (u32, u32),
    border: u32,
    stored: u32,
) -> Box<[T]> {
    let side = stored as usize;
    let mut out = vec![T::default(); side * side].into_boxed_slice();
    let clamp = |at: i64, axis: usize| at.clamp(0, i64::from(size[axis]) - 1) as u32;
    let left = i64::from(first.0) - i64::from(border);
    let top = i64::from(first.1) - i64::from(border);
    let inside = left >= 0 && left + i64::from(stored) <= i64::from(size[0]);
    for (target, z) in out.chunks_exact_mut(side).zip(top..) {
        let row = rows.row(clamp(z, 1));
        if inside {
            target.copy_from_slice(&row[left as usize..left as usize + side]);
        } else {
            for (sample, x) in target.iter_mut().zip(left..) {
                *sample = row[clamp(x, 0) as usize];
            }
        }
    }
    out
}

fn height_window(level: &Level, address: TileAddress) -> HeightTile {
    let first = address.first_sample();
    let samples = window(
        &level.heights,
        level.samples,
        first,
        TILE_BORDER,
        TILE_STORED,
    );
    HeightTile::from_samples(samples).expect("the window has a tile's size")
}

fn density_window(level: &Level, address: TileAddress) -> DensityTile {
    let first = (address.x * DENSITY_TEXELS, address.z * DENSITY_TEXELS);
    let texels = window(
        &level.densities,
        level.texels,
        first,
        DENSITY_BORDER,
        DENSITY_STORED,
    );
    DensityTile::from_samples(texels).expect("the window has a tile's size")
}
