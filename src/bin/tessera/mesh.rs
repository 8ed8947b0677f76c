//! `tessera mesh`.

use crate::progress::Bar;
use crate::text::{of_terrain, peak_memory_mib, rounded, whole};
use bevy_tessera::lattice::LodSettings;
use bevy_tessera::mesh_export::{MeshEye, MeshReport, MeshSettings, export_mesh};
use bevy_tessera::tessellate::Partitioning;
use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use glam::{DVec2, DVec3};
use std::error::Error;
use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Once;
use std::time::Instant;

const DEFAULT_EYE: MeshEye = MeshEye::At(DVec3::ZERO);

/// The defaults, which are the library's.
fn default() -> MeshSettings {
    MeshSettings::new(DEFAULT_EYE)
}

#[derive(Args)]
pub struct MeshArgs {
    /// The terrain's folder.
    dir: PathBuf,
    /// The mesh, a file that ends in .obj (Wavefront) or .glb (binary glTF); a mesh that exists is
    /// replaced, and no other file.
    #[arg(long, short, value_name = "FILE")]
    out: PathBuf,
    /// Where the eye is, in metres from the terrain's first sample, y up; X,Z with --above.
    #[arg(
        long,
        value_name = "X,Y,Z",
        allow_hyphen_values = true,
        value_delimiter = ',',
        required = true
    )]
    eye: Vec<f64>,
    /// Put the eye so far above the ground at X,Z.
    #[arg(long, value_name = "METRES", allow_hyphen_values = true)]
    above: Option<f64>,
    /// Replace a file that is no such mesh; a part of a terrain never is.
    #[arg(long)]
    force: bool,
    #[command(flatten)]
    camera: CameraArgs,
    #[command(flatten)]
    terrain: TerrainArgs,
}

/// What a camera is told in a game.
#[derive(Args)]
#[command(next_help_heading = "Camera")]
struct CameraArgs {
    /// Wanted length of a triangle's edge on the screen where the ground is roughest, 1 to 256.
    #[arg(
        long,
        value_name = "PIXELS",
        default_value_t = default().triangle_width_px,
        allow_hyphen_values = true
    )]
    triangle_width_px: f64,
    /// The most that a height may be off on the screen, 0.1 to 64: decides how finely the ground is
    /// cut, in place of triangle width and density map.
    #[arg(long, value_name = "PIXELS", allow_hyphen_values = true)]
    max_error_px: Option<f64>,
    /// Height of the viewport, 1 to 65536.
    #[arg(
        long,
        value_name = "PIXELS",
        default_value_t = default().height_px,
        allow_hyphen_values = true
    )]
    height_px: f64,
    /// Vertical field of view, 1 to 179.
    #[arg(
        long,
        value_name = "DEGREES",
        default_value_t = default().fov_deg,
        allow_hyphen_values = true
    )]
    fov_deg: f64,
    /// How far the density map counts, 0 (not at all) to 1.
    #[arg(
        long,
        value_name = "STRENGTH",
        default_value_t = default().density,
        allow_hyphen_values = true
    )]
    density: f64,
    /// How an edge's real number of segments becomes whole.
    #[arg(
        long,
        value_name = "KIND",
        default_value = name(default().partitioning),
        value_parser = partitionings()
    )]
    partitioning: Partitioning,
    /// The most segments that an edge of a face is cut into, 1 to 64.
    #[arg(
        long,
        value_name = "SEGMENTS",
        default_value_t = default().max_factor,
        allow_hyphen_values = true
    )]
    max_factor: f64,
    /// Cut no edge shorter than this; the spacing of the terrain's samples unless given, or anything
    /// with --max-error-px.
    #[arg(long, value_name = "METRES", allow_hyphen_values = true)]
    min_triangle_m: Option<f64>,
    /// How far a level of detail reaches, in sizes of its nodes, 2 to 32.
    #[arg(
        long,
        value_name = "NODES",
        default_value_t = default().lod.reach,
        allow_hyphen_values = true
    )]
    reach: f32,
    /// Over which part of that it turns into the next, in sizes of its nodes: a power of two from
    /// 1/16 to 4.
    #[arg(
        long,
        value_name = "NODES",
        default_value_t = default().lod.morph,
        allow_hyphen_values = true
    )]
    morph: f32,
    /// The most vertices, as a camera counts them: before those are made one that faces share. Where
    /// the view wants more, all of it is cut more coarsely.
    #[arg(
        long,
        value_name = "NUMBER",
        default_value_t = default().max_vertices,
        allow_hyphen_values = true,
        value_parser = whole(1024..=1_u32 << 24)
    )]
    max_vertices: u32,
    /// The most triangles; twice as many as vertices unless given.
    #[arg(
        long,
        value_name = "NUMBER",
        allow_hyphen_values = true,
        value_parser = whole(1024..=1_u32 << 25)
    )]
    max_triangles: Option<u32>,
}

/// What a terrain is told in a game.
#[derive(Args)]
#[command(next_help_heading = "Terrain")]
struct TerrainArgs {
    /// Finest level of the geometry: 0 for that of the finest tiles, down to -8 for finer.
    #[arg(
        long,
        value_name = "LEVEL",
        default_value_t = default().leaf_level,
        allow_hyphen_values = true
    )]
    leaf_level: i32,
    /// Faces along a node's side, a power of two from 2 to 32.
    #[arg(
        long,
        value_name = "FACES",
        default_value_t = default().faces_per_side,
        allow_hyphen_values = true
    )]
    faces_per_side: u32,
}

/// A partitioning's name, made of the enum's own, so that every kind that is added has one.
fn name(partitioning: Partitioning) -> &'static str {
    let mut name = String::new();
    for letter in format!("{partitioning:?}").chars() {
        if letter.is_uppercase() && !name.is_empty() {
            name.push('-');
        }
        name.extend(letter.to_lowercase());
    }
    // The parser wants names that live as long as the program: a handful, in a tool that is done
    // soon.
    name.leak()
}

fn partitionings() -> impl TypedValueParser<Value = Partitioning> {
    let names = Partitioning::ALL.map(|kind| PossibleValue::new(name(kind)));
    PossibleValuesParser::new(names).map(|wanted| {
        let found = Partitioning::ALL
            .into_iter()
            .find(|&kind| name(kind) == wanted);
        found.unwrap_or_default()
    })
}

impl MeshArgs {
    fn settings(&self) -> Result<MeshSettings, String> {
        let eye = match (&self.eye[..], self.above) {
            (&[x, y, z], None) => MeshEye::At(DVec3::new(x, y, z)),
            (&[x, z], Some(above_m)) => MeshEye::AboveGround {
                place_m: DVec2::new(x, z),
                above_m,
            },
            (_, None) => {
                return Err(format!(
                    "--eye is written X,Y,Z, as in 1200,350,800, and has {} numbers; give three, or \
                     X,Z with --above",
                    self.eye.len()
                ));
            }
            (_, Some(_)) => {
                return Err(format!(
                    "with --above, --eye is written X,Z, as in 1200,800, and has {} numbers; give \
                     two, or leave --above out",
                    self.eye.len()
                ));
            }
        };
        let CameraArgs { max_vertices, .. } = self.camera;
        Ok(MeshSettings {
            eye,
            triangle_width_px: self.camera.triangle_width_px,
            max_error_px: self.camera.max_error_px,
            height_px: self.camera.height_px,
            fov_deg: self.camera.fov_deg,
            density: self.camera.density,
            partitioning: self.camera.partitioning,
            max_factor: self.camera.max_factor,
            min_triangle_m: self.camera.min_triangle_m,
            lod: LodSettings {
                reach: self.camera.reach,
                morph: self.camera.morph,
            },
            leaf_level: self.terrain.leaf_level,
            faces_per_side: self.terrain.faces_per_side,
            max_vertices,
            max_triangles: self.camera.max_triangles.unwrap_or(2 * max_vertices),
            force: self.force,
        })
    }
}

pub fn mesh(args: &MeshArgs) -> Result<ExitCode, Box<dyn Error>> {
    let settings = args.settings()?;
    let start = Instant::now();
    let progress = Bar::default();
    let began = Once::new();
    let result = export_mesh(&args.dir, &args.out, &settings, &|faces, all| {
        began.call_once(|| progress.start("mesh", all, "faces"));
        progress.more(faces);
    });
    progress.clear();
    let report = result.map_err(|error| of_terrain(&args.dir, error))?;
    print(args, &report, start)?;
    for warning in &report.warnings {
        let _ = writeln!(std::io::stderr(), "{warning}");
    }
    Ok(ExitCode::SUCCESS)
}

fn print(args: &MeshArgs, report: &MeshReport, start: Instant) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(
        out,
        "{}: {} triangles, {} vertices, {:.1} MB",
        args.out.display(),
        report.triangles,
        report.vertices,
        report.bytes as f64 / 1e6
    )?;
    let [x, y, z] = report.eye_m.to_array().map(rounded);
    writeln!(
        out,
        "seen from {x},{y},{z}; {} of {} tiles were read",
        report.tiles_read, report.tiles
    )?;
    if report.scale > 0 {
        writeln!(
            out,
            "note: the view wants more, and was cut 1/{} as finely to keep within --max-vertices and \
             --max-triangles",
            1_u32 << report.scale
        )?;
    }
    if !report.fits {
        writeln!(
            out,
            "note: that is more than --max-vertices or --max-triangles allows, but nothing coarser \
             can be made with this --reach and --faces-per-side"
        )?;
    }
    write!(out, "made in {:.2} s", start.elapsed().as_secs_f64())?;
    match peak_memory_mib() {
        Some(peak) => writeln!(out, ", {peak} MiB of memory at most"),
        None => writeln!(out),
    }
}
