//! The pyramid of levels, from bands of level 0 to finished tiles.

use super::quantise::ConvertedBand;
use super::span::{LevelSpan, Span, density_reach};
use super::{BakeError, writer};
use crate::density::{
    DensityKernel, DensityRows, DensityScratch, DensitySettings, coarser_row, densities, spread_row,
};
use crate::error_bound::{ERROR_REACH, ErrorScratch, cover_finer, tile_errors};
use crate::terrain::ManifestFile;
use crate::tile::{
    DENSITY_BORDER, DENSITY_CELL, DENSITY_STORED, DENSITY_TEXELS, DensityTile, ErrorTile,
    HeightTile, TILE_BORDER, TILE_SAMPLES, TILE_STORED, TileAddress, TileIndex, TileRange,
};
use rayon::prelude::*;
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

/// Rows of a level that something still needs: the newest, and some before.
pub(super) struct Rows<T> {
    first: u32,
    rows: VecDeque<Vec<T>>,
}

impl<T> Rows<T> {
    pub(super) fn new() -> Self {
        Self::starting_at(0)
    }

    /// None yet; the first that comes is row `first`.
    fn starting_at(first: u32) -> Self {
        Self {
            first,
            rows: VecDeque::new(),
        }
    }

    /// One past the newest row.
    pub(super) fn end(&self) -> u32 {
        self.first + self.rows.len() as u32
    }

    /// Row `number`, which must still be there.
    pub(super) fn row(&self, number: u32) -> &[T] {
        &self.rows[(number - self.first) as usize]
    }

    pub(super) fn extend(&mut self, rows: impl IntoIterator<Item = Vec<T>>) {
        self.rows.extend(rows);
    }

    pub(super) fn drop_before(&mut self, number: u32) {
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
    /// The largest error bounds of two by two texels of the tiles written: what the level above must
    /// not fall below.
    errors: Rows<[u8; 8]>,
    next_tile_row: u32,
    /// One past the last row of tiles that is written.
    end_tile_row: u32,
}

/// A row of tiles of a level that others are made of.
pub(super) struct GivenTiles {
    /// Which row.
    pub(super) z: u32,
    /// The tiles' own rows of heights; behind the last row of tiles, also the level's last.
    pub(super) heights: Vec<Vec<u16>>,
    /// The tiles' own rows of densities, as far as the level has some.
    pub(super) densities: Vec<Vec<u8>>,
    /// The tiles' error bounds, their children's covered.
    pub(super) errors: Vec<ErrorTile>,
    /// The tiles' heights from the lowest to the highest.
    pub(super) ranges: Vec<TileRange>,
}

/// Which sections tiles get besides heights.
#[derive(Clone, Copy)]
pub(super) struct Sections {
    pub(super) densities: bool,
    pub(super) errors: bool,
}

impl Level {
    /// Whether all rows are there that the next row of tiles takes.
    fn tile_row_ready(&self, sections: Sections) -> bool {
        let [last_row, last_texel] = [self.samples[1] - 1, self.texels[1] - 1];
        let z = self.next_tile_row;
        let below = if sections.errors {
            ERROR_REACH
        } else {
            TILE_BORDER
        };
        z < self.end_tile_row
            && self.heights.end() > last_row.min(TILE_SAMPLES * (z + 1) + below)
            && (!sections.densities
                || self.densities.end() > last_texel.min(DENSITY_TEXELS * (z + 1) + DENSITY_BORDER))
    }
}

/// Takes rows of its first level (level 0, but for what is merged) and writes tiles of all levels as
/// soon as their rows are complete.
pub(super) struct Pyramid {
    /// From level `base` on.
    levels: Vec<Level>,
    base: u8,
    /// Densities of level 0 before they spread.
    unspread: Rows<u8>,
    density: DensitySettings,
    kernel: DensityKernel,
    index: TileIndex,
    dir: PathBuf,
    bytes: u64,
    sections: Sections,
    /// The terrain's.
    stamp: u32,
    /// What error bounds are made in, one for each thread that ever made some.
    scratches: Mutex<Vec<ErrorScratch>>,
}

impl Pyramid {
    /// Makes what `span` says of the terrain that `file` describes, into the folder `dir`.
    pub(super) fn new(file: &ManifestFile, span: &Span, dir: &Path, sections: Sections) -> Self {
        let level = |(span, level): (&LevelSpan, u8)| {
            let samples = file.samples(level);
            Level {
                samples,
                texels: samples.map(|count| (count - 1).div_ceil(DENSITY_CELL)),
                tiles: file.tiles(level),
                heights: Rows::starting_at(span.first_height),
                densities: Rows::starting_at(span.first_density),
                errors: Rows::starting_at(DENSITY_TEXELS / 2 * span.tile_rows.start),
                next_tile_row: span.tile_rows.start,
                end_tile_row: span.tile_rows.end,
            }
        };
        Self {
            levels: span.levels.iter().zip(span.base..).map(level).collect(),
            base: span.base,
            unspread: Rows::starting_at(span.first_unspread),
            density: file.density.clone(),
            kernel: DensityKernel::new(&file.density, file.height_step_m, file.spacing_m, 0),
            index: TileIndex::new(file),
            dir: dir.to_owned(),
            bytes: 0,
            sections,
            stamp: file.stamp(),
            scratches: Mutex::default(),
        }
    }

    /// The finished index, in which parents don't cover their children yet, and the number of
    /// bytes written.
    pub(super) fn finish(self) -> (TileIndex, u64) {
        debug_assert!(
            self.levels
                .iter()
                .all(|level| level.next_tile_row == level.end_tile_row),
            "every row of tiles is written"
        );
        (self.index, self.bytes)
    }

    /// Takes the next rows of level 0 and does all that they make possible.
    pub(super) fn push(&mut self, band: ConvertedBand) -> Result<(), BakeError> {
        self.levels[0].heights.extend(band.heights);
        if self.sections.densities {
            self.make_densities();
            self.spread_densities();
        }
        self.go_on()
    }

    /// Takes the next row of tiles of the first level, whose files are there already, and does all
    /// that it makes possible.
    pub(super) fn push_tiles(&mut self, row: GivenTiles) -> Result<(), BakeError> {
        for (x, range) in (0..).zip(&row.ranges) {
            let address = TileAddress::new(self.base, x, row.z);
            self.index.set(address, Some(*range));
        }
        let level = &mut self.levels[0];
        level.heights.extend(row.heights);
        level.densities.extend(row.densities);
        if self.levels.len() > 1 {
            let level = &mut self.levels[0];
            let rows = pairs_below(level.texels, row.z, &row.errors);
            level.errors.extend(rows);
        }
        self.go_on()
    }

    /// Says that a tile below the first level is there already.
    pub(super) fn set(&mut self, address: TileAddress, range: TileRange) {
        self.index.set(address, Some(range));
    }

    /// One past the last row of tiles of the coarsest level that is written; all tiles below it are.
    pub(super) fn rows_done(&self) -> u32 {
        self.levels.last().map_or(0, |level| level.next_tile_row)
    }

    /// Makes all that the first level's rows make possible.
    fn go_on(&mut self) -> Result<(), BakeError> {
        for level in 1..self.levels.len() {
            self.make_level(level);
        }
        self.write_tiles()?;
        self.forget();
        Ok(())
    }

    /// Densities of level 0 from its heights.
    fn make_densities(&mut self) {
        let level = &self.levels[0];
        let height = level.samples[1];
        let first = self.unspread.end();
        // Texel row t takes the curvature of sample rows 4 t ..= 4 t + 4, and that of the last one
        // takes the row after it.
        let mut end = first;
        while end < level.texels[1]
            && level.heights.end() > (height - 1).min(DENSITY_CELL * (end + 1) + 1)
        {
            end += 1;
        }
        if end == first {
            return;
        }
        let source = DensityRows {
            samples: level.samples,
            first_column: 0,
            row: |z| level.heights.row(z),
        };
        // In blocks whose samples stay close to the core that works on them.
        let width = level.texels[0];
        let blocks: Vec<_> = (0..width.div_ceil(DENSITY_TEXELS))
            .into_par_iter()
            .map_init(DensityScratch::default, |scratch, block| {
                let start = block * DENSITY_TEXELS;
                let columns = start..(start + DENSITY_TEXELS).min(width);
                densities(&self.kernel, &source, columns, first..end, scratch)
            })
            .collect();
        let rows = (0..(end - first) as usize).map(|row| {
            let mut out = Vec::with_capacity(width as usize);
            for block in &blocks {
                let columns = block.len() / (end - first) as usize;
                out.extend_from_slice(&block[row * columns..][..columns]);
            }
            out
        });
        self.unspread.extend(rows);
    }

    /// Densities of level 0 as they are stored.
    fn spread_densities(&mut self) {
        let level = &mut self.levels[0];
        spread_rows(
            &self.density,
            level.texels[1],
            &mut self.unspread,
            &mut level.densities,
        );
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
                let mut out = vec![0; width];
                let finer_row = |z: u32| finer.heights.row(z);
                let centre = 2 * row;
                if centre > last {
                    // Just beyond the rim, where the ground goes on straight.
                    let (rim, inner) = (finer_row(last), finer_row(last - 1));
                    let beyond: Vec<u16> = rim.iter().zip(inner).map(straight_on).collect();
                    tent_row(&beyond, &beyond, &beyond, &mut out);
                } else if centre == 0 || centre == last {
                    let rim = finer_row(centre);
                    tent_row(rim, rim, rim, &mut out);
                } else {
                    let (above, below) = (finer_row(centre - 1), finer_row(centre + 1));
                    tent_row(above, finer_row(centre), below, &mut out);
                }
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
        let rows: Vec<Vec<u8>> = (first..end)
            .into_par_iter()
            .map(|row| {
                let above = finer.densities.row((2 * row).min(last));
                let below = finer.densities.row((2 * row + 1).min(last));
                coarser_row(&self.density, row, above, below)
            })
            .collect();
        coarser.densities.extend(rows);
    }

    /// Writes every tile whose rows are complete, the finer levels first.
    fn write_tiles(&mut self) -> Result<(), BakeError> {
        let sections = self.sections;
        let mut ready = Vec::new();
        for (level, number) in self.levels.iter_mut().zip(self.base..) {
            while level.tile_row_ready(sections) {
                let z = level.next_tile_row;
                ready.extend((0..level.tiles[0]).map(|x| TileAddress::new(number, x, z)));
                level.next_tile_row += 1;
            }
        }
        let errors = if sections.errors {
            self.make_errors(&ready)
        } else {
            Vec::new()
        };
        let written: Vec<_> = ready
            .into_par_iter()
            .enumerate()
            .map(|(at, address)| {
                let level = &self.levels[usize::from(address.level - self.base)];
                let heights = height_window(level, address);
                let densities = sections
                    .densities
                    .then(|| density_window(&level.densities, level.texels, address));
                let tile = writer::Tile {
                    heights: &heights,
                    densities: densities.as_ref(),
                    errors: errors.get(at),
                    stamp: self.stamp,
                };
                let bytes = tile.write(&self.dir, address)?;
                Ok::<_, BakeError>((address, heights.range(), bytes))
            })
            .collect::<Result<_, _>>()?;
        for (address, range, bytes) in written {
            self.index.set(address, Some(range));
            self.bytes += bytes;
        }
        Ok(())
    }

    /// Error bounds of tiles that can be written: whole rows of tiles, the finer levels first. A tile's
    /// children have always been written, or are among them: they need no more ground than it does.
    fn make_errors(&mut self, ready: &[TileAddress]) -> Vec<ErrorTile> {
        let mut errors: Vec<ErrorTile> = ready
            .par_iter()
            .map(|address| {
                // Memory is kept from one row of tiles to the next: allocated for each of the parts that
                // a row is split into, it costs as much as the bounds.
                let lock = || {
                    self.scratches
                        .lock()
                        .unwrap_or_else(PoisonError::into_inner)
                };
                let mut scratch = lock().pop().unwrap_or_default();
                let level = &self.levels[usize::from(address.level - self.base)];
                let first = address.first_sample();
                let row = |z: u32| level.heights.row(z);
                let errors = tile_errors(level.samples, [first.0, first.1], row, &mut scratch);
                lock().push(scratch);
                errors
            })
            .collect();
        let mut rest = (ready, errors.as_mut_slice());
        while let Some(first) = rest.0.first() {
            let number = usize::from(first.level - self.base);
            let columns = self.levels[number].tiles[0] as usize;
            let (addresses, tiles);
            ((addresses, rest.0), (tiles, rest.1)) =
                (rest.0.split_at(columns), rest.1.split_at_mut(columns));
            if let Some(finer) = number.checked_sub(1).map(|finer| &mut self.levels[finer]) {
                for (address, tile) in addresses.iter().zip(&mut *tiles) {
                    cover_finer_tile(tile, *address, &finer.errors);
                }
                finer.errors.drop_before(DENSITY_TEXELS * (first.z + 1));
            }
            if number + 1 < self.levels.len() {
                let level = &mut self.levels[number];
                let rows = pairs_below(level.texels, first.z, tiles);
                level.errors.extend(rows);
            }
        }
        errors
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
            // What lies beyond the last row follows from the last two, so those stay.
            let tile_row = level.next_tile_row;
            let above = if self.sections.errors {
                ERROR_REACH
            } else {
                TILE_BORDER
            };
            // Rows behind a strip's last tile only lead to coarser ones.
            let of_tiles = |rows: u32, before: u32| {
                if tile_row < level.end_tile_row {
                    (rows * tile_row).saturating_sub(before)
                } else {
                    u32::MAX
                }
            };
            let of_densities = if number == 0 && self.base == 0 && self.sections.densities {
                (DENSITY_CELL * self.unspread.end()).saturating_sub(1)
            } else {
                u32::MAX
            };
            let heights = height_done
                .min(of_tiles(TILE_SAMPLES, above))
                .min(of_densities)
                .min(level.samples[1] - 2);
            let densities = density_done
                .min(of_tiles(DENSITY_TEXELS, DENSITY_BORDER))
                .min(level.texels[1] - 1);
            level.heights.drop_before(heights);
            level.densities.drop_before(densities);
        }
    }
}

/// Raises a tile's error bounds to the largest below each texel, of which `finer` has the rows.
fn cover_finer_tile(tile: &mut ErrorTile, address: TileAddress, finer: &Rows<[u8; 8]>) {
    let side = DENSITY_TEXELS as usize;
    let rows = tile.texels_mut().chunks_exact_mut(side);
    for (texels, z) in rows.zip(DENSITY_TEXELS * address.z..finer.end()) {
        // The last tile's row may be longer than the level's.
        let below = &finer.row(z)[(DENSITY_TEXELS * address.x) as usize..];
        for (texel, below) in texels.iter_mut().zip(below) {
            cover_finer(texel, below);
        }
    }
}

/// The largest error bounds of two by two texels each, of a row of tiles of a level with `texels`
/// texels.
fn pairs_below(texels: [u32; 2], row: u32, tiles: &[ErrorTile]) -> Vec<Vec<[u8; 8]>> {
    let rows = DENSITY_TEXELS.min(texels[1] - DENSITY_TEXELS * row);
    let columns = texels[0].div_ceil(2);
    let pair = |x: u32, z: u32| {
        let tile = &tiles[(2 * x / DENSITY_TEXELS) as usize];
        let (x, z) = (2 * x % DENSITY_TEXELS, 2 * z);
        // Texels beyond the level are 0.
        let four = [(x, z), (x + 1, z), (x, z + 1), (x + 1, z + 1)].map(|(x, z)| tile.get(x, z));
        std::array::from_fn(|k| four.iter().map(|texel| texel[k]).fold(0, u8::max))
    };
    (0..rows.div_ceil(2))
        .map(|z| (0..columns).map(|x| pair(x, z)).collect())
        .collect()
}

/// Spreads all rows of densities that can be, of `rows` that a level has, and drops what no other
/// row needs.
pub(super) fn spread_rows(
    settings: &DensitySettings,
    rows: u32,
    unspread: &mut Rows<u8>,
    done: &mut Rows<u8>,
) {
    let reach = density_reach(settings);
    let first = done.end();
    let mut end = first;
    while end < rows && unspread.end() > (rows - 1).min(end + reach) {
        end += 1;
    }
    let spread: Vec<_> = (first..end)
        .into_par_iter()
        .map(|z| spread_row(settings, z, rows, |z| unspread.row(z)))
        .collect();
    done.extend(spread);
    unspread.drop_before(end.saturating_sub(reach));
}

/// What follows a rim sample and the one inside of it on a straight line.
fn straight_on((&rim, &inner): (&u16, &u16)) -> u16 {
    (2 * i32::from(rim) - i32::from(inner)).clamp(0, u16::MAX.into()) as u16
}

/// One row of the coarser level from three of the finer: the mean with the weights 1 2 1, 2 4 2,
/// 1 2 1, rounded to the nearest, halves up. At either end the ground goes on straight, so that a
/// plane stays one: the mean there is the end itself. The finer rows have one length `n`, at least
/// 2, and `out` has `ceil((n - 1) / 2) + 1`. Takes about a third of a nanosecond a sample of the
/// finer row.
///
/// # Panics
/// Where the lengths don't match.
pub fn tent_row(above: &[u16], row: &[u16], below: &[u16], out: &mut [u16]) {
    let width = row.len();
    assert!(above.len() == width && below.len() == width);
    assert_eq!(out.len(), (width - 1).div_ceil(2) + 1);
    let column = |x: usize| u32::from(above[x]) + 2 * u32::from(row[x]) + u32::from(below[x]);
    let mean = |left: u32, middle: u32, right: u32| ((left + 2 * middle + right + 8) >> 4) as u16;
    let alone = |column: u32| mean(column, column, column);
    let last = out.len() - 1;
    out[0] = alone(column(0));
    out[last] = if 2 * last == width {
        let beyond = (2 * column(width - 1)).saturating_sub(column(width - 2));
        alone(beyond.min(4 * u32::from(u16::MAX)))
    } else {
        alone(column(width - 1))
    };
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

/// The density tile at `address` of a level with `texels` texels in x and z.
pub(super) fn density_window(
    densities: &Rows<u8>,
    texels: [u32; 2],
    address: TileAddress,
) -> DensityTile {
    let first = (address.x * DENSITY_TEXELS, address.z * DENSITY_TEXELS);
    let texels = window(densities, texels, first, DENSITY_BORDER, DENSITY_STORED);
    DensityTile::from_samples(texels).expect("the window has a tile's size")
}
