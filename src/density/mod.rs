//! Density: how finely ground deserves to be tessellated, from how much it bends.
//!
//! A density is a `u8` per 4 × 4 samples, read as 0..1. It follows from stored heights alone, and
//! so whoever has the heights can make the same bytes: a bake, a rebake, a crater on any machine.
//!
//! # From heights to a density
//! 1. **Curvature** `c` of every sample, by the [filter](DensityFilter) that the
//!    [settings](DensitySettings) name, from the sample and its eight neighbours; see
//!    [`curvature`]. Beyond the terrain's rim the ground goes on straight.
//! 2. **Normalisation.** Heights and distances both count sample spacings, which makes curvature a
//!    pure number: `c = κ · s` with `κ` the curvature per metre and `s` the spacing in metres (of
//!    that level; `c = K · s²` for the Gaussian). It says by how much the ground turns from one
//!    sample to the next. The curvature per metre alone would flatter coarse models: rough ground
//!    seen at twice the spacing has less than half of it, because what was between the samples is
//!    gone, while its slopes still turn about as much from sample to sample.
//! 3. **Maximum** over the 5 × 5 samples of a texel: its 4 × 4, and one more to each side that
//!    neighbouring texels share, so that a spike between two texels counts in both.
//! 4. **Rounding noise off.** Stored heights are whole steps, and a plane of them bends by up to
//!    one step between samples. What is as small counts as nothing, what is twice as large in
//!    full, with a ramp in between: `min(c, 2 · max(c − n, 0))`, `n` being
//!    [`DensityFilter::rounding_noise`].
//! 5. **Scale and shape**: `min(gain · scale · c, 1)^exponent`, the scale being
//!    [the filter's](DensityFilter::scale).
//! 6. **Quantisation**: times 255, rounded up. Ground may get more triangles than it deserves,
//!    never fewer.
//! 7. **Spreading**, which the thesis calls preprocessing: the largest over a square of
//!    [`filter_size`](DensitySettings::filter_size) texels.
//! 8. **Coarser levels**: the largest of the four texels that a texel covers. Where a tile has no
//!    finer ones, steps 1 to 7 on its own heights and its own spacing.
//!
//! # Cliffs
//! All filters but [`SecondOrder`](DensityFilter::SecondOrder) measure the surface's own curvature,
//! and a wall one sample wide is hardly curved: half-way up it is steep and straight, and the samples
//! above and below it see a slope so steep that what bends counts for little (equation 3.6). A step
//! of 5 spacings is seen as a quarter of one of 1 spacing, a step of 50 not at all. Where walls
//! matter, take `SecondOrder`.
//!
//! Everything is IEEE arithmetic without fused multiplications and without library functions whose
//! results differ by platform.

pub mod curvature;
mod kernel;
mod settings;
mod texels;

pub use kernel::{DensityKernel, DensityScratch, DensityWindow};
pub use settings::{DensityBorder, DensityFilter, DensitySettings, DensitySettingsError};
pub use texels::{DensityExtent, DensityRows, densities, texels_of, tile_densities};
pub(crate) use texels::{coarser_row, some_tile_densities, spread_row};

impl DensityFilter {
    /// What takes the filter's curvature to a density at a gain of 1.
    ///
    /// Derived from six elevation models with samples 1 to 160 m apart (hills of Tennessee, Taiwan,
    /// Puget Sound, Mount Rainier, Mount Washington, fields of Slovenia), each counting alike: 90 %
    /// of all texels have less curvature than what becomes the density 1.
    /// `cargo bench --bench density_scales` does it again.
    #[must_use]
    pub const fn scale(self) -> f32 {
        match self {
            Self::SecondOrder => 0.83,
            Self::Gaussian => 5.2,
            Self::Mean => 2.0,
            Self::LaplaceBeltrami => 2.3,
            Self::LaplaceBeltramiVoronoi => 2.2,
            Self::Principal => 1.3,
        }
    }

    /// The most curvature that the heights of a plane show once they are rounded to steps of
    /// `step` sample spacings, at any slope.
    #[must_use]
    pub fn rounding_noise(self, step: f32) -> f32 {
        // Between three samples in a row, rounding bends a straight line by one step at most;
        // across a square, by a quarter of one. See the tests for planes of all slopes.
        // The thousandth is for rounding in single precision.
        match self {
            Self::SecondOrder => 2.0 * step,
            Self::Gaussian => 1.001 * 1.0625 * step * step,
            Self::Mean => 1.001 * step,
            // Sums of cotangents cancel out on a plane, and leave a little.
            Self::LaplaceBeltrami | Self::LaplaceBeltramiVoronoi => 1.001 * step + 1e-6,
            Self::Principal => 1.001 * 1.25 * step,
        }
    }
}
