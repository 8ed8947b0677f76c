//! One face: its vertices and its triangles, each computable alone from its number.

use super::{Partitioning, scaled_factor, segment_count, segment_parameter};
use crate::lattice::lerp;
use glam::IVec2;

/// Fixed-point factors of a face.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FaceFactors {
    /// Of the edges, shared with the faces beside them.
    pub edges: [u32; 4],
    /// What the inside asks for itself, across and down; private to the face.
    pub inside: [u32; 2],
}

impl FaceFactors {
    /// All factors brought down by `2^-scale`, none below 1.
    #[must_use]
    pub fn scaled(&self, scale: u32) -> Self {
        Self {
            edges: self.edges.map(|factor| scaled_factor(factor, scale)),
            inside: self.inside.map(|factor| scaled_factor(factor, scale)),
        }
    }
}

/// A face with its factors: everything that its vertices and triangles follow from.
///
/// Corners run around the face: `(0,0)`, `(1,0)`, `(1,1)`, `(0,1)`; edge `e` goes from corner `e`
/// to the next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Face {
    /// Lattice points of the corners.
    pub corners: [IVec2; 4],
    /// Fixed-point factors.
    pub factors: FaceFactors,
    /// How factors become segments.
    pub partitioning: Partitioning,
}

/// Segments of a face, and what follows from them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FaceCounts {
    /// Segments of each edge.
    pub edge: [u32; 4],
    /// Segments of the inner grid in both directions, counting the rings that join it to the
    /// edges; 0 where the face is two triangles.
    pub inner: [u32; 2],
}

impl FaceCounts {
    /// Vertices of the face.
    #[must_use]
    pub fn vertices(&self) -> u32 {
        if self.inner[0] == 0 {
            return 4;
        }
        self.edge.iter().sum::<u32>() + (self.inner[0] - 1) * (self.inner[1] - 1)
    }

    /// Triangles of the face.
    #[must_use]
    pub fn triangles(&self) -> u32 {
        if self.inner[0] == 0 {
            return 2;
        }
        let [across, down] = self.inner.map(|segments| segments - 2);
        2 * across * down + self.edge.iter().sum::<u32>() + 2 * (across + down)
    }
}

impl Face {
    /// The fixed-point factors inside, across and down: the largest of two opposite edges and of
    /// what the inside asks for.
    #[must_use]
    pub fn inner_factors(&self) -> [u32; 2] {
        let FaceFactors { edges: f, inside } = self.factors;
        [f[0].max(f[2]).max(inside[0]), f[1].max(f[3]).max(inside[1])]
    }

    /// How many segments, vertices and triangles the face has.
    #[must_use]
    pub fn counts(&self) -> FaceCounts {
        let count = |f, inner| segment_count(self.partitioning, f, inner);
        let edge = self.factors.edges.map(|f| count(f, false));
        let inner = self.inner_factors();
        let inner = if edge == [1; 4] && inner.map(|f| count(f, false)) == [1; 2] {
            [0; 2]
        } else {
            inner.map(|f| count(f, true))
        };
        FaceCounts { edge, inner }
    }

    /// Cut `i` of edge `e`, from corner `e` on. The edge is cut in canonical direction, so the
    /// face on its other side gets the same points.
    fn edge_point(&self, e: usize, count: u32, i: u32) -> IVec2 {
        let (a, b) = (self.corners[e], self.corners[(e + 1) % 4]);
        let forward = (a.x, a.y) <= (b.x, b.y);
        let (low, high, i) = if forward {
            (a, b, i)
        } else {
            (b, a, count - i)
        };
        let t = segment_parameter(self.partitioning, self.factors.edges[e], count, i);
        lerp(low, high, t)
    }

    /// Lattice point of vertex `index`: the edges' vertices in order, then the inner grid's.
    #[must_use]
    pub fn vertex(&self, counts: &FaceCounts, index: u32) -> IVec2 {
        if counts.inner[0] == 0 {
            return self.corners[index as usize];
        }
        let mut rest = index;
        for e in 0..4 {
            if rest < counts.edge[e] {
                return self.edge_point(e, counts.edge[e], rest);
            }
            rest -= counts.edge[e];
        }
        let columns = counts.inner[0] - 1;
        let (i, j) = (rest % columns + 1, rest / columns + 1);
        let [across, down] = self.inner_factors();
        let u = segment_parameter(self.partitioning, across, counts.inner[0], i);
        let v = segment_parameter(self.partitioning, down, counts.inner[1], j);
        let [c00, c10, c11, c01] = self.corners;
        lerp(lerp(c00, c10, u), lerp(c01, c11, u), v)
    }

    /// Vertex numbers of triangle `index`, counter-clockwise seen from above.
    #[must_use]
    pub fn triangle(&self, counts: &FaceCounts, index: u32) -> [u32; 3] {
        if counts.inner[0] == 0 {
            return [[0, 2, 1], [0, 3, 2]][index as usize];
        }
        let [columns, rows] = counts.inner.map(|segments| segments - 1);
        let first_inner: u32 = counts.edge.iter().sum();
        let inner = |i: u32, j: u32| first_inner + j * columns + i;
        let (across, down) = (columns - 1, rows - 1);
        let grid = 2 * across * down;
        if index < grid {
            let (i, j) = ((index / 2) % across, (index / 2) / across);
            return if index.is_multiple_of(2) {
                [inner(i, j), inner(i + 1, j + 1), inner(i + 1, j)]
            } else {
                [inner(i, j), inner(i, j + 1), inner(i + 1, j + 1)]
            };
        }
        let mut rest = index - grid;
        let mut first_outer = 0;
        for e in 0..4 {
            let outer_count = counts.edge[e];
            let inner_count = if e % 2 == 0 { across } else { down };
            if rest >= outer_count + inner_count {
                rest -= outer_count + inner_count;
                first_outer += outer_count;
                continue;
            }
            let outer = |i: u32| (first_outer + i) % first_inner;
            let ring = |i: u32| match e {
                0 => inner(i, 0),
                1 => inner(across, i),
                2 => inner(across - i, down),
                _ => inner(0, down - i),
            };
            // The two rows of segments are merged by the position of their middles, outer first
            // where they tie; each triangle finds its own partner.
            return if rest < outer_count {
                let i = rest;
                let j = middles_before(2 * i + 1, outer_count, inner_count, false);
                [outer(i), ring(j), outer(i + 1)]
            } else {
                let j = rest - outer_count;
                let i = middles_before(2 * j + 1, inner_count, outer_count, true);
                [ring(j), ring(j + 1), outer(i)]
            };
        }
        unreachable!("triangle {index} of {}", counts.triangles());
    }
}

/// How many of `other` equal segments have their middle before the place `odd / (2 * count)`,
/// counting one exactly there if `ties`.
fn middles_before(odd: u32, count: u32, other: u32, ties: bool) -> u32 {
    // Middle k lies at (2 k + 1) / (2 other): count k with (2 k + 1) * count < odd * other.
    let reach = odd * other;
    let reach = if ties {
        reach
    } else {
        reach - u32::from(reach > 0)
    };
    (reach / count).div_ceil(2).min(other)
}
