//! Regions that are kept resident, and how far they are.

use super::TerrainState;
use crate::lattice::Lattice;
use crate::residency::PinnedRegion;
use crate::terrain::{Terrain, TerrainPinReady};
use crate::tile::{TILE_SAMPLES, TileAddress};
use bevy::math::IVec2;
use bevy::prelude::*;

/// A rectangle of a terrain, in metres of its own x and z.
#[derive(Clone, Copy, Debug, PartialEq, Reflect)]
#[reflect(Debug, Clone, PartialEq)]
pub struct TerrainRegion {
    /// Corner with the least x and z.
    pub min_m: Vec2,
    /// Corner with the greatest x and z.
    pub max_m: Vec2,
}

impl TerrainRegion {
    /// The whole terrain, however large.
    pub const EVERYTHING: Self = Self {
        min_m: Vec2::NEG_INFINITY,
        max_m: Vec2::INFINITY,
    };

    /// The square around a place that holds the circle of `radius_m` metres.
    #[must_use]
    pub fn around(centre_m: Vec2, radius_m: f32) -> Self {
        Self {
            min_m: centre_m - radius_m,
            max_m: centre_m + radius_m,
        }
    }

    /// The lattice points within, half-open; `None` where the terrain has none of them.
    fn on(&self, lattice: &Lattice, spacing_m: f64) -> Option<(IVec2, IVec2)> {
        let extent = lattice.extent.as_dvec2();
        let units = lattice.unit_m(spacing_m);
        let [low, high] = [self.min_m, self.max_m].map(|at| at.as_dvec2() / units);
        // Not a number compares with nothing.
        let meets = low.cmple(extent).all() && high.cmpge(bevy::math::DVec2::ZERO).all();
        if !meets || !low.cmple(high).all() {
            return None;
        }
        let low = low
            .clamp(bevy::math::DVec2::ZERO, extent)
            .floor()
            .as_ivec2();
        let high = high
            .clamp(bevy::math::DVec2::ZERO, extent)
            .ceil()
            .as_ivec2();
        Some((low, (high + 1).min(lattice.extent + 1)))
    }
}

/// Keeps the tiles of a region resident, as far as it lies on the terrain (one that lies elsewhere is
/// never ready): a spawn point, the stage of a cutscene, all the ground
/// that a server answers for. Spawn one; despawn it to let go.
///
/// What is pinned comes before what views need, and so a region that takes all of
/// [`TerrainStreaming`](super::TerrainStreaming) leaves nothing for them. [`TerrainPinProgress`]
/// says how far it is, and [`TerrainPinReady`] when it is there.
///
/// ```
/// # use bevy::prelude::*;
/// # use bevy_tessera::stream::{TerrainPin, TerrainRegion};
/// # use bevy_tessera::terrain::{Terrain, TerrainPinReady};
/// # fn spawn_player() {}
/// fn load(mut commands: Commands, terrain: Single<Entity, With<Terrain>>) {
///     let spawn_point = TerrainRegion::around(Vec2::new(1200.0, 800.0), 200.0);
///     commands
///         .spawn(Terrain::wait_for(*terrain, spawn_point))
///         .observe(|_: On<TerrainPinReady>| spawn_player());
/// }
/// ```
#[derive(Component, Clone, Copy, Debug, PartialEq, Reflect)]
#[reflect(Component, Debug, Clone, PartialEq)]
#[require(TerrainPinProgress)]
pub struct TerrainPin {
    /// The terrain whose ground is pinned.
    #[entities]
    pub terrain: Entity,
    /// Which part of it, in metres of its own x and z.
    pub region: TerrainRegion,
    /// The finest level that is pinned; 0 pins everything down to the samples.
    pub finest_level: u8,
}

impl Terrain {
    /// What a loading screen waits with: a pin on `region` of the terrain `entity`, in full detail.
    #[must_use]
    pub const fn wait_for(entity: Entity, region: TerrainRegion) -> TerrainPin {
        TerrainPin {
            terrain: entity,
            region,
            finest_level: 0,
        }
    }
}

/// How far a [`TerrainPin`] is; on every one.
#[derive(Component, Clone, Copy, Debug, Default, PartialEq, Eq, Reflect)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct TerrainPinProgress {
    /// Stored tiles that the region touches, of the pinned levels. 0 until the manifest has loaded.
    pub wanted: u32,
    /// Those that are resident.
    pub resident: u32,
    /// Those that are missing or corrupt; their parents' shape stands in for them.
    pub failed: u32,
}

impl TerrainPinProgress {
    /// The part of the region's tiles that are resident or have failed, 0 to 1; 0 until the manifest
    /// has loaded.
    #[must_use]
    pub fn fraction(&self) -> f32 {
        if self.wanted == 0 {
            return 0.0;
        }
        (self.resident + self.failed) as f32 / self.wanted as f32
    }

    /// Whether all is there that can be had.
    #[must_use]
    pub const fn is_ready(&self) -> bool {
        self.wanted > 0 && self.resident + self.failed >= self.wanted
    }
}

/// What a pin's progress was counted for.
#[derive(Component, Default)]
pub(crate) struct Counted {
    instance: u64,
    pages_version: u64,
    failures: u64,
    was_ready: bool,
}

/// Hands every terrain its pins.
pub(crate) fn collect_pins(
    pins: Query<&TerrainPin>,
    mut terrains: Query<(Entity, &mut TerrainState)>,
) {
    for (_, mut state) in &mut terrains {
        state.bypass_change_detection().pins.clear();
    }
    for pin in &pins {
        let Ok((_, mut state)) = terrains.get_mut(pin.terrain) else {
            continue;
        };
        let state = state.bypass_change_detection();
        let spacing_m = state.manifest.file.spacing_m;
        let root_level = state.root().level;
        if let Some((low, high)) = pin.region.on(&state.lattice, spacing_m) {
            state.pins.push(PinnedRegion {
                low,
                high,
                finest_level: pin.finest_level.min(root_level),
            });
        }
    }
}

/// Counts what of the pinned regions is there.
pub(crate) fn count_pins(
    mut pins: Query<(
        Entity,
        Ref<TerrainPin>,
        &mut TerrainPinProgress,
        Option<&mut Counted>,
    )>,
    terrains: Query<&TerrainState>,
    mut commands: Commands,
) {
    for (entity, pin, mut progress, counted) in &mut pins {
        let Some(mut counted) = counted else {
            commands.entity(entity).try_insert(Counted::default());
            continue;
        };
        let Ok(state) = terrains.get(pin.terrain) else {
            progress.set_if_neq(TerrainPinProgress::default());
            *counted = Counted::default();
            continue;
        };
        let known = Counted {
            instance: state.instance(),
            pages_version: state.pages_version(),
            failures: state.failures_version,
            was_ready: counted.was_ready,
        };
        let same = known.instance == counted.instance
            && known.pages_version == counted.pages_version
            && known.failures == counted.failures;
        if same && !pin.is_changed() {
            continue;
        }
        *counted = known;
        progress.set_if_neq(count(state, &pin));
        let is_ready = progress.is_ready();
        if is_ready && !counted.was_ready {
            commands.trigger(TerrainPinReady { entity });
        }
        counted.was_ready = is_ready;
    }
}

fn count(state: &TerrainState, pin: &TerrainPin) -> TerrainPinProgress {
    let mut progress = TerrainPinProgress::default();
    let spacing_m = state.manifest.file.spacing_m;
    let Some((low, high)) = pin.region.on(&state.lattice, spacing_m) else {
        return progress;
    };
    let root_level = state.root().level;
    // Without its root there is no terrain to wait for.
    let is_there = state.is_ready();
    let tile_log2 = TILE_SAMPLES.ilog2() + state.lattice.unit_log2;
    for level in pin.finest_level.min(root_level)..=root_level {
        let shift = tile_log2 + u32::from(level);
        let tiles = IVec2::from(state.pages().tiles(level).map(|tiles| tiles as i32));
        let first = (low >> IVec2::splat(shift as i32)).min(tiles - 1);
        let last = ((high - 1) >> IVec2::splat(shift as i32)).min(tiles - 1);
        for z in first.y..=last.y {
            for x in first.x..=last.x {
                let address = TileAddress::new(level, x as u32, z as u32);
                if state.manifest.index.get(address).is_none() {
                    continue;
                }
                progress.wanted += 1;
                if !is_there {
                    continue;
                }
                if state.pages().get(address).is_some() {
                    progress.resident += 1;
                } else if state.has_failed(address) {
                    progress.failed += 1;
                }
            }
        }
    }
    progress
}
