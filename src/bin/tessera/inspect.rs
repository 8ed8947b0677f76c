//! `tessera inspect` and `tessera verify`.

use crate::progress::Bar;
use crate::text::{in_folder, metres, metres_in_table, rounded};
use bevy_tessera::bake::{self, BakeProgress};
use bevy_tessera::terrain::{DensityBorder, DensitySettings, TerrainManifest};
use std::error::Error;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

pub fn inspect(dir: &Path) -> Result<ExitCode, Box<dyn Error>> {
    let terrain = TerrainManifest::read(dir).map_err(|error| in_folder(dir, &error))?;
    let file = &terrain.file;
    let mut out = std::io::stdout().lock();
    let [width, height] = file.size;
    let side = |samples: u32| f64::from(samples - 1) * file.spacing_m / 1000.0;
    writeln!(out, "terrain   {}", dir.display())?;
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
    writeln!(out, "density   {}", describe(&file.density))?;
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

pub fn verify(dir: &Path) -> Result<ExitCode, Box<dyn Error>> {
    let tiles = TerrainManifest::read(dir)
        .map_err(|error| in_folder(dir, &error))?
        .index
        .iter()
        .count() as u64;
    let progress = Bar::default();
    progress.start("verify", tiles, "tiles");
    let result = bake::verify(dir, &|tiles| progress.advance(tiles));
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
