//! The terrain's component and its settings.

use super::TerrainManifest;
use crate::edit::TerrainEdits;
use crate::stream::TerrainTiles;
use bevy::prelude::*;
use std::ops::RangeInclusive;
use thiserror::Error;

/// A terrain: spawn one with the handle of its manifest.
///
/// Its corner, sample `(0, 0)` at height 0, stands at the entity's [`Transform`], which may move,
/// turn and scale uniformly at any time; samples lie along local x and z, and y is up. Once the
/// manifest has loaded, the entity gets a [`TerrainState`], and tiles appear as entities
/// [related](TerrainTiles) to it. Despawning it, or removing this component, frees everything.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_tessera::terrain::{Terrain, TerrainCamera};
/// fn setup(mut commands: Commands, assets: Res<AssetServer>) {
///     commands.spawn(Terrain::new(assets.load("alps/terrain.ron")));
///     commands.spawn((TerrainCamera::default(), Transform::from_xyz(500.0, 300.0, 500.0)));
/// }
/// ```
///
/// [`TerrainState`]: crate::stream::TerrainState
#[derive(Component, Clone, Debug, Default, PartialEq, Eq, Reflect)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
#[require(Transform, TerrainEdits, TerrainSettings, TerrainTiles)]
#[cfg_attr(feature = "render", require(Visibility))]
pub struct Terrain {
    /// The manifest, `terrain.ron` in a baked terrain's folder. The tiles are loaded from beside
    /// it. Another handle makes it another terrain: the tiles of the former are dropped.
    pub manifest: Handle<TerrainManifest>,
}

impl Terrain {
    /// A terrain whose manifest is `manifest`.
    #[must_use]
    pub const fn new(manifest: Handle<TerrainManifest>) -> Self {
        Self { manifest }
    }
}

/// How a terrain is cut up and how its detail comes and goes.
///
/// `leaf_level` is read once, when the manifest has loaded; the others may change at any time. What
/// can't be used is logged and replaced by its default. What all terrains may use together is in
/// [`TerrainStreaming`](crate::stream::TerrainStreaming).
#[derive(Component, Clone, Debug, PartialEq, Reflect)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct TerrainSettings {
    /// Finest level of the geometry, -8 to 0: 0 stands for nodes as large as the finest tiles
    /// (128 samples), -1 for half of that, and so on. Finer nodes follow the eye more closely and
    /// cost CPU time per node.
    pub leaf_level: i32,
    /// How many of the coarsest levels are always resident as a whole, wherever the eyes are,
    /// 1 to 8: one tile, five, twenty-one... They are what is seen first after a teleport.
    pub root_levels: u8,
    /// How fast detail appears and disappears when tiles come and go in view, in levels a second
    /// at most, above 0. Where nobody looks, it happens at once.
    pub fade_levels_per_s: f32,
    /// How fast the ground moves on the screen at most while detail appears and disappears, in
    /// pixels a second, above 0: near the eye and on rough ground fading takes longer, down to
    /// 1/32 of `fade_levels_per_s`.
    pub fade_px_per_s: f32,
}

impl Default for TerrainSettings {
    fn default() -> Self {
        Self {
            leaf_level: 0,
            root_levels: 2,
            fade_levels_per_s: 4.0,
            fade_px_per_s: 12.0,
        }
    }
}

/// What is wrong with a terrain's settings.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum TerrainSettingsError {
    /// The number of root levels is out of its range.
    #[error("TerrainSettings::root_levels is {0}: use a number from 1 to 8")]
    RootLevels(u8),
    /// A fade rate is not a positive number.
    #[error("TerrainSettings::{name} is {value}: use a number above 0")]
    Fade {
        /// The field.
        name: &'static str,
        /// Its value.
        value: f32,
    },
}

impl TerrainSettings {
    /// Finest levels that are accepted, where the terrain isn't too large for them.
    pub const LEAF_LEVEL_RANGE: RangeInclusive<i32> = crate::lattice::LEAF_LEVEL_RANGE;
    /// Numbers of root levels that are accepted.
    pub const ROOT_LEVELS_RANGE: RangeInclusive<u8> = 1..=8;
    /// Rates of fading that are accepted, in levels or pixels a second.
    pub const FADE_RANGE: RangeInclusive<f32> = f32::MIN_POSITIVE..=f32::MAX;

    /// These settings with every value that can't be used replaced by its default, each of which
    /// is given to `refused`. `leaf_level` is left to
    /// [`Lattice::new`](crate::lattice::Lattice::new), which knows the terrain.
    #[must_use]
    pub fn checked(&self, mut refused: impl FnMut(TerrainSettingsError)) -> Self {
        let default = Self::default();
        let root_levels = if Self::ROOT_LEVELS_RANGE.contains(&self.root_levels) {
            self.root_levels
        } else {
            refused(TerrainSettingsError::RootLevels(self.root_levels));
            default.root_levels
        };
        let mut fade = |name, value: f32, default: f32| {
            // Not a number is in no range.
            if Self::FADE_RANGE.contains(&value) {
                return value;
            }
            refused(TerrainSettingsError::Fade { name, value });
            default
        };
        Self {
            leaf_level: self.leaf_level,
            root_levels,
            fade_levels_per_s: fade(
                "fade_levels_per_s",
                self.fade_levels_per_s,
                default.fade_levels_per_s,
            ),
            fade_px_per_s: fade("fade_px_per_s", self.fade_px_per_s, default.fade_px_per_s),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_settings_are_named_and_replaced() {
        let settings = TerrainSettings {
            root_levels: 0,
            fade_levels_per_s: f32::NAN,
            fade_px_per_s: -1.0,
            ..default()
        };
        let mut errors = Vec::new();
        let checked = settings.checked(|error| errors.push(error.to_string()));
        assert_eq!(checked, TerrainSettings::default());
        assert_eq!(errors.len(), 3, "{errors:?}");
        let fine = TerrainSettings::default();
        assert_eq!(fine.checked(|error| panic!("{error}")), fine);
    }
}
