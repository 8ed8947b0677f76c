//! Heights, normals and rays are those of the finest resident tiles' bilinear ground, and no ray
//! slips through it.

mod common;
mod query_support;

use bevy_tessera::lattice::Lattice;
use bevy_tessera::query::{GroundHit, GroundRay, GroundReader};
use bevy_tessera::tessellate::{Pages, height};
use bevy_tessera::tile::{DENSITY_STORED, DensityTile, ErrorTile, TerrainTile, TileAddress};
use common::random::Random;
use glam::{DVec2, DVec3, IVec2};
use proptest::prelude::*;
use query_support::TestGround;
use std::sync::Arc;

/// Ground with waves, steps and spikes.
fn rough(x: u32, z: u32) -> u16 {
    let (u, v) = (f64::from(x), f64::from(z));
    let waves = 3000.0 * (u / 23.0).sin() * (v / 17.0).cos() + 800.0 * (u / 3.1 + v / 2.3).sin();
    let step = if (x / 40 + z / 56).is_multiple_of(3) {
        1500.0
    } else {
        0.0
    };
    let spike = if (x * 7 + z * 13).is_multiple_of(101) {
        2500.0
    } else {
        0.0
    };
    (9000.0 + waves + step + spike) as u16
}

/// A part of the tiles, a different one for each seed.
fn some(seed: u64, percent: u64) -> impl FnMut(TileAddress) -> bool {
    move |address| {
        let of = u64::from(address.level) << 40 | u64::from(address.x) << 20 | u64::from(address.z);
        let mut random = Random((of + 1).wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ (seed + 1));
        for _ in 0..5 {
            random.next();
        }
        random.next() % 100 < percent
    }
}

fn ray(origin_m: DVec3, direction: DVec3) -> GroundRay {
    GroundRay {
        origin_m,
        direction,
        max_distance: f64::INFINITY,
    }
}

fn unit(random: &mut Random) -> f64 {
    (random.next() >> 11) as f64 / (1_u64 << 53) as f64
}

fn between(random: &mut Random, low: f64, high: f64) -> f64 {
    low + (high - low) * unit(random)
}

fn place(random: &mut Random, ground: &TestGround) -> DVec2 {
    DVec2::new(unit(random), unit(random)) * ground.extent_m()
}

/// The hit lies on the ground, or on the wall between two tiles' grounds.
fn assert_on_the_ground(ground: &TestGround, ray: &GroundRay, hit: &GroundHit) {
    let on = |t: f64| {
        let point = ray.origin_m + ray.direction * t;
        let end = ground.extent_m();
        let on = DVec2::new(point.x, point.z).clamp(DVec2::ZERO, end);
        point.y - ground.height_m(on)
    };
    let here = on(hit.distance);
    let step = 1e-6 * (1.0 + hit.distance);
    let (before, after) = (on(hit.distance - step), on(hit.distance + step));
    assert!(
        here.abs() < 1e-6 || (before > 0.0) != (after > 0.0),
        "{ray:?} {hit:?}: {before} {here} {after}"
    );
    let point = ray.origin_m + ray.direction * hit.distance;
    assert!((hit.point_m - point).length() < 1e-9 * (1.0 + hit.distance));
    let at = DVec2::new(point.x, point.z).clamp(DVec2::ZERO, ground.extent_m());
    let sample = GroundReader::new(ground).sample(at).expect("on it");
    assert_eq!((hit.level, hit.normal), (sample.level, sample.normal()));
}

/// Where small steps along the ray first see it change sides, as the interval of that step; `None`
/// where they don't.
fn march(ground: &TestGround, ray: &GroundRay, step: f64, to: f64) -> Option<[f64; 2]> {
    let mut reader = GroundReader::new(ground);
    let mut last: Option<(f64, bool)> = None;
    let mut t = 0.0;
    while t <= to {
        let point = ray.origin_m + ray.direction * t;
        let here = reader.height(DVec2::new(point.x, point.z));
        last = match (here, last) {
            (None, _) => None,
            (Some(here), Some((before, was_above))) if was_above != (point.y > here.height_m) => {
                return Some([before, t]);
            }
            (Some(here), _) => Some((t, point.y > here.height_m)),
        };
        t += step;
    }
    None
}

#[test]
fn heights_equal_the_twins_where_all_is_settled() {
    let mut random = Random(11);
    for (size, seed) in [
        ([300, 211], 1),
        ([129, 640], 2),
        ([2, 2], 3),
        ([513, 257], 4),
    ] {
        let ground = TestGround::new(size, 40, &rough, &mut some(seed, 60));
        let lattice = Lattice::new(size, ground.file.levels, 0, 8).expect("a size that fits");
        let texels = vec![128; (DENSITY_STORED * DENSITY_STORED) as usize];
        let mut pages = Pages::default();
        for (&address, (heights, _)) in &ground.tiles {
            let tile = TerrainTile {
                heights: heights.clone(),
                densities: DensityTile::from_samples(texels.clone().into()).expect("35 x 35"),
                errors: ErrorTile::flat(),
                stamp: 0,
            };
            pages.tiles.insert(address, Arc::new(tile));
        }
        let mut levels = [0; 8];
        let mut reader = GroundReader::new(&ground);
        for _ in 0..4000 {
            let p = IVec2::new(
                random.below(lattice.extent.x + 1),
                random.below(lattice.extent.y + 1),
            );
            let unit_m = lattice.unit_m(ground.file.spacing_m);
            let at_m = (p.as_dvec2() * unit_m).min(ground.extent_m());
            let found = reader.height(at_m).expect("on the terrain");
            levels[usize::from(found.level)] += 1;
            let lambda = i32::from(found.level) << 16;
            let twin = height(&pages, &lattice, p, lambda).expect("is there");
            let twin_m = ground.file.height_min_m + f64::from(twin) * ground.file.height_step_m;
            assert!(
                (found.height_m - twin_m).abs() < 1e-4,
                "{p}: {found:?} {twin_m}"
            );
            assert_eq!(GroundReader::new(&ground).height(at_m), Some(found));
        }
        if ground.file.levels > 1 {
            assert!(levels[0] > 0 && levels[0] < 4000, "{levels:?}");
        }
    }
}

#[test]
fn normals_and_slopes_are_those_of_finite_differences() {
    let ground = TestGround::new([300, 300], 0, &rough, &mut some(9, 70));
    let mut random = Random(5);
    let mut reader = GroundReader::new(&ground);
    let mut steep = 0;
    for _ in 0..5000 {
        let at = place(&mut random, &ground);
        let sample = reader.sample(at).expect("on the terrain");
        // Both ends in the same cell of level 0, so in the same patch.
        let cell = at / ground.file.spacing_m;
        if (cell.fract() - 0.5).abs().max_element() > 0.49 {
            continue;
        }
        let step = 1e-3;
        let slope =
            |by: DVec2| (ground.height_m(at + by) - ground.height_m(at - by)) / (2.0 * step);
        let rises = DVec2::new(slope(DVec2::X * step), slope(DVec2::Y * step));
        assert!(
            (rises - sample.gradient).length() < 1e-6,
            "{rises} {sample:?}"
        );
        let normal = sample.normal();
        assert!((normal.length() - 1.0).abs() < 1e-12 && normal.y > 0.0);
        assert!(normal.dot(DVec3::new(1.0, rises.x, 0.0)).abs() < 1e-5);
        assert!(normal.dot(DVec3::new(0.0, rises.y, 1.0)).abs() < 1e-5);
        assert!((normal.y.acos() - sample.slope()).abs() < 1e-7);
        steep += u32::from(sample.slope() > 1.0);
    }
    assert!(steep > 50);
}

#[test]
fn rays_meet_a_plane_where_its_formula_says() {
    // As wide as whole cells of the coarsest level: what is beyond the last sample repeats it.
    let slanted = |x: u32, z: u32| (5000 + 2 * x - z) as u16;
    for percent in [0, 50, 100] {
        let ground = TestGround::new([513, 385], 0, &slanted, &mut some(3, percent));
        let file = &ground.file;
        let rise = DVec2::new(2.0, -1.0) * file.height_step_m / file.spacing_m;
        let base = file.height_min_m + 5000.0 * file.height_step_m;
        let mut random = Random(21);
        for n in 0..4000 {
            let at = place(&mut random, &ground);
            let hit_point = DVec3::new(at.x, base + rise.dot(at), at.y);
            let way = DVec3::new(
                between(&mut random, -1.0, 1.0),
                between(&mut random, 0.05, 1.0) * if n % 2 == 0 { 1.0 } else { -1.0 },
                between(&mut random, -1.0, 1.0),
            );
            let back = between(&mut random, 0.1, 900.0);
            let ray = ray(hit_point - way * back, way);
            let hit = ray.cast(&ground).expect("hits");
            assert!((hit.distance - back).abs() < 1e-6, "{ray:?} {hit:?} {back}");
            assert!((hit.point_m - hit_point).length() < 1e-6);
            let normal = DVec3::new(-rise.x, 1.0, -rise.y).normalize();
            assert!((hit.normal - normal).length() < 1e-9);
            assert_eq!(hit.is_from_below, way.dot(normal) > 0.0);
            // No further than asked.
            for (max_distance, is_hit) in [(back - 1e-3, false), (back + 1e-3, true)] {
                let short = GroundRay {
                    max_distance,
                    ..ray
                };
                assert_eq!(short.cast(&ground).is_some(), is_hit);
            }
            // And none the other way.
            let away = GroundRay {
                direction: -way,
                ..ray
            };
            assert_eq!(away.cast(&ground), None);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn rays_hit_what_a_march_in_small_steps_finds(
        seed in any::<u64>(),
        size in prop_oneof![Just([150, 130]), Just([257, 300]), Just([129, 129]), Just([40, 9])],
        lift in prop_oneof![Just(0u16), Just(150)],
        percent in prop_oneof![Just(0u64), Just(60), Just(100)],
        (has_blocks, has_ranges) in any::<(bool, bool)>(),
        steepness in prop_oneof![Just(0.0), -0.2..0.2_f64, -3.0..3.0_f64],
    ) {
        let mut ground = TestGround::new(size, lift, &rough, &mut some(seed, percent));
        (ground.has_blocks, ground.has_ranges) = (has_blocks, has_ranges);
        let mut random = Random(seed | 1);
        for _ in 0..10 {
            let at = place(&mut random, &ground);
            let angle = between(&mut random, 0.0, std::f64::consts::TAU);
            // Along the grid's lines too.
            let (at, angle) = if random.next().is_multiple_of(3) {
                let quarter = std::f64::consts::FRAC_PI_2 * f64::from(random.below(4));
                ((at / ground.file.spacing_m).floor() * ground.file.spacing_m, quarter)
            } else {
                (at, angle)
            };
            let origin = at.extend(between(&mut random, -20.0, 130.0));
            let origin = DVec3::new(origin.x, origin.z, origin.y);
            let flat = DVec2::from_angle(angle);
            // Exactly along an axis where it is meant to be.
            let flat = DVec2::select(flat.abs().cmplt(DVec2::splat(1e-9)), DVec2::ZERO, flat);
            let ray = ray(origin, DVec3::new(flat.x, steepness, flat.y));
            let found = march(&ground, &ray, 1.0 / 32.0, ground.extent_m().length());
            let hit = ray.cast(&ground);
            if let Some(hit) = hit {
                assert_on_the_ground(&ground, &ray, &hit);
                let above = ground.clearance_m(origin) > 0.0;
                prop_assert_eq!(hit.is_from_below, !above);
            }
            if let Some([from, to]) = found {
                // Steps may pass over a tip that the ray goes through, so a hit may be before.
                let hit = hit.ok_or_else(|| TestCaseError::fail(format!("{ray:?} misses {from}")))?;
                prop_assert!(hit.distance <= to + 1e-9, "{:?} {:?} {}", ray, hit, to);
            }
        }
    }
}

#[test]
fn no_ray_from_above_escapes_through_ground_of_many_levels() {
    let mut random = Random(99);
    for seed in 0..10 {
        let ground = TestGround::new([700, 515], 200, &rough, &mut some(seed, 65));
        let levels: Vec<_> = (0..ground.file.levels)
            .map(|level| {
                ground
                    .tiles
                    .keys()
                    .filter(|tile| tile.level == level)
                    .count()
            })
            .collect();
        assert!(levels.iter().all(|&count| count > 0), "{levels:?}");
        for n in 0..1000 {
            let (from, to) = (place(&mut random, &ground), place(&mut random, &ground));
            // Some exactly along lines between tiles, and some upright.
            let line = 128.0 * ground.file.spacing_m;
            let (from, to) = match n % 8 {
                0 => (from.with_x(line * 2.0), to.with_x(line * 2.0)),
                1 => (from.with_y(line * 3.0), to.with_y(line * 3.0)),
                2 => ((from / line).floor() * line, (to / line).floor() * line),
                3 => (from, from),
                _ => (from, to),
            };
            let above = DVec3::new(from.x, between(&mut random, 300.0, 900.0), from.y);
            let below = DVec3::new(to.x, between(&mut random, -900.0, -45.0), to.y);
            for (start, end, is_from_below) in [(above, below, false), (below, above, true)] {
                let ray = GroundRay {
                    max_distance: 1.0,
                    ..ray(start, end - start)
                };
                let hit = ray.cast(&ground);
                let hit = hit.unwrap_or_else(|| panic!("{ray:?} escapes, seed {seed}"));
                assert_eq!(hit.is_from_below, is_from_below);
                assert_on_the_ground(&ground, &ray, &hit);
            }
        }
    }
}

#[test]
fn a_ray_through_the_gap_between_two_levels_hits_its_wall() {
    // The right half has its finest tiles; the left half, 20 m higher, hasn't.
    let flat = |_: u32, _: u32| 4000;
    let mut right = |address: TileAddress| address.level != 0 || address.x >= 1;
    let ground = TestGround::new([257, 129], 2000, &flat, &mut right);
    let border = 128.0 * ground.file.spacing_m;
    let [low, high] = [0.0, 20.0];
    let right_of = GroundReader::new(&ground).height(DVec2::new(border, 9.0));
    assert_eq!(right_of.map(|ground| ground.height_m), Some(low));
    assert!((ground.height_m(DVec2::new(border - 1e-9, 9.0)) - high).abs() < 1e-9);
    for z in [0.0, 9.0, 50.25] {
        // From the low ground, horizontally, into the wall.
        let from = DVec3::new(border + 30.0, 11.0, z);
        let hit = ray(from, DVec3::NEG_X).cast(&ground).expect("hits");
        assert!((hit.distance - 30.0).abs() < 1e-9, "{hit:?}");
        assert!(!hit.is_from_below);
        // From under the high ground into the open: from below.
        let from = DVec3::new(border - 30.0, 11.0, z);
        let hit = ray(from, DVec3::X).cast(&ground).expect("hits");
        assert!((hit.distance - 30.0).abs() < 1e-9, "{hit:?}");
        assert!(hit.is_from_below);
    }
}

#[test]
fn rays_beyond_the_rim_miss_and_the_rim_itself_is_ground() {
    // The second one ends on a line between tiles.
    for size in [[200, 140], [257, 129]] {
        let ground = TestGround::new(size, 90, &rough, &mut some(1, 100));
        let end = ground.extent_m();
        for x in [0.0, 77.7, end.x] {
            for z in [0.0, 55.5, end.y] {
                let down = ray(DVec3::new(x, 500.0, z), DVec3::NEG_Y);
                let hit = down.cast(&ground).expect("hits");
                let height_m = ground.height_m(DVec2::new(x, z));
                assert!((hit.point_m.y - height_m).abs() < 1e-9, "{down:?} {hit:?}");
            }
        }
    }
    let ground = TestGround::new([200, 140], 0, &rough, &mut some(1, 50));
    let end = ground.extent_m();
    let down = |x: f64, z: f64| ray(DVec3::new(x, 500.0, z), DVec3::NEG_Y).cast(&ground);
    for (x, z) in [
        (-1e-9, 5.0),
        (end.x + 1e-9, 5.0),
        (5.0, -0.1),
        (5.0, end.y + 0.1),
    ] {
        assert_eq!(down(x, z), None);
    }
    // Past a corner, beside, over and under it all.
    let miss = |origin: [f64; 3], direction: [f64; 3]| {
        let ray = ray(origin.into(), direction.into());
        assert_eq!(ray.cast(&ground), None, "{ray:?}");
    };
    miss([-10.0, 40.0, 5.0], [1.0, 0.0, -1.0]);
    miss([-10.0, 40.0, -5.0], [1.0, 0.0, 0.0]);
    miss([-10.0, 40.0, 5.0], [-1.0, 0.0, 0.0]);
    miss([-10.0, 400.0, 5.0], [1.0, 0.0, 0.2]);
    miss([-10.0, -41.0, 5.0], [1.0, 0.0, 0.2]);
    miss([-1000.0, 300.0, 5.0], [1.0, -1.0, 0.0]);
    // From outside onto it, and from outside below it up through it.
    let hit = ray(
        DVec3::new(-1000.0, 1000.0, 50.0),
        DVec3::new(1.1, -1.0, 0.1),
    )
    .cast(&ground);
    assert!(!hit.expect("hits").is_from_below);
    let hit = ray(
        DVec3::new(-1000.0, -1000.0, 50.0),
        DVec3::new(1.1, 1.0, 0.1),
    )
    .cast(&ground);
    assert!(hit.expect("hits").is_from_below);
}

#[test]
fn a_ray_on_the_ground_hits_where_it_is() {
    let flat = |_: u32, _: u32| 4000;
    let ground = TestGround::new([300, 300], 0, &flat, &mut some(1, 50));
    for direction in [
        DVec3::X,
        DVec3::NEG_Z,
        DVec3::Y,
        DVec3::NEG_Y,
        DVec3::new(1.0, -2.0, 0.5),
    ] {
        let hit = ray(DVec3::new(100.0, 0.0, 100.0), direction).cast(&ground);
        assert_eq!(hit.expect("hits").distance, 0.0);
    }
    // And one that comes along its surface where that begins.
    let hit = ray(DVec3::new(-7.0, 0.0, 100.0), DVec3::X).cast(&ground);
    assert_eq!(hit.expect("hits").distance, 7.0);
}

#[test]
fn what_is_not_finite_or_not_there_is_no_hit() {
    let mut ground = TestGround::new([200, 140], 0, &rough, &mut some(1, 50));
    let odd = [
        f64::NAN,
        f64::INFINITY,
        f64::NEG_INFINITY,
        f64::MAX,
        -f64::MAX,
        f64::MIN_POSITIVE,
        5e-324,
        1e300,
        -1e18,
        0.0,
        -0.0,
        64.0,
    ];
    let mut random = Random(3);
    for _ in 0..200_000 {
        let mut pick = || random.pick(&odd);
        let ray = GroundRay {
            origin_m: DVec3::new(pick(), pick(), pick()),
            direction: DVec3::new(pick(), pick(), pick()),
            max_distance: pick(),
        };
        let hit = ray.cast(&ground);
        let is_sound = ray.origin_m.is_finite()
            && ray.direction.is_finite()
            && ray.direction != DVec3::ZERO
            && ray.max_distance >= 0.0;
        assert!(is_sound || hit.is_none(), "{ray:?} {hit:?}");
        let at = DVec2::new(pick(), pick());
        let sample = GroundReader::new(&ground).sample(at);
        let is_on = at.cmpge(DVec2::ZERO).all() && at.cmple(ground.extent_m()).all();
        assert_eq!(sample.is_some(), is_on, "{at}");
    }
    ground.tiles.clear();
    let down = ray(DVec3::new(10.0, 500.0, 10.0), DVec3::NEG_Y);
    assert_eq!(down.cast(&ground), None);
    assert_eq!(GroundReader::new(&ground).sample(DVec2::ONE), None);
}
