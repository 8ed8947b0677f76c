//! What cameras are told of their meshes is what was drawn, and buffers follow it.

mod common;

use bevy::diagnostic::{DiagnosticPath, DiagnosticsStore};
use bevy::prelude::*;
use bevy_tessera::render::{TerrainDiagnostics, TerrainStatistics, TerrainViewStatistics};
use bevy_tessera::terrain::{TerrainCamera, TerrainSettings};
use bevy_tessera::tessellate::{FACTOR_LOG2, FACTOR_ONE};
use common::gpu::{Kernels, ReadBack};

fn kernels() -> (Kernels, Transform) {
    let mut kernels = Kernels::start(TerrainSettings::default(), UVec2::new(640, 400));
    let eye = Transform::from_xyz(15e3, 900.0, 15e3).looking_to(Vec3::new(1.0, -0.3, 0.0), Vec3::Y);
    kernels.set_camera(eye, TerrainCamera::default());
    common::app::settle(&mut kernels.app, 400);
    (kernels, eye)
}

fn told(kernels: &Kernels) -> TerrainViewStatistics {
    let statistics = kernels.app.world().get::<TerrainStatistics>(kernels.camera);
    statistics.unwrap().terrains[&kernels.terrain]
}

/// The statistics that arrive within a few frames after this one.
fn counted(kernels: &mut Kernels) -> TerrainViewStatistics {
    for _ in 0..6 {
        kernels.app.update();
    }
    told(kernels)
}

/// The triangles' longest edges on the screen, in the counters' bins; with what is too near to a
/// bin's end to tell.
fn sizes(kernels: &Kernels, frame: &ReadBack) -> ([u32; 32], u32) {
    let view = &frame.factor_view;
    let eye = view.eye.as_dvec2() + view.eye_fraction.as_dvec2();
    let from_eye = |index: u32| {
        let vertex = &frame.vertices[index as usize];
        let plane = (vertex.point.as_dvec2() - eye) * f64::from(view.unit_m);
        let height = f64::from(vertex.height_m) - f64::from(view.eye_height_m);
        bevy::math::DVec3::new(plane.x, height, plane.y)
    };
    let (mut bins, mut unsure) = ([0; 32], 0);
    assert!(kernels.state().is_ready());
    for triangle in &frame.triangles {
        let points = triangle.map(|index| frame.vertices[index as usize].point);
        if points[0] == points[1] || points[1] == points[2] || points[2] == points[0] {
            continue;
        }
        let corners = triangle.map(from_eye);
        let px = (0..3)
            .map(|k| {
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                let length = (b - a).length();
                length * f64::from(view.focal_px) / (0.5 * (a + b)).length().max(0.5 * length)
            })
            .fold(0.0, f64::max);
        let place = 4.0 * px.log2() + 9.0;
        unsure += u32::from((place - place.round()).abs() < 1e-3);
        bins[place.floor().clamp(0.0, 31.0) as usize] += 1;
    }
    (bins, unsure)
}

#[test]
fn counters_say_what_was_drawn() {
    let (mut kernels, _) = kernels();
    let (app, camera) = (&mut kernels.app, kernels.camera);
    let mut statistics = app
        .world_mut()
        .get_mut::<TerrainStatistics>(camera)
        .unwrap();
    statistics.measure_triangle_sizes = true;
    let told = counted(&mut kernels);
    let frame = kernels.frame();
    assert_eq!(told.overflow, 0);
    assert_eq!(told.width_scale, 1.0);
    assert_eq!(told.vertices as usize, frame.vertices.len());
    assert_eq!(told.triangles as usize, frame.triangles.len());
    assert_eq!(told.wanted_vertices, told.vertices);
    assert_eq!(told.wanted_triangles, told.triangles);
    let counters = told.counters;
    assert_eq!(counters.faces as usize, frame.factors.len());
    assert_eq!(counters.culled_faces, 0);
    assert_eq!(counters.edges, 4 * counters.faces);
    let mut factors = [0; 28];
    for factor in frame.factors.iter().flat_map(|factors| factors.edges) {
        let octaves = (f64::from(factor) / f64::from(FACTOR_ONE)).log2();
        let octave = octaves.floor() as u32;
        let quarter = (factor >> (FACTOR_LOG2 + octave - 2)) & 3;
        factors[(4 * octave + quarter) as usize] += 1;
    }
    assert_eq!(counters.factors, factors);
    assert!(factors.iter().filter(|&&count| count > 0).count() > 4);
    assert!(told.has_triangle_sizes);
    let (bins, unsure) = sizes(&kernels, &frame);
    let differ: u32 = (0..32)
        .map(|bin| counters.triangle_sizes[bin].abs_diff(bins[bin]))
        .sum();
    assert!(differ <= 2 * unsure, "{differ} differ, {unsure} are unsure");
    assert_eq!(
        counters.triangle_sizes.iter().sum::<u32>(),
        bins.iter().sum::<u32>()
    );

    let store = kernels.app.world().resource::<DiagnosticsStore>();
    let value = |path: &DiagnosticPath| store.get(path).unwrap().value().unwrap();
    assert_eq!(value(&TerrainDiagnostics::FACES), f64::from(counters.faces));
    assert_eq!(
        value(&TerrainDiagnostics::VERTICES),
        f64::from(told.vertices)
    );
    assert_eq!(
        value(&TerrainDiagnostics::TRIANGLES),
        f64::from(told.triangles)
    );
    assert_eq!(value(&TerrainDiagnostics::OVERFLOWS), 0.0);
}

#[test]
fn edges_that_the_largest_factor_clamps_are_counted() {
    let (mut kernels, eye) = kernels();
    let clamped = TerrainCamera {
        triangle_width_px: 1.0,
        max_factor: 4.0,
        density: 0.0,
        ..default()
    };
    kernels.set_camera(eye, clamped);
    let told = counted(&mut kernels);
    let frame = kernels.frame();
    let at_limit = frame
        .factors
        .iter()
        .flat_map(|factors| factors.edges)
        .filter(|&factor| factor == 4 * FACTOR_ONE)
        .count() as u32;
    assert!(at_limit > 1000);
    assert_eq!(told.counters.clamped_edges, at_limit);
}

/// The scale is said, the mesh holds together, and as soon as the counters have come the buffer has
/// grown.
#[test]
fn a_buffer_that_was_too_small_has_grown_when_the_counters_have_come() {
    let (mut kernels, eye) = kernels();
    let fine = TerrainCamera {
        triangle_width_px: 1.0,
        density: 0.0,
        max_vertices: 1 << 23,
        ..default()
    };
    // `frame` waits for the GPU: from here on no counters are on their way but the newest.
    kernels.frame();
    kernels.frame();
    kernels.set_camera(eye, fine);
    let first = kernels.frame();
    assert!(
        first.args.scale > 0,
        "it was to be too small: {:?}",
        first.args
    );
    assert!(first.args.vertices <= first.max_vertices);
    common::manifold::check(
        kernels.state().lattice(),
        &first.vertices,
        &first.triangles,
        first.settings.partitioning,
    )
    .unwrap();
    let next = kernels.frame();
    assert_eq!(
        next.args.scale, 0,
        "{:?} in a room of {}",
        next.args, next.max_vertices
    );
    assert!(next.args.vertices > first.max_vertices);
    let told = counted(&mut kernels);
    assert_eq!((told.overflow, told.width_scale), (0, 1.0));
}

#[test]
fn past_its_budget_a_view_gets_wider_triangles_and_says_so() {
    let (mut kernels, eye) = kernels();
    let budget = 60_000;
    let tight = TerrainCamera {
        triangle_width_px: 1.0,
        density: 0.0,
        max_vertices: budget,
        ..default()
    };
    kernels.set_camera(eye, tight.clone());
    let mut overflows = 0;
    for _ in 0..12 {
        let frame = kernels.frame();
        assert!(frame.args.vertices <= budget);
        overflows += u32::from(frame.args.scale > 0);
    }
    assert!(
        (1..=4).contains(&overflows),
        "{overflows} frames were too coarse"
    );
    let told = counted(&mut kernels);
    assert!(told.width_scale > 1.5, "{}", told.width_scale);
    assert_eq!(told.overflow, 0);
    assert!(told.vertices > budget / 2, "{} of {budget}", told.vertices);
    let store = kernels.app.world().resource::<DiagnosticsStore>();
    let scale = store.get(&TerrainDiagnostics::WIDTH_SCALE).unwrap().value();
    assert_eq!(scale, Some(f64::from(told.width_scale)));

    // With a budget again, all is as wanted.
    let wide = TerrainCamera {
        max_vertices: 1 << 23,
        ..tight
    };
    kernels.set_camera(eye, wide);
    for _ in 0..6 {
        kernels.frame();
    }
    let told = counted(&mut kernels);
    assert_eq!((told.width_scale, told.overflow), (1.0, 0));
}
