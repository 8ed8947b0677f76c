//! The plugin that makes terrains live.

use super::{
    Terrain, TerrainCamera, TerrainCpuTimes, TerrainManifest, TerrainManifestLoader,
    TerrainSettings,
};
use crate::detail::TerrainDetail;
use crate::edit;
use crate::stream::{
    self, TerrainPin, TerrainPinProgress, TerrainStreamer, TerrainStreaming, TerrainTiles,
    TileBounds, TileData, TileOf, TilePage,
};
use crate::tile::{TerrainTile, TerrainTileLoader, TileAddress};
use crate::view;
use bevy::prelude::*;
use bevy::transform::TransformSystems;

/// What terrains do in `PostUpdate`, in this order, after transforms have been propagated.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum TerrainSystems {
    /// Manifests that have loaded become a [`TerrainState`](crate::stream::TerrainState). Order
    /// before it whatever spawns terrains or changes [`TerrainSettings`] in `PostUpdate`.
    Load,
    /// [`TerrainViews`](crate::view::TerrainViews) are computed. Order before it whatever changes
    /// a camera's or a terrain's `GlobalTransform` or [`TerrainCamera`]; after it, the views of
    /// this frame can be read.
    View,
    /// Tiles are loaded, activated and evicted, and the residency field moves. Order after it
    /// whatever reads page tables, fields or tile entities of this frame.
    Stream,
}

/// Terrains as entities and assets, without a renderer: loads manifests and tiles and keeps
/// resident what the [`TerrainCamera`]s need.
///
/// It needs Bevy's `TaskPoolPlugin`, `TimePlugin`, `TransformPlugin` and `AssetPlugin`, all of
/// which `DefaultPlugins` holds; a server adds them to `MinimalPlugins` as far as they aren't
/// there. Cost: some microseconds a frame and terrain while nothing moves, and the reading of
/// tiles in the background.
#[derive(Clone, Copy, Debug, Default)]
pub struct TerrainPlugin;

impl Plugin for TerrainPlugin {
    fn build(&self, app: &mut App) {
        app.add_plugins(edit::EditPlugin)
            .init_asset::<TerrainManifest>()
            .init_asset::<TerrainTile>()
            .init_asset_loader::<TerrainManifestLoader>()
            .init_asset_loader::<TerrainTileLoader>()
            .init_resource::<TerrainStreaming>()
            .init_resource::<TerrainStreamer>()
            .init_resource::<TerrainCpuTimes>()
            .register_type::<TerrainStreaming>()
            .register_type::<TerrainPin>()
            .register_type::<TerrainPinProgress>()
            .register_type::<Terrain>()
            .register_type::<TerrainSettings>()
            .register_type::<TerrainDetail>()
            .register_type::<TerrainCamera>()
            .register_type::<TileAddress>()
            .register_type::<TileOf>()
            .register_type::<TerrainTiles>()
            .register_type::<TileData>()
            .register_type::<TileBounds>()
            .register_type::<TilePage>()
            .add_observer(stream::forget_removed_terrain)
            .configure_sets(
                PostUpdate,
                (
                    TerrainSystems::Load,
                    TerrainSystems::View,
                    TerrainSystems::Stream,
                )
                    .chain()
                    .after(TransformSystems::Propagate),
            )
            .add_systems(
                PostUpdate,
                (
                    (
                        stream::follow_manifests,
                        stream::start_terrains,
                        stream::replace_terrains,
                        edit::start_logs,
                        // What has only just started is followed in the next frame.
                        stream::update_detail,
                    )
                        .chain()
                        .in_set(TerrainSystems::Load),
                    view::update_views.in_set(TerrainSystems::View),
                    (
                        stream::collect_pins,
                        stream::stream_tiles,
                        stream::count_pins,
                        edit::mask::draw_masks,
                    )
                        .chain()
                        .in_set(TerrainSystems::Stream),
                ),
            );
        #[cfg(feature = "render")]
        app.add_plugins(view::EyePlugin).configure_sets(
            PostUpdate,
            TerrainSystems::View.after(bevy::camera::CameraUpdateSystems),
        );
    }
}
