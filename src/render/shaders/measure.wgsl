// Pass 5, only while somebody asks: how long the triangles' longest edges are on the screen.

#import bevy_tessera::types::{COUNTER_SIZES, COUNTERS, TerrainVertex}
#import bevy_tessera::bindings::{
    terrain_view, draw_args, drawn_vertices, drawn_indices, counters,
}

const LANES: u32 = 256u;
const SIZES: u32 = 32u;

var<workgroup> sizes: array<atomic<u32>, 32>;

// A vertex relative to the eye, metres.
fn from_eye_m(vertex: TerrainVertex) -> vec3<f32> {
    let whole = vec2<f32>(vertex.point - terrain_view.eye);
    let plane_m = (whole - terrain_view.eye_fraction) * terrain_view.unit_m;
    return vec3(plane_m.x, vertex.height_m - terrain_view.eye_height_m, plane_m.y);
}

fn length_px(a: vec3<f32>, b: vec3<f32>) -> f32 {
    let length_m = length(b - a);
    let distance_m = max(length(0.5 * (a + b)), 0.5 * length_m);
    if terrain_view.focal_px > 0.0 && distance_m > 0.0 {
        return length_m * terrain_view.focal_px / distance_m;
    }
    return length_m * terrain_view.px_per_m;
}

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
        let a = from_eye_m(first);
        let b = from_eye_m(second);
        let c = from_eye_m(third);
        let size_px = max(length_px(a, b), max(length_px(b, c), length_px(c, a)));
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
