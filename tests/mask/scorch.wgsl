// Shows what a material is told of scorch.

#import bevy_tessera::destruction::surface_scorch
#import bevy_tessera::surface::TerrainSurface
#import bevy_pbr::pbr_types::{PbrInput, STANDARD_MATERIAL_FLAGS_UNLIT_BIT}

fn terrain_material(surface: TerrainSurface, base: PbrInput) -> PbrInput {
    var pbr = base;
    pbr.material.flags |= STANDARD_MATERIAL_FLAGS_UNLIT_BIT;
    pbr.material.base_color = vec4(surface_scorch(surface), 0.25, 0.0, 1.0);
    return pbr;
}
