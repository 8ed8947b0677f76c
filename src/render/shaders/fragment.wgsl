// The end of every terrain material: appended to the WGSL that defines `terrain_material`.

// Everything is imported by module and under a name of its own: what a game's module imports, and
// how it calls it, must not meet what is imported here.

#import bevy_tessera::surface as terrain_surface_module
#import bevy_tessera::vertex_io as terrain_vertex_module
#import bevy_pbr::mesh_types as terrain_mesh_types
#import bevy_pbr::mesh_view_bindings as terrain_view_bindings
#import bevy_pbr::pbr_functions as terrain_pbr_functions
#import bevy_pbr::pbr_types as terrain_pbr_types
#ifdef TERRAIN_DENSITY_PREVIEW
#import bevy_tessera::density_preview as terrain_density_module
#endif
#ifdef TERRAIN_OVERLAY
#import bevy_tessera::overlay as terrain_overlay_module
#endif
#ifdef PREPASS_PIPELINE
#ifdef DEFERRED_PREPASS
#import bevy_pbr::pbr_deferred_functions as terrain_deferred_functions
#endif
#ifdef MOTION_VECTOR_PREPASS
#import bevy_pbr::pbr_prepass_functions as terrain_prepass_functions
#endif
#else
#ifdef SCREEN_SPACE_AMBIENT_OCCLUSION
#import bevy_pbr::ssao_utils as terrain_ssao_utils
#import bevy_pbr::lighting as terrain_lighting
#endif
#endif

// `after` is left alone, or becomes what is to be laid over the picture and how much of that is left.
fn terrain_pbr_input(
    in: terrain_vertex_module::TerrainVertexOutput,
    after: ptr<function, vec4<f32>>,
) -> terrain_pbr_types::PbrInput {
    let world_from_eye = terrain_surface_module::terrain_draw.world_from_eye;
    var surface: terrain_surface_module::TerrainSurface;
    let across = fwidth(in.plane_from_eye_m);
    let footprint_m = max(across.x, across.y);
    let local_normal = terrain_surface_module::terrain_normal(
        in.plane_from_eye_m,
        in.lambda,
        in.height_m,
        footprint_m,
    );
    surface.world_position = in.world_position;
    let plane = terrain_surface_module::terrain_draw.eye_local_m + in.plane_from_eye_m;
    surface.local_position = vec3(plane.x, in.height_m, plane.y);
    surface.height_m = in.height_m;
    surface.slope = 1.0 - local_normal.y;
    surface.normal = normalize((world_from_eye * vec4(local_normal, 0.0)).xyz);
    surface.frag_coord = in.position;
    surface.from_eye_m = in.plane_from_eye_m;
    surface.footprint_m = footprint_m;

    var pbr = terrain_pbr_types::pbr_input_new();
    pbr.flags = terrain_mesh_types::MESH_FLAGS_SHADOW_RECEIVER_BIT;
    pbr.material.flags |= terrain_pbr_types::STANDARD_MATERIAL_FLAGS_FOG_ENABLED_BIT;
    pbr.frag_coord = in.position;
    pbr.world_position = vec4(in.world_position, 1.0);
    pbr.world_normal = surface.normal;
    pbr.N = surface.normal;
    pbr.clearcoat_N = surface.normal;
    pbr.is_orthographic = terrain_view_bindings::view.clip_from_view[3].w == 1.0;
    pbr.V = terrain_pbr_functions::calculate_view(pbr.world_position, pbr.is_orthographic);
    pbr = terrain_material(surface, pbr);
#ifdef TERRAIN_DENSITY_PREVIEW
    let color = pbr.material.base_color;
    pbr.material.base_color = vec4(
        terrain_density_module::density_over(color.rgb, in.plane_from_eye_m, in.lambda),
        color.a,
    );
#endif
#ifdef TERRAIN_OVERLAY
    pbr = terrain_overlay_module::overlaid(
        pbr,
        surface,
        in.lambda,
        in.overlay_own,
        in.overlay_of_triangle,
        after,
    );
#endif
    return pbr;
}

#ifdef PREPASS_PIPELINE

struct TerrainPrepassOutput {
#ifdef NORMAL_PREPASS
    @location(0) normal: vec4<f32>,
#endif
#ifdef MOTION_VECTOR_PREPASS
    @location(1) motion_vector: vec2<f32>,
#endif
#ifdef DEFERRED_PREPASS
    @location(2) deferred: vec4<u32>,
    @location(3) deferred_lighting_pass_id: u32,
#endif
#ifdef UNCLIPPED_DEPTH_ORTHO_EMULATION
    @builtin(frag_depth) frag_depth: f32,
#endif
}

#ifdef PREPASS_FRAGMENT
@fragment
fn fragment(in: terrain_vertex_module::TerrainVertexOutput) -> TerrainPrepassOutput {
    var out: TerrainPrepassOutput;
#ifdef TERRAIN_READS_MATERIAL
    var after = vec4(0.0, 0.0, 0.0, 1.0);
    let pbr = terrain_pbr_input(in, &after);
#ifdef NORMAL_PREPASS
    out.normal = vec4(pbr.N * 0.5 + vec3(0.5), 1.0);
#endif
#ifdef DEFERRED_PREPASS
    out.deferred = terrain_deferred_functions::deferred_gbuffer_from_pbr_input(pbr);
    out.deferred_lighting_pass_id = pbr.material.deferred_lighting_pass_id;
#endif
#endif
#ifdef MOTION_VECTOR_PREPASS
    out.motion_vector = terrain_prepass_functions::calculate_motion_vector(
        vec4(in.world_position, 1.0),
        vec4(in.previous_world_position, 1.0),
    );
#endif
#ifdef UNCLIPPED_DEPTH_ORTHO_EMULATION
    out.frag_depth = in.unclipped_depth;
#endif
    return out;
}
#endif

#else

@fragment
fn fragment(in: terrain_vertex_module::TerrainVertexOutput) -> @location(0) vec4<f32> {
    var after = vec4(0.0, 0.0, 0.0, 1.0);
    var pbr = terrain_pbr_input(in, &after);
    var color = pbr.material.base_color;
    if (pbr.material.flags & terrain_pbr_types::STANDARD_MATERIAL_FLAGS_UNLIT_BIT) == 0u {
#ifdef SCREEN_SPACE_AMBIENT_OCCLUSION
        let ssao = textureLoad(
            terrain_view_bindings::screen_space_ambient_occlusion_texture,
            vec2<i32>(in.position.xy),
            0i,
        ).r;
        let bounced = terrain_ssao_utils::ssao_multibounce(ssao, pbr.material.base_color.rgb);
        pbr.diffuse_occlusion = min(pbr.diffuse_occlusion, bounced);
        // Lagarde and de Rousiers 2014, specular occlusion from ambient occlusion.
        let n_dot_v = max(dot(pbr.N, pbr.V), 0.0001);
        let roughness = terrain_lighting::perceptualRoughnessToRoughness(
            pbr.material.perceptual_roughness,
        );
        pbr.specular_occlusion =
            saturate(pow(n_dot_v + ssao, exp2(-16.0 * roughness - 1.0)) - 1.0 + ssao);
#endif
        color = terrain_pbr_functions::apply_pbr_lighting(pbr);
    }
    color = terrain_pbr_functions::main_pass_post_lighting_processing(pbr, color);
#ifdef TERRAIN_OVERLAY
    color = vec4(after.a * color.rgb + after.rgb, color.a);
#endif
    return color;
}

#endif
