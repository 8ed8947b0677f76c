//! What the compute passes write is what the functions in Rust say: integers are equal once the
//! factors, which are born as floats, are handed over; factors agree to a unit; heights agree
//! within half a stored unit.

mod common;

use bevy::prelude::*;
use bevy_tessera::detail::{DetailRule, TerrainDetail};
use bevy_tessera::stream::{PAGE_BYTES, TerrainStreaming};
use bevy_tessera::terrain::{TerrainCamera, TerrainSettings, TessellationPolicy};
use bevy_tessera::tessellate::{FaceFactors, Partitioning};
use common::gpu::{Kernels, ReadBack};
use common::random::Random;

/// Compares a frame with the twin's; returns the largest differences of factors and heights.
fn compare(frame: &ReadBack) -> (u32, f32) {
    let twin = frame.twin();
    let faces_a_node = 1 << (2 * frame.lattice.faces_log2);
    let faces: Vec<_> = frame
        .nodes
        .iter()
        .flat_map(|node| (0..faces_a_node).map(|face| (*node, face)))
        .collect();
    assert_eq!(faces.len(), frame.factors.len());
    let mut factor_difference = 0;
    for ((node, face), gpu) in faces.iter().zip(&frame.factors) {
        let cpu = twin.classify(node, *face);
        let all = |factors: &FaceFactors| factors.edges.into_iter().chain(factors.inside);
        for (a, b) in all(&cpu).zip(all(gpu)) {
            factor_difference = factor_difference.max(a.abs_diff(b));
        }
    }

    let mesh = twin.build_with(&faces, frame.factors.clone());
    assert_eq!(mesh.scale, frame.args.scale, "scale");
    assert_eq!(mesh.vertices.len(), frame.vertices.len(), "vertices");
    assert_eq!(mesh.triangles.len(), frame.triangles.len(), "triangles");
    assert_eq!(mesh.triangles, frame.triangles);
    let mut height_difference = 0.0_f32;
    for (index, (cpu, gpu)) in mesh.vertices.iter().zip(&frame.vertices).enumerate() {
        assert_eq!(cpu.point, gpu.point, "point of vertex {index}");
        assert_eq!(cpu.lambda, gpu.lambda, "level of detail of vertex {index}");
        height_difference = height_difference.max((cpu.height_m - gpu.height_m).abs());
    }
    (factor_difference, height_difference)
}

fn eye(random: &mut Random) -> Transform {
    let place = Vec3::new(
        random.unit() * 36e3 - 3e3,
        100.0 + random.unit().powi(3) * 9000.0,
        random.unit() * 38e3 - 3e3,
    );
    Transform::from_translation(place).looking_to(
        Vec3::new(random.unit() - 0.5, -random.unit(), random.unit() - 0.5),
        Vec3::Y,
    )
}

#[test]
fn vertices_and_triangles_equal_the_twins() {
    let mut random = Random(11);
    for (leaf_level, faces_per_side) in [(0, 8), (-2, 4), (0, 2)] {
        let settings = TerrainSettings {
            leaf_level,
            ..default()
        };
        let mut kernels = Kernels::start(settings, UVec2::new(96, 64));
        // Frames are to catch the field in motion.
        kernels.app.insert_resource(TerrainStreaming {
            upload_bytes_per_frame: 4 * PAGE_BYTES,
            ..default()
        });
        for n in 0..12 {
            let camera = TerrainCamera {
                partitioning: Partitioning::ALL[n % Partitioning::ALL.len()],
                triangle_width_px: random.pick(&[1.0, 3.0, 8.0]),
                density: random.pick(&[0.0, 0.6, 1.0, 1.0]),
                faces_per_side,
                policy: [
                    TessellationPolicy::TriangleWidth,
                    TessellationPolicy::ScreenError { max_px: 2.0 },
                    TessellationPolicy::TriangleWidth,
                    TessellationPolicy::ScreenError { max_px: 16.0 },
                ][n % 4],
                ..default()
            };
            // Large enough for the nearest vertices of such coarse ground to show it.
            let detail = TerrainDetail {
                amplitude_m: 30.0,
                wavelength_m: 900.0,
                rule: [
                    DetailRule::Everywhere,
                    DetailRule::Slope {
                        from_deg: 2.0,
                        to_deg: 15.0,
                    },
                    DetailRule::InverseHeight {
                        full_m: 250.0,
                        none_m: 700.0,
                    },
                ][n % 3],
                ..default()
            };
            let mut terrain = kernels.app.world_mut().entity_mut(kernels.terrain);
            if n >= 6 {
                terrain.insert(detail);
            } else {
                terrain.remove::<TerrainDetail>();
            }
            kernels.set_camera(eye(&mut random), camera);
            let frame = kernels.frame();
            assert_eq!(frame.detail.octave_count > 0, n >= 6);
            let (factors, heights) = compare(&frame);
            assert!(!frame.triangles.is_empty());
            assert!(factors <= 1, "factors differ by {factors} units");
            assert!(
                heights <= 0.5 * frame.height_step_m,
                "heights differ by {heights} m, half a stored unit is {} m",
                0.5 * frame.height_step_m
            );
        }
    }
}

#[test]
fn an_orthographic_view_has_one_level_and_equals_its_twin() {
    let mut kernels = Kernels::start(TerrainSettings::default(), UVec2::new(64, 64));
    let mut parallel = OrthographicProjection::default_3d();
    parallel.scaling_mode = bevy::camera::ScalingMode::FixedVertical {
        viewport_height: 6000.0,
    };
    parallel.far = 20e3;
    let (app, camera) = (&mut kernels.app, kernels.camera);
    app.world_mut()
        .entity_mut(camera)
        .insert(Projection::Orthographic(parallel));
    let down = Transform::from_xyz(15e3, 5e3, 15e3).looking_to(Vec3::NEG_Y, Vec3::NEG_Z);
    kernels.set_camera(down, TerrainCamera::default());
    for _ in 0..3 {
        let frame = kernels.frame();
        assert_eq!(frame.levels(), 1);
        compare(&frame);
    }
}

#[test]
fn a_view_that_wants_more_than_its_buffers_hold_is_brought_down_as_a_whole() {
    let mut kernels = Kernels::start(TerrainSettings::default(), UVec2::new(512, 512));
    let eye = Transform::from_xyz(15e3, 900.0, 15e3).looking_to(Vec3::new(1.0, -0.3, 0.0), Vec3::Y);
    let wide = TerrainCamera {
        triangle_width_px: 1.0,
        density: 0.0,
        max_vertices: 1 << 22,
        ..default()
    };
    kernels.set_camera(eye, wide.clone());
    common::app::settle(&mut kernels.app, 400);
    let whole = kernels.frame();
    assert_eq!(whole.args.scale, 0);
    let tight = TerrainCamera {
        max_vertices: whole.args.vertices / 3,
        ..wide
    };
    kernels.set_camera(eye, tight);
    let frame = kernels.frame();
    assert!(frame.args.scale > 0);
    assert!(frame.args.vertices <= whole.args.vertices / 3);
    assert_eq!(frame.args.wanted_vertices, whole.args.vertices);
    compare(&frame);
    let state = kernels.state();
    common::manifold::check(
        state.lattice(),
        &frame.vertices,
        &frame.triangles,
        frame.settings.partitioning,
    )
    .unwrap();
}
