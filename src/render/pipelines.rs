//! Layouts and pipelines of the passes and the draws, made once a device.

use super::gpu_types::{
    GpuDensityJob, GpuDensityKernel, GpuFaceFactors, GpuTerrainCounters, GpuTerrainDraw,
    GpuTerrainDrawArgs, GpuTerrainNode, GpuTerrainVertex, GpuTerrainView,
};
use super::overlay::GpuTerrainOverlays;
use crate::detail::DetailKernel;
use bevy::asset::load_embedded_asset;
use bevy::core_pipeline::core_3d::CORE_3D_DEPTH_FORMAT;
use bevy::core_pipeline::prepass::prepass_target_descriptors;
use bevy::mesh::{MeshVertexBufferLayout, MeshVertexBufferLayoutRef, VertexBufferLayout};
use bevy::pbr::{MATERIAL_BIND_GROUP_INDEX, MeshPipeline, MeshPipelineKey, PrepassPipeline};
use bevy::prelude::*;
use bevy::render::render_resource::binding_types::{
    sampler, storage_buffer_read_only_sized, storage_buffer_sized, texture_2d_array,
    uniform_buffer_sized,
};
use bevy::render::render_resource::{
    BindGroupLayoutDescriptor, BindGroupLayoutEntries, BindGroupLayoutEntryBuilder,
    CachedComputePipelineId, CompareFunction, ComputePipelineDescriptor, DepthStencilState,
    DynamicBindGroupLayoutEntries, Face, FilterMode, FragmentState, MultisampleState,
    PipelineCache, PrimitiveState, RenderPipelineDescriptor, Sampler, SamplerBindingType,
    SamplerDescriptor, ShaderStages, SpecializedMeshPipeline, SpecializedRenderPipeline,
    TextureSampleType, VertexAttribute, VertexFormat, VertexState, VertexStepMode,
};
use bevy::render::renderer::RenderDevice;
use bevy::shader::{Shader, ShaderDefVal};
use std::num::NonZeroU64;
use std::sync::Arc;

/// Bind group of the terrain's own bindings in all draws.
pub(super) const TERRAIN_BIND_GROUP: usize = 2;

/// What makes a fragment shader show the preview of densities.
const DENSITY_PREVIEW_DEF: &str = "TERRAIN_DENSITY_PREVIEW";

/// What makes a draw show overlays.
const OVERLAY_DEF: &str = "TERRAIN_OVERLAY";

/// Layouts, samplers and compute pipelines.
#[derive(Resource)]
pub(super) struct TerrainPipelines {
    pub(super) inputs_layout: BindGroupLayoutDescriptor,
    pub(super) classify_layout: BindGroupLayoutDescriptor,
    pub(super) setup_layout: BindGroupLayoutDescriptor,
    pub(super) vertices_layout: BindGroupLayoutDescriptor,
    pub(super) indices_layout: BindGroupLayoutDescriptor,
    pub(super) measure_layout: BindGroupLayoutDescriptor,
    pub(super) density_layout: BindGroupLayoutDescriptor,
    pub(super) draw_layout: BindGroupLayoutDescriptor,
    /// The draws' layout while there is a preview of densities.
    pub(super) preview_draw_layout: BindGroupLayoutDescriptor,
    pub(super) faces_layout: BindGroupLayoutDescriptor,
    /// Of the pass of faces, whose pipeline is made when the first overlay is shown.
    pub(super) faces_shader: Handle<Shader>,
    /// The draws' layouts with overlays, and with both.
    pub(super) overlay_draw_layout: BindGroupLayoutDescriptor,
    pub(super) overlay_preview_draw_layout: BindGroupLayoutDescriptor,
    pub(super) material_layout: BindGroupLayoutDescriptor,
    pub(super) classify: CachedComputePipelineId,
    pub(super) setup: CachedComputePipelineId,
    pub(super) vertices: CachedComputePipelineId,
    pub(super) indices: CachedComputePipelineId,
    pub(super) measure: CachedComputePipelineId,
    pub(super) density: CachedComputePipelineId,
    pub(super) gradient_sampler: Sampler,
}

const fn size_of_pod<T>() -> Option<NonZeroU64> {
    NonZeroU64::new(size_of::<T>() as u64)
}

pub(super) fn init_terrain_pipelines(
    mut commands: Commands,
    device: Res<RenderDevice>,
    pipeline_cache: Res<PipelineCache>,
    assets: Res<AssetServer>,
    mesh_pipeline: Res<MeshPipeline>,
    prepass_pipeline: Res<PrepassPipeline>,
) {
    let view = uniform_buffer_sized(false, size_of_pod::<GpuTerrainView>());
    let read = |size| storage_buffer_read_only_sized(false, size);
    let write = |size| storage_buffer_sized(false, size);
    let word = NonZeroU64::new(4);
    let pair = NonZeroU64::new(8);
    let factors = size_of_pod::<GpuFaceFactors>();
    let args = size_of_pod::<GpuTerrainDrawArgs>();
    let counters = size_of_pod::<GpuTerrainCounters>();
    let compute = ShaderStages::COMPUTE;

    let inputs_layout = BindGroupLayoutDescriptor::new(
        "terrain_inputs_layout",
        &BindGroupLayoutEntries::sequential(
            compute,
            (
                view,
                read(size_of_pod::<GpuTerrainNode>()),
                read(word),
                read(word),
                texture_2d_array(TextureSampleType::Uint),
                texture_2d_array(TextureSampleType::Uint),
                texture_2d_array(TextureSampleType::Uint),
                uniform_buffer_sized(false, size_of_pod::<DetailKernel>()),
            ),
        ),
    );
    let classify_layout = BindGroupLayoutDescriptor::new(
        "terrain_classify_layout",
        &BindGroupLayoutEntries::with_indices(
            compute,
            ((0, write(factors)), (1, write(pair)), (6, write(counters))),
        ),
    );
    let setup_layout = BindGroupLayoutDescriptor::new(
        "terrain_setup_layout",
        &BindGroupLayoutEntries::with_indices(
            compute,
            ((1, read(pair)), (2, write(pair)), (3, write(args))),
        ),
    );
    let vertices_layout = BindGroupLayoutDescriptor::new(
        "terrain_vertices_layout",
        &BindGroupLayoutEntries::with_indices(
            compute,
            (
                (0, read(factors)),
                (2, read(pair)),
                (3, read(args)),
                (4, write(size_of_pod::<GpuTerrainVertex>())),
            ),
        ),
    );
    let indices_layout = BindGroupLayoutDescriptor::new(
        "terrain_indices_layout",
        &BindGroupLayoutEntries::with_indices(
            compute,
            (
                (0, read(factors)),
                (2, read(pair)),
                (3, read(args)),
                (5, write(word)),
            ),
        ),
    );
    let measure_layout = BindGroupLayoutDescriptor::new(
        "terrain_measure_layout",
        &BindGroupLayoutEntries::with_indices(
            compute,
            (
                (3, read(args)),
                (4, read(size_of_pod::<GpuTerrainVertex>())),
                (5, read(word)),
                (6, write(counters)),
            ),
        ),
    );
    let density_layout = BindGroupLayoutDescriptor::new(
        "terrain_density_layout",
        &BindGroupLayoutEntries::sequential(
            compute,
            (
                uniform_buffer_sized(false, size_of_pod::<GpuDensityKernel>()),
                read(size_of_pod::<GpuDensityJob>()),
                texture_2d_array(TextureSampleType::Uint),
                write(word),
            ),
        ),
    );
    let draw_entries = || {
        DynamicBindGroupLayoutEntries::sequential(
            ShaderStages::FRAGMENT,
            (
                uniform_buffer_sized(false, size_of_pod::<GpuTerrainDraw>())
                    .visibility(ShaderStages::VERTEX_FRAGMENT),
                read(word),
                texture_2d_array(TextureSampleType::Float { filterable: true }),
                sampler(SamplerBindingType::Filtering),
                uniform_buffer_sized(false, size_of_pod::<DetailKernel>()),
            ),
        )
    };
    let preview_entries = || draw_entries().extend_sequential((read(word),));
    let draw_layout = BindGroupLayoutDescriptor::new("terrain_draw_layout", &draw_entries());
    let preview_draw_layout =
        BindGroupLayoutDescriptor::new("terrain_preview_draw_layout", &preview_entries());
    let overlays = uniform_buffer_sized(false, size_of_pod::<GpuTerrainOverlays>());
    let faces_layout = BindGroupLayoutDescriptor::new(
        "terrain_faces_layout",
        &BindGroupLayoutEntries::with_indices(
            compute,
            (
                (0, read(factors)),
                (2, read(pair)),
                (3, read(args)),
                (7, write(pair)),
                (8, write(word)),
                (9, overlays),
            ),
        ),
    );
    // Vertices are pulled, so that each knows its triangle.
    let pulled = |entry: BindGroupLayoutEntryBuilder| entry.visibility(ShaderStages::VERTEX);
    let overlay_entries = (
        (6, overlays),
        (7, read(word)),
        (8, pulled(view)),
        (9, pulled(read(size_of_pod::<GpuTerrainVertex>()))),
        (10, pulled(read(word))),
        (11, pulled(read(pair))),
        (12, pulled(read(word))),
    );
    let overlay_draw_layout = BindGroupLayoutDescriptor::new(
        "terrain_overlay_draw_layout",
        &draw_entries().extend_with_indices(overlay_entries),
    );
    let overlay_preview_draw_layout = BindGroupLayoutDescriptor::new(
        "terrain_overlay_preview_draw_layout",
        &preview_entries().extend_with_indices(overlay_entries),
    );
    let material_layout = BindGroupLayoutDescriptor::new(
        "terrain_material_layout",
        &BindGroupLayoutEntries::single(
            ShaderStages::FRAGMENT,
            uniform_buffer_sized(false, NonZeroU64::new(8 * 16)),
        ),
    );

    let pass = |label: &'static str, shader, layout: &BindGroupLayoutDescriptor| {
        pipeline_cache.queue_compute_pipeline(ComputePipelineDescriptor {
            label: Some(format!("terrain_{label}_pipeline").into()),
            layout: vec![inputs_layout.clone(), layout.clone()],
            shader,
            entry_point: Some(label.into()),
            ..default()
        })
    };
    let assets = assets.as_ref();
    let classify = pass(
        "classify",
        load_embedded_asset!(assets, "shaders/classify.wgsl"),
        &classify_layout,
    );
    let setup = pass(
        "setup",
        load_embedded_asset!(assets, "shaders/setup.wgsl"),
        &setup_layout,
    );
    let vertices = pass(
        "vertices",
        load_embedded_asset!(assets, "shaders/vertices.wgsl"),
        &vertices_layout,
    );
    let indices = pass(
        "indices",
        load_embedded_asset!(assets, "shaders/indices.wgsl"),
        &indices_layout,
    );
    let measure = pass(
        "measure",
        load_embedded_asset!(assets, "shaders/measure.wgsl"),
        &measure_layout,
    );

    let density = pipeline_cache.queue_compute_pipeline(ComputePipelineDescriptor {
        label: Some("terrain_density_pipeline".into()),
        layout: vec![density_layout.clone()],
        shader: load_embedded_asset!(assets, "shaders/density.wgsl"),
        entry_point: Some("density".into()),
        ..default()
    });

    commands.insert_resource(TerrainDrawPipeline {
        mesh_pipeline: mesh_pipeline.clone(),
        prepass_pipeline: prepass_pipeline.clone(),
        vertex_shader: load_embedded_asset!(assets, "shaders/vertex.wgsl"),
        draw_layouts: [
            [draw_layout.clone(), preview_draw_layout.clone()],
            [
                overlay_draw_layout.clone(),
                overlay_preview_draw_layout.clone(),
            ],
        ],
        material_layout: material_layout.clone(),
    });
    commands.insert_resource(TerrainPipelines {
        classify,
        setup,
        vertices,
        indices,
        measure,
        density,
        inputs_layout,
        classify_layout,
        setup_layout,
        vertices_layout,
        indices_layout,
        measure_layout,
        density_layout,
        draw_layout,
        preview_draw_layout,
        faces_layout,
        faces_shader: load_embedded_asset!(assets, "shaders/faces.wgsl"),
        overlay_draw_layout,
        overlay_preview_draw_layout,
        material_layout,
        gradient_sampler: device.create_sampler(&SamplerDescriptor {
            label: Some("terrain_gradient_sampler"),
            mag_filter: FilterMode::Linear,
            min_filter: FilterMode::Linear,
            ..default()
        }),
    });
}

/// Which of Bevy's passes a pipeline draws in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum TerrainDrawKind {
    Main,
    Prepass,
    Deferred,
    Shadow,
}

/// What tells one draw pipeline from another.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) struct TerrainDrawKey {
    pub(super) kind: TerrainDrawKind,
    pub(super) mesh: MeshPipelineKey,
    /// The material's WGSL with the entry points appended.
    pub(super) shader: Handle<Shader>,
    /// What is laid over the material's colour.
    pub(super) extras: DrawExtras,
}

/// What a draw shows beside the ground itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct DrawExtras {
    /// The preview of densities.
    pub(super) preview: bool,
    pub(super) overlays: bool,
}

/// Makes draw pipelines out of Bevy's own mesh and prepass pipelines.
#[derive(Resource)]
pub(super) struct TerrainDrawPipeline {
    mesh_pipeline: MeshPipeline,
    prepass_pipeline: PrepassPipeline,
    vertex_shader: Handle<Shader>,
    /// Without overlays and with them; of either, without the preview of densities and with it.
    draw_layouts: [[BindGroupLayoutDescriptor; 2]; 2],
    material_layout: BindGroupLayoutDescriptor,
}

impl SpecializedRenderPipeline for TerrainDrawPipeline {
    type Key = TerrainDrawKey;

    fn specialize(&self, key: TerrainDrawKey) -> RenderPipelineDescriptor {
        match key.kind {
            TerrainDrawKind::Main => self.main(&key),
            _ => self.prepass(&key),
        }
    }
}

impl TerrainDrawPipeline {
    fn vertex_buffer() -> VertexBufferLayout {
        let attribute = |format, offset, shader_location| VertexAttribute {
            format,
            offset,
            shader_location,
        };
        VertexBufferLayout {
            array_stride: size_of::<GpuTerrainVertex>() as u64,
            step_mode: VertexStepMode::Vertex,
            attributes: vec![
                attribute(VertexFormat::Sint32x2, 0, 0),
                attribute(VertexFormat::Float32, 8, 1),
                attribute(VertexFormat::Sint32, 12, 2),
            ],
        }
    }

    /// Draws with overlays pull their vertices.
    fn vertex_buffers(extras: DrawExtras) -> Vec<VertexBufferLayout> {
        if extras.overlays {
            Vec::new()
        } else {
            vec![Self::vertex_buffer()]
        }
    }

    fn terrain_layouts(&self, key: &TerrainDrawKey) -> [BindGroupLayoutDescriptor; 2] {
        let DrawExtras { preview, overlays } = key.extras;
        let draw = &self.draw_layouts[usize::from(overlays)][usize::from(preview)];
        [draw.clone(), self.material_layout.clone()]
    }

    fn culled_face(key: MeshPipelineKey) -> Face {
        if key.contains(MeshPipelineKey::INVERT_CULLING) {
            Face::Front
        } else {
            Face::Back
        }
    }

    fn main(&self, key: &TerrainDrawKey) -> RenderPipelineDescriptor {
        let no_attributes = MeshVertexBufferLayoutRef(Arc::new(MeshVertexBufferLayout::new(
            Vec::new(),
            VertexBufferLayout {
                array_stride: 0,
                step_mode: VertexStepMode::Vertex,
                attributes: Vec::new(),
            },
        )));
        let mut descriptor = self
            .mesh_pipeline
            .specialize(key.mesh, &no_attributes)
            .expect("a layout that asks for no attribute lacks none");
        let material_group = ShaderDefVal::UInt(
            "MATERIAL_BIND_GROUP".into(),
            MATERIAL_BIND_GROUP_INDEX as u32,
        );
        descriptor.label = Some(if key.extras.overlays {
            "terrain_main_overlay_pipeline".into()
        } else {
            "terrain_main_pipeline".into()
        });
        descriptor.layout.truncate(TERRAIN_BIND_GROUP);
        descriptor.layout.extend(self.terrain_layouts(key));
        descriptor.vertex.shader = self.vertex_shader.clone();
        descriptor.vertex.entry_point = Some("vertex".into());
        descriptor.vertex.buffers = Self::vertex_buffers(key.extras);
        descriptor.vertex.shader_defs.push(material_group.clone());
        if key.extras.overlays {
            descriptor.vertex.shader_defs.push(OVERLAY_DEF.into());
        }
        // The main pass writes no motion vectors; the view's layout asks for the definition.
        if let Some(fragment) = &mut descriptor.fragment {
            fragment.shader = key.shader.clone();
            fragment.entry_point = Some("fragment".into());
            fragment.shader_defs.push(material_group);
            if key.extras.preview {
                fragment.shader_defs.push(DENSITY_PREVIEW_DEF.into());
            }
            if key.extras.overlays {
                fragment.shader_defs.push(OVERLAY_DEF.into());
            }
        }
        descriptor.primitive.cull_mode = Some(Self::culled_face(key.mesh));
        descriptor
    }

    /// Prepass, deferred and shadow pipelines; Bevy's own builder of these is private.
    fn prepass(&self, key: &TerrainDrawKey) -> RenderPipelineDescriptor {
        let mesh = key.mesh;
        let has = |bits| mesh.contains(bits);
        let shadow = key.kind == TerrainDrawKind::Shadow;
        let normal = has(MeshPipelineKey::NORMAL_PREPASS);
        let motion = has(MeshPipelineKey::MOTION_VECTOR_PREPASS);
        let deferred = key.kind == TerrainDrawKind::Deferred;
        let unclipped = has(MeshPipelineKey::UNCLIPPED_DEPTH_ORTHO);
        let can_unclip = self.prepass_pipeline.depth_clip_control_supported;
        let emulate_unclipped = unclipped && !can_unclip;

        let mut defs: Vec<ShaderDefVal> = vec![
            "PREPASS_PIPELINE".into(),
            ShaderDefVal::UInt(
                "MATERIAL_BIND_GROUP".into(),
                MATERIAL_BIND_GROUP_INDEX as u32,
            ),
        ];
        let mut define = |condition: bool, name: &'static str| {
            if condition {
                defs.push(name.into());
            }
        };
        define(shadow, "TERRAIN_SHADOW");
        define(has(MeshPipelineKey::DEPTH_PREPASS), "DEPTH_PREPASS");
        define(normal, "NORMAL_PREPASS");
        define(normal || deferred, "NORMAL_PREPASS_OR_DEFERRED_PREPASS");
        define(motion, "MOTION_VECTOR_PREPASS");
        define(
            motion || deferred,
            "MOTION_VECTOR_PREPASS_OR_DEFERRED_PREPASS",
        );
        define(deferred, "DEFERRED_PREPASS");
        define(normal || deferred, "TERRAIN_READS_MATERIAL");
        define(key.extras.preview, DENSITY_PREVIEW_DEF);
        define(key.extras.overlays, OVERLAY_DEF);
        define(emulate_unclipped, "UNCLIPPED_DEPTH_ORTHO_EMULATION");
        let needs_fragment = normal || motion || deferred || emulate_unclipped;
        define(needs_fragment, "PREPASS_FRAGMENT");
        let projection = mesh.intersection(MeshPipelineKey::VIEW_PROJECTION_RESERVED_BITS);
        define(
            projection == MeshPipelineKey::VIEW_PROJECTION_PERSPECTIVE,
            "VIEW_PROJECTION_PERSPECTIVE",
        );
        define(
            projection == MeshPipelineKey::VIEW_PROJECTION_ORTHOGRAPHIC,
            "VIEW_PROJECTION_ORTHOGRAPHIC",
        );

        let mut targets = prepass_target_descriptors(normal, motion, deferred);
        if targets.iter().all(Option::is_none) {
            targets.clear();
        }
        let [draw_layout, material_layout] = self.terrain_layouts(key);
        RenderPipelineDescriptor {
            label: Some(
                match key.kind {
                    TerrainDrawKind::Shadow => "terrain_shadow_pipeline",
                    TerrainDrawKind::Deferred if key.extras.overlays => {
                        "terrain_deferred_overlay_pipeline"
                    }
                    TerrainDrawKind::Deferred => "terrain_deferred_pipeline",
                    _ => "terrain_prepass_pipeline",
                }
                .into(),
            ),
            layout: vec![
                if motion {
                    self.prepass_pipeline.view_layout_motion_vectors.clone()
                } else {
                    self.prepass_pipeline.view_layout_no_motion_vectors.clone()
                },
                self.prepass_pipeline.empty_layout.clone(),
                draw_layout,
                material_layout,
            ],
            vertex: VertexState {
                shader: self.vertex_shader.clone(),
                shader_defs: defs.clone(),
                entry_point: Some("vertex".into()),
                buffers: Self::vertex_buffers(key.extras),
            },
            fragment: needs_fragment.then(|| FragmentState {
                shader: key.shader.clone(),
                shader_defs: defs,
                entry_point: Some("fragment".into()),
                targets,
            }),
            primitive: PrimitiveState {
                // Both sides cast shadows: the rim of a terrain has no far side.
                cull_mode: (!shadow).then(|| Self::culled_face(mesh)),
                unclipped_depth: unclipped && can_unclip,
                ..default()
            },
            depth_stencil: Some(DepthStencilState {
                format: CORE_3D_DEPTH_FORMAT,
                depth_write_enabled: Some(true),
                depth_compare: Some(CompareFunction::GreaterEqual),
                stencil: default(),
                bias: default(),
            }),
            multisample: MultisampleState {
                count: mesh.msaa_samples(),
                ..default()
            },
            ..default()
        }
    }
}
