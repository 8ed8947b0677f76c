#define_import_path bevy_tessera::height

// Twin of `src/tessellate/height.rs`: the one height function.

#import bevy_tessera::types::{ONE, TILE_SAMPLES, TILE_BORDER, TILE_STORED, PAGES_ACROSS}
#import bevy_tessera::bindings::{terrain_view, page_table, height_pages}
#import bevy_tessera::lattice::node_shift

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

// Height in metres at p read at level of detail lambda (16.16).
fn height_m(p: vec2<i32>, lambda: i32) -> f32 {
    let level = u32(lambda >> 16u);
    let blend = f32(lambda & (ONE - 1)) / f32(ONE);
    var stored = level_height(p, level);
    if blend > 0.0 {
        let coarse = level_height(p, level + 1u);
        stored = stored + (coarse - stored) * blend;
    }
    return terrain_view.height_min_m + stored * terrain_view.height_step_m;
}
