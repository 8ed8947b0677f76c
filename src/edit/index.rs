//! Which edits may touch a place.

use super::SampleRect;
use crate::tile::{ERROR_SPACINGS, TILE_BORDER, TILE_SAMPLES, TileAddress};
use std::collections::HashMap;

/// Cells of the finest grid are 2^6 samples of level 0 a side; each grid has cells twice as large
/// as the one before.
const FINEST_LOG2: u32 = 6;
/// The coarsest grid's cells of 2^11 samples hold the largest edit.
const GRIDS: usize = 6;

/// Samples of its own level beyond a tile's square in which an edit can change what is stored of the
/// tile. Error bounds reach furthest: triangles that meet the tile have edges of up to 64 samples, and
/// the surface under them ends with the cells of their corners.
const TOUCH_MARGIN: u32 = (1 << (ERROR_SPACINGS - 1)) + 2 + TILE_BORDER;

/// The samples of level 0 on which an edit must lie, by its [`rect`](super::Edit::rect), to be able
/// to change anything that is stored of a tile: its heights with their borders, its densities, or
/// its error bounds, which edits 66 of the level's samples away can raise. With the tile's border, it
/// reaches 68 of the level's samples, `68 << level` of level 0, beyond its square to every side.
///
/// What loads a tile asks the log for the edits in this rectangle, and what a change of the log
/// leaves stale is found by it too.
#[must_use]
pub fn touch_rect(address: TileAddress) -> SampleRect {
    let samples = |at: i64| {
        let at = at << u32::from(address.level).min(32);
        at.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
    };
    let (own, margin) = (i64::from(TILE_SAMPLES), i64::from(TOUCH_MARGIN));
    let first = [address.x, address.z].map(|tile| i64::from(tile) * own);
    SampleRect {
        min: first.map(|first| samples(first - margin)),
        max: first.map(|first| samples(first + own + margin).saturating_add(1)),
    }
}

/// An edit in a cell.
#[derive(Clone, Copy, Debug)]
struct Entry {
    sequence: u64,
    rect: SampleRect,
}

/// Active edits by place: hashed grids of several cell sizes. Each edit lies in one cell of the
/// finest grid whose cells are no smaller than its rectangle: the one with its least corner. So it
/// reaches into the next cell at most.
///
/// Takes 24 bytes an edit, and as much again at worst while a cell grows; a cell that holds any takes
/// some 40 bytes more.
#[derive(Clone, Debug, Default)]
pub(super) struct AreaIndex {
    /// Cells by column and row, each with its edits in order.
    grids: [HashMap<[i32; 2], Vec<Entry>>; GRIDS],
}

impl AreaIndex {
    /// The grid and the cell in which an edit with the rectangle belongs.
    fn place(rect: &SampleRect) -> (usize, [i32; 2]) {
        let [columns, rows] = rect.size();
        let side = columns.max(rows).max(1) as u64;
        let log2 = u64::BITS - (side - 1).leading_zeros();
        let grid = (log2.saturating_sub(FINEST_LOG2) as usize).min(GRIDS - 1);
        (grid, rect.min.map(|at| at >> (FINEST_LOG2 as usize + grid)))
    }

    pub(super) fn insert(&mut self, sequence: u64, rect: SampleRect) {
        let (grid, cell) = Self::place(&rect);
        let entries = self.grids[grid].entry(cell).or_default();
        // Nearly always at the end; an edit that was redone goes where it was.
        let at = entries.partition_point(|entry| entry.sequence < sequence);
        entries.insert(at, Entry { sequence, rect });
    }

    pub(super) fn remove(&mut self, sequence: u64, rect: SampleRect) {
        let (grid, cell) = Self::place(&rect);
        let Some(entries) = self.grids[grid].get_mut(&cell) else {
            return;
        };
        if let Ok(at) = entries.binary_search_by_key(&sequence, |entry| entry.sequence) {
            entries.remove(at);
        }
        if entries.is_empty() {
            self.grids[grid].remove(&cell);
        }
    }

    /// Sequence numbers above `after` of edits whose rectangles meet `rect`, in order.
    pub(super) fn meeting(&self, rect: &SampleRect, after: u64) -> Vec<u64> {
        let mut found = Vec::new();
        if rect.is_empty() {
            return found;
        }
        let mut look = |entries: &[Entry]| {
            let first = entries.partition_point(|entry| entry.sequence <= after);
            let meets = |entry: &&Entry| !entry.rect.intersection(rect).is_empty();
            let meeting = entries[first..].iter().filter(meets);
            found.extend(meeting.map(|entry| entry.sequence));
        };
        for (grid, cells) in self.grids.iter().enumerate() {
            let log2 = FINEST_LOG2 as usize + grid;
            let first = rect.min.map(|at| (at >> log2).saturating_sub(1));
            let last = rect.max.map(|at| (at - 1) >> log2);
            let count: u64 = [0, 1]
                .map(|axis| (i64::from(last[axis]) - i64::from(first[axis]) + 1) as u64)
                .iter()
                .product();
            if count >= cells.len() as u64 {
                for entries in cells.values() {
                    look(entries);
                }
                continue;
            }
            for z in first[1]..=last[1] {
                for x in first[0]..=last[0] {
                    if let Some(entries) = cells.get(&[x, z]) {
                        look(entries);
                    }
                }
            }
        }
        found.sort_unstable();
        found
    }
}
