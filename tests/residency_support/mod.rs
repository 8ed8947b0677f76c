//! Terrains, eyes and pins drawn at random, and what is needed of them by definition.
#![allow(dead_code, reason = "each test uses a part")]

use bevy_tessera::density::DensitySettings;
use bevy_tessera::lattice::{Lattice, LodSettings, ViewLod};
use bevy_tessera::residency::{
    Availability, EyePath, Need, PinnedRegion, PlanTerrain, Ranked, ResidentTiles,
};
use bevy_tessera::terrain::{MANIFEST_MAGIC, MANIFEST_VERSION, ManifestFile};
use bevy_tessera::tile::{TileAddress, TileIndex, TileRange};
use glam::IVec2;
use proptest::prelude::*;

/// How a terrain is drawn.
#[derive(Clone, Debug)]
pub struct Draw {
    pub size: (u32, u32),
    pub leaf_level: i32,
    /// Luck of each tile, in turn: few low ones are not stored.
    pub stored: Vec<u8>,
    /// The same for being resident.
    pub resident: Vec<u8>,
    pub forbidden: Vec<(u8, u32, u32)>,
    pub root_levels: u8,
    pub eyes: Vec<EyeDraw>,
    pub pins: Vec<(f64, f64, f64, f64, u8)>,
}

/// How an eye is drawn: lengths in leaf tiles.
#[derive(Clone, Debug)]
pub struct EyeDraw {
    pub at: (f64, f64),
    /// Put on a line between half tiles.
    pub snaps: bool,
    pub floor: f64,
    pub planar: bool,
    pub reach: f32,
    pub velocity: (f32, f32),
    pub descent: f32,
}

pub fn speeds() -> impl Strategy<Value = f32> {
    prop_oneof![
        2 => Just(0.0_f32),
        6 => -8.0..8.0_f32,
        2 => (-8..8_i8).prop_map(f32::from),
        1 => prop_oneof![Just(f32::NAN), Just(f32::INFINITY), Just(-1e30), Just(1e-30)],
    ]
}

pub fn eyes() -> impl Strategy<Value = EyeDraw> {
    (
        (-12.0..30.0, -12.0..30.0),
        any::<bool>(),
        prop_oneof![2 => Just(0.0), 2 => 0.0..6.0, 1 => 0.0..80.0],
        prop::bool::weighted(0.85),
        prop_oneof![Just(4.0_f32), Just(5.3), Just(8.0)],
        (speeds(), speeds()),
        speeds(),
    )
        .prop_map(
            |(at, snaps, floor, planar, reach, velocity, descent)| EyeDraw {
                at,
                snaps,
                floor,
                planar,
                reach,
                velocity,
                descent,
            },
        )
}

pub fn draws() -> impl Strategy<Value = Draw> {
    (
        (2..2600_u32, 2..2600_u32),
        -1..=0,
        prop::collection::vec(any::<u8>(), 1..70),
        prop::collection::vec(any::<u8>(), 1..70),
        prop::collection::vec((0..5_u8, 0..20_u32, 0..20_u32), 0..3),
        0..4_u8,
        prop::collection::vec(eyes(), 0..4),
        prop::collection::vec(
            (-3.0..23.0, -3.0..23.0, -1.0..9.0, -1.0..9.0, 0..6_u8),
            0..3,
        ),
    )
        .prop_map(
            |(size, leaf_level, stored, resident, forbidden, root_levels, eyes, pins)| Draw {
                size,
                leaf_level,
                stored,
                resident,
                forbidden,
                root_levels,
                eyes,
                pins,
            },
        )
}

/// A terrain that can be planned for.
pub struct Ground {
    pub lattice: Lattice,
    pub index: TileIndex,
    pub forbidden: Vec<TileAddress>,
    pub available: Availability,
    pub resident: ResidentTiles,
    pub eyes: Vec<EyePath>,
    pub pins: Vec<PinnedRegion>,
    pub root_levels: u8,
}

pub fn file(size: [u32; 2]) -> ManifestFile {
    ManifestFile {
        format: MANIFEST_MAGIC.to_owned(),
        version: MANIFEST_VERSION,
        size,
        spacing_m: 1.0,
        height_min_m: 0.0,
        height_step_m: 0.1,
        levels: ManifestFile::levels_for(size),
        density: DensitySettings::default(),
        index_crc32: 0,
    }
}

/// All tiles that an index has room for, the coarsest level first.
pub fn squares(index: &TileIndex) -> Vec<TileAddress> {
    let levels = index.levels().iter().zip(0..18_u8);
    let levels = levels.collect::<Vec<_>>().into_iter().rev();
    levels
        .flat_map(|(level, number)| {
            let [columns, rows] = level.tiles();
            (0..columns * rows).map(move |at| TileAddress::new(number, at % columns, at / columns))
        })
        .collect()
}

impl Ground {
    pub fn whole(size: [u32; 2]) -> Self {
        Self::new(&Draw {
            size: size.into(),
            leaf_level: 0,
            stored: vec![255],
            resident: vec![0],
            forbidden: Vec::new(),
            root_levels: 1,
            eyes: Vec::new(),
            pins: Vec::new(),
        })
    }

    pub fn new(draw: &Draw) -> Self {
        let size = [draw.size.0, draw.size.1];
        let file = file(size);
        let lattice = Lattice::new(size, file.levels, draw.leaf_level, 8).expect("fits");
        let mut index = TileIndex::new(&file);
        let mut luck = draw.stored.iter().cycle();
        for address in squares(&index) {
            let is_stored = *luck.next().expect("some luck") > 12;
            index.set(address, is_stored.then_some(TileRange { min: 1, max: 2 }));
        }
        let mut available = Availability::new(&index);
        let forbidden: Vec<_> = draw
            .forbidden
            .iter()
            .map(|&(level, x, z)| TileAddress::new(level, x, z))
            .collect();
        for &address in &forbidden {
            available.forbid(address);
        }
        let mut resident = ResidentTiles::new(&index);
        let mut luck = draw.resident.iter().cycle();
        for address in squares(&index) {
            if *luck.next().expect("some luck") > 90 && available.has(address) {
                resident.insert(address);
            }
        }
        let leaf = f64::from(lattice.node_size(0));
        let units = |tiles: f64| (tiles * leaf) as i32;
        let pins = draw.pins.iter().map(|&(x, z, width, depth, finest_level)| {
            let low = IVec2::new(units(x), units(z));
            PinnedRegion {
                low,
                high: low + IVec2::new(units(width), units(depth)),
                finest_level,
            }
        });
        Self {
            eyes: draw.eyes.iter().map(|eye| eye.path(&lattice)).collect(),
            pins: pins.collect(),
            lattice,
            index,
            forbidden,
            available,
            resident,
            root_levels: draw.root_levels,
        }
    }

    pub fn terrain(&self) -> PlanTerrain<'_> {
        PlanTerrain {
            lattice: &self.lattice,
            available: &self.available,
            resident: &self.resident,
            eyes: &self.eyes,
            pins: &self.pins,
            root_levels: self.root_levels,
        }
    }

    /// Whether a tile can be had, by definition.
    pub fn can_be_had(&self, address: TileAddress) -> bool {
        (address.level..self.index.levels().len() as u8).all(|level| {
            let ancestor = address.ancestor(level).expect("coarser");
            self.index.get(ancestor).is_some() && !self.forbidden.contains(&ancestor)
        })
    }

    pub fn bounds(&self, address: TileAddress) -> [[i64; 2]; 2] {
        let size = i64::from(self.lattice.node_size(i32::from(address.level)));
        let extent = [self.lattice.extent.x, self.lattice.extent.y].map(i64::from);
        let low = [address.x, address.z].map(|at| i64::from(at) * size);
        let high = [0, 1].map(|axis| (low[axis] + size).min(extent[axis]));
        [low, high]
    }

    pub fn reach(&self, lod: &ViewLod, level: u8) -> i64 {
        let reach = lod.reach[self.lattice.level_index(i32::from(level))];
        if reach == i32::MAX {
            i64::MAX / 4
        } else {
            i64::from(reach)
        }
    }

    pub fn box_distance(&self, lod: &ViewLod, address: TileAddress, planar: bool) -> i64 {
        let [low, high] = self.bounds(address);
        let at = [lod.eye.x, lod.eye.y].map(i64::from);
        let mut distance = i64::from(lod.floor);
        if planar {
            for axis in [0, 1] {
                distance = distance
                    .max(low[axis] - at[axis])
                    .max(at[axis] - high[axis]);
            }
        }
        distance
    }

    pub fn needs_now(&self, lod: &ViewLod, address: TileAddress) -> bool {
        self.box_distance(lod, address, lod.planar) < self.reach(lod, address.level)
    }

    /// When an eye on its path comes to need a tile that it doesn't need now.
    pub fn needed_in_s(&self, eye: &EyePath, address: TileAddress, horizon_s: f64) -> Option<f64> {
        let reach = self.reach(&eye.lod, address.level);
        let [low, high] = self.bounds(address);
        let at = [eye.lod.eye.x, eye.lod.eye.y].map(i64::from);
        let (mut from_s, mut until_s) = (0.0_f64, horizon_s);
        let limit = f64::from(1_u32 << 31);
        let speed = |speed: f32| match f64::from(speed) {
            speed if speed.is_nan() => 0.0,
            speed => speed.clamp(-limit, limit),
        };
        if eye.lod.planar {
            for axis in [0, 1] {
                let speed = speed(eye.velocity[axis]);
                let ahead = [
                    (low[axis] - reach - at[axis]) as f64,
                    (high[axis] + reach - at[axis]) as f64,
                ];
                if speed == 0.0 {
                    if ahead[0] >= 0.0 || ahead[1] <= 0.0 {
                        return None;
                    }
                    continue;
                }
                let times = ahead.map(|ahead| ahead / speed);
                from_s = from_s.max(times[0].min(times[1]));
                until_s = until_s.min(times[0].max(times[1]));
            }
        }
        let floor = i64::from(eye.lod.floor);
        if floor >= reach {
            if speed(eye.descent) <= 0.0 {
                return None;
            }
            from_s = from_s.max((floor - reach) as f64 / speed(eye.descent));
        }
        (from_s < until_s).then_some(from_s)
    }

    pub fn is_pinned(&self, address: TileAddress) -> bool {
        let [low, high] = self.bounds(address);
        let extent = [self.lattice.extent.x, self.lattice.extent.y].map(i64::from);
        self.pins.iter().any(|pin| {
            let from = [pin.low.x, pin.low.y].map(i64::from);
            let to = [pin.high.x, pin.high.y].map(i64::from);
            address.level >= pin.finest_level
                && (0..2).all(|axis| {
                    // The terrain's last line belongs to its last tiles.
                    let end = high[axis] + i64::from(high[axis] == extent[axis]);
                    from[axis] < to[axis] && from[axis] < end && to[axis] > low[axis]
                })
        })
    }

    /// Why a tile is needed, and its place among those needed for the same reason.
    pub fn need(&self, address: TileAddress, lookahead_s: f32) -> Option<(Need, u32)> {
        let depth = self.index.levels().len() as u8 - 1 - address.level;
        if depth < self.root_levels.max(1) {
            return Some((Need::Root, u32::from(depth)));
        }
        if self.is_pinned(address) {
            return Some((Need::Pinned, u32::from(depth)));
        }
        let is_resident = self.resident.contains(address);
        let nearer = |key: i64| if is_resident { key - key / 8 } else { key };
        let size = i64::from(self.lattice.node_size(i32::from(address.level)));
        let now = self
            .eyes
            .iter()
            .filter(|eye| self.needs_now(&eye.lod, address))
            .map(|eye| self.box_distance(&eye.lod, address, true).max(0) * 1024 / size)
            .min();
        if let Some(distance) = now {
            let distance = distance.min((1 << 30) - 1);
            let steps = ((nearer(distance) + 1024) as f32).to_bits() >> 16;
            return Some((Need::Now, steps));
        }
        let horizon_s = f64::from(lookahead_s.max(0.0));
        let soon = self
            .eyes
            .iter()
            .filter_map(|eye| self.needed_in_s(eye, address, horizon_s))
            .min_by(f64::total_cmp)?;
        let parts = f64::from(1 << 24);
        let key = ((soon * (parts / horizon_s)) as i64).min((1 << 24) - 1);
        Some((Need::Soon, (nearer(key) >> 13) as u32))
    }

    /// How many levels a tile is short, by definition.
    pub fn short(&self, address: TileAddress) -> u8 {
        let levels = self.index.levels().len() as u8;
        (address.level..levels)
            .find(|&level| {
                let ancestor = address.ancestor(level).expect("coarser");
                self.resident.contains(ancestor)
            })
            .unwrap_or(levels)
            - address.level
    }
}

impl EyeDraw {
    pub fn path(&self, lattice: &Lattice) -> EyePath {
        let leaf = f64::from(lattice.node_size(0));
        let mut at = [self.at.0, self.at.1];
        if self.snaps {
            at = at.map(|at| (at * 2.0).round() / 2.0);
        }
        let eye = IVec2::from(at.map(|at| (at * leaf) as i32));
        let settings = LodSettings {
            reach: self.reach,
            morph: 1.0,
        };
        let floor = (self.floor * leaf) as i32;
        let lod = ViewLod::new(lattice, &settings, eye, floor, self.planar);
        EyePath {
            lod: lod.expect("valid"),
            velocity: [self.velocity.0, self.velocity.1].map(|speed| speed * leaf as f32),
            descent: self.descent * leaf as f32,
        }
    }
}

/// All that is needed, ranked by definition.
pub fn reference(grounds: &[Ground], lookahead_s: f32) -> Vec<Ranked> {
    let mut all = Vec::new();
    for (terrain, ground) in (0..).zip(grounds) {
        for address in squares(&ground.index) {
            if ground.can_be_had(address)
                && let Some((need, place)) = ground.need(address, lookahead_s)
            {
                let depth = ground.index.levels().len() - usize::from(address.level);
                let order = (need, place, depth, terrain, address.z, address.x);
                let ranked = Ranked {
                    terrain,
                    address,
                    need,
                };
                all.push((order, ranked));
            }
        }
    }
    all.sort_by_key(|(order, _)| *order);
    all.into_iter().map(|(_, ranked)| ranked).collect()
}
