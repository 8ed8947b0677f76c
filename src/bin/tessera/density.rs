//! `tessera density`, and the options that it shares with the commands that bake.

use crate::inspect::describe;
use crate::progress::Bar;
use crate::text::{in_folder, named, peak_memory_mib};
use bevy_tessera::bake;
use bevy_tessera::density::{DensityBorder, DensityFilter, DensitySettings, DensitySettingsError};
use bevy_tessera::terrain::TerrainManifest;
use clap::Args;
use std::error::Error;
use std::io::Write;
use std::path::Path;
use std::process::ExitCode;

/// How densities follow from heights; what isn't given stays as it is.
#[derive(Args)]
#[command(next_help_heading = "Density")]
pub struct DensityArgs {
    /// Estimate of curvature: `mean` suits most ground; `principal` also sees symmetric saddles.
    #[arg(long, value_name = "FILTER", value_parser = named(DensityFilter::ALL, DensityFilter::name))]
    filter: Option<DensityFilter>,
    /// Scale of curvature before it is clamped, 0.001 to 1000: higher spends triangles on gentler
    /// ground. [1 for a new terrain]
    #[arg(long, value_name = "FACTOR", allow_hyphen_values = true)]
    gain: Option<f32>,
    /// Exponent of density, 0.05 to 20: above 1 keeps triangles for the sharpest ground. [1 for a
    /// new terrain]
    #[arg(long, value_name = "EXPONENT", allow_hyphen_values = true)]
    exponent: Option<f32>,
    /// Side in texels (of 4 x 4 samples) of the square over which densities spread, 1 to 32; it
    /// reaches as far to every side, so that even sides count as the next odd one. [1 for a new
    /// terrain: they don't]
    #[arg(
        long,
        value_name = "TEXELS",
        allow_hyphen_values = true,
        value_parser = crate::text::whole(DensitySettings::FILTER_SIZE_RANGE)
    )]
    filter_size: Option<u32>,
    /// Level at which point-sampled borders are about right, 0 to 4. [1 for a new terrain]
    #[arg(
        long,
        value_name = "LEVELS",
        allow_hyphen_values = true,
        value_parser = crate::text::whole(DensitySettings::LOD_SKIP_RANGE)
    )]
    lod_skip: Option<u32>,
    /// Spread nothing, to see what the filter sees.
    #[arg(long, overrides_with = "preprocess")]
    no_preprocess: bool,
    /// Spread densities as --filter-size and --lod-skip say; undoes an earlier --no-preprocess.
    #[arg(long)]
    preprocess: bool,
    /// Texels along tiles' borders in coarser levels: like all others, or point-sampled so that a
    /// border is the same at all levels.
    #[arg(long, value_name = "SCHEME", value_parser = named(DensityBorder::ALL, DensityBorder::name))]
    border: Option<DensityBorder>,
}

impl DensityArgs {
    /// `base` with what was given.
    pub fn over(&self, base: DensitySettings) -> Result<DensitySettings, DensitySettingsError> {
        let mut settings = base;
        settings.filter = self.filter.unwrap_or(settings.filter);
        settings.gain = self.gain.unwrap_or(settings.gain);
        settings.exponent = self.exponent.unwrap_or(settings.exponent);
        settings.filter_size = self.filter_size.unwrap_or(settings.filter_size);
        settings.lod_skip = self.lod_skip.unwrap_or(settings.lod_skip);
        settings.border = self.border.unwrap_or(settings.border);
        settings.preprocess = match (self.no_preprocess, self.preprocess) {
            (true, _) => false,
            (_, true) => true,
            _ => settings.preprocess,
        };
        settings.validate()?;
        Ok(settings)
    }
}

/// Bakes the densities of the terrain in `dir` anew.
pub fn density(dir: &Path, args: &DensityArgs) -> Result<ExitCode, Box<dyn Error>> {
    // Where a bake was killed between its last two steps, the terrain isn't there yet.
    let folder = dir.canonicalize().unwrap_or_else(|_| dir.to_owned());
    bake::put_right(&folder)?;
    let terrain = TerrainManifest::read(dir).map_err(|error| in_folder(dir, &error))?;
    let settings = args.over(terrain.file.density)?;
    let progress = Bar::default();
    let result = bake::rebake_densities(dir, &settings, &progress);
    progress.clear();
    let report = result?;
    let mut out = std::io::stdout().lock();
    writeln!(out, "{}: {}", dir.display(), describe(&settings))?;
    writeln!(
        out,
        "{} tiles, {:.1} MB; the finest have a mean density of {:.3}",
        report.tiles,
        report.bytes as f64 / 1e6,
        report.mean
    )?;
    let seconds = report.elapsed.as_secs_f64();
    write!(
        out,
        "made in {seconds:.2} s, {:.1} million samples a second",
        report.samples as f64 / seconds.max(1e-9) / 1e6
    )?;
    match peak_memory_mib() {
        Some(peak) => writeln!(out, ", {peak} MiB of memory at most")?,
        None => writeln!(out)?,
    }
    Ok(ExitCode::SUCCESS)
}
