//! What the remote methods answer, as Rust; in JSON the fields have the same names.

use bevy::prelude::Entity;
use serde::{Deserialize, Serialize};
use serde_json::Value;

/// The answer of `terrain.stats`.
///
/// A tool that is written in Rust may read answers with this type; an entity is a number in JSON.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct TerrainStats {
    /// Every [`Terrain`](crate::terrain::Terrain), by entity.
    pub terrains: Vec<TerrainWorldStats>,
    /// Every [`TerrainCamera`](crate::terrain::TerrainCamera), by entity.
    pub cameras: Vec<TerrainCameraStats>,
    /// What all of them share; `None` where the app has no
    /// [`TerrainPlugin`](crate::terrain::TerrainPlugin).
    pub streaming: Option<TerrainStreamingStats>,
    /// The terrains' entries in Bevy's diagnostics, by path: `terrain/…`, and the passes'
    /// `render/terrain_…` where the game has Bevy's `RenderDiagnosticsPlugin`.
    pub diagnostics: Vec<TerrainDiagnosticStats>,
}

/// A terrain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct TerrainWorldStats {
    /// Its entity.
    pub entity: Entity,
    /// Its `Name`.
    pub name: Option<String>,
    /// The path of its manifest.
    pub manifest: Option<String>,
    /// What it does: `loading` (the manifest), `failed` (the manifest can't be read), `starting` (no
    /// tile is resident), `streaming`, or `settled` (all is there that the views want).
    pub state: String,
    /// Samples of level 0 along x and z; `None`, like what follows, until the manifest has loaded.
    pub size_samples: Option<[u32; 2]>,
    /// Metres between them.
    pub spacing_m: Option<f64>,
    /// Levels of tiles.
    pub levels: Option<u8>,
    /// Resident tiles of each level, the finest first.
    pub tiles_resident: Vec<u32>,
    /// Tiles that views and pins want, resident or not, as far as the memory goes.
    pub tiles_wanted: usize,
    /// Tiles that were asked for and aren't resident yet.
    pub tiles_loading: usize,
    /// Tiles that are missing or corrupt.
    pub tiles_failed: usize,
    /// The first 16 of those, as paths beside the manifest.
    pub failed_paths: Vec<String>,
    /// How many levels short of what the views ask for the ground is, where it is worst.
    pub levels_short: u8,
    /// Whether the views want more than there is memory for.
    pub is_short_of_pages: bool,
    /// Edits that are in effect.
    pub edits: usize,
    /// Edits that have been taken back.
    pub edits_undone: usize,
    /// Number of the log's newest record, by which logs are compared.
    pub last_sequence: u64,
    /// What its [`TerrainSettings`](crate::terrain::TerrainSettings) hold.
    pub settings: Value,
}

/// A camera, or another eye that terrains stream around.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct TerrainCameraStats {
    /// Its entity.
    pub entity: Entity,
    /// Its `Name`.
    pub name: Option<String>,
    /// What its [`TerrainCamera`](crate::terrain::TerrainCamera) holds.
    pub settings: Value,
    /// Why some of that can't be used and its default is taken, a sentence each.
    pub refused: Vec<String>,
    /// Its views of terrains, by terrain; none while the camera isn't active.
    pub views: Vec<TerrainViewStats>,
}

/// A camera's view of a terrain.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct TerrainViewStats {
    /// The terrain's entity.
    pub terrain: Entity,
    /// The eye in the terrain's own space, metres.
    pub eye_m: [f64; 3],
    /// How fast it moves there, metres a second.
    pub velocity_m_s: [f64; 3],
    /// What was drawn; `None` without a renderer, and until the first frame has come back from the GPU.
    pub drawn: Option<TerrainDrawnStats>,
}

/// What the newest frame that the GPU has finished drew of a view, as
/// `render::TerrainViewStatistics` has it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct TerrainDrawnStats {
    /// Faces drawn.
    pub faces: u32,
    /// Faces left out, since no view sees them.
    pub culled_faces: u32,
    /// Vertices drawn.
    pub vertices: u32,
    /// Triangles drawn.
    pub triangles: u32,
    /// Vertices that the settings ask for at this width scale.
    pub wanted_vertices: u32,
    /// Triangles that they ask for.
    pub wanted_triangles: u32,
    /// Vertices that there was room for.
    pub room_vertices: u32,
    /// Power of two by which factors were brought down to fit that room; 0 where all was drawn.
    pub overflow: u32,
    /// What the triangle width was multiplied by because of the budget; 1 where it wasn't.
    pub width_scale: f32,
}

/// What all terrains share.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct TerrainStreamingStats {
    /// Pages in use.
    pub pages_used: u32,
    /// Pages that there is memory for.
    pub pages: u32,
    /// Bytes of a page on the GPU.
    pub page_bytes: u64,
    /// Tiles in main memory: with a page, on their way, and kept.
    pub tiles_held: usize,
    /// Tiles that were asked for and have no page yet.
    pub tiles_loading: usize,
    /// Tiles that the latest plan wants.
    pub tiles_wanted: usize,
    /// CPU time that streaming took in the latest frame, milliseconds.
    pub last_frame_ms: f64,
    /// What [`TerrainStreaming`](crate::stream::TerrainStreaming) holds.
    pub settings: Value,
    /// Why some of that can't be used and its default is taken, a sentence each.
    pub refused: Vec<String>,
}

/// An entry in Bevy's diagnostics.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct TerrainDiagnosticStats {
    /// Its path, as `terrain/triangles`.
    pub path: String,
    /// Its latest value; `None` where there is none yet.
    pub value: Option<f64>,
    /// The same, smoothed over time.
    pub smoothed: Option<f64>,
    /// What the value counts, as `ms`; empty for plain numbers.
    pub unit: String,
}

/// The answer of `terrain.set`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct TerrainSetting {
    /// Whose setting it is; `None` for what belongs to no entity.
    pub entity: Option<Entity>,
    /// The component or resource.
    pub component: String,
    /// Which part of it.
    pub path: String,
    /// What it was.
    pub old: Value,
    /// What it is now.
    pub new: Value,
}
