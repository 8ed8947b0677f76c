//! Where colliders are made, and what they may take.

use crate::tile::TILE_SAMPLES;
use bevy::prelude::*;
use std::ops::RangeInclusive;
use thiserror::Error;

/// Where the ground gets colliders, and how many; a resource that may change at any time. What
/// can't be used is logged and replaced by its default.
#[derive(Resource, Clone, Debug, PartialEq, Reflect)]
#[reflect(Resource, Default, Debug, Clone, PartialEq)]
pub struct TerrainPhysics {
    /// Cells of level 0 along a collider's side: 16, 32, 64 or 128, a whole tile. A collider of 64
    /// takes 21 KiB, twice that where the terrain is scaled. Smaller ones follow few bodies more
    /// closely; larger ones have fewer seams, at which bodies that slide may catch. Another number
    /// makes all colliders anew.
    pub chunk_cells: u32,
    /// Metres around a body's box within which the ground gets colliders, 0 to 10 000.
    pub margin_m: f32,
    /// How far ahead along their velocity bodies are followed, 0 to 60 s. Colliders are asked for,
    /// and tiles too, that long before a body comes near them.
    pub lookahead_s: f32,
    /// For how long colliders stay that no body and no pin wants any more, 0 to 3600 s.
    pub keep_s: f32,
    /// Colliders that are begun, or made finer, in one physics step at most, 1 to 4096. Edits don't
    /// wait: every collider that an edit touches is right in the next step.
    pub builds_per_step: u32,
    /// The most colliders there may be, of all terrains, 1 to 2^20. Beyond it no more are made, which
    /// is logged once.
    pub max_colliders: u32,
    /// Whether bodies keep the finest tiles under them resident, as a
    /// [`TerrainPin`](crate::stream::TerrainPin) does. A server needs it; a game whose bodies are all
    /// in view may do without.
    pub keep_resident: bool,
    /// Whether kinematic bodies get ground too. They don't collide with it by themselves, but
    /// character controllers that cast their shape at it want it to be there.
    pub kinematic_bodies: bool,
    /// Whether bodies that stood on the ground are lifted with it where it rises under them, be it
    /// by an edit or because finer tiles have arrived: as far as the ground under a body's middle has
    /// risen. A heightfield has no inside; a body that the ground has passed would fall for good.
    pub lift_bodies: bool,
}

impl Default for TerrainPhysics {
    fn default() -> Self {
        Self {
            chunk_cells: 64,
            margin_m: 8.0,
            lookahead_s: 1.0,
            keep_s: 4.0,
            builds_per_step: 16,
            max_colliders: 4096,
            keep_resident: true,
            kinematic_bodies: true,
            lift_bodies: true,
        }
    }
}

/// What is wrong with a [`TerrainPhysics`].
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum TerrainPhysicsError {
    /// The side of a collider doesn't divide a tile.
    #[error("TerrainPhysics::chunk_cells is {0}: use 16, 32, 64 or 128")]
    ChunkCells(u32),
    /// A length or time is out of its range.
    #[error("TerrainPhysics::{name} is {value}: use a number from 0 to {most}")]
    Number {
        /// The field.
        name: &'static str,
        /// Its value.
        value: f32,
        /// The most that it may be.
        most: f32,
    },
    /// A count is out of its range.
    #[error("TerrainPhysics::{name} is {value}: use a number from 1 to {most}")]
    Count {
        /// The field.
        name: &'static str,
        /// Its value.
        value: u32,
        /// The most that it may be.
        most: u32,
    },
}

impl TerrainPhysics {
    /// Sides of a collider that are accepted, in cells.
    pub const CHUNK_CELLS: [u32; 4] = [16, 32, 64, TILE_SAMPLES];
    /// Margins that are accepted, in metres.
    pub const MARGIN_RANGE: RangeInclusive<f32> = 0.0..=1e4;
    /// Times ahead of bodies that are accepted, in seconds.
    pub const LOOKAHEAD_RANGE: RangeInclusive<f32> = 0.0..=60.0;
    /// Times that colliders stay for which are accepted, in seconds.
    pub const KEEP_RANGE: RangeInclusive<f32> = 0.0..=3600.0;
    /// Numbers of colliders begun in a step that are accepted.
    pub const BUILDS_RANGE: RangeInclusive<u32> = 1..=1 << 12;
    /// Numbers of colliders that are accepted.
    pub const MAX_COLLIDERS_RANGE: RangeInclusive<u32> = 1..=1 << 20;

    /// These settings with every value that can't be used replaced by its default, each of which
    /// is given to `refused`.
    #[must_use]
    pub fn checked(&self, mut refused: impl FnMut(TerrainPhysicsError)) -> Self {
        let default = Self::default();
        let chunk_cells = if Self::CHUNK_CELLS.contains(&self.chunk_cells) {
            self.chunk_cells
        } else {
            refused(TerrainPhysicsError::ChunkCells(self.chunk_cells));
            default.chunk_cells
        };
        let mut number = |name, value: f32, range: RangeInclusive<f32>, default: f32| {
            // Not a number is in no range.
            if range.contains(&value) {
                return value;
            }
            let most = *range.end();
            refused(TerrainPhysicsError::Number { name, value, most });
            default
        };
        let margin_m = number(
            "margin_m",
            self.margin_m,
            Self::MARGIN_RANGE,
            default.margin_m,
        );
        let lookahead_s = number(
            "lookahead_s",
            self.lookahead_s,
            Self::LOOKAHEAD_RANGE,
            default.lookahead_s,
        );
        let keep_s = number("keep_s", self.keep_s, Self::KEEP_RANGE, default.keep_s);
        let mut count = |name, value: u32, range: RangeInclusive<u32>, default: u32| {
            if range.contains(&value) {
                return value;
            }
            let most = *range.end();
            refused(TerrainPhysicsError::Count { name, value, most });
            default
        };
        Self {
            chunk_cells,
            margin_m,
            lookahead_s,
            keep_s,
            builds_per_step: count(
                "builds_per_step",
                self.builds_per_step,
                Self::BUILDS_RANGE,
                default.builds_per_step,
            ),
            max_colliders: count(
                "max_colliders",
                self.max_colliders,
                Self::MAX_COLLIDERS_RANGE,
                default.max_colliders,
            ),
            ..*self
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_settings_are_named_and_replaced() {
        let settings = TerrainPhysics {
            chunk_cells: 48,
            margin_m: f32::NAN,
            lookahead_s: -1.0,
            keep_s: f32::INFINITY,
            builds_per_step: 0,
            max_colliders: u32::MAX,
            ..default()
        };
        let mut errors = Vec::new();
        let checked = settings.checked(|error| errors.push(error.to_string()));
        assert_eq!(checked, TerrainPhysics::default());
        assert_eq!(errors.len(), 6, "{errors:?}");
        let fine = TerrainPhysics {
            chunk_cells: 128,
            keep_resident: false,
            ..default()
        };
        assert_eq!(fine.checked(|error| panic!("{error}")), fine);
    }
}
