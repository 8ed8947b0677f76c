#define_import_path bevy_tessera::bindings

#import bevy_tessera::detail::Detail
#import bevy_tessera::types::{
    COUNTERS, TerrainView, TerrainNode, TerrainVertex, TerrainDrawArgs, TerrainOverlays,
}

#ifdef TERRAIN_OVERLAY
// What the vertex shader of a draw with overlays reads beside the draw's own bindings.
@group(2) @binding(8) var<uniform> terrain_view: TerrainView;
@group(2) @binding(9) var<storage, read> pulled_vertices: array<TerrainVertex>;
@group(2) @binding(10) var<storage, read> pulled_indices: array<u32>;
@group(2) @binding(11) var<storage, read> pulled_faces: array<vec2<u32>>;
@group(2) @binding(12) var<storage, read> pulled_errors: array<f32>;
@group(2) @binding(13) var<storage, read> residency_field: array<u32>;
#else
// Group 0: what a view's mesh is made from.
@group(0) @binding(0) var<uniform> terrain_view: TerrainView;
@group(0) @binding(1) var<storage, read> nodes: array<TerrainNode>;
@group(0) @binding(2) var<storage, read> page_table: array<u32>;
@group(0) @binding(3) var<storage, read> residency_field: array<u32>;
@group(0) @binding(4) var height_pages: texture_2d_array<u32>;
@group(0) @binding(5) var density_pages: texture_2d_array<u32>;
@group(0) @binding(6) var error_pages: texture_2d_array<u32>;
@group(0) @binding(7) var<uniform> terrain_detail: Detail;

// Group 1: what the passes hand on; each pass binds the part that it uses.
@group(1) @binding(0) var<storage, read_write> classified_factors: array<vec4<u32>>;
@group(1) @binding(0) var<storage, read> face_factors: array<vec4<u32>>;
@group(1) @binding(1) var<storage, read_write> classified_totals: array<vec2<u32>>;
@group(1) @binding(1) var<storage, read> node_totals: array<vec2<u32>>;
@group(1) @binding(2) var<storage, read_write> setup_offsets: array<vec2<u32>>;
@group(1) @binding(2) var<storage, read> node_offsets: array<vec2<u32>>;
@group(1) @binding(3) var<storage, read_write> setup_args: TerrainDrawArgs;
@group(1) @binding(3) var<storage, read> draw_args: TerrainDrawArgs;
@group(1) @binding(4) var<storage, read_write> mesh_vertices: array<TerrainVertex>;
@group(1) @binding(4) var<storage, read> drawn_vertices: array<TerrainVertex>;
@group(1) @binding(5) var<storage, read_write> mesh_indices: array<u32>;
@group(1) @binding(5) var<storage, read> drawn_indices: array<u32>;
@group(1) @binding(6) var<storage, read_write> counters: array<atomic<u32>, COUNTERS>;
@group(1) @binding(7) var<storage, read_write> triangle_faces: array<vec2<u32>>;
@group(1) @binding(8) var<storage, read_write> part_errors: array<f32>;
@group(1) @binding(9) var<uniform> face_overlays: TerrainOverlays;
#endif
