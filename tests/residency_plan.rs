//! A plan holds the tiles that are needed most, each behind its parent, and what is needed is what
//! views can ask for.

mod residency_support;

use bevy_tessera::lattice::{LodSettings, ONE, ViewLod};
use bevy_tessera::residency::{
    Availability, EyePath, Need, PinnedRegion, Plan, PlanTerrain, Planner, ResidentTiles,
    levels_short,
};
use bevy_tessera::tile::{TileAddress, TileIndex};
use glam::IVec2;
use proptest::prelude::*;
use residency_support::{Draw, EyeDraw, Ground, draws, eyes, file, reference, squares};
use std::collections::HashSet;

fn terrains(grounds: &[Ground]) -> Vec<PlanTerrain<'_>> {
    grounds.iter().map(Ground::terrain).collect()
}

fn planned(grounds: &[Ground], capacity: usize, lookahead_s: f32) -> Plan {
    let mut planner = Planner::default();
    planner
        .plan(&terrains(grounds), capacity, lookahead_s)
        .clone()
}

fn all_draws() -> impl Strategy<Value = Vec<Draw>> {
    prop::collection::vec(draws(), 1..3)
}

fn capacities() -> impl Strategy<Value = usize> {
    prop_oneof![0..4_usize, 0..60_usize, 0..800_usize, Just(usize::MAX)]
}

fn lookaheads() -> impl Strategy<Value = f32> {
    prop_oneof![Just(0.0_f32), Just(1.0), 0.0..6.0_f32]
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn the_best_are_ranked_as_brute_force_ranks_them(
        draws in all_draws(),
        capacity in capacities(),
        lookahead_s in lookaheads(),
    ) {
        let grounds: Vec<_> = draws.iter().map(Ground::new).collect();
        let plan = planned(&grounds, capacity, lookahead_s);
        let all = reference(&grounds, lookahead_s);
        let ranked = all.len().min(capacity);
        prop_assert_eq!(plan.ranked(), &all[..ranked]);
        prop_assert_eq!(plan.candidates(), all.len());
        let pressing = all[ranked..].iter().any(|tile| tile.need != Need::Soon);
        prop_assert_eq!(plan.is_cut(), pressing);

        // Figures of each eye, by their definitions.
        let kept: HashSet<_> = plan.ranked().iter().map(|tile| (tile.terrain, tile.address)).collect();
        let mut most_short = 0;
        for (number, ground) in grounds.iter().enumerate() {
            prop_assert_eq!(plan.eyes(number).len(), ground.eyes.len());
            for (eye, figures) in ground.eyes.iter().zip(plan.eyes(number)) {
                let wanted: Vec<_> = squares(&ground.index)
                    .into_iter()
                    .filter(|&tile| ground.can_be_had(tile) && ground.needs_now(&eye.lod, tile))
                    .collect();
                let cut = wanted.iter().any(|&tile| !kept.contains(&(number as u32, tile)));
                let short = wanted.iter().map(|&tile| ground.short(tile)).max().unwrap_or(0);
                prop_assert_eq!(figures.wanted_now as usize, wanted.len());
                prop_assert_eq!(figures.cut, cut);
                prop_assert_eq!(figures.levels_short, short);
                let PlanTerrain { lattice, available, resident, .. } = ground.terrain();
                prop_assert_eq!(levels_short(lattice, available, resident, &eye.lod), short);
                most_short = short.max(most_short);
            }
        }
        prop_assert_eq!(plan.levels_short(), most_short);
        prop_assert!(plan.eyes(grounds.len()).is_empty());
    }

    #[test]
    fn parents_stand_before_their_children_and_no_tile_twice(
        draws in all_draws(),
        capacity in capacities(),
        lookahead_s in lookaheads(),
    ) {
        let grounds: Vec<_> = draws.iter().map(Ground::new).collect();
        let plan = planned(&grounds, capacity, lookahead_s);
        prop_assert!(plan.ranked().len() <= capacity);
        let mut seen = HashSet::new();
        for tile in plan.ranked() {
            let levels = grounds[tile.terrain as usize].index.levels().len();
            let is_root = usize::from(tile.address.level) + 1 == levels;
            let parent = (tile.terrain, tile.address.parent());
            prop_assert!(is_root || seen.contains(&parent), "{} before its parent", tile.address);
            prop_assert!(seen.insert((tile.terrain, tile.address)), "{} twice", tile.address);
        }
    }

    #[test]
    fn a_plan_follows_from_its_input_alone(
        before in all_draws(),
        draws in all_draws(),
        capacity in capacities(),
        lookahead_s in lookaheads(),
    ) {
        let before: Vec<_> = before.iter().map(Ground::new).collect();
        let grounds: Vec<_> = draws.iter().map(Ground::new).collect();
        let mut planner = Planner::default();
        let first = planner.plan(&terrains(&grounds), capacity, lookahead_s).clone();
        planner.plan(&terrains(&before), 500, 3.0);
        let again = planner.plan(&terrains(&grounds), capacity, lookahead_s).clone();
        prop_assert_eq!(&first, &again);
        prop_assert_eq!(planner.latest(), &again);
    }

    #[test]
    fn a_tile_is_needed_now_where_a_view_may_read_it_and_nowhere_else(
        size in (2..2600_u32, 2..2600_u32),
        leaf_level in -2..=0,
        eye in eyes(),
        points in prop::collection::vec((0.0..=1.0, 0.0..=1.0), 30),
    ) {
        let ground = Ground::new(&Draw {
            leaf_level,
            eyes: vec![eye],
            ..whole(size)
        });
        let (lattice, lod) = (&ground.lattice, &ground.eyes[0].lod);
        let plan = planned(std::slice::from_ref(&ground), usize::MAX, 0.0);
        let needed: HashSet<_> = plan.ranked().iter().map(|tile| tile.address).collect();

        // Whatever is drawn at a point reads a needed tile.
        let mut nodes = Vec::new();
        lod.select(lattice, &mut |_, _| true, &mut |node| nodes.push(node));
        let points = points
            .into_iter()
            .map(|(x, z)| (lattice.extent.as_dvec2() * glam::DVec2::new(x, z)).as_ivec2());
        for p in points {
            let node = nodes.iter().find(|node| {
                let bounds = node.bounds(lattice).expect("drawn");
                bounds.low.cmple(p).all() && p.cmple(bounds.high).all()
            });
            let node = node.expect("the whole terrain is drawn");
            let level = (lod.detail(lattice, p, node.level) / ONE).clamp(0, lattice.root_level);
            // The tile of that level around the node; a coarser node reads its own.
            let at = node.origin >> lattice.node_log2(level.max(node.level)) as i32;
            let tile = TileAddress::new(level.max(node.level) as u8, at.x as u32, at.y as u32);
            prop_assert!(needed.contains(&tile), "{tile} is read at {p}");
        }

        // And a needed tile may be read: at its nearest point the view asks for less than the
        // next coarser level.
        let root_level = lattice.root_level as u8;
        for tile in squares(&ground.index) {
            let [low, high] = ground.bounds(tile).map(|p| IVec2::new(p[0] as i32, p[1] as i32));
            let level = i32::from(tile.level);
            let asks = lod.detail(lattice, lod.eye.clamp(low, high), level) < (level + 1) * ONE;
            prop_assert_eq!(needed.contains(&tile), asks || tile.level == root_level, "{}", tile);
        }
    }

    #[test]
    fn soon_are_the_tiles_that_become_needed_along_the_path(
        size in (2..2600_u32, 2..2600_u32),
        eye in eyes(),
        velocity in (-4.0..4.0_f32, -4.0..4.0_f32),
        descent in prop_oneof![Just(0.0_f32), 0.0..10.0_f32],
        lookahead_s in 0.5..3.0_f32,
    ) {
        const STEPS: u32 = 600;
        let ground = Ground::new(&Draw {
            eyes: vec![EyeDraw { velocity, descent, ..eye }],
            ..whole(size)
        });
        let path = ground.eyes[0];
        let plan = planned(std::slice::from_ref(&ground), usize::MAX, lookahead_s);
        let soon: HashSet<_> = plan
            .ranked()
            .iter()
            .filter(|tile| tile.need == Need::Soon)
            .map(|tile| tile.address)
            .collect();
        // What a tile is inside its reach by, in lattice units, at the best place of the path.
        let leaf = f64::from(ground.lattice.node_size(0));
        let speed = path.velocity[0].abs().max(path.velocity[1].abs()).max(path.descent);
        let step = f64::from(speed * lookahead_s) / f64::from(STEPS) + 2.0;
        for tile in squares(&ground.index) {
            let reach = ground.reach(&path.lod, tile.level);
            let deepest = (0..=STEPS)
                .map(|at| {
                    let time_s = f64::from(lookahead_s) * f64::from(at) / f64::from(STEPS);
                    let moved = path.velocity.map(|speed| (f64::from(speed) * time_s) as i32);
                    let sunk = (f64::from(path.descent) * time_s) as i32;
                    let mut lod = path.lod;
                    lod.eye += IVec2::from(moved);
                    lod.floor = (lod.floor - sunk).max(0);
                    reach - ground.box_distance(&lod, tile, lod.planar)
                })
                .max()
                .expect("some steps");
            let is_now = ground.needs_now(&path.lod, tile) || tile.level == ground.lattice.root_level as u8;
            if is_now {
                prop_assert!(!soon.contains(&tile), "{tile} is needed now");
            } else if deepest as f64 > step {
                prop_assert!(soon.contains(&tile), "{tile} is {deepest} inside, {leaf} a leaf");
            } else if (deepest as f64) < -step {
                prop_assert!(!soon.contains(&tile), "{tile} is {deepest} outside");
            }
        }
    }

    #[test]
    fn what_is_forbidden_can_not_be_had_until_it_is_permitted(
        draw in draws(),
        steps in prop::collection::vec((any::<bool>(), 0..40_usize), 0..30),
    ) {
        let mut ground = Ground::new(&draw);
        let tiles = squares(&ground.index);
        for (forbids, at) in steps {
            let tile = tiles[at * 7 % tiles.len()];
            ground.forbidden.retain(|&other| other != tile);
            if forbids {
                ground.forbidden.push(tile);
                ground.available.forbid(tile);
            } else {
                ground.available.permit(tile);
            }
        }
        let can: Vec<_> = tiles.iter().filter(|&&tile| ground.can_be_had(tile)).collect();
        prop_assert_eq!(ground.available.count(), can.len());
        for &tile in &tiles {
            prop_assert_eq!(ground.available.has(tile), ground.can_be_had(tile), "{}", tile);
        }
    }

    #[test]
    fn what_is_resident_is_closed_towards_the_root(
        size in (2..2600_u32, 2..2600_u32),
        steps in prop::collection::vec((any::<bool>(), 0..6_u8, 0..4_u32, 0..4_u32), 0..200),
    ) {
        let index = TileIndex::new(&file([size.0, size.1]));
        let levels = index.levels().len() as u8;
        let mut tiles = ResidentTiles::new(&index);
        let mut twin = HashSet::new();
        for (inserts, level, x, z) in steps {
            let tile = TileAddress::new(level, x, z);
            if inserts {
                let fits = squares(&index).contains(&tile)
                    && (level + 1 == levels || twin.contains(&tile.parent()));
                prop_assert_eq!(tiles.insert(tile), fits);
                if fits {
                    twin.insert(tile);
                }
            } else {
                let mut children = tile.children().into_iter().flatten();
                let goes = twin.contains(&tile) && !children.any(|child| twin.contains(&child));
                prop_assert_eq!(tiles.remove(tile), goes);
                if goes {
                    twin.remove(&tile);
                }
            }
            prop_assert_eq!(tiles.count(), twin.len());
        }
        for tile in squares(&index) {
            prop_assert_eq!(tiles.contains(tile), twin.contains(&tile));
        }
    }
}

fn whole(size: (u32, u32)) -> Draw {
    Draw {
        size,
        leaf_level: 0,
        stored: vec![255],
        resident: vec![0],
        forbidden: Vec::new(),
        root_levels: 1,
        eyes: Vec::new(),
        pins: Vec::new(),
    }
}

fn eye_at(ground: &Ground, eye: IVec2, floor: i32, velocity: [f32; 2], descent: f32) -> EyePath {
    let lod = ViewLod::new(&ground.lattice, &LodSettings::default(), eye, floor, true);
    EyePath {
        lod: lod.expect("valid"),
        velocity,
        descent,
    }
}

#[test]
fn pinned_tiles_come_before_what_views_need() {
    let mut ground = Ground::whole([2561, 2561]);
    let leaf = ground.lattice.node_size(0);
    ground
        .eyes
        .push(eye_at(&ground, IVec2::splat(leaf), 0, [0.0; 2], 0.0));
    ground.pins.push(PinnedRegion {
        low: IVec2::splat(leaf * 15),
        high: IVec2::splat(leaf * 15 + 1),
        finest_level: 0,
    });
    // Root, the pin's four levels below it, and two more.
    let plan = planned(std::slice::from_ref(&ground), 8, 0.0);
    let needs: Vec<_> = plan.ranked().iter().map(|tile| tile.need).collect();
    let levels = ground.index.levels().len();
    assert_eq!(needs[0], Need::Root);
    assert!(
        needs[1..levels].iter().all(|need| *need == Need::Pinned),
        "{needs:?}"
    );
    assert!(needs[levels..].iter().all(|need| *need == Need::Now));
    assert_eq!(
        plan.ranked()[levels - 1].address,
        TileAddress::new(0, 15, 15)
    );
    assert!(plan.is_cut() && plan.eyes(0)[0].cut);
}

#[test]
fn every_level_loses_its_farthest_tiles_where_the_capacity_is_short() {
    let mut ground = Ground::whole([8193, 8193]);
    let leaf = ground.lattice.node_size(0);
    ground
        .eyes
        .push(eye_at(&ground, IVec2::splat(leaf * 31), 0, [0.0; 2], 0.0));
    let all = planned(std::slice::from_ref(&ground), usize::MAX, 0.0);
    let plan = planned(std::slice::from_ref(&ground), all.candidates() / 2, 0.0);
    let lod = &ground.eyes[0].lod;
    let in_tiles = |address: TileAddress| {
        let size = f64::from(ground.lattice.node_size(i32::from(address.level)));
        ground.box_distance(lod, address, true) as f64 / size
    };
    let kept: HashSet<_> = plan.ranked().iter().map(|tile| tile.address).collect();
    let farthest = kept.iter().map(|&tile| in_tiles(tile)).fold(0.0, f64::max);
    for tile in all.ranked().iter().map(|tile| tile.address) {
        // A step of the scale apart at most.
        assert!(kept.contains(&tile) || in_tiles(tile) * 1.02 + 0.02 >= farthest);
    }
}

#[test]
fn without_its_root_nothing_of_a_terrain_is_planned() {
    let mut ground = Ground::whole([1000, 1000]);
    ground
        .eyes
        .push(eye_at(&ground, IVec2::ZERO, 0, [0.0; 2], 0.0));
    let root = TileAddress::new(ground.index.levels().len() as u8 - 1, 0, 0);
    ground.available.forbid(root);
    let plan = planned(std::slice::from_ref(&ground), 100, 1.0);
    assert_eq!((plan.ranked().len(), plan.candidates()), (0, 0));
    assert_eq!(plan.eyes(0)[0].wanted_now, 0);
    ground.available.permit(root);
    assert!(planned(std::slice::from_ref(&ground), 100, 1.0).candidates() > 20);
    // Neither of no terrain at all.
    assert_eq!(planned(&[], 100, 1.0), Plan::default());
}

#[test]
fn roots_come_first_and_are_cut_coarse_before_fine() {
    let mut ground = Ground::whole([2000, 2000]);
    ground.root_levels = 3;
    let grounds = [ground, Ground::whole([3000, 300])];
    let plan = planned(&grounds, 7, 0.0);
    let levels: Vec<_> = plan
        .ranked()
        .iter()
        .map(|tile| (tile.terrain, tile.address.level))
        .collect();
    let expected = [(0, 4), (1, 5), (0, 3), (0, 3), (0, 3), (0, 3), (0, 2)];
    // The second terrain is wider, so its root is one level coarser.
    assert_eq!(grounds[1].index.levels().len(), 6);
    assert_eq!(levels, expected);
    assert!(plan.is_cut());
}

#[test]
fn eyes_beyond_all_measure_harm_nothing() {
    // The largest extent that the lattice holds: 2^30 units.
    let mut ground = Ground::whole([262_145, 1025]);
    assert_eq!(ground.lattice.extent.x, 1 << 30);
    let root = TileAddress::new(ground.index.levels().len() as u8 - 1, 0, 0);
    let ends = [
        IVec2::MIN,
        IVec2::MAX,
        IVec2::new(i32::MIN, i32::MAX),
        ground.lattice.extent,
    ];
    let speeds = [
        0.0,
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        f32::MAX,
        f32::MIN_POSITIVE,
    ];
    for eye in ends {
        for speed in speeds {
            for floor in [0, i32::MAX] {
                let mut path = eye_at(&ground, eye, floor, [speed, -speed], speed);
                ground.eyes = vec![path];
                for lookahead_s in [f32::NAN, -1.0, 0.0, 1e-30, 5.0, f32::INFINITY] {
                    let plan = planned(std::slice::from_ref(&ground), 50, lookahead_s);
                    assert_eq!(plan.ranked()[0].address, root);
                }
                // A view that nobody would make, with levels that reach less far than finer ones.
                path.lod.reach.reverse();
                path.lod.floor = -5;
                path.lod.planar = false;
                ground.eyes = vec![path];
                planned(std::slice::from_ref(&ground), 50, 3.0);
            }
        }
    }
    ground.eyes.clear();
    ground.pins = vec![PinnedRegion {
        low: IVec2::MIN,
        high: IVec2::MAX,
        finest_level: 9,
    }];
    let plan = planned(std::slice::from_ref(&ground), usize::MAX, 0.0);
    assert_eq!(plan.ranked().len(), 1 + 2 + 4);
}

#[test]
fn levels_short_counts_down_as_tiles_arrive() {
    let mut ground = Ground::whole([2561, 2561]);
    let lod = eye_at(&ground, IVec2::ZERO, 0, [0.0; 2], 0.0).lod;
    let levels = ground.index.levels().len() as u8;
    let short = |ground: &Ground| {
        let available: &Availability = &ground.available;
        levels_short(&ground.lattice, available, &ground.resident, &lod)
    };
    assert_eq!(short(&ground), levels);
    for level in (0..levels).rev() {
        for tile in squares(&ground.index) {
            if tile.level == level {
                assert!(ground.resident.insert(tile));
            }
        }
        assert_eq!(short(&ground), level);
    }
}
