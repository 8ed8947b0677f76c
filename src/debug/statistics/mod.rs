//! Live figures, plots, and the histogram of triangle sizes.

mod figures;
mod histogram;
mod history;
mod measuring;

pub use measuring::StatisticsTabPlugin;

use super::{TerrainChoice, TerrainDebugTab};
use crate::edit::TerrainEdits;
use crate::edit::mask::TerrainMask;
use crate::render::{ComparisonCamera, TerrainGpuMemory, TerrainStatistics};
use crate::stream::{TerrainPin, TerrainPinProgress, TerrainState, TerrainStreamer};
use crate::terrain::{TerrainCamera, TessellationPolicy};
use bevy::diagnostic::DiagnosticsStore;
use bevy::prelude::*;
use bevy::render::renderer::RenderDevice;
use bevy::render::settings::WgpuFeatures;
use bevy_egui::egui::{CollapsingHeader, Grid, Ui};
use egui_plot::{Legend, Line, Plot, PlotBounds, PlotPoints};
use figures::{LevelsCounted, LoadRate, Row};
use histogram::Target;
use history::{Clock, History};
use measuring::Measuring;

/// What GPU times need.
const TIMESTAMPS: WgpuFeatures = WgpuFeatures::TIMESTAMP_QUERY
    .union(WgpuFeatures::TIMESTAMP_QUERY_INSIDE_ENCODERS)
    .union(WgpuFeatures::TIMESTAMP_QUERY_INSIDE_PASSES);

/// How long the plot of times may be, seconds.
const WINDOWS_S: [f64; 3] = [10.0, 30.0, 120.0];

type Cameras = QueryState<(Entity, &'static TerrainStatistics), Without<ComparisonCamera>>;
type Terrains = QueryState<(
    Entity,
    &'static TerrainState,
    Option<&'static TerrainEdits>,
    Option<&'static TerrainMask>,
)>;
type Pins = QueryState<(&'static TerrainPin, &'static TerrainPinProgress)>;

/// The tab: what the chosen camera draws of the chosen terrain, what streaming holds, what passes and
/// systems take, and how large triangles are on the screen.
///
/// While it is seen, the chosen camera's savings are counted, its triangles are measured where their
/// histogram is unfolded, and the CPU times of the terrains' systems are taken while the panel is open.
/// [`StatisticsTabPlugin`] ends that.
#[derive(Default)]
pub struct StatisticsTab {
    cameras: Option<Cameras>,
    terrains: Option<Terrains>,
    pins: Option<Pins>,
    levels: LevelsCounted,
    rate: LoadRate,
    history: History,
    /// The GPU's at first, where it has one.
    clock: Option<Clock>,
}

impl TerrainDebugTab for StatisticsTab {
    fn title(&self) -> &'static str {
        "Statistics"
    }

    fn ui(&mut self, ui: &mut Ui, world: &mut World, chosen: TerrainChoice) {
        CollapsingHeader::new("Mesh")
            .default_open(true)
            .show(ui, |ui| {
                ui.spacing_mut().item_spacing.y = 2.0;
                let cameras = self.cameras.get_or_insert_with(|| QueryState::new(world));
                let rows = figures::views(chosen, cameras.iter(world));
                table(
                    ui,
                    "terrain_mesh_figures",
                    ["this view", "all views"],
                    &rows,
                );
            });
        let terrains = self.terrains.get_or_insert_with(|| world.query());
        let pins = self.pins.get_or_insert_with(|| world.query());
        let figures = figures::terrains(
            chosen.terrain,
            terrains.iter(world),
            pins.iter(world),
            &mut self.levels,
        );
        CollapsingHeader::new("Streaming and memory")
            .default_open(true)
            .show(ui, |ui| {
                ui.spacing_mut().item_spacing.y = 2.0;
                let heads = ["this terrain", "all"];
                table(ui, "terrain_streaming_figures", heads, &figures.streaming());
                if !figures.by_level.is_empty() {
                    ui.label(&figures.by_level).on_hover_text(
                        "Resident tiles of each level of the chosen terrain; L0 is the finest.",
                    );
                }
                let rows = figures::memory(
                    world.get_resource::<TerrainStreamer>(),
                    world.get_resource::<TerrainGpuMemory>(),
                    self.rate,
                );
                table(ui, "terrain_memory_figures", ["", "all"], &rows);
            });
        CollapsingHeader::new("Edits")
            .default_open(false)
            .show(ui, |ui| {
                table(
                    ui,
                    "terrain_edit_figures",
                    ["this terrain", "all"],
                    &figures.edits(),
                );
            });
        CollapsingHeader::new("Times")
            .default_open(true)
            .show(ui, |ui| self.show_times(ui, world));
        let sizes = CollapsingHeader::new("Triangle sizes")
            .default_open(true)
            .show(ui, |ui| show_sizes(ui, world, chosen));
        CollapsingHeader::new("Edge factors")
            .default_open(false)
            .show(ui, |ui| show_factors(ui, world, chosen));
        if let Some(camera) = chosen.camera {
            Measuring::ask(world, camera, sizes.body_response.is_some());
        }
    }

    fn update(&mut self, world: &mut World, _chosen: TerrainChoice) {
        Measuring::ask_times(world);
        if let Some(store) = world.get_resource::<DiagnosticsStore>() {
            self.history.update(store);
        }
        if let Some(streamer) = world.get_resource::<TerrainStreamer>() {
            self.rate.update(streamer.tiles_activated());
        }
    }
}

/// A table of figures, each with what it means where the pointer rests.
fn table(ui: &mut Ui, id: &str, heads: [&str; 2], rows: &[Row]) {
    Grid::new(id).num_columns(3).striped(true).show(ui, |ui| {
        ui.label("");
        for head in heads {
            ui.weak(head);
        }
        ui.end_row();
        for row in rows {
            ui.label(row.name).on_hover_text(row.hover);
            ui.monospace(&row.chosen).on_hover_text(row.hover);
            ui.monospace(&row.all).on_hover_text(row.hover);
            ui.end_row();
        }
    });
}

impl StatisticsTab {
    fn show_times(&mut self, ui: &mut Ui, world: &World) {
        let device = world.get_resource::<RenderDevice>();
        let has_stamps = device.is_none_or(|device| device.features().contains(TIMESTAMPS));
        let clock = self
            .clock
            .get_or_insert(if has_stamps { Clock::Gpu } else { Clock::Cpu });
        ui.horizontal(|ui| {
            ui.selectable_value(clock, Clock::Gpu, "GPU")
                .on_hover_text("What the passes take on the GPU, by its own clock.");
            ui.selectable_value(clock, Clock::Cpu, "CPU").on_hover_text(
                "What the terrains' systems take in the main world, and what it takes to record each \
                 pass.",
            );
            ui.separator();
            for window_s in WINDOWS_S {
                let is_chosen = self.history.window_s == window_s;
                let name = format!("{window_s:.0} s");
                if ui.selectable_label(is_chosen, name).clicked() && !is_chosen {
                    self.history.set_window(window_s);
                }
            }
        });
        let clock = *clock;
        let has_passes = self
            .history
            .of(Clock::Cpu)
            .any(|series| series.name == "classify" && series.latest_ms.is_some());
        if clock == Clock::Gpu {
            if !has_stamps {
                ui.label("no GPU timestamps on this device");
                return;
            }
            if !has_passes {
                ui.label(
                    "no pass is timed: nothing is drawn, or RenderDiagnosticsPlugin is missing",
                );
                return;
            }
        }
        self.plot_times(ui, clock);
        Grid::new("terrain_times")
            .num_columns(4)
            .striped(true)
            .show(ui, |ui| {
                for head in ["", "now", "mean", "most"] {
                    ui.weak(head);
                }
                ui.end_row();
                for series in self.history.of(clock) {
                    let latest = series.latest_ms;
                    let plotted = series.mean_and_most();
                    if latest.is_none() && plotted.is_none() {
                        continue;
                    }
                    let ms = |ms: Option<f64>| {
                        ms.map_or_else(|| "–".to_owned(), |ms| format!("{ms:.3} ms"))
                    };
                    ui.colored_label(series.colour, series.name)
                        .on_hover_text(series.hover);
                    ui.monospace(ms(latest));
                    ui.monospace(ms(plotted.map(|[mean, _]| mean.into())));
                    ui.monospace(ms(plotted.map(|[_, most]| most.into())))
                        .on_hover_text("The greatest mean of a point of the plot.");
                    ui.end_row();
                }
            });
    }

    fn plot_times(&self, ui: &mut Ui, clock: Clock) {
        let window_s = self.history.window_s;
        let shown = || {
            let series = self.history.of(clock);
            series.filter_map(|series| Some((series, series.mean_and_most()?)))
        };
        let most = shown().fold(0.1_f32, |most, (_, [_, own])| most.max(own));
        Plot::new("terrain_times_plot")
            .height(150.0)
            .legend(Legend::default())
            .allow_drag(false)
            .allow_zoom(false)
            .allow_scroll(false)
            .allow_boxed_zoom(false)
            .y_axis_min_width(36.0)
            .y_axis_formatter(|mark, _| format!("{} ms", mark.value))
            .x_axis_formatter(|mark, _| format!("{} s", mark.value))
            .show(ui, |plot| {
                plot.set_plot_bounds(PlotBounds::from_min_max(
                    [-window_s, 0.0],
                    [0.0, 1.1 * f64::from(most)],
                ));
                for (series, _) in shown() {
                    let points: PlotPoints = series.line(window_s).collect();
                    plot.line(Line::new(series.name, points).color(series.colour));
                }
            });
    }
}

/// The chosen camera's figures of the chosen terrain, or a line that says why there are none.
fn chosen_view<'a>(
    ui: &mut Ui,
    world: &'a World,
    chosen: TerrainChoice,
) -> Option<(&'a crate::render::TerrainViewStatistics, &'a TerrainCamera)> {
    let camera = chosen.camera?;
    let view = world
        .get::<TerrainStatistics>(camera)
        .and_then(|statistics| statistics.terrains.get(&chosen.terrain?));
    let Some(view) = view else {
        ui.label("the chosen camera draws nothing of the chosen terrain");
        return None;
    };
    Some((view, world.get::<TerrainCamera>(camera)?))
}

fn show_sizes(ui: &mut Ui, world: &World, chosen: TerrainChoice) {
    let Some((view, settings)) = chosen_view(ui, world, chosen) else {
        return;
    };
    if !view.has_triangle_sizes {
        let why = if world.contains_resource::<Measuring>() {
            "triangles are measured from the next frames on"
        } else {
            "triangles aren't measured: add StatisticsTabPlugin"
        };
        ui.label(why);
        return;
    }
    let settings = settings.checked(|_| ());
    let width_px = match settings.policy {
        TessellationPolicy::TriangleWidth => Some(settings.triangle_width_px),
        _ => None,
    };
    let target = Target {
        width_px,
        width_scale: view.width_scale,
    };
    histogram::show_sizes(ui, &view.counters.triangle_sizes, target);
}

fn show_factors(ui: &mut Ui, world: &World, chosen: TerrainChoice) {
    let Some((view, settings)) = chosen_view(ui, world, chosen) else {
        return;
    };
    let max_factor = settings.checked(|_| ()).max_factor;
    let counters = &view.counters;
    histogram::show_factors(ui, &counters.factors, max_factor, counters.clamped_edges);
}
