#define_import_path bevy_tessera::strip

// Twin of `src/tessellate/strip.rs`: rows of segments, each in a slot that it keeps.

// The slot of a segment across the middle; those before and after it are mirrored.
const MIDDLE_SLOT: u32 = 32u;

// A row of segments along the side of a face.
struct Row {
    // Slots of the first half, as bits.
    slots: u32,
    // 1 where a segment lies across the middle.
    middle: u32,
}

// The last `bits` bits of `n`, the other way round.
fn reversed(n: u32, bits: u32) -> u32 {
    if bits == 0u {
        return 0u;
    }
    return reverseBits(n) >> (32u - bits);
}

// The slots, as bits, that `pairs` pairs of segments take.
fn taken_slots(pairs: u32) -> u32 {
    var slots = 0u;
    var rest = pairs;
    // The pairs below a set bit of `pairs`, the higher bits being as there, lie evenly.
    while rest > 0u {
        let bit = firstLeadingBit(rest);
        rest -= 1u << bit;
        let higher = pairs >> bit >> 1u << 1u << bit;
        var comb = 0xffffffffu;
        switch bit {
            case 0u: { comb = 1u; }
            case 1u: { comb = 0x00010001u; }
            case 2u: { comb = 0x01010101u; }
            case 3u: { comb = 0x11111111u; }
            case 4u: { comb = 0x55555555u; }
            default: {}
        }
        slots |= comb << reversed(higher, 5u);
    }
    return slots;
}

fn bits_below(bits: u32, end: u32) -> u32 {
    if end >= 32u {
        return countOneBits(bits);
    }
    return countOneBits(bits & ((1u << end) - 1u));
}

// How many segments of a half edge lie before the newest, the one that grows.
fn newest_place(pairs: u32) -> u32 {
    var place = 0u;
    var rest = pairs - 1u;
    while rest > 0u {
        let bit = firstLeadingBit(rest);
        rest -= 1u << bit;
        place += reversed(rest, bit) + 1u;
    }
    return place;
}

// The place of the n-th set bit.
fn nth_bit(bits: u32, n: u32) -> u32 {
    var at = 0u;
    for (var step = 16u; step > 0u; step >>= 1u) {
        if bits_below(bits, at + step) <= n {
            at += step;
        }
    }
    return at;
}

fn edge_row(count: u32) -> Row {
    return Row(taken_slots(count / 2u), count % 2u);
}

// The ring of an inner grid that has two more segments: those first and last in order.
fn ring_row(count: u32) -> Row {
    return Row(taken_slots(count / 2u + 1u) & ~1u, count % 2u);
}

// The slot of segment `i`, 0..=64.
fn segment_slot(row: Row, i: u32) -> u32 {
    let half = countOneBits(row.slots);
    if i < half {
        return nth_bit(row.slots, i);
    }
    if i == half && row.middle == 1u {
        return MIDDLE_SLOT;
    }
    return 2u * MIDDLE_SLOT - nth_bit(row.slots, 2u * half + row.middle - 1u - i);
}

// How many segments have a slot below `slot`.
fn segments_before(row: Row, slot: u32) -> u32 {
    if slot <= MIDDLE_SLOT {
        return bits_below(row.slots, slot);
    }
    return 2u * countOneBits(row.slots) + row.middle
        - bits_below(row.slots, 2u * MIDDLE_SLOT + 1u - slot);
}
