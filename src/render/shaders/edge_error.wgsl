#define_import_path bevy_tessera::edge_error

// Twin of `src/tessellate/edge_error.rs`: how much error triangles may leave on ground.

#import bevy_tessera::bindings::{terrain_view, error_pages}
#import bevy_tessera::edge_density::{
    Square, square_texels, texel_at, texel_centre, texel_lambda,
}

// More than any terrain's relief, so that a blend with weights of 256 stays below 32 bits.
const MOST_ERROR: u32 = 8388607u;

// The error that a stored byte stands for, in 64ths of a stored height's step.
fn decode_error(byte: u32) -> u32 {
    if byte == 0u {
        return 0u;
    }
    let exponent = (byte - 1u) >> 3u;
    if exponent > 19u {
        return MOST_ERROR;
    }
    return min((8u + ((byte - 1u) & 7u)) << exponent, MOST_ERROR);
}

// Bounds of a level as those of one `levels` finer: by the same distance on the ground.
fn shifted_errors(bounds_in: array<u32, 7>, levels: u32) -> array<u32, 7> {
    var bounds = bounds_in;
    var out: array<u32, 7>;
    for (var k = 0u; k < 7u; k++) {
        if k >= levels {
            out[k] = bounds[k - levels];
        } else {
            // Below a sample's distance the error falls with the distance.
            let finer = min(levels - k, 31u);
            out[k] = (bounds[0] + ((1u << finer) - 1u)) >> finer;
        }
    }
    return out;
}

// In parts of 256, rounded up.
fn blended_errors(fine_in: array<u32, 7>, coarse_in: array<u32, 7>, part: u32) -> array<u32, 7> {
    var fine = fine_in;
    var coarse = coarse_in;
    for (var k = 0u; k < 7u; k++) {
        fine[k] = (fine[k] * (256u - part) + coarse[k] * part + 255u) >> 8u;
    }
    return fine;
}

// The level that errors of faces of `level` are read from, and whose samples they count in: never a
// finer one than is drawn, and while faces morph, the next one is too.
fn error_level(level: i32) -> u32 {
    return u32(clamp(level + 1, 0, terrain_view.root_level));
}

fn level_errors(p: vec2<i32>, level: u32) -> array<u32, 7> {
    let at = texel_at(p, level);
    let words = textureLoad(error_pages, at.xy, at.z, 0).rg;
    var bounds: array<u32, 7>;
    for (var k = 0u; k < 7u; k++) {
        bounds[k] = decode_error((words[k / 4u] >> (8u * (k % 4u))) & 255u);
    }
    return bounds;
}

fn texel_errors(texel: vec2<i32>, level: u32) -> array<u32, 7> {
    let centre = texel_centre(texel, level);
    let lambda = texel_lambda(centre, level);
    let read = lambda >> 8u;
    let fine = shifted_errors(level_errors(centre, read), read - level);
    let blend = lambda & 255u;
    if blend == 0u {
        return fine;
    }
    let coarse = shifted_errors(level_errors(centre, read + 1u), read + 1u - level);
    return blended_errors(fine, coarse, blend);
}

fn square_errors(square: Square) -> array<u32, 7> {
    let level = error_level(square.level);
    let texels = square_texels(square, level);
    var largest: array<u32, 7>;
    for (var z = texels.y; z <= texels.w; z++) {
        for (var x = texels.x; x <= texels.z; x++) {
            var bounds = texel_errors(vec2(x, z), level);
            for (var k = 0u; k < 7u; k++) {
                largest[k] = max(largest[k], bounds[k]);
            }
        }
    }
    return largest;
}

// The bound at edges of `spacing` samples: what `error_spacing` turns round. Beyond the last entry it
// goes on as it rose to it.
fn error_at(bounds_in: array<u32, 7>, spacing: f32) -> f32 {
    var bounds = bounds_in;
    if spacing <= 1.0 {
        return f32(bounds[0]) * spacing;
    }
    var cut_length = 1.0;
    var k = 1u;
    while k < 6u && spacing > 2.0 * cut_length {
        cut_length *= 2.0;
        k++;
    }
    let low = f32(bounds[k - 1u]);
    let high = f32(bounds[k]);
    let longer = spacing / cut_length;
    return low + (high - low) * ((longer * longer - 1.0) / 3.0);
}

// The longest edge, in samples, whose triangles leave no more than `allowed`.
fn error_spacing(bounds_in: array<u32, 7>, allowed: f32) -> f32 {
    var bounds = bounds_in;
    let first = f32(bounds[0]);
    if allowed < first {
        return allowed / first;
    }
    var spacing = 1.0;
    for (var k = 1u; k < 7u; k++) {
        let low = f32(bounds[k - 1u]);
        let high = f32(bounds[k]);
        if allowed < high {
            return spacing * sqrt(1.0 + 3.0 * ((allowed - low) / (high - low)));
        }
        spacing *= 2.0;
    }
    return spacing;
}
