//! Where the filters' scales come from: curvature of real ground, texel by texel.
//!
//! `TESSERA_DATA=… cargo bench --no-default-features --features cli --bench density_scales`
//!
//! Every elevation model counts as much as any other. A filter's scale takes the curvature that
//! 90 % of all texels stay below to the density 1; what is printed last is what
//! `DensityFilter::scale` holds, rounded.

use bevy_tessera::bake::import::{self, ImportSettings};
use bevy_tessera::density::DensityFilter;
use bevy_tessera::density::curvature::Ring;
use std::path::PathBuf;

/// The share of texels whose density stays below 1 at a gain of 1.
const BELOW_ONE: f64 = 0.9;

struct Model {
    name: String,
    size: [usize; 2],
    spacing_m: f64,
    heights_m: Vec<f32>,
}

fn models() -> Vec<Model> {
    let bundled = PathBuf::from(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/assets/elevation/jacksboro_u16.png"
    ));
    let mut files = vec![(bundled, 0.02, 30.0)];
    if let Some(data) = std::env::var_os("TESSERA_DATA") {
        let terrain = PathBuf::from(data).join("terrain");
        // What a unit is worth and how far samples lie apart, as that folder's notes say.
        for (file, scale, spacing_m) in [
            ("taiwan_z12_4096_u16.png", 0.1, 38.0),
            ("puget_sound_1025_u16.png", 0.1, 160.0),
            ("mt_rainier_90m.tif", 1.0, 90.0),
            ("N44W072.hgt", 1.0, 90.0),
            ("slovenia_lidar_1m_f32.tif", 1.0, 1.0),
        ] {
            files.push((terrain.join(file), scale, spacing_m));
        }
    } else {
        println!("TESSERA_DATA is not set: the bundled model alone is looked at");
    }
    files
        .into_iter()
        .map(|(path, scale, spacing_m)| read(&path, scale, spacing_m))
        .collect()
}

fn read(path: &std::path::Path, scale: f64, spacing_m: f64) -> Model {
    let plain = path.extension().is_some_and(|extension| extension == "png");
    let settings = ImportSettings {
        scale: plain.then_some(scale),
        offset: plain.then_some(0.0),
        ..Default::default()
    };
    let mut source = import::open(path, &settings).unwrap_or_else(|error| panic!("{error}"));
    let [width, height] = source.size().map(|side| side as usize);
    let mut heights_m = vec![0.0; width * height];
    for row in heights_m.chunks_exact_mut(width) {
        source
            .read_row(row)
            .unwrap_or_else(|error| panic!("{error}"));
    }
    Model {
        name: path
            .file_stem()
            .map_or(String::new(), |name| name.to_string_lossy().into_owned()),
        size: [width, height],
        spacing_m,
        heights_m,
    }
}

impl Model {
    /// The model with half the samples a side: means with the weights 1 2 1, 2 4 2, 1 2 1, as the
    /// levels of a terrain are made.
    fn halved(&self) -> Self {
        let [width, height] = self.size;
        let at = |x: usize, z: usize| self.heights_m[z.min(height - 1) * width + x.min(width - 1)];
        let size = [width / 2, height / 2];
        let mut heights_m = Vec::with_capacity(size[0] * size[1]);
        for z in 0..size[1] {
            for x in 0..size[0] {
                let mut sum = 0.0;
                for (dz, wz) in [(0, 1.0), (1, 2.0), (2, 1.0)] {
                    for (dx, wx) in [(0, 1.0), (1, 2.0), (2, 1.0)] {
                        sum += wz * wx * at((2 * x + dx).max(1) - 1, (2 * z + dz).max(1) - 1);
                    }
                }
                heights_m.push(sum / 16.0);
            }
        }
        Self {
            name: self.name.clone(),
            size,
            spacing_m: 2.0 * self.spacing_m,
            heights_m,
        }
    }

    /// The largest curvature of every texel that has data, sorted.
    fn curvatures(&self, filter: DensityFilter) -> Vec<f32> {
        let [width, height] = self.size;
        let unit = (1.0 / self.spacing_m) as f32;
        let mut texels = Vec::new();
        for z in (4..height - 8).step_by(4) {
            for x in (4..width - 8).step_by(4) {
                let mut largest = 0.0_f32;
                for at in 0..25 {
                    let (x, z) = ((x + at % 5) as i32, (z + at / 5) as i32);
                    let height = |dx: i32, dz: i32| {
                        self.heights_m[(z + dz) as usize * width + (x + dx) as usize]
                    };
                    let curvature = filter.curvature(&Ring::new(height), unit);
                    // NaN, where there is no data, wins over every number.
                    if curvature.is_nan() || curvature > largest {
                        largest = curvature;
                    }
                }
                if !largest.is_nan() {
                    texels.push(largest);
                }
            }
        }
        texels.sort_by(f32::total_cmp);
        texels
    }
}

fn share_below(sorted: &[f32], curvature: f32) -> f64 {
    sorted.partition_point(|&texel| texel < curvature) as f64 / sorted.len() as f64
}

fn main() {
    let models = models();
    for filter in DensityFilter::ALL {
        println!("\n{filter}");
        println!("model                      50 %      75 %      90 %      95 %      99 %");
        let all: Vec<Vec<f32>> = models
            .iter()
            .map(|model| model.curvatures(filter))
            .collect();
        for (model, sorted) in models.iter().zip(&all) {
            let at = |share: f64| sorted[((sorted.len() - 1) as f64 * share) as usize];
            print!("{:22}", model.name);
            for share in [0.5, 0.75, 0.9, 0.95, 0.99] {
                print!("  {:8.5}", at(share));
            }
            println!();
        }
        // The curvature below which the wanted share of texels stays, every model counting alike.
        let (mut low, mut high) = (0.0_f32, 100.0_f32);
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            let share: f64 = all.iter().map(|sorted| share_below(sorted, middle)).sum();
            if share < BELOW_ONE * all.len() as f64 {
                low = middle;
            } else {
                high = middle;
            }
        }
        println!("scale {:.4} (stored: {})", 1.0 / high, filter.scale());
        let density = |sorted: &[f32]| {
            let sum: f64 = sorted
                .iter()
                .map(|&texel| f64::from((texel * filter.scale()).min(1.0)))
                .sum();
            sum / sorted.len() as f64
        };
        let means: Vec<String> = all
            .iter()
            .map(|sorted| format!("{:.3}", density(sorted)))
            .collect();
        println!("mean densities at the stored scale: {}", means.join(", "));
    }

    let filter = DensityFilter::default();
    println!("\nmean density at 1, 2, 4 and 8 times the spacing, {filter}");
    for model in models {
        print!("{:22}", model.name);
        let mut model = model;
        for _ in 0..4 {
            print!("  {:.3}", mean_density(&model.curvatures(filter), filter));
            model = model.halved();
        }
        println!();
    }
}

fn mean_density(sorted: &[f32], filter: DensityFilter) -> f64 {
    let density = |&texel: &f32| f64::from((texel * filter.scale()).min(1.0));
    sorted.iter().map(density).sum::<f64>() / sorted.len() as f64
}
