//! A panel that shows what terrains do and sets what they can be set to.
//!
//! Add [`TerrainDebugPlugin`] after Bevy's plugins and, where the game has one of its own, after
//! bevy_egui's `EguiPlugin`; F3 opens the [`TerrainPanel`]:
//!
//! ```no_run
//! # use bevy::prelude::*;
//! use bevy_tessera::TerrainPlugins;
//! use bevy_tessera::debug::{PanelPlace, TerrainDebugPlugin, TerrainPanel};
//!
//! fn main() -> AppExit {
//!     App::new()
//!         .add_plugins((DefaultPlugins, TerrainPlugins, TerrainDebugPlugin))
//!         .insert_resource(TerrainPanel {
//!             key: Some(KeyCode::F8),
//!             place: PanelPlace::Left,
//!             ..default()
//!         })
//!         .run()
//! }
//! ```
//!
//! Its tabs can be dragged beside each other, split, and undocked into windows of their own. A game
//! adds tabs of its own to [`TerrainPanel::tabs`], and may show the whole panel in its own egui with
//! [`TerrainPanel::ui`].
//!
//! # Input under the panel
//! While the pointer is over the panel, or drags one of its controls, the game sees no mouse buttons,
//! no wheel and no touches; while a field is typed in, no keys but held modifiers. The panel sees to
//! that before `Update`, by resetting `ButtonInput` (of key codes and of logical keys) and `Touches`,
//! clearing the messages of buttons, keys, touches and the wheel, and
//! [`AccumulatedMouseScroll`](bevy::input::mouse::AccumulatedMouseScroll). A drag that began outside the
//! panel stays the game's. The line of a comparison side by side takes the pointer in the same way,
//! with the panel open or closed. A game that wants its input whole sets
//! [`TerrainPanel::absorbs_input`] to false and asks before it uses it:
//!
//! ```no_run
//! # use bevy::prelude::*;
//! use bevy_egui::input::{egui_wants_any_keyboard_input, egui_wants_any_pointer_input};
//!
//! # fn turn_camera() {}
//! # fn walk() {}
//! # let mut app = App::new();
//! app.add_systems(
//!     Update,
//!     (
//!         turn_camera.run_if(not(egui_wants_any_pointer_input)),
//!         walk.run_if(not(egui_wants_any_keyboard_input)),
//!     ),
//! );
//! ```
//!
//! Raw mouse motion is left alone: a camera that turns with no button pressed has to ask. Pointer
//! events of Bevy's picking stop at the panel by themselves.

pub mod brush;
mod form;
mod map;
mod panel;
mod settings;
mod statistics;
mod systems;
mod views;

pub use brush::BrushTab;
pub use map::{MapColour, MapTab, TerrainCameraFlown};
pub use panel::{PanelPlace, TerrainPanel};
pub use settings::SettingsTab;
pub use statistics::{StatisticsTab, StatisticsTabPlugin};
pub use systems::TerrainDebugPlugin;
pub use views::ViewsTab;

use bevy::prelude::*;
use bevy_egui::egui;

/// What a tab works on: the camera and the terrain that are chosen at the panel's top, both alive and
/// with their component.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TerrainChoice {
    /// An entity with a [`TerrainCamera`](crate::terrain::TerrainCamera).
    pub camera: Option<Entity>,
    /// An entity with a [`Terrain`](crate::terrain::Terrain).
    pub terrain: Option<Entity>,
}

/// A tab of the panel. It has the whole world, but for the [`TerrainPanel`] that it is in, and so it
/// needs no other system to do what it says; what it remembers lies in itself.
pub trait TerrainDebugTab: Send + Sync + 'static {
    /// What its tab is called; of two with the same title only the first is shown.
    fn title(&self) -> &'static str;
    /// Shows it and does what its controls are told.
    fn ui(&mut self, ui: &mut egui::Ui, world: &mut World, chosen: TerrainChoice);
    /// Called once a frame while the panel is open, whether or not the tab is seen: for plots that go
    /// on.
    fn update(&mut self, _world: &mut World, _chosen: TerrainChoice) {}
}
