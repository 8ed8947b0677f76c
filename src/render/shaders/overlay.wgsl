#define_import_path bevy_tessera::overlay

// What the ground is made of, in colours over it; see `TerrainOverlay`, whose legend the uniform holds.

#import bevy_pbr::pbr_types::{
    PbrInput, STANDARD_MATERIAL_FLAGS_FOG_ENABLED_BIT, STANDARD_MATERIAL_FLAGS_UNLIT_BIT,
}
#import bevy_tessera::types::{
    NO_PAGE, OVERLAYS, OVERLAY_DENSITY, OVERLAY_DESTRUCTION, OVERLAY_EDGE_FACTOR,
    OVERLAY_ERROR_BOUND, OVERLAY_LEVEL, OVERLAY_MORPH, OVERLAY_NORMALS, OVERLAY_PAGE_BORDERS,
    OVERLAY_RESIDENCY, OVERLAY_SLOPE, OVERLAY_STOPS, OVERLAY_TRIANGLE_SIZE, OVERLAY_WIREFRAME,
    PAGES_ACROSS, TILE_SAMPLES, TerrainOverlays,
}
#import bevy_tessera::density_texel::{density_texel, unpacked_density}
#import bevy_tessera::destruction::destruction_mask
#import bevy_tessera::surface::{
    TerrainSurface, sample_place, surface_level, surface_page, terrain_draw,
}

@group(2) @binding(6) var<uniform> overlays: TerrainOverlays;
// The atlas of stored densities, row by row, layer by layer; four texels a word.
@group(2) @binding(7) var<storage, read> stored_densities: array<u32>;

// Texels along a page's side.
const TEXELS: u32 = 32u;
// Half the width of a line of the wireframe and of a page's border, pixels.
const WIRE_PX: f32 = 0.6;
const BORDER_PX: f32 = 1.0;
// Triangles whose inscribed circle has a smaller radius have fainter lines, pixels.
const WIRE_FREE_PX: f32 = 3.0;

fn opacity_of(overlay: u32) -> f32 {
    return overlays.opacities[overlay / 4u][overlay % 4u];
}

// The colour of a value, between the stops of an overlay's legend.
fn legend_color(overlay: u32, value: f32) -> vec3<f32> {
    let first = overlay * OVERLAY_STOPS;
    var color = overlays.legend[first].rgb;
    for (var k = first + 1u; k < first + OVERLAY_STOPS; k++) {
        let low = overlays.legend[k - 1u];
        let high = overlays.legend[k];
        if value > low.w {
            color = mix(low.rgb, high.rgb, min((value - low.w) / max(high.w - low.w, 1e-6), 1.0));
        }
    }
    return color;
}

// The density that is stored for a place, of the nearest texel, blended over two levels like the heights.
fn stored_density(place: vec2<f32>, lambda: f32) -> f32 {
    let level = surface_level(lambda);
    var density = 0.0;
    for (var k = 0; k < 2; k++) {
        let found = surface_page(place, select(level.fine, level.coarse, k == 1));
        var here = 0.0;
        if found.page != NO_PAGE {
            let in_layer = found.page % (PAGES_ACROSS * PAGES_ACROSS);
            let layer = found.page / (PAGES_ACROSS * PAGES_ACROSS);
            let page = vec2(in_layer % PAGES_ACROSS, in_layer / PAGES_ACROSS);
            let texel = page * TEXELS + density_texel(found);
            let across = PAGES_ACROSS * TEXELS;
            let at = (layer * across + texel.y) * across + texel.x;
            here = unpacked_density(stored_densities[at / 4u], at);
        }
        density = mix(density, here, select(level.blend, 1.0, k == 0));
    }
    return density;
}

// How much of a pixel a line covers whose middle is so far away.
fn line_cover(distance_px: f32, half_width_px: f32) -> f32 {
    return clamp(half_width_px + 0.5 - distance_px, 0.0, 1.0);
}

// How much of a pixel borders of the page cover that a place is read from; `width` is that of a pixel
// in samples of level 0.
fn border_cover(place: vec2<f32>, lambda: f32, width: vec2<f32>) -> f32 {
    let found = surface_page(place, surface_level(lambda).fine);
    let inside = min(found.local, f32(TILE_SAMPLES) - found.local) * f32(1u << u32(found.level));
    let distance_px = inside / max(width, vec2(1e-9));
    return line_cover(min(distance_px.x, distance_px.y), BORDER_PX);
}

// How wide a pixel is in what changes by so much to the right and down.
fn pixel_width(right: vec2<f32>, down: vec2<f32>) -> vec2<f32> {
    return sqrt(right * right + down * down);
}

// A material with the overlays over its colour. What isn't lit is to be laid over the picture instead,
// where nothing changes it any more: then `after` is its colour and how much of the picture is left.
fn overlaid(
    base: PbrInput,
    surface: TerrainSurface,
    lambda: f32,
    own: vec4<f32>,
    of_triangle: vec4<f32>,
    after: ptr<function, vec4<f32>>,
) -> PbrInput {
    let last = 1.0 - own.x - own.y;
    let wide = pixel_width(dpdx(own.xy), dpdy(own.xy));
    let last_wide = pixel_width(vec2(dpdx(last)), vec2(dpdy(last))).x;
    let side_px = vec3(own.xy, last) / max(vec3(wide, last_wide), vec3(1e-9));
    let ground_m = pixel_width(dpdx(surface.from_eye_m), dpdy(surface.from_eye_m));
    let place = sample_place(surface.from_eye_m);

    var values: array<f32, OVERLAYS>;
    var covers: array<f32, OVERLAYS>;
    for (var k = 0u; k < OVERLAYS; k++) {
        covers[k] = 1.0;
    }
    if opacity_of(OVERLAY_DENSITY) > 0.0 {
        values[OVERLAY_DENSITY] = stored_density(place, lambda);
    }
    // Colours come round after as many levels as there are stops.
    values[OVERLAY_LEVEL] = f32(u32(i32(of_triangle.x) + 32) % OVERLAY_STOPS);
    values[OVERLAY_EDGE_FACTOR] = log2(of_triangle.y);
    values[OVERLAY_TRIANGLE_SIZE] = log2(max(of_triangle.z, 1e-6) / overlays.target_px);
    values[OVERLAY_MORPH] = own.z;
    values[OVERLAY_RESIDENCY] = own.w;
    values[OVERLAY_SLOPE] = degrees(acos(clamp(1.0 - surface.slope, -1.0, 1.0)));
    values[OVERLAY_ERROR_BOUND] = of_triangle.w / overlays.max_error_px;
    if opacity_of(OVERLAY_DESTRUCTION) > 0.0 {
        values[OVERLAY_DESTRUCTION] = destruction_mask(surface.from_eye_m, surface.footprint_m);
    }
    if opacity_of(OVERLAY_PAGE_BORDERS) > 0.0 {
        covers[OVERLAY_PAGE_BORDERS] =
            border_cover(place, lambda, ground_m / terrain_draw.spacing_m);
    }
    let nearest_side_px = min(side_px.x, min(side_px.y, side_px.z));
    // What sides lie so close to each other that lines would hide the ground between them, they do so
    // more faintly.
    let inradius_px = 1.0 / max(wide.x + wide.y + last_wide, 1e-9);
    covers[OVERLAY_WIREFRAME] =
        line_cover(nearest_side_px, WIRE_PX) * min(inradius_px / WIRE_FREE_PX, 1.0);

    var pbr = base;
    // Overlays over each other.
    var laid = vec3(0.0);
    // How much of the ground itself is left to be seen.
    var bare = 1.0;
    for (var k = 0u; k < OVERLAYS; k++) {
        let opacity = opacity_of(k) * covers[k];
        if opacity <= 0.0 {
            continue;
        }
        var over = legend_color(k, values[k]);
        if k == OVERLAY_NORMALS {
            over = 0.5 * pbr.N + 0.5;
        }
        laid = mix(laid, over, opacity);
        bare *= 1.0 - opacity;
    }
#ifndef PREPASS_PIPELINE
    if overlays.unlit != 0u {
        *after = vec4(laid, bare);
        laid = vec3(0.0);
        bare = 1.0;
    }
#endif
    let ground = pbr.material.base_color;
    pbr.material.base_color = vec4(bare * ground.rgb + laid, ground.a);
    pbr.material.emissive = vec4(bare * pbr.material.emissive.rgb, pbr.material.emissive.a);
    pbr.material.metallic *= bare;
    pbr.material.reflectance *= bare;
    pbr.material.perceptual_roughness = mix(1.0, pbr.material.perceptual_roughness, bare);
    if overlays.unlit != 0u {
        pbr.material.flags |= STANDARD_MATERIAL_FLAGS_UNLIT_BIT;
        pbr.material.flags &= ~STANDARD_MATERIAL_FLAGS_FOG_ENABLED_BIT;
    }
    return pbr;
}
