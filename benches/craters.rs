//! Craters in a running app without a renderer: from the trigger until everything that is resident has
//! changed and pages are marked to be written again.
//!
//! `cargo bench --no-default-features --features ecs,generate --bench craters`
//!
//! The ground is 4096² samples of ridges a metre apart, all of it resident; one thread calls.

use bevy::app::ScheduleRunnerPlugin;
use bevy::asset::AssetPlugin;
use bevy::prelude::*;
use bevy_tessera::bake::generate::{GenerateSettings, GeneratedSource, GeneratorKind};
use bevy_tessera::bake::{BakeSettings, bake};
use bevy_tessera::edit::{Crater, RedoEdit, TerrainEdits, UndoEdit};
use bevy_tessera::stream::{TerrainPin, TerrainRegion, TerrainState, TerrainStreaming};
use bevy_tessera::terrain::{Terrain, TerrainPlugin};
use std::path::Path;
use std::time::{Duration, Instant};

const SIDE: u32 = 4096;

struct Random(u64);

impl Random {
    /// 0 to 1.
    fn unit(&mut self) -> f32 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 40) as f32 / (1_u64 << 24) as f32
    }

    fn place(&mut self, low: f32, high: f32) -> Vec3 {
        let at = |random: &mut Self| low + (high - low) * random.unit();
        Vec3::new(at(self), 0.0, at(self))
    }
}

fn settled(assets: &Path) -> (App, Entity) {
    let mut app = App::new();
    app.add_plugins(MinimalPlugins.set(ScheduleRunnerPlugin::run_once()))
        .add_plugins(TransformPlugin)
        .add_plugins(AssetPlugin {
            file_path: assets.to_string_lossy().into_owned(),
            watch_for_changes_override: Some(false),
            ..default()
        })
        .add_plugins(TerrainPlugin)
        .insert_resource(TerrainStreaming::with_pages(1500));
    app.finish();
    app.cleanup();
    let manifest = app.world().resource::<AssetServer>().load("terrain.ron");
    let terrain = app.world_mut().spawn(Terrain::new(manifest)).id();
    app.world_mut().spawn(TerrainPin {
        terrain,
        region: TerrainRegion::EVERYTHING,
        finest_level: 0,
    });
    let began = Instant::now();
    loop {
        app.update();
        let state = app.world().get::<TerrainState>(terrain);
        if state.is_some_and(|state| state.is_settled() && state.resident_count() > 1300) {
            return (app, terrain);
        }
        assert!(began.elapsed() < Duration::from_secs(300), "never settles");
        std::thread::sleep(Duration::from_millis(1));
    }
}

fn trigger(app: &mut App, crater: Crater) -> Duration {
    let began = Instant::now();
    app.world_mut().trigger(crater);
    app.world_mut().flush();
    began.elapsed()
}

fn report(what: &str, mut times: Vec<Duration>) {
    times.sort();
    let at = |part: f64| times[((times.len() - 1) as f64 * part) as usize];
    println!(
        "{what}: median {:?}, 90th {:?}, 99th {:?}, worst {:?} ({} times)",
        at(0.5),
        at(0.9),
        at(0.99),
        at(1.0),
        times.len()
    );
}

fn main() {
    // `cargo test --benches` only wants to see it compile.
    if !std::env::args().any(|argument| argument == "--bench") {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let terrain = folder.path().join("terrain");
    let settings = GenerateSettings {
        relief_m: 300.0,
        ..GenerateSettings::new(GeneratorKind::Ridged, [SIDE, SIDE])
    };
    let mut source = GeneratedSource::new(settings).expect("can be made");
    bake(&mut source, &terrain, &BakeSettings::default(), &()).expect("room on the disk");
    let (mut app, terrain) = settled(&terrain);
    let app = &mut app;
    let mut random = Random(7);

    for radius_m in [4.0, 16.0] {
        let crater = |at: Vec3| Crater::at(at).radius(radius_m);
        let fresh: Vec<_> = (0..200)
            .map(|_| {
                let at = random.place(100.0, 3900.0);
                let time = trigger(app, crater(at));
                app.update();
                time
            })
            .collect();
        report(&format!("{radius_m} m, anywhere, a frame each"), fresh);
        let near: Vec<_> = (0..500)
            .map(|_| {
                let at = random.place(1900.0, 2200.0);
                let time = trigger(app, crater(at));
                app.update();
                time
            })
            .collect();
        report(&format!("{radius_m} m, on ground with craters"), near);
        for _ in 0..3 {
            let began = Instant::now();
            for _ in 0..1000 {
                let at = random.place(1000.0, 3000.0);
                trigger(app, crater(at));
            }
            let craters = began.elapsed();
            let began = Instant::now();
            app.update();
            println!(
                "1000 of {radius_m} m in a frame, over 2 x 2 km: {craters:?}, the rest of the frame {:?}",
                began.elapsed()
            );
        }
        let undo = |app: &mut App| {
            let began = Instant::now();
            app.world_mut().trigger(UndoEdit::default());
            app.world_mut().flush();
            began.elapsed()
        };
        let times = (0..30).map(|_| undo(app)).collect();
        report(&format!("{radius_m} m, undo"), times);
        let began = Instant::now();
        app.world_mut().trigger(RedoEdit::default());
        println!("redo {:?}", began.elapsed());
    }
    let edits = app.world().get::<TerrainEdits>(terrain);
    let log = edits.and_then(TerrainEdits::log).expect("is there");
    println!("{} records", log.len());
}
