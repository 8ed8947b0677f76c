//! Shards and merges by the tool: what is refused, resumed, linked and left behind.

use super::*;

fn tessera() -> Command {
    Command::new(env!("CARGO_BIN_EXE_tessera"))
}

fn text(output: &[u8]) -> String {
    String::from_utf8_lossy(output).into_owned()
}

fn raw(dir: &Path, size: [u32; 2]) -> PathBuf {
    let path = dir.join(format!("{}x{}.r16", size[0], size[1]));
    let samples: Vec<u8> = landscape(size, 11)
        .iter()
        .flat_map(|height| ((height + 100.0) * 150.0).max(0.0).to_le_bytes_u16())
        .collect();
    fs::write(&path, samples).expect("writable");
    path
}

trait ToCode {
    fn to_le_bytes_u16(self) -> [u8; 2];
}

impl ToCode for f32 {
    fn to_le_bytes_u16(self) -> [u8; 2] {
        (self as u16).to_le_bytes()
    }
}

fn bake_command(source: &Path, size: [u32; 2], out: &Path, more: &[&str]) -> Command {
    let mut command = tessera();
    command
        .arg("bake")
        .arg(source)
        .args(["--size", &format!("{}x{}", size[0], size[1]), "--out"])
        .arg(out)
        .args(more);
    command
}

fn run(mut command: Command) -> Output {
    command.output().expect("tessera runs")
}

fn assert_succeeds(command: Command) -> String {
    let output = run(command);
    assert!(output.status.success(), "{}", text(&output.stderr));
    text(&output.stdout)
}

/// Runs what must be refused; returns the sentence.
fn assert_refused(command: Command) -> String {
    let output = run(command);
    let message = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert_eq!(message.lines().count(), 1, "{message}");
    assert!(message.starts_with("tessera: "), "{message}");
    message
}

fn merge_command(parts: &[PathBuf], out: &Path, more: &[&str]) -> Command {
    let mut command = tessera();
    command
        .arg("merge")
        .args(parts)
        .arg("--out")
        .arg(out)
        .args(more);
    command
}

/// When each tile of the complete rows was last written.
fn times(dir: &Path, part: &PartFile) -> BTreeMap<PathBuf, (u64, SystemTime)> {
    let rows = part.rows_done();
    let mut all = BTreeMap::new();
    for level in 0..=part.top {
        let up = part.top - level;
        let [columns, last] = part.terrain.tiles(level);
        for z in rows.start << up..(rows.end << up).min(last) {
            for x in 0..columns {
                let path = dir.join(tile_path(TileAddress::new(level, x, z)));
                let metadata = fs::metadata(&path).expect("a complete tile is there");
                let modified = metadata.modified().expect("a time");
                all.insert(path, (metadata.ino(), modified));
            }
        }
    }
    all
}

#[test]
fn a_killed_shard_goes_on_where_it_was_and_makes_the_same_bytes() {
    let folder = folder();
    let dir = folder.path();
    let size = [1500, 5000];
    let source = raw(dir, size);
    let whole = dir.join("whole");
    assert_succeeds(bake_command(&source, size, &whole, &[]));
    let mut random = 12_345_u32;
    let (mut in_the_middle, mut kept_tiles) = (0, 0);
    let mut parts = Vec::new();
    for number in 1..=2 {
        let part = part_name(dir, number);
        let which = format!("{number}/2");
        let mut before: BTreeMap<PathBuf, (u64, SystemTime)> = BTreeMap::new();
        for _ in 0..12 {
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let mut child = bake_command(&source, size, &part, &["--shard", &which])
                .stdout(Stdio::null())
                .stderr(Stdio::null())
                .spawn()
                .expect("tessera runs");
            std::thread::sleep(Duration::from_millis(u64::from((random >> 16) % 600)));
            // SIGKILL, on Unix.
            child.kill().expect("it can be killed");
            child.wait().expect("it ends");
            let Ok(file) = PartFile::read(&part) else {
                assert!(before.is_empty(), "a part is gone");
                continue;
            };
            let after = times(&part, &file);
            for (path, time) in &before {
                assert_eq!(
                    after.get(path),
                    Some(time),
                    "{} was made again",
                    path.display()
                );
            }
            let done = file.rows_done().len();
            if done > 0 && !file.is_complete() {
                in_the_middle += 1;
                kept_tiles += before.len();
            }
            before = after;
        }
        let said = assert_succeeds(bake_command(&source, size, &part, &["--shard", &which]));
        let file = PartFile::read(&part).expect("a part");
        assert!(file.is_complete());
        assert_eq!(said.contains("from before"), !before.is_empty(), "{said}");
        for (path, time) in &before {
            let after = times(&part, &file);
            assert_eq!(
                after.get(path),
                Some(time),
                "{} was made again",
                path.display()
            );
        }
        parts.push(part);
    }
    assert!(in_the_middle > 0, "no kill fell between two rows");
    println!("{in_the_middle} kills with some rows complete, {kept_tiles} tiles kept");
    let out = dir.join("terrain");
    assert_succeeds(merge_command(&parts, &out, &[]));
    assert_same_tree(&whole, &out, "after kills");
}

/// Two parts of two, of a source of 300 x 700 samples, as the tool makes them.
struct TwoParts {
    _folder: tempfile::TempDir,
    dir: PathBuf,
    source: PathBuf,
    parts: Vec<PathBuf>,
}

const SIZE: [u32; 2] = [300, 700];
const RANGE: [&str; 2] = ["--height-range-m", "0..40000"];

fn two_parts() -> TwoParts {
    let folder = folder();
    let dir = folder.path().to_owned();
    let source = raw(&dir, SIZE);
    let parts = (1..=2)
        .map(|number| {
            let part = part_name(&dir, number);
            let which = format!("{number}/2");
            let more = ["--shard", &which, RANGE[0], RANGE[1]];
            assert_succeeds(bake_command(&source, SIZE, &part, &more));
            part
        })
        .collect();
    TwoParts {
        _folder: folder,
        dir,
        source,
        parts,
    }
}

#[test]
fn a_part_is_gone_on_with_only_by_the_same_bake() {
    let two = two_parts();
    let part = &two.parts[0];
    let before = tree(part);
    let base = ["--shard", "1/2", RANGE[0], RANGE[1]];
    let said = assert_succeeds(bake_command(&two.source, SIZE, part, &base));
    assert!(said.contains("from before"), "{said}");
    for (more, cause) in [
        (
            &["--shard", "2/2", RANGE[0], RANGE[1]][..],
            "shard 1/2 where 2/2",
        ),
        (&["--shard", "1/3", RANGE[0], RANGE[1]], "numbers of shards"),
        (
            &["--shard", "1/2", "--height-range-m", "0..5000"],
            "heights in metres",
        ),
        (&["--shard", "1/2"], "heights in metres"),
        (
            &["--shard", "1/2", RANGE[0], RANGE[1], "--spacing-m", "2"],
            "metres between",
        ),
        (
            &["--shard", "1/2", RANGE[0], RANGE[1], "--gain", "2"],
            "density settings",
        ),
        (
            &["--shard", "1/2", RANGE[0], RANGE[1], "--big-endian"],
            "sources",
        ),
    ] {
        let message = assert_refused(bake_command(&two.source, SIZE, part, more));
        assert!(message.contains("part of another bake"), "{message}");
        assert!(message.contains(cause), "{more:?}: {message}");
    }
    let other = raw(&two.dir, [300, 701]);
    let message = assert_refused(bake_command(&other, [300, 701], part, &base));
    assert!(message.contains("sizes in samples"), "{message}");
    // Another version's.
    assert_eq!(tree(part), before, "the part was changed");
    let path = part.join("part.ron");
    let text = fs::read_to_string(&path).expect("readable");
    let version = format!("program: \"{}\"", env!("CARGO_PKG_VERSION"));
    assert!(text.contains(&version), "{text}");
    fs::write(&path, text.replace(&version, "program: \"0.0.7\"")).expect("writable");
    let message = assert_refused(bake_command(&two.source, SIZE, part, &base));
    assert!(message.contains("programs' versions"), "{message}");

    // Said so, any of them takes its place.
    let more = ["--shard", "1/3", "--force", RANGE[0], RANGE[1]];
    fs::write(part.join("notes.txt"), "mine").expect("writable");
    assert_succeeds(bake_command(&two.source, SIZE, part, &more));
    assert_eq!(PartFile::read(part).expect("a part").shard, shard(1, 3));
    assert_eq!(fs::read(part.join("notes.txt")).expect("kept"), b"mine");
}

#[test]
fn merge_names_the_part_that_is_missing_double_unfinished_or_of_another_bake() {
    let two = two_parts();
    let (out, [one, other]) = (two.dir.join("terrain"), [&two.parts[0], &two.parts[1]]);
    let refused = |parts: &[&PathBuf], causes: &[&str]| {
        let parts: Vec<_> = parts.iter().map(|part| (*part).clone()).collect();
        let message = assert_refused(merge_command(&parts, &out, &[]));
        for cause in causes {
            assert!(message.contains(cause), "{cause}: {message}");
        }
        assert!(!out.exists());
        let left = entries(&two.dir);
        assert!(
            !left.iter().any(|name| name.contains("partial")),
            "{left:?}"
        );
    };
    refused(&[one], &["shard 2/2 is missing"]);
    refused(&[other], &["shard 1/2 is missing"]);
    refused(&[one, other, one], &["shard 1/2 is given twice", "part1"]);
    let none = two.dir.join("none");
    refused(&[one, &none], &["none is no part of a bake"]);

    let third = two.dir.join("third");
    let bake = |more: &[&str]| {
        let mut all = vec!["--force", "--shard", "2/2", RANGE[0], RANGE[1]];
        all.extend(more);
        assert_succeeds(bake_command(&two.source, SIZE, &third, &all));
    };
    bake(&["--exponent", "2"]);
    refused(
        &[one, &third],
        &["part1", "third", "density settings differ"],
    );
    bake(&["--spacing-m", "2"]);
    refused(
        &[one, &third],
        &["metres between their samples differ (1.0 and 2.0)"],
    );
    bake(&["--height-scale", "0.5"]);
    refused(&[one, &third], &["sources"]);
    let three = ["--force", "--shard", "2/3", RANGE[0], RANGE[1]];
    assert_succeeds(bake_command(&two.source, SIZE, &third, &three));
    refused(&[one, &third], &["numbers of shards differ (2 and 3)"]);

    // A part that a killed bake left.
    let path = other.join("part.ron");
    let text = fs::read_to_string(&path).expect("readable");
    let (start, end) = (
        text.find("clamped").expect("there"),
        text.rfind(']').expect("there"),
    );
    let cut = format!("{}clamped: [0{}", &text[..start], &text[end..]);
    fs::write(&path, cut).expect("writable");
    refused(
        &[one, other],
        &["part2 is not complete: 1 of its 3 rows", "--shard 2/2"],
    );
    fs::write(&path, "nonsense").expect("writable");
    refused(&[one, other], &["part2/part.ron can't be used"]);
}

#[test]
fn merge_names_a_tile_that_is_damaged_or_does_not_fit() {
    let two = two_parts();
    let out = two.dir.join("terrain");
    let parts = &two.parts;
    let refused = |causes: &[&str]| {
        let message = assert_refused(merge_command(parts, &out, &[]));
        for cause in causes {
            assert!(message.contains(cause), "{cause}: {message}");
        }
        assert!(!out.exists());
    };
    let address = TileAddress::new(0, 1, 3);
    let path = parts[1].join(tile_path(address));
    let good = fs::read(&path).expect("the second part begins with row 3");

    let mut bytes = good.clone();
    bytes[9000] ^= 1;
    fs::write(&path, &bytes).expect("writable");
    refused(&[
        "part2/tile/0/1_3.tile can't be used",
        "checksum",
        "--shard 2/2",
    ]);
    fs::write(&path, &good[..500]).expect("writable");
    refused(&["part2/tile/0/1_3.tile can't be used", "bytes"]);
    fs::remove_file(&path).expect("removable");
    refused(&["part2/tile/0/1_3.tile can't be used", "No such file"]);

    // A sound tile whose border another shard's tile holds too.
    let stamp = TerrainTile::decode(&good, address).expect("sound").stamp;
    let write = |heights: &_, densities: &_| {
        let errors = errors(&two.parts[1], address);
        let tile = encode_tile(address, stamp, heights, densities, &errors);
        fs::write(&path, tile).expect("writable");
    };
    fs::write(&path, &good).expect("writable");
    let (good_heights, good_densities) = (
        heights(&two.parts[1], address),
        densities(&two.parts[1], address),
    );
    // Row -2 and column 40, which only the tile above has in its own square.
    let mut changed = good_heights.clone();
    changed.samples_mut()[42] ^= 1;
    write(&changed, &good_densities);
    refused(&[
        "part2/tile/0/1_3.tile",
        "part1/tile/0/1_2.tile",
        "differ in heights",
    ]);
    fs::write(&path, &good).expect("writable");
    let mut changed = good_densities.clone();
    changed.samples_mut()[17] ^= 1;
    write(&good_heights, &changed);
    refused(&[
        "part2/tile/0/1_3.tile",
        "part1/tile/0/1_2.tile",
        "differ in densities",
    ]);
    // Inside of a part.
    fs::write(&path, &good).expect("writable");
    let mut changed = good_heights.clone();
    changed.samples_mut()[133 * 60] ^= 1;
    write(&changed, &good_densities);
    refused(&[
        "part2/tile/0/1_3.tile",
        "part2/tile/0/0_3.tile",
        "differ in heights",
    ]);

    // What is damaged is made again, and nothing else is wrong.
    fs::write(&path, &good[..500]).expect("writable");
    let more = ["--shard", "2/2", RANGE[0], RANGE[1]];
    assert_succeeds(bake_command(&two.source, SIZE, &parts[1], &more));
    assert!(fs::read(&path).expect("there") == good);
    assert_succeeds(merge_command(parts, &out, &[]));
}

#[test]
fn merge_finds_parts_of_sources_that_differ_near_the_border() {
    let two = two_parts();
    let mut samples = fs::read(&two.source).expect("readable");
    // In the last row that the first part's tiles show, which is also the second part's.
    let at = 2 * (300 * 384 + 150);
    samples[at] ^= 64;
    fs::write(&two.source, samples).expect("writable");
    let more = ["--force", "--shard", "2/2", RANGE[0], RANGE[1]];
    assert_succeeds(bake_command(&two.source, SIZE, &two.parts[1], &more));
    let message = assert_refused(merge_command(&two.parts, &two.dir.join("terrain"), &[]));
    assert!(message.contains("part2/tile/0/1_3.tile"), "{message}");
    assert!(message.contains("bake shard 2/2 or 1/2 again"), "{message}");
}

#[test]
fn merged_tiles_are_links_and_parts_live_on() {
    let two = two_parts();
    let out = two.dir.join("terrain");
    let before: Vec<_> = two.parts.iter().map(|part| tree(part)).collect();
    let said = assert_succeeds(merge_command(&two.parts, &out, &[]));
    assert!(said.contains("18 tiles linked, 0 copied"), "{said}");
    let after: Vec<_> = two.parts.iter().map(|part| tree(part)).collect();
    assert!(before == after, "a part changed");
    let whole = two.dir.join("whole");
    assert_succeeds(bake_command(&two.source, SIZE, &whole, &RANGE));
    assert_same_tree(&whole, &out, "merged");
    let inode = |path: PathBuf| fs::metadata(path).expect("there").ino();
    let tile = tile_path(TileAddress::new(0, 2, 5));
    assert_eq!(inode(out.join(&tile)), inode(two.parts[1].join(&tile)));

    // Baked again, a part doesn't touch the terrain; neither does one that goes on.
    let again = |more: &[&str]| {
        let mut all = vec!["--shard", "2/2", RANGE[0], RANGE[1]];
        all.extend(more);
        assert_succeeds(bake_command(&two.source, SIZE, &two.parts[1], &all));
        assert_same_tree(&whole, &out, "after another bake of a part");
    };
    again(&["--force", "--gain", "3"]);
    again(&["--force"]);
    // Its copy is damaged, not the file that the terrain shares.
    let path = two.parts[1].join(&tile);
    fs::remove_file(&path).expect("removable");
    fs::write(&path, b"damaged").expect("writable");
    again(&[]);

    // Merged again, over what is there, what else lies there stays.
    fs::write(out.join("notes.txt"), "mine").expect("writable");
    assert!(assert_refused(merge_command(&two.parts, &out, &[])).contains("--force"));
    assert_succeeds(merge_command(&two.parts, &out, &["--force"]));
    assert_eq!(fs::read(out.join("notes.txt")).expect("kept"), b"mine");
    fs::remove_file(out.join("notes.txt")).expect("removable");
    assert_same_tree(&whole, &out, "merged again");

    // A sound tile of a row that is made again gets a file of its own: were it written in its place,
    // the terrain would lack it meanwhile.
    let beside = tile_path(TileAddress::new(0, 0, 5));
    let shared = inode(out.join(&beside));
    assert_eq!(inode(two.parts[1].join(&beside)), shared);
    fs::remove_file(&path).expect("removable");
    again(&[]);
    assert_ne!(inode(two.parts[1].join(&beside)), shared);
    assert_eq!(inode(out.join(&beside)), shared);
    for part in &two.parts {
        fs::remove_dir_all(part).expect("removable");
    }
    assert_same_tree(&whole, &out, "without parts");
}

#[test]
fn a_part_is_never_mistaken_for_a_terrain_nor_put_over_anything_else() {
    let two = two_parts();
    let part = &two.parts[0];
    for command in ["inspect", "verify", "density"] {
        let mut tool = tessera();
        tool.arg(command).arg(part);
        if command == "inspect" {
            let said = assert_succeeds(tool);
            assert!(said.contains("shard 1/2"), "{said}");
            assert!(said.contains("complete"), "{said}");
        } else {
            assert_refused(tool);
        }
    }
    // No bake and no merge replaces a part.
    let before = tree(part);
    for more in [&[][..], &["--force"]] {
        assert_refused(bake_command(&two.source, SIZE, part, more));
        assert_refused(merge_command(&two.parts, part, more));
    }
    assert!(tree(part) == before, "a part was replaced");
    // And no part replaces a terrain, or what isn't ours.
    let terrain = two.dir.join("terrain");
    assert_succeeds(merge_command(&two.parts, &terrain, &[]));
    let mine = two.dir.join("mine");
    fs::create_dir(&mine).expect("a folder");
    fs::write(mine.join("thesis.txt"), "years").expect("writable");
    let file = two.dir.join("file");
    fs::write(&file, "x").expect("writable");
    for out in [&terrain, &mine, &file] {
        for more in [&["--shard", "1/2"][..], &["--shard", "1/2", "--force"]] {
            let message = assert_refused(bake_command(&two.source, SIZE, out, more));
            assert!(message.contains("is not a part"), "{message}");
        }
    }
    assert_eq!(entries(&mine), ["thesis.txt"]);
    for which in ["0/2", "3/2", "1", "1/0", "a/b", "1/70000"] {
        let output = run(bake_command(
            &two.source,
            SIZE,
            &two.dir.join("new"),
            &["--shard", which],
        ));
        assert!(!output.status.success(), "{which}");
        assert!(
            text(&output.stderr).contains("shard"),
            "{}",
            text(&output.stderr)
        );
    }
}

#[test]
fn a_shard_whose_disk_is_full_says_so_and_goes_on_later() {
    let two = two_parts();
    let part = two.dir.join("late");
    // A limit on file sizes stops a write in its middle, as a full disk does.
    let mut command = Command::new("sh");
    command
        .args(["-c", "trap '' XFSZ; ulimit -f 20; exec \"$@\"", "sh"])
        .arg(env!("CARGO_BIN_EXE_tessera"))
        .arg("bake")
        .arg(&two.source)
        .args([
            "--size", "300x700", "--shard", "2/2", RANGE[0], RANGE[1], "--out",
        ])
        .arg(&part);
    let message = assert_refused(command);
    assert!(message.contains("can't be written"), "{message}");
    assert!(message.contains("goes on from there"), "{message}");
    assert!(!PartFile::read(&part).expect("a part stays").is_complete());
    let more = ["--shard", "2/2", RANGE[0], RANGE[1]];
    assert_succeeds(bake_command(&two.source, SIZE, &part, &more));
    assert_same_tree(&two.parts[1], &part, "after a full disk");
}

#[test]
fn a_merge_whose_disk_is_full_leaves_no_terrain_and_the_parts() {
    let two = two_parts();
    let before: Vec<_> = two.parts.iter().map(|part| tree(part)).collect();
    let out = two.dir.join("terrain");
    let left = entries(&two.dir);
    let mut command = Command::new("sh");
    command
        .args(["-c", "trap '' XFSZ; ulimit -f 20; exec \"$@\"", "sh"])
        .arg(env!("CARGO_BIN_EXE_tessera"))
        .arg("merge")
        .args(&two.parts)
        .arg("--out")
        .arg(&out);
    let message = assert_refused(command);
    assert!(message.contains("can't be written"), "{message}");
    assert!(message.contains("nothing was left behind"), "{message}");
    assert_eq!(entries(&two.dir), left);
    assert!(before == two.parts.iter().map(|part| tree(part)).collect::<Vec<_>>());
    assert_succeeds(merge_command(&two.parts, &out, &[]));
}

#[test]
fn a_part_is_baked_by_one_process_at_a_time() {
    let two = two_parts();
    let lock = fs::File::open(two.parts[0].join("part.lock")).expect("there");
    lock.try_lock().expect("nobody has it");
    let more = ["--shard", "1/2", RANGE[0], RANGE[1]];
    let message = assert_refused(bake_command(&two.source, SIZE, &two.parts[0], &more));
    assert!(message.contains("another process"), "{message}");
    drop(lock);
    assert_succeeds(bake_command(&two.source, SIZE, &two.parts[0], &more));
}

#[test]
fn an_unfit_source_leaves_no_part() {
    let folder = folder();
    let out = folder.path().join("part");
    let mut empty = source([20, 30], vec![f32::NAN; 600]);
    let result: Result<ShardReport, ShardError> =
        bake_shard(&mut empty, &out, &BakeSettings::default(), shard(1, 2), &());
    assert!(matches!(result, Err(ShardError::Bake(_))));
    assert!(!out.exists());
}
