//! What is resident, what is on its way out, and the field that follows from both.

use super::PageTable;
use crate::lattice::{Lattice, ResidencyField, ViewLod};
use crate::tile::TileAddress;
use glam::{IVec2, UVec2};

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
    pub(super) field: ResidencyField,
    residents: Vec<Option<Resident>>,
    /// Free pages, the next one last.
    free: Vec<u32>,
    leaving: Vec<u32>,
    plan: u64,
    /// Finest level readable all over a cell, cell by cell.
    cells: Vec<u8>,
    /// Corners that are not where they should be.
    moving: Vec<u32>,
    is_moving: Vec<bool>,
    /// What is left over of the last step, in 1/256 levels.
    carry: f32,
    pub(super) pages_version: u64,
    pub(super) field_version: u64,
}

impl Residency {
    pub(super) fn new(lattice: &Lattice, pages: PageTable, capacity: u32) -> Self {
        let root_level = lattice.root_level.unsigned_abs() as u8;
        let field = ResidencyField::new(lattice, root_level);
        Self {
            lattice: *lattice,
            pages,
            residents: vec![None; capacity as usize],
            free: (0..capacity).rev().collect(),
            leaving: Vec::new(),
            plan: 0,
            cells: vec![root_level; (field.cells.x * field.cells.y) as usize],
            moving: Vec::new(),
            is_moving: vec![false; field.corners.len()],
            field,
            carry: 0.0,
            pages_version: 1,
            field_version: 1,
        }
    }

    pub(super) fn resident_count(&self) -> usize {
        self.residents.len() - self.free.len()
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

    fn is_root(&self, address: TileAddress) -> bool {
        i32::from(address.level) == self.lattice.root_level
    }

    /// Takes over a plan: `wanted`, best first, parents before their children.
    pub(super) fn apply_plan(&mut self, wanted: &[TileAddress]) {
        self.plan += 1;
        for tile in self.residents.iter_mut().flatten() {
            tile.rank = UNWANTED;
        }
        let plan = self.plan;
        for (rank, &address) in (0..).zip(wanted) {
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
    }

    /// Makes a tile resident. `None`, and nothing done, where there is no free page or where its
    /// parent is not readable.
    pub(super) fn activate(&mut self, address: TileAddress, rank: u32) -> Option<u32> {
        let is_root = self.is_root(address);
        if !is_root && !self.is_readable(address.parent()) {
            return None;
        }
        if !self.pages.holds(address) || self.pages.get(address).is_some() {
            return None;
        }
        let page = self.free.pop()?;
        if !is_root
            && let Some(parent) = self.pages.get(address.parent())
            && let Some(parent) = self.resident_mut(parent)
        {
            parent.children += 1;
        }
        self.residents[page as usize] = Some(Resident {
            address,
            rank,
            wanted_at: self.plan,
            children: 0,
            leaving: false,
        });
        self.pages.set(address, Some(page));
        self.pages_version += 1;
        self.refresh_cells(address);
        Some(page)
    }

    /// Sees to it that `wanted` pages are free or on their way to be, as far as there are tiles
    /// that no view wants: those go first that have been unwanted for longest.
    pub(super) fn make_room(&mut self, wanted: usize) {
        while self.free.len() + self.leaving.len() < wanted {
            let victim = (0..)
                .zip(&self.residents)
                .filter_map(|(page, tile)| Some((page, (*tile)?)))
                .filter(|(_, tile)| {
                    tile.rank == UNWANTED
                        && !tile.leaving
                        && tile.children == 0
                        && !self.is_root(tile.address)
                })
                .min_by_key(|(page, tile)| (tile.wanted_at, tile.address.level, *page));
            let Some((page, tile)) = victim else {
                return;
            };
            if let Some(tile) = self.resident_mut(page) {
                tile.leaving = true;
            }
            self.leaving.push(page);
            self.refresh_cells(tile.address);
        }
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
            self.pages.set(address, None);
            self.pages_version += 1;
            self.free.push(page);
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
        for z in low.y..high.y {
            for x in low.x..high.x {
                let cell = UVec2::new(x, z);
                let level = known.unwrap_or_else(|| self.finest_readable(cell));
                self.cells[(z * self.field.cells.x + x) as usize] = level;
            }
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

    /// Moves the corners that aren't where they should be by `levels`, or all the way where no
    /// view would see it.
    pub(super) fn step(&mut self, levels: f32, views: &[ViewLod]) {
        if self.moving.is_empty() {
            return;
        }
        // 16 levels are more than most terrains have. Not a number, as 0 s at an endless rate is,
        // is not above 0.
        let levels = if levels > 0.0 { levels.min(16.0) } else { 0.0 };
        let step = self.carry + levels * 256.0;
        self.carry = step.fract();
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "within 0..=4097"
        )]
        let step = step as u16;
        let mut changed = false;
        let mut at = 0;
        while at < self.moving.len() {
            let index = self.moving[at] as usize;
            let columns = self.field.cells.x + 1;
            let corner = UVec2::new(self.moving[at] % columns, self.moving[at] / columns);
            let target = self.target(corner);
            let value = self.field.corners[index];
            let moved = if self.is_unseen(corner, target, views) {
                target
            } else if value < target {
                target.min(value.saturating_add(step))
            } else {
                target.max(value.saturating_sub(step))
            };
            changed |= moved != value;
            self.field.corners[index] = moved;
            if moved == target {
                self.is_moving[index] = false;
                self.moving.swap_remove(at);
            } else {
                at += 1;
            }
        }
        if changed {
            self.field_version += 1;
        }
    }

    /// Whether no view would see this corner jump to `target`: whether, wherever the corner has
    /// a say, every view reads more coarsely than the field asks for, before and after. The
    /// neighbouring corners count too: where they keep the field up, the blend shows this one.
    fn is_unseen(&self, corner: UVec2, target: u16, views: &[ViewLod]) -> bool {
        let low = corner.saturating_sub(UVec2::ONE);
        let high = (corner + 1).min(self.field.cells);
        let mut level = target;
        for z in low.y..=high.y {
            let first = self.field.corner_index(UVec2::new(low.x, z));
            let last = self.field.corner_index(UVec2::new(high.x, z));
            let row = &self.field.corners[first..=last];
            level = row.iter().copied().fold(level, u16::max);
        }
        let log2 = UVec2::splat(self.field.cell_log2);
        let low = (low << log2).as_ivec2();
        let high = (high << log2).as_ivec2().min(self.lattice.extent);
        views
            .iter()
            .all(|view| finest_detail(&self.lattice, view, low, high) >= i32::from(level))
    }

    /// Checks that every promise of this module is kept; says which one isn't.
    pub(super) fn validate(&self) -> Result<(), String> {
        let residents = (0..).zip(&self.residents);
        let mut count = 0;
        for (page, tile) in residents.filter_map(|(page, tile)| Some((page, tile.as_ref()?))) {
            count += 1;
            let address = tile.address;
            if self.pages.get(address) != Some(page) {
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
        if listed.count() != count || count + self.free.len() != self.residents.len() {
            return Err(format!(
                "{count} tiles are resident, page table or free list differ"
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
            .flat_map(|z| (low.x..high.x).map(move |x| TileAddress::new(level, x, z)))
            .find(|&tile| self.pages.holds(tile) && self.pages.get(tile).is_none())
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
