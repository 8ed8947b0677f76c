//! Terrain for Bevy games that spends triangles where the ground is interesting.
#![deny(unsafe_code)]
#![warn(missing_docs)]

pub mod bake;
pub mod lattice;
#[cfg(feature = "render")]
pub mod render;
#[cfg(feature = "ecs")]
pub mod stream;
pub mod terrain;
pub mod tessellate;
pub mod tile;
#[cfg(feature = "ecs")]
pub mod view;

#[cfg(feature = "ecs")]
mod plugins;
#[cfg(feature = "ecs")]
pub use plugins::TerrainPlugins;
