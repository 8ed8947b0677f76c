//! Scorch is drawn where the mask has it and nowhere else, as its CPU twin reads it, near and far;
//! it goes when it is undone, and comes back after the device was lost.

mod common;

use bevy::core_pipeline::prepass::{DeferredPrepass, DepthPrepass};
use bevy::ecs::world::EntityWorldMut;
use bevy::math::DVec2;
use bevy::prelude::*;
use bevy::render::RenderApp;
use bevy::render::error_handler::{ErrorType, RenderErrorHandler, RenderErrorPolicy};
use bevy::render::render_resource::PollType;
use bevy::render::renderer::RenderDevice;
use bevy::render::settings::{WgpuSettings, WgpuSettingsPriority};
use bevy::shader::Shader;
use bevy_tessera::edit::mask::{DestructionMask, MaskSettings, TerrainMask};
use bevy_tessera::edit::{Change, EDIT_UNITS, Edit, MAX_REACH};
use bevy_tessera::render::TerrainMaterial;
use common::app;
use common::scene::{
    Scene, assets_with_hills, brightness, covered_around, hills, mean_difference, pixel, ramp,
};
use common::stage::Stage;
use image::RgbImage;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use std::sync::atomic::{AtomicU32, Ordering};

const SIZE: [u32; 2] = [192, 128];
const SCORCH: &str = include_str!("mask/scorch.wgsl");
/// Of the baked landscapes.
const SPACING_M: f64 = 2.0;

fn assets() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = assets_with_hills("mask");
        Scene::new(ramp).bake(&folder.join("ramp"));
        folder
    })
}

fn crater(at_m: [f64; 2], reach_m: f64, seed: u32) -> Edit {
    let units = |metres: f64| (metres / SPACING_M * f64::from(EDIT_UNITS)).round();
    Edit {
        centre: at_m.map(|at| units(at) as i32),
        reach: (units(reach_m) as u32).min(MAX_REACH),
        change: Change::Crater {
            depth: 100,
            rim: 30,
            bowl: 43_690,
            roughness: 64,
            seed,
            density: 255,
            scorch: 255,
            may_clamp: false,
        },
    }
}

/// Craters on borders and corners of pages, which are 16 m wide, and one in a coarser layer.
fn craters() -> Vec<Edit> {
    vec![
        crater([208.0, 304.0], 7.0, 1),
        crater([200.0, 297.0], 3.0, 2),
        crater([192.0, 309.5], 5.0, 3),
        crater([330.0, 240.0], 24.0, 4),
        crater([120.0, 200.0], 110.0, 5),
    ]
}

fn sunlight() -> impl Bundle {
    (
        DirectionalLight {
            illuminance: 12_000.0,
            ..default()
        },
        Transform::from_xyz(0.75, 0.6, 0.45).looking_at(Vec3::ZERO, Vec3::Y),
    )
}

/// The stage, with the terrain streamed in and a mask on it.
fn stage_on(terrain: &str, settings: WgpuSettings) -> Stage {
    let manifest = format!("{terrain}/terrain.ron");
    let mut stage = Stage::with("mask", assets(), &manifest, SIZE, false, settings, |_| {});
    stage.aim(eye(), |_| {});
    app::settle(&mut stage.app, 2000);
    stage.app.update();
    stage
}

fn stage(terrain: &str) -> Stage {
    stage_on(terrain, default())
}

fn eye() -> Transform {
    Transform::from_xyz(250.0, 90.0, 430.0).looking_at(Vec3::new(215.0, 30.0, 300.0), Vec3::Y)
}

/// A close look at craters.
fn near() -> Transform {
    Transform::from_xyz(228.0, 58.0, 338.0).looking_at(Vec3::new(204.0, 33.0, 303.0), Vec3::Y)
}

fn mask(stage: &mut Stage) -> Mut<'_, TerrainMask> {
    let terrain = stage.terrain;
    let world = stage.app.world_mut();
    world
        .get_mut::<TerrainMask>(terrain)
        .expect("a terrain that is drawn has a mask")
}

fn show_scorch(stage: &mut Stage) {
    let shader = Shader::from_wgsl(SCORCH, "scorch.wgsl");
    let mut shaders = stage.app.world_mut().resource_mut::<Assets<Shader>>();
    let shader = shaders.add(shader);
    let terrain = stage.terrain;
    stage
        .app
        .world_mut()
        .entity_mut(terrain)
        .insert(TerrainMaterial {
            shader: Some(shader),
            ..default()
        });
}

/// Straight down on `centre`, so many metres a pixel.
fn down(stage: &mut Stage, name: &str, centre: Vec2, px_m: f32) -> RgbImage {
    let above = Transform::from_xyz(centre.x, 400.0, centre.y).looking_to(Vec3::NEG_Y, Vec3::NEG_Z);
    stage.picture(name, above, 1, |camera: &mut EntityWorldMut| {
        let mut parallel = OrthographicProjection::default_3d();
        parallel.scale = px_m;
        camera.insert(Projection::Orthographic(parallel));
    })
}

/// The ground under the middle of a pixel of that picture.
fn place(centre: Vec2, px_m: f32, index: usize) -> DVec2 {
    let (x, y) = (index as u32 % SIZE[0], index as u32 / SIZE[0]);
    let from = DVec2::new(f64::from(x), f64::from(y)) + 0.5
        - DVec2::new(f64::from(SIZE[0]), f64::from(SIZE[1])) * 0.5;
    centre.as_dvec2() + from * f64::from(px_m)
}

/// The byte that a linear value becomes.
fn encoded(linear: f32) -> f32 {
    let value = if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    };
    255.0 * value
}

/// The most by which a picture of scorch differs from the twin, in bytes, and how much scorch it sees.
fn compare(picture: &RgbImage, mask: &DestructionMask, centre: Vec2, px_m: f32) -> (f32, f32) {
    let (mut worst, mut seen) = (0.0_f32, 0.0);
    for index in 0..(SIZE[0] * SIZE[1]) as usize {
        let strength = mask.strength_at(place(centre, px_m, index), px_m);
        let drawn = f32::from(pixel(picture, index)[0]);
        worst = worst.max((drawn - encoded(strength)).abs());
        seen += strength;
    }
    (worst, seen)
}

#[test]
fn the_shader_reads_the_mask_as_its_twin_does() {
    let mut stage = stage("ramp");
    show_scorch(&mut stage);
    for edit in craters() {
        mask(&mut stage).apply(&edit);
    }
    assert_eq!(mask(&mut stage).mask().layers(), 0b11);
    for (name, centre, px_m) in [
        ("twin_texels", Vec2::new(203.3, 303.1), 0.11),
        ("twin_mips", Vec2::new(203.3, 303.1), 0.37),
        ("twin_pages", Vec2::new(250.0, 270.0), 1.3),
        ("twin_far", Vec2::new(300.0, 300.0), 2.9),
    ] {
        let picture = down(&mut stage, name, centre, px_m);
        let (worst, seen) = compare(&picture, mask(&mut stage).mask(), centre, px_m);
        eprintln!("{name}: off by {worst} of 255");
        assert!(seen > 100.0, "{name}: {seen}");
        assert!(worst < 2.5, "{name}: {worst}");
    }
}

#[test]
fn scorched_ground_is_dark_and_the_rest_as_it_was() {
    for (way, deferred) in [("forward", false), ("deferred", true)] {
        let mut stage = stage("hills");
        stage.prop(sunlight());
        let dress = move |camera: &mut EntityWorldMut| {
            if deferred {
                camera.insert((DepthPrepass, DeferredPrepass));
            }
        };
        let before = stage.picture(&format!("before_{way}"), near(), 1, dress);
        for edit in &craters()[..4] {
            mask(&mut stage).apply(edit);
        }
        let after = stage.picture(&format!("after_{way}"), near(), 1, dress);
        let scene = Scene::new(hills);
        let hits = scene.look(&near(), SIZE);
        let (mut scorched, mut others) = (0, 0);
        for (index, hit) in hits.iter().enumerate() {
            let Some(hit) = hit.filter(|_| covered_around(&hits, SIZE, index, 8.0)) else {
                continue;
            };
            let at = DVec2::new(f64::from(hit.point.x), f64::from(hit.point.z));
            let mask = mask(&mut stage);
            let around = [DVec2::X, DVec2::NEG_X, DVec2::Y, DVec2::NEG_Y];
            let is_dark = around
                .iter()
                .all(|along| mask.mask().strength_at(at + along, 0.0) > 0.95);
            // Pixels see further along the ground than across.
            let wide = mask.mask().strength_at(at, 0.06 * hit.distance);
            let (was, is) = (pixel(&before, index), pixel(&after, index));
            if is_dark {
                scorched += 1;
                assert!(
                    brightness(is) < 0.62 * brightness(was),
                    "{at}: {was:?} {is:?}"
                );
            } else if wide == 0.0 {
                others += 1;
                assert_eq!(was, is, "{at}");
            }
        }
        assert!(scorched > 50 && others > 5000, "{scorched} {others}");

        // Undone, it is as if it had never been.
        for edit in &craters()[..4] {
            mask(&mut stage).rebuild(edit.rect(), []);
        }
        assert!(mask(&mut stage).mask().is_empty());
        let undone = stage.picture(&format!("undone_{way}"), near(), 1, dress);
        assert_eq!(before, undone);
        // And done again, in one go.
        mask(&mut stage).rebuild_all(&craters()[..4]);
        let again = stage.picture(&format!("again_{way}"), near(), 1, dress);
        assert_eq!(after, again);
    }
}

#[test]
fn what_is_drawn_later_joins_what_the_gpu_has() {
    let mut stage = stage("ramp");
    show_scorch(&mut stage);
    let centre = Vec2::new(250.0, 270.0);
    // The buffer grows twice, its table is made larger, and then half of it goes.
    let many: Vec<Edit> = (0..60)
        .map(|at| {
            let place = [
                f64::from(at * 37 % 200) + 150.0,
                f64::from(at * 71 % 130) + 205.0,
            ];
            crater(place, 3.0 + f64::from(at % 9), at)
        })
        .collect();
    for (step, some) in many.chunks(12).enumerate() {
        for edit in some {
            mask(&mut stage).apply(edit);
        }
        let picture = down(&mut stage, &format!("joins_{step}"), centre, 1.1);
        let (worst, seen) = compare(&picture, mask(&mut stage).mask(), centre, 1.1);
        assert!(seen > 100.0 && worst < 2.5, "{step}: {worst} {seen}");
    }
    for edit in &many[..50] {
        let left = many[50..].iter();
        mask(&mut stage).rebuild(edit.rect(), left);
    }
    let picture = down(&mut stage, "joins_undone", centre, 1.1);
    let (worst, seen) = compare(&picture, mask(&mut stage).mask(), centre, 1.1);
    assert!(seen > 50.0 && worst < 2.5, "{worst} {seen}");
}

#[test]
fn a_device_with_the_limits_of_webgpu_draws_the_same_scorch() {
    let mut pictures = Vec::new();
    for (name, priority) in [
        ("webgpu", WgpuSettingsPriority::WebGPU),
        ("native", WgpuSettingsPriority::Functionality),
    ] {
        let settings = WgpuSettings {
            priority,
            ..default()
        };
        let mut stage = stage_on("hills", settings);
        stage.prop(sunlight());
        for edit in craters() {
            mask(&mut stage).apply(&edit);
        }
        pictures.push(stage.picture(name, eye(), 1, |_| {}));
    }
    assert!(mean_difference(&pictures[0], &pictures[1]) < 0.2);
}

#[test]
fn a_mask_is_made_anew_where_its_settings_change() {
    let mut stage = stage("ramp");
    mask(&mut stage).apply(&craters()[0]);
    let first = mask(&mut stage).instance();
    let terrain = stage.terrain;
    stage
        .app
        .world_mut()
        .entity_mut(terrain)
        .insert(MaskSettings {
            texels_per_m: 1.0,
            ..default()
        });
    stage.app.update();
    let now = mask(&mut stage);
    assert_ne!(now.instance(), first);
    assert_eq!(now.mask().texel_m(), 1.0);
    let second = now.instance();
    stage.app.update();
    assert_eq!(mask(&mut stage).instance(), second);
}

/// Devices that were lost so far.
static LOST: AtomicU32 = AtomicU32::new(0);

#[test]
fn a_lost_device_gets_the_scorch_again() {
    let mut stage = stage("ramp");
    stage.app.insert_resource(RenderErrorHandler(|error, _, _| {
        if error.ty == ErrorType::DeviceLost {
            LOST.fetch_add(1, Ordering::SeqCst);
        }
        RenderErrorPolicy::Recover(default())
    }));
    show_scorch(&mut stage);
    for edit in craters() {
        mask(&mut stage).apply(&edit);
    }
    let centre = Vec2::new(250.0, 270.0);
    let before = down(&mut stage, "lost_before", centre, 1.3);
    let device = stage
        .app
        .sub_app(RenderApp)
        .world()
        .resource::<RenderDevice>()
        .clone();
    let _ = device.poll(PollType::wait_indefinitely());
    device.wgpu_device().destroy();
    let _ = device.poll(PollType::wait_indefinitely());
    drop(device);
    for _ in 0..20 {
        stage.app.update();
    }
    assert_eq!(LOST.load(Ordering::SeqCst), 1);
    let after = down(&mut stage, "lost_after", centre, 1.3);
    assert_eq!(before, after);
    let (worst, seen) = compare(&after, mask(&mut stage).mask(), centre, 1.3);
    assert!(seen > 100.0 && worst < 2.5, "{worst} {seen}");
}
