//! Asking a settled terrain for heights, normals and rays:
//! `cargo bench --no-default-features --features ecs,generate --bench query`.
//!
//! The ground is 4096² samples of ridges a metre apart, all of it resident.

use bevy::app::ScheduleRunnerPlugin;
use bevy::asset::AssetPlugin;
use bevy::ecs::system::SystemState;
use bevy::math::DVec2;
use bevy::prelude::*;
use bevy_tessera::bake::generate::{GenerateSettings, GeneratedSource, GeneratorKind};
use bevy_tessera::bake::{BakeSettings, bake};
use bevy_tessera::query::{BlockRanges, TerrainQuery};
use bevy_tessera::stream::{TerrainPin, TerrainRegion, TerrainState, TerrainStreaming};
use bevy_tessera::terrain::{Terrain, TerrainPlugin};
use bevy_tessera::tile::TileAddress;
use criterion::{BenchmarkId, Criterion, Throughput};
use std::hint::black_box;
use std::path::Path;
use std::time::{Duration, Instant};

const SIDE: u32 = 4096;

struct Random(u64);

impl Random {
    /// 0 to 1.
    fn unit(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn place(&mut self) -> DVec2 {
        DVec2::new(self.unit(), self.unit()) * f64::from(SIDE - 1)
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

/// Rays from eyes above random places, `far_m` metres away from what they look at.
fn rays(
    query: &TerrainQuery,
    terrain: Entity,
    far_m: std::ops::Range<f64>,
    down: std::ops::Range<f64>,
) -> Vec<(Ray3d, f32)> {
    let mut random = Random(7);
    let mut rays = Vec::new();
    while rays.len() < 4096 {
        let at = random.place();
        let heading = DVec2::from_angle(random.unit() * std::f64::consts::TAU);
        let pitch = (down.start + (down.end - down.start) * random.unit()).to_radians();
        let far_m = far_m.start + (far_m.end - far_m.start) * random.unit();
        let way = Vec3::new(
            (heading.x * pitch.cos()) as f32,
            -pitch.sin() as f32,
            (heading.y * pitch.cos()) as f32,
        );
        let ground = query.height(terrain, at).expect("on the terrain").height_m;
        let target = Vec3::new(at.x as f32, ground as f32, at.y as f32);
        let origin = target - way * far_m as f32;
        let eye = query.height(terrain, origin.xz().as_dvec2());
        // From above the ground, on the terrain.
        if eye.is_some_and(|eye| eye.height_m + 1.0 < f64::from(origin.y)) {
            let towards = Dir3::new(way).expect("a direction");
            rays.push((Ray3d::new(origin, towards), f32::INFINITY));
        }
    }
    rays
}

fn main() {
    let mut criterion = Criterion::default().configure_from_args();
    // `cargo test --benches` only wants to see it compile.
    if !std::env::args().any(|argument| argument == "--bench") {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let dir = folder.path().join("ground");
    let settings = GenerateSettings {
        relief_m: 400.0,
        ..GenerateSettings::new(GeneratorKind::Ridged, [SIDE, SIDE])
    };
    let mut source = GeneratedSource::new(settings).expect("can be made");
    bake(&mut source, &dir, &BakeSettings::default(), &()).expect("baked");
    let (mut app, terrain) = settled(&dir);
    let mut state = SystemState::<TerrainQuery>::new(app.world_mut());
    let query = state.get(app.world()).expect("valid");

    let mut random = Random(3);
    let places: Vec<_> = (0..10_000).map(|_| random.place()).collect();
    // As the wheels of a column of vehicles are: near each other.
    let near: Vec<_> = (0..10_000)
        .map(|n| {
            DVec2::new(
                900.0 + f64::from(n % 100) * 0.7,
                1200.0 + f64::from(n / 100) * 0.7,
            )
        })
        .collect();
    let mut group = criterion.benchmark_group("query");
    let mut next = near.iter().cycle();
    group.bench_function("height, near each other", |bencher| {
        bencher.iter(|| query.height(terrain, *next.next().expect("endless")));
    });
    let mut next = places.iter().cycle();
    group.bench_function("height, all over", |bencher| {
        bencher.iter(|| query.height(terrain, *next.next().expect("endless")));
    });
    group.bench_function("normal", |bencher| {
        bencher.iter(|| query.normal(terrain, *next.next().expect("endless")));
    });
    group.bench_function("under", |bencher| {
        bencher.iter(|| {
            let at = next.next().expect("endless").as_vec2();
            query.under(Vec3::new(at.x, 100.0, at.y))
        });
    });
    for (name, places) in [("all over", &places), ("near each other", &near)] {
        group.throughput(Throughput::Elements(places.len() as u64));
        group.bench_function(BenchmarkId::new("10 000 heights", name), |bencher| {
            bencher.iter(|| black_box(query.heights(terrain, places)));
        });
    }
    group.throughput(Throughput::Elements(1));

    let missing: Vec<_> = {
        let mut random = Random(9);
        let eye = |random: &mut Random| {
            let at = random.place().as_vec2();
            Vec3::new(at.x, 395.0, at.y)
        };
        (0..4096)
            .map(|_| {
                let (from, to) = (eye(&mut random), eye(&mut random));
                let towards = Dir3::new(to - from).unwrap_or(Dir3::X);
                (Ray3d::new(from, towards), f32::INFINITY)
            })
            .collect()
    };
    // The pixels of a camera that flies 250 m above the ground.
    let pixels: Vec<_> = {
        let mut random = Random(11);
        let at = DVec2::splat(f64::from(SIDE) / 2.0);
        let ground = query.height(terrain, at).expect("on the terrain").height_m;
        let eye = Vec3::new(at.x as f32, ground as f32 + 250.0, at.y as f32);
        let camera =
            Transform::from_translation(eye).looking_to(Vec3::new(1.0, -0.4, 0.6), Vec3::Y);
        (0..4096)
            .map(|_| {
                let [right, up] = [0.7, 0.4].map(|side| side * (2.0 * random.unit() as f32 - 1.0));
                let way = camera.rotation * Vec3::new(right, up, -1.0);
                (
                    Ray3d::new(eye, Dir3::new(way).expect("a direction")),
                    f32::INFINITY,
                )
            })
            .collect()
    };
    for (name, rays) in [
        ("of a camera's pixels", pixels),
        ("down", rays(&query, terrain, 100.0..2000.0, 80.0..90.0)),
        (
            "100 m to 2 km, 10° to 60° down",
            rays(&query, terrain, 100.0..2000.0, 10.0..60.0),
        ),
        (
            "2 km, 2° to 6° down",
            rays(&query, terrain, 1900.0..2000.0, 2.0..6.0),
        ),
        ("missing, over the summits", missing),
    ] {
        let hits: Vec<_> = query.rays(&rays).into_iter().flatten().collect();
        let way_m: f32 = hits.iter().map(|hit| hit.distance).sum();
        println!(
            "{name}: {} of {} hit, {} m on average",
            hits.len(),
            rays.len(),
            way_m / hits.len() as f32
        );
        let mut next = rays.iter().cycle();
        group.bench_function(BenchmarkId::new("ray", name), |bencher| {
            bencher.iter(|| {
                let (ray, far) = *next.next().expect("endless");
                query.ray(ray, far)
            });
        });
        group.throughput(Throughput::Elements(rays.len() as u64));
        group.bench_function(BenchmarkId::new("4096 rays", name), |bencher| {
            bencher.iter(|| black_box(query.rays(&rays)));
        });
        group.throughput(Throughput::Elements(1));
    }

    let state = app.world().get::<TerrainState>(terrain).expect("is there");
    let tile = state
        .tile_data(TileAddress::new(0, 9, 9))
        .expect("resident");
    group.bench_function("a tile's blocks", |bencher| {
        bencher.iter(|| BlockRanges::new(&tile.heights));
    });
    let mut blocks = BlockRanges::new(&tile.heights);
    group.bench_function(
        "a tile's blocks again where a crater of 16 m is",
        |bencher| {
            bencher.iter(|| blocks.refresh(&tile.heights, [40, 40], [74, 74]));
        },
    );
    group.finish();
}
