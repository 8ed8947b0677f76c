//! What streaming costs and how well it keeps up; prints the table of `docs/PERFORMANCE.md`.
//!
//! A 16384² terrain is flown over at 300 m/s in real time, 60 frames a second, with 64 MiB of pages:
//! from its folder, from its archive, and from either behind a web server on this machine.
//! `TESSERA_FLIGHT_S` says for how many seconds each (20), `TESSERA_FLIGHT_SIDE` how many samples
//! a side the terrain has.

#[path = "../tests/common/http_server.rs"]
mod http_server;

use bevy::app::ScheduleRunnerPlugin;
use bevy::asset::AssetPlugin;
use bevy::prelude::*;
use bevy_tessera::archive::write_archive;
use bevy_tessera::bake::generate::{GenerateSettings, GeneratedSource, GeneratorKind};
use bevy_tessera::bake::{BakeSettings, bake};
use bevy_tessera::source::TerrainSourcePlugin;
use bevy_tessera::stream::{TILE_BYTES, TerrainState, TerrainStreamer, TerrainStreaming};
use bevy_tessera::terrain::{Terrain, TerrainCamera, TerrainPlugin, TileLoaded};
use bevy_tessera::tile::TileAddress;
use http_server::{Fault, HttpServer};
use std::collections::HashMap;
use std::path::Path;
use std::time::{Duration, Instant};

const SPEED_M_S: f32 = 300.0;
const FRAME: Duration = Duration::from_nanos(16_666_667);

fn from_environment(name: &str, default: u32) -> u32 {
    let value = std::env::var(name).ok();
    value
        .and_then(|value| value.parse().ok())
        .unwrap_or(default)
}

/// When tiles were asked for, and how long they took to become resident.
#[derive(Resource, Default)]
struct Latencies {
    asked: HashMap<TileAddress, Instant>,
    took_ms: Vec<f64>,
}

fn percentile(sorted: &[f64], part: f64) -> f64 {
    let at = (sorted.len() as f64 * part) as usize;
    sorted
        .get(at.min(sorted.len().saturating_sub(1)))
        .copied()
        .unwrap_or(f64::NAN)
}

fn app(assets: &Path, location: Option<&str>) -> App {
    let mut app = App::new();
    if let Some(location) = location {
        app.add_plugins(TerrainSourcePlugin::new("other", location));
    }
    app.add_plugins(MinimalPlugins.set(ScheduleRunnerPlugin::run_once()))
        .add_plugins(TransformPlugin)
        .add_plugins(AssetPlugin {
            file_path: assets.to_string_lossy().into_owned(),
            watch_for_changes_override: Some(false),
            ..default()
        })
        .add_plugins(TerrainPlugin)
        .insert_resource(TerrainStreaming {
            page_bytes: 64 << 20,
            tile_bytes: 580 * TILE_BYTES,
            ..default()
        })
        .init_resource::<Latencies>()
        .add_observer(|event: On<TileLoaded>, mut latencies: ResMut<Latencies>| {
            if let Some(asked) = latencies.asked.remove(&event.address) {
                latencies.took_ms.push(asked.elapsed().as_secs_f64() * 1e3);
            }
        });
    app.finish();
    app.cleanup();
    app
}

fn spawn_terrain(app: &mut App, location: Option<&str>) -> Entity {
    let manifest = if location.is_some() {
        "other://terrain.ron"
    } else {
        "big/terrain.ron"
    };
    let manifest = app.world().resource::<AssetServer>().load(manifest);
    app.world_mut().spawn(Terrain::new(manifest)).id()
}

fn fly(name: &str, assets: &Path, location: Option<&str>, seconds: u32, side: u32) {
    let mut app = app(assets, location);
    let terrain = spawn_terrain(&mut app, location);
    let start = Vec3::new(600.0, 400.0, 900.0);
    let eye = (TerrainCamera::default(), Transform::from_translation(start));
    let eye = app.world_mut().spawn(eye).id();
    let began = Instant::now();
    loop {
        app.update();
        let state = app.world().get::<TerrainState>(terrain);
        if state.is_some_and(TerrainState::is_settled) {
            break;
        }
        assert!(
            began.elapsed() < Duration::from_secs(120),
            "{name} never settles"
        );
        std::thread::sleep(Duration::from_millis(1));
    }
    let settled_s = began.elapsed().as_secs_f64();
    app.world_mut().resource_mut::<Latencies>().took_ms.clear();

    let mut updates_ms = Vec::new();
    let mut stream_ms = Vec::new();
    let (mut short_frames, mut short_since, mut longest_short) = (0, None, Duration::ZERO);
    let (mut more_since, mut longest_more) = (None, Duration::ZERO);
    let mut shortest = 0;
    let began = Instant::now();
    let mut before = began;
    let mut at = start;
    let mut heading = Vec3::new(0.8, 0.0, 0.6);
    let edge = side as f32 - 700.0;
    while began.elapsed() < Duration::from_secs(seconds.into()) {
        let now = Instant::now();
        at += heading * SPEED_M_S * (now - before).as_secs_f32();
        before = now;
        // Turns back at the terrain's edges.
        if at.x > edge || at.x < 500.0 {
            heading.x = -heading.x;
            at.x = at.x.clamp(500.0, edge);
        }
        if at.z > edge || at.z < 500.0 {
            heading.z = -heading.z;
            at.z = at.z.clamp(500.0, edge);
        }
        *app.world_mut().get_mut::<Transform>(eye).expect("eye") = Transform::from_translation(at);
        app.update();
        updates_ms.push(now.elapsed().as_secs_f64() * 1e3);
        let world = app.world_mut();
        let streamer = world.resource::<TerrainStreamer>();
        stream_ms.push(streamer.last_frame().as_secs_f64() * 1e3);
        let state = world.get::<TerrainState>(terrain).expect("is there");
        let loading: Vec<TileAddress> = state.loading().collect();
        let short = state.levels_short();
        let mut latencies = world.resource_mut::<Latencies>();
        for address in loading {
            latencies.asked.entry(address).or_insert(now);
        }
        shortest = shortest.max(short);
        short_frames += u32::from(short > 0);
        for (is, since, longest) in [
            (short > 0, &mut short_since, &mut longest_short),
            (short > 1, &mut more_since, &mut longest_more),
        ] {
            if is {
                let since = since.get_or_insert(now);
                *longest = now.duration_since(*since).max(*longest);
            } else {
                *since = None;
            }
        }
        std::thread::sleep(FRAME.saturating_sub(now.elapsed()));
    }
    let mut took_ms = app.world().resource::<Latencies>().took_ms.clone();
    for list in [&mut took_ms, &mut updates_ms, &mut stream_ms] {
        list.sort_by(f64::total_cmp);
    }
    println!(
        "{name}: settled after {settled_s:.2} s; {} frames, {} tiles; request to resident \
         {:.1} ms median, {:.1} ms 99th percentile; streaming {:.3} ms a frame median, {:.3} ms \
         99th; whole update {:.3} ms median, {:.3} ms 99th; short in {short_frames} frames, at most \
         {shortest} levels, for {:.2} s at most, by more than one level for {:.2} s",
        updates_ms.len(),
        took_ms.len(),
        percentile(&took_ms, 0.5),
        percentile(&took_ms, 0.99),
        percentile(&stream_ms, 0.5),
        percentile(&stream_ms, 0.99),
        percentile(&updates_ms, 0.5),
        percentile(&updates_ms, 0.99),
        longest_short.as_secs_f64(),
        longest_more.as_secs_f64(),
    );
}

/// How long a tile takes by itself: one load at a time, frames as short as they can be, from
/// jumps all over the terrain.
fn wait_for_single_tiles(name: &str, assets: &Path, location: Option<&str>, side: u32) {
    let mut app = app(assets, location);
    app.world_mut()
        .resource_mut::<TerrainStreaming>()
        .loads_in_flight = 1;
    let terrain = spawn_terrain(&mut app, location);
    let eye = (TerrainCamera::default(), Transform::default());
    let eye = app.world_mut().spawn(eye).id();
    for jump in 0..24_u32 {
        let at = |salt: u32| {
            let draw = (jump * 2 + salt).wrapping_mul(0x9e37_79b1) >> 8;
            draw as f32 / (1 << 24) as f32 * side as f32
        };
        let place = Vec3::new(at(0), 400.0, at(1));
        *app.world_mut().get_mut::<Transform>(eye).expect("eye") =
            Transform::from_translation(place);
        let began = Instant::now();
        let mut frames = 0;
        while began.elapsed() < Duration::from_secs(10) {
            let now = Instant::now();
            app.update();
            frames += 1;
            let world = app.world_mut();
            let Some(state) = world.get::<TerrainState>(terrain) else {
                continue;
            };
            if frames > 3 && state.is_settled() {
                break;
            }
            let loading: Vec<TileAddress> = state.loading().collect();
            let mut latencies = world.resource_mut::<Latencies>();
            for address in loading {
                latencies.asked.entry(address).or_insert(now);
            }
            std::thread::sleep(Duration::from_micros(50));
        }
    }
    let mut took_ms = app.world().resource::<Latencies>().took_ms.clone();
    took_ms.sort_by(f64::total_cmp);
    println!(
        "{name}, one tile at a time, frames without pause: {} tiles; request to resident {:.2} ms \
         median, {:.2} ms 99th percentile",
        took_ms.len(),
        percentile(&took_ms, 0.5),
        percentile(&took_ms, 0.99),
    );
}

fn main() {
    // `cargo test --benches` only wants to see it compile.
    if !std::env::args().any(|argument| argument == "--bench") {
        return;
    }
    let seconds = from_environment("TESSERA_FLIGHT_S", 20);
    let side = from_environment("TESSERA_FLIGHT_SIDE", 16_384);
    let folder = tempfile::tempdir().expect("a folder");
    let settings = GenerateSettings::new(GeneratorKind::Ridged, [side, side]);
    let mut source = GeneratedSource::new(settings).expect("can be made");
    let big = folder.path().join("big");
    let began = Instant::now();
    bake(&mut source, &big, &BakeSettings::default(), &()).expect("baked");
    println!("{side}²: baked in {:.0} s", began.elapsed().as_secs_f64());
    let archive = folder.path().join("big.pmtiles");
    let report = write_archive(&big, &archive, false, &()).expect("packed");
    println!("{report:?}");

    let server = HttpServer::of_folder(folder.path(), |_| Fault::None);
    let archive = archive.to_string_lossy().into_owned();
    for (name, location) in [
        ("folder", None),
        ("archive", Some(archive)),
        ("folder over HTTP", Some(server.url("big"))),
        ("archive over HTTP", Some(server.url("big.pmtiles"))),
    ] {
        let location = location.as_deref();
        fly(name, folder.path(), location, seconds, side);
        wait_for_single_tiles(name, folder.path(), location, side);
    }
}
