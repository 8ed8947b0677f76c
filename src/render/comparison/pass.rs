//! The pass that makes one picture of two.

use super::camera::Compared;
use super::{ComparisonView, TerrainComparison};
use bevy::asset::AssetServer;
use bevy::camera::CompositingSpace;
use bevy::core_pipeline::{Core3dSystems, FullscreenShader};
use bevy::ecs::schedule::{InternedSystemSet, NodeId, ScheduleGraph};
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::camera::ExtractedCamera;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::binding_types::{texture_2d, uniform_buffer_sized};
use bevy::render::render_resource::{
    BindGroup, BindGroupEntries, BindGroupLayoutDescriptor, BindGroupLayoutEntries, Buffer,
    BufferDescriptor, BufferUsages, CachedRenderPipelineId, ColorTargetState, ColorWrites,
    FragmentState, Operations, PipelineCache, RenderPassColorAttachment, RenderPassDescriptor,
    RenderPipelineDescriptor, ShaderStages, SpecializedRenderPipeline, SpecializedRenderPipelines,
    TextureFormat, TextureSampleType, TextureView, TextureViewId, VertexState,
};
use bevy::render::renderer::{RenderContext, RenderDevice, RenderQueue, ViewQuery};
use bevy::render::sync_world::RenderEntity;
use bevy::render::view::{ExtractedView, ViewTarget};
use bevy::render::{
    Extract, ExtractSchedule, GpuResourceAppExt, Render, RenderStartup, RenderSystems,
};
use bytemuck::{Pod, Zeroable};
use std::num::NonZeroU64;

/// How two pictures become one; WGSL `Comparison`.
#[derive(Clone, Copy, Debug, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct GpuComparison {
    /// The first pixel of what is compared.
    pub low: [u32; 2],
    /// The pixel beyond its last.
    pub high: [u32; 2],
    /// The first column of the line between the pictures, and the one beyond its last; the left half of
    /// it is black.
    pub line: [u32; 2],
    /// What differences are multiplied by.
    pub gain: f32,
    /// 0 for pictures side by side, 1 for their difference.
    pub mode: u32,
    /// What the pictures hold: 0 linear light, 1 sRGB, 2 Oklab.
    pub space: u32,
    /// Nothing.
    pub unused_a: u32,
    /// Nothing.
    pub unused_b: u32,
    /// Nothing.
    pub unused_c: u32,
}

impl GpuComparison {
    /// `half_line_px` is half the width of the line between two pictures, in physical pixels.
    fn new(
        view: ComparisonView,
        half_line_px: u32,
        viewport: UVec4,
        space: Option<CompositingSpace>,
    ) -> Self {
        let low = viewport.xy();
        let high = low + viewport.zw();
        let mut comparison = Self {
            low: low.to_array(),
            high: high.to_array(),
            space: match space {
                None | Some(CompositingSpace::Linear) => 0,
                Some(CompositingSpace::Srgb) => 1,
                Some(CompositingSpace::Oklab) => 2,
            },
            ..Self::zeroed()
        };
        match view {
            ComparisonView::Split { divider } => {
                let divider = if divider.is_nan() { 0.5 } else { divider };
                let width = viewport.z;
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "between 0 and a picture's width"
                )]
                let edge = (divider.clamp(0.0, 1.0) * width as f32).round() as u32;
                let half = half_line_px.min(edge).min(width - edge);
                comparison.line = [low.x + edge - half, low.x + edge + half];
            }
            ComparisonView::Difference { gain } => {
                comparison.mode = 1;
                comparison.gain = if gain.is_nan() { 1.0 } else { gain }.clamp(1.0, 64.0);
            }
        }
        comparison
    }
}

/// A comparison in this frame, and what the GPU has of it.
struct Comparison {
    other: Entity,
    view: ComparisonView,
    half_line_px: u32,
    is_extracted: bool,
    pipeline: Option<CachedRenderPipelineId>,
    uniform: Option<(GpuComparison, Buffer)>,
    /// By the two pictures that they bind: each camera draws into two by turns.
    groups: Vec<([TextureViewId; 2], BindGroup)>,
}

/// All comparisons, by the camera that is compared, both of the render world. Made anew with the device.
#[derive(Resource, Default)]
pub(super) struct Comparisons(HashMap<Entity, Comparison>);

#[derive(Resource)]
pub(super) struct ComparisonPipeline {
    layout: BindGroupLayoutDescriptor,
    vertex: VertexState,
    shader: Handle<Shader>,
}

impl SpecializedRenderPipeline for ComparisonPipeline {
    type Key = TextureFormat;

    fn specialize(&self, format: TextureFormat) -> RenderPipelineDescriptor {
        RenderPipelineDescriptor {
            label: Some("terrain_comparison_pipeline".into()),
            layout: vec![self.layout.clone()],
            vertex: self.vertex.clone(),
            fragment: Some(FragmentState {
                shader: self.shader.clone(),
                entry_point: Some("fragment".into()),
                targets: vec![Some(ColorTargetState {
                    format,
                    blend: None,
                    write_mask: ColorWrites::ALL,
                })],
                ..default()
            }),
            ..default()
        }
    }
}

pub(super) fn build(render_app: &mut SubApp) {
    render_app
        .init_gpu_resource::<Comparisons>()
        .init_gpu_resource::<SpecializedRenderPipelines<ComparisonPipeline>>()
        .add_systems(RenderStartup, init_pipeline)
        .add_systems(ExtractSchedule, extract)
        .add_systems(Render, prepare.in_set(RenderSystems::PrepareResources));
}

fn init_pipeline(
    mut commands: Commands,
    assets: Res<AssetServer>,
    fullscreen: Res<FullscreenShader>,
) {
    let picture = || texture_2d(TextureSampleType::Float { filterable: false });
    let size = NonZeroU64::new(size_of::<GpuComparison>() as u64);
    commands.insert_resource(ComparisonPipeline {
        layout: BindGroupLayoutDescriptor::new(
            "terrain_comparison_layout",
            &BindGroupLayoutEntries::sequential(
                ShaderStages::FRAGMENT,
                (uniform_buffer_sized(false, size), picture(), picture()),
            ),
        ),
        vertex: fullscreen.to_vertex_state(),
        shader: super::shader(&assets),
    });
}

fn extract(
    cameras: Extract<Query<(RenderEntity, &TerrainComparison, &Compared, &Camera)>>,
    others: Extract<Query<RenderEntity>>,
    mut comparisons: ResMut<Comparisons>,
) {
    let comparisons = &mut comparisons.0;
    if comparisons.is_empty() && cameras.is_empty() {
        return;
    }
    for comparison in comparisons.values_mut() {
        comparison.is_extracted = false;
    }
    for (entity, comparison, compared, camera) in &cameras {
        let other = compared.other.and_then(|other| others.get(other).ok());
        let Some(other) = other.filter(|_| camera.is_active) else {
            continue;
        };
        // A logical pixel, in whole physical ones.
        let scale_factor = camera.target_scaling_factor().unwrap_or(1.0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a whole number between 1 and 64"
        )]
        let half_line_px = scale_factor.round().clamp(1.0, 64.0) as u32;
        let known = comparisons.entry(entity).or_insert_with(|| Comparison {
            other,
            view: comparison.view,
            half_line_px,
            is_extracted: true,
            pipeline: None,
            uniform: None,
            groups: Vec::new(),
        });
        known.other = other;
        known.view = comparison.view;
        known.half_line_px = half_line_px;
        known.is_extracted = true;
    }
    comparisons.retain(|_, comparison| comparison.is_extracted);
}

fn prepare(
    mut comparisons: ResMut<Comparisons>,
    mut pipelines: ResMut<SpecializedRenderPipelines<ComparisonPipeline>>,
    pipeline: Res<ComparisonPipeline>,
    cache: Res<PipelineCache>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    views: Query<(&ExtractedView, &ExtractedCamera)>,
) {
    for (entity, comparison) in &mut comparisons.0 {
        let Ok((view, camera)) = views.get(*entity) else {
            continue;
        };
        let id = pipelines.specialize(&cache, &pipeline, view.target_format);
        comparison.pipeline = Some(id);
        let wanted = GpuComparison::new(
            comparison.view,
            comparison.half_line_px,
            view.viewport,
            camera.compositing_space,
        );
        match &mut comparison.uniform {
            Some((known, _)) if *known == wanted => continue,
            Some((known, buffer)) => {
                *known = wanted;
                queue.write_buffer(buffer, 0, bytemuck::bytes_of(&wanted));
            }
            None => {
                let buffer = device.create_buffer(&BufferDescriptor {
                    label: Some("terrain_comparison_uniform"),
                    size: size_of::<GpuComparison>() as u64,
                    usage: BufferUsages::UNIFORM | BufferUsages::COPY_DST,
                    mapped_at_creation: false,
                });
                queue.write_buffer(&buffer, 0, bytemuck::bytes_of(&wanted));
                comparison.uniform = Some((wanted, buffer));
            }
        }
    }
}

/// The pass's label in captures, and its name in Bevy's render diagnostics.
const LABEL: &str = "terrain_comparison";

/// Puts the second camera's picture into that of the view that is drawn.
pub(super) fn compare(
    view: ViewQuery<&ViewTarget>,
    targets: Query<&ViewTarget>,
    mut comparisons: ResMut<Comparisons>,
    pipeline: Res<ComparisonPipeline>,
    cache: Res<PipelineCache>,
    mut context: RenderContext,
) {
    let entity = view.entity();
    let own = view.into_inner();
    let Some(comparison) = comparisons.0.get_mut(&entity) else {
        return;
    };
    let (Ok(other), Some(id), Some((_, uniform))) = (
        targets.get(comparison.other),
        comparison.pipeline,
        &comparison.uniform,
    ) else {
        return;
    };
    // Where the second camera hasn't followed a new size yet, the first picture stays as it is.
    if other.main_texture().size() != own.main_texture().size() {
        return;
    }
    let Some(render_pipeline) = cache.get_render_pipeline(id) else {
        return;
    };
    let _span = bevy::log::debug_span!("terrain_comparison").entered();
    let sources = [own.main_texture_view(), own.main_texture_other_view()];
    let others = [other.main_texture_view(), other.main_texture_other_view()];
    let holds = |views: &[&TextureView; 2], id| views.iter().any(|view| view.id() == id);
    let written = own.post_process_write();
    let ids = [written.source.id(), others[0].id()];
    let groups = &mut comparison.groups;
    let known = groups.iter().position(|(known, _)| *known == ids);
    let place = known.unwrap_or_else(|| {
        groups.retain(|(known, _)| holds(&sources, known[0]) && holds(&others, known[1]));
        let group = context.render_device().create_bind_group(
            "terrain_comparison_bind_group",
            &cache.get_bind_group_layout(&pipeline.layout),
            &BindGroupEntries::sequential((uniform.as_entire_binding(), written.source, others[0])),
        );
        groups.push((ids, group));
        groups.len() - 1
    });
    let group = &groups[place].1;

    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let mut pass = context
        .command_encoder()
        .begin_render_pass(&RenderPassDescriptor {
            label: Some(LABEL),
            color_attachments: &[Some(RenderPassColorAttachment {
                view: written.destination,
                depth_slice: None,
                resolve_target: None,
                ops: Operations::default(),
            })],
            depth_stencil_attachment: None,
            timestamp_writes: None,
            occlusion_query_set: None,
            multiview_mask: None,
        });
    let span = diagnostics.pass_span(&mut pass, LABEL);
    pass.set_pipeline(render_pipeline);
    pass.set_bind_group(0, group, &[]);
    pass.draw(0..3, 0..1);
    span.end(&mut pass);
}

/// The systems of [`Core3dSystems::PostProcess`], of whatever crate; [`compare`] comes after them.
/// User interfaces are drawn after that set, by systems that aren't known here.
pub(super) fn effects(graph: &ScheduleGraph) -> Vec<InternedSystemSet> {
    let set = graph
        .system_sets
        .get_key(Core3dSystems::PostProcess.intern());
    let mut waiting: Vec<NodeId> = set.map(NodeId::Set).into_iter().collect();
    let mut effects: Vec<InternedSystemSet> = Vec::new();
    while let Some(node) = waiting.pop() {
        let NodeId::System(system) = node else {
            waiting.extend(graph.hierarchy().graph().neighbors(node));
            continue;
        };
        if let Some(system) = graph.systems.get(system) {
            effects.extend(system.system().default_system_sets());
        }
    }
    // What a schedule has twice has no order of its own.
    let counted = effects.clone();
    effects.retain(|effect| counted.iter().filter(|other| *other == effect).count() == 1);
    effects
}
