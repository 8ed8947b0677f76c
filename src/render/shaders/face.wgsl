#define_import_path bevy_tessera::face

// Twin of `src/tessellate/partition.rs` and `face.rs`: a face's vertices and triangles, each
// computable alone from its number.

#import bevy_tessera::types::{
    ONE, FACTOR_SHIFT, FACTOR_ONE, TerrainNode, PARTITIONING_INTEGER, PARTITIONING_POWER_OF_TWO,
    PARTITIONING_FRACTIONAL_EVEN,
}
#import bevy_tessera::bindings::terrain_view
#import bevy_tessera::lattice::{control_vertex, lerp_point}

struct Face {
    corners: array<vec2<i32>, 4>,
    factors: array<u32, 4>,
}

struct FaceCounts {
    edge: array<u32, 4>,
    // 0 where the face is two triangles.
    inner: vec2<u32>,
}

// Fixed-point factors: of the edges, and what the inside asks for itself.
struct FaceFactors {
    edges: vec4<u32>,
    inside: vec2<u32>,
}

// A factor less one unit fits 16 bits.
fn pack_factors(factors: FaceFactors) -> vec4<u32> {
    let e = factors.edges - 1u;
    let i = factors.inside - 1u;
    return vec4(e.x | (e.y << 16u), e.z | (e.w << 16u), i.x | (i.y << 16u), 0u);
}

fn unpack_factors(packed: vec4<u32>) -> FaceFactors {
    let low = (packed & vec4(0xffffu)) + 1u;
    let high = (packed >> vec4(16u)) + 1u;
    return FaceFactors(vec4(low.x, high.x, low.y, high.y), vec2(low.z, high.z));
}

fn scaled_factors(factors: FaceFactors, factor_scale: u32) -> FaceFactors {
    return FaceFactors(
        max(factors.edges >> vec4(factor_scale), vec4(FACTOR_ONE)),
        max(factors.inside >> vec2(factor_scale), vec2(FACTOR_ONE)),
    );
}

// The least factor that the partitioning can do.
fn least_factor() -> u32 {
    return select(
        FACTOR_ONE,
        2u * FACTOR_ONE,
        terrain_view.partitioning == PARTITIONING_FRACTIONAL_EVEN,
    );
}

fn segment_count(wanted: u32, inner: bool) -> u32 {
    let factor = max(wanted, least_factor());
    switch terrain_view.partitioning {
        case PARTITIONING_FRACTIONAL_EVEN: {
            return 2u * ((factor + 2u * FACTOR_ONE - 1u) / (2u * FACTOR_ONE));
        }
        case PARTITIONING_INTEGER: {
            let count = (factor + FACTOR_ONE - 1u) / FACTOR_ONE;
            return select(count, max(count, 2u), inner);
        }
        case PARTITIONING_POWER_OF_TWO: {
            let whole = (factor + FACTOR_ONE - 1u) / FACTOR_ONE;
            // firstLeadingBit(0) is all ones: whole - 1 = 0 gives 1 << 0.
            let count = 1u << (firstLeadingBit(whole - 1u) + 1u);
            return select(count, max(count, 2u), inner);
        }
        default: {
            let pairs = (factor - FACTOR_ONE + 2u * FACTOR_ONE - 1u) / (2u * FACTOR_ONE);
            let count = 2u * pairs + 1u;
            return select(count, max(count, 3u), inner);
        }
    }
}

fn segment_parameter(wanted: u32, count: u32, index: u32) -> i32 {
    if index == 0u {
        return 0;
    }
    if index == count {
        return ONE;
    }
    let factor = max(wanted, least_factor());
    let mirrored = 2u * index > count;
    let i = select(index, count - index, mirrored);
    var t: u32;
    if terrain_view.partitioning == PARTITIONING_INTEGER
        || terrain_view.partitioning == PARTITIONING_POWER_OF_TWO {
        t = (i << 16u) / count;
    } else {
        let missing = (count << FACTOR_SHIFT) - factor;
        let short = 2u * FACTOR_ONE - missing;
        t = ((short + (i - 1u) * 2u * FACTOR_ONE) << 15u) / factor;
    }
    return select(i32(t), ONE - i32(t), mirrored);
}

// Column and row of face `index` in its node.
fn face_place(index: u32) -> vec2<i32> {
    let side = 1u << terrain_view.faces_shift;
    return vec2<i32>(vec2(index % side, index / side));
}

// The corners of a face in its node, around it, counted in faces.
fn face_places_around(first: vec2<i32>) -> array<vec2<i32>, 4> {
    return array(first, first + vec2(1, 0), first + vec2(1, 1), first + vec2(0, 1));
}

// The corners of face `index` of a node, around it.
fn face_corners(node: TerrainNode, index: u32) -> array<vec2<i32>, 4> {
    var places = face_places_around(face_place(index));
    var corners: array<vec2<i32>, 4>;
    for (var k = 0u; k < 4u; k++) {
        corners[k] = control_vertex(node.origin, node.level, places[k]);
    }
    return corners;
}

fn inner_factors(factors: FaceFactors) -> vec2<u32> {
    return max(max(factors.edges.xy, factors.edges.zw), factors.inside);
}

fn face_counts(factors: FaceFactors) -> FaceCounts {
    var counts: FaceCounts;
    let inner = inner_factors(factors);
    var whole = segment_count(inner.x, false) == 1u && segment_count(inner.y, false) == 1u;
    for (var e = 0u; e < 4u; e++) {
        counts.edge[e] = segment_count(factors.edges[e], false);
        whole = whole && counts.edge[e] == 1u;
    }
    if !whole {
        counts.inner = vec2(segment_count(inner.x, true), segment_count(inner.y, true));
    }
    return counts;
}

fn edge_total(counts: FaceCounts) -> u32 {
    return counts.edge[0] + counts.edge[1] + counts.edge[2] + counts.edge[3];
}

fn face_vertices(counts: FaceCounts) -> u32 {
    if counts.inner.x == 0u {
        return 4u;
    }
    return edge_total(counts) + (counts.inner.x - 1u) * (counts.inner.y - 1u);
}

fn face_triangles(counts: FaceCounts) -> u32 {
    if counts.inner.x == 0u {
        return 2u;
    }
    let grid = counts.inner - 2u;
    return 2u * grid.x * grid.y + edge_total(counts) + 2u * (grid.x + grid.y);
}

fn point_before(a: vec2<i32>, b: vec2<i32>) -> bool {
    return a.x < b.x || (a.x == b.x && a.y <= b.y);
}

fn face_vertex(
    corners_in: array<vec2<i32>, 4>,
    factors: FaceFactors,
    counts_in: FaceCounts,
    index: u32,
) -> vec2<i32> {
    var corners = corners_in;
    var counts = counts_in;
    if counts.inner.x == 0u {
        return corners[index];
    }
    var rest = index;
    for (var e = 0u; e < 4u; e++) {
        let count = counts.edge[e];
        if rest < count {
            // The edge is cut in canonical direction, so both faces beside it get the same points.
            let a = corners[e];
            let b = corners[(e + 1u) % 4u];
            let forward = point_before(a, b);
            let low = select(b, a, forward);
            let high = select(a, b, forward);
            let cut = select(count - rest, rest, forward);
            return lerp_point(low, high, segment_parameter(factors.edges[e], count, cut));
        }
        rest -= count;
    }
    let columns = counts.inner.x - 1u;
    let inner = inner_factors(factors);
    let u = segment_parameter(inner.x, counts.inner.x, rest % columns + 1u);
    let v = segment_parameter(inner.y, counts.inner.y, rest / columns + 1u);
    let near = lerp_point(corners[0], corners[1], u);
    let far = lerp_point(corners[3], corners[2], u);
    return lerp_point(near, far, v);
}

fn middles_before(odd: u32, count: u32, other: u32, ties: bool) -> u32 {
    var reach = odd * other;
    if !ties && reach > 0u {
        reach -= 1u;
    }
    return min((reach / count + 1u) / 2u, other);
}

// Vertex number of place `i` on the inner ring beside edge `e`.
fn ring_vertex(first_inner: u32, grid: vec2<u32>, e: u32, i: u32) -> u32 {
    var at: vec2<u32>;
    switch e {
        case 0u: { at = vec2(i, 0u); }
        case 1u: { at = vec2(grid.x, i); }
        case 2u: { at = vec2(grid.x - i, grid.y); }
        default: { at = vec2(0u, grid.y - i); }
    }
    return first_inner + at.y * (grid.x + 1u) + at.x;
}

// Vertex numbers of triangle `index`, counter-clockwise seen from above.
fn face_triangle(counts_in: FaceCounts, index: u32) -> vec3<u32> {
    var counts = counts_in;
    if counts.inner.x == 0u {
        return select(vec3(0u, 3u, 2u), vec3(0u, 2u, 1u), index == 0u);
    }
    let grid = counts.inner - 2u;
    let stride = grid.x + 1u;
    let first_inner = edge_total(counts);
    let grid_triangles = 2u * grid.x * grid.y;
    if index < grid_triangles {
        let quad = index / 2u;
        let a = first_inner + (quad / grid.x) * stride + quad % grid.x;
        let c = a + stride + 1u;
        return select(vec3(a, a + stride, c), vec3(a, c, a + 1u), index % 2u == 0u);
    }
    var rest = index - grid_triangles;
    var first_outer = 0u;
    for (var e = 0u; e < 4u; e++) {
        let outer_count = counts.edge[e];
        let inner_count = select(grid.x, grid.y, e % 2u == 1u);
        if rest >= outer_count + inner_count {
            rest -= outer_count + inner_count;
            first_outer += outer_count;
            continue;
        }
        if rest < outer_count {
            let j = middles_before(2u * rest + 1u, outer_count, inner_count, false);
            return vec3(
                first_outer + rest,
                ring_vertex(first_inner, grid, e, j),
                (first_outer + rest + 1u) % first_inner,
            );
        }
        let j = rest - outer_count;
        let i = middles_before(2u * j + 1u, inner_count, outer_count, true);
        return vec3(
            ring_vertex(first_inner, grid, e, j),
            ring_vertex(first_inner, grid, e, j + 1u),
            (first_outer + i) % first_inner,
        );
    }
    return vec3(0u);
}
