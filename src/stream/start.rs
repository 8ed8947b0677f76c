//! Terrains begin when their manifest has loaded, and follow it when it changes.

use super::TerrainTiles;
use super::settings::TerrainStreaming;
use super::state::TerrainState;
use super::systems::retry_after_s;
use crate::detail::{DetailKernel, TerrainDetail};
use crate::terrain::{
    Terrain, TerrainFailed, TerrainManifest, TerrainReloadFailed, TerrainSettings,
};
use bevy::asset::io::AssetReaderError;
use bevy::asset::{AssetId, AssetLoadError, AssetLoadFailedEvent, AssetPath, LoadState};
use bevy::log::{error, info, warn};
use bevy::prelude::*;
use bevy::time::Real;
use std::sync::Arc;

/// On a terrain whose manifest was refused.
#[derive(Component)]
pub(crate) struct TerrainRefused {
    manifest: AssetId<TerrainManifest>,
    attempts: u32,
    retry_at_s: f64,
    reason: String,
}

/// On a terrain that is drawn and whose manifest has changed beyond recognition: what will take
/// the state's place once its coarsest tiles have loaded.
#[derive(Component)]
pub(crate) struct NextTerrain(pub(super) TerrainState);

/// Follows manifests that have been replaced, or have changed under a running program.
#[expect(clippy::type_complexity, reason = "parameters of a Bevy system")]
#[expect(clippy::too_many_arguments, reason = "parameters of a Bevy system")]
pub(crate) fn follow_manifests(
    mut terrains: Query<(
        Entity,
        &Terrain,
        &TerrainSettings,
        Option<&mut TerrainState>,
        Option<&TerrainRefused>,
        Option<&NextTerrain>,
    )>,
    mut changes: MessageReader<AssetEvent<TerrainManifest>>,
    mut failures: MessageReader<AssetLoadFailedEvent<TerrainManifest>>,
    manifests: Res<Assets<TerrainManifest>>,
    server: Res<AssetServer>,
    mut commands: Commands,
    mut added: Local<Vec<AssetId<TerrainManifest>>>,
    mut modified: Local<Vec<AssetId<TerrainManifest>>>,
) {
    added.clear();
    modified.clear();
    for change in changes.read() {
        match change {
            AssetEvent::Added { id } => added.push(*id),
            AssetEvent::Modified { id } => modified.push(*id),
            _ => (),
        }
    }
    for (entity, terrain, settings, state, refused, next) in &mut terrains {
        let id = terrain.manifest.id();
        if let Some(refused) = refused {
            // What has changed since may do.
            if refused.manifest != id || added.contains(&id) || modified.contains(&id) {
                commands.entity(entity).try_remove::<TerrainRefused>();
            }
        }
        let Some(mut state) = state else {
            continue;
        };
        if state.manifest_id != id {
            commands.queue(move |world: &mut World| forget(world, entity));
            continue;
        }
        if !modified.contains(&id) {
            continue;
        }
        let Some(manifest) = manifests.get(id) else {
            continue;
        };
        if *manifest == **state.manifest() {
            // What the event told of is what the state began with, or a file that was only touched.
            // Tiles may have changed without it.
            state.refresh();
            state.has_next = false;
            commands.entity(entity).try_remove::<NextTerrain>();
            continue;
        }
        if state.take_manifest(manifest) {
            info!("terrain {entity} follows its manifest, which has changed");
            state.has_next = false;
            commands.entity(entity).try_remove::<NextTerrain>();
            continue;
        }
        if next.is_some_and(|next| **next.0.manifest() == *manifest) {
            continue;
        }
        let path = state.manifest_path.clone();
        match start(manifest, id, path, settings) {
            Ok(mut next) => {
                next.is_next = true;
                next.was_refreshed = true;
                state.await_next();
                commands.entity(entity).try_insert(NextTerrain(next));
            }
            Err(reason) => {
                state.has_next = false;
                commands.entity(entity).try_remove::<NextTerrain>();
                refuse_change(entity, reason, &mut commands);
            }
        }
    }
    for failure in failures.read() {
        for (entity, _, _, state, ..) in &terrains {
            if state.is_some_and(|state| state.manifest_id == failure.id) {
                let path = server.get_path(failure.id).map(|path| path.to_string());
                let path = path.as_deref().unwrap_or("the manifest");
                refuse_change(entity, reason_of(&failure.error, path), &mut commands);
            }
        }
    }
}

pub(super) fn refuse_change(entity: Entity, reason: String, commands: &mut Commands) {
    warn!("terrain {entity} stays as it was: {reason}");
    commands.trigger(TerrainReloadFailed { entity, reason });
}

/// Lets states take others' places whose coarsest tiles have loaded. Before views are computed, which
/// follow from the state.
pub(crate) fn replace_terrains(
    mut terrains: Query<(Entity, &mut TerrainState, &mut NextTerrain)>,
    mut commands: Commands,
) {
    for (entity, mut state, mut next) in &mut terrains {
        if next.0.has_its_roots() {
            state.give_way(&mut next.0, entity, &mut commands);
        }
    }
}

/// Removes all that streaming has put on a terrain. Also runs while the terrain is despawned, so
/// it must cope with an entity that is gone.
pub(super) fn forget(world: &mut World, terrain: Entity) {
    if let Ok(mut terrain) = world.get_entity_mut(terrain) {
        terrain
            .despawn_related::<TerrainTiles>()
            .remove::<(TerrainState, NextTerrain, TerrainRefused)>();
    }
}

/// Runs when a [`Terrain`] is removed or its entity despawned.
pub(crate) fn forget_removed_terrain(removed: On<Remove, Terrain>, mut commands: Commands) {
    let terrain = removed.entity;
    commands.queue(move |world: &mut World| forget(world, terrain));
}

/// Gives a [`TerrainState`] to terrains whose manifest has loaded.
pub(crate) fn start_terrains(
    mut terrains: Query<
        (
            Entity,
            &Terrain,
            &TerrainSettings,
            Option<&mut TerrainRefused>,
        ),
        Without<TerrainState>,
    >,
    manifests: Res<Assets<TerrainManifest>>,
    server: Res<AssetServer>,
    streaming: Res<TerrainStreaming>,
    time: Res<Time<Real>>,
    mut commands: Commands,
) {
    let now_s = time.elapsed_secs_f64();
    for (entity, terrain, settings, mut refused) in &mut terrains {
        let id = terrain.manifest.id();
        let path = server.get_path(id);
        if let Some(refused) = &mut refused {
            // A manifest that has loaded is refused for good, until it changes.
            if refused.retry_at_s <= now_s
                && !manifests.contains(id)
                && let Some(path) = path
            {
                refused.retry_at_s = f64::INFINITY;
                server.reload(path);
                continue;
            }
            // What was asked for again has failed again where its time has come and gone.
            if refused.retry_at_s < f64::INFINITY {
                continue;
            }
        }
        let started = if let Some(manifest) = manifests.get(id) {
            path.ok_or_else(|| {
                "a terrain's manifest has no path, so its tiles can't be found: load it with the \
                 asset server"
                    .to_owned()
            })
            .and_then(|path| start(manifest, id, path.into_owned(), settings))
        } else if let LoadState::Failed(error) = server.load_state(id) {
            let path = path.map(|path| path.to_string());
            Err(reason_of(&error, path.as_deref().unwrap_or("the manifest")))
        } else {
            continue;
        };
        match started {
            Ok(state) => {
                commands
                    .entity(entity)
                    .try_remove::<TerrainRefused>()
                    .try_insert(state);
            }
            Err(reason) => {
                let attempts = refused.as_ref().map_or(0, |refused| refused.attempts);
                let is_news = refused.is_none_or(|refused| refused.reason != reason);
                commands.entity(entity).try_insert(TerrainRefused {
                    manifest: id,
                    attempts: attempts + 1,
                    retry_at_s: now_s + retry_after_s(streaming.retry_s, attempts),
                    reason: reason.clone(),
                });
                if is_news {
                    error!("terrain {entity} can't be shown: {reason}");
                    commands.trigger(TerrainFailed { entity, reason });
                }
            }
        }
    }
}

fn start(
    manifest: &TerrainManifest,
    id: AssetId<TerrainManifest>,
    path: AssetPath<'static>,
    raw_settings: &TerrainSettings,
) -> Result<TerrainState, String> {
    let settings = raw_settings.checked(|error| error!("{path}: {error}; the default is used"));
    let manifest = Arc::new(manifest.clone());
    let new = |settings| TerrainState::new(manifest.clone(), id, path.clone(), settings);
    let mut state = new(settings.clone())
        .or_else(|error| {
            error!("{path}: {error}; the default is used");
            let TerrainSettings { leaf_level, .. } = TerrainSettings::default();
            new(TerrainSettings {
                leaf_level,
                ..settings
            })
        })
        .map_err(|error| format!("{path}: {error}"))?;
    state.raw_settings = raw_settings.clone();
    Ok(state)
}

/// One sentence on why an asset didn't load.
pub(super) fn reason_of(error: &AssetLoadError, path: &str) -> String {
    match error {
        // Our loaders' messages name the file themselves. Bevy appends a backtrace where one was
        // asked for.
        AssetLoadError::AssetLoaderError(error) => {
            let text = error.error().to_string();
            text.lines().next().unwrap_or_default().to_owned()
        }
        AssetLoadError::AssetReaderError(AssetReaderError::NotFound(_)) => {
            format!("{path} is missing")
        }
        AssetLoadError::AssetReaderError(AssetReaderError::HttpError(status)) => {
            format!("{path} can't be read: the server answers {status}")
        }
        AssetLoadError::AssetReaderError(AssetReaderError::Io(error)) => {
            format!("{path} can't be read: {error}")
        }
        error => format!("{path} can't be loaded: {error}"),
    }
}

/// Follows what terrains' [`TerrainDetail`] says.
pub(crate) fn update_detail(mut terrains: Query<(&mut TerrainState, Option<&TerrainDetail>)>) {
    for (mut state, detail) in &mut terrains {
        if state.raw_detail.as_ref() == detail {
            continue;
        }
        let state = &mut *state;
        let path = &state.manifest_path;
        state.raw_detail = detail.cloned();
        state.detail = detail.map_or_else(DetailKernel::default, |detail| {
            let checked = detail.checked(|error| error!("{path}: {error}; the default is used"));
            DetailKernel::new(&checked, &state.lattice, state.manifest.file.spacing_m)
        });
    }
}
