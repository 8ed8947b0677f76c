//! A real landscape to fly over: the Jacksboro fault in Tennessee, with sun, shadows and
//! atmosphere.
//!
//! ```sh
//! cargo run --release --features examples --example open_world
//! ```
//!
//! Right mouse button to look, W A S D Q E to fly, shift to hurry, the wheel for the speed.

mod kit;

use bevy::camera::Exposure;
use bevy::camera_controller::free_camera::{FreeCamera, FreeCameraPlugin};
use bevy::core_pipeline::tonemapping::Tonemapping;
use bevy::light::atmosphere::ScatteringMedium;
use bevy::light::light_consts::lux;
use bevy::light::{Atmosphere, CascadeShadowConfigBuilder};
use bevy::pbr::AtmosphereSettings;
use bevy::prelude::*;
use bevy_tessera::TerrainPlugins;
use bevy_tessera::terrain::{Terrain, TerrainCamera};

fn main() -> AppExit {
    kit::app()
        .add_plugins((TerrainPlugins, FreeCameraPlugin))
        .insert_resource(GlobalAmbientLight::NONE)
        .add_systems(Startup, setup)
        .run()
}

fn setup(
    mut commands: Commands,
    assets: Res<AssetServer>,
    terrain: Res<kit::TerrainPath>,
    mut media: ResMut<Assets<ScatteringMedium>>,
) {
    let _=(&assets,&terrain);
    commands.spawn((
        TerrainCamera::default(),
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
        Transform::from_xyz(13_500.0, 1250.0, 20_500.0)
            .looking_at(Vec3::new(16_500.0, 500.0, 14_000.0), Vec3::Y),
        AtmosphereSettings{ rendering_method: if std::env::var("RAY").is_ok() {bevy::pbr::AtmosphereMode::Raymarched} else {bevy::pbr::AtmosphereMode::LookupTexture}, ..default()},
        if std::env::var("NOMSAA").is_ok() {Msaa::Off} else {Msaa::Sample4},
        Exposure { ev100: 13.0 },
        Tonemapping::AcesFitted,
    ));
    commands.spawn(Atmosphere::earth(media.add(ScatteringMedium::earth(256, 256))));
    commands.spawn((
        DirectionalLight {
            shadow_maps_enabled: std::env::var("NOSH").is_err(),
            illuminance: lux::RAW_SUNLIGHT,
            ..default()
        },
        Transform::from_xyz(-1.0, 0.42, 0.35).looking_at(Vec3::ZERO, Vec3::Y),
        CascadeShadowConfigBuilder {
            num_cascades: 4,
            first_cascade_far_bound: 600.0,
            maximum_distance: 16_000.0,
            ..default()
        }
        .build(),
    ));
}
