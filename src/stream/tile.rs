//! Tile entities: what a game can query about the tiles that are resident.

use crate::terrain::ManifestFile;
use crate::tile::{TILE_SAMPLES, TerrainTile, TileAddress, TileRange};
use bevy::prelude::*;

/// The terrain that a tile belongs to.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq, Reflect)]
#[reflect(Component, Debug, Clone, PartialEq)]
#[relationship(relationship_target = TerrainTiles)]
pub struct TileOf(#[entities] pub Entity);

/// The tiles of a terrain that are resident, in no order. They are despawned with the terrain.
#[derive(Component, Clone, Debug, Default, PartialEq, Eq, Reflect)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
#[relationship_target(relationship = TileOf, linked_spawn)]
pub struct TerrainTiles(Vec<Entity>);

/// What is stored of a resident tile: its heights and densities, loaded.
#[derive(Component, Clone, Debug, PartialEq, Eq, Deref, Reflect)]
#[reflect(Component, Debug, Clone, PartialEq)]
pub struct TileData(pub Handle<TerrainTile>);

/// The box that holds a tile's ground, in metres in the terrain's own space.
#[derive(Component, Clone, Copy, Debug, PartialEq, Reflect)]
#[reflect(Component, Debug, Clone, PartialEq)]
pub struct TileBounds {
    /// Corner with the least x, height and z.
    pub min_m: Vec3,
    /// Corner with the greatest x, height and z.
    pub max_m: Vec3,
}

impl TileBounds {
    /// The bounds of the tile `address` whose heights lie in `range`.
    #[must_use]
    pub fn new(manifest: &ManifestFile, address: TileAddress, range: TileRange) -> Self {
        let along = |tile: u32, samples: u32| {
            let first = u64::from(tile) * (u64::from(TILE_SAMPLES) << address.level);
            let last = first + (u64::from(TILE_SAMPLES) << address.level);
            [first, last]
                .map(|sample| sample.min(u64::from(samples) - 1) as f64 * manifest.spacing_m)
        };
        let x = along(address.x, manifest.size[0]);
        let z = along(address.z, manifest.size[1]);
        let y = [range.min, range.max].map(|height| manifest.height_m(height));
        let corner = |end: usize| bevy::math::DVec3::new(x[end], y[end], z[end]).as_vec3();
        Self {
            min_m: corner(0),
            max_m: corner(1),
        }
    }
}

/// Number of the page that holds a resident tile, below the terrain's capacity. It stays the
/// tile's own until the tile's entity is despawned, and may be another's in the same frame.
#[derive(Component, Clone, Copy, Debug, PartialEq, Eq, Hash, Reflect)]
#[reflect(Component, Debug, Clone, PartialEq, Hash)]
#[component(immutable)]
pub struct TilePage(pub u32);
