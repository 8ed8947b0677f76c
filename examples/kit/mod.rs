//! What every example shares: a window or, without one, pictures; and a terrain to show.
#![allow(dead_code, reason = "each example uses a part of it")]

mod arguments;
mod headless;

pub use arguments::Arguments;

use bevy::prelude::*;
use bevy::render::RenderPlugin;
use bevy::render::renderer::RenderAdapterInfo;
use bevy_tessera::bake::import::{self, ImportSettings};
use bevy_tessera::bake::{BakeSettings, bake};
use bevy_tessera::terrain::TerrainManifest;
use std::path::{Path, PathBuf};

/// Bevy with its default plugins, in a window or headless, as the arguments say; the asset folder
/// holds the terrain at [`TERRAIN`] or the one that `--terrain` names.
pub fn app() -> App {
    let arguments = Arguments::parse();
    if !arguments.headless {
        match windowed(&arguments) {
            Some(app) => return app,
            None => eprintln!("no window can be opened: running headless"),
        }
    }
    headless::app(arguments)
}

/// Whether this renderer draws on the CPU.
pub fn is_software(adapter: &RenderAdapterInfo) -> bool {
    // The type's own enum is wgpu's, which Bevy doesn't hand on.
    format!("{:?}", adapter.device_type) == "Cpu"
}

/// The terrain's manifest in the asset folder.
#[derive(Resource)]
pub struct TerrainPath(pub String);

fn windowed(arguments: &Arguments) -> Option<App> {
    // Bevy's window plugin panics where there is no display; that is an answer, not an accident.
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(|_| {}));
    let app = std::panic::catch_unwind(|| {
        let mut app = App::new();
        let (assets, terrain) = terrain(arguments);
        app.add_plugins(DefaultPlugins.set(AssetPlugin {
            file_path: assets,
            ..default()
        }));
        app.insert_resource(TerrainPath(terrain));
        app.insert_resource(arguments.clone());
        app.add_systems(PostStartup, place_cameras);
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
            let up = if (look - transform.translation).normalize_or_zero().y.abs() > 0.999 {
                Vec3::Z
            } else {
                Vec3::Y
            };
            transform.look_at(look, up);
        }
    }
}

/// The asset folder, and the manifest's path in it. Bakes the bundled elevation model where
/// nobody has done so yet.
fn terrain(arguments: &Arguments) -> (String, String) {
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
    let folder = assets.join("terrains/jacksboro");
    // One that another version of the crate baked is baked again.
    if TerrainManifest::read(&folder).is_err()
        && let Err(error) = bake_bundled(&assets, &folder)
    {
        eprintln!("{error}");
        std::process::exit(1);
    }
    (
        assets.to_string_lossy().into_owned(),
        "terrains/jacksboro/terrain.ron".to_owned(),
    )
}

/// Bakes the bundled elevation model into `folder`.
pub fn bake_bundled(assets: &Path, folder: &Path) -> Result<(), Box<dyn std::error::Error>> {
    eprintln!(
        "baking the bundled elevation model into {}",
        folder.display()
    );
    if let Some(parent) = folder.parent() {
        std::fs::create_dir_all(parent)?;
    }
    let source: PathBuf = assets.join("elevation/jacksboro_u16.png");
    let import_settings = ImportSettings {
        scale: Some(0.02),
        offset: Some(200.0),
        ..Default::default()
    };
    let settings = BakeSettings {
        spacing_m: Some(30.0),
        force: true,
        ..Default::default()
    };
    let mut source = import::open(&source, &import_settings)?;
    bake(&mut *source, folder, &settings, &())?;
    Ok(())
}
