//! The second reference: a restricted tree of right triangles, each cut in two at the middle of its
//! longest side. What ROAM (Duchaineau 1997) converges to from above and bottom-up algorithms
//! (Lindstrom 1996) from below, here with errors that are exact for the view.

use crate::ground::Samples;
use crate::measure::{Corner, PlanMesh, for_samples};
use glam::IVec2;
use std::collections::HashMap;

/// A triangle of the tree: the two ends of its longest side, then the right angle.
type Right = [IVec2; 3];

fn middle([a, b, _]: Right) -> IVec2 {
    (a + b) / 2
}

fn children(triangle: Right) -> [Right; 2] {
    let [a, b, c] = triangle;
    let middle = middle(triangle);
    [[c, a, middle], [b, c, middle]]
}

/// The errors of all triangles for one view, on a square of `2^n + 1` samples that the ground lies in
/// the corner of. Beyond the ground's rim heights go on as they are there, count no error, and have
/// no triangles but those that reach over the rim.
pub struct Bintree<'a> {
    samples: &'a Samples,
    side_log2: u32,
    /// For each vertex of the square, row by row: the largest error in pixels of the two triangles
    /// that it cuts in two, and of all below them. So no vertex has less than one that needs it, and
    /// a threshold gives a mesh without gaps.
    errors_px: Vec<f32>,
}

impl<'a> Bintree<'a> {
    pub fn new(samples: &'a Samples, px_per_m: &[f32]) -> Self {
        let longest = samples.size[0].max(samples.size[1]) - 1;
        let side_log2 = longest.next_power_of_two().ilog2();
        let side = (1 << side_log2) + 1;
        let mut tree = Self {
            samples,
            side_log2,
            errors_px: vec![0.0; side * side],
        };
        // Level by level from the finest: both triangles of a longest side must have spoken before
        // those above ask.
        for level in (0..2 * side_log2).rev() {
            for root in tree.roots() {
                tree.collect(root, level, px_per_m);
            }
        }
        tree
    }

    fn roots(&self) -> [Right; 2] {
        let side = 1 << self.side_log2;
        let (low, high) = (IVec2::ZERO, IVec2::splat(side));
        [
            [low, high, IVec2::new(side, 0)],
            [high, low, IVec2::new(0, side)],
        ]
    }

    fn vertex(&self, p: IVec2) -> usize {
        p.y as usize * ((1 << self.side_log2) + 1) + p.x as usize
    }

    /// Whether a triangle reaches into the ground.
    fn inside(&self, triangle: Right) -> bool {
        let low = triangle[0].min(triangle[1]).min(triangle[2]);
        low.x < self.samples.size[0] as i32 - 1 && low.y < self.samples.size[1] as i32 - 1
    }

    fn corner(&self, p: IVec2) -> Corner {
        Corner {
            plan: p.as_dvec2(),
            height_m: self.samples.height_m(p.x, p.y),
        }
    }

    /// Collects the errors of all triangles `below` levels below `triangle`.
    fn collect(&mut self, triangle: Right, below: u32, px_per_m: &[f32]) {
        if !self.inside(triangle) {
            return;
        }
        let halves = children(triangle);
        if below > 0 {
            for half in halves {
                self.collect(half, below - 1, px_per_m);
            }
            return;
        }
        let samples = self.samples;
        let mut largest_px = 0.0_f32;
        let corners = triangle.map(|p| self.corner(p));
        for_samples(samples.size, corners, |sample, height_m| {
            let error_m = (height_m - f64::from(samples.heights_m[sample])).abs();
            largest_px = largest_px.max(error_m as f32 * px_per_m[sample]);
        });
        for half in halves {
            // The smallest triangles have no middle among the samples.
            if can_split(half) {
                largest_px = largest_px.max(self.errors_px[self.vertex(middle(half))]);
            }
        }
        let vertex = self.vertex(middle(triangle));
        self.errors_px[vertex] = self.errors_px[vertex].max(largest_px);
    }

    /// The mesh in which every vertex with an error above `max_px` is inserted.
    pub fn mesh(&self, max_px: f64) -> PlanMesh {
        let mut mesh = PlanMesh::default();
        let mut numbers = HashMap::new();
        for root in self.roots() {
            self.refine(root, max_px, &mut mesh, &mut numbers);
        }
        mesh
    }

    fn refine(
        &self,
        triangle: Right,
        max_px: f64,
        mesh: &mut PlanMesh,
        numbers: &mut HashMap<IVec2, u32>,
    ) {
        if !self.inside(triangle) {
            return;
        }
        let splits = can_split(triangle)
            && f64::from(self.errors_px[self.vertex(middle(triangle))]) > max_px;
        if splits {
            for half in children(triangle) {
                self.refine(half, max_px, mesh, numbers);
            }
            return;
        }
        mesh.triangles.push(triangle.map(|p| {
            *numbers.entry(p).or_insert_with(|| {
                mesh.corners.push(self.corner(p));
                mesh.corners.len() as u32 - 1
            })
        }));
    }
}

fn can_split([a, b, _]: Right) -> bool {
    let twice = a + b;
    (twice.x | twice.y) & 1 == 0
}
