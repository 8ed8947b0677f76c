// Pass 1: one workgroup a node; each face gets the factors of its edges, and each node its counts
// of vertices and triangles at every scale that the view may have to be brought down to.

#import bevy_tessera::types::{DENSITY_ONE, FACTOR_ONE, FACTOR_MAX, FACTOR_SCALES}
#import bevy_tessera::bindings::{terrain_view, nodes, classified_factors, classified_totals}
#import bevy_tessera::lattice::lambda_at
#import bevy_tessera::height::height_m
#import bevy_tessera::edge_density::{edge_density, face_density}
#import bevy_tessera::face::{
    FaceFactors, face_corners, face_counts, face_place, face_places_around, face_vertices,
    face_triangles, pack_factors, runs_forward, scaled_factors,
}

var<workgroup> vertex_totals: array<atomic<u32>, 7>;
var<workgroup> triangle_totals: array<atomic<u32>, 7>;

// An edge as the eye sees it: segments that the view wants, were the ground as rough as can be, and
// the most that it may have.
fn project_edge(a: vec2<i32>, a_height_m: f32, b: vec2<i32>, b_height_m: f32) -> vec2<f32> {
    let span = vec2<f32>(b - a) * terrain_view.unit_m;
    let length_m = length(span);
    let rise_m = b_height_m - a_height_m;
    let diameter_m = sqrt(dot(span, span) + rise_m * rise_m);
    let from_eye = (a - terrain_view.eye) + (b - terrain_view.eye);
    let plane_m = (vec2<f32>(from_eye) * 0.5 - terrain_view.eye_fraction) * terrain_view.unit_m;
    let height = 0.5 * (a_height_m + b_height_m) - terrain_view.eye_height_m;
    let distance_m = max(length(vec3(plane_m.x, height, plane_m.y)), 0.5 * diameter_m);
    var projected = 0.0;
    if distance_m > 0.0 {
        projected = diameter_m * terrain_view.segments_per_radian / distance_m;
    }
    let wanted = projected + diameter_m * terrain_view.segments_per_m;
    return vec2(wanted, min(length_m / terrain_view.min_triangle_m, terrain_view.max_factor));
}

// The one place where a float decides topology; rounded to fixed point at once.
fn edge_factor(edge: vec2<f32>, density: u32) -> u32 {
    let weight = 1.0 - terrain_view.density_strength * (1.0 - f32(density) / DENSITY_ONE);
    let factor = max(min(edge.x * weight, edge.y), 1.0);
    return clamp(u32(factor * f32(FACTOR_ONE) + 0.5), FACTOR_ONE, FACTOR_MAX);
}

@compute @workgroup_size(64)
fn classify(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    let node_index = workgroup.y * workgroups.x + workgroup.x;
    if lane < FACTOR_SCALES {
        atomicStore(&vertex_totals[lane], 0u);
        atomicStore(&triangle_totals[lane], 0u);
    }
    workgroupBarrier();

    if node_index < terrain_view.node_count {
        let node = nodes[node_index];
        let faces = 1u << (2u * terrain_view.faces_shift);
        for (var face = lane; face < faces; face += 64u) {
            var corners = face_corners(node, face);
            var heights: array<f32, 4>;
            for (var k = 0u; k < 4u; k++) {
                heights[k] = height_m(corners[k], lambda_at(corners[k], node.level));
            }
            let place = face_place(face);
            var places = face_places_around(place);
            let inside = face_density(node.level, node.origin, place);
            var factors: FaceFactors;
            var insides: vec4<u32>;
            for (var e = 0u; e < 4u; e++) {
                let next = (e + 1u) % 4u;
                let forward = runs_forward(corners[e], corners[next]);
                let a = select(next, e, forward);
                let b = select(e, next, forward);
                let edge = project_edge(corners[a], heights[a], corners[b], heights[b]);
                let density = edge_density(node.level, node.origin, places[e], places[next]);
                factors.edges[e] = edge_factor(edge, density);
                insides[e] = edge_factor(edge, inside);
            }
            factors.inside = max(insides.xy, insides.zw);
            classified_factors[node_index * faces + face] = pack_factors(factors);
            for (var s = 0u; s < FACTOR_SCALES; s++) {
                let counts = face_counts(scaled_factors(factors, s));
                atomicAdd(&vertex_totals[s], face_vertices(counts));
                atomicAdd(&triangle_totals[s], face_triangles(counts));
            }
        }
    }

    workgroupBarrier();
    if lane < FACTOR_SCALES && node_index < terrain_view.node_count {
        classified_totals[node_index * FACTOR_SCALES + lane] =
            vec2(atomicLoad(&vertex_totals[lane]), atomicLoad(&triangle_totals[lane]));
    }
}
