//! The integer lattice that all horizontal positions live on, and what follows from position
//! alone: level of detail, morph, and which nodes a view draws.
//!
//! Nothing here knows a neighbour, a frame before, or a screen. Two faces that share an edge see
//! the same integers on it because every function below takes a position and a view, never the
//! face that asks. Conditions under which that makes the mesh watertight:
//!
//! 1. positions are integers ([`Lattice`]);
//! 2. level of detail is a function of position alone ([`ViewLod::distance`]);
//! 3. a level's reach leaves room for its morph, `R >= 2 + 2 Z` ([`LodSettings::validate`]);
//! 4. an edge's subdivision depends on its two end points alone (module
//!    [`tessellate`](crate::tessellate)).
//!
//! A terrain whose size is no multiple of the node size ends exactly at its last sample: control
//! vertices are clamped to the terrain's extent, and so are the node boxes that selection
//! measures, which keeps condition 2 true at the rim.

mod field;
mod select;

pub use field::ResidencyField;
pub use select::{Node, NodeBounds};

use crate::tile::TILE_SAMPLES;
#[cfg(feature = "ecs")]
use bevy::prelude::ReflectDefault;
use glam::IVec2;
use std::ops::RangeInclusive;

/// One in the 16.16 fixed point of morphs, levels of detail and edge parameters.
pub const ONE: i32 = 1 << 16;
/// Levels that a view can hold: those of the tiles and those finer than the finest tile.
pub const MAX_LEVELS: usize = 24;
/// Lattice coordinates of a terrain stay below two to this power.
pub const EXTENT_LOG2: u32 = 30;
/// Lattice units per sample, as a power of two, where the terrain's size doesn't force fewer.
pub const UNIT_LOG2_MAX: u32 = 12;
/// Faces along a node's side where nothing else is asked for: the most accurate for its triangles of
/// 4, 8 and 16 (`cargo bench --bench tessellation`).
pub const DEFAULT_FACES_PER_SIDE: u32 = 4;
/// A face of the finest level is at least two to this power units long.
const LEAF_FACE_LOG2_MIN: u32 = 6;

/// Why a lattice or a level-of-detail setting was refused.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LatticeError {
    /// The terrain has too many samples for 30-bit positions at the wanted fineness.
    #[error(
        "a terrain of {levels} levels with geometry down to level {leaf_level} does not fit the \
         lattice: use fewer levels, a coarser leaf level or fewer faces a side"
    )]
    TooLarge {
        /// Levels of the terrain.
        levels: u8,
        /// Finest geometry level wanted.
        leaf_level: i32,
    },
    /// `faces_per_side` is not a power of two in 2..=32.
    #[error("faces_per_side is {0}: use a power of two from 2 to 32")]
    FacesPerSide(u32),
    /// The finest geometry level is above level 0 or too far below.
    #[error("leaf_level is {0}: use 0 for the finest tiles, or down to -8 for finer nodes")]
    LeafLevel(i32),
    /// `R < 2 + 2 Z`: nodes would meet coarser ones before they are fully morphed.
    #[error(
        "reach {reach} is below 2 + 2 x morph ({morph}), which would tear the mesh: raise reach to at least {least}"
    )]
    ReachTooShort {
        /// The reach asked for.
        reach: f32,
        /// The morph zone asked for.
        morph: f32,
        /// The least reach that this morph zone allows.
        least: f32,
    },
    /// The reach is not a finite number that the lattice can hold.
    #[error("reach is {0}: use a number from 2 to 32")]
    Reach(f32),
    /// The morph zone is not a power of two in 1/16..=4.
    #[error("morph is {0}: use a power of two from 1/16 to 4")]
    Morph(f32),
}

/// A terrain's integer grid: how samples, tiles, nodes and faces lie on it.
///
/// Lattice point `(0, 0)` is sample `(0, 0)`; `1 << unit_log2` units make one level-0 sample.
/// Nodes of level `l` have `TILE_SAMPLES << l` samples a side, so that node and tile of a level
/// are the same square; negative levels are finer than the finest tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lattice {
    /// Lattice units per level-0 sample, as a power of two.
    pub unit_log2: u32,
    /// The last lattice point of the terrain in x and z.
    pub extent: IVec2,
    /// Finest level of the geometry, at most 0.
    pub leaf_level: i32,
    /// Coarsest level; one node of it covers the terrain.
    pub root_level: i32,
    /// Faces along a node's side, as a power of two.
    pub faces_log2: u32,
}

impl Lattice {
    /// The lattice of a terrain of `size` samples whose coarsest tile level is `levels - 1`.
    ///
    /// # Errors
    /// Where the sizes don't fit 30-bit positions, or an argument is out of its range.
    pub fn new(
        size: [u32; 2],
        levels: u8,
        leaf_level: i32,
        faces_per_side: u32,
    ) -> Result<Self, LatticeError> {
        let faces_log2 = faces_log2(faces_per_side)?;
        if !LEAF_LEVEL_RANGE.contains(&leaf_level) {
            return Err(LatticeError::LeafLevel(leaf_level));
        }
        let too_large = LatticeError::TooLarge { levels, leaf_level };
        let root_log2 = TILE_SAMPLES.ilog2() + u32::from(levels.max(1)) - 1;
        let unit_log2 = EXTENT_LOG2
            .checked_sub(root_log2)
            .ok_or(too_large)?
            .min(UNIT_LOG2_MAX);
        let leaf_face_log2 = (TILE_SAMPLES.ilog2() + unit_log2)
            .checked_sub(faces_log2 + leaf_level.unsigned_abs())
            .ok_or(too_large)?;
        let fits = size
            .iter()
            .all(|&samples| samples >= 2 && samples - 1 <= 1 << root_log2);
        let geometry_levels = levels as usize + leaf_level.unsigned_abs() as usize;
        if leaf_face_log2 < LEAF_FACE_LOG2_MIN || !fits || geometry_levels > MAX_LEVELS {
            return Err(too_large);
        }
        Ok(Self {
            unit_log2,
            extent: IVec2::from(size.map(|samples| ((samples - 1) << unit_log2).cast_signed())),
            leaf_level,
            root_level: i32::from(levels.max(1)) - 1,
            faces_log2,
        })
    }

    /// The same grid with nodes of another number of faces.
    ///
    /// # Errors
    /// Where that is no power of two from 2 to 32, or the finest faces would be too small.
    pub fn with_faces_per_side(self, faces_per_side: u32) -> Result<Self, LatticeError> {
        let faces_log2 = faces_log2(faces_per_side)?;
        if self.node_log2(self.leaf_level) < faces_log2 + LEAF_FACE_LOG2_MIN {
            return Err(LatticeError::TooLarge {
                levels: u8::try_from(self.root_level + 1).unwrap_or(u8::MAX),
                leaf_level: self.leaf_level,
            });
        }
        Ok(Self { faces_log2, ..self })
    }

    /// Lattice units along the side of a node of `level`, as a power of two.
    ///
    /// # Panics
    /// Where `level` is so far below 0 that a node would be smaller than a unit; the lattice's own levels
    /// never are.
    #[must_use]
    pub const fn node_log2(&self, level: i32) -> u32 {
        (TILE_SAMPLES.ilog2() + self.unit_log2)
            .checked_add_signed(level)
            .expect("the constructor checked the finest level")
    }

    /// Lattice units along the side of a node of `level`.
    #[must_use]
    pub const fn node_size(&self, level: i32) -> i32 {
        1 << self.node_log2(level)
    }

    /// Lattice units along the side of a face of `level`.
    #[must_use]
    pub const fn face_size(&self, level: i32) -> i32 {
        1 << (self.node_log2(level) - self.faces_log2)
    }

    /// Index of `level` in tables that begin with the finest level.
    #[must_use]
    pub const fn level_index(&self, level: i32) -> usize {
        (level - self.leaf_level).unsigned_abs() as usize
    }

    /// The nearest point of the terrain.
    #[must_use]
    pub fn clamp(&self, p: IVec2) -> IVec2 {
        p.clamp(IVec2::ZERO, self.extent)
    }

    /// Metres per lattice unit, where level-0 samples stand `spacing_m` metres apart.
    #[must_use]
    pub fn unit_m(&self, spacing_m: f64) -> f64 {
        spacing_m / f64::from(1_u32 << self.unit_log2)
    }

    /// Lattice point and fraction (0..1) of a place given in metres from the terrain's corner.
    /// A place far outside the terrain is brought to where 32-bit distances still hold.
    #[must_use]
    pub fn lattice_from_local(&self, place_m: glam::DVec2, spacing_m: f64) -> (IVec2, glam::Vec2) {
        let limit = f64::from(1_i32 << (EXTENT_LOG2 - 1));
        let units = place_m / self.unit_m(spacing_m);
        let units = units.clamp(
            glam::DVec2::splat(-limit),
            self.extent.as_dvec2() + glam::DVec2::splat(limit),
        );
        let whole = units.floor();
        (whole.as_ivec2(), (units - whole).as_vec2())
    }

    /// Control vertex `(i, j)` of the node of `level` with corner `origin`, slid onto the next
    /// coarser grid as far as its morph says (Strugar 2009); a lattice point.
    ///
    /// Even vertices stay; odd ones have slid all the way where the node may meet a coarser one.
    #[must_use]
    pub fn control_vertex(&self, lod: &ViewLod, level: i32, origin: IVec2, ij: IVec2) -> IVec2 {
        let step = self.face_size(level);
        let grid = origin + ij * step;
        let morph = lod.morph(self, self.clamp(grid), level);
        let slide = scale(step, morph);
        self.clamp(grid - (ij & 1) * slide)
    }
}

/// Numbers of control faces along a node's side that are accepted.
pub const FACES_PER_SIDE: [u32; 5] = [2, 4, 8, 16, 32];
/// Finest levels of the geometry that are accepted, where the terrain isn't too large for them.
pub const LEAF_LEVEL_RANGE: RangeInclusive<i32> = -8..=0;

/// `faces_per_side` as a power of two.
///
/// # Errors
/// Where it is none, or not in 2..=32.
pub fn faces_log2(faces_per_side: u32) -> Result<u32, LatticeError> {
    if !FACES_PER_SIDE.contains(&faces_per_side) {
        return Err(LatticeError::FacesPerSide(faces_per_side));
    }
    Ok(faces_per_side.ilog2())
}

/// `d * t / ONE`, rounded down, split so that 32 bits hold every product: `d` within 30 bits,
/// `t` in `0..=ONE`. The same integer on every machine.
///
/// # Panics
/// Where `d` is so large that the product overflows; with `d` and `t` in their ranges it can't.
#[must_use]
pub fn scale(d: i32, t: i32) -> i32 {
    debug_assert!((0..=ONE).contains(&t), "edge parameter {t} is not in 0..=1");
    let high = (d >> 16)
        .checked_mul(t)
        .expect("lattice distances stay below 2^30");
    let low = ((d & 0xffff).cast_unsigned() * t.cast_unsigned()) >> 16;
    high + low.cast_signed()
}

/// The point `t / ONE` of the way from `a` to `b`; `t` in `0..=ONE`.
///
/// # Panics
/// As [`scale`].
#[must_use]
pub fn lerp(a: IVec2, b: IVec2, t: i32) -> IVec2 {
    a + IVec2::new(scale(b.x - a.x, t), scale(b.y - a.y, t))
}

/// How far a level reaches and over which part of that it morphs (CDLOD: Strugar 2009; Cervin 2012,
/// section 1.1.4). Both count node sizes, so that they mean the same on every level.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(
    feature = "ecs",
    derive(bevy::prelude::Reflect),
    reflect(Default, Clone)
)]
pub struct LodSettings {
    /// `R`: distance out to which a level is used, in node sizes of that level; 2 to 32, and at least
    /// `2 + 2 Z`.
    pub reach: f32,
    /// `Z`: length of the zone before that in which it morphs to the next level, in node sizes;
    /// a power of two from 1/16 to 4, so that the morph needs a shift and no division.
    pub morph: f32,
}

impl Default for LodSettings {
    /// Reach 4, morph 1: the least reach that leaves room for a morph zone of a whole node.
    fn default() -> Self {
        Self {
            reach: 4.0,
            morph: 1.0,
        }
    }
}

impl LodSettings {
    /// Reaches that are accepted, in node sizes; with a long morph zone only from `2 + 2 Z` on.
    pub const REACH_RANGE: RangeInclusive<f32> = 2.0..=32.0;
    /// Lengths of the morph zone that are accepted, in node sizes.
    pub const MORPHS: [f32; 7] = [0.0625, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0];

    /// Checks `R >= 2 + 2 Z` and the ranges of both.
    ///
    /// # Errors
    /// Names the number that is out of range and the nearest that isn't.
    pub fn validate(&self) -> Result<(), LatticeError> {
        let Self { reach, morph } = *self;
        if !Self::MORPHS.contains(&morph) {
            return Err(LatticeError::Morph(morph));
        }
        if !Self::REACH_RANGE.contains(&reach) {
            return Err(LatticeError::Reach(reach));
        }
        let least = 2.0 + 2.0 * morph;
        if reach < least {
            return Err(LatticeError::ReachTooShort {
                reach,
                morph,
                least,
            });
        }
        Ok(())
    }
}

/// Everything that a view's level of detail follows from: where the eye is, and how far each
/// level reaches. All integers; built once a frame and view.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ViewLod {
    /// The eye's lattice point in the plane.
    pub eye: IVec2,
    /// Floor of all distances: the eye's distance to the nearest ground, in lattice units.
    pub floor: i32,
    /// Whether the distance in the plane counts; an orthographic view has its floor alone.
    pub planar: bool,
    /// Where each level ends, from the finest; `i32::MAX` for the root, which never ends.
    pub reach: [i32; MAX_LEVELS],
    /// Where each level begins to morph, from the finest; `i32::MAX` for the root.
    pub morph_start: [i32; MAX_LEVELS],
    /// Length of each level's morph zone, as a power of two.
    pub zone_log2: [u32; MAX_LEVELS],
}

impl ViewLod {
    /// The level of detail of a view whose eye stands at lattice point `eye`, `floor` units from
    /// the nearest ground.
    ///
    /// # Errors
    /// Where `settings` break `R >= 2 + 2 Z` or are out of their ranges.
    pub fn new(
        lattice: &Lattice,
        settings: &LodSettings,
        eye: IVec2,
        floor: i32,
        planar: bool,
    ) -> Result<Self, LatticeError> {
        settings.validate()?;
        let mut lod = Self {
            eye,
            floor: floor.max(0),
            planar,
            reach: [i32::MAX; MAX_LEVELS],
            morph_start: [i32::MAX; MAX_LEVELS],
            zone_log2: [0; MAX_LEVELS],
        };
        for level in lattice.leaf_level..lattice.root_level {
            let index = lattice.level_index(level);
            let size_log2 = lattice.node_log2(level);
            #[expect(clippy::cast_possible_truncation, reason = "validated: 1/16..=4")]
            let zone_log2 = size_log2.saturating_add_signed(settings.morph.log2() as i32);
            #[expect(clippy::cast_possible_truncation, reason = "saturates, as it should")]
            let reach = (f64::from(settings.reach) * f64::from(1_u32 << size_log2)) as i32;
            lod.reach[index] = reach;
            lod.zone_log2[index] = zone_log2;
            // A level that reaches further than any distance never morphs.
            lod.morph_start[index] = if reach == i32::MAX {
                i32::MAX
            } else {
                reach - (1 << zone_log2)
            };
        }
        Ok(lod)
    }

    /// Chebyshev distance in the plane from the eye to `p`, at least the view's floor, in lattice
    /// units (Cervin 2012, section 1.1.4).
    #[must_use]
    pub fn distance(&self, p: IVec2) -> i32 {
        if !self.planar {
            return self.floor;
        }
        (p - self.eye).abs().max_element().max(self.floor)
    }

    /// The least distance of any point of the box `low..=high`, in lattice units.
    #[must_use]
    pub fn box_distance(&self, low: IVec2, high: IVec2) -> i32 {
        if !self.planar {
            return self.floor;
        }
        let outside = (low - self.eye).max(self.eye - high);
        outside.max_element().max(self.floor)
    }

    /// How far `p` has moved from `level`'s grid to the next coarser one, `0..=ONE`: the morph factor
    /// of CDLOD (Strugar 2009), linear in the distance over the morph zone.
    #[must_use]
    pub fn morph(&self, lattice: &Lattice, p: IVec2, level: i32) -> i32 {
        let index = lattice.level_index(level);
        let zone_log2 = self.zone_log2[index];
        let beyond = self.distance(p).saturating_sub(self.morph_start[index]);
        if beyond <= 0 {
            0
        } else if beyond >= 1 << zone_log2 {
            ONE
        } else if zone_log2 >= 16 {
            beyond >> (zone_log2 - 16)
        } else {
            beyond << (16 - zone_log2)
        }
    }

    /// The geometry's level of detail at `p`, 16.16: the same whichever face asks.
    #[must_use]
    pub fn detail(&self, lattice: &Lattice, p: IVec2, level: i32) -> i32 {
        level * ONE + self.morph(lattice, p, level)
    }

    /// `λ`, the level of detail at which height and density are read at `p`, 16.16: that of the
    /// geometry, but never finer than what is resident there, nor coarser than the root.
    #[must_use]
    pub fn lambda(&self, lattice: &Lattice, field: &ResidencyField, p: IVec2, level: i32) -> i32 {
        self.detail(lattice, p, level)
            .max(field.at(p) << 8)
            .min(lattice.root_level * ONE)
    }
}

#[cfg(test)]
mod tests;
