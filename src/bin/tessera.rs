//! `tessera`: bakes height maps into terrains, and looks at terrains.

use bevy_tessera::bake::import::{self, ImportSettings, Packing};
use bevy_tessera::bake::{self, BakeProgress, BakeReport, BakeSettings, BakeStage};
use bevy_tessera::terrain::{DensitySettings, TerrainManifest};
use clap::{Args, Parser, Subcommand};
use indicatif::{HumanCount, ProgressBar, ProgressState, ProgressStyle};
use std::error::Error;
use std::fmt;
use std::io::{IsTerminal, Write};
use std::ops::RangeInclusive;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;

/// Terrain tools: bake height maps into terrains, inspect and verify terrains.
#[derive(Parser)]
#[command(name = "tessera", version)]
struct Cli {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Bake a height map into a terrain's folder.
    ///
    /// Reads PNG (grey of 1 to 16 bit, or heights packed into colours), TIFF and GeoTIFF (8 to 64
    /// bit integers, 16 to 64 bit floats), OpenEXR, SRTM .hgt, and raw .r16 and .r32. Samples
    /// without data are filled from their surroundings and counted.
    Bake(BakeArgs),
    /// Print what a terrain holds.
    Inspect {
        /// The terrain's folder.
        dir: PathBuf,
    },
    /// Check every tile of a terrain and name each bad one.
    ///
    /// Checks magic, version, address and checksum, that neighbours are equal bit for bit in what
    /// both hold, that every tile's parent is stored, and that the index covers every tile and its
    /// children. Exits with 1 where something is wrong.
    Verify {
        /// The terrain's folder.
        dir: PathBuf,
    },
}

#[derive(Args)]
struct BakeArgs {
    /// The height map.
    input: PathBuf,
    /// The terrain's folder, which will be made.
    #[arg(long, short, value_name = "DIR")]
    out: PathBuf,
    /// Metres between samples; what the file says, or 1, unless given.
    #[arg(long, value_name = "METRES")]
    spacing_m: Option<f64>,
    /// Heights in metres that the terrain can store, as LO..HI; those of the file with headroom
    /// unless given. For files whose numbers have no meaning of their own (grey PNG, unsigned
    /// TIFF, .r16, rgb24) also what their lowest and highest number stand for.
    #[arg(long, value_name = "LO..HI", allow_hyphen_values = true, value_parser = range)]
    height_range_m: Option<RangeInclusive<f64>>,
    /// Metres kept free below and above the file's heights, for digging and piling up.
    #[arg(long, value_name = "METRES", default_value_t = bake::DEFAULT_HEADROOM_M)]
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
    #[arg(long, value_name = "WIDTHxHEIGHT", value_parser = size)]
    size: Option<[u32; 2]>,
    /// How heights are packed into the colours of a PNG file.
    #[arg(long, value_enum)]
    packing: Option<Packing>,
    /// Read a raw file's numbers with their most significant byte first.
    #[arg(long)]
    big_endian: bool,
    /// Scale of curvature before it is clamped to a density: higher spends triangles on gentler
    /// ground.
    #[arg(long, value_name = "FACTOR", default_value_t = DensitySettings::DEFAULT_GAIN)]
    density_gain: f32,
    /// Exponent of density: above 1 keeps triangles for the roughest ground.
    #[arg(long, value_name = "EXPONENT", default_value_t = 1.0)]
    density_exponent: f32,
    /// Replace a terrain that exists.
    #[arg(long)]
    force: bool,
}

fn range(text: &str) -> Result<RangeInclusive<f64>, String> {
    let wanted = || format!("a range is written LO..HI, as in -100..6453.5, not {text:?}");
    let (low, high) = text.split_once("..").ok_or_else(wanted)?;
    let high = high.strip_prefix('=').unwrap_or(high);
    let number = |text: &str| text.trim().parse::<f64>().map_err(|_| wanted());
    Ok(number(low)?..=number(high)?)
}

fn size(text: &str) -> Result<[u32; 2], String> {
    let wanted = || format!("a size is written WIDTHxHEIGHT, as in 1025x1025, not {text:?}");
    let (width, height) = text.split_once(['x', 'X']).ok_or_else(wanted)?;
    let number = |text: &str| text.trim().parse::<u32>().map_err(|_| wanted());
    Ok([number(width)?, number(height)?])
}

fn main() -> ExitCode {
    // A decoder that panics is caught and told in a sentence; the panic's own report is noise.
    std::panic::set_hook(Box::new(|_| {}));
    let cli = Cli::parse();
    match catch_unwind(AssertUnwindSafe(|| run(cli.command))) {
        Ok(Ok(code)) => code,
        Ok(Err(error)) => {
            say_error(&error.to_string());
            ExitCode::FAILURE
        }
        Err(panic) => {
            let message = panic
                .downcast_ref::<String>()
                .map(String::as_str)
                .or_else(|| panic.downcast_ref::<&str>().copied())
                .unwrap_or("no reason given");
            say_error(&format!("internal error, please report it: {message}"));
            ExitCode::from(101)
        }
    }
}

/// One line on standard error; a reader that has gone away is no reason to panic.
fn say_error(message: &str) {
    let line = message.replace(['\n', '\r'], " ");
    let _ = writeln!(std::io::stderr(), "tessera: {line}");
}

fn run(command: Command) -> Result<ExitCode, Box<dyn Error>> {
    match command {
        Command::Bake(args) => bake(&args),
        Command::Inspect { dir } => inspect(&dir),
        Command::Verify { dir } => verify(&dir),
    }
}

fn bake(args: &BakeArgs) -> Result<ExitCode, Box<dyn Error>> {
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
        density: DensitySettings {
            gain: args.density_gain,
            exponent: args.density_exponent,
            ..Default::default()
        },
        force: args.force,
        ..Default::default()
    };
    let mut source = import::open(&args.input, &import)?;
    let notes = source.notes();
    let has_spacing = args.spacing_m.or(source.spacing_m()).is_some();
    let progress = Bar::default();
    let result = bake::bake(&mut *source, &args.out, &settings, &progress);
    progress.clear();
    let report = result?;

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
    print_report(&mut out, &args.out, &report)?;
    Ok(ExitCode::SUCCESS)
}

fn print_report(out: &mut impl Write, dir: &Path, report: &BakeReport) -> std::io::Result<()> {
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
    let range = &report.height_range_m;
    write!(
        out,
        "heights: {}..{} m in steps of {} m",
        rounded(*range.start()),
        rounded(*range.end()),
        rounded(report.height_step_m)
    )?;
    match report.source_range_m {
        Some((low, high)) => {
            writeln!(out, " (the file has {}..{} m)", rounded(low), rounded(high))?
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
    write!(
        out,
        "baked in {:.2} s, {:.1} million samples a second",
        report.elapsed.as_secs_f64(),
        report.samples_per_second() / 1e6
    )?;
    match peak_memory_mib() {
        Some(peak) => writeln!(out, ", {peak} MiB of memory at most"),
        None => writeln!(out),
    }
}

/// A number with as many decimals as it needs, at most six.
fn rounded(value: f64) -> String {
    let text = format!("{value:.6}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

/// The most memory that this process has had, where the system tells.
fn peak_memory_mib() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status
        .lines()
        .find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib / 1024)
}

fn inspect(dir: &Path) -> Result<ExitCode, Box<dyn Error>> {
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
        rounded(file.height_m(0)),
        rounded(file.height_m(u16::MAX)),
        rounded(file.height_step_m)
    )?;
    writeln!(
        out,
        "density   {:?} curvature, gain {}, exponent {}",
        file.density.filter, file.density.gain, file.density.exponent
    )?;
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
                "{:.1}..{:.1} m",
                file.height_m(range.min),
                file.height_m(range.max)
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

fn verify(dir: &Path) -> Result<ExitCode, Box<dyn Error>> {
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

fn in_folder(dir: &Path, error: &dyn Error) -> String {
    format!("{} is no terrain that can be used: {error}", dir.display())
}

/// A progress bar with rate and time left, which `indicatif` hides unless standard error is a
/// terminal.
#[derive(Default)]
struct Bar {
    bar: Mutex<Option<ProgressBar>>,
}

impl Bar {
    fn start(&self, what: &'static str, length: u64, unit: &str) {
        if !std::io::stderr().is_terminal() {
            return;
        }
        let bar = ProgressBar::new(length);
        let style = format!(
            "{{msg:>7}} [{{wide_bar}}] {{percent:>3}} %  {{human_pos}} {unit}, {{rate}}/s, \
             {{eta}} left"
        );
        if let Ok(style) = ProgressStyle::with_template(&style) {
            let style =
                style.with_key("rate", |state: &ProgressState, out: &mut dyn fmt::Write| {
                    let _ = write!(out, "{}", HumanCount(state.per_sec() as u64));
                });
            bar.set_style(style.progress_chars("=> "));
        }
        bar.set_message(what);
        self.replace(Some(bar));
    }

    fn replace(&self, bar: Option<ProgressBar>) {
        let mut held = self.bar.lock().unwrap_or_else(|poison| poison.into_inner());
        if let Some(old) = held.take() {
            old.finish_and_clear();
        }
        *held = bar;
    }

    fn clear(&self) {
        self.replace(None);
    }
}

impl BakeProgress for Bar {
    fn stage(&self, stage: BakeStage, samples: u64) {
        let what = match stage {
            BakeStage::Survey => "survey",
            BakeStage::Fill => "fill",
            BakeStage::Bake => "bake",
            _ => return self.clear(),
        };
        self.start(what, samples, "samples");
    }

    fn advance(&self, samples: u64) {
        let held = self.bar.lock().unwrap_or_else(|poison| poison.into_inner());
        if let Some(bar) = held.as_ref() {
            bar.inc(samples);
        }
    }
}
