//! The controls themselves.

use super::Field;
use super::code::Value;
use bevy_egui::egui::{self, Align2, Id, Response, Sense, TextStyle, WidgetInfo, WidgetType, vec2};
use std::ops::RangeInclusive;

/// Width of the column of labels, in points.
const LABEL_WIDTH: f32 = 122.0;
/// Width of the column of reset buttons.
const RESET_WIDTH: f32 = 18.0;

/// Tells assistive technology, and tests, what a control is called.
pub(in crate::debug) fn name_widget(response: &Response, before: &str, label: &str) {
    response.ctx.accesskit_node_builder(response.id, |node| {
        node.clear_labelled_by();
        node.set_label(format!("{before}{label}"));
    });
}

/// A label of a fixed width; in the colour of what differs where it does.
pub(in crate::debug) fn label_cell(
    ui: &mut egui::Ui,
    label: &str,
    width: f32,
    differs: bool,
) -> Response {
    let height = ui.spacing().interact_size.y;
    let (rect, response) = ui.allocate_exact_size(vec2(width, height), Sense::hover());
    if ui.is_rect_visible(rect) {
        let visuals = ui.visuals();
        let colour = if differs {
            visuals.warn_fg_color
        } else {
            visuals.text_color()
        };
        let font = TextStyle::Body.resolve(ui.style());
        let place = rect.left_center();
        ui.painter()
            .text(place, Align2::LEFT_CENTER, label, font, colour);
    }
    response.widget_info(|| WidgetInfo::labeled(WidgetType::Label, ui.is_enabled(), label));
    response
}

/// Whether the button that sets a field to its default was clicked; there is one where it differs.
fn reset_button(ui: &mut egui::Ui, label: &str, differs: bool) -> bool {
    let size = vec2(RESET_WIDTH, ui.spacing().interact_size.y);
    if !differs {
        ui.allocate_exact_size(size, Sense::hover());
        return false;
    }
    let response = ui.add(egui::Button::new("⟲").small().frame(false).min_size(size));
    name_widget(&response, "reset ", label);
    response.on_hover_text("set it to its default").clicked()
}

/// A row: what resets it, its label, and what `content` adds, which is given the label's id. Returns
/// whether the field is to be reset.
pub(super) fn row(
    ui: &mut egui::Ui,
    field: &Field,
    differs: bool,
    content: impl FnOnce(&mut egui::Ui, Id),
) -> bool {
    ui.horizontal(|ui| {
        // What is scrolled out of sight costs nothing but its place.
        if !ui.is_rect_visible(ui.max_rect()) {
            ui.allocate_space(vec2(LABEL_WIDTH, ui.spacing().interact_size.y));
            return false;
        }
        ui.spacing_mut().item_spacing.x = 3.0;
        let is_reset = reset_button(ui, field.label, differs);
        let label = label_cell(ui, field.label, LABEL_WIDTH, differs);
        let id = label.id;
        label.on_hover_text(field.hover);
        content(ui, id);
        is_reset
    })
    .inner
}

/// Whether a field's numbers are whole as they are shown.
const fn is_whole<N: Value>(field: &Field) -> bool {
    N::INTEGRAL && field.scale == 1.0
}

/// A number of a field as text. Whole ones are exact; others have as many digits as it takes to tell
/// them from their neighbours, at most four behind the point for what isn't tiny.
fn number_text<N: Value>(field: &Field, number: f64) -> String {
    if is_whole::<N>(field) {
        return format!("{number:.0}");
    }
    #[expect(
        clippy::cast_possible_truncation,
        reason = "what is shown has the precision of what is set"
    )]
    let short = number as f32;
    let size = short.abs();
    if size != 0.0 && !(1e-4..1e9).contains(&size) {
        format!("{short:e}")
    } else if size < 1000.0 {
        short.to_string()
    } else {
        // Whole numbers above what an f32 tells apart.
        ((number * 1e3).round() / 1e3).to_string()
    }
}

/// The range of a field, as a row ends with it.
pub(super) fn range_text<N: Value>(field: &Field, range: &RangeInclusive<N>) -> String {
    let text = |end: &N| {
        let end = (end.to_f64() / field.scale * 1e3).round() / 1e3;
        number_text::<N>(field, end)
    };
    let least = range.start().to_f64();
    let most = range.end().to_f64();
    // Above 0 are ranges that begin with the least number that there is.
    let is_above_0 = least > 0.0 && least < 1e-30;
    let has_end = most < 1e12 && !(N::INTEGRAL && *range.end() == N::MAX);
    match (is_above_0, has_end) {
        _ if least < -1e12 => String::new(),
        (true, true) => format!("above 0, to {}", text(range.end())),
        (true, false) => "above 0".to_owned(),
        (false, true) => format!("{} – {}", text(range.start()), text(range.end())),
        (false, false) => format!("from {}", text(range.start())),
    }
}

/// A number that is dragged or typed, and whether it has changed.
pub(super) fn number_widget<N: Value>(
    ui: &mut egui::Ui,
    field: &Field,
    range: &RangeInclusive<N>,
    value: &mut N,
) -> (Response, bool) {
    let before = value.to_f64() / field.scale;
    let (least, most) = (range.start().to_f64(), range.end().to_f64());
    let span = (most - least) / field.scale;
    // Over many orders of magnitude a step is a part of what is there.
    let mut speed = if span < 1e3 {
        span / 300.0
    } else {
        before.abs().max(0.01) / 100.0
    };
    if is_whole::<N>(field) {
        speed = speed.max(0.05);
    }
    // Where a drag of a slow field has come to.
    let dragged = ui.next_auto_id().with("dragged to");
    let mut shown = before;
    if field.is_slow {
        shown = ui.data(|data| data.get_temp(dragged)).unwrap_or(before);
    }
    let at = shown;
    let mut drag = egui::DragValue::new(&mut shown)
        .speed(speed)
        .range(least / field.scale..=most / field.scale)
        .clamp_existing_to_range(false)
        .update_while_editing(false)
        .custom_formatter(|number, _| number_text::<N>(field, number))
        .custom_parser(|text| {
            let number: f64 = text.trim().parse().ok()?;
            number.is_finite().then_some(number)
        });
    if is_whole::<N>(field) {
        drag = drag.max_decimals(0);
    }
    if !field.unit.is_empty() {
        drag = drag.suffix(format!(" {}", field.unit));
    }
    let response = ui.add(drag);
    if field.is_slow {
        if response.dragged() {
            ui.data_mut(|data| data.insert_temp(dragged, shown));
            return (response, false);
        }
        ui.data_mut(|data| data.remove::<f64>(dragged));
        // A drag whose end nobody has seen counts for nothing.
        if shown == at && !response.drag_stopped() {
            return (response, false);
        }
    }
    // What was only looked at in a text field has lost the digits that aren't shown, and no more.
    let is_same =
        shown == before || number_text::<N>(field, shown) == number_text::<N>(field, before);
    let mut new = *value;
    if !is_same && shown.is_finite() {
        let number = shown * field.scale;
        new = N::from_f64(if N::INTEGRAL { number.round() } else { number });
        if new < *range.start() {
            new = *range.start();
        } else if new > *range.end() {
            new = *range.end();
        }
    }
    let is_changed = new != *value;
    *value = new;
    (response, is_changed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_say_where_they_begin_and_whether_they_end() {
        let field = Field::new("a", "a", "");
        assert_eq!(range_text(&field, &(0..=u64::MAX)), "from 0");
        assert_eq!(range_text(&field.mib(), &(0..=u64::MAX)), "from 0");
        assert_eq!(range_text(&field, &(0..=u32::MAX)), "from 0");
        assert_eq!(range_text(&field, &(1u32..=64)), "1 – 64");
        assert_eq!(
            range_text(&field, &(f32::MIN_POSITIVE..=f32::MAX)),
            "above 0"
        );
        assert_eq!(
            range_text(&field, &(f32::MIN_POSITIVE..=2.5)),
            "above 0, to 2.5"
        );
        assert_eq!(range_text(&field, &(0.0..=f32::MAX)), "from 0");
        assert_eq!(range_text(&field, &(f32::MIN..=f32::MAX)), "");
    }
}
