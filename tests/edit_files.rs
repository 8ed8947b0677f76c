//! Logs of edits in files: what is loaded is what was saved, whatever happened in between, or it is
//! refused.
#![cfg(unix)]

mod edit_support;

use bevy_tessera::edit::{
    Change, Edit, EditFileError, EditFormatError, EditLog, StampImage, TileSnapshot,
};
use bevy_tessera::tile::TileAddress;
use edit_support::{crater, raise, replay_steps, steps, terrain};
use proptest::prelude::*;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Tells a test that runs in a child process where to save.
const SAVE_TO: &str = "TESSERA_TEST_SAVE_TO";

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

fn entries(dir: &Path) -> Vec<String> {
    let mut all: Vec<String> = fs::read_dir(dir)
        .expect("readable")
        .map(|entry| {
            entry
                .expect("readable")
                .file_name()
                .to_string_lossy()
                .into_owned()
        })
        .collect();
    all.sort();
    all
}

/// A log with everything in it: edits of two kinds, an undo, a shared image and a snapshot.
fn varied() -> EditLog {
    let mut log = EditLog::new(&terrain());
    log.push(crater(640, 640, 900, 7)).expect("a good edit");
    for at in 0..3 {
        log.push(stamp(at, &image(4))).expect("a good edit");
    }
    log.undo(2).expect("it is active");
    assert!(
        log.keep_snapshot(TileSnapshot {
            address: TileAddress::new(1, 2, 0),
            sequence: 3,
            bytes: Arc::new([5; 40]),
        }) || log.last_sequence() == 5
    );
    log
}

fn image(side: u16) -> StampImage {
    let samples = (0..u32::from(side).pow(2)).map(|at| (at * 7919 % 30_011) as i16);
    StampImage {
        side,
        samples: samples.collect(),
    }
}

fn stamp(x: i32, image: &StampImage) -> Edit {
    Edit {
        centre: [x * 640, 0],
        reach: 6400,
        change: Change::Stamp {
            image: image.clone(),
            by: 300,
            turn: [1 << 14, 0],
            density: 0,
            scorch: 0,
            may_clamp: false,
        },
    }
}

/// A log of so many craters.
fn craters(count: u32) -> EditLog {
    let mut log = EditLog::new(&terrain());
    for at in 0..count {
        let x = (at * 7919 % 100_000) as i32;
        let edit = crater(
            x,
            (at * 31 % 77_777) as i32,
            640 + at % 600,
            at.wrapping_mul(40_503),
        );
        log.push(edit).expect("a good edit");
    }
    log
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn what_is_loaded_equals_what_was_saved(steps in steps(40), level in 0_u8..4, x in 0_u32..9) {
        let folder = folder();
        let mut log = replay_steps(&steps);
        let address = TileAddress::new(level, x, 3);
        let sequence = log.last_sequence();
        log.keep_snapshot(TileSnapshot { address, sequence, bytes: Arc::new([level; 50]) });

        let path = folder.path().join("saved.edits");
        log.save(&path).expect("it is saved");
        let mut loaded = EditLog::load(&path).expect("it is loaded");
        prop_assert_eq!(&loaded, &log);
        prop_assert_eq!(loaded.snapshots(), log.snapshots());
        prop_assert_eq!(loaded.encode(), log.encode());
        prop_assert!(loaded.check_terrain(&terrain()).is_ok());

        let path = folder.path().join("saved.ron");
        log.save_ron(&path).expect("it is saved");
        let readable = EditLog::load(&path).expect("it is loaded");
        prop_assert_eq!(&readable, &log);

        // Undo and redo go on where they stood.
        prop_assert_eq!(loaded.redo_last(), log.redo_last());
        prop_assert_eq!(loaded.undo_last(), log.undo_last());
    }
}

#[test]
fn images_that_stamps_share_are_stored_once_and_shared_again() {
    let big = image(256);
    let copy = StampImage {
        side: big.side,
        samples: big.samples.to_vec().into(),
    };
    let log = |stamps: i32| {
        let mut log = EditLog::new(&terrain());
        for at in 0..stamps {
            let image = if at % 2 == 0 { &big } else { &copy };
            log.push(stamp(at, image)).expect("a good edit");
        }
        log
    };
    let (one, fifty) = (log(1).encode().len(), log(50).encode().len());
    assert!(fifty < one + 50 * 20, "{one} bytes, and {fifty} for fifty");
    let shared = |log: &EditLog, sequence| {
        let edit = log.edit(sequence).expect("an edit").clone();
        let Change::Stamp { image, .. } = &edit.change else {
            panic!("a stamp");
        };
        image.samples.clone()
    };
    let loaded = EditLog::decode(&log(50).encode()).expect("it is good");
    assert!(Arc::ptr_eq(&shared(&loaded, 1), &shared(&loaded, 50)));
    let sent = postcard::to_stdvec(&log(50).diff(0)).expect("it can be sent");
    let alone = postcard::to_stdvec(&log(1).diff(0)).expect("it can be sent");
    assert!(
        sent.len() < alone.len() + 50 * 40,
        "{} of {}",
        sent.len(),
        alone.len()
    );
}

#[test]
fn a_readable_log_has_a_record_a_line() {
    let mut log = EditLog::new(&terrain());
    log.push(raise(1, 2, 640)).expect("a good edit");
    log.push(stamp(0, &image(2))).expect("a good edit");
    log.undo(1).expect("it is active");
    let text = log.to_ron();
    let has = |line: &str| {
        assert!(
            text.lines().any(|found| found.trim() == line),
            "{line}\n{text}"
        );
    };
    has("Undo(1),");
    has(
        "Apply(centre: (1, 2), reach: 640, change: Raise(by: 100, hardness: 200, density: 90, may_clamp: false)),",
    );
    has("format: \"tessera-edits\",");
    has("version: 1,");
    assert!(text.lines().count() < 20, "{text}");
}

#[test]
fn a_damaged_file_is_refused_whichever_byte_it_is() {
    let good = varied().encode();
    assert_eq!(EditLog::decode(&good).expect("it is good"), varied());
    for at in 0..good.len() {
        for bit in [0x01, 0x80, 0xff] {
            let mut bad = good.clone();
            bad[at] ^= bit;
            let error = EditLog::decode(&bad).expect_err("a bit is another");
            assert_eq!(error.to_string().lines().count(), 1, "{error}");
        }
    }
}

#[test]
fn a_file_of_any_other_length_is_refused() {
    let folder = folder();
    let path = folder.path().join("cut.edits");
    let good = varied().encode();
    for length in 0..good.len() {
        let cut = &good[..length];
        assert!(EditLog::decode(cut).is_err(), "{length} bytes");
        fs::write(&path, cut).expect("it can be written");
        let error = EditLog::load(&path).expect_err("it is cut").to_string();
        assert!(error.contains("cut.edits"), "{error}");
    }
    let mut longer = good;
    longer.push(0);
    let error = EditLog::decode(&longer).expect_err("it is longer");
    assert!(matches!(error, EditFormatError::Length { .. }), "{error}");
}

/// A file whose checksum is right, whatever else it says.
fn sealed(mut head: Vec<u8>, payload: &[u8]) -> Vec<u8> {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&head[..40]);
    hasher.update(payload);
    head.truncate(40);
    head.extend(hasher.finalize().to_le_bytes());
    head.extend(payload);
    head
}

/// A file of this payload that says to inflate to so many bytes.
fn file_of(payload: &[u8], inflated: u64) -> Vec<u8> {
    let mut head = varied().encode()[..24].to_vec();
    head.extend((payload.len() as u64).to_le_bytes());
    head.extend(inflated.to_le_bytes());
    sealed(head, payload)
}

fn deflated(bytes: &[u8]) -> Vec<u8> {
    use std::io::Write;
    let mut encoder = flate2::write::DeflateEncoder::new(Vec::new(), flate2::Compression::best());
    encoder.write_all(bytes).expect("memory");
    encoder.finish().expect("memory")
}

#[test]
fn sizes_that_lie_are_refused_before_memory_is_taken() {
    let bomb = deflated(&vec![0; 200 << 20]);
    // An honest bomb, a liar, and two of sizes that nothing has.
    for (payload, inflated, by_its_size) in [
        (&bomb[..], 200 << 20, true),
        (&bomb[..], 1000, false),
        (&bomb[..], u64::MAX, true),
        (&[][..], u64::MAX, true),
    ] {
        let error = EditLog::decode(&file_of(payload, inflated)).expect_err("it lies");
        let refused = matches!(error, EditFormatError::Inflation { .. });
        assert_eq!(refused, by_its_size, "{error}");
    }
    // A payload that promises records, images and samples without end.
    for start in [
        vec![0xff, 0xff, 0xff, 0xff, 0x0f],
        vec![1, 2, 0xff, 0xff, 0xff, 0xff, 0x0f],
        vec![0, 0xff, 0xff, 0xff, 0xff, 0x0f, 2, 1],
        vec![0, 0, 1, 0, 0, 0, 0, 0xff, 0xff, 0xff, 0xff, 0x0f],
        vec![0, 0, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x7f],
    ] {
        let payload = deflated(&start);
        let file = file_of(&payload, start.len() as u64);
        let error = EditLog::decode(&file).expect_err("nothing follows");
        assert!(matches!(error, EditFormatError::Content(_)), "{error}");
    }
}

#[test]
fn bytes_at_random_behind_a_good_checksum_never_panic() {
    let mut state = 1_u32;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    let good = {
        use std::io::Read;
        let mut plain = Vec::new();
        let bytes = varied().encode();
        flate2::read::DeflateDecoder::new(&bytes[44..])
            .read_to_end(&mut plain)
            .expect("it is good");
        plain
    };
    let mut refused = 0;
    for round in 0..4000 {
        let mut plain = good.clone();
        for _ in 0..1 + round % 5 {
            let at = usize::from(random()) * 256 + usize::from(random());
            let at = at % plain.len();
            plain[at] = random();
        }
        let payload = deflated(&plain);
        let result = EditLog::decode(&file_of(&payload, plain.len() as u64));
        refused += u32::from(result.is_err());
    }
    assert!(refused > 500, "{refused} of 4000 were refused");
}

#[test]
fn records_that_cannot_follow_each_other_are_refused() {
    let text = varied().to_ron();
    assert!(text.contains("Undo(2)"), "{text}");
    for (good, bad, reason) in [
        ("Undo(2)", "Redo(2)", "active already"),
        ("Undo(2)", "Undo(9)", "no edit of that number"),
        ("image: 0", "image: 7", "names image 7 of 1"),
        ("reach: 900", "reach: 0", "edit 1 can't be taken"),
        ("tessera-edits", "other", "is wanted"),
        ("version: 1", "version: 9", "version 9"),
    ] {
        let changed = text.replace(good, bad);
        assert_ne!(changed, text, "{good}");
        let error = EditLog::from_ron(&changed).expect_err(bad).to_string();
        assert!(error.contains(reason), "{error}");
    }
    for length in 0..text.len() - 2 {
        assert!(
            EditLog::from_ron(&text[..length]).is_err(),
            "{length} bytes"
        );
    }
}

#[test]
fn other_files_are_named_and_neither_loaded_nor_replaced() {
    let folder = folder();
    let path = folder.path().join("holiday.png");
    fs::write(&path, b"\x89PNG\r\n\x1a\n and so on").expect("it can be written");
    let error = EditLog::load(&path).expect_err("a picture").to_string();
    assert!(
        error.contains("holiday.png can't be loaded: it starts with"),
        "{error}"
    );
    let error = varied().save(&path).expect_err("a picture");
    assert!(matches!(error, EditFileError::NotEdits { .. }), "{error}");
    assert!(error.to_string().contains("holiday.png"), "{error}");
    assert!(fs::read(&path).expect("readable").starts_with(b"\x89PNG"));

    let error = varied()
        .save(folder.path())
        .expect_err("a folder")
        .to_string();
    assert!(error.contains("folder"), "{error}");
    let error = EditLog::load(folder.path())
        .expect_err("a folder")
        .to_string();
    assert!(error.contains("can't be read"), "{error}");
    let error = EditLog::load(&folder.path().join("none"))
        .expect_err("nothing")
        .to_string();
    assert!(error.contains("none can't be read"), "{error}");
    let missing = folder.path().join("no/such.edits");
    let error = varied().save(&missing).expect_err("no folder").to_string();
    assert!(error.contains("there is no folder"), "{error}");

    // An older version is named as such.
    let mut old = varied().encode();
    old[8] = 9;
    assert_eq!(
        EditLog::decode(&old),
        Err(EditFormatError::Version { found: 9 })
    );
    // A huge file of something else is refused by its start.
    let huge = folder.path().join("huge");
    let file = fs::File::create(&huge).expect("it can be made");
    file.set_len(1 << 40).expect("a sparse file");
    assert!(EditLog::load(&huge).is_err());
}

#[test]
fn a_damaged_save_may_be_replaced_and_a_link_stays_one() {
    let folder = folder();
    let path = folder.path().join("saved.edits");
    let mut bytes = varied().encode();
    bytes.truncate(100);
    for left in [bytes, Vec::new()] {
        fs::write(&path, left).expect("it can be written");
        varied().save(&path).expect("it is saved");
        assert_eq!(EditLog::load(&path).expect("it is loaded"), varied());
    }
    let link = folder.path().join("latest.edits");
    std::os::unix::fs::symlink(&path, &link).expect("a link");
    craters(3).save(&link).expect("it is saved");
    assert!(link.is_symlink());
    assert_eq!(EditLog::load(&path).expect("it is loaded"), craters(3));
}

#[test]
fn another_terrains_log_is_told_from_this_ones() {
    let mut other = terrain();
    other.height_step_m = 0.5;
    let error = varied().check_terrain(&other).expect_err("another terrain");
    assert!(
        error.to_string().contains("belong to another terrain"),
        "{error}"
    );
}

#[test]
fn what_killed_programs_left_is_ignored_and_cleared_by_the_next_save() {
    let folder = folder();
    let path = folder.path().join("saved.edits");
    varied().save(&path).expect("it is saved");
    let mut child = Command::new("true").spawn().expect("true runs");
    child.wait().expect("it ends");
    let gone = child.id();
    let alive = std::process::id();
    for process in [gone, alive] {
        let name = format!(".tessera-edits-{process}-77.partial");
        fs::write(folder.path().join(name), b"TSREDIT\0half").expect("it can be written");
    }
    fs::write(folder.path().join(".tessera-edits-notes.partial"), b"").expect("writable");
    assert_eq!(EditLog::load(&path).expect("it is loaded"), varied());
    varied().save(&path).expect("it is saved");
    assert_eq!(
        entries(folder.path()),
        [
            format!(".tessera-edits-{alive}-77.partial"),
            ".tessera-edits-notes.partial".to_owned(),
            "saved.edits".to_owned(),
        ]
    );
}

/// Runs one of this file's helpers in a process of its own.
fn helper(name: &str, path: &Path) -> Command {
    let mut command = Command::new(std::env::current_exe().expect("this program has a path"));
    command
        .args(["--exact", name, "--nocapture", "--test-threads", "1"])
        .env(SAVE_TO, path)
        .stdout(Stdio::null());
    command
}

fn save_to() -> Option<PathBuf> {
    std::env::var_os(SAVE_TO).map(PathBuf::from)
}

/// No test of its own: saves logs one after the other until it is killed.
#[test]
fn helper_saves_until_it_is_killed() {
    let Some(path) = save_to() else { return };
    let logs = [2000, 2500].map(craters);
    loop {
        for log in &logs {
            log.save(&path).expect("it is saved");
        }
    }
}

/// No test of its own: saves once, and says how it went.
#[test]
fn helper_saves_once() {
    let Some(path) = save_to() else { return };
    if let Err(error) = craters(20_000).save(&path) {
        eprintln!("told: {error}");
        std::process::exit(7);
    }
}

fn kill(mut child: Child) {
    child.kill().expect("it can be killed");
    child.wait().expect("it ends");
}

#[test]
fn a_program_killed_while_saving_leaves_a_save_that_loads() {
    let folder = folder();
    let path = folder.path().join("saved.edits");
    let first = craters(500);
    first.save(&path).expect("it is saved");
    let logs = [500, 2000, 2500].map(craters);
    let mut half_written = 0;
    let mut seed = std::process::id();
    for _ in 0..40 {
        let mut child = helper("helper_saves_until_it_is_killed", &path)
            .stderr(Stdio::null())
            .spawn()
            .expect("this program runs again");
        let before = fs::metadata(&path)
            .expect("it is there")
            .modified()
            .expect("a time");
        let started = Instant::now();
        // Saving has begun when the file is another.
        while fs::metadata(&path).is_ok_and(|file| file.modified().is_ok_and(|at| at == before)) {
            assert!(
                started.elapsed() < Duration::from_secs(60),
                "it saved nothing"
            );
            assert!(child.try_wait().expect("it runs").is_none(), "it ended");
            std::thread::sleep(Duration::from_micros(200));
        }
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        std::thread::sleep(Duration::from_micros(u64::from(seed >> 16) % 12_000));
        kill(child);
        let loaded = EditLog::load(&path).unwrap_or_else(|error| panic!("{error}"));
        assert!(logs.contains(&loaded), "{} records", loaded.len());
        let left = entries(folder.path()).len();
        assert!(left <= 2, "leftovers pile up: {left}");
        half_written += usize::from(left == 2);
    }
    println!("{half_written} of 40 were killed in the middle of a save");
    assert!(half_written > 0, "none was killed in the middle");
    first.save(&path).expect("it is saved");
    assert_eq!(entries(folder.path()), ["saved.edits"]);
    assert_eq!(EditLog::load(&path).expect("it is loaded"), first);
}

fn assert_told_and_unchanged(output: &Output, path: &Path, before: &EditLog) {
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(7), "{told}");
    assert!(told.contains("saved.edits can't be saved"), "{told}");
    assert!(
        told.contains("what was saved there before is unchanged"),
        "{told}"
    );
    assert_eq!(&EditLog::load(path).expect("the old save"), before);
    let folder = path.parent().expect("a folder");
    assert_eq!(entries(folder), ["saved.edits"]);
}

#[test]
fn a_full_disk_is_told_and_the_old_save_stays() {
    let folder = folder();
    let path = folder.path().join("saved.edits");
    let before = craters(10);
    before.save(&path).expect("it is saved");
    // A limit on file sizes stops a write in its middle, as a full disk does.
    let program = std::env::current_exe().expect("this program has a path");
    let output = Command::new("sh")
        .args(["-c", "trap '' XFSZ; ulimit -f 20; exec \"$@\"", "sh"])
        .arg(program)
        .args(["--exact", "helper_saves_once", "--nocapture"])
        .env(SAVE_TO, &path)
        .output()
        .expect("sh runs");
    assert_told_and_unchanged(&output, &path, &before);

    let disk = folder.path().join("disk");
    fs::create_dir(&disk).expect("a folder can be made");
    let mounted = Command::new("mount")
        .args(["-t", "tmpfs", "-o", "size=100k", "tmpfs"])
        .arg(&disk)
        .stderr(Stdio::null())
        .status()
        .is_ok_and(|status| status.success());
    if !mounted {
        println!("skipped: no file system can be mounted here");
        return;
    }
    let path = disk.join("saved.edits");
    before.save(&path).expect("it is saved");
    let output = helper("helper_saves_once", &path)
        .output()
        .expect("it runs again");
    let checked = std::panic::catch_unwind(|| assert_told_and_unchanged(&output, &path, &before));
    let unmounted = Command::new("umount").arg(&disk).status();
    assert!(unmounted.is_ok_and(|status| status.success()));
    if let Err(panic) = checked {
        std::panic::resume_unwind(panic);
    }
}
