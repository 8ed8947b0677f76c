//! What the parts of a bake cost, in samples per second. The whole of it is what `tessera bake`
//! prints.

use bevy_tessera::bake::import::{self, ImportSettings};
use bevy_tessera::bake::{BakeSettings, bake, tent_row};
use bevy_tessera::error_bound::{ErrorScratch, tile_errors};
use bevy_tessera::tile::{HeightTile, TileAddress};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use std::hint::black_box;
use std::time::Duration;

const WIDTH: usize = 4097;

fn wave(x: usize, z: usize) -> f32 {
    ((x * x + z * 31) as f32 * 0.001).sin() * 30.0 + (z as f32 * 0.1).cos() * 4.0 + 40.0
}

fn rows(criterion: &mut Criterion) {
    let heights: Vec<Vec<u16>> = (0..3)
        .map(|z| (0..WIDTH).map(|x| (wave(x, z) * 500.0) as u16).collect())
        .collect();
    let mut group = criterion.benchmark_group("bake/row");
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
    let bytes = tile.encode(address, 7);
    let mut group = criterion.benchmark_group("bake/tile");
    group.throughput(Throughput::Bytes(bytes.len() as u64));
    group.bench_function("encode", |bencher| {
        bencher.iter(|| black_box(black_box(&tile).encode(address, 7)));
    });
    group.bench_function("decode", |bencher| {
        bencher.iter(|| HeightTile::decode(black_box(&bytes), address));
    });
    group.finish();
    let samples = [385, 385];
    let heights: Vec<u16> = (0..385 * 385)
        .map(|at| (wave(at % 385, at / 385) * 500.0) as u16)
        .collect();
    let row = |z: u32| &heights[z as usize * 385..][..385];
    let mut group = criterion.benchmark_group("bake/tile");
    group.throughput(Throughput::Elements(128 * 128));
    group.bench_function("error bounds", |bencher| {
        let mut scratch = ErrorScratch::default();
        bencher.iter(|| tile_errors(samples, [128, 128], black_box(row), &mut scratch));
    });
    group.finish();
}

fn whole(criterion: &mut Criterion) {
    let size = [4097, 2049];
    let codes: Vec<u16> = (0..size[0] as usize * size[1] as usize)
        .map(|at| (wave(at % size[0] as usize, at / size[0] as usize) * 500.0) as u16)
        .collect();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let source = folder.path().join("source.r16");
    let bytes: Vec<u8> = codes.iter().flat_map(|code| code.to_le_bytes()).collect();
    std::fs::write(&source, bytes).expect("the disk has room");
    let out = folder.path().join("terrain");
    let import = ImportSettings {
        size: Some(size),
        ..Default::default()
    };
    let mut group = criterion.benchmark_group("bake");
    group.sample_size(20);
    group.throughput(Throughput::Elements(
        u64::from(size[0]) * u64::from(size[1]),
    ));
    for (name, leave_out_densities, leave_out_errors) in [
        ("4097 x 2049 u16 to disk", false, false),
        ("the same without densities", true, false),
        ("the same without error bounds", false, true),
    ] {
        let settings = BakeSettings {
            leave_out_densities,
            leave_out_errors,
            ..Default::default()
        };
        group.bench_function(name, |bencher| {
            bencher.iter_custom(|times| {
                let mut elapsed = Duration::ZERO;
                for _ in 0..times {
                    let mut source = import::open(&source, &import).expect("a good source");
                    let report = bake(&mut *source, &out, &settings, &());
                    elapsed += report.expect("the bake succeeds").elapsed;
                    std::fs::remove_dir_all(&out).expect("it can be removed");
                }
                elapsed
            });
        });
    }
    group.finish();
}

criterion_group!(benches, rows, tiles, whole);
criterion_main!(benches);
