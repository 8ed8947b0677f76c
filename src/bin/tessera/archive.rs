//! `tessera pack` and `tessera unpack`.

use crate::progress::Bar;
use crate::text::of_terrain;
use bevy_tessera::archive::{self, ArchiveReport, TerrainArchive};
use clap::Args;
use std::error::Error;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;

#[derive(Args)]
pub struct PackArgs {
    /// The terrain's folder.
    dir: PathBuf,
    /// The archive, whose name ends in .pmtiles.
    #[arg(long, short, value_name = "FILE")]
    out: PathBuf,
    /// Replace a terrain archive that exists.
    #[arg(long)]
    force: bool,
}

#[derive(Args)]
pub struct UnpackArgs {
    /// The archive.
    file: PathBuf,
    /// The terrain's folder, which will be made.
    #[arg(long, short, value_name = "DIR")]
    out: PathBuf,
    /// Replace a terrain that exists.
    #[arg(long)]
    force: bool,
}

pub fn pack(args: &PackArgs) -> Result<ExitCode, Box<dyn Error>> {
    let progress = Bar::default();
    let result = archive::write_archive(&args.dir, &args.out, args.force, &progress);
    progress.clear();
    let report = result.map_err(|error| of_terrain(&args.dir, error))?;
    let mut out = std::io::stdout().lock();
    write!(out, "{}: ", args.out.display())?;
    print_report(&mut out, &report, "packed")?;
    Ok(ExitCode::SUCCESS)
}

pub fn unpack(args: &UnpackArgs) -> Result<ExitCode, Box<dyn Error>> {
    if args.file.is_dir() {
        return Err(format!(
            "{} is a folder, not an archive; give a file that `tessera pack` made",
            args.file.display()
        )
        .into());
    }
    let archive = TerrainArchive::open_file(&args.file)?;
    let progress = Bar::default();
    let result = archive::unpack_archive(&archive, &args.out, args.force, &progress);
    progress.clear();
    let report = result?;
    let mut out = std::io::stdout().lock();
    write!(out, "{}: ", args.out.display())?;
    print_report(&mut out, &report, "unpacked")?;
    Ok(ExitCode::SUCCESS)
}

/// Sizes of folder and archive, and how long it took.
pub fn print_report(
    out: &mut impl Write,
    report: &ArchiveReport,
    done: &str,
) -> std::io::Result<()> {
    let (folder, archive) = (report.folder_bytes as f64, report.archive_bytes as f64);
    let seconds = report.elapsed.as_secs_f64();
    writeln!(
        out,
        "{} tiles, {:.1} MB as a folder, {:.1} MB as an archive ({:.1} %)",
        report.tiles,
        folder / 1e6,
        archive / 1e6,
        100.0 * archive / folder
    )?;
    writeln!(
        out,
        "{done} in {seconds:.2} s, {:.0} MB of folder a second",
        folder / 1e6 / seconds.max(1e-9)
    )
}
