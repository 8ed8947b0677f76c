// Shows what the prepasses hold.

#import bevy_tessera::surface::{TerrainSurface, material_parameters}
#import bevy_pbr::pbr_types::{PbrInput, STANDARD_MATERIAL_FLAGS_UNLIT_BIT}
#ifndef PREPASS_PIPELINE
#import bevy_pbr::prepass_utils::{prepass_depth, prepass_motion_vector, prepass_normal}
#endif

fn terrain_material(surface: TerrainSurface, base: PbrInput) -> PbrInput {
    var pbr = base;
    var shown = vec3(0.0);
#ifndef PREPASS_PIPELINE
    let settings = material_parameters[0];
    if settings.x < 0.5 {
        let motion = prepass_motion_vector(surface.frag_coord, 0u);
        shown = vec3(motion * settings.z + 0.5, 0.0);
    } else if settings.x < 1.5 {
        shown = prepass_normal(surface.frag_coord, 0u) * 0.5 + 0.5;
    } else {
        // Bevy's near plane, over reversed depth.
        shown = vec3(0.1 / prepass_depth(surface.frag_coord, 0u) / settings.y);
    }
#endif
    pbr.material.flags |= STANDARD_MATERIAL_FLAGS_UNLIT_BIT;
    pbr.material.base_color = vec4(shown, 1.0);
    return pbr;
}
