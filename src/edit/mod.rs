//! Changing the ground: craters and other edits, as an ordered log that means the same everywhere.
//!
//! An [`Edit`] is made of integers. Its effect on a stored height depends on the edit, on the
//! sample's level and place, and on the height itself, and on nothing else: not on which tiles are
//! resident, not on the machine, not on how many threads there are. So whoever applies the same
//! edits in the same order to the same terrain has the same bytes, tile by tile.

mod apply;
mod change;
mod check;
#[cfg(feature = "ecs")]
mod command;
mod compact;
#[cfg(feature = "ecs")]
mod component;
mod error;
#[cfg(feature = "ecs")]
mod events;
mod footprint;
mod frozen;
mod index;
mod log;
pub mod mask;
#[cfg(feature = "ecs")]
mod plugin;
mod profile;
mod raster;
mod rect;
mod save;
mod snapshot;
mod tile;

pub use change::{CapturedGround, Change, EDIT_UNITS, Edit, MAX_REACH, MIN_REACH, StampImage};
#[cfg(feature = "egui")]
pub(crate) use command::CRATER_REACH;
#[cfg(feature = "ecs")]
pub use command::{Crater, EditRefusal, Flatten, Raise, Smooth, Stamp};
#[cfg(feature = "ecs")]
pub use component::{MergeEdits, RedoEdit, TerrainEdits, UndoEdit};
pub use error::InvalidEdit;
#[cfg(feature = "ecs")]
pub use events::{TerrainEditRedone, TerrainEditRefused, TerrainEditUndone, TerrainEdited};
pub use footprint::{Footprint, LevelFootprint};
pub use index::touch_rect;
pub use log::{EditDiff, EditLog, EditLogError, EditOp, EditRecord, Merged};
#[cfg(feature = "ecs")]
pub(crate) use plugin::{EditPlugin, start_logs};
pub use raster::{EditGround, EditRaster, EditScratch};
pub use rect::SampleRect;
pub use save::{EditFileError, EditFormatError};
pub use snapshot::TileSnapshot;
pub use tile::{EditedTile, TileChange, ground_hash};
