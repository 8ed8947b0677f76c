// Pass 2: one workgroup a view; chooses the scale at which everything fits, gives every node its
// place in the vertex and index buffers, and fills in the indirect draw.

#import bevy_tessera::types::FACTOR_SCALES
#import bevy_tessera::bindings::{terrain_view, node_totals, setup_offsets, setup_args}

const LANES: u32 = 256u;

var<workgroup> scale_vertices: array<atomic<u32>, 7>;
var<workgroup> scale_triangles: array<atomic<u32>, 7>;
var<workgroup> sums: array<vec2<u32>, 256>;

@compute @workgroup_size(256)
fn setup(@builtin(local_invocation_index) lane: u32) {
    let node_count = terrain_view.node_count;
    if lane < FACTOR_SCALES {
        atomicStore(&scale_vertices[lane], 0u);
        atomicStore(&scale_triangles[lane], 0u);
    }
    workgroupBarrier();
    for (var node = lane; node < node_count; node += LANES) {
        for (var s = 0u; s < FACTOR_SCALES; s++) {
            let totals = node_totals[node * FACTOR_SCALES + s];
            atomicAdd(&scale_vertices[s], totals.x);
            atomicAdd(&scale_triangles[s], totals.y);
        }
    }
    workgroupBarrier();

    // The whole view shares one scale: edges must go on agreeing.
    var factor_scale = 0u;
    while factor_scale < FACTOR_SCALES - 1u
        && (atomicLoad(&scale_vertices[factor_scale]) > terrain_view.max_vertices
            || atomicLoad(&scale_triangles[factor_scale]) > terrain_view.max_triangles) {
        factor_scale++;
    }

    // Each lane sums a run of nodes, the runs are scanned, and each lane hands out its places.
    let run = (node_count + LANES - 1u) / LANES;
    let first = min(lane * run, node_count);
    let last = min(first + run, node_count);
    var sum = vec2(0u);
    for (var node = first; node < last; node++) {
        sum += node_totals[node * FACTOR_SCALES + factor_scale];
    }
    sums[lane] = sum;
    for (var stride = 1u; stride < LANES; stride <<= 1u) {
        workgroupBarrier();
        var before = vec2(0u);
        if lane >= stride {
            before = sums[lane - stride];
        }
        workgroupBarrier();
        sums[lane] += before;
    }
    workgroupBarrier();
    var place = sums[lane] - sum;
    for (var node = first; node < last; node++) {
        setup_offsets[node] = place;
        place += node_totals[node * FACTOR_SCALES + factor_scale];
    }

    if lane == 0u {
        let total = sums[LANES - 1u];
        // Nothing fits only where the buffers are smaller than the least mesh: draw nothing then.
        let fits = total.x <= terrain_view.max_vertices && total.y <= terrain_view.max_triangles;
        setup_args.index_count = select(0u, 3u * total.y, fits);
        setup_args.instance_count = 1u;
        setup_args.first_index = 0u;
        setup_args.base_vertex = 0;
        setup_args.first_instance = 0u;
        setup_args.scale = factor_scale;
        setup_args.vertices = total.x;
        setup_args.triangles = total.y;
        setup_args.wanted_vertices = atomicLoad(&scale_vertices[0]);
        setup_args.wanted_triangles = atomicLoad(&scale_triangles[0]);
    }
}
