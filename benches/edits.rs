//! What edits cost on one core: working out what a crater does on every level, changing all tiles that it
//! touches, and bringing a tile that streams in up to date with a thousand craters.
//!
//! `cargo bench --no-default-features --bench edits`

use bevy_tessera::density::DensitySettings;
use bevy_tessera::edit::mask::{DestructionMask, MaskSettings};
use bevy_tessera::edit::{
    Change, EDIT_UNITS, Edit, EditGround, EditRaster, EditScratch, EditedTile,
};
use bevy_tessera::terrain::{MANIFEST_MAGIC, MANIFEST_VERSION, ManifestFile};
use bevy_tessera::tile::{DensityTile, ErrorTile, HeightTile, TerrainTile, TileAddress};
use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use std::hint::black_box;

/// Samples a side at a spacing of 1 m, which makes 8 levels.
const SIZE: u32 = 128 * 128 + 1;

fn file() -> ManifestFile {
    let size = [SIZE; 2];
    ManifestFile {
        format: MANIFEST_MAGIC.to_owned(),
        version: MANIFEST_VERSION,
        size,
        spacing_m: 1.0,
        height_min_m: -100.0,
        height_step_m: 0.02,
        levels: ManifestFile::levels_for(size),
        density: DensitySettings::default(),
        index_crc32: 0,
    }
}

fn tile(address: TileAddress) -> TerrainTile {
    let mut state = address.x * 31 + address.z;
    let heights = (0..133 * 133_u32)
        .map(|at| {
            let (x, z) = ((at % 133) as f32, (at / 133) as f32);
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let waves = (x * 0.11).sin() * 900.0 + (z * 0.07 + x * 0.013).cos() * 1400.0;
            (20_000.0 + waves + (state >> 28) as f32) as u16
        })
        .collect();
    TerrainTile {
        heights: HeightTile::from_samples(heights).expect("133 by 133"),
        densities: DensityTile::from_samples(vec![40; 35 * 35].into()).expect("35 by 35"),
        errors: ErrorTile::from_texels(vec![[30; 8]; 32 * 32].into()).expect("32 by 32"),
        stamp: 0,
    }
}

/// A crater whose bowl has a radius in metres, with the rim that it comes with.
fn crater(at_m: [f64; 2], radius_m: f64, seed: u32) -> Edit {
    let units = f64::from(EDIT_UNITS);
    Edit {
        centre: at_m.map(|at| (at * units) as i32),
        reach: (radius_m * 1.6 * units) as u32,
        change: Change::Crater {
            depth: (radius_m * 0.3 / 0.02) as u16,
            rim: (radius_m * 0.1 / 0.02) as u16,
            bowl: 40_960,
            roughness: 64,
            seed,
            density: 120,
            scorch: 255,
            may_clamp: false,
        },
    }
}

fn touched(ground: &EditGround, raster: &EditRaster) -> Vec<TileAddress> {
    let mut all = Vec::new();
    for level in 0..ground.levels() {
        let tiles = file().tiles(level);
        let rows = (0..tiles[1]).flat_map(|z| (0..tiles[0]).map(move |x| (x, z)));
        all.extend(
            rows.map(|(x, z)| TileAddress::new(level, x, z))
                .filter(|&address| raster.footprint().touches(address)),
        );
    }
    all
}

fn one_crater(criterion: &mut Criterion) {
    let ground = EditGround::new(&file());
    let mut scratch = EditScratch::default();
    let mut group = criterion.benchmark_group("edits/crater_16m");
    let edit = crater([5000.3, 7777.7], 16.0, 5);
    group.bench_function("raster", |bencher| {
        bencher.iter(|| ground.raster(black_box(&edit), &mut scratch));
    });
    // In the middle of a tile, and on a corner.
    for (name, at) in [("inside", [4990.3, 7744.7]), ("corner", [5120.0, 7680.0])] {
        let edit = crater(at, 16.0, 5);
        let raster = ground.raster(&edit, &mut scratch);
        let addresses = touched(&ground, &raster);
        let tiles: Vec<_> = addresses
            .iter()
            .map(|&address| EditedTile::new(address, tile(address)))
            .collect();
        let label = format!("raster_and_{}_tiles_{name}", tiles.len());
        let mut apply = |tiles: &mut Vec<EditedTile>| {
            let raster = ground.raster(black_box(&edit), &mut scratch);
            for tile in tiles {
                black_box(tile.apply(&ground, &raster, &mut scratch));
            }
        };
        let mut warm = tiles.clone();
        group.bench_function(format!("{label}/edited_before"), |bencher| {
            bencher.iter(|| apply(&mut warm));
        });
        group.bench_function(format!("{label}/first_edit"), |bencher| {
            bencher.iter_batched_ref(|| tiles.clone(), &mut apply, BatchSize::SmallInput);
        });
    }
    group.finish();
}

fn replay(criterion: &mut Criterion) {
    let ground = EditGround::new(&file());
    let mut scratch = EditScratch::default();
    let mut group = criterion.benchmark_group("edits/replay_1000");
    group.sample_size(30);
    for level in [0, 3] {
        let address = TileAddress::new(level, 3, 5);
        let side = f64::from(128 << level);
        for radius_m in [4.0, 8.0, 16.0] {
            let rasters: Vec<_> = (0..1000_u32)
                .map(|number| {
                    let part = |factor: f64| (f64::from(number) * factor).fract() * side;
                    let at = [part(0.618_034) + 3.0 * side, part(0.754_878) + 5.0 * side];
                    ground.raster(&crater(at, radius_m, number), &mut scratch)
                })
                .collect();
            let edits: Vec<_> = rasters
                .iter()
                .map(|raster| (raster.edit(), raster.footprint()))
                .collect();
            let base = tile(address);
            group.bench_function(format!("level_{level}/radius_{radius_m}m"), |bencher| {
                bencher.iter(|| {
                    let edits = black_box(&edits).iter().copied();
                    EditedTile::replay(&ground, address, base.clone(), edits, &mut scratch)
                });
            });
        }
    }
    group.finish();
}

/// What craters leave in the mask of scorched earth.
fn mask(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("mask");
    for radius_m in [4.0, 16.0] {
        let mut mask = DestructionMask::new(1.0, &MaskSettings::default());
        let mut number = 0_u32;
        group.bench_function(format!("draw/radius_{radius_m}m"), |bencher| {
            bencher.iter(|| {
                number += 1;
                let at = f64::from(number % 64) * 2.3;
                mask.draw(black_box(&crater(
                    [300.0 + at, 300.0 - at],
                    radius_m,
                    number,
                )))
            });
        });
        let mut mask = DestructionMask::new(1.0, &MaskSettings::default());
        for number in 0..1000_u32 {
            let at = |factor: f64| (f64::from(number) * factor).fract() * 2000.0;
            mask.draw(&crater([at(0.618_034), at(0.754_878)], radius_m, number));
        }
        println!(
            "1000 craters of {radius_m} m over 2 x 2 km: {} pages, {} bytes a crater",
            mask.page_count(),
            mask.bytes() / 1000
        );
    }
    group.finish();
}

criterion_group!(benches, one_crater, replay, mask);
criterion_main!(benches);
