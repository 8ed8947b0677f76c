//! Figures and settings of terrains over the [Bevy Remote Protocol](bevy::remote), so that tools
//! outside a running game or server can watch and set them.
//!
//! Three methods, which need no renderer:
//!
//! | method | does |
//! |---|---|
//! | `terrain.stats` | answers with [`TerrainStats`]: every terrain, camera and view, streaming, diagnostics |
//! | `terrain.stats+watch` | the same again and again, as a stream of server-sent events |
//! | `terrain.set` | changes one setting of one component or resource, or says why it can't |
//!
//! ```no_run
//! use bevy::prelude::*;
//! use bevy::remote::RemotePlugin;
//! use bevy::remote::http::RemoteHttpPlugin;
//! use bevy_tessera::remote::TerrainRemotePlugin;
//!
//! App::new()
//!     .add_plugins(DefaultPlugins)
//!     // Bevy's own, which listens at 127.0.0.1, port 15702.
//!     .add_plugins((RemotePlugin::default(), RemoteHttpPlugin::default()))
//!     .add_plugins((bevy_tessera::TerrainPlugins, TerrainRemotePlugin))
//!     .run();
//! ```
//!
//! ```sh
//! curl http://127.0.0.1:15702 -d '{"jsonrpc": "2.0", "id": 1, "method": "terrain.stats"}'
//! curl http://127.0.0.1:15702 -d '{"jsonrpc": "2.0", "id": 2, "method": "terrain.set", "params":
//!     {"component": "TerrainCamera", "path": "triangle_width_px", "value": 8}}'
//! ```
//!
//! The protocol knows no passwords: whoever reaches the port may read and change everything in the
//! app. Bevy listens on the machine itself only, where any program reaches it, a web page in its
//! browser included: leave the plugins out of what you ship.
//!
//! # `terrain.stats`
//! Takes no parameters. The answer is a [`TerrainStats`], whose fields say their units.
//!
//! # `terrain.stats+watch`
//! Takes `{"every_s": 0.5}` or nothing: seconds between two answers, 0.05 to 3600, 1 where nothing
//! is said; never more than one a frame. The first comes with the app's next whole multiple of
//! `every_s`, not at once. It ends when the connection is closed. Bevy ends it too where eight answers
//! wait to be read. Where the parameters are wrong, the error comes again once a second until the
//! connection is closed.
//!
//! # `terrain.set`
//! Takes an object of
//! - `component`: what holds the setting, by its short name: of cameras `TerrainCamera`; of terrains
//!   `TerrainSettings`, `TerrainDetail`; for all `TerrainStreaming`; with the feature `render` of
//!   cameras `TerrainOverlays`, `TerrainComparison`, `TerrainEye`, of terrains `TerrainMaterial`,
//!   `TerrainDensityPreview`, `MaskSettings`; with `avian` for all `TerrainPhysics`; with `gizmos`
//!   for all `TerrainGizmos`;
//! - `path`: which part of it, in [Bevy's notation](bevy::reflect::GetPath): `triangle_width_px`,
//!   `lod.reach`, `parameters[0].x`; an empty one stands for the whole;
//! - `value`: the new value, as Bevy's reflection writes it: a number, `true`, a list, an object with
//!   the fields that change, `"PowerOfTwo"`, `{"ScreenError": {"max_px": 2.0}}`, `null` for `None`;
//! - `entity`: which camera or terrain, as `terrain.stats` numbers them. It may be left out where
//!   only one has the component.
//!
//! A component has to be there to be set: insert it in the game, `TerrainOverlays::default()` for
//! instance. A material's shader can't be set, nor [`TerrainSettings::leaf_level`] once the terrain has
//! loaded.
//!
//! [`TerrainSettings::leaf_level`]: crate::terrain::TerrainSettings::leaf_level
//!
//! The answer is a [`TerrainSetting`]. Where a value is of the wrong type or out of its range, a name
//! isn't known, or it isn't clear which entity is meant, nothing changes and the error's `message`
//! says in a sentence what is wrong and what to do: see [`TerrainRemoteError`]. What changes takes
//! effect in the next frame.

mod error;
mod figures;
mod set;
mod settings;
mod stats;

pub use error::TerrainRemoteError;
pub use figures::{
    TerrainCameraStats, TerrainDiagnosticStats, TerrainDrawnStats, TerrainSetting, TerrainStats,
    TerrainStreamingStats, TerrainViewStats, TerrainWorldStats,
};

use bevy::ecs::reflect::AppTypeRegistry;
use bevy::prelude::*;
use bevy::remote::{RemoteMethodSystemId, RemoteMethods};

/// The method that answers with [`TerrainStats`].
pub const TERRAIN_STATS_METHOD: &str = "terrain.stats";
/// The method that answers with [`TerrainStats`] again and again.
pub const TERRAIN_STATS_WATCH_METHOD: &str = "terrain.stats+watch";
/// The method that changes a setting and answers with a [`TerrainSetting`].
pub const TERRAIN_SET_METHOD: &str = "terrain.set";

/// Adds the methods `terrain.stats`, `terrain.stats+watch` and `terrain.set` to the app's
/// [`RemotePlugin`](bevy::remote::RemotePlugin); the [module](self) says what they take and answer.
///
/// It may be added before or after Bevy's plugin, and does not add it: a game that wants other
/// methods makes its own, and Bevy allows only one. Where there is none when the app starts, a warning
/// says so and nothing is added. A transport, such as Bevy's `RemoteHttpPlugin`, is the game's to
/// choose too. Costs nothing while nobody asks.
#[derive(Clone, Copy, Debug, Default)]
pub struct TerrainRemotePlugin;

impl Plugin for TerrainRemotePlugin {
    fn build(&self, app: &mut App) {
        app.add_systems(PreStartup, register);
    }
}

/// Bevy's plugin puts its own list of methods in place whenever it is built, so nothing can be
/// added to it before all plugins are there.
fn register(world: &mut World) {
    if !world.contains_resource::<RemoteMethods>() {
        warn!(
            "TerrainRemotePlugin has nothing to add `{TERRAIN_STATS_METHOD}` and \
             `{TERRAIN_SET_METHOD}` to: add Bevy's RemotePlugin too"
        );
        return;
    }
    let registry = world.resource::<AppTypeRegistry>().clone();
    for settable in settings::SETTABLE {
        (settable.register)(&mut registry.write());
    }
    let stats = RemoteMethodSystemId::Instant(world.register_system(stats::stats));
    let watch = RemoteMethodSystemId::Watching(world.register_system(stats::watch));
    let set = RemoteMethodSystemId::Instant(world.register_system(set::set));
    let mut methods = world.resource_mut::<RemoteMethods>();
    methods.insert(TERRAIN_STATS_METHOD, stats);
    methods.insert(TERRAIN_STATS_WATCH_METHOD, watch);
    methods.insert(TERRAIN_SET_METHOD, set);
}
