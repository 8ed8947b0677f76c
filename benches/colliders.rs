//! What colliders cost the thread of physics: `cargo bench --all-features --bench colliders`.
//!
//! A terrain of 1025 × 1025 samples, pinned as a whole, with colliders everywhere. `edit` is all that
//! the plugin does for a physics step after a crater: the event, and the colliders' new shapes; `make`
//! is what making all colliders takes of that thread.

#[path = "../tests/streaming_support/mod.rs"]
mod streaming_support;

use avian3d::prelude::*;
use bevy::ecs::schedule::ScheduleLabel;
use bevy::prelude::*;
use bevy_tessera::edit::{SampleRect, TerrainEdited};
use bevy_tessera::physics::{
    TerrainColliderPin, TerrainColliders, TerrainPhysics, TerrainPhysicsPlugin,
};
use bevy_tessera::stream::{TerrainPinProgress, TerrainRegion};
use bevy_tessera::terrain::Terrain;
use criterion::{Criterion, criterion_group, criterion_main};
use std::time::{Duration, Instant};
use streaming_support::World3;

const SIZE: [u32; 2] = [1025; 2];

/// A schedule of the plugin alone; Avian's is another.
#[derive(ScheduleLabel, Clone, Debug, PartialEq, Eq, Hash)]
struct Alone;

/// A world in which all of a terrain has colliders of so many cells.
fn world(chunk_cells: u32) -> (World3, Entity, Entity) {
    let mut world = World3::in_app(SIZE, false, |app, _| {
        app.init_schedule(Alone)
            .add_plugins((PhysicsPlugins::default(), TerrainPhysicsPlugin::new(Alone)))
            .insert_resource(TerrainPhysics {
                chunk_cells,
                builds_per_step: 4096,
                keep_s: 0.0,
                ..default()
            });
    });
    let terrain = world.spawn(());
    let pin = world.app.world_mut().spawn(everywhere(terrain)).id();
    world.run_until("pinned", |world| {
        let progress = world.get::<TerrainPinProgress>(pin);
        progress.is_some_and(TerrainPinProgress::is_ready)
    });
    make(&mut world, terrain);
    world.app.world_mut().run_schedule(FixedPostUpdate);
    (world, terrain, pin)
}

fn everywhere(terrain: Entity) -> impl Bundle {
    let pin = Terrain::wait_for(terrain, TerrainRegion::EVERYTHING);
    (pin, TerrainColliderPin)
}

/// Runs the plugin until all colliders are there; the time that it took of its thread.
fn make(world: &mut World3, terrain: Entity) -> Duration {
    let mut spent = Duration::ZERO;
    loop {
        let before = Instant::now();
        world.app.world_mut().run_schedule(Alone);
        spent += before.elapsed();
        let all = world.app.world().resource::<TerrainColliders>();
        if all.covers(terrain, TerrainRegion::EVERYTHING) {
            return spent;
        }
        std::thread::sleep(Duration::from_micros(200));
    }
}

fn edited(world: &mut World, terrain: Entity, rect: SampleRect) {
    world.trigger(TerrainEdited {
        entity: terrain,
        sequence: 0,
        rect,
        region: TerrainRegion::EVERYTHING,
        clamped: false,
    });
}

/// A square of `side` samples on a corner of four colliders.
fn crater(side: i32) -> SampleRect {
    let first = 512 - side / 2;
    SampleRect::new([first; 2], [first + side; 2])
}

fn colliders(criterion: &mut Criterion) {
    for cells in [32, 64, 128] {
        let mut group = criterion.benchmark_group(format!("colliders of {cells} cells"));
        let (mut app, terrain, mut pin) = world(cells);
        let count = (1024 / cells).pow(2);
        group.bench_function("nothing has changed", |bencher| {
            let world = app.app.world_mut();
            bencher.iter(|| world.run_schedule(Alone));
        });
        for side in [33, 49] {
            group.bench_function(format!("edit of {side} x {side} samples"), |bencher| {
                let world = app.app.world_mut();
                bencher.iter(|| {
                    edited(world, terrain, crater(side));
                    world.run_schedule(Alone);
                });
            });
        }
        group.bench_function("a thousand edits of 49 x 49", |bencher| {
            let world = app.app.world_mut();
            bencher.iter(|| {
                for n in 0..1000 {
                    let at = [(n % 32) * 30, (n / 32) * 30];
                    edited(world, terrain, SampleRect::new(at, at.map(|at| at + 49)));
                }
                world.run_schedule(Alone);
            });
        });
        group.bench_function("Avian's step, nothing has changed", |bencher| {
            let world = app.app.world_mut();
            bencher.iter(|| world.run_schedule(FixedPostUpdate));
        });
        group.bench_function("edit of 49 x 49, and Avian's step", |bencher| {
            let world = app.app.world_mut();
            bencher.iter(|| {
                edited(world, terrain, crater(49));
                world.run_schedule(Alone);
                world.run_schedule(FixedPostUpdate);
            });
        });
        group.bench_function(format!("make {count}"), |bencher| {
            bencher.iter_custom(|times| {
                let mut spent = Duration::ZERO;
                for _ in 0..times {
                    let world = app.app.world_mut();
                    world.despawn(pin);
                    while world.resource::<TerrainColliders>().wanted() > 0 {
                        world.run_schedule(Alone);
                    }
                    pin = world.spawn(everywhere(terrain)).id();
                    spent += make(&mut app, terrain);
                }
                spent
            });
        });
        for n in 0..1000 {
            let at = Vec3::new((n % 32) as f32 * 60.0, 100.0, (n / 32) as f32 * 60.0);
            app.app.world_mut().spawn((
                RigidBody::Kinematic,
                Collider::sphere(0.5),
                LinearVelocity(Vec3::X * 3.0),
                Transform::from_translation(at),
            ));
        }
        app.app.world_mut().run_schedule(FixedPostUpdate);
        app.app.world_mut().run_schedule(FixedPostUpdate);
        group.bench_function("a thousand bodies, nothing has changed", |bencher| {
            let world = app.app.world_mut();
            bencher.iter(|| world.run_schedule(Alone));
        });
        group.finish();
    }
}

criterion_group! {
    name = benches;
    config = Criterion::default()
        .warm_up_time(Duration::from_millis(300))
        .measurement_time(Duration::from_secs(1))
        .sample_size(20);
    targets = colliders
}
criterion_main!(benches);
