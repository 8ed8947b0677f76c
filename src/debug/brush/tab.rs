//! The panel's tab.

use super::files::{self, BrushFiles, EditFormat, Said, load_edits, read_stamp, save_edits};
use super::list::{self, Known};
use super::numbers::{Limits, numbers};
use super::pointer::{BrushHand, BrushMessages};
use super::stroke::{redo_stroke, undo_stroke};
use super::tool::{BrushKind, MarkedEdit, TerrainBrush};
use crate::debug::map::{TerrainCameraFlown, moved_eye};
use crate::debug::{TerrainChoice, TerrainDebugTab};
use crate::edit::{RedoEdit, TerrainEdits, UndoEdit};
use crate::stream::TerrainState;
use bevy::math::DVec2;
use bevy::prelude::*;
use bevy::time::Real;
use bevy_egui::egui;
use std::path::Path;

/// Heights of the list in points: it takes what is left, within these.
const LIST_HEIGHTS: [f32; 2] = [160.0, 480.0];

/// The tab: the brush, and the chosen terrain's log. What the brush is set to is in
/// [`TerrainBrush`]; the list costs what is seen of it, however long the log is.
#[derive(Debug)]
pub struct BrushTab {
    known: Known,
    /// Of the log's file.
    path: String,
    /// Of the stamp's image.
    stamp_path: String,
    row: String,
}

impl Default for BrushTab {
    fn default() -> Self {
        Self {
            known: Known::default(),
            path: "terrain.edits".to_owned(),
            stamp_path: String::new(),
            row: String::new(),
        }
    }
}

impl TerrainDebugTab for BrushTab {
    fn title(&self) -> &'static str {
        "Edit"
    }

    fn ui(&mut self, ui: &mut egui::Ui, world: &mut World, chosen: TerrainChoice) {
        if !world.contains_resource::<TerrainBrush>() || !world.contains_resource::<BrushFiles>() {
            ui.label("There is no brush: add bevy_tessera's BrushPlugin to the app.");
            return;
        }
        BrushHand::see(world);
        self.brush(ui, world, chosen);
        ui.separator();
        let Some(terrain) = chosen.terrain else {
            ui.label("No terrain is chosen.");
            return;
        };
        self.follow(world, terrain);
        self.history(ui, world, terrain);
        self.files(ui, world, terrain);
        ui.separator();
        self.list(ui, world, terrain, chosen.camera);
    }

    fn update(&mut self, world: &mut World, _chosen: TerrainChoice) {
        BrushHand::see(world);
    }
}

impl BrushTab {
    fn brush(&mut self, ui: &mut egui::Ui, world: &mut World, chosen: TerrainChoice) {
        let limits = Limits::of(world, chosen.terrain);
        let before = world.resource::<TerrainBrush>();
        let mut brush = before.clone();
        // What is chosen at the panel's top is what is edited.
        brush.terrain = chosen.terrain;
        brush.camera = chosen.camera;
        let tool = ui.checkbox(&mut brush.on, "Tool on").on_hover_text(
            "click on the ground to edit it, drag to paint; off when the panel is closed",
        );
        if tool.changed() {
            BrushHand::switch(world, brush.on);
        }
        ui.horizontal_wrapped(|ui| {
            for kind in BrushKind::ALL {
                ui.selectable_value(&mut brush.kind, kind, kind.name());
            }
        });
        egui::Grid::new("brush numbers")
            .num_columns(3)
            .show(ui, |ui| numbers(ui, &mut brush, &limits));
        if brush.kind == BrushKind::Stamp {
            self.stamp(ui, world);
        }
        ui.horizontal_wrapped(|ui| {
            ui.checkbox(&mut brush.keeps_shape, "Heights follow the radius");
            if ui
                .button("Defaults")
                .on_hover_text("the chosen kind's numbers as they were at first")
                .clicked()
            {
                brush.reset_kind();
                if let Some(sample_m) = limits.sample_m {
                    brush.grow_kind_to(sample_m);
                }
            }
            if ui
                .button("Copy as Rust")
                .on_hover_text("the command that makes such an edit at `point`, as code")
                .clicked()
            {
                ui.ctx().copy_text(brush.code());
            }
        });
        ui.checkbox(&mut brush.keys, "Keys").on_hover_text(
            "[ and ] change the radius, Ctrl+Z undoes, Ctrl+Shift+Z redoes, while the tool is on",
        );
        if brush != *world.resource::<TerrainBrush>() {
            *world.resource_mut::<TerrainBrush>() = brush;
        }
    }

    fn stamp(&mut self, ui: &mut egui::Ui, world: &mut World) {
        ui.horizontal(|ui| {
            let label = ui.label("Image");
            ui.add(
                egui::TextEdit::singleline(&mut self.stamp_path)
                    .hint_text("a square PNG, up to 1024 pixels a side")
                    .desired_width(180.0),
            )
            .labelled_by(label.id);
            let path = self.stamp_path.trim();
            if ui
                .add_enabled(!path.is_empty(), egui::Button::new("Read"))
                .clicked()
            {
                read_stamp(world, Path::new(path));
            }
            if world.resource::<BrushFiles>().is_reading_stamp() {
                ui.label("reading …");
            }
        });
        let files = world.resource::<BrushFiles>();
        match &files.image_said {
            Some(message) => say(ui, message),
            None if world.resource::<TerrainBrush>().image.is_none() => {
                ui.label("Without an image a stamp does nothing.");
            }
            None => {}
        }
    }

    /// Brings what is known of the log up to date.
    fn follow(&mut self, world: &World, terrain: Entity) {
        let edits = world.get::<TerrainEdits>(terrain);
        match edits.and_then(|edits| Some((edits.log()?, edits.instance()))) {
            Some((log, instance)) => self.known.follow(log, instance),
            None => self.known = Known::default(),
        }
    }

    fn history(&mut self, ui: &mut egui::Ui, world: &mut World, terrain: Entity) {
        let known = &self.known;
        let active = known.rows() - known.undone;
        let redoable = known.redoable;
        ui.horizontal_wrapped(|ui| {
            let undo = egui::Button::new(format!("Undo ({active})"));
            if ui
                .add_enabled(active > 0, undo)
                .on_hover_text("takes the newest edit back, a stroke as a whole")
                .clicked()
            {
                undo_stroke(world, Some(terrain));
            }
            let redo = egui::Button::new(format!("Redo ({redoable})"));
            if ui
                .add_enabled(redoable > 0, redo)
                .on_hover_text("makes what was taken back last again")
                .clicked()
            {
                redo_stroke(world, Some(terrain));
            }
        });
        self.follow(world, terrain);
        let known = &self.known;
        ui.label(format!(
            "{} edits, {} undone, {} in memory",
            known.rows(),
            known.undone,
            bytes(known.bytes)
        ));
        let now = world.get_resource::<Time<Real>>();
        let now = now.map(|time| time.elapsed()).unwrap_or_default();
        if let Some(messages) = world.get_resource::<BrushMessages>() {
            for reason in messages.refused(Some(terrain), now) {
                ui.colored_label(ui.visuals().warn_fg_color, reason);
            }
        }
    }

    fn files(&mut self, ui: &mut egui::Ui, world: &mut World, terrain: Entity) {
        ui.horizontal(|ui| {
            let label = ui.label("File");
            ui.add(egui::TextEdit::singleline(&mut self.path).desired_width(220.0))
                .labelled_by(label.id);
        });
        let path = Path::new(self.path.trim());
        let is_busy = world.resource::<BrushFiles>().is_busy();
        ui.horizontal_wrapped(|ui| {
            ui.add_enabled_ui(!is_busy && !path.as_os_str().is_empty(), |ui| {
                if ui.button("Save").clicked() {
                    save_edits(world, terrain, path, EditFormat::Binary);
                }
                if ui
                    .button("Save as RON")
                    .on_hover_text("text, to be read by people; loads as well")
                    .clicked()
                {
                    save_edits(world, terrain, path, EditFormat::Ron);
                }
                if ui
                    .button("Load")
                    .on_hover_text("in the place of the edits that are here")
                    .clicked()
                {
                    load_edits(world, terrain, path);
                }
            });
            if let Some(edits) = world.resource::<BrushFiles>().replaced(terrain)
                && ui
                    .button(format!("Bring {edits} edits back"))
                    .on_hover_text("those that the loaded ones took the place of")
                    .clicked()
            {
                files::bring_back(world, terrain);
            }
            if is_busy {
                ui.label("working …");
            }
        });
        if let Some(message) = &world.resource::<BrushFiles>().log_said {
            say(ui, message);
        }
    }

    fn list(
        &mut self,
        ui: &mut egui::Ui,
        world: &mut World,
        terrain: Entity,
        camera: Option<Entity>,
    ) {
        let marked = world.resource::<TerrainBrush>().marked;
        let marked = marked.filter(|marked| marked.terrain == terrain);
        self.marked(ui, world, camera, marked);
        self.follow(world, terrain);
        let Self { known, row, .. } = self;
        let mut clicked = None;
        let mut flown = None;
        let (Some(edits), Some(state)) = (
            world.get::<TerrainEdits>(terrain),
            world.get::<TerrainState>(terrain),
        ) else {
            return;
        };
        let (Some(log), file) = (edits.log(), &state.manifest().file) else {
            return;
        };
        let header = "     # kind         x m      z m  reach m";
        ui.label(egui::RichText::new(header).monospace().weak());
        let height = ui.text_style_height(&egui::TextStyle::Monospace);
        let height = height + 2.0 * ui.spacing().button_padding.y;
        let [least, most] = LIST_HEIGHTS;
        egui::ScrollArea::vertical()
            .id_salt("edits")
            .max_height(ui.available_height().clamp(least, most))
            .auto_shrink([false, true])
            .show_rows(ui, height, known.rows(), |ui, rows| {
                for at in rows {
                    let Some(sequence) = known.sequence(at) else {
                        continue;
                    };
                    let Some(edit) = log.edit(sequence) else {
                        continue;
                    };
                    list::write_row(row, sequence, edit, file);
                    let is_active = log.is_active(sequence);
                    let mut text = egui::RichText::new(row.as_str()).monospace();
                    if !is_active {
                        text = text.weak().strikethrough();
                    }
                    let is_marked = marked.is_some_and(|marked| marked.sequence == sequence);
                    let button = egui::Button::selectable(is_marked, text)
                        .min_size(egui::vec2(0.0, height))
                        .wrap_mode(egui::TextWrapMode::Extend);
                    let response = ui.add(button).on_hover_ui(|ui| {
                        for line in list::describe(sequence, is_active, edit, file) {
                            ui.label(line);
                        }
                    });
                    if response.double_clicked() {
                        flown = Some(sequence);
                    } else if response.clicked() {
                        clicked = Some((sequence, is_marked));
                    }
                }
            });
        let mark = |sequence| Some(MarkedEdit { terrain, sequence });
        if let Some((sequence, was_marked)) = clicked {
            let now = if was_marked { None } else { mark(sequence) };
            world.resource_mut::<TerrainBrush>().marked = now;
        }
        if let Some(sequence) = flown {
            world.resource_mut::<TerrainBrush>().marked = mark(sequence);
            if let Some(camera) = camera {
                fly(world, camera, terrain, sequence);
            }
        }
    }

    /// What can be done with the edit that is marked.
    fn marked(
        &mut self,
        ui: &mut egui::Ui,
        world: &mut World,
        camera: Option<Entity>,
        marked: Option<MarkedEdit>,
    ) {
        ui.horizontal_wrapped(|ui| {
            let Some(MarkedEdit { terrain, sequence }) = marked else {
                ui.label("Click an edit to mark it on the ground.");
                return;
            };
            let edits = world.get::<TerrainEdits>(terrain);
            let log = edits.and_then(TerrainEdits::log);
            let is_active = log.is_some_and(|log| log.is_active(sequence));
            ui.label(format!("Edit {sequence}"));
            if let Some(camera) = camera
                && ui.button("Fly there").clicked()
            {
                fly(world, camera, terrain, sequence);
            }
            let (terrain, sequence) = (Some(terrain), Some(sequence));
            if is_active && ui.button("Undo it").clicked() {
                world.trigger(UndoEdit { terrain, sequence });
                world.flush();
            } else if !is_active && ui.button("Redo it").clicked() {
                world.trigger(RedoEdit { terrain, sequence });
                world.flush();
            }
            if ui.button("Unmark").clicked() {
                world.resource_mut::<TerrainBrush>().marked = None;
            }
        });
    }
}

fn say(ui: &mut egui::Ui, message: &Said) {
    if message.is_error {
        ui.colored_label(ui.visuals().error_fg_color, &message.text);
    } else {
        ui.label(&message.text);
    }
}

fn bytes(bytes: usize) -> String {
    match bytes {
        0..10_000 => format!("{bytes} bytes"),
        10_000..10_000_000 => format!("{:.1} kB", bytes as f64 / 1e3),
        _ => format!("{:.1} MB", bytes as f64 / 1e6),
    }
}

/// Brings a camera to where an edit is seen, from the side that it comes from.
fn fly(world: &mut World, camera: Entity, terrain: Entity, sequence: u64) {
    let Some(to) = view_of(world, camera, terrain, sequence) else {
        return;
    };
    let parent = world.get::<ChildOf>(camera).map(ChildOf::parent);
    let parent = parent.and_then(|parent| world.get::<GlobalTransform>(parent));
    let to = parent.map_or(to, |parent| GlobalTransform::from(to).reparented_to(parent));
    if let Some(mut transform) = world.get_mut::<Transform>(camera) {
        // A camera's scale is its own.
        (transform.translation, transform.rotation) = (to.translation, to.rotation);
        world.trigger(TerrainCameraFlown {
            entity: camera,
            terrain,
            is_there: true,
        });
        world.flush();
    }
}

fn view_of(world: &World, camera: Entity, terrain: Entity, sequence: u64) -> Option<Transform> {
    let state = world.get::<TerrainState>(terrain)?;
    let affine = world.get::<GlobalTransform>(terrain)?.affine();
    let log = world.get::<TerrainEdits>(terrain)?.log()?;
    let edit = log.edit(sequence)?;
    let file = &state.manifest().file;
    let last = DVec2::from(file.size.map(|samples| f64::from(samples) - 1.0)) * file.spacing_m;
    let ground = |at: DVec2| {
        let height = state.height(at.clamp(DVec2::ZERO, last));
        let height_m = height.map_or(0.0, |height| height.height_m);
        affine.transform_point3(Vec3::new(at.x as f32, height_m as f32, at.y as f32))
    };
    let centre = ground(list::place_m(edit, file));
    let scale = affine.matrix3.x_axis.length();
    let reach = (list::reach_m(edit, file) as f32 * scale).max(2.0);
    let forward = moved_eye(world, camera)?.forward();
    let forward = forward.with_y(0.0).normalize_or(Vec3::NEG_Z);
    let eye = centre - forward * (2.5 * reach) + Vec3::Y * (1.5 * reach);
    // Over a hill rather than in it.
    let below = affine.inverse().transform_point3(eye).xz().as_dvec2();
    let least = ground(below).y + 0.5 * reach;
    let eye = eye.with_y(eye.y.max(least));
    Some(Transform::from_translation(eye).looking_at(centre, Vec3::Y))
}
