//! How an edge's factor cuts it into segments.

use super::strip::newest_place;
use crate::lattice::ONE;

/// Fractional bits of an edge factor.
pub const FACTOR_LOG2: u32 = 10;
/// An edge factor of 1: the edge stays whole.
pub const FACTOR_ONE: u32 = 1 << FACTOR_LOG2;
/// The largest edge factor, 64 segments.
pub const FACTOR_MAX: u32 = 64 << FACTOR_LOG2;

/// How a real edge factor becomes whole segments: hardware tessellation's four partitioning modes (Cervin
/// 2012, section 2.3), and one more.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "ecs", derive(bevy::prelude::Reflect))]
#[non_exhaustive]
#[repr(u32)]
pub enum Partitioning {
    /// An odd number of segments, two of which grow from nothing: vertices slide, none pops.
    FractionalOdd = 0,
    /// The factor rounded up; segments of one length, vertices pop.
    Integer = 1,
    /// The factor rounded up to a power of two; every vertex stays when the factor doubles, the new
    /// ones pop.
    PowerOfTwo = 2,
    /// An even number of segments, at least 2, two of which grow from nothing: vertices slide, none
    /// pops. The default: where an edge is cut as finely as its samples lie, its vertices lie on them.
    #[default]
    FractionalEven = 3,
    /// The factors rounded up to powers of two, one for the whole inside of a face; new vertices rise
    /// in place from the coarser surface, those on edges slide out of their neighbours. Nothing pops,
    /// and inside faces nothing swims; more triangles than the others where a face is long and thin.
    PowerOfTwoMorph = 4,
}

impl Partitioning {
    /// All ways, the fractional ones first.
    pub const ALL: [Self; 5] = [
        Self::FractionalOdd,
        Self::FractionalEven,
        Self::Integer,
        Self::PowerOfTwo,
        Self::PowerOfTwoMorph,
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

    /// Whether no vertex pops when a factor changes.
    #[must_use]
    pub const fn is_continuous(self) -> bool {
        matches!(
            self,
            Self::FractionalOdd | Self::FractionalEven | Self::PowerOfTwoMorph
        )
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
        Partitioning::PowerOfTwo | Partitioning::PowerOfTwoMorph => {
            let count = factor.div_ceil(FACTOR_ONE).next_power_of_two();
            if inner { count.max(2) } else { count }
        }
    }
}

/// Where along an edge of `count` segments cut `i` lies, `0..=ONE`, counted in the edge's canonical
/// direction.
///
/// Fractional: segments of length `1 / factor`, and in each half one that grows from nothing; it
/// keeps its place among the others from then on, so no cut changes its neighbours. Symmetric about
/// the middle. Power of two with morph: even cuts stay, odd ones slide from the cut before them to
/// the middle between their neighbours.
#[must_use]
pub fn segment_parameter(partitioning: Partitioning, factor: u32, count: u32, i: u32) -> i32 {
    if i == 0 {
        return 0;
    }
    if i == count {
        return ONE;
    }
    let factor = factor.max(partitioning.least());
    if partitioning == Partitioning::PowerOfTwoMorph && !i.is_multiple_of(2) {
        return (((i + 1) << 16) / count - (1 << 26) / factor).cast_signed();
    }
    // Mirror the second half, or rounding would break the symmetry.
    let mirrored = 2 * i > count;
    let i = if mirrored { count - i } else { i };
    let t = match partitioning {
        Partitioning::FractionalOdd | Partitioning::FractionalEven => {
            let missing = (count << FACTOR_LOG2) - factor;
            // In half units of the factor's fixed point: a segment, and the newest one.
            let full = 2 * FACTOR_ONE;
            let newest = full - missing;
            let length = if i > newest_place(count / 2) {
                (i - 1) * full + newest
            } else {
                i * full
            };
            (length << 15) / factor
        }
        _ => (i << 16) / count,
    };
    let t = t.cast_signed();
    if mirrored { ONE - t } else { t }
}

/// How far the new vertices inside a face of `count` segments have risen from the coarser surface,
/// `0..=ONE`, in [`Partitioning::PowerOfTwoMorph`].
///
/// `4/3 (1 - 1 / (1 + u)²)`, where the factor has come `u` of the way from `count / 2` to `count`: what
/// is left of the coarser mesh's error falls at least as fast as the square of a segment's length
/// does in the fractional kinds.
#[must_use]
pub fn rise(factor: u32, count: u32) -> i32 {
    let ratio = ((count << FACTOR_LOG2) << 15) / factor;
    // 1 where the factor is half the count: it is more than that, or the count would be smaller.
    let ratio = ratio.min(ONE.cast_unsigned() - 1);
    let left = ONE.cast_unsigned() - ((ratio * ratio) >> 16);
    (left * 4 / 3).cast_signed().min(ONE)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn cuts_rise_and_are_symmetric(factor in FACTOR_ONE..=FACTOR_MAX, inner: bool, kind in 0_usize..5) {
            let kind = Partitioning::ALL[kind];
            let count = segment_count(kind, factor, inner);
            let cuts: Vec<i32> = (0..=count)
                .map(|i| segment_parameter(kind, factor, count, i))
                .collect();
            prop_assert_eq!(cuts[0], 0);
            prop_assert_eq!(cuts[count as usize], ONE);
            for i in 0..cuts.len() {
                // An edge whose new cuts slide is the one that has a direction.
                let mirror = cuts[cuts.len() - 1 - i];
                prop_assert!(kind == Partitioning::PowerOfTwoMorph || cuts[i] + mirror == ONE);
                prop_assert!(i == 0 || cuts[i] >= cuts[i - 1]);
            }
        }

        #[test]
        fn fractional_cuts_move_no_further_than_their_factor(
            factor in FACTOR_ONE..FACTOR_MAX,
            kind in prop_oneof![
                Just(Partitioning::FractionalOdd),
                Just(Partitioning::FractionalEven),
                Just(Partitioning::PowerOfTwoMorph),
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

    /// Where segments come in, they have no length yet and all other cuts stay.
    #[test]
    fn cuts_are_continuous_where_the_count_changes() {
        for kind in Partitioning::ALL {
            if !kind.is_continuous() {
                continue;
            }
            for whole in 1..64 {
                let factor = whole << FACTOR_LOG2;
                let cuts = |factor| -> Vec<i32> {
                    let count = segment_count(kind, factor, false);
                    (0..=count)
                        .map(|i| segment_parameter(kind, factor, count, i))
                        .collect()
                };
                let (before, after) = (cuts(factor), cuts(factor + 1));
                let near = |cut: i32, others: &[i32]| {
                    others.iter().any(|other| (other - cut).abs() <= ONE / 512)
                };
                assert!(
                    before.iter().all(|&cut| near(cut, &after)),
                    "{kind:?} {whole}"
                );
                assert!(
                    after.iter().all(|&cut| near(cut, &before)),
                    "{kind:?} {whole}"
                );
            }
        }
    }

    #[test]
    fn new_vertices_rise_from_nothing_to_their_place() {
        for count in [2, 4, 8, 16, 32, 64] {
            assert!(rise((count << (FACTOR_LOG2 - 1)) + 1, count) <= ONE / 128);
            assert_eq!(rise(count << FACTOR_LOG2, count), ONE);
            let half = rise((count * 3) << (FACTOR_LOG2 - 2), count);
            assert!((half - ONE * 20 / 27).abs() < 4, "{half}");
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
