//! Ranking tiles by need: `cargo bench --no-default-features --bench planner`.
//!
//! Throughput is in candidates: tiles that are needed, before the capacity cuts any.

use bevy_tessera::density::DensitySettings;
use bevy_tessera::lattice::{Lattice, LodSettings, ViewLod};
use bevy_tessera::residency::{
    Availability, EyePath, PlanTerrain, Planner, ResidentTiles, levels_short,
};
use bevy_tessera::terrain::{MANIFEST_MAGIC, MANIFEST_VERSION, ManifestFile};
use bevy_tessera::tile::{TileAddress, TileIndex, TileRange};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glam::IVec2;
use std::hint::black_box;

/// Pages of the streamer, and tiles of the plan.
const CAPACITY: usize = 4096;

/// 32 km at a metre: 9 levels, 87 381 tiles, 4096 lattice units a metre.
struct World {
    lattice: Lattice,
    available: Availability,
    resident: ResidentTiles,
    eyes: Vec<EyePath>,
}

impl World {
    fn new(reach: f32, eyes: &[([f32; 2], [f32; 2])]) -> Self {
        let size = [32_769, 32_769];
        let file = ManifestFile {
            format: MANIFEST_MAGIC.to_owned(),
            version: MANIFEST_VERSION,
            size,
            spacing_m: 1.0,
            height_min_m: 0.0,
            height_step_m: 0.1,
            levels: ManifestFile::levels_for(size),
            density: DensitySettings::default(),
            index_crc32: 0,
        };
        let mut index = TileIndex::new(&file);
        for level in 0..file.levels {
            let [columns, rows] = file.tiles(level);
            for at in 0..columns * rows {
                let address = TileAddress::new(level, at % columns, at / columns);
                index.set(address, Some(TileRange { min: 0, max: 9 }));
            }
        }
        let lattice = Lattice::new(size, file.levels, 0, 8).unwrap();
        let settings = LodSettings { reach, morph: 1.0 };
        let unit_m = lattice.unit_m(1.0) as f32;
        let eyes = eyes
            .iter()
            .map(|&(at_m, velocity_m)| {
                let eye = IVec2::from(at_m.map(|at| (at / unit_m) as i32));
                EyePath {
                    lod: ViewLod::new(&lattice, &settings, eye, 400_000, true).unwrap(),
                    velocity: velocity_m.map(|speed| speed / unit_m),
                    descent: 0.0,
                }
            })
            .collect();
        Self {
            lattice,
            available: Availability::new(&index),
            resident: ResidentTiles::new(&index),
            eyes,
        }
    }

    fn terrain(&self) -> PlanTerrain<'_> {
        PlanTerrain {
            lattice: &self.lattice,
            available: &self.available,
            resident: &self.resident,
            eyes: &self.eyes,
            pins: &[],
            root_levels: 2,
        }
    }
}

fn plan(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("planner");
    let fast = [212.0, 212.0];
    let cases = [
        (
            "one eye at 300 m/s, 10 s ahead",
            vec![World::new(24.0, &[([15_000.0, 18_000.0], fast)])],
            10.0,
        ),
        (
            "four eyes over two terrains, 4 s ahead",
            vec![
                World::new(
                    12.0,
                    &[
                        ([5_000.0, 9_000.0], fast),
                        ([6_000.0, 9_500.0], [-150.0, 20.0]),
                    ],
                ),
                World::new(
                    12.0,
                    &[
                        ([25_000.0, 9_000.0], [0.0, 300.0]),
                        ([9_000.0, 25_000.0], [0.0, 0.0]),
                    ],
                ),
            ],
            4.0,
        ),
        (
            "one eye at 300 m/s, 4 s ahead",
            vec![World::new(5.5, &[([15_000.0, 18_000.0], fast)])],
            4.0,
        ),
    ];
    for (name, mut worlds, lookahead_s) in cases {
        let mut planner = Planner::default();
        // What the plan asks for is there, as it mostly is while an eye flies.
        let terrains: Vec<_> = worlds.iter().map(World::terrain).collect();
        let plan = planner.plan(&terrains, CAPACITY, lookahead_s).clone();
        for tile in plan.ranked() {
            worlds[tile.terrain as usize].resident.insert(tile.address);
        }
        let terrains: Vec<_> = worlds.iter().map(World::terrain).collect();
        let candidates = plan.candidates();
        group.throughput(Throughput::Elements(candidates as u64));
        group.bench_function(format!("{name}, {candidates} candidates"), |bencher| {
            bencher.iter(|| {
                let plan = planner.plan(black_box(&terrains), CAPACITY, lookahead_s);
                black_box(plan.ranked().len())
            });
        });
    }
    let world = World::new(24.0, &[([15_000.0, 18_000.0], fast)]);
    let mut resident = world.resident.clone();
    resident.insert(TileAddress::new(8, 0, 0));
    group.throughput(Throughput::Elements(1));
    group.bench_function("levels short, all but the root missing", |bencher| {
        let World {
            lattice,
            available,
            eyes,
            ..
        } = &world;
        bencher.iter(|| levels_short(lattice, available, &resident, black_box(&eyes[0].lod)));
    });
    group.finish();
}

criterion_group!(benches, plan);
criterion_main!(benches);
