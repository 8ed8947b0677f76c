//! A preview of densities, made on the GPU from the height pages that lie there.

use super::TerrainPass;
use super::extract::{ExtractedTerrains, UploadedTerrains};
use super::gpu_types::{GpuDensityJob, GpuDensityKernel};
use super::pages::GpuTerrainPages;
use super::passes::density;
use super::pipelines::TerrainPipelines;
use super::prepare::buffer;
use crate::density::DensitySettings;
use crate::stream::TerrainState;
use crate::terrain::TerrainSystems;
use bevy::ecs::entity::EntityHashSet;
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::render_resource::{
    BindGroup, BindGroupEntries, Buffer, BufferUsages, PipelineCache,
};
use bevy::render::renderer::{RenderDevice, RenderGraph, RenderQueue};
use bevy::render::sync_world::MainEntity;
use bevy::render::{Extract, ExtractSchedule, GpuResourceAppExt, Render, RenderApp};

/// Shows what densities other settings would make, while it is on a terrain's entity: from green
/// (0) to red (1), over the ground's own colour.
///
/// For parameters that are dragged: densities of all resident tiles are made anew on the GPU
/// whenever the settings change, and a tile's when its heights are uploaded. They are shown and
/// nothing else: what is stored, saved or tessellated by comes from the CPU
/// ([`density`](crate::density)), so that every machine has the same bytes. The two agree within
/// one quantum (1/255) at exponents from a third up; a smaller one makes much of the last bit of
/// ground that hardly bends.
///
/// A preview is not quite the map that a bake would write:
/// - Each level shows the curvature of its own heights at its own spacing. In the map, coarser
///   levels take the largest density of the finer ones, where there are any.
/// - Densities don't spread, and borders are like all other texels: `preprocess`, `filter_size`,
///   `border` and `lod_skip` change nothing.
///
/// It takes 1 KiB of GPU memory a page and a storage buffer of the fragment stage. Where a view
/// leaves none (on a device with WebGPU's limits, a camera with both order-independent
/// transparency and an atmosphere) it is not drawn there. Settings that can't be used are logged,
/// and nothing is shown until they can.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_tessera::render::TerrainDensityPreview;
/// # use bevy_tessera::terrain::Terrain;
/// fn louder(mut commands: Commands, terrain: Single<Entity, With<Terrain>>) {
///     let mut preview = TerrainDensityPreview::default();
///     preview.settings.gain = 2.0;
///     commands.entity(*terrain).insert(preview);
/// }
/// ```
#[derive(Component, Clone, Debug, PartialEq, Reflect)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct TerrainDensityPreview {
    /// What densities are made with; may differ from the settings of the terrain's manifest.
    pub settings: DensitySettings,
    /// How much of the ground's colour is covered, 0 to 1.
    pub opacity: f32,
}

impl Default for TerrainDensityPreview {
    fn default() -> Self {
        Self {
            settings: DensitySettings::default(),
            opacity: 0.8,
        }
    }
}

impl TerrainDensityPreview {
    /// Opacities that make sense.
    pub const OPACITY_RANGE: std::ops::RangeInclusive<f32> = 0.0..=1.0;
}

/// Previews of densities. Part of [`TerrainRenderPlugin`](super::TerrainRenderPlugin).
pub(super) struct DensityPreviewPlugin;

impl Plugin for DensityPreviewPlugin {
    fn build(&self, app: &mut App) {
        app.register_type::<TerrainDensityPreview>()
            .add_systems(PostUpdate, refuse_previews.after(TerrainSystems::Stream));
        let Some(render_app) = app.get_sub_app_mut(RenderApp) else {
            return;
        };
        render_app
            .init_gpu_resource::<GpuDensityPreviews>()
            .add_systems(
                ExtractSchedule,
                extract_previews
                    .after(super::extract::extract_terrains)
                    .in_set(super::TerrainRenderSystems::Extract),
            )
            .add_systems(
                Render,
                prepare_previews
                    .after(super::prepare::prepare_terrains)
                    .before(super::prepare::prepare_meshes)
                    .in_set(super::TerrainRenderSystems::Prepare),
            )
            .add_systems(RenderGraph, density.in_set(TerrainPass::Density));
    }
}

/// The previews of all terrains in the render world.
#[derive(Resource, Default)]
pub struct GpuDensityPreviews {
    pub(super) previews: HashMap<MainEntity, GpuDensityPreview>,
}

impl GpuDensityPreviews {
    /// The preview of `terrain`, an entity of the main world.
    #[must_use]
    pub fn get(&self, terrain: Entity) -> Option<&GpuDensityPreview> {
        self.previews.get(&MainEntity::from(terrain))
    }
}

/// A terrain's preview in the render world.
pub struct GpuDensityPreview {
    /// What the densities are of.
    instance: u64,
    settings: DensitySettings,
    pub(super) opacity: f32,
    kernel: GpuDensityKernel,
    /// Whether the GPU's copy of the kernel is another one.
    kernel_changed: bool,
    /// Pages that there is room for.
    capacity: u32,
    /// Pages whose densities are not what they should be.
    pub(super) pending: Vec<GpuDensityJob>,
    pub(super) made_pages: u64,
    /// Whether there is a pass to make densities with; before there is, none are shown.
    pub(super) is_ready: bool,
    pub(super) gpu: Option<DensityBuffers>,
}

/// What a preview has on the GPU.
pub(super) struct DensityBuffers {
    capacity: u32,
    kernel: Buffer,
    jobs: Buffer,
    pub(super) densities: Buffer,
    pub(super) group: BindGroup,
    group_built_for: u64,
    /// Tells these buffers from all others.
    pub(super) generation: u64,
}

impl GpuDensityPreview {
    /// The densities by page, 32 × 32 bytes each, row by row. `None` before the first frame.
    #[must_use]
    pub fn densities(&self) -> Option<&Buffer> {
        self.gpu.as_ref().map(|gpu| &gpu.densities)
    }

    /// How many pages' densities have been made since the preview began. Stands still while neither
    /// settings nor heights change.
    #[must_use]
    pub const fn made_pages(&self) -> u64 {
        self.made_pages
    }

    /// What the pass was told.
    #[must_use]
    pub const fn kernel(&self) -> &GpuDensityKernel {
        &self.kernel
    }
}

/// Says what is wrong with settings that can't be used.
fn refuse_previews(
    previews: Query<(Entity, &TerrainDensityPreview), Changed<TerrainDensityPreview>>,
    all: Query<(), With<TerrainDensityPreview>>,
    mut refused: Local<EntityHashSet>,
) {
    let _span = bevy::log::debug_span!("terrain_refuse_density_previews").entered();
    refused.retain(|entity| all.contains(*entity));
    for (entity, preview) in &previews {
        match preview.settings.validate() {
            // Once, not in every frame of a drag through what can't be used.
            Err(error) if refused.insert(entity) => {
                error!("terrain {entity} shows no preview of its densities: {error}");
            }
            Err(_) => {}
            Ok(()) => {
                refused.remove(&entity);
            }
        }
    }
}

fn extract_previews(
    terrains: Extract<Query<(Entity, &TerrainState, &TerrainDensityPreview)>>,
    extracted: Res<ExtractedTerrains>,
    uploaded: Res<UploadedTerrains>,
    mut previews: ResMut<GpuDensityPreviews>,
) {
    let _span = bevy::log::debug_span!("terrain_extract_density_previews").entered();
    if previews.previews.is_empty() && terrains.is_empty() {
        return;
    }
    let shows = |preview: &TerrainDensityPreview| preview.settings.validate().is_ok();
    previews.previews.retain(|terrain, _| {
        terrains
            .get(terrain.id())
            .is_ok_and(|(.., preview)| shows(preview))
    });
    for (entity, state, preview) in terrains.iter().filter(|(.., preview)| shows(preview)) {
        let key = MainEntity::from(entity);
        let mut everything = false;
        let known = previews.previews.entry(key).or_insert_with(|| {
            everything = true;
            GpuDensityPreview {
                instance: state.instance(),
                settings: preview.settings.clone(),
                opacity: preview.opacity,
                kernel: GpuDensityKernel::new(&state.manifest().file, &preview.settings),
                kernel_changed: true,
                capacity: extracted.page_numbers,
                pending: Vec::new(),
                made_pages: 0,
                is_ready: false,
                gpu: None,
            }
        });
        // What is not a number covers nothing.
        known.opacity = if preview.opacity > 0.0 {
            preview.opacity.min(1.0)
        } else {
            0.0
        };
        if known.instance != state.instance() || known.settings != preview.settings {
            let kernel = GpuDensityKernel::new(&state.manifest().file, &preview.settings);
            // Some settings change nothing that is shown.
            everything |= known.instance != state.instance() || known.kernel != kernel;
            known.kernel_changed |= known.kernel != kernel;
            known.kernel = kernel;
            known.instance = state.instance();
            known.settings = preview.settings.clone();
        }
        let uploads = extracted
            .terrains
            .get(&key)
            .map_or(&[][..], |terrain| &terrain.uploads);
        // Where the pass has to wait for its pipeline, pages may be uploaded again and again.
        let capacity = extracted.page_numbers;
        everything |= known.capacity != capacity;
        everything |= known.pending.len() + uploads.len() > capacity as usize;
        known.capacity = capacity;
        if everything {
            known.pending.clear();
            let resident = uploaded
                .pages(entity)
                .filter(|&(page, address)| state.pages().get(address) == Some(page))
                .map(|(page, address)| GpuDensityJob::new(page, address));
            known.pending.extend(resident);
        } else {
            let uploads = uploads.iter();
            let jobs = uploads.map(|upload| GpuDensityJob::new(upload.page, upload.address));
            known.pending.extend(jobs);
        }
    }
}

impl DensityBuffers {
    fn new(
        device: &RenderDevice,
        cache: &PipelineCache,
        pipelines: &TerrainPipelines,
        pages: &GpuTerrainPages,
        capacity: u32,
        generation: u64,
    ) -> Self {
        let room = u64::from(capacity);
        let kernel = buffer(
            device,
            "terrain_density_kernel",
            size_of::<GpuDensityKernel>() as u64,
            BufferUsages::UNIFORM,
        );
        let jobs = buffer(
            device,
            "terrain_density_jobs",
            room * size_of::<GpuDensityJob>() as u64,
            BufferUsages::STORAGE,
        );
        let densities = buffer(
            device,
            "terrain_density_preview_pages",
            room * GpuDensityKernel::PAGE_BYTES,
            BufferUsages::STORAGE | BufferUsages::COPY_SRC,
        );
        let group = Self::bind(device, cache, pipelines, pages, &kernel, &jobs, &densities);
        Self {
            capacity,
            kernel,
            jobs,
            densities,
            group,
            group_built_for: pages.generation,
            generation,
        }
    }

    fn bind(
        device: &RenderDevice,
        cache: &PipelineCache,
        pipelines: &TerrainPipelines,
        pages: &GpuTerrainPages,
        kernel: &Buffer,
        jobs: &Buffer,
        densities: &Buffer,
    ) -> BindGroup {
        device.create_bind_group(
            "terrain_density_bind_group",
            &cache.get_bind_group_layout(&pipelines.density_layout),
            &BindGroupEntries::sequential((
                kernel.as_entire_binding(),
                jobs.as_entire_binding(),
                &pages.heights.view,
                densities.as_entire_binding(),
            )),
        )
    }
}

fn prepare_previews(
    mut previews: ResMut<GpuDensityPreviews>,
    pages: Res<GpuTerrainPages>,
    device: Res<RenderDevice>,
    queue: Res<RenderQueue>,
    cache: Res<PipelineCache>,
    pipelines: Res<TerrainPipelines>,
    mut generation: Local<u64>,
) {
    let _span = bevy::log::debug_span!("terrain_prepare_density_previews").entered();
    for preview in previews.previews.values_mut() {
        let kept = preview
            .gpu
            .take()
            .filter(|gpu| gpu.capacity == preview.capacity);
        let gpu = preview.gpu.insert(kept.unwrap_or_else(|| {
            *generation += 1;
            preview.kernel_changed = true;
            let capacity = preview.capacity;
            DensityBuffers::new(&device, &cache, &pipelines, &pages, capacity, *generation)
        }));
        if gpu.group_built_for != pages.generation {
            gpu.group_built_for = pages.generation;
            gpu.group = DensityBuffers::bind(
                &device,
                &cache,
                &pipelines,
                &pages,
                &gpu.kernel,
                &gpu.jobs,
                &gpu.densities,
            );
        }
        preview.is_ready = cache.get_compute_pipeline(pipelines.density).is_some();
        if !preview.is_ready || preview.pending.is_empty() {
            continue;
        }
        if std::mem::take(&mut preview.kernel_changed) {
            queue.write_buffer(&gpu.kernel, 0, bytemuck::bytes_of(&preview.kernel));
        }
        queue.write_buffer(&gpu.jobs, 0, bytemuck::cast_slice(&preview.pending));
    }
}
