//! Rectangles of samples.

use serde::{Deserialize, Serialize};

/// A half-open rectangle of the samples of some level, which may reach beyond the terrain.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "ecs", derive(bevy::reflect::Reflect))]
pub struct SampleRect {
    /// Least column and row.
    pub min: [i32; 2],
    /// One past the greatest column and row.
    pub max: [i32; 2],
}

impl SampleRect {
    /// The rectangle from `min` to before `max`.
    #[must_use]
    pub const fn new(min: [i32; 2], max: [i32; 2]) -> Self {
        Self { min, max }
    }

    /// Whether it holds no sample.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.min[0] >= self.max[0] || self.min[1] >= self.max[1]
    }

    /// Columns and rows of samples; 0 where it is empty.
    #[must_use]
    pub fn size(&self) -> [usize; 2] {
        [0, 1].map(|axis| (i64::from(self.max[axis]) - i64::from(self.min[axis])).max(0) as usize)
    }

    /// What both hold; may be empty.
    #[must_use]
    pub fn intersection(&self, other: &Self) -> Self {
        Self {
            min: [0, 1].map(|axis| self.min[axis].max(other.min[axis])),
            max: [0, 1].map(|axis| self.max[axis].min(other.max[axis])),
        }
    }

    /// The least rectangle that holds both; an empty one adds nothing.
    #[must_use]
    pub fn union(&self, other: &Self) -> Self {
        if self.is_empty() {
            return *other;
        }
        if other.is_empty() {
            return *self;
        }
        Self {
            min: [0, 1].map(|axis| self.min[axis].min(other.min[axis])),
            max: [0, 1].map(|axis| self.max[axis].max(other.max[axis])),
        }
    }

    /// The rectangle moved by `by`; an empty one stays as it is.
    #[must_use]
    pub fn moved(&self, by: [i32; 2]) -> Self {
        if self.is_empty() {
            return *self;
        }
        let moved = |corner: [i32; 2]| [0, 1].map(|axis| corner[axis].saturating_add(by[axis]));
        Self {
            min: moved(self.min),
            max: moved(self.max),
        }
    }

    /// The rectangle with `by` more samples to every side.
    #[must_use]
    pub fn grown(&self, by: i32) -> Self {
        Self {
            min: self.min.map(|at| at.saturating_sub(by)),
            max: self.max.map(|at| at.saturating_add(by)),
        }
    }
}
