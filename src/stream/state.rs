//! A terrain's run-time state: what is resident and what is on its way.

use super::planner::Planner;
use super::residency::Residency;
use super::{PageTable, TileBounds};
use crate::detail::{DetailKernel, TerrainDetail};
use crate::lattice::{DEFAULT_FACES_PER_SIDE, Lattice, LatticeError, ResidencyField, ViewLod};
use crate::terrain::{TerrainManifest, TerrainSettings};
use crate::tile::{TerrainTile, TileAddress};
use bevy::asset::{AssetId, AssetPath};
use bevy::prelude::*;
use std::collections::HashSet;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// What a terrain knows at run time; inserted on the terrain's entity once its manifest has
/// loaded, and removed with it.
///
/// Everything in here is written by the streaming systems
/// ([`TerrainSystems::Stream`](crate::terrain::TerrainSystems::Stream)) and may be read by anyone.
/// The two versions say whether a copy of the page table or of the field is still good.
#[derive(Component, Debug)]
pub struct TerrainState {
    pub(super) manifest: Arc<TerrainManifest>,
    pub(super) manifest_id: AssetId<TerrainManifest>,
    /// The manifest's path; tiles lie beside it.
    pub(super) manifest_path: AssetPath<'static>,
    /// The settings as the game gave them, and as they are used.
    pub(super) raw_settings: TerrainSettings,
    pub(super) settings: TerrainSettings,
    pub(super) residency: Residency,
    pub(super) planner: Planner,
    /// Handles and entities of the resident tiles, by page.
    pub(super) slots: Vec<Option<Slot>>,
    /// Tiles that were asked for and aren't resident yet.
    pub(super) loading: Vec<Loading>,
    /// Tiles that are missing or corrupt; they are not asked for again.
    pub(super) failed: HashSet<TileAddress>,
    /// How far down the plan tiles have been asked for.
    pub(super) cursor: usize,
    /// The views of this terrain, refilled every frame.
    pub(super) views: Vec<ViewLod>,
    pub(super) lattice: Lattice,
    /// The detail as the game gave it, and as it is evaluated.
    pub(super) raw_detail: Option<TerrainDetail>,
    pub(super) detail: DetailKernel,
    instance: u64,
}

/// The next state's instance.
static INSTANCE: AtomicU64 = AtomicU64::new(1);

/// What a page holds. The handle keeps the tile loaded even where a game despawns its entity.
#[derive(Debug)]
pub(super) struct Slot {
    pub(super) entity: Entity,
    _tile: Handle<TerrainTile>,
}

impl Slot {
    pub(super) const fn new(entity: Entity, tile: Handle<TerrainTile>) -> Self {
        Self {
            entity,
            _tile: tile,
        }
    }
}

/// A tile on its way.
#[derive(Debug)]
pub(super) struct Loading {
    pub(super) address: TileAddress,
    pub(super) rank: u32,
    pub(super) tile: Handle<TerrainTile>,
    /// The asset has loaded.
    pub(super) is_ready: bool,
}

impl TerrainState {
    /// The state of a terrain of which no tile is resident yet. `settings` must be
    /// [checked](TerrainSettings::checked).
    pub(super) fn new(
        manifest: Arc<TerrainManifest>,
        manifest_id: AssetId<TerrainManifest>,
        manifest_path: AssetPath<'static>,
        settings: TerrainSettings,
    ) -> Result<Self, LatticeError> {
        let file = &manifest.file;
        let lattice = Lattice::new(
            file.size,
            file.levels,
            settings.leaf_level,
            DEFAULT_FACES_PER_SIDE,
        )?;
        let residency = Residency::new(&lattice, PageTable::new(file), settings.page_capacity);
        let mut slots = Vec::new();
        slots.resize_with(settings.page_capacity as usize, || None);
        Ok(Self {
            manifest,
            manifest_id,
            manifest_path,
            raw_settings: settings.clone(),
            settings,
            residency,
            planner: Planner::default(),
            slots,
            loading: Vec::new(),
            failed: HashSet::new(),
            cursor: 0,
            views: Vec::new(),
            lattice,
            raw_detail: None,
            detail: DetailKernel::default(),
            instance: INSTANCE.fetch_add(1, Ordering::Relaxed),
        })
    }

    /// The terrain's integer grid, with the default number of faces a node; each view has its own,
    /// [`TerrainView::lattice`](crate::view::TerrainView::lattice).
    #[must_use]
    pub const fn lattice(&self) -> &Lattice {
        &self.lattice
    }

    /// What is added to the stored heights, as its [`TerrainDetail`] says; without octaves where it
    /// has none.
    #[must_use]
    pub const fn detail(&self) -> &DetailKernel {
        &self.detail
    }

    /// The terrain's manifest and the index of its tiles.
    #[must_use]
    pub const fn manifest(&self) -> &Arc<TerrainManifest> {
        &self.manifest
    }

    /// Which page holds which tile.
    #[must_use]
    pub const fn pages(&self) -> &PageTable {
        &self.residency.pages
    }

    /// How finely heights may be read where.
    #[must_use]
    pub const fn field(&self) -> &ResidencyField {
        &self.residency.field
    }

    /// A number that no other state has had since the program started, so that copies of a former
    /// state of the same entity (before its manifest was replaced, say) can be told.
    #[must_use]
    pub const fn instance(&self) -> u64 {
        self.instance
    }

    /// Changes whenever [`pages`](Self::pages) does. Begins anew with every
    /// [`instance`](Self::instance).
    #[must_use]
    pub const fn pages_version(&self) -> u64 {
        self.residency.pages_version
    }

    /// Changes whenever [`field`](Self::field) does; begins anew with every
    /// [`instance`](Self::instance).
    #[must_use]
    pub const fn field_version(&self) -> u64 {
        self.residency.field_version
    }

    /// The most tiles that are resident at once; pages count from 0 up to this.
    #[must_use]
    pub fn capacity(&self) -> u32 {
        self.slots.len() as u32
    }

    /// Tiles that are resident.
    #[must_use]
    pub fn resident_count(&self) -> usize {
        self.residency.resident_count()
    }

    /// Tiles that were asked for and are not resident yet.
    #[must_use]
    pub const fn loading_count(&self) -> usize {
        self.loading.len()
    }

    /// Tiles that the views want, resident or not, as far as the capacity goes.
    #[must_use]
    pub fn wanted_count(&self) -> usize {
        self.planner.wanted().len()
    }

    /// Whether the views want more tiles than the capacity holds.
    #[must_use]
    pub fn is_short_of_pages(&self) -> bool {
        self.planner.is_truncated()
    }

    /// Tiles that turned out to be missing or corrupt.
    pub fn failed(&self) -> impl ExactSizeIterator<Item = TileAddress> {
        self.failed.iter().copied()
    }

    /// The entity of a resident tile.
    #[must_use]
    pub fn tile(&self, address: TileAddress) -> Option<Entity> {
        self.slot(self.pages().get(address)?)
            .map(|slot| slot.entity)
    }

    pub(super) fn slot(&self, page: u32) -> Option<&Slot> {
        self.slots.get(page as usize)?.as_ref()
    }

    /// The coarsest tile, which covers the terrain.
    #[must_use]
    pub fn root(&self) -> TileAddress {
        TileAddress::new(self.lattice.root_level.unsigned_abs() as u8, 0, 0)
    }

    /// Whether the terrain can be drawn: its root tile is resident.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        self.pages().get(self.root()).is_some()
    }

    /// Whether everything that the views want (and the capacity holds) is there and has faded in:
    /// while the views stand still, nothing will change any more. The views are those of the last
    /// [`TerrainSystems::Stream`](crate::terrain::TerrainSystems::Stream).
    #[must_use]
    pub fn is_settled(&self) -> bool {
        self.is_ready()
            && self.loading.is_empty()
            && self.cursor == self.planner.wanted().len()
            && self.residency.is_still()
    }

    /// The box that holds a stored tile's ground, resident or not.
    #[must_use]
    pub fn bounds(&self, address: TileAddress) -> Option<TileBounds> {
        let range = self.manifest.index.get(address)?;
        Some(TileBounds::new(&self.manifest.file, address, range))
    }

    /// Checks the promises that streaming makes: wherever the field lets a level be read, that
    /// level and all coarser ones are resident; parents are resident before their children; pages
    /// and tiles match one to one. For tests and debug builds: visits every cell of the field.
    ///
    /// # Errors
    /// Says which promise is broken, and where.
    pub fn validate(&self) -> Result<(), String> {
        self.residency.validate()?;
        let pages = self.pages().flat().iter();
        let mut resident = pages.filter(|&&page| page != PageTable::NONE);
        if resident.any(|&page| self.slot(page).is_none()) {
            return Err("a resident tile has no handles".to_owned());
        }
        if self.slots.iter().flatten().count() != self.resident_count() {
            return Err("handles of a tile are kept that is not resident".to_owned());
        }
        Ok(())
    }
}
