//! Terrains under pointers: a backend of Bevy's picking.

use super::TerrainQuery;
use crate::stream::TerrainState;
use bevy::camera::visibility::RenderLayers;
use bevy::picking::backend::ray::RayMap;
use bevy::picking::backend::{HitData, PointerHits};
use bevy::picking::{Pickable, PickingSystems};
use bevy::prelude::*;

/// Terrains get pointer events, as meshes do by Bevy's `MeshPickingPlugin`: `Pointer<Click>`,
/// `Pointer<Over>` and so on, on the terrain's entity, with the place on the ground and its normal in
/// the world. A part of [`TerrainPlugins`](crate::TerrainPlugins).
///
/// A terrain with a `Pickable` behaves as that says, one in other `RenderLayers` than a camera's is
/// not seen by that, and hidden ones are not hit. The ground is that of [`TerrainQuery`], at the
/// finest resident level, hit from either side. Needs Bevy's `DefaultPickingPlugins`, which
/// `DefaultPlugins` holds, and does nothing without. Cost: one ray a frame, pointer, camera and
/// terrain.
///
/// ```no_run
/// # use bevy::prelude::*;
/// # use bevy_tessera::terrain::Terrain;
/// fn setup(mut commands: Commands, assets: Res<AssetServer>) {
///     let terrain = Terrain::new(assets.load("alps/terrain.ron"));
///     commands.spawn(terrain).observe(|click: On<Pointer<Click>>| {
///         info!("clicked at {:?}", click.hit.position);
///     });
/// }
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct TerrainPickingPlugin;

impl Plugin for TerrainPickingPlugin {
    fn build(&self, app: &mut App) {
        // Whoever has no picking has no rays either.
        app.init_resource::<RayMap>()
            .add_message::<PointerHits>()
            .add_systems(
                PreUpdate,
                update_terrain_hits.in_set(PickingSystems::Backend),
            );
    }
}

type PickedTerrain = (
    Entity,
    Option<&'static Pickable>,
    Option<&'static RenderLayers>,
    Option<&'static InheritedVisibility>,
);

/// Casts every pointer's rays at the terrains and writes what they hit.
pub fn update_terrain_hits(
    rays: Res<RayMap>,
    cameras: Query<(&Camera, Option<&RenderLayers>)>,
    terrains: Query<PickedTerrain, With<TerrainState>>,
    ground: TerrainQuery,
    mut hits: MessageWriter<PointerHits>,
) {
    for (&id, &ray) in rays.iter() {
        let Ok((camera, seen)) = cameras.get(id.camera) else {
            continue;
        };
        let seen = seen.cloned().unwrap_or_default();
        let picks: Vec<_> = terrains
            .iter()
            .filter(|(_, pickable, layers, visibility)| {
                let layers = layers.cloned().unwrap_or_default();
                pickable.is_none_or(|pickable| pickable.is_hoverable)
                    && visibility.is_none_or(|visibility| visibility.get())
                    && seen.intersects(&layers)
            })
            .filter_map(|(terrain, ..)| {
                let hit = ground.ray_on(terrain, ray, f32::INFINITY)?;
                let data = HitData::new(id.camera, hit.distance, Some(hit.point), Some(hit.normal));
                Some((terrain, data))
            })
            .collect();
        if !picks.is_empty() {
            hits.write(PointerHits::new(id.pointer, picks, camera.order as f32));
        }
    }
}
