//! `tessera generate`, `density` and `preview` as a user runs them.

mod bake_support;

use bake_support::{entries, manifest};
use bevy_tessera::bake::verify;
use bevy_tessera::density::{DensityBorder, DensityFilter, DensitySettings};
use bevy_tessera::tile::{DensityTile, HeightTile};
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
    let of = |address| [HeightTile::path(address), DensityTile::path(address)];
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
        ("--octaves", "0", "1 and 32"),
        ("--spacing-m", "0", "0.0001"),
        ("--relief-m", "-1", "0 and 1000000"),
        ("--wavelength-m", "0.5", "wavelength"),
        ("--size", "1x1", "2 to 16777216"),
        ("--size", "9", "WIDTHxHEIGHT"),
        ("--seed", "-1", "--seed"),
        ("--gain", "0", "0.001..=1000"),
        ("--filter", "sobel", "laplace-beltrami"),
    ] {
        let option = format!("{option}={value}");
        let message = refused(&["generate", "fbm", "--out", &out, &option]);
        assert!(message.contains(says), "{option}: {message}");
        assert!(entries(folder.path()).is_empty(), "{option}");
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
        printed.contains("principal curvature, gain 0.7, exponent 1, spread over 2 x 2"),
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
    let wide = refused(&["density", &out, "--filter-size", "32", "--lod-skip", "4"]);
    assert!(wide.contains("at most 64"), "{wide}");
    assert!(tiles(&out) == before);
    fs::remove_file(Path::new(&out).join("height/0/1_0.height")).expect("it was there");
    let message = refused(&["density", &out]);
    assert!(message.contains("1_0.height"), "{message}");
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
    assert!(refused(&["preview", &out, "--out", &nowhere]).contains("nowhere"));
    assert!(refused(&["preview", &nowhere, "--out", &picture]).contains("nowhere"));
}
