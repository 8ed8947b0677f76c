// Draws the mesh that the passes wrote: lattice integers become camera-relative floats only here.

#import bevy_tessera::surface::terrain_draw
#import bevy_tessera::vertex_io::{TerrainVertexInput, TerrainVertexOutput}
#import bevy_pbr::mesh_view_bindings::view
#ifdef TERRAIN_OVERLAY
#import bevy_tessera::overlay_vertex::overlay_vertex
#endif

@vertex
#ifdef TERRAIN_OVERLAY
fn vertex(@builtin(vertex_index) vertex_index: u32) -> TerrainVertexOutput {
    let pulled = overlay_vertex(vertex_index);
    let in = pulled.vertex;
#else
fn vertex(in: TerrainVertexInput) -> TerrainVertexOutput {
#endif
    let whole = vec2<f32>(in.point - terrain_draw.eye_point);
    let plane_m = (whole - terrain_draw.eye_fraction) * terrain_draw.unit_m;
    let from_eye = vec3(plane_m.x, in.height_m - terrain_draw.eye_height_m, plane_m.y);
    let turned = (terrain_draw.world_from_eye * vec4(from_eye, 0.0)).xyz;
    let eye = terrain_draw.world_from_eye[3].xyz;

    var out: TerrainVertexOutput;
    out.world_position = turned + eye;
#ifdef TERRAIN_SHADOW
    out.position = view.clip_from_world * vec4(out.world_position, 1.0);
#else
    // For the eye that the mesh was made for, the difference is zero and nothing large is ever
    // added: millimetres hold at a hundred kilometres.
    let from_view = turned + (eye - view.world_position);
    let in_view = view.view_from_world * vec4(from_view, 0.0);
    out.position = view.clip_from_view * vec4(in_view.xyz, 1.0);
#endif
    out.plane_from_eye_m = plane_m;
    out.height_m = in.height_m;
    out.lambda = f32(in.lambda) / 65536.0;
#ifdef MOTION_VECTOR_PREPASS
    out.previous_world_position =
        (terrain_draw.previous_world_from_eye * vec4(from_eye, 1.0)).xyz;
#endif
#ifdef TERRAIN_OVERLAY
    out.overlay_own = pulled.own;
    out.overlay_of_triangle = pulled.of_triangle;
#endif
#ifdef UNCLIPPED_DEPTH_ORTHO_EMULATION
    out.unclipped_depth = out.position.z;
    out.position.z = min(out.position.z, 1.0);
#endif
    return out;
}
