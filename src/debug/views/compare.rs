//! Two settings of the chosen camera side by side.

use crate::debug::form::{Field, Form, Group, Presence, code_of_f32};
use crate::debug::settings::camera::{self, CAMERA};
use crate::render::{ComparisonView, TerrainComparison};
use crate::terrain::TerrainCamera;
use bevy::prelude::*;
use bevy_egui::egui;
use std::ops::RangeInclusive;

/// Where a divider may be, 0 the left edge and 1 the right one.
const DIVIDER_RANGE: RangeInclusive<f32> = 0.0..=1.0;
/// What differences may be multiplied by.
const GAIN_RANGE: RangeInclusive<f32> = 1.0..=64.0;
/// The gain with which a difference begins.
const FIRST_GAIN: f32 = 8.0;

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Off,
    Split,
    Difference,
}

const fn kind(comparison: Option<&TerrainComparison>) -> Kind {
    match comparison {
        None => Kind::Off,
        Some(comparison) => match comparison.view {
            ComparisonView::Split { .. } => Kind::Split,
            ComparisonView::Difference { .. } => Kind::Difference,
        },
    }
}

const fn first_view(kind: Kind) -> ComparisonView {
    match kind {
        Kind::Difference => ComparisonView::Difference { gain: FIRST_GAIN },
        Kind::Off | Kind::Split => ComparisonView::Split { divider: 0.5 },
    }
}

/// The other settings, as the group of a camera is shown.
const OTHER: Group<TerrainComparison> = Group {
    title: "Other settings",
    type_name: "TerrainComparison",
    imports: "{lattice::LodSettings, render::{ComparisonView, TerrainComparison}, \
              terrain::{TerrainCamera, TessellationPolicy}, tessellate::Partitioning}",
    presence: Presence::Required,
    is_open: false,
    check: |comparison| (CAMERA.check)(&comparison.other),
    list,
};

fn list(form: &mut Form, comparison: &mut TerrainComparison, default: &TerrainComparison) {
    if form.is_writing() {
        let TerrainComparison { other, view } = &*comparison;
        form.code("other", *other != default.other, || {
            CAMERA.literal(other).of(CAMERA.type_name)
        });
        form.code("view", *view != default.view, || match view {
            ComparisonView::Split { divider } => format!(
                "ComparisonView::Split {{ divider: {} }}",
                code_of_f32(*divider)
            ),
            ComparisonView::Difference { gain } => {
                format!(
                    "ComparisonView::Difference {{ gain: {} }}",
                    code_of_f32(*gain)
                )
            }
        });
        return;
    }
    camera::list(form, &mut comparison.other, &default.other);
}

/// Shows a camera's comparison.
pub(super) fn ui(ui: &mut egui::Ui, world: &mut World, camera: Entity) {
    let was = world.get::<TerrainComparison>(camera).cloned();
    let mut new = was.clone();
    let before = kind(was.as_ref());
    ui.horizontal_wrapped(|ui| {
        let choices = [
            (Kind::Off, "off", "The camera's own picture alone."),
            (
                Kind::Split,
                "side by side",
                "The camera's own picture to the left of a line, the other to the right.",
            ),
            (
                Kind::Difference,
                "difference",
                "The difference of the two pictures, grey where they are equal.",
            ),
        ];
        for (kind, text, hover) in choices {
            let response = ui.radio(kind == before, text).on_hover_text(hover);
            if response.clicked() && kind != before {
                new = (kind != Kind::Off).then(|| TerrainComparison {
                    view: first_view(kind),
                    ..new.take().unwrap_or_else(|| first(world, camera))
                });
            }
        }
    });
    if ui
        .button("Density off against on")
        .on_hover_text(
            "Compares with the camera's own settings without their density map, or with it in full \
             where they have none.",
        )
        .clicked()
    {
        let first = first(world, camera);
        new = Some(match new {
            Some(comparison) => TerrainComparison {
                other: first.other,
                ..comparison
            },
            None => first,
        });
    }
    if let Some(comparison) = &mut new {
        let mut form = Form::show(ui);
        match &mut comparison.view {
            ComparisonView::Split { divider } => {
                let field = Field::new(
                    "divider",
                    "",
                    "Where the line is: 0 is the left edge, 1 the right one.",
                );
                form.number(field, DIVIDER_RANGE, divider, 0.5);
            }
            ComparisonView::Difference { gain } => {
                let field = Field::new("gain", "", "What differences are multiplied by.");
                form.number(field, GAIN_RANGE, gain, FIRST_GAIN);
            }
        }
    }
    if new != was
        && let Ok(mut camera) = world.get_entity_mut(camera)
    {
        match new {
            None => {
                camera.remove::<TerrainComparison>();
            }
            Some(new) => match camera.get_mut::<TerrainComparison>() {
                Some(mut comparison) => *comparison = new,
                None => {
                    camera.insert(new);
                }
            },
        }
    }
    crate::debug::form::component(ui, world, camera, &OTHER);
}

/// The camera's own settings without density, or with it where they have none.
fn first(world: &World, camera: Entity) -> TerrainComparison {
    let own = world.get::<TerrainCamera>(camera);
    let other = own.cloned().unwrap_or_default();
    let density = if other.density > 0.0 { 0.0 } else { 1.0 };
    TerrainComparison {
        other: TerrainCamera { density, ..other },
        ..default()
    }
}
