#define_import_path bevy_tessera::surface

// What a fragment knows of the ground, and where it comes from. A game's own material receives
// `TerrainSurface`; see `material.wgsl` for the default one.

#import bevy_tessera::detail::{Detail, detail_fade, detail_noise, detail_weight}
#import bevy_tessera::types::{ONE, TerrainDraw, TILE_BORDER, TILE_STORED, TILE_SAMPLES, PAGES_ACROSS, NO_PAGE}

@group(2) @binding(0) var<uniform> terrain_draw: TerrainDraw;
// The page table; from `terrain_draw.mask_first` on, the destruction mask. One buffer, because some of
// Bevy's passes leave no more than one on a device with WebGPU's limits.
@group(2) @binding(1) var<storage, read> surface_tables: array<u32>;
@group(2) @binding(2) var gradient_pages: texture_2d_array<f32>;
@group(2) @binding(3) var gradient_sampler: sampler;
@group(2) @binding(4) var<uniform> surface_detail: Detail;

// Eight numbers of four that a material may be given from Rust, `TerrainMaterial::parameters`.
@group(3) @binding(0) var<uniform> material_parameters: array<vec4<f32>, 8>;

struct TerrainSurface {
    // World position, metres.
    world_position: vec3<f32>,
    // Position in the terrain: metres from its first sample, and above its origin.
    local_position: vec3<f32>,
    // Height above the terrain's origin, metres.
    height_m: f32,
    // 0 where the ground is level, 1 where it is vertical: one minus the normal's upward part.
    slope: f32,
    // World normal, one long, filtered from the heights for this pixel.
    normal: vec3<f32>,
    // The pixel, as in the fragment's @builtin(position).
    frag_coord: vec4<f32>,
    // From the eye that the mesh was made for, metres of the terrain's own x and z: exact where
    // `local_position` is rounded, far from the first sample.
    from_eye_m: vec2<f32>,
    // How wide the pixel is on the ground, along the longer of its sides, metres.
    footprint_m: f32,
}

// A page, and where in its tile a place lies, in samples of its level from the tile's first own.
struct SurfacePage {
    page: u32,
    local: vec2<f32>,
#ifdef TERRAIN_OVERLAY
    level: i32,
#endif
}

// The page that is to be read for a place, counted in samples of level 0, at one level or, where
// that isn't resident, at the next that is. `NO_PAGE` where none is.
fn surface_page(from_first: vec2<f32>, wanted: i32) -> SurfacePage {
    var level = wanted;
    var found: SurfacePage;
    loop {
        let level_tiles = terrain_draw.tiles[level];
        let place = from_first / f32(1u << u32(level));
        let tile = clamp(
            vec2<i32>(floor(place / f32(TILE_SAMPLES))),
            vec2(0),
            vec2<i32>(level_tiles.yz) - 1,
        );
        found.page = surface_tables[level_tiles.x + u32(tile.y) * level_tiles.y + u32(tile.x)];
        found.local = place - vec2<f32>(tile * TILE_SAMPLES);
#ifdef TERRAIN_OVERLAY
        found.level = level;
#endif
        if found.page != NO_PAGE || level >= terrain_draw.root_level {
            break;
        }
        level++;
    }
    return found;
}

// Gradient of the height at a place counted in samples of level 0. x, y: rise per metre.
fn level_gradient(place: vec2<f32>, wanted: i32) -> vec2<f32> {
    let found = surface_page(place, wanted);
    if found.page == NO_PAGE {
        return vec2(0.0);
    }
    let page = found.page;
    // The samples that a page can be asked for, whatever float arithmetic made of the place.
    let texel = clamp(
        found.local + f32(TILE_BORDER) + 0.5,
        vec2(1.5),
        vec2(f32(TILE_STORED) - 1.5),
    );
    let origin = vec2(page % PAGES_ACROSS, (page / PAGES_ACROSS) % PAGES_ACROSS);
    let uv = (vec2<f32>(origin) * f32(TILE_STORED) + texel)
        / f32(i32(PAGES_ACROSS) * TILE_STORED);
    let layer = page / (PAGES_ACROSS * PAGES_ACROSS);
    return textureSampleLevel(gradient_pages, gradient_sampler, uv, layer, 0.0).rg;
}

// The two levels that a level of detail lies between, and how far it is from the finer one.
struct SurfaceLevel {
    fine: i32,
    coarse: i32,
    blend: f32,
}

fn surface_level(lambda: f32) -> SurfaceLevel {
    let clamped = clamp(lambda, 0.0, f32(terrain_draw.root_level));
    let level = i32(floor(clamped));
    return SurfaceLevel(level, min(level + 1, terrain_draw.root_level), clamped - f32(level));
}

// A place on the ground in samples of level 0.
fn sample_place(plane_from_eye_m: vec2<f32>) -> vec2<f32> {
    return vec2<f32>(terrain_draw.eye_sample)
        + (terrain_draw.eye_sample_fraction + plane_from_eye_m / terrain_draw.spacing_m);
}

// Slope of the detail at a place that has some, for a pixel that is `footprint_m` wide.
fn surface_detail_gradient(
    plane_from_eye_m: vec2<f32>,
    height_m: f32,
    stored: vec2<f32>,
    footprint_m: f32,
) -> vec2<f32> {
    let from_eye = plane_from_eye_m / terrain_draw.unit_m + terrain_draw.eye_fraction;
    let p = terrain_draw.eye_point + vec2<i32>(floor(from_eye));
    let weight = detail_weight(surface_detail, height_m, stored);
    let finest = i32(log2(max(footprint_m / terrain_draw.unit_m, 1e-3)) * f32(ONE));
    var sum = vec2(0.0);
    for (var i = 0u; i < min(surface_detail.octave_count, 8u); i++) {
        let fade = detail_fade(surface_detail.octaves[i].cell_shift, finest);
        if fade == 0.0 || weight == 0.0 {
            break;
        }
        let noise = detail_noise(surface_detail.octaves[i], p);
        sum += surface_detail.octaves[i].amplitude_m * fade * noise.yz;
    }
    return sum * (weight / surface_detail.unit_m);
}

// Normal in the terrain's own frame, blended over two levels like the heights; detail included, as far
// as a pixel that is `footprint_m` wide can show it.
fn terrain_normal(
    plane_from_eye_m: vec2<f32>,
    lambda: f32,
    height_m: f32,
    footprint_m: f32,
) -> vec3<f32> {
    let place = sample_place(plane_from_eye_m);
    let level = surface_level(lambda);
    var gradient = level_gradient(place, level.fine);
    if level.blend > 0.0 {
        gradient = mix(gradient, level_gradient(place, level.coarse), level.blend);
    }
    if surface_detail.octave_count > 0u {
        gradient += surface_detail_gradient(plane_from_eye_m, height_m, gradient, footprint_m);
    }
    return normalize(vec3(-gradient.x, 1.0, -gradient.y));
}
