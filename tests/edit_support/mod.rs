//! What the tests of edits share: edits at random, and logs of them.

use bevy_tessera::density::DensitySettings;
use bevy_tessera::edit::{
    CapturedGround, Change, EDIT_UNITS, Edit, EditLog, MAX_REACH, MIN_REACH, StampImage,
};
use bevy_tessera::terrain::{MANIFEST_MAGIC, MANIFEST_VERSION, ManifestFile};
use proptest::prelude::*;
use std::sync::Arc;

pub fn terrain() -> ManifestFile {
    let size = [2049, 2049];
    ManifestFile {
        format: MANIFEST_MAGIC.to_owned(),
        version: MANIFEST_VERSION,
        size,
        spacing_m: 1.0,
        height_min_m: 0.0,
        height_step_m: 0.01,
        levels: ManifestFile::levels_for(size),
        density: DensitySettings::default(),
        index_crc32: 0,
    }
}

/// A hill around a place in units.
pub fn raise(x: i32, z: i32, reach: u32) -> Edit {
    Edit {
        centre: [x, z],
        reach,
        change: Change::Raise {
            by: 100,
            hardness: 200,
            density: 90,
            may_clamp: false,
        },
    }
}

pub fn crater(x: i32, z: i32, reach: u32, seed: u32) -> Edit {
    Edit {
        centre: [x, z],
        reach,
        change: Change::Crater {
            depth: 120,
            rim: 40,
            bowl: 40_000,
            roughness: 30,
            seed,
            density: 120,
            scorch: 200,
            may_clamp: false,
        },
    }
}

fn changes() -> impl Strategy<Value = Change> {
    let captured = (any::<u16>(), 2_u16..9, 2_u16..9).prop_map(|(base, columns, rows)| {
        let points = u32::from(columns) * u32::from(rows);
        let height = |at: u32| base.wrapping_add((at * at % 37) as u16);
        CapturedGround {
            first: [-7, 12],
            spacing_log2: 4,
            size: [columns, rows],
            heights: (0..points).map(height).collect(),
        }
    });
    // Few different ones, so that stamps share them, some by content only.
    let image = (2_u16..5).prop_map(|side| StampImage {
        side,
        samples: (0..side * side)
            .map(|at| at.cast_signed() * 900 - 7000)
            .collect(),
    });
    prop_oneof![
        (any::<u32>(), any::<u8>()).prop_map(|(seed, density)| Change::Crater {
            depth: 120,
            rim: 40,
            bowl: 40_000,
            roughness: 30,
            seed,
            density,
            scorch: 200,
            may_clamp: false,
        }),
        (-3000..3000, any::<u8>()).prop_map(|(by, hardness)| Change::Raise {
            by,
            hardness,
            density: 9,
            may_clamp: true,
        }),
        (any::<u16>(), any::<u16>()).prop_map(|(to, strength)| Change::Flatten {
            to,
            strength,
            hardness: 128,
            least: -400,
            most: 300,
        }),
        captured.prop_map(|ground| Change::Smooth {
            ground,
            strength: 40_000,
            hardness: 128,
            least: -40,
            most: 30,
        }),
        (image, -3000..3000).prop_map(|(image, by)| Change::Stamp {
            image,
            by,
            turn: [1 << 14, 0],
            density: 30,
            scorch: 0,
            may_clamp: false,
        }),
    ]
}

/// Edits on the terrain, at its rim and beyond, of all sizes.
pub fn edits() -> impl Strategy<Value = Edit> {
    let reach = prop_oneof![MIN_REACH..20 * MIN_REACH, MIN_REACH..=MAX_REACH];
    let units = -400 * EDIT_UNITS..2500 * EDIT_UNITS;
    (units.clone(), units, reach, changes()).prop_map(|(x, z, reach, change)| Edit {
        centre: [x, z],
        reach,
        change,
    })
}

/// What may be done to a log.
#[derive(Clone, Debug)]
pub enum Step {
    Push(Edit),
    /// The number, of those there are.
    Undo(u64),
    Redo(u64),
    UndoLast,
    RedoLast,
}

pub fn steps(most: usize) -> impl Strategy<Value = Vec<Step>> {
    let step = prop_oneof![
        5 => edits().prop_map(Step::Push),
        2 => any::<u64>().prop_map(Step::Undo),
        2 => any::<u64>().prop_map(Step::Redo),
        1 => Just(Step::UndoLast),
        1 => Just(Step::RedoLast),
    ];
    prop::collection::vec(step, 0..most)
}

/// The log that steps make; those that are refused change nothing.
pub fn replay_steps(steps: &[Step]) -> EditLog {
    let mut log = EditLog::new(&terrain());
    // Numbers come from what is there, so that most of them mean something.
    let of = |log: &EditLog, number: u64| number % (log.last_sequence() + 1);
    for step in steps {
        match step {
            Step::Push(edit) => {
                log.push(Arc::new(edit.clone())).expect("a good edit");
            }
            Step::Undo(number) => {
                let _ = log.undo(of(&log, *number));
            }
            Step::Redo(number) => {
                let _ = log.redo(of(&log, *number));
            }
            Step::UndoLast => {
                log.undo_last();
            }
            Step::RedoLast => {
                log.redo_last();
            }
        }
    }
    log
}
