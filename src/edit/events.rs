//! What a game is told of edits.

use super::SampleRect;
use crate::stream::TerrainRegion;
use bevy::prelude::*;

/// An edit has been applied: the ground that is resident has changed, and queries answer with it.
/// It is drawn in this frame, or the next where this one has been extracted already.
#[derive(EntityEvent, Clone, Copy, Debug, PartialEq)]
pub struct TerrainEdited {
    /// The terrain.
    pub entity: Entity,
    /// The edit's number in the terrain's log.
    pub sequence: u64,
    /// Samples of level 0 that may have changed; may reach beyond the terrain.
    pub rect: SampleRect,
    /// The same in metres of the terrain's own x and z.
    pub region: TerrainRegion,
    /// Whether resident ground was cut off somewhere because it can't be lower or higher than the
    /// terrain's range of heights. `false` for edits that were merged together with undone ones, or
    /// many at once.
    pub clamped: bool,
}

/// An edit can't be made, and nothing has changed. A log line says the same.
#[derive(Event, Clone, Debug, PartialEq, Eq)]
pub struct TerrainEditRefused {
    /// The terrain, where one is known.
    pub terrain: Option<Entity>,
    /// One sentence that says what is wrong and what to do.
    pub reason: String,
}

/// An edit has been taken back: its ground is as if it had never been.
#[derive(EntityEvent, Clone, Copy, Debug, PartialEq)]
pub struct TerrainEditUndone {
    /// The terrain.
    pub entity: Entity,
    /// The edit's number in the log.
    pub sequence: u64,
    /// Samples of level 0 that may have changed.
    pub rect: SampleRect,
    /// The same in metres of the terrain's own x and z.
    pub region: TerrainRegion,
}

/// An edit that had been taken back is there again.
#[derive(EntityEvent, Clone, Copy, Debug, PartialEq)]
pub struct TerrainEditRedone {
    /// The terrain.
    pub entity: Entity,
    /// The edit's number in the log.
    pub sequence: u64,
    /// Samples of level 0 that may have changed.
    pub rect: SampleRect,
    /// The same in metres of the terrain's own x and z.
    pub region: TerrainRegion,
}
