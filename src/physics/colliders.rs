//! The colliders of the ground near bodies, and the systems that keep them.

use super::bodies::{Bodies, Body, LocalBox};
use super::grid::{Built, Chunk, Chunks, Grid, Key, Stage};
use super::settings::TerrainPhysics;
use super::shape::{Ground, Place, height_at};
use crate::edit::SampleRect;
use crate::stream::{TerrainPin, TerrainRegion, TerrainState};
use crate::terrain::Terrain;
use crate::tile::{TILE_SAMPLES, TileAddress};
use avian3d::dynamics::solver::islands::WakeBody;
use avian3d::parry::shape::SharedShape;
use avian3d::prelude::{
    Collider, CollisionLayers, CollisionMargin, Friction, Position, Restitution, RigidBody,
};
use bevy::ecs::system::SystemParam;
use bevy::log::{error, warn};
use bevy::math::Affine3A;
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::tasks::{AsyncComputeTaskPool, block_on, futures_lite::future};

/// A piece of ground that bodies collide with: a child of its terrain, beside a static `RigidBody`
/// and a `Collider`.
#[derive(Component, Clone, Copy, Debug, PartialEq, Reflect)]
#[reflect(Component, Debug, Clone, PartialEq)]
pub struct TerrainCollider {
    /// The terrain.
    #[entities]
    pub terrain: Entity,
    /// The samples of level 0 that it holds; the last row and column are its neighbours' first.
    pub rect: SampleRect,
    /// The level that its heights come from: 0, or the finest that is resident.
    pub level: u8,
    /// Where it stands in the terrain's space.
    translation: Vec3,
}

/// Beside a [`TerrainPin`]: the ground in the pin's region has colliders too, bodies or not. They are
/// as fine as what is resident, so that a pin of level 0 gives them in full detail.
///
/// A region that is wider than [`TerrainPhysics::max_colliders`] gets no more than that.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Eq, Reflect)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct TerrainColliderPin;

/// Beside a [`TerrainPin`] that the plugin has spawned to keep a tile under a body resident: tells
/// such pins from the game's own.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Eq, Reflect)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct TerrainBodyPin;

/// All terrains' colliders. A resource, for its figures.
#[derive(Resource, Default)]
pub struct TerrainColliders {
    grids: HashMap<Entity, Grid>,
    raw_settings: Option<TerrainPhysics>,
    settings: TerrainPhysics,
    /// Whether it has been logged that there are too many.
    is_full: bool,
    bodies: Vec<Body>,
}

impl std::fmt::Debug for TerrainColliders {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("TerrainColliders")
            .field("made", &self.made())
            .field("wanted", &self.wanted())
            .finish_non_exhaustive()
    }
}

impl TerrainColliders {
    /// Colliders that there are.
    #[must_use]
    pub fn made(&self) -> usize {
        let chunks = self.grids.values().flat_map(|grid| grid.chunks.values());
        chunks
            .filter(|chunk| matches!(chunk.stage, Stage::Made(..)))
            .count()
    }

    /// Colliders that are wanted, made or not.
    #[must_use]
    pub fn wanted(&self) -> usize {
        self.grids.values().map(|grid| grid.chunks.len()).sum()
    }

    /// The collider under a place of a terrain, in metres of its own x and z; `None` where there is
    /// none.
    #[must_use]
    pub fn under(&self, terrain: Entity, at_m: Vec2) -> Option<Entity> {
        let grid = self.grids.get(&terrain)?;
        let at_m = at_m.as_dvec2();
        let key = grid.touched(at_m, at_m)?.first;
        match grid.chunks.get(&key)?.stage {
            Stage::Made(entity, ..) => Some(entity),
            _ => None,
        }
    }

    /// Whether all ground of a region has colliders.
    #[must_use]
    pub fn covers(&self, terrain: Entity, region: TerrainRegion) -> bool {
        let Some(grid) = self.grids.get(&terrain) else {
            return false;
        };
        let chunks = grid.touched(region.min_m.as_dvec2(), region.max_m.as_dvec2());
        let is_made = |key| {
            let chunk = grid.chunks.get(&key);
            chunk.is_some_and(|chunk| matches!(chunk.stage, Stage::Made(..)))
        };
        chunks.is_some_and(|chunks| chunks.iter().all(is_made))
    }

    pub(super) fn edited(&mut self, terrain: Entity, rect: SampleRect) {
        if let Some(grid) = self.grids.get_mut(&terrain) {
            grid.edited(rect);
        }
    }

    pub(super) fn tile_changed(
        &mut self,
        terrain: Entity,
        address: TileAddress,
        has_arrived: bool,
    ) {
        if let Some(grid) = self.grids.get_mut(&terrain) {
            grid.tile_changed(address, has_arrived);
        }
    }

    /// Somebody has despawned a collider, maybe without asking.
    pub(super) fn removed(&mut self, entity: Entity, collider: &TerrainCollider) {
        if let Some(grid) = self.grids.get_mut(&collider.terrain) {
            grid.removed(entity, collider.rect);
        }
    }
}

/// Terrains that have begun.
type Terrains<'w, 's> =
    Query<'w, 's, (Entity, &'static TerrainState, &'static GlobalTransform), With<Terrain>>;

/// What colliders take over from their terrain.
type Surface = (
    Option<&'static CollisionLayers>,
    Option<&'static Friction>,
    Option<&'static Restitution>,
    Option<&'static CollisionMargin>,
);
type SurfaceChanged = Or<(
    Changed<CollisionLayers>,
    Changed<Friction>,
    Changed<Restitution>,
    Changed<CollisionMargin>,
)>;

/// Everything that colliders are made from and into.
#[derive(SystemParam)]
pub(super) struct Outside<'w, 's> {
    raw_settings: Res<'w, TerrainPhysics>,
    time: Res<'w, Time>,
    terrains: Terrains<'w, 's>,
    bodies: Bodies<'w, 's>,
    pins: Query<'w, 's, &'static TerrainPin, With<TerrainColliderPin>>,
    colliders: Query<'w, 's, (&'static mut Collider, &'static mut TerrainCollider)>,
    positions: Query<'w, 's, &'static mut Position, Without<TerrainCollider>>,
    surfaces: Query<'w, 's, Surface>,
    commands: Commands<'w, 's>,
}

/// A collider whose heights have been replaced.
struct Change {
    place: Place,
    /// In metres of the terrain.
    min_m: Vec2,
    max_m: Vec2,
    base_m: f32,
    old: SharedShape,
    new: SharedShape,
}

/// Avian writes what it thinks of a body's place back into transforms, rounded; static ground goes
/// nowhere by that, however often its terrain moves.
pub(super) fn hold_in_place(
    mut colliders: Query<(&TerrainCollider, &mut Transform), Changed<Transform>>,
) {
    for (collider, mut transform) in &mut colliders {
        transform.set_if_neq(Transform::from_translation(collider.translation));
    }
}

/// Colliders are as rough and as bouncy as their terrain, also when it changes.
pub(super) fn follow_surface(
    changed: Query<Entity, (SurfaceChanged, With<Terrain>)>,
    surfaces: Query<Surface>,
    colliders: Query<(Entity, &TerrainCollider)>,
    mut commands: Commands,
) {
    if changed.is_empty() {
        return;
    }
    for (entity, collider) in &colliders {
        if changed.contains(collider.terrain)
            && let Ok(surface) = surfaces.get(collider.terrain)
        {
            take_surface(&mut commands.entity(entity), surface);
        }
    }
}

fn take_surface(
    entity: &mut EntityCommands,
    (layers, friction, restitution, margin): (
        Option<&CollisionLayers>,
        Option<&Friction>,
        Option<&Restitution>,
        Option<&CollisionMargin>,
    ),
) {
    if let Some(layers) = layers {
        entity.try_insert(*layers);
    }
    if let Some(friction) = friction {
        entity.try_insert(*friction);
    }
    if let Some(restitution) = restitution {
        entity.try_insert(*restitution);
    }
    if let Some(margin) = margin {
        entity.try_insert(*margin);
    }
}

/// Brings all colliders up to date with bodies, pins, tiles and edits.
pub(super) fn update_colliders(mut all: ResMut<TerrainColliders>, mut outside: Outside) {
    let _span = bevy::log::debug_span!("terrain_colliders").entered();
    let all = &mut *all;
    let outside = &mut outside;
    all.take_settings(&outside.raw_settings);
    all.drop_gone(outside);
    let mut bodies = std::mem::take(&mut all.bodies);
    outside
        .bodies
        .collect(all.settings.kinematic_bodies, &mut bodies);
    let now_s = outside.time.elapsed_secs_f64();
    let mut builds = all.settings.builds_per_step;
    let mut wanted = all.wanted();
    let mut lifts = HashMap::<Entity, Vec3>::default();
    for (terrain, state, transform) in &outside.terrains {
        let Some(grid) = all.grids.get_mut(&terrain) else {
            continue;
        };
        let mut pass = Pass {
            terrain,
            state,
            grid,
            settings: &all.settings,
            now_s,
            room: (all.settings.max_colliders as usize).saturating_sub(wanted),
            refused: 0,
            builds: &mut builds,
        };
        let before = pass.grid.chunks.len();
        let to_world = transform.affine();
        let to_local = to_world.inverse();
        let is_sound = to_local.is_finite() && to_world.is_finite();
        if is_sound {
            pass.want_near(&bodies, &to_local, &mut outside.commands, &outside.surfaces);
        }
        pass.want_pinned(&outside.pins);
        wanted += pass.grid.chunks.len() - before;
        pass.finish_builds(&mut outside.commands, &outside.surfaces);
        let changes = pass.follow_changes(&mut outside.colliders);
        pass.begin_builds(&mut outside.commands, &outside.surfaces);
        let lapsed = pass.drop_unwanted(&mut outside.commands);
        wanted -= lapsed;
        if pass.refused > 0 && !all.is_full {
            all.is_full = true;
            warn!(
                "{} colliders of terrain are all that TerrainPhysics::max_colliders allows: bodies \
                 may fall through the ground; raise it, or pin smaller regions",
                all.settings.max_colliders
            );
        }
        if is_sound && !changes.is_empty() {
            let frames = [to_world, to_local];
            let lift = all.settings.lift_bodies;
            move_bodies(
                &bodies,
                &changes,
                frames,
                lift,
                &mut lifts,
                &mut outside.commands,
            );
        }
    }
    for (entity, lift) in lifts {
        if let Ok(mut position) = outside.positions.get_mut(entity) {
            position.0 += lift;
        }
    }
    all.bodies = bodies;
}

impl TerrainColliders {
    fn take_settings(&mut self, raw: &TerrainPhysics) {
        if self.raw_settings.as_ref() != Some(raw) {
            self.raw_settings = Some(raw.clone());
            self.settings = raw.checked(|error| error!("{error}; the default is used"));
            self.is_full = false;
        }
    }

    /// Lets go of what belongs to terrains that are gone, or are others now, and begins new ones.
    fn drop_gone(&mut self, outside: &mut Outside) {
        let cells = self.settings.chunk_cells;
        let (terrains, commands) = (&outside.terrains, &mut outside.commands);
        self.grids.retain(|&terrain, grid| {
            let same = terrains.get(terrain).is_ok_and(|(_, state, _)| {
                grid.instance == state.instance() && grid.cells == cells
            });
            if !same {
                let made = grid.chunks.values().filter_map(|chunk| match chunk.stage {
                    Stage::Made(entity, ..) => Some(entity),
                    _ => None,
                });
                for entity in made.chain(grid.tiles.values().map(|&(pin, _)| pin)) {
                    commands.entity(entity).try_despawn();
                }
            }
            same
        });
        for (terrain, state, _) in terrains {
            self.grids
                .entry(terrain)
                .or_insert_with(|| Grid::new(state, cells));
        }
    }
}

/// One terrain's part of a step.
struct Pass<'a> {
    terrain: Entity,
    state: &'a TerrainState,
    grid: &'a mut Grid,
    settings: &'a TerrainPhysics,
    now_s: f64,
    /// Colliders that there may be more.
    room: usize,
    /// Colliders that there was no room for.
    refused: usize,
    /// Colliders that may be begun in this step.
    builds: &'a mut u32,
}

impl Pass<'_> {
    /// The chunk at `key`, which is wanted; `None` where it can't be.
    fn want(&mut self, key: Key, is_urgent: bool) -> Option<&mut Chunk> {
        if !self.grid.chunks.contains_key(&key) {
            let place = Place::new(&self.grid.manifest.file, self.grid.cells, key)?;
            if self.room == 0 {
                self.refused += 1;
                return None;
            }
            self.room -= 1;
            self.grid.chunks.insert(
                key,
                Chunk {
                    place,
                    stage: Stage::Waiting,
                    until_s: f64::NEG_INFINITY,
                    is_pinned: false,
                    is_keeping: false,
                    is_stale: false,
                },
            );
            if is_urgent {
                self.grid.waiting.push_front(key);
            } else {
                self.grid.waiting.push_back(key);
            }
        }
        self.grid.chunks.get_mut(&key)
    }

    fn want_near(
        &mut self,
        bodies: &[Body],
        to_local: &Affine3A,
        commands: &mut Commands,
        surfaces: &Query<Surface>,
    ) {
        // Uniform scale: one axis says it.
        let margin = self.settings.margin_m * to_local.matrix3.x_axis.length();
        let mut keys = Vec::new();
        for body in bodies {
            let sweep = to_local.transform_vector3(body.velocity) * self.settings.lookahead_s;
            keys.clear();
            self.grid.near(
                self.state,
                body.within(to_local),
                sweep,
                margin,
                |key, is_urgent| keys.push((key, is_urgent)),
            );
            for &(key, is_urgent) in &keys {
                let (until_s, keep) = (
                    self.now_s + f64::from(self.settings.keep_s),
                    self.settings.keep_resident,
                );
                let Some(chunk) = self.want(key, is_urgent) else {
                    continue;
                };
                chunk.until_s = until_s;
                let must_keep = keep && !std::mem::replace(&mut chunk.is_keeping, keep);
                let is_waiting = matches!(chunk.stage, Stage::Waiting);
                if must_keep {
                    self.keep_tile(key, commands);
                }
                if is_urgent && is_waiting && *self.builds > 0 {
                    self.build_now(key, commands, surfaces);
                }
            }
        }
    }

    /// Keeps the finest tile under a chunk resident.
    fn keep_tile(&mut self, key: Key, commands: &mut Commands) {
        let (cells, terrain) = (self.grid.cells, self.terrain);
        let tile = key.map(|at| at * cells / TILE_SAMPLES);
        let file = &self.grid.manifest.file;
        let (_, count) = self.grid.tiles.entry(tile).or_insert_with(|| {
            // A place in the tile's middle pins that tile alone.
            let middle = [0, 1].map(|axis| {
                let first = f64::from(tile[axis] * TILE_SAMPLES);
                let last = f64::from(file.size[axis] - 1).min(first + f64::from(TILE_SAMPLES));
                ((first + last) * 0.5 * file.spacing_m) as f32
            });
            let pin = TerrainPin {
                terrain,
                region: TerrainRegion::around(Vec2::from(middle), 0.0),
                finest_level: 0,
            };
            (commands.spawn((pin, TerrainBodyPin)).id(), 0)
        });
        *count += 1;
    }

    fn want_pinned(&mut self, pins: &Query<&TerrainPin, With<TerrainColliderPin>>) {
        let own = pins.iter().filter(|pin| pin.terrain == self.terrain);
        let wanted: Vec<Chunks> = own
            .filter_map(|pin| {
                let TerrainRegion { min_m, max_m } = pin.region;
                self.grid.touched(min_m.as_dvec2(), max_m.as_dvec2())
            })
            .collect();
        if wanted == self.grid.pinned {
            return;
        }
        for chunk in self.grid.chunks.values_mut() {
            chunk.is_pinned = false;
        }
        let refused = self.refused;
        for key in wanted.iter().flat_map(|chunks| chunks.iter()) {
            if let Some(chunk) = self.want(key, false) {
                chunk.is_pinned = true;
            } else if self.room == 0 {
                break;
            }
        }
        // What there was no room for is asked for again.
        let is_complete = refused == self.refused;
        self.grid.pinned = if is_complete { wanted } else { Vec::new() };
    }

    fn spawn(
        &mut self,
        key: Key,
        built: Built,
        commands: &mut Commands,
        surfaces: &Query<Surface>,
    ) {
        let Some(chunk) = self.grid.chunks.get_mut(&key) else {
            return;
        };
        let Built {
            shape,
            base_m,
            level,
        } = built;
        let collider = TerrainCollider {
            terrain: self.terrain,
            rect: chunk.place.rect,
            level,
            translation: chunk.place.translation(base_m),
        };
        let mut entity = commands.spawn_empty();
        if let Ok(surface) = surfaces.get(self.terrain) {
            take_surface(&mut entity, surface);
        }
        let entity = entity.id();
        commands.queue(move |world: &mut World| {
            // A terrain that was despawned in this very step takes no more colliders.
            if world.get_entity(collider.terrain).is_err() {
                world.despawn(entity);
            } else if let Ok(mut entity) = world.get_entity_mut(entity) {
                entity.insert((
                    ChildOf(collider.terrain),
                    Transform::from_translation(collider.translation),
                    RigidBody::Static,
                    Collider::from(shape),
                    collider,
                ));
            }
        });
        chunk.stage = Stage::Made(entity, level, base_m);
        if level > 0 {
            self.grid.coarse.insert(key);
        }
    }

    fn build_now(&mut self, key: Key, commands: &mut Commands, surfaces: &Query<Surface>) {
        let Some(chunk) = self.grid.chunks.get(&key) else {
            return;
        };
        let Some(ground) = Ground::under(&chunk.place, self.state) else {
            return;
        };
        *self.builds = self.builds.saturating_sub(1);
        let built = Built::of(&ground, &chunk.place);
        self.spawn(key, built, commands, surfaces);
    }

    /// Takes the shapes that have been made.
    fn finish_builds(&mut self, commands: &mut Commands, surfaces: &Query<Surface>) {
        let mut finished = Vec::new();
        for (&key, chunk) in &mut self.grid.chunks {
            if let Stage::Building(task, is_outdated) = &mut chunk.stage
                && task.is_finished()
                && let Some(built) = block_on(future::poll_once(task))
            {
                let built = if *is_outdated {
                    Ground::under(&chunk.place, self.state)
                        .map(|ground| Built::of(&ground, &chunk.place))
                } else {
                    Some(built)
                };
                finished.push((key, built));
            }
        }
        for (key, built) in finished {
            if let Some(built) = built {
                self.spawn(key, built, commands, surfaces);
            } else if let Some(chunk) = self.grid.chunks.get_mut(&key) {
                chunk.stage = Stage::Waiting;
                self.grid.waiting.push_back(key);
            }
        }
    }

    /// Begins to make what is wanted, as much as a step may.
    fn begin_builds(&mut self, commands: &mut Commands, surfaces: &Query<Surface>) {
        for _ in 0..self.grid.waiting.len() {
            if *self.builds == 0 {
                return;
            }
            let Some(key) = self.grid.waiting.pop_front() else {
                return;
            };
            let Some(chunk) = self.grid.chunks.get_mut(&key) else {
                continue;
            };
            if !matches!(chunk.stage, Stage::Waiting) {
                continue;
            }
            let Some(ground) = Ground::under(&chunk.place, self.state) else {
                self.grid.waiting.push_back(key);
                continue;
            };
            let Some(pool) = AsyncComputeTaskPool::try_get() else {
                self.build_now(key, commands, surfaces);
                continue;
            };
            let place = chunk.place;
            let task = pool.spawn(async move { Built::of(&ground, &place) });
            chunk.stage = Stage::Building(task, false);
            *self.builds -= 1;
        }
    }

    /// Rewrites what edits have changed, all of it, and what follows from tiles that have come or
    /// gone, as much as a step may.
    fn follow_changes(
        &mut self,
        colliders: &mut Query<(&'static mut Collider, &'static mut TerrainCollider)>,
    ) -> Vec<Change> {
        let mut changes = Vec::new();
        let dirty = std::mem::take(&mut self.grid.dirty);
        for (key, rect) in dirty {
            changes.extend(self.rewrite(key, Some(rect), colliders));
        }
        while *self.builds > 0
            && let Some(key) = self.grid.stale.pop_front()
        {
            let Some(chunk) = self.grid.chunks.get_mut(&key) else {
                continue;
            };
            if std::mem::take(&mut chunk.is_stale) {
                *self.builds -= 1;
                changes.extend(self.rewrite(key, None, colliders));
            }
        }
        changes
    }

    /// Rewrites a collider's heights, all of them where no rectangle is given.
    fn rewrite(
        &mut self,
        key: Key,
        rect: Option<SampleRect>,
        colliders: &mut Query<(&'static mut Collider, &'static mut TerrainCollider)>,
    ) -> Option<Change> {
        let chunk = self.grid.chunks.get_mut(&key)?;
        let Stage::Made(entity, level, base_m) = chunk.stage else {
            return None;
        };
        let Ok((mut collider, mut described)) = colliders.get_mut(entity) else {
            return None;
        };
        let place = chunk.place;
        let ground = Ground::under(&place, self.state)?;
        let old = collider.shape().clone();
        let field = old.as_heightfield()?;
        let same = ground.address.level == level;
        if !same {
            let level = ground.address.level;
            chunk.stage = Stage::Made(entity, level, base_m);
            described.level = level;
            if level > 0 {
                self.grid.coarse.insert(key);
            } else {
                self.grid.coarse.remove(&key);
            }
        }
        let (new, rect) = match rect.filter(|_| same) {
            Some(rect) => (ground.changed_shape(&place, base_m, field, rect), rect),
            None => {
                let new = ground.shape(&place, base_m);
                // Bodies beside what has changed are left alone.
                let rect = place.difference(field, new.as_heightfield()?)?;
                (new, rect)
            }
        };
        collider.set_shape(new.clone());
        let spacing_m = self.grid.manifest.file.spacing_m;
        // Triangles reach a sample further than the samples that have changed.
        let around = rect.grown(1);
        let corner = |at: [i32; 2]| Vec2::from(at.map(|at| (f64::from(at) * spacing_m) as f32));
        Some(Change {
            place,
            min_m: corner(around.min),
            max_m: corner(around.max.map(|end| end - 1)),
            base_m,
            old,
            new,
        })
    }

    /// Removes what nobody has wanted for some time; says how many.
    fn drop_unwanted(&mut self, commands: &mut Commands) -> usize {
        let before = self.grid.chunks.len();
        let (now_s, keeps) = (self.now_s, self.settings.keep_resident);
        let Grid {
            chunks,
            tiles,
            coarse,
            cells,
            ..
        } = &mut *self.grid;
        chunks.retain(|&key, chunk| {
            let by_body = chunk.until_s >= now_s;
            if chunk.is_keeping && !(by_body && keeps) {
                chunk.is_keeping = false;
                let tile = key.map(|at| at * *cells / TILE_SAMPLES);
                if let Some((pin, count)) = tiles.get_mut(&tile) {
                    *count -= 1;
                    if *count == 0 {
                        commands.entity(*pin).try_despawn();
                        tiles.remove(&tile);
                    }
                }
            }
            let stays = by_body || chunk.is_pinned;
            if !stays {
                coarse.remove(&key);
                if let Stage::Made(entity, ..) = chunk.stage {
                    commands.entity(entity).try_despawn();
                }
            }
            stays
        });
        let lapsed = before - self.grid.chunks.len();
        if lapsed > 0 {
            let Grid {
                chunks,
                waiting,
                stale,
                ..
            } = &mut *self.grid;
            waiting.retain(|key| chunks.contains_key(key));
            stale.retain(|key| chunks.contains_key(key));
        }
        lapsed
    }
}

/// Wakes the bodies over ground that has changed, and lifts those that it has passed on its way up.
fn move_bodies(
    bodies: &[Body],
    changes: &[Change],
    [to_world, to_local]: [Affine3A; 2],
    lift: bool,
    lifts: &mut HashMap<Entity, Vec3>,
    commands: &mut Commands,
) {
    for body in bodies {
        let own = body.within(&to_local);
        let (low, high) = ((own.centre - own.half).xz(), (own.centre + own.half).xz());
        let mut rise = 0.0_f32;
        let mut is_near = false;
        for change in changes {
            if !(low.cmple(change.max_m).all() && high.cmpge(change.min_m).all()) {
                continue;
            }
            is_near |= change.reaches(&own);
            if lift && body.is_dynamic {
                rise = rise.max(change.rise_under(&own));
            }
        }
        if is_near && body.is_sleeping {
            let wake = WakeBody(body.entity);
            commands.queue_silenced(wake);
        }
        if rise > 0.0 {
            let up = to_world.transform_vector3(Vec3::Y * rise);
            let known = lifts.entry(body.entity).or_insert(up);
            if known.length_squared() < up.length_squared() {
                *known = up;
            }
        }
    }
}

impl Change {
    /// Whether a body over the change may touch the ground as it was or as it is.
    fn reaches(&self, body: &LocalBox) -> bool {
        let tops = [&self.old, &self.new]
            .into_iter()
            .filter_map(|shape| shape.as_heightfield())
            .map(|field| field.root_aabb().maxs.y);
        let top = tops.fold(f32::NEG_INFINITY, f32::max) + self.base_m;
        // Bodies rest a little above what they rest on.
        body.centre.y - body.half.y <= top + 0.5
    }

    /// How far a body has to rise that was above the ground, so as to be again.
    fn rise_under(&self, body: &LocalBox) -> f32 {
        let at = self.place.inside(body.centre.xz().as_dvec2());
        let heights = at.and_then(|at| {
            let old = height_at(self.old.as_heightfield()?, at);
            let new = height_at(self.new.as_heightfield()?, at);
            Some((old + self.base_m, new + self.base_m))
        });
        let Some((old, new)) = heights else {
            return 0.0;
        };
        if body.centre.y < old {
            return 0.0;
        }
        let bottom = body.centre.y - body.half.y;
        (new - bottom).min(new - old).max(0.0)
    }
}
