//! What the render world is told each frame.

use super::TerrainMaterial;
use super::comparison::ComparisonCamera;
use super::cull::{NodeCulling, TerrainNodes};
use super::gpu_types::{GpuTerrainDraw, GpuTerrainNode, GpuTerrainView};
use super::mask::{KnownMask, MaskChange};
use super::material::ComposedMaterials;
use super::overlay::{ExtractedOverlays, TerrainOverlays};
use super::page_part::PagePart;
use super::statistics::TerrainStatistics;
use crate::detail::DetailKernel;
use crate::edit::mask::TerrainMask;
use crate::stream::{TerrainState, TerrainStreamer};
use crate::terrain::{TerrainCamera, TerrainCpuStage, TerrainCpuTimes, TessellationPolicy};
use crate::tessellate::{FactorView, Partitioning};
use crate::tile::{TerrainTile, TileAddress};
use crate::view::{TerrainView, TerrainViews};
use bevy::ecs::entity::EntityHashMap;
use bevy::math::{DAffine3, DVec3, Mat4};
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::Extract;
use bevy::render::sync_world::MainEntity;
use bevy::shader::Shader;
use bytemuck::Zeroable;
use std::ops::Range;

/// A tile whose page has to be written, whole or in part.
pub(super) struct PageUpload {
    pub(super) page: u32,
    pub(super) address: TileAddress,
    pub(super) data: PageData,
}

pub(super) enum PageData {
    Whole(TerrainTile),
    Part(PagePart),
}

/// A run of a table's entries.
pub(super) struct TableChange {
    pub(super) first: u32,
    pub(super) words: Vec<u32>,
}

impl TableChange {
    /// What has to be written to a copy: the entries in `changes`, or all `length` of them where
    /// those aren't known.
    fn of(
        length: usize,
        changes: Option<impl Iterator<Item = Range<u32>>>,
        words: impl Fn(Range<usize>) -> Vec<u32>,
    ) -> Vec<Self> {
        let Some(changes) = changes else {
            return vec![Self {
                first: 0,
                words: words(0..length),
            }];
        };
        let runs = changes.map(|range| Self {
            first: range.start,
            words: words(range.start as usize..range.end as usize),
        });
        runs.collect()
    }
}

/// A terrain as it is in this frame.
pub(super) struct ExtractedTerrain {
    /// Metres per stored unit over twice the finest spacing: a gradient per difference.
    pub(super) gradient_scale: f32,
    pub(super) uploads: Vec<PageUpload>,
    /// What has changed of the tables.
    pub(super) page_table: Vec<TableChange>,
    pub(super) field: Vec<TableChange>,
    pub(super) mask: MaskChange,
    pub(super) shader: Option<Handle<Shader>>,
    pub(super) parameters: [Vec4; 8],
    pub(super) detail: DetailKernel,
}

/// A camera's view of a terrain in this frame.
pub(super) struct ExtractedView {
    pub(super) camera: MainEntity,
    pub(super) terrain: MainEntity,
    pub(super) view: GpuTerrainView,
    pub(super) draw: GpuTerrainDraw,
    pub(super) nodes: Vec<GpuTerrainNode>,
    pub(super) partitioning: Partitioning,
    pub(super) max_vertices: u32,
    pub(super) measure_triangle_sizes: bool,
    /// Overlays, where any is on.
    pub(super) overlays: Option<ExtractedOverlays>,
    pub(super) measure_savings: bool,
    /// Whether the camera is the second one of a comparison.
    pub(super) compares: bool,
}

/// Everything extracted in this frame.
#[derive(Resource, Default)]
pub(super) struct ExtractedTerrains {
    pub(super) terrains: HashMap<MainEntity, ExtractedTerrain>,
    pub(super) views: Vec<ExtractedView>,
    /// One more than the greatest page that is in use.
    pub(super) pages_in_use: u32,
    /// One more than the greatest page that may come into use.
    pub(super) page_numbers: u32,
    /// Lists of nodes to be filled again.
    spare_nodes: Vec<Vec<GpuTerrainNode>>,
}

/// What the GPU's copies are copies of. Made anew with the device, so that a recovered one is
/// told everything again.
#[derive(Resource, Default)]
pub(super) struct UploadedTerrains {
    terrains: EntityHashMap<Uploaded>,
    /// What each page holds.
    pages: Vec<Option<PageContent>>,
}

impl UploadedTerrains {
    /// The pages that were last written with a tile of this terrain, resident or not any more.
    pub(super) fn pages(&self, terrain: Entity) -> impl Iterator<Item = (u32, TileAddress)> {
        let pages = (0..).zip(&self.pages);
        let written = pages.filter_map(|(page, content)| Some((page, content.as_ref()?)));
        written
            .filter(move |(_, content)| content.terrain == terrain)
            .map(|(page, content)| (page, content.address))
    }
}

/// What a page was written with.
#[derive(Clone, Copy, PartialEq, Eq)]
struct PageContent {
    terrain: Entity,
    address: TileAddress,
    /// Tells it from all else that any page has held.
    content: u64,
}

#[derive(Default)]
struct Uploaded {
    /// The state that this is a copy of: two insertions of the component differ in their tables.
    instance: Option<u64>,
    pages_version: u64,
    field_version: u64,
    mask: KnownMask,
    world_from_local: Option<DAffine3>,
}

#[expect(clippy::type_complexity, reason = "parameters of a Bevy system")]
pub(super) fn extract_terrains(
    terrains: Extract<
        Query<(
            Entity,
            &TerrainState,
            Option<&TerrainMaterial>,
            Option<&TerrainMask>,
        )>,
    >,
    streamer: Extract<Res<TerrainStreamer>>,
    cameras: Extract<
        Query<(
            Entity,
            &Camera,
            &TerrainCamera,
            &TerrainViews,
            &TerrainNodes,
            &TerrainStatistics,
            Option<&TerrainOverlays>,
            Has<ComparisonCamera>,
        )>,
    >,
    materials: Extract<Res<ComposedMaterials>>,
    times: Extract<Res<TerrainCpuTimes>>,
    mut extracted: ResMut<ExtractedTerrains>,
    mut uploaded: ResMut<UploadedTerrains>,
) {
    let _span = bevy::log::debug_span!("terrain_extract").entered();
    let _time = times.measure(TerrainCpuStage::Extract);
    let ExtractedTerrains {
        terrains: out,
        views: views_out,
        pages_in_use,
        page_numbers,
        spare_nodes,
    } = &mut *extracted;
    *pages_in_use = 0;
    *page_numbers = streamer.page_numbers();
    out.clear();
    spare_nodes.extend(views_out.drain(..).map(|view| view.nodes));
    let UploadedTerrains {
        terrains: uploaded,
        pages: written,
    } = &mut *uploaded;
    uploaded.retain(|terrain, _| terrains.contains(*terrain));

    for (entity, state, material, mask) in &terrains {
        let known = uploaded.entry(entity).or_default();
        let is_new = known.instance != Some(state.instance());
        if is_new {
            *known = Uploaded {
                instance: Some(state.instance()),
                world_from_local: known.world_from_local,
                ..default()
            };
        }
        let mut uploads = Vec::new();
        let pages_changed = known.pages_version != state.pages_version();
        for (page, address, content, tile) in state.contents() {
            *pages_in_use = (*pages_in_use).max(page + 1);
            if !pages_changed {
                continue;
            }
            let content = Some(PageContent {
                terrain: entity,
                address,
                content,
            });
            if written.len() <= page as usize {
                written.resize(page as usize + 1, None);
            }
            let written = &mut written[page as usize];
            if *written == content {
                continue;
            }
            // Only what has changed, where the page holds what this tile was before.
            let before = written
                .filter(|before| before.terrain == entity && before.address == address)
                .and_then(|before| state.dirt_since(page, before.content));
            *written = content;
            uploads.push(PageUpload {
                page,
                address,
                data: before.map_or_else(
                    || PageData::Whole(tile.clone()),
                    |dirt| PageData::Part(PagePart::new(tile, &dirt)),
                ),
            });
        }
        let mut page_table = Vec::new();
        if pages_changed {
            let flat = state.pages().flat();
            let changes = state.page_changes(known.pages_version);
            page_table = TableChange::of(flat.len(), changes, |range| flat[range].to_vec());
            known.pages_version = state.pages_version();
        }
        let mut field = Vec::new();
        if known.field_version != state.field_version() {
            let corners = &state.field().corners;
            let changes = state.field_changes(known.field_version);
            field = TableChange::of(corners.len(), changes, |range| {
                corners[range].iter().copied().map(u32::from).collect()
            });
            known.field_version = state.field_version();
        }
        let file = &state.manifest().file;
        let fallback = TerrainMaterial::default();
        let material = material.unwrap_or(&fallback);
        out.insert(
            entity.into(),
            ExtractedTerrain {
                gradient_scale: (file.height_step_m / (2.0 * file.spacing_m)) as f32,
                uploads,
                page_table,
                field,
                mask: MaskChange::since(mask, &mut known.mask, is_new),
                shader: materials.shader(material),
                parameters: material.parameters,
                detail: *state.detail(),
            },
        );
    }

    for (entity, camera, settings, views, drawn, statistics, overlays, compares) in &cameras {
        let settings = settings.checked(|_| ());
        for view in &views.views {
            let Ok((_, state, ..)) = terrains.get(view.terrain) else {
                continue;
            };
            let Some(nodes) = drawn
                .nodes
                .get(&view.terrain)
                .filter(|nodes| !nodes.is_empty())
            else {
                continue;
            };
            let Some(factors) = factor_view(camera, &settings, view, state) else {
                continue;
            };
            let previous = uploaded
                .get(&view.terrain)
                .and_then(|known| known.world_from_local)
                .unwrap_or(view.world_from_local);
            let mut gpu_view =
                GpuTerrainView::new(&view.lattice, &view.lod, &factors, settings.partitioning);
            gpu_view.node_count = nodes.len() as u32;
            gpu_view.height_min_m = state.manifest().file.height_min_m as f32;
            gpu_view.height_step_m = state.manifest().file.height_step_m as f32;
            gpu_view.field_cell_shift = state.field().cell_log2;
            gpu_view.field_cells = state.field().cells.to_array();
            for level in 0..state.pages().levels() {
                let [across, down] = state.pages().tiles(level);
                gpu_view.tiles[usize::from(level)] =
                    [state.pages().level_offset(level), across, down, 0];
            }
            let draw = terrain_draw(view, state, &factors, &previous, &gpu_view);
            let mut gpu_nodes = spare_nodes.pop().unwrap_or_default();
            gpu_nodes.clear();
            let culling = drawn.culling.get(&view.terrain);
            // Somebody else's nodes have no heights, and then no face is culled.
            if let Some(NodeCulling { heights_m, volumes }) =
                culling.filter(|culling| culling.heights_m.len() == nodes.len())
            {
                gpu_view.set_volumes(volumes);
                let nodes = nodes.iter().zip(heights_m);
                gpu_nodes.extend(nodes.map(|(node, heights)| GpuTerrainNode::new(*node, *heights)));
            } else {
                gpu_nodes.extend(
                    nodes
                        .iter()
                        .map(|node| GpuTerrainNode::new(*node, [0.0; 2])),
                );
            }
            let overlays = overlays
                .filter(|overlays| overlays.is_on())
                .map(|overlays| ExtractedOverlays::new(overlays, &gpu_view));
            views_out.push(ExtractedView {
                camera: entity.into(),
                terrain: view.terrain.into(),
                view: gpu_view,
                draw,
                nodes: gpu_nodes,
                partitioning: settings.partitioning,
                max_vertices: settings.max_vertices,
                measure_triangle_sizes: statistics.measure_triangle_sizes,
                overlays,
                measure_savings: statistics.measure_savings,
                compares,
            });
        }
    }
    // After the views: they need the transform of the frame before.
    for (_, _, _, views, ..) in &cameras {
        for view in &views.views {
            if let Some(known) = uploaded.get_mut(&view.terrain) {
                known.world_from_local = Some(view.world_from_local);
            }
        }
    }
}

/// What a camera's edge factors follow from; `None` where it has no viewport yet.
#[must_use]
pub fn factor_view(
    camera: &Camera,
    settings: &TerrainCamera,
    view: &TerrainView,
    state: &TerrainState,
) -> Option<FactorView> {
    camera.physical_viewport_size()?;
    // A view takes what isn't a perspective for parallel.
    let (focal_px, px_per_m) = (view.focal_px, view.px_per_m);
    let file = &state.manifest().file;
    let spacing_m = file.spacing_m;
    let max_error_px = match settings.policy {
        TessellationPolicy::TriangleWidth => 0.0,
        TessellationPolicy::ScreenError { max_px } => max_px,
    };
    // There is nothing to be seen between the finest samples, but for detail's four vertices a wave;
    // and an error is to be kept whatever that takes.
    let finest_m = if max_error_px > 0.0 {
        f32::MIN_POSITIVE
    } else {
        state
            .detail()
            .finest_wavelength_m()
            .map_or(spacing_m as f32, |wave_m| {
                (0.25 * wave_m).min(spacing_m as f32)
            })
    };
    Some(FactorView {
        eye: view.lod.eye,
        eye_fraction: view.eye_fraction,
        eye_height_m: view.eye_height_m,
        unit_m: state.lattice().unit_m(spacing_m) as f32,
        segments_per_radian: focal_px / settings.triangle_width_px,
        segments_per_m: px_per_m / settings.triangle_width_px,
        min_triangle_m: settings.min_triangle_m.unwrap_or(finest_m),
        max_factor: settings.max_factor,
        density_strength: settings.density,
        focal_px,
        px_per_m,
        max_error_px,
        error_units_per_m: file.error_units_per_m() as f32,
    })
}

fn terrain_draw(
    view: &TerrainView,
    state: &TerrainState,
    factors: &FactorView,
    previous: &DAffine3,
    gpu_view: &GpuTerrainView,
) -> GpuTerrainDraw {
    // The mesh is relative to the eye's lattice point, which stands still where the eye flies far
    // off the terrain. Elsewhere the eye itself is taken: it rounds to Bevy's own view position.
    let unit_m = state.lattice().unit_m(state.manifest().file.spacing_m);
    let on_lattice = (view.lod.eye.as_dvec2() + view.eye_fraction.as_dvec2()) * unit_m;
    let eye_m = if (on_lattice - bevy::math::DVec2::new(view.eye_m.x, view.eye_m.z))
        .abs()
        .max_element()
        < unit_m
    {
        view.eye_m
    } else {
        DVec3::new(on_lattice.x, view.eye_m.y, on_lattice.y)
    };
    let from_eye = |affine: &DAffine3| {
        // The eye is brought to its place in double precision; what is added to it is small.
        let eye = affine.transform_point3(eye_m).as_vec3();
        Mat4::from_cols(
            affine.matrix3.x_axis.as_vec3().extend(0.0),
            affine.matrix3.y_axis.as_vec3().extend(0.0),
            affine.matrix3.z_axis.as_vec3().extend(0.0),
            eye.extend(1.0),
        )
        .to_cols_array_2d()
    };
    let unit_log2 = state.lattice().unit_log2;
    let sample = view.lod.eye >> IVec2::splat(unit_log2.cast_signed());
    let rest = view.lod.eye - (sample << IVec2::splat(unit_log2.cast_signed()));
    let fraction = (rest.as_vec2() + view.eye_fraction) / (1_u32 << unit_log2) as f32;
    GpuTerrainDraw {
        world_from_eye: from_eye(&view.world_from_local),
        previous_world_from_eye: from_eye(previous),
        eye_point: view.lod.eye.to_array(),
        eye_fraction: view.eye_fraction.to_array(),
        eye_sample: sample.to_array(),
        eye_sample_fraction: fraction.to_array(),
        eye_local_m: [eye_m.x as f32, eye_m.z as f32],
        eye_height_m: view.eye_height_m,
        unit_m: factors.unit_m,
        spacing_m: state.manifest().file.spacing_m as f32,
        root_level: state.lattice().root_level,
        tiles: gpu_view.tiles,
        ..GpuTerrainDraw::zeroed()
    }
}
