//! From displacements to a tile's heights.

use super::profile::captured;
use super::raster::GroundLevel;
use super::{Change, Edit, SampleRect};
use crate::tile::{TILE_BORDER, TILE_STORED, TileAddress};
use pulp::{Arch, NullaryFnOnce};

const SIDE: usize = TILE_STORED as usize;
const BORDER: i32 = TILE_BORDER as i32;

/// Values of an edit: those of the samples in `rect` of a level, `stride` apart, the first one first.
#[derive(Clone, Copy)]
pub(super) struct Values<'a> {
    pub(super) rect: SampleRect,
    pub(super) values: &'a [i32],
    pub(super) stride: usize,
}

/// What has become of a tile's heights.
pub(super) struct HeightChange {
    /// The tile's samples that may have changed, counted from its first own.
    pub(super) rect: SampleRect,
    pub(super) clamped: bool,
}

/// Changes the stored heights of a tile as an edit says, whose values hold all of the tile's samples
/// that lie on the terrain and may change, and no others.
pub(super) fn change_heights(
    level: &GroundLevel,
    address: TileAddress,
    edit: &Edit,
    values: &Values<'_>,
    heights: &mut [u16],
) -> HeightChange {
    let (x, z) = address.first_sample();
    // The level's sample that is stored first.
    let first = [x as i32 - BORDER, z as i32 - BORDER];
    let [columns, rows] = values.rect.size();
    let at = [0, 1].map(|axis| (values.rect.min[axis] - first[axis]) as usize);
    let clamped = Arch::new().dispatch(Add {
        edit,
        level: address.level,
        values,
        columns,
        rows,
        heights: &mut heights[at[1] * SIDE + at[0]..],
    });
    // What lies beyond the terrain repeats its edge.
    let end = [0, 1].map(|axis| at[axis] + values.rect.size()[axis]);
    let stored = |axis: usize| {
        let on_terrain = (-first[axis]).max(0) as usize;
        let past = (level.samples[axis] as i32 - first[axis]).min(SIDE as i32) as usize;
        (on_terrain, past)
    };
    let mut from = at;
    let mut to = end;
    for axis in [0, 1] {
        let (start, past) = stored(axis);
        if at[axis] == start {
            from[axis] = 0;
        }
        if end[axis] == past {
            to[axis] = SIDE;
        }
    }
    for row in heights.chunks_exact_mut(SIDE).take(end[1]).skip(at[1]) {
        let (left, right) = (row[at[0]], row[end[0] - 1]);
        row[from[0]..at[0]].fill(left);
        row[end[0]..to[0]].fill(right);
    }
    for (target, source) in (from[1]..at[1])
        .map(|row| (row, at[1]))
        .chain((end[1]..to[1]).map(|row| (row, end[1] - 1)))
    {
        let source = source * SIDE;
        heights.copy_within(source + from[0]..source + to[0], target * SIDE + from[0]);
    }
    HeightChange {
        rect: SampleRect {
            min: from.map(|at| at as i32 - BORDER),
            max: to.map(|at| at as i32 - BORDER),
        },
        clamped,
    }
}

struct Add<'a, 'b> {
    edit: &'a Edit,
    level: u8,
    values: &'a Values<'b>,
    columns: usize,
    rows: usize,
    heights: &'a mut [u16],
}

impl NullaryFnOnce for Add<'_, '_> {
    type Output = bool;

    #[inline(always)]
    fn call(self) -> bool {
        let Self {
            edit,
            level,
            values,
            columns,
            rows,
            heights,
        } = self;
        let Values {
            rect,
            values,
            stride,
        } = *values;
        let mut cut = 0;
        let pairs = heights.chunks_mut(SIDE).zip(values.chunks(stride));
        for ((heights, values), z) in pairs.take(rows).zip(rect.min[1]..) {
            let pairs = heights[..columns].iter_mut().zip(&values[..columns]);
            match &edit.change {
                Change::Crater { .. } | Change::Raise { .. } | Change::Stamp { .. } => {
                    for (height, &by) in pairs {
                        *height = moved(*height, by, &mut cut);
                    }
                }
                &Change::Flatten {
                    to, least, most, ..
                } => {
                    for (height, &weight) in pairs {
                        let by = drawn(*height, to.into(), weight, least, most);
                        *height = moved(*height, by, &mut cut);
                    }
                }
                Change::Smooth {
                    ground,
                    least,
                    most,
                    ..
                } => {
                    for ((height, &weight), x) in pairs.zip(rect.min[0]..) {
                        let place = [x, z].map(|at| i64::from(at) << level);
                        let by = drawn(*height, captured(ground, place), weight, *least, *most);
                        *height = moved(*height, by, &mut cut);
                    }
                }
            }
        }
        cut != 0
    }
}

/// The height, moved; the sum's part beyond the range of heights is kept in `cut`.
#[inline(always)]
fn moved(height: u16, by: i32, cut: &mut i32) -> u16 {
    let sum = i32::from(height) + by;
    let low = if sum > 0 { sum } else { 0 };
    let most = i32::from(u16::MAX);
    let clamped = if low < most { low } else { most };
    *cut |= sum ^ clamped;
    clamped as u16
}

/// By how much a height is drawn to another with a weight of 65535, to the nearest step, halves up.
#[inline(always)]
fn drawn(height: u16, to: i32, weight: i32, least: i32, most: i32) -> i32 {
    // So that the largest weight is 1.
    let weight = i64::from(weight + (weight >> 15));
    let by = (weight * i64::from(to - i32::from(height)) + (1 << 15)) >> 16;
    let by = by as i32;
    let by = if by > least { by } else { least };
    if by < most { by } else { most }
}
