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

/// The terrain will never be seen: its manifest or its root tile is missing or corrupt, or its
/// settings don't fit it. A log line says the same.
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
/// after this event.
#[derive(EntityEvent, Clone, Copy, Debug, PartialEq, Eq)]
pub struct TileEvicted {
    /// The terrain.
    pub entity: Entity,
    /// The tile's entity, still there.
    pub tile: Entity,
    /// Which tile.
    pub address: TileAddress,
}

/// A tile is missing or corrupt. It isn't asked for again; its parent's shape stands in for it.
/// A log line says the same.
#[derive(EntityEvent, Clone, Debug, PartialEq, Eq)]
pub struct TileFailed {
    /// The terrain.
    pub entity: Entity,
    /// Which tile.
    pub address: TileAddress,
    /// One sentence that names the file and the cause.
    pub reason: String,
}
