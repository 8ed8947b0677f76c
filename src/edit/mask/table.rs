//! Finding a page by its place: open addressing, in the words that the GPU reads.

use super::MaskPlace;

/// Words of a slot.
pub(super) const SLOT_WORDS: usize = 3;
/// Slots of a table that holds something, at the least.
const LEAST_SLOTS: usize = 32;
/// What a tag's layer is shifted by; below it stands one more than the page's number.
pub(super) const LAYER_SHIFT: u32 = 24;

/// A hash table with linear probing, at most half full. A slot is a tag (0 where it is free, else
/// the layer and one more than the page's number), then the page's x and z.
#[derive(Clone, Debug, Default)]
pub(super) struct MaskTable {
    slots: Vec<[u32; SLOT_WORDS]>,
    /// The version of the mask in which each slot was last written.
    written: Vec<u64>,
    len: usize,
}

/// Where the search for a place begins, before it is cut to the table's size.
const fn hash(place: MaskPlace) -> u32 {
    let mixed = place.x.cast_unsigned().wrapping_mul(0x9e37_79b1)
        ^ place.z.cast_unsigned().wrapping_mul(0x85eb_ca77)
        ^ (place.layer as u32).wrapping_mul(0xc2b2_ae3d);
    let mixed = (mixed ^ (mixed >> 15)).wrapping_mul(0x2c1b_3c6d);
    mixed ^ (mixed >> 12)
}

const fn place_in(slot: [u32; SLOT_WORDS]) -> MaskPlace {
    MaskPlace {
        layer: (slot[0] >> LAYER_SHIFT) as u8,
        x: slot[1].cast_signed(),
        z: slot[2].cast_signed(),
    }
}

impl MaskTable {
    pub(super) fn slots(&self) -> &[[u32; SLOT_WORDS]] {
        &self.slots
    }

    pub(super) fn written(&self) -> &[u64] {
        &self.written
    }

    /// The slot that holds `place`, or the free one where it would go.
    fn probe(&self, place: MaskPlace) -> usize {
        let last = self.slots.len() - 1;
        let mut slot = hash(place) as usize & last;
        while self.slots[slot][0] != 0 && place_in(self.slots[slot]) != place {
            slot = (slot + 1) & last;
        }
        slot
    }

    /// The number of the page at `place`.
    pub(super) fn find(&self, place: MaskPlace) -> Option<u32> {
        if self.slots.is_empty() {
            return None;
        }
        let tag = self.slots[self.probe(place)][0];
        (tag != 0).then(|| (tag & ((1 << LAYER_SHIFT) - 1)) - 1)
    }

    fn put(&mut self, place: MaskPlace, page: u32, version: u64) {
        let slot = self.probe(place);
        let tag = u32::from(place.layer) << LAYER_SHIFT | (page + 1);
        self.slots[slot] = [tag, place.x.cast_unsigned(), place.z.cast_unsigned()];
        self.written[slot] = version;
    }

    /// Adds a page that isn't there.
    pub(super) fn insert(&mut self, place: MaskPlace, page: u32, version: u64) {
        self.len += 1;
        if self.len * 2 > self.slots.len() {
            let slots = (self.slots.len() * 2).max(LEAST_SLOTS);
            let former = std::mem::replace(&mut self.slots, vec![[0; SLOT_WORDS]; slots]);
            self.written = vec![version; slots];
            for slot in former.into_iter().filter(|slot| slot[0] != 0) {
                let page = (slot[0] & ((1 << LAYER_SHIFT) - 1)) - 1;
                self.put(place_in(slot), page, version);
            }
        }
        self.put(place, page, version);
    }

    /// Takes a page out. Those behind it in the same run close up, so that no search ends early.
    pub(super) fn remove(&mut self, place: MaskPlace, version: u64) {
        if self.slots.is_empty() {
            return;
        }
        let last = self.slots.len() - 1;
        let mut hole = self.probe(place);
        if self.slots[hole][0] == 0 {
            return;
        }
        self.len -= 1;
        if self.len == 0 {
            *self = Self::default();
            return;
        }
        let mut next = hole;
        loop {
            self.slots[hole][0] = 0;
            self.written[hole] = version;
            loop {
                next = (next + 1) & last;
                if self.slots[next][0] == 0 {
                    return;
                }
                let home = hash(place_in(self.slots[next])) as usize & last;
                // It may move only where its own search passes the hole.
                if (next.wrapping_sub(home) & last) >= (next.wrapping_sub(hole) & last) {
                    break;
                }
            }
            self.slots[hole] = self.slots[next];
            hole = next;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::HashMap;

    proptest! {
        #[test]
        fn a_table_finds_what_was_put_in_and_not_what_was_taken_out(
            steps in proptest::collection::vec((0..2_u8, -6..6_i32, -6..6_i32, any::<bool>()), 0..400),
        ) {
            let mut table = MaskTable::default();
            let mut known = HashMap::new();
            for (version, (layer, x, z, adds)) in (1..).zip(steps) {
                let place = MaskPlace { layer, x, z };
                if adds && !known.contains_key(&place) {
                    table.insert(place, version as u32, version);
                    known.insert(place, version as u32);
                } else if !adds {
                    table.remove(place, version);
                    known.remove(&place);
                }
            }
            for layer in 0..2 {
                for x in -6..6 {
                    for z in -6..6 {
                        let place = MaskPlace { layer, x, z };
                        prop_assert_eq!(table.find(place), known.get(&place).copied());
                    }
                }
            }
            prop_assert!(known.len() * 2 <= table.slots().len());
        }

        #[test]
        fn the_slots_of_a_table_follow_from_those_written_since(
            steps in proptest::collection::vec((-6..6_i32, any::<bool>()), 1..200),
            at in 0..200_usize,
        ) {
            let mut table = MaskTable::default();
            let mut copy: Option<(u64, Vec<[u32; SLOT_WORDS]>)> = None;
            for (place, (x, adds)) in steps.iter().enumerate() {
                let version = place as u64 + 1;
                let place = MaskPlace { layer: 0, x: *x, z: 3 };
                if *adds && table.find(place).is_none() {
                    table.insert(place, *x as u32 & 0xff, version);
                } else if !adds {
                    table.remove(place, version);
                }
                if version as usize == at {
                    copy = Some((version, table.slots().to_vec()));
                }
            }
            if let Some((known, mut slots)) = copy {
                slots.resize(table.slots().len(), [9; SLOT_WORDS]);
                for (slot, written) in table.written().iter().enumerate() {
                    if *written > known {
                        slots[slot] = table.slots()[slot];
                    }
                }
                let free = |slots: &[[u32; SLOT_WORDS]]| -> Vec<_> {
                    slots.iter().map(|slot| if slot[0] == 0 { [0; SLOT_WORDS] } else { *slot }).collect()
                };
                prop_assert_eq!(free(&slots), free(table.slots()));
            }
        }
    }
}
