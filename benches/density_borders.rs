//! What point-sampled borders cost: how far the densities along tiles' borders fall short of the
//! ground that they cover, level by level. The other scheme takes the largest and never does.
//!
//! `TESSERA_DATA=… cargo bench --no-default-features --features cli --bench density_borders`
//!
//! Draws the same ground at three levels with both schemes into the file that `TESSERA_PICTURE`
//! names, if it does.

use bevy_tessera::bake::import::{self, ImportSettings};
use bevy_tessera::bake::{BakeSettings, bake, rebake_densities};
use bevy_tessera::density::{DensityBorder, DensitySettings, texels_of};
use bevy_tessera::terrain::TerrainManifest;
use bevy_tessera::tile::{DensityTile, TileAddress, tile_path};
use image::{Rgb, RgbImage};
use std::path::{Path, PathBuf};

/// All densities of a level, row by row.
struct Map {
    size: [u32; 2],
    texels: Vec<u8>,
}

impl Map {
    fn at(&self, x: u32, z: u32) -> u8 {
        self.texels[(z * self.size[0] + x) as usize]
    }
}

fn read(dir: &Path) -> Vec<Map> {
    let file = TerrainManifest::read(dir)
        .expect("it was baked just now")
        .file;
    let level = |level: u8| {
        let size = file.samples(level).map(texels_of);
        let mut texels = vec![0; (size[0] * size[1]) as usize];
        let [columns, rows] = file.tiles(level);
        for at in 0..columns * rows {
            let address = TileAddress::new(level, at % columns, at / columns);
            let bytes = std::fs::read(dir.join(tile_path(address))).expect("readable");
            let tile = DensityTile::decode(&bytes, address).expect("a good tile");
            for texel in 0..1024 {
                let (x, z) = (texel % 32 + 32 * address.x, texel / 32 + 32 * address.z);
                if x < size[0] && z < size[1] {
                    let own = tile.get((texel % 32) as i32, (texel / 32) as i32);
                    texels[(z * size[0] + x) as usize] = own;
                }
            }
        }
        Map { size, texels }
    };
    (0..file.levels).map(level).collect()
}

fn terrain(dir: &Path, file: &Path, scale: f64, spacing_m: f64) {
    let settings = ImportSettings {
        scale: Some(scale),
        offset: Some(0.0),
        ..Default::default()
    };
    let mut source = import::open(file, &settings).unwrap_or_else(|error| panic!("{error}"));
    let settings = BakeSettings {
        spacing_m: Some(spacing_m),
        ..Default::default()
    };
    bake(&mut *source, dir, &settings, &()).unwrap_or_else(|error| panic!("{error}"));
}

fn compare(name: &str, dir: &Path) {
    println!("\n{name}");
    println!(
        "filter size  lod skip  level  border texels  short by, mean  99 %   more than 1/4 short"
    );
    for filter_size in [1, 3] {
        let none = DensitySettings {
            filter_size,
            ..Default::default()
        };
        rebake_densities(dir, &none, &()).expect("it can be made anew");
        let full = read(dir);
        for lod_skip in 0..=2 {
            let point = DensitySettings {
                border: DensityBorder::PointSampled,
                lod_skip,
                ..none.clone()
            };
            rebake_densities(dir, &point, &()).expect("it can be made anew");
            for (level, (point, full)) in read(dir).iter().zip(&full).enumerate().skip(1).take(4) {
                let mut short = Vec::new();
                for at in 0..full.size[0] * full.size[1] {
                    let (x, z) = (at % full.size[0], at / full.size[0]);
                    if x.is_multiple_of(32) || z.is_multiple_of(32) {
                        short.push(full.at(x, z).saturating_sub(point.at(x, z)));
                    }
                }
                short.sort_unstable();
                let count = short.len() as f64;
                let mean = short.iter().map(|&short| f64::from(short)).sum::<f64>() / count;
                println!(
                    "{filter_size:11}  {lod_skip:8}  {level:5}  {:13}  {:14.3}  {:4.2}  {:18.1} %",
                    short.len(),
                    mean / 255.0,
                    f64::from(short[(0.99 * (count - 1.0)) as usize]) / 255.0,
                    100.0 * short.iter().filter(|&&short| short > 63).count() as f64 / count
                );
            }
        }
    }
}

/// The same ground at levels 0, 1 and 2 (columns), as the largest and point-sampled (rows).
fn draw(dir: &Path, out: &str) {
    const SIDE: u32 = 384;
    let mut picture = RgbImage::from_pixel(3 * SIDE + 8, 2 * SIDE + 4, Rgb([255; 3]));
    for (row, border) in DensityBorder::ALL.into_iter().enumerate() {
        let settings = DensitySettings {
            border,
            ..Default::default()
        };
        rebake_densities(dir, &settings, &()).expect("it can be made anew");
        let maps = read(dir);
        for level in 0..=2_u32 {
            let map = &maps[level as usize];
            // Around a corner of four tiles of level 2, which is one of the others' as well.
            let corner = 32 << (2 - level);
            for at in 0..SIDE * SIDE {
                // Sixteen texels of level 2 a side, and as much ground of the finer levels.
                let shown = 16 << (2 - level);
                let texel =
                    |at: u32, size: u32| (corner - shown / 2 + at * shown / SIDE).min(size - 1);
                let (x, z) = (at % SIDE, at / SIDE);
                let (tx, tz) = (texel(x, map.size[0]), texel(z, map.size[1]));
                let density = f32::from(map.at(tx, tz)) / 255.0;
                let mix = |low: f32, middle: f32, high: f32| {
                    let value = if density < 0.5 {
                        low + (middle - low) * density * 2.0
                    } else {
                        middle + (high - middle) * (density * 2.0 - 1.0)
                    };
                    value as u8
                };
                let colour = Rgb([
                    mix(40.0, 240.0, 210.0),
                    mix(160.0, 210.0, 30.0),
                    mix(60.0, 50.0, 30.0),
                ]);
                let left = level * (SIDE + 4);
                picture.put_pixel(left + x, row as u32 * (SIDE + 4) + z, colour);
            }
        }
    }
    picture.save(out).expect("the picture can be written");
}

fn main() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let bundled = PathBuf::from(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/assets/elevation/jacksboro_u16.png"
    ));
    let dir = folder.path().join("jacksboro");
    terrain(&dir, &bundled, 0.02, 30.0);
    compare("jacksboro, 30 m", &dir);
    if let Ok(out) = std::env::var("TESSERA_PICTURE") {
        draw(&dir, &out);
    }
    let Some(data) = std::env::var_os("TESSERA_DATA") else {
        println!("TESSERA_DATA is not set: that is all");
        return;
    };
    let file = PathBuf::from(data).join("terrain/taiwan_z12_4096_u16.png");
    let dir = folder.path().join("taiwan");
    terrain(&dir, &file, 0.1, 38.0);
    compare("taiwan, 38 m", &dir);
}
