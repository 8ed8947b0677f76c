// Pass 5, only while somebody asks: how long the triangles' longest edges are on the screen.

#import bevy_tessera::types::{COUNTER_SIZES, COUNTERS}
#import bevy_tessera::bindings::{draw_args, drawn_vertices, drawn_indices, counters}
#import bevy_tessera::screen::longest_px

const LANES: u32 = 256u;
const SIZES: u32 = 32u;

var<workgroup> sizes: array<atomic<u32>, 32>;

@compute @workgroup_size(256)
fn measure(
    @builtin(workgroup_id) workgroup: vec3<u32>,
    @builtin(num_workgroups) workgroups: vec3<u32>,
    @builtin(local_invocation_index) lane: u32,
) {
    if lane < SIZES {
        atomicStore(&sizes[lane], 0u);
    }
    workgroupBarrier();
    let triangles = draw_args.index_count / 3u;
    for (
        var triangle = workgroup.x * LANES + lane;
        triangle < triangles;
        triangle += workgroups.x * LANES
    ) {
        let first = drawn_vertices[drawn_indices[3u * triangle]];
        let second = drawn_vertices[drawn_indices[3u * triangle + 1u]];
        let third = drawn_vertices[drawn_indices[3u * triangle + 2u]];
        // Triangles without area are drawn by nobody.
        let u = second.point - first.point;
        let v = third.point - first.point;
        if all(u == vec2(0)) || all(v == vec2(0)) || all(u == v) {
            continue;
        }
        let size_px = longest_px(first, second, third);
        // Four bins an octave, the first up to a quarter of a pixel.
        let bin = clamp(i32(floor(4.0 * log2(max(size_px, 1e-6)))) + 9, 0, i32(SIZES) - 1);
        atomicAdd(&sizes[bin], 1u);
    }
    workgroupBarrier();
    if lane < SIZES {
        let count = atomicLoad(&sizes[lane]);
        if count > 0u {
            atomicAdd(&counters[COUNTER_SIZES + lane], count);
        }
    }
}
