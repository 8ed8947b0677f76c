//! The least that a game adds to see a terrain.

mod kit;

use bevy::prelude::*;
use bevy_tessera::TerrainPlugins;
use bevy_tessera::terrain::{Terrain, TerrainCamera};

fn main() -> AppExit {
    let mut app = kit::app();
    app.add_plugins(TerrainPlugins).add_systems(Startup, setup);
    app.run()
}

fn setup(mut commands: Commands, assets: Res<AssetServer>) {
    let terrain = assets.load("terrains/jacksboro/terrain.ron");
    commands.spawn(Terrain::new(terrain));
    let eye = Transform::from_xyz(12e3, 1600.0, 18e3);
    let eye = eye.looking_to(Vec3::new(0.6, -0.25, -0.8), Vec3::Y);
    commands.spawn((Camera3d::default(), TerrainCamera::default(), eye));
    let sun = Transform::default().looking_to(Vec3::new(1.0, -0.7, 0.4), Vec3::Y);
    commands.spawn((DirectionalLight::default(), sun));
}
