//! No triangle is further from the ground than the bounds of the texels that it meets say, whatever
//! its phase, shape and direction; and the bounds are not much larger than they have to be.

mod bake_support;
mod error_support;

use bake_support::{addresses, bake_heights, data, errors, heights, landscape, manifest, read_all};
use bevy_tessera::bake::{BakeSettings, bake, import};
use bevy_tessera::error_bound::{ErrorScratch, bound, cover_finer, tile_errors};
use bevy_tessera::tile::{
    ERROR_SPACINGS, ErrorTile, HeightTile, TileAddress, decode_error, encode_error, tile_path,
};
use error_support::{Ground, Random, longest_edge, meets, random_triangle, search};
use proptest::prelude::*;
use std::path::Path;

/// All texels of a ground, row by row, and how many there are in x and z.
struct Bounds {
    texels: [u32; 2],
    tiles: [u32; 2],
    errors: Vec<ErrorTile>,
}

impl Bounds {
    fn new(ground: &Ground) -> Self {
        let tiles = ground.size.map(|samples| (samples - 1).div_ceil(128));
        let mut scratch = ErrorScratch::default();
        let errors = (0..tiles[0] * tiles[1]).map(|at| {
            let first = [at % tiles[0] * 128, at / tiles[0] * 128];
            tile_errors(ground.size, first, |z| ground.row(z), &mut scratch)
        });
        Self {
            texels: ground.size.map(|samples| (samples - 1).div_ceil(4)),
            tiles,
            errors: errors.collect(),
        }
    }

    fn texel(&self, [x, z]: [u32; 2]) -> [u8; 8] {
        self.errors[(z / 32 * self.tiles[0] + x / 32) as usize].get(x % 32, z % 32)
    }

    fn at(&self, texel: [u32; 2], spacing: f64) -> f64 {
        bound(&self.texel(texel), spacing).expect("no larger than 64")
    }
}

/// Looks for a triangle that is further from the ground than any texel's bound that it meets.
fn check(name: &str, ground: &Ground, triangles: usize, seed: u64) {
    let bounds = Bounds::new(ground);
    let mut random = Random(seed);
    let mut checked = 0;
    for _ in 0..triangles {
        let texel = bounds
            .texels
            .map(|count| (random.unit() * f64::from(count)) as u32);
        // Powers of two, and everything between and below.
        let spacing = match (random.unit() * 3.0) as u32 {
            0 => f64::from(1 << (random.unit() * 7.0) as u32),
            1 => 2_f64.powf(random.between(-4.0, 1.0)),
            _ => 2_f64.powf(random.between(0.0, 6.0)),
        };
        let triangle = random_triangle(&mut random, texel, spacing);
        if !ground.holds(&triangle) || !meets(&triangle, texel) {
            continue;
        }
        checked += 1;
        let (worst, long) = (ground.worst(&triangle), longest_edge(&triangle));
        let limit = bounds.at(texel, long);
        assert!(
            worst <= limit + 1e-6,
            "{name}: {worst} > {limit} in texel {texel:?}, edges up to {long}: {triangle:?}"
        );
    }
    assert!(checked > triangles / 50, "{name}: only {checked}");
}

fn grounds() -> Vec<(&'static str, Ground)> {
    let mut noise = Random(1);
    let mut rough = Random(2);
    let size = [300, 230];
    vec![
        (
            "smooth",
            Ground::new(size, |x, z| {
                30_000.0 + 9_000.0 * (x * 0.03).sin() * (z * 0.05 + x * 0.01).cos()
            }),
        ),
        (
            "noise",
            Ground::new(size, |_, _| 30_000.0 + 4000.0 * noise.unit()),
        ),
        (
            "rough",
            Ground::new(size, |x, z| {
                20_000.0 + 40.0 * x + 3000.0 * (z * 0.04).sin() + 90.0 * rough.unit()
            }),
        ),
        (
            "spikes",
            Ground::new(size, |x, z| {
                if (x * 7.0 + z * 13.0) % 97.0 == 0.0 {
                    60_000.0
                } else {
                    10_000.0
                }
            }),
        ),
        (
            "step",
            Ground::new(size, |x, z| {
                if x * 0.7 + z < 190.0 {
                    5000.0
                } else {
                    40_000.0
                }
            }),
        ),
        (
            "ridge",
            Ground::new(size, |x, z| {
                60_000.0 - 300.0 * (x * 0.6 - z * 0.8 + 20.0).abs()
            }),
        ),
        (
            "saddle",
            Ground::new(size, |x, z| 32_000.0 + 0.8 * (x - 140.0) * (z - 100.0)),
        ),
        (
            "bowl",
            Ground::new(size, |x, z| 0.4 * ((x - 90.0).powi(2) + (z - 70.0).powi(2))),
        ),
        (
            "small",
            Ground::new([7, 5], |x, z| 9000.0 * (x * 1.9 + z * z).sin() + 20_000.0),
        ),
        (
            "narrow",
            Ground::new([2, 140], |x, z| {
                20_000.0 * x + 9000.0 * (z * 0.8).sin() + 10_000.0
            }),
        ),
        (
            "rim",
            Ground::new([130, 131], |x, z| {
                90.0 * x + if x > 126.0 || z > 127.0 { 9000.0 } else { 0.0 }
            }),
        ),
    ]
}

#[test]
fn no_triangle_is_further_from_the_ground_than_the_bound() {
    for (seed, (name, ground)) in grounds().iter().enumerate() {
        check(name, ground, 40_000, seed as u64);
    }
}

#[test]
fn the_worst_triangles_that_a_search_finds_keep_to_the_bound() {
    let mut random = Random(77);
    for (name, ground) in &grounds() {
        let bounds = Bounds::new(ground);
        for _ in 0..12 {
            let texel = bounds
                .texels
                .map(|count| (random.unit() * f64::from(count)) as u32);
            let spacing = 2_f64.powf(random.between(-1.0, 5.0));
            let found = search(ground, &mut random, texel, spacing, 60, 200);
            let limit = bounds.at(texel, spacing);
            assert!(
                found <= limit + 1e-6,
                "{name}: {found} > {limit}, {texel:?}, {spacing}"
            );
        }
    }
}

/// Half a kilometre of files: what the README of the data calls them, and which part is taken.
fn real(dir: &Path, name: &str, size: [u32; 2]) -> Ground {
    let settings = import::ImportSettings::default();
    let mut source = import::open(&dir.join("terrain").join(name), &settings).expect("readable");
    let whole = source.size();
    let heights = read_all(&mut *source).expect("readable");
    let known = heights.iter().copied().filter(|height| !height.is_nan());
    let (low, high) = known.fold((f32::MAX, f32::MIN), |(a, b), h| (a.min(h), b.max(h)));
    let (low, range) = (low - 64.0, high - low + 128.0);
    let from = [0, 1].map(|axis| (whole[axis] - size[axis]) / 2);
    Ground::new(size, |x, z| {
        let at = (z as u32 + from[1]) * whole[0] + x as u32 + from[0];
        f64::from((heights[at as usize].max(low) - low) / range) * 65535.0
    })
}

#[test]
fn bounds_hold_on_real_ground_and_are_not_much_larger_than_needed() {
    let Some(dir) = data() else { return };
    println!("bound / largest error found: median over texels");
    println!(
        "{:32} {:>6} {:>6} {:>6} {:>6} {:>6} {:>6} {:>6}",
        "", 1, 2, 4, 8, 16, 32, 64
    );
    for name in [
        "taiwan_z12_4096_u16.png",
        "puget_sound_1025_u16.png",
        "slovenia_lidar_1m_f32.tif",
        "N44W072.hgt",
    ] {
        let ground = real(&dir, name, [385, 385]);
        check(name, &ground, 20_000, 5);
        let bounds = Bounds::new(&ground);
        let mut random = Random(3);
        let mut line = format!("{name:32}");
        for k in 0..ERROR_SPACINGS {
            let spacing = f64::from(1_u32 << k);
            let mut ratios: Vec<f64> = (0..40)
                .filter_map(|_| {
                    let texel = [0; 2].map(|_| random.between(17.0, 79.0) as u32);
                    let found = search(
                        &ground,
                        &mut random,
                        texel,
                        spacing,
                        std::env::var("TRIES").map_or(150, |t| t.parse().unwrap()),
                        std::env::var("STEPS").map_or(350, |t| t.parse().unwrap()),
                    );
                    let limit = bounds.at(texel, spacing);
                    assert!(
                        found <= limit + 1e-6,
                        "{name}: {found} > {limit}, {texel:?}"
                    );
                    (found > 0.5).then(|| limit / found)
                })
                .collect();
            ratios.sort_by(f64::total_cmp);
            let median = ratios.get(ratios.len() / 2).copied().unwrap_or(f64::NAN);
            line += &format!(" {median:6.2}");
        }
        println!("{line}");
    }
}

#[test]
fn a_spike_of_one_sample_counts_at_every_spacing() {
    let height = 4000.0;
    for spike in [[130, 131], [128, 128], [127, 60], [1, 1], [0, 57]] {
        let at = |x: f64, z: f64| x == f64::from(spike[0]) && z == f64::from(spike[1]);
        let ground = Ground::new([260, 260], |x, z| {
            20_000.0 + 3.0 * x + if at(x, z) { height } else { 0.0 }
        });
        let bounds = Bounds::new(&ground);
        for k in 0..ERROR_SPACINGS {
            // Even a triangle between samples misses nearly half of the spike where edges are as
            // long as the grid's; where they are longer, nearly all of it.
            let least = if k == 0 { 0.24 } else { 0.49 } * height;
            for texel in [0, 1].map(|back| spike.map(|at: u32| at.saturating_sub(back) / 4)) {
                let found = bounds.at(texel, f64::from(1 << k));
                assert!(found >= least, "{spike:?}, texel {texel:?}, 2^{k}: {found}");
            }
        }
    }
}

#[test]
fn planes_have_bounds_of_what_their_rounding_makes() {
    for (dx, dz) in [
        (0.0, 0.0),
        (17.0, -9.0),
        (1.0, 80.0),
        (0.31, 0.77),
        (-13.37, 40.21),
    ] {
        let mut inside: f64 = 0.0;
        let whole = f64::fract(dx) == 0.0 && f64::fract(dz) == 0.0;
        for size in [[300, 200], [129, 130], [40, 3]] {
            if size[1] == 3 && !whole {
                // Turned about the rim again and again, rounding adds up.
                continue;
            }
            let ground = Ground::new(size, |x, z| 20_000.0 + dx * x + dz * z);
            let bounds = Bounds::new(&ground);
            for z in 0..bounds.texels[1] {
                for x in 0..bounds.texels[0] {
                    for k in 0..ERROR_SPACINGS {
                        let found = bounds.at([x, z], f64::from(1 << k));
                        // Rounding moves samples by half a step and kinks by two. At the rim,
                        // where ground is turned about it, that doubles.
                        let most = if whole { 0.2 } else { 9.0 };
                        assert!(
                            found <= most,
                            "{dx} {dz} {size:?}: {found} at {x} {z}, 2^{k}"
                        );
                        if size[0] > 200 && (30..40).contains(&x) && (15..30).contains(&z) {
                            inside = inside.max(found);
                        }
                    }
                }
            }
        }
        println!("{dx} {dz}: up to {inside} steps far from the rim");
    }
}

#[test]
fn bounds_never_fall_with_the_spacing_and_parents_cover_their_children() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for size in [[700, 530], [129, 1200], [257, 2]] {
        let dir = folder.path().join(format!("{}x{}", size[0], size[1]));
        bake_heights(size, landscape(size, 3), &dir, &BakeSettings::default());
        let file = manifest(&dir).file;
        let mut raised = 0;
        for address in addresses(&file) {
            let own = errors(&dir, address);
            for texel in own.texels() {
                assert!(texel[..ERROR_SPACINGS].is_sorted(), "{address}: {texel:?}");
                assert_eq!(texel[7], 0);
            }
            for child in address.children().into_iter().flatten() {
                let tiles = file.tiles(child.level);
                if child.x >= tiles[0] || child.z >= tiles[1] {
                    continue;
                }
                let finer = errors(&dir, child);
                for z in 0..32 {
                    for x in 0..32 {
                        let (x_above, z_above) = (child.x % 2 * 32 + x, child.z % 2 * 32 + z);
                        let (above, below) = (own.get(x_above / 2, z_above / 2), finer.get(x, z));
                        for k in 0..ERROR_SPACINGS - 1 {
                            assert!(above[k] >= below[k + 1], "{address} {x} {z}");
                        }
                        raised += u32::from(above[0] == below[1] && above[0] > 0);
                    }
                }
            }
        }
        assert!(raised > 0, "nothing rests on a child");
    }
}

#[test]
fn a_bake_stores_each_levels_bounds_raised_to_its_childrens() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let size = [530, 330];
    let dir = folder.path().join("terrain");
    bake_heights(size, landscape(size, 9), &dir, &BakeSettings::default());
    let file = manifest(&dir).file;
    let mut finer: Option<Vec<Vec<[u8; 8]>>> = None;
    for level in 0..file.levels {
        let ground = level_of(&dir, &file, level);
        let bounds = Bounds::new(&ground);
        let mut all = Vec::new();
        for z in 0..bounds.texels[1] {
            let row = (0..bounds.texels[0]).map(|x| {
                let mut texel = bounds.texel([x, z]);
                let below = finer.iter().flat_map(|finer| {
                    let rows = finer.iter().skip(2 * z as usize).take(2);
                    rows.flat_map(|row| row.iter().skip(2 * x as usize).take(2))
                });
                for below in below {
                    cover_finer(&mut texel, below);
                }
                let address = TileAddress::new(level, x / 32, z / 32);
                assert_eq!(
                    errors(&dir, address).get(x % 32, z % 32),
                    texel,
                    "{address} {x} {z}"
                );
                texel
            });
            all.push(row.collect());
        }
        finer = Some(all);
    }
}

/// A baked level's heights.
fn level_of(dir: &Path, file: &bevy_tessera::terrain::ManifestFile, level: u8) -> Ground {
    let size = file.samples(level);
    let tiles = file.tiles(level);
    let read = |x, z| heights(dir, TileAddress::new(level, x, z));
    let all: Vec<HeightTile> = (0..tiles[0] * tiles[1])
        .map(|at| read(at % tiles[0], at / tiles[0]))
        .collect();
    Ground::new(size, |x, z| {
        let (x, z) = (x as u32, z as u32);
        let tile = [x, z].map(|at| at / 128);
        let tile = [0, 1].map(|axis| tile[axis].min(tiles[axis] - 1));
        let at = |at: u32, tile: u32| (at - 128 * tile) as i32;
        let stored = &all[(tile[1] * tiles[0] + tile[0]) as usize];
        f64::from(stored.get(at(x, tile[0]), at(z, tile[1])))
    })
}

#[test]
fn a_texels_bounds_do_not_depend_on_where_tiles_begin() {
    let mut noise = Random(5);
    let whole = Ground::new([640, 610], |x, z| {
        30_000.0 + 4000.0 * (x * 0.05).sin() * (z * 0.06).cos() + 900.0 * noise.unit().powi(9)
    });
    let all = Bounds::new(&whole);
    // The widest boxes begin at multiples of 32 samples; tiles begin at multiples of 128.
    for from in [[32, 96], [64, 32], [96, 0]] {
        let part = Ground::new([420, 400], |x, z| {
            whole.sample(x as i64 + from[0], z as i64 + from[1])
        });
        let bounds = Bounds::new(&part);
        for z in 34..bounds.texels[1] - 35 {
            for x in 34..bounds.texels[0] - 35 {
                let other = [x + from[0] as u32 / 4, z + from[1] as u32 / 4];
                assert_eq!(bounds.texel([x, z]), all.texel(other), "{from:?}: {x} {z}");
            }
        }
    }
}

#[test]
fn neither_bands_nor_threads_change_bounds() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let size = [600, 420];
    let made = |name: &str, band_rows: Option<u32>, threads: usize| {
        let dir = folder.path().join(name);
        let settings = BakeSettings {
            band_rows,
            ..Default::default()
        };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let pool = pool.expect("threads can be made");
        pool.install(|| {
            let mut source = bake_support::source(size, landscape(size, 8));
            bake(&mut source, &dir, &settings, &()).expect("the bake succeeds")
        });
        let file = manifest(&dir).file;
        let all = addresses(&file).into_iter();
        all.map(|tile| std::fs::read(dir.join(tile_path(tile))).expect("readable"))
            .collect::<Vec<_>>()
    };
    let whole = made("whole", None, 1);
    for (name, band_rows, threads) in [("rows", Some(1), 3), ("odd", Some(77), 2)] {
        assert!(made(name, band_rows, threads) == whole, "{name}");
    }
}

proptest! {
    #[test]
    fn a_stored_error_is_rounded_up_by_less_than_an_eighth(error in 0_u32..=u32::MAX >> 6) {
        let byte = encode_error(error);
        let decoded = decode_error(byte);
        prop_assert!(decoded >= error);
        prop_assert!(decoded - error <= (error / 8).max(8));
        prop_assert!(byte == 0 || decode_error(byte - 1) < error);
        prop_assert_eq!(encode_error(decoded), byte);
    }
}

#[test]
fn every_stored_byte_is_an_error_of_its_own() {
    let all: Vec<u32> = (0..=u8::MAX).map(decode_error).collect();
    assert_eq!(all[..4], [0, 8, 9, 10]);
    assert!(all[..233].windows(2).all(|pair| pair[0] < pair[1]));
    for byte in 0..233 {
        assert_eq!(encode_error(decode_error(byte)), byte);
    }
    assert_eq!(decode_error(u8::MAX), u32::MAX);
    assert!(decode_error(encode_error(u32::MAX)) == u32::MAX);
    // The largest error there can be.
    assert!(encode_error(65535 * 64) < 233);
}
