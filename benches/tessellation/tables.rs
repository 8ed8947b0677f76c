//! What the density map saves, which defaults suit it, and how near and far an eye may be.

use crate::curves::Step;
use crate::ground::{EYES, Eye, Ground, px_per_m};
use crate::measure::errors_of;
use crate::policy::{Policy, Setup};
use crate::table::{Cell, Table};
use bevy_tessera::lattice::ONE;
use bevy_tessera::tessellate::{Pages, Partitioning, ViewMesh};
use glam::{DVec2, DVec3, IVec2};
use std::path::Path;

/// Vertices without and with a density map in the views of figures 4.13a and b, the thesis's table 4.2.
const THESIS_VERTICES: [[usize; 2]; 2] = [[667_060, 249_222], [511_723, 209_485]];

/// Vertices and triangles with and without the density map, for the two eyes.
pub fn saved(ground: &Ground, folder: &Path) {
    let heads = [
        "view",
        "triangle width",
        "density",
        "vertices",
        "triangles",
        "largest px",
        "99.9 % below px",
        "RMS px",
        "times fewer vertices",
        "largest px more",
    ];
    let mut table = Table::new("What the density map saves", &heads);
    for (eye, thesis) in EYES.iter().zip(THESIS_VERTICES) {
        let px_per_m = px_per_m(ground, eye, Setup::default().focal_px);
        for width_px in [4.0, 6.0, 8.0, 12.0] {
            let step = |density_strength: f32| {
                let setup = Setup {
                    triangle_width_px: width_px,
                    density_strength,
                    ..Default::default()
                };
                let (mesh, _) = setup.mesh(ground, eye);
                Step::new(width_px, &mesh, ground, &px_per_m)
            };
            let (off, on) = (step(0.0), step(1.0));
            let times = off.vertices as f64 / on.vertices as f64;
            let more_px = on.errors.largest_px - off.errors.largest_px;
            let which = |density: &str| {
                let width = Cell::Text(format!("{width_px} px"));
                [eye.name.into(), width, density.into()]
            };
            let compared = [Cell::Nothing, Cell::Nothing];
            table.row(which("off").into_iter().chain(off.cells()).chain(compared));
            let compared = [Cell::Number(times, 2), Cell::Number(more_px, 2)];
            table.row(which("on").into_iter().chain(on.cells()).chain(compared));
        }
        for (density, vertices) in ["off", "on"].into_iter().zip(thesis) {
            let times = thesis[0] as f64 / vertices as f64;
            let mut row: Vec<Cell> = vec![
                eye.name.into(),
                "the thesis".into(),
                density.into(),
                vertices.into(),
            ];
            row.extend((0..4).map(|_| Cell::Nothing));
            row.push(if density == "on" {
                Cell::Number(times, 2)
            } else {
                Cell::Nothing
            });
            row.push(Cell::Nothing);
            table.row(row);
        }
    }
    table.finish(folder, "tessellation_saved");
}

/// The four partitionings where the ground's own samples limit factors, and where they don't: which
/// of them put vertices on samples.
pub fn partitionings(ground: &Ground, folder: &Path) {
    let heads = [
        "view",
        "triangle width",
        "density",
        "partitioning",
        "vertices",
        "triangles",
        "largest px",
        "99.9 % below px",
        "RMS px",
    ];
    let mut table = Table::new("Partitionings", &heads);
    for eye in &EYES {
        let px_per_m = px_per_m(ground, eye, Setup::default().focal_px);
        for (width_px, density) in [(2.0, "off"), (4.0, "off"), (4.0, "on")] {
            for partitioning in Partitioning::ALL {
                let setup = Setup {
                    triangle_width_px: width_px,
                    density_strength: if density == "on" { 1.0 } else { 0.0 },
                    partitioning,
                    ..Default::default()
                };
                let (mesh, _) = setup.mesh(ground, eye);
                let step = Step::new(width_px, &mesh, ground, &px_per_m);
                let which = [
                    Cell::from(eye.name),
                    Cell::Text(format!("{width_px} px")),
                    density.into(),
                    Cell::Text(format!("{partitioning:?}")),
                ];
                table.row(which.into_iter().chain(step.cells()));
            }
        }
    }
    table.finish(folder, "tessellation_partitionings");
}

/// Faces along a node's side and triangle widths, with the density map (the thesis's figures 4.5 to
/// 4.11, with errors in place of milliseconds).
pub fn sweep(ground: &Ground, folder: &Path) {
    let heads = [
        "view",
        "faces a side",
        "triangle width",
        "nodes",
        "vertices",
        "triangles",
        "largest px",
        "99.9 % below px",
        "RMS px",
    ];
    let mut table = Table::new("Faces a side and triangle width, with density", &heads);
    for eye in &EYES {
        let px_per_m = px_per_m(ground, eye, Setup::default().focal_px);
        for faces_per_side in [4, 8, 16] {
            for triangle_width_px in [4.0, 6.0, 8.0, 12.0] {
                let setup = Setup {
                    faces_per_side,
                    triangle_width_px,
                    density_strength: 1.0,
                    ..Default::default()
                };
                let (mesh, nodes) = setup.mesh(ground, eye);
                let step = Step::new(triangle_width_px, &mesh, ground, &px_per_m);
                let which = [
                    Cell::from(eye.name),
                    Cell::Count(faces_per_side as usize),
                    Cell::Text(format!("{triangle_width_px} px")),
                    Cell::Count(nodes),
                ];
                table.row(which.into_iter().chain(step.cells()));
            }
        }
    }
    table.finish(folder, "tessellation_sweep");
}

/// What is missing where levels coarser than the finest are drawn, were each drawn without an error:
/// the price of a shorter reach, and what a longer one costs.
pub fn levels(ground: &Ground, folder: &Path) {
    let heads = [
        "view",
        "reach",
        "nodes",
        "triangles at 2 px",
        "largest px",
        "99.9 % below px",
        "RMS px",
    ];
    let mut table = Table::new(
        "What coarser levels leave out of the finest heights",
        &heads,
    );
    for eye in &EYES {
        let px_per_m = px_per_m(ground, eye, Setup::default().focal_px);
        for reach in [4.0, 6.0, 8.0, 12.0, 16.0] {
            let setup = Setup {
                reach,
                ..Policy::ScreenErrorEven.setup(2.0)
            };
            let drawn_m = setup.view(ground, eye, |view, _| drawn_levels_m(ground, view));
            let errors = errors_of(&ground.samples, &px_per_m, &drawn_m);
            let (mesh, nodes) = setup.mesh(ground, eye);
            table.row([
                Cell::from(eye.name),
                Cell::Text(format!("{reach}")),
                Cell::Count(nodes),
                Cell::Count(mesh.triangles.len()),
                Cell::Number(errors.largest_px, 2),
                Cell::Number(errors.most_px, 2),
                Cell::Number(errors.rms_px, 3),
            ]);
        }
    }
    table.finish(folder, "tessellation_levels");
}

/// At every sample the height of the levels that are drawn there.
fn drawn_levels_m(ground: &Ground, view: &ViewMesh<Pages>) -> Vec<f64> {
    let [columns, rows] = ground.samples.size;
    let samples = (0..rows).flat_map(|z| (0..columns).map(move |x| (x, z)));
    samples
        .map(|(x, z)| {
            let p = IVec2::new(x as i32, z as i32) << IVec2::splat(view.lattice.unit_log2 as i32);
            let mut level = view.lattice.leaf_level;
            // A level that has morphed all the way is the next one.
            while level < view.lattice.root_level && view.lod.morph(view.lattice, p, level) == ONE {
                level += 1;
            }
            view.displaced(p, level).0.into()
        })
        .collect()
}

/// Triangles over which a size is taken in the middle: fractional segments differ beside each other.
const SIZED_TRIANGLES: usize = 100;

#[derive(Clone, Copy)]
struct Sized {
    distance_m: f64,
    longest_edge_m: f64,
}

/// The medians of some triangles.
fn median(triangles: &[Sized]) -> Sized {
    let middle = |of: fn(&Sized) -> f64| {
        let mut all: Vec<f64> = triangles.iter().map(of).collect();
        all.sort_by(f64::total_cmp);
        all[all.len() / 2]
    };
    Sized {
        distance_m: middle(|sized| sized.distance_m),
        longest_edge_m: middle(|sized| sized.longest_edge_m),
    }
}

/// One setup for an eye a hand above the ground, for one that walks, and for one in space.
pub fn depth(ground: &Ground, folder: &Path) {
    let heads = [
        "eye above ground",
        "nodes",
        "vertices",
        "triangles",
        "nearest 100: m away",
        "nearest 100: longest edge m",
        "nearest 100: px",
        "farthest 100: m away",
        "farthest 100: longest edge m",
        "farthest 100: px",
    ];
    let title = "Depth of view: leaf level -8, triangles 12 px wide and at least 1 cm, density off";
    let mut table = Table::new(title, &heads);
    let setup = Setup {
        leaf_level: -8,
        triangle_width_px: 12.0,
        min_triangle_m: Some(0.01),
        ..Default::default()
    };
    for (name, above_m) in [("6 cm", 0.06), ("2 m", 2.0), ("30 km", 30_000.0)] {
        let eye = Eye {
            name,
            // On a sample near a corner, so that there is ground 40 km away.
            place_m: DVec2::splat(50.0 * ground.spacing_m()),
            above_m,
        };
        let eye_m = DVec3::new(eye.place_m.x, eye.height_m(ground), eye.place_m.y);
        let (mesh, nodes) = setup.mesh(ground, &eye);
        let sized = |triangle: &[u32; 3]| {
            let [a, b, c] = triangle.map(|vertex| {
                let corner = mesh.corners[vertex as usize];
                let plan_m = corner.plan * ground.spacing_m();
                DVec3::new(plan_m.x, corner.height_m, plan_m.y) - eye_m
            });
            Sized {
                distance_m: ((a + b + c) / 3.0).length(),
                longest_edge_m: (b - a).length().max((c - b).length()).max((a - c).length()),
            }
        };
        let mut triangles: Vec<Sized> = mesh.triangles.iter().map(sized).collect();
        triangles.sort_by(|a, b| a.distance_m.total_cmp(&b.distance_m));
        let ends = [
            median(&triangles[..SIZED_TRIANGLES]),
            median(&triangles[triangles.len() - SIZED_TRIANGLES..]),
        ];
        let mut row: Vec<Cell> = vec![
            name.into(),
            nodes.into(),
            mesh.corners.len().into(),
            mesh.triangles.len().into(),
        ];
        for end in ends {
            let px = end.longest_edge_m / end.distance_m * setup.focal_px;
            row.extend([
                Cell::Number(end.distance_m, 2),
                Cell::Number(end.longest_edge_m, 3),
                Cell::Number(px, 1),
            ]);
        }
        table.row(row);
    }
    table.finish(folder, "tessellation_depth");
}
