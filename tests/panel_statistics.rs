//! What the panel's tabs of figures and of the map show is what is, and what they are told is done.

mod common;
#[path = "panel_statistics/figures.rs"]
mod figures;
#[path = "panel_statistics/map.rs"]
mod map;
mod streaming_support;

use bevy::prelude::*;
use bevy_egui::egui::accesskit::Role;
use bevy_egui::egui::{Event, Pos2, Rect, Shape, Ui, vec2};
use bevy_tessera::debug::{TerrainChoice, TerrainDebugTab};
use egui_kittest::Harness;
use egui_kittest::kittest::NodeT as _;
use tempfile::TempDir;

/// A tab over a world.
pub struct Shown<T> {
    pub app: App,
    pub tab: T,
    pub chosen: TerrainChoice,
    /// The folder that the terrain lies in.
    _folder: Option<TempDir>,
}

pub type Tab<T> = Harness<'static, Shown<T>>;

/// Shows a tab as the panel does.
pub fn show<T: TerrainDebugTab>(
    app: App,
    tab: T,
    chosen: TerrainChoice,
    folder: Option<TempDir>,
) -> Tab<T> {
    let mut harness = Harness::builder()
        .with_size(vec2(760.0, 1500.0))
        .with_os(bevy_egui::egui::os::OperatingSystem::Nix)
        .build_ui_state(
            |ui: &mut Ui, shown: &mut Shown<T>| {
                let Shown {
                    app, tab, chosen, ..
                } = shown;
                tab.update(app.world_mut(), *chosen);
                tab.ui(ui, app.world_mut(), *chosen);
            },
            Shown {
                app,
                tab,
                chosen,
                _folder: folder,
            },
        );
    harness.run_steps(2);
    harness
}

/// All that labels say, with where they stand.
pub fn texts<T>(harness: &Tab<T>) -> Vec<(String, Rect)> {
    let root = harness.root();
    root.children_recursive()
        // Runs of text below them say the same again.
        .filter(|node| node.accesskit_node().role() == Role::Label)
        .filter_map(|node| {
            let text = node.accesskit_node().value()?;
            Some((text, node.rect()))
        })
        .collect()
}

/// The one text that holds `words`.
pub fn text_with<T>(harness: &Tab<T>, words: &str) -> String {
    let mut texts = texts(harness);
    texts.retain(|(text, _)| text.contains(words));
    assert_eq!(texts.len(), 1, "{words}: {texts:?}");
    texts.remove(0).0
}

/// What a table's row says, from left to right.
pub fn row<T>(harness: &Tab<T>, name: &str) -> Vec<String> {
    let texts = texts(harness);
    let (_, at) = texts
        .iter()
        .find(|(text, _)| text == name)
        .unwrap_or_else(|| panic!("{name} is not in {texts:?}"));
    let mut row: Vec<_> = texts
        .iter()
        .filter(|(text, rect)| {
            text != name
                && !text.is_empty()
                && rect.min.x > at.min.x
                && (rect.center().y - at.center().y).abs() < 0.4 * at.height()
        })
        .collect();
    row.sort_by(|a, b| a.1.min.x.total_cmp(&b.1.min.x));
    row.into_iter().map(|(text, _)| text.clone()).collect()
}

/// All shapes that were painted, those in lists too.
pub fn shapes<T>(harness: &Tab<T>) -> Vec<Shape> {
    fn flatten(shape: &Shape, into: &mut Vec<Shape>) {
        match shape {
            Shape::Vec(shapes) => shapes.iter().for_each(|shape| flatten(shape, into)),
            Shape::Noop => {}
            other => into.push(other.clone()),
        }
    }
    let mut shapes = Vec::new();
    for clipped in &harness.output().shapes {
        flatten(&clipped.shape, &mut shapes);
    }
    shapes
}

/// Moves the pointer there and lets the tab notice.
pub fn hover<T>(harness: &mut Tab<T>, at: Pos2) {
    harness.event(Event::PointerMoved(at));
    harness.run_steps(2);
}
