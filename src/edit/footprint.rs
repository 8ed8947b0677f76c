//! Where an edit changes what, and by how much at most.
//!
//! # Errors of triangles
//! [Error bounds](crate::error_bound) are bounds on `|f − T|`, `f` being the bilinear surface through a
//! level's heights and `T` a triangle with its corners on it. Both are linear in the heights: an edit that
//! adds `q` to them adds at most a bound on `|f − T|` of the surface through `q`. Bounds of edits, and
//! that of the ground before, are added up.
//!
//! As shown [there](crate::error_bound), kinks along x add at most `max(Dx, 0) (Vx/2 + 1/8)` to one
//! side and `max(−Dx, 0) (Vx/2 + 1/8)` to the other, `Dx` being the second difference and `Vx` the
//! variance of the corners around the point, and twists `c` at most `|c| (Vx + Vz)/2`. With `D` the
//! largest `|Dx|` or `|Dz|`, zeros around the edit included, and `C` the largest `|c|`, both sides get at
//! most
//!
//! ```text
//! D/4 + (D + C) (Vx + Vz)/2 ≤ D/4 + s² (D + C)/6
//! ```
//!
//! as `Vx + Vz ≤ s²/3` where edges are no longer than `s`. This is a straight line in `s²`, as is asked of
//! bounds between the spacings that are stored. Below `s = 1` it shrinks as fast as `s`, by the same
//! argument as there.
//!
//! No error is larger than the range `R` of `q`, 0 included. That holds for any `s`; below 1, where
//! bounds shrink with `s`, the slopes within a cell do it: `f` changes by at most `R (|dx| + |dz|)`
//! over `(dx, dz)`, whose mean over the corners is at most `√2 √(s²/3) < s`. Between two stored spacings,
//! one of the two bounds has to hold at both, so there is one spacing at which both do.
//!
//! Where the sum is cut off at the ends of the range of heights, what is left of `q` lies between 0 and
//! `q`, and its kinks can be anything: `R` is all that is known. The same goes for edits that draw the
//! ground somewhere, of which `R` was written down when they were made.
//!
//! # Which texels
//! A triangle with edges up to `s` that meets a texel lies within `s` of it, and `q`'s surface is 0 from one
//! sample around the rectangle of changed samples on. The bound for `2^k` also counts, together with
//! that for `2^(k + 1)`, for spacings in between. So it is raised in all texels that the latter reaches: those
//! at most `2^(k + 1) + 1` samples from the rectangle (65 for the last).
//!
//! # Parents
//! A parent's bound for `2^k` has to be no less than its children's for `2^(k + 1)`. An edit raises it by no
//! less, in an area that covers theirs: rectangles of changed samples cover those of the finer level.

use super::{Change, Edit, SampleRect};
use crate::tile::{
    DENSITY_CELL, DENSITY_TEXELS, ERROR_SPACINGS, ERROR_UNIT, TILE_BORDER, TILE_SAMPLES,
    TileAddress,
};
use pulp::{Arch, NullaryFnOnce};

/// The largest error that there is: all heights lie in this range, in parts of a step.
pub(super) const MOST_ERROR: u32 = u16::MAX as u32 * ERROR_UNIT;

/// Where an edit changes what on each level of a terrain, and by how much at most.
///
/// Kept for every edit of a log: it takes 56 bytes for each of the terrain's levels.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Footprint {
    levels: Box<[LevelFootprint]>,
}

/// A [`Footprint`] on one level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LevelFootprint {
    /// The level's samples that may change, all on the terrain. Covers that of the finer level. May be
    /// empty.
    pub heights: SampleRect,
    /// No sample changes by less, in stored units; 0 or negative.
    pub least: i32,
    /// No sample changes by more, in stored units; 0 or positive.
    pub most: i32,
    /// By how much the [error bounds](crate::tile::ErrorTile) for spacings of 1, 2, 4, … 64 samples rise,
    /// in parts of a step ([`ERROR_UNIT`]).
    pub errors: [u32; ERROR_SPACINGS],
}

impl LevelFootprint {
    /// `values` are those of the samples in `rect`, of a level with `samples` samples.
    pub(super) fn new(
        edit: &Edit,
        rect: SampleRect,
        samples: [u32; 2],
        values: &[i32],
        finer: Option<&Self>,
    ) -> Self {
        let bends = Bends::of(rect, samples, values);
        let (least, most, known) = match &edit.change {
            Change::Flatten { least, most, .. } | Change::Smooth { least, most, .. } => {
                // Without a sample that is drawn anywhere, none changes.
                let any = i32::from(bends.most > 0);
                (least * any, most * any, false)
            }
            Change::Crater { may_clamp, .. }
            | Change::Raise { may_clamp, .. }
            | Change::Stamp { may_clamp, .. } => (bends.least, bends.most, !may_clamp),
        };
        let range = (i64::from(most) - i64::from(least)) as u64;
        let mut errors = own_errors(range, known.then_some((bends.kink, bends.twist)));
        if let Some(finer) = finer {
            for (error, &finer) in errors.iter_mut().zip(&finer.errors[1..]) {
                *error = finer.max(*error);
            }
        }
        for k in 1..ERROR_SPACINGS {
            errors[k] = errors[k].max(errors[k - 1]);
        }
        Self {
            heights: rect,
            least,
            most,
            errors,
        }
    }

    /// The texels of the level whose error bounds for `2^k` samples rise; may reach beyond the terrain.
    #[must_use]
    pub fn error_texels(&self, k: usize) -> SampleRect {
        if self.heights.is_empty() {
            return SampleRect::default();
        }
        texels_within(&self.heights, reach_of_errors(k))
    }

    /// The texels of the level whose density may change: those with a sample on them or beside them
    /// that may.
    pub(super) fn density_texels(&self) -> SampleRect {
        if self.heights.is_empty() {
            return SampleRect::default();
        }
        texels_within(&self.heights, 1)
    }
}

/// How far from what changes error bounds for `2^k` samples rise.
fn reach_of_errors(k: usize) -> i32 {
    (1 << (k + 1).min(ERROR_SPACINGS - 1)) + 1
}

/// Texels whose closed squares are at most `distance` samples from the samples in `rect`.
fn texels_within(rect: &SampleRect, distance: i32) -> SampleRect {
    let cell = DENSITY_CELL as i32;
    SampleRect {
        // Texel x ends with sample 4 x + 4.
        min: rect.min.map(|at| (at - distance - 1).div_euclid(cell)),
        max: rect
            .max
            .map(|end| (end - 1 + distance).div_euclid(cell) + 1),
    }
}

/// The bounds that follow from a level's own samples. `bends` are its largest kink and twist.
fn own_errors(range: u64, bends: Option<(u64, u64)>) -> [u32; ERROR_SPACINGS] {
    let unit = u64::from(ERROR_UNIT);
    let most = (range * unit).min(MOST_ERROR.into());
    let line = |k: usize| match bends {
        Some((kink, twist)) => {
            unit * kink / 4 + ((unit / 2 * (kink + twist)) << (2 * k)).div_ceil(3)
        }
        None => most,
    };
    let mut errors = std::array::from_fn(line);
    if let Some(first) = errors.iter().position(|&error| error >= most) {
        let mut from = first;
        let mut error = most;
        if first > 0 {
            let (below, above) = (errors[first - 1], errors[first]);
            // The spacing at which both bounds hold is the one where that costs less.
            if most * most <= below * above {
                from = first - 1;
            } else {
                error = above;
            }
        }
        errors[from..].fill(error);
    }
    errors.map(|error| error.min(MOST_ERROR.into()) as u32)
}

/// How much a rectangle of numbers bends, and what they range over, 0 included.
struct Bends {
    least: i32,
    most: i32,
    kink: u64,
    twist: u64,
}

impl Bends {
    fn of(rect: SampleRect, samples: [u32; 2], values: &[i32]) -> Self {
        let [width, height] = rect.size();
        if width == 0 || height == 0 {
            return Self {
                least: 0,
                most: 0,
                kink: 0,
                twist: 0,
            };
        }
        // With zeros around, but where the terrain ends: triangles don't reach across its rim.
        let before = rect.min.map(|at| at > 0);
        let after = [0, 1].map(|axis| (rect.max[axis] as u32) < samples[axis]);
        Arch::new().dispatch(Measure {
            before,
            after,
            width,
            values,
        })
    }
}

struct Measure<'a> {
    before: [bool; 2],
    after: [bool; 2],
    width: usize,
    values: &'a [i32],
}

impl NullaryFnOnce for Measure<'_> {
    type Output = Bends;

    #[inline(always)]
    fn call(self) -> Bends {
        let Self {
            before,
            after,
            width,
            values,
        } = self;
        // Two zeros where they belong, none where the terrain ends.
        let pad = [0, 1].map(|axis| [before[axis], after[axis]].map(|any| 2 * usize::from(any)));
        let wide = width + pad[0][0] + pad[0][1];
        let zeros = vec![0; wide];
        let mut rows = [zeros.clone(), zeros.clone(), zeros.clone()];
        let height = values.len() / width;
        let total = height + pad[1][0] + pad[1][1];
        let (mut least, mut most, mut kink, mut twist) = (0, 0, 0, 0);
        for z in 0..total {
            rows.rotate_left(1);
            let [above, middle, row] = &mut rows;
            let at = z.wrapping_sub(pad[1][0]);
            let inner = &mut row[pad[0][0]..pad[0][0] + width];
            if at < height {
                inner.copy_from_slice(&values[at * width..][..width]);
            } else {
                inner.fill(0);
            }
            let (above, middle, row) = (&above[..wide], &middle[..wide], &row[..wide]);
            for &value in row {
                least = if value < least { value } else { least };
                most = if value > most { value } else { most };
            }
            for x in 2..wide {
                let bend = (row[x - 2] - 2 * row[x - 1] + row[x]).abs();
                kink = if bend > kink { bend } else { kink };
            }
            if z >= 1 {
                for x in 1..wide {
                    let bend = (middle[x - 1] - middle[x] - row[x - 1] + row[x]).abs();
                    twist = if bend > twist { bend } else { twist };
                }
            }
            if z >= 2 {
                for x in 0..wide {
                    let bend = (above[x] - 2 * middle[x] + row[x]).abs();
                    kink = if bend > kink { bend } else { kink };
                }
            }
        }
        Bends {
            least,
            most,
            kink: kink as u64,
            twist: twist as u64,
        }
    }
}

impl Footprint {
    pub(super) fn new(levels: Vec<LevelFootprint>) -> Self {
        Self {
            levels: levels.into(),
        }
    }

    /// One for each level of the terrain, the finest first.
    #[must_use]
    pub fn levels(&self) -> &[LevelFootprint] {
        &self.levels
    }

    /// That of one level.
    ///
    /// # Panics
    /// Where the terrain has no such level.
    #[must_use]
    pub fn level(&self, level: u8) -> &LevelFootprint {
        &self.levels[usize::from(level)]
    }

    /// Whether applying the edit to a tile may change anything of it: heights, borders included,
    /// densities or error bounds.
    ///
    /// # Panics
    /// Where the terrain has no such level.
    #[must_use]
    pub fn touches(&self, address: TileAddress) -> bool {
        let level = self.level(address.level);
        // Bounds for the largest spacings reach further than all else.
        let texels = level.error_texels(ERROR_SPACINGS - 1);
        !texels.intersection(&own_texels(address)).is_empty()
    }

    /// Whether applying the edit to a tile may change heights of it, borders included.
    ///
    /// # Panics
    /// Where the terrain has no such level.
    #[must_use]
    pub fn touches_heights(&self, address: TileAddress) -> bool {
        let (x, z) = address.first_sample();
        let first = [x, z].map(|at| at as i32);
        let border = TILE_BORDER as i32;
        let end = (TILE_SAMPLES + TILE_BORDER) as i32 + 1;
        let stored = SampleRect::new(first.map(|at| at - border), first.map(|at| at + end));
        !self
            .level(address.level)
            .heights
            .intersection(&stored)
            .is_empty()
    }
}

/// A tile's own texels, counted from the terrain's corner.
pub(super) fn own_texels(address: TileAddress) -> SampleRect {
    let first = [address.x, address.z].map(|at| (at * DENSITY_TEXELS) as i32);
    SampleRect::new(first, first.map(|at| at + DENSITY_TEXELS as i32))
}
