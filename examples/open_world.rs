//! A real landscape to fly over: the Jacksboro fault in Tennessee, with sun, shadows and
//! atmosphere.
//!
//! ```sh
//! cargo run --release --features examples --example open_world
//! ```
//!
//! Right mouse button to look, W A S D Q E to fly, shift to hurry, the wheel for the speed; F3 opens
//! the terrain's panel.

mod kit;

use bevy::camera::Exposure;
use bevy::camera_controller::free_camera::{FreeCamera, FreeCameraPlugin};
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::light::atmosphere::ScatteringMedium;
use bevy::light::light_consts::lux;
use bevy::light::{Atmosphere, AtmosphereEnvironmentMapLight, CascadeShadowConfigBuilder};
use bevy::pbr::{AtmosphereSettings, DistanceFog, FogFalloff};
use bevy::prelude::*;
use bevy::render::renderer::RenderAdapterInfo;
use bevy_tessera::TerrainPlugins;
use bevy_tessera::detail::{DetailRule, TerrainDetail};
use bevy_tessera::render::{TerrainComparison, TerrainDensityPreview};
use bevy_tessera::terrain::{Terrain, TerrainCamera, TerrainSettings, TessellationPolicy};

/// Where the sun's light comes from.
const SUN: Vec3 = Vec3::new(-1.0, 0.42, 0.35);

fn main() -> AppExit {
    let mut app = kit::app();
    app.add_plugins((TerrainPlugins, FreeCameraPlugin))
        .insert_resource(GlobalAmbientLight::NONE)
        .add_systems(Startup, (setup, setup_sky).chain())
        .add_systems(Update, kit::step_beside);
    kit::add_panel(&mut app);
    app.run()
}

fn setup(
    mut commands: Commands,
    assets: Res<AssetServer>,
    terrain: Res<kit::TerrainPath>,
    arguments: Res<kit::Arguments>,
) {
    let mut terrain = commands.spawn((
        Name::new("landscape"),
        Terrain::new(assets.load(terrain.0.clone())),
    ));
    if let Some(amplitude_m) = arguments.detail_m {
        terrain.insert((
            TerrainDetail {
                amplitude_m,
                wavelength_m: 16.0 * amplitude_m,
                octaves: 8,
                rule: DetailRule::Everywhere,
                ..default()
            },
            // Nodes finer than the finest tiles, for the ground at the eye's feet.
            TerrainSettings {
                leaf_level: -5,
                ..default()
            },
        ));
    }
    if let Some(gain) = arguments.density_gain {
        let mut preview = TerrainDensityPreview::default();
        preview.settings.gain = gain;
        terrain.insert(preview);
    }
    let mut camera = TerrainCamera::default();
    if let Some(max_px) = arguments.max_error_px {
        camera.policy = TessellationPolicy::ScreenError { max_px };
    }
    if let Some(width_px) = arguments.triangle_px {
        camera.triangle_width_px = width_px;
    }
    let comparison = arguments.compare.map(|view| TerrainComparison {
        other: TerrainCamera {
            density: 0.0,
            ..camera.clone()
        },
        view,
    });
    let camera = (
        Name::new("fly camera"),
        camera,
        FreeCamera {
            walk_speed: 200.0,
            run_speed: 1500.0,
            ..default()
        },
        Camera3d::default(),
        Projection::from(PerspectiveProjection {
            far: 100_000.0,
            ..default()
        }),
        Transform::from_xyz(9_600.0, 1_450.0, 17_900.0)
            .looking_at(Vec3::new(14_500.0, 350.0, 12_600.0), Vec3::Y),
        Tonemapping::AcesFitted,
    );
    let mut camera = commands.spawn(camera);
    if let Some(comparison) = comparison {
        camera.insert(comparison);
    }
    commands.spawn((
        DirectionalLight {
            shadow_maps_enabled: true,
            illuminance: lux::RAW_SUNLIGHT,
            ..default()
        },
        Transform::from_translation(SUN).looking_at(Vec3::ZERO, Vec3::Y),
        CascadeShadowConfigBuilder {
            num_cascades: 4,
            first_cascade_far_bound: 900.0,
            maximum_distance: 20_000.0,
            ..default()
        }
        .build(),
    ));
}

/// Bevy's atmosphere; on a software renderer, which takes minutes for it where it survives it, a
/// plain sky with haze.
#[expect(clippy::too_many_arguments, reason = "parameters of a Bevy system")]
fn setup_sky(
    mut commands: Commands,
    adapter: Res<RenderAdapterInfo>,
    arguments: Res<kit::Arguments>,
    cameras: Query<Entity, With<Camera3d>>,
    mut suns: Query<&mut DirectionalLight>,
    mut media: ResMut<Assets<ScatteringMedium>>,
    mut ambient: ResMut<GlobalAmbientLight>,
    mut sky: ResMut<ClearColor>,
) {
    if !kit::is_software(&adapter) || arguments.atmosphere {
        commands.spawn(Atmosphere::earth(
            media.add(ScatteringMedium::earth(256, 256)),
        ));
        for camera in &cameras {
            commands.entity(camera).insert((
                AtmosphereSettings::default(),
                AtmosphereEnvironmentMapLight::default(),
                Exposure { ev100: 13.0 },
            ));
        }
        return;
    }
    info!("drawing a plain sky on this software renderer; --atmosphere draws Bevy's");
    sky.0 = Color::srgb(0.62, 0.74, 0.87);
    *ambient = GlobalAmbientLight {
        color: Color::srgb(0.75, 0.85, 1.0),
        brightness: 9_000.0,
        ..default()
    };
    for mut sun in &mut suns {
        sun.illuminance = lux::FULL_DAYLIGHT * 2.5;
    }
    for camera in &cameras {
        commands.entity(camera).insert((
            DistanceFog {
                color: sky.0,
                falloff: FogFalloff::from_visibility_squared(70_000.0),
                ..default()
            },
            Exposure { ev100: 13.0 },
        ));
    }
}
