//! Settings as Rust code.

use super::panel_settings_support::{Everything, Panel, copied};
use super::{comparing, settings_panel, views_panel};
use bevy::prelude::*;
use bevy_tessera::density::{DensityBorder, DensityFilter, DensitySettings};
use bevy_tessera::detail::{DetailRule, TerrainDetail};
use bevy_tessera::edit::mask::MaskSettings;
use bevy_tessera::gizmos::TerrainGizmos;
use bevy_tessera::lattice::LodSettings;
use bevy_tessera::physics::TerrainPhysics;
use bevy_tessera::render::{
    ComparisonView, TerrainComparison, TerrainDensityPreview, TerrainMaterial, TerrainOverlay,
    TerrainOverlays,
};
use bevy_tessera::stream::TerrainStreaming;
use bevy_tessera::terrain::{TerrainCamera, TerrainSettings, TessellationPolicy};
use bevy_tessera::tessellate::Partitioning;
use bevy_tessera::view::TerrainEye;

/// Values, each with the very code that makes it: what is compared with this text compiles, and makes
/// this value.
macro_rules! fixtures {
    ($($value:expr),* $(,)?) => {
        [$(($value, stringify!($value))),*]
    };
}

/// Code without comments and space.
fn bare(code: &str) -> String {
    let lines = code
        .lines()
        .filter(|line| !line.trim_start().starts_with("//"));
    lines
        .flat_map(str::chars)
        .filter(|char| !char.is_whitespace())
        .collect()
}

fn check_code<T: Clone>(
    panel: &mut Panel,
    group: &str,
    fixtures: impl IntoIterator<Item = (T, &'static str)>,
    set: fn(&mut Everything, T),
) {
    for (value, code) in fixtures {
        let mut all = Everything::new();
        set(&mut all, value);
        panel.state_mut().set(&all);
        panel.run();
        let text = copied(panel, &format!("copy as Rust: {group}"));
        assert_eq!(bare(&text), bare(code), "{text}");
        assert!(text.starts_with("// use bevy"), "{text}");
        assert_eq!(panel.state().everything(), all, "copying changes nothing");
    }
}

#[test]
#[expect(
    clippy::needless_update,
    reason = "as it is copied, also where every field differs"
)]
#[rustfmt::skip]
fn copied_code_makes_the_value_that_is_shown() {
    let mut panel = settings_panel();
    check_code(&mut panel, "Camera", fixtures![
        TerrainCamera::default(),
        TerrainCamera { density: 0.25, ..default() },
        TerrainCamera { policy: TessellationPolicy::ScreenError { max_px: 0.5 }, ..default() },
        TerrainCamera {
            lod: LodSettings { reach: 10.0, morph: 4.0, ..default() },
            faces_per_side: 16,
            policy: TessellationPolicy::ScreenError { max_px: 2.0 },
            triangle_width_px: 9.1,
            max_factor: 12.0,
            min_triangle_m: Some(1e-5),
            density: 0.1,
            partitioning: Partitioning::PowerOfTwoMorph,
            max_vertices: 1024,
            ..default()
        },
        TerrainCamera { lod: LodSettings { morph: 0.0625, ..default() }, faces_per_side: 2,
            partitioning: Partitioning::FractionalOdd, ..default() },
        TerrainCamera { lod: LodSettings { morph: 0.125, ..default() }, faces_per_side: 8,
            partitioning: Partitioning::Integer, ..default() },
        TerrainCamera { lod: LodSettings { morph: 0.25, ..default() }, faces_per_side: 32,
            partitioning: Partitioning::PowerOfTwo, ..default() },
        TerrainCamera { lod: LodSettings { morph: 0.5, ..default() }, ..default() },
        TerrainCamera { lod: LodSettings { reach: 8.0, morph: 2.0, ..default() }, ..default() },
    ], |all, value| all.camera = value);
    check_code(&mut panel, "Terrain", fixtures![
        TerrainSettings { leaf_level: -8, root_levels: 8, fade_levels_per_s: 1e30, fade_px_per_s: 0.5,
            ..default() },
        TerrainSettings { fade_px_per_s: f32::INFINITY, ..default() },
    ], |all, value| all.terrain = value);
    check_code(&mut panel, "Material", fixtures![
        TerrainMaterial::default(),
        TerrainMaterial {
            parameters: {
                let mut parameters = TerrainMaterial::default().parameters;
                parameters[0] = Vec4::new(0.5, 0.25, 0.0, 1.0);
                parameters[3] = Vec4::new(0.1, 0.2, 0.3, 0.0);
                parameters
            },
            ..default()
        },
    ], |all, value| all.material = Some(value));
    check_code(&mut panel, "Detail", fixtures![
        TerrainDetail::default(),
        TerrainDetail { amplitude_m: 1.5, wavelength_m: 100.0, octaves: 8, gain: 0.75,
            seed: 4294967295, rule: DetailRule::Everywhere, ..default() },
        TerrainDetail { rule: DetailRule::Slope { from_deg: 20.0, to_deg: 30.5 }, ..default() },
        TerrainDetail { rule: DetailRule::Height { from_m: -10.0, to_m: 1000.0 }, ..default() },
        TerrainDetail { rule: DetailRule::InverseHeight { full_m: 0.0, none_m: 10.0 }, ..default() },
    ], |all, value| all.detail = Some(value));
    check_code(&mut panel, "Density preview", fixtures![
        TerrainDensityPreview { opacity: 0.5, ..default() },
        TerrainDensityPreview {
            opacity: 0.25,
            settings: DensitySettings { filter: DensityFilter::Gaussian, gain: 2.5, exponent: 0.5,
                preprocess: false, filter_size: 3, border: DensityBorder::PointSampled, lod_skip: 2,
                ..default() },
            ..default()
        },
        TerrainDensityPreview {
            settings: DensitySettings { filter: DensityFilter::SecondOrder, ..default() },
            ..default()
        },
        TerrainDensityPreview {
            settings: DensitySettings { filter: DensityFilter::LaplaceBeltrami, ..default() },
            ..default()
        },
        TerrainDensityPreview {
            settings: DensitySettings { filter: DensityFilter::LaplaceBeltramiVoronoi, ..default() },
            ..default()
        },
        TerrainDensityPreview {
            settings: DensitySettings { filter: DensityFilter::Principal, ..default() },
            ..default()
        },
    ], |all, value| all.preview = Some(value));
    check_code(&mut panel, "Destruction mask", fixtures![
        MaskSettings { texels_per_m: 2.0, max_bytes: 32 << 20, ..default() },
    ], |all, value| all.mask = Some(value));
    check_code(&mut panel, "Streaming", fixtures![
        TerrainStreaming { page_bytes: 256 << 20, tile_bytes: 123456789, loads_in_flight: 4,
            upload_bytes_per_frame: 1 << 20, lookahead_s: 0.5, load_timeout_s: 5.0, retry_s: 1.5,
            ..default() },
    ], |all, value| all.streaming = value);
    check_code(&mut panel, "Physics", fixtures![
        TerrainPhysics { chunk_cells: 128, margin_m: 4.0, lookahead_s: 0.5, keep_s: 1.0,
            builds_per_step: 8, max_colliders: 1000, keep_resident: false, kinematic_bodies: false,
            lift_bodies: false, ..default() },
        TerrainPhysics { chunk_cells: 16, ..default() },
        TerrainPhysics { chunk_cells: 32, ..default() },
    ], |all, value| all.physics = value);
    let mut panel = comparing();
    check_code(&mut panel, "Other settings", fixtures![
        TerrainComparison::default(),
        TerrainComparison { other: TerrainCamera::default(), ..default() },
        TerrainComparison {
            other: TerrainCamera { triangle_width_px: 12.0, ..default() },
            view: ComparisonView::Split { divider: 0.25 },
            ..default()
        },
        TerrainComparison { view: ComparisonView::Difference { gain: 16.0 }, ..default() },
    ], |all, value| all.comparison = Some(value));
    let mut panel = views_panel();
    check_code(&mut panel, "Overlays", fixtures![
        TerrainOverlays::default().with(TerrainOverlay::Density, 1.0),
        TerrainOverlays::default().with(TerrainOverlay::Level, 0.25).with(TerrainOverlay::Wireframe, 0.5),
        TerrainOverlays { lit: false, ..TerrainOverlays::default().with(TerrainOverlay::EdgeFactor, 1.0) },
    ], |all, value| all.overlays = Some(value));
    check_code(&mut panel, "Eye", fixtures![
        TerrainEye::EyeAndLod,
        TerrainEye::EyeOnly,
        TerrainEye::LodOnly,
    ], |all, value| all.eye = Some(value));
    check_code(&mut panel, "Gizmos", fixtures![
        TerrainGizmos::default(),
        TerrainGizmos { tiles: true, edits: true, held_eyes: true, ..default() },
        TerrainGizmos {
            most_tiles: 4294967295,
            tiles_within_m: 500.0,
            tile_colors: {
                let mut colors = TerrainGizmos::default().tile_colors;
                colors[3] = Color::srgb(0.5, 0.25, 0.0);
                colors[7] = Color::linear_rgba(0.5, 0.25, 0.0, 0.5);
                colors
            },
            most_edits: 0,
            edit_color: Color::srgb(1.0, 0.5, 0.25),
            held_eye_color: Color::linear_rgb(1.0, 0.5, 0.25),
            held_eye_reach_m: 50.0,
            ..default()
        },
    ], |all, value| all.gizmos = value);
}
