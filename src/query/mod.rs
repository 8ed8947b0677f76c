//! Asking the ground for its height and its slope, and casting rays at it, with or without a GPU.
//!
//! Answers come from the tiles that are resident, at the finest level that is there: those of a
//! server that [pins](crate::stream::TerrainPin) a region are as good as those of a client that
//! stands in it. They say which level they come from. The ground is that of the stored heights,
//! without the [detail](crate::detail) that may be added to them where they are drawn.
//!
//! Games ask [`TerrainQuery`], a system parameter, and with the feature `picking`
//! `TerrainPickingPlugin` asks for them what is under a pointer. What answers needs no
//! engine: [`GroundReader`] and [`GroundRay`] on a [`GroundSource`].

mod blocks;
#[cfg(feature = "ecs")]
mod param;
#[cfg(all(feature = "picking", feature = "render"))]
mod picking;
mod ray;
#[cfg(feature = "ecs")]
mod state;
mod surface;

pub use blocks::BlockRanges;
#[cfg(feature = "ecs")]
pub use param::{TerrainGround, TerrainHit, TerrainQuery};
#[cfg(all(feature = "picking", feature = "render"))]
pub use picking::{TerrainPickingPlugin, update_terrain_hits};
pub use ray::{GroundHit, GroundRay};
pub use surface::{GroundReader, GroundSample, GroundSource, TerrainHeight};
