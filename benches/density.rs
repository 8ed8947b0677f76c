//! What densities cost on one core: from the `u16` heights of a tile to its densities, a filter at a
//! time, beside the core's copy bandwidth in the same run.
//!
//! `cargo bench --no-default-features --bench density`

use bevy_tessera::density::{
    DensityExtent, DensityFilter, DensityKernel, DensityScratch, DensitySettings, tile_densities,
};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

/// Samples of a terrain that has tiles on all sides of the one that is measured.
const SIZE: [u32; 2] = [1025, 1025];
const FIRST: [u32; 2] = [256, 384];

/// Rolling ground with fine noise, no two samples alike.
fn heights() -> Vec<u16> {
    let mut state = 1_u32;
    (0..133 * 133_u32)
        .map(|at| {
            let (x, z) = ((at % 133) as f32, (at / 133) as f32);
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let waves = (x * 0.11).sin() * 900.0 + (z * 0.07 + x * 0.013).cos() * 1400.0;
            (20_000.0 + waves + (state >> 24) as f32) as u16
        })
        .collect()
}

fn filters(criterion: &mut Criterion) {
    let heights = heights();
    let mut group = criterion.benchmark_group("density/tile");
    group.throughput(Throughput::Elements(128 * 128));
    let mut bench = |name: String, settings: DensitySettings| {
        let kernel = DensityKernel::new(&settings, 0.02, 1.0, 0);
        let extent = DensityExtent::new(SIZE, 0);
        let mut scratch = DensityScratch::default();
        let mut out = [0; 32 * 32];
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                let heights = black_box(&heights);
                tile_densities(&kernel, &extent, FIRST, heights, &mut scratch, &mut out);
                black_box(out[77])
            });
        });
    };
    for filter in DensityFilter::ALL {
        let settings = DensitySettings {
            filter,
            ..Default::default()
        };
        bench(filter.to_string(), settings);
    }
    let settings = DensitySettings {
        exponent: 2.0,
        ..Default::default()
    };
    bench("mean, exponent 2".to_owned(), settings);
    group.finish();
}

fn copy(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("density/copy");
    // Far beyond the caches, and a tile's worth of floats within them.
    for (name, floats) in [("64 MiB of f32", 1 << 24), ("a tile of f32", 128 * 128)] {
        let source = vec![1.5_f32; floats];
        let mut target = vec![0.0_f32; floats];
        group.throughput(Throughput::Bytes(4 * floats as u64));
        group.bench_function(name, |bencher| {
            bencher.iter(|| {
                target.copy_from_slice(black_box(&source));
                black_box(&mut target);
            });
        });
    }
    group.finish();
}

criterion_group!(benches, copy, filters);
criterion_main!(benches);
