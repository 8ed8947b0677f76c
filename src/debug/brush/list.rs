//! The log as a list, newest first, and its figures.

use crate::edit::{Change, EDIT_UNITS, Edit, EditLog, EditOp, EditRecord};
use crate::terrain::ManifestFile;
use bevy::math::DVec2;
use std::collections::HashSet;
use std::fmt::Write;
use std::sync::Arc;

/// What is known of a log without going through it every frame. A log only grows, and so each frame
/// costs what is new.
#[derive(Debug, Default)]
pub(super) struct Known {
    instance: u64,
    version: u64,
    records: usize,
    /// Numbers of the edits among the records.
    edits: Vec<u64>,
    images: HashSet<usize>,
    pub(super) bytes: usize,
    pub(super) undone: usize,
    /// Edits that redo would bring back.
    pub(super) redoable: usize,
}

impl Known {
    /// Brings it up to date. `instance` tells one log from another that takes its place.
    pub(super) fn follow(&mut self, log: &EditLog, instance: u64) {
        if self.instance != instance || log.len() < self.records {
            *self = Self {
                instance,
                ..Self::default()
            };
        } else if self.version == log.version() {
            return;
        }
        for record in &log.records()[self.records..] {
            self.bytes += size_of::<EditRecord>();
            if let EditOp::Apply(edit) = &record.op {
                self.edits.push(record.sequence);
                self.bytes += size_of::<Edit>() + self.shared_bytes(edit);
            }
        }
        self.records = log.len();
        self.version = log.version();
        self.undone = self.edits.len() - log.active_count();
        let mut undone: Vec<_> = super::stroke::undone_since_last_edit(log).collect();
        undone.sort_unstable();
        undone.dedup();
        self.redoable = undone.len();
    }

    /// Bytes of images and captured ground, which edits may share.
    fn shared_bytes(&mut self, edit: &Edit) -> usize {
        let (at, bytes) = match &edit.change {
            Change::Smooth { ground, .. } => (
                Arc::as_ptr(&ground.heights).cast::<u8>() as usize,
                size_of_val(&*ground.heights),
            ),
            Change::Stamp { image, .. } => (
                Arc::as_ptr(&image.samples).cast::<u8>() as usize,
                size_of_val(&*image.samples),
            ),
            _ => return 0,
        };
        if self.images.insert(at) { bytes } else { 0 }
    }

    pub(super) const fn rows(&self) -> usize {
        self.edits.len()
    }

    /// The edit's number in a row, the newest in row 0.
    pub(super) fn sequence(&self, row: usize) -> Option<u64> {
        let from_end = self.edits.len().checked_sub(row + 1)?;
        self.edits.get(from_end).copied()
    }
}

pub(super) const fn kind(edit: &Edit) -> &'static str {
    match &edit.change {
        Change::Crater { .. } => "Crater",
        Change::Raise { by, .. } if *by < 0 => "Lower",
        Change::Raise { .. } => "Raise",
        Change::Flatten { .. } => "Flatten",
        Change::Smooth { .. } => "Smooth",
        Change::Stamp { .. } => "Stamp",
    }
}

/// Where an edit is, in metres of the terrain's own x and z.
pub(super) fn place_m(edit: &Edit, file: &ManifestFile) -> DVec2 {
    DVec2::from(edit.centre.map(f64::from)) * (file.spacing_m / f64::from(EDIT_UNITS))
}

/// How far it reaches, in metres of the terrain's own space.
pub(super) fn reach_m(edit: &Edit, file: &ManifestFile) -> f64 {
    f64::from(edit.reach) * file.spacing_m / f64::from(EDIT_UNITS)
}

/// A line of the list, into `text`.
pub(super) fn write_row(text: &mut String, sequence: u64, edit: &Edit, file: &ManifestFile) {
    let at = place_m(edit, file);
    text.clear();
    let _ = write!(
        text,
        "{sequence:>6} {:<7} {:>8.1} {:>8.1} {:>6.1}",
        kind(edit),
        at.x,
        at.y,
        reach_m(edit, file)
    );
}

/// All that an edit says, a line each.
pub(super) fn describe(
    sequence: u64,
    is_active: bool,
    edit: &Edit,
    file: &ManifestFile,
) -> Vec<String> {
    let metres = |steps: i32| f64::from(steps) * file.height_step_m;
    let percent = |part: f64, whole: f64| 100.0 * part / whole;
    let at = place_m(edit, file);
    let undone = if is_active { "" } else { ", undone" };
    let mut lines = vec![
        format!("{} {sequence}{undone}", kind(edit)),
        format!("centre {:.2} m, {:.2} m (x, z)", at.x, at.y),
        format!("reach {:.2} m", reach_m(edit, file)),
    ];
    let mut say = |line: String| lines.push(line);
    let density = |density: u8| format!("density at least {:.0} %", percent(density.into(), 255.0));
    let scorched = |scorch: u8| format!("scorch {:.0} %", percent(scorch.into(), 255.0));
    let hard = |hardness: u8| format!("hardness {:.0} %", percent(hardness.into(), 255.0));
    let strong = |strength: u16| format!("strength {:.0} %", percent(strength.into(), 65535.0));
    let limits =
        |least: i32, most: i32| format!("changes by {:.2} to {:.2} m", metres(least), metres(most));
    match &edit.change {
        Change::Crater {
            depth,
            rim,
            bowl,
            roughness,
            seed,
            density: dense,
            scorch,
            may_clamp: _,
        } => {
            let bowl_m = reach_m(edit, file) * f64::from(*bowl) / 65536.0;
            say(format!("bowl's radius {bowl_m:.2} m"));
            say(format!("depth {:.2} m", metres((*depth).into())));
            say(format!("rim {:.2} m", metres((*rim).into())));
            say(format!(
                "roughness {:.0} %, seed {seed}",
                percent((*roughness).into(), 96.0)
            ));
            say(density(*dense));
            say(scorched(*scorch));
        }
        Change::Raise {
            by,
            hardness,
            density: dense,
            may_clamp: _,
        } => {
            say(format!("by {:.2} m", metres(*by)));
            say(hard(*hardness));
            say(density(*dense));
        }
        Change::Flatten {
            to,
            strength,
            hardness,
            least,
            most,
        } => {
            say(format!("to {:.2} m", file.height_m(*to)));
            say(strong(*strength));
            say(hard(*hardness));
            say(limits(*least, *most));
        }
        Change::Smooth {
            ground,
            strength,
            hardness,
            least,
            most,
        } => {
            let [x, z] = ground.size;
            say(format!("captured ground {x} x {z} points"));
            say(strong(*strength));
            say(hard(*hardness));
            say(limits(*least, *most));
        }
        Change::Stamp {
            image,
            by,
            turn,
            density: dense,
            scorch,
            may_clamp: _,
        } => {
            let [cos, sin] = turn.map(f64::from);
            say(format!("image {0} x {0}", image.side));
            say(format!("by {:.2} m", metres(*by)));
            say(format!("turned {:.1} degrees", sin.atan2(cos).to_degrees()));
            say(density(*dense));
            say(scorched(*scorch));
        }
    }
    lines
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::StampImage;

    fn raise(by: i32) -> Edit {
        Edit {
            centre: [640, 1280],
            reach: 320,
            change: Change::Raise {
                by,
                hardness: 255,
                density: 0,
                may_clamp: false,
            },
        }
    }

    #[test]
    fn the_list_is_newest_first_and_follows_the_log() {
        let file = crate::terrain::test_manifest_file([3000, 2000]);
        let mut log = EditLog::new(&file);
        let mut known = Known::default();
        for by in [1, -2, 3] {
            log.push(raise(by)).unwrap();
        }
        known.follow(&log, 1);
        assert_eq!(known.rows(), 3);
        assert_eq!(known.sequence(0), Some(3));
        assert_eq!(known.sequence(2), Some(1));
        assert_eq!(known.sequence(3), None);
        log.undo_last();
        log.undo_last();
        log.redo_last();
        log.undo_last();
        known.follow(&log, 1);
        assert_eq!((known.rows(), known.undone, known.redoable), (3, 2, 2));
        log.push(raise(4)).unwrap();
        known.follow(&log, 1);
        assert_eq!((known.rows(), known.undone, known.redoable), (4, 2, 0));
        assert_eq!(known.sequence(0), Some(8));
        let mut afresh = Known::default();
        afresh.follow(&log, 1);
        assert_eq!(afresh.edits, known.edits);
        assert_eq!(afresh.bytes, known.bytes);
        known.follow(&EditLog::new(&file), 2);
        assert_eq!((known.rows(), known.bytes), (0, 0));
    }

    #[test]
    fn an_image_that_stamps_share_is_counted_once() {
        let file = crate::terrain::test_manifest_file([3000, 2000]);
        let mut log = EditLog::new(&file);
        let stamp = Edit {
            change: Change::Stamp {
                image: StampImage::new(32, vec![7; 1024]).unwrap(),
                by: 100,
                turn: [16384, 0],
                density: 0,
                scorch: 0,
                may_clamp: false,
            },
            ..raise(0)
        };
        log.push(stamp.clone()).unwrap();
        log.push(stamp).unwrap();
        let mut known = Known::default();
        known.follow(&log, 1);
        let each = size_of::<EditRecord>() + size_of::<Edit>();
        assert_eq!(known.bytes, 2 * each + 2048);
    }

    #[test]
    fn a_row_says_number_kind_place_and_reach() {
        let file = crate::terrain::test_manifest_file([3000, 2000]);
        let mut row = String::from("before");
        write_row(&mut row, 12, &raise(-5), &file);
        let words: Vec<_> = row.split_whitespace().collect();
        assert_eq!(words, ["12", "Lower", "10.0", "20.0", "5.0"]);
        let all = describe(12, false, &raise(-5), &file).join("\n");
        assert!(all.contains("Lower 12, undone") && all.contains("hardness 100 %"));
        assert!(all.contains("by -0.25 m"), "{all}");
    }
}
