//! What is resident, what is on its way out, and the field that follows from both.

use super::PageTable;
use super::changes::ChangeLog;
use super::fade::{Fade, FadeView};
use crate::lattice::{Lattice, ResidencyField, ViewLod};
use crate::residency::ResidentTiles;
use crate::terrain::TerrainManifest;
use crate::tile::TileAddress;
use glam::{IVec2, UVec2};

/// Corners that are no further apart than this are noted as one change.
const RUN_GAP: u32 = 64;
/// Rank of a tile that no view wants.
const UNWANTED: u32 = u32::MAX;

/// A tile that has a page.
#[derive(Clone, Copy, Debug)]
struct Resident {
    address: TileAddress,
    /// Place in the latest plan, or [`UNWANTED`].
    rank: u32,
    /// Number of the latest plan that wanted it.
    wanted_at: u64,
    /// Resident children, leaving ones included.
    children: u8,
    /// Whether the field fades away from it so that its page can be freed.
    leaving: bool,
}

/// A half-open rectangle of the field's cells.
#[derive(Clone, Copy, Debug)]
struct Cells {
    low: UVec2,
    high: UVec2,
}

/// The resident tiles of a terrain, without the tiles themselves.
///
/// A tile is *readable* if it is resident and not leaving. Parents outlast their children: a tile
/// becomes readable only under a readable parent, and leaves only once it has no resident child.
/// So "readable" is closed towards the root, and each cell of the field has a finest readable
/// level. Corners of the field move towards the coarsest of their cells' levels and never below
/// it, which is why nothing that isn't resident is ever read.
#[derive(Debug)]
pub(super) struct Residency {
    lattice: Lattice,
    pub(super) pages: PageTable,
    pub(super) resident: ResidentTiles,
    pub(super) field: ResidencyField,
    /// By page. Pages are numbers from a pool that other terrains draw from too.
    residents: Vec<Option<Resident>>,
    resident_count: usize,
    leaving: Vec<u32>,
    plan: u64,
    /// Pages of tiles that no view wanted in the latest plan, those to go first in front.
    unwanted: Vec<u32>,
    /// Finest level readable all over a cell, cell by cell.
    cells: Vec<u8>,
    /// Corners that are not where they should be.
    moving: Vec<u32>,
    /// Corners that have moved in this step.
    moved: Vec<u32>,
    is_moving: Vec<bool>,
    /// Whether corners go where they should be without fading: nothing has been seen yet.
    pub(super) is_appearing: bool,
    /// Steps so far, which spreads the rounding of slow fades over frames.
    steps: u64,
    /// Changes of the page table; its version rises with what the pages hold too.
    pub(super) page_log: ChangeLog,
    pub(super) field_log: ChangeLog,
}

impl Residency {
    pub(super) fn new(lattice: &Lattice, manifest: &TerrainManifest) -> Self {
        let root_level = lattice.root_level.unsigned_abs() as u8;
        let field = ResidencyField::new(lattice, root_level);
        Self {
            lattice: *lattice,
            pages: PageTable::new(&manifest.file),
            resident: ResidentTiles::new(&manifest.index),
            residents: Vec::new(),
            resident_count: 0,
            leaving: Vec::new(),
            plan: 0,
            unwanted: Vec::new(),
            cells: vec![root_level; (field.cells.x * field.cells.y) as usize],
            moving: Vec::new(),
            moved: Vec::new(),
            is_moving: vec![false; field.corners.len()],
            field,
            is_appearing: true,
            steps: 0,
            page_log: ChangeLog::default(),
            field_log: ChangeLog::default(),
        }
    }

    pub(super) fn resident_count(&self) -> usize {
        self.resident_count
    }

    /// Tiles whose pages will be free once they have faded.
    pub(super) fn leaving_count(&self) -> usize {
        self.leaving.len()
    }

    /// Resident tiles with their pages, in the order of pages.
    pub(super) fn residents(&self) -> impl Iterator<Item = (u32, TileAddress)> {
        let residents = (0..).zip(&self.residents);
        residents.filter_map(|(page, tile)| Some((page, tile.as_ref()?.address)))
    }

    /// Whether no tile is leaving and no corner on its way.
    pub(super) fn is_still(&self) -> bool {
        self.leaving.is_empty() && self.moving.is_empty()
    }

    /// Whether a tile may be read: resident, and not on its way out.
    pub(super) fn is_readable(&self, address: TileAddress) -> bool {
        self.pages
            .get(address)
            .is_some_and(|page| self.resident(page).is_some_and(|tile| !tile.leaving))
    }

    fn resident(&self, page: u32) -> Option<&Resident> {
        self.residents.get(page as usize)?.as_ref()
    }

    fn resident_mut(&mut self, page: u32) -> Option<&mut Resident> {
        self.residents.get_mut(page as usize)?.as_mut()
    }

    fn set_page(&mut self, address: TileAddress, page: Option<u32>) {
        if let Some(index) = self.pages.set(address, page) {
            self.page_log.note(index..index + 1);
        }
    }

    fn is_root(&self, address: TileAddress) -> bool {
        i32::from(address.level) == self.lattice.root_level
    }

    /// Takes over plan number `plan`: `wanted`, each tile with its rank, parents before their
    /// children.
    pub(super) fn apply_plan(
        &mut self,
        plan: u64,
        wanted: impl IntoIterator<Item = (TileAddress, u32)>,
    ) {
        self.plan = plan;
        for tile in self.residents.iter_mut().flatten() {
            tile.rank = UNWANTED;
        }
        for (address, rank) in wanted {
            let Some(page) = self.pages.get(address) else {
                continue;
            };
            let Some(tile) = self.resident_mut(page) else {
                continue;
            };
            tile.rank = rank;
            tile.wanted_at = plan;
            if tile.leaving {
                tile.leaving = false;
                self.leaving.retain(|&other| other != page);
                self.refresh_cells(address);
            }
        }
        let Self {
            residents,
            unwanted,
            ..
        } = self;
        unwanted.clear();
        let pages = (0..).zip(residents.iter());
        unwanted.extend(
            pages
                .filter(|(_, tile)| tile.is_some_and(|tile| tile.rank == UNWANTED && !tile.leaving))
                .map(|(page, _)| page),
        );
        unwanted.sort_unstable_by_key(|&page| {
            let tile = residents[page as usize].as_ref();
            tile.map(|tile| (tile.wanted_at, tile.address.level, page))
        });
    }

    /// Makes a tile resident on the page that `page` gives. `None`, and nothing done, where it
    /// gives none or where the tile's parent is not readable.
    pub(super) fn activate(
        &mut self,
        address: TileAddress,
        rank: u32,
        page: impl FnOnce() -> Option<u32>,
    ) -> Option<u32> {
        let is_root = self.is_root(address);
        if !is_root && !self.is_readable(address.parent()) {
            return None;
        }
        if !self.pages.holds(address) || self.pages.get(address).is_some() {
            return None;
        }
        let page = page()?;
        if !is_root
            && let Some(parent) = self.pages.get(address.parent())
            && let Some(parent) = self.resident_mut(parent)
        {
            parent.children += 1;
        }
        if self.residents.len() <= page as usize {
            self.residents.resize(page as usize + 1, None);
        }
        self.residents[page as usize] = Some(Resident {
            address,
            rank,
            wanted_at: self.plan,
            children: 0,
            leaving: false,
        });
        self.resident_count += 1;
        self.resident.insert(address);
        self.set_page(address, Some(page));
        self.refresh_cells(address);
        Some(page)
    }

    /// The tile on a page.
    pub(super) fn tile_on(&self, page: u32) -> Option<TileAddress> {
        self.resident(page).map(|tile| tile.address)
    }

    /// The page of a tile without resident children that isn't leaving and that `picks` picks.
    pub(super) fn childless_where(&self, picks: impl Fn(TileAddress) -> bool) -> Option<u32> {
        let pages = (0..).zip(&self.residents);
        pages
            .filter_map(|(page, tile)| Some((page, tile.as_ref()?)))
            .find(|(_, tile)| {
                tile.children == 0
                    && !tile.leaving
                    && !self.is_root(tile.address)
                    && picks(tile.address)
            })
            .map(|(page, _)| page)
    }

    /// A page in use from number `limit` on.
    pub(super) fn page_beyond(&self, limit: u32) -> Option<u32> {
        let pages = (limit..).zip(self.residents.iter().skip(limit as usize));
        pages
            .filter(|(_, tile)| tile.is_some())
            .map(|(page, _)| page)
            .next()
    }

    /// Moves a tile to another page.
    pub(super) fn relocate(&mut self, from: u32, to: u32) {
        let Some(tile) = self.residents.get_mut(from as usize).and_then(Option::take) else {
            return;
        };
        if self.residents.len() <= to as usize {
            self.residents.resize(to as usize + 1, None);
        }
        self.residents[to as usize] = Some(tile);
        for page in self.leaving.iter_mut().chain(&mut self.unwanted) {
            if *page == from {
                *page = to;
            }
        }
        self.set_page(tile.address, Some(to));
    }

    /// The tile that may go first, if any may: no view wants it, and it has no resident child.
    /// The least of what is returned goes first, across terrains.
    pub(super) fn first_to_go(&self) -> Option<(u64, u8, u32)> {
        self.unwanted.iter().find_map(|&page| {
            let tile = self.resident(page)?;
            let may = tile.rank == UNWANTED
                && !tile.leaving
                && tile.children == 0
                && !self.is_root(tile.address);
            may.then_some((tile.wanted_at, tile.address.level, page))
        })
    }

    /// Begins to fade the tile on `page` out, whose page is then freed.
    pub(super) fn send_off(&mut self, page: u32) {
        let Some(tile) = self.resident_mut(page) else {
            return;
        };
        tile.leaving = true;
        let address = tile.address;
        self.unwanted.retain(|&other| other != page);
        self.leaving.push(page);
        self.refresh_cells(address);
    }

    /// Frees the pages of leaving tiles that the field has faded away from, and hands each page
    /// and its tile to `freed`.
    pub(super) fn free_faded(&mut self, mut freed: impl FnMut(u32, TileAddress)) {
        let mut at = 0;
        while at < self.leaving.len() {
            let page = self.leaving[at];
            let Some(&Resident { address, .. }) = self.resident(page) else {
                self.leaving.swap_remove(at);
                continue;
            };
            if !self.has_faded(address) {
                at += 1;
                continue;
            }
            self.leaving.swap_remove(at);
            self.residents[page as usize] = None;
            self.resident_count -= 1;
            self.resident.remove(address);
            self.set_page(address, None);
            if let Some(parent) = self.pages.get(address.parent())
                && let Some(parent) = self.resident_mut(parent)
            {
                parent.children -= 1;
            }
            freed(page, address);
        }
    }

    /// Whether nothing of the tile's own level is read any more, all over it.
    fn has_faded(&self, address: TileAddress) -> bool {
        let least = (u16::from(address.level) + 1) << 8;
        let Cells { low, high } = self.cells_of(address);
        (low.y..=high.y).all(|z| {
            let first = self.field.corner_index(UVec2::new(low.x, z));
            let last = self.field.corner_index(UVec2::new(high.x, z));
            self.field.corners[first..=last]
                .iter()
                .all(|&corner| corner >= least)
        })
    }

    /// Level of the nodes that are as large as a cell.
    fn cell_level(&self) -> u32 {
        self.field.cell_log2 - self.lattice.node_log2(0)
    }

    /// The cells that a tile touches.
    fn cells_of(&self, address: TileAddress) -> Cells {
        let (level, cell_level) = (u32::from(address.level), self.cell_level());
        let at = UVec2::new(address.x, address.z);
        let (low, high) = if level >= cell_level {
            let log2 = UVec2::splat(level - cell_level);
            (at << log2, (at + 1) << log2)
        } else {
            let low = at >> UVec2::splat(cell_level - level);
            (low, low + 1)
        };
        Cells {
            low: low.min(self.field.cells),
            high: high.min(self.field.cells),
        }
    }

    /// Brings cells and corners up to date after a tile has become readable or unreadable.
    fn refresh_cells(&mut self, address: TileAddress) {
        let Cells { low, high } = self.cells_of(address);
        // Nothing below the tile is readable, now or before, so a tile that fills its cells says
        // all there is to say about them.
        let known = (u32::from(address.level) >= self.cell_level()).then(|| {
            if self.is_readable(address) || self.is_root(address) {
                address.level
            } else {
                address.level + 1
            }
        });
        let mut changed = false;
        for z in low.y..high.y {
            for x in low.x..high.x {
                let cell = UVec2::new(x, z);
                let level = known.unwrap_or_else(|| self.finest_readable(cell));
                let known = &mut self.cells[(z * self.field.cells.x + x) as usize];
                changed |= *known != level;
                *known = level;
            }
        }
        if !changed {
            return;
        }
        if self.is_appearing {
            self.jump(Cells { low, high });
            return;
        }
        for z in low.y..=high.y {
            for x in low.x..=high.x {
                let corner = UVec2::new(x, z);
                let index = self.field.corner_index(corner);
                if !self.is_moving[index] && self.field.corners[index] != self.target(corner) {
                    self.is_moving[index] = true;
                    self.moving.push(index as u32);
                }
            }
        }
    }

    /// The finest level that is readable all over a cell, from the tiles themselves.
    fn finest_readable(&self, cell: UVec2) -> u8 {
        let cell_level = self.cell_level() as u8;
        let root_level = self.lattice.root_level.unsigned_abs() as u8;
        for level in (cell_level..=root_level).rev() {
            let at = cell >> UVec2::splat(u32::from(level - cell_level));
            if !self.is_readable(TileAddress::new(level, at.x, at.y)) {
                return (level + 1).min(root_level);
            }
        }
        self.finest_below(TileAddress::new(cell_level, cell.x, cell.y))
    }

    /// The finest level that is readable all over a readable tile.
    fn finest_below(&self, address: TileAddress) -> u8 {
        let children = address.children().into_iter().flatten();
        children
            .filter(|&child| self.pages.holds(child))
            .map(|child| {
                if self.is_readable(child) {
                    self.finest_below(child)
                } else {
                    address.level
                }
            })
            .max()
            .unwrap_or(address.level)
    }

    /// What a corner moves towards: the coarsest of its cells' finest readable levels.
    fn target(&self, corner: UVec2) -> u16 {
        let mut level = 0;
        for z in corner.y.saturating_sub(1)..(corner.y + 1).min(self.field.cells.y) {
            for x in corner.x.saturating_sub(1)..(corner.x + 1).min(self.field.cells.x) {
                level = level.max(self.cells[(z * self.field.cells.x + x) as usize]);
            }
        }
        u16::from(level) << 8
    }

    /// Puts the corners of `cells` where they should be, at once.
    fn jump(&mut self, cells: Cells) {
        for z in cells.low.y..=cells.high.y {
            for x in cells.low.x..=cells.high.x {
                let corner = UVec2::new(x, z);
                let index = self.field.corner_index(corner);
                self.field.corners[index] = self.target(corner);
            }
        }
        let first = self.field.corner_index(cells.low) as u32;
        let last = self.field.corner_index(cells.high) as u32;
        self.field_log.note(first..last + 1);
    }

    /// Moves the corners that aren't where they should be as far as `fade` lets them, or all the
    /// way where no view would see it. `rise_m` says how far the ground of a tile is from its parent's,
    /// in metres at most, given both pages.
    pub(super) fn step(
        &mut self,
        fade: Fade,
        views: &[FadeView],
        mut rise_m: impl FnMut(TileAddress, u32, u32) -> f32,
    ) {
        if self.moving.is_empty() {
            return;
        }
        self.steps += 1;
        self.moved.clear();
        let mut at = 0;
        while at < self.moving.len() {
            let index = self.moving[at] as usize;
            let columns = self.field.cells.x + 1;
            let corner = UVec2::new(self.moving[at] % columns, self.moving[at] / columns);
            let target = self.target(corner);
            let value = self.field.corners[index];
            let moved = if self.is_unseen(corner, target, views) {
                target
            } else {
                let px = if fade.max_px < f32::INFINITY {
                    self.pixels_a_level(corner, target, views, &mut rise_m)
                } else {
                    0.0
                };
                let step = fade.step(px, self.steps);
                if value < target {
                    target.min(value.saturating_add(step))
                } else {
                    target.max(value.saturating_sub(step))
                }
            };
            if moved != value {
                self.moved.push(index as u32);
            }
            self.field.corners[index] = moved;
            if moved == target {
                self.is_moving[index] = false;
                self.moving.swap_remove(at);
            } else {
                at += 1;
            }
        }
        self.moved.sort_unstable();
        let near = |pair: &[u32]| pair[1] - pair[0] < RUN_GAP;
        for run in self.moved.chunk_by(|&a, &b| near(&[a, b])) {
            if let [first, .., last] | [first @ last] = run {
                self.field_log.note(*first..*last + 1);
            }
        }
    }

    /// How far a level's difference is seen at most where a corner has a say, in pixels: the
    /// largest of all levels that are blended there and of all views.
    fn pixels_a_level(
        &self,
        corner: UVec2,
        target: u16,
        views: &[FadeView],
        rise_m: &mut impl FnMut(TileAddress, u32, u32) -> f32,
    ) -> f32 {
        let low = corner.saturating_sub(UVec2::ONE);
        let high = (corner + 1).min(self.field.cells);
        let (mut finest, mut coarsest) = (target, target);
        for z in low.y..=high.y {
            let first = self.field.corner_index(UVec2::new(low.x, z));
            let last = self.field.corner_index(UVec2::new(high.x, z));
            for &value in &self.field.corners[first..=last] {
                finest = finest.min(value);
                coarsest = coarsest.max(value);
            }
        }
        let cells = Cells { low, high };
        let mut rise: f32 = 0.0;
        for level in finest >> 8..(coarsest + 255) >> 8 {
            for tile in self.tiles_in(cells, level as u8) {
                let pages = [tile, tile.parent()].map(|tile| self.pages.get(tile));
                if let [Some(page), Some(parent)] = pages {
                    rise = rise.max(rise_m(tile, page, parent));
                }
            }
        }
        let (low, high) = self.box_of(cells);
        let seen = views.iter().map(|view| view.pixels(rise, low, high));
        seen.fold(0.0, f32::max)
    }

    /// The part of the lattice that cells cover.
    fn box_of(&self, cells: Cells) -> (IVec2, IVec2) {
        let log2 = UVec2::splat(self.field.cell_log2);
        let low = (cells.low << log2).as_ivec2();
        let high = (cells.high << log2).as_ivec2().min(self.lattice.extent);
        (low, high)
    }

    /// Whether no view would see this corner jump to `target`: whether, wherever the corner has
    /// a say, every view reads more coarsely than the field asks for, before and after. The
    /// neighbouring corners count too: where they keep the field up, the blend shows this one.
    fn is_unseen(&self, corner: UVec2, target: u16, views: &[FadeView]) -> bool {
        let low = corner.saturating_sub(UVec2::ONE);
        let high = (corner + 1).min(self.field.cells);
        let mut level = target;
        for z in low.y..=high.y {
            let first = self.field.corner_index(UVec2::new(low.x, z));
            let last = self.field.corner_index(UVec2::new(high.x, z));
            let row = &self.field.corners[first..=last];
            level = row.iter().copied().fold(level, u16::max);
        }
        let (low, high) = self.box_of(Cells { low, high });
        views
            .iter()
            .all(|view| finest_detail(&self.lattice, &view.lod, low, high) >= i32::from(level))
    }

    /// Checks that every promise of this module is kept; says which one isn't.
    pub(super) fn validate(&self) -> Result<(), String> {
        let residents = (0..).zip(&self.residents);
        let mut count = 0;
        for (page, tile) in residents.filter_map(|(page, tile)| Some((page, tile.as_ref()?))) {
            count += 1;
            let address = tile.address;
            if self.pages.get(address) != Some(page) || !self.resident.contains(address) {
                return Err(format!(
                    "page {page} holds {address}, the table says otherwise"
                ));
            }
            if !self.is_root(address) && !self.is_readable(address.parent()) {
                return Err(format!("{address} is resident under an unreadable parent"));
            }
            let children = address.children().into_iter().flatten();
            let children = children.filter(|&child| self.pages.get(child).is_some());
            if children.count() != usize::from(tile.children) {
                return Err(format!(
                    "{address} miscounts its {} children",
                    tile.children
                ));
            }
        }
        let listed = self
            .pages
            .flat()
            .iter()
            .filter(|&&page| page != PageTable::NONE);
        if listed.count() != count || count != self.resident_count || count != self.resident.count()
        {
            return Err(format!(
                "{count} tiles are resident, page table or count differ"
            ));
        }
        for z in 0..self.field.cells.y {
            for x in 0..self.field.cells.x {
                self.validate_cell(UVec2::new(x, z))?;
            }
        }
        Ok(())
    }

    fn validate_cell(&self, cell: UVec2) -> Result<(), String> {
        let finest = self.finest_readable(cell);
        if self.cells[(cell.y * self.field.cells.x + cell.x) as usize] != finest {
            return Err(format!("cell {cell} is out of date: {finest} is readable"));
        }
        let root_level = self.lattice.root_level.unsigned_abs() as u8;
        let corners = [UVec2::ZERO, UVec2::X, UVec2::Y, UVec2::ONE].map(|offset| {
            let corner = cell + offset;
            (corner, self.field.corners[self.field.corner_index(corner)])
        });
        // What the bilinear blend can fall to is the least corner; every level from there up must
        // be resident all over the cell (leaving tiles are, until they have faded).
        let least = corners
            .iter()
            .map(|&(_, value)| value >> 8)
            .min()
            .unwrap_or(0);
        for level in least..u16::from(root_level) {
            let cells = Cells {
                low: cell,
                high: cell + 1,
            };
            if let Some(hole) = self.first_hole(cells, level as u8) {
                return Err(format!(
                    "cell {cell} reads level {least}, {hole} is not resident"
                ));
            }
        }
        for (corner, value) in corners {
            let settled = value == self.target(corner);
            if !settled && !self.is_moving[self.field.corner_index(corner)] {
                return Err(format!("corner {corner} stands still off its target"));
            }
        }
        Ok(())
    }

    /// A tile of `level` within `cells` that is not resident.
    fn first_hole(&self, cells: Cells, level: u8) -> Option<TileAddress> {
        self.tiles_in(cells, level)
            .find(|&tile| self.pages.holds(tile) && self.pages.get(tile).is_none())
    }

    /// The squares of `level` that touch `cells`.
    fn tiles_in(&self, cells: Cells, level: u8) -> impl Iterator<Item = TileAddress> + use<> {
        let cell_level = self.cell_level();
        let level_bits = u32::from(level);
        let (low, high) = if level_bits >= cell_level {
            let log2 = UVec2::splat(level_bits - cell_level);
            (cells.low >> log2, ((cells.high - 1) >> log2) + 1)
        } else {
            let log2 = UVec2::splat(cell_level - level_bits);
            (cells.low << log2, cells.high << log2)
        };
        (low.y..high.y)
            .flat_map(move |z| (low.x..high.x).map(move |x| TileAddress::new(level, x, z)))
    }
}

/// The finest level of detail (8.8, at least 0) that a view asks for anywhere in a box.
fn finest_detail(lattice: &Lattice, view: &ViewLod, low: IVec2, high: IVec2) -> i32 {
    let distance = view.box_distance(low, high);
    let level = (0..lattice.root_level)
        .find(|&level| distance < view.reach[lattice.level_index(level)])
        .unwrap_or(lattice.root_level);
    let index = lattice.level_index(level);
    let beyond = distance.saturating_sub(view.morph_start[index]).max(0);
    let zone_log2 = view.zone_log2[index];
    let morph = ((i64::from(beyond) << 8) >> zone_log2).min(256) as i32;
    (level << 8) + morph
}

#[cfg(test)]
mod tests;
