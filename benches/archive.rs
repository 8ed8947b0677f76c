//! Packing tiles, and unpacking them.

use bevy_tessera::tile::{DensityTile, ErrorTile, HeightTile, TerrainTile};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

/// Bytes of a tile that isn't packed, headers aside.
const RAW_LEN: u64 = 133 * 133 * 2 + 35 * 35 + 32 * 32 * 8;

/// Hills with some roughness, which pack about as well as surveyed ground.
fn hills() -> TerrainTile {
    let mut state = 1_u32;
    let mut noise = move || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as f32 / 8.0
    };
    let heights = (0..133 * 133).map(|at| {
        let (x, z) = ((at % 133) as f32, (at / 133) as f32);
        (30_000.0 + 4000.0 * (x * 0.05).sin() + 3000.0 * (z * 0.03).cos() + noise()) as u16
    });
    let densities = (0..35 * 35).map(|at: u32| (at % 35 * 4 + at / 35 * 2) as u8);
    let texel = |at: u32| -> [u8; 8] {
        std::array::from_fn(|k| {
            if k < 7 {
                (at % 32 / 4 + 20 * k as u32) as u8
            } else {
                0
            }
        })
    };
    TerrainTile {
        heights: HeightTile::from_samples(heights.collect()).expect("a tile's worth"),
        densities: DensityTile::from_samples(densities.collect()).expect("a tile's worth"),
        errors: ErrorTile::from_texels((0..32 * 32).map(texel).collect()).expect("a tile's worth"),
        stamp: 7,
    }
}

fn tiles(criterion: &mut Criterion) {
    let tile = hills();
    let packed = tile.pack();
    let mut group = criterion.benchmark_group("archive/tile");
    group.throughput(Throughput::Bytes(RAW_LEN));
    group.bench_function("pack", |bencher| bencher.iter(|| black_box(&tile).pack()));
    group.bench_function("unpack", |bencher| {
        bencher.iter(|| TerrainTile::unpack(black_box(&packed)));
    });
    group.finish();
}

criterion_group!(benches, tiles);
criterion_main!(benches);
