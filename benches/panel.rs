//! What the open panel costs the CPU a frame: `cargo bench --all-features --bench panel`.
//!
//! For every built-in tab, seen in a panel of 400 × 1080 points with all its groups unfolded, over a
//! world in which there is something to show: a terrain of 341 tiles, all resident but some that have
//! failed and some that load, 2000 edits, a camera that draws what its level of detail selects, figures
//! and a histogram of a view, and times of all passes in full plots. Measured are the layout, which is
//! what runs in the main world's schedule, and the tessellation of its shapes into triangles. Nothing
//! is drawn.

#[path = "../tests/streaming_support/mod.rs"]
mod streaming_support;
#[path = "../tests/common/virtual_source.rs"]
#[expect(dead_code, reason = "the tests use the rest")]
mod virtual_source;

use bevy::asset::AssetApp;
use bevy::diagnostic::{Diagnostic, DiagnosticMeasurement, DiagnosticPath, DiagnosticsStore};
use bevy::gizmos::GizmoAsset;
use bevy::picking::{InteractionPlugin, PickingPlugin};
use bevy::prelude::*;
use bevy_egui::egui::{self, accesskit};
use bevy_tessera::debug::brush::{BrushPlugin, TerrainBrush};
use bevy_tessera::debug::{StatisticsTabPlugin, TerrainPanel};
use bevy_tessera::detail::TerrainDetail;
use bevy_tessera::edit::{Change, Edit, EditLog, TerrainEdits};
use bevy_tessera::gizmos::TerrainGizmos;
use bevy_tessera::lattice::Node;
use bevy_tessera::physics::TerrainPhysics;
use bevy_tessera::query::TerrainPickingPlugin;
use bevy_tessera::render::{
    GpuTerrainCounters, TerrainComparison, TerrainDensityPreview, TerrainDiagnostics,
    TerrainGpuMemory, TerrainNodes, TerrainOverlay, TerrainOverlays, TerrainPass,
    TerrainStatistics, TerrainViewStatistics,
};
use bevy_tessera::stream::{TerrainPin, TerrainRegion, TerrainState, TerrainStreaming};
use bevy_tessera::terrain::{Terrain, TerrainCamera, TerrainCpuStage, TerrainSettings};
use bevy_tessera::view::TerrainViews;
use criterion::{Criterion, criterion_group, criterion_main};
use std::hint::black_box;
use std::time::{Duration, Instant};
use streaming_support::World3;
use virtual_source::{Outcome, VirtualSource};

/// Samples of the terrain a side.
const SIDE: u32 = 2049;
const EDITS: i32 = 2000;
/// Points of a plot, and what it spans at first.
const POINTS: u32 = 120;
const WINDOW_S: f64 = 10.0;

/// Groups that are closed at first.
const CLOSED: [&str; 9] = [
    "Material",
    "Detail",
    "Density preview",
    "Destruction mask",
    "Streaming",
    "Physics",
    "Other settings",
    "Edits",
    "Edge factors",
];

fn world() -> World3 {
    let mut world = World3::in_app([SIDE; 2], false, |app, assets| {
        let source = VirtualSource::new(assets, |path, _| {
            let path = path.to_string_lossy();
            if path.ends_with("0/3_5.tile") || path.ends_with("0/12_12.tile") {
                (0, Outcome::Failure)
            } else if ["0/9_3", "0/9_4", "0/9_5", "0/9_6"]
                .iter()
                .any(|it| path.contains(it))
            {
                (1 << 40, Outcome::Good)
            } else {
                (0, Outcome::Good)
            }
        });
        app.register_asset_source("late", source.builder());
        app.add_systems(First, move || source.tick());
        app.add_plugins((
            PickingPlugin,
            InteractionPlugin,
            TerrainPickingPlugin,
            bevy::input::InputPlugin,
            BrushPlugin,
            StatisticsTabPlugin,
        ));
    });
    world.app.init_asset::<GizmoAsset>();
    let app = world.app.world_mut();
    app.insert_resource(TerrainStreaming {
        retry_s: 1e6,
        load_timeout_s: 1e6,
        ..default()
    });
    app.init_resource::<TerrainPhysics>();
    app.resource_mut::<GizmoConfigStore>()
        .insert(GizmoConfig::default(), TerrainGizmos::default());
    app.resource_mut::<TerrainBrush>().on = true;
    let manifest = app
        .resource::<AssetServer>()
        .load("late://alps/terrain.ron");
    let terrain = (
        Terrain::new(manifest),
        TerrainSettings::default(),
        TerrainDetail::default(),
        TerrainDensityPreview::default(),
    );
    let terrain = app.spawn(terrain).id();
    app.spawn(TerrainPin {
        terrain,
        region: TerrainRegion::EVERYTHING,
        finest_level: 0,
    });
    let eye =
        Transform::from_xyz(2000.0, 500.0, 2000.0).looking_to(Vec3::new(1.0, -0.3, 0.4), Vec3::Y);
    let camera = (
        TerrainCamera::default(),
        TerrainOverlays::only(TerrainOverlay::Level),
        TerrainComparison::default(),
        TerrainNodes::default(),
        Projection::default(),
        eye,
    );
    let camera = app.spawn(camera).id();
    world.run_until("all is there that comes", |world| {
        let state = world.get::<TerrainState>(terrain);
        state.is_some_and(|state| state.resident_count() == 335 && state.failed_count() == 2)
    });
    fill(world.app.world_mut(), terrain, camera);
    world
}

/// What edits and a renderer would have left there.
fn fill(world: &mut World, terrain: Entity, camera: Entity) {
    let state = world.get::<TerrainState>(terrain).expect("it has loaded");
    let mut log = EditLog::new(&state.manifest().file);
    for at in 0..EDITS {
        let change = Change::Raise {
            by: 1 + at % 5,
            hardness: 0,
            density: 0,
            may_clamp: false,
        };
        let centre = [at % 45 * 2900, at / 45 * 2900];
        let edit = Edit {
            centre,
            reach: 128,
            change,
        };
        log.push(edit).expect("an edit");
    }
    world.entity_mut(terrain).insert(TerrainEdits::new(log));

    let views = world.get::<TerrainViews>(camera).expect("it has some");
    let view = *views.of(terrain).expect("it sees the terrain");
    let mut nodes: Vec<Node> = Vec::new();
    let mut keep = |node: Node| nodes.push(node);
    view.lod.select(&view.lattice, &mut |_, _| true, &mut keep);
    // About as many as a camera sees of those around it.
    nodes.truncate(nodes.len() / 3);
    let mut drawn = TerrainNodes::default();
    drawn.nodes.insert(terrain, nodes);
    world.entity_mut(camera).insert(drawn);

    let bell = |bins: usize, bin: usize| {
        let from = (bin as f32 - 0.5 * bins as f32) / (0.2 * bins as f32);
        (90_000.0 * (-from * from).exp()) as u32
    };
    let figures = TerrainViewStatistics {
        counters: GpuTerrainCounters {
            faces: 40_321,
            culled_faces: 81_003,
            edges: 161_284,
            clamped_edges: 311,
            factors: std::array::from_fn(|bin| bell(28, bin)),
            triangle_sizes: std::array::from_fn(|bin| bell(32, bin)),
            plain_vertices: 812_345,
            plain_triangles: 1_612_345,
        },
        has_triangle_sizes: true,
        has_savings: true,
        vertices: 412_345,
        triangles: 812_345,
        wanted_vertices: 412_345,
        wanted_triangles: 812_345,
        room_vertices: 600_000,
        overflow: 0,
        width_scale: 1.0,
        gpu_bytes: 123_456_789,
    };
    let mut statistics = TerrainStatistics::default();
    statistics.terrains.insert(terrain, figures);
    world.entity_mut(camera).insert(statistics);
    world.insert_resource(TerrainGpuMemory {
        pages_bytes: 500 << 20,
        meshes_bytes: 120 << 20,
        tables_bytes: 3 << 20,
    });
    let mut store = DiagnosticsStore::default();
    for path in timed() {
        store.add(Diagnostic::new(path));
    }
    world.insert_resource(store);
}

/// What the plots of either clock are made of.
fn timed() -> Vec<DiagnosticPath> {
    let passes = TerrainPass::ALL.map(TerrainPass::label);
    let others = [
        "terrain_comparison",
        "main_opaque_pass_3d",
        "early prepass",
        "early deferred prepass",
    ];
    let mut paths: Vec<_> = TerrainCpuStage::ALL
        .map(TerrainDiagnostics::of_stage)
        .into();
    for label in passes.into_iter().chain(others) {
        for field in ["elapsed_gpu", "elapsed_cpu"] {
            paths.push(DiagnosticPath::from_components(["render", label, field]));
        }
    }
    paths
}

/// What is done in every frame.
#[derive(Clone, Copy, PartialEq)]
enum Doing {
    Nothing,
    /// The wheel over the middle of the panel turns to and fro.
    Zooming,
}

/// A panel and the world that it shows.
struct Shown {
    ctx: egui::Context,
    panel: TerrainPanel,
    world: World3,
    timed: Vec<DiagnosticPath>,
    time_s: f64,
}

impl Shown {
    /// The tab on top, with every group of it open.
    fn new(tab: &'static str) -> Self {
        let mut shown = Self {
            ctx: egui::Context::default(),
            panel: TerrainPanel {
                shown_tab: Some(tab),
                ..default()
            },
            world: world(),
            timed: timed(),
            time_s: 0.0,
        };
        shown.open_groups();
        for _ in 0..60 {
            shown.frame();
        }
        if tab == "Statistics" {
            for _ in 0..=POINTS {
                shown.measure();
                shown.frame();
                std::thread::sleep(Duration::from_secs_f64(WINDOW_S / f64::from(POINTS)));
            }
        }
        shown
    }

    /// Opens what is closed at first, as assistive technology does.
    fn open_groups(&mut self) {
        self.ctx.enable_accesskit();
        self.frame();
        let output = self.frame();
        let update = output.platform_output.accesskit_update;
        let nodes = update.expect("it was asked for").nodes;
        for (target_node, node) in nodes {
            if node.label().is_some_and(|label| CLOSED.contains(&label)) {
                let request = accesskit::ActionRequest {
                    action: accesskit::Action::Click,
                    target_tree: accesskit::TreeId::ROOT,
                    target_node,
                    data: None,
                };
                self.frame_after(vec![egui::Event::AccessKitActionRequest(request)]);
            }
        }
        self.ctx.disable_accesskit();
    }

    /// A frame's new times.
    fn measure(&mut self) {
        let mut store = self
            .world
            .app
            .world_mut()
            .resource_mut::<DiagnosticsStore>();
        let time = Instant::now();
        for (at, path) in self.timed.iter().enumerate() {
            let value = 0.1 + 0.05 * at as f64 + 0.02 * (self.time_s + at as f64).sin();
            if let Some(diagnostic) = store.get_mut(path) {
                diagnostic.add_measurement(DiagnosticMeasurement { time, value });
            }
        }
    }

    fn frame(&mut self) -> egui::FullOutput {
        self.frame_after(Vec::new())
    }

    fn frame_while(&mut self, doing: Doing, frame: u64) -> egui::FullOutput {
        if doing == Doing::Nothing {
            return self.frame();
        }
        let lines = if frame.is_multiple_of(2) { 1.0 } else { -1.0 };
        let wheel = egui::Event::MouseWheel {
            unit: egui::MouseWheelUnit::Point,
            delta: egui::vec2(0.0, 8.0 * lines),
            phase: egui::TouchPhase::Move,
            modifiers: egui::Modifiers::NONE,
        };
        let over = egui::Event::PointerMoved(egui::pos2(200.0, 540.0));
        self.frame_after(vec![over, wheel])
    }

    fn frame_after(&mut self, events: Vec<egui::Event>) -> egui::FullOutput {
        let Self {
            ctx, panel, world, ..
        } = self;
        self.time_s += 1.0 / 60.0;
        let size = egui::vec2(400.0, 1080.0);
        let input = egui::RawInput {
            screen_rect: Some(egui::Rect::from_min_size(egui::Pos2::ZERO, size)),
            time: Some(self.time_s),
            events,
            ..default()
        };
        ctx.run_ui(input, |ui| panel.ui(ui, world.app.world_mut()))
    }
}

fn panel(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("panel");
    for (tab, doing, name) in [
        ("Settings", Doing::Nothing, "Settings"),
        ("Views", Doing::Nothing, "Views"),
        ("Statistics", Doing::Nothing, "Statistics"),
        ("Map", Doing::Nothing, "Map"),
        ("Map", Doing::Zooming, "Map, zoomed"),
        ("Edit", Doing::Nothing, "Edit"),
    ] {
        let mut shown = Shown::new(tab);
        group.bench_function(format!("{name}, layout"), |bencher| {
            bencher.iter_custom(|frames| {
                let mut took = Duration::ZERO;
                for frame in 0..frames {
                    shown.measure();
                    let began = Instant::now();
                    let output = black_box(shown.frame_while(doing, frame));
                    took += began.elapsed();
                    drop(output);
                }
                took
            });
        });
        let output = shown.frame();
        group.bench_function(format!("{name}, tessellation"), |bencher| {
            bencher.iter_batched(
                || output.shapes.clone(),
                |shapes| black_box(shown.ctx.tessellate(shapes, output.pixels_per_point)),
                criterion::BatchSize::SmallInput,
            );
        });
    }
    group.finish();
}

criterion_group!(benches, panel);
criterion_main!(benches);
