//! The tab of figures.

use super::{Tab, row, shapes, show, text_with, texts};
use crate::common::app;
use crate::common::gpu::{Kernels, ReadBack, bundled};
use bevy::diagnostic::{DiagnosticPath, DiagnosticsStore};
use bevy::prelude::*;
use bevy::render::diagnostic::RenderDiagnosticsPlugin;
use bevy::render::renderer::RenderDevice;
use bevy::render::settings::{WgpuFeatures, WgpuSettings};
use bevy_egui::egui::epaint::ColorMode;
use bevy_egui::egui::{Color32, Rect, Shape};
use bevy_tessera::debug::{StatisticsTab, StatisticsTabPlugin, TerrainChoice, TerrainDebugTab};
use bevy_tessera::render::{
    ComparisonCamera, SavedByDensity, TerrainComparison, TerrainDiagnostics, TerrainGpuMemory,
    TerrainStatistics, TerrainViewStatistics,
};
use bevy_tessera::stream::{TerrainState, TerrainStreamer};
use bevy_tessera::terrain::{
    TerrainCamera, TerrainCpuStage, TerrainCpuTimes, TerrainSettings, TessellationPolicy,
};
use bevy_tessera::tessellate::FaceFactors;
use egui_kittest::kittest::Queryable as _;

/// Colours of bars below, around and above the target, and of the target's line.
const BARS: [Color32; 3] = [
    Color32::from_rgb(78, 154, 241),
    Color32::from_rgb(89, 180, 84),
    Color32::from_rgb(242, 142, 43),
];
const TARGET: Color32 = Color32::from_rgb(255, 66, 66);

fn kernels_in(mut app: App) -> Kernels {
    app.add_plugins((RenderDiagnosticsPlugin, StatisticsTabPlugin));
    let settings = TerrainSettings::default();
    let size = UVec2::new(640, 400);
    let mut kernels = Kernels::start_in(app, "jacksboro/terrain.ron", settings, size);
    kernels.set_camera(eye(), TerrainCamera::default());
    app::settle(&mut kernels.app, 400);
    kernels
}

fn kernels() -> Kernels {
    kernels_in(app::app(bundled(), false))
}

fn eye() -> Transform {
    Transform::from_xyz(15e3, 900.0, 15e3).looking_to(Vec3::new(1.0, -0.3, 0.0), Vec3::Y)
}

fn told(world: &World, camera: Entity, terrain: Entity) -> TerrainViewStatistics {
    world.get::<TerrainStatistics>(camera).unwrap().terrains[&terrain]
}

/// The tab over what the kernels draw, with everything that it asks for measured.
fn tab(kernels: Kernels) -> (Tab<StatisticsTab>, Entity, Entity) {
    let Kernels {
        app,
        terrain,
        camera,
    } = kernels;
    let chosen = TerrainChoice {
        camera: Some(camera),
        terrain: Some(terrain),
    };
    let mut tab = show(app, StatisticsTab::default(), chosen, None);
    frames(&mut tab, 8);
    (tab, camera, terrain)
}

fn frames(tab: &mut Tab<StatisticsTab>, count: u32) {
    for _ in 0..count {
        tab.state_mut().app.update();
        tab.step();
    }
}

fn grouped(number: impl Into<u64>) -> String {
    let digits = number.into().to_string();
    let mut text = String::new();
    for (at, digit) in digits.chars().enumerate() {
        if at > 0 && (digits.len() - at) % 3 == 0 {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[test]
fn figures_are_those_of_the_components() {
    let (tab, camera, terrain) = tab(kernels());
    let world = tab.state().app.world();
    let view = told(world, camera, terrain);
    assert!(view.triangles > 10_000);
    let saved = view.saved().unwrap();
    let starts = |name: &str, number: u64| {
        for column in row(&tab, name) {
            let digits = column.split(" (").next().unwrap();
            assert_eq!(digits, grouped(number), "{name}");
        }
        assert_eq!(row(&tab, name).len(), 2, "{name}");
    };
    starts("Faces drawn", view.counters.faces.into());
    starts("Faces culled", view.counters.culled_faces.into());
    starts("Vertices", view.vertices.into());
    starts("Triangles", view.triangles.into());
    starts("Saved vertices", saved.vertices.into());
    starts("Saved triangles", saved.triangles.into());
    starts("Wanted vertices", view.wanted_vertices.into());
    starts("Wanted triangles", view.wanted_triangles.into());
    starts("Room", view.room_vertices.into());
    assert_eq!(row(&tab, "Overflow"), ["÷ 1", "÷ 1"]);
    assert_eq!(row(&tab, "Width scale"), ["× 1.00", "× 1.00"]);
    let state = world.get::<TerrainState>(terrain).unwrap();
    starts("Tiles resident", state.resident_count() as u64);
    starts("Tiles wanted", state.wanted_count() as u64);
    starts("Tiles loading", 0);
    starts("Tiles failed", 0);
    let by_level = text_with(&tab, "L0: ");
    let counted: usize = by_level
        .split("L")
        .filter_map(|part| part.split_once(": "))
        .map(|(_, count)| count.trim().parse::<usize>().unwrap())
        .sum();
    assert_eq!(counted, state.resident_count());
    let streamer = world.resource::<TerrainStreamer>();
    let pages = text_with(&tab, &format!(" of {}", grouped(streamer.pages())));
    assert!(
        pages.starts_with(&grouped(streamer.pages_used())),
        "{pages}"
    );
    let mib = |bytes: u64| format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20));
    let memory = world.resource::<TerrainGpuMemory>();
    assert!(view.gpu_bytes > 16 * u64::from(view.room_vertices));
    assert_eq!(
        row(&tab, "Mesh memory"),
        [mib(view.gpu_bytes), mib(view.gpu_bytes)]
    );
    assert_eq!(memory.meshes_bytes, view.gpu_bytes);
    assert_eq!(row(&tab, "Page memory"), [mib(memory.pages_bytes)]);
    assert_eq!(row(&tab, "GPU memory"), [mib(memory.total_bytes())]);

    // And Bevy's diagnostics say the same.
    let store = world.resource::<DiagnosticsStore>();
    let value = |path: &DiagnosticPath| store.get(path).unwrap().value().unwrap();
    let entries = [
        (TerrainDiagnostics::SAVED_TRIANGLES, saved.triangles.into()),
        (TerrainDiagnostics::SAVED_VERTICES, saved.vertices.into()),
        (
            TerrainDiagnostics::CULLED_FACES,
            view.counters.culled_faces.into(),
        ),
        (TerrainDiagnostics::TILES_FAILED, 0.0),
        (TerrainDiagnostics::EDITS, 0.0),
        (
            TerrainDiagnostics::PAGE_MEMORY,
            memory.pages_bytes as f64 / f64::from(1 << 20),
        ),
    ];
    for (path, wanted) in entries {
        assert_eq!(value(&path), wanted, "{path}");
    }
}

/// The statistics that arrive within a few frames after this one.
fn counted(kernels: &mut Kernels) -> TerrainViewStatistics {
    for _ in 0..6 {
        kernels.app.update();
    }
    told(kernels.app.world(), kernels.camera, kernels.terrain)
}

fn count_savings(kernels: &mut Kernels) {
    let world = kernels.app.world_mut();
    let mut statistics = world.get_mut::<TerrainStatistics>(kernels.camera).unwrap();
    statistics.measure_savings = true;
}

/// The twin's factors at a density strength of 0, all faces.
fn plain(frame: &ReadBack) -> Vec<FaceFactors> {
    let twin = frame.twin();
    let faces = 1 << (2 * frame.lattice.faces_log2);
    let nodes = frame.nodes.iter();
    nodes
        .flat_map(|node| (0..faces).map(|face| twin.classify_plain(node, face)))
        .collect()
}

#[test]
fn what_density_saves_is_the_difference_of_two_renders() {
    let mut kernels = kernels();
    let with = |density| TerrainCamera {
        density,
        triangle_width_px: 4.0,
        ..default()
    };
    kernels.set_camera(eye(), with(1.0));
    assert_eq!(counted(&mut kernels).saved(), None, "nobody has asked");
    count_savings(&mut kernels);
    let told = counted(&mut kernels);
    let dense = kernels.frame();
    let strength = counted(&mut kernels).saved().unwrap();
    kernels.set_camera(eye(), with(0.0));
    let nothing = counted(&mut kernels);
    let full = kernels.frame();
    assert_eq!((dense.args.scale, full.args.scale), (0, 0));
    let saved = SavedByDensity {
        vertices: (full.vertices.len() - dense.vertices.len()) as u32,
        triangles: (full.triangles.len() - dense.triangles.len()) as u32,
    };
    assert_eq!(told.saved(), Some(saved));
    assert_eq!(strength, saved);
    assert!(saved.triangles > told.triangles / 10, "{saved:?}");
    // Without density there is nothing to be saved.
    assert_eq!(nothing.saved(), Some(SavedByDensity::default()));

    // And the twin counts the same: of the same factors exactly, which differ by a unit at most.
    let counters = told.counters;
    assert_eq!(
        dense.twin().totals(&full.factors),
        [
            u64::from(counters.plain_vertices),
            counters.plain_triangles.into()
        ]
    );
    for (twin, gpu) in plain(&dense).iter().zip(&full.factors) {
        for (twin, gpu) in twin.edges.iter().zip(gpu.edges) {
            assert!(twin.abs_diff(gpu) <= 1, "{twin} and {gpu}");
        }
    }
}

#[test]
fn where_no_density_is_asked_none_saves_anything() {
    let mut kernels = kernels();
    let by_error = TerrainCamera {
        policy: TessellationPolicy::ScreenError { max_px: 1.0 },
        ..default()
    };
    kernels.set_camera(eye(), by_error);
    count_savings(&mut kernels);
    let told = counted(&mut kernels);
    assert!(told.triangles > 1000);
    assert_eq!(told.saved(), Some(SavedByDensity::default()));
    let plain = [told.counters.plain_vertices, told.counters.plain_triangles];
    assert_eq!(plain, [told.wanted_vertices, told.wanted_triangles]);
    let frame = kernels.frame();
    for ((node, face), gpu) in frame
        .nodes
        .iter()
        .flat_map(|node| (0..16).map(move |face| (node, face)))
        .zip(&frame.factors)
        .take(64)
    {
        let plain = frame.twin().classify_plain(node, face);
        for (twin, gpu) in plain.edges.iter().zip(gpu.edges) {
            assert!(twin.abs_diff(gpu) <= 1);
        }
    }
}

/// The bars of the histogram of sizes, from left to right, and where its target's lines stand.
fn histogram(tab: &Tab<StatisticsTab>) -> (Vec<Rect>, Vec<f32>) {
    let (mut bars, mut lines) = (Vec::new(), Vec::new());
    for shape in shapes(tab) {
        match shape {
            Shape::Rect(rect) if BARS.contains(&rect.fill) => bars.push(rect.rect),
            Shape::LineSegment { points, stroke } if stroke.color == TARGET => {
                lines.push(points[0].x);
            }
            Shape::Path(path) if path.stroke.color == ColorMode::Solid(TARGET) => {
                lines.push(path.points[0].x);
            }
            _ => {}
        }
    }
    bars.sort_by(|a, b| a.min.x.total_cmp(&b.min.x));
    (bars, lines)
}

#[test]
fn the_histogram_holds_all_triangles_and_its_line_stands_at_the_target() {
    let (mut tab, camera, terrain) = tab(kernels());
    for width_px in [6.0_f32, 11.3] {
        let world = tab.state_mut().app.world_mut();
        let mut settings = world.get_mut::<TerrainCamera>(camera).unwrap();
        settings.triangle_width_px = width_px;
        frames(&mut tab, 8);
        let view = told(tab.state().app.world(), camera, terrain);
        let sizes = view.counters.triangle_sizes;
        let total: u32 = sizes.iter().sum();
        // Triangles without area are drawn by nobody.
        assert!(total <= view.triangles && total > view.triangles / 10 * 9);
        text_with(&tab, &format!("{} triangles measured", grouped(total)));
        text_with(&tab, &format!("target {width_px:.1} px"));

        let (bars, lines) = histogram(&tab);
        let filled: Vec<usize> = (0..32).filter(|&bin| sizes[bin] > 0).collect();
        assert_eq!(bars.len(), filled.len());
        assert!(filled.len() > 8);
        // Heights are in the bins' proportion.
        let highest = bars.iter().map(Rect::height).fold(0.0, f32::max);
        let most = sizes.iter().copied().max().unwrap();
        for (bar, &bin) in bars.iter().zip(&filled) {
            let wanted = highest * sizes[bin] as f32 / most as f32;
            assert!((bar.height() - wanted).abs() < 1.0, "bin {bin}");
        }
        // Of two bars' middles follows where the line's size is.
        let (first, last) = (bars.first().unwrap(), bars.last().unwrap());
        let bins = [filled[0], *filled.last().unwrap()].map(|bin| bin as f32 + 0.5);
        let a_bin = (last.center().x - first.center().x) / (bins[1] - bins[0]);
        let place = bins[0] + (lines[0] - first.center().x) / a_bin;
        let line_px = ((place - 9.0) / 4.0).exp2();
        assert_eq!(lines.len(), 1);
        assert!(
            (line_px / width_px - 1.0).abs() < 0.02,
            "{line_px} for {width_px}"
        );

        // What is said of the shares is what the bins say.
        let said = text_with(&tab, "within ¼ octave");
        let percents: Vec<u32> = said
            .split(" %")
            .filter_map(|part| part.rsplit(' ').next()?.parse().ok())
            .collect();
        assert!((99..=101).contains(&percents.iter().sum::<u32>()), "{said}");
        let surely_within: u32 = sizes
            .iter()
            .zip(0_u32..)
            .filter(|(_, bin)| {
                let place = 4.0 * width_px.log2() + 9.0;
                let bin = *bin as f32;
                bin >= place - 1.0 && bin + 1.0 <= place + 1.0
            })
            .map(|(count, _)| count)
            .sum();
        assert!(percents[0] + 1 >= 100 * surely_within / total, "{said}");
    }
}

#[test]
fn a_view_without_a_width_to_aim_at_has_no_target() {
    let (mut tab, camera, _) = tab(kernels());
    let world = tab.state_mut().app.world_mut();
    world.get_mut::<TerrainCamera>(camera).unwrap().policy =
        TessellationPolicy::ScreenError { max_px: 1.0 };
    frames(&mut tab, 6);
    text_with(&tab, "no target");
    assert!(histogram(&tab).1.is_empty());
}

fn measured(tab: &Tab<StatisticsTab>, camera: Entity) -> [bool; 3] {
    let world = tab.state().app.world();
    let statistics = world.get::<TerrainStatistics>(camera).unwrap();
    [
        statistics.measure_triangle_sizes,
        statistics.measure_savings,
        world.resource::<TerrainCpuTimes>().is_measured(),
    ]
}

#[test]
fn measuring_ends_when_the_tab_is_hidden_and_another_camera_takes_its_turn() {
    let (mut tab, camera, _) = tab(kernels());
    assert_eq!(measured(&tab, camera), [true; 3]);
    tab.state_mut().app.update();
    assert_eq!(measured(&tab, camera), [true; 3], "a frame may pass");
    tab.state_mut().app.update();
    tab.state_mut().app.update();
    assert_eq!(measured(&tab, camera), [false; 3]);

    // Seen in the panel, but with another tab over it: times go on, triangles don't.
    let other = tab
        .state_mut()
        .app
        .world_mut()
        .spawn(TerrainCamera::default())
        .id();
    frames(&mut tab, 1);
    assert_eq!(measured(&tab, camera), [true; 3]);
    for _ in 0..3 {
        let shown = tab.state_mut();
        shown.app.update();
        shown.tab.update(shown.app.world_mut(), shown.chosen);
    }
    assert_eq!(measured(&tab, camera), [false, false, true]);

    // Another camera is chosen.
    frames(&mut tab, 1);
    tab.state_mut().chosen.camera = Some(other);
    frames(&mut tab, 1);
    assert_eq!(measured(&tab, camera), [false, false, true]);
    assert_eq!(measured(&tab, other), [true; 3]);

    // What was on before stays on.
    let world = tab.state_mut().app.world_mut();
    let mut statistics = world.get_mut::<TerrainStatistics>(camera).unwrap();
    statistics.measure_triangle_sizes = true;
    tab.state_mut().chosen.camera = Some(camera);
    frames(&mut tab, 2);
    for _ in 0..3 {
        tab.state_mut().app.update();
    }
    assert_eq!(measured(&tab, camera), [true, false, false]);
    assert_eq!(measured(&tab, other), [false; 3]);
}

#[test]
fn what_somebody_sets_while_the_tab_is_seen_stays_then_and_afterwards() {
    let (mut tab, camera, _) = tab(kernels());
    assert_eq!(measured(&tab, camera), [true; 3]);
    let world = tab.state_mut().app.world_mut();
    let mut statistics = world.get_mut::<TerrainStatistics>(camera).unwrap();
    statistics.measure_savings = false;
    world.resource::<TerrainCpuTimes>().set_measured(false);
    frames(&mut tab, 3);
    assert_eq!(measured(&tab, camera), [true, false, false]);
    let world = tab.state_mut().app.world_mut();
    let mut statistics = world.get_mut::<TerrainStatistics>(camera).unwrap();
    statistics.measure_savings = true;
    frames(&mut tab, 3);
    assert_eq!(measured(&tab, camera), [true, true, false]);
    // Closed: what it asked for ends, what somebody set stays.
    for _ in 0..4 {
        tab.state_mut().app.update();
    }
    assert_eq!(measured(&tab, camera), [false, true, false]);
}

#[test]
fn what_is_not_measured_any_more_has_no_value_any_more() {
    let (mut tab, camera, _) = tab(kernels());
    frames(&mut tab, 8);
    let asked = [
        TerrainDiagnostics::SAVED_VERTICES,
        TerrainDiagnostics::SAVED_TRIANGLES,
        TerrainDiagnostics::VIEW_CPU,
        TerrainDiagnostics::EXTRACT_CPU,
    ];
    let values = |tab: &Tab<StatisticsTab>| {
        let store = tab.state().app.world().resource::<DiagnosticsStore>();
        let values = asked.iter().map(|path| store.get(path).unwrap().value());
        values.filter(Option::is_some).count()
    };
    assert_eq!(values(&tab), 4);
    for _ in 0..8 {
        tab.state_mut().app.update();
    }
    assert_eq!(measured(&tab, camera), [false; 3]);
    assert_eq!(values(&tab), 0);
    let store = tab.state().app.world().resource::<DiagnosticsStore>();
    let faces = store.get(&TerrainDiagnostics::FACES).unwrap().value();
    assert!(faces.is_some_and(|faces| faces > 0.0));
    // Asked for again, they are there again.
    frames(&mut tab, 8);
    assert_eq!(values(&tab), 4);
}

#[test]
fn the_second_camera_of_a_comparison_counts_in_no_sum() {
    let (mut tab, camera, terrain) = tab(kernels());
    let world = tab.state_mut().app.world_mut();
    let comparison = TerrainComparison::default();
    world.entity_mut(camera).insert(comparison);
    frames(&mut tab, 12);
    let world = tab.state_mut().app.world_mut();
    let mut others = world.query_filtered::<&TerrainStatistics, With<ComparisonCamera>>();
    let other = others.single(world).unwrap();
    assert!(other.terrains[&terrain].counters.faces > 0);
    let world = tab.state().app.world();
    let faces = told(world, camera, terrain).counters.faces;
    let store = world.resource::<DiagnosticsStore>();
    let diagnosed = store.get(&TerrainDiagnostics::FACES).unwrap().value();
    assert_eq!(diagnosed, Some(f64::from(faces)));
    assert_eq!(row(&tab, "Faces drawn"), [grouped(faces), grouped(faces)]);
}

/// The times of a plot's x axis, from its marks.
fn plotted_s(tab: &Tab<StatisticsTab>) -> f64 {
    let marks = shapes(tab).into_iter().filter_map(|shape| match shape {
        Shape::Text(text) => {
            let seconds = text.galley.text().strip_suffix(" s")?;
            seconds.parse::<f64>().ok()
        }
        _ => None,
    });
    -marks.fold(0.0, f64::min)
}

#[test]
fn the_plot_spans_what_is_chosen_and_shows_the_clock_that_is_chosen() {
    let (mut tab, ..) = tab(kernels());
    tab.get_by_label("CPU").click();
    frames(&mut tab, 12);
    for (window, s) in [("30 s", 30.0), ("120 s", 120.0), ("10 s", 10.0)] {
        tab.get_by_label(window).click();
        frames(&mut tab, 6);
        let plotted_s = plotted_s(&tab);
        assert!(
            plotted_s > 0.4 * s && plotted_s <= s,
            "{window}: {plotted_s} s"
        );
    }
    assert_eq!(row(&tab, "stream").len(), 3);
    tab.get_by_label("GPU").click();
    frames(&mut tab, 4);
    let said: Vec<_> = texts(&tab).into_iter().map(|(text, _)| text).collect();
    assert!(!said.iter().any(|text| text == "stream"), "{said:?}");
}

#[test]
fn triangles_are_measured_only_while_their_histogram_is_unfolded() {
    let (mut tab, camera, _) = tab(kernels());
    tab.get_by_label("Triangle sizes").click();
    frames(&mut tab, 4);
    assert_eq!(measured(&tab, camera), [false, true, true]);
}

#[test]
fn passes_and_systems_are_timed_under_their_names() {
    let (mut tab, ..) = tab(kernels());
    frames(&mut tab, 20);
    let world = tab.state().app.world();
    let store = world.resource::<DiagnosticsStore>();
    let has = |path: &str| {
        store
            .get_measurement(&DiagnosticPath::new(path.to_owned()))
            .is_some()
    };
    for pass in ["classify", "setup", "vertices", "indices", "measure"] {
        assert!(has(&format!("render/terrain_{pass}/elapsed_cpu")), "{pass}");
    }
    let features = world.resource::<RenderDevice>().features();
    let stamps =
        WgpuFeatures::TIMESTAMP_QUERY_INSIDE_PASSES | WgpuFeatures::TIMESTAMP_QUERY_INSIDE_ENCODERS;
    if features.contains(stamps) {
        for pass in ["classify", "setup", "vertices", "indices", "measure"] {
            assert!(has(&format!("render/terrain_{pass}/elapsed_gpu")), "{pass}");
            let [now, mean, most]: [String; 3] = row(&tab, pass).try_into().unwrap();
            for figure in [now, mean, most] {
                assert!(figure.ends_with(" ms"), "{pass}: {figure}");
            }
        }
    }
    let times = world.resource::<TerrainCpuTimes>();
    for stage in TerrainCpuStage::ALL {
        let took = times.of(stage);
        assert!(took.as_nanos() > 0, "{stage:?}");
        let value = store
            .get(&TerrainDiagnostics::of_stage(stage))
            .unwrap()
            .value();
        assert!(value.is_some_and(|ms| ms > 0.0 && ms < 1000.0), "{stage:?}");
    }
    tab.get_by_label("CPU").click();
    frames(&mut tab, 3);
    for stage in ["view", "stream", "cull", "extract"] {
        assert_eq!(row(&tab, stage).len(), 3, "{stage}");
    }
}

#[test]
fn a_device_without_timestamps_is_said_to_have_none() {
    let settings = WgpuSettings {
        disabled_features: Some(
            WgpuFeatures::TIMESTAMP_QUERY
                | WgpuFeatures::TIMESTAMP_QUERY_INSIDE_PASSES
                | WgpuFeatures::TIMESTAMP_QUERY_INSIDE_ENCODERS,
        ),
        ..default()
    };
    let (mut tab, ..) = tab(kernels_in(app::app_on(bundled(), false, settings)));
    // What it has is shown at first.
    text_with(&tab, "stream");
    tab.get_by_label("GPU").click();
    frames(&mut tab, 2);
    text_with(&tab, "no GPU timestamps on this device");
}
