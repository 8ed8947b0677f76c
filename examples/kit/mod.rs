//! What every example shares: a window or, without one, pictures; and a terrain to show.
#![allow(dead_code, reason = "each example uses a part of it")]

mod arguments;
mod headless;

pub use arguments::Arguments;

use bevy::camera_controller::free_camera::FreeCameraState;
use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::renderer::RenderAdapterInfo;
use bevy_tessera::bake::import::{self, ImportSettings};
use bevy_tessera::bake::{BakeSettings, bake};
use bevy_tessera::debug::{TerrainCameraFlown, TerrainDebugPlugin, TerrainPanel};
use bevy_tessera::gizmos::{TerrainGizmos, TerrainGizmosPlugin};
use bevy_tessera::terrain::{TerrainCamera, TerrainManifest};
use bevy_tessera::view::TerrainEye;
use std::path::{Path, PathBuf};

/// Bevy with its default plugins, in a window or headless, as the arguments say; the asset folder
/// holds the terrain at [`TERRAIN`] or the one that `--terrain` names.
pub fn app() -> App {
    app_on(&JACKSBORO, Arguments::parse())
}

/// The bundled elevation model, as some example wants it.
pub struct Model {
    /// The terrain's folder, in that of the assets.
    pub folder: &'static str,
    pub spacing_m: f64,
    /// Metres for each step of the model's heights, and at height 0.
    pub scale: f64,
    pub offset: f64,
}

/// As it is.
pub const JACKSBORO: Model = Model {
    folder: "terrains/jacksboro",
    spacing_m: 30.0,
    scale: 0.02,
    offset: 200.0,
};

/// Small enough for a crater to be seen, rough enough to hide in.
pub const BATTLEFIELD: Model = Model {
    folder: "terrains/battlefield",
    spacing_m: 1.0,
    scale: 0.002,
    offset: 0.0,
};

/// The same, on `model`.
pub fn app_on(model: &Model, arguments: Arguments) -> App {
    let gizmos = arguments.gizmos.clone();
    let mut app = with_bevy(model, arguments);
    if let Some(gizmos) = gizmos {
        app.add_plugins(TerrainGizmosPlugin);
        let mut store = app.world_mut().resource_mut::<GizmoConfigStore>();
        *store.config_mut::<TerrainGizmos>().1 = gizmos;
    }
    app
}

fn with_bevy(model: &Model, arguments: Arguments) -> App {
    if !arguments.headless {
        match windowed(model, &arguments) {
            Some(app) => return app,
            None => eprintln!("no window can be opened: running headless"),
        }
    }
    headless::app(model, arguments)
}

/// Adds the terrain's panel, which F3 opens; `--panel` begins with it open.
pub fn add_panel(app: &mut App) {
    app.add_plugins(TerrainDebugPlugin).add_observer(turn_along);
    let arguments = app.world().resource::<Arguments>().clone();
    if !arguments.headless {
        println!("F3 opens and closes the terrain's panel");
    }
    let Some(tab) = arguments.panel else {
        return;
    };
    let mut panel = app.world_mut().resource_mut::<TerrainPanel>();
    let titles: Vec<_> = panel.tabs.iter().map(|tab| tab.title()).collect();
    let shown = titles.iter().find(|title| title.eq_ignore_ascii_case(&tab));
    if shown.is_none() && !tab.is_empty() {
        eprintln!("there is no tab {tab}: it is one of {}", titles.join(", "));
        std::process::exit(2);
    }
    panel.is_open = true;
    panel.shown_tab = shown.copied();
}

/// Bevy's camera keeps its angles beside the `Transform`; where the panel has flown it, they follow.
fn turn_along(
    flown: On<TerrainCameraFlown>,
    mut cameras: Query<(&Transform, &mut FreeCameraState)>,
) {
    if let Ok((transform, mut state)) = cameras.get_mut(flown.entity) {
        let (yaw, pitch, _) = transform.rotation.to_euler(EulerRot::YXZ);
        (state.yaw, state.pitch) = (yaw, pitch);
    }
}

/// Whether this renderer draws on the CPU.
pub fn is_software(adapter: &RenderAdapterInfo) -> bool {
    // The type's own enum is wgpu's, which Bevy doesn't hand on.
    format!("{:?}", adapter.device_type) == "Cpu"
}

/// The terrain's manifest in the asset folder.
#[derive(Resource)]
pub struct TerrainPath(pub String);

fn windowed(model: &Model, arguments: &Arguments) -> Option<App> {
    // Bevy's window plugin panics where there is no display; that is an answer, not an accident.
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(|_| {}));
    let app = std::panic::catch_unwind(|| {
        let mut app = App::new();
        let (assets, terrain) = terrain(model, arguments);
        app.add_plugins(DefaultPlugins.set(AssetPlugin {
            file_path: assets,
            ..default()
        }));
        app.insert_resource(TerrainPath(terrain));
        app.insert_resource(arguments.clone());
        app.add_systems(PostStartup, (place_cameras, dress_cameras));
        app
    });
    std::panic::set_hook(hook);
    app.ok()
}

fn render_plugin() -> RenderPlugin {
    RenderPlugin {
        // A picture is to show everything from the first frame on.
        synchronous_pipeline_compilation: true,
        ..default()
    }
}

/// Where `--eye` and `--look` want it, every camera stands there.
fn place_cameras(arguments: Res<Arguments>, mut cameras: Query<&mut Transform, With<Camera3d>>) {
    for mut transform in &mut cameras {
        if let Some(eye) = arguments.eye {
            transform.translation = eye;
        }
        if let Some(look) = arguments.look {
            *transform = looking_at(*transform, look);
        }
    }
}

/// Where `--overlay` wants some, every camera shows them.
fn dress_cameras(
    mut commands: Commands,
    arguments: Res<Arguments>,
    cameras: Query<Entity, With<Camera3d>>,
) {
    if let Some(overlays) = &arguments.overlays {
        for camera in &cameras {
            commands.entity(camera).insert(overlays.clone());
        }
    }
}

fn looking_at(from: Transform, look: Vec3) -> Transform {
    let is_upright = (look - from.translation).normalize_or_zero().y.abs() > 0.999;
    from.looking_at(look, if is_upright { Vec3::Z } else { Vec3::Y })
}

/// Where `--beside` asks for it, cameras leave their level of detail behind in the second frame and
/// show it from there.
pub fn step_beside(
    mut commands: Commands,
    arguments: Res<Arguments>,
    mut cameras: Query<(Entity, &mut Transform), With<TerrainCamera>>,
    mut frames: Local<u32>,
) {
    *frames += 1;
    let Some(beside) = arguments.beside.filter(|_| *frames == 2) else {
        return;
    };
    for (camera, mut transform) in &mut cameras {
        transform.translation = beside;
        if let Some(look) = arguments.beside_look {
            *transform = looking_at(*transform, look);
        }
        commands.entity(camera).insert(TerrainEye::EyeOnly);
    }
}

/// The asset folder, and the manifest's path in it. Bakes the bundled elevation model where
/// nobody has done so yet.
pub fn terrain(model: &Model, arguments: &Arguments) -> (String, String) {
    if let Some(folder) = &arguments.terrain {
        let folder = std::path::absolute(folder).unwrap_or_else(|_| folder.clone());
        if let (Some(parent), Some(name)) = (folder.parent(), folder.file_name()) {
            return (
                parent.to_string_lossy().into_owned(),
                format!("{}/terrain.ron", name.to_string_lossy()),
            );
        }
    }
    let assets = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets");
    let folder = assets.join(model.folder);
    // One that another version of the crate baked is baked again.
    if TerrainManifest::read(&folder).is_err()
        && let Err(error) = bake_bundled(model, &assets, &folder)
    {
        eprintln!("{error}");
        std::process::exit(1);
    }
    (
        assets.to_string_lossy().into_owned(),
        format!("{}/terrain.ron", model.folder),
    )
}

/// Bakes the bundled elevation model into `folder`.
pub fn bake_bundled(
    model: &Model,
    assets: &Path,
    folder: &Path,
) -> Result<(), Box<dyn std::error::Error>> {
    eprintln!(
        "baking the bundled elevation model into {}",
        folder.display()
    );
    if let Some(parent) = folder.parent() {
        std::fs::create_dir_all(parent)?;
    }
    let source: PathBuf = assets.join("elevation/jacksboro_u16.png");
    let import_settings = ImportSettings {
        scale: Some(model.scale),
        offset: Some(model.offset),
        ..Default::default()
    };
    let settings = BakeSettings {
        spacing_m: Some(model.spacing_m),
        force: true,
        ..Default::default()
    };
    let mut source = import::open(&source, &import_settings)?;
    bake(&mut *source, folder, &settings, &())?;
    Ok(())
}
