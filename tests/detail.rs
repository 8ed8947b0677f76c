//! Detail displacement: continuous, within its bounds, as its rules say, fading with the spacing of
//! vertices, with the slope that its gradient says, and the same for the same input.

mod common;

use bevy_tessera::detail::{
    DETAIL_OCTAVES, DetailKernel, DetailOctave, DetailRule, TerrainDetail, TerrainDetailError,
};
use bevy_tessera::lattice::{Lattice, ONE};
use bevy_tessera::tessellate::DENSITY_ONE;
use common::random::Random;
use glam::{IVec2, Vec2};

const EVERYTHING: i32 = DetailKernel::EVERYTHING;

fn lattice() -> Lattice {
    Lattice::new([4097, 4097], 6, 0, 8).unwrap()
}

fn everywhere() -> TerrainDetail {
    TerrainDetail {
        rule: DetailRule::Everywhere,
        ..TerrainDetail::default()
    }
}

/// On samples a metre apart.
fn kernel(settings: &TerrainDetail) -> DetailKernel {
    settings.validate().unwrap();
    DetailKernel::new(settings, &lattice(), 1.0)
}

/// Anywhere on the terrain, and as far outside of it.
fn anywhere(random: &mut Random) -> IVec2 {
    let extent = lattice().extent.x;
    IVec2::new(
        random.below(3 * extent) - extent,
        random.below(3 * extent) - extent,
    )
}

/// No octave rises by more than this many of its amplitudes a wavelength.
const STEEPEST: f32 = 5.7;

fn wavelength_units(octave: &DetailOctave) -> f32 {
    (1_u32 << octave.cell_shift) as f32 / 65.0
}

#[test]
fn a_unit_further_the_ground_is_hardly_higher() {
    let kernel = kernel(&everywhere());
    let steepest_m: f32 = kernel
        .octaves()
        .iter()
        .map(|octave| STEEPEST * octave.amplitude_m / wavelength_units(octave))
        .sum();
    let check = |p: IVec2| {
        let here = kernel.height_m(p, 1.0, EVERYTHING);
        for step in [IVec2::X, IVec2::Y, IVec2::NEG_X, IVec2::NEG_Y] {
            let there = kernel.height_m(p + step, 1.0, EVERYTHING);
            assert!(
                (there - here).abs() <= steepest_m + 1e-6,
                "{p} {step}: {here} {there}"
            );
        }
    };
    let mut random = Random(1);
    for _ in 0..20_000 {
        check(anywhere(&mut random));
    }
    // Long enough for many borders of cells, through the corner and where products wrap.
    for from in [IVec2::splat(-40_000), IVec2::new(1 << 30, -(1 << 30))] {
        for along in [IVec2::new(1, 1), IVec2::new(1, 0)] {
            (0..80_000).for_each(|i| check(from + along * i));
        }
    }
}

#[test]
fn crossing_a_border_of_cells_bends_nothing() {
    // One octave with its border known: the turned point's whole cells change.
    let kernel = kernel(&TerrainDetail {
        octaves: 1,
        ..everywhere()
    });
    let octave = kernel.octaves()[0];
    let turned = |p: IVec2| -> [u32; 2] {
        let [a, b] = octave.turn.map(i64::from);
        let (x, z) = (i64::from(p.x), i64::from(p.y));
        let [x, z] = [a * x - b * z, b * x + a * z];
        [
            (x + i64::from(octave.offset[0])) as u32 >> octave.cell_shift,
            (z + i64::from(octave.offset[1])) as u32 >> octave.cell_shift,
        ]
    };
    let wave = wavelength_units(&octave);
    let (mut crossed, mut wrapped) = (0, 0);
    // Far enough for the cells to wrap, after 2^32 / 65 units in their own direction.
    for i in 0..10_000 {
        let (from, to) = (IVec2::new(i * 8_192, 77), IVec2::new((i + 1) * 8_192, 77));
        let (mut low, mut high) = (from, to);
        if turned(low) == turned(high) {
            continue;
        }
        while high.x - low.x > 1 {
            let middle = IVec2::new(i32::midpoint(low.x, high.x), 77);
            if turned(middle) == turned(from) {
                low = middle;
            } else {
                high = middle;
            }
        }
        crossed += 1;
        let (before, after) = (turned(low), turned(high));
        wrapped += i32::from((0..2).any(|axis| before[axis].abs_diff(after[axis]) > 1));
        let [here, there] = [low, high].map(|p| kernel.height_m(p, 1.0, EVERYTHING));
        assert!((here - there).abs() <= STEEPEST * octave.amplitude_m / wave + 1e-7);
        let [here, there] =
            [low, high].map(|p| kernel.gradient(p, 1.0, EVERYTHING) * kernel.unit_m);
        // Slopes go on as well: no more bend than anywhere else.
        let most = octave.amplitude_m * 40.0 / (wave * wave);
        assert!(here.distance(there) < most + 1e-9, "{low}: {here} {there}");
    }
    assert!(crossed > 2_000 && wrapped > 0, "{crossed} {wrapped}");
}

#[test]
fn it_stays_within_its_amplitude_and_uses_some_of_it() {
    for settings in [
        everywhere(),
        TerrainDetail {
            octaves: 1,
            ..everywhere()
        },
        TerrainDetail {
            gain: 1.0,
            octaves: 8,
            amplitude_m: 100.0,
            ..everywhere()
        },
    ] {
        let kernel = kernel(&settings);
        assert_eq!(kernel.bound_m(), settings.amplitude_m);
        let mut random = Random(2);
        let mut most = 0.0_f32;
        let (mut sum, mut squares) = (0.0_f64, 0.0_f64);
        let count = 100_000;
        for _ in 0..count {
            let height = kernel.height_m(anywhere(&mut random), 1.0, EVERYTHING);
            most = most.max(height.abs());
            sum += f64::from(height);
            squares += f64::from(height) * f64::from(height);
        }
        let amplitude = f64::from(settings.amplitude_m);
        let (mean, rms) = (sum / f64::from(count), (squares / f64::from(count)).sqrt());
        println!(
            "{} octaves, gain {}: mean {:.4}, rms {:.3}, most {:.3} of the amplitude",
            settings.octaves,
            settings.gain,
            mean / amplitude,
            rms / amplitude,
            f64::from(most) / amplitude
        );
        assert!(most <= kernel.bound_m());
        assert!(f64::from(most) > 0.4 * amplitude);
        assert!(mean.abs() < 0.01 * amplitude);
        assert!((0.08..0.5).contains(&(rms / amplitude)));
    }
}

#[test]
fn all_directions_are_alike() {
    let kernel = kernel(&everywhere());
    // How much the ground differs some distance away, by direction.
    for distance in [200.0_f32, 1_000.0, 5_000.0] {
        let differences: Vec<f64> = (0..12)
            .map(|i| {
                let angle = i as f32 * std::f32::consts::PI / 12.0;
                let away = (Vec2::from_angle(angle) * distance).round().as_ivec2();
                let mut random = Random(3);
                (0..20_000)
                    .map(|_| {
                        let p = anywhere(&mut random);
                        let [a, b] = [p, p + away].map(|p| kernel.height_m(p, 1.0, EVERYTHING));
                        f64::from(a - b).powi(2)
                    })
                    .sum::<f64>()
            })
            .collect();
        let most = differences.iter().copied().fold(0.0, f64::max);
        let least = differences.iter().copied().fold(f64::MAX, f64::min);
        println!("{distance} units: {:.3}", most / least);
        assert!(most / least < 1.15, "{distance}: {differences:?}");
    }
}

#[test]
fn octaves_add_up_and_those_that_do_not_fit_are_dropped() {
    for (amplitude_m, gain, octaves) in
        [(0.4, 0.5, 6), (0.3, 0.7, 8), (100.0, 1.0, 7), (0.1, 0.0, 3)]
    {
        let kernel = kernel(&TerrainDetail {
            amplitude_m,
            gain,
            octaves,
            ..everywhere()
        });
        let each = || kernel.octaves().iter().map(|octave| octave.amplitude_m);
        assert_eq!(kernel.octave_count, octaves);
        assert_eq!(each().sum::<f32>(), amplitude_m);
        assert_eq!(each().rev().sum::<f32>(), amplitude_m);
        for (coarse, fine) in each().zip(each().skip(1)) {
            assert!((fine - coarse * gain).abs() <= 1e-6 * amplitude_m);
        }
        for (coarse, fine) in kernel.octaves().iter().zip(&kernel.octaves()[1..]) {
            assert_eq!(coarse.cell_shift, fine.cell_shift + 1);
            assert_eq!(fine.per_cell * (1_u32 << fine.cell_shift) as f32, 1.0);
        }
        for rest in &kernel.octaves[octaves as usize..] {
            assert_eq!(*rest, DetailOctave::default());
        }
    }
    // 6 m are 24 576 units: the nearest power of two is 2^15, 2^14.58 in fact.
    assert_eq!(kernel(&everywhere()).octaves()[0].cell_shift, 15 + 6);
    // A wavelength of 41 units leaves room for 32, 16, 8 and 4.
    let fine = kernel(&TerrainDetail {
        wavelength_m: 0.01,
        octaves: 8,
        ..everywhere()
    });
    assert_eq!(fine.octave_count, 4);
    assert_eq!(fine.octaves()[3].cell_shift, 2 + 6);
    let coarse = kernel(&TerrainDetail {
        wavelength_m: 10_000.0,
        ..everywhere()
    });
    assert_eq!(coarse.octaves()[0].cell_shift, 20 + 6);
    // Off.
    let off = kernel(&TerrainDetail {
        amplitude_m: 0.0,
        ..everywhere()
    });
    assert!(off.octaves().is_empty());
    assert_eq!(off.height_m(IVec2::ONE, 1.0, EVERYTHING), 0.0);
    assert_eq!((off.density(1.0), off.bound_m()), (0, 0.0));
}

#[test]
fn nonsense_is_replaced_and_nothing_panics() {
    let mut settings = everywhere();
    settings.amplitude_m = f32::NAN;
    settings.octaves = 900;
    for spacing_m in [1.0, 0.0, -1.0, f64::NAN, f64::INFINITY, 1e-30, 1e30] {
        let kernel = DetailKernel::new(&settings, &lattice(), spacing_m);
        for p in [
            IVec2::MIN,
            IVec2::MAX,
            IVec2::ZERO,
            IVec2::new(i32::MIN, i32::MAX),
        ] {
            for finest in [i32::MIN, -1, 0, i32::MAX] {
                let height_m = kernel.height_m(p, 1.0, finest);
                assert!(height_m.abs() <= kernel.bound_m(), "{p} {finest}");
                let _ = kernel.gradient(p, 1.0, finest);
            }
        }
        let _ = kernel.density(1.0);
        let _ = kernel.density(f32::NAN);
        let _ = kernel.finest_log2(f32::NAN);
    }
}

#[test]
fn octaves_fade_out_with_the_spacing_of_vertices() {
    let kernel = kernel(&everywhere());
    let p = IVec2::new(123_456, 654_321);
    for (i, octave) in kernel.octaves().iter().enumerate() {
        let wave_log2 = octave.cell_shift as i32 - 6;
        assert_eq!(DetailKernel::fade(octave, i32::MIN), 1.0);
        assert_eq!(DetailKernel::fade(octave, (wave_log2 - 2) * ONE), 1.0);
        assert_eq!(
            DetailKernel::fade(octave, (wave_log2 - 2) * ONE + ONE / 4),
            0.75
        );
        assert_eq!(DetailKernel::fade(octave, (wave_log2 - 1) * ONE), 0.0);
        assert_eq!(DetailKernel::fade(octave, i32::MAX), 0.0);
        // With two vertices a wavelength, what is left is what the coarser octaves make.
        let mut coarser = kernel;
        coarser.octave_count = i as u32;
        assert_eq!(
            kernel.height_m(p, 1.0, (wave_log2 - 1) * ONE),
            coarser.height_m(p, 1.0, (wave_log2 - 1) * ONE)
        );
    }
    // No jump from one end to the other.
    let mut random = Random(4);
    for _ in 0..20 {
        let p = anywhere(&mut random);
        let mut last = kernel.height_m(p, 1.0, 0);
        for finest in (0..20 * ONE).step_by(512) {
            let height = kernel.height_m(p, 1.0, finest);
            assert!((height - last).abs() <= 2.1 * kernel.bound_m() * 512.0 / ONE as f32);
            last = height;
        }
        assert_eq!(last, 0.0);
    }
    // A quarter of the wavelength, in metres.
    let quarter_m = 2.0_f32.powi(13) * kernel.unit_m;
    assert_eq!(kernel.finest_log2(quarter_m), 13 * ONE);
    assert_eq!(kernel.finest_log2(0.0), i32::MIN);
}

#[test]
fn the_gradient_is_the_slope() {
    // Units of a millimetre and long waves, so that differences mean something in single precision.
    for octaves in [1, 4] {
        let kernel = DetailKernel::new(
            &TerrainDetail {
                amplitude_m: 10.0,
                wavelength_m: 200.0,
                octaves,
                ..everywhere()
            },
            &lattice(),
            4.0,
        );
        let mut random = Random(5);
        let steepest = kernel
            .octaves()
            .iter()
            .map(|octave| octave.amplitude_m / (wavelength_units(octave) * kernel.unit_m))
            .fold(0.0, f32::max);
        let step = 300;
        for weight in [1.0, 0.25] {
            for finest in [0, 16 * ONE + ONE / 2] {
                for _ in 0..5_000 {
                    let p = anywhere(&mut random);
                    let height = |p| kernel.height_m(p, weight, finest);
                    let rise = |away: IVec2| {
                        (height(p + away) - height(p - away)) / (2.0 * step as f32 * kernel.unit_m)
                    };
                    let differences = Vec2::new(rise(IVec2::X * step), rise(IVec2::Y * step));
                    let gradient = kernel.gradient(p, weight, finest);
                    assert!(
                        gradient.distance(differences) < 0.01 * steepest * weight,
                        "{p}: {gradient} {differences}, steepest {steepest}"
                    );
                }
            }
        }
    }
}

#[test]
fn the_same_seed_makes_the_same_bits() {
    let kernel = kernel(&everywhere());
    let points = [
        IVec2::ZERO,
        IVec2::new(1, 0),
        IVec2::new(1_234_567, 7_654_321),
        IVec2::new(-98_765, 43_210),
        IVec2::new(1 << 29, -(1 << 29)),
    ];
    let found = points.map(|p| kernel.height_m(p, 1.0, EVERYTHING).to_bits());
    let known = [
        0xbca2_c11a,
        0xbca2_b781,
        0xbcd9_5cb4,
        0x3ce8_6833,
        0xbd01_aef8,
    ];
    assert_eq!(found, known, "{found:#x?}");
}

#[test]
fn seeds_differ() {
    let [a, b] = [0, 1].map(|seed| {
        kernel(&TerrainDetail {
            seed,
            ..everywhere()
        })
    });
    let mut random = Random(6);
    let (mut product, mut squares) = (0.0_f64, 0.0_f64);
    for _ in 0..20_000 {
        let p = anywhere(&mut random);
        let [a, b] = [a, b].map(|kernel| f64::from(kernel.height_m(p, 1.0, EVERYTHING)));
        product += a * b;
        squares += 0.5 * (a * a + b * b);
    }
    let correlation = product / squares;
    assert!(correlation.abs() < 0.05, "{correlation}");
}

#[test]
fn rules_are_smoothsteps() {
    let weight = |rule, height_m, slope_deg: f32| {
        let kernel = kernel(&TerrainDetail {
            rule,
            ..everywhere()
        });
        let rise = slope_deg.to_radians().tan();
        let [along_x, aslant] = [Vec2::new(-rise, 0.0), Vec2::new(0.6 * rise, 0.8 * rise)]
            .map(|gradient| kernel.weight(height_m, gradient));
        assert!((along_x - aslant).abs() < 1e-5);
        along_x
    };
    let near = |a: f32, b: f32| assert!((a - b).abs() < 1e-5, "{a} is not {b}");
    near(weight(DetailRule::Everywhere, -5.0, 89.0), 1.0);

    let slope = DetailRule::Slope {
        from_deg: 30.0,
        to_deg: 60.0,
    };
    near(weight(slope, 0.0, 0.0), 0.0);
    near(weight(slope, 0.0, 29.9), 0.0);
    near(weight(slope, 0.0, 45.0), 0.5);
    near(weight(slope, 0.0, 60.1), 1.0);
    near(weight(slope, 0.0, 89.9), 1.0);
    // sin² 40° = 0.413 176, and 0.326 352 of the way from 1/4 to 3/4.
    let t = 0.326_352_f32;
    near(weight(slope, 0.0, 40.0), t * t * (3.0 - 2.0 * t));
    let gentle = DetailRule::Slope {
        from_deg: 60.0,
        to_deg: 30.0,
    };
    near(weight(gentle, 0.0, 40.0), 1.0 - weight(slope, 0.0, 40.0));

    let high = DetailRule::Height {
        from_m: 100.0,
        to_m: 300.0,
    };
    near(weight(high, 99.0, 0.0), 0.0);
    near(weight(high, 150.0, 50.0), 0.156_25);
    near(weight(high, 200.0, 0.0), 0.5);
    near(weight(high, 301.0, 0.0), 1.0);
    let low = DetailRule::InverseHeight {
        full_m: 100.0,
        none_m: 300.0,
    };
    near(weight(low, -99.0, 0.0), 1.0);
    near(weight(low, 150.0, 50.0), 1.0 - 0.156_25);
    near(weight(low, 301.0, 0.0), 0.0);

    // A weight scales height and slope alike.
    let kernel = kernel(&everywhere());
    let p = IVec2::new(77_777, -5);
    assert_eq!(
        kernel.height_m(p, 0.5, EVERYTHING),
        0.5 * kernel.height_m(p, 1.0, EVERYTHING)
    );
    assert_eq!(kernel.height_m(p, 0.0, EVERYTHING), 0.0);
    assert_eq!(kernel.gradient(p, 0.0, EVERYTHING), Vec2::ZERO);
}

#[test]
fn density_grows_with_the_weight_and_with_the_amplitude() {
    let kernel = kernel(&everywhere());
    println!("density a weight {}", kernel.density_per_weight);
    assert_eq!(kernel.density(0.0), 0);
    let mut last = 0;
    for i in 1..=1000 {
        let density = kernel.density(i as f32 / 1000.0);
        assert!(density >= last && density <= DENSITY_ONE);
        assert!(density > 0);
        last = density;
    }
    assert_eq!(kernel.density(1e30), DENSITY_ONE);
    // One octave in closed form: 10 cm at 64/65 of 8 m, samples a metre apart.
    let one = |amplitude_m| {
        DetailKernel::new(
            &TerrainDetail {
                amplitude_m,
                wavelength_m: 8.0,
                octaves: 1,
                ..everywhere()
            },
            &lattice(),
            1.0,
        )
    };
    let wave = std::f64::consts::TAU / (8.0 * 64.0 / 65.0);
    let wanted = 2.0 * 0.1 * wave * wave;
    let found = f64::from(one(0.1).density(1.0)) / f64::from(DENSITY_ONE);
    assert!((found - wanted).abs() < 1e-6, "{found} {wanted}");
    let half = f64::from(one(0.1).density(0.5)) / f64::from(DENSITY_ONE);
    assert!((half - 0.5 * wanted).abs() < 1e-6);
    assert!(one(0.2).density(0.5) > one(0.1).density(0.5));
    assert_eq!(one(10.0).density(1.0), DENSITY_ONE);
}

#[test]
fn bad_settings_are_named() {
    TerrainDetail::default().validate().unwrap();
    let bad = TerrainDetail {
        amplitude_m: -1.0,
        wavelength_m: f32::NAN,
        octaves: 0,
        gain: 1.5,
        seed: 7,
        rule: DetailRule::Slope {
            from_deg: 30.0,
            to_deg: 95.0,
        },
    };
    let mut errors = Vec::new();
    let checked = bad.checked(|error| errors.push(error.to_string()));
    let default = TerrainDetail::default();
    assert_eq!(checked, TerrainDetail { seed: 7, ..default });
    for (error, (name, value)) in errors.iter().zip([
        ("amplitude_m", "-1"),
        ("wavelength_m", "NaN"),
        ("gain", "1.5"),
        ("octaves", "0"),
        ("rule.to_deg", "95"),
    ]) {
        assert!(
            error.starts_with(&format!(
                "TerrainDetail::{name} is {value}: use a number from"
            )),
            "{error}"
        );
    }
    assert_eq!(errors.len(), 5);
    assert_eq!(bad.validate().unwrap_err().to_string(), errors[0]);

    let with = |rule| TerrainDetail {
        rule,
        ..TerrainDetail::default()
    };
    let error = with(DetailRule::Height {
        from_m: 5.0,
        to_m: 5.0,
    })
    .validate()
    .unwrap_err();
    assert_eq!(
        error.to_string(),
        "TerrainDetail::rule goes from 5 to 5: set the two at least 0.1 apart"
    );
    let error = with(DetailRule::InverseHeight {
        full_m: 5.0,
        none_m: 1.0,
    })
    .validate()
    .unwrap_err();
    assert!(matches!(error, TerrainDetailError::RuleUpsideDown { .. }));
    let error = with(DetailRule::InverseHeight {
        full_m: f32::INFINITY,
        none_m: 1.0,
    })
    .validate()
    .unwrap_err();
    assert!(error.to_string().contains("rule.full_m is inf"), "{error}");
}

/// The shader's module composes with the types alone, is valid, and lays its structs out as Rust
/// does.
#[test]
fn the_shader_is_valid_and_its_structs_are_laid_out_as_in_rust() {
    use naga::valid::{Capabilities, ValidationFlags, Validator};
    use naga_oil::compose::{ComposableModuleDescriptor, Composer, NagaModuleDescriptor};

    let mut composer = Composer::default();
    for source in [
        include_str!("../src/render/shaders/types.wgsl"),
        include_str!("../src/render/shaders/detail.wgsl"),
    ] {
        composer
            .add_composable_module(ComposableModuleDescriptor {
                source,
                ..Default::default()
            })
            .unwrap();
    }
    let source = "
        #import bevy_tessera::detail::{
            Detail, detail_noise, detail_fade, detail_weight, detail_density,
        }
        @group(0) @binding(0) var<uniform> detail: Detail;
        @group(0) @binding(1) var<storage, read_write> out: array<vec4<f32>>;
        @compute @workgroup_size(64)
        fn evaluate(@builtin(global_invocation_id) id: vec3<u32>) {
            let p = vec2<i32>(id.xy);
            let weight = detail_weight(detail, 3.0, vec2(0.5, 0.25));
            let fade = detail_fade(detail.octaves[0].cell_shift, 0);
            let noise = detail_noise(detail.octaves[0], p) * fade;
            out[id.x] = vec4(noise, f32(detail_density(detail, weight)));
        }";
    let module = composer
        .make_naga_module(NagaModuleDescriptor {
            source,
            ..Default::default()
        })
        .unwrap_or_else(|error| panic!("{}", error.emit_to_string(&composer)));
    Validator::new(ValidationFlags::all(), Capabilities::empty())
        .validate(&module)
        .unwrap();

    let layout = |name: &str| {
        module
            .types
            .iter()
            .find_map(|(_, found)| match &found.inner {
                naga::TypeInner::Struct { members, span }
                    if found
                        .name
                        .as_deref()
                        .is_some_and(|found| found.starts_with(name)) =>
                {
                    let offset = |member: &naga::StructMember| {
                        (member.name.clone().unwrap(), member.offset as usize)
                    };
                    Some((
                        *span as usize,
                        members.iter().map(offset).collect::<Vec<_>>(),
                    ))
                }
                _ => None,
            })
            .unwrap()
    };
    macro_rules! rust {
        ($of:ty: $($field:ident)*) => {(
            size_of::<$of>(),
            vec![$((stringify!($field).to_owned(), std::mem::offset_of!($of, $field))),*],
        )};
    }
    assert_eq!(
        layout("DetailOctave"),
        rust!(DetailOctave: turn offset cell_shift per_cell amplitude_m salt)
    );
    let kernel = rust!(DetailKernel: octaves octave_count rule rule_from rule_rate unit_m
        density_per_weight amplitude_m unused);
    assert_eq!(layout("DetailX"), kernel);
    assert_eq!(kernel.0, DETAIL_OCTAVES * 32 + 32);
}

/// Shaded relief of the detail, to be looked at: `DETAIL_PNG=… cargo test … -- --ignored`.
#[test]
#[ignore = "writes a picture for a person to look at"]
fn picture() {
    // Four times the default amplitude, because the eye likes contrast.
    let kernel = kernel(&TerrainDetail {
        amplitude_m: 1.6,
        ..everywhere()
    });
    let path = std::env::var("DETAIL_PNG").unwrap_or_else(|_| "detail.png".into());
    // 512 pixels of 6 cm.
    let step = 250;
    let light = glam::Vec3::new(-0.6, 0.55, -0.55).normalize();
    let picture = image::GrayImage::from_fn(512, 512, |x, z| {
        let p = IVec2::new(x as i32, z as i32) * step - 40_000;
        let slope = kernel.gradient(p, 1.0, kernel.finest_log2(step as f32 * kernel.unit_m));
        let normal = glam::Vec3::new(-slope.x, 1.0, -slope.y).normalize();
        image::Luma([(normal.dot(light).max(0.0) * 255.0) as u8])
    });
    picture.save(path).unwrap();
}
