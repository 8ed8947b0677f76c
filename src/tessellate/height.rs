//! The one height function: tiles blended over two levels.

use crate::lattice::{Lattice, ONE};
use crate::tile::{TILE_SAMPLES, TerrainTile, TileAddress};
use glam::IVec2;
use std::collections::HashMap;
use std::sync::Arc;

/// Where stored heights and densities come from: the twin of the GPU's pages.
pub trait PageSource {
    /// The stored height of a tile at a sample counted from its first own one, `-2..=130`; `None`
    /// where the tile isn't there.
    fn height(&self, tile: TileAddress, x: i32, z: i32) -> Option<u16>;

    /// The stored error bounds of a tile at a texel counted from its first own one, `0..32`; `None`
    /// where the tile isn't there.
    fn errors(&self, tile: TileAddress, x: i32, z: i32) -> Option<[u8; 8]>;

    /// The stored density of a tile at a texel counted from its first own one, `0..32`; `None`
    /// where the tile isn't there.
    fn density(&self, tile: TileAddress, x: i32, z: i32) -> Option<u8>;
}

/// Tiles by address, as a view reads them.
#[derive(Clone, Debug, Default)]
pub struct Pages {
    /// The tiles that are there.
    pub tiles: HashMap<TileAddress, Arc<TerrainTile>>,
}

impl PageSource for Pages {
    fn height(&self, tile: TileAddress, x: i32, z: i32) -> Option<u16> {
        self.tiles.get(&tile).map(|tile| tile.heights.get(x, z))
    }

    fn errors(&self, tile: TileAddress, x: i32, z: i32) -> Option<[u8; 8]> {
        let tile = self.tiles.get(&tile)?;
        Some(tile.errors.get(x.cast_unsigned(), z.cast_unsigned()))
    }

    fn density(&self, tile: TileAddress, x: i32, z: i32) -> Option<u8> {
        self.tiles.get(&tile).map(|tile| tile.densities.get(x, z))
    }
}

/// The tile of `level` that holds lattice point `p`, given the tiles a side; the terrain's last
/// point belongs to the last tile.
#[must_use]
pub fn tile_at(lattice: &Lattice, p: IVec2, level: u32) -> TileAddress {
    let log2 = lattice.node_log2(level.cast_signed());
    let last = (lattice.extent - 1).max(IVec2::ZERO) >> IVec2::splat(log2.cast_signed());
    let tile = (p >> IVec2::splat(log2.cast_signed())).clamp(IVec2::ZERO, last);
    #[expect(clippy::cast_possible_truncation, reason = "levels are below 24")]
    TileAddress::new(level as u8, tile.x.cast_unsigned(), tile.y.cast_unsigned())
}

/// Stored height at `p` read from one level, bilinear between samples.
pub fn level_height(
    source: &impl PageSource,
    lattice: &Lattice,
    p: IVec2,
    level: u32,
) -> Option<f32> {
    let tile = tile_at(lattice, p, level);
    let shift = lattice.unit_log2 + level;
    let sample = p >> IVec2::splat(shift.cast_signed());
    let rest = p - (sample << IVec2::splat(shift.cast_signed()));
    let weight = rest.as_vec2() / (1_u32 << shift) as f32;
    let first = IVec2::new(
        (tile.x * TILE_SAMPLES).cast_signed(),
        (tile.z * TILE_SAMPLES).cast_signed(),
    );
    let local = sample - first;
    let at = |dx: i32, dz: i32| {
        source
            .height(tile, local.x + dx, local.y + dz)
            .map(f32::from)
    };
    let (h00, h10, h01, h11) = (at(0, 0)?, at(1, 0)?, at(0, 1)?, at(1, 1)?);
    let near = h00 + (h10 - h00) * weight.x;
    let far = h01 + (h11 - h01) * weight.x;
    Some(near + (far - near) * weight.y)
}

/// Stored height at `p` read at level of detail `lambda` (16.16): level `⌊λ⌋` blended with the
/// next. `None` where a tile isn't there; `λ` from
/// [`ViewLod::lambda`](crate::lattice::ViewLod::lambda) never asks for such a one.
pub fn height(source: &impl PageSource, lattice: &Lattice, p: IVec2, lambda: i32) -> Option<f32> {
    let level = (lambda >> 16).cast_unsigned();
    let blend = (lambda & (ONE - 1)) as f32 / ONE as f32;
    let fine = level_height(source, lattice, p, level)?;
    if blend == 0.0 {
        return Some(fine);
    }
    let coarse = level_height(source, lattice, p, level + 1)?;
    Some(fine + (coarse - fine) * blend)
}
