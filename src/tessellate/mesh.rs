//! A whole view's mesh on the CPU.

use super::edge_density::Squares;
use super::height::height;
use super::{
    DENSITY_ONE, DensityReader, EdgeEnd, FACTOR_ONE, FACTOR_SCALES, Face, FaceFactors, FaceVertex,
    FactorView, GroundErrors, LocalVolume, PageSource, Partitioning, ProjectedEdge, edge_ends,
};
use crate::detail::{DETAIL_SLOPE, DetailKernel};
use crate::lattice::{Lattice, Node, ONE, ResidencyField, ViewLod};
use glam::{IVec2, Vec2, Vec3};

/// The corners of a face, around it.
const AROUND: [IVec2; 4] = [IVec2::ZERO, IVec2::X, IVec2::ONE, IVec2::Y];

/// A vertex as the passes write it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TerrainVertex {
    /// Its lattice point, morphed.
    pub point: IVec2,
    /// Height in metres above the terrain's origin.
    pub height_m: f32,
    /// Level of detail at the point, 16.16.
    pub lambda: i32,
}

/// A view's vertices and triangles, in the order that the passes write them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TerrainMesh {
    /// Vertices, face by face.
    pub vertices: Vec<TerrainVertex>,
    /// Triangles, counter-clockwise seen from above.
    pub triangles: Vec<[u32; 3]>,
    /// The factors of every face before scaling, node by node.
    pub factors: Vec<FaceFactors>,
    /// Power of two by which all factors were brought down to fit the budget.
    pub scale: u32,
}

/// What faces are culled by.
#[derive(Clone, Copy)]
pub struct FaceCulling<'a> {
    /// Everything that looks at the view's nodes.
    pub volumes: &'a [LocalVolume],
    /// The lowest and the highest height that a node may be drawn with, metres.
    pub heights_m: &'a (dyn Fn(&Node) -> [f32; 2] + Sync),
}

/// What the ground beside an edge, or inside a face, asks for.
#[derive(Clone, Copy)]
enum Asked {
    /// So many of the wanted segments, in units of [`DENSITY_ONE`].
    Density(u32),
    /// So many that no more than the bounds' part is left; and the density that detail needs.
    Error(GroundErrors, u32),
}

/// Everything that a view's mesh follows from.
pub struct ViewMesh<'a, S: PageSource> {
    /// The terrain's grid, with the view's faces a side.
    pub lattice: &'a Lattice,
    /// The view's level of detail.
    pub lod: &'a ViewLod,
    /// How finely heights may be read where.
    pub field: &'a ResidencyField,
    /// What factors follow from.
    pub factor_view: &'a FactorView,
    /// How factors become segments.
    pub partitioning: Partitioning,
    /// Stored heights and densities.
    pub pages: &'a S,
    /// Height of a stored 0, metres above the terrain's origin.
    pub height_min_m: f32,
    /// Metres a stored unit.
    pub height_step_m: f32,
    /// Vertices that there is room for.
    pub max_vertices: u32,
    /// Triangles that there is room for.
    pub max_triangles: u32,
    /// What faces are culled by; `None` draws all.
    pub culling: Option<FaceCulling<'a>>,
    /// What is added to the stored heights.
    pub detail: Option<&'a DetailKernel>,
}

impl<S: PageSource> ViewMesh<'_, S> {
    /// Height in metres and level of detail at `p`, as a node of `level` draws them.
    ///
    /// # Panics
    /// Where the residency field promises a tile that `pages` doesn't hold.
    #[must_use]
    pub fn displaced(&self, p: IVec2, level: i32) -> (f32, i32) {
        let (height_m, lambda, _) = self.displaced_by_weight(p, level);
        (height_m, lambda)
    }

    /// The same, and the weight of detail there.
    fn displaced_by_weight(&self, p: IVec2, level: i32) -> (f32, i32, f32) {
        let (stored_m, lambda) = self.stored(p, level);
        let Some(detail) = self.detail else {
            return (stored_m, lambda, 0.0);
        };
        let weight = self.detail_weight(detail, p, level, stored_m);
        let added_m = detail.height_m(p, weight, self.finest_log2(p, level));
        (stored_m + added_m, lambda, weight)
    }

    /// How much detail there is at `p`, 0..=1, where the stored height is `stored_m`.
    fn detail_weight(&self, detail: &DetailKernel, p: IVec2, level: i32, stored_m: f32) -> f32 {
        let mut gradient = Vec2::ZERO;
        if detail.rule == DETAIL_SLOPE {
            let lambda = self.lod.lambda(self.lattice, self.field, p, level);
            let reach = 1 << (self.lattice.unit_log2 + (lambda >> 16).cast_unsigned());
            for (axis, step) in [IVec2::X, IVec2::Y].into_iter().enumerate() {
                let low = self.lattice.clamp(p - step * reach);
                let high = self.lattice.clamp(p + step * reach);
                let rise_m = self.stored(high, level).0 - self.stored(low, level).0;
                let run_m = (high - low)[axis] as f32 * self.factor_view.unit_m;
                gradient[axis] = rise_m / run_m;
            }
        }
        detail.weight(stored_m, gradient)
    }

    /// `log2` of the spacing of vertices at `p` that the view can afford, in lattice units, 16.16: by
    /// the wanted width of a triangle there, and by the finest cut of the level's faces.
    fn finest_log2(&self, p: IVec2, level: i32) -> i32 {
        let view = self.factor_view;
        let width = if view.segments_per_m > 0.0 {
            1.0 / (view.segments_per_m * view.unit_m)
        } else {
            self.lod.distance(p).max(1) as f32 / view.segments_per_radian
        };
        let face_log2 = self.lattice.node_log2(level) - self.lattice.faces_log2;
        let cut = face_log2 as f32 - view.max_factor.log2();
        #[expect(clippy::cast_possible_truncation, reason = "logarithms are small")]
        let [by_width, by_cut] = [width.log2(), cut].map(|log2| (log2 * ONE as f32) as i32);
        by_width.max(by_cut + self.lod.morph(self.lattice, p, level))
    }

    /// Stored height in metres and level of detail at `p`, as a node of `level` reads them.
    fn stored(&self, p: IVec2, level: i32) -> (f32, i32) {
        let lambda = self.lod.lambda(self.lattice, self.field, p, level);
        let stored = height(self.pages, self.lattice, p, lambda)
            .expect("the residency field never promises a tile that isn't there");
        (self.height_min_m + stored * self.height_step_m, lambda)
    }

    /// `vertices`: a vertex of a face of a node of `level` as it is drawn.
    #[must_use]
    pub fn vertex(&self, vertex: &FaceVertex, level: i32) -> TerrainVertex {
        let (own_m, mut lambda) = self.displaced(vertex.point, level);
        let mut height_m = own_m;
        let point = vertex.drawn();
        if vertex.rise != ONE {
            let [a_m, b_m] = vertex.parents.map(|parent| self.displaced(parent, level).0);
            let between_m = 0.5 * (a_m + b_m);
            height_m = between_m + (own_m - between_m) * (vertex.rise as f32 / ONE as f32);
            lambda = self.lod.lambda(self.lattice, self.field, point, level);
        }
        TerrainVertex {
            point,
            height_m,
            lambda,
        }
    }

    /// Column and row of face `face` in its node.
    pub(super) fn place(&self, face: u32) -> IVec2 {
        let side = 1 << self.lattice.faces_log2;
        IVec2::new(face.cast_signed() % side, face.cast_signed() / side)
    }

    /// The corners of face `face` of `node`, around it.
    #[must_use]
    pub fn corners(&self, node: &Node, face: u32) -> [IVec2; 4] {
        let ij = self.place(face);
        AROUND.map(|corner| {
            self.lattice
                .control_vertex(self.lod, node.level, node.origin, ij + corner)
        })
    }

    /// `classify`: the factors of face `face` of `node`.
    #[must_use]
    pub fn classify(&self, node: &Node, face: u32) -> FaceFactors {
        let corners = self.corners(node, face);
        if self.is_culled(node, &corners) {
            return FaceFactors {
                edges: [FACTOR_ONE; 4],
                inside: [FACTOR_ONE; 2],
                culled: true,
            };
        }
        let displaced = corners.map(|point| self.displaced_by_weight(point, node.level));
        let ends: [EdgeEnd; 4] = std::array::from_fn(|k| EdgeEnd {
            point: corners[k],
            height_m: displaced[k].0,
        });
        // The density that detail needs at the corners.
        let needed = displaced.map(|(.., weight)| self.detail.map_or(0, |it| it.density(weight)));
        let reader = DensityReader {
            lattice: self.lattice,
            lod: self.lod,
            field: self.field,
            source: self.pages,
        };
        let ij = self.place(face);
        let inside = self.ask(
            &reader,
            &reader.face_squares(node.level, node.origin, ij),
            needed.into_iter().max().unwrap_or(0),
        );
        let factors: [[u32; 2]; 4] = std::array::from_fn(|e| {
            let next = (e + 1) % 4;
            let [a, b] = edge_ends(e).map(|corner| ends[corner]);
            let edge = self.factor_view.project(a, b);
            let (from, to) = (ij + AROUND[e], ij + AROUND[next]);
            let squares = reader.edge_squares(node.level, node.origin, from, to);
            let beside = self.ask(&reader, &squares, needed[e].max(needed[next]));
            [beside, inside].map(|asked| self.factor(&edge, &asked))
        });
        let [edges, insides] = [0, 1].map(|which| factors.map(|factors| factors[which]));
        FaceFactors {
            edges,
            inside: [insides[0].max(insides[2]), insides[1].max(insides[3])],
            culled: false,
        }
    }

    /// `classify` while savings are counted: the factors that a face would have at a density strength of
    /// 0. Under the policy of errors, which asks no density, those that it has.
    #[must_use]
    pub fn classify_plain(&self, node: &Node, face: u32) -> FaceFactors {
        let corners = self.corners(node, face);
        if self.factor_view.max_error_px > 0.0 || self.is_culled(node, &corners) {
            return self.classify(node, face);
        }
        let ends = corners.map(|point| EdgeEnd {
            point,
            height_m: self.displaced(point, node.level).0,
        });
        let edges = std::array::from_fn(|e| {
            let [a, b] = edge_ends(e).map(|corner| ends[corner]);
            let edge = self.factor_view.project(a, b);
            FactorView::fixed(edge.wanted, edge.limit)
        });
        FaceFactors {
            edges,
            inside: [edges[0].max(edges[2]), edges[1].max(edges[3])],
            culled: false,
        }
    }

    /// Vertices and triangles of faces with these factors, were there room enough.
    #[must_use]
    pub fn totals(&self, factors: &[FaceFactors]) -> [u64; 2] {
        self.totals_at(factors, 0)
    }

    /// What `squares` ask for by the view's policy, where detail needs a density of `needed`.
    fn ask(&self, reader: &DensityReader<S>, squares: &Squares, needed: u32) -> Asked {
        if self.factor_view.max_error_px > 0.0 {
            Asked::Error(reader.errors(squares), needed)
        } else {
            Asked::Density(reader.density(squares).max(needed))
        }
    }

    fn factor(&self, edge: &ProjectedEdge, asked: &Asked) -> u32 {
        let view = self.factor_view;
        match asked {
            Asked::Density(density) => view.factor(*edge, *density),
            Asked::Error(errors, needed) => {
                let sample_m = view.unit_m * (1_u32 << self.lattice.unit_log2) as f32;
                let by_detail = edge.wanted * (*needed as f32 / DENSITY_ONE as f32);
                let wanted = view.wanted_by_error(edge, errors, sample_m).max(by_detail);
                FactorView::fixed(wanted, edge.limit)
            }
        }
    }

    /// Whether no volume may hold any of a face, wherever between the node's bounds its ground lies.
    fn is_culled(&self, node: &Node, corners: &[IVec2; 4]) -> bool {
        let Some(culling) = &self.culling else {
            return false;
        };
        let [lowest_m, highest_m] = (culling.heights_m)(node);
        let unit_m = self.factor_view.unit_m;
        let low = corners.iter().fold(IVec2::MAX, |low, p| low.min(*p));
        let high = corners.iter().fold(IVec2::MIN, |high, p| high.max(*p));
        let (low, high) = (low.as_vec2() * unit_m, high.as_vec2() * unit_m);
        let low = Vec3::new(low.x, lowest_m, low.y);
        let high = Vec3::new(high.x, highest_m, high.y);
        !culling
            .volumes
            .iter()
            .any(|volume| volume.may_hold(low, high))
    }

    /// Runs all passes over `nodes`: classify, setup, vertices, indices.
    #[must_use]
    pub fn build(&self, nodes: &[Node]) -> TerrainMesh {
        let faces_a_node = 1 << (2 * self.lattice.faces_log2);
        let faces: Vec<(Node, u32)> = nodes
            .iter()
            .flat_map(|node| (0..faces_a_node).map(|face| (*node, face)))
            .collect();
        let factors: Vec<FaceFactors> = faces
            .iter()
            .map(|(node, face)| self.classify(node, *face))
            .collect();
        self.build_with(&faces, factors)
    }

    /// Setup, vertices and indices for given factors: what tests hand the GPU's factors to.
    #[must_use]
    pub fn build_with(&self, faces: &[(Node, u32)], factors: Vec<FaceFactors>) -> TerrainMesh {
        let scale = self.setup(&factors);
        let mut mesh = TerrainMesh {
            scale,
            ..Default::default()
        };
        for ((node, face), factors) in faces.iter().zip(&factors) {
            if factors.culled {
                continue;
            }
            let face = self.face(self.corners(node, *face), factors, scale);
            let counts = face.counts();
            #[expect(clippy::cast_possible_truncation, reason = "bounded by max_vertices")]
            let first = mesh.vertices.len() as u32;
            for index in 0..counts.vertices() {
                mesh.vertices
                    .push(self.vertex(&face.vertex(&counts, index), node.level));
            }
            for index in 0..counts.triangles() {
                let triangle = face.triangle(&counts, index);
                mesh.triangles.push(triangle.map(|vertex| first + vertex));
            }
        }
        mesh.factors = factors;
        mesh
    }

    /// `setup`: the least scale at which everything fits. The whole view shares it, because edges
    /// must go on agreeing.
    #[must_use]
    pub fn setup(&self, factors: &[FaceFactors]) -> u32 {
        let last = FACTOR_SCALES as u32 - 1;
        (0..last)
            .find(|&scale| {
                let [vertices, triangles] = self.totals_at(factors, scale);
                vertices <= u64::from(self.max_vertices)
                    && triangles <= u64::from(self.max_triangles)
            })
            .unwrap_or(last)
    }

    fn totals_at(&self, factors: &[FaceFactors], scale: u32) -> [u64; 2] {
        let drawn = factors.iter().filter(|factors| !factors.culled);
        drawn.fold([0, 0], |[vertices, triangles], factors| {
            let counts = self.face([IVec2::ZERO; 4], factors, scale).counts();
            [
                vertices + u64::from(counts.vertices()),
                triangles + u64::from(counts.triangles()),
            ]
        })
    }

    pub(super) fn face(&self, corners: [IVec2; 4], factors: &FaceFactors, scale: u32) -> Face {
        Face {
            corners,
            factors: factors.scaled(scale),
            partitioning: self.partitioning,
        }
    }
}
