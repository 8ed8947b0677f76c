//! What must hold for the references' meshes, checked in every run.

use crate::bintree::Bintree;
use crate::curves::{Curve, Step};
use crate::delaunay::Greedy;
use crate::ground::Samples;
use crate::measure::{PlanMesh, errors};
use glam::DVec2;

/// What rounding to `f32` may make of an error.
fn close(a_px: f64, b_px: f64) -> bool {
    (a_px - b_px).abs() <= 1e-3 * a_px.max(b_px) + 2e-3
}

/// Checks a mesh of either reference: no gaps, all ground covered, and no error above the one asked
/// for, measured by other code than that which asked.
pub fn reference(samples: &Samples, mesh: &PlanMesh, step: &Step) {
    conforming(samples, mesh);
    assert_eq!(step.errors.samples, samples.heights_m.len());
    let (found_px, asked_px) = (step.errors.largest_px, step.step);
    assert!(
        found_px <= asked_px || close(found_px, asked_px),
        "{found_px} px for {asked_px} px"
    );
}

/// Checks that more triangles mean smaller errors.
pub fn falls(curve: &Curve) {
    for pair in curve.steps.windows(2) {
        assert!(pair[0].triangles <= pair[1].triangles);
        assert!(pair[0].errors.largest_px >= pair[1].errors.largest_px);
        assert!(pair[0].errors.rms_px >= pair[1].errors.rms_px);
    }
}

/// Checks both references on ground so small that everything can be computed anew at every step.
pub fn small() {
    let size = [61_u32, 50];
    // Whole numbers, so that no height lies on the plane through others but by chance.
    let heights_m = (0..size[0] * size[1])
        .map(|at| ((at.wrapping_mul(2_654_435_761) >> 20) % 997) as f32)
        .collect();
    let px_per_m: Vec<f32> = (0..size[0] * size[1])
        .map(|at| 1.0 / (1 + at % size[0]) as f32)
        .collect();
    let samples = Samples { size, heights_m };
    let quads = ((size[0] - 1) * (size[1] - 1)) as usize;

    let mut greedy = Greedy::new(&samples, &px_per_m);
    for _ in 0..1000 {
        let claimed_px = greedy.largest_px();
        let mesh = greedy.mesh();
        let found_px = errors(&samples, &px_per_m, &mesh).largest_px;
        assert!(close(claimed_px, found_px), "{claimed_px} for {found_px}");
        greedy.insert_worst();
    }
    conforming(&samples, &greedy.mesh());

    let tree = Bintree::new(&samples, &px_per_m);
    for max_px in [500.0, 100.0, 30.0, 10.0, 3.0, 1.0] {
        let mesh = tree.mesh(max_px);
        conforming(&samples, &mesh);
        assert!(errors(&samples, &px_per_m, &mesh).largest_px <= max_px);
    }
    let finest = tree.mesh(-1.0);
    assert_eq!(finest.triangles.len(), 2 * quads);
}

/// Panics unless every edge of `mesh` is shared by exactly two triangles that run along it in
/// opposite directions, but for edges with both ends on one side of the ground's rim or beyond it.
fn conforming(samples: &Samples, mesh: &PlanMesh) {
    let mut edges: Vec<(u32, u32)> = mesh
        .triangles
        .iter()
        .flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)])
        .collect();
    edges.sort_unstable();
    let last = DVec2::new(
        f64::from(samples.size[0] - 1),
        f64::from(samples.size[1] - 1),
    );
    for pair in edges.windows(2) {
        assert_ne!(pair[0], pair[1], "an edge runs twice in one direction");
    }
    for &(a, b) in &edges {
        let [p, q] = [a, b].map(|vertex| mesh.corners[vertex as usize].plan);
        let low = p.min(q);
        let on_rim = p.max(q).min_element() <= 0.0 || low.x >= last.x || low.y >= last.y;
        assert!(
            on_rim || edges.binary_search(&(b, a)).is_ok(),
            "the edge from {p} to {q} has a triangle on one side only"
        );
    }
}
