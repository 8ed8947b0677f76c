//! `tessera preview`.

use crate::text::{named, of_terrain, rounded, significant, whole};
use bevy_tessera::bake::{self, PreviewKind, PreviewSettings};
use bevy_tessera::terrain::MAX_LEVELS;
use clap::Args;
use std::error::Error;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Args)]
pub struct PreviewArgs {
    /// The terrain's folder.
    dir: PathBuf,
    /// The picture, a PNG file; a preview that exists is replaced, and no other file.
    #[arg(long, short, value_name = "PNG")]
    out: PathBuf,
    /// What is drawn; `all` is the three others side by side.
    #[arg(long, value_name = "KIND", value_parser = named(PreviewKind::ALL, PreviewKind::name), default_value = "all")]
    kind: PreviewKind,
    /// Longest side of one picture in pixels, 16 to 8192.
    #[arg(
        long,
        value_name = "PIXELS",
        default_value_t = PreviewSettings::default().max_size_px,
        allow_hyphen_values = true,
        value_parser = whole(PreviewSettings::MAX_SIZE_RANGE)
    )]
    max_size: u32,
    /// Level that is drawn; the finest that fits unless given.
    #[arg(
        long,
        value_name = "LEVEL",
        allow_hyphen_values = true,
        value_parser = whole(0..=MAX_LEVELS - 1)
    )]
    level: Option<u8>,
    /// Where the sun stands, in degrees from north by east.
    #[arg(
        long,
        value_name = "DEGREES",
        default_value_t = 315.0,
        allow_hyphen_values = true
    )]
    sun_azimuth: f64,
    /// How high the sun stands, in degrees.
    #[arg(
        long,
        value_name = "DEGREES",
        default_value_t = 45.0,
        allow_hyphen_values = true
    )]
    sun_altitude: f64,
    /// Factor of slopes in the shading; what makes the relief readable unless given, 1 for true
    /// slopes.
    #[arg(long, value_name = "FACTOR", allow_hyphen_values = true)]
    exaggeration: Option<f64>,
}

pub fn preview(args: &PreviewArgs) -> Result<ExitCode, Box<dyn Error>> {
    let settings = PreviewSettings {
        kind: args.kind,
        max_size_px: args.max_size,
        level: args.level,
        sun_azimuth_deg: args.sun_azimuth,
        sun_altitude_deg: args.sun_altitude,
        exaggeration: args.exaggeration,
    };
    let report = bake::preview(&args.dir, &args.out, &settings)
        .map_err(|error| of_terrain(&args.dir, error))?;
    let mut out = std::io::stdout().lock();
    let [width, height] = report.size_px;
    writeln!(
        out,
        "{}: {width} x {height} pixels, level {}, {} m a pixel, slopes {} times as steep",
        args.out.display(),
        report.level,
        rounded(report.pixel_m),
        significant(report.exaggeration)
    )?;
    if report.coarser_tiles > 0 {
        writeln!(
            out,
            "{} tiles are not stored at that level and were drawn from coarser ones",
            report.coarser_tiles
        )?;
    }
    for warning in &report.warnings {
        let _ = writeln!(std::io::stderr(), "{warning}");
    }
    Ok(ExitCode::SUCCESS)
}
