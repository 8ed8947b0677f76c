//! `tessera generate`, `density` and `preview` as a user runs them.

mod bake_support;

use bake_support::{entries, manifest};
use bevy_tessera::bake::verify;
use bevy_tessera::density::{DensityBorder, DensityFilter, DensitySettings};
use bevy_tessera::tile::tile_path;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

fn tessera(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_tessera"))
        .args(arguments)
        .output()
        .expect("tessera runs")
}

fn text(output: &[u8]) -> String {
    String::from_utf8_lossy(output).into_owned()
}

/// Runs what must work, and returns what it prints.
fn run(arguments: &[&str]) -> String {
    let output = tessera(arguments);
    let message = text(&output.stderr);
    assert!(output.status.success(), "{arguments:?}: {message}");
    assert!(message.is_empty(), "{arguments:?}: {message}");
    text(&output.stdout)
}

/// Runs what must be refused, and returns the sentence.
fn refused(arguments: &[&str]) -> String {
    let output = tessera(arguments);
    let message = text(&output.stderr);
    assert!(!output.status.success(), "{arguments:?} was accepted");
    assert!(output.stdout.is_empty(), "{arguments:?}");
    assert!(
        !message.contains("panicked") && !message.contains("internal"),
        "{message}"
    );
    message
}

fn path(dir: &Path, name: &str) -> String {
    dir.join(name).to_string_lossy().into_owned()
}

fn assert_good(dir: &str) {
    let report = verify(Path::new(dir), &|_| {}).expect("it can be read");
    assert!(report.faults.is_empty(), "{:?}", report.faults);
}

/// Every byte of a terrain's tiles.
fn tiles(dir: &str) -> Vec<Vec<u8>> {
    let dir = Path::new(dir);
    let of = |address| [tile_path(address)];
    let all = manifest(dir).index;
    let files = all.iter().flat_map(|(address, _)| of(address));
    files
        .map(|file| fs::read(dir.join(file)).expect("readable"))
        .collect()
}

#[test]
fn generate_makes_a_terrain_of_every_kind_that_a_seed_tells_apart() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for kind in ["fbm", "ridged", "hybrid", "diamond-square"] {
        let make = |name: &str, seed: &str| {
            let out = path(folder.path(), &format!("{kind}{name}"));
            let printed = run(&[
                "generate", kind, "--seed", seed, "--size", "200x130", "--out", &out,
            ]);
            assert!(
                printed.contains("200 x 130 samples, 1 m apart"),
                "{printed}"
            );
            assert_good(&out);
            tiles(&out)
        };
        let first = make("a", "7");
        assert!(
            first == make("b", "7"),
            "{kind}: the same seed made other ground"
        );
        assert!(
            first != make("c", "8"),
            "{kind}: another seed made the same ground"
        );
    }
}

#[test]
fn generate_takes_the_options_of_a_bake() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = path(folder.path(), "terrain");
    let mut arguments = vec!["generate", "hybrid", "--out", &out, "--size", "129x129"];
    arguments.extend(["--filter", "gaussian", "--gain", "3", "--exponent", "0.5"]);
    arguments.extend([
        "--filter-size",
        "4",
        "--lod-skip",
        "2",
        "--border",
        "point-sampled",
    ]);
    arguments.extend([
        "--no-preprocess",
        "--spacing-m",
        "2.5",
        "--wavelength-m",
        "100",
    ]);
    run(&arguments);
    let file = manifest(Path::new(&out)).file;
    assert_eq!(file.spacing_m, 2.5);
    let wanted = DensitySettings {
        filter: DensityFilter::Gaussian,
        gain: 3.0,
        exponent: 0.5,
        preprocess: false,
        filter_size: 4,
        border: DensityBorder::PointSampled,
        lod_skip: 2,
    };
    assert_eq!(file.density, wanted);
    let printed = run(&["inspect", &out]);
    assert!(
        printed.contains("gaussian curvature, gain 3, exponent 0.5, not spread"),
        "{printed}"
    );

    assert!(refused(&arguments).contains("exists already"));
    arguments.push("--force");
    run(&arguments);
    assert_eq!(entries(folder.path()), ["terrain"]);
}

#[test]
fn generate_refuses_what_is_out_of_range_and_leaves_nothing() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = path(folder.path(), "terrain");
    for (option, value, says) in [
        ("--roughness", "9", "0 and 4"),
        ("--octaves", "0", "1..=32"),
        ("--spacing-m", "0", "0.0001"),
        ("--relief-m", "-1", "0 and 1000000"),
        ("--wavelength-m", "0.5", "wavelength"),
        ("--size", "1x1", "2 to 16777216"),
        ("--size", "9", "WIDTHxHEIGHT"),
        ("--seed", "-1", "0..=18446744073709551615"),
        ("--gain", "0", "0.001..=1000"),
        ("--filter", "sobel", "laplace-beltrami"),
    ] {
        let joined = format!("{option}={value}");
        let message = refused(&["generate", "fbm", "--out", &out, &joined]);
        assert!(message.contains(says), "{joined}: {message}");
        assert!(entries(folder.path()).is_empty(), "{joined}");
        let apart = refused(&["generate", "fbm", "--out", &out, option, value]);
        assert_eq!(apart, message);
    }
    let message = refused(&["generate", "worley", "--out", &out]);
    assert!(message.contains("diamond-square"), "{message}");
    let wrap = [
        "generate",
        "diamond-square",
        "--wrap",
        "--size",
        "100x100",
        "--out",
        &out,
    ];
    assert!(refused(&wrap).contains("2^n + 1"));
}

/// In the words that follow the option, not as an option of its own.
#[test]
fn numbers_that_are_none_or_negative_are_refused_with_the_option_and_its_range() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (out, picture) = (
        path(folder.path(), "terrain"),
        path(folder.path(), "picture.png"),
    );
    let check = |command: &[&str], option: &str, values: &[&str], says: [&str; 2]| {
        for value in values {
            let arguments = [command, &[option, value]].concat();
            let message = refused(&arguments);
            assert!(
                says.iter().all(|says| message.contains(says)),
                "{arguments:?}: {message}"
            );
            assert!(!message.contains("unexpected"), "{arguments:?}: {message}");
        }
    };
    let raw = path(folder.path(), "a.r16");
    fs::write(&raw, [7; 2 * 64 * 64]).expect("written");
    let generate = ["generate", "fbm", "--out", &out];
    let bake = ["bake", &raw, "--size", "64x64", "--out", &out];
    for command in [&generate[..], &bake] {
        let density_is = |option, values: &[&str], says| check(command, option, values, says);
        density_is(
            "--filter-size",
            &["-1", "0", "33", "1.5", "x", ""],
            ["--filter-size", "1..=32"],
        );
        density_is(
            "--lod-skip",
            &["-1", "5", "1e0", "x"],
            ["--lod-skip", "0..=4"],
        );
        density_is("--gain", &["-1", "nan"], ["gain", "0.001..=1000"]);
        density_is("--exponent", &["-1", "-inf"], ["exponent", "0.05..=20"]);
        density_is("--spacing-m", &["-1", "-0"], ["spacing", "0.0001"]);
        density_is(
            "--headroom-m",
            &["-1", "-inf"],
            ["headroom", "0 and a million"],
        );
    }
    check(
        &generate,
        "--octaves",
        &["-1", "0", "33", "2.0", "many"],
        ["--octaves", "1..=32"],
    );
    check(
        &generate,
        "--seed",
        &["-1", "1.5", "18446744073709551616"],
        ["--seed", "0..=18446744073709551615"],
    );
    check(
        &generate,
        "--relief-m",
        &["-5", "nan"],
        ["relief", "0 and 1000000 m"],
    );
    check(
        &generate,
        "--roughness",
        &["-1", "5"],
        ["roughness", "0 and 4"],
    );
    check(
        &generate,
        "--wavelength-m",
        &["-1", "nan", "1e10"],
        ["wavelength", "1000000000 m"],
    );
    check(
        &generate,
        "--size",
        &["-4x4", "-4"],
        ["--size", "WIDTHxHEIGHT"],
    );
    assert_eq!(entries(folder.path()), ["a.r16"]);

    run(&[&generate[..], &["--size", "5x5"]].concat());
    let preview = ["preview", &out, "--out", &picture];
    check(
        &preview,
        "--max-size",
        &["-4", "15", "8193", "99.5", "big"],
        ["--max-size", "16..=8192"],
    );
    check(
        &preview,
        "--level",
        &["-1", "300", "0.5", "x"],
        ["--level", "0..="],
    );
    check(
        &preview,
        "--exaggeration",
        &["-1"],
        ["exaggeration", "0.001..=1000"],
    );
    check(&preview, "--sun-azimuth", &["-1"], ["azimuth", "0..=360"]);
    check(&preview, "--sun-altitude", &["-1"], ["altitude", "1..=90"]);
    let density = ["density", &out];
    check(
        &density,
        "--filter-size",
        &["-1"],
        ["--filter-size", "1..=32"],
    );
    check(&density, "--lod-skip", &["-1"], ["--lod-skip", "0..=4"]);
    assert_eq!(entries(folder.path()), ["a.r16", "terrain"]);
}

#[test]
fn a_relief_that_nobody_gave_is_never_out_of_proportion() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = path(folder.path(), "terrain");
    for kind in ["fbm", "ridged", "hybrid", "diamond-square"] {
        for (size, spacing) in [
            ("65x65", "1000000"),
            ("257x257", "1000"),
            ("16385x2", "100000"),
            ("9x9", "0.0001"),
        ] {
            let arguments = ["generate", kind, "--out", &out, "--size", size, "--force"];
            run(&[&arguments[..], &["--spacing-m", spacing]].concat());
            let file = manifest(Path::new(&out)).file;
            // With the headroom, and what the range is widened by for lack of height.
            let most = 8000.0 + 2.0 * 64.0 + 2.0;
            let all = file.height_m(u16::MAX) - file.height_m(0);
            assert!(all <= most, "{kind} {size} {spacing}: {all}");
        }
    }
    run(&[
        "generate",
        "fbm",
        "--out",
        &out,
        "--size",
        "65x65",
        "--spacing-m",
        "1000",
        "--relief-m",
        "90000",
        "--force",
    ]);
    let file = manifest(Path::new(&out)).file;
    assert!(file.height_m(u16::MAX) > 10_000.0, "what is given is taken");
    let help = run(&["generate", "--help"]);
    assert!(help.contains("at most 8000, unless given"), "{help}");
}

#[test]
fn small_numbers_are_printed_as_more_than_zero() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (out, picture) = (
        path(folder.path(), "terrain"),
        path(folder.path(), "picture.png"),
    );
    let raw = path(folder.path(), "a.r16");
    let ramp: Vec<u8> = (0..64 * 64_u16)
        .flat_map(|at| (at * 16).to_le_bytes())
        .collect();
    fs::write(&raw, ramp).expect("written");
    let bake = |range| {
        let arguments = ["bake", &raw, "--size", "64x64", "--out", &out, "--force"];
        run(&[&arguments[..], &["--height-range-m", range]].concat())
    };
    for range in ["0..0.00001", "-0.00001..0"] {
        let printed = bake(range);
        assert!(
            printed.contains(&format!("{range} m in steps of 1.53e-10 m")),
            "{printed}"
        );
        let printed = run(&["inspect", &out]);
        assert!(
            !printed.contains("-0.") || range.starts_with('-'),
            "{printed}"
        );
        assert!(
            !printed.contains("-0..") && !printed.contains("..-0 m"),
            "{printed}"
        );
        assert!(printed.contains("in steps of 1.53e-10 m"), "{printed}");
    }
    bake("-0.04..3000");
    let printed = run(&["inspect", &out]);
    assert!(printed.contains("  0.0..2"), "{printed}");
    let printed = run(&["preview", &out, "-o", &picture, "--exaggeration", "0.001"]);
    assert!(printed.contains("slopes 0.001 times as steep"), "{printed}");
}

#[test]
fn density_keeps_what_it_is_not_told_and_leaves_heights_alone() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (out, wanted) = (
        path(folder.path(), "terrain"),
        path(folder.path(), "wanted"),
    );
    let make = [
        "generate", "ridged", "--size", "300x200", "--seed", "3", "--out",
    ];
    let plain = [&make[..], &[&out, "--gain", "0.7", "--filter-size", "2"]].concat();
    run(&plain);
    let printed = run(&["density", &out, "--filter", "principal"]);
    assert!(
        printed.contains("principal curvature, gain 0.7, exponent 1, spread over 3 x 3 texels"),
        "{printed}"
    );
    assert!(printed.contains("mean density of 0."), "{printed}");
    let same = [
        &make[..],
        &[
            &wanted,
            "--gain",
            "0.7",
            "--filter-size",
            "2",
            "--filter",
            "principal",
        ],
    ]
    .concat();
    run(&same);
    assert_eq!(manifest(Path::new(&out)), manifest(Path::new(&wanted)));
    assert!(tiles(&out) == tiles(&wanted));
    assert_good(&out);

    let before = tiles(&out);
    run(&["density", &out, "--no-preprocess"]);
    assert!(tiles(&out) != before);
    run(&["density", &out, "--preprocess"]);
    assert!(tiles(&out) == before);
    assert_eq!(entries(folder.path()), ["terrain", "wanted"]);
}

#[test]
fn density_refuses_what_it_cannot_do_and_changes_nothing() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = path(folder.path(), "terrain");
    run(&["generate", "fbm", "--size", "300x200", "--out", &out]);
    let before = tiles(&out);
    assert!(refused(&["density", &path(folder.path(), "nothing")]).contains("nothing"));
    assert!(refused(&["density", &out, "--gain", "1e9"]).contains("0.001..=1000"));
    let wide = [
        "--border",
        "point-sampled",
        "--filter-size",
        "32",
        "--lod-skip",
        "4",
    ];
    let wide = refused(&[&["density", &out], &wide[..]].concat());
    assert!(wide.contains("at most 64"), "{wide}");
    assert!(tiles(&out) == before);
    fs::remove_file(Path::new(&out).join("tile/0/1_0.tile")).expect("it was there");
    let message = refused(&["density", &out]);
    assert!(message.contains("1_0.tile"), "{message}");
    assert_eq!(entries(folder.path()), ["terrain"]);
}

/// The new terrain replaces the old one at the very end.
#[cfg(unix)]
#[test]
fn a_killed_rebake_leaves_the_old_terrain() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = path(folder.path(), "terrain");
    run(&[
        "generate",
        "diamond-square",
        "--size",
        "4097x4097",
        "--out",
        &out,
    ]);
    let before = manifest(Path::new(&out));
    let mut child = Command::new(env!("CARGO_BIN_EXE_tessera"))
        .args(["density", &out, "--filter", "laplace-beltrami-voronoi"])
        .stdout(Stdio::null())
        .spawn()
        .expect("tessera runs");
    let start = Instant::now();
    let partial = || entries(folder.path()).len() > 1;
    while !partial() && start.elapsed() < Duration::from_secs(20) {
        std::thread::sleep(Duration::from_millis(1));
    }
    assert!(partial(), "the rebake should have begun");
    child.kill().expect("it can be killed");
    child.wait().expect("it ends");
    assert!(partial(), "the rebake was killed in its middle");
    assert_eq!(manifest(Path::new(&out)), before);
    assert_good(&out);
    // The next one clears away what is left.
    run(&["density", &out, "--gain", "2"]);
    assert_eq!(entries(folder.path()), ["terrain"]);
    assert_eq!(manifest(Path::new(&out)).file.density.gain, 2.0);
    assert_good(&out);
}

#[test]
fn preview_draws_what_it_is_asked_for() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let out = path(folder.path(), "terrain");
    run(&["generate", "hybrid", "--size", "300x200", "--out", &out]);
    let picture = path(folder.path(), "picture.png");
    let printed = run(&["preview", &out, "--out", &picture]);
    assert!(
        printed.contains("900 x 200 pixels, level 0, 1 m a pixel"),
        "{printed}"
    );
    let drawn = image::open(&picture).expect("a good picture");
    assert_eq!((drawn.width(), drawn.height()), (900, 200));
    let printed = run(&[
        "preview",
        &out,
        "-o",
        &picture,
        "--kind",
        "density",
        "--max-size",
        "160",
    ]);
    assert!(
        printed.contains("150 x 100") || printed.contains("151 x 101"),
        "{printed}"
    );

    for (option, says) in [
        ("--max-size=9", "16"),
        ("--level=9", "level"),
        ("--kind=relieff", "blended"),
        ("--sun-altitude=0", "1"),
        ("--exaggeration=-1", "0.001"),
    ] {
        let message = refused(&["preview", &out, "--out", &picture, option]);
        assert!(message.contains(says), "{option}: {message}");
    }
    let nowhere = path(folder.path(), "nowhere/picture.png");
    assert!(refused(&["preview", &out, "--out", &nowhere]).contains("nowhere; make it"));
    assert!(refused(&["preview", &nowhere, "--out", &picture]).contains("nowhere"));

    // Neither the picture of something else nor a name that promises another format.
    let source = path(folder.path(), "source.png");
    image::GrayImage::new(4, 4).save(&source).expect("written");
    let before = fs::read(&source).expect("readable");
    let message = refused(&["preview", &out, "-o", &source]);
    assert!(message.contains("exists and is no preview"), "{message}");
    assert!(fs::read(&source).expect("readable") == before);
    let message = refused(&["preview", &out, "-o", &path(folder.path(), "x.jpg")]);
    assert!(message.contains("ends in .png"), "{message}");
    assert_eq!(message.lines().count(), 1, "{message}");
    assert_eq!(
        entries(folder.path()),
        ["picture.png", "source.png", "terrain"]
    );
}

#[test]
fn what_is_no_terrains_folder_is_called_what_it_is() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let place = |name: &str| path(folder.path(), name);
    let (source, part, file) = (place("a.r16"), place("part"), place("b.pmtiles"));
    let (empty, none, picture) = (place("empty"), place("none"), place("c.png"));
    std::fs::write(&source, vec![7; 150 * 130 * 2]).expect("writable");
    let bake = ["bake", &source, "--size", "150x130", "--out"];
    run(&[&bake[..], &[&part, "--shard", "1/2"]].concat());
    run(&[&bake[..], &[&file, "--archive"]].concat());
    std::fs::create_dir(&empty).expect("a folder");
    let commands: [&[&str]; 4] = [
        &["density"],
        &["preview", "--out", &picture],
        &["mesh", "--out", &picture, "--eye", "1,1,1"],
        &["pack", "--out", &picture],
    ];
    for (dir, cause) in [
        (&part, "it is a part of one; join all parts"),
        (
            &file,
            "it is a file; if it is an archive, make a folder of it with `tessera unpack`",
        ),
        (&empty, "there is no terrain.ron in it; give"),
        (&none, "there is nothing there; give"),
    ] {
        let wanted = format!("{dir} is no terrain that can be used: {cause}");
        for command in commands {
            let message = refused(&[command, &[dir]].concat());
            assert!(message.contains(&wanted), "{command:?}: {message}");
        }
        // These two look at archives too.
        for command in ["verify", "inspect"] {
            let shown = command == "inspect" && dir == &part || dir == &file;
            if !shown {
                let message = refused(&[command, dir]);
                assert!(message.contains(&wanted), "{command}: {message}");
            }
        }
    }
    let message = refused(&["unpack", &part, "--out", &none]);
    assert!(message.contains("is a folder, not an archive"), "{message}");
}
