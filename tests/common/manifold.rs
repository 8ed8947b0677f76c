//! What makes a mesh watertight, asserted in integers with no epsilon.

use bevy_tessera::lattice::Lattice;
use bevy_tessera::tessellate::{Partitioning, TerrainVertex};
use glam::IVec2;
use std::collections::HashMap;

/// A vertex as far as a neighbour can tell: where it is and at which level its height was read.
type Read = (IVec2, i32);

/// Checks that `triangles` tile the terrain: inside it every edge `a-b` of a triangle is used as
/// often as `b-a`, the signed areas sum to the terrain's, and no triangle is turned over. Returns
/// the sentence that says what is wrong.
pub fn check(
    lattice: &Lattice,
    vertices: &[TerrainVertex],
    triangles: &[[u32; 3]],
    partitioning: Partitioning,
) -> Result<(), String> {
    // Where a face is sheared on its way to a coarser level, vertices that rise may cross each other's
    // paths.
    let may_fold = partitioning == Partitioning::PowerOfTwoMorph;
    let mut folded = 0_i128;
    let mut count: HashMap<(Read, Read), i32> = HashMap::new();
    let mut area = 0_i128;
    for triangle in triangles {
        // Counter-clockwise from above is clockwise in (x, z).
        let [a, c, b] = triangle.map(|vertex| vertices[vertex as usize]);
        let points = [a.point, b.point, c.point];
        if points[0] == points[1] || points[1] == points[2] || points[2] == points[0] {
            continue;
        }
        let doubled = area2(points);
        let longest = (0..3)
            .map(|k| (points[(k + 1) % 3] - points[k]).as_dvec2().length())
            .fold(0.0, f64::max);
        // Rounding to the lattice may fold a sliver over by about a unit.
        if (doubled as f64) < -2.0 * longest {
            if !may_fold {
                return Err(format!("triangle {points:?} is turned over"));
            }
            folded -= i128::from(doubled);
        }
        area += i128::from(doubled);
        let reads = [a, b, c].map(|vertex| (vertex.point, vertex.lambda));
        for k in 0..3 {
            *count.entry((reads[k], reads[(k + 1) % 3])).or_default() += 1;
        }
    }
    let extent = lattice.extent;
    let whole = 2 * i128::from(extent.x) * i128::from(extent.y);
    if area != whole {
        return Err(format!(
            "the triangles cover {area} of {whole} half square units: they overlap or leave gaps"
        ));
    }
    if folded > whole / 2000 {
        return Err(format!(
            "{folded} of {whole} half square units are folded over"
        ));
    }
    for (&(a, b), &uses) in &count {
        let on_rim =
            |axis: usize| a.0[axis] == b.0[axis] && (a.0[axis] == 0 || a.0[axis] == extent[axis]);
        let back = count.get(&(b, a)).copied().unwrap_or(0);
        if uses != back && !on_rim(0) && !on_rim(1) {
            return Err(format!(
                "edge {a:?} - {b:?}: {uses} one way, {back} the other"
            ));
        }
    }
    Ok(())
}

fn area2([a, b, c]: [IVec2; 3]) -> i64 {
    let [u, v] = [b - a, c - a].map(|d| (i64::from(d.x), i64::from(d.y)));
    u.0 * v.1 - v.0 * u.1
}
