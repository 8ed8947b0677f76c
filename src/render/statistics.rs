//! What became of each camera's view of each terrain: counted on the GPU, read back a frame or
//! two later without waiting for it.

use super::ComparisonCamera;
use super::gpu_types::{GpuTerrainCounters, GpuTerrainDrawArgs};
use crate::edit::TerrainEdits;
use crate::edit::mask::TerrainMask;
use crate::stream::{TerrainState, TerrainStreamer};
use crate::terrain::{TerrainCamera, TerrainCpuStage, TerrainCpuTimes};
use bevy::diagnostic::{
    Diagnostic, DiagnosticPath, Diagnostics, DiagnosticsStore, RegisterDiagnostic,
};
use bevy::ecs::entity::EntityHashMap;
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::render::RenderApp;
use bevy::render::sync_world::MainEntity;
use std::sync::{Arc, Mutex, PoisonError};

/// Figures of a camera's terrains, of the newest frame that the GPU has finished; on every
/// [`TerrainCamera`].
#[derive(Component, Clone, Debug, Default)]
pub struct TerrainStatistics {
    /// Whether triangle sizes are to be measured too. Costs a pass over all triangles.
    pub measure_triangle_sizes: bool,
    /// Whether it is to be counted too what the view would have without its density map, for
    /// [`TerrainViewStatistics::saved`]. Costs a count more than the seven of each face that are made
    /// anyway, and nothing else: what edges project to is known before densities are asked.
    pub measure_savings: bool,
    /// By terrain.
    pub terrains: EntityHashMap<TerrainViewStatistics>,
}

/// Figures of one camera's view of one terrain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TerrainViewStatistics {
    /// Faces, factors and, where they were asked for, triangle sizes and savings.
    pub counters: GpuTerrainCounters,
    /// Whether [`GpuTerrainCounters::triangle_sizes`] was filled.
    pub has_triangle_sizes: bool,
    /// Whether [`GpuTerrainCounters::plain_vertices`] and `plain_triangles` were filled.
    pub has_savings: bool,
    /// Vertices drawn.
    pub vertices: u32,
    /// Triangles drawn.
    pub triangles: u32,
    /// Vertices that the view's settings ask for, at its `width_scale`.
    pub wanted_vertices: u32,
    /// Triangles that they ask for.
    pub wanted_triangles: u32,
    /// Vertices that there was room for. It grows up to
    /// [`TerrainCamera::max_vertices`], two triangles a vertex.
    pub room_vertices: u32,
    /// Power of two by which all factors had to be brought down to fit that room; 0 where all was
    /// drawn as wanted.
    pub overflow: u32,
    /// What the triangle width (or the error allowed) was multiplied by, because the view wants more
    /// than its budget; 1 where it doesn't.
    pub width_scale: f32,
    /// Bytes of GPU memory that the view's nodes, factors, vertices and indices take, and what overlays
    /// need while any is on, free room included.
    pub gpu_bytes: u64,
}

/// What a density map spares a view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SavedByDensity {
    /// Vertices.
    pub vertices: u32,
    /// Triangles.
    pub triangles: u32,
}

/// What was asked for beside the counters that are always there.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Measured {
    pub(super) triangle_sizes: bool,
    pub(super) savings: bool,
}

impl TerrainViewStatistics {
    pub(super) const fn new(
        args: GpuTerrainDrawArgs,
        counters: GpuTerrainCounters,
        room_vertices: u32,
        width_scale: f32,
        measured: Measured,
    ) -> Self {
        Self {
            counters,
            has_triangle_sizes: measured.triangle_sizes,
            has_savings: measured.savings,
            vertices: args.vertices,
            triangles: args.triangles,
            wanted_vertices: args.wanted_vertices,
            wanted_triangles: args.wanted_triangles,
            room_vertices,
            overflow: args.scale,
            width_scale,
            gpu_bytes: 0,
        }
    }

    /// What the density map saves: how much more the same view, of the same faces at the same
    /// `width_scale`, would want with a [density](TerrainCamera::density) of 0. Counted, not
    /// estimated: it is what two frames that differ in nothing else differ by (where room is short, of
    /// what they want, not of what they draw). 0 under a policy that doesn't ask densities; `None`
    /// where nobody has asked ([`TerrainStatistics::measure_savings`]).
    #[must_use]
    pub const fn saved(&self) -> Option<SavedByDensity> {
        if !self.has_savings {
            return None;
        }
        Some(SavedByDensity {
            vertices: self
                .counters
                .plain_vertices
                .saturating_sub(self.wanted_vertices),
            triangles: self
                .counters
                .plain_triangles
                .saturating_sub(self.wanted_triangles),
        })
    }
}

/// GPU memory that terrains take, of all cameras and terrains together; a resource. Previews of
/// densities, materials and what Bevy itself takes for views aren't in it.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TerrainGpuMemory {
    /// Bytes of all pages' textures, free pages included.
    pub pages_bytes: u64,
    /// Bytes of the views' nodes, factors, vertices and indices, free room included, and what overlays
    /// need while any is on, with the copy of the densities that they share.
    pub meshes_bytes: u64,
    /// Bytes of page tables, residency fields and destruction masks.
    pub tables_bytes: u64,
}

impl TerrainGpuMemory {
    /// Bytes of all of it.
    #[must_use]
    pub const fn total_bytes(&self) -> u64 {
        self.pages_bytes + self.meshes_bytes + self.tables_bytes
    }
}

/// The terrains' entries in Bevy's diagnostics, each summed over all cameras and terrains where it
/// says nothing else. The second camera of a [`TerrainComparison`](super::TerrainComparison) counts in
/// memory alone. An entry that is measured only while somebody asks has no value otherwise.
#[derive(Clone, Copy, Debug)]
pub struct TerrainDiagnostics;

impl TerrainDiagnostics {
    /// Faces drawn.
    pub const FACES: DiagnosticPath = DiagnosticPath::const_new("terrain/faces");
    /// Faces of the views' nodes that nobody sees, which are left out.
    pub const CULLED_FACES: DiagnosticPath = DiagnosticPath::const_new("terrain/culled_faces");
    /// Vertices drawn.
    pub const VERTICES: DiagnosticPath = DiagnosticPath::const_new("terrain/vertices");
    /// Triangles drawn.
    pub const TRIANGLES: DiagnosticPath = DiagnosticPath::const_new("terrain/triangles");
    /// Vertices that the density maps save, in the views that have them counted
    /// ([`TerrainStatistics::measure_savings`]); no entry is added while none has.
    pub const SAVED_VERTICES: DiagnosticPath = DiagnosticPath::const_new("terrain/saved_vertices");
    /// Triangles that they save.
    pub const SAVED_TRIANGLES: DiagnosticPath =
        DiagnosticPath::const_new("terrain/saved_triangles");
    /// Views whose factors were brought down because a buffer was too small.
    pub const OVERFLOWS: DiagnosticPath = DiagnosticPath::const_new("terrain/overflows");
    /// The largest widening of triangles because of a budget; 1 where none is reached.
    pub const WIDTH_SCALE: DiagnosticPath = DiagnosticPath::const_new("terrain/width_scale");
    /// Pages in use.
    pub const PAGES: DiagnosticPath = DiagnosticPath::const_new("terrain/pages");
    /// Tiles that were asked for and have no page yet.
    pub const TILES_LOADING: DiagnosticPath = DiagnosticPath::const_new("terrain/tiles_loading");
    /// Tiles that are missing or corrupt and haven't been read since.
    pub const TILES_FAILED: DiagnosticPath = DiagnosticPath::const_new("terrain/tiles_failed");
    /// How many levels short of what the views ask for the ground is, where it is worst.
    pub const LEVELS_SHORT: DiagnosticPath = DiagnosticPath::const_new("terrain/levels_short");
    /// GPU memory of pages in MiB, free ones included; see [`TerrainGpuMemory`].
    pub const PAGE_MEMORY: DiagnosticPath = DiagnosticPath::const_new("terrain/page_memory");
    /// GPU memory of the views' meshes in MiB, free room included.
    pub const MESH_MEMORY: DiagnosticPath = DiagnosticPath::const_new("terrain/mesh_memory");
    /// GPU memory of page tables, residency fields and destruction masks in MiB.
    pub const TABLE_MEMORY: DiagnosticPath = DiagnosticPath::const_new("terrain/table_memory");
    /// Active edits in the logs.
    pub const EDITS: DiagnosticPath = DiagnosticPath::const_new("terrain/edits");
    /// Main memory of the destruction masks in MiB.
    pub const MASK_MEMORY: DiagnosticPath = DiagnosticPath::const_new("terrain/mask_memory");
    /// CPU time of [`TerrainCpuStage::View`] in ms. No entry of the four is added while
    /// [`TerrainCpuTimes`] measures nothing.
    pub const VIEW_CPU: DiagnosticPath = DiagnosticPath::const_new("terrain/view_cpu");
    /// CPU time of [`TerrainCpuStage::Stream`] in ms.
    pub const STREAM_CPU: DiagnosticPath = DiagnosticPath::const_new("terrain/stream_cpu");
    /// CPU time of [`TerrainCpuStage::Cull`] in ms.
    pub const CULL_CPU: DiagnosticPath = DiagnosticPath::const_new("terrain/cull_cpu");
    /// CPU time of [`TerrainCpuStage::Extract`] in ms.
    pub const EXTRACT_CPU: DiagnosticPath = DiagnosticPath::const_new("terrain/extract_cpu");

    /// All of them, each with its unit (empty for counts).
    const ALL: [(DiagnosticPath, &'static str); 21] = [
        (Self::FACES, ""),
        (Self::CULLED_FACES, ""),
        (Self::VERTICES, ""),
        (Self::TRIANGLES, ""),
        (Self::SAVED_VERTICES, ""),
        (Self::SAVED_TRIANGLES, ""),
        (Self::OVERFLOWS, ""),
        (Self::WIDTH_SCALE, ""),
        (Self::PAGES, ""),
        (Self::TILES_LOADING, ""),
        (Self::TILES_FAILED, ""),
        (Self::LEVELS_SHORT, ""),
        (Self::PAGE_MEMORY, "MiB"),
        (Self::MESH_MEMORY, "MiB"),
        (Self::TABLE_MEMORY, "MiB"),
        (Self::EDITS, ""),
        (Self::MASK_MEMORY, "MiB"),
        (Self::VIEW_CPU, "ms"),
        (Self::STREAM_CPU, "ms"),
        (Self::CULL_CPU, "ms"),
        (Self::EXTRACT_CPU, "ms"),
    ];

    /// The entry of a stage's CPU time.
    #[must_use]
    pub const fn of_stage(stage: TerrainCpuStage) -> DiagnosticPath {
        match stage {
            TerrainCpuStage::View => Self::VIEW_CPU,
            TerrainCpuStage::Stream => Self::STREAM_CPU,
            TerrainCpuStage::Cull => Self::CULL_CPU,
            TerrainCpuStage::Extract => Self::EXTRACT_CPU,
        }
    }
}

/// What the render world tells of its newest frames.
#[derive(Default)]
pub(super) struct Shared {
    pub(super) views: HashMap<(MainEntity, MainEntity), TerrainViewStatistics>,
    pub(super) memory: TerrainGpuMemory,
}

/// What the render world has read last; a copy of the handle in either world.
#[derive(Resource, Clone, Default)]
pub(super) struct SharedStatistics(Arc<Mutex<Shared>>);

impl SharedStatistics {
    pub(super) fn with<R>(&self, read: impl FnOnce(&mut Shared) -> R) -> R {
        read(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

/// Statistics. Part of [`TerrainRenderPlugin`](super::TerrainRenderPlugin).
pub(super) struct StatisticsPlugin;

impl Plugin for StatisticsPlugin {
    fn build(&self, app: &mut App) {
        let shared = SharedStatistics::default();
        for (path, unit) in TerrainDiagnostics::ALL {
            app.register_diagnostic(Diagnostic::new(path).with_suffix(unit));
        }
        app.register_required_components::<TerrainCamera, TerrainStatistics>()
            .init_resource::<TerrainGpuMemory>()
            .insert_resource(shared.clone())
            .add_systems(
                First,
                (
                    publish,
                    publish_streaming,
                    forget.after(publish).after(publish_streaming),
                ),
            );
        if let Some(render_app) = app.get_sub_app_mut(RenderApp) {
            render_app.insert_resource(shared);
        }
    }
}

const MIB: f64 = (1 << 20) as f64;

/// What the GPU counted, and what it holds.
fn publish(
    shared: Res<SharedStatistics>,
    mut cameras: Query<(&mut TerrainStatistics, Has<ComparisonCamera>)>,
    mut memory: ResMut<TerrainGpuMemory>,
    mut diagnostics: Diagnostics,
) {
    for (mut statistics, _) in &mut cameras {
        statistics.bypass_change_detection().terrains.clear();
    }
    let (mut faces, mut culled, mut vertices, mut triangles) = (0.0, 0.0, 0.0, 0.0);
    let (mut overflows, mut width_scale) = (0.0, 1.0_f64);
    let mut saved: Option<[f64; 2]> = None;
    shared.with(|shared| {
        memory.set_if_neq(shared.memory);
        for ((camera, terrain), view) in &shared.views {
            let Ok((mut statistics, is_comparison)) = cameras.get_mut(camera.id()) else {
                continue;
            };
            statistics.terrains.insert(terrain.id(), *view);
            if is_comparison {
                continue;
            }
            faces += f64::from(view.counters.faces);
            culled += f64::from(view.counters.culled_faces);
            vertices += f64::from(view.vertices);
            triangles += f64::from(view.triangles);
            overflows += f64::from(u8::from(view.overflow > 0));
            width_scale = width_scale.max(f64::from(view.width_scale));
            if let Some(view) = view.saved() {
                let [vertices, triangles] = saved.get_or_insert_default();
                *vertices += f64::from(view.vertices);
                *triangles += f64::from(view.triangles);
            }
        }
    });
    diagnostics.add_measurement(&TerrainDiagnostics::FACES, || faces);
    diagnostics.add_measurement(&TerrainDiagnostics::CULLED_FACES, || culled);
    diagnostics.add_measurement(&TerrainDiagnostics::VERTICES, || vertices);
    diagnostics.add_measurement(&TerrainDiagnostics::TRIANGLES, || triangles);
    if let Some([vertices, triangles]) = saved {
        diagnostics.add_measurement(&TerrainDiagnostics::SAVED_VERTICES, || vertices);
        diagnostics.add_measurement(&TerrainDiagnostics::SAVED_TRIANGLES, || triangles);
    }
    diagnostics.add_measurement(&TerrainDiagnostics::OVERFLOWS, || overflows);
    diagnostics.add_measurement(&TerrainDiagnostics::WIDTH_SCALE, || width_scale);
    let mib = |bytes: u64| bytes as f64 / MIB;
    let TerrainGpuMemory {
        pages_bytes,
        meshes_bytes,
        tables_bytes,
    } = *memory;
    diagnostics.add_measurement(&TerrainDiagnostics::PAGE_MEMORY, || mib(pages_bytes));
    diagnostics.add_measurement(&TerrainDiagnostics::MESH_MEMORY, || mib(meshes_bytes));
    diagnostics.add_measurement(&TerrainDiagnostics::TABLE_MEMORY, || mib(tables_bytes));
}

/// What the main world knows: streaming, edits, CPU times.
fn publish_streaming(
    terrains: Query<(&TerrainState, &TerrainEdits, Option<&TerrainMask>)>,
    streamer: Res<TerrainStreamer>,
    times: Res<TerrainCpuTimes>,
    mut diagnostics: Diagnostics,
) {
    let (mut short, mut failed, mut edits, mut mask_bytes) = (0, 0, 0, 0);
    for (state, log, mask) in &terrains {
        short = short.max(state.levels_short());
        failed += state.failed_count();
        edits += log.log().map_or(0, |log| log.active_count());
        mask_bytes += mask.map_or(0, |mask| mask.mask().bytes());
    }
    let (pages, loading) = (streamer.pages_used(), streamer.tiles_loading());
    diagnostics.add_measurement(&TerrainDiagnostics::PAGES, || pages.into());
    diagnostics.add_measurement(&TerrainDiagnostics::TILES_LOADING, || loading as f64);
    diagnostics.add_measurement(&TerrainDiagnostics::TILES_FAILED, || failed as f64);
    diagnostics.add_measurement(&TerrainDiagnostics::LEVELS_SHORT, || short.into());
    diagnostics.add_measurement(&TerrainDiagnostics::EDITS, || edits as f64);
    let mask_mib = mask_bytes as f64 / MIB;
    diagnostics.add_measurement(&TerrainDiagnostics::MASK_MEMORY, || mask_mib);
    if times.is_measured() {
        for stage in TerrainCpuStage::ALL {
            let ms = 1e3 * times.of(stage).as_secs_f64();
            diagnostics.add_measurement(&TerrainDiagnostics::of_stage(stage), || ms);
        }
    }
}

/// Empties the entries of what isn't measured any more, which would keep their last values for ever.
fn forget(
    cameras: Query<&TerrainStatistics, Without<ComparisonCamera>>,
    times: Res<TerrainCpuTimes>,
    store: Option<ResMut<DiagnosticsStore>>,
    mut had: Local<[bool; 2]>,
) {
    let mut views = cameras.iter().flat_map(|camera| camera.terrains.values());
    let has = [views.any(|view| view.has_savings), times.is_measured()];
    let [lost_savings, lost_times] = [0, 1].map(|which| had[which] && !has[which]);
    *had = has;
    let Some(mut store) = store.filter(|_| lost_savings || lost_times) else {
        return;
    };
    let mut clear = |path: &DiagnosticPath| {
        if let Some(diagnostic) = store.get_mut(path) {
            diagnostic.clear_history();
        }
    };
    if lost_savings {
        clear(&TerrainDiagnostics::SAVED_VERTICES);
        clear(&TerrainDiagnostics::SAVED_TRIANGLES);
    }
    if lost_times {
        for stage in TerrainCpuStage::ALL {
            clear(&TerrainDiagnostics::of_stage(stage));
        }
    }
}
