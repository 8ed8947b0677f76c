//! Masks follow logs.

use super::TerrainMask;
use crate::edit::{Edit, EditLog, EditOp, TerrainEdits};
use crate::stream::TerrainState;
use bevy::prelude::*;

/// Texels that are drawn in a frame, and those of the edit with which there are as many. A long log
/// that was loaded, or a thousand craters at once, take some frames; a crater doesn't.
const TEXELS_A_FRAME: f64 = (1 << 17) as f64;

/// What of which log a mask shows.
#[derive(Component, Default, Clone, Copy, PartialEq, Eq)]
pub(crate) struct MaskDrawn {
    mask: u64,
    log: u64,
    /// The last of the log's records.
    sequence: u64,
    /// Records up to here only count as far as they are active: the mask was empty when the last of
    /// them had come.
    fresh_until: u64,
}

/// Draws what has come to logs since the frame before into their terrains' masks.
pub(crate) fn draw_masks(
    mut masks: Query<(
        &TerrainEdits,
        Option<&TerrainState>,
        &mut TerrainMask,
        &mut MaskDrawn,
    )>,
) {
    for (edits, state, mut mask, mut drawn) in &mut masks {
        let Some(log) = edits.log() else {
            continue;
        };
        // A foreign log counts as none.
        let file = state.map(|state| &state.manifest().file);
        if file.is_some_and(|file| log.check_terrain(file).is_err()) {
            *drawn = MaskDrawn::default();
            if !mask.mask().is_empty() {
                mask.clear();
            }
            continue;
        }
        let last = log.last_sequence();
        let is_same = drawn.mask == mask.instance() && drawn.log == edits.instance();
        if !is_same || drawn.sequence > last {
            *drawn = MaskDrawn {
                mask: mask.instance(),
                log: edits.instance(),
                sequence: 0,
                fresh_until: last,
            };
            if !mask.mask().is_empty() {
                mask.clear();
            }
        }
        if drawn.sequence < last {
            follow(&mut mask, log, &mut drawn);
        }
    }
}

/// Draws what records say that have come since.
fn follow(mask: &mut TerrainMask, log: &EditLog, drawn: &mut MaskDrawn) {
    let texels_a_unit = 1.0 / f64::from(1_u32 << mask.mask().texel_shift());
    let mut texels = 0.0;
    let mut cost = |edit: &Edit| {
        // Larger ones are drawn with larger texels.
        let across = (2.0 * f64::from(edit.reach) * texels_a_unit).min(512.0);
        texels += across * across;
        texels > TEXELS_A_FRAME
    };
    for record in &log.records()[drawn.sequence as usize..] {
        let mut is_enough = false;
        match &record.op {
            EditOp::Apply(edit) => {
                if log.is_active(record.sequence) {
                    mask.apply(edit);
                    is_enough = cost(edit);
                }
            }
            EditOp::Undo(_) | EditOp::Redo(_) if record.sequence <= drawn.fresh_until => (),
            EditOp::Undo(sequence) | EditOp::Redo(sequence) => {
                if let Some(edit) = log.edit(*sequence) {
                    let rect = edit.rect();
                    // Later ones are drawn when it is their turn.
                    let there = log.active_in(rect).into_iter();
                    let before = there.filter(|(sequence, _)| *sequence < record.sequence);
                    let before: Vec<_> = before.map(|(_, edit)| &**edit).collect();
                    mask.rebuild(rect, before.iter().copied());
                    for edit in before {
                        is_enough |= cost(edit);
                    }
                }
            }
        }
        drawn.sequence = record.sequence;
        if is_enough {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::MaskSettings;
    use super::*;
    use crate::edit::Change;
    use crate::terrain::test_manifest_file;

    fn crater(number: i32) -> Edit {
        Edit {
            centre: [64 * (20 + 7 * number), 64 * (30 + number)],
            reach: 64 * 9,
            change: Change::Crater {
                depth: 50,
                rim: 10,
                bowl: 40_000,
                roughness: 20,
                seed: number as u32,
                density: 255,
                scorch: 200,
                may_clamp: false,
            },
        }
    }

    #[test]
    fn a_mask_shows_what_the_log_has_however_it_came_there() {
        let mut app = App::new();
        app.add_systems(Update, draw_masks);
        let settings = MaskSettings::default();
        let file = test_manifest_file([300, 300]);
        let mask = || TerrainMask::new(1.0, &settings);
        let edits = TerrainEdits::new(EditLog::new(&file));
        let terrain = app.world_mut().spawn((edits, mask())).id();
        app.update();
        let check = |app: &mut App| {
            // Undone and made again, many are drawn.
            for _ in 0..80 {
                app.update();
            }
            let log = app.world().get::<TerrainEdits>(terrain);
            let log = log.and_then(TerrainEdits::log).expect("is there");
            let mut wanted = mask();
            wanted.rebuild_all(log.active().map(|(_, edit)| &**edit));
            let shown = app.world().get::<TerrainMask>(terrain).expect("is there");
            assert!(shown.mask().content() == wanted.mask().content());
            wanted.mask().content().len()
        };
        let change = |app: &mut App, change: &dyn Fn(&mut EditLog)| {
            let mut edits = app.world_mut().get_mut::<TerrainEdits>(terrain);
            let log = edits.as_mut().and_then(|edits| edits.log_mut());
            change(log.expect("is there"));
        };
        for number in 0..9 {
            change(&mut app, &|log| {
                log.push(crater(number)).expect("fine");
            });
            if number % 2 == 0 {
                assert!(check(&mut app) > 0);
            }
        }
        change(&mut app, &|log| {
            log.undo(3).expect("active");
            log.push(crater(11)).expect("fine");
            log.undo_last();
        });
        check(&mut app);
        change(&mut app, &|log| {
            log.redo(3).expect("undone");
        });
        let flat = |number| Edit {
            change: Change::Flatten {
                to: 900,
                strength: 30_000,
                hardness: 100,
                least: -900,
                most: 900,
            },
            ..crater(number)
        };
        // What comes after an undo in the same frame fades once.
        change(&mut app, &|log| {
            log.undo(4).expect("active");
            log.push(flat(5)).expect("fine");
            log.push(crater(6)).expect("fine");
            log.redo(4).expect("undone");
        });
        let before = check(&mut app);
        // A long one that is loaded takes some frames.
        let mut long = EditLog::new(&file);
        for number in 0..300 {
            long.push(crater(number % 30)).expect("fine");
            long.push(flat(number % 28)).expect("fine");
            if number % 9 == 4 {
                long.undo(u64::from(number.unsigned_abs())).ok();
            }
        }
        let loaded = TerrainEdits::new(long);
        app.world_mut().entity_mut(terrain).insert(loaded);
        app.update();
        change(&mut app, &|log| {
            log.undo(2).expect("active");
        });
        check(&mut app);
        let edits = TerrainEdits::new(EditLog::new(&file));
        app.world_mut().entity_mut(terrain).insert(edits);
        assert_eq!(check(&mut app), 0);
        assert!(before > 0);
    }
}
