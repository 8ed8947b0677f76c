//! Culling may only drop what no view sees.

mod common;

use bevy::camera::primitives::Frustum;
use bevy::math::primitives::ViewFrustum;
use bevy::prelude::*;
use bevy_tessera::bake::{BakeSettings, MemorySource, bake};
use bevy_tessera::lattice::Node;
use bevy_tessera::render::{NodeCulling, TerrainNodes, TileHeightBounds, select_seen};
use bevy_tessera::stream::{PAGE_BYTES, TerrainStreaming};
use bevy_tessera::terrain::{TerrainCamera, TerrainSettings};
use bevy_tessera::tessellate::{Face, FaceCulling, LocalVolume, ViewMesh};
use bevy_tessera::view::TerrainViews;
use common::gpu::{Culled, Kernels};
use common::random::Random;
use std::collections::HashSet;
use std::path::Path;

#[test]
fn no_dropped_node_reaches_into_the_frustum() {
    let settings = TerrainSettings {
        leaf_level: -1,
        ..default()
    };
    let mut kernels = Kernels::start(settings, UVec2::new(96, 64));
    // Frames while tiles stream in are culled by looser boxes; both are to be seen.
    kernels.app.insert_resource(TerrainStreaming {
        upload_bytes_per_frame: 8 * PAGE_BYTES,
        ..default()
    });
    // A terrain that is moved, turned and scaled is culled in its own space.
    let placed = Transform::from_xyz(-300.0, 50.0, 900.0)
        .with_rotation(Quat::from_euler(EulerRot::YXZ, 0.6, 0.05, -0.04))
        .with_scale(Vec3::splat(0.7));
    let terrain = kernels.terrain;
    kernels.app.world_mut().entity_mut(terrain).insert(placed);

    let mut random = Random(23);
    let (mut dropped_count, mut kept_count) = (0, 0);
    for n in 0..40 {
        let place = placed.transform_point(Vec3::new(
            random.unit() * 30e3,
            250.0 + random.unit() * 2000.0,
            random.unit() * 30e3,
        ));
        let towards = Vec3::new(
            random.unit() - 0.5,
            random.unit() * 0.8 - 0.7,
            random.unit() - 0.5,
        );
        let eye = Transform::from_translation(place).looking_to(towards, Vec3::Y);
        kernels.set_camera(eye, TerrainCamera::default());
        let frame = kernels.frame();
        let world = kernels.app.world();
        let state = kernels.state();
        let view = *world
            .get::<TerrainViews>(kernels.camera)
            .unwrap()
            .of(terrain)
            .unwrap();
        let frustum = world.get::<Frustum>(kernels.camera).unwrap();
        let far = ViewFrustum::FAR_PLANE_IDX;
        let volume = LocalVolume::new(frustum, &view.world_from_local, Some(far));
        let mut seen = Vec::new();
        let bounds = TileHeightBounds::new(state.manifest());
        select_seen(state, &bounds, &view.lod, &[volume], &mut seen);
        let seen: HashSet<_> = seen.into_iter().collect();
        let twin = frame.twin();
        let unit_m = state.lattice().unit_m(state.manifest().file.spacing_m);
        kept_count += seen.len();
        for node in frame.nodes.iter().filter(|node| !seen.contains(node)) {
            dropped_count += 1;
            // All on the outer side of one plane: then no triangle crosses the frustum either.
            let vertices: Vec<_> = twin
                .build(std::slice::from_ref(node))
                .vertices
                .iter()
                .map(|vertex| {
                    let plane = vertex.point.as_dvec2() * unit_m;
                    let local =
                        bevy::math::DVec3::new(plane.x, f64::from(vertex.height_m), plane.y);
                    view.world_from_local.transform_point3(local)
                })
                .collect();
            let outside = frustum.half_spaces[..far].iter().any(|plane| {
                let plane = plane.normal_d().as_dvec4();
                vertices
                    .iter()
                    .all(|vertex| plane.truncate().dot(*vertex) + plane.w < 0.0)
            });
            assert!(outside, "eye {n}: {node:?} was dropped and may be seen");
        }
    }
    assert!(
        dropped_count > 100,
        "only {dropped_count} nodes were dropped at all"
    );
    assert!(kept_count > 100, "only {kept_count} nodes were kept at all");
}

/// Faces of nodes that are drawn, and culled by the passes: the twin agrees, and none may be seen.
#[test]
fn no_culled_face_reaches_into_the_frustum() {
    let mut kernels = Kernels::start(TerrainSettings::default(), UVec2::new(96, 64));
    kernels.app.insert_resource(Culled);
    let mut random = Random(29);
    let (mut culled_count, mut kept_count) = (0, 0);
    for n in 0..30 {
        let place = Vec3::new(
            random.unit() * 30e3,
            250.0 + random.unit() * 1500.0,
            random.unit() * 30e3,
        );
        let towards = Vec3::new(
            random.unit() - 0.5,
            random.unit() * 0.6 - 0.5,
            random.unit() - 0.5,
        );
        let eye = Transform::from_translation(place).looking_to(towards, Vec3::Y);
        kernels.set_camera(eye, TerrainCamera::default());
        let frame = kernels.frame();
        let world = kernels.app.world();
        let drawn = world.get::<TerrainNodes>(kernels.camera).unwrap();
        let NodeCulling { heights_m, volumes } = &drawn.culling[&kernels.terrain];
        assert_eq!(heights_m.len(), frame.nodes.len());
        let of_node = |node: &Node| {
            let at = frame.nodes.iter().position(|other| other == node).unwrap();
            heights_m[at]
        };
        let twin = ViewMesh {
            culling: Some(FaceCulling {
                volumes,
                heights_m: &of_node,
            }),
            ..frame.twin()
        };
        // Culled faces have no factors; these are what they would have.
        let unculled = frame.twin();
        let faces = frame.factors.len() / frame.nodes.len();
        let unit_m = twin.factor_view.unit_m;
        let mut disagree = 0;
        for (at, factors) in frame.factors.iter().enumerate() {
            let (node, number) = (&frame.nodes[at / faces], (at % faces) as u32);
            disagree += usize::from(twin.classify(node, number).culled != factors.culled);
            if !factors.culled {
                kept_count += 1;
                continue;
            }
            culled_count += 1;
            let face = Face {
                corners: twin.corners(node, number),
                factors: unculled.classify(node, number),
                partitioning: twin.partitioning,
            };
            let counts = face.counts();
            let vertices: Vec<Vec4> = (0..counts.vertices())
                .map(|index| {
                    let vertex = twin.vertex(&face.vertex(&counts, index), node.level);
                    let plane = vertex.point.as_vec2() * unit_m;
                    Vec4::new(plane.x, vertex.height_m, plane.y, 1.0)
                })
                .collect();
            for volume in volumes {
                let outside = volume
                    .planes()
                    .iter()
                    .any(|plane| vertices.iter().all(|vertex| plane.dot(*vertex) < 0.0));
                assert!(outside, "eye {n}: face {at} was culled and may be seen");
            }
        }
        assert!(
            disagree <= 1,
            "{disagree} faces are culled on one side only"
        );
        let drawn: usize = frame.factors.iter().filter(|face| !face.culled).count();
        let mesh = twin.build(&frame.nodes);
        assert!(mesh.vertices.len() >= drawn * 4);
    }
    assert!(
        culled_count > 1_000,
        "only {culled_count} faces were culled"
    );
    assert!(kept_count > 2_000, "only {kept_count} faces were kept");
}

/// Ground of 513² samples, 4 m apart: flat, or with a hill of 800 m in its far half.
fn bake_ground(out: &Path, has_hill: bool) {
    let height_m = |x: f32, z: f32| {
        let away = Vec2::new(x - 400.0, z - 256.0).length();
        if has_hill {
            (800.0 - 8.0 * away).max(0.0)
        } else {
            0.0
        }
    };
    let heights = (0..513 * 513)
        .map(|at| height_m((at % 513) as f32, (at / 513) as f32))
        .collect();
    let mut source = MemorySource::new([513, 513], heights).unwrap();
    let settings = BakeSettings {
        spacing_m: Some(4.0),
        // The same scale for both.
        height_range_m: Some(-100.0..=1000.0),
        force: true,
        ..default()
    };
    bake(&mut source, out, &settings, &()).unwrap();
}

#[test]
fn ground_that_is_baked_higher_is_seen() {
    let folder = tempfile::tempdir().unwrap();
    let ground = folder.path().join("ground");
    bake_ground(&ground, false);
    let app = common::app::app(folder.path(), false);
    let settings = TerrainSettings::default();
    let size = UVec2::new(64, 64);
    let mut kernels = Kernels::start_in(app, "ground/terrain.ron", settings, size);
    kernels.app.insert_resource(Culled);
    // Level, 400 m above the plain, with a narrow view: nothing but a hill can be in it.
    let eye = Transform::from_xyz(200.0, 400.0, 1024.0).looking_to(Vec3::X, Vec3::Y);
    kernels.set_camera(eye, TerrainCamera::default());
    let narrow = PerspectiveProjection {
        fov: 0.2,
        ..default()
    };
    let camera = kernels.camera;
    let mut camera = kernels.app.world_mut().entity_mut(camera);
    camera.insert(Projection::Perspective(narrow));
    let seen = |kernels: &mut Kernels| {
        kernels.app.update();
        let nodes = kernels
            .app
            .world()
            .get::<TerrainNodes>(kernels.camera)
            .unwrap();
        nodes.nodes.get(&kernels.terrain).map_or(0, Vec::len)
    };
    for _ in 0..100 {
        seen(&mut kernels);
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    assert_eq!(seen(&mut kernels), 0, "the plain is below the view");
    bake_ground(&ground, true);
    let server = kernels.app.world().resource::<AssetServer>();
    server.reload("ground/terrain.ron");
    let shows = (0..1000).any(|_| {
        std::thread::sleep(std::time::Duration::from_millis(1));
        seen(&mut kernels) > 0
    });
    assert!(shows, "the hill is culled by what was there before");
    common::app::settle(&mut kernels.app, 2000);
    assert!(seen(&mut kernels) > 0, "nor does it go again");
}
