//! Which tiles of a level an eye needs, as rectangles and times.

use super::tile_bits::{TileBits, words_of};
use super::{Availability, EyePath, PinnedRegion, ResidentTiles, SPEED_MAX};
use crate::lattice::{Lattice, MAX_LEVELS, ViewLod};
use crate::tile::TileAddress;
use std::ops::Range;

/// A reach that never ends.
const ENDLESS: i64 = i64::MAX / 4;
/// Distances are told apart by tile sizes divided by two to this power.
const DISTANCE_LOG2: u32 = 10;
/// Distances from here on are not told apart.
const DISTANCE_MAX: i64 = (1 << 30) - 1;

/// One level of a terrain. All numbers that follow are 64-bit: sums of lattice points and reaches
/// don't fit 32.
#[derive(Clone, Copy, Debug)]
pub(super) struct Level {
    pub(super) level: u8,
    size_log2: u32,
    extent: [i64; 2],
    /// Tiles in x and z that have an area on the terrain.
    pub(super) tiles: [u32; 2],
}

impl Level {
    pub(super) fn new(lattice: &Lattice, level: u8, bits: &TileBits) -> Self {
        let size_log2 = lattice.node_log2(i32::from(level));
        let extent = [lattice.extent.x, lattice.extent.y].map(i64::from);
        let squares = bits.tiles(level);
        let tiles = [0, 1].map(|axis| {
            let on_terrain = (extent[axis] + (1 << size_log2) - 1) >> size_log2;
            on_terrain.clamp(0, i64::from(squares[axis])) as u32
        });
        Self {
            level,
            size_log2,
            extent,
            tiles,
        }
    }

    /// First and last lattice point of the tiles in a column (axis 0) or row (axis 1).
    fn span(&self, axis: usize, at: u32) -> [i64; 2] {
        let low = i64::from(at) << self.size_log2;
        [low, (low + (1 << self.size_log2)).min(self.extent[axis])]
    }

    /// The tiles from number `low` to number `high`, both included, as far as there are any.
    fn clamp(&self, axis: usize, low: i64, high: i64) -> Range<u32> {
        let count = i64::from(self.tiles[axis]);
        let low = low.clamp(0, count);
        let high = high.saturating_add(1).clamp(low, count);
        low as u32..high as u32
    }

    /// A length in tile sizes, fixed point. Rounds down, so that order is kept among lengths and
    /// between a level and the next.
    fn in_tiles(&self, length: i64) -> u32 {
        let scaled = match self.size_log2.checked_sub(DISTANCE_LOG2) {
            Some(down) => length >> down,
            None => length << (DISTANCE_LOG2 - self.size_log2),
        };
        scaled.clamp(0, DISTANCE_MAX) as u32
    }
}

/// A half-open rectangle of tiles.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct TileRect {
    pub(super) x: Range<u32>,
    pub(super) z: Range<u32>,
}

impl TileRect {
    pub(super) fn whole(level: &Level) -> Self {
        Self {
            x: 0..level.tiles[0],
            z: 0..level.tiles[1],
        }
    }

    pub(super) fn is_empty(&self) -> bool {
        self.x.is_empty() || self.z.is_empty()
    }

    pub(super) fn contains(&self, x: u32, z: u32) -> bool {
        self.x.contains(&x) && self.z.contains(&z)
    }

    /// The tiles that a pinned region touches.
    pub(super) fn pinned(level: &Level, pin: &PinnedRegion) -> Self {
        if level.level < pin.finest_level {
            return Self::default();
        }
        let span = |axis: usize, low: i32, high: i32| {
            let (low, high) = (i64::from(low), i64::from(high));
            if low >= high || low > level.extent[axis] {
                return 0..0;
            }
            // The terrain's last line belongs to its last tiles.
            let low = low.min(level.extent[axis] - 1);
            level.clamp(axis, low >> level.size_log2, (high - 1) >> level.size_log2)
        };
        Self {
            x: span(0, pin.low.x, pin.high.x),
            z: span(1, pin.low.y, pin.high.y),
        }
    }
}

/// An eye and its path, fit to be reckoned with.
#[derive(Clone, Copy, Debug)]
pub(super) struct Eye {
    at: [i64; 2],
    floor: i64,
    planar: bool,
    velocity: [f64; 2],
    descent: f64,
    /// By tile level. No level reaches further than the next coarser one, whatever the view says.
    reach: [i64; MAX_LEVELS],
}

impl Eye {
    pub(super) fn new(lattice: &Lattice, path: &EyePath) -> Self {
        let speed = |speed: f32| {
            if speed.is_nan() {
                0.0
            } else {
                f64::from(speed.clamp(-SPEED_MAX, SPEED_MAX))
            }
        };
        Self {
            velocity: path.velocity.map(speed),
            descent: speed(path.descent).max(0.0),
            ..Self::standing(lattice, &path.lod)
        }
    }

    fn standing(lattice: &Lattice, lod: &ViewLod) -> Self {
        let mut reach = [0; MAX_LEVELS];
        let mut least = 0;
        for (level, reach) in (0..).zip(&mut reach) {
            let own = lod.reach.get(lattice.level_index(level)).copied();
            least = match own {
                None | Some(i32::MAX) => ENDLESS,
                Some(own) => i64::from(own).max(least),
            };
            *reach = least;
        }
        Self {
            at: [lod.eye.x, lod.eye.y].map(i64::from),
            floor: i64::from(lod.floor.max(0)),
            planar: lod.planar,
            velocity: [0.0; 2],
            descent: 0.0,
            reach,
        }
    }

    /// The tiles that are needed where the eye is.
    pub(super) fn now(&self, level: &Level) -> TileRect {
        let reach = self.reach[usize::from(level.level)];
        if self.floor >= reach {
            return TileRect::default();
        }
        if !self.planar || reach == ENDLESS {
            return TileRect::whole(level);
        }
        let span = |axis: usize| {
            let (low, high) = (self.at[axis] - reach, self.at[axis] + reach);
            if low >= level.extent[axis] {
                return 0..0;
            }
            level.clamp(axis, low >> level.size_log2, (high - 1) >> level.size_log2)
        };
        TileRect {
            x: span(0),
            z: span(1),
        }
    }

    /// How far the tiles of a column (axis 0) or row (axis 1) are, in tile sizes, fixed point.
    pub(super) fn distance(&self, level: &Level, axis: usize, at: u32) -> u32 {
        let [low, high] = level.span(axis, at);
        let at = self.at[axis];
        level.in_tiles((low - at).max(at - high).max(0))
    }

    /// The view's floor in tile sizes, fixed point: no tile is nearer.
    pub(super) fn floor_distance(&self, level: &Level) -> u32 {
        level.in_tiles(self.floor)
    }

    /// What the eye comes to need of a level within `horizon_s`; nothing where that is 0.
    pub(super) fn soon(&self, level: &Level, horizon_s: f64) -> Option<Sweep> {
        let reach = self.reach[usize::from(level.level)];
        if reach == ENDLESS || reach <= 0 || horizon_s <= 0.0 {
            return None;
        }
        let is_low = self.floor < reach;
        let floor_s = if is_low {
            0.0
        } else if self.descent > 0.0 {
            (self.floor - reach) as f64 / self.descent
        } else {
            return None;
        };
        let stands = self.velocity == [0.0; 2] || !self.planar;
        if (stands && is_low) || floor_s >= horizon_s {
            return None;
        }
        let mut sweep = Sweep {
            rect: TileRect::whole(level),
            floor_s,
            horizon_s,
            reach: reach as f64,
        };
        if self.planar {
            sweep.rect.x = self.swept(level, 0, &sweep, [0.0, horizon_s]);
            sweep.rect.z = self.swept(level, 1, &sweep, [0.0, horizon_s]);
        }
        (!sweep.rect.is_empty()).then_some(sweep)
    }

    /// The tiles along an axis that come into reach between two times; a few more, as places are
    /// rounded.
    fn swept(&self, level: &Level, axis: usize, sweep: &Sweep, times_s: [f64; 2]) -> Range<u32> {
        let places = times_s.map(|time_s| self.at[axis] as f64 + self.velocity[axis] * time_s);
        let tile = 1.0 / (1_u64 << level.size_log2) as f64;
        let low = (places[0].min(places[1]) - sweep.reach) * tile;
        let high = (places[0].max(places[1]) + sweep.reach) * tile;
        #[expect(clippy::cast_possible_truncation, reason = "saturates, as it should")]
        let range = level.clamp(axis, low as i64 - 1, high as i64 + 1);
        range
    }

    /// When a column (axis 0) or row (axis 1) of tiles comes into reach and when it leaves it
    /// again; the first is not before the second where it never does.
    pub(super) fn times_s(&self, level: &Level, axis: usize, at: u32, sweep: &Sweep) -> [f64; 2] {
        const ALWAYS: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];
        const NEVER: [f64; 2] = [f64::INFINITY, f64::NEG_INFINITY];
        if !self.planar {
            return ALWAYS;
        }
        let [low, high] = level.span(axis, at);
        let low = (low - self.at[axis]) as f64 - sweep.reach;
        let high = (high - self.at[axis]) as f64 + sweep.reach;
        let speed = self.velocity[axis];
        if speed > 0.0 {
            [low / speed, high / speed]
        } else if speed < 0.0 {
            [high / speed, low / speed]
        } else if low < 0.0 && 0.0 < high {
            ALWAYS
        } else {
            NEVER
        }
    }

    /// The times between which tiles of a row may come into reach, and their columns (or a few
    /// more); `None` where none does.
    pub(super) fn sweep_row(
        &self,
        level: &Level,
        z: u32,
        sweep: &Sweep,
    ) -> Option<([f64; 2], Range<u32>)> {
        let [from_s, until_s] = self.times_s(level, 1, z, sweep);
        let from_s = from_s.max(sweep.floor_s);
        let until_s = until_s.min(sweep.horizon_s);
        if from_s >= until_s {
            return None;
        }
        let times_s = [from_s, until_s];
        let columns = if self.planar {
            let columns = self.swept(level, 0, sweep, times_s);
            // Both are rounded from the same numbers, but not from the same times.
            columns.start.max(sweep.rect.x.start)..columns.end.min(sweep.rect.x.end)
        } else {
            sweep.rect.x.clone()
        };
        (!columns.is_empty()).then_some((times_s, columns))
    }
}

/// What an eye on its path comes to need of a level.
#[derive(Clone, Debug)]
pub(super) struct Sweep {
    /// All such tiles lie in here.
    pub(super) rect: TileRect,
    /// When the floor has sunk below the reach.
    floor_s: f64,
    horizon_s: f64,
    reach: f64,
}

/// What an eye needs now, and what of that is there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Survey {
    pub(super) wanted: u32,
    pub(super) levels_short: u8,
}

/// Counts what an eye needs now, whole rows of tiles at once.
pub(super) fn survey(
    lattice: &Lattice,
    available: &Availability,
    resident: &ResidentTiles,
    eye: &Eye,
) -> Survey {
    let (available, resident) = (available.bits(), resident.bits());
    let mut survey = Survey::default();
    let root_level = available.levels().saturating_sub(1);
    for number in (0..available.levels()).rev() {
        let level = Level::new(lattice, number, available);
        let TileRect { x, z } = eye.now(&level);
        for z in z {
            let can = available.row(number, z);
            let is = resident.row(number, z);
            for (word, mask) in words_of(x.start, x.end) {
                let wanted = can.get(word).copied().unwrap_or(0) & mask;
                survey.wanted += wanted.count_ones();
                let mut missing = wanted & !is.get(word).copied().unwrap_or(0);
                while missing != 0 {
                    let x = word as u32 * u64::BITS + missing.trailing_zeros();
                    missing &= missing - 1;
                    // The greatest so far only grows, so all tiles together climb each level once.
                    while let Some(level) = number.checked_add(survey.levels_short)
                        && level <= root_level
                        && TileAddress::new(number, x, z)
                            .ancestor(level)
                            .is_some_and(|tile| !resident.get(tile))
                    {
                        survey.levels_short += 1;
                    }
                }
            }
        }
    }
    survey
}

/// How many levels coarser the ground is, at worst, than a view may ask for: the greatest
/// difference, over all tiles that the view needs where it is and that can be had, between a
/// tile's level and that of its finest resident ancestor. 0 where all are resident; where not
/// even the root is, it counts as one level above it.
///
/// Cost: a few nanoseconds for each row of needed tiles and each missing tile.
#[must_use]
pub fn levels_short(
    lattice: &Lattice,
    available: &Availability,
    resident: &ResidentTiles,
    lod: &ViewLod,
) -> u8 {
    let eye = Eye::standing(lattice, lod);
    survey(lattice, available, resident, &eye).levels_short
}
