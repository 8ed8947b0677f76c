//! The part of a page that has changed.

use crate::edit::SampleRect;
use crate::stream::PageDirt;
use crate::tile::{DENSITY_BORDER, DENSITY_STORED, DENSITY_TEXELS, TILE_STORED, TerrainTile};
use half::f16;

/// A rectangle of texels.
pub(super) struct Texels<T> {
    pub(super) first: [u32; 2],
    pub(super) size: [u32; 2],
    pub(super) texels: Vec<T>,
}

impl<T: Copy> Texels<T> {
    /// Copies `rect` out of `all`, which has `stride` texels a row and `border` more before the
    /// first column and row.
    fn cut(all: &[T], stride: usize, border: usize, rect: SampleRect) -> Self {
        let size = rect.size();
        let first = rect.min.map(|at| at as usize + border);
        let mut texels = Vec::with_capacity(size[0] * size[1]);
        if !rect.is_empty() {
            for row in 0..size[1] {
                let at = (first[1] + row) * stride + first[0];
                texels.extend_from_slice(&all[at..at + size[0]]);
            }
        }
        Self {
            first: rect.min.map(|at| at as u32),
            size: size.map(|count| count as u32),
            texels,
        }
    }
}

/// What has changed of a page. Holds copies of that only: tiles may change again before it is
/// written.
pub(super) struct PagePart {
    pub(super) heights: Texels<u16>,
    pub(super) densities: Texels<u8>,
    pub(super) errors: Texels<[u8; 8]>,
    /// The samples whose gradients have changed, and the heights that they follow from: those and
    /// one more to each side, as far as the tile has them.
    slopes: SampleRect,
    around: Texels<u16>,
}

impl PagePart {
    pub(super) fn new(tile: &TerrainTile, dirt: &PageDirt) -> Self {
        let stored = SampleRect::new([0; 2], [TILE_STORED as i32; 2]);
        let own = SampleRect::new([0; 2], [DENSITY_TEXELS as i32; 2]);
        let heights = dirt.heights.intersection(&stored);
        let grown = |rect: SampleRect| {
            if rect.is_empty() {
                SampleRect::default()
            } else {
                rect.grown(1).intersection(&stored)
            }
        };
        let slopes = grown(heights);
        let samples = tile.heights.samples();
        let side = TILE_STORED as usize;
        Self {
            heights: Texels::cut(samples, side, 0, heights),
            densities: Texels::cut(
                tile.densities.samples(),
                DENSITY_STORED as usize,
                DENSITY_BORDER as usize,
                dirt.densities.intersection(&own),
            ),
            errors: Texels::cut(
                tile.errors.texels(),
                DENSITY_TEXELS as usize,
                0,
                dirt.errors.intersection(&own),
            ),
            slopes,
            around: Texels::cut(samples, side, 0, grown(slopes)),
        }
    }

    /// The gradients that have changed, as [`tile_gradients`](super::pages::tile_gradients) has
    /// them, and where they begin and how many there are.
    pub(super) fn gradients(&self, scale: f32, out: &mut Vec<[f16; 2]>) -> ([u32; 2], [u32; 2]) {
        out.clear();
        let (from, stride) = (self.around.first, self.around.size[0] as usize);
        let last = TILE_STORED as i32 - 1;
        let at = |x: i32, z: i32| {
            let column = (x.clamp(0, last) as u32 - from[0]) as usize;
            let row = (z.clamp(0, last) as u32 - from[1]) as usize;
            f32::from(self.around.texels[row * stride + column])
        };
        for z in self.slopes.min[1]..self.slopes.max[1] {
            for x in self.slopes.min[0]..self.slopes.max[0] {
                out.push([
                    f16::from_f32((at(x + 1, z) - at(x - 1, z)) * scale),
                    f16::from_f32((at(x, z + 1) - at(x, z - 1)) * scale),
                ]);
            }
        }
        let size = self.slopes.size().map(|count| count as u32);
        (self.slopes.min.map(|at| at as u32), size)
    }
}

#[cfg(test)]
mod tests {
    use super::super::pages::tile_gradients;
    use super::*;
    use crate::tile::{DensityTile, ErrorTile, HeightTile};

    #[test]
    fn a_part_of_a_page_is_that_part_of_the_whole() {
        let side = TILE_STORED as usize;
        let noise = |at: usize| (at * 7919 % 65_521) as u16;
        let heights = HeightTile::from_samples((0..side * side).map(noise).collect());
        let texels = DENSITY_STORED as usize;
        let densities =
            DensityTile::from_samples((0..texels * texels).map(|at| noise(at) as u8).collect());
        let mut errors = ErrorTile::flat();
        for (at, texel) in errors.texels_mut().iter_mut().enumerate() {
            *texel = (noise(at) as u64).to_le_bytes();
        }
        let tile = TerrainTile {
            heights: heights.expect("as many as belong"),
            densities: densities.expect("as many as belong"),
            errors,
            stamp: 0,
        };
        let (mut whole, mut part) = (Vec::new(), Vec::new());
        tile_gradients(&tile.heights, 0.25, &mut whole);
        let own = tile.densities.own_texels();
        for (min, max) in [
            ([0, 0], [133, 133]),
            ([0, 5], [3, 9]),
            ([40, 50], [41, 51]),
            ([100, 120], [133, 133]),
            ([7, 7], [7, 7]),
        ] {
            let rect = SampleRect::new(min, max);
            let dirt = PageDirt {
                heights: rect,
                densities: rect,
                errors: rect,
            };
            let cut = PagePart::new(&tile, &dirt);
            let (first, size) = cut.gradients(0.25, &mut part);
            let mut count = 0;
            for row in 0..size[1] {
                for column in 0..size[0] {
                    let at = ((first[1] + row) * side as u32 + first[0] + column) as usize;
                    assert_eq!(part[count], whole[at], "{rect:?}: {column}, {row}");
                    count += 1;
                }
            }
            assert_eq!(part.len(), count);
            let Texels {
                first,
                size,
                texels,
            } = &cut.densities;
            for (at, texel) in (0..).zip(texels) {
                let (x, z) = (first[0] + at % size[0], first[1] + at / size[0]);
                assert_eq!(*texel, own[(z * DENSITY_TEXELS + x) as usize]);
            }
            let Texels {
                first,
                size,
                texels,
            } = &cut.errors;
            for (at, texel) in (0..).zip(texels) {
                let (x, z) = (first[0] + at % size[0], first[1] + at / size[0]);
                assert_eq!(*texel, tile.errors.get(x, z));
            }
        }
    }
}
