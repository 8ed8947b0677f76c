//! What overlays' colours mean. Shaders are given these very numbers.

use super::TerrainOverlay;
use bevy::color::LinearRgba;

/// Stops that each legend has room for; WGSL `OVERLAY_STOPS`.
pub(in crate::render) const STOPS: usize = 8;

/// A colour of an overlay's legend, and what it stands for. Between two stops colours are mixed, in
/// linear light; beyond the first and the last they stay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TerrainLegendStop {
    /// The value, in the overlay's own measure: what colours are mixed by.
    pub value: f32,
    /// What is written beside the colour, with its unit.
    pub label: &'static str,
    /// The colour.
    pub color: LinearRgba,
}

const fn stop(value: f32, label: &'static str, [red, green, blue]: [f32; 3]) -> TerrainLegendStop {
    TerrainLegendStop {
        value,
        label,
        color: LinearRgba::rgb(red, green, blue),
    }
}

// Eight colours that the colour-blind can tell apart (Okabe and Ito 2008), in linear light.
const ORANGE: [f32; 3] = [0.7913, 0.3467, 0.0];
const SKY: [f32; 3] = [0.0931, 0.4564, 0.8148];
const GREEN: [f32; 3] = [0.0, 0.3419, 0.1714];
const YELLOW: [f32; 3] = [0.8714, 0.7758, 0.0545];
const BLUE: [f32; 3] = [0.0, 0.1683, 0.4452];
const VERMILION: [f32; 3] = [0.6654, 0.1119, 0.0];
const PURPLE: [f32; 3] = [0.6038, 0.1912, 0.3864];
const GREY: [f32; 3] = [0.3185, 0.3185, 0.3185];

// From blue through white to red.
const DIVERGING: [[f32; 3]; 5] = [
    [0.0152, 0.1329, 0.4125],
    [0.2874, 0.5583, 0.7305],
    [0.9301, 0.9301, 0.9301],
    [0.9047, 0.3763, 0.2232],
    [0.4452, 0.0091, 0.0242],
];

// From dark violet to bright yellow (viridis).
const RISING: [[f32; 3]; 7] = [
    [0.0578, 0.0003, 0.0887],
    [0.0578, 0.0409, 0.2270],
    [0.0307, 0.1384, 0.2705],
    [0.0152, 0.2831, 0.2623],
    [0.0356, 0.4735, 0.1912],
    [0.2789, 0.6795, 0.0561],
    [0.9823, 0.7991, 0.0185],
];

const DENSITY: &[TerrainLegendStop] = &[
    stop(0.0, "density 0", [0.02, 0.30, 0.03]),
    stop(0.5, "density 1/2", [0.75, 0.55, 0.02]),
    stop(1.0, "density 1", [0.60, 0.01, 0.01]),
];
const LEVEL: &[TerrainLegendStop] = &[
    stop(0.0, "level -8, 0, 8, 16", BLUE),
    stop(1.0, "level -7, 1, 9, 17", ORANGE),
    stop(2.0, "level -6, 2, 10, 18", GREEN),
    stop(3.0, "level -5, 3, 11, 19", YELLOW),
    stop(4.0, "level -4, 4, 12, 20", PURPLE),
    stop(5.0, "level -3, 5, 13, 21", SKY),
    stop(6.0, "level -2, 6, 14, 22", VERMILION),
    stop(7.0, "level -1, 7, 15, 23", GREY),
];
const EDGE_FACTOR: &[TerrainLegendStop] = &[
    stop(0.0, "factor 1", RISING[0]),
    stop(1.0, "factor 2", RISING[1]),
    stop(2.0, "factor 4", RISING[2]),
    stop(3.0, "factor 8", RISING[3]),
    stop(4.0, "factor 16", RISING[4]),
    stop(5.0, "factor 32", RISING[5]),
    stop(6.0, "factor 64", RISING[6]),
];
const TRIANGLE_SIZE: &[TerrainLegendStop] = &[
    stop(-3.0, "1/8 of the target or less", DIVERGING[0]),
    stop(-1.0, "1/2 of the target", DIVERGING[1]),
    stop(0.0, "the target", DIVERGING[2]),
    stop(1.0, "2 times the target", DIVERGING[3]),
    stop(3.0, "8 times the target or more", DIVERGING[4]),
];
const MORPH: &[TerrainLegendStop] = &[
    stop(0.0, "0 (the level's own place)", RISING[0]),
    stop(0.5, "1/2", RISING[3]),
    stop(1.0, "1 (the coarser level's)", RISING[6]),
];
const RESIDENCY: &[TerrainLegendStop] = &[
    stop(0.0, "as fine as asked for", BLUE),
    stop(1.0, "1 level coarser", YELLOW),
    stop(2.0, "2 levels coarser", ORANGE),
    stop(4.0, "4 levels coarser or more", VERMILION),
];
const NORMALS: &[TerrainLegendStop] = &[
    stop(0.0, "towards +x", [1.0, 0.5, 0.5]),
    stop(1.0, "towards +y", [0.5, 1.0, 0.5]),
    stop(2.0, "towards +z", [0.5, 0.5, 1.0]),
];
const SLOPE: &[TerrainLegendStop] = &[
    stop(0.0, "0°", RISING[0]),
    stop(15.0, "15°", RISING[2]),
    stop(30.0, "30°", RISING[3]),
    stop(45.0, "45°", RISING[5]),
    stop(60.0, "60°", RISING[6]),
    stop(90.0, "90°", [0.93, 0.93, 0.93]),
];
const ERROR_BOUND: &[TerrainLegendStop] = &[
    stop(0.0, "no error", DIVERGING[1]),
    stop(1.0, "the error allowed", DIVERGING[2]),
    stop(2.0, "2 times as much", DIVERGING[3]),
    stop(8.0, "8 times as much or more", DIVERGING[4]),
];
const DESTRUCTION: &[TerrainLegendStop] = &[
    stop(0.0, "untouched", [0.8, 0.8, 0.8]),
    stop(0.5, "half scorched", ORANGE),
    stop(1.0, "scorched", RISING[0]),
];
const PAGE_BORDERS: &[TerrainLegendStop] = &[stop(0.0, "border of a page", [0.8, 0.0, 0.5])];
const WIREFRAME: &[TerrainLegendStop] = &[stop(0.0, "edge of a triangle", [0.0, 0.0, 0.0])];

impl TerrainOverlay {
    /// What the overlay's colours stand for, by rising value, at most eight stops:
    ///
    /// - Levels and directions of normals are told apart, not mixed: a level's colour comes round
    ///   after eight levels, and a normal's is half its direction and a half, `(n + 1) / 2`.
    /// - Factors and sizes of triangles are mixed by their logarithms to base 2, all others by the
    ///   values themselves: degrees, levels, parts of 1, parts of the error that
    ///   [`TessellationPolicy::ScreenError`](crate::terrain::TessellationPolicy) allows (1 px under
    ///   the policy of triangle widths).
    /// - Lines have one colour.
    #[must_use]
    pub const fn legend(self) -> &'static [TerrainLegendStop] {
        match self {
            Self::Density => DENSITY,
            Self::Level => LEVEL,
            Self::EdgeFactor => EDGE_FACTOR,
            Self::TriangleSize => TRIANGLE_SIZE,
            Self::Morph => MORPH,
            Self::Residency => RESIDENCY,
            Self::Normals => NORMALS,
            Self::Slope => SLOPE,
            Self::ErrorBound => ERROR_BOUND,
            Self::Destruction => DESTRUCTION,
            Self::PageBorders => PAGE_BORDERS,
            Self::Wireframe => WIREFRAME,
        }
    }

    /// The colour of a value, mixed as on the ground; that of levels by `level.rem_euclid(8)`. Means
    /// nothing for normals.
    #[must_use]
    pub fn legend_color(self, value: f32) -> LinearRgba {
        let stops = self.legend();
        let mut color = stops[0].color;
        for pair in stops.windows(2) {
            let [low, high] = [pair[0], pair[1]];
            if value > low.value {
                let part = ((value - low.value) / (high.value - low.value)).min(1.0);
                color = low.color * (1.0 - part) + high.color * part;
            }
        }
        color
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_legend_rises_and_fits() {
        for overlay in TerrainOverlay::ALL {
            let stops = overlay.legend();
            assert!((1..=STOPS).contains(&stops.len()), "{overlay:?}");
            assert!(stops.windows(2).all(|pair| pair[0].value < pair[1].value));
            for (at, stop) in stops.iter().enumerate() {
                assert!(!stop.label.is_empty());
                let shown = overlay.legend_color(stop.value);
                assert!((shown.red - stop.color.red).abs() < 1e-6);
                let others = stops.iter().skip(at + 1);
                assert!(others.clone().all(|other| other.color != stop.color));
            }
        }
    }
}
