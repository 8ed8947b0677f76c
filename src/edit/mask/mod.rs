//! The destruction mask: how scorched the ground is, kept where it is and nowhere else (after the sparse
//! destruction mask of Andersson 2007, section 5.2.5).
//!
//! Texels lie in pages of 64 × 64, which are made when something is drawn there and freed when
//! nothing is left. Their grid starts at the terrain's first sample and knows no end, so a mask
//! doesn't depend on the terrain's size.
//!
//! - **A texel is a power of two of [`EDIT_UNITS`] wide**, the coarsest that gives as many texels a
//!   metre as asked for, but no finer than one unit, 1/64 of the samples' spacing (with samples
//!   16 m apart and more, the default's four a metre aren't reached).
//! - **Edits that reach further than 256 texels draw into coarser layers**, each with texels twice
//!   as wide as the one before, so that no edit touches more than 81 pages. What is read is the
//!   greatest of all layers.
//! - **Every texel is a function of the edits and of its place**, in integers. Craters and stamps
//!   leave the greater of what was there and what they draw; [`Change::Flatten`] and
//!   [`Change::Smooth`] take away as much as they draw the ground elsewhere; [`Change::Raise`]
//!   lifts the ground with what is on it.
//! - **A page holds its mips**, down to one texel, each the mean of four: a distant view reads what
//!   its pixels cover, and craters fade with the distance rather than flicker. Borders need no
//!   apron: a read that crosses one looks into both pages, and a missing page is 0 everywhere.
//!
//! Reading is bilinear and blends two mips. `shaders/destruction.wgsl` does the same as
//! [`DestructionMask::strength`], operation for operation.

#[cfg(feature = "ecs")]
mod component;
#[cfg(feature = "ecs")]
mod follow;
mod read;
mod scorch;
mod table;

#[cfg(feature = "ecs")]
pub use component::TerrainMask;
#[cfg(feature = "ecs")]
pub(crate) use follow::draw_masks;

use super::{Change, EDIT_UNITS, Edit, SampleRect};
#[cfg(feature = "ecs")]
use bevy::prelude::{ReflectComponent, ReflectDefault};
use scorch::{Brush, CraterBrush, FadeBrush, ScorchPlace, StampBrush};
use std::collections::BTreeSet;
use std::ops::{Range, RangeInclusive};
use table::MaskTable;

/// Texels along a page's side, as a power of two.
const PAGE_LOG2: u32 = 6;
/// Texels along a page's side.
pub const MASK_PAGE_TEXELS: usize = 1 << PAGE_LOG2;
/// Mips of a page, from its texels to one for all of it.
pub const MASK_MIPS: usize = PAGE_LOG2 as usize + 1;
/// Where each mip begins in a page.
const MIP_OFFSETS: [usize; MASK_MIPS] = [0, 4096, 5120, 5376, 5440, 5456, 5460];
/// Bytes of a page: its texels row by row, then those of its mips, filled up to whole words.
pub const MASK_PAGE_BYTES: usize = 5464;
/// Words of a slot of the table by which pages are found.
pub const MASK_SLOT_WORDS: usize = table::SLOT_WORDS;
/// What the layer in a slot's tag is shifted by.
pub const MASK_LAYER_SHIFT: u32 = table::LAYER_SHIFT;
/// Texels that an edit reaches at the most before it takes a coarser layer.
const MAX_REACH_TEXELS: u32 = 256;
/// The coarsest texel of the finest layer, as a power of two of units.
const MAX_SHIFT: u32 = 15;
/// Pages that tags can tell apart.
const MAX_PAGES: u64 = (1 << MASK_LAYER_SHIFT) - 2;

/// How fine a destruction mask is and how much it may hold. Put it beside
/// [`Terrain`](crate::terrain::Terrain); without it the defaults are taken.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(
    feature = "ecs",
    derive(bevy::prelude::Component, bevy::prelude::Reflect),
    reflect(Component, Default, Debug, Clone, PartialEq)
)]
pub struct MaskSettings {
    /// Texels per metre of ground, at the least; above 0. What can't be used is taken as the
    /// default, 4.
    pub texels_per_m: f32,
    /// Bytes that pages may take, on the CPU and on the GPU each; 64 MiB by default. Beyond, no new pages are
    /// made, and edits leave no scorch where there is none.
    pub max_bytes: u64,
}

impl Default for MaskSettings {
    fn default() -> Self {
        Self {
            texels_per_m: 4.0,
            max_bytes: 64 << 20,
        }
    }
}

impl MaskSettings {
    /// Texels a metre that are accepted.
    pub const TEXELS_PER_M_RANGE: RangeInclusive<f32> = f32::MIN_POSITIVE..=f32::MAX;
}

/// Which page: its layer, and its column and row in that layer's grid.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct MaskPlace {
    /// The layer; its texels are `2^layer` times as wide as the finest.
    pub layer: u8,
    /// Column of pages, from the terrain's first sample.
    pub x: i32,
    /// Row of pages, from the terrain's first sample.
    pub z: i32,
}

#[derive(Clone, Debug)]
struct Page {
    place: MaskPlace,
    texels: Box<[u8; MASK_PAGE_BYTES]>,
    /// The version of the mask in which it was last changed.
    written: u64,
}

/// How scorched a terrain is; see the [module](self).
///
/// It takes 5.3 KiB a page, and a page for each 16 m × 16 m of ground that is scorched somewhere,
/// with the default's four texels a metre.
#[derive(Clone, Debug)]
pub struct DestructionMask {
    spacing_m: f64,
    settings: MaskSettings,
    /// Width of the finest layer's texels, as a power of two of units.
    shift: u32,
    max_pages: usize,
    pages: Vec<Option<Page>>,
    free: BTreeSet<u32>,
    table: MaskTable,
    /// Pages in each layer.
    layers: [u32; 16],
    version: u64,
    refused: u64,
}

/// A half-open rectangle of a layer's texels, or of a page's.
#[derive(Clone, Copy, Debug)]
struct Texels {
    min: [i64; 2],
    max: [i64; 2],
}

impl Texels {
    const NONE: Self = Self {
        min: [i64::MAX; 2],
        max: [i64::MIN; 2],
    };

    const fn is_empty(&self) -> bool {
        self.min[0] >= self.max[0] || self.min[1] >= self.max[1]
    }

    fn intersection(&self, other: &Self) -> Self {
        Self {
            min: [0, 1].map(|axis| self.min[axis].max(other.min[axis])),
            max: [0, 1].map(|axis| self.max[axis].min(other.max[axis])),
        }
    }

    fn add(&mut self, [x, z]: [i64; 2]) {
        self.min = [self.min[0].min(x), self.min[1].min(z)];
        self.max = [self.max[0].max(x + 1), self.max[1].max(z + 1)];
    }

    /// The pages that they lie in, columns and rows.
    fn pages(&self) -> [Range<i32>; 2] {
        [0, 1].map(|axis| {
            let first = self.min[axis] >> PAGE_LOG2;
            let end = ((self.max[axis] - 1) >> PAGE_LOG2) + 1;
            clamped(first)..clamped(end)
        })
    }

    /// The texels of a page.
    fn of_page(place: MaskPlace) -> Self {
        let first = [place.x, place.z].map(|at| i64::from(at) << PAGE_LOG2);
        Self {
            min: first,
            max: first.map(|at| at + MASK_PAGE_TEXELS as i64),
        }
    }
}

fn clamped(page: i64) -> i32 {
    page.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
}

/// The first texel whose middle is no less than `at`, in half units; texels are `2^shift` units
/// wide.
const fn first_texel(at: i64, shift: u32) -> i64 {
    (at + (1 << shift) - 1) >> (shift + 1)
}

/// The disc of an edit, in half units.
#[derive(Clone, Copy)]
struct Disc {
    centre: [i64; 2],
    reach: i64,
    shift: u32,
}

impl Disc {
    fn new(edit: &Edit, shift: u32) -> Self {
        Self {
            centre: edit.centre.map(|at| 2 * i64::from(at)),
            reach: 2 * i64::from(edit.reach.min(super::MAX_REACH)),
            shift,
        }
    }

    fn texels(&self) -> Texels {
        Texels {
            min: self
                .centre
                .map(|at| first_texel(at - self.reach, self.shift)),
            max: self
                .centre
                .map(|at| first_texel(at + self.reach + 1, self.shift)),
        }
    }

    /// Half units from the disc's centre to a texel's middle, along one axis.
    const fn offset(&self, axis: usize, texel: i64) -> i64 {
        ((2 * texel + 1) << self.shift) - self.centre[axis]
    }

    /// The texels of a row whose middles are no further from the centre than the reach.
    fn row(&self, z: i64) -> Range<i64> {
        let down = self.offset(1, z);
        let Ok(left) = u64::try_from(self.reach * self.reach - down * down) else {
            return 0..0;
        };
        let half = left.isqrt().cast_signed();
        let [x, _] = self.centre;
        first_texel(x - half, self.shift)..first_texel(x + half + 1, self.shift)
    }
}

/// Makes the mips over the texels in `changed` anew.
fn update_mips(texels: &mut [u8; MASK_PAGE_BYTES], changed: Texels) {
    let (mut min, mut max) = (changed.min, changed.max);
    let mut side = MASK_PAGE_TEXELS;
    for mip in 1..MASK_MIPS {
        let (finer, coarser) = texels.split_at_mut(MIP_OFFSETS[mip]);
        let finer = &finer[MIP_OFFSETS[mip - 1]..];
        (min, max) = (min.map(|at| at >> 1), max.map(|at| (at + 1) >> 1));
        for z in min[1] as usize..max[1] as usize {
            let above = &finer[2 * z * side..][..side];
            let below = &finer[(2 * z + 1) * side..][..side];
            let row = &mut coarser[z * side / 2..][..side / 2];
            for (x, texel) in (0..).zip(row).take(max[0] as usize).skip(min[0] as usize) {
                let sum = [
                    above[2 * x],
                    above[2 * x + 1],
                    below[2 * x],
                    below[2 * x + 1],
                ];
                *texel = ((sum.map(u16::from).iter().sum::<u16>() + 2) / 4) as u8;
            }
        }
        side /= 2;
    }
}

impl DestructionMask {
    /// An empty mask for a terrain whose samples are `spacing_m` apart, metres.
    #[must_use]
    pub fn new(spacing_m: f64, settings: &MaskSettings) -> Self {
        let asked = settings.texels_per_m;
        let texels_per_m = if MaskSettings::TEXELS_PER_M_RANGE.contains(&asked) {
            f64::from(asked)
        } else {
            f64::from(MaskSettings::default().texels_per_m)
        };
        let units = f64::from(EDIT_UNITS) / (texels_per_m * spacing_m);
        // Whatever isn't a number is no power of two above the first.
        let shift = (1..=MAX_SHIFT)
            .take_while(|shift| f64::from(1_u32 << shift) <= units)
            .count() as u32;
        let max_pages = (settings.max_bytes / MASK_PAGE_BYTES as u64).min(MAX_PAGES);
        Self {
            spacing_m,
            settings: settings.clone(),
            shift,
            max_pages: max_pages as usize,
            pages: Vec::new(),
            free: BTreeSet::new(),
            table: MaskTable::default(),
            layers: [0; 16],
            version: 0,
            refused: 0,
        }
    }

    /// Whether it was made for this spacing with these settings, bit for bit.
    #[must_use]
    pub const fn is_for(&self, spacing_m: f64, settings: &MaskSettings) -> bool {
        self.spacing_m.to_bits() == spacing_m.to_bits()
            && self.settings.texels_per_m.to_bits() == settings.texels_per_m.to_bits()
            && self.settings.max_bytes == settings.max_bytes
    }

    /// Metres between the samples of the terrain that it is for.
    #[must_use]
    pub const fn spacing_m(&self) -> f64 {
        self.spacing_m
    }

    /// Side of the finest layer's texels, metres.
    #[must_use]
    pub fn texel_m(&self) -> f64 {
        self.spacing_m * f64::from(1_u32 << self.shift) / f64::from(EDIT_UNITS)
    }

    /// The same as a power of two of [`EDIT_UNITS`].
    #[must_use]
    pub const fn texel_shift(&self) -> u32 {
        self.shift
    }

    /// Whether nothing is scorched.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.page_count() == 0
    }

    /// Pages that hold something.
    #[must_use]
    pub fn page_count(&self) -> usize {
        self.pages.len() - self.free.len()
    }

    /// Memory that pages and table take, bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        self.page_count() * MASK_PAGE_BYTES
            + self.pages.len() * size_of::<Option<Page>>()
            + self.table.slots().len() * (4 * MASK_SLOT_WORDS + size_of::<u64>())
    }

    /// How often an edit would have needed a page that there was no room for
    /// ([`MaskSettings::max_bytes`]). Never falls.
    #[must_use]
    pub const fn refused(&self) -> u64 {
        self.refused
    }

    /// Rises with every change. Copies remember which version they are of.
    #[must_use]
    pub const fn version(&self) -> u64 {
        self.version
    }

    /// The layers that have pages, one bit each.
    #[must_use]
    pub fn layers(&self) -> u32 {
        let present = (0..).zip(&self.layers).filter(|(_, pages)| **pages > 0);
        present.fold(0, |bits, (layer, _)| bits | 1 << layer)
    }

    /// One more than the greatest number of a page.
    #[must_use]
    pub fn page_numbers(&self) -> u32 {
        self.pages.len() as u32
    }

    /// Pages that have changed since `version`: number, place, and texels with mips.
    pub fn pages_since(
        &self,
        version: u64,
    ) -> impl Iterator<Item = (u32, MaskPlace, &[u8; MASK_PAGE_BYTES])> {
        let numbered = (0..).zip(&self.pages);
        numbered.filter_map(move |(number, page)| {
            let page = page.as_ref()?;
            (page.written > version).then_some((number, page.place, &*page.texels))
        })
    }

    /// The table by which the GPU finds pages, slot by slot: a tag, x and z. The tag is 0 where the
    /// slot is free, else one more than the page's number, and its layer from
    /// [`MASK_LAYER_SHIFT`] up. There are none or a power of two of them.
    #[must_use]
    pub fn table(&self) -> &[[u32; MASK_SLOT_WORDS]] {
        self.table.slots()
    }

    /// The version in which each slot of [`table`](Self::table) was last written.
    #[must_use]
    pub fn table_written(&self) -> &[u64] {
        self.table.written()
    }

    /// All pages in the order of their places, with texels and mips: what two masks have to agree
    /// in to be equal.
    #[must_use]
    pub fn content(&self) -> Vec<(MaskPlace, &[u8; MASK_PAGE_BYTES])> {
        let pages = self.pages.iter().flatten();
        let mut content: Vec<_> = pages.map(|page| (page.place, &*page.texels)).collect();
        content.sort_unstable_by_key(|(place, _)| *place);
        content
    }

    /// Draws an edit over what is there, and says how many pages have changed. Where a page is
    /// needed and there is room for none, [`refused`](Self::refused) rises and nothing is drawn.
    ///
    /// Costs some nanoseconds for each texel within the edit's reach, of which there are at most
    /// 512 × 512.
    pub fn draw(&mut self, edit: &Edit) -> usize {
        self.version += 1;
        self.draw_within(edit, None)
    }

    /// Draws the texels whose middles lie in `rect` anew, as if nothing but `edits` had ever been
    /// drawn there, in this order, and says how many pages were written. `edits` must hold all
    /// that [`touch`](Edit::rect) the rectangle; others do no harm. After it, the mask has the bytes
    /// that it would have without the edits that are missing, as long as none was refused a page.
    pub fn redraw<'a>(
        &mut self,
        rect: SampleRect,
        edits: impl IntoIterator<Item = &'a Edit>,
    ) -> usize {
        self.version += 1;
        let mut cleared = Vec::new();
        for layer in 0..self.layers.len() as u8 {
            let within = self.texels_of(rect, layer);
            for place in self.pages_in(layer, within) {
                let Some(page) = self.page_mut(place) else {
                    continue;
                };
                let inside = within.intersection(&Texels::of_page(place));
                let first = Texels::of_page(place).min;
                let local = Texels {
                    min: [0, 1].map(|axis| inside.min[axis] - first[axis]),
                    max: [0, 1].map(|axis| inside.max[axis] - first[axis]),
                };
                for z in local.min[1]..local.max[1] {
                    let row = &mut page.texels[z as usize * MASK_PAGE_TEXELS..][..MASK_PAGE_TEXELS];
                    row[local.min[0] as usize..local.max[0] as usize].fill(0);
                }
                update_mips(&mut page.texels, local);
                cleared.push(place);
            }
        }
        let version = self.version;
        for edit in edits {
            self.draw_within(edit, Some(rect));
        }
        for place in cleared {
            if let Some(page) = self.page_mut(place) {
                page.written = version;
                self.free_if_empty(place);
            }
        }
        let written = self.pages.iter().flatten();
        written.filter(|page| page.written == version).count()
    }

    /// Forgets everything that was drawn, and frees all pages.
    pub fn clear(&mut self) {
        self.version += 1;
        self.pages.clear();
        self.free.clear();
        self.table = MaskTable::default();
        self.layers = [0; 16];
    }

    /// The layer that an edit of this reach draws into.
    fn layer_for(&self, reach: u32) -> u8 {
        let reach = reach.min(super::MAX_REACH);
        (0..15)
            .find(|layer| reach >> (self.shift + u32::from(*layer)) <= MAX_REACH_TEXELS)
            .unwrap_or(15)
    }

    fn draw_within(&mut self, edit: &Edit, within: Option<SampleRect>) -> usize {
        let reach = edit.reach.min(super::MAX_REACH);
        let layer = self.layer_for(reach);
        match &edit.change {
            Change::Crater {
                bowl, seed, scorch, ..
            } if *scorch > 0 => {
                let brush = CraterBrush::new(reach, *bowl, *seed, *scorch);
                self.paint(edit, layer, within, &brush, true)
            }
            Change::Stamp {
                image,
                turn,
                scorch,
                ..
            } if *scorch > 0 => StampBrush::new(reach, image, *turn, *scorch)
                .map_or(0, |brush| self.paint(edit, layer, within, &brush, true)),
            Change::Flatten {
                strength, hardness, ..
            }
            | Change::Smooth {
                strength, hardness, ..
            } => {
                let brush = FadeBrush::new(reach, *hardness, *strength);
                let layers = 0..self.layers.len() as u8;
                layers
                    .map(|layer| self.paint(edit, layer, within, &brush, false))
                    .sum()
            }
            _ => 0,
        }
    }

    /// The texels of a layer whose middles lie in a rectangle of samples.
    fn texels_of(&self, rect: SampleRect, layer: u8) -> Texels {
        let shift = self.shift + u32::from(layer);
        let texels = |at: i32| first_texel(2 * i64::from(EDIT_UNITS) * i64::from(at), shift);
        Texels {
            min: rect.min.map(texels),
            max: rect.max.map(texels),
        }
    }

    /// The places of the pages of a layer that there are in a rectangle of its texels.
    fn pages_in(&self, layer: u8, texels: Texels) -> Vec<MaskPlace> {
        if texels.is_empty() || self.layers[usize::from(layer)] == 0 {
            return Vec::new();
        }
        let [columns, rows] = texels.pages();
        let places = columns.len().saturating_mul(rows.len());
        if places <= self.pages.len() {
            let mut found = places_of(layer, columns, rows);
            found.retain(|place| self.table.find(*place).is_some());
            return found;
        }
        let pages = self.pages.iter().flatten().map(|page| page.place);
        pages
            .filter(|at| at.layer == layer && columns.contains(&at.x) && rows.contains(&at.z))
            .collect()
    }

    fn page_mut(&mut self, place: MaskPlace) -> Option<&mut Page> {
        let number = self.table.find(place)?;
        self.pages.get_mut(number as usize)?.as_mut()
    }

    /// Applies a brush to the texels of a layer that an edit reaches.
    fn paint<B: Brush>(
        &mut self,
        edit: &Edit,
        layer: u8,
        within: Option<SampleRect>,
        brush: &B,
        makes_pages: bool,
    ) -> usize {
        let disc = Disc::new(edit, self.shift + u32::from(layer));
        let mut texels = disc.texels();
        if let Some(rect) = within {
            texels = texels.intersection(&self.texels_of(rect, layer));
        }
        if texels.is_empty() {
            return 0;
        }
        let places = if makes_pages {
            let [columns, rows] = texels.pages();
            places_of(layer, columns, rows)
        } else {
            self.pages_in(layer, texels)
        };
        let mut changed_pages = 0;
        let mut fresh: Option<Box<[u8; MASK_PAGE_BYTES]>> = None;
        for place in places {
            let number = self.table.find(place);
            let page = number.and_then(|number| self.pages[number as usize].as_mut());
            let is_there = page.is_some();
            let page = match page {
                Some(page) => &mut *page.texels,
                None => &mut **fresh.get_or_insert_with(|| Box::new([0; MASK_PAGE_BYTES])),
            };
            let changed = paint_page(page, place, &disc, texels, brush);
            if changed.is_empty() {
                continue;
            }
            update_mips(page, changed);
            if is_there {
                let version = self.version;
                if let Some(page) = self.page_mut(place) {
                    page.written = version;
                }
                if !makes_pages {
                    self.free_if_empty(place);
                }
            } else if let Some(page) = fresh.take()
                && !self.add(place, page)
            {
                continue;
            }
            changed_pages += 1;
        }
        changed_pages
    }

    /// Adds a page; false where there is no room for it.
    fn add(&mut self, place: MaskPlace, texels: Box<[u8; MASK_PAGE_BYTES]>) -> bool {
        if self.page_count() >= self.max_pages {
            self.refused += 1;
            return false;
        }
        let page = Some(Page {
            place,
            texels,
            written: self.version,
        });
        let number = if let Some(number) = self.free.pop_first() {
            self.pages[number as usize] = page;
            number
        } else {
            self.pages.push(page);
            self.pages.len() as u32 - 1
        };
        self.table.insert(place, number, self.version);
        self.layers[usize::from(place.layer)] += 1;
        true
    }

    fn free_if_empty(&mut self, place: MaskPlace) {
        let Some(number) = self.table.find(place) else {
            return;
        };
        let slot = &mut self.pages[number as usize];
        let empty = slot
            .as_ref()
            .is_some_and(|page| page.texels[..MIP_OFFSETS[1]] == [0; MIP_OFFSETS[1]]);
        if !empty {
            return;
        }
        *slot = None;
        self.free.insert(number);
        self.table.remove(place, self.version);
        self.layers[usize::from(place.layer)] -= 1;
        // Numbers at the end come back, so that copies needn't keep room for them.
        while let Some(None) = self.pages.last() {
            self.pages.pop();
            self.free.remove(&(self.pages.len() as u32));
        }
    }
}

/// All places of these columns and rows, row by row.
fn places_of(layer: u8, columns: Range<i32>, rows: Range<i32>) -> Vec<MaskPlace> {
    let row = |z: i32| columns.clone().map(move |x| MaskPlace { layer, x, z });
    rows.flat_map(row).collect()
}

/// Applies a brush to the texels of a page that lie in the disc and in `texels`, and tells which of
/// the page's own have changed.
fn paint_page<B: Brush>(
    page: &mut [u8; MASK_PAGE_BYTES],
    place: MaskPlace,
    disc: &Disc,
    texels: Texels,
    brush: &B,
) -> Texels {
    let own = Texels::of_page(place);
    let inside = texels.intersection(&own);
    let mut changed = Texels::NONE;
    for z in inside.min[1]..inside.max[1] {
        let reached = disc.row(z);
        let span = reached.start.max(inside.min[0])..reached.end.min(inside.max[0]);
        let down = disc.offset(1, z) as i32;
        let row = (z - own.min[1]) as usize * MASK_PAGE_TEXELS;
        for x in span {
            let texel = &mut page[row + (x - own.min[0]) as usize];
            let seen = ScorchPlace {
                from_centre: [disc.offset(0, x) as i32, down],
                texel: [x as u32, z as u32],
            };
            let value = brush.value(seen, *texel);
            if value != *texel {
                *texel = value;
                changed.add([x - own.min[0], z - own.min[1]]);
            }
        }
    }
    changed
}
