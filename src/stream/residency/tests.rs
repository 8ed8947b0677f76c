use super::*;
use crate::lattice::LodSettings;
use crate::residency::{Availability, EyePath, PlanTerrain, Planner};
use crate::stream::pool::PagePool;
use crate::terrain::{TerrainManifest, test_manifest_file};
use crate::tile::{TileIndex, TileRange};
use proptest::prelude::*;
use std::collections::HashSet;

const RANGE: TileRange = TileRange { min: 0, max: 9 };
/// Who holds the pages.
const INSTANCE: u64 = 1;

/// A terrain that streams with loads that take no time.
struct Sim {
    lattice: Lattice,
    manifest: TerrainManifest,
    available: Availability,
    planner: Planner,
    plan: u64,
    pool: PagePool,
    residency: Residency,
    eyes: Vec<EyePath>,
    views: Vec<FadeView>,
}

impl Sim {
    /// `stored` says which tiles besides the root exist.
    fn new(size: [u32; 2], capacity: u32, stored: impl Fn(TileAddress) -> bool) -> Self {
        let file = test_manifest_file(size);
        let lattice = Lattice::new(size, file.levels, 0, 8).expect("fits");
        let mut index = TileIndex::new(&file);
        for level in 0..file.levels {
            let [columns, rows] = file.tiles(level);
            for z in 0..rows {
                for x in 0..columns {
                    let address = TileAddress::new(level, x, z);
                    let is_stored = level + 1 == file.levels || stored(address);
                    index.set(address, is_stored.then_some(RANGE));
                }
            }
        }
        let manifest = TerrainManifest { file, index };
        let mut residency = Residency::new(&lattice, &manifest);
        // What these tests look at is a terrain that is seen from the beginning.
        residency.is_appearing = false;
        let mut pool = PagePool::default();
        pool.set_limit(capacity);
        Self {
            lattice,
            available: Availability::new(&manifest.index),
            manifest,
            planner: Planner::default(),
            plan: 0,
            pool,
            residency,
            eyes: Vec::new(),
            views: Vec::new(),
        }
    }

    /// Looks from these places, given in samples.
    fn look(&mut self, eyes: &[[i32; 2]]) {
        let unit = 1 << self.lattice.unit_log2;
        let lods = eyes.iter().map(|&eye| {
            let eye = IVec2::from(eye) * unit;
            let settings = LodSettings::default();
            ViewLod::new(&self.lattice, &settings, eye, 0, true).expect("defaults are fine")
        });
        let lods: Vec<_> = lods.collect();
        self.eyes = lods
            .iter()
            .map(|&lod| EyePath {
                lod,
                velocity: [0.0; 2],
                descent: 0.0,
            })
            .collect();
        self.views = lods
            .iter()
            .map(|&lod| FadeView {
                lod,
                unit_m: 1.0 / unit as f32,
                focal_px: 0.0,
                px_per_m: 0.0,
            })
            .collect();
    }

    fn wanted(&self) -> Vec<TileAddress> {
        let ranked = self.planner.latest().ranked().iter();
        ranked.map(|ranked| ranked.address).collect()
    }

    fn fade(&mut self, levels: f32) {
        let fade = Fade {
            levels,
            max_px: f32::INFINITY,
        };
        self.residency.step(fade, &self.views, |_, _, _| 0.0);
    }

    fn free_faded(&mut self) {
        let pool = &mut self.pool;
        self.residency.free_faded(|page, _| pool.give_back(page));
    }

    fn activate(&mut self, address: TileAddress, rank: u32) -> Option<u32> {
        let pool = &mut self.pool;
        self.residency
            .activate(address, rank, || pool.take(INSTANCE))
    }

    /// Sends off tiles that nobody wants until so many pages are free or will be.
    fn make_room(&mut self, wanted: usize) {
        while self.pool.free_count() + self.residency.leaving_count() < wanted
            && let Some((.., page)) = self.residency.first_to_go()
        {
            self.residency.send_off(page);
        }
    }

    fn plan(&mut self) {
        self.plan += 1;
        let terrain = PlanTerrain {
            lattice: &self.lattice,
            available: &self.available,
            resident: &self.residency.resident,
            eyes: &self.eyes,
            pins: &[],
            root_levels: 1,
        };
        let capacity = self.pool.limit() as usize;
        self.planner.plan(&[terrain], capacity, 0.0);
        let wanted = self.wanted();
        self.residency
            .apply_plan(self.plan, wanted.into_iter().zip(0..));
    }

    /// A frame in which every wanted tile has loaded, at most `activations` of which may come in.
    /// The tile at place `fails` of the plan turns out to be missing.
    fn frame(&mut self, levels: f32, activations: usize, fails: Option<usize>) {
        self.plan();
        self.fade(levels);
        self.free_faded();
        let mut waiting = 0;
        for (rank, address) in (0..).zip(self.wanted()) {
            if self.residency.pages.get(address).is_some() {
                continue;
            }
            if Some(rank as usize) == fails && rank > 0 {
                self.available.forbid(address);
                break;
            }
            waiting += 1;
            if waiting > activations {
                break;
            }
            self.activate(address, rank);
        }
        self.make_room(waiting);
    }

    fn check(&self) {
        if let Err(broken) = self.residency.validate() {
            panic!("{broken}");
        }
    }

    /// Checks a lattice point against the field as it is read: the level that it gives and all
    /// coarser ones are resident there.
    fn check_point(&self, p: IVec2) {
        let finest = self.residency.field.at(p) >> 8;
        for level in finest..self.lattice.root_level {
            let [columns, rows] = self.manifest.file.tiles(level as u8);
            let tile = p >> IVec2::splat(self.lattice.node_log2(level) as i32);
            let tile = tile.as_uvec2().min(UVec2::new(columns, rows) - 1);
            let address = TileAddress::new(level as u8, tile.x, tile.y);
            assert!(
                self.residency.pages.get(address).is_some(),
                "{p} reads level {finest}, but {address} is not resident"
            );
        }
    }

    /// Places all over a terrain of 2500 samples a side.
    fn places(&self) -> Vec<IVec2> {
        (0..61 * 61)
            .map(|at| IVec2::new(at % 61, at / 61) * (41 << self.lattice.unit_log2))
            .collect()
    }

    /// The levels that the first view reads there, 8.8.
    fn levels_at(&self, places: &[IVec2]) -> Vec<i32> {
        let level = |&p: &IVec2| {
            let detail = finest_detail(&self.lattice, &self.views[0].lod, p, p);
            detail.max(self.residency.field.at(p))
        };
        places.iter().map(level).collect()
    }

    fn settle(&mut self) {
        for _ in 0..10_000 {
            self.frame(0.5, 64, None);
            let pages = &self.residency.pages;
            let mut wanted = self.wanted().into_iter();
            let complete = wanted.all(|tile| pages.get(tile).is_some());
            if complete && self.residency.is_still() {
                return;
            }
        }
        panic!("streaming never comes to rest");
    }
}

fn luck(address: TileAddress, seed: u32) -> u32 {
    let mixed = (address.x ^ address.z.rotate_left(11) ^ (u32::from(address.level) << 27) ^ seed)
        .wrapping_mul(0x9e37_79b1);
    (mixed ^ (mixed >> 15)).wrapping_mul(0x85eb_ca77) >> 16
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 60, ..ProptestConfig::default() })]

    /// Random flights, teleports and all, with too few pages and holes in the terrain.
    #[test]
    fn nothing_is_read_that_is_not_resident(
        size in (2u32..3000, 2u32..3000),
        capacity in 1u32..120,
        seed in any::<u32>(),
        holes in 0u32..20_000,
        eyes in prop::collection::vec((-500..3500, -500..3500, 0..4u8, 0f32..0.4), 5..40),
    ) {
        let mut sim = Sim::new([size.0, size.1], capacity, |tile| luck(tile, seed) >= holes);
        let mut at = [0, 0];
        for (x, z, kind, levels) in eyes {
            match kind {
                // A teleport, a second pair of eyes, a glide, and nobody there at all.
                0 => { at = [x, z]; sim.look(&[at]); }
                1 => sim.look(&[at, [x, z]]),
                2 => { at = [at[0] + x / 20, at[1] + z / 20]; sim.look(&[at]); }
                _ => sim.look(&[]),
            }
            for frame in 0..8 {
                let fails = (luck(TileAddress::new(0, frame, x.unsigned_abs()), seed) < 2000).then_some(3);
                sim.frame(levels, 6, fails);
                sim.check();
                let p = IVec2::new(x + 37 * frame as i32, z) * (1 << sim.lattice.unit_log2);
                sim.check_point(sim.lattice.clamp(p));
                sim.check_point(sim.lattice.extent);
            }
        }
    }

    /// The same where several leaf tiles share a cell of the field.
    #[test]
    fn shared_cells_read_only_what_all_their_tiles_have(
        seed in any::<u32>(),
        capacity in 20u32..200,
        eyes in prop::collection::vec(0..380_000, 2..8),
    ) {
        let mut sim = Sim::new([128 * 2900, 128 * 5], capacity, |tile| luck(tile, seed) >= 6000);
        prop_assert!(sim.residency.cell_level() >= 2);
        for x in eyes {
            sim.look(&[[x, 300]]);
            for step in 0..12 {
                sim.frame(0.3, 20, None);
                sim.check();
                let p = IVec2::new(x + 61 * step, 11 * step) * (1 << sim.lattice.unit_log2);
                sim.check_point(sim.lattice.clamp(p));
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// While the eyes stand still, the level that is read anywhere changes no faster than the
    /// fade, however many tiles come and go: corners jump only where nobody can see it.
    #[test]
    fn nothing_pops_in_view(
        capacity in 20u32..120,
        eyes in prop::collection::vec((0..2500, 0..2500), 2..5),
    ) {
        let mut sim = Sim::new([2500, 2500], capacity, |_| true);
        let points = sim.places();
        for (x, z) in eyes {
            sim.look(&[[x, z]]);
            let mut before = sim.levels_at(&points);
            for _ in 0..60 {
                sim.frame(0.1, 5, None);
                let now = sim.levels_at(&points);
                for ((a, b), p) in before.iter().zip(&now).zip(&points) {
                    prop_assert!((a - b).abs() <= 27, "{p}: {a} to {b} in a tenth of a level");
                }
                before = now;
            }
        }
    }
}

#[test]
fn detail_arrives_under_the_eye_and_comes_to_rest() {
    let mut sim = Sim::new([2000, 1500], 400, |_| true);
    let unit = 1 << sim.lattice.unit_log2;
    let eye = IVec2::new(700, 600) * unit;
    sim.look(&[[700, 600]]);
    sim.settle();
    sim.check();
    assert_eq!(sim.residency.field.at(eye), 0);
    // 2 000 samples away, level 0 doesn't reach.
    sim.look(&[[-9000, -9000]]);
    sim.settle();
    assert!(sim.wanted().len() < 20);
    assert_eq!(
        sim.residency.field.at(eye),
        0,
        "what is resident stays while there is room"
    );
}

#[test]
fn a_tile_fades_in_and_out_in_view_at_the_rate_asked_for() {
    // One leaf only: the far corner of the terrain has level 0, all else level 1.
    let leaf = TileAddress::new(0, 0, 0);
    let mut sim = Sim::new([257, 257], 2, |tile| tile == leaf);
    sim.look(&[[30, 30]]);
    sim.frame(0.0, 9, None);
    let eye = IVec2::splat(30 << sim.lattice.unit_log2);
    assert_eq!(
        sim.residency.field.at(eye),
        256,
        "the tile is there, the detail is not yet"
    );
    let mut last = 256;
    let mut frames = 0;
    while sim.residency.field.at(eye) > 0 && frames < 100 {
        sim.frame(0.1, 9, None);
        sim.check();
        let now = sim.residency.field.at(eye);
        assert!(
            now <= last && last - now <= 26,
            "{last} to {now} in a tenth of a level"
        );
        last = now;
        frames += 1;
        if sim.residency.is_still() {
            break;
        }
    }
    // The leaf's inner corner has three coarse neighbours and stays at level 1.
    assert_eq!(sim.residency.field.corners[0], 0);
    assert!((9..=12).contains(&frames), "{frames}");
}

#[test]
fn where_nobody_looks_detail_changes_at_once() {
    let mut sim = Sim::new([2000, 2000], 400, |_| true);
    sim.look(&[[100, 100]]);
    sim.settle();
    let resident = sim.residency.resident_count();
    sim.look(&[[100_000, 100_000]]);
    sim.frame(0.0, 9, None);
    sim.make_room(400);
    for _ in 0..8 {
        sim.fade(0.0);
        sim.free_faded();
        sim.make_room(400);
        sim.check();
    }
    assert!(resident > 20);
    assert!(sim.residency.resident_count() <= sim.wanted().len());
}

#[test]
fn a_leaving_tile_that_is_wanted_again_stays() {
    let mut sim = Sim::new([2000, 2000], 400, |_| true);
    sim.look(&[[1000, 1000]]);
    sim.settle();
    let before = sim.residency.resident_count();
    let field = sim.residency.field.clone();
    sim.look(&[]);
    sim.frame(0.0, 9, None);
    // A view appears in the same moment in which room is made.
    sim.make_room(400);
    assert!(!sim.residency.leaving.is_empty());
    sim.look(&[[1000, 1000]]);
    sim.frame(0.01, 9, None);
    sim.check();
    assert!(sim.residency.leaving.is_empty());
    assert_eq!(sim.residency.resident_count(), before);
    sim.settle();
    assert_eq!(sim.residency.field, field);
}

#[test]
fn parents_are_planned_before_their_children_and_detail_is_cut_evenly() {
    let mut sim = Sim::new([16_384, 16_384], 150, |_| true);
    sim.look(&[[8000, 9000]]);
    sim.frame(0.1, 9, None);
    let wanted = sim.wanted();
    assert_eq!(wanted.len(), 150);
    assert!(sim.planner.latest().is_cut());
    let mut seen = HashSet::new();
    for &tile in &wanted {
        let is_root = i32::from(tile.level) == sim.lattice.root_level;
        assert!(
            is_root || seen.contains(&tile.parent()),
            "{tile} before its parent"
        );
        seen.insert(tile);
    }
    // Each level keeps as many tiles around the eye as the next, the coarsest ones aside.
    let count = |level| wanted.iter().filter(|tile| tile.level == level).count();
    for level in 0..4 {
        assert!(count(level).abs_diff(count(level + 1)) <= 12, "{wanted:?}");
    }
    // The eye's own leaf is there, however few pages.
    assert!(seen.contains(&TileAddress::new(0, 8000 / 128, 9000 / 128)));
}

#[test]
fn without_views_only_the_root_is_wanted() {
    let mut sim = Sim::new([3000, 3000], 50, |_| true);
    sim.look(&[]);
    sim.settle();
    assert_eq!(sim.residency.resident_count(), 1);
}

#[test]
fn a_tile_becomes_resident_only_once_on_a_free_page_under_its_parent() {
    let mut sim = Sim::new([500, 500], 3, |_| true);
    let root = TileAddress::new(2, 0, 0);
    let [near, far, ..] = root.children().expect("not a leaf");
    assert_eq!(sim.activate(near, 1), None, "before its parent");
    assert_eq!(sim.activate(root, 0), Some(0));
    assert_eq!(sim.activate(root, 0), None, "twice");
    let beyond = TileAddress::new(1, 2, 0);
    assert_eq!(sim.activate(beyond, 0), None, "beyond the terrain");
    assert_eq!(sim.activate(near, 1), Some(1));
    assert_eq!(sim.activate(far, 2), Some(2));
    let leaf = TileAddress::new(0, 0, 0);
    assert_eq!(sim.activate(leaf, 3), None, "no page is free");
    sim.check();
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// However tiles come and go, and however rough the ground is, what is drawn anywhere moves by no
    /// more pixels a frame than asked for, as far as the slowest fade allows.
    #[test]
    fn the_ground_moves_no_faster_on_the_screen_than_asked_for(
        capacity in 20u32..120,
        eyes in prop::collection::vec((0..2500, 0..2500), 2..4),
        rise_m in 0.05f32..3.0,
    ) {
        const MAX_PX: f32 = 0.2;
        const LEVELS: f32 = 4.0 / 60.0;
        let mut sim = Sim::new([2500, 2500], capacity, |_| true);
        let points = sim.places();
        for (x, z) in eyes {
            sim.look(&[[x, z]]);
            for view in &mut sim.views {
                view.focal_px = 900.0;
            }
            let mut before = sim.levels_at(&points);
            for _ in 0..60 {
                sim.plan();
                let fade = Fade { levels: LEVELS, max_px: MAX_PX };
                sim.residency.step(fade, &sim.views, |_, _, _| rise_m);
                sim.free_faded();
                let missing: Vec<_> = (0..)
                    .zip(sim.wanted())
                    .filter(|&(_, tile)| sim.residency.pages.get(tile).is_none())
                    .take(5)
                    .collect();
                for &(rank, tile) in &missing {
                    sim.activate(tile, rank);
                }
                sim.make_room(missing.len());
                let now = sim.levels_at(&points);
                for ((a, b), &p) in before.iter().zip(&now).zip(&points) {
                    let level_px = sim.views[0].pixels(rise_m, p, p);
                    let levels = (a - b).abs() as f32 / 256.0;
                    // A unit for the rounding of the field, one for that of the step.
                    let most = (MAX_PX / level_px).clamp(LEVELS / 32.0, LEVELS) + 2.0 / 256.0;
                    prop_assert!(levels <= most, "{p}: {levels} levels of {level_px} px");
                }
                before = now;
            }
        }
    }
}
