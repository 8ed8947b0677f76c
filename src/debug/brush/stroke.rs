//! Strokes: places along a path, and which edits of a log belong together.

use crate::edit::{EditDiff, EditLog, EditOp, MergeEdits, RedoEdit, TerrainEdits, UndoEdit};
use bevy::math::DVec2;
use bevy::prelude::*;

/// The next place of a stroke whose last edit is at `last` and whose pointer has come to `to`; `None`
/// where that is nearer than `step`. In metres of a terrain's own plane.
pub(super) fn next_place(last: DVec2, to: DVec2, step: f64) -> Option<DVec2> {
    let way = to - last;
    let length = way.length();
    // What is not a number is no way.
    (step > 0.0 && length >= step).then(|| last + way * (step / length))
}

/// Edits of one stroke.
#[derive(Clone, Debug)]
struct Stroke {
    terrain: Entity,
    /// Which of the logs that the terrain may have had.
    log: u64,
    /// Their numbers, ascending.
    sequences: Vec<u64>,
}

/// Strokes that were made with the brush, so that each is taken back as a whole.
#[derive(Resource, Debug, Default)]
pub struct BrushHistory {
    strokes: Vec<Stroke>,
}

impl BrushHistory {
    /// A stroke begins.
    pub(super) fn begin(&mut self, terrain: Entity, log: u64) {
        // One edit needs no company to be taken back.
        if self
            .strokes
            .last()
            .is_some_and(|last| last.sequences.len() < 2)
        {
            self.strokes.pop();
        }
        self.strokes.push(Stroke {
            terrain,
            log,
            sequences: Vec::new(),
        });
    }

    /// An edit of the stroke that was begun last.
    pub(super) fn add(&mut self, sequence: u64) {
        if let Some(last) = self.strokes.last_mut() {
            last.sequences.push(sequence);
        }
    }

    /// What is undone or redone together with an edit.
    fn company(&self, terrain: Entity, log: u64, sequence: u64) -> Vec<u64> {
        let mut strokes = self.strokes.iter().rev();
        let stroke = strokes.find(|stroke| {
            (stroke.terrain, stroke.log) == (terrain, log)
                && stroke.sequences.binary_search(&sequence).is_ok()
        });
        stroke.map_or_else(|| vec![sequence], |stroke| stroke.sequences.clone())
    }
}

/// The edit that [`EditLog::redo_last`] would bring back.
pub(super) fn next_redo(log: &EditLog) -> Option<u64> {
    undone_since_last_edit(log).next()
}

/// Edits that were undone after the last new one and still are, the latest first; one that was undone
/// twice comes twice.
pub(super) fn undone_since_last_edit(log: &EditLog) -> impl Iterator<Item = u64> {
    let records = log.records().iter().rev();
    let turns = records.map_while(|record| match record.op {
        EditOp::Apply(_) => None,
        EditOp::Undo(sequence) => Some(Some(sequence)),
        EditOp::Redo(_) => Some(None),
    });
    turns.flatten().filter(|&sequence| !log.is_active(sequence))
}

/// Takes the newest edit of `terrain` back, with its stroke's others; `None` takes the only terrain.
///
/// A stroke is taken back in one go: one record an edit, and the ground is made anew once. Where there
/// is nothing to be undone, [`TerrainEditRefused`](crate::edit::TerrainEditRefused) says so.
pub fn undo_stroke(world: &mut World, terrain: Option<Entity>) {
    turn(world, terrain, true);
}

/// Makes the edit again that was taken back last, with its stroke's others; otherwise as
/// [`undo_stroke`].
pub fn redo_stroke(world: &mut World, terrain: Option<Entity>) {
    turn(world, terrain, false);
}

fn turn(world: &mut World, terrain: Option<Entity>, undo: bool) {
    let terrain = terrain.or_else(|| {
        let mut terrains = world.query_filtered::<Entity, With<TerrainEdits>>();
        terrains.single(world).ok()
    });
    let diff = terrain.and_then(|terrain| together(world, terrain, undo));
    match diff {
        Some(diff) => world.trigger(MergeEdits { terrain, diff }),
        None if undo => world.trigger(UndoEdit {
            terrain,
            sequence: None,
        }),
        None => world.trigger(RedoEdit {
            terrain,
            sequence: None,
        }),
    }
    world.flush();
}

/// The records that undo or redo a stroke of several edits.
fn together(world: &World, terrain: Entity, undo: bool) -> Option<EditDiff> {
    let history = world.get_resource::<BrushHistory>()?;
    let edits = world.get::<TerrainEdits>(terrain)?;
    let log = edits.log()?;
    let first = if undo {
        log.active().next_back()?.0
    } else {
        next_redo(log)?
    };
    let mut company = history.company(terrain, edits.instance(), first);
    company.retain(|&sequence| log.is_active(sequence) == undo);
    if company.len() < 2 {
        return None;
    }
    let ops = if undo {
        company.into_iter().rev().map(EditOp::Undo).collect()
    } else {
        company.into_iter().map(EditOp::Redo).collect()
    };
    Some(EditDiff {
        stamp: log.stamp(),
        since: log.last_sequence(),
        ops,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::{Change, Edit};

    #[test]
    fn places_lie_a_step_apart_on_the_way_to_the_pointer() {
        let mut at = DVec2::new(2.0, 1.0);
        let to = DVec2::new(8.5, 1.0);
        let mut places = Vec::new();
        while let Some(next) = next_place(at, to, 2.0) {
            places.push(next.x);
            at = next;
        }
        assert_eq!(places, [4.0, 6.0, 8.0]);
        assert_eq!(next_place(at, to, f64::NAN), None);
        assert_eq!(next_place(at, to, 0.0), None);
        assert_eq!(next_place(at, DVec2::NAN, 1.0), None);
    }

    fn log() -> EditLog {
        let mut log = EditLog::new(&crate::terrain::test_manifest_file([3000, 2000]));
        for at in 0..5 {
            let change = Change::Raise {
                by: 10,
                hardness: 0,
                density: 0,
                may_clamp: false,
            };
            let centre = [at * 640, 640];
            log.push(Edit {
                centre,
                reach: 320,
                change,
            })
            .unwrap();
        }
        log
    }

    #[test]
    fn the_next_redo_is_what_the_log_would_bring_back() {
        let mut log = log();
        assert_eq!(next_redo(&log), None);
        for turn in 0..40_u64 {
            // Some ways through the log, without a new edit.
            match turn % 5 {
                0 | 1 | 3 => drop(log.undo_last()),
                2 => drop(log.redo_last()),
                _ => {
                    let any = turn % 4 + 1;
                    drop(log.redo(any).or_else(|_| log.undo(any)));
                }
            }
            let wanted = log.clone().redo_last();
            assert_eq!(next_redo(&log), wanted, "after turn {turn}");
        }
        let edit = log.edit(1).unwrap().clone();
        log.push(edit).unwrap();
        assert_eq!(next_redo(&log), None);
    }

    #[test]
    fn a_stroke_knows_its_company_in_its_own_log_only() {
        let mut history = BrushHistory::default();
        let terrain = Entity::from_bits(7);
        history.begin(terrain, 1);
        history.add(3);
        history.begin(terrain, 1);
        for sequence in [4, 5, 7] {
            history.add(sequence);
        }
        assert_eq!(history.company(terrain, 1, 5), [4, 5, 7]);
        assert_eq!(history.company(terrain, 1, 6), [6]);
        assert_eq!(history.company(terrain, 1, 3), [3]);
        assert_eq!(history.company(terrain, 2, 5), [5]);
        history.begin(terrain, 1);
        assert_eq!(history.strokes.len(), 2, "a single edit is no stroke");
    }
}
