//! The line of a comparison side by side, dragged in the picture.

use crate::debug::TerrainPanel;
use crate::debug::form::name_widget;
use crate::render::{ComparisonView, TerrainComparison};
use bevy::prelude::*;
use bevy_egui::egui::{self, Area, Context, CursorIcon, LayerId, Order, Rect, Response, Sense};
use bevy_egui::{EguiContext, PrimaryEguiContext};

/// How wide the line counts for the pointer, in points.
const WIDTH: f32 = 8.0;
/// The grip in its middle, in points.
const GRIP: egui::Vec2 = egui::vec2(14.0, 44.0);

/// Whether the line has the pointer: the game is to see none of it then.
#[derive(Resource, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::debug) struct DividerUse(pub bool);

/// Moves the line of the camera that has egui's primary context, whether or not the panel is open.
pub(in crate::debug) fn drag_divider(
    mut cameras: Query<(&mut EguiContext, &mut TerrainComparison), With<PrimaryEguiContext>>,
    panel: Option<Res<TerrainPanel>>,
    mut divider_use: ResMut<DividerUse>,
) {
    let mut has_pointer = false;
    for (mut context, mut comparison) in &mut cameras {
        let ComparisonView::Split { divider } = comparison.view else {
            continue;
        };
        let is_open = panel.as_ref().is_some_and(|panel| panel.is_open);
        let (moved, has) = line(context.get_mut(), divider, is_open);
        has_pointer |= has;
        // One that isn't a number, too, stays what it is until it is dragged.
        if moved.to_bits() != divider.to_bits() {
            comparison.view = ComparisonView::Split { divider: moved };
        }
    }
    divider_use.set_if_neq(DividerUse(has_pointer));
}

/// Where the line is drawn, 0 to 1.
const fn place_of(divider: f32) -> f32 {
    if divider.is_nan() {
        0.5
    } else {
        divider.clamp(0.0, 1.0)
    }
}

/// Lets the line be dragged; returns where it is then, and whether it has the pointer.
fn line(ctx: &Context, divider: f32, has_grip: bool) -> (f32, bool) {
    // The context's screen is its camera's viewport.
    let screen = ctx.viewport_rect();
    if screen.width() < 1.0 || screen.height() < 1.0 {
        return (divider, false);
    }
    let x = egui::lerp(screen.x_range(), place_of(divider));
    let rect = Rect::from_x_y_ranges(x - 0.5 * WIDTH..=x + 0.5 * WIDTH, screen.y_range());
    let area = Area::new(egui::Id::new("terrain comparison divider"))
        .order(Order::Middle)
        .fixed_pos(rect.min)
        .constrain(false)
        .fade_in(false)
        .show(ctx, |ui| {
            let (_, response) = ui.allocate_exact_size(rect.size(), Sense::drag());
            let response = response.on_hover_and_drag_cursor(CursorIcon::ResizeHorizontal);
            if has_grip || response.hovered() || response.dragged() {
                paint_grip(ui, &response, egui::pos2(x, screen.center().y));
            }
            name_widget(&response, "", "divider in the picture");
            response
        });
    stay_below(ctx, area.response.layer_id);
    let response = area.inner;
    let has_pointer =
        response.hovered() || response.dragged() || response.is_pointer_button_down_on();
    let moved = match response.interact_pointer_pos() {
        Some(pointer) if response.dragged() && response.drag_delta().x != 0.0 => {
            place_of((pointer.x - screen.left()) / screen.width())
        }
        _ => divider,
    };
    (moved, has_pointer)
}

fn paint_grip(ui: &egui::Ui, response: &Response, center: egui::Pos2) {
    let visuals = ui.style().interact(response);
    // Wider than the line that it lies on.
    let painter = ui.painter().with_clip_rect(Rect::EVERYTHING);
    let rect = Rect::from_center_size(center, GRIP);
    painter.rect(
        rect.shrink(1.0),
        4.0,
        visuals.bg_fill,
        visuals.fg_stroke,
        egui::StrokeKind::Inside,
    );
    for offset in [-2.0, 2.0] {
        painter.vline(
            center.x + offset,
            rect.shrink(10.0).y_range(),
            visuals.fg_stroke,
        );
    }
}

/// Keeps the line below all windows: egui lifts what is new or pressed above them. In the layer under
/// everything egui would not say that it wants the pointer.
fn stay_below(ctx: &Context, line: LayerId) {
    let windows: Vec<LayerId> = ctx.memory(|memory| {
        let areas = memory.areas();
        let is_window = |layer: &LayerId| {
            layer.order == Order::Middle && *layer != line && areas.is_visible(layer)
        };
        // From the lowest to the highest.
        let mut below = memory.layer_ids().take_while(|layer| *layer != line);
        if !below.any(|layer| is_window(&layer)) {
            return Vec::new();
        }
        // All of them, so that they keep their order among themselves.
        memory.layer_ids().filter(is_window).collect()
    });
    for window in windows {
        ctx.move_to_top(window);
    }
}
