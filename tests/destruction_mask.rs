//! The destruction mask is a function of the edits and of nothing else: drawn edit by edit or
//! anew in parts, it has the same bytes; it is seamless, sparse, and bounded.

use bevy_tessera::edit::mask::{
    DestructionMask, MASK_MIPS, MASK_PAGE_BYTES, MASK_PAGE_TEXELS, MaskSettings,
};
use bevy_tessera::edit::{
    CapturedGround, Change, EDIT_UNITS, Edit, MAX_REACH, MIN_REACH, SampleRect, StampImage,
};
use glam::DVec2;
use proptest::prelude::*;

/// A crater at metres, on samples that are `spacing_m` apart; its bowl takes up two thirds of it.
fn crater(spacing_m: f64, at_m: [f64; 2], reach_m: f64, seed: u32) -> Edit {
    let units = |metres: f64| (metres / spacing_m * f64::from(EDIT_UNITS)).round();
    Edit {
        centre: at_m.map(|at| units(at) as i32),
        reach: (units(reach_m) as u32).clamp(MIN_REACH, MAX_REACH),
        change: Change::Crater {
            depth: 100,
            rim: 30,
            bowl: 43_690,
            roughness: 64,
            seed,
            density: 255,
            scorch: 255,
            may_clamp: false,
        },
    }
}

fn flatten(centre: [i32; 2], reach: u32, strength: u16, hardness: u8) -> Edit {
    Edit {
        centre,
        reach,
        change: Change::Flatten {
            to: 1000,
            strength,
            hardness,
            least: -10,
            most: 10,
        },
    }
}

fn mask(spacing_m: f64) -> DestructionMask {
    DestructionMask::new(spacing_m, &MaskSettings::default())
}

/// Edits of all kinds that often overlap.
fn any_edit() -> impl Strategy<Value = Edit> {
    let image = StampImage {
        side: 5,
        samples: (0..25)
            .map(|at| (at % 7) * 900 - 2000)
            .collect::<Vec<i16>>()
            .into(),
    };
    let change = prop_oneof![
        4 => (any::<u16>(), any::<u32>(), any::<u8>()).prop_map(|(bowl, seed, scorch)| {
            Change::Crater {
                depth: 9, rim: 3, bowl, roughness: 80, seed, density: 9, scorch, may_clamp: false,
            }
        }),
        1 => (any::<u16>(), any::<u8>()).prop_map(|(strength, hardness)| Change::Flatten {
            to: 7, strength, hardness, least: -5, most: 5,
        }),
        1 => (any::<u16>(), any::<u8>()).prop_map(|(strength, hardness)| Change::Smooth {
            ground: CapturedGround {
                first: [0, 0],
                spacing_log2: 2,
                size: [1, 1],
                heights: vec![5].into(),
            },
            strength, hardness, least: -5, most: 5,
        }),
        1 => any::<u8>().prop_map(|hardness| Change::Raise {
            by: 300, hardness, density: 4, may_clamp: false,
        }),
        2 => (-1.0..1.0_f64, any::<u8>()).prop_map(move |(half_turns, scorch)| {
            let (sine, cosine) = (half_turns * std::f64::consts::PI).sin_cos();
            Change::Stamp {
                image: image.clone(),
                by: 50,
                turn: [cosine, sine].map(|along| (along * 16384.0) as i16),
                density: 3,
                scorch,
                may_clamp: true,
            }
        }),
    ];
    // Around a corner of pages, and of samples with negative numbers.
    let centre = [-1500..1500_i32, -1500..1500_i32];
    let reach = prop_oneof![8 => MIN_REACH..1500, 1 => 1500..12_000_u32];
    (centre, reach, change).prop_map(|(centre, reach, change)| Edit {
        centre,
        reach,
        change,
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn a_mask_redrawn_without_an_edit_is_the_mask_that_never_had_it(
        edits in proptest::collection::vec(any_edit(), 1..12),
        undone in any::<prop::sample::Index>(),
        spacing_m in prop_oneof![Just(0.25), Just(1.0), Just(2.0), Just(30.0)],
    ) {
        let undone = undone.index(edits.len());
        let mut drawn = mask(spacing_m);
        for edit in &edits {
            drawn.draw(edit);
        }
        let rect = edits[undone].rect();
        let left: Vec<Edit> = edits
            .iter()
            .enumerate()
            .filter(|(place, _)| *place != undone)
            .map(|(_, edit)| edit.clone())
            .collect();
        let touching = left.iter().filter(|edit| !edit.rect().intersection(&rect).is_empty());
        drawn.redraw(rect, touching);
        let mut never = mask(spacing_m);
        for edit in &left {
            never.draw(edit);
        }
        prop_assert!(drawn.content() == never.content());

        // And done again.
        let touching = edits.iter().filter(|edit| !edit.rect().intersection(&rect).is_empty());
        drawn.redraw(rect, touching);
        let mut all = mask(spacing_m);
        for edit in &edits {
            all.draw(edit);
        }
        prop_assert!(drawn.content() == all.content());
        drawn.clear();
        prop_assert!(drawn.is_empty());
    }

    #[test]
    fn a_mask_drawn_in_windows_is_the_mask_drawn_at_once(
        edits in proptest::collection::vec(any_edit(), 1..6),
        cuts in [-20..20_i32, -20..20_i32],
    ) {
        let mut at_once = mask(1.0);
        for edit in &edits {
            at_once.draw(edit);
        }
        let mut in_windows = mask(1.0);
        let [x, z] = cuts;
        for (columns, rows) in [(-999..x, -999..z), (x..999, z..999), (-999..x, z..999), (x..999, -999..z)] {
            let window = SampleRect::new([columns.start, rows.start], [columns.end, rows.end]);
            in_windows.redraw(window, &edits);
        }
        prop_assert!(at_once.content() == in_windows.content());
    }

    #[test]
    fn nothing_is_drawn_beyond_an_edits_reach(edit in any_edit()) {
        let mut mask = mask(1.0);
        mask.draw(&edit);
        let texel_units = i64::from(1_u32 << mask.texel_shift());
        for (place, texels) in mask.content() {
            let side = texel_units << place.layer;
            for z in 0..MASK_PAGE_TEXELS as i64 {
                for x in 0..MASK_PAGE_TEXELS as i64 {
                    if texels[(z * 64 + x) as usize] == 0 {
                        continue;
                    }
                    // In half units.
                    let middle = |page: i32, at: i64| (2 * (i64::from(page) * 64 + at) + 1) * side;
                    let from = [
                        middle(place.x, x) - 2 * i64::from(edit.centre[0]),
                        middle(place.z, z) - 2 * i64::from(edit.centre[1]),
                    ];
                    let reach = 2 * i64::from(edit.reach);
                    prop_assert!(from[0] * from[0] + from[1] * from[1] <= reach * reach);
                }
            }
        }
    }
}

#[test]
fn craters_leave_the_same_mask_in_any_order() {
    let craters: Vec<Edit> = (0..40)
        .map(|at| {
            crater(
                1.0,
                [f64::from(at * 37 % 90), f64::from(at * 53 % 70)],
                4.0 + f64::from(at),
                at,
            )
        })
        .collect();
    let (mut one, mut other) = (mask(1.0), mask(1.0));
    for edit in &craters {
        one.draw(edit);
    }
    for edit in craters.iter().rev() {
        other.draw(edit);
    }
    assert!(one.content() == other.content());
}

#[test]
fn a_crater_is_dark_in_its_bowl_and_ends_in_rays_within_its_reach() {
    let mut mask = mask(1.0);
    mask.draw(&crater(1.0, [100.0, 60.0], 24.0, 5));
    let at = |angle: f64, far: f64| {
        let place = DVec2::new(100.0, 60.0) + DVec2::from_angle(angle) * far;
        mask.strength_at(place, 0.0)
    };
    let around = |far: f64| {
        (0..64)
            .map(move |step| f64::from(step) * std::f64::consts::TAU / 64.0)
            .map(move |angle| at(angle, far))
    };
    // 55 % of a bowl of 16 m.
    for far in [0.0, 3.0, 8.3] {
        assert!(around(far).all(|strength| strength == 1.0), "{far}");
    }
    assert!(around(24.3).all(|strength| strength == 0.0));
    // Where the bowl ends, some rays go on and others don't.
    let rim: Vec<f32> = around(15.5).collect();
    assert!(rim.iter().any(|strength| *strength > 0.2), "{rim:?}");
    assert!(rim.iter().any(|strength| *strength < 0.02), "{rim:?}");
    // Other seeds have other rays.
    let mut other = self::mask(1.0);
    other.draw(&crater(1.0, [100.0, 60.0], 24.0, 6));
    assert!(mask.content() != other.content());
}

#[test]
fn flattening_wipes_scorch_out_and_a_crater_after_it_is_there() {
    let first = crater(1.0, [10.0, 10.0], 6.0, 1);
    let mut mask = mask(1.0);
    mask.draw(&first);
    let middle = DVec2::splat(10.0);
    assert_eq!(mask.strength_at(middle, 0.0), 1.0);
    mask.draw(&flatten(first.centre, 12 * 64, 32768, 255));
    let half = mask.strength_at(middle, 0.0);
    assert!((half - 0.5).abs() < 0.01, "{half}");
    mask.draw(&flatten(first.centre, 12 * 64, 65535, 255));
    assert!(mask.is_empty(), "its pages are free again");
    mask.draw(&first);
    assert_eq!(mask.strength_at(middle, 0.0), 1.0);
}

#[test]
fn raising_the_ground_leaves_its_scorch() {
    let mut mask = mask(1.0);
    mask.draw(&crater(1.0, [10.0, 10.0], 6.0, 1));
    let content: Vec<_> = mask
        .content()
        .iter()
        .map(|(at, texels)| (*at, **texels))
        .collect();
    let mut raise = flatten([640, 640], 640, 0, 128);
    raise.change = Change::Raise {
        by: 900,
        hardness: 128,
        density: 0,
        may_clamp: true,
    };
    assert_eq!(mask.draw(&raise), 0);
    let after: Vec<_> = mask
        .content()
        .iter()
        .map(|(at, texels)| (*at, **texels))
        .collect();
    assert!(content == after);
}

#[test]
fn a_stamp_scorches_where_its_image_is_not_0() {
    // Something in the quarter towards the image's own x and z only.
    let samples: Vec<i16> = (0..81)
        .map(|at| if at % 9 > 4 && at / 9 > 4 { 20_000 } else { 0 })
        .collect();
    let stamp = |turn: [i16; 2]| Edit {
        centre: [6400, 6400],
        reach: 20 * 64,
        change: Change::Stamp {
            image: StampImage {
                side: 9,
                samples: samples.clone().into(),
            },
            by: 40,
            turn,
            density: 0,
            scorch: 200,
            may_clamp: false,
        },
    };
    let quarters = |turn: [i16; 2]| {
        let mut mask = mask(1.0);
        mask.draw(&stamp(turn));
        [[6.0, 6.0], [-6.0, 6.0], [-6.0, -6.0], [6.0, -6.0]]
            .map(|from| mask.strength_at(DVec2::splat(100.0) + DVec2::from(from), 0.0))
    };
    let full = 200.0 / 255.0;
    assert_eq!(quarters([16384, 0]), [full, 0.0, 0.0, 0.0]);
    // Its x axis points along z, and its z axis against x.
    assert_eq!(quarters([0, 16384]), [0.0, full, 0.0, 0.0]);
    assert_eq!(quarters([-16384, 0]), [0.0, 0.0, full, 0.0]);
}

#[test]
fn what_is_read_has_no_seam_at_the_borders_of_pages() {
    let mut mask = mask(1.0);
    // Pages are 16 m wide; these lie on borders and corners.
    for (place, at) in [[16.0, 5.0], [16.0, 16.0], [3.0, 32.0], [0.0, 0.0]]
        .iter()
        .enumerate()
    {
        mask.draw(&crater(1.0, *at, 7.0, place as u32));
    }
    for footprint_m in [0.0, 0.3, 1.0, 3.0, 9.0, 40.0] {
        // What is read changes no faster than from one texel of the finer mip to the next.
        let texel_m = f64::from(footprint_m).max(0.25);
        let step_m = texel_m / 64.0;
        let most = 1.6 / 64.0 * 2.0;
        for line in 0..40 {
            let z = -8.0 + f64::from(line) * 1.1;
            let mut before = None;
            let mut x = -10.0;
            while x < 35.0 {
                for place in [DVec2::new(x, z), DVec2::new(z, x)] {
                    let here = mask.strength_at(place, footprint_m);
                    let next = mask.strength_at(place + step_m * 0.5, footprint_m);
                    assert!(
                        (here - next).abs() < most,
                        "{place} {here} {next} at {footprint_m}"
                    );
                }
                let here = mask.strength_at(DVec2::new(x, z), footprint_m);
                if let Some(before) = before {
                    let jump: f32 = here - before;
                    assert!(
                        jump.abs() < most,
                        "{x} {z}: {before} {here} at {footprint_m}"
                    );
                }
                before = Some(here);
                x += step_m.max(0.01);
            }
        }
    }
}

#[test]
fn a_distant_view_sees_as_much_scorch_as_a_near_one() {
    let mut mask = mask(1.0);
    mask.draw(&crater(1.0, [37.0, 21.0], 9.0, 3));
    let mean = |footprint_m: f32| {
        let mut sum = 0.0;
        for z in 0..200 {
            for x in 0..200 {
                let place = DVec2::new(f64::from(x), f64::from(z)) * 0.5 + DVec2::new(-13.0, -29.0);
                sum += f64::from(mask.strength_at(place, footprint_m));
            }
        }
        sum
    };
    let near = mean(0.0);
    for footprint_m in [0.5, 1.0, 2.0, 4.0, 7.0] {
        let far = mean(footprint_m);
        assert!(
            (far / near - 1.0).abs() < 0.02,
            "{footprint_m}: {far} of {near}"
        );
    }
}

#[test]
fn memory_follows_the_craters() {
    let mut mask = mask(1.0);
    assert_eq!((mask.bytes(), mask.page_count(), mask.layers()), (0, 0, 0));
    // Craters of bombs, far from each other: at most four pages each.
    for at in 0..100 {
        let place = f64::from(at) * 1234.5;
        mask.draw(&crater(1.0, [place, -place], 6.0, at));
    }
    let pages = mask.page_count();
    assert!((100..=400).contains(&pages), "{pages}");
    assert!(mask.bytes() < pages * (MASK_PAGE_BYTES + 128));
    // The same again takes nothing.
    for at in 0..100 {
        let place = f64::from(at) * 1234.5;
        assert_eq!(mask.draw(&crater(1.0, [place, -place], 6.0, at)), 0);
    }
    assert_eq!(mask.page_count(), pages);
    let everywhere = SampleRect::new([i32::MIN; 2], [i32::MAX; 2]);
    mask.redraw(everywhere, []);
    assert_eq!(
        (mask.page_count(), mask.layers(), mask.page_numbers()),
        (0, 0, 0)
    );
    assert!(mask.table().is_empty());
}

#[test]
fn texels_are_as_fine_as_asked_for_at_any_spacing() {
    for (spacing_m, texel_m) in [
        (0.25, 0.25),
        (0.5, 0.25),
        (1.0, 0.25),
        (1.5, 0.1875),
        (2.0, 0.25),
        (10.0, 0.15625),
        (30.0, 0.46875),
        (90.0, 1.40625),
    ] {
        let mask = mask(spacing_m);
        assert_eq!(mask.texel_m(), texel_m, "{spacing_m}");
    }
    for texels_per_m in [f32::NAN, 0.0, -3.0, f32::INFINITY] {
        let settings = MaskSettings {
            texels_per_m,
            ..Default::default()
        };
        assert_eq!(DestructionMask::new(1.0, &settings).texel_m(), 0.25);
    }
    for spacing_m in [f64::NAN, 0.0, -1.0, f64::MIN_POSITIVE, 1e300] {
        let mut mask = mask(spacing_m);
        mask.draw(&crater(1.0, [5.0, 5.0], 6.0, 0));
    }
}

#[test]
fn no_edit_touches_more_than_81_pages() {
    for spacing_m in [0.25, 1.0, 7.0, 30.0, 90.0] {
        for reach in [MIN_REACH, 100, 16_447, MAX_REACH, u32::MAX] {
            for centre in [[0, 0], [i32::MIN, i32::MAX], [777, -31]] {
                let mut mask = mask(spacing_m);
                let mut edit = crater(1.0, [0.0, 0.0], 1.0, 8);
                (edit.centre, edit.reach) = (centre, reach);
                mask.draw(&edit);
                let pages = mask.page_count();
                assert!(pages <= 81, "{pages} at {spacing_m} m and {reach}");
                assert!(pages > 0, "{spacing_m} m and {reach}");
            }
        }
    }
}

#[test]
fn what_is_in_coarse_and_fine_layers_is_seen_as_the_greater() {
    let mut mask = mask(1.0);
    mask.draw(&crater(1.0, [0.0, 0.0], 300.0, 2));
    mask.draw(&crater(1.0, [230.0, 0.0], 6.0, 1));
    assert_eq!(mask.layers(), 0b1001);
    for place in [DVec2::ZERO, DVec2::new(90.0, 30.0), DVec2::new(230.0, 0.0)] {
        assert_eq!(mask.strength_at(place, 0.0), 1.0);
    }
    // Both go where the ground is flattened.
    mask.draw(&flatten([0, 0], MAX_REACH, 65535, 255));
    assert!(mask.is_empty());
}

#[test]
fn a_full_mask_refuses_pages_and_goes_on() {
    let settings = MaskSettings {
        max_bytes: 10 * MASK_PAGE_BYTES as u64,
        ..Default::default()
    };
    let mut mask = DestructionMask::new(1.0, &settings);
    for at in 0..50 {
        mask.draw(&crater(1.0, [f64::from(at) * 40.0, 8.0], 5.0, at));
    }
    assert_eq!(mask.page_count(), 10);
    assert!(mask.refused() > 0);
    // What is there can still change.
    let whole = SampleRect::new([-100; 2], [100; 2]);
    mask.redraw(whole, []);
    assert!(mask.page_count() < 10);
    mask.draw(&crater(1.0, [0.0, 0.0], 5.0, 0));
    assert_eq!(mask.strength_at(DVec2::ZERO, 0.0), 1.0);
}

#[test]
fn what_has_changed_since_a_version_makes_a_copy_equal() {
    let mut mask = mask(1.0);
    let mut copy: Vec<Vec<u8>> = Vec::new();
    let mut version = 0;
    let edits: Vec<Edit> = (0..60)
        .map(|at| {
            crater(
                1.0,
                [f64::from(at * 31 % 200), f64::from(at * 17 % 90)],
                5.0,
                at,
            )
        })
        .collect();
    for step in 0..edits.len() {
        if step % 7 == 6 {
            let rect = edits[step - 3].rect();
            mask.redraw(rect, &edits[..step - 3]);
        }
        mask.draw(&edits[step]);
        if step % 5 != 4 {
            continue;
        }
        copy.resize(mask.page_numbers() as usize, Vec::new());
        for (number, _, texels) in mask.pages_since(version) {
            copy[number as usize] = texels.to_vec();
        }
        version = mask.version();
        for (number, _, texels) in mask.pages_since(0) {
            assert!(copy[number as usize] == texels);
        }
    }
    assert_eq!(mask.pages_since(version).count(), 0);
    assert_eq!(MASK_MIPS, 7);
}
