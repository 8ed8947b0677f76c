//! A terrain's log of edits.

use super::{EditDiff, EditLog};
use bevy::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};

/// The edits of a terrain; on every one, empty at first.
///
/// Triggers add to it: [`Crater`](super::Crater) and its like, [`UndoEdit`], [`RedoEdit`],
/// [`MergeEdits`]. A log that was [loaded](EditLog::load) takes its place when this component is
/// inserted anew. Whatever way it changes, the ground that is resident follows in the same frame, and
/// what streams in later has the edits that are in it.
#[derive(Component, Debug)]
pub struct TerrainEdits {
    /// `None` until the terrain's manifest is there, which the log is bound to.
    log: Option<EditLog>,
    /// Tells this log, which only ever grows, from one that takes its place.
    instance: u64,
}

fn new_instance() -> u64 {
    static INSTANCE: AtomicU64 = AtomicU64::new(1);
    INSTANCE.fetch_add(1, Ordering::Relaxed)
}

impl Default for TerrainEdits {
    fn default() -> Self {
        Self {
            log: None,
            instance: new_instance(),
        }
    }
}

impl Clone for TerrainEdits {
    fn clone(&self) -> Self {
        // Both may grow in different ways from now on.
        Self {
            log: self.log.clone(),
            instance: new_instance(),
        }
    }
}

impl TerrainEdits {
    /// Edits that have been loaded, or received.
    #[must_use]
    pub fn new(log: EditLog) -> Self {
        Self {
            log: Some(log),
            instance: new_instance(),
        }
    }

    /// The log; `None` until the terrain's manifest has loaded.
    #[must_use]
    pub const fn log(&self) -> Option<&EditLog> {
        self.log.as_ref()
    }

    /// The log, for those who see to it that the ground follows.
    pub(crate) const fn log_mut(&mut self) -> Option<&mut EditLog> {
        self.log.as_mut()
    }

    /// Replaces the log.
    pub(crate) fn set_log(&mut self, log: EditLog) {
        *self = Self::new(log);
    }

    /// A number that no other log has had since the program started.
    pub(crate) const fn instance(&self) -> u64 {
        self.instance
    }
}

/// Takes an edit back: the newest that hasn't been, or the one that is named.
#[derive(Event, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UndoEdit {
    /// The terrain; `None` where there is only one.
    pub terrain: Option<Entity>,
    /// The edit's number in the log; `None` takes back the newest.
    pub sequence: Option<u64>,
}

/// Makes an edit again that was taken back: the one that was last, or the one that is named.
#[derive(Event, Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RedoEdit {
    /// The terrain; `None` where there is only one.
    pub terrain: Option<Entity>,
    /// The edit's number in the log; `None` takes the one that was taken back last.
    pub sequence: Option<u64>,
}

/// Adds what another machine's log has and this one's hasn't.
#[derive(Event, Clone, Debug)]
pub struct MergeEdits {
    /// The terrain; `None` where there is only one.
    pub terrain: Option<Entity>,
    /// What [`EditLog::diff`] of the other log gave.
    pub diff: EditDiff,
}
