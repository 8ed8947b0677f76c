//! Drawing without a window, into a picture.

use super::{Arguments, Model, TerrainPath, dress_cameras, place_cameras, render_plugin, terrain};
use bevy::app::ScheduleRunnerPlugin;
use bevy::camera::RenderTarget;
use bevy::image::Image;
use bevy::prelude::*;
use bevy::render::render_resource::TextureFormat;
use bevy::render::view::screenshot::{Screenshot, ScreenshotCaptured};
use bevy::window::ExitCondition;
use bevy::winit::WinitPlugin;
use bevy_tessera::stream::TerrainState;
use bevy_tessera::terrain::{Terrain, TerrainFailed};
use std::time::{Duration, Instant};

/// Longer than this nobody waits for a terrain to stream in; the picture shows what there is.
const PATIENCE: Duration = Duration::from_secs(120);

/// The image that cameras draw into, and how far the run has come.
#[derive(Resource)]
struct Picture {
    image: Handle<Image>,
    started: Instant,
    frames_left: u32,
    captured: bool,
}

pub(super) fn app(model: &Model, arguments: Arguments) -> App {
    let mut app = App::new();
    let (assets, terrain) = terrain(model, &arguments);
    app.add_plugins(
        DefaultPlugins
            .set(AssetPlugin {
                file_path: assets,
                ..default()
            })
            .set(WindowPlugin {
                primary_window: None,
                exit_condition: ExitCondition::DontExit,
                ..default()
            })
            .set(render_plugin())
            .disable::<WinitPlugin>(),
    )
    .add_plugins(ScheduleRunnerPlugin::run_loop(Duration::ZERO));
    let size = arguments.size.unwrap_or(UVec2::new(1280, 720));
    let image = Image::new_target_texture(size.x, size.y, TextureFormat::Rgba8UnormSrgb, None);
    let image = app.world_mut().resource_mut::<Assets<Image>>().add(image);
    app.insert_resource(Picture {
        image,
        started: Instant::now(),
        frames_left: arguments.frames.unwrap_or(3).max(1),
        captured: false,
    });
    app.insert_resource(TerrainPath(terrain));
    app.insert_resource(arguments);
    app.add_systems(PostStartup, (place_cameras, dress_cameras, aim_cameras));
    app.add_systems(Last, finish);
    app.add_observer(give_up);
    app
}

/// There will be no picture: the log has said why.
fn give_up(_failed: On<TerrainFailed>, mut exit: MessageWriter<AppExit>) {
    exit.write(AppExit::error());
}

/// Cameras draw into the picture.
fn aim_cameras(
    mut commands: Commands,
    cameras: Query<Entity, With<Camera3d>>,
    picture: Res<Picture>,
) {
    for camera in &cameras {
        let target = RenderTarget::Image(picture.image.clone().into());
        commands.entity(camera).insert(target);
    }
}

/// Counts frames once everything has streamed in, then takes the picture and ends.
fn finish(
    mut commands: Commands,
    mut picture: ResMut<Picture>,
    arguments: Res<Arguments>,
    terrains: Query<Option<&TerrainState>, With<Terrain>>,
    mut exit: MessageWriter<AppExit>,
) {
    if picture.captured {
        return;
    }
    let settled = terrains
        .iter()
        .all(|state| state.is_some_and(TerrainState::is_settled));
    let late = picture.started.elapsed() > PATIENCE;
    if !settled && !late {
        return;
    }
    if late && !settled && picture.frames_left == arguments.frames.unwrap_or(3).max(1) {
        eprintln!(
            "the terrain has not streamed in after {PATIENCE:?}: going on with what is there"
        );
    }
    picture.frames_left = picture.frames_left.saturating_sub(1);
    if picture.frames_left > 0 {
        return;
    }
    picture.captured = true;
    let Some(path) = arguments.screenshot.clone() else {
        exit.write(AppExit::Success);
        return;
    };
    commands
        .spawn(Screenshot::image(picture.image.clone()))
        .observe(
            move |captured: On<ScreenshotCaptured>, mut exit: MessageWriter<AppExit>| {
                let saved = captured
                    .image
                    .clone()
                    .try_into_dynamic()
                    .map_err(|error| error.to_string())
                    .and_then(|image| {
                        image
                            .to_rgb8()
                            .save(&path)
                            .map_err(|error| error.to_string())
                    });
                match saved {
                    Ok(()) => {
                        eprintln!("saved {}", path.display());
                        exit.write(AppExit::Success);
                    }
                    Err(error) => {
                        eprintln!("{} can't be saved: {error}", path.display());
                        exit.write(AppExit::error());
                    }
                }
            },
        );
}
