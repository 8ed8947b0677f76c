//! Why an archive can't be read or written.

use super::RangeError;
use crate::bake::BakeError;
use crate::output::OutputError;
use crate::terrain::ManifestError;
use crate::tile::TileAddress;
use std::io;
use std::path::PathBuf;
use thiserror::Error;

/// Why there is no archive, or no tile in it. Each message is a sentence that names the file and the
/// cause and says what can be done.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum ArchiveError {
    /// Bytes can't be read.
    #[error(transparent)]
    Read(#[from] RangeError),
    /// It is another format's file.
    #[error(
        "{name} is no terrain archive: it starts with \"{}\" where a PMTiles archive starts with \
         \"PMTiles\"; give a file that `tessera pack` made",
        found.escape_ascii()
    )]
    Magic {
        /// The archive.
        name: String,
        /// The bytes found.
        found: Vec<u8>,
    },
    /// A PMTiles archive of another version.
    #[error("{name} is a PMTiles archive of version {found} where this program reads version 3")]
    PmTilesVersion {
        /// The archive.
        name: String,
        /// Version found.
        found: u8,
    },
    /// A PMTiles archive of something else.
    #[error(
        "{name} is a PMTiles archive, but of no terrain: perhaps a map; give a file that `tessera pack` made"
    )]
    NoTerrain {
        /// The archive.
        name: String,
    },
    /// A terrain's archive, written by another version of this crate.
    #[error(
        "{name} has archive format {found} where this program reads format {wanted}; pack the \
         terrain again"
    )]
    Format {
        /// The archive.
        name: String,
        /// Format found.
        found: u64,
        /// Format that this crate reads.
        wanted: u64,
    },
    /// Its bytes contradict each other, or aren't those that were written.
    #[error("{name} is damaged: {reason}; pack the terrain again")]
    Damaged {
        /// The archive.
        name: String,
        /// What is wrong with it.
        reason: String,
    },
    /// Its manifest or its index can't be used.
    #[error("{name} is no terrain that can be used: {reason}")]
    Manifest {
        /// The archive, or the folder that should have been packed.
        name: String,
        /// What is wrong with it.
        reason: Box<ManifestError>,
    },
    /// The index has a tile that the directory lacks.
    #[error("{name} lacks tile {address}, which its index has; pack the terrain again")]
    MissingTile {
        /// The archive.
        name: String,
        /// The tile.
        address: TileAddress,
    },
    /// A tile can't be used.
    #[error("tile {address} of {name} can't be used: {reason}")]
    Tile {
        /// The archive, or the folder that should have been packed.
        name: String,
        /// The tile.
        address: TileAddress,
        /// What is wrong with it.
        reason: String,
    },
    /// Nothing may be written at that path.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The path's name is no archive's.
    #[error("{} is no name for a terrain archive; give --out a name that ends in .pmtiles", path.display())]
    OutputExtension {
        /// The path.
        path: PathBuf,
    },
    /// Something stands where the archive should go.
    #[error("{} exists already; choose another --out, or say --force to replace it", path.display())]
    OutputExists {
        /// The path.
        path: PathBuf,
    },
    /// Something that isn't a terrain's archive stands where it should go.
    #[error(
        "{} exists and is no terrain archive, so --force doesn't replace it; choose another --out",
        path.display()
    )]
    OutputNotArchive {
        /// The path.
        path: PathBuf,
    },
    /// A file or folder can't be written.
    #[error("{} can't be written: {reason}; nothing was left behind", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
    /// The terrain to be archived can't be baked, or that of an archive can't be put in a folder.
    #[error(transparent)]
    Bake(#[from] Box<BakeError>),
}

impl From<BakeError> for ArchiveError {
    fn from(error: BakeError) -> Self {
        Self::Bake(Box::new(error))
    }
}
