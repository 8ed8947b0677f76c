//! Baking a terrain in parts, on several machines or one after the other, and merging them.
//!
//! Each of `N` shards bakes a strip of the terrain into a folder of its own ([`bake_shard`],
//! `tessera bake --shard I/N`); [`merge`] (`tessera merge`) joins the folders. Nothing has to be told
//! from one shard to another, so that whatever starts jobs can start these. The merged terrain's
//! folder has the same bytes as one bake's, however many shards there were, in whatever order they
//! ran, and however often they were stopped.
//!
//! # Where a terrain is split
//! Between rows of tiles of one level, `top`, the same for all shards of a terrain: a shard has some
//! rows of tiles of that level and all tiles below them. Those depend on nothing but rows of the
//! source: a row of a level on three of the level below, error bounds on
//! [`ERROR_REACH`](crate::error_bound::ERROR_REACH) rows around a tile, and densities on what spreads
//! from their neighbours. A shard counts down from its top level which rows of level 0 that takes, reads
//! these, and pushes them through the same pyramid as a whole bake does. The pyramid tells the
//! terrain's rim by the levels' sizes and not by where its rows end, so that there is one function
//! from rows to tiles, whichever rows are there: the tiles are equal, not alike.
//!
//! `top` is at most 4 and low enough that every shard has at least eight rows of tiles of that level,
//! where there are enough of them, or 0. A shard reads 97 times 2^`top` rows more to either side of its
//! own, at most a fifth of them where it has its eight rows (densities that spread far may ask for some
//! 150 rows, whatever `top`). More shards than rows of tiles leave some with nothing to do, which they are
//! done with at once.
//!
//! # Levels above
//! Heights and densities of level `top` lie in its tiles, every row of them, and so do its error bounds.
//! That is all that the level above follows from. [`merge`] pushes those rows through the pyramid's
//! upper levels.
//!
//! # What depends on the whole source
//! The height range, unless it is given, and what samples without data are filled with. Each shard
//! reads the whole source for it. With `--height-range-m`, and a source that can't lack data (16-bit
//! samples without a no-data value), none does, and sources that can go to a row without reading those
//! before it (raw, TIFF, SRTM) are read in part only.
//!
//! # Interrupted
//! `part.ron` counts the rows of tiles of level `top` that are complete. A shard that is started
//! again with the same arguments reads the tiles of these rows, to see that they are sound, and goes
//! on with the first row that isn't: a shard that begins there, and for the reasons above makes the same
//! tiles. What belongs to an incomplete row is made again. Tiles are not synced to the disk one by
//! one; what a power failure takes is found by its checksum. The same version of this crate has to have
//! made the part, of a source of the same size, scale and first row, with the same settings, as the same
//! one of as many shards; anything else is refused.
//!
//! # Tiles are linked
//! [`merge`] gives the parts' tiles a second name in the terrain's folder (a hard link) where both
//! lie on one file system, and copies them where not. Parts stay as they are, take no room twice, and
//! may be deleted, or merged again. Nothing in this crate changes a tile's file in its place, and a part
//! that is baked again drops its name for a tile first. Tools that do change files in place change both.

mod error;
mod merge;
mod part;

pub use error::ShardError;
pub use merge::{MergeReport, merge};
pub use part::{PART_FILE, PART_MAGIC, PART_VERSION, PartFile};

use super::pyramid::{Pyramid, Sections};
use super::quantise::Bands;
use super::span::Span;
use super::{BakeError, BakeProgress, BakeSettings, BakeStage, HeightSource, Plan, check, stream};
use crate::terrain::ManifestFile;
use crate::tile::{TILE_SAMPLES, TerrainTile, TileAddress, of_terrain, tile_path};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::fs;
use std::io;
use std::path::Path;
use std::str::FromStr;
use std::time::{Duration, Instant};

/// The most shards of a terrain.
pub const MAX_SHARDS: u32 = 1 << 16;

/// Which part of a bake; written `3/8`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Shard {
    /// From 1 to `count`.
    pub number: u32,
    /// How many there are, at most [`MAX_SHARDS`].
    pub count: u32,
}

impl Shard {
    /// Shard `number` of `count`.
    ///
    /// # Errors
    /// Where there is no such shard.
    pub fn new(number: u32, count: u32) -> Result<Self, ShardError> {
        let shard = Self { number, count };
        shard.validate()?;
        Ok(shard)
    }

    fn validate(self) -> Result<(), ShardError> {
        let Self { number, count } = self;
        if (1..=count).contains(&number) && count <= MAX_SHARDS {
            Ok(())
        } else {
            Err(ShardError::Shard { number, count })
        }
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.count)
    }
}

impl FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = || format!("a shard is written I/N, as in 3/8, not {text:?}");
        let (number, count) = text.split_once('/').ok_or_else(wanted)?;
        let whole = |text: &str| text.trim().parse::<u32>().map_err(|_| wanted());
        Self::new(whole(number)?, whole(count)?).map_err(|error| error.to_string())
    }
}

/// What a shard made.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct ShardReport {
    /// What lies in the part's folder now.
    pub part: PartFile,
    /// Tiles of the part.
    pub tiles: u64,
    /// Those of them that an earlier run had made.
    pub tiles_before: u64,
    /// Bytes of the tiles that this run made.
    pub bytes: u64,
    /// Rows of the source that this run's tiles were made of, those around the part's own included.
    pub source_rows: u32,
    /// How long this run took.
    pub elapsed: Duration,
}

/// Bakes the part `shard` of what [`bake`](super::bake) would make of `source` with the same
/// settings, into the folder `out`, or goes on with it where an earlier run was stopped.
///
/// With [`force`](BakeSettings::force), begins anew whatever part is there. Other files in the
/// folder stay. Reads the whole source as often as [`bake`](super::bake) does before it makes tiles,
/// and for these only the rows that they need. Takes as much memory as a whole bake.
///
/// # Errors
/// Where [`bake`](super::bake) fails, where `out` holds something else than a part of the same bake, and
/// where another process bakes the part; see [`ShardError`]. What was complete before stays.
pub fn bake_shard(
    source: &mut dyn HeightSource,
    out: &Path,
    settings: &BakeSettings,
    shard: Shard,
    progress: &dyn BakeProgress,
) -> Result<ShardReport, ShardError> {
    let start = Instant::now();
    shard.validate()?;
    let spacing_m = check(source, settings)?;
    // Before any work; and once more when nobody else can change it.
    if let Some(before) = part::check_output(out, settings.force)?
        && !settings.force
        && (before.shard, before.terrain.size) != (shard, source.size())
    {
        return Err(other_part(out, &before, source.size(), shard));
    }
    let plan = Plan::make(source, settings, spacing_m, progress)?;
    let mut part = describe(source, &plan, shard)?;
    let _lock = part::lock(out)?;
    if let Some(before) = part::check_output(out, settings.force)?
        && !settings.force
    {
        if let Some(difference) = before.difference_of_part(&part) {
            return Err(ShardError::OutputOther {
                path: out.to_owned(),
                difference,
            });
        }
        part.clamped = before.clamped;
    }
    keep_sound_rows(&mut part, out, progress)?;
    let tiles = |rows| part.addresses(&rows).count() as u64;
    let mut report = ShardReport {
        tiles: tiles(part.rows()),
        tiles_before: tiles(part.rows_done()),
        bytes: 0,
        source_rows: 0,
        elapsed: Duration::ZERO,
        part,
    };
    if !report.part.is_complete() {
        make_rows(source, out, settings, &plan, &mut report, progress)?;
    }
    progress.stage(BakeStage::Finish, 0);
    report.elapsed = start.elapsed();
    Ok(report)
}

/// Refuses a part that can be told from the wanted one without reading the source.
fn other_part(out: &Path, before: &PartFile, size: [u32; 2], shard: Shard) -> ShardError {
    let mut wanted = before.clone();
    wanted.shard = shard;
    wanted.terrain.size = size;
    ShardError::OutputOther {
        path: out.to_owned(),
        difference: before.difference_of_part(&wanted).unwrap_or_default(),
    }
}

/// A part of which nothing is done.
fn describe(
    source: &mut dyn HeightSource,
    plan: &Plan,
    shard: Shard,
) -> Result<PartFile, BakeError> {
    let terrain = plan.manifest.clone();
    let mut row = vec![0.0; terrain.size[0] as usize];
    source.rewind()?;
    source.read_row(&mut row)?;
    let mut hasher = crc32fast::Hasher::new();
    for height in row {
        // Not every machine makes the same NaN.
        let bits = if height.is_nan() {
            u32::MAX
        } else {
            height.to_bits()
        };
        hasher.update(&bits.to_le_bytes());
    }
    Ok(PartFile {
        format: PART_MAGIC.to_owned(),
        version: PART_VERSION,
        program: env!("CARGO_PKG_VERSION").to_owned(),
        shard,
        top: part::top_level(&terrain, shard.count),
        terrain,
        height_range_m: (*plan.range.start(), *plan.range.end()),
        source_range_m: plan.survey.heights_m,
        filled: plan.survey.no_data,
        fill_block: plan.fill.block(),
        source_crc32: hasher.finalize(),
        clamped: Vec::new(),
    })
}

/// Forgets the rows of tiles of an earlier run from the first on in which a tile is not sound, and
/// removes the tiles of all rows that have to be made.
fn keep_sound_rows(
    part: &mut PartFile,
    out: &Path,
    progress: &dyn BakeProgress,
) -> Result<(), ShardError> {
    let done = part.rows_done();
    progress.stage(BakeStage::Merge, part.addresses(&done).count() as u64);
    let sound = done.clone().take_while(|&row| {
        let addresses: Vec<_> = part.addresses(&(row..row + 1)).collect();
        let sound = addresses
            .par_iter()
            .all(|&address| read_tile(out, address, &part.terrain).is_ok());
        progress.advance(addresses.len() as u64);
        sound
    });
    let sound = sound.count();
    part.clamped.truncate(sound);
    // Before any tile is removed, so that no row counts as complete that isn't.
    part.write(out)?;
    let failed = |path: &Path, reason: io::Error| match reason.kind() {
        io::ErrorKind::NotFound => Ok(()),
        _ => Err(ShardError::Write {
            path: path.to_owned(),
            reason,
        }),
    };
    if sound == 0 {
        let tiles = out.join("tile");
        return fs::remove_dir_all(&tiles).or_else(|reason| failed(&tiles, reason));
    }
    // Removed and not written over: a merged terrain may have the same files.
    for address in part.addresses(&(part.rows_done().end..part.rows().end)) {
        let path = out.join(tile_path(address));
        fs::remove_file(&path).or_else(|reason| failed(&path, reason))?;
    }
    Ok(())
}

/// Reads and checks a tile of the part of `terrain` in the folder `dir`.
fn read_tile(
    dir: &Path,
    address: TileAddress,
    terrain: &ManifestFile,
) -> Result<(Vec<u8>, TerrainTile), String> {
    let bytes = fs::read(dir.join(tile_path(address))).map_err(|reason| reason.to_string())?;
    let tile = TerrainTile::decode(&bytes, address).map_err(|reason| reason.to_string())?;
    of_terrain(((), tile.stamp), terrain.stamp()).map_err(|reason| reason.to_string())?;
    Ok((bytes, tile))
}

/// Makes all rows of tiles that aren't done yet.
fn make_rows(
    source: &mut dyn HeightSource,
    out: &Path,
    settings: &BakeSettings,
    plan: &Plan,
    report: &mut ShardReport,
    progress: &dyn BakeProgress,
) -> Result<(), ShardError> {
    let part = &mut report.part;
    for level in 0..=part.top {
        let path = out.join(format!("tile/{level}"));
        fs::create_dir_all(&path).map_err(|reason| ShardError::Write { path, reason })?;
    }
    let rows = part.rows_done().end..part.rows().end;
    let span = Span::strip(&part.terrain, part.top, rows.clone());
    let sections = Sections {
        densities: true,
        errors: true,
    };
    let mut pyramid = Pyramid::new(&part.terrain, &span, out, sections);
    let unit = TILE_SAMPLES << part.top;
    report.source_rows = span.rows.end - span.rows.start;
    let bands = Bands {
        rows: span.rows,
        at_once: settings.rows_at_once(part.terrain.size),
        // So that what is clamped can be told of every row of tiles.
        unit,
    };
    let last = part.terrain.tiles(part.top)[1] - 1;
    let mut clamped = vec![0; rows.len()];
    let made = stream(
        source,
        plan,
        bands,
        &mut pyramid,
        progress,
        &mut |pyramid, band| {
            // The terrain's last row of samples belongs to no tile after it.
            let row = (band.first_row / unit).min(last);
            if let Some(clamped) = row
                .checked_sub(rows.start)
                .and_then(|row| clamped.get_mut(row as usize))
            {
                *clamped += band.clamped;
            }
            let done = part.rows_done().end..pyramid.rows_done();
            if !done.is_empty() {
                let made = done.map(|row| clamped[(row - rows.start) as usize]);
                part.clamped.extend(made);
                part.write(out)?;
            }
            Ok::<_, ShardError>(())
        },
    );
    made.map_err(|error| match error {
        // A part stays.
        ShardError::Bake(BakeError::Write { path, reason }) => ShardError::Write { path, reason },
        other => other,
    })?;
    report.bytes = pyramid.finish().1;
    Ok(())
}
