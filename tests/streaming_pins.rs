//! What is pinned is resident without anybody looking, says how far it is, and answers; on a server
//! without a GPU too.

mod streaming_support;

use bevy::ecs::system::SystemState;
use bevy::math::DVec2;
use bevy::prelude::*;
use bevy_tessera::query::TerrainQuery;
use bevy_tessera::stream::{
    TerrainPin, TerrainPinProgress, TerrainRegion, TerrainState, TerrainStreamer, TerrainStreaming,
};
use bevy_tessera::terrain::{Terrain, TerrainCamera, TerrainSettings};
use bevy_tessera::tile::{TerrainTile, TileAddress};
use streaming_support::{Told, World3, stored_height};

const SIZE: [u32; 2] = [1500, 1100];
/// Metres a finest tile, and a sample.
const LEAF_M: f32 = 256.0;
const SPACING_M: f64 = 2.0;

fn progress(world: &World, pin: Entity) -> TerrainPinProgress {
    *world.get(pin).expect("every pin has one")
}

fn wait(world: &mut World3, pin: Entity) {
    world.run_until("pinned", |world| progress(world, pin).is_ready());
}

#[test]
fn a_server_answers_for_the_region_that_it_pins() {
    let mut world = World3::new(SIZE);
    let terrain = world.spawn(());
    let region = TerrainRegion::around(Vec2::new(1300.0, 900.0), 200.0);
    let pin = world
        .app
        .world_mut()
        .spawn(Terrain::wait_for(terrain, region))
        .id();
    assert_eq!(progress(world.app.world(), pin).fraction(), 0.0);
    let mut last = 0.0;
    world.run_until("pinned", |world| {
        let now = progress(world, pin).fraction();
        assert!((last..=1.0).contains(&now), "{last} to {now}");
        last = now;
        progress(world, pin).is_ready()
    });
    world.frame();
    assert_eq!(world.told().pins_ready, [pin]);
    world.settle(terrain);

    let mut random = 77_u32;
    let mut draw = || {
        random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(random >> 8) / f64::from(1 << 24)
    };
    let mut state = SystemState::<TerrainQuery>::new(world.app.world_mut());
    let query = state.get(world.app.world()).expect("valid");
    for _ in 0..2000 {
        let sample = DVec2::new(550.0 + draw() * 199.0, 350.0 + draw() * 199.0);
        let found = query
            .height(terrain, sample * SPACING_M)
            .expect("on the terrain");
        assert_eq!(found.level, 0, "at {sample}");
        let (cell, part) = (sample.floor(), sample.fract());
        let at =
            |dx: f64, dz: f64| f64::from(stored_height((cell.x + dx) as u32, (cell.y + dz) as u32));
        let near = at(0.0, 0.0) * (1.0 - part.x) + at(1.0, 0.0) * part.x;
        let far = at(0.0, 1.0) * (1.0 - part.x) + at(1.0, 1.0) * part.x;
        let stored = near * (1.0 - part.y) + far * part.y;
        let height_m = -100.0 + 0.01 * stored;
        assert!(
            (found.height_m - height_m).abs() < 1e-9,
            "at {sample}: {found:?}"
        );
        let place = (sample * SPACING_M).as_vec2().extend(5000.0).xzy();
        let under = query.under(place).expect("over the terrain");
        assert_eq!((under.terrain, under.level), (terrain, 0));
        assert!((under.point - place.with_y(height_m as f32)).length() < 0.01);
    }
    // Elsewhere an ancestor answers, and says so; outside nobody does.
    let far = query
        .height(terrain, DVec2::new(10.0, 2000.0))
        .expect("on the terrain");
    assert!(far.level >= 2, "{far:?}");
    for outside in [DVec2::new(-0.1, 5.0), DVec2::new(5.0, 2198.1), DVec2::NAN] {
        assert_eq!(query.height(terrain, outside), None);
    }
    let corner = DVec2::new(2998.0, 2198.0);
    assert!(
        query.height(terrain, corner).is_some(),
        "the last sample belongs to the terrain"
    );
}

#[test]
fn pinned_tiles_stay_while_eyes_want_others() {
    let mut world = World3::new(SIZE);
    let terrain = world.spawn(());
    world.app.insert_resource(TerrainStreaming::with_pages(40));
    let region = TerrainRegion::around(Vec2::splat(2.5 * LEAF_M), 1.0);
    let pin = world
        .app
        .world_mut()
        .spawn(TerrainPin {
            terrain,
            region,
            finest_level: 0,
        })
        .id();
    let leaf = TileAddress::new(0, 2, 2);
    let there = |world: &World| {
        let state = world.get::<TerrainState>(terrain).expect("is there");
        state.pages().get(leaf).is_some()
    };
    wait(&mut world, pin);
    let eye = (TerrainCamera::default(), Transform::default());
    let eye = world.app.world_mut().spawn(eye).id();
    for n in 0..200 {
        let at = Vec3::new(2900.0 - 4.0 * n as f32, 150.0, 1900.0);
        *world.app.world_mut().get_mut(eye).expect("eye") = Transform::from_translation(at);
        world.frame();
        assert!(there(world.app.world()), "in frame {n}");
        std::thread::sleep(std::time::Duration::from_micros(300));
    }
    assert!(!world.told().evicted.is_empty(), "others had to go");
    // Let go, it goes.
    world.app.world_mut().despawn(pin);
    for n in 0..400 {
        let at = Vec3::new(2900.0 - 4.0 * (n % 200) as f32, 150.0, 1900.0);
        *world.app.world_mut().get_mut(eye).expect("eye") = Transform::from_translation(at);
        world.frame();
        std::thread::sleep(std::time::Duration::from_micros(300));
    }
    assert!(!there(world.app.world()));
}

#[test]
fn everything_can_be_pinned_and_more_than_there_is_memory_for_does_no_harm() {
    let mut world = World3::new(SIZE);
    let terrain = world.spawn(());
    let pin = TerrainPin {
        terrain,
        region: TerrainRegion::EVERYTHING,
        finest_level: 1,
    };
    let pin = world.app.world_mut().spawn(pin).id();
    wait(&mut world, pin);
    let file = world.state(terrain).manifest().file.clone();
    let coarse: u32 = (1..file.levels)
        .map(|level| file.tiles(level).iter().product::<u32>())
        .sum();
    let found = progress(world.app.world(), pin);
    assert_eq!(
        found,
        TerrainPinProgress {
            wanted: coarse,
            resident: coarse,
            failed: 0
        }
    );
    assert_eq!(world.state(terrain).resident_count() as u32, coarse);
    // Down to the samples there are more tiles than pages.
    world.app.insert_resource(TerrainStreaming::with_pages(50));
    let world_mut = world.app.world_mut();
    world_mut
        .get_mut::<TerrainPin>(pin)
        .expect("pin")
        .finest_level = 0;
    world.settle(terrain);
    assert!(!progress(world.app.world(), pin).is_ready());
    assert_eq!(world.state(terrain).resident_count(), 50);
    let streamer = world.app.world().resource::<TerrainStreamer>();
    assert_eq!((streamer.pages_used(), streamer.pages()), (50, 50));
}

#[test]
fn a_tile_that_cannot_be_had_does_not_keep_a_loading_screen_up() {
    let mut world = World3::new(SIZE);
    let bad = TileAddress::new(0, 3, 3);
    std::fs::write(world.path(TerrainTile::path(bad)), b"rubbish").expect("written");
    let terrain = world.spawn(());
    let region = TerrainRegion::around(Vec2::splat(3.5 * LEAF_M), 300.0);
    let pin = world
        .app
        .world_mut()
        .spawn(Terrain::wait_for(terrain, region))
        .id();
    wait(&mut world, pin);
    let found = progress(world.app.world(), pin);
    assert_eq!(found.failed, 1);
    assert_eq!(found.resident + 1, found.wanted);
    assert!(
        world
            .app
            .world()
            .resource::<Told>()
            .pins_ready
            .contains(&pin)
    );
}

#[test]
fn the_coarsest_levels_are_there_without_eyes_or_pins() {
    let mut world = World3::new(SIZE);
    let settings = TerrainSettings {
        root_levels: 3,
        ..default()
    };
    let terrain = world.spawn(settings);
    world.settle(terrain);
    let state = world.state(terrain);
    let root = state.root().level;
    let file = &state.manifest().file;
    let coarsest = (root - 2..=root).map(|level| file.tiles(level).iter().product::<u32>());
    assert_eq!(state.resident_count() as u32, coarsest.sum::<u32>());
    assert_eq!(state.levels_short(), 0);
}
