//! How far the eye is from the nearest ground.

use super::TerrainManifest;
use crate::lattice::{Lattice, NodeBounds};
use crate::tile::{TileAddress, TileRange};
use glam::IVec2;

/// Distances beyond this are not told apart; the lattice's extent is smaller.
const DISTANCE_MAX: f64 = (1_u32 << 30) as f64;

/// Asks a terrain's bounds for distances, in lattice units.
///
/// The ground is the boxes of the finest stored tiles (of their ancestors, where finer ones are
/// not stored), and the distance is Chebyshev's: the greatest of those along x, height and z.
/// As a distance to a fixed set it changes no faster than the eye moves, over cliffs and beside
/// walls too.
#[derive(Clone, Copy, Debug)]
pub struct GroundQuery<'a> {
    /// The terrain's lattice, in whose units distances are.
    pub lattice: &'a Lattice,
    /// The terrain's manifest and index.
    pub manifest: &'a TerrainManifest,
}

impl GroundQuery<'_> {
    /// Metres in lattice units, rounded down, 0 to 2³⁰.
    #[must_use]
    pub fn units(&self, metres: f64) -> i32 {
        let units = metres / self.lattice.unit_m(self.manifest.file.spacing_m);
        #[expect(clippy::cast_possible_truncation, reason = "clamped to 30 bits")]
        let units = units.clamp(0.0, DISTANCE_MAX) as i32;
        units
    }

    /// The distance from lattice point `eye`, `height_m` metres above the terrain's origin, to
    /// the nearest ground; 0 inside a box. Cost: a microsecond or two, whatever the terrain's
    /// size.
    #[must_use]
    pub fn distance(&self, eye: IVec2, height_m: f64) -> i32 {
        let root = TileAddress::new(self.lattice.root_level.unsigned_abs() as u8, 0, 0);
        let Some((range, bounds)) = self.stored(root) else {
            return 0;
        };
        let mut best = i32::MAX;
        self.search(eye, height_m, root, range, bounds, &mut best);
        if best == i32::MAX { 0 } else { best }
    }

    fn stored(&self, address: TileAddress) -> Option<(TileRange, NodeBounds)> {
        let range = self.manifest.index.get(address)?;
        Some((range, tile_bounds(self.lattice, address)?))
    }

    /// Lowers `best` to the distance of the nearest ground at or below a stored tile.
    fn search(
        &self,
        eye: IVec2,
        height_m: f64,
        address: TileAddress,
        range: TileRange,
        bounds: NodeBounds,
        best: &mut i32,
    ) {
        let Some(children) = address.children() else {
            *best = (*best).min(self.box_distance(eye, height_m, range, bounds));
            return;
        };
        // A child that isn't stored is drawn from this tile, so its square has this one's range.
        let mut open = children.map(|child| {
            let bounds = tile_bounds(self.lattice, child)?;
            let stored = self.manifest.index.get(child);
            let distance = self.box_distance(eye, height_m, stored.unwrap_or(range), bounds);
            Some((distance, child, stored, bounds))
        });
        open.sort_by_key(|child| child.map_or(i32::MAX, |(distance, ..)| distance));
        for (distance, child, stored, bounds) in open.into_iter().flatten() {
            if distance >= *best {
                return;
            }
            match stored {
                Some(range) => self.search(eye, height_m, child, range, bounds, best),
                None => *best = distance,
            }
        }
    }

    /// The distance to a box, rounded down.
    fn box_distance(&self, eye: IVec2, height_m: f64, range: TileRange, bounds: NodeBounds) -> i32 {
        let outside = (bounds.low - eye).max(eye - bounds.high).max_element();
        let file = &self.manifest.file;
        let (bottom, top) = (file.height_m(range.min), file.height_m(range.max));
        outside.max(self.units((bottom - height_m).max(height_m - top)))
    }
}

/// The part of a tile's square that lies on the terrain.
pub(crate) fn tile_bounds(lattice: &Lattice, address: TileAddress) -> Option<NodeBounds> {
    let size = i64::from(lattice.node_size(i32::from(address.level)));
    let low = [address.x, address.z].map(|at| i64::from(at) * size);
    let extent = [lattice.extent.x, lattice.extent.y].map(i64::from);
    if low[0] >= extent[0] || low[1] >= extent[1] {
        return None;
    }
    // Below the extent, so within 31 bits.
    let low = IVec2::new(low[0] as i32, low[1] as i32);
    let room = lattice.extent - low;
    let high = low + room.min(IVec2::splat(size as i32));
    Some(NodeBounds { low, high })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::terrain::ManifestFile;
    use crate::tile::TileIndex;
    use proptest::prelude::*;

    /// The range that a level-0 square is drawn with: its finest stored tile's.
    fn range_at(manifest: &TerrainManifest, leaf: TileAddress) -> TileRange {
        let mut range = None;
        for level in (0..manifest.file.levels).rev() {
            match leaf
                .ancestor(level)
                .and_then(|tile| manifest.index.get(tile))
            {
                Some(stored) => range = Some(stored),
                None => break,
            }
        }
        range.expect("the root is stored")
    }

    fn brute_force(query: &GroundQuery, eye: IVec2, height_m: f64) -> i32 {
        let [columns, rows] = query.manifest.file.tiles(0);
        (0..rows)
            .flat_map(|z| (0..columns).map(move |x| TileAddress::new(0, x, z)))
            .map(|leaf| {
                let bounds = tile_bounds(query.lattice, leaf).expect("on the terrain");
                query.box_distance(eye, height_m, range_at(query.manifest, leaf), bounds)
            })
            .min()
            .expect("there are tiles")
    }

    /// A terrain whose leaves have random ranges, some of whose tiles are not stored.
    fn terrain(size: [u32; 2], seed: &[(u16, u16, u8)]) -> TerrainManifest {
        let file = crate::terrain::test_manifest_file(size);
        let mut index = TileIndex::new(&file);
        let mut draws = seed.iter().cycle();
        for level in 0..file.levels {
            let [columns, rows] = file.tiles(level);
            for z in 0..rows {
                for x in 0..columns {
                    let address = TileAddress::new(level, x, z);
                    let &(low, high, luck) = draws.next().expect("the seed is not empty");
                    let own = TileRange {
                        min: low.min(high),
                        max: low.max(high),
                    };
                    let children = address.children().into_iter().flatten();
                    let range = children
                        .filter_map(|child| index.get(child))
                        .fold(own, TileRange::union);
                    let is_root = level + 1 == file.levels;
                    index.set(address, (is_root || luck > 40).then_some(range));
                }
            }
        }
        TerrainManifest { file, index }
    }

    proptest! {
        #[test]
        fn the_pruned_search_finds_what_brute_force_finds(
            size in (2u32..2000, 2u32..2000),
            seed in prop::collection::vec((any::<u16>(), any::<u16>(), any::<u8>()), 1..60),
            eyes in prop::collection::vec((-3000.0..5000.0, -3000.0..5000.0, -500.0..4000.0), 1..20),
        ) {
            let manifest = terrain([size.0, size.1], &seed);
            let ManifestFile { levels, spacing_m, .. } = manifest.file;
            let lattice = Lattice::new(manifest.file.size, levels, 0, 8).expect("fits");
            let query = GroundQuery { lattice: &lattice, manifest: &manifest };
            for (x, z, height_m) in eyes {
                let (eye, _) = lattice.lattice_from_local(glam::DVec2::new(x, z), spacing_m);
                prop_assert_eq!(query.distance(eye, height_m), brute_force(&query, eye, height_m));
            }
        }

        #[test]
        fn the_distance_changes_no_faster_than_the_eye_moves(
            seed in prop::collection::vec((any::<u16>(), any::<u16>(), any::<u8>()), 1..60),
            from in (-500.0..1500.0_f64, -500.0..1500.0_f64, -100.0..900.0_f64),
            step in (-20.0..20.0_f64, -20.0..20.0_f64, -20.0..20.0_f64),
        ) {
            let manifest = terrain([1000, 700], &seed);
            let lattice = Lattice::new(manifest.file.size, manifest.file.levels, 0, 8).expect("fits");
            let query = GroundQuery { lattice: &lattice, manifest: &manifest };
            let at = |x: f64, y: f64, z: f64| {
                let (eye, _) = lattice.lattice_from_local(glam::DVec2::new(x, z), manifest.file.spacing_m);
                query.distance(eye, y)
            };
            let a = at(from.0, from.2, from.1);
            let b = at(from.0 + step.0, from.2 + step.2, from.1 + step.1);
            let moved = step.0.abs().max(step.1.abs()).max(step.2.abs());
            // Two roundings.
            prop_assert!((a - b).abs() <= query.units(moved) + 2, "{a} {b} {moved}");
        }
    }
}
