//! Brings a camera to a place that was clicked.

use crate::stream::TerrainState;
use crate::terrain::Terrain;
use crate::view::{HeldTerrainEye, TerrainEye};
use bevy::math::{DAffine3, DVec2, DVec3};
use bevy::prelude::*;
use bevy::time::Real;

/// How far below the horizon a camera looks at the place, as a rise: about 35°.
const DESCENT: f64 = 0.7;
/// The camera is at least so far above the place, in samples of the terrain and in metres...
const LEAST_SAMPLES: f64 = 8.0;
const LEAST_M: f64 = 10.0;
/// ...and at most this part of the terrain's longer side.
const MOST_PART: f64 = 0.1;
/// So high, as a part of that side, where nothing says better.
const FIRST_PART: f64 = 0.03;
/// Of its height above the place, how much the camera keeps above the ground that it stands over.
const CLEARANCE: f64 = 0.3;
/// A place further than this, in heights above it, is jumped to.
const GLIDE_HEIGHTS: f64 = 40.0;
/// How long a glide takes.
const GLIDE_S: f32 = 0.8;

/// The panel has moved a camera to a place that was clicked, or a part of the way; triggered on the
/// camera, in every frame of a flight.
///
/// A camera controller that keeps angles of its own takes them from the camera's `Transform` now;
/// otherwise the first turn jumps back. For Bevy's `FreeCamera`:
///
/// ```no_run
/// # use bevy::prelude::*;
/// # #[derive(Component)]
/// # struct FreeCameraState { yaw: f32, pitch: f32 }
/// # use bevy_tessera::debug::TerrainCameraFlown;
/// fn turn_along(
///     flown: On<TerrainCameraFlown>,
///     mut cameras: Query<(&Transform, &mut FreeCameraState)>,
/// ) {
///     if let Ok((transform, mut state)) = cameras.get_mut(flown.entity) {
///         let (yaw, pitch, _) = transform.rotation.to_euler(EulerRot::YXZ);
///         (state.yaw, state.pitch) = (yaw, pitch);
///     }
/// }
/// # App::new().add_observer(turn_along);
/// ```
#[derive(EntityEvent, Clone, Copy, Debug, PartialEq, Eq)]
pub struct TerrainCameraFlown {
    /// The camera.
    pub entity: Entity,
    /// The terrain that the place is on.
    pub terrain: Entity,
    /// Whether it has arrived.
    pub is_there: bool,
}

/// Where the eye is, in the world, that a camera's `Transform` moves.
pub(in crate::debug) fn moved_eye(world: &World, camera: Entity) -> Option<GlobalTransform> {
    match (world.get::<TerrainEye>(camera), world.get(camera)) {
        (Some(TerrainEye::LodOnly), Some(HeldTerrainEye { lod, .. })) => Some(*lod),
        _ => world.get::<GlobalTransform>(camera).copied(),
    }
}

/// A flight that is to end at its goal, if nobody goes on with it.
#[derive(Resource, Debug, Default)]
struct Landing {
    frame: u64,
    due: Option<(Flight, u64)>,
}

impl Landing {
    fn note(world: &mut World, flight: Option<Flight>) {
        if let Some(mut landing) = world.get_resource_mut::<Self>() {
            let frame = landing.frame;
            landing.due = flight.map(|flight| (flight, frame));
        }
    }
}

/// Ends flights at their goals when the panel is closed on the way.
pub(in crate::debug) struct FlightPlugin;

impl Plugin for FlightPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Landing>().add_systems(First, land);
    }
}

fn land(world: &mut World) {
    let mut landing = world.resource_mut::<Landing>();
    landing.frame += 1;
    let frame = landing.frame;
    // One that went on in the frame before most likely does in this one.
    let due = landing.due.take_if(|(_, seen)| *seen + 1 < frame);
    if let Some((mut flight, _)) = due
        && flight.is_undisturbed(world)
    {
        flight.set(world, flight.to, true);
    }
}

/// A camera on its way.
#[derive(Clone, Copy, Debug)]
pub(super) struct Flight {
    camera: Entity,
    terrain: Entity,
    from: Transform,
    to: Transform,
    /// What was set last: where the camera isn't there any more, somebody else moves it.
    set: Transform,
    progress: f32,
}

/// From a terrain's own space to the world and back.
pub(super) fn placement(transform: &GlobalTransform) -> Option<[DAffine3; 2]> {
    let affine = transform.affine();
    let axis = |axis: bevy::math::Vec3A| Vec3::from(axis).as_dvec3();
    let world_from_local = DAffine3::from_cols(
        axis(affine.matrix3.x_axis),
        axis(affine.matrix3.y_axis),
        axis(affine.matrix3.z_axis),
        axis(affine.translation),
    );
    let local_from_world = world_from_local.inverse();
    local_from_world
        .is_finite()
        .then_some([world_from_local, local_from_world])
}

/// The eye and the place that it looks at, in the terrain's own space: the place `at_m` from a sensible
/// height, seen in the direction that the eye looks in now.
pub(super) fn stand_before(
    state: &TerrainState,
    at_m: DVec2,
    eye_m: DVec3,
    forward: DVec3,
) -> Option<[DVec3; 2]> {
    let ground = |at_m: DVec2| state.height(at_m).map(|ground| ground.height_m);
    let target_m = DVec3::new(at_m.x, ground(at_m)?, at_m.y);
    let file = &state.manifest().file;
    let side_m = f64::from(file.size[0].max(file.size[1])) * file.spacing_m;
    let least_m = (LEAST_SAMPLES * file.spacing_m).max(LEAST_M);
    let most_m = (MOST_PART * side_m).max(least_m);
    let now_m = ground(DVec2::new(eye_m.x, eye_m.z)).map(|height_m| eye_m.y - height_m);
    let height_m = now_m.unwrap_or(FIRST_PART * side_m).clamp(least_m, most_m);
    let heading = DVec2::new(forward.x, forward.z)
        .try_normalize()
        .unwrap_or(DVec2::NEG_Y);
    let stand_m = at_m - heading * (height_m / DESCENT);
    let below_m = ground(stand_m).unwrap_or(f64::NEG_INFINITY);
    let y = (target_m.y + height_m).max(below_m + CLEARANCE * height_m);
    Some([DVec3::new(stand_m.x, y, stand_m.y), target_m])
}

impl Flight {
    /// Sends `camera` to the place `at_m` of `terrain`; at once where it is far. `None` where there is
    /// nothing to fly to, or where the camera is there already.
    pub(super) fn begin(
        world: &mut World,
        camera: Entity,
        terrain: Entity,
        at_m: DVec2,
    ) -> Option<Self> {
        let state = world.get::<TerrainState>(terrain)?;
        let [world_from_local, local_from_world] = placement(world.get(terrain)?)?;
        let global = moved_eye(world, camera)?;
        let eye_m = local_from_world.transform_point3(global.translation().as_dvec3());
        let forward = local_from_world.transform_vector3(global.forward().as_dvec3());
        let [stand_m, target_m] = stand_before(state, at_m, eye_m, forward)?;
        let [stand, target] =
            [stand_m, target_m].map(|place| world_from_local.transform_point3(place).as_vec3());
        let up = world_from_local.transform_vector3(DVec3::Y).as_vec3();
        let goal = Transform::from_translation(stand).looking_at(target, up);
        let height_m = (stand_m.y - target_m.y).max(1.0);
        let is_far = eye_m.distance(stand_m) > GLIDE_HEIGHTS * height_m;
        // A camera may ride on something.
        let parent = world.get::<ChildOf>(camera).map(ChildOf::parent);
        let parent = parent.and_then(|parent| world.get::<GlobalTransform>(parent).copied());
        let from = *world.get::<Transform>(camera)?;
        let mut to = match parent {
            Some(parent) => GlobalTransform::from(goal).reparented_to(&parent),
            None => goal,
        };
        to.scale = from.scale;
        let mut flight = Self {
            camera,
            terrain,
            from,
            to,
            set: from,
            progress: 0.0,
        };
        if is_far {
            flight.set(world, to, true);
            return None;
        }
        Landing::note(world, Some(flight));
        Some(flight)
    }

    /// Whether the camera is where it was left, and the terrain is there.
    fn is_undisturbed(&self, world: &World) -> bool {
        world.get::<Transform>(self.camera) == Some(&self.set)
            && world.get::<Terrain>(self.terrain).is_some()
    }

    /// Moves the camera and says so.
    fn set(&mut self, world: &mut World, next: Transform, is_there: bool) {
        self.set = next;
        if let Some(mut transform) = world.get_mut::<Transform>(self.camera) {
            *transform = next;
        }
        Landing::note(world, (!is_there).then_some(*self));
        world.trigger(TerrainCameraFlown {
            entity: self.camera,
            terrain: self.terrain,
            is_there,
        });
        world.flush();
    }

    /// Goes a frame further; false where the flight is over.
    pub(super) fn step(&mut self, world: &mut World) -> bool {
        let dt_s = world
            .get_resource::<Time<Real>>()
            .map_or(GLIDE_S, |time| time.delta_secs());
        if !self.is_undisturbed(world) {
            Landing::note(world, None);
            return false;
        }
        self.progress = (self.progress + dt_s / GLIDE_S).min(1.0);
        let part = self.progress * self.progress * (3.0 - 2.0 * self.progress);
        let mut next = Transform {
            translation: self.from.translation.lerp(self.to.translation, part),
            rotation: self.from.rotation.slerp(self.to.rotation, part),
            scale: self.to.scale,
        };
        if self.progress >= 1.0 {
            next = self.to;
        } else if world.get::<ChildOf>(self.camera).is_none() {
            self.rise_above_ground(world, &mut next);
        }
        self.set(world, next, self.progress >= 1.0);
        self.progress < 1.0
    }

    /// Hills between here and there are flown over.
    fn rise_above_ground(&self, world: &World, next: &mut Transform) {
        let Some(state) = world.get::<TerrainState>(self.terrain) else {
            return;
        };
        let placement = world.get(self.terrain).and_then(placement);
        let Some([world_from_local, local_from_world]) = placement else {
            return;
        };
        let mut place = local_from_world.transform_point3(next.translation.as_dvec3());
        if let Some(ground) = state.height(DVec2::new(place.x, place.z)) {
            let least_m = ground.height_m + 0.5 * LEAST_M;
            if place.y < least_m {
                place.y = least_m;
                next.translation = world_from_local.transform_point3(place).as_vec3();
            }
        }
    }
}
