//! Generated terrains: the same on every platform and any number of threads, within their relief,
//! as rough as they were told to be, and fit to be baked.

mod bake_support;

use bake_support::read_all;
use bevy_tessera::bake::generate::{
    GenerateError, GenerateSettings, GeneratedSource, GeneratorKind, MAX_DIAMOND_SQUARE_SIZE,
};
use bevy_tessera::bake::{BakeSettings, HeightSource, bake, verify};
use proptest::prelude::*;

const NOISES: [GeneratorKind; 3] = [
    GeneratorKind::Fbm,
    GeneratorKind::Ridged,
    GeneratorKind::Hybrid,
];

/// Ground with several features across even a small terrain.
fn settings(kind: GeneratorKind, size: [u32; 2]) -> GenerateSettings {
    GenerateSettings {
        seed: 7,
        relief_m: 100.0,
        wavelength_m: 64.0,
        ..GenerateSettings::new(kind, size)
    }
}

fn heights(settings: &GenerateSettings) -> Vec<f32> {
    let mut source = GeneratedSource::new(settings.clone()).expect("good settings");
    read_all(&mut source).expect("readable")
}

fn bits(heights: &[f32]) -> Vec<u32> {
    heights.iter().map(|height| height.to_bits()).collect()
}

fn at(heights: &[f32], settings: &GenerateSettings, x: u32, z: u32) -> f32 {
    heights[z as usize * settings.size[0] as usize + x as usize]
}

/// The mean of how much heights bend from sample to sample along both axes.
fn bend(settings: &GenerateSettings) -> f64 {
    let heights = heights(settings);
    let [width, height] = settings.size;
    let mut sum = 0.0;
    for z in 1..height - 1 {
        for x in 1..width - 1 {
            let [west, here, east, north, south] =
                [(x - 1, z), (x, z), (x + 1, z), (x, z - 1), (x, z + 1)]
                    .map(|(x, z)| f64::from(at(&heights, settings, x, z)));
            sum += (west - 2.0 * here + east).abs() + (north - 2.0 * here + south).abs();
        }
    }
    sum / f64::from((width - 2) * (height - 2))
}

fn refusal(change: impl FnOnce(&mut GenerateSettings)) -> String {
    let mut settings = settings(GeneratorKind::Fbm, [65, 65]);
    change(&mut settings);
    let found = GeneratedSource::new(settings.clone());
    let error = found.expect_err(&format!("{settings:?} should be refused"));
    let sentence = error.to_string();
    assert!(
        !sentence.contains('\n') && !sentence.ends_with('.'),
        "{sentence}"
    );
    sentence
}

/// A platform whose arithmetic differs is caught here. Whoever changes how ground is made changes
/// every terrain that was ever made from a seed, and has to say so in the changelog.
#[test]
fn heights_are_these_to_the_last_bit() {
    let points = [(0, 0), (17, 5), (100, 99), (3, 128), (128, 128)];
    let wanted = [
        (
            GeneratorKind::DiamondSquare,
            false,
            [
                0x417a_01b2,
                0x4251_9cb4,
                0x42ab_1375,
                0x41fd_34f6,
                0x42bb_72a7,
            ],
        ),
        (
            GeneratorKind::DiamondSquare,
            true,
            [
                0x0000_0000,
                0x4226_2a28,
                0x42a1_1ebf,
                0x4115_901d,
                0x0000_0000,
            ],
        ),
        (
            GeneratorKind::Fbm,
            false,
            [
                0x424a_d731,
                0x41b8_e7a8,
                0x4268_7363,
                0x4270_cd35,
                0x426b_79bb,
            ],
        ),
        (
            GeneratorKind::Fbm,
            true,
            [
                0x424a_d731,
                0x41b5_e402,
                0x4216_f5e4,
                0x422c_a27f,
                0x424a_d731,
            ],
        ),
        (
            GeneratorKind::Ridged,
            false,
            [
                0x421f_2620,
                0x40ee_31cf,
                0x4245_3c4e,
                0x4235_9b97,
                0x4277_5318,
            ],
        ),
        (
            GeneratorKind::Ridged,
            true,
            [
                0x421f_2620,
                0x40db_4f9c,
                0x4245_7ed2,
                0x420b_9a95,
                0x421f_2620,
            ],
        ),
        (
            GeneratorKind::Hybrid,
            false,
            [
                0x4275_d0c7,
                0x4220_df36,
                0x4265_1212,
                0x419e_8631,
                0x4215_a1da,
            ],
        ),
        (
            GeneratorKind::Hybrid,
            true,
            [
                0x4275_d0c7,
                0x4221_1950,
                0x4293_27d0,
                0x424a_df30,
                0x4275_d0c7,
            ],
        ),
    ];
    let mut found = Vec::new();
    for kind in GeneratorKind::ALL {
        for wrap in [false, true] {
            let settings = GenerateSettings {
                wrap,
                ..settings(kind, [129, 129])
            };
            let heights = heights(&settings);
            let here = points.map(|(x, z)| at(&heights, &settings, x, z).to_bits());
            found.push((kind, wrap, here));
        }
    }
    assert_eq!(found, wanted, "{found:#010x?}");
}

#[test]
fn the_same_seed_gives_the_same_ground_on_any_number_of_threads() {
    for kind in GeneratorKind::ALL {
        for wrap in [false, true] {
            let settings = GenerateSettings {
                wrap,
                ..settings(kind, [257, 257])
            };
            let made = [1, 2, 5].map(|threads| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
                let pool = pool.expect("a pool of threads");
                pool.install(|| bits(&heights(&settings)))
            });
            assert_eq!(made[0], made[1], "{kind}");
            assert_eq!(made[0], made[2], "{kind}");
        }
    }
}

#[test]
fn a_source_gives_the_same_heights_at_every_reading() {
    for kind in GeneratorKind::ALL {
        // More rows than are made ahead at once.
        let settings = settings(kind, [4099, 300]);
        let mut source = GeneratedSource::new(settings).expect("good settings");
        let first = bits(&read_all(&mut source).expect("readable"));
        let mut row = vec![0.0; 4099];
        assert!(source.read_row(&mut row).is_err(), "{kind} has no row 300");
        source.rewind().expect("back at the first row");
        for _ in 0..7 {
            source.read_row(&mut row).expect("readable");
        }
        assert_eq!(bits(&row), first[6 * 4099..7 * 4099], "{kind}");
        source.rewind().expect("back at the first row");
        assert_eq!(
            bits(&read_all(&mut source).expect("readable")),
            first,
            "{kind}"
        );
        source.rewind().expect("back at the first row");
        let error = source
            .read_row(&mut row[1..])
            .expect_err("one sample too few");
        assert!(error.to_string().contains("4099"), "{error}");
    }
}

/// Neighbouring seeds, and seeds that differ in bits that an `i32` doesn't have, share nothing.
#[test]
fn another_seed_gives_another_ground() {
    for kind in GeneratorKind::ALL {
        let with_seed = |seed| {
            let settings = GenerateSettings {
                seed,
                octaves: 1,
                ..settings(kind, [129, 129])
            };
            let heights = heights(&settings);
            let mean = heights.iter().sum::<f32>() / heights.len() as f32;
            heights
                .into_iter()
                .map(|height| height - mean)
                .collect::<Vec<_>>()
        };
        let product = |a: &[f32], b: &[f32]| -> f32 { a.iter().zip(b).map(|(a, b)| a * b).sum() };
        let seeds = [7, 8, 6, 7 + (1 << 32), 7 + (1 << 63)].map(with_seed);
        for (number, other) in seeds.iter().enumerate().skip(1) {
            let likeness = product(&seeds[0], other)
                / (product(&seeds[0], &seeds[0]) * product(other, other)).sqrt();
            // Diamond-square's largest feature is the whole terrain: two can resemble each other.
            let limit = if kind == GeneratorKind::DiamondSquare {
                0.9
            } else {
                0.5
            };
            assert!(likeness.abs() < limit, "{kind}, seed {number}: {likeness}");
        }
    }
}

#[test]
fn heights_spread_over_the_relief_and_not_beyond() {
    for kind in GeneratorKind::ALL {
        for (roughness, octaves) in [(0.0, 3), (0.5, 10), (1.1, 10), (2.0, 10), (4.0, 1)] {
            let settings = GenerateSettings {
                roughness,
                octaves,
                wavelength_m: 32.0,
                ..settings(kind, [257, 257])
            };
            let heights = heights(&settings);
            let low = heights.iter().copied().fold(f32::INFINITY, f32::min);
            let high = heights.iter().copied().fold(f32::NEG_INFINITY, f32::max);
            assert!(low >= 0.0 && high <= 100.0, "{settings:?}: {low}..{high} m");
            let least = if kind == GeneratorKind::DiamondSquare {
                99.99
            } else {
                50.0
            };
            assert!(high - low >= least, "{settings:?}: {low}..{high} m");
        }
    }
}

/// At the largest roughness the last displacements are too small to be seen, and what is left are
/// the means of the lecture: of four corners, of four neighbours, of three at an edge.
#[test]
fn diamond_square_takes_the_means_of_the_right_neighbours() {
    for wrap in [false, true] {
        let settings = GenerateSettings {
            wrap,
            roughness: 4.0,
            ..settings(GeneratorKind::DiamondSquare, [513, 513])
        };
        let heights = heights(&settings);
        let at = |x: i64, z: i64| -> Option<f32> {
            let inside = |k: i64| match k {
                0..=512 => Some(k as u32),
                _ if wrap => Some(k.rem_euclid(512) as u32),
                _ => None,
            };
            Some(at(&heights, &settings, inside(x)?, inside(z)?))
        };
        for step in [1, 2, 4] {
            for (x, z) in (0..=512 / step).flat_map(|z| (0..=512 / step).map(move |x| (x, z))) {
                let neighbours = match (x % 2, z % 2) {
                    (0, 0) => continue,
                    (1, 1) => [(-1, -1), (1, -1), (-1, 1), (1, 1)],
                    _ => [(-1, 0), (1, 0), (0, -1), (0, 1)],
                };
                let neighbours = neighbours.map(|(u, v)| at((x + u) * step, (z + v) * step));
                let found: Vec<f32> = neighbours.into_iter().flatten().collect();
                let mean = found.iter().sum::<f32>() / found.len() as f32;
                let height = at(x * step, z * step).expect("inside");
                let place = format!("wrap {wrap}, step {step}, ({x}, {z})");
                assert!((height - mean).abs() < 1e-4, "{place}: {height} and {mean}");
            }
        }
    }
}

#[test]
fn terrain_that_wraps_goes_on_smoothly_at_the_opposite_edge() {
    for kind in GeneratorKind::ALL {
        for size in [[129, 129], [200, 90]] {
            let diamond_square = kind == GeneratorKind::DiamondSquare;
            if diamond_square && size[0] != size[1] {
                continue;
            }
            let settings = GenerateSettings {
                wrap: true,
                // Smooth enough for a seam to stand out; diamond-square then has peaks and creases
                // where its largest squares meet, and so at the seam.
                roughness: if diamond_square { 1.0 } else { 1.6 },
                ..settings(kind, size)
            };
            let heights = heights(&settings);
            let at = |x: u32, z: u32| at(&heights, &settings, x, z);
            let [east, south] = size.map(|samples| samples - 1);
            for z in 0..=south {
                assert_eq!(at(0, z).to_bits(), at(east, z).to_bits(), "{kind}, row {z}");
            }
            for x in 0..=east {
                assert_eq!(
                    at(x, 0).to_bits(),
                    at(x, south).to_bits(),
                    "{kind}, column {x}"
                );
            }
            let line_bend = |line: [(u32, u32); 3]| {
                let [before, here, after] = line.map(|(x, z)| at(x, z));
                (before - 2.0 * here + after).abs()
            };
            let columns = |x: u32| -> f32 {
                let next = if x == east { 1 } else { x + 1 };
                let bends = (0..=south).map(|z| line_bend([(x - 1, z), (x, z), (next, z)]));
                bends.sum()
            };
            let rows = |z: u32| -> f32 {
                let next = if z == south { 1 } else { z + 1 };
                let bends = (0..=east).map(|x| line_bend([(x, z - 1), (x, z), (x, next)]));
                bends.sum()
            };
            // How much the ground bends at the seam, and how much it may.
            let limit = |bends: Vec<f32>| {
                if diamond_square {
                    1.5 * bends.into_iter().fold(0.0, f32::max)
                } else {
                    2.0 * bends.iter().sum::<f32>() / bends.len() as f32
                }
            };
            let most = limit((1..east).map(columns).collect());
            assert!(columns(east) < most, "{kind}: {} and {most}", columns(east));
            let most = limit((1..south).map(rows).collect());
            assert!(rows(south) < most, "{kind}: {} and {most}", rows(south));
        }
    }
}

#[test]
fn a_larger_noise_shows_the_same_ground_and_more() {
    for kind in NOISES {
        let (small, large) = (settings(kind, [65, 40]), settings(kind, [301, 77]));
        let (few, many) = (heights(&small), heights(&large));
        for z in 0..40 {
            for x in 0..65 {
                assert_eq!(
                    at(&few, &small, x, z),
                    at(&many, &large, x, z),
                    "{kind} ({x}, {z})"
                );
            }
        }
    }
}

#[test]
fn a_finer_noise_shows_the_same_ground() {
    for kind in NOISES {
        let coarse = GenerateSettings {
            octaves: 5,
            ..settings(kind, [65, 40])
        };
        let fine = GenerateSettings {
            spacing_m: 0.5,
            size: [129, 79],
            ..coarse.clone()
        };
        let (few, many) = (heights(&coarse), heights(&fine));
        for z in 0..40 {
            for x in 0..65 {
                let (one, other) = (at(&few, &coarse, x, z), at(&many, &fine, 2 * x, 2 * z));
                assert!(
                    (one - other).abs() < 1e-3,
                    "{kind} ({x}, {z}): {one} and {other}"
                );
            }
        }
    }
}

#[test]
fn more_roughness_makes_smoother_ground() {
    for kind in GeneratorKind::ALL {
        let bends = [0.2, 0.6, 1.0, 1.4, 1.8].map(|roughness| {
            bend(&GenerateSettings {
                roughness,
                ..settings(kind, [257, 257])
            })
        });
        for pair in bends.windows(2) {
            assert!(pair[1] < 0.9 * pair[0], "{kind}: {bends:?}");
        }
    }
}

/// Octaves whose zeros met, at the origin for instance, would leave a mark there on every ground.
#[test]
fn no_place_looks_the_same_on_every_ground() {
    for kind in GeneratorKind::ALL {
        let corners: Vec<f32> = (0..40)
            .map(|seed| {
                let settings = GenerateSettings {
                    seed,
                    ..settings(kind, [33, 33])
                };
                heights(&settings)[0]
            })
            .collect();
        let mean = corners.iter().sum::<f32>() / 40.0;
        let spread = corners
            .iter()
            .map(|height| (height - mean).abs())
            .sum::<f32>()
            / 40.0;
        assert!(spread > 5.0, "{kind}: {corners:?}");
    }
}

#[test]
fn every_kind_bakes_into_a_good_terrain() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for kind in GeneratorKind::ALL {
        for wrap in [false, true] {
            let size = if wrap { [257, 257] } else { [400, 291] };
            let settings = GenerateSettings {
                wrap,
                spacing_m: 2.5,
                ..settings(kind, size)
            };
            let mut source = GeneratedSource::new(settings).expect("good settings");
            assert_eq!(source.name().split(' ').next(), Some(kind.as_str()));
            assert!(source.name().ends_with(", seed 7"), "{}", source.name());
            let out = folder.path().join(format!("{kind}-{wrap}"));
            let report = bake(&mut source, &out, &BakeSettings::default(), &()).expect("bakes");
            assert_eq!((report.size, report.spacing_m), (size, 2.5));
            assert_eq!((report.filled, report.clamped), (0, 0));
            let verified = verify(&out, &|_| ()).expect("the manifest is good");
            assert!(
                verified.tiles > 0 && verified.faults.is_empty(),
                "{verified:?}"
            );
        }
    }
}

#[test]
fn kinds_are_read_as_they_are_written() {
    for kind in GeneratorKind::ALL {
        assert_eq!(kind.to_string().parse(), Ok(kind));
    }
    let error = "Perlin\n"
        .parse::<GeneratorKind>()
        .expect_err("no such kind")
        .to_string();
    assert!(error.contains("\"Perlin\\n\""), "{error}");
    for kind in GeneratorKind::ALL {
        assert!(error.contains(kind.as_str()), "{error}");
    }
}

#[test]
fn parameters_out_of_range_are_refused_by_name_and_range() {
    let says = |sentence: String, words: &[&str]| {
        for word in words {
            assert!(sentence.contains(word), "{sentence} ({word})");
        }
    };
    for size in [[1, 65], [65, 0], [(1 << 24) + 1, 65], [1 << 24, 1 << 24]] {
        let sentence = refusal(|s| s.size = size);
        says(
            sentence,
            &[
                "size",
                &size[0].to_string(),
                &size[1].to_string(),
                "2 to 16777216",
            ],
        );
    }
    for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, -1.0, 1e300] {
        let found = format!("{value:?}");
        says(
            refusal(|s| s.spacing_m = value),
            &["spacing", &found, "0.0001 and 1000000 m"],
        );
        says(
            refusal(|s| s.relief_m = value),
            &["relief", &found, "0 and 1000000 m"],
        );
        let sentence = refusal(|s| s.wavelength_m = value);
        says(sentence, &["wavelength", &found, "2.0 m", "1000000000 m"]);
        says(
            refusal(|s| s.roughness = value),
            &["roughness", &found, "0 and 4"],
        );
    }
    says(refusal(|s| s.spacing_m = 0.0), &["spacing", "0.0"]);
    says(
        refusal(|s| s.wavelength_m = 1.99),
        &["wavelength", "1.99", "2.0 m"],
    );
    says(
        refusal(|s| s.spacing_m = 100.0),
        &["wavelength", "64.0", "200.0 m"],
    );
    says(
        refusal(|s| s.roughness = 4.001),
        &["roughness", "4.001", "0 and 4"],
    );
    says(refusal(|s| s.octaves = 0), &["octaves", "0", "1 and 32"]);
    says(refusal(|s| s.octaves = 33), &["octaves", "33", "1 and 32"]);

    for size in [[100, 100], [129, 65], [128, 128]] {
        let sentence = refusal(|s| {
            (s.kind, s.size, s.wrap) = (GeneratorKind::DiamondSquare, size, true);
        });
        says(sentence, &["wrap", &size[0].to_string(), "2^n + 1"]);
    }
    let side = MAX_DIAMOND_SQUARE_SIZE + 1;
    let large = |s: &mut GenerateSettings| {
        (s.kind, s.size) = (GeneratorKind::DiamondSquare, [2, side]);
    };
    let words = ["2 x 16386", "memory", "16385", "fbm", "ridged", "hybrid"];
    says(refusal(large), &words);
    let mut settings = settings(GeneratorKind::Fbm, [2, side]);
    assert_eq!(settings.validate(), Ok(()));
    settings.kind = GeneratorKind::DiamondSquare;
    assert_eq!(
        settings.validate(),
        Err(GenerateError::TooLarge { found: [2, side] })
    );
}

#[test]
fn the_settings_of_every_kind_are_good() {
    for kind in GeneratorKind::ALL {
        for size in [[2, 2], [1025, 1025], [4097, 2]] {
            assert_eq!(GenerateSettings::new(kind, size).validate(), Ok(()));
        }
        // Whatever is asked for, nobody panics before the size is checked.
        for size in [[0, 0], [u32::MAX, u32::MAX]] {
            assert!(GenerateSettings::new(kind, size).validate().is_err());
        }
    }
    assert_eq!(GenerateSettings::default().validate(), Ok(()));
}

/// Numbers of all magnitudes in a range.
fn magnitude(low: f64, high: f64) -> impl Strategy<Value = f64> {
    (low.ln()..=high.ln()).prop_map(move |log| log.exp().clamp(low, high))
}

fn any_kind() -> impl Strategy<Value = GeneratorKind> {
    prop::sample::select(GeneratorKind::ALL.as_slice())
}

fn any_good_settings() -> impl Strategy<Value = GenerateSettings> {
    let ground = (any_kind(), [2_u32..150, 2_u32..150], any::<u64>(), 0_u32..8);
    let spacing_m = magnitude(1e-4, 1e6);
    let relief_m = prop_oneof![Just(0.0), magnitude(1e-9, 1e6)];
    let ranges = (
        spacing_m,
        relief_m,
        0.0..=1.0,
        1_u32..=32,
        0.0..=4.0,
        any::<bool>(),
    );
    (ground, ranges).prop_map(|((kind, size, seed, log), ranges)| {
        let (spacing_m, relief_m, length, octaves, roughness, wrap) = ranges;
        let shortest: f64 = 2.0 * spacing_m;
        let square = kind == GeneratorKind::DiamondSquare && wrap;
        GenerateSettings {
            kind,
            size: if square { [(1 << log) + 1; 2] } else { size },
            seed,
            spacing_m,
            relief_m,
            wavelength_m: (shortest * (1e9 / shortest).powf(length)).clamp(shortest, 1e9),
            octaves,
            roughness,
            wrap,
        }
    })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]

    #[test]
    fn good_settings_give_finite_heights_within_the_relief(settings in any_good_settings()) {
        let relief_m = settings.relief_m as f32;
        let mut source = GeneratedSource::new(settings).expect("good settings");
        for height in read_all(&mut source).expect("readable") {
            prop_assert!((0.0..=relief_m).contains(&height), "{}", height);
        }
    }

    #[test]
    fn any_settings_at_all_are_refused_or_give_finite_heights(
        kind in any_kind(),
        size in [0_u32..70, 0_u32..70],
        seed in any::<u64>(),
        numbers in any::<[f64; 4]>(),
        octaves in any::<u32>(),
        wrap in any::<bool>(),
    ) {
        let good = settings(kind, [9, 9]);
        // One bad number would hide the others: each is tried among good ones, and then all.
        for bad in 0..6 {
            let number = |at: usize, good: f64| {
                if bad == at || bad == 5 { numbers[at] } else { good }
            };
            let settings = GenerateSettings {
                size,
                seed,
                spacing_m: number(0, good.spacing_m),
                relief_m: number(1, good.relief_m),
                wavelength_m: number(2, good.wavelength_m),
                roughness: number(3, good.roughness),
                octaves: if bad >= 4 { octaves } else { good.octaves },
                wrap,
                ..good.clone()
            };
            if let Ok(mut source) = GeneratedSource::new(settings) {
                for height in read_all(&mut source).expect("readable") {
                    prop_assert!(height.is_finite());
                }
            }
        }
    }

    #[test]
    fn no_size_panics(kind in any_kind(), size in any::<[u32; 2]>(), wrap in any::<bool>()) {
        let mut settings = GenerateSettings::new(kind, size);
        settings.wrap = wrap;
        let _ = GeneratedSource::new(settings);
    }
}

/// The far end of a very wide terrain: positions still have digits to spare, and so ground that is
/// smooth bends four times as much over twice the distance.
#[test]
fn the_far_end_of_a_wide_terrain_is_smooth() {
    let settings = GenerateSettings {
        octaves: 1,
        // No power of two, whose positions would be short binary fractions.
        wavelength_m: 61.3,
        ..settings(GeneratorKind::Fbm, [1 << 20, 2])
    };
    let mut row = vec![0.0; 1 << 20];
    let mut source = GeneratedSource::new(settings).expect("good settings");
    source.read_row(&mut row).expect("readable");
    let far = &row[row.len() - 20_000..];
    let bend = |step: usize| -> f64 {
        let bends = far
            .windows(2 * step + 1)
            .map(|w| w[0] - 2.0 * w[step] + w[2 * step]);
        bends.map(|bend| f64::from(bend.abs())).sum()
    };
    let ratio = bend(2) / bend(1);
    assert!((3.5..4.5).contains(&ratio), "{ratio}");
}
