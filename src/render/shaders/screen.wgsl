#define_import_path bevy_tessera::screen

// How long the mesh's triangles are on the screen.

#import bevy_tessera::types::TerrainVertex
#import bevy_tessera::bindings::terrain_view

// A vertex relative to the eye, metres.
fn from_eye_m(vertex: TerrainVertex) -> vec3<f32> {
    let whole = vec2<f32>(vertex.point - terrain_view.eye);
    let plane_m = (whole - terrain_view.eye_fraction) * terrain_view.unit_m;
    return vec3(plane_m.x, vertex.height_m - terrain_view.eye_height_m, plane_m.y);
}

fn length_px(a: vec3<f32>, b: vec3<f32>) -> f32 {
    let length_m = length(b - a);
    let distance_m = max(length(0.5 * (a + b)), 0.5 * length_m);
    let in_perspective = terrain_view.focal_px > 0.0 && distance_m > 0.0;
    let by_angle = length_m * terrain_view.focal_px / max(distance_m, 1e-30);
    return select(length_m * terrain_view.px_per_m, by_angle, in_perspective);
}

// The longest edge of a triangle.
fn longest_px(first: TerrainVertex, second: TerrainVertex, third: TerrainVertex) -> f32 {
    let a = from_eye_m(first);
    let b = from_eye_m(second);
    let c = from_eye_m(third);
    return max(length_px(a, b), max(length_px(b, c), length_px(c, a)));
}
