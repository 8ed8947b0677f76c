//! Asking the ground for its height, with or without a GPU.
//!
//! Answers come from the tiles that are resident, at the finest level that is there: those of a
//! server that [pins](crate::stream::TerrainPin) a region are as good as those of a client that
//! stands in it. They say which level they come from.

use crate::stream::TerrainState;
use crate::tile::{HeightTile, TILE_SAMPLES, TileAddress};
use bevy::ecs::system::SystemParam;
use bevy::math::DVec2;
use bevy::prelude::*;

/// The ground at a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TerrainHeight {
    /// Metres above the terrain's origin.
    pub height_m: f64,
    /// The level that the answer comes from: the finest that is resident there, 0 for the samples
    /// themselves.
    pub level: u8,
}

/// The ground under a place in the world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TerrainGround {
    /// The terrain.
    pub terrain: Entity,
    /// The place on the ground, in the world.
    pub point: Vec3,
    /// The level that the answer comes from, as in [`TerrainHeight::level`].
    pub level: u8,
}

/// Asks terrains for their ground. A system parameter.
///
/// ```
/// # use bevy::prelude::*;
/// # use bevy_tessera::query::TerrainQuery;
/// # #[derive(Component)] struct Sheep;
/// fn stand_on_the_ground(ground: TerrainQuery, mut sheep: Query<&mut Transform, With<Sheep>>) {
///     for mut sheep in &mut sheep {
///         if let Some(ground) = ground.under(sheep.translation) {
///             sheep.translation = ground.point;
///         }
///     }
/// }
/// ```
#[derive(SystemParam)]
pub struct TerrainQuery<'w, 's> {
    terrains: Query<'w, 's, (Entity, &'static TerrainState, &'static GlobalTransform)>,
}

impl TerrainQuery<'_, '_> {
    /// The ground of `terrain` at `at_m`, in metres of its own x and z. `None` where that is
    /// outside, and while not even the coarsest tile is resident. Cost: some 100 ns.
    #[must_use]
    pub fn height(&self, terrain: Entity, at_m: DVec2) -> Option<TerrainHeight> {
        let (_, state, _) = self.terrains.get(terrain).ok()?;
        state.height(at_m)
    }

    /// The ground under a place in the world (or over it, where the place is below the ground): that
    /// of the terrain whose ground is nearest along the terrain's own vertical. `None` where there is
    /// no terrain.
    #[must_use]
    pub fn under(&self, place: Vec3) -> Option<TerrainGround> {
        let grounds = self
            .terrains
            .iter()
            .filter_map(|(terrain, state, transform)| {
                let affine = transform.affine();
                let local = affine.inverse().transform_point3(place);
                if !local.is_finite() {
                    return None;
                }
                let ground = state.height(local.xz().as_dvec2())?;
                let foot = local.with_y(ground.height_m as f32);
                let found = TerrainGround {
                    terrain,
                    point: affine.transform_point3(foot),
                    level: ground.level,
                };
                Some((found.point.distance_squared(place), found))
            });
        let nearest = grounds.min_by(|(a, _), (b, _)| a.total_cmp(b));
        nearest.map(|(_, found)| found)
    }
}

impl TerrainState {
    /// The ground at `at_m`, in metres of the terrain's own x and z: bilinear between the samples of
    /// the finest level that is resident there. `None` outside, and while nothing is resident.
    #[must_use]
    pub fn height(&self, at_m: DVec2) -> Option<TerrainHeight> {
        let file = &self.manifest().file;
        let sample = at_m / file.spacing_m;
        let last = DVec2::from(file.size.map(|samples| f64::from(samples - 1)));
        // Not a number is nowhere.
        if !(sample.cmpge(DVec2::ZERO).all() && sample.cmple(last).all()) {
            return None;
        }
        let mut answer = None;
        for level in (0..file.levels).rev() {
            let at = sample / f64::from(1_u32 << level);
            let tile = (at / f64::from(TILE_SAMPLES)).floor().as_uvec2();
            // The last sample belongs to the last tile.
            let [columns, rows] = file.tiles(level);
            let address = TileAddress::new(level, tile.x.min(columns - 1), tile.y.min(rows - 1));
            let Some(data) = self.tile_data(address) else {
                break;
            };
            answer = Some((address, at, &data.heights));
        }
        let (address, at, heights) = answer?;
        let (first_x, first_z) = address.first_sample();
        let stored = bilinear(heights, at - DVec2::new(first_x.into(), first_z.into()));
        Some(TerrainHeight {
            height_m: file.height_min_m + stored * file.height_step_m,
            level: address.level,
        })
    }
}

/// The stored height at `at`, counted in samples from the tile's first own one, 0 to 128.
fn bilinear(heights: &HeightTile, at: DVec2) -> f64 {
    let cell = at
        .floor()
        .clamp(DVec2::ZERO, DVec2::splat(f64::from(TILE_SAMPLES - 1)));
    let part = at - cell;
    let corner = |dx: i32, dz: i32| {
        let (x, z) = (cell.x as i32 + dx, cell.y as i32 + dz);
        f64::from(heights.get(x, z))
    };
    let row = |dz: i32| corner(0, dz) + (corner(1, dz) - corner(0, dz)) * part.x;
    let near = row(0);
    near + (row(1) - near) * part.y
}
