//! The log of edits with 100 000 of them: `cargo bench --no-default-features --bench edit_log`.
//!
//! The terrain has 16384² samples; a thousand edits may touch the tile that is asked for, the others
//! lie anywhere. Bytes of files are printed first.

use bevy_tessera::density::DensitySettings;
use bevy_tessera::edit::{Change, Edit, EditLog, SampleRect};
use bevy_tessera::terrain::{MANIFEST_MAGIC, MANIFEST_VERSION, ManifestFile};
use bevy_tessera::tile::TileAddress;
use criterion::{BatchSize, Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use std::sync::Arc;

const EDITS: u32 = 100_000;
const CROWDED: u32 = 1000;
const TILE: TileAddress = TileAddress::new(0, 40, 70);

fn terrain() -> ManifestFile {
    let size = [16_385; 2];
    ManifestFile {
        format: MANIFEST_MAGIC.to_owned(),
        version: MANIFEST_VERSION,
        size,
        spacing_m: 1.0,
        height_min_m: 0.0,
        height_step_m: 0.01,
        levels: ManifestFile::levels_for(size),
        density: DensitySettings::default(),
        index_crc32: 0,
    }
}

/// Numbers that look random.
struct Random(u64);

impl Random {
    fn below(&mut self, end: u32) -> u32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (((self.0 >> 32) * u64::from(end)) >> 32) as u32
    }
}

/// Craters of 3 to 18 m radius, as bombs make them.
fn crater(random: &mut Random, centre: [u32; 2]) -> Arc<Edit> {
    Arc::new(Edit {
        centre: centre.map(u32::cast_signed),
        reach: 300 + random.below(1500),
        change: Change::Crater {
            depth: 100 + random.below(300) as u16,
            rim: 20 + random.below(80) as u16,
            bowl: 43_690,
            roughness: 64,
            seed: random.below(u32::MAX),
            density: random.below(256) as u8,
            scorch: 255,
            may_clamp: false,
        },
    })
}

fn edits() -> Vec<Arc<Edit>> {
    let mut random = Random(1);
    let edit = |at: u32| {
        // Every hundredth lies on the tile, the others anywhere.
        let centre = if at.is_multiple_of(EDITS / CROWDED) {
            let first = [TILE.x, TILE.z].map(|tile| tile * 128 * 64);
            first.map(|first| first + random.below(128 * 64))
        } else {
            [0; 2].map(|_| random.below(16_384 * 64))
        };
        crater(&mut random, centre)
    };
    (0..EDITS).map(edit).collect()
}

fn log_of(edits: &[Arc<Edit>]) -> EditLog {
    let mut log = EditLog::new(&terrain());
    for edit in edits {
        log.push(edit.clone()).expect("a good edit");
    }
    log
}

fn edit_log(c: &mut Criterion) {
    let edits = edits();
    let log = log_of(&edits);
    let binary = log.encode();
    let text = log.to_ron();
    println!(
        "{EDITS} craters: {:.1} bytes each in a binary file, {:.1} as RON; {} touch the tile; an edit has \
         {} bytes in memory, its record {}",
        binary.len() as f64 / f64::from(EDITS),
        text.len() as f64 / f64::from(EDITS),
        log.active_touching(TILE).len(),
        size_of::<Edit>(),
        size_of::<bevy_tessera::edit::EditRecord>(),
    );
    let mut group = c.benchmark_group("edit_log");
    group.bench_function("active_touching a tile, 1000 edits on it", |b| {
        b.iter(|| black_box(log.active_touching(black_box(TILE))));
    });
    let quiet = TileAddress::new(0, 100, 20);
    println!("{} touch the quiet tile", log.active_touching(quiet).len());
    group.bench_function("active_touching a quiet tile", |b| {
        b.iter(|| black_box(log.active_touching(black_box(quiet))));
    });
    let last = log.last_sequence();
    group.bench_function("active_in_after, 10 new edits", |b| {
        let all = SampleRect::new([0; 2], [16_385; 2]);
        b.iter(|| black_box(log.active_in_after(black_box(all), last - 10)));
    });
    group.bench_function("push", |b| {
        let mut long = log.clone();
        let mut next = edits.iter().cycle();
        b.iter(|| {
            let edit = next.next().expect("there is always one").clone();
            black_box(long.push(edit)).expect("a good edit")
        });
    });
    group.bench_function("undo and redo", |b| {
        let mut log = log.clone();
        let mut random = Random(2);
        b.iter(|| {
            let sequence = u64::from(random.below(EDITS)) + 1;
            log.undo(sequence).expect("it is active");
            log.redo(sequence).expect("it is undone")
        });
    });
    group.sample_size(10);
    group.bench_function("a log made by 100 000 pushes", |b| {
        b.iter(|| black_box(log_of(&edits)));
    });
    group.bench_function("encode", |b| b.iter(|| black_box(log.encode())));
    group.bench_function("decode", |b| {
        b.iter(|| black_box(EditLog::decode(&binary).expect("it is good")));
    });
    group.bench_function("diff and merge into an empty log", |b| {
        b.iter_batched(
            || EditLog::new(&terrain()),
            |mut late| {
                late.merge(log.diff(0)).expect("it follows");
                late
            },
            BatchSize::PerIteration,
        );
    });
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("saved.edits");
    group.bench_function("save", |b| b.iter(|| log.save(&path).expect("it is saved")));
    group.bench_function("load", |b| {
        b.iter(|| black_box(EditLog::load(&path).expect("it is loaded")));
    });
    group.finish();
}

criterion_group!(benches, edit_log);
criterion_main!(benches);
