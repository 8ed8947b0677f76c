//! What the prepasses hold of ground that moves under a camera that moves: depth, normals, and
//! where each point was in the frame before. A material reads them and shows them.

use super::common::app;
use super::common::scene::{Hit, covered_around, linear, pixel};
use super::common::stage::Stage;
use super::{SIZE, assets, empty, eye, stage};
use bevy::core_pipeline::prepass::{DepthPrepass, MotionVectorPrepass, NormalPrepass};
use bevy::prelude::*;
use bevy_tessera::render::TerrainMaterial;
use image::RgbImage;

const SHOWN: &str = include_str!("prepasses.wgsl");
/// Metres that are shown as white, and what motion is multiplied with.
const DEPTH_M: f32 = 1000.0;
const MOTION: f32 = 4.0;

/// Shows one of the prepass's textures in the very next frame after the terrain and the camera
/// went to `terrain` and `eye`.
fn shown(stage: &mut Stage, name: &str, what: f32, terrain: Transform, eye: Transform) -> RgbImage {
    let world = stage.app.world_mut();
    let mut material = world.get_mut::<TerrainMaterial>(stage.terrain).unwrap();
    material.parameters[0] = Vec4::new(what, DEPTH_M, MOTION, 0.0);
    *world.get_mut::<Transform>(stage.terrain).unwrap() = terrain;
    *world.get_mut::<Transform>(stage.camera.unwrap()).unwrap() = eye;
    let picture = app::picture(&mut stage.app, &stage.target.clone());
    stage.save(name, &picture);
    picture
}

/// The largest difference from what is wanted at pixels that are well inside the ground, but for
/// one pixel in a hundred: the ground is drawn with triangles.
fn worst(picture: &RgbImage, hits: &[Option<Hit>], wanted: impl Fn(usize, &Hit) -> Vec3) -> f32 {
    let mut off: Vec<f32> = (0..hits.len())
        .filter(|index| covered_around(hits, SIZE, *index, 8.0))
        .map(|index| {
            let hit = hits[index].unwrap();
            (linear(pixel(picture, index)) - wanted(index, &hit))
                .abs()
                .max_element()
        })
        .collect();
    assert!(off.len() > 8000, "{}", off.len());
    off.sort_by(f32::total_cmp);
    off[off.len() * 99 / 100]
}

fn ndc(eye: &Transform, point: Vec3) -> Vec2 {
    let seen = eye.compute_affine().inverse().transform_point3(point);
    let focal = 1.0 / (std::f32::consts::FRAC_PI_4 * 0.5).tan();
    let aspect = SIZE[0] as f32 / SIZE[1] as f32;
    Vec2::new(seen.x / aspect, seen.y) * focal / -seen.z
}

fn check(msaa: Msaa) {
    std::fs::write(assets().join(format!("prepasses_{msaa:?}.wgsl")), SHOWN).unwrap();
    let mut stage = stage();
    let shader = stage
        .app
        .world()
        .resource::<AssetServer>()
        .load(format!("prepasses_{msaa:?}.wgsl"));
    app::wait_for(&mut stage.app, &shader);
    let material = TerrainMaterial {
        shader: Some(shader),
        ..default()
    };
    let terrain = stage.terrain;
    stage.app.world_mut().entity_mut(terrain).insert(material);
    stage.aim(eye(), |camera| {
        camera.insert((msaa, DepthPrepass, NormalPrepass, MotionVectorPrepass));
    });
    app::settle(&mut stage.app, 2000);

    let scene = empty();
    let here = Transform::IDENTITY;
    let there = Transform::from_xyz(2.0, -1.0, 1.0).with_rotation(Quat::from_euler(
        EulerRot::YXZ,
        0.012,
        0.004,
        0.0,
    ));
    let step = Transform::from_translation(eye().translation + Vec3::new(-6.0, 3.0, 5.0))
        .with_rotation(eye().rotation * Quat::from_rotation_y(0.02));

    // Nothing moves: the first frames are over.
    let hits = scene.look(&eye(), SIZE);
    for _ in 0..3 {
        stage.app.update();
    }
    let still = shown(&mut stage, "prepass_still", 0.0, here, eye());
    let off = worst(&still, &hits, |_, _| Vec3::new(0.5, 0.5, 0.0));
    assert!(off < 0.01, "motion of what stands still is off by {off}");

    for (name, terrain_now, eye_now) in [
        ("camera", here, step),
        ("terrain", there, eye()),
        ("both", there, step),
    ] {
        shown(&mut stage, "prepass_before", 0.0, here, eye());
        let moving = shown(
            &mut stage,
            &format!("prepass_moving_{name}"),
            0.0,
            terrain_now,
            eye_now,
        );
        let back = terrain_now.compute_affine().inverse();
        let local_eye = Transform::from_matrix(Mat4::from(back * eye_now.compute_affine()));
        let hits = scene.look(&local_eye, SIZE);
        let mut most: f32 = 0.0;
        for hit in hits.iter().flatten() {
            let now = ndc(&eye_now, terrain_now.transform_point(hit.point));
            most = most.max((now - ndc(&eye(), hit.point)).length());
        }
        // Enough to be seen, and not so much that a pixel can't show it.
        let most = 0.5 * most * MOTION;
        assert!(most > 0.1 && most < 0.5, "{name} moves by {most}");
        let off = worst(&moving, &hits, |_, hit| {
            let now = ndc(&eye_now, terrain_now.transform_point(hit.point));
            let motion = (now - ndc(&eye(), hit.point)) * Vec2::new(0.5, -0.5);
            (motion * MOTION + 0.5).extend(0.0)
        });
        eprintln!("{msaa:?} {name}: motion off by {off}, largest {most}");
        assert!(off < 0.012, "motion of {name} is off by {off}");

        // One picture later it stands still again.
        let normals = shown(
            &mut stage,
            &format!("prepass_normal_{name}"),
            1.0,
            terrain_now,
            eye_now,
        );
        let off = worst(&normals, &hits, |_, hit| {
            terrain_now.rotation * scene.normal(hit.point) * 0.5 + 0.5
        });
        eprintln!("{msaa:?} {name}: normals off by {off}");
        assert!(off < 0.02, "normals with {name} moved are off by {off}");
        let depths = shown(
            &mut stage,
            &format!("prepass_depth_{name}"),
            2.0,
            terrain_now,
            eye_now,
        );
        let off = worst(&depths, &hits, |_, hit| {
            let depth = (hit.point - local_eye.translation).dot(*local_eye.forward());
            Vec3::splat(depth / DEPTH_M)
        });
        eprintln!("{msaa:?} {name}: depths off by {off}");
        assert!(off < 0.01, "depths with {name} moved are off by {off}");
    }
}

#[test]
fn depth_normals_and_motion_are_those_of_the_ground() {
    check(Msaa::Off);
}

#[test]
fn depth_normals_and_motion_are_those_of_the_ground_with_several_samples() {
    check(Msaa::Sample4);
}
