#define_import_path bevy_tessera::vertex_io

struct TerrainVertexInput {
    @location(0) point: vec2<i32>,
    @location(1) height_m: f32,
    @location(2) lambda: i32,
}

struct TerrainVertexOutput {
    // Prepass and main pass must come to the same depth, bit for bit.
    @builtin(position) @invariant position: vec4<f32>,
    @location(0) world_position: vec3<f32>,
    @location(1) plane_from_eye_m: vec2<f32>,
    @location(2) height_m: f32,
    @location(3) lambda: f32,
#ifdef MOTION_VECTOR_PREPASS
    @location(4) previous_world_position: vec3<f32>,
#endif
#ifdef UNCLIPPED_DEPTH_ORTHO_EMULATION
    @location(5) unclipped_depth: f32,
#endif
#ifdef TERRAIN_OVERLAY
    // See `OverlayVertex`.
    @location(6) overlay_own: vec4<f32>,
    @location(7) @interpolate(flat) overlay_of_triangle: vec4<f32>,
#endif
}
