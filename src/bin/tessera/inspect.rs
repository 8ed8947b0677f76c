//! `tessera inspect` and `tessera verify`.

use crate::progress::Bar;
use crate::text::{in_folder, metres, metres_in_table, rounded};
use bevy_tessera::archive::{ArchiveError, TerrainArchive};
use bevy_tessera::bake::shard::{PART_FILE, PartFile};
use bevy_tessera::bake::{self, BakeProgress};
use bevy_tessera::terrain::{
    DensityBorder, DensitySettings, MANIFEST_FILE, ManifestFile, TerrainManifest,
};
use std::error::Error;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

pub fn inspect(dir: &Path) -> Result<ExitCode, Box<dyn Error>> {
    if !dir.join(MANIFEST_FILE).exists() && dir.join(PART_FILE).exists() {
        return inspect_part(dir);
    }
    let archive = open_archive(dir)?;
    let read;
    let terrain = match &archive {
        Some(archive) => archive.terrain(),
        None => {
            read = TerrainManifest::read(dir).map_err(|error| in_folder(dir, &error))?;
            &read
        }
    };
    let mut out = std::io::stdout().lock();
    writeln!(out, "terrain   {}", dir.display())?;
    if let Some(archive) = &archive {
        writeln!(out, "archive   {:.1} MB", archive.length() as f64 / 1e6)?;
    }
    print_scale(&mut out, &terrain.file)?;
    let file = &terrain.file;
    writeln!(out, "format    version {}", file.version)?;
    writeln!(out, "level  spacing          tiles  stored  heights")?;
    for (level, number) in terrain.index.levels().iter().zip(0u8..) {
        let [x, z] = level.tiles();
        let mut stored = 0;
        let mut range = None;
        let of_level = |entry: &(bevy_tessera::tile::TileAddress, _)| entry.0.level == number;
        for (_, tile) in terrain.index.iter().filter(of_level) {
            stored += 1;
            range = Some(range.map_or(tile, |range: bevy_tessera::tile::TileRange| {
                range.union(tile)
            }));
        }
        let heights = range.map_or("none".to_owned(), |range| {
            format!(
                "{}..{} m",
                metres_in_table(file.height_m(range.min), file.height_step_m),
                metres_in_table(file.height_m(range.max), file.height_step_m)
            )
        });
        let spacing = format!("{} m", rounded(file.spacing_m * f64::from(1 << number)));
        let tiles = format!("{x} x {z}");
        writeln!(
            out,
            "{number:5}  {spacing:<10} {tiles:>11}  {stored:6}  {heights}"
        )?;
    }
    Ok(ExitCode::SUCCESS)
}

/// Which part of a terrain lies in the folder `dir`.
fn inspect_part(dir: &Path) -> Result<ExitCode, Box<dyn Error>> {
    let part = PartFile::read(dir)?;
    let mut out = std::io::stdout().lock();
    writeln!(out, "part      {}", dir.display())?;
    writeln!(out, "what      {}", crate::bake::describe(&part))?;
    print_scale(&mut out, &part.terrain)?;
    writeln!(out, "format    version {}", part.version)?;
    Ok(ExitCode::SUCCESS)
}

/// What tiles of a terrain, or of a part of one, mean.
fn print_scale(out: &mut impl Write, file: &ManifestFile) -> std::io::Result<()> {
    let [width, height] = file.size;
    let side = |samples: u32| f64::from(samples - 1) * file.spacing_m / 1000.0;
    writeln!(
        out,
        "size      {width} x {height} samples, {} m apart: {:.3} km x {:.3} km",
        rounded(file.spacing_m),
        side(width),
        side(height)
    )?;
    writeln!(
        out,
        "heights   {}..{} m can be stored, in steps of {} m",
        metres(file.height_m(0), file.height_step_m),
        metres(file.height_m(u16::MAX), file.height_step_m),
        rounded(file.height_step_m)
    )?;
    writeln!(out, "density   {}", describe(&file.density))
}

pub fn verify(dir: &Path) -> Result<ExitCode, Box<dyn Error>> {
    let archive = open_archive(dir)?;
    let count = |terrain: &TerrainManifest| terrain.index.iter().count() as u64;
    let progress = Bar::default();
    let advance = |tiles| progress.advance(tiles);
    let result = match &archive {
        Some(archive) => {
            progress.start("verify", count(archive.terrain()), "tiles");
            Ok(bake::verify_archive(archive, &advance))
        }
        None => {
            let terrain = TerrainManifest::read(dir).map_err(|error| in_folder(dir, &error))?;
            progress.start("verify", count(&terrain), "tiles");
            bake::verify(dir, &advance)
        }
    };
    progress.clear();
    let report = result.map_err(|error| in_folder(dir, &error))?;
    if report.faults.is_empty() {
        let mut out = std::io::stdout().lock();
        writeln!(out, "{}: {} tiles, all good", dir.display(), report.tiles)?;
        return Ok(ExitCode::SUCCESS);
    }
    for (address, fault) in &report.faults {
        let _ = writeln!(std::io::stderr(), "tile {address}: {fault}");
    }
    let mut bad: Vec<_> = report.faults.iter().map(|(address, _)| address).collect();
    bad.dedup();
    Err(format!(
        "{}: {} of {} tiles are bad; bake the terrain again",
        dir.display(),
        bad.len(),
        report.tiles
    )
    .into())
}

/// The archive at `path`; `None` where a folder is there, or nothing.
fn open_archive(path: &Path) -> Result<Option<TerrainArchive>, ArchiveError> {
    if path.is_file() {
        TerrainArchive::open_file(path).map(Some)
    } else {
        Ok(None)
    }
}

/// Density settings in a line.
pub fn describe(settings: &DensitySettings) -> String {
    let mut text = format!(
        "{} curvature, gain {}, exponent {}",
        settings.filter, settings.gain, settings.exponent
    );
    if !settings.preprocess {
        text += ", not spread";
    } else if settings.filter_size > 1 {
        // Half of an even side, to the left and to the right, is the next odd side.
        let side = 2 * (settings.filter_size / 2) + 1;
        text += &format!(", spread over {side} x {side} texels");
    }
    if settings.border == DensityBorder::PointSampled {
        text += &format!(
            ", borders point-sampled, right at level {}",
            settings.lod_skip
        );
    }
    text
}
