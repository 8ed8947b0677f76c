//! What should be resident: a ranking of all terrains' tiles by how much, and how soon, eyes need
//! them. Pure: positions in, addresses out; no files, no clock, no engine.
//!
//! # Idea
//! A [`Planner`] is told, once for all terrains, what can be had ([`Availability`]), where eyes
//! are and where they are heading ([`EyePath`]), what is asked for besides ([`PinnedRegion`]) and
//! what is there already ([`ResidentTiles`]). It ranks the tiles by [`Need`]:
//!
//! 1. **Root**: all tiles of the coarsest levels, views or not.
//! 2. **Pinned**: tiles of pinned regions, coarse before fine.
//! 3. **Now**: tiles that a view may read where it is: those nearer than their level reaches
//!    ([`ViewLod::box_distance`](crate::lattice::ViewLod::box_distance) `<`
//!    [`reach`](crate::lattice::ViewLod::reach)). The least distance in sizes of the tile comes
//!    first, so that where the capacity is short every level loses its farthest tiles, over all
//!    eyes and terrains alike.
//! 4. **Soon**: tiles that an eye will need within the look-ahead if it goes straight on, the
//!    earliest first. A level reaches equally far in x and z, so its tiles are needed while the
//!    eye is inside their square grown by that reach: the time follows exactly from when the eye
//!    crosses four lines, and from when its floor has sunk below the reach.
//!
//! A tile that several eyes need counts for the one that needs it most. All share one capacity.
//!
//! # Promises
//! - A tile stands behind its parent, always: parents are nearer in sizes of themselves, are
//!   reached no later, and every rounding keeps order.
//! - The best `capacity` tiles are ranked, or all where there are fewer; none twice.
//! - The same input gives the same plan on every machine, whatever was planned before.
//! - Resident tiles count as an eighth nearer (or sooner), so that two tiles at the capacity's
//!   edge don't take turns as an eye sways. This needs what is resident to be closed towards the
//!   root, which [`ResidentTiles`] sees to.
//!
//! # Order in full
//! Within a need: by bucket, then coarse before fine (levels counted from each terrain's root),
//! then by terrain, row and column. A bucket is, for roots and pins, the level; for Now, the
//! distance `d` in tile sizes, rounded down to 1/1024, on a logarithmic scale with 128 steps an
//! octave of `1 + d`; for Soon, 1/2048 of the look-ahead.
//!
//! # Units
//! Lattice units for lengths, seconds for times; levels count up from the finest tiles at 0.
//!
//! # Cost
//! Time is spent on tiles that are needed, not on those that exist: 96 µs for the 11 361 candidates
//! of an eye at 300 m/s that looks 10 s ahead, 15 µs for 1105 of them (medians, one core of a Xeon
//! server that had other work; `cargo bench --no-default-features --bench planner`). Nothing is
//! allocated once a planner has seen its largest plan.

mod available;
mod needs;
mod planner;
mod tile_bits;

pub use available::{Availability, ResidentTiles};
pub use needs::levels_short;
pub use planner::{EyeFigures, Plan, Planner};

use crate::lattice::{Lattice, ViewLod};
use crate::tile::TileAddress;
use glam::IVec2;

/// The longest look-ahead, in seconds; longer ones are cut to it.
pub const LOOKAHEAD_MAX_S: f32 = 3600.0;
/// The greatest speed in lattice units per second, along each axis; greater ones are cut to it.
pub const SPEED_MAX: f32 = (1_u32 << 31) as f32;

/// Where an eye is and where it is heading.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EyePath {
    /// What its level of detail follows from.
    pub lod: ViewLod,
    /// Lattice units per second in x and z. What is no number counts as 0.
    pub velocity: [f32; 2],
    /// Lattice units per second by which the distance to the ground, the view's
    /// [`floor`](ViewLod::floor), shrinks. An eye that isn't sinking has 0; so does what is
    /// negative or no number.
    pub descent: f32,
}

/// A part of a terrain that is wanted whether or not an eye is near: around a spawn point, a
/// cut scene's first view, a server's players.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PinnedRegion {
    /// Its first lattice point, the least in x and z.
    pub low: IVec2,
    /// One past the last lattice point; a region with none is empty.
    pub high: IVec2,
    /// The finest level wanted; all coarser ones are as well.
    pub finest_level: u8,
}

/// A terrain, as a [`Planner`] sees it.
#[derive(Clone, Copy, Debug)]
pub struct PlanTerrain<'a> {
    /// The terrain's lattice, which tells what its views reach.
    pub lattice: &'a Lattice,
    /// What can be had of it. Without its root nothing can.
    pub available: &'a Availability,
    /// Which of its tiles are resident.
    pub resident: &'a ResidentTiles,
    /// The eyes that look at it.
    pub eyes: &'a [EyePath],
    /// What is wanted besides.
    pub pins: &'a [PinnedRegion],
    /// How many of the coarsest levels are always needed whole; 0 counts as 1.
    pub root_levels: u8,
}

/// Why a tile is needed; the most pressing first. Of several reasons a tile has the most pressing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Need {
    /// It is of one of the coarsest levels.
    #[default]
    Root,
    /// A pinned region touches it.
    Pinned,
    /// A view may read it where it is.
    Now,
    /// A view may read it within the look-ahead.
    Soon,
}

/// A tile in a [`Plan`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Ranked {
    /// Which of the planned terrains.
    pub terrain: u32,
    /// Which of its tiles.
    pub address: TileAddress,
    /// Why it is needed.
    pub need: Need,
}
