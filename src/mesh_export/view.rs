//! What an eye draws of a terrain, on all cores.

use super::tiles::StoredTiles;
use super::{MeshError, MeshSettings};
use crate::lattice::{Lattice, Node, ResidencyField, ViewLod};
use crate::terrain::{GroundQuery, TerrainManifest};
use crate::tessellate::{FaceFactors, FactorView, PageSource, TerrainMesh, ViewMesh};
use glam::{DVec2, DVec3};
use rayon::prelude::*;

/// Faces that a task classifies or cuts.
const FACES_A_TASK: usize = 256;

/// A camera's view of a terrain.
pub(super) struct View {
    pub lod: ViewLod,
    factors: FactorView,
}

impl View {
    pub fn new(
        lattice: &Lattice,
        manifest: &TerrainManifest,
        settings: &MeshSettings,
        eye_m: DVec3,
    ) -> Result<Self, MeshError> {
        let spacing_m = manifest.file.spacing_m;
        let (eye, eye_fraction) =
            lattice.lattice_from_local(DVec2::new(eye_m.x, eye_m.z), spacing_m);
        let floor = GroundQuery { lattice, manifest }.distance(eye, eye_m.y);
        let focal_px = 0.5 * settings.height_px / (0.5 * settings.fov_deg.to_radians()).tan();
        Ok(Self {
            lod: ViewLod::new(lattice, &settings.lod, eye, floor, true)?,
            factors: FactorView {
                eye,
                eye_fraction,
                eye_height_m: eye_m.y as f32,
                unit_m: lattice.unit_m(spacing_m) as f32,
                segments_per_radian: (focal_px / settings.triangle_width_px) as f32,
                segments_per_m: 0.0,
                min_triangle_m: settings.least_triangle_m(spacing_m) as f32,
                max_factor: settings.max_factor as f32,
                density_strength: settings.density as f32,
                focal_px: focal_px as f32,
                px_per_m: 0.0,
                max_error_px: settings.max_error_px.unwrap_or(0.0) as f32,
                error_units_per_m: manifest.file.error_units_per_m() as f32,
            },
        })
    }

    pub fn mesh<'a, 'b>(
        &'a self,
        lattice: &'a Lattice,
        manifest: &TerrainManifest,
        field: &'a ResidencyField,
        tiles: &'a StoredTiles<'b>,
        settings: &MeshSettings,
    ) -> ViewMesh<'a, StoredTiles<'b>> {
        ViewMesh {
            lattice,
            lod: &self.lod,
            field,
            factor_view: &self.factors,
            partitioning: settings.partitioning,
            pages: tiles,
            height_min_m: manifest.file.height_min_m as f32,
            height_step_m: manifest.file.height_step_m as f32,
            max_vertices: settings.max_vertices,
            max_triangles: settings.max_triangles,
            culling: None,
            detail: None,
        }
    }
}

/// A view's mesh in pieces.
pub(super) struct Cut {
    pub meshes: Vec<TerrainMesh>,
    pub scale: u32,
    pub fits: bool,
}

/// All passes over all nodes of the view: what [`ViewMesh::build`] makes, on all cores.
pub(super) fn cut<S: PageSource + Sync>(
    view: &ViewMesh<'_, S>,
    progress: &(dyn Fn(u64, u64) + Sync),
) -> Cut {
    let lattice = view.lattice;
    let mut nodes = Vec::new();
    view.lod
        .select(lattice, &mut |_, _| true, &mut |node| nodes.push(node));
    let faces_a_node = 1_u32 << (2 * lattice.faces_log2);
    let faces: Vec<(Node, u32)> = nodes
        .iter()
        .flat_map(|node| (0..faces_a_node).map(|face| (*node, face)))
        .collect();
    let all = 2 * faces.len() as u64;
    let factors: Vec<FaceFactors> = faces
        .par_chunks(FACES_A_TASK)
        .flat_map_iter(|faces| {
            progress(faces.len() as u64, all);
            faces.iter().map(|(node, face)| view.classify(node, *face))
        })
        .collect();
    let scale = view.setup(&factors);
    // A piece doesn't know how large the whole is: its factors come scaled.
    let piece = ViewMesh {
        max_vertices: u32::MAX,
        max_triangles: u32::MAX,
        ..*view
    };
    let meshes: Vec<TerrainMesh> = faces
        .par_chunks(FACES_A_TASK)
        .zip(factors.par_chunks(FACES_A_TASK))
        .map(|(faces, factors)| {
            progress(faces.len() as u64, all);
            let scaled = factors.iter().map(|factors| factors.scaled(scale));
            piece.build_with(faces, scaled.collect())
        })
        .collect();
    let count = |of: fn(&TerrainMesh) -> usize| meshes.iter().map(of).sum::<usize>() as u64;
    let fits = count(|mesh| mesh.vertices.len()) <= u64::from(view.max_vertices)
        && count(|mesh| mesh.triangles.len()) <= u64::from(view.max_triangles);
    Cut {
        meshes,
        scale,
        fits,
    }
}
