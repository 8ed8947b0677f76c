//! Rectangles of edits, laid on the ground.

use super::TerrainGizmos;
use super::shapes::{foot, rect_outline};
use crate::edit::{Edit, TerrainEdits};
use crate::query::GroundReader;
use crate::stream::TerrainState;
use bevy::ecs::entity::EntityHashMap;
use bevy::math::DVec2;
use bevy::prelude::*;

/// Points on a side of a rectangle.
const PER_SIDE: u32 = 12;
/// How bright the oldest rectangle is that is drawn, the newest being 1.
const DIMMEST: f32 = 0.3;

/// A terrain's rectangles in its own space, and what they were made of.
#[derive(Default)]
pub(super) struct Outlines {
    made_of: [u64; 3],
    most: u32,
    /// `4 PER_SIDE + 1` points a rectangle, the newest first; none where the ground's height isn't known.
    points: Vec<Vec3>,
}

/// The corners of what an edit may change, in metres of the terrain's own x and z, as far as it lies on
/// the terrain.
pub(crate) fn edit_corners(edit: &Edit, state: &TerrainState) -> [DVec2; 2] {
    let file = &state.manifest().file;
    let last = DVec2::from(file.size.map(|samples| f64::from(samples) - 1.0));
    let rect = edit.rect();
    let least = DVec2::from(rect.min.map(f64::from));
    let greatest = DVec2::from(rect.max.map(f64::from)) - 1.0;
    [least, greatest].map(|corner| corner.clamp(DVec2::ZERO, last) * file.spacing_m)
}

/// The rectangles of the newest edits. Points are looked up again when the log or the tiles change.
pub(super) fn draw_edits(
    terrains: Query<(Entity, &TerrainState, &TerrainEdits, &GlobalTransform)>,
    mut known: Local<EntityHashMap<Outlines>>,
    mut gizmos: Gizmos<TerrainGizmos>,
) {
    known.retain(|terrain, _| terrains.contains(*terrain));
    let most = gizmos.config_ext.most_edits;
    let newest = gizmos.config_ext.edit_color.to_linear();
    for (entity, state, edits, transform) in &terrains {
        let (true, Some(log)) = (state.is_ready(), edits.log()) else {
            continue;
        };
        let outlines = known.entry(entity).or_default();
        let made_of = [log.version(), state.pages_version(), state.instance()];
        if outlines.made_of != made_of || outlines.most != most {
            outlines.points.clear();
            let mut reader = GroundReader::new(state);
            for (_, edit) in log.active().rev().take(most as usize) {
                let [min, max] = edit_corners(edit, state);
                let around = rect_outline(min, max, PER_SIDE);
                // Strips are broken where there is no place.
                let points = around.map(|at| foot(&mut reader, at).unwrap_or(Vec3::NAN));
                outlines.points.extend(points);
            }
            outlines.made_of = made_of;
            outlines.most = most;
        }
        let rectangles = outlines.points.chunks_exact(4 * PER_SIDE as usize + 1);
        let shown = rectangles.len();
        for (rank, rectangle) in rectangles.enumerate() {
            let age = rank as f32 / (shown - 1).max(1) as f32;
            let color = (newest * (1.0 - age * (1.0 - DIMMEST))).with_alpha(newest.alpha);
            let points = rectangle.iter().map(|&at| transform.transform_point(at));
            gizmos.linestrip(points, color);
        }
    }
}
