//! From folders to archives and back.

use super::writer::{check_output, tile_order};
use super::{ArchiveError, ArchiveWriter, TerrainArchive};
use crate::bake::{self, BakeProgress, BakeReport, BakeSettings, BakeStage, HeightSource};
use crate::terrain::{INDEX_FILE, MANIFEST_FILE, TerrainManifest};
use crate::tile::{TerrainTile, TileAddress};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};

/// Tiles that are packed at once: enough for all cores, and some 20 MiB.
const WINDOW: usize = 256;

/// What packing a terrain, or unpacking it, made.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ArchiveReport {
    /// Tiles that the archive holds, equal ones counted each.
    pub tiles: u64,
    /// Bytes of the folder: tiles, index and manifest.
    pub folder_bytes: u64,
    /// Bytes of the archive.
    pub archive_bytes: u64,
    /// How long it took.
    pub elapsed: Duration,
}

/// Packs the terrain in the folder `dir` into the archive `out`, whose name ends in `.pmtiles`.
/// `force` replaces a terrain archive that exists, and no other file. The same terrain makes the same
/// bytes. Every tile is checked before it is packed. What else lies in the folder is not packed.
///
/// All cores pack; memory stays at some 20 MiB and 100 bytes a tile. The archive is written beside its
/// place and renamed: who is stopped leaves the old one or none.
///
/// # Errors
/// Where the folder holds no terrain that can be used, a tile is missing, damaged or another
/// terrain's, and where the archive may not or can't be written. What stood there then still does.
pub fn write_archive(
    dir: &Path,
    out: &Path,
    force: bool,
    progress: &dyn BakeProgress,
) -> Result<ArchiveReport, ArchiveError> {
    let start = Instant::now();
    check_output(out, force)?;
    let name = || dir.display().to_string();
    let unusable = |reason| ArchiveError::Manifest {
        name: name(),
        reason: Box::new(reason),
    };
    // Checks lengths, so that the files can be read as they are.
    let terrain = TerrainManifest::read(dir).map_err(unusable)?;
    let read = |file: &str| {
        let path = dir.join(file);
        std::fs::read(&path)
            .map_err(|reason| unusable(crate::terrain::ManifestError::Read { path, reason }))
    };
    let ron = String::from_utf8_lossy(&read(MANIFEST_FILE)?).into_owned();
    let index = read(INDEX_FILE)?;
    let mut writer = ArchiveWriter::create(out, &ron, &index, force)?;
    let tiles = tile_order(&terrain.index);
    let mut folder_bytes = (ron.len() + index.len()) as u64;
    progress.stage(BakeStage::Pack, tiles.len() as u64);
    for window in tiles.chunks(WINDOW) {
        let packed: Vec<(u64, Vec<u8>)> = window
            .par_iter()
            .map(|&address| {
                let failed = |reason: String| ArchiveError::Tile {
                    name: name(),
                    address,
                    reason,
                };
                let bytes = std::fs::read(dir.join(TerrainTile::path(address)))
                    .map_err(|error| failed(error.to_string()))?;
                let tile = TerrainTile::decode(&bytes, address)
                    .and_then(|tile| tile.check(&terrain, address).map(|()| tile))
                    .map_err(|error| failed(error.to_string()))?;
                Ok((bytes.len() as u64, tile.pack()))
            })
            .collect::<Result<_, ArchiveError>>()?;
        for (&address, (length, packed)) in window.iter().zip(&packed) {
            writer.add(address, packed)?;
            folder_bytes += length;
        }
        progress.advance(window.len() as u64);
    }
    progress.stage(BakeStage::Finish, 0);
    Ok(ArchiveReport {
        tiles: tiles.len() as u64,
        folder_bytes,
        archive_bytes: writer.finish()?,
        elapsed: start.elapsed(),
    })
}

/// Makes a folder of an archive's terrain again: what [`write_archive`] packed, byte for byte.
/// `force` replaces a terrain's folder as a bake does, and keeps what else lies in it.
///
/// # Errors
/// Where a tile can't be read or used, and where the folder may not or can't be written. What stood
/// there then still does.
pub fn unpack_archive(
    archive: &TerrainArchive,
    out: &Path,
    force: bool,
    progress: &dyn BakeProgress,
) -> Result<ArchiveReport, ArchiveError> {
    let start = Instant::now();
    let terrain = archive.terrain();
    let (ron, index) = archive.manifest();
    let folder = bake::FolderWriter::create(out, &terrain.file, force)?;
    let tiles = tile_order(&terrain.index);
    progress.stage(BakeStage::Unpack, tiles.len() as u64);
    let lengths: Vec<u64> = tiles
        .par_iter()
        .map(|&address| {
            let tile = read_tile(archive, address)?;
            let bytes = tile.encode(address);
            folder.write(Path::new(&TerrainTile::path(address)), &bytes)?;
            progress.advance(1);
            Ok(bytes.len() as u64)
        })
        .collect::<Result<_, ArchiveError>>()?;
    folder.write(Path::new(INDEX_FILE), index)?;
    folder.write(Path::new(MANIFEST_FILE), ron.as_bytes())?;
    progress.stage(BakeStage::Finish, 0);
    folder.publish()?;
    Ok(ArchiveReport {
        tiles: tiles.len() as u64,
        folder_bytes: lengths.iter().sum::<u64>() + (ron.len() + index.len()) as u64,
        archive_bytes: archive.length(),
        elapsed: start.elapsed(),
    })
}

/// A tile that is the terrain's.
fn read_tile(archive: &TerrainArchive, address: TileAddress) -> Result<TerrainTile, ArchiveError> {
    let missing = || ArchiveError::MissingTile {
        name: archive.name(),
        address,
    };
    let bytes = archive.tile(address)?.ok_or_else(missing)?;
    TerrainTile::decode(&bytes, address)
        .and_then(|tile| tile.check(archive.terrain(), address).map(|()| tile))
        .map_err(|error| ArchiveError::Tile {
            name: archive.name(),
            address,
            reason: error.to_string(),
        })
}

/// Bakes `source` into the archive `out`: into a folder beside it, which is then packed and removed.
/// While it runs, both are on the disk. `force`, of the settings, replaces a terrain archive that
/// exists.
///
/// # Errors
/// Those of [`bake`](bake::bake) and of [`write_archive`].
pub fn bake_archive(
    source: &mut dyn HeightSource,
    out: &Path,
    settings: &BakeSettings,
    progress: &dyn BakeProgress,
) -> Result<(BakeReport, ArchiveReport), ArchiveError> {
    check_output(out, settings.force)?;
    // Removes what a bake that was killed left beside it.
    bake::put_right(out)?;
    let folder = Beside::create(out)?;
    let dir = folder.path.join("terrain");
    let baked = bake::bake(source, &dir, settings, progress)?;
    let packed = write_archive(&dir, out, settings.force, progress)?;
    Ok((baked, packed))
}

/// A folder beside a file, removed when dropped.
struct Beside {
    path: PathBuf,
}

impl Beside {
    fn create(out: &Path) -> Result<Self, ArchiveError> {
        static FOLDERS: AtomicU32 = AtomicU32::new(0);
        let number = FOLDERS.fetch_add(1, Ordering::Relaxed);
        let path = bake::partial_path(out, &format!("archive{number}"))?;
        std::fs::create_dir(&path).map_err(|reason| ArchiveError::Write {
            path: path.clone(),
            reason,
        })?;
        Ok(Self { path })
    }
}

impl Drop for Beside {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.path);
    }
}
