//! Terrains are drawn alike on a device with WebGPU's limits only and on a generous one, with
//! rendering pipelined or not, by several cameras at once, and again after the device was lost;
//! and what is hidden or despawned is not drawn and keeps nothing.

mod common;

use bevy::core_pipeline::prepass::{DeferredPrepass, DepthPrepass};
use bevy::prelude::*;
use bevy::render::RenderApp;
use bevy::render::error_handler::{ErrorType, RenderErrorHandler, RenderErrorPolicy};
use bevy::render::render_resource::PollType;
use bevy::render::renderer::RenderDevice;
use bevy::render::settings::{WgpuSettings, WgpuSettingsPriority};
use bevy_tessera::render::GpuTerrainMeshes;
use bevy_tessera::stream::{TerrainState, TilePage};
use bevy_tessera::terrain::TerrainCamera;
use common::app;
use common::scene::{Scene, assets_with_hills, hills, mean_difference, two_cascades};
use common::stage::{NOTHING, Stage, bare_camera, covered};
use image::RgbImage;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};

const SIZE: [u32; 2] = [192, 128];
const TERRAIN: &str = "hills/terrain.ron";

fn assets() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| assets_with_hills("devices"))
}

fn eye() -> Transform {
    Transform::from_xyz(130.0, 115.0, 590.0).looking_at(Vec3::new(370.0, 30.0, 310.0), Vec3::Y)
}

fn sunlight() -> impl Bundle {
    (
        DirectionalLight {
            illuminance: 12_000.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::from_xyz(0.75, 0.38, 0.45).looking_at(Vec3::ZERO, Vec3::Y),
        two_cascades(),
    )
}

fn lamp() -> impl Bundle {
    (
        PointLight {
            intensity: 4.0e8,
            range: 900.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::from_xyz(330.0, 62.0, 262.0),
    )
}

fn plain() -> Stage {
    Stage::new("devices", assets(), TERRAIN, SIZE)
}

fn share_covered(picture: &RgbImage) -> f32 {
    let covered = covered(picture);
    covered.iter().filter(|covered| **covered).count() as f32 / covered.len() as f32
}

/// A close look at ground in the shadow of a hill that stands behind the camera: it lies before
/// the near plane of the light's only cascade.
fn lee() -> Transform {
    Transform::from_xyz(335.0, 58.0, 235.0).looking_at(Vec3::new(305.0, 30.0, 215.0), Vec3::Y)
}

fn near_cascade() -> impl Bundle {
    bevy::light::CascadeShadowConfigBuilder {
        num_cascades: 1,
        maximum_distance: 80.0,
        ..default()
    }
    .build()
}

/// Pictures of the same places with shadows of two kinds: forward, deferred, and close.
fn series(stage: &mut Stage, name: &str) -> [RgbImage; 3] {
    let sun = stage.prop(sunlight());
    let lamp = stage.prop(lamp());
    let forward = stage.picture(&format!("{name}_forward"), eye(), 1, |camera| {
        camera.insert(Msaa::Sample4);
    });
    let deferred = stage.picture(&format!("{name}_deferred"), eye(), 1, |camera| {
        camera.insert((DepthPrepass, DeferredPrepass));
    });
    stage
        .app
        .world_mut()
        .entity_mut(lamp)
        .insert(Visibility::Hidden);
    stage.app.world_mut().entity_mut(sun).insert(near_cascade());
    let close = stage.picture(&format!("{name}_close"), lee(), 1, |_| {});
    let mut light = stage
        .app
        .world_mut()
        .get_mut::<DirectionalLight>(sun)
        .unwrap();
    light.shadow_maps_enabled = false;
    let lit = stage.picture(&format!("{name}_close_lit"), lee(), 1, |_| {});
    let shade = mean_difference(&close, &lit);
    assert!(shade > 30.0, "{name}: the hill throws no shadow: {shade}");
    stage.clear();
    [forward, deferred, close]
}

fn assert_alike(a: &[RgbImage; 3], b: &[RgbImage; 3]) {
    for (a, b) in a.iter().zip(b) {
        assert!(share_covered(a) > 0.5);
        let mean = mean_difference(a, b);
        assert!(mean < 0.2, "{mean}");
    }
}

#[test]
fn a_device_with_the_limits_of_webgpu_draws_the_same() {
    let settings = WgpuSettings {
        priority: WgpuSettingsPriority::WebGPU,
        ..default()
    };
    let mut webgpu = Stage::with("devices", assets(), TERRAIN, SIZE, false, settings, |_| {});
    let device = webgpu
        .app
        .sub_app(RenderApp)
        .world()
        .resource::<RenderDevice>();
    assert_eq!(device.limits().max_storage_buffers_per_shader_stage, 8);
    // There, depth is unclipped for the casters behind a light by the shader.
    let features = device.features();
    assert!(!features.contains(bevy::render::settings::WgpuFeatures::DEPTH_CLIP_CONTROL));
    let narrow = series(&mut webgpu, "webgpu");
    drop(webgpu);
    let wide = series(&mut plain(), "native");
    assert_alike(&narrow, &wide);
}

#[test]
fn pipelined_rendering_draws_the_same() {
    let mut stage = Stage::with("devices", assets(), TERRAIN, SIZE, true, default(), |_| {});
    let pipelined = series(&mut stage, "pipelined");
    drop(stage);
    assert_alike(&pipelined, &series(&mut plain(), "sequential"));
}

#[test]
fn cameras_see_terrains_each_in_its_own_way() {
    let mut stage = plain();
    stage.prop(sunlight());
    let fine = stage.picture("camera_alone", eye(), 1, |_| {});

    let [second, third] = [0, 1].map(|_| app::target(&mut stage.app, SIZE[0], SIZE[1]));
    let elsewhere =
        Transform::from_xyz(600.0, 200.0, 60.0).looking_at(Vec3::new(380.0, 30.0, 320.0), Vec3::Y);
    let coarse = TerrainCamera {
        triangle_width_px: 64.0,
        max_factor: 1.0,
        ..default()
    };
    let other = stage
        .app
        .world_mut()
        .spawn((bare_camera(elsewhere, &second), coarse.clone()))
        .id();
    // One that doesn't ask for terrains sees none.
    stage.app.world_mut().spawn(bare_camera(eye(), &third));

    let beside = stage.shoot("camera_one", 1);
    assert!(mean_difference(&fine, &beside) < 0.1);
    let meshes = stage
        .app
        .sub_app(RenderApp)
        .world()
        .resource::<GpuTerrainMeshes>();
    let mesh = |camera| meshes.get(camera, stage.terrain).unwrap();
    let first = mesh(stage.camera.unwrap()).uniform();
    assert_eq!(mesh(other).uniform().max_factor, 1.0);
    assert!(first.max_factor > 1.0 && first.eye != mesh(other).uniform().eye);

    let seen = app::picture(&mut stage.app, &second);
    stage.save("camera_two", &seen);
    let nothing = app::picture(&mut stage.app, &third);
    assert!(nothing.pixels().all(|pixel| pixel.0 == NOTHING));

    // The second sees what it sees alone.
    let first = stage.camera.unwrap();
    stage.app.world_mut().despawn(first);
    stage.camera = None;
    stage.target = second;
    let alone = stage.shoot("camera_two_alone", 1);
    assert!(share_covered(&alone) > 0.5);
    assert!(mean_difference(&seen, &alone) < 0.1);
}

#[test]
fn what_is_hidden_or_despawned_is_not_drawn() {
    let mut stage = plain();
    stage.prop(sunlight());
    stage.boxes(&Scene {
        boxes: vec![(Vec3::new(280.0, 20.0, 400.0), Vec3::new(310.0, 60.0, 430.0))],
        ..Scene::new(hills)
    });
    let all = stage.picture("shown", eye(), 1, |_| {});
    let terrain = stage.terrain;
    stage
        .app
        .world_mut()
        .entity_mut(terrain)
        .insert(Visibility::Hidden);
    let hidden = stage.shoot("hidden", 1);
    let left = share_covered(&hidden);
    assert!(left > 0.005 && left < 0.1, "only the box is left: {left}");
    // Nor does it throw a shadow on the box, or keep a mesh.
    let meshes = |stage: &Stage| {
        let meshes = stage
            .app
            .sub_app(RenderApp)
            .world()
            .resource::<GpuTerrainMeshes>();
        meshes.get(stage.camera.unwrap(), terrain).is_some()
    };
    assert!(!meshes(&stage));
    stage
        .app
        .world_mut()
        .entity_mut(terrain)
        .insert(Visibility::Inherited);
    let again = stage.shoot("shown_again", 1);
    assert_eq!(all, again);
    assert!(meshes(&stage));

    stage.app.world_mut().despawn(terrain);
    let despawned = stage.shoot("despawned", 1);
    assert_eq!(hidden, despawned);
    assert!(!meshes(&stage));
    let mut tiles = stage.app.world_mut().query::<&TilePage>();
    assert_eq!(tiles.iter(stage.app.world()).count(), 0);
    let mut states = stage.app.world_mut().query::<&TerrainState>();
    assert_eq!(states.iter(stage.app.world()).count(), 0);

    // Another one in its place, from the same manifest.
    let manifest = stage.app.world().resource::<AssetServer>().load(TERRAIN);
    stage.terrain = stage
        .app
        .world_mut()
        .spawn(bevy_tessera::terrain::Terrain::new(manifest))
        .id();
    let replaced = stage.shoot("replaced", 1);
    assert!(mean_difference(&all, &replaced) < 0.1);
}

/// Devices that were lost so far.
static LOST: AtomicU32 = AtomicU32::new(0);

#[test]
fn a_lost_device_recovers_with_the_terrain() {
    let mut stage = plain();
    stage.app.insert_resource(RenderErrorHandler(|error, _, _| {
        if error.ty == ErrorType::DeviceLost {
            LOST.fetch_add(1, Ordering::SeqCst);
        }
        RenderErrorPolicy::Recover(default())
    }));
    let before = series(&mut stage, "lost_before");
    stage.aim(eye(), |_| {});
    for round in 1..=2 {
        let device = stage
            .app
            .sub_app(RenderApp)
            .world()
            .resource::<RenderDevice>()
            .clone();
        // Bevy reads its own buffers back meanwhile; what is still on its way must arrive first.
        let _ = device.poll(PollType::wait_indefinitely());
        device.wgpu_device().destroy();
        let _ = device.poll(PollType::wait_indefinitely());
        drop(device);
        for _ in 0..20 {
            stage.app.update();
        }
        assert_eq!(LOST.load(Ordering::SeqCst), round);
        let after = series(&mut stage, &format!("lost_after_{round}"));
        assert_alike(&before, &after);
    }
}
