//! Ten thousand frames of streaming take no more memory than a thousand.

mod common;
mod streaming_support;

use bevy::prelude::*;
use bevy_tessera::stream::{TerrainState, TerrainStreamer, TerrainStreaming};
use bevy_tessera::terrain::{Terrain, TerrainCamera, TerrainManifest};
use bevy_tessera::tile::TerrainTile;
use common::flight::{hills, rough_weather};

const PAGES: u32 = 68;
const LOADS: usize = 16;

/// Bytes of this process that are in memory.
fn resident_bytes() -> u64 {
    let statm = std::fs::read_to_string("/proc/self/statm").expect("Linux has it");
    let pages: u64 = statm
        .split(' ')
        .nth(1)
        .and_then(|pages| pages.parse().ok())
        .expect("a number");
    pages * 4096
}

#[test]
fn ten_thousand_frames_of_streaming_take_no_more_memory_than_a_thousand() {
    let source = rough_weather(hills());
    let builder = source.builder();
    let mut app = streaming_support::app(hills(), false, |app, _| {
        app.register_asset_source("late", builder);
    });
    let ticker = source.clone();
    app.add_systems(First, move || ticker.tick());
    app.insert_resource(TerrainStreaming {
        loads_in_flight: LOADS as u32,
        ..TerrainStreaming::with_pages(PAGES)
    });
    let manifest = app
        .world()
        .resource::<AssetServer>()
        .load("late://hills/terrain.ron");
    let mut terrain = app.world_mut().spawn(Terrain::new(manifest.clone())).id();
    let eye = app
        .world_mut()
        .spawn((TerrainCamera::default(), Transform::default()))
        .id();
    let mut memory = Vec::new();
    let mut evicted = 0;
    for frame in 0..10_000 {
        // At 300 m/s around the terrain, once at a time at 30.
        let speed = if frame % 3000 < 1000 { 0.5 } else { 5.0 };
        let turn = frame as f32 * speed / 1500.0;
        let at = Vec3::new(
            2048.0 + 1500.0 * turn.cos(),
            130.0,
            2048.0 + 1500.0 * turn.sin(),
        );
        *app.world_mut().get_mut(eye).expect("eye") = Transform::from_translation(at);
        app.update();
        if frame % 2500 == 2499 {
            // Gone, and there again.
            evicted += app
                .world()
                .resource::<streaming_support::Told>()
                .evicted
                .len();
            *app.world_mut().resource_mut() = streaming_support::Told::default();
            app.world_mut().despawn(terrain);
            terrain = app.world_mut().spawn(Terrain::new(manifest.clone())).id();
        }
        if frame % 500 == 499 {
            memory.push(resident_bytes() >> 10);
        }
        let world = app.world();
        let streamer = world.resource::<TerrainStreamer>();
        assert!(streamer.pages_used() <= PAGES);
        // Those whose handles were dropped in this frame are freed in the next.
        let tiles = world.resource::<Assets<TerrainTile>>().len();
        assert!(
            tiles <= PAGES as usize + 4 * LOADS + 32,
            "{tiles} tiles in frame {frame}"
        );
        assert!(world.resource::<Assets<TerrainManifest>>().len() <= 1);
        if frame % 100 == 0
            && let Some(state) = world.get::<TerrainState>(terrain)
        {
            state
                .validate()
                .unwrap_or_else(|broken| panic!("frame {frame}: {broken}"));
        }
    }
    println!(
        "KiB in memory: {memory:?}; {evicted} evictions, {} reads",
        source.read_count()
    );
    assert!(evicted > 1000);
    let early = memory[1..6].iter().max().expect("some");
    let late = memory[memory.len() - 5..].iter().max().expect("some");
    assert!(*late < early + (4 << 10), "{memory:?}");
}
