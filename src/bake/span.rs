//! Which rows of which levels a pyramid, or a part of one, is made of.
//!
//! A strip is the part of the levels `0..=top` that lies above a whole number of rows of tiles of
//! level `top`. Every row of every level is a function of a few rows of the level below it, so a
//! strip is made of its own rows of the source and some before and after them. [`Span::strip`]
//! counts them, from the top level down, as the pyramid takes them:
//!
//! | of level `l` | needed for | rows |
//! |---|---|---|
//! | heights | error bounds, and tiles with their borders | [`ERROR_REACH`] before the first tile and after the last |
//! | heights | row `k` of level `l + 1` | `2 k - 1 ..= 2 k + 1` |
//! | densities | tiles with their borders | 1 texel before, 2 after |
//! | densities | row `k` of level `l + 1` | `2 k` and `2 k + 1` |
//! | level 0, densities | those that spread there | the settings' reach to either side |
//! | level 0, heights | density of texel row `k` | `4 k - 1 ..= 4 k + 5` |
//!
//! Rows that lie beyond the terrain are never asked for: there, as everywhere, a strip does what the
//! whole pyramid does, because the pyramid tells a rim by a level's size and not by what it holds.

use crate::density::DensitySettings;
use crate::error_bound::ERROR_REACH;
use crate::terrain::ManifestFile;
use crate::tile::{DENSITY_BORDER, DENSITY_CELL, DENSITY_TEXELS, TILE_SAMPLES};
use std::ops::Range;

/// What is made of one level.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct LevelSpan {
    /// Rows of tiles that are written.
    pub(super) tile_rows: Range<u32>,
    /// The first row of heights that is made.
    pub(super) first_height: u32,
    /// The first row of densities that is made.
    pub(super) first_density: u32,
}

/// What is made of a pyramid, and of what.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Span {
    /// The level whose rows are given, the first of `levels`.
    pub(super) base: u8,
    pub(super) levels: Vec<LevelSpan>,
    /// The first row of densities of level 0 before they spread.
    pub(super) first_unspread: u32,
    /// Rows of level `base` that must be given.
    pub(super) rows: Range<u32>,
}

impl Span {
    /// The whole pyramid, from all rows of level 0.
    pub(super) fn whole(file: &ManifestFile) -> Self {
        Self {
            base: 0,
            levels: (0..file.levels).map(|level| all(file, level)).collect(),
            first_unspread: 0,
            rows: 0..file.size[1],
        }
    }

    /// All levels above `base`, from the whole of level `base`, whose own tiles are there already.
    pub(super) fn above(file: &ManifestFile, base: u8) -> Self {
        let mut levels: Vec<_> = (base..file.levels).map(|level| all(file, level)).collect();
        if let Some(given) = levels.first_mut() {
            given.tile_rows = 0..0;
        }
        Self {
            base,
            levels,
            first_unspread: 0,
            rows: 0..file.samples(base)[1],
        }
    }

    /// Rows of tiles `tile_rows` of level `top`, and all tiles below them. There is at least one.
    pub(super) fn strip(file: &ManifestFile, top: u8, tile_rows: Range<u32>) -> Self {
        let mut levels = Vec::new();
        // What the level above asks for, of heights and of densities.
        let mut above: Option<[Range<u32>; 2]> = None;
        for level in (0..=top).rev() {
            let up = top - level;
            let tiles = tile_rows.start << up..(tile_rows.end << up).min(file.tiles(level)[1]);
            let mut heights = widened(&tiles, TILE_SAMPLES, ERROR_REACH, ERROR_REACH + 1);
            let mut texels = widened(&tiles, DENSITY_TEXELS, DENSITY_BORDER, DENSITY_BORDER + 1);
            if let Some([height, texel]) = &above {
                heights = heights.start.min((2 * height.start).saturating_sub(1))
                    ..heights.end.max(2 * height.end);
                texels = texels.start.min(2 * texel.start)..texels.end.max(2 * texel.end);
            }
            let samples = file.samples(level)[1];
            let heights = heights.start..heights.end.min(samples);
            let texels = texels.start..texels.end.min((samples - 1).div_ceil(DENSITY_CELL));
            levels.push(LevelSpan {
                tile_rows: tiles,
                first_height: heights.start,
                first_density: texels.start,
            });
            above = Some([heights, texels]);
        }
        levels.reverse();
        let [mut rows, texels] = above.unwrap_or_default();
        let reach = density_reach(&file.density);
        let first_unspread = texels.start.saturating_sub(reach);
        rows.start = rows
            .start
            .min((DENSITY_CELL * first_unspread).saturating_sub(1));
        rows.end = rows
            .end
            .max(DENSITY_CELL * (texels.end + reach) + 2)
            .min(file.size[1]);
        if let Some(finest) = levels.first_mut() {
            finest.first_height = rows.start;
        }
        Self {
            base: 0,
            levels,
            first_unspread,
            rows,
        }
    }
}

/// All of a level.
fn all(file: &ManifestFile, level: u8) -> LevelSpan {
    LevelSpan {
        tile_rows: 0..file.tiles(level)[1],
        first_height: 0,
        first_density: 0,
    }
}

/// Rows of which tiles have `each`, with so many more before and after.
fn widened(tiles: &Range<u32>, each: u32, before: u32, after: u32) -> Range<u32> {
    (each * tiles.start).saturating_sub(before)..each * tiles.end + after
}

/// Rows of texels over which densities spread.
pub(super) fn density_reach(settings: &DensitySettings) -> u32 {
    settings.reach().max(settings.border_reach())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::test_manifest_file;

    #[test]
    fn a_strip_of_everything_is_the_whole_pyramid() {
        for size in [[2, 2], [300, 129], [1000, 2050], [2, 5000]] {
            let file = test_manifest_file(size);
            let top = file.levels - 1;
            let strip = Span::strip(&file, top, 0..file.tiles(top)[1]);
            assert_eq!(strip, Span::whole(&file), "{size:?}");
        }
    }

    #[test]
    fn a_strip_asks_for_the_rows_that_its_levels_take_and_no_more() {
        let file = test_manifest_file([129, 100_001]);
        let strip = Span::strip(&file, 0, 3..5);
        assert_eq!(strip.rows, 3 * 128 - 96..5 * 128 + 97);
        // Level 1 takes rows 160..737 of level 1, which are made of twice as many and one before.
        let strip = Span::strip(&file, 1, 2..5);
        assert_eq!(strip.levels[1].first_height, 160);
        assert_eq!(strip.levels[0].tile_rows, 4..10);
        assert_eq!(strip.rows, 319..2 * 737);
    }

    #[test]
    fn what_spreads_far_widens_a_strip() {
        let mut file = test_manifest_file([129, 100_001]);
        file.density.filter_size = 32;
        let reach = density_reach(&file.density);
        assert!(reach >= 16);
        let strip = Span::strip(&file, 0, 30..31);
        assert_eq!(strip.first_unspread, 32 * 30 - 1 - reach);
        let wanted = 4 * (32 * 30 - 1 - reach) - 1..4 * (32 * 31 + 2 + reach) + 2;
        assert_eq!(strip.rows, wanted.start.min(3744)..wanted.end.max(4065));
    }
}
