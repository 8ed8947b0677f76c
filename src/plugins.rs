//! Everything that a game adds.

use bevy::app::PluginGroupBuilder;
use bevy::prelude::*;

/// Everything that a game adds to see, query and stream terrains; add it after `DefaultPlugins`.
///
/// [`TerrainPlugin`](crate::terrain::TerrainPlugin) alone serves an app without a renderer; with
/// the feature `render`, [`TerrainRenderPlugin`](crate::render::TerrainRenderPlugin) draws. With the
/// feature `avian`, `TerrainPhysicsPlugin` gives bodies ground, where the game has Avian's plugins.
#[derive(Clone, Copy, Debug, Default)]
pub struct TerrainPlugins;

impl PluginGroup for TerrainPlugins {
    fn build(self) -> PluginGroupBuilder {
        let group = PluginGroupBuilder::start::<Self>().add(crate::terrain::TerrainPlugin);
        #[cfg(feature = "render")]
        let group = group.add(crate::render::TerrainRenderPlugin);
        #[cfg(all(feature = "picking", feature = "render"))]
        let group = group.add(crate::query::TerrainPickingPlugin);
        #[cfg(feature = "avian")]
        let group = group.add(crate::physics::TerrainPhysicsPlugin::default());
        group
    }
}
