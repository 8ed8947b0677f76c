//! What a terrain costs the CPU in a frame, by stage, with all of Bevy running around it:
//! `cargo bench --all-features --bench frame`.
//!
//! The spans of the terrain's systems are timed; Bevy's executor around them is not.

use bevy::app::PluginsState;
use bevy::camera::RenderTarget;
use bevy::image::Image;
use bevy::log::LogPlugin;
use bevy::log::tracing_subscriber::filter::filter_fn;
use bevy::log::tracing_subscriber::layer::{Context, Layer, SubscriberExt};
use bevy::log::tracing_subscriber::registry;
use bevy::log::tracing_subscriber::registry::LookupSpan;
use bevy::log::tracing_subscriber::util::SubscriberInitExt;
use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::pipelined_rendering::PipelinedRenderingPlugin;
use bevy::render::render_resource::TextureFormat;
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use bevy_tessera::TerrainPlugins;
use bevy_tessera::bake::{BakeSettings, MemorySource, bake};
use bevy_tessera::lattice::LodSettings;
use bevy_tessera::render::TerrainNodes;
use bevy_tessera::stream::TerrainState;
use bevy_tessera::stream::TerrainStreaming;
use bevy_tessera::terrain::{Terrain, TerrainCamera, TerrainSettings};
use std::sync::Mutex;
use std::time::Instant;
use tracing::Subscriber;
use tracing::span::Id;

/// Nanoseconds that each span took, an entry a frame.
static TIMES: Mutex<Vec<(&str, Vec<u64>)>> = Mutex::new(Vec::new());

/// Times the spans of the terrain's systems.
struct Stopwatch;

/// When a span was entered.
struct Entered(Instant);

impl<S: Subscriber + for<'a> LookupSpan<'a>> Layer<S> for Stopwatch {
    fn on_enter(&self, id: &Id, context: Context<'_, S>) {
        if let Some(span) = context.span(id) {
            span.extensions_mut().replace(Entered(Instant::now()));
        }
    }

    fn on_exit(&self, id: &Id, context: Context<'_, S>) {
        let Some(span) = context.span(id) else { return };
        let Some(elapsed) = span
            .extensions()
            .get::<Entered>()
            .map(|entered| entered.0.elapsed())
        else {
            return;
        };
        let elapsed = elapsed.as_nanos() as u64;
        let mut times = TIMES.lock().unwrap();
        match times.iter_mut().find(|(name, _)| *name == span.name()) {
            Some((_, times)) => times.push(elapsed),
            None => times.push((span.name(), vec![elapsed])),
        }
    }
}

/// Rolling hills with ridges: enough shape that bounds and densities differ from tile to tile.
fn hills(side: u32) -> MemorySource {
    let heights = (0..side * side)
        .map(|i| {
            let (x, z) = ((i % side) as f32, (i / side) as f32);
            let ridge = (x * 0.011 + (z * 0.004).sin() * 2.0).sin().abs();
            300.0 + 120.0 * ridge + 60.0 * (z * 0.007).cos() + 8.0 * (x * 0.09 + z * 0.07).sin()
        })
        .collect();
    MemorySource::new([side, side], heights).expect("as many heights as samples")
}

fn main() {
    let terrain_only = filter_fn(|metadata| metadata.target().starts_with("bevy_tessera"));
    registry().with(Stopwatch.with_filter(terrain_only)).init();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let mut source = hills(4097);
    bake(
        &mut source,
        &folder.path().join("hills"),
        &BakeSettings::default(),
        &(),
    )
    .expect("hills can be baked");

    let mut app = App::new();
    app.add_plugins(
        DefaultPlugins
            .set(AssetPlugin {
                file_path: folder.path().to_string_lossy().into_owned(),
                ..default()
            })
            .set(WindowPlugin {
                primary_window: None,
                exit_condition: ExitCondition::DontExit,
                ..default()
            })
            .set(RenderPlugin {
                synchronous_pipeline_compilation: true,
                ..default()
            })
            .disable::<LogPlugin>()
            .disable::<WinitPlugin>()
            .disable::<PipelinedRenderingPlugin>(),
    )
    .add_plugins(TerrainPlugins);
    while app.plugins_state() == PluginsState::Adding {
        bevy::tasks::tick_global_task_pools_on_main_thread();
    }
    app.finish();
    app.cleanup();

    app.insert_resource(TerrainStreaming::with_pages(2048));
    let image = Image::new_target_texture(64, 36, TextureFormat::Rgba8UnormSrgb, None);
    let image = app.world_mut().resource_mut::<Assets<Image>>().add(image);
    let manifest = app
        .world()
        .resource::<AssetServer>()
        .load("hills/terrain.ron");
    let terrain = app
        .world_mut()
        .spawn((
            Terrain::new(manifest),
            TerrainSettings {
                leaf_level: -2,
                ..default()
            },
        ))
        .id();
    let camera = app
        .world_mut()
        .spawn((
            Camera3d::default(),
            Msaa::Off,
            TerrainCamera {
                lod: LodSettings {
                    reach: 13.0,
                    morph: 1.0,
                },
                triangle_width_px: 32.0,
                ..default()
            },
            RenderTarget::Image(image.into()),
            Transform::from_xyz(2000.0, 420.0, 2000.0)
                .looking_to(Vec3::new(1.0, -0.4, 0.7), Vec3::Y),
        ))
        .id();
    app.world_mut().spawn((
        DirectionalLight {
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(0.5, -1.0, 0.3), Vec3::Y),
    ));
    let mut moved = 0.0;
    for frame in 0..900 {
        // The eye moves a little every frame: nothing may be cached from the one before.
        moved += 0.05;
        app.world_mut()
            .get_mut::<Transform>(camera)
            .unwrap()
            .translation
            .x = 2000.0 + moved;
        app.update();
        let settled = app
            .world()
            .get::<TerrainState>(terrain)
            .is_some_and(TerrainState::is_settled);
        if frame > 30 && settled {
            break;
        }
    }
    TIMES.lock().unwrap().clear();
    for _ in 0..200 {
        moved += 0.05;
        app.world_mut()
            .get_mut::<Transform>(camera)
            .unwrap()
            .translation
            .x = 2000.0 + moved;
        app.update();
    }

    let nodes = app.world().get::<TerrainNodes>(camera).unwrap().nodes[&terrain].len();
    let tiles = app
        .world()
        .get::<TerrainState>(terrain)
        .unwrap()
        .resident_count();
    println!("{nodes} nodes in view and cascades, {tiles} tiles resident, medians of 200 frames:");
    let mut total = 0.0;
    for (stage, times) in TIMES.lock().unwrap().iter_mut() {
        // A stage that runs several times a frame counts as often.
        let a_frame = times.len() as f64 / 200.0;
        times.sort_unstable();
        let median = a_frame * times[times.len() / 2] as f64 / 1e6;
        total += median;
        println!("{stage:24} {median:8.4} ms");
    }
    println!("{:24} {total:8.4} ms", "sum");
}
