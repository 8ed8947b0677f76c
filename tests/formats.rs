//! Every format is read as what it is: small files made here, and real ones where `TESSERA_DATA`
//! names a folder of them.

mod bake_support;

use bake_support::{addresses, data, files, heights, manifest, read_all};
use bevy_tessera::bake::import::{self, ImportSettings, Packing};
use bevy_tessera::bake::{self, BakeSettings};
use bevy_tessera::tile::TileAddress;
use std::fs::File;
use std::path::{Path, PathBuf};

const SIZE: [u32; 2] = [37, 23];

/// Heights in whole metres that differ everywhere, from 0 to 850.
fn codes() -> Vec<u16> {
    (0..SIZE[0] * SIZE[1]).map(|at| at as u16).collect()
}

struct Folder {
    dir: tempfile::TempDir,
}

impl Folder {
    fn new() -> Self {
        let dir = tempfile::tempdir().expect("a temporary folder");
        Self { dir }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn write(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.path(name);
        std::fs::write(&path, bytes).expect("a file can be written");
        path
    }
}

/// Opens a file and reads it twice, as a bake does.
fn read_twice(path: &Path, settings: &ImportSettings) -> Vec<f32> {
    let mut source = import::open(path, settings).unwrap_or_else(|e| panic!("{e}"));
    assert_eq!(source.size(), SIZE, "{}", path.display());
    let first = read_all(&mut *source).unwrap_or_else(|e| panic!("{e}"));
    source.rewind().unwrap_or_else(|e| panic!("{e}"));
    let second = read_all(&mut *source).unwrap_or_else(|e| panic!("{e}"));
    let bits = |all: &[f32]| all.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert_eq!(
        bits(&first),
        bits(&second),
        "{} reads differently again",
        path.display()
    );
    if let Some(mapping) = source.codes() {
        source.rewind().unwrap_or_else(|e| panic!("{e}"));
        let mut row = vec![0; SIZE[0] as usize];
        for wanted in first.chunks_exact(row.len()) {
            source
                .read_codes(&mut row)
                .unwrap_or_else(|e| panic!("{e}"));
            let found: Vec<_> = row.iter().map(|&code| mapping.sample(code)).collect();
            assert_eq!(
                bits(&found),
                bits(wanted),
                "{}: codes differ",
                path.display()
            );
        }
    }
    first
}

fn metres() -> Vec<f32> {
    codes().into_iter().map(f32::from).collect()
}

fn png(path: &Path, size: [u32; 2], colour: png::ColorType, depth: png::BitDepth, data: &[u8]) {
    let file = File::create(path).expect("a file can be written");
    let mut encoder = png::Encoder::new(file, size[0], size[1]);
    encoder.set_color(colour);
    encoder.set_depth(depth);
    let mut writer = encoder.write_header().expect("a header");
    writer.write_image_data(data).expect("pixels");
}

#[test]
fn grey_png_of_every_depth_is_read() {
    let folder = Folder::new();
    let settings = ImportSettings::default();
    let path = folder.path("sixteen.png");
    let data: Vec<u8> = codes().iter().flat_map(|c| c.to_be_bytes()).collect();
    png(
        &path,
        SIZE,
        png::ColorType::Grayscale,
        png::BitDepth::Sixteen,
        &data,
    );
    assert_eq!(read_twice(&path, &settings), metres());
    for (bits, depth) in [
        (1_u32, png::BitDepth::One),
        (2, png::BitDepth::Two),
        (4, png::BitDepth::Four),
        (8, png::BitDepth::Eight),
    ] {
        let largest = (1_u32 << bits) - 1;
        let values: Vec<u32> = codes()
            .iter()
            .map(|&c| (u32::from(c) * 7) & largest)
            .collect();
        let data: Vec<u8> = values
            .chunks_exact(SIZE[0] as usize)
            .flat_map(|row| {
                row.chunks(8 / bits as usize).map(|few| {
                    let shifted = few.iter().enumerate();
                    shifted.fold(0, |byte, (at, &value)| {
                        byte | (value << (8 - bits * (at as u32 + 1))) as u8
                    })
                })
            })
            .collect();
        let path = folder.path(&format!("{bits}.png"));
        png(&path, SIZE, png::ColorType::Grayscale, depth, &data);
        let wanted: Vec<f32> = values.iter().map(|&value| value as f32).collect();
        assert_eq!(read_twice(&path, &settings), wanted, "{bits} bit");
        let shares = ImportSettings {
            range_m: Some(-10.0..=20.0),
            ..Default::default()
        };
        let step = 30.0 / f64::from(largest);
        let wanted: Vec<f32> = values
            .iter()
            .map(|&value| (f64::from(value) * step - 10.0) as f32)
            .collect();
        assert_eq!(read_twice(&path, &shares), wanted, "{bits} bit as shares");
    }
}

#[test]
fn heights_packed_into_colours_are_unpacked() {
    let folder = Folder::new();
    let pack = |name: &str, colour: png::ColorType, number: &dyn Fn(u16) -> u32| {
        let alpha = colour == png::ColorType::Rgba;
        let data: Vec<u8> = codes()
            .iter()
            .flat_map(|&code| {
                let [_, r, g, b] = number(code).to_be_bytes();
                let mut pixel = vec![r, g, b];
                pixel.extend(alpha.then_some(7));
                pixel
            })
            .collect();
        let path = folder.path(name);
        png(&path, SIZE, colour, png::BitDepth::Eight, &data);
        path
    };
    let with = |packing| ImportSettings {
        packing: Some(packing),
        ..Default::default()
    };
    for colour in [png::ColorType::Rgb, png::ColorType::Rgba] {
        let path = pack("terrain.png", colour, &|c| 100_000 + u32::from(c) * 10);
        assert_eq!(read_twice(&path, &with(Packing::TerrainRgb)), metres());
        let path = pack("terrarium.png", colour, &|c| (32_768 + u32::from(c)) * 256);
        assert_eq!(read_twice(&path, &with(Packing::Terrarium)), metres());
        let path = pack("rgb24.png", colour, &|c| u32::from(c) << 14);
        let settings = ImportSettings {
            range_m: Some(0.0..=1024.0),
            ..with(Packing::Rgb24)
        };
        assert_eq!(read_twice(&path, &settings), metres());
    }
}

fn tiff<C>(path: &Path, data: &[C::Inner])
where
    C: tiff::encoder::colortype::ColorType,
    [C::Inner]: tiff::encoder::TiffValue,
{
    let file = File::create(path).expect("a file can be written");
    let mut encoder = tiff::encoder::TiffEncoder::new(file).expect("a header");
    let mut image = encoder.new_image::<C>(SIZE[0], SIZE[1]).expect("an image");
    image.rows_per_strip(5).expect("strips");
    image.write_data(data).expect("pixels");
}

#[test]
fn grey_tiff_of_every_number_type_is_read() {
    use tiff::encoder::colortype::{
        Gray8, Gray16, Gray32, Gray32Float, Gray64, Gray64Float, GrayI8, GrayI16, GrayI32, GrayI64,
    };
    let folder = Folder::new();
    let settings = ImportSettings::default();
    let path = folder.path("a.tif");
    let all = codes();
    tiff::<Gray16>(&path, &all);
    assert_eq!(read_twice(&path, &settings), metres());
    tiff::<Gray32>(&path, &all.iter().map(|&c| c.into()).collect::<Vec<_>>());
    assert_eq!(read_twice(&path, &settings), metres());
    tiff::<Gray64>(&path, &all.iter().map(|&c| c.into()).collect::<Vec<_>>());
    assert_eq!(read_twice(&path, &settings), metres());
    tiff::<Gray32Float>(&path, &metres());
    assert_eq!(read_twice(&path, &settings), metres());
    tiff::<Gray64Float>(&path, &all.iter().map(|&c| c.into()).collect::<Vec<_>>());
    assert_eq!(read_twice(&path, &settings), metres());

    let sunk: Vec<f32> = metres().iter().map(|m| m - 400.0).collect();
    let signed: Vec<i16> = all.iter().map(|&c| c as i16 - 400).collect();
    tiff::<GrayI16>(&path, &signed);
    assert_eq!(read_twice(&path, &settings), sunk);
    tiff::<GrayI32>(&path, &signed.iter().map(|&c| c.into()).collect::<Vec<_>>());
    assert_eq!(read_twice(&path, &settings), sunk);
    tiff::<GrayI64>(&path, &signed.iter().map(|&c| c.into()).collect::<Vec<_>>());
    assert_eq!(read_twice(&path, &settings), sunk);

    let low: Vec<u8> = all.iter().map(|&c| c as u8).collect();
    tiff::<Gray8>(&path, &low);
    assert_eq!(
        read_twice(&path, &settings),
        low.iter().map(|&c| c.into()).collect::<Vec<f32>>()
    );
    let low: Vec<i8> = all.iter().map(|&c| c as i8).collect();
    tiff::<GrayI8>(&path, &low);
    assert_eq!(
        read_twice(&path, &settings),
        low.iter().map(|&c| c.into()).collect::<Vec<f32>>()
    );
}

/// Writes a GeoTIFF of floats, with the given pixel scale, tie point, keys and no-data text.
fn geotiff(path: &Path, data: &[f32], scale: [f64; 2], tie: [f64; 2], keys: &[u16], none: &str) {
    use tiff::encoder::colortype::Gray32Float;
    use tiff::tags::Tag;
    let file = File::create(path).expect("a file can be written");
    let mut encoder = tiff::encoder::TiffEncoder::new(file).expect("a header");
    let mut image = encoder
        .new_image::<Gray32Float>(SIZE[0], SIZE[1])
        .expect("an image");
    let tags = image.encoder();
    tags.write_tag(Tag::ModelPixelScaleTag, &[scale[0], scale[1], 0.0][..])
        .expect("a tag");
    tags.write_tag(
        Tag::ModelTiepointTag,
        &[0.0, 0.0, 0.0, tie[0], tie[1], 0.0][..],
    )
    .expect("a tag");
    tags.write_tag(Tag::GeoKeyDirectoryTag, keys)
        .expect("a tag");
    tags.write_tag(Tag::GdalNodata, none).expect("a tag");
    image.write_data(data).expect("pixels");
}

#[test]
fn geotiff_scale_and_no_data_are_used() {
    let folder = Folder::new();
    let path = folder.path("a.tif");
    let mut data = metres();
    data[5] = -3.402_823_5e38;
    data[40] = f32::NAN;
    let projected = [1, 1, 0, 1, 1024, 0, 1, 1];
    geotiff(
        &path,
        &data,
        [12.5, 12.5],
        [5e5, 4e6],
        &projected,
        "-3.4028234663852886e+38 ",
    );
    let mut source = import::open(&path, &ImportSettings::default()).expect("readable");
    assert_eq!(source.spacing_m(), Some(12.5));
    assert!(source.notes().is_empty(), "{:?}", source.notes());
    let found = read_all(&mut *source).expect("readable");
    let missing: Vec<usize> = (0..found.len()).filter(|&at| found[at].is_nan()).collect();
    assert_eq!(missing, [5, 40]);
    assert_eq!(found[6], 6.0);

    // One arc second at 60 degrees north: 15.5 m by 30.9 m.
    let geographic = [1, 1, 0, 1, 1024, 0, 1, 2];
    let second = 1.0 / 3600.0;
    geotiff(&path, &data, [second; 2], [10.0, 60.0], &geographic, "nan");
    let source = import::open(&path, &ImportSettings::default()).expect("readable");
    let spacing = source.spacing_m().expect("told");
    assert!(
        (spacing - (15.5_f64 * 30.95).sqrt()).abs() < 0.1,
        "{spacing}"
    );
    assert_eq!(source.notes().len(), 1, "that pixels aren't square is said");

    let feet = [1, 1, 0, 2, 1024, 0, 1, 1, 3076, 0, 1, 9003];
    geotiff(&path, &data, [100.0; 2], [0.0; 2], &feet, "x");
    let source = import::open(&path, &ImportSettings::default()).expect("readable");
    assert!((source.spacing_m().expect("told") - 30.480_061).abs() < 1e-5);
}

#[test]
fn raw_files_are_read_in_both_byte_orders() {
    let folder = Folder::new();
    let sized = |big_endian| ImportSettings {
        size: Some(SIZE),
        big_endian,
        ..Default::default()
    };
    let bytes: Vec<u8> = codes().iter().flat_map(|c| c.to_le_bytes()).collect();
    let path = folder.write("a.r16", &bytes);
    assert_eq!(read_twice(&path, &sized(false)), metres());
    let bytes: Vec<u8> = codes().iter().flat_map(|c| c.to_be_bytes()).collect();
    let path = folder.write("a.r16", &bytes);
    assert_eq!(read_twice(&path, &sized(true)), metres());
    let bytes: Vec<u8> = metres().iter().flat_map(|c| c.to_le_bytes()).collect();
    let path = folder.write("a.r32", &bytes);
    assert_eq!(read_twice(&path, &sized(false)), metres());
    let bytes: Vec<u8> = metres().iter().flat_map(|c| c.to_be_bytes()).collect();
    let path = folder.write("a.r32", &bytes);
    assert_eq!(read_twice(&path, &sized(true)), metres());
    let halves = ImportSettings {
        scale: Some(0.5),
        offset: Some(-3.0),
        ..sized(true)
    };
    assert_eq!(read_twice(&path, &halves)[10], 2.0);
}

#[test]
fn srtm_tiles_are_read_and_their_voids_are_missing() {
    let folder = Folder::new();
    let mut values = vec![-5_i16; 1201 * 1201];
    values[1201 * 3 + 4] = -32768;
    values[1201 * 3 + 5] = 1234;
    let bytes: Vec<u8> = values.iter().flat_map(|v| v.to_be_bytes()).collect();
    let path = folder.write("N00E010.hgt", &bytes);
    let mut source = import::open(&path, &ImportSettings::default()).expect("readable");
    assert_eq!(source.size(), [1201, 1201]);
    let spacing = source.spacing_m().expect("told");
    assert!((spacing - 92.45).abs() < 0.1, "{spacing}");
    let found = read_all(&mut *source).expect("readable");
    assert_eq!(found[0], -5.0);
    assert!(found[1201 * 3 + 4].is_nan());
    assert_eq!(found[1201 * 3 + 5], 1234.0);

    source.rewind().expect("readable");
    let dir = folder.path("terrain");
    let report = bake::bake(&mut *source, &dir, &BakeSettings::default(), &()).expect("bakes");
    assert_eq!(report.filled, 1);
    assert_eq!(report.source_range_m, Some((-5.0, 1234.0)));
}

#[test]
fn openexr_is_read_by_line_and_by_tile_in_both_orders() {
    use exr::prelude::*;
    let folder = Folder::new();
    let path = folder.path("a.exr");
    let settings = ImportSettings::default();
    let all = metres();
    let at = |position: Vec2<usize>| all[position.y() * SIZE[0] as usize + position.x()];
    let size = (SIZE[0] as usize, SIZE[1] as usize);
    let samples: Vec<f32> = all.clone();
    let encodings = [
        (Compression::ZIP16, Blocks::ScanLines, LineOrder::Increasing),
        (
            Compression::Uncompressed,
            Blocks::ScanLines,
            LineOrder::Decreasing,
        ),
        (
            Compression::PIZ,
            Blocks::Tiles(Vec2(16, 8)),
            LineOrder::Increasing,
        ),
    ];
    for (compression, blocks, line_order) in encodings {
        let encoding = Encoding {
            compression,
            blocks,
            line_order,
        };
        for name in ["Y", "Z", "whatever"] {
            let channel = AnyChannel::new(name, FlatSamples::F32(samples.clone()));
            let layer = Layer::new(
                size,
                LayerAttributes::named("heights"),
                encoding,
                AnyChannels::sort(std::iter::once(channel).collect()),
            );
            Image::from_layer(layer)
                .write()
                .to_file(&path)
                .expect("written");
            assert_eq!(read_twice(&path, &settings), all, "{name} {encoding:?}");
        }
        let grey = SpecificChannels::rgb(|position| (at(position), at(position), at(position)));
        let layer = Layer::new(size, LayerAttributes::named("grey"), encoding, grey);
        Image::from_layer(layer)
            .write()
            .to_file(&path)
            .expect("written");
        assert_eq!(
            read_twice(&path, &settings),
            all,
            "grey in colours, {encoding:?}"
        );
    }
    let halves = all.iter().map(|&value| f16::from_f32(value)).collect();
    let channel = AnyChannel::new("Y", FlatSamples::F16(halves));
    let channels = AnyChannels::sort(std::iter::once(channel).collect());
    let layer = Layer::new(
        size,
        LayerAttributes::named("a"),
        Encoding::default(),
        channels,
    );
    Image::from_layer(layer)
        .write()
        .to_file(&path)
        .expect("written");
    assert_eq!(
        read_twice(&path, &settings),
        all,
        "whole numbers to 850 fit 16 bit floats"
    );
}

/// The options that make a file of `formats/` give heights in metres, and how far these may be off.
fn options(name: &str) -> (ImportSettings, f64) {
    let plain = ImportSettings::default();
    let range = ImportSettings {
        range_m: Some(-100.0..=6453.5),
        ..Default::default()
    };
    let raw = ImportSettings {
        size: Some([1025, 1025]),
        ..range.clone()
    };
    let packed = |packing| ImportSettings {
        packing: Some(packing),
        ..Default::default()
    };
    match name {
        "be.r16" => (
            ImportSettings {
                big_endian: true,
                ..raw
            },
            0.0,
        ),
        "le.r16" | "le.r32" => (raw, 0.0),
        "u16.png" | "u16.tif" => (range, 0.0),
        "u8_lossy.png" => (
            ImportSettings {
                range_m: Some(439.0..=3275.0),
                ..Default::default()
            },
            // Half of a 255th of the range.
            (3275.0 - 439.0) / 255.0 / 2.0,
        ),
        "mapbox_terrain_rgb.png" => (packed(Packing::TerrainRgb), 0.0),
        "terrarium.png" => (packed(Packing::Terrarium), 0.0),
        // 16 bit floats between 2048 and 4096 are 2 apart.
        "f16_Y_zips_lossy.exr" => (plain, 1.0),
        _ => (plain, 0.0),
    }
}

#[test]
fn eighteen_files_of_the_same_heights_give_the_same_tiles() {
    let Some(data) = data() else { return };
    let folder = Folder::new();
    let settings = BakeSettings {
        height_range_m: Some(-100.0..=6453.5),
        spacing_m: Some(20.0),
        ..Default::default()
    };
    let bake = |path: &Path, import: &ImportSettings| {
        let mut source = import::open(path, import).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(source.size(), [1025, 1025], "{}", path.display());
        let dir = folder.path(&path.file_name().expect("a name").to_string_lossy());
        let report =
            bake::bake(&mut *source, &dir, &settings, &()).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(
            (report.clamped, report.filled),
            (0, 0),
            "{}",
            path.display()
        );
        dir
    };
    let formats = data.join("formats");
    let reference = bake(&formats.join("u16.tif"), &options("u16.tif").0);
    let file = manifest(&reference).file;
    let mut read = 0;
    for path in files(&formats) {
        let name = path
            .file_name()
            .expect("a name")
            .to_string_lossy()
            .into_owned();
        if name == "meta.json" {
            continue;
        }
        read += 1;
        if name == "u16.tif" {
            continue;
        }
        let (import, tolerance_m) = options(&name);
        let dir = bake(&path, &import);
        // Both ends of a difference may round, to the nearest stored height.
        let tolerance = (tolerance_m / file.height_step_m).ceil() as u16;
        let mut worst = 0;
        for address in addresses(&file) {
            let (a, b) = (heights(&reference, address), heights(&dir, address));
            for (a, b) in a.samples().iter().zip(b.samples()) {
                worst = worst.max(a.abs_diff(*b));
            }
        }
        assert!(
            worst <= tolerance,
            "{name}: heights differ by {worst} units"
        );
        if tolerance_m > 0.0 {
            assert!(worst > 0, "{name} is lossy");
        }
    }
    assert_eq!(read, 18);
}

#[test]
fn real_elevation_models_are_read() {
    let Some(data) = data() else { return };
    let folder = Folder::new();
    let bake = |name: &str, import: ImportSettings| {
        let path = data.join("terrain").join(name);
        let mut source = import::open(&path, &import).unwrap_or_else(|e| panic!("{e}"));
        let dir = folder.path(name);
        let report = bake::bake(&mut *source, &dir, &BakeSettings::default(), &())
            .unwrap_or_else(|e| panic!("{e}"));
        let verified = bake::verify(&dir, &|_| {}).unwrap_or_else(|e| panic!("{e}"));
        assert!(verified.faults.is_empty(), "{name}: {:?}", verified.faults);
        assert_eq!(verified.tiles, report.tiles);
        report
    };
    let scaled = |scale, offset| ImportSettings {
        scale: Some(scale),
        offset: Some(offset),
        ..Default::default()
    };
    let report = bake("taiwan_z12_4096_u16.png", scaled(0.1, -100.0));
    assert_eq!(report.size, [4096, 4096]);
    assert_eq!(report.source_range_m, Some((-22.0, 3947.0)));
    let report = bake("puget_sound_1025_u16.png", scaled(0.1, 0.0));
    assert_eq!(report.size, [1025, 1025]);
    let report = bake("mt_rainier_90m.tif", ImportSettings::default());
    assert_eq!((report.size, report.filled), ([1201, 1201], 9033));
    let report = bake("N44W072.hgt", ImportSettings::default());
    assert_eq!(report.source_range_m, Some((115.0, 1908.0)));
    let report = bake("slovenia_lidar_1m_f32.tif", ImportSettings::default());
    assert_eq!((report.size, report.spacing_m), ([1000, 1000], 1.0));
}

#[test]
fn the_bundled_elevation_model_bakes_at_the_heights_that_its_readme_gives() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/elevation/jacksboro_u16.png");
    let settings = ImportSettings {
        scale: Some(0.02),
        offset: Some(200.0),
        ..Default::default()
    };
    let mut source = import::open(&path, &settings).unwrap_or_else(|e| panic!("{e}"));
    let folder = Folder::new();
    let dir = folder.path("jacksboro");
    let report = bake::bake(&mut *source, &dir, &BakeSettings::default(), &()).expect("bakes");
    assert_eq!(report.size, [1000, 1058]);
    let (low, high) = report.source_range_m.expect("looked for");
    assert!(
        (low - 234.7).abs() < 0.1 && (high - 1075.7).abs() < 0.1,
        "{low}..{high}"
    );
    let root = TileAddress::new(report.levels - 1, 0, 0);
    assert!(manifest(&dir).index.get(root).is_some());
}
