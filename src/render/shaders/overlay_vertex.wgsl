#define_import_path bevy_tessera::overlay_vertex

// Vertices of draws with overlays are pulled: each knows its triangle's other corners.

#import bevy_tessera::types::{
    FACTOR_ONE, ONE, TerrainVertex, TRIANGLE_LEVEL_SHIFT, TRIANGLE_LEVEL_ZERO, TRIANGLE_PART_SHIFT,
}
#import bevy_tessera::bindings::{
    terrain_view, pulled_vertices, pulled_indices, pulled_faces, pulled_errors,
}
#import bevy_tessera::lattice::morph
#import bevy_tessera::screen::longest_px

struct OverlayVertex {
    vertex: TerrainVertex,
    // Weights of the triangle's first two corners; morph; levels that what is resident is short of.
    own: vec4<f32>,
    // Level, factor, longest edge and error bound of the triangle, pixels.
    of_triangle: vec4<f32>,
}

fn overlay_vertex(index: u32) -> OverlayVertex {
    let triangle = index / 3u;
    var corners: array<TerrainVertex, 3>;
    for (var k = 0u; k < 3u; k++) {
        corners[k] = pulled_vertices[pulled_indices[3u * triangle + k]];
    }
    let corner = index % 3u;
    let face = pulled_faces[triangle];
    let level = i32(face.x >> TRIANGLE_LEVEL_SHIFT) - TRIANGLE_LEVEL_ZERO;
    let part = (face.x >> TRIANGLE_PART_SHIFT) & 7u;
    let factor = f32((face.x & 0xffffu) + 1u) / f32(FACTOR_ONE);

    var out: OverlayVertex;
    out.vertex = corners[corner];
    let morphed = morph(out.vertex.point, level);
    // What is coarser than the geometry asks for: finer than level 0 there is nothing to be had.
    let asked = clamp(level * ONE + morphed, 0, terrain_view.root_level * ONE);
    let short = f32(out.vertex.lambda - asked) / f32(ONE);
    out.own = vec4(
        f32(corner == 0u),
        f32(corner == 1u),
        f32(morphed) / f32(ONE),
        max(short, 0.0),
    );
    out.of_triangle = vec4(
        f32(level),
        factor,
        longest_px(corners[0], corners[1], corners[2]),
        pulled_errors[5u * face.y + part],
    );
    return out;
}
