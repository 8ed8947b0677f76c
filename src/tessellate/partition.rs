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
    /// An even number of segments, at least 2, two of which grow from nothing: vertices slide, none
    /// pops.
    FractionalEven = 3,
}

impl Partitioning {
    /// All ways.
    pub const ALL: [Self; 4] = [
        Self::FractionalOdd,
        Self::FractionalEven,
        Self::Integer,
        Self::PowerOfTwo,
    ];

    /// The least factor that it can do.
    const fn least(self) -> u32 {
        match self {
            Self::FractionalEven => 2 * FACTOR_ONE,
            _ => FACTOR_ONE,
        }
    }

    /// Vertices of a face with the least factors.
    #[must_use]
    pub const fn least_vertices(self) -> u32 {
        match self {
            Self::FractionalEven => 9,
            _ => 4,
        }
    }
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
    let factor = factor.max(partitioning.least());
    match partitioning {
        Partitioning::FractionalEven => 2 * factor.div_ceil(2 * FACTOR_ONE),
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
/// Fractional: `count - 2` segments of length `1 / factor` and a shorter one at either end.
#[must_use]
pub fn segment_parameter(partitioning: Partitioning, factor: u32, count: u32, i: u32) -> i32 {
    if i == 0 {
        return 0;
    }
    if i == count {
        return ONE;
    }
    // Mirror the second half, or rounding would break the symmetry.
    let factor = factor.max(partitioning.least());
    let mirrored = 2 * i > count;
    let i = if mirrored { count - i } else { i };
    let t = match partitioning {
        Partitioning::FractionalOdd | Partitioning::FractionalEven => {
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

    proptest! {
        #[test]
        fn cuts_rise_and_are_symmetric(factor in FACTOR_ONE..=FACTOR_MAX, inner: bool, kind in 0_usize..4) {
            let kind = Partitioning::ALL[kind];
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
        fn fractional_cuts_move_no_further_than_their_factor(
            factor in FACTOR_ONE..FACTOR_MAX,
            kind in prop_oneof![
                Just(Partitioning::FractionalOdd),
                Just(Partitioning::FractionalEven),
            ],
        ) {
            // Where the count stays, a step of the factor moves a vertex by a small step too.
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

    /// Where two segments come in, they have no length yet and all other cuts stay.
    #[test]
    fn fractional_cuts_are_continuous_where_the_count_changes() {
        for (kind, first) in [
            (Partitioning::FractionalOdd, 1),
            (Partitioning::FractionalEven, 2),
        ] {
            for count in (first..64).step_by(2) {
                let factor = count << FACTOR_LOG2;
                let before = segment_count(kind, factor, false);
                let after = segment_count(kind, factor + 1, false);
                assert_eq!((before, after), (count, count + 2));
                for i in 0..=count {
                    let was = segment_parameter(kind, factor, before, i);
                    let is = segment_parameter(kind, factor + 1, after, i + 1);
                    assert!(
                        (was - is).abs() <= ONE / 1024,
                        "{count}: cut {i} from {was} to {is}"
                    );
                }
            }
        }
    }

    #[test]
    fn fractional_even_never_falls_below_two() {
        for factor in [FACTOR_ONE, FACTOR_ONE + 1, 2 * FACTOR_ONE] {
            assert_eq!(
                segment_count(Partitioning::FractionalEven, factor, false),
                2
            );
            assert_eq!(
                segment_parameter(Partitioning::FractionalEven, factor, 2, 1),
                ONE / 2
            );
        }
    }

    #[test]
    fn whole_partitionings_round_up() {
        for (factor, integer, power) in [(1024, 1, 1), (1025, 2, 2), (2049, 3, 4), (5 * 1024, 5, 8)]
        {
            assert_eq!(segment_count(Partitioning::Integer, factor, false), integer);
            assert_eq!(
                segment_count(Partitioning::PowerOfTwo, factor, false),
                power
            );
        }
    }
}
