//! A view's mesh as a file for other programs: Wavefront OBJ or binary glTF.
//!
//! [`export_mesh`] makes what a camera sees at a place of a terrain that lies on disk and whose
//! tiles are all resident, by the compute passes' [twin](crate::tessellate). [`Surface`] is what it
//! writes, for those who have a [`TerrainMesh`](crate::tessellate::TerrainMesh) of their own.
//!
//! ```no_run
//! use bevy_tessera::mesh_export::{MeshEye, MeshSettings, export_mesh};
//! use glam::DVec2;
//! use std::path::Path;
//!
//! let settings = MeshSettings::new(MeshEye::AboveGround {
//!     place_m: DVec2::new(1200.0, 800.0),
//!     above_m: 2.0,
//! });
//! let report = export_mesh(Path::new("alps"), Path::new("alps.glb"), &settings, &|_, _| {})?;
//! println!("{} triangles", report.triangles);
//! # Ok::<(), bevy_tessera::mesh_export::MeshError>(())
//! ```

mod error;
mod surface;
mod tiles;
mod view;
mod write;

pub use error::MeshError;
pub use surface::{Surface, SurfaceVertex};

use crate::lattice::{DEFAULT_FACES_PER_SIDE, Lattice, LodSettings, ResidencyField, ViewLod};
use crate::output::{PartialFile, check_place};
use crate::terrain::TerrainManifest;
use crate::tessellate::Partitioning;
use glam::{DVec2, DVec3};
use std::fs::File;
use std::io::{BufWriter, Read, Seek};
use std::path::{Path, PathBuf};
use tiles::{StoredTiles, field_of};
use view::{Cut, View, cut};

/// Bytes at the start of a file that are looked through for the mark.
const HEAD: u64 = 256;

/// Where the eye of a [`MeshSettings`] is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum MeshEye {
    /// At a place in the terrain's own space: metres from its first sample, y up.
    At(DVec3),
    /// Above the ground at `x` and `z`; beside the terrain, above the nearest ground of its rim.
    AboveGround {
        /// x and z in metres from the terrain's first sample.
        place_m: DVec2,
        /// Metres above the ground.
        above_m: f64,
    },
}

/// What a mesh follows from, besides the terrain: what a camera has, and what a terrain in a game
/// has.
#[derive(Clone, Debug, PartialEq)]
pub struct MeshSettings {
    /// Where the eye is. It looks everywhere at once: nothing is left out for being behind it.
    pub eye: MeshEye,
    /// Wanted length of a triangle's edge on the screen where the ground is roughest, in pixels, 1
    /// to 256.
    pub triangle_width_px: f64,
    /// The most that a height may be off on the screen, in pixels, 0.1 to 64: the mesh follows from
    /// that bound and neither from the triangle width nor from the density map. Not unless set.
    pub max_error_px: Option<f64>,
    /// The viewport's height in pixels, 1 to 65536.
    pub height_px: f64,
    /// The vertical field of view in degrees, 1 to 179.
    pub fov_deg: f64,
    /// How far the density map counts, 0 to 1.
    pub density: f64,
    /// How factors become segments.
    pub partitioning: Partitioning,
    /// The most segments that an edge of a face is cut into, 1 to 64.
    pub max_factor: f64,
    /// Edges are not cut shorter than this, in metres along the ground; unless set, the spacing of
    /// the finest samples, or anything where the error decides.
    pub min_triangle_m: Option<f64>,
    /// How far each level of detail reaches.
    pub lod: LodSettings,
    /// Finest level of the geometry: 0 for that of the finest tiles, down to -8.
    pub leaf_level: i32,
    /// Faces along a node's side, a power of two from 2 to 32.
    pub faces_per_side: u32,
    /// The most vertices, 1024 to 2²⁴, counted before those are made one that faces share, as a
    /// camera counts them. Where the view wants more, all its factors are lowered together.
    pub max_vertices: u32,
    /// The most triangles, 1024 to 2²⁵.
    pub max_triangles: u32,
    /// Whether a file that is no mesh of this crate's is replaced.
    pub force: bool,
}

impl MeshSettings {
    /// The default settings with an eye.
    #[must_use]
    pub fn new(eye: MeshEye) -> Self {
        Self {
            eye,
            triangle_width_px: 6.0,
            max_error_px: None,
            height_px: 1080.0,
            fov_deg: 60.0,
            density: 1.0,
            partitioning: Partitioning::default(),
            max_factor: 64.0,
            min_triangle_m: None,
            lod: LodSettings::default(),
            leaf_level: 0,
            faces_per_side: DEFAULT_FACES_PER_SIDE,
            max_vertices: 1 << 20,
            max_triangles: 1 << 21,
            force: false,
        }
    }

    /// The shortest edges, where the finest samples are `spacing_m` apart.
    #[must_use]
    pub fn least_triangle_m(&self, spacing_m: f64) -> f64 {
        let free = match self.max_error_px {
            Some(_) => f64::from(f32::MIN_POSITIVE),
            None => spacing_m,
        };
        self.min_triangle_m.unwrap_or(free)
    }

    /// Checks what doesn't need the terrain.
    ///
    /// # Errors
    /// Names the first number that is out of its range, and the range.
    pub fn validate(&self) -> Result<(), MeshError> {
        let (MeshEye::At(DVec3 { x, z, .. })
        | MeshEye::AboveGround {
            place_m: DVec2 { x, y: z },
            ..
        }) = self.eye;
        let (MeshEye::At(DVec3 { y, .. }) | MeshEye::AboveGround { above_m: y, .. }) = self.eye;
        let far = 1.0e9;
        let smallest = f64::from(f32::MIN_POSITIVE);
        let numbers = [
            ("eye's x", x, -far, far),
            ("eye's height", y, -far, far),
            ("eye's z", z, -far, far),
            (
                "triangle width in pixels",
                self.triangle_width_px,
                1.0,
                256.0,
            ),
            (
                "largest error in pixels",
                self.max_error_px.unwrap_or(1.0),
                0.1,
                64.0,
            ),
            ("viewport's height in pixels", self.height_px, 1.0, 65536.0),
            ("field of view in degrees", self.fov_deg, 1.0, 179.0),
            ("density", self.density, 0.0, 1.0),
            ("largest factor", self.max_factor, 1.0, 64.0),
            (
                "least triangle in metres",
                self.min_triangle_m.unwrap_or(1.0),
                smallest,
                far,
            ),
            (
                "number of vertices",
                self.max_vertices.into(),
                1024.0,
                16_777_216.0,
            ),
            (
                "number of triangles",
                self.max_triangles.into(),
                1024.0,
                33_554_432.0,
            ),
        ];
        for (name, found, least, most) in numbers {
            // Not a number is in no range.
            if !(least..=most).contains(&found) {
                return Err(MeshError::Number {
                    name,
                    found,
                    least,
                    most,
                });
            }
        }
        Ok(self.lod.validate()?)
    }
}

/// What [`export_mesh`] wrote.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct MeshReport {
    /// Vertices of the file.
    pub vertices: u64,
    /// Triangles of the file.
    pub triangles: u64,
    /// Bytes of the file.
    pub bytes: u64,
    /// Where the eye was, in metres from the terrain's first sample.
    pub eye_m: DVec3,
    /// Power of two by which all factors were lowered so that the mesh keeps within its limits.
    pub scale: u32,
    /// Whether it keeps within its limits. The coarsest mesh that there is may not.
    pub fits: bool,
    /// Tiles that were read.
    pub tiles_read: u64,
    /// Tiles that the terrain has.
    pub tiles: u64,
    /// A sentence for each tile that can't be read. The ground there has its parent's shape, as in a
    /// game.
    pub warnings: Vec<String>,
}

/// The formats that can be written.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Format {
    Obj,
    Glb,
}

/// Writes the mesh that a camera sees of the terrain in the folder `dir` to `out`, all around the
/// eye: Wavefront OBJ where that ends in `.obj`, binary glTF where it ends in `.glb`.
///
/// All passes are run by their twin on all cores: classify, setup, vertices, indices. Nothing is
/// culled. Only those tiles are read that the view needs, all of which stay in memory; their number
/// follows from the reach, not from the terrain's size. The mesh takes some 100 bytes a vertex
/// while it is made. `progress` is told how many faces have got further, and of how many in all;
/// each face is counted twice, and again where tiles turn out
/// to be damaged.
///
/// The file is written beside `out`, under another name, and then renamed. An `out` that exists is
/// replaced where it is such a mesh or empty; any other file only if
/// [`force`](MeshSettings::force) is set, and a part of a terrain never.
///
/// # Errors
/// Where settings are out of range, `dir` is no terrain, its root tile can't be read, or `out` can't
/// be written; see [`MeshError`]. What stood at `out` then stands there still.
pub fn export_mesh(
    dir: &Path,
    out: &Path,
    settings: &MeshSettings,
    progress: &(dyn Fn(u64, u64) + Sync),
) -> Result<MeshReport, MeshError> {
    settings.validate()?;
    let (folder, format) = check_output(out, settings.force)?;
    let manifest = TerrainManifest::read(dir).map_err(|reason| MeshError::Terrain {
        path: dir.to_owned(),
        reason: Box::new(reason),
    })?;
    let made = view_surface(dir, &manifest, settings, progress)?;
    let failed = |reason| MeshError::Write {
        path: out.to_owned(),
        reason,
    };
    let (partial, file) = PartialFile::create(&folder, "mesh").map_err(failed)?;
    let mut file = BufWriter::with_capacity(1 << 16, file);
    match format {
        Format::Obj => made.surface.write_obj(&mut file),
        Format::Glb => made.surface.write_glb(&mut file, made.origin_m),
    }
    .map_err(failed)?;
    let mut file = file.into_inner().map_err(|error| failed(error.into()))?;
    let bytes = file.stream_position().map_err(failed)?;
    partial.publish(file, out).map_err(failed)?;
    Ok(MeshReport {
        vertices: made.surface.vertices.len() as u64,
        triangles: made.surface.triangles.len() as u64,
        bytes,
        eye_m: made.eye_m,
        scale: made.scale,
        fits: made.fits,
        tiles_read: made.tiles_read,
        tiles: manifest.index.iter().count() as u64,
        warnings: made.warnings,
    })
}

/// Whether `out` may be written; the folder in which it lies, and what it is to become.
fn check_output(out: &Path, force: bool) -> Result<(PathBuf, Format), MeshError> {
    let path = || out.to_owned();
    let place = check_place(out, "mesh")?;
    let extension = out.extension().unwrap_or_default();
    let format = if extension.eq_ignore_ascii_case("obj") {
        Format::Obj
    } else if extension.eq_ignore_ascii_case("glb") {
        Format::Glb
    } else {
        return Err(MeshError::OutputExtension { path: path() });
    };
    let holds_something = place.metadata.is_some_and(|metadata| metadata.len() > 0);
    if holds_something && !force && !is_mesh(out) {
        return Err(MeshError::OutputExists { path: path() });
    }
    Ok((place.folder, format))
}

/// Whether the file is one that this room wrote. One that can't be read is not known to be.
fn is_mesh(path: &Path) -> bool {
    let mut head = Vec::new();
    let read = File::open(path).and_then(|file| file.take(HEAD).read_to_end(&mut head));
    let mark = format!(r#""generator":"{}""#, write::MARK);
    let is_glb = || {
        head.starts_with(b"glTF")
            && head
                .windows(mark.len())
                .any(|found| found == mark.as_bytes())
    };
    read.is_ok() && (head.starts_with(format!("# {}", write::MARK).as_bytes()) || is_glb())
}

/// What a view draws of a terrain on disk.
struct Made {
    surface: Surface,
    eye_m: DVec3,
    /// What a glTF file's positions are relative to.
    origin_m: DVec3,
    scale: u32,
    fits: bool,
    tiles_read: u64,
    warnings: Vec<String>,
}

fn view_surface(
    dir: &Path,
    manifest: &TerrainManifest,
    settings: &MeshSettings,
    progress: &(dyn Fn(u64, u64) + Sync),
) -> Result<Made, MeshError> {
    let file = &manifest.file;
    let lattice = Lattice::new(
        file.size,
        file.levels,
        settings.leaf_level,
        settings.faces_per_side,
    )?;
    let tiles = StoredTiles::new(dir, manifest);
    // What can't be read counts as not stored, as in a game, where it never arrives.
    let mut index = manifest.index.clone();
    let mut warnings = Vec::new();
    loop {
        let field = field_of(&lattice, &index).ok_or_else(|| MeshError::NoRoot {
            path: dir.to_owned(),
            reason: warnings.first().cloned().unwrap_or_default(),
        })?;
        let eye_m = eye_place(&lattice, manifest, &field, &tiles, settings)?;
        let view = View::new(&lattice, manifest, settings, eye_m)?;
        let mesh = view.mesh(&lattice, manifest, &field, &tiles, settings);
        let Cut {
            meshes,
            scale,
            fits,
        } = cut(&mesh, progress);
        let faults = tiles.take_faults();
        if faults.is_empty() {
            let unit_m = lattice.unit_m(file.spacing_m);
            // At the eye, or at the nearest of the terrain: whole metres, which `f32` holds.
            let last = lattice.extent.as_dvec2() * unit_m;
            let heights = [file.height_m(0), file.height_m(u16::MAX)];
            let highest = DVec3::new(last.x, heights[1], last.y);
            let lowest = DVec3::new(0.0, heights[0], 0.0);
            return Ok(Made {
                surface: Surface::new(meshes, unit_m),
                eye_m,
                origin_m: eye_m.clamp(lowest, highest).round(),
                scale,
                fits,
                tiles_read: tiles.read_count(),
                warnings,
            });
        }
        for fault in faults {
            index.set(fault.address, None);
            warnings.push(format!(
                "{} {}; its parent's shape is used",
                fault.path.display(),
                fault.reason
            ));
        }
    }
}

/// Where the eye is, in metres from the terrain's first sample.
fn eye_place(
    lattice: &Lattice,
    manifest: &TerrainManifest,
    field: &ResidencyField,
    tiles: &StoredTiles<'_>,
    settings: &MeshSettings,
) -> Result<DVec3, MeshError> {
    let (place_m, above_m) = match settings.eye {
        MeshEye::At(place_m) => return Ok(place_m),
        MeshEye::AboveGround { place_m, above_m } => (place_m, above_m),
    };
    let (point, _) = lattice.lattice_from_local(place_m, manifest.file.spacing_m);
    let point = lattice.clamp(point);
    let at_sea = DVec3::new(place_m.x, 0.0, place_m.y);
    let mut view = View::new(lattice, manifest, settings, at_sea)?;
    // With the eye on it, the ground is read as finely as it is stored.
    view.lod = ViewLod::new(lattice, &settings.lod, point, 0, true)?;
    let mesh = view.mesh(lattice, manifest, field, tiles, settings);
    let (ground_m, _) = mesh.displaced(point, lattice.leaf_level);
    let height_m = f64::from(ground_m) + above_m;
    Ok(DVec3::new(place_m.x, height_m, place_m.y))
}
