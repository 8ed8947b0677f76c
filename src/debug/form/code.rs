//! Settings as Rust code.

use bevy::color::{Color, ColorToComponents, LinearRgba, Srgba};
use bevy_egui::egui::emath::Numeric;
use std::fmt::Write;

/// A number that a control can set and code can hold.
pub(in crate::debug) trait Value: Numeric {
    /// Its literal.
    fn code(self) -> String;
}

/// A float's literal.
pub(in crate::debug) fn code_of_f32(value: f32) -> String {
    if value.is_nan() {
        "f32::NAN".to_owned()
    } else if value.is_infinite() {
        let name = if value > 0.0 {
            "f32::INFINITY"
        } else {
            "f32::NEG_INFINITY"
        };
        name.to_owned()
    } else {
        format!("{value:?}")
    }
}

/// The expression that makes a colour.
pub(in crate::debug) fn code_of_color(color: Color) -> String {
    let (space, parts) = match color {
        Color::Srgba(Srgba {
            red,
            green,
            blue,
            alpha,
        }) => ("srgb", [red, green, blue, alpha]),
        _ => ("linear_rgb", LinearRgba::from(color).to_f32_array()),
    };
    let [red, green, blue, alpha] = parts.map(code_of_f32);
    if parts[3] == 1.0 {
        format!("Color::{space}({red}, {green}, {blue})")
    } else {
        format!("Color::{space}a({red}, {green}, {blue}, {alpha})")
    }
}

impl Value for f32 {
    fn code(self) -> String {
        code_of_f32(self)
    }
}

impl Value for u8 {
    fn code(self) -> String {
        self.to_string()
    }
}

impl Value for u32 {
    fn code(self) -> String {
        self.to_string()
    }
}

impl Value for i32 {
    fn code(self) -> String {
        self.to_string()
    }
}

impl Value for u64 {
    fn code(self) -> String {
        // Bytes, nearly always.
        if self > 0 && self.trailing_zeros() >= 20 {
            format!("{} << 20", self >> 20)
        } else {
            self.to_string()
        }
    }
}

/// Fields of a struct that differ from their default.
#[derive(Debug, Default)]
pub(in crate::debug) struct Literal {
    fields: String,
}

impl Literal {
    pub(super) fn push(&mut self, name: &str, code: &str) {
        let code = code.replace('\n', "\n    ");
        // A String takes whatever is written to it.
        let _ = writeln!(self.fields, "    {name}: {code},");
    }

    pub(super) fn comment(&mut self, text: &str) {
        let _ = writeln!(self.fields, "    // {text}");
    }

    /// The expression that makes a value of the type.
    pub(in crate::debug) fn of(&self, type_name: &str) -> String {
        if self.fields.is_empty() {
            format!("{type_name}::default()")
        } else {
            format!("{type_name} {{\n{}    ..default()\n}}", self.fields)
        }
    }
}
