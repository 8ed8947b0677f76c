//! The panel's settings and views: every control changes what it names, and nothing else.

#[path = "panel_settings/cases.rs"]
mod cases;
#[path = "panel_settings/code.rs"]
mod code;
mod panel_settings_support;
#[path = "panel_settings/settings.rs"]
mod settings;
#[path = "panel_settings/views.rs"]
mod views;

use bevy_egui::egui;
use bevy_tessera::debug::{SettingsTab, ViewsTab};
use cases::{Case, split};
use egui_kittest::kittest::Queryable;
use panel_settings_support::{Bench, Everything, Panel, Role, act, click, harness};

const GROUPS: [&str; 6] = [
    "Material",
    "Detail",
    "Density preview",
    "Destruction mask",
    "Streaming",
    "Physics",
];

fn settings_panel() -> Panel {
    harness(Bench::new(SettingsTab), &GROUPS)
}

fn views_panel() -> Panel {
    harness(Bench::new(ViewsTab::default()), &[])
}

/// The same, with the settings of a comparison open.
fn comparing() -> Panel {
    let mut panel = views_panel();
    let mut all = Everything::new();
    split(&mut all);
    panel.state_mut().set(&all);
    panel.run();
    click(&mut panel, Role::Button, "Other settings");
    panel
}

/// What comes before, which control, what is done to it, and what becomes of everything.
fn run(panel: &mut Panel, cases: Vec<Case>) {
    for (before, label, what, after) in cases {
        let mut expected = Everything::new();
        before(&mut expected);
        panel.state_mut().set(&expected);
        panel.run();
        act(panel, label, what);
        after(&mut expected);
        assert_eq!(panel.state().everything(), expected, "{label}: {what:?}");
    }
}

/// Clicks a picker of colours and types a number over its red.
fn pick_red(panel: &mut Panel, label: &str, red: &str) {
    click(panel, Role::ColorWell, label);
    let part = panel.get_by(|node| {
        node.role() == Role::SpinButton && node.value().is_some_and(|text| text.starts_with("R "))
    });
    part.click();
    panel.step();
    panel.run();
    panel.event(egui::Event::Text(red.to_owned()));
    panel.step();
    panel.key_press(egui::Key::Enter);
    panel.step();
    panel.run();
}
