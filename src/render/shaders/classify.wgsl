// Pass 1: one workgroup a node; each face gets the factors of its edges, and each node its counts
// of vertices and triangles at every scale that the view may have to be brought down to.

#import bevy_tessera::types::{
    COUNTER_CLAMPED, COUNTER_CULLED, COUNTER_EDGES, COUNTER_FACES, COUNTER_FACTORS,
    COUNTER_PLAIN_TRIANGLES, COUNTER_PLAIN_VERTICES, COUNTER_SIZES, DENSITY_ONE, ONE, FACTOR_ONE, FACTOR_MAX, FACTOR_SCALES, TerrainNode,
}
#import bevy_tessera::bindings::{
    terrain_view, terrain_detail, nodes, classified_factors, classified_totals, counters,
}
#import bevy_tessera::detail::detail_density
#import bevy_tessera::height::displaced_m
#import bevy_tessera::edge::{ProjectedEdge, STRETCH, error_sample_m, project_edge}
#import bevy_tessera::edge_density::{Squares, edge_squares, face_squares, squares_density}
#import bevy_tessera::edge_error::{error_spacing, square_errors}
#import bevy_tessera::face::{
    FaceFactors, edge_ends, face_corners, face_place, face_places_around, face_totals, pack_factors,
    scaled_factors,
}

// At each scale, then at a density strength of 0.
var<workgroup> vertex_totals: array<atomic<u32>, 8>;
var<workgroup> triangle_totals: array<atomic<u32>, 8>;
// Counters up to the histogram of triangle sizes.
var<workgroup> node_counters: array<atomic<u32>, 32>;

// What the ground beside an edge, or inside a face, asks for: the part of a projected edge's segments
// by density, or what its triangles leave, by the view's policy.
struct Asked {
    weight: f32,
    // By the ground's own level, and by the coarser one that it morphs to, `part` of the way.
    fine: array<u32, 7>,
    coarse: array<u32, 7>,
    fine_sample_m: f32,
    coarse_sample_m: f32,
    part: f32,
}

// `detail` is the weight of detail there.
fn ask(squares: Squares, detail: f32) -> Asked {
    var asked: Asked;
    if terrain_view.max_error_px > 0.0 {
        asked.fine = square_errors(squares.fine);
        asked.fine_sample_m = error_sample_m(squares.fine.level);
        if squares.amount > 0 {
            asked.coarse = square_errors(squares.coarse);
            asked.coarse_sample_m = error_sample_m(squares.coarse.level);
            asked.part = f32(squares.amount) / f32(ONE);
        }
        asked.weight = f32(detail_density(terrain_detail, detail)) / DENSITY_ONE;
        return asked;
    }
    let density = max(squares_density(squares), detail_density(terrain_detail, detail));
    asked.weight = 1.0 - terrain_view.density_strength * (1.0 - f32(density) / DENSITY_ONE);
    return asked;
}

// Segments that an edge wants so that its triangles leave no more than `allowed_m`.
fn segments_by_error(length_m: f32, errors: array<u32, 7>, sample_m: f32, allowed_m: f32) -> f32 {
    let spacing = error_spacing(errors, allowed_m * terrain_view.error_units_per_m);
    return STRETCH * length_m / max(spacing * sample_m, 1e-6);
}

// Segments that an edge wants, its limit aside.
fn wanted_segments(edge: ProjectedEdge, asked: Asked) -> f32 {
    var wanted = edge.wanted * asked.weight;
    if terrain_view.max_error_px > 0.0 {
        var allowed_m = terrain_view.max_error_px * edge.nearest_m / terrain_view.focal_px;
        if terrain_view.focal_px <= 0.0 {
            allowed_m = terrain_view.max_error_px / terrain_view.px_per_m;
        }
        var by_error = segments_by_error(
            edge.length_m, asked.fine, asked.fine_sample_m, allowed_m,
        );
        if asked.part > 0.0 {
            let by_coarse = segments_by_error(
                edge.length_m, asked.coarse, asked.coarse_sample_m, allowed_m,
            );
            by_error = by_error * (1.0 - asked.part) + by_coarse * asked.part;
        }
        wanted = max(wanted, by_error);
    }
    return wanted;
}

// The one place where a float decides topology; rounded to fixed point at once.
fn fixed_factor(wanted: f32, limit: f32) -> u32 {
    let factor = max(min(wanted, limit), 1.0);
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
    if lane <= FACTOR_SCALES {
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
            var factors: FaceFactors;
            factors.culled = is_culled(node, corners);
            if factors.culled {
                factors.edges = vec4(FACTOR_ONE);
                factors.inside = vec2(FACTOR_ONE);
                classified_factors[node_index * faces + face] = pack_factors(factors);
                atomicAdd(&node_counters[COUNTER_CULLED], 1u);
                continue;
            }
            var heights: array<f32, 4>;
            // Weights of detail.
            var details: array<f32, 4>;
            for (var k = 0u; k < 4u; k++) {
                let displaced = displaced_m(corners[k], node.level);
                heights[k] = displaced.x;
                details[k] = displaced.y;
            }
            let place = face_place(face);
            var places = face_places_around(place);
            let most_detail = max(max(details[0], details[1]), max(details[2], details[3]));
            let inside = ask(face_squares(node.level, node.origin, place), most_detail);
            var insides: vec4<u32>;
            // Factors at a density strength of 0, where nothing of the density counts.
            var plains: vec4<u32>;
            var clamped = 0u;
            for (var e = 0u; e < 4u; e++) {
                let next = (e + 1u) % 4u;
                let ends = edge_ends(e);
                let a = ends.x;
                let b = ends.y;
                let edge = project_edge(corners[a], heights[a], corners[b], heights[b]);
                let squares = edge_squares(node.level, node.origin, places[e], places[next]);
                let beside = ask(squares, max(details[a], details[b]));
                let wanted = wanted_segments(edge, beside);
                factors.edges[e] = fixed_factor(wanted, edge.limit);
                insides[e] = fixed_factor(wanted_segments(edge, inside), edge.limit);
                if terrain_view.counts_plain > 0u {
                    plains[e] = fixed_factor(edge.wanted, edge.limit);
                }
                let is_clamped = wanted > edge.limit && edge.limit >= terrain_view.max_factor;
                clamped += u32(is_clamped);
            }
            factors.inside = max(insides.xy, insides.zw);
            classified_factors[node_index * faces + face] = pack_factors(factors);
            atomicAdd(&node_counters[COUNTER_FACES], 1u);
            atomicAdd(&node_counters[COUNTER_EDGES], 4u);
            atomicAdd(&node_counters[COUNTER_CLAMPED], clamped);
            for (var e = 0u; e < 4u; e++) {
                atomicAdd(&node_counters[COUNTER_FACTORS + factor_bin(factors.edges[e])], 1u);
            }
            let rounds = FACTOR_SCALES + terrain_view.counts_plain;
            for (var s = 0u; s < rounds; s++) {
                var counted = scaled_factors(factors, s % FACTOR_SCALES);
                // Under the policy of errors no density is asked, and nothing would change.
                if s == FACTOR_SCALES && terrain_view.max_error_px <= 0.0 {
                    counted = FaceFactors(plains, max(plains.xy, plains.zw), false);
                }
                let totals = face_totals(counted);
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
    if lane == FACTOR_SCALES && terrain_view.counts_plain > 0u {
        atomicAdd(&counters[COUNTER_PLAIN_VERTICES], atomicLoad(&vertex_totals[lane]));
        atomicAdd(&counters[COUNTER_PLAIN_TRIANGLES], atomicLoad(&triangle_totals[lane]));
    }
    if lane < FACTOR_SCALES && node_index < terrain_view.node_count {
        classified_totals[node_index * FACTOR_SCALES + lane] =
            vec2(atomicLoad(&vertex_totals[lane]), atomicLoad(&triangle_totals[lane]));
    }
}
