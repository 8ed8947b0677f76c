//! What a bake leaves on disk: a whole terrain, or what was there before. And what `tessera verify`
//! makes of a terrain that was damaged since.
#![cfg(unix)]

mod bake_support;

use bake_support::{addresses, bake_heights, entries, landscape, manifest};
use bevy_tessera::bake::{self, BakeError, BakeSettings, Fault, HeightSource, SourceError};
use bevy_tessera::density::DensitySettings;
use bevy_tessera::tile::{
    DensityTile, ErrorTile, HeightTile, TerrainTile, TileAddress, TileFormatError, TileRange,
    encode_tile, tile_path,
};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

fn tessera() -> Command {
    Command::new(env!("CARGO_BIN_EXE_tessera"))
}

fn text(output: &[u8]) -> String {
    String::from_utf8_lossy(output).into_owned()
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// A small raw file and the arguments that bake it.
fn small_source(dir: &Path) -> PathBuf {
    let path = dir.join("small.r16");
    let samples: Vec<u8> = (0..300_u32 * 200)
        .flat_map(|at| ((at % 300 * (at / 300)) as u16).to_le_bytes())
        .collect();
    fs::write(&path, samples).expect("a file can be written");
    path
}

fn bake_small(dir: &Path, out: &Path, more: &[&str]) -> Output {
    tessera()
        .arg("bake")
        .arg(small_source(dir))
        .args(["--size", "300x200", "--out"])
        .arg(out)
        .args(more)
        .output()
        .expect("tessera runs")
}

fn assert_good(out: &Path) {
    let report = bake::verify(out, &|_| {}).unwrap_or_else(|e| panic!("{e}"));
    assert!(report.faults.is_empty(), "{:?}", report.faults);
    assert!(report.tiles > 0);
}

/// Files that sum up a terrain: equal where its tiles are.
fn contents(out: &Path) -> (Vec<u8>, Vec<u8>) {
    let read = |name| fs::read(out.join(name)).expect("readable");
    (read("terrain.ron"), read("tiles.index"))
}

/// Starts a bake that takes seconds, and kills it as soon as its first tile is written (`late`:
/// some time after).
fn kill_a_bake(dir: &Path, out: &Path, wait: Duration) {
    let big = dir.join("big.r16");
    let file = fs::File::create(&big).expect("a file can be made");
    file.set_len(12_000 * 12_000 * 2).expect("a sparse file");
    let mut child = tessera()
        .arg("bake")
        .arg(&big)
        .args([
            "--size",
            "12000x12000",
            "--height-range-m",
            "0..100",
            "--force",
            "--out",
        ])
        .arg(out)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .expect("tessera runs");
    let started = Instant::now();
    let partial = || {
        let all = entries(dir);
        all.into_iter()
            .find(|name| name.contains(".tessera-partial-"))
    };
    loop {
        if let Some(name) = partial()
            && fs::read_dir(dir.join(name).join("tile/0")).is_ok_and(|mut d| d.next().is_some())
        {
            break;
        }
        assert!(
            child.try_wait().expect("it runs").is_none(),
            "the bake was over too soon"
        );
        assert!(
            started.elapsed() < Duration::from_secs(60),
            "the bake wrote nothing"
        );
        std::thread::sleep(Duration::from_millis(1));
    }
    std::thread::sleep(wait);
    // SIGKILL, on Unix.
    child.kill().expect("it can be killed");
    child.wait().expect("it ends");
    assert!(partial().is_some(), "the bake was killed in its middle");
}

#[test]
fn a_killed_bake_leaves_the_old_terrain_or_nothing() {
    let folder = folder();
    let dir = folder.path();
    let out = dir.join("terrain");
    kill_a_bake(dir, &out, Duration::ZERO);
    assert!(!out.exists(), "half a terrain was left");

    // The next bake clears away what the killed one left.
    assert!(bake_small(dir, &out, &[]).status.success());
    assert_eq!(entries(dir), ["big.r16", "small.r16", "terrain"]);
    let before = contents(&out);

    for wait in [0, 50, 200] {
        kill_a_bake(dir, &out, Duration::from_millis(wait));
        assert!(contents(&out) == before, "the old terrain changed");
        assert_good(&out);
    }
    assert!(bake_small(dir, &out, &["--force"]).status.success());
    assert_eq!(entries(dir), ["big.r16", "small.r16", "terrain"]);
}

/// The number of a process that is surely gone.
fn gone_process() -> u32 {
    let mut child = Command::new("true").spawn().expect("true runs");
    child.wait().expect("it ends");
    child.id()
}

#[test]
fn a_bake_killed_between_its_two_renames_gives_the_old_terrain_back() {
    let folder = folder();
    let dir = folder.path();
    let out = dir.join("terrain");
    assert!(bake_small(dir, &out, &[]).status.success());
    let before = contents(&out);
    let aside = dir.join(format!(".terrain.tessera-old-{}-0", gone_process()));
    fs::rename(&out, &aside).expect("it can be renamed");

    // Refused, because the old terrain is there again.
    let output = bake_small(dir, &out, &[]);
    assert!(!output.status.success());
    assert!(contents(&out) == before);
    assert_eq!(entries(dir), ["small.r16", "terrain"]);
}

#[test]
fn a_running_bake_is_left_alone_by_others_of_the_same_terrain() {
    let folder = folder();
    let dir = folder.path();
    // This test's own process is one that runs.
    let other = dir.join(format!(".terrain.tessera-partial-{}-0", std::process::id()));
    fs::create_dir(&other).expect("a folder can be made");
    // A terrain whose name begins alike has nothing to do with this one.
    let alike = dir.join(format!(".terrain2.tessera-partial-{}-0", gone_process()));
    fs::create_dir(&alike).expect("a folder can be made");
    assert!(bake_small(dir, &dir.join("terrain"), &[]).status.success());
    assert!(other.exists() && alike.exists());
}

#[test]
fn an_existing_terrain_is_replaced_only_when_forced() {
    let folder = folder();
    let dir = folder.path();
    let out = dir.join("terrain");
    assert!(bake_small(dir, &out, &[]).status.success());
    let before = contents(&out);

    let output = bake_small(dir, &out, &["--spacing-m", "7"]);
    assert_eq!(output.status.code(), Some(1));
    let message = text(&output.stderr);
    assert!(message.contains("terrain exists already"), "{message}");
    assert!(message.contains("--force"), "{message}");
    assert!(contents(&out) == before);

    let output = bake_small(dir, &out, &["--spacing-m", "7", "--force"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert_eq!(manifest(&out).file.spacing_m, 7.0);
    assert_good(&out);
    assert_eq!(entries(dir), ["small.r16", "terrain"]);
}

#[test]
fn force_removes_nothing_that_is_not_a_terrain() {
    let folder = folder();
    let dir = folder.path();
    let out = dir.join("precious");
    fs::create_dir(&out).expect("a folder can be made");
    fs::write(out.join("thesis.txt"), "years of work").expect("a file can be written");
    let output = bake_small(dir, &out, &["--force"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stderr).contains("not a terrain"));
    assert_eq!(entries(&out), ["thesis.txt"]);

    let file = dir.join("file");
    fs::write(&file, "x").expect("a file can be written");
    assert_eq!(bake_small(dir, &file, &["--force"]).status.code(), Some(1));
    assert_eq!(fs::read(&file).expect("readable"), b"x");
    assert_eq!(entries(dir), ["file", "precious", "small.r16"]);

    let empty = dir.join("empty");
    fs::create_dir(&empty).expect("a folder can be made");
    assert!(bake_small(dir, &empty, &[]).status.success());
    assert_good(&empty);
}

#[test]
fn a_bake_into_a_pipe_says_nothing_on_standard_error() {
    let folder = folder();
    let output = bake_small(folder.path(), &folder.path().join("terrain"), &[]);
    assert!(output.status.success());
    assert_eq!(text(&output.stderr), "");
    let report = text(&output.stdout);
    assert!(report.contains("300 x 200 samples"), "{report}");
    assert!(
        !report.contains(['\r', '\u{1b}']),
        "a progress bar in a pipe: {report:?}"
    );
    let verified = tessera()
        .arg("verify")
        .arg(folder.path().join("terrain"))
        .output()
        .expect("tessera runs");
    assert_eq!(
        (verified.status.code(), text(&verified.stderr)),
        (Some(0), String::new())
    );
}

fn assert_refused_without_a_trace(output: &Output, dir: &Path, left: &[&str]) {
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.starts_with("tessera: "), "{message}");
    assert_eq!(message.lines().count(), 1, "{message}");
    assert!(message.contains("can't be written"), "{message}");
    assert_eq!(entries(dir), left);
}

#[test]
fn an_output_that_cannot_be_written_is_refused_and_nothing_is_left() {
    let folder = folder();
    let dir = folder.path();
    // Below a file no folder can be made, whoever tries.
    let output = bake_small(dir, &dir.join("small.r16/terrain"), &[]);
    assert_refused_without_a_trace(&output, dir, &["small.r16"]);

    // A limit on file sizes stops a write in its middle, as a full disk does.
    let source = small_source(dir);
    let output = Command::new("sh")
        .args(["-c", "trap '' XFSZ; ulimit -f 20; exec \"$@\"", "sh"])
        .arg(env!("CARGO_BIN_EXE_tessera"))
        .arg("bake")
        .arg(&source)
        .args(["--size", "300x200", "--out"])
        .arg(dir.join("terrain"))
        .output()
        .expect("sh runs");
    assert_refused_without_a_trace(&output, dir, &["small.r16"]);
}

#[test]
fn a_full_disk_is_told_and_nothing_is_left() {
    let folder = folder();
    let dir = folder.path();
    let disk = dir.join("disk");
    fs::create_dir(&disk).expect("a folder can be made");
    let mounted = Command::new("mount")
        .args(["-t", "tmpfs", "-o", "size=200k", "tmpfs"])
        .arg(&disk)
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success());
    if !mounted {
        println!("skipped: no file system can be mounted here");
        return;
    }
    let output = bake_small(dir, &disk.join("terrain"), &[]);
    let left = entries(&disk);
    let unmounted = Command::new("umount").arg(&disk).status();
    assert!(unmounted.is_ok_and(|status| status.success()));
    assert!(left.is_empty(), "{left:?}");
    assert_refused_without_a_trace(&output, dir, &["disk", "small.r16"]);
}

struct Terrain {
    _folder: tempfile::TempDir,
    out: PathBuf,
}

fn terrain() -> Terrain {
    let folder = folder();
    let out = folder.path().join("terrain");
    bake_heights(
        [400, 300],
        landscape([400, 300], 5),
        &out,
        &BakeSettings::default(),
    );
    Terrain {
        _folder: folder,
        out,
    }
}

fn verify(out: &Path) -> (Option<i32>, String) {
    let output = tessera()
        .arg("verify")
        .arg(out)
        .output()
        .expect("tessera runs");
    (output.status.code(), text(&output.stderr))
}

#[test]
fn verify_names_every_damaged_tile() {
    let Terrain { _folder, out } = &terrain();
    assert_eq!(verify(out).0, Some(0));
    let height = |x, z| tile_path(TileAddress::new(0, x, z));
    let density = height;
    let change = |path: &str, change: &dyn Fn(&mut Vec<u8>)| {
        let path = out.join(path);
        let mut bytes = fs::read(&path).expect("readable");
        change(&mut bytes);
        fs::write(&path, bytes).expect("writable");
    };
    change(&height(0, 0), &|bytes| bytes[0] = b'X');
    change(&height(1, 0), &|bytes| bytes[8] = 9);
    change(&height(2, 0), &|bytes| bytes[5000] ^= 1);
    change(&height(3, 0), &|bytes| bytes.truncate(1000));
    change(&height(0, 1), &|bytes| bytes.clear());
    fs::copy(out.join(height(2, 1)), out.join(height(1, 1))).expect("it can be copied");
    fs::remove_file(out.join(density(3, 1))).expect("it can be removed");
    change(&density(0, 2), &|bytes| bytes.push(0));
    let (code, message) = verify(out);
    assert_eq!(code, Some(1));
    for (tile, cause) in [
        ("0/0_0", "starts with"),
        ("0/1_0", "version 9 where this program reads version 2"),
        ("0/2_0", "checksum"),
        ("0/3_0", "bytes"),
        ("0/0_1", "ends after 0 bytes"),
        ("0/1_1", "holds tile 0/2_1 where tile 0/1_1 belongs"),
        ("0/3_1", "can't be read"),
        ("0/0_2", "bytes"),
    ] {
        let named = |line: &&str| line.starts_with(&format!("tile {tile}: "));
        let line = message
            .lines()
            .find(named)
            .unwrap_or_else(|| panic!("{tile}:\n{message}"));
        assert!(line.contains(cause), "{line}");
    }
    assert!(message.contains("8 of "), "{message}");
    assert_eq!(message.lines().count(), 9, "{message}");
}

#[test]
fn verify_finds_borders_that_differ_though_every_checksum_is_right() {
    let Terrain { _folder, out } = &terrain();
    let address = TileAddress::new(0, 1, 1);
    let mut tile = bake_support::heights(out, address);
    // The south-eastern corner of the border: three neighbours hold it, none as its own range.
    let last = tile.samples().len() - 1;
    tile.samples_mut()[last] ^= 1;
    let good = bake_support::densities(out, address);
    let errors = bake_support::errors(out, address);
    let stamp = manifest(out).file.stamp();
    let write = |heights: &HeightTile, densities: &DensityTile| {
        let bytes = encode_tile(address, stamp, heights, densities, &errors);
        fs::write(out.join(tile_path(address)), bytes).expect("writable");
    };
    write(&tile, &good);
    let report = bake::verify(out, &|_| {}).expect("the manifest is good");
    assert!(!report.faults.is_empty());
    for (tile, fault) in &report.faults {
        let Fault::HeightBorder { neighbour } = fault else {
            panic!("{tile}: {fault}");
        };
        assert!(*tile == address || *neighbour == address, "{tile}: {fault}");
    }

    let mut densities = good;
    densities.samples_mut()[35] ^= 1;
    write(&tile, &densities);
    let report = bake::verify(out, &|_| {}).expect("the manifest is good");
    let densities =
        |(_, fault): &&(TileAddress, Fault)| matches!(fault, Fault::DensityBorder { .. });
    assert!(report.faults.iter().any(|fault| densities(&fault)));
}

#[test]
fn tiles_name_their_terrain_and_those_of_others_are_refused() {
    let Terrain { _folder, out } = &terrain();
    let stamp = manifest(out).file.stamp();
    let address = TileAddress::new(0, 1, 1);
    let path = out.join(tile_path(address));
    let bytes = fs::read(&path).expect("readable");
    let mut tile = TerrainTile::decode(&bytes, address).expect("good");
    assert_eq!(tile.stamp, stamp);
    assert_eq!(tile.check(&manifest(out), address), Ok(()));
    tile.stamp ^= 1;
    let found = tile.stamp;
    fs::write(&path, tile.encode(address)).expect("writable");

    let report = bake::verify(out, &|_| {}).expect("the manifest is good");
    let wanted = Fault::Format {
        path: tile_path(address),
        reason: TileFormatError::Stamp {
            found,
            wanted: stamp,
        },
    };
    assert_eq!(report.faults, [(address, wanted)]);
    let error = bake::rebake_densities(out, &DensitySettings::default(), &()).expect_err("refused");
    assert!(error.to_string().contains("another terrain"), "{error}");
}

#[test]
fn verify_finds_error_bounds_that_fall_or_are_less_than_a_childs() {
    let Terrain { _folder, out } = &terrain();
    let faults = |address: TileAddress, change: &dyn Fn(&mut [[u8; 8]])| {
        let heights = bake_support::heights(out, address);
        let densities = bake_support::densities(out, address);
        let good = bake_support::errors(out, address);
        let stamp = manifest(out).file.stamp();
        let mut errors = good.clone();
        change(errors.texels_mut());
        let write = |errors: &ErrorTile| {
            let bytes = encode_tile(address, stamp, &heights, &densities, errors);
            fs::write(out.join(tile_path(address)), bytes).expect("writable");
        };
        write(&errors);
        let report = bake::verify(out, &|_| {}).expect("the manifest is good");
        write(&good);
        report.faults
    };
    let parent = TileAddress::new(1, 0, 0);
    assert_eq!(faults(parent, &|_| {}), []);
    let falls = faults(TileAddress::new(0, 1, 1), &|texels| {
        texels[32 * 5 + 7] = [9, 9, 9, 8, 9, 9, 9, 0]
    });
    let order = |(_, fault): &(TileAddress, Fault)| *fault == Fault::ErrorOrder { texel: [7, 5] };
    assert!(falls.iter().any(order), "{falls:?}");
    // The texel lies over the second child's.
    let child = TileAddress::new(0, 1, 0);
    let below = faults(parent, &|texels| texels[32 * 15 + 16] = [0; 8]);
    assert_eq!(below, [(parent, Fault::ErrorBelowChild { child })]);
}

#[test]
fn verify_finds_an_index_that_is_wrong() {
    let Terrain { _folder, out } = &terrain();
    let terrain = manifest(out);
    let rewrite = |change: &dyn Fn(&mut bevy_tessera::tile::TileIndex)| {
        let mut index = terrain.index.clone();
        change(&mut index);
        let bytes = index.encode();
        let mut file = terrain.file.clone();
        let text = fs::read_to_string(out.join("terrain.ron")).expect("readable");
        let old = manifest(out).file.index_crc32;
        file.index_crc32 = crc32fast::hash(&bytes);
        let text = text.replace(&old.to_string(), &file.index_crc32.to_string());
        fs::write(out.join("tiles.index"), bytes).expect("writable");
        fs::write(out.join("terrain.ron"), text).expect("writable");
        bake::verify(out, &|_| {})
            .expect("the manifest is good")
            .faults
    };
    let address = TileAddress::new(0, 2, 1);
    let range = terrain.index.get(address).expect("stored");
    let wider = TileRange {
        min: range.min,
        max: range.max + 1,
    };
    let faults = rewrite(&|index| index.set(address, Some(wider)));
    assert!(
        faults.contains(&(
            address,
            Fault::Range {
                found: wider,
                wanted: range
            }
        )),
        "{faults:?}"
    );
    // A parent that its children reach beyond.
    let parent = address.parent();
    let covering = terrain.index.get(parent).expect("stored");
    let narrow = TileRange {
        min: covering.min + 1,
        max: covering.max,
    };
    let faults = rewrite(&|index| index.set(parent, Some(narrow)));
    assert!(faults.iter().any(|(tile, _)| *tile == parent), "{faults:?}");

    let faults = rewrite(&|index| index.set(parent, None));
    assert!(faults.contains(&(address, Fault::Orphan)), "{faults:?}");
    let root = *addresses(&terrain.file).last().expect("there is a root");
    let faults = rewrite(&|index| index.set(root, None));
    assert!(faults.contains(&(root, Fault::NoRoot)), "{faults:?}");
    // A terrain may lack fine tiles: that alone is no fault.
    let faults = rewrite(&|index| {
        let [columns, rows] = terrain.file.tiles(0);
        for z in 0..rows {
            for x in 0..columns {
                index.set(TileAddress::new(0, x, z), None);
            }
        }
        for z in 0..2 {
            for x in 0..2 {
                let at = TileAddress::new(1, x, z);
                let tile = bake_support::heights(out, at);
                index.set(at, Some(tile.range()));
            }
        }
        let own = bake_support::heights(out, root).range();
        let all = (0..4).map(|at| TileAddress::new(1, at % 2, at / 2));
        let covering = all
            .filter_map(|at| index.get(at))
            .fold(own, TileRange::union);
        index.set(root, Some(covering));
    });
    assert!(faults.is_empty(), "{faults:?}");
}

#[test]
fn inspect_prints_what_a_terrain_holds() {
    let Terrain { _folder, out } = &terrain();
    let output = tessera()
        .arg("inspect")
        .arg(out)
        .output()
        .expect("tessera runs");
    assert!(output.status.success());
    let report = text(&output.stdout);
    assert!(report.contains("400 x 300 samples, 1 m apart"), "{report}");
    assert!(report.contains("4 x 3"), "{report}");
}

/// A source that is never surveyed, and turns bad near its end.
struct TurnsBad {
    next_row: u32,
    infinite: bool,
}

impl HeightSource for TurnsBad {
    fn name(&self) -> String {
        "the source".to_owned()
    }

    fn size(&self) -> [u32; 2] {
        [300, 400]
    }

    fn may_lack_data(&self) -> bool {
        false
    }

    fn rewind(&mut self) -> Result<(), SourceError> {
        self.next_row = 0;
        Ok(())
    }

    fn read_row(&mut self, row: &mut [f32]) -> Result<(), SourceError> {
        row.fill(5.0);
        if self.next_row == 390 {
            if !self.infinite {
                return Err(SourceError::new(self.name(), "it ends here"));
            }
            row[17] = f32::INFINITY;
        }
        self.next_row += 1;
        Ok(())
    }
}

#[test]
fn an_error_in_the_middle_of_a_bake_leaves_nothing() {
    let folder = folder();
    let dir = folder.path();
    let settings = BakeSettings {
        height_range_m: Some(0.0..=100.0),
        band_rows: Some(8),
        ..Default::default()
    };
    let mut errors = Vec::new();
    for infinite in [true, false] {
        let mut source = TurnsBad {
            next_row: 0,
            infinite,
        };
        let error = bake::bake(&mut source, &dir.join("terrain"), &settings, &());
        errors.push(error.expect_err("refused"));
        assert!(entries(dir).is_empty(), "{:?}", entries(dir));
    }
    assert!(matches!(
        errors[..],
        [
            BakeError::Infinite { x: 17, z: 390, .. },
            BakeError::Source(_)
        ]
    ));
}
