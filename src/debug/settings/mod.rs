//! Everything that a camera and a terrain can be set to.

pub(super) mod camera;
mod material;
mod shared;
mod terrain;

use super::form::{component, name_widget, resource};
use super::{TerrainChoice, TerrainDebugTab};
use crate::render::TerrainStatistics;
use bevy::prelude::*;
use bevy_egui::egui;

/// Everything that the chosen camera and terrain can be set to, and what all of them share.
///
/// Each group is a component or a resource. A value that differs from its default is marked and has a
/// button that resets it; "Copy as Rust" puts the group's values on the clipboard. Numbers keep to the
/// ranges of the settings' own checks; what two values together make unusable is refused with the
/// reason. A component counts as changed in the frame in which a control was used, and in no other.
#[derive(Debug, Default)]
pub struct SettingsTab;

impl TerrainDebugTab for SettingsTab {
    fn title(&self) -> &'static str {
        "Settings"
    }

    fn ui(&mut self, ui: &mut egui::Ui, world: &mut World, chosen: TerrainChoice) {
        if let Some(camera) = chosen.camera {
            component(ui, world, camera, &camera::CAMERA);
            measure(ui, world, camera);
        }
        if let Some(entity) = chosen.terrain {
            component(ui, world, entity, &terrain::TERRAIN);
            component(ui, world, entity, &material::MATERIAL);
            component(ui, world, entity, &terrain::DETAIL);
            component(ui, world, entity, &terrain::PREVIEW);
            component(ui, world, entity, &terrain::MASK);
        }
        resource(ui, world, &shared::STREAMING);
        #[cfg(feature = "avian")]
        resource(ui, world, &shared::PHYSICS);
    }
}

/// A flag of a camera's statistics.
type Flag = fn(&mut TerrainStatistics) -> &mut bool;

/// What is measured of the camera's view: flags of its statistics, which are no setting else.
fn measure(ui: &mut egui::Ui, world: &mut World, camera: Entity) {
    let flags: [(Flag, &str, &str); 2] = [
        (
            |statistics| &mut statistics.measure_triangle_sizes,
            "measure triangle sizes",
            "For the histogram in the statistics. Costs a pass over all triangles.",
        ),
        (
            |statistics| &mut statistics.measure_savings,
            "measure savings",
            "Counts what the view would have without its density map. Costs a count more than the \
             seven of each face that are made anyway.",
        ),
    ];
    for (flag, text, hover) in flags {
        let Some(mut statistics) = world.get_mut::<TerrainStatistics>(camera) else {
            return;
        };
        // A look is no change.
        let statistics = statistics.bypass_change_detection();
        let was = *flag(statistics);
        let mut is_on = was;
        let response = ui.checkbox(&mut is_on, text).on_hover_text(hover);
        name_widget(&response, "", text);
        if is_on != was
            && let Some(mut statistics) = world.get_mut::<TerrainStatistics>(camera)
        {
            *flag(&mut statistics) = is_on;
        }
    }
}
