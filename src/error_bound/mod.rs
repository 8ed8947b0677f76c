//! Bounds on the vertical error that triangles leave of the ground, whatever triangles they are.
//!
//! # What is bounded
//! The ground of a level is the bilinear surface `f` through its stored heights. A texel is the
//! closed square of 4 × 4 cells that a density covers too. For each spacing `L` = 1, 2, 4, … 64
//! samples, a texel has a bound `V` on `|f(p) − T(p)|`, in steps of stored heights, over all points
//! `p` of all triangles `T` that
//! - have their corners on the surface, anywhere, not only on samples,
//! - have edges no longer than `L` in plan,
//! - meet the texel with at least one point, and
//! - lie on the terrain.
//!
//! So whoever knows how long edges are in a texel knows how wrong they can be, without knowing
//! where vertices are; fractional ones slide. Between two of the spacings, the bounds' straight line
//! in `L²` holds, and below the first one, `L · V(1)`: see [`bound`].
//!
//! # One triangle
//! Take a point `p` with barycentric weights `wᵢ` and `dᵢ = xᵢ − p`, so that `Σ wᵢ dᵢ = 0`. By
//! Taylor's theorem along the way from `p` to each corner, the first-order terms cancel out, and
//!
//! ```text
//! T(p) − f(p) = Σ wᵢ ∫₀¹ (1 − t) D²f(p + t dᵢ)[dᵢ, dᵢ] dt
//! ```
//!
//! A bilinear surface on a grid of spacing 1 bends in two ways. At the grid's line `x = j` its slope
//! in x jumps by the second difference `D`, which is linear between points of the grid; and within
//! each cell it twists by `c = h₀₀ − h₁₀ − h₀₁ + h₁₁`.
//! - *Kinks in x.* The line between `p` and corner `i` adds `wᵢ D |xᵢ − j|`. With one `D` for all of
//!   them, these add up to `Σ wᵢ Q(xᵢ) − Q(p)`, `Q` being the polygon through `x²/2` at whole numbers.
//!   It lies above the parabola by at most 1/8. So they are at most `max(D, 0) (Vx/2 + 1/8)` with the
//!   variance `Vx = Σ wᵢ dᵢₓ²`, and the same to the other side with `max(−D, 0)`. Kinks in z
//!   alike.
//! - *Twists* from `m − h` to `m + h`: the mean adds `m Σ wᵢ dᵢₓ dᵢ₂`, what varies at most
//!   `h Σ wᵢ |dᵢₓ dᵢ₂| ≤ h (Vx + Vz)/2`.
//!
//! So the error to one side is at most `(Dx + Dz)/8 + tr(M S)`, with `S` the covariance matrix of the
//! `dᵢ` and `M = ½ ((Dx + h, m), (m, Dz + h))`. Of a triangle with edges up to `L`, the variance in any
//! direction is at most `L²/4`, and their sum `Σ wᵢ wⱼ |xᵢ − xⱼ|²` over pairs at most `L²/3`. Hence
//! `tr(M S) ≤ L² (λ₁/4 + max(λ₂, 0)/12)`, `λ₁ ≥ λ₂` being the eigenvalues of `M`. The bound is a straight
//! line in `L²`.
//!
//! Below `L = 1`, at most one line of each direction runs through a triangle, and it adds at most
//! `D √Vx / 2`. Shrunk from 1 to `L`, this shrinks by `L`, the twist by `L²`, and
//! `√V / 2 ≤ V/2 + 1/8`: the error is at most `L` times the bound at 1.
//!
//! # Coarser grids
//! Where ground is rough, its second differences grow with `L²` and its errors don't. There, `f` is
//! split into a surface `g` with a point at every `2^k'`-th sample and the rest: the error is at most that of
//! `g`, as above with `2^k'` as the unit, and the largest less the smallest rest. Any `g` will do; with means of the
//! ground around each point, both come out lower than with the samples there. Last, no error is
//! larger than the ground's highest less its lowest. The best of these is taken.
//!
//! # Boxes
//! All of this needs the largest `D`, `c` and rest around the triangle. A triangle with edges up to
//! `L` lies in one of the boxes that are `3/2 L` wide and begin at whole multiples of `L/2` (`2 L` and
//! `L` where `L` is 1), so each box gets a bound of its own, and a texel the largest of the boxes that
//! can hold a triangle which meets it. That is much tighter than the largest of everything around the
//! texel.
//!
//! Between the spacings `L` and `2 L`, the box for `2 L` holds, and there the *same* grid's line
//! from its bound at `L` to that at `2 L`; so the bound stored for `L` is also at least that of these
//! boxes' grids at `L`. The best grid is the one with the least sum of both, that at `L` counted twice.
//!
//! # Rim
//! Beyond the terrain's rim there are no triangles, and cells that begin there don't count. Where a
//! grid's cell reaches beyond it, the ground goes on turned about the rim by half a turn.
//!
//! # Parents
//! A coarser level's heights are means, and its bounds say nothing about what was lost. So that bounds
//! don't fall as levels get coarser, a parent's bound at `k` is raised to its children's at `k + 1`,
//! which is as far on the ground.
//!
//! A tile's bounds follow from its heights and those [`ERROR_REACH`] samples around it. They don't
//! depend on the machine: IEEE arithmetic in a fixed order, nothing fused.

mod boxes;
mod grid;
mod window;

use crate::tile::{
    DENSITY_CELL, DENSITY_TEXELS, ERROR_SPACINGS, ERROR_UNIT, ErrorTile, TILE_SAMPLES, decode_error,
};
use boxes::{Family, PAD};
use grid::{Cells, Extremes, Grid, larger};
use pulp::{Arch, Simd, WithSimd};
use window::{MARGIN, SIDE, Window};

/// Samples beyond a tile's own square on which its bounds depend.
pub const ERROR_REACH: u32 = 96;
/// Samples beyond a tile's own square that a box reaches which holds a triangle there.
const REACH: usize = 64;

const TEXELS: usize = DENSITY_TEXELS as usize;
const CELL: usize = DENSITY_CELL as usize;
/// More than what rounding in single precision can take from a bound.
const ROUNDING: f32 = 1.000_01;

/// Memory that [`tile_errors`] works in, less than 2 MiB. Kept, it is not allocated again.
#[derive(Clone, Debug, Default)]
pub struct ErrorScratch {
    window: Window,
    grid: Grid,
    cells: Cells,
    range: [Extremes; 2],
    families: [Family; ERROR_SPACINGS],
}

/// The bounds of the tile whose first own sample is `first`, on a level with `samples` samples in x
/// and z, from the level's heights alone: without what its children have. `row(z)` gives the level's
/// rows; it is asked for those at most [`ERROR_REACH`] before the tile's first and after its last.
///
/// Allocates nothing but the result where `scratch` has been
/// used before.
///
/// # Panics
/// Where the tile lies beyond the level, the level has less than two samples a side, or a row is
/// shorter than the level.
#[must_use]
pub fn tile_errors<'a>(
    samples: [u32; 2],
    first: [u32; 2],
    row: impl Fn(u32) -> &'a [u16],
    scratch: &mut ErrorScratch,
) -> ErrorTile {
    for axis in [0, 1] {
        assert!(
            samples[axis] >= 2 && first[axis] + 1 < samples[axis],
            "the tile lies on the level"
        );
    }
    let mut errors = ErrorTile::flat();
    Arch::new().dispatch(Sweep {
        samples,
        first,
        row,
        scratch,
        out: errors.texels_mut(),
    });
    errors
}

/// The bound on the error of triangles with edges up to `spacing` samples of the tile's level that
/// meet a texel, in steps of stored heights, from what [`ErrorTile`] holds of it. `None` where
/// `spacing` is larger than the 64 samples that a tile tells of: then a coarser level's texel does.
/// 0 for spacings that are not positive.
#[must_use]
pub fn bound(texel: &[u8; 8], spacing: f64) -> Option<f64> {
    let stored = |k: usize| f64::from(decode_error(texel[k])) / f64::from(ERROR_UNIT);
    if spacing.is_nan() || spacing <= 0.0 {
        return Some(0.0);
    }
    if spacing <= 1.0 {
        return Some(spacing * stored(0));
    }
    (1..ERROR_SPACINGS).find_map(|k| {
        let square = 4_f64.powi(k as i32 - 1);
        let part = (spacing * spacing - square) / (3.0 * square);
        (part <= 1.0).then(|| stored(k - 1) + (stored(k) - stored(k - 1)) * part)
    })
}

/// Raises a texel's bounds to those of a texel below it (or the largest of the four): a spacing of
/// `2^k` samples is one of `2^(k + 1)` there. Makes sure that they don't fall, too.
pub fn cover_finer(texel: &mut [u8; 8], finer: &[u8; 8]) {
    for k in 0..ERROR_SPACINGS {
        if k + 1 < ERROR_SPACINGS {
            texel[k] = texel[k].max(finer[k + 1]);
        }
        if k > 0 {
            texel[k] = texel[k].max(texel[k - 1]);
        }
    }
}

/// The arguments of the sweep, which is compiled for several instruction sets. All of them compute
/// the same bits.
struct Sweep<'a, F> {
    samples: [u32; 2],
    first: [u32; 2],
    row: F,
    scratch: &'a mut ErrorScratch,
    out: &'a mut [[u8; 8]],
}

impl<'a, F: Fn(u32) -> &'a [u16]> WithSimd for Sweep<'_, F> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let ErrorScratch {
            window,
            grid,
            cells,
            range,
            families,
        } = self.scratch;
        window.fill(self.samples, self.first, self.row);
        begin(simd, window, range, families);
        // Grids with points 1, 2, 4, 8 and 16 samples apart.
        measure::<S, 0, 1>(simd, window, grid, cells, families);
        measure::<S, 1, 2>(simd, window, grid, cells, families);
        measure::<S, 2, 4>(simd, window, grid, cells, families);
        measure::<S, 3, 8>(simd, window, grid, cells, families);
        measure::<S, 4, 16>(simd, window, grid, cells, families);
        finish(simd, window, families, self.out);
    }
}

/// Samples along a cell of a family.
const fn cell_of(family: usize) -> usize {
    if family == 0 { 1 } else { 1 << (family - 1) }
}

/// Cells along a box of a family: enough for any triangle, wherever it begins in the first of them.
const fn cells_of(family: usize) -> usize {
    if family == 0 { 2 } else { 3 }
}

#[inline(always)]
fn begin<S: Simd>(
    simd: S,
    window: &Window,
    range: &mut [Extremes; 2],
    families: &mut [Family; ERROR_SPACINGS],
) {
    let own = TILE_SAMPLES as usize;
    let [finest, second, others @ ..] = families;
    // A bound that is no line from 0 doesn't hold below the first spacing.
    finest.begin_empty(own + 1);
    let heights = window.heights.as_slice();
    // Three cells have four samples.
    second.begin::<S, 4>(simd, own + 2, [heights; 2], SIDE, MARGIN - 2);
    let [fine, coarse] = range;
    let mut side = grid::measure_range(window, fine);
    for (family, number) in others.iter_mut().zip(2..) {
        let cell = cell_of(number);
        let first = REACH / cell - 2;
        family.begin::<S, 3>(simd, own / cell + 2, fine.planes(), side, first);
        side = grid::halve_range(fine, side, coarse);
        std::mem::swap(fine, coarse);
    }
}

/// Tries the grid with a point at every `SPACING`-th sample, two to the power of `NUMBER`, for spacings
/// twice and four times its own. On smooth ground, finer grids give bounds lower by less than a tenth;
/// on real ground, none that could be measured.
#[inline(always)]
fn measure<S: Simd, const NUMBER: usize, const SPACING: usize>(
    simd: S,
    window: &Window,
    grid: &mut Grid,
    cells: &mut Cells,
    families: &mut [Family; ERROR_SPACINGS],
) {
    // As far as the coarsest family that it is tried for.
    let last = (NUMBER + 2).min(ERROR_SPACINGS - 1);
    let margin = 2 * cell_of(last);
    if NUMBER == 0 {
        grid.begin();
    } else {
        grid.coarsen(window);
    }
    grid.measure::<S, SPACING>(simd, window, margin);
    if NUMBER == 0 {
        families[0].consider_grid::<S, 1, 2, 3, false>(simd, grid, margin - 1, 1.0);
        families[1].consider_grid::<S, 2, 3, 4, false>(simd, grid, margin - 2, 2.0);
    } else {
        let first = margin / cell_of(NUMBER + 1) - 2;
        families[NUMBER + 1].consider_grid::<S, 2, 3, 4, true>(simd, grid, first, 2.0);
    }
    if NUMBER + 2 <= last {
        grid.halve(cells, NUMBER > 0);
        let first = margin / cell_of(last) - 2;
        if NUMBER == 0 {
            families[last].consider_cells::<S, false>(simd, cells, first, 4.0);
        } else {
            families[last].consider_cells::<S, true>(simd, cells, first, 4.0);
        }
    }
}

/// Room for the longest row of boxes, and more.
const ROOM: usize = TILE_SAMPLES as usize + 2 + 2 * PAD;

/// From boxes to texels.
#[inline(always)]
fn finish<S: Simd>(
    simd: S,
    window: &Window,
    families: &[Family; ERROR_SPACINGS],
    out: &mut [[u8; 8]],
) {
    let [columns, rows] = [0, 1].map(|axis| window.cells_on_terrain(axis, MARGIN, CELL, TEXELS));
    let mut bytes = [[0_u8; TEXELS]; ERROR_SPACINGS];
    let mut room = [[0.0; ROOM]; 2];
    for z in rows {
        let mut bounds = [[0.0_f32; TEXELS]; ERROR_SPACINGS];
        for (k, family) in families.iter().enumerate() {
            around(simd, family, &family.bound, k, z, &mut room, &mut bounds[k]);
            if k > 0 {
                let out = &mut bounds[k - 1];
                around(simd, family, &family.finer, k, z, &mut room, out);
            }
        }
        for (bytes, bounds) in bytes.iter_mut().zip(&bounds) {
            for (byte, &bound) in bytes.iter_mut().zip(bounds) {
                *byte = encode(bound);
            }
        }
        for x in columns.clone() {
            let texel = &mut out[z * TEXELS + x];
            let mut largest = 0;
            for (texel, bytes) in texel.iter_mut().zip(&bytes) {
                // A bound doesn't fall as spacings grow.
                largest = bytes[x].max(largest);
                *texel = largest;
            }
        }
    }
}

/// Raises each texel of row `z` to the largest bound of family `k` in the boxes that can hold a
/// triangle which meets it.
#[inline(always)]
fn around<S: Simd>(
    simd: S,
    family: &Family,
    plane: &[f32],
    k: usize,
    z: usize,
    [column, spare]: &mut [[f32; ROOM]; 2],
    out: &mut [f32; TEXELS],
) {
    let cell = cell_of(k);
    let reach = (CELL / cell).max(1) + cells_of(k) - 1;
    let stride = family.stride;
    let rows = &plane[CELL * z / cell * stride..][..reach * stride];
    let count = stride / S::F32_LANES;
    for x in 0..count {
        let mut largest = simd.splat_f32s(0.0);
        for row in rows.chunks_exact(stride) {
            largest = simd.max_f32s(largest, S::as_simd_f32s(row).0[x]);
        }
        S::as_mut_simd_f32s(&mut column[..]).0[x] = largest;
    }
    // Of one box, of two from each on, of four, and so on: into another row, as loops that change a
    // row in its place come out slower.
    let (mut column, mut spare) = (column, spare);
    let mut width = 1;
    while width < reach {
        let shift = width.min(reach - width);
        for x in 0..count {
            let a = S::as_simd_f32s(&column[x * S::F32_LANES..]).0[0];
            let b = S::as_simd_f32s(&column[x * S::F32_LANES + shift..]).0[0];
            S::as_mut_simd_f32s(&mut spare[..]).0[x] = simd.max_f32s(a, b);
        }
        std::mem::swap(&mut column, &mut spare);
        width += shift;
    }
    for (x, out) in out.iter_mut().enumerate() {
        let largest = column[CELL * x / cell];
        *out = larger(*out, largest);
    }
}

/// The byte that stands for a bound: the same as
/// [`encode_error`](crate::tile::encode_error) gives, without a branch.
#[inline(always)]
fn encode(bound: f32) -> u8 {
    let most = u16::MAX as f32;
    let bound = if bound < most { bound } else { most };
    let units = bound * ROUNDING * ERROR_UNIT as f32;
    // Three bits of a number's fraction and its exponent, rounded up, are the byte but for a constant.
    const EIGHT: u32 = 8.0_f32.to_bits() >> 20;
    let rounded = (larger(8.0, units).to_bits() + 0xf_ffff) >> 20;
    if units > 0.0 {
        (rounded - EIGHT + 1) as u8
    } else {
        0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tile::encode_error;

    #[test]
    fn bounds_are_stored_as_the_least_byte_that_holds_them() {
        let all = (0..200_000).map(|number| number as f32 * 0.37);
        for bound in all.chain((0..2000).map(|number| number as f32 / 512.0)) {
            let units = bound.min(65_535.0) * ROUNDING * ERROR_UNIT as f32;
            assert_eq!(encode(bound), encode_error(units.ceil() as u32), "{bound}");
        }
        assert_eq!(encode(-1.0), 0);
        assert_eq!(encode(f32::MAX), encode(65_535.0));
    }
}
