//! The first reference: greedy insertion into a Delaunay triangulation (Garland and Heckbert 1995).
//!
//! Always the sample with the largest error of all in the picture comes next, until none is larger
//! than wanted. Nothing that has to run on a GPU in a millisecond gets near, but it shows how few
//! triangles the ground needs.

use crate::ground::Samples;
use crate::measure::{Corner, PlanMesh, for_samples};
use glam::DVec2;
use spade::handles::{FixedFaceHandle, FixedVertexHandle, InnerTag};
use spade::{DelaunayTriangulation, HasPosition, Point2, Triangulation};
use std::collections::BinaryHeap;

/// Vertices at which a mesh is given up; the bundled ground stays well below.
const MAX_VERTICES: usize = 500_000;

#[derive(Clone, Copy)]
struct Place {
    x: u32,
    z: u32,
}

impl HasPosition for Place {
    type Scalar = f64;

    fn position(&self) -> Point2<f64> {
        Point2::new(self.x.into(), self.z.into())
    }
}

/// The worst sample of a face. Ordered by error, whose bits rise with it as it is never negative.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Candidate {
    error_bits: u32,
    sample: usize,
    face: usize,
    /// Insertions that the face had seen; another number says that it is a triangle no longer.
    stamp: u32,
    /// A corner of the face, from which the sample is found at once.
    near: usize,
}

pub struct Greedy<'a> {
    samples: &'a Samples,
    px_per_m: &'a [f32],
    triangulation: DelaunayTriangulation<Place>,
    candidates: BinaryHeap<Candidate>,
    /// The last change of each face.
    stamps: Vec<u32>,
    stamp: u32,
}

impl<'a> Greedy<'a> {
    /// Two triangles over all the ground.
    pub fn new(samples: &'a Samples, px_per_m: &'a [f32]) -> Self {
        let mut greedy = Self {
            samples,
            px_per_m,
            triangulation: DelaunayTriangulation::new(),
            candidates: BinaryHeap::new(),
            stamps: Vec::new(),
            stamp: 0,
        };
        let [x, z] = samples.size.map(|samples| samples - 1);
        for (x, z) in [(0, 0), (x, 0), (x, z), (0, z)] {
            greedy
                .triangulation
                .insert(Place { x, z })
                .expect("samples are numbers");
        }
        let faces: Vec<_> = greedy
            .triangulation
            .inner_faces()
            .map(|face| face.fix())
            .collect();
        for face in faces {
            greedy.rescan(face);
        }
        greedy
    }

    /// Inserts samples until no error is above `max_px`. `false` where that takes too many.
    pub fn refine(&mut self, max_px: f64) -> bool {
        while self.largest_px() > max_px {
            if self.triangulation.num_vertices() >= MAX_VERTICES {
                return false;
            }
            self.insert_worst();
        }
        true
    }

    /// The largest error of all.
    pub fn largest_px(&mut self) -> f64 {
        while let Some(worst) = self.candidates.peek() {
            if self.stamps[worst.face] == worst.stamp {
                return f32::from_bits(worst.error_bits).into();
            }
            self.candidates.pop();
        }
        0.0
    }

    /// Inserts the sample with the largest error, after [`largest_px`](Self::largest_px) has found it.
    pub fn insert_worst(&mut self) {
        if let Some(worst) = self.candidates.pop() {
            self.insert(worst);
        }
    }

    fn insert(&mut self, worst: Candidate) {
        let width = self.samples.size[0] as usize;
        let place = Place {
            x: (worst.sample % width) as u32,
            z: (worst.sample / width) as u32,
        };
        let near = FixedVertexHandle::from_index(worst.near);
        let vertex = self
            .triangulation
            .insert_with_hint(place, near)
            .expect("samples are numbers");
        self.stamp += 1;
        // All that changed are the faces around the new vertex: flipped edges end in it.
        let changed: Vec<_> = self
            .triangulation
            .vertex(vertex)
            .out_edges()
            .filter_map(|edge| edge.face().as_inner())
            .map(|face| face.fix())
            .collect();
        for face in changed {
            self.rescan(face);
        }
    }

    fn rescan(&mut self, face: FixedFaceHandle<InnerTag>) {
        let vertices = self.triangulation.face(face).vertices();
        let near = vertices[0].index();
        let corners = vertices.map(|vertex| self.corner(*vertex.data()));
        let (samples, px_per_m) = (self.samples, self.px_per_m);
        let (mut worst_px, mut worst) = (0.0_f32, 0);
        for_samples(samples.size, corners, |sample, height_m| {
            let error_m = (height_m - f64::from(samples.heights_m[sample])).abs();
            let error_px = error_m as f32 * px_per_m[sample];
            if error_px > worst_px {
                (worst_px, worst) = (error_px, sample);
            }
        });
        let index = face.index();
        if index >= self.stamps.len() {
            self.stamps.resize(index + 1, 0);
        }
        self.stamps[index] = self.stamp;
        // What rounding makes of the face's own corners is no error.
        if worst_px > 1e-3 {
            self.candidates.push(Candidate {
                error_bits: worst_px.to_bits(),
                sample: worst,
                face: index,
                stamp: self.stamp,
                near,
            });
        }
    }

    fn corner(&self, place: Place) -> Corner {
        let number = self.samples.number(place.x, place.z);
        Corner {
            plan: DVec2::new(place.x.into(), place.z.into()),
            height_m: self.samples.heights_m[number].into(),
        }
    }

    pub fn mesh(&self) -> PlanMesh {
        PlanMesh {
            corners: self
                .triangulation
                .vertices()
                .map(|vertex| self.corner(*vertex.data()))
                .collect(),
            triangles: self
                .triangulation
                .inner_faces()
                .map(|face| face.vertices().map(|vertex| vertex.index() as u32))
                .collect(),
        }
    }
}
