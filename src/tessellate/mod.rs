//! The compute passes' twin on the CPU: from nodes to faces, factors, vertices and triangles.
//!
//! Every function here stands operation for operation in WGSL too (`src/render/shaders`), and
//! tests compare the two: integers for equality, heights within half a stored unit. It also
//! serves where there is no GPU: collision meshes, export, servers.
//!
//! A *face* is a square of a node's control grid. Its four edges get a factor each, from their
//! ends alone: the size that the edge has on the screen, scaled by the density of the ground around
//! it. Its inside is a grid as fine as the finer of two opposite edges, or finer where its own ground
//! deserves it, joined to the edges by strips. So two faces that share an edge cut it at the same lattice points,
//! whatever their levels.

mod edge_density;
mod edge_error;
mod face;
mod faces;
mod factor;
mod height;
mod mesh;
mod partition;
mod strip;
mod volume;

pub use edge_density::{DENSITY_ONE, DensityReader};
pub use edge_error::{ErrorBounds, GroundErrors, LevelErrors, error_at, error_spacing};
pub use face::{Face, FaceCounts, FaceFactors, FaceVertex, edge_ends};
pub use faces::{FacePart, TriangleFace};
pub use factor::{EdgeEnd, FactorView, ProjectedEdge};
pub use height::{PageSource, Pages, height};
pub use mesh::{FaceCulling, TerrainMesh, TerrainVertex, ViewMesh};
pub use partition::{
    FACTOR_LOG2, FACTOR_MAX, FACTOR_ONE, Partitioning, rise, scaled_factor, segment_count,
    segment_parameter,
};
pub use volume::LocalVolume;

/// Scales that a view's factors can be brought down by, finest first: `1/2^0 ..= 1/2^6`. With
/// the last, every factor is 1.
pub const FACTOR_SCALES: usize = 7;
