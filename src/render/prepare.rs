//! Buffers, textures and bind groups: made when they are missing or too small, never for nothing.

use super::counters::Counters;
use super::density::{DensityBuffers, GpuDensityPreviews};
use super::extract::{ExtractedTerrain, ExtractedTerrains, ExtractedView, TableChange};
use super::gpu_types::{
    GpuFaceFactors, GpuTerrainCounters, GpuTerrainDraw, GpuTerrainDrawArgs, GpuTerrainNode,
    GpuTerrainVertex, GpuTerrainView,
};
use super::mask::GpuTables;
use super::overlay::{OverlayBuffers, OverlayGroups, OverlayPipelines, StoredDensities};
use super::pages::GpuTerrainPages;
use super::pipelines::{DrawExtras, TerrainPipelines};
use super::statistics::{Measured, TerrainViewStatistics};
use crate::detail::DetailKernel;
use crate::tessellate::FACTOR_SCALES;
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::render_resource::{
    BindGroup, BindGroupEntries, BindGroupEntry, Buffer, BufferDescriptor, BufferUsages,
    CommandEncoder, PipelineCache,
};
use bevy::render::renderer::{RenderDevice, RenderQueue};
use bevy::render::sync_world::MainEntity;
use bytemuck::Zeroable;
use half::f16;

/// Bytes a vertex and its six indices take at most; see [`largest_room`].
const INDICES_A_VERTEX: u64 = 6;

/// Vertices that a view has room for before anything was counted.
const FIRST_ROOM: u32 = 1 << 18;
/// Vertices by which that room grows.
const ROOM_STEP: u32 = 1 << 16;
/// How much of its budget a view that would want more is allowed to fill.
const FULLEST: f32 = 0.9;
/// The most that a budget widens triangles; nothing is left to be won there.
const WIDEST: f32 = 256.0;

/// A terrain's tables on the GPU.
pub(super) struct GpuTerrain {
    detail: Buffer,
    written_detail: Option<DetailKernel>,
    tables: GpuTables,
    field: Buffer,
    parameters: Buffer,
    written_parameters: Option<[Vec4; 8]>,
    pub(super) material: BindGroup,
    /// Rises when a buffer is replaced, so that views rebuild their bind groups.
    pub(super) generation: u64,
}

/// All terrains on the GPU, by their entity in the main world.
#[derive(Resource, Default)]
pub(super) struct GpuTerrains {
    pub(super) terrains: HashMap<MainEntity, GpuTerrain>,
}

/// A camera's mesh of a terrain on the GPU.
pub struct GpuTerrainMesh {
    view: Buffer,
    draw: Buffer,
    nodes: Buffer,
    factors: Buffer,
    totals: Buffer,
    offsets: Buffer,
    args: Buffer,
    vertices: Buffer,
    indices: Buffer,
    node_room: u32,
    face_room: u64,
    vertex_room: u32,
    node_count: u32,
    pub(super) counters: Counters,
    /// Whether triangle sizes are measured in this frame.
    measured: bool,
    /// Vertices that the view wanted when last counted, with its triangles' if those need more room.
    wanted_vertices: u32,
    /// What widths are multiplied by so that the view keeps within its budget.
    width_scale: f32,
    /// The budget, vertices.
    max_vertices: u32,
    /// Vertices that a face has at the least.
    least_a_face: u32,
    /// What this frame's view was, as the passes see it.
    uniform: GpuTerrainView,
    /// Rises when a buffer is replaced.
    generation: u64,
    seen: bool,
    /// Whether it is that of the second camera of a comparison.
    pub(super) compares: bool,
    /// What overlays need, while any is on.
    overlays: Option<OverlayBuffers>,
    pub(super) groups: Option<MeshBindGroups>,
}

/// The bind groups of a mesh's passes and draws.
pub(super) struct MeshBindGroups {
    pub(super) inputs: BindGroup,
    pub(super) classify: BindGroup,
    pub(super) setup: BindGroup,
    pub(super) vertices: BindGroup,
    pub(super) indices: BindGroup,
    pub(super) measure: BindGroup,
    pub(super) draw: BindGroup,
    /// The same with the preview of densities, while there is one.
    pub(super) preview_draw: Option<BindGroup>,
    /// Those of overlays, while any is on and can be shown.
    pub(super) overlays: Option<OverlayGroups>,
    /// Generations of the mesh, the pages, the terrain, its tables, the preview, the overlays and the
    /// densities that those show.
    built_for: [u64; 7],
}

impl MeshBindGroups {
    /// The bind group of a draw that shows `extras`.
    pub(super) const fn of_draw(&self, extras: DrawExtras) -> Option<&BindGroup> {
        match (extras, &self.overlays) {
            (
                DrawExtras {
                    overlays: false,
                    preview: false,
                },
                _,
            ) => Some(&self.draw),
            (
                DrawExtras {
                    overlays: false,
                    preview: true,
                },
                _,
            ) => self.preview_draw.as_ref(),
            (DrawExtras { preview: false, .. }, Some(overlays)) => Some(&overlays.draw),
            (DrawExtras { preview: true, .. }, Some(overlays)) => overlays.preview_draw.as_ref(),
            (_, None) => None,
        }
    }
}

/// The meshes of all cameras and terrains, by (camera, terrain).
#[derive(Resource, Default)]
pub struct GpuTerrainMeshes {
    pub(super) meshes: HashMap<(MainEntity, MainEntity), GpuTerrainMesh>,
}

impl GpuTerrainMeshes {
    /// The mesh of `terrain` that `camera` sees, both as entities of the main world.
    #[must_use]
    pub fn get(&self, camera: Entity, terrain: Entity) -> Option<&GpuTerrainMesh> {
        self.meshes.get(&(camera.into(), terrain.into()))
    }
}

impl GpuTerrainMesh {
    /// [`GpuTerrainVertex`] by [`GpuTerrainVertex`], as many as [`args`](Self::args) say.
    #[must_use]
    pub const fn vertices(&self) -> &Buffer {
        &self.vertices
    }

    /// Three `u32` a triangle.
    #[must_use]
    pub const fn indices(&self) -> &Buffer {
        &self.indices
    }

    /// One [`GpuTerrainDrawArgs`], which the draws are made from.
    #[must_use]
    pub const fn args(&self) -> &Buffer {
        &self.args
    }

    /// [`GpuFaceFactors`] a face, as many faces as nodes times faces a node.
    #[must_use]
    pub const fn factors(&self) -> &Buffer {
        &self.factors
    }

    /// While the camera has overlays on: what each triangle belongs to, a
    /// [`GpuTriangleFace`](super::GpuTriangleFace) each.
    #[must_use]
    pub fn triangle_faces(&self) -> Option<&Buffer> {
        self.overlays.as_ref().map(|overlays| &overlays.faces)
    }

    /// While the camera has overlays on: the error bounds of every face's five parts, pixels as `f32`.
    /// Not kept up while [`ErrorBound`](super::TerrainOverlay::ErrorBound) is off.
    #[must_use]
    pub fn part_errors(&self) -> Option<&Buffer> {
        self.overlays.as_ref().map(|overlays| &overlays.errors)
    }

    /// Whether the mesh is to be drawn with overlays.
    pub(super) fn has_overlays(&self) -> bool {
        let groups = self.groups.as_ref();
        groups.is_some_and(|groups| groups.overlays.is_some())
    }

    /// Nodes in this frame's view.
    #[must_use]
    pub const fn node_count(&self) -> u32 {
        self.node_count
    }

    /// What the passes were told of this frame's view.
    #[must_use]
    pub const fn uniform(&self) -> &GpuTerrainView {
        &self.uniform
    }
}

pub(super) fn buffer(
    device: &RenderDevice,
    label: &'static str,
    size: u64,
    usage: BufferUsages,
) -> Buffer {
    device.create_buffer(&BufferDescriptor {
        label: Some(label),
        size: size.max(16).next_multiple_of(16),
        usage: usage | BufferUsages::COPY_DST,
        mapped_at_creation: false,
    })
}

/// The most vertices whose indices still fit one binding: three indices a triangle, fewer than two
/// triangles a vertex.
fn largest_room(device: &RenderDevice) -> u32 {
    let limits = device.limits();
    let bytes = limits
        .max_storage_buffer_binding_size
        .min(limits.max_buffer_size);
    u32::try_from(bytes / (INDICES_A_VERTEX * 4)).unwrap_or(u32::MAX)
}

impl GpuTerrain {
    /// Bytes of GPU memory that its tables take: page table, destruction mask and residency field.
    pub(super) fn bytes(&self) -> u64 {
        self.tables.buffer.size() + self.field.size()
    }

    fn new(device: &RenderDevice, cache: &PipelineCache, pipelines: &TerrainPipelines) -> Self {
        let detail = buffer(
            device,
            "terrain_detail",
            size_of::<DetailKernel>() as u64,
            BufferUsages::UNIFORM,
        );
        let parameters = buffer(
            device,
            "terrain_material_parameters",
            8 * 16,
            BufferUsages::UNIFORM,
        );
        let material = device.create_bind_group(
            "terrain_material_bind_group",
            &cache.get_bind_group_layout(&pipelines.material_layout),
            &BindGroupEntries::single(parameters.as_entire_binding()),
        );
        let empty = |label| buffer(device, label, 16, BufferUsages::STORAGE);
        Self {
            detail,
            written_detail: None,
            tables: GpuTables::new(device),
            field: empty("terrain_residency_field"),
            parameters,
            written_parameters: None,
            material,
            generation: 0,
        }
    }
}

fn write_field(
    field: &mut Buffer,
    generation: &mut u64,
    change: &TableChange,
    device: &RenderDevice,
    queue: &RenderQueue,
) {
    let TableChange { first, words } = change;
    let first = u64::from(*first) * 4;
    let bytes: &[u8] = bytemuck::cast_slice(words);
    let end = first + bytes.len() as u64;
    // The first change is the whole field, and a field keeps its length.
    if field.size() < end {
        *field = buffer(
            device,
            "terrain_residency_field",
            end,
            BufferUsages::STORAGE,
        );
        *generation += 1;
    }
    queue.write_buffer(field, first, bytes);
}

impl GpuTerrainMesh {
    fn new(device: &RenderDevice) -> Self {
        let storage = |label| buffer(device, label, 16, BufferUsages::STORAGE);
        Self {
            view: buffer(
                device,
                "terrain_view",
                size_of::<GpuTerrainView>() as u64,
                BufferUsages::UNIFORM,
            ),
            draw: buffer(
                device,
                "terrain_draw",
                size_of::<GpuTerrainDraw>() as u64,
                BufferUsages::UNIFORM,
            ),
            args: buffer(
                device,
                "terrain_draw_args",
                size_of::<GpuTerrainDrawArgs>() as u64,
                BufferUsages::STORAGE | BufferUsages::INDIRECT | BufferUsages::COPY_SRC,
            ),
            nodes: storage("terrain_nodes"),
            factors: storage("terrain_face_factors"),
            totals: storage("terrain_node_totals"),
            offsets: storage("terrain_node_offsets"),
            vertices: storage("terrain_vertices"),
            indices: storage("terrain_indices"),
            node_room: 0,
            face_room: 0,
            vertex_room: 0,
            node_count: 0,
            counters: Counters::new(device),
            measured: false,
            wanted_vertices: 0,
            width_scale: 1.0,
            max_vertices: 0,
            least_a_face: 4,
            uniform: GpuTerrainView::zeroed(),
            generation: 0,
            seen: false,
            compares: false,
            overlays: None,
            groups: None,
        }
    }

    /// Makes room for the view's nodes and for at least the coarsest mesh of them.
    fn make_room(&mut self, device: &RenderDevice, extracted: &ExtractedView) {
        let nodes = extracted.nodes.len() as u32;
        let faces_a_node = 1_u64 << (2 * extracted.view.faces_shift);
        let faces = u64::from(nodes) * faces_a_node;
        let mut replaced = false;
        if self.node_room < nodes {
            self.node_room = nodes.next_power_of_two().max(64);
            let room = u64::from(self.node_room);
            let storage =
                |label, bytes: u64| buffer(device, label, room * bytes, BufferUsages::STORAGE);
            self.nodes = storage("terrain_nodes", size_of::<GpuTerrainNode>() as u64);
            self.totals = storage("terrain_node_totals", 8 * FACTOR_SCALES as u64);
            self.offsets = storage("terrain_node_offsets", 8);
            replaced = true;
        }
        if self.face_room < faces {
            self.face_room = u64::from(self.node_room) * faces_a_node;
            self.factors = buffer(
                device,
                "terrain_face_factors",
                self.face_room * size_of::<GpuFaceFactors>() as u64,
                BufferUsages::STORAGE | BufferUsages::COPY_SRC,
            );
            replaced = true;
        }
        // The least factor everywhere always fits.
        self.least_a_face = extracted.partitioning.least_vertices();
        let least = u32::try_from(u64::from(self.least_a_face) * faces)
            .unwrap_or(u32::MAX)
            .next_power_of_two();
        self.max_vertices = extracted.max_vertices;
        let most = extracted.max_vertices.max(least).min(largest_room(device));
        // A quarter more than wanted, so that few frames find too little.
        let wanted = self
            .wanted_vertices
            .saturating_add(self.wanted_vertices / 4);
        let wanted = wanted
            .checked_next_multiple_of(ROOM_STEP)
            .unwrap_or(u32::MAX);
        let room = wanted
            .max(FIRST_ROOM)
            .max(least)
            .max(self.vertex_room)
            .min(most);
        if self.vertex_room != room {
            self.vertex_room = room;
            let bytes = u64::from(room) * size_of::<GpuTerrainVertex>() as u64;
            self.vertices = buffer(
                device,
                "terrain_vertices",
                bytes,
                BufferUsages::STORAGE | BufferUsages::VERTEX | BufferUsages::COPY_SRC,
            );
            self.indices = buffer(
                device,
                "terrain_indices",
                u64::from(room) * INDICES_A_VERTEX * 4,
                BufferUsages::STORAGE | BufferUsages::INDEX | BufferUsages::COPY_SRC,
            );
            replaced = true;
        }
        if replaced {
            self.generation += 1;
        }
    }

    /// Follows what was counted: buffers are to grow, and past the budget triangles.
    pub(super) fn follow(&mut self, counted: &TerrainViewStatistics) {
        let wanted = counted
            .wanted_vertices
            .max(counted.wanted_triangles.div_ceil(2));
        self.wanted_vertices = wanted;
        // What faces have at the least stays; the rest falls with the square of the width.
        let least = counted.counters.faces as f32 * self.least_a_face as f32;
        let movable = (wanted as f32 - least).max(1.0);
        let budget = (FULLEST * self.max_vertices as f32 - least).max(0.01 * movable);
        let needed = counted.width_scale * (movable / budget).sqrt();
        let relaxes = self.width_scale > 1.0 && needed < 0.97 * self.width_scale;
        if wanted > self.max_vertices || relaxes {
            self.width_scale = needed.clamp(1.0, WIDEST);
        }
    }

    /// Bytes of GPU memory that its buffers take, those of overlays included.
    pub(super) fn bytes(&self) -> u64 {
        let buffers = [
            &self.view,
            &self.draw,
            &self.nodes,
            &self.factors,
            &self.totals,
            &self.offsets,
            &self.args,
            &self.vertices,
            &self.indices,
        ];
        let own: u64 = buffers.into_iter().map(|buffer| buffer.size()).sum();
        own + self.overlays.as_ref().map_or(0, OverlayBuffers::bytes)
    }

    /// Whether triangle sizes are measured in this frame.
    pub(super) const fn is_measured(&self) -> bool {
        self.measured
    }

    /// Copies this frame's counters to where the CPU can read them.
    pub(super) fn copy_counters(&mut self, encoder: &mut CommandEncoder) {
        self.counters.copy(
            encoder,
            &self.args,
            self.vertex_room,
            self.width_scale,
            Measured {
                triangle_sizes: self.measured,
                savings: self.uniform.counts_plain > 0,
            },
        );
    }

    fn write(
        &mut self,
        queue: &RenderQueue,
        extracted: &ExtractedView,
        density_opacity: f32,
        mask_first: u32,
    ) {
        self.node_count = extracted.nodes.len() as u32;
        self.measured = extracted.measure_triangle_sizes;
        self.uniform = extracted.view;
        self.uniform.counts_plain = u32::from(extracted.measure_savings);
        self.uniform.segments_per_radian /= self.width_scale;
        self.uniform.segments_per_m /= self.width_scale;
        self.uniform.max_error_px *= self.width_scale;
        self.uniform.max_vertices = self.vertex_room;
        self.uniform.max_triangles = self.vertex_room.saturating_mul(2);
        queue.write_buffer(&self.view, 0, bytemuck::bytes_of(&self.uniform));
        let draw = GpuTerrainDraw {
            density_opacity,
            mask_first,
            ..extracted.draw
        };
        queue.write_buffer(&self.draw, 0, bytemuck::bytes_of(&draw));
        queue.write_buffer(&self.nodes, 0, bytemuck::cast_slice(&extracted.nodes));
        let nothing = GpuTerrainCounters::zeroed();
        queue.write_buffer(&self.counters.buffer, 0, bytemuck::bytes_of(&nothing));
    }

    /// Makes room for what overlays need, where any is on and can be shown.
    fn prepare_overlays(
        &mut self,
        device: &RenderDevice,
        queue: &RenderQueue,
        extracted: &ExtractedView,
        is_ready: bool,
        generation: &mut u64,
    ) {
        let Some(overlays) = extracted.overlays.as_ref().filter(|_| is_ready) else {
            self.overlays = None;
            return;
        };
        *generation += 1;
        let rooms = [2 * u64::from(self.vertex_room), self.face_room];
        self.overlays
            .get_or_insert_with(|| OverlayBuffers::new(device, *generation))
            .prepare(device, queue, overlays, rooms, *generation);
    }

    fn bind(
        &mut self,
        device: &RenderDevice,
        cache: &PipelineCache,
        pipelines: &TerrainPipelines,
        pages: &GpuTerrainPages,
        terrain: &GpuTerrain,
        (preview, stored): (Option<&DensityBuffers>, &StoredDensities),
    ) {
        let overlays = self.overlays.as_ref();
        let overlays = overlays.and_then(|overlays| Some((overlays, stored.buffer()?)));
        let built_for = [
            self.generation,
            pages.generation,
            terrain.generation,
            terrain.tables.generation,
            preview.map_or(0, |preview| preview.generation),
            overlays.map_or(0, |(overlays, _)| overlays.generation),
            overlays.map_or(0, |_| stored.generation),
        ];
        if self
            .groups
            .as_ref()
            .is_some_and(|groups| groups.built_for == built_for)
        {
            return;
        }
        let layout = |descriptor| cache.get_bind_group_layout(descriptor);
        let group = |label, descriptor, entries: &[_]| {
            device.create_bind_group(label, &layout(descriptor), entries)
        };
        self.groups = Some(MeshBindGroups {
            inputs: group(
                "terrain_inputs_bind_group",
                &pipelines.inputs_layout,
                &BindGroupEntries::sequential((
                    self.view.as_entire_binding(),
                    self.nodes.as_entire_binding(),
                    terrain.tables.buffer.as_entire_binding(),
                    terrain.field.as_entire_binding(),
                    &pages.heights.view,
                    &pages.densities.view,
                    &pages.errors.view,
                    terrain.detail.as_entire_binding(),
                )),
            ),
            classify: group(
                "terrain_classify_bind_group",
                &pipelines.classify_layout,
                &BindGroupEntries::with_indices((
                    (0, self.factors.as_entire_binding()),
                    (1, self.totals.as_entire_binding()),
                    (6, self.counters.buffer.as_entire_binding()),
                )),
            ),
            setup: group(
                "terrain_setup_bind_group",
                &pipelines.setup_layout,
                &BindGroupEntries::with_indices((
                    (1, self.totals.as_entire_binding()),
                    (2, self.offsets.as_entire_binding()),
                    (3, self.args.as_entire_binding()),
                )),
            ),
            vertices: group(
                "terrain_vertices_bind_group",
                &pipelines.vertices_layout,
                &BindGroupEntries::with_indices((
                    (0, self.factors.as_entire_binding()),
                    (2, self.offsets.as_entire_binding()),
                    (3, self.args.as_entire_binding()),
                    (4, self.vertices.as_entire_binding()),
                )),
            ),
            indices: group(
                "terrain_indices_bind_group",
                &pipelines.indices_layout,
                &BindGroupEntries::with_indices((
                    (0, self.factors.as_entire_binding()),
                    (2, self.offsets.as_entire_binding()),
                    (3, self.args.as_entire_binding()),
                    (5, self.indices.as_entire_binding()),
                )),
            ),
            measure: group(
                "terrain_measure_bind_group",
                &pipelines.measure_layout,
                &BindGroupEntries::with_indices((
                    (3, self.args.as_entire_binding()),
                    (4, self.vertices.as_entire_binding()),
                    (5, self.indices.as_entire_binding()),
                    (6, self.counters.buffer.as_entire_binding()),
                )),
            ),
            draw: group(
                "terrain_draw_bind_group",
                &pipelines.draw_layout,
                &BindGroupEntries::sequential((
                    self.draw.as_entire_binding(),
                    terrain.tables.buffer.as_entire_binding(),
                    &pages.gradients.view,
                    &pipelines.gradient_sampler,
                    terrain.detail.as_entire_binding(),
                )),
            ),
            preview_draw: preview.map(|preview| {
                group(
                    "terrain_preview_draw_bind_group",
                    &pipelines.preview_draw_layout,
                    &BindGroupEntries::sequential((
                        self.draw.as_entire_binding(),
                        terrain.tables.buffer.as_entire_binding(),
                        &pages.gradients.view,
                        &pipelines.gradient_sampler,
                        terrain.detail.as_entire_binding(),
                        preview.densities.as_entire_binding(),
                    )),
                )
            }),
            overlays: overlays.map(|(overlays, densities)| {
                let draw = |label, layout, preview: Option<&DensityBuffers>| {
                    let draw = BindGroupEntries::sequential((
                        self.draw.as_entire_binding(),
                        terrain.tables.buffer.as_entire_binding(),
                        &pages.gradients.view,
                        &pipelines.gradient_sampler,
                        terrain.detail.as_entire_binding(),
                    ));
                    let pulled = BindGroupEntries::with_indices((
                        (6, overlays.uniform().as_entire_binding()),
                        (7, densities.as_entire_binding()),
                        (8, self.view.as_entire_binding()),
                        (9, self.vertices.as_entire_binding()),
                        (10, self.indices.as_entire_binding()),
                        (11, overlays.faces.as_entire_binding()),
                        (12, overlays.errors.as_entire_binding()),
                    ));
                    let preview = preview.map(|preview| BindGroupEntry {
                        binding: 5,
                        resource: preview.densities.as_entire_binding(),
                    });
                    let entries: Vec<_> = draw
                        .iter()
                        .cloned()
                        .chain(preview)
                        .chain(pulled.iter().cloned())
                        .collect();
                    device.create_bind_group(label, &cache.get_bind_group_layout(layout), &entries)
                };
                OverlayGroups {
                    faces: group(
                        "terrain_faces_bind_group",
                        &pipelines.faces_layout,
                        &BindGroupEntries::with_indices((
                            (0, self.factors.as_entire_binding()),
                            (2, self.offsets.as_entire_binding()),
                            (3, self.args.as_entire_binding()),
                            (7, overlays.faces.as_entire_binding()),
                            (8, overlays.errors.as_entire_binding()),
                            (9, overlays.uniform().as_entire_binding()),
                        )),
                    ),
                    draw: draw(
                        "terrain_overlay_draw_bind_group",
                        &pipelines.overlay_draw_layout,
                        None,
                    ),
                    preview_draw: preview.map(|preview| {
                        draw(
                            "terrain_overlay_preview_draw_bind_group",
                            &pipelines.overlay_preview_draw_layout,
                            Some(preview),
                        )
                    }),
                }
            }),
            built_for,
        });
    }
}

#[expect(clippy::too_many_arguments, reason = "parameters of a Bevy system")]
pub(super) fn prepare_terrains(
    extracted: Res<ExtractedTerrains>,
    mut terrains: ResMut<GpuTerrains>,
    mut pages: ResMut<GpuTerrainPages>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    cache: Res<PipelineCache>,
    pipelines: Res<TerrainPipelines>,
    mut scratch: Local<Vec<[f16; 2]>>,
) {
    let _span = bevy::log::debug_span!("terrain_prepare_pages").entered();
    terrains
        .terrains
        .retain(|entity, _| extracted.terrains.contains_key(entity));
    pages.make_room(extracted.pages_in_use, &device, &queue);
    for (entity, extracted) in &extracted.terrains {
        let ExtractedTerrain {
            gradient_scale,
            uploads,
            page_table,
            field,
            mask,
            parameters,
            detail,
            ..
        } = extracted;
        let terrain = terrains
            .terrains
            .entry(*entity)
            .or_insert_with(|| GpuTerrain::new(&device, &cache, &pipelines));
        for upload in uploads {
            pages.write(&queue, upload, *gradient_scale, &mut scratch);
        }
        for change in page_table {
            terrain.tables.write_page_table(change, &device, &queue);
        }
        terrain.tables.write_mask(mask, &device, &queue);
        for change in field {
            let GpuTerrain {
                field, generation, ..
            } = terrain;
            write_field(field, generation, change, &device, &queue);
        }
        if terrain.written_detail != Some(*detail) {
            terrain.written_detail = Some(*detail);
            queue.write_buffer(&terrain.detail, 0, bytemuck::bytes_of(detail));
        }
        if terrain.written_parameters != Some(*parameters) {
            terrain.written_parameters = Some(*parameters);
            queue.write_buffer(&terrain.parameters, 0, bytemuck::cast_slice(parameters));
        }
    }
}

#[expect(clippy::too_many_arguments, reason = "parameters of a Bevy system")]
pub(super) fn prepare_meshes(
    extracted: Res<ExtractedTerrains>,
    terrains: Res<GpuTerrains>,
    pages: Res<GpuTerrainPages>,
    previews: Res<GpuDensityPreviews>,
    mut meshes: ResMut<GpuTerrainMeshes>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    cache: Res<PipelineCache>,
    pipelines: Res<TerrainPipelines>,
    (overlays, densities): (Res<OverlayPipelines>, Res<StoredDensities>),
    mut overlay_generation: Local<u64>,
) {
    let _span = bevy::log::debug_span!("terrain_prepare_meshes").entered();
    for mesh in meshes.meshes.values_mut() {
        mesh.seen = false;
    }
    for extracted in &extracted.views {
        let Some(terrain) = terrains.terrains.get(&extracted.terrain) else {
            continue;
        };
        let mesh = meshes
            .meshes
            .entry((extracted.camera, extracted.terrain))
            .or_insert_with(|| GpuTerrainMesh::new(&device));
        mesh.seen = true;
        mesh.compares = extracted.compares;
        mesh.make_room(&device, extracted);
        let preview = previews.previews.get(&extracted.terrain);
        let opacity = preview.map_or(0.0, |preview| preview.opacity);
        mesh.write(&queue, extracted, opacity, terrain.tables.mask_first());
        let preview = preview.and_then(|preview| preview.gpu.as_ref());
        let generation = &mut *overlay_generation;
        mesh.prepare_overlays(&device, &queue, extracted, overlays.is_ready, generation);
        mesh.bind(
            &device,
            &cache,
            &pipelines,
            &pages,
            terrain,
            (preview, &densities),
        );
    }
    meshes.meshes.retain(|_, mesh| mesh.seen);
}
