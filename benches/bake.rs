//! What the parts of a bake cost, in samples per second. The whole of it is what `tessera bake`
//! prints.

use bevy_tessera::bake::curvature::mean_curvature;
use bevy_tessera::bake::{BakeSettings, MemorySource, bake, tent_row};
use bevy_tessera::tile::{HeightTile, TileAddress};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;

const WIDTH: usize = 4097;

fn wave(x: usize, z: usize) -> f32 {
    ((x * x + z * 31) as f32 * 0.001).sin() * 30.0 + (z as f32 * 0.1).cos() * 4.0 + 40.0
}

fn rows(criterion: &mut Criterion) {
    let relief: Vec<Vec<f32>> = (0..3)
        .map(|z| (0..WIDTH).map(|x| wave(x, z)).collect())
        .collect();
    let heights: Vec<Vec<u16>> = relief
        .iter()
        .map(|row| row.iter().map(|&height| (height * 500.0) as u16).collect())
        .collect();
    let mut group = criterion.benchmark_group("bake/row");
    group.throughput(Throughput::Elements(WIDTH as u64));
    group.bench_function("mean curvature", |bencher| {
        let mut out = vec![0.0; WIDTH];
        bencher.iter(|| {
            mean_curvature(
                black_box(&relief[0]),
                black_box(&relief[1]),
                black_box(&relief[2]),
                &mut out,
            );
            black_box(out[WIDTH / 2])
        });
    });
    // Counted in samples of the finer level, of which two rows make one.
    group.throughput(Throughput::Elements(2 * WIDTH as u64));
    group.bench_function("tent filter", |bencher| {
        let mut out = vec![0; WIDTH / 2 + 1];
        bencher.iter(|| {
            tent_row(
                black_box(&heights[0]),
                black_box(&heights[1]),
                black_box(&heights[2]),
                &mut out,
            );
            black_box(out[WIDTH / 4])
        });
    });
    group.finish();
}

fn tiles(criterion: &mut Criterion) {
    let samples: Box<[u16]> = (0..133 * 133).map(|at| (at * 7 % 60_000) as u16).collect();
    let tile = HeightTile::from_samples(samples).expect("a tile's worth of samples");
    let address = TileAddress::new(0, 3, 5);
    let bytes = tile.encode(address);
    let mut group = criterion.benchmark_group("bake/tile");
    group.throughput(Throughput::Bytes(bytes.len() as u64));
    group.bench_function("encode", |bencher| {
        bencher.iter(|| black_box(black_box(&tile).encode(address)));
    });
    group.bench_function("decode", |bencher| {
        bencher.iter(|| HeightTile::decode(black_box(&bytes), address));
    });
    group.finish();
}

fn whole(criterion: &mut Criterion) {
    let size = [2049, 1025];
    let heights = (0..size[0] as usize * size[1] as usize)
        .map(|at| wave(at % size[0] as usize, at / size[0] as usize))
        .collect();
    let mut source = MemorySource::new(size, heights).expect("sizes match");
    let settings = BakeSettings {
        force: true,
        ..Default::default()
    };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = folder.path().join("terrain");
    let mut group = criterion.benchmark_group("bake");
    group.sample_size(10);
    group.throughput(Throughput::Elements(
        u64::from(size[0]) * u64::from(size[1]),
    ));
    group.bench_function("2049 x 1025 floats to disk", |bencher| {
        bencher.iter(|| bake(&mut source, &out, &settings, &()).expect("the bake succeeds"));
    });
    group.finish();
}

criterion_group!(benches, rows, tiles, whole);
criterion_main!(benches);
