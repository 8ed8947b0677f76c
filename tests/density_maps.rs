//! Densities are what they promise: the same on every machine, never rounded down, blind to the
//! steps of stored heights, seeing a spike wherever it stands and the terrain's rim, alike at any
//! resolution.
#![cfg(feature = "generate")]

mod bake_support;

use bake_support::{addresses, bake_heights, densities, heights, manifest};
use bevy_tessera::bake::generate::{GenerateSettings, GeneratedSource, GeneratorKind};
use bevy_tessera::bake::{BakeSettings, bake, rebake_densities};
use bevy_tessera::density::curvature::Ring;
use bevy_tessera::density::{
    DensityBorder, DensityExtent, DensityFilter, DensityKernel, DensityScratch, DensitySettings,
    DensityWindow, tile_densities,
};
use bevy_tessera::tile::TileAddress;
use proptest::prelude::*;
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
