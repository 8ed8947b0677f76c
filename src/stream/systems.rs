//! The systems that load, activate and evict tiles.

use super::state::{Loading, Slot, TerrainState};
use super::{TerrainTiles, TileData, TileOf, TilePage};
use crate::detail::{DetailKernel, TerrainDetail};
use crate::terrain::{
    Terrain, TerrainFailed, TerrainManifest, TerrainReady, TerrainSettings, TileEvicted,
    TileFailed, TileLoaded,
};
use crate::tile::{TerrainTile, TileAddress};
use crate::view::TerrainViews;
use bevy::asset::io::AssetReaderError;
use bevy::asset::{AssetId, AssetLoadError, AssetPath, LoadState};
use bevy::log::{error, warn};
use bevy::prelude::*;
use bevy::time::Real;
use std::sync::Arc;

/// On a terrain whose manifest was refused, so that it is refused once.
#[derive(Component)]
pub(crate) struct TerrainRefused(AssetId<TerrainManifest>);

/// Drops the state of terrains whose manifest has been replaced or has changed.
pub(crate) fn reset_changed_terrains(
    terrains: Query<(
        Entity,
        &Terrain,
        Option<&TerrainState>,
        Option<&TerrainRefused>,
    )>,
    mut changes: MessageReader<AssetEvent<TerrainManifest>>,
    mut commands: Commands,
) {
    let modified: Vec<_> = changes
        .read()
        .filter_map(|change| match change {
            AssetEvent::Modified { id } => Some(*id),
            _ => None,
        })
        .collect();
    for (entity, terrain, state, refused) in &terrains {
        let id = state
            .map(|state| state.manifest_id)
            .or_else(|| refused.map(|refused| refused.0));
        if id.is_some_and(|id| id != terrain.manifest.id() || modified.contains(&id)) {
            commands.queue(move |world: &mut World| forget(world, entity));
        }
    }
}

/// Removes all that streaming has put on a terrain. Also runs while the terrain is despawned, so
/// it must cope with an entity that is gone.
pub(super) fn forget(world: &mut World, terrain: Entity) {
    if let Ok(mut terrain) = world.get_entity_mut(terrain) {
        terrain
            .despawn_related::<TerrainTiles>()
            .remove::<(TerrainState, TerrainRefused)>();
    }
}

/// Terrains that wait for their manifest.
type Waiting = (Without<TerrainState>, Without<TerrainRefused>);

/// Gives a [`TerrainState`] to terrains whose manifest has loaded.
pub(crate) fn start_terrains(
    terrains: Query<(Entity, &Terrain, &TerrainSettings), Waiting>,
    manifests: Res<Assets<TerrainManifest>>,
    server: Res<AssetServer>,
    mut commands: Commands,
) {
    for (entity, terrain, settings) in &terrains {
        let id = terrain.manifest.id();
        let started = if let Some(manifest) = manifests.get(id) {
            server
                .get_path(id)
                .ok_or_else(|| {
                    "a terrain's manifest has no path, so its tiles can't be found: load it with \
                     the asset server"
                        .to_owned()
                })
                .and_then(|path| start(manifest, id, path.into_owned(), settings))
        } else if let LoadState::Failed(error) = server.load_state(id) {
            let path = server.get_path(id).map(|path| path.to_string());
            Err(reason_of(&error, path.as_deref().unwrap_or("the manifest")))
        } else {
            continue;
        };
        match started {
            Ok(state) => {
                commands.entity(entity).try_insert(state);
            }
            Err(reason) => {
                error!("terrain {entity} can't be shown: {reason}");
                commands.entity(entity).try_insert(TerrainRefused(id));
                commands.trigger(TerrainFailed { entity, reason });
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
fn reason_of(error: &AssetLoadError, path: &str) -> String {
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

/// Everything that a terrain's streaming needs from outside.
struct Context<'a, 'w, 's> {
    entity: Entity,
    server: &'a AssetServer,
    tiles: &'a Assets<TerrainTile>,
    commands: &'a mut Commands<'w, 's>,
}

/// Moves every terrain's tiles a frame further: plan, load, fade, evict, activate.
pub(crate) fn stream_tiles(
    mut terrains: Query<(Entity, &mut TerrainState, Ref<TerrainSettings>)>,
    cameras: Query<&TerrainViews>,
    time: Res<Time<Real>>,
    server: Res<AssetServer>,
    tiles: Res<Assets<TerrainTile>>,
    mut commands: Commands,
) {
    let _span = bevy::log::debug_span!("terrain_stream").entered();
    for (entity, mut state, settings) in &mut terrains {
        let state = &mut *state;
        if settings.is_changed() && state.raw_settings != *settings {
            state.take_settings(&settings);
        }
        state.views.clear();
        let views = cameras.iter().flat_map(|views| &views.views);
        state.views.extend(
            views
                .filter(|view| view.terrain == entity)
                .map(|view| view.lod),
        );
        let mut context = Context {
            entity,
            server: &server,
            tiles: &tiles,
            commands: &mut commands,
        };
        state.poll_loads(&mut context);
        state.plan();
        let levels = time.delta_secs() * state.settings.fade_levels_per_s;
        state.residency.step(levels, &state.views);
        state.free_pages(&mut context);
        state.activate_tiles(&mut context);
        state.residency.make_room(state.loading.len());
        state.request_tiles(&context);
    }
}

impl TerrainState {
    /// Takes over the settings that may change at any time.
    fn take_settings(&mut self, settings: &TerrainSettings) {
        let path = &self.manifest_path;
        let checked = settings.checked(|error| error!("{path}: {error}; the default is used"));
        self.raw_settings = settings.clone();
        self.settings.loads_in_flight = checked.loads_in_flight;
        self.settings.activations_per_frame = checked.activations_per_frame;
        self.settings.fade_levels_per_s = checked.fade_levels_per_s;
    }

    /// Sees which tiles have loaded, and which never will.
    fn poll_loads(&mut self, context: &mut Context) {
        let mut at = 0;
        while at < self.loading.len() {
            let loading = &mut self.loading[at];
            if loading.is_ready {
                at += 1;
                continue;
            }
            if context.tiles.contains(&loading.tile) {
                loading.is_ready = true;
                at += 1;
                continue;
            }
            let LoadState::Failed(error) = context.server.load_state(&loading.tile) else {
                at += 1;
                continue;
            };
            let address = loading.address;
            self.loading.swap_remove(at);
            let path = self.tile_path(address);
            self.give_up(address, reason_of(&error, &path.to_string()), context);
        }
    }

    fn give_up(&mut self, address: TileAddress, reason: String, context: &mut Context) {
        let entity = context.entity;
        self.failed.insert(address);
        self.planner.invalidate();
        if address == self.root() {
            error!("terrain {entity} can't be shown: {reason}");
            context.commands.trigger(TerrainFailed {
                entity,
                reason: reason.clone(),
            });
        } else {
            warn!("tile {address} of terrain {entity} keeps its parent's shape: {reason}");
        }
        context.commands.trigger(TileFailed {
            entity,
            address,
            reason,
        });
    }

    /// Where a tile's file lies.
    fn tile_path(&self, address: TileAddress) -> AssetPath<'static> {
        let path = TerrainTile::path(address);
        AssetPath::from(self.manifest_path.path().with_file_name(path))
            .with_source(self.manifest_path.source().clone_owned())
    }

    fn plan(&mut self) {
        let changed = self.planner.update(
            &self.lattice,
            &self.manifest.index,
            &self.failed,
            &self.views,
            self.slots.len(),
        );
        if !changed {
            return;
        }
        self.cursor = 0;
        self.residency.apply_plan(self.planner.wanted());
        // Loads that are no longer wanted are cancelled by dropping their handles.
        const UNWANTED: u32 = u32::MAX;
        for loading in &mut self.loading {
            loading.rank = UNWANTED;
        }
        if !self.loading.is_empty() {
            for (rank, &address) in (0..).zip(self.planner.wanted()) {
                if let Some(loading) = self.loading.iter_mut().find(|l| l.address == address) {
                    loading.rank = rank;
                }
            }
            self.loading.retain(|loading| loading.rank != UNWANTED);
        }
    }

    fn free_pages(&mut self, context: &mut Context) {
        let slots = &mut self.slots;
        self.residency.free_faded(|page, address| {
            let Some(slot) = slots.get_mut(page as usize).and_then(Option::take) else {
                return;
            };
            context.commands.trigger(TileEvicted {
                entity: context.entity,
                tile: slot.entity,
                address,
            });
            context.commands.entity(slot.entity).try_despawn();
        });
    }

    fn activate_tiles(&mut self, context: &mut Context) {
        for _ in 0..self.settings.activations_per_frame {
            // A tile whose parent is still on its way waits, without holding up others.
            let residency = &self.residency;
            let root = self.root();
            let next = (0..self.loading.len())
                .filter(|&at| {
                    let Loading {
                        address, is_ready, ..
                    } = self.loading[at];
                    is_ready && (address == root || residency.is_readable(address.parent()))
                })
                .min_by_key(|&at| self.loading[at].rank);
            let Some(next) = next else {
                return;
            };
            let Loading { address, rank, .. } = self.loading[next];
            let Some(page) = self.residency.activate(address, rank) else {
                // No page is free.
                return;
            };
            let loading = self.loading.swap_remove(next);
            self.spawn_tile(page, loading, context);
        }
    }

    fn spawn_tile(&mut self, page: u32, loading: Loading, context: &mut Context) {
        let Loading {
            address,
            tile: data,
            ..
        } = loading;
        let terrain = context.entity;
        let tile = context.commands.spawn_empty().id();
        self.slots[page as usize] = Some(Slot::new(tile, data.clone()));
        let bounds = self.bounds(address);
        let is_root = address == self.root();
        context.commands.queue(move |world: &mut World| {
            // A terrain that was despawned in this very frame takes no more tiles.
            if world.get_entity(terrain).is_err() {
                world.despawn(tile);
                return;
            }
            if let Ok(mut entity) = world.get_entity_mut(tile) {
                entity.insert((TileOf(terrain), address, TileData(data), TilePage(page)));
                if let Some(bounds) = bounds {
                    entity.insert(bounds);
                }
            }
            world.trigger(TileLoaded {
                entity: terrain,
                tile,
                address,
            });
            if is_root {
                world.trigger(TerrainReady { entity: terrain });
            }
        });
    }

    fn request_tiles(&mut self, context: &Context) {
        while self.loading.len() < self.settings.loads_in_flight as usize
            && let Some(&address) = self.planner.wanted().get(self.cursor)
        {
            let rank = self.cursor as u32;
            self.cursor += 1;
            let known = self.pages().get(address).is_some()
                || self.loading.iter().any(|l| l.address == address);
            if known {
                continue;
            }
            // The game has asked for the manifest, wherever it lies; the tiles lie beside it.
            let path = self.tile_path(address);
            let builder = context.server.load_builder().override_unapproved();
            self.loading.push(Loading {
                address,
                rank,
                tile: builder.load(path),
                is_ready: false,
            });
        }
    }
}

/// Runs when a [`Terrain`] is removed or its entity despawned.
pub(crate) fn forget_removed_terrain(removed: On<Remove, Terrain>, mut commands: Commands) {
    let terrain = removed.entity;
    commands.queue(move |world: &mut World| forget(world, terrain));
}
