//! Every partitioning in closed form: how many vertices and triangles a face has, that they cover it
//! once, and that, for the kinds that say so, its surface moves no further than its factors.

use bevy_tessera::lattice::ONE;
use bevy_tessera::tessellate::{
    FACTOR_MAX, FACTOR_ONE, Face, FaceCounts, FaceFactors, Partitioning, segment_count,
    segment_parameter,
};
use glam::{DVec2, DVec3, IVec2};
use proptest::prelude::*;

/// Lattice units along a face.
const SIDE: i32 = 1 << 20;

/// A face as morphing leaves it: no rectangle.
fn corners() -> [IVec2; 4] {
    [
        IVec2::new(0, 0),
        IVec2::new(SIDE - 60_000, 0),
        IVec2::new(SIDE - 61_000, SIDE - 40_000),
        IVec2::new(0, SIDE - 41_000),
    ]
}

/// Ground with waves shorter than a face, in the unit of the plane.
fn ground(p: IVec2) -> f64 {
    let q = p.as_dvec2() / f64::from(SIDE);
    f64::from(SIDE) * (0.05 * (9.0 * q.x + 4.0 * q.y).sin() + 0.04 * (7.0 * q.y - 5.0 * q.x).cos())
}

/// How steep that ground is at most.
const STEEPEST: f64 = 0.9;

fn vertices(face: &Face, counts: &FaceCounts) -> Vec<DVec3> {
    (0..counts.vertices())
        .map(|index| {
            let vertex = face.vertex(counts, index);
            let rise = f64::from(vertex.rise) / f64::from(ONE);
            let between = 0.5 * (ground(vertex.parents[0]) + ground(vertex.parents[1]));
            let drawn = vertex.drawn().as_dvec2();
            let height = between + (ground(vertex.point) - between) * rise;
            DVec3::new(drawn.x, height, drawn.y)
        })
        .collect()
}

/// The surface of a face: its triangles, the ones without area left out.
struct Surface(Vec<[DVec3; 3]>);

fn turn(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    let plane = |p: DVec3| DVec2::new(p.x, p.z);
    (plane(b) - plane(a)).perp_dot(plane(c) - plane(a))
}

impl Surface {
    fn of(face: &Face) -> Self {
        let counts = face.counts();
        let vertices = vertices(face, &counts);
        let triangles = (0..counts.triangles()).map(|index| {
            let triangle = face.triangle(&counts, index);
            triangle.map(|vertex| vertices[vertex as usize])
        });
        Self(
            triangles
                .filter(|&[a, b, c]| turn(a, b, c) != 0.0)
                .collect(),
        )
    }

    /// The lowest and the highest height above a place: two, where triangles overlap.
    fn at(&self, place: DVec2) -> Option<(f64, f64)> {
        let p = DVec3::new(place.x, 0.0, place.y);
        let mut found: Option<(f64, f64)> = None;
        for &[a, b, c] in &self.0 {
            let area = turn(a, b, c);
            let weights = [turn(p, b, c) / area, turn(p, c, a) / area];
            let weights = [weights[0], weights[1], 1.0 - weights[0] - weights[1]];
            if weights.iter().all(|&weight| weight >= -1e-12) {
                let height = weights[0] * a.y + weights[1] * b.y + weights[2] * c.y;
                let (low, high) = found.unwrap_or((height, height));
                found = Some((low.min(height), high.max(height)));
            }
        }
        found
    }
}

fn places() -> impl Iterator<Item = DVec2> {
    // No place lies on a cut.
    (0..17).flat_map(|z| {
        (0..17).map(move |x| {
            DVec2::new(f64::from(x) + 0.531, f64::from(z) + 0.377) / 18.0
                * (f64::from(SIDE) - 70_000.0)
        })
    })
}

fn factor() -> impl Strategy<Value = u32> {
    prop_oneof![
        FACTOR_ONE..=12 * FACTOR_ONE,
        // Where counts change.
        (1_u32..=12).prop_map(|whole| whole * FACTOR_ONE),
        FACTOR_ONE..=FACTOR_MAX,
    ]
}

fn kinds() -> impl Strategy<Value = Partitioning> {
    (0..Partitioning::ALL.len()).prop_map(|at| Partitioning::ALL[at])
}

fn face(partitioning: Partitioning, factors: [u32; 6]) -> Face {
    let [a, b, c, d, across, down] = factors;
    Face {
        corners: corners(),
        factors: FaceFactors {
            edges: [a, b, c, d],
            inside: [across, down],
            culled: false,
        },
        partitioning,
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn triangles_cover_a_face_once(kind in kinds(), factors in prop::array::uniform6(factor())) {
        let face = face(kind, factors);
        let counts = face.counts();
        let surface = Surface::of(&face);
        let area: f64 = surface.0.iter().map(|&[a, b, c]| turn(a, b, c)).sum();
        let [c00, c10, c11, c01] = corners().map(|p| DVec3::new(p.x.into(), 0.0, p.y.into()));
        let whole = turn(c00, c10, c11) + turn(c00, c11, c01);
        // Seen from above, with z to the south, counter-clockwise turns are negative.
        prop_assert!(surface.0.iter().all(|&[a, b, c]| turn(a, b, c) < 0.0));
        // Rounding to the lattice moves edges by a unit.
        prop_assert!((area + whole).abs() < 64.0 * f64::from(SIDE), "{area} of {whole}");
        let edges: u32 = counts.edge.iter().sum();
        let [across, down] = counts.inner;
        if counts.inner == [0, 0] {
            prop_assert_eq!((counts.vertices(), counts.triangles()), (4, 2));
        } else {
            prop_assert_eq!(counts.vertices(), edges + (across - 1) * (down - 1));
            // Euler's formula for a disk, triangles without area in nested grids counted.
            if !counts.nested {
                prop_assert_eq!(counts.triangles(), 2 * counts.vertices() - 2 - edges);
            }
        }
    }

    #[test]
    fn a_small_step_of_a_factor_moves_a_surface_by_as_little(
        kind in kinds().prop_filter("pops by nature", |kind| kind.is_continuous()),
        factors in prop::array::uniform6(factor()),
        which in 0_usize..6,
    ) {
        let mut grown = factors;
        grown[which] = (grown[which] + 1).min(FACTOR_MAX);
        let (before, after) = (Surface::of(&face(kind, factors)), Surface::of(&face(kind, grown)));
        // A cut moves by 66 / 65 536 of its edge at most, and the surface over it by that times
        // the steepness, once for the cut and once for what is interpolated beside it; a new vertex
        // rises by 1 / 96 of what its parents' middle lies off the ground.
        let step = 66.0 / 65_536.0 * f64::from(SIDE) * STEEPEST;
        for place in places() {
            let (Some((_, a)), Some((_, b))) = (before.at(place), after.at(place)) else {
                continue;
            };
            prop_assert!((a - b).abs() <= 4.0 * step, "{place}: from {a} to {b}, {} steps", (a - b).abs() / step);
        }
    }
}

/// The two that pop do: the test above can see it.
#[test]
fn whole_partitionings_pop() {
    for kind in [Partitioning::Integer, Partitioning::PowerOfTwo] {
        let surface = |factor| Surface::of(&face(kind, [factor; 6]));
        let (before, after) = (surface(2 * FACTOR_ONE), surface(2 * FACTOR_ONE + 1));
        let moved = places()
            .filter_map(|place| Some((before.at(place)?.1 - after.at(place)?.1).abs()))
            .fold(0.0, f64::max);
        assert!(moved > 0.01 * f64::from(SIDE), "{kind:?}: {moved}");
    }
}

#[test]
fn cuts_follow_their_closed_form() {
    for kind in Partitioning::ALL {
        for factor in (FACTOR_ONE..=FACTOR_MAX).step_by(37) {
            let count = segment_count(kind, factor, false);
            let real = f64::from(factor) / f64::from(FACTOR_ONE);
            let closed = match kind {
                Partitioning::FractionalOdd => 2 * ((real - 1.0) / 2.0).ceil() as u32 + 1,
                Partitioning::FractionalEven => 2 * (real / 2.0).ceil().max(1.0) as u32,
                Partitioning::Integer => real.ceil() as u32,
                _ => (real.ceil() as u32).next_power_of_two(),
            };
            assert_eq!(count, closed, "{kind:?} {real}");
            let cuts: Vec<f64> = (0..=count)
                .map(|i| f64::from(segment_parameter(kind, factor, count, i)) / f64::from(ONE))
                .collect();
            let lengths: Vec<f64> = cuts.windows(2).map(|pair| pair[1] - pair[0]).collect();
            let full = match kind {
                Partitioning::Integer | Partitioning::PowerOfTwo => 1.0 / f64::from(count),
                Partitioning::FractionalEven => 1.0 / real.max(2.0),
                _ => 1.0 / real,
            };
            let rounding = 3.0 / f64::from(ONE);
            // No segment is longer than the factor promises, and all but the newest are as long.
            assert!(lengths.iter().all(|&length| length <= full + rounding));
            let shorter = lengths.iter().filter(|&&length| length < full - rounding);
            let newest = match kind {
                Partitioning::Integer | Partitioning::PowerOfTwo => 0,
                Partitioning::PowerOfTwoMorph => count as usize / 2,
                _ => 2,
            };
            assert!(shorter.count() <= newest, "{kind:?} {real}: {lengths:?}");
        }
    }
}
