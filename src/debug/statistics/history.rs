//! Times over the last seconds, read from Bevy's diagnostics.

use crate::render::{TerrainDiagnostics, TerrainPass};
use crate::terrain::TerrainCpuStage;
use bevy::diagnostic::{DiagnosticPath, DiagnosticsStore};
use bevy_egui::egui::Color32;
use std::collections::VecDeque;
use std::time::Instant;

/// Points of a plotted line: as many as can be told apart, so that a plot costs the same whatever it
/// spans.
const POINTS: usize = 120;
/// A time that has had no new measurement for so long is over.
const STALE_S: f64 = 0.5;

/// Which clock a series is of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Clock {
    #[default]
    Gpu,
    Cpu,
}

/// A time that is followed.
pub(super) struct Series {
    pub(super) name: &'static str,
    pub(super) hover: &'static str,
    pub(super) clock: Clock,
    pub(super) colour: Color32,
    path: DiagnosticPath,
    /// When its newest measurement was made.
    newest: Option<Instant>,
    /// The newest measurement, ms; `None` where there is none, or none any more.
    pub(super) latest_ms: Option<f64>,
    /// Sum and number of the measurements since the last point.
    pending: (f64, u32),
    /// Means of the measurements between points, ms, the newest last; NaN where there was none.
    points: VecDeque<f32>,
}

impl Series {
    fn new(
        clock: Clock,
        name: &'static str,
        hover: &'static str,
        colour: Color32,
        path: DiagnosticPath,
    ) -> Self {
        Self {
            name,
            hover,
            clock,
            colour,
            path,
            newest: None,
            latest_ms: None,
            pending: (0.0, 0),
            points: VecDeque::with_capacity(POINTS + 1),
        }
    }

    fn read(&mut self, store: &DiagnosticsStore, now: Instant) {
        let Some(measurement) = store.get_measurement(&self.path) else {
            self.latest_ms = None;
            return;
        };
        if self.newest != Some(measurement.time) {
            self.newest = Some(measurement.time);
            if measurement.value.is_finite() {
                self.latest_ms = Some(measurement.value);
                self.pending.0 += measurement.value;
                self.pending.1 += 1;
            }
        } else if now.duration_since(measurement.time).as_secs_f64() > STALE_S {
            self.latest_ms = None;
        }
    }

    fn close_point(&mut self) {
        let (sum, count) = std::mem::take(&mut self.pending);
        let mean = if count == 0 {
            f32::NAN
        } else {
            (sum / f64::from(count)) as f32
        };
        self.points.push_back(mean);
        while self.points.len() > POINTS {
            self.points.pop_front();
        }
    }

    /// Mean and greatest of the points that are plotted, ms.
    pub(super) fn mean_and_most(&self) -> Option<[f32; 2]> {
        let known = self.points.iter().filter(|point| !point.is_nan());
        let (sum, most, count) = known.fold((0.0, 0.0_f32, 0_u16), |(sum, most, count), point| {
            (sum + point, most.max(*point), count + 1)
        });
        (count > 0).then(|| [sum / f32::from(count), most])
    }

    /// Points for a plot whose right end is now and which spans `window_s`: seconds (negative) and ms.
    pub(super) fn line(&self, window_s: f64) -> impl Iterator<Item = [f64; 2]> {
        let step_s = window_s / POINTS as f64;
        let points = self.points.iter().rev().zip(0_u32..);
        points
            .filter(|(point, _)| !point.is_nan())
            .map(move |(point, age)| [-f64::from(age) * step_s, f64::from(*point)])
    }
}

/// All times that are followed.
pub(super) struct History {
    pub(super) series: Vec<Series>,
    pub(super) window_s: f64,
    point_began: Option<Instant>,
}

impl Default for History {
    fn default() -> Self {
        Self {
            series: all_series(),
            window_s: 10.0,
            point_began: None,
        }
    }
}

impl History {
    /// Takes what has been measured since the frame before.
    pub(super) fn update(&mut self, store: &DiagnosticsStore) {
        let now = Instant::now();
        for series in &mut self.series {
            series.read(store, now);
        }
        let began = *self.point_began.get_or_insert(now);
        let step_s = self.window_s / POINTS as f64;
        let passed_s = now.duration_since(began).as_secs_f64();
        if passed_s < step_s {
            return;
        }
        // A frame may take as long as several points.
        let closed = ((passed_s / step_s) as usize).min(POINTS);
        for series in &mut self.series {
            for _ in 0..closed {
                series.close_point();
            }
        }
        self.point_began = Some(now);
    }

    /// Spans another time; what was plotted is forgotten.
    pub(super) fn set_window(&mut self, window_s: f64) {
        self.window_s = window_s;
        for series in &mut self.series {
            series.points.clear();
        }
    }

    /// The times of a clock.
    pub(super) fn of(&self, clock: Clock) -> impl Iterator<Item = &Series> {
        self.series
            .iter()
            .filter(move |series| series.clock == clock)
    }
}

/// What the pass of a comparison is recorded as.
const COMPARISON: &str = "terrain_comparison";

/// Colours that are told apart on light and dark ground; as many as the CPU's clock has series.
const COLOURS: [Color32; 15] = [
    Color32::from_rgb(78, 154, 241),
    Color32::from_rgb(242, 142, 43),
    Color32::from_rgb(89, 180, 84),
    Color32::from_rgb(225, 87, 89),
    Color32::from_rgb(176, 122, 200),
    Color32::from_rgb(156, 117, 95),
    Color32::from_rgb(237, 201, 72),
    Color32::from_rgb(118, 183, 178),
    Color32::from_rgb(255, 157, 167),
    Color32::from_rgb(150, 150, 150),
    Color32::from_rgb(44, 123, 74),
    Color32::from_rgb(196, 78, 158),
    Color32::from_rgb(160, 160, 40),
    Color32::from_rgb(60, 90, 190),
    Color32::from_rgb(150, 45, 50),
];

fn all_series() -> Vec<Series> {
    let passes = TerrainPass::ALL.map(|pass| {
        let (name, hover) = match pass {
            TerrainPass::Classify => (
                "classify",
                "Faces get their edge factors; grows with the faces that are seen.",
            ),
            TerrainPass::Setup => (
                "setup",
                "Nodes get their places in the buffers; grows with the nodes.",
            ),
            TerrainPass::Faces => (
                "faces",
                "Triangles are told their faces for overlays, only while some are on.",
            ),
            TerrainPass::Vertices => (
                "vertices",
                "Vertices are evaluated; grows with their number.",
            ),
            TerrainPass::Indices => ("indices", "Triangles are listed; grows with their number."),
            TerrainPass::Measure => (
                "measure",
                "Triangles are measured for the histogram below, only while it is shown.",
            ),
            TerrainPass::Density => (
                "density",
                "Densities are made for a preview, only after its settings or tiles changed.",
            ),
        };
        (pass.label(), name, hover)
    });
    let draws = [
        (
            COMPARISON,
            "comparison",
            "Two pictures are put into one, only where a camera is compared.",
        ),
        (
            "main_opaque_pass_3d",
            "opaque pass",
            "Bevy's pass that shades opaque things: the terrain and everything else that is opaque, \
             of all cameras.",
        ),
        (
            "early prepass",
            "prepass",
            "Bevy's depth, normal and motion prepass: the terrain and everything else in it.",
        ),
        (
            "early deferred prepass",
            "deferred",
            "Bevy's deferred prepass: the terrain and everything else that is shaded later.",
        ),
    ];
    let mut series = Vec::new();
    for (clock, field) in [(Clock::Gpu, "elapsed_gpu"), (Clock::Cpu, "elapsed_cpu")] {
        let first = if clock == Clock::Gpu { 0 } else { 4 };
        if clock == Clock::Cpu {
            for (stage, colour) in TerrainCpuStage::ALL.into_iter().zip(COLOURS) {
                let hover = match stage {
                    TerrainCpuStage::View => "Main world: every camera's view of every terrain.",
                    TerrainCpuStage::Stream => {
                        "Main world: planning, activating and evicting tiles, without what reading \
                         takes in the background."
                    }
                    TerrainCpuStage::Cull => "Main world: nodes are selected and culled.",
                    TerrainCpuStage::Extract => {
                        "What changed is told to the render world; the main world waits for it."
                    }
                };
                let path = TerrainDiagnostics::of_stage(stage);
                series.push(Series::new(clock, stage.label(), hover, colour, path));
            }
        }
        let labels = passes.into_iter().chain(draws);
        for (at, (label, name, hover)) in labels.enumerate() {
            let path = DiagnosticPath::from_components(["render", label, field]);
            let colour = COLOURS[(first + at) % COLOURS.len()];
            series.push(Series::new(clock, name, hover, colour, path));
        }
    }
    series
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::diagnostic::{Diagnostic, DiagnosticMeasurement};

    #[test]
    fn every_pass_that_is_recorded_has_a_line_of_its_own_on_either_clock() {
        let series = all_series();
        let labels = TerrainPass::ALL.map(TerrainPass::label);
        for (clock, field) in [(Clock::Gpu, "elapsed_gpu"), (Clock::Cpu, "elapsed_cpu")] {
            for label in labels.into_iter().chain([COMPARISON]) {
                let path = DiagnosticPath::from_components(["render", label, field]);
                let of = series
                    .iter()
                    .filter(|it| it.path == path && it.clock == clock);
                assert_eq!(of.count(), 1, "{path}");
            }
            let of_clock = || series.iter().filter(move |it| it.clock == clock);
            for one in of_clock() {
                let alike = of_clock().filter(|it| it.colour == one.colour || it.name == one.name);
                assert_eq!(alike.count(), 1, "{}", one.name);
            }
        }
        // And the passes say so themselves.
        let mut sources = String::new();
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("src/render");
        for name in ["passes.rs", "comparison/pass.rs"] {
            sources += &std::fs::read_to_string(folder.join(name)).unwrap();
        }
        assert!(sources.contains(&format!("const LABEL: &str = \"{COMPARISON}\"")));
        for pass in TerrainPass::ALL {
            assert!(sources.contains(&format!("{pass:?}")), "{pass:?}");
        }
    }

    #[test]
    fn a_measurement_counts_once_and_is_forgotten_when_no_new_one_comes() {
        let mut history = History::default();
        let mut store = DiagnosticsStore::default();
        let path = history.series[0].path.clone();
        let mut diagnostic = Diagnostic::new(path);
        let now = Instant::now();
        diagnostic.add_measurement(DiagnosticMeasurement {
            time: now,
            value: 2.0,
        });
        store.add(diagnostic);
        let series = &mut history.series[0];
        series.read(&store, now);
        series.read(&store, now);
        assert_eq!(series.pending, (2.0, 1));
        assert_eq!(series.latest_ms, Some(2.0));
        series.read(&store, now + std::time::Duration::from_secs(1));
        assert_eq!(series.latest_ms, None);
        for _ in 0..2 * POINTS {
            series.close_point();
        }
        series.pending = (6.0, 2);
        series.close_point();
        assert_eq!(series.points.len(), POINTS);
        assert_eq!(series.line(10.0).collect::<Vec<_>>(), [[0.0, 3.0]]);
        assert_eq!(series.mean_and_most(), Some([3.0, 3.0]));
    }
}
