//! The preview on the ground, and the marked edit.

use super::pointer::{BrushPointer, sample_m};
use super::tool::{BrushKind, TerrainBrush};
use crate::edit::TerrainEdits;
use crate::gizmos::edit_corners;
use crate::gizmos::shapes::{foot, rect_outline, ring, square};
use crate::query::GroundReader;
use crate::stream::TerrainState;
use bevy::gizmos::config::GizmoConfigGroup;
use bevy::math::{Affine3A, DVec2};
use bevy::prelude::*;

/// How much nearer than the ground lines count; see `GizmoConfig`.
pub(super) const DEPTH_BIAS: f32 = -0.01;
/// Points of a ring, and of a side of a square.
const RING_POINTS: u32 = 96;
const SIDE_POINTS: u32 = 24;
/// How far out a crater's rim is highest, of the way from the bowl's edge to where the rim ends, for
/// squares of distances: the maximum of `v (1 − v)²`.
const CREST: f64 = 1.0 / 3.0;

/// The brush's lines. Their width, 3 px at first, is in the `GizmoConfig` of this group.
#[derive(GizmoConfigGroup, Clone, Debug, PartialEq, Reflect)]
#[reflect(Default)]
pub struct BrushGizmos {
    /// The ring beyond which nothing changes; a stamp's square.
    pub color: Color,
    /// Rings within: a crater's bowl and the crest of its rim, and up to where the change is whole.
    pub inner_color: Color,
    /// The rectangle of the marked edit.
    pub mark_color: Color,
}

impl Default for BrushGizmos {
    fn default() -> Self {
        Self {
            color: Color::srgb(1.0, 0.85, 0.1),
            inner_color: Color::srgb(1.0, 0.35, 0.1),
            mark_color: Color::srgb(0.2, 0.9, 1.0),
        }
    }
}

/// Radii of the rings within the outer one, in metres of the world, where samples lie `sample_m` apart; 0
/// for none.
fn inner_radii_m(brush: &TerrainBrush, sample_m: f32) -> [f32; 2] {
    let grown = brush.grown_on(sample_m);
    wanted_radii_m(brush).map(|radius_m| radius_m * grown)
}

/// The same where samples are fine enough.
fn wanted_radii_m(brush: &TerrainBrush) -> [f32; 2] {
    let hard = |radius_m: f32, hardness: f32| [radius_m * hardness.clamp(0.0, 1.0), 0.0];
    match brush.kind {
        BrushKind::Crater => {
            let bowl = f64::from(brush.crater.radius_m);
            let end = f64::from(brush.reach_m());
            let crest = (bowl * bowl + CREST * (end * end - bowl * bowl)).sqrt();
            [bowl as f32, crest as f32]
        }
        BrushKind::Raise => hard(brush.raise.radius_m, brush.raise.hardness),
        BrushKind::Lower => hard(brush.lower.radius_m, brush.lower.hardness),
        BrushKind::Flatten => hard(brush.flatten.radius_m, brush.flatten.hardness),
        BrushKind::Smooth => hard(brush.smooth.radius_m, brush.smooth.hardness),
        BrushKind::Stamp => [0.0, 0.0],
    }
}

/// Rings that lie on the ground around the pointer.
pub(super) fn draw_preview(
    brush: Res<TerrainBrush>,
    pointer: Res<BrushPointer>,
    terrains: Query<(&TerrainState, &GlobalTransform)>,
    mut gizmos: Gizmos<BrushGizmos>,
) {
    let Some(hit) = pointer.hit else {
        return;
    };
    let Ok((state, transform)) = terrains.get(hit.terrain) else {
        return;
    };
    let affine = transform.affine();
    let scale = f64::from(affine.matrix3.x_axis.length());
    let centre = affine.inverse().transform_point3(hit.point).xz();
    let centre = centre.as_dvec2();
    let BrushGizmos {
        color, inner_color, ..
    } = *gizmos.config_ext;
    // What would be smaller than a sample changes as much as one.
    let sample_m = sample_m(state, transform);
    let mut reader = GroundReader::new(state);
    if brush.kind == BrushKind::Stamp {
        let side_m = brush.stamp.side_m * brush.grown_on(sample_m);
        let half = 0.5 * f64::from(side_m) / scale;
        let around = square(centre, half, brush.stamp.turn.into(), SIDE_POINTS);
        lay(&mut gizmos, &affine, &mut reader, around, color);
        return;
    }
    let reach_m = f64::from(brush.reach_on_m(sample_m));
    let around = ring(centre, reach_m / scale, RING_POINTS);
    lay(&mut gizmos, &affine, &mut reader, around, color);
    for radius_m in inner_radii_m(&brush, sample_m) {
        if radius_m > 0.0 {
            let around = ring(centre, f64::from(radius_m) / scale, RING_POINTS);
            lay(&mut gizmos, &affine, &mut reader, around, inner_color);
        }
    }
}

/// The rectangle of the edit that is marked, undone or not.
pub(super) fn draw_mark(
    brush: Res<TerrainBrush>,
    terrains: Query<(&TerrainState, &TerrainEdits, &GlobalTransform)>,
    mut gizmos: Gizmos<BrushGizmos>,
) {
    let Some(marked) = brush.marked else {
        return;
    };
    let Ok((state, edits, transform)) = terrains.get(marked.terrain) else {
        return;
    };
    let Some(edit) = edits.log().and_then(|log| log.edit(marked.sequence)) else {
        return;
    };
    let [min, max] = edit_corners(edit, state);
    let color = gizmos.config_ext.mark_color;
    let around = rect_outline(min, max, SIDE_POINTS);
    let mut reader = GroundReader::new(state);
    lay(&mut gizmos, &transform.affine(), &mut reader, around, color);
}

/// Lines along points of a terrain's own plane, laid on its ground as far as it reaches.
fn lay(
    gizmos: &mut Gizmos<BrushGizmos>,
    affine: &Affine3A,
    reader: &mut GroundReader<'_, TerrainState>,
    points: impl Iterator<Item = DVec2>,
    color: Color,
) {
    let mut before = None;
    for at in points {
        let here = foot(reader, at).map(|foot| affine.transform_point3(foot));
        if let (Some(before), Some(here)) = (before, here) {
            gizmos.line(before, here, color);
        }
        before = here;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_craters_rings_are_its_bowl_the_crest_of_its_rim_and_its_end() {
        let brush = TerrainBrush::default();
        let [bowl, crest] = inner_radii_m(&brush, 0.5);
        assert_eq!(bowl, brush.crater.radius_m);
        assert!(bowl < crest && crest < brush.reach_m());
        // On coarse ground all of them are as large as the change.
        let [bowl, crest] = inner_radii_m(&brush, 30.0);
        assert!((bowl - 30.0 / 1.6).abs() < 1e-3, "{bowl}");
        assert!(bowl < crest && crest < 30.0);
    }

    #[test]
    fn hard_brushes_show_where_their_change_is_whole() {
        for kind in [BrushKind::Raise, BrushKind::Flatten, BrushKind::Smooth] {
            let mut brush = TerrainBrush { kind, ..default() };
            (brush.raise.hardness, brush.raise.radius_m) = (0.5, 8.0);
            (brush.flatten.hardness, brush.flatten.radius_m) = (0.5, 8.0);
            (brush.smooth.hardness, brush.smooth.radius_m) = (0.5, 8.0);
            assert_eq!(inner_radii_m(&brush, 2.0), [4.0, 0.0], "{kind:?}");
        }
    }
}
