//! The panel: what is at its top, and its tabs.

use super::form::name_widget;
use super::{
    BrushTab, MapTab, SettingsTab, StatisticsTab, TerrainChoice, TerrainDebugTab, ViewsTab,
};
use crate::render::ComparisonCamera;
use crate::terrain::{Terrain, TerrainCamera};
use bevy::ecs::query::QueryFilter;
use bevy::prelude::*;
use bevy_egui::egui;
use egui_dock::{DockArea, DockState, TabViewer};
use std::fmt;

/// The panel's width where nobody has dragged its edge, in points.
const WIDTH: f32 = 400.0;
/// Its least width.
const LEAST_WIDTH: f32 = 240.0;

/// Where the panel is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum PanelPlace {
    /// Along the left edge of the screen.
    Left,
    /// Along the right edge.
    #[default]
    Right,
    /// A window that can be moved.
    Window,
}

/// The panel, a resource; [`TerrainDebugPlugin`](super::TerrainDebugPlugin) adds it where the game
/// hasn't.
///
/// It is drawn in bevy_egui's primary context, and so over the camera that has that. While a tab is
/// shown, or the game's own call of [`ui`](Self::ui) runs within `World::resource_scope`, this
/// resource is not in the world.
#[derive(Resource)]
pub struct TerrainPanel {
    /// Whether it is open. Closed, it costs nothing.
    pub is_open: bool,
    /// What opens and closes it. While something is typed in, only function keys do.
    pub key: Option<KeyCode>,
    /// Where it is.
    pub place: PanelPlace,
    /// Whether the game sees no input that is meant for egui while the panel is open; see the
    /// [module](super#input-under-the-panel).
    pub absorbs_input: bool,
    /// The camera that is shown. Where it is none, or despawned, the panel chooses one and writes it
    /// here, so that the choice stays whatever becomes of the others; while it lacks its
    /// [`TerrainCamera`], another is shown.
    pub camera: Option<Entity>,
    /// The same for the terrain.
    pub terrain: Option<Entity>,
    /// Its tabs. A new one comes last in the first row; one that is removed is shown no more.
    pub tabs: Vec<Box<dyn TerrainDebugTab>>,
    /// Where the tabs lie, by title. Tabs that it lacks are added when it is shown next.
    pub dock: DockState<&'static str>,
    /// The tab that is to be on top when the panel is shown next, by title.
    pub shown_tab: Option<&'static str>,
}

impl Default for TerrainPanel {
    fn default() -> Self {
        Self {
            is_open: false,
            key: Some(KeyCode::F3),
            place: PanelPlace::default(),
            absorbs_input: true,
            camera: None,
            terrain: None,
            tabs: vec![
                Box::new(SettingsTab),
                Box::new(ViewsTab::default()),
                Box::<StatisticsTab>::default(),
                Box::<MapTab>::default(),
                Box::<BrushTab>::default(),
            ],
            dock: DockState::new(Vec::new()),
            shown_tab: None,
        }
    }
}

impl fmt::Debug for TerrainPanel {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let tabs: Vec<_> = self.tabs.iter().map(|tab| tab.title()).collect();
        out.debug_struct("TerrainPanel")
            .field("is_open", &self.is_open)
            .field("key", &self.key)
            .field("place", &self.place)
            .field("absorbs_input", &self.absorbs_input)
            .field("camera", &self.camera)
            .field("terrain", &self.terrain)
            .field("tabs", &tabs)
            .finish_non_exhaustive()
    }
}

impl TerrainPanel {
    /// The camera and the terrain that are shown: those that were chosen while they are alive,
    /// otherwise those that were spawned first, which are chosen from then on.
    #[must_use]
    pub fn choice(&mut self, world: &mut World) -> TerrainChoice {
        offered(world, |world, offered| self.choose(world, offered))
    }

    fn choose(&mut self, world: &World, offered: &Offered) -> TerrainChoice {
        let choose = |chosen: &mut Option<Entity>, offered: &[Entity]| {
            if let Some(chosen) = chosen.filter(|chosen| offered.contains(chosen)) {
                return Some(chosen);
            }
            let first = offered.first().copied();
            if first.is_some() && chosen.is_none_or(|chosen| world.get_entity(chosen).is_err()) {
                *chosen = first;
            }
            first
        };
        TerrainChoice {
            camera: choose(&mut self.camera, &offered.cameras.found),
            terrain: choose(&mut self.terrain, &offered.terrains.found),
        }
    }

    /// Shows the panel at its [`place`](Self::place) on the screen of an egui context.
    pub(super) fn show(&mut self, ctx: &egui::Context, world: &mut World) {
        let screen = ctx.content_rect();
        if screen.width() < 1.0 || screen.height() < 1.0 {
            return;
        }
        // A window and not egui's own side panel: those lie in the layer under everything, where
        // egui doesn't say that it wants the pointer.
        let window = egui::Window::new("Terrain");
        let frame = egui::Frame::side_top_panel(&ctx.global_style());
        let along_edge = |window: egui::Window<'static>, corner| {
            let height = screen.height() - frame.total_margin().sum().y;
            window
                .title_bar(false)
                .frame(frame)
                .anchor(corner, egui::Vec2::ZERO)
                .resizable([true, false])
                .default_width(WIDTH)
                .min_width(LEAST_WIDTH)
                .max_width(0.9 * screen.width())
                .min_height(height)
                .max_height(height)
        };
        let window = match self.place {
            PanelPlace::Left => along_edge(window, egui::Align2::LEFT_TOP),
            PanelPlace::Right => along_edge(window, egui::Align2::RIGHT_TOP),
            PanelPlace::Window => window
                .id(egui::Id::new("terrain panel, floating"))
                .default_pos(screen.min + egui::vec2(40.0, 40.0))
                .default_size([WIDTH, 0.75 * screen.height()])
                .min_width(LEAST_WIDTH)
                .constrain_to(screen),
        };
        window.show(ctx, |ui| self.ui(ui, world));
    }

    /// Shows the panel in a game's own `ui`; take it out of the world before:
    ///
    /// ```
    /// # use bevy::prelude::*;
    /// # use bevy_egui::egui;
    /// # use bevy_tessera::debug::TerrainPanel;
    /// fn my_debug_window(ui: &mut egui::Ui, world: &mut World) {
    ///     world.resource_scope(|world, mut panel: Mut<TerrainPanel>| panel.ui(ui, world));
    /// }
    /// ```
    ///
    /// It takes all the room that there is. Works in every egui context, with a renderer or without.
    pub fn ui(&mut self, ui: &mut egui::Ui, world: &mut World) {
        let chosen = offered(world, |world, offered| self.header(ui, world, offered));
        // A frame may have several passes.
        let frame = ui.ctx().cumulative_frame_nr();
        let memory = egui::Id::new("terrain panel was updated in frame");
        let updated = ui.data_mut(|data| {
            let updated = data.get_temp(memory);
            data.insert_temp(memory, frame);
            updated
        });
        if updated != Some(frame) {
            for tab in &mut self.tabs {
                tab.update(world, chosen);
            }
        }
        self.arrange();
        let mut viewer = Viewer {
            tabs: &mut self.tabs,
            world,
            chosen,
        };
        DockArea::new(&mut self.dock)
            .id(ui.id().with("terrain panel tabs"))
            .show_close_buttons(false)
            .show_leaf_close_all_buttons(false)
            .show_leaf_collapse_buttons(false)
            .show_inside(ui, &mut viewer);
    }

    /// Gives every tab a place, and takes away those of tabs that are gone.
    fn arrange(&mut self) {
        let is_there = |title: &&'static str| self.tabs.iter().any(|tab| tab.title() == *title);
        if !self.dock.iter_all_tabs().all(|(_, title)| is_there(title)) {
            self.dock.retain_tabs(|title| is_there(title));
            for (_, leaf) in self.dock.iter_leaves_mut() {
                leaf.active.0 = leaf.active.0.min(leaf.tabs.len().saturating_sub(1));
            }
        }
        // A tab that is pushed comes on top; the one that was there stays, or the first of all.
        let on_top = match self.dock.iter_leaves().next() {
            Some((_, leaf)) => leaf.tabs.get(leaf.active.0).copied(),
            None => None,
        };
        let on_top = on_top.or_else(|| self.tabs.first().map(|tab| tab.title()));
        for tab in &self.tabs {
            let title = tab.title();
            if self.dock.iter_all_tabs().all(|(_, known)| *known != title) {
                self.dock.push_to_first_leaf(title);
                self.shown_tab = self.shown_tab.or(on_top);
            }
        }
        if let Some(title) = self.shown_tab.take()
            && let Some(path) = self.dock.find_tab(&title)
        {
            // It was found right there.
            let _ = self.dock.set_active_tab(path);
        }
    }

    /// Which camera and which terrain, where the panel is, and what closes it.
    fn header(&mut self, ui: &mut egui::Ui, world: &World, offered: &Offered) -> TerrainChoice {
        let chosen = self.choose(world, offered);
        ui.horizontal(|ui| {
            for (place, text, hover) in [
                (PanelPlace::Left, "⏴", "dock the panel to the left"),
                (PanelPlace::Window, "🗖", "make the panel a window"),
                (PanelPlace::Right, "⏵", "dock the panel to the right"),
            ] {
                let response = ui.selectable_label(self.place == place, text);
                name_widget(&response, "", hover);
                if response.on_hover_text(hover).clicked() {
                    self.place = place;
                }
            }
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
                let key = self.key.map(|key| format!("close the panel ({key:?})"));
                let response = ui.small_button("✖");
                name_widget(&response, "", "close the panel");
                let response = response.on_hover_text(key.as_deref().unwrap_or("close the panel"));
                if response.clicked() {
                    self.is_open = false;
                }
            });
        });
        let camera = pick(ui, world, "camera", chosen.camera, &offered.cameras.found);
        let terrain = pick(
            ui,
            world,
            "terrain",
            chosen.terrain,
            &offered.terrains.found,
        );
        self.camera = camera.or(self.camera);
        self.terrain = terrain.or(self.terrain);
        TerrainChoice {
            camera: camera.or(chosen.camera),
            terrain: terrain.or(chosen.terrain),
        }
    }
}

/// Entities to choose from, in the order in which they were spawned as far as their numbers tell; that
/// of a query changes with their components.
struct Found<F: QueryFilter> {
    query: QueryState<Entity, F>,
    found: Vec<Entity>,
}

impl<F: QueryFilter> Found<F> {
    fn new(world: &mut World) -> Self {
        Self {
            query: world.query_filtered(),
            found: Vec::new(),
        }
    }

    fn find(&mut self, world: &World) {
        self.found.clear();
        self.found.extend(self.query.iter(world));
        // The order of entities themselves is that of bits that mean nothing.
        self.found.sort_unstable_by_key(|entity| entity.index_u32());
    }
}

/// What there is to choose from. The second camera of a comparison is a helper of this crate.
#[derive(Resource)]
struct Offered {
    cameras: Found<(With<TerrainCamera>, Without<ComparisonCamera>)>,
    terrains: Found<With<Terrain>>,
}

impl FromWorld for Offered {
    fn from_world(world: &mut World) -> Self {
        Self {
            cameras: Found::new(world),
            terrains: Found::new(world),
        }
    }
}

/// Looks what there is to choose from.
fn offered<R>(world: &mut World, look: impl FnOnce(&World, &Offered) -> R) -> R {
    world.init_resource::<Offered>();
    world.resource_scope(|world, mut offered: Mut<Offered>| {
        offered.cameras.find(world);
        offered.terrains.find(world);
        look(world, &offered)
    })
}

/// What an entity is called.
fn name(world: &World, entity: Entity) -> String {
    match world.get::<Name>(entity) {
        Some(name) => name.to_string(),
        None => entity.to_string(),
    }
}

/// A row that chooses an entity; returns another one if that was chosen.
fn pick(
    ui: &mut egui::Ui,
    world: &World,
    label: &str,
    chosen: Option<Entity>,
    offered: &[Entity],
) -> Option<Entity> {
    let mut picked = None;
    ui.horizontal(|ui| {
        let cell = super::form::label_cell(ui, label, 54.0, false);
        let text = chosen.map_or_else(|| format!("no {label}"), |entity| name(world, entity));
        let combo = egui::ComboBox::from_id_salt(label)
            .selected_text(text)
            .width((ui.available_width() - 8.0).max(60.0))
            .truncate()
            .show_ui(ui, |ui| {
                for &entity in offered {
                    let text = name(world, entity);
                    if ui.selectable_label(Some(entity) == chosen, text).clicked() {
                        picked = Some(entity);
                    }
                }
            });
        let response = combo.response.labelled_by(cell.id);
        name_widget(&response, "", label);
    });
    picked
}

/// Shows tabs to egui_dock, which knows them by their titles.
struct Viewer<'a> {
    tabs: &'a mut [Box<dyn TerrainDebugTab>],
    world: &'a mut World,
    chosen: TerrainChoice,
}

impl TabViewer for Viewer<'_> {
    type Tab = &'static str;

    fn id(&mut self, title: &mut Self::Tab) -> egui::Id {
        egui::Id::new(("terrain panel tab", *title))
    }

    fn title(&mut self, title: &mut Self::Tab) -> egui::WidgetText {
        (*title).into()
    }

    fn ui(&mut self, ui: &mut egui::Ui, title: &mut Self::Tab) {
        if let Some(tab) = self.tabs.iter_mut().find(|tab| tab.title() == *title) {
            tab.ui(ui, self.world, self.chosen);
        }
    }

    fn on_tab_button(&mut self, title: &mut Self::Tab, response: &egui::Response) {
        response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::Button, true, *title));
    }

    fn is_closeable(&self, _title: &Self::Tab) -> bool {
        false
    }

    fn scroll_bars(&self, _title: &Self::Tab) -> [bool; 2] {
        [false, true]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_panel_is_a_resource_that_any_thread_may_hold() {
        fn check<T: Send + Sync>() {}
        check::<TerrainPanel>();
    }
}
