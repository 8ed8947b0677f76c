//! What the brush does, and how large it is.

use crate::edit::{
    CRATER_REACH, Crater, Flatten, Raise, Smooth, Stamp, StampImage, TerrainEditRefused,
};
use bevy::prelude::*;

/// What a brush makes of the ground.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Reflect)]
#[reflect(Default, Debug, Clone, PartialEq, Hash)]
pub enum BrushKind {
    /// [`TerrainBrush::crater`].
    #[default]
    Crater,
    /// [`TerrainBrush::raise`].
    Raise,
    /// [`TerrainBrush::lower`].
    Lower,
    /// [`TerrainBrush::flatten`].
    Flatten,
    /// [`TerrainBrush::smooth`].
    Smooth,
    /// [`TerrainBrush::stamp`].
    Stamp,
}

impl BrushKind {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Crater,
        Self::Raise,
        Self::Lower,
        Self::Flatten,
        Self::Smooth,
        Self::Stamp,
    ];

    /// What the panel calls it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Crater => "Crater",
            Self::Raise => "Raise",
            Self::Lower => "Lower",
            Self::Flatten => "Flatten",
            Self::Smooth => "Smooth",
            Self::Stamp => "Stamp",
        }
    }
}

/// The numbers of a [`Stamp`], without its place and its image.
#[derive(Clone, Debug, PartialEq, Reflect)]
#[reflect(Default, Debug, Clone, PartialEq)]
pub struct StampBrush {
    /// As in [`Stamp::side_m`].
    pub side_m: f32,
    /// As in [`Stamp::by_m`].
    pub by_m: f32,
    /// As in [`Stamp::turn`].
    pub turn: f32,
    /// As in [`Stamp::density_per_m`].
    pub density_per_m: f32,
    /// As in [`Stamp::scorch`].
    pub scorch: f32,
}

impl Default for StampBrush {
    fn default() -> Self {
        // What the builder says, whatever the image.
        let image = StampImage {
            side: 0,
            samples: [].into(),
        };
        let stamp = Stamp::at(Vec3::ZERO, image);
        Self {
            side_m: stamp.side_m,
            by_m: stamp.by_m,
            turn: stamp.turn,
            density_per_m: stamp.density_per_m,
            scorch: stamp.scorch,
        }
    }
}

/// An edit in the log that is marked on the ground.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Reflect)]
#[reflect(Debug, Clone, PartialEq)]
pub struct MarkedEdit {
    /// The terrain.
    pub terrain: Entity,
    /// The edit's number in its log.
    pub sequence: u64,
}

/// A brush that edits the ground under the pointer: a click makes one edit, dragging makes more, each
/// [`spacing`](Self::spacing) radii from the last. Off at first.
///
/// The panel's tab sets it; a game that has [`BrushPlugin`](super::BrushPlugin) may set it, too, and
/// needs no panel. Commands are those that a game triggers itself, of which `at`, `terrain` and, in a
/// [`Crater`], `seed` are replaced: by where the pointer is, the terrain there, and
/// [`seed`](Self::seed).
#[derive(Resource, Clone, Debug, PartialEq, Reflect)]
#[reflect(Resource, Default, Debug, Clone, PartialEq)]
pub struct TerrainBrush {
    /// Whether pointer and keys do anything, and the preview is drawn.
    pub on: bool,
    /// What it does.
    pub kind: BrushKind,
    /// The crater of [`BrushKind::Crater`].
    pub crater: Crater,
    /// The hill of [`BrushKind::Raise`].
    pub raise: Raise,
    /// The hollow of [`BrushKind::Lower`]; its `by_m` is negative.
    pub lower: Raise,
    /// What [`BrushKind::Flatten`] does: all of a stroke is drawn to the height at which it begins.
    pub flatten: Flatten,
    /// What [`BrushKind::Smooth`] does.
    pub smooth: Smooth,
    /// The stamp of [`BrushKind::Stamp`].
    pub stamp: StampBrush,
    /// Its image; without one a stamp does nothing.
    #[reflect(ignore)]
    pub image: Option<StampImage>,
    /// What the noise of the next stroke's craters is made of.
    pub seed: u32,
    /// Whether each stroke leaves another seed for the one after it.
    pub seed_follows_strokes: bool,
    /// How far the edits of a stroke lie apart, as a share of the radius; above 0. What is less than
    /// 0.02 counts as that.
    pub spacing: f32,
    /// Whether a crater's depth and rim, and what is raised, lowered or stamped, grow with the radius
    /// where [`set_radius_m`](Self::set_radius_m) changes it.
    pub keeps_shape: bool,
    /// Whether `[` and `]` change the radius, Ctrl+Z undoes and Ctrl+Shift+Z redoes while it is on.
    pub keys: bool,
    /// Whether a press that the brush paints with is taken out of `ButtonInput<MouseButton>` before
    /// `Update`, so that the game doesn't shoot where the ground is edited. Messages of the button and
    /// Bevy's `Pointer` events stay: who reads those asks for [`on`](Self::on).
    pub takes_clicks: bool,
    /// The only terrain that it works on; `None` for whichever is under the pointer.
    pub terrain: Option<Entity>,
    /// The only camera through which it points; `None` for whichever the pointer is in.
    pub camera: Option<Entity>,
    /// An edit that is marked on the ground, whether or not the brush is on.
    pub marked: Option<MarkedEdit>,
}

impl Default for TerrainBrush {
    fn default() -> Self {
        let raise = Raise::at(Vec3::ZERO);
        Self {
            on: false,
            kind: BrushKind::default(),
            crater: Crater::at(Vec3::ZERO),
            lower: raise.clone().by(-raise.by_m),
            raise,
            flatten: Flatten::at(Vec3::ZERO),
            smooth: Smooth::at(Vec3::ZERO),
            stamp: StampBrush::default(),
            image: None,
            seed: 1,
            seed_follows_strokes: true,
            spacing: 0.5,
            keeps_shape: true,
            keys: true,
            takes_clicks: true,
            terrain: None,
            camera: None,
            marked: None,
        }
    }
}

/// The least spacing that counts.
pub(super) const LEAST_SPACING: f32 = 0.02;
/// What one of the keys `[` and `]` does to the radius.
pub(super) const KEY_STEP: f32 = 1.15;
/// The largest radius that keys go to, in metres; the terrain's own limit is in the sentences of what
/// is refused.
const MOST_RADIUS_M: f32 = 100_000.0;
/// The first radius on a terrain is at least so many of its samples: a smaller change is hardly seen.
const FIRST_SAMPLES: f32 = 4.0;

impl TerrainBrush {
    /// The radius in metres of the world; for a stamp half of its side.
    #[must_use]
    pub const fn radius_m(&self) -> f32 {
        match self.kind {
            BrushKind::Crater => self.crater.radius_m,
            BrushKind::Raise => self.raise.radius_m,
            BrushKind::Lower => self.lower.radius_m,
            BrushKind::Flatten => self.flatten.radius_m,
            BrushKind::Smooth => self.smooth.radius_m,
            BrushKind::Stamp => 0.5 * self.stamp.side_m,
        }
    }

    /// Another radius, above 0; heights grow with it where the brush
    /// [keeps its shape](Self::keeps_shape).
    pub fn set_radius_m(&mut self, radius_m: f32) {
        if !(radius_m.is_finite() && radius_m > 0.0) {
            return;
        }
        let by = radius_m / self.radius_m();
        let by = if self.keeps_shape && by.is_finite() {
            by
        } else {
            1.0
        };
        match self.kind {
            BrushKind::Crater => {
                self.crater.radius_m = radius_m;
                self.crater.depth_m *= by;
                self.crater.rim_m *= by;
            }
            BrushKind::Raise => {
                self.raise.radius_m = radius_m;
                self.raise.by_m *= by;
            }
            BrushKind::Lower => {
                self.lower.radius_m = radius_m;
                self.lower.by_m *= by;
            }
            BrushKind::Flatten => self.flatten.radius_m = radius_m,
            BrushKind::Smooth => self.smooth.radius_m = radius_m,
            BrushKind::Stamp => {
                self.stamp.side_m = 2.0 * radius_m;
                self.stamp.by_m *= by;
            }
        }
    }

    /// The radius multiplied by `by`, as far as that makes sense: at least `sample_m`.
    pub(super) fn scale_radius(&mut self, by: f32, sample_m: f32) {
        let least = sample_m.min(MOST_RADIUS_M);
        self.set_radius_m((self.radius_m() * by).clamp(least, MOST_RADIUS_M));
    }

    /// The numbers that kinds begin with on a terrain whose samples lie `sample_m` apart in the world:
    /// [`Default`]'s where that is fine enough, otherwise larger, in the same shape.
    #[must_use]
    pub(super) fn first_on(sample_m: f32) -> Self {
        let mut first = Self::default();
        first.grow_to(sample_m);
        first
    }

    /// Enlarges every kind whose radius is still [`Default`]'s to what can be seen where samples lie
    /// `sample_m` apart; it keeps its shape.
    pub(super) fn grow_to(&mut self, sample_m: f32) {
        let kind = self.kind;
        for each in BrushKind::ALL {
            self.kind = each;
            self.grow_kind_to(sample_m);
        }
        self.kind = kind;
    }

    /// The same for the chosen kind alone.
    pub(super) fn grow_kind_to(&mut self, sample_m: f32) {
        let first = Self {
            kind: self.kind,
            ..Self::default()
        };
        let least_m = FIRST_SAMPLES * sample_m;
        if self.radius_m() == first.radius_m() && self.radius_m() < least_m {
            let keeps_shape = std::mem::replace(&mut self.keeps_shape, true);
            self.set_radius_m(least_m);
            self.keeps_shape = keeps_shape;
        }
    }

    /// How far from the pointer the ground changes, in metres of the world, on a terrain that is fine
    /// enough for it; [`reach_on_m`](Self::reach_on_m) tells it for others, too.
    #[must_use]
    pub fn reach_m(&self) -> f32 {
        match self.kind {
            BrushKind::Crater => self.crater.radius_m * CRATER_REACH as f32,
            BrushKind::Stamp => self.stamp.side_m * std::f32::consts::FRAC_1_SQRT_2,
            _ => self.radius_m(),
        }
    }

    /// How far from the pointer the ground changes where samples lie `sample_m` apart, both in metres of
    /// the world: no edit reaches less far than a sample.
    #[must_use]
    pub fn reach_on_m(&self, sample_m: f32) -> f32 {
        self.reach_m().max(sample_m)
    }

    /// How much larger than it says the brush is where samples lie `sample_m` apart; 1 where those are
    /// fine enough.
    pub(super) fn grown_on(&self, sample_m: f32) -> f32 {
        let grown = self.reach_on_m(sample_m) / self.reach_m();
        if grown.is_finite() { grown } else { 1.0 }
    }

    /// How far the edits of a stroke lie apart, in metres of the world, on a terrain that is fine enough.
    #[must_use]
    pub fn step_m(&self) -> f32 {
        self.radius_m() * self.spacing.max(LEAST_SPACING)
    }

    /// The chosen kind's numbers as they are at first.
    pub fn reset_kind(&mut self) {
        let first = Self::default();
        match self.kind {
            BrushKind::Crater => self.crater = first.crater,
            BrushKind::Raise => self.raise = first.raise,
            BrushKind::Lower => self.lower = first.lower,
            BrushKind::Flatten => self.flatten = first.flatten,
            BrushKind::Smooth => self.smooth = first.smooth,
            BrushKind::Stamp => self.stamp = first.stamp,
        }
    }

    /// Makes one edit: triggers the command of the chosen kind at a place in the world, on `terrain`.
    pub fn trigger(&self, world: &mut World, terrain: Entity, at: Vec3, seed: u32) {
        let on = Some(terrain);
        let raised = |raise: &Raise| Raise {
            at,
            terrain: on,
            ..raise.clone()
        };
        match self.kind {
            BrushKind::Crater => world.trigger(Crater {
                at,
                terrain: on,
                seed,
                ..self.crater.clone()
            }),
            BrushKind::Raise => world.trigger(raised(&self.raise)),
            BrushKind::Lower => world.trigger(raised(&self.lower)),
            BrushKind::Flatten => world.trigger(Flatten {
                at,
                terrain: on,
                ..self.flatten.clone()
            }),
            BrushKind::Smooth => world.trigger(Smooth {
                at,
                terrain: on,
                ..self.smooth.clone()
            }),
            BrushKind::Stamp => {
                let Some(image) = self.image.clone() else {
                    let reason = "Stamp has no image: read a square PNG first".to_owned();
                    let terrain = on;
                    world.trigger(TerrainEditRefused { terrain, reason });
                    return;
                };
                world.trigger(Stamp {
                    at,
                    terrain: on,
                    image,
                    side_m: self.stamp.side_m,
                    by_m: self.stamp.by_m,
                    turn: self.stamp.turn,
                    density_per_m: self.stamp.density_per_m,
                    scorch: self.stamp.scorch,
                });
            }
        }
        world.flush();
    }
}

/// The seed after `seed`; comes back to it after all others.
pub(super) const fn next_seed(seed: u32) -> u32 {
    seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_larger_brush_keeps_its_shape_unless_told_not_to() {
        let mut brush = TerrainBrush::default();
        let first = brush.crater.clone();
        brush.set_radius_m(2.0 * first.radius_m);
        assert_eq!(brush.crater.radius_m, 2.0 * first.radius_m);
        assert_eq!(brush.crater.depth_m, 2.0 * first.depth_m);
        assert_eq!(brush.crater.rim_m, 2.0 * first.rim_m);
        assert_eq!(brush.crater, first.clone().radius(2.0 * first.radius_m));
        brush.keeps_shape = false;
        brush.set_radius_m(first.radius_m);
        assert_eq!(brush.crater.depth_m, 2.0 * first.depth_m);
        brush.set_radius_m(f32::NAN);
        brush.set_radius_m(0.0);
        assert_eq!(brush.crater.radius_m, first.radius_m);
        brush.reset_kind();
        assert_eq!(brush.crater, first);
    }

    #[test]
    fn every_kind_has_a_radius_that_can_be_set() {
        for kind in BrushKind::ALL {
            let mut brush = TerrainBrush {
                kind,
                spacing: 0.25,
                ..default()
            };
            brush.set_radius_m(12.0);
            assert_eq!(brush.radius_m(), 12.0, "{kind:?}");
            assert_eq!(brush.step_m(), 3.0, "{kind:?}");
            assert!(brush.reach_m() >= 12.0, "{kind:?}");
            for _ in 0..1000 {
                brush.scale_radius(KEY_STEP, 2.0);
            }
            assert!(brush.radius_m() <= MOST_RADIUS_M, "{kind:?}");
            for _ in 0..1000 {
                brush.scale_radius(1.0 / KEY_STEP, 2.0);
            }
            assert_eq!(brush.radius_m(), 2.0, "{kind:?}");
        }
    }

    #[test]
    fn the_first_radius_is_some_samples_and_what_was_set_stays() {
        let fine = TerrainBrush::first_on(0.5);
        assert_eq!(fine, TerrainBrush::default());
        let coarse = TerrainBrush::first_on(30.0);
        for kind in BrushKind::ALL {
            let coarse = TerrainBrush {
                kind,
                ..coarse.clone()
            };
            assert!(coarse.radius_m() >= 119.0, "{kind:?}");
        }
        assert_eq!(coarse.crater, fine.crater.radius(120.0));
        let mut set = TerrainBrush {
            keeps_shape: false,
            ..default()
        };
        set.crater.radius_m = 5.0;
        set.grow_to(30.0);
        assert_eq!(set.crater.radius_m, 5.0);
        assert_eq!(set.raise.radius_m, 120.0);
        assert_eq!((set.kind, set.keeps_shape), (BrushKind::Crater, false));
    }

    #[test]
    fn no_edit_reaches_less_far_than_a_sample() {
        let mut brush = TerrainBrush::default();
        brush.set_radius_m(1.0);
        assert_eq!(brush.reach_on_m(0.5), brush.reach_m());
        assert_eq!(brush.reach_on_m(30.0), 30.0);
        assert!((brush.grown_on(30.0) * brush.reach_m() - 30.0).abs() < 1e-4);
        assert_eq!(brush.grown_on(0.5), 1.0);
        brush.crater.radius_m = f32::NAN;
        assert_eq!(brush.grown_on(30.0), 1.0);
    }

    #[test]
    fn lowering_is_a_negative_raise() {
        let brush = TerrainBrush::default();
        assert_eq!(brush.lower.by_m, -brush.raise.by_m);
    }
}
