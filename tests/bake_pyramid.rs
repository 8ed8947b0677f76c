//! A bake that streams makes what a bake of the whole picture at once would make: every tile is
//! a window of one function, parents cover their children, densities are never rounded down.

mod bake_support;

use bake_support::{addresses, bake_heights, densities, heights, landscape, manifest};
use bevy_tessera::bake::BakeSettings;
use bevy_tessera::density::curvature::Ring;
use bevy_tessera::density::{DensityBorder, DensityFilter, DensityKernel, DensitySettings};
use bevy_tessera::terrain::ManifestFile;
use bevy_tessera::tile::TileAddress;
use proptest::prelude::*;
use std::path::Path;

/// A grid whose indices are clamped to it.
struct Grid<T> {
    size: [i64; 2],
    values: Vec<T>,
}

impl<T: Copy> Grid<T> {
    fn new(size: [i64; 2], value: impl Fn(i64, i64) -> T) -> Self {
        let values = (0..size[1])
            .flat_map(|z| (0..size[0]).map(move |x| (x, z)))
            .map(|(x, z)| value(x, z))
            .collect();
        Self { size, values }
    }

    fn at(&self, x: i64, z: i64) -> T {
        let (x, z) = (x.clamp(0, self.size[0] - 1), z.clamp(0, self.size[1] - 1));
        self.values[(z * self.size[0] + x) as usize]
    }
}

/// The whole pyramid from the whole picture, as plainly as possible.
struct Reference {
    heights: Vec<Grid<u16>>,
    densities: Vec<Grid<u8>>,
}

fn reference(size: [u32; 2], metres: &[f32], file: &ManifestFile) -> Reference {
    let size = size.map(i64::from);
    let (low, step) = (file.height_min_m, file.height_step_m);
    let metres = Grid {
        size,
        values: metres.to_vec(),
    };
    let wanted = |x, z| ((f64::from(metres.at(x, z)) - low) / step).clamp(0.0, 65535.0);
    let mut heights = vec![Grid::new(size, |x, z| (wanted(x, z) + 0.5).floor() as u16)];
    let kernel = DensityKernel::new(&file.density, step, file.spacing_m, 0);

    let curvature = |x: i64, z: i64| {
        if x >= size[0] || z >= size[1] {
            return 0.0;
        }
        // Beyond the rim the ground goes on straight.
        let straight = |at: i64, count: i64, height: &dyn Fn(i64) -> f32| match at {
            -1 => 2.0 * height(0) - height(1),
            at if at == count => 2.0 * height(count - 1) - height(count - 2),
            at => height(at),
        };
        let height = |dx: i32, dz: i32| {
            straight(x + i64::from(dx), size[0], &|x| {
                straight(z + i64::from(dz), size[1], &|z| {
                    f32::from(heights[0].at(x, z))
                })
            })
        };
        file.density
            .filter
            .curvature(&Ring::new(height), kernel.step())
    };
    let texels = size.map(|count| (count - 1 + 3) / 4);
    let unspread = Grid::new(texels, |x, z| {
        let mut largest = 0_f32;
        for dz in 0..=4 {
            for dx in 0..=4 {
                largest = largest.max(curvature(4 * x + dx, 4 * z + dz));
            }
        }
        kernel.quantise(largest)
    });
    let settings = &file.density;
    let point_sampled = settings.border == DensityBorder::PointSampled;
    let on_border = |x: i64, z: i64| point_sampled && (x % 32 == 0 || z % 32 == 0);
    let mut densities = vec![Grid::new(texels, |x, z| {
        let side = match (settings.preprocess, on_border(x, z)) {
            (false, _) => 1,
            (true, false) => settings.filter_size,
            (true, true) => settings.filter_size << settings.lod_skip,
        };
        let around = || -i64::from(side / 2)..=i64::from(side / 2);
        let all = around().flat_map(|dz| around().map(move |dx| (dx, dz)));
        all.map(|(dx, dz)| unspread.at(x + dx, z + dz))
            .max()
            .expect("the texel itself")
    })];
    for _ in 1..file.levels {
        let fine = heights.last().expect("there is level 0");
        let half = fine.size.map(|count| count / 2 + 1);
        // Along one axis: the samples that a coarse one is a mean of. Beyond the rim the ground goes
        // on straight, within what can be stored.
        let along = |at: i64, count: i64, height: &dyn Fn(i64) -> i64, top: i64| {
            if at == count {
                4 * (2 * height(count - 1) - height(count - 2)).clamp(0, top)
            } else if at == 0 || at == count - 1 {
                4 * height(at)
            } else {
                height(at - 1) + 2 * height(at) + height(at + 1)
            }
        };
        let tent = Grid::new(half, |x, z| {
            let column = |x: i64| along(2 * z, fine.size[1], &|z| i64::from(fine.at(x, z)), 65535);
            ((along(2 * x, fine.size[0], &column, 4 * 65535) + 8) / 16) as u16
        });
        heights.push(tent);
        let fine = densities.last().expect("there is level 0");
        let half = fine.size.map(|count| (count + 1) / 2);
        let largest = Grid::new(half, |x, z| {
            let four = [(0, 0), (1, 0), (0, 1), (1, 1)];
            let of = |(dx, dz)| fine.at(2 * x + dx, 2 * z + dz);
            if on_border(x, z) {
                return of((0, 0));
            }
            four.into_iter().map(of).max().expect("four of them")
        });
        densities.push(largest);
    }
    Reference { heights, densities }
}

fn assert_equals_reference(dir: &Path, reference: &Reference) {
    let file = manifest(dir).file;
    for address in addresses(&file) {
        let level = usize::from(address.level);
        let (first_x, first_z) = (i64::from(address.x), i64::from(address.z));
        let tile = heights(dir, address);
        for z in -2..=130 {
            for x in -2..=130 {
                let wanted = reference.heights[level]
                    .at(first_x * 128 + i64::from(x), first_z * 128 + i64::from(z));
                assert_eq!(
                    tile.get(x, z),
                    wanted,
                    "height ({x}, {z}) of tile {address}"
                );
            }
        }
        let tile = densities(dir, address);
        for z in -1..=33 {
            for x in -1..=33 {
                let wanted = reference.densities[level]
                    .at(first_x * 32 + i64::from(x), first_z * 32 + i64::from(z));
                assert_eq!(
                    tile.get(x, z),
                    wanted,
                    "density ({x}, {z}) of tile {address}"
                );
            }
        }
    }
}

/// Settings of all sorts.
fn some_settings(seed: u32) -> DensitySettings {
    let pick = |of: u32, from: u32| (seed / from) % of;
    DensitySettings {
        filter: DensityFilter::ALL[pick(6, 1) as usize],
        gain: 0.4,
        exponent: [1.0, 0.75][pick(2, 6) as usize],
        preprocess: pick(4, 12) != 0,
        filter_size: [1, 2, 3, 7][pick(4, 48) as usize],
        border: DensityBorder::ALL[pick(2, 192) as usize],
        lod_skip: pick(4, 384),
    }
}

fn assert_streams_right(size: [u32; 2], seed: u32, band_rows: Option<u32>) {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    let metres = landscape(size, seed);
    let settings = BakeSettings {
        band_rows,
        spacing_m: Some(3.0),
        density: some_settings(seed),
        ..Default::default()
    };
    bake_heights(size, metres.clone(), &dir, &settings);
    let file = manifest(&dir).file;
    assert_equals_reference(&dir, &reference(size, &metres, &file));
}

#[test]
fn a_streamed_bake_equals_a_bake_of_the_whole_picture() {
    for (number, size) in [
        [2, 2],
        [3, 2],
        [2, 400],
        [129, 129],
        [130, 57],
        [257, 300],
        [128, 128],
        [385, 130],
        [600, 9],
    ]
    .into_iter()
    .enumerate()
    {
        for (variant, band_rows) in [None, Some(1), Some(37)].into_iter().enumerate() {
            let seed = 577 * number as u32 + 269 * variant as u32;
            assert_streams_right(size, seed, band_rows);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    #[test]
    fn a_streamed_bake_of_any_size_equals_a_bake_of_the_whole_picture(
        width in 2_u32..400,
        height in 2_u32..400,
        band in 1_u32..200,
        seed in any::<u32>(),
    ) {
        assert_streams_right([width, height], seed, Some(band));
    }
}

#[test]
fn neighbours_hold_identical_samples_where_both_hold_them() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    bake_heights(
        [523, 391],
        landscape([523, 391], 7),
        &dir,
        &BakeSettings::default(),
    );
    let file = manifest(&dir).file;
    let mut compared = 0;
    for address in addresses(&file) {
        let [columns, rows] = file.tiles(address.level);
        let (a_heights, a_densities) = (heights(&dir, address), densities(&dir, address));
        for (east, south) in [(1_i32, 0_i32), (0, 1), (1, 1), (-1, 1)] {
            let x = address.x.wrapping_add_signed(east);
            let z = address.z.wrapping_add_signed(south);
            if x >= columns || z >= rows {
                continue;
            }
            let other = TileAddress::new(address.level, x, z);
            let (b_heights, b_densities) = (heights(&dir, other), densities(&dir, other));
            for z in -2..=130 {
                for x in -2..=130 {
                    let (u, v) = (x - 128 * east, z - 128 * south);
                    if (-2..=130).contains(&u) && (-2..=130).contains(&v) {
                        assert_eq!(
                            a_heights.get(x, z),
                            b_heights.get(u, v),
                            "sample ({x}, {z}) of {address} in {other}"
                        );
                        compared += 1;
                    }
                }
            }
            for z in -1..=33 {
                for x in -1..=33 {
                    let (u, v) = (x - 32 * east, z - 32 * south);
                    if (-1..=33).contains(&u) && (-1..=33).contains(&v) {
                        assert_eq!(
                            a_densities.get(x, z),
                            b_densities.get(u, v),
                            "texel ({x}, {z}) of {address} in {other}"
                        );
                    }
                }
            }
        }
    }
    assert!(compared > 10_000, "only {compared} samples are shared");
}

#[test]
fn parents_cover_their_children() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    bake_heights(
        [700, 450],
        landscape([700, 450], 3),
        &dir,
        &BakeSettings::default(),
    );
    let terrain = manifest(&dir);
    let mut narrower = 0;
    for address in addresses(&terrain.file) {
        let range = terrain.index.get(address).expect("every tile is stored");
        let own = heights(&dir, address).range();
        assert!(range.covers(own), "{address}");
        narrower += u32::from(own != range);
        for child in address.children().into_iter().flatten() {
            if let Some(child_range) = terrain.index.get(child) {
                assert!(range.covers(child_range), "{child} in {address}");
            }
        }
    }
    // Filtering flattens peaks, so that the test would fail were ranges taken from tiles alone.
    assert!(narrower > 0);
}

#[test]
fn a_plane_has_no_density_and_a_ball_has_its_own_curvature() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let size = [200, 150];
    let plane: Vec<f32> = (0..200 * 150)
        .map(|at| (at % 200) as f32 * 0.5 - (at / 200) as f32 * 0.25)
        .collect();
    let dir = folder.path().join("plane");
    bake_heights(size, plane, &dir, &BakeSettings::default());
    for address in addresses(&manifest(&dir).file) {
        assert!(
            densities(&dir, address)
                .samples()
                .iter()
                .all(|&texel| texel == 0)
        );
    }

    // Mean curvature of a ball of 400 m, with samples 2 m apart: 2 / 400 a sample.
    let ball: Vec<f32> = (0..200 * 150)
        .map(|at| ((at % 200) as f64 - 100.0, (at / 200) as f64 - 75.0))
        .map(|(x, z)| (400.0_f64.powi(2) - 4.0 * (x * x + z * z)).sqrt() as f32)
        .collect();
    let dir = folder.path().join("ball");
    let settings = BakeSettings {
        spacing_m: Some(2.0),
        density: DensitySettings {
            gain: 100.0 / DensityFilter::Mean.scale(),
            ..Default::default()
        },
        headroom_m: 0.0,
        ..Default::default()
    };
    bake_heights(size, ball, &dir, &settings);
    let tile = densities(&dir, TileAddress::new(0, 0, 0));
    let wanted = 255.0 * 0.5;
    // A texel takes its largest curvature, to which rounding adds up to two steps.
    let rounding = 255.0 * 100.0 * manifest(&dir).file.height_step_m / 2.0;
    assert!(rounding < 20.0, "{rounding}");
    for (x, z) in [(0, 0), (12, 30), (25, 18)] {
        let found = f64::from(tile.get(x, z));
        assert!(
            found > wanted - 1.0 && found < wanted + 2.0 * rounding + 2.0,
            "{found} at ({x}, {z}), wanted {wanted}"
        );
    }
}

#[test]
fn flat_ground_bakes_with_and_without_headroom() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    for headroom_m in [0.0, 64.0] {
        let dir = folder.path().join(format!("flat{headroom_m}"));
        let settings = BakeSettings {
            headroom_m,
            ..Default::default()
        };
        let report = bake_heights([20, 30], vec![812.5; 600], &dir, &settings);
        assert!(report.height_step_m > 0.0);
        let tile = heights(&dir, TileAddress::new(0, 0, 0));
        let file = manifest(&dir).file;
        let found = file.height_m(tile.get(3, 4));
        assert!(
            (found - 812.5).abs() <= report.height_step_m * 0.5,
            "{found}"
        );
    }
}

#[test]
fn a_given_range_maps_to_all_stored_heights_and_clamps_what_lies_outside() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let dir = folder.path().join("terrain");
    let settings = BakeSettings {
        height_range_m: Some(-100.0..=6453.5),
        ..Default::default()
    };
    let metres = vec![
        -100.0, 6453.5, -200.0, 9000.0, 0.0, 0.04, 0.06, 100.0, -99.9,
    ];
    let report = bake_heights([3, 3], metres, &dir, &settings);
    assert_eq!(report.clamped, 2);
    let tile = heights(&dir, TileAddress::new(0, 0, 0));
    let row = |z| [0, 1, 2].map(|x| tile.get(x, z));
    assert_eq!(row(0), [0, 65535, 0]);
    assert_eq!(row(1), [65535, 1000, 1000]);
    assert_eq!(row(2), [1001, 2000, 1]);
}
