//! Overlays, the held eye, comparisons and gizmos.

mod compare;
mod divider;
mod gizmos;
mod overlays;

pub(super) use divider::{DividerUse, drag_divider};

use super::form::name_widget;
use super::{TerrainChoice, TerrainDebugTab};
use crate::render::{TerrainComparison, TerrainOverlay, TerrainOverlays};
use crate::view::TerrainEye;
use bevy::prelude::*;
use bevy_egui::egui;

/// Overlays, the held eye, comparisons and gizmos.
///
/// A component that says nothing is taken away: with everything off, none is left.
#[derive(Debug)]
pub struct ViewsTab {
    /// Whether overlays are laid over each other; otherwise there is one at a time.
    is_blending: bool,
    /// What each overlay's opacity was when it was last on.
    opacities: [f32; TerrainOverlay::ALL.len()],
    /// Whether overlays that are switched on are lit.
    is_lit: bool,
    /// The overlay whose opacity is being dragged; it keeps its slider at 0.
    sliding: Option<TerrainOverlay>,
    /// Whether the frustum of held eyes is drawn because an eye was held here.
    has_shown_held_eyes: bool,
}

impl Default for ViewsTab {
    fn default() -> Self {
        Self {
            is_blending: false,
            opacities: [1.0; TerrainOverlay::ALL.len()],
            is_lit: TerrainOverlays::default().lit,
            sliding: None,
            has_shown_held_eyes: false,
        }
    }
}

impl TerrainDebugTab for ViewsTab {
    fn title(&self) -> &'static str {
        "Views"
    }

    fn ui(&mut self, ui: &mut egui::Ui, world: &mut World, chosen: TerrainChoice) {
        if ui
            .button("Turn everything off")
            .on_hover_text("Overlays, the held eye, the comparison and all gizmos.")
            .clicked()
        {
            self.turn_off(world, chosen);
        }
        if let Some(camera) = chosen.camera {
            section(ui, "Overlays", |ui| self.overlays(ui, world, camera));
            section(ui, "Eye and level of detail", |ui| {
                self.eye(ui, world, camera);
            });
            section(ui, "Comparison", |ui| compare::ui(ui, world, camera));
        }
        if world.contains_resource::<GizmoConfigStore>() {
            gizmos::ui(ui, world);
            if gizmos::of(world).is_none_or(|gizmos| !gizmos.held_eyes) {
                self.has_shown_held_eyes = false;
            }
        }
    }
}

fn section(ui: &mut egui::Ui, title: &str, content: impl FnOnce(&mut egui::Ui)) {
    egui::CollapsingHeader::new(egui::RichText::new(title).strong())
        .default_open(true)
        .show(ui, content);
}

/// A button that copies code to the clipboard; `label` tells it from others.
fn copy_button(ui: &mut egui::Ui, label: &str, code: impl FnOnce() -> String) {
    let copy = ui.add(egui::Button::new("Copy as Rust").small());
    name_widget(&copy, "copy as Rust: ", label);
    if copy.clicked() {
        ui.copy_text(code());
    }
}

impl ViewsTab {
    /// Colours and limits of gizmos stay as the game has set them.
    fn turn_off(&mut self, world: &mut World, chosen: TerrainChoice) {
        if let Some(camera) = chosen.camera
            && let Ok(mut camera) = world.get_entity_mut(camera)
        {
            camera.remove::<(TerrainOverlays, TerrainEye, TerrainComparison)>();
        }
        self.has_shown_held_eyes = false;
        gizmos::change(world, |gizmos| {
            gizmos.tiles = false;
            gizmos.edits = false;
            gizmos.held_eyes = false;
        });
    }

    /// The three radio buttons of Cantlay's sample.
    fn eye(&mut self, ui: &mut egui::Ui, world: &mut World, camera: Entity) {
        let was = world.get::<TerrainEye>(camera).copied().unwrap_or_default();
        let choices = [
            (
                TerrainEye::EyeAndLod,
                "Eye & LOD",
                "The camera moves both; nothing is held.",
            ),
            (
                TerrainEye::EyeOnly,
                "Eye only",
                "The camera moves; level of detail and culling stay those of the place that is left.",
            ),
            (
                TerrainEye::LodOnly,
                "LOD only",
                "The level of detail moves; the picture stays that of the place that is left.",
            ),
        ];
        ui.horizontal_wrapped(|ui| {
            for (eye, text, hover) in choices {
                let response = ui.radio(eye == was, text).on_hover_text(hover);
                if response.clicked() && eye != was {
                    self.hold(world, camera, eye);
                }
            }
            copy_button(ui, "Eye", || {
                format!("// use bevy_tessera::view::TerrainEye;\nTerrainEye::{was:?}")
            });
        });
        if was != TerrainEye::EyeAndLod {
            gizmos::reach(ui, world);
        }
    }

    /// Sets which eye is held, and has the one that the level of detail follows drawn.
    fn hold(&mut self, world: &mut World, camera: Entity, eye: TerrainEye) {
        let Ok(mut entity) = world.get_entity_mut(camera) else {
            return;
        };
        let was = entity.get::<TerrainEye>().copied().unwrap_or_default();
        if eye != TerrainEye::EyeAndLod {
            entity.insert(eye);
            if was == TerrainEye::EyeAndLod
                && gizmos::of(world).is_some_and(|gizmos| !gizmos.held_eyes)
            {
                gizmos::change(world, |gizmos| gizmos.held_eyes = true);
                self.has_shown_held_eyes = true;
            }
            return;
        }
        entity.remove::<TerrainEye>();
        let mut eyes = world.query::<&TerrainEye>();
        let is_held = eyes.iter(world).any(|eye| *eye != TerrainEye::EyeAndLod);
        if self.has_shown_held_eyes && !is_held {
            self.has_shown_held_eyes = false;
            gizmos::change(world, |gizmos| gizmos.held_eyes = false);
        }
    }
}
