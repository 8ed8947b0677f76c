//! Terrains asked in the world's space.

use super::{GroundRay, GroundReader, GroundSample, TerrainHeight};
use crate::stream::TerrainState;
use bevy::ecs::system::SystemParam;
use bevy::math::{DAffine3, DMat3, DVec2, DVec3};
use bevy::prelude::*;
use bevy::tasks::{ComputeTaskPool, TaskPool};

/// Fewer questions than this are answered at once, on the thread that asks.
const PARALLEL_RAYS: usize = 256;
const PARALLEL_PLACES: usize = 8192;

/// The ground under a place in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TerrainGround {
    /// The terrain.
    pub terrain: Entity,
    /// The place on the ground, in the world.
    pub point: Vec3,
    /// The unit vector that stands upright on the ground there, in the world.
    pub normal: Vec3,
    /// The level that the answer comes from, as in [`TerrainHeight::level`].
    pub level: u8,
}

/// Where a ray hits a terrain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TerrainHit {
    /// The terrain.
    pub terrain: Entity,
    /// The place on the ground, in the world.
    pub point: Vec3,
    /// The unit vector that stands upright on the ground there, in the world; upwards, whichever
    /// side was hit.
    pub normal: Vec3,
    /// How far the place is from the ray's origin, in the world's metres.
    pub distance: f32,
    /// The level that the answer comes from, as in [`TerrainHeight::level`]: above 0, finer tiles
    /// aren't resident there.
    pub level: u8,
    /// Whether the ray came from below the ground.
    pub is_from_below: bool,
}

/// Asks terrains for their ground. A system parameter.
///
/// Places are in the world, or in metres of a terrain's own x and z where a terrain is named.
/// Terrains may be moved, turned and scaled uniformly; what counts is their `GlobalTransform`,
/// which Bevy brings up to date once a frame. The ground is a surface without thickness, which ends at
/// each terrain's rim.
///
/// What is not a number, or not finite, is on no terrain. Answers are those of the tiles that are
/// resident at the time, and say their level.
///
/// ```
/// # use bevy::prelude::*;
/// # use bevy_tessera::query::TerrainQuery;
/// # #[derive(Component)] struct Sheep;
/// fn stand_on_the_ground(ground: TerrainQuery, mut sheep: Query<&mut Transform, With<Sheep>>) {
///     for mut sheep in &mut sheep {
///         if let Some(ground) = ground.under(sheep.translation) {
///             sheep.translation = ground.point;
///         }
///     }
/// }
///
/// fn is_in_sight(ground: &TerrainQuery, sheep: Vec3, wolf: Vec3) -> bool {
///     let Ok((towards, distance)) = Dir3::new_and_length(sheep - wolf) else {
///         return true;
///     };
///     ground.ray(Ray3d::new(wolf, towards), distance).is_none()
/// }
/// ```
#[derive(SystemParam)]
pub struct TerrainQuery<'w, 's> {
    terrains: Query<'w, 's, (Entity, &'static TerrainState, &'static GlobalTransform)>,
}

impl TerrainQuery<'_, '_> {
    /// The ground of `terrain` at `at_m`, in metres of its own x and z. `None` where that is
    /// outside, and while not even the coarsest tile is resident.
    #[must_use]
    pub fn height(&self, terrain: Entity, at_m: DVec2) -> Option<TerrainHeight> {
        self.state(terrain)?.height(at_m)
    }

    /// The same at many places, in their order. Faster than one by one where neighbours in the list
    /// are neighbours on the ground; from some thousands on, on all of the compute threads. All are
    /// `None` where there is no such terrain.
    #[must_use]
    pub fn heights(&self, terrain: Entity, at_m: &[DVec2]) -> Vec<Option<TerrainHeight>> {
        let Some(state) = self.state(terrain) else {
            return vec![None; at_m.len()];
        };
        answer_all(at_m, PARALLEL_PLACES, |at_m| {
            let mut reader = GroundReader::new(state);
            at_m.iter().map(|&at_m| reader.height(at_m)).collect()
        })
    }

    /// Height, gradient (and from it normal and slope) and level of the ground of `terrain` at
    /// `at_m`, in metres of its own x and z, from one look-up.
    #[must_use]
    pub fn ground(&self, terrain: Entity, at_m: DVec2) -> Option<GroundSample> {
        self.state(terrain)?.ground(at_m)
    }

    /// The unit vector that stands upright on the ground of `terrain` at `at_m`, in metres of its
    /// own x and z. It is in the terrain's own space too; [`under`](Self::under) gives that in the
    /// world. That of the bilinear surface, exactly: it jumps where cells meet.
    #[must_use]
    pub fn normal(&self, terrain: Entity, at_m: DVec2) -> Option<DVec3> {
        Some(self.ground(terrain, at_m)?.normal())
    }

    /// The angle between the ground of `terrain` at `at_m`, in metres of its own x and z, and the
    /// terrain's own level, in radians from 0 to below π/2.
    #[must_use]
    pub fn slope(&self, terrain: Entity, at_m: DVec2) -> Option<f64> {
        Some(self.ground(terrain, at_m)?.slope())
    }

    /// The finest level that is resident on `terrain` at `at_m`, in metres of its own x and z: 0
    /// where the samples themselves are.
    #[must_use]
    pub fn level(&self, terrain: Entity, at_m: DVec2) -> Option<u8> {
        Some(self.height(terrain, at_m)?.level)
    }

    /// The ground under a place in the world (or over it, where the place is below the ground): that
    /// of the terrain whose ground is nearest along the terrain's own vertical. `None` where there is
    /// no terrain.
    #[must_use]
    pub fn under(&self, place: Vec3) -> Option<TerrainGround> {
        let grounds = self
            .placed()
            .filter_map(|terrain| terrain.under(&mut terrain.reader(), place));
        nearest_ground(place, grounds)
    }

    /// The same at many places, in their order; see [`heights`](Self::heights).
    #[must_use]
    pub fn under_all(&self, places: &[Vec3]) -> Vec<Option<TerrainGround>> {
        let terrains: Vec<_> = self.placed().collect();
        answer_all(places, PARALLEL_PLACES, |places| {
            let mut readers: Vec<_> = terrains.iter().map(|terrain| terrain.reader()).collect();
            let mut under = |&place: &Vec3| {
                let grounds = terrains
                    .iter()
                    .zip(&mut readers)
                    .filter_map(|(terrain, reader)| terrain.under(reader, place));
                nearest_ground(place, grounds)
            };
            places.iter().map(&mut under).collect()
        })
    }

    /// Where a ray in the world first hits a terrain, at most `max_distance` metres away (which may be
    /// infinite); from above or from below. Where it starts on the ground, there.
    ///
    /// Where tiles of different levels meet, their grounds may leave an upright gap; that is ground
    /// too, so that no ray from above ever gets below. Cost: about a microsecond a terrain.
    #[must_use]
    pub fn ray(&self, ray: Ray3d, max_distance: f32) -> Option<TerrainHit> {
        nearest_hit(self.placed(), ray, max_distance)
    }

    /// The same for `terrain` alone, whatever other terrains are in the way.
    #[must_use]
    pub fn ray_on(&self, terrain: Entity, ray: Ray3d, max_distance: f32) -> Option<TerrainHit> {
        let terrain = self.terrains.get(terrain).ok().and_then(Placed::new)?;
        terrain.ray(ray, max_distance)
    }

    /// [`ray`](Self::ray) for many rays, each with its greatest distance, in their order; from some
    /// hundreds on, on all of the compute threads.
    #[must_use]
    pub fn rays(&self, rays: &[(Ray3d, f32)]) -> Vec<Option<TerrainHit>> {
        let terrains: Vec<_> = self.placed().collect();
        answer_all(rays, PARALLEL_RAYS, |rays| {
            rays.iter()
                .map(|&(ray, max_distance)| {
                    nearest_hit(terrains.iter().copied(), ray, max_distance)
                })
                .collect()
        })
    }

    fn state(&self, terrain: Entity) -> Option<&TerrainState> {
        let (_, state, _) = self.terrains.get(terrain).ok()?;
        Some(state)
    }

    fn placed(&self) -> impl Iterator<Item = Placed<'_>> {
        self.terrains.iter().filter_map(Placed::new)
    }
}

/// A terrain in the world.
#[derive(Clone, Copy)]
struct Placed<'a> {
    terrain: Entity,
    state: &'a TerrainState,
    to_world: DAffine3,
    to_local: DAffine3,
    /// What normals are multiplied by.
    turn: DMat3,
}

impl<'a> Placed<'a> {
    /// `None` where the transform can't be inverted.
    fn new(
        (terrain, state, transform): (Entity, &'a TerrainState, &GlobalTransform),
    ) -> Option<Self> {
        let affine = transform.affine();
        let to_world = DAffine3::from_cols(
            DVec3::from(Vec3::from(affine.matrix3.x_axis)),
            DVec3::from(Vec3::from(affine.matrix3.y_axis)),
            DVec3::from(Vec3::from(affine.matrix3.z_axis)),
            DVec3::from(Vec3::from(affine.translation)),
        );
        let to_local = to_world.inverse();
        to_local.is_finite().then_some(Self {
            terrain,
            state,
            to_world,
            to_local,
            turn: to_local.matrix3.transpose(),
        })
    }

    fn reader(&self) -> GroundReader<'a, TerrainState> {
        GroundReader::new(self.state)
    }

    fn normal(&self, local: DVec3) -> Vec3 {
        (self.turn * local).normalize_or_zero().as_vec3()
    }

    fn under(
        &self,
        reader: &mut GroundReader<'a, TerrainState>,
        place: Vec3,
    ) -> Option<TerrainGround> {
        let local = self.to_local.transform_point3(place.as_dvec3());
        let ground = reader.sample(local.xz())?;
        let foot = local.with_y(ground.height_m);
        Some(TerrainGround {
            terrain: self.terrain,
            point: self.to_world.transform_point3(foot).as_vec3(),
            normal: self.normal(ground.normal()),
            level: ground.level,
        })
    }

    fn ray(&self, ray: Ray3d, max_distance: f32) -> Option<TerrainHit> {
        let ray = GroundRay {
            origin_m: self.to_local.transform_point3(ray.origin.as_dvec3()),
            direction: self.to_local.transform_vector3(ray.direction.as_dvec3()),
            max_distance: f64::from(max_distance),
        };
        let hit = self.state.ray(&ray)?;
        Some(TerrainHit {
            terrain: self.terrain,
            point: self.to_world.transform_point3(hit.point_m).as_vec3(),
            normal: self.normal(hit.normal),
            distance: hit.distance as f32,
            level: hit.level,
            is_from_below: hit.is_from_below,
        })
    }
}

fn nearest_ground(
    place: Vec3,
    grounds: impl Iterator<Item = TerrainGround>,
) -> Option<TerrainGround> {
    let distance = |ground: &TerrainGround| ground.point.distance_squared(place);
    grounds.min_by(|a, b| distance(a).total_cmp(&distance(b)))
}

fn nearest_hit<'a>(
    terrains: impl Iterator<Item = Placed<'a>>,
    ray: Ray3d,
    max_distance: f32,
) -> Option<TerrainHit> {
    let mut nearest: Option<TerrainHit> = None;
    for terrain in terrains {
        let max_distance = nearest.map_or(max_distance, |hit| hit.distance);
        if let Some(hit) = terrain.ray(ray, max_distance)
            && nearest.is_none_or(|nearest| hit.distance < nearest.distance)
        {
            nearest = Some(hit);
        }
    }
    nearest
}

/// Answers questions in their order; on all compute threads where there are at least `parallel`.
fn answer_all<Q: Sync, A: Send + 'static>(
    questions: &[Q],
    parallel: usize,
    answer: impl Fn(&[Q]) -> Vec<A> + Sync,
) -> Vec<A> {
    let pool: Option<&TaskPool> = ComputeTaskPool::try_get().map(|pool| &**pool);
    match pool {
        Some(pool) if questions.len() >= parallel && pool.thread_num() > 1 => {
            // Some pieces a thread, for what takes longer here than there.
            let piece = questions.len().div_ceil(4 * pool.thread_num()).max(1);
            let answer = &answer;
            let pieces = pool.scope(|scope| {
                for questions in questions.chunks(piece) {
                    scope.spawn(async move { answer(questions) });
                }
            });
            pieces.into_iter().flatten().collect()
        }
        _ => answer(questions),
    }
}
