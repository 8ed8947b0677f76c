//! A missing or corrupt file costs detail or a terrain, never more: an event and a log line name
//! it, the parent's shape stands in for a tile, and nothing panics.

mod streaming_support;

use bevy::log::Level;
use bevy::prelude::*;
use bevy_tessera::stream::TerrainState;
use bevy_tessera::terrain::{INDEX_FILE, MANIFEST_FILE, Terrain, TerrainCamera, TerrainManifest};
use bevy_tessera::tile::{TerrainTile, TileAddress};
use std::fs;
use streaming_support::{World3, logged, write_terrain};

fn camera(x: f32, z: f32) -> (TerrainCamera, Transform) {
    (TerrainCamera::default(), Transform::from_xyz(x, 150.0, z))
}

/// The level that the field gives in the middle of a tile.
fn level_in(state: &TerrainState, tile: TileAddress) -> i32 {
    let size = state.lattice().node_size(i32::from(tile.level));
    let at = bevy::math::IVec2::new(tile.x as i32, tile.z as i32) * size + size / 2;
    state.field().at(at)
}

#[test]
fn a_bad_tile_is_named_once_and_its_parent_stands_in() {
    let mut world = World3::new([1200, 1200]);
    let missing = TileAddress::new(0, 1, 1);
    let truncated = TileAddress::new(0, 3, 1);
    let flipped = TileAddress::new(0, 1, 3);
    let another = TileAddress::new(0, 3, 3);
    let empty = TileAddress::new(0, 5, 1);
    let no_density = TileAddress::new(0, 5, 3);
    let coarse = TileAddress::new(1, 3, 3);
    let path = |tile| world.path(TerrainTile::path(tile));
    fs::remove_file(path(missing)).expect("was there");
    let bytes = fs::read(path(truncated)).expect("is there");
    fs::write(path(truncated), &bytes[..bytes.len() / 2]).expect("written");
    let mut bytes = fs::read(path(flipped)).expect("is there");
    bytes[9000] ^= 4;
    fs::write(path(flipped), &bytes).expect("written");
    fs::copy(path(TileAddress::new(0, 2, 2)), path(another)).expect("copied");
    fs::write(path(empty), []).expect("written");
    let bytes = fs::read(path(no_density)).expect("is there");
    let tile = TerrainTile::decode(&bytes, no_density).expect("good");
    let heights = tile.heights.encode(no_density, tile.stamp);
    fs::write(path(no_density), heights).expect("written");
    fs::write(path(coarse), b"not a tile at all, but some text").expect("written");

    let terrain = world.spawn(());
    let eye = world.app.world_mut().spawn(camera(1000.0, 700.0)).id();
    world.settle(terrain);
    let bad = [
        missing, truncated, flipped, another, empty, no_density, coarse,
    ];
    let told = &world.told().tiles_failed;
    let mut failed: Vec<_> = told.iter().map(|(tile, _)| *tile).collect();
    failed.sort();
    let mut wanted = bad.to_vec();
    wanted.sort();
    assert_eq!(failed, wanted, "each bad tile once, and no other");
    for (tile, reason) in told {
        let file = TerrainTile::path(*tile);
        assert!(reason.contains(&format!("alps/{file}")), "{reason}");
        assert_eq!(reason.lines().count(), 1, "{reason}");
        let why = match *tile {
            tile if tile == missing => "is missing",
            tile if tile == flipped => "damaged",
            tile if tile == another => "holds tile 0/2_2",
            tile if tile == empty || tile == truncated => "bytes",
            _ => "starts with",
        };
        assert!(reason.contains(why), "{reason}");
        let line = format!("tile {tile} of terrain {terrain} keeps its parent's shape: {reason}");
        assert_eq!(logged(&line), [Level::WARN], "{line}");
    }
    let state = world.state(terrain);
    for tile in bad {
        assert!(state.pages().get(tile).is_none());
        let parent = i32::from(tile.level + 1) << 8;
        assert!(level_in(state, tile) >= parent, "{tile} is read");
    }
    // Nothing below a bad tile is asked for, and all around is there.
    let below = coarse.children().expect("not a leaf");
    assert!(below.iter().all(|&tile| state.pages().get(tile).is_none()));
    assert!(state.pages().get(TileAddress::new(0, 2, 2)).is_some());
    assert_eq!(world.told().ready, [terrain]);
    assert!(world.told().failed.is_empty());

    // Away and back: nothing is asked for again.
    for x in [50_000.0, 1000.0, 1300.0] {
        let mut transform = world
            .app
            .world_mut()
            .get_mut::<Transform>(eye)
            .expect("eye");
        transform.translation.x = x;
        world.settle(terrain);
    }
    assert_eq!(world.told().tiles_failed.len(), bad.len());
}

/// Breaks a terrain's folder, and expects one failure that names `file` and `why`.
fn refused(break_it: impl FnOnce(&World3), file: &str, why: &str) {
    let mut world = World3::new([300, 300]);
    break_it(&world);
    let terrain = world.spawn(());
    world.app.world_mut().spawn(camera(100.0, 100.0));
    world.run_until("refused", |world| {
        !world
            .resource::<streaming_support::Told>()
            .failed
            .is_empty()
    });
    for _ in 0..20 {
        world.frame();
    }
    let [(failed, reason)] = &world.told().failed[..] else {
        panic!("{:?}", world.told().failed);
    };
    assert_eq!(*failed, terrain);
    assert!(reason.contains(file), "{reason}");
    assert!(reason.contains(why), "{reason}");
    assert!(logged(reason).iter().all(|level| *level == Level::ERROR));
    assert!(!logged(reason).is_empty(), "{reason}");
    assert_eq!(reason.lines().count(), 1, "{reason}");
    assert!(world.told().ready.is_empty());
    assert_eq!(world.tile_entities(), 0);
}

#[test]
fn a_manifest_that_cannot_be_used_is_an_event() {
    let manifest = "alps/terrain.ron";
    refused(
        |world| fs::remove_file(world.path(MANIFEST_FILE)).expect("was there"),
        manifest,
        "missing",
    );
    refused(
        |world| fs::write(world.path(MANIFEST_FILE), "(format: 3").expect("written"),
        manifest,
        "can't be understood",
    );
    refused(
        |world| fs::write(world.path(MANIFEST_FILE), [0xff, 0xfe, 0]).expect("written"),
        manifest,
        "not text",
    );
    refused(
        |world| fs::write(world.path(MANIFEST_FILE), "").expect("written"),
        manifest,
        "can't be understood",
    );
    refused(
        |world| fs::remove_file(world.path(INDEX_FILE)).expect("was there"),
        manifest,
        INDEX_FILE,
    );
    refused(
        |world| {
            let other = tempfile::tempdir().expect("a folder");
            write_terrain(other.path(), [200, 200]);
            fs::copy(other.path().join(INDEX_FILE), world.path(INDEX_FILE)).expect("copied");
        },
        manifest,
        "different bakes",
    );
}

#[test]
fn without_its_root_a_terrain_is_none() {
    let root = TerrainTile::path(TileAddress::new(2, 0, 0));
    refused(
        |world| fs::remove_file(world.path(&root)).expect("was there"),
        &format!("alps/{root}"),
        "missing",
    );
}

#[test]
fn a_manifest_without_a_path_is_refused() {
    let mut world = World3::new([300, 300]);
    let kept = world.manifest();
    world.run_until("the manifest", |world| {
        world.resource::<Assets<TerrainManifest>>().contains(&kept)
    });
    let mut manifests = world
        .app
        .world_mut()
        .resource_mut::<Assets<TerrainManifest>>();
    let copy = manifests.get(&kept).expect("loaded").clone();
    let copy = manifests.add(copy);
    world.app.world_mut().spawn(Terrain::new(copy));
    world.frame();
    world.frame();
    let [(_, reason)] = &world.told().failed[..] else {
        panic!("{:?}", world.told().failed);
    };
    assert!(reason.contains("no path"), "{reason}");
}

#[test]
fn a_refused_terrain_may_get_a_better_manifest() {
    let mut world = World3::new([300, 300]);
    let bad = world
        .app
        .world()
        .resource::<AssetServer>()
        .load("nowhere/terrain.ron");
    let terrain = world.app.world_mut().spawn(Terrain::new(bad)).id();
    world.app.world_mut().spawn(camera(100.0, 100.0));
    world.run_until("refused", |world| {
        !world
            .resource::<streaming_support::Told>()
            .failed
            .is_empty()
    });
    let good = world.manifest();
    let mut component = world
        .app
        .world_mut()
        .get_mut::<Terrain>(terrain)
        .expect("terrain");
    component.manifest = good;
    world.settle(terrain);
    assert!(world.state(terrain).resident_count() > 3);

    // And another one again: all tiles of the first are dropped.
    write_terrain(&world.dir.path().join("plain"), [200, 150]);
    let other = world
        .app
        .world()
        .resource::<AssetServer>()
        .load("plain/terrain.ron");
    let mut component = world
        .app
        .world_mut()
        .get_mut::<Terrain>(terrain)
        .expect("terrain");
    component.manifest = other;
    world.frame();
    world.settle(terrain);
    assert_eq!(world.state(terrain).manifest().file.size, [200, 150]);
    let resident = world.state(terrain).resident_count();
    world.run_until("the first one's assets are freed", |world| {
        world.resource::<Assets<TerrainManifest>>().len() == 1
            && world.resource::<Assets<TerrainTile>>().len() == resident
    });
}
