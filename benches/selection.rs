//! Selecting the nodes of a view: `cargo bench --no-default-features --bench selection`.

use bevy_tessera::lattice::{Lattice, LodSettings, Node, ViewLod};
use criterion::{Criterion, criterion_group, criterion_main};
use glam::IVec2;
use std::hint::black_box;

fn selection(criterion: &mut Criterion) {
    // 32 km at a metre, the way an open world is played: 9 levels, and two below the tiles.
    let lattice = Lattice::new([32_769, 32_769], 9, -2, 8).unwrap();
    let mut group = criterion.benchmark_group("selection");
    for reach in [4.0, 6.0, 8.0] {
        let settings = LodSettings { reach, morph: 1.0 };
        let eye = IVec2::new(lattice.extent.x * 5 / 11, lattice.extent.y * 4 / 7);
        let lod = ViewLod::new(&lattice, &settings, eye, 0, true).unwrap();
        let select = |nodes: &mut Vec<Node>| {
            nodes.clear();
            lod.select(&lattice, &mut |_, _| true, &mut |node| nodes.push(node));
            nodes.len()
        };
        let mut nodes = Vec::new();
        let count = select(&mut nodes);
        group.bench_function(format!("reach {reach}, {count} nodes"), |bencher| {
            bencher.iter(|| black_box(select(&mut nodes)));
        });
    }
    group.finish();
}

criterion_group!(benches, selection);
criterion_main!(benches);
