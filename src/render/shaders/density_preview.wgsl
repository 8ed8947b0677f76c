#define_import_path bevy_tessera::density_preview

// The preview of densities over the ground's colour, in the colours of Cervin's figures.

#import bevy_tessera::types::{DENSITY_PAGE_WORDS, NO_PAGE}
#import bevy_tessera::density_texel::{density_texel, unpacked_density}
#import bevy_tessera::surface::{terrain_draw, sample_place, surface_level, surface_page}

// Four texels a word, row by row, a page after the other.
@group(2) @binding(5) var<storage, read> density_pages: array<u32>;

const LOW: vec3<f32> = vec3(0.1, 0.6, 0.1);
const HIGH: vec3<f32> = vec3(0.85, 0.1, 0.05);

// The density at a place counted in samples of level 0, of the nearest texel of one level.
fn level_density(place: vec2<f32>, wanted: i32) -> f32 {
    let found = surface_page(place, wanted);
    if found.page == NO_PAGE {
        return 0.0;
    }
    let texel = density_texel(found);
    let index = texel.y * 32u + texel.x;
    return unpacked_density(density_pages[found.page * DENSITY_PAGE_WORDS + index / 4u], index);
}

// A colour with the preview over it; the density is blended over two levels like the heights.
fn density_over(color: vec3<f32>, plane_from_eye_m: vec2<f32>, lambda: f32) -> vec3<f32> {
    let place = sample_place(plane_from_eye_m);
    let level = surface_level(lambda);
    var density = level_density(place, level.fine);
    if level.blend > 0.0 {
        density = mix(density, level_density(place, level.coarse), level.blend);
    }
    return mix(color, mix(LOW, HIGH, density), terrain_draw.density_opacity);
}
