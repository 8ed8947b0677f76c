//! The numbers of the chosen kind, each with its range and what resets it.

use super::pointer::sample_m;
use super::tool::{BrushKind, LEAST_SPACING, TerrainBrush};
use crate::debug::form::name_widget;
use crate::edit::{CRATER_REACH, EDIT_UNITS, MAX_REACH};
use crate::stream::TerrainState;
use bevy::prelude::*;
use bevy_egui::egui;
use std::ops::RangeInclusive;

/// What numbers may be on the chosen terrain, in metres of the world.
pub(super) struct Limits {
    /// How far apart samples lie; `None` while no terrain says so.
    pub(super) sample_m: Option<f32>,
    reach_m: f32,
    height_m: f32,
}

impl Limits {
    pub(super) fn of(world: &World, terrain: Option<Entity>) -> Self {
        let found = terrain.and_then(|terrain| {
            let state = world.get::<TerrainState>(terrain)?;
            Some((state, world.get::<GlobalTransform>(terrain)?))
        });
        let Some((state, transform)) = found else {
            return Self {
                sample_m: None,
                reach_m: 10_000.0,
                height_m: 10_000.0,
            };
        };
        let sample_m = sample_m(state, transform);
        let scale = transform.affine().matrix3.x_axis.length();
        let samples = f64::from(MAX_REACH) / f64::from(EDIT_UNITS);
        let step_m = state.manifest().file.height_step_m * f64::from(u16::MAX);
        Self {
            sample_m: Some(sample_m),
            reach_m: samples as f32 * sample_m,
            height_m: step_m as f32 * scale,
        }
    }

    /// Radii of an edit that reaches `factor` times as far: from a sample on, which is what less becomes.
    fn radii(&self, factor: f32) -> RangeInclusive<f32> {
        let least_m = self.sample_m.unwrap_or(0.05);
        least_m..=(self.reach_m / factor).max(least_m)
    }
}

/// A line of a grid with a number in it, its range, and what sets it to `first`. A number that is out
/// of range stays until somebody changes it.
fn number(
    ui: &mut egui::Ui,
    name: &str,
    value: &mut f32,
    (unit, range): (&str, RangeInclusive<f32>),
    first: f32,
) -> bool {
    let [least, most] = [*range.start(), *range.end()];
    let hint = format!("{} at first", short(first) + unit);
    let label = ui.label(name).on_hover_text(&hint);
    let speed = if unit == " m" {
        (0.01 * value.abs()).max(0.01)
    } else if unit == "°" {
        1.0
    } else {
        0.01
    };
    let mut now = *value;
    let field = egui::DragValue::new(&mut now)
        .range(range)
        .clamp_existing_to_range(false)
        .speed(speed)
        .max_decimals(3)
        .suffix(unit);
    let field = ui.add(field).labelled_by(label.id).on_hover_text(&hint);
    let mut changed = field.changed() && now.is_finite();
    if changed {
        *value = now.clamp(least, most);
    }
    ui.horizontal(|ui| {
        // Angles and turned signs come back from their conversions almost the same.
        let is_first = (*value - first).abs() <= 1e-5 * first.abs();
        let reset = egui::Button::new("⟲").small().frame(false);
        let reset = ui.add_enabled(!is_first, reset);
        name_widget(&reset, "reset ", name);
        if reset.on_hover_text(hint).clicked() {
            *value = first;
            changed = true;
        }
        ui.weak(format!("{} – {}", short(least), short(most)));
    });
    ui.end_row();
    changed
}

fn short(value: f32) -> String {
    let value = (value * 100.0).round() / 100.0;
    format!("{value}")
}

const SHARE: RangeInclusive<f32> = 0.0..=1.0;
const DENSITIES: RangeInclusive<f32> = 0.0..=10.0;

/// The chosen kind's numbers, the seed and the spacing.
pub(super) fn numbers(ui: &mut egui::Ui, brush: &mut TerrainBrush, limits: &Limits) {
    let mut first = limits
        .sample_m
        .map_or_else(TerrainBrush::default, TerrainBrush::first_on);
    first.kind = brush.kind;
    let heights = || (" m", 0.0..=limits.height_m);
    let share = || ("", SHARE);
    let radius = |ui: &mut egui::Ui, brush: &mut TerrainBrush, factor: f32| {
        let mut radius_m = brush.radius_m();
        let range = (" m", limits.radii(factor));
        if number(ui, "Radius", &mut radius_m, range, first.radius_m()) {
            brush.set_radius_m(radius_m);
        }
    };
    match brush.kind {
        BrushKind::Crater => {
            radius(ui, brush, CRATER_REACH as f32);
            let (now, first) = (&mut brush.crater, &first.crater);
            number(ui, "Depth", &mut now.depth_m, heights(), first.depth_m);
            number(ui, "Rim", &mut now.rim_m, heights(), first.rim_m);
            number(
                ui,
                "Roughness",
                &mut now.roughness,
                share(),
                first.roughness,
            );
            density(ui, &mut now.density_per_m, first.density_per_m);
            number(ui, "Scorch", &mut now.scorch, share(), first.scorch);
            seed(ui, brush);
        }
        BrushKind::Raise => {
            radius(ui, brush, 1.0);
            let (now, first) = (&mut brush.raise, &first.raise);
            number(ui, "Raise by", &mut now.by_m, heights(), first.by_m);
            number(ui, "Hardness", &mut now.hardness, share(), first.hardness);
            density(ui, &mut now.density_per_m, first.density_per_m);
        }
        BrushKind::Lower => {
            radius(ui, brush, 1.0);
            let (now, first) = (&mut brush.lower, &first.lower);
            let mut by_m = -now.by_m;
            if number(ui, "Lower by", &mut by_m, heights(), -first.by_m) {
                now.by_m = -by_m;
            }
            number(ui, "Hardness", &mut now.hardness, share(), first.hardness);
            density(ui, &mut now.density_per_m, first.density_per_m);
        }
        BrushKind::Flatten => {
            radius(ui, brush, 1.0);
            let (now, first) = (&mut brush.flatten, &first.flatten);
            number(ui, "Strength", &mut now.strength, share(), first.strength);
            number(ui, "Hardness", &mut now.hardness, share(), first.hardness);
        }
        BrushKind::Smooth => {
            radius(ui, brush, 1.0);
            let (now, first) = (&mut brush.smooth, &first.smooth);
            number(ui, "Strength", &mut now.strength, share(), first.strength);
            number(ui, "Hardness", &mut now.hardness, share(), first.hardness);
        }
        BrushKind::Stamp => {
            let mut side_m = brush.stamp.side_m;
            let radii = limits.radii(std::f32::consts::SQRT_2);
            let sides = 2.0 * radii.start()..=2.0 * radii.end();
            if number(ui, "Side", &mut side_m, (" m", sides), first.stamp.side_m) {
                brush.set_radius_m(0.5 * side_m);
            }
            let (now, first) = (&mut brush.stamp, &first.stamp);
            let both = -limits.height_m..=limits.height_m;
            number(ui, "White adds", &mut now.by_m, (" m", both), first.by_m);
            let mut degrees = now.turn.to_degrees();
            let turns = ("°", -360.0..=360.0);
            if number(ui, "Turn", &mut degrees, turns, first.turn.to_degrees()) {
                now.turn = degrees.to_radians();
            }
            density(ui, &mut now.density_per_m, first.density_per_m);
            number(ui, "Scorch", &mut now.scorch, share(), first.scorch);
        }
    }
    let spacings = (" radii", LEAST_SPACING..=4.0);
    number(ui, "Spacing", &mut brush.spacing, spacings, first.spacing);
}

fn density(ui: &mut egui::Ui, value: &mut f32, first: f32) {
    number(ui, "Density", value, (" a metre", DENSITIES), first);
}

fn seed(ui: &mut egui::Ui, brush: &mut TerrainBrush) {
    let label = ui.label("Seed").on_hover_text("of the outline's noise");
    ui.add(egui::DragValue::new(&mut brush.seed))
        .labelled_by(label.id);
    ui.checkbox(&mut brush.seed_follows_strokes, "New every stroke");
    ui.end_row();
}
