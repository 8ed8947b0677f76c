//! Tiles and nodes as triangles: one mesh each, however many there are.

use super::frame::{MapFrame, MapView};
use crate::lattice::{Lattice, Node, ViewLod};
use crate::stream::TerrainState;
use crate::tile::{TILE_SAMPLES, TileAddress};
use crate::view::TerrainView;
use bevy::math::DVec2;
use bevy_egui::egui::{Color32, Mesh, Rect, Vec2, pos2};
use std::sync::Arc;

/// Squares smaller than this are shown by the one that they lie in, points of the screen.
const LEAST_PX: f32 = 2.0;
/// Squares smaller than this have no outline.
const OUTLINED_PX: f32 = 8.0;
/// What has failed or loads is shown at least so large.
const LEAST_MARK_PX: f32 = 4.0;
/// The most tiles that are marked one by one.
const MOST_MARKS: usize = 1024;

/// What the map's colours stand for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum MapColour {
    /// Ground of nodes that the chosen camera draws.
    Drawn,
    /// Outline of nodes that its level of detail would draw, but that nobody sees.
    Culled,
    /// A tile that is resident.
    Resident,
    /// A tile that was asked for and has no page yet.
    Loading,
    /// A tile that is missing or corrupt.
    Failed,
    /// A tile that is stored and not resident.
    Absent,
}

impl MapColour {
    /// All of them.
    pub const ALL: [Self; 6] = [
        Self::Drawn,
        Self::Culled,
        Self::Resident,
        Self::Loading,
        Self::Failed,
        Self::Absent,
    ];

    /// The colour as it is painted; that of drawn ground lets the tiles below shine through.
    #[must_use]
    pub const fn colour(self) -> Color32 {
        match self {
            Self::Drawn => Color32::from_rgba_premultiplied(38, 110, 34, 150),
            Self::Culled => Color32::from_rgb(34, 60, 92),
            Self::Resident => Color32::from_rgb(66, 104, 150),
            Self::Loading => Color32::from_rgb(237, 201, 72),
            Self::Failed => Color32::from_rgb(225, 60, 60),
            Self::Absent => Color32::from_rgb(52, 52, 58),
        }
    }

    /// What it is called in the legend.
    #[must_use]
    pub const fn label(self) -> &'static str {
        match self {
            Self::Drawn => "drawn",
            Self::Culled => "culled",
            Self::Resident => "resident",
            Self::Loading => "loading",
            Self::Failed => "failed",
            Self::Absent => "absent",
        }
    }

    /// What it means.
    pub(super) const fn hover(self) -> &'static str {
        match self {
            Self::Drawn => "Ground of nodes that the chosen camera draws, in green over its tiles.",
            Self::Culled => {
                "Outlines of nodes that the level of detail would draw, but that neither the camera \
                 nor a light sees."
            }
            Self::Resident => "Tiles that have a page.",
            Self::Loading => "Tiles that were asked for and have no page yet.",
            Self::Failed => "Tiles that are missing or corrupt; rest on one to read why.",
            Self::Absent => {
                "Tiles that are stored and not resident: nobody wants them, or pages are short."
            }
        }
    }
}

const TILE_EDGE: Color32 = Color32::from_rgb(44, 72, 108);
const NODE_EDGE: Color32 = Color32::from_rgb(176, 240, 160);

/// Metres of ground that a tile covers, from its corner on; the part that lies on the terrain.
pub(super) fn tile_square(state: &TerrainState, address: TileAddress) -> [DVec2; 2] {
    let file = &state.manifest().file;
    let end = DVec2::new(
        f64::from(file.size[0].saturating_sub(1)),
        f64::from(file.size[1].saturating_sub(1)),
    );
    let side = f64::from(TILE_SAMPLES) * f64::from(address.level).exp2();
    let low = DVec2::new(address.x.into(), address.z.into()) * side;
    let high = (low + side).min(end);
    [low.min(end) * file.spacing_m, high * file.spacing_m]
}

/// Adds a rectangle, with lines at its upper and left side where it is large enough: those at the other
/// sides are its neighbours'.
fn add_square(mesh: &mut Mesh, rect: Rect, fill: Option<Color32>, edge: Color32) {
    if let Some(fill) = fill {
        mesh.add_colored_rect(rect, fill);
    }
    if rect.width().min(rect.height()) < OUTLINED_PX {
        return;
    }
    let line = |min: [f32; 2], size: [f32; 2]| {
        Rect::from_min_size(pos2(min[0].round(), min[1].round()), Vec2::from(size))
    };
    let top = line([rect.min.x, rect.min.y], [rect.width(), 1.0]);
    let left = line([rect.min.x, rect.min.y], [1.0, rect.height()]);
    mesh.add_colored_rect(top, edge);
    mesh.add_colored_rect(left, edge);
}

/// Which tiles are shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Shown {
    /// The finest that is resident, everywhere.
    #[default]
    Finest,
    /// Those of a level.
    Level(u8),
}

/// What the tiles' mesh was made of.
#[derive(Clone, Copy, PartialEq)]
struct Made {
    instance: u64,
    pages_version: u64,
    shown: Shown,
    view: MapView,
    rect: Rect,
}

/// The tiles' mesh, made anew where something has changed.
#[derive(Default)]
pub(super) struct TileMesh {
    made: Option<Made>,
    mesh: Arc<Mesh>,
}

impl TileMesh {
    pub(super) fn get(
        &mut self,
        state: &TerrainState,
        frame: &MapFrame,
        shown: Shown,
    ) -> Arc<Mesh> {
        let made = Made {
            instance: state.instance(),
            pages_version: state.pages_version(),
            shown,
            view: frame.view,
            rect: frame.rect,
        };
        if self.made != Some(made) {
            self.made = Some(made);
            let mesh = Arc::make_mut(&mut self.mesh);
            clear(mesh);
            let mut painter = TilePainter { state, frame, mesh };
            painter.add(state.root(), shown);
        }
        Arc::clone(&self.mesh)
    }
}

struct TilePainter<'a> {
    state: &'a TerrainState,
    frame: &'a MapFrame,
    mesh: &'a mut Mesh,
}

impl TilePainter<'_> {
    fn rect(&self, address: TileAddress) -> Option<Rect> {
        let [low_m, high_m] = tile_square(self.state, address);
        let rect = self.frame.rect_of(low_m, high_m);
        rect.intersects(self.frame.rect).then_some(rect)
    }

    fn paint(&mut self, rect: Rect, colour: MapColour) {
        // Corners far outside the map would lose their places to rounding.
        let rect = rect.intersect(self.frame.rect.expand(2.0));
        add_square(self.mesh, rect, Some(colour.colour()), TILE_EDGE);
    }

    /// Whether tiles of half the size are large enough to be told apart.
    fn may_split(&self, level: u8) -> bool {
        let samples = f64::from(TILE_SAMPLES) * (f64::from(level) - 1.0).exp2();
        let side_m = samples * self.state.manifest().file.spacing_m;
        side_m * self.frame.view.px_per_m >= f64::from(LEAST_PX)
    }

    fn add(&mut self, address: TileAddress, shown: Shown) {
        let Some(rect) = self.rect(address) else {
            return;
        };
        let pages = self.state.pages();
        if pages.get(address).is_none() {
            // All that lies below is absent too.
            if self.state.ground_range(address).is_some() {
                self.paint(rect, MapColour::Absent);
            }
            return;
        }
        let ends = match shown {
            Shown::Finest => address.level == 0,
            Shown::Level(level) => address.level <= level,
        };
        let children = address
            .children()
            .filter(|_| !ends && self.may_split(address.level));
        let Some(children) = children else {
            self.paint(rect, MapColour::Resident);
            return;
        };
        let there = children.map(|child| pages.holds(child));
        let resident = children.map(|child| pages.get(child).is_some());
        let enters = match shown {
            Shown::Finest => {
                // A parent shows where its children leave it to be seen.
                if there != resident {
                    self.paint(rect, MapColour::Resident);
                }
                resident
            }
            Shown::Level(_) => there,
        };
        for (child, _) in children.into_iter().zip(enters).filter(|(_, it)| *it) {
            self.add(child, shown);
        }
    }
}

/// Loading and failed tiles, on top of all others; in the place of what `mesh` held.
pub(super) fn marks(state: &TerrainState, frame: &MapFrame, shown: Shown, mesh: &mut Mesh) {
    clear(mesh);
    let failed = state.failed().map(|tile| (tile, MapColour::Failed));
    let loading = state.loading().map(|tile| (tile, MapColour::Loading));
    let marked = failed.take(MOST_MARKS).chain(loading.take(MOST_MARKS));
    for (address, colour) in marked {
        if let Shown::Level(level) = shown
            && level != address.level
        {
            continue;
        }
        let [low_m, high_m] = tile_square(state, address);
        let rect = frame.rect_of(low_m, high_m);
        if !rect.intersects(frame.rect) {
            continue;
        }
        let grow = 0.5 * (LEAST_MARK_PX - rect.width().min(rect.height())).max(0.0);
        let rect = rect.expand(grow).intersect(frame.rect.expand(2.0));
        add_square(mesh, rect, Some(colour.colour()), TILE_EDGE);
    }
}

/// What the nodes' mesh was made of, but for the nodes that are drawn.
#[derive(Clone, Copy, PartialEq)]
struct MadeNodes {
    lattice: Lattice,
    lod: ViewLod,
    spacing_m: f64,
    frame: MapFrame,
}

/// The nodes' mesh, made anew where something has changed.
#[derive(Default)]
pub(super) struct NodeMesh {
    made: Option<MadeNodes>,
    drawn: Vec<Node>,
    mesh: Arc<Mesh>,
}

impl NodeMesh {
    pub(super) fn get(
        &mut self,
        view: &TerrainView,
        drawn: &[Node],
        spacing_m: f64,
        frame: &MapFrame,
    ) -> Arc<Mesh> {
        let made = MadeNodes {
            lattice: view.lattice,
            lod: view.lod,
            spacing_m,
            frame: *frame,
        };
        if self.made != Some(made) || self.drawn != drawn {
            self.made = Some(made);
            self.drawn.clear();
            self.drawn.extend_from_slice(drawn);
            // What egui has painted of the frame before lets go of it by now.
            nodes(view, drawn, spacing_m, frame, Arc::make_mut(&mut self.mesh));
        }
        Arc::clone(&self.mesh)
    }
}

/// The nodes that a camera draws, filled, and the outlines of those that nobody sees.
fn nodes(view: &TerrainView, drawn: &[Node], spacing_m: f64, frame: &MapFrame, mesh: &mut Mesh) {
    clear(mesh);
    let lattice = &view.lattice;
    let unit_m = lattice.unit_m(spacing_m);
    let place = |node: &Node| node_rect(node, lattice, unit_m, frame);
    let mut keep = |node: &Node, _: &crate::lattice::NodeBounds| {
        place(node).is_some_and(|rect| {
            rect.intersects(frame.rect) && rect.width().max(rect.height()) >= OUTLINED_PX
        })
    };
    let edge = MapColour::Culled.colour();
    view.lod.select(lattice, &mut keep, &mut |node| {
        if let Some(rect) = place(&node) {
            add_square(mesh, rect.intersect(frame.rect.expand(2.0)), None, edge);
        }
    });
    let fill = MapColour::Drawn.colour();
    for node in drawn {
        let Some(rect) = place(node) else {
            continue;
        };
        if rect.intersects(frame.rect) {
            let rect = rect.intersect(frame.rect.expand(2.0));
            add_square(mesh, rect, Some(fill), NODE_EDGE);
        }
    }
}

fn node_rect(node: &Node, lattice: &Lattice, unit_m: f64, frame: &MapFrame) -> Option<Rect> {
    let bounds = node.bounds(lattice)?;
    let [low_m, high_m] = [bounds.low, bounds.high].map(|point| point.as_dvec2() * unit_m);
    Some(frame.rect_of(low_m, high_m))
}

/// Empties a mesh and keeps its memory.
fn clear(mesh: &mut Mesh) {
    mesh.indices.clear();
    mesh.vertices.clear();
}

/// What is known of a tile, for whoever points at it.
pub(super) fn state_of(state: &TerrainState, address: TileAddress) -> MapColour {
    if state.failure(address).is_some() {
        MapColour::Failed
    } else if state.pages().get(address).is_some() {
        MapColour::Resident
    } else if state.loading().any(|tile| tile == address) {
        MapColour::Loading
    } else {
        MapColour::Absent
    }
}

/// The tile that is shown at a place: of the chosen level, or the finest one that is resident, that
/// loads or has failed.
pub(super) fn tile_at(state: &TerrainState, at_m: DVec2, shown: Shown) -> Option<TileAddress> {
    let file = &state.manifest().file;
    let sample = at_m / file.spacing_m;
    let last = DVec2::new(
        f64::from(file.size[0].saturating_sub(1)),
        f64::from(file.size[1].saturating_sub(1)),
    );
    if !sample.cmpge(DVec2::ZERO).all() || !sample.cmple(last).all() {
        return None;
    }
    let [x, z] = sample.to_array().map(|at| at as u32 / TILE_SAMPLES);
    let at = |level: u8| {
        let tiles = state.pages().tiles(level);
        let [x, z] = [x >> level, z >> level];
        TileAddress::new(level, x.min(tiles[0] - 1), z.min(tiles[1] - 1))
    };
    match shown {
        Shown::Level(level) => Some(at(level.min(state.root().level))),
        Shown::Finest => (0..=state.root().level)
            .map(at)
            .find(|&tile| state_of(state, tile) != MapColour::Absent),
    }
}
