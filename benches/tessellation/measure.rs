//! Meshes in the plane and how far they lie from the finest heights: one measure for all of them.

use crate::ground::Samples;
use glam::DVec2;

/// A vertex: its place in samples and its height.
#[derive(Clone, Copy)]
pub struct Corner {
    pub plan: DVec2,
    pub height_m: f64,
}

/// A mesh over the ground, whoever made it.
#[derive(Default)]
pub struct PlanMesh {
    pub corners: Vec<Corner>,
    pub triangles: Vec<[u32; 3]>,
}

/// Calls `visit` with every sample that lies in the triangle or on its rim, and the triangle's height
/// there.
pub fn for_samples(size: [u32; 2], triangle: [Corner; 3], mut visit: impl FnMut(usize, f64)) {
    let [a, b, c] = triangle.map(|corner| corner.plan);
    let area = (b - a).perp_dot(c - a);
    if area == 0.0 {
        return;
    }
    let rise = |corner: usize| triangle[corner].height_m - triangle[0].height_m;
    let slope = DVec2::new(
        rise(1) * (c.y - a.y) - rise(2) * (b.y - a.y),
        rise(2) * (b.x - a.x) - rise(1) * (c.x - a.x),
    ) / area;
    let rows_end = f64::from(size[1] - 1);
    let columns_end = f64::from(size[0] - 1);
    let first_row = a.y.min(b.y).min(c.y).ceil().max(0.0) as i32;
    let last_row = a.y.max(b.y).max(c.y).floor().min(rows_end) as i32;
    for row in first_row..=last_row {
        let z = f64::from(row);
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for (from, to) in [(a, b), (b, c), (c, a)] {
            if z < from.y.min(to.y) || z > from.y.max(to.y) {
                continue;
            }
            let cuts = if from.y == to.y {
                [from.x, to.x]
            } else {
                [from.x + (to.x - from.x) * ((z - from.y) / (to.y - from.y)); 2]
            };
            low = low.min(cuts[0]).min(cuts[1]);
            high = high.max(cuts[0]).max(cuts[1]);
        }
        // Samples on an edge must not be lost to rounding.
        let first = (low - 1e-9).ceil().max(0.0) as i32;
        let last = (high + 1e-9).floor().min(columns_end) as i32;
        for column in first..=last {
            let offset = DVec2::new(f64::from(column), z) - a;
            let sample = row as usize * size[0] as usize + column as usize;
            visit(sample, triangle[0].height_m + slope.dot(offset));
        }
    }
}

/// How far a mesh lies from the finest heights, over all samples that it covers.
#[derive(Clone, Copy, Debug)]
pub struct Errors {
    pub samples: usize,
    pub largest_px: f64,
    /// 99.9 % of the samples stay below.
    pub most_px: f64,
    pub rms_px: f64,
}

/// Errors in pixels at all samples of the finest level that `mesh` covers, where a metre at a sample
/// takes `px_per_m`.
pub fn errors(samples: &Samples, px_per_m: &[f32], mesh: &PlanMesh) -> Errors {
    let mut drawn_m = vec![f64::NAN; samples.heights_m.len()];
    for triangle in &mesh.triangles {
        let corners = triangle.map(|vertex| mesh.corners[vertex as usize]);
        for_samples(samples.size, corners, |sample, height_m| {
            drawn_m[sample] = height_m;
        });
    }
    errors_of(samples, px_per_m, &drawn_m)
}

/// Errors in pixels of heights at all samples, those that are no number left out.
pub fn errors_of(samples: &Samples, px_per_m: &[f32], drawn_m: &[f64]) -> Errors {
    let mut errors_px: Vec<f64> = drawn_m
        .iter()
        .zip(&samples.heights_m)
        .zip(px_per_m)
        .filter(|((drawn_m, _), _)| !drawn_m.is_nan())
        .map(|((drawn_m, &height_m), &px)| (drawn_m - f64::from(height_m)).abs() * f64::from(px))
        .collect();
    errors_px.sort_by(f64::total_cmp);
    let count = errors_px.len();
    let squares: f64 = errors_px.iter().map(|error| error * error).sum();
    Errors {
        samples: count,
        largest_px: errors_px[count - 1],
        most_px: errors_px[(0.999 * (count - 1) as f64) as usize],
        rms_px: (squares / count as f64).sqrt(),
    }
}
