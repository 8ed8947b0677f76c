//! Hashes that stand for random numbers: the same for the same input, on every platform.

/// The output function of the splitmix64 generator (Steele, Lea and Flood, 2014): every bit of the
/// input changes about half of the output's bits.
fn mix(value: u64) -> u64 {
    let mut hash = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    hash = (hash ^ hash >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    hash = (hash ^ hash >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
    hash ^ hash >> 31
}

/// The hash of `key` and `value`: the key of what belongs to `value`.
pub(super) fn fold(key: u64, value: u64) -> u64 {
    mix(mix(key) ^ value)
}

/// A number from -1 to below 1, in steps that an `f32` holds exactly.
pub(super) fn signed_unit(hash: u64) -> f32 {
    (hash >> 40) as f32 / (1_u32 << 23) as f32 - 1.0
}
