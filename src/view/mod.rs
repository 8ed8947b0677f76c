//! Where the eyes are: what each camera's level of detail on each terrain follows from.

#[cfg(feature = "render")]
mod eye;

pub use crate::terrain::GroundQuery;
#[cfg(feature = "render")]
pub(crate) use eye::{EyePlugin, EyeSystems, HeldLod};
#[cfg(feature = "render")]
pub use eye::{HeldTerrainEye, TerrainEye};

use crate::lattice::{Lattice, ViewLod};
use crate::stream::TerrainState;
use crate::terrain::{Terrain, TerrainCamera, TerrainCpuStage, TerrainCpuTimes};
use crate::tile::TILE_SAMPLES;
use bevy::ecs::entity::EntityHashSet;
use bevy::log::{error, warn};
use bevy::math::{DAffine3, DMat3, DVec3};
use bevy::prelude::*;
use bevy::time::Real;

/// A camera's view of one terrain, in this frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TerrainView {
    /// The terrain.
    pub terrain: Entity,
    /// The terrain's grid, with as many faces a node as the camera asks for.
    pub lattice: Lattice,
    /// What the level of detail follows from; its `eye` is the lattice point at or before the eye.
    pub lod: ViewLod,
    /// From that lattice point to the eye, 0..1 lattice units in x and z.
    pub eye_fraction: Vec2,
    /// The eye's height above the terrain's origin, in metres.
    pub eye_height_m: f32,
    /// The eye in the terrain's own space, in metres.
    pub eye_m: DVec3,
    /// From the world to the terrain's own space.
    pub local_from_world: DAffine3,
    /// From the terrain's own space to the world.
    pub world_from_local: DAffine3,
    /// World units per metre of the terrain.
    pub scale: f32,
    /// How fast the eye moves over the terrain, in metres a second along the terrain's axes,
    /// smoothed over a tenth of a second. 0 after a jump.
    pub velocity_m_s: DVec3,
    /// The same of the last frame alone, jumps included.
    pub last_velocity_m_s: DVec3,
    /// Pixels that a metre takes at a distance of a metre; 0 for a parallel projection and where
    /// nothing is drawn.
    pub focal_px: f32,
    /// Pixels that a metre of the terrain takes at any distance, in a parallel projection; else 0.
    pub px_per_m: f32,
}

/// A camera's views of all terrains, refilled every frame by
/// [`TerrainSystems::View`](crate::terrain::TerrainSystems::View); empty while the camera is not
/// active.
#[derive(Component, Clone, Debug, Default, PartialEq)]
pub struct TerrainViews {
    /// One view for each terrain whose manifest has loaded.
    pub views: Vec<TerrainView>,
}

impl TerrainViews {
    /// The view of `terrain`.
    #[must_use]
    pub fn of(&self, terrain: Entity) -> Option<&TerrainView> {
        self.views.iter().find(|view| view.terrain == terrain)
    }
}

/// How far a terrain's axes may be from equally long and at right angles, relative to their
/// length. Rounding in a chain of `f32` transforms stays well below.
const SKEW_MAX: f64 = 1e-3;
/// Half the height of what a camera sees at distance 1, with the field of view of Bevy's default
/// perspective (45°): tan 22.5°.
const DEFAULT_SLOPE: f64 = 0.414_213_562_373_095_03;

/// What a terrain's transform is made of.
struct Placement {
    world_from_local: DAffine3,
    local_from_world: DAffine3,
    scale: f64,
    /// Whether it is a rotation, a translation and a uniform positive scale.
    is_rigid: bool,
}

impl Placement {
    /// `None` where the transform can't be inverted.
    fn new(transform: &GlobalTransform) -> Option<Self> {
        let affine = transform.affine();
        let axis = |axis: bevy::math::Vec3A| Vec3::from(axis).as_dvec3();
        let matrix = DMat3::from_cols(
            axis(affine.matrix3.x_axis),
            axis(affine.matrix3.y_axis),
            axis(affine.matrix3.z_axis),
        );
        let world_from_local = DAffine3 {
            matrix3: matrix,
            translation: axis(affine.translation),
        };
        let determinant = matrix.determinant();
        let local_from_world = world_from_local.inverse();
        if !world_from_local.is_finite() || !local_from_world.is_finite() || determinant == 0.0 {
            return None;
        }
        let scale = determinant.abs().cbrt();
        let gram = matrix.transpose() * matrix * (scale * scale).recip();
        let skew = (gram - DMat3::IDENTITY)
            .to_cols_array()
            .into_iter()
            .fold(0.0, |most: f64, entry| most.max(entry.abs()));
        Some(Self {
            world_from_local,
            local_from_world,
            scale,
            is_rigid: determinant > 0.0 && skew <= SKEW_MAX,
        })
    }
}

/// The height in world units of what an orthographic projection shows; `None` for a perspective.
#[cfg(feature = "render")]
fn orthographic_height(clip_from_view: &Mat4) -> Option<f64> {
    let is_parallel = clip_from_view.w_axis.w == 1.0;
    is_parallel.then(|| (2.0 / f64::from(clip_from_view.y_axis.y)).abs())
}

/// What a camera's picture says about sizes.
#[derive(Clone, Copy, Debug, Default)]
struct Optics {
    /// World units that a parallel projection is high.
    parallel_height: Option<f64>,
    /// As [`TerrainView::focal_px`].
    focal_px: f32,
    /// Pixels a world unit, in a parallel projection.
    px_per_unit: f32,
}

impl Optics {
    #[cfg(feature = "render")]
    fn new(projection: Option<&Projection>, camera: Option<&Camera>) -> Self {
        let height_px = camera.and_then(Camera::physical_viewport_size);
        // A camera that has been computed knows whether it draws a part of a larger picture.
        let clip_from_view = match (camera, height_px) {
            (Some(camera), Some(_)) => Some(camera.clip_from_view()),
            _ => projection.map(|projection| projection.get_clip_from_view()),
        };
        let parallel_height = clip_from_view.as_ref().and_then(orthographic_height);
        let height_px = height_px.map_or(0.0, |size| size.y as f32);
        let slope = clip_from_view.map_or(0.0, |clip_from_view| clip_from_view.y_axis.y.abs());
        // Half the picture's height over the tangent of half the field of view, or over half the
        // height of a parallel one.
        let focal_px = 0.5 * height_px * slope;
        let is_parallel = parallel_height.is_some();
        Self {
            parallel_height,
            focal_px: if is_parallel { 0.0 } else { focal_px },
            px_per_unit: if is_parallel { focal_px } else { 0.0 },
        }
    }
}

/// Over what time an eye's velocity is smoothed.
const SMOOTHING_S: f64 = 0.1;
/// An eye that gets further than this in a frame has jumped, in finest tiles...
const JUMP_TILES: f64 = 0.5;
/// ...if it was this many times faster than before as well.
const JUMP_SPEEDUP: f64 = 4.0;

/// An eye's velocity, smoothed and of the last frame alone.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Motion {
    smooth_m_s: DVec3,
    last_m_s: DVec3,
}

impl Motion {
    /// The motion after a frame in which the eye got `moved_m` further.
    fn after(self, moved_m: DVec3, dt_s: f64, tile_m: f64) -> Self {
        if dt_s <= 0.0 {
            return self;
        }
        let now_m_s = moved_m / dt_s;
        if !now_m_s.is_finite() {
            return Self::default();
        }
        let is_far = moved_m.length() > JUMP_TILES * tile_m;
        let is_sudden = now_m_s.length() > JUMP_SPEEDUP * self.smooth_m_s.length();
        // Two frames that agree are no jumps.
        let goes_on = now_m_s.distance(self.last_m_s) < 0.25 * now_m_s.length();
        let smooth_m_s = if is_far && is_sudden {
            if goes_on { now_m_s } else { DVec3::ZERO }
        } else {
            self.smooth_m_s + (now_m_s - self.smooth_m_s) * (1.0 - (-dt_s / SMOOTHING_S).exp())
        };
        Self {
            smooth_m_s,
            last_m_s: now_m_s,
        }
    }
}

#[cfg(feature = "render")]
type CameraData = (
    Entity,
    Ref<'static, TerrainCamera>,
    &'static GlobalTransform,
    &'static mut TerrainViews,
    Option<&'static Projection>,
    Option<&'static Camera>,
    Option<&'static HeldTerrainEye>,
    Option<&'static HeldLod>,
);
#[cfg(not(feature = "render"))]
type CameraData = (
    Entity,
    Ref<'static, TerrainCamera>,
    &'static GlobalTransform,
    &'static mut TerrainViews,
);

/// Computes every camera's view of every terrain.
pub(crate) fn update_views(
    mut cameras: Query<CameraData>,
    terrains: Query<(Entity, &TerrainState, &GlobalTransform), With<Terrain>>,
    time: Res<Time<Real>>,
    times: Res<TerrainCpuTimes>,
    mut warned: Local<EntityHashSet>,
    mut before: Local<Vec<TerrainView>>,
) {
    let _span = bevy::log::debug_span!("terrain_views").entered();
    let _time = times.measure(TerrainCpuStage::View);
    if !warned.is_empty() {
        warned.retain(|terrain| terrains.contains(*terrain));
    }
    for camera in &mut cameras {
        #[cfg(feature = "render")]
        let (entity, settings, transform, mut views, projection, camera, held, held_lod) = camera;
        #[cfg(not(feature = "render"))]
        let (entity, settings, transform, mut views) = camera;
        before.clear();
        before.append(&mut views.views);
        #[cfg(feature = "render")]
        if camera.is_some_and(|camera| !camera.is_active) {
            continue;
        }
        #[cfg(feature = "render")]
        let optics = held_lod
            .and_then(|held| held.optics)
            .unwrap_or_else(|| Optics::new(projection, camera));
        #[cfg(feature = "render")]
        let transform = held.map_or(transform, |held| &held.lod);
        #[cfg(not(feature = "render"))]
        let optics = Optics::default();

        let is_new = settings.is_changed();
        let settings = settings.checked(|refused| {
            if is_new {
                error!("camera {entity}: {refused}; the default is used");
            }
        });
        for (terrain, state, placement) in &terrains {
            let placement = Placement::new(placement);
            let is_rigid = placement
                .as_ref()
                .is_some_and(|placement| placement.is_rigid);
            if !is_rigid && warned.insert(terrain) {
                warn!(
                    "terrain {terrain} has a Transform that is more than a rotation, a \
                     translation and one positive scale: its level of detail will be off"
                );
            }
            let eye = transform.translation().as_dvec3();
            let lattice = state.lattice();
            let lattice = lattice
                .with_faces_per_side(settings.faces_per_side)
                .unwrap_or_else(|refused| {
                    if is_new {
                        error!("camera {entity}: {refused}; the default is used");
                    }
                    *lattice
                });
            let view = placement.and_then(|placement| {
                let mut view = view_of(terrain, state, &placement, &settings, eye, &optics)?;
                view.lattice = lattice;
                if let Some(before) = before.iter().find(|view| view.terrain == terrain) {
                    let tile_m = f64::from(TILE_SAMPLES) * state.manifest().file.spacing_m;
                    let motion = Motion {
                        smooth_m_s: before.velocity_m_s,
                        last_m_s: before.last_velocity_m_s,
                    };
                    let moved_m = view.eye_m - before.eye_m;
                    let motion = motion.after(moved_m, time.delta_secs_f64(), tile_m);
                    view.velocity_m_s = motion.smooth_m_s;
                    view.last_velocity_m_s = motion.last_m_s;
                    let unit_m = view.lattice.unit_m(state.manifest().file.spacing_m);
                    let dt_s = time.delta_secs_f64();
                    view.lod.floor = followed_floor(before, &view, unit_m, dt_s);
                }
                Some(view)
            });
            views.views.extend(view);
        }
    }
}

/// How fast the distance to the nearest ground may change in a view besides what the eye's own motion
/// does to it, in sides of the finest nodes a second: a crater that opens below a hovering eye must
/// not change the level of detail from one frame to the next.
const FLOOR_NODES_PER_S: f64 = 0.25;

/// The floor of a view's distances that follows on that of the frame before.
fn followed_floor(before: &TerrainView, view: &TerrainView, unit_m: f64, dt_s: f64) -> i32 {
    let (old, new) = (&before.lod, &view.lod);
    if !new.planar || !old.planar || before.lattice != view.lattice {
        return new.floor;
    }
    let node = f64::from(view.lattice.node_size(view.lattice.leaf_level));
    let eye = |view: &TerrainView| view.lod.eye.as_dvec2() + view.eye_fraction.as_dvec2();
    let moved = (eye(view) - eye(before)).abs().max_element();
    let height_m = f64::from((view.eye_height_m - before.eye_height_m).abs());
    // Two for the rounding of both distances.
    let most = moved.max(height_m / unit_m) + node * FLOOR_NODES_PER_S * dt_s + 2.0;
    let change = f64::from(new.floor) - f64::from(old.floor);
    #[expect(clippy::cast_possible_truncation, reason = "between two i32")]
    let floor = (f64::from(old.floor) + change.clamp(-most, most)).round() as i32;
    floor
}

fn view_of(
    terrain: Entity,
    state: &TerrainState,
    placement: &Placement,
    settings: &TerrainCamera,
    eye: DVec3,
    optics: &Optics,
) -> Option<TerrainView> {
    let eye_m = placement.local_from_world.transform_point3(eye);
    if !eye_m.is_finite() {
        return None;
    }
    let lattice = state.lattice();
    let manifest = state.ground_bounds();
    let spacing_m = manifest.file.spacing_m;
    let (eye, eye_fraction) = lattice.lattice_from_local(eye_m.xz(), spacing_m);
    let ground = GroundQuery { lattice, manifest };
    let (floor, planar) = match optics.parallel_height {
        None => {
            // Detail may bring the ground nearer than the stored bounds.
            let detail = ground.units(state.detail().bound_m().into());
            let distance = ground.distance(eye, eye_m.y) - detail;
            (distance.max(0), true)
        }
        Some(height) => {
            let distance_m = height / (2.0 * DEFAULT_SLOPE * placement.scale);
            (ground.units(distance_m), false)
        }
    };
    let lod = ViewLod::new(lattice, &settings.lod, eye, floor, planar).ok()?;
    Some(TerrainView {
        terrain,
        lattice: *lattice,
        lod,
        eye_fraction,
        eye_height_m: eye_m.y as f32,
        eye_m,
        local_from_world: placement.local_from_world,
        world_from_local: placement.world_from_local,
        scale: placement.scale as f32,
        velocity_m_s: DVec3::ZERO,
        last_velocity_m_s: DVec3::ZERO,
        focal_px: optics.focal_px,
        px_per_m: optics.px_per_unit * placement.scale as f32,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_eyes_velocity_follows_its_motion_and_not_its_jumps() {
        let frame_s = 1.0 / 60.0;
        let step = DVec3::new(5.0, 0.0, 0.0);
        let mut motion = Motion::default();
        for _ in 0..60 {
            motion = motion.after(step, frame_s, 128.0);
        }
        assert!((motion.smooth_m_s.x - 300.0).abs() < 3.0, "{motion:?}");
        // A frame that takes half a second is no jump, nor is a pause.
        let late = motion.after(DVec3::new(150.0, 0.0, 0.0), 0.5, 128.0);
        assert!((late.smooth_m_s.x - 300.0).abs() < 3.0, "{late:?}");
        assert_eq!(motion.after(DVec3::ZERO, 0.0, 128.0), motion);
        let jump = DVec3::new(0.0, 0.0, 9000.0);
        let landed = motion.after(jump, frame_s, 128.0);
        assert_eq!(landed.smooth_m_s, DVec3::ZERO);
        let rests = landed.after(DVec3::ZERO, frame_s, 128.0);
        assert_eq!(rests.smooth_m_s, DVec3::ZERO);
        let nowhere = DVec3::splat(f64::NAN);
        assert_eq!(motion.after(nowhere, frame_s, 128.0), Motion::default());
        // However fast, a second frame like the first is a flight.
        let fast = Motion::default().after(100.0 * step, frame_s, 128.0);
        assert_eq!(fast.smooth_m_s, DVec3::ZERO);
        let fast = fast.after(100.0 * step, frame_s, 128.0);
        assert!((fast.smooth_m_s.x - 30_000.0).abs() < 1.0, "{fast:?}");
    }

    /// A view from `eye` in the plane and from `height_m`, `floor_m` above the ground, a metre a
    /// sample.
    fn view_from(eye: IVec2, height_m: f32, floor_m: f64) -> TerrainView {
        let lattice = Lattice::new([4097; 2], 6, 0, 8).expect("it fits");
        let units = |metres: f64| (metres / lattice.unit_m(1.0)) as i32;
        let samples = 1 << lattice.unit_log2;
        let settings = crate::lattice::LodSettings::default();
        let lod = ViewLod::new(&lattice, &settings, eye * samples, units(floor_m), true);
        TerrainView {
            terrain: Entity::PLACEHOLDER,
            lattice,
            lod: lod.expect("good settings"),
            eye_fraction: Vec2::ZERO,
            eye_height_m: height_m,
            eye_m: eye.as_dvec2().extend(height_m.into()).xzy(),
            local_from_world: DAffine3::IDENTITY,
            world_from_local: DAffine3::IDENTITY,
            scale: 1.0,
            velocity_m_s: DVec3::ZERO,
            last_velocity_m_s: DVec3::ZERO,
            focal_px: 1000.0,
            px_per_m: 0.0,
        }
    }

    #[test]
    fn ground_that_jumps_changes_a_hovering_eyes_level_of_detail_little_by_little() {
        let dt_s = 1.0 / 60.0;
        let unit_m = view_from(IVec2::ZERO, 0.0, 0.0).lattice.unit_m(1.0);
        let here = IVec2::splat(700);
        let most_m = f64::from(TILE_SAMPLES) * FLOOR_NODES_PER_S * dt_s + 3.0 * unit_m;
        for (old_m, new_m) in [
            (20.0_f64, 320.0_f64),
            (320.0, 20.0),
            (20.0, 20.2),
            (0.0, 90.0),
        ] {
            let mut before = view_from(here, 150.0, old_m);
            let new = view_from(here, 150.0, new_m);
            let mut frames = 0;
            while before.lod.floor != new.lod.floor {
                let floor = followed_floor(&before, &new, unit_m, dt_s);
                let change_m = f64::from(floor - before.lod.floor) * unit_m;
                assert!(change_m.abs() <= most_m, "{change_m} m in a frame");
                assert_eq!(change_m > 0.0, new_m > old_m, "it goes one way");
                before.lod.floor = floor;
                frames += 1;
            }
            let rate_m_s = f64::from(TILE_SAMPLES) * FLOOR_NODES_PER_S;
            let wanted = ((new_m - old_m).abs() / (rate_m_s * dt_s)).ceil();
            assert!(f64::from(frames) <= wanted, "{frames} frames, not {wanted}");
            // Nothing moves where no time passes.
            let paused = view_from(here, 150.0, old_m);
            let floor = followed_floor(&paused, &new, unit_m, 0.0);
            assert!((floor - paused.lod.floor).abs() <= 2);
        }
    }

    #[test]
    fn an_eye_that_flies_or_jumps_has_the_level_of_detail_of_where_it_is() {
        let dt_s = 1.0 / 60.0;
        let unit_m = view_from(IVec2::ZERO, 0.0, 0.0).lattice.unit_m(1.0);
        let here = IVec2::splat(700);
        let before = view_from(here, 150.0, 50.0);
        // The distance to the ground changes no faster than the eye moves: up, down, on, and far.
        for now in [
            view_from(here, 190.0, 90.0),
            view_from(here, 101.0, 1.0),
            view_from(here + IVec2::new(40, 3), 150.0, 12.0),
            view_from(here + IVec2::new(-30, 9), 170.0, 80.0),
            view_from(IVec2::new(3900, 20), 2500.0, 2400.0),
            view_from(IVec2::new(3900, 20), 150.0, 1.0),
        ] {
            let floor = followed_floor(&before, &now, unit_m, dt_s);
            assert_eq!(floor, now.lod.floor, "{now:?}");
        }
        // Nor is what isn't the same grid, or no distance.
        let mut other = view_from(here, 150.0, 400.0);
        other.lod.planar = false;
        assert_eq!(
            followed_floor(&before, &other, unit_m, dt_s),
            other.lod.floor
        );
        let mut other = view_from(here, 150.0, 400.0);
        other.lattice = Lattice::new([4097; 2], 6, 0, 4).expect("it fits");
        assert_eq!(
            followed_floor(&before, &other, unit_m, dt_s),
            other.lod.floor
        );
    }

    #[test]
    fn a_turned_and_scaled_terrain_is_rigid() {
        let transform = Transform::from_xyz(1e4, -3.0, 2e4)
            .with_rotation(Quat::from_euler(EulerRot::XYZ, 0.3, 1.0, -2.0))
            .with_scale(Vec3::splat(2.5));
        let placement = Placement::new(&transform.into()).expect("can be inverted");
        assert!(placement.is_rigid);
        assert!((placement.scale - 2.5).abs() < 1e-6);
        let there = DVec3::new(1.0, 2.0, 3.0);
        let world = placement.world_from_local.transform_point3(there);
        let back = placement.local_from_world.transform_point3(world);
        assert!((back - there).length() < 1e-9);
    }

    #[test]
    fn other_transforms_are_told_apart() {
        let scaled = |scale| Placement::new(&Transform::from_scale(scale).into());
        assert!(scaled(Vec3::new(1.0, 2.0, 1.0)).is_some_and(|placement| !placement.is_rigid));
        assert!(scaled(Vec3::new(-1.0, 1.0, 1.0)).is_some_and(|placement| !placement.is_rigid));
        assert!(scaled(Vec3::ZERO).is_none());
        assert!(scaled(Vec3::splat(f32::NAN)).is_none());
    }

    #[cfg(feature = "render")]
    #[test]
    fn a_parallel_projection_is_told_from_a_perspective() {
        use bevy::camera::{OrthographicProjection, PerspectiveProjection};
        let mut parallel = OrthographicProjection::default_3d();
        parallel.area = Rect::new(-8.0, -6.0, 8.0, 6.0);
        let height = orthographic_height(&Projection::Orthographic(parallel).get_clip_from_view());
        assert!(
            height.is_some_and(|height| (height - 12.0).abs() < 1e-4),
            "{height:?}"
        );
        let perspective = Projection::Perspective(PerspectiveProjection::default());
        assert_eq!(orthographic_height(&perspective.get_clip_from_view()), None);
    }
}
