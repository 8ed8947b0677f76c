#define_import_path bevy_tessera::height

// Twin of `src/tessellate/height.rs`: the one height function.

#import bevy_tessera::types::{ONE, TILE_SAMPLES, TILE_BORDER, TILE_STORED, PAGES_ACROSS}
#import bevy_tessera::bindings::{terrain_view, page_table, height_pages, terrain_detail}
#import bevy_tessera::lattice::{clamp_point, lambda_at, morph, node_shift, view_distance}
#import bevy_tessera::detail::{DETAIL_SLOPE, detail_fade, detail_noise, detail_weight}

// Column and row of a page in its atlas layer.
fn page_place(page: u32) -> vec2<i32> {
    return vec2<i32>(vec2(page % PAGES_ACROSS, (page / PAGES_ACROSS) % PAGES_ACROSS));
}

// First texel of a page of heights in its atlas layer.
fn page_origin(page: u32) -> vec2<i32> {
    return page_place(page) * TILE_STORED;
}

fn page_layer(page: u32) -> u32 {
    return page / (PAGES_ACROSS * PAGES_ACROSS);
}

// The tile of a level that holds p; the terrain's last point belongs to the last tile.
fn tile_at(p: vec2<i32>, level: u32) -> vec2<i32> {
    let log2 = node_shift(i32(level));
    let last = max(terrain_view.extent - 1, vec2(0)) >> vec2(log2);
    return clamp(p >> vec2(log2), vec2(0), last);
}

fn tile_page(tile: vec2<i32>, level: u32) -> u32 {
    let level_tiles = terrain_view.tiles[level];
    return page_table[level_tiles.x + u32(tile.y) * level_tiles.y + u32(tile.x)];
}

// Stored height at p read from one level, bilinear between samples.
fn level_height(p: vec2<i32>, level: u32) -> f32 {
    let tile = tile_at(p, level);
    let page = tile_page(tile, level);

    let shift = terrain_view.unit_shift + level;
    let sample = p >> vec2(shift);
    let weight = vec2<f32>(p - (sample << vec2(shift))) / f32(1u << shift);
    let texel = sample - tile * TILE_SAMPLES + TILE_BORDER + page_origin(page);
    let layer = page_layer(page);
    let h00 = f32(textureLoad(height_pages, texel, layer, 0).r);
    let h10 = f32(textureLoad(height_pages, texel + vec2(1, 0), layer, 0).r);
    let h01 = f32(textureLoad(height_pages, texel + vec2(0, 1), layer, 0).r);
    let h11 = f32(textureLoad(height_pages, texel + vec2(1, 1), layer, 0).r);
    let near = h00 + (h10 - h00) * weight.x;
    let far = h01 + (h11 - h01) * weight.x;
    return near + (far - near) * weight.y;
}

// Stored height in metres at p read at level of detail lambda (16.16).
fn stored_m(p: vec2<i32>, lambda: i32) -> f32 {
    let level = u32(lambda >> 16u);
    let blend = f32(lambda & (ONE - 1)) / f32(ONE);
    var stored = level_height(p, level);
    if blend > 0.0 {
        let coarse = level_height(p, level + 1u);
        stored = stored + (coarse - stored) * blend;
    }
    return terrain_view.height_min_m + stored * terrain_view.height_step_m;
}

// Logarithm of the spacing of vertices at p that the view can afford, in lattice units, 16.16: by the
// wanted width of a triangle there, and by the finest cut of the level's faces.
fn finest_log(p: vec2<i32>, level: i32) -> i32 {
    var width: f32;
    if terrain_view.segments_per_m > 0.0 {
        width = 1.0 / (terrain_view.segments_per_m * terrain_view.unit_m);
    } else {
        width = f32(max(view_distance(p), 1)) / terrain_view.segments_per_radian;
    }
    let cut = f32(node_shift(level) - terrain_view.faces_shift) - log2(terrain_view.max_factor);
    let by_face = i32(cut * f32(ONE)) + morph(p, level);
    return max(i32(log2(width) * f32(ONE)), by_face);
}

// The rule's weight of detail at p, where the stored height is known already.
fn weight_at(p: vec2<i32>, level: i32, height: f32) -> f32 {
    var gradient = vec2(0.0);
    if terrain_detail.rule == DETAIL_SLOPE {
        let shift = terrain_view.unit_shift + u32(lambda_at(p, level) >> 16u);
        let reach = 1 << shift;
        for (var axis = 0u; axis < 2u; axis++) {
            var step = vec2(0);
            step[axis] = reach;
            let low = clamp_point(p - step);
            let high = clamp_point(p + step);
            let rise = stored_m(high, lambda_at(high, level)) - stored_m(low, lambda_at(low, level));
            gradient[axis] = rise / (f32(high[axis] - low[axis]) * terrain_view.unit_m);
        }
    }
    return detail_weight(terrain_detail, height, gradient);
}

// Where the ground is drawn at p by a node of a level, metres, and the weight of detail there.
fn displaced_m(p: vec2<i32>, level: i32) -> vec2<f32> {
    let height = stored_m(p, lambda_at(p, level));
    if terrain_detail.octave_count == 0u {
        return vec2(height, 0.0);
    }
    let weight = weight_at(p, level, height);
    let finest = finest_log(p, level);
    var sum = 0.0;
    for (var i = 0u; i < min(terrain_detail.octave_count, 8u); i++) {
        let fade = detail_fade(terrain_detail.octaves[i].cell_shift, finest);
        // All others are finer still.
        if fade == 0.0 || weight == 0.0 {
            break;
        }
        let noise = detail_noise(terrain_detail.octaves[i], p);
        sum += terrain_detail.octaves[i].amplitude_m * fade * noise.x;
    }
    return vec2(height + sum * weight, weight);
}
