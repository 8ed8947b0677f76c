//! A tile and what edits have made of it.

use super::apply::{Values, change_heights};
use super::footprint::{MOST_ERROR, own_texels};
use super::profile::Profile;
use super::raster::GroundLevel;
use super::{
    Change, EDIT_UNITS, Edit, EditGround, EditRaster, EditScratch, Footprint, LevelFootprint,
    SampleRect,
};
use crate::density::{DensityScratch, some_tile_densities};
use crate::tile::{
    DENSITY_BORDER, DENSITY_CELL, DENSITY_STORED, DENSITY_TEXELS, ERROR_SPACINGS, TILE_BORDER,
    TILE_SAMPLES, TILE_STORED, TerrainTile, TileAddress, TileRange, decode_error,
};
use pulp::{Arch, NullaryFnOnce};
use xxhash_rust::xxh3::Xxh3;

const TEXELS: usize = DENSITY_TEXELS as usize;
pub(super) const OWN: usize = TEXELS * TEXELS;
pub(super) const SIDE: usize = TILE_STORED as usize;
/// Rows and columns of samples on a tile's own square, the far edges included.
const SQUARE: usize = TILE_SAMPLES as usize + 1;

/// Memory that tiles are changed in.
#[derive(Clone, Debug, Default)]
pub(super) struct TileScratch {
    density: DensityScratch,
    texels: Vec<u8>,
    columns: Vec<[u32; 2]>,
    differences: Vec<u64>,
    sums: Vec<u64>,
}

/// What applying an edit has changed of a tile. Rectangles may hold more than what differs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TileChange {
    /// Samples whose heights may have changed, counted from the tile's first own sample: within
    /// `-2..131`.
    pub heights: SampleRect,
    /// The tile's own texels whose densities may have changed, within `0..32`.
    pub densities: SampleRect,
    /// The tile's own texels whose error bounds may have changed, within `0..32`.
    pub errors: SampleRect,
    /// Whether a height was cut off, as it can't be lower or higher.
    pub clamped: bool,
}

impl TileChange {
    /// Whether nothing has changed.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        [self.heights, self.densities, self.errors]
            .iter()
            .all(SampleRect::is_empty)
    }
}

/// A tile as it was baked, and as edits have made it.
///
/// # Densities
/// A texel keeps a floor, which is the baked density at first, and a boost, 0 at first. An edit that
/// adds to the ground raises the boost of each texel that its disc meets to what it says, and takes
/// the floor of those away that lie in its disc as a whole: what was there is gone. One that draws the
/// ground somewhere takes floor and boost of the latter. Texels that an edit may have changed then have the
/// largest of floor, boost and the density that the tile's own heights give (without spreading). Coarse
/// texels, which are partly covered, so never fall below what is finer there.
///
/// The texels that a tile stores beyond its own (the border) stay as they were baked: only
/// baking and drawing of files need them.
///
/// # Error bounds
/// Bounds of all edits are added to the baked ones, as [`Footprint`] says, and so hold whatever the
/// order. They never fall.
///
/// # Memory
/// What differs from the base takes as much as the base; besides, 3 KiB, and 28 KiB from the first edit on
/// that raises error bounds.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EditedTile {
    address: TileAddress,
    base: TerrainTile,
    tile: TerrainTile,
    /// Of each of the tile's own texels.
    floors: Box<[u8; OWN]>,
    boosts: Box<[u8; OWN]>,
    /// What edits add to the error bounds, at most [`MOST_ERROR`], a plane for each spacing; empty before the
    /// first.
    sums: Vec<[u32; OWN]>,
    /// The lowest and the highest of each of the 129 rows.
    ranges: Box<[TileRange; SQUARE]>,
    range: TileRange,
}

impl EditedTile {
    /// A tile without edits.
    #[must_use]
    pub fn new(address: TileAddress, base: TerrainTile) -> Self {
        let mut ranges = Box::new([TileRange { min: 0, max: 0 }; SQUARE]);
        measure_rows(base.heights.samples(), 0..SQUARE, &mut ranges);
        Self {
            address,
            tile: base.clone(),
            floors: Box::new(base.densities.own_texels()),
            boosts: Box::new([0; OWN]),
            sums: Vec::new(),
            range: whole_range(&ranges),
            ranges,
            base,
        }
    }

    /// The tile's address.
    #[must_use]
    pub fn address(&self) -> TileAddress {
        self.address
    }

    /// The tile as it is now.
    #[must_use]
    pub fn tile(&self) -> &TerrainTile {
        &self.tile
    }

    /// The tile without any edit.
    #[must_use]
    pub fn base(&self) -> &TerrainTile {
        &self.base
    }

    /// The tile as it is now, without what edits need.
    #[must_use]
    pub fn into_tile(self) -> TerrainTile {
        self.tile
    }

    /// The lowest and the highest of the heights on the tile's own square, as
    /// [`HeightTile::range`](crate::tile::HeightTile::range) gives them. Costs nothing.
    #[must_use]
    pub fn range(&self) -> TileRange {
        self.range
    }

    /// Applies an edit. `ground` is that of the tile's terrain, and made the raster.
    ///
    /// Tiles that share their samples with others, as clones do, copy what changes.
    ///
    /// # Panics
    /// Where the terrain doesn't have the tile's level.
    pub fn apply(
        &mut self,
        ground: &EditGround,
        raster: &EditRaster,
        scratch: &mut EditScratch,
    ) -> TileChange {
        let address = self.address;
        let level = ground.level(address.level);
        let footprint = raster.footprint().level(address.level);
        let mut change = TileChange::default();
        if !raster.footprint().touches(address) {
            return change;
        }
        let part = footprint.heights.intersection(&level.stored(address));
        if !part.is_empty() {
            let (rect, values) = raster.level(address.level);
            let stride = rect.size()[0];
            let skip = [0, 1].map(|axis| (part.min[axis] - rect.min[axis]) as usize);
            let values = Values {
                rect: part,
                values: &values[skip[1] * stride + skip[0]..],
                stride,
            };
            (change.heights, change.clamped) = self.change_heights(level, &raster.edit, &values);
        }
        let scratch = &mut scratch.tile;
        let touched = self.touch_texels(level, &raster.edit, footprint, scratch);
        if !touched.is_empty() {
            self.make_densities(level, touched, None, scratch);
            change.densities = touched;
        }
        change.errors = self.raise_errors(level, footprint);
        if !change.heights.is_empty() {
            self.measure(change.heights);
        }
        change
    }

    /// The tile after many edits, in their order: the same, to the last bit of its state, as applying
    /// each, at a fraction of the cost. Edits that don't touch the tile cost next to nothing.
    ///
    /// Each edit comes with its [footprint](EditRaster::footprint) on the same ground.
    ///
    /// # Panics
    /// Where the terrain doesn't have the tile's level.
    #[must_use]
    pub fn replay<'e>(
        ground: &EditGround,
        address: TileAddress,
        base: TerrainTile,
        edits: impl IntoIterator<Item = (&'e Edit, &'e Footprint)>,
        scratch: &mut EditScratch,
    ) -> Self {
        let mut tile = Self::new(address, base);
        tile.apply_all(ground, edits, scratch);
        tile
    }

    /// Applies many edits at once: [`replay`](Self::replay) on top of those that there are.
    ///
    /// # Panics
    /// Where the terrain doesn't have the tile's level.
    pub fn apply_all<'e>(
        &mut self,
        ground: &EditGround,
        edits: impl IntoIterator<Item = (&'e Edit, &'e Footprint)>,
        scratch: &mut EditScratch,
    ) -> TileChange {
        let address = self.address;
        let level = ground.level(address.level);
        let stored = level.stored(address);
        let mut change = TileChange::default();
        let mut touched_rows = [0_u32; TEXELS];
        scratch.tile.differences.clear();
        for (edit, footprint) in edits {
            if !footprint.touches(address) {
                continue;
            }
            let footprint = footprint.level(address.level);
            let part = footprint.heights.intersection(&stored);
            if !part.is_empty() {
                ground.window_of(&Profile::new(edit), edit, address.level, &part, scratch);
                let values = Values {
                    rect: part,
                    values: &scratch.values,
                    stride: part.size()[0],
                };
                let (rect, clamped) = self.change_heights(level, edit, &values);
                change.heights = change.heights.union(&rect);
                change.clamped |= clamped;
            }
            let scratch = &mut scratch.tile;
            let touched = self.touch_texels(level, edit, footprint, scratch);
            if !touched.is_empty() {
                change.densities = change.densities.union(&touched);
                let columns = u32::MAX >> (TEXELS - touched.size()[0]) << touched.min[0];
                let rows = touched.min[1] as usize..touched.max[1] as usize;
                for row in &mut touched_rows[rows] {
                    *row |= columns;
                }
            }
            let errors = self.add_differences(level, footprint, scratch);
            change.errors = change.errors.union(&errors);
        }
        let scratch = &mut scratch.tile;
        if !change.densities.is_empty() {
            self.make_densities(level, change.densities, Some(&touched_rows), scratch);
        }
        if !change.errors.is_empty() {
            self.sum_differences(change.errors, scratch);
        }
        if !change.heights.is_empty() {
            self.measure(change.heights);
        }
        change
    }

    fn change_heights(
        &mut self,
        level: &GroundLevel,
        edit: &Edit,
        values: &Values<'_>,
    ) -> (SampleRect, bool) {
        let heights = self.tile.heights.samples_mut();
        let change = change_heights(level, self.address, edit, values, heights);
        (change.rect, change.clamped)
    }

    fn measure(&mut self, heights: SampleRect) {
        let row = |at: i32| at.clamp(0, SQUARE as i32) as usize;
        let rows = row(heights.min[1])..row(heights.max[1]);
        measure_rows(self.tile.heights.samples(), rows, &mut self.ranges);
        self.range = whole_range(&self.ranges);
    }

    /// A rectangle of the level's texels in the tile's own, as far as they lie on the terrain.
    fn own_part(&self, level: &GroundLevel, texels: &SampleRect) -> SampleRect {
        let all = SampleRect::new([0; 2], level.extent.texels.map(|count| count as i32));
        let own = own_texels(self.address);
        let part = texels.intersection(&own).intersection(&all);
        if part.is_empty() {
            return SampleRect::default();
        }
        SampleRect {
            min: [0, 1].map(|axis| part.min[axis] - own.min[axis]),
            max: [0, 1].map(|axis| part.max[axis] - own.min[axis]),
        }
    }

    /// Changes floors and boosts. Returns the own texels whose density has to be made anew.
    fn touch_texels(
        &mut self,
        level: &GroundLevel,
        edit: &Edit,
        footprint: &LevelFootprint,
        scratch: &mut TileScratch,
    ) -> SampleRect {
        let number = u32::from(self.address.level);
        // Units along a texel.
        let unit = i64::from(EDIT_UNITS * DENSITY_CELL as i32) << number;
        let reach = i64::from(edit.reach);
        let centre = edit.centre.map(i64::from);
        // Of closed squares that the disc's box meets.
        let box_of_disc = SampleRect {
            min: centre.map(|at| (-(reach - at).div_euclid(unit)) as i32 - 1),
            max: centre.map(|at| (at + reach).div_euclid(unit) as i32 + 1),
        };
        let disc = self.own_part(level, &box_of_disc);
        let around = self.own_part(level, &footprint.density_texels());
        if !disc.is_empty() {
            self.cover(edit, disc, unit, scratch);
        }
        around.union(&disc)
    }

    fn cover(&mut self, edit: &Edit, disc: SampleRect, unit: i64, scratch: &mut TileScratch) {
        let own = own_texels(self.address);
        let reach = i64::from(edit.reach);
        // Squares of the least and the greatest distance of a row or column of texels from the
        // centre. Beyond the reach, they are just that; so two of them have 32 bits.
        let distances = |axis: usize, at: i32| {
            let start = i64::from(own.min[axis] + at) * unit - i64::from(edit.centre[axis]);
            let end = start + unit;
            let least = start.max(-end).max(0);
            let most = end.max(-start);
            [least, most].map(|distance| {
                let distance = distance.min(reach + 1) as u32;
                distance * distance
            })
        };
        let square = edit.reach * edit.reach;
        let (boost, additive) = match &edit.change {
            Change::Crater { density, .. }
            | Change::Raise { density, .. }
            | Change::Stamp { density, .. } => (*density, true),
            Change::Flatten { .. } | Change::Smooth { .. } => (0, false),
        };
        let columns = &mut scratch.columns;
        columns.clear();
        columns.extend((disc.min[0]..disc.max[0]).map(|x| distances(0, x)));
        for z in disc.min[1]..disc.max[1] {
            let [least, most] = distances(1, z);
            let first = z as usize * TEXELS + disc.min[0] as usize;
            let floors = self.floors[first..].iter_mut();
            let boosts = self.boosts[first..].iter_mut();
            for ((floor, own), column) in floors.zip(boosts).zip(&*columns) {
                let meets = column[0] + least <= square;
                let within = column[1] + most <= square;
                if within {
                    *floor = 0;
                    if !additive {
                        *own = 0;
                    }
                }
                if meets {
                    *own = boost.max(*own);
                }
            }
        }
    }

    /// Makes the densities of own texels in `touched` anew; of each row only those whose bit is set
    /// in `rows`.
    fn make_densities(
        &mut self,
        level: &GroundLevel,
        touched: SampleRect,
        rows: Option<&[u32; TEXELS]>,
        scratch: &mut TileScratch,
    ) {
        let [columns, count] = touched.size();
        let (x, z) = self.address.first_sample();
        let texels = &mut scratch.texels;
        texels.clear();
        texels.resize(columns * count, 0);
        some_tile_densities(
            &level.kernel,
            &level.extent,
            [x, z],
            [0, 1].map(|axis| touched.min[axis] as u32..touched.max[axis] as u32),
            self.tile.heights.samples(),
            &mut scratch.density,
            texels,
        );
        let out = self.tile.densities.samples_mut();
        let first = touched.min[0] as usize;
        for (texels, z) in texels.chunks_exact(columns).zip(touched.min[1] as usize..) {
            let bits = rows.map_or(u32::MAX, |rows| rows[z]);
            let stored =
                (z + DENSITY_BORDER as usize) * DENSITY_STORED as usize + DENSITY_BORDER as usize;
            for (x, &density) in (first..).zip(texels) {
                let own = z * TEXELS + x;
                if bits >> x & 1 == 1 {
                    let density = density.max(self.floors[own]).max(self.boosts[own]);
                    out[stored + x] = density;
                }
            }
        }
    }

    /// Raises the error bounds by an edit's. Returns the own texels that may have changed.
    fn raise_errors(&mut self, level: &GroundLevel, footprint: &LevelFootprint) -> SampleRect {
        let mut all = SampleRect::default();
        for (k, &error) in footprint.errors.iter().enumerate() {
            let part = self.own_part(level, &footprint.error_texels(k));
            if error == 0 || part.is_empty() {
                continue;
            }
            if self.sums.is_empty() {
                self.sums = vec![[0; OWN]; ERROR_SPACINGS];
            }
            Arch::new().dispatch(Raise {
                k,
                part,
                error,
                sums: &mut self.sums[k],
                base: self.base.errors.texels(),
                out: self.tile.errors.texels_mut(),
            });
            all = all.union(&part);
        }
        all
    }

    /// Notes down by how much an edit raises the error bounds.
    fn add_differences(
        &self,
        level: &GroundLevel,
        footprint: &LevelFootprint,
        scratch: &mut TileScratch,
    ) -> SampleRect {
        const ROW: usize = TEXELS + 1;
        let mut all = SampleRect::default();
        for (k, &error) in footprint.errors.iter().enumerate() {
            let part = self.own_part(level, &footprint.error_texels(k));
            if error == 0 || part.is_empty() {
                continue;
            }
            let differences = &mut scratch.differences;
            if differences.is_empty() {
                differences.resize(ERROR_SPACINGS * ROW * ROW, 0);
            }
            let plane = &mut differences[k * ROW * ROW..][..ROW * ROW];
            let error = u64::from(error);
            let [left, right] = [part.min[0], part.max[0]].map(|at| at as usize);
            for (row, error) in [(part.min[1], error), (part.max[1], error.wrapping_neg())] {
                let row = &mut plane[row as usize * ROW..][..ROW];
                row[left] = row[left].wrapping_add(error);
                row[right] = row[right].wrapping_sub(error);
            }
            all = all.union(&part);
        }
        all
    }

    /// Raises the error bounds by all that has been noted down.
    fn sum_differences(&mut self, all: SampleRect, scratch: &mut TileScratch) {
        const ROW: usize = TEXELS + 1;
        if self.sums.is_empty() {
            self.sums = vec![[0; OWN]; ERROR_SPACINGS];
        }
        for (k, plane) in scratch.differences.chunks_exact(ROW * ROW).enumerate() {
            let row_sums = &mut scratch.sums;
            row_sums.clear();
            row_sums.resize(ROW, 0);
            let sums = self.sums[k].chunks_exact_mut(TEXELS);
            for (row, sums) in plane.chunks_exact(ROW).zip(sums) {
                let mut sum = 0_u64;
                for ((above, &difference), out) in row_sums.iter_mut().zip(row).zip(sums) {
                    *above = above.wrapping_add(difference);
                    sum = sum.wrapping_add(*above);
                    *out = (u64::from(*out) + sum).min(u64::from(MOST_ERROR)) as u32;
                }
            }
            Arch::new().dispatch(Raise {
                k,
                part: all,
                error: 0,
                sums: &mut self.sums[k],
                base: self.base.errors.texels(),
                out: self.tile.errors.texels_mut(),
            });
        }
        scratch.differences.clear();
    }
}

/// What an edited tile knows besides what can be seen of it.
pub(super) struct TileState {
    pub(super) floors: Box<[u8; OWN]>,
    pub(super) boosts: Box<[u8; OWN]>,
    pub(super) sums: Vec<[u32; OWN]>,
}

impl EditedTile {
    pub(super) fn state(&self) -> TileState {
        TileState {
            floors: self.floors.clone(),
            boosts: self.boosts.clone(),
            sums: self.sums.clone(),
        }
    }

    /// The tile with this state, these heights, and these densities of its own texels; `None` where
    /// those aren't as many as belong.
    pub(super) fn of_state(
        address: TileAddress,
        base: TerrainTile,
        state: TileState,
        heights: &[u16],
        densities: &[u8],
    ) -> Option<Self> {
        let mut edited = Self::new(address, base);
        let TileState {
            floors,
            boosts,
            sums,
        } = state;
        let fits = heights.len() == SIDE * SIDE
            && densities.len() == OWN
            && (sums.is_empty() || sums.len() == ERROR_SPACINGS)
            && sums.as_flattened().iter().all(|&sum| sum <= MOST_ERROR);
        if !fits {
            return None;
        }
        (edited.floors, edited.boosts, edited.sums) = (floors, boosts, sums);
        let tile = &mut edited.tile;
        tile.heights.samples_mut().copy_from_slice(heights);
        let stored = tile.densities.samples_mut();
        let (side, border) = (DENSITY_STORED as usize, DENSITY_BORDER as usize);
        for (row, texels) in densities.chunks_exact(TEXELS).enumerate() {
            stored[(row + border) * side + border..][..TEXELS].copy_from_slice(texels);
        }
        for (k, sums) in edited.sums.iter_mut().enumerate() {
            Arch::new().dispatch(Raise {
                k,
                part: SampleRect::new([0; 2], [TEXELS as i32; 2]),
                error: 0,
                sums,
                base: edited.base.errors.texels(),
                out: edited.tile.errors.texels_mut(),
            });
        }
        measure_rows(edited.tile.heights.samples(), 0..SQUARE, &mut edited.ranges);
        edited.range = whole_range(&edited.ranges);
        Some(edited)
    }
}

/// Adds to the sums of one spacing and writes the bytes that follow.
struct Raise<'a> {
    k: usize,
    part: SampleRect,
    error: u32,
    sums: &'a mut [u32; OWN],
    base: &'a [[u8; 8]],
    out: &'a mut [[u8; 8]],
}

impl NullaryFnOnce for Raise<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self {
            k,
            part,
            error,
            sums,
            base,
            out,
        } = self;
        let [columns, rows] = part.size();
        let first = part.min[0] as usize;
        let rows = part.min[1] as usize..part.min[1] as usize + rows;
        let mut bytes = [0; TEXELS];
        for z in rows {
            let row = z * TEXELS + first..z * TEXELS + first + columns;
            let sums = &mut sums[row.clone()];
            let base = &base[row.clone()];
            let bytes = &mut bytes[..columns];
            for ((byte, sum), base) in bytes.iter_mut().zip(sums).zip(base) {
                // Both are at most `MOST_ERROR`, which single precision holds.
                let raised = *sum + error;
                *sum = if raised < MOST_ERROR {
                    raised
                } else {
                    MOST_ERROR
                };
                *byte = total(base[k], *sum);
            }
            for (out, byte) in out[row].iter_mut().zip(bytes) {
                out[k] = *byte;
            }
        }
    }
}

/// The byte for a baked error bound and what edits add. A bound beyond the range of heights stays as it
/// was; no bake writes one.
#[inline(always)]
fn total(base: u8, sum: u32) -> u8 {
    const DECODED: [u32; 256] = {
        let mut all = [0; 256];
        let mut byte = 0;
        while byte < 256 {
            let error = decode_error(byte as u8);
            all[byte] = if error < MOST_ERROR {
                error
            } else {
                MOST_ERROR
            };
            byte += 1;
        }
        all
    };
    let total = DECODED[usize::from(base)] + sum;
    let total = if total < MOST_ERROR {
        total
    } else {
        MOST_ERROR
    };
    // Three bits of a number's fraction and its exponent, rounded up, are the byte but for a
    // constant: `encode_error` without a branch.
    const EIGHT: u32 = 8.0_f32.to_bits() >> 20;
    let least = if total > 8 { total } else { 8 };
    let rounded = ((least as i32 as f32).to_bits() + 0xf_ffff) >> 20;
    let byte = if total > 0 { rounded - EIGHT + 1 } else { 0 } as u8;
    if byte > base { byte } else { base }
}

/// Measures some of the rows of a tile's own square.
fn measure_rows(heights: &[u16], rows: std::ops::Range<usize>, out: &mut [TileRange; SQUARE]) {
    Arch::new().dispatch(|| {
        for row in rows {
            let first = (row + TILE_BORDER as usize) * SIDE + TILE_BORDER as usize;
            let (mut min, mut max) = (u16::MAX, u16::MIN);
            for &height in &heights[first..first + SQUARE] {
                min = if height < min { height } else { min };
                max = if height > max { height } else { max };
            }
            out[row] = TileRange { min, max };
        }
    });
}

fn whole_range(rows: &[TileRange; SQUARE]) -> TileRange {
    rows.iter().fold(rows[0], |all, row| TileRange {
        min: all.min.min(row.min),
        max: all.max.max(row.max),
    })
}

/// A number that tells a tile's ground from any other: XXH3 of 128 bits over its address, its 133 × 133
/// heights, its own 32 × 32 densities and its error bounds, little endian and in this order. Machines
/// that have applied the same edits to the same tile get the same. No protection against forgery.
/// Takes some microseconds.
#[must_use]
pub fn ground_hash(address: TileAddress, tile: &TerrainTile) -> u128 {
    let mut hasher = Xxh3::new();
    for number in [u32::from(address.level), address.x, address.z] {
        hasher.update(&number.to_le_bytes());
    }
    let mut bytes = [0; 2 * SIDE];
    for row in tile.heights.samples().chunks_exact(SIDE) {
        for (bytes, height) in bytes.chunks_exact_mut(2).zip(row) {
            bytes.copy_from_slice(&height.to_le_bytes());
        }
        hasher.update(&bytes);
    }
    hasher.update(&tile.densities.own_texels());
    hasher.update(tile.errors.texels().as_flattened());
    hasher.digest128()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tile::encode_error;

    #[test]
    fn sums_are_stored_as_the_least_byte_that_holds_them() {
        for base in 0..=255_u8 {
            for sum in (0..40).chain((0..300).map(|number| number * number * 47)) {
                let sum = sum.min(MOST_ERROR);
                let decoded = decode_error(base).saturating_add(sum).min(MOST_ERROR);
                assert_eq!(total(base, sum), encode_error(decoded).max(base));
            }
        }
    }
}
