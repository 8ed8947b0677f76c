//! Overlays show what they say, in the colours of their legends, one at a time and over each other,
//! in every way that Bevy renders; and while none is on there is nothing of them.

mod common;
#[path = "overlays/kernels.rs"]
mod kernels;
#[path = "overlays/ways.rs"]
mod ways;
#[path = "overlays/what.rs"]
mod what;

use bevy::ecs::world::EntityWorldMut;
use bevy::prelude::*;
use bevy_tessera::bake::{BakeSettings, MemorySource, bake};
use bevy_tessera::render::{TerrainOverlay, TerrainOverlays};
use common::scene::{Scene, assets_with_hills, pixel};
use common::stage::{NOTHING, Stage};
use image::RgbImage;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

const SIZE: [u32; 2] = [192, 128];
/// Metres between the samples of all landscapes.
const SPACING_M: f32 = 2.0;

/// The asset folder: hills; level ground; ground that rises by one metre in two; and ground whose
/// western half is as rough as its eastern is plain.
fn assets() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = assets_with_hills("overlays");
        Scene::new(|_| 20.0).bake(&folder.join("plain"));
        Scene::new(|place| 0.5 * place.x).bake(&folder.join("tilted"));
        let heights = (0..385 * 321_u32)
            .map(|at| {
                let mut hash = (at ^ 0x9e37).wrapping_mul(0x85eb_ca6b);
                hash ^= hash >> 13;
                hash = hash.wrapping_mul(0xc2b2_ae35);
                let noise = (hash >> 8) as f32 / (1 << 24) as f32;
                if at % 385 < 192 {
                    20.0 + 8.0 * noise
                } else {
                    20.0
                }
            })
            .collect();
        let mut source = MemorySource::new([385, 321], heights)
            .unwrap()
            .with_spacing_m(f64::from(SPACING_M));
        bake(
            &mut source,
            &folder.join("halves"),
            &BakeSettings::default(),
            &(),
        )
        .unwrap();
        folder
    })
}

fn stage(terrain: &str) -> Stage {
    let manifest = format!("{terrain}/terrain.ron");
    Stage::new("overlays", assets(), &manifest, SIZE)
}

/// Overlays in the colours of their legends.
fn unlit(overlays: &[TerrainOverlay]) -> TerrainOverlays {
    let off = TerrainOverlays {
        lit: false,
        ..default()
    };
    overlays
        .iter()
        .fold(off, |all, overlay| all.with(*overlay, 1.0))
}

/// From the south-west over all of a landscape.
fn eye() -> Transform {
    Transform::from_xyz(130.0, 115.0, 590.0).looking_at(Vec3::new(370.0, 30.0, 310.0), Vec3::Y)
}

/// From so far outside that nothing is near.
fn afar() -> Transform {
    Transform::from_xyz(-420.0, 260.0, 320.0).looking_at(Vec3::new(380.0, 30.0, 320.0), Vec3::Y)
}

/// Straight down on `centre`, so many metres a pixel.
fn down(
    stage: &mut Stage,
    name: &str,
    centre: Vec2,
    px_m: f32,
    overlays: TerrainOverlays,
    dress: impl FnOnce(&mut EntityWorldMut),
) -> RgbImage {
    let above = Transform::from_xyz(centre.x, 400.0, centre.y).looking_to(Vec3::NEG_Y, Vec3::NEG_Z);
    stage.picture(name, above, 4, |camera: &mut EntityWorldMut| {
        let mut parallel = OrthographicProjection::default_3d();
        parallel.scale = px_m;
        camera.insert((Projection::Orthographic(parallel), overlays));
        dress(camera);
    })
}

/// The ground under the middle of a pixel of that picture.
fn place(centre: Vec2, px_m: f32, index: usize) -> Vec2 {
    let (x, y) = (index as u32 % SIZE[0], index as u32 / SIZE[0]);
    let from =
        Vec2::new(x as f32, y as f32) + 0.5 - Vec2::new(SIZE[0] as f32, SIZE[1] as f32) * 0.5;
    centre + from * px_m
}

/// The picture of a perspective camera.
fn look(
    stage: &mut Stage,
    name: &str,
    eye: Transform,
    overlays: TerrainOverlays,
    dress: impl FnOnce(&mut EntityWorldMut),
) -> RgbImage {
    stage.picture(name, eye, 4, |camera| {
        camera.insert(overlays);
        dress(camera);
    })
}

/// The bytes that a linear colour becomes.
fn encoded(color: LinearRgba) -> Vec3 {
    let channel = |linear: f32| {
        let value = if linear <= 0.003_130_8 {
            12.92 * linear
        } else {
            1.055 * linear.powf(1.0 / 2.4) - 0.055
        };
        255.0 * value
    };
    Vec3::new(
        channel(color.red),
        channel(color.green),
        channel(color.blue),
    )
}

fn difference(pixel: [u8; 3], color: LinearRgba) -> f32 {
    (Vec3::from(pixel.map(f32::from)) - encoded(color))
        .abs()
        .max_element()
}

/// Whether a pixel has the colour of a value in a legend.
fn shows(pixel: [u8; 3], overlay: TerrainOverlay, value: f32) -> bool {
    difference(pixel, overlay.legend_color(value)) < 3.0
}

/// The value whose colour in a legend a pixel has.
fn value_of(pixel: [u8; 3], overlay: TerrainOverlay) -> Option<f32> {
    let stops = overlay.legend();
    let (first, last) = (stops[0].value, stops[stops.len() - 1].value);
    // Levels are told apart, not mixed.
    let steps = if overlay == TerrainOverlay::Level {
        stops.len() as u32 - 1
    } else {
        2000
    };
    (0..=steps)
        .map(|step| first + (last - first) * step as f32 / steps as f32)
        .map(|value| (value, difference(pixel, overlay.legend_color(value))))
        .min_by(|a, b| a.1.total_cmp(&b.1))
        .filter(|(_, off)| *off < 4.0)
        .map(|(value, _)| value)
}

/// The pixels of a picture that show ground.
fn ground(picture: &RgbImage) -> Vec<[u8; 3]> {
    let ground: Vec<_> = (0..(picture.width() * picture.height()) as usize)
        .map(|index| pixel(picture, index))
        .filter(|pixel| *pixel != NOTHING)
        .collect();
    assert!(
        ground.len() > 3000,
        "only {} pixels of ground",
        ground.len()
    );
    ground
}

/// The share of the ground of which something is true.
fn share(picture: &RgbImage, says: impl Fn([u8; 3]) -> bool) -> f32 {
    let ground = ground(picture);
    let said = ground.iter().filter(|pixel| says(**pixel)).count();
    said as f32 / ground.len() as f32
}

/// The values that an overlay's picture shows, sorted; all of the ground shows some.
fn values(picture: &RgbImage, overlay: TerrainOverlay) -> Vec<f32> {
    let mut values: Vec<f32> = ground(picture)
        .into_iter()
        .map(|pixel| {
            value_of(pixel, overlay)
                .unwrap_or_else(|| panic!("{pixel:?} is no colour of {overlay:?}'s legend"))
        })
        .collect();
    values.sort_by(f32::total_cmp);
    values
}
