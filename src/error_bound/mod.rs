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
    DENSITY_CELL, DENSITY_TEXELS, ERROR_SPACINGS, ERROR_UNIT, ErrorTile, TILE_SAMPLES,
    decode_error, encode_error,
};
use boxes::Family;
use grid::{Cells, Extremes, Grid, larger};
use pulp::{Arch, NullaryFnOnce};
use window::{MARGIN, SIDE, Window};

/// Samples beyond a tile's own square on which its bounds depend.
pub const ERROR_REACH: u32 = 96;
/// Samples beyond a tile's own square that a box reaches which holds a triangle there.
const REACH: usize = 64;

const TEXELS: usize = DENSITY_TEXELS as usize;
const CELL: usize = DENSITY_CELL as usize;
/// Grids that are tried: with points 1, 2, 4, 8 and 16 samples apart.
const GRIDS: usize = 5;
/// Spacings for which a grid is tried: twice and four times its own. On smooth ground, finer grids
/// give bounds lower by less than a tenth; on real ground, none that could be measured.
const USES: usize = 2;
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
    scratch.window.fill(samples, first, row);
    let mut errors = ErrorTile::flat();
    Arch::new().dispatch(Sweep {
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

/// The arguments of the sweep, which is compiled for several instruction sets.
struct Sweep<'a> {
    scratch: &'a mut ErrorScratch,
    out: &'a mut [[u8; 8]],
}

impl NullaryFnOnce for Sweep<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let ErrorScratch {
            window,
            grid,
            cells,
            range,
            families,
        } = self.scratch;
        begin(window, range, families);
        for number in 0..GRIDS {
            measure(window, number, grid, cells, families);
        }
        finish(window, families, self.out);
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
fn begin(window: &Window, range: &mut [Extremes; 2], families: &mut [Family; ERROR_SPACINGS]) {
    let own = TILE_SAMPLES as usize;
    let [finest, second, others @ ..] = families;
    // A bound that is no line from 0 doesn't hold below the first spacing.
    finest.begin_empty(own + 1);
    let heights = window.heights.as_slice();
    second.begin(own + 2, [heights; 2], SIDE, MARGIN - 2, 4);
    let [fine, coarse] = range;
    let mut side = grid::measure_range(window, fine);
    for (family, number) in others.iter_mut().zip(2..) {
        let cell = cell_of(number);
        let planes = [fine.high.as_slice(), fine.low.as_slice()];
        let first = REACH / cell - 2;
        family.begin(own / cell + 2, planes, side, first, cells_of(number));
        side = grid::halve_range(fine, side, coarse);
        std::mem::swap(fine, coarse);
    }
}

#[inline(always)]
fn measure(
    window: &Window,
    number: usize,
    grid: &mut Grid,
    cells: &mut Cells,
    families: &mut [Family; ERROR_SPACINGS],
) {
    // As far as the coarsest family that it is tried for.
    let last = (number + USES).min(ERROR_SPACINGS - 1);
    let margin = 2 * cell_of(last);
    if number == 0 {
        grid.begin();
    } else {
        grid.coarsen(window);
    }
    grid.measure(window, margin);
    if number == 0 {
        families[0].consider_grid(grid, margin - 1, cells_of(0), 1.0);
    }
    let finer = families.iter_mut().enumerate().take(last + 1);
    for (family, target) in finer.skip(number + 1) {
        let (cell, count) = (cell_of(family), cells_of(family));
        let first = margin / cell - 2;
        let spacing = (1 << (family - number)) as f32;
        if family == number + 1 {
            target.consider_grid(grid, first, count, spacing);
        } else {
            grid.halve(cells);
            target.consider_cells(cells, number > 0, first, count, spacing);
        }
    }
}

/// From boxes to texels.
#[inline(always)]
fn finish(window: &Window, families: &[Family; ERROR_SPACINGS], out: &mut [[u8; 8]]) {
    let [columns, rows] = [0, 1].map(|axis| window.cells_on_terrain(axis, MARGIN, CELL, TEXELS));
    let mut bounds = [[0.0_f32; TEXELS]; ERROR_SPACINGS];
    for z in rows {
        for (k, family) in families.iter().enumerate() {
            around(&family.bound, family.side, k, z, &mut bounds[k]);
            if k > 0 {
                around(&family.finer, family.side, k, z, &mut bounds[k - 1]);
            }
        }
        for x in columns.clone() {
            let texel = &mut out[z * TEXELS + x];
            for (byte, row) in texel.iter_mut().zip(&bounds) {
                *byte = encode(row[x]);
            }
            cover_finer(texel, &[0; 8]);
        }
        bounds = [[0.0; TEXELS]; ERROR_SPACINGS];
    }
}

/// Raises each texel of row `z` to the largest bound of family `k` in the boxes that can hold a
/// triangle which meets it.
#[inline(always)]
fn around(plane: &[f32], side: usize, k: usize, z: usize, out: &mut [f32; TEXELS]) {
    const ROOM: usize = TILE_SAMPLES as usize + 2;
    let cell = cell_of(k);
    let reach = (CELL / cell).max(1) + cells_of(k) - 1;
    let first = |texel: usize| CELL * texel / cell;
    let (mut column, mut largest) = ([0.0_f32; ROOM], [0.0_f32; ROOM]);
    let column = &mut column[..side];
    for row in first(z)..first(z) + reach {
        for (out, &value) in column.iter_mut().zip(&plane[row * side..]) {
            *out = larger(*out, value);
        }
    }
    let largest = &mut largest[..side + 1 - reach];
    for shift in 0..reach {
        for (out, &value) in largest.iter_mut().zip(&column[shift..]) {
            *out = larger(*out, value);
        }
    }
    for (x, out) in out.iter_mut().enumerate() {
        *out = larger(*out, largest[first(x)]);
    }
}

/// The byte that stands for a bound.
#[inline(always)]
fn encode(bound: f32) -> u8 {
    let most = u16::MAX as f32;
    let bound = if bound < most { bound } else { most };
    let units = bound * ROUNDING * ERROR_UNIT as f32;
    let below = units as u32;
    encode_error(below + u32::from((below as f32) < units))
}
