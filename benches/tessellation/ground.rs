//! The ground that everything is measured on, the eyes that look at it, and pixels.

use bevy_tessera::bake::{BakeSettings, MemorySource, bake};
use bevy_tessera::terrain::TerrainManifest;
use bevy_tessera::tessellate::Pages;
use bevy_tessera::tile::TerrainTile;
use glam::DVec2;
use std::path::Path;
use std::sync::Arc;

/// Metres between two samples of the bundled terrain.
const SPACING_M: f64 = 30.0;
/// What a unit of its picture is worth, and where it begins, in metres.
const CODE_M: f32 = 0.02;
const CODE_ZERO_M: f32 = 200.0;

/// The finest heights: all that errors are measured against and that references are made of.
pub struct Samples {
    /// Samples in x and z.
    pub size: [u32; 2],
    /// Metres, row by row.
    pub heights_m: Vec<f32>,
}

impl Samples {
    /// The number of the sample in column `x` of row `z`.
    pub fn number(&self, x: u32, z: u32) -> usize {
        (z * self.size[0] + x) as usize
    }

    /// The height at a sample; beyond the rim, that of the rim.
    pub fn height_m(&self, x: i32, z: i32) -> f64 {
        let inside = |at: i32, count: u32| at.clamp(0, count as i32 - 1) as u32;
        let number = self.number(inside(x, self.size[0]), inside(z, self.size[1]));
        f64::from(self.heights_m[number])
    }
}

/// A baked terrain, read whole.
pub struct Ground {
    pub manifest: TerrainManifest,
    pub pages: Pages,
    /// Heights as they are stored.
    pub samples: Samples,
}

impl Ground {
    /// Bakes the bundled terrain into `dir` and reads it back.
    ///
    /// Not by `bake::import`, so that the bench needs none of the crate's features.
    pub fn bundled(dir: &Path) -> Self {
        let file = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/assets/elevation/jacksboro_u16.png"
        );
        let codes = image::open(file)
            .unwrap_or_else(|error| panic!("{file}: {error}"))
            .into_luma16();
        let size = [codes.width(), codes.height()];
        let heights_m = codes
            .as_raw()
            .iter()
            .map(|&code| CODE_M.mul_add(f32::from(code), CODE_ZERO_M))
            .collect();
        let mut source = MemorySource::new(size, heights_m)
            .expect("a picture has all its pixels")
            .with_spacing_m(SPACING_M);
        bake(&mut source, dir, &BakeSettings::default(), &())
            .unwrap_or_else(|error| panic!("{error}"));
        Self::read(dir)
    }

    fn read(dir: &Path) -> Self {
        let manifest = TerrainManifest::read(dir).unwrap_or_else(|error| panic!("{error}"));
        let file = &manifest.file;
        let size = file.size;
        let mut pages = Pages::default();
        let mut heights_m = vec![0.0; (size[0] * size[1]) as usize];
        for (address, _) in manifest.index.iter() {
            let path = dir.join(TerrainTile::path(address));
            let bytes = std::fs::read(path).expect("it was baked just now");
            let tile = TerrainTile::decode(&bytes, address).expect("good");
            if address.level == 0 {
                for at in 0..129 * 129 {
                    let (x, z) = (at % 129, at / 129);
                    let (column, row) = (address.x * 128 + x, address.z * 128 + z);
                    if column < size[0] && row < size[1] {
                        heights_m[(row * size[0] + column) as usize] =
                            file.height_m(tile.heights.get(x as i32, z as i32)) as f32;
                    }
                }
            }
            pages.tiles.insert(address, Arc::new(tile));
        }
        Self {
            manifest,
            pages,
            samples: Samples { size, heights_m },
        }
    }

    /// Metres between two samples.
    pub fn spacing_m(&self) -> f64 {
        self.manifest.file.spacing_m
    }
}

/// Where a picture is taken from.
#[derive(Clone, Copy)]
pub struct Eye {
    pub name: &'static str,
    /// Metres from the terrain's corner.
    pub place_m: DVec2,
    /// Metres above the ground.
    pub above_m: f64,
}

/// The two eyes of all comparisons: one as a player sees the ground (the thesis's figure 4.13a),
/// one that overlooks it (figure 4.13b).
pub const EYES: [Eye; 2] = [
    Eye {
        name: "in action, 2 m up",
        place_m: DVec2::new(13_400.0, 14_200.0),
        above_m: 2.0,
    },
    Eye {
        name: "vista, 400 m up",
        place_m: DVec2::new(9_000.0, 21_000.0),
        above_m: 400.0,
    },
];

impl Eye {
    /// Metres above the terrain's origin.
    pub fn height_m(&self, ground: &Ground) -> f64 {
        let sample = (self.place_m / ground.spacing_m()).as_ivec2();
        ground.samples.height_m(sample.x, sample.y) + self.above_m
    }
}

/// The focal length in pixels of a picture `height_px` high that takes in `angle_deg` from top to
/// bottom.
pub fn focal_px(height_px: f64, angle_deg: f64) -> f64 {
    0.5 * height_px / (0.5 * angle_deg).to_radians().tan()
}

/// How large a metre of height at each sample is in an eye's picture, in pixels, row by row: the
/// focal length over the distance, as if seen from the side.
pub fn px_per_m(ground: &Ground, eye: &Eye, focal_px: f64) -> Vec<f32> {
    let eye_m = eye.height_m(ground);
    let spacing_m = ground.spacing_m();
    let Samples { size, heights_m } = &ground.samples;
    (0..heights_m.len())
        .map(|sample| {
            let at = sample as u32;
            let place = DVec2::new((at % size[0]).into(), (at / size[0]).into());
            let plane_m = (place * spacing_m - eye.place_m).length();
            let up_m = f64::from(heights_m[sample]) - eye_m;
            // Nearer than a metre it would grow without bounds.
            (focal_px / plane_m.hypot(up_m).max(1.0)) as f32
        })
        .collect()
}
