//! How much error triangles may leave on the ground beside an edge, or inside a face.
//!
//! For the screen-error policy. Read like densities ([`edge_density`](super::edge_density)): the
//! largest bounds of a square, and of the coarser grid's square while the level morphs. Parents'
//! bounds are at least as large as their children's, so that a coarser level may stand for a finer
//! one, never the other way round; what the finer square says keeps the promise by itself, the coarser
//! one only leads over to the coarser node's factors.

use super::edge_density::{DensityReader, Square, Squares, texel_at, texel_lambda};
use super::height::PageSource;
use crate::tile::{ERROR_SPACINGS, decode_error};
use glam::IVec2;

/// Bounds of the vertical error that triangles leave, in 64ths of a stored height's step: entry `k`
/// for edges up to `2^k` samples of some level, see [`ErrorTile`](crate::tile::ErrorTile).
pub type ErrorBounds = [u32; ERROR_SPACINGS];

/// More than any terrain's relief; so that a blend with weights of 256 stays below 32 bits.
const MOST: u32 = (1 << 23) - 1;

/// `bounds` of a level as those of one `levels` finer: by the same distance on the ground.
fn shifted(bounds: &ErrorBounds, levels: u32) -> ErrorBounds {
    std::array::from_fn(|k| {
        let k = k as u32;
        if k >= levels {
            bounds[(k - levels) as usize]
        } else {
            // Below a sample's distance the error falls with the distance.
            let finer = (levels - k).min(31);
            bounds[0].div_ceil(1 << finer)
        }
    })
}

/// `fine` and `coarse` in parts of 256, rounded up.
fn blended(fine: &ErrorBounds, coarse: &ErrorBounds, part: u32) -> ErrorBounds {
    std::array::from_fn(|k| (fine[k] * (256 - part) + coarse[k] * part + 255) >> 8)
}

/// Bounds, and the level whose samples they count in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LevelErrors {
    /// The bounds of the ground, at the level that is read.
    pub bounds: ErrorBounds,
    /// The level that they are of.
    pub level: u32,
}

/// What triangles leave on some ground: by its own level, and by the coarser one that it morphs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GroundErrors {
    /// By its own level.
    pub fine: LevelErrors,
    /// By the coarser one, and the morph above 0.
    pub coarse: Option<(LevelErrors, i32)>,
}

impl<S: PageSource> DensityReader<'_, S> {
    /// What triangles leave on some ground.
    pub(super) fn errors(&self, squares: &Squares) -> GroundErrors {
        let coarse = squares.coarse.as_ref();
        GroundErrors {
            fine: self.square_errors(&squares.fine),
            coarse: coarse.map(|(square, morph)| (self.square_errors(square), *morph)),
        }
    }

    /// The level that errors of faces of `level` are read from: never a finer one than is drawn, and
    /// while faces morph, the next one is too.
    fn error_level(&self, level: i32) -> u32 {
        (level + 1)
            .clamp(0, self.lattice.root_level)
            .cast_unsigned()
    }

    fn square_errors(&self, square: &Square) -> LevelErrors {
        let level = self.error_level(square.level);
        let [first, last] = square.texels(self.lattice, level);
        let mut largest = [0; ERROR_SPACINGS];
        for z in first.y..=last.y {
            for x in first.x..=last.x {
                let bounds = self.texel_errors(IVec2::new(x, z), level);
                for (largest, bound) in largest.iter_mut().zip(bounds) {
                    *largest = bound.max(*largest);
                }
            }
        }
        LevelErrors {
            bounds: largest,
            level,
        }
    }

    fn texel_errors(&self, texel: IVec2, level: u32) -> ErrorBounds {
        let (centre, lambda) = texel_lambda(self.lattice, self.field, texel, level);
        let (read, blend) = (lambda >> 8, lambda & 255);
        let fine = shifted(&self.level_errors(centre, read), read - level);
        if blend == 0 {
            return fine;
        }
        let coarse = self.level_errors(centre, read + 1);
        blended(&fine, &shifted(&coarse, read + 1 - level), blend)
    }

    fn level_errors(&self, p: IVec2, level: u32) -> ErrorBounds {
        let (tile, local) = texel_at(self.lattice, p, level);
        let bytes = self.source.errors(tile, local.x, local.y);
        std::array::from_fn(|k| bytes.map_or(MOST, |bytes| decode_error(bytes[k]).min(MOST)))
    }
}

/// The longest edge, in samples, whose triangles leave no more than `allowed`.
///
/// Between two entries the bound is linear in the square of the length, below the first in the
/// length.
#[must_use]
pub fn error_spacing(bounds: &ErrorBounds, allowed: f32) -> f32 {
    let first = bounds[0] as f32;
    if allowed < first {
        return allowed / first;
    }
    let mut length = 1.0;
    for k in 1..ERROR_SPACINGS {
        let (low, high) = (bounds[k - 1] as f32, bounds[k] as f32);
        if allowed < high {
            let part = (allowed - low) / (high - low);
            return length * (1.0 + 3.0 * part).sqrt();
        }
        length *= 2.0;
    }
    length
}

/// The bound at edges of `spacing` samples: what [`error_spacing`] turns round. Beyond the last entry it
/// goes on as it rose to it.
#[must_use]
pub fn error_at(bounds: &ErrorBounds, spacing: f32) -> f32 {
    if spacing <= 1.0 {
        return bounds[0] as f32 * spacing;
    }
    let mut length = 1.0;
    let mut k = 1;
    while k + 1 < ERROR_SPACINGS && spacing > 2.0 * length {
        length *= 2.0;
        k += 1;
    }
    let (low, high) = (bounds[k - 1] as f32, bounds[k] as f32);
    let longer = spacing / length;
    low + (high - low) * ((longer * longer - 1.0) / 3.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_at_the_spacing_for_an_error_is_that_error() {
        let bounds = [10, 30, 31, 120, 500, 900, 2000];
        for allowed in 1..2000 {
            let found = error_at(&bounds, error_spacing(&bounds, allowed as f32));
            assert!(
                (found - allowed as f32).abs() < 2e-3 * found,
                "{allowed}: {found}"
            );
        }
        assert_eq!(error_at(&bounds, 64.0), 2000.0);
        assert_eq!(error_at(&bounds, 0.5), 5.0);
        assert!(error_at(&bounds, 80.0) > 2000.0);
    }

    #[test]
    fn spacings_rise_with_what_is_allowed_without_a_jump() {
        let bounds = [10, 30, 30, 120, 500, 500, 2000];
        let mut before = 0.0;
        for allowed in 1..2500 {
            let spacing = error_spacing(&bounds, allowed as f32);
            assert!(spacing >= before, "{allowed}");
            before = spacing;
        }
        assert_eq!(error_spacing(&bounds, 5.0), 0.5);
        assert_eq!(error_spacing(&bounds, 10.0), 1.0);
        assert_eq!(error_spacing(&bounds, 30.0), 4.0);
        assert_eq!(error_spacing(&bounds, 120.0), 8.0);
        assert_eq!(error_spacing(&bounds, 1e9), 64.0);
        assert_eq!(error_spacing(&[0; ERROR_SPACINGS], 0.0), 64.0);
    }

    #[test]
    fn bounds_of_a_coarser_level_stand_for_the_same_distance() {
        let bounds = [16, 20, 30, 40, 50, 60, 70];
        assert_eq!(shifted(&bounds, 0), bounds);
        assert_eq!(shifted(&bounds, 2), [4, 8, 16, 20, 30, 40, 50]);
        assert_eq!(shifted(&bounds, 40)[0], 1);
        assert_eq!(blended(&[8; 7], &[16; 7], 128), [12; 7]);
        assert_eq!(blended(&[8; 7], &[9; 7], 1), [9; 7]);
    }
}
