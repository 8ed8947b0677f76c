//! Two settings of one camera in one picture.

mod common;

use bevy::anti_alias::fxaa::Fxaa;
use bevy::camera::{Hdr, ImageRenderTarget, RenderTarget, Viewport};
use bevy::core_pipeline::prepass::DepthPrepass;
use bevy::core_pipeline::tonemapping::{DebandDither, Tonemapping};
use bevy::ecs::world::EntityWorldMut;
use bevy::pbr::DistanceFog;
use bevy::post_process::bloom::Bloom;
use bevy::prelude::*;
use bevy::render::RenderApp;
use bevy::render::render_resource::TextureFormat;
use bevy::render::view::ExtractedView;
use bevy::render::view::screenshot::{Screenshot, ScreenshotCaptured};
use bevy_tessera::render::{ComparisonCamera, ComparisonView, TerrainComparison};
use bevy_tessera::terrain::TerrainCamera;
use bevy_tessera::view::{TerrainEye, TerrainViews};
use common::scene::{self, Scene};
use common::stage::{self, Stage};
use image::RgbImage;
use std::sync::{Arc, Mutex};

const SIZE: [u32; 2] = [320, 200];
const GREY: [u8; 3] = [128; 3];

/// Coarse enough for the density map to show.
fn settings(density: f32) -> TerrainCamera {
    TerrainCamera {
        density,
        triangle_width_px: 24.0,
        ..default()
    }
}

fn eye(scene: &Scene) -> Transform {
    Transform::from_translation(scene.ground(150.0, 560.0) + Vec3::Y * 60.0)
        .looking_at(scene.ground(430.0, 290.0), Vec3::Y)
}

/// A stage with hills under a sun.
fn stage(folder: &'static str) -> (Stage, Transform) {
    let scene = Scene::new(scene::hills);
    let assets = scene::assets_with_hills(folder);
    let mut stage = Stage::new("comparison", &assets, "hills/terrain.ron", SIZE);
    stage.prop((
        DirectionalLight {
            illuminance: 5_000.0,
            shadow_maps_enabled: true,
            ..default()
        },
        scene::two_cascades(),
        Transform::default().looking_to(Vec3::new(-1.0, -0.7, 0.3), Vec3::Y),
    ));
    (stage, eye(&scene))
}

fn compare(other: f32, view: ComparisonView) -> TerrainComparison {
    TerrainComparison {
        other: settings(other),
        view,
    }
}

/// A camera's component is put on, and some frames later a picture is taken.
fn shoot_with(stage: &mut Stage, name: &str, value: impl Bundle) -> RgbImage {
    let camera = stage.camera.unwrap();
    stage.app.world_mut().entity_mut(camera).insert(value);
    stage.shoot(name, 3)
}

/// Pictures with the density map and without.
fn plain(
    stage: &mut Stage,
    name: &str,
    eye: Transform,
    dress: &dyn Fn(&mut EntityWorldMut),
) -> [RgbImage; 2] {
    [1.0, 0.0].map(|density| {
        stage.picture(&format!("{name}_plain_{density}"), eye, 3, |camera| {
            camera.insert(settings(density));
            dress(camera);
        })
    })
}

fn assert_same(a: &RgbImage, b: &RgbImage, what: &str) {
    let differing = scene::share_beyond(a, b, 0);
    assert_eq!(differing, 0.0, "{what}: share of pixels that differ");
}

/// A picture that is `left` up to the line, `right` from there on.
fn assert_split(
    picture: &RgbImage,
    [left, right]: [&RgbImage; 2],
    line: std::ops::Range<u32>,
    what: &str,
) {
    let mut wrong = 0;
    for (x, y, pixel) in picture.enumerate_pixels() {
        let expected = if line.contains(&x) {
            let light = if x == line.start { 0 } else { 255 };
            image::Rgb([light; 3])
        } else if x < line.start {
            *left.get_pixel(x, y)
        } else {
            *right.get_pixel(x, y)
        };
        wrong += u32::from(*pixel != expected);
    }
    assert_eq!(wrong, 0, "{what}: pixels that are wrong");
}

#[test]
fn equal_settings_give_the_plain_picture_and_no_difference() {
    let (mut stage, eye) = stage("comparison_equal");
    let [plain, _] = plain(&mut stage, "equal", eye, &|_| ());
    stage.aim(eye, |camera| {
        camera.insert(settings(1.0));
    });
    let split = compare(1.0, ComparisonView::Split { divider: 0.5 });
    let split = shoot_with(&mut stage, "equal_split", split);
    assert_split(&split, [&plain, &plain], 159..161, "split");
    for gain in [1.0, 64.0] {
        let view = ComparisonView::Difference { gain };
        let difference = shoot_with(&mut stage, "equal_difference", compare(1.0, view));
        let other = difference.pixels().filter(|pixel| pixel.0 != GREY).count();
        assert_eq!(other, 0, "pixels that aren't grey at gain {gain}");
    }
}

#[test]
fn the_left_part_is_the_cameras_own_picture_and_the_right_one_the_others() {
    let (mut stage, eye) = stage("comparison_split");
    let [dense, even] = plain(&mut stage, "split", eye, &|_| ());
    let differing = scene::share_beyond(&dense, &even, 1);
    assert!(differing > 0.01, "density shows in {differing} only");
    stage.aim(eye, |camera| {
        camera.insert(settings(1.0));
    });
    for (divider, line) in [
        (0.25, 79..81),
        (0.0, 0..0),
        (1.0, 320..320),
        (-3.0, 0..0),
        (f32::INFINITY, 320..320),
        (f32::NAN, 159..161),
    ] {
        let view = ComparisonView::Split { divider };
        let picture = shoot_with(&mut stage, &format!("split_{divider}"), compare(0.0, view));
        assert_split(&picture, [&dense, &even], line, &format!("at {divider}"));
    }
}

/// What a channel's difference is drawn as.
fn amplified(own: u8, other: u8, gain: f32) -> u8 {
    let difference = gain * (f32::from(own) - f32::from(other));
    (128.0 + difference).round().clamp(0.0, 255.0) as u8
}

#[test]
fn a_difference_grows_with_the_gain_until_it_saturates() {
    let (mut stage, eye) = stage("comparison_difference");
    let [dense, even] = plain(&mut stage, "difference", eye, &|_| ());
    stage.aim(eye, |camera| {
        camera.insert(settings(1.0));
    });
    let mut saturated = 0;
    for (gain, is) in [
        (1.0, 1.0),
        (4.0, 4.0),
        (16.0, 16.0),
        (64.0, 64.0),
        (1e9, 64.0),
        (-1.0, 1.0),
        (f32::NAN, 1.0),
    ] {
        let view = ComparisonView::Difference { gain };
        let picture = shoot_with(
            &mut stage,
            &format!("difference_{gain}"),
            compare(0.0, view),
        );
        for ((pixel, own), other) in picture.pixels().zip(dense.pixels()).zip(even.pixels()) {
            for channel in 0..3 {
                let expected = amplified(own.0[channel], other.0[channel], is);
                // Drivers round what they encode.
                let off = pixel.0[channel].abs_diff(expected);
                assert!(off <= 1, "gain {gain}: {own:?} {other:?} {pixel:?}");
                saturated += u32::from(expected == 0 || expected == 255);
            }
        }
    }
    assert!(saturated > 100, "nothing was saturated");
}

#[test]
fn it_holds_in_every_kind_of_picture() {
    let (mut stage, eye) = stage("comparison_kinds");
    type Dress = fn(&mut EntityWorldMut);
    let kinds: [(&str, Dress); 7] = [
        ("hdr", |camera| {
            camera.insert((Hdr, Tonemapping::AcesFitted, DebandDither::Enabled));
        }),
        ("msaa", |camera| {
            camera.insert((Msaa::Sample4, Tonemapping::Reinhard));
        }),
        ("viewport", |camera| {
            let viewport = Viewport {
                physical_position: UVec2::new(10, 2),
                physical_size: UVec2::new(300, 196),
                ..default()
            };
            camera.get_mut::<Camera>().unwrap().viewport = Some(viewport);
        }),
        ("fog", |camera| {
            camera.insert((
                DistanceFog {
                    falloff: FogFalloff::from_visibility_squared(900.0),
                    ..default()
                },
                DepthPrepass,
            ));
        }),
        ("parallel", |camera| {
            camera.insert(Projection::from(OrthographicProjection {
                scale: 1.5,
                near: -2000.0,
                far: 4000.0,
                ..OrthographicProjection::default_3d()
            }));
        }),
        ("bloom", |camera| {
            camera.insert((Hdr, Bloom::NATURAL));
        }),
        ("fxaa", |camera| {
            camera.insert(Fxaa::default());
        }),
    ];
    for (name, dress) in kinds {
        let [dense, even] = plain(&mut stage, name, eye, &dress);
        let differing = scene::share_beyond(&dense, &even, 0);
        assert!(
            differing > 0.01,
            "{name}: density shows in {differing} only"
        );
        stage.aim(eye, |camera| {
            camera.insert(settings(1.0));
            dress(camera);
        });
        let view = ComparisonView::Split { divider: 0.5 };
        let picture = shoot_with(&mut stage, &format!("{name}_split"), compare(0.0, view));
        let line = 159..161;
        if name == "viewport" {
            for (x, y, pixel) in picture.enumerate_pixels() {
                let inside = (10..310).contains(&x) && (2..198).contains(&y);
                if !inside {
                    assert_eq!(pixel, dense.get_pixel(x, y), "{name} beside the viewport");
                } else if !line.contains(&x) {
                    let expected = if x < 159 { &dense } else { &even };
                    assert_eq!(pixel, expected.get_pixel(x, y), "{name} at {x}, {y}");
                }
            }
        } else {
            assert_split(&picture, [&dense, &even], line, name);
        }
    }
}

#[test]
fn effects_are_compared_where_nobody_has_registered_their_types() {
    let (mut stage, eye) = stage("comparison_effects");
    // As it is without Bevy's feature `reflect_auto_register`.
    stage.app.insert_resource(AppTypeRegistry::default());
    type Dress = fn(&mut EntityWorldMut);
    let effects: [(&str, Dress); 2] = [
        ("unregistered_bloom", |camera| {
            camera.insert((Hdr, Bloom::NATURAL));
        }),
        ("unregistered_fxaa", |camera| {
            camera.insert(Fxaa::default());
        }),
    ];
    for (name, dress) in effects {
        let [dense, even] = plain(&mut stage, name, eye, &dress);
        let [_, bare] = plain(&mut stage, &format!("{name}_off"), eye, &|camera| {
            if name.ends_with("bloom") {
                camera.insert(Hdr);
            }
        });
        let differing = scene::share_beyond(&even, &bare, 1);
        assert!(differing > 0.01, "{name} shows in {differing} only");
        stage.aim(eye, |camera| {
            camera.insert(settings(1.0));
            dress(camera);
        });
        let view = ComparisonView::Split { divider: 0.5 };
        let picture = shoot_with(&mut stage, &format!("{name}_split"), compare(0.0, view));
        assert_split(&picture, [&dense, &even], 159..161, name);
    }
    // What stands somewhere stays where it is: there is one lamp, not two.
    let camera = stage.camera.unwrap();
    let world = stage.app.world_mut();
    world.entity_mut(camera).insert(PointLight::default());
    stage.shoot("unregistered_lamp", 2);
    let other = others(&mut stage)[0].0;
    assert!(!stage.app.world().entity(other).contains::<PointLight>());
}

#[test]
fn the_cameras_own_picture_keeps_its_lamps_shadows() {
    let (mut stage, eye) = stage("comparison_lamp");
    stage.prop((
        PointLight {
            intensity: 1.5e9,
            range: 900.0,
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::from_xyz(330.0, 62.0, 262.0),
    ));
    let of_width = |triangle_width_px, faces_per_side| TerrainCamera {
        density: 0.0,
        triangle_width_px,
        faces_per_side,
        ..default()
    };
    let (fine, coarse) = (of_width(4.0, 4), of_width(250.0, 2));
    let [other, before] = [("coarse", &coarse), ("before", &fine)].map(|(name, settings)| {
        stage.picture(&format!("lamp_{name}"), eye, 3, |camera| {
            camera.insert(settings.clone());
        })
    });
    let differing = scene::share_beyond(&other, &before, 1);
    assert!(differing > 0.01, "settings show in {differing} only");
    let comparison = TerrainComparison {
        other: coarse,
        view: ComparisonView::Split { divider: 1.0 },
    };
    let during = shoot_with(&mut stage, "lamp_during", comparison);
    assert_eq!(others(&mut stage).len(), 1);
    assert_same(&during, &before, "while it is compared");
}

#[test]
fn the_line_is_as_wide_as_the_target_scales() {
    let (mut stage, eye) = stage("comparison_line");
    let target = RenderTarget::Image(ImageRenderTarget {
        handle: stage.target.clone(),
        scale_factor: 3.0,
    });
    stage.aim(eye, |camera| {
        camera.insert((
            settings(1.0),
            compare(1.0, ComparisonView::Split { divider: 0.5 }),
            target.clone(),
        ));
    });
    common::app::settle(&mut stage.app, 2000);
    for _ in 0..4 {
        stage.app.update();
    }
    let taken: Arc<Mutex<Option<RgbImage>>> = Arc::default();
    let slot = taken.clone();
    stage.app.world_mut().spawn(Screenshot(target)).observe(
        move |captured: On<ScreenshotCaptured>| {
            let image = captured.image.clone().try_into_dynamic().unwrap();
            *slot.lock().unwrap() = Some(image.to_rgb8());
        },
    );
    let mut picture = None;
    for _ in 0..100 {
        stage.app.update();
        picture = taken.lock().unwrap().take();
        if picture.is_some() {
            break;
        }
    }
    let picture = picture.expect("a picture in 100 frames");
    stage.save("line", &picture);
    for (columns, light) in [(157..160, 0), (160..163, 255)] {
        for x in columns {
            let is_line = (0..SIZE[1]).all(|y| picture.get_pixel(x, y).0 == [light; 3]);
            assert!(is_line, "column {x}");
        }
    }
    for x in [156, 163] {
        let line =
            (0..SIZE[1]).filter(|y| [[0; 3], [255; 3]].contains(&picture.get_pixel(x, *y).0));
        assert!(line.count() < 20, "column {x}");
    }
}

#[test]
fn it_follows_the_camera_and_its_target() {
    let (mut stage, eye) = stage("comparison_follows");
    stage.aim(eye, |camera| {
        camera.insert((
            settings(1.0),
            compare(1.0, ComparisonView::Difference { gain: 64.0 }),
        ));
    });
    stage.shoot("follows_before", 3);
    let grey = |picture: &RgbImage, what: &str| {
        let other = picture.pixels().filter(|pixel| pixel.0 != GREY).count();
        assert_eq!(other, 0, "{what}: pixels that aren't grey");
    };
    // Every single frame, wherever the camera is, with whatever is put on it.
    let camera = stage.camera.unwrap();
    let target = stage.target.clone();
    for step in 0..12 {
        let mut entity = stage.app.world_mut().entity_mut(camera);
        entity.get_mut::<Transform>().unwrap().translation.x += 7.0;
        match step {
            2 => {
                entity.insert(Projection::from(PerspectiveProjection {
                    fov: 0.5,
                    ..default()
                }));
            }
            4 => {
                entity.insert(DistanceFog::default());
            }
            6 => {
                entity.remove::<DistanceFog>();
            }
            8 => {
                entity.insert(TerrainCamera {
                    triangle_width_px: 24.0,
                    ..default()
                });
            }
            _ => {}
        }
        let picture = common::app::picture(&mut stage.app, &target);
        grey(&picture, &format!("step {step}"));
    }
    // A target of another size, from its first frame on.
    for [width, height] in [[200, 260], [400, 100]] {
        let format = TextureFormat::Rgba8UnormSrgb;
        let image = Image::new_target_texture(width, height, format, None);
        let mut images = stage.app.world_mut().resource_mut::<Assets<Image>>();
        *images.get_mut(&target).unwrap() = image;
        for _ in 0..3 {
            let picture = common::app::picture(&mut stage.app, &target);
            assert_eq!(picture.dimensions(), (width, height));
            grey(&picture, "resized");
        }
    }
}

/// What may be left behind: entities here and in the renderer, images, views that are drawn.
fn census(stage: &mut Stage) -> [usize; 4] {
    for _ in 0..4 {
        stage.app.update();
    }
    let world = stage.app.world_mut();
    let entities = world.query::<Entity>().iter(world).count();
    let images = world.resource::<Assets<Image>>().len();
    let render = stage.app.sub_app_mut(RenderApp).world_mut();
    let drawn = render.query::<Entity>().iter(render).count();
    let views = render.query::<&ExtractedView>().iter(render).count();
    [entities, images, drawn, views]
}

#[test]
fn nothing_is_left_when_it_ends() {
    let (mut stage, eye) = stage("comparison_ends");
    let [dense, _] = plain(&mut stage, "ends", eye, &|_| ());
    let camera = stage.aim(eye, |camera| {
        camera.insert(settings(1.0));
    });
    stage.shoot("ends_before", 3);
    let before = census(&mut stage);
    let view = ComparisonView::Split { divider: 0.5 };
    shoot_with(&mut stage, "ends_during", compare(0.0, view));
    let during = census(&mut stage);
    assert_eq!(during[0], before[0] + 1, "one camera more");
    assert_eq!(during[1], before[1] + 1, "one image more");
    assert!(during[3] > before[3], "one view more");
    let world = stage.app.world_mut();
    world.entity_mut(camera).remove::<TerrainComparison>();
    assert_eq!(others(&mut stage).len(), 0, "it ends at once");
    let after = census(&mut stage);
    assert_eq!(after, before);
    let picture = stage.shoot("ends_after", 1);
    assert_same(&picture, &dense, "afterwards");

    // Nor where the camera goes, or is none any more.
    shoot_with(&mut stage, "ends_again", compare(0.0, view));
    assert_eq!(others(&mut stage).len(), 1);
    stage.app.world_mut().despawn(camera);
    stage.camera = None;
    assert_eq!(others(&mut stage).len(), 0);
    let empty = census(&mut stage);
    assert_eq!(empty[1], before[1]);
    let camera = stage.aim(eye, |camera| {
        camera.insert((settings(1.0), compare(0.0, view)));
    });
    stage.shoot("ends_third", 3);
    assert_eq!(others(&mut stage).len(), 1);
    let world = stage.app.world_mut();
    world.entity_mut(camera).remove::<TerrainCamera>();
    stage.app.update();
    assert_eq!(others(&mut stage).len(), 0);
}

fn others(stage: &mut Stage) -> Vec<(Entity, ComparisonCamera)> {
    let world = stage.app.world_mut();
    let mut others = world.query::<(Entity, &ComparisonCamera)>();
    others
        .iter(world)
        .map(|(entity, of)| (entity, *of))
        .collect()
}

#[test]
fn two_cameras_are_compared_at_once() {
    let (mut stage, eye) = stage("comparison_two");
    let pictures = plain(&mut stage, "two", eye, &|_| ());
    let [dense, even] = [&pictures[0], &pictures[1]];
    stage.aim(eye, |camera| {
        camera.insert((
            settings(1.0),
            compare(0.0, ComparisonView::Split { divider: 0.5 }),
        ));
    });
    let second = common::app::target(&mut stage.app, SIZE[0], SIZE[1]);
    stage.prop((
        stage::bare_camera(eye, &second),
        settings(0.0),
        compare(1.0, ComparisonView::Split { divider: 0.25 }),
    ));
    let first = stage.shoot("two_first", 5);
    assert_split(&first, [dense, even], 159..161, "the first");
    let other = common::app::picture(&mut stage.app, &second);
    stage.save("two_second", &other);
    assert_split(&other, [even, dense], 79..81, "the second");
    assert_eq!(others(&mut stage).len(), 2);
}

#[test]
fn the_second_camera_shares_a_held_eye() {
    let (mut stage, eye) = stage("comparison_held");
    let camera = stage.aim(eye, |camera| {
        camera.insert((
            settings(1.0),
            compare(1.0, ComparisonView::Difference { gain: 64.0 }),
        ));
    });
    stage.shoot("held_before", 3);
    let beside = Transform {
        translation: eye.translation + Vec3::new(150.0, 80.0, -20.0),
        ..eye
    };
    for held in [
        TerrainEye::EyeOnly,
        TerrainEye::LodOnly,
        TerrainEye::EyeAndLod,
    ] {
        let picture = shoot_with(&mut stage, &format!("held_{held:?}"), (held, beside));
        let other = picture.pixels().filter(|pixel| pixel.0 != GREY).count();
        assert_eq!(other, 0, "{held:?}: pixels that aren't grey");
        let other = others(&mut stage)[0].0;
        let world = stage.app.world();
        let view = |camera: Entity| {
            let views = world.get::<TerrainViews>(camera).unwrap();
            views.of(stage.terrain).unwrap().eye_m
        };
        assert_eq!(view(camera), view(other), "{held:?}");
        let place = |camera: Entity| *world.get::<GlobalTransform>(camera).unwrap();
        assert_eq!(place(camera), place(other), "{held:?}");
    }
}

/// Stands for what a game puts on its camera.
#[derive(Component, Clone)]
struct Player;

#[test]
fn games_and_interfaces_do_not_find_the_second_camera() {
    let scene = Scene::new(scene::hills);
    let assets = scene::assets_with_hills("comparison_found");
    let mut stage = Stage::with(
        "comparison",
        &assets,
        "hills/terrain.ron",
        SIZE,
        false,
        default(),
        |app| {
            app.add_plugins(bevy_egui::EguiPlugin::default())
                .init_schedule(bevy_egui::EguiPrimaryContextPass);
        },
    );
    // Everything in one bundle, before anybody has seen the camera.
    let camera = stage.aim(eye(&scene), |camera| {
        camera.insert((
            settings(1.0),
            Player,
            IsDefaultUiCamera,
            compare(0.0, ComparisonView::default()),
        ));
    });
    stage.shoot("found", 5);
    let others = others(&mut stage);
    assert_eq!(others.len(), 1);
    let (other, of) = others[0];
    assert_eq!(of, ComparisonCamera(camera));
    let world = stage.app.world_mut();
    let mut primary = world.query_filtered::<Entity, With<bevy_egui::PrimaryEguiContext>>();
    assert_eq!(primary.iter(world).collect::<Vec<_>>(), [camera]);
    let entity = world.entity(other);
    assert!(!entity.contains::<Player>());
    assert!(!entity.contains::<IsDefaultUiCamera>());
    assert!(!entity.contains::<TerrainComparison>());
    assert!(!entity.contains::<bevy_egui::EguiContext>());
    assert_eq!(entity.get::<TerrainCamera>(), Some(&settings(0.0)));
}
