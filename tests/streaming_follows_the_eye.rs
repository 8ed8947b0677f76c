//! Tiles are resident where eyes are, never more than there are pages, and never without their
//! parents; and nothing is left of a terrain that is despawned.

mod streaming_support;

use bevy::log::Level;
use bevy::math::DVec3;
use bevy::prelude::*;
use bevy_tessera::stream::{
    PAGE_BYTES, TerrainState, TerrainStreamer, TerrainStreaming, TerrainTiles, TileBounds,
    TileData, TileOf, TilePage,
};
use bevy_tessera::terrain::{Terrain, TerrainCamera, TerrainManifest, TerrainSettings};
use bevy_tessera::tile::{TerrainTile, TileAddress};
use bevy_tessera::view::TerrainViews;
use streaming_support::{World3, logged, write_terrain};

const SIZE: [u32; 2] = [1800, 1400];
const LEAF_M: f32 = 256.0;

fn camera(x: f32, z: f32) -> (TerrainCamera, Transform) {
    (TerrainCamera::default(), Transform::from_xyz(x, 150.0, z))
}

fn leaf_at(x: f32, z: f32) -> TileAddress {
    TileAddress::new(0, (x / LEAF_M) as u32, (z / LEAF_M) as u32)
}

/// Reads the field at a place in metres.
fn level_at(state: &TerrainState, x: f64, z: f64) -> i32 {
    let (point, _) = state
        .lattice()
        .lattice_from_local(bevy::math::DVec2::new(x, z), 2.0);
    state.field().at(state.lattice().clamp(point))
}

#[test]
fn the_root_comes_first_and_detail_where_the_eye_is() {
    let mut world = World3::new(SIZE);
    let terrain = world.spawn(());
    world.app.world_mut().spawn(camera(500.0, 900.0));
    world.settle(terrain);

    let loaded = &world.told().loaded;
    assert_eq!(world.told().ready, [terrain]);
    assert_eq!(loaded[0], world.state(terrain).root());
    for (at, tile) in loaded.iter().enumerate().skip(1) {
        assert!(
            loaded[..at].contains(&tile.parent()),
            "{tile} before its parent"
        );
    }
    let state = world.state(terrain);
    assert!(state.pages().get(leaf_at(500.0, 900.0)).is_some());
    assert_eq!(level_at(state, 500.0, 900.0), 0);
    // The far corner is 3 km away and stays coarse.
    assert!(state.pages().get(TileAddress::new(0, 14, 0)).is_none());
    assert!(level_at(state, 3590.0, 10.0) >= 256);
    assert!(world.told().evicted.is_empty());
}

#[test]
fn tiles_can_be_queried() {
    let mut world = World3::new([400, 300]);
    let terrain = world.spawn(());
    world.app.world_mut().spawn(camera(100.0, 100.0));
    world.settle(terrain);
    let resident = world.state(terrain).resident_count();
    let world3 = &world;
    let world = world3.app.world();
    let tiles = world.get::<TerrainTiles>(terrain).expect("has tiles");
    assert_eq!(tiles.len(), resident);
    let mut pages = Vec::new();
    for tile in tiles.iter() {
        let get = world.entity(tile);
        let address = get.get::<TileAddress>().expect("address");
        let page = get.get::<TilePage>().expect("page");
        assert_eq!(get.get::<TileOf>(), Some(&TileOf(terrain)));
        assert_eq!(world3.state(terrain).pages().get(*address), Some(page.0));
        assert_eq!(world3.state(terrain).tile(*address), Some(tile));
        pages.push(page.0);
        let data = get.get::<TileData>().expect("data");
        let data = world.resource::<Assets<TerrainTile>>().get(&data.0);
        let data = data.expect("loaded");
        assert_eq!(data.densities.get(0, 0), 128);
        let bounds = get.get::<TileBounds>().expect("bounds");
        let range = data.heights.range();
        let metres = |stored: u16| -100.0 + 0.01 * f32::from(stored);
        assert!(bounds.min_m.y <= metres(range.min) + 1e-3);
        assert!(bounds.max_m.y >= metres(range.max) - 1e-3);
        let side = LEAF_M * f32::from(1_u16 << address.level);
        let corner = Vec2::new(address.x as f32, address.z as f32) * side;
        assert_eq!(bounds.min_m.xz(), corner);
        assert_eq!(
            bounds.max_m.xz(),
            (corner + side).min(Vec2::new(798.0, 598.0))
        );
    }
    pages.sort_unstable();
    pages.dedup();
    assert_eq!(pages.len(), resident, "no two tiles share a page");
}

#[test]
fn a_random_flight_with_few_pages_breaks_no_promise() {
    let mut world = World3::new(SIZE);
    let terrain = world.spawn(());
    world.app.insert_resource(TerrainStreaming {
        upload_bytes_per_frame: 3 * PAGE_BYTES,
        ..TerrainStreaming::with_pages(24)
    });
    let eye = world.app.world_mut().spawn(camera(100.0, 100.0)).id();
    let mut seed = 12_345_u32;
    let mut random = || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 8) as f32 / (1 << 24) as f32
    };
    world.run_until("ready", |world| {
        let state = world.get::<TerrainState>(terrain);
        state.is_some_and(TerrainState::is_ready)
    });
    let mut to = Vec3::ZERO;
    for frame in 0..1500 {
        if frame % 60 == 0 {
            to = Vec3::new(
                random() * 3600.0,
                80.0 + random() * 200.0,
                random() * 2800.0,
            );
        }
        let mut transform = world
            .app
            .world_mut()
            .get_mut::<Transform>(eye)
            .expect("eye");
        let here = transform.translation;
        // A jump now and then, else 1.5 km/s.
        transform.translation = if frame % 400 == 399 {
            to
        } else {
            here + (to - here).clamp_length_max(24.0)
        };
        world.frame();
        if frame % 8 == 0 {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
    }
    world.settle(terrain);
    let here = world
        .app
        .world()
        .get::<Transform>(eye)
        .expect("eye")
        .translation;
    let state = world.state(terrain);
    assert_eq!(state.resident_count(), 24, "the pages are put to use");
    assert!(state.is_short_of_pages());
    assert!(state.pages().get(leaf_at(here.x, here.z)).is_some());
    assert!(
        world.told().evicted.len() > 20,
        "the flight should have evicted tiles"
    );
    assert_eq!(world.assets(), [1, 24], "nothing beyond what has a page");
}

#[test]
fn two_cameras_each_have_their_ground() {
    let mut world = World3::new(SIZE);
    let terrain = world.spawn(());
    world.app.world_mut().spawn(camera(200.0, 200.0));
    let mut far = camera(3400.0, 2600.0);
    far.0.lod.reach = 6.0;
    let far = world.app.world_mut().spawn(far).id();
    world.settle(terrain);
    let state = world.state(terrain);
    assert_eq!(level_at(state, 200.0, 200.0), 0);
    assert_eq!(level_at(state, 3400.0, 2600.0), 0);
    let views = world.app.world().get::<TerrainViews>(far).expect("views");
    let view = views.of(terrain).expect("one for the terrain");
    assert!((view.eye_m - DVec3::new(3400.0, 150.0, 2600.0)).length() < 1e-3);
    let leaf = state.lattice().level_index(0);
    assert_eq!(view.lod.reach[leaf], 6 * state.lattice().node_size(0));
}

#[test]
fn a_terrain_may_move_turn_and_grow() {
    let mut world = World3::new(SIZE);
    let placed = Transform::from_xyz(-5000.0, 300.0, 7000.0)
        .with_rotation(Quat::from_rotation_y(2.0))
        .with_scale(Vec3::splat(3.0));
    let terrain = world.spawn(placed);
    let there = Vec3::new(1000.0, 160.0, 1300.0);
    let eye = placed.transform_point(there);
    let eye = (TerrainCamera::default(), Transform::from_translation(eye));
    let eye = world.app.world_mut().spawn(eye).id();
    world.settle(terrain);
    let views = world.app.world().get::<TerrainViews>(eye).expect("views");
    let view = *views.of(terrain).expect("one for the terrain");
    assert!(
        (view.eye_m.as_vec3() - there).length() < 0.01,
        "{}",
        view.eye_m
    );
    assert!((view.eye_height_m - 160.0).abs() < 0.01);
    assert!((view.scale - 3.0).abs() < 1e-5);
    assert_eq!(level_at(world.state(terrain), 1000.0, 1300.0), 0);
    // Some metres above the ground, the floor is less than the eye's height and more than 0.
    let floor_m = f64::from(view.lod.floor) * world.state(terrain).lattice().unit_m(2.0);
    assert!((1.0..160.0).contains(&floor_m), "{floor_m}");

    // The terrain moves under the eye that stands still.
    let mut transform = world
        .app
        .world_mut()
        .get_mut::<Transform>(terrain)
        .expect("terrain");
    transform.rotate_local_y(0.3);
    transform.translation.x += 700.0;
    let local = transform.compute_affine().inverse();
    let eye_at = world
        .app
        .world()
        .get::<Transform>(eye)
        .expect("eye")
        .translation;
    let there = local.transform_point3(eye_at);
    world.settle(terrain);
    let views = world.app.world().get::<TerrainViews>(eye).expect("views");
    let view = *views.of(terrain).expect("one for the terrain");
    assert!((view.eye_m.as_vec3() - there).length() < 0.01);
}

#[test]
fn a_despawned_terrain_leaves_nothing() {
    let mut world = World3::new(SIZE);
    // Once at rest, once in the middle of loading.
    for frames in [None, Some(1), Some(2), Some(4), Some(9)] {
        let terrain = world.spawn(());
        let eye = world.app.world_mut().spawn(camera(900.0, 900.0)).id();
        match frames {
            None => world.settle(terrain),
            Some(frames) => {
                for _ in 0..frames {
                    world.frame();
                }
            }
        }
        world.app.world_mut().despawn(terrain);
        assert_eq!(world.tile_entities(), 0);
        world.run_until("all assets freed", |world| {
            world.resource::<Assets<TerrainManifest>>().is_empty()
                && world.resource::<Assets<TerrainTile>>().is_empty()
        });
        for _ in 0..20 {
            world.frame();
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        assert_eq!(
            world.assets(),
            [0; 2],
            "a load that was under way came in later"
        );
        assert_eq!(world.tile_entities(), 0);
        let views = world.app.world().get::<TerrainViews>(eye).expect("views");
        assert!(views.views.is_empty());
        world.app.world_mut().despawn(eye);
    }
}

#[test]
fn a_terrain_that_loses_its_component_is_no_terrain() {
    let mut world = World3::new([400, 300]);
    let terrain = world.spawn(());
    world.settle(terrain);
    let mut entity = world.app.world_mut().entity_mut(terrain);
    entity.remove::<Terrain>();
    world.frame();
    assert_eq!(world.tile_entities(), 0);
    assert!(world.app.world().get::<TerrainState>(terrain).is_none());
    world.run_until("assets freed", |world| {
        world.resource::<Assets<TerrainTile>>().is_empty()
    });
}

#[test]
fn several_terrains_are_apart() {
    let mut world = World3::new([400, 300]);
    let near = world.spawn(());
    let far = world.spawn(Transform::from_xyz(50_000.0, 0.0, 0.0));
    let eye = world.app.world_mut().spawn(camera(100.0, 100.0)).id();
    world.settle(near);
    world.settle(far);
    assert_eq!(
        world.state(far).resident_count(),
        5,
        "nobody is near it: the two coarsest levels"
    );
    let detail = world.state(near).resident_count();
    assert!(detail > 10);
    let views = world.app.world().get::<TerrainViews>(eye).expect("views");
    assert_eq!(views.views.len(), 2);
    world.app.world_mut().despawn(near);
    world.settle(far);
    world.run_until("the near one's tiles freed", |world| {
        world.resource::<Assets<TerrainTile>>().len() == 5
    });
    assert_eq!(world.tile_entities(), 5);
}

#[test]
fn another_asset_source_will_do() {
    let mut world = World3::new([300, 300]);
    // Of the app's two sources only this one has a terrain of that name.
    write_terrain(&world.dir.path().join("elsewhere/andes"), [300, 300]);
    let server = world.app.world().resource::<AssetServer>();
    let manifest = server.load("worlds://andes/terrain.ron");
    let terrain = world.app.world_mut().spawn(Terrain::new(manifest)).id();
    world.app.world_mut().spawn(camera(100.0, 100.0));
    world.settle(terrain);
    assert_eq!(world.state(terrain).resident_count(), 14);
}

#[test]
fn settings_that_cannot_be_used_fall_back() {
    let mut world = World3::new([300, 300]);
    let terrain = world.spawn(TerrainSettings {
        leaf_level: 3,
        root_levels: 9,
        fade_levels_per_s: -1.0,
        ..default()
    });
    world.app.insert_resource(TerrainStreaming {
        page_bytes: 7,
        ..default()
    });
    let (_, at) = camera(100.0, 100.0);
    let mut bad = TerrainCamera::default();
    bad.lod.reach = 2.5;
    bad.faces_per_side = 7;
    world.app.world_mut().spawn((bad, at));
    world.settle(terrain);
    let state = world.state(terrain);
    let streamer = world.app.world().resource::<TerrainStreamer>();
    assert_eq!(streamer.pages(), TerrainStreaming::default().pages());
    assert_eq!(state.lattice().leaf_level, 0);
    assert_eq!(level_at(state, 100.0, 100.0), 0);
    for field in [
        "page_bytes is 7",
        "root_levels is 9",
        "fade_levels_per_s is -1",
        "faces_per_side is 7",
        "reach 2.5",
    ] {
        assert_eq!(logged(field), [Level::ERROR], "{field}");
    }
    // A transform that can't be inverted has no view, and nothing else happens.
    let mut transform = world
        .app
        .world_mut()
        .get_mut::<Transform>(terrain)
        .expect("terrain");
    transform.scale = Vec3::ZERO;
    world.frame();
    world.frame();
    let terrain = format!("terrain {terrain} has a Transform");
    assert!(logged(&terrain).contains(&Level::WARN));
}

#[cfg(feature = "render")]
#[test]
fn cameras_count_by_what_they_show() {
    use bevy::camera::{OrthographicProjection, PerspectiveProjection};
    let mut world = World3::new(SIZE);
    let terrain = world.spawn(());
    let (settings, at) = camera(500.0, 500.0);
    let inactive = Camera {
        is_active: false,
        ..default()
    };
    let projection = Projection::Perspective(PerspectiveProjection::default());
    let eye = (inactive, settings.clone(), at, projection);
    let eye = world.app.world_mut().spawn(eye).id();
    world.settle(terrain);
    assert_eq!(
        world.state(terrain).resident_count(),
        5,
        "an inactive camera sees nothing but the two coarsest levels"
    );

    // What shows 4 km of ground needs no detail finer than a perspective 4.8 km away.
    let mut parallel = OrthographicProjection::default_3d();
    parallel.area = Rect::new(-3000.0, -2000.0, 3000.0, 2000.0);
    let parallel = Projection::Orthographic(parallel);
    let mut entity = world.app.world_mut().entity_mut(eye);
    entity.insert((parallel, Camera::default()));
    world.settle(terrain);
    let views = world.app.world().get::<TerrainViews>(eye).expect("views");
    let view = *views.of(terrain).expect("one for the terrain");
    assert!(!view.lod.planar);
    let floor_m = f64::from(view.lod.floor) * world.state(terrain).lattice().unit_m(2.0);
    assert!((floor_m - 4000.0 / (2.0 * 22.5_f64.to_radians().tan())).abs() < 0.1);
    let finest = world.told().loaded.iter().map(|tile| tile.level).min();
    // Reach 4: level 2 ends at 4.1 km, level 3 at 8.2 km.
    assert_eq!(finest, Some(3));
}
