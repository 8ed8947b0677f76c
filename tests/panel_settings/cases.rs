//! What every control does: what comes before, which control, what is done to it, and what becomes of
//! everything.

use super::panel_settings_support::{Act, Everything};
use bevy::prelude::*;
use bevy_tessera::density::{DensityBorder, DensityFilter, DensitySettings};
use bevy_tessera::detail::{DetailRule, TerrainDetail};
use bevy_tessera::edit::mask::MaskSettings;
use bevy_tessera::gizmos::TerrainGizmos;
use bevy_tessera::render::{
    ComparisonView, TerrainComparison, TerrainDensityPreview, TerrainOverlay,
};
use bevy_tessera::terrain::TessellationPolicy;
use bevy_tessera::tessellate::Partitioning;
use bevy_tessera::view::TerrainEye;

/// What comes before, which control, what is done to it, and what becomes of everything.
pub type Case = (fn(&mut Everything), &'static str, Act, fn(&mut Everything));

pub fn nothing(_: &mut Everything) {}

pub fn by_error(all: &mut Everything) {
    all.camera.policy = TessellationPolicy::ScreenError { max_px: 2.0 };
}

pub fn long_reach(all: &mut Everything) {
    all.camera.lod.reach = 10.0;
}

pub fn detailed(all: &mut Everything) {
    all.detail = Some(TerrainDetail::default());
}

pub fn detail(all: &mut Everything) -> &mut TerrainDetail {
    all.detail.get_or_insert_default()
}

pub fn by_height(all: &mut Everything) {
    detail(all).rule = DetailRule::Height {
        from_m: 10.0,
        to_m: 20.0,
    };
}

pub fn by_inverse_height(all: &mut Everything) {
    detail(all).rule = DetailRule::InverseHeight {
        full_m: 10.0,
        none_m: 20.0,
    };
}

pub fn previewed(all: &mut Everything) {
    all.preview = Some(TerrainDensityPreview::default());
}

pub fn density(all: &mut Everything) -> &mut DensitySettings {
    &mut all.preview.get_or_insert_default().settings
}

pub fn parameter(all: &mut Everything, number: usize) -> &mut Vec4 {
    &mut all.material.get_or_insert_default().parameters[number]
}

pub fn mask(all: &mut Everything) -> &mut MaskSettings {
    all.mask.get_or_insert_default()
}

pub fn camera_cases() -> Vec<Case> {
    use Act::{Check, Choose, Type};
    vec![
        (nothing, "LOD reach", Type("6.5"), |all| {
            all.camera.lod.reach = 6.5
        }),
        (long_reach, "LOD morph", Choose("1/4"), |all| {
            all.camera.lod.morph = 0.25
        }),
        (long_reach, "LOD morph", Choose("4"), |all| {
            all.camera.lod.morph = 4.0
        }),
        (nothing, "faces per side", Choose("16"), |all| {
            all.camera.faces_per_side = 16
        }),
        (nothing, "policy", Choose("screen error"), |all| {
            all.camera.policy = TessellationPolicy::ScreenError { max_px: 1.0 };
        }),
        (by_error, "policy", Choose("triangle width"), |all| {
            all.camera.policy = TessellationPolicy::TriangleWidth;
        }),
        (by_error, "max error", Type("0.5"), |all| {
            all.camera.policy = TessellationPolicy::ScreenError { max_px: 0.5 };
        }),
        (nothing, "triangle width", Type("9.25"), |all| {
            all.camera.triangle_width_px = 9.25;
        }),
        (nothing, "max factor", Type("12"), |all| {
            all.camera.max_factor = 12.0
        }),
        (nothing, "set min triangle", Check, |all| {
            all.camera.min_triangle_m = Some(1.0);
        }),
        (
            |all| all.camera.min_triangle_m = Some(3.0),
            "min triangle",
            Type("0.25"),
            |all| all.camera.min_triangle_m = Some(0.25),
        ),
        (
            |all| all.camera.min_triangle_m = Some(3.0),
            "set min triangle",
            Check,
            |all| all.camera.min_triangle_m = None,
        ),
        (nothing, "density", Type("0.1"), |all| {
            all.camera.density = 0.1
        }),
        (nothing, "partitioning", Choose("fractional odd"), |all| {
            all.camera.partitioning = Partitioning::FractionalOdd;
        }),
        (
            nothing,
            "partitioning",
            Choose("power of two, morph"),
            |all| {
                all.camera.partitioning = Partitioning::PowerOfTwoMorph;
            },
        ),
        (nothing, "max vertices", Type("16777213"), |all| {
            all.camera.max_vertices = 16_777_213;
        }),
    ]
}

pub fn terrain_cases() -> Vec<Case> {
    use Act::{Check, Choose, Type};
    vec![
        (nothing, "measure triangle sizes", Check, |all| {
            all.measure = true
        }),
        (nothing, "measure savings", Check, |all| all.savings = true),
        (nothing, "leaf level", Type("-3"), |all| {
            all.terrain.leaf_level = -3
        }),
        (nothing, "root levels", Type("5"), |all| {
            all.terrain.root_levels = 5
        }),
        (nothing, "fade, levels", Type("0.5"), |all| {
            all.terrain.fade_levels_per_s = 0.5
        }),
        (nothing, "fade, pixels", Type("200"), |all| {
            all.terrain.fade_px_per_s = 200.0
        }),
        (nothing, "grass red", Type("0.5"), |all| {
            parameter(all, 0).x = 0.5
        }),
        (nothing, "grass green", Type("0.6"), |all| {
            parameter(all, 0).y = 0.6
        }),
        (nothing, "grass blue", Type("0.7"), |all| {
            parameter(all, 0).z = 0.7
        }),
        (nothing, "rock red", Type("0.5"), |all| {
            parameter(all, 1).x = 0.5
        }),
        (nothing, "rock green", Type("0.6"), |all| {
            parameter(all, 1).y = 0.6
        }),
        (nothing, "rock blue", Type("0.7"), |all| {
            parameter(all, 1).z = 0.7
        }),
        (nothing, "scorch red", Type("0.5"), |all| {
            parameter(all, 3).x = 0.5
        }),
        (nothing, "scorch green", Type("0.6"), |all| {
            parameter(all, 3).y = 0.6
        }),
        (nothing, "scorch blue", Type("0.7"), |all| {
            parameter(all, 3).z = 0.7
        }),
        (nothing, "grass up to slope", Type("0.2"), |all| {
            parameter(all, 2).x = 0.2
        }),
        (nothing, "rock from slope", Type("0.4"), |all| {
            parameter(all, 2).y = 0.4
        }),
        (nothing, "scorch amount", Type("0.5"), |all| {
            parameter(all, 3).w = 0.5
        }),
        (nothing, "detail finer than the samples", Check, detailed),
        (detailed, "detail finer than the samples", Check, |all| {
            all.detail = None
        }),
        (detailed, "amplitude", Type("2"), |all| {
            detail(all).amplitude_m = 2.0
        }),
        (detailed, "wavelength", Type("33"), |all| {
            detail(all).wavelength_m = 33.0
        }),
        (detailed, "octaves", Type("3"), |all| {
            detail(all).octaves = 3
        }),
        (detailed, "octave gain", Type("0.7"), |all| {
            detail(all).gain = 0.7
        }),
        (detailed, "seed", Type("4294967295"), |all| {
            detail(all).seed = u32::MAX
        }),
        (
            |all| detail(all).seed = 1_234_567_890,
            "seed",
            Type("1234567891"),
            |all| detail(all).seed = 1_234_567_891,
        ),
        (detailed, "rule", Choose("everywhere"), |all| {
            detail(all).rule = DetailRule::Everywhere;
        }),
        (detailed, "rule", Choose("by height"), |all| {
            detail(all).rule = DetailRule::Height {
                from_m: 0.0,
                to_m: 500.0,
            };
        }),
        (detailed, "rule", Choose("by inverse height"), |all| {
            detail(all).rule = DetailRule::InverseHeight {
                full_m: 100.0,
                none_m: 500.0,
            };
        }),
        (by_height, "rule", Choose("by slope"), |all| {
            detail(all).rule = TerrainDetail::default().rule;
        }),
        (detailed, "from slope", Type("20"), |all| {
            detail(all).rule = DetailRule::Slope {
                from_deg: 20.0,
                to_deg: 40.0,
            };
        }),
        (detailed, "to slope", Type("80"), |all| {
            detail(all).rule = DetailRule::Slope {
                from_deg: 15.0,
                to_deg: 80.0,
            };
        }),
        (by_height, "from height", Type("-7"), |all| {
            detail(all).rule = DetailRule::Height {
                from_m: -7.0,
                to_m: 20.0,
            };
        }),
        (by_height, "to height", Type("70"), |all| {
            detail(all).rule = DetailRule::Height {
                from_m: 10.0,
                to_m: 70.0,
            };
        }),
        (by_inverse_height, "full height", Type("-7"), |all| {
            detail(all).rule = DetailRule::InverseHeight {
                full_m: -7.0,
                none_m: 20.0,
            };
        }),
        (by_inverse_height, "none height", Type("70"), |all| {
            detail(all).rule = DetailRule::InverseHeight {
                full_m: 10.0,
                none_m: 70.0,
            };
        }),
        (nothing, "show densities", Check, previewed),
        (previewed, "show densities", Check, |all| all.preview = None),
        (previewed, "preview opacity", Type("0.3"), |all| {
            all.preview.as_mut().unwrap().opacity = 0.3;
        }),
        (previewed, "filter", Choose("second order"), |all| {
            density(all).filter = DensityFilter::SecondOrder;
        }),
        (previewed, "filter", Choose("principal"), |all| {
            density(all).filter = DensityFilter::Principal;
        }),
        (previewed, "curvature gain", Type("2.5"), |all| {
            density(all).gain = 2.5
        }),
        (previewed, "exponent", Type("3"), |all| {
            density(all).exponent = 3.0
        }),
        (previewed, "preprocess", Check, |all| {
            density(all).preprocess = false
        }),
        (previewed, "filter size", Type("7"), |all| {
            density(all).filter_size = 7
        }),
        (previewed, "border", Choose("point-sampled"), |all| {
            density(all).border = DensityBorder::PointSampled;
        }),
        (previewed, "LOD skip", Type("3"), |all| {
            density(all).lod_skip = 3
        }),
        (nothing, "texels per metre", Type("8"), |all| {
            mask(all).texels_per_m = 8.0
        }),
        (nothing, "mask memory", Type("32"), |all| {
            mask(all).max_bytes = 32 << 20
        }),
    ]
}

pub fn shared_cases() -> Vec<Case> {
    use Act::{Check, Choose, Type};
    vec![
        (nothing, "GPU pages", Type("256"), |all| {
            all.streaming.page_bytes = 256 << 20
        }),
        (nothing, "tiles in memory", Type("0.5"), |all| {
            all.streaming.tile_bytes = 1 << 19;
        }),
        (nothing, "loads in flight", Type("64"), |all| {
            all.streaming.loads_in_flight = 64
        }),
        (nothing, "upload per frame", Type("8"), |all| {
            all.streaming.upload_bytes_per_frame = 8 << 20;
        }),
        (nothing, "eyes' lookahead", Type("1.5"), |all| {
            all.streaming.lookahead_s = 1.5
        }),
        (nothing, "load timeout", Type("5"), |all| {
            all.streaming.load_timeout_s = 5.0
        }),
        (nothing, "retry after", Type("0.125"), |all| {
            all.streaming.retry_s = 0.125
        }),
        (nothing, "chunk", Choose("128"), |all| {
            all.physics.chunk_cells = 128
        }),
        (nothing, "margin", Type("3"), |all| {
            all.physics.margin_m = 3.0
        }),
        (nothing, "bodies' lookahead", Type("2.5"), |all| {
            all.physics.lookahead_s = 2.5
        }),
        (nothing, "keep", Type("9"), |all| all.physics.keep_s = 9.0),
        (nothing, "builds per step", Type("99"), |all| {
            all.physics.builds_per_step = 99
        }),
        (nothing, "max colliders", Type("500"), |all| {
            all.physics.max_colliders = 500
        }),
        (nothing, "keep resident", Check, |all| {
            all.physics.keep_resident = false
        }),
        (nothing, "kinematic bodies", Check, |all| {
            all.physics.kinematic_bodies = false
        }),
        (nothing, "lift bodies", Check, |all| {
            all.physics.lift_bodies = false
        }),
    ]
}

pub fn all_cases() -> Vec<Case> {
    [camera_cases(), terrain_cases(), shared_cases()].concat()
}

pub fn overlay(all: &mut Everything, overlay: TerrainOverlay, opacity: f32) {
    let overlays = all.overlays.take().unwrap_or_default();
    all.overlays = Some(overlays.with(overlay, opacity));
}

pub fn split(all: &mut Everything) {
    all.comparison = Some(TerrainComparison::default());
}

pub fn difference(all: &mut Everything) {
    all.comparison = Some(TerrainComparison {
        view: ComparisonView::Difference { gain: 8.0 },
        ..default()
    });
}

pub fn hold(all: &mut Everything) {
    all.eye = Some(TerrainEye::EyeOnly);
}

fn near_tiles(all: &mut Everything) {
    all.gizmos.tiles_within_m = 1000.0;
}

pub fn eye_cases() -> Vec<Case> {
    use Act::{Radio, Type};
    vec![
        (nothing, "Eye only", Radio, |all| {
            hold(all);
            all.gizmos.held_eyes = true;
        }),
        (nothing, "LOD only", Radio, |all| {
            all.eye = Some(TerrainEye::LodOnly);
            all.gizmos.held_eyes = true;
        }),
        (hold, "Eye & LOD", Radio, |all| all.eye = None),
        (hold, "Eye only", Radio, nothing),
        (hold, "frustum length", Type("50"), |all| {
            all.gizmos.held_eye_reach_m = 50.0;
        }),
    ]
}

pub fn comparison_cases() -> Vec<Case> {
    use Act::{Choose, Press, Radio, Type};
    vec![
        (nothing, "side by side", Radio, split),
        (nothing, "difference", Radio, difference),
        (split, "difference", Radio, difference),
        (split, "off", Radio, |all| all.comparison = None),
        (nothing, "Density off against on", Press, split),
        (
            |all| all.camera.density = 0.0,
            "Density off against on",
            Press,
            |all| {
                split(all);
                all.comparison.as_mut().unwrap().other.density = 1.0;
            },
        ),
        (split, "divider", Type("0.25"), |all| {
            all.comparison.as_mut().unwrap().view = ComparisonView::Split { divider: 0.25 };
        }),
        (difference, "gain", Type("32"), |all| {
            all.comparison.as_mut().unwrap().view = ComparisonView::Difference { gain: 32.0 };
        }),
        (split, "partitioning", Choose("integer"), |all| {
            all.comparison.as_mut().unwrap().other.partitioning = Partitioning::Integer;
        }),
    ]
}

pub fn gizmo_cases() -> Vec<Case> {
    use Act::{Check, Type};
    vec![
        (nothing, "bounds of tiles", Check, |all| {
            all.gizmos.tiles = true
        }),
        (nothing, "rectangles of edits", Check, |all| {
            all.gizmos.edits = true
        }),
        (nothing, "held eyes", Check, |all| {
            all.gizmos.held_eyes = true
        }),
        (
            |all| all.gizmos.tiles = true,
            "bounds of tiles",
            Check,
            |all| all.gizmos.tiles = false,
        ),
        (nothing, "most tiles", Type("16777217"), |all| {
            all.gizmos.most_tiles = 16_777_217;
        }),
        (nothing, "set tiles within", Check, near_tiles),
        (near_tiles, "set tiles within", Check, |all| {
            all.gizmos.tiles_within_m = f32::MAX;
        }),
        (near_tiles, "tiles within", Type("12.5"), |all| {
            all.gizmos.tiles_within_m = 12.5;
        }),
        (nothing, "most edits", Type("7"), |all| {
            all.gizmos.most_edits = 7
        }),
    ]
}

/// A picker of a colour, and the field that it sets.
pub type Picked = (
    &'static str,
    &'static str,
    fn(&mut TerrainGizmos) -> &mut Color,
);

/// Pickers, what their rows are called, and what they pick.
pub const GIZMO_COLORS: [Picked; 4] = [
    ("tile colour 0", "tile colours", |gizmos| {
        &mut gizmos.tile_colors[0]
    }),
    ("tile colour 7", "tile colours", |gizmos| {
        &mut gizmos.tile_colors[7]
    }),
    ("edit colour", "edit colour", |gizmos| {
        &mut gizmos.edit_color
    }),
    ("held eye colour", "held eye colour", |gizmos| {
        &mut gizmos.held_eye_color
    }),
];
