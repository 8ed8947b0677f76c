//! One face: its vertices and its triangles, each computable alone from its number.

use super::partition::rise;
use super::strip::Row;
use super::{Partitioning, scaled_factor, segment_count, segment_parameter};
use crate::lattice::{ONE, lerp};
use glam::IVec2;

/// Whether edge `e` of a face is cut from its first corner on: all edges are cut the way that their
/// axis rises, so that the faces on both sides, of whatever levels, agree.
const fn runs_forward(e: usize) -> bool {
    e < 2
}

/// The ends of edge `e` of a face in the order that it is cut in: counted around the face.
#[must_use]
pub const fn edge_ends(e: usize) -> [usize; 2] {
    if runs_forward(e) {
        [e, e + 1]
    } else {
        [(e + 1) % 4, e]
    }
}

/// Fixed-point factors of a face.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FaceFactors {
    /// Of the edges, shared with the faces beside them.
    pub edges: [u32; 4],
    /// What the inside asks for itself, across and down; private to the face.
    pub inside: [u32; 2],
    /// No view sees the face: it has no vertices and no triangles.
    pub culled: bool,
}

impl FaceFactors {
    /// All factors brought down by `2^-scale`, none below 1.
    #[must_use]
    pub fn scaled(&self, scale: u32) -> Self {
        Self {
            edges: self.edges.map(|factor| scaled_factor(factor, scale)),
            inside: self.inside.map(|factor| scaled_factor(factor, scale)),
            culled: self.culled,
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
    /// Its factors, fixed point with [`FACTOR_LOG2`](super::FACTOR_LOG2) fractional bits.
    pub factors: FaceFactors,
    /// How factors become segments.
    pub partitioning: Partitioning,
}

/// Where a vertex of a face comes to stand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FaceVertex {
    /// The lattice point that its height is read at.
    pub point: IVec2,
    /// The two vertices of the coarser mesh that it rises from the middle of.
    pub parents: [IVec2; 2],
    /// How far it has risen, `0..=ONE`; `ONE` for vertices without parents.
    pub rise: i32,
}

impl FaceVertex {
    const fn settled(point: IVec2) -> Self {
        Self {
            point,
            parents: [point; 2],
            rise: ONE,
        }
    }

    /// The lattice point where it is drawn.
    #[must_use]
    pub fn drawn(&self) -> IVec2 {
        if self.rise == ONE {
            return self.point;
        }
        let [a, b] = self.parents;
        lerp((a + b) >> 1, self.point, self.rise)
    }
}

/// Segments of a face, and what follows from them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FaceCounts {
    /// Segments of each edge.
    pub edge: [u32; 4],
    /// Segments of the inner grid in both directions, counting the rings that join it to the
    /// edges; 0 where the face is two triangles.
    pub inner: [u32; 2],
    /// Whether the inner grid reaches the edges and takes their vertices for its own outermost ones
    /// ([`Partitioning::PowerOfTwoMorph`]).
    pub nested: bool,
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
        if self.nested {
            return 2 * self.inner[0] * self.inner[1];
        }
        let [across, down] = self.inner.map(|segments| segments - 2);
        2 * across * down + self.edge.iter().sum::<u32>() + 2 * (across + down)
    }
}

impl Face {
    /// The fixed-point factors inside, across and down: the largest of two opposite edges and of
    /// what the inside asks for; where the grid reaches the edges, one for both.
    #[must_use]
    pub fn inner_factors(&self) -> [u32; 2] {
        let FaceFactors {
            edges: f, inside, ..
        } = self.factors;
        let inner = [f[0].max(f[2]).max(inside[0]), f[1].max(f[3]).max(inside[1])];
        if self.partitioning == Partitioning::PowerOfTwoMorph {
            return [inner[0].max(inner[1]); 2];
        }
        inner
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
        FaceCounts {
            edge,
            inner,
            nested: self.partitioning == Partitioning::PowerOfTwoMorph,
        }
    }

    /// Cut `i` of edge `e`, from corner `e` on. The edge is cut in canonical direction, so the
    /// face on its other side gets the same points.
    fn edge_point(&self, e: usize, count: u32, i: u32) -> IVec2 {
        let [low, high] = edge_ends(e).map(|corner| self.corners[corner]);
        let i = if runs_forward(e) { i } else { count - i };
        let t = segment_parameter(self.partitioning, self.factors.edges[e], count, i);
        lerp(low, high, t)
    }

    /// Place `(i, j)` of the inner grid.
    fn grid_point(&self, counts: &FaceCounts, i: u32, j: u32) -> IVec2 {
        let (u, v) = if counts.nested {
            (
                ((i << 16) / counts.inner[0]).cast_signed(),
                ((j << 16) / counts.inner[1]).cast_signed(),
            )
        } else {
            let [across, down] = self.inner_factors();
            (
                segment_parameter(self.partitioning, across, counts.inner[0], i),
                segment_parameter(self.partitioning, down, counts.inner[1], j),
            )
        };
        let [c00, c10, c11, c01] = self.corners;
        lerp(lerp(c00, c10, u), lerp(c01, c11, u), v)
    }

    /// Place `(i, j)` of a grid that reaches the edges, rim included.
    fn nested_point(&self, counts: &FaceCounts, i: u32, j: u32) -> IVec2 {
        match counts.rim(i, j) {
            Some((e, cut)) => self.edge_point(e, counts.edge[e], cut),
            None => self.grid_point(counts, i, j),
        }
    }

    /// Vertex `index`: the edges' vertices in order, then the inner grid's.
    #[must_use]
    pub fn vertex(&self, counts: &FaceCounts, index: u32) -> FaceVertex {
        if counts.inner[0] == 0 {
            return FaceVertex::settled(self.corners[index as usize]);
        }
        let mut rest = index;
        for e in 0..4 {
            if rest < counts.edge[e] {
                return FaceVertex::settled(self.edge_point(e, counts.edge[e], rest));
            }
            rest -= counts.edge[e];
        }
        let columns = counts.inner[0] - 1;
        let (i, j) = (rest % columns + 1, rest / columns + 1);
        let point = self.grid_point(counts, i, j);
        let (odd_i, odd_j) = (i % 2, j % 2);
        if !counts.nested || odd_i + odd_j == 0 {
            return FaceVertex::settled(point);
        }
        FaceVertex {
            point,
            parents: [
                self.nested_point(counts, i - odd_i, j - odd_j),
                self.nested_point(counts, i + odd_i, j + odd_j),
            ],
            rise: rise(self.inner_factors()[0], counts.inner[0]),
        }
    }

    /// Vertex numbers of triangle `index`, counter-clockwise seen from above.
    #[must_use]
    pub fn triangle(&self, counts: &FaceCounts, index: u32) -> [u32; 3] {
        if counts.inner[0] == 0 {
            return [[0, 2, 1], [0, 3, 2]][index as usize];
        }
        let first_inner: u32 = counts.edge.iter().sum();
        if counts.nested {
            let side = counts.inner[0];
            let (i, j) = ((index / 2) % side, (index / 2) / side);
            return quad_triangle(index, i, j, |i, j| counts.nested_vertex(i, j));
        }
        let columns = counts.inner[0] - 1;
        let [across, down] = counts.inner.map(|segments| segments - 2);
        let inner = |i: u32, j: u32| first_inner + j * columns + i;
        let grid = 2 * across * down;
        if index < grid {
            let (i, j) = ((index / 2) % across, (index / 2) / across);
            return quad_triangle(index, i, j, inner);
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
            let (outer_row, ring_row) = (Row::edge(outer_count), Row::ring(inner_count));
            // Each triangle finds its own partner in the other row; outer segments first where two
            // share a slot.
            return if rest < outer_count {
                let j = ring_row.before(outer_row.slot(rest));
                [outer(rest), ring(j), outer(rest + 1)]
            } else {
                let j = rest - outer_count;
                let i = outer_row.before(ring_row.slot(j) + 1);
                [ring(j), ring(j + 1), outer(i)]
            };
        }
        unreachable!("triangle {index} of {}", counts.triangles());
    }
}

/// Triangle `index` (by its last bit) of the quad with corner `(i, j)`.
fn quad_triangle(index: u32, i: u32, j: u32, vertex: impl Fn(u32, u32) -> u32) -> [u32; 3] {
    if index.is_multiple_of(2) {
        [vertex(i, j), vertex(i + 1, j + 1), vertex(i + 1, j)]
    } else {
        [vertex(i, j), vertex(i, j + 1), vertex(i + 1, j + 1)]
    }
}

impl FaceCounts {
    /// Where place `(i, j)` of a grid that reaches the edges lies on one of them: the edge, and the
    /// cut counted from its first corner. The rim's places share the edge's cuts, each taking the
    /// last one before it, so that cuts which come in new part from it without a jump.
    fn rim(&self, i: u32, j: u32) -> Option<(usize, u32)> {
        let side = self.inner[0];
        let (e, along) = if j == 0 && i < side {
            (0, i)
        } else if i == side && j < side {
            (1, j)
        } else if j == side && i > 0 {
            (2, side - i)
        } else if i == 0 {
            (3, side - j)
        } else {
            return None;
        };
        let count = self.edge[e];
        let cut = if runs_forward(e) {
            along * count / side
        } else {
            count - (side - along) * count / side
        };
        Some((e, cut))
    }

    /// The number of the vertex at place `(i, j)` of a grid that reaches the edges.
    fn nested_vertex(&self, i: u32, j: u32) -> u32 {
        let total: u32 = self.edge.iter().sum();
        match self.rim(i, j) {
            Some((e, cut)) => (self.edge[..e].iter().sum::<u32>() + cut) % total,
            None => total + (j - 1) * (self.inner[0] - 1) + i - 1,
        }
    }
}
