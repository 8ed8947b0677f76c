//! Where ground lies on the map: north, the terrain's -z, is up.

use bevy::math::DVec2;
use bevy_egui::egui::{Pos2, Rect};

/// Part of the map's side that a terrain fills when it is fitted.
const FITTED: f64 = 0.94;
/// The most that a sample's side may take on the map.
const MOST_SAMPLE_PX: f64 = 64.0;

/// What part of the ground the map shows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MapView {
    /// The ground in the map's middle, in metres of the terrain's x and z.
    pub(super) centre_m: DVec2,
    /// Points of the screen a metre.
    pub(super) px_per_m: f64,
}

/// The map on the screen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MapFrame {
    pub(super) view: MapView,
    pub(super) rect: Rect,
}

impl MapView {
    /// The whole terrain, from the corner on `extent_m` metres.
    pub(super) fn fit(extent_m: DVec2, rect: Rect) -> Self {
        let px = DVec2::new(rect.width().into(), rect.height().into()).max(DVec2::ONE);
        Self {
            centre_m: 0.5 * extent_m,
            px_per_m: FITTED * (px / extent_m.max(DVec2::splat(1e-3))).min_element(),
        }
    }
}

impl MapFrame {
    fn middle(&self) -> DVec2 {
        let middle = self.rect.center();
        DVec2::new(middle.x.into(), middle.y.into())
    }

    pub(super) fn to_screen(self, at_m: DVec2) -> Pos2 {
        let px = self.middle() + (at_m - self.view.centre_m) * self.view.px_per_m;
        Pos2::new(px.x as f32, px.y as f32)
    }

    pub(super) fn to_ground(self, at: Pos2) -> DVec2 {
        let px = DVec2::new(at.x.into(), at.y.into()) - self.middle();
        self.view.centre_m + px / self.view.px_per_m
    }

    /// A rectangle of ground on the screen.
    pub(super) fn rect_of(&self, low_m: DVec2, high_m: DVec2) -> Rect {
        Rect::from_min_max(self.to_screen(low_m), self.to_screen(high_m))
    }

    /// The view with the ground moved by so many points.
    pub(super) fn panned(&self, by: [f32; 2]) -> MapView {
        let px = DVec2::new(by[0].into(), by[1].into());
        MapView {
            centre_m: self.view.centre_m - px / self.view.px_per_m,
            ..self.view
        }
    }

    /// The view enlarged by `factor`, with the ground at `at` where it is. It can't be made much smaller
    /// than the terrain, nor larger than its samples.
    pub(super) fn zoomed(&self, factor: f64, at: Pos2, extent_m: DVec2, spacing_m: f64) -> MapView {
        let fitted = MapView::fit(extent_m, self.rect).px_per_m;
        let least = 0.25 * fitted;
        let most = (MOST_SAMPLE_PX / spacing_m).max(fitted);
        let px_per_m = (self.view.px_per_m * factor).clamp(least, most);
        let kept_m = self.to_ground(at);
        let px = DVec2::new(at.x.into(), at.y.into()) - self.middle();
        MapView {
            centre_m: kept_m - px / px_per_m,
            px_per_m,
        }
    }

    /// A round length in metres for a scale bar of at most `most_px` points, and the points that it
    /// takes.
    pub(super) fn scale_bar(&self, most_px: f64) -> (f64, f32) {
        let most_m = most_px / self.view.px_per_m;
        let power = 10.0_f64.powf(most_m.log10().floor());
        let steps = [5.0, 2.0, 1.0];
        let step = steps.into_iter().find(|step| step * power <= most_m);
        let length_m = step.unwrap_or(1.0) * power;
        (length_m, (length_m * self.view.px_per_m) as f32)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use bevy_egui::egui::pos2;
    use proptest::prelude::*;

    fn frame(centre_m: DVec2, px_per_m: f64) -> MapFrame {
        MapFrame {
            view: MapView { centre_m, px_per_m },
            rect: Rect::from_min_max(pos2(10.0, 20.0), pos2(410.0, 320.0)),
        }
    }

    #[test]
    fn a_fitted_terrain_is_seen_whole_with_its_north_up() {
        let extent_m = DVec2::new(8000.0, 2000.0);
        let rect = frame(DVec2::ZERO, 1.0).rect;
        let frame = MapFrame {
            view: MapView::fit(extent_m, rect),
            rect,
        };
        let ground = frame.rect_of(DVec2::ZERO, extent_m);
        assert!(rect.contains_rect(ground), "{ground:?}");
        assert!(ground.width() > 0.9 * rect.width());
        let north = frame.to_screen(DVec2::new(4000.0, 0.0));
        let south = frame.to_screen(DVec2::new(4000.0, 2000.0));
        assert!(north.y < south.y && (north.x - south.x).abs() < 1e-3);
    }

    #[test]
    fn a_scale_bar_is_round_and_fits() {
        for (px_per_m, length_m) in [(1.0, 100.0), (0.3, 200.0), (0.011, 10_000.0), (55.0, 2.0)] {
            let (found_m, px) = frame(DVec2::ZERO, px_per_m).scale_bar(120.0);
            assert_eq!(found_m, length_m);
            assert!(px <= 120.0 && px > 40.0, "{px}");
        }
    }

    proptest! {
        #[test]
        fn zooming_keeps_the_ground_under_the_pointer(
            x in 0.0..4096.0, z in 0.0..4096.0, scale in -4.0..1.0,
            px in 10.0_f32..410.0, py in 20.0_f32..320.0, factor in 0.5..2.0,
        ) {
            let extent_m = DVec2::splat(4096.0);
            let before = frame(DVec2::new(x, z), f64::exp2(scale));
            let at = pos2(px, py);
            let kept_m = before.to_ground(at);
            let view = before.zoomed(factor, at, extent_m, 1.0);
            let after = MapFrame { view, ..before };
            let [x, y] = [after.to_screen(kept_m).x - px, after.to_screen(kept_m).y - py];
            prop_assert!(x.abs() < 0.01 && y.abs() < 0.01, "{x} {y}");
        }
    }
}
