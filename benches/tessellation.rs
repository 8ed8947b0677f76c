//! What the density map saves and what it costs: vertices and triangles of a view with and without
//! it, and how far the drawn ground lies from the finest heights, in pixels.
//!
//! `cargo bench --no-default-features --features cli --bench tessellation`
//!
//! Everything is computed by the CPU twin, of the bundled terrain, all around the eye. An error is
//! the height difference at a sample times the focal length over the distance, as if seen from the
//! side.

use bevy_tessera::bake::import::{self, ImportSettings};
use bevy_tessera::bake::{BakeSettings, bake};
use bevy_tessera::lattice::{Lattice, LodSettings, Node, ResidencyField, ViewLod};
use bevy_tessera::terrain::TerrainManifest;
use bevy_tessera::tessellate::{FactorView, Pages, Partitioning, TerrainMesh, ViewMesh};
use bevy_tessera::tile::TerrainTile;
use glam::{DVec2, IVec2};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Half of 1200 pixels over the tangent of half of Bevy's 45 degrees.
const FOCAL_PX: f64 = 600.0 / 0.414_213_56;

struct Terrain {
    manifest: TerrainManifest,
    lattice: Lattice,
    pages: Pages,
    /// The finest heights in metres, row by row.
    heights_m: Vec<f32>,
}

fn terrain(dir: &Path) -> Terrain {
    let file = PathBuf::from(concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/assets/elevation/jacksboro_u16.png"
    ));
    let settings = ImportSettings {
        scale: Some(0.02),
        offset: Some(200.0),
        ..Default::default()
    };
    let mut source = import::open(&file, &settings).unwrap_or_else(|error| panic!("{error}"));
    let settings = BakeSettings {
        spacing_m: Some(30.0),
        ..Default::default()
    };
    bake(&mut *source, dir, &settings, &()).unwrap_or_else(|error| panic!("{error}"));
    let manifest = TerrainManifest::read(dir).unwrap_or_else(|error| panic!("{error}"));
    let file = &manifest.file;
    let mut pages = Pages::default();
    let mut heights_m = vec![0.0; (file.size[0] * file.size[1]) as usize];
    for (address, _) in manifest.index.iter() {
        let path = dir.join(TerrainTile::path(address));
        let bytes = std::fs::read(path).expect("it was baked just now");
        let tile = TerrainTile::decode(&bytes, address).expect("good");
        if address.level == 0 {
            for at in 0..129 * 129 {
                let (x, z) = (at % 129, at / 129);
                let (column, row) = (address.x * 128 + x, address.z * 128 + z);
                if column < file.size[0] && row < file.size[1] {
                    heights_m[(row * file.size[0] + column) as usize] =
                        file.height_m(tile.heights.get(x as i32, z as i32)) as f32;
                }
            }
        }
        pages.tiles.insert(address, Arc::new(tile));
    }
    Terrain {
        lattice: Lattice::new(file.size, file.levels, -2, 8).expect("it fits"),
        manifest,
        pages,
        heights_m,
    }
}

struct Eye {
    name: &'static str,
    place_m: DVec2,
    above_m: f64,
}

fn mesh(terrain: &Terrain, eye: &Eye, triangle_width_px: f64, density: f32) -> TerrainMesh {
    let Terrain {
        lattice, manifest, ..
    } = terrain;
    let file = &manifest.file;
    let (point, fraction) = lattice.lattice_from_local(eye.place_m, file.spacing_m);
    let floor = (eye.above_m / lattice.unit_m(file.spacing_m)) as i32;
    let lod = ViewLod::new(lattice, &LodSettings::default(), point, floor, true).expect("valid");
    let field = ResidencyField::new(lattice, 0);
    let view = FactorView {
        eye: point,
        eye_fraction: fraction,
        eye_height_m: eye_height_m(terrain, eye) as f32,
        unit_m: lattice.unit_m(file.spacing_m) as f32,
        segments_per_radian: (FOCAL_PX / triangle_width_px) as f32,
        segments_per_m: 0.0,
        min_triangle_m: file.spacing_m as f32,
        max_factor: 64.0,
        density_strength: density,
        focal_px: 900.0,
        px_per_m: 0.0,
        max_error_px: 0.0,
    };
    let mut nodes: Vec<Node> = Vec::new();
    lod.select(lattice, &mut |_, _| true, &mut |node| nodes.push(node));
    ViewMesh {
        lattice,
        lod: &lod,
        field: &field,
        factor_view: &view,
        partitioning: Partitioning::FractionalOdd,
        pages: &terrain.pages,
        height_min_m: file.height_min_m as f32,
        height_step_m: file.height_step_m as f32,
        max_vertices: u32::MAX,
        max_triangles: u32::MAX,
        culling: None,
    }
    .build(&nodes)
}

fn eye_height_m(terrain: &Terrain, eye: &Eye) -> f64 {
    let file = &terrain.manifest.file;
    let sample = (eye.place_m / file.spacing_m).as_uvec2();
    f64::from(terrain.heights_m[(sample.y * file.size[0] + sample.x) as usize]) + eye.above_m
}

/// Errors in pixels at all samples of the finest level, sorted.
fn errors_px(terrain: &Terrain, eye: &Eye, mesh: &TerrainMesh) -> Vec<f64> {
    let file = &terrain.manifest.file;
    let log2 = terrain.lattice.unit_log2;
    let mut drawn = vec![f32::NAN; terrain.heights_m.len()];
    for triangle in &mesh.triangles {
        let corners = triangle.map(|vertex| mesh.vertices[vertex as usize]);
        let [a, b, c] = corners.map(|vertex| vertex.point.as_dvec2());
        let area = (b - a).perp_dot(c - a);
        if area == 0.0 {
            continue;
        }
        let low = corners.iter().fold(IVec2::MAX, |low, v| low.min(v.point));
        let high = corners.iter().fold(IVec2::MIN, |high, v| high.max(v.point));
        let unit = 1 << log2;
        let first = (low + (unit - 1)) >> IVec2::splat(log2 as i32);
        let last = high >> IVec2::splat(log2 as i32);
        for z in first.y..=last.y {
            for x in first.x..=last.x {
                let p = (IVec2::new(x, z) << IVec2::splat(log2 as i32)).as_dvec2();
                let weights =
                    [(b - p).perp_dot(c - p), (c - p).perp_dot(a - p)].map(|part| part / area);
                let weights = [weights[0], weights[1], 1.0 - weights[0] - weights[1]];
                if weights.iter().any(|&weight| weight < -1e-9) {
                    continue;
                }
                let height: f64 = (0..3)
                    .map(|k| weights[k] * f64::from(corners[k].height_m))
                    .sum();
                drawn[(z as u32 * file.size[0] + x as u32) as usize] = height as f32;
            }
        }
    }
    let eye_m = eye_height_m(terrain, eye);
    let mut errors: Vec<f64> = drawn
        .iter()
        .zip(&terrain.heights_m)
        .enumerate()
        .filter(|(_, (drawn, _))| !drawn.is_nan())
        .map(|(at, (&drawn, &height))| {
            let place = DVec2::new(
                (at as u32 % file.size[0]).into(),
                (at as u32 / file.size[0]).into(),
            );
            let plane = (place * file.spacing_m - eye.place_m).length();
            let distance = plane.hypot(f64::from(height) - eye_m).max(1.0);
            f64::from((drawn - height).abs()) * FOCAL_PX / distance
        })
        .collect();
    errors.sort_by(f64::total_cmp);
    errors
}

fn main() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let terrain = terrain(&folder.path().join("terrain"));
    let eyes = [
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
    println!("view                 width  density   vertices  triangles    max px  99.9 %     RMS");
    for eye in &eyes {
        for width_px in [2.0, 4.0, 6.0, 8.0, 12.0] {
            for density in [0.0, 0.5, 1.0] {
                let mesh = mesh(&terrain, eye, width_px, density);
                let errors = errors_px(&terrain, eye, &mesh);
                let count = errors.len() as f64;
                let rms = (errors.iter().map(|error| error * error).sum::<f64>() / count).sqrt();
                println!(
                    "{:20} {width_px:5}  {density:7}  {:9}  {:9}  {:8.2}  {:6.2}  {rms:6.3}",
                    eye.name,
                    mesh.vertices.len(),
                    mesh.triangles.len(),
                    errors[errors.len() - 1],
                    errors[(0.999 * (count - 1.0)) as usize],
                );
            }
        }
    }
}
