//! Rows of controls for settings, and the Rust code that sets them.
//!
//! A group of settings lists its fields once, for a [`Form`], which either shows them or writes
//! those that differ from their default as Rust code: what is shown is what is copied.

mod code;
mod group;
mod widgets;

pub(super) use code::{Literal, code_of_color, code_of_f32};
pub(super) use group::{Group, Presence, component, resource, value};
pub(super) use widgets::{label_cell, name_widget};

use bevy::color::{Color, ColorToComponents, LinearRgba};
use bevy_egui::egui;
use code::Value;
use std::ops::RangeInclusive;
use widgets::{number_widget, range_text, row};

/// Bytes in a mebibyte.
pub(super) const MIB: f64 = (1 << 20) as f64;

/// What a control says about the field that it sets.
#[derive(Clone, Copy)]
pub(super) struct Field {
    /// What the row begins with; no two rows of a tab have the same.
    pub label: &'static str,
    /// What the field is called in Rust.
    pub name: &'static str,
    /// What stands behind a number.
    pub unit: &'static str,
    /// One of the unit in the field's own.
    pub scale: f64,
    /// What it is for.
    pub hover: &'static str,
    /// Whether a drag sets it when it ends, not on its way.
    pub is_slow: bool,
}

impl Field {
    pub(super) const fn new(label: &'static str, name: &'static str, hover: &'static str) -> Self {
        Self {
            label,
            name,
            unit: "",
            scale: 1.0,
            hover,
            is_slow: false,
        }
    }

    pub(super) const fn unit(mut self, unit: &'static str) -> Self {
        self.unit = unit;
        self
    }

    /// Set when a drag ends: what follows from it takes too long for every frame.
    pub(super) const fn slow(mut self) -> Self {
        self.is_slow = true;
        self
    }

    /// Shown in mebibytes, kept in bytes.
    pub(super) const fn mib(mut self) -> Self {
        self.unit = "MiB";
        self.scale = MIB;
        self
    }
}

enum Mode<'a> {
    Show(&'a mut egui::Ui),
    Write(Literal),
}

/// One pass over the fields of a group.
pub(super) struct Form<'a> {
    mode: Mode<'a>,
    changed: bool,
}

impl<'a> Form<'a> {
    /// Shows controls.
    pub(super) const fn show(ui: &'a mut egui::Ui) -> Self {
        Self {
            mode: Mode::Show(ui),
            changed: false,
        }
    }

    /// Writes code.
    pub(super) fn write(list: impl FnOnce(&mut Self)) -> Literal {
        let mut form = Self {
            mode: Mode::Write(Literal::default()),
            changed: false,
        };
        list(&mut form);
        match form.mode {
            Mode::Write(literal) => literal,
            Mode::Show(_) => Literal::default(),
        }
    }

    /// Whether a control has been used.
    pub(super) const fn is_changed(&self) -> bool {
        self.changed
    }

    /// Code of a field that needs more than one row, where it differs.
    pub(super) fn code(&mut self, name: &str, differs: bool, code: impl FnOnce() -> String) {
        if let Mode::Write(literal) = &mut self.mode
            && differs
        {
            literal.push(name, &code());
        }
    }

    /// A number in a range. What is typed beyond its ends becomes the nearer one; what is no number
    /// changes nothing.
    pub(super) fn number<N: Value>(
        &mut self,
        field: Field,
        range: RangeInclusive<N>,
        value: &mut N,
        default: N,
    ) {
        let differs = *value != default;
        match &mut self.mode {
            Mode::Write(literal) if differs => literal.push(field.name, &value.code()),
            Mode::Write(_) => {}
            Mode::Show(ui) => {
                let is_reset = row(ui, &field, differs, |ui, label| {
                    let (response, changed) = number_widget(ui, &field, &range, value);
                    response.labelled_by(label);
                    self.changed |= changed;
                    ui.small(range_text(&field, &range));
                });
                if is_reset {
                    *value = default;
                    self.changed = true;
                }
            }
        }
    }

    /// A number that there may be or not; switched on, it begins with `first`.
    pub(super) fn optional<N: Value>(
        &mut self,
        field: Field,
        range: RangeInclusive<N>,
        value: &mut Option<N>,
        first: N,
    ) {
        let differs = value.is_some();
        match &mut self.mode {
            Mode::Write(literal) => {
                if let Some(value) = value {
                    literal.push(field.name, &format!("Some({})", value.code()));
                }
            }
            Mode::Show(ui) => {
                let is_reset = row(ui, &field, differs, |ui, label| {
                    let mut is_some = value.is_some();
                    let check = ui.checkbox(&mut is_some, "");
                    name_widget(&check, "set ", field.label);
                    if check.changed() {
                        *value = is_some.then_some(first);
                        self.changed = true;
                    }
                    if let Some(value) = value {
                        let (response, changed) = number_widget(ui, &field, &range, value);
                        response.labelled_by(label);
                        self.changed |= changed;
                        ui.small(range_text(&field, &range));
                    }
                });
                if is_reset {
                    *value = None;
                    self.changed = true;
                }
            }
        }
    }

    /// A number whose largest value means that there is no limit; switched on, it begins with `first`.
    pub(super) fn limit(
        &mut self,
        field: Field,
        range: RangeInclusive<f32>,
        value: &mut f32,
        default: f32,
        first: f32,
    ) {
        let differs = *value != default;
        let none = *range.end();
        match &mut self.mode {
            Mode::Write(literal) if differs => literal.push(field.name, &value.code()),
            Mode::Write(_) => {}
            Mode::Show(ui) => {
                let is_reset = row(ui, &field, differs, |ui, label| {
                    let mut is_limited = *value < none;
                    let check = ui.checkbox(&mut is_limited, "");
                    name_widget(&check, "set ", field.label);
                    if check.changed() {
                        *value = if is_limited { first } else { none };
                        self.changed = true;
                    }
                    if *value < none {
                        let (response, changed) = number_widget(ui, &field, &range, value);
                        response.labelled_by(label);
                        self.changed |= changed;
                        ui.small(range_text(&field, &range));
                    } else {
                        ui.small("no limit");
                    }
                });
                if is_reset {
                    *value = default;
                    self.changed = true;
                }
            }
        }
    }

    /// On or off.
    pub(super) fn toggle(&mut self, field: Field, value: &mut bool, default: bool) {
        let differs = *value != default;
        match &mut self.mode {
            Mode::Write(literal) if differs => literal.push(field.name, &value.to_string()),
            Mode::Write(_) => {}
            Mode::Show(ui) => {
                let is_reset = row(ui, &field, differs, |ui, label| {
                    let response = ui.checkbox(value, "").labelled_by(label);
                    name_widget(&response, "", field.label);
                    self.changed |= response.changed();
                });
                if is_reset {
                    *value = default;
                    self.changed = true;
                }
            }
        }
    }

    /// One of several values, each with its text and its code.
    pub(super) fn choice<T: Copy + PartialEq>(
        &mut self,
        field: Field,
        choices: &[(T, &str, &str)],
        value: &mut T,
        default: T,
    ) {
        let differs = *value != default;
        let current = choices.iter().find(|(choice, ..)| choice == value);
        match &mut self.mode {
            Mode::Write(literal) if differs => {
                if let Some((.., code)) = current {
                    literal.push(field.name, code);
                }
            }
            Mode::Write(_) => {}
            Mode::Show(ui) => {
                let text = current.map_or("?", |(_, text, _)| text);
                let is_reset = row(ui, &field, differs, |ui, label| {
                    let combo = egui::ComboBox::from_id_salt(field.label)
                        .selected_text(text)
                        .width(if choices.len() > 5 || text.len() > 8 {
                            150.0
                        } else {
                            70.0
                        })
                        .show_ui(ui, |ui| {
                            for (choice, text, _) in choices {
                                if ui.selectable_label(choice == value, *text).clicked()
                                    && choice != value
                                {
                                    *value = *choice;
                                    self.changed = true;
                                }
                            }
                        });
                    let response = combo.response.labelled_by(label);
                    name_widget(&response, "", field.label);
                    if !field.unit.is_empty() {
                        ui.small(field.unit);
                    }
                });
                if is_reset {
                    *value = default;
                    self.changed = true;
                }
            }
        }
    }

    /// A linear colour; the caller writes its code.
    pub(super) fn colour(
        &mut self,
        field: Field,
        parts: [&'static str; 3],
        value: &mut [f32; 3],
        default: [f32; 3],
    ) {
        let Mode::Show(ui) = &mut self.mode else {
            return;
        };
        let differs = *value != default;
        let is_reset = row(ui, &field, differs, |ui, _| {
            // The picker turns colours into others and back, which changes their last digit.
            let mut picked = *value;
            let picker = ui.color_edit_button_rgb(&mut picked);
            name_widget(&picker, "", field.label);
            if picker.changed() {
                *value = picked.map(|part| part.clamp(0.0, 1.0));
                self.changed = true;
            }
            for (part, value) in parts.into_iter().zip(&mut *value) {
                let part = Field {
                    label: part,
                    ..field
                };
                let (response, changed) = number_widget(ui, &part, &(0.0..=1.0), value);
                name_widget(&response, "", part.label);
                self.changed |= changed;
            }
        });
        if is_reset {
            *value = default;
            self.changed = true;
        }
    }

    /// Colours in a row, each with what it is called; the caller writes their code.
    pub(super) fn colors(
        &mut self,
        field: Field,
        labels: &[&'static str],
        values: &mut [Color],
        defaults: &[Color],
    ) {
        let Mode::Show(ui) = &mut self.mode else {
            return;
        };
        let differs = *values != *defaults;
        let is_reset = row(ui, &field, differs, |ui, _| {
            ui.spacing_mut().interact_size.x = ui.spacing().interact_size.y;
            for (value, label) in values.iter_mut().zip(labels) {
                // The picker turns colours into others and back, which changes their last digit.
                let before = LinearRgba::from(*value);
                let mut picked = before.to_f32_array_no_alpha();
                let picker = ui.color_edit_button_rgb(&mut picked);
                name_widget(&picker, "", label);
                if picker.changed() {
                    let [red, green, blue] = picked.map(|part| part.clamp(0.0, 1.0));
                    *value = Color::linear_rgba(red, green, blue, before.alpha);
                    self.changed = true;
                }
            }
        });
        if is_reset {
            values.copy_from_slice(defaults);
            self.changed = true;
        }
    }

    /// Four numbers without names; the caller writes their code.
    pub(super) fn vector(&mut self, field: Field, value: &mut [f32; 4], default: [f32; 4]) {
        let Mode::Show(ui) = &mut self.mode else {
            return;
        };
        let differs = *value != default;
        let is_reset = row(ui, &field, differs, |ui, _| {
            for (value, part) in value.iter_mut().zip([" x", " y", " z", " w"]) {
                let (response, changed) = number_widget(ui, &field, &(f32::MIN..=f32::MAX), value);
                name_widget(&response, field.label, part);
                self.changed |= changed;
            }
        });
        if is_reset {
            *value = default;
            self.changed = true;
        }
    }

    /// A struct in a field, whose own fields `list` goes through.
    pub(super) fn nested(
        &mut self,
        name: &str,
        type_name: &str,
        differs: bool,
        list: impl FnOnce(&mut Form),
    ) {
        match &mut self.mode {
            Mode::Show(_) => list(self),
            Mode::Write(literal) => {
                if differs {
                    literal.push(name, &Form::write(list).of(type_name));
                }
            }
        }
    }

    /// A line of the code that says what it leaves out.
    pub(super) fn comment(&mut self, text: impl FnOnce() -> String) {
        if let Mode::Write(literal) = &mut self.mode {
            literal.comment(&text());
        }
    }

    /// A line of text.
    pub(super) fn note(&mut self, text: &str) {
        if let Mode::Show(ui) = &mut self.mode {
            ui.small(text);
        }
    }

    /// Whether code is written, not controls shown.
    pub(super) const fn is_writing(&self) -> bool {
        matches!(self.mode, Mode::Write(_))
    }
}
