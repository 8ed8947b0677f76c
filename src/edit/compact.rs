//! How logs are stored and sent: images once, captured heights as differences.

use super::check::image_key;
use super::{Change, Edit, EditDiff, EditLog, EditOp, StampImage};
use serde::{Deserialize, Serialize};
use std::collections::HashMap;
use std::sync::Arc;

/// What `format` says in a readable log.
pub(super) const RON_FORMAT: &str = "tessera-edits";
/// The version of stored logs, binary and readable, that this crate writes and reads.
pub(super) const EDITS_VERSION: u32 = 1;

/// Records whose stamps name their images by number.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
pub(super) struct StoredOps {
    images: Vec<StampImage>,
    ops: Vec<StoredOp>,
}

#[derive(Clone, Debug, Serialize, Deserialize)]
enum StoredOp {
    /// An edit whose change is as it is.
    Apply {
        centre: [i32; 2],
        reach: u32,
        change: Change,
    },
    /// An edit by an image stamp; `image` is a number in [`StoredOps::images`].
    Stamp {
        centre: [i32; 2],
        reach: u32,
        image: u32,
        by: i32,
        turn: [i16; 2],
        density: u8,
        scorch: u8,
        may_clamp: bool,
    },
    Undo(u64),
    Redo(u64),
}

impl StoredOps {
    pub(super) fn pack<'a>(ops: impl Iterator<Item = &'a EditOp>) -> Self {
        let mut packed = Self::default();
        // Images that share their samples are equal without a look at these.
        let mut known: HashMap<(usize, u16), u32> = HashMap::new();
        let mut equal: HashMap<&StampImage, u32> = HashMap::new();
        for op in ops {
            let stored = match op {
                &EditOp::Undo(sequence) => StoredOp::Undo(sequence),
                &EditOp::Redo(sequence) => StoredOp::Redo(sequence),
                EditOp::Apply(edit) => {
                    let Edit {
                        centre,
                        reach,
                        change,
                    } = &**edit;
                    let (centre, reach) = (*centre, *reach);
                    match change {
                        Change::Stamp {
                            image,
                            by,
                            turn,
                            density,
                            scorch,
                            may_clamp,
                        } => {
                            let number = *known.entry(image_key(image)).or_insert_with(|| {
                                *equal.entry(image).or_insert_with(|| {
                                    packed.images.push(image.clone());
                                    (packed.images.len() - 1) as u32
                                })
                            });
                            StoredOp::Stamp {
                                centre,
                                reach,
                                image: number,
                                by: *by,
                                turn: *turn,
                                density: *density,
                                scorch: *scorch,
                                may_clamp: *may_clamp,
                            }
                        }
                        change => StoredOp::Apply {
                            centre,
                            reach,
                            change: change.clone(),
                        },
                    }
                }
            };
            packed.ops.push(stored);
        }
        packed
    }

    /// What was packed; says what is wrong where a stamp names an image that isn't there.
    pub(super) fn unpack(self) -> Result<Vec<EditOp>, String> {
        let Self { images, ops } = self;
        let apply = |centre, reach, change| {
            EditOp::Apply(Arc::new(Edit {
                centre,
                reach,
                change,
            }))
        };
        let unpack = |op| {
            Ok(match op {
                StoredOp::Undo(sequence) => EditOp::Undo(sequence),
                StoredOp::Redo(sequence) => EditOp::Redo(sequence),
                StoredOp::Apply {
                    centre,
                    reach,
                    change,
                } => apply(centre, reach, change),
                StoredOp::Stamp {
                    centre,
                    reach,
                    image,
                    by,
                    turn,
                    density,
                    scorch,
                    may_clamp,
                } => {
                    let number = image;
                    let image = images.get(number as usize).cloned().ok_or_else(|| {
                        format!(
                            "it names image {number} of {}; it is damaged or was written wrongly",
                            images.len()
                        )
                    })?;
                    let change = Change::Stamp {
                        image,
                        by,
                        turn,
                        density,
                        scorch,
                        may_clamp,
                    };
                    apply(centre, reach, change)
                }
            })
        };
        ops.into_iter().map(unpack).collect()
    }
}

/// The serde form of [`EditDiff`].
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct StoredDiff {
    stamp: u32,
    since: u64,
    records: StoredOps,
}

impl From<EditDiff> for StoredDiff {
    fn from(diff: EditDiff) -> Self {
        Self {
            stamp: diff.stamp,
            since: diff.since,
            records: StoredOps::pack(diff.ops.iter()),
        }
    }
}

impl TryFrom<StoredDiff> for EditDiff {
    type Error = String;

    fn try_from(stored: StoredDiff) -> Result<Self, String> {
        Ok(Self {
            stamp: stored.stamp,
            since: stored.since,
            ops: stored.records.unpack()?,
        })
    }
}

/// The serde form of [`EditLog`], which is that of readable logs.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct StoredLog {
    format: String,
    version: u32,
    stamp: u32,
    size: [u32; 2],
    images: Vec<StampImage>,
    records: Vec<StoredOp>,
}

impl Serialize for EditLog {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        let packed = StoredOps::pack(self.records().iter().map(|record| &record.op));
        let stored = StoredLog {
            format: RON_FORMAT.to_owned(),
            version: EDITS_VERSION,
            stamp: self.stamp(),
            size: self.size(),
            images: packed.images,
            records: packed.ops,
        };
        stored.serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for EditLog {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let stored = StoredLog::deserialize(deserializer)?;
        stored.open().map_err(serde::de::Error::custom)
    }
}

impl StoredLog {
    fn open(self) -> Result<EditLog, String> {
        if self.format != RON_FORMAT {
            let found: String = self.format.chars().take(40).collect();
            return Err(format!(
                "its format is {found:?} where \"{RON_FORMAT}\" is wanted"
            ));
        }
        if self.version != EDITS_VERSION {
            return Err(format!(
                "it has version {} where this program reads version {EDITS_VERSION}",
                self.version
            ));
        }
        let ops = StoredOps {
            images: self.images,
            ops: self.records,
        };
        open_ops(self.stamp, self.size, ops)
    }
}

/// The log that the records make.
pub(super) fn open_ops(stamp: u32, size: [u32; 2], ops: StoredOps) -> Result<EditLog, String> {
    let mut log = EditLog::of_stamp(stamp, size);
    let diff = EditDiff {
        stamp,
        since: 0,
        ops: ops.unpack()?,
    };
    log.merge(diff).map_err(|error| error.to_string())?;
    Ok(log)
}

/// Edits behind an `Arc` are stored as themselves.
pub(super) mod shared_edit {
    use super::{Arc, Deserialize, Edit, Serialize};
    use serde::{Deserializer, Serializer};

    pub(in super::super) fn serialize<S: Serializer>(
        edit: &Arc<Edit>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        (**edit).serialize(serializer)
    }

    pub(in super::super) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Arc<Edit>, D::Error> {
        Edit::deserialize(deserializer).map(Arc::new)
    }
}

/// Sixteen bits, with a sign or without.
pub(super) trait Sixteen: Copy {
    fn bits(self) -> u16;
    fn of(bits: u16) -> Self;
}

impl Sixteen for u16 {
    fn bits(self) -> u16 {
        self
    }

    fn of(bits: u16) -> Self {
        bits
    }
}

impl Sixteen for i16 {
    fn bits(self) -> u16 {
        self.cast_unsigned()
    }

    fn of(bits: u16) -> Self {
        bits.cast_signed()
    }
}

/// Slices of samples are stored as the differences between one and the next, which take a byte
/// where the ground is smooth; where people read it, as they are.
pub(super) mod samples {
    use super::{Arc, Deserialize, Serialize, Sixteen};
    use serde::{Deserializer, Serializer};

    pub(in super::super) fn serialize<T: Sixteen + Serialize, S: Serializer>(
        samples: &Arc<[T]>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        if serializer.is_human_readable() {
            return (**samples).serialize(serializer);
        }
        let mut before = 0_u16;
        serializer.collect_seq(samples.iter().map(|sample| {
            let by = sample.bits().wrapping_sub(before);
            before = sample.bits();
            by.cast_signed()
        }))
    }

    pub(in super::super) fn deserialize<'de, T, D>(deserializer: D) -> Result<Arc<[T]>, D::Error>
    where
        T: Sixteen + Deserialize<'de>,
        D: Deserializer<'de>,
    {
        if deserializer.is_human_readable() {
            return Vec::deserialize(deserializer).map(Into::into);
        }
        let differences: Vec<i16> = Vec::deserialize(deserializer)?;
        let mut sample = 0_u16;
        let sum = differences.into_iter().map(|by| {
            sample = sample.wrapping_add(by.cast_unsigned());
            T::of(sample)
        });
        Ok(sum.collect())
    }
}
