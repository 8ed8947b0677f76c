//! A terrain's run-time state: what is resident and what is on its way.

use super::changes::ChangeLog;
use super::content::TileContent;
use super::dirt::{PageDirt, PageDirtLog};
use super::edits::GroundEdits;
use super::fade::FadeView;
use super::replay::Arrival;
use super::residency::Residency;
use super::{PageTable, TileBounds};
use crate::detail::{DetailKernel, TerrainDetail};
use crate::edit::{EditGround, EditRaster, EditScratch, TileChange};
use crate::lattice::{DEFAULT_FACES_PER_SIDE, Lattice, LatticeError, ResidencyField};
use crate::query::BlockRanges;
use crate::residency::{Availability, EyePath, PinnedRegion};
use crate::terrain::{TerrainManifest, TerrainSettings};
use crate::tile::{HeightTile, TILE_SAMPLES, TerrainTile, TileAddress, TileRange};
use bevy::asset::{AssetId, AssetPath};
use bevy::prelude::*;
use std::collections::{HashMap, VecDeque};
#[cfg(feature = "render")]
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, OnceLock};

/// What a terrain knows at run time; inserted on the terrain's entity once its manifest has
/// loaded, and removed with it.
///
/// Everything in here is written by the streaming systems
/// ([`TerrainSystems::Stream`](crate::terrain::TerrainSystems::Stream)) and may be read by anyone.
/// The two versions say whether a copy of the page table or of the field is still good.
#[derive(Component, Debug)]
pub struct TerrainState {
    pub(super) manifest: Arc<TerrainManifest>,
    /// Bounds of all that may be drawn: the manifest's and, while tiles of a former one are about,
    /// that one's too.
    pub(super) bounds: Arc<TerrainManifest>,
    pub(super) bounds_log: ChangeLog,
    /// Whether the bounds hold a former manifest's too.
    pub(super) has_wide_bounds: bool,
    pub(super) manifest_id: AssetId<TerrainManifest>,
    /// The manifest's path; tiles lie beside it.
    pub(super) manifest_path: AssetPath<'static>,
    /// The settings as the game gave them, and as they are used.
    pub(super) raw_settings: TerrainSettings,
    pub(super) settings: TerrainSettings,
    pub(super) residency: Residency,
    pub(super) available: Availability,
    /// The resident tiles, by page.
    pub(super) slots: Vec<Option<Slot>>,
    /// Tiles that were asked for and aren't resident yet.
    pub(super) loading: Vec<Loading>,
    /// Tiles that are missing or corrupt.
    pub(super) failed: HashMap<TileAddress, Failure>,
    /// Whether the latest plan has been asked for to its end.
    pub(super) is_requested: bool,
    /// Tiles of this terrain in the latest plan.
    pub(super) wanted_count: usize,
    /// Whether something has changed that plans follow from.
    pub(super) must_plan: bool,
    /// Tiles that are to be read again, and assets that are being.
    pub(super) to_refresh: VecDeque<TileAddress>,
    pub(super) refreshing: Vec<(AssetId<TerrainTile>, f64)>,
    /// Whether files have changed, so that assets that are still in memory can't be trusted.
    pub(super) was_refreshed: bool,
    /// Whether a resident tile's file couldn't be read again.
    pub(super) has_complaints: bool,
    /// Whether tiles are resident that the manifest doesn't have any more.
    pub(super) has_strays: bool,
    /// Whether another state waits to take this one's place.
    pub(super) has_next: bool,
    /// Changes with what has failed.
    pub(super) failures_version: u64,
    /// Whether another state of the same terrain is drawn until this one has its coarsest tiles.
    pub(super) is_next: bool,
    pub(super) is_short_of_pages: bool,
    pub(super) levels_short: u8,
    /// The views of this terrain, refilled every frame, and those of the latest plan.
    pub(super) eyes: Vec<EyePath>,
    pub(super) planned_eyes: Vec<EyePath>,
    pub(super) fades: Vec<FadeView>,
    pub(super) pins: Vec<PinnedRegion>,
    pub(super) planned_pins: Vec<PinnedRegion>,
    pub(super) lattice: Lattice,
    pub(super) edits: GroundEdits,
    /// The detail as the game gave it, and as it is evaluated.
    pub(super) raw_detail: Option<TerrainDetail>,
    pub(super) detail: DetailKernel,
    instance: u64,
}

/// The next state's instance; 0 stands for none.
static INSTANCE: AtomicU64 = AtomicU64::new(1);

/// The next content's number.
static CONTENT: AtomicU64 = AtomicU64::new(1);

/// A resident tile. The handle keeps the asset loaded even where a game despawns the tile's entity.
#[derive(Debug)]
pub(super) struct Slot {
    pub(super) entity: Entity,
    pub(super) handle: Handle<TerrainTile>,
    /// What is drawn and asked.
    pub(super) tile: TileContent,
    /// Changes with the content, and differs from all others'.
    pub(super) content: u64,
    /// What of it has changed, from number to number.
    pub(super) dirt: PageDirtLog,
    /// How far the ground is from the parent tile's at most, in metres, once somebody has asked.
    rise_m: Option<f32>,
    /// The ranges of its blocks, once somebody has asked, and the content that they are of.
    blocks: OnceLock<(u64, BlockRanges)>,
    /// Why its file, which has changed, can't be used; empty where there is nothing to say.
    pub(super) complaint: String,
    /// When the file is asked for again, seconds of real time.
    pub(super) retry_at_s: Option<f64>,
}

impl Slot {
    pub(super) fn new(entity: Entity, handle: Handle<TerrainTile>, tile: TileContent) -> Self {
        Self {
            entity,
            handle,
            tile,
            content: CONTENT.fetch_add(1, Ordering::Relaxed),
            dirt: PageDirtLog::default(),
            rise_m: None,
            blocks: OnceLock::new(),
            complaint: String::new(),
            retry_at_s: None,
        }
    }

    /// Takes another content.
    pub(super) fn take(&mut self, tile: TileContent) {
        self.tile = tile;
        self.content = CONTENT.fetch_add(1, Ordering::Relaxed);
        self.dirt = PageDirtLog::default();
        self.rise_m = None;
        self.blocks = OnceLock::new();
    }

    /// Applies an edit.
    pub(super) fn apply(
        &mut self,
        address: TileAddress,
        ground: &EditGround,
        raster: &EditRaster,
        scratch: &mut EditScratch,
    ) -> TileChange {
        let change = self.tile.apply(address, ground, raster, scratch);
        // Pages begin with the border.
        let border = crate::tile::TILE_BORDER as i32;
        let dirt = PageDirt {
            heights: change.heights.moved([border; 2]),
            densities: change.densities,
            errors: change.errors,
        };
        if dirt != PageDirt::default() {
            self.dirt.note(self.content, dirt);
            self.content = CONTENT.fetch_add(1, Ordering::Relaxed);
        }
        if let Some((of, blocks)) = self.blocks.get_mut() {
            *of = self.content;
            if !change.heights.is_empty() {
                let at = |sample: i32| sample.clamp(0, TILE_SAMPLES as i32) as u32;
                let last = change.heights.max.map(|end| at(end - 1));
                blocks.refresh(&self.tile.tile().heights, change.heights.min.map(at), last);
            }
        }
        change
    }

    /// The ground has changed, or that of the parent.
    pub(super) const fn forget_rise(&mut self) {
        self.rise_m = None;
    }
}

/// A tile on its way.
#[derive(Debug)]
pub(super) struct Loading {
    pub(super) address: TileAddress,
    /// Place in the latest plan.
    pub(super) rank: u32,
    pub(super) handle: Handle<TerrainTile>,
    /// When it was asked for, seconds of real time.
    pub(super) since_s: f64,
    /// What has become of it, once the asset has loaded and is this terrain's.
    pub(super) arrival: Option<Arrival>,
    /// The asset was an older one and is being read again.
    pub(super) is_stale: bool,
}

impl Loading {
    /// Whether the tile may become resident.
    pub(super) fn is_ready(&self) -> bool {
        self.arrival.as_ref().is_some_and(Arrival::is_done)
    }
}

/// What is known of a tile that could not be read.
#[derive(Debug)]
pub(super) struct Failure {
    pub(super) attempts: u32,
    /// When it is asked for again, seconds of real time; `None` once it is.
    pub(super) retry_at_s: Option<f64>,
    pub(super) reason: String,
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
        let edits = GroundEdits::new(file);
        Ok(Self {
            residency: Residency::new(&lattice, &manifest),
            available: Availability::new(&manifest.index),
            bounds: Arc::clone(&manifest),
            bounds_log: ChangeLog::default(),
            has_wide_bounds: false,
            manifest,
            manifest_id,
            manifest_path,
            raw_settings: settings.clone(),
            settings,
            slots: Vec::new(),
            loading: Vec::new(),
            failed: HashMap::new(),
            is_requested: false,
            wanted_count: 0,
            must_plan: true,
            to_refresh: VecDeque::new(),
            refreshing: Vec::new(),
            was_refreshed: false,
            has_complaints: false,
            has_strays: false,
            has_next: false,
            failures_version: 0,
            is_next: false,
            is_short_of_pages: false,
            levels_short: 0,
            eyes: Vec::new(),
            planned_eyes: Vec::new(),
            fades: Vec::new(),
            pins: Vec::new(),
            planned_pins: Vec::new(),
            lattice,
            edits,
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

    /// What bounds the ground that may be drawn in this frame: the manifest, with what edits have
    /// changed, and both manifests where it has changed and tiles of the former one are still
    /// resident.
    #[must_use]
    pub const fn ground_bounds(&self) -> &Arc<TerrainManifest> {
        &self.bounds
    }

    /// Changes whenever [`ground_bounds`](Self::ground_bounds) do; begins anew with every
    /// [`instance`](Self::instance).
    #[must_use]
    pub const fn bounds_version(&self) -> u64 {
        self.bounds_log.version()
    }

    /// The tiles whose bounds have changed since [`bounds_version`](Self::bounds_version) was `known`,
    /// as places in the page table; `None` where that is too long ago.
    #[cfg(feature = "render")]
    pub(crate) fn bounds_changes(&self, known: u64) -> Option<impl Iterator<Item = Range<u32>>> {
        self.bounds_log.since(known)
    }

    /// The lowest and the highest stored height that a tile's square may be drawn with, edits
    /// included, whether or not the tile is resident; `None` where no such tile is stored.
    #[must_use]
    pub fn ground_range(&self, address: TileAddress) -> Option<TileRange> {
        self.bounds.index.get(address)
    }

    /// Which page holds which tile. Pages are numbered across all terrains, which share them.
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

    /// Changes whenever [`pages`](Self::pages) or what they hold does. Begins anew with every
    /// [`instance`](Self::instance).
    #[must_use]
    pub const fn pages_version(&self) -> u64 {
        self.residency.page_log.version()
    }

    /// Changes whenever [`field`](Self::field) does; begins anew with every
    /// [`instance`](Self::instance).
    #[must_use]
    pub const fn field_version(&self) -> u64 {
        self.residency.field_log.version()
    }

    #[cfg(feature = "render")]
    /// What of the page table has changed since [`pages_version`](Self::pages_version) was `known`;
    /// `None` where that is too long ago.
    pub(crate) fn page_changes(&self, known: u64) -> Option<impl Iterator<Item = Range<u32>>> {
        self.residency.page_log.since(known)
    }

    #[cfg(feature = "render")]
    /// The same of the field's corners.
    pub(crate) fn field_changes(&self, known: u64) -> Option<impl Iterator<Item = Range<u32>>> {
        self.residency.field_log.since(known)
    }

    /// Tiles that are resident.
    #[must_use]
    pub fn resident_count(&self) -> usize {
        self.residency.resident_count()
    }

    /// The tiles that are resident, in no order. Cost: a pass over the pages.
    pub fn residents(&self) -> impl Iterator<Item = TileAddress> {
        self.residency.residents().map(|(_, address)| address)
    }

    /// Tiles that were asked for and are not resident yet.
    #[must_use]
    pub const fn loading_count(&self) -> usize {
        self.loading.len()
    }

    /// Which tiles those are.
    pub fn loading(&self) -> impl ExactSizeIterator<Item = TileAddress> {
        self.loading.iter().map(|loading| loading.address)
    }

    /// Tiles that this terrain's views and pins want, resident or not, as far as the memory goes.
    #[must_use]
    pub const fn wanted_count(&self) -> usize {
        self.wanted_count
    }

    /// Whether the views want more tiles now than there is memory for.
    #[must_use]
    pub const fn is_short_of_pages(&self) -> bool {
        self.is_short_of_pages
    }

    /// How many levels short of what the views ask for the ground is, where it is worst: 0 where
    /// every tile that a view reads is resident, 1 where a parent stands in, and so on.
    #[must_use]
    pub const fn levels_short(&self) -> u8 {
        self.levels_short
    }

    /// Tiles that turned out to be missing or corrupt, as far as they haven't been read since. They
    /// are asked for again from time to time.
    pub fn failed(&self) -> impl ExactSizeIterator<Item = TileAddress> {
        self.failed.keys().copied()
    }

    /// Why a tile can't be read, in a sentence; `None` where it wasn't tried, or could be.
    #[must_use]
    pub fn failure(&self, address: TileAddress) -> Option<&str> {
        let failure = self.failed.get(&address)?;
        Some(&failure.reason)
    }

    /// Tiles that turned out to be missing or corrupt and haven't been read since.
    #[must_use]
    pub fn failed_count(&self) -> usize {
        self.failed.len()
    }

    /// Changes whenever [`failed`](Self::failed) does; begins anew with every
    /// [`instance`](Self::instance).
    #[must_use]
    pub const fn failures_version(&self) -> u64 {
        self.failures_version
    }

    /// Whether a tile can't be read, or one that it lies in.
    pub(super) fn has_failed(&self, address: TileAddress) -> bool {
        let root_level = self.root().level;
        !self.failed.is_empty()
            && (address.level..=root_level)
                .filter_map(|level| address.ancestor(level))
                .any(|tile| self.failed.contains_key(&tile))
    }

    /// The entity of a resident tile.
    #[must_use]
    pub fn tile(&self, address: TileAddress) -> Option<Entity> {
        self.slot(self.pages().get(address)?)
            .map(|slot| slot.entity)
    }

    /// What a resident tile holds: that which is drawn.
    #[must_use]
    pub fn tile_data(&self, address: TileAddress) -> Option<&TerrainTile> {
        self.slot(self.pages().get(address)?)
            .map(|slot| slot.tile.tile())
    }

    /// What of a resident tile has changed since its content had the number `known`; `None` where
    /// that is too long ago to tell, or was another tile's.
    #[cfg(feature = "render")]
    pub(crate) fn dirt_since(&self, page: u32, known: u64) -> Option<PageDirt> {
        self.slot(page)?.dirt.since(known)
    }

    /// The ranges of a resident tile's blocks, made where nobody has asked since its content changed.
    pub(crate) fn ground_blocks(&self, address: TileAddress) -> Option<&BlockRanges> {
        let slot = self.slot(self.pages().get(address)?)?;
        let (content, blocks) = slot
            .blocks
            .get_or_init(|| (slot.content, BlockRanges::new(&slot.tile.tile().heights)));
        // Whoever changes heights and doesn't bring the blocks along makes rays slower, not wrong.
        (*content == slot.content).then_some(blocks)
    }

    #[cfg(feature = "render")]
    /// The resident tiles with their pages, and numbers that change with what they hold.
    pub(crate) fn contents(&self) -> impl Iterator<Item = (u32, TileAddress, u64, &TerrainTile)> {
        self.residency.residents().filter_map(|(page, address)| {
            let slot = self.slot(page)?;
            Some((page, address, slot.content, slot.tile.tile()))
        })
    }

    pub(super) fn slot(&self, page: u32) -> Option<&Slot> {
        self.slots.get(page as usize)?.as_ref()
    }

    pub(super) fn set_slot(&mut self, page: u32, slot: Slot) {
        let page = page as usize;
        if self.slots.len() <= page {
            self.slots.resize_with(page + 1, || None);
        }
        self.slots[page] = Some(slot);
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

    /// Whether everything that the views want, now or soon (and the memory holds), is there and has
    /// faded in: while the views stand still, nothing will change any more. The views are those of
    /// the last [`TerrainSystems::Stream`](crate::terrain::TerrainSystems::Stream).
    #[must_use]
    pub fn is_settled(&self) -> bool {
        self.is_ready()
            && self.loading.is_empty()
            && self.is_requested
            && self.to_refresh.is_empty()
            && self.refreshing.is_empty()
            && !self.has_next
            && self.has_its_edits()
            && self.residency.is_still()
    }

    /// The box that holds a stored tile's ground, resident or not.
    #[must_use]
    pub fn bounds(&self, address: TileAddress) -> Option<TileBounds> {
        let range = self.ground_range(address)?;
        Some(TileBounds::new(&self.manifest.file, address, range))
    }

    /// Moves the field's corners a frame further.
    pub(super) fn step(&mut self, fade: super::fade::Fade) {
        let Self {
            residency,
            slots,
            fades,
            manifest,
            ..
        } = self;
        let step_m = manifest.file.height_step_m as f32;
        residency.step(fade, fades, |address, page, parent| {
            rise_m(slots, address, page, parent, step_m)
        });
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
            return Err("a resident tile has no data".to_owned());
        }
        if self.slots.iter().flatten().count() != self.resident_count() {
            return Err("data of a tile is kept that is not resident".to_owned());
        }
        Ok(())
    }
}

/// How far the ground of the tile on `page` is from its parent's, in metres at most.
fn rise_m(
    slots: &mut [Option<Slot>],
    address: TileAddress,
    page: u32,
    parent: u32,
    height_step_m: f32,
) -> f32 {
    let of = |page: u32| slots.get(page as usize).and_then(Option::as_ref);
    let (Some(slot), Some(coarse)) = (of(page), of(parent)) else {
        return 0.0;
    };
    if let Some(known) = slot.rise_m {
        return known;
    }
    let (tile, coarse) = (slot.tile.tile(), coarse.tile.tile());
    let rise = level_rise(&tile.heights, &coarse.heights, address);
    let rise_m = f32::from(rise) * height_step_m;
    if let Some(slot) = &mut slots[page as usize] {
        slot.rise_m = Some(rise_m);
    }
    rise_m
}

/// How far a tile's ground is from that of its parent at most, in stored units, rounded up. Both
/// are bilinear between samples, so the greatest difference stands at one of the finer ones.
fn level_rise(tile: &HeightTile, parent: &HeightTile, address: TileAddress) -> u16 {
    let half = (TILE_SAMPLES / 2) as i32;
    let first = [address.x, address.z].map(|at| (at % 2) as i32 * half);
    let mut most = 0;
    for z in 0..=TILE_SAMPLES as i32 {
        let (near, far) = (first[1] + z / 2, first[1] + (z + 1) / 2);
        // Twice the parent's height on its own columns.
        let between = |x: i32| {
            i32::from(parent.get(first[0] + x, near)) + i32::from(parent.get(first[0] + x, far))
        };
        let mut left = between(0);
        for x in 0..half {
            let right = between(x + 1);
            let on = 4 * i32::from(tile.get(2 * x, z)) - 2 * left;
            let beside = 4 * i32::from(tile.get(2 * x + 1, z)) - (left + right);
            most = most.max(on.abs()).max(beside.abs());
            left = right;
        }
        most = most.max((4 * i32::from(tile.get(2 * half, z)) - 2 * left).abs());
    }
    // Below four times 2^16.
    ((most + 3) / 4) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tile::{TILE_BORDER, TILE_STORED};

    #[test]
    fn the_rise_of_a_tile_is_the_greatest_difference_from_its_parents_ground() {
        let made = |height: &dyn Fn(i32, i32) -> u16| {
            let side = TILE_STORED as i32;
            let border = TILE_BORDER as i32;
            let samples = (0..side * side)
                .map(|at| height(at % side - border, at / side - border))
                .collect();
            HeightTile::from_samples(samples).expect("as many as belong")
        };
        // A plane is the same on both levels, wherever the child lies.
        for (x, z) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
            let address = TileAddress::new(0, x, z);
            let at = |x: i32, z: i32| (3000 + 2 * x + 6 * z) as u16;
            let parent = made(&|x, z| at(2 * x, 2 * z));
            let (x, z) = (x as i32 * 128, z as i32 * 128);
            let child = made(&|u, v| at(u + x, v + z));
            assert_eq!(level_rise(&child, &parent, address), 0);
            // A spike on an odd sample, a dent on the far corner.
            for (u, v, by) in [(77, 31, 500_i32), (128, 128, -900), (0, 5, 3)] {
                let mut spiked = child.clone();
                let side = TILE_STORED as usize;
                let index = (v as usize + 2) * side + u as usize + 2;
                let sample = &mut spiked.samples_mut()[index];
                *sample = (i32::from(*sample) + by) as u16;
                let rise = level_rise(&spiked, &parent, address);
                assert_eq!(i32::from(rise), by.abs());
            }
        }
    }
}
