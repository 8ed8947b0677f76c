//! Outlines of what gizmos show, as points.

use crate::query::GroundReader;
use crate::stream::TerrainState;
use bevy::math::{DMat4, DVec2, DVec3};
use bevy::prelude::*;

/// Which two of [`box_corners`] or [`frustum_corners`] each edge joins.
pub(crate) const BOX_EDGES: [[usize; 2]; 12] = [
    [0, 1],
    [2, 3],
    [4, 5],
    [6, 7],
    [0, 2],
    [1, 3],
    [4, 6],
    [5, 7],
    [0, 4],
    [1, 5],
    [2, 6],
    [3, 7],
];

/// The corners of a box: bit 0 of the index is the end in x, bit 1 in y, bit 2 in z.
pub(crate) fn box_corners(min: Vec3, max: Vec3) -> [Vec3; 8] {
    std::array::from_fn(|corner| {
        let is_max = BVec3::new(corner & 1 != 0, corner & 2 != 0, corner & 4 != 0);
        Vec3::select(is_max, max, min)
    })
}

/// The corners of what a projection sees between its near plane and the depth `reach_m`, in the
/// view's own space, numbered like those of a box whose z axis points away from the eye. A far plane
/// that is nearer counts. `None` for what is no projection.
pub(crate) fn frustum_corners(clip_from_view: Mat4, reach_m: f32) -> Option<[Vec3; 8]> {
    let view_from_clip = clip_from_view.as_dmat4().inverse();
    if !view_from_clip.is_finite() {
        return None;
    }
    let mut corners = [Vec3::ZERO; 8];
    for corner in 0..4 {
        let x = if corner & 1 == 0 { -1.0 } else { 1.0 };
        let y = if corner & 2 == 0 { -1.0 } else { 1.0 };
        let at = |depth: f64| project(&view_from_clip, DVec3::new(x, y, depth));
        // Depths run from 1 at the near plane to 0 at the far plane, which may be infinitely far.
        let (near, between) = (at(1.0)?, at(0.5)?);
        let away = between - near;
        if away.z >= 0.0 {
            return None;
        }
        let cut = near + away * ((-f64::from(reach_m) - near.z) / away.z).max(0.0);
        let far = at(0.0).filter(|far| far.z > cut.z).unwrap_or(cut);
        corners[corner] = near.as_vec3();
        corners[corner | 4] = far.as_vec3();
    }
    Some(corners)
}

fn project(view_from_clip: &DMat4, at: DVec3) -> Option<DVec3> {
    let point = *view_from_clip * at.extend(1.0);
    let point = point.truncate() / point.w;
    point.is_finite().then_some(point)
}

/// Points on a circle in a terrain's own plane, the first of them again at the end.
pub(crate) fn ring(centre: DVec2, radius: f64, count: u32) -> impl Iterator<Item = DVec2> {
    (0..=count).map(move |point| {
        let turn = std::f64::consts::TAU * f64::from(point % count) / f64::from(count);
        centre + radius * DVec2::from_angle(turn)
    })
}

/// Points on the sides of a square in a terrain's own plane, which is turned from x to z; the first of
/// them again at the end.
pub(crate) fn square(
    centre: DVec2,
    half: f64,
    turn: f64,
    per_side: u32,
) -> impl Iterator<Item = DVec2> {
    let along = DVec2::from_angle(turn);
    rect_outline(DVec2::splat(-half), DVec2::splat(half), per_side)
        .map(move |at| centre + along.rotate(at))
}

/// Points on the sides of a rectangle, `per_side` to a side, the first of them again at the end.
pub(crate) fn rect_outline(min: DVec2, max: DVec2, per_side: u32) -> impl Iterator<Item = DVec2> {
    let corners = [min, DVec2::new(max.x, min.y), max, DVec2::new(min.x, max.y)];
    (0..=4 * per_side).map(move |point| {
        let side = (point / per_side) as usize;
        let part = f64::from(point % per_side) / f64::from(per_side);
        corners[side % 4].lerp(corners[(side + 1) % 4], part)
    })
}

/// The ground at a place of a terrain's own plane, in the terrain's own space.
pub(crate) fn foot(reader: &mut GroundReader<'_, TerrainState>, at_m: DVec2) -> Option<Vec3> {
    let height_m = reader.height(at_m)?.height_m;
    Some(DVec3::new(at_m.x, height_m, at_m.y).as_vec3())
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::camera::CameraProjection;

    #[test]
    fn a_box_has_eight_corners_and_each_edge_runs_along_one_axis() {
        let (min, max) = (Vec3::new(-1.0, 2.0, 3.0), Vec3::new(4.0, 6.0, 9.0));
        let corners = box_corners(min, max);
        assert_eq!(corners[0], min);
        assert_eq!(corners[7], max);
        let mut seen = [0; 8];
        for [a, b] in BOX_EDGES {
            let along = corners[b] - corners[a];
            assert_eq!(along.abs().cmpgt(Vec3::ZERO).bitmask().count_ones(), 1);
            seen[a] += 1;
            seen[b] += 1;
        }
        assert_eq!(seen, [3; 8]);
    }

    #[test]
    fn an_infinite_frustum_ends_at_its_reach() {
        let projection = PerspectiveProjection {
            fov: 1.2,
            aspect_ratio: 1.5,
            near: 0.1,
            ..default()
        };
        let corners = frustum_corners(projection.get_clip_from_view(), 500.0).unwrap();
        let up = (0.6_f32).tan();
        for (corner, at) in corners.iter().enumerate() {
            let depth = if corner < 4 { 0.1 } else { 500.0 };
            let x = if corner & 1 == 0 { -1.0 } else { 1.0 };
            let y = if corner & 2 == 0 { -1.0 } else { 1.0 };
            let wanted = Vec3::new(x * up * 1.5, y * up, -1.0) * depth;
            let off = at.distance(wanted);
            assert!(off < 1e-4 * depth, "corner {corner}: {at} for {wanted}");
        }
    }

    #[test]
    fn a_far_plane_that_is_nearer_ends_a_frustum() {
        let projection = OrthographicProjection {
            near: 1.0,
            far: 80.0,
            area: Rect::new(-3.0, -2.0, 3.0, 2.0),
            ..OrthographicProjection::default_3d()
        };
        let clip_from_view = projection.get_clip_from_view();
        let corners = frustum_corners(clip_from_view, 500.0).unwrap();
        assert!(corners[7].distance(Vec3::new(3.0, 2.0, -80.0)) < 1e-3);
        let corners = frustum_corners(clip_from_view, 50.0).unwrap();
        assert!(corners[7].distance(Vec3::new(3.0, 2.0, -50.0)) < 1e-3);
        assert!(corners[0].distance(Vec3::new(-3.0, -2.0, -1.0)) < 1e-3);
        assert_eq!(frustum_corners(Mat4::ZERO, 50.0), None);
    }

    #[test]
    fn a_ring_is_closed_and_keeps_its_radius() {
        let centre = DVec2::new(10.0, -4.0);
        let points: Vec<_> = ring(centre, 3.0, 12).collect();
        assert_eq!(points.len(), 13);
        assert_eq!(points[0], points[12]);
        for pair in points.windows(2) {
            assert!((pair[0].distance(centre) - 3.0).abs() < 1e-12);
            let chord = 6.0 * (std::f64::consts::PI / 12.0).sin();
            assert!((pair[0].distance(pair[1]) - chord).abs() < 1e-12);
        }
    }

    #[test]
    fn an_outline_passes_all_corners_and_closes() {
        let (min, max) = (DVec2::new(1.0, 2.0), DVec2::new(5.0, 4.0));
        let points: Vec<_> = rect_outline(min, max, 4).collect();
        assert_eq!(points.len(), 17);
        assert_eq!((points[0], points[8], points[16]), (min, max, min));
        assert_eq!(points[4], DVec2::new(5.0, 2.0));
        assert_eq!(points[5], DVec2::new(5.0, 2.5));
        let turned: Vec<_> = square(min, 1.0, std::f64::consts::FRAC_PI_2, 1).collect();
        // From (-1, -1), a quarter from x to z.
        assert!(turned[0].distance(min + DVec2::new(1.0, -1.0)) < 1e-12);
    }
}
