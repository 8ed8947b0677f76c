//! Whatever a bake is fed, it bakes it or refuses it in one sentence that names the file, fails,
//! and leaves nothing behind.

mod bake_support;

use bake_support::{data, entries, files, read_all};
use bevy_tessera::bake::import::{self, ImportSettings};
use proptest::prelude::*;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::time::{Duration, Instant};

struct Folder {
    dir: tempfile::TempDir,
}

impl Folder {
    fn new() -> Self {
        let dir = tempfile::tempdir().expect("a temporary folder");
        fs::create_dir(dir.path().join("out")).expect("a folder can be made");
        Self { dir }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn write(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path(name);
        fs::write(&path, bytes).expect("a file can be written");
        path
    }

    fn bake(&self, input: &Path, arguments: &[&str]) -> Output {
        Command::new(env!("CARGO_BIN_EXE_tessera"))
            .arg("bake")
            .arg(input)
            .arg("--out")
            .arg(self.path("out/terrain"))
            .args(arguments)
            .output()
            .expect("tessera runs")
    }

    /// Bakes what must be refused, and returns the sentence.
    fn refused(&self, input: &Path, arguments: &[&str]) -> String {
        let start = Instant::now();
        let output = self.bake(input, arguments);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_one_sentence(&message, input);
        assert_eq!(output.status.code(), Some(1), "{message}");
        assert!(output.stdout.is_empty(), "{message}");
        assert!(
            start.elapsed() < Duration::from_secs(10),
            "took too long: {message}"
        );
        let left = entries(&self.path("out"));
        assert!(left.is_empty(), "{left:?} was left: {message}");
        message
    }
}

fn assert_one_sentence(message: &str, input: &Path) {
    assert!(message.starts_with("tessera: "), "{message}");
    assert_eq!(message.trim_end().lines().count(), 1, "{message}");
    assert!(
        message.contains(&input.display().to_string()),
        "{message} doesn't name the file"
    );
    for noise in ["panicked", "internal error", "backtrace", "gave up"] {
        assert!(!message.contains(noise), "{message}");
    }
}

fn crc_chunk(kind: &[u8; 4], data: &[u8]) -> Vec<u8> {
    let mut body = kind.to_vec();
    body.extend_from_slice(data);
    let mut chunk = (data.len() as u32).to_be_bytes().to_vec();
    chunk.extend_from_slice(&body);
    chunk.extend_from_slice(&crc32fast::hash(&body).to_be_bytes());
    chunk
}

/// A PNG file whose header promises `size`, with hardly any pixels behind it.
fn promising_png(size: [u32; 2], interlaced: bool) -> Vec<u8> {
    let mut bytes = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut header = Vec::new();
    header.extend_from_slice(&size[0].to_be_bytes());
    header.extend_from_slice(&size[1].to_be_bytes());
    header.extend_from_slice(&[16, 0, 0, 0, u8::from(interlaced)]);
    bytes.extend(crc_chunk(b"IHDR", &header));
    bytes.extend(crc_chunk(b"IDAT", &[0x78, 0x9c, 0x03, 0, 0, 0, 0, 1]));
    bytes.extend(crc_chunk(b"IEND", &[]));
    bytes
}

/// A TIFF file of `f32` whose header promises `size` in one strip.
fn promising_tiff(size: [u32; 2]) -> Vec<u8> {
    let mut bytes = b"II*\0\x08\0\0\0".to_vec();
    let entries: [(u16, u32); 9] = [
        (256, size[0]),
        (257, size[1]),
        (258, 32),
        (259, 1),
        (262, 1),
        (273, 200),
        (277, 1),
        (278, size[1]),
        (339, 3),
    ];
    bytes.extend_from_slice(&(entries.len() as u16 + 1).to_le_bytes());
    for (tag, value) in entries {
        bytes.extend_from_slice(&tag.to_le_bytes());
        let short = value < 65536 && !matches!(tag, 256 | 257 | 273 | 278);
        bytes.extend_from_slice(&(if short { 3_u16 } else { 4 }).to_le_bytes());
        bytes.extend_from_slice(&1_u32.to_le_bytes());
        bytes.extend_from_slice(&value.to_le_bytes());
    }
    bytes.extend_from_slice(&279_u16.to_le_bytes());
    bytes.extend_from_slice(&[4, 0, 1, 0, 0, 0]);
    bytes.extend_from_slice(&u32::MAX.to_le_bytes());
    bytes.extend_from_slice(&[0; 4]);
    bytes.resize(400, 0);
    bytes
}

fn grey_png(path: &Path, size: [u32; 2]) {
    let mut encoder = png::Encoder::new(File::create(path).expect("writable"), size[0], size[1]);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Sixteen);
    let data: Vec<u8> = (0..size[0] * size[1] * 2)
        .map(|at| (at * 37 % 251) as u8)
        .collect();
    let mut writer = encoder.write_header().expect("a header");
    writer.write_image_data(&data).expect("pixels");
}

fn grey_tiff(path: &Path, size: [u32; 2]) {
    use tiff::encoder::{TiffEncoder, colortype::Gray32Float};
    let data: Vec<f32> = (0..size[0] * size[1]).map(|at| (at % 97) as f32).collect();
    let mut encoder = TiffEncoder::new(File::create(path).expect("writable")).expect("a header");
    encoder
        .write_image::<Gray32Float>(size[0], size[1], &data)
        .expect("pixels");
}

fn grey_exr(path: &Path, size: [usize; 2], value: impl Fn(usize, usize) -> [f32; 3] + Sync) {
    exr::prelude::write_rgb_file(path, size[0], size[1], |x, y| {
        let [r, g, b] = value(x, y);
        (r, g, b)
    })
    .expect("pixels");
}

fn r32(values: &[f32]) -> Vec<u8> {
    values
        .iter()
        .flat_map(|value| value.to_le_bytes())
        .collect()
}

/// Replaces the size in an OpenEXR header.
fn promising_exr(folder: &Folder) -> Vec<u8> {
    let path = folder.path("small.exr");
    grey_exr(&path, [16, 16], |_, _| [1.0; 3]);
    let mut bytes = fs::read(&path).expect("readable");
    for window in [&b"dataWindow\0box2i\0"[..], b"displayWindow\0box2i\0"] {
        let at = bytes
            .windows(window.len())
            .position(|found| found == window)
            .expect("the header has it");
        let first = at + window.len() + 4;
        for (offset, value) in [(0, 0_i32), (4, 0), (8, i32::MAX - 1), (12, i32::MAX - 1)] {
            bytes[first + offset..first + offset + 4].copy_from_slice(&value.to_le_bytes());
        }
    }
    bytes
}

#[test]
fn a_header_that_promises_two_billion_pixels_a_side_is_refused_at_once() {
    let folder = Folder::new();
    let huge = 0x7fff_ffff;
    for (name, bytes) in [
        ("a.png", promising_png([huge, huge], false)),
        ("b.png", promising_png([huge, 2], false)),
        ("c.tif", promising_tiff([huge, huge])),
        ("d.tif", promising_tiff([2, u32::MAX])),
        ("e.exr", promising_exr(&folder)),
    ] {
        let message = folder.refused(&folder.write(name, &bytes), &[]);
        assert!(
            message.contains("out of bounds") || message.contains("damaged"),
            "{message}"
        );
    }
    let raw = folder.write("f.r16", &[0; 64]);
    for size in [
        "2147483648x2147483648",
        "4294967295x1",
        "16777217x2",
        "1x1",
        "0x5",
    ] {
        let message = folder.refused(&raw, &["--size", size]);
        assert!(message.contains("out of bounds"), "{message}");
    }
}

/// Sizes that are in bounds, and nothing behind them.
#[test]
fn a_header_that_promises_more_than_the_file_holds_is_refused() {
    let folder = Folder::new();
    let big = [131_072, 131_072];
    for (name, bytes) in [
        ("a.png", promising_png(big, false)),
        ("b.png", promising_png(big, true)),
        ("c.tif", promising_tiff(big)),
        ("d.tif", promising_tiff([3000, 3000])),
        ("e.png", promising_png([3000, 3000], true)),
    ] {
        folder.refused(&folder.write(name, &bytes), &[]);
    }
}

#[test]
fn truncated_corrupt_and_empty_files_are_refused() {
    let folder = Folder::new();
    let png = folder.path("a.png");
    grey_png(&png, [90, 70]);
    let tiff = folder.path("a.tif");
    grey_tiff(&tiff, [90, 70]);
    let exr = folder.path("a.exr");
    grey_exr(&exr, [90, 70], |x, y| [(x * y) as f32; 3]);
    for path in [&png, &tiff, &exr] {
        let name = path.file_name().expect("a name").to_string_lossy();
        let bytes = fs::read(path).expect("readable");
        for keep in [1, 4, 9, 30, bytes.len() / 2, bytes.len() - 20] {
            let cut = folder.write(&format!("cut{keep}-{name}"), &bytes[..keep]);
            folder.refused(&cut, &[]);
        }
        let empty = folder.write(&format!("empty-{name}"), &[]);
        assert!(folder.refused(&empty, &[]).contains("is empty"));
        let noise: Vec<u8> = (0..5000_u32).map(|at| ((at * at) >> 3) as u8).collect();
        folder.refused(&folder.write(&format!("noise-{name}"), &noise), &[]);
    }
    let mut bytes = fs::read(&png).expect("readable");
    let middle = bytes.len() / 2;
    bytes[middle] ^= 0x55;
    assert!(
        folder
            .refused(&folder.write("flipped.png", &bytes), &[])
            .contains("damaged")
    );
    folder.refused(&folder.write("notes.txt", b"not a height map"), &[]);
    folder.refused(&folder.write("N10E010.hgt", &[0; 1000]), &[]);
    folder.refused(&folder.write("empty.hgt", &[]), &[]);
    folder.refused(&folder.path("missing.png"), &[]);
    folder.refused(&folder.path("out"), &[]);
}

#[test]
fn colour_where_grey_is_needed_is_refused() {
    let folder = Folder::new();
    let path = folder.path("colour.png");
    let mut encoder = png::Encoder::new(File::create(&path).expect("writable"), 4, 4);
    encoder.set_color(png::ColorType::Rgb);
    let mut writer = encoder.write_header().expect("a header");
    writer.write_image_data(&[9; 48]).expect("pixels");
    drop(writer);
    let message = folder.refused(&path, &[]);
    assert!(
        message.contains("colour") && message.contains("--packing"),
        "{message}"
    );
    let message = folder.refused(&path, &["--packing", "rgb24"]);
    assert!(message.contains("--height-range-m"), "{message}");

    let path = folder.path("colour.exr");
    grey_exr(&path, [20, 20], |x, y| [x as f32, y as f32, 0.0]);
    assert!(folder.refused(&path, &[]).contains("colour"));

    use tiff::encoder::{TiffEncoder, colortype::RGB8};
    let path = folder.path("colour.tif");
    let mut encoder = TiffEncoder::new(File::create(&path).expect("writable")).expect("a header");
    encoder.write_image::<RGB8>(4, 4, &[9; 48]).expect("pixels");
    assert!(folder.refused(&path, &[]).contains("colour"));

    let path = folder.path("grey.png");
    grey_png(&path, [4, 4]);
    let message = folder.refused(&path, &["--packing", "terrarium"]);
    assert!(message.contains("--packing"), "{message}");
}

#[test]
fn infinities_are_refused_and_missing_data_is_filled() {
    let folder = Folder::new();
    let size = ["--size", "30x20"];
    let mut values = vec![5.0_f32; 600];
    values[30 * 7 + 3] = f32::INFINITY;
    let path = folder.write("infinite.r32", &r32(&values));
    for more in [&[][..], &["--height-range-m", "0..10"]] {
        let message = folder.refused(&path, &[&size, more].concat());
        assert!(message.contains("column 3, row 7"), "{message}");
    }
    values[30 * 7 + 3] = f32::NEG_INFINITY;
    folder.refused(&folder.write("infinite.r32", &r32(&values)), &size);

    values[30 * 7 + 3] = -3.0e38;
    let path = folder.write("undeclared.r32", &r32(&values));
    let message = folder.refused(&path, &size);
    assert!(message.contains("--no-data"), "{message}");

    let all = folder.write("nothing.r32", &r32(&[f32::NAN; 600]));
    for more in [&[][..], &["--height-range-m", "0..10"]] {
        let message = folder.refused(&all, &[&size, more].concat());
        assert!(message.contains("no sample has data"), "{message}");
    }

    let output = folder.bake(&path, &["--size", "30x20", "--no-data", "-3e38"]);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let report = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(report.contains("1 samples had no data"), "{report}");
}

#[test]
fn a_raw_file_whose_length_is_wrong_is_refused() {
    let folder = Folder::new();
    let path = folder.write("a.r16", &[0; 2 * 64 * 64]);
    let message = folder.refused(&path, &[]);
    assert!(
        message.contains("--size") && message.contains("64x64"),
        "{message}"
    );
    for size in ["64x63", "65x64", "128x64"] {
        let message = folder.refused(&path, &["--size", size]);
        assert!(message.contains("8192 bytes"), "{message}");
    }
    assert!(folder.bake(&path, &["--size", "32x128"]).status.success());
}

#[test]
fn settings_that_make_no_terrain_are_refused() {
    let folder = Folder::new();
    let path = folder.write("a.r16", &[7; 2 * 64 * 64]);
    let refused = |arguments: &[&str]| {
        let all = [&["--size", "64x64"], arguments].concat();
        let output = folder.bake(&path, &all);
        let message = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(!output.status.success(), "{arguments:?}");
        assert!(entries(&folder.path("out")).is_empty(), "{arguments:?}");
        assert!(!message.contains("panicked"), "{message}");
        message
    };
    for range in ["5..5", "9..3", "nan..4", "0..inf", "-1e9..0"] {
        assert!(
            refused(&["--height-range-m", range]).contains("height range"),
            "{range}"
        );
    }
    for range in ["x..4", "4", "..", "1..2..3"] {
        assert!(
            refused(&["--height-range-m", range]).contains("LO..HI"),
            "{range}"
        );
    }
    for spacing in ["0", "nan", "inf", "1e9"] {
        assert!(
            refused(&["--spacing-m", spacing]).contains("spacing"),
            "{spacing}"
        );
    }
    refused(&["--headroom-m", "nan"]);
    for (option, bad, range) in [
        ("--gain", ["0", "-1", "inf", "nan", "1001"], "0.001..=1000"),
        ("--exponent", ["0", "-2", "inf", "nan", "21"], "0.05..=20"),
        ("--filter-size", ["0", "33", "-1", "x", "1.5"], "1..=32"),
        ("--lod-skip", ["5", "99", "-1", "x", "0.5"], "0..=4"),
        (
            "--filter",
            ["", "Mean", "sobel", "mean ", "7"],
            "laplace-beltrami-voronoi",
        ),
        ("--border", ["", "both", "None", "x", "7"], "point-sampled"),
    ] {
        for value in bad {
            let message = refused(&[&format!("{option}={value}")]);
            let parses = value.parse::<f64>().is_ok() && !message.contains("invalid value");
            let named = message.contains(range) || (!parses && message.contains(option));
            assert!(named, "{option}={value}: {message}");
        }
    }
    let border = ["--border", "point-sampled"];
    let wide = refused(&[&border[..], &["--filter-size", "32", "--lod-skip", "2"]].concat());
    assert!(wide.contains("at most 64"), "{wide}");
    refused(&["--height-scale", "0"]);
    refused(&["--height-offset", "nan"]);
    refused(&["--packing", "terrarium"]);
    let png = folder.path("a.png");
    grey_png(&png, [8, 8]);
    assert!(folder.refused(&png, &["--size", "8x8"]).contains("--size"));
    assert!(
        folder
            .refused(&png, &["--big-endian"])
            .contains("--big-endian")
    );
}

#[test]
fn negative_height_ranges_are_understood() {
    let folder = Folder::new();
    let path = folder.write("a.r16", &[7; 2 * 64 * 64]);
    let arguments = ["--size", "64x64", "--height-range-m", "-100..6453.5"];
    let output = folder.bake(&path, &arguments);
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let report = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(
        report.contains("heights: -100..6453.5 m in steps of 0.1 m"),
        "{report}"
    );
}

#[test]
fn folders_that_are_no_terrain_are_refused_by_inspect_and_verify() {
    let folder = Folder::new();
    folder.write("out/terrain.ron", b"(format: \"something else\")");
    for command in ["inspect", "verify"] {
        for dir in [folder.path("out"), folder.path("missing")] {
            let output = Command::new(env!("CARGO_BIN_EXE_tessera"))
                .arg(command)
                .arg(&dir)
                .output()
                .expect("tessera runs");
            let message = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_one_sentence(&message, &dir);
            assert_eq!(output.status.code(), Some(1));
        }
    }
}

#[test]
fn odd_files_are_read_or_refused_in_a_sentence() {
    let Some(data) = data() else { return };
    let folder = Folder::new();
    let (mut read, mut refused) = (0, 0);
    for kind in ["pngsuite", "png_bugfixes", "tiff_valid_odd"] {
        for path in files(&data.join("odd").join(kind)) {
            let name = path
                .file_name()
                .expect("a name")
                .to_string_lossy()
                .into_owned();
            let output = folder.bake(&path, &["--force"]);
            let message = String::from_utf8_lossy(&output.stderr).into_owned();
            if output.status.success() {
                assert_eq!(message, "", "{name}");
                assert!(
                    !(kind == "pngsuite" && name.starts_with('x')),
                    "{name} is corrupt"
                );
                read += 1;
                fs::remove_dir_all(folder.path("out/terrain")).expect("removable");
            } else {
                assert_one_sentence(&message, &path);
                assert_eq!(output.status.code(), Some(1), "{message}");
                refused += 1;
            }
            let left = entries(&folder.path("out"));
            assert!(left.is_empty(), "{name} left {left:?}");
        }
    }
    assert!(
        read >= 50 && refused >= 50,
        "{read} read, {refused} refused"
    );
}

/// Reads a file to its end, or as far as it goes.
fn read_to_the_end(path: &Path) -> Result<(), String> {
    let mut source = import::open(path, &ImportSettings::default()).map_err(|e| e.to_string())?;
    let [width, height] = source.size();
    // What a flipped bit makes huge is refused by whoever runs out of file first.
    if u64::from(width) * u64::from(height) > 1 << 22 {
        return Ok(());
    }
    read_all(&mut *source).map(|_| ())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn files_with_a_few_wrong_bytes_never_make_a_decoder_panic(
        kind in 0_usize..3,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
        cut in prop::option::of(any::<prop::sample::Index>()),
    ) {
        let folder = Folder::new();
        let path = folder.path(["a.png", "a.tif", "a.exr"][kind]);
        match kind {
            0 => grey_png(&path, [40, 30]),
            1 => grey_tiff(&path, [40, 30]),
            _ => grey_exr(&path, [40, 30], |x, y| [(x + y) as f32; 3]),
        }
        let mut bytes = fs::read(&path).expect("readable");
        for (at, byte) in &changes {
            // Half of the changes hit the header, where they do most.
            let reach = if byte % 2 == 0 { bytes.len() } else { bytes.len().min(300) };
            let at = at.index(reach);
            bytes[at] = *byte;
        }
        if let Some(cut) = cut {
            bytes.truncate(cut.index(bytes.len()).max(1));
        }
        fs::write(&path, &bytes).expect("writable");
        if let Err(message) = read_to_the_end(&path) {
            prop_assert!(message.contains(&path.display().to_string()), "{message}");
            prop_assert!(!message.contains("gave up"), "{message}");
        }
    }
}
