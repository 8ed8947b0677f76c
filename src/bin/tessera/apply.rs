//! `tessera apply`.

use crate::progress::Bar;
use crate::text::{in_folder, peak_memory_mib};
use bevy_tessera::bake;
use bevy_tessera::edit::EditLog;
use bevy_tessera::terrain::TerrainManifest;
use clap::Args;
use std::error::Error;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Args)]
pub struct ApplyArgs {
    /// The terrain's folder.
    dir: PathBuf,
    /// The file of edits.
    log: PathBuf,
    /// The new terrain's folder.
    #[arg(long, short, value_name = "DIR")]
    out: PathBuf,
    /// Replace a terrain that exists; may be the first folder itself.
    #[arg(long)]
    force: bool,
}

pub fn apply(args: &ApplyArgs) -> Result<ExitCode, Box<dyn Error>> {
    let folder = args.dir.canonicalize().unwrap_or_else(|_| args.dir.clone());
    bake::put_right(&folder)?;
    let terrain = TerrainManifest::read(&args.dir).map_err(|error| in_folder(&args.dir, &error))?;
    let log = EditLog::load(&args.log)?;
    log.check_terrain(&terrain.file)
        .map_err(|error| format!("{} can't be applied: {error}", args.log.display()))?;
    let progress = Bar::default();
    let result = bake::apply_edits(&args.dir, &log, &args.out, args.force, &progress);
    progress.clear();
    let report = result?;
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "{}: {} tiles with {} edits; {} tiles changed, {:.1} MB written",
        args.out.display(),
        report.tiles,
        report.edits,
        report.changed,
        report.bytes as f64 / 1e6
    )?;
    write!(out, "applied in {:.2} s", report.elapsed.as_secs_f64())?;
    match peak_memory_mib() {
        Some(peak) => writeln!(out, ", {peak} MiB of memory at most")?,
        None => writeln!(out)?,
    }
    Ok(ExitCode::SUCCESS)
}
