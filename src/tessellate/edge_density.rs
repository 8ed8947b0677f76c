//! How finely ground deserves to be cut: the density of an edge and of a face's inside (Cervin 2012,
//! algorithm 3.1, which reads one point of an edge).
//!
//! Densities scale edge factors, and so whatever is read here decides topology: all of it is
//! integers. An edge reads the largest density of the square of its length around its middle, which
//! covers half of both faces beside it. The square is that of the edge on its level's *grid*, where
//! it lies on whole texels; while the level morphs it is blended with that of the edge of the coarser
//! grid that it turns into. Squares around the moving ends would step over texels while the eye
//! moves, and factors would jump.

use super::height::{PageSource, tile_at};
use crate::lattice::{Lattice, ONE, ResidencyField, ViewLod};
use crate::tile::{DENSITY_CELL, DENSITY_TEXELS, TileAddress};
use glam::IVec2;

/// The density of ground that deserves all triangles that the settings allow, in the unit of
/// [`DensityReader`]: 255 in 8.16 fixed point.
pub const DENSITY_ONE: u32 = 255 << 16;

/// Lattice units along the side of a density texel of `level`, as a power of two.
fn texel_log2(lattice: &Lattice, level: u32) -> u32 {
    lattice.unit_log2 + DENSITY_CELL.ilog2() + level
}

/// The tile of `level` that holds `p`, and the texel in it.
pub(super) fn texel_at(lattice: &Lattice, p: IVec2, level: u32) -> (TileAddress, IVec2) {
    let tile = tile_at(lattice, p, level);
    let texel = p >> IVec2::splat(texel_log2(lattice, level).cast_signed());
    let first =
        IVec2::new(tile.x.cast_signed(), tile.z.cast_signed()) * DENSITY_TEXELS.cast_signed();
    (
        tile,
        (texel - first).min(IVec2::splat(DENSITY_TEXELS.cast_signed() - 1)),
    )
}

/// The middle of a texel of `level`, and the level of detail to read there (8.8): its own where that
/// is resident, else what the residency field names.
pub(super) fn texel_lambda(
    lattice: &Lattice,
    field: &ResidencyField,
    texel: IVec2,
    level: u32,
) -> (IVec2, u32) {
    let log2 = texel_log2(lattice, level).cast_signed();
    let centre = lattice.clamp((texel << IVec2::splat(log2)) + (1 << (log2 - 1)));
    let lambda = (level.cast_signed() << 8)
        .max(field.at(centre))
        .min(lattice.root_level << 8);
    (centre, lambda.cast_unsigned())
}

/// The stored density at `p`, of one level.
fn level_density(source: &impl PageSource, lattice: &Lattice, p: IVec2, level: u32) -> u32 {
    let (tile, local) = texel_at(lattice, p, level);
    source
        .density(tile, local.x, local.y)
        .map_or(255, u32::from)
}

/// The density of a texel of `level`, 8.8 fixed point: that of its own level where it is resident,
/// else of the levels that the residency field names, blended, so that it moves with the field.
fn texel_density(
    source: &impl PageSource,
    lattice: &Lattice,
    field: &ResidencyField,
    texel: IVec2,
    level: u32,
) -> u32 {
    let (centre, lambda) = texel_lambda(lattice, field, texel, level);
    let (level, blend) = (lambda >> 8, lambda & 255);
    let fine = level_density(source, lattice, centre, level);
    if blend == 0 {
        return fine << 8;
    }
    let coarse = level_density(source, lattice, centre, level + 1);
    fine * (256 - blend) + coarse * blend
}

/// The level whose texels are half as long as the faces of `level`, or the nearest that there is.
fn read_level(lattice: &Lattice, level: i32) -> u32 {
    // A face has 128 / faces samples, a texel 4.
    let half = level + 4 - lattice.faces_log2.cast_signed();
    half.clamp(0, lattice.root_level).cast_unsigned()
}

/// A square of ground that reaches `half` to all sides of `centre`, and the level of the faces that
/// it is asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Square {
    centre: IVec2,
    half: i32,
    pub(super) level: i32,
}

impl Square {
    /// The first and the last texel of level `texels` in it.
    pub(super) fn texels(&self, lattice: &Lattice, texels: u32) -> [IVec2; 2] {
        let log2 = IVec2::splat(texel_log2(lattice, texels).cast_signed());
        let last = (lattice.extent - 1).max(IVec2::ZERO) >> log2;
        // A square that ends on a texel's border doesn't reach into the next.
        [self.centre - self.half, self.centre + self.half - 1]
            .map(|corner| (corner >> log2).clamp(IVec2::ZERO, last))
    }
}

/// The ground that an edge, or the inside of a face, is about: that of its own level's grid, and how
/// far it has morphed towards that of the coarser one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Squares {
    pub(super) fine: Square,
    /// And the morph, above 0.
    pub(super) coarse: Option<(Square, i32)>,
}

/// What densities and errors are read from.
pub struct DensityReader<'a, S> {
    /// The terrain's grid, which says where texels lie.
    pub lattice: &'a Lattice,
    /// The view's level of detail.
    pub lod: &'a ViewLod,
    /// How finely densities may be read where.
    pub field: &'a ResidencyField,
    /// Stored densities and errors.
    pub source: &'a S,
}

impl<S: PageSource> DensityReader<'_, S> {
    /// The ground beside the edge between control vertices `a` and `b`, counted in faces from the
    /// corner `origin` of a node of `level`.
    pub(super) fn edge_squares(&self, level: i32, origin: IVec2, a: IVec2, b: IVec2) -> Squares {
        let step = self.lattice.face_size(level);
        // Written so that no sum of two places leaves 32 bits.
        let middle = |a: IVec2, b: IVec2| origin + a * step + (b - a) * (step / 2);
        let fine = Square {
            centre: middle(a, b),
            half: step / 2,
            level,
        };
        let place = self.lattice.clamp(fine.centre);
        let morph = self.lod.morph(self.lattice, place, level);
        // The ends slide onto the coarser grid; an edge whose ends meet there vanishes.
        let (a, b) = (a - (a & 1), b - (b & 1));
        let coarse = Square {
            centre: middle(a, b),
            half: step,
            level: level + 1,
        };
        Squares {
            fine,
            coarse: (morph > 0 && a != b).then_some((coarse, morph)),
        }
    }

    /// The ground of face `ij` of a node of `level` with corner `origin`.
    pub(super) fn face_squares(&self, level: i32, origin: IVec2, ij: IVec2) -> Squares {
        let step = self.lattice.face_size(level);
        let corner = origin + ij * step;
        let fine = Square {
            centre: corner + step / 2,
            half: step / 2,
            level,
        };
        let place = self.lattice.clamp(fine.centre);
        let morph = self.lod.morph(self.lattice, place, level);
        let coarse = Square {
            centre: corner - (ij & 1) * step + step,
            half: step,
            level: level + 1,
        };
        Squares {
            fine,
            coarse: (morph > 0).then_some((coarse, morph)),
        }
    }

    /// The density of the edge between control vertices `a` and `b`, counted in faces from the
    /// corner `origin` of a node of `level`, in units of [`DENSITY_ONE`] (Cervin 2012, algorithm 3.1).
    #[must_use]
    pub fn edge_density(&self, level: i32, origin: IVec2, a: IVec2, b: IVec2) -> u32 {
        self.density(&self.edge_squares(level, origin, a, b))
    }

    /// The density of the inside of face `ij` of a node of `level` with corner `origin`, in units of
    /// [`DENSITY_ONE`] (Cervin 2012, algorithm 3.1).
    #[must_use]
    pub fn face_density(&self, level: i32, origin: IVec2, ij: IVec2) -> u32 {
        self.density(&self.face_squares(level, origin, ij))
    }

    /// The density of some ground, in units of [`DENSITY_ONE`].
    pub(super) fn density(&self, squares: &Squares) -> u32 {
        let fine = self.square_density(&squares.fine);
        match &squares.coarse {
            None => fine << 8,
            Some((coarse, morph)) => blend(fine, self.square_density(coarse), *morph),
        }
    }

    /// The largest density of a square, read from the level that suits its faces; 8.8 fixed point.
    fn square_density(&self, square: &Square) -> u32 {
        let level = read_level(self.lattice, square.level);
        let [first, last] = square.texels(self.lattice, level);
        let mut largest = 0;
        for z in first.y..=last.y {
            for x in first.x..=last.x {
                let texel = IVec2::new(x, z);
                let density = texel_density(self.source, self.lattice, self.field, texel, level);
                largest = largest.max(density);
            }
        }
        largest
    }
}

/// `fine` and `coarse` (8.8) blended by a morph, in 8.16.
fn blend(fine: u32, coarse: u32, morph: i32) -> u32 {
    let morph = morph.cast_unsigned();
    (fine * (ONE.cast_unsigned() - morph) + coarse * morph) >> 8
}
