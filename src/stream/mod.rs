//! What should be resident, what is, and how finely the ground may be read where.
//!
//! Every frame each terrain's views are ranked into a list of wanted tiles ([`Planner`]); the
//! best of those that aren't there are loaded through Bevy's asset server, a few at once; those
//! that have loaded, and whose parent is there, get a page and an entity ([`TileOf`]); and where
//! pages run out, tiles that no view wants make room.
//!
//! Nothing of that is seen as a jump: heights are read through the
//! [`ResidencyField`](crate::lattice::ResidencyField), whose corners move towards the levels that
//! are there at a bounded rate. A tile that arrives fades in; one that is to go has faded out
//! before its page is freed. A tile that is missing or corrupt never arrives, and the ground
//! keeps its parent's shape.
//!
//! A root tile is always resident, views or not, on servers too.

mod pages;
mod planner;
mod residency;
mod state;
mod systems;
mod tile;

pub use pages::PageTable;
pub use planner::Planner;
pub use state::TerrainState;
pub(crate) use systems::{
    forget_removed_terrain, reset_changed_terrains, start_terrains, stream_tiles, update_detail,
};
pub use tile::{TerrainTiles, TileBounds, TileData, TileOf, TilePage};
