#define_import_path bevy_tessera::face

// Twin of `src/tessellate/partition.rs` and `face.rs`: a face's vertices and triangles, each
// computable alone from its number.

#import bevy_tessera::types::{
    ONE, FACTOR_SHIFT, FACTOR_ONE, TerrainNode, PARTITIONING_INTEGER, PARTITIONING_POWER_OF_TWO,
    PARTITIONING_FRACTIONAL_EVEN, PARTITIONING_POWER_OF_TWO_MORPH,
}
#import bevy_tessera::bindings::terrain_view
#import bevy_tessera::lattice::{control_vertex, lerp_point}
#import bevy_tessera::strip::{Row, edge_row, newest_place, ring_row, segments_before, segment_slot}

struct FaceCounts {
    edge: array<u32, 4>,
    // 0 where the face is two triangles.
    inner: vec2<u32>,
}

// Where a vertex comes to stand: the point that its height is read at, the two vertices of the
// coarser mesh that it rises from the middle of, and how far it has.
struct FaceVertex {
    point: vec2<i32>,
    parents: array<vec2<i32>, 2>,
    rise: i32,
}

// Fixed-point factors: of the edges, and what the inside asks for itself.
struct FaceFactors {
    edges: vec4<u32>,
    inside: vec2<u32>,
    // No view sees the face: it has no vertices and no triangles.
    culled: bool,
}

// A factor less one unit fits 16 bits.
fn pack_factors(factors: FaceFactors) -> vec4<u32> {
    let e = factors.edges - 1u;
    let i = factors.inside - 1u;
    let culled = u32(factors.culled);
    return vec4(e.x | (e.y << 16u), e.z | (e.w << 16u), i.x | (i.y << 16u), culled);
}

fn unpack_factors(packed: vec4<u32>) -> FaceFactors {
    let low = (packed & vec4(0xffffu)) + 1u;
    let high = (packed >> vec4(16u)) + 1u;
    return FaceFactors(
        vec4(low.x, high.x, low.y, high.y),
        vec2(low.z, high.z),
        (packed.w & 1u) != 0u,
    );
}

fn scaled_factors(factors: FaceFactors, factor_scale: u32) -> FaceFactors {
    return FaceFactors(
        max(factors.edges >> vec4(factor_scale), vec4(FACTOR_ONE)),
        max(factors.inside >> vec2(factor_scale), vec2(FACTOR_ONE)),
        factors.culled,
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
        case PARTITIONING_POWER_OF_TWO, PARTITIONING_POWER_OF_TWO_MORPH: {
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
    if terrain_view.partitioning == PARTITIONING_POWER_OF_TWO_MORPH && index % 2u == 1u {
        return i32(((index + 1u) << 16u) / count - (1u << 26u) / factor);
    }
    let mirrored = 2u * index > count;
    let i = select(index, count - index, mirrored);
    var t: u32;
    switch terrain_view.partitioning {
        case PARTITIONING_INTEGER, PARTITIONING_POWER_OF_TWO, PARTITIONING_POWER_OF_TWO_MORPH: {
            t = (i << 16u) / count;
        }
        default: {
            let missing = (count << FACTOR_SHIFT) - factor;
            let full = 2u * FACTOR_ONE;
            let newest = full - missing;
            var cut_length = i * full;
            if i > newest_place(count / 2u) {
                cut_length = (i - 1u) * full + newest;
            }
            t = (cut_length << 15u) / factor;
        }
    }
    return select(i32(t), ONE - i32(t), mirrored);
}

// How far the new vertices inside a face have risen from the coarser surface.
fn rise_of(factor: u32, count: u32) -> i32 {
    let ratio = min(((count << FACTOR_SHIFT) << 15u) / factor, u32(ONE) - 1u);
    let left = u32(ONE) - ((ratio * ratio) >> 16u);
    return min(i32(left * 4u / 3u), ONE);
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

// Whether the inner grid reaches the edges and takes their vertices for its own outermost ones.
fn is_nested() -> bool {
    return terrain_view.partitioning == PARTITIONING_POWER_OF_TWO_MORPH;
}

fn inner_factors(factors: FaceFactors) -> vec2<u32> {
    let inner = max(max(factors.edges.xy, factors.edges.zw), factors.inside);
    return select(inner, vec2(max(inner.x, inner.y)), is_nested());
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

// Vertices and triangles of a face, by its factors.
fn face_totals(factors: FaceFactors) -> vec2<u32> {
    if factors.culled {
        return vec2(0u);
    }
    let counts = face_counts(factors);
    return vec2(face_vertices(counts), face_triangles(counts));
}

fn face_triangles(counts: FaceCounts) -> u32 {
    if counts.inner.x == 0u {
        return 2u;
    }
    if is_nested() {
        return 2u * counts.inner.x * counts.inner.y;
    }
    let grid = counts.inner - 2u;
    return 2u * grid.x * grid.y + edge_total(counts) + 2u * (grid.x + grid.y);
}

// The part of a face that its inner grid is; parts before it are the strips along the edges.
const INSIDE: u32 = 4u;

// The part that triangle `index` belongs to.
fn triangle_part(counts_in: FaceCounts, index: u32) -> u32 {
    var counts = counts_in;
    if counts.inner.x == 0u {
        return INSIDE;
    }
    if is_nested() {
        let side = counts.inner.x;
        let at = vec2((index / 2u) % side, (index / 2u) / side);
        if index % 2u == 0u {
            if at.y == 0u {
                return 0u;
            }
            return select(INSIDE, 1u, at.x == side - 1u);
        }
        if at.y == side - 1u {
            return 2u;
        }
        return select(INSIDE, 3u, at.x == 0u);
    }
    let grid = counts.inner - 2u;
    let grid_triangles = 2u * grid.x * grid.y;
    if index < grid_triangles {
        return INSIDE;
    }
    var rest = index - grid_triangles;
    for (var e = 0u; e < 3u; e++) {
        let strip = counts.edge[e] + select(grid.x, grid.y, e % 2u == 1u);
        if rest < strip {
            return e;
        }
        rest -= strip;
    }
    return 3u;
}

// The fixed-point factor of a part; inside, the larger of the two.
fn part_factor(factors: FaceFactors, part: u32) -> u32 {
    if part != INSIDE {
        return factors.edges[part];
    }
    let inner = inner_factors(factors);
    return max(inner.x, inner.y);
}

// The ends of edge `e` of a face in the order that it is cut in, counted around the face: all edges are
// cut the way that their axis rises, so that the faces on both sides agree.
fn edge_ends(e: u32) -> vec2<u32> {
    return select(vec2((e + 1u) % 4u, e), vec2(e, e + 1u), e < 2u);
}

// Cut `index` of edge `e`, from corner `e` on.
fn edge_point(
    corners_in: array<vec2<i32>, 4>,
    e: u32,
    factor: u32,
    count: u32,
    index: u32,
) -> vec2<i32> {
    var corners = corners_in;
    let ends = edge_ends(e);
    let cut = select(count - index, index, e < 2u);
    return lerp_point(corners[ends.x], corners[ends.y], segment_parameter(factor, count, cut));
}

// Place `at` of the inner grid.
fn grid_point(
    corners: array<vec2<i32>, 4>,
    factors: FaceFactors,
    counts: FaceCounts,
    at: vec2<u32>,
) -> vec2<i32> {
    var uv: vec2<i32>;
    if is_nested() {
        uv = vec2<i32>((at << vec2(16u)) / counts.inner);
    } else {
        let inner = inner_factors(factors);
        uv.x = segment_parameter(inner.x, counts.inner.x, at.x);
        uv.y = segment_parameter(inner.y, counts.inner.y, at.y);
    }
    let near = lerp_point(corners[0], corners[1], uv.x);
    let far = lerp_point(corners[3], corners[2], uv.x);
    return lerp_point(near, far, uv.y);
}

// Where a place of a grid that reaches the edges lies on one of them: the edge, and the cut counted
// from its first corner. Edge 4: none.
fn rim_cut(counts_in: FaceCounts, at: vec2<u32>) -> vec2<u32> {
    var counts = counts_in;
    let side = counts.inner.x;
    var e = 4u;
    var along = 0u;
    if at.y == 0u && at.x < side {
        e = 0u;
        along = at.x;
    } else if at.x == side && at.y < side {
        e = 1u;
        along = at.y;
    } else if at.y == side && at.x > 0u {
        e = 2u;
        along = side - at.x;
    } else if at.x == 0u {
        e = 3u;
        along = side - at.y;
    } else {
        return vec2(4u, 0u);
    }
    let count = counts.edge[e];
    let cut = select(count - (side - along) * count / side, along * count / side, e < 2u);
    return vec2(e, cut);
}

// Place `at` of a grid that reaches the edges, rim included.
fn nested_point(
    corners_in: array<vec2<i32>, 4>,
    factors: FaceFactors,
    counts_in: FaceCounts,
    at: vec2<u32>,
) -> vec2<i32> {
    var corners = corners_in;
    var counts = counts_in;
    let rim = rim_cut(counts, at);
    if rim.x == 4u {
        return grid_point(corners, factors, counts, at);
    }
    let e = rim.x;
    return edge_point(corners, e, factors.edges[e], counts.edge[e], rim.y);
}

// The number of the vertex at a place of a grid that reaches the edges.
fn nested_number(counts_in: FaceCounts, at: vec2<u32>) -> u32 {
    var counts = counts_in;
    let total = edge_total(counts);
    let rim = rim_cut(counts, at);
    if rim.x == 4u {
        return total + (at.y - 1u) * (counts.inner.x - 1u) + at.x - 1u;
    }
    var first = 0u;
    for (var e = 0u; e < rim.x; e++) {
        first += counts.edge[e];
    }
    return (first + rim.y) % total;
}

fn settled(point: vec2<i32>) -> FaceVertex {
    return FaceVertex(point, array(point, point), ONE);
}

fn face_vertex(
    corners_in: array<vec2<i32>, 4>,
    factors: FaceFactors,
    counts_in: FaceCounts,
    index: u32,
) -> FaceVertex {
    var corners = corners_in;
    var counts = counts_in;
    if counts.inner.x == 0u {
        return settled(corners[index]);
    }
    var rest = index;
    for (var e = 0u; e < 4u; e++) {
        let count = counts.edge[e];
        if rest < count {
            return settled(edge_point(corners, e, factors.edges[e], count, rest));
        }
        rest -= count;
    }
    let columns = counts.inner.x - 1u;
    let at = vec2(rest % columns, rest / columns) + 1u;
    let point = grid_point(corners, factors, counts, at);
    let odd = at % vec2(2u);
    if !is_nested() || odd.x + odd.y == 0u {
        return settled(point);
    }
    let parents = array(
        nested_point(corners, factors, counts, at - odd),
        nested_point(corners, factors, counts, at + odd),
    );
    return FaceVertex(point, parents, rise_of(inner_factors(factors).x, counts.inner.x));
}

// The lattice point where a vertex is drawn.
fn drawn_point(vertex: FaceVertex) -> vec2<i32> {
    if vertex.rise == ONE {
        return vertex.point;
    }
    let middle = (vertex.parents[0] + vertex.parents[1]) >> vec2(1u);
    return lerp_point(middle, vertex.point, vertex.rise);
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
    let first_half = index % 2u == 0u;
    if is_nested() {
        let side = counts.inner.x;
        let at = vec2((index / 2u) % side, (index / 2u) / side);
        let a = nested_number(counts, at);
        let b = nested_number(counts, at + select(vec2(0u, 1u), vec2(1u, 0u), first_half));
        let c = nested_number(counts, at + 1u);
        return select(vec3(a, b, c), vec3(a, c, b), first_half);
    }
    let grid = counts.inner - 2u;
    let stride = grid.x + 1u;
    let first_inner = edge_total(counts);
    let grid_triangles = 2u * grid.x * grid.y;
    if index < grid_triangles {
        let quad = index / 2u;
        let a = first_inner + (quad / grid.x) * stride + quad % grid.x;
        let c = a + stride + 1u;
        return select(vec3(a, a + stride, c), vec3(a, c, a + 1u), first_half);
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
        let outer = edge_row(outer_count);
        let ring = ring_row(inner_count);
        // Each triangle finds its own partner in the other row.
        if rest < outer_count {
            let j = segments_before(ring, segment_slot(outer, rest));
            return vec3(
                first_outer + rest,
                ring_vertex(first_inner, grid, e, j),
                (first_outer + rest + 1u) % first_inner,
            );
        }
        let j = rest - outer_count;
        let i = segments_before(outer, segment_slot(ring, j) + 1u);
        return vec3(
            ring_vertex(first_inner, grid, e, j),
            ring_vertex(first_inner, grid, e, j + 1u),
            (first_outer + i) % first_inner,
        );
    }
    return vec3(0u);
}
