//! What should be resident: tiles ranked by how much the views need them.

use crate::lattice::{Lattice, NodeBounds, ViewLod};
use crate::terrain::tile_bounds;
use crate::tile::{TileAddress, TileIndex};
use std::cmp::Reverse;
use std::collections::{BinaryHeap, HashSet};

/// A plan is made anew when an eye has moved further than a finest tile's side divided by two to
/// this power.
const REPLAN_LOG2: u32 = 3;

/// Ranks the tiles that a terrain's views want, best first, parents before their children.
///
/// A view wants every stored tile of a level that lies nearer than the level reaches. They are
/// found best first, by distance in sizes of the tile, so that where there are more than the
/// capacity holds, detail is cut off evenly: each level loses its farthest tiles. Cost: some
/// 200 ns a wanted tile and view, spent only when an eye has moved by an eighth of a tile.
#[derive(Debug, Default)]
pub struct Planner {
    wanted: Vec<TileAddress>,
    /// Distance in tile sizes, levels above the root, row, column; the least first.
    open: BinaryHeap<Reverse<(u64, u8, u32, u32)>>,
    planned: Vec<ViewLod>,
    current: bool,
    truncated: bool,
}

impl Planner {
    /// The tiles wanted by the latest plan, best first, parents before their children.
    #[must_use]
    pub fn wanted(&self) -> &[TileAddress] {
        &self.wanted
    }

    /// Whether the views wanted more tiles than the capacity holds.
    #[must_use]
    pub fn is_truncated(&self) -> bool {
        self.truncated
    }

    /// Makes the next [`update`](Self::update) plan anew wherever the views are: what is stored
    /// has changed.
    pub fn invalidate(&mut self) {
        self.current = false;
    }

    /// Plans anew where a view has changed enough to matter; says whether it did.
    pub fn update(
        &mut self,
        lattice: &Lattice,
        index: &TileIndex,
        missing: &HashSet<TileAddress>,
        views: &[ViewLod],
        capacity: usize,
    ) -> bool {
        let slack = lattice.node_size(0) >> REPLAN_LOG2;
        let still = |(old, new): (&ViewLod, &ViewLod)| {
            let moved = (new.eye - old.eye).abs().max_element();
            let moved = moved.max((new.floor - old.floor).abs());
            moved <= slack && old.planar == new.planar && old.reach == new.reach
        };
        if self.current
            && self.planned.len() == views.len()
            && self.planned.iter().zip(views).all(still)
        {
            return false;
        }
        self.planned.clear();
        self.planned.extend_from_slice(views);
        self.current = true;
        self.plan(lattice, index, missing, capacity);
        true
    }

    fn plan(
        &mut self,
        lattice: &Lattice,
        index: &TileIndex,
        missing: &HashSet<TileAddress>,
        capacity: usize,
    ) {
        self.wanted.clear();
        self.open.clear();
        let root_level = lattice.root_level.unsigned_abs() as u8;
        let root = TileAddress::new(root_level, 0, 0);
        let stored =
            |address: TileAddress| index.get(address).is_some() && !missing.contains(&address);
        if stored(root) {
            // The root is wanted even where there is no view.
            self.open.push(Reverse((0, 0, 0, 0)));
        }
        while self.wanted.len() < capacity
            && let Some(Reverse((_, depth, z, x))) = self.open.pop()
        {
            let address = TileAddress::new(root_level - depth, x, z);
            self.wanted.push(address);
            for child in address.children().into_iter().flatten() {
                if stored(child)
                    && let Some(bounds) = tile_bounds(lattice, child)
                    && let Some(key) = wish(lattice, &self.planned, child.level, bounds)
                {
                    self.open.push(Reverse((key, depth + 1, child.z, child.x)));
                }
            }
        }
        self.truncated = !self.open.is_empty();
    }
}

/// How much the views want a tile: its distance in sizes of itself, scaled by a common factor,
/// the least first; `None` where none wants it.
fn wish(lattice: &Lattice, views: &[ViewLod], level: u8, bounds: NodeBounds) -> Option<u64> {
    let level = i32::from(level);
    let NodeBounds { low, high } = bounds;
    let shift = lattice.node_log2(lattice.root_level) - lattice.node_log2(level);
    views
        .iter()
        .filter(|view| view.box_distance(low, high) < view.reach[lattice.level_index(level)])
        .map(|view| {
            // A view that has one level of detail everywhere still needs what is near it first.
            let outside = (low - view.eye).max(view.eye - high);
            let distance = outside.max_element().max(view.floor);
            u64::from(distance.max(0).unsigned_abs()) << shift
        })
        .min()
}
