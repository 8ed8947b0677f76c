//! `tessera apply`: a terrain into which edits were baked.
#![cfg(unix)]

mod bake_support;
#[expect(dead_code, reason = "every test file uses its own part")]
mod edit_support;

use bake_support::{addresses, bake_heights, densities, entries, errors, heights, manifest};
use bevy_tessera::bake::{self, BakeSettings};
use bevy_tessera::density::DensityExtent;
use bevy_tessera::edit::{EditGround, EditLog, EditScratch, EditedTile, touch_rect};
use bevy_tessera::tile::{TerrainTile, TileAddress, tile_path};
use edit_support::{crater, edits, raise};
use proptest::prelude::*;
use std::fs;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const SIZE: [u32; 2] = [900, 700];

struct World {
    folder: tempfile::TempDir,
    terrain: PathBuf,
}

/// Ground that is gentle enough for edits to be what makes it dense.
fn gentle() -> Vec<f32> {
    let height = |at: u32| {
        let (x, z) = ((at % SIZE[0]) as f32, (at / SIZE[0]) as f32);
        (x * 0.011).sin() * 9.0 + (z * 0.007 + x * 0.0013).cos() * 12.0
    };
    (0..SIZE[0] * SIZE[1]).map(height).collect()
}

fn world() -> World {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let terrain = folder.path().join("terrain");
    bake_heights(SIZE, gentle(), &terrain, &BakeSettings::default());
    World { folder, terrain }
}

/// Hills on borders, on a corner of tiles, on the terrain's rim and beyond it, and one undone.
fn edited(terrain: &Path) -> EditLog {
    let mut log = EditLog::new(&manifest(terrain).file);
    for (x, z, reach) in [
        (130, 60, 12),
        (256, 256, 9),
        (0, 300, 20),
        (905, 699, 10),
        (250, 250, 4),
    ] {
        log.push(raise(64 * x, 64 * z, 64 * reach))
            .expect("a good edit");
    }
    let undone = log
        .push(raise(64 * 500, 64 * 500, 64 * 30))
        .expect("a good edit");
    log.undo(undone).expect("it is active");
    log
}

fn apply(terrain: &Path, log: &Path, out: &Path, more: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tessera"))
        .arg("apply")
        .args([terrain, log])
        .arg("--out")
        .arg(out)
        .args(more)
        .output()
        .expect("tessera runs")
}

fn told(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

fn tile(dir: &Path, address: TileAddress) -> Vec<u8> {
    fs::read(dir.join(tile_path(address))).expect("readable")
}

/// The bytes of everything that makes a terrain.
fn contents(dir: &Path) -> Vec<Vec<u8>> {
    let tiles = addresses(&manifest(dir).file);
    let mut all: Vec<_> = tiles.into_iter().map(|at| tile(dir, at)).collect();
    for name in ["terrain.ron", "tiles.index"] {
        all.push(fs::read(dir.join(name)).expect("readable"));
    }
    all
}

fn assert_good(dir: &Path) {
    let report = bake::verify(dir, &|_| {}).unwrap_or_else(|error| panic!("{error}"));
    assert!(report.faults.is_empty(), "{:?}", report.faults);
}

#[test]
fn a_terrain_with_edits_baked_in_passes_verify_and_the_old_one_stays() {
    let World { folder, terrain } = world();
    let before = contents(&terrain);
    let log = folder.path().join("saved.edits");
    edited(&terrain).save(&log).expect("it is saved");
    let out = folder.path().join("edited");
    let output = apply(&terrain, &log, &out, &[]);
    assert!(output.status.success(), "{}", told(&output));
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("tiles with 5 edits"), "{text}");
    assert_good(&out);
    assert!(contents(&terrain) == before, "the old terrain changed");
    let at = TileAddress::new(0, 2, 2);
    assert!(heights(&out, at) != heights(&terrain, at));
    assert!(manifest(&out).index != manifest(&terrain).index);
    // All that says which terrain it is stays.
    assert_eq!(manifest(&out).file.stamp(), manifest(&terrain).file.stamp());

    // The readable log says the same.
    let readable = folder.path().join("saved.ron");
    edited(&terrain).save_ron(&readable).expect("it is saved");
    let again = folder.path().join("again");
    assert!(apply(&terrain, &readable, &again, &[]).status.success());
    assert!(contents(&again) == contents(&out));
}

#[test]
fn tiles_that_no_edit_reaches_are_the_old_ones() {
    let World { folder, terrain } = world();
    let log = edited(&terrain);
    let out = folder.path().join("edited");
    let report = bake::apply_edits(&terrain, &log, &out, false, &()).expect("it is applied");
    let inode = |dir: &Path, at| fs::metadata(dir.join(tile_path(at))).expect("there").ino();
    let mut linked = 0;
    for address in addresses(&manifest(&terrain).file) {
        let same = inode(&terrain, address) == inode(&out, address);
        linked += u64::from(same);
        if same {
            assert!(log.active_touching(address).is_empty(), "{address}");
        } else if log.active_touching(address).is_empty() {
            // Only for a neighbour's densities.
            assert!(
                heights(&out, address) == heights(&terrain, address),
                "{address}"
            );
            assert!(
                errors(&out, address) == errors(&terrain, address),
                "{address}"
            );
            assert!(
                densities(&out, address) != densities(&terrain, address),
                "{address}"
            );
        }
    }
    assert!(linked > 5, "{linked} are linked");
    assert_eq!(report.tiles - report.changed, linked);
    assert_eq!(report.edits, 5);
}

#[test]
fn heights_differ_where_edits_lie_and_nowhere_else() {
    let World { folder, terrain } = world();
    let log = edited(&terrain);
    let out = folder.path().join("edited");
    bake::apply_edits(&terrain, &log, &out, false, &()).expect("it is applied");
    for address in addresses(&manifest(&terrain).file) {
        if address.level > 0 {
            continue;
        }
        let (old, new) = (heights(&terrain, address), heights(&out, address));
        let (x, z) = address.first_sample();
        for row in -2..=130 {
            for column in -2..=130 {
                let at = [x as i32 + column, z as i32 + row];
                let edited = log.active().any(|(_, edit)| {
                    let rect = edit.rect();
                    [0, 1].iter().all(|&axis| {
                        let at = at[axis].clamp(0, SIZE[axis] as i32 - 1);
                        (rect.min[axis]..rect.max[axis]).contains(&at)
                    })
                });
                let same = old.get(column, row) == new.get(column, row);
                assert!(same || edited, "{address}: {at:?}");
            }
        }
    }
    let middle = heights(&out, TileAddress::new(0, 2, 2)).get(0, 0);
    assert_eq!(
        middle,
        heights(&terrain, TileAddress::new(0, 2, 2)).get(0, 0) + 100
    );
}

/// A log of edits of every kind.
fn random_log(terrain: &Path, edits: &[bevy_tessera::edit::Edit]) -> EditLog {
    let mut log = EditLog::new(&manifest(terrain).file);
    for edit in edits {
        log.push(edit.clone()).expect("a good edit");
    }
    log
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(6))]

    #[test]
    fn baked_tiles_are_those_that_a_game_makes_of_the_log(
        edits in prop::collection::vec(edits(), 1..12),
    ) {
        let World { folder, terrain } = world();
        let log = random_log(&terrain, &edits);
        let out = folder.path().join("edited");
        bake::apply_edits(&terrain, &log, &out, false, &()).expect("it is applied");
        assert_good(&out);
        let file = manifest(&terrain).file;
        let ground = EditGround::new(&file);
        let mut scratch = EditScratch::default();
        for address in addresses(&file) {
            let read = |dir: &Path| {
                TerrainTile::decode(&tile(dir, address), address).expect("a good tile")
            };
            let mut played = EditedTile::new(address, read(&terrain));
            for (_, edit) in log.active() {
                let raster = ground.raster(edit, &mut scratch);
                played.apply(&ground, &raster, &mut scratch);
            }
            let (played, baked) = (played.into_tile(), read(&out));
            prop_assert!(played.heights == baked.heights, "{}", address);
            // Those beyond the rim repeat it in files.
            let texels = DensityExtent::new(file.size, address.level).texels;
            let left = |axis: usize, tile: u32| (texels[axis] - 32 * tile).min(32) as i32;
            for z in 0..left(1, address.z) {
                for x in 0..left(0, address.x) {
                    let (played, baked) = (played.densities.get(x, z), baked.densities.get(x, z));
                    prop_assert_eq!(played, baked, "{}: {}, {}", address, x, z);
                }
            }
            prop_assert!(played.errors == baked.errors, "{}", address);
        }
    }
}

proptest! {
    #[test]
    fn no_edit_touches_a_tile_without_lying_on_its_touch_rect(edit in edits()) {
        let mut file = edit_support::terrain();
        file.size = [4097, 3001];
        file.levels = bevy_tessera::terrain::ManifestFile::levels_for(file.size);
        let ground = EditGround::new(&file);
        let raster = ground.raster(&edit, &mut EditScratch::default());
        for address in addresses(&file) {
            let meets = !touch_rect(address).intersection(&edit.rect()).is_empty();
            prop_assert!(meets || !raster.footprint().touches(address), "{}", address);
        }
    }
}

#[test]
fn a_log_without_active_edits_changes_nothing() {
    let World { folder, terrain } = world();
    let mut log = edited(&terrain);
    while log.undo_last().is_some() {}
    let out = folder.path().join("same");
    let report = bake::apply_edits(&terrain, &log, &out, false, &()).expect("it is applied");
    assert_eq!((report.edits, report.changed), (0, 0));
    assert!(contents(&out) == contents(&terrain));
}

#[test]
fn a_terrain_may_be_replaced_by_itself_with_edits() {
    let World { folder, terrain } = world();
    let log = edited(&terrain);
    let out = folder.path().join("edited");
    bake::apply_edits(&terrain, &log, &out, false, &()).expect("it is applied");
    fs::write(terrain.join("notes.txt"), "mine").expect("it can be written");
    let file = folder.path().join("saved.edits");
    log.save(&file).expect("it is saved");
    let output = apply(&terrain, &file, &terrain, &[]);
    assert!(
        told(&output).contains("exists already"),
        "{}",
        told(&output)
    );
    let output = apply(&terrain, &file, &terrain, &["--force"]);
    assert!(output.status.success(), "{}", told(&output));
    assert!(contents(&terrain) == contents(&out));
    assert_eq!(
        fs::read(terrain.join("notes.txt")).expect("readable"),
        b"mine"
    );
    assert_eq!(entries(folder.path()), ["edited", "saved.edits", "terrain"]);
}

#[test]
fn what_cannot_be_applied_is_refused_in_a_sentence_and_nothing_is_left() {
    let World { folder, terrain } = world();
    let dir = folder.path();
    let out = dir.join("edited");
    let file = dir.join("saved.edits");
    let mut other = manifest(&terrain).file;
    other.spacing_m *= 2.0;
    let mut log = EditLog::new(&other);
    log.push(crater(0, 0, 640, 1)).expect("a good edit");
    log.save(&file).expect("it is saved");
    let error = bake::apply_edits(&terrain, &log, &out, false, &()).expect_err("another's");
    assert!(
        error.to_string().contains("belong to another terrain"),
        "{error}"
    );
    for (terrain, file, reason) in [
        (
            &terrain,
            &file,
            "saved.edits can't be applied: the edits belong to another terrain",
        ),
        (&terrain, &dir.join("none"), "none can't be read"),
        (
            &terrain,
            &terrain.join("tiles.index"),
            "tiles.index can't be loaded: it starts with",
        ),
        (
            &dir.join("none"),
            &file,
            "none is no terrain that can be used",
        ),
    ] {
        let output = apply(terrain, file, &out, &[]);
        let told = told(&output);
        assert_eq!(output.status.code(), Some(1), "{told}");
        assert_eq!(told.lines().count(), 1, "{told}");
        assert!(told.contains(reason), "{told}");
        assert_eq!(entries(dir), ["saved.edits", "terrain"]);
    }
    // A limit on file sizes stops a write in its middle, as a full disk does.
    edited(&terrain).save(&file).expect("it is saved");
    let output = Command::new("sh")
        .args(["-c", "trap '' XFSZ; ulimit -f 20; exec \"$@\"", "sh"])
        .arg(env!("CARGO_BIN_EXE_tessera"))
        .arg("apply")
        .args([&terrain, &file])
        .arg("--out")
        .arg(&out)
        .output()
        .expect("sh runs");
    assert!(
        told(&output).contains("can't be written"),
        "{}",
        told(&output)
    );
    assert_eq!(entries(dir), ["saved.edits", "terrain"]);
    // A damaged tile is named.
    let address = TileAddress::new(0, 2, 2);
    let path = terrain.join(tile_path(address));
    let mut bytes = tile(&terrain, address);
    assert!(TerrainTile::decode(&bytes, address).is_ok());
    bytes[5000] ^= 1;
    fs::write(path, bytes).expect("it can be written");
    assert!(!touch_rect(address).is_empty());
    let output = apply(&terrain, &file, &out, &[]);
    assert!(
        told(&output).contains("2_2.tile can't be used"),
        "{}",
        told(&output)
    );
    assert_eq!(entries(dir), ["saved.edits", "terrain"]);
}
