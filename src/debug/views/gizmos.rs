//! Which lines are drawn over terrains, how many, and in which colours.

use crate::debug::form::{Field, Form, Group, Presence, code_of_color, value};
use crate::gizmos::TerrainGizmos;
use bevy::prelude::*;
use bevy_egui::egui;
use std::fmt::Write;

/// Lines over terrains.
const GIZMOS: Group<TerrainGizmos> = Group {
    title: "Gizmos",
    type_name: "TerrainGizmos",
    imports: "gizmos::TerrainGizmos",
    presence: Presence::Required,
    is_open: true,
    check: |_| None,
    list,
};

/// Names of the levels' colours.
const TILE_COLORS: [&str; 8] = [
    "tile colour 0",
    "tile colour 1",
    "tile colour 2",
    "tile colour 3",
    "tile colour 4",
    "tile colour 5",
    "tile colour 6",
    "tile colour 7",
];

const REACH: Field = Field::new(
    "frustum length",
    "held_eye_reach_m",
    "How deep the frustum of a held eye is drawn: most projections have no end.",
)
.unit("m");

/// The distance with which a limit begins, in metres.
const FIRST_WITHIN_M: f32 = 1000.0;

/// What is drawn, where there are gizmos at all.
pub(super) fn of(world: &World) -> Option<&TerrainGizmos> {
    let store = world.get_resource::<GizmoConfigStore>()?;
    store
        .get_config::<TerrainGizmos>()
        .map(|(_, gizmos)| gizmos)
}

/// Changes what is drawn; it counts as changed if it is something else then.
pub(super) fn change(world: &mut World, change: impl FnOnce(&mut TerrainGizmos)) {
    let Some(was) = of(world) else { return };
    let mut new = was.clone();
    change(&mut new);
    if new != *was
        && let Some(mut store) = world.get_resource_mut::<GizmoConfigStore>()
        && let Some((_, gizmos)) = store.get_config_mut::<TerrainGizmos>()
    {
        *gizmos = new;
    }
}

pub(super) fn ui(ui: &mut egui::Ui, world: &mut World) {
    let Some(gizmos) = of(world) else {
        ui.small("This app has no TerrainGizmosPlugin, which draws gizmos.");
        return;
    };
    if let Some(new) = value(ui, gizmos, &GIZMOS) {
        change(world, |gizmos| *gizmos = new);
    }
}

/// How deep frusta are drawn.
pub(super) fn reach(ui: &mut egui::Ui, world: &mut World) {
    let Some(gizmos) = of(world) else { return };
    let mut reach_m = gizmos.held_eye_reach_m;
    let mut form = Form::show(ui);
    form.number(
        REACH,
        TerrainGizmos::HELD_EYE_REACH_RANGE,
        &mut reach_m,
        TerrainGizmos::default().held_eye_reach_m,
    );
    if form.is_changed() {
        change(world, |gizmos| gizmos.held_eye_reach_m = reach_m);
    }
}

fn list(form: &mut Form, gizmos: &mut TerrainGizmos, default: &TerrainGizmos) {
    form.toggle(
        Field::new(
            "bounds of tiles",
            "tiles",
            "Boxes around resident tiles, a colour a level.",
        ),
        &mut gizmos.tiles,
        default.tiles,
    );
    form.number(
        Field::new(
            "most tiles",
            "most_tiles",
            "The most boxes that are drawn: those nearest to the cameras.",
        ),
        0..=u32::MAX,
        &mut gizmos.most_tiles,
        default.most_tiles,
    );
    form.limit(
        Field::new(
            "tiles within",
            "tiles_within_m",
            "Boxes further than this from all cameras are not drawn. Off, none is too far.",
        )
        .unit("m"),
        TerrainGizmos::TILES_WITHIN_RANGE,
        &mut gizmos.tiles_within_m,
        default.tiles_within_m,
        FIRST_WITHIN_M,
    );
    form.colors(
        Field::new(
            "tile colours",
            "",
            "Colours of the levels, the finest first; coarser ones begin again.",
        ),
        &TILE_COLORS,
        &mut gizmos.tile_colors,
        &default.tile_colors,
    );
    let differs = gizmos.tile_colors != default.tile_colors;
    form.code("tile_colors", differs, || {
        tile_colors(&gizmos.tile_colors, &default.tile_colors)
    });
    form.toggle(
        Field::new(
            "rectangles of edits",
            "edits",
            "Rectangles of the edits in the log, the newest brightest.",
        ),
        &mut gizmos.edits,
        default.edits,
    );
    form.number(
        Field::new(
            "most edits",
            "most_edits",
            "The most rectangles that are drawn: those of the newest edits.",
        ),
        0..=u32::MAX,
        &mut gizmos.most_edits,
        default.most_edits,
    );
    let color = |form: &mut Form, label: &'static str, name, hover, color: &mut Color, default| {
        form.colors(
            Field::new(label, "", hover),
            &[label],
            std::slice::from_mut(color),
            &[default],
        );
        form.code(name, *color != default, || code_of_color(*color));
    };
    color(
        form,
        "edit colour",
        "edit_color",
        "Colour of the newest edit.",
        &mut gizmos.edit_color,
        default.edit_color,
    );
    form.toggle(
        Field::new(
            "held eyes",
            "held_eyes",
            "The frustum of the eye that the level of detail follows, where one is held.",
        ),
        &mut gizmos.held_eyes,
        default.held_eyes,
    );
    color(
        form,
        "held eye colour",
        "held_eye_color",
        "Colour of held eyes.",
        &mut gizmos.held_eye_color,
        default.held_eye_color,
    );
    // It is shown beside the hold.
    if form.is_writing() {
        form.number(
            REACH,
            TerrainGizmos::HELD_EYE_REACH_RANGE,
            &mut gizmos.held_eye_reach_m,
            default.held_eye_reach_m,
        );
    }
}

/// A block, for an array has no `..default()`.
fn tile_colors(colors: &[Color; 8], default: &[Color; 8]) -> String {
    let mut code = "{\n    let mut colors = TerrainGizmos::default().tile_colors;\n".to_owned();
    for (number, (color, default)) in colors.iter().zip(default).enumerate() {
        if color != default {
            // A String takes whatever is written to it.
            let _ = writeln!(code, "    colors[{number}] = {};", code_of_color(*color));
        }
    }
    code.push_str("    colors\n}");
    code
}
