//! The log: all edits in their order, with those that were taken back.

use super::check::{Checker, check_edit};
use super::index::{AreaIndex, touch_rect};
use super::snapshot::{Snapshots, TileSnapshot, is_stale};
use super::{Edit, SampleRect};
use crate::terrain::ManifestFile;
use crate::tile::TileAddress;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeSet, HashMap};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use thiserror::Error;

/// What a record of the log says.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum EditOp {
    /// An edit is made. It has the record's sequence number from then on.
    Apply(#[serde(with = "super::compact::shared_edit")] Arc<Edit>),
    /// The active edit of this sequence number is taken back.
    Undo(u64),
    /// The undone edit of this sequence number is made again, in its old place in the order.
    Redo(u64),
}

/// One record of the log.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct EditRecord {
    /// Its number: the first record has 1, and none is left out.
    pub sequence: u64,
    /// What it says: an edit, or that one is taken back or made again.
    pub op: EditOp,
}

/// What one log has beyond another's last record, for whoever joins late or fell behind.
///
/// Its serde form holds images that several stamps share once.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(
    try_from = "super::compact::StoredDiff",
    into = "super::compact::StoredDiff"
)]
pub struct EditDiff {
    /// The [stamp](ManifestFile::stamp) of the log's terrain.
    pub stamp: u32,
    /// The sequence number of the record before the first of [`ops`](Self::ops).
    pub since: u64,
    /// What the records after it say, in order.
    pub ops: Vec<EditOp>,
}

/// How the ground changed by a [merge](EditLog::merge), each list in order of the sequence.
///
/// Only what differs before and after counts: an edit that came and was undone again is in no
/// list.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Merged {
    /// New edits that are active.
    pub applied: Vec<u64>,
    /// Edits that were active before and are undone.
    pub undone: Vec<u64>,
    /// Edits that were undone before and are active.
    pub redone: Vec<u64>,
}

/// Why a log refuses something. It has not changed then.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum EditLogError {
    /// No edit has the number.
    #[error("edit {sequence} can't be undone or redone: the log has no edit of that number")]
    NoEdit {
        /// The number.
        sequence: u64,
    },
    /// The edit has been undone before.
    #[error("edit {sequence} can't be undone: it is undone already")]
    AlreadyUndone {
        /// The edit's number.
        sequence: u64,
    },
    /// The edit isn't undone.
    #[error("edit {sequence} can't be redone: it is active already")]
    AlreadyActive {
        /// The edit's number.
        sequence: u64,
    },
    /// An edit that no ground can have.
    #[error("edit {sequence} can't be taken into the log: {reason}")]
    Invalid {
        /// The number that it has, or would have had.
        sequence: u64,
        /// What is wrong with it.
        reason: String,
    },
    /// Both logs have different records of the same number.
    #[error(
        "the logs have parted: both have a record {sequence}, and they differ; load one of them in \
         the other's place"
    )]
    Parted {
        /// The first number at which they differ.
        sequence: u64,
    },
    /// Records between the log's last and the diff's first are missing.
    #[error(
        "records {} to {since} are missing between the log and the diff; ask for a diff since \
         {last}",
        last + 1
    )]
    Gap {
        /// The log's last sequence number.
        last: u64,
        /// Where the diff begins.
        since: u64,
    },
    /// The edits are of another terrain.
    #[error(
        "the edits belong to another terrain (stamp {found:08x} where this terrain has \
         {wanted:08x}); use the edits that were made on this one"
    )]
    OtherTerrain {
        /// Stamp of the edits' terrain.
        found: u32,
        /// Stamp of this terrain.
        wanted: u32,
    },
}

/// An ordered log of edits, with undo and redo.
///
/// The ground is by definition the terrain as it was baked with all *active* edits, those that were
/// not undone, applied in the order of their sequence numbers. Undoing and redoing are records too, so
/// a log only ever grows, and two logs that begin alike are brought together by what one has more
/// ([`diff`](Self::diff), [`merge`](Self::merge)).
///
/// Two logs are equal where they are of terrains of the same stamp and size and have equal records;
/// all else follows from these, but for snapshots, which don't count.
///
/// Edits are shared by clones of a log and by diffs of it, images also by edits. Besides these, an
/// edit takes its record, its place among the active ones, and 24 bytes of the index by area, which may
/// have room for as many again.
#[derive(Clone, Debug)]
pub struct EditLog {
    stamp: u32,
    size: [u32; 2],
    records: Vec<EditRecord>,
    /// Sequence numbers of the undos and redos among them.
    changes: Vec<u64>,
    active: BTreeSet<u64>,
    /// Undone edits since the last new one, the latest last. Entries that have become active by an
    /// explicit redo stay, and are passed over.
    redo: Vec<u64>,
    area: AreaIndex,
    snapshots: Snapshots,
    version: u64,
}

impl PartialEq for EditLog {
    fn eq(&self, other: &Self) -> bool {
        (self.stamp, self.size) == (other.stamp, other.size) && self.records == other.records
    }
}

impl Eq for EditLog {}

/// So many records are looked at one by one, in a coarse tile's case instead of thousands of cells.
const FEW_RECORDS: usize = 64;

/// A number that no log has had yet.
fn new_version() -> u64 {
    static VERSIONS: AtomicU64 = AtomicU64::new(1);
    VERSIONS.fetch_add(1, Ordering::Relaxed)
}

impl EditLog {
    /// An empty log of the terrain that `file` describes.
    #[must_use]
    pub fn new(file: &ManifestFile) -> Self {
        Self::of_stamp(file.stamp(), file.size)
    }

    pub(super) fn of_stamp(stamp: u32, size: [u32; 2]) -> Self {
        Self {
            stamp,
            size,
            records: Vec::new(),
            changes: Vec::new(),
            active: BTreeSet::new(),
            redo: Vec::new(),
            area: AreaIndex::default(),
            snapshots: Snapshots::default(),
            version: new_version(),
        }
    }

    /// The [stamp](ManifestFile::stamp) of the log's terrain.
    #[must_use]
    pub const fn stamp(&self) -> u32 {
        self.stamp
    }

    /// Samples of level 0 in x and z of the log's terrain.
    #[must_use]
    pub const fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Checks that the log is of the terrain that `file` describes.
    ///
    /// # Errors
    /// [`EditLogError::OtherTerrain`] where it is of another.
    pub fn check_terrain(&self, file: &ManifestFile) -> Result<(), EditLogError> {
        let (found, wanted) = (self.stamp, file.stamp());
        if found == wanted && self.size == file.size {
            Ok(())
        } else {
            Err(EditLogError::OtherTerrain { found, wanted })
        }
    }

    /// How many records there are, undos and redos included.
    #[must_use]
    pub fn len(&self) -> usize {
        self.records.len()
    }

    /// Whether there is no record.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.records.is_empty()
    }

    /// The last record's sequence number; 0 where there is none.
    #[must_use]
    pub fn last_sequence(&self) -> u64 {
        self.records.len() as u64
    }

    /// All records in order.
    #[must_use]
    pub fn records(&self) -> &[EditRecord] {
        &self.records
    }

    /// A number that changes whenever the log does (snapshots apart), and that no two logs share
    /// unless one is an unchanged clone of the other.
    #[must_use]
    pub const fn version(&self) -> u64 {
        self.version
    }

    /// The edit of a sequence number, active or not; `None` where that record is none of an edit.
    #[must_use]
    pub fn edit(&self, sequence: u64) -> Option<&Arc<Edit>> {
        let at = usize::try_from(sequence.checked_sub(1)?).ok()?;
        match &self.records.get(at)?.op {
            EditOp::Apply(edit) => Some(edit),
            EditOp::Undo(_) | EditOp::Redo(_) => None,
        }
    }

    /// Whether an edit has this number and is not undone.
    #[must_use]
    pub fn is_active(&self, sequence: u64) -> bool {
        self.active.contains(&sequence)
    }

    /// How many edits are active.
    #[must_use]
    pub fn active_count(&self) -> usize {
        self.active.len()
    }

    /// All active edits, in order of their sequence numbers.
    pub fn active(&self) -> impl DoubleEndedIterator<Item = (u64, &Arc<Edit>)> {
        self.active
            .iter()
            .filter_map(|&sequence| Some((sequence, self.edit(sequence)?)))
    }

    /// Adds an edit at the end and returns its sequence number. What was undone before can no longer
    /// be brought back by [`redo_last`](Self::redo_last), as in editors.
    ///
    /// # Errors
    /// [`EditLogError::Invalid`] for an edit that no ground can have: a log that held one couldn't be
    /// loaded again.
    pub fn push(&mut self, edit: impl Into<Arc<Edit>>) -> Result<u64, EditLogError> {
        let edit = edit.into();
        let sequence = self.last_sequence() + 1;
        check_edit(&edit).map_err(|reason| EditLogError::Invalid { sequence, reason })?;
        self.commit(EditOp::Apply(edit));
        Ok(sequence)
    }

    /// Takes an active edit back, and returns the sequence number of the record that says so.
    ///
    /// # Errors
    /// Where there is no such edit, or it is undone already.
    pub fn undo(&mut self, sequence: u64) -> Result<u64, EditLogError> {
        if self.edit(sequence).is_none() {
            return Err(EditLogError::NoEdit { sequence });
        }
        if !self.is_active(sequence) {
            return Err(EditLogError::AlreadyUndone { sequence });
        }
        self.commit(EditOp::Undo(sequence));
        Ok(self.last_sequence())
    }

    /// Makes an undone edit again, in its old place in the order, and returns the sequence number of
    /// the record that says so.
    ///
    /// # Errors
    /// Where there is no such edit, or it is active already.
    pub fn redo(&mut self, sequence: u64) -> Result<u64, EditLogError> {
        if self.edit(sequence).is_none() {
            return Err(EditLogError::NoEdit { sequence });
        }
        if self.is_active(sequence) {
            return Err(EditLogError::AlreadyActive { sequence });
        }
        self.commit(EditOp::Redo(sequence));
        Ok(self.last_sequence())
    }

    /// Takes the newest active edit back and returns its sequence number; `None` where none is active.
    pub fn undo_last(&mut self) -> Option<u64> {
        let sequence = *self.active.last()?;
        self.commit(EditOp::Undo(sequence));
        Some(sequence)
    }

    /// Makes the edit again that was undone last, and returns its sequence number; `None` where none
    /// was undone since the last new edit. Edits undone before that one come back by
    /// [`redo`](Self::redo) only.
    pub fn redo_last(&mut self) -> Option<u64> {
        while let Some(sequence) = self.redo.pop() {
            if !self.is_active(sequence) {
                self.commit(EditOp::Redo(sequence));
                return Some(sequence);
            }
        }
        None
    }

    /// Appends a record that is known to be allowed.
    fn commit(&mut self, op: EditOp) {
        let next = self.last_sequence() + 1;
        match &op {
            EditOp::Apply(edit) => {
                self.area.insert(next, edit.rect());
                self.active.insert(next);
                self.redo.clear();
            }
            EditOp::Undo(sequence) => {
                if let Some(rect) = self.edit(*sequence).map(|edit| edit.rect()) {
                    self.area.remove(*sequence, rect);
                    self.snapshots.drop_stale(*sequence, &rect);
                }
                self.active.remove(sequence);
                self.redo.push(*sequence);
            }
            EditOp::Redo(sequence) => {
                if let Some(rect) = self.edit(*sequence).map(|edit| edit.rect()) {
                    self.area.insert(*sequence, rect);
                    self.snapshots.drop_stale(*sequence, &rect);
                }
                self.active.insert(*sequence);
            }
        }
        if !matches!(op, EditOp::Apply(_)) {
            self.changes.push(next);
        }
        self.records.push(EditRecord { sequence: next, op });
        self.version = new_version();
    }

    /// All that came after the record `since`; 0 asks for everything. Costs a copy of the records,
    /// which share their edits with the log.
    #[must_use]
    pub fn diff(&self, since: u64) -> EditDiff {
        let since = since.min(self.last_sequence());
        let after = &self.records[since as usize..];
        EditDiff {
            stamp: self.stamp,
            since,
            ops: after.iter().map(|record| record.op.clone()).collect(),
        }
    }

    /// Appends what a diff has more than this log. Records that both have must be equal.
    ///
    /// Costs what the records cost that are looked at: to join late is to merge `diff(0)` into an empty
    /// log, which is what loading one costs without the file.
    ///
    /// # Errors
    /// Where the diff is of another terrain, where the two have parted, where records are missing in
    /// between, and where a new record can't be: an invalid edit, or an undo or redo of one that
    /// isn't there, or is undone or active already. Nothing has changed then.
    pub fn merge(&mut self, diff: EditDiff) -> Result<Merged, EditLogError> {
        if diff.stamp != self.stamp {
            return Err(EditLogError::OtherTerrain {
                found: diff.stamp,
                wanted: self.stamp,
            });
        }
        let last = self.last_sequence();
        if diff.since > last {
            let since = diff.since;
            return Err(EditLogError::Gap { last, since });
        }
        let known = self.records[diff.since as usize..].iter();
        let parted = known.zip(&diff.ops).find(|(record, op)| record.op != **op);
        if let Some((record, _)) = parted {
            let sequence = record.sequence;
            return Err(EditLogError::Parted { sequence });
        }
        let overlap = (last - diff.since) as usize;
        let new: Vec<EditOp> = diff.ops.into_iter().skip(overlap).collect();
        let changed = self.check_ops(&new)?;

        let mut merged = Merged::default();
        for (sequence, active) in changed {
            match (sequence > last, self.is_active(sequence), active) {
                (true, _, true) => merged.applied.push(sequence),
                (false, true, false) => merged.undone.push(sequence),
                (false, false, true) => merged.redone.push(sequence),
                _ => {}
            }
        }
        for list in [&mut merged.applied, &mut merged.undone, &mut merged.redone] {
            list.sort_unstable();
        }
        for op in new {
            self.commit(op);
        }
        Ok(merged)
    }

    /// Checks records that would be appended, without appending them; returns the edits whose state
    /// they set, and to what.
    fn check_ops(&self, ops: &[EditOp]) -> Result<HashMap<u64, bool>, EditLogError> {
        let last = self.last_sequence();
        let mut state: HashMap<u64, bool> = HashMap::new();
        let mut checker = Checker::default();
        for (op, sequence) in ops.iter().zip(last + 1..) {
            let edit_state = |state: &HashMap<u64, bool>, of: u64| match state.get(&of) {
                Some(&active) => Ok(active),
                None if self.edit(of).is_some() => Ok(self.is_active(of)),
                None => Err(EditLogError::NoEdit { sequence: of }),
            };
            match op {
                EditOp::Apply(edit) => {
                    let invalid = |reason| EditLogError::Invalid { sequence, reason };
                    checker.check(edit).map_err(invalid)?;
                    state.insert(sequence, true);
                }
                &EditOp::Undo(of) => {
                    if !edit_state(&state, of)? {
                        return Err(EditLogError::AlreadyUndone { sequence: of });
                    }
                    state.insert(of, false);
                }
                &EditOp::Redo(of) => {
                    if edit_state(&state, of)? {
                        return Err(EditLogError::AlreadyActive { sequence: of });
                    }
                    state.insert(of, true);
                }
            }
        }
        Ok(state)
    }

    /// Active edits whose [rectangle](Edit::rect) meets `rect` (samples of level 0), in order of their
    /// sequence numbers. Costs what meets it and lies near it, however many edits there are elsewhere.
    #[must_use]
    pub fn active_in(&self, rect: SampleRect) -> Vec<(u64, &Arc<Edit>)> {
        self.active_in_after(rect, 0)
    }

    /// [`active_in`](Self::active_in), only those whose sequence numbers are above `after`.
    #[must_use]
    pub fn active_in_after(&self, rect: SampleRect, after: u64) -> Vec<(u64, &Arc<Edit>)> {
        let new = self.records.get(after as usize..).unwrap_or_default();
        if new.len() <= FEW_RECORDS {
            let meeting = |record: &EditRecord| {
                let edit = self.edit(record.sequence)?;
                let meets = !edit.rect().intersection(&rect).is_empty();
                (meets && self.is_active(record.sequence)).then_some((record.sequence, edit))
            };
            return new.iter().filter_map(meeting).collect();
        }
        let found = self.area.meeting(&rect, after);
        let with_edit = |sequence| Some((sequence, self.edit(sequence)?));
        found.into_iter().filter_map(with_edit).collect()
    }

    /// Active edits that may [touch](touch_rect) a tile, in order: what has to be applied to the tile
    /// as it was baked.
    #[must_use]
    pub fn active_touching(&self, address: TileAddress) -> Vec<(u64, &Arc<Edit>)> {
        self.active_in(touch_rect(address))
    }

    /// A tile's snapshot, if there is one, and the edits that have to be applied to it, or to the tile
    /// as it was baked.
    #[must_use]
    pub fn replay_of(
        &self,
        address: TileAddress,
    ) -> (Option<&TileSnapshot>, Vec<(u64, &Arc<Edit>)>) {
        let snapshot = self.snapshot(address);
        let after = snapshot.map_or(0, |snapshot| snapshot.sequence);
        (snapshot, self.active_in_after(touch_rect(address), after))
    }

    /// Keeps a snapshot of a tile in place of an older one. Returns whether it was kept: it isn't where
    /// a newer one is there, where it says that it is newer than the log, and where an edit that it
    /// holds or should hold was undone or redone since it was taken. Looks at all undos and redos since then.
    pub fn keep_snapshot(&mut self, snapshot: TileSnapshot) -> bool {
        if snapshot.sequence > self.last_sequence() {
            return false;
        }
        let stale = |change: &u64| match self.records[*change as usize - 1].op {
            EditOp::Undo(sequence) | EditOp::Redo(sequence) => self
                .edit(sequence)
                .is_some_and(|edit| is_stale(&snapshot, sequence, &edit.rect())),
            EditOp::Apply(_) => false,
        };
        let first = self
            .changes
            .partition_point(|&change| change <= snapshot.sequence);
        if self.changes[first..].iter().any(stale) {
            return false;
        }
        self.snapshots.keep(snapshot)
    }

    /// The tile's snapshot. Undoing or redoing an edit that it holds, or that it would have held,
    /// drops it.
    #[must_use]
    pub fn snapshot(&self, address: TileAddress) -> Option<&TileSnapshot> {
        self.snapshots.get(address)
    }

    /// Drops a tile's snapshot, one that can't be used for example, and returns it.
    pub fn remove_snapshot(&mut self, address: TileAddress) -> Option<TileSnapshot> {
        self.snapshots.remove(address)
    }

    /// How many tiles have a snapshot.
    #[must_use]
    pub fn snapshot_count(&self) -> usize {
        self.snapshots.len()
    }

    /// All snapshots, sorted by tile.
    #[must_use]
    pub fn snapshots(&self) -> Vec<&TileSnapshot> {
        self.snapshots.sorted()
    }
}
