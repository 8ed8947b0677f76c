//! Bevy with its renderer and no window, stepped frame by frame.

use bevy::app::PluginsState;
use bevy::asset::LoadState;
use bevy::camera::RenderTarget;
use bevy::image::Image;
use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::pipelined_rendering::PipelinedRenderingPlugin;
use bevy::render::render_resource::TextureFormat;
use bevy::render::settings::WgpuSettings;
use bevy::render::view::screenshot::{Screenshot, ScreenshotCaptured};
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use bevy_tessera::TerrainPlugins;
use bevy_tessera::stream::TerrainState;
use bevy_tessera::terrain::Terrain;
use image::RgbImage;
use std::path::Path;
use std::sync::{Arc, Mutex};

/// An app whose asset folder is `assets`, with terrains, ready to be stepped.
pub fn app(assets: &Path, pipelined: bool) -> App {
    app_on(assets, pipelined, WgpuSettings::default())
}

/// The same on a device made with `settings`.
pub fn app_on(assets: &Path, pipelined: bool, settings: WgpuSettings) -> App {
    app_after(assets, pipelined, settings, |_| ())
}

/// The same; `first` may do what must come before Bevy's plugins.
pub fn app_after(
    assets: &Path,
    pipelined: bool,
    settings: WgpuSettings,
    first: impl FnOnce(&mut App),
) -> App {
    let mut app = App::new();
    first(&mut app);
    let plugins = DefaultPlugins
        .set(AssetPlugin {
            file_path: assets.to_string_lossy().into_owned(),
            ..default()
        })
        .set(WindowPlugin {
            primary_window: None,
            exit_condition: ExitCondition::DontExit,
            ..default()
        })
        .set(RenderPlugin {
            synchronous_pipeline_compilation: true,
            render_creation: settings.into(),
            ..default()
        })
        .disable::<WinitPlugin>();
    // `RUST_LOG=warn` shows what the renderer complains of.
    let plugins = if std::env::var_os("RUST_LOG").is_some() {
        plugins
    } else {
        plugins.disable::<bevy::log::LogPlugin>()
    };
    if pipelined {
        app.add_plugins(plugins);
    } else {
        app.add_plugins(plugins.disable::<PipelinedRenderingPlugin>());
    }
    app.add_plugins(TerrainPlugins);
    app
}

/// Waits for the device and finishes the plugins. Call once, after all plugins are added.
pub fn finish(app: &mut App) {
    while app.plugins_state() == PluginsState::Adding {
        bevy::tasks::tick_global_task_pools_on_main_thread();
    }
    app.finish();
    app.cleanup();
}

/// An image that cameras can draw into.
pub fn target(app: &mut App, width: u32, height: u32) -> Handle<Image> {
    let image = Image::new_target_texture(width, height, TextureFormat::Rgba8UnormSrgb, None);
    app.world_mut().resource_mut::<Assets<Image>>().add(image)
}

pub fn into_image(image: &Handle<Image>) -> RenderTarget {
    RenderTarget::Image(image.clone().into())
}

/// Steps the app until every terrain has streamed in, at most `frames` frames.
pub fn settle(app: &mut App, frames: u32) {
    for _ in 0..frames {
        app.update();
        let mut terrains = app
            .world_mut()
            .query_filtered::<Option<&TerrainState>, With<Terrain>>();
        let settled = terrains
            .iter(app.world())
            .all(|state| state.is_some_and(TerrainState::is_settled));
        if settled {
            return;
        }
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    panic!("the terrain has not streamed in after {frames} frames");
}

/// The next frame that is drawn into `target`.
pub fn picture(app: &mut App, target: &Handle<Image>) -> RgbImage {
    let taken: Arc<Mutex<Option<RgbImage>>> = Arc::default();
    let slot = taken.clone();
    app.world_mut()
        .spawn(Screenshot::image(target.clone()))
        .observe(move |captured: On<ScreenshotCaptured>| {
            let image = captured.image.clone().try_into_dynamic().unwrap();
            *slot.lock().unwrap() = Some(image.to_rgb8());
        });
    for _ in 0..100 {
        app.update();
        if let Some(image) = taken.lock().unwrap().take() {
            return image;
        }
    }
    panic!("no picture was taken in 100 frames");
}

/// Waits until an asset has loaded.
pub fn wait_for<A: Asset>(app: &mut App, handle: &Handle<A>) {
    for _ in 0..1000 {
        app.update();
        match app.world().resource::<AssetServer>().load_state(handle) {
            LoadState::Loaded => return,
            LoadState::Failed(error) => panic!("{error}"),
            _ => {}
        }
    }
    panic!("an asset has not loaded after 1000 frames");
}
