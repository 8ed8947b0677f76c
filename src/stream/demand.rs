//! What a terrain's views and pins ask for, and whether that has changed.

use super::fade::FadeView;
use super::state::TerrainState;
use crate::residency::EyePath;
use crate::view::TerrainViews;
use bevy::prelude::*;

/// A plan is made anew when an eye has moved further than a finest tile's side divided by two to
/// this power.
const REPLAN_LOG2: u32 = 3;
impl TerrainState {
    /// Notes where the eyes are.
    pub(super) fn look(&mut self, entity: Entity, cameras: &Query<&TerrainViews>) {
        self.eyes.clear();
        self.fades.clear();
        let spacing_m = self.manifest.file.spacing_m;
        let unit_m = self.lattice.unit_m(spacing_m);
        let views = cameras.iter().flat_map(|views| &views.views);
        for view in views.filter(|view| view.terrain == entity) {
            let velocity = view.velocity_m_s / unit_m;
            self.eyes.push(EyePath {
                lod: view.lod,
                velocity: [velocity.x as f32, velocity.z as f32],
                descent: if view.lod.planar {
                    -velocity.y as f32
                } else {
                    0.0
                },
            });
            self.fades.push(FadeView {
                lod: view.lod,
                unit_m: unit_m as f32,
                focal_px: view.focal_px,
                px_per_m: view.px_per_m,
            });
        }
    }

    /// Whether what the latest plan was made for has changed enough to matter.
    pub(super) fn wants_plan(&mut self, lookahead_s: f32) -> bool {
        let slack = self.lattice.node_size(0) >> REPLAN_LOG2;
        let still = |(old, new): (&EyePath, &EyePath)| {
            let (a, b) = (&old.lod, &new.lod);
            let moved = (b.eye - a.eye).abs().max_element();
            let moved = moved.max((b.floor - a.floor).abs());
            let turned = [0, 1].map(|axis| (new.velocity[axis] - old.velocity[axis]).abs());
            let turned = turned[0]
                .max(turned[1])
                .max((new.descent - old.descent).abs());
            moved <= slack
                && turned * lookahead_s <= slack as f32
                && b.planar == a.planar
                && b.reach == a.reach
        };
        let same = self.planned_eyes.len() == self.eyes.len()
            && self.planned_eyes.iter().zip(&self.eyes).all(still)
            && self.planned_pins == self.pins;
        std::mem::take(&mut self.must_plan) || !same
    }
}
