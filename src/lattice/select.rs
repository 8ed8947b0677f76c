//! Which nodes a view draws.

use super::{Lattice, ViewLod};
use glam::IVec2;

/// A square of the geometry quadtree, drawn at its own level.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Node {
    /// Level of the node; negative ones are finer than the finest tile.
    pub level: i32,
    /// First lattice point in x and z.
    pub origin: IVec2,
}

/// The part of a node that lies on the terrain, in lattice units.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NodeBounds {
    /// Its first lattice point, the least in x and z.
    pub low: IVec2,
    /// Its last lattice point, the greatest in x and z.
    pub high: IVec2,
}

impl Node {
    /// The part of the node that lies on the terrain, or `None` where that has no area.
    #[must_use]
    pub fn bounds(&self, lattice: &Lattice) -> Option<NodeBounds> {
        let low = self.origin;
        let high = (low + lattice.node_size(self.level)).min(lattice.extent);
        low.cmplt(high).all().then_some(NodeBounds { low, high })
    }
}

impl ViewLod {
    /// Calls `visit` for every node that this view draws, coarse quadrants before fine ones.
    ///
    /// CDLOD's selection (Strugar 2009): a node is split while it reaches into the range of the next finer level.
    /// `keep` may drop a node, and all below it, that no view sees; it is given the level and the
    /// part of the node that lies on the terrain. Cost: a few nanoseconds a node.
    pub fn select(
        &self,
        lattice: &Lattice,
        keep: &mut impl FnMut(&Node, &NodeBounds) -> bool,
        visit: &mut impl FnMut(Node),
    ) {
        let root = Node {
            level: lattice.root_level,
            origin: IVec2::ZERO,
        };
        self.select_below(lattice, root, keep, visit);
    }

    fn select_below(
        &self,
        lattice: &Lattice,
        node: Node,
        keep: &mut impl FnMut(&Node, &NodeBounds) -> bool,
        visit: &mut impl FnMut(Node),
    ) {
        let Some(bounds) = node.bounds(lattice) else {
            return;
        };
        if !keep(&node, &bounds) {
            return;
        }
        let splits = node.level > lattice.leaf_level
            && self.box_distance(bounds.low, bounds.high)
                < self.reach[lattice.level_index(node.level - 1)];
        if !splits {
            visit(node);
            return;
        }
        let half = lattice.node_size(node.level - 1);
        for quadrant in [IVec2::ZERO, IVec2::X, IVec2::Y, IVec2::ONE] {
            let child = Node {
                level: node.level - 1,
                origin: node.origin + quadrant * half,
            };
            self.select_below(lattice, child, keep, visit);
        }
    }
}
