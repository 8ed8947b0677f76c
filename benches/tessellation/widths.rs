//! Triangles in the picture by their width: the table of Cantlay 2011, on this ground.

use crate::ground::{EYES, Eye, Ground, focal_px};
use crate::policy::{PICTURE_HEIGHT_PX, Setup};
use crate::table::{Cell, Table};
use bevy_tessera::lattice::Node;
use bevy_tessera::tessellate::{EdgeEnd, FACTOR_ONE, FaceFactors, Pages, ViewMesh};
use glam::{DVec3, IVec2, UVec2};
use std::path::Path;
use std::time::Instant;

/// Triangles of the reference's default view for widths of 1 to 10 pixels, at 1920 × 1200.
const REFERENCE_TRIANGLES: [usize; 10] = [
    14_546_300, 4_736_714, 2_465_020, 1_569_450, 1_106_962, 841_350, 683_860, 570_924, 484_998,
    414_516,
];
const PICTURE_WIDTH_PX: f64 = 1920.0;
/// The reference doesn't say which angle its picture takes in.
const VIEW_ANGLE_DEG: f64 = 60.0;
/// How far below the horizon the eye looks, towards the middle of the ground.
const DOWN_DEG: f64 = 10.0;
/// The reference's ground is procedural and has detail down to its "footprints".
const FOOTPRINT_M: f64 = 0.05;

/// What an eye sees: inward normals of the four sides of its picture.
struct Frustum {
    eye_m: DVec3,
    sides: [DVec3; 4],
}

impl Frustum {
    fn new(ground: &Ground, eye: &Eye, focal_px: f64) -> Self {
        let middle_m = UVec2::from(ground.samples.size).as_dvec2() * (0.5 * ground.spacing_m());
        let towards = (middle_m - eye.place_m).normalize();
        let down = DOWN_DEG.to_radians();
        let level = DVec3::new(towards.x, 0.0, towards.y);
        let forward = level * down.cos() - DVec3::Y * down.sin();
        let right = forward.cross(DVec3::Y).normalize();
        let up = right.cross(forward);
        let across = 0.5 * PICTURE_WIDTH_PX / focal_px;
        let upward = 0.5 * PICTURE_HEIGHT_PX / focal_px;
        Self {
            eye_m: DVec3::new(eye.place_m.x, eye.height_m(ground), eye.place_m.y),
            sides: [
                forward * across + right,
                forward * across - right,
                forward * upward + up,
                forward * upward - up,
            ],
        }
    }

    /// Whether all `points` lie outside one side.
    fn misses(&self, points: &[DVec3]) -> bool {
        self.sides
            .iter()
            .any(|side| points.iter().all(|&p| side.dot(p - self.eye_m) < 0.0))
    }
}

/// What is in the picture.
#[derive(Default)]
struct Counts {
    triangles: usize,
    edges: usize,
    /// Edges that would be cut more finely, if the largest factor or the ground's samples let them.
    clamped_by_factor: usize,
    clamped_by_ground: usize,
}

struct Counter<'a, 'b> {
    ground: &'a Ground,
    frustum: &'a Frustum,
    view: &'a ViewMesh<'b, Pages>,
    counts: Counts,
}

impl Counter<'_, '_> {
    fn place_m(&self, point: IVec2, height_m: f64) -> DVec3 {
        let plan = point.as_dvec2() * f64::from(self.view.factor_view.unit_m);
        DVec3::new(plan.x, height_m, plan.y)
    }

    fn face(&mut self, node: &Node, face: u32) {
        let file = &self.ground.manifest.file;
        let corners = self.view.corners(node, face);
        // Whatever the heights within are.
        let heights = [file.height_m(0), file.height_m(u16::MAX)];
        let boxed = corners.map(|corner| heights.map(|height| self.place_m(corner, height)));
        if self.frustum.misses(boxed.as_flattened()) {
            return;
        }
        let factors = self.view.classify(node, face);
        self.edges(node, corners, &factors);
        let mesh = self.view.build_with(&[(*node, face)], vec![factors]);
        for triangle in &mesh.triangles {
            let corners = triangle.map(|vertex| {
                let vertex = mesh.vertices[vertex as usize];
                self.place_m(vertex.point, vertex.height_m.into())
            });
            self.counts.triangles += usize::from(!self.frustum.misses(&corners));
        }
    }

    fn edges(&mut self, node: &Node, corners: [IVec2; 4], factors: &FaceFactors) {
        let ends = corners.map(|point| EdgeEnd {
            point,
            height_m: self.view.displaced(point, node.level).0,
        });
        let view = self.view.factor_view;
        for (e, &factor) in factors.edges.iter().enumerate() {
            let limit = view.project(ends[e], ends[(e + 1) % 4]).limit;
            self.counts.edges += 1;
            let fixed = (limit * FACTOR_ONE as f32 + 0.5) as u32;
            if factor > FACTOR_ONE && factor >= fixed {
                if limit >= view.max_factor {
                    self.counts.clamped_by_factor += 1;
                } else {
                    self.counts.clamped_by_ground += 1;
                }
            }
        }
    }
}

fn count(ground: &Ground, eye: &Eye, frustum: &Frustum, setup: &Setup) -> Counts {
    setup.view(ground, eye, |view, nodes| {
        let counts = Counts::default();
        let mut counter = Counter {
            ground,
            frustum,
            view,
            counts,
        };
        for node in nodes {
            // Face by face, as the finest meshes wouldn't fit memory.
            for face in 0..1 << (2 * view.lattice.faces_log2) {
                counter.face(node, face);
            }
        }
        counter.counts
    })
}

/// Triangles in the picture for widths of 1 to 10 pixels beside the reference's.
pub fn widths(ground: &Ground, folder: &Path) {
    let heads = [
        "triangle width",
        "shortest segment",
        "density",
        "Cantlay 2011",
        "triangles",
        "edges",
        "% clamped by max_factor",
        "% clamped by shortest segment",
    ];
    let title = "Triangles in a picture of 1920 x 1200 from the vista, looking to the middle";
    let mut table = Table::new(title, &heads);
    let eye = &EYES[1];
    let focal_px = focal_px(PICTURE_HEIGHT_PX, VIEW_ANGLE_DEG);
    let frustum = Frustum::new(ground, eye, focal_px);
    for (floor, min_triangle_m) in [("5 cm", FOOTPRINT_M), ("30 m", ground.spacing_m())] {
        for (density, density_strength) in [("off", 0.0), ("on", 1.0)] {
            let start = Instant::now();
            for (reference, width) in REFERENCE_TRIANGLES.into_iter().zip(1..) {
                let setup = Setup {
                    triangle_width_px: f64::from(width),
                    density_strength,
                    min_triangle_m: Some(min_triangle_m),
                    focal_px,
                    ..Default::default()
                };
                let counts = count(ground, eye, &frustum, &setup);
                let share =
                    |part: usize| Cell::Number(100.0 * part as f64 / counts.edges as f64, 1);
                table.row([
                    Cell::Text(format!("{width} px")),
                    floor.into(),
                    density.into(),
                    reference.into(),
                    counts.triangles.into(),
                    counts.edges.into(),
                    share(counts.clamped_by_factor),
                    share(counts.clamped_by_ground),
                ]);
            }
            let seconds = start.elapsed().as_secs_f64();
            eprintln!("widths, segments of {floor}, density {density}: {seconds:.1} s");
        }
    }
    table.finish(folder, "tessellation_widths");
}
