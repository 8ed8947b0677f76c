use super::*;
use crate::lattice::LodSettings;
use crate::stream::Planner;
use crate::terrain::{ManifestFile, test_manifest_file};
use crate::tile::{TileIndex, TileRange};
use proptest::prelude::*;
use std::collections::HashSet;

const RANGE: TileRange = TileRange { min: 0, max: 9 };

/// A terrain that streams with loads that take no time.
struct Sim {
    lattice: Lattice,
    file: ManifestFile,
    index: TileIndex,
    planner: Planner,
    residency: Residency,
    missing: HashSet<TileAddress>,
    views: Vec<ViewLod>,
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
        let residency = Residency::new(&lattice, PageTable::new(&file), capacity);
        Self {
            lattice,
            file,
            index,
            planner: Planner::default(),
            residency,
            missing: HashSet::new(),
            views: Vec::new(),
        }
    }

    /// Looks from these places, given in samples.
    fn look(&mut self, eyes: &[[i32; 2]]) {
        let unit = 1 << self.lattice.unit_log2;
        let view = |&eye: &[i32; 2]| {
            let eye = IVec2::from(eye) * unit;
            let settings = LodSettings::default();
            ViewLod::new(&self.lattice, &settings, eye, 0, true).expect("defaults are fine")
        };
        self.views = eyes.iter().map(view).collect();
    }

    /// A frame in which every wanted tile has loaded, at most `activations` of which may come in.
    /// The tile at place `fails` of the plan turns out to be missing.
    fn frame(&mut self, levels: f32, activations: usize, fails: Option<usize>) {
        let capacity = self.residency.residents.len();
        let changed = self.planner.update(
            &self.lattice,
            &self.index,
            &self.missing,
            &self.views,
            capacity,
        );
        if changed {
            self.residency.apply_plan(self.planner.wanted());
        }
        self.residency.step(levels, &self.views);
        self.residency.free_faded(|_, _| {});
        let mut waiting = 0;
        for (rank, &address) in (0..).zip(self.planner.wanted()) {
            if self.residency.pages.get(address).is_some() {
                continue;
            }
            if Some(rank as usize) == fails && rank > 0 {
                self.missing.insert(address);
                self.planner.invalidate();
                break;
            }
            waiting += 1;
            if waiting > activations {
                break;
            }
            self.residency.activate(address, rank);
        }
        self.residency.make_room(waiting);
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
            let [columns, rows] = self.file.tiles(level as u8);
            let tile = p >> IVec2::splat(self.lattice.node_log2(level) as i32);
            let tile = tile.as_uvec2().min(UVec2::new(columns, rows) - 1);
            let address = TileAddress::new(level as u8, tile.x, tile.y);
            assert!(
                self.residency.pages.get(address).is_some(),
                "{p} reads level {finest}, but {address} is not resident"
            );
        }
    }

    fn settle(&mut self) {
        for _ in 0..10_000 {
            self.frame(0.5, 64, None);
            let wanted = self.planner.wanted();
            let pages = &self.residency.pages;
            let complete = wanted.iter().all(|&tile| pages.get(tile).is_some());
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
        let points: Vec<_> = (0..61 * 61)
            .map(|at| IVec2::new(at % 61, at / 61) * (41 << sim.lattice.unit_log2))
            .collect();
        let read = |sim: &Sim| -> Vec<i32> {
            let level = |&p: &IVec2| {
                let detail = finest_detail(&sim.lattice, &sim.views[0], p, p);
                detail.max(sim.residency.field.at(p))
            };
            points.iter().map(level).collect()
        };
        for (x, z) in eyes {
            sim.look(&[[x, z]]);
            let mut before = read(&sim);
            for _ in 0..60 {
                sim.frame(0.1, 5, None);
                let now = read(&sim);
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
    assert!(sim.planner.wanted().len() < 20);
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
    sim.residency.make_room(400);
    for _ in 0..8 {
        sim.residency.step(0.0, &sim.views);
        sim.residency.free_faded(|_, _| {});
        sim.residency.make_room(400);
        sim.check();
    }
    assert!(resident > 20);
    assert!(sim.residency.resident_count() <= sim.planner.wanted().len());
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
    sim.residency.make_room(400);
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
    let wanted = sim.planner.wanted();
    assert_eq!(wanted.len(), 150);
    assert!(sim.planner.is_truncated());
    let mut seen = HashSet::new();
    for &tile in wanted {
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
fn a_still_eye_costs_no_new_plan() {
    let mut sim = Sim::new([3000, 3000], 50, |_| true);
    sim.look(&[[500, 500]]);
    let update = |sim: &mut Sim| {
        sim.planner
            .update(&sim.lattice, &sim.index, &sim.missing, &sim.views, 50)
    };
    assert!(update(&mut sim));
    assert!(!update(&mut sim));
    sim.look(&[[515, 500]]);
    assert!(!update(&mut sim), "15 of 128 samples");
    sim.look(&[[517, 500]]);
    assert!(update(&mut sim));
    sim.look(&[[517, 500], [0, 0]]);
    assert!(update(&mut sim), "a second view");
}

#[test]
fn a_tile_becomes_resident_only_once_on_a_free_page_under_its_parent() {
    let mut sim = Sim::new([500, 500], 3, |_| true);
    let root = TileAddress::new(2, 0, 0);
    let [near, far, ..] = root.children().expect("not a leaf");
    let residency = &mut sim.residency;
    assert_eq!(residency.activate(near, 1), None, "before its parent");
    assert_eq!(residency.activate(root, 0), Some(0));
    assert_eq!(residency.activate(root, 0), None, "twice");
    let beyond = TileAddress::new(1, 2, 0);
    assert_eq!(residency.activate(beyond, 0), None, "beyond the terrain");
    assert_eq!(residency.activate(near, 1), Some(1));
    assert_eq!(residency.activate(far, 2), Some(2));
    let leaf = TileAddress::new(0, 0, 0);
    assert_eq!(residency.activate(leaf, 3), None, "no page is free");
    sim.check();
}
