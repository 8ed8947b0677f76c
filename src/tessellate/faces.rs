//! Which part of which face each triangle of a view belongs to, and what error that part may leave:
//! what overlays colour triangles by.

use super::edge_density::DensityReader;
use super::{Face, FaceCounts, FaceFactors, PageSource, ViewMesh, edge_ends};
use crate::lattice::Node;
use crate::tessellate::EdgeEnd;
use glam::IVec2;

/// The corners of a face, around it.
const AROUND: [IVec2; 4] = [IVec2::ZERO, IVec2::X, IVec2::ONE, IVec2::Y];

/// A part of a face that has a factor of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum FacePart {
    /// The strip along an edge, 0 to 3, counted around the face.
    Edge(u8),
    /// The grid inside.
    Inside,
}

impl FacePart {
    /// All of them, by their number.
    pub const ALL: [Self; 5] = [
        Self::Edge(0),
        Self::Edge(1),
        Self::Edge(2),
        Self::Edge(3),
        Self::Inside,
    ];

    /// The part's number: the edge's, or 4.
    #[must_use]
    pub const fn number(self) -> u32 {
        match self {
            Self::Edge(edge) => edge as u32,
            Self::Inside => 4,
        }
    }
}

/// What a triangle belongs to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TriangleFace {
    /// The face, counted node by node.
    pub face: u32,
    /// Level of its node.
    pub level: i32,
    /// The part of the face.
    pub part: FacePart,
    /// That part's factor as it is drawn, in fixed point ([`FACTOR_ONE`](super::FACTOR_ONE)).
    pub factor: u32,
}

impl FaceCounts {
    /// The part that triangle `index` belongs to. Where the inner grid reaches the edges, that is the
    /// edge that one of the triangle's own sides lies on; a face of two triangles is all inside.
    #[must_use]
    pub fn part(&self, index: u32) -> FacePart {
        if self.inner[0] == 0 {
            return FacePart::Inside;
        }
        if self.nested {
            let side = self.inner[0];
            let (i, j) = ((index / 2) % side, (index / 2) / side);
            return match index % 2 {
                0 if j == 0 => FacePart::Edge(0),
                0 if i == side - 1 => FacePart::Edge(1),
                1 if j == side - 1 => FacePart::Edge(2),
                1 if i == 0 => FacePart::Edge(3),
                _ => FacePart::Inside,
            };
        }
        let [across, down] = self.inner.map(|segments| segments - 2);
        let Some(mut rest) = index.checked_sub(2 * across * down) else {
            return FacePart::Inside;
        };
        for (edge, outer) in (0..).zip(self.edge) {
            let strip = outer + if edge % 2 == 0 { across } else { down };
            if rest < strip {
                return FacePart::Edge(edge);
            }
            rest -= strip;
        }
        FacePart::Inside
    }
}

impl Face {
    /// The fixed-point factor of a part; inside, the larger of the two.
    #[must_use]
    pub fn part_factor(&self, part: FacePart) -> u32 {
        match part {
            FacePart::Edge(edge) => self.factors.edges[usize::from(edge)],
            FacePart::Inside => {
                let [across, down] = self.inner_factors();
                across.max(down)
            }
        }
    }
}

impl<S: PageSource> ViewMesh<'_, S> {
    /// `faces`: what each triangle belongs to, in the order of [`build_with`](Self::build_with), which
    /// is given the same `faces` and factors and says what `scale` is.
    #[must_use]
    pub fn faces(
        &self,
        faces: &[(Node, u32)],
        factors: &[FaceFactors],
        scale: u32,
    ) -> Vec<TriangleFace> {
        let mut triangles = Vec::new();
        for (number, ((node, _), factors)) in (0..).zip(faces.iter().zip(factors)) {
            if factors.culled {
                continue;
            }
            let face = self.face([IVec2::ZERO; 4], factors, scale);
            let counts = face.counts();
            triangles.extend((0..counts.triangles()).map(|index| {
                let part = counts.part(index);
                TriangleFace {
                    face: number,
                    level: node.level,
                    part,
                    factor: face.part_factor(part),
                }
            }));
        }
        triangles
    }

    /// What the stored bounds say of the vertical error that the triangles of a part of face `face` of
    /// `node` leave, in pixels on the screen, where the face has `factors`, brought down by `2^-scale`:
    /// as the screen-error policy ([`FactorView::wanted_by_error`](super::FactorView::wanted_by_error))
    /// counts it. Detail is none of it.
    #[must_use]
    pub fn part_error_px(
        &self,
        node: &Node,
        face: u32,
        factors: &FaceFactors,
        scale: u32,
        part: FacePart,
    ) -> f32 {
        let corners = self.corners(node, face);
        let ends = corners.map(|point| EdgeEnd {
            point,
            height_m: self.displaced(point, node.level).0,
        });
        let drawn = self.face(corners, factors, scale);
        let reader = DensityReader {
            lattice: self.lattice,
            lod: self.lod,
            field: self.field,
            source: self.pages,
        };
        let ij = self.place(face);
        let sample_m = self.factor_view.unit_m * (1_u32 << self.lattice.unit_log2) as f32;
        let squares = match part {
            FacePart::Edge(edge) => {
                let edge = usize::from(edge);
                let (from, to) = (ij + AROUND[edge], ij + AROUND[(edge + 1) % 4]);
                reader.edge_squares(node.level, node.origin, from, to)
            }
            FacePart::Inside => reader.face_squares(node.level, node.origin, ij),
        };
        let errors = reader.errors(&squares).fine;
        let edge_px = |edge: usize, factor: u32| {
            let [a, b] = edge_ends(edge).map(|corner| ends[corner]);
            let projected = self.factor_view.project(a, b);
            self.factor_view
                .error_px(&projected, &errors, factor, sample_m)
        };
        match part {
            FacePart::Edge(edge) => edge_px(usize::from(edge), drawn.part_factor(part)),
            FacePart::Inside => {
                let inner = drawn.inner_factors();
                (0..4)
                    .map(|edge| edge_px(edge, inner[edge % 2]))
                    .fold(0.0, f32::max)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tessellate::{FACTOR_MAX, FACTOR_ONE, Partitioning};
    use proptest::prelude::*;

    fn factor() -> impl Strategy<Value = u32> {
        prop_oneof![
            Just(FACTOR_ONE),
            FACTOR_ONE..=6 * FACTOR_ONE,
            FACTOR_ONE..=FACTOR_MAX
        ]
    }

    proptest! {
        #[test]
        fn the_triangles_that_touch_an_edge_belong_to_one_and_those_inside_to_none(
            kind in 0..Partitioning::ALL.len(),
            factors in prop::array::uniform6(factor()),
        ) {
            let [a, b, c, d, across, down] = factors;
            let face = Face {
                corners: [IVec2::ZERO; 4],
                factors: FaceFactors { edges: [a, b, c, d], inside: [across, down], culled: false },
                partitioning: Partitioning::ALL[kind],
            };
            let counts = face.counts();
            let rim: u32 = counts.edge.iter().sum();
            if counts.inner[0] == 0 {
                prop_assert_eq!(counts.part(0), FacePart::Inside);
                prop_assert_eq!(counts.part(1), FacePart::Inside);
                return Ok(());
            }
            // The rim's vertices, by the edge that each begins on.
            let mut starts = [0; 5];
            for edge in 0..4 {
                starts[edge + 1] = starts[edge] + counts.edge[edge];
            }
            for index in 0..counts.triangles() {
                let corners = face.triangle(&counts, index);
                let outside: Vec<u32> = corners.into_iter().filter(|&corner| corner < rim).collect();
                match counts.part(index) {
                    FacePart::Inside => prop_assert!(
                        counts.nested || outside.is_empty(),
                        "{index}: {corners:?} touches the rim"
                    ),
                    FacePart::Edge(edge) => {
                        let (first, end) = (starts[usize::from(edge)], starts[usize::from(edge) + 1]);
                        let on = |corner: u32| (first..=end).contains(&corner) || (edge == 3 && corner == 0);
                        prop_assert!(!outside.is_empty(), "{index}: {corners:?}");
                        if !counts.nested {
                            prop_assert!(outside.iter().all(|&corner| on(corner)), "{index}: {corners:?}");
                        }
                        prop_assert!(outside.iter().any(|&corner| on(corner)), "{index}: {corners:?}");
                    }
                }
            }
        }
    }
}
