//! One indirect draw per terrain and pass, as items of Bevy's own phases.

use super::density::GpuDensityPreviews;
use super::extract::ExtractedTerrains;
use super::pipelines::{
    DrawExtras, TERRAIN_BIND_GROUP, TerrainDrawKey, TerrainDrawKind, TerrainDrawPipeline,
};
use super::prepare::{GpuTerrainMesh, GpuTerrainMeshes, GpuTerrains};
use bevy::core_pipeline::core_3d::{Opaque3d, Opaque3dBatchSetKey, Opaque3dBinKey};
use bevy::core_pipeline::deferred::AlphaMask3dDeferred;
use bevy::core_pipeline::prepass::{
    DeferredPrepass, DepthPrepass, MotionVectorPrepass, NormalPrepass, Opaque3dPrepass,
    OpaqueNoLightmap3dBatchSetKey, OpaqueNoLightmap3dBinKey,
};
use bevy::ecs::query::ROQueryItem;
use bevy::ecs::system::SystemParamItem;
use bevy::ecs::system::lifetimeless::{Read, SRes};
use bevy::mesh::{BaseMeshPipelineKey, PrimitiveTopology};
use bevy::pbr::{
    LightEntity, MATERIAL_BIND_GROUP_INDEX, MeshPipelineKey, SetMeshViewBindGroup,
    SetMeshViewBindingArrayBindGroup, SetPrepassViewBindGroup, SetPrepassViewEmptyBindGroup,
    Shadow, ShadowBatchSetKey, ShadowBinKey, ViewKeyCache,
};
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::camera::ExtractedCamera;
use bevy::render::mesh::allocator::MeshSlabs;
use bevy::render::render_phase::{
    BinnedPhaseItem, BinnedRenderPhaseType, DrawFunctions, InputUniformIndex, PhaseItem,
    RenderCommand, RenderCommandResult, SetItemPipeline, TrackedRenderPass, ViewBinnedRenderPhases,
};
use bevy::render::render_resource::{
    CachedRenderPipelineId, IndexFormat, PipelineCache, SpecializedRenderPipelines,
};
use bevy::render::renderer::RenderDevice;
use bevy::render::sync_world::MainEntity;
use bevy::render::view::{ExtractedView, RetainedViewEntity};

/// Which camera's mesh each view draws of each terrain; filled while queueing.
#[derive(Resource, Default)]
pub(super) struct TerrainDraws {
    cameras: HashMap<(RetainedViewEntity, MainEntity), DrawnMesh>,
    /// What was queued in the frame before: bins persist, so it must be taken out again.
    queued: Vec<(TerrainDrawKind, RetainedViewEntity, MainEntity)>,
}

/// The mesh that a view draws of a terrain.
struct DrawnMesh {
    camera: MainEntity,
    /// What the pass that shades it shows beside the ground.
    extras: DrawExtras,
}

pub(super) type DrawTerrainMain = (
    SetItemPipeline,
    SetMeshViewBindGroup<0>,
    SetMeshViewBindingArrayBindGroup<1>,
    DrawTerrain<true>,
);

pub(super) type DrawTerrainPrepass = (
    SetItemPipeline,
    SetPrepassViewBindGroup<0>,
    SetPrepassViewEmptyBindGroup<1>,
    DrawTerrain<false>,
);

pub(super) type DrawTerrainDeferred = (
    SetItemPipeline,
    SetPrepassViewBindGroup<0>,
    SetPrepassViewEmptyBindGroup<1>,
    DrawTerrain<true>,
);

/// Binds a terrain's mesh and material and draws it, indirectly. `SHADES` in the passes where
/// materials' colours count.
pub(super) struct DrawTerrain<const SHADES: bool>;

impl<P: PhaseItem, const SHADES: bool> RenderCommand<P> for DrawTerrain<SHADES> {
    type Param = (
        SRes<GpuTerrainMeshes>,
        SRes<GpuTerrains>,
        SRes<TerrainDraws>,
    );
    type ViewQuery = Read<ExtractedView>;
    type ItemQuery = ();

    fn render<'w>(
        item: &P,
        view: ROQueryItem<'w, '_, Self::ViewQuery>,
        _: Option<()>,
        (meshes, terrains, draws): SystemParamItem<'w, '_, Self::Param>,
        pass: &mut TrackedRenderPass<'w>,
    ) -> RenderCommandResult {
        let terrain = item.main_entity();
        let (meshes, terrains) = (meshes.into_inner(), terrains.into_inner());
        let found = draws
            .into_inner()
            .cameras
            .get(&(view.retained_view_entity, terrain))
            .and_then(|drawn| {
                let mesh = meshes.meshes.get(&(drawn.camera, terrain))?;
                Some((mesh, if SHADES { drawn.extras } else { default() }))
            });
        let (Some((mesh, extras)), Some(gpu_terrain)) = (found, terrains.terrains.get(&terrain))
        else {
            return RenderCommandResult::Skip;
        };
        let groups = mesh.groups.as_ref();
        let Some(draw) = groups.and_then(|groups| groups.of_draw(extras)) else {
            return RenderCommandResult::Skip;
        };
        pass.set_bind_group(TERRAIN_BIND_GROUP, draw, &[]);
        pass.set_bind_group(MATERIAL_BIND_GROUP_INDEX, &gpu_terrain.material, &[]);
        if extras.overlays {
            // The first four words of the arguments are those of a draw that isn't indexed.
            pass.draw_indirect(mesh.args(), 0);
            return RenderCommandResult::Success;
        }
        pass.set_vertex_buffer(0, mesh.vertices().slice(..));
        pass.set_index_buffer(mesh.indices().slice(..), IndexFormat::Uint32);
        pass.draw_indexed_indirect(mesh.args(), 0);
        RenderCommandResult::Success
    }
}

type CameraViews<'w, 's> = Query<
    'w,
    's,
    (
        &'static ExtractedView,
        &'static Msaa,
        Has<DepthPrepass>,
        Has<NormalPrepass>,
        Has<MotionVectorPrepass>,
        Has<DeferredPrepass>,
    ),
    With<ExtractedCamera>,
>;

/// The phases that terrains are drawn in.
#[derive(bevy::ecs::system::SystemParam)]
pub(super) struct Phases<'w> {
    main: ResMut<'w, ViewBinnedRenderPhases<Opaque3d>>,
    prepass: ResMut<'w, ViewBinnedRenderPhases<Opaque3dPrepass>>,
    // Not `Opaque3dDeferred`: its pass skips a scene whose only opaque thing is no mesh.
    deferred: ResMut<'w, ViewBinnedRenderPhases<AlphaMask3dDeferred>>,
    shadow: ResMut<'w, ViewBinnedRenderPhases<Shadow>>,
    main_draws: Res<'w, DrawFunctions<Opaque3d>>,
    prepass_draws: Res<'w, DrawFunctions<Opaque3dPrepass>>,
    deferred_draws: Res<'w, DrawFunctions<AlphaMask3dDeferred>>,
    shadow_draws: Res<'w, DrawFunctions<Shadow>>,
}

fn remove<P: BinnedPhaseItem>(
    phases: &mut ViewBinnedRenderPhases<P>,
    view: &RetainedViewEntity,
    terrain: MainEntity,
) {
    if let Some(phase) = phases.get_mut(view) {
        phase.remove(terrain);
    }
}

/// Queues a terrain; false where the view has no such phase.
fn add<P: BinnedPhaseItem>(
    phases: &mut ViewBinnedRenderPhases<P>,
    view: &RetainedViewEntity,
    terrain: MainEntity,
    batch_set: P::BatchSetKey,
    bin: P::BinKey,
) -> bool {
    let Some(phase) = phases.get_mut(view) else {
        return false;
    };
    let entity = (Entity::PLACEHOLDER, terrain);
    let uniform = InputUniformIndex::default();
    phase.add(
        batch_set,
        bin,
        entity,
        uniform,
        BinnedRenderPhaseType::NonMesh,
    );
    true
}

impl Phases<'_> {
    fn remove(&mut self, kind: TerrainDrawKind, view: &RetainedViewEntity, terrain: MainEntity) {
        match kind {
            TerrainDrawKind::Main => remove(&mut self.main, view, terrain),
            TerrainDrawKind::Prepass => remove(&mut self.prepass, view, terrain),
            TerrainDrawKind::Deferred => remove(&mut self.deferred, view, terrain),
            TerrainDrawKind::Shadow => remove(&mut self.shadow, view, terrain),
        }
    }

    /// Queues a terrain; false where the view has no such phase.
    fn add(
        &mut self,
        kind: TerrainDrawKind,
        view: &RetainedViewEntity,
        terrain: MainEntity,
        pipeline: CachedRenderPipelineId,
    ) -> bool {
        let asset_id = AssetId::<Mesh>::invalid().untyped();
        let slabs = MeshSlabs::default();
        let material_bind_group_index = None;
        let no_lightmap = |draw_function| OpaqueNoLightmap3dBatchSetKey {
            draw_function,
            pipeline,
            material_bind_group_index,
            slabs,
        };
        let no_lightmap_bin = OpaqueNoLightmap3dBinKey { asset_id };
        match kind {
            TerrainDrawKind::Main => {
                let batch_set = Opaque3dBatchSetKey {
                    draw_function: self.main_draws.read().id::<DrawTerrainMain>(),
                    pipeline,
                    material_bind_group_index,
                    lightmap_slab: None,
                    slabs,
                };
                let bin = Opaque3dBinKey { asset_id };
                add(&mut self.main, view, terrain, batch_set, bin)
            }
            TerrainDrawKind::Prepass => {
                let batch_set = no_lightmap(self.prepass_draws.read().id::<DrawTerrainPrepass>());
                add(&mut self.prepass, view, terrain, batch_set, no_lightmap_bin)
            }
            TerrainDrawKind::Deferred => {
                let batch_set = no_lightmap(self.deferred_draws.read().id::<DrawTerrainDeferred>());
                add(
                    &mut self.deferred,
                    view,
                    terrain,
                    batch_set,
                    no_lightmap_bin,
                )
            }
            TerrainDrawKind::Shadow => {
                let batch_set = ShadowBatchSetKey {
                    draw_function: self.shadow_draws.read().id::<DrawTerrainPrepass>(),
                    pipeline,
                    material_bind_group_index,
                    slabs,
                };
                let bin = ShadowBinKey { asset_id };
                add(&mut self.shadow, view, terrain, batch_set, bin)
            }
        }
    }
}

/// What a shader stage of the device may bind.
#[derive(Clone, Copy)]
struct StageLimits {
    storage_buffers: u32,
    uniform_buffers: u32,
}

/// Whether a pass shades the ground and has buffers left for `extras`.
fn affords(
    kind: TerrainDrawKind,
    mesh: MeshPipelineKey,
    limits: StageLimits,
    extras: DrawExtras,
) -> bool {
    let DrawExtras { preview, overlays } = extras;
    let has = |bits| u32::from(mesh.contains(bits));
    match kind {
        TerrainDrawKind::Deferred => true,
        TerrainDrawKind::Main => {
            let oit = has(MeshPipelineKey::OIT_ENABLED);
            // Lights take three, order-independent transparency three, the atmosphere one, the
            // page table, the preview and the overlays' densities one each.
            let storage = 4
                + 3 * oit
                + has(MeshPipelineKey::ATMOSPHERE)
                + u32::from(preview)
                + u32::from(overlays);
            // Bevy's view takes seven, order-independent transparency two, the draw, its detail and
            // its material three, the overlays one.
            let uniforms = 10 + 2 * oit + u32::from(overlays);
            // Bevy's visibility ranges and four that vertices are pulled from.
            let vertex_storage = if overlays { 5 } else { 1 };
            storage.max(vertex_storage) <= limits.storage_buffers
                && (uniforms <= limits.uniform_buffers || !overlays)
        }
        TerrainDrawKind::Prepass | TerrainDrawKind::Shadow => false,
    }
}

/// Of the cameras that have a mesh of a terrain, each with whether it is the second one of a
/// comparison, that whose mesh throws the shadows that all share: the first, whichever that is, the
/// same every frame. A second camera only where there is no other, so that comparing doesn't change
/// what is compared.
fn shared_caster(cameras: impl Iterator<Item = (MainEntity, bool)>) -> Option<MainEntity> {
    let first = cameras.min_by_key(|(camera, compares)| (*compares, *camera));
    first.map(|(camera, _)| camera)
}

/// Puts every terrain into the phases of every view that draws it.
#[expect(clippy::too_many_arguments, reason = "parameters of a Bevy system")]
pub(super) fn queue_terrains(
    mut phases: Phases,
    mut draws: ResMut<TerrainDraws>,
    mut pipelines: ResMut<SpecializedRenderPipelines<TerrainDrawPipeline>>,
    draw_pipeline: Res<TerrainDrawPipeline>,
    cache: Res<PipelineCache>,
    extracted: Res<ExtractedTerrains>,
    meshes: Res<GpuTerrainMeshes>,
    previews: Res<GpuDensityPreviews>,
    device: Res<RenderDevice>,
    view_keys: Res<ViewKeyCache>,
    cameras: CameraViews,
    shadow_views: Query<(&LightEntity, &ExtractedView)>,
    mut refused: Local<bool>,
) {
    let _span = bevy::log::debug_span!("terrain_queue").entered();
    let TerrainDraws {
        cameras: drawn_by,
        queued,
    } = &mut *draws;
    drawn_by.clear();
    for (kind, view, terrain) in queued.drain(..) {
        phases.remove(kind, &view, terrain);
    }
    let limits = device.limits();
    let limits = StageLimits {
        storage_buffers: limits.max_storage_buffers_per_shader_stage,
        uniform_buffers: limits.max_uniform_buffers_per_shader_stage,
    };
    let mut queue = |kind, mesh, view: &ExtractedView, camera: MainEntity, terrain: MainEntity| {
        let Some(shader) = extracted
            .terrains
            .get(&terrain)
            .and_then(|terrain| terrain.shader.clone())
        else {
            return;
        };
        let mut pipeline = |extras| {
            let shader = shader.clone();
            let key = TerrainDrawKey {
                kind,
                mesh,
                shader,
                extras,
            };
            pipelines.specialize(&cache, &draw_pipeline, key)
        };
        let wanted = DrawExtras {
            preview: previews
                .previews
                .get(&terrain)
                .is_some_and(|it| it.is_ready),
            overlays: meshes
                .meshes
                .get(&(camera, terrain))
                .is_some_and(GpuTerrainMesh::has_overlays),
        };
        // With as much as can be afforded, overlays first. While that is compiled, the ground is drawn
        // without rather than not at all.
        let overlays_only = DrawExtras {
            preview: false,
            ..wanted
        };
        let preview_only = DrawExtras {
            overlays: false,
            ..wanted
        };
        let afforded = |extras: &DrawExtras| affords(kind, mesh, limits, *extras);
        let best = [wanted, overlays_only, preview_only]
            .into_iter()
            .find(afforded)
            .unwrap_or_default();
        if wanted.overlays && !best.overlays && kind == TerrainDrawKind::Main && !*refused {
            *refused = true;
            warn!(
                "terrain overlays are not drawn: this camera leaves them no buffers on a device \
                 with {} storage and {} uniform buffers a stage; do without order-independent \
                 transparency or the atmosphere",
                limits.storage_buffers, limits.uniform_buffers
            );
        }
        let fallback = DrawExtras {
            overlays: false,
            ..best
        };
        let (extras, pipeline) = [best, fallback]
            .into_iter()
            .filter(|extras| *extras != DrawExtras::default())
            .map(|extras| (extras, pipeline(extras)))
            .find(|(_, id)| cache.get_render_pipeline(*id).is_some())
            .unwrap_or_else(|| (default(), pipeline(default())));
        let retained = view.retained_view_entity;
        if phases.add(kind, &retained, terrain, pipeline) {
            queued.push((kind, retained, terrain));
            drawn_by.insert((retained, terrain), DrawnMesh { camera, extras });
        }
    };

    let triangles = MeshPipelineKey::from_bits_retain(
        BaseMeshPipelineKey::from_primitive_topology_and_strip_index(
            PrimitiveTopology::TriangleList,
            None,
        )
        .bits(),
    );
    for (view, msaa, depth, normal, motion, deferred) in &cameras {
        let camera = view.retained_view_entity.main_entity;
        let mut prepass = triangles | MeshPipelineKey::from_msaa_samples(msaa.samples());
        prepass.set(MeshPipelineKey::DEPTH_PREPASS, depth);
        prepass.set(MeshPipelineKey::NORMAL_PREPASS, normal);
        prepass.set(MeshPipelineKey::MOTION_VECTOR_PREPASS, motion);
        prepass.set(MeshPipelineKey::DEFERRED_PREPASS, deferred);
        prepass.set(MeshPipelineKey::INVERT_CULLING, view.invert_culling);
        for &(_, terrain) in meshes.meshes.keys().filter(|(of, _)| *of == camera) {
            if deferred {
                queue(TerrainDrawKind::Deferred, prepass, view, camera, terrain);
                continue;
            }
            if depth || normal || motion {
                queue(TerrainDrawKind::Prepass, prepass, view, camera, terrain);
            }
            if let Some(view_key) = view_keys.get(&view.retained_view_entity) {
                queue(
                    TerrainDrawKind::Main,
                    triangles | *view_key,
                    view,
                    camera,
                    terrain,
                );
            }
        }
    }

    for (light, view) in &shadow_views {
        let directional = matches!(light, LightEntity::Directional { .. });
        let mut key = triangles | MeshPipelineKey::from_msaa_samples(1);
        key |= MeshPipelineKey::DEPTH_PREPASS;
        key |= if directional {
            MeshPipelineKey::VIEW_PROJECTION_ORTHOGRAPHIC | MeshPipelineKey::UNCLIPPED_DEPTH_ORTHO
        } else {
            MeshPipelineKey::VIEW_PROJECTION_PERSPECTIVE
        };
        // A cascade belongs to a camera. Point and spot shadows are shared by all.
        let of_camera = view.retained_view_entity.auxiliary_entity;
        for &(camera, terrain) in meshes.meshes.keys() {
            let casts = if directional {
                camera == of_camera
            } else {
                let all = meshes.meshes.iter();
                let of_terrain = all.filter(|((_, other), _)| *other == terrain);
                let cameras = of_terrain.map(|((camera, _), mesh)| (*camera, mesh.compares));
                shared_caster(cameras) == Some(camera)
            };
            if !casts {
                continue;
            }
            queue(TerrainDrawKind::Shadow, key, view, camera, terrain);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WEBGPU: StageLimits = StageLimits {
        storage_buffers: 8,
        uniform_buffers: 12,
    };

    #[test]
    fn a_comparison_takes_the_shared_shadows_of_no_other_camera() {
        let camera = |index| MainEntity::from(Entity::from_raw_u32(index).expect("small"));
        let mut cameras = [5, 3, 9].map(camera);
        cameras.sort();
        for compared in 0..3 {
            let all = (0..3).map(|at| (cameras[at], at == compared));
            let wanted = cameras[usize::from(compared == 0)];
            assert_eq!(shared_caster(all.clone()), Some(wanted));
            assert_eq!(shared_caster(all.rev()), Some(wanted));
        }
        let alone = [(cameras[1], true)];
        assert_eq!(shared_caster(alone.into_iter()), Some(cameras[1]));
    }

    #[test]
    fn overlays_are_left_out_where_no_buffer_is_left_for_them() {
        let (oit, atmosphere) = (MeshPipelineKey::OIT_ENABLED, MeshPipelineKey::ATMOSPHERE);
        let overlays = DrawExtras {
            preview: false,
            overlays: true,
        };
        let both = DrawExtras {
            preview: true,
            overlays: true,
        };
        let main = |mesh, extras| affords(TerrainDrawKind::Main, mesh, WEBGPU, extras);
        assert!(main(MeshPipelineKey::NONE, overlays));
        assert!(main(atmosphere, both));
        assert!(!main(oit, overlays), "no uniform buffer is left");
        let wide = StageLimits {
            storage_buffers: 8,
            uniform_buffers: 15,
        };
        let wide = |mesh, extras| affords(TerrainDrawKind::Main, mesh, wide, extras);
        assert!(wide(oit, overlays));
        assert!(!wide(oit, both), "no storage buffer is left");
        assert!(affords(TerrainDrawKind::Deferred, oit, WEBGPU, both));
        assert!(!affords(TerrainDrawKind::Shadow, oit, WEBGPU, overlays));
        assert!(!affords(TerrainDrawKind::Prepass, oit, WEBGPU, overlays));
    }

    #[test]
    fn a_preview_is_left_out_where_no_storage_buffer_is_left_for_it() {
        let (oit, atmosphere) = (MeshPipelineKey::OIT_ENABLED, MeshPipelineKey::ATMOSPHERE);
        let preview = DrawExtras {
            preview: true,
            overlays: false,
        };
        let afforded = |kind, mesh| affords(kind, mesh, WEBGPU, preview);
        assert!(afforded(TerrainDrawKind::Main, MeshPipelineKey::NONE));
        assert!(afforded(TerrainDrawKind::Main, oit));
        assert!(afforded(TerrainDrawKind::Main, atmosphere));
        assert!(!afforded(TerrainDrawKind::Main, oit | atmosphere));
        assert!(afforded(TerrainDrawKind::Deferred, atmosphere));
        assert!(!afforded(TerrainDrawKind::Shadow, MeshPipelineKey::NONE));
    }
}
