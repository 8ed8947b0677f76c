//! What the pass of faces writes is what its twin in Rust says.

use super::common::gpu::Kernels;
use super::common::random::Random;
use super::unlit;
use bevy::prelude::*;
use bevy_tessera::render::TerrainOverlay;
use bevy_tessera::stream::{PAGE_BYTES, TerrainStreaming};
use bevy_tessera::terrain::{TerrainCamera, TerrainSettings, TessellationPolicy};
use bevy_tessera::tessellate::{FACTOR_ONE, FacePart, Partitioning};
use std::collections::HashSet;

#[test]
fn triangles_belong_to_the_faces_that_the_twin_says_and_parts_leave_the_errors() {
    let settings = TerrainSettings {
        leaf_level: -1,
        ..default()
    };
    let mut kernels = Kernels::start(settings, UVec2::new(96, 64));
    // Frames are to catch the field in motion.
    kernels.app.insert_resource(TerrainStreaming {
        upload_bytes_per_frame: 4 * PAGE_BYTES,
        ..default()
    });
    let overlays = unlit(&[TerrainOverlay::ErrorBound]);
    kernels
        .app
        .world_mut()
        .entity_mut(kernels.camera)
        .insert(overlays);
    let mut random = Random(23);
    let mut parts = HashSet::new();
    let mut rough = 0;
    for _ in 0..3 {
        kernels.app.update();
    }
    for n in 0..10 {
        let place = Vec3::new(
            random.unit() * 30e3,
            500.0 + random.unit().powi(2) * 3000.0,
            random.unit() * 30e3,
        );
        let camera = TerrainCamera {
            partitioning: Partitioning::ALL[n % Partitioning::ALL.len()],
            triangle_width_px: random.pick(&[2.0, 6.0]),
            density: random.pick(&[0.0, 1.0]),
            faces_per_side: random.pick(&[2, 4, 8]),
            policy: if n % 3 == 2 {
                TessellationPolicy::ScreenError { max_px: 2.0 }
            } else {
                TessellationPolicy::TriangleWidth
            },
            // Some views are brought down to fit.
            max_vertices: if n == 4 { 1 << 12 } else { 1 << 20 },
            ..default()
        };
        kernels.set_camera(Transform::from_translation(place), camera);
        let frame = kernels.frame();
        let twin = frame.twin();
        let faces_a_node = 1 << (2 * frame.lattice.faces_log2);
        let faces: Vec<_> = frame
            .nodes
            .iter()
            .flat_map(|node| (0..faces_a_node).map(|face| (*node, face)))
            .collect();
        let wanted = twin.faces(&faces, &frame.factors, frame.args.scale);
        assert_eq!(wanted.len(), frame.triangles.len());
        assert_eq!(frame.triangle_faces.len(), wanted.len());
        for (index, (gpu, cpu)) in frame.triangle_faces.iter().zip(&wanted).enumerate() {
            assert_eq!(gpu, cpu, "triangle {index} of view {n}");
            parts.insert((gpu.part, frame.settings.partitioning));
            rough += usize::from(gpu.factor > 4 * FACTOR_ONE);
        }
        for (index, (node, face)) in faces.iter().enumerate().step_by(7) {
            for part in FacePart::ALL {
                let factors = &frame.factors[index];
                if factors.culled {
                    continue;
                }
                let cpu = twin.part_error_px(node, *face, factors, frame.args.scale, part);
                let at = index * FacePart::ALL.len() + part.number() as usize;
                let gpu = frame.part_errors[at];
                // Near the eye distances, and with them pixels, are as exact as heights.
                assert!(
                    (cpu - gpu).abs() <= 0.02 * cpu.max(0.05),
                    "{part:?} of face {index} of view {n}: {cpu} px, not {gpu}"
                );
            }
        }
    }
    assert_eq!(parts.len(), 5 * Partitioning::ALL.len());
    assert!(rough > 100);
}
