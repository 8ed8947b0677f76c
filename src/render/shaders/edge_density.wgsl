#define_import_path bevy_tessera::edge_density

// Twin of `src/tessellate/edge_density.rs`: how finely ground deserves to be cut, in integers.

#import bevy_tessera::types::{ONE, DENSITY_TEXELS}
#import bevy_tessera::bindings::{terrain_view, density_pages}
#import bevy_tessera::lattice::{clamp_point, face_size, field_at, morph}
#import bevy_tessera::height::{page_layer, page_place, tile_at, tile_page}

// Lattice units along the side of a density texel, as a power of two.
fn texel_shift(level: u32) -> u32 {
    return terrain_view.unit_shift + 2u + level;
}

// The stored density at p, of one level.
fn level_density(p: vec2<i32>, level: u32) -> u32 {
    let tile = tile_at(p, level);
    let page = tile_page(tile, level);
    let texel = min((p >> vec2(texel_shift(level))) - tile * DENSITY_TEXELS, vec2(DENSITY_TEXELS - 1));
    let at = page_place(page) * DENSITY_TEXELS + texel;
    return textureLoad(density_pages, at, page_layer(page), 0).r;
}

// The density of a texel of a level, 8.8 fixed point: its own where it is resident, else of the
// levels that the residency field names.
fn texel_density(texel: vec2<i32>, level: u32) -> u32 {
    let shift = texel_shift(level);
    let centre = clamp_point((texel << vec2(shift)) + (1 << (shift - 1u)));
    let lambda = u32(min(max(i32(level) << 8u, field_at(centre)), terrain_view.root_level << 8u));
    let fine = level_density(centre, lambda >> 8u);
    let blend = lambda & 255u;
    if blend == 0u {
        return fine << 8u;
    }
    return fine * (256u - blend) + level_density(centre, (lambda >> 8u) + 1u) * blend;
}

// The level whose texels are half as long as the faces of `level`, or the nearest that there is.
fn read_level(level: i32) -> u32 {
    return u32(clamp(level + 4 - i32(terrain_view.faces_shift), 0, terrain_view.root_level));
}

// The largest density of the square that reaches `half` to all sides of a point.
fn square_density(centre: vec2<i32>, half: i32, level: i32) -> u32 {
    let texel_level = read_level(level);
    let shift = vec2(texel_shift(texel_level));
    let last = max(terrain_view.extent - 1, vec2(0)) >> shift;
    let first = clamp((centre - half) >> shift, vec2(0), last);
    let end = clamp((centre + half - 1) >> shift, vec2(0), last);
    var largest = 0u;
    for (var z = first.y; z <= end.y; z++) {
        for (var x = first.x; x <= end.x; x++) {
            largest = max(largest, texel_density(vec2(x, z), texel_level));
        }
    }
    return largest;
}

// 8.8 values blended by a morph, in 8.16.
fn blend_densities(fine: u32, coarse: u32, amount: i32) -> u32 {
    return (fine * u32(ONE - amount) + coarse * u32(amount)) >> 8u;
}

// The density of the edge between two control vertices of a node, in 8.16.
fn edge_density(level: i32, origin: vec2<i32>, a: vec2<i32>, b: vec2<i32>) -> u32 {
    let step = face_size(level);
    // Written so that no sum of two places leaves 32 bits.
    let middle = origin + a * step + (b - a) * (step / 2);
    let density = square_density(middle, step / 2, level);
    let amount = morph(clamp_point(middle), level);
    // The ends slide onto the coarser grid; an edge whose ends meet there vanishes.
    let outer_a = a - (a & vec2(1));
    let outer_b = b - (b & vec2(1));
    if amount == 0 || all(outer_a == outer_b) {
        return density << 8u;
    }
    let outer_middle = origin + outer_a * step + (outer_b - outer_a) * (step / 2);
    return blend_densities(density, square_density(outer_middle, step, level + 1), amount);
}

// The density of the inside of a face, in 8.16.
fn face_density(level: i32, origin: vec2<i32>, ij: vec2<i32>) -> u32 {
    let step = face_size(level);
    let corner = origin + ij * step;
    let density = square_density(corner + step / 2, step / 2, level);
    let amount = morph(clamp_point(corner + step / 2), level);
    if amount == 0 {
        return density << 8u;
    }
    let outer = corner - (ij & vec2(1)) * step;
    let coarse = square_density(outer + step, step, level + 1);
    return blend_densities(density, coarse, amount);
}
