//! Rows of segments, each in a slot that it keeps as factors grow.
//!
//! A half edge has 32 slots. Its segments take them in bit-reversed order (0, 16, 8, 24, 4, ...), so
//! that they spread evenly however many there are; the second half mirrors the first, and a segment
//! across the middle lies between. Two rows beside each other are joined slot by slot: a segment that
//! comes in on either, with no length yet, leaves all others' triangles as they were. So the strips
//! between a face's inner grid and its edges don't turn their diagonals when a factor changes.

/// The slot of a segment across the middle; those before and after it are mirrored.
const MIDDLE_SLOT: u32 = 32;

/// The last `bits` bits of `n`, the other way round.
const fn reversed(n: u32, bits: u32) -> u32 {
    if bits == 0 {
        0
    } else {
        n.reverse_bits() >> (32 - bits)
    }
}

/// The slots, as bits, that `pairs` pairs of segments take (at most 32).
const fn taken_slots(pairs: u32) -> u32 {
    let mut slots = 0;
    let mut rest = pairs;
    // The pairs below a set bit of `pairs`, the higher bits being as there, lie evenly.
    while rest > 0 {
        let bit = rest.ilog2();
        rest -= 1 << bit;
        let higher = pairs >> bit >> 1 << 1 << bit;
        let comb = match bit {
            0 => 1,
            1 => 0x0001_0001,
            2 => 0x0101_0101,
            3 => 0x1111_1111,
            4 => 0x5555_5555,
            _ => u32::MAX,
        };
        slots |= comb << reversed(higher, 5);
    }
    slots
}

/// How many of the segments of a half edge with `pairs` pairs lie before the newest, which is the
/// one that grows.
#[must_use]
pub(super) const fn newest_place(pairs: u32) -> u32 {
    let newest = pairs - 1;
    let mut place = 0;
    let mut rest = newest;
    // Of the pairs that first differ from the newest in a bit that it has, those whose lower bits
    // come before its own, or are its own, lie before it.
    while rest > 0 {
        let bit = rest.ilog2();
        rest -= 1 << bit;
        place += reversed(rest, bit) + 1;
    }
    place
}

/// A row of segments along the side of a face: an edge, or the ring of the inner grid beside it.
#[derive(Clone, Copy)]
pub(super) struct Row {
    /// Slots of the first half, as bits.
    slots: u32,
    /// 1 where a segment lies across the middle.
    middle: u32,
}

impl Row {
    /// An edge of `count` segments.
    pub(super) const fn edge(count: u32) -> Self {
        Self {
            slots: taken_slots(count / 2),
            middle: count % 2,
        }
    }

    /// The ring of `count` segments of an inner grid that has two more: those first and last in
    /// order.
    pub(super) const fn ring(count: u32) -> Self {
        Self {
            slots: taken_slots(count / 2 + 1) & !1,
            middle: count % 2,
        }
    }

    /// The slot of segment `i`, `0..=64`.
    pub(super) const fn slot(self, i: u32) -> u32 {
        let half = self.slots.count_ones();
        if i < half {
            return nth_bit(self.slots, i);
        }
        if i == half && self.middle == 1 {
            return MIDDLE_SLOT;
        }
        2 * MIDDLE_SLOT - nth_bit(self.slots, 2 * half + self.middle - 1 - i)
    }

    /// How many segments have a slot below `slot`.
    pub(super) const fn before(self, slot: u32) -> u32 {
        if slot <= MIDDLE_SLOT {
            return bits_below(self.slots, slot);
        }
        2 * self.slots.count_ones() + self.middle
            - bits_below(self.slots, 2 * MIDDLE_SLOT + 1 - slot)
    }
}

const fn bits_below(bits: u32, end: u32) -> u32 {
    if end >= 32 {
        bits.count_ones()
    } else {
        (bits & ((1 << end) - 1)).count_ones()
    }
}

/// The place of the `n`-th set bit.
const fn nth_bit(bits: u32, n: u32) -> u32 {
    let mut at = 0;
    let mut step = 16;
    while step > 0 {
        if bits_below(bits, at + step) <= n {
            at += step;
        }
        step >>= 1;
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slots_are_taken_in_bit_reversed_order() {
        let mut slots = 0;
        for pairs in 1..=32_u32 {
            let slot = (pairs - 1).reverse_bits() >> 27;
            assert_eq!(newest_place(pairs), bits_below(slots, slot), "{pairs}");
            slots |= 1 << slot;
            assert_eq!(taken_slots(pairs), slots, "{pairs}");
        }
        assert_eq!(taken_slots(0), 0);
    }

    #[test]
    fn segments_know_their_slots_and_what_lies_before() {
        for count in 0..=64 {
            for row in [Row::edge(count), Row::ring(count.min(62))] {
                let count = 2 * row.slots.count_ones() + row.middle;
                let slots: Vec<u32> = (0..count).map(|i| row.slot(i)).collect();
                assert!(slots.is_sorted_by(|a, b| a < b), "{slots:?}");
                for slot in 0..=65 {
                    let before = slots.iter().filter(|&&other| other < slot).count();
                    assert_eq!(row.before(slot) as usize, before, "{slot} of {slots:?}");
                }
            }
        }
    }
}
