//! What a resident tile holds: as it was baked, or with edits.

use crate::edit::{EditGround, EditRaster, EditScratch, EditedTile, TileChange};
use crate::tile::{TerrainTile, TileAddress};

/// What a resident tile holds.
#[derive(Clone, Debug)]
pub(super) enum TileContent {
    /// As it was baked: the asset's content, shared with it until either changes.
    Baked(TerrainTile),
    /// With edits.
    Edited {
        tile: Box<EditedTile>,
        /// How many since its last snapshot.
        since_snapshot: u32,
    },
}

impl TileContent {
    /// What is drawn and asked.
    pub(super) fn tile(&self) -> &TerrainTile {
        match self {
            Self::Baked(tile) => tile,
            Self::Edited { tile, .. } => tile.tile(),
        }
    }

    /// As it was baked.
    pub(super) fn base(&self) -> &TerrainTile {
        match self {
            Self::Baked(tile) => tile,
            Self::Edited { tile, .. } => tile.base(),
        }
    }
}

impl TileContent {
    /// Applies an edit.
    pub(super) fn apply(
        &mut self,
        address: TileAddress,
        ground: &EditGround,
        raster: &EditRaster,
        scratch: &mut EditScratch,
    ) -> TileChange {
        if let Self::Baked(base) = self {
            *self = Self::Edited {
                tile: Box::new(EditedTile::new(address, base.clone())),
                since_snapshot: 0,
            };
        }
        match self {
            Self::Edited { tile, .. } => tile.apply(ground, raster, scratch),
            Self::Baked(_) => unreachable!("it was made an edited one above"),
        }
    }
}
