//! From degrees to metres.

/// Metres that a degree of longitude and one of latitude take at `latitude` degrees, on the WGS 84
/// ellipsoid (series good to a decimetre).
pub(super) fn metres_per_degree(latitude: f64) -> [f64; 2] {
    let phi = latitude.to_radians();
    [
        111_412.84 * phi.cos() - 93.5 * (3.0 * phi).cos() + 0.118 * (5.0 * phi).cos(),
        111_132.92 - 559.82 * (2.0 * phi).cos() + 1.175 * (4.0 * phi).cos(),
    ]
}

/// One spacing for pixels of `x` by `z` metres, and a note where they aren't square: a terrain's
/// samples lie as far apart in x as in z. The mean is the geometric one, which keeps areas.
pub(super) fn square_spacing(x: f64, z: f64) -> (f64, Option<String>) {
    let mean = (x * z).sqrt();
    let note = ((x - z).abs() > 0.01 * mean).then(|| {
        format!(
            "its pixels are {x:.2} m x {z:.2} m; they are taken as squares of {mean:.2} m, which \
             stretches the terrain (resample it to square pixels to avoid that)"
        )
    });
    (mean, note)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn degrees_have_their_known_lengths() {
        let [x, z] = metres_per_degree(0.0);
        assert!((x - 111_319.5).abs() < 1.0 && (z - 110_574.3).abs() < 1.0);
        let [x, z] = metres_per_degree(45.0);
        assert!((x - 78_846.8).abs() < 1.0 && (z - 111_131.7).abs() < 1.0);
        assert!(metres_per_degree(90.0)[0].abs() < 1.0);
    }
}
