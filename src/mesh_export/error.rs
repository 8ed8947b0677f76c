//! Why a mesh isn't written.

use crate::lattice::LatticeError;
use crate::output::OutputError;
use crate::terrain::ManifestError;
use std::io;
use std::path::PathBuf;
use thiserror::Error;

/// Why there is no mesh. Each message is a sentence that names the thing, the cause and what can be
/// done; a file that stood in the mesh's place still stands there.
#[derive(Debug, Error)]
#[non_exhaustive]
pub enum MeshError {
    /// A setting lies outside its range.
    #[error("the mesh's {name} is {found}: use a number from {least} to {most}")]
    Number {
        /// What was set.
        name: &'static str,
        /// Its value.
        found: f64,
        /// The least that is accepted.
        least: f64,
        /// The most that is accepted.
        most: f64,
    },
    /// The level of detail would tear the mesh, or the geometry doesn't fit the terrain.
    #[error("the mesh can't be made: {0}")]
    Lattice(#[from] LatticeError),
    /// The folder holds no terrain.
    #[error("{} is no terrain that can be used: {reason}", path.display())]
    Terrain {
        /// The folder.
        path: PathBuf,
        /// What is wrong with it.
        reason: Box<ManifestError>,
    },
    /// The tile that covers the whole terrain is missing, and with it what stands in for others.
    #[error(
        "{} is no terrain that can be used: its coarsest tile is not there; bake it again{}{reason}",
        path.display(),
        if reason.is_empty() { "" } else { ": " }
    )]
    NoRoot {
        /// The folder.
        path: PathBuf,
        /// What was said of the tiles that can't be read.
        reason: String,
    },
    /// Nothing may be written at that path.
    #[error(transparent)]
    Output(#[from] OutputError),
    /// The mesh's name says no format.
    #[error(
        "{} is no name for a mesh; give --out a name that ends in .obj (Wavefront) or .glb (binary \
         glTF)",
        path.display()
    )]
    OutputExtension {
        /// The path.
        path: PathBuf,
    },
    /// The mesh would replace a file that is none, such as a model.
    #[error(
        "{} exists and is no mesh that tessera wrote, so it isn't replaced; choose another --out, or \
         --force",
        path.display()
    )]
    OutputExists {
        /// The path.
        path: PathBuf,
    },
    /// The mesh can't be written.
    #[error("{} can't be written: {reason}; choose another --out", path.display())]
    Write {
        /// The mesh's file.
        path: PathBuf,
        /// What the system says.
        reason: io::Error,
    },
}
