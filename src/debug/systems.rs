//! The plugin: when the panel is shown, and what input the game sees meanwhile.

use super::brush::BrushPlugin;
use super::views::{DividerUse, drag_divider};
use super::{StatisticsTabPlugin, TerrainPanel};
use crate::gizmos::TerrainGizmosPlugin;
use bevy::ecs::system::SystemParam;
use bevy::gizmos::GizmoPlugin;
use bevy::input::keyboard::{Key, KeyboardInput};
use bevy::input::mouse::{AccumulatedMouseScroll, MouseButtonInput, MouseWheel};
use bevy::input::touch::TouchInput;
use bevy::input::{InputPlugin, InputSystems};
use bevy::prelude::*;
use bevy::render::RenderApp;
use bevy::render::diagnostic::RenderDiagnosticsPlugin;
use bevy_egui::input::EguiWantsInput;
use bevy_egui::{
    EguiContext, EguiGlobalSettings, EguiPlugin, EguiPreUpdateSet, EguiPrimaryContextPass,
    PrimaryEguiContext,
};
use std::hash::Hash;

/// Adds the [panel](TerrainPanel), and what it needs where the app hasn't got it:
/// [`TerrainGizmosPlugin`], Bevy's `RenderDiagnosticsPlugin` and bevy_egui's `EguiPlugin`.
///
/// Add it after `DefaultPlugins`, and after an `EguiPlugin` of the game's own. Where there is no
/// renderer it adds the [`TerrainPanel`] alone, which the game may show by itself.
///
/// Open, the panel takes below half a millisecond of CPU time a frame (`cargo bench --bench
/// panel`); closed, a run condition.
#[derive(Clone, Copy, Debug, Default)]
pub struct TerrainDebugPlugin;

impl Plugin for TerrainDebugPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<TerrainPanel>();
        if app.get_sub_app(RenderApp).is_none() {
            return;
        }
        if !app.is_plugin_added::<RenderDiagnosticsPlugin>() {
            app.add_plugins(RenderDiagnosticsPlugin);
        }
        if app.is_plugin_added::<GizmoPlugin>() && !app.is_plugin_added::<TerrainGizmosPlugin>() {
            app.add_plugins(TerrainGizmosPlugin);
        }
        if !app.is_plugin_added::<EguiPlugin>() {
            app.add_plugins(EguiPlugin::default());
        }
        app.add_plugins(StatisticsTabPlugin);
        if app.is_plugin_added::<GizmoPlugin>() && !app.is_plugin_added::<BrushPlugin>() {
            app.add_plugins(BrushPlugin);
        }
        app.init_resource::<LostContext>()
            .init_resource::<DividerUse>()
            .add_observer(lose_context)
            .add_systems(
                EguiPrimaryContextPass,
                (drag_divider, show.run_if(is_open)).chain(),
            )
            .add_systems(
                PreUpdate,
                replace_context
                    .run_if(is_open)
                    .before(EguiPreUpdateSet::InitContexts),
            );
        if app.is_plugin_added::<InputPlugin>() {
            app.add_systems(
                PreUpdate,
                (
                    // Before keys are taken away from the game.
                    toggle
                        .after(InputSystems)
                        .before(EguiPreUpdateSet::ProcessInput),
                    absorb
                        .after(EguiPreUpdateSet::ProcessInput)
                        .run_if(is_open.or_else(is_divider_used)),
                ),
            );
        }
    }
}

fn is_open(panel: Option<Res<TerrainPanel>>) -> bool {
    panel.is_some_and(|panel| panel.is_open)
}

fn is_divider_used(divider: Res<DividerUse>) -> bool {
    divider.0
}

/// Opens and closes the panel.
fn toggle(
    panel: Option<ResMut<TerrainPanel>>,
    keys: Res<ButtonInput<KeyCode>>,
    wants: Res<EguiWantsInput>,
) {
    let Some(mut panel) = panel else {
        return;
    };
    let Some(key) = panel.key else {
        return;
    };
    let is_function_key = (KeyCode::F1..=KeyCode::F35).contains(&key);
    let is_typed = wants.wants_keyboard_input() && !is_function_key;
    if keys.just_pressed(key) && !is_typed {
        panel.is_open = !panel.is_open;
    }
}

/// Shows the panel, which is not in the world meanwhile.
fn show(world: &mut World) {
    let mut contexts = world.query_filtered::<&mut EguiContext, With<PrimaryEguiContext>>();
    let Ok(mut context) = contexts.single_mut(world) else {
        return;
    };
    // A handle.
    let ctx = context.get_mut().clone();
    world.try_resource_scope(|world, mut panel: Mut<TerrainPanel>| panel.show(&ctx, world));
}

/// What the game sees of the pointer.
#[derive(SystemParam)]
struct PointerInput<'w> {
    buttons: ResMut<'w, ButtonInput<MouseButton>>,
    scroll: ResMut<'w, AccumulatedMouseScroll>,
    touches: ResMut<'w, Touches>,
    button_messages: ResMut<'w, Messages<MouseButtonInput>>,
    wheel_messages: ResMut<'w, Messages<MouseWheel>>,
    touch_messages: ResMut<'w, Messages<TouchInput>>,
}

impl PointerInput<'_> {
    fn take(&mut self) {
        self.buttons.reset_all();
        self.scroll.delta = Vec2::ZERO;
        self.touches.reset_all();
        self.button_messages.clear();
        self.wheel_messages.clear();
        self.touch_messages.clear();
    }
}

/// What the game sees of the keyboard.
#[derive(SystemParam)]
struct KeyInput<'w> {
    codes: ResMut<'w, ButtonInput<KeyCode>>,
    keys: ResMut<'w, ButtonInput<Key>>,
    messages: ResMut<'w, Messages<KeyboardInput>>,
}

impl KeyInput<'_> {
    /// Modifiers stay as they are: one that is held while a field is left is still held.
    fn take(&mut self) {
        reset_but(&mut self.codes, |code| {
            matches!(
                code,
                KeyCode::AltLeft
                    | KeyCode::AltRight
                    | KeyCode::ControlLeft
                    | KeyCode::ControlRight
                    | KeyCode::ShiftLeft
                    | KeyCode::ShiftRight
                    | KeyCode::SuperLeft
                    | KeyCode::SuperRight
            )
        });
        reset_but(&mut self.keys, |key| {
            matches!(
                key,
                Key::Alt | Key::AltGraph | Key::Control | Key::Meta | Key::Shift | Key::Super
            )
        });
        self.messages.clear();
    }
}

/// Forgets what was pressed and released, but for what is to stay.
fn reset_but<T: Clone + Eq + Hash + Send + Sync + 'static>(
    input: &mut ButtonInput<T>,
    stays: fn(&T) -> bool,
) {
    let known = input
        .get_pressed()
        .chain(input.get_just_pressed())
        .chain(input.get_just_released());
    let gone: Vec<T> = known.filter(|key| !stays(key)).cloned().collect();
    for key in gone {
        input.reset(key);
    }
}

/// Takes input away from the game that is meant for the panel, or for the line of a comparison.
fn absorb(
    panel: Option<Res<TerrainPanel>>,
    divider: Res<DividerUse>,
    wants: Res<EguiWantsInput>,
    mut pointer: PointerInput,
    mut keys: KeyInput,
) {
    if panel.as_ref().is_some_and(|panel| !panel.absorbs_input) {
        return;
    }
    // Closed, the panel has no say in what the game's own egui takes.
    let is_open = panel.is_some_and(|panel| panel.is_open);
    let is_wanted =
        wants.wants_pointer_input() || wants.is_using_pointer() || wants.is_popup_open();
    if divider.0 || (is_open && is_wanted) {
        pointer.take();
    }
    if is_open && wants.wants_keyboard_input() {
        keys.take();
    }
}

/// Whether the primary context is gone with the camera that had it. bevy_egui gives one to the first
/// camera there is, and to no other ever after.
#[derive(Resource, Default)]
struct LostContext(bool);

fn lose_context(_removed: On<Remove, PrimaryEguiContext>, mut lost: ResMut<LostContext>) {
    lost.0 = true;
}

/// Gives the context to the camera that is chosen, where its own is gone and the game leaves contexts
/// to bevy_egui.
fn replace_context(world: &mut World) {
    if !world.resource::<LostContext>().0 {
        return;
    }
    let is_automatic = world
        .get_resource::<EguiGlobalSettings>()
        .is_some_and(|settings| settings.auto_create_primary_context);
    let mut contexts = world.query_filtered::<(), With<PrimaryEguiContext>>();
    if !is_automatic || contexts.iter(world).next().is_some() {
        world.resource_mut::<LostContext>().0 = false;
        return;
    }
    let Some(choice) = world
        .try_resource_scope(|world, mut panel: Mut<TerrainPanel>| panel.choice(world).camera)
        .flatten()
    else {
        return;
    };
    if world.get::<Camera>(choice).is_some() {
        world.resource_mut::<LostContext>().0 = false;
        world.entity_mut(choice).insert(PrimaryEguiContext);
    }
}
