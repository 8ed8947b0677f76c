//! A whole terrain in one file.
//!
//! An archive is a [PMTiles](https://docs.protomaps.com/pmtiles/) file of version 3: tiles one after
//! the other, equal ones once, and directories that say where each lies. Whoever has an address
//! reads one range of bytes, from a disk or from a web server that knows nothing of terrains. Tiles
//! are [packed](crate::tile::TerrainTile::pack) losslessly, so that a folder that was packed and
//! unpacked again is the same folder, byte for byte.
//!
//! Zoom `z` holds the tiles of level `levels - 1 - z`, column and row their `x` and `z`. Manifest
//! and index lie in the metadata, under the key `bevy_tessera`:
//!
//! ```json
//! { "name": "…", "bevy_tessera": { "format": 1, "manifest": "(format: …", "index": "base64…" } }
//! ```

mod error;
#[cfg(feature = "http")]
mod http;
mod layout;
mod pack;
mod range;
mod writer;

pub use error::ArchiveError;
#[cfg(feature = "http")]
pub use http::{
    FOLDER_FILE_LIMIT, HttpClient, HttpFolder, HttpRange, HttpSettings, HttpSettingsError,
    WHOLE_ANSWER_LIMIT,
};
pub use pack::{ArchiveReport, bake_archive, unpack_archive, write_archive};
pub use range::{FileRange, RangeError, RangeSource};
pub use writer::{ArchiveWriter, tile_order};

use crate::terrain::{MAX_LEVELS, TerrainManifest};
use crate::tile::TileAddress;
use base64::Engine;
use base64::engine::general_purpose::STANDARD as BASE64;
use layout::{Directory, HEADER_LEN, Header, HeaderFault, START_LEN, Section, tile_number};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

/// What an archive's file name ends in.
pub const ARCHIVE_EXTENSION: &str = "pmtiles";
/// Version of what the metadata holds under the key `bevy_tessera`.
pub const ARCHIVE_FORMAT: u64 = 1;

/// The most bytes of metadata: index and manifest of the largest terrain take 8 MiB.
const MAX_METADATA_LEN: usize = 32 << 20;
/// The most bytes of a packed leaf directory, and of a tile. Whole tiles take 45 kB, whatever packs
/// them some bytes more where nothing can be gained.
const MAX_LEAF_LEN: u32 = 16 << 20;
const MAX_TILE_LEN: u32 = 1 << 16;
/// Entries of leaf directories that are kept, 24 bytes each.
const KEPT_ENTRIES: usize = 1 << 18;

/// What the metadata holds of a terrain.
#[derive(Serialize, Deserialize)]
struct TerrainMetadata {
    format: u64,
    #[serde(default)]
    manifest: String,
    #[serde(default)]
    index: String,
}

/// A terrain in one file, of which tiles are read by range.
///
/// Holds the index twice (as it was stored, and ready for look-ups), the root directory, and the leaf
/// directories used last, at most 6 MiB of them. Any number of threads may read at once.
pub struct TerrainArchive {
    source: Box<dyn RangeSource>,
    header: Header,
    root: Directory,
    leaves: Mutex<VecDeque<(u64, Arc<Directory>)>>,
    ron: String,
    index: Vec<u8>,
    terrain: TerrainManifest,
}

impl std::fmt::Debug for TerrainArchive {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let name = self.source.name();
        f.debug_tuple("TerrainArchive").field(&name).finish()
    }
}

impl TerrainArchive {
    /// Opens an archive: reads header, root directory, manifest and index, and the last byte, so that
    /// a truncated one is found out. Three or four reads.
    ///
    /// # Errors
    /// Where bytes can't be read, where they are no PMTiles archive of version 3 or one of something
    /// else than a terrain, and where they contradict each other.
    pub fn open(source: impl RangeSource) -> Result<Self, ArchiveError> {
        let source: Box<dyn RangeSource> = Box::new(source);
        let name = source.name();
        let damaged = |reason: String| ArchiveError::Damaged {
            name: name.clone(),
            reason,
        };
        let start = match source.read_at(0, START_LEN) {
            // Smaller than what other archives start with.
            Err(RangeError::Short { .. }) => read_small(&*source)?,
            start => start?,
        };
        let header = Header::decode(&start).map_err(|fault| match fault {
            HeaderFault::Magic => ArchiveError::Magic {
                name: name.clone(),
                found: start.iter().copied().take(8).collect(),
            },
            HeaderFault::Version(found) => ArchiveError::PmTilesVersion {
                name: name.clone(),
                found,
            },
            HeaderFault::Other => ArchiveError::NoTerrain { name: name.clone() },
            HeaderFault::Damaged(reason) => damaged(reason.to_owned()),
        })?;
        // Before anything is believed that the header promises.
        source.read_at(header.end().saturating_sub(1), 1)?;
        let root = match part(&start, header.root) {
            Some(root) => root.to_owned(),
            None => source.read_at(header.root.offset, header.root.length as usize)?,
        };
        let root = header
            .directory(root)
            .map_err(|reason| damaged(format!("of its root directory, {reason}")))?;

        if header.metadata.length > MAX_METADATA_LEN as u64 {
            return Err(ArchiveError::NoTerrain { name });
        }
        let metadata = source.read_at(header.metadata.offset, header.metadata.length as usize)?;
        let metadata = header
            .unpack(metadata, MAX_METADATA_LEN)
            .map_err(|reason| damaged(format!("of its metadata, {reason}")))?;
        let metadata: serde_json::Value = serde_json::from_slice(&metadata)
            .map_err(|error| damaged(format!("its metadata is no JSON: {error}")))?;
        let Some(terrain) = metadata.get("bevy_tessera") else {
            return Err(ArchiveError::NoTerrain { name });
        };
        let found = TerrainMetadata::deserialize(terrain)
            .map_err(|error| damaged(format!("its metadata can't be understood: {error}")))?;
        if found.format != ARCHIVE_FORMAT {
            return Err(ArchiveError::Format {
                name,
                found: found.format,
                wanted: ARCHIVE_FORMAT,
            });
        }
        let index = BASE64
            .decode(&found.index)
            .map_err(|error| damaged(format!("its index can't be understood: {error}")))?;
        let terrain = TerrainManifest::decode(&found.manifest, &index).map_err(|reason| {
            ArchiveError::Manifest {
                name: name.clone(),
                reason: Box::new(reason),
            }
        })?;
        let stored = terrain.index.iter().count() as u64;
        if header.addressed != stored {
            let addressed = header.addressed;
            return Err(damaged(format!(
                "it has {addressed} tiles where its index has {stored}"
            )));
        }
        if header.zooms != [0, terrain.file.levels - 1] {
            return Err(damaged("its zooms are not its terrain's levels".to_owned()));
        }
        Ok(Self {
            source,
            header,
            root,
            leaves: Mutex::default(),
            ron: found.manifest,
            index,
            terrain,
        })
    }

    /// Opens the archive in the file at `path`.
    ///
    /// # Errors
    /// Those of [`open`](Self::open).
    pub fn open_file(path: &Path) -> Result<Self, ArchiveError> {
        Self::open(FileRange::open(path)?)
    }

    /// What `terrain.ron` and `tiles.index` of the terrain's folder hold.
    #[must_use]
    pub fn manifest(&self) -> (&str, &[u8]) {
        (&self.ron, &self.index)
    }

    /// The terrain's manifest and the index of its tiles.
    #[must_use]
    pub const fn terrain(&self) -> &TerrainManifest {
        &self.terrain
    }

    /// What the archive is called in messages.
    #[must_use]
    pub fn name(&self) -> String {
        self.source.name()
    }

    /// Bytes of the whole file.
    #[must_use]
    pub fn length(&self) -> u64 {
        self.header.end()
    }

    /// The bytes of a tile as they are stored, for
    /// [`TerrainTile::decode`](crate::tile::TerrainTile::decode); `None` where the index has no such
    /// tile. One read, and another for a leaf directory that hasn't been used for long.
    ///
    /// The bytes themselves are not looked at: their checksum and stamp tell the reader whether the
    /// file was replaced meanwhile.
    ///
    /// # Errors
    /// Where bytes can't be read, where directories contradict themselves or the index, and where the
    /// file was replaced by another while it is open.
    pub fn tile(&self, address: TileAddress) -> Result<Option<Vec<u8>>, ArchiveError> {
        if self.terrain.index.get(address).is_none() {
            return Ok(None);
        }
        let missing = || ArchiveError::MissingTile {
            name: self.name(),
            address,
        };
        let number = tile_number(self.terrain.file.levels, address).ok_or_else(missing)?;
        let mut entry = self.root.find(number).ok_or_else(missing)?;
        // The format has leaves below leaves for no terrain's number of tiles; other writers may.
        let mut depth = 0;
        while entry.run == 0 {
            depth += 1;
            if depth > 3 {
                return Err(self.damaged("its directories lead in a circle".to_owned()));
            }
            let leaf = self.leaf(entry.offset, entry.length)?;
            entry = leaf.find(number).ok_or_else(missing)?;
        }
        let place = self.header.tiles.part(entry.offset, entry.length.into());
        let place = place.filter(|_| entry.length <= MAX_TILE_LEN);
        let place = place.ok_or_else(|| {
            self.damaged(format!(
                "its directory places tile {address} beyond its tiles"
            ))
        })?;
        Ok(Some(
            self.source.read_at(place.offset, place.length as usize)?,
        ))
    }

    fn damaged(&self, reason: String) -> ArchiveError {
        ArchiveError::Damaged {
            name: self.name(),
            reason,
        }
    }

    /// A leaf directory, from memory where it was used before.
    fn leaf(&self, offset: u64, length: u32) -> Result<Arc<Directory>, ArchiveError> {
        let lock = || self.leaves.lock().unwrap_or_else(PoisonError::into_inner);
        {
            let mut kept = lock();
            if let Some(at) = kept.iter().position(|(of, _)| *of == offset)
                && let Some(found) = kept.remove(at)
            {
                let leaf = found.1.clone();
                kept.push_back(found);
                return Ok(leaf);
            }
        }
        let place = self.header.leaves.part(offset, length.into());
        let place = place.filter(|_| length <= MAX_LEAF_LEN);
        let place = place.ok_or_else(|| {
            self.damaged("its root directory places a directory beyond its end".to_owned())
        })?;
        let bytes = self.source.read_at(place.offset, place.length as usize)?;
        let leaf = self
            .header
            .directory(bytes)
            .map_err(|reason| self.damaged(format!("of a directory, {reason}")))?;
        let leaf = Arc::new(leaf);
        let mut kept = lock();
        if !kept.iter().any(|(of, _)| *of == offset) {
            kept.push_back((offset, leaf.clone()));
        }
        let entries = |kept: &VecDeque<(u64, Arc<Directory>)>| -> usize {
            kept.iter().map(|(_, leaf)| leaf.len()).sum()
        };
        while kept.len() > 1 && entries(&kept) > KEPT_ENTRIES {
            kept.pop_front();
        }
        Ok(leaf)
    }
}

/// Header and root directory of an archive that is smaller than those may be.
fn read_small(source: &dyn RangeSource) -> Result<Vec<u8>, ArchiveError> {
    match source.read_at(0, HEADER_LEN) {
        // What is shorter than a header still says what it isn't, however short it is.
        Err(short @ RangeError::Short { .. }) => {
            let wanted = b"PMTiles\x03";
            let mut starts = (1..=wanted.len()).rev();
            match starts.find_map(|length| source.read_at(0, length).ok()) {
                Some(start) if !wanted.starts_with(&start) => Ok(start),
                _ => Err(short.into()),
            }
        }
        start => Ok(start?),
    }
}

/// A part of the archive that has been read already.
fn part(start: &[u8], section: Section) -> Option<&[u8]> {
    let first = usize::try_from(section.offset).ok()?;
    let end = usize::try_from(section.end()?).ok()?;
    start.get(first..end)
}

const _: () = assert!(MAX_LEVELS <= 32);
