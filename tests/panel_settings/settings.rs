//! What a camera, a terrain and what is shared can be set to.

use super::cases::{
    GIZMO_COLORS, all_cases, by_error, camera_cases, density, detail, detailed, eye_cases,
    gizmo_cases, parameter, previewed, shared_cases, terrain_cases,
};
use super::panel_settings_support::{
    Act, Everything, Panel, Role, act, click, copied, is_shown, type_number,
};
use super::{pick_red, run, settings_panel};
use bevy::prelude::*;
use bevy_egui::egui;
use bevy_tessera::detail::{DetailRule, TerrainDetail};
use bevy_tessera::edit::mask::MaskSettings;
use bevy_tessera::physics::TerrainPhysics;
use bevy_tessera::render::{TerrainMaterial, TerrainStatistics};
use bevy_tessera::stream::TerrainStreaming;
use bevy_tessera::terrain::{Terrain, TerrainCamera, TerrainSettings};
use egui_kittest::kittest::{NodeT, Queryable};
use std::collections::{BTreeMap, BTreeSet};

#[test]
fn every_control_of_a_camera_sets_what_it_names_and_nothing_else() {
    run(&mut settings_panel(), camera_cases());
}

#[test]
fn every_control_of_a_terrain_sets_what_it_names_and_nothing_else() {
    run(&mut settings_panel(), terrain_cases());
}

#[test]
fn every_control_of_what_is_shared_sets_what_it_names_and_nothing_else() {
    run(&mut settings_panel(), shared_cases());
}

/// Fields of a struct, by name, as text.
fn fields(value: &dyn std::fmt::Debug) -> BTreeMap<String, String> {
    let text = format!("{value:#?}");
    let mut fields = BTreeMap::new();
    let mut name = String::new();
    for line in text.lines() {
        if let Some(field) = line.strip_prefix("    ")
            && let Some((start, _)) = field.split_once(':')
            && !field.starts_with(' ')
        {
            start.clone_into(&mut name);
        }
        fields
            .entry(name.clone())
            .or_insert_with(String::new)
            .push_str(line);
    }
    // The type's own name.
    fields.remove("");
    fields
}

#[test]
fn every_field_has_a_control() {
    fn structs(all: &Everything) -> [(&'static str, BTreeMap<String, String>); 10] {
        let detail = all.detail.clone().unwrap_or_default();
        let preview = all.preview.clone().unwrap_or_default();
        let mask = all.mask.clone().unwrap_or_default();
        [
            ("TerrainCamera", fields(&all.camera)),
            ("LodSettings", fields(&all.camera.lod)),
            ("TerrainSettings", fields(&all.terrain)),
            ("TerrainDetail", fields(&detail)),
            ("TerrainDensityPreview", fields(&preview)),
            ("DensitySettings", fields(&preview.settings)),
            ("MaskSettings", fields(&mask)),
            ("TerrainStreaming", fields(&all.streaming)),
            ("TerrainPhysics", fields(&all.physics)),
            ("TerrainGizmos", fields(&all.gizmos)),
        ]
    }
    let mut changed = BTreeSet::new();
    let mut compare = |before: &Everything, after: &Everything| {
        for ((name, before), (_, after)) in structs(before).into_iter().zip(structs(after)) {
            for (field, text) in before {
                if after.get(&field) != Some(&text) {
                    changed.insert((name, field));
                }
            }
        }
    };
    for (before, _, _, after) in [all_cases(), gizmo_cases(), eye_cases()].concat() {
        let mut was = Everything::new();
        before(&mut was);
        let mut is = was.clone();
        after(&mut is);
        compare(&was, &is);
    }
    for (_, _, color) in GIZMO_COLORS {
        let mut is = Everything::new();
        *color(&mut is.gizmos) = Color::BLACK;
        compare(&Everything::new(), &is);
    }
    for (name, fields) in structs(&Everything::new()) {
        assert!(fields.len() > 1, "{name}: {fields:?}");
        for field in fields.into_keys() {
            let field = (name, field);
            assert!(changed.contains(&field), "no control sets {field:?}");
        }
    }
}

/// What a number's control shows.
fn shown(panel: &Panel, label: &str) -> String {
    let node = panel.get_by_role_and_label(Role::SpinButton, label);
    node.accesskit_node().value().unwrap_or_default()
}

#[test]
fn whole_numbers_are_shown_to_the_last_digit() {
    let mut panel = settings_panel();
    let mut all = Everything::new();
    for seed in [0, 1_234_567_890, 1_234_567_891, u32::MAX] {
        detail(&mut all).seed = seed;
        panel.state_mut().set(&all);
        panel.run();
        assert_eq!(shown(&panel, "seed"), seed.to_string());
    }
}

#[test]
fn a_range_that_begins_with_0_says_so() {
    let mut panel = settings_panel();
    let mut all = Everything::new();
    detail(&mut all);
    panel.state_mut().set(&all);
    panel.run();
    let row_of = |label: &str| {
        let number = panel.get_by_role_and_label(Role::SpinButton, label).rect();
        let texts = panel.get_all_by_role(Role::Label);
        let beside = texts.filter(|text| {
            let rect = text.rect();
            rect.left() >= number.right() && rect.y_range().contains(number.center().y)
        });
        let words: Vec<String> = beside
            .filter_map(|text| text.accesskit_node().value())
            .collect();
        words.join(" ")
    };
    assert_eq!(row_of("mask memory"), "from 0");
    assert_eq!(row_of("seed"), "from 0");
    assert_eq!(row_of("octaves"), "1 – 8");
}

#[test]
fn a_mask_is_drawn_anew_when_a_drag_of_its_settings_ends() {
    let mut panel = settings_panel();
    for label in ["texels per metre", "mask memory"] {
        let all = Everything::new();
        panel.state_mut().set(&all);
        panel.run();
        let before = shown(&panel, label);
        let place = panel.get_by_role_and_label(Role::SpinButton, label).rect();
        let button = |pos, pressed| egui::Event::PointerButton {
            pos,
            button: egui::PointerButton::Primary,
            pressed,
            modifiers: egui::Modifiers::NONE,
        };
        panel.event(egui::Event::PointerMoved(place.center()));
        panel.step();
        panel.event(button(place.center(), true));
        panel.step();
        let mut end = place.center();
        for _ in 0..5 {
            end.x += 8.0;
            panel.event(egui::Event::PointerMoved(end));
            panel.step();
            assert_eq!(panel.state().everything(), all, "{label}, on the way");
        }
        // A number is written before it is dragged.
        panel.step();
        let after = shown(&panel, label);
        assert_ne!(before, after, "{label} shows where the drag is");
        panel.event(button(end, false));
        panel.step();
        panel.run();
        assert_eq!(shown(&panel, label), after);
        let is = panel.state().everything();
        assert_ne!(is.mask, None, "{label}, at the end");
        assert_ne!(
            is.mask,
            Some(MaskSettings::default()),
            "{label}, at the end"
        );
    }
}

#[test]
fn why_a_value_was_refused_is_said_until_it_no_longer_counts() {
    let mut panel = settings_panel();
    let rule = |full_m, none_m| DetailRule::InverseHeight { full_m, none_m };
    let upside_down = TerrainDetail {
        rule: rule(30.0, 20.0),
        ..default()
    };
    let reason = upside_down.validate().unwrap_err().to_string();
    let mut all = Everything::new();
    let mut refuse = |panel: &mut Panel| {
        detail(&mut all).rule = rule(10.0, 20.0);
        panel.state_mut().set(&all);
        panel.run();
        type_number(panel, "full height", "30");
        assert_eq!(panel.state().everything(), all);
        assert!(panel.query_by_label(&reason).is_some());
    };
    let is_said = |panel: &Panel| panel.query_by_label(&reason).is_some();
    refuse(&mut panel);
    click(&mut panel, Role::Button, "reset all of Detail");
    assert!(!is_said(&panel), "it was reset");
    refuse(&mut panel);
    let terrain = panel.state().terrain;
    panel
        .state_mut()
        .world
        .get_mut::<TerrainDetail>(terrain)
        .unwrap()
        .octaves = 1;
    panel.run();
    assert!(!is_said(&panel), "the game has changed it");
    refuse(&mut panel);
    for _ in 0..2 {
        act(&mut panel, "detail finer than the samples", Act::Check);
    }
    assert!(!is_said(&panel), "it was switched off and on");
    refuse(&mut panel);
    let bench = panel.state_mut();
    let same = bench.world.get::<TerrainDetail>(terrain).cloned().unwrap();
    let other = (Terrain::default(), TerrainSettings::default(), same);
    bench.terrain = bench.world.spawn(other).id();
    panel.run();
    assert!(!is_said(&panel), "another terrain");
}

#[test]
fn copied_code_of_a_material_says_which_shader_it_lacks() {
    let mut panel = settings_panel();
    let mut all = Everything::new();
    all.material = Some(TerrainMaterial {
        shader: Some(Handle::default()),
        ..default()
    });
    panel.state_mut().set(&all);
    panel.run();
    let text = copied(&mut panel, "copy as Rust: Material");
    assert!(text.contains("\n    // shader: "), "{text}");
    assert!(text.ends_with("    ..default()\n}"), "{text}");
    all.material = Some(default());
    panel.state_mut().set(&all);
    panel.run();
    let text = copied(&mut panel, "copy as Rust: Material");
    assert!(!text.contains("shader"), "{text}");
}

#[test]
fn what_is_typed_beyond_a_range_becomes_its_end_and_what_is_no_number_changes_nothing() {
    let mut panel = settings_panel();
    for (before, label, what, _) in all_cases() {
        let Act::Type(_) = what else { continue };
        let mut expected = Everything::new();
        before(&mut expected);
        for text in ["-1e30", "1e30", "1e300", "-1e300"] {
            panel.state_mut().set(&expected);
            panel.run();
            type_number(&mut panel, label, text);
            let refused = panel.state().everything().refused();
            assert_eq!(refused, Vec::<String>::new(), "{label}: {text}");
        }
        for text in ["abc", "nan", "inf", "1,5", " "] {
            panel.state_mut().set(&expected);
            panel.run();
            type_number(&mut panel, label, text);
            assert_eq!(panel.state().everything(), expected, "{label}: {text}");
        }
    }
    panel.state_mut().set(&Everything::new());
    panel.run();
    for (label, text, expected) in [
        ("triangle width", "1000", 256.0),
        ("triangle width", "0", 1.0),
    ] {
        type_number(&mut panel, label, text);
        assert_eq!(
            panel.state().everything().camera.triangle_width_px,
            expected
        );
    }
}

#[test]
fn what_two_values_together_make_unusable_is_refused() {
    let mut panel = settings_panel();
    let mut all = Everything::new();
    // Reach 4 leaves room for a morph zone of 1.
    type_number(&mut panel, "LOD reach", "2");
    assert_eq!(panel.state().everything(), all, "2 becomes 4, the least");
    density(&mut all).filter_size = 32;
    density(&mut all).lod_skip = 4;
    panel.state_mut().set(&all);
    panel.run();
    act(&mut panel, "border", Act::Choose("point-sampled"));
    assert_eq!(panel.state().everything(), all, "512 texels are too many");
    detail(&mut all).rule = DetailRule::InverseHeight {
        full_m: 10.0,
        none_m: 20.0,
    };
    panel.state_mut().set(&all);
    panel.run();
    type_number(&mut panel, "full height", "30");
    assert_eq!(panel.state().everything(), all, "upside down");
}

#[test]
fn looking_at_values_changes_nothing_and_marks_nothing_changed() {
    let mut panel = settings_panel();
    let mut all = Everything::new();
    detailed(&mut all);
    previewed(&mut all);
    by_error(&mut all);
    all.camera.min_triangle_m = Some(0.123_456_79);
    // Pages that are no whole number of mebibytes.
    all.streaming = TerrainStreaming::with_pages(77);
    panel.state_mut().set(&all);
    panel.run();
    panel.state_mut().world.clear_trackers();
    for (_, label, what, _) in all_cases() {
        if matches!(what, Act::Type(_)) && is_shown(&panel, Role::SpinButton, label) {
            // Into the text, and out again.
            click(&mut panel, Role::SpinButton, label);
            panel.key_press(egui::Key::Enter);
            panel.step();
            panel.run();
        }
    }
    assert_eq!(panel.state().everything(), all);
    let bench = panel.state_mut();
    let (camera, terrain) = (bench.camera, bench.terrain);
    let world = &mut bench.world;
    let is_changed = [
        world
            .entity(camera)
            .get_ref::<TerrainCamera>()
            .unwrap()
            .is_changed(),
        world
            .entity(camera)
            .get_ref::<TerrainStatistics>()
            .unwrap()
            .is_changed(),
        world
            .entity(terrain)
            .get_ref::<TerrainSettings>()
            .unwrap()
            .is_changed(),
        world
            .entity(terrain)
            .get_ref::<TerrainDetail>()
            .unwrap()
            .is_changed(),
        world.is_resource_changed::<TerrainStreaming>(),
        world.is_resource_changed::<TerrainPhysics>(),
        world.is_resource_changed::<GizmoConfigStore>(),
    ];
    assert_eq!(is_changed, [false; 7]);
    type_number(&mut panel, "density", "0.5");
    let world = &panel.state().world;
    assert!(
        world
            .entity(camera)
            .get_ref::<TerrainCamera>()
            .unwrap()
            .is_changed()
    );
    assert!(!world.is_resource_changed::<TerrainStreaming>());
}

#[test]
fn what_differs_is_marked_with_a_button_that_resets_it_alone() {
    let mut panel = settings_panel();
    for (before, label, what, _) in all_cases() {
        let label = label.trim_start_matches("set ");
        // Colours and switches are reset as a whole.
        let parts = [
            "grass red",
            "grass green",
            "grass blue",
            "rock red",
            "rock green",
            "rock blue",
        ];
        let parts = [
            parts.as_slice(),
            &["scorch red", "scorch green", "scorch blue"],
        ]
        .concat();
        let switches = [
            "detail finer than the samples",
            "show densities",
            "measure triangle sizes",
            "measure savings",
        ];
        if parts.contains(&label) || switches.contains(&label) {
            continue;
        }
        let mut all = Everything::new();
        before(&mut all);
        // Something else differs, and has to stay.
        all.camera.max_factor = 3.0;
        all.terrain.root_levels = 3;
        panel.state_mut().set(&all);
        panel.run();
        let reset = format!("reset {label}");
        if is_shown(&panel, Role::Button, &reset) {
            continue;
        }
        let differs = panel.state().everything();
        act(
            &mut panel,
            if what_is_optional(what, label) {
                "set min triangle"
            } else {
                label
            },
            what,
        );
        assert!(is_shown(&panel, Role::Button, &reset), "{reset}");
        click(&mut panel, Role::Button, &reset);
        let mut is = panel.state().everything();
        // A component that was made for it stays, at its default.
        if differs.material.is_none() && is.material == Some(TerrainMaterial::default()) {
            is.material = None;
        }
        if differs.mask.is_none() && is.mask == Some(MaskSettings::default()) {
            is.mask = None;
        }
        assert_eq!(is, differs, "{reset}");
        assert!(!is_shown(&panel, Role::Button, &reset), "{reset} is gone");
    }
}

fn what_is_optional(act: Act, label: &str) -> bool {
    label == "min triangle" && matches!(act, Act::Check)
}

#[test]
fn a_group_is_reset_as_a_whole_and_no_other_is() {
    let mut panel = settings_panel();
    let mut all = Everything::new();
    for (before, _, _, after) in all_cases() {
        before(&mut all);
        after(&mut all);
    }
    all.camera.min_triangle_m = Some(2.0);
    detail(&mut all).octaves = 2;
    density(&mut all).gain = 2.0;
    for (group, reset) in [
        (
            "Camera",
            (|all| all.camera = default()) as fn(&mut Everything),
        ),
        ("Terrain", |all| all.terrain = default()),
        ("Material", |all| all.material = Some(default())),
        ("Detail", |all| all.detail = Some(default())),
        ("Density preview", |all| all.preview = Some(default())),
        ("Destruction mask", |all| all.mask = Some(default())),
        ("Streaming", |all| all.streaming = default()),
        ("Physics", |all| all.physics = default()),
    ] {
        let mut expected = all.clone();
        panel.state_mut().set(&expected);
        panel.run();
        click(&mut panel, Role::Button, &format!("reset all of {group}"));
        reset(&mut expected);
        assert_eq!(panel.state().everything(), expected, "{group}");
    }
}

#[test]
fn a_colour_is_picked_and_no_other_is() {
    let mut panel = settings_panel();
    pick_red(&mut panel, "grass", "255");
    let mut expected = Everything::new();
    let is = panel.state().everything();
    let picked = is.material.as_ref().unwrap().parameters[0];
    assert!(picked.x > 0.99 && picked.w == 1.0, "{picked}");
    assert!(
        (picked.y - 0.125).abs() < 0.01 && (picked.z - 0.065).abs() < 0.01,
        "{picked}"
    );
    *parameter(&mut expected, 0) = picked;
    assert_eq!(is, expected);
    click(&mut panel, Role::Button, "reset grass");
    assert_eq!(panel.state().everything().material, Some(default()));
}

#[test]
fn a_materials_own_parameters_are_numbers() {
    let mut panel = settings_panel();
    let mut expected = Everything::new();
    expected.material = Some(TerrainMaterial {
        shader: Some(Handle::default()),
        ..default()
    });
    for number in 0..8 {
        for (part, axis) in [" x", " y", " z", " w"].into_iter().zip(0..) {
            panel.state_mut().set(&expected);
            panel.run();
            type_number(&mut panel, &format!("parameter {number}{part}"), "-12.5");
            parameter(&mut expected, number)[axis] = -12.5;
            assert_eq!(panel.state().everything(), expected, "{number}{part}");
        }
    }
}
