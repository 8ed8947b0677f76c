//! What lies over the tiles: edits, pins, eyes and what they see, and the scale.

use super::frame::MapFrame;
use crate::edit::{EDIT_UNITS, EditLog};
use crate::stream::{TerrainPin, TerrainState};
use bevy::math::{DAffine3, DVec2, DVec3, Mat4};
use bevy::prelude::*;
use bevy_egui::egui::{
    Align2, Color32, FontId, Mesh, Painter, Rect, Shape, Stroke, Vec2 as ScreenVec, pos2,
};

/// The newest edits are shown, so many.
const MOST_EDITS: usize = 2000;
/// Side of an edit's dot, points of the screen.
const DOT_PX: f32 = 3.0;
/// The longest that the scale bar gets, points of the screen.
const SCALE_PX: f64 = 120.0;

pub(super) const EYE: Color32 = Color32::from_rgb(255, 255, 255);
pub(super) const LOD_EYE: Color32 = Color32::from_rgb(255, 150, 220);
pub(super) const PIN: Color32 = Color32::from_rgb(196, 120, 255);
pub(super) const EDIT: Color32 = Color32::from_rgb(255, 140, 60);

/// Where edits lie, found anew when the log has changed.
#[derive(Default)]
pub(super) struct EditDots {
    version: u64,
    centres_m: Vec<DVec2>,
}

impl EditDots {
    pub(super) fn paint(
        &mut self,
        log: &EditLog,
        spacing_m: f64,
        frame: &MapFrame,
        mesh: &mut Mesh,
    ) {
        if self.version != log.version() {
            self.version = log.version();
            let unit_m = spacing_m / f64::from(EDIT_UNITS);
            let newest = log.active().rev().take(MOST_EDITS);
            self.centres_m.clear();
            self.centres_m.extend(newest.map(|(_, edit)| {
                DVec2::new(edit.centre[0].into(), edit.centre[1].into()) * unit_m
            }));
        }
        for centre_m in &self.centres_m {
            let at = frame.to_screen(*centre_m);
            if frame.rect.contains(at) {
                let dot = Rect::from_center_size(at, ScreenVec::splat(DOT_PX));
                mesh.add_colored_rect(dot, EDIT);
            }
        }
    }
}

/// Outlines a pin's region.
pub(super) fn paint_pin(pin: &TerrainPin, extent_m: DVec2, frame: &MapFrame, mesh: &mut Mesh) {
    let [low_m, high_m] = [pin.region.min_m, pin.region.max_m]
        .map(|corner| corner.as_dvec2().clamp(DVec2::ZERO, extent_m));
    let rect = frame.rect_of(low_m, high_m);
    // Not a number is in no rectangle.
    if !rect.intersects(frame.rect) {
        return;
    }
    let rect = rect.intersect(frame.rect.expand(4.0));
    let line = 2.0;
    for side in [
        Rect::from_min_max(rect.min, pos2(rect.max.x, rect.min.y + line)),
        Rect::from_min_max(pos2(rect.min.x, rect.max.y - line), rect.max),
        Rect::from_min_max(rect.min, pos2(rect.min.x + line, rect.max.y)),
        Rect::from_min_max(pos2(rect.max.x - line, rect.min.y), rect.max),
    ] {
        mesh.add_colored_rect(side, PIN);
    }
}

/// An eye over a terrain.
#[derive(Clone, Copy, Debug)]
pub(super) struct MapEye {
    /// From the eye's space to the terrain's.
    pub(super) local_from_view: DAffine3,
    pub(super) clip_from_view: Mat4,
}

impl MapEye {
    pub(super) fn at_m(&self) -> DVec2 {
        let place = self.local_from_view.translation;
        DVec2::new(place.x, place.z)
    }

    /// Where it looks, along the ground; zero where it looks straight up or down.
    fn heading(&self) -> DVec2 {
        let forward = self.local_from_view.transform_vector3(DVec3::NEG_Z);
        let heading = DVec2::new(forward.x, forward.z);
        // Straight down there is no telling.
        if heading.length_squared() < 1e-6 * forward.length_squared() {
            return DVec2::ZERO;
        }
        heading.normalize_or_zero()
    }

    /// What it sees of the level ground at `height_m`, at most `reach_m` away, around it; fewer than
    /// three points where it sees none of it.
    pub(super) fn sight(&self, height_m: f64, reach_m: f64) -> Vec<DVec2> {
        let view_from_clip = self.clip_from_view.inverse().as_dmat4();
        let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
        let ends = corners.map(|(x, y)| {
            // Depth runs from 1 at the near plane to 0 at the far one, which may be infinitely far.
            let at = |depth: f64| {
                let place = view_from_clip.project_point3(DVec3::new(x, y, depth));
                self.local_from_view.transform_point3(place)
            };
            let near = at(1.0);
            let along = (at(0.5) - near).normalize_or_zero();
            [near, near + along * reach_m]
        });
        let mut points = Vec::new();
        let mut cut = |a: DVec3, b: DVec3| {
            let (above, below) = (a.y - height_m, b.y - height_m);
            if (above > 0.0) != (below > 0.0) {
                let point = a.lerp(b, above / (above - below));
                points.push(DVec2::new(point.x, point.z));
            }
        };
        for (at, [near, far]) in ends.iter().enumerate() {
            let [next_near, next_far] = ends[(at + 1) % ends.len()];
            cut(*near, *far);
            cut(*near, next_near);
            cut(*far, next_far);
        }
        let middle = points.iter().sum::<DVec2>() / (points.len().max(1) as f64);
        points.sort_by(|a, b| {
            let [a, b] = [a, b].map(|point| (*point - middle).to_angle());
            a.total_cmp(&b)
        });
        points
    }

    pub(super) fn paint(
        &self,
        painter: &Painter,
        frame: &MapFrame,
        state: &TerrainState,
        extent_m: DVec2,
        colour: Color32,
    ) {
        let at_m = self.at_m();
        let ground = state.height(at_m.clamp(DVec2::ZERO, extent_m));
        let height_m = ground.map_or(0.0, |ground| ground.height_m);
        let eye_height_m = self.local_from_view.translation.y;
        let reach_m = 2.0 * extent_m.max_element() + eye_height_m.abs();
        let sight = self.sight(height_m, reach_m);
        if sight.len() >= 3 {
            let points = sight.into_iter().map(|point| frame.to_screen(point));
            painter.add(Shape::closed_line(
                points.collect(),
                Stroke::new(1.0, colour),
            ));
        }
        // An eye beyond the map is shown at its rim.
        let at = frame.rect.shrink(6.0).clamp(frame.to_screen(at_m));
        let heading = self.heading();
        let heading = ScreenVec::new(heading.x as f32, heading.y as f32);
        let outline = Stroke::new(1.0, Color32::BLACK);
        if heading == ScreenVec::ZERO {
            painter.circle(at, 4.0, colour, outline);
            return;
        }
        let aside = heading.rot90();
        let arrow = vec![
            at + heading * 9.0,
            at - heading * 5.0 + aside * 5.0,
            at - heading * 2.5,
            at - heading * 5.0 - aside * 5.0,
        ];
        // A dart is not convex: its two halves are.
        let halves = [
            vec![arrow[0], arrow[1], arrow[2]],
            vec![arrow[0], arrow[2], arrow[3]],
        ];
        for half in halves {
            painter.add(Shape::convex_polygon(half, colour, Stroke::NONE));
        }
        painter.add(Shape::closed_line(arrow, outline));
    }
}

/// A length in metres or kilometres.
pub(super) fn length(length_m: f64) -> String {
    if length_m >= 1000.0 {
        format!("{} km", length_m / 1000.0)
    } else {
        format!("{length_m} m")
    }
}

pub(super) fn paint_scale(painter: &Painter, frame: &MapFrame) {
    let (length_m, px) = frame.scale_bar(SCALE_PX);
    let start = frame.rect.left_bottom() + ScreenVec::new(10.0, -10.0);
    let end = start + ScreenVec::new(px, 0.0);
    for (width, colour) in [(4.0, Color32::BLACK), (2.0, Color32::WHITE)] {
        painter.line_segment([start, end], Stroke::new(width, colour));
    }
    painter.text(
        start - ScreenVec::new(0.0, 4.0),
        Align2::LEFT_BOTTOM,
        length(length_m),
        FontId::proportional(12.0),
        Color32::WHITE,
    );
    painter.text(
        frame.rect.center_top() + ScreenVec::new(0.0, 4.0),
        Align2::CENTER_TOP,
        "N",
        FontId::proportional(12.0),
        Color32::WHITE,
    );
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy::camera::{CameraProjection, PerspectiveProjection};

    fn eye(transform: Transform) -> MapEye {
        let affine = transform.compute_affine();
        MapEye {
            local_from_view: DAffine3::from_mat4(Mat4::from(affine).as_dmat4()),
            clip_from_view: PerspectiveProjection::default().get_clip_from_view(),
        }
    }

    #[test]
    fn an_eye_that_looks_straight_down_sees_a_rectangle_below_it() {
        let down = Transform::from_xyz(100.0, 50.0, 200.0).looking_to(Vec3::NEG_Y, Vec3::NEG_Z);
        let sight = eye(down).sight(0.0, 1000.0);
        assert_eq!(sight.len(), 4);
        let half = 50.0 * (std::f64::consts::FRAC_PI_8).tan();
        for point in sight {
            let from = (point - DVec2::new(100.0, 200.0)).abs();
            assert!((from.y - half).abs() < 0.01, "{point}");
        }
        assert_eq!(eye(down).heading(), DVec2::ZERO);
    }

    #[test]
    fn an_eye_that_looks_at_the_sky_sees_no_ground() {
        let up = Transform::from_xyz(0.0, 50.0, 0.0).looking_to(Vec3::new(0.0, 1.0, -0.5), Vec3::Y);
        assert!(eye(up).sight(0.0, 1000.0).len() < 3);
        let level = Transform::from_xyz(0.0, 50.0, 0.0).looking_to(Vec3::NEG_Z, Vec3::Y);
        let sight = eye(level).sight(0.0, 1000.0);
        assert!(sight.len() >= 3 && sight.iter().all(|point| point.y < -100.0));
        assert_eq!(eye(level).heading(), DVec2::NEG_Y);
    }
}
