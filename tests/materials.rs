//! A game's own WGSL shades the ground: it is told position, height, slope and normal as they are,
//! gets its parameters, and works in forward and deferred rendering alike.

mod common;

use bevy::core_pipeline::prepass::{DeferredPrepass, DepthPrepass};
use bevy::prelude::*;
use bevy::shader::Shader;
use bevy_tessera::render::TerrainMaterial;
use common::app;
use common::scene::{
    Hit, Scene, assets_with_hills, covered_around, hills, linear, mean_difference, pixel, ramp,
};
use common::stage::{NOTHING, Stage};
use image::RgbImage;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

const SIZE: [u32; 2] = [192, 128];
const SURFACE: &str = include_str!("materials/surface.wgsl");
/// What the components of a position are divided by to be shown.
const SHOWN_M: Vec3 = Vec3::new(800.0, 150.0, 800.0);

fn assets() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let folder = assets_with_hills("materials");
        std::fs::create_dir_all(folder.join("shaders")).unwrap();
        Scene::new(ramp).bake(&folder.join("ramp"));
        std::fs::write(folder.join("shaders/surface.wgsl"), SURFACE).unwrap();
        folder
    })
}

fn eye() -> Transform {
    Transform::from_xyz(250.0, 150.0, 600.0).looking_at(Vec3::new(400.0, 30.0, 280.0), Vec3::Y)
}

/// A stage whose terrain is shaded by the game's file.
fn stage(terrain: &str) -> Stage {
    let manifest = format!("{terrain}/terrain.ron");
    let mut stage = Stage::new("materials", assets(), &manifest, SIZE);
    let shader: Handle<Shader> = stage
        .app
        .world()
        .resource::<AssetServer>()
        .load("shaders/surface.wgsl");
    app::wait_for(&mut stage.app, &shader);
    let entity = stage.terrain;
    stage
        .app
        .world_mut()
        .entity_mut(entity)
        .insert(TerrainMaterial {
            shader: Some(shader),
            parameters: [Vec4::ZERO; 8],
        });
    stage
}

fn set_parameters(stage: &mut Stage, parameters: &[(usize, Vec4)]) {
    let terrain = stage.terrain;
    let mut material = stage
        .app
        .world_mut()
        .get_mut::<TerrainMaterial>(terrain)
        .unwrap();
    for (index, value) in parameters {
        material.parameters[*index] = *value;
    }
}

fn show(stage: &mut Stage, name: &str, parameters: &[(usize, Vec4)], deferred: bool) -> RgbImage {
    set_parameters(stage, parameters);
    stage.picture(name, eye(), 1, |camera| {
        if deferred {
            camera.insert((DepthPrepass, DeferredPrepass));
        }
    })
}

fn what(number: f32) -> (usize, Vec4) {
    (0, Vec4::new(number, 0.0, 0.0, 0.0))
}

/// The largest difference from what is wanted, but for one pixel in a hundred: the ground is drawn
/// with triangles.
fn worst(picture: &RgbImage, hits: &[Option<Hit>], wanted: impl Fn(&Hit) -> Vec3) -> f32 {
    let mut off: Vec<f32> = (0..hits.len())
        .filter(|index| covered_around(hits, SIZE, *index, 8.0))
        .map(|index| {
            let hit = hits[index].unwrap();
            (linear(pixel(picture, index)) - wanted(&hit))
                .abs()
                .max_element()
        })
        .collect();
    assert!(off.len() > 6000, "{}", off.len());
    off.sort_by(f32::total_cmp);
    off[off.len() * 99 / 100]
}

#[test]
fn a_material_is_told_position_height_slope_and_normal() {
    let scene = Scene::new(hills);
    let mut stage = stage("hills");
    let hits = scene.look(&eye(), SIZE);
    for (way, deferred) in [("forward", false), ("deferred", true)] {
        let normals = show(&mut stage, &format!("normal_{way}"), &[what(0.0)], deferred);
        let off = worst(&normals, &hits, |hit| scene.normal(hit.point) * 0.5 + 0.5);
        eprintln!("{way}: normals off by {off}");
        assert!(off < 0.015, "{way}: normals are off by {off}");

        let heights = show(&mut stage, &format!("height_{way}"), &[what(1.0)], deferred);
        let off = worst(&heights, &hits, |hit| {
            Vec3::new(hit.point.y / 150.0, 1.0 - scene.normal(hit.point).y, 0.0)
        });
        eprintln!("{way}: heights and slopes off by {off}");
        assert!(off < 0.02, "{way}: heights and slopes are off by {off}");

        let places = show(&mut stage, &format!("place_{way}"), &[what(2.0)], deferred);
        let off = worst(&places, &hits, |hit| hit.point / SHOWN_M);
        eprintln!("{way}: places off by {off}");
        assert!(off < 0.02, "{way}: places are off by {off}");

        let parameters = [what(4.0), (7, Vec4::new(0.2, 0.6, 0.9, 0.0))];
        let flat = show(
            &mut stage,
            &format!("parameters_{way}"),
            &parameters,
            deferred,
        );
        let off = worst(&flat, &hits, |_| Vec3::new(0.2, 0.6, 0.9));
        assert!(off < 0.01, "{way}: parameters are off by {off}");
    }
}

#[test]
fn positions_and_normals_follow_a_terrain_that_was_moved_and_turned() {
    let scene = Scene::new(hills);
    let mut stage = stage("hills");
    let moved = Transform::from_xyz(1000.0, 200.0, -500.0)
        .with_rotation(Quat::from_rotation_y(0.6) * Quat::from_rotation_x(0.1));
    let terrain = stage.terrain;
    *stage.app.world_mut().get_mut::<Transform>(terrain).unwrap() = moved;
    let hits = scene.look(&eye(), SIZE);
    let mut show_moved = |name: &str, parameters: &[(usize, Vec4)]| {
        set_parameters(&mut stage, parameters);
        stage.picture(name, moved * eye(), 1, |_| {})
    };
    let normals = show_moved("moved_normal", &[what(0.0)]);
    let off = worst(&normals, &hits, |hit| {
        moved.rotation * scene.normal(hit.point) * 0.5 + 0.5
    });
    assert!(off < 0.015, "normals are off by {off}");
    let places = show_moved("moved_place", &[what(2.0)]);
    let off = worst(&places, &hits, |hit| hit.point / SHOWN_M);
    assert!(off < 0.02, "local positions are off by {off}");
    // Shown relative to a corner below all of it, so that nothing is negative.
    let low = Vec3::new(900.0, 50.0, -1500.0);
    let places = show_moved("moved_world_place", &[what(3.0), (1, low.extend(0.0))]);
    let off = worst(&places, &hits, |hit| {
        ((moved.transform_point(hit.point) - low) / SHOWN_M).clamp(Vec3::ZERO, Vec3::ONE)
    });
    assert!(off < 0.02, "world positions are off by {off}");
}

#[test]
fn flat_ground_is_level_and_a_ramp_tilts_away_from_its_rise() {
    let scene = Scene::new(ramp);
    let mut stage = stage("ramp");
    let hits = scene.look(&eye(), SIZE);
    let normals = show(&mut stage, "ramp_normal", &[what(0.0)], false);
    let slopes = show(&mut stage, "ramp_slope", &[what(1.0)], false);
    let tilted = Vec3::new(-0.5, 1.0, 0.0).normalize();
    let (mut level, mut steep) = (0, 0);
    for (index, hit) in hits.iter().enumerate() {
        let Some(hit) = hit else { continue };
        if !covered_around(&hits, SIZE, index, 15.0) {
            continue;
        }
        let normal = linear(pixel(&normals, index)) * 2.0 - 1.0;
        let slope = linear(pixel(&slopes, index)).y;
        if hit.point.x < 340.0 {
            level += 1;
            assert!(
                (normal - Vec3::Y).abs().max_element() < 0.012,
                "{hit:?}: {normal}"
            );
            assert!(slope < 0.004, "{hit:?}: {slope}");
        } else if hit.point.x > 430.0 {
            steep += 1;
            assert!(normal.x < 0.0, "{hit:?}: {normal}");
            assert!(
                (normal - tilted).abs().max_element() < 0.02,
                "{hit:?}: {normal}"
            );
            assert!((slope - (1.0 - tilted.y)).abs() < 0.01, "{hit:?}: {slope}");
        }
    }
    assert!(level > 1000 && steep > 1000, "{level} level, {steep} steep");
}

#[test]
fn a_material_may_change_while_the_game_runs() {
    let mut stage = stage("hills");
    let terrain = stage.terrain;
    let green = [what(4.0), (7, Vec4::new(0.0, 1.0, 0.0, 0.0))];
    let before = show(&mut stage, "changing_before", &green, false);
    assert_eq!(bottom(&before), [0, 255, 0]);

    // The file is saved again.
    let material = stage.app.world().get::<TerrainMaterial>(terrain).unwrap();
    let shader = material.shader.clone().unwrap();
    let path = "shaders/surface.wgsl";
    let red = SURFACE.replace("vec4(shown, 1.0)", "vec4(shown.grb, 1.0)");
    let mut shaders = stage.app.world_mut().resource_mut::<Assets<Shader>>();
    shaders
        .insert(shader.id(), Shader::from_wgsl(red, path))
        .unwrap();
    let after = show(&mut stage, "changing_after", &green, false);
    assert_eq!(bottom(&after), [255, 0, 0]);

    // The terrain gets another material, the default one.
    stage
        .app
        .world_mut()
        .entity_mut(terrain)
        .remove::<TerrainMaterial>();
    stage.prop((
        DirectionalLight::default(),
        Transform::from_xyz(1.0, 1.0, 1.0).looking_at(Vec3::ZERO, Vec3::Y),
    ));
    let default = stage.picture("changing_default", eye(), 1, |_| {});
    let [red, green, blue] = bottom(&default);
    assert!(
        green > blue && red > blue && green > 40 && green < 220,
        "{red} {green} {blue}"
    );
    assert!(mean_difference(&after, &default) > 40.0);
}

#[test]
fn a_material_that_does_not_compile_takes_nothing_else_with_it() {
    let mut stage = stage("hills");
    let terrain = stage.terrain;
    let broken = SURFACE.replace("var pbr = base;", "var pbr = nothing_of_that_name;");
    let shader = Shader::from_wgsl(broken, "broken.wgsl");
    let shader = stage
        .app
        .world_mut()
        .resource_mut::<Assets<Shader>>()
        .add(shader);
    let mut material = stage
        .app
        .world_mut()
        .get_mut::<TerrainMaterial>(terrain)
        .unwrap();
    let good = material.shader.replace(shader);
    let broken = stage.picture("broken", eye(), 1, |_| {});
    assert!(broken.pixels().all(|pixel| pixel.0 == NOTHING));
    let mut material = stage
        .app
        .world_mut()
        .get_mut::<TerrainMaterial>(terrain)
        .unwrap();
    material.shader = good;
    let green = [what(4.0), (7, Vec4::new(0.0, 1.0, 0.0, 0.0))];
    let mended = show(&mut stage, "mended", &green, false);
    assert_eq!(bottom(&mended), [0, 255, 0]);
}

#[test]
fn a_material_that_cannot_be_read_leaves_the_default() {
    let mut stage = stage("hills");
    let terrain = stage.terrain;
    let server = stage.app.world().resource::<AssetServer>();
    let missing = server.load("shaders/no_such_file.wgsl");
    let mut terrain = stage.app.world_mut().entity_mut(terrain);
    terrain.insert(TerrainMaterial {
        shader: Some(missing),
        ..default()
    });
    stage.prop((
        DirectionalLight::default(),
        Transform::from_xyz(1.0, 1.0, 1.0).looking_at(Vec3::ZERO, Vec3::Y),
    ));
    for _ in 0..20 {
        stage.app.update();
        std::thread::sleep(std::time::Duration::from_millis(2));
    }
    let picture = stage.picture("missing_material", eye(), 1, |_| {});
    let [red, green, blue] = bottom(&picture);
    assert!(
        green > blue && red > blue && green > 40,
        "{red} {green} {blue}"
    );
}

/// The pixel in the middle of the picture's lower rim.
fn bottom(picture: &RgbImage) -> [u8; 3] {
    picture.get_pixel(SIZE[0] / 2, SIZE[1] - 2).0
}
