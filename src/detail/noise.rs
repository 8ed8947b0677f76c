//! Gradient noise of one octave. `shaders/detail.wgsl` does the same, operation for operation.

use super::DetailOctave;
use glam::{IVec2, Vec2, Vec3};

/// Length of the vectors that octaves are turned by, [`TURNS`].
pub(super) const TURN_LENGTH: f32 = 65.0;
/// The power of two next to that length. A turned cell is `2^TURN_LOG2` times its wavelength long,
/// which makes wavelengths 64/65 of what their power of two says.
pub(super) const TURN_LOG2: u32 = 6;
/// An integer vector for each octave, all of length 65: multiplying a point by one of them, as a
/// complex number, turns it without leaving the integers. The grid lines of no two octaves run the
/// same way, and none along the terrain's own; neighbours are far apart. The angles, in degrees: 14,
/// 59, 31, 76, 37, 67, 23, 53.
pub(super) const TURNS: [[i32; 2]; super::DETAIL_OCTAVES] = [
    [63, 16],
    [33, 56],
    [56, 33],
    [16, 63],
    [52, 39],
    [25, 60],
    [60, 25],
    [39, 52],
];

/// What takes the noise of unit gradients, at most `√½` in the middle of a cell, to -1..=1. A
/// little less than `√2`, because gradients are up to a thousandth longer than 1.
const NOISE_SCALE: f32 = 1.41;

/// Mixes all bits of `x` (Wellons, "lowbias32").
pub(super) fn mix(x: u32) -> u32 {
    let x = (x ^ (x >> 16)).wrapping_mul(0x7feb_352d);
    let x = (x ^ (x >> 15)).wrapping_mul(0x846c_a68b);
    x ^ (x >> 16)
}

/// The sine of `π t`, for `t` in -1..=1, within 0.0011: a polynomial, where library functions of
/// GPUs differ.
fn turn_sine(t: f32) -> f32 {
    let s = 4.0 * t * (1.0 - t.abs());
    s * (0.775 + 0.225 * s.abs())
}

/// The direction of a cell's corner, as good as one long: any angle is as likely as any other.
fn corner(x: u32, z: u32, salt: u32) -> Vec2 {
    let bits = mix((x
        .wrapping_mul(0x9e37_79b1)
        .wrapping_add(z.wrapping_mul(0x85eb_ca77)))
        ^ salt);
    // 24 bits, which a float holds: -1..1 in half turns.
    let t = (bits >> 8) as f32 * (1.0 / 8_388_608.0) - 1.0;
    let quarter_on = if t >= 0.5 { t - 1.5 } else { t + 0.5 };
    Vec2::new(turn_sine(quarter_on), turn_sine(t))
}

/// The octave's noise at `p`, -1..=1, then its rise per lattice unit in x and z.
pub(super) fn noise(octave: &DetailOctave, p: IVec2) -> Vec3 {
    let shift = octave.cell_shift;
    // Wrapping is as good as any place: the cells are counted modulo what 32 bits hold, so that
    // the noise goes on across it.
    let [turn_x, turn_z] = octave.turn.map(i32::cast_unsigned);
    let (x, z) = (p.x.cast_unsigned(), p.y.cast_unsigned());
    let qx = turn_x
        .wrapping_mul(x)
        .wrapping_sub(turn_z.wrapping_mul(z))
        .wrapping_add(octave.offset[0]);
    let qz = turn_z
        .wrapping_mul(x)
        .wrapping_add(turn_x.wrapping_mul(z))
        .wrapping_add(octave.offset[1]);
    let last = u32::MAX >> shift;
    let (x0, z0) = (qx >> shift, qz >> shift);
    let (x1, z1) = ((x0 + 1) & last, (z0 + 1) & last);
    let inside = (1_u32 << shift) - 1;
    let f = Vec2::new((qx & inside) as f32, (qz & inside) as f32) * octave.per_cell;

    let g00 = corner(x0, z0, octave.salt);
    let g10 = corner(x1, z0, octave.salt);
    let g01 = corner(x0, z1, octave.salt);
    let g11 = corner(x1, z1, octave.salt);
    let n00 = g00.x * f.x + g00.y * f.y;
    let n10 = g10.x * (f.x - 1.0) + g10.y * f.y;
    let n01 = g01.x * f.x + g01.y * (f.y - 1.0);
    let n11 = g11.x * (f.x - 1.0) + g11.y * (f.y - 1.0);

    let u = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let du = 30.0 * f * f * (f - 1.0) * (f - 1.0);
    let along_x = n10 - n00;
    let along_z = n01 - n00;
    let twist = n00 - n10 - n01 + n11;
    let value = n00 + u.x * along_x + u.y * along_z + u.x * u.y * twist;
    let slope = g00
        + u.x * (g10 - g00)
        + u.y * (g01 - g00)
        + u.x * u.y * (g00 - g10 - g01 + g11)
        + du * Vec2::new(along_x + u.y * twist, along_z + u.x * twist);

    // Back from the turned cells to the lattice.
    let (a, b) = (octave.turn[0] as f32, octave.turn[1] as f32);
    let back = Vec2::new(a * slope.x + b * slope.y, a * slope.y - b * slope.x) * octave.per_cell;
    Vec3::new(value, back.x, back.y) * NOISE_SCALE
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_are_all_different_and_as_long_as_each_other() {
        for (i, [a, b]) in TURNS.into_iter().enumerate() {
            assert_eq!((a * a + b * b) as f32, TURN_LENGTH * TURN_LENGTH);
            assert!(TURNS[..i].iter().all(|&other| other != [a, b]));
        }
    }

    #[test]
    fn the_sine_is_a_sine() {
        for i in -1000..=1000_i32 {
            let t = i as f32 / 1000.0;
            let off = turn_sine(t) - (std::f32::consts::PI * t).sin();
            assert!(off.abs() < 0.0011, "{t}: {off}");
        }
    }

    #[test]
    fn directions_are_one_long_and_point_everywhere() {
        let mut eighths = [0_u32; 8];
        let mut sum = Vec2::ZERO;
        for x in 0..128 {
            for z in 0..128 {
                let direction = corner(x, z, 7);
                assert!((direction.length() - 1.0).abs() < 0.0015, "{direction}");
                let eighth = (direction.to_angle() / std::f32::consts::FRAC_PI_4).floor() as i32;
                eighths[(eighth + 4).clamp(0, 7) as usize] += 1;
                sum += direction;
            }
        }
        for count in eighths {
            assert!(count.abs_diff(2048) < 200, "{eighths:?}");
        }
        assert!(sum.length() / 16_384.0 < 0.02, "{sum}");
    }

    /// Fixed, so that neither a machine nor a later version makes other ground of the same seed.
    #[test]
    fn the_hash_stays_what_it_is() {
        let found = [0, 1, 2, 0x8000_0000, u32::MAX].map(mix);
        let known = [0, 0x6889_90c0, 0xd113_2181, 0xcc4b_4124, 0x6768_824a];
        assert_eq!(found, known);
        let found =
            [(0, 0), (1, 0), (0, 1), (7, u32::MAX)].map(|(x, z)| corner(x, z, 1).to_array());
        let known = [
            [0.839_426_04, -0.544_756],
            [-0.133_585_84, 0.990_962_86],
            [0.228_190_24, -0.973_542_2],
            [-0.967_594_27, -0.252_299_64],
        ];
        assert_eq!(found, known);
    }
}
