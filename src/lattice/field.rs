//! The residency field: how fine the data is that is there, as a continuous function.

use super::{EXTENT_LOG2, Lattice};
use crate::tile::TILE_SAMPLES;
use glam::{IVec2, UVec2};

/// Cells along the longer side of a field at most; beyond, several leaf tiles share a cell.
const MAX_CELLS: u32 = 1024;

/// `D(p)`: the finest level that may be read at a lattice point, 8.8 fixed point, bilinear
/// between corner values and therefore continuous.
///
/// Each corner holds the coarsest of its four cells' finest readable levels (or more, while it
/// fades), so that everywhere in a cell `D` is at least what the cell itself has. Weights and
/// values are integers: a float blend of equal values can fall below them, and would then ask for
/// a level that isn't there.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ResidencyField {
    /// Side of a cell in lattice units, as a power of two.
    pub cell_log2: u32,
    /// Cells in x and z; there is one more corner than cells each way.
    pub cells: UVec2,
    /// Corner values, row by row, 8.8 fixed point.
    pub corners: Vec<u16>,
}

impl ResidencyField {
    /// A field over the whole of `lattice` with `level` everywhere.
    #[must_use]
    pub fn new(lattice: &Lattice, level: u8) -> Self {
        let mut cell_log2 = TILE_SAMPLES.ilog2() + lattice.unit_log2;
        let cells = |log2: u32| {
            (lattice.extent.as_uvec2() + UVec2::splat((1 << log2) - 1)) >> UVec2::splat(log2)
        };
        while cells(cell_log2).max_element() > MAX_CELLS && cell_log2 < EXTENT_LOG2 {
            cell_log2 += 1;
        }
        let cells = cells(cell_log2).max(UVec2::ONE);
        let corners = (cells.x + 1) as usize * (cells.y + 1) as usize;
        Self {
            cell_log2,
            cells,
            corners: vec![u16::from(level) << 8; corners],
        }
    }

    /// Index of a corner in [`corners`](Self::corners).
    #[must_use]
    pub fn corner_index(&self, corner: UVec2) -> usize {
        (corner.y * (self.cells.x + 1) + corner.x) as usize
    }

    /// The field at `p`, 8.8 fixed point. The cell follows from the point alone.
    #[must_use]
    pub fn at(&self, p: IVec2) -> i32 {
        let p = p.max(IVec2::ZERO).as_uvec2();
        let cell = (p >> UVec2::splat(self.cell_log2)).min(self.cells - 1);
        // 0..=256: the terrain's last point is the far corner of the last cell.
        let weight =
            (p - (cell << UVec2::splat(self.cell_log2))) >> UVec2::splat(self.cell_log2 - 8);
        let weight = weight.min(UVec2::splat(256));
        let corner = |dx: u32, dz: u32| {
            u32::from(self.corners[self.corner_index(cell + UVec2::new(dx, dz))])
        };
        let near = corner(0, 0) * (256 - weight.x) + corner(1, 0) * weight.x;
        let far = corner(0, 1) * (256 - weight.x) + corner(1, 1) * weight.x;
        ((near * (256 - weight.y) + far * weight.y) >> 16).cast_signed()
    }
}
