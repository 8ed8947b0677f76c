//! Where the brush is, and when it works.

use super::stroke::{BrushHistory, next_place, redo_stroke, undo_stroke};
use super::tool::{BrushKind, KEY_STEP, TerrainBrush, next_seed};
use crate::debug::TerrainPanel;
use crate::edit::{TerrainEditRefused, TerrainEdits};
use crate::stream::TerrainState;
use bevy::ecs::system::SystemParam;
use bevy::input::ButtonState;
use bevy::input::keyboard::{Key, KeyboardInput};
use bevy::math::DVec2;
use bevy::picking::hover::HoverMap;
use bevy::picking::pointer::{PointerId, PointerPress};
use bevy::prelude::*;
use bevy::time::Real;
use bevy_egui::input::EguiWantsInput;
use std::collections::VecDeque;
use std::time::Duration;

/// A stroke makes at most so many edits a frame; a pointer that is faster is caught up with in the
/// frames after.
const MOST_A_FRAME: u32 = 16;
/// The least radius that keys go to where no terrain says how fine it is, in metres.
const LEAST_RADIUS_M: f32 = 0.05;
/// How long refusals are shown, and how many at once.
const SHOWN_FOR: Duration = Duration::from_secs(8);
const MOST_SHOWN: usize = 4;

/// A place on the ground under the pointer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BrushHit {
    /// The terrain.
    pub terrain: Entity,
    /// The place in the world.
    pub point: Vec3,
}

/// Where the brush is; set in [`BrushSystems::Point`](super::BrushSystems::Point).
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq)]
pub struct BrushPointer {
    /// The ground under the pointer; `None` where there is none that may be edited: the brush is off,
    /// something is in the way, or egui wants the pointer.
    pub hit: Option<BrushHit>,
    /// Whether the pointer's primary button is down, or the finger.
    pub is_pressed: bool,
}

/// Edits that were refused lately.
#[derive(Resource, Debug, Default)]
pub struct BrushMessages {
    refused: VecDeque<(Duration, Option<Entity>, String)>,
}

impl BrushMessages {
    /// The sentences of what was refused on `terrain` in the last 8 s, the oldest first; `now` is
    /// `Time<Real>`'s elapsed time.
    pub fn refused(&self, terrain: Option<Entity>, now: Duration) -> impl Iterator<Item = &str> {
        let recent = move |(at, of, _): &&(Duration, Option<Entity>, String)| {
            now.saturating_sub(*at) < SHOWN_FOR
                && (of.is_none() || terrain.is_none_or(|t| Some(t) == *of))
        };
        let refused = self.refused.iter().filter(recent);
        refused.map(|(_, _, reason)| reason.as_str())
    }
}

pub(super) fn hear_refusals(
    refused: On<TerrainEditRefused>,
    mut messages: ResMut<BrushMessages>,
    time: Option<Res<Time<Real>>>,
) {
    let now = time.map_or(Duration::ZERO, |time| time.elapsed());
    if messages.refused.len() >= MOST_SHOWN {
        messages.refused.pop_front();
    }
    let what = (now, refused.terrain, refused.reason.clone());
    messages.refused.push_back(what);
}

/// What lies under pointers.
#[derive(SystemParam)]
pub(super) struct Pointers<'w, 's> {
    hovered: Option<Res<'w, HoverMap>>,
    presses: Query<'w, 's, (&'static PointerId, &'static PointerPress)>,
    terrains: Query<'w, 's, (), With<TerrainState>>,
    egui: Option<Res<'w, EguiWantsInput>>,
}

impl Pointers<'_, '_> {
    fn find(&self, brush: &TerrainBrush) -> BrushPointer {
        let mut found = BrushPointer::default();
        let (true, Some(hovered)) = (brush.on, &self.hovered) else {
            return found;
        };
        let egui = self.egui.as_ref();
        let is_free = egui.is_none_or(|egui| !egui.wants_any_pointer_input());
        for (id, press) in &self.presses {
            let hits = hovered.get(id).into_iter().flatten();
            let hit = hits
                .filter(|(terrain, hit)| {
                    self.terrains.contains(**terrain)
                        && brush.terrain.is_none_or(|only| only == **terrain)
                        && brush.camera.is_none_or(|only| only == hit.camera)
                })
                .find_map(|(&terrain, hit)| {
                    let point = hit.position?;
                    Some(BrushHit { terrain, point })
                });
            let hit = hit.filter(|_| is_free);
            let is_pressed = press.is_primary_pressed();
            // One that is pressed comes before one that only hovers.
            if (is_pressed, hit.is_some()) > (found.is_pressed, found.hit.is_some()) {
                found = BrushPointer { hit, is_pressed };
            }
        }
        found
    }
}

/// Finds the ground under the pointer.
pub(super) fn point(
    brush: Res<TerrainBrush>,
    pointers: Pointers,
    mut pointer: ResMut<BrushPointer>,
) {
    pointer.set_if_neq(pointers.find(&brush));
}

/// Takes the button of a stroke away from the game, before it looks at it.
pub(super) fn take_clicks(
    brush: Res<TerrainBrush>,
    pointers: Pointers,
    buttons: Option<ResMut<ButtonInput<MouseButton>>>,
    mut was_pressed: Local<bool>,
    mut is_taken: Local<bool>,
) {
    let found = pointers.find(&brush);
    if !found.is_pressed {
        *is_taken = false;
    } else if !*was_pressed {
        *is_taken = found.hit.is_some();
    }
    *was_pressed = found.is_pressed;
    if *is_taken
        && brush.takes_clicks
        && let Some(mut buttons) = buttons
    {
        buttons.reset(MouseButton::Left);
    }
}

/// How far apart a terrain's samples lie, in metres of the world.
pub(super) fn sample_m(state: &TerrainState, transform: &GlobalTransform) -> f32 {
    let scale = transform.affine().matrix3.x_axis.length();
    state.manifest().file.spacing_m as f32 * scale
}

/// Gives kinds that nobody has sized a size that can be seen, on the first terrain that the brush
/// meets.
pub(super) fn fit(
    pointer: Res<BrushPointer>,
    terrains: Query<(&TerrainState, &GlobalTransform)>,
    mut brush: ResMut<TerrainBrush>,
    mut is_fitted: Local<bool>,
) {
    if *is_fitted {
        return;
    }
    let met = brush.terrain.or(pointer.hit.map(|hit| hit.terrain));
    let Some(Ok((state, transform))) = met.map(|terrain| terrains.get(terrain)) else {
        return;
    };
    *is_fitted = true;
    brush.grow_to(sample_m(state, transform));
}

/// Whether the panel's tab has switched the brush on, and when the panel was last seen.
#[derive(Resource, Debug, Default)]
pub(super) struct BrushHand {
    frame: u64,
    seen: u64,
    /// Whether it was the tab.
    pub(super) is_tabs: bool,
}

impl BrushHand {
    /// The panel is open in this frame.
    pub(super) fn see(world: &mut World) {
        if let Some(mut hand) = world.get_resource_mut::<Self>() {
            hand.seen = hand.frame;
        }
    }

    /// The tab has switched the brush on or off.
    pub(super) fn switch(world: &mut World, on: bool) {
        if let Some(mut hand) = world.get_resource_mut::<Self>() {
            hand.is_tabs = on;
        }
    }
}

/// Switches a brush off that the panel's tab has switched on, when the panel is closed.
pub(super) fn lay_down(
    panel: Option<Res<TerrainPanel>>,
    mut hand: ResMut<BrushHand>,
    mut brush: ResMut<TerrainBrush>,
    mut was_open: Local<bool>,
) {
    hand.frame += 1;
    let is_open = panel.is_some_and(|panel| panel.is_open);
    let was_open = std::mem::replace(&mut *was_open, is_open);
    if !brush.on {
        hand.is_tabs = false;
    }
    // A panel in a game's own windows is open while it is shown.
    let is_closed = (was_open && !is_open) || hand.seen + 1 < hand.frame;
    if hand.is_tabs && is_closed {
        hand.is_tabs = false;
        brush.on = false;
    }
}

/// Does what keys ask for.
pub(super) fn obey_keys(
    mut typed: MessageReader<KeyboardInput>,
    held: Option<Res<ButtonInput<KeyCode>>>,
    egui: Option<Res<EguiWantsInput>>,
    pointer: Res<BrushPointer>,
    terrains: Query<(&TerrainState, &GlobalTransform)>,
    mut brush: ResMut<TerrainBrush>,
    mut commands: Commands,
) {
    let is_free = egui.is_none_or(|egui| !egui.wants_any_keyboard_input());
    if !(brush.on && brush.keys && is_free) {
        typed.clear();
        return;
    }
    let is_held = |keys: [KeyCode; 2]| held.as_ref().is_some_and(|held| held.any_pressed(keys));
    let is_command = is_held([KeyCode::ControlLeft, KeyCode::ControlRight])
        || is_held([KeyCode::SuperLeft, KeyCode::SuperRight]);
    let is_shifted = is_held([KeyCode::ShiftLeft, KeyCode::ShiftRight]);
    for key in typed.read().filter(|key| key.state == ButtonState::Pressed) {
        let Key::Character(character) = &key.logical_key else {
            continue;
        };
        let terrain = brush.terrain.or(pointer.hit.map(|hit| hit.terrain));
        let by = match character.as_str() {
            "[" => Some(1.0 / KEY_STEP),
            "]" => Some(KEY_STEP),
            _ => None,
        };
        if let Some(by) = by {
            let met = terrain.and_then(|terrain| terrains.get(terrain).ok());
            let least_m = met.map_or(LEAST_RADIUS_M, |(state, place)| sample_m(state, place));
            brush.scale_radius(by, least_m);
        }
        match character.as_str() {
            "z" | "Z" if is_command && is_shifted => {
                commands.queue(move |world: &mut World| redo_stroke(world, terrain));
            }
            "z" | "Z" if is_command => {
                commands.queue(move |world: &mut World| undo_stroke(world, terrain));
            }
            _ => {}
        }
    }
}

/// A stroke that goes on.
pub(super) struct Ongoing {
    terrain: Entity,
    /// The last edit's place, in metres of the terrain's own plane.
    last: DVec2,
    /// How high the ground was where it began, in metres of the terrain's own space.
    height_m: f64,
    seed: u32,
}

/// Whether [`apply`] has anything to do or to end.
pub(super) fn is_wanted(pointer: Res<BrushPointer>, mut was_pressed: Local<bool>) -> bool {
    let wanted = pointer.is_pressed || *was_pressed;
    *was_pressed = pointer.is_pressed;
    wanted
}

/// Makes the edits of this frame.
pub(super) fn apply(
    world: &mut World,
    mut ongoing: Local<Option<Ongoing>>,
    mut was_pressed: Local<bool>,
) {
    let pointer = *world.resource::<BrushPointer>();
    let begins = pointer.is_pressed && !*was_pressed;
    *was_pressed = pointer.is_pressed;
    if begins || !pointer.is_pressed {
        *ongoing = None;
    }
    let (true, Some(hit)) = (pointer.is_pressed, pointer.hit) else {
        return;
    };
    if begins {
        *ongoing = begin(world, hit);
    } else if let Some(stroke) = ongoing.as_mut()
        && stroke.terrain == hit.terrain
        && !go_on(world, stroke, hit)
    {
        *ongoing = None;
    }
}

fn begin(world: &mut World, hit: BrushHit) -> Option<Ongoing> {
    let mut brush = world.resource_mut::<TerrainBrush>();
    let seed = brush.seed;
    if brush.seed_follows_strokes {
        brush.seed = next_seed(seed);
    }
    let transform = world.get::<GlobalTransform>(hit.terrain)?;
    let local = transform.affine().inverse().transform_point3(hit.point);
    let log = world.get::<TerrainEdits>(hit.terrain)?.instance();
    world.resource_mut::<BrushHistory>().begin(hit.terrain, log);
    let stroke = Ongoing {
        terrain: hit.terrain,
        last: local.xz().as_dvec2(),
        height_m: local.y.into(),
        seed,
    };
    edit(world, &stroke, hit.point).then_some(stroke)
}

/// Follows the pointer; `false` where an edit was refused.
fn go_on(world: &mut World, stroke: &mut Ongoing, hit: BrushHit) -> bool {
    for _ in 0..MOST_A_FRAME {
        let brush = world.resource::<TerrainBrush>();
        let (Some(transform), Some(state)) = (
            world.get::<GlobalTransform>(stroke.terrain),
            world.get::<TerrainState>(stroke.terrain),
        ) else {
            return false;
        };
        let affine = transform.affine();
        let scale = f64::from(affine.matrix3.x_axis.length());
        let to = affine.inverse().transform_point3(hit.point).xz().as_dvec2();
        let spacing_m = state.manifest().file.spacing_m;
        let grown = brush.grown_on((spacing_m * scale) as f32);
        let step_m = f64::from(brush.step_m() * grown) / scale;
        let Some(next) = next_place(stroke.last, to, step_m) else {
            return true;
        };
        let height_m = match brush.kind {
            BrushKind::Flatten => stroke.height_m,
            _ => state
                .height(next)
                .map_or(stroke.height_m, |height| height.height_m),
        };
        let at = Vec3::new(next.x as f32, height_m as f32, next.y as f32);
        let at = affine.transform_point3(at);
        stroke.last = next;
        if !edit(world, stroke, at) {
            return false;
        }
    }
    true
}

/// Makes one edit and notes it; `false` where it was refused.
fn edit(world: &mut World, stroke: &Ongoing, at: Vec3) -> bool {
    let last = |world: &World| {
        let edits = world.get::<TerrainEdits>(stroke.terrain);
        edits
            .and_then(TerrainEdits::log)
            .map_or(0, |log| log.last_sequence())
    };
    let before = last(world);
    let brush = world.resource::<TerrainBrush>().clone();
    brush.trigger(world, stroke.terrain, at, stroke.seed);
    // What others make of it comes after it.
    let is_made = last(world) > before;
    if is_made {
        world.resource_mut::<BrushHistory>().add(before + 1);
    }
    is_made
}
