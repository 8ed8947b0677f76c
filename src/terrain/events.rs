//! What a terrain tells the game: observe these on the terrain's entity, or everywhere.

use crate::tile::TileAddress;
use bevy::prelude::*;

/// The terrain can be seen and stood on: its manifest and its root tile are there. Finer tiles
/// follow.
#[derive(EntityEvent, Clone, Copy, Debug, PartialEq, Eq)]
pub struct TerrainReady {
    /// The terrain.
    pub entity: Entity,
}

/// The terrain can't be seen: its manifest or its root tile is missing or corrupt, or its settings
/// don't fit it. A log line says the same. Files are asked for again from time to time, and
/// [`TerrainReady`] follows where that helps.
#[derive(EntityEvent, Clone, Debug, PartialEq, Eq)]
pub struct TerrainFailed {
    /// The terrain.
    pub entity: Entity,
    /// One sentence that names the file and the cause.
    pub reason: String,
}

/// A tile has become resident. Its entity is there when the event is seen.
#[derive(EntityEvent, Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileLoaded {
    /// The terrain.
    pub entity: Entity,
    /// The tile's entity.
    pub tile: Entity,
    /// Which tile.
    pub address: TileAddress,
}

/// A tile stops being resident: nothing reads it any more, and its entity is despawned right
/// after this event. Not told of each tile where a whole terrain goes.
#[derive(EntityEvent, Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileEvicted {
    /// The terrain.
    pub entity: Entity,
    /// The tile's entity, still there.
    pub tile: Entity,
    /// Which tile.
    pub address: TileAddress,
}

/// What a resident tile holds has been replaced: its file has changed, and was read again.
#[derive(EntityEvent, Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileReloaded {
    /// The terrain.
    pub entity: Entity,
    /// The tile's entity.
    pub tile: Entity,
    /// Which tile.
    pub address: TileAddress,
}

/// A terrain's manifest, or its root tile, has changed while the terrain was drawn, and the new one
/// can't be used; the terrain stays as it was. A log line says the same.
#[derive(EntityEvent, Clone, Debug, PartialEq, Eq)]
pub struct TerrainReloadFailed {
    /// The terrain.
    pub entity: Entity,
    /// One sentence that names the file and the cause.
    pub reason: String,
}

/// Everything of a [`TerrainPin`]'s region that can be had is resident. Observe it on the pin.
///
/// [`TerrainPin`]: crate::stream::TerrainPin
#[derive(EntityEvent, Clone, Copy, Debug, PartialEq, Eq)]
pub struct TerrainPinReady {
    /// The pin.
    pub entity: Entity,
}

/// A tile is missing or corrupt, or comes from another terrain; its parent's shape stands in for it
/// (its former own, where it was resident). A log line says the same. It is asked for again from
/// time to time, which is told once for each reason.
#[derive(EntityEvent, Clone, Debug, PartialEq, Eq)]
pub struct TileFailed {
    /// The terrain.
    pub entity: Entity,
    /// Which tile.
    pub address: TileAddress,
    /// One sentence that names the file and the cause.
    pub reason: String,
}
