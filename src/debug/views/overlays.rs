//! Overlays, one at a time or over each other.

use super::{ViewsTab, copy_button};
use crate::debug::form::{code_of_f32, label_cell, name_widget};
use crate::render::{TerrainOverlay, TerrainOverlays};
use crate::terrain::{TerrainCamera, TessellationPolicy};
use bevy::prelude::*;
use bevy_egui::egui;
use std::fmt::Write;

/// Width of the overlays' names, in points.
const NAME_WIDTH: f32 = 110.0;
/// The least opacity that an overlay comes back with: one that is hardly seen looks as if it were off.
const LEAST_REMEMBERED: f32 = 0.05;

impl ViewsTab {
    pub(super) fn overlays(&mut self, ui: &mut egui::Ui, world: &mut World, camera: Entity) {
        let was = world.get::<TerrainOverlays>(camera).cloned();
        let mut new = was.clone().unwrap_or_else(|| TerrainOverlays {
            lit: self.is_lit,
            ..default()
        });
        let shown = TerrainOverlay::ALL
            .iter()
            .filter(|overlay| new.opacity(**overlay) > 0.0);
        // Somebody else may have laid several over each other.
        self.is_blending |= shown.count() > 1;
        ui.horizontal(|ui| {
            let single = ui
                .radio(!self.is_blending, "one at a time")
                .on_hover_text("Choosing an overlay switches the others off.");
            if single.clicked() && self.is_blending {
                self.is_blending = false;
                keep_topmost(&mut new);
            }
            let blended = ui
                .radio(self.is_blending, "blended")
                .on_hover_text("Each overlay covers what lies below it as far as its opacity says.");
            if blended.clicked() {
                self.is_blending = true;
            }
            ui.checkbox(&mut new.lit, "lit").on_hover_text(
                "Whether overlays are lit like the ground; otherwise their colours are those of the \
                 legend.",
            );
        });
        self.is_lit = new.lit;
        if !self.is_blending {
            let is_off = !new.is_on();
            if ui.radio(is_off, "no overlay").clicked() {
                new.opacities = [0.0; TerrainOverlay::ALL.len()];
            }
        }
        let follows_error = world
            .get::<TerrainCamera>(camera)
            .is_some_and(|camera| matches!(camera.policy, TessellationPolicy::ScreenError { .. }));
        for overlay in TerrainOverlay::ALL {
            self.row(ui, overlay, &mut new);
            if overlay == TerrainOverlay::TriangleSize
                && follows_error
                && new.opacity(overlay) > 0.0
            {
                ui.weak(
                    "      Compared with the triangle width, which the camera's policy, screen error, \
                     does not follow.",
                );
            }
        }
        if new.is_on() {
            copy_button(ui, "Overlays", || code(&new));
        }
        if was.as_ref() == Some(&new) || (was.is_none() && !new.is_on()) {
            return;
        }
        let Ok(mut camera) = world.get_entity_mut(camera) else {
            return;
        };
        if !new.is_on() {
            camera.remove::<TerrainOverlays>();
        } else if let Some(mut overlays) = camera.get_mut::<TerrainOverlays>() {
            *overlays = new;
        } else {
            camera.insert(new);
        }
    }

    fn row(&mut self, ui: &mut egui::Ui, overlay: TerrainOverlay, overlays: &mut TerrainOverlays) {
        let name = overlay.name();
        let before = overlays.opacity(overlay);
        let was_on = before > 0.0;
        let mut is_on = was_on;
        ui.horizontal(|ui| {
            let response = if self.is_blending {
                ui.checkbox(&mut is_on, "")
            } else {
                let response = ui.radio(is_on, "");
                is_on |= response.clicked();
                response
            };
            name_widget(&response, "", name);
            label_cell(ui, name, NAME_WIDTH, was_on);
            if is_on != was_on {
                if !is_on {
                    self.remember(overlay, before);
                }
                if is_on && !self.is_blending {
                    overlays.opacities = [0.0; TerrainOverlay::ALL.len()];
                }
                overlays.opacities[overlay as usize] = if is_on {
                    self.opacities[overlay as usize]
                } else {
                    0.0
                };
            }
            let is_sliding = self.sliding == Some(overlay);
            if was_on || is_sliding {
                let mut opacity = before;
                ui.spacing_mut().slider_width = 90.0;
                let slider = ui.add(
                    egui::Slider::new(&mut opacity, 0.0..=1.0)
                        .clamping(egui::SliderClamping::Edits)
                        .update_while_editing(false),
                );
                name_widget(&slider, "opacity of ", name);
                if opacity != before && opacity.is_finite() {
                    let opacity = opacity.clamp(0.0, 1.0);
                    overlays.opacities[overlay as usize] = opacity;
                }
                // What a drag only passes is not remembered.
                if slider.dragged() {
                    self.sliding = Some(overlay);
                } else {
                    if is_sliding {
                        self.sliding = None;
                    }
                    self.remember(overlay, overlays.opacity(overlay));
                }
            }
        });
        if was_on || self.sliding == Some(overlay) {
            legend(ui, overlay);
        }
    }

    /// Notes with which opacity an overlay comes back.
    fn remember(&mut self, overlay: TerrainOverlay, opacity: f32) {
        if opacity >= LEAST_REMEMBERED {
            self.opacities[overlay as usize] = opacity;
        }
    }
}

/// The expression that makes overlays, after a comment that says what it imports.
fn code(overlays: &TerrainOverlays) -> String {
    let mut value = "TerrainOverlays::default()".to_owned();
    for overlay in TerrainOverlay::ALL {
        let opacity = overlays.opacity(overlay);
        if opacity > 0.0 {
            // A String takes whatever is written to it.
            let _ = write!(
                value,
                ".with(TerrainOverlay::{overlay:?}, {})",
                code_of_f32(opacity)
            );
        }
    }
    if overlays.lit != TerrainOverlays::default().lit {
        value = format!(
            "TerrainOverlays {{\n    lit: {},\n    ..{value}\n}}",
            overlays.lit
        );
    }
    format!("// use bevy_tessera::render::{{TerrainOverlay, TerrainOverlays}};\n{value}")
}

/// What an overlay's colours mean.
fn legend(ui: &mut egui::Ui, overlay: TerrainOverlay) {
    ui.horizontal_wrapped(|ui| {
        ui.spacing_mut().item_spacing.x = 4.0;
        ui.add_space(20.0);
        for stop in overlay.legend() {
            let (place, _) = ui.allocate_exact_size(egui::vec2(10.0, 10.0), egui::Sense::hover());
            let color = bevy::color::Srgba::from(stop.color).to_u8_array_no_alpha();
            let color = egui::Color32::from_rgb(color[0], color[1], color[2]);
            ui.painter().rect_filled(place, 1.0, color);
            ui.small(stop.label);
            ui.add_space(4.0);
        }
    });
}

/// Switches all but the topmost overlay off.
fn keep_topmost(overlays: &mut TerrainOverlays) {
    let top = TerrainOverlay::ALL
        .into_iter()
        .rfind(|overlay| overlays.opacity(*overlay) > 0.0);
    for overlay in TerrainOverlay::ALL {
        if Some(overlay) != top {
            overlays.opacities[overlay as usize] = 0.0;
        }
    }
}
