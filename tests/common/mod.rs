//! What several tests share.
#![allow(dead_code, reason = "each test file uses a part of it")]

#[cfg(feature = "examples")]
pub mod app;
#[cfg(all(feature = "ecs", feature = "archive"))]
pub mod flight;
#[cfg(feature = "examples")]
pub mod gpu;
pub mod manifold;
#[cfg(feature = "examples")]
pub mod page_textures;
pub mod random;
#[cfg(feature = "examples")]
pub mod scene;
#[cfg(feature = "examples")]
pub mod stage;
#[cfg(all(feature = "ecs", feature = "archive"))]
pub mod virtual_source;
