//! Shadows of all kinds of light fall where a ray towards the light is blocked, on the ground and
//! from the ground.

use super::common::scene::{Light, Scene, covered_around, interior, linear, pixel};
use super::common::stage::Stage;
use super::{SIZE, busy, empty, eye, stage, sun, sunlight};
use bevy::core_pipeline::prepass::{DeferredPrepass, DepthPrepass};
use bevy::ecs::world::EntityWorldMut;
use bevy::prelude::*;
use image::RgbImage;

/// Where the lamp stands: between the cubes and the hills, or behind a hill.
const LAMPS: [Vec3; 2] = [Vec3::new(330.0, 62.0, 262.0), Vec3::new(510.0, 95.0, 195.0)];

fn lamp(place: usize, shadow_maps_enabled: bool) -> impl Bundle {
    (
        PointLight {
            intensity: 1.5e9,
            range: 900.0,
            shadow_maps_enabled,
            ..default()
        },
        Transform::from_translation(LAMPS[place]),
    )
}

fn spot(place: usize, shadow_maps_enabled: bool) -> impl Bundle {
    (
        SpotLight {
            intensity: 1.5e9,
            range: 900.0,
            shadow_maps_enabled,
            outer_angle: 0.9,
            inner_angle: 0.8,
            ..default()
        },
        Transform::from_translation(LAMPS[place])
            .looking_at(Vec3::new(260.0, 30.0, 440.0), Vec3::Y),
    )
}

/// Pictures without the light, with it, and with its shadows.
fn three<B: Bundle>(
    stage: &mut Stage,
    scene: &Scene,
    name: &str,
    light: impl Fn(bool) -> B,
    dress: fn(&mut EntityWorldMut),
) -> [RgbImage; 3] {
    stage.boxes(scene);
    let dark = stage.picture(&format!("{name}_dark"), eye(), 1, dress);
    let entity = stage.app.world_mut().spawn(light(false)).id();
    let open = stage.picture(&format!("{name}_without"), eye(), 1, dress);
    stage.app.world_mut().despawn(entity);
    let entity = stage.app.world_mut().spawn(light(true)).id();
    let shadowed = stage.picture(&format!("{name}_shadows"), eye(), 1, dress);
    stage.app.world_mut().despawn(entity);
    stage.clear();
    [dark, open, shadowed]
}

fn assert_shadows(scene: &Scene, pictures: &[RgbImage; 3], light: Light, name: &str) {
    let hits = scene.look(&eye(), SIZE);
    let expected: Vec<Option<bool>> = hits
        .iter()
        .map(|hit| hit.map(|hit| scene.in_shadow(&hit, light)))
        .collect();
    let [dark, open, shadowed] = pictures;
    let (mut right, mut missing, mut acne) = ([0, 0], 0, 0);
    for index in interior(SIZE, |index| expected[index]) {
        let (Some(hit), Some(in_shadow)) = (hits[index], expected[index]) else {
            continue;
        };
        if !hit.on_ground || !covered_around(&hits, SIZE, index, 40.0) {
            continue;
        }
        if scene.normal(hit.point).dot(light.towards(hit.point)) < 0.15 {
            continue;
        }
        let [dark, open, shadowed] =
            [dark, open, shadowed].map(|picture| linear(pixel(picture, index)).element_sum());
        let lit = open - dark;
        if lit < 0.02 {
            continue;
        }
        let is_shadowed = (shadowed - dark) / lit < 0.5;
        match (in_shadow, is_shadowed) {
            (true, false) => missing += 1,
            (false, true) => acne += 1,
            (known, _) => right[usize::from(known)] += 1,
        }
    }
    let [lit, shaded] = right;
    eprintln!("{name}: {lit} lit, {shaded} shaded, {missing} shadows missing, {acne} too many");
    assert!(
        lit > 300 && shaded > 150,
        "{name}: {lit} lit, {shaded} shaded"
    );
    assert!(
        missing * 25 < shaded,
        "{name}: {missing} missing of {shaded}"
    );
    assert!(acne * 50 < lit, "{name}: {acne} too many of {lit}");
}

fn every_shadow(scene: &Scene, kind: &str, place: usize) {
    let mut stage = stage();
    let plain: fn(&mut EntityWorldMut) = |_| {};
    let deferred: fn(&mut EntityWorldMut) = |camera| {
        camera.insert((DepthPrepass, DeferredPrepass));
    };
    for (camera, dress) in [("forward", plain), ("deferred", deferred)] {
        let name = format!("{kind}_{camera}_sun");
        let pictures = three(&mut stage, scene, &name, sunlight, dress);
        assert_shadows(scene, &pictures, Light::Sun(sun()), &name);
    }
    let name = format!("{kind}_lamp");
    let pictures = three(
        &mut stage,
        scene,
        &name,
        |shadows| lamp(place, shadows),
        plain,
    );
    assert_shadows(scene, &pictures, Light::Lamp(LAMPS[place]), &name);
    let name = format!("{kind}_spot");
    let pictures = three(
        &mut stage,
        scene,
        &name,
        |shadows| spot(place, shadows),
        plain,
    );
    assert_shadows(scene, &pictures, Light::Lamp(LAMPS[place]), &name);
}

#[test]
fn the_ground_shades_itself() {
    every_shadow(&empty(), "alone", 1);
}

#[test]
fn the_ground_shades_and_is_shaded_among_meshes() {
    every_shadow(&busy(), "busy", 0);
}
