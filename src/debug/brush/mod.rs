//! A brush for the ground: craters, hills, and what else [`edit`](crate::edit) knows, made where the
//! pointer is; and the panel's tab of it, with the log's list.
//!
//! [`BrushPlugin`] does what happens on the ground and needs no panel: set [`TerrainBrush`].
//!
//! ```no_run
//! # use bevy::prelude::*;
//! # use bevy_tessera::debug::brush::{BrushKind, BrushPlugin, TerrainBrush};
//! fn take_shovel(mut brush: ResMut<TerrainBrush>) {
//!     brush.on = true;
//!     brush.kind = BrushKind::Lower;
//!     brush.set_radius_m(3.0);
//! }
//! # App::new().add_plugins((DefaultPlugins, BrushPlugin)).add_systems(Startup, take_shovel);
//! ```

mod code;
mod files;
mod list;
mod numbers;
mod pointer;
mod ring;
mod stroke;
mod tab;
mod tool;

pub use pointer::{BrushHit, BrushMessages, BrushPointer};
pub use ring::BrushGizmos;
pub use stroke::{BrushHistory, redo_stroke, undo_stroke};
pub use tab::BrushTab;
pub use tool::{BrushKind, MarkedEdit, StampBrush, TerrainBrush};

pub use files::{BrushFiles, EditFormat, load_edits, read_stamp, save_edits};

use crate::terrain::TerrainSystems;
use bevy::input::InputSystems;
use bevy::input::keyboard::KeyboardInput;
use bevy::picking::PickingSystems;
use bevy::prelude::*;
use bevy_egui::EguiPreUpdateSet;

/// Lets [`TerrainBrush`] edit the ground under pointers. Part of what the panel adds.
///
/// It needs [`TerrainPlugins`](crate::TerrainPlugins) and Bevy's `DefaultPickingPlugins` and
/// `GizmoPlugin`, which `DefaultPlugins` holds: the place under the pointer is that of
/// [`TerrainPickingPlugin`](crate::query::TerrainPickingPlugin), so that what stands before the ground
/// and can be picked is in the way, and so is egui. Cost while the brush is off: nothing worth a figure.
///
/// A brush that the panel's tab has switched on is switched off when the panel is closed; one that the
/// game has switched on is the game's. What a press of the brush is to others, see
/// [`TerrainBrush::takes_clicks`]. Kinds whose radius nobody has set get one of at least four samples of
/// the first terrain that the brush meets, in the same shape.
#[derive(Clone, Copy, Debug, Default)]
pub struct BrushPlugin;

/// What the brush does in a frame.
#[derive(SystemSet, Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum BrushSystems {
    /// Finds the ground under the pointer, and obeys keys. In `Update`; order before it what sets
    /// [`TerrainBrush`].
    Point,
    /// Makes edits. In `Update`, after [`Point`](Self::Point); order after it what asks for the ground.
    Apply,
    /// Draws the preview and the marked edit. In `PostUpdate`, after
    /// [`TerrainSystems::Stream`].
    Draw,
}

impl Plugin for BrushPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<TerrainBrush>()
            .init_resource::<BrushPointer>()
            .init_resource::<BrushHistory>()
            .init_resource::<BrushMessages>()
            .init_resource::<BrushFiles>()
            .init_resource::<pointer::BrushHand>()
            .register_type::<TerrainBrush>()
            .add_message::<KeyboardInput>()
            .init_gizmo_group::<BrushGizmos>()
            .add_observer(pointer::hear_refusals)
            .configure_sets(Update, (BrushSystems::Point, BrushSystems::Apply).chain())
            .configure_sets(PostUpdate, BrushSystems::Draw.after(TerrainSystems::Stream))
            .add_systems(
                Update,
                (
                    (
                        pointer::lay_down,
                        pointer::point,
                        pointer::fit.run_if(is_met),
                        pointer::obey_keys,
                    )
                        .chain()
                        .in_set(BrushSystems::Point),
                    (
                        files::finish.run_if(files::is_busy),
                        pointer::apply.run_if(pointer::is_wanted),
                    )
                        .chain()
                        .in_set(BrushSystems::Apply),
                ),
            )
            .add_systems(
                PreUpdate,
                pointer::take_clicks
                    .after(PickingSystems::Last)
                    .after(InputSystems)
                    .after(EguiPreUpdateSet::ProcessInput),
            )
            .add_systems(
                PostUpdate,
                (
                    ring::draw_preview.run_if(|brush: Res<TerrainBrush>| brush.on),
                    ring::draw_mark.run_if(|brush: Res<TerrainBrush>| brush.marked.is_some()),
                )
                    .in_set(BrushSystems::Draw),
            );
        let mut store = app.world_mut().resource_mut::<GizmoConfigStore>();
        let (config, _) = store.config_mut::<BrushGizmos>();
        config.depth_bias = ring::DEPTH_BIAS;
        config.line.width = 3.0;
    }
}

/// Whether the brush has met a terrain, as far as is known without looking.
fn is_met(brush: Res<TerrainBrush>) -> bool {
    brush.on || brush.terrain.is_some()
}
