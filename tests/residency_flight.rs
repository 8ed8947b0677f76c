//! Following plans frame by frame: all that fits arrives, rest is rest, and no tile starves.

mod residency_support;

use bevy_tessera::lattice::{LodSettings, ViewLod};
use bevy_tessera::residency::{EyePath, Need, Planner, Ranked};
use bevy_tessera::tile::TileAddress;
use glam::IVec2;
use proptest::prelude::*;
use residency_support::{Draw, Ground, draws, squares};
use std::collections::{HashMap, HashSet};

/// A streamer as simple as can be: loads the best-ranked missing tiles, a few at once, and makes
/// room by dropping tiles that the plan leaves out.
struct Streamer {
    ground: Ground,
    planner: Planner,
    capacity: usize,
    in_flight: usize,
    /// Frames that a load takes, at most.
    delay: u32,
    loading: Vec<(TileAddress, u32)>,
    /// Tiles that came and went in the latest frame.
    came: usize,
    went: usize,
}

impl Streamer {
    fn new(ground: Ground, capacity: usize, in_flight: usize, delay: u32) -> Self {
        Self {
            ground,
            planner: Planner::default(),
            capacity,
            in_flight,
            delay,
            loading: Vec::new(),
            came: 0,
            went: 0,
        }
    }

    fn frame(&mut self, lookahead_s: f32) -> Vec<Ranked> {
        let terrain = self.ground.terrain();
        let plan = self.planner.plan(&[terrain], self.capacity, lookahead_s);
        let ranked = plan.ranked().to_vec();
        let wanted: HashSet<_> = ranked.iter().map(|tile| tile.address).collect();
        self.loading.retain(|(tile, _)| wanted.contains(tile));
        (self.came, self.went) = (0, 0);
        let mut count = self.ground.resident.count();
        let arrived: Vec<_> = self.loading.iter().filter(|(_, left)| *left == 0).collect();
        if count + arrived.len() > self.capacity {
            // The finest first: children go before their parents.
            for tile in squares(&self.ground.index).into_iter().rev() {
                if !wanted.contains(&tile) && self.ground.resident.remove(tile) {
                    self.went += 1;
                    count -= 1;
                }
            }
        }
        let (resident, capacity) = (&mut self.ground.resident, self.capacity);
        let mut came = 0;
        self.loading.retain_mut(|(tile, left)| {
            *left = left.saturating_sub(1);
            let stays = *left > 0 || count >= capacity || !resident.insert(*tile);
            if !stays {
                count += 1;
                came += 1;
            }
            stays
        });
        self.came = came;
        for tile in &ranked {
            if self.loading.len() >= self.in_flight {
                break;
            }
            let known = self.ground.resident.contains(tile.address)
                || self.loading.iter().any(|(other, _)| *other == tile.address);
            if !known {
                // Some loads are quicker than others.
                let delay = 1 + (tile.address.x * 7 + tile.address.z * 3) % self.delay;
                self.loading.push((tile.address, delay));
            }
        }
        ranked
    }
}

fn flat(size: (u32, u32)) -> Ground {
    Ground::whole(size.into())
}

fn eye(ground: &Ground, at: glam::DVec2, velocity: glam::Vec2) -> EyePath {
    let leaf = f64::from(ground.lattice.node_size(0));
    let at: IVec2 = (at * leaf).as_ivec2();
    let lod = ViewLod::new(&ground.lattice, &LodSettings::default(), at, 0, true);
    EyePath {
        lod: lod.expect("valid"),
        velocity: (velocity * leaf as f32).into(),
        descent: 0.0,
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, ..ProptestConfig::default() })]

    #[test]
    fn while_eyes_rest_all_that_fits_arrives_and_then_nothing_moves(
        draw in draws(),
        capacity in 1..150_usize,
        in_flight in 1..9_usize,
        delay in 1..9_u32,
        lookahead_s in prop_oneof![Just(0.0_f32), Just(2.0)],
    ) {
        let ground = Ground::new(&Draw { resident: vec![0], ..draw });
        let mut streamer = Streamer::new(ground, capacity, in_flight, delay);
        // Each load takes its frames, and as many as are in flight run side by side.
        for _ in 0..capacity as u32 * (delay + 1) + 10 {
            streamer.frame(lookahead_s);
        }
        let ranked = streamer.frame(lookahead_s);
        for tile in &ranked {
            prop_assert!(streamer.ground.resident.contains(tile.address), "{}", tile.address);
        }
        for _ in 0..10 {
            prop_assert_eq!(&streamer.frame(lookahead_s), &ranked);
            prop_assert_eq!((streamer.came, streamer.went), (0, 0));
        }
    }

    #[test]
    fn no_tile_starves_while_an_eye_flies(
        legs in prop::collection::vec((0.0..20.0, 0.0..20.0), 2..6),
        capacity in 30..200_usize,
        in_flight in 3..9_usize,
        delay in 1..5_u32,
        lookahead_s in prop_oneof![Just(0.0_f32), Just(2.0)],
    ) {
        const FRAME_S: f64 = 1.0 / 60.0;
        // Leaf tiles per second: 300 m/s over tiles of 128 m.
        const SPEED: f64 = 2.3;
        // Longer than the longest queue takes.
        let patience = capacity as u32 * (delay + 1) / in_flight as u32 + 60;
        let mut streamer = Streamer::new(flat((2561, 2561)), capacity, in_flight, delay);
        let mut at = glam::DVec2::from(legs[0]);
        let mut waits: HashMap<TileAddress, u32> = HashMap::new();
        for to in legs.into_iter().map(glam::DVec2::from) {
            let way = to - at;
            let frames = (way.length() / SPEED / FRAME_S) as u32;
            let velocity = way.normalize_or_zero() * SPEED;
            for _ in 0..frames {
                at += velocity * FRAME_S;
                streamer.ground.eyes = vec![eye(&streamer.ground, at, velocity.as_vec2())];
                let ranked = streamer.frame(lookahead_s);
                let resident = &streamer.ground.resident;
                let mut still = HashMap::new();
                for tile in ranked {
                    if !resident.contains(tile.address) {
                        let wait = waits.get(&tile.address).unwrap_or(&0) + 1;
                        prop_assert!(wait < patience, "{} starves", tile.address);
                        still.insert(tile.address, wait);
                    }
                }
                waits = still;
            }
        }
    }

    #[test]
    fn an_eye_that_sways_at_the_capacitys_edge_changes_nothing(
        at in (6.0..14.0, 6.0..14.0),
        sways in prop::collection::vec((-0.02..0.02, -0.02..0.02), 20),
        part in 0.2..0.6,
    ) {
        let mut ground = flat((2561, 2561));
        let at = glam::DVec2::from(at);
        let path = |ground: &Ground, at| eye(ground, at, glam::Vec2::ZERO);
        ground.eyes = vec![path(&ground, at)];
        let mut planner = Planner::default();
        let all = planner.plan(&[ground.terrain()], usize::MAX, 0.0).clone();
        let capacity = (all.candidates() as f64 * part) as usize;
        // What lies directly under the eye is at distance 0, an eighth of which is nothing; and
        // tiles at the end of their level's reach come and go with it.
        let last = all.ranked()[capacity].address;
        let size = f64::from(ground.lattice.node_size(i32::from(last.level)));
        let distance = ground.box_distance(&ground.eyes[0].lod, last, true) as f64 / size;
        prop_assume!((0.6..3.0).contains(&distance));
        for tile in &all.ranked()[..capacity] {
            prop_assert!(ground.resident.insert(tile.address));
        }
        let set = |ranked: &[Ranked]| -> HashSet<_> {
            ranked.iter().map(|tile| tile.address).collect()
        };
        let before = set(&all.ranked()[..capacity]);
        for sway in sways {
            ground.eyes = vec![path(&ground, at + glam::DVec2::from(sway))];
            let plan = planner.plan(&[ground.terrain()], capacity, 0.0);
            prop_assert_eq!(set(plan.ranked()), before.clone());
        }
    }
}

#[test]
fn what_is_needed_soon_is_there_when_it_is_needed() {
    // Straight across the terrain at 300 m/s over tiles of 128 m, with room for everything.
    const FRAME_S: f64 = 1.0 / 60.0;
    let late = |lookahead_s: f32| {
        let mut streamer = Streamer::new(flat((5121, 2561)), 2000, 6, 4);
        let mut at = glam::DVec2::new(6.0, 9.3);
        let mut late = 0;
        for frame in 0..700 {
            if frame > 200 {
                at.x += 2.3 * FRAME_S;
            }
            streamer.ground.eyes = vec![eye(&streamer.ground, at, glam::Vec2::new(2.3, 0.0))];
            let ranked = streamer.frame(lookahead_s);
            if frame > 200 {
                let resident = &streamer.ground.resident;
                late += ranked
                    .iter()
                    .filter(|tile| tile.need == Need::Now && !resident.contains(tile.address))
                    .count();
            }
        }
        late
    };
    assert!(late(0.0) > 0);
    assert_eq!(late(1.0), 0);
}
