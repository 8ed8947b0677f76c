//! A held eye: what follows it stays while the other point moves.

mod common;

use bevy::camera::Camera3dDepthLoadOp;
use bevy::camera::primitives::Frustum;
use bevy::prelude::*;
use bevy::render::RenderApp;
use bevy::render::view::ExtractedView;
use bevy_tessera::lattice::Node;
use bevy_tessera::render::TerrainNodes;
use bevy_tessera::stream::TerrainTiles;
use bevy_tessera::terrain::{TerrainCamera, TerrainSettings};
use bevy_tessera::tile::TileAddress;
use bevy_tessera::view::{HeldTerrainEye, TerrainEye, TerrainViews};
use common::gpu::{Culled, Kernels, ReadBack};
use common::random::Random;
use common::scene::{self, Scene};
use common::stage::{self, Stage};
use std::collections::BTreeSet;

/// Where tests begin.
fn start() -> Transform {
    Transform::from_xyz(15e3, 900.0, 15e3).looking_to(Vec3::new(1.0, -0.3, 0.2), Vec3::Y)
}

/// A camera at the start, culled, with a sun that throws shadows, all streamed in.
fn kernels() -> Kernels {
    let mut kernels = Kernels::start(TerrainSettings::default(), UVec2::new(96, 64));
    kernels.app.insert_resource(Culled);
    kernels.app.world_mut().spawn((
        DirectionalLight {
            shadow_maps_enabled: true,
            ..default()
        },
        Transform::default().looking_to(Vec3::new(-1.0, -0.6, 0.3), Vec3::Y),
    ));
    kernels.set_camera(start(), TerrainCamera::default());
    for _ in 0..3 {
        kernels.app.update();
    }
    common::app::settle(&mut kernels.app, 2000);
    // The velocity of having come here fades.
    for _ in 0..20 {
        kernels.app.update();
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
    common::app::settle(&mut kernels.app, 2000);
    kernels
}

impl Held for Kernels {
    fn set(&mut self, value: impl Bundle) {
        let camera = self.camera;
        self.app.world_mut().entity_mut(camera).insert(value);
    }

    fn place(&self) -> GlobalTransform {
        *self.app.world().get(self.camera).unwrap()
    }

    fn held(&self) -> Option<HeldTerrainEye> {
        self.app.world().get(self.camera).copied()
    }
}

trait Held {
    fn set(&mut self, value: impl Bundle);
    fn place(&self) -> GlobalTransform;
    fn held(&self) -> Option<HeldTerrainEye>;
}

/// Everything that may follow from a level of detail, bit for bit.
#[derive(Debug, PartialEq)]
struct Frozen {
    vertices: Vec<[u32; 4]>,
    triangles: Vec<[u32; 3]>,
    nodes: Vec<Node>,
    tiles: BTreeSet<TileAddress>,
}

fn frozen(kernels: &mut Kernels) -> Frozen {
    let frame = kernels.frame();
    Frozen::new(kernels, &frame)
}

impl Frozen {
    fn new(kernels: &Kernels, frame: &ReadBack) -> Self {
        let world = kernels.app.world();
        let tiles = world.get::<TerrainTiles>(kernels.terrain).unwrap();
        let bits = frame.vertices.iter().map(|vertex| {
            [
                vertex.point.x.cast_unsigned(),
                vertex.point.y.cast_unsigned(),
                vertex.height_m.to_bits(),
                vertex.lambda.cast_unsigned(),
            ]
        });
        Self {
            vertices: bits.collect(),
            triangles: frame.triangles.clone(),
            nodes: frame.nodes.clone(),
            tiles: tiles
                .iter()
                .map(|tile| *world.get::<TileAddress>(tile).unwrap())
                .collect(),
        }
    }

    /// Says where two differ rather than printing both.
    fn assert_same(&self, other: &Self, what: &str) {
        assert_eq!(self.nodes, other.nodes, "{what}: nodes");
        assert_eq!(self.tiles, other.tiles, "{what}: tiles");
        assert!(self.vertices == other.vertices, "{what}: vertices");
        assert!(self.triangles == other.triangles, "{what}: triangles");
    }
}

fn anywhere(random: &mut Random) -> Transform {
    let place = Vec3::new(
        random.unit() * 30e3,
        250.0 + random.unit() * 3000.0,
        random.unit() * 30e3,
    );
    let towards = Vec3::new(
        random.unit() - 0.5,
        random.unit() * 0.8 - 0.7,
        random.unit() - 0.5,
    );
    Transform::from_translation(place).looking_to(towards, Vec3::Y)
}

#[test]
fn a_frozen_mesh_stays_bit_for_bit_while_the_eye_flies() {
    let mut kernels = kernels();
    let before = frozen(&mut kernels);
    assert!(before.nodes.len() > 4 && before.vertices.len() > 500);
    kernels.set(TerrainEye::EyeOnly);
    before.assert_same(&frozen(&mut kernels), "when it is set");
    let mut random = Random(7);
    let place = start();
    for frame in 0..100 {
        // Steps and jumps.
        let to = if frame % 10 == 9 {
            anywhere(&mut random)
        } else {
            let along = Vec3::new(random.unit(), random.unit(), random.unit()) * 200.0;
            place.with_translation(place.translation + along)
        };
        kernels.set(to);
        let now = frozen(&mut kernels);
        before.assert_same(&now, &format!("frame {frame}"));
        assert_eq!(kernels.place(), to.into(), "the picture moves freely");
        let held = kernels.held().unwrap();
        assert_eq!(held.lod, start().into());
        assert_eq!(held.eye, to.into());
    }
    let views = kernels.app.world().get::<TerrainViews>(kernels.camera);
    let view = views.unwrap().of(kernels.terrain).unwrap();
    assert!(
        view.velocity_m_s.length() < 1.0,
        "a frozen eye moves at {}",
        view.velocity_m_s
    );
}

#[test]
fn a_frozen_mesh_stays_bit_for_bit_while_lamps_on_the_camera_fly_along() {
    let mut kernels = kernels();
    let camera = kernels.camera;
    let world = kernels.app.world_mut();
    let spot = SpotLight {
        range: 4000.0,
        outer_angle: 0.5,
        shadow_maps_enabled: true,
        ..default()
    };
    // Behind the camera.
    let back = Transform::default().looking_to(Vec3::Z, Vec3::Y);
    let spot = world.spawn((spot, back, ChildOf(camera))).id();
    let point = PointLight {
        range: 600.0,
        shadow_maps_enabled: true,
        ..default()
    };
    let point = world.spawn((point, ChildOf(camera))).id();
    for _ in 0..3 {
        kernels.app.update();
    }
    common::app::settle(&mut kernels.app, 2000);
    let lit = frozen(&mut kernels);
    kernels.set(TerrainEye::EyeOnly);
    lit.assert_same(&frozen(&mut kernels), "when it is set");
    let mut random = Random(29);
    for frame in 0..20 {
        kernels.set(anywhere(&mut random));
        lit.assert_same(&frozen(&mut kernels), &format!("frame {frame}"));
    }
    kernels.set((TerrainEye::EyeAndLod, start()));
    for lamp in [spot, point] {
        kernels.app.world_mut().despawn(lamp);
    }
    kernels.app.update();
    let dark = frozen(&mut kernels);
    assert!(dark.nodes.len() < lit.nodes.len(), "the lamps saw nothing");
}

#[test]
fn a_frozen_mesh_keeps_the_projection_and_the_height_in_pixels() {
    let mut kernels = kernels();
    let before = frozen(&mut kernels);
    kernels.set(TerrainEye::EyeOnly);
    kernels.app.update();
    kernels.set(Projection::from(PerspectiveProjection {
        fov: 0.2,
        ..default()
    }));
    before.assert_same(&frozen(&mut kernels), "another projection");
    let larger = common::app::target(&mut kernels.app, 300, 200);
    kernels.set(common::app::into_image(&larger));
    kernels.app.update();
    before.assert_same(&frozen(&mut kernels), "a larger picture");
    // Settings are the camera's still.
    kernels.set(TerrainCamera {
        triangle_width_px: 60.0,
        ..default()
    });
    let coarser = frozen(&mut kernels);
    assert!(coarser.vertices.len() < before.vertices.len());
}

/// What Bevy draws from.
fn drawn_from(kernels: &mut Kernels) -> (GlobalTransform, Frustum) {
    let camera = kernels.camera;
    let render = kernels.app.sub_app_mut(RenderApp).world_mut();
    let mut views = render.query::<&ExtractedView>();
    let of_camera = |view: &&ExtractedView| {
        view.retained_view_entity.main_entity.id() == camera
            && view.retained_view_entity.subview_index == 0
            && view.retained_view_entity.auxiliary_entity.id() == Entity::PLACEHOLDER
    };
    let place = views.iter(render).find(of_camera).unwrap().world_from_view;
    (place, *kernels.app.world().get(camera).unwrap())
}

#[test]
fn the_picture_stays_while_the_level_of_detail_moves() {
    let mut kernels = kernels();
    let before = frozen(&mut kernels);
    let (view, frustum) = drawn_from(&mut kernels);
    let planes = |frustum: &Frustum| frustum.half_spaces.map(|plane| plane.normal_d());
    kernels.set(TerrainEye::LodOnly);
    before.assert_same(&frozen(&mut kernels), "when it is set");
    let mut random = Random(9);
    let mut changed = 0;
    for _ in 0..20 {
        let to = anywhere(&mut random);
        kernels.set(to);
        let now = frozen(&mut kernels);
        changed += usize::from(now.nodes != before.nodes);
        let (place, now) = drawn_from(&mut kernels);
        assert_eq!(place, view);
        assert_eq!(planes(&now), planes(&frustum));
        assert_eq!(kernels.place(), view);
        let held = kernels.held().unwrap();
        assert_eq!((held.eye, held.lod), (view, to.into()));
        // Nor does it drift while nothing is touched.
        kernels.app.update();
        assert_eq!(drawn_from(&mut kernels).0, view);
    }
    assert!(changed > 15, "only {changed} meshes changed");
}

/// The level of detail's eye, in metres.
fn lod_eye(kernels: &Kernels) -> Vec3 {
    let views = kernels.app.world().get::<TerrainViews>(kernels.camera);
    views.unwrap().of(kernels.terrain).unwrap().eye_m.as_vec3()
}

#[test]
fn going_back_puts_both_points_where_the_transform_is_in_the_same_frame() {
    let mut kernels = kernels();
    let mut random = Random(11);
    for eye in [TerrainEye::EyeOnly, TerrainEye::LodOnly] {
        for removed in [false, true] {
            kernels.set(start());
            kernels.app.update();
            kernels.set(eye);
            kernels.app.update();
            let to = anywhere(&mut random);
            kernels.set(to);
            kernels.app.update();
            assert!(kernels.held().is_some());
            if removed {
                let camera = kernels.camera;
                let mut camera = kernels.app.world_mut().entity_mut(camera);
                camera.remove::<TerrainEye>();
            } else {
                kernels.set(TerrainEye::EyeAndLod);
            }
            kernels.app.update();
            assert_eq!(kernels.place(), to.into(), "{eye:?}");
            assert_eq!(lod_eye(&kernels), to.translation, "{eye:?}");
            assert_eq!(drawn_from(&mut kernels).0, to.into(), "{eye:?}");
            assert_eq!(kernels.held(), None);
        }
    }
}

#[test]
fn what_is_not_moved_stays_where_the_last_picture_was_taken() {
    let mut kernels = kernels();
    let to = anywhere(&mut Random(13));
    // Set and moved in one frame.
    kernels.set((TerrainEye::EyeOnly, to));
    kernels.app.update();
    assert_eq!(lod_eye(&kernels), start().translation);
    assert_eq!(kernels.place(), to.into());
    kernels.set((TerrainEye::EyeAndLod, start()));
    kernels.app.update();
    kernels.set((TerrainEye::LodOnly, to));
    kernels.app.update();
    assert_eq!(lod_eye(&kernels), to.translation);
    assert_eq!(kernels.place(), start().into());
}

#[test]
fn switching_between_held_points_leaves_both_where_they_are() {
    for parented in [false, true] {
        let mut kernels = kernels();
        let mut place = start();
        if parented {
            let vehicle = Transform::from_xyz(14e3, 500.0, 14e3)
                .with_rotation(Quat::from_rotation_y(0.7))
                .with_scale(Vec3::splat(2.0));
            let vehicle = kernels.app.world_mut().spawn(vehicle).id();
            kernels.set(ChildOf(vehicle));
            place = Transform::from_xyz(100.0, 200.0, 50.0).looking_to(Vec3::X, Vec3::Y);
            kernels.set(place);
            kernels.app.update();
        }
        kernels.app.update();
        kernels.set(TerrainEye::EyeOnly);
        kernels.app.update();
        let moved = Transform {
            translation: place.translation + Vec3::new(150.0, 80.0, -30.0),
            ..place.looking_to(Vec3::new(-1.0, -0.4, 0.1), Vec3::Y)
        };
        kernels.set(moved);
        kernels.app.update();
        let there = kernels.held().unwrap();
        assert_ne!(there.lod, there.eye);
        for eye in [
            TerrainEye::LodOnly,
            TerrainEye::EyeOnly,
            TerrainEye::LodOnly,
        ] {
            kernels.set(eye);
            kernels.app.update();
            let held = kernels.held().unwrap();
            assert_eq!((held.lod, held.eye), (there.lod, there.eye), "{eye:?}");
            assert_eq!(kernels.place(), there.eye, "{eye:?}");
            assert_eq!(drawn_from(&mut kernels).0, there.eye, "{eye:?}");
            assert_eq!(lod_eye(&kernels), there.lod.translation(), "{eye:?}");
        }
        // Now the Transform moves the level of detail, from where it is.
        let camera = kernels.camera;
        let at = *kernels.app.world().get::<Transform>(camera).unwrap();
        let far = (at.translation - place.translation).length();
        assert!(far < 0.01, "the Transform is {far} beside the held place");
    }
}

#[test]
fn a_parented_camera_is_held_in_the_world() {
    let mut kernels = kernels();
    let vehicle = |x: f32| Transform::from_xyz(x, 500.0, 14e3);
    let parent = kernels.app.world_mut().spawn(vehicle(14e3)).id();
    let seat = Transform::from_xyz(0.0, 300.0, 0.0).looking_to(Vec3::X, Vec3::Y);
    kernels.set((ChildOf(parent), seat));
    let camera = kernels.camera;
    let lamp = kernels
        .app
        .world_mut()
        .spawn((Transform::from_xyz(0.0, 0.0, -1.0), ChildOf(camera)));
    let lamp = lamp.id();
    kernels.app.update();
    let first = kernels.place();
    let place_of = |kernels: &Kernels, entity| {
        let place: &GlobalTransform = kernels.app.world().get(entity).unwrap();
        place.translation()
    };
    for eye in [TerrainEye::EyeOnly, TerrainEye::LodOnly] {
        kernels
            .app
            .world_mut()
            .entity_mut(parent)
            .insert(vehicle(14e3));
        kernels.set(TerrainEye::EyeAndLod);
        kernels.app.update();
        kernels.set(eye);
        for step in 1..6 {
            let x = 14e3 + 100.0 * step as f32;
            kernels
                .app
                .world_mut()
                .entity_mut(parent)
                .insert(vehicle(x));
            // What hangs on the camera may move by itself: it is at the camera's Transform always.
            let nod = Transform::from_xyz(0.0, 0.0, -1.0 - step as f32);
            if step % 2 == 0 {
                kernels.app.world_mut().entity_mut(lamp).insert(nod);
            }
            kernels.app.update();
            let moved = first.translation() + Vec3::X * 100.0 * step as f32;
            let (lod, eye_place) = (lod_eye(&kernels), kernels.place().translation());
            let expected = if eye == TerrainEye::EyeOnly {
                (first.translation(), moved)
            } else {
                (moved, first.translation())
            };
            assert_eq!((lod, eye_place), expected, "{eye:?}, step {step}");
            let local = kernels.app.world().get::<Transform>(lamp).unwrap();
            let ahead = moved + Vec3::X * -local.translation.z;
            assert!(place_of(&kernels, lamp).distance(ahead) < 0.01);
            // A frame in which only the lamp moves.
            kernels
                .app
                .world_mut()
                .get_mut::<Transform>(lamp)
                .unwrap()
                .translation
                .z = -3.0;
            kernels.app.update();
            assert!(place_of(&kernels, lamp).distance(moved + Vec3::X * 3.0) < 0.01);
        }
    }
}

#[test]
fn without_a_hold_nothing_changes() {
    let mut kernels = kernels();
    let mut random = Random(17);
    let see = |kernels: &mut Kernels, to: Transform| {
        kernels.set(to);
        let frame = kernels.frame();
        let view = *kernels
            .app
            .world()
            .get::<TerrainViews>(kernels.camera)
            .unwrap()
            .of(kernels.terrain)
            .unwrap();
        (
            Frozen::new(kernels, &frame),
            view.eye_m,
            kernels.place(),
            frame.factor_view.focal_px,
        )
    };
    for _ in 0..5 {
        let to = anywhere(&mut random);
        kernels.set(TerrainEye::EyeAndLod);
        for _ in 0..3 {
            see(&mut kernels, to);
        }
        common::app::settle(&mut kernels.app, 2000);
        let with = see(&mut kernels, to);
        assert_eq!(kernels.held(), None);
        let camera = kernels.camera;
        let mut camera = kernels.app.world_mut().entity_mut(camera);
        camera.remove::<TerrainEye>();
        let without = see(&mut kernels, to);
        with.0.assert_same(&without.0, "the component alone");
        assert_eq!((with.1, with.2, with.3), (without.1, without.2, without.3));
    }
}

#[test]
fn a_camera_may_be_spawned_and_despawned_while_it_is_held() {
    let mut kernels = kernels();
    for eye in [TerrainEye::EyeOnly, TerrainEye::LodOnly] {
        let target = common::app::target(&mut kernels.app, 64, 64);
        let camera = (
            Camera3d {
                depth_load_op: Camera3dDepthLoadOp::default(),
                ..default()
            },
            Msaa::Off,
            TerrainCamera::default(),
            common::app::into_image(&target),
            start(),
            eye,
        );
        let camera = kernels.app.world_mut().spawn(camera).id();
        kernels.app.update();
        let held: HeldTerrainEye = *kernels.app.world().get(camera).unwrap();
        assert_eq!(held.lod, start().into());
        assert_eq!(held.eye, start().into());
        let to = anywhere(&mut Random(19));
        kernels.app.world_mut().entity_mut(camera).insert(to);
        kernels.app.update();
        let held: HeldTerrainEye = *kernels.app.world().get(camera).unwrap();
        let stays = if eye == TerrainEye::EyeOnly {
            held.lod
        } else {
            held.eye
        };
        assert_eq!(stays, start().into(), "{eye:?}");
        // It sees what a camera at that place sees.
        let clip: Mat4 = kernels
            .app
            .world()
            .get::<Camera>(camera)
            .unwrap()
            .clip_from_view();
        assert_eq!(held.clip_from_lod_view, clip);
        let nodes = kernels.app.world().get::<TerrainNodes>(camera).unwrap();
        assert!(!nodes.nodes[&kernels.terrain].is_empty());
        kernels.app.world_mut().despawn(camera);
        for _ in 0..3 {
            kernels.app.update();
        }
    }
    // The other camera is what it was.
    assert_eq!(lod_eye(&kernels), start().translation);
}

#[test]
fn seen_from_beside_the_frozen_ground_has_no_holes() {
    let scene = Scene::new(scene::hills);
    let assets = scene::assets_with_hills("held_eye");
    let size = [400, 300];
    let mut stage = Stage::new("held_eye", &assets, "hills/terrain.ron", size);
    let from = Transform::from_translation(scene.ground(150.0, 600.0) + Vec3::Y * 40.0)
        .looking_at(scene.ground(450.0, 250.0), Vec3::Y);
    let camera = stage.aim(from, |_| ());
    stage.shoot("ahead", 2);
    let beside = Transform::from_translation(scene.ground(700.0, 620.0) + Vec3::Y * 180.0)
        .looking_at(scene.ground(380.0, 330.0), Vec3::Y);
    let world = stage.app.world_mut();
    world
        .entity_mut(camera)
        .insert((TerrainEye::EyeOnly, beside));
    let picture = stage.shoot("beside", 2);
    let covered = stage::covered(&picture);
    let hits = scene.look(&beside, size);
    let held: HeldTerrainEye = *stage.app.world().get(camera).unwrap();
    let clip_from_world = held.clip_from_lod_view * held.lod.to_matrix().inverse();
    // Where the middle of a pixel and all around it is ground that the frozen eye saw.
    let frozen = |index: usize, margin: f32| {
        hits[index].is_some_and(|hit| {
            let clip = clip_from_world * hit.point.extend(1.0);
            clip.w > 1.0 && clip.xy().abs().max_element() < margin * clip.w
        })
    };
    let inside = scene::interior(size, |index| frozen(index, 0.98))
        .into_iter()
        .filter(|&index| frozen(index, 0.98));
    let inside: Vec<_> = inside
        .filter(|&index| scene::covered_around(&hits, size, index, 40.0))
        .collect();
    assert!(inside.len() > 10_000, "{} pixels in view", inside.len());
    let holes = inside.iter().filter(|&&index| !covered[index]).count();
    assert_eq!(holes, 0, "of {} pixels", inside.len());
    // And ground that it didn't see is missing: else this picture would prove nothing.
    let missing = (0..hits.len())
        .filter(|&index| hits[index].is_some() && !frozen(index, 1.5) && !covered[index])
        .count();
    assert!(missing > 2_000, "only {missing} pixels show nothing");
}

#[test]
fn a_held_picture_has_no_holes_wherever_the_level_of_detail_goes() {
    let scene = Scene::new(scene::hills);
    let assets = scene::assets_with_hills("held_picture");
    let size = [400, 300];
    let mut stage = Stage::new("held_eye", &assets, "hills/terrain.ron", size);
    let from = Transform::from_translation(scene.ground(150.0, 600.0) + Vec3::Y * 40.0)
        .looking_at(scene.ground(450.0, 250.0), Vec3::Y);
    let camera = stage.aim(from, |_| ());
    let before = stage::covered(&stage.shoot("picture_before", 2));
    let hits = scene.look(&from, size);
    // Ground whose rim may not come and go with its level of detail.
    let inside: Vec<_> = scene::interior(size, |index| before[index])
        .into_iter()
        .filter(|&index| before[index] && scene::covered_around(&hits, size, index, 40.0))
        .collect();
    assert!(inside.len() > 10_000, "{} pixels of ground", inside.len());
    let aside = Transform::from_translation(scene.ground(300.0, 450.0) + Vec3::Y * 60.0)
        .looking_to(Vec3::new(-1.0, -0.2, 0.8), Vec3::Y);
    let world = stage.app.world_mut();
    world
        .entity_mut(camera)
        .insert((TerrainEye::LodOnly, aside));
    let held = stage::covered(&stage.shoot("picture_held", 2));
    let holes = inside.iter().filter(|&&index| !held[index]).count();
    assert_eq!(holes, 0, "of {} pixels", inside.len());
}
