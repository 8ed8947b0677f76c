//! Why there is no part, or no whole of parts.

use super::super::BakeError;
use super::Shard;
use std::io;
use std::path::PathBuf;
use thiserror::Error;

/// Why a part of a bake can't be made, or parts can't be merged. Each message is a sentence that
/// names the part or the tile and the cause and says what to do about it. What is complete of a part
/// stays.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ShardError {
    /// What a whole bake fails of, too.
    #[error(transparent)]
    Bake(#[from] BakeError),
    /// There is no such shard.
    #[error(
        "there is no shard {number}/{count}: shards are counted from 1/N to N/N, and N is at most \
         65536"
    )]
    Shard {
        /// The shard's number.
        number: u32,
        /// How many there are said to be.
        count: u32,
    },
    /// A part's `part.ron` can't be read.
    #[error("{} can't be read: {reason}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
    /// A part's `part.ron` holds what no part does.
    #[error("{} can't be used: {reason}; bake the part again with --force", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A folder that was given as a part is none.
    #[error("{} is no part of a bake: there is no part.ron in it", path.display())]
    NotPart {
        /// The folder.
        path: PathBuf,
    },
    /// Something else stands where a part should go.
    #[error(
        "{} exists and is not a part of a bake, so nothing is written there; choose another --out",
        path.display()
    )]
    OutputNotPart {
        /// The output folder.
        path: PathBuf,
    },
    /// A part of another bake stands where a part should go.
    #[error(
        "{} holds a part of another bake: {difference}; choose another --out, or say --force to \
         replace it",
        path.display()
    )]
    OutputOther {
        /// The output folder.
        path: PathBuf,
        /// How the two differ.
        difference: String,
    },
    /// Another process bakes the same part.
    #[error(
        "{} is being baked by another process; wait for it, or choose another --out",
        path.display()
    )]
    Busy {
        /// The part's folder.
        path: PathBuf,
    },
    /// A file or folder of a part can't be written.
    #[error(
        "{} can't be written: {reason}; what is complete was kept, and the same command goes on \
         from there",
        path.display()
    )]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
    /// There is nothing to merge.
    #[error("no part is given; name the folders of all parts")]
    NoParts,
    /// Two parts are not of the same bake.
    #[error(
        "{} and {} are parts of different bakes: {difference}; bake one of them again",
        first.display(),
        other.display()
    )]
    Different {
        /// The first part given.
        first: PathBuf,
        /// The part that differs from it.
        other: PathBuf,
        /// How.
        difference: String,
    },
    /// A part is given twice.
    #[error(
        "shard {shard} is given twice, as {} and as {}; leave one of them out",
        first.display(),
        second.display()
    )]
    Double {
        /// Which one.
        shard: Shard,
        /// One of the two folders.
        first: PathBuf,
        /// The other one, or the same again.
        second: PathBuf,
    },
    /// A part isn't given.
    #[error("shard {shard} is missing; bake it with --shard {shard}, or name its folder too")]
    Missing {
        /// Which one; the first where there are several.
        shard: Shard,
    },
    /// A part isn't finished.
    #[error(
        "{} is not complete: {done} of its {rows} rows of tiles are done; run its bake with \
         --shard {shard} again, which goes on from there",
        path.display()
    )]
    Incomplete {
        /// The part's folder.
        path: PathBuf,
        /// Which shard it is.
        shard: Shard,
        /// Rows of tiles of the part's coarsest level that are done.
        done: u32,
        /// Rows of tiles of that level that the part has.
        rows: u32,
    },
    /// A tile of a part can't be used.
    #[error("{} can't be used: {reason}; run its bake with --shard {shard} again", path.display())]
    Tile {
        /// The tile's file.
        path: PathBuf,
        /// Which shard it belongs to.
        shard: Shard,
        /// What is wrong with it.
        reason: String,
    },
    /// Two neighbouring tiles differ in what both hold.
    #[error(
        "{} and its neighbour {} differ in {what} that both hold, so they come from different \
         sources or one was changed; bake shard {shard}{} again with --force",
        path.display(),
        neighbour.display(),
        other.map(|other| format!(" or {other}")).unwrap_or_default()
    )]
    Border {
        /// One tile's file.
        path: PathBuf,
        /// The other one's.
        neighbour: PathBuf,
        /// Heights or densities.
        what: &'static str,
        /// The shard that the first tile belongs to.
        shard: Shard,
        /// The shard that the neighbour belongs to, where it is another one.
        other: Option<Shard>,
    },
}
