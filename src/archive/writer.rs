//! Writing an archive so that it is there as a whole or not at all.

use super::layout::{START_LEN, coordinate, tile_number};
use super::{
    ARCHIVE_EXTENSION, ARCHIVE_FORMAT, ArchiveError, BASE64, RangeError, TerrainArchive,
    TerrainMetadata,
};
use crate::output::{PartialFile, check_place};
use crate::terrain::TerrainManifest;
use crate::tile::{TileAddress, TileIndex};
use base64::Engine;
use pmtiles::{Compression, PmTilesStreamWriter, PmTilesWriter, PmtError, TileType};
use std::collections::BTreeMap;
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};

const KIND: &str = "terrain archive";

/// The stored tiles of a terrain in the order in which an archive has them: the root first, the tiles
/// of a level along a Hilbert curve.
#[must_use]
pub fn tile_order(index: &TileIndex) -> Vec<TileAddress> {
    let levels = index.levels().len() as u8;
    let mut all: Vec<_> = index.iter().map(|(address, _)| address).collect();
    all.sort_by_cached_key(|&address| tile_number(levels, address));
    all
}

/// Whether an archive may be put at `out`; changes nothing.
pub(super) fn check_output(out: &Path, force: bool) -> Result<(), ArchiveError> {
    let extension = out.extension().and_then(|extension| extension.to_str());
    if !extension.is_some_and(|extension| extension.eq_ignore_ascii_case(ARCHIVE_EXTENSION)) {
        return Err(ArchiveError::OutputExtension {
            path: out.to_owned(),
        });
    }
    let place = check_place(out, KIND)?;
    if place.metadata.is_none() && std::fs::symlink_metadata(out).is_err() {
        return Ok(());
    }
    if !force {
        return Err(ArchiveError::OutputExists {
            path: out.to_owned(),
        });
    }
    // One that is damaged may go; a map, or whatever can't be told, may not.
    match TerrainArchive::open_file(out) {
        Ok(_)
        | Err(
            ArchiveError::Damaged { .. }
            | ArchiveError::Manifest { .. }
            | ArchiveError::Format { .. }
            | ArchiveError::Read(RangeError::Short { .. }),
        ) => Ok(()),
        Err(_) => Err(ArchiveError::OutputNotArchive {
            path: out.to_owned(),
        }),
    }
}

/// An archive that is being written, beside the place where it will lie. Dropped before it is
/// [finished](Self::finish), it is removed.
pub struct ArchiveWriter {
    out: PathBuf,
    force: bool,
    levels: u8,
    partial: PartialFile,
    file: File,
    writer: PmTilesStreamWriter<File>,
}

impl std::fmt::Debug for ArchiveWriter {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("ArchiveWriter").field(&self.out).finish()
    }
}

impl ArchiveWriter {
    /// Begins the archive `out`, whose name ends in `.pmtiles`, of the terrain that the text of
    /// `terrain.ron` and the bytes of `tiles.index` describe. `force` replaces a terrain archive that
    /// exists, and no other file.
    ///
    /// # Errors
    /// Where the terrain can't be used, and where nothing may or can be written there.
    pub fn create(out: &Path, ron: &str, index: &[u8], force: bool) -> Result<Self, ArchiveError> {
        check_output(out, force)?;
        let terrain =
            TerrainManifest::decode(ron, index).map_err(|reason| ArchiveError::Manifest {
                name: out.display().to_string(),
                reason: Box::new(reason),
            })?;
        let failed = |reason: io::Error| ArchiveError::Write {
            path: out.to_owned(),
            reason,
        };
        let json = |error: serde_json::Error| failed(io::Error::other(error));
        // The archive's own name is left out: the same terrain makes the same bytes wherever it lies.
        let held = TerrainMetadata {
            format: ARCHIVE_FORMAT,
            manifest: ron.to_owned(),
            index: BASE64.encode(index),
        };
        let [width, height] = terrain.file.size;
        let description = format!(
            "{width} x {height} samples, {} m apart; heights, densities and error bounds, no picture",
            terrain.file.spacing_m
        );
        let metadata = BTreeMap::from([
            ("bevy_tessera", serde_json::to_value(held).map_err(json)?),
            ("description", description.into()),
            ("name", "terrain of bevy_tessera".into()),
        ]);
        let metadata = serde_json::to_string(&metadata).map_err(json)?;
        let folder = check_place(out, KIND)?.folder;
        let (partial, file) = PartialFile::create(&folder, "archive").map_err(failed)?;
        let zooms = terrain.file.levels - 1;
        let writer = PmTilesWriter::new(TileType::Unknown)
            .precompressed(Compression::None)
            .min_zoom(0)
            .max_zoom(zooms)
            // PMTiles places tiles on a map of the Earth, which a terrain isn't on.
            .bounds(0.0, 0.0, 0.0, 0.0)
            .metadata(metadata)
            .create(file.try_clone().map_err(failed)?)
            .map_err(|error| write_failed(out, error))?;
        Ok(Self {
            out: out.to_owned(),
            force,
            levels: terrain.file.levels,
            partial,
            file,
            writer,
        })
    }

    /// Adds a tile's bytes, [packed](crate::tile::TerrainTile::pack) or as they lie in a folder. Tiles
    /// are added in their [order](tile_order), each once; bytes that have been added before are not
    /// written again. Memory grows by some 100 bytes a tile.
    ///
    /// # Errors
    /// For an address beyond the terrain, for no bytes, and where the archive can't be written.
    pub fn add(&mut self, address: TileAddress, bytes: &[u8]) -> Result<(), ArchiveError> {
        let refused = |reason: &str| ArchiveError::Tile {
            name: self.out.display().to_string(),
            address,
            reason: reason.to_owned(),
        };
        let place = coordinate(self.levels, address)
            .ok_or_else(|| refused("it lies beyond the terrain"))?;
        if bytes.is_empty() {
            return Err(refused("it has no bytes"));
        }
        self.writer
            .add_tile(place, bytes)
            .map_err(|error| write_failed(&self.out, error))
    }

    /// Completes the archive and puts it in its place. Returns its length in bytes.
    ///
    /// # Errors
    /// Where it can't be written, or something has appeared in its place meanwhile.
    pub fn finish(self) -> Result<u64, ArchiveError> {
        let out = &self.out.clone();
        let failed = |reason: io::Error| ArchiveError::Write {
            path: out.clone(),
            reason,
        };
        self.writer
            .finalize()
            .map_err(|error| write_failed(out, error))?;
        let length = self.file.metadata().map_err(failed)?.len();
        debug_assert!(length > START_LEN as u64);
        check_output(out, self.force)?;
        self.partial.publish(self.file, out).map_err(failed)?;
        Ok(length)
    }
}

fn write_failed(out: &Path, error: PmtError) -> ArchiveError {
    let reason = match error {
        PmtError::Reading(reason) => reason,
        other => io::Error::other(other),
    };
    ArchiveError::Write {
        path: out.to_owned(),
        reason,
    }
}
