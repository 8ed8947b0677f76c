//! Between which heights the ground of a tile's parts lies.

use crate::tile::{HeightTile, TILE_BORDER, TILE_SAMPLES, TILE_STORED, TileRange};

/// Cells along the side of the smallest blocks, as a power of two.
pub(super) const FINEST_LOG2: u32 = 3;
/// Cells along the side of the largest blocks, as a power of two: a quarter of the tile.
const COARSEST_LOG2: u32 = 6;
const SIDE: usize = (TILE_SAMPLES >> FINEST_LOG2) as usize;
/// All blocks of all sizes.
const COUNT: usize = {
    let (mut count, mut log2) = (0, FINEST_LOG2);
    while log2 <= COARSEST_LOG2 {
        count += blocks_a_side(log2) * blocks_a_side(log2);
        log2 += 1;
    }
    count
};
const NOTHING: TileRange = TileRange { min: 1, max: 0 };

const fn blocks_a_side(log2: u32) -> usize {
    (TILE_SAMPLES >> log2) as usize
}

const fn offset(log2: u32) -> usize {
    let (mut at, mut finer) = (0, FINEST_LOG2);
    while finer < log2 {
        at += blocks_a_side(finer) * blocks_a_side(finer);
        finer += 1;
    }
    at
}

/// The lowest and the highest stored height in the blocks of a tile: squares of 8 × 8 cells, and
/// of 16, 32 and 64 a side. Ranges hold the samples on a block's far edges too, so that the ground
/// over a block lies between them.
///
/// Rays pass over (or under) whole blocks by them. 1.4 KiB; made in some microseconds, and brought
/// up to date in fewer where only a part of the tile has changed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct BlockRanges {
    ranges: Box<[TileRange; COUNT]>,
}

impl BlockRanges {
    /// The ranges of a tile's blocks.
    #[must_use]
    pub fn new(heights: &HeightTile) -> Self {
        let mut blocks = Self {
            ranges: Box::new([NOTHING; COUNT]),
        };
        blocks.refresh(heights, [0, 0], [TILE_SAMPLES; 2]);
        blocks
    }

    /// Looks again at all blocks that samples of a rectangle belong to: from `first` to `last`, both
    /// included, counted in x and z from the tile's first own sample and at most 128. To be called
    /// after these samples, and no others, have changed. An empty rectangle, or one beyond the tile,
    /// changes nothing.
    pub fn refresh(&mut self, heights: &HeightTile, first: [u32; 2], last: [u32; 2]) {
        let last = last.map(|at| at.min(TILE_SAMPLES));
        if first[0] > last[0] || first[1] > last[1] {
            return;
        }
        // A sample on the line between two blocks belongs to both.
        let block = |at: u32| (at >> FINEST_LOG2) as usize;
        let from = first.map(|at| block(at.saturating_sub(1)));
        let to = last.map(|at| block(at).min(SIDE - 1));
        for z in from[1]..=to[1] {
            self.refresh_row(heights, z, [from[0], to[0]]);
        }
        let (mut from, mut to) = (from, to);
        for log2 in FINEST_LOG2 + 1..=COARSEST_LOG2 {
            from = from.map(|at| at / 2);
            to = to.map(|at| at / 2);
            let (finer, finer_side) = (offset(log2 - 1), blocks_a_side(log2 - 1));
            let (own, own_side) = (offset(log2), blocks_a_side(log2));
            for z in from[1]..=to[1] {
                for x in from[0]..=to[0] {
                    let near = finer + 2 * z * finer_side + 2 * x;
                    let of = |at: usize| self.ranges[at];
                    let far = near + finer_side;
                    let range = of(near)
                        .union(of(near + 1))
                        .union(of(far).union(of(far + 1)));
                    self.ranges[own + z * own_side + x] = range;
                }
            }
        }
    }

    /// Looks at the smallest blocks of row `z`, from one column to another, both included.
    fn refresh_row(&mut self, heights: &HeightTile, z: usize, columns: [usize; 2]) {
        const CELLS: usize = 1 << FINEST_LOG2;
        const STORED: usize = TILE_STORED as usize;
        let border = TILE_BORDER as usize;
        let first = columns[0] * CELLS;
        let count = (columns[1] + 1 - columns[0]) * CELLS + 1;
        let mut lowest = [u16::MAX; TILE_SAMPLES as usize + 1];
        let mut highest = [u16::MIN; TILE_SAMPLES as usize + 1];
        let (lowest, highest) = (&mut lowest[..count], &mut highest[..count]);
        for row in z * CELLS..=(z + 1) * CELLS {
            let start = (row + border) * STORED + border + first;
            let samples = &heights.samples()[start..start + count];
            for ((low, high), &sample) in lowest.iter_mut().zip(&mut *highest).zip(samples) {
                *low = (*low).min(sample);
                *high = (*high).max(sample);
            }
        }
        for x in columns[0]..=columns[1] {
            let at = x * CELLS - first;
            let own = at..=at + CELLS;
            self.ranges[z * SIDE + x] = TileRange {
                min: lowest[own.clone()].iter().copied().fold(u16::MAX, u16::min),
                max: highest[own].iter().copied().fold(u16::MIN, u16::max),
            };
        }
    }

    /// The range of the block in column `x` and row `z` among those of `2^log2` cells a side, 3 to 6;
    /// `None` for others.
    #[must_use]
    pub fn get(&self, log2: u32, x: u32, z: u32) -> Option<TileRange> {
        if !(FINEST_LOG2..=COARSEST_LOG2).contains(&log2) {
            return None;
        }
        let side = blocks_a_side(log2);
        let (x, z) = (x as usize, z as usize);
        (x < side && z < side).then(|| self.ranges[offset(log2) + z * side + x])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn tile(seed: u64) -> HeightTile {
        let mut state = seed | 1;
        let samples = (0..TILE_STORED * TILE_STORED)
            .map(|_| {
                state ^= state << 13;
                state ^= state >> 7;
                state ^= state << 17;
                (state >> 40) as u16
            })
            .collect();
        HeightTile::from_samples(samples).expect("133 x 133")
    }

    #[test]
    fn blocks_hold_the_ground_over_them_and_no_more() {
        let heights = tile(5);
        let blocks = BlockRanges::new(&heights);
        for log2 in FINEST_LOG2..=COARSEST_LOG2 {
            let cells = 1_i32 << log2;
            for z in 0..blocks_a_side(log2) as i32 {
                for x in 0..blocks_a_side(log2) as i32 {
                    let range = blocks.get(log2, x as u32, z as u32).expect("is one");
                    let own = (z * cells..=(z + 1) * cells)
                        .flat_map(|z| (x * cells..=(x + 1) * cells).map(move |x| (x, z)))
                        .map(|(x, z)| heights.get(x, z));
                    assert_eq!(Some(range.min), own.clone().min());
                    assert_eq!(Some(range.max), own.max());
                }
            }
        }
        assert_eq!(blocks.get(FINEST_LOG2, SIDE as u32, 0), None);
        assert_eq!(blocks.get(FINEST_LOG2 - 1, 0, 0), None);
        assert_eq!(blocks.get(COARSEST_LOG2 + 1, 0, 0), None);
    }

    proptest! {
        #[test]
        fn a_part_that_is_looked_at_again_is_as_if_all_had_been(
            seed in any::<u64>(),
            a in [0u32..=128, 0u32..=128],
            b in [0u32..=128, 0u32..=128],
            heights in any::<[u16; 2]>(),
        ) {
            let mut tile = tile(seed);
            let mut blocks = BlockRanges::new(&tile);
            let first = [0, 1].map(|axis| a[axis].min(b[axis]));
            let last = [0, 1].map(|axis| a[axis].max(b[axis]));
            for z in first[1]..=last[1] {
                for x in first[0]..=last[0] {
                    let at = (z + TILE_BORDER) * TILE_STORED + x + TILE_BORDER;
                    tile.samples_mut()[at as usize] = heights[(x + z) as usize % 2];
                }
            }
            blocks.refresh(&tile, first, last);
            prop_assert_eq!(&blocks, &BlockRanges::new(&tile));
            // Nothing, and nothing of this tile.
            blocks.refresh(&tile, [5, 5], [4, 9]);
            blocks.refresh(&tile, [129, 0], [140, 9]);
            prop_assert_eq!(&blocks, &BlockRanges::new(&tile));
        }
    }
}
