//! What several tests share.
#![allow(dead_code, reason = "each test file uses a part of it")]

#[cfg(feature = "examples")]
pub mod app;
pub mod manifold;
