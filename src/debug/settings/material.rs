//! How a terrain is shaded.

use crate::debug::form::{Field, Form, Group, Presence, code_of_f32};
use crate::render::TerrainMaterial;
use bevy::prelude::*;
use std::fmt::Write;

/// A terrain's material.
pub(super) const MATERIAL: Group<TerrainMaterial> = Group {
    title: "Material",
    type_name: "TerrainMaterial",
    imports: "render::TerrainMaterial",
    presence: Presence::Default,
    is_open: false,
    check: |_| None,
    list,
};

/// Colours of the default material, by parameter.
const COLOURS: [(usize, Field, [&str; 3]); 3] = [
    (
        0,
        Field::new("grass", "", "Linear colour of gentle ground."),
        ["grass red", "grass green", "grass blue"],
    ),
    (
        1,
        Field::new("rock", "", "Linear colour of steep ground."),
        ["rock red", "rock green", "rock blue"],
    ),
    (
        3,
        Field::new("scorch", "", "Linear colour of scorched earth."),
        ["scorch red", "scorch green", "scorch blue"],
    ),
];

/// Names of the parameters of a game's own material.
const PARAMETERS: [&str; 8] = [
    "parameter 0",
    "parameter 1",
    "parameter 2",
    "parameter 3",
    "parameter 4",
    "parameter 5",
    "parameter 6",
    "parameter 7",
];

fn list(form: &mut Form, material: &mut TerrainMaterial, default: &TerrainMaterial) {
    if let Some(shader) = &material.shader {
        form.comment(|| match shader.path() {
            Some(path) => format!("shader: the game's own, {path}"),
            None => "shader: the game's own, which has no path".to_owned(),
        });
    }
    form.code(
        "parameters",
        material.parameters != default.parameters,
        || code(&material.parameters, &default.parameters),
    );
    let parameters = &mut material.parameters;
    if material.shader.is_some() {
        form.note("shader: the game's own; its handle is not copied");
        for (number, label) in PARAMETERS.into_iter().enumerate() {
            let field = Field::new(label, "", "What `material_parameters` holds.");
            let mut value = parameters[number].to_array();
            form.vector(field, &mut value, default.parameters[number].to_array());
            parameters[number] = Vec4::from_array(value);
        }
        return;
    }
    for (number, field, parts) in COLOURS {
        let colour = &mut parameters[number];
        let mut value = colour.truncate().to_array();
        let default = default.parameters[number].truncate().to_array();
        form.colour(field, parts, &mut value, default);
        *colour = Vec3::from_array(value).extend(colour.w);
    }
    let mut part = |label, hover, value: &mut f32, default| {
        // Their code is the whole parameter's.
        if !form.is_writing() {
            form.number(Field::new(label, "", hover), 0.0..=1.0, value, default);
        }
    };
    part(
        "grass up to slope",
        "Ground up to this slope is grass; 0 is level, 1 vertical.",
        &mut parameters[2].x,
        default.parameters[2].x,
    );
    part(
        "rock from slope",
        "Ground from this slope on is rock; 0 is level, 1 vertical.",
        &mut parameters[2].y,
        default.parameters[2].y,
    );
    part(
        "scorch amount",
        "How much of the scorch is seen.",
        &mut parameters[3].w,
        default.parameters[3].w,
    );
}

/// A block, for an array has no `..default()`.
fn code(parameters: &[Vec4; 8], default: &[Vec4; 8]) -> String {
    let mut code =
        "{\n    let mut parameters = TerrainMaterial::default().parameters;\n".to_owned();
    for (number, (vector, default)) in parameters.iter().zip(default).enumerate() {
        if vector != default {
            let [x, y, z, w] = vector.to_array().map(code_of_f32);
            // A String takes whatever is written to it.
            let _ = writeln!(
                code,
                "    parameters[{number}] = Vec4::new({x}, {y}, {z}, {w});"
            );
        }
    }
    code.push_str("    parameters\n}");
    code
}
