//! Rays against the ground.
//!
//! A ray goes down the quadtree of resident tiles, nearest square first, and on through the blocks
//! of the finest one, past everything that its bounds say it passes over or under; in the cells that
//! are left, it is intersected with the bilinear patch exactly. The squares that it visits share the
//! numbers at which it goes from one to the next, and on which side of the ground it was last is
//! remembered. So it can't slip through between two cells, nor between two tiles of different
//! levels, whose grounds needn't meet: where it comes out on the other side, it has hit the wall
//! between them.

use super::surface::{Patch, corners};
use super::{BlockRanges, GroundReader, GroundSource, blocks::FINEST_LOG2};
use crate::tile::{HeightTile, TILE_SAMPLES, TileAddress, TileRange};
use glam::{BVec3, DVec2, DVec3};

/// Rays end here, in lengths of their direction: far enough, and short of what can't be computed
/// with.
const FARTHEST: f64 = 1e18;
const TILE_LOG2: u32 = TILE_SAMPLES.ilog2();

/// A ray in a terrain's own space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundRay {
    /// Where it starts, in metres.
    pub origin_m: DVec3,
    /// Where it goes. Not necessarily a unit vector: distances count its lengths.
    pub direction: DVec3,
    /// How far it goes, in lengths of `direction`; may be infinite.
    pub max_distance: f64,
}

/// Where a ray hits the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GroundHit {
    /// How far from the ray's origin, in lengths of its direction.
    pub distance: f64,
    /// The place, in metres of the terrain's own space.
    pub point_m: DVec3,
    /// The unit vector that stands upright on the ground there, upwards whichever side was hit.
    pub normal: DVec3,
    /// The level that the answer comes from, as in
    /// [`TerrainHeight::level`](super::TerrainHeight::level).
    pub level: u8,
    /// Whether the ray came from below the ground.
    pub is_from_below: bool,
}

impl GroundRay {
    /// Where the ray first meets the ground of `source`, from above or from below; where it starts on
    /// the ground, there. The ground is that of the finest resident tiles, and ends at the terrain's
    /// rim: who comes from beyond it below the ground's height meets it from below, or not at all.
    /// Where tiles of different levels meet, their grounds may leave an upright gap, and that is
    /// ground too.
    ///
    /// `None` where there is no hit, while nothing is resident, for numbers that aren't finite (but
    /// for the greatest distance), for a direction of no length and for a negative distance.
    ///
    /// Cost: one to two microseconds; for each tile on the way that no ray has met since its heights
    /// changed, some microseconds once.
    #[must_use]
    pub fn cast<S: GroundSource + ?Sized>(&self, source: &S) -> Option<GroundHit> {
        let file = source.file();
        let root = TileAddress::new(file.levels.checked_sub(1)?, 0, 0);
        if !source.is_resident(root) {
            return None;
        }
        // Horizontally in samples of level 0, vertically in stored units.
        let unit_m = DVec3::new(file.spacing_m, file.height_step_m, file.spacing_m);
        let last = file.size.map(|samples| f64::from(samples) - 1.0);
        let origin = (self.origin_m - DVec3::Y * file.height_min_m) / unit_m;
        let mut walk = Walk::new(origin, self.direction / unit_m, DVec2::from(last))?;
        let (from, to) = walk.on_the_terrain(self.max_distance)?;
        let distance = walk.tile(source, root, from, to)?;

        let point_m = self.origin_m + self.direction * distance;
        let on =
            DVec2::new(point_m.x, point_m.z).clamp(DVec2::ZERO, DVec2::from(last) * file.spacing_m);
        let ground = GroundReader::new(source).sample(on)?;
        let normal = ground.normal();
        Some(GroundHit {
            distance,
            point_m,
            normal,
            level: ground.level,
            is_from_below: match walk.side {
                Side::Above => false,
                Side::Below => true,
                Side::Unknown => self.direction.dot(normal) > 0.0,
            },
        })
    }
}

/// On which side of the ground a ray is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Side {
    Unknown,
    Above,
    Below,
}

/// What is left of a ray's way through something whose bounds are known.
enum Passage {
    /// Nothing: it passes over it or under it.
    Past,
    /// It came from the other side.
    Hit(f64),
    /// A part of it, and on which side of the ground the rest is.
    Through(f64, f64, Side),
}

/// A ray on its way. Horizontally in samples of level 0, vertically in stored units.
struct Walk {
    origin: DVec3,
    direction: DVec3,
    /// One by the direction; 0 along axes that the ray doesn't go.
    inverse: DVec3,
    /// The terrain's last sample.
    last: DVec2,
    /// The side on which the ray was last.
    side: Side,
}

/// A resident tile that a ray passes through.
#[derive(Clone, Copy)]
struct Inside<'a> {
    heights: &'a HeightTile,
    blocks: Option<&'a BlockRanges>,
    address: TileAddress,
}

impl Walk {
    fn new(origin: DVec3, direction: DVec3, last: DVec2) -> Option<Self> {
        if !(origin.is_finite() && direction.is_finite()) {
            return None;
        }
        // What goes too slowly for its inverse to be a number doesn't go.
        let inverse = direction.recip();
        let goes = BVec3::from_array(inverse.to_array().map(f64::is_finite));
        if !goes.any() {
            return None;
        }
        Some(Self {
            origin,
            direction: DVec3::select(goes, direction, DVec3::ZERO),
            inverse: DVec3::select(goes, inverse, DVec3::ZERO),
            last,
            side: Side::Unknown,
        })
    }

    /// From where to where the ray is over or under the terrain.
    fn on_the_terrain(&self, max_distance: f64) -> Option<(f64, f64)> {
        let (mut from, mut to) = (0.0_f64, max_distance.min(FARTHEST));
        for (origin, inverse, last) in [
            (self.origin.x, self.inverse.x, self.last.x),
            (self.origin.z, self.inverse.z, self.last.y),
        ] {
            if inverse == 0.0 {
                if !(0.0..=last).contains(&origin) {
                    return None;
                }
                continue;
            }
            let (a, b) = (-origin * inverse, (last - origin) * inverse);
            from = from.max(a.min(b));
            to = to.min(a.max(b));
        }
        // `f64::min` would have made a distance of a number that isn't one.
        (from <= to && !max_distance.is_nan()).then_some((from, to))
    }

    /// Notes that the ray is on a side of the ground, at `t`: a hit where it was on the other.
    fn note(&mut self, t: f64, side: Side) -> Option<f64> {
        match (self.side, side) {
            (Side::Above, Side::Below) | (Side::Below, Side::Above) => return Some(t),
            (_, Side::Unknown) => {}
            _ => self.side = side,
        }
        None
    }

    /// What is left of the way between `from` and `to` where the ground lies in `range`.
    fn pass(&mut self, range: TileRange, from: f64, to: f64) -> Passage {
        let past =
            |walk: &mut Self, side| walk.note(from, side).map_or(Passage::Past, Passage::Hit);
        // A little more, so that roundings leave what is found well inside.
        let (low, high) = (f64::from(range.min) - 0.5, f64::from(range.max) + 0.5);
        let at = self.origin.y;
        if self.inverse.y == 0.0 {
            return if at > high {
                past(self, Side::Above)
            } else if at < low {
                past(self, Side::Below)
            } else {
                Passage::Through(from, to, Side::Unknown)
            };
        }
        let (low, high) = ((low - at) * self.inverse.y, (high - at) * self.inverse.y);
        let (enter, before, leave, after) = if self.direction.y < 0.0 {
            (high, Side::Above, low, Side::Below)
        } else {
            (low, Side::Below, high, Side::Above)
        };
        if enter >= to {
            return past(self, before);
        }
        if leave <= from {
            return past(self, after);
        }
        if enter > from
            && let Some(hit) = self.note(from, before)
        {
            return Passage::Hit(hit);
        }
        let after = if leave < to { after } else { Side::Unknown };
        Passage::Through(from.max(enter), to.min(leave), after)
    }

    /// Whether the ray at `from` is beyond the line `middle` along an axis, and when it crosses that
    /// before `to`; infinity where it doesn't.
    fn crossing(
        [origin, direction, inverse, last]: [f64; 4],
        middle: f64,
        [from, to]: [f64; 2],
    ) -> (bool, f64) {
        // Beyond the terrain there is nothing.
        if middle >= last {
            return (false, f64::INFINITY);
        }
        if direction == 0.0 {
            return (origin >= middle, f64::INFINITY);
        }
        let at = (middle - origin) * inverse;
        let is_beyond = (at <= from) == (direction > 0.0);
        let is_on_the_way = from < at && at < to;
        (is_beyond, if is_on_the_way { at } else { f64::INFINITY })
    }

    /// Visits the quarters around `middle` that the ray passes through, in its order, until one gives
    /// a hit.
    fn quarters(
        &mut self,
        middle: DVec2,
        mut from: f64,
        to: f64,
        mut visit: impl FnMut(&mut Self, [u32; 2], f64, f64) -> Option<f64>,
    ) -> Option<f64> {
        let along_x = [self.origin.x, self.direction.x, self.inverse.x, self.last.x];
        let along_z = [self.origin.z, self.direction.z, self.inverse.z, self.last.y];
        let (mut is_right, mut turn_x) = Self::crossing(along_x, middle.x, [from, to]);
        let (mut is_far, mut turn_z) = Self::crossing(along_z, middle.y, [from, to]);
        loop {
            let until = turn_x.min(turn_z).min(to);
            let quarter = [u32::from(is_right), u32::from(is_far)];
            let hit = visit(self, quarter, from, until);
            if hit.is_some() || until >= to {
                return hit;
            }
            if turn_x <= until {
                (is_right, turn_x) = (!is_right, f64::INFINITY);
            }
            if turn_z <= until {
                (is_far, turn_z) = (!is_far, f64::INFINITY);
            }
            from = until;
        }
    }

    /// The hit on a resident tile's square between `from` and `to`.
    fn tile<S: GroundSource + ?Sized>(
        &mut self,
        source: &S,
        address: TileAddress,
        from: f64,
        to: f64,
    ) -> Option<f64> {
        let (from, to, after) = match source.range(address) {
            None => (from, to, Side::Unknown),
            Some(range) => match self.pass(range, from, to) {
                Passage::Past => return None,
                Passage::Hit(hit) => return Some(hit),
                Passage::Through(from, to, after) => (from, to, after),
            },
        };
        // Only now is anything read that may lie far away in memory.
        let own = || {
            Some(Inside {
                heights: source.heights(address)?,
                blocks: source.blocks(address),
                address,
            })
        };
        let hit = match address.children() {
            None => self.block(own()?, TILE_LOG2, [0, 0], from, to),
            Some([first, ..]) => {
                let size = f64::from(TILE_SAMPLES) * f64::from(1_u32 << first.level);
                let middle = DVec2::new(f64::from(first.x) + 1.0, f64::from(first.z) + 1.0) * size;
                self.quarters(middle, from, to, |walk, [x, z], from, to| {
                    let child = TileAddress::new(first.level, first.x + x, first.z + z);
                    if source.is_resident(child) {
                        walk.tile(source, child, from, to)
                    } else {
                        walk.block(own()?, TILE_LOG2 - 1, [x, z], from, to)
                    }
                })
            }
        };
        hit.or_else(|| self.note(to, after))
    }

    /// The hit on a tile's own ground in a block of `2^log2` cells a side, between `from` and `to`.
    fn block(
        &mut self,
        tile: Inside<'_>,
        log2: u32,
        [x, z]: [u32; 2],
        from: f64,
        to: f64,
    ) -> Option<f64> {
        let range = tile.blocks.and_then(|blocks| blocks.get(log2, x, z));
        let (from, to, after) = match range {
            None => (from, to, Side::Unknown),
            Some(range) => match self.pass(range, from, to) {
                Passage::Past => return None,
                Passage::Hit(hit) => return Some(hit),
                Passage::Through(from, to, after) => (from, to, after),
            },
        };
        let hit = if log2 == FINEST_LOG2 {
            self.cells(tile, [x << log2, z << log2], from, to)
        } else {
            let (first_x, first_z) = tile.address.first_sample();
            let half = 1 << (log2 - 1);
            let middle = DVec2::new(
                f64::from(first_x + (x << log2) + half),
                f64::from(first_z + (z << log2) + half),
            ) * f64::from(1_u32 << tile.address.level);
            self.quarters(middle, from, to, |walk, [right, far], from, to| {
                walk.block(tile, log2 - 1, [2 * x + right, 2 * z + far], from, to)
            })
        };
        hit.or_else(|| self.note(to, after))
    }

    /// The hit in one of the cells of a smallest block, whose first one is given, between `from` and
    /// `to`.
    fn cells(&mut self, tile: Inside<'_>, first: [u32; 2], mut from: f64, to: f64) -> Option<f64> {
        let size = f64::from(1_u32 << tile.address.level);
        let (first_x, first_z) = tile.address.first_sample();
        let mut x = Cells::new(
            [self.origin.x, self.direction.x, self.inverse.x, self.last.x],
            size,
            [first_x, first[0]],
            from,
        );
        let mut z = Cells::new(
            [self.origin.z, self.direction.z, self.inverse.z, self.last.y],
            size,
            [first_z, first[1]],
            from,
        );
        loop {
            let until = x.next.min(z.next).min(to);
            let hit = self.patch(tile.heights, &x, &z, from, until);
            if hit.is_some() || until >= to {
                return hit;
            }
            if x.next <= until {
                x.step();
            }
            if z.next <= until {
                z.step();
            }
            from = until;
        }
    }

    /// The hit in one cell, between `from` and `to`.
    fn patch(
        &mut self,
        heights: &HeightTile,
        x: &Cells,
        z: &Cells,
        from: f64,
        to: f64,
    ) -> Option<f64> {
        let corners = corners(heights, x.cell, z.cell);
        let height = self.origin.y + self.direction.y * from;
        let end = self.origin.y + self.direction.y * to;
        let [a, b, c, d] = corners;
        if height.min(end) > f64::from(a.max(b).max(c.max(d))) {
            return self.note(from, Side::Above);
        }
        if height.max(end) < f64::from(a.min(b).min(c.min(d))) {
            return self.note(from, Side::Below);
        }
        let part = DVec2::new(x.part(from), z.part(from));
        let step = DVec2::new(x.pace, z.pace);
        let clearance = Patch::through(corners).clearance(part, height, step, self.direction.y);
        let side = |clearance: f64| {
            if clearance > 0.0 {
                Side::Above
            } else {
                Side::Below
            }
        };
        if clearance[0] == 0.0 {
            return Some(from);
        }
        if let Some(hit) = self.note(from, side(clearance[0])) {
            return Some(hit);
        }
        first_root(clearance, to - from).map(|root| from + root)
    }
}

/// A ray's way through the cells of a block along one axis.
struct Cells {
    /// Its column or row in the tile.
    cell: u32,
    /// When the ray leaves it; infinity where it doesn't, or where it leaves the block with it.
    next: f64,
    /// How far the ray goes along this axis, in cells a unit.
    pace: f64,
    /// Cells between the tile's first and the ray's origin.
    start: f64,
    /// The first and the last cell of the block that lie on the terrain.
    ends: [u32; 2],
    tile_first: u32,
    size: f64,
    origin: f64,
    inverse: f64,
}

impl Cells {
    /// The cells of `size` samples from `first` on, counted from the tile's first one, of which
    /// `tile_first` are before the tile.
    fn new(
        [origin, direction, inverse, last]: [f64; 4],
        size: f64,
        [tile_first, first]: [u32; 2],
        from: f64,
    ) -> Self {
        let before = f64::from(tile_first);
        // The cell that holds the terrain's last sample at its far end.
        let last = (last / size).ceil() - 1.0 - before;
        let end = (first + (1 << FINEST_LOG2) - 1).min(last.max(0.0) as u32);
        let (start, pace) = (origin / size - before, direction / size);
        let at = (start + pace * from).floor();
        let mut cells = Self {
            cell: (at.max(0.0) as u32).clamp(first.min(end), end),
            next: f64::INFINITY,
            pace,
            start,
            ends: [first.min(end), end],
            tile_first,
            size,
            origin,
            inverse,
        };
        cells.next = cells.leaves();
        // The place is rounded and so is the time: the time counts.
        if cells.next <= from {
            cells.step();
        }
        cells
    }

    /// When the ray leaves the cell: by the same formula as for quarters.
    fn leaves(&self) -> f64 {
        let forth = self.inverse > 0.0;
        if self.inverse == 0.0 || self.cell == self.ends[usize::from(forth)] {
            return f64::INFINITY;
        }
        let line = f64::from(self.tile_first + self.cell + u32::from(forth)) * self.size;
        (line - self.origin) * self.inverse
    }

    fn step(&mut self) {
        if self.inverse > 0.0 {
            self.cell += 1;
        } else {
            self.cell -= 1;
        }
        self.next = self.leaves();
    }

    /// Where in the cell the ray is, 0 to 1.
    fn part(&self, t: f64) -> f64 {
        self.start + self.pace * t - f64::from(self.cell)
    }
}

/// The smallest root of `c + b s + a s²` with `0 < s <= end`, where `c` isn't 0.
fn first_root([c, b, a]: [f64; 3], end: f64) -> Option<f64> {
    let at_end = c + (b + a * end) * end;
    let ends_beyond = at_end == 0.0 || (at_end > 0.0) != (c > 0.0);
    let discriminant = b * b - 4.0 * a * c;
    let root = if discriminant < 0.0 {
        None
    } else {
        // Without differences of like numbers.
        let q = -0.5 * (b + discriminant.sqrt().copysign(b));
        [c / q, q / a]
            .into_iter()
            .filter(|&root| root > 0.0 && root <= end)
            .min_by(f64::total_cmp)
    };
    // The ends decide; what is between them is known as well as roundings let.
    root.or(ends_beyond.then_some(end))
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_first_root_is_one_and_no_other_is_before_it(
            roots in (-3.0..3.0_f64, -3.0..3.0_f64),
            a in prop_oneof![Just(0.0), Just(1e-9), -5.0..5.0_f64],
            end in 0.0..4.0_f64,
        ) {
            // a (s - r0) (s - r1); a line through the first root where a is none.
            let (r0, r1) = roots;
            let polynomial = if a == 0.0 { [-r0, 1.0, 0.0] } else { [a * r0 * r1, -a * (r0 + r1), a] };
            prop_assume!(polynomial[0] != 0.0 && (r0 - r1).abs() > 1e-3);
            let wanted = [r0, if a == 0.0 { r0 } else { r1 }]
                .into_iter()
                .filter(|&root| root > 0.0 && root <= end)
                .min_by(f64::total_cmp);
            let close = |root: f64| (root - end).abs() < 1e-6 || root.abs() < 1e-6;
            prop_assume!(!close(r0) && !close(r1));
            match (first_root(polynomial, end), wanted) {
                (Some(found), Some(wanted)) => prop_assert!((found - wanted).abs() < 1e-6),
                (found, wanted) => prop_assert_eq!(found, wanted),
            }
        }
    }
}
