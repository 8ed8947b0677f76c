//! Overlays, the held eye, comparisons and gizmos.

use super::cases::{
    GIZMO_COLORS, by_error, comparison_cases, eye_cases, gizmo_cases, hold, overlay, split,
};
use super::panel_settings_support::{Act, Everything, Panel, Role, act, click, is_shown, slide};
use super::{comparing, pick_red, run, views_panel};
use bevy::prelude::*;
use bevy_egui::egui;
use bevy_tessera::render::{TerrainOverlay, TerrainOverlays};
use bevy_tessera::view::TerrainEye;
use egui_kittest::kittest::Queryable;

#[test]
fn every_control_of_the_views_sets_what_it_names_and_nothing_else() {
    let mut panel = comparing();
    run(&mut panel, eye_cases());
    run(&mut panel, comparison_cases());
    run(&mut panel, gizmo_cases());
}

#[test]
fn overlays_are_one_at_a_time_or_over_each_other() {
    let mut panel = views_panel();
    let mut expected = Everything::new();
    for one in TerrainOverlay::ALL {
        act(&mut panel, one.name(), Act::Radio);
        expected.overlays = Some(TerrainOverlays::only(one));
        assert_eq!(panel.state().everything(), expected, "{}", one.name());
    }
    let label = "opacity of wireframe";
    slide(&mut panel, label, 0.5);
    expected.overlays = Some(TerrainOverlays::default().with(TerrainOverlay::Wireframe, 0.5));
    assert_eq!(panel.state().everything(), expected);
    act(&mut panel, "no overlay", Act::Radio);
    expected.overlays = None;
    assert_eq!(panel.state().everything(), expected);
    act(&mut panel, "blended", Act::Radio);
    assert_eq!(panel.state().everything(), expected);
    for one in TerrainOverlay::ALL {
        act(&mut panel, one.name(), Act::Check);
        // The wireframe's opacity is remembered.
        let opacity = if one == TerrainOverlay::Wireframe {
            0.5
        } else {
            1.0
        };
        overlay(&mut expected, one, opacity);
        assert_eq!(panel.state().everything(), expected, "{}", one.name());
        slide(&mut panel, &format!("opacity of {}", one.name()), 0.75);
        overlay(&mut expected, one, 0.75);
        assert_eq!(panel.state().everything(), expected, "{}", one.name());
    }
    act(&mut panel, "lit", Act::Check);
    expected.overlays.as_mut().unwrap().lit = false;
    assert_eq!(panel.state().everything(), expected);
    act(&mut panel, "one at a time", Act::Radio);
    expected.overlays = Some(TerrainOverlays {
        lit: false,
        ..TerrainOverlays::default().with(TerrainOverlay::Wireframe, 0.75)
    });
    assert_eq!(panel.state().everything(), expected);
    act(&mut panel, "blended", Act::Radio);
    act(&mut panel, "wireframe", Act::Check);
    expected.overlays = None;
    assert_eq!(panel.state().everything(), expected);
}

#[test]
fn turning_everything_off_leaves_no_component() {
    let mut panel = views_panel();
    let mut all = Everything::new();
    overlay(&mut all, TerrainOverlay::Level, 1.0);
    split(&mut all);
    all.eye = Some(TerrainEye::LodOnly);
    all.gizmos.edits = true;
    panel.state_mut().set(&all);
    panel.run();
    act(&mut panel, "Turn everything off", Act::Press);
    assert_eq!(panel.state().everything(), Everything::new());
}

#[test]
fn turning_everything_off_leaves_colours_and_limits_of_gizmos() {
    let mut panel = views_panel();
    let mut all = Everything::new();
    all.gizmos.edit_color = Color::BLACK;
    all.gizmos.tile_colors[2] = Color::WHITE;
    all.gizmos.most_tiles = 3;
    all.gizmos.tiles_within_m = 10.0;
    let off = all.clone();
    all.gizmos.tiles = true;
    all.gizmos.edits = true;
    all.gizmos.held_eyes = true;
    panel.state_mut().set(&all);
    panel.run();
    act(&mut panel, "Turn everything off", Act::Press);
    assert_eq!(panel.state().everything(), off);
}

#[test]
fn a_held_eye_is_drawn_while_it_is_held_unless_it_was_drawn_before() {
    let mut panel = views_panel();
    let held_eyes = |panel: &Panel| panel.state().everything().gizmos.held_eyes;
    let is_long = |panel: &Panel| is_shown(panel, Role::SpinButton, "frustum length");
    assert!(!is_long(&panel));
    act(&mut panel, "Eye only", Act::Radio);
    assert!(held_eyes(&panel) && is_long(&panel));
    act(&mut panel, "LOD only", Act::Radio);
    assert!(held_eyes(&panel));
    act(&mut panel, "Eye & LOD", Act::Radio);
    assert_eq!(panel.state().everything(), Everything::new());
    assert!(!is_long(&panel));
    // Somebody wants it off, or on, whatever is held.
    act(&mut panel, "Eye only", Act::Radio);
    act(&mut panel, "held eyes", Act::Check);
    act(&mut panel, "LOD only", Act::Radio);
    assert!(!held_eyes(&panel));
    act(&mut panel, "held eyes", Act::Check);
    act(&mut panel, "Eye & LOD", Act::Radio);
    assert!(held_eyes(&panel));
    act(&mut panel, "Eye only", Act::Radio);
    act(&mut panel, "Eye & LOD", Act::Radio);
    assert!(held_eyes(&panel));
    // Another camera's is held still.
    act(&mut panel, "held eyes", Act::Check);
    panel.state_mut().world.spawn(TerrainEye::LodOnly);
    act(&mut panel, "Eye only", Act::Radio);
    act(&mut panel, "Eye & LOD", Act::Radio);
    assert!(held_eyes(&panel));
}

#[test]
fn a_gizmos_colour_is_picked_and_no_other_is() {
    for (label, row, color) in GIZMO_COLORS {
        let mut panel = views_panel();
        let mut expected = Everything::new();
        let before = color(&mut expected.gizmos).to_linear();
        pick_red(&mut panel, label, "0");
        let is = panel.state().everything();
        let picked = *color(&mut is.gizmos.clone());
        let linear = picked.to_linear();
        assert!(linear.red < 0.01 && linear.alpha == 1.0, "{linear:?}");
        let [green, blue] = [linear.green - before.green, linear.blue - before.blue];
        assert!(green.abs() < 0.01 && blue.abs() < 0.01, "{linear:?}");
        *color(&mut expected.gizmos) = picked;
        assert_eq!(is, expected, "{label}");
        click(&mut panel, Role::Button, &format!("reset {row}"));
        assert_eq!(panel.state().everything(), Everything::new());
    }
}

#[test]
fn gizmos_are_reset_as_a_whole() {
    let mut panel = views_panel();
    let mut all = Everything::new();
    for (before, _, _, after) in gizmo_cases() {
        before(&mut all);
        after(&mut all);
    }
    hold(&mut all);
    all.gizmos.held_eye_reach_m = 1.0;
    panel.state_mut().set(&all);
    panel.run();
    click(&mut panel, Role::Button, "reset all of Gizmos");
    all.gizmos = default();
    assert_eq!(panel.state().everything(), all);
}

fn button(pos: egui::Pos2, pressed: bool) -> egui::Event {
    egui::Event::PointerButton {
        pos,
        button: egui::PointerButton::Primary,
        pressed,
        modifiers: egui::Modifiers::NONE,
    }
}

#[test]
fn an_opacity_that_is_dragged_to_0_and_back_keeps_its_slider() {
    let mut panel = views_panel();
    let mut all = Everything::new();
    overlay(&mut all, TerrainOverlay::Slope, 0.75);
    panel.state_mut().set(&all);
    panel.run();
    let label = "opacity of slope";
    let rail = panel.get_by_role_and_label(Role::Slider, label).rect();
    let opacity = |panel: &Panel| {
        let overlays = panel.state().everything().overlays.unwrap_or_default();
        overlays.opacity(TerrainOverlay::Slope)
    };
    let [off, middle] = [rail.left_center() - egui::vec2(50.0, 0.0), rail.center()];
    let drag_to = |panel: &mut Panel, to| {
        panel.event(egui::Event::PointerMoved(to));
        panel.step();
        panel.run();
    };
    drag_to(&mut panel, middle);
    panel.event(button(middle, true));
    panel.step();
    // Slowly, past opacities that are hardly seen.
    for step in 0..=20 {
        drag_to(&mut panel, middle.lerp(off, step as f32 / 20.0));
        assert!(is_shown(&panel, Role::Slider, label), "step {step}");
    }
    assert_eq!(panel.state().everything(), Everything::new(), "it is off");
    drag_to(&mut panel, middle);
    let back = opacity(&panel);
    assert!((0.2..0.8).contains(&back), "the same drag has it at {back}");
    drag_to(&mut panel, off);
    panel.event(button(off, false));
    panel.step();
    panel.run();
    assert!(!is_shown(&panel, Role::Slider, label));
    act(&mut panel, "slope", Act::Radio);
    assert_eq!(opacity(&panel), 0.75, "what it was before the drag");
    for (given, comes_back) in [(0.04, 0.75), (0.06, 0.06)] {
        overlay(&mut all, TerrainOverlay::Slope, given);
        panel.state_mut().set(&all);
        panel.run();
        act(&mut panel, "no overlay", Act::Radio);
        act(&mut panel, "slope", Act::Radio);
        assert_eq!(opacity(&panel), comes_back);
    }
}

#[test]
fn sizes_of_triangles_say_when_they_are_not_what_is_followed() {
    let mut panel = views_panel();
    let mut all = Everything::new();
    let is_said = |panel: &Panel| panel.query_by_label_contains("does not follow").is_some();
    overlay(&mut all, TerrainOverlay::TriangleSize, 1.0);
    panel.state_mut().set(&all);
    panel.run();
    assert!(!is_said(&panel));
    by_error(&mut all);
    panel.state_mut().set(&all);
    panel.run();
    assert!(is_said(&panel));
    all.overlays = None;
    panel.state_mut().set(&all);
    panel.run();
    assert!(!is_said(&panel));
}
