//! Baking edits into a terrain.

use super::writer::{self, PartialTerrain};
use super::{BakeError, BakeProgress, BakeStage};
use crate::density::DensityExtent;
use crate::edit::{Edit, EditGround, EditLog, EditScratch, EditedTile, Footprint};
use crate::error_bound::cover_finer;
use crate::terrain::{ManifestFile, TerrainManifest};
use crate::tile::{
    DENSITY_BORDER, DENSITY_STORED, DENSITY_TEXELS, DensityTile, ErrorTile, TerrainTile,
    TileAddress, TileFormatError, TileIndex, of_terrain, tile_path,
};
use rayon::prelude::*;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::fs;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// What [`apply_edits`] made.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ApplyReport {
    /// Edits that were active, and so are part of the new terrain's ground.
    pub edits: u64,
    /// Tiles of the new terrain.
    pub tiles: u64,
    /// How many of them edits may touch, or are written for a neighbour's sake.
    pub changed: u64,
    /// Bytes written; tiles that are linked don't count.
    pub bytes: u64,
    /// How long it took.
    pub elapsed: Duration,
}

/// Bakes the active edits of `log` into a copy of the terrain in the folder `dir`, which is put in the
/// folder `out`; `dir` itself may be replaced by `force`. Heights are, byte for byte, those that a game
/// has which applies the log; so are densities and error bounds, but that border texels are made equal
/// to the neighbours' own and parents' bounds are raised to their children's.
///
/// Tiles that no edit reaches are linked, not copied, where the file system can. What else lies in
/// `dir` is not taken along. Memory grows with the terrain's width: three rows of edited tiles, some
/// 60 KB each, and 1 KB for each tile beside them.
///
/// # Errors
/// For a folder that is no terrain, a log of another terrain, a tile that can't be read, where another
/// terrain was put in `dir` meanwhile, and where `out` exists (without `force`) or can't be written.
/// `out` is then as it was before.
pub fn apply_edits(
    dir: &Path,
    log: &EditLog,
    out: &Path,
    force: bool,
    progress: &dyn BakeProgress,
) -> Result<ApplyReport, BakeError> {
    let start = Instant::now();
    // The folders themselves and not links to them, which a rename would replace.
    let [source, out] = [dir, out].map(|dir| dir.canonicalize().unwrap_or_else(|_| dir.to_owned()));
    writer::put_right(&source)?;
    writer::prepare(&out, force)?;
    let before = writer::Identity::of(&source);
    let manifest = TerrainManifest::read(&source).map_err(|reason| BakeError::Terrain {
        path: dir.to_owned(),
        reason: Box::new(reason),
    })?;
    let before = before?;
    let TerrainManifest { mut file, index } = manifest;
    log.check_terrain(&file)
        .map_err(|reason| BakeError::Edits { reason })?;
    let partial = PartialTerrain::create(&out, &file)?;
    let tiles = index.iter().count() as u64;
    progress.stage(BakeStage::Apply, tiles);
    let mut report = ApplyReport {
        edits: log.active_count() as u64,
        tiles,
        changed: 0,
        bytes: 0,
        elapsed: Duration::ZERO,
    };
    let replay = Replay::new(&file, log);
    let mut new_index = index.clone();
    for level in 0..file.levels {
        Level {
            source: &source,
            partial: partial.dir(),
            file: &file,
            index: &index,
            stamp: file.stamp(),
            log,
            replay: &replay,
            level,
            progress,
        }
        .run(&mut new_index, &mut report)?;
    }
    progress.stage(BakeStage::Finish, 0);
    new_index.cover_children();
    report.bytes += partial.write_index(&mut file, &new_index)?;
    partial.carry_over(&writer::is_ours)?;
    if writer::Identity::of(&source).ok().as_ref() != Some(&before) {
        return Err(BakeError::Replaced {
            path: dir.to_owned(),
        });
    }
    partial.publish(force)?;
    report.elapsed = start.elapsed();
    Ok(report)
}

/// What edits do on a terrain.
struct Replay {
    ground: EditGround,
    /// Where each active edit reaches.
    footprints: HashMap<u64, Footprint>,
}

impl Replay {
    fn new(file: &ManifestFile, log: &EditLog) -> Self {
        let ground = EditGround::new(file);
        let active: Vec<_> = log.active().collect();
        let footprints = active
            .into_par_iter()
            .map_init(EditScratch::default, |scratch, (sequence, edit)| {
                (sequence, ground.raster(edit, scratch).into_footprint())
            })
            .collect();
        Self { ground, footprints }
    }

    /// A tile with edits applied in order, as a game has it.
    fn tile(
        &self,
        address: TileAddress,
        tile: TerrainTile,
        edits: &[(u64, &Arc<Edit>)],
        scratch: &mut EditScratch,
    ) -> TerrainTile {
        let edits = edits
            .iter()
            .filter_map(|(sequence, edit)| Some((&***edit, self.footprints.get(sequence)?)));
        EditedTile::replay(&self.ground, address, tile, edits, scratch).into_tile()
    }
}

/// One level.
struct Level<'a> {
    source: &'a Path,
    partial: &'a Path,
    file: &'a ManifestFile,
    index: &'a TileIndex,
    stamp: u32,
    log: &'a EditLog,
    replay: &'a Replay,
    level: u8,
    progress: &'a dyn BakeProgress,
}

/// The edited tiles of a row, by column.
type Row = HashMap<u32, TerrainTile>;

impl Level<'_> {
    fn run(&self, index: &mut TileIndex, report: &mut ApplyReport) -> Result<(), BakeError> {
        let rows = self.file.tiles(self.level)[1];
        // The rows before, at and after the one that is written.
        let mut around: [Row; 3] = Default::default();
        for z in 0..=rows {
            around.rotate_left(1);
            around[2] = if z < rows {
                self.replay_row(z)?
            } else {
                Row::new()
            };
            for (&x, tile) in &around[2] {
                let address = TileAddress::new(self.level, x, z);
                index.set(address, Some(tile.heights.range()));
            }
            if let Some(z) = z.checked_sub(1) {
                self.write_row(z, &around, report)?;
            }
        }
        Ok(())
    }

    /// The tiles of a row that edits may touch, with these.
    fn replay_row(&self, z: u32) -> Result<Row, BakeError> {
        let replay = |scratch: &mut EditScratch, x: u32| {
            let address = TileAddress::new(self.level, x, z);
            self.index.get(address)?;
            let edits = self.log.active_touching(address);
            if edits.is_empty() {
                return None;
            }
            let tile = self.read(self.source, address, |bytes| {
                let tile = TerrainTile::decode(bytes, address)?;
                of_terrain(((), tile.stamp), self.stamp)?;
                Ok(tile)
            });
            Some(tile.and_then(|tile| {
                let mut tile = self.replay.tile(address, tile, &edits, scratch);
                self.cover_children(address, &mut tile.errors)?;
                Ok((x, tile))
            }))
        };
        (0..self.file.tiles(self.level)[0])
            .into_par_iter()
            .map_init(EditScratch::default, replay)
            .flatten()
            .collect()
    }

    /// Raises a tile's error bounds to those that were written for its children.
    fn cover_children(
        &self,
        address: TileAddress,
        errors: &mut ErrorTile,
    ) -> Result<(), BakeError> {
        let stored = |child: &TileAddress| self.index.get(*child).is_some();
        for child in address.children().into_iter().flatten().filter(stored) {
            let finer = self.read(self.partial, child, |bytes| self.errors(bytes, child))?;
            let half = DENSITY_TEXELS / 2;
            let first = [child.x % 2 * half, child.z % 2 * half];
            let texels = errors.texels_mut();
            for (at, finer) in (0..).zip(finer.texels()) {
                let x = first[0] + at % DENSITY_TEXELS / 2;
                let z = first[1] + at / DENSITY_TEXELS / 2;
                cover_finer(&mut texels[(z * DENSITY_TEXELS + x) as usize], finer);
            }
        }
        Ok(())
    }

    /// A tile's error bounds, of a file that may be packed.
    fn errors(&self, bytes: &[u8], address: TileAddress) -> Result<ErrorTile, TileFormatError> {
        if crate::tile::is_packed(bytes) {
            let tile = TerrainTile::decode(bytes, address)?;
            return of_terrain((tile.errors, tile.stamp), self.stamp);
        }
        of_terrain(ErrorTile::decode_stamped(bytes, address)?, self.stamp)
    }

    /// Writes or links the tiles of a row.
    fn write_row(
        &self,
        z: u32,
        around: &[Row; 3],
        report: &mut ApplyReport,
    ) -> Result<(), BakeError> {
        let columns: Vec<u32> = (0..self.file.tiles(self.level)[0])
            .filter(|&x| self.index.get(TileAddress::new(self.level, x, z)).is_some())
            .collect();
        let written = columns
            .par_iter()
            .map(|&x| self.write_tile(TileAddress::new(self.level, x, z), around))
            .collect::<Result<Vec<_>, BakeError>>()?;
        self.progress.advance(written.len() as u64);
        for bytes in written.into_iter().flatten() {
            report.changed += 1;
            report.bytes += bytes;
        }
        Ok(())
    }

    /// Writes a tile that differs and returns the number of bytes; links one that doesn't.
    fn write_tile(
        &self,
        address: TileAddress,
        around: &[Row; 3],
    ) -> Result<Option<u64>, BakeError> {
        let edited = around[1].get(&address.x);
        let columns = address.x.saturating_sub(1)..=address.x + 1;
        let near = |row: &Row| columns.clone().any(|x| row.contains_key(&x));
        if !around.iter().any(near) {
            self.link(address)?;
            return Ok(None);
        }
        let tile = match edited {
            Some(tile) => tile.clone(),
            None => self.read(self.source, address, |bytes| {
                let tile = TerrainTile::decode(bytes, address)?;
                of_terrain(((), tile.stamp), self.stamp)?;
                Ok(tile)
            })?,
        };
        let densities = self.with_borders(address, &tile.densities, around)?;
        if edited.is_none() && densities == tile.densities {
            self.link(address)?;
            return Ok(None);
        }
        let tile = writer::Tile {
            heights: &tile.heights,
            densities: Some(&densities),
            errors: Some(&tile.errors),
            stamp: self.stamp,
        };
        tile.write(self.partial, address).map(Some)
    }

    /// A tile's densities with its neighbours' own texels in its border, and where it reaches beyond
    /// the terrain, the texels on the rim.
    fn with_borders(
        &self,
        address: TileAddress,
        own: &DensityTile,
        around: &[Row; 3],
    ) -> Result<DensityTile, BakeError> {
        let side = DENSITY_TEXELS as i32;
        let border = DENSITY_BORDER as i32;
        let extent = DensityExtent::new(self.file.size, self.level);
        let [columns, rows] = extent.texels.map(|texels| texels as i32);
        let first = [address.x, address.z].map(|tile| tile as i32 * side);
        let mut neighbours: HashMap<TileAddress, Option<DensityTile>> = HashMap::new();
        let mut made = own.clone();
        let texels = made.samples_mut();
        for (at, texel) in (0..).zip(texels.iter_mut()) {
            let x = (at % DENSITY_STORED as i32 - border + first[0]).clamp(0, columns - 1);
            let z = (at / DENSITY_STORED as i32 - border + first[1]).clamp(0, rows - 1);
            let owner = TileAddress::new(self.level, (x / side) as u32, (z / side) as u32);
            if owner == address {
                *texel = own.get(x - first[0], z - first[1]);
                continue;
            }
            let neighbour = match neighbours.entry(owner) {
                Entry::Occupied(known) => known.into_mut(),
                Entry::Vacant(new) => new.insert(self.neighbour(owner, address, around)?),
            };
            if let Some(neighbour) = neighbour {
                *texel = neighbour.get(x % side, z % side);
            }
        }
        Ok(made)
    }

    /// A neighbour's densities; `None` where it isn't stored.
    fn neighbour(
        &self,
        owner: TileAddress,
        of: TileAddress,
        around: &[Row; 3],
    ) -> Result<Option<DensityTile>, BakeError> {
        let row = (owner.z + 1).checked_sub(of.z).map(|row| row as usize);
        if let Some(tile) = row
            .and_then(|row| around.get(row))
            .and_then(|row| row.get(&owner.x))
        {
            return Ok(Some(tile.densities.clone()));
        }
        if self.index.get(owner).is_none() {
            return Ok(None);
        }
        let densities = self.read(self.source, owner, |bytes| {
            if crate::tile::is_packed(bytes) {
                let tile = TerrainTile::decode(bytes, owner)?;
                return of_terrain((tile.densities, tile.stamp), self.stamp);
            }
            of_terrain(DensityTile::decode_stamped(bytes, owner)?, self.stamp)
        })?;
        Ok(Some(densities))
    }

    /// Gives the old terrain's file of a tile a second name in the new one.
    fn link(&self, address: TileAddress) -> Result<(), BakeError> {
        let [source, target] = [self.source, self.partial].map(|dir| dir.join(tile_path(address)));
        if fs::hard_link(&source, &target).is_ok() {
            return Ok(());
        }
        fs::copy(&source, &target)
            .map(drop)
            .map_err(|reason| BakeError::Write {
                path: target,
                reason,
            })
    }

    fn read<T>(
        &self,
        dir: &Path,
        address: TileAddress,
        decode: impl FnOnce(&[u8]) -> Result<T, TileFormatError>,
    ) -> Result<T, BakeError> {
        super::rebake::read(dir, &tile_path(address), decode)
    }
}
