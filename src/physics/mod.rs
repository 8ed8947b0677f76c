//! Colliders for [Avian](avian3d): bodies stand on the ground, and fall where it is blown away.
//!
//! [`TerrainPhysicsPlugin`], which [`TerrainPlugins`](crate::TerrainPlugins) holds, gives the ground
//! near moving bodies, and in [pinned](TerrainColliderPin) regions, heightfield colliders. A game adds
//! Avian's own `PhysicsPlugins` and bodies; nothing more is needed. Without `PhysicsPlugins` the plugin
//! does nothing.
//!
//! # What the colliders are
//! Squares of [`TerrainPhysics::chunk_cells`] cells of level 0, each a child of the terrain with a static
//! `RigidBody` of its own, so that they follow the terrain wherever it is moved, turned or uniformly
//! scaled. They carry [`TerrainCollider`]. `CollisionLayers`, `Friction`, `Restitution` and
//! `CollisionMargin` are taken over from the terrain's entity. Squares end at the terrain's last sample:
//! beyond the rim there is nothing.
//!
//! At samples a collider's height is the stored one, to the precision of `f32` (heights are counted from
//! the collider's own corner, so that the terrain's size costs none): the same as that which is drawn at
//! level 0, but for [detail](crate::detail), which bodies don't feel. Each cell is two triangles that
//! meet in the diagonal from the corner with the least x and greatest z to the opposite one; the bilinear
//! ground that queries answer with differs from them by at most a quarter of
//! `|h00 - h10 - h01 + h11|`, of the cell's corners.
//!
//! Where level 0 isn't resident, the finest level that is stands in, resampled to the same grid, so that
//! no body falls through ground that is drawn. Bodies [keep their ground
//! resident](TerrainPhysics::keep_resident), and so the finest follows; the collider is then replaced,
//! and bodies that it passes are [lifted](TerrainPhysics::lift_bodies). Until the terrain is
//! [ready](crate::terrain::TerrainReady) there is no ground: spawn bodies when a
//! [pin](crate::stream::TerrainPin) is.
//!
//! # When they are right
//! Colliders are made on other threads, begun [a few a step](TerrainPhysics::builds_per_step), long
//! before a body comes near; where a body is near already, in the very step. What changes the ground
//! is followed in [`TerrainPhysicsSystems::Update`], right before Avian's own systems: whatever edit is
//! applied before a physics step, that step collides with the new ground, and if a thousand edits are
//! applied, each collider is rewritten once. Sleeping bodies over what has changed are woken.

mod bodies;
mod colliders;
mod grid;
mod plugin;
mod settings;
mod shape;

pub use colliders::{TerrainBodyPin, TerrainCollider, TerrainColliderPin, TerrainColliders};
pub use plugin::{TerrainPhysicsPlugin, TerrainPhysicsSystems};
pub use settings::{TerrainPhysics, TerrainPhysicsError};
