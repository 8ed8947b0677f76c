//! Joining parts.

use super::super::pyramid::{GivenTiles, Pyramid, Sections};
use super::super::span::Span;
use super::super::verify::{Contents, Fault, check_seam};
use super::super::writer::is_ours;
use super::super::writer::{self, PartialTerrain};
use super::super::{BakeError, BakeProgress, BakeReport, BakeStage};
use super::{PartFile, Shard, ShardError, read_tile};
use crate::tile::{
    DENSITY_CELL, DENSITY_TEXELS, ErrorTile, TILE_SAMPLES, TerrainTile, TileAddress, TileRange,
    tile_path,
};
use rayon::prelude::*;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// What a merge made.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct MergeReport {
    /// The terrain, as if one bake had made it.
    pub terrain: BakeReport,
    /// Parts that it was made of.
    pub parts: u32,
    /// Tiles of parts that got a second name.
    pub linked: u64,
    /// Tiles of parts that were copied.
    pub copied: u64,
}

/// A part that is given.
struct Part<'a> {
    dir: &'a Path,
    file: PartFile,
}

/// Joins the parts in the folders `parts`, in any order, to the terrain `out`.
///
/// Reads every tile once, and compares neighbouring tiles in all that both hold. Makes the levels
/// above the parts'. Memory grows with the terrain's width: from 8193 to 131073 columns
/// by 3.3 kB a column where parts have tiles of level 0 alone, and from 8193 to 32769 columns by 0.9 kB
/// where they have those of level 1 too (peaks of the whole process, on two cores).
///
/// # Errors
/// Where parts are missing, double, incomplete or of different bakes, where a tile is damaged or
/// doesn't fit its neighbours, and where `out` exists (without `force`) or can't be written; see
/// [`ShardError`]. `out` is then as it was before, and so are the parts.
pub fn merge(
    parts: &[PathBuf],
    out: &Path,
    force: bool,
    progress: &dyn BakeProgress,
) -> Result<MergeReport, ShardError> {
    let start = Instant::now();
    let parts = read_parts(parts)?;
    writer::prepare(out, force)?;
    let file = &parts[0].file;
    let mut manifest = file.terrain.clone();
    let partial = PartialTerrain::create(out, &manifest)?;
    let sections = Sections {
        densities: true,
        errors: true,
    };
    let span = Span::above(&manifest, file.top);
    let mut merge = Merge {
        parts: &parts,
        target: partial.dir(),
        pyramid: Pyramid::new(&manifest, &span, partial.dir(), sections),
        bytes: 0,
        linked: 0,
        copied: 0,
    };
    let tiles: u64 = parts
        .iter()
        .map(|part| part.file.addresses(&part.file.rows()).count() as u64)
        .sum();
    progress.stage(BakeStage::Merge, tiles);
    for level in 0..=file.top {
        merge.level(level, progress)?;
    }
    let Merge {
        pyramid,
        linked,
        copied,
        bytes: linked_bytes,
        ..
    } = merge;
    let (mut index, bytes) = pyramid.finish();
    index.cover_children();
    let tiles = index.iter().count() as u64;
    let bytes = linked_bytes + bytes + partial.write_index(&mut manifest, &index)?;
    progress.stage(BakeStage::Finish, 0);
    partial.carry_over(&is_ours)?;
    partial.publish(force)?;
    Ok(MergeReport {
        terrain: BakeReport {
            size: manifest.size,
            levels: manifest.levels,
            tiles,
            bytes,
            spacing_m: manifest.spacing_m,
            height_range_m: file.height_range_m.0..=file.height_range_m.1,
            height_step_m: manifest.height_step_m,
            source_range_m: file.source_range_m,
            clamped: parts.iter().flat_map(|part| &part.file.clamped).sum(),
            filled: file.filled,
            fill_block: file.fill_block,
            elapsed: start.elapsed(),
        },
        parts: parts.len() as u32,
        linked,
        copied,
    })
}

/// Reads all parts and sorts them by number; there is at least one, and all shards are there.
fn read_parts(dirs: &[PathBuf]) -> Result<Vec<Part<'_>>, ShardError> {
    let mut parts = dirs
        .iter()
        .map(|dir| {
            let file = PartFile::read(dir)?;
            Ok(Part { dir, file })
        })
        .collect::<Result<Vec<_>, ShardError>>()?;
    let first = parts.first().ok_or(ShardError::NoParts)?;
    for part in &parts {
        if let Some(difference) = first.file.difference(&part.file) {
            return Err(ShardError::Different {
                first: first.dir.to_owned(),
                other: part.dir.to_owned(),
                difference,
            });
        }
    }
    let count = first.file.shard.count;
    parts.sort_by_key(|part| part.file.shard);
    for pair in parts.windows(2) {
        if pair[0].file.shard == pair[1].file.shard {
            return Err(ShardError::Double {
                shard: pair[0].file.shard,
                first: pair[0].dir.to_owned(),
                second: pair[1].dir.to_owned(),
            });
        }
    }
    let given = |number: &u32| {
        let at = *number as usize - 1;
        parts
            .get(at)
            .is_some_and(|part| part.file.shard.number == *number)
    };
    if let Some(number) = (1..=count).find(|number| !given(number)) {
        return Err(ShardError::Missing {
            shard: Shard { number, count },
        });
    }
    if let Some(part) = parts.iter().find(|part| !part.file.is_complete()) {
        return Err(ShardError::Incomplete {
            path: part.dir.to_owned(),
            shard: part.file.shard,
            done: part.file.clamped.len() as u32,
            rows: part.file.rows().len() as u32,
        });
    }
    Ok(parts)
}

struct Merge<'a> {
    parts: &'a [Part<'a>],
    target: &'a Path,
    /// The levels above the parts'.
    pyramid: Pyramid,
    bytes: u64,
    linked: u64,
    copied: u64,
}

/// A tile of a part, read, checked and given a place in the terrain.
struct Placed {
    contents: Contents,
    range: TileRange,
    bytes: u64,
    linked: bool,
}

impl Merge<'_> {
    /// The part that has row `z` of tiles of `level`.
    fn part(&self, level: u8, z: u32) -> &Part<'_> {
        let after = |part: &Part| part.file.tile_rows(level, &part.file.rows()).end <= z;
        &self.parts[self.parts.partition_point(after)]
    }

    /// Takes all tiles of one of the parts' levels.
    fn level(&mut self, level: u8, progress: &dyn BakeProgress) -> Result<(), ShardError> {
        let file = &self.parts[0].file;
        let (top, [columns, rows]) = (file.top, file.terrain.tiles(level));
        let mut before: Vec<Placed> = Vec::new();
        for z in 0..rows {
            let part = self.part(level, z);
            let row: Vec<Placed> = (0..columns)
                .into_par_iter()
                .map(|x| self.place(part, TileAddress::new(level, x, z)))
                .collect::<Result<_, _>>()?;
            self.check_seams(level, z, &row, &before)?;
            for (x, placed) in (0..).zip(&row) {
                self.bytes += placed.bytes;
                *if placed.linked {
                    &mut self.linked
                } else {
                    &mut self.copied
                } += 1;
                let address = TileAddress::new(level, x, z);
                self.pyramid.set(address, placed.range);
            }
            progress.advance(row.len() as u64);
            before = row;
            if level == top {
                self.pyramid.push_tiles(given(file, z, &mut before))?;
            }
        }
        Ok(())
    }

    /// Reads and checks a tile, and links or copies it.
    fn place(&self, part: &Part, address: TileAddress) -> Result<Placed, ShardError> {
        let name = tile_path(address);
        let (source, target) = (part.dir.join(&name), self.target.join(&name));
        let (bytes, tile) = read_tile(part.dir, address, &part.file.terrain).map_err(|reason| {
            ShardError::Tile {
                path: source.clone(),
                shard: part.file.shard,
                reason,
            }
        })?;
        // A link to a link would be none to the file.
        let is_file = fs::symlink_metadata(&source).is_ok_and(|metadata| metadata.is_file());
        let linked = is_file && fs::hard_link(&source, &target).is_ok();
        if !linked {
            fs::write(&target, &bytes).map_err(|reason| BakeError::Write {
                path: target,
                reason,
            })?;
        }
        let TerrainTile {
            heights,
            densities,
            errors,
            stamp: _,
        } = tile;
        Ok(Placed {
            range: heights.range(),
            contents: Contents {
                heights: Some(heights),
                densities: Some(densities),
                errors: (address.level == part.file.top).then_some(errors),
            },
            bytes: bytes.len() as u64,
            linked,
        })
    }

    /// Compares the tiles of a row with each other and with those of the row before.
    fn check_seams(
        &self,
        level: u8,
        z: u32,
        row: &[Placed],
        before: &[Placed],
    ) -> Result<(), ShardError> {
        let fault = (0..row.len()).into_par_iter().find_map_first(|x| {
            let address = TileAddress::new(level, x as u32, z);
            // Those to the north and to the west.
            [(0, -1), (-1, -1), (1, -1), (-1, 0)]
                .into_iter()
                .find_map(|(step_x, step_z)| {
                    let at = x.checked_add_signed(step_x as isize)?;
                    let other = if step_z == 0 { row } else { before }.get(at)?;
                    let neighbour =
                        TileAddress::new(level, at as u32, z.checked_add_signed(step_z)?);
                    let (own, step) = (&row[x].contents, [step_x, step_z]);
                    check_seam(address, own, neighbour, &other.contents, step).pop()
                })
        });
        let Some((address, fault)) = fault else {
            return Ok(());
        };
        let (neighbour, what) = match fault {
            Fault::DensityBorder { neighbour } => (neighbour, "densities"),
            Fault::HeightBorder { neighbour } => (neighbour, "heights"),
            _ => (address, "what they hold"),
        };
        let (own, other) = (self.part(level, address.z), self.part(level, neighbour.z));
        Err(ShardError::Border {
            path: own.dir.join(tile_path(address)),
            neighbour: other.dir.join(tile_path(neighbour)),
            what,
            shard: own.file.shard,
            other: (own.file.shard != other.file.shard).then_some(other.file.shard),
        })
    }
}

/// What the pyramid's upper levels take of a row of tiles of the parts' coarsest level.
fn given(file: &PartFile, z: u32, row: &mut [Placed]) -> GivenTiles {
    let samples = file.terrain.samples(file.top);
    let texels = samples.map(|count| (count - 1).div_ceil(DENSITY_CELL));
    let last = z + 1 == file.terrain.tiles(file.top)[1];
    let height_rows = if last {
        samples[1] - TILE_SAMPLES * z
    } else {
        TILE_SAMPLES
    };
    let density_rows = DENSITY_TEXELS.min(texels[1] - DENSITY_TEXELS * z);
    let tiles = row.len();
    let heights = (0..height_rows as i32)
        .map(|z| {
            let mut out = Vec::with_capacity(samples[0] as usize);
            for (number, placed) in row.iter().enumerate() {
                let left = samples[0] as usize - out.len();
                let count = if number + 1 == tiles {
                    left
                } else {
                    TILE_SAMPLES as usize
                };
                if let Some(heights) = &placed.contents.heights {
                    out.extend((0..count as i32).map(|x| heights.get(x, z)));
                }
            }
            out
        })
        .collect();
    let densities = (0..density_rows as i32)
        .map(|z| {
            let mut out = Vec::with_capacity(texels[0] as usize);
            for placed in row.iter() {
                let count = (texels[0] as usize - out.len()).min(DENSITY_TEXELS as usize);
                if let Some(densities) = &placed.contents.densities {
                    out.extend((0..count as i32).map(|x| densities.get(x, z)));
                }
            }
            out
        })
        .collect();
    GivenTiles {
        z,
        heights,
        densities,
        ranges: row.iter().map(|placed| placed.range).collect(),
        errors: row
            .iter_mut()
            .map(|placed| {
                placed
                    .contents
                    .errors
                    .take()
                    .unwrap_or_else(ErrorTile::flat)
            })
            .collect(),
    }
}
