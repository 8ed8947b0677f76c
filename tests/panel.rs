//! The panel in an app: drawn over the ground, opened by its key, with whatever cameras and terrains
//! there are.

mod common;

use bevy::camera::Viewport;
use bevy::input::ButtonState;
use bevy::input::keyboard::{Key, KeyboardInput};
use bevy::input::mouse::{AccumulatedMouseScroll, MouseScrollUnit, MouseWheel};
use bevy::input::touch::{TouchInput, TouchPhase};
use bevy::prelude::*;
use bevy::render::settings::WgpuSettings;
use bevy_egui::input::EguiWantsInput;
use bevy_egui::{PrimaryEguiContext, egui};
use bevy_tessera::debug::{
    MapColour, PanelPlace, TerrainChoice, TerrainDebugPlugin, TerrainDebugTab, TerrainPanel,
};
use bevy_tessera::render::{
    ComparisonCamera, ComparisonView, TerrainComparison, TerrainOverlay, TerrainOverlays,
};
use bevy_tessera::terrain::{Terrain, TerrainCamera};
use common::app;
use common::scene::{assets_with_hills, share_beyond};
use common::stage::Stage;
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use image::RgbImage;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};

const SIZE: [u32; 2] = [800, 450];

fn assets() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| assets_with_hills("panel"))
}

fn eye() -> Transform {
    Transform::from_xyz(130.0, 115.0, 590.0).looking_at(Vec3::new(370.0, 30.0, 310.0), Vec3::Y)
}

/// A lit landscape, with or without the plugin.
fn stage(has_panel: bool) -> Stage {
    stage_of(SIZE, has_panel)
}

fn stage_of(size: [u32; 2], has_panel: bool) -> Stage {
    let mut stage = Stage::with(
        "panel",
        assets(),
        "hills/terrain.ron",
        size,
        false,
        WgpuSettings::default(),
        |app| {
            if has_panel {
                app.add_plugins(TerrainDebugPlugin);
            }
        },
    );
    stage.app.world_mut().spawn((
        DirectionalLight {
            illuminance: 4_000.0,
            ..default()
        },
        Transform::from_xyz(0.75, 0.38, 0.45).looking_at(Vec3::ZERO, Vec3::Y),
    ));
    stage.aim(eye(), |_| {});
    stage
}

fn press(app: &mut App, key: KeyCode) {
    for state in [ButtonState::Pressed, ButtonState::Released] {
        app.world_mut().write_message(KeyboardInput {
            key_code: key,
            logical_key: Key::F3,
            state,
            text: None,
            repeat: false,
            window: Entity::PLACEHOLDER,
        });
        app.update();
    }
}

fn is_open(app: &App) -> bool {
    app.world().resource::<TerrainPanel>().is_open
}

fn open(app: &mut App) {
    app.world_mut().resource_mut::<TerrainPanel>().is_open = true;
}

/// Columns of a picture.
fn columns(picture: &RgbImage, range: std::ops::Range<u32>) -> RgbImage {
    image::imageops::crop_imm(
        picture,
        range.start,
        0,
        range.len() as u32,
        picture.height(),
    )
    .to_image()
}

/// Share of pixels that have the colour of egui's panels.
fn panel_share(picture: &RgbImage) -> f32 {
    let fill = egui::Visuals::dark().panel_fill;
    let alike = picture.pixels().filter(|pixel| {
        let of = [fill.r(), fill.g(), fill.b()];
        pixel.0.iter().zip(of).all(|(a, b)| a.abs_diff(b) <= 2)
    });
    alike.count() as f32 / (picture.width() * picture.height()) as f32
}

/// Whether two pictures show the same.
fn is_alike(a: &RgbImage, b: &RgbImage) -> bool {
    share_beyond(a, b, 4) < 0.001
}

#[test]
fn the_panel_is_drawn_beside_the_ground_and_gone_when_it_is_closed() {
    let bare = stage(false).shoot("without", 4);
    let mut stage = stage(true);
    let closed = stage.shoot("closed", 4);
    assert_eq!(
        share_beyond(&bare, &closed, 0),
        0.0,
        "closed, it is not there"
    );
    press(&mut stage.app, KeyCode::F3);
    assert!(is_open(&stage.app));
    let opened = stage.shoot("open", 4);
    let (left, right) = (0..SIZE[0] - 400, SIZE[0] - 330..SIZE[0]);
    let ground = |picture| columns(picture, left.clone());
    assert!(is_alike(&ground(&bare), &ground(&opened)));
    let panel = columns(&opened, right.clone());
    let share = panel_share(&panel);
    assert!(share > 0.5, "{share} of the panel is its background");
    assert!(
        share < 0.98,
        "{share} of the panel is its background: it is empty"
    );
    assert!(panel_share(&columns(&bare, right)) < 0.05);
    press(&mut stage.app, KeyCode::F3);
    assert!(!is_open(&stage.app));
    let closed = stage.shoot("closed_again", 4);
    assert_eq!(
        share_beyond(&bare, &closed, 0),
        0.0,
        "closed again, it is gone"
    );
}

#[test]
fn it_is_docked_where_it_is_told() {
    let mut stage = stage(true);
    let bare = stage.shoot("places_closed", 4);
    open(&mut stage.app);
    let half = SIZE[0] / 2;
    for (place, name) in [(PanelPlace::Left, "left"), (PanelPlace::Right, "right")] {
        stage.app.world_mut().resource_mut::<TerrainPanel>().place = place;
        let picture = stage.shoot(name, 4);
        let is_left = place == PanelPlace::Left;
        for (is_its, side) in [(is_left, 0..half), (!is_left, half..SIZE[0])] {
            let changed = share_beyond(&columns(&bare, side.clone()), &columns(&picture, side), 4);
            assert_eq!(changed > 0.5, is_its, "{name}: {changed}");
        }
    }
    stage.app.world_mut().resource_mut::<TerrainPanel>().place = PanelPlace::Window;
    let picture = stage.shoot("window", 4);
    assert!(panel_share(&picture) > 0.15);
    let edge = columns(&picture, 0..20);
    assert!(is_alike(&columns(&bare, 0..20), &edge));
}

#[test]
fn a_key_that_is_another_one_or_none_opens_it_or_does_not() {
    let mut stage = stage(true);
    let panel = |app: &mut App, key| app.world_mut().resource_mut::<TerrainPanel>().key = key;
    panel(&mut stage.app, Some(KeyCode::KeyP));
    press(&mut stage.app, KeyCode::F3);
    assert!(!is_open(&stage.app));
    press(&mut stage.app, KeyCode::KeyP);
    assert!(is_open(&stage.app));
    panel(&mut stage.app, None);
    press(&mut stage.app, KeyCode::KeyP);
    assert!(is_open(&stage.app));
}

#[test]
fn it_is_there_again_after_the_camera_that_it_was_drawn_over_is_gone() {
    let mut stage = stage(true);
    open(&mut stage.app);
    stage.shoot("first_camera", 2);
    // Despawns the camera, and with it bevy_egui's context.
    stage.aim(eye(), |_| {});
    let picture = stage.shoot("second_camera", 4);
    let share = panel_share(&columns(&picture, SIZE[0] - 330..SIZE[0]));
    assert!(share > 0.5, "{share} of the panel is its background");
    let camera = stage.camera.unwrap();
    assert!(
        stage
            .app
            .world()
            .get::<PrimaryEguiContext>(camera)
            .is_some()
    );
}

#[test]
fn it_runs_where_there_is_no_camera_no_terrain_and_no_context() {
    let mut app = app::app(assets(), false);
    app.add_plugins(TerrainDebugPlugin);
    app::finish(&mut app);
    open(&mut app);
    for _ in 0..4 {
        app.update();
    }
    let target = app::target(&mut app, 64, 64);
    let camera = app
        .world_mut()
        .spawn((Camera3d::default(), app::into_image(&target)))
        .id();
    for _ in 0..4 {
        app.update();
    }
    app.world_mut().despawn(camera);
    app.world_mut().remove_resource::<TerrainPanel>();
    for _ in 0..4 {
        app.update();
    }
}

#[test]
fn without_a_renderer_it_is_a_resource() {
    let mut app = App::new();
    app.add_plugins((MinimalPlugins, TerrainDebugPlugin));
    app.update();
    assert!(app.world().contains_resource::<TerrainPanel>());
}

/// Gives egui what happens to the pointer or the keyboard, and a frame to see it.
fn happen(stage: &mut Stage, event: egui::Event) {
    let camera = stage.camera.unwrap();
    let mut input = stage
        .app
        .world_mut()
        .get_mut::<bevy_egui::EguiInput>(camera)
        .unwrap();
    input.events.push(event);
    stage.app.update();
}

fn point(stage: &mut Stage, x: f32) {
    happen(stage, egui::Event::PointerMoved(egui::pos2(x, 200.0)));
    stage.app.update();
}

fn press_at(stage: &mut Stage, x: f32, pressed: bool) {
    let event = egui::Event::PointerButton {
        pos: egui::pos2(x, 200.0),
        button: egui::PointerButton::Primary,
        pressed,
        modifiers: egui::Modifiers::NONE,
    };
    happen(stage, event);
}

/// Whether the game sees that a button is held; that the wheel is turned, as a sum and as messages;
/// that the screen is touched, as touches and as messages.
fn sees(stage: &mut Stage) -> [bool; 5] {
    let world = stage.app.world_mut();
    world
        .resource_mut::<ButtonInput<MouseButton>>()
        .press(MouseButton::Left);
    world.write_message(MouseWheel {
        unit: MouseScrollUnit::Line,
        x: 0.0,
        y: 1.0,
        window: Entity::PLACEHOLDER,
        phase: TouchPhase::Moved,
    });
    world.write_message(TouchInput {
        phase: TouchPhase::Started,
        position: Vec2::splat(100.0),
        window: Entity::PLACEHOLDER,
        force: None,
        id: 7,
    });
    stage.app.update();
    let world = stage.app.world_mut();
    let mut buttons = world.resource_mut::<ButtonInput<MouseButton>>();
    let sees_button = buttons.pressed(MouseButton::Left);
    buttons.reset_all();
    let mut touches = world.resource_mut::<Touches>();
    let sees_touch = touches.any_just_pressed();
    touches.reset_all();
    let mut wheel = world.resource_mut::<Messages<MouseWheel>>();
    let sees_wheel = wheel.drain().next().is_some();
    let mut touched = world.resource_mut::<Messages<TouchInput>>();
    let sees_touched = touched.drain().next().is_some();
    let scroll = world.resource::<AccumulatedMouseScroll>().delta;
    [
        sees_button,
        scroll != Vec2::ZERO,
        sees_wheel,
        sees_touch,
        sees_touched,
    ]
}

#[test]
fn the_game_sees_no_input_that_is_meant_for_the_panel() {
    let mut stage = stage(true);
    open(&mut stage.app);
    stage.shoot("input", 2);
    point(&mut stage, 100.0);
    assert_eq!(sees(&mut stage), [true; 5], "beside the panel");
    point(&mut stage, SIZE[0] as f32 - 100.0);
    let wants = stage.app.world().resource::<EguiWantsInput>().clone();
    assert!(wants.wants_pointer_input(), "egui knows of the panel");
    assert_eq!(sees(&mut stage), [false; 5], "over the panel");
    let mut panel = stage.app.world_mut().resource_mut::<TerrainPanel>();
    panel.absorbs_input = false;
    assert_eq!(
        sees(&mut stage),
        [true; 5],
        "over the panel, which is told not to"
    );
}

#[test]
fn while_a_field_has_the_keyboard_the_game_sees_no_keys_but_held_modifiers() {
    let mut stage = stage(true);
    open(&mut stage.app);
    stage.shoot("keys", 2);
    let sees = |stage: &mut Stage| {
        let world = stage.app.world_mut();
        for (key_code, logical_key) in [
            (KeyCode::KeyW, Key::Character("w".into())),
            (KeyCode::ShiftLeft, Key::Shift),
        ] {
            world.write_message(KeyboardInput {
                key_code,
                logical_key,
                state: ButtonState::Pressed,
                text: None,
                repeat: false,
                window: Entity::PLACEHOLDER,
            });
        }
        stage.app.update();
        let world = stage.app.world_mut();
        let mut codes = world.resource_mut::<ButtonInput<KeyCode>>();
        let seen_codes = [KeyCode::KeyW, KeyCode::ShiftLeft].map(|code| codes.pressed(code));
        codes.reset_all();
        let mut keys = world.resource_mut::<ButtonInput<Key>>();
        let seen_keys =
            [Key::Character("w".into()), Key::Shift].map(|key| keys.pressed(key.clone()));
        keys.reset_all();
        let mut messages = world.resource_mut::<Messages<KeyboardInput>>();
        let has_messages = messages.drain().next().is_some();
        (seen_codes, seen_keys, has_messages)
    };
    assert_eq!(sees(&mut stage), ([true; 2], [true; 2], true));
    // The key that goes on to the next field has egui choose one.
    happen(
        &mut stage,
        egui::Event::Key {
            key: egui::Key::Tab,
            physical_key: None,
            pressed: true,
            repeat: false,
            modifiers: egui::Modifiers::NONE,
        },
    );
    stage.app.update();
    let wants = stage.app.world().resource::<EguiWantsInput>();
    assert!(wants.wants_keyboard_input(), "a field has the keyboard");
    assert_eq!(sees(&mut stage), ([false, true], [false, true], false));
    // One that stays held is not pressed anew.
    stage
        .app
        .world_mut()
        .resource_mut::<ButtonInput<KeyCode>>()
        .press(KeyCode::ShiftLeft);
    stage.app.update();
    let codes = stage.app.world().resource::<ButtonInput<KeyCode>>();
    assert!(codes.pressed(KeyCode::ShiftLeft));
    assert!(!codes.just_pressed(KeyCode::ShiftLeft));
}

#[test]
fn the_line_of_a_comparison_is_dragged_in_the_picture_with_the_panel_closed() {
    let mut stage = stage(true);
    let camera = stage.camera.unwrap();
    // The right half: its middle is at 600.
    let mut entity = stage.app.world_mut().entity_mut(camera);
    entity.insert(TerrainComparison::default());
    entity.get_mut::<Camera>().unwrap().viewport = Some(Viewport {
        physical_position: UVec2::new(400, 0),
        physical_size: UVec2::new(400, 450),
        ..default()
    });
    let divider = |stage: &Stage| {
        let comparison = stage.app.world().get::<TerrainComparison>(camera);
        match comparison.unwrap().view {
            ComparisonView::Split { divider } => divider,
            ComparisonView::Difference { .. } => unreachable!("nobody has asked for it"),
        }
    };
    for _ in 0..4 {
        stage.app.update();
    }
    point(&mut stage, 500.0);
    assert_eq!(sees(&mut stage), [true; 5], "beside the line");
    press_at(&mut stage, 500.0, true);
    point(&mut stage, 550.0);
    press_at(&mut stage, 550.0, false);
    assert_eq!(divider(&stage), 0.5, "a drag beside the line");
    point(&mut stage, 602.0);
    assert_eq!(sees(&mut stage), [false; 5], "over the line");
    press_at(&mut stage, 602.0, true);
    for (x, place) in [(640.0, 0.6), (700.0, 0.75), (2000.0, 1.0), (500.0, 0.25)] {
        point(&mut stage, x);
        let is = divider(&stage);
        assert!((is - place).abs() < 1e-4, "at {x} it is {is}");
        assert_eq!(sees(&mut stage), [false; 5], "while it is dragged");
    }
    press_at(&mut stage, 500.0, false);
    point(&mut stage, 700.0);
    assert_eq!(divider(&stage), 0.25, "let go");
    assert_eq!(sees(&mut stage), [true; 5]);
    assert!(!is_open(&stage.app));
    // What isn't a number is drawn in the middle, and dragged from there.
    let mut entity = stage.app.world_mut().entity_mut(camera);
    let mut comparison = entity.get_mut::<TerrainComparison>().unwrap();
    comparison.view = ComparisonView::Split { divider: f32::NAN };
    point(&mut stage, 600.0);
    assert!(divider(&stage).is_nan(), "a look changes nothing");
    press_at(&mut stage, 600.0, true);
    point(&mut stage, 700.0);
    assert!((divider(&stage) - 0.75).abs() < 1e-4);
    press_at(&mut stage, 700.0, false);
    // Under the panel there is no line to drag.
    stage.app.world_mut().resource_mut::<TerrainPanel>().is_open = true;
    for _ in 0..4 {
        point(&mut stage, 700.0);
    }
    press_at(&mut stage, 700.0, true);
    point(&mut stage, 500.0);
    press_at(&mut stage, 500.0, false);
    assert!((divider(&stage) - 0.75).abs() < 1e-4, "under the panel");
}

/// Pixels of a picture that have a colour.
fn pixels_of(picture: &RgbImage, color: [u8; 3]) -> usize {
    let alike = picture.pixels().filter(|pixel| {
        let mut parts = pixel.0.iter().zip(color);
        parts.all(|(a, b)| a.abs_diff(b) <= 3)
    });
    alike.count()
}

#[test]
fn every_tab_is_drawn_in_its_own_colours() {
    const TALL: [u32; 2] = [800, 900];
    let mut stage = stage_of(TALL, true);
    open(&mut stage.app);
    let camera = stage.camera.unwrap();
    let overlays = TerrainOverlays::only(TerrainOverlay::Level);
    stage.app.world_mut().entity_mut(camera).insert(overlays);
    let mut pictures = Vec::new();
    for tab in ["Settings", "Views", "Statistics", "Map", "Edit"] {
        let mut panel = stage.app.world_mut().resource_mut::<TerrainPanel>();
        panel.shown_tab = Some(tab);
        let picture = stage.shoot(&format!("tab_{tab}"), 8);
        // Below the header and the titles of the tabs.
        let content = columns(&picture, TALL[0] - 380..TALL[0]);
        let content = image::imageops::crop_imm(&content, 0, 100, 380, TALL[1] - 100).to_image();
        let share = panel_share(&content);
        assert!(share < 0.985, "{tab}: {share} of it is background");
        pictures.push((tab, content));
    }
    for (number, (tab, picture)) in pictures.iter().enumerate() {
        for (other, another) in &pictures[number + 1..] {
            let differing = share_beyond(picture, another, 8);
            assert!(differing > 0.01, "{tab} and {other} differ by {differing}");
        }
    }
    let [_, (_, views), _, (_, map), _] = &pictures[..] else {
        unreachable!("five tabs")
    };
    for stop in TerrainOverlay::Level.legend() {
        let color = Srgba::from(stop.color).to_u8_array_no_alpha();
        let count = pixels_of(views, color);
        assert!(count >= 60, "{}: {count} pixels", stop.label);
    }
    for colour in MapColour::ALL {
        if colour == MapColour::Drawn {
            // Lets what is below shine through.
            continue;
        }
        let [red, green, blue, _] = colour.colour().to_array();
        let count = pixels_of(map, [red, green, blue]);
        assert!(count >= 40, "{}: {count} pixels", colour.label());
    }
}

/// A panel in a game's own egui.
struct Game {
    world: World,
    panel: TerrainPanel,
}

fn harness(game: Game) -> Harness<'static, Game> {
    Harness::builder()
        .with_size([360.0, 700.0])
        .with_max_steps(20)
        .build_ui_state(
            |ui, game: &mut Game| game.panel.ui(ui, &mut game.world),
            game,
        )
}

fn game() -> Game {
    Game {
        world: World::new(),
        panel: TerrainPanel::default(),
    }
}

/// Counts what is asked of it.
struct CountingTab {
    title: &'static str,
    shown: &'static AtomicU32,
    updated: &'static AtomicU32,
}

impl TerrainDebugTab for CountingTab {
    fn title(&self) -> &'static str {
        self.title
    }

    fn ui(&mut self, ui: &mut egui::Ui, world: &mut World, chosen: TerrainChoice) {
        self.shown.fetch_add(1, Ordering::Relaxed);
        ui.label(format!(
            "camera {:?}, {} entities",
            chosen.camera,
            world.entities().len()
        ));
        ui.label("the game's own");
    }

    fn update(&mut self, _: &mut World, _: TerrainChoice) {
        self.updated.fetch_add(1, Ordering::Relaxed);
    }
}

#[test]
fn a_game_adds_tabs_and_takes_them_away_in_its_own_egui() {
    static SHOWN: AtomicU32 = AtomicU32::new(0);
    static UPDATED: AtomicU32 = AtomicU32::new(0);
    let mut panel = harness(game());
    assert!(panel.query_by_label("Settings").is_some());
    let tab = CountingTab {
        title: "Weather",
        shown: &SHOWN,
        updated: &UPDATED,
    };
    panel.state_mut().panel.tabs.push(Box::new(tab));
    panel.run();
    assert_eq!(SHOWN.load(Ordering::Relaxed), 0, "another tab is on top");
    let frames = UPDATED.load(Ordering::Relaxed);
    assert!(frames > 0, "tabs that aren't seen go on");
    panel.step();
    assert_eq!(UPDATED.load(Ordering::Relaxed), frames + 1, "once a frame");
    panel.state_mut().panel.shown_tab = Some("Weather");
    panel.run();
    assert!(SHOWN.load(Ordering::Relaxed) > 0);
    assert!(panel.query_by_label("the game's own").is_some());
    panel.state_mut().panel.tabs.pop();
    panel.run();
    assert!(panel.query_by_label("the game's own").is_none());
    assert!(panel.query_by_label("Weather").is_none());
}

#[test]
fn a_camera_and_a_terrain_are_chosen_by_name_and_others_take_the_place_of_those_that_are_gone() {
    let mut game = game();
    let world = &mut game.world;
    let [first, second] = ["north", "south"].map(|name| {
        world
            .spawn((TerrainCamera::default(), Name::new(name)))
            .id()
    });
    let [plain, rough] = [(); 2].map(|()| world.spawn(Terrain::default()).id());
    let mut panel = harness(game);
    let choice = |panel: &mut Harness<Game>| {
        let Game { world, panel } = panel.state_mut();
        panel.choice(world)
    };
    let chosen = |camera, terrain| TerrainChoice { camera, terrain };
    assert_eq!(choice(&mut panel), chosen(Some(first), Some(plain)));
    let role = egui::accesskit::Role::ComboBox;
    let pick = |panel: &mut Harness<Game>, what: &str, name: &str| {
        panel.get_by_role_and_label(role, what).click();
        panel.step();
        panel.run();
        panel
            .get_by_role_and_label(egui::accesskit::Role::Button, name)
            .click();
        panel.step();
        panel.run();
    };
    pick(&mut panel, "camera", "south");
    assert_eq!(choice(&mut panel), chosen(Some(second), Some(plain)));
    pick(&mut panel, "terrain", &rough.to_string());
    assert_eq!(choice(&mut panel), chosen(Some(second), Some(rough)));
    panel.state_mut().world.despawn(second);
    panel.run();
    assert_eq!(choice(&mut panel), chosen(Some(first), Some(rough)));
    // One that is no terrain any more is none to choose.
    panel
        .state_mut()
        .world
        .entity_mut(rough)
        .remove::<Terrain>();
    panel.run();
    assert_eq!(choice(&mut panel), chosen(Some(first), Some(plain)));
    panel.state_mut().world.despawn(first);
    panel.state_mut().world.despawn(plain);
    for tab in ["Settings", "Views", "Statistics", "Map", "Edit"] {
        panel.state_mut().panel.shown_tab = Some(tab);
        panel.run();
        assert_eq!(choice(&mut panel), chosen(None, None));
    }
}

#[test]
fn what_was_chosen_stays_whatever_becomes_of_the_others() {
    let mut game = game();
    let world = &mut game.world;
    let [first, second] = [(); 2].map(|()| world.spawn(TerrainCamera::default()).id());
    let [plain, rough] = [(); 2].map(|()| world.spawn(Terrain::default()).id());
    // The second camera of a comparison is nobody's choice.
    let helper = world
        .spawn((TerrainCamera::default(), ComparisonCamera(first)))
        .id();
    let chosen = TerrainChoice {
        camera: Some(first),
        terrain: Some(plain),
    };
    let Game { world, panel } = &mut game;
    assert_eq!(panel.choice(world), chosen);
    // The order of queries is another one from here on.
    world
        .entity_mut(first)
        .insert(TerrainOverlays::only(TerrainOverlay::Level));
    world.entity_mut(plain).insert(Name::new("plain"));
    assert_eq!(panel.choice(world), chosen);
    let mut fresh = TerrainPanel::default();
    assert_eq!(fresh.choice(world), chosen, "for a new panel, too");
    world.entity_mut(first).remove::<TerrainOverlays>();
    assert_eq!(panel.choice(world), chosen);
    panel.camera = Some(helper);
    assert_eq!(panel.choice(world), chosen);
    // Without its component another is shown; with it, it is there again.
    panel.camera = Some(second);
    world.entity_mut(second).remove::<TerrainCamera>();
    assert_eq!(panel.choice(world), chosen);
    world.entity_mut(second).insert(TerrainCamera::default());
    assert_eq!(panel.choice(world).camera, Some(second));
    world.despawn(second);
    world.despawn(plain);
    assert_eq!(
        panel.choice(world),
        TerrainChoice {
            camera: Some(first),
            terrain: Some(rough),
        }
    );
    assert_eq!([panel.camera, panel.terrain], [Some(first), Some(rough)]);
}

#[test]
fn its_own_buttons_close_it_and_move_it() {
    let mut game = game();
    game.panel.is_open = true;
    let mut panel = harness(game);
    for (label, place) in [
        ("dock the panel to the left", PanelPlace::Left),
        ("make the panel a window", PanelPlace::Window),
        ("dock the panel to the right", PanelPlace::Right),
    ] {
        panel.get_by_label(label).click();
        panel.step();
        panel.run();
        assert_eq!(panel.state().panel.place, place);
    }
    panel.get_by_label("close the panel").click();
    panel.step();
    assert!(!panel.state().panel.is_open);
}
