//! The least that a game adds to see a terrain.

mod kit;

use bevy::prelude::*;
use bevy_tessera::TerrainPlugins;
use bevy_tessera::terrain::{Terrain, TerrainCamera};

fn main() -> AppExit {
    kit::app()
        .add_plugins(TerrainPlugins)
        .add_systems(Startup, setup)
        .run()
}

fn setup(mut commands: Commands, assets: Res<AssetServer>) {
    commands.spawn(Terrain::new(assets.load("terrains/jacksboro/terrain.ron")));
    let eye = Transform::from_xyz(12e3, 1600.0, 18e3);
    commands.spawn((
        Camera3d::default(),
        TerrainCamera::default(),
        eye.looking_at(Vec3::new(15e3, 400.0, 14e3), Vec3::Y),
    ));
    commands.spawn((
        DirectionalLight::default(),
        Transform::default().looking_to(Vec3::new(1.0, -0.7, 0.4), Vec3::Y),
    ));
}
