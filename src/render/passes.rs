//! The compute passes, one system each, before Bevy draws any view.

use super::TerrainPass;
use super::density::{GpuDensityPreview, GpuDensityPreviews};
use super::overlay::OverlayPipelines;
use super::pipelines::TerrainPipelines;
use super::prepare::{GpuTerrainMesh, GpuTerrainMeshes, MeshBindGroups};
use bevy::prelude::*;
use bevy::render::diagnostic::RecordDiagnostics;
use bevy::render::render_resource::{
    BindGroup, CachedComputePipelineId, ComputePass, ComputePassDescriptor, ComputePipeline,
    PipelineCache,
};
use bevy::render::renderer::RenderContext;

/// Workgroups that share the vertices, or the triangles, of a node: the nodes beside the eye hold
/// most of a view's.
const NODE_SHARES: u32 = 4;
/// Workgroups that share a view's triangles when their sizes are measured.
const MEASURE_WORKGROUPS: u32 = 256;
/// Workgroups along one dimension of a dispatch; the rest go along the next.
const DISPATCH_ACROSS: u32 = 1 << 15;

struct Pass {
    kind: TerrainPass,
    pipeline: fn(&TerrainPipelines) -> CachedComputePipelineId,
    group: fn(&MeshBindGroups) -> &BindGroup,
    workgroups: fn(u32) -> [u32; 3],
    wants: fn(&GpuTerrainMesh) -> bool,
}

fn nodes(count: u32, shares: u32) -> [u32; 3] {
    let across = count.min(DISPATCH_ACROSS);
    [across, count.div_ceil(across.max(1)), shares]
}

fn run(
    pass: &Pass,
    meshes: &GpuTerrainMeshes,
    pipelines: &TerrainPipelines,
    cache: &PipelineCache,
    context: &mut RenderContext,
) {
    let Some(pipeline) = cache.get_compute_pipeline((pass.pipeline)(pipelines)) else {
        return;
    };
    if !meshes.meshes.values().any(pass.wants) {
        return;
    }
    record(pass.kind, pipeline, context, |compute| {
        for mesh in meshes.meshes.values().filter(|mesh| (pass.wants)(mesh)) {
            let GpuTerrainMesh {
                groups: Some(groups),
                ..
            } = mesh
            else {
                continue;
            };
            let [x, y, z] = (pass.workgroups)(mesh.node_count());
            compute.set_bind_group(0, &groups.inputs, &[]);
            compute.set_bind_group(1, (pass.group)(groups), &[]);
            compute.dispatch_workgroups(x, y, z);
        }
    });
}

/// Records a pass of `pipeline` under its label, with the spans of tracing and of Bevy's diagnostics.
fn record(
    kind: TerrainPass,
    pipeline: &ComputePipeline,
    context: &mut RenderContext,
    dispatch: impl FnOnce(&mut ComputePass),
) {
    let label = kind.label();
    let _span = bevy::log::debug_span!("terrain_pass", pass = label).entered();
    let diagnostics = context.diagnostic_recorder();
    let diagnostics = diagnostics.as_deref();
    let mut compute = context
        .command_encoder()
        .begin_compute_pass(&ComputePassDescriptor {
            label: Some(label),
            timestamp_writes: None,
        });
    let span = diagnostics.pass_span(&mut compute, label);
    compute.set_pipeline(pipeline);
    dispatch(&mut compute);
    span.end(&mut compute);
}

macro_rules! pass_system {
    ($name:ident, $kind:ident, $workgroups:expr) => {
        pass_system!($name, $kind, $workgroups, |_| true);
    };
    ($name:ident, $kind:ident, $workgroups:expr, $wants:expr) => {
        pub(super) fn $name(
            meshes: Res<GpuTerrainMeshes>,
            pipelines: Res<TerrainPipelines>,
            cache: Res<PipelineCache>,
            mut context: RenderContext,
        ) {
            let pass = Pass {
                kind: TerrainPass::$kind,
                pipeline: |pipelines| pipelines.$name,
                group: |groups| &groups.$name,
                workgroups: $workgroups,
                wants: $wants,
            };
            run(&pass, &meshes, &pipelines, &cache, &mut context);
        }
    };
}

pass_system!(classify, Classify, |count| nodes(count, 1));
pass_system!(setup, Setup, |_| [1, 1, 1]);
pass_system!(vertices, Vertices, |count| nodes(count, NODE_SHARES));
pass_system!(indices, Indices, |count| nodes(count, NODE_SHARES));
pass_system!(measure, Measure, |_| [MEASURE_WORKGROUPS, 1, 1], |mesh| {
    mesh.is_measured()
});

/// Finds the faces of the triangles that are drawn with overlays; without any there is no pass.
pub(super) fn faces(
    meshes: Res<GpuTerrainMeshes>,
    pipelines: Res<OverlayPipelines>,
    cache: Res<PipelineCache>,
    mut context: RenderContext,
) {
    let groups = || {
        meshes.meshes.values().filter_map(|mesh| {
            let groups = mesh.groups.as_ref()?;
            Some((mesh.node_count(), groups, groups.overlays.as_ref()?))
        })
    };
    if groups().next().is_none() {
        return;
    }
    let pipeline = pipelines.faces();
    let Some(pipeline) = pipeline.and_then(|id| cache.get_compute_pipeline(id)) else {
        return;
    };
    record(TerrainPass::Faces, pipeline, &mut context, |compute| {
        for (node_count, groups, overlays) in groups() {
            let [x, y, z] = nodes(node_count, NODE_SHARES);
            compute.set_bind_group(0, &groups.inputs, &[]);
            compute.set_bind_group(1, &overlays.faces, &[]);
            compute.dispatch_workgroups(x, y, z);
        }
    });
}

/// Workgroups that share the densities of a page, four rows of texels each.
const DENSITY_STRIPS: u32 = 8;

/// Makes the densities that previews lack; in most frames there are none, and no pass.
pub(super) fn density(
    mut previews: ResMut<GpuDensityPreviews>,
    pipelines: Res<TerrainPipelines>,
    cache: Res<PipelineCache>,
    mut context: RenderContext,
) {
    let lacks = |preview: &GpuDensityPreview| preview.is_ready && !preview.pending.is_empty();
    if !previews.previews.values().any(lacks) {
        return;
    }
    let Some(pipeline) = cache.get_compute_pipeline(pipelines.density) else {
        return;
    };
    record(TerrainPass::Density, pipeline, &mut context, |compute| {
        for preview in previews.previews.values_mut().filter(|it| lacks(it)) {
            let Some(gpu) = &preview.gpu else {
                continue;
            };
            let pages = preview.pending.len() as u32;
            compute.set_bind_group(0, &gpu.group, &[]);
            compute.dispatch_workgroups(pages, DENSITY_STRIPS, 1);
            preview.pending.clear();
            preview.made_pages += u64::from(pages);
        }
    });
}
