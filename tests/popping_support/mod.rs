//! How far the drawn ground moves as the eye does, and why.

mod world;

use crate::common::random::Random;
use bevy_tessera::lattice::Node;
use bevy_tessera::tessellate::{FACTOR_ONE, FaceFactors, Partitioning};
use glam::{DVec2, DVec3};
use rayon::prelude::*;
use std::collections::HashMap;
use world::{Drawn, FOCAL_PX, View, area2, holds};
pub use world::{Place, Stretch, World};

/// Why the ground moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Another node is drawn there, of another level.
    Level,
    /// The morph to the next level.
    Morph,
    /// A factor changed at once by more than a sixteenth of a segment.
    FactorJump,
    /// The inner grid got other segments, seen in the grid.
    InnerCountInGrid,
    /// The inner grid got other segments, seen in a strip.
    InnerCountInStrip,
    /// An edge got other segments, the inner grid didn't.
    EdgeCount,
    /// Vertices slid with their factors; nothing happened at once.
    Slide,
}

/// A step in which the ground moved.
#[derive(Clone, Copy, Debug)]
pub struct Movement {
    pub place: Place,
    pub step: usize,
    pub px: f64,
}

/// All steps at all places.
pub struct Movements {
    pub partitioning: Partitioning,
    density: f32,
    eyes_m: Vec<DVec3>,
    pub all: Vec<Movement>,
}

/// Pixels that a difference of heights at `place` takes.
fn pixels(world: &World, eye_m: DVec3, place: Place, height_m: f64, moved_m: f64) -> f64 {
    let plane = place.as_dvec2() * world.lattice.unit_m(world.file.spacing_m);
    let distance_m = DVec3::new(plane.x, height_m, plane.y).distance(eye_m);
    moved_m.abs() * FOCAL_PX / distance_m.max(0.5)
}

/// Places around a path, as many near as far.
fn places(world: &World, stretch: &Stretch, count: usize) -> Vec<Place> {
    let mut random = Random(99);
    let mut places = Vec::new();
    let middle = stretch.eyes_m[stretch.eyes_m.len() / 2];
    while places.len() < count {
        // From 2 m to as far as the terrain goes.
        let distance =
            2.0 * f64::from(random.unit() * (400.0 * world.file.spacing_m as f32).ln()).exp();
        let angle = f64::from(random.unit()) * std::f64::consts::TAU;
        let at = DVec2::new(middle.x, middle.z) + DVec2::from_angle(angle) * distance;
        let last = world.lattice.extent.as_dvec2() * world.lattice.unit_m(world.file.spacing_m);
        if at.cmpgt(DVec2::ZERO).all() && at.cmplt(last).all() {
            places.push(world.place(at));
        }
    }
    places
}

/// How far the ground moves at `count` places along a stretch, for each partitioning.
pub fn measure(
    world: &World,
    stretch: &Stretch,
    count: usize,
    density: f32,
    partitionings: &[Partitioning],
) -> Vec<Movements> {
    let views: Vec<View> = stretch
        .eyes_m
        .iter()
        .map(|&eye| world.view(eye, density))
        .collect();
    let moved: Vec<Vec<Vec<Movement>>> = places(world, stretch, count)
        .into_par_iter()
        .map(|place| {
            let mut all = vec![Vec::new(); partitionings.len()];
            let mut before: Option<Vec<f64>> = None;
            for (step, view) in views.iter().enumerate() {
                let mesh = world.mesh(view, Partitioning::FractionalOdd);
                let drawn = world.drawn(view, partitionings, place, |node, face| {
                    mesh.classify(node, face)
                });
                let heights: Vec<f64> = drawn.iter().map(|drawn| drawn.height_m).collect();
                if let Some(before) = before {
                    for (k, all) in all.iter_mut().enumerate() {
                        let moved_m = heights[k] - before[k];
                        let px = pixels(world, stretch.eyes_m[step], place, heights[k], moved_m);
                        all.push(Movement { place, step, px });
                    }
                }
                before = Some(heights);
            }
            all
        })
        .collect();
    partitionings
        .iter()
        .enumerate()
        .map(|(k, &partitioning)| {
            let all = moved
                .iter()
                .flat_map(|place| place[k].iter().copied())
                .collect();
            Movements::new(stretch, partitioning, density, all)
        })
        .collect()
}

/// The factors of all faces that a view draws.
type Classified = HashMap<(Node, u32), FaceFactors>;

fn classified(world: &World, view: &View) -> Classified {
    let mut nodes = Vec::new();
    view.lod
        .select(&world.lattice, &mut |_, _| true, &mut |node| {
            nodes.push(node)
        });
    let mesh = world.mesh(view, Partitioning::FractionalOdd);
    let faces_a_node = 1_u32 << (2 * world.lattice.faces_log2);
    nodes
        .into_par_iter()
        .flat_map_iter(|node| (0..faces_a_node).map(move |face| (node, face)))
        .map(|(node, face)| ((node, face), mesh.classify(&node, face)))
        .collect()
}

/// Looks where something may pop: at `count` places in each face whose segments change in a step
/// and in each node that comes or goes.
pub fn hunt(
    world: &World,
    stretch: &Stretch,
    count: usize,
    density: f32,
    partitionings: &[Partitioning],
) -> Vec<Movements> {
    let mut found = vec![Vec::new(); partitionings.len()];
    let mut before: Option<(View, Classified)> = None;
    for (step, &eye_m) in stretch.eyes_m.iter().enumerate() {
        let view = world.view(eye_m, density);
        let factors = classified(world, &view);
        if let Some((old, old_factors)) = &before {
            for (k, &partitioning) in partitionings.iter().enumerate() {
                let moves: Vec<Movement> = factors
                    .par_iter()
                    .flat_map_iter(|(&(node, face), &now)| {
                        let seed = (step as u64) << 40 | u64::from(face) << 32;
                        let seed =
                            seed ^ u64::from((node.origin.x ^ (node.origin.y >> 8)).unsigned_abs());
                        let mut random = Random(seed | 1);
                        let corners = world.mesh(&view, partitioning).corners(&node, face);
                        let cut = world.cut(partitioning, node, face, corners, now);
                        let was = old_factors.get(&(node, face)).map(|&was| {
                            let corners = world.mesh(old, partitioning).corners(&node, face);
                            world.cut(partitioning, node, face, corners, was)
                        });
                        let changed = was.as_ref().is_none_or(|was| was.counts != cut.counts);
                        let samples = if changed { count } else { 0 };
                        let mut moves = Vec::new();
                        for _ in 0..samples {
                            let place = cut.random_place(&mut random);
                            let Some(after) = world.in_face(&view, &cut, place) else {
                                continue;
                            };
                            let before = match &was {
                                Some(was) => match world.in_face(old, was, place) {
                                    Some(before) => before,
                                    None => continue,
                                },
                                None => {
                                    let mesh = world.mesh(old, partitioning);
                                    let factors = |node: &Node, face| mesh.classify(node, face);
                                    world.drawn(old, &[partitioning], place, factors).remove(0)
                                }
                            };
                            let moved_m = after.height_m - before.height_m;
                            let px = pixels(world, eye_m, place, after.height_m, moved_m);
                            moves.push(Movement { place, step, px });
                        }
                        moves
                    })
                    .collect();
                found[k].extend(moves);
            }
        }
        before = Some((view, factors));
    }
    partitionings
        .iter()
        .zip(found)
        .map(|(&partitioning, all)| Movements::new(stretch, partitioning, density, all))
        .collect()
}

impl Movements {
    fn new(
        stretch: &Stretch,
        partitioning: Partitioning,
        density: f32,
        mut all: Vec<Movement>,
    ) -> Self {
        all.sort_by(|a, b| b.px.total_cmp(&a.px));
        Self {
            partitioning,
            density,
            eyes_m: stretch.eyes_m.clone(),
            all,
        }
    }

    /// The largest, unless there is none.
    pub fn largest(&self) -> Option<Movement> {
        self.all.first().copied()
    }

    pub fn quantile(&self, part: f64) -> f64 {
        let last = self.all.len().saturating_sub(1);
        let at = ((1.0 - part) * last as f64) as usize;
        self.all.get(at).map_or(0.0, |movement| movement.px)
    }

    pub fn over(&self, px: f64) -> Vec<Movement> {
        let few = self.all.partition_point(|movement| movement.px > px);
        self.all[..few].to_vec()
    }

    /// Why the ground moved, how much of that at once, and what was drawn before and after. The
    /// step is halved as long as it can be, so that a single thing remains that changes.
    pub fn explain(&self, world: &World, movement: Movement) -> (Cause, f64, [Drawn; 2]) {
        let place = movement.place;
        let at = |eye: DVec3| {
            let view = world.view(eye, self.density);
            let mesh = world.mesh(&view, self.partitioning);
            let factors = |node: &Node, face| mesh.classify(node, face);
            world
                .drawn(&view, &[self.partitioning], place, factors)
                .remove(0)
        };
        let (mut from, mut to) = (self.eyes_m[movement.step - 1], self.eyes_m[movement.step]);
        let (mut before, mut after) = (at(from), at(to));
        for _ in 0..24 {
            let eye = 0.5 * (from + to);
            let middle = at(eye);
            let first = (middle.height_m - before.height_m).abs();
            let second = (after.height_m - middle.height_m).abs();
            if first > second {
                (to, after) = (eye, middle);
            } else {
                (from, before) = (eye, middle);
            }
        }
        let jump_px = pixels(
            world,
            to,
            place,
            after.height_m,
            after.height_m - before.height_m,
        );
        // A movement of which little is left is smooth: look at the whole step.
        let is_smooth = jump_px < 0.5 * movement.px;
        if is_smooth {
            (from, to) = (self.eyes_m[movement.step - 1], self.eyes_m[movement.step]);
            (before, after) = (at(from), at(to));
        }
        let cause = self.cause(world, place, to, is_smooth, [&before, &after]);
        (cause, jump_px, [before, after])
    }

    fn cause(
        &self,
        world: &World,
        place: Place,
        to: DVec3,
        is_smooth: bool,
        [before, after]: [&Drawn; 2],
    ) -> Cause {
        if before.node != after.node {
            return Cause::Level;
        }
        if before.face != after.face {
            return Cause::Morph;
        }
        // The new view with the old factors: what remains is the morph.
        let view = world.view(to, self.density);
        let morphed = world
            .drawn(&view, &[self.partitioning], place, |node, face| {
                if face == before.face {
                    before.factors
                } else {
                    world.mesh(&view, self.partitioning).classify(node, face)
                }
            })
            .remove(0);
        let by_morph = (morphed.height_m - before.height_m).abs();
        let by_factors = (after.height_m - morphed.height_m).abs();
        if by_morph > by_factors {
            return Cause::Morph;
        }
        if is_smooth {
            return Cause::Slide;
        }
        let all = |factors: &FaceFactors| {
            let [a, b, c, d] = factors.edges;
            [a, b, c, d, factors.inside[0], factors.inside[1]]
        };
        let jump = all(&before.factors)
            .into_iter()
            .zip(all(&after.factors))
            .map(|(before, after)| before.abs_diff(after))
            .max()
            .unwrap_or(0);
        let same_inner = before.counts.inner == after.counts.inner;
        if jump > FACTOR_ONE / 16 {
            Cause::FactorJump
        } else if before.counts == after.counts {
            Cause::Slide
        } else if same_inner {
            Cause::EdgeCount
        } else if before.in_strip || after.in_strip {
            Cause::InnerCountInStrip
        } else {
            Cause::InnerCountInGrid
        }
    }
}

/// Compares heights at places with those of the mesh of all nodes.
pub fn agrees_with_the_whole_mesh(world: &World) {
    let stretch = &world.stretches(2)[0];
    let view = world.view(stretch.eyes_m[0], 1.0);
    let mesh = world.mesh(&view, Partitioning::FractionalEven);
    let mut nodes = Vec::new();
    view.lod
        .select(&world.lattice, &mut |_, _| true, &mut |node| {
            nodes.push(node)
        });
    let whole = mesh.build(&nodes);
    for place in places(world, stretch, 40) {
        let factors = |node: &Node, face| mesh.classify(node, face);
        let found = world
            .drawn(&view, &[Partitioning::FractionalEven], place, factors)
            .remove(0);
        let mut holders = 0;
        for triangle in &whole.triangles {
            let corners = triangle.map(|vertex| whole.vertices[vertex as usize]);
            let [a, b, c] = corners.map(|vertex| vertex.point);
            if !holds([a, b, c], place) {
                continue;
            }
            holders += 1;
            let weights = [area2(b, c, place), area2(c, a, place), area2(a, b, place)];
            let height: f64 = (0..3)
                .map(|k| weights[k] as f64 / area2(a, b, c) as f64 * f64::from(corners[k].height_m))
                .sum();
            assert!(
                (height - found.height_m).abs() < 1e-6,
                "{place}: {height}, {found:?}"
            );
        }
        assert!(holders > 0);
    }
}
