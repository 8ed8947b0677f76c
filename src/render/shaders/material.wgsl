// The default material: grass and earth where the ground is gentle, rock where it is steep.

#import bevy_tessera::surface::{TerrainSurface, material_parameters}
#import bevy_pbr::pbr_types::PbrInput

// material_parameters[0].rgb: ground colour; [1].rgb: rock colour; [2].xy: slopes between which
// the ground turns into rock.
fn terrain_material(surface: TerrainSurface, base: PbrInput) -> PbrInput {
    var pbr = base;
    let rock = smoothstep(material_parameters[2].x, material_parameters[2].y, surface.slope);
    let color = mix(material_parameters[0].rgb, material_parameters[1].rgb, rock);
    pbr.material.base_color = vec4(color, 1.0);
    pbr.material.perceptual_roughness = mix(0.95, 0.8, rock);
    pbr.material.reflectance = vec3(0.2);
    return pbr;
}
