//! Densities are what they promise: the same on every machine, never rounded down, blind to the
//! steps of stored heights, seeing a spike wherever it stands, equal where tiles meet, alike at any
//! resolution; and made anew they are what a bake makes.
#![cfg(feature = "generate")]

mod bake_support;

use bake_support::{addresses, bake_heights, densities, heights, landscape, manifest};
use bevy_tessera::bake::generate::{GenerateSettings, GeneratedSource, GeneratorKind};
use bevy_tessera::bake::{
    BakeError, BakeProgress, BakeSettings, BakeStage, bake, rebake_densities, verify,
};
use bevy_tessera::density::curvature::Ring;
use bevy_tessera::density::{
    DensityBorder, DensityExtent, DensityFilter, DensityKernel, DensityScratch, DensitySettings,
    DensityWindow, tile_densities,
};
use bevy_tessera::terrain::{INDEX_FILE, MANIFEST_FILE, TerrainManifest};
use bevy_tessera::tile::{TileAddress, TileRange, tile_path};
use proptest::prelude::*;
use std::fs;
use std::path::Path;

fn settings(filter: DensityFilter) -> DensitySettings {
    DensitySettings {
        filter,
        ..Default::default()
    }
}

/// Densities of a tile in the middle of a terrain whose stored heights `height` gives.
fn tile(kernel: &DensityKernel, height: impl Fn(i32, i32) -> u16) -> [u8; 1024] {
    let stored: Vec<u16> = (0..133 * 133)
        .map(|at| height(at % 133 - 2, at / 133 - 2))
        .collect();
    let mut out = [0; 1024];
    let mut scratch = DensityScratch::default();
    let extent = DensityExtent::new([1025; 2], 0);
    tile_densities(kernel, &extent, [256; 2], &stored, &mut scratch, &mut out);
    out
}

/// A generator of numbers without a crate.
struct Lcg(u64);

impl Lcg {
    fn next(&mut self) -> u32 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (self.0 >> 33) as u32
    }

    /// In -1..1.
    fn signed(&mut self) -> f64 {
        f64::from(self.next()) / f64::from(1_u32 << 30) - 1.0
    }
}

#[test]
fn vector_instructions_make_the_same_bytes_as_one_sample_at_a_time() {
    let mut random = Lcg(3);
    for filter in DensityFilter::ALL {
        for (texels, exponent) in [([1, 1], 1.0), ([3, 2], 1.0), ([32, 5], 2.5), ([77, 3], 0.6)] {
            let kernel = DensityKernel::new(
                &DensitySettings {
                    gain: 0.3,
                    exponent,
                    ..settings(filter)
                },
                0.01,
                1.0,
                0,
            );
            let [width, height] = texels.map(|texels: usize| 4 * texels + 3);
            let stored: Vec<u16> = (0..width * height)
                .map(|at| (20_000 + 40 * (at % width) as u32 + random.next() % 97) as u16)
                .collect();
            let window = DensityWindow {
                heights: &stored,
                stride: width,
                texels,
                terrain: texels.map(|texels| 0..4 * texels + 3),
            };
            let mut found = vec![0; texels[0] * texels[1]];
            kernel.run(
                &window,
                &mut DensityScratch::default(),
                &mut found,
                texels[0],
            );
            for (at, &found) in found.iter().enumerate() {
                let (x, z) = (4 * (at % texels[0]), 4 * (at / texels[0]));
                let mut largest = 0.0_f32;
                for sample in 0..25 {
                    let (x, z) = (x + 1 + sample % 5, z + 1 + sample / 5);
                    let ring = Ring::new(|dx, dz| {
                        let (x, z) = (x as i32 + dx, z as i32 + dz);
                        f32::from(stored[z as usize * width + x as usize])
                    });
                    largest = largest.max(filter.curvature(&ring, kernel.step()));
                }
                assert_eq!(
                    found,
                    kernel.quantise(largest),
                    "{filter}, texel {at} of {texels:?}"
                );
            }
        }
    }
}

#[test]
fn a_plane_of_stored_steps_has_no_density_at_any_slope() {
    let mut random = Lcg(9);
    for filter in DensityFilter::ALL {
        for case in 0..120 {
            // Steps from far below a spacing to several spacings, slopes from level to cliffs.
            let step = [1e-4, 0.003, 0.02, 0.11, 0.5, 1.0, 4.0][case % 7];
            let steepness = [0.01, 0.3, 1.0, 7.0, 110.0][case % 5];
            let kernel = DensityKernel::new(
                &DensitySettings {
                    gain: 1000.0,
                    ..settings(filter)
                },
                step,
                1.0,
                0,
            );
            let (x, z) = (random.signed() * steepness, random.signed() * steepness);
            let offset = random.signed();
            let found = tile(&kernel, |column, row| {
                let wanted = x * f64::from(column) + z * f64::from(row) + offset + 30_000.0;
                assert!((0.0..65535.0).contains(&wanted));
                (wanted + 0.5).floor() as u16
            });
            let largest = found.iter().max().expect("1024 texels");
            assert_eq!(
                *largest, 0,
                "{filter}, {x} and {z} steps a sample, a step being {step}"
            );
        }
    }
}

#[test]
fn what_bends_more_than_rounding_can_is_seen_in_full() {
    for filter in DensityFilter::ALL {
        let kernel = DensityKernel::new(&settings(filter), 0.02, 1.0, 0);
        let noise = kernel.noise();
        assert_eq!(kernel.quantise(noise), 0);
        let above = kernel.quantise(noise * 1.5);
        assert!(above > 0 || noise * kernel.factor() < 1e-3, "{filter}");
        let wanted = f64::from(2.0 * noise * kernel.factor()).min(1.0) * 255.0;
        assert_eq!(
            f64::from(kernel.quantise(2.0 * noise)),
            wanted.ceil(),
            "{filter}"
        );
    }
}

#[test]
fn the_spike_of_table_3_1_is_caught_wherever_it_stands() {
    for filter in DensityFilter::ALL {
        let kernel = DensityKernel::new(&settings(filter), 0.01, 1.0, 0);
        // From two sample spacings high to five hundred.
        for at in 0..256 {
            let high = [200, 1000, 5000, 50_000][at as usize / 64];
            let spike = [64 + at % 8, 60 + at / 8 % 8];
            let found = tile(
                &kernel,
                |x, z| if [x, z] == spike { 5_000 + high } else { 5_000 },
            );
            // On a lone spike the area of the Laplace-Beltrami filters grows with the height, and
            // what is left is what its neighbours see.
            let least = match filter {
                DensityFilter::LaplaceBeltrami | DensityFilter::LaplaceBeltramiVoronoi => 128,
                _ => 255,
            };
            // All texels whose ground the spike lifts: it belongs to up to four.
            for (texel, &density) in found.iter().enumerate() {
                let (x, z) = (4 * (texel as i32 % 32), 4 * (texel as i32 / 32));
                let touched = (x..=x + 4).contains(&spike[0]) && (z..=z + 4).contains(&spike[1]);
                assert!(
                    !touched || density >= least,
                    "{filter}: {density} in texel ({x}, {z}), spike of {high} at {spike:?}"
                );
                let near =
                    (x - 1..=x + 5).contains(&spike[0]) && (z - 1..=z + 5).contains(&spike[1]);
                assert!(
                    near || density == 0,
                    "{filter}: {density} far from the spike"
                );
            }
        }
    }
}

#[test]
fn an_exponent_leaves_none_and_all_where_they_are_and_lowers_the_rest() {
    for exponent in [0.05, 0.5, 1.5, 2.0, 20.0] {
        let plain = DensityKernel::new(&settings(DensityFilter::Mean), 0.0, 1.0, 0);
        let shaped = DensitySettings {
            exponent,
            ..Default::default()
        };
        let kernel = DensityKernel::new(&shaped, 0.0, 1.0, 0);
        assert_eq!(kernel.quantise(0.0), 0);
        assert_eq!(kernel.quantise(1.0), 255);
        assert!(
            kernel.quantise(1e-20) > 0,
            "only what is plain is stored as 0"
        );
        for step in 1..100 {
            let curvature = step as f32 * 0.005;
            let (before, after) = (plain.quantise(curvature), kernel.quantise(curvature));
            if exponent > 1.0 {
                assert!(after <= before, "{exponent}: {before} to {after}");
            } else {
                assert!(after >= before, "{exponent}: {before} to {after}");
            }
        }
    }
}

#[test]
fn what_is_no_number_has_no_density() {
    let kernel = DensityKernel::new(&DensitySettings::default(), 0.01, 1.0, 0);
    assert_eq!(kernel.quantise(f32::NAN), 0);
    assert_eq!(kernel.quantise(f32::NEG_INFINITY), 0);
    assert_eq!(kernel.quantise(f32::INFINITY), 255);
}

/// 254 / 255 in `f32` times 255 rounds to 254 exactly, though the share is a little more.
#[test]
fn a_density_just_above_a_step_is_stored_as_the_next() {
    let unscaled = DensitySettings {
        gain: 1.0 / DensityFilter::Mean.scale(),
        ..Default::default()
    };
    let kernel = DensityKernel::new(&unscaled, 0.0, 1.0, 0);
    assert_eq!(kernel.quantise(f32::MIN_POSITIVE), 1);
    for step in 1..255_u16 {
        let share = f32::from(step) / 255.0;
        let stored = f64::from(kernel.quantise(share)) / 255.0;
        assert!(stored >= f64::from(share), "{step}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, ..ProptestConfig::default() })]

    #[test]
    fn densities_are_never_rounded_down(curvature in 0_f32..2.0, gain in 0.01_f32..8.0) {
        let settings = DensitySettings { gain, ..Default::default() };
        let kernel = DensityKernel::new(&settings, 0.0, 1.0, 0);
        let wanted = f64::from((curvature * kernel.factor()).clamp(0.0, 1.0));
        let stored = f64::from(kernel.quantise(curvature)) / 255.0;
        prop_assert!(stored >= wanted, "{stored} < {wanted}");
        prop_assert!(stored - wanted < 1.0 / 255.0 + 1e-12);
    }

    #[test]
    fn more_gain_never_makes_less_density(
        seed in any::<u64>(),
        filter in 0_usize..6,
        gain in 0.001_f32..500.0,
        more in 1.0_f32..2.0,
        step in prop_oneof![1e-4_f64..1e-2, 1e-2_f64..10.0, 10.0_f64..1e9],
        rough in 1_u32..65536,
    ) {
        let mut random = Lcg(seed);
        let stored: Vec<u16> = (0..133 * 133).map(|_| (random.next() % rough) as u16).collect();
        let at = |x: i32, z: i32| stored[((z + 2) * 133 + x + 2) as usize];
        let of = |gain| {
            let settings = DensitySettings { gain, ..settings(DensityFilter::ALL[filter]) };
            tile(&DensityKernel::new(&settings, step, 1.0, 0), at)
        };
        for (texel, (less, more)) in of(gain).into_iter().zip(of(gain * more)).enumerate() {
            prop_assert!(less <= more, "texel {texel}: {less} to {more}");
        }
    }
}

/// Bakes `size` samples of one fractal ground, every `stride`-th of them.
fn fractal(dir: &Path, kind: GeneratorKind, size: u32, stride: u32) -> f64 {
    let mut source = GeneratedSource::new(GenerateSettings {
        spacing_m: f64::from(stride),
        wavelength_m: 300.0,
        relief_m: 150.0,
        ..GenerateSettings::new(kind, [size / stride + 1; 2])
    })
    .expect("the settings are good");
    let settings = BakeSettings::default();
    bake(&mut source, dir, &settings, &()).expect("the bake succeeds");
    rebake_densities(dir, &DensitySettings::default(), &())
        .expect("it works")
        .mean
}

/// The band that the guide states: doubling the spacing changes the mean density of fractal ground
/// by at most a quarter, and no ground's to more than twice as much.
#[test]
fn the_same_ground_has_about_the_same_density_at_any_resolution() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = |name: &str| folder.path().join(name);
    for kind in [
        GeneratorKind::Fbm,
        GeneratorKind::Ridged,
        GeneratorKind::Hybrid,
    ] {
        let means: Vec<f64> = [1, 2, 4]
            .map(|stride| fractal(&dir(&format!("{kind}{stride}")), kind, 1024, stride))
            .to_vec();
        for pair in means.windows(2) {
            let ratio = pair[1] / pair[0];
            assert!((0.75..1.25).contains(&ratio), "{kind}: {means:?}");
        }
        assert!((0.02..0.98).contains(&means[0]), "{kind}: {means:?}");
    }
    // Ground without any detail between the samples is the other end: the steps between its slopes
    // are twice as large at twice the spacing.
    let smooth = |stride: u32| {
        let size = [512 / stride + 1; 2];
        let metres = (0..size[0] * size[1])
            .map(|at| ((at % size[0]) * stride, (at / size[0]) * stride))
            .map(|(x, z)| (x as f32 * 0.02).sin() * 30.0 + (z as f32 * 0.03).cos() * 20.0)
            .collect();
        let settings = BakeSettings {
            spacing_m: Some(f64::from(stride)),
            ..Default::default()
        };
        let dir = dir(&format!("smooth{stride}"));
        bake_heights(size, metres, &dir, &settings);
        rebake_densities(&dir, &DensitySettings::default(), &())
            .expect("it works")
            .mean
    };
    let ratio = smooth(2) / smooth(1);
    assert!((1.6..2.05).contains(&ratio), "{ratio}");
}

fn varied() -> Vec<DensitySettings> {
    let base = DensitySettings {
        gain: 0.5,
        ..Default::default()
    };
    vec![
        base.clone(),
        DensitySettings {
            filter: DensityFilter::Principal,
            filter_size: 3,
            ..base.clone()
        },
        DensitySettings {
            border: DensityBorder::PointSampled,
            filter_size: 2,
            lod_skip: 2,
            exponent: 1.7,
            ..base.clone()
        },
        DensitySettings {
            filter: DensityFilter::LaplaceBeltramiVoronoi,
            border: DensityBorder::PointSampled,
            preprocess: false,
            ..base.clone()
        },
        DensitySettings {
            filter_size: 32,
            lod_skip: 1,
            border: DensityBorder::PointSampled,
            ..base
        },
    ]
}

/// All sides and corners of every two neighbours at every level; `verify` compares all texels that
/// both hold.
#[test]
fn neighbours_agree_in_all_densities_that_both_hold() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    let size = [700, 460];
    for density in varied() {
        let settings = BakeSettings {
            density: density.clone(),
            force: true,
            ..Default::default()
        };
        bake_heights(size, landscape(size, 5), &dir, &settings);
        let report = verify(&dir, &|_| {}).expect("it can be read");
        assert!(report.faults.is_empty(), "{density:?}: {:?}", report.faults);
        let file = manifest(&dir).file;
        for address in addresses(&file) {
            let [columns, rows] = file.tiles(address.level);
            let own = densities(&dir, address);
            for (dx, dz) in [(1, 0), (0, 1), (1, 1)] {
                let (x, z) = (address.x + dx, address.z + dz);
                if x >= columns || z >= rows {
                    continue;
                }
                let other = densities(&dir, TileAddress::new(address.level, x, z));
                for step in 0..1024 {
                    let (mut x, mut z) = (step % 35 - 1, step / 35 - 1);
                    (x, z) = (x + 32 * dx as i32, z + 32 * dz as i32);
                    if x <= 33 && z <= 33 {
                        let theirs = other.get(x - 32 * dx as i32, z - 32 * dz as i32);
                        assert_eq!(own.get(x, z), theirs, "{address}, ({x}, {z}), {density:?}");
                    }
                }
            }
        }
    }
}

/// The bytes of all files of a terrain, by name.
fn contents(dir: &Path) -> Vec<(String, Vec<u8>)> {
    let mut files = vec![MANIFEST_FILE.to_owned(), INDEX_FILE.to_owned()];
    for (address, _) in manifest(dir).index.iter() {
        files.push(tile_path(address));
    }
    let read = |file: String| {
        let bytes = fs::read(dir.join(&file)).unwrap_or_else(|error| panic!("{file}: {error}"));
        (file, bytes)
    };
    files.into_iter().map(read).collect()
}

#[test]
fn densities_made_anew_are_what_a_bake_makes_byte_for_byte() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (first, wanted) = (folder.path().join("first"), folder.path().join("wanted"));
    for size in [[2, 2], [2, 300], [130, 129], [523, 391]] {
        let metres = landscape(size, 11);
        let force = BakeSettings {
            force: true,
            spacing_m: Some(2.5),
            ..Default::default()
        };
        bake_heights(size, metres.clone(), &first, &force);
        for density in varied() {
            let settings = BakeSettings {
                density: density.clone(),
                ..force.clone()
            };
            bake_heights(size, metres.clone(), &wanted, &settings);
            let report = rebake_densities(&first, &density, &()).expect("it works");
            assert_eq!(report.tiles, addresses(&manifest(&first).file).len() as u64);
            assert_eq!(manifest(&first).file.density, density);
            for (found, wanted) in contents(&first).into_iter().zip(contents(&wanted)) {
                assert_eq!(found.0, wanted.0);
                assert!(
                    found.1 == wanted.1,
                    "{size:?}: {} differs, {density:?}",
                    found.0
                );
            }
        }
    }
    assert_eq!(bake_support::entries(folder.path()), ["first", "wanted"]);
}

#[test]
fn making_densities_anew_does_not_touch_heights() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    let size = [300, 200];
    bake_heights(size, landscape(size, 2), &dir, &BakeSettings::default());
    let all_heights = || {
        let all = addresses(&manifest(&dir).file);
        all.into_iter()
            .map(|address| heights(&dir, address))
            .collect::<Vec<_>>()
    };
    let before = (all_heights(), manifest(&dir).index);
    rebake_densities(&dir, &varied()[1], &()).expect("it works");
    assert!(before == (all_heights(), manifest(&dir).index));
}

#[test]
fn a_rebake_that_fails_leaves_the_terrain_as_it_was() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    bake_heights(
        [400, 300],
        landscape([400, 300], 2),
        &dir,
        &BakeSettings::default(),
    );
    let bad = dir.join(tile_path(TileAddress::new(0, 1, 1)));
    let good = fs::read(&bad).expect("readable");
    let mut broken = good.clone();
    broken[500] ^= 1;
    fs::write(&bad, &broken).expect("writable");
    let before = contents(&dir);
    let error = rebake_densities(&dir, &varied()[1], &()).expect_err("a tile is broken");
    assert!(matches!(error, BakeError::Tile { .. }));
    let message = error.to_string();
    assert!(
        message.contains("1_1.tile") && message.contains("checksum"),
        "{message}"
    );
    assert!(contents(&dir) == before);
    assert_eq!(bake_support::entries(folder.path()), ["terrain"]);

    let error = rebake_densities(folder.path(), &varied()[0], &()).expect_err("no terrain");
    assert!(error.to_string().contains("no terrain"), "{error}");
    let too_much = DensitySettings {
        gain: 1e6,
        ..Default::default()
    };
    let error = rebake_densities(&dir, &too_much, &()).expect_err("out of range");
    assert!(error.to_string().contains("0.001..=1000"), "{error}");
    assert!(contents(&dir) == before);
}

/// Takes tiles of level 0 away, as a terrain has it whose fine data isn't everywhere.
fn without(dir: &Path, gone: impl Fn(TileAddress) -> bool) {
    let mut terrain: TerrainManifest = manifest(dir);
    let all: Vec<_> = terrain.index.iter().map(|(address, _)| address).collect();
    for &address in all.iter().filter(|&&address| gone(address)) {
        terrain.index.set(address, None);
        fs::remove_file(dir.join(tile_path(address))).expect("it was there");
    }
    for &address in &all {
        if terrain.index.get(address).is_some() {
            let children = address.children().into_iter().flatten();
            let range = children
                .filter_map(|child| terrain.index.get(child))
                .fold(heights(dir, address).range(), TileRange::union);
            terrain.index.set(address, Some(range));
        }
    }
    let index = terrain.index.encode();
    terrain.file.index_crc32 = crc32fast::hash(&index);
    fs::write(dir.join(INDEX_FILE), index).expect("writable");
    fs::write(
        dir.join(MANIFEST_FILE),
        ron::to_string(&terrain.file).expect("it can be told"),
    )
    .expect("writable");
}

#[test]
fn a_tile_without_finer_ones_gets_densities_from_its_own_heights() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    let size = [1025, 600];
    for density in varied() {
        let force = BakeSettings {
            force: true,
            density: density.clone(),
            ..Default::default()
        };
        bake_heights(size, landscape(size, 4), &dir, &force);
        let missing = |address: TileAddress| {
            address.level == 0 && (address.x / 2 == 1 || (address.x, address.z) == (5, 2))
        };
        let whole = |address| densities(&dir, address);
        let far = TileAddress::new(1, 3, 0);
        let before = whole(far);
        without(&dir, missing);
        rebake_densities(&dir, &density, &()).expect("it works");
        let report = verify(&dir, &|_| {}).expect("it can be read");
        assert!(report.faults.is_empty(), "{density:?}: {:?}", report.faults);
        let spreads_far = density.preprocess && density.filter_size > 8;
        let whole_far = whole(far);
        for at in 0..28 * 28 {
            let (x, z) = (4 + at % 28, at / 28);
            let unchanged = whole_far.get(x, z) == before.get(x, z);
            assert!(
                spreads_far || unchanged,
                "({x}, {z}) is far from what is missing"
            );
        }

        // Of the tile that has no finer one at all, texels that nothing spreads to.
        let file = manifest(&dir).file;
        let bare = TileAddress::new(1, 1, 0);
        let kernel = DensityKernel::new(&density, file.height_step_m, file.spacing_m, 1);
        let mut own = [0; 1024];
        tile_densities(
            &kernel,
            &DensityExtent::new(file.size, 1),
            [128, 0],
            heights(&dir, bare).samples(),
            &mut DensityScratch::default(),
            &mut own,
        );
        let stored = whole(bare);
        let plain = !density.preprocess || density.filter_size == 1;
        for (at, own) in own.into_iter().enumerate() {
            let (x, z) = (at as i32 % 32, at as i32 / 32);
            let found = stored.get(x, z);
            assert!(found >= own, "({x}, {z})");
            assert!(
                !plain || found == own,
                "({x}, {z}): {found} instead of {own}"
            );
        }
        assert!(own.iter().any(|&own| own > 0));
        // Of the tile that lacks one of four, three quarters are the finer ones' maximum.
        let three = whole(TileAddress::new(1, 2, 1));
        let finer = whole(TileAddress::new(0, 4, 2));
        let inside = (2..14).flat_map(|z| (2..14).map(move |x| (x, z)));
        for (x, z) in inside {
            let largest = (0..4)
                .map(|at| finer.get(2 * x + at % 2, 2 * z + at / 2))
                .max();
            assert_eq!(Some(three.get(x, z)), largest, "({x}, {z}), {density:?}");
        }
    }
}

#[test]
fn a_level_is_judged_by_its_own_spacing() {
    for filter in DensityFilter::ALL {
        for level in 0..8 {
            let of =
                |spacing_m, level| DensityKernel::new(&settings(filter), 0.02, spacing_m, level);
            let coarse = of(1.5, level);
            assert_eq!(coarse, of(1.5 * f64::from(1 << level), 0));
            let wanted = 0.02 / 1.5 / f64::from(1 << level);
            assert!((f64::from(coarse.step()) / wanted - 1.0).abs() < 1e-6);
        }
    }
    // However far apart steps and samples lie, products of heights stay finite.
    let cliffs = DensityKernel::new(&settings(DensityFilter::Mean), 1e6, 1e-4, 0);
    assert_eq!(cliffs.step(), 1000.0);
}

/// On the rim as inside, at every level: of a pyramid of planes no tile has any density, its own
/// heights being all that is looked at.
#[test]
fn planes_have_no_density_on_any_level_or_rim() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    let mut random = Lcg(21);
    for size in [[300, 200], [257, 131], [5, 3], [2, 9]] {
        for case in 0..6 {
            let steepness = [0.004, 0.1, 1.0][case % 3];
            let (x, z) = (random.signed() * steepness, random.signed() * steepness);
            let metres: Vec<f32> = (0..size[0] * size[1])
                .map(|at| f64::from(at % size[0]) * x + f64::from(at / size[0]) * z)
                .map(|height| height as f32)
                .collect();
            let force = BakeSettings {
                force: true,
                height_range_m: Some(-700.0..=700.0),
                ..Default::default()
            };
            bake_heights(size, metres, &dir, &force);
            let file = manifest(&dir).file;
            for address in addresses(&file) {
                for filter in DensityFilter::ALL {
                    let strong = DensitySettings {
                        gain: 1000.0,
                        ..settings(filter)
                    };
                    let (step_m, spacing_m) = (file.height_step_m, file.spacing_m);
                    let kernel = DensityKernel::new(&strong, step_m, spacing_m, address.level);
                    let mut found = [1; 1024];
                    tile_densities(
                        &kernel,
                        &DensityExtent::new(file.size, address.level),
                        [128 * address.x, 128 * address.z],
                        heights(&dir, address).samples(),
                        &mut DensityScratch::default(),
                        &mut found,
                    );
                    let bent = found.iter().position(|&density| density > 0);
                    assert_eq!(
                        bent, None,
                        "{filter}, {address} of {size:?}, slope {x}, {z}"
                    );
                }
            }
        }
    }
}

/// Rounding bends a plane by no more than the filters allow for, and sometimes by that much.
#[test]
fn the_rounding_noise_of_gaussian_curvature_is_reached() {
    let kernel = DensityKernel::new(
        &DensitySettings {
            gain: 1000.0,
            ..settings(DensityFilter::Gaussian)
        },
        0.5,
        1.0,
        0,
    );
    // A saddle of one step: up along x, down along z, and a quarter across.
    let saddle = |x: i32, z: i32| match (x - 64, z - 64) {
        (-1 | 1, 0) | (1, 1) => 101,
        (0, -1 | 1) => 99,
        _ => 100,
    };
    let found = tile(&kernel, saddle);
    let own = kernel.quantise(1.0625 * 0.25 / 1.3);
    assert_eq!(own, 0, "less than that on a slope counts for nothing");
    assert!(
        found.iter().any(|&density| density > 0),
        "what no plane can be is seen"
    );
}

/// A spike of the rim's ground is seen like any other, at every place of the rim.
#[test]
fn the_terrains_rim_is_seen() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    let size = [70, 45];
    for spike in [
        [0, 0],
        [0, 20],
        [33, 0],
        [69, 44],
        [69, 7],
        [12, 44],
        [0, 44],
        [1, 1],
    ] {
        let metres = (0..size[0] * size[1])
            .map(|at| {
                if [at % size[0], at / size[0]] == spike {
                    10.0
                } else {
                    5.0
                }
            })
            .collect();
        let force = BakeSettings {
            force: true,
            headroom_m: 0.0,
            ..Default::default()
        };
        bake_heights(size, metres, &dir, &force);
        let found = densities(&dir, TileAddress::new(0, 0, 0));
        let texel = spike.map(|at| (at / 4) as i32);
        let last = size.map(|side| (side - 2) as i32 / 4);
        let (x, z) = (texel[0].min(last[0]), texel[1].min(last[1]));
        let corner = spike
            .iter()
            .zip(size)
            .all(|(&at, side)| at == 0 || at == side - 1);
        // A corner's own ground goes on straight on two sides; its neighbours see it.
        let least = if corner { 20 } else { 128 };
        assert!(found.get(x, z) >= least, "{} at {spike:?}", found.get(x, z));
    }
}

/// What the guide says of walls: steps of one sample between flat ground, in sample spacings.
#[test]
fn walls_are_seen_by_the_second_differences_alone() {
    let wall = |filter, high: u16| {
        let kernel = DensityKernel::new(&settings(filter), 0.01, 1.0, 0);
        let found = tile(
            &kernel,
            |x, _| if x > 62 { 20_000 + 100 * high } else { 20_000 },
        );
        found[32 * 10 + 15]
    };
    for (filter, [low, middle, high]) in [
        (DensityFilter::SecondOrder, [212, 255, 255]),
        (DensityFilter::Gaussian, [0, 0, 0]),
        (DensityFilter::Mean, [180, 64, 0]),
        (DensityFilter::Principal, [234, 83, 0]),
        (DensityFilter::LaplaceBeltrami, [180, 120, 14]),
        (DensityFilter::LaplaceBeltramiVoronoi, [174, 114, 13]),
    ] {
        for (height, wanted) in [(1, low), (5, middle), (50, high)] {
            let found = i32::from(wall(filter, height));
            assert!(
                (found - wanted).abs() <= 8,
                "{filter}, {height}: {found} and not {wanted}"
            );
        }
    }
}

/// Hears when the new terrain is about to take the old one's place.
struct AtTheEnd<F>(F);

impl<F: Fn() + Sync> BakeProgress for AtTheEnd<F> {
    fn stage(&self, stage: BakeStage, _: u64) {
        if stage == BakeStage::Finish {
            (self.0)();
        }
    }
}

#[test]
fn a_terrain_that_was_replaced_meanwhile_is_left_alone() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    let size = [300, 200];
    bake_heights(size, landscape(size, 1), &dir, &BakeSettings::default());
    let replace = || {
        let force = BakeSettings {
            force: true,
            ..Default::default()
        };
        bake_heights(size, landscape(size, 2), &dir, &force);
    };
    let error = rebake_densities(&dir, &varied()[1], &AtTheEnd(replace)).expect_err("too late");
    assert!(matches!(error, BakeError::Replaced { .. }), "{error}");
    assert!(error.to_string().contains("run it again"), "{error}");
    let wanted = folder.path().join("wanted");
    bake_heights(size, landscape(size, 2), &wanted, &BakeSettings::default());
    assert!(contents(&dir) == contents(&wanted));
    assert_eq!(bake_support::entries(folder.path()), ["terrain", "wanted"]);
}

/// A terrain's folder may hold textures, notes, metadata.
#[cfg(unix)]
#[test]
fn whatever_else_lies_in_a_terrains_folder_stays() {
    use std::os::unix::fs::PermissionsExt;
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    let size = [140, 60];
    bake_heights(size, landscape(size, 1), &dir, &BakeSettings::default());
    let write = |name: &str| {
        let path = dir.join(name);
        fs::create_dir_all(path.parent().expect("it has one")).expect("writable");
        fs::write(path, name).expect("writable");
    };
    let all = ["README.txt", "textures/deep/albedo.png", "terrain.ron.meta"];
    all.into_iter().for_each(write);
    write("tile/0/0_0.tile.meta");
    std::os::unix::fs::symlink("README.txt", dir.join("link")).expect("writable");
    fs::set_permissions(&dir, fs::Permissions::from_mode(0o750)).expect("it is ours");
    let check = |names: &[&str]| {
        for &name in names {
            let found = fs::read_to_string(dir.join(name));
            assert_eq!(found.ok().as_deref(), Some(name), "{name} is lost");
        }
        assert!(fs::symlink_metadata(dir.join("link")).is_ok_and(|link| link.is_symlink()));
        let mode = fs::metadata(&dir).expect("it exists").permissions().mode();
        assert_eq!(mode & 0o777, 0o750);
    };
    rebake_densities(&dir, &varied()[1], &()).expect("it works");
    check(&all);
    check(&["tile/0/0_0.tile.meta"]);
    let force = BakeSettings {
        force: true,
        ..Default::default()
    };
    bake_heights(size, landscape(size, 2), &dir, &force);
    check(&all);
    assert_eq!(bake_support::entries(folder.path()), ["terrain"]);
}

#[cfg(unix)]
#[test]
fn densities_are_made_anew_by_any_name_of_the_folder() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    bake_heights(
        [140, 60],
        landscape([140, 60], 1),
        &dir,
        &BakeSettings::default(),
    );
    std::os::unix::fs::symlink(&dir, folder.path().join("link")).expect("writable");
    for (name, gain) in [
        ("link", 2.0),
        ("link/", 3.0),
        ("terrain/.", 4.0),
        ("terrain/", 5.0),
    ] {
        let density = DensitySettings {
            gain,
            ..Default::default()
        };
        let path = format!("{}/{name}", folder.path().display());
        rebake_densities(Path::new(&path), &density, &()).expect("it works");
        assert_eq!(manifest(&dir).file.density.gain, gain);
        assert_eq!(bake_support::entries(folder.path()), ["link", "terrain"]);
    }
}

/// A bake that was killed between its two renames has moved the old terrain aside.
#[cfg(target_os = "linux")]
#[test]
fn densities_of_a_terrain_that_a_killed_bake_moved_aside_are_made_anew() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    bake_heights(
        [140, 60],
        landscape([140, 60], 1),
        &dir,
        &BakeSettings::default(),
    );
    // No process has a number that large.
    let aside = folder.path().join(".terrain.tessera-old-999999999-0");
    fs::rename(&dir, aside).expect("it is ours");
    rebake_densities(&dir, &varied()[1], &()).expect("it works");
    assert_eq!(manifest(&dir).file.density, varied()[1]);
    assert_eq!(bake_support::entries(folder.path()), ["terrain"]);
}

#[test]
fn a_height_tile_that_is_missing_is_named_at_every_level() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    bake_heights(
        [400, 300],
        landscape([400, 300], 2),
        &dir,
        &BakeSettings::default(),
    );
    let levels = manifest(&dir).file.levels;
    for level in 0..levels {
        let path = dir.join(tile_path(TileAddress::new(level, 0, 0)));
        let bytes = fs::read(&path).expect("readable");
        fs::remove_file(&path).expect("writable");
        let error = rebake_densities(&dir, &varied()[0], &()).expect_err("it is missing");
        let message = error.to_string();
        assert!(
            message.starts_with(&path.display().to_string()),
            "{message}"
        );
        fs::write(&path, bytes).expect("writable");
    }
    assert_eq!(bake_support::entries(folder.path()), ["terrain"]);
}

#[test]
fn the_mean_density_is_that_of_the_finest_tiles_there_are() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    let size = [517, 300];
    bake_heights(size, landscape(size, 4), &dir, &BakeSettings::default());
    for gone in [false, true] {
        if gone {
            without(&dir, |address| address.level == 0 && address.x == 1);
        }
        let report = rebake_densities(&dir, &varied()[0], &()).expect("it works");
        let file = manifest(&dir).file;
        let texels = file.samples(0).map(bevy_tessera::density::texels_of);
        let (mut sum, mut count) = (0_u64, 0_u64);
        for (address, _) in manifest(&dir).index.iter().filter(|tile| tile.0.level == 0) {
            let tile = densities(&dir, address);
            for at in 0..1024_u32 {
                let (x, z) = (at % 32, at / 32);
                if 32 * address.x + x < texels[0] && 32 * address.z + z < texels[1] {
                    sum += u64::from(tile.get(x as i32, z as i32));
                    count += 1;
                }
            }
        }
        assert!((report.mean - sum as f64 / (255.0 * count as f64)).abs() < 1e-12);
    }
}

#[test]
fn settings_are_stored_with_the_terrain() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for (number, density) in varied().into_iter().enumerate() {
        let dir = folder.path().join(number.to_string());
        let settings = BakeSettings {
            density: density.clone(),
            ..Default::default()
        };
        bake_heights([40, 40], landscape([40, 40], 1), &dir, &settings);
        assert_eq!(manifest(&dir).file.density, density);
        // A manifest that somebody wrote by hand is refused as well.
        let path = dir.join(MANIFEST_FILE);
        let text = fs::read_to_string(&path).expect("readable");
        let found = format!("filter_size: {}", density.filter_size);
        assert!(text.contains(&found), "{text}");
        fs::write(&path, text.replace(&found, "filter_size: 77")).expect("writable");
        let error = TerrainManifest::read(&dir).expect_err("77 is too much");
        assert!(error.to_string().contains("1..=32"), "{error}");
    }
}

#[test]
fn names_of_filters_and_borders_are_read_as_they_are_written() {
    for filter in DensityFilter::ALL {
        assert_eq!(filter.to_string().parse(), Ok(filter));
    }
    for border in DensityBorder::ALL {
        assert_eq!(border.to_string().parse(), Ok(border));
    }
    let error = "sobel".parse::<DensityFilter>().expect_err("there is none");
    for filter in DensityFilter::ALL {
        assert!(error.to_string().contains(filter.name()), "{error}");
    }
}
