//! Edits as games ask for them, in metres.

use super::{CapturedGround, Change, EDIT_UNITS, Edit, MAX_REACH, MIN_REACH, StampImage};
use crate::stream::TerrainState;
use crate::tile::{TILE_SAMPLES, TileAddress};
use bevy::math::{DAffine3, DVec2, DVec3};
use bevy::prelude::*;
use thiserror::Error;

/// How far a crater reaches beyond its bowl: its rim falls off up to there.
pub(crate) const CRATER_REACH: f64 = 1.6;
/// Points of the grid that smooth ground is captured on, per reach.
const SMOOTH_POINTS: f64 = 8.0;

/// Blows a crater into the ground: `commands.trigger(Crater::at(place).radius(8.0))`.
///
/// Lengths are metres of the world. Observe [`TerrainEdited`](super::TerrainEdited) on the terrain to
/// learn what came of it, and [`TerrainEditRefused`](super::TerrainEditRefused) for what didn't.
#[derive(Event, Clone, Debug, PartialEq, Reflect)]
#[reflect(Debug, Clone, PartialEq)]
pub struct Crater {
    /// The centre in the world. How high it is doesn't matter but for finding the terrain.
    pub at: Vec3,
    /// The terrain; `None` takes the one whose ground is nearest.
    pub terrain: Option<Entity>,
    /// Radius of the bowl, where it crosses the ground, metres. What is less than a sample of the terrain
    /// becomes one; more than 320 samples is refused.
    pub radius_m: f32,
    /// How much lower the centre gets, metres, 0 or more.
    pub depth_m: f32,
    /// How much higher the rim gets, metres, 0 or more.
    pub rim_m: f32,
    /// How rough the outline is, 0 to 1.
    pub roughness: f32,
    /// What the outline's noise is made of.
    pub seed: u32,
    /// The artist's factor: what densities in the crater are at least, for each metre of depth (Cervin
    /// 2012, section 3.5); 0 or more.
    pub density_per_m: f32,
    /// How strongly the ground is scorched, 0 to 1.
    pub scorch: f32,
}

impl Crater {
    /// A crater of a shell: a bowl with a radius of 4 m, 1.4 m deep, with a rim of 0.4 m.
    #[must_use]
    pub const fn at(at: Vec3) -> Self {
        Self {
            at,
            terrain: None,
            radius_m: 4.0,
            depth_m: 1.4,
            rim_m: 0.4,
            roughness: 0.3,
            seed: 0,
            density_per_m: 0.5,
            scorch: 1.0,
        }
    }

    /// A crater of this radius, as deep as one of that size is, with the rim that belongs to it.
    /// What [`depth`](Self::depth) and [`rim`](Self::rim) say comes after it.
    #[must_use]
    pub fn radius(self, radius_m: f32) -> Self {
        let usual = Self::at(self.at);
        let by = radius_m / usual.radius_m;
        Self {
            radius_m,
            depth_m: usual.depth_m * by,
            rim_m: usual.rim_m * by,
            ..self
        }
    }

    /// The same with another depth in metres, 0 or more.
    #[must_use]
    pub const fn depth(self, depth_m: f32) -> Self {
        Self { depth_m, ..self }
    }

    /// The same with another height of the rim in metres, 0 or more.
    #[must_use]
    pub const fn rim(self, rim_m: f32) -> Self {
        Self { rim_m, ..self }
    }

    /// An outline as rough as this, 0 to 1, made of `seed`.
    #[must_use]
    pub const fn rough(self, roughness: f32, seed: u32) -> Self {
        Self {
            roughness,
            seed,
            ..self
        }
    }

    /// As strongly scorched as this, 0 to 1.
    #[must_use]
    pub const fn scorched(self, scorch: f32) -> Self {
        Self { scorch, ..self }
    }

    /// In this terrain, whichever is nearest.
    #[must_use]
    pub const fn on(self, terrain: Entity) -> Self {
        Self {
            terrain: Some(terrain),
            ..self
        }
    }
}

/// Raises the ground to a smooth hill, or lowers it to a hollow.
#[derive(Event, Clone, Debug, PartialEq, Reflect)]
#[reflect(Debug, Clone, PartialEq)]
pub struct Raise {
    /// The centre in the world.
    pub at: Vec3,
    /// The terrain; `None` takes the one whose ground is nearest.
    pub terrain: Option<Entity>,
    /// Beyond it nothing changes; metres, above 0, at most 512 samples of the terrain.
    pub radius_m: f32,
    /// How much higher the centre gets, metres; negative lowers it.
    pub by_m: f32,
    /// The part of the radius within which the change is whole, 0 to 1.
    pub hardness: f32,
    /// What densities are there at least, for each metre of change; as in [`Crater::density_per_m`].
    pub density_per_m: f32,
}

impl Raise {
    /// A hill of 2 m within 8 m.
    #[must_use]
    pub const fn at(at: Vec3) -> Self {
        Self {
            at,
            terrain: None,
            radius_m: 8.0,
            by_m: 2.0,
            hardness: 0.0,
            density_per_m: 0.1,
        }
    }

    /// Within another radius in metres, above 0.
    #[must_use]
    pub const fn radius(self, radius_m: f32) -> Self {
        Self { radius_m, ..self }
    }

    /// By this many metres; negative lowers.
    #[must_use]
    pub const fn by(self, by_m: f32) -> Self {
        Self { by_m, ..self }
    }

    /// Whole within this part of the radius, 0 to 1.
    #[must_use]
    pub const fn hard(self, hardness: f32) -> Self {
        Self { hardness, ..self }
    }

    /// On this terrain, whichever is nearest.
    #[must_use]
    pub const fn on(self, terrain: Entity) -> Self {
        Self {
            terrain: Some(terrain),
            ..self
        }
    }
}

/// Draws the ground to one height: that of [`at`](Self::at).
#[derive(Event, Clone, Debug, PartialEq, Reflect)]
#[reflect(Debug, Clone, PartialEq)]
pub struct Flatten {
    /// The centre in the world; the ground is drawn to its height.
    pub at: Vec3,
    /// The terrain; `None` takes the one whose ground is nearest.
    pub terrain: Option<Entity>,
    /// Beyond it nothing changes; metres, above 0, at most 512 samples of the terrain.
    pub radius_m: f32,
    /// How far the ground is drawn there, 0 to 1.
    pub strength: f32,
    /// The part of the radius within which it is drawn as far as that, 0 to 1.
    pub hardness: f32,
}

impl Flatten {
    /// Flat within 4 m, and falling off to 8 m.
    #[must_use]
    pub const fn at(at: Vec3) -> Self {
        Self {
            at,
            terrain: None,
            radius_m: 8.0,
            strength: 1.0,
            hardness: 0.5,
        }
    }

    /// Within another radius in metres, above 0.
    #[must_use]
    pub const fn radius(self, radius_m: f32) -> Self {
        Self { radius_m, ..self }
    }

    /// Drawn as far as this, 0 to 1.
    #[must_use]
    pub const fn strength(self, strength: f32) -> Self {
        Self { strength, ..self }
    }

    /// Whole within this part of the radius, 0 to 1.
    #[must_use]
    pub const fn hard(self, hardness: f32) -> Self {
        Self { hardness, ..self }
    }

    /// On this terrain, whichever is nearest.
    #[must_use]
    pub const fn on(self, terrain: Entity) -> Self {
        Self {
            terrain: Some(terrain),
            ..self
        }
    }
}

/// Smooths the ground: draws it to what it is on a grid of an eighth of the radius.
#[derive(Event, Clone, Debug, PartialEq, Reflect)]
#[reflect(Debug, Clone, PartialEq)]
pub struct Smooth {
    /// The centre in the world.
    pub at: Vec3,
    /// The terrain; `None` takes the one whose ground is nearest.
    pub terrain: Option<Entity>,
    /// Beyond it nothing changes; metres, above 0, at most 512 samples of the terrain.
    pub radius_m: f32,
    /// How far the ground is drawn there, 0 to 1.
    pub strength: f32,
    /// The part of the radius within which it is drawn as far as that, 0 to 1.
    pub hardness: f32,
}

impl Smooth {
    /// Smooth within 8 m.
    #[must_use]
    pub const fn at(at: Vec3) -> Self {
        Self {
            at,
            terrain: None,
            radius_m: 8.0,
            strength: 1.0,
            hardness: 0.3,
        }
    }

    /// Within another radius in metres, above 0.
    #[must_use]
    pub const fn radius(self, radius_m: f32) -> Self {
        Self { radius_m, ..self }
    }

    /// Drawn as far as this, 0 to 1.
    #[must_use]
    pub const fn strength(self, strength: f32) -> Self {
        Self { strength, ..self }
    }

    /// Whole within this part of the radius, 0 to 1.
    #[must_use]
    pub const fn hard(self, hardness: f32) -> Self {
        Self { hardness, ..self }
    }

    /// On this terrain, whichever is nearest.
    #[must_use]
    pub const fn on(self, terrain: Entity) -> Self {
        Self {
            terrain: Some(terrain),
            ..self
        }
    }
}

/// Adds an image to the ground: tracks, trenches, a footprint.
#[derive(Event, Clone, Debug, PartialEq)]
pub struct Stamp {
    /// The centre in the world.
    pub at: Vec3,
    /// The terrain; `None` takes the one whose ground is nearest.
    pub terrain: Option<Entity>,
    /// The image; edits share it.
    pub image: StampImage,
    /// The length of its side, metres, above 0; half its diagonal is at most 512 samples of the terrain.
    pub side_m: f32,
    /// What a full sample of it adds, metres; negative digs.
    pub by_m: f32,
    /// How far the image's x axis is turned from the terrain's, in radians about the vertical, from
    /// x to z.
    pub turn: f32,
    /// What densities are there at least, for each metre of change; as in [`Crater::density_per_m`].
    pub density_per_m: f32,
    /// How strongly the ground is scorched where the image isn't 0, 0 to 1.
    pub scorch: f32,
}

impl Stamp {
    /// The image with a side of 8 m and a depth of 1 m.
    #[must_use]
    pub const fn at(at: Vec3, image: StampImage) -> Self {
        Self {
            at,
            terrain: None,
            image,
            side_m: 8.0,
            by_m: -1.0,
            turn: 0.0,
            density_per_m: 0.5,
            scorch: 0.0,
        }
    }

    /// With another side in metres, above 0.
    #[must_use]
    pub fn side(self, side_m: f32) -> Self {
        Self { side_m, ..self }
    }

    /// Adding this many metres where the image is full; negative digs.
    #[must_use]
    pub fn by(self, by_m: f32) -> Self {
        Self { by_m, ..self }
    }

    /// Turned by this angle, in radians from x to z.
    #[must_use]
    pub fn turned(self, turn: f32) -> Self {
        Self { turn, ..self }
    }

    /// As strongly scorched as this, 0 to 1.
    #[must_use]
    pub fn scorched(self, scorch: f32) -> Self {
        Self { scorch, ..self }
    }

    /// On this terrain, whichever is nearest.
    #[must_use]
    pub fn on(self, terrain: Entity) -> Self {
        Self {
            terrain: Some(terrain),
            ..self
        }
    }
}

/// Why an edit can't be made.
#[derive(Clone, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum EditRefusal {
    /// There is no terrain, or the one named isn't ready.
    #[error("{edit} meets no terrain: wait for TerrainReady of the one that it is for")]
    NoTerrain {
        /// The command.
        edit: &'static str,
    },
    /// The command's disc doesn't meet the terrain.
    #[error("{edit} at {at} lies beyond the terrain: nothing is there to be changed")]
    Beyond {
        /// The command.
        edit: &'static str,
        /// Its centre in the world.
        at: Vec3,
    },
    /// A number can't be used.
    #[error("{edit}::{name} is {value}: {wanted}")]
    Number {
        /// The command.
        edit: &'static str,
        /// The field.
        name: &'static str,
        /// Its value.
        value: f32,
        /// What to do.
        wanted: &'static str,
    },
    /// The edit would reach further than an edit may.
    #[error("{edit}::{name} is {value} m: on this terrain {most} m is the most")]
    TooLarge {
        /// The command.
        edit: &'static str,
        /// The field.
        name: &'static str,
        /// Its value.
        value: f32,
        /// The most that is possible.
        most: f64,
    },
    /// The terrain can't be edited because of its transform.
    #[error(
        "{edit} can't be placed: the terrain's Transform is more than a rotation, a translation and \
         one positive scale"
    )]
    Transform {
        /// The command.
        edit: &'static str,
    },
    /// What was made is no edit.
    #[error("{edit} can't be: {reason}")]
    Invalid {
        /// The command.
        edit: &'static str,
        /// Why.
        reason: String,
    },
    /// There is nothing to be undone, or to be done again.
    #[error("{0}")]
    History(String),
}

/// A command that becomes an [`Edit`].
pub(super) trait EditCommand: Event {
    const NAME: &'static str;

    fn place(&self) -> (Vec3, Option<Entity>);

    /// The edit, given the terrain and where it is.
    fn resolve(&self, on: &Placed) -> Result<Edit, EditRefusal>;
}

/// A terrain, and where a command is on it.
pub(super) struct Placed<'a> {
    pub(super) edit: &'static str,
    pub(super) state: &'a TerrainState,
    /// The command's place in the world.
    at: Vec3,
    /// The same in metres of the terrain's own space.
    local: DVec3,
    /// Metres of the world in a metre of the terrain's own.
    scale: f64,
}

impl<'a> Placed<'a> {
    pub(super) fn new(
        edit: &'static str,
        state: &'a TerrainState,
        transform: &GlobalTransform,
        at: Vec3,
    ) -> Result<Self, EditRefusal> {
        let affine = transform.affine();
        let world_from_local = DAffine3 {
            matrix3: affine.matrix3.as_dmat3(),
            translation: affine.translation.as_dvec3(),
        };
        let scale = world_from_local.matrix3.determinant().cbrt();
        let local = world_from_local.inverse().transform_point3(at.as_dvec3());
        if !(scale.is_finite() && scale > 0.0 && local.is_finite()) {
            return Err(if at.is_finite() {
                EditRefusal::Transform { edit }
            } else {
                EditRefusal::Number {
                    edit,
                    name: "at",
                    value: f32::NAN,
                    wanted: "use a place in the world",
                }
            });
        }
        Ok(Self {
            edit,
            state,
            at,
            local,
            scale,
        })
    }

    fn spacing_m(&self) -> f64 {
        self.state.manifest().file.spacing_m
    }

    fn number(&self, name: &'static str, value: f32, wanted: &'static str) -> EditRefusal {
        EditRefusal::Number {
            edit: self.edit,
            name,
            value,
            wanted,
        }
    }

    /// A number from 0 to 1 as one from 0 to `whole`.
    fn part(&self, name: &'static str, value: f32, whole: f64) -> Result<f64, EditRefusal> {
        if value.is_finite() {
            Ok((f64::from(value).clamp(0.0, 1.0) * whole).round())
        } else {
            Err(self.number(name, value, "use a number from 0 to 1"))
        }
    }

    /// A length in stored heights, cut off at the range of those.
    fn steps(&self, name: &'static str, metres: f32) -> Result<f64, EditRefusal> {
        if !metres.is_finite() {
            return Err(self.number(name, metres, "use a length in metres"));
        }
        let step_m = self.state.manifest().file.height_step_m * self.scale;
        let most = f64::from(u16::MAX);
        Ok((f64::from(metres) / step_m).round().clamp(-most, most))
    }

    fn depth(&self, name: &'static str, metres: f32) -> Result<u16, EditRefusal> {
        if metres < 0.0 {
            return Err(self.number(name, metres, "use 0 or more; Raise makes hills"));
        }
        Ok(self.steps(name, metres)? as u16)
    }

    fn density(&self, per_m: f32, metres: f32) -> Result<u8, EditRefusal> {
        if !per_m.is_finite() {
            return Err(self.number("density_per_m", per_m, "use 0 or more"));
        }
        let density = 255.0 * f64::from(per_m) * f64::from(metres.abs());
        Ok(density.ceil().clamp(0.0, 255.0) as u8)
    }

    /// Centre and reach of an edit that reaches `factor` times as far as its field `name` says.
    fn disc(
        &self,
        name: &'static str,
        metres: f32,
        factor: f64,
    ) -> Result<([i32; 2], u32), EditRefusal> {
        if !(metres.is_finite() && metres > 0.0) {
            return Err(self.number(name, metres, "use a number above 0"));
        }
        let units_a_m = f64::from(EDIT_UNITS) / (self.spacing_m() * self.scale);
        let reach = f64::from(metres) * factor * units_a_m;
        if reach > f64::from(MAX_REACH) {
            return Err(EditRefusal::TooLarge {
                edit: self.edit,
                name,
                value: metres,
                most: f64::from(MAX_REACH) / (units_a_m * factor),
            });
        }
        let centre = self.local.xz() * (f64::from(EDIT_UNITS) / self.spacing_m());
        let size = DVec2::from(self.state.manifest().file.size.map(f64::from));
        let last = (size - 1.0) * f64::from(EDIT_UNITS);
        if (centre + reach).cmplt(DVec2::ZERO).any() || (centre - reach).cmpgt(last).any() {
            return Err(EditRefusal::Beyond {
                edit: self.edit,
                at: self.at,
            });
        }
        let centre = [centre.x, centre.y].map(|at| at.round() as i32);
        Ok((centre, (reach.round() as u32).max(MIN_REACH)))
    }

    /// Whether the ground may be cut off where between `least` and `most` is added to it. Of all
    /// ground: what holds at the centre need not hold for coarse levels' means.
    fn may_clamp(&self, least: i32, most: i32) -> bool {
        let range = self.state.ground_range(self.state.root());
        range.is_none_or(|range| {
            i32::from(range.min) + least < 0 || i32::from(range.max) + most > i32::from(u16::MAX)
        })
    }
}

impl EditCommand for Crater {
    const NAME: &'static str = "Crater";

    fn place(&self) -> (Vec3, Option<Entity>) {
        (self.at, self.terrain)
    }

    fn resolve(&self, on: &Placed) -> Result<Edit, EditRefusal> {
        let (centre, reach) = on.disc("radius_m", self.radius_m, CRATER_REACH)?;
        let depth = on.depth("depth_m", self.depth_m)?;
        let rim = on.depth("rim_m", self.rim_m)?;
        let change = Change::Crater {
            depth,
            rim,
            bowl: (65536.0 / CRATER_REACH) as u16,
            // More would tear the rim to pieces.
            roughness: on.part("roughness", self.roughness, 96.0)? as u8,
            seed: self.seed,
            density: on.density(self.density_per_m, self.depth_m.max(self.rim_m))?,
            scorch: on.part("scorch", self.scorch, 255.0)? as u8,
            may_clamp: on.may_clamp(-i32::from(depth), i32::from(rim)),
        };
        Ok(Edit {
            centre,
            reach,
            change,
        })
    }
}

impl EditCommand for Raise {
    const NAME: &'static str = "Raise";

    fn place(&self) -> (Vec3, Option<Entity>) {
        (self.at, self.terrain)
    }

    fn resolve(&self, on: &Placed) -> Result<Edit, EditRefusal> {
        let (centre, reach) = on.disc("radius_m", self.radius_m, 1.0)?;
        let by = on.steps("by_m", self.by_m)? as i32;
        let change = Change::Raise {
            by,
            hardness: on.part("hardness", self.hardness, 255.0)? as u8,
            density: on.density(self.density_per_m, self.by_m)?,
            may_clamp: on.may_clamp(by.min(0), by.max(0)),
        };
        Ok(Edit {
            centre,
            reach,
            change,
        })
    }
}

impl EditCommand for Flatten {
    const NAME: &'static str = "Flatten";

    fn place(&self) -> (Vec3, Option<Entity>) {
        (self.at, self.terrain)
    }

    fn resolve(&self, on: &Placed) -> Result<Edit, EditRefusal> {
        let (centre, reach) = on.disc("radius_m", self.radius_m, 1.0)?;
        let file = &on.state.manifest().file;
        let to = (on.local.y - file.height_min_m) / file.height_step_m;
        let to = to.round().clamp(0.0, f64::from(u16::MAX)) as u16;
        let (low, high) = on.state.range_around(centre, reach);
        let change = Change::Flatten {
            to,
            strength: on.part("strength", self.strength, 65535.0)? as u16,
            hardness: on.part("hardness", self.hardness, 255.0)? as u8,
            least: (i32::from(to) - high).min(0),
            most: (i32::from(to) - low).max(0),
        };
        Ok(Edit {
            centre,
            reach,
            change,
        })
    }
}

impl EditCommand for Smooth {
    const NAME: &'static str = "Smooth";

    fn place(&self) -> (Vec3, Option<Entity>) {
        (self.at, self.terrain)
    }

    fn resolve(&self, on: &Placed) -> Result<Edit, EditRefusal> {
        let (centre, reach) = on.disc("radius_m", self.radius_m, 1.0)?;
        let samples = f64::from(reach) / f64::from(EDIT_UNITS);
        let spacing_log2 = (samples / SMOOTH_POINTS).max(1.0).log2().ceil() as u8;
        let ground = on.state.captured(centre, reach, spacing_log2.max(1));
        let (low, high) = on.state.range_around(centre, reach);
        let target = ground.heights.iter().map(|&height| i32::from(height));
        let (least, most) = target.fold((0, 0), |(least, most), height| {
            (least.min(height - high), most.max(height - low))
        });
        let change = Change::Smooth {
            ground,
            strength: on.part("strength", self.strength, 65535.0)? as u16,
            hardness: on.part("hardness", self.hardness, 255.0)? as u8,
            least,
            most,
        };
        Ok(Edit {
            centre,
            reach,
            change,
        })
    }
}

impl EditCommand for Stamp {
    const NAME: &'static str = "Stamp";

    fn place(&self) -> (Vec3, Option<Entity>) {
        (self.at, self.terrain)
    }

    fn resolve(&self, on: &Placed) -> Result<Edit, EditRefusal> {
        // The corners lie on the disc's circle.
        let half_diagonal = std::f64::consts::FRAC_1_SQRT_2;
        let (centre, reach) = on.disc("side_m", self.side_m, half_diagonal)?;
        if !self.turn.is_finite() {
            return Err(on.number("turn", self.turn, "use an angle in radians"));
        }
        let by = on.steps("by_m", self.by_m)? as i32;
        let (sin, cos) = f64::from(self.turn).sin_cos();
        let change = Change::Stamp {
            image: self.image.clone(),
            by,
            turn: [cos, sin].map(|part| (part * 16384.0).round() as i16),
            density: on.density(self.density_per_m, self.by_m)?,
            scorch: on.part("scorch", self.scorch, 255.0)? as u8,
            // Samples may be negative.
            may_clamp: on.may_clamp(-by.abs(), by.abs()),
        };
        Ok(Edit {
            centre,
            reach,
            change,
        })
    }
}

impl TerrainState {
    /// The lowest and the highest stored height of the finest tiles within `reach` of `centre`, both
    /// in [`EDIT_UNITS`].
    fn range_around(&self, centre: [i32; 2], reach: u32) -> (i32, i32) {
        let tiles = self.manifest().file.tiles(0);
        let around = |axis: usize| {
            let at = |by: i64| {
                let units = i64::from(TILE_SAMPLES) * i64::from(EDIT_UNITS);
                let tile = (i64::from(centre[axis]) + by).div_euclid(units);
                tile.clamp(0, i64::from(tiles[axis]) - 1) as u32
            };
            at(-i64::from(reach))..=at(reach.into())
        };
        let (mut low, mut high) = (i32::from(u16::MAX), 0);
        for z in around(1) {
            for x in around(0) {
                let mut tile = TileAddress::new(0, x, z);
                let range = loop {
                    if let Some(range) = self.ground_range(tile) {
                        break range;
                    }
                    if tile == self.root() {
                        return (0, u16::MAX.into());
                    }
                    tile = tile.parent();
                };
                low = low.min(range.min.into());
                high = high.max(range.max.into());
            }
        }
        (low, high)
    }

    /// The ground around `centre` on a grid of `2^spacing_log2` samples: each point the mean of the
    /// ground around it.
    fn captured(&self, centre: [i32; 2], reach: u32, spacing_log2: u8) -> CapturedGround {
        let file = &self.manifest().file;
        let spacing = 1_i32 << spacing_log2;
        let sample = |at: i64| at.div_euclid(i64::from(EDIT_UNITS)) as i32;
        let first = centre.map(|at| {
            let low = sample(i64::from(at) - i64::from(reach));
            low.div_euclid(spacing) * spacing
        });
        let size = [0, 1].map(|axis| {
            let high = sample(i64::from(centre[axis]) + i64::from(reach)) + 1;
            ((high - first[axis]) / spacing + 2) as u16
        });
        let last = file.size.map(|samples| samples as i32 - 1);
        let stored = |x: i32, z: i32| {
            let at = [x.clamp(0, last[0]), z.clamp(0, last[1])];
            let at_m = DVec2::from(at.map(f64::from)) * file.spacing_m;
            let height_m = self.height(at_m).map_or(0.0, |height| height.height_m);
            (height_m - file.height_min_m) / file.height_step_m
        };
        // Nine places a point, with the weights 1 2 1 a side.
        let half = (spacing / 2).max(1);
        let point = |x: i32, z: i32| {
            let mut sum = 0.0;
            for (dz, weight_z) in [(-half, 1.0), (0, 2.0), (half, 1.0)] {
                for (dx, weight_x) in [(-half, 1.0), (0, 2.0), (half, 1.0)] {
                    sum += weight_x * weight_z * stored(x + dx, z + dz);
                }
            }
            (sum / 16.0).round().clamp(0.0, f64::from(u16::MAX)) as u16
        };
        let rows = (0..i32::from(size[1])).map(|row| first[1] + row * spacing);
        let columns = (0..i32::from(size[0])).map(|column| first[0] + column * spacing);
        let heights = rows.flat_map(|z| columns.clone().map(move |x| (x, z)));
        CapturedGround {
            first,
            spacing_log2,
            size,
            heights: heights.map(|(x, z)| point(x, z)).collect(),
        }
    }
}
