// The default material: grass and earth where the ground is gentle, rock where it is steep, and
// scorched earth where edits have left it.

#import bevy_tessera::destruction::{scorch_grain, surface_scorch}
#import bevy_tessera::surface::{TerrainSurface, material_parameters}
#import bevy_pbr::pbr_types::PbrInput

// material_parameters[0].rgb: ground colour; [1].rgb: rock colour; [2].xy: slopes between which
// the ground turns into rock; [3].rgb: colour of scorched earth, [3].w: how much of it is seen.
fn terrain_material(surface: TerrainSurface, base: PbrInput) -> PbrInput {
    var pbr = base;
    let rock = smoothstep(material_parameters[2].x, material_parameters[2].y, surface.slope);
    let color = mix(material_parameters[0].rgb, material_parameters[1].rgb, rock);
    pbr.material.base_color = vec4(color, 1.0);
    pbr.material.perceptual_roughness = mix(0.95, 0.8, rock);
    pbr.material.reflectance = vec3(0.2);

    let scorch = surface_scorch(surface);
    if scorch > 0.0 {
        // What is scorched through stays so; towards the edge the grain decides where it ends.
        let grain = scorch_grain(surface);
        let edge = (grain - 0.5) * (1.0 - scorch) * min(4.0 * scorch, 1.0);
        let burnt = material_parameters[3].w * smoothstep(0.0, 0.6, scorch + edge);
        let earth = material_parameters[3].rgb * (0.6 + 0.8 * grain);
        pbr.material.base_color = vec4(mix(color, earth, burnt), 1.0);
        pbr.material.perceptual_roughness = mix(pbr.material.perceptual_roughness, 1.0, burnt);
        pbr.material.reflectance = mix(pbr.material.reflectance, vec3(0.05), burnt);
    }
    return pbr;
}
