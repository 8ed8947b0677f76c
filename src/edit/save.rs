//! Logs in files.
//!
//! ```text
//! offset  size  what
//!      0     8  magic, "TSREDIT\0"
//!      8     4  version
//!     12     4  stamp of the terrain
//!     16     8  size of the terrain: samples of level 0 in x and z
//!     24     8  length of the payload in bytes
//!     32     8  its length once inflated
//!     40     4  CRC-32 (IEEE) of bytes 0..40 and the payload
//!     44        payload: postcard, deflated
//! ```
//!
//! All numbers are little endian. The payload holds the records, whose sequence numbers follow from
//! their places, and the snapshots.

use super::compact::{EDITS_VERSION, RON_FORMAT, StoredOps, open_ops};
use super::{EditLog, TileSnapshot};
use crate::output::{OutputError, PartialFile, check_place, remove_leftovers};
use crate::tile::TileAddress;
use flate2::Compression;
use flate2::read::DeflateDecoder;
use flate2::write::DeflateEncoder;
use serde::{Deserialize, Serialize};
use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use thiserror::Error;

/// What a binary file of edits starts with.
const MAGIC: [u8; 8] = *b"TSREDIT\0";
const HEADER_LEN: usize = 44;
/// The most that a payload is taken to inflate by, beyond [`FREE_INFLATION`]. What deflates better is
/// stored without: a file that promises more is refused before any of it is inflated.
const MAX_RATIO: u64 = 64;
/// Bytes to which every payload may inflate.
const FREE_INFLATION: u64 = 1 << 20;
/// What files being written are called, for [`PartialFile`].
const PARTIAL: &str = "edits";

/// Why bytes or text are no log of edits. The messages don't name the file; [`EditFileError`] does.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[non_exhaustive]
pub enum EditFormatError {
    /// It starts like something else.
    #[error(
        "it starts with \"{}\" where a file of edits starts with \"{}\", or is RON with the format \
         \"{RON_FORMAT}\"; it is something else",
        found.escape_ascii(),
        MAGIC.escape_ascii()
    )]
    Magic {
        /// The first bytes, at most 8.
        found: Vec<u8>,
    },
    /// Written by another version of this crate.
    #[error(
        "it has version {found} where this program reads version {EDITS_VERSION}; load it with the \
         version that wrote it"
    )]
    Version {
        /// Version found.
        found: u32,
    },
    /// It is shorter or longer than its header says.
    #[error("it has {found} bytes where its header makes them {wanted}: it was cut off or damaged")]
    Length {
        /// Bytes found.
        found: u64,
        /// Bytes that belong there.
        wanted: u64,
    },
    /// The bytes changed since they were written.
    #[error(
        "its checksum is {found:08x} where its header says {wanted:08x}: it is damaged; take an \
         older save"
    )]
    Checksum {
        /// Checksum of the bytes found.
        found: u32,
        /// Checksum that the header promises.
        wanted: u32,
    },
    /// It promises more than its length can hold.
    #[error("its {stored} bytes can't hold the {promised} that it promises: it is no save of ours")]
    Inflation {
        /// Bytes of the payload.
        stored: u64,
        /// Bytes to which it is said to inflate.
        promised: u64,
    },
    /// What is stored can't be a log.
    #[error("it can't be understood: {0}")]
    Content(String),
}

/// Why edits can't be loaded or saved. Where saving failed, the last save still stands.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum EditFileError {
    /// The file can't be read.
    #[error("{} can't be read: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
    /// The file holds no edits.
    #[error("{} can't be loaded: {reason}", path.display())]
    Format {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: EditFormatError,
    },
    /// Nothing may be written there.
    #[error(transparent)]
    Place(#[from] OutputError),
    /// Something that isn't a save stands there.
    #[error(
        "{} is no file of edits, and is not replaced by one; remove it, or save under another name",
        path.display()
    )]
    NotEdits {
        /// The file.
        path: PathBuf,
    },
    /// The file can't be written.
    #[error("{} can't be saved: {reason}; what was saved there before is unchanged", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
}

/// The payload.
#[derive(Serialize, Deserialize)]
struct Payload {
    ops: StoredOps,
    snapshots: Vec<StoredSnapshot>,
}

#[derive(Serialize, Deserialize)]
struct StoredSnapshot {
    level: u8,
    x: u32,
    z: u32,
    sequence: u64,
    #[serde(with = "byte_string")]
    bytes: Vec<u8>,
}

/// Bytes as such, which are copied as a whole and not one by one.
mod byte_string {
    use serde::de::{Error, SeqAccess, Visitor};
    use serde::{Deserializer, Serializer};
    use std::fmt;

    pub(super) fn serialize<S: Serializer>(bytes: &[u8], serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_bytes(bytes)
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Vec<u8>, D::Error> {
        struct Bytes;
        impl<'de> Visitor<'de> for Bytes {
            type Value = Vec<u8>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("bytes")
            }

            fn visit_bytes<E: Error>(self, bytes: &[u8]) -> Result<Vec<u8>, E> {
                Ok(bytes.to_vec())
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut bytes: A) -> Result<Vec<u8>, A::Error> {
                let mut all = Vec::new();
                while let Some(byte) = bytes.next_element()? {
                    all.push(byte);
                }
                Ok(all)
            }
        }
        deserializer.deserialize_bytes(Bytes)
    }
}

fn u32_at(bytes: &[u8], at: usize) -> u32 {
    u32::from_le_bytes([bytes[at], bytes[at + 1], bytes[at + 2], bytes[at + 3]])
}

fn u64_at(bytes: &[u8], at: usize) -> u64 {
    u64::from(u32_at(bytes, at)) | u64::from(u32_at(bytes, at + 4)) << 32
}

/// What a good header says.
struct Header {
    stamp: u32,
    size: [u32; 2],
    payload: u64,
    inflated: u64,
}

impl Header {
    /// Reads the header of a file of `length` bytes from its first [`HEADER_LEN`], or from all
    /// where it is shorter.
    fn read(bytes: &[u8], length: u64) -> Result<Self, EditFormatError> {
        if !bytes.starts_with(&MAGIC) {
            return Err(EditFormatError::Magic {
                found: bytes[..bytes.len().min(MAGIC.len())].to_vec(),
            });
        }
        let short = |wanted| EditFormatError::Length {
            found: length,
            wanted,
        };
        if bytes.len() < HEADER_LEN {
            return Err(short(HEADER_LEN as u64));
        }
        let version = u32_at(bytes, 8);
        if version != EDITS_VERSION {
            return Err(EditFormatError::Version { found: version });
        }
        let header = Self {
            stamp: u32_at(bytes, 12),
            size: [u32_at(bytes, 16), u32_at(bytes, 20)],
            payload: u64_at(bytes, 24),
            inflated: u64_at(bytes, 32),
        };
        let wanted = header.payload.saturating_add(HEADER_LEN as u64);
        if length != wanted {
            return Err(short(wanted));
        }
        if header.inflated > most_inflated(header.payload) {
            return Err(EditFormatError::Inflation {
                stored: header.payload,
                promised: header.inflated,
            });
        }
        Ok(header)
    }
}

fn most_inflated(stored: u64) -> u64 {
    stored.saturating_mul(MAX_RATIO).max(FREE_INFLATION)
}

fn checksum(header: &[u8], payload: &[u8]) -> u32 {
    let mut hasher = crc32fast::Hasher::new();
    hasher.update(&header[..HEADER_LEN - 4]);
    hasher.update(payload);
    hasher.finalize()
}

fn deflate(bytes: &[u8], level: Compression) -> io::Result<Vec<u8>> {
    let mut encoder = DeflateEncoder::new(Vec::new(), level);
    encoder.write_all(bytes)?;
    encoder.finish()
}

/// Inflates what must be `wanted` bytes.
fn inflate(bytes: &[u8], wanted: u64) -> Result<Vec<u8>, EditFormatError> {
    let content = |reason: io::Error| EditFormatError::Content(reason.to_string());
    let mut decoder = DeflateDecoder::new(bytes);
    let mut inflated = Vec::new();
    // One more than promised, to see that there is no more.
    let mut limited = decoder.by_ref().take(wanted.saturating_add(1));
    limited.read_to_end(&mut inflated).map_err(content)?;
    let found = inflated.len() as u64;
    if found != wanted || decoder.total_in() != bytes.len() as u64 {
        return Err(EditFormatError::Content(format!(
            "it inflates to {found} bytes where it promises {wanted}"
        )));
    }
    Ok(inflated)
}

impl EditLog {
    /// The bytes of a binary file: the records and the snapshots. Images that several stamps share
    /// are stored once.
    #[must_use]
    pub fn encode(&self) -> Vec<u8> {
        let snapshots = self.snapshots().into_iter().map(|snapshot| {
            let TileAddress { level, x, z } = snapshot.address;
            StoredSnapshot {
                level,
                x,
                z,
                sequence: snapshot.sequence,
                bytes: snapshot.bytes.to_vec(),
            }
        });
        let payload = Payload {
            ops: StoredOps::pack(self.records().iter().map(|record| &record.op)),
            snapshots: snapshots.collect(),
        };
        let plain = postcard::to_stdvec(&payload).expect("memory takes all that is written to it");
        let deflated = |level| deflate(&plain, level).expect("memory takes all that is written");
        let mut stored = deflated(Compression::default());
        if plain.len() as u64 > most_inflated(stored.len() as u64) {
            stored = deflated(Compression::none());
        }
        let mut bytes = Vec::with_capacity(HEADER_LEN + stored.len());
        bytes.extend_from_slice(&MAGIC);
        for number in [EDITS_VERSION, self.stamp(), self.size()[0], self.size()[1]] {
            bytes.extend_from_slice(&number.to_le_bytes());
        }
        for length in [stored.len(), plain.len()] {
            bytes.extend_from_slice(&(length as u64).to_le_bytes());
        }
        bytes.extend_from_slice(&[0; 4]);
        let checksum = checksum(&bytes, &stored);
        bytes[HEADER_LEN - 4..].copy_from_slice(&checksum.to_le_bytes());
        bytes.extend_from_slice(&stored);
        bytes
    }

    /// Reads what [`encode`](Self::encode) wrote. Whatever the bytes promise, no more memory is taken
    /// than some hundred times their length.
    ///
    /// # Errors
    /// Where the bytes are cut off, damaged, of another format or version, promise more than they can
    /// hold, or hold records that can't follow each other.
    pub fn decode(bytes: &[u8]) -> Result<Self, EditFormatError> {
        let head = &bytes[..bytes.len().min(HEADER_LEN)];
        let header = Header::read(head, bytes.len() as u64)?;
        let stored = &bytes[HEADER_LEN..];
        let (found, wanted) = (checksum(head, stored), u32_at(head, HEADER_LEN - 4));
        if found != wanted {
            return Err(EditFormatError::Checksum { found, wanted });
        }
        let plain = inflate(stored, header.inflated)?;
        let (payload, rest): (Payload, _) = postcard::take_from_bytes(&plain)
            .map_err(|error| EditFormatError::Content(error.to_string()))?;
        if !rest.is_empty() {
            let reason = format!("{} bytes follow its end", rest.len());
            return Err(EditFormatError::Content(reason));
        }
        let mut log =
            open_ops(header.stamp, header.size, payload.ops).map_err(EditFormatError::Content)?;
        for snapshot in payload.snapshots {
            let StoredSnapshot { level, x, z, .. } = snapshot;
            // One that the log doesn't take would be made again.
            log.keep_snapshot(TileSnapshot {
                address: TileAddress::new(level, x, z),
                sequence: snapshot.sequence,
                bytes: snapshot.bytes.into(),
            });
        }
        Ok(log)
    }

    /// The log as readable RON, a record a line, without snapshots: these are bytes, and follow from
    /// the rest.
    #[must_use]
    pub fn to_ron(&self) -> String {
        let pretty = ron::ser::PrettyConfig::new().depth_limit(2);
        ron::ser::to_string_pretty(self, pretty).expect("text takes all that is written to it")
    }

    /// Reads what [`to_ron`](Self::to_ron) wrote, or somebody changed since.
    ///
    /// # Errors
    /// Where it isn't RON or not of this format, and where the records can't follow each other.
    pub fn from_ron(text: &str) -> Result<Self, EditFormatError> {
        ron::from_str(text).map_err(|error| EditFormatError::Content(error.to_string()))
    }

    /// Saves the log in a binary file, in place of an older save.
    ///
    /// The file is written beside, brought to the disk and renamed: whenever the program or the machine
    /// stops, `path` is the old save or the new one as a whole. What killed programs left half-written
    /// in the folder is removed. Takes as long as [`encode`](Self::encode) and the disk: clone the log
    /// and save it off the main thread.
    ///
    /// # Errors
    /// Where `path` names a folder or anything else that is no save, and where the file can't be
    /// written, because the disk is full for example. The old save is unchanged then.
    pub fn save(&self, path: &Path) -> Result<(), EditFileError> {
        write(path, || self.encode())
    }

    /// [`save`](Self::save) as [RON](Self::to_ron).
    ///
    /// # Errors
    /// As [`save`](Self::save).
    pub fn save_ron(&self, path: &Path) -> Result<(), EditFileError> {
        write(path, || self.to_ron().into_bytes())
    }

    /// Loads what [`save`](Self::save) or [`save_ron`](Self::save_ron) wrote. Whose terrain it is,
    /// [`check_terrain`](Self::check_terrain) tells.
    ///
    /// # Errors
    /// Where the file can't be read, and where it holds no log: see [`decode`](Self::decode). What is
    /// something else is refused by its first bytes, however long it is.
    pub fn load(path: &Path) -> Result<Self, EditFileError> {
        let unreadable = |reason| EditFileError::Read {
            path: path.to_owned(),
            reason,
        };
        let unusable = |reason| EditFileError::Format {
            path: path.to_owned(),
            reason,
        };
        let mut file = File::open(path).map_err(unreadable)?;
        let metadata = file.metadata().map_err(unreadable)?;
        if !metadata.is_file() {
            let reason = io::Error::other("it is no regular file");
            return Err(unreadable(reason));
        }
        let mut bytes = Vec::new();
        let start = (&file).take(START_LEN).read_to_end(&mut bytes);
        start.map_err(unreadable)?;
        let readable = is_ron(&bytes);
        if !readable {
            let head = &bytes[..bytes.len().min(HEADER_LEN)];
            Header::read(head, metadata.len()).map_err(unusable)?;
        }
        file.read_to_end(&mut bytes).map_err(unreadable)?;
        if !readable {
            return Self::decode(&bytes).map_err(unusable);
        }
        let text = String::from_utf8(bytes)
            .map_err(|_| unusable(EditFormatError::Content("it is not text".to_owned())))?;
        Self::from_ron(&text).map_err(unusable)
    }
}

/// Bytes by which a file is told from others.
const START_LEN: u64 = 512;

/// Whether a file is a readable log, as far as its start tells.
fn is_ron(start: &[u8]) -> bool {
    let format = RON_FORMAT.as_bytes();
    start.windows(format.len()).any(|window| window == format) && !start.starts_with(&MAGIC)
}

/// Whether a save may replace what stands there: an older save, even a damaged one, or nothing.
fn may_replace(path: &Path) -> io::Result<bool> {
    let mut start = Vec::new();
    File::open(path)?.take(START_LEN).read_to_end(&mut start)?;
    Ok(start.is_empty() || start.starts_with(&MAGIC) || is_ron(&start))
}

fn write(path: &Path, bytes: impl FnOnce() -> Vec<u8>) -> Result<(), EditFileError> {
    let failed = |reason| EditFileError::Write {
        path: path.to_owned(),
        reason,
    };
    // The file itself and not a link to it, which a rename would replace.
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    let place = check_place(&target, "save of edits")?;
    if place.metadata.is_some() && !may_replace(&target).map_err(failed)? {
        return Err(EditFileError::NotEdits {
            path: path.to_owned(),
        });
    }
    remove_leftovers(&place.folder, PARTIAL);
    let bytes = bytes();
    let (partial, mut file) = PartialFile::create(&place.folder, PARTIAL).map_err(failed)?;
    file.write_all(&bytes).map_err(failed)?;
    partial.publish(file, &target).map_err(failed)?;
    // A rename is on disk when its folder is. Not every system can sync a folder.
    let _ = File::open(&place.folder).and_then(|folder| folder.sync_all());
    Ok(())
}
