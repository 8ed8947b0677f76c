//! Terrains, paths over them, and the height that a view draws at a place.

use crate::common::random::Random;
use bevy_tessera::bake::generate::{GenerateSettings, GeneratedSource, GeneratorKind};
use bevy_tessera::bake::import::{self, ImportSettings};
use bevy_tessera::bake::{BakeSettings, HeightSource, bake};
use bevy_tessera::density::DensitySettings;
use bevy_tessera::lattice::{Lattice, LodSettings, Node, ResidencyField, ViewLod, lerp};
use bevy_tessera::terrain::{ManifestFile, TerrainManifest};
use bevy_tessera::tessellate::{
    Face, FaceCounts, FaceFactors, FaceVertex, FactorView, PageSource, Pages, Partitioning,
    ViewMesh,
};
use bevy_tessera::tile::{TerrainTile, TileAddress, TileIndex};
use glam::{DVec2, DVec3, IVec2};
use std::path::Path;
use std::sync::Arc;

/// Half of 1080 pixels over the tangent of half of 60 degrees.
pub const FOCAL_PX: f64 = 540.0 / 0.577_350_27;
/// How far the eye moves in a step.
const STEP_M: f64 = 0.05;
/// How wide triangles are wanted.
const TRIANGLE_WIDTH_PX: f64 = 6.0;
/// Faces a side of a node, as terrains have unless told otherwise.
const FACES_PER_SIDE: u32 = 8;

/// A place on the ground, as a lattice point.
pub type Place = IVec2;

/// A terrain whose tiles are all there.
pub struct World {
    pub name: &'static str,
    pub file: ManifestFile,
    pub index: TileIndex,
    pub lattice: Lattice,
    pub field: ResidencyField,
    pub pages: Pages,
}

/// A camera's path: where the eye is at every step.
pub struct Stretch {
    pub name: &'static str,
    pub eyes_m: Vec<DVec3>,
}

/// What a view draws at a place.
#[derive(Clone, Debug, PartialEq)]
pub struct Drawn {
    pub node: Node,
    pub face: u32,
    pub factors: FaceFactors,
    pub counts: FaceCounts,
    pub triangle: u32,
    /// Whether the triangle belongs to the strips that join a face's inner grid to its edges.
    pub in_strip: bool,
    pub height_m: f64,
}

pub struct View {
    pub lod: ViewLod,
    pub factors: FactorView,
}

impl World {
    pub fn bake(
        name: &'static str,
        source: &mut dyn HeightSource,
        settings: &BakeSettings,
    ) -> Self {
        let folder = tempfile::tempdir().expect("a temporary folder");
        let dir = folder.path().join("terrain");
        bake(source, &dir, settings, &()).unwrap_or_else(|error| panic!("{error}"));
        let manifest = TerrainManifest::read(&dir).expect("baked just now");
        let mut pages = Pages::default();
        for (address, _) in manifest.index.iter() {
            let bytes = std::fs::read(dir.join(TerrainTile::path(address))).expect("readable");
            let tile = TerrainTile::decode(&bytes, address).expect("good");
            pages.tiles.insert(address, Arc::new(tile));
        }
        let TerrainManifest { file, index } = manifest;
        let lattice = Lattice::new(file.size, file.levels, 0, FACES_PER_SIDE).expect("it fits");
        Self {
            name,
            field: ResidencyField::new(&lattice, 0),
            lattice,
            file,
            index,
            pages,
        }
    }

    /// The elevation model that comes with the crate, a sample every 30 m.
    pub fn bundled() -> Self {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/elevation/jacksboro_u16.png");
        let settings = ImportSettings {
            scale: Some(0.02),
            offset: Some(200.0),
            ..Default::default()
        };
        let mut source = import::open(&file, &settings).expect("bundled");
        let settings = BakeSettings {
            spacing_m: Some(30.0),
            ..Default::default()
        };
        Self::bake("bundled", &mut *source, &settings)
    }

    /// A survey of Slovenia by lidar, a sample every metre, where `TESSERA_DATA` says where it is.
    pub fn lidar() -> Option<Self> {
        let Some(data) = std::env::var_os("TESSERA_DATA") else {
            println!("skipped: TESSERA_DATA is not set");
            return None;
        };
        let file = Path::new(&data).join("terrain/slovenia_lidar_1m_f32.tif");
        let mut source = import::open(&file, &ImportSettings::default())
            .unwrap_or_else(|error| panic!("{error}"));
        Some(Self::bake("lidar", &mut *source, &BakeSettings::default()))
    }

    /// Ground of a sample every metre.
    pub fn generated(name: &'static str, relief_m: f64, roughness: f64, gain: f32) -> Self {
        let mut settings = GenerateSettings::new(GeneratorKind::Hybrid, [1025, 1025]);
        settings.seed = 11;
        settings.wavelength_m = 300.0;
        settings.relief_m = relief_m;
        settings.roughness = roughness;
        settings.octaves = 10;
        let mut source = GeneratedSource::new(settings).expect("valid");
        let settings = BakeSettings {
            density: DensitySettings {
                gain,
                ..Default::default()
            },
            ..Default::default()
        };
        Self::bake(name, &mut source, &settings)
    }

    /// Rocks, a sample every metre: nearly all of it has full density.
    pub fn rough() -> Self {
        Self::generated("rough", 120.0, 0.9, 1.0)
    }

    /// Hills, a sample every metre, with densities of all kinds: half of the most on average.
    pub fn hills() -> Self {
        Self::generated("hills", 60.0, 1.0, 1.0)
    }

    /// Rocks again, with densities as nobody should have them: too low by far.
    pub fn sparse() -> Self {
        Self::generated("sparse", 120.0, 0.9, 0.05)
    }

    pub fn place(&self, metres: DVec2) -> Place {
        let (point, _) = self.lattice.lattice_from_local(metres, self.file.spacing_m);
        self.lattice.clamp(point)
    }

    /// The ground itself, read from the finest tiles.
    pub fn ground_m(&self, place: Place) -> f64 {
        let unit = f64::from(1 << self.lattice.unit_log2);
        let at = place.as_dvec2() / unit;
        let sample = at.floor().as_ivec2();
        let rest = at - at.floor();
        let stored = |dx, dz| {
            let sample = sample + IVec2::new(dx, dz);
            let tile = sample / 128;
            let address = TileAddress::new(0, tile.x as u32, tile.y as u32);
            let local = sample - tile * 128;
            // Beyond the rim nothing is asked for.
            self.pages
                .height(address, local.x, local.y)
                .map_or(0.0, f64::from)
        };
        let near = stored(0, 0) * (1.0 - rest.x) + stored(1, 0) * rest.x;
        let far = stored(0, 1) * (1.0 - rest.x) + stored(1, 1) * rest.x;
        let stored = near * (1.0 - rest.y) + far * rest.y;
        self.file.height_min_m + stored * self.file.height_step_m
    }

    /// Paths of `steps` steps: over open ground, across the corner of four tiles, and upwards.
    pub fn stretches(&self, steps: usize) -> Vec<Stretch> {
        let tile_m = 128.0 * self.file.spacing_m;
        let half = 0.5 * STEP_M * steps as f64;
        let corner = DVec2::splat(4.0 * tile_m);
        let along = |name, middle: DVec2, heading: f64, rise: f64| {
            let direction = DVec2::from_angle(heading);
            let start = middle - direction * half;
            let ground = |at: DVec2| {
                // The mean of some metres around, or a rough path would be no smooth one.
                let around = (-10..=10)
                    .flat_map(|x| (-10..=10).map(move |z| DVec2::new(x.into(), z.into())));
                around
                    .map(|offset| self.ground_m(self.place(at + offset)))
                    .sum::<f64>()
                    / 441.0
            };
            let mut y = ground(start) + 3.0;
            let flat = (1.0 - rise * rise).sqrt() * STEP_M;
            let eyes_m = (0..=steps)
                .map(|step| {
                    let at = start + direction * (flat * step as f64);
                    if rise >= 1.0 {
                        y += STEP_M;
                    } else {
                        let wanted = ground(at) + 3.0 + (step as f64 * 0.02).sin();
                        let most = rise * STEP_M;
                        y += (wanted - y).clamp(-most, most);
                    }
                    DVec3::new(at.x, y, at.y)
                })
                .collect();
            Stretch { name, eyes_m }
        };
        vec![
            along("open", DVec2::new(2.31, 2.64) * tile_m, 0.4, 0.6),
            along("corner", corner + DVec2::new(0.2, -0.1), 0.9, 0.6),
            along("border", corner + DVec2::new(-0.7 * tile_m, 0.4), 0.05, 0.6),
            along("upwards", DVec2::new(3.1, 5.2) * tile_m, 0.0, 1.0),
        ]
    }

    /// The distance to the nearest of all finest tiles' boxes, as cameras have it.
    pub fn distance_to_ground(&self, eye: IVec2, height_m: f64) -> i32 {
        let leaves = self.index.iter().filter(|(address, _)| address.level == 0);
        let distances = leaves.map(|(address, range)| {
            let low = IVec2::new(address.x as i32, address.z as i32) * self.lattice.node_size(0);
            let high = (low + self.lattice.node_size(0)).min(self.lattice.extent);
            let outside = (low - eye).max(eye - high).max_element().max(0);
            let (bottom, top) = (self.file.height_m(range.min), self.file.height_m(range.max));
            let above_m = (bottom - height_m).max(height_m - top).max(0.0);
            outside.max((above_m / self.lattice.unit_m(self.file.spacing_m)) as i32)
        });
        distances.min().expect("there are tiles")
    }

    pub fn view(&self, eye_m: DVec3, density: f32) -> View {
        let (eye, eye_fraction) = self
            .lattice
            .lattice_from_local(DVec2::new(eye_m.x, eye_m.z), self.file.spacing_m);
        let floor = self.distance_to_ground(eye, eye_m.y);
        View {
            lod: ViewLod::new(&self.lattice, &LodSettings::default(), eye, floor, true)
                .expect("valid"),
            factors: FactorView {
                eye,
                eye_fraction,
                eye_height_m: eye_m.y as f32,
                unit_m: self.lattice.unit_m(self.file.spacing_m) as f32,
                segments_per_radian: (FOCAL_PX / TRIANGLE_WIDTH_PX) as f32,
                segments_per_m: 0.0,
                min_triangle_m: self.file.spacing_m as f32,
                max_factor: 64.0,
                density_strength: density,
                focal_px: FOCAL_PX as f32,
                px_per_m: 0.0,
                max_error_px: 0.0,
                error_units_per_m: self.file.error_units_per_m() as f32,
            },
        }
    }

    pub fn mesh<'a>(&'a self, view: &'a View, partitioning: Partitioning) -> ViewMesh<'a, Pages> {
        ViewMesh {
            lattice: &self.lattice,
            lod: &view.lod,
            field: &self.field,
            factor_view: &view.factors,
            partitioning,
            pages: &self.pages,
            height_min_m: self.file.height_min_m as f32,
            height_step_m: self.file.height_step_m as f32,
            max_vertices: u32::MAX,
            max_triangles: u32::MAX,
            culling: None,
            detail: None,
        }
    }

    /// The node that `view` draws at `place`.
    pub fn node_at(&self, view: &View, place: Place) -> Node {
        let mut found = None;
        view.lod.select(
            &self.lattice,
            &mut |_, bounds| place.cmpge(bounds.low).all() && place.cmple(bounds.high).all(),
            &mut |node| found = found.or(Some(node)),
        );
        found.expect("nodes cover the terrain")
    }

    /// Faces of `node` whose corners surround `place`, roughly.
    pub fn faces_at(&self, view: &View, node: &Node, place: Place) -> Vec<(u32, [IVec2; 4])> {
        let mesh = self.mesh(view, Partitioning::FractionalOdd);
        let side = 1 << self.lattice.faces_log2;
        let ij = (place - node.origin) / self.lattice.face_size(node.level);
        let mut faces = Vec::new();
        for dj in -1..=1 {
            for di in -1..=1 {
                let ij = ij + IVec2::new(di, dj);
                if ij.min_element() < 0 || ij.max_element() >= side {
                    continue;
                }
                let face = (ij.y * side + ij.x) as u32;
                let corners = mesh.corners(node, face);
                let low = corners.into_iter().reduce(IVec2::min).expect("four");
                let high = corners.into_iter().reduce(IVec2::max).expect("four");
                if place.cmpge(low - 1).all() && place.cmple(high + 1).all() {
                    faces.push((face, corners));
                }
            }
        }
        faces
    }

    /// What `view` draws at `place`; `factors` classifies faces, once for all partitionings.
    pub fn drawn(
        &self,
        view: &View,
        partitionings: &[Partitioning],
        place: Place,
        factors: impl Fn(&Node, u32) -> FaceFactors,
    ) -> Vec<Drawn> {
        let node = self.node_at(view, place);
        let faces: Vec<_> = self
            .faces_at(view, &node, place)
            .into_iter()
            .map(|(face, corners)| (face, corners, factors(&node, face)))
            .collect();
        partitionings
            .iter()
            .map(|&partitioning| {
                faces
                    .iter()
                    .find_map(|&(face, corners, factors)| {
                        let cut = self.cut(partitioning, node, face, corners, factors);
                        self.in_face(view, &cut, place)
                    })
                    .unwrap_or_else(|| panic!("no triangle of {node:?} holds {place}"))
            })
            .collect()
    }

    /// A face's vertices, ready to be asked for places.
    pub fn cut(
        &self,
        partitioning: Partitioning,
        node: Node,
        number: u32,
        corners: [IVec2; 4],
        factors: FaceFactors,
    ) -> Cut {
        let face = Face {
            corners,
            factors,
            partitioning,
        };
        let counts = face.counts();
        Cut {
            node,
            number,
            counts,
            vertices: (0..counts.vertices())
                .map(|vertex| face.vertex(&counts, vertex))
                .collect(),
            face,
        }
    }

    /// What `view` draws at `place`, if the face holds it.
    pub fn in_face(&self, view: &View, cut: &Cut, place: Place) -> Option<Drawn> {
        let Cut { face, counts, .. } = cut;
        let (triangle, corners) = (0..counts.triangles()).find_map(|triangle| {
            let corners = face
                .triangle(counts, triangle)
                .map(|vertex| cut.vertices[vertex as usize]);
            let points = corners.map(|vertex| vertex.drawn());
            holds(points, place).then_some((triangle, corners))
        })?;
        let mesh = self.mesh(view, face.partitioning);
        let heights =
            corners.map(|vertex| f64::from(mesh.vertex(&vertex, cut.node.level).height_m));
        let [a, b, c] = corners.map(|vertex| vertex.drawn());
        let area = area2(a, b, c) as f64;
        let weights = [area2(b, c, place), area2(c, a, place), area2(a, b, place)];
        let height_m = (0..3).map(|k| weights[k] as f64 / area * heights[k]).sum();
        let grid = match counts.inner {
            [0, _] => u32::MAX,
            inner => inner.map(|segments| segments - 2).iter().product::<u32>() * 2,
        };
        Some(Drawn {
            node: cut.node,
            face: cut.number,
            factors: face.factors,
            counts: *counts,
            triangle,
            in_strip: triangle >= grid,
            height_m,
        })
    }
}

/// A face with its vertices.
pub struct Cut {
    pub node: Node,
    pub number: u32,
    pub face: Face,
    pub counts: FaceCounts,
    pub vertices: Vec<FaceVertex>,
}

pub fn area2(a: IVec2, b: IVec2, c: IVec2) -> i64 {
    let [u, v] = [b - a, c - a].map(|d| (i64::from(d.x), i64::from(d.y)));
    u.0 * v.1 - v.0 * u.1
}

/// Whether a triangle of some area holds `place`.
pub fn holds([a, b, c]: [IVec2; 3], place: Place) -> bool {
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    if place.cmplt(low).any() || place.cmpgt(high).any() {
        return false;
    }
    let whole = area2(a, b, c);
    let parts = [area2(a, b, place), area2(b, c, place), area2(c, a, place)];
    whole != 0 && parts.iter().all(|part| part.signum() * whole.signum() >= 0)
}

impl Cut {
    /// A place in the face, more often than not near its edges, where triangles differ most.
    pub fn random_place(&self, random: &mut Random) -> Place {
        let counts = self.counts.inner.map(|segments| segments.max(2) as f32);
        let mut at = [random.unit(), random.unit()];
        let near = random.below(3);
        for (axis, at) in at.iter_mut().enumerate() {
            if near == axis as i32 {
                let strip = *at * 3.0 / counts[axis];
                *at = if random.below(2) == 0 {
                    strip
                } else {
                    1.0 - strip
                };
            }
        }
        let [u, v] = at.map(|t| (t.clamp(0.0, 1.0) * 65536.0) as i32);
        let [c00, c10, c11, c01] = self.face.corners;
        lerp(lerp(c00, c10, u), lerp(c01, c11, u), v)
    }
}
