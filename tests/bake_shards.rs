//! A bake in parts makes the bytes of one bake, whatever the parts, and however often they are stopped;
//! and parts that don't fit together are refused by name.
#![cfg(unix)]

mod bake_support;
#[path = "bake_shards/tool.rs"]
mod tool;

use bake_support::{densities, entries, errors, heights, landscape, source};
use bevy_tessera::bake::import::{self, ImportSettings};
use bevy_tessera::bake::shard::{PartFile, Shard, ShardError, ShardReport, bake_shard, merge};
use bevy_tessera::bake::{self, BakeSettings, HeightSource, SourceError};
use bevy_tessera::density::{DensityBorder, DensityFilter, DensitySettings};
use bevy_tessera::tile::{TerrainTile, TileAddress, encode_tile, tile_path};
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, SystemTime};

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

fn shard(number: u32, count: u32) -> Shard {
    Shard::new(number, count).expect("there is such a shard")
}

fn part_name(dir: &Path, number: u32) -> PathBuf {
    dir.join(format!("part{number}"))
}

/// Every file below a folder, and folders as such.
fn tree(dir: &Path) -> BTreeMap<PathBuf, Option<Vec<u8>>> {
    let mut all = BTreeMap::new();
    let mut open = vec![dir.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(&folder).expect("readable") {
            let path = entry.expect("readable").path();
            let below = path.strip_prefix(dir).expect("below").to_owned();
            if path.is_dir() {
                all.insert(below, None);
                open.push(path);
            } else {
                all.insert(below, Some(fs::read(&path).expect("readable")));
            }
        }
    }
    all
}

fn assert_same_tree(a: &Path, b: &Path, what: &str) {
    let (a, b) = (tree(a), tree(b));
    assert!(a.len() > 3, "{what}: a terrain has files");
    let names = |tree: &BTreeMap<PathBuf, _>| tree.keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(&a), names(&b), "{what}");
    for (path, bytes) in &a {
        assert!(*bytes == b[path], "{what}: {} differs", path.display());
    }
}

/// Bakes and merges all shards in `dir`; returns the terrain.
fn bake_in_parts(
    dir: &Path,
    count: u32,
    settings: &BakeSettings,
    open: &mut dyn FnMut() -> Box<dyn HeightSource>,
) -> PathBuf {
    let mut parts = Vec::new();
    // Not in their order.
    for number in (1..=count).rev() {
        let part = part_name(dir, number);
        bake_shard(&mut *open(), &part, settings, shard(number, count), &())
            .unwrap_or_else(|e| panic!("{e}"));
        parts.push(part);
    }
    let out = dir.join("merged");
    merge(&parts, &out, false, &()).unwrap_or_else(|e| panic!("{e}"));
    out
}

fn some_settings(seed: u32) -> DensitySettings {
    let pick = |of: u32, from: u32| (seed / from) % of;
    let filter_size = [1_u32, 2, 7, 32][pick(4, 48) as usize];
    let widest = DensitySettings::LOD_SKIP_RANGE;
    let lod_skip = pick(5, 384).min((64 / filter_size).ilog2());
    assert!(widest.contains(&lod_skip));
    DensitySettings {
        filter: DensityFilter::ALL[pick(6, 1) as usize],
        gain: 0.4,
        exponent: [1.0, 0.75][pick(2, 6) as usize],
        preprocess: pick(4, 12) != 0,
        filter_size,
        border: DensityBorder::ALL[pick(2, 192) as usize],
        lod_skip,
    }
}

fn assert_parts_make_the_whole(size: [u32; 2], count: u32, seed: u32, band_rows: Option<u32>) {
    let folder = folder();
    let dir = folder.path();
    let mut metres = landscape(size, seed);
    if seed.is_multiple_of(3) {
        // Gaps of all sorts, the largest across shards.
        for (at, height) in metres.iter_mut().enumerate() {
            let (x, z) = (at as u32 % size[0], at as u32 / size[0]);
            if (x / 7 + z / 11).is_multiple_of(9) || (z * 3 > size[1] && z * 2 < size[1]) {
                *height = f32::NAN;
            }
        }
        metres[0] = 3.0;
    }
    let settings = BakeSettings {
        band_rows,
        spacing_m: Some(3.0),
        // Some samples are clamped.
        height_range_m: (seed % 5 < 2).then_some(-20.5..=61.7),
        density: some_settings(seed),
        ..Default::default()
    };
    let whole = dir.join("whole");
    let report = bake::bake(&mut source(size, metres.clone()), &whole, &settings, &())
        .unwrap_or_else(|e| panic!("{e}"));
    let mut parts = Vec::new();
    for number in 1..=count {
        let part = part_name(dir, number);
        let mut source = source(size, metres.clone());
        bake_shard(&mut source, &part, &settings, shard(number, count), &())
            .unwrap_or_else(|e| panic!("{e}"));
        parts.push(part);
    }
    parts.rotate_left(count as usize / 2);
    let out = dir.join("merged");
    let merged = merge(&parts, &out, false, &()).unwrap_or_else(|e| panic!("{e}"));
    let what = format!("{size:?} in {count} parts, seed {seed}");
    assert_same_tree(&whole, &out, &what);
    let mut terrain = merged.terrain.clone();
    terrain.elapsed = report.elapsed;
    assert_eq!(terrain, report, "{what}");
}

#[test]
fn parts_make_the_bytes_of_one_bake() {
    for (number, (size, count)) in [
        ([2, 2], 3),
        ([2, 700], 4),
        ([129, 129], 2),
        ([130, 257], 9),
        ([700, 300], 2),
        ([513, 640], 5),
        // Of two levels, three and four.
        ([9, 4200], 2),
        ([66, 8300], 2),
        ([131, 8193], 1),
        ([40, 8200], 3),
        // Densities that spread over more than a shard.
        ([200, 1290], 7),
    ]
    .into_iter()
    .enumerate()
    {
        for (variant, band_rows) in [None, Some(37)].into_iter().enumerate() {
            let seed = 1577 * number as u32 + 2269 * variant as u32 + 7;
            assert_parts_make_the_whole(size, count, seed, band_rows);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]

    #[test]
    fn parts_of_any_bake_make_its_bytes(
        width in 2_u32..300,
        height in 2_u32..1500,
        count in 1_u32..=9,
        band in 1_u32..400,
        seed in any::<u32>(),
    ) {
        assert_parts_make_the_whole([width, height], count, seed, Some(band));
    }

    #[test]
    fn parts_of_any_tall_bake_make_its_bytes(
        width in 2_u32..20,
        height in 2049_u32..12_000,
        count in 1_u32..=5,
        seed in any::<u32>(),
    ) {
        assert_parts_make_the_whole([width, height], count, seed, None);
    }
}

#[test]
fn parts_of_a_file_of_any_format_make_the_bytes_of_one_bake() {
    let folder = folder();
    let dir = folder.path();
    let size = [300_u32, 420];
    let codes: Vec<u16> = landscape(size, 4)
        .iter()
        .map(|height| ((height + 100.0) * 200.0) as u16)
        .collect();
    let metres: Vec<f32> = codes.iter().map(|&code| f32::from(code) * 0.1).collect();
    let write = |name: &str, bytes: Vec<u8>| {
        fs::write(dir.join(name), bytes).expect("writable");
    };
    let little: Vec<u8> = codes.iter().flat_map(|code| code.to_le_bytes()).collect();
    write("a.r16", little);
    let floats = metres.iter().flat_map(|metres| metres.to_be_bytes());
    write("b.r32", floats.collect());
    let picture = image::ImageBuffer::<image::Luma<u16>, _>::from_raw(size[0], size[1], &codes[..]);
    let picture = picture.expect("a picture");
    picture.save(dir.join("c.png")).expect("writable");
    let mut tiff = Vec::new();
    let mut encoder =
        tiff::encoder::TiffEncoder::new(std::io::Cursor::new(&mut tiff)).expect("an encoder");
    encoder
        .write_image::<tiff::encoder::colortype::Gray32Float>(size[0], size[1], &metres)
        .expect("an image");
    write("d.tif", tiff);
    exr::prelude::write_rgb_file(
        dir.join("e.exr"),
        size[0] as usize,
        size[1] as usize,
        |x, z| {
            let height = metres[z * size[0] as usize + x];
            (height, height, height)
        },
    )
    .expect("writable");
    let srtm: Vec<u8> = landscape([1201, 1201], 9)
        .iter()
        .flat_map(|&height| {
            let void = height > 60.0;
            (if void { i16::MIN } else { height as i16 }).to_be_bytes()
        })
        .collect();
    write("N46E007.hgt", srtm);
    for (name, count) in [
        ("a.r16", 4),
        ("b.r32", 3),
        ("c.png", 2),
        ("d.tif", 4),
        ("e.exr", 2),
        ("N46E007.hgt", 5),
    ] {
        let raw = name.starts_with(['a', 'b']);
        let import = ImportSettings {
            size: raw.then_some(size),
            big_endian: name == "b.r32",
            no_data: (name == "c.png").then(|| f64::from(codes[7777])),
            ..Default::default()
        };
        for range in [None, Some(-50.0..=20_000.0)] {
            let settings = BakeSettings {
                height_range_m: range,
                ..Default::default()
            };
            let work = folder.path().join(format!("{name}-{}", count));
            fs::create_dir_all(&work).expect("a folder");
            let mut open =
                || import::open(&dir.join(name), &import).unwrap_or_else(|e| panic!("{name}: {e}"));
            let whole = work.join("whole");
            bake::bake(&mut *open(), &whole, &settings, &()).unwrap_or_else(|e| panic!("{e}"));
            let merged = bake_in_parts(&work, count, &settings, &mut open);
            assert_same_tree(&whole, &merged, name);
            fs::remove_dir_all(&work).expect("removable");
        }
    }
}

#[test]
fn a_row_with_an_unsound_tile_of_any_level_is_made_again_with_all_rows_after_it() {
    let folder = folder();
    let (size, out) = ([300, 8200], folder.path().join("part"));
    let settings = BakeSettings {
        height_range_m: Some(-50.0..=150.0),
        ..Default::default()
    };
    let bake = || {
        let mut source = source(size, landscape(size, 3));
        bake_shard(&mut source, &out, &settings, shard(2, 2), &()).unwrap_or_else(|e| panic!("{e}"))
    };
    let made = bake();
    let (part, good) = (made.part, tree(&out));
    assert_eq!((part.top, part.rows()), (2, 8..17));
    assert_eq!(bake().tiles_before, made.tiles);
    let columns = |level| part.terrain.tiles(level)[0];
    let of_row: u64 = (0..=part.top)
        .map(|level| u64::from(columns(level)) << (part.top - level))
        .sum();
    for level in 0..=part.top {
        // The first and the last tile of the part's fourth row.
        let up = part.top - level;
        let first = TileAddress::new(level, 0, 11 << up);
        let last = TileAddress::new(level, columns(level) - 1, (12 << up) - 1);
        for (address, damage) in [(first, 0), (last, 1), (first, 2), (last, 3)] {
            let path = out.join(tile_path(address));
            let mut bytes = fs::read(&path).expect("there");
            match damage {
                0 => bytes.clear(),
                1 => bytes.truncate(900),
                2 => bytes[20_000] ^= 4,
                _ => {
                    // A sound tile of another terrain.
                    let (heights, densities) = (heights(&out, address), densities(&out, address));
                    let errors = errors(&out, address);
                    bytes = encode_tile(address, 7, &heights, &densities, &errors);
                }
            }
            fs::remove_file(&path).expect("there");
            if damage > 0 {
                fs::write(&path, bytes).expect("writable");
            }
            assert_eq!(bake().tiles_before, 3 * of_row, "{address}");
            assert!(tree(&out) == good, "{address} differs");
        }
    }
}

/// Counts the rows that are read.
struct Counted {
    size: [u32; 2],
    next: u32,
    read: u32,
}

impl HeightSource for Counted {
    fn name(&self) -> String {
        "counted".to_owned()
    }

    fn size(&self) -> [u32; 2] {
        self.size
    }

    fn may_lack_data(&self) -> bool {
        false
    }

    fn rewind(&mut self) -> Result<(), SourceError> {
        self.next = 0;
        Ok(())
    }

    fn read_row(&mut self, row: &mut [f32]) -> Result<(), SourceError> {
        row.fill(self.next as f32);
        self.next += 1;
        self.read += 1;
        Ok(())
    }

    fn skip_rows(&mut self, rows: u32) -> Result<(), SourceError> {
        self.next += rows;
        Ok(())
    }
}

#[test]
fn a_shard_reads_only_the_rows_that_it_needs() {
    let folder = folder();
    let mut source = Counted {
        size: [40, 16_385],
        next: 0,
        read: 0,
    };
    let settings = BakeSettings {
        height_range_m: Some(0.0..=20_000.0),
        ..Default::default()
    };
    let out = folder.path().join("part");
    let report = bake_shard(&mut source, &out, &settings, shard(2, 4), &()).expect("it bakes");
    assert_eq!(report.part.top, 2);
    // Its own 4096 rows, 97 times 4 to either side but for one, and the first one, by which sources are
    // told apart.
    assert_eq!(source.read, report.source_rows + 1);
    assert_eq!(report.source_rows, 4096 + 2 * 97 * 4 - 1);
}

// The tool.
