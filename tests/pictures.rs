//! Bevy's own rendering takes terrains as they are: with every prepass, forward and deferred,
//! with every anti-aliasing, ambient occlusion, fog and all kinds of shadows, in a scene that has
//! nothing else and in one with meshes, the terrain is where a ray says that it is, and looks like
//! it does without.

mod common;
#[path = "pictures/passes.rs"]
mod passes;
#[path = "pictures/prepasses.rs"]
mod prepasses;
#[path = "pictures/shadows.rs"]
mod shadows;

use bevy::prelude::*;
use common::scene::{Scene, assets_with_hills, hills, two_cascades};
use common::stage::Stage;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// Size of all pictures.
const SIZE: [u32; 2] = [224, 144];

/// The asset folder with the baked landscape.
fn assets() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| assets_with_hills("pictures"))
}

fn stage() -> Stage {
    Stage::new("pictures", assets(), "hills/terrain.ron", SIZE)
}

fn empty() -> Scene {
    Scene::new(hills)
}

/// The landscape with cubes that stand in it.
fn busy() -> Scene {
    let mut scene = Scene::new(hills);
    for (x, z, side) in [
        (300.0, 420.0, 22.0),
        (240.0, 360.0, 14.0),
        (340.0, 350.0, 26.0),
        (200.0, 450.0, 9.0),
        (430.0, 290.0, 16.0),
    ] {
        let middle = scene.ground(x, z) + Vec3::Y * 0.4 * side;
        let half = Vec3::splat(0.5 * side);
        scene.boxes.push((middle - half, middle + half));
    }
    scene
}

fn eye() -> Transform {
    Transform::from_xyz(130.0, 115.0, 590.0).looking_at(Vec3::new(370.0, 30.0, 310.0), Vec3::Y)
}

/// Where the sun stands.
fn sun() -> Vec3 {
    Vec3::new(0.75, 0.38, 0.45).normalize()
}

fn sunlight(shadow_maps_enabled: bool) -> impl Bundle {
    (
        DirectionalLight {
            illuminance: 12_000.0,
            shadow_maps_enabled,
            ..default()
        },
        Transform::default().looking_to(-sun(), Vec3::Y),
        two_cascades(),
    )
}
