#define_import_path bevy_tessera::lattice

// Twin of `src/lattice`: level of detail as a function of position alone, in integers.

#import bevy_tessera::types::{ONE, TILE_SAMPLES}
#import bevy_tessera::bindings::{terrain_view, residency_field}

// d * t / ONE, rounded down, with products that 32 bits hold.
fn scale(d: i32, t: i32) -> i32 {
    let low = (u32(d) & 0xffffu) * u32(t) >> 16u;
    return (d >> 16u) * t + i32(low);
}

fn lerp_point(a: vec2<i32>, b: vec2<i32>, t: i32) -> vec2<i32> {
    return a + vec2(scale(b.x - a.x, t), scale(b.y - a.y, t));
}

fn node_shift(level: i32) -> u32 {
    return u32(7 + i32(terrain_view.unit_shift) + level);
}

fn view_distance(p: vec2<i32>) -> i32 {
    if terrain_view.planar == 0u {
        return terrain_view.distance_floor;
    }
    let d = abs(p - terrain_view.eye);
    return max(max(d.x, d.y), terrain_view.distance_floor);
}

fn morph(p: vec2<i32>, level: i32) -> i32 {
    let geometry = terrain_view.geometry[level - terrain_view.leaf_level];
    let distance = view_distance(p);
    if distance <= geometry.x {
        return 0;
    }
    let beyond = distance - geometry.x;
    let zone_log2 = u32(geometry.y);
    if beyond >= (1 << zone_log2) {
        return ONE;
    }
    if zone_log2 >= 16u {
        return beyond >> (zone_log2 - 16u);
    }
    return beyond << (16u - zone_log2);
}

// The residency field at p, 8.8 fixed point.
fn field_at(p: vec2<i32>) -> i32 {
    let log2 = vec2(terrain_view.field_cell_shift);
    let q = vec2<u32>(max(p, vec2(0)));
    let cell = min(q >> log2, terrain_view.field_cells - 1u);
    let weight = min((q - (cell << log2)) >> (log2 - 8u), vec2(256u));
    let stride = terrain_view.field_cells.x + 1u;
    let first = cell.y * stride + cell.x;
    let near = residency_field[first] * (256u - weight.x) + residency_field[first + 1u] * weight.x;
    let far = residency_field[first + stride] * (256u - weight.x)
        + residency_field[first + stride + 1u] * weight.x;
    return i32((near * (256u - weight.y) + far * weight.y) >> 16u);
}

// The level of detail at which height and density are read at p, 16.16.
fn lambda_at(p: vec2<i32>, level: i32) -> i32 {
    let detail = level * ONE + morph(p, level);
    return min(max(detail, field_at(p) << 8u), terrain_view.root_level * ONE);
}

fn clamp_point(p: vec2<i32>) -> vec2<i32> {
    return clamp(p, vec2(0), terrain_view.extent);
}

// Lattice units along the side of a face.
fn face_size(level: i32) -> i32 {
    return 1 << (node_shift(level) - terrain_view.faces_shift);
}

fn control_vertex(origin: vec2<i32>, level: i32, ij: vec2<i32>) -> vec2<i32> {
    let step = face_size(level);
    let grid = origin + ij * step;
    let slide = scale(step, morph(clamp_point(grid), level));
    return clamp_point(grid - (ij & vec2(1)) * slide);
}
