//! Colliders come and go with terrains, bodies and pins, odd ones too.

use super::*;

#[test]
fn terrains_come_and_go_with_all_that_is_theirs() {
    let mut world = plains();
    let first = spawn_ready(&mut world, ());
    let second = spawn_ready(&mut world, Transform::from_xyz(0.0, 50.0, 5000.0));
    let bodies = [0.0, 5000.0].map(|z| {
        let height = if z > 0.0 { 150.0 } else { 100.0 };
        ball(&mut world, Vec3::new(600.0, height + 1.0, z + 400.0))
    });
    frames(&mut world, 60);
    assert!((place_of(&world, bodies[1]).y - 150.5).abs() < 0.05);
    let of = |world: &mut World3, terrain: Entity| {
        let all = colliders(world);
        all.iter().filter(|(_, own)| own.terrain == terrain).count()
    };
    assert!(of(&mut world, first) > 0 && of(&mut world, second) > 0);
    world.app.world_mut().despawn(first);
    frames(&mut world, 3);
    assert_eq!(of(&mut world, first), 0);
    assert!(of(&mut world, second) > 0);
    let app = world.app.world_mut();
    let mut pins = app.query_filtered::<&TerrainPin, With<TerrainBodyPin>>();
    assert!(pins.iter(app).all(|pin| pin.terrain == second));
    // The component alone goes; the entity stays.
    app.entity_mut(second).remove::<Terrain>();
    frames(&mut world, 3);
    assert!(colliders(&mut world).is_empty());
    let app = world.app.world_mut();
    let mut pins = app.query::<&TerrainPin>();
    assert_eq!(pins.iter(app).count(), 0);
    for body in bodies {
        app.despawn(body);
    }
    // What somebody despawns that is wanted comes back.
    let third = spawn_ready(&mut world, ());
    let body = ball(&mut world, IN_SQUARE.with_y(PLAIN_M + 0.6));
    frames(&mut world, 10);
    for (entity, _) in colliders(&mut world) {
        world.app.world_mut().despawn(entity);
    }
    frames(&mut world, 5);
    assert!(of(&mut world, third) > 0);
    frames(&mut world, 60);
    assert!((place_of(&world, body).y - PLAIN_M - 0.5).abs() < 0.1);
}

#[test]
fn odd_bodies_and_pins_do_no_harm() {
    let mut world = plains();
    world.app.insert_resource(TerrainPhysics {
        max_colliders: 100,
        ..default()
    });
    let terrain = spawn_ready(&mut world, ());
    let giant = (
        RigidBody::Kinematic,
        Collider::cuboid(1e6, 10.0, 1e6),
        CollisionLayers::NONE,
        Transform::from_xyz(0.0, PLAIN_M + 8.0, 0.0),
    );
    let bullet = (
        RigidBody::Kinematic,
        Collider::sphere(0.1),
        LinearVelocity(Vec3::splat(1e12)),
        Transform::from_xyz(300.0, PLAIN_M, 300.0),
    );
    let bare = (RigidBody::Dynamic, Transform::from_xyz(300.0, 300.0, 300.0));
    let zone = (
        RigidBody::Dynamic,
        GravityScale(0.0),
        Collider::cuboid(5e3, 5e3, 5e3),
        Sensor,
        CollisionLayers::NONE,
        Transform::from_xyz(300.0, 300.0, 300.0),
    );
    let app = world.app.world_mut();
    app.spawn(giant);
    app.spawn(bullet);
    app.spawn(bare);
    app.spawn(zone);
    for region in [
        TerrainRegion::EVERYTHING,
        TerrainRegion::around(Vec2::NAN, 1.0),
        TerrainRegion::around(Vec2::splat(1e30), 1.0),
        TerrainRegion::around(Vec2::ZERO, -1.0),
        TerrainRegion::around(Vec2::splat(-5.0), 5.0),
    ] {
        pin(&mut world, terrain, region);
    }
    frames(&mut world, 30);
    for rect in [
        SampleRect::new([i32::MIN; 2], [i32::MAX; 2]),
        SampleRect::new([5; 2], [5; 2]),
        SampleRect::new([-9; 2], [0; 2]),
        SampleRect::new([SIZE[0] as i32; 2], [i32::MAX; 2]),
    ] {
        edited(&mut world, terrain, rect);
        world.frame();
    }
    let all = world.app.world().resource::<TerrainColliders>();
    assert_eq!(all.wanted(), 11 * 8, "the whole terrain");
    world.app.insert_resource(TerrainPhysics {
        max_colliders: 20,
        chunk_cells: 32,
        ..default()
    });
    frames(&mut world, 30);
    let all = world.app.world().resource::<TerrainColliders>();
    assert_eq!(all.wanted(), 20);
    assert_eq!(logged("max_colliders allows").len(), 1, "said once");
    let mut scale = world
        .app
        .world_mut()
        .get_mut::<Transform>(terrain)
        .expect("it");
    scale.scale = Vec3::ZERO;
    frames(&mut world, 3);
}

#[test]
fn a_terrain_hands_its_surface_to_its_colliders() {
    let mut world = plains();
    let extra = (Friction::new(0.25), CollisionLayers::from_bits(2, 4));
    let terrain = spawn_ready(&mut world, extra);
    ball(&mut world, IN_SQUARE.with_y(PLAIN_M + 1.0));
    frames(&mut world, 10);
    let surfaces = |world: &mut World3| {
        let app = world.app.world_mut();
        let mut found =
            app.query_filtered::<(&Friction, &CollisionLayers), With<TerrainCollider>>();
        found.iter(app).map(|(&f, &l)| (f, l)).collect::<Vec<_>>()
    };
    let found = surfaces(&mut world);
    assert!(!found.is_empty());
    let layers = CollisionLayers::from_bits(2, 4);
    assert!(
        found
            .iter()
            .all(|&own| own == (Friction::new(0.25), layers))
    );
    let mut friction = world
        .app
        .world_mut()
        .get_mut::<Friction>(terrain)
        .expect("it");
    *friction = Friction::new(0.75);
    frames(&mut world, 2);
    let found = surfaces(&mut world);
    assert!(
        found
            .iter()
            .all(|&own| own == (Friction::new(0.75), layers))
    );
}

#[test]
fn without_physics_nothing_is_done() {
    let mut world = World3::in_app(SIZE, false, |app, _| {
        app.add_plugins(TerrainPhysicsPlugin::default());
    });
    let terrain = spawn_ready(&mut world, ());
    world.app.world_mut().spawn((
        RigidBody::Dynamic,
        Collider::sphere(0.5),
        Transform::from_xyz(600.0, 100.0, 400.0),
    ));
    pin(&mut world, terrain, TerrainRegion::EVERYTHING);
    edited(&mut world, terrain, SQUARE);
    frames(&mut world, 20);
    assert!(colliders(&mut world).is_empty());
}
