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

// A texel of the tile of a level that holds p: its place in an atlas layer of 32 texels a page, and
// the layer.
fn texel_at(p: vec2<i32>, level: u32) -> vec3<i32> {
    let tile = tile_at(p, level);
    let page = tile_page(tile, level);
    let texel = min((p >> vec2(texel_shift(level))) - tile * DENSITY_TEXELS, vec2(DENSITY_TEXELS - 1));
    return vec3(page_place(page) * DENSITY_TEXELS + texel, i32(page_layer(page)));
}

// The middle of a texel of a level.
fn texel_centre(texel: vec2<i32>, level: u32) -> vec2<i32> {
    let shift = texel_shift(level);
    return clamp_point((texel << vec2(shift)) + (1 << (shift - 1u)));
}

// The level of detail to read at the middle of a texel of a level (8.8): its own where that is
// resident, else what the residency field names.
fn texel_lambda(centre: vec2<i32>, level: u32) -> u32 {
    return u32(min(max(i32(level) << 8u, field_at(centre)), terrain_view.root_level << 8u));
}

// The stored density at p, of one level.
fn level_density(p: vec2<i32>, level: u32) -> u32 {
    let at = texel_at(p, level);
    return textureLoad(density_pages, at.xy, at.z, 0).r;
}

// The density of a texel of a level, 8.8 fixed point.
fn texel_density(texel: vec2<i32>, level: u32) -> u32 {
    let centre = texel_centre(texel, level);
    let lambda = texel_lambda(centre, level);
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

// A square of ground that reaches `half` to all sides of a point, and the level of the faces that it
// is asked for.
struct Square {
    centre: vec2<i32>,
    half: i32,
    level: i32,
}

// The ground that an edge, or the inside of a face, is about: that of its own level's grid, and how far
// it has morphed towards that of the coarser one.
struct Squares {
    fine: Square,
    coarse: Square,
    amount: i32,
}

// The first and the last texel of a level in a square.
fn square_texels(square: Square, texel_level: u32) -> vec4<i32> {
    let shift = vec2(texel_shift(texel_level));
    let last = max(terrain_view.extent - 1, vec2(0)) >> shift;
    let first = clamp((square.centre - square.half) >> shift, vec2(0), last);
    return vec4(first, clamp((square.centre + square.half - 1) >> shift, vec2(0), last));
}

// The ground beside the edge between two control vertices of a node.
fn edge_squares(level: i32, origin: vec2<i32>, a: vec2<i32>, b: vec2<i32>) -> Squares {
    let step = face_size(level);
    // Written so that no sum of two places leaves 32 bits.
    let middle = origin + a * step + (b - a) * (step / 2);
    // The ends slide onto the coarser grid; an edge whose ends meet there vanishes.
    let outer_a = a - (a & vec2(1));
    let outer_b = b - (b & vec2(1));
    let outer_middle = origin + outer_a * step + (outer_b - outer_a) * (step / 2);
    var amount = morph(clamp_point(middle), level);
    if all(outer_a == outer_b) {
        amount = 0;
    }
    return Squares(
        Square(middle, step / 2, level),
        Square(outer_middle, step, level + 1),
        amount,
    );
}

// The ground of a face.
fn face_squares(level: i32, origin: vec2<i32>, ij: vec2<i32>) -> Squares {
    let step = face_size(level);
    let corner = origin + ij * step;
    let outer = corner - (ij & vec2(1)) * step;
    return Squares(
        Square(corner + step / 2, step / 2, level),
        Square(outer + step, step, level + 1),
        morph(clamp_point(corner + step / 2), level),
    );
}

// The largest density of a square, 8.8.
fn square_density(square: Square) -> u32 {
    let texel_level = read_level(square.level);
    let texels = square_texels(square, texel_level);
    var largest = 0u;
    for (var z = texels.y; z <= texels.w; z++) {
        for (var x = texels.x; x <= texels.z; x++) {
            largest = max(largest, texel_density(vec2(x, z), texel_level));
        }
    }
    return largest;
}

// 8.8 values blended by a morph, in 8.16.
fn blend_densities(fine: u32, coarse: u32, amount: i32) -> u32 {
    return (fine * u32(ONE - amount) + coarse * u32(amount)) >> 8u;
}

// The density of an edge or of the inside of a face, in 8.16.
fn squares_density(squares: Squares) -> u32 {
    let fine = square_density(squares.fine);
    if squares.amount == 0 {
        return fine << 8u;
    }
    return blend_densities(fine, square_density(squares.coarse), squares.amount);
}
