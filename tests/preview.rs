//! A preview shows the terrain that is there: its shape, its densities, its place, its damage; and
//! a preview that fails leaves the picture that was there before.
#![cfg(feature = "import")]

use bevy_tessera::bake::{
    BakeSettings, MemorySource, PreviewError, PreviewKind, PreviewReport, PreviewSettings, bake,
    preview,
};
use bevy_tessera::tile::{TileAddress, tile_path};
use image::RgbImage;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

const MAGENTA: [u8; 3] = [255, 0, 255];

/// A terrain of its own, and room for pictures beside it.
struct Stage {
    folder: TempDir,
}

impl Stage {
    fn new(size: [u32; 2], height: impl Fn(f32, f32) -> f32) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let heights = (0..size[1])
            .flat_map(|z| (0..size[0]).map(move |x| (x as f32, z as f32)))
            .map(|(x, z)| height(x, z))
            .collect();
        let mut source = MemorySource::new(size, heights).expect("as many heights as said");
        let stage = Self { folder };
        let settings = BakeSettings::default();
        bake(&mut source, &stage.terrain(), &settings, &()).expect("the bake succeeds");
        stage
    }

    fn terrain(&self) -> PathBuf {
        self.folder.path().join("terrain")
    }

    fn out(&self) -> PathBuf {
        self.folder.path().join("picture.png")
    }

    fn draw(&self, settings: &PreviewSettings) -> (RgbImage, PreviewReport) {
        let report = preview(&self.terrain(), &self.out(), settings).expect("it is drawn");
        let picture = image::open(self.out()).expect("a PNG").to_rgb8();
        assert_eq!([picture.width(), picture.height()], report.size_px);
        (picture, report)
    }

    fn kind(&self, kind: PreviewKind) -> RgbImage {
        self.draw(&of(kind)).0
    }

    /// What lies beside the terrain.
    fn beside(&self) -> Vec<String> {
        let mut names: Vec<String> = std::fs::read_dir(self.folder.path())
            .expect("the folder can be read")
            .map(|entry| entry.expect("readable").file_name())
            .map(|name| name.to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }
}

fn of(kind: PreviewKind) -> PreviewSettings {
    PreviewSettings {
        kind,
        ..PreviewSettings::default()
    }
}

fn hills(x: f32, z: f32) -> f32 {
    (x * 0.11).sin() * 20.0 + (z * 0.07 + x * 0.013).cos() * 30.0
}

#[test]
fn a_picture_has_the_size_of_the_finest_level_that_fits() {
    // Size, longest side, picture, level, metres a pixel.
    for (size, max_size_px, picture, level, pixel_m) in [
        ([2, 2], 1024, [2, 2], 0, 1.0),
        ([5, 3], 16, [5, 3], 0, 1.0),
        ([3, 5], 16, [3, 5], 0, 1.0),
        ([257, 129], 257, [257, 129], 0, 1.0),
        ([257, 129], 256, [129, 65], 1, 2.0),
        ([130, 300], 299, [66, 151], 1, 2.0),
        ([500, 2], 1024, [500, 2], 0, 1.0),
        // The root has 126 x 2 samples, which is 8 times what fits.
        ([500, 2], 16, [16, 1], 2, 32.0),
        ([2, 500], 16, [1, 16], 2, 32.0),
        ([129, 129], 50, [43, 43], 0, 3.0),
    ] {
        let settings = PreviewSettings {
            max_size_px,
            ..of(PreviewKind::Relief)
        };
        let (_, report) = Stage::new(size, hills).draw(&settings);
        let found = (report.size_px, report.level, report.pixel_m);
        assert_eq!(found, (picture, level, pixel_m), "{size:?}, {max_size_px}");
        assert_eq!(report.warnings, [""; 0]);
    }
}

#[test]
fn the_level_that_is_asked_for_is_drawn_and_made_to_fit() {
    let stage = Stage::new([300, 200], hills);
    let settings = |level| PreviewSettings {
        level: Some(level),
        max_size_px: 100,
        ..of(PreviewKind::Blended)
    };
    let (_, report) = stage.draw(&settings(0));
    assert_eq!(
        (report.size_px, report.level, report.pixel_m),
        ([100, 67], 0, 3.0)
    );
    let (_, report) = stage.draw(&settings(2));
    assert_eq!((report.size_px, report.level), ([76, 51], 2));
    let error = preview(&stage.terrain(), &stage.out(), &settings(3)).expect_err("no such level");
    assert!(error.to_string().contains("levels are 0..=2"), "{error}");
}

#[test]
fn flat_ground_is_even_grey_and_green() {
    let stage = Stage::new([300, 140], |_, _| 7.0);
    let relief = stage.kind(PreviewKind::Relief);
    let [r, g, b] = relief.get_pixel(0, 0).0;
    assert!(r == g && g == b && (60..=220).contains(&r), "{r} {g} {b}");
    assert!(relief.pixels().all(|pixel| pixel.0 == [r, g, b]));
    for kind in [PreviewKind::Density, PreviewKind::Blended] {
        let picture = stage.kind(kind);
        let [r, g, b] = picture.get_pixel(0, 0).0;
        assert!(g > 100 && g > 2 * r && g > 2 * b, "{kind}: {r} {g} {b}");
        assert!(picture.pixels().all(|pixel| pixel.0 == [r, g, b]));
    }
}

#[test]
fn a_plane_is_even_up_to_the_rim_and_across_tiles() {
    let settings = PreviewSettings {
        exaggeration: Some(1.0),
        ..of(PreviewKind::Relief)
    };
    // Rises to the east, away from the sun in the west: all as dark, but for the height's tint.
    let stage = Stage::new([300, 140], |x, _| x * 0.5);
    let (picture, report) = stage.draw(&settings);
    assert_eq!(report.exaggeration, 1.0);
    let row: Vec<u8> = (0..300).map(|x| picture.get_pixel(x, 70).0[0]).collect();
    for pair in row.windows(2) {
        assert!(
            (0..=1).contains(&(i16::from(pair[1]) - i16::from(pair[0]))),
            "{row:?}"
        );
    }
}

#[test]
fn a_sharp_crest_is_redder_than_its_surroundings() {
    // A roof whose crest runs from north to south at x = 200, in the second tile.
    let stage = Stage::new([300, 100], |x, _| 50.0 - (x - 200.0).abs() * 0.8);
    for kind in [PreviewKind::Density, PreviewKind::Blended] {
        let picture = stage.kind(kind);
        for z in [0, 50, 99] {
            let red = |x: u32| {
                let [r, g, _] = picture.get_pixel(x, z).0;
                i32::from(r) - i32::from(g)
            };
            assert!(red(200) > 40, "{kind}: {}", red(200));
            for x in (0..190).chain(210..300) {
                assert!(red(x) < -40, "{kind} {x}: {}", red(x));
            }
        }
    }
    // The largest density survives where pixels are many samples.
    let small = PreviewSettings {
        level: Some(0),
        max_size_px: 30,
        ..of(PreviewKind::Density)
    };
    let (picture, _) = stage.draw(&small);
    let redness =
        |x| i32::from(picture.get_pixel(x, 5).0[0]) - i32::from(picture.get_pixel(x, 5).0[1]);
    assert!(redness(20) > 40 && redness(17) < -40 && redness(23) < -40);
}

#[test]
fn the_sun_stands_in_the_north_west_unless_it_is_moved() {
    let stage = Stage::new([129, 129], |x, z| {
        let (x, z) = ((x - 64.0) / 25.0, (z - 64.0) / 25.0);
        20.0 * (-(x * x + z * z)).exp()
    });
    let sides = |settings: &PreviewSettings| {
        let (picture, _) = stage.draw(settings);
        let at = |x, z| i32::from(picture.get_pixel(x, z).0[0]);
        // North-west, north-east, south-east, south-west.
        [at(50, 50), at(78, 50), at(78, 78), at(50, 78)]
    };
    let [nw, ne, se, sw] = sides(&of(PreviewKind::Relief));
    assert!(nw > ne + 20 && nw > sw + 20 && ne > se + 20 && sw > se + 20);
    let east = PreviewSettings {
        sun_azimuth_deg: 90.0,
        ..of(PreviewKind::Relief)
    };
    let [nw, ne, se, sw] = sides(&east);
    assert!(ne > nw + 20 && se > sw + 20 && (ne - se).abs() < 3 && (nw - sw).abs() < 3);
}

#[test]
fn all_is_the_three_others_side_by_side() {
    let stage = Stage::new([200, 140], hills);
    let all = stage.draw(&PreviewSettings::default()).0;
    let kinds = [
        PreviewKind::Relief,
        PreviewKind::Density,
        PreviewKind::Blended,
    ];
    assert_eq!((all.width(), all.height()), (600, 140));
    for (kind, left) in kinds.into_iter().zip([0, 200, 400]) {
        let one = stage.kind(kind);
        assert_eq!((one.width(), one.height()), (200, 140));
        for (x, z, pixel) in one.enumerate_pixels() {
            assert_eq!(pixel, all.get_pixel(left + x, z), "{kind} {x} {z}");
        }
    }
}

#[test]
fn what_cannot_be_read_is_magenta_and_named_and_the_rest_is_unharmed() {
    let stage = Stage::new([300, 300], hills);
    let before = stage.draw(&PreviewSettings::default()).0;
    let tile = TileAddress::new(0, 1, 1);
    // Of the heights' section, or of the densities' behind it: before the error bounds' 32 + 8192.
    let damage = |at: fn(usize) -> usize| {
        let path = stage.terrain().join(tile_path(tile));
        let mut bytes = std::fs::read(&path).expect("the tile");
        let at = at(bytes.len());
        bytes[at] ^= 1;
        std::fs::write(&path, bytes).expect("written");
    };
    // Panels that show heights: the first and the third; densities: the second and the third.
    let check = |spoilt: [bool; 3]| {
        let after = stage.draw(&PreviewSettings::default()).0;
        for (x, z, pixel) in after.enumerate_pixels() {
            let inside = (128..256).contains(&(x % 300)) && (128..256).contains(&z);
            let wanted = if inside && spoilt[(x / 300) as usize] {
                MAGENTA
            } else {
                before.get_pixel(x, z).0
            };
            assert_eq!(pixel.0, wanted, "{x} {z}");
        }
    };
    damage(|_| 100);
    check([true, false, true]);
    let (_, report) = stage.draw(&PreviewSettings::default());
    assert_eq!(report.warnings.len(), 1);
    assert!(report.warnings[0].contains("tile/0/1_1.tile"), "{report:?}");

    damage(|length| length - 32 - 8192 - 100);
    check([true, true, true]);
    let (_, report) = stage.draw(&PreviewSettings::default());
    assert_eq!(report.warnings.len(), 2);
    assert!(report.warnings[1].contains("tile/0/1_1.tile"), "{report:?}");

    // Where pixels are many samples, each that has one of the tile's is spoilt.
    let small = PreviewSettings {
        level: Some(0),
        max_size_px: 60,
        ..of(PreviewKind::Relief)
    };
    let (picture, _) = stage.draw(&small);
    for (x, z, pixel) in picture.enumerate_pixels() {
        let inside = (25..=51).contains(&x) && (25..=51).contains(&z);
        assert_eq!(pixel.0 == MAGENTA, inside, "{x} {z}");
    }
}

#[test]
fn a_tile_that_is_not_stored_is_drawn_from_its_ancestor() {
    use bevy_tessera::terrain::{INDEX_FILE, MANIFEST_FILE, TerrainManifest};
    let stage = Stage::new([300, 300], |x, z| 100.0 * ((x - z * 0.5) * 0.02).sin());
    let (before, _) = stage.draw(&PreviewSettings::default());
    let dir = stage.terrain();
    let mut manifest = TerrainManifest::read(&dir).expect("a terrain");
    for (x, z) in [(1, 1), (2, 2), (0, 2)] {
        manifest.index.set(TileAddress::new(0, x, z), None);
    }
    let bytes = manifest.index.encode();
    // The manifest says which index belongs to it.
    let path = dir.join(MANIFEST_FILE);
    let text = std::fs::read_to_string(&path).expect("text");
    let old = format!("index_crc32: {}", manifest.file.index_crc32);
    let new = format!("index_crc32: {}", crc32fast::hash(&bytes));
    assert!(text.contains(&old));
    std::fs::write(&path, text.replace(&old, &new)).expect("written");
    std::fs::write(dir.join(INDEX_FILE), bytes).expect("written");

    let (after, report) = stage.draw(&PreviewSettings::default());
    assert_eq!((report.coarser_tiles, report.warnings.len()), (3, 0));
    // Smooth ground looks nearly the same from half the samples, if they are where they belong.
    // The outermost samples of coarser levels are flatter, since what lies beyond repeats them.
    for (x, z, pixel) in after.enumerate_pixels().filter(|(x, z, _)| x.max(z) < &297) {
        let wanted = i32::from(before.get_pixel(x, z).0[0]);
        let off = (i32::from(pixel.0[0]) - wanted).abs();
        assert!(off <= 12, "{x} {z}: {off}");
    }
}

#[test]
fn settings_out_of_range_are_refused_with_the_range() {
    let stage = Stage::new([5, 3], hills);
    let default = PreviewSettings::default;
    let refused = |settings: PreviewSettings, words: &[&str]| {
        let error = preview(&stage.terrain(), &stage.out(), &settings).expect_err("refused");
        assert!(matches!(error, PreviewError::Range { .. }));
        let text = error.to_string();
        assert!(words.iter().all(|word| text.contains(word)), "{text}");
    };
    for max_size_px in [0, 15, 8193, u32::MAX] {
        refused(
            PreviewSettings {
                max_size_px,
                ..default()
            },
            &["size", "16..=8192"],
        );
    }
    for bad in [-1.0, 361.0, f64::NAN, f64::INFINITY] {
        refused(
            PreviewSettings {
                sun_azimuth_deg: bad,
                ..default()
            },
            &["azimuth", "0..=360"],
        );
        refused(
            PreviewSettings {
                sun_altitude_deg: bad,
                ..default()
            },
            &["altitude", "1..=90"],
        );
        refused(
            PreviewSettings {
                exaggeration: Some(bad * 3.0),
                ..default()
            },
            &["exaggeration", "0.001..=1000"],
        );
    }
    assert_eq!(stage.beside(), ["terrain"]);
}

#[test]
fn a_failed_preview_leaves_what_was_there() {
    let stage = Stage::new([5, 3], hills);
    let settings = PreviewSettings::default();
    stage.draw(&of(PreviewKind::Relief));
    let old = std::fs::read(stage.out()).expect("readable");
    let kept = || {
        assert!(std::fs::read(stage.out()).expect("still there") == old);
        assert_eq!(stage.beside(), ["picture.png", "terrain"]);
    };
    preview(Path::new("/nowhere/at/all"), &stage.out(), &settings).expect_err("no terrain");
    kept();
    let level = PreviewSettings {
        level: Some(9),
        ..settings.clone()
    };
    preview(&stage.terrain(), &stage.out(), &level).expect_err("no level");
    kept();

    let refused = |out: &Path, words: &str| {
        let error = preview(&stage.terrain(), out, &settings).expect_err("refused");
        assert!(error.to_string().contains(words), "{error}");
        kept();
    };
    refused(&stage.terrain(), "is a folder");
    refused(Path::new("/"), "is a folder");
    refused(Path::new(".."), "is a folder");
    refused(
        &stage.folder.path().join("missing/picture.png"),
        "missing; make it, or choose another --out",
    );
    refused(&stage.out().join("picture.png"), "no folder");
    refused(&stage.terrain().join("terrain.ron"), "part of a terrain");
    refused(
        &stage.folder.path().join("n".repeat(300) + ".png"),
        "can't be written",
    );
    refused(
        &stage.folder.path().join("n".repeat(300) + ".png"),
        "; choose another --out",
    );
    #[cfg(unix)]
    refused(Path::new("/dev/null"), "no regular file");

    // And one that succeeds replaces it, and leaves nothing else behind.
    stage.draw(&settings);
    assert!(std::fs::read(stage.out()).expect("there") != old);
    assert_eq!(stage.beside(), ["picture.png", "terrain"]);
}

#[test]
fn only_previews_and_empty_files_are_replaced() {
    let stage = Stage::new([5, 3], hills);
    let settings = PreviewSettings::default();
    stage.draw(&settings);
    let drawn = std::fs::read(stage.out()).expect("readable");
    let mut reader = png::Decoder::new(std::io::Cursor::new(&drawn))
        .read_info()
        .expect("a PNG");
    reader.finish().expect("a whole one");
    let texts = &reader.info().uncompressed_latin1_text;
    let found: Vec<_> = texts
        .iter()
        .map(|chunk| (&*chunk.keyword, &*chunk.text))
        .collect();
    assert_eq!(found, [("Software", "tessera preview")]);

    let mut height_map = Vec::new();
    let grey = image::GrayImage::new(8, 8);
    grey.write_to(
        &mut std::io::Cursor::new(&mut height_map),
        image::ImageFormat::Png,
    )
    .expect("a PNG");
    // A mark without the file that belongs to it, and one far behind what is looked at.
    let words = drawn[8..].to_vec();
    let far = [&height_map[..], &[0; 5000], &drawn].concat();
    for other in [height_map, words, far, b"notes".to_vec(), vec![0]] {
        std::fs::write(stage.out(), &other).expect("written");
        let error = preview(&stage.terrain(), &stage.out(), &settings).expect_err("refused");
        assert!(matches!(error, PreviewError::OutputExists { .. }));
        let wanted = "picture.png exists and is no preview, so it isn't replaced; choose another \
                      --out or remove it";
        assert!(error.to_string().ends_with(wanted), "{error}");
        assert!(std::fs::read(stage.out()).expect("still there") == other);
        assert_eq!(stage.beside(), ["picture.png", "terrain"]);
    }
    std::fs::write(stage.out(), "").expect("written");
    stage.draw(&settings);
    assert!(std::fs::read(stage.out()).expect("readable") == drawn);
}

#[test]
fn a_picture_is_called_png() {
    let stage = Stage::new([5, 3], hills);
    let settings = PreviewSettings::default();
    for name in ["x.jpg", "x", "x.png.bak", ".png", "png", "x.pn"] {
        let out = stage.folder.path().join(name);
        let error = preview(&stage.terrain(), &out, &settings).expect_err("refused");
        assert!(matches!(error, PreviewError::OutputExtension { .. }));
        let text = error.to_string();
        assert!(
            text.contains(name) && text.contains("ends in .png"),
            "{text}"
        );
        assert_eq!(stage.beside(), ["terrain"]);
    }
    let out = stage.folder.path().join("x.PnG");
    preview(&stage.terrain(), &out, &settings).expect("it is drawn");
    assert_eq!(stage.beside(), ["terrain", "x.PnG"]);
}

#[test]
fn kinds_are_called_what_they_are_parsed_from() {
    let names = PreviewKind::ALL.map(|kind| kind.to_string());
    assert_eq!(names, ["relief", "density", "blended", "all"]);
    for kind in PreviewKind::ALL {
        assert_eq!(
            kind.to_string().parse::<PreviewKind>().expect("a kind"),
            kind
        );
    }
    let error = "rainbow".parse::<PreviewKind>().expect_err("no kind");
    assert!(
        error
            .to_string()
            .contains("relief, density, blended and all")
    );
}
