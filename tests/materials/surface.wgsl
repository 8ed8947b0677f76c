// Shows what a material is told of the ground, and what it is given from Rust.

#import bevy_tessera::surface::{TerrainSurface, material_parameters}
#import bevy_pbr::pbr_types::{PbrInput, STANDARD_MATERIAL_FLAGS_UNLIT_BIT}

fn terrain_material(surface: TerrainSurface, base: PbrInput) -> PbrInput {
    var pbr = base;
    var shown = vec3(0.0);
    switch u32(material_parameters[0].x) {
        case 0u: {
            shown = surface.normal * 0.5 + 0.5;
        }
        case 1u: {
            shown = vec3(surface.height_m / 150.0, surface.slope, 0.0);
        }
        case 2u: {
            shown = surface.local_position / vec3(800.0, 150.0, 800.0);
        }
        case 3u: {
            shown = (surface.world_position - material_parameters[1].xyz)
                / vec3(800.0, 150.0, 800.0);
        }
        default: {
            shown = material_parameters[7].xyz;
        }
    }
    pbr.material.flags |= STANDARD_MATERIAL_FLAGS_UNLIT_BIT;
    pbr.material.base_color = vec4(shown, 1.0);
    return pbr;
}
