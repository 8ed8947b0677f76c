//! A terrain with a brush and a pointer, in an app without a window's system or a renderer.
#![allow(dead_code, reason = "each test file uses its own part")]

use super::streaming_support::World3;
use bevy::camera::{CameraProjection, ComputedCameraValues, RenderTargetInfo};
use bevy::ecs::system::SystemState;
use bevy::gizmos::{GizmoAsset, GizmoHandles};
use bevy::input::ButtonState;
use bevy::input::keyboard::{Key, KeyboardInput};
use bevy::picking::pointer::{Location, PointerAction, PointerId, PointerInput};
use bevy::picking::{InteractionPlugin, PickingPlugin};
use bevy::prelude::*;
use bevy::window::{PrimaryWindow, WindowRef};
use bevy_egui::EguiContext;
use bevy_egui::input::{EguiWantsInput, write_egui_wants_input_system};
use bevy_tessera::debug::TerrainChoice;
use bevy_tessera::debug::brush::{BrushGizmos, BrushPlugin, TerrainBrush};
use bevy_tessera::edit::{Change, Edit, EditLog, TerrainEdits};
use bevy_tessera::query::{TerrainPickingPlugin, TerrainQuery};
use bevy_tessera::stream::{TerrainPin, TerrainRegion};
use std::any::TypeId;

pub const SIZE: [u32; 2] = [700, 500];
pub const SCREEN: Vec2 = Vec2::new(800.0, 600.0);
/// What the camera looks at, above the ground.
pub const TARGET: Vec3 = Vec3::new(700.0, 100.0, 500.0);

pub struct Ground {
    pub world: World3,
    pub terrain: Entity,
    pub camera: Entity,
    window: Entity,
    at: Vec2,
}

impl Ground {
    /// A terrain that is resident as a whole, a camera that looks down on it, and a brush that is on.
    pub fn new() -> Self {
        Self::placed(Transform::IDENTITY)
    }

    /// The same with the terrain and the camera moved, turned and scaled together.
    pub fn placed(place: Transform) -> Self {
        let mut world = World3::in_app(SIZE, false, |app, _| {
            app.add_plugins((
                PickingPlugin,
                InteractionPlugin,
                TerrainPickingPlugin,
                bevy::input::InputPlugin,
                BrushPlugin,
            ))
            .init_resource::<EguiWantsInput>()
            .add_systems(PostUpdate, (see, write_egui_wants_input_system));
        });
        world.app.init_asset::<GizmoAsset>();
        let terrain = world.spawn(place);
        world.app.world_mut().spawn(TerrainPin {
            terrain,
            region: TerrainRegion::EVERYTHING,
            finest_level: 0,
        });
        world.settle(terrain);
        let at = world.app.world_mut();
        let window = at.spawn((Window::default(), PrimaryWindow)).id();
        let eye = TARGET + Vec3::new(0.0, 120.0, 90.0);
        let eye = Transform::from_translation(eye).looking_at(TARGET, Vec3::Y);
        let eye = Transform::from_matrix(place.to_matrix() * eye.to_matrix()).with_scale(Vec3::ONE);
        let camera = at.spawn((camera(), eye)).id();
        at.spawn(PointerId::Mouse);
        at.resource_mut::<TerrainBrush>().on = true;
        world.frame();
        Self {
            world,
            terrain,
            camera,
            window,
            at: Vec2::ZERO,
        }
    }

    pub fn app(&mut self) -> &mut World {
        self.world.app.world_mut()
    }

    pub fn brush(&mut self) -> Mut<'_, TerrainBrush> {
        self.world.app.world_mut().resource_mut::<TerrainBrush>()
    }

    pub fn log(&self) -> &EditLog {
        let edits = self.world.app.world().get::<TerrainEdits>(self.terrain);
        edits.and_then(TerrainEdits::log).expect("it has loaded")
    }

    pub fn newest(&self) -> &Edit {
        let (_, edit) = self.log().active().next_back().expect("an edit");
        edit
    }

    pub fn newest_change(&self) -> &Change {
        &self.newest().change
    }

    pub fn chosen(&self) -> TerrainChoice {
        TerrainChoice {
            camera: Some(self.camera),
            terrain: Some(self.terrain),
        }
    }

    fn input(&mut self, action: PointerAction) {
        let target = WindowRef::Primary.normalize(Some(self.window));
        let location = Location {
            target: bevy::camera::NormalizedRenderTarget::Window(target.expect("there is one")),
            position: self.at,
        };
        let input = PointerInput::new(PointerId::Mouse, location, action);
        self.app().write_message(input);
    }

    /// Moves the pointer on the screen and lets a frame pass.
    pub fn move_to(&mut self, at: Vec2) {
        let delta = at - self.at;
        self.at = at;
        self.input(PointerAction::Move { delta });
        self.world.frame();
    }

    pub fn press(&mut self) {
        self.input(PointerAction::Press(PointerButton::Primary));
        self.world.frame();
    }

    pub fn release(&mut self) {
        self.input(PointerAction::Release(PointerButton::Primary));
        self.world.frame();
    }

    pub fn click(&mut self, at: Vec2) {
        self.move_to(at);
        self.press();
        self.release();
    }

    /// From one place on the screen to another, in so many frames.
    pub fn drag(&mut self, from: Vec2, to: Vec2, frames: u32) {
        self.move_to(from);
        self.press();
        for frame in 1..=frames {
            self.move_to(from.lerp(to, frame as f32 / frames as f32));
        }
        // A pointer that is ahead is caught up with.
        for _ in 0..20 {
            self.world.frame();
        }
        self.release();
    }

    /// The ground that is seen at a place on the screen.
    pub fn seen_at(&mut self, at: Vec2) -> Vec3 {
        let world = self.world.app.world();
        let camera = world.get::<Camera>(self.camera).expect("a camera");
        let eye = world.get::<GlobalTransform>(self.camera).expect("an eye");
        let ray = camera.viewport_to_world(eye, at).expect("a ray");
        let hit = self.ask(|query| query.ray(ray, f32::INFINITY));
        hit.expect("looks at the ground").point
    }

    pub fn ask<T>(&mut self, question: impl FnOnce(&TerrainQuery) -> T) -> T {
        let mut state = SystemState::<TerrainQuery>::new(self.app());
        question(&state.get(self.world.app.world()).expect("valid"))
    }

    /// Types a character while other keys are held.
    pub fn type_key(&mut self, character: &str, code: KeyCode, held: &[KeyCode]) {
        let window = self.window;
        let key = |key_code, logical_key, state| KeyboardInput {
            key_code,
            logical_key,
            state,
            text: None,
            repeat: false,
            window,
        };
        for &code in held {
            let input = key(code, Key::Control, ButtonState::Pressed);
            self.app().write_message(input);
        }
        self.world.frame();
        for state in [ButtonState::Pressed, ButtonState::Released] {
            let input = key(code, Key::Character(character.into()), state);
            self.app().write_message(input);
        }
        self.world.frame();
        for &code in held {
            let input = key(code, Key::Control, ButtonState::Released);
            self.app().write_message(input);
        }
        self.world.frame();
    }

    /// Ends of the lines that the brush has drawn in the last frame, in pairs.
    pub fn lines(&self) -> Vec<Vec3> {
        let world = self.world.app.world();
        let handles = world.resource::<GizmoHandles>().handles();
        let handle = handles.get(&TypeId::of::<BrushGizmos>());
        let Some(Some(handle)) = handle else {
            return Vec::new();
        };
        let lines = world.resource::<Assets<GizmoAsset>>().get(handle);
        lines.expect("it is there").buffer().list_positions.clone()
    }

    /// Gives egui a context of its own, in which the pointer is over an area, or a text is typed.
    pub fn egui_wants(&mut self, pointer: bool, keyboard: bool) {
        use bevy_egui::egui;
        let mut context = EguiContext::default();
        let ctx = context.get_mut().clone();
        for _ in 0..3 {
            let mut input = egui::RawInput {
                screen_rect: Some(egui::Rect::from_min_size(
                    egui::Pos2::ZERO,
                    egui::vec2(SCREEN.x, SCREEN.y),
                )),
                ..Default::default()
            };
            let at = if pointer { 20.0 } else { 500.0 };
            input
                .events
                .push(egui::Event::PointerMoved(egui::pos2(at, at)));
            let _ = ctx.run_ui(input, |ui| {
                egui::Area::new("panel".into())
                    .fixed_pos(egui::Pos2::ZERO)
                    .show(ui.ctx(), |ui| {
                        ui.allocate_space(egui::vec2(100.0, 100.0));
                        let mut text = String::new();
                        let field = ui.text_edit_singleline(&mut text);
                        if keyboard {
                            field.request_focus();
                        }
                    });
            });
        }
        self.app().spawn(context);
        self.world.frame();
        let wants = self.world.app.world().resource::<EguiWantsInput>();
        assert_eq!(wants.wants_any_pointer_input(), pointer);
        assert_eq!(wants.wants_any_keyboard_input(), keyboard);
    }
}

/// What Bevy's `VisibilityPlugin` does, without its meshes.
fn see(mut seen: Query<&mut InheritedVisibility>) {
    for mut seen in &mut seen {
        seen.set_if_neq(InheritedVisibility::VISIBLE);
    }
}

/// A camera as its systems would leave it.
fn camera() -> impl Bundle {
    let projection = PerspectiveProjection {
        aspect_ratio: SCREEN.x / SCREEN.y,
        ..default()
    };
    let camera = Camera {
        computed: ComputedCameraValues {
            clip_from_view: projection.get_clip_from_view(),
            target_info: Some(RenderTargetInfo {
                physical_size: SCREEN.as_uvec2(),
                scale_factor: 1.0,
            }),
            ..default()
        },
        ..default()
    };
    (
        Camera3d::default(),
        camera,
        Projection::Perspective(projection),
    )
}
