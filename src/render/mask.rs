//! Destruction masks on the GPU: behind a terrain's page table, in the same buffer.

use super::extract::TableChange;
use super::prepare::buffer;
use crate::edit::mask::{
    DestructionMask, MASK_PAGE_BYTES, MASK_SLOT_WORDS, MaskSettings, TerrainMask,
};
use crate::stream::TerrainState;
use bevy::prelude::*;
use bevy::render::render_resource::{Buffer, BufferUsages, CommandEncoderDescriptor};
use bevy::render::renderer::{RenderDevice, RenderQueue};

/// Words of a mask's head in its terrain's tables, before the slots: layers in use, slots less one, pages that there is room for, width of the
/// finest texels as a power of two of edit units.
pub const MASK_HEADER_WORDS: u32 = 4;
const SLOT_WORDS: u32 = MASK_SLOT_WORDS as u32;
const PAGE_WORDS: u32 = (MASK_PAGE_BYTES / 4) as u32;
/// Pages that there is room for at the least.
const LEAST_ROOM: u32 = 16;

/// Puts a mask on every terrain that can be drawn, and another one where it fits no longer.
pub(super) fn add_masks(
    terrains: Query<(
        Entity,
        &TerrainState,
        Option<&MaskSettings>,
        Option<&TerrainMask>,
    )>,
    mut commands: Commands,
) {
    for (entity, state, settings, mask) in &terrains {
        let default = MaskSettings::default();
        let settings = settings.unwrap_or(&default);
        let spacing_m = state.manifest().file.spacing_m;
        if !mask.is_some_and(|mask| mask.mask().is_for(spacing_m, settings)) {
            let mask = TerrainMask::new(spacing_m, settings);
            commands.entity(entity).try_insert(mask);
        }
    }
}

/// What became of a mask since the frame before.
pub(super) enum MaskChange {
    Same,
    /// There is no scorch any more.
    Nothing,
    Some(MaskUpload),
}

/// What has changed of a mask.
pub(super) struct MaskUpload {
    layers: u32,
    texel_shift: u32,
    slots: u32,
    page_numbers: u32,
    /// Words of the table.
    table: Vec<TableChange>,
    pages: Vec<u32>,
    /// Of those pages, one after the other.
    texels: Vec<u8>,
}

/// What mask the GPU's copy is a copy of: its instance and version.
pub(super) type KnownMask = Option<(u64, u64)>;

impl MaskChange {
    /// What has to be written to a copy that is as `known` says; `forgotten` where that doesn't hold
    /// any more.
    pub(super) fn since(
        mask: Option<&TerrainMask>,
        known: &mut KnownMask,
        forgotten: bool,
    ) -> Self {
        let Some(mask) = mask.filter(|mask| !mask.mask().is_empty()) else {
            let had_one = known.take().is_some() || forgotten;
            return if had_one { Self::Nothing } else { Self::Same };
        };
        let now = (mask.instance(), mask.mask().version());
        let since = match *known {
            _ if forgotten => 0,
            Some(known) if known == now => return Self::Same,
            Some((instance, version)) if instance == now.0 => version,
            _ => 0,
        };
        *known = Some(now);
        Self::Some(MaskUpload::since(mask.mask(), since))
    }
}

impl MaskUpload {
    fn since(mask: &DestructionMask, version: u64) -> Self {
        let mut table: Vec<TableChange> = Vec::new();
        let slots = (0..).zip(mask.table().iter().zip(mask.table_written()));
        let mut end = None;
        for (slot, (words, _)) in slots.filter(|(_, (_, written))| **written > version) {
            let first = slot * SLOT_WORDS;
            match table.last_mut() {
                Some(run) if end == Some(slot) => run.words.extend_from_slice(words),
                _ => table.push(TableChange {
                    first,
                    words: words.to_vec(),
                }),
            }
            end = Some(slot + 1);
        }
        let mut pages = Vec::new();
        let mut texels = Vec::new();
        for (number, _, page) in mask.pages_since(version) {
            pages.push(number);
            texels.extend_from_slice(page);
        }
        Self {
            layers: mask.layers(),
            texel_shift: mask.texel_shift(),
            slots: mask.table().len() as u32,
            page_numbers: mask.page_numbers(),
            table,
            pages,
            texels,
        }
    }
}

/// What a mask has room for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct MaskRoom {
    slots: u32,
    pages: u32,
}

impl MaskRoom {
    /// Words before the first page.
    const fn before_pages(self) -> u32 {
        MASK_HEADER_WORDS + SLOT_WORDS * self.slots
    }

    /// The room that `upload` wants, of `most` words at the most.
    fn wanted(upload: &MaskUpload, had: Option<Self>, most: u32) -> Self {
        let (wanted, slots) = (upload.page_numbers.max(1), upload.slots);
        let had = had.map_or(0, |had| had.pages);
        let pages = if wanted > had {
            wanted.max(had + had / 2).max(LEAST_ROOM)
        } else if wanted * 4 < had {
            wanted.max(LEAST_ROOM)
        } else {
            had
        };
        let empty = Self { slots, pages: 0 };
        let pages = pages.min(most.saturating_sub(empty.before_pages()) / PAGE_WORDS);
        Self { slots, pages }
    }
}

/// A terrain's page table, and its destruction mask where it has one.
pub(super) struct GpuTables {
    pub(super) buffer: Buffer,
    page_table_words: u32,
    mask: Option<MaskRoom>,
    /// Rises when the buffer is replaced.
    pub(super) generation: u64,
}

fn tables(device: &RenderDevice, words: u32) -> Buffer {
    buffer(
        device,
        "terrain_tables",
        4 * u64::from(words),
        BufferUsages::STORAGE | BufferUsages::COPY_SRC,
    )
}

impl GpuTables {
    pub(super) fn new(device: &RenderDevice) -> Self {
        Self {
            buffer: tables(device, 4),
            page_table_words: 4,
            mask: None,
            generation: 0,
        }
    }

    /// Where the mask begins, words; 0 where there is none.
    pub(super) const fn mask_first(&self) -> u32 {
        if self.mask.is_some() {
            self.page_table_words
        } else {
            0
        }
    }

    /// Writes a run of the page table. The first is the whole table, and a table keeps its length;
    /// a longer one is another terrain's, and the mask begins anew with it.
    pub(super) fn write_page_table(
        &mut self,
        change: &TableChange,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) {
        let end = change.first + change.words.len() as u32;
        if self.page_table_words < end {
            self.buffer = tables(device, end);
            self.page_table_words = end;
            self.mask = None;
            self.generation += 1;
        }
        let words = bytemuck::cast_slice(&change.words);
        queue.write_buffer(&self.buffer, 4 * u64::from(change.first), words);
    }

    /// Replaces the buffer; the page table stays, and of the mask what both have room for.
    fn resize(&mut self, room: Option<MaskRoom>, device: &RenderDevice, queue: &RenderQueue) {
        let first = self.page_table_words;
        let words = room.map_or(0, |room| room.before_pages() + PAGE_WORDS * room.pages);
        let new = tables(device, first + words);
        let mut encoder = device.create_command_encoder(&CommandEncoderDescriptor {
            label: Some("terrain_tables_copy"),
        });
        let mut copy = |from: u32, to: u32, words: u32| {
            let [from, to, bytes] = [from, to, words].map(|at| 4 * u64::from(at));
            encoder.copy_buffer_to_buffer(&self.buffer, from, &new, to, bytes);
        };
        copy(0, 0, first);
        if let (Some(old), Some(new)) = (self.mask, room) {
            if old.slots == new.slots {
                copy(first, first, old.before_pages());
            }
            let pages = old.pages.min(new.pages);
            if pages > 0 {
                copy(
                    first + old.before_pages(),
                    first + new.before_pages(),
                    PAGE_WORDS * pages,
                );
            }
        }
        // Before anything is written to the new one: writes come before what is submitted after them.
        queue.submit([encoder.finish()]);
        self.buffer = new;
        self.mask = room;
        self.generation += 1;
    }

    pub(super) fn write_mask(
        &mut self,
        change: &MaskChange,
        device: &RenderDevice,
        queue: &RenderQueue,
    ) {
        let upload = match change {
            MaskChange::Same => return,
            MaskChange::Nothing => {
                if self.mask.is_some() {
                    self.resize(None, device, queue);
                }
                return;
            }
            MaskChange::Some(upload) => upload,
        };
        let limits = device.limits();
        let most = limits
            .max_storage_buffer_binding_size
            .min(limits.max_buffer_size)
            / 4;
        let most = u32::try_from(most).unwrap_or(u32::MAX);
        let most = most.saturating_sub(self.page_table_words);
        let room = MaskRoom::wanted(upload, self.mask, most);
        if room.before_pages() > most {
            return;
        }
        if self.mask != Some(room) {
            self.resize(Some(room), device, queue);
        }
        let first = self.page_table_words;
        let write = |word: u32, bytes: &[u8]| {
            queue.write_buffer(&self.buffer, 4 * u64::from(first + word), bytes);
        };
        let header = [
            upload.layers,
            room.slots - 1,
            room.pages,
            upload.texel_shift,
        ];
        write(0, bytemuck::cast_slice(&header));
        for change in &upload.table {
            let words = bytemuck::cast_slice(&change.words);
            write(MASK_HEADER_WORDS + change.first, words);
        }
        let pages = upload.texels.chunks_exact(MASK_PAGE_BYTES);
        for (number, texels) in upload.pages.iter().zip(pages) {
            // Pages that there is no room for stay unwritten; the shader knows how many there are.
            if *number < room.pages {
                write(room.before_pages() + PAGE_WORDS * number, texels);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::edit::{Change, Edit};

    fn crater(at: i32) -> Edit {
        Edit {
            centre: [at * 6400, 0],
            reach: 640,
            change: Change::Crater {
                depth: 9,
                rim: 3,
                bowl: 40_000,
                roughness: 0,
                seed: 1,
                density: 0,
                scorch: 255,
                may_clamp: false,
            },
        }
    }

    fn pages(change: &MaskChange) -> usize {
        match change {
            MaskChange::Some(upload) => upload.pages.len(),
            _ => 0,
        }
    }

    #[test]
    fn what_has_changed_of_a_mask_is_sent_once_and_all_of_it_to_a_new_device() {
        let mut mask = TerrainMask::new(1.0, &MaskSettings::default());
        let mut known = None;
        assert!(matches!(
            MaskChange::since(Some(&mask), &mut known, false),
            MaskChange::Same
        ));
        (0..20).for_each(|at| mask.apply(&crater(at)));
        let all = mask.mask().page_count();
        assert_eq!(
            pages(&MaskChange::since(Some(&mask), &mut known, false)),
            all
        );
        assert!(matches!(
            MaskChange::since(Some(&mask), &mut known, false),
            MaskChange::Same
        ));
        mask.apply(&crater(30));
        let some = pages(&MaskChange::since(Some(&mask), &mut known, false));
        assert!(some > 0 && some <= 4, "{some}");
        // Another device knows nothing.
        let all = mask.mask().page_count();
        assert_eq!(
            pages(&MaskChange::since(Some(&mask), &mut None, false)),
            all
        );
        // Nor does one whose buffer belongs to another terrain.
        assert_eq!(
            pages(&MaskChange::since(Some(&mask), &mut known, true)),
            all
        );
        // Another mask is sent whole.
        let mut other = TerrainMask::new(1.0, &MaskSettings::default());
        other.apply(&crater(2));
        let all = other.mask().page_count();
        assert_eq!(
            pages(&MaskChange::since(Some(&other), &mut known, false)),
            all
        );
        other.rebuild_all([]);
        assert!(matches!(
            MaskChange::since(Some(&other), &mut known, false),
            MaskChange::Nothing
        ));
        assert!(matches!(
            MaskChange::since(None, &mut known, false),
            MaskChange::Same
        ));
        assert!(matches!(
            MaskChange::since(None, &mut known, true),
            MaskChange::Nothing
        ));
    }

    #[test]
    fn a_masks_room_grows_by_half_and_keeps_within_the_devices_limits() {
        let upload = |page_numbers| MaskUpload {
            layers: 1,
            texel_shift: 4,
            slots: 64,
            page_numbers,
            table: Vec::new(),
            pages: Vec::new(),
            texels: Vec::new(),
        };
        let room = |pages| MaskRoom { slots: 64, pages };
        let wanted = |pages, had: Option<u32>, most| {
            MaskRoom::wanted(&upload(pages), had.map(room), most).pages
        };
        assert_eq!(wanted(1, None, u32::MAX), 16);
        assert_eq!(wanted(17, Some(16), u32::MAX), 24);
        assert_eq!(wanted(24, Some(24), u32::MAX), 24);
        assert_eq!(wanted(100, Some(24), u32::MAX), 100);
        assert_eq!(wanted(26, Some(100), u32::MAX), 100);
        assert_eq!(wanted(20, Some(100), u32::MAX), 20);
        let most = room(0).before_pages() + 50 * PAGE_WORDS;
        assert_eq!(wanted(100, Some(24), most), 50);
        assert_eq!(wanted(100, Some(24), 3), 0);
    }
}
