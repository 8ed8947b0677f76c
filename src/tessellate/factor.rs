//! How finely an edge is cut: the projected size of the sphere around it.

use super::edge_error::{GroundErrors, LevelErrors, error_at, error_spacing};
use super::{DENSITY_ONE, FACTOR_MAX, FACTOR_ONE};
use crate::lattice::ONE;
use glam::{IVec2, Vec2, Vec3};

/// One end of an edge: its lattice point and the displaced height there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EdgeEnd {
    /// Its lattice point, morphed.
    pub point: IVec2,
    /// Height in metres above the terrain's origin, read at the end's own level of detail.
    pub height_m: f32,
}

/// What edge factors follow from, besides the edge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FactorView {
    /// The eye's lattice point.
    pub eye: IVec2,
    /// The eye's fraction of a lattice unit, 0..1.
    pub eye_fraction: Vec2,
    /// The eye's height in metres above the terrain's origin.
    pub eye_height_m: f32,
    /// Metres per lattice unit.
    pub unit_m: f32,
    /// Segments that an edge of a metre gets at a metre's distance: the focal length in pixels
    /// over the wanted triangle width in pixels.
    pub segments_per_radian: f32,
    /// Segments a metre whatever the distance, for orthographic views; 0 in perspective.
    pub segments_per_m: f32,
    /// No edge is cut into segments shorter than this on the ground, in metres.
    pub min_triangle_m: f32,
    /// The most segments that an edge gets, 1 to 64.
    pub max_factor: f32,
    /// Pixels a radian in the middle of the picture: the focal length; 0 in orthographic views.
    pub focal_px: f32,
    /// Pixels a metre in orthographic views, else 0.
    pub px_per_m: f32,
    /// The vertical error that may be left on the screen, in pixels: factors follow from the stored
    /// bounds of it and not from the triangle width. 0 for factors by triangle width.
    pub max_error_px: f32,
    /// Units of [`ErrorBounds`](super::ErrorBounds) that make a metre.
    pub error_units_per_m: f32,
    /// How far densities count, 0 (not at all) to 1 (in full): a factor is scaled by
    /// `1 - strength + strength * density` (in full as in Cervin 2012, algorithm 3.1).
    pub density_strength: f32,
}

/// How far the square beside an edge reaches from its middle, in lengths of the edge: half a
/// diagonal.
const SQUARE_REACH: f32 = 0.707_106_77;
/// The longest edge of a triangle, in lengths of a segment: the diagonal of a square.
const STRETCH: f32 = std::f32::consts::SQRT_2;
/// Nearer than this no ground is taken to be when its error is to be named in pixels, metres.
const NEAREST_M: f32 = 1e-3;

/// An edge as the eye sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProjectedEdge {
    /// Segments that the view wants, were the ground as rough as can be; 0 or more, not whole.
    pub wanted: f32,
    /// The most segments that it may have, by its length on the ground and the view's limit.
    pub limit: f32,
    /// Its length on the ground, metres.
    pub length_m: f32,
    /// From the eye to the nearest ground of the square beside it, metres.
    pub nearest_m: f32,
}

impl FactorView {
    /// The edge between `a` and `b` as the eye sees it.
    ///
    /// The diameter of the sphere around the displaced edge, projected, over the triangle width
    /// (Cantlay 2011, figures 6 and 7: a projected edge would vanish at grazing views, a sphere doesn't).
    /// Depends on the two ends alone, in the order that
    /// the edge is [cut in](super::edge_ends).
    #[must_use]
    pub fn project(&self, a: EdgeEnd, b: EdgeEnd) -> ProjectedEdge {
        let span = (b.point - a.point).as_vec2() * self.unit_m;
        let length_m = span.length();
        let diameter_m = (span.length_squared() + (b.height_m - a.height_m).powi(2)).sqrt();
        // Twice the middle, so that no half unit is lost before it is made relative to the eye.
        let from_eye = (a.point - self.eye) + (b.point - self.eye);
        let plane_m = (from_eye.as_vec2() * 0.5 - self.eye_fraction) * self.unit_m;
        let height_m = 0.5 * (a.height_m + b.height_m) - self.eye_height_m;
        let distance_m = Vec3::new(plane_m.x, height_m, plane_m.y)
            .length()
            // Inside the sphere the projection has no meaning; it is as large as can be.
            .max(0.5 * diameter_m);
        let projected = if distance_m > 0.0 {
            diameter_m * self.segments_per_radian / distance_m
        } else {
            0.0
        };
        let wanted = projected + diameter_m * self.segments_per_m;
        ProjectedEdge {
            wanted,
            limit: (length_m / self.min_triangle_m).min(self.max_factor),
            length_m,
            nearest_m: (distance_m - SQUARE_REACH * diameter_m).max(0.0),
        }
    }

    /// Segments that the edge wants so that no more than [`max_error_px`](Self::max_error_px) is left
    /// on the screen, where triangles leave `errors` and samples of level 0 are `sample_m` apart.
    #[must_use]
    pub fn wanted_by_error(
        &self,
        edge: &ProjectedEdge,
        errors: &GroundErrors,
        sample_m: f32,
    ) -> f32 {
        let allowed_m = if self.focal_px > 0.0 {
            self.max_error_px * edge.nearest_m / self.focal_px
        } else {
            self.max_error_px / self.px_per_m
        };
        let by_level = |errors: &LevelErrors| {
            let spacing = error_spacing(&errors.bounds, allowed_m * self.error_units_per_m);
            let spacing_m = spacing * sample_m * (1_u32 << errors.level) as f32;
            STRETCH * edge.length_m / spacing_m.max(1e-6)
        };
        let fine = by_level(&errors.fine);
        match &errors.coarse {
            None => fine,
            Some((coarse, morph)) => {
                let part = *morph as f32 / ONE as f32;
                fine * (1.0 - part) + by_level(coarse) * part
            }
        }
    }

    /// What `errors` say of the vertical error that triangles leave beside an edge that is cut by
    /// `factor` (fixed point), in pixels on the screen, where samples of level 0 are `sample_m` apart.
    /// What [`wanted_by_error`](Self::wanted_by_error) turns round.
    #[must_use]
    pub fn error_px(
        &self,
        edge: &ProjectedEdge,
        errors: &LevelErrors,
        factor: u32,
        sample_m: f32,
    ) -> f32 {
        let segment_m = STRETCH * edge.length_m * FACTOR_ONE as f32 / factor as f32;
        let spacing = segment_m / (sample_m * (1_u32 << errors.level) as f32);
        let error_m = error_at(&errors.bounds, spacing) / self.error_units_per_m;
        if self.focal_px > 0.0 {
            error_m * self.focal_px / edge.nearest_m.max(NEAREST_M)
        } else {
            error_m * self.px_per_m
        }
    }

    /// The factor of an edge on ground with `density` (in units of
    /// [`DENSITY_ONE`](super::DENSITY_ONE)), in fixed point ([`FACTOR_ONE`]).
    ///
    /// This is the one place where a float decides topology, and it is rounded to fixed point here.
    #[must_use]
    pub fn factor(&self, edge: ProjectedEdge, density: u32) -> u32 {
        let density = density as f32 / DENSITY_ONE as f32;
        let weight = 1.0 - self.density_strength * (1.0 - density);
        Self::fixed(edge.wanted * weight, edge.limit)
    }

    /// `wanted` segments as a factor in fixed point, not above `limit`.
    #[must_use]
    pub fn fixed(wanted: f32, limit: f32) -> u32 {
        let factor = wanted.min(limit).max(1.0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "1..=64, and saturates"
        )]
        let fixed = (factor * FACTOR_ONE as f32 + 0.5) as u32;
        fixed.clamp(FACTOR_ONE, FACTOR_MAX)
    }
}
