#define_import_path bevy_tessera::edge

// Twin of `src/tessellate/factor.rs`: an edge as the eye sees it.

#import bevy_tessera::bindings::terrain_view
#import bevy_tessera::edge_error::{error_at, error_level}

// How far the square beside an edge reaches from its middle, in lengths of the edge: half a diagonal.
const SQUARE_REACH: f32 = 0.70710677;
// The longest edge of a triangle, in lengths of a segment: the diagonal of a square.
const STRETCH: f32 = 1.4142135;
// Nearer than this no ground is taken to be when its error is to be named in pixels, metres.
const NEAREST_M: f32 = 1e-3;

// An edge as the eye sees it.
struct ProjectedEdge {
    // Segments that the view wants, were the ground as rough as can be.
    wanted: f32,
    // The most that it may have.
    limit: f32,
    length_m: f32,
    // From the eye to the nearest ground of the square beside it.
    nearest_m: f32,
}

fn project_edge(a: vec2<i32>, a_height_m: f32, b: vec2<i32>, b_height_m: f32) -> ProjectedEdge {
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
    return ProjectedEdge(
        projected + diameter_m * terrain_view.segments_per_m,
        min(length_m / terrain_view.min_triangle_m, terrain_view.max_factor),
        length_m,
        max(distance_m - SQUARE_REACH * diameter_m, 0.0),
    );
}

// Metres between the samples that errors of faces of a level count in.
fn error_sample_m(level: i32) -> f32 {
    let sample_m = terrain_view.unit_m * f32(1u << terrain_view.unit_shift);
    return sample_m * f32(1u << error_level(level));
}

// What `errors` say of the vertical error that triangles leave beside an edge that is cut by a factor
// (1 to 64), in pixels on the screen.
fn edge_error_px(
    edge: ProjectedEdge,
    errors: array<u32, 7>,
    sample_m: f32,
    factor: f32,
) -> f32 {
    let spacing = STRETCH * edge.length_m / factor / sample_m;
    let error_m = error_at(errors, spacing) / terrain_view.error_units_per_m;
    if terrain_view.focal_px > 0.0 {
        return error_m * terrain_view.focal_px / max(edge.nearest_m, NEAREST_M);
    }
    return error_m * terrain_view.px_per_m;
}
