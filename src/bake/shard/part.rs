//! A part's folder and what `part.ron` says of it.

use super::{Shard, ShardError};
use crate::terrain::ManifestFile;
use crate::tile::TileAddress;
use serde::{Deserialize, Serialize};
use std::fs::{self, File};
use std::io::{self, Write};
use std::ops::Range;
use std::path::Path;

/// Name of the file that says what a part is.
pub const PART_FILE: &str = "part.ron";
/// What the file's `format` field must say.
pub const PART_MAGIC: &str = "tessera-part";
/// The version of parts that this crate writes and reads.
pub const PART_VERSION: u32 = 1;

/// Held while a part is baked, so that no two processes write it.
const LOCK_FILE: &str = "part.lock";
/// Where `part.ron` is written before it takes the old one's place.
const NEW_FILE: &str = "part.ron.new";
/// No `part.ron` is longer: some hundred bytes, and some for every row of tiles.
const MAX_FILE_BYTES: u64 = 1 << 20;

/// The coarsest level that a part has at most. The levels above take a 1024th of the work; what a
/// part reads around its own rows doubles with every level.
const MAX_TOP: u8 = 4;
/// Rows of tiles of its coarsest level that a part has at least, where there are enough of them: what
/// it reads around its own rows is then at most a fifth of them, unless densities spread far.
const MIN_ROWS: u32 = 8;

/// Describes a part of a bake and how far it is; stored as `part.ron` in the part's folder.
///
/// All numbers that tiles depend on are in it, so that two parts with equal ones fit together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[non_exhaustive]
pub struct PartFile {
    /// Always [`PART_MAGIC`].
    pub format: String,
    /// Version of the format, [`PART_VERSION`].
    pub version: u32,
    /// Version of the crate that baked it: another one's tiles may differ.
    pub program: String,
    /// Which part it is.
    pub shard: Shard,
    /// The part's coarsest level: its tiles and all below them are in the part.
    pub top: u8,
    /// The whole terrain's manifest, without the checksum of an index.
    pub terrain: ManifestFile,
    /// Heights in metres that the stored 0 and 65535 stand for.
    pub height_range_m: (f64, f64),
    /// The whole source's lowest and highest height in metres, where they were looked for.
    pub source_range_m: Option<(f64, f64)>,
    /// Samples of the whole source without data.
    pub filled: u64,
    /// Side in samples of the blocks from which they were filled.
    pub fill_block: u32,
    /// CRC-32 of the source's first row in metres (`f32`, little endian): tells sources, and ways to
    /// read them, apart.
    pub source_crc32: u32,
    /// Samples that were clamped, in every row of tiles of level `top` that is complete.
    pub clamped: Vec<u64>,
}

impl PartFile {
    /// Reads what lies in the part's folder `dir`.
    ///
    /// # Errors
    /// Where there is no part, or its file can't be read or understood.
    pub fn read(dir: &Path) -> Result<Self, ShardError> {
        let path = dir.join(PART_FILE);
        let invalid = |reason: String| ShardError::Invalid {
            path: path.clone(),
            reason,
        };
        let failed = |reason: io::Error| match reason.kind() {
            io::ErrorKind::NotFound | io::ErrorKind::NotADirectory => ShardError::NotPart {
                path: dir.to_owned(),
            },
            _ => ShardError::Read {
                path: path.clone(),
                reason,
            },
        };
        let length = fs::metadata(&path).map_err(failed)?.len();
        if length > MAX_FILE_BYTES {
            return Err(invalid(format!(
                "it has {length} bytes where at most {MAX_FILE_BYTES} belong"
            )));
        }
        let bytes = fs::read(&path).map_err(failed)?;
        let text = String::from_utf8(bytes).map_err(|_| invalid("it is not text".to_owned()))?;
        let file: Self = ron::from_str(&text).map_err(|error| invalid(error.to_string()))?;
        file.validate().map_err(invalid)?;
        Ok(file)
    }

    fn validate(&self) -> Result<(), String> {
        if self.format != PART_MAGIC {
            let found: String = self.format.chars().take(40).collect();
            return Err(format!("it has the format {found:?}, not {PART_MAGIC:?}"));
        }
        if self.version != PART_VERSION {
            return Err(format!(
                "it has version {} where this program reads version {PART_VERSION}",
                self.version
            ));
        }
        self.shard.validate().map_err(|error| error.to_string())?;
        self.terrain.validate().map_err(|error| error.to_string())?;
        let wanted = top_level(&self.terrain, self.shard.count);
        if self.top != wanted {
            return Err(format!(
                "its coarsest level is {} where it should be {wanted}",
                self.top
            ));
        }
        let (rows, done) = (self.rows().len(), self.clamped.len());
        if done > rows {
            return Err(format!("it has {done} rows of tiles where {rows} belong"));
        }
        Ok(())
    }

    /// Rows of tiles of level [`top`](Self::top) that the part has when it is complete; empty where
    /// there are more shards than rows.
    #[must_use]
    pub fn rows(&self) -> Range<u32> {
        let all = u64::from(self.terrain.tiles(self.top)[1]);
        let until = |shard: u32| (all * u64::from(shard) / u64::from(self.shard.count)) as u32;
        until(self.shard.number - 1)..until(self.shard.number)
    }

    /// Those of them that are complete, with all tiles below.
    #[must_use]
    pub fn rows_done(&self) -> Range<u32> {
        let start = self.rows().start;
        start..start + self.clamped.len() as u32
    }

    /// Whether there is nothing left to do.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.rows_done() == self.rows()
    }

    /// Rows of tiles of `level` in rows `rows` of level `top`.
    pub(super) fn tile_rows(&self, level: u8, rows: &Range<u32>) -> Range<u32> {
        let up = self.top - level;
        let all = self.terrain.tiles(level)[1];
        (rows.start << up).min(all)..(rows.end << up).min(all)
    }

    /// All tiles in rows `rows` of level `top`, and below.
    pub(super) fn addresses(&self, rows: &Range<u32>) -> impl Iterator<Item = TileAddress> {
        (0..=self.top).flat_map(move |level| {
            let columns = self.terrain.tiles(level)[0];
            self.tile_rows(level, rows)
                .flat_map(move |z| (0..columns).map(move |x| TileAddress::new(level, x, z)))
        })
    }

    /// How this part's bake differs from another's, as a sentence, whichever shards they are.
    pub(super) fn difference(&self, other: &Self) -> Option<String> {
        let (a, b) = (&self.terrain, &other.terrain);
        let pair = |what: &str, a: &dyn std::fmt::Debug, b: &dyn std::fmt::Debug| {
            Some(format!("{what} differ ({a:?} and {b:?})"))
        };
        if self.program != other.program {
            return pair("the programs' versions", &self.program, &other.program);
        }
        if self.shard.count != other.shard.count {
            let (a, b) = (self.shard.count, other.shard.count);
            return pair("the numbers of shards", &a, &b);
        }
        if a.size != b.size {
            return pair("their sizes in samples", &a.size, &b.size);
        }
        if a.spacing_m != b.spacing_m {
            let what = "the metres between their samples";
            return pair(what, &a.spacing_m, &b.spacing_m);
        }
        if a.density != b.density {
            return Some("their density settings differ".to_owned());
        }
        let heights = |file: &Self| (file.height_range_m, file.terrain.clone());
        if heights(self) != heights(other) {
            let (a, b) = (self.height_range_m, other.height_range_m);
            return pair("the heights in metres that they can store", &a, &b);
        }
        let facts = |file: &Self| {
            let Self {
                source_range_m,
                filled,
                fill_block,
                source_crc32,
                ..
            } = *file;
            (source_range_m, filled, fill_block, source_crc32)
        };
        (facts(self) != facts(other))
            .then(|| "their sources, or the numbers by which those were read, differ".to_owned())
    }

    /// How the two can't be the same part of the same bake.
    pub(super) fn difference_of_part(&self, other: &Self) -> Option<String> {
        let (a, b) = (self.shard, other.shard);
        if a.count == b.count && a.number != b.number {
            return Some(format!("it is shard {a} where {b} is wanted"));
        }
        self.difference(other)
    }

    /// Puts the file into the part's folder, as a whole or not at all.
    pub(super) fn write(&self, dir: &Path) -> Result<(), ShardError> {
        let path = dir.join(PART_FILE);
        let new = dir.join(NEW_FILE);
        let write = || -> io::Result<()> {
            let pretty = ron::ser::PrettyConfig::default().compact_arrays(true);
            let text = ron::ser::to_string_pretty(self, pretty).map_err(io::Error::other)?;
            let mut file = File::create(&new)?;
            file.write_all(text.as_bytes())?;
            // Tiles can be told from what a power failure left of them; this file is needed for it.
            file.sync_all()?;
            drop(file);
            fs::rename(&new, &path)
        };
        write().map_err(|reason| {
            let _ = fs::remove_file(&new);
            ShardError::Write { path, reason }
        })
    }
}

/// The coarsest level of parts of which there are `count`.
pub(super) fn top_level(terrain: &ManifestFile, count: u32) -> u8 {
    let enough =
        |level: &u8| u64::from(terrain.tiles(*level)[1]) >= u64::from(MIN_ROWS) * u64::from(count);
    (1..terrain.levels.min(MAX_TOP + 1))
        .take_while(enough)
        .last()
        .unwrap_or(0)
}

/// Whether a part may be put into the folder `out`, and the one that is there.
pub(super) fn check_output(out: &Path, force: bool) -> Result<Option<PartFile>, ShardError> {
    let Ok(metadata) = fs::symlink_metadata(out) else {
        return Ok(None);
    };
    let refused = || ShardError::OutputNotPart {
        path: out.to_owned(),
    };
    let metadata = if metadata.is_symlink() {
        fs::metadata(out).map_err(|_| refused())?
    } else {
        metadata
    };
    if !metadata.is_dir() || out.join(crate::terrain::MANIFEST_FILE).exists() {
        return Err(refused());
    }
    match PartFile::read(out) {
        Ok(part) => Ok(Some(part)),
        // What can't be understood may be replaced, since a part it is.
        Err(ShardError::Invalid { .. }) if force => Ok(None),
        Err(ShardError::NotPart { .. }) => {
            let entries = fs::read_dir(out).map_err(|reason| ShardError::Read {
                path: out.to_owned(),
                reason,
            })?;
            let foreign = |name: &std::ffi::OsStr| name != LOCK_FILE && name != NEW_FILE;
            let mut names = entries.flatten().map(|entry| entry.file_name());
            if names.any(|name| foreign(&name)) {
                return Err(refused());
            }
            Ok(None)
        }
        Err(error) => Err(error),
    }
}

/// Makes the part's folder and keeps other processes out of it until the file is dropped, or its
/// process is killed.
pub(super) fn lock(out: &Path) -> Result<File, ShardError> {
    let failed = |path: &Path| {
        let path = path.to_owned();
        |reason| ShardError::Write { path, reason }
    };
    fs::create_dir_all(out).map_err(failed(out))?;
    let path = out.join(LOCK_FILE);
    let file = File::options()
        .write(true)
        .create(true)
        .truncate(false)
        .open(&path)
        .map_err(failed(&path))?;
    match file.try_lock() {
        Err(fs::TryLockError::WouldBlock) => Err(ShardError::Busy {
            path: out.to_owned(),
        }),
        // Some network file systems have no locks: there, schedulers have to start a shard once.
        Ok(()) | Err(fs::TryLockError::Error(_)) => Ok(file),
    }
}
