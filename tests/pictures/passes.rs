//! Cameras of every kind see the same ground.

use super::common::scene::{Scene, linear, mean_difference, pixel, share_beyond};
use super::common::stage::{Stage, covered};
use super::{SIZE, busy, empty, eye, stage, sunlight};
use bevy::anti_alias::taa::TemporalAntiAliasing;
use bevy::core_pipeline::prepass::{
    DeferredPrepass, DepthPrepass, MotionVectorPrepass, NormalPrepass,
};
use bevy::ecs::world::EntityWorldMut;
use bevy::pbr::{
    DefaultOpaqueRendererMethod, DistanceFog, FogFalloff, ScreenSpaceAmbientOcclusion,
};
use bevy::prelude::*;

/// A kind of camera, and how much its picture may differ from the plain one.
struct Look {
    name: &'static str,
    dress: fn(&mut EntityWorldMut),
    /// Frames drawn before the picture.
    frames: u32,
    /// Mean difference, in 255ths.
    mean: f32,
    /// Share of pixels that are covered in one picture only.
    outline: f32,
}

const LOOKS: [Look; 10] = [
    Look {
        name: "depth_prepass",
        dress: |camera| {
            camera.insert(DepthPrepass);
        },
        frames: 1,
        mean: 0.01,
        outline: 0.0,
    },
    Look {
        name: "normal_prepass",
        dress: |camera| {
            camera.insert(NormalPrepass);
        },
        frames: 1,
        mean: 0.01,
        outline: 0.0,
    },
    Look {
        name: "motion_vector_prepass",
        dress: |camera| {
            camera.insert(MotionVectorPrepass);
        },
        frames: 1,
        mean: 0.01,
        outline: 0.0,
    },
    Look {
        name: "all_prepasses",
        dress: |camera| {
            camera.insert((DepthPrepass, NormalPrepass, MotionVectorPrepass));
        },
        frames: 1,
        mean: 0.01,
        outline: 0.0,
    },
    Look {
        name: "deferred",
        dress: |camera| {
            camera.insert((DepthPrepass, DeferredPrepass));
        },
        frames: 1,
        mean: 1.0,
        outline: 0.0,
    },
    Look {
        name: "deferred_with_prepasses",
        dress: |camera| {
            camera.insert((
                DepthPrepass,
                NormalPrepass,
                MotionVectorPrepass,
                DeferredPrepass,
            ));
        },
        frames: 1,
        mean: 1.0,
        outline: 0.0,
    },
    Look {
        name: "msaa",
        dress: |camera| {
            camera.insert(Msaa::Sample4);
        },
        frames: 1,
        mean: 1.5,
        outline: 0.02,
    },
    Look {
        name: "msaa_with_prepasses",
        dress: |camera| {
            camera.insert((
                Msaa::Sample4,
                DepthPrepass,
                NormalPrepass,
                MotionVectorPrepass,
            ));
        },
        frames: 1,
        mean: 1.5,
        outline: 0.02,
    },
    Look {
        name: "taa",
        dress: |camera| {
            camera.insert(TemporalAntiAliasing::default());
        },
        frames: 12,
        mean: 3.0,
        outline: 0.03,
    },
    Look {
        name: "ambient_occlusion",
        dress: |camera| {
            camera.insert(ScreenSpaceAmbientOcclusion::default());
        },
        frames: 1,
        mean: 6.0,
        outline: 0.0,
    },
];

fn every_look(stage: &mut Stage, scene: &Scene, kind: &str) {
    stage.boxes(scene);
    stage.prop(sunlight(true));
    let plain = stage.picture(&format!("{kind}_plain"), eye(), 1, |_| {});
    assert_where_rays_say(scene, &plain, kind);

    let outline = covered(&plain);
    let mut wrong = Vec::new();
    for look in &LOOKS {
        let name = format!("{kind}_{}", look.name);
        let seen = stage.picture(&name, eye(), look.frames, look.dress);
        let mean = mean_difference(&plain, &seen);
        let pixels = outline.len() as f32;
        let moved = covered(&seen)
            .iter()
            .zip(&outline)
            .filter(|(a, b)| a != b)
            .count();
        let moved = moved as f32 / pixels;
        eprintln!("{name}: differs by {mean:.3}, outline by {moved:.4}");
        if mean > look.mean || moved > look.outline {
            wrong.push(format!(
                "{name} differs by {mean} and its outline by {moved}"
            ));
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
    stage.clear();
}

/// The picture covers what the rays meet, and nothing else.
fn assert_where_rays_say(scene: &Scene, picture: &image::RgbImage, name: &str) {
    let hits = scene.look(&eye(), SIZE);
    let outline = covered(picture);
    let wrong = hits
        .iter()
        .zip(&outline)
        .filter(|(hit, seen)| hit.is_some() != **seen)
        .count();
    let ground = hits
        .iter()
        .filter(|hit| hit.is_some_and(|hit| hit.on_ground))
        .count();
    assert!(
        ground * 2 > hits.len(),
        "{name}: too little ground: {ground}"
    );
    assert!(
        wrong * 200 < hits.len(),
        "{name}: {wrong} of {} pixels",
        hits.len()
    );
}

#[test]
fn the_ground_alone_is_in_every_kind_of_picture() {
    every_look(&mut stage(), &empty(), "alone");
}

#[test]
fn the_ground_among_meshes_is_in_every_kind_of_picture() {
    let mut stage = stage();
    every_look(&mut stage, &busy(), "busy");

    // Meshes that are deferred too: then Bevy's own deferred items are beside the terrain's.
    stage.boxes(&busy());
    stage.prop(sunlight(true));
    let forward = stage.picture("busy_forward", eye(), 1, |_| {});
    stage
        .app
        .insert_resource(DefaultOpaqueRendererMethod::deferred());
    stage.clear();
    stage.boxes(&busy());
    stage.prop(sunlight(true));
    let deferred = stage.picture("busy_all_deferred", eye(), 1, |camera| {
        camera.insert((DepthPrepass, DeferredPrepass));
    });
    let mean = mean_difference(&forward, &deferred);
    assert!(mean < 1.0, "{mean}");
}

#[test]
fn fog_swallows_the_ground_with_distance() {
    let fog_color = Vec3::new(0.1, 0.4, 0.5);
    let (start, end) = (250.0, 800.0);
    let mut stage = stage();
    let scene = empty();
    stage.prop(sunlight(false));
    let hits = scene.look(&eye(), SIZE);
    for (name, deferred) in [("forward", false), ("deferred", true)] {
        let dress = |camera: &mut EntityWorldMut| {
            if deferred {
                camera.insert((DepthPrepass, DeferredPrepass));
            }
        };
        let clear = stage.picture(&format!("fog_without_{name}"), eye(), 1, dress);
        let fog = stage.picture(&format!("fog_{name}"), eye(), 1, |camera| {
            dress(camera);
            camera.insert(DistanceFog {
                color: Color::linear_rgb(fog_color.x, fog_color.y, fog_color.z),
                directional_light_color: Color::NONE,
                falloff: FogFalloff::Linear { start, end },
                ..default()
            });
        });
        let mut worst: f32 = 0.0;
        let mut far = 0;
        for (index, hit) in hits.iter().enumerate() {
            let Some(hit) = hit else { continue };
            let share = ((hit.distance - start) / (end - start)).clamp(0.0, 1.0);
            let wanted = linear(pixel(&clear, index)).lerp(fog_color, share);
            let off = (linear(pixel(&fog, index)) - wanted).abs().max_element();
            far += usize::from(share > 0.6);
            // At an outline, a ray may meet another hill than the pixel shows.
            let inside = super::common::scene::covered_around(&hits, SIZE, index, 30.0);
            if inside {
                worst = worst.max(off);
            }
        }
        assert!(far > 500, "{far}");
        assert!(worst < 0.05, "{name}: {worst}");
    }
}

#[test]
fn ambient_occlusion_darkens_what_is_hidden() {
    let mut stage = stage();
    let scene = busy();
    stage.boxes(&scene);
    stage.app.insert_resource(GlobalAmbientLight {
        brightness: 3000.0,
        ..default()
    });
    let without = stage.picture("occlusion_without", eye(), 1, |_| {});
    let with = stage.picture("occlusion", eye(), 1, |camera| {
        camera.insert(ScreenSpaceAmbientOcclusion::default());
    });
    let hits = scene.look(&eye(), SIZE);
    let (mut darker, mut brighter, mut ground) = (0, 0, 0);
    for (index, hit) in hits.iter().enumerate() {
        if !hit.is_some_and(|hit| hit.on_ground) {
            continue;
        }
        ground += 1;
        let change = linear(pixel(&with, index)) - linear(pixel(&without, index));
        darker += usize::from(change.max_element() < -0.01);
        brighter += usize::from(change.max_element() > 0.01);
    }
    eprintln!("occlusion: {darker} darker, {brighter} brighter of {ground}");
    assert!(darker * 200 > ground, "{darker} of {ground} are darker");
    assert!(
        brighter * 200 < ground,
        "{brighter} of {ground} are brighter"
    );
    assert!(share_beyond(&with, &without, 128) < 0.02);
}

#[test]
fn a_moved_and_turned_terrain_looks_the_same_from_where_the_camera_moved_to() {
    let mut stage = stage();
    let light = stage.prop(sunlight(false));
    let before = stage.picture("standing", eye(), 1, |_| {});
    let moved = Transform {
        translation: Vec3::new(-4000.0, 500.0, 900.0),
        rotation: Quat::from_euler(EulerRot::YXZ, 2.1, 0.15, -0.1),
        scale: Vec3::splat(1.5),
    };
    let terrain = stage.terrain;
    *stage.app.world_mut().get_mut::<Transform>(terrain).unwrap() = moved;
    let unmoved_eye = stage.picture("moved_away", eye(), 1, |_| {});
    let mut shone = stage.app.world_mut().get_mut::<Transform>(light).unwrap();
    shone.rotation = moved.rotation * shone.rotation;
    let mut eye = moved * eye();
    eye.scale = Vec3::ONE;
    let after = stage.picture("moved", eye, 1, |_| {});
    let mean = mean_difference(&before, &after);
    assert!(mean < 0.5, "{mean}");
    assert!(mean_difference(&before, &unmoved_eye) > 30.0);
}
