//! Nothing pops: along a camera's path in steps of 5 cm, the drawn height at fixed places on the
//! ground moves by no more than a quarter of a pixel a step.
//!
//! The camera's own motion doesn't count: what is measured is the difference of two heights at one
//! place, times the focal length over the distance, as if seen from the side. `Integer` and
//! `PowerOfTwo` insert whole vertices and pop by nature; what they do is measured and not asserted.
//!
//! `cargo test --release --no-default-features --features cli --test popping -- --ignored
//! --nocapture` prints how much moves, and why.

mod common;
mod popping_support;

use bevy_tessera::tessellate::Partitioning;
use popping_support::{Cause, Movement, Movements, Stretch, World, hunt, measure};

/// The most that the ground may move in a step, in pixels.
const LIMIT_PX: f64 = 0.25;

/// Whether a partitioning is made of whole segments, which pop.
fn pops_by_nature(partitioning: Partitioning) -> bool {
    matches!(
        partitioning,
        Partitioning::Integer | Partitioning::PowerOfTwo
    )
}

/// Asserts the limit along `stretches`: at places all around, and where segments change.
fn check(world: &World, stretches: &[Stretch]) {
    let kinds: Vec<_> = Partitioning::ALL
        .into_iter()
        .filter(|&kind| !pops_by_nature(kind))
        .collect();
    let mut looked_at = 0;
    for stretch in stretches {
        for density in [1.0, 0.0] {
            let around = measure(world, stretch, 128, density, &kinds);
            let changes = hunt(world, stretch, 12, density, &kinds);
            for movements in around.iter().chain(&changes) {
                looked_at += movements.all.len();
                let Some(worst) = movements.largest() else {
                    continue;
                };
                assert!(
                    worst.px <= LIMIT_PX,
                    "{:?}, density {density}, {}: the ground at {} moved by {:.3} px in step {}: \
                     {:?}",
                    movements.partitioning,
                    stretch.name,
                    worst.place,
                    worst.px,
                    worst.step,
                    movements.explain(world, worst),
                );
            }
        }
    }
    assert!(
        looked_at > 100_000,
        "only {looked_at} movements were looked at"
    );
}

#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "minutes with overflow checks; release has it"
)]
fn the_bundled_terrain_moves_by_less_than_a_quarter_of_a_pixel_a_step() {
    let world = World::bundled();
    check(&world, &world.stretches(60));
}

#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "minutes with overflow checks; release has it"
)]
fn hills_of_a_sample_a_metre_move_by_less_than_a_quarter_of_a_pixel_a_step() {
    let world = World::hills();
    check(&world, &world.stretches(60));
}

#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "minutes with overflow checks; release has it"
)]
fn rocks_of_a_sample_a_metre_move_by_less_than_a_quarter_of_a_pixel_a_step() {
    let world = World::rough();
    check(&world, &world.stretches(60));
}

#[test]
#[cfg_attr(
    debug_assertions,
    ignore = "minutes with overflow checks; release has it"
)]
fn a_survey_of_a_sample_a_metre_moves_by_less_than_a_quarter_of_a_pixel_a_step() {
    if let Some(world) = World::lidar() {
        check(&world, &world.stretches(60));
    }
}

/// What popping is measured with finds the same heights as the whole view's mesh has.
#[test]
fn the_height_at_a_place_is_that_of_the_whole_mesh() {
    popping_support::agrees_with_the_whole_mesh(&World::rough());
}

#[test]
#[ignore = "a report, for reading: how much moves and why"]
fn report() {
    let generated = [World::hills(), World::rough(), World::sparse()];
    let surveyed = [World::bundled()].into_iter().chain(World::lidar());
    for world in surveyed.chain(generated) {
        for stretch in world.stretches(200) {
            for density in [1.0, 0.0] {
                let around = measure(&world, &stretch, 256, density, &Partitioning::ALL);
                let changes = hunt(&world, &stretch, 12, density, &Partitioning::ALL);
                for (around, changes) in around.iter().zip(&changes) {
                    let kind = format!("{:?}", around.partitioning);
                    println!(
                        "{}, {}, density {density}, {kind}",
                        world.name, stretch.name
                    );
                    print(&world, "places all around", around);
                    print(&world, "where segments change", changes);
                }
            }
        }
    }
}

fn print(world: &World, what: &str, movements: &Movements) {
    println!(
        "  {what:22} max {:7.3} px  99.9 % {:6.3}  99 % {:6.3}  over {LIMIT_PX}: {:5} of {}",
        movements.largest().map_or(0.0, |worst| worst.px),
        movements.quantile(0.999),
        movements.quantile(0.99),
        movements.over(LIMIT_PX).len(),
        movements.all.len(),
    );
    // Of each cause how often, and the worst.
    let mut causes: Vec<(Cause, usize, Movement, f64)> = Vec::new();
    for movement in movements.over(0.1).into_iter().take(300) {
        let (cause, jump_px, _) = movements.explain(world, movement);
        match causes.iter_mut().find(|entry| entry.0 == cause) {
            Some(entry) => entry.1 += 1,
            None => causes.push((cause, 1, movement, jump_px)),
        }
    }
    for (cause, count, worst, jump_px) in causes {
        println!(
            "    {count:4} x {cause:?}: at most {:.3} px in a step, of which {jump_px:.3} px at \
             once, at {} in step {}",
            worst.px, worst.place, worst.step
        );
    }
}
