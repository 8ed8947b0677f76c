//! Structs that the passes share with Rust; each has its pair in `shaders/types.wgsl`, and
//! `tests/shaders.rs` compares their layouts.

use crate::density::{DensityExtent, DensityFilter, DensityKernel, DensitySettings};
use crate::lattice::{Lattice, MAX_LEVELS, Node, ViewLod};
use crate::terrain::ManifestFile;
use crate::tessellate::{FaceFactors, FactorView, LocalVolume, Partitioning};
use crate::tile::{DENSITY_TEXELS, TileAddress};
use bytemuck::{Pod, Zeroable};

/// Everything that a view's mesh follows from; WGSL `TerrainView`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuTerrainView {
    /// The eye's lattice point.
    pub eye: [i32; 2],
    /// The terrain's last lattice point.
    pub extent: [i32; 2],
    /// The eye's fraction of a lattice unit.
    pub eye_fraction: [f32; 2],
    /// The eye's height above the terrain's origin, metres.
    pub eye_height_m: f32,
    /// Metres per lattice unit.
    pub unit_m: f32,
    /// Floor of all distances, lattice units.
    pub distance_floor: i32,
    /// 1 where the distance in the plane counts.
    pub planar: u32,
    /// Lattice units per sample, as a power of two.
    pub unit_shift: u32,
    /// Faces a side, as a power of two.
    pub faces_shift: u32,
    /// Finest level of the geometry, 0 or below.
    pub leaf_level: i32,
    /// Coarsest level, that of the root tile.
    pub root_level: i32,
    /// [`Partitioning`] as a number.
    pub partitioning: u32,
    /// Nodes in the view.
    pub node_count: u32,
    /// See [`FactorView::segments_per_radian`].
    pub segments_per_radian: f32,
    /// See [`FactorView::segments_per_m`].
    pub segments_per_m: f32,
    /// See [`FactorView::min_triangle_m`].
    pub min_triangle_m: f32,
    /// See [`FactorView::max_factor`].
    pub max_factor: f32,
    /// Height of a stored 0, metres above the terrain's origin.
    pub height_min_m: f32,
    /// Metres a stored unit.
    pub height_step_m: f32,
    /// Side of a residency cell, as a power of two.
    pub field_cell_shift: u32,
    /// Room in the vertex buffer.
    pub max_vertices: u32,
    /// Residency cells in x and z.
    pub field_cells: [u32; 2],
    /// Room in the index buffer, triangles.
    pub max_triangles: u32,
    /// See [`FactorView::density_strength`].
    pub density_strength: f32,
    /// Volumes that faces are culled by; with 0 none is.
    pub volume_count: u32,
    /// See [`FactorView::focal_px`].
    pub focal_px: f32,
    /// See [`FactorView::px_per_m`].
    pub px_per_m: f32,
    /// See [`FactorView::max_error_px`].
    pub max_error_px: f32,
    /// See [`FactorView::error_units_per_m`].
    pub error_units_per_m: f32,
    /// Padding.
    pub unused_a: u32,
    /// Padding.
    pub unused_b: u32,
    /// 1 where it is counted what the view would have at a density strength of 0.
    pub counts_plain: u32,
    /// Per geometry level: where it begins to morph, its zone as a power of two.
    pub geometry: [[i32; 4]; MAX_LEVELS],
    /// Per tile level: first entry in the page table, tiles in x and z.
    pub tiles: [[u32; 4]; MAX_LEVELS],
    /// Six planes a volume.
    pub volumes: [[[f32; 4]; 6]; MAX_VOLUMES],
}

/// Volumes that faces can be culled by; where more look at a terrain, whole nodes are culled only.
pub const MAX_VOLUMES: usize = 16;

impl GpuTerrainView {
    /// Sets what faces are culled by.
    pub fn set_volumes(&mut self, volumes: &[LocalVolume]) {
        let count = if volumes.len() > MAX_VOLUMES {
            0
        } else {
            volumes.len()
        };
        self.volume_count = count as u32;
        for (place, volume) in self.volumes.iter_mut().zip(&volumes[..count]) {
            *place = volume.planes().map(|plane| plane.to_array());
        }
    }

    /// The view of `lod`, with everything that the terrain's buffers decide left at zero.
    #[must_use]
    pub fn new(
        lattice: &Lattice,
        lod: &ViewLod,
        factors: &FactorView,
        partitioning: Partitioning,
    ) -> Self {
        let mut view = Self {
            eye: lod.eye.to_array(),
            extent: lattice.extent.to_array(),
            eye_fraction: factors.eye_fraction.to_array(),
            eye_height_m: factors.eye_height_m,
            unit_m: factors.unit_m,
            distance_floor: lod.floor,
            planar: u32::from(lod.planar),
            unit_shift: lattice.unit_log2,
            faces_shift: lattice.faces_log2,
            leaf_level: lattice.leaf_level,
            root_level: lattice.root_level,
            partitioning: partitioning as u32,
            segments_per_radian: factors.segments_per_radian,
            segments_per_m: factors.segments_per_m,
            min_triangle_m: factors.min_triangle_m,
            max_factor: factors.max_factor,
            density_strength: factors.density_strength,
            focal_px: factors.focal_px,
            px_per_m: factors.px_per_m,
            max_error_px: factors.max_error_px,
            error_units_per_m: factors.error_units_per_m,
            ..Self::zeroed()
        };
        for (level, entry) in view.geometry.iter_mut().enumerate() {
            *entry = [
                lod.morph_start[level],
                lod.zone_log2[level].cast_signed(),
                0,
                0,
            ];
        }
        view
    }
}

/// How a view's mesh comes to stand in the world; WGSL `TerrainDraw`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuTerrainDraw {
    /// From metres relative to the eye.
    pub world_from_eye: [[f32; 4]; 4],
    /// The same with the terrain's transform of the frame before.
    pub previous_world_from_eye: [[f32; 4]; 4],
    /// The eye's lattice point.
    pub eye_point: [i32; 2],
    /// The eye's fraction of a lattice unit.
    pub eye_fraction: [f32; 2],
    /// The eye's sample at level 0.
    pub eye_sample: [i32; 2],
    /// The eye's fraction of a sample.
    pub eye_sample_fraction: [f32; 2],
    /// Metres from the terrain's corner to the eye.
    pub eye_local_m: [f32; 2],
    /// The eye's height above the terrain's origin, metres.
    pub eye_height_m: f32,
    /// Metres per lattice unit.
    pub unit_m: f32,
    /// Metres per sample of level 0.
    pub spacing_m: f32,
    /// Coarsest level, that of the root tile.
    pub root_level: i32,
    /// How much of the ground's colour the preview of densities takes.
    pub density_opacity: f32,
    /// Where the destruction mask begins in the terrain's tables, words; 0 while there is none.
    pub mask_first: u32,
    /// Per tile level: first entry in the page table, tiles in x and z.
    pub tiles: [[u32; 4]; MAX_LEVELS],
}

/// A node; WGSL `TerrainNode`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuTerrainNode {
    /// First lattice point.
    pub origin: [i32; 2],
    /// Its level; below 0, finer than the finest tiles.
    pub level: i32,
    /// The lowest height that it may be drawn with, metres.
    pub lowest_m: f32,
    /// The highest.
    pub highest_m: f32,
    /// Padding.
    pub unused: u32,
}

impl GpuTerrainNode {
    /// A node that is drawn with heights between the two.
    #[must_use]
    pub fn new(node: Node, [lowest_m, highest_m]: [f32; 2]) -> Self {
        Self {
            origin: node.origin.to_array(),
            level: node.level,
            lowest_m,
            highest_m,
            unused: 0,
        }
    }
}

/// A vertex as the passes write and the draws read it; WGSL `TerrainVertex`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuTerrainVertex {
    /// Lattice point.
    pub point: [i32; 2],
    /// Height above the terrain's origin, metres.
    pub height_m: f32,
    /// Level of detail that the height was read at, 16.16.
    pub lambda: i32,
}

/// Arguments of the indirect draw, then what became of the view; WGSL `TerrainDrawArgs`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuTerrainDrawArgs {
    /// Indices to draw.
    pub index_count: u32,
    /// Always 1.
    pub instance_count: u32,
    /// Always 0.
    pub first_index: u32,
    /// Always 0.
    pub base_vertex: i32,
    /// Always 0: `INDIRECT_FIRST_INSTANCE` isn't asked for.
    pub first_instance: u32,
    /// Power of two by which all factors were brought down to fit the buffers.
    pub scale: u32,
    /// Vertices written.
    pub vertices: u32,
    /// Triangles written.
    pub triangles: u32,
    /// Vertices that would have been written with room enough.
    pub wanted_vertices: u32,
    /// Triangles that would have been written with room enough.
    pub wanted_triangles: u32,
    /// Padding.
    pub unused: [u32; 2],
}

/// What the passes count beside the draw's arguments; WGSL `counters`, by its `COUNTER_` constants.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuTerrainCounters {
    /// Faces that are drawn.
    pub faces: u32,
    /// Faces that no view sees.
    pub culled_faces: u32,
    /// Edges of the drawn faces, those inside counted from both sides.
    pub edges: u32,
    /// Edges that would be cut more finely but for the view's largest factor.
    pub clamped_edges: u32,
    /// Factors of those edges, four bins an octave from 1.
    pub factors: [u32; 28],
    /// Longest edges of the triangles on the screen, four bins an octave; the first holds all up to a
    /// quarter of a pixel.
    pub triangle_sizes: [u32; 32],
    /// Vertices that the view would have at a density strength of 0, room aside; where it was asked
    /// for.
    pub plain_vertices: u32,
    /// Triangles that it would have then.
    pub plain_triangles: u32,
}

/// Factors of a face, less one unit each so that they fit 16 bits: the edges', then what the inside
/// asks for itself. WGSL `pack_factors`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuFaceFactors {
    /// Of the edges.
    pub edges: [u16; 4],
    /// Of the inside, across and down.
    pub inside: [u16; 2],
    /// Whether no view sees the face, in the last bit.
    pub culled: u16,
    /// Padding.
    pub unused: u16,
}

impl From<GpuFaceFactors> for FaceFactors {
    fn from(factors: GpuFaceFactors) -> Self {
        Self {
            edges: factors.edges.map(|factor| u32::from(factor) + 1),
            inside: factors.inside.map(|factor| u32::from(factor) + 1),
            culled: factors.culled != 0,
        }
    }
}

/// What turns heights into densities, for a preview; WGSL `DensityKernel`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuDensityKernel {
    /// [`DensityFilter`] as a number.
    pub density_filter: u32,
    /// See [`DensityKernel::factor`].
    pub factor: f32,
    /// See [`DensitySettings::exponent`].
    pub exponent: f32,
    /// Padding.
    pub unused: u32,
    /// Per tile level.
    pub levels: [GpuDensityLevel; MAX_LEVELS],
}

/// What densities of a level follow from; WGSL `DensityLevel`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuDensityLevel {
    /// See [`DensityKernel::step`].
    pub step: f32,
    /// See [`DensityKernel::noise`].
    pub noise: f32,
    /// The level's samples in x and z that lie on the terrain.
    pub samples: [u32; 2],
    /// The level's texels in x and z.
    pub texels: [u32; 2],
    /// Padding.
    pub unused: [u32; 2],
}

impl GpuDensityKernel {
    /// Bytes that a page's densities take.
    pub const PAGE_BYTES: u64 = (DENSITY_TEXELS * DENSITY_TEXELS) as u64;

    /// The kernel for the terrain that `file` describes. The numbers are the CPU's.
    #[must_use]
    pub fn new(file: &ManifestFile, settings: &DensitySettings) -> Self {
        let mut kernel = Self {
            density_filter: match settings.filter {
                DensityFilter::SecondOrder => 0,
                DensityFilter::Gaussian => 1,
                DensityFilter::Mean => 2,
                DensityFilter::LaplaceBeltrami => 3,
                DensityFilter::LaplaceBeltramiVoronoi => 4,
                DensityFilter::Principal => 5,
            },
            exponent: settings.exponent,
            ..Self::zeroed()
        };
        for (level, entry) in (0..file.levels).zip(&mut kernel.levels) {
            let cpu = DensityKernel::new(settings, file.height_step_m, file.spacing_m, level);
            let extent = DensityExtent::new(file.size, level);
            kernel.factor = cpu.factor();
            *entry = GpuDensityLevel {
                step: cpu.step(),
                noise: cpu.noise(),
                samples: extent.samples,
                texels: extent.texels,
                unused: [0; 2],
            };
        }
        kernel
    }
}

/// A page whose densities are to be made; WGSL `DensityJob`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuDensityJob {
    /// The page.
    pub page: u32,
    /// Level of the tile that it holds.
    pub level: u32,
    /// Column and row of that tile.
    pub tile: [u32; 2],
}

impl GpuDensityJob {
    /// The job for `page`, which holds the tile at `address`.
    #[must_use]
    pub const fn new(page: u32, address: TileAddress) -> Self {
        Self {
            page,
            level: address.level as u32,
            tile: [address.x, address.z],
        }
    }
}
