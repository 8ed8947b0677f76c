//! The quadtree from above.

mod flight;
mod frame;
mod marks;
mod tiles;

pub use flight::TerrainCameraFlown;
pub(super) use flight::{FlightPlugin, moved_eye};
pub use tiles::MapColour;

use super::{TerrainChoice, TerrainDebugTab};
use crate::edit::TerrainEdits;
use crate::render::TerrainNodes;
use crate::stream::{TerrainPin, TerrainState};
use crate::view::{HeldTerrainEye, TerrainViews};
use bevy::math::{DAffine3, DVec2};
use bevy::prelude::*;
use bevy_egui::egui::{self, Color32, ComboBox, Mesh, Rect, Sense, Shape, Ui};
use flight::{Flight, placement};
use frame::{MapFrame, MapView};
use marks::{EditDots, MapEye};
use std::sync::Arc;
use tiles::{NodeMesh, Shown, TileMesh};

const GROUND: Color32 = Color32::from_rgb(24, 24, 28);
/// The least height of the map, points of the screen.
const LEAST_PX: f32 = 160.0;
/// How much a step of the wheel enlarges.
const WHEEL: f32 = 0.005;

/// The tab: the chosen terrain's tiles from above, north (its -z) up, with the nodes that the chosen
/// camera draws, its eye and what it sees, pins and edits.
///
/// Dragging moves it, the wheel enlarges it about the pointer, and a click flies the chosen camera
/// there; [`TerrainCameraFlown`] tells of it. What it costs grows with what is resident and drawn, not
/// with the terrain: tiles that aren't resident are shown by the square that they lie in, and so are
/// those too small to be seen.
#[derive(Default)]
pub struct MapTab {
    view: Option<MapView>,
    /// The state that `view` fits.
    instance: u64,
    follows_eye: bool,
    shown: Shown,
    tiles: TileMesh,
    nodes: NodeMesh,
    marks: Arc<Mesh>,
    dots: EditDots,
    pins: Option<QueryState<&'static TerrainPin>>,
    flight: Option<Flight>,
}

/// What is looked at in this frame.
struct Scene<'a> {
    world: &'a World,
    chosen: TerrainChoice,
    terrain: Entity,
    state: &'a TerrainState,
    local_from_world: DAffine3,
    extent_m: DVec2,
    spacing_m: f64,
}

impl<'a> Scene<'a> {
    fn new(world: &'a World, chosen: TerrainChoice) -> Option<Self> {
        let terrain = chosen.terrain?;
        let state = world.get::<TerrainState>(terrain)?;
        let [_, local_from_world] = placement(world.get(terrain)?)?;
        let file = &state.manifest().file;
        let samples = file
            .size
            .map(|samples| f64::from(samples.saturating_sub(1)));
        Some(Self {
            world,
            chosen,
            terrain,
            state,
            local_from_world,
            extent_m: DVec2::from(samples) * file.spacing_m,
            spacing_m: file.spacing_m,
        })
    }

    /// The eyes of the chosen camera with their colours: the one that sees last, for it is in front.
    fn eyes(&self) -> [Option<(MapEye, Color32)>; 2] {
        let Some(camera) = self.chosen.camera else {
            return [None, None];
        };
        let clip_from_view = self
            .world
            .get::<Projection>(camera)
            .map_or(Mat4::ZERO, |projection| projection.get_clip_from_view());
        let eye = |transform: &GlobalTransform, clip_from_view, colour| {
            let [world_from_view, _] = placement(transform)?;
            let eye = MapEye {
                local_from_view: self.local_from_world * world_from_view,
                clip_from_view,
            };
            Some((eye, colour))
        };
        match self.world.get::<HeldTerrainEye>(camera) {
            Some(held) => [
                eye(&held.lod, held.clip_from_lod_view, marks::LOD_EYE),
                eye(&held.eye, clip_from_view, marks::EYE),
            ],
            None => {
                let transform = self.world.get::<GlobalTransform>(camera);
                let eye = transform.and_then(|it| eye(it, clip_from_view, marks::EYE));
                [None, eye]
            }
        }
    }
}

impl TerrainDebugTab for MapTab {
    fn title(&self) -> &'static str {
        "Map"
    }

    fn ui(&mut self, ui: &mut Ui, world: &mut World, chosen: TerrainChoice) {
        let pins = self.pins.get_or_insert_with(|| world.query());
        pins.update_archetypes(world);
        let Some(scene) = Scene::new(world, chosen) else {
            ui.label("the chosen terrain's manifest has not loaded yet");
            return;
        };
        let fits = self.show_controls(ui, &scene);
        show_legend(ui, &scene);
        let status = self.show_map(ui, &scene, fits);
        ui.monospace(status.text);
        if let Some(at_m) = status.clicked
            && let (Some(camera), terrain) = (chosen.camera, scene.terrain)
        {
            self.flight = Flight::begin(world, camera, terrain, at_m);
        }
    }

    fn update(&mut self, world: &mut World, _chosen: TerrainChoice) {
        if let Some(flight) = &mut self.flight
            && !flight.step(world)
        {
            self.flight = None;
        }
    }
}

/// What the pointer does on the map.
struct Pointed {
    text: String,
    clicked: Option<DVec2>,
}

impl MapTab {
    /// Whether the whole terrain is to be shown.
    fn show_controls(&mut self, ui: &mut Ui, scene: &Scene) -> bool {
        ui.horizontal_wrapped(|ui| {
            let fits = ui
                .button("Fit")
                .on_hover_text("Shows the whole terrain.")
                .clicked();
            ui.checkbox(&mut self.follows_eye, "Follow eye")
                .on_hover_text("Keeps the chosen camera's eye in the middle.");
            let root_level = scene.state.root().level;
            if let Shown::Level(level) = &mut self.shown {
                *level = (*level).min(root_level);
            }
            let name = match self.shown {
                Shown::Finest => "finest resident".to_owned(),
                Shown::Level(level) => format!("level {level}"),
            };
            ComboBox::from_label("Tiles")
                .selected_text(name)
                .show_ui(ui, |ui| {
                    ui.selectable_value(&mut self.shown, Shown::Finest, "finest resident");
                    for level in 0..=root_level {
                        let name = format!("level {level}");
                        ui.selectable_value(&mut self.shown, Shown::Level(level), name);
                    }
                });
            fits
        })
        .inner
    }

    fn show_map(&mut self, ui: &mut Ui, scene: &Scene, fits: bool) -> Pointed {
        // A scrolling panel has no end; what is seen of it has.
        let status_px = 2.0 * ui.text_style_height(&egui::TextStyle::Monospace) + 8.0;
        let seen = ui.clip_rect().bottom() - ui.cursor().top();
        let height = ui.available_height().min(seen) - status_px;
        let size = egui::vec2(ui.available_width().max(LEAST_PX), height.max(LEAST_PX));
        let (rect, response) = ui.allocate_exact_size(size, Sense::click_and_drag());
        let response = response.on_hover_cursor(egui::CursorIcon::Crosshair);
        response.widget_info(|| {
            egui::WidgetInfo::labeled(egui::WidgetType::Image, true, "Map of the quadtree")
        });
        let frame = self.frame(ui, scene, rect, &response, fits);
        if ui.is_rect_visible(rect) {
            self.paint(&ui.painter_at(rect), scene, &frame);
        }
        let pointer = response.hover_pos();
        let text = pointer.map_or_else(
            || "rest on a tile to read of it; click to fly there".to_owned(),
            |pointer| self.told(scene, frame.to_ground(pointer)),
        );
        let clicked = response
            .interact_pointer_pos()
            .filter(|_| response.clicked())
            .map(|pointer| frame.to_ground(pointer));
        Pointed { text, clicked }
    }

    /// Follows what is done to the map, and to the eye.
    fn frame(
        &mut self,
        ui: &Ui,
        scene: &Scene,
        rect: Rect,
        response: &egui::Response,
        fits: bool,
    ) -> MapFrame {
        let is_other =
            std::mem::replace(&mut self.instance, scene.state.instance()) != scene.state.instance();
        let view = match self.view {
            Some(view) if !fits && !is_other => view,
            _ => MapView::fit(scene.extent_m, rect),
        };
        let mut frame = MapFrame { view, rect };
        if response.dragged() {
            self.follows_eye = false;
            frame.view = frame.panned(response.drag_delta().into());
        }
        if self.follows_eye
            && let [_, Some((eye, _))] = scene.eyes()
        {
            frame.view.centre_m = eye.at_m();
        }
        if let Some(pointer) = response.hover_pos() {
            let (scroll, zoom) = ui.input_mut(|input| {
                // The panel around it is not to scroll too.
                let scroll = std::mem::take(&mut input.smooth_scroll_delta);
                (scroll.y, input.zoom_delta())
            });
            let factor = f64::from(zoom * (WHEEL * scroll).exp());
            if factor != 1.0 {
                frame.view = frame.zoomed(factor, pointer, scene.extent_m, scene.spacing_m);
            }
        }
        self.view = Some(frame.view);
        frame
    }

    fn paint(&mut self, painter: &egui::Painter, scene: &Scene, frame: &MapFrame) {
        painter.rect_filled(frame.rect, 0.0, GROUND);
        painter.add(Shape::Mesh(self.tiles.get(scene.state, frame, self.shown)));
        self.paint_nodes(painter, scene, frame);
        // What egui has painted of the frame before lets go of it by now.
        let mesh = Arc::make_mut(&mut self.marks);
        tiles::marks(scene.state, frame, self.shown, mesh);
        let log = scene.world.get::<TerrainEdits>(scene.terrain);
        if let Some(log) = log.and_then(TerrainEdits::log) {
            self.dots.paint(log, scene.spacing_m, frame, mesh);
        }
        let pins = self
            .pins
            .iter()
            .flat_map(|pins| pins.iter_manual(scene.world));
        for pin in pins.filter(|pin| pin.terrain == scene.terrain) {
            marks::paint_pin(pin, scene.extent_m, frame, mesh);
        }
        painter.add(Shape::Mesh(Arc::clone(&self.marks)));
        for (eye, colour) in scene.eyes().into_iter().flatten() {
            eye.paint(painter, frame, scene.state, scene.extent_m, colour);
        }
        marks::paint_scale(painter, frame);
    }

    fn paint_nodes(&mut self, painter: &egui::Painter, scene: &Scene, frame: &MapFrame) {
        let Some(camera) = scene.chosen.camera else {
            return;
        };
        let view = scene.world.get::<TerrainViews>(camera);
        let Some(view) = view.and_then(|views| views.of(scene.terrain)) else {
            return;
        };
        let drawn = scene.world.get::<TerrainNodes>(camera);
        let drawn = drawn.and_then(|drawn| drawn.nodes.get(&scene.terrain));
        let drawn = drawn.map_or(&[][..], Vec::as_slice);
        let mesh = self.nodes.get(view, drawn, scene.spacing_m, frame);
        painter.add(Shape::Mesh(mesh));
    }

    /// What is to be said of a place.
    fn told(&self, scene: &Scene, at_m: DVec2) -> String {
        let place = format!("x {:.1} m, z {:.1} m", at_m.x, at_m.y);
        let state = scene.state;
        let Some(tile) = tiles::tile_at(state, at_m, self.shown) else {
            return format!("{place}: beyond the terrain");
        };
        let is = tiles::state_of(state, tile).label();
        let range = state.ground_range(tile).map_or_else(
            || "not stored".to_owned(),
            |range| {
                let file = &state.manifest().file;
                let [low_m, high_m] = [range.min, range.max].map(|height| file.height_m(height));
                format!("{low_m:.1} to {high_m:.1} m high")
            },
        );
        let why = state
            .failure(tile)
            .map_or_else(String::new, |reason| format!(": {reason}"));
        format!(
            "tile {tile}, level {}, {is}, {range}; {place}{why}",
            tile.level
        )
    }
}

/// The colours, with how many tiles or nodes there are of each.
fn show_legend(ui: &mut Ui, scene: &Scene) {
    let state = scene.state;
    let drawn = scene.chosen.camera.and_then(|camera| {
        let nodes = scene.world.get::<TerrainNodes>(camera)?;
        nodes.nodes.get(&scene.terrain).map(Vec::len)
    });
    ui.horizontal_wrapped(|ui| {
        for colour in MapColour::ALL {
            let count = match colour {
                MapColour::Drawn => drawn,
                MapColour::Resident => Some(state.resident_count()),
                MapColour::Loading => Some(state.loading_count()),
                MapColour::Failed => Some(state.failed_count()),
                MapColour::Culled | MapColour::Absent => None,
            };
            let name = colour.label();
            let text = count.map_or_else(|| name.to_owned(), |count| format!("{name} {count}"));
            key(ui, colour.colour(), text, colour.hover());
        }
        key(
            ui,
            marks::PIN,
            "pins".to_owned(),
            "Regions that are kept resident.",
        );
        let edits = "The centres of the newest 2,000 edits that count.";
        key(ui, marks::EDIT, "edits".to_owned(), edits);
        if scene.eyes()[0].is_some() {
            let held = "The eye that the level of detail follows; the white one sees the picture.";
            key(ui, marks::LOD_EYE, "held eye".to_owned(), held);
        }
    });
}

fn key(ui: &mut Ui, colour: Color32, text: String, hover: &str) {
    let side = 0.7 * ui.text_style_height(&egui::TextStyle::Body);
    let (rect, _) = ui.allocate_exact_size(egui::vec2(side, side), Sense::hover());
    ui.painter().rect_filled(rect, 1.0, colour);
    ui.label(text).on_hover_text(hover);
}
