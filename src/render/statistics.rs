//! What became of each camera's view of each terrain: counted on the GPU, read back a frame or
//! two later without waiting for it.

use super::gpu_types::{GpuTerrainCounters, GpuTerrainDrawArgs};
use crate::stream::{TerrainState, TerrainStreamer};
use crate::terrain::TerrainCamera;
use bevy::diagnostic::{Diagnostic, DiagnosticPath, Diagnostics, RegisterDiagnostic};
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
    /// By terrain.
    pub terrains: EntityHashMap<TerrainViewStatistics>,
}

/// Figures of one camera's view of one terrain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TerrainViewStatistics {
    /// Faces, factors and, where they were asked for, triangle sizes.
    pub counters: GpuTerrainCounters,
    /// Whether [`GpuTerrainCounters::triangle_sizes`] was filled.
    pub has_triangle_sizes: bool,
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
}

impl TerrainViewStatistics {
    pub(super) const fn new(
        args: GpuTerrainDrawArgs,
        counters: GpuTerrainCounters,
        room_vertices: u32,
        width_scale: f32,
        has_triangle_sizes: bool,
    ) -> Self {
        Self {
            counters,
            has_triangle_sizes,
            vertices: args.vertices,
            triangles: args.triangles,
            wanted_vertices: args.wanted_vertices,
            wanted_triangles: args.wanted_triangles,
            room_vertices,
            overflow: args.scale,
            width_scale,
        }
    }
}

/// The terrains' entries in Bevy's diagnostics, each summed over all cameras and terrains.
#[derive(Clone, Copy, Debug)]
pub struct TerrainDiagnostics;

impl TerrainDiagnostics {
    /// Faces drawn.
    pub const FACES: DiagnosticPath = DiagnosticPath::const_new("terrain/faces");
    /// Vertices drawn.
    pub const VERTICES: DiagnosticPath = DiagnosticPath::const_new("terrain/vertices");
    /// Triangles drawn.
    pub const TRIANGLES: DiagnosticPath = DiagnosticPath::const_new("terrain/triangles");
    /// Views whose factors were brought down because a buffer was too small.
    pub const OVERFLOWS: DiagnosticPath = DiagnosticPath::const_new("terrain/overflows");
    /// The largest widening of triangles because of a budget; 1 where none is reached.
    pub const WIDTH_SCALE: DiagnosticPath = DiagnosticPath::const_new("terrain/width_scale");
    /// Pages in use.
    pub const PAGES: DiagnosticPath = DiagnosticPath::const_new("terrain/pages");
    /// Tiles that were asked for and have no page yet.
    pub const TILES_LOADING: DiagnosticPath = DiagnosticPath::const_new("terrain/tiles_loading");
    /// How many levels short of what the views ask for the ground is, where it is worst.
    pub const LEVELS_SHORT: DiagnosticPath = DiagnosticPath::const_new("terrain/levels_short");
}

type Shared = HashMap<(MainEntity, MainEntity), TerrainViewStatistics>;

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
        app.register_required_components::<TerrainCamera, TerrainStatistics>()
            .register_diagnostic(Diagnostic::new(TerrainDiagnostics::FACES))
            .register_diagnostic(Diagnostic::new(TerrainDiagnostics::VERTICES))
            .register_diagnostic(Diagnostic::new(TerrainDiagnostics::TRIANGLES))
            .register_diagnostic(Diagnostic::new(TerrainDiagnostics::OVERFLOWS))
            .register_diagnostic(Diagnostic::new(TerrainDiagnostics::WIDTH_SCALE))
            .register_diagnostic(Diagnostic::new(TerrainDiagnostics::PAGES))
            .register_diagnostic(Diagnostic::new(TerrainDiagnostics::TILES_LOADING))
            .register_diagnostic(Diagnostic::new(TerrainDiagnostics::LEVELS_SHORT))
            .insert_resource(shared.clone())
            .add_systems(First, publish);
        if let Some(render_app) = app.get_sub_app_mut(RenderApp) {
            render_app.insert_resource(shared);
        }
    }
}

fn publish(
    shared: Res<SharedStatistics>,
    mut cameras: Query<(Entity, &mut TerrainStatistics)>,
    terrains: Query<&TerrainState>,
    streamer: Res<TerrainStreamer>,
    mut diagnostics: Diagnostics,
) {
    let short = terrains.iter().map(TerrainState::levels_short).max();
    let (pages, loading) = (streamer.pages_used(), streamer.tiles_loading());
    diagnostics.add_measurement(&TerrainDiagnostics::PAGES, || pages.into());
    diagnostics.add_measurement(&TerrainDiagnostics::TILES_LOADING, || loading as f64);
    let short = short.unwrap_or(0);
    diagnostics.add_measurement(&TerrainDiagnostics::LEVELS_SHORT, || short.into());
    for (_, mut statistics) in &mut cameras {
        statistics.bypass_change_detection().terrains.clear();
    }
    let (mut faces, mut vertices, mut triangles) = (0.0, 0.0, 0.0);
    let (mut overflows, mut width_scale) = (0.0, 1.0_f64);
    shared.with(|shared| {
        for ((camera, terrain), view) in shared.iter() {
            let Ok((_, mut statistics)) = cameras.get_mut(camera.id()) else {
                continue;
            };
            statistics.terrains.insert(terrain.id(), *view);
            faces += f64::from(view.counters.faces);
            vertices += f64::from(view.vertices);
            triangles += f64::from(view.triangles);
            overflows += f64::from(u8::from(view.overflow > 0));
            width_scale = width_scale.max(f64::from(view.width_scale));
        }
    });
    diagnostics.add_measurement(&TerrainDiagnostics::FACES, || faces);
    diagnostics.add_measurement(&TerrainDiagnostics::VERTICES, || vertices);
    diagnostics.add_measurement(&TerrainDiagnostics::TRIANGLES, || triangles);
    diagnostics.add_measurement(&TerrainDiagnostics::OVERFLOWS, || overflows);
    diagnostics.add_measurement(&TerrainDiagnostics::WIDTH_SCALE, || width_scale);
}
