//! A terrain in one file is the terrain that was packed, or an error.

mod bake_support;

use bake_support::{bake_heights, entries, landscape, manifest};
use bevy_tessera::archive::{
    ArchiveError, ArchiveWriter, FileRange, RangeError, RangeSource, TerrainArchive, bake_archive,
    tile_order, unpack_archive, write_archive,
};
use bevy_tessera::bake::{self, BakeSettings, verify_archive};
use bevy_tessera::terrain::{INDEX_FILE, MANIFEST_FILE};
use bevy_tessera::tile::{HeightTile, TerrainTile, TileAddress, TileIndex, TileRange, tile_path};
use futures_lite::StreamExt;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Every file below a folder.
fn contents(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut all = BTreeMap::new();
    let mut folders = vec![dir.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(&folder).expect("readable") {
            let path = entry.expect("readable").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let below = path.strip_prefix(dir).expect("below").to_owned();
                all.insert(below, fs::read(&path).expect("readable"));
            }
        }
    }
    all
}

/// Bytes in memory as a source.
#[derive(Clone)]
struct Bytes(Arc<Vec<u8>>);

impl RangeSource for Bytes {
    fn name(&self) -> String {
        "bytes.pmtiles".to_owned()
    }

    fn read_at(&self, offset: u64, length: usize) -> Result<Vec<u8>, RangeError> {
        let end = offset.saturating_add(length as u64);
        let range = usize::try_from(offset).ok().zip(usize::try_from(end).ok());
        let bytes = range.and_then(|(first, end)| self.0.get(first..end));
        bytes.map(<[u8]>::to_vec).ok_or(RangeError::Short {
            name: self.name(),
            wanted: end,
        })
    }
}

fn open(bytes: Vec<u8>) -> Result<TerrainArchive, ArchiveError> {
    TerrainArchive::open(Bytes(Arc::new(bytes)))
}

fn baked(folder: &Path, size: [u32; 2]) -> PathBuf {
    let dir = folder.join("terrain");
    bake_heights(size, landscape(size, 5), &dir, &BakeSettings::default());
    dir
}

fn temporary() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// Takes fine tiles of the western half away.
fn without_west(dir: &Path) {
    let mut terrain = manifest(dir);
    let all: Vec<_> = terrain.index.iter().map(|(address, _)| address).collect();
    for &address in &all {
        if address.level == 0 && address.x < 2 {
            terrain.index.set(address, None);
            fs::remove_file(dir.join(tile_path(address))).expect("it was there");
        }
    }
    for &address in &all {
        if terrain.index.get(address).is_some() {
            let bytes = fs::read(dir.join(tile_path(address))).expect("readable");
            let own = HeightTile::decode(&bytes, address).expect("good").range();
            let children = address.children().into_iter().flatten();
            let range = children
                .filter_map(|child| terrain.index.get(child))
                .fold(own, TileRange::union);
            terrain.index.set(address, Some(range));
        }
    }
    let index = terrain.index.encode();
    terrain.file.index_crc32 = crc32fast::hash(&index);
    fs::write(dir.join(INDEX_FILE), index).expect("writable");
    let text = ron::to_string(&terrain.file).expect("it can be told");
    fs::write(dir.join(MANIFEST_FILE), text).expect("writable");
}

#[test]
fn a_folder_that_was_packed_and_unpacked_is_the_same_byte_for_byte() {
    for (size, missing) in [([600, 300], false), ([100, 60], false), ([600, 300], true)] {
        let folder = temporary();
        let dir = baked(folder.path(), size);
        if missing {
            without_west(&dir);
        }
        let out = folder.path().join("terrain.pmtiles");
        let report = write_archive(&dir, &out, false, &()).expect("packed");
        let before = contents(&dir);
        assert_eq!(report.tiles, before.len() as u64 - 2);
        assert_eq!(
            report.archive_bytes,
            fs::metadata(&out).expect("there").len()
        );
        let archive = TerrainArchive::open_file(&out).expect("good");
        assert_eq!(archive.terrain(), &manifest(&dir));
        let [ron, index] = [MANIFEST_FILE, INDEX_FILE].map(|name| &before[Path::new(name)]);
        let (held_ron, held_index) = archive.manifest();
        assert!(held_ron.as_bytes() == ron && held_index == index);
        for (address, _) in archive.terrain().index.iter() {
            let bytes = archive.tile(address).expect("readable").expect("there");
            let tile = TerrainTile::decode(&bytes, address).expect("good");
            assert!(tile.encode(address) == before[Path::new(&tile_path(address))]);
        }
        let absent = TileAddress::new(0, 4_000_000, 0);
        assert!(archive.tile(absent).expect("readable").is_none());
        if missing {
            let west = archive.tile(TileAddress::new(0, 0, 0)).expect("readable");
            assert!(west.is_none());
        }
        let checked = verify_archive(&archive, &|_| {});
        assert_eq!((checked.tiles, checked.faults.len()), (report.tiles, 0));

        let again = folder.path().join("again");
        unpack_archive(&archive, &again, false, &()).expect("unpacked");
        assert!(contents(&again) == before);
        let error = unpack_archive(&archive, &again, false, &()).expect_err("it exists");
        assert!(error.to_string().contains("--force"), "{error}");
        unpack_archive(&archive, &again, true, &()).expect("replaced");
        assert_eq!(
            entries(folder.path()),
            ["again", "terrain", "terrain.pmtiles"]
        );
    }
}

#[test]
fn the_same_terrain_makes_the_same_bytes() {
    let folder = temporary();
    let dir = baked(folder.path(), [600, 300]);
    let [a, b] = ["a.pmtiles", "b.pmtiles"].map(|name| folder.path().join(name));
    write_archive(&dir, &a, false, &()).expect("packed");
    let one = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .expect("a pool");
    one.install(|| write_archive(&dir, &b, false, &()))
        .expect("packed");
    let [a, b] = [a, b].map(|path| fs::read(path).expect("readable"));
    assert!(a == b);
    let c = folder.path().join("c.pmtiles");
    let mut source = bake_support::source([600, 300], landscape([600, 300], 5));
    bake_archive(&mut source, &c, &BakeSettings::default(), &()).expect("baked");
    assert!(fs::read(&c).expect("readable") == a);
    assert_eq!(
        entries(folder.path()),
        ["a.pmtiles", "b.pmtiles", "c.pmtiles", "terrain"]
    );
}

#[test]
fn equal_tiles_are_stored_once() {
    let folder = temporary();
    let dir = folder.path().join("flat");
    let flat = vec![12.0; 2049 * 2049];
    bake_heights([2049, 2049], flat, &dir, &BakeSettings::default());
    let out = folder.path().join("flat.pmtiles");
    let report = write_archive(&dir, &out, false, &()).expect("packed");
    assert_eq!(report.tiles, 256 + 64 + 16 + 4 + 1);
    let bytes = fs::read(&out).expect("readable");
    // PMTiles' own counts: tiles, entries, contents.
    let count = |at: usize| u64::from_le_bytes(bytes[at..at + 8].try_into().expect("eight"));
    assert_eq!([72, 80, 88].map(count), [report.tiles, 1, 1]);
    assert!(report.archive_bytes < 25_000, "{report:?}");
}

#[test]
fn any_truncated_archive_is_refused() {
    let folder = temporary();
    let dir = baked(folder.path(), [300, 200]);
    let out = folder.path().join("a.pmtiles");
    write_archive(&dir, &out, false, &()).expect("packed");
    let bytes = fs::read(&out).expect("readable");
    assert!(open(bytes.clone()).is_ok());
    for length in (0..bytes.len()).step_by(53).chain([bytes.len() - 1]) {
        let error = open(bytes[..length].to_vec()).expect_err("truncated");
        let short = matches!(&error, ArchiveError::Read(RangeError::Short { .. }));
        assert!(short, "{length}: {error}");
    }
    fs::write(&out, &bytes[..bytes.len() - 1]).expect("writable");
    let error = TerrainArchive::open_file(&out)
        .expect_err("truncated")
        .to_string();
    assert!(
        error.contains("a.pmtiles") && error.contains("truncated"),
        "{error}"
    );
    let missing = folder.path().join("none.pmtiles");
    let error = TerrainArchive::open_file(&missing)
        .expect_err("missing")
        .to_string();
    assert!(error.ends_with("none.pmtiles is missing"), "{error}");
}

#[test]
fn no_flipped_byte_makes_another_terrain() {
    let folder = temporary();
    let dir = baked(folder.path(), [300, 200]);
    let out = folder.path().join("a.pmtiles");
    write_archive(&dir, &out, false, &()).expect("packed");
    let good = fs::read(&out).expect("readable");
    let archive = open(good.clone()).expect("good");
    let wanted: Vec<_> = tile_order(&archive.terrain().index)
        .into_iter()
        .map(|address| (address, archive.tile(address).expect("readable")))
        .collect();
    let number = |at: usize| u64::from_le_bytes(good[at..at + 8].try_into().expect("eight"));
    // Between root directory and metadata lies nothing.
    let nothing = number(8) + number(16)..number(24);
    let mut unnoticed = Vec::new();
    for at in (0..good.len()).filter(|&at| !nothing.contains(&(at as u64))) {
        let tile_data = at as u64 >= number(56);
        if tile_data && !at.is_multiple_of(101) {
            continue;
        }
        let mut bytes = good.clone();
        bytes[at] ^= 1 << (at % 8);
        let Ok(other) = open(bytes) else {
            assert!(!tile_data, "byte {at} is a tile's");
            continue;
        };
        assert!(other.manifest() == archive.manifest(), "byte {at}");
        let mut errors = 0;
        for (address, wanted) in &wanted {
            let found = other.tile(*address);
            let read = found.as_ref().ok().and_then(|bytes| bytes.as_ref());
            match read.map(|bytes| TerrainTile::decode(bytes, *address)) {
                Some(Ok(_)) => assert!(found.expect("readable") == *wanted, "byte {at}"),
                _ => errors += 1,
            }
        }
        assert!(!tile_data || errors == 1, "byte {at}: {errors}");
        if errors == 0 {
            unnoticed.push(at);
        }
    }
    // Some of the header that no terrain has a use for (where on Earth it lies, how many tiles
    // are equal), and gzip's own notes on time and system.
    assert!(unnoticed.len() < 80, "{unnoticed:?}");
}

#[test]
fn what_is_no_terrain_archive_is_refused_by_name() {
    let refused = |bytes: &[u8]| open(bytes.to_vec()).expect_err("refused");
    let text = [b"not an archive but a text".as_slice(), &[b' '; 20_000]].concat();
    for bytes in [&text[..], &text[..25]] {
        assert!(matches!(refused(bytes), ArchiveError::Magic { .. }));
    }
    let folder = temporary();
    let dir = baked(folder.path(), [100, 60]);
    let out = folder.path().join("a.pmtiles");
    write_archive(&dir, &out, false, &()).expect("packed");
    let good = fs::read(&out).expect("readable");
    let mut older = good.clone();
    older[7] = 2;
    let error = refused(&older);
    assert!(
        matches!(error, ArchiveError::PmTilesVersion { found: 2, .. }),
        "{error}"
    );

    let map = |kind, metadata: &str| {
        let path = folder.path().join("map");
        let writer = pmtiles::PmTilesWriter::new(kind)
            .metadata(metadata)
            .create(fs::File::create(&path).expect("writable"));
        let mut writer = writer.expect("writable");
        let root = pmtiles::TileCoord::new(0, 0, 0).expect("the root");
        writer.add_tile(root, b"tile").expect("writable");
        writer.finalize().expect("writable");
        fs::read(&path).expect("readable")
    };
    let error = refused(&map(pmtiles::TileType::Png, "{}"));
    assert!(error.to_string().contains("perhaps a map"), "{error}");
    let error = refused(&map(pmtiles::TileType::Unknown, "{}"));
    assert!(matches!(error, ArchiveError::NoTerrain { .. }), "{error}");
    let later = r#"{"bevy_tessera":{"format":2}}"#;
    let error = refused(&map(pmtiles::TileType::Unknown, later));
    assert!(
        matches!(error, ArchiveError::Format { found: 2, .. }),
        "{error}"
    );
    let empty = r#"{"bevy_tessera":{"format":1}}"#;
    let error = refused(&map(pmtiles::TileType::Unknown, empty));
    assert!(matches!(error, ArchiveError::Manifest { .. }), "{error}");
    let error = refused(&map(pmtiles::TileType::Unknown, "no JSON"));
    assert!(matches!(error, ArchiveError::Damaged { .. }), "{error}");
}

#[test]
fn only_terrain_archives_are_replaced_and_failures_leave_what_was() {
    let folder = temporary();
    let dir = baked(folder.path(), [300, 200]);
    let place = |name: &str| folder.path().join(name);
    let pack = |name: &str, force| write_archive(&dir, &place(name), force, &());
    let error = pack("a.zip", false)
        .expect_err("another extension")
        .to_string();
    assert!(error.contains(".pmtiles"), "{error}");
    pack("a.pmtiles", false).expect("packed");
    let good = fs::read(place("a.pmtiles")).expect("readable");
    let error = pack("a.pmtiles", false).expect_err("it exists");
    assert!(
        matches!(error, ArchiveError::OutputExists { .. }),
        "{error}"
    );
    // However short: what ends before a header would is not for that a damaged archive.
    let long = "dear diary, ".repeat(2000);
    for text in ["!", "PMTilex", "my diary", "dear diary", &long] {
        fs::write(place("text.pmtiles"), text).expect("writable");
        let error = pack("text.pmtiles", true).expect_err("not ours");
        assert!(
            matches!(error, ArchiveError::OutputNotArchive { .. }),
            "{error}"
        );
        let left = fs::read(place("text.pmtiles")).expect("there");
        assert_eq!(left, text.as_bytes());
        let error = TerrainArchive::open_file(&place("text.pmtiles")).expect_err("no archive");
        assert!(matches!(error, ArchiveError::Magic { .. }), "{error}");
    }
    fs::write(place("cut.pmtiles"), &good[..good.len() / 2]).expect("writable");
    pack("cut.pmtiles", true).expect("a damaged one is replaced");
    assert!(fs::read(place("cut.pmtiles")).expect("there") == good);

    let path = dir.join(tile_path(TileAddress::new(0, 1, 1)));
    let tile = fs::read(&path).expect("readable");
    let mut damaged = tile.clone();
    damaged[3000] ^= 1;
    fs::write(&path, damaged).expect("writable");
    let error = pack("a.pmtiles", true).expect_err("damaged").to_string();
    assert!(
        error.contains("0/1_1") && error.contains("checksum"),
        "{error}"
    );
    assert!(fs::read(place("a.pmtiles")).expect("there") == good);
    assert_eq!(
        entries(folder.path()),
        ["a.pmtiles", "cut.pmtiles", "terrain", "text.pmtiles"]
    );
}

#[test]
fn verify_names_the_bad_tiles_of_an_archive() {
    let folder = temporary();
    let dir = baked(folder.path(), [300, 200]);
    let out = folder.path().join("a.pmtiles");
    let terrain = manifest(&dir);
    let read = |name: &str| fs::read(dir.join(name)).expect("readable");
    let ron = String::from_utf8(read(MANIFEST_FILE)).expect("text");
    let bad = TileAddress::new(0, 1, 0);
    let mut writer = ArchiveWriter::create(&out, &ron, &read(INDEX_FILE), false).expect("writable");
    for address in tile_order(&terrain.index) {
        let bytes = read(&tile_path(address));
        let mut tile = TerrainTile::decode(&bytes, address).expect("good");
        if address == bad {
            let last = tile.heights.samples().len() - 1;
            tile.heights.samples_mut()[last] ^= 1;
        }
        writer.add(address, &tile.pack()).expect("writable");
    }
    writer.finish().expect("writable");
    let archive = TerrainArchive::open_file(&out).expect("good");
    let report = verify_archive(&archive, &|_| {});
    assert!(!report.faults.is_empty());
    for (address, fault) in &report.faults {
        let bake::Fault::HeightBorder { neighbour } = fault else {
            panic!("{address}: {fault}");
        };
        assert!(*address == bad || *neighbour == bad);
    }
}

/// A terrain of so many tiles that directories have leaves; its tiles hold their own address.
#[test]
fn archives_of_many_tiles_have_leaf_directories() {
    let folder = temporary();
    let mut file = manifest(&baked(folder.path(), [100, 60])).file;
    file.size = [128 * 400, 128 * 300];
    file.levels = bevy_tessera::terrain::ManifestFile::levels_for(file.size);
    let mut index = TileIndex::new(&file);
    let mut expected = Vec::new();
    for level in 0..file.levels {
        let [columns, rows] = file.tiles(level);
        for z in 0..rows {
            for x in 0..columns {
                let address = TileAddress::new(level, x, z);
                index.set(address, Some(TileRange { min: 0, max: 9 }));
                expected.push(address);
            }
        }
    }
    assert!(expected.len() > 150_000);
    let index_bytes = index.encode();
    file.index_crc32 = crc32fast::hash(&index_bytes);
    let ron = ron::to_string(&file).expect("it can be told");
    let out = folder.path().join("many.pmtiles");
    let mut writer = ArchiveWriter::create(&out, &ron, &index_bytes, false).expect("writable");
    for address in tile_order(&index) {
        writer
            .add(address, address.to_string().as_bytes())
            .expect("writable");
    }
    writer.finish().expect("writable");
    let archive = TerrainArchive::open_file(&out).expect("good");
    let bytes = fs::read(&out).expect("readable");
    assert_ne!(&bytes[48..56], &[0; 8], "there are leaf directories");
    for address in expected {
        let found = archive.tile(address).expect("readable").expect("there");
        assert_eq!(found, address.to_string().as_bytes());
    }
    // A byte of a leaf directory, which lie last.
    let mut damaged = bytes.clone();
    let at = bytes.len() - 1000;
    damaged[at] ^= 16;
    let archive = open(damaged).expect("the start is good");
    let results: Vec<_> = index
        .iter()
        .map(|(address, _)| archive.tile(address))
        .collect();
    assert!(results.iter().any(Result::is_err));
    for ((address, _), found) in index.iter().zip(results) {
        if let Ok(found) = found {
            assert_eq!(found.expect("there"), address.to_string().as_bytes());
        }
    }
}

impl pmtiles::AsyncBackend for Bytes {
    async fn read(
        &self,
        offset: u64,
        length: usize,
    ) -> Result<pmtiles::BackendResponse, pmtiles::PmtError> {
        let first = offset as usize;
        let end = (first + length).min(self.0.len());
        let part = self.0[first..end].to_vec();
        Ok(pmtiles::BackendResponse::new(part.into()))
    }
}

#[test]
fn other_readers_of_pmtiles_list_an_archive() {
    let folder = temporary();
    let dir = baked(folder.path(), [600, 300]);
    let out = folder.path().join("a.pmtiles");
    write_archive(&dir, &out, false, &()).expect("packed");
    let archive = TerrainArchive::open_file(&out).expect("good");
    let levels = archive.terrain().file.levels;
    let bytes = Bytes(Arc::new(fs::read(&out).expect("readable")));
    futures_lite::future::block_on(async {
        let reader = pmtiles::AsyncPmTilesReader::try_from_source(bytes).await;
        let reader = Arc::new(reader.expect("an archive"));
        assert_eq!(reader.get_header().tile_type, pmtiles::TileType::Unknown);
        assert_eq!(reader.get_header().max_zoom, levels - 1);
        let metadata = reader.get_metadata().await.expect("readable");
        let metadata: serde_json::Value = serde_json::from_str(&metadata).expect("JSON");
        assert_eq!(metadata["bevy_tessera"]["manifest"], archive.manifest().0);
        let mut listed = 0;
        let mut entries = reader.clone().entries();
        while let Some(entry) = entries.next().await {
            listed += entry.expect("good").iter_coords().count();
        }
        assert_eq!(listed, archive.terrain().index.iter().count());
        for (address, _) in archive.terrain().index.iter() {
            let zoom = levels - 1 - address.level;
            let place = pmtiles::TileCoord::new(zoom, address.x, address.z).expect("a place");
            let tile = reader.get_tile(place).await.expect("readable");
            let wanted = archive.tile(address).expect("readable");
            assert_eq!(tile.map(Vec::from), wanted);
        }
    });
}

#[test]
fn a_file_is_read_by_range_and_no_further_than_it_reaches() {
    let folder = temporary();
    let path = folder.path().join("bytes");
    fs::write(&path, b"0123456789").expect("writable");
    let file = FileRange::open(&path).expect("there");
    assert_eq!(file.read_at(3, 4), Ok(b"3456".to_vec()));
    assert_eq!(file.read_at(10, 0), Ok(Vec::new()));
    for (offset, length) in [(7, 4), (u64::MAX, 1), (0, usize::MAX), (11, 0)] {
        let error = file.read_at(offset, length).expect_err("beyond");
        assert!(matches!(error, RangeError::Short { .. }), "{error}");
    }
}

#[test]
fn the_tool_packs_unpacks_bakes_inspects_and_verifies_archives() {
    let folder = temporary();
    let dir = baked(folder.path(), [300, 200]);
    let run = |line: &str| {
        let output = std::process::Command::new(env!("CARGO_BIN_EXE_tessera"))
            .args(line.split(' '))
            .current_dir(folder.path())
            .output()
            .expect("the tool runs");
        let text = [output.stdout, output.stderr].concat();
        (
            output.status.code(),
            String::from_utf8_lossy(&text).into_owned(),
        )
    };
    let good = |line: &str| {
        let (code, text) = run(line);
        assert_eq!(code, Some(0), "{line}: {text}");
        text
    };
    let text = good("pack terrain --out a.pmtiles");
    assert!(text.contains("MB as an archive"), "{text}");
    let (code, text) = run("pack terrain --out a.pmtiles");
    assert!(code == Some(1) && text.contains("--force"), "{text}");
    good("pack terrain --out a.pmtiles --force");
    assert!(good("inspect a.pmtiles").contains("300 x 200 samples"));
    assert!(good("verify a.pmtiles").contains("all good"));
    good("unpack a.pmtiles --out again");
    assert!(contents(&folder.path().join("again")) == contents(&dir));

    fs::write(folder.path().join("map.r16"), vec![7; 150 * 130 * 2]).expect("writable");
    good("bake map.r16 --size 150x130 --height-range-m 0..100 --archive --out b.pmtiles");
    good("bake map.r16 --size 150x130 --height-range-m 0..100 --out b");
    good("pack b --out c.pmtiles");
    let [b, c] = ["b.pmtiles", "c.pmtiles"].map(|name| folder.path().join(name));
    assert!(fs::read(b).expect("there") == fs::read(c).expect("there"));
    let (code, text) = run("verify map.r16");
    assert!(
        code == Some(1) && text.contains("no terrain archive"),
        "{text}"
    );

    let path = folder.path().join("a.pmtiles");
    let mut bytes = fs::read(&path).expect("there");
    let last = bytes.len() - 10;
    bytes[last] ^= 1;
    fs::write(&path, bytes).expect("writable");
    let (code, text) = run("verify a.pmtiles");
    assert!(code == Some(1) && text.contains("checksum"), "{text}");
    let left = [
        "a.pmtiles",
        "again",
        "b",
        "b.pmtiles",
        "c.pmtiles",
        "map.r16",
        "terrain",
    ];
    assert_eq!(entries(folder.path()), left);
}
