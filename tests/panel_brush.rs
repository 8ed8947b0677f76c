//! The brush edits the ground under the pointer, and its tab sets it, takes strokes back, lists the log
//! and saves it.

mod brush_support;
mod common;
mod streaming_support;

use bevy::math::DVec2;
use bevy::prelude::*;
use bevy_tessera::debug::brush::{
    BrushKind, BrushMessages, BrushTab, TerrainBrush, redo_stroke, undo_stroke,
};
use bevy_tessera::debug::{TerrainDebugTab, TerrainPanel};
use bevy_tessera::edit::{Change, EDIT_UNITS, StampImage};
use brush_support::{Ground, SCREEN};

const SPACING_M: f64 = 2.0;
const MIDDLE: Vec2 = Vec2::new(0.5 * SCREEN.x, 0.5 * SCREEN.y);

/// An edit's centre in metres of the terrain.
fn centre_m(centre: [i32; 2]) -> DVec2 {
    DVec2::from(centre.map(f64::from)) * (SPACING_M / f64::from(EDIT_UNITS))
}

fn image() -> StampImage {
    StampImage::from_grey8(2, &[0, 255, 255, 0]).expect("an image")
}

#[test]
fn a_click_makes_a_crater_at_the_ground_under_the_pointer() {
    for place in [
        Transform::IDENTITY,
        Transform::from_xyz(300.0, -40.0, -900.0)
            .with_rotation(Quat::from_rotation_y(0.8))
            .with_scale(Vec3::splat(0.5)),
    ] {
        let mut ground = Ground::placed(place);
        for at in [MIDDLE, Vec2::new(230.0, 410.0)] {
            let wanted = ground.seen_at(at);
            let before = ground.log().len();
            ground.click(at);
            assert_eq!(ground.log().len(), before + 1);
            let local = place.to_matrix().inverse().transform_point3(wanted);
            let off = centre_m(ground.newest().centre).distance(local.xz().as_dvec2());
            assert!(off < 0.1, "{off} m from what is under the pointer");
            assert!(matches!(ground.newest_change(), Change::Crater { .. }));
            // A held button makes no second one.
            ground.press();
            for _ in 0..5 {
                ground.world.frame();
            }
            ground.release();
            assert_eq!(ground.log().len(), before + 2);
        }
    }
}

#[test]
fn dragging_paints_edits_that_lie_the_spacing_apart() {
    let mut ground = Ground::new();
    {
        let mut brush = ground.brush();
        brush.kind = BrushKind::Raise;
        brush.set_radius_m(5.0);
        // What is painted would lift the ground under the pointer.
        brush.raise.by_m = 0.05;
        brush.spacing = 0.8;
    }
    let (from, to) = (Vec2::new(200.0, 300.0), Vec2::new(620.0, 330.0));
    let ends = [from, to].map(|at| ground.seen_at(at));
    ground.drag(from, to, 7);
    let places: Vec<_> = ground
        .log()
        .active()
        .map(|(_, edit)| centre_m(edit.centre))
        .collect();
    let way = ends[0].xz().distance(ends[1].xz());
    let wanted = 1 + (way / 4.0) as usize;
    assert!(
        places.len().abs_diff(wanted) <= 2,
        "{} edits on {way} m",
        places.len()
    );
    for pair in places.windows(2) {
        let apart = pair[0].distance(pair[1]);
        assert!((apart - 4.0).abs() < 0.1, "{apart} m apart");
    }
    // Nothing is painted after the button is up.
    let count = ground.log().len();
    ground.move_to(MIDDLE);
    ground.world.frame();
    assert_eq!(ground.log().len(), count);
}

#[test]
fn nothing_is_done_while_egui_wants_the_pointer_or_the_brush_is_off_or_elsewhere() {
    let mut ground = Ground::new();
    ground.move_to(MIDDLE);
    assert!(!ground.lines().is_empty());
    let context = {
        ground.egui_wants(true, false);
        let mut contexts = ground
            .app()
            .query_filtered::<Entity, With<bevy_egui::EguiContext>>();
        contexts.single(ground.world.app.world()).expect("one")
    };
    ground.click(MIDDLE);
    assert_eq!(ground.lines().len(), 0);
    ground.app().despawn(context);
    ground.world.frame();
    assert!(ground.log().is_empty());
    // A button that went down over the panel paints nothing when it comes to the ground.
    ground.egui_wants(true, false);
    ground.move_to(MIDDLE);
    ground.press();
    let mut contexts = ground
        .app()
        .query_filtered::<Entity, With<bevy_egui::EguiContext>>();
    let context = contexts.single(ground.world.app.world()).expect("one");
    ground.app().despawn(context);
    ground.world.frame();
    ground.move_to(Vec2::new(500.0, 400.0));
    ground.move_to(Vec2::new(300.0, 200.0));
    ground.release();
    assert!(ground.log().is_empty());

    ground.brush().on = false;
    ground.click(MIDDLE);
    assert_eq!(ground.lines().len(), 0);
    let camera = ground.camera;
    *ground.brush() = TerrainBrush {
        on: true,
        // No terrain has this entity.
        terrain: Some(camera),
        ..default()
    };
    ground.click(MIDDLE);
    let terrain = ground.terrain;
    *ground.brush() = TerrainBrush {
        on: true,
        camera: Some(terrain),
        ..default()
    };
    ground.click(MIDDLE);
    assert!(ground.log().is_empty());
    ground.brush().camera = None;
    ground.click(MIDDLE);
    assert_eq!(ground.log().len(), 1);
}

#[test]
fn keys_change_the_radius_and_take_strokes_back_and_make_them_again() {
    let control = [KeyCode::ControlLeft];
    let both = [KeyCode::ControlLeft, KeyCode::ShiftLeft];
    let mut ground = Ground::new();
    let first = ground.brush().radius_m();
    ground.type_key("]", KeyCode::BracketRight, &[]);
    assert!((ground.brush().radius_m() - 1.15 * first).abs() < 1e-4);
    ground.type_key("[", KeyCode::BracketLeft, &[]);
    ground.type_key("[", KeyCode::BracketLeft, &[]);
    assert!((ground.brush().radius_m() - first / 1.15).abs() < 1e-4);

    ground.click(MIDDLE);
    ground.drag(Vec2::new(200.0, 300.0), Vec2::new(600.0, 320.0), 9);
    let painted = ground.log().active_count();
    assert!(painted > 5);
    let whole = ground.log().len();
    ground.type_key("z", KeyCode::KeyZ, &control);
    assert_eq!(ground.log().active_count(), 1, "the stroke as a whole");
    ground.type_key("z", KeyCode::KeyZ, &control);
    assert_eq!(ground.log().active_count(), 0);
    ground.type_key("Z", KeyCode::KeyZ, &both);
    assert_eq!(ground.log().active_count(), 1);
    ground.type_key("Z", KeyCode::KeyZ, &both);
    assert_eq!(ground.log().active_count(), painted);
    assert_eq!(ground.log().len(), whole + 2 * painted);

    // Not without Ctrl, not while a text is typed, and not if it is told not to.
    ground.type_key("z", KeyCode::KeyZ, &[]);
    ground.brush().keys = false;
    ground.type_key("z", KeyCode::KeyZ, &control);
    ground.type_key("[", KeyCode::BracketLeft, &[]);
    ground.brush().keys = true;
    ground.brush().on = false;
    ground.type_key("z", KeyCode::KeyZ, &control);
    ground.brush().on = true;
    ground.egui_wants(false, true);
    ground.type_key("z", KeyCode::KeyZ, &control);
    ground.type_key("]", KeyCode::BracketRight, &[]);
    assert_eq!(ground.log().active_count(), painted);
    assert!((ground.brush().radius_m() - first / 1.15).abs() < 1e-4);
}

#[test]
fn a_stroke_that_is_taken_back_leaves_the_ground_as_it_was() {
    let mut ground = Ground::new();
    let hash = |ground: &Ground| {
        let state = ground.world.state(ground.terrain);
        let everything = bevy_tessera::stream::TerrainRegion::EVERYTHING;
        state.ground_hash(&everything).expect("all is resident")
    };
    let before = hash(&ground);
    ground.drag(Vec2::new(200.0, 300.0), Vec2::new(600.0, 320.0), 9);
    let painted = hash(&ground);
    assert_ne!(painted, before);
    undo_stroke(ground.app(), None);
    assert_eq!(hash(&ground), before);
    let terrain = Some(ground.terrain);
    redo_stroke(ground.app(), terrain);
    assert_eq!(hash(&ground), painted);
    // A new edit ends what can be done again; one that isn't the brush's is taken back alone.
    undo_stroke(ground.app(), terrain);
    let at = ground.seen_at(MIDDLE);
    ground.app().trigger(bevy_tessera::edit::Raise::at(at));
    ground.app().flush();
    let records = ground.log().len();
    redo_stroke(ground.app(), terrain);
    assert_eq!(ground.log().len(), records, "there is nothing to redo");
    undo_stroke(ground.app(), terrain);
    assert_eq!(ground.log().len(), records + 1);
    assert_eq!(hash(&ground), before);
}

#[test]
fn the_numbers_of_every_kind_reach_the_log() {
    let mut ground = Ground::new();
    // What is set before the brush meets a terrain, and is what it is at first, would grow with it.
    ground.move_to(MIDDLE);
    let step_m = 0.01;
    {
        let mut brush = ground.brush();
        let crater = &mut brush.crater;
        (crater.radius_m, crater.depth_m, crater.rim_m) = (10.0, 3.0, 1.0);
        (crater.roughness, crater.scorch, crater.density_per_m) = (0.5, 0.4, 0.1);
        brush.seed = 77;
        brush.seed_follows_strokes = false;
        (brush.raise.radius_m, brush.raise.by_m) = (6.0, 1.5);
        (brush.raise.hardness, brush.raise.density_per_m) = (1.0, 0.2);
        (brush.lower.radius_m, brush.lower.by_m) = (7.0, -2.5);
        (brush.flatten.radius_m, brush.flatten.strength) = (9.0, 0.5);
        brush.flatten.hardness = 0.2;
        (brush.smooth.radius_m, brush.smooth.strength) = (12.0, 0.25);
        brush.smooth.hardness = 0.6;
        (brush.stamp.side_m, brush.stamp.by_m) = (8.0, -0.75);
        (brush.stamp.turn, brush.stamp.scorch) = (std::f32::consts::FRAC_PI_2, 1.0);
        brush.image = Some(image());
    }
    for (kind, reach_m) in BrushKind::ALL.into_iter().zip([
        16.0,
        6.0,
        7.0,
        9.0,
        12.0,
        8.0 * std::f64::consts::FRAC_1_SQRT_2,
    ]) {
        ground.brush().kind = kind;
        ground.click(MIDDLE);
        let edit = ground.newest();
        let reach = f64::from(edit.reach) * SPACING_M / f64::from(EDIT_UNITS);
        assert!((reach - reach_m).abs() < 0.05, "{kind:?} reaches {reach} m");
        let steps = |metres: f64| (metres / step_m).round() as i32;
        match (kind, &edit.change) {
            (
                BrushKind::Crater,
                &Change::Crater {
                    depth,
                    rim,
                    roughness,
                    seed,
                    density,
                    scorch,
                    ..
                },
            ) => {
                assert_eq!([i32::from(depth), rim.into()], [3.0, 1.0].map(steps));
                assert_eq!((roughness, seed, density, scorch), (48, 77, 77, 102));
            }
            (
                BrushKind::Raise,
                &Change::Raise {
                    by,
                    hardness,
                    density,
                    ..
                },
            ) => {
                assert_eq!((by, hardness, density), (steps(1.5), 255, 77));
            }
            (BrushKind::Lower, &Change::Raise { by, .. }) => assert_eq!(by, steps(-2.5)),
            (
                BrushKind::Flatten,
                &Change::Flatten {
                    strength, hardness, ..
                },
            ) => assert_eq!((strength, hardness), (32768, 51)),
            (
                BrushKind::Smooth,
                &Change::Smooth {
                    strength, hardness, ..
                },
            ) => assert_eq!((strength, hardness), (16384, 153)),
            (
                BrushKind::Stamp,
                Change::Stamp {
                    image: held,
                    by,
                    turn,
                    scorch,
                    ..
                },
            ) => {
                assert_eq!(held, &image());
                assert_eq!((*by, *turn, *scorch), (steps(-0.75), [0, 16384], 255));
            }
            (kind, change) => panic!("{kind:?} has made {change:?}"),
        }
    }
}

#[test]
fn all_of_a_stroke_is_flattened_to_where_it_began() {
    let mut ground = Ground::new();
    ground.brush().kind = BrushKind::Flatten;
    ground.drag(Vec2::new(200.0, 300.0), Vec2::new(600.0, 320.0), 9);
    let heights: Vec<_> = ground
        .log()
        .active()
        .map(|(_, edit)| match edit.change {
            Change::Flatten { to, .. } => to,
            ref change => panic!("{change:?}"),
        })
        .collect();
    assert!(heights.len() > 3);
    for &height in &heights {
        assert!(height.abs_diff(heights[0]) <= 1, "{heights:?}");
    }
}

#[test]
fn every_stroke_has_another_seed_unless_it_is_to_stay() {
    let mut ground = Ground::new();
    let seeds = |ground: &Ground| -> Vec<u32> {
        let seeds = ground.log().active().map(|(_, edit)| match edit.change {
            Change::Crater { seed, .. } => seed,
            ref change => panic!("{change:?}"),
        });
        seeds.collect()
    };
    ground.drag(Vec2::new(300.0, 300.0), Vec2::new(450.0, 300.0), 5);
    let painted = seeds(&ground);
    assert!(painted.len() > 1 && painted.iter().all(|&seed| seed == painted[0]));
    ground.click(MIDDLE);
    assert_ne!(seeds(&ground).last(), Some(&painted[0]));
    ground.brush().seed_follows_strokes = false;
    ground.brush().seed = 5;
    ground.click(MIDDLE);
    ground.click(MIDDLE);
    let seeds = seeds(&ground);
    assert_eq!(seeds[seeds.len() - 2..], [5, 5]);
}

#[test]
fn the_preview_lies_on_the_ground_at_the_brushs_radii() {
    let place = Transform::from_xyz(-200.0, 30.0, 50.0)
        .with_rotation(Quat::from_rotation_y(-0.4))
        .with_scale(Vec3::splat(2.0));
    let mut ground = Ground::placed(place);
    ground.brush().set_radius_m(20.0);
    ground.move_to(MIDDLE);
    let centre = ground.seen_at(MIDDLE);
    let lines = ground.lines();
    let mut radii: Vec<f32> = Vec::new();
    for &point in &lines {
        let under = ground.ask(|query| query.under(point)).expect("on it");
        assert!(under.point.distance(point) < 0.02, "{point} hangs");
        let radius = point.xz().distance(centre.xz());
        if !radii.iter().any(|known| (known - radius).abs() < 0.1) {
            radii.push(radius);
        }
    }
    radii.sort_by(f32::total_cmp);
    assert_eq!(radii.len(), 3, "{radii:?}");
    assert!((radii[0] - 20.0).abs() < 0.1 && (radii[2] - 32.0).abs() < 0.1);
    ground.brush().on = false;
    ground.world.frame();
    assert_eq!(ground.lines().len(), 0);
}

#[test]
fn on_coarse_ground_the_first_crater_and_its_ring_can_be_seen() {
    // 2 m a sample, 15 times as large: as in the example of the open world.
    let place = Transform::from_scale(Vec3::splat(15.0));
    let mut ground = Ground::placed(place);
    ground.move_to(MIDDLE);
    ground.world.frame();
    assert_eq!(ground.brush().crater.radius_m, 120.0);
    assert_eq!(ground.brush().crater.depth_m, 42.0);
    let centre = ground.seen_at(MIDDLE);
    let reach = |ground: &Ground| {
        let lines = ground.lines();
        let from = lines.iter().map(|at| at.xz().distance(centre.xz()));
        from.fold(0.0, f32::max)
    };
    assert!((reach(&ground) - 192.0).abs() < 1.0, "{}", reach(&ground));
    // What the user has set stays, and its ring is as large as what is changed: a sample.
    ground.brush().set_radius_m(4.0);
    ground.world.frame();
    assert_eq!(ground.brush().crater.radius_m, 4.0);
    assert!((reach(&ground) - 30.0).abs() < 0.5, "{}", reach(&ground));
    ground.press();
    ground.release();
    assert_eq!(ground.newest().reach, EDIT_UNITS as u32);
    // Keys go no lower.
    ground.type_key("[", KeyCode::BracketLeft, &[]);
    ground.type_key("[", KeyCode::BracketLeft, &[]);
    assert_eq!(ground.brush().radius_m(), 30.0);
    {
        let mut stamp = ground.brush();
        stamp.kind = BrushKind::Stamp;
        stamp.set_radius_m(1.0);
    }
    ground.world.frame();
    // The edit has moved what is under the pointer.
    let centre = ground.seen_at(MIDDLE);
    let reach = |ground: &Ground| {
        let lines = ground.lines();
        let from = lines.iter().map(|at| at.xz().distance(centre.xz()));
        from.fold(0.0, f32::max)
    };
    assert!((reach(&ground) - 30.0).abs() < 0.5, "{}", reach(&ground));
}

/// The tab is not shown here; its checkbox is what an egui without a screen clicks.
fn click_tool_on(ground: &mut Ground, tab: &mut BrushTab) {
    use bevy_egui::egui;
    let ctx = egui::Context::default();
    ctx.enable_accesskit();
    let chosen = ground.chosen();
    let mut events = Vec::new();
    for _ in 0..3 {
        let input = egui::RawInput {
            events: std::mem::take(&mut events),
            ..Default::default()
        };
        let output = ctx.run_ui(input, |ui| tab.ui(ui, ground.app(), chosen));
        let update = output.platform_output.accesskit_update.expect("enabled");
        let mut nodes = update.nodes.iter();
        let tool = nodes.find(|(_, node)| node.label() == Some("Tool on"));
        let (target_node, _) = *tool.expect("it is shown");
        if ground.brush().on {
            return;
        }
        let request = egui::accesskit::ActionRequest {
            action: egui::accesskit::Action::Click,
            target_tree: egui::accesskit::TreeId::ROOT,
            target_node,
            data: None,
        };
        events.push(egui::Event::AccessKitActionRequest(request));
    }
    assert!(ground.brush().on);
}

#[test]
fn a_brush_that_the_tab_has_switched_on_does_nothing_once_the_panel_is_closed() {
    let mut ground = Ground::new();
    let mut tab = BrushTab::default();
    // The game has switched it on: no panel ends that.
    for _ in 0..5 {
        ground.world.frame();
    }
    ground.click(MIDDLE);
    assert_eq!(ground.log().len(), 1);

    ground.brush().on = false;
    ground.world.frame();
    let panel = TerrainPanel {
        is_open: true,
        ..default()
    };
    ground.app().insert_resource(panel);
    click_tool_on(&mut ground, &mut tab);
    let chosen = ground.chosen();
    // Open, it is seen each frame, whichever tab is on top.
    for at in [MIDDLE, 0.9 * MIDDLE] {
        ground.move_to(at);
        for action in [Ground::press, Ground::release] {
            tab.update(ground.app(), chosen);
            action(&mut ground);
        }
        tab.update(ground.app(), chosen);
    }
    assert_eq!(ground.log().len(), 3);
    assert!(ground.brush().on);
    ground.app().resource_mut::<TerrainPanel>().is_open = false;
    ground.click(MIDDLE);
    assert!(!ground.brush().on);
    assert_eq!(ground.log().len(), 3);

    // A panel in a game's own windows is closed when it isn't shown.
    click_tool_on(&mut ground, &mut tab);
    ground.world.frame();
    assert!(ground.brush().on);
    ground.world.frame();
    ground.click(MIDDLE);
    assert!(!ground.brush().on);
    assert_eq!(ground.log().len(), 3);
    // And the game may switch it on again.
    ground.brush().on = true;
    ground.click(MIDDLE);
    assert_eq!(ground.log().len(), 4);
}

#[test]
fn a_press_that_paints_is_not_the_games_unless_the_game_wants_it() {
    let mut ground = Ground::new();
    ground.move_to(MIDDLE);
    let press = |ground: &mut Ground| {
        let mut buttons = ground.app().resource_mut::<ButtonInput<MouseButton>>();
        buttons.press(MouseButton::Right);
        buttons.press(MouseButton::Left);
        // Bevy's own system would forget it in the frame in which it is read.
        ground.app().resource_mut::<Seen>().0.clear();
        ground.press();
        ground.release();
        let mut buttons = ground.app().resource_mut::<ButtonInput<MouseButton>>();
        buttons.reset_all();
        ground.app().resource::<Seen>().0.clone()
    };
    #[derive(Resource, Default)]
    struct Seen(Vec<[bool; 2]>);
    fn look(buttons: Res<ButtonInput<MouseButton>>, mut seen: ResMut<Seen>) {
        let pressed = [MouseButton::Left, MouseButton::Right].map(|it| buttons.pressed(it));
        seen.0.push(pressed);
    }
    ground.world.app.init_resource::<Seen>();
    ground.world.app.add_systems(Update, look);
    assert_eq!(press(&mut ground)[0], [false, true]);
    assert_eq!(ground.log().len(), 1);
    ground.brush().takes_clicks = false;
    assert_eq!(press(&mut ground)[0], [true, true]);
    ground.brush().takes_clicks = true;
    // Not where there is nothing to paint, and not while it is off.
    ground.brush().on = false;
    assert_eq!(press(&mut ground)[0], [true, true]);
    ground.brush().on = true;
    ground.egui_wants(true, false);
    assert_eq!(press(&mut ground)[0], [true, true]);
}

#[test]
fn what_is_refused_ends_the_stroke_and_is_said_once() {
    let mut ground = Ground::new();
    ground.brush().keeps_shape = false;
    // More than 320 samples.
    ground.brush().set_radius_m(700.0);
    ground.brush().spacing = 0.02;
    ground.drag(Vec2::new(200.0, 300.0), Vec2::new(600.0, 320.0), 5);
    assert!(ground.log().is_empty());
    let world = ground.world.app.world();
    let now = world.resource::<Time<bevy::time::Real>>().elapsed();
    let messages = world.resource::<BrushMessages>();
    let said: Vec<_> = messages.refused(Some(ground.terrain), now).collect();
    assert_eq!(said.len(), 1, "{said:?}");
    assert!(said[0].contains("radius_m"), "{said:?}");
    let later = now + std::time::Duration::from_secs(9);
    assert_eq!(messages.refused(Some(ground.terrain), later).count(), 0);
    assert_eq!(messages.refused(Some(ground.camera), now).count(), 0);
    // A stamp without an image says that it wants one.
    ground.brush().kind = BrushKind::Stamp;
    ground.click(MIDDLE);
    let world = ground.world.app.world();
    let messages = world.resource::<BrushMessages>();
    let said = messages.refused(None, now).last();
    assert!(said.is_some_and(|said| said.contains("image")), "{said:?}");
}

mod seen {
    use super::common::app::{into_image, settle};
    use super::common::scene::{Scene, assets_with_hills, hills};
    use super::common::stage::Stage;
    use bevy::camera::RenderTarget;
    use bevy::gizmos::config::GizmoConfigStore;
    use bevy::picking::pointer::{Location, PointerAction, PointerId, PointerInput};
    use bevy::prelude::*;
    use bevy::render::settings::WgpuSettings;
    use bevy::window::PrimaryWindow;
    use bevy_tessera::debug::brush::{BrushGizmos, BrushPlugin, TerrainBrush};
    use image::RgbImage;

    const SIZE: [u32; 2] = [480, 320];
    const COLOR: [u8; 3] = [0, 255, 0];

    fn count(picture: &RgbImage) -> usize {
        picture.pixels().filter(|pixel| pixel.0 == COLOR).count()
    }

    /// Bevy's own pointer, over a camera that draws into an image.
    #[test]
    fn the_ring_is_seen_on_the_ground_around_the_pointer() {
        let assets = assets_with_hills("panel_brush");
        let mut stage = Stage::with(
            "panel_brush",
            &assets,
            "hills/terrain.ron",
            SIZE,
            false,
            WgpuSettings::default(),
            |app| {
                app.add_plugins(BrushPlugin);
            },
        );
        let scene = Scene::new(hills);
        let eye = Transform::from_xyz(320.0, 130.0, 420.0);
        let eye = eye.looking_at(Vec3::new(400.0, 45.0, 290.0), Vec3::Y);
        let camera = stage.aim(eye, |_| ());
        let sun = Transform::from_xyz(-1.0, 1.2, 0.6).looking_at(Vec3::ZERO, Vec3::Y);
        stage.prop((DirectionalLight::default(), sun));
        settle(&mut stage.app, 2000);
        let world = stage.app.world_mut();
        world.spawn((Window::default(), PrimaryWindow));
        let mut store = world.resource_mut::<GizmoConfigStore>();
        let (_, gizmos) = store.config_mut::<BrushGizmos>();
        gizmos.color = Color::srgb(0.0, 1.0, 0.0);
        let before = stage.shoot("off", 2);
        assert_eq!(count(&before), 0);

        let world = stage.app.world_mut();
        let mut brush = world.resource_mut::<TerrainBrush>();
        brush.on = true;
        brush.set_radius_m(15.0);
        let reach_m = brush.reach_m();
        let target = into_image(&stage.target);
        let RenderTarget::Image(image) = target else {
            panic!("it draws into an image");
        };
        let at = Vec2::new(250.0, 190.0);
        let location = Location {
            target: bevy::camera::NormalizedRenderTarget::Image(image),
            position: at,
        };
        let moved = PointerAction::Move { delta: Vec2::ONE };
        let input = PointerInput::new(PointerId::Mouse, location, moved);
        let world = stage.app.world_mut();
        world.write_message(input);
        let picture = stage.shoot("ring", 2);
        assert!(count(&picture) > 100, "{} pixels", count(&picture));

        let world = stage.app.world();
        let lens = world.get::<Camera>(camera).unwrap();
        let eye = world.get::<GlobalTransform>(camera).unwrap();
        let ray = lens.viewport_to_world(eye, at).unwrap();
        let centre = scene.cast(ray.origin, *ray.direction, 3000.0).unwrap();
        let mut seen = 0;
        for turn in 0..24 {
            let around = Vec2::from_angle(turn as f32 * std::f32::consts::TAU / 24.0) * reach_m;
            let place = centre.point.xz() + around;
            let place = scene.ground(place.x, place.y);
            // The other side of a hill is hidden.
            let way = place - eye.translation();
            let hit = scene.cast(eye.translation(), way.normalize(), way.length() - 2.0);
            let Ok(on_screen) = lens.world_to_viewport(eye, place) else {
                continue;
            };
            let (x, y) = (on_screen.x as i32, on_screen.y as i32);
            if hit.is_some() || x < 4 || y < 4 || x > 475 || y > 315 {
                continue;
            }
            let is_near = (-3..=3).any(|dy| {
                (-3..=3).any(|dx| picture.get_pixel((x + dx) as u32, (y + dy) as u32).0 == COLOR)
            });
            assert!(is_near, "no ring at {place}, which is seen at {on_screen}");
            seen += 1;
        }
        assert!(seen > 12, "{seen} places of the ring are seen");
    }
}
