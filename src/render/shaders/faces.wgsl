// For views with overlays: which part of which face each triangle belongs to, and what error that part
// may leave. Twin of `src/tessellate/faces.rs`.

#import bevy_tessera::types::{
    FACTOR_ONE, OVERLAY_ERROR_BOUND, TerrainNode, TerrainOverlays, TRIANGLE_LEVEL_SHIFT,
    TRIANGLE_LEVEL_ZERO, TRIANGLE_PART_SHIFT,
}
#import bevy_tessera::bindings::{
    terrain_view, nodes, face_factors, node_offsets, draw_args, triangle_faces, part_errors,
    face_overlays,
}
#import bevy_tessera::edge::{ProjectedEdge, edge_error_px, error_sample_m, project_edge}
#import bevy_tessera::edge_density::{Square, edge_squares, face_squares}
#import bevy_tessera::edge_error::square_errors
#import bevy_tessera::face::{
    FaceFactors, INSIDE, edge_ends, face_corners, face_counts, face_place, face_places_around,
    inner_factors, part_factor, scaled_factors, triangle_part, unpack_factors,
}
#import bevy_tessera::height::displaced_m
#import bevy_tessera::scan::{LANES, face_places, faces_a_node, scan_faces, face_at}

const PARTS: u32 = 5u;

fn view_factors(node_index: u32, face: u32) -> FaceFactors {
    let packed = face_factors[node_index * faces_a_node() + face];
    return scaled_factors(unpack_factors(packed), draw_args.scale);
}

// What the stored bounds say of the error that a part of a face leaves, pixels.
fn part_error_px(node: TerrainNode, face: u32, factors: FaceFactors, part: u32) -> f32 {
    var corners = face_corners(node, face);
    var heights: array<f32, 4>;
    for (var k = 0u; k < 4u; k++) {
        heights[k] = displaced_m(corners[k], node.level).x;
    }
    let place = face_place(face);
    var places = face_places_around(place);
    var square: Square;
    if part == INSIDE {
        square = face_squares(node.level, node.origin, place).fine;
    } else {
        let next = (part + 1u) % 4u;
        square = edge_squares(node.level, node.origin, places[part], places[next]).fine;
    }
    let errors = square_errors(square);
    let sample_m = error_sample_m(node.level);
    let inner = inner_factors(factors);
    var largest_px = 0.0;
    for (var e = 0u; e < 4u; e++) {
        if part != INSIDE && part != e {
            continue;
        }
        let ends = edge_ends(e);
        let edge = project_edge(
            corners[ends.x], heights[ends.x], corners[ends.y], heights[ends.y],
        );
        let factor = f32(select(factors.edges[e], inner[e % 2u], part == INSIDE));
        let error_px = edge_error_px(edge, errors, sample_m, factor / f32(FACTOR_ONE));
        largest_px = max(largest_px, error_px);
    }
    return largest_px;
}

@compute @workgroup_size(256)
fn faces(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let node_index = workgroup.y * workgroups.x + workgroup.x;
    if node_index >= terrain_view.node_count || draw_args.index_count == 0u {
        return;
    }
    let node = nodes[node_index];
    let total = scan_faces(node_index, lane).y;
    let first = node_offsets[node_index].y;
    let level = u32(node.level + TRIANGLE_LEVEL_ZERO) << TRIANGLE_LEVEL_SHIFT;
    let stride = workgroups.z * LANES;
    for (var place = workgroup.z * LANES + lane; place < total; place += stride) {
        let face = face_at(place, 1u);
        let factors = view_factors(node_index, face);
        let part = triangle_part(face_counts(factors), place - face_places[face].y);
        let packed = level | (part << TRIANGLE_PART_SHIFT) | (part_factor(factors, part) - 1u);
        triangle_faces[first + place] = vec2(packed, node_index * faces_a_node() + face);
    }

    if face_overlays.opacities[OVERLAY_ERROR_BOUND / 4u][OVERLAY_ERROR_BOUND % 4u] == 0.0 {
        return;
    }
    for (var item = workgroup.z * LANES + lane; item < PARTS * faces_a_node(); item += stride) {
        let face = item / PARTS;
        let factors = view_factors(node_index, face);
        var error_px = 0.0;
        if !factors.culled {
            error_px = part_error_px(node, face, factors, item % PARTS);
        }
        part_errors[PARTS * node_index * faces_a_node() + item] = error_px;
    }
}
