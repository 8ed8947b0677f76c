//! The terrain itself: its manifest and, in a Bevy world, its component and settings.

#[cfg(feature = "ecs")]
mod camera;
#[cfg(feature = "ecs")]
mod component;
#[cfg(feature = "ecs")]
mod cpu_times;
#[cfg(feature = "ecs")]
mod events;
#[cfg(feature = "ecs")]
mod loader;
mod manifest;
mod nearest_ground;
#[cfg(feature = "ecs")]
mod plugin;

pub use crate::density::{DensityBorder, DensityFilter, DensitySettings, DensitySettingsError};
#[cfg(feature = "ecs")]
pub use camera::{TerrainCamera, TerrainCameraError, TessellationPolicy};
#[cfg(feature = "ecs")]
pub use component::{Terrain, TerrainSettings, TerrainSettingsError};
#[cfg(feature = "ecs")]
pub use cpu_times::{TerrainCpuStage, TerrainCpuTimes};
#[cfg(feature = "ecs")]
pub use events::{
    TerrainFailed, TerrainPinReady, TerrainReady, TerrainReloadFailed, TileEvicted, TileFailed,
    TileLoaded, TileReloaded,
};
#[cfg(feature = "ecs")]
pub use loader::{ManifestLoadError, TerrainManifestLoader};
pub(crate) use manifest::check_size;
#[cfg(test)]
pub(crate) use manifest::test_manifest_file;
pub use manifest::{
    INDEX_FILE, MANIFEST_FILE, MANIFEST_MAGIC, MANIFEST_VERSION, MAX_LEAF_TILES, MAX_LEVELS,
    MAX_SIZE, MIN_SIZE, ManifestError, ManifestFile, TerrainManifest,
};
pub use nearest_ground::GroundQuery;
pub(crate) use nearest_ground::tile_bounds;
#[cfg(feature = "ecs")]
pub use plugin::{TerrainPlugin, TerrainSystems};
