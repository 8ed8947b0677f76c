//! How an edge's factor cuts it into segments.

use crate::lattice::ONE;

/// Fractional bits of an edge factor.
pub const FACTOR_LOG2: u32 = 10;
/// An edge factor of 1: the edge stays whole.
pub const FACTOR_ONE: u32 = 1 << FACTOR_LOG2;
/// The largest edge factor, 64 segments.
pub const FACTOR_MAX: u32 = 64 << FACTOR_LOG2;

/// How a real edge factor becomes whole segments (hardware tessellation's partitioning modes).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "ecs", derive(bevy::prelude::Reflect))]
#[non_exhaustive]
#[repr(u32)]
pub enum Partitioning {
    /// An odd number of segments, two of which grow from nothing: vertices slide, none pops.
    #[default]
    FractionalOdd = 0,
    /// The factor rounded up; segments of one length, vertices pop.
    Integer = 1,
    /// The factor rounded up to a power of two; every vertex stays when the factor doubles.
    PowerOfTwo = 2,
}

/// `factor` times `2^-scale`, not below 1.
#[must_use]
pub fn scaled_factor(factor: u32, scale: u32) -> u32 {
    (factor >> scale).max(FACTOR_ONE)
}

/// Segments that `factor` cuts an edge into. An inner factor never leaves a face whole: 1 there is
/// the limit of 1 + ε, so that nothing pops when it grows.
#[must_use]
pub fn segment_count(partitioning: Partitioning, factor: u32, inner: bool) -> u32 {
    match partitioning {
        Partitioning::FractionalOdd => {
            let pairs = (factor - FACTOR_ONE).div_ceil(2 * FACTOR_ONE);
            let count = 2 * pairs + 1;
            if inner { count.max(3) } else { count }
        }
        Partitioning::Integer => {
            let count = factor.div_ceil(FACTOR_ONE);
            if inner { count.max(2) } else { count }
        }
        Partitioning::PowerOfTwo => {
            let count = factor.div_ceil(FACTOR_ONE).next_power_of_two();
            if inner { count.max(2) } else { count }
        }
    }
}

/// Where along an edge of `count` segments cut `i` lies, `0..=ONE`; symmetric about the middle,
/// so both directions give the same points.
///
/// Fractional odd: `count - 2` segments of length `1 / factor` and a shorter one at either end.
#[must_use]
pub fn segment_parameter(partitioning: Partitioning, factor: u32, count: u32, i: u32) -> i32 {
    if i == 0 {
        return 0;
    }
    if i == count {
        return ONE;
    }
    // Mirror the second half, or rounding would break the symmetry.
    let mirrored = 2 * i > count;
    let i = if mirrored { count - i } else { i };
    let t = match partitioning {
        Partitioning::FractionalOdd => {
            let missing = (count << FACTOR_LOG2) - factor;
            // Length of the end segment, in half units of the factor's fixed point.
            let short = 2 * FACTOR_ONE - missing;
            ((short + (i - 1) * 2 * FACTOR_ONE) << 15) / factor
        }
        Partitioning::Integer | Partitioning::PowerOfTwo => (i << 16) / count,
    };
    let t = t.cast_signed();
    if mirrored { ONE - t } else { t }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ALL: [Partitioning; 3] = [
        Partitioning::FractionalOdd,
        Partitioning::Integer,
        Partitioning::PowerOfTwo,
    ];

    proptest! {
        #[test]
        fn cuts_rise_and_are_symmetric(factor in FACTOR_ONE..=FACTOR_MAX, inner: bool, kind in 0_usize..3) {
            let kind = ALL[kind];
            let count = segment_count(kind, factor, inner);
            let cuts: Vec<i32> = (0..=count)
                .map(|i| segment_parameter(kind, factor, count, i))
                .collect();
            prop_assert_eq!(cuts[0], 0);
            prop_assert_eq!(cuts[count as usize], ONE);
            for i in 0..cuts.len() {
                prop_assert_eq!(cuts[i] + cuts[cuts.len() - 1 - i], ONE);
                prop_assert!(i == 0 || cuts[i] >= cuts[i - 1]);
            }
        }

        #[test]
        fn fractional_odd_moves_no_further_than_its_factor(factor in FACTOR_ONE..FACTOR_MAX) {
            // Where the count stays, a step of the factor moves a vertex by a small step too.
            let kind = Partitioning::FractionalOdd;
            let count = segment_count(kind, factor, true);
            if count == segment_count(kind, factor + 1, true) {
                for i in 0..=count {
                    let a = segment_parameter(kind, factor, count, i);
                    let b = segment_parameter(kind, factor + 1, count, i);
                    prop_assert!((a - b).abs() <= 66, "cut {i} of {count} jumps from {a} to {b}");
                }
            }
        }
    }

    #[test]
    fn fractional_odd_is_continuous_where_the_count_changes() {
        for count in (1..64).step_by(2) {
            let factor = count << FACTOR_LOG2;
            let before = segment_count(Partitioning::FractionalOdd, factor, false);
            let after = segment_count(Partitioning::FractionalOdd, factor + 1, false);
            assert_eq!((before, after), (count, count + 2));
            // The two new segments have no length yet.
            let first = segment_parameter(Partitioning::FractionalOdd, factor + 1, after, 1);
            assert!(first <= ONE / 1024, "{count}: first cut at {first}");
        }
    }
}
