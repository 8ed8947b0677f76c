//! Terrains stream from an archive and from behind a web server as they do from a folder; whatever
//! the file or the server does wrong is named, costs detail and no more, and is got over.

#[path = "common/http_server.rs"]
mod http_server;
mod streaming_support;

use bevy::asset::AssetServer;
use bevy::math::DVec2;
use bevy::prelude::*;
use bevy_tessera::archive::{HttpSettings, TerrainArchive, write_archive};
use bevy_tessera::source::TerrainSourcePlugin;
use bevy_tessera::stream::{TerrainState, TerrainStreaming};
use bevy_tessera::terrain::{Terrain, TerrainCamera, TerrainManifest};
use bevy_tessera::tile::{TerrainTile, TileAddress};
use http_server::{Fault, HttpServer};
use std::fs;
use std::path::Path;
use std::sync::atomic::{AtomicU8, Ordering};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use streaming_support::{Told, World3, stored_height, write_terrain_of};

const SIZE: [u32; 2] = [1200, 1200];
const AT: Vec3 = Vec3::new(1000.0, 150.0, 700.0);

/// A world whose source `other` lies where `location` says, given the app's folder.
fn world(watches: bool, location: impl FnOnce(&Path) -> String) -> World3 {
    let mut world = World3::in_app(SIZE, watches, |app, dir| {
        // What a game's player waits for is not what a test does.
        let http = HttpSettings {
            connect_timeout_s: 0.5,
            timeout_s: 0.5,
            retries: 0,
            ..default()
        };
        app.add_plugins(TerrainSourcePlugin::new("other", location(dir)).with_http(http));
    });
    world.app.insert_resource(TerrainStreaming {
        retry_s: 0.2,
        ..default()
    });
    world
}

fn pack(dir: &Path, to: &Path) {
    write_archive(dir, to, true, &()).expect("packed");
}

/// Spawns the terrain of the source `other`, and an eye.
fn spawn(world: &mut World3) -> Entity {
    let server = world.app.world().resource::<AssetServer>();
    let manifest = server.load("other://terrain.ron");
    let eye = (TerrainCamera::default(), Transform::from_translation(AT));
    world.app.world_mut().spawn(eye);
    world.app.world_mut().spawn(Terrain::new(manifest)).id()
}

fn ground_m(world: &World, terrain: Entity) -> Option<f64> {
    let state = world.get::<TerrainState>(terrain)?;
    let ground = state.height(DVec2::new(AT.x.into(), AT.z.into()))?;
    Some(ground.height_m)
}

/// The tiles that are resident with what they hold.
fn resident(world: &World3, terrain: Entity) -> Vec<(TileAddress, TerrainTile)> {
    let state = world.state(terrain);
    let mut tiles = Vec::new();
    for (address, _) in state.manifest().index.iter() {
        tiles.extend(state.tile_data(address).map(|tile| (address, tile.clone())));
    }
    tiles
}

/// What is resident around the eye when the terrain is read from its folder.
fn from_folder() -> Vec<(TileAddress, TerrainTile)> {
    let mut world = World3::new(SIZE);
    let terrain = world.spawn(());
    let eye = (TerrainCamera::default(), Transform::from_translation(AT));
    world.app.world_mut().spawn(eye);
    world.settle(terrain);
    resident(&world, terrain)
}

#[test]
fn an_archive_streams_as_its_folder_does() {
    let mut world = world(false, |dir| {
        let archive = dir.join("alps.pmtiles");
        pack(&dir.join("alps"), &archive);
        // Nothing else is left to read.
        fs::remove_dir_all(dir.join("alps")).expect("removed");
        archive.to_string_lossy().into_owned()
    });
    let terrain = spawn(&mut world);
    world.settle(terrain);
    assert_eq!(resident(&world, terrain), from_folder());
    assert!(world.told().tiles_failed.is_empty());
}

#[test]
fn a_web_server_streams_as_a_folder_does() {
    for archive in [false, true] {
        let folder = tempfile::tempdir().expect("a folder");
        let alps = folder.path().join("alps");
        streaming_support::write_terrain(&alps, SIZE);
        pack(&alps, &folder.path().join("alps.pmtiles"));
        let server = HttpServer::of_folder(folder.path(), |_| Fault::None);
        let url = server.url(if archive { "alps.pmtiles" } else { "alps" });
        let mut world = world(false, |_| url);
        let terrain = spawn(&mut world);
        world.settle(terrain);
        assert_eq!(resident(&world, terrain), from_folder());
        assert!(
            server.connections() < server.requests() / 2,
            "connections are used again"
        );
    }
}

#[test]
fn an_archive_that_is_useless_is_named_and_found_again_when_it_is_put_right() {
    type Breaks<'a> = &'a dyn Fn(&mut Vec<u8>);
    let broken: [(Breaks, &str); 5] = [
        (&|bytes| bytes.truncate(bytes.len() / 2), "truncated"),
        (&|bytes| bytes.truncate(40), "alps.pmtiles"),
        (&|bytes| bytes[7] = 2, "version 2"),
        (&|bytes| bytes[0] = b'Q', "starts with"),
        // In the root directory.
        (&|bytes| bytes[140] ^= 0x55, "damaged"),
    ];
    for (break_it, why) in broken {
        let mut good = Vec::new();
        let mut path = None;
        let mut world = world(false, |dir| {
            let archive = dir.join("alps.pmtiles");
            pack(&dir.join("alps"), &archive);
            good = fs::read(&archive).expect("packed");
            let mut bad = good.clone();
            break_it(&mut bad);
            fs::write(&archive, bad).expect("written");
            path = Some(archive.clone());
            archive.to_string_lossy().into_owned()
        });
        let terrain = spawn(&mut world);
        world.run_until("refused", |world| {
            !world.resource::<Told>().failed.is_empty()
        });
        let reason = world.told().failed[0].1.clone();
        assert!(
            reason.contains("alps.pmtiles") && reason.contains(why),
            "{reason}"
        );
        assert_eq!(reason.lines().count(), 1, "{reason}");
        fs::write(path.expect("set above"), &good).expect("written");
        world.run_until("found", |world| ground_m(world, terrain).is_some());
        world.settle(terrain);
        assert_eq!(world.told().failed.len(), 1, "told once");
    }
}

#[test]
fn a_damaged_tile_of_an_archive_costs_that_tile() {
    let bad = TileAddress::new(0, (AT.x / 256.0) as u32, (AT.z / 256.0) as u32);
    let mut world = world(false, |dir| {
        let path = dir.join("alps.pmtiles");
        pack(&dir.join("alps"), &path);
        let archive = TerrainArchive::open_file(&path).expect("good");
        let tile = archive.tile(bad).expect("good").expect("stored");
        let mut bytes = fs::read(&path).expect("is there");
        let at = bytes.windows(tile.len()).position(|window| window == tile);
        bytes[at.expect("is in there") + tile.len() / 2] ^= 1;
        fs::write(&path, bytes).expect("written");
        path.to_string_lossy().into_owned()
    });
    let terrain = spawn(&mut world);
    world.settle(terrain);
    let [(failed, reason)] = &world.told().tiles_failed[..] else {
        panic!("{:?}", world.told().tiles_failed);
    };
    assert_eq!(*failed, bad);
    assert!(reason.contains(&TerrainTile::path(bad)), "{reason}");
    assert!(
        reason.contains("damaged") || reason.contains("checksum"),
        "{reason}"
    );
}

#[test]
fn an_archive_that_is_replaced_shows_up() {
    let mut path = None;
    let mut world = world(true, |dir| {
        let archive = dir.join("alps.pmtiles");
        pack(&dir.join("alps"), &archive);
        path = Some(archive.clone());
        archive.to_string_lossy().into_owned()
    });
    let terrain = spawn(&mut world);
    world.settle(terrain);
    let before = ground_m(world.app.world(), terrain).expect("is there");
    let new = world.dir.path().join("new");
    write_terrain_of(&new, SIZE, 0.01, &|x, z| stored_height(x, z) + 2000);
    pack(&new, &path.expect("set above"));
    world.run_until("followed", |world| {
        (ground_m(world, terrain).expect("is there") - before - 20.0).abs() < 1e-6
    });
    world.settle(terrain);
    assert!(
        world.told().tiles_failed.is_empty(),
        "{:?}",
        world.told().tiles_failed
    );
}

/// What a server does to the file of one tile, until it is told to stop.
fn misbehaving(fault: impl Fn() -> Fault + Send + Sync + 'static, why: &str) {
    let bad = TileAddress::new(0, (AT.x / 256.0) as u32, (AT.z / 256.0) as u32);
    let folder = tempfile::tempdir().expect("a folder");
    let alps = folder.path().join("alps");
    streaming_support::write_terrain(&alps, SIZE);
    let is_over = Arc::new(AtomicU8::new(0));
    let over = Arc::clone(&is_over);
    let server = HttpServer::of_folder(folder.path(), move |request| {
        let is_it = request.target.ends_with(&TerrainTile::path(bad));
        if is_it && over.load(Ordering::Relaxed) == 0 {
            fault()
        } else {
            Fault::None
        }
    });
    let mut world = world(false, |_| server.url("alps"));
    let terrain = spawn(&mut world);
    world.run_until("refused", |world| {
        !world.resource::<Told>().tiles_failed.is_empty()
    });
    // All else goes on.
    world.settle(terrain);
    let told = world.told().tiles_failed.clone();
    assert!(told.iter().all(|(tile, _)| *tile == bad), "{told:?}");
    let reason = &told[0].1;
    assert!(reason.contains(&TerrainTile::path(bad)), "{reason}");
    assert!(reason.contains(why), "{reason}");
    assert_eq!(reason.lines().count(), 1, "{reason}");
    let state = world.state(terrain);
    assert!(state.is_ready() && state.resident_count() > 20);
    assert!(state.pages().get(bad).is_none());
    is_over.store(1, Ordering::Relaxed);
    world.run_until("got over", |world| {
        let state = world.get::<TerrainState>(terrain).expect("is there");
        state.pages().get(bad).is_some()
    });
}

#[test]
fn a_server_that_lacks_a_tile_costs_that_tile() {
    misbehaving(|| Fault::Status(404), "is missing");
}

#[test]
fn a_server_that_fails_costs_that_tile() {
    misbehaving(|| Fault::Status(500), "500");
}

#[test]
fn a_server_that_never_answers_costs_that_tile() {
    misbehaving(|| Fault::Never, "no answer within 0.5 s");
}

#[test]
fn a_server_that_is_slow_beyond_patience_costs_that_tile() {
    misbehaving(
        || Fault::Trickle { bytes_per_s: 2000 },
        "no answer within 0.5 s",
    );
}

#[test]
fn a_server_that_damages_a_tile_costs_that_tile() {
    misbehaving(|| Fault::Corrupt(9000), "damaged");
}

#[test]
fn a_server_that_cuts_a_tile_off_costs_that_tile() {
    misbehaving(|| Fault::Truncate(9000), "");
}

#[test]
fn a_server_without_the_terrain_is_asked_again() {
    let folder = tempfile::tempdir().expect("a folder");
    let status = Arc::new(Mutex::new(Some(503)));
    let answers = Arc::clone(&status);
    let server = HttpServer::of_folder(folder.path(), move |_| {
        answers.lock().unwrap().map_or(Fault::None, Fault::Status)
    });
    let mut world = world(false, |_| server.url("alps"));
    let terrain = spawn(&mut world);
    world.run_until("refused", |world| {
        !world.resource::<Told>().failed.is_empty()
    });
    let reason = world.told().failed[0].1.clone();
    assert!(
        reason.contains("terrain.ron") && reason.contains("503"),
        "{reason}"
    );
    streaming_support::write_terrain(&folder.path().join("alps"), SIZE);
    *status.lock().unwrap() = None;
    world.run_until("found", |world| ground_m(world, terrain).is_some());
    world.settle(terrain);
    // Asked to, it reads the manifest again.
    let server = world.app.world().resource::<AssetServer>();
    server.reload("other://terrain.ron");
    let handle = server.get_handle::<TerrainManifest>("other://terrain.ron");
    assert!(handle.is_some());
    std::thread::sleep(Duration::from_millis(50));
    world.settle(terrain);
}
