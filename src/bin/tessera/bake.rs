//! `tessera bake`.

use crate::archive::print_report as print_packed;
use crate::density::DensityArgs;
use crate::progress::Bar;
use crate::text::{metres, peak_memory_mib, range, rounded, size};
use bevy_tessera::archive;
use bevy_tessera::bake::import::{self, ImportSettings, Packing};
use bevy_tessera::bake::shard::{self, PartFile, Shard, ShardReport};
use bevy_tessera::bake::{self, BakeError, BakeReport, BakeSettings, HeightSource};
use bevy_tessera::density::DensitySettings;
use clap::Args;
use std::error::Error;
use std::io::Write;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

#[derive(Args)]
pub struct BakeArgs {
    /// The height map.
    input: PathBuf,
    /// The terrain's folder, which will be made; with --archive the archive's file, with --shard the
    /// part's folder.
    #[arg(long, short, value_name = "DIR")]
    out: PathBuf,
    /// Bake part I of N only, counted from 1, for `tessera merge` to join: every machine bakes one
    /// from the same file with the same options. Started again, it goes on where it was stopped.
    #[arg(long, value_name = "I/N")]
    shard: Option<Shard>,
    /// Metres between samples; what the file says, or 1, unless given.
    #[arg(long, value_name = "METRES", allow_hyphen_values = true)]
    spacing_m: Option<f64>,
    /// Heights in metres that the terrain can store, as LO..HI; those of the file with headroom
    /// unless given. For files whose numbers have no meaning of their own (grey PNG, unsigned
    /// TIFF, .r16, rgb24) also what their lowest and highest number stand for.
    #[arg(long, value_name = "LO..HI", allow_hyphen_values = true, value_parser = range)]
    height_range_m: Option<RangeInclusive<f64>>,
    /// Metres kept free below and above the file's heights, for digging and piling up.
    #[arg(
        long,
        value_name = "METRES",
        default_value_t = bake::DEFAULT_HEADROOM_M,
        allow_hyphen_values = true
    )]
    headroom_m: f64,
    /// Metres a unit of the file's numbers.
    #[arg(long, value_name = "METRES", allow_hyphen_values = true)]
    height_scale: Option<f64>,
    /// Metres of the file's number 0.
    #[arg(long, value_name = "METRES", allow_hyphen_values = true)]
    height_offset: Option<f64>,
    /// Number in the file that says that there is no data.
    #[arg(long, value_name = "NUMBER", allow_hyphen_values = true)]
    no_data: Option<f64>,
    /// Size of a raw file in samples.
    #[arg(long, value_name = "WIDTHxHEIGHT", allow_hyphen_values = true, value_parser = size)]
    size: Option<[u32; 2]>,
    /// How heights are packed into the colours of a PNG file.
    #[arg(long, value_enum)]
    packing: Option<Packing>,
    /// Read a raw file's numbers with their most significant byte first.
    #[arg(long)]
    big_endian: bool,
    #[command(flatten)]
    density: DensityArgs,
    /// Make an archive, one file that ends in .pmtiles, instead of a folder. While it is made, a
    /// folder lies beside it that takes several times the archive's size.
    #[arg(long, conflicts_with = "shard")]
    archive: bool,
    /// Replace a terrain that exists; with --shard, begin anew what part there is.
    #[arg(long)]
    force: bool,
}

#[derive(Args)]
pub struct MergeArgs {
    /// The parts' folders, in any order.
    #[arg(required = true, value_name = "PART")]
    parts: Vec<PathBuf>,
    /// The terrain's folder, which will be made.
    #[arg(long, short, value_name = "DIR")]
    out: PathBuf,
    /// Replace a terrain that exists.
    #[arg(long)]
    force: bool,
}

pub fn bake(args: &BakeArgs) -> Result<ExitCode, Box<dyn Error>> {
    let import = ImportSettings {
        size: args.size,
        packing: args.packing,
        big_endian: args.big_endian,
        scale: args.height_scale,
        offset: args.height_offset,
        range_m: args.height_range_m.clone(),
        no_data: args.no_data,
    };
    let settings = BakeSettings {
        spacing_m: args.spacing_m,
        height_range_m: args.height_range_m.clone(),
        headroom_m: args.headroom_m,
        density: args.density.over(DensitySettings::default())?,
        force: args.force,
        ..Default::default()
    };
    let mut source = import::open(&args.input, &import)?;
    let notes = source.notes();
    let has_spacing = args.spacing_m.or(source.spacing_m()).is_some();
    let mut packed = None;
    let made = match args.shard {
        None if args.archive => {
            let progress = Bar::default();
            let result = archive::bake_archive(&mut *source, &args.out, &settings, &progress);
            progress.clear();
            let (baked, report) = result?;
            packed = Some(report);
            Made::Terrain(baked)
        }
        None => Made::Terrain(bake_shown(&mut *source, &args.out, &settings)?),
        Some(shard) => {
            let progress = Bar::default();
            let result = shard::bake_shard(&mut *source, &args.out, &settings, shard, &progress);
            progress.clear();
            Made::Part(result?)
        }
    };

    let mut out = std::io::stdout().lock();
    let name = args.input.display();
    for note in notes {
        writeln!(out, "note: {name}: {note}")?;
    }
    if !has_spacing {
        writeln!(
            out,
            "note: {name}: it doesn't say how far its samples lie apart, so 1 m is taken; \
             --spacing-m says otherwise"
        )?;
    }
    match made {
        Made::Terrain(report) => print_report(&mut out, &args.out, &report)?,
        Made::Part(report) => print_part(&mut out, &args.out, &report)?,
    }
    if let Some(packed) = packed {
        print_packed(&mut out, &packed, "packed")?;
    }
    Ok(ExitCode::SUCCESS)
}

/// What a bake made.
enum Made {
    Terrain(BakeReport),
    Part(ShardReport),
}

pub fn merge(args: &MergeArgs) -> Result<ExitCode, Box<dyn Error>> {
    let progress = Bar::default();
    let result = shard::merge(&args.parts, &args.out, args.force, &progress);
    progress.clear();
    let report = result?;
    let mut out = std::io::stdout().lock();
    print_contents(&mut out, &args.out, &report.terrain)?;
    write!(
        out,
        "merged from {} parts ({} tiles linked, {} copied) in {:.2} s",
        report.parts,
        report.linked,
        report.copied,
        report.terrain.elapsed.as_secs_f64()
    )?;
    print_memory(&mut out)?;
    Ok(ExitCode::SUCCESS)
}

fn print_part(out: &mut impl Write, dir: &Path, report: &ShardReport) -> std::io::Result<()> {
    writeln!(out, "{}: {}", dir.display(), describe(&report.part))?;
    let seconds = report.elapsed.as_secs_f64();
    if report.tiles == 0 {
        return Ok(());
    }
    if report.tiles_before == report.tiles {
        write!(
            out,
            "{} tiles, all of them from before, checked in {seconds:.2} s",
            report.tiles
        )?;
        return print_memory(out);
    }
    write!(out, "{} tiles", report.tiles)?;
    if report.tiles_before > 0 {
        write!(out, ", {} of them from before", report.tiles_before)?;
    }
    let samples = f64::from(report.source_rows) * f64::from(report.part.terrain.size[0]);
    write!(
        out,
        ", {:.1} MB from {} rows of samples\nbaked in {seconds:.2} s, {:.1} million samples a second",
        report.bytes as f64 / 1e6,
        report.source_rows,
        samples / seconds.max(1e-9) / 1e6
    )?;
    print_memory(out)
}

/// A part in a line.
pub fn describe(part: &PartFile) -> String {
    let rows = part.rows();
    let done = part.rows_done().len();
    let below = if part.top == 0 {
        ""
    } else {
        " and all tiles below them"
    };
    let all = part.terrain.tiles(part.top)[1];
    let what = match rows.len() {
        0 => "no tiles, since there are more shards than rows of tiles".to_owned(),
        count => format!(
            "tile rows {} to {} of {all} of level {}{below}, {}",
            rows.start + 1,
            rows.end,
            part.top,
            if done == count {
                "complete".to_owned()
            } else {
                format!("{done} of {count} rows complete")
            }
        ),
    };
    format!("shard {}: {what}", part.shard)
}

/// A bake whose progress is shown.
pub fn bake_shown(
    source: &mut dyn HeightSource,
    out: &Path,
    settings: &BakeSettings,
) -> Result<BakeReport, BakeError> {
    let progress = Bar::default();
    let result = bake::bake(source, out, settings, &progress);
    progress.clear();
    result
}

pub fn print_report(out: &mut impl Write, dir: &Path, report: &BakeReport) -> std::io::Result<()> {
    print_contents(out, dir, report)?;
    write!(
        out,
        "baked in {:.2} s, {:.1} million samples a second",
        report.elapsed.as_secs_f64(),
        report.samples_per_second() / 1e6
    )?;
    print_memory(out)
}

/// Ends a line.
fn print_memory(out: &mut impl Write) -> std::io::Result<()> {
    match peak_memory_mib() {
        Some(peak) => writeln!(out, ", {peak} MiB of memory at most"),
        None => writeln!(out),
    }
}

fn print_contents(out: &mut impl Write, dir: &Path, report: &BakeReport) -> std::io::Result<()> {
    let [width, height] = report.size;
    writeln!(
        out,
        "{}: {width} x {height} samples, {} m apart, {} levels, {} tiles, {:.1} MB",
        dir.display(),
        rounded(report.spacing_m),
        report.levels,
        report.tiles,
        report.bytes as f64 / 1e6
    )?;
    let (range, step_m) = (&report.height_range_m, report.height_step_m);
    write!(
        out,
        "heights: {}..{} m in steps of {} m",
        metres(*range.start(), step_m),
        metres(*range.end(), step_m),
        rounded(step_m)
    )?;
    match report.source_range_m {
        Some((low, high)) => {
            let (low, high) = (metres(low, step_m), metres(high, step_m));
            writeln!(out, " (the file has {low}..{high} m)")?
        }
        None => writeln!(out)?,
    }
    if report.clamped > 0 {
        writeln!(
            out,
            "{} samples lay outside that range and were clamped",
            report.clamped
        )?;
    }
    if report.filled > 0 {
        write!(
            out,
            "{} samples had no data and were filled from their surroundings",
            report.filled
        )?;
        match report.fill_block {
            1 => writeln!(out)?,
            block => writeln!(
                out,
                ", from means of {block} x {block} samples, the file being large"
            )?,
        }
    }
    Ok(())
}
