//! `terrain.stats`: what terrains do just now.

use super::figures::{
    TerrainCameraStats, TerrainDiagnosticStats, TerrainDrawnStats, TerrainStats,
    TerrainStreamingStats, TerrainViewStats, TerrainWorldStats,
};
use super::{TERRAIN_STATS_METHOD, TERRAIN_STATS_WATCH_METHOD, TerrainRemoteError};
use crate::edit::{EditOp, EditRecord, TerrainEdits};
#[cfg(feature = "render")]
use crate::render::{ComparisonCamera, TerrainStatistics};
use crate::stream::{PAGE_BYTES, PageTable, TerrainState, TerrainStreamer, TerrainStreaming};
use crate::terrain::{Terrain, TerrainCamera, TerrainSettings};
use crate::tile::tile_path;
use crate::view::TerrainViews;
use bevy::diagnostic::{Diagnostic, DiagnosticsStore};
use bevy::ecs::reflect::AppTypeRegistry;
use bevy::ecs::system::SystemParam;
use bevy::prelude::*;
use bevy::reflect::serde::TypedReflectSerializer;
use bevy::reflect::{GetTypeRegistration, TypeRegistry};
use bevy::remote::{BrpError, BrpResult};
use bevy::time::Real;
use serde::Deserialize;
use serde_json::Value;
use std::ops::RangeInclusive;

/// How many failed tiles an answer names.
const FAILED_NAMED: usize = 16;
/// Seconds between two answers of a stream.
const EVERY_S: RangeInclusive<f64> = 0.05..=3600.0;

/// The method that answers once.
pub(super) fn stats(In(parameters): In<Option<Value>>, sources: Sources) -> BrpResult {
    let is_empty = match &parameters {
        None | Some(Value::Null) => true,
        Some(Value::Object(fields)) => fields.is_empty(),
        Some(Value::Array(list)) => list.is_empty(),
        Some(_) => false,
    };
    if !is_empty {
        return Err(TerrainRemoteError::Parameters {
            method: TERRAIN_STATS_METHOD,
            cause: "there are some".to_owned(),
            wanted: "none",
        }
        .into());
    }
    serde_json::to_value(sources.collect()).map_err(BrpError::internal)
}

/// What the method that answers again and again takes.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WatchParameters {
    #[serde(default = "one")]
    every_s: f64,
}

const fn one() -> f64 {
    1.0
}

/// The method that answers again and again.
pub(super) fn watch(
    In(parameters): In<Option<Value>>,
    time: Option<Res<Time<Real>>>,
    sources: Sources,
) -> BrpResult<Option<Value>> {
    // A request remembers nothing from frame to frame; time does.
    let is_due = |every_s: f64| {
        time.is_none_or(|time| {
            let now_s = time.elapsed_secs_f64();
            let before_s = now_s - time.delta_secs_f64();
            (now_s / every_s).floor() > (before_s / every_s).floor()
        })
    };
    let every_s = match every_s(parameters) {
        Ok(every_s) => every_s,
        // Bevy goes on asking after an error: once a second is enough of it.
        Err(error) if is_due(one()) => return Err(error.into()),
        Err(_) => return Ok(None),
    };
    if !is_due(every_s) {
        return Ok(None);
    }
    let stats = serde_json::to_value(sources.collect());
    stats.map(Some).map_err(BrpError::internal)
}

fn every_s(parameters: Option<Value>) -> Result<f64, TerrainRemoteError> {
    let unreadable = |cause: String| TerrainRemoteError::Parameters {
        method: TERRAIN_STATS_WATCH_METHOD,
        cause,
        wanted: "an object with `every_s`, 0.05 to 3600, or nothing",
    };
    let every_s = match parameters {
        None | Some(Value::Null) => one(),
        // serde would take the fields by their order.
        Some(Value::Array(_)) => return Err(unreadable("they are a list".to_owned())),
        Some(parameters) => {
            let read: Result<WatchParameters, _> = serde_json::from_value(parameters);
            read.map_err(|error| unreadable(error.to_string()))?.every_s
        }
    };
    if EVERY_S.contains(&every_s) {
        Ok(every_s)
    } else {
        Err(unreadable(format!("`every_s` is {every_s}")))
    }
}

/// What is told of a terrain's entity.
type TerrainParts = (
    Entity,
    &'static Terrain,
    Option<&'static Name>,
    Option<&'static TerrainState>,
    Option<&'static TerrainEdits>,
    Option<&'static TerrainSettings>,
);

/// The cameras that are told of: a comparison's second one is nobody's to set.
#[cfg(feature = "render")]
type Told = Without<ComparisonCamera>;
#[cfg(not(feature = "render"))]
type Told = ();

/// What is told of a camera's entity.
type CameraParts = (
    Entity,
    &'static TerrainCamera,
    Option<&'static Name>,
    Option<&'static TerrainViews>,
);

/// Everything that figures come from. Nothing of it has to be there.
#[derive(SystemParam)]
pub(super) struct Sources<'w, 's> {
    terrains: Query<'w, 's, TerrainParts>,
    cameras: Query<'w, 's, CameraParts, Told>,
    #[cfg(feature = "render")]
    drawn: Query<'w, 's, &'static TerrainStatistics>,
    streamer: Option<Res<'w, TerrainStreamer>>,
    streaming: Option<Res<'w, TerrainStreaming>>,
    server: Option<Res<'w, AssetServer>>,
    diagnostics: Option<Res<'w, DiagnosticsStore>>,
    registry: Res<'w, AppTypeRegistry>,
}

impl Sources<'_, '_> {
    fn collect(&self) -> TerrainStats {
        let registry = self.registry.read();
        let mut terrains: Vec<_> = self
            .terrains
            .iter()
            .map(|(entity, terrain, name, state, edits, settings)| {
                let mut stats = self.terrain(entity, terrain, state);
                stats.name = name.map(|name| name.as_str().to_owned());
                stats.settings =
                    settings.map_or(Value::Null, |settings| as_json(settings, &registry));
                if let Some(log) = edits.and_then(TerrainEdits::log) {
                    stats.edits = log.active_count();
                    let is_edit = |record: &&EditRecord| matches!(record.op, EditOp::Apply(_));
                    let made = log.records().iter().filter(is_edit).count();
                    stats.edits_undone = made - log.active_count();
                    stats.last_sequence = log.last_sequence();
                }
                stats
            })
            .collect();
        terrains.sort_by_key(|terrain| terrain.entity);
        let mut cameras: Vec<_> = self
            .cameras
            .iter()
            .map(|(entity, camera, name, views)| {
                let mut refused = Vec::new();
                let _ = camera.checked(|error| refused.push(error.to_string()));
                TerrainCameraStats {
                    entity,
                    name: name.map(|name| name.as_str().to_owned()),
                    settings: as_json(camera, &registry),
                    refused,
                    views: views.map_or_else(Vec::new, |views| self.views(entity, views)),
                }
            })
            .collect();
        cameras.sort_by_key(|camera| camera.entity);
        TerrainStats {
            terrains,
            cameras,
            streaming: self.streaming(&registry),
            diagnostics: self.diagnostics(),
        }
    }

    fn terrain(
        &self,
        entity: Entity,
        terrain: &Terrain,
        state: Option<&TerrainState>,
    ) -> TerrainWorldStats {
        let has_failed = |server: &AssetServer| server.load_state(&terrain.manifest).is_failed();
        let name = match state {
            None if self.server.as_deref().is_some_and(has_failed) => "failed",
            None => "loading",
            Some(state) if !state.is_ready() => "starting",
            Some(state) if state.is_settled() => "settled",
            Some(_) => "streaming",
        };
        let file = state.map(|state| &state.manifest().file);
        let mut failed: Vec<_> = state.into_iter().flat_map(TerrainState::failed).collect();
        failed.sort_unstable();
        let paths = failed.iter().take(FAILED_NAMED);
        TerrainWorldStats {
            entity,
            name: None,
            manifest: terrain.manifest.path().map(ToString::to_string),
            state: name.to_owned(),
            size_samples: file.map(|file| file.size),
            spacing_m: file.map(|file| file.spacing_m),
            levels: file.map(|file| file.levels),
            tiles_resident: state.map_or_else(Vec::new, |state| resident(state.pages())),
            tiles_wanted: state.map_or(0, TerrainState::wanted_count),
            tiles_loading: state.map_or(0, TerrainState::loading_count),
            tiles_failed: failed.len(),
            failed_paths: paths.map(|&address| tile_path(address)).collect(),
            levels_short: state.map_or(0, TerrainState::levels_short),
            is_short_of_pages: state.is_some_and(TerrainState::is_short_of_pages),
            edits: 0,
            edits_undone: 0,
            last_sequence: 0,
            settings: Value::Null,
        }
    }

    fn views(&self, camera: Entity, views: &TerrainViews) -> Vec<TerrainViewStats> {
        let view = |view: &crate::view::TerrainView| TerrainViewStats {
            terrain: view.terrain,
            eye_m: view.eye_m.to_array(),
            velocity_m_s: view.velocity_m_s.to_array(),
            drawn: self.drawn(camera, view.terrain),
        };
        let mut views: Vec<_> = views.views.iter().map(view).collect();
        views.sort_by_key(|view| view.terrain);
        views
    }

    #[cfg(feature = "render")]
    fn drawn(&self, camera: Entity, terrain: Entity) -> Option<TerrainDrawnStats> {
        let view = self.drawn.get(camera).ok()?.terrains.get(&terrain)?;
        Some(TerrainDrawnStats {
            faces: view.counters.faces,
            culled_faces: view.counters.culled_faces,
            vertices: view.vertices,
            triangles: view.triangles,
            wanted_vertices: view.wanted_vertices,
            wanted_triangles: view.wanted_triangles,
            room_vertices: view.room_vertices,
            overflow: view.overflow,
            width_scale: view.width_scale,
        })
    }

    #[cfg(not(feature = "render"))]
    #[expect(
        clippy::unused_self,
        reason = "without a renderer nothing is drawn of anything"
    )]
    const fn drawn(&self, _: Entity, _: Entity) -> Option<TerrainDrawnStats> {
        None
    }

    fn streaming(&self, registry: &TypeRegistry) -> Option<TerrainStreamingStats> {
        let (streamer, settings) = (self.streamer.as_deref()?, self.streaming.as_deref()?);
        let mut refused = Vec::new();
        let _ = settings.checked(|error| refused.push(error.to_string()));
        Some(TerrainStreamingStats {
            pages_used: streamer.pages_used(),
            pages: streamer.pages(),
            page_bytes: PAGE_BYTES,
            tiles_held: streamer.tiles_held(),
            tiles_loading: streamer.tiles_loading(),
            tiles_wanted: streamer.wanted(),
            last_frame_ms: streamer.last_frame().as_secs_f64() * 1e3,
            settings: as_json(settings, registry),
            refused,
        })
    }

    fn diagnostics(&self) -> Vec<TerrainDiagnosticStats> {
        let all = self.diagnostics.iter().flat_map(|store| store.iter());
        let mut ours: Vec<_> = all
            .filter(|diagnostic| is_ours(diagnostic.path().as_str()))
            .map(figures)
            .collect();
        ours.sort_by(|one, other| one.path.cmp(&other.path));
        ours
    }
}

/// Whether a diagnostic is of terrains, or of one of their passes.
fn is_ours(path: &str) -> bool {
    path.starts_with("terrain/") || (path.starts_with("render/") && path.contains("/terrain_"))
}

fn figures(diagnostic: &Diagnostic) -> TerrainDiagnosticStats {
    TerrainDiagnosticStats {
        path: diagnostic.path().as_str().to_owned(),
        value: diagnostic.value().filter(|value| value.is_finite()),
        smoothed: diagnostic.smoothed().filter(|value| value.is_finite()),
        unit: diagnostic.suffix.trim().to_owned(),
    }
}

/// Tiles with a page, of each level.
fn resident(pages: &PageTable) -> Vec<u32> {
    let ends = (1..=pages.levels()).map(|level| {
        let last = level == pages.levels();
        (!last).then(|| pages.level_offset(level) as usize)
    });
    let mut begin = 0;
    ends.map(|end| {
        let level = &pages.flat()[begin..end.unwrap_or(pages.flat().len())];
        begin += level.len();
        level
            .iter()
            .filter(|&&page| page != PageTable::NONE)
            .count() as u32
    })
    .collect()
}

/// Settings as `terrain.set` takes them; `null` where they can't be written so.
fn as_json<T: Reflect + GetTypeRegistration>(settings: &T, registry: &TypeRegistry) -> Value {
    serde_json::to_value(TypedReflectSerializer::new(settings, registry)).unwrap_or_default()
}
