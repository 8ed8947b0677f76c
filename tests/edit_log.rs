//! The log of edits: its order, undo and redo, what it tells by place, and how logs are brought
//! together.

#[expect(dead_code, reason = "every test file uses its own part")]
mod edit_support;

use bevy_tessera::edit::{
    Edit, EditDiff, EditLog, EditLogError, EditOp, Merged, SampleRect, TileSnapshot, touch_rect,
};
use bevy_tessera::tile::TileAddress;
use edit_support::{Step, edits, raise, replay_steps, steps, terrain};
use proptest::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Which edits are active, by the records alone.
fn active_by_records(log: &EditLog) -> BTreeMap<u64, Arc<Edit>> {
    let mut active = BTreeMap::new();
    let mut all = BTreeMap::new();
    for record in log.records() {
        match &record.op {
            EditOp::Apply(edit) => {
                active.insert(record.sequence, edit.clone());
                all.insert(record.sequence, edit.clone());
            }
            EditOp::Undo(sequence) => {
                assert!(active.remove(sequence).is_some(), "it was active");
            }
            EditOp::Redo(sequence) => {
                let again = active.insert(*sequence, all[sequence].clone());
                assert!(again.is_none(), "it was undone");
            }
        }
    }
    active
}

fn numbers(found: Vec<(u64, &Arc<Edit>)>) -> Vec<u64> {
    found.into_iter().map(|(sequence, _)| sequence).collect()
}

fn assert_tells_by_place(log: &EditLog, rect: SampleRect, after: u64) {
    let wanted: Vec<u64> = active_by_records(log)
        .iter()
        .filter(|(sequence, edit)| {
            **sequence > after && !rect.is_empty() && !edit.rect().intersection(&rect).is_empty()
        })
        .map(|(&sequence, _)| sequence)
        .collect();
    assert_eq!(
        numbers(log.active_in_after(rect, after)),
        wanted,
        "{rect:?}"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn what_is_active_in_a_place_is_what_a_look_at_every_edit_finds(
        steps in steps(300),
        rects in prop::collection::vec((-3000..3000, -3000..3000, 0..6000, 0..6000), 8),
        after in 0_u64..300,
    ) {
        let log = replay_steps(&steps);
        let active = active_by_records(&log);
        prop_assert_eq!(log.active_count(), active.len());
        for record in log.records() {
            prop_assert_eq!(
                log.is_active(record.sequence),
                active.contains_key(&record.sequence)
            );
        }
        let all: Vec<u64> = log.active().map(|(sequence, _)| sequence).collect();
        prop_assert_eq!(all, active.keys().copied().collect::<Vec<_>>());
        for (x, z, columns, rows) in rects {
            for small in [1, 8, 64] {
                let rect = SampleRect::new([x, z], [x + columns / small, z + rows / small]);
                assert_tells_by_place(&log, rect, after);
                assert_tells_by_place(&log, rect, 0);
            }
        }
        let all = SampleRect::new([i32::MIN; 2], [i32::MAX; 2]);
        assert_tells_by_place(&log, all, 0);
    }

    #[test]
    fn a_diff_from_any_record_on_makes_an_older_log_equal(
        steps in steps(40),
        behind in 0_usize..50,
        since in 0_u64..50,
    ) {
        let log = replay_steps(&steps);
        let have = behind.min(log.len());
        let since = since.min(have as u64);
        let mut late = EditLog::new(&terrain());
        let known = EditDiff { ops: log.diff(0).ops[..have].to_vec(), ..log.diff(0) };
        late.merge(known).expect("the beginning of a log");
        let before: BTreeSet<u64> = late.active().map(|(sequence, _)| sequence).collect();

        let merged = late.merge(log.diff(since)).expect("the rest of it");
        prop_assert_eq!(&late, &log);
        let after: BTreeSet<u64> = log.active().map(|(sequence, _)| sequence).collect();
        prop_assert_eq!(late.active().map(|(s, _)| s).collect::<BTreeSet<_>>(), after.clone());
        let (old, new): (Vec<u64>, Vec<u64>) =
            after.difference(&before).partition(|&&sequence| sequence <= have as u64);
        let gone: Vec<u64> = before.difference(&after).copied().collect();
        prop_assert_eq!(merged, Merged { applied: new, undone: gone, redone: old });

        // And they go on alike.
        let (mut a, mut b) = (log, late);
        prop_assert_eq!(a.redo_last(), b.redo_last());
        prop_assert_eq!(a.undo_last(), b.undo_last());
        prop_assert_eq!(a, b);
    }

    #[test]
    fn logs_that_have_parted_are_refused_unchanged(
        steps in steps(30),
        at in 0_usize..30,
        other in edits(),
    ) {
        let log = replay_steps(&steps);
        prop_assume!(!log.is_empty());
        let at = at % log.len();
        let mut diff = log.diff(0);
        let changed = EditOp::Apply(Arc::new(other));
        prop_assume!(diff.ops[at] != changed);
        diff.ops[at] = changed;
        let mut mine = log.clone();
        let version = mine.version();
        let error = mine.merge(diff).expect_err("it has parted");
        prop_assert_eq!(&error, &EditLogError::Parted { sequence: at as u64 + 1 });
        let named = format!("record {}", at + 1);
        prop_assert!(error.to_string().contains(&named), "{error}");
        prop_assert_eq!(&mine, &log);
        prop_assert_eq!(mine.version(), version);
    }

    #[test]
    fn diffs_keep_their_meaning_in_any_form(steps in steps(30), since in 0_u64..20) {
        let diff = replay_steps(&steps).diff(since);
        let binary = postcard::to_stdvec(&diff).expect("it can be written");
        prop_assert_eq!(&postcard::from_bytes::<EditDiff>(&binary).expect("and read"), &diff);
        let text = ron::to_string(&diff).expect("it can be written");
        prop_assert_eq!(&ron::from_str::<EditDiff>(&text).expect("and read"), &diff);
    }

    #[test]
    fn snapshots_are_dropped_by_what_they_hold_and_nothing_else(
        steps in steps(40),
        level in 0_u8..5,
        x in 0_u32..6,
        z in 0_u32..6,
        after in 0_usize..40,
    ) {
        let address = TileAddress::new(level, x, z);
        let touches = |log: &EditLog, sequence| {
            let rect = log.edit(sequence).expect("an edit").rect();
            !touch_rect(address).intersection(&rect).is_empty()
        };
        let all = replay_steps(&steps);
        let at = after.min(all.len());
        let mut log = EditLog::new(&terrain());
        let merge = |log: &mut EditLog, ops: &[EditOp]| {
            let ops = ops.to_vec();
            let diff = EditDiff { stamp: log.stamp(), since: log.last_sequence(), ops };
            log.merge(diff).expect("it follows");
        };
        let ops = all.diff(0).ops;
        merge(&mut log, &ops[..at]);
        let snapshot = TileSnapshot { address, sequence: at as u64, bytes: Arc::new([1, 2, 3]) };
        prop_assert!(log.keep_snapshot(snapshot.clone()));
        let mut stays = true;
        for op in &ops[at..] {
            merge(&mut log, std::slice::from_ref(op));
            if let EditOp::Undo(sequence) | EditOp::Redo(sequence) = op {
                stays &= *sequence > at as u64 || !touches(&log, *sequence);
            }
            prop_assert_eq!(log.snapshot(address).is_some(), stays);
        }
        // Who comes late with the same snapshot hears the same.
        let mut late = all.clone();
        prop_assert_eq!(late.keep_snapshot(snapshot), stays);
        let (kept, replayed) = late.replay_of(address);
        let first = kept.map_or(0, |snapshot| snapshot.sequence);
        let wanted: Vec<u64> = numbers(all.active_touching(address))
            .into_iter()
            .filter(|&sequence| sequence > first)
            .collect();
        prop_assert_eq!(numbers(replayed), wanted);
    }
}

#[test]
fn sequence_numbers_count_from_one_without_gaps() {
    let mut log = EditLog::new(&terrain());
    assert!(log.is_empty());
    assert_eq!(log.last_sequence(), 0);
    assert_eq!(log.push(raise(0, 0, 640)), Ok(1));
    assert_eq!(log.push(raise(64, 0, 640)), Ok(2));
    assert_eq!(log.undo(1), Ok(3));
    assert_eq!(log.push(raise(128, 0, 640)), Ok(4));
    let sequences: Vec<u64> = log.records().iter().map(|record| record.sequence).collect();
    assert_eq!(sequences, [1, 2, 3, 4]);
    assert_eq!(log.len(), 4);
    assert!(log.edit(3).is_none() && log.edit(0).is_none() && log.edit(5).is_none());
}

#[test]
fn undo_and_redo_are_refused_with_a_reason() {
    let mut log = EditLog::new(&terrain());
    log.push(raise(0, 0, 640)).expect("a good edit");
    let none = |sequence| Err(EditLogError::NoEdit { sequence });
    assert_eq!(log.undo(0), none(0));
    assert_eq!(log.undo(2), none(2));
    assert_eq!(log.redo(u64::MAX), none(u64::MAX));
    assert_eq!(
        log.redo(1),
        Err(EditLogError::AlreadyActive { sequence: 1 })
    );
    assert_eq!(log.undo(1), Ok(2));
    assert_eq!(
        log.undo(1),
        Err(EditLogError::AlreadyUndone { sequence: 1 })
    );
    // A record of an undo is no edit.
    assert_eq!(log.undo(2), none(2));
    assert_eq!(log.len(), 2);
}

#[test]
fn the_last_edits_are_undone_and_redone_as_editors_do() {
    let mut log = EditLog::new(&terrain());
    for at in 0..3 {
        log.push(raise(at * 640, 0, 640)).expect("a good edit");
    }
    assert_eq!([log.undo_last(), log.undo_last()], [Some(3), Some(2)]);
    assert_eq!([log.redo_last(), log.redo_last()], [Some(2), Some(3)]);
    assert_eq!(log.redo_last(), None);
    log.undo(1).expect("it is active");
    assert_eq!(log.undo_last(), Some(3));
    // What an explicit redo brought back is passed over.
    log.redo(3).expect("it is undone");
    assert_eq!([log.redo_last(), log.redo_last()], [Some(1), None]);
    // A new edit ends what can be redone in order, and a number still names it.
    assert_eq!(log.undo_last(), Some(3));
    let new = log.push(raise(0, 640, 640)).expect("a good edit");
    assert_eq!(log.redo_last(), None);
    log.redo(3).expect("it is undone");
    assert!(log.is_active(3));
    assert_eq!(log.undo_last(), Some(new));
    while log.undo_last().is_some() {}
    assert_eq!((log.active_count(), log.undo_last()), (0, None));
}

#[test]
fn every_change_has_a_version_of_its_own() {
    let mut log = EditLog::new(&terrain());
    let mut versions = vec![EditLog::new(&terrain()).version(), log.version()];
    log.push(raise(0, 0, 640)).expect("a good edit");
    versions.push(log.version());
    log.undo(1).expect("it is active");
    versions.push(log.version());
    log.redo(1).expect("it is undone");
    versions.push(log.version());
    let copy = log.clone();
    assert_eq!(copy.version(), log.version());
    log.undo_last();
    versions.push(log.version());
    let distinct: BTreeSet<_> = versions.iter().collect();
    assert_eq!(distinct.len(), versions.len(), "{versions:?}");
    assert!(log.undo(1).is_err());
    assert_eq!(log.version(), versions[versions.len() - 1]);
}

#[test]
fn no_invalid_edit_enters_a_log() {
    let mut log = EditLog::new(&terrain());
    let bad = raise(0, 0, 1);
    assert!(matches!(
        log.push(bad.clone()),
        Err(EditLogError::Invalid { sequence: 1, .. })
    ));
    let ops = vec![
        EditOp::Apply(Arc::new(raise(0, 0, 640))),
        EditOp::Apply(Arc::new(bad)),
    ];
    let stamp = log.stamp();
    let diff = EditDiff {
        stamp,
        since: 0,
        ops,
    };
    assert!(matches!(
        log.merge(diff),
        Err(EditLogError::Invalid { sequence: 2, .. })
    ));
    assert!(log.is_empty());
}

#[test]
fn what_cannot_follow_a_log_is_refused_unchanged() {
    let mut log = EditLog::new(&terrain());
    for at in 0..2 {
        log.push(raise(at * 640, 0, 640)).expect("a good edit");
    }
    log.undo(1).expect("it is active");
    let before = log.clone();
    let stamp = log.stamp();
    let mut refused = |since, ops: Vec<EditOp>| {
        let error = log.merge(EditDiff { stamp, since, ops });
        assert_eq!(log, before);
        error.expect_err("it can't follow")
    };
    let gap = refused(4, Vec::new());
    assert_eq!(gap, EditLogError::Gap { last: 3, since: 4 });
    assert!(
        gap.to_string().contains("records 4 to 4 are missing"),
        "{gap}"
    );
    let new = || EditOp::Apply(Arc::new(raise(0, 0, 640)));
    for (ops, wanted) in [
        (
            vec![new(), EditOp::Undo(1)],
            EditLogError::AlreadyUndone { sequence: 1 },
        ),
        (
            vec![new(), EditOp::Redo(2)],
            EditLogError::AlreadyActive { sequence: 2 },
        ),
        (
            vec![new(), EditOp::Undo(5)],
            EditLogError::NoEdit { sequence: 5 },
        ),
        (vec![EditOp::Undo(3)], EditLogError::NoEdit { sequence: 3 }),
        (
            vec![new(), EditOp::Undo(4), EditOp::Undo(4)],
            EditLogError::AlreadyUndone { sequence: 4 },
        ),
    ] {
        assert_eq!(refused(3, ops), wanted);
    }
    let other = EditDiff {
        stamp: stamp ^ 1,
        since: 0,
        ops: Vec::new(),
    };
    let error = log.merge(other).expect_err("another terrain's");
    assert!(error.to_string().contains("another terrain"), "{error}");
    assert_eq!(log, before);
}

#[test]
fn a_tile_is_touched_as_far_as_its_error_bounds_reach() {
    for (address, min, max) in [
        (TileAddress::new(0, 0, 0), [-68, -68], [197, 197]),
        (TileAddress::new(0, 2, 1), [188, 60], [453, 325]),
        (TileAddress::new(3, 1, 0), [480, -544], [2593, 1569]),
    ] {
        assert_eq!(touch_rect(address), SampleRect::new(min, max), "{address}");
    }
    // The largest addresses there are don't overflow.
    let root = touch_rect(TileAddress::new(17, 0, 0));
    assert_eq!(root.max[0], (196 << 17) + 1);
    let beyond = touch_rect(TileAddress::new(255, u32::MAX, u32::MAX));
    assert_eq!(beyond.max, [i32::MAX; 2]);
}

#[test]
fn the_newer_snapshot_of_a_tile_is_kept() {
    let mut log = EditLog::new(&terrain());
    for _ in 0..3 {
        log.push(raise(0, 0, 640)).expect("a good edit");
    }
    let address = TileAddress::new(0, 0, 0);
    let snapshot = |sequence| TileSnapshot {
        address,
        sequence,
        bytes: Arc::new([sequence as u8]),
    };
    assert!(!log.keep_snapshot(snapshot(4)), "newer than the log");
    assert!(log.keep_snapshot(snapshot(2)));
    assert!(!log.keep_snapshot(snapshot(1)));
    assert_eq!(log.snapshot(address), Some(&snapshot(2)));
    assert_eq!(numbers(log.replay_of(address).1), [3]);
    assert!(log.keep_snapshot(snapshot(3)));
    assert_eq!(log.replay_of(address).1.len(), 0);
    log.undo(3).expect("it is active");
    assert_eq!(log.snapshot(address), None);
    // Taken before that undo, it comes too late.
    assert!(!log.keep_snapshot(snapshot(3)));
    assert!(log.keep_snapshot(snapshot(2)));
}

#[test]
fn every_kind_of_step_happens_in_these_tests() {
    let kinds = [Step::Push(raise(0, 0, 64)), Step::UndoLast, Step::RedoLast];
    let log = replay_steps(&kinds);
    assert_eq!(log.len(), 3);
}
