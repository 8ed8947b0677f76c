#define_import_path bevy_tessera::scan

// Where each face of a node begins in the node's part of the buffers; shared by the passes that
// write vertices and indices. Workgroups of 256.

#import bevy_tessera::types::TerrainNode
#import bevy_tessera::bindings::{terrain_view, face_factors, draw_args}
#import bevy_tessera::face::{face_totals, scaled_factors, unpack_factors}

const LANES: u32 = 256u;
// faces_per_side is at most 32.
const MAX_FACES: u32 = 1024u;

var<workgroup> face_places: array<vec2<u32>, 1024>;
var<workgroup> lane_sums: array<vec2<u32>, 256>;

fn faces_a_node() -> u32 {
    return 1u << (2u * terrain_view.faces_shift);
}

// Fills `face_places` with the vertices and triangles before each face; returns the node's totals.
fn scan_faces(node_index: u32, lane: u32) -> vec2<u32> {
    let faces = faces_a_node();
    let run = max(faces / LANES, 1u);
    let first = min(lane * run, faces);
    let last = min(first + run, faces);
    var sum = vec2(0u);
    for (var face = first; face < last; face++) {
        let packed = face_factors[node_index * faces + face];
        let factors = scaled_factors(unpack_factors(packed), draw_args.scale);
        face_places[face] = sum;
        sum += face_totals(factors);
    }
    lane_sums[lane] = sum;
    for (var stride = 1u; stride < LANES; stride <<= 1u) {
        workgroupBarrier();
        var before = vec2(0u);
        if lane >= stride {
            before = lane_sums[lane - stride];
        }
        workgroupBarrier();
        lane_sums[lane] += before;
    }
    workgroupBarrier();
    let before = lane_sums[lane] - sum;
    for (var face = first; face < last; face++) {
        face_places[face] += before;
    }
    workgroupBarrier();
    return lane_sums[LANES - 1u];
}

// The last face that begins at or before `place`, by vertices (0) or triangles (1).
fn face_at(place: u32, by: u32) -> u32 {
    var low = 0u;
    var high = faces_a_node();
    while high - low > 1u {
        let middle = (low + high) / 2u;
        if face_places[middle][by] <= place {
            low = middle;
        } else {
            high = middle;
        }
    }
    return low;
}
