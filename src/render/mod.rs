//! Drawing: nodes are selected and culled on the CPU, compute passes write their vertices and
//! triangles, and one indirect draw a pass puts them into Bevy's own phases.
//!
//! What it costs: a page takes 113 KiB of GPU memory, a vertex with its triangles at most
//! 40 bytes of room ([`TerrainCamera::max_vertices`](crate::terrain::TerrainCamera::max_vertices)
//! of them per camera), a draw call per terrain, view and pass. It asks for no feature beyond
//! WebGPU's defaults.
//!
//! What it doesn't do: shadows of point and spot lights are drawn from the mesh of one camera,
//! and transparent terrains don't exist.

mod comparison;
mod counters;
mod cull;
mod density;
mod draw;
mod extract;
mod gpu_types;
mod mask;
mod material;
mod overlay;
mod page_part;
mod pages;
mod passes;
mod pipelines;
mod prepare;
mod statistics;

pub use comparison::{
    ComparedComponents, ComparisonCamera, ComparisonView, GpuComparison, TerrainComparison,
};
pub(crate) use cull::{LightVolume, LightVolumes};
pub use cull::{NodeBox, NodeCulling, TerrainNodes, TileHeightBounds, select_seen};
pub use density::{GpuDensityPreview, GpuDensityPreviews, TerrainDensityPreview};
pub use extract::factor_view;
pub use gpu_types::{
    GpuDensityJob, GpuDensityKernel, GpuDensityLevel, GpuFaceFactors, GpuTerrainCounters,
    GpuTerrainDraw, GpuTerrainDrawArgs, GpuTerrainNode, GpuTerrainVertex, GpuTerrainView,
    MAX_VOLUMES,
};
pub use mask::MASK_HEADER_WORDS;
pub use material::{DEFAULT_MATERIAL_WGSL, TerrainMaterial, compose_material};
pub use overlay::{
    GpuTerrainOverlays, GpuTriangleFace, TerrainLegendStop, TerrainOverlay, TerrainOverlays,
};
pub use pages::{GpuTerrainPages, tile_gradients};
pub use prepare::{GpuTerrainMesh, GpuTerrainMeshes};
pub use statistics::{
    SavedByDensity, TerrainDiagnostics, TerrainGpuMemory, TerrainStatistics, TerrainViewStatistics,
};

use crate::edit::mask::MaskSettings;
use crate::terrain::{TerrainCamera, TerrainSystems};
use bevy::asset::embedded_asset;
use bevy::camera::visibility::VisibilitySystems;
use bevy::core_pipeline::core_3d::Opaque3d;
use bevy::core_pipeline::deferred::AlphaMask3dDeferred;
use bevy::core_pipeline::prepass::Opaque3dPrepass;
use bevy::core_pipeline::schedule::camera_driver;
use bevy::light::SimulationLightSystems;
use bevy::pbr::{Shadow, init_prepass_pipeline};
use bevy::prelude::*;
use bevy::render::render_phase::AddRenderCommand;
use bevy::render::render_resource::SpecializedRenderPipelines;
use bevy::render::renderer::{RenderGraph, RenderGraphSystems};
use bevy::render::{
    ExtractSchedule, GpuResourceAppExt, Render, RenderApp, RenderStartup, RenderSystems,
};
use bevy::shader::load_shader_library;

/// What terrains do to be drawn, besides the passes ([`TerrainPass`]).
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TerrainRenderSystems {
    /// In `PostUpdate`: [`TerrainNodes`] of all cameras are selected and culled, after
    /// [`TerrainSystems::Stream`] and after cameras' and lights' frusta. Order after it whatever
    /// reads them.
    Cull,
    /// In the render world's `ExtractSchedule`: what changed is told to the render world.
    Extract,
    /// In its `Render` schedule: pages are uploaded, buffers grow, bind groups are made. Meshes of
    /// this frame are in [`GpuTerrainMeshes`] after it.
    Prepare,
    /// In its `Render` schedule: terrains are put into the phases of all views.
    Queue,
}

/// The compute passes, in order, each a system in Bevy's `RenderGraph` schedule before
/// `camera_driver`; [`Density`](Self::Density) in no order with the others. Order a game's own passes against these sets: after
/// [`Vertices`](Self::Vertices) to change what is drawn, after [`Indices`](Self::Indices) to read
/// it.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TerrainPass {
    /// Faces get their factors, nodes their counts.
    Classify,
    /// The view's scale, the nodes' places in the buffers, the indirect draw's arguments.
    Setup,
    /// For cameras with [`TerrainOverlays`] on: which part of which face each triangle belongs to. After
    /// [`Setup`](Self::Setup), in no order with those that follow it.
    Faces,
    /// Every vertex is evaluated once.
    Vertices,
    /// Triangles are listed.
    Indices,
    /// Triangles are measured, where [`TerrainStatistics::measure_triangle_sizes`] asks for it, and
    /// the counters are copied for the CPU to read.
    Measure,
    /// Densities of pages are made for a [`TerrainDensityPreview`]: of all where its settings
    /// changed, of those whose heights were uploaded otherwise. Runs in frames that have such
    /// pages only. Order after it to read [`GpuDensityPreview::densities`].
    Density,
}

impl TerrainPass {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Classify,
        Self::Setup,
        Self::Faces,
        Self::Vertices,
        Self::Indices,
        Self::Measure,
        Self::Density,
    ];

    /// The pass's label in captures, and its name in Bevy's render diagnostics.
    #[must_use]
    pub const fn label(self) -> &'static str {
        match self {
            Self::Classify => "terrain_classify",
            Self::Setup => "terrain_setup",
            Self::Faces => "terrain_faces",
            Self::Vertices => "terrain_vertices",
            Self::Indices => "terrain_indices",
            Self::Measure => "terrain_measure",
            Self::Density => "terrain_density",
        }
    }
}

/// Draws terrains for every [`TerrainCamera`]. Does nothing where there is no renderer.
#[derive(Clone, Copy, Debug, Default)]
pub struct TerrainRenderPlugin;

impl Plugin for TerrainRenderPlugin {
    fn build(&self, app: &mut App) {
        // Without a renderer there may be no shaders either.
        if app.get_sub_app(RenderApp).is_none() {
            return;
        }
        load_shader_library!(app, "shaders/types.wgsl");
        load_shader_library!(app, "shaders/detail.wgsl");
        load_shader_library!(app, "shaders/bindings.wgsl");
        load_shader_library!(app, "shaders/lattice.wgsl");
        load_shader_library!(app, "shaders/height.wgsl");
        load_shader_library!(app, "shaders/edge_density.wgsl");
        load_shader_library!(app, "shaders/edge_error.wgsl");
        load_shader_library!(app, "shaders/edge.wgsl");
        load_shader_library!(app, "shaders/screen.wgsl");
        load_shader_library!(app, "shaders/strip.wgsl");
        load_shader_library!(app, "shaders/face.wgsl");
        load_shader_library!(app, "shaders/scan.wgsl");
        load_shader_library!(app, "shaders/surface.wgsl");
        load_shader_library!(app, "shaders/destruction.wgsl");
        load_shader_library!(app, "shaders/vertex_io.wgsl");
        load_shader_library!(app, "shaders/curvature.wgsl");
        load_shader_library!(app, "shaders/density_texel.wgsl");
        load_shader_library!(app, "shaders/density_preview.wgsl");
        load_shader_library!(app, "shaders/overlay.wgsl");
        load_shader_library!(app, "shaders/overlay_vertex.wgsl");
        embedded_asset!(app, "shaders/faces.wgsl");
        embedded_asset!(app, "shaders/density.wgsl");
        embedded_asset!(app, "shaders/classify.wgsl");
        embedded_asset!(app, "shaders/setup.wgsl");
        embedded_asset!(app, "shaders/vertices.wgsl");
        embedded_asset!(app, "shaders/indices.wgsl");
        embedded_asset!(app, "shaders/measure.wgsl");
        embedded_asset!(app, "shaders/vertex.wgsl");
        material::add_default_material(app.world_mut());

        app.register_type::<TerrainMaterial>()
            .register_required_components::<TerrainCamera, TerrainNodes>()
            .add_systems(Last, material::compose_materials)
            .configure_sets(
                PostUpdate,
                TerrainRenderSystems::Cull
                    .after(TerrainSystems::Stream)
                    .after(VisibilitySystems::UpdateFrusta)
                    .after(VisibilitySystems::VisibilityPropagate)
                    .after(SimulationLightSystems::UpdateLightFrusta),
            )
            .register_type::<MaskSettings>()
            .add_systems(
                PostUpdate,
                mask::add_masks
                    .after(TerrainSystems::Load)
                    .before(TerrainSystems::View),
            )
            .add_systems(
                PostUpdate,
                cull::cull_nodes.in_set(TerrainRenderSystems::Cull),
            );

        let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
            return;
        };
        render_app
            .init_gpu_resource::<extract::ExtractedTerrains>()
            .init_gpu_resource::<extract::UploadedTerrains>()
            .init_gpu_resource::<pages::GpuTerrainPages>()
            .init_gpu_resource::<prepare::GpuTerrains>()
            .init_gpu_resource::<GpuTerrainMeshes>()
            .init_gpu_resource::<draw::TerrainDraws>()
            .init_gpu_resource::<SpecializedRenderPipelines<pipelines::TerrainDrawPipeline>>()
            .add_render_command::<Opaque3d, draw::DrawTerrainMain>()
            .add_render_command::<Opaque3dPrepass, draw::DrawTerrainPrepass>()
            .add_render_command::<AlphaMask3dDeferred, draw::DrawTerrainDeferred>()
            .add_render_command::<Shadow, draw::DrawTerrainPrepass>()
            .add_systems(
                RenderStartup,
                pipelines::init_terrain_pipelines.after(init_prepass_pipeline),
            )
            .configure_sets(
                Render,
                (
                    // Before queueing, which asks for the meshes of this frame.
                    TerrainRenderSystems::Prepare.in_set(RenderSystems::PrepareAssets),
                    TerrainRenderSystems::Queue.in_set(RenderSystems::Queue),
                ),
            )
            .add_systems(
                ExtractSchedule,
                extract::extract_terrains.in_set(TerrainRenderSystems::Extract),
            )
            .add_systems(
                Render,
                (
                    (
                        counters::read_counters,
                        prepare::prepare_terrains,
                        prepare::prepare_meshes,
                    )
                        .chain()
                        .in_set(TerrainRenderSystems::Prepare),
                    draw::queue_terrains.in_set(TerrainRenderSystems::Queue),
                ),
            )
            .configure_sets(
                RenderGraph,
                (
                    TerrainPass::Classify,
                    TerrainPass::Setup,
                    TerrainPass::Vertices,
                    TerrainPass::Indices,
                    TerrainPass::Measure,
                )
                    .chain()
                    .in_set(RenderGraphSystems::Render)
                    .before(camera_driver),
            )
            .configure_sets(
                RenderGraph,
                TerrainPass::Faces
                    .after(TerrainPass::Setup)
                    .in_set(RenderGraphSystems::Render)
                    .before(camera_driver),
            )
            .configure_sets(
                RenderGraph,
                TerrainPass::Density
                    .in_set(RenderGraphSystems::Render)
                    .before(camera_driver),
            )
            .add_systems(
                RenderGraph,
                (
                    passes::classify.in_set(TerrainPass::Classify),
                    passes::setup.in_set(TerrainPass::Setup),
                    passes::vertices.in_set(TerrainPass::Vertices),
                    passes::indices.in_set(TerrainPass::Indices),
                    (passes::measure, counters::copy_counters)
                        .chain()
                        .in_set(TerrainPass::Measure),
                ),
            );
        app.add_plugins((
            comparison::ComparisonPlugin,
            density::DensityPreviewPlugin,
            overlay::OverlayPlugin,
            statistics::StatisticsPlugin,
        ));
    }
}
