//! Where a tile lies in its terrain's quadtree.

use super::TILE_SAMPLES;
#[cfg(feature = "ecs")]
use bevy::prelude::ReflectComponent;
use std::fmt;

/// The place of a tile: level 0 is the finest; `x` and `z` count tiles of that level from the
/// terrain's corner.
///
/// Tile `(level, x, z)` owns the level's samples `128 x .. 128 x + 128` (and the one after, which
/// its neighbour owns), where sample `k` of level `l` lies on sample `k << l` of level 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[cfg_attr(
    feature = "ecs",
    derive(bevy::prelude::Component, bevy::prelude::Reflect),
    reflect(Component, PartialEq, Hash)
)]
#[cfg_attr(feature = "ecs", component(immutable))]
pub struct TileAddress {
    /// 0 is the finest level; each level above has half the samples a side.
    pub level: u8,
    /// Column, in tiles of this level.
    pub x: u32,
    /// Row, in tiles of this level.
    pub z: u32,
}

impl TileAddress {
    /// The tile in column `x` and row `z` of `level`.
    #[must_use]
    pub const fn new(level: u8, x: u32, z: u32) -> Self {
        Self { level, x, z }
    }

    /// The tile one level coarser that covers this one.
    #[must_use]
    pub const fn parent(self) -> Self {
        Self::new(self.level + 1, self.x / 2, self.z / 2)
    }

    /// The ancestor at `level`, or `None` where `level` is finer than this tile's.
    #[must_use]
    pub const fn ancestor(self, level: u8) -> Option<Self> {
        if level < self.level {
            return None;
        }
        let up = level - self.level;
        Some(Self::new(level, self.x >> up, self.z >> up))
    }

    /// The four tiles one level finer that this one covers, in row order, or `None` at level 0.
    /// Some of them may lie beyond the terrain.
    #[must_use]
    pub const fn children(self) -> Option<[Self; 4]> {
        if self.level == 0 {
            return None;
        }
        let (level, x, z) = (self.level - 1, self.x * 2, self.z * 2);
        Some([
            Self::new(level, x, z),
            Self::new(level, x + 1, z),
            Self::new(level, x, z + 1),
            Self::new(level, x + 1, z + 1),
        ])
    }

    /// The first own sample in `x` and `z`, counted in samples of this tile's level.
    #[must_use]
    pub const fn first_sample(self) -> (u32, u32) {
        (self.x * TILE_SAMPLES, self.z * TILE_SAMPLES)
    }
}

impl fmt::Display for TileAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}_{}", self.level, self.x, self.z)
    }
}
