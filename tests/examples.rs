//! The examples do what their text says, run as a stranger would run them.

use image::RgbImage;
use std::path::{Path, PathBuf};
use std::process::Command;

/// An example's binary: Cargo builds them beside the tests'.
fn example(name: &str) -> PathBuf {
    let mut path = std::env::current_exe().unwrap();
    path.pop();
    path.pop();
    path.join("examples").join(name)
}

/// A picture that an example saved.
fn picture(name: &str, file: &str, arguments: &[&str]) -> RgbImage {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(file);
    let _ = std::fs::remove_file(&path);
    let output = Command::new(example(name))
        .args([
            "--headless",
            "--size",
            "480x270",
            "--frames",
            "2",
            "--screenshot",
        ])
        .arg(&path)
        .args(arguments)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr).into_owned()
        + &String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{}: {said}", output.status);
    assert!(!said.contains("ERROR"), "{said}");
    image::open(&path).unwrap().to_rgb8()
}

/// The plain sky of a software renderer, and what the atmosphere's looks like: more blue than red.
fn is_sky(pixel: image::Rgb<u8>) -> bool {
    let [r, g, b] = pixel.0.map(i32::from);
    b > r + 20 && b > 120 && g >= r
}

/// Share of pixels of some rows that are sky.
fn sky_share(image: &RgbImage, rows: std::ops::Range<u32>) -> f32 {
    let count = rows.len() as u32 * image.width();
    let sky = rows
        .flat_map(|y| (0..image.width()).map(move |x| (x, y)))
        .filter(|&(x, y)| is_sky(*image.get_pixel(x, y)))
        .count();
    sky as f32 / count as f32
}

/// Mean and standard deviation of the brightness of some rows.
fn brightness(image: &RgbImage, rows: std::ops::Range<u32>) -> (f32, f32) {
    let values: Vec<f32> = rows
        .flat_map(|y| (0..image.width()).map(move |x| (x, y)))
        .map(|(x, y)| {
            let [r, g, b] = image.get_pixel(x, y).0.map(f32::from);
            (r + g + b) / 3.0
        })
        .collect();
    let mean = values.iter().sum::<f32>() / values.len() as f32;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f32>() / values.len() as f32;
    (mean, variance.sqrt())
}

#[test]
fn open_world_shows_mountains_under_a_sky_from_three_cameras() {
    let cameras: [(&str, &[&str]); 3] = [
        ("open_world_default.png", &[]),
        (
            "open_world_ridge.png",
            &["--eye", "16000,1300,21000", "--look", "13000,600,14000"],
        ),
        (
            "open_world_valley.png",
            &["--eye", "21000,700,12000", "--look", "12000,500,17000"],
        ),
    ];
    for (file, arguments) in cameras {
        let image = picture("open_world", file, arguments);
        let height = image.height();
        let top = sky_share(&image, 0..height / 8);
        let bottom = sky_share(&image, height * 3 / 4..height);
        assert!(top > 0.9, "{file}: {top} of the top is sky");
        assert!(bottom < 0.05, "{file}: {bottom} of the bottom is sky");
        let (mean, deviation) = brightness(&image, height / 2..height);
        assert!(
            (15.0..220.0).contains(&mean),
            "{file}: the ground's brightness is {mean}"
        );
        assert!(
            deviation > 8.0,
            "{file}: the ground is flat, deviation {deviation}"
        );
        // Ground under the sun is greener or redder than it is blue.
        let lit = (0..image.width())
            .filter(|&x| {
                let [r, g, b] = image.get_pixel(x, height * 7 / 8).0;
                r.max(g) > b
            })
            .count();
        assert!(
            lit * 4 > image.width() as usize,
            "{file}: {lit} columns look like ground"
        );
    }
}

/// Share of the ground's pixels that are nearly black.
fn dark_share(image: &RgbImage) -> f32 {
    let from = image.height() / 2;
    let ground = (from..image.height()).flat_map(|y| (0..image.width()).map(move |x| (x, y)));
    let dark = ground.filter(|&(x, y)| image.get_pixel(x, y).0.iter().all(|&part| part < 75));
    dark.count() as f32 / ((image.height() - from) * image.width()) as f32
}

#[test]
fn destruction_leaves_scorched_craters() {
    // Two frames after the terrain has come the bombs are in the air; later they have landed.
    let before = dark_share(&picture("destruction", "destruction_before.png", &[]));
    let after = dark_share(&picture(
        "destruction",
        "destruction_after.png",
        &["--frames", "24"],
    ));
    assert!(
        after > before + 0.01,
        "{before} of the ground is dark before, {after} afterwards"
    );
}

#[test]
fn minimal_shows_a_terrain() {
    let image = picture("minimal", "minimal.png", &[]);
    let (_, above) = brightness(&image, 0..image.height() / 8);
    let (_, below) = brightness(&image, image.height() / 2..image.height());
    assert!(
        above < 1.0,
        "the sky of minimal is one colour, deviation {above}"
    );
    assert!(
        below > 5.0,
        "the ground of minimal has none, deviation {below}"
    );
}

#[test]
fn minimal_takes_fifteen_lines() {
    let text = include_str!("../examples/minimal.rs");
    let functions = text.split_once("fn main").unwrap().1;
    let lines = functions
        .lines()
        .filter(|line| !line.trim().is_empty())
        .count();
    assert!(lines <= 15, "main and setup take {lines} lines");
}

#[test]
fn bad_arguments_are_refused_in_a_sentence() {
    for (arguments, expected) in [
        (&["--eye", "1,2"][..], "--eye is 1,2: write X,Y,Z"),
        (
            &["--eye", "1,2,nan"][..],
            "--eye is 1,2,nan: write finite numbers",
        ),
        (
            &["--size", "0x9"][..],
            "--size is 0x9: use 1 to 8192 a side",
        ),
        (&["--frames"][..], "--frames needs a value after it"),
        (&["--fast"][..], "--fast is no option"),
        (&["--terrain", "/nowhere"][..], "holds no terrain.ron"),
    ] {
        let output = Command::new(example("open_world"))
            .args(arguments)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(
            said.lines().any(|line| line.contains(expected)),
            "{arguments:?}: {said}"
        );
    }
}

#[test]
fn without_a_display_an_example_says_so_and_goes_on_headless() {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join("no_display.png");
    let output = Command::new(example("minimal"))
        .args(["--size", "64x48", "--frames", "1", "--screenshot"])
        .arg(&path)
        .env_remove("DISPLAY")
        .env_remove("WAYLAND_DISPLAY")
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(
        said.contains("no window can be opened: running headless"),
        "{said}"
    );
}

#[test]
fn a_picture_that_cannot_be_saved_is_an_error() {
    let output = Command::new(example("minimal"))
        .args(["--headless", "--size", "64x48", "--frames", "1"])
        .args(["--screenshot", "/nowhere/at/all.png"])
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success());
    assert!(
        said.contains("/nowhere/at/all.png can't be saved"),
        "{said}"
    );
}
