//! What the ground looks like: a game's own WGSL, or the default grass and rock.

use bevy::asset::{AssetId, LoadState};
use bevy::platform::collections::HashMap;
use bevy::prelude::*;
use bevy::shader::{Shader, Source};

/// The WGSL of the default material; a template for a game's own.
pub const DEFAULT_MATERIAL_WGSL: &str = include_str!("shaders/material.wgsl");
/// What is appended to a material's WGSL: the entry points of all passes.
const FRAGMENT_WGSL: &str = include_str!("shaders/fragment.wgsl");
/// Path of the default material's composed shader.
const DEFAULT_PATH: &str = "bevy_tessera/default_material.wgsl";

/// How a terrain is shaded; put it beside [`Terrain`](crate::terrain::Terrain).
///
/// `shader` is WGSL that defines
///
/// ```wgsl
/// #import bevy_tessera::surface::{TerrainSurface, material_parameters}
/// #import bevy_pbr::pbr_types::PbrInput
///
/// fn terrain_material(surface: TerrainSurface, base: PbrInput) -> PbrInput {
///     var pbr = base;
///     pbr.material.base_color = vec4(vec3(surface.slope), 1.0);
///     return pbr;
/// }
/// ```
///
/// It receives position, height, slope and normal of the ground, may ask how scorched the ground is
/// (`bevy_tessera::destruction::surface_scorch(surface)`, 0 to 1), and returns Bevy's PBR input;
/// lighting, shadows, fog, the prepasses and the deferred G-buffer follow from that. The entry
/// points of all passes are appended to the module, so it must define neither entry points nor
/// names that begin with `terrain_` or `Terrain` but `terrain_material`. It may bind nothing of its
/// own; `material_parameters` carries eight `vec4<f32>` from here. Saving the file while the game
/// runs with Bevy's file watcher shows the change. Where the file can't be read, an error says so
/// and the default is drawn; where it doesn't compile, Bevy says why and nothing is drawn.
#[derive(Component, Clone, Debug, PartialEq, Reflect)]
#[reflect(Component, Default, Clone, PartialEq)]
pub struct TerrainMaterial {
    /// The game's WGSL; `None` for the default.
    pub shader: Option<Handle<Shader>>,
    /// What `material_parameters` holds. The default material reads linear colours of gentle
    /// ground from `[0]` and of rock from `[1]`, and the two slopes (0 level, 1 vertical) between
    /// which one turns into the other from `[2]`; the colour of scorched earth from `[3]`, and how much
    /// of it is seen, 0 to 1, from its fourth component.
    pub parameters: [Vec4; 8],
}

impl Default for TerrainMaterial {
    fn default() -> Self {
        let mut parameters = [Vec4::ZERO; 8];
        parameters[0] = Vec4::new(0.105, 0.125, 0.065, 1.0);
        parameters[1] = Vec4::new(0.16, 0.15, 0.135, 1.0);
        parameters[2] = Vec4::new(0.08, 0.25, 0.0, 0.0);
        parameters[3] = Vec4::new(0.016, 0.0135, 0.012, 1.0);
        Self {
            shader: None,
            parameters,
        }
    }
}

/// Material shaders with their entry points appended, by the shader that a game gave.
#[derive(Resource, Debug)]
pub(super) struct ComposedMaterials {
    default: Handle<Shader>,
    composed: HashMap<AssetId<Shader>, Handle<Shader>>,
}

impl ComposedMaterials {
    /// The shader to draw `material` with; `None` while its WGSL is loading.
    pub(super) fn shader(&self, material: &TerrainMaterial) -> Option<Handle<Shader>> {
        match &material.shader {
            None => Some(self.default.clone()),
            Some(shader) => self.composed.get(&shader.id()).cloned(),
        }
    }
}

/// A material's WGSL with the entry points of all passes after it.
#[must_use]
pub fn compose_material(material_wgsl: &str) -> String {
    format!("{material_wgsl}\n{FRAGMENT_WGSL}")
}

pub(super) fn add_default_material(world: &mut World) {
    let shader = Shader::from_wgsl(compose_material(DEFAULT_MATERIAL_WGSL), DEFAULT_PATH);
    let default = world.resource_mut::<Assets<Shader>>().add(shader);
    world.insert_resource(ComposedMaterials {
        default,
        composed: HashMap::default(),
    });
}

/// Composes a material's shader when its WGSL has loaded or changed.
pub(super) fn compose_materials(
    materials: Query<&TerrainMaterial>,
    mut events: MessageReader<AssetEvent<Shader>>,
    server: Res<AssetServer>,
    mut shaders: ResMut<Assets<Shader>>,
    mut composed: ResMut<ComposedMaterials>,
) {
    let mut stale = Vec::new();
    for event in events.read() {
        // A file that was mended after it could not be read is added, not modified.
        if let AssetEvent::Modified { id } | AssetEvent::Added { id } = event {
            stale.push(*id);
        }
    }
    for material in &materials {
        let Some(given) = &material.shader else {
            continue;
        };
        let id = given.id();
        if composed.composed.contains_key(&id) && !stale.contains(&id) {
            continue;
        }
        let Some(shader) = shaders.get(id) else {
            if let Some(LoadState::Failed(error)) = server.get_load_state(id) {
                error!("a terrain's material can't be read: {error}; the default is drawn");
                let default = composed.default.clone();
                composed.composed.insert(id, default);
            }
            continue;
        };
        let Source::Wgsl(wgsl) = &shader.source else {
            if !composed.composed.contains_key(&id) {
                error!(
                    "terrain material {} is not WGSL: write it in WGSL; the default material is \
                     drawn",
                    shader.path
                );
                let default = composed.default.clone();
                composed.composed.insert(id, default);
            }
            continue;
        };
        let path = format!("{}#terrain", shader.path);
        let whole = Shader::from_wgsl(compose_material(wgsl), path);
        stale.retain(|stale| *stale != id);
        let known = composed.composed.get(&id).cloned();
        // What stood in for a material that could not be read is not this material's to replace.
        match known.filter(|handle| *handle != composed.default) {
            Some(handle) => {
                if let Err(error) = shaders.insert(handle.id(), whole) {
                    error!("terrain material can't be replaced: {error}");
                }
            }
            None => {
                let handle = shaders.add(whole);
                composed.composed.insert(id, handle);
            }
        }
    }
}
