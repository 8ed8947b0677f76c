//! How fast detail may appear and disappear.

use crate::lattice::ViewLod;
use glam::IVec2;

/// However much it would show, detail fades no slower than this part of the rate asked for.
const SLOWEST: f32 = 1.0 / 32.0;

/// A view as far as fading is concerned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct FadeView {
    pub(crate) lod: ViewLod,
    /// Metres a lattice unit.
    pub(crate) unit_m: f32,
    /// Pixels that a metre takes at a distance of a metre; 0 for a parallel projection, and where
    /// nothing is drawn.
    pub(crate) focal_px: f32,
    /// Pixels that a metre takes at any distance, in a parallel projection; else 0.
    pub(crate) px_per_m: f32,
}

impl FadeView {
    /// How many pixels a height of `rise_m` metres takes at most, anywhere in a box.
    pub(crate) fn pixels(&self, rise_m: f32, low: IVec2, high: IVec2) -> f32 {
        let distance_m = self.lod.box_distance(low, high).max(1) as f32 * self.unit_m;
        rise_m * (self.focal_px / distance_m + self.px_per_m)
    }
}

/// How far the field's corners may move in a frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Fade {
    /// Levels at most.
    pub(crate) levels: f32,
    /// Pixels at most by which the ground may move, as far as the slowest fade allows.
    pub(crate) max_px: f32,
}

impl Fade {
    /// How far a corner may move in frame number `frame`, in 1/256 levels, where a whole level
    /// would move the ground by `level_px` pixels.
    pub(crate) fn step(&self, level_px: f32, frame: u64) -> u16 {
        // 16 levels are more than most terrains have. Not a number, as 0 s at an endless rate is,
        // is not above 0.
        let most = if self.levels > 0.0 {
            self.levels.min(16.0)
        } else {
            0.0
        };
        let levels = (self.max_px / level_px).clamp(most * SLOWEST, most);
        // The same total over the frames whatever the fraction: every frame takes what the
        // fraction has gathered since the one before.
        let units = f64::from(levels) * 256.0;
        let gathered = |frame: u64| (units * (frame % (1 << 20)) as f64).floor();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "within 0..=4097"
        )]
        let step = (gathered(frame % (1 << 20) + 1) - gathered(frame)) as u16;
        step
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fade_is_as_fast_as_asked_for_and_no_faster_than_what_shows() {
        let fade = Fade {
            levels: 4.0 / 60.0,
            max_px: 0.2,
        };
        let total = |px: f32| (0..600).map(|at| u32::from(fade.step(px, at))).sum::<u32>();
        assert!((total(0.0)).abs_diff(40 * 256) <= 2, "{}", total(0.0));
        // A level of 20 pixels takes 100 frames.
        assert!(total(20.0).abs_diff(6 * 256) <= 2, "{}", total(20.0));
        let slowest = (40.0 * SLOWEST * 256.0) as u32;
        assert!(total(1e9).abs_diff(slowest) <= 2);
        assert!(total(f32::INFINITY).abs_diff(slowest) <= 2);
    }

    #[test]
    fn no_time_and_odd_rates_do_no_harm() {
        for levels in [0.0, -1.0, f32::NAN] {
            let fade = Fade {
                levels,
                max_px: 0.2,
            };
            assert_eq!(fade.step(1.0, 9), 0);
        }
        let endless = Fade {
            levels: f32::INFINITY,
            max_px: f32::INFINITY,
        };
        assert!(endless.step(0.0, 3) >= 4096);
    }
}
