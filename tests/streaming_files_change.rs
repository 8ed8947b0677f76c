//! Files that change under a running program: a tile that is baked again shows up, a whole terrain
//! does, and what can't be used is named and changes nothing.

mod streaming_support;

use bevy::log::Level;
use bevy::math::DVec2;
use bevy::prelude::*;
use bevy_tessera::stream::TerrainState;
use bevy_tessera::terrain::{MANIFEST_FILE, TerrainCamera, TerrainManifest};
use bevy_tessera::tile::{TerrainTile, TileAddress};
use std::fs;
use std::path::Path;
use streaming_support::{World3, logged, stored_height, write_terrain_of};

const SIZE: [u32; 2] = [1200, 1200];
const STEP_M: f64 = 0.01;
const AT: Vec3 = Vec3::new(1000.0, 150.0, 700.0);

fn watched() -> (World3, Entity) {
    let mut world = World3::in_app(SIZE, true, |_, _| ());
    let terrain = world.spawn(());
    let eye = (TerrainCamera::default(), Transform::from_translation(AT));
    world.app.world_mut().spawn(eye);
    world.settle(terrain);
    (world, terrain)
}

/// The ground under the eye, in metres.
fn ground_m(world: &World, terrain: Entity) -> f64 {
    let state = world.get::<TerrainState>(terrain).expect("is there");
    let at = DVec2::new(AT.x.into(), AT.z.into());
    let ground = state.height(at).expect("on the terrain");
    ground.height_m
}

fn tile_at(world: &World3) -> (TileAddress, std::path::PathBuf) {
    let address = TileAddress::new(0, (AT.x / 256.0) as u32, (AT.z / 256.0) as u32);
    (address, world.path(TerrainTile::path(address)))
}

/// Moves a finished file or folder to its place, as a bake does.
fn put(from: &Path, to: &Path) {
    fs::rename(from, to).expect("renamed");
}

#[test]
fn a_tile_that_is_baked_again_shows_up() {
    let (mut world, terrain) = watched();
    let (address, path) = tile_at(&world);
    let before = ground_m(world.app.world(), terrain);
    let bytes = fs::read(&path).expect("is there");
    let mut tile = TerrainTile::decode(&bytes, address).expect("good");
    // Within the range that the index promises.
    let range = tile.heights.range();
    tile.heights
        .samples_mut()
        .iter_mut()
        .for_each(|height| *height = range.min + (*height - range.min) / 2);
    fs::write(&path, tile.encode(address)).expect("written");
    world.run_until("read again", |world| {
        (ground_m(world, terrain) - before).abs() > 1.0
    });
    assert_eq!(world.told().reloaded, [address]);
    assert!(world.told().tiles_failed.is_empty());
    assert!(world.told().evicted.is_empty(), "nothing went away for it");

    // And what can't be used does not.
    let now = ground_m(world.app.world(), terrain);
    fs::write(&path, &bytes[..4000]).expect("written");
    world.run_until("refused", |world| {
        let told = world.resource::<streaming_support::Told>();
        !told.tiles_failed.is_empty()
    });
    let (failed, reason) = world.told().tiles_failed[0].clone();
    assert_eq!(failed, address);
    assert!(reason.contains(&TerrainTile::path(address)), "{reason}");
    let line = format!("tile {address} of terrain {terrain} stays as it was: {reason}");
    assert_eq!(logged(&line), [Level::WARN]);
    assert_eq!(ground_m(world.app.world(), terrain), now);
    // Put right, it is picked up.
    fs::write(&path, &bytes).expect("written");
    world.run_until("read again", |world| {
        (ground_m(world, terrain) - before).abs() < 1e-6
    });
}

#[test]
fn a_terrain_that_is_baked_again_is_followed_tile_by_tile() {
    let (mut world, terrain) = watched();
    let before = ground_m(world.app.world(), terrain);
    let resident = world.state(terrain).resident_count();
    let instance = world.state(terrain).instance();
    // The same scale, and 20 m higher. The folder is replaced as a whole.
    let new = world.dir.path().join("new");
    write_terrain_of(&new, SIZE, STEP_M, &|x, z| stored_height(x, z) + 2000);
    let old = world.path("");
    put(&old, &world.dir.path().join("old"));
    put(&new, &old);
    touch(&old.join(MANIFEST_FILE));
    world.run_until("followed", |world| {
        (ground_m(world, terrain) - before - 20.0).abs() < 1e-6
    });
    world.settle(terrain);
    assert_eq!(world.state(terrain).instance(), instance);
    assert!(world.state(terrain).resident_count() >= resident);
    // Every resident tile is the new one.
    let state = world.state(terrain);
    let mut told = world.told().reloaded.clone();
    told.sort();
    told.dedup();
    assert!(told.len() >= resident, "{} of {resident}", told.len());
    let root = state.tile_data(state.root()).expect("resident");
    let file = fs::read(world.path(TerrainTile::path(state.root()))).expect("is there");
    assert_eq!(
        *root,
        TerrainTile::decode(&file, state.root()).expect("good")
    );
}

/// Opens a file for writing and closes it, as a bake does with a manifest in its final place.
fn touch(path: &Path) {
    std::thread::sleep(std::time::Duration::from_millis(50));
    fs::OpenOptions::new()
        .append(true)
        .open(path)
        .expect("is there");
}

#[test]
fn another_terrain_takes_the_place_of_one_that_is_drawn_and_never_is_there_none() {
    let (mut world, terrain) = watched();
    let before = ground_m(world.app.world(), terrain);
    // Twice as steep: stored heights mean something else.
    let new = world.dir.path().join("new");
    write_terrain_of(&new, SIZE, 2.0 * STEP_M, &stored_height);
    let old = world.path("");
    put(&old, &world.dir.path().join("old"));
    put(&new, &old);
    touch(&old.join(MANIFEST_FILE));
    let height_m = 2.0 * (before + 100.0) - 100.0;
    world.run_until("replaced", |world| {
        // One or the other, in every frame.
        let state = world.get::<TerrainState>(terrain).expect("one is there");
        assert!(state.is_ready());
        (ground_m(world, terrain) - height_m).abs() < 30.0
    });
    world.settle(terrain);
    assert!((ground_m(world.app.world(), terrain) - height_m).abs() < 1e-6);
    assert!(
        world.told().tiles_failed.is_empty(),
        "{:?}",
        world.told().tiles_failed
    );
    assert_eq!(world.told().ready, [terrain, terrain]);
}

#[test]
fn a_manifest_that_becomes_useless_changes_nothing_and_is_named() {
    let (mut world, terrain) = watched();
    let before = ground_m(world.app.world(), terrain);
    let manifest = world.path(MANIFEST_FILE);
    let good = fs::read_to_string(&manifest).expect("is there");
    for (text, why) in [
        (
            "it was a dark and stormy night".to_owned(),
            "can't be understood",
        ),
        (good.replace("version:4", "version:99"), "version 99"),
        (good.replace("tessera-terrain", "tesseract"), "tesseract"),
    ] {
        let told = world.told().reload_failed.len();
        fs::write(&manifest, text).expect("written");
        world.run_until("refused", |world| {
            let refused = &world.resource::<streaming_support::Told>().reload_failed;
            refused.len() > told
        });
        let reason = world.told().reload_failed[told].clone();
        assert!(
            reason.contains("alps/terrain.ron") && reason.contains(why),
            "{reason}"
        );
        let line = format!("terrain {terrain} stays as it was: {reason}");
        assert_eq!(logged(&line), [Level::WARN]);
        assert_eq!(ground_m(world.app.world(), terrain), before);
    }
    // Put right, it streams on, wherever the eye goes.
    fs::write(&manifest, good).expect("written");
    world.run_until("loaded", |world| {
        let server = world.resource::<AssetServer>();
        let path = "alps/terrain.ron";
        server
            .get_handle::<TerrainManifest>(path)
            .is_some_and(|handle| server.is_loaded(&handle))
    });
    world.settle(terrain);
    assert_eq!(ground_m(world.app.world(), terrain), before);
    assert!(world.told().tiles_failed.is_empty());
}

#[test]
fn what_was_missing_is_found_when_it_comes() {
    let mut world = World3::new(SIZE);
    let (address, path) = tile_at(&world);
    let manifest = world.path(MANIFEST_FILE);
    let hidden = world.path("hidden");
    put(&manifest, &hidden);
    let bytes = fs::read(&path).expect("is there");
    fs::write(&path, &bytes[..999]).expect("written");
    let terrain = world.spawn(());
    let eye = (TerrainCamera::default(), Transform::from_translation(AT));
    world.app.world_mut().spawn(eye);
    world.run_until("refused", |world| {
        !world
            .resource::<streaming_support::Told>()
            .failed
            .is_empty()
    });
    assert!(world.told().failed[0].1.contains("terrain.ron is missing"));
    put(&hidden, &manifest);
    world.run_until("found", |world| {
        world.get::<TerrainState>(terrain).is_some()
    });
    world.settle(terrain);
    assert_eq!(world.told().failed.len(), 1, "told once");
    assert_eq!(world.told().tiles_failed.len(), 1);
    assert!(world.state(terrain).pages().get(address).is_none());
    // Nobody watches; it is asked for again all the same.
    fs::write(&path, &bytes).expect("written");
    world.run_until("found", |world| {
        let state = world.get::<TerrainState>(terrain).expect("is there");
        state.pages().get(address).is_some()
    });
    assert_eq!(world.state(terrain).failed().len(), 0);
}

#[test]
fn a_tile_of_another_terrain_is_refused_by_name() {
    let mut world = World3::new(SIZE);
    let (address, path) = tile_at(&world);
    let other = world.dir.path().join("other");
    write_terrain_of(&other, SIZE, 3.0 * STEP_M, &stored_height);
    fs::copy(other.join(TerrainTile::path(address)), &path).expect("copied");
    // One of the same scale, whose heights are elsewhere.
    let beside = TileAddress::new(0, address.x + 1, address.z);
    write_terrain_of(&other, SIZE, STEP_M, &|x, z| stored_height(x, z) + 9000);
    let path = TerrainTile::path(beside);
    fs::copy(other.join(&path), world.path(path)).expect("copied");
    let terrain = world.spawn(());
    let eye = (TerrainCamera::default(), Transform::from_translation(AT));
    world.app.world_mut().spawn(eye);
    world.settle(terrain);
    let mut told = world.told().tiles_failed.clone();
    told.sort();
    assert_eq!(told.len(), 2, "{told:?}");
    assert_eq!([told[0].0, told[1].0], [address, beside]);
    assert!(told[0].1.contains("another terrain"), "{}", told[0].1);
    for (tile, reason) in &told {
        assert!(reason.contains(&TerrainTile::path(*tile)), "{reason}");
        assert!(world.state(terrain).pages().get(*tile).is_none());
    }
}

#[test]
fn a_terrain_that_never_comes_doesnt_keep_the_one_that_is_there_from_streaming() {
    let (mut world, terrain) = watched();
    let before = ground_m(world.app.world(), terrain);
    let manifest = world.path(MANIFEST_FILE);
    let good = fs::read_to_string(&manifest).expect("is there");
    // Another scale, to which no tile belongs.
    fs::write(&manifest, good.replace("spacing_m:2", "spacing_m:3")).expect("written");
    world.run_until("refused", |world| {
        let told = world.resource::<streaming_support::Told>();
        !told.reload_failed.is_empty()
    });
    let reason = world.told().reload_failed[0].clone();
    assert!(reason.contains("another terrain"), "{reason}");
    assert!(!world.state(terrain).is_settled(), "another one is awaited");
    assert_eq!(ground_m(world.app.world(), terrain), before);
    // It was a mistake.
    fs::write(&manifest, good).expect("written");
    world.run_until("settled", |world| {
        let state = world.get::<TerrainState>(terrain).expect("is there");
        state.is_settled()
    });
    let mut eyes = world
        .app
        .world_mut()
        .query::<(&TerrainCamera, &mut Transform)>();
    for (_, mut eye) in eyes.iter_mut(world.app.world_mut()) {
        eye.translation = Vec3::new(2000.0, 150.0, 2100.0);
    }
    world.settle(terrain);
    let leaf = TileAddress::new(0, 2000 / 256, 2100 / 256);
    assert!(world.state(terrain).pages().get(leaf).is_some());
    assert!(world.told().failed.is_empty());
}
