//! Every filter holds against closed forms: planes, spheres, cylinders, saddles, paraboloids, and
//! the error falls with the square of the spacing.

use bevy_tessera::density::DensityFilter;
use bevy_tessera::density::curvature::{
    Ring, gaussian, laplace_beltrami, laplace_beltrami_voronoi, mean, principal, second_order,
};
use proptest::prelude::*;

/// Heights of `surface` around `(x, z)`, `spacing` apart; one of them is worth `1 / spacing` of a
/// spacing.
fn ring(surface: impl Fn(f64, f64) -> f64, at: [f64; 2], spacing: f64) -> (Ring<f64>, f64) {
    let height = |x: i32, z: i32| {
        surface(
            at[0] + spacing * f64::from(x),
            at[1] + spacing * f64::from(z),
        )
    };
    (Ring::new(height), 1.0 / spacing)
}

/// What the six filters should see of a surface at a point: `h_xx + h_zz`, Gaussian and mean
/// curvature, from derivatives in closed form.
struct Truth {
    laplacian: f64,
    gaussian: f64,
    mean: f64,
}

impl Truth {
    fn new([x, z]: [f64; 2], [xx, xz, zz]: [f64; 3]) -> Self {
        let square = 1.0 + x * x + z * z;
        Self {
            laplacian: xx + zz,
            gaussian: (xx * zz - xz * xz) / (square * square),
            mean: (xx * (1.0 + z * z) - 2.0 * xz * x * z + zz * (1.0 + x * x))
                / (2.0 * square.powf(1.5)),
        }
    }

    fn of(&self, filter: DensityFilter) -> f64 {
        let (h, k) = (self.mean, self.gaussian);
        match filter {
            DensityFilter::SecondOrder => self.laplacian.abs(),
            DensityFilter::Gaussian => k.abs(),
            DensityFilter::Principal => h.abs() + (h * h - k).max(0.0).sqrt(),
            _ => h.abs(),
        }
    }
}

/// Curvature per metre (squared, for the Gaussian) as a filter sees it.
fn seen(
    filter: DensityFilter,
    surface: impl Fn(f64, f64) -> f64,
    at: [f64; 2],
    spacing: f64,
) -> f64 {
    let (ring, unit) = ring(surface, at, spacing);
    let normalised = filter.curvature(&ring, unit);
    match filter {
        DensityFilter::Gaussian => normalised / (spacing * spacing),
        _ => normalised / spacing,
    }
}

fn assert_near(found: f64, wanted: f64, tolerance: f64, what: &str) {
    assert!(
        (found - wanted).abs() <= tolerance,
        "{what}: {found} where {wanted} is right"
    );
}

fn sphere(radius: f64) -> impl Fn(f64, f64) -> f64 + Copy {
    move |x, z| (radius * radius - x * x - z * z).sqrt()
}

#[test]
fn planes_do_not_bend() {
    for slope in [
        [0.0, 0.0],
        [0.3, -0.2],
        [1.0, 1.0],
        [-5.0, 2.0],
        [40.0, -70.0],
    ] {
        for filter in DensityFilter::ALL {
            let plane = |x: f64, z: f64| slope[0] * x + slope[1] * z + 300.0;
            let found = seen(filter, plane, [3.0, 5.0], 0.5);
            assert_near(found, 0.0, 1e-9, &format!("{filter} on slope {slope:?}"));
        }
    }
}

#[test]
fn a_sphere_has_mean_curvature_1_over_r_and_gaussian_1_over_r_squared() {
    for radius in [2.0, 10.0, 500.0] {
        for [x, z] in [[0.0, 0.0], [0.3, 0.0], [0.2, -0.4], [-0.5, 0.5]] {
            let at = [x * radius, z * radius];
            let spacing = radius * 1e-3;
            let near = |filter, wanted: f64| {
                let found = seen(filter, sphere(radius), at, spacing);
                let what = format!("{filter} on a sphere of {radius} at {at:?}");
                assert_near(found, wanted, wanted * 2e-5, &what);
            };
            near(DensityFilter::Gaussian, 1.0 / (radius * radius));
            near(DensityFilter::Mean, 1.0 / radius);
            near(DensityFilter::LaplaceBeltrami, 1.0 / radius);
            near(DensityFilter::LaplaceBeltramiVoronoi, 1.0 / radius);
        }
        // Both principal curvatures are equal, and the root of their difference is ill-conditioned.
        let found = seen(
            DensityFilter::Principal,
            sphere(radius),
            [0.0, 0.0],
            radius * 1e-3,
        );
        assert_near(found, 1.0 / radius, 2e-5 / radius, "principal on a sphere");
        // At the top the second differences add up to twice the mean curvature.
        let found = seen(
            DensityFilter::SecondOrder,
            sphere(radius),
            [0.0, 0.0],
            radius * 1e-3,
        );
        assert_near(
            found,
            2.0 / radius,
            2e-5 / radius,
            "second-order on a sphere",
        );
    }
}

#[test]
fn a_cylinder_has_half_the_curvature_of_its_circle_and_no_gaussian() {
    let radius = 8.0_f64;
    // Along the axes and across them.
    for direction in [[1.0, 0.0], [0.0, 1.0], [0.6, 0.8], [-0.28, 0.96]] {
        let cylinder = |x: f64, z: f64| {
            let across = direction[0] * x + direction[1] * z;
            (radius * radius - across * across).sqrt()
        };
        let at = [direction[0] * 2.0 + 1.0, direction[1] * 2.0 - 0.7];
        for filter in DensityFilter::ALL {
            let wanted = match filter {
                DensityFilter::Gaussian => 0.0,
                DensityFilter::Principal => 1.0 / radius,
                DensityFilter::SecondOrder => continue,
                _ => 0.5 / radius,
            };
            let found = seen(filter, cylinder, at, 0.01);
            assert_near(
                found,
                wanted,
                1e-6,
                &format!("{filter} along {direction:?}"),
            );
        }
    }
}

#[test]
fn a_symmetric_saddle_has_negative_gaussian_no_mean_and_is_seen_by_principal() {
    let saddle = |x: f64, z: f64| 0.05 * (x * x - z * z);
    let (around, unit) = ring(saddle, [0.0, 0.0], 1.0);
    assert_near(gaussian(&around, unit), -0.01, 1e-12, "gaussian");
    assert_near(mean(&around, unit), 0.0, 1e-12, "mean");
    assert_near(second_order(&around, unit), 0.0, 1e-12, "second-order");
    assert_near(principal(&around, unit), 0.1, 1e-12, "principal");
    for found in [
        laplace_beltrami(&around, unit),
        laplace_beltrami_voronoi(&around, unit),
    ] {
        assert_near(found, 0.0, 1e-3, "laplace-beltrami");
    }
    // Its other half, whose bends run along the diagonals.
    let twisted = |x: f64, z: f64| 0.1 * x * z;
    let (around, unit) = ring(twisted, [0.0, 0.0], 1.0);
    assert_near(gaussian(&around, unit), -0.01, 1e-12, "gaussian");
    assert_near(principal(&around, unit), 0.1, 1e-12, "principal");
}

#[test]
fn signs_tell_pits_from_peaks() {
    let pit = |x: f64, z: f64| 0.1 * (x * x + 2.0 * z * z);
    let (around, unit) = ring(pit, [0.0, 0.0], 1.0);
    assert!(mean(&around, unit) > 0.0 && gaussian(&around, unit) > 0.0);
    let (around, unit) = ring(|x, z| -pit(x, z), [0.0, 0.0], 1.0);
    assert!(mean(&around, unit) < 0.0 && gaussian(&around, unit) > 0.0);
}

#[test]
fn a_paraboloid_is_right_at_its_apex_and_off_it() {
    let paraboloid = |x: f64, z: f64| 0.5 * (0.3 * x * x + 0.7 * z * z + 0.2 * x * z);
    for at in [[0.0, 0.0], [1.0, 0.0], [0.0, -2.0], [1.5, 0.8], [-4.0, 3.0]] {
        let [x, z] = at;
        let truth = Truth::new([0.3 * x + 0.1 * z, 0.7 * z + 0.1 * x], [0.3, 0.1, 0.7]);
        for filter in DensityFilter::ALL {
            let found = seen(filter, paraboloid, at, 1e-3);
            let wanted = truth.of(filter);
            let what = format!("{filter} at {at:?}");
            assert_near(found, wanted, 1e-5 + wanted * 1e-5, &what);
        }
    }
}

/// A surface without any symmetry, and its derivatives.
fn hills(x: f64, z: f64) -> f64 {
    (x * 0.9).sin() * (z * 0.7 + 0.3).cos() + 0.2 * (x * 0.4 - z * 0.8).sin()
}

fn hills_truth(x: f64, z: f64) -> Truth {
    let (sx, cx) = (x * 0.9).sin_cos();
    let (sz, cz) = (z * 0.7 + 0.3).sin_cos();
    let (s, c) = (x * 0.4 - z * 0.8).sin_cos();
    Truth::new(
        [
            0.9 * cx * cz + 0.2 * 0.4 * c,
            -0.7 * sx * sz - 0.2 * 0.8 * c,
        ],
        [
            -0.81 * sx * cz - 0.2 * 0.16 * s,
            -0.63 * cx * sz + 0.2 * 0.32 * s,
            -0.49 * sx * cz - 0.2 * 0.64 * s,
        ],
    )
}

#[test]
fn errors_fall_to_a_quarter_when_the_spacing_is_halved() {
    for filter in DensityFilter::ALL {
        // The root mean square over many points: at single ones the error may cross zero.
        let error = |spacing: f64| {
            let mut sum = 0.0;
            for at in 0..400 {
                let (x, z) = (
                    f64::from(at % 20) * 0.37 - 3.1,
                    f64::from(at / 20) * 0.41 - 2.7,
                );
                let wanted = hills_truth(x, z).of(filter);
                sum += (seen(filter, hills, [x, z], spacing) - wanted).powi(2);
            }
            (sum / 400.0).sqrt()
        };
        let spacings = [0.08, 0.04, 0.02, 0.01];
        for pair in spacings.windows(2) {
            let order = (error(pair[0]) / error(pair[1])).log2();
            // A principal curvature has a kink where the two are equal.
            let least = if filter == DensityFilter::Principal {
                1.7
            } else {
                1.9
            };
            assert!(
                (least..2.1).contains(&order),
                "{filter} from {} to {}: order {order}",
                pair[0],
                pair[1]
            );
        }
    }
}

/// Triangles on a steep slope are obtuse, and the Voronoi area as printed would be negative there.
#[test]
fn obtuse_triangles_do_not_turn_the_area_negative() {
    for steepness in [1.0, 3.0, 10.0, 100.0] {
        let surface = |x: f64, z: f64| steepness * (x - z) + 0.01 * (x * x + z * z);
        let derivatives = [steepness, -steepness];
        let truth = Truth::new(derivatives, [0.02, 0.0, 0.02]);
        let found = seen(
            DensityFilter::LaplaceBeltramiVoronoi,
            surface,
            [0.0, 0.0],
            0.01,
        );
        let wanted = truth.of(DensityFilter::Mean);
        assert_near(found, wanted, wanted * 1e-2 + 1e-9, &format!("{steepness}"));
    }
}

/// The thesis's example: 100 m, and 50 m around it, a metre apart. The mean curvature of the
/// spike's neighbours is tiny, as equation 3.6 says, and that of the spike itself is large.
#[test]
fn the_spike_of_table_3_1_is_flat_beside_itself() {
    let spike = |x: f64, z: f64| if x == 0.0 && z == 0.0 { 100.0 } else { 50.0 };
    let beside = seen(DensityFilter::Mean, spike, [-1.0, 0.0], 1.0);
    assert_near(
        beside,
        25.0 / (626.0_f64).powf(1.5),
        1e-9,
        "beside the spike",
    );
    assert_near(
        seen(DensityFilter::Mean, spike, [0.0, 0.0], 1.0),
        100.0,
        1e-9,
        "on it",
    );
}

proptest! {
    #[test]
    fn any_heights_have_a_finite_curvature(
        heights in prop::array::uniform9(any::<u16>()),
        step in prop_oneof![0.0_f32..1e-3, 0.0_f32..1.0, 0.0_f32..1000.0, Just(1000.0_f32)],
    ) {
        let ring = Ring::new(|x, z| f32::from(heights[(3 * z + x + 4) as usize]));
        for filter in DensityFilter::ALL {
            let curvature = filter.curvature(&ring, step);
            prop_assert!(curvature.is_finite() && curvature >= 0.0, "{filter}: {curvature}");
        }
    }

    #[test]
    fn single_precision_agrees_with_double(
        heights in prop::array::uniform9(0_u16..2000),
        step in 1e-3_f32..0.5,
    ) {
        let single = Ring::new(|x, z| f32::from(heights[(3 * z + x + 4) as usize]));
        let double = Ring::new(|x, z| f64::from(heights[(3 * z + x + 4) as usize]));
        for filter in DensityFilter::ALL {
            let found = f64::from(filter.curvature(&single, step));
            let wanted = filter.curvature(&double, f64::from(step));
            // Terms cancel out: errors are relative to the largest of them.
            let scale = match filter {
                DensityFilter::SecondOrder => f64::from(step) * 8000.0,
                _ => 1.0 + wanted,
            };
            prop_assert!((found - wanted).abs() <= 2e-3 * scale, "{filter}: {found}, {wanted}");
        }
    }
}
