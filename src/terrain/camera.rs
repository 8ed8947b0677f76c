//! The component that makes a camera see terrains.

use crate::lattice::{
    DEFAULT_FACES_PER_SIDE, FACES_PER_SIDE, LatticeError, LodSettings, faces_log2,
};
use crate::tessellate::Partitioning;
use crate::view::TerrainViews;
use bevy::prelude::*;
use std::ops::RangeInclusive;
use thiserror::Error;

/// Makes a camera see terrains, and terrains stream around it.
///
/// Any number of cameras may have one, each with its own settings. An entity that is no camera
/// may have one too: terrains then stream around it as around a perspective camera, which is how
/// a server keeps the ground under its players resident. Such an app needs Bevy's
/// `TransformPlugin`. A camera that is not active counts for nothing.
///
/// An orthographic camera sees the whole terrain at one level of detail: the one that Bevy's
/// default perspective camera (45° high) would see at the distance at which its pixels have the
/// same size.
#[derive(Component, Clone, Debug, PartialEq, Reflect)]
#[reflect(Component, Default, Debug, Clone, PartialEq)]
#[require(Transform, TerrainViews)]
pub struct TerrainCamera {
    /// How far each level of detail reaches. Memory and triangles grow with the square of the
    /// reach.
    pub lod: LodSettings,
    /// Control faces along a node's side, a power of two from 2 to 32. More faces follow the
    /// density map more closely; they cost GPU time whether or not they are cut up.
    pub faces_per_side: u32,
    /// What decides how finely the ground is cut.
    pub policy: TessellationPolicy,
    /// Wanted length of a triangle's edge on the screen where the ground is roughest, in pixels,
    /// 1 to 256 (Cantlay 2011, figure 6). The number of triangles falls with up to the square of it.
    pub triangle_width_px: f32,
    /// The most segments that an edge of a control face is cut into, 1 to 64. With 1 nothing is
    /// tessellated.
    pub max_factor: f32,
    /// Edges are not cut shorter than this, in metres along the ground, above 0. `None` stands
    /// for the spacing of the finest samples, beyond which there is nothing to be seen.
    pub min_triangle_m: Option<f32>,
    /// How far the density map counts, from 0 (not at all: triangles of one size everywhere) to 1
    /// (in full: none where the map says that the ground is plain; Cervin 2012, algorithm 3.1).
    pub density: f32,
    /// How real factors become whole segments.
    pub partitioning: Partitioning,
    /// The most vertices that this camera's view may have, 1024 to 2²⁴. Where it wants more, all
    /// factors of the view are lowered together until they fit. A vertex takes 40 bytes of GPU
    /// memory, its triangles included. The device's largest storage buffer may allow fewer:
    /// 5.6 million within WebGPU's limits.
    pub max_vertices: u32,
}

impl Default for TerrainCamera {
    fn default() -> Self {
        Self {
            lod: LodSettings::default(),
            faces_per_side: DEFAULT_FACES_PER_SIDE,
            policy: TessellationPolicy::default(),
            triangle_width_px: 6.0,
            max_factor: 64.0,
            min_triangle_m: None,
            density: 1.0,
            partitioning: Partitioning::default(),
            max_vertices: 1 << 20,
        }
    }
}

/// What decides how finely the ground is cut.
#[derive(Clone, Copy, Debug, Default, PartialEq, Reflect)]
#[reflect(Default, Debug, Clone, PartialEq)]
#[non_exhaustive]
pub enum TessellationPolicy {
    /// Triangles of [`TerrainCamera::triangle_width_px`], wider where the density map says that the
    /// ground is plain (Cantlay 2011; Cervin 2012).
    #[default]
    TriangleWidth,
    /// As few triangles as keep the error below a bound: no height that is drawn lies further than
    /// this beside that of the tiles in view, as seen on the screen. Follows from bounds that are
    /// stored with the tiles; neither the triangle width nor the density map counts. What coarser
    /// levels leave out of the ground is not part of the error; [`LodSettings::reach`] decides it.
    ScreenError {
        /// The most that a height may be off, in pixels, 0.1 to 64.
        max_px: f32,
    },
}

impl TessellationPolicy {
    /// Errors that [`ScreenError`](Self::ScreenError) accepts, in pixels.
    pub const MAX_PX_RANGE: RangeInclusive<f32> = 0.1..=64.0;
}

/// What is wrong with a [`TerrainCamera`].
#[derive(Clone, Copy, Debug, PartialEq, Error)]
#[non_exhaustive]
pub enum TerrainCameraError {
    /// The level-of-detail settings would tear the mesh or are out of range.
    #[error("TerrainCamera::lod can't be used: {0}")]
    Lod(#[from] LatticeError),
    /// The number of faces is no power of two, or out of its range.
    #[error("TerrainCamera::faces_per_side can't be used: {0}")]
    Faces(LatticeError),
    /// The view may have too few or too many vertices.
    #[error(
        "TerrainCamera::max_vertices is {0}: use a number from {least} to {most}",
        least = TerrainCamera::MAX_VERTICES_RANGE.start(),
        most = TerrainCamera::MAX_VERTICES_RANGE.end()
    )]
    MaxVertices(u32),
    /// A number is out of its range.
    #[error("TerrainCamera::{name} is {value}: use a number from {least} to {most}")]
    Number {
        /// The field.
        name: &'static str,
        /// Its value.
        value: f32,
        /// The least that it may be.
        least: f32,
        /// The most that it may be.
        most: f32,
    },
}

impl TerrainCamera {
    /// Numbers of faces along a node's side that are accepted.
    pub const FACES_PER_SIDE: [u32; 5] = FACES_PER_SIDE;
    /// Triangle widths that are accepted, in pixels.
    pub const TRIANGLE_WIDTH_RANGE: RangeInclusive<f32> = 1.0..=256.0;
    /// Largest factors that are accepted.
    pub const MAX_FACTOR_RANGE: RangeInclusive<f32> = 1.0..=64.0;
    /// Least lengths of an edge that are accepted, in metres.
    pub const MIN_TRIANGLE_RANGE: RangeInclusive<f32> = f32::MIN_POSITIVE..=f32::MAX;
    /// Weights of the density map that are accepted.
    pub const DENSITY_RANGE: RangeInclusive<f32> = 0.0..=1.0;
    /// Numbers of vertices that are accepted.
    pub const MAX_VERTICES_RANGE: RangeInclusive<u32> = 1024..=1 << 24;

    /// These settings with every value that can't be used replaced by its default, each of which
    /// is given to `refused`. The systems work with the result, never with the raw values.
    #[must_use]
    pub fn checked(&self, mut refused: impl FnMut(TerrainCameraError)) -> Self {
        let default = Self::default();
        let mut number = |name, value: f32, range: RangeInclusive<f32>, default: f32| {
            // Not a number is in no range.
            if range.contains(&value) {
                return value;
            }
            let (least, most) = range.into_inner();
            refused(TerrainCameraError::Number {
                name,
                value,
                least,
                most,
            });
            default
        };
        let triangle_width_px = number(
            "triangle_width_px",
            self.triangle_width_px,
            Self::TRIANGLE_WIDTH_RANGE,
            default.triangle_width_px,
        );
        let max_factor = number(
            "max_factor",
            self.max_factor,
            Self::MAX_FACTOR_RANGE,
            default.max_factor,
        );
        let policy = match self.policy {
            TessellationPolicy::ScreenError { max_px } => TessellationPolicy::ScreenError {
                max_px: number(
                    "policy.max_px",
                    max_px,
                    TessellationPolicy::MAX_PX_RANGE,
                    1.0,
                ),
            },
            policy @ TessellationPolicy::TriangleWidth => policy,
        };
        let density = number(
            "density",
            self.density,
            Self::DENSITY_RANGE,
            default.density,
        );
        let min_triangle_m = self.min_triangle_m.and_then(|metres| {
            let checked = number("min_triangle_m", metres, Self::MIN_TRIANGLE_RANGE, -1.0);
            (checked > 0.0).then_some(checked)
        });
        let max_vertices = if Self::MAX_VERTICES_RANGE.contains(&self.max_vertices) {
            self.max_vertices
        } else {
            refused(TerrainCameraError::MaxVertices(self.max_vertices));
            default.max_vertices
        };
        let faces_per_side = match faces_log2(self.faces_per_side) {
            Ok(_) => self.faces_per_side,
            Err(error) => {
                refused(TerrainCameraError::Faces(error));
                default.faces_per_side
            }
        };
        let lod = match self.lod.validate() {
            Ok(()) => self.lod,
            Err(error) => {
                refused(error.into());
                default.lod
            }
        };
        Self {
            lod,
            faces_per_side,
            policy,
            triangle_width_px,
            max_factor,
            min_triangle_m,
            density,
            partitioning: self.partitioning,
            max_vertices,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_numbers_are_named_and_replaced() {
        let camera = TerrainCamera {
            lod: LodSettings {
                reach: 2.0,
                morph: 1.0,
            },
            faces_per_side: 7,
            triangle_width_px: f32::NAN,
            max_factor: 65.0,
            min_triangle_m: Some(0.0),
            density: 1.5,
            max_vertices: (1 << 24) + 1,
            ..default()
        };
        let mut errors = Vec::new();
        let checked = camera.checked(|error| errors.push(error.to_string()));
        assert_eq!(checked, TerrainCamera::default());
        let named = [
            "triangle_width_px",
            "max_factor",
            "min_triangle_m",
            "density",
            "max_vertices",
            "faces_per_side",
            "lod",
        ];
        assert_eq!(errors.len(), named.len());
        for name in named {
            assert!(
                errors.iter().any(|error| error.contains(name)),
                "{name}: {errors:?}"
            );
        }
    }

    #[test]
    fn the_defaults_are_fine() {
        let checked = TerrainCamera::default().checked(|error| panic!("{error}"));
        assert_eq!(checked, TerrainCamera::default());
    }
}
