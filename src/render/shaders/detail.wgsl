#define_import_path bevy_tessera::detail

// Twin of `src/detail`: noise that is added to the stored heights, operation for operation.

#import bevy_tessera::types::{ONE, DENSITY_ONE}

// Pairs of the structs in `src/detail/kernel.rs`.
struct DetailOctave {
    // What points are multiplied by, as complex numbers; of length 65.
    turn: vec2<i32>,
    // What is then added.
    offset: vec2<u32>,
    // Side of a cell in turned units, as a power of two: 6 more than the wavelength's.
    cell_shift: u32,
    // One over the side of a cell; exact.
    per_cell: f32,
    amplitude_m: f32,
    salt: u32,
}

struct Detail {
    // Coarse ones first.
    octaves: array<DetailOctave, 8>,
    octave_count: u32,
    rule: u32,
    // Where the rule's weight is 0, and one over the way from there to 1.
    rule_from: f32,
    rule_rate: f32,
    unit_m: f32,
    density_per_weight: f32,
    amplitude_m: f32,
    unused: u32,
}

const DETAIL_EVERYWHERE: u32 = 0u;
const DETAIL_SLOPE: u32 = 1u;
const DETAIL_HEIGHT: u32 = 2u;
// Turned cells are two to this power wavelengths long.
const DETAIL_TURN_SHIFT: u32 = 6u;
const DETAIL_NOISE_SCALE: f32 = 1.41;

// Mixes all bits of a number.
fn detail_mix(bits: u32) -> u32 {
    var x = (bits ^ (bits >> 16u)) * 0x7feb352du;
    x = (x ^ (x >> 15u)) * 0x846ca68bu;
    return x ^ (x >> 16u);
}

// The sines of pi t, t in -1..=1, by a polynomial.
fn detail_turn_sines(t: vec2<f32>) -> vec2<f32> {
    let s = 4.0 * t * (1.0 - abs(t));
    return s * (0.775 + 0.225 * abs(s));
}

// The direction of a cell's corner, one long.
fn detail_corner(x: u32, z: u32, salt: u32) -> vec2<f32> {
    let bits = detail_mix((x * 0x9e3779b1u + z * 0x85ebca77u) ^ salt);
    let t = f32(bits >> 8u) * (1.0 / 8388608.0) - 1.0;
    let quarter_on = select(t + 0.5, t - 1.5, t >= 0.5);
    return detail_turn_sines(vec2(quarter_on, t));
}

// An octave's noise at p, -1..=1, then its rise per lattice unit in x and z.
fn detail_noise(octave: DetailOctave, p: vec2<i32>) -> vec3<f32> {
    let turn = bitcast<vec2<u32>>(octave.turn);
    let at = bitcast<vec2<u32>>(p);
    // Wrapping is as good as any place: the cells are counted modulo what 32 bits hold.
    let q = vec2(turn.x * at.x - turn.y * at.y, turn.y * at.x + turn.x * at.y) + octave.offset;
    let shift = octave.cell_shift;
    let last = 0xffffffffu >> shift;
    let low = q >> vec2(shift);
    let high = (low + 1u) & vec2(last);
    let f = vec2<f32>(q & vec2((1u << shift) - 1u)) * octave.per_cell;

    let g_near_left = detail_corner(low.x, low.y, octave.salt);
    let g_near_right = detail_corner(high.x, low.y, octave.salt);
    let g_far_left = detail_corner(low.x, high.y, octave.salt);
    let g_far_right = detail_corner(high.x, high.y, octave.salt);
    let near_left = g_near_left.x * f.x + g_near_left.y * f.y;
    let near_right = g_near_right.x * (f.x - 1.0) + g_near_right.y * f.y;
    let far_left = g_far_left.x * f.x + g_far_left.y * (f.y - 1.0);
    let far_right = g_far_right.x * (f.x - 1.0) + g_far_right.y * (f.y - 1.0);

    let u = f * f * f * (f * (f * 6.0 - 15.0) + 10.0);
    let du = 30.0 * f * f * (f - 1.0) * (f - 1.0);
    let along_x = near_right - near_left;
    let along_z = far_left - near_left;
    let twist = near_left - near_right - far_left + far_right;
    let value = near_left + u.x * along_x + u.y * along_z + u.x * u.y * twist;
    let slope = g_near_left
        + u.x * (g_near_right - g_near_left)
        + u.y * (g_far_left - g_near_left)
        + u.x * u.y * (g_near_left - g_near_right - g_far_left + g_far_right)
        + du * vec2(along_x + u.y * twist, along_z + u.x * twist);

    // Back from the turned cells to the lattice.
    let back = vec2<f32>(octave.turn);
    let rise = vec2(back.x * slope.x + back.y * slope.y, back.x * slope.y - back.y * slope.x)
        * octave.per_cell;
    return vec3(value, rise) * DETAIL_NOISE_SCALE;
}

// How much of an octave is left where vertices stand 2^finest_log lattice units apart (16.16): all
// from four vertices a wavelength on, nothing up to two.
fn detail_fade(cell_shift: u32, finest_log: i32) -> f32 {
    let wave_log = i32(cell_shift - DETAIL_TURN_SHIFT);
    let above = (wave_log - 1) * ONE - clamp(finest_log, -64 * ONE, 64 * ONE);
    return f32(clamp(above, 0, ONE)) * (1.0 / f32(ONE));
}

// The rule: how much detail ground gets, 0..=1, by its stored height in metres and its stored
// slope in x and z, rise per metre.
fn detail_weight(detail: Detail, height_m: f32, gradient: vec2<f32>) -> f32 {
    var measure = height_m;
    if detail.rule == DETAIL_EVERYWHERE {
        return 1.0;
    }
    if detail.rule == DETAIL_SLOPE {
        // The squared sine of the angle, which needs no arctangent.
        measure = 1.0 - 1.0 / (1.0 + (gradient.x * gradient.x + gradient.y * gradient.y));
    }
    let t = clamp((measure - detail.rule_from) * detail.rule_rate, 0.0, 1.0);
    return t * t * (3.0 - 2.0 * t);
}

// The least density of ground with detail of this weight, in 8.16.
fn detail_density(detail: Detail, weight: f32) -> u32 {
    return u32(ceil(clamp(weight * detail.density_per_weight, 0.0, 1.0) * DENSITY_ONE));
}
