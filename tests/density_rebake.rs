//! Densities on disk: equal where tiles meet, stored with their settings, and made anew exactly as a
//! bake makes them, without losing anything that lies in the terrain's folder.

mod bake_support;

use bake_support::{addresses, bake_heights, densities, heights, landscape, manifest};
use bevy_tessera::bake::{
    BakeError, BakeProgress, BakeSettings, BakeStage, rebake_densities, verify,
};
use bevy_tessera::density::{
    DensityBorder, DensityExtent, DensityFilter, DensityKernel, DensityScratch, DensitySettings,
    tile_densities,
};
use bevy_tessera::terrain::{INDEX_FILE, MANIFEST_FILE, TerrainManifest};
use bevy_tessera::tile::{TileAddress, TileRange, tile_path};
use std::fs;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A terrain of `size` samples in a folder of its own.
fn baked(size: [u32; 2], seed: u32) -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    bake_heights(size, landscape(size, seed), &dir, &BakeSettings::default());
    (folder, dir)
}

/// Settings of all sorts.
fn varied() -> Vec<DensitySettings> {
    let base = DensitySettings {
        gain: 0.5,
        ..Default::default()
    };
    vec![
        base.clone(),
        DensitySettings {
            filter: DensityFilter::Principal,
            filter_size: 3,
            ..base.clone()
        },
        DensitySettings {
            border: DensityBorder::PointSampled,
            filter_size: 2,
            lod_skip: 2,
            exponent: 1.7,
            ..base.clone()
        },
        DensitySettings {
            filter: DensityFilter::LaplaceBeltramiVoronoi,
            border: DensityBorder::PointSampled,
            preprocess: false,
            ..base.clone()
        },
        DensitySettings {
            filter_size: 32,
            lod_skip: 1,
            border: DensityBorder::PointSampled,
            ..base
        },
    ]
}

/// All sides and corners of every two neighbours at every level; `verify` compares all texels that
/// both hold.
#[test]
fn neighbours_agree_in_all_densities_that_both_hold() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    let size = [700, 460];
    for density in varied() {
        let settings = BakeSettings {
            density: density.clone(),
            force: true,
            ..Default::default()
        };
        bake_heights(size, landscape(size, 5), &dir, &settings);
        let report = verify(&dir, &|_| {}).expect("it can be read");
        assert!(report.faults.is_empty(), "{density:?}: {:?}", report.faults);
        let file = manifest(&dir).file;
        for address in addresses(&file) {
            let [columns, rows] = file.tiles(address.level);
            let own = densities(&dir, address);
            for (dx, dz) in [(1, 0), (0, 1), (1, 1)] {
                let (x, z) = (address.x + dx, address.z + dz);
                if x >= columns || z >= rows {
                    continue;
                }
                let other = densities(&dir, TileAddress::new(address.level, x, z));
                for step in 0..1024 {
                    let (mut x, mut z) = (step % 35 - 1, step / 35 - 1);
                    (x, z) = (x + 32 * dx as i32, z + 32 * dz as i32);
                    if x <= 33 && z <= 33 {
                        let theirs = other.get(x - 32 * dx as i32, z - 32 * dz as i32);
                        assert_eq!(own.get(x, z), theirs, "{address}, ({x}, {z}), {density:?}");
                    }
                }
            }
        }
    }
}

/// The bytes of all files of a terrain, by name.
fn contents(dir: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files = vec![MANIFEST_FILE.to_owned(), INDEX_FILE.to_owned()];
    for (address, _) in manifest(dir).index.iter() {
        files.push(tile_path(address));
    }
    let read = |file: String| {
        let bytes = fs::read(dir.join(&file)).unwrap_or_else(|error| panic!("{file}: {error}"));
        (file, bytes)
    };
    files.into_iter().map(read).collect()
}

#[test]
fn densities_made_anew_are_what_a_bake_makes_byte_for_byte() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (first, wanted) = (folder.path().join("first"), folder.path().join("wanted"));
    for size in [[2, 2], [2, 300], [130, 129], [523, 391]] {
        let metres = landscape(size, 11);
        let force = BakeSettings {
            force: true,
            spacing_m: Some(2.5),
            ..Default::default()
        };
        bake_heights(size, metres.clone(), &first, &force);
        for density in varied() {
            let settings = BakeSettings {
                density: density.clone(),
                ..force.clone()
            };
            bake_heights(size, metres.clone(), &wanted, &settings);
            let report = rebake_densities(&first, &density, &()).expect("it works");
            assert_eq!(report.tiles, addresses(&manifest(&first).file).len() as u64);
            assert_eq!(manifest(&first).file.density, density);
            for (found, wanted) in contents(&first).into_iter().zip(contents(&wanted)) {
                assert_eq!(found.0, wanted.0);
                assert!(
                    found.1 == wanted.1,
                    "{size:?}: {} differs, {density:?}",
                    found.0
                );
            }
        }
    }
    assert_eq!(bake_support::entries(folder.path()), ["first", "wanted"]);
}

#[test]
fn making_densities_anew_does_not_touch_heights() {
    let size = [300, 200];
    let (_folder, dir) = baked(size, 2);
    let all_heights = || {
        let all = addresses(&manifest(&dir).file);
        all.into_iter()
            .map(|address| heights(&dir, address))
            .collect::<Vec<_>>()
    };
    let before = (all_heights(), manifest(&dir).index);
    rebake_densities(&dir, &varied()[1], &()).expect("it works");
    assert!(before == (all_heights(), manifest(&dir).index));
}

#[test]
fn a_rebake_that_fails_leaves_the_terrain_as_it_was() {
    let (folder, dir) = baked([400, 300], 2);
    let bad = dir.join(tile_path(TileAddress::new(0, 1, 1)));
    let good = fs::read(&bad).expect("readable");
    let mut broken = good.clone();
    broken[500] ^= 1;
    fs::write(&bad, &broken).expect("writable");
    let before = contents(&dir);
    let error = rebake_densities(&dir, &varied()[1], &()).expect_err("a tile is broken");
    assert!(matches!(error, BakeError::Tile { .. }));
    let message = error.to_string();
    assert!(
        message.contains("1_1.tile") && message.contains("checksum"),
        "{message}"
    );
    assert!(contents(&dir) == before);
    assert_eq!(bake_support::entries(folder.path()), ["terrain"]);

    let error = rebake_densities(folder.path(), &varied()[0], &()).expect_err("no terrain");
    assert!(error.to_string().contains("no terrain"), "{error}");
    let too_much = DensitySettings {
        gain: 1e6,
        ..Default::default()
    };
    let error = rebake_densities(&dir, &too_much, &()).expect_err("out of range");
    assert!(error.to_string().contains("0.001..=1000"), "{error}");
    assert!(contents(&dir) == before);
}

/// Takes tiles of level 0 away, as a terrain has it whose fine data isn't everywhere.
fn without(dir: &Path, gone: impl Fn(TileAddress) -> bool) {
    let mut terrain: TerrainManifest = manifest(dir);
    let all: Vec<_> = terrain.index.iter().map(|(address, _)| address).collect();
    for &address in all.iter().filter(|&&address| gone(address)) {
        terrain.index.set(address, None);
        fs::remove_file(dir.join(tile_path(address))).expect("it was there");
    }
    for &address in &all {
        if terrain.index.get(address).is_some() {
            let children = address.children().into_iter().flatten();
            let range = children
                .filter_map(|child| terrain.index.get(child))
                .fold(heights(dir, address).range(), TileRange::union);
            terrain.index.set(address, Some(range));
        }
    }
    let index = terrain.index.encode();
    terrain.file.index_crc32 = crc32fast::hash(&index);
    fs::write(dir.join(INDEX_FILE), index).expect("writable");
    fs::write(
        dir.join(MANIFEST_FILE),
        ron::to_string(&terrain.file).expect("it can be told"),
    )
    .expect("writable");
}

#[test]
fn a_tile_without_finer_ones_gets_densities_from_its_own_heights() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    let size = [1025, 600];
    for density in varied() {
        let force = BakeSettings {
            force: true,
            density: density.clone(),
            ..Default::default()
        };
        bake_heights(size, landscape(size, 4), &dir, &force);
        let missing = |address: TileAddress| {
            address.level == 0 && (address.x / 2 == 1 || (address.x, address.z) == (5, 2))
        };
        let whole = |address| densities(&dir, address);
        let far = TileAddress::new(1, 3, 0);
        let before = whole(far);
        without(&dir, missing);
        rebake_densities(&dir, &density, &()).expect("it works");
        let report = verify(&dir, &|_| {}).expect("it can be read");
        assert!(report.faults.is_empty(), "{density:?}: {:?}", report.faults);
        let spreads_far = density.preprocess && density.filter_size > 8;
        let whole_far = whole(far);
        for at in 0..28 * 28 {
            let (x, z) = (4 + at % 28, at / 28);
            let unchanged = whole_far.get(x, z) == before.get(x, z);
            assert!(
                spreads_far || unchanged,
                "({x}, {z}) is far from what is missing"
            );
        }

        // Of the tile that has no finer one at all, texels that nothing spreads to.
        let file = manifest(&dir).file;
        let bare = TileAddress::new(1, 1, 0);
        let kernel = DensityKernel::new(&density, file.height_step_m, file.spacing_m, 1);
        let mut own = [0; 1024];
        tile_densities(
            &kernel,
            &DensityExtent::new(file.size, 1),
            [128, 0],
            heights(&dir, bare).samples(),
            &mut DensityScratch::default(),
            &mut own,
        );
        let stored = whole(bare);
        let plain = !density.preprocess || density.filter_size == 1;
        for (at, own) in own.into_iter().enumerate() {
            let (x, z) = (at as i32 % 32, at as i32 / 32);
            let found = stored.get(x, z);
            assert!(found >= own, "({x}, {z})");
            assert!(
                !plain || found == own,
                "({x}, {z}): {found} instead of {own}"
            );
        }
        assert!(own.iter().any(|&own| own > 0));
        // Of the tile that lacks one of four, three quarters are the finer ones' maximum.
        let three = whole(TileAddress::new(1, 2, 1));
        let finer = whole(TileAddress::new(0, 4, 2));
        let inside = (2..14).flat_map(|z| (2..14).map(move |x| (x, z)));
        for (x, z) in inside {
            let largest = (0..4)
                .map(|at| finer.get(2 * x + at % 2, 2 * z + at / 2))
                .max();
            assert_eq!(Some(three.get(x, z)), largest, "({x}, {z}), {density:?}");
        }
    }
}

/// Hears when the new terrain is about to take the old one's place.
struct AtTheEnd<F>(F);

impl<F: Fn() + Sync> BakeProgress for AtTheEnd<F> {
    fn stage(&self, stage: BakeStage, _: u64) {
        if stage == BakeStage::Finish {
            (self.0)();
        }
    }
}

#[test]
fn a_terrain_that_was_replaced_meanwhile_is_left_alone() {
    let size = [300, 200];
    let (folder, dir) = baked(size, 1);
    let replace = || {
        let force = BakeSettings {
            force: true,
            ..Default::default()
        };
        bake_heights(size, landscape(size, 2), &dir, &force);
    };
    let error = rebake_densities(&dir, &varied()[1], &AtTheEnd(replace)).expect_err("too late");
    assert!(matches!(error, BakeError::Replaced { .. }), "{error}");
    assert!(error.to_string().contains("run it again"), "{error}");
    let wanted = folder.path().join("wanted");
    bake_heights(size, landscape(size, 2), &wanted, &BakeSettings::default());
    assert!(contents(&dir) == contents(&wanted));
    assert_eq!(bake_support::entries(folder.path()), ["terrain", "wanted"]);
}

/// A terrain's folder may hold textures, notes, metadata.
#[cfg(unix)]
#[test]
fn whatever_else_lies_in_a_terrains_folder_stays() {
    use std::os::unix::fs::PermissionsExt;
    let size = [140, 60];
    let (folder, dir) = baked(size, 1);
    let write = |name: &str| {
        let path = dir.join(name);
        fs::create_dir_all(path.parent().expect("it has one")).expect("writable");
        fs::write(path, name).expect("writable");
    };
    let all = ["README.txt", "textures/deep/albedo.png", "terrain.ron.meta"];
    all.into_iter().for_each(write);
    write("tile/0/0_0.tile.meta");
    std::os::unix::fs::symlink("README.txt", dir.join("link")).expect("writable");
    fs::set_permissions(&dir, fs::Permissions::from_mode(0o750)).expect("it is ours");
    let check = |names: &[&str]| {
        for &name in names {
            let found = fs::read_to_string(dir.join(name));
            assert_eq!(found.ok().as_deref(), Some(name), "{name} is lost");
        }
        assert!(fs::symlink_metadata(dir.join("link")).is_ok_and(|link| link.is_symlink()));
        let mode = fs::metadata(&dir).expect("it exists").permissions().mode();
        assert_eq!(mode & 0o777, 0o750);
    };
    rebake_densities(&dir, &varied()[1], &()).expect("it works");
    check(&all);
    check(&["tile/0/0_0.tile.meta"]);
    let force = BakeSettings {
        force: true,
        ..Default::default()
    };
    bake_heights(size, landscape(size, 2), &dir, &force);
    check(&all);
    assert_eq!(bake_support::entries(folder.path()), ["terrain"]);
}

#[cfg(unix)]
#[test]
fn densities_are_made_anew_by_any_name_of_the_folder() {
    let (folder, dir) = baked([140, 60], 1);
    std::os::unix::fs::symlink(&dir, folder.path().join("link")).expect("writable");
    for (name, gain) in [
        ("link", 2.0),
        ("link/", 3.0),
        ("terrain/.", 4.0),
        ("terrain/", 5.0),
    ] {
        let density = DensitySettings {
            gain,
            ..Default::default()
        };
        let path = format!("{}/{name}", folder.path().display());
        rebake_densities(Path::new(&path), &density, &()).expect("it works");
        assert_eq!(manifest(&dir).file.density.gain, gain);
        assert_eq!(bake_support::entries(folder.path()), ["link", "terrain"]);
    }
}

/// A bake that was killed between its two renames has moved the old terrain aside.
#[cfg(target_os = "linux")]
#[test]
fn densities_of_a_terrain_that_a_killed_bake_moved_aside_are_made_anew() {
    let (folder, dir) = baked([140, 60], 1);
    // No process has a number that large.
    let aside = folder.path().join(".terrain.tessera-old-999999999-0");
    fs::rename(&dir, aside).expect("it is ours");
    rebake_densities(&dir, &varied()[1], &()).expect("it works");
    assert_eq!(manifest(&dir).file.density, varied()[1]);
    assert_eq!(bake_support::entries(folder.path()), ["terrain"]);
}

#[test]
fn a_height_tile_that_is_missing_is_named_at_every_level() {
    let (folder, dir) = baked([400, 300], 2);
    let levels = manifest(&dir).file.levels;
    for level in 0..levels {
        let path = dir.join(tile_path(TileAddress::new(level, 0, 0)));
        let bytes = fs::read(&path).expect("readable");
        fs::remove_file(&path).expect("writable");
        let error = rebake_densities(&dir, &varied()[0], &()).expect_err("it is missing");
        let message = error.to_string();
        assert!(
            message.starts_with(&path.display().to_string()),
            "{message}"
        );
        fs::write(&path, bytes).expect("writable");
    }
    assert_eq!(bake_support::entries(folder.path()), ["terrain"]);
}

#[test]
fn the_mean_density_is_that_of_the_finest_tiles_there_are() {
    let size = [517, 300];
    let (_folder, dir) = baked(size, 4);
    for gone in [false, true] {
        if gone {
            without(&dir, |address| address.level == 0 && address.x == 1);
        }
        let report = rebake_densities(&dir, &varied()[0], &()).expect("it works");
        let file = manifest(&dir).file;
        let texels = file.samples(0).map(bevy_tessera::density::texels_of);
        let (mut sum, mut count) = (0_u64, 0_u64);
        for (address, _) in manifest(&dir).index.iter().filter(|tile| tile.0.level == 0) {
            let tile = densities(&dir, address);
            for at in 0..1024_u32 {
                let (x, z) = (at % 32, at / 32);
                if 32 * address.x + x < texels[0] && 32 * address.z + z < texels[1] {
                    sum += u64::from(tile.get(x as i32, z as i32));
                    count += 1;
                }
            }
        }
        assert!((report.mean - sum as f64 / (255.0 * count as f64)).abs() < 1e-12);
    }
}

#[test]
fn settings_are_stored_with_the_terrain() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (number, density) in varied().into_iter().enumerate() {
        let dir = folder.path().join(number.to_string());
        let settings = BakeSettings {
            density: density.clone(),
            ..Default::default()
        };
        bake_heights([40, 40], landscape([40, 40], 1), &dir, &settings);
        assert_eq!(manifest(&dir).file.density, density);
        // A manifest that somebody wrote by hand is refused as well.
        let path = dir.join(MANIFEST_FILE);
        let text = fs::read_to_string(&path).expect("readable");
        let found = format!("filter_size: {}", density.filter_size);
        assert!(text.contains(&found), "{text}");
        fs::write(&path, text.replace(&found, "filter_size: 77")).expect("writable");
        let error = TerrainManifest::read(&dir).expect_err("77 is too much");
        assert!(error.to_string().contains("1..=32"), "{error}");
    }
}
