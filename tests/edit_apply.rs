//! Edits change tiles the same way wherever, whenever and together with whatever they are applied;
//! neighbours keep their borders equal, and error bounds stay bounds.

mod bake_support;
#[path = "edit_apply/bounds.rs"]
mod bounds;
#[expect(dead_code, reason = "the tests of baked bounds use the rest")]
mod error_support;
#[path = "edit_apply/refusals.rs"]
mod refusals;

use bake_support::{addresses, bake_heights, landscape, manifest};
use bevy_tessera::bake::BakeSettings;
use bevy_tessera::edit::{
    CapturedGround, Change, EDIT_UNITS, Edit, EditGround, EditRaster, EditScratch, EditedTile,
    InvalidEdit, MAX_REACH, MIN_REACH, SampleRect, StampImage, TileChange, ground_hash,
};
use bevy_tessera::error_bound::bound;
use bevy_tessera::terrain::ManifestFile;
use bevy_tessera::tile::{TerrainTile, TileAddress, tile_path};
use error_support::{Ground, Random, longest_edge, meets, random_triangle};
use proptest::prelude::*;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::{Arc, OnceLock};

type Tiles = BTreeMap<TileAddress, TerrainTile>;
type Edited = BTreeMap<TileAddress, EditedTile>;

struct Terrain {
    file: ManifestFile,
    ground: EditGround,
    tiles: Tiles,
}

fn terrain(size: [u32; 2], heights: Vec<f32>) -> Terrain {
    let dir = tempfile::tempdir().expect("a folder");
    let dir = dir.path().join("terrain");
    bake_heights(size, heights, &dir, &BakeSettings::default());
    let file = manifest(&dir).file;
    let read = |address| {
        let bytes = std::fs::read(dir.join(tile_path(address))).expect("the tile is there");
        let tile = TerrainTile::decode(&bytes, address).expect("the tile is good");
        (address, tile)
    };
    Terrain {
        ground: EditGround::new(&file),
        tiles: addresses(&file).into_iter().map(read).collect(),
        file,
    }
}

/// Several tiles a side, of which the last ones lie partly beyond the rim.
fn rough() -> &'static Terrain {
    static TERRAIN: OnceLock<Terrain> = OnceLock::new();
    const SIZE: [u32; 2] = [601, 330];
    TERRAIN.get_or_init(|| terrain(SIZE, landscape(SIZE, 3)))
}

/// Smooth hills, on which bounds are low.
fn smooth() -> &'static Terrain {
    static TERRAIN: OnceLock<Terrain> = OnceLock::new();
    const SIZE: [u32; 2] = [420, 391];
    let height = |at: u32| {
        let (x, z) = ((at % SIZE[0]) as f32, (at / SIZE[0]) as f32);
        (x * 0.02).sin() * 20.0 + (z * 0.015 + x * 0.003).cos() * 30.0
    };
    TERRAIN.get_or_init(|| terrain(SIZE, (0..SIZE[0] * SIZE[1]).map(height).collect()))
}

impl Terrain {
    fn edited(&self) -> Edited {
        let tiles = self.tiles.iter();
        tiles
            .map(|(&address, tile)| (address, EditedTile::new(address, tile.clone())))
            .collect()
    }

    fn rasters(&self, edits: &[Edit]) -> Vec<EditRaster> {
        let mut scratch = EditScratch::default();
        edits
            .iter()
            .map(|edit| self.ground.raster(edit, &mut scratch))
            .collect()
    }

    /// All tiles after some edits, one by one.
    fn after(&self, edits: &[Edit]) -> Edited {
        let mut scratch = EditScratch::default();
        let mut tiles = self.edited();
        for raster in &self.rasters(edits) {
            for tile in tiles.values_mut() {
                tile.apply(&self.ground, raster, &mut scratch);
            }
        }
        tiles
    }

    /// The level's heights, of which all tiles that store them must say the same.
    fn level(&self, tiles: &Edited, level: u8) -> Result<Ground, TestCaseError> {
        let size = self.file.samples(level);
        let mut heights: Vec<Option<u16>> = vec![None; (size[0] * size[1]) as usize];
        for (address, tile) in tiles.iter().filter(|(address, _)| address.level == level) {
            let (first_x, first_z) = address.first_sample();
            for z in -2..=130 {
                for x in -2..=130 {
                    let at = [(first_x, x), (first_z, z)].map(|(first, at)| first as i32 + at);
                    let [x_on, z_on] =
                        [0, 1].map(|axis| at[axis].clamp(0, size[axis] as i32 - 1) as u32);
                    let height = tile.tile().heights.get(x, z);
                    let known = &mut heights[(z_on * size[0] + x_on) as usize];
                    let wanted = *known.get_or_insert(height);
                    prop_assert_eq!(height, wanted, "{} differs at {}, {}", address, x, z);
                }
            }
        }
        Ok(Ground {
            size,
            heights: heights.into_iter().flatten().collect(),
        })
    }
}

fn crater(centre: [i32; 2], reach: u32) -> Edit {
    Edit {
        centre,
        reach,
        change: Change::Crater {
            depth: 1200,
            rim: 400,
            bowl: 40_000,
            roughness: 64,
            seed: 7,
            density: 90,
            scorch: 255,
            may_clamp: false,
        },
    }
}

/// A place of a terrain in units, on it or near it.
fn place(size: u32) -> impl Strategy<Value = i32> {
    let end = (size as i32 - 1) * EDIT_UNITS;
    prop_oneof![
        4 => -3000..end + 3000,
        // On borders and corners of tiles.
        3 => (0..=size as i32 / 128, -130..130).prop_map(|(tile, by)| tile * 128 * EDIT_UNITS + by),
        1 => Just(end),
        1 => -40_000..end + 40_000,
    ]
}

fn reaches() -> impl Strategy<Value = u32> {
    prop_oneof![
        6 => MIN_REACH..=24 * EDIT_UNITS as u32,
        2 => MIN_REACH..=150 * EDIT_UNITS as u32,
        1 => Just(MIN_REACH),
    ]
}

fn changes() -> impl Strategy<Value = Change> {
    let crater = (any::<[u16; 2]>(), 1..=u16::MAX, any::<(u8, u32, u8)>()).prop_map(
        |([depth, rim], bowl, (roughness, seed, density))| Change::Crater {
            depth: depth / 16,
            rim: rim / 32,
            bowl,
            roughness,
            seed,
            density,
            scorch: 0,
            may_clamp: true,
        },
    );
    let raise =
        (-5000..5000, any::<u8>(), any::<u8>()).prop_map(|(by, hardness, density)| Change::Raise {
            by,
            hardness,
            density,
            may_clamp: true,
        });
    let limits = (-9000..=0, 0..=9000);
    let flatten = (any::<(u16, u16, u8)>(), limits.clone()).prop_map(
        |((to, strength, hardness), (least, most))| Change::Flatten {
            to,
            strength,
            hardness,
            least,
            most,
        },
    );
    let grid = (
        [-100..700, -100..700],
        0..6_u8,
        [1..9_u16, 1..9_u16],
        any::<u64>(),
    )
        .prop_map(|(first, spacing_log2, size, seed)| {
            let mut random = Random(seed);
            let count = size[0] * size[1];
            CapturedGround {
                first,
                spacing_log2,
                size,
                heights: (0..count)
                    .map(|_| random.between(0.0, 65535.9) as u16)
                    .collect(),
            }
        });
    let smooth = (grid, any::<(u16, u8)>(), limits).prop_map(
        |(ground, (strength, hardness), (least, most))| Change::Smooth {
            ground,
            strength,
            hardness,
            least,
            most,
        },
    );
    let stamp = (
        2..40_u16,
        any::<u64>(),
        -4000..4000,
        0.0..7.0_f64,
        any::<u8>(),
    )
        .prop_map(|(side, seed, by, angle, density)| {
            let mut random = Random(seed);
            let sample = |_| random.between(-32767.0, 32767.0) as i16;
            Change::Stamp {
                image: StampImage {
                    side,
                    samples: (0..side * side).map(sample).collect(),
                },
                by,
                turn: [angle.cos(), angle.sin()].map(|part| (part * 16384.0).round() as i16),
                density,
                scorch: 0,
                may_clamp: true,
            }
        });
    prop_oneof![3 => crater, 1 => raise, 1 => flatten, 1 => smooth, 1 => stamp]
}

/// Edits of a terrain of `size`, as harmless as commands make them.
fn edits(size: [u32; 2]) -> impl Strategy<Value = Edit> {
    (place(size[0]), place(size[1]), reaches(), changes()).prop_map(|(x, z, reach, change)| Edit {
        centre: [x, z],
        reach,
        change,
    })
}

/// The worst that passes as valid.
fn extreme_edits() -> impl Strategy<Value = Edit> {
    let reach = prop_oneof![Just(MIN_REACH), Just(MAX_REACH), MIN_REACH..MIN_REACH + 9];
    let centre = |reach: u32| {
        let most = (1 << 30) + reach as i32;
        prop_oneof![
            2 => -20_000..50_000,
            1 => Just(most),
            1 => Just(-most),
            1 => -most..=most,
        ]
    };
    let end = |low: i32, high: i32| prop_oneof![Just(low), Just(high)];
    let byte = prop_oneof![Just(0), Just(255), any::<u8>()];
    let word = prop_oneof![Just(0), Just(1), Just(u16::MAX), any::<u16>()];
    let change = prop_oneof![
        (
            word.clone(),
            word.clone(),
            word.clone(),
            byte.clone(),
            any::<u32>()
        )
            .prop_map(|(depth, rim, bowl, roughness, seed)| Change::Crater {
                depth,
                rim,
                bowl: bowl.max(1),
                roughness,
                seed,
                density: 255,
                scorch: 255,
                may_clamp: false,
            }),
        (end(-65535, 65535), byte.clone()).prop_map(|(by, hardness)| Change::Raise {
            by,
            hardness,
            density: 255,
            may_clamp: false,
        }),
        (
            word.clone(),
            word.clone(),
            byte.clone(),
            end(-65535, 0),
            end(0, 65535)
        )
            .prop_map(|(to, strength, hardness, least, most)| Change::Flatten {
                to,
                strength,
                hardness,
                least,
                most,
            }),
        (
            [any::<i32>(), any::<i32>()],
            0..=12_u8,
            [1..4_u16, 1..4_u16],
            word.clone(),
            byte,
        )
            .prop_map(
                |(first, spacing_log2, size, strength, hardness)| Change::Smooth {
                    ground: CapturedGround {
                        first,
                        spacing_log2,
                        size,
                        heights: vec![u16::MAX; usize::from(size[0] * size[1])].into(),
                    },
                    strength,
                    hardness,
                    least: -65535,
                    most: 65535,
                }
            ),
        (
            prop_oneof![Just(2_u16), Just(3), Just(1024)],
            end(-32767, 32767),
            end(-65535, 65535),
            end(-16384, 16384),
            any::<bool>(),
        )
            .prop_map(|(side, sample, by, turn, across)| Change::Stamp {
                image: StampImage {
                    side,
                    samples: vec![sample as i16; usize::from(side) * usize::from(side)].into(),
                },
                by,
                turn: if across {
                    [0, turn as i16]
                } else {
                    [turn as i16, 0]
                },
                density: 255,
                scorch: 0,
                may_clamp: false,
            }),
    ];
    (reach, change).prop_flat_map(move |(reach, change)| {
        (centre(reach), centre(reach)).prop_map(move |(x, z)| Edit {
            centre: [x, z],
            reach,
            change: change.clone(),
        })
    })
}

fn config(cases: u32) -> ProptestConfig {
    ProptestConfig {
        cases,
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

proptest! {
    #![proptest_config(config(150))]

    #[test]
    fn a_samples_displacement_does_not_depend_on_what_else_is_asked_for(
        edit in edits(rough().file.size),
        windows in prop::collection::vec((any::<[u16; 2]>(), 1..40_i32, 1..40_i32), 12),
    ) {
        prop_assert_eq!(edit.validate(), Ok(()));
        let ground = &rough().ground;
        let mut scratch = EditScratch::default();
        let raster = ground.raster(&edit, &mut scratch);
        for (number, (place, width, height)) in windows.into_iter().enumerate() {
            let level = number as u8 % ground.levels();
            let size = ground.samples(level);
            let around = raster.level(level).0.grown(4);
            // Around the edit, as far as the terrain reaches.
            let min = [0, 1].map(|axis| {
                let span = (around.max[axis] - around.min[axis]).max(1);
                let at = around.min[axis] + i32::from(place[axis]) % span;
                at.clamp(0, size[axis] as i32 - 1)
            });
            let max = [
                (min[0] + width).min(size[0] as i32),
                (min[1] + height).min(size[1] as i32),
            ];
            let window = SampleRect::new(min, max);
            let values = ground.window(&edit, level, &window, &mut scratch);
            let samples = (min[1]..max[1]).flat_map(|z| (min[0]..max[0]).map(move |x| [x, z]));
            for (sample, &value) in samples.zip(values) {
                prop_assert_eq!(raster.value(level, sample), value, "{} {:?}", level, sample);
            }
        }
    }
}

proptest! {
    #![proptest_config(config(24))]

    #[test]
    fn neighbours_agree_on_their_shared_samples_after_any_edits(
        edits in prop::collection::vec(edits(rough().file.size), 1..6),
    ) {
        let terrain = rough();
        let tiles = terrain.after(&edits);
        for level in 0..terrain.ground.levels() {
            terrain.level(&tiles, level)?;
        }
    }

    #[test]
    fn many_edits_at_once_leave_what_one_after_the_other_does(
        edits in prop::collection::vec(edits(rough().file.size), 1..9),
        split in 0..9_usize,
    ) {
        let terrain = rough();
        let rasters = terrain.rasters(&edits);
        let one_by_one = terrain.after(&edits);
        let mut scratch = EditScratch::default();
        let pairs: Vec<_> = rasters.iter().map(|raster| (raster.edit(), raster.footprint())).collect();
        let (first, second) = pairs.split_at(split.min(pairs.len()));
        for (&address, base) in &terrain.tiles {
            let wanted = &one_by_one[&address];
            let ground = &terrain.ground;
            let replayed =
                EditedTile::replay(ground, address, base.clone(), pairs.iter().copied(), &mut scratch);
            prop_assert!(&replayed == wanted, "{}", address);
            prop_assert_eq!(replayed.range(), replayed.tile().heights.range());
            prop_assert_eq!(
                ground_hash(address, replayed.tile()),
                ground_hash(address, wanted.tile())
            );
            let mut twice =
                EditedTile::replay(ground, address, base.clone(), first.iter().copied(), &mut scratch);
            twice.apply_all(ground, second.iter().copied(), &mut scratch);
            prop_assert!(&twice == wanted, "{}", address);
            prop_assert_eq!(replayed.base(), base);
        }
    }

    #[test]
    fn what_an_edit_changes_it_says_and_tiles_that_it_does_not_touch_stay(
        edit in edits(rough().file.size),
    ) {
        let terrain = rough();
        let mut scratch = EditScratch::default();
        let raster = terrain.ground.raster(&edit, &mut scratch);
        for (&address, base) in &terrain.tiles {
            let mut tile = EditedTile::new(address, base.clone());
            let change = tile.apply(&terrain.ground, &raster, &mut scratch);
            let (old, new) = (base, tile.tile());
            let touched = raster.footprint().touches(address);
            prop_assert!(touched || change == TileChange::default());
            let heights = raster.footprint().touches_heights(address);
            prop_assert!(heights || change.heights.is_empty());
            let inside = |rect: &SampleRect, x: i32, z: i32| {
                (rect.min[0]..rect.max[0]).contains(&x) && (rect.min[1]..rect.max[1]).contains(&z)
            };
            for z in -2..=130 {
                for x in -2..=130 {
                    let same = old.heights.get(x, z) == new.heights.get(x, z);
                    prop_assert!(same || inside(&change.heights, x, z));
                }
            }
            for z in 0..32 {
                for x in 0..32 {
                    let same = old.densities.get(x, z) == new.densities.get(x, z);
                    prop_assert!(same || inside(&change.densities, x, z), "{address} {x} {z}");
                    let texel = [x as u32, z as u32];
                    let same = old.errors.get(texel[0], texel[1]) == new.errors.get(texel[0], texel[1]);
                    prop_assert!(same || inside(&change.errors, x, z));
                }
            }
        }
    }

    #[test]
    fn nothing_panics_whatever_valid_edits_say(
        edits in prop::collection::vec(extreme_edits(), 1..4),
    ) {
        for edit in &edits {
            prop_assert_eq!(edit.validate(), Ok(()));
        }
        let terrain = rough();
        let tiles = terrain.after(&edits);
        for level in 0..terrain.ground.levels() {
            terrain.level(&tiles, level)?;
        }
        for tile in tiles.values() {
            for texel in tile.tile().errors.texels() {
                prop_assert!(texel[..7].is_sorted());
            }
        }
    }
}

#[test]
fn ground_that_is_gone_keeps_no_density_of_its_own() {
    // A cliff, which is dense, and a wide flat plain in its place.
    let terrain = rough();
    let centre = [300 * EDIT_UNITS, 160 * EDIT_UNITS];
    let flatten = Edit {
        centre,
        reach: 100 * EDIT_UNITS as u32,
        change: Change::Flatten {
            to: 30_000,
            strength: u16::MAX,
            hardness: 230,
            least: -65_535,
            most: 65_535,
        },
    };
    let tiles = terrain.after(&[crater(centre, 3000), flatten]);
    let tile = tiles[&TileAddress::new(0, 2, 1)].tile();
    assert!(
        terrain.tiles[&TileAddress::new(0, 2, 1)]
            .densities
            .get(11, 8)
            > 0
    );
    assert_eq!(tile.heights.get(44, 32), 30_000);
    assert_eq!(tile.densities.get(11, 8), 0);
}

#[test]
fn heights_are_cut_off_at_both_ends_and_the_change_says_so() {
    let terrain = smooth();
    let address = TileAddress::new(0, 1, 1);
    let mut scratch = EditScratch::default();
    for (by, end) in [(65_535, u16::MAX), (-65_535, 0)] {
        let edit = Edit {
            centre: [200 * EDIT_UNITS; 2],
            reach: 30 * EDIT_UNITS as u32,
            change: Change::Raise {
                by,
                hardness: 128,
                density: 3,
                may_clamp: true,
            },
        };
        let raster = terrain.ground.raster(&edit, &mut scratch);
        let mut tile = EditedTile::new(address, terrain.tiles[&address].clone());
        let change = tile.apply(&terrain.ground, &raster, &mut scratch);
        assert!(change.clamped);
        assert_eq!(tile.tile().heights.get(72, 72), end);
        let mut tile = EditedTile::new(address, terrain.tiles[&address].clone());
        let small = terrain
            .ground
            .raster(&crater([200 * EDIT_UNITS; 2], 999), &mut scratch);
        assert!(!tile.apply(&terrain.ground, &small, &mut scratch).clamped);
    }
}

#[test]
fn a_crater_looks_like_one() {
    let terrain = smooth();
    let mut scratch = EditScratch::default();
    let (middle, reach) = (200, 40);
    let mut edit = crater([middle * EDIT_UNITS; 2], (reach * EDIT_UNITS) as u32);
    let Change::Crater {
        roughness, bowl, ..
    } = &mut edit.change
    else {
        unreachable!()
    };
    *roughness = 0;
    let edge = reach as f64 * f64::from(*bowl) / 65536.0;
    let raster = terrain.ground.raster(&edit, &mut scratch);
    let along: Vec<i32> = (0..=reach)
        .map(|x| raster.value(0, [middle + x, middle]))
        .collect();
    assert_eq!(along[0], -1200);
    assert!(along[(edge * 0.5) as usize] < -700, "{along:?}");
    assert!(
        along[edge.floor() as usize] <= 0 && along[edge.ceil() as usize] >= 0,
        "{along:?}"
    );
    assert!(
        (396..=400).contains(along.iter().max().unwrap()),
        "{along:?}"
    );
    assert_eq!(along[reach as usize], 0);
    // Nowhere a kink: slopes change slowly.
    for window in along.windows(3) {
        assert!(
            (window[0] - 2 * window[1] + window[2]).abs() < 40,
            "{along:?}"
        );
    }
    // Round, and the same to all sides.
    for (x, &value) in (0..).zip(&along) {
        for place in [[-x, 0], [0, x], [0, -x]] {
            assert_eq!(raster.value(0, place.map(|at| at + middle)), value);
        }
    }
}

#[test]
fn a_rough_outline_stays_within_what_roughness_says() {
    let terrain = smooth();
    let mut scratch = EditScratch::default();
    let (middle, reach) = (200, 60);
    let mut edges = Vec::new();
    for seed in 0..20 {
        let mut edit = crater([middle * EDIT_UNITS; 2], (reach * EDIT_UNITS) as u32);
        if let Change::Crater { seed: own, .. } = &mut edit.change {
            *own = seed;
        }
        let raster = terrain.ground.raster(&edit, &mut scratch);
        for [x, z] in [[1, 0], [0, 1], [-1, 0], [0, -1]] {
            let inside = |at: i32| raster.value(0, [middle + at * x, middle + at * z]) < 0;
            edges.push((0..reach).take_while(|&at| inside(at)).count() as f64);
        }
    }
    let edge = f64::from(reach) * 40_000.0 / 65536.0;
    let least = edges.iter().copied().fold(f64::MAX, f64::min);
    let most = edges.iter().copied().fold(f64::MIN, f64::max);
    assert!(
        least >= edge / 1.25 - 1.0 && most <= edge / 0.75 + 1.0,
        "{least} {most} {edge}"
    );
    assert!(most - least > 4.0, "{least} {most}");
}

#[test]
fn a_coarse_levels_displacement_is_near_the_mean_of_the_fine_ones() {
    let terrain = smooth();
    let mut scratch = EditScratch::default();
    for reach in [3, 9, 26, 80, 180] {
        let edit = crater([201 * EDIT_UNITS + 17, 188 * EDIT_UNITS + 5], reach * 64);
        let raster = terrain.ground.raster(&edit, &mut scratch);
        let mut fine = BTreeMap::new();
        let (rect, _) = raster.level(0);
        for z in rect.min[1]..rect.max[1] {
            for x in rect.min[0]..rect.max[0] {
                fine.insert([x, z], f64::from(raster.value(0, [x, z])));
            }
        }
        for level in 1..terrain.ground.levels() {
            let mut coarse = BTreeMap::new();
            let grown = raster.level(level).0.grown(1);
            for z in grown.min[1]..grown.max[1] {
                for x in grown.min[0]..grown.max[0] {
                    let weights = [1.0, 2.0, 1.0];
                    let mut sum = 0.0;
                    for (i, a) in weights.iter().enumerate() {
                        for (j, b) in weights.iter().enumerate() {
                            let at = [2 * x + i as i32 - 1, 2 * z + j as i32 - 1];
                            sum += a * b * fine.get(&at).copied().unwrap_or(0.0);
                        }
                    }
                    coarse.insert([x, z], sum / 16.0);
                    let own = raster.value(level, [x, z]);
                    let size = terrain.file.samples(level);
                    let on = x >= 0 && z >= 0 && x < size[0] as i32 && z < size[1] as i32;
                    // A twelfth of the depth: small craters bend much from sample to sample.
                    let difference = (f64::from(own) - sum / 16.0).abs();
                    assert!(
                        !on || difference <= 1200.0 / 12.0,
                        "{reach} {level} {x} {z}: {difference}"
                    );
                }
            }
            fine = coarse;
        }
    }
}

#[test]
fn threads_and_the_order_of_tiles_change_nothing() {
    let terrain = rough();
    let edits: Vec<Edit> = (0..40)
        .map(|number| {
            let at = [number * 977 % 601, number * 631 % 330].map(|at| at * EDIT_UNITS + number);
            crater(at, 400 + 60 * number as u32)
        })
        .collect();
    let rasters = terrain.rasters(&edits);
    let hashes = |tiles: &Edited| -> Vec<u128> {
        tiles
            .iter()
            .map(|(&address, tile)| ground_hash(address, tile.tile()))
            .collect()
    };
    let wanted = hashes(&terrain.after(&edits));
    for threads in 1..=8 {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .expect("threads");
        let mut order: Vec<_> = terrain.tiles.iter().collect();
        let mut random = Random(threads as u64);
        for at in (1..order.len()).rev() {
            order.swap(at, (random.unit() * (at + 1) as f64) as usize);
        }
        let tiles: Edited = pool.install(|| {
            order
                .par_iter()
                .map_init(EditScratch::default, |scratch, (address, base)| {
                    let pairs = rasters
                        .iter()
                        .map(|raster| (raster.edit(), raster.footprint()));
                    let tile = EditedTile::replay(
                        &terrain.ground,
                        **address,
                        (*base).clone(),
                        pairs,
                        scratch,
                    );
                    (**address, tile)
                })
                .collect()
        });
        assert_eq!(hashes(&tiles), wanted, "{threads} threads");
    }
}

/// What craters do is written down in saves and sent to other machines: it must never change.
#[test]
fn displacements_are_those_of_every_version() {
    let mut scratch = EditScratch::default();
    let raster = smooth()
        .ground
        .raster(&crater([9999, 12345], 1717), &mut scratch);
    let mut bytes = Vec::new();
    for level in 0..smooth().ground.levels() {
        let (_, values) = raster.level(level);
        bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    }
    assert_eq!(crc32fast::hash(&bytes), 3471886973);
}
