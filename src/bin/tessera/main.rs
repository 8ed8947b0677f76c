//! `tessera`: bakes height maps into terrains, makes terrains of nothing, and looks at terrains.

mod apply;
mod archive;
mod bake;
mod density;
mod generate;
mod inspect;
mod mesh;
mod preview;
mod progress;
mod text;

use clap::{Parser, Subcommand};
use std::error::Error;
use std::io::Write;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::process::ExitCode;

/// Terrain tools: bake height maps into terrains, generate, look at and verify terrains.
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
    ///
    /// What takes one machine too long, several can bake: `--shard 3/8` bakes the third of eight
    /// parts, and `tessera merge` joins them. Give --height-range-m where it is known, or each shard
    /// reads the whole file for it.
    Bake(bake::BakeArgs),
    /// Join the parts that `tessera bake --shard` made to the terrain that one bake would have made.
    ///
    /// Checks every tile, that neighbours are equal bit for bit in what both hold, and that all parts
    /// are there and of one bake. Tiles are linked where parts and terrain lie on one file system, and
    /// copied where not; the parts stay as they are, and may be deleted.
    Merge(bake::MergeArgs),
    /// Make a terrain of nothing: fractal noise, or diamond-square.
    ///
    /// The same options make the same bytes on every machine.
    Generate(generate::GenerateArgs),
    /// Make a terrain's densities anew, without touching its heights.
    ///
    /// What isn't given stays as the terrain has it. The result is what a bake of the same heights
    /// would make. Stopped half-way, it leaves the terrain as it was.
    Density {
        /// The terrain's folder.
        dir: PathBuf,
        #[command(flatten)]
        density: density::DensityArgs,
    },
    /// Bake edits that were made in a game into a copy of the terrain.
    ///
    /// The log is a file of edits as games save it, binary or RON. The new terrain's heights are those
    /// that a game has which applies the log, byte for byte. Tiles that no edit reaches are linked where
    /// the file system can. Stopped half-way, it leaves nothing.
    Apply(apply::ApplyArgs),
    /// Draw a terrain from above: shaded relief, densities (red where high, green where low), and
    /// both blended.
    Preview(preview::PreviewArgs),
    /// Write the mesh that a camera sees at a place, all around it, for other programs.
    ///
    /// It is what a game draws there once all tiles have streamed in: watertight, vertices shared,
    /// with normals, right-handed with y up. OBJ has metres from the terrain's first sample; glTF
    /// the same by a translation of its node, near the eye. Reads only the tiles that the view needs.
    Mesh(mesh::MeshArgs),
    /// Pack a terrain's folder into an archive: one file, a fraction of the size.
    ///
    /// The archive is a PMTiles file that any web server can serve. Packing is lossless: `unpack`
    /// gives the folder back, byte for byte. What else lies in the folder is not packed.
    Pack(archive::PackArgs),
    /// Make a terrain's folder of an archive.
    Unpack(archive::UnpackArgs),
    /// Print what a terrain holds, or which part of one a folder is.
    Inspect {
        /// The terrain's folder, its archive, or a part's folder.
        dir: PathBuf,
    },
    /// Check every tile of a terrain and name each bad one.
    ///
    /// Checks magic, version, address and checksum, that neighbours are equal bit for bit in what
    /// both hold, that every tile's parent is stored, and that the index covers every tile and its
    /// children. Exits with 1 where something is wrong.
    Verify {
        /// The terrain's folder, or its archive.
        dir: PathBuf,
    },
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
        Command::Bake(args) => bake::bake(&args),
        Command::Merge(args) => bake::merge(&args),
        Command::Generate(args) => generate::generate(&args),
        Command::Density { dir, density } => density::density(&dir, &density),
        Command::Apply(args) => apply::apply(&args),
        Command::Preview(args) => preview::preview(&args),
        Command::Mesh(args) => mesh::mesh(&args),
        Command::Pack(args) => archive::pack(&args),
        Command::Unpack(args) => archive::unpack(&args),
        Command::Inspect { dir } => inspect::inspect(&dir),
        Command::Verify { dir } => inspect::verify(&dir),
    }
}
