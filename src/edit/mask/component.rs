//! A terrain's mask as a component.

use super::follow::MaskDrawn;
use super::{DestructionMask, MaskSettings};
use crate::edit::{Edit, SampleRect};
use bevy::log::warn;
use bevy::prelude::Component;
use std::sync::atomic::{AtomicU64, Ordering};

/// How scorched a terrain is. [`TerrainRenderPlugin`](crate::render::TerrainRenderPlugin) puts one
/// on every terrain that can be drawn, and another one when its manifest is replaced by one with
/// other samples; where nothing is drawn there is none, and edits leave no trace but the ground's.
///
/// It holds what edits have drawn and nothing of its own: whoever keeps a terrain's edits applies
/// them, and draws them all when the component is added.
#[derive(Component, Debug)]
#[require(MaskDrawn)]
pub struct TerrainMask {
    mask: DestructionMask,
    instance: u64,
    warned: bool,
}

impl TerrainMask {
    /// An empty mask for a terrain whose samples are `spacing_m` apart, metres.
    #[must_use]
    pub fn new(spacing_m: f64, settings: &MaskSettings) -> Self {
        static INSTANCES: AtomicU64 = AtomicU64::new(1);
        Self {
            mask: DestructionMask::new(spacing_m, settings),
            instance: INSTANCES.fetch_add(1, Ordering::Relaxed),
            warned: false,
        }
    }

    /// What is drawn: the scorch of all edits so far.
    #[must_use]
    pub const fn mask(&self) -> &DestructionMask {
        &self.mask
    }

    /// A number that no other mask has had since the program started, so that copies can be told.
    #[must_use]
    pub const fn instance(&self) -> u64 {
        self.instance
    }

    /// Draws an edit that was made after all others; see [`DestructionMask::draw`].
    pub fn apply(&mut self, edit: &Edit) {
        self.mask.draw(edit);
        self.warn();
    }

    /// Draws a rectangle anew after an edit was taken back or is there again; see
    /// [`DestructionMask::redraw`]. `edits` are those that touch `rect` and are to be seen, in the
    /// order of the log.
    pub fn rebuild<'a>(&mut self, rect: SampleRect, edits: impl IntoIterator<Item = &'a Edit>) {
        self.mask.redraw(rect, edits);
        self.warn();
    }

    /// Forgets everything and draws these edits, all there are, in the order of the log.
    pub fn rebuild_all<'a>(&mut self, edits: impl IntoIterator<Item = &'a Edit>) {
        self.clear();
        for edit in edits {
            self.mask.draw(edit);
        }
        self.warn();
    }

    /// Forgets everything that was drawn; the ground's shape stays.
    pub fn clear(&mut self) {
        self.mask.clear();
        self.warned = false;
    }

    fn warn(&mut self) {
        if self.mask.refused() > 0 && !self.warned {
            self.warned = true;
            warn!(
                "a terrain's destruction mask is full with {} pages: edits leave no scorch on \
                 ground that has none yet; raise `MaskSettings::max_bytes` or lower \
                 `MaskSettings::texels_per_m`",
                self.mask.page_count()
            );
        }
    }
}
