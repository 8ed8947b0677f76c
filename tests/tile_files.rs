//! Files of a terrain are read as they were written, or refused: no byte of them can change
//! without notice, and nothing that stands in them makes a reader panic or take much memory.

mod bake_support;

use bake_support::{bake_heights, landscape, manifest};
use bevy_tessera::bake::BakeSettings;
use bevy_tessera::terrain::{
    DensitySettings, MANIFEST_VERSION, ManifestError, ManifestFile, TerrainManifest,
};
use bevy_tessera::tile::{
    DensityTile, ErrorTile, HeightTile, TerrainTile, TileAddress, TileFormatError, TileIndex,
    TileKind, TileRange,
};
use proptest::prelude::*;

const ADDRESS: TileAddress = TileAddress::new(3, 70_000, 5);
const STAMP: u32 = 0x0123_4567;

fn density_tile() -> DensityTile {
    let texels = (0..35 * 35).map(|at| (at * 7) as u8).collect();
    DensityTile::from_samples(texels).expect("a tile's worth")
}

fn error_tile() -> ErrorTile {
    let texels = (0..32 * 32).map(|at: u32| std::array::from_fn(|k| (at * 11 + k as u32) as u8));
    ErrorTile::from_texels(texels.collect()).expect("a tile's worth")
}

fn height_tile() -> HeightTile {
    let samples = (0..133 * 133).map(|at| (at * 31) as u16).collect();
    HeightTile::from_samples(samples).expect("a tile's worth")
}

fn file(size: [u32; 2]) -> ManifestFile {
    ManifestFile {
        format: "tessera-terrain".to_owned(),
        version: MANIFEST_VERSION,
        size,
        spacing_m: 1.0,
        height_min_m: -5.0,
        height_step_m: 0.1,
        levels: ManifestFile::levels_for(size),
        density: DensitySettings::default(),
        index_crc32: 0,
    }
}

#[test]
fn tiles_are_read_as_they_were_written() {
    let tile = height_tile();
    assert_eq!(
        HeightTile::decode(&tile.encode(ADDRESS, STAMP), ADDRESS),
        Ok(tile)
    );
    let tile = density_tile();
    assert_eq!(
        DensityTile::decode(&tile.encode(ADDRESS, STAMP), ADDRESS),
        Ok(tile)
    );
    let tile = error_tile();
    assert_eq!(
        ErrorTile::decode(&tile.encode(ADDRESS, STAMP), ADDRESS),
        Ok(tile)
    );
    assert!(ErrorTile::from_texels(vec![[0; 8]; 1023].into()).is_none());
    assert_eq!(TerrainTile::path(ADDRESS), "tile/3/70000_5.tile");
    assert!(HeightTile::from_samples(vec![0; 133 * 132].into()).is_none());
    assert!(DensityTile::from_samples(vec![0; 36].into()).is_none());
}

#[test]
fn samples_are_counted_from_the_first_own_one() {
    let mut tile = height_tile();
    assert_eq!(tile.get(-2, -2), tile.samples()[0]);
    assert_eq!(tile.get(0, 0), tile.samples()[2 * 133 + 2]);
    assert_eq!(tile.get(130, 130), tile.samples()[133 * 133 - 1]);
    tile.samples_mut().fill(100);
    // The border doesn't count, the closing samples do.
    tile.samples_mut()[0] = 1;
    tile.samples_mut()[133 + 60] = 2;
    tile.samples_mut()[133 * 60 + 1] = 3;
    tile.samples_mut()[133 * 131 + 60] = 60_000;
    tile.samples_mut()[133 * 60 + 131] = 60_001;
    tile.samples_mut()[133 * 130 + 130] = 200;
    assert_eq!(tile.range(), TileRange { min: 100, max: 200 });
    let tile = density_tile();
    assert_eq!(tile.get(-1, -1), tile.samples()[0]);
    assert_eq!(tile.get(33, 33), tile.samples()[35 * 35 - 1]);
    let tile = error_tile();
    assert_eq!(tile.get(0, 0), tile.texels()[0]);
    assert_eq!(tile.get(5, 31), tile.texels()[31 * 32 + 5]);
}

#[test]
fn a_tile_is_refused_for_its_first_bad_section() {
    let tile = TerrainTile {
        heights: height_tile(),
        densities: density_tile(),
        errors: error_tile(),
        stamp: STAMP,
    };
    let good = tile.encode(ADDRESS);
    assert_eq!(TerrainTile::decode(&good, ADDRESS), Ok(tile.clone()));
    let sections = [
        tile.heights.encode(ADDRESS, STAMP),
        tile.densities.encode(ADDRESS, STAMP),
        tile.errors.encode(ADDRESS, STAMP),
    ];
    assert_eq!(good, sections.concat());
    let lengths = sections.map(|section| section.len());
    let refused = |bytes: &[u8]| TerrainTile::decode(bytes, ADDRESS).expect_err("refused");
    for (first, kind) in [
        (0, "height"),
        (lengths[0], "density"),
        (lengths[0] + lengths[1], "error"),
    ] {
        let mut bytes = good.clone();
        bytes[first + 50] ^= 4;
        let error = refused(&bytes);
        assert!(
            matches!(error, TileFormatError::Checksum { .. }),
            "{kind}: {error}"
        );
    }
    // As baked before there were error bounds.
    let error = refused(&good[..lengths[0] + lengths[1]]);
    let wanted = TileFormatError::Magic {
        found: *b"TSRHGHT\0",
        kind: TileKind::Error,
    };
    assert_eq!(error, wanted);
    assert!(error.to_string().contains("TSRERRB"), "{error}");
    for length in (0..good.len()).step_by(97) {
        refused(&good[..length]);
    }
    refused(&[&good[..], &[0]].concat());
}

#[test]
fn a_tile_put_together_from_two_terrains_is_refused() {
    let (heights, densities, errors) = (height_tile(), density_tile(), error_tile());
    let of = |stamps: [u32; 3]| {
        let sections = [
            heights.encode(ADDRESS, stamps[0]),
            densities.encode(ADDRESS, stamps[1]),
            errors.encode(ADDRESS, stamps[2]),
        ];
        TerrainTile::decode(&sections.concat(), ADDRESS)
    };
    assert_eq!(of([5, 5, 5]).expect("one terrain's").stamp, 5);
    for (stamps, kind) in [([5, 6, 5], TileKind::Density), ([5, 5, 6], TileKind::Error)] {
        let wanted = TileFormatError::MixedStamps {
            kind,
            found: 6,
            wanted: 5,
        };
        assert_eq!(of(stamps), Err(wanted));
    }
}

#[test]
fn a_stamp_follows_from_size_and_scale_and_nothing_else() {
    let plain = file([1000, 300]);
    let mut other_densities = plain.clone();
    other_densities.density.gain = 2.0;
    other_densities.index_crc32 = 77;
    assert_eq!(plain.stamp(), other_densities.stamp());
    let mut bytes = Vec::new();
    bytes.extend(1000_u32.to_le_bytes());
    bytes.extend(300_u32.to_le_bytes());
    for metres in [1.0_f64, -5.0, 0.1] {
        bytes.extend(metres.to_le_bytes());
    }
    assert_eq!(plain.stamp(), crc32fast::hash(&bytes));
    let changes: [fn(&mut ManifestFile); 5] = [
        |file| file.size[0] += 1,
        |file| file.size[1] += 1,
        |file| file.spacing_m *= 2.0,
        |file| file.height_min_m += 0.1,
        |file| file.height_step_m *= 2.0,
    ];
    for change in changes {
        let mut other = plain.clone();
        change(&mut other);
        assert_ne!(plain.stamp(), other.stamp(), "{other:?}");
    }
}

#[test]
fn a_tile_of_another_terrain_or_beyond_its_range_is_found_out() {
    let file = file([1000, 300]);
    let address = TileAddress::new(0, 2, 1);
    let mut manifest = TerrainManifest {
        index: TileIndex::new(&file),
        file,
    };
    let mut tile = TerrainTile {
        heights: height_tile(),
        densities: density_tile(),
        errors: error_tile(),
        stamp: manifest.file.stamp(),
    };
    assert_eq!(
        tile.check(&manifest, address),
        Err(TileFormatError::NotInIndex)
    );
    let found = tile.heights.range();
    manifest.index.set(address, Some(found));
    assert_eq!(tile.check(&manifest, address), Ok(()));
    for wanted in [
        TileRange {
            min: found.min + 1,
            ..found
        },
        TileRange {
            max: found.max - 1,
            ..found
        },
    ] {
        manifest.index.set(address, Some(wanted));
        let refused = TileFormatError::Range { found, wanted };
        assert_eq!(tile.check(&manifest, address), Err(refused));
    }
    tile.stamp ^= 1;
    let error = tile.check(&manifest, address).expect_err("another stamp");
    let message = format!(
        "it belongs to another terrain (stamp {:08x} where terrain.ron has {:08x}); bake again",
        tile.stamp,
        manifest.file.stamp()
    );
    assert_eq!(error.to_string(), message);
}

#[cfg(not(feature = "archive"))]
#[test]
fn a_packed_tile_is_refused_with_what_to_enable() {
    let error = TerrainTile::decode(b"TSRPACK\0\x01\0\0\0", ADDRESS).expect_err("packed");
    assert!(error.to_string().contains("feature `archive`"), "{error}");
}

#[test]
fn no_bit_of_a_tile_can_change_without_notice() {
    let bytes = density_tile().encode(ADDRESS, STAMP);
    for at in 0..bytes.len() {
        let mut bytes = bytes.clone();
        bytes[at] ^= 1 << (at % 8);
        assert!(DensityTile::decode(&bytes, ADDRESS).is_err(), "byte {at}");
    }
    for length in 0..bytes.len() {
        assert!(
            DensityTile::decode(&bytes[..length], ADDRESS).is_err(),
            "{length}"
        );
    }
}

#[test]
fn a_refusal_names_what_was_found_and_what_was_wanted() {
    let bytes = height_tile().encode(ADDRESS, STAMP);
    let other = TileAddress::new(3, 70_000, 6);
    let error = HeightTile::decode(&bytes, other).expect_err("another tile");
    assert_eq!(
        error,
        TileFormatError::Address {
            found: ADDRESS,
            wanted: other
        }
    );
    let error = DensityTile::decode(&bytes, ADDRESS).expect_err("another kind");
    assert_eq!(
        error,
        TileFormatError::Magic {
            found: *b"TSRHGHT\0",
            kind: TileKind::Density
        }
    );
    let message = error.to_string();
    assert!(
        message.contains("TSRHGHT") && message.contains("TSRDENS"),
        "{message}"
    );
    let mut newer = bytes;
    newer[8] = 3;
    let error = HeightTile::decode(&newer, ADDRESS).expect_err("another version");
    assert_eq!(
        error,
        TileFormatError::Version {
            found: 3,
            wanted: 2
        }
    );
}

#[test]
fn an_index_is_read_as_it_was_written() {
    let mut index = TileIndex::new(&file([1000, 300]));
    let tiles: Vec<_> = index.levels().iter().map(|level| level.tiles()).collect();
    assert_eq!(tiles, [[8, 3], [4, 2], [2, 1], [1, 1]]);
    assert_eq!(index.iter().count(), 0);
    let range = TileRange { min: 7, max: 7 };
    index.set(TileAddress::new(0, 7, 2), Some(range));
    index.set(TileAddress::new(0, 8, 0), Some(range));
    index.set(TileAddress::new(9, 0, 0), Some(range));
    let root = TileRange { min: 0, max: 65535 };
    index.set(TileAddress::new(3, 0, 0), Some(root));
    assert_eq!(index.get(TileAddress::new(0, 7, 2)), Some(range));
    assert_eq!(index.get(TileAddress::new(0, 7, 3)), None);
    assert_eq!(index.get(TileAddress::new(4, 0, 0)), None);
    let all: Vec<_> = index.iter().collect();
    assert_eq!(
        all,
        [
            (TileAddress::new(0, 7, 2), range),
            (TileAddress::new(3, 0, 0), root)
        ]
    );
    assert_eq!(TileIndex::decode(&index.encode()), Ok(index.clone()));
    index.set(TileAddress::new(0, 7, 2), None);
    assert_eq!(index.iter().count(), 1);
}

/// An index whose checksum is right, whatever it says.
fn index_bytes(levels: u32, payload: &[u8]) -> Vec<u8> {
    let mut bytes = b"TSRINDX\0".to_vec();
    for number in [2, levels, 0, 0, 0, payload.len() as u32] {
        bytes.extend_from_slice(&number.to_le_bytes());
    }
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&bytes);
    hasher.update(payload);
    bytes.extend_from_slice(&hasher.finalize().to_le_bytes());
    bytes.extend_from_slice(payload);
    bytes
}

#[test]
fn an_index_that_promises_too_much_is_refused() {
    let counts = |counts: &[u32]| {
        counts
            .iter()
            .flat_map(|c| c.to_le_bytes())
            .collect::<Vec<_>>()
    };
    for (levels, payload) in [
        (0, counts(&[])),
        (1, counts(&[])),
        (19, counts(&[1, 1, 0])),
        (u32::MAX, counts(&[1, 1, 0])),
        (1, counts(&[u32::MAX, u32::MAX])),
        (1, counts(&[1 << 20, 1])),
        (2, counts(&[1 << 20, 2, 0])),
        (1, counts(&[0, 0])),
        (1, counts(&[2, 1, 0, 0])),
        (2, counts(&[2, 1, 0, 0, 2, 1, 0, 0])),
        (2, counts(&[3, 1, 0, 0, 0, 1, 1, 0])),
        (1, counts(&[1, 1, 0, 0])),
        (1, counts(&[1, 1])),
    ] {
        let error = TileIndex::decode(&index_bytes(levels, &payload)).expect_err("refused");
        assert!(
            matches!(
                error,
                TileFormatError::Length { .. }
                    | TileFormatError::Levels { .. }
                    | TileFormatError::LevelCount { .. }
            ),
            "{levels} {payload:?}: {error}"
        );
    }
    assert!(TileIndex::decode(&index_bytes(1, &counts(&[1, 1, 0]))).is_ok());
}

#[test]
fn a_manifest_is_read_as_it_was_written_and_absurd_ones_are_refused() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    bake_heights(
        [300, 200],
        landscape([300, 200], 2),
        &dir,
        &BakeSettings::default(),
    );
    let good = manifest(&dir);
    assert_eq!(good.file.size, [300, 200]);
    let text = std::fs::read_to_string(dir.join("terrain.ron")).expect("readable");
    let index = std::fs::read(dir.join("tiles.index")).expect("readable");
    assert_eq!(TerrainManifest::decode(&text, &index).expect("good"), good);
    let replace = |from: &str, to: &str| {
        assert!(text.contains(from), "{from} in {text}");
        TerrainManifest::decode(&text.replace(from, to), &index).expect_err(to)
    };
    let format = replace("tessera-terrain", "other");
    assert!(matches!(format, ManifestError::Format { .. }), "{format}");
    let version = replace("version: 4", "version: 3").to_string();
    assert!(
        version.contains("version 4") && version.contains("version 3"),
        "{version}"
    );
    for size in [
        "(1, 200)",
        "(300, 0)",
        "(4294967295, 4294967295)",
        "(16777216, 16777216)",
    ] {
        let error = replace("(300, 200)", size);
        assert!(
            matches!(error, ManifestError::Size { .. }),
            "{size}: {error}"
        );
    }
    assert!(matches!(
        replace("levels: 3", "levels: 255"),
        ManifestError::Levels { .. }
    ));
    for spacing in ["0.0", "-1.0", "inf", "NaN"] {
        let error = replace("spacing_m: 1.0", &format!("spacing_m: {spacing}"));
        assert!(
            matches!(error, ManifestError::Number { .. }),
            "{spacing}: {error}"
        );
    }
    let error = replace("(300, 200)", "(300, 300)");
    assert!(matches!(error, ManifestError::IndexTiles { .. }), "{error}");
    let syntax = replace("(300, 200)", "(300,");
    assert!(matches!(syntax, ManifestError::Syntax(_)), "{syntax}");
    // Another bake's index.
    let mut other = good.index.clone();
    other.set(TileAddress::new(0, 0, 0), None);
    let error = TerrainManifest::decode(&text, &other.encode()).expect_err("refused");
    assert!(
        matches!(error, ManifestError::IndexChecksum { .. }),
        "{error}"
    );
    let mut damaged = index.clone();
    damaged[40] ^= 1;
    let error = TerrainManifest::decode(&text, &damaged).expect_err("refused");
    assert!(matches!(error, ManifestError::Index(_)), "{error}");
    assert!(TerrainManifest::decode(&"(".repeat(100_000), &index).is_err());
}

proptest! {
    #[test]
    fn nothing_that_stands_in_a_file_makes_a_reader_panic(
        mut bytes in prop::collection::vec(any::<u8>(), 0..400),
        levels in 0_u32..24,
        magic in any::<bool>(),
    ) {
        let _ = TileIndex::decode(&index_bytes(levels, &bytes));
        if magic && bytes.len() >= 12 {
            bytes[..12].copy_from_slice(b"TSRHGHT\0\x02\0\0\0");
        }
        prop_assert!(HeightTile::decode(&bytes, ADDRESS).is_err());
        prop_assert!(DensityTile::decode(&bytes, ADDRESS).is_err());
        prop_assert!(ErrorTile::decode(&bytes, ADDRESS).is_err());
        prop_assert!(TileIndex::decode(&bytes).is_err());
        let text = String::from_utf8_lossy(&bytes).into_owned();
        prop_assert!(TerrainManifest::decode(&text, &bytes).is_err());
    }
}
