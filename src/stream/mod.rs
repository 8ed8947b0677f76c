//! What should be resident, what is, and how finely the ground may be read where.
//!
//! What all views of all terrains need, now and soon, is ranked into one list of wanted tiles
//! ([`residency`](crate::residency)); the best of those that aren't there are loaded through Bevy's
//! asset server, a few at once; those that have loaded, and whose parent is there, get a page and
//! an entity ([`TileOf`]), as many a frame as [`TerrainStreaming`] lets; and where pages run out,
//! tiles that nobody wants make room. Pages and memory are shared by all terrains.
//!
//! Nothing of that is seen as a jump: heights are read through the
//! [`ResidencyField`](crate::lattice::ResidencyField), whose corners move towards the levels that
//! are there at a bounded rate. A tile that arrives fades in; one that is to go has faded out
//! before its page is freed. A tile that is missing or corrupt doesn't arrive, and the ground
//! keeps its parent's shape; it is asked for again from time to time, so that a file that has been
//! put right is picked up.
//!
//! The coarsest levels are always resident, views or not, on servers too;
//! [`TerrainPin`]s keep what else is to be there whether or not somebody looks.
//!
//! # Files that change
//! Where Bevy watches for changes (its feature `file_watcher`), a tile that is baked again shows up
//! in the running program, and so does a whole terrain: a changed manifest is followed at once
//! where the tiles' scale is still the same, and otherwise as soon as the new terrain's coarsest
//! tiles have loaded; until then the old one is drawn. What can't be used changes nothing and is
//! named.

mod cache;
mod changes;
mod content;
mod demand;
mod dirt;
mod edits;
mod fade;
mod pages;
mod pin;
mod pool;
mod reload;
mod replay;
mod residency;
mod settings;
mod start;
mod state;
mod systems;
mod tile;

#[cfg(feature = "render")]
pub(crate) use dirt::PageDirt;
pub use pages::PageTable;
pub use pin::{TerrainPin, TerrainPinProgress, TerrainRegion};
pub(crate) use pin::{collect_pins, count_pins};
pub use settings::{PAGE_BYTES, TILE_BYTES, TerrainStreaming, TerrainStreamingError};
pub(crate) use start::{
    follow_manifests, forget_removed_terrain, replace_terrains, start_terrains, update_detail,
};
pub use state::TerrainState;
pub use systems::TerrainStreamer;
pub(crate) use systems::stream_tiles;
pub use tile::{TerrainTiles, TileBounds, TileData, TileOf, TilePage};
