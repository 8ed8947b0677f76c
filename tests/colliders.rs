//! Bodies stand on the ground, wherever they go, however it changes under them.

#[path = "colliders/life.rs"]
mod life;
mod streaming_support;

use avian3d::prelude::*;
use bevy::math::{Affine3A, DVec2};
use bevy::prelude::*;
use bevy::time::Fixed;
use bevy_tessera::edit::{SampleRect, TerrainEdited};
use bevy_tessera::physics::{
    TerrainBodyPin, TerrainCollider, TerrainColliderPin, TerrainColliders, TerrainPhysics,
    TerrainPhysicsPlugin,
};
use bevy_tessera::query::TerrainQuery;
use bevy_tessera::stream::{TerrainPin, TerrainRegion, TileData};
use bevy_tessera::terrain::Terrain;
use bevy_tessera::tile::{TILE_SAMPLES, TerrainTile, TileAddress};
use std::time::Duration;
use streaming_support::{World3, logged, stored_height, write_terrain_of};

/// Neither a multiple of a tile's samples, nor of a collider's.
const SIZE: [u32; 2] = [700, 450];
/// Metres a sample, and a quantum of height.
const SPACING_M: f64 = 2.0;
const QUANTUM_M: f64 = 0.01;
/// Where the level ground of [`plain`] lies.
const PLAIN_M: f32 = 100.0;

/// Level ground at 100 m, but for a peak and a pit in each tile, so that its range of heights leaves
/// room for changes.
fn plain(x: u32, z: u32) -> u16 {
    match (x % TILE_SAMPLES, z % TILE_SAMPLES) {
        (5, 5) => 40_000,
        (5, 9) => 0,
        _ => 20_000,
    }
}

fn add_physics(app: &mut App) {
    // One physics step a frame.
    app.insert_resource(Time::<Fixed>::from_duration(Duration::from_millis(16)))
        .add_plugins((PhysicsPlugins::default(), TerrainPhysicsPlugin::default()));
}

/// A world with bodies, over the waves of [`stored_height`].
fn hills() -> World3 {
    World3::in_app(SIZE, false, |app, _| add_physics(app))
}

/// The same, over [`plain`].
fn plains() -> World3 {
    let world = hills();
    write_terrain_of(&world.dir.path().join("alps"), SIZE, QUANTUM_M, &plain);
    world
}

fn spawn_ready(world: &mut World3, extra: impl Bundle) -> Entity {
    let before = world.told().ready.len();
    let terrain = world.spawn(extra);
    world.run_until("ready", |world| {
        world.resource::<streaming_support::Told>().ready.len() > before
    });
    terrain
}

fn ball(world: &mut World3, at: Vec3) -> Entity {
    let body = (
        RigidBody::Dynamic,
        Collider::sphere(0.5),
        Transform::from_translation(at),
    );
    world.app.world_mut().spawn(body).id()
}

fn place_of(world: &World3, body: Entity) -> Vec3 {
    world.app.world().get::<Position>(body).expect("a body").0
}

fn pin(world: &mut World3, terrain: Entity, region: TerrainRegion) -> Entity {
    let pin = (Terrain::wait_for(terrain, region), TerrainColliderPin);
    world.app.world_mut().spawn(pin).id()
}

fn covered(world: &World, terrain: Entity, region: TerrainRegion) -> bool {
    let all = world.resource::<TerrainColliders>();
    all.covers(terrain, region) && levels(world).iter().all(|&level| level == 0)
}

fn levels(world: &World) -> Vec<u8> {
    let mut found = world.try_query::<&TerrainCollider>().expect("known");
    found.iter(world).map(|collider| collider.level).collect()
}

fn colliders(world: &mut World3) -> Vec<(Entity, TerrainCollider)> {
    let world = world.app.world_mut();
    let mut found = world.query::<(Entity, &TerrainCollider)>();
    found.iter(world).map(|(at, &own)| (at, own)).collect()
}

fn frames(world: &mut World3, count: usize) {
    for _ in 0..count {
        world.frame();
        // Colliders are made in the background, in time that a frame of a test doesn't take.
        let all = world.app.world().get_resource::<TerrainColliders>();
        if all.is_some_and(|all| all.made() < all.wanted()) {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
}

/// The corners of a collider's cells in the world, by sample of level 0.
fn corners(world: &World, collider: Entity) -> Vec<([u32; 2], Vec3)> {
    let described = world.get::<TerrainCollider>(collider).expect("a collider");
    let shape = world.get::<Collider>(collider).expect("a shape");
    let field = shape.shape_scaled().as_heightfield().expect("heights");
    let place = world.get::<Position>(collider).expect("a place").0;
    let turn = world.get::<Rotation>(collider).expect("a rotation").0;
    let (heights, scale) = (field.heights(), field.scale());
    let mut corners = Vec::new();
    for row in 0..heights.nrows() {
        for column in 0..heights.ncols() {
            let along = Vec3::new(
                column as f32 / (heights.ncols() - 1) as f32 - 0.5,
                heights[(row, column)],
                row as f32 / (heights.nrows() - 1) as f32 - 0.5,
            );
            let sample = [column, row].map(|at| at as u32);
            let first = described.rect.min.map(|at| at as u32);
            corners.push((
                [sample[0] + first[0], sample[1] + first[1]],
                place + turn * (along * scale),
            ));
        }
    }
    let [columns, rows] = described.rect.size();
    assert_eq!(
        (columns, rows),
        (heights.ncols(), heights.nrows()),
        "it says which samples it holds"
    );
    corners
}

/// Checks all colliders of level 0 against stored heights.
fn check(world: &mut World3, terrain: Entity, affine: Affine3A, stored: &dyn Fn(u32, u32) -> u16) {
    let file = world.state(terrain).manifest().file.clone();
    let mut checked = 0;
    let scale = affine.matrix3.x_axis.length();
    for (entity, own) in colliders(world) {
        if own.terrain != terrain {
            continue;
        }
        assert_eq!(own.level, 0);
        for ([x, z], found) in corners(world.app.world(), entity) {
            let height_m = file.height_m(stored(x, z));
            let at = [f64::from(x) * SPACING_M, height_m, f64::from(z) * SPACING_M];
            let wanted = affine.transform_point3(Vec3::from(at.map(|at| at as f32)));
            assert!(
                found.distance(wanted) < 0.5 * QUANTUM_M as f32 * scale,
                "sample ({x}, {z}) is {found} and not {wanted}"
            );
            checked += 1;
        }
    }
    assert!(checked > 1000, "{checked}");
}

/// Rewrites the heights of resident tiles in place, as a file that has changed does.
fn rewrite(world: &mut World3, terrain: Entity, new: &dyn Fn(u32, u32) -> Option<u16>) {
    let app = world.app.world_mut();
    let mut tiles = app.query::<(&TileAddress, &TileData, &bevy_tessera::stream::TileOf)>();
    let found: Vec<_> = tiles
        .iter(app)
        .filter(|(.., of)| of.0 == terrain)
        .map(|(&address, data, _)| (address, data.0.id()))
        .collect();
    let mut assets = app.resource_mut::<Assets<TerrainTile>>();
    for (address, id) in found {
        let mut tile = assets.get(id).expect("it is resident").clone();
        let (first_x, first_z) = address.first_sample();
        let mut has_changed = false;
        for (at, sample) in tile.heights.samples_mut().iter_mut().enumerate() {
            let at = at as u32;
            let along = |first: u32, at: u32, last: u32| {
                (((first + at).saturating_sub(2)) << address.level).min(last)
            };
            let x = along(first_x, at % 133, SIZE[0] - 1);
            let z = along(first_z, at / 133, SIZE[1] - 1);
            if let Some(new) = new(x, z) {
                has_changed |= *sample != new;
                *sample = new;
            }
        }
        if has_changed {
            *assets.get_mut(id).expect("it is resident") = tile;
        }
    }
}

fn edited(world: &mut World3, terrain: Entity, rect: SampleRect) {
    let metres = |at: [i32; 2]| Vec2::from(at.map(|at| at as f32 * SPACING_M as f32));
    world.app.world_mut().trigger(TerrainEdited {
        entity: terrain,
        sequence: 0,
        rect,
        region: TerrainRegion {
            min_m: metres(rect.min),
            max_m: metres(rect.max),
        },
        clamped: false,
    });
}

/// A square of samples around the place where balls lie in these tests.
const SQUARE: SampleRect = SampleRect::new([280, 180], [321, 221]);
const IN_SQUARE: Vec3 = Vec3::new(600.0, PLAIN_M, 400.0);

fn in_square(height: u16) -> impl Fn(u32, u32) -> Option<u16> {
    move |x, z| {
        let is_inside = (SQUARE.min[0]..SQUARE.max[0]).contains(&(x as i32))
            && (SQUARE.min[1]..SQUARE.max[1]).contains(&(z as i32));
        (is_inside && plain(x, z) == 20_000).then_some(height)
    }
}

#[test]
fn a_ball_falls_and_rests_on_the_ground_which_it_keeps_resident() {
    let mut world = plains();
    let terrain = spawn_ready(&mut world, ());
    let body = ball(&mut world, IN_SQUARE.with_y(PLAIN_M + 6.0));
    world.run_until("at rest", |world| world.get::<Sleeping>(body).is_some());
    let at = place_of(&world, body);
    assert!((at.y - (PLAIN_M + 0.5)).abs() < 0.02, "{at}");
    // It stays on the ground for as long as it sleeps.
    frames(&mut world, 300);
    assert_eq!(place_of(&world, body), at);
    // No camera looks, and yet the finest tile is there.
    let found = levels(world.app.world());
    assert!(
        !found.is_empty() && found.iter().all(|&level| level == 0),
        "{found:?}"
    );
    let all = world.app.world().resource::<TerrainColliders>();
    let under = all.under(terrain, at.xz()).expect("what it lies on");
    assert!(world.app.world().get::<RigidBody>(under) == Some(&RigidBody::Static));
    assert!(all.made() <= 4, "a small body has few: {}", all.made());
    assert_eq!(all.made(), all.wanted());
}

#[test]
fn colliders_hold_the_stored_heights_to_less_than_a_quantum() {
    let mut world = hills();
    let terrain = spawn_ready(&mut world, ());
    let everything = TerrainRegion::EVERYTHING;
    pin(&mut world, terrain, everything);
    world.run_until("covered", |world| covered(world, terrain, everything));
    let count = [0, 1].map(|axis| (SIZE[axis] - 1).div_ceil(64) as usize);
    assert_eq!(colliders(&mut world).len(), count[0] * count[1]);
    check(&mut world, terrain, Affine3A::IDENTITY, &stored_height);
    for chunk_cells in [16, 128] {
        world.app.insert_resource(TerrainPhysics {
            chunk_cells,
            ..default()
        });
        frames(&mut world, 2);
        world.run_until("covered again", |world| covered(world, terrain, everything));
        let count = [0, 1].map(|axis| (SIZE[axis] - 1).div_ceil(chunk_cells) as usize);
        assert_eq!(colliders(&mut world).len(), count[0] * count[1]);
        check(&mut world, terrain, Affine3A::IDENTITY, &stored_height);
    }
}

#[test]
fn between_samples_the_diagonal_runs_from_least_x_and_greatest_z() {
    let mut world = hills();
    let terrain = spawn_ready(&mut world, ());
    let region = TerrainRegion::around(Vec2::new(600.0, 400.0), 100.0);
    pin(&mut world, terrain, region);
    world.run_until("covered", |world| covered(world, terrain, region));
    frames(&mut world, 3);
    let mut rays =
        bevy::ecs::system::SystemState::<(SpatialQuery, TerrainQuery)>::new(world.app.world_mut());
    let (rays, ground) = rays.get(world.app.world()).expect("valid");
    let mut off = 0.0_f64;
    for n in 0..2000_u32 {
        let part = |salt: u32| f64::from((n * salt) % 1009) / 1009.0;
        let sample = DVec2::new(260.0 + 80.0 * part(331), 160.0 + 80.0 * part(577));
        let (cell, part) = (sample.floor(), sample.fract());
        let h = |dx: f64, dz: f64| {
            let stored = stored_height((cell.x + dx) as u32, (cell.y + dz) as u32);
            -100.0 + f64::from(stored) * QUANTUM_M
        };
        let (h00, h10, h01, h11) = (h(0.0, 0.0), h(1.0, 0.0), h(0.0, 1.0), h(1.0, 1.0));
        let wanted = if part.x + part.y <= 1.0 {
            h00 + (h10 - h00) * part.x + (h01 - h00) * part.y
        } else {
            h11 + (h01 - h11) * (1.0 - part.x) + (h10 - h11) * (1.0 - part.y)
        };
        let at = (sample * SPACING_M).as_vec2();
        let hit = rays
            .cast_ray(
                Vec3::new(at.x, 400.0, at.y),
                Dir3::NEG_Y,
                1000.0,
                false,
                &SpatialQueryFilter::default(),
            )
            .expect("ground");
        let found = 400.0 - f64::from(hit.distance);
        assert!((found - wanted).abs() < 1e-3, "{sample}: {found}, {wanted}");
        let bilinear = ground.height(terrain, sample * SPACING_M).expect("ground");
        let bound = (h00 - h10 - h01 + h11).abs() / 4.0;
        assert!((found - bilinear.height_m).abs() < bound + 1e-3);
        off = off.max((found - bilinear.height_m).abs());
    }
    assert!(off > 0.002, "the bound has been tried: {off}");
}

#[test]
fn colliders_go_some_time_after_the_last_body() {
    let mut world = plains();
    world.app.insert_resource(TerrainPhysics {
        keep_s: 0.5,
        ..default()
    });
    let terrain = spawn_ready(&mut world, ());
    let body = ball(&mut world, IN_SQUARE.with_y(PLAIN_M + 1.0));
    frames(&mut world, 10);
    let before = colliders(&mut world);
    assert!(!before.is_empty());
    // It is moved away.
    let mut position = world.app.world_mut().get_mut::<Position>(body).expect("it");
    position.0 = Vec3::new(100.0, PLAIN_M + 1.0, 100.0);
    frames(&mut world, 10);
    let there = |world: &mut World3| {
        let now = colliders(world);
        before.iter().filter(|old| now.contains(old)).count()
    };
    assert_eq!(there(&mut world), before.len(), "it might come back");
    frames(&mut world, 40);
    assert_eq!(there(&mut world), 0);
    assert!(!colliders(&mut world).is_empty());
    world.app.world_mut().despawn(body);
    frames(&mut world, 40);
    assert!(colliders(&mut world).is_empty());
    let all = world.app.world().resource::<TerrainColliders>();
    assert_eq!((all.made(), all.wanted()), (0, 0));
    let app = world.app.world_mut();
    let mut pins = app.query::<&TerrainPin>();
    assert_eq!(pins.iter(app).count(), 0, "no tile is kept any more");
    // High above the ground a body needs none, until it comes down.
    let body = ball(&mut world, IN_SQUARE.with_y(PLAIN_M + 2000.0));
    frames(&mut world, 20);
    assert!(colliders(&mut world).is_empty());
    let mut fast = world
        .app
        .world_mut()
        .get_mut::<LinearVelocity>(body)
        .expect("it");
    fast.0 = Vec3::new(0.0, -2000.0, 0.0);
    frames(&mut world, 10);
    assert!(!colliders(&mut world).is_empty(), "it is expected");
    let _ = terrain;
}

#[test]
fn what_moves_fast_finds_ground_wherever_it_comes_down() {
    let mut world = plains();
    let terrain = spawn_ready(&mut world, ());
    let body = ball(&mut world, Vec3::new(100.0, PLAIN_M + 12.0, 300.0));
    let velocity = Vec3::new(300.0, 0.0, 20.0);
    world
        .app
        .world_mut()
        .entity_mut(body)
        .insert(LinearVelocity(velocity));
    for frame in 0..240 {
        world.frame();
        let at = place_of(&world, body);
        let soon = at + 0.5 * velocity;
        if soon.x > 1390.0 {
            return;
        }
        assert!(at.y > PLAIN_M, "{at}");
        let all = world.app.world().resource::<TerrainColliders>();
        if frame > 5 {
            assert!(all.under(terrain, soon.xz()).is_some(), "{at}");
        }
        // Whatever it has bounced off, it goes on.
        world
            .app
            .world_mut()
            .entity_mut(body)
            .insert(LinearVelocity(velocity));
    }
}

#[test]
fn a_pinned_region_has_colliders_without_bodies_and_loses_them_with_its_pin() {
    let mut world = plains();
    let terrain = spawn_ready(&mut world, ());
    let region = TerrainRegion::around(Vec2::new(700.0, 300.0), 130.0);
    let pin = pin(&mut world, terrain, region);
    world.run_until("covered", |world| covered(world, terrain, region));
    check(&mut world, terrain, Affine3A::IDENTITY, &plain);
    frames(&mut world, 400);
    assert!(covered(world.app.world(), terrain, region), "they stay");
    world.app.world_mut().despawn(pin);
    frames(&mut world, 400);
    assert!(colliders(&mut world).is_empty());
}

#[test]
fn the_ground_ends_at_the_rim() {
    let mut world = plains();
    let terrain = spawn_ready(&mut world, ());
    let rim = SIZE.map(|samples| (samples - 1) as f32 * SPACING_M as f32);
    let kept = ball(
        &mut world,
        Vec3::new(rim[0] - 1.0, PLAIN_M + 1.0, rim[1] - 1.0),
    );
    let lost = [
        ball(&mut world, Vec3::new(rim[0] + 1.0, PLAIN_M + 1.0, 400.0)),
        ball(&mut world, Vec3::new(600.0, PLAIN_M + 1.0, rim[1] + 1.0)),
        ball(&mut world, Vec3::new(-1.0, PLAIN_M + 1.0, 400.0)),
        ball(&mut world, Vec3::new(600.0, PLAIN_M + 1.0, -1.0)),
    ];
    frames(&mut world, 200);
    assert!((place_of(&world, kept).y - PLAIN_M - 0.5).abs() < 0.05);
    for body in lost {
        assert!(place_of(&world, body).y < PLAIN_M - 20.0);
    }
    for (entity, own) in colliders(&mut world) {
        assert!((0..2).all(|axis| own.rect.max[axis] <= SIZE[axis] as i32));
        for (_, at) in corners(world.app.world(), entity) {
            assert!(at.x <= rim[0] + 1e-3 && at.z <= rim[1] + 1e-3);
        }
    }
    let _ = terrain;
}

#[test]
fn colliders_follow_a_terrain_that_is_moved_turned_and_scaled() {
    let mut world = hills();
    let first = Transform::from_xyz(-3000.0, 250.0, 800.0)
        .with_rotation(Quat::from_euler(EulerRot::XYZ, 0.1, 1.3, -0.2))
        .with_scale(Vec3::splat(0.5));
    let terrain = spawn_ready(&mut world, first);
    let region = TerrainRegion::around(Vec2::new(600.0, 400.0), 150.0);
    pin(&mut world, terrain, region);
    world.run_until("covered", |world| covered(world, terrain, region));
    frames(&mut world, 2);
    check(&mut world, terrain, first.compute_affine(), &stored_height);
    // Again and again, so that what is rounded would add up.
    let mut last = first;
    for n in 0..300 {
        last.rotation *= Quat::from_rotation_y(0.01);
        last.translation += Vec3::new(1.7, -0.3, 0.9);
        last.scale = Vec3::splat(0.5 + 0.005 * n as f32);
        *world.app.world_mut().get_mut(terrain).expect("it") = last;
        world.frame();
    }
    frames(&mut world, 2);
    check(&mut world, terrain, last.compute_affine(), &stored_height);
    // And a body rests on it, scaled by 2 and askew as it is.
    let at = Vec3::new(600.0, 0.0, 400.0);
    let ground = world
        .state(terrain)
        .height(at.xz().as_dvec2())
        .expect("ground");
    let up = last.rotation * Vec3::Y;
    let at = last.transform_point(at.with_y(ground.height_m as f32)) + up * 1.0;
    world.app.insert_resource(Gravity(-9.81 * up));
    let body = (
        RigidBody::Dynamic,
        Collider::cuboid(1.0, 1.0, 1.0),
        Transform::from_translation(at).with_rotation(last.rotation),
        Friction::new(10.0),
    );
    let body = world.app.world_mut().spawn(body).id();
    frames(&mut world, 120);
    let to_local = last.compute_affine().inverse();
    let found = to_local.transform_point3(place_of(&world, body));
    let ground = world
        .state(terrain)
        .height(found.xz().as_dvec2())
        .expect("ground");
    let above = (f64::from(found.y) - ground.height_m) * f64::from(last.scale.x);
    assert!((0.4..0.75).contains(&above), "{above} m above the ground");
}

#[test]
fn a_ball_at_rest_wakes_and_lands_where_its_ground_is_blown_away() {
    let mut world = plains();
    let terrain = spawn_ready(&mut world, ());
    let body = ball(&mut world, IN_SQUARE.with_y(PLAIN_M + 1.0));
    let far = ball(&mut world, IN_SQUARE.with_y(PLAIN_M + 1.0) + Vec3::X * 90.0);
    world.run_until("both at rest", |world| {
        [body, far]
            .iter()
            .all(|&body| world.get::<Sleeping>(body).is_some())
    });
    rewrite(&mut world, terrain, &in_square(19_000));
    edited(&mut world, terrain, SQUARE);
    // The state takes it over at the frame's end; then comes the first physics step.
    world.frame();
    edited(&mut world, terrain, SQUARE);
    world.frame();
    check(&mut world, terrain, Affine3A::IDENTITY, &|x, z| {
        in_square(19_000)(x, z).unwrap_or_else(|| plain(x, z))
    });
    assert!(world.app.world().get::<Sleeping>(body).is_none(), "awake");
    assert!(
        world.app.world().get::<Sleeping>(far).is_some(),
        "left alone"
    );
    world.run_until("at rest again", |world| {
        world.get::<Sleeping>(body).is_some()
    });
    let at = place_of(&world, body);
    assert!((at.y - (PLAIN_M - 10.0 + 0.5)).abs() < 0.05, "{at}");
}

#[test]
fn a_ball_rises_with_its_ground() {
    let mut world = plains();
    let terrain = spawn_ready(&mut world, ());
    let body = ball(&mut world, IN_SQUARE.with_y(PLAIN_M + 1.0));
    let high = ball(&mut world, IN_SQUARE.with_y(PLAIN_M + 60.0) + Vec3::X * 3.0);
    world
        .app
        .world_mut()
        .entity_mut(high)
        .insert(GravityScale(0.0));
    world.run_until("at rest", |world| world.get::<Sleeping>(body).is_some());
    let before = place_of(&world, high);
    rewrite(&mut world, terrain, &in_square(20_800));
    frames(&mut world, 3);
    let at = place_of(&world, body);
    assert!(at.y > PLAIN_M + 8.0, "{at}");
    assert_eq!(place_of(&world, high), before, "what is above stays");
    world.run_until("at rest again", |world| {
        world.get::<Sleeping>(body).is_some()
    });
    let at = place_of(&world, body);
    assert!((at.y - (PLAIN_M + 8.5)).abs() < 0.05, "{at}");
    // Who doesn't want it is told what happens then.
    world.app.insert_resource(TerrainPhysics {
        lift_bodies: false,
        ..default()
    });
    rewrite(&mut world, terrain, &in_square(22_000));
    frames(&mut world, 200);
    assert!(place_of(&world, body).y < PLAIN_M - 10.0);
}

#[test]
fn an_edit_is_in_all_colliders_it_touches_by_the_next_step_whatever_else_waits() {
    let mut world = plains();
    world.app.insert_resource(TerrainPhysics {
        builds_per_step: 1,
        ..default()
    });
    let terrain = spawn_ready(&mut world, ());
    let everything = TerrainRegion::EVERYTHING;
    pin(&mut world, terrain, everything);
    world.run_until("covered", |world| covered(world, terrain, everything));
    let new = |x: u32, z: u32| (plain(x, z) == 20_000).then_some(21_000);
    rewrite(&mut world, terrain, &new);
    // All tiles have been read again: that takes its time, a collider a step.
    world.frame();
    // On a corner where four colliders of four tiles meet.
    let rect = SampleRect::new([256, 128], [257, 129]);
    edited(&mut world, terrain, rect);
    world.frame();
    let mut found = Vec::new();
    for (entity, own) in colliders(&mut world) {
        for (sample, at) in corners(world.app.world(), entity) {
            if sample == [256, 128] {
                found.push((own.rect.min, at.y));
            }
        }
    }
    assert_eq!(found.len(), 4);
    assert!(
        found.iter().all(|(_, y)| (y - PLAIN_M - 10.0).abs() < 0.01),
        "{found:?}"
    );
    let all = colliders(&mut world).len();
    let stale = |world: &mut World3| {
        let found = colliders(world);
        let world = world.app.world();
        let is_stale = |entity: &Entity| {
            corners(world, *entity)
                .iter()
                .any(|([x, z], at)| plain(*x, *z) == 20_000 && (at.y - PLAIN_M - 10.0).abs() > 0.01)
        };
        found.iter().filter(|(entity, _)| is_stale(entity)).count()
    };
    assert!(stale(&mut world) >= all - 6, "the others wait");
    frames(&mut world, all + 1);
    assert_eq!(stale(&mut world), 0);
}

#[test]
fn coarse_ground_stands_in_until_the_finest_is_there() {
    let mut world = hills();
    world.app.insert_resource(TerrainPhysics {
        keep_resident: false,
        ..default()
    });
    let terrain = spawn_ready(&mut world, ());
    let at = DVec2::new(600.0, 400.0);
    let height = |world: &World3| world.state(terrain).height(at).expect("ground");
    let coarse = height(&world);
    assert!(coarse.level > 0);
    let spot = Vec3::new(600.0, coarse.height_m as f32 + 0.55, 400.0);
    let body = (
        RigidBody::Dynamic,
        Collider::sphere(0.5),
        Transform::from_translation(spot),
        LockedAxes::new().lock_translation_x().lock_translation_z(),
    );
    let body = world.app.world_mut().spawn(body).id();
    // The body falls until its collider has been made, however long that takes here.
    world.run_until("coarse", |world| !levels(world).is_empty());
    frames(&mut world, 60);
    let found = levels(world.app.world());
    assert!(
        !found.is_empty() && found.iter().all(|&level| level > 0),
        "{found:?}"
    );
    let stands = place_of(&world, body).y;
    assert!((stands - spot.y).abs() < 0.3, "{stands} on {coarse:?}");
    for (entity, _) in colliders(&mut world) {
        for ([x, z], at) in corners(world.app.world(), entity) {
            let place = DVec2::new(f64::from(x), f64::from(z)) * SPACING_M;
            let drawn = world.state(terrain).height(place).expect("ground").height_m;
            assert!(
                (f64::from(at.y) - drawn).abs() < 0.5 * QUANTUM_M,
                "({x}, {z})"
            );
        }
    }
    let region = TerrainRegion::around(at.as_vec2(), 60.0);
    let fine = world
        .app
        .world_mut()
        .spawn(Terrain::wait_for(terrain, region))
        .id();
    world.run_until("fine", |world| {
        let found = levels(world);
        !found.is_empty() && found.iter().all(|&level| level == 0)
    });
    check(&mut world, terrain, Affine3A::IDENTITY, &stored_height);
    frames(&mut world, 60);
    let (stands, ground) = (place_of(&world, body).y, height(&world).height_m);
    assert!(
        (f64::from(stands) - ground - 0.5).abs() < 0.3,
        "{stands} on {ground}"
    );
    let _ = fine;
}
