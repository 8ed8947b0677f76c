//! The brush's tab of the panel: every control changes what it names, and the log's list costs what is
//! seen of it.

mod brush_support;
mod streaming_support;

use bevy::prelude::*;
use bevy_egui::egui;
use bevy_egui::egui::accesskit::{Action, ActionData, ActionRequest, Role};
use bevy_tessera::debug::brush::{
    BrushFiles, BrushKind, BrushTab, MarkedEdit, TerrainBrush, read_stamp,
};
use bevy_tessera::debug::{TerrainCameraFlown, TerrainDebugTab};
use bevy_tessera::edit::{Change, Crater, Edit, EditLog, Raise, TerrainEditRefused, TerrainEdits};
use brush_support::{Ground, SCREEN};
use egui_kittest::Harness;
use egui_kittest::kittest::{NodeT, Queryable};

struct Shown {
    ground: Ground,
    tab: BrushTab,
}

type Panel = Harness<'static, Shown>;

fn panel(ground: Ground) -> Panel {
    let show = |ui: &mut egui::Ui, shown: &mut Shown| {
        let chosen = shown.ground.chosen();
        shown.tab.ui(ui, shown.ground.app(), chosen);
    };
    let shown = Shown {
        ground,
        tab: BrushTab::default(),
    };
    Harness::builder()
        .with_size([460.0, 900.0])
        .with_step_dt(1.0 / 60.0)
        .build_ui_state(show, shown)
}

fn ground(panel: &mut Panel) -> &mut Ground {
    &mut panel.state_mut().ground
}

fn brush(panel: &mut Panel) -> TerrainBrush {
    ground(panel).brush().clone()
}

fn click(panel: &mut Panel, label: &str) {
    panel.get_by_label(label).click();
    panel.run_steps(2);
}

/// Sets the number in the field of that name.
fn set(panel: &mut Panel, label: &str, value: f64) {
    let (target_node, target_tree) = panel.get_by_label(label).accesskit_node().locate();
    panel.event(egui::Event::AccessKitActionRequest(ActionRequest {
        action: Action::SetValue,
        target_node,
        target_tree,
        data: Some(ActionData::NumericValue(value)),
    }));
    panel.run_steps(2);
}

fn type_in(panel: &mut Panel, label: &str, text: &str) {
    let field = panel.get_by_label(label);
    field.focus();
    panel.run_steps(2);
    panel.key_combination_modifiers(egui::Modifiers::COMMAND, &[egui::Key::A]);
    panel.run_steps(2);
    panel.get_by_label(label).type_text(text);
    panel.run_steps(2);
}

/// Lets frames pass until no file is read or written.
fn wait(panel: &mut Panel) {
    for _ in 0..2000 {
        ground(panel).world.frame();
        let files = ground(panel).app().resource::<BrushFiles>();
        if !files.is_busy() && !files.is_reading_stamp() {
            panel.run_steps(2);
            return;
        }
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    panic!("files take for ever");
}

#[test]
fn every_control_changes_what_it_names() {
    let mut panel = panel(Ground::new());
    assert!(brush(&mut panel).on);
    click(&mut panel, "Tool on");
    assert!(!brush(&mut panel).on);
    click(&mut panel, "Tool on");
    assert!(brush(&mut panel).on);
    let chosen = ground(&mut panel).chosen();
    assert_eq!(brush(&mut panel).terrain, chosen.terrain);
    assert_eq!(brush(&mut panel).camera, chosen.camera);

    type Read = fn(&TerrainBrush) -> f32;
    type Numbers<'a> = (BrushKind, &'a [(&'a str, f64, Read)]);
    let numbers: [Numbers; 6] = [
        (
            BrushKind::Crater,
            &[
                ("Radius", 6.5, |brush| brush.crater.radius_m),
                ("Depth", 2.25, |brush| brush.crater.depth_m),
                ("Rim", 0.75, |brush| brush.crater.rim_m),
                ("Roughness", 0.625, |brush| brush.crater.roughness),
                ("Density", 1.5, |brush| brush.crater.density_per_m),
                ("Scorch", 0.25, |brush| brush.crater.scorch),
            ],
        ),
        (
            BrushKind::Raise,
            &[
                ("Radius", 7.5, |brush| brush.raise.radius_m),
                ("Raise by", 3.5, |brush| brush.raise.by_m),
                ("Hardness", 0.25, |brush| brush.raise.hardness),
                ("Density", 0.5, |brush| brush.raise.density_per_m),
            ],
        ),
        (
            BrushKind::Lower,
            &[
                ("Radius", 8.5, |brush| brush.lower.radius_m),
                ("Lower by", 1.25, |brush| -brush.lower.by_m),
                ("Hardness", 0.75, |brush| brush.lower.hardness),
                ("Density", 2.5, |brush| brush.lower.density_per_m),
            ],
        ),
        (
            BrushKind::Flatten,
            &[
                ("Radius", 9.5, |brush| brush.flatten.radius_m),
                ("Strength", 0.5, |brush| brush.flatten.strength),
                ("Hardness", 0.125, |brush| brush.flatten.hardness),
            ],
        ),
        (
            BrushKind::Smooth,
            &[
                ("Radius", 10.5, |brush| brush.smooth.radius_m),
                ("Strength", 0.75, |brush| brush.smooth.strength),
                ("Hardness", 0.875, |brush| brush.smooth.hardness),
            ],
        ),
        (
            BrushKind::Stamp,
            &[
                ("Side", 11.5, |brush| brush.stamp.side_m),
                ("White adds", -4.5, |brush| brush.stamp.by_m),
                ("Turn", 90.0, |brush| brush.stamp.turn.to_degrees()),
                ("Density", 3.5, |brush| brush.stamp.density_per_m),
                ("Scorch", 0.5, |brush| brush.stamp.scorch),
            ],
        ),
    ];
    for (kind, fields) in numbers {
        click(&mut panel, kind.name());
        assert_eq!(brush(&mut panel).kind, kind);
        for &(label, value, read) in fields {
            set(&mut panel, label, value);
            let now = f64::from(read(&brush(&mut panel)));
            assert!((now - value).abs() < 1e-4, "{kind:?} {label}: {now}");
        }
        // Out of range is cut off: a radius is a sample at least.
        set(&mut panel, fields[0].0, -3.0);
        assert_eq!(brush(&mut panel).radius_m(), 2.0, "{kind:?}");
        // Each number goes back by itself.
        let first = {
            let mut first = TerrainBrush { kind, ..default() };
            let sample_m = 2.0;
            first.set_radius_m(first.radius_m().max(4.0 * sample_m));
            first
        };
        for &(label, _, read) in fields.iter().rev() {
            click(&mut panel, &format!("reset {label}"));
            let (now, wanted) = (read(&brush(&mut panel)), read(&first));
            assert!((now - wanted).abs() < 1e-4, "{kind:?} {label}: {now}");
        }
        set(&mut panel, "Spacing", 0.75);
        assert_eq!(brush(&mut panel).spacing, 0.75);
        set(&mut panel, "Spacing", 0.5);
        let before = brush(&mut panel);
        set(&mut panel, fields[1].0, 0.5);
        click(&mut panel, "Defaults");
        let mut wanted = before.clone();
        wanted.reset_kind();
        wanted.keeps_shape = true;
        // Not less than four samples of the terrain.
        wanted.set_radius_m(wanted.radius_m().max(8.0));
        wanted.keeps_shape = before.keeps_shape;
        assert_eq!(brush(&mut panel), wanted);
    }

    click(&mut panel, "Crater");
    set(&mut panel, "Seed", 99.0);
    assert_eq!(brush(&mut panel).seed, 99);
    let before = brush(&mut panel);
    click(&mut panel, "New every stroke");
    click(&mut panel, "Heights follow the radius");
    click(&mut panel, "Keys");
    let after = brush(&mut panel);
    assert_ne!(after.seed_follows_strokes, before.seed_follows_strokes);
    assert_ne!(after.keeps_shape, before.keeps_shape);
    assert_ne!(after.keys, before.keys);
    set(&mut panel, "Radius", 20.0);
    assert_eq!(brush(&mut panel).crater.depth_m, before.crater.depth_m);
}

#[test]
fn looking_at_the_tab_changes_no_number() {
    let mut panel = panel(Ground::new());
    {
        let mut brush = ground(&mut panel).brush();
        brush.on = false;
        brush.spacing = 0.001;
        // Less than a sample, more than the terrain allows, and no number at all.
        brush.crater.radius_m = 0.3;
        brush.crater.scorch = 7.0;
        brush.crater.depth_m = -4.0;
        brush.raise.radius_m = 1e6;
        brush.raise.by_m = f32::NAN;
        brush.lower.by_m = 3.0;
        brush.stamp.turn = 100.0;
        brush.stamp.side_m = 1e-3;
        brush.smooth.radius_m = f32::NAN;
    }
    let text = |brush: &TerrainBrush| {
        let seen = TerrainBrush {
            kind: BrushKind::Crater,
            terrain: None,
            camera: None,
            ..brush.clone()
        };
        format!("{seen:?}")
    };
    let before = text(&brush(&mut panel));
    for kind in BrushKind::ALL {
        click(&mut panel, kind.name());
        panel.run_steps(3);
    }
    assert_eq!(text(&brush(&mut panel)), before);
}

#[test]
fn the_chosen_kinds_command_is_copied_as_code() {
    let mut panel = panel(Ground::new());
    click(&mut panel, "Raise");
    set(&mut panel, "Radius", 6.0);
    set(&mut panel, "Raise by", 1.5);
    panel.get_by_label("Copy as Rust").click();
    panel.step();
    let copied = panel
        .output()
        .platform_output
        .commands
        .iter()
        .find_map(|it| match it {
            egui::OutputCommand::CopyText(text) => Some(text.clone()),
            _ => None,
        });
    let copied = copied.expect("something is copied");
    assert!(copied.contains("Raise::at(point)"), "{copied}");
    assert!(
        copied.contains(".radius(6.0)") && copied.contains(".by(1.5)"),
        "{copied}"
    );
}

#[test]
fn a_row_is_unmarked_by_a_second_click_and_flown_to_by_a_double_one() {
    let mut made = Ground::new();
    let at = Vec3::new(300.0, 50.0, 200.0);
    made.app().trigger(Crater::at(at).radius(10.0));
    made.app().flush();
    made.world.frame();
    #[derive(Resource, Default)]
    struct Heard(Vec<TerrainCameraFlown>);
    made.app().init_resource::<Heard>();
    let hear = |flown: On<TerrainCameraFlown>, mut heard: ResMut<Heard>| heard.0.push(*flown);
    made.app().add_observer(hear);
    let (camera, terrain) = (made.camera, made.terrain);
    let mut panel = panel(made);
    panel.run_steps(2);
    let label = panel
        .get_all_by_role(Role::Button)
        .filter_map(|button| button.accesskit_node().label())
        .find(|label| label.contains("Crater") && label.contains("300.0"))
        .expect("a row");
    let row = panel.get_by_label(&label).rect().center();
    let press = |panel: &mut Panel, times: u32, pause: usize| {
        panel.event(egui::Event::PointerMoved(row));
        panel.step();
        for _ in 0..times {
            for pressed in [true, false] {
                panel.event(egui::Event::PointerButton {
                    pos: row,
                    button: egui::PointerButton::Primary,
                    pressed,
                    modifiers: egui::Modifiers::NONE,
                });
            }
            panel.step();
        }
        // Longer than a double click may take.
        panel.run_steps(pause);
    };
    press(&mut panel, 1, 40);
    assert!(brush(&mut panel).marked.is_some());
    press(&mut panel, 1, 40);
    assert_eq!(brush(&mut panel).marked, None);
    let before = *ground(&mut panel)
        .app()
        .get::<Transform>(camera)
        .expect("it");
    press(&mut panel, 2, 40);
    let marked = MarkedEdit {
        terrain,
        sequence: 1,
    };
    assert_eq!(brush(&mut panel).marked, Some(marked));
    let ground = self::ground(&mut panel);
    let eye = *ground.app().get::<Transform>(camera).expect("it");
    assert_ne!(eye, before);
    let centre = ground.ask(|query| query.under(at)).expect("ground").point;
    assert!((centre - eye.translation).normalize().dot(*eye.forward()) > 0.999);
    let flown = TerrainCameraFlown {
        entity: camera,
        terrain,
        is_there: true,
    };
    assert_eq!(ground.app().resource::<Heard>().0, [flown]);
}

#[test]
fn what_is_set_in_the_tab_is_what_a_click_on_the_ground_does() {
    let mut panel = panel(Ground::new());
    click(&mut panel, "Lower");
    set(&mut panel, "Radius", 6.0);
    set(&mut panel, "Lower by", 2.0);
    ground(&mut panel).click(0.5 * SCREEN);
    let edit = ground(&mut panel).newest();
    assert_eq!(edit.reach, 192);
    assert!(matches!(edit.change, Change::Raise { by: -200, .. }));
}

#[test]
fn undo_and_redo_buttons_count_and_take_strokes_as_a_whole() {
    let mut panel = panel(Ground::new());
    ground(&mut panel).click(0.5 * SCREEN);
    ground(&mut panel).drag(Vec2::new(200.0, 300.0), Vec2::new(600.0, 320.0), 9);
    let painted = ground(&mut panel).log().active_count();
    assert!(painted > 5);
    panel.run_steps(2);
    click(&mut panel, &format!("Undo ({painted})"));
    assert_eq!(ground(&mut panel).log().active_count(), 1);
    click(&mut panel, "Undo (1)");
    assert_eq!(ground(&mut panel).log().active_count(), 0);
    assert!(
        panel
            .get_by_label("Undo (0)")
            .accesskit_node()
            .is_disabled()
    );
    click(&mut panel, &format!("Redo ({painted})"));
    assert_eq!(ground(&mut panel).log().active_count(), 1);
    click(&mut panel, &format!("Redo ({})", painted - 1));
    assert_eq!(ground(&mut panel).log().active_count(), painted);
    let figures = format!("{painted} edits, 0 undone");
    assert!(panel.query_by_label_contains(&figures).is_some());
    assert!(
        panel
            .get_by_label("Redo (0)")
            .accesskit_node()
            .is_disabled()
    );
}

#[test]
fn what_is_refused_is_shown_for_some_seconds() {
    let mut panel = panel(Ground::new());
    let terrain = Some(ground(&mut panel).terrain);
    let reason = "Crater::radius_m is 0: use a number above 0".to_owned();
    let refused = TerrainEditRefused {
        terrain,
        reason: reason.clone(),
    };
    ground(&mut panel).app().trigger(refused);
    ground(&mut panel).app().flush();
    panel.run_steps(2);
    assert!(panel.query_by_label(&reason).is_some());
    let mut real = ground(&mut panel)
        .app()
        .resource_mut::<Time<bevy::time::Real>>();
    real.update_with_duration(std::time::Duration::from_secs(9));
    panel.run_steps(2);
    assert!(panel.query_by_label(&reason).is_none());
}

/// A log of so many small edits all over the terrain.
fn long_log(ground: &Ground, edits: i32) -> EditLog {
    let mut log = EditLog::new(&ground.world.state(ground.terrain).manifest().file);
    for at in 0..edits {
        let change = Change::Raise {
            by: 1 + at % 5,
            hardness: 0,
            density: 0,
            may_clamp: false,
        };
        let centre = [at % 690 * 64, at / 690 % 490 * 64];
        log.push(Edit {
            centre,
            reach: 128,
            change,
        })
        .expect("an edit");
    }
    log
}

#[test]
fn a_list_of_100_000_edits_lays_out_the_rows_that_are_seen() {
    let mut ground = Ground::new();
    let log = long_log(&ground, 100_000);
    let terrain = ground.terrain;
    let entity = ground
        .app()
        .entity_mut(terrain)
        .insert(TerrainEdits::new(log))
        .id();
    let mut panel = panel(ground);
    panel.run_steps(2);
    assert!(
        panel
            .query_by_label_contains("100000 edits, 0 undone")
            .is_some()
    );
    let rows = |panel: &Panel| -> Vec<u64> {
        let buttons = panel.get_all_by_role(Role::Button);
        let numbers = buttons.filter_map(|button| {
            let label = button.accesskit_node().label()?;
            let mut words = label.split_whitespace();
            let number = words.next()?.parse().ok()?;
            (words.next()? == "Raise").then_some(number)
        });
        numbers.collect()
    };
    let seen = rows(&panel);
    assert!(seen.len() > 5 && seen.len() < 60, "{} rows", seen.len());
    assert_eq!(seen[0], 100_000);
    assert!(seen.windows(2).all(|pair| pair[1] + 1 == pair[0]));
    let few = panel.output().shapes.len();
    assert!(few < 1000, "{few} shapes");
    // A click marks a row, and marks it no longer.
    let label = |panel: &Panel, number: u64| {
        let number = format!("{number} Raise");
        let buttons = panel.get_all_by_role(Role::Button);
        let mut labels = buttons.filter_map(|button| button.accesskit_node().label());
        labels.find(|label| label.trim_start().starts_with(&number))
    };
    let row = label(&panel, 99_998).expect("it is seen");
    click(&mut panel, &row);
    let marked = MarkedEdit {
        terrain: entity,
        sequence: 99_998,
    };
    assert_eq!(brush(&mut panel).marked, Some(marked));
    click(&mut panel, "Unmark");
    assert_eq!(brush(&mut panel).marked, None);
}

#[test]
fn a_marked_edit_is_flown_to_drawn_and_taken_back() {
    let mut made = Ground::new();
    let at = Vec3::new(300.0, 50.0, 200.0);
    made.app().trigger(Crater::at(at).radius(10.0));
    made.app().trigger(Raise::at(at + 90.0));
    made.app().flush();
    made.world.frame();
    let mut panel = panel(made);
    let label = panel
        .get_all_by_role(Role::Button)
        .filter_map(|button| button.accesskit_node().label())
        .find(|label| label.contains("Crater") && label.contains("300.0"))
        .expect("a row");
    assert!(label.contains("200.0") && label.contains("16.0"), "{label}");
    click(&mut panel, &label);
    click(&mut panel, "Fly there");
    let ground = self::ground(&mut panel);
    ground.world.frame();
    let camera = ground.camera;
    let eye = *ground.app().get::<GlobalTransform>(camera).expect("an eye");
    let centre = ground.ask(|query| query.under(at)).expect("ground").point;
    let away = (centre - eye.translation()).normalize();
    assert!(away.dot(*eye.forward()) > 0.999, "it looks at the edit");
    let distance = centre.distance(eye.translation());
    assert!(distance > 16.0 && distance < 160.0, "{distance} m away");
    // Its rectangle is on the ground: 16 m around it, to a sample.
    let lines = ground.lines();
    assert!(!lines.is_empty());
    for point in lines {
        let from = (point.xz() - at.xz()).abs().max_element();
        assert!((from - 16.0).abs() <= 2.0, "{from} m from its centre");
        let under = ground.ask(|query| query.under(point)).expect("ground");
        assert!(under.point.distance(point) < 0.02);
    }
    click(&mut panel, "Undo it");
    assert!(!self::ground(&mut panel).log().is_active(1));
    assert!(self::ground(&mut panel).log().is_active(2));
    click(&mut panel, "Redo it");
    assert!(self::ground(&mut panel).log().is_active(1));
}

#[test]
fn the_log_is_saved_and_loaded_and_what_was_there_can_be_brought_back() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut panel = panel(Ground::new());
    ground(&mut panel).click(0.5 * SCREEN);
    ground(&mut panel).click(0.4 * SCREEN);
    let saved = ground(&mut panel).log().clone();
    for (button, name) in [("Save", "a.edits"), ("Save as RON", "a.ron")] {
        let path = folder.path().join(name);
        type_in(&mut panel, "File", path.to_str().expect("readable"));
        click(&mut panel, button);
        wait(&mut panel);
        assert!(panel.query_by_label_contains("saved 2 edits").is_some());
        assert_eq!(EditLog::load(&path).expect("a save"), saved);
        click(&mut panel, "Undo (2)");
        click(&mut panel, "Load");
        wait(&mut panel);
        assert!(panel.query_by_label_contains("loaded 2 edits").is_some());
        assert_eq!(ground(&mut panel).log(), &saved);
        click(&mut panel, "Bring 1 edits back");
        assert_eq!(ground(&mut panel).log().active_count(), 1);
        click(&mut panel, "Bring 2 edits back");
        assert_eq!(ground(&mut panel).log(), &saved);
    }
    let text = std::fs::read_to_string(folder.path().join("a.ron")).expect("text");
    assert!(text.contains("Crater"));

    // What can't be loaded changes nothing, and says so.
    let other = folder.path().join("other.edits");
    std::fs::write(&other, "something else").expect("a file");
    type_in(&mut panel, "File", other.to_str().expect("readable"));
    for (button, words) in [("Load", "can't be loaded"), ("Save", "is no file of edits")] {
        click(&mut panel, button);
        wait(&mut panel);
        let files = ground(&mut panel).app().resource::<BrushFiles>();
        let said = files.log_message().expect("a sentence").to_owned();
        assert!(
            said.contains(words) && said.contains("other.edits"),
            "{said}"
        );
        assert!(panel.query_by_label(&said).is_some());
        assert_eq!(ground(&mut panel).log(), &saved);
    }
    assert_eq!(std::fs::read(&other).expect("it"), b"something else");
}

#[test]
fn a_stamps_image_is_read_in_the_background_and_what_is_none_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("track.png");
    let picture = image::GrayImage::from_fn(8, 8, |x, _| image::Luma([(x * 36) as u8]));
    picture.save(&path).expect("a picture");
    let mut panel = panel(Ground::new());
    click(&mut panel, "Stamp");
    type_in(&mut panel, "Image", path.to_str().expect("readable"));
    click(&mut panel, "Read");
    wait(&mut panel);
    let held = brush(&mut panel).image.expect("an image");
    assert_eq!(held.side, 8);
    for (at, &sample) in held.samples.iter().enumerate() {
        let grey = (at % 8 * 36) as f32 / 255.0;
        assert!((f32::from(sample) / 32_767.0 - grey).abs() < 1e-3);
    }
    ground(&mut panel).click(0.5 * SCREEN);
    let change = ground(&mut panel).newest_change();
    assert!(matches!(change, Change::Stamp { image, .. } if *image == held));
    // 16 bits stay 16 bits.
    let fine = folder.path().join("fine.png");
    let picture = image::ImageBuffer::from_fn(4, 4, |x, y| image::Luma([(x + 4 * y) as u16 * 257]));
    picture.save(&fine).expect("a picture");
    read_stamp(ground(&mut panel).app(), &fine);
    wait(&mut panel);
    let fine = brush(&mut panel).image.expect("an image");
    assert_eq!(fine.samples[1], 128);

    let wide = folder.path().join("wide.png");
    image::GrayImage::new(8, 4).save(&wide).expect("a picture");
    for name in ["wide.png", "missing.png"] {
        let path = folder.path().join(name);
        read_stamp(ground(&mut panel).app(), &path);
        wait(&mut panel);
        let files = ground(&mut panel).app().resource::<BrushFiles>();
        let said = files.stamp_message().expect("a sentence").to_owned();
        assert!(said.contains(name), "{said}");
        assert!(panel.query_by_label(&said).is_some());
        assert_eq!(brush(&mut panel).image, Some(fine.clone()));
    }
}

#[test]
fn without_its_plugin_the_tab_says_so() {
    let show = |ui: &mut egui::Ui, (tab, world): &mut (BrushTab, World)| {
        let chosen = bevy_tessera::debug::TerrainChoice {
            camera: None,
            terrain: None,
        };
        tab.ui(ui, world, chosen);
    };
    let panel = Harness::new_ui_state(show, (BrushTab::default(), World::new()));
    assert!(panel.query_by_label_contains("BrushPlugin").is_some());
}
