//! The terrain's component and its settings.

use super::TerrainManifest;
use crate::stream::TerrainTiles;
use bevy::prelude::*;
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
#[require(Transform, TerrainSettings, TerrainTiles)]
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

/// How a terrain is cut up and streamed.
///
/// The first and `page_capacity` are read once, when the manifest has loaded; the others may change at any
/// time. What can't be used is logged and replaced by its default.
#[derive(Component, Clone, Debug, PartialEq, Reflect)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
pub struct TerrainSettings {
    /// Finest level of the geometry, -8 to 0: 0 stands for nodes as large as the finest tiles
    /// (128 samples), -1 for half of that, and so on. Finer nodes follow the eye more closely and
    /// cost CPU time per node.
    pub leaf_level: i32,
    /// The most tiles that are resident at once, 1 to 16 384 (WebGPU's 256 texture layers of 64
    /// pages). A page takes 113 KiB of memory on the GPU and 44 KiB on the CPU. Where a view wants more tiles than that, the
    /// farthest of the finest are left out.
    pub page_capacity: u32,
    /// The most tiles that are read at once, 1 to 1024.
    pub loads_in_flight: u32,
    /// The most tiles that become resident in one frame, 1 to 1024. Each is an upload to the GPU,
    /// so this bounds the cost of a frame.
    pub activations_per_frame: u32,
    /// How fast detail appears and disappears when tiles come and go in view, in levels a second,
    /// above 0. Where nobody looks, it happens at once.
    pub fade_levels_per_s: f32,
}

impl Default for TerrainSettings {
    fn default() -> Self {
        Self {
            leaf_level: 0,
            page_capacity: 512,
            loads_in_flight: 16,
            activations_per_frame: 16,
            fade_levels_per_s: 4.0,
        }
    }
}

/// What is wrong with a terrain's settings.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum TerrainSettingsError {
    /// A count is out of its range.
    #[error("TerrainSettings::{name} is {value}: use a number from 1 to {most}")]
    Count {
        /// The field.
        name: &'static str,
        /// Its value.
        value: u32,
        /// The most that it may be.
        most: u32,
    },
    /// The fade rate is not a positive number.
    #[error("TerrainSettings::fade_levels_per_s is {0}: use a number above 0")]
    Fade(f32),
}

impl TerrainSettings {
    /// These settings with every value that can't be used replaced by its default, each of which
    /// is given to `refused`. `leaf_level` is left to
    /// [`Lattice::new`](crate::lattice::Lattice::new), which knows the terrain.
    #[must_use]
    pub fn checked(&self, mut refused: impl FnMut(TerrainSettingsError)) -> Self {
        let default = Self::default();
        let mut count = |name, value: u32, most: u32, default: u32| {
            if (1..=most).contains(&value) {
                return value;
            }
            refused(TerrainSettingsError::Count { name, value, most });
            default
        };
        let page_capacity = count(
            "page_capacity",
            self.page_capacity,
            1 << 14,
            default.page_capacity,
        );
        let loads_in_flight = count(
            "loads_in_flight",
            self.loads_in_flight,
            1 << 10,
            default.loads_in_flight,
        );
        let activations_per_frame = count(
            "activations_per_frame",
            self.activations_per_frame,
            1 << 10,
            default.activations_per_frame,
        );
        let fade = self.fade_levels_per_s;
        let fade_levels_per_s = if fade > 0.0 {
            fade
        } else {
            refused(TerrainSettingsError::Fade(fade));
            default.fade_levels_per_s
        };
        Self {
            leaf_level: self.leaf_level,
            page_capacity,
            loads_in_flight,
            activations_per_frame,
            fade_levels_per_s,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_settings_are_named_and_replaced() {
        let settings = TerrainSettings {
            page_capacity: 0,
            loads_in_flight: 0,
            activations_per_frame: 1 << 20,
            fade_levels_per_s: f32::NAN,
            ..default()
        };
        let mut errors = Vec::new();
        let checked = settings.checked(|error| errors.push(error.to_string()));
        assert_eq!(checked, TerrainSettings::default());
        assert_eq!(errors.len(), 4, "{errors:?}");
        let fine = TerrainSettings::default();
        assert_eq!(fine.checked(|error| panic!("{error}")), fine);
    }
}
