//! How densities follow from heights.
//!
//! The estimate is the mean curvature of the height field (Cervin, *Adaptive Hardware-accelerated
//! Terrain Tessellation*, equation 2.26),
//!
//! ```text
//!       h_xx (1 + h_z²) - 2 h_xz h_x h_z + h_zz (1 + h_x²)
//! H  =  --------------------------------------------------
//!                  2 (1 + h_x² + h_z²)^(3/2)
//! ```
//!
//! with derivatives by central differences. Heights and distances both count sample spacings, which
//! makes `H` a pure number: the curvature per metre times the spacing. It says by how much the
//! ground bends between two samples, whatever their distance, and so the same gain suits a 1 m
//! and a 90 m model.
//!
//! A density is `min(gain · |H|, 1)^exponent`, and what is stored is the largest density of a
//! texel's 5 × 5 samples, times 255, rounded up: ground may get more triangles than it deserves,
//! never fewer.
//!
//! Samples on the terrain's rim have no neighbours on one side, and take the curvature of the
//! nearest sample that has both.
//!
//! # The default gain
//! A crest one sample wide between two flanks of slope `s` has `|H| = s`, a gutter likewise. The
//! default gain of 2 takes the crest between two flanks of 27 degrees (`s = 1/2`) to the density 1.
//! Over elevation models with samples 1 to 160 m apart it leaves half of the texels of rolling hills
//! below 0.25, half of those of high mountains above 0.4, and up to two in five of the steepest
//! young mountains at 1.

use crate::terrain::DensitySettings;

/// Writes the absolute mean curvature of a row's samples to `out`.
///
/// `above`, `row` and `below` hold heights divided by the sample spacing, of three neighbouring
/// rows; all slices have the same length, at least 2. The first and the last sample take their
/// neighbours' curvature. Takes about a nanosecond a sample.
///
/// # Panics
/// Where the slices differ in length.
pub fn mean_curvature(above: &[f32], row: &[f32], below: &[f32], out: &mut [f32]) {
    let width = out.len();
    assert!(above.len() == width && row.len() == width && below.len() == width);
    if width < 3 {
        // Too narrow for a central difference: what bends along z is all there is.
        for x in 0..width {
            let h_z = (below[x] - above[x]) * 0.5;
            let h_zz = below[x] - 2.0 * row[x] + above[x];
            let square = 1.0 + h_z * h_z;
            out[x] = (h_zz / (2.0 * square * square.sqrt())).abs();
        }
        return;
    }
    // Slices of one length, so that the loop runs without bounds checks and in vector registers.
    let inner = width - 2;
    let (a_w, a, a_e) = (&above[..inner], &above[1..=inner], &above[2..]);
    let (r_w, r, r_e) = (&row[..inner], &row[1..=inner], &row[2..]);
    let (b_w, b, b_e) = (&below[..inner], &below[1..=inner], &below[2..]);
    let target = &mut out[1..=inner];
    for x in 0..inner {
        let h_x = (r_e[x] - r_w[x]) * 0.5;
        let h_z = (b[x] - a[x]) * 0.5;
        let h_xx = r_e[x] - 2.0 * r[x] + r_w[x];
        let h_zz = b[x] - 2.0 * r[x] + a[x];
        let h_xz = (b_e[x] - b_w[x] - a_e[x] + a_w[x]) * 0.25;
        let (x2, z2) = (h_x * h_x, h_z * h_z);
        let square = 1.0 + x2 + z2;
        let above_line = h_xx * (1.0 + z2) - 2.0 * h_xz * h_x * h_z + h_zz * (1.0 + x2);
        target[x] = (above_line / (2.0 * square * square.sqrt())).abs();
    }
    out[0] = out[1];
    out[width - 1] = out[width - 2];
}

/// The stored density of ground with the absolute normalised mean curvature `curvature`.
///
/// Rounded up: only ground without any curvature is stored as 0.
#[must_use]
pub fn quantise_density(curvature: f32, settings: &DensitySettings) -> u8 {
    let clamped = (curvature * settings.gain).clamp(0.0, 1.0);
    let density = if settings.exponent == 1.0 {
        clamped
    } else {
        clamped.powf(settings.exponent)
    };
    // In f64, where the product is exact: rounded to f32 it could fall onto a whole number and the
    // density be rounded down after all. Casts saturate, and NaN becomes 0.
    (f64::from(density) * 255.0).ceil() as u8
}
