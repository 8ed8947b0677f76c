// Pass 1: one workgroup a node; each face gets the factors of its edges, and each node its counts
// of vertices and triangles at every scale that the view may have to be brought down to.

#import bevy_tessera::types::{
    COUNTER_CLAMPED, COUNTER_CULLED, COUNTER_EDGES, COUNTER_FACES, COUNTER_FACTORS, COUNTER_SIZES,
    DENSITY_ONE, FACTOR_ONE, FACTOR_MAX, FACTOR_SCALES, TerrainNode,
}
#import bevy_tessera::bindings::{
    terrain_view, nodes, classified_factors, classified_totals, counters,
}
#import bevy_tessera::lattice::lambda_at
#import bevy_tessera::height::height_m
#import bevy_tessera::edge_density::{edge_density, face_density}
#import bevy_tessera::face::{
    FaceFactors, face_corners, face_place, face_places_around, face_totals, pack_factors,
    runs_forward, scaled_factors,
}

var<workgroup> vertex_totals: array<atomic<u32>, 7>;
var<workgroup> triangle_totals: array<atomic<u32>, 7>;
// Counters up to the histogram of triangle sizes.
var<workgroup> node_counters: array<atomic<u32>, 32>;

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

fn density_weight(density: u32) -> f32 {
    return 1.0 - terrain_view.density_strength * (1.0 - f32(density) / DENSITY_ONE);
}

// The one place where a float decides topology; rounded to fixed point at once.
fn edge_factor(edge: vec2<f32>, density: u32) -> u32 {
    let factor = max(min(edge.x * density_weight(density), edge.y), 1.0);
    return clamp(u32(factor * f32(FACTOR_ONE) + 0.5), FACTOR_ONE, FACTOR_MAX);
}

// Whether no volume may hold any of a face, wherever between the node's bounds its ground lies.
fn is_culled(node: TerrainNode, corners_in: array<vec2<i32>, 4>) -> bool {
    var corners = corners_in;
    let low_point = min(min(corners[0], corners[1]), min(corners[2], corners[3]));
    let high_point = max(max(corners[0], corners[1]), max(corners[2], corners[3]));
    let low_plane = vec2<f32>(low_point) * terrain_view.unit_m;
    let high_plane = vec2<f32>(high_point) * terrain_view.unit_m;
    let low = vec3(low_plane.x, node.lowest_m, low_plane.y);
    let high = vec3(high_plane.x, node.highest_m, high_plane.y);
    for (var volume = 0u; volume < terrain_view.volume_count; volume++) {
        var may_hold = true;
        for (var k = 0u; k < 6u; k++) {
            let plane = terrain_view.volumes[6u * volume + k];
            let farthest = select(low, high, plane.xyz >= vec3(0.0));
            let reach = max(max(abs(farthest.x), abs(farthest.y)), max(abs(farthest.z), 1.0));
            // A millimetre a kilometre makes up for rounding to f32.
            may_hold = may_hold && dot(plane.xyz, farthest) + plane.w >= -1e-6 * reach;
        }
        if may_hold {
            return false;
        }
    }
    return terrain_view.volume_count > 0u;
}

// The bin of a factor: four an octave.
fn factor_bin(factor: u32) -> u32 {
    let octave = firstLeadingBit(factor);
    return 4u * (octave - 10u) + ((factor >> (octave - 2u)) & 3u);
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
    if lane < COUNTER_SIZES {
        atomicStore(&node_counters[lane], 0u);
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
            factors.culled = is_culled(node, corners);
            var insides: vec4<u32>;
            var clamped = 0u;
            for (var e = 0u; e < 4u; e++) {
                let next = (e + 1u) % 4u;
                let forward = runs_forward(corners[e], corners[next]);
                let a = select(next, e, forward);
                let b = select(e, next, forward);
                let edge = project_edge(corners[a], heights[a], corners[b], heights[b]);
                let density = edge_density(node.level, node.origin, places[e], places[next]);
                factors.edges[e] = edge_factor(edge, density);
                insides[e] = edge_factor(edge, inside);
                let is_clamped = edge.x * density_weight(density) > edge.y
                    && edge.y >= terrain_view.max_factor;
                clamped += u32(is_clamped);
            }
            factors.inside = max(insides.xy, insides.zw);
            classified_factors[node_index * faces + face] = pack_factors(factors);
            if factors.culled {
                atomicAdd(&node_counters[COUNTER_CULLED], 1u);
                continue;
            }
            atomicAdd(&node_counters[COUNTER_FACES], 1u);
            atomicAdd(&node_counters[COUNTER_EDGES], 4u);
            atomicAdd(&node_counters[COUNTER_CLAMPED], clamped);
            for (var e = 0u; e < 4u; e++) {
                atomicAdd(&node_counters[COUNTER_FACTORS + factor_bin(factors.edges[e])], 1u);
            }
            for (var s = 0u; s < FACTOR_SCALES; s++) {
                let totals = face_totals(scaled_factors(factors, s));
                atomicAdd(&vertex_totals[s], totals.x);
                atomicAdd(&triangle_totals[s], totals.y);
            }
        }
    }

    workgroupBarrier();
    if lane < COUNTER_SIZES {
        let count = atomicLoad(&node_counters[lane]);
        if count > 0u {
            atomicAdd(&counters[lane], count);
        }
    }
    if lane < FACTOR_SCALES && node_index < terrain_view.node_count {
        classified_totals[node_index * FACTOR_SCALES + lane] =
            vec2(atomicLoad(&vertex_totals[lane]), atomicLoad(&triangle_totals[lane]));
    }
}
