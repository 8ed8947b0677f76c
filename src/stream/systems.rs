//! The system that loads, activates and evicts tiles.

use super::cache::TileCache;
use super::content::TileContent;
use super::fade::Fade;
use super::pool::PagePool;
use super::settings::TerrainStreaming;
use super::start::{NextTerrain, reason_of, refuse_change};
use super::state::{Failure, Loading, Slot, TerrainState};
use super::{TileData, TileOf, TilePage};
use crate::edit::{EditLog, TerrainEdits};
use crate::residency::{PlanTerrain, Planner, levels_short};
use crate::terrain::{
    TerrainCpuStage, TerrainCpuTimes, TerrainFailed, TerrainReady, TerrainSettings, TileEvicted,
    TileFailed, TileLoaded,
};
use crate::tile::{TerrainTile, TileAddress};
use crate::view::TerrainViews;
use bevy::asset::{AssetLoadFailedEvent, AssetPath, LoadState};
use bevy::ecs::system::SystemParam;
use bevy::log::{error, info, warn};
use bevy::prelude::*;
use bevy::time::Real;
use std::time::{Duration, Instant};

/// The longest frame in which the ground moves as far as its time allows, in seconds.
const LONGEST_FRAME_S: f32 = 1.0 / 30.0;
/// Rank of a tile that is not in the latest plan.
const UNWANTED: u32 = u32::MAX;

/// What all terrains stream with: the pages they share, the ranking of their tiles. A resource, for
/// its figures.
#[derive(Resource, Default, Debug)]
pub struct TerrainStreamer {
    raw_settings: Option<TerrainStreaming>,
    settings: TerrainStreaming,
    pool: PagePool,
    planner: Planner,
    /// Number of the latest plan.
    plan: u64,
    /// How far down the plan tiles have been asked for.
    cursor: usize,
    /// The plan's terrains.
    order: Vec<Entity>,
    must_plan: bool,
    cache: TileCache,
    /// Instances of the states that live, in this frame and in the one before.
    lives: [Vec<u64>; 2],
    loading: usize,
    last_frame: Duration,
    activated: u64,
}

impl TerrainStreamer {
    /// Pages in use, of all terrains.
    #[must_use]
    pub const fn pages_used(&self) -> u32 {
        self.pool.used()
    }

    /// Pages that there is memory for.
    #[must_use]
    pub const fn pages(&self) -> u32 {
        self.pool.limit()
    }

    /// One more than the greatest number that a page has or may get.
    #[must_use]
    pub fn page_numbers(&self) -> u32 {
        self.pool.capacity()
    }

    /// Tiles in main memory: those with a page, those on their way, and those that are kept for
    /// when they are wanted again.
    #[must_use]
    pub fn tiles_held(&self) -> usize {
        self.pool.used() as usize + self.loading + self.cache.len()
    }

    /// Tiles that were asked for and have no page yet.
    #[must_use]
    pub const fn tiles_loading(&self) -> usize {
        self.loading
    }

    /// Tiles that have been given a page since the app started, those counted again that came back.
    /// Each is [`TILE_BYTES`](super::TILE_BYTES) long once it is read.
    #[must_use]
    pub const fn tiles_activated(&self) -> u64 {
        self.activated
    }

    /// CPU time that streaming took in the latest frame, without what reading takes in the
    /// background.
    #[must_use]
    pub const fn last_frame(&self) -> Duration {
        self.last_frame
    }

    /// Tiles that the latest plan wants, of all terrains, as far as the memory goes.
    #[must_use]
    pub fn wanted(&self) -> usize {
        self.planner.latest().ranked().len()
    }
}

/// For how long a thing is left alone that has failed `attempts` times before.
pub(super) fn retry_after_s(retry_s: f32, attempts: u32) -> f64 {
    f64::from(retry_s) * f64::from(1_u32 << attempts.min(5))
}

/// Everything that streaming needs from outside.
#[derive(SystemParam)]
pub(crate) struct Outside<'w, 's> {
    settings: Res<'w, TerrainStreaming>,
    pub(super) time: Res<'w, Time<Real>>,
    times: Res<'w, TerrainCpuTimes>,
    server: Res<'w, AssetServer>,
    tiles: Res<'w, Assets<TerrainTile>>,
    changes: MessageReader<'w, 's, AssetEvent<TerrainTile>>,
    failures: MessageReader<'w, 's, AssetLoadFailedEvent<TerrainTile>>,
    commands: Commands<'w, 's>,
}

/// All terrains that have begun.
pub(crate) type Terrains<'w, 's> = Query<
    'w,
    's,
    (
        Entity,
        &'static mut TerrainState,
        Ref<'static, TerrainSettings>,
        Option<&'static mut NextTerrain>,
        &'static mut TerrainEdits,
    ),
>;

/// Moves all terrains' tiles a frame further: plan, load, fade, evict, activate.
pub(crate) fn stream_tiles(
    mut terrains: Terrains,
    cameras: Query<&TerrainViews>,
    mut streamer: ResMut<TerrainStreamer>,
    mut outside: Outside,
) {
    let _span = bevy::log::debug_span!("terrain_stream").entered();
    let began = Instant::now();
    let times = outside.times.clone();
    let _time = times.measure(TerrainCpuStage::Stream);
    let streamer = &mut *streamer;
    let outside = &mut outside;
    streamer.take_settings(&outside.settings);
    for (entity, mut state, settings, next, edits) in &mut terrains {
        let state = &mut *state;
        if state.raw_settings != *settings {
            state.take_settings(&settings);
            streamer.must_plan = true;
        }
        state.look(entity, &cameras);
        if let Some(mut next) = next {
            next.0
                .poll_loads(entity, edits.log(), &streamer.settings, outside);
            next.0.request_roots(outside);
        }
    }
    streamer.count_lives(terrains.iter().map(|(_, state, ..)| state.instance()));
    outside.hand_out_changes(&mut terrains);
    for (entity, mut state, _, _, mut edits) in &mut terrains {
        let state = &mut *state;
        if let Some(log) = edits.log() {
            state.catch_up(entity, log, &mut outside.commands);
        }
        state.keep_snapshots(edits.bypass_change_detection());
        state.take_remade(entity, edits.log(), &mut outside.commands);
        state.poll_loads(entity, edits.log(), &streamer.settings, outside);
        state.retry(outside.time.elapsed_secs_f64());
        state.retry_residents(&streamer.settings, outside.time.elapsed_secs_f64());
        streamer.must_plan |= state.wants_plan(streamer.settings.lookahead_s);
    }
    streamer.plan(&mut terrains);
    // A frame that takes long is no reason to jump.
    let dt_s = outside.time.delta_secs();
    let seen_s = dt_s.min(LONGEST_FRAME_S);
    for (entity, mut state, ..) in &mut terrains {
        let state = &mut *state;
        state.step(Fade {
            levels: dt_s * state.settings.fade_levels_per_s,
            max_px: seen_s * state.settings.fade_px_per_s,
        });
        streamer.free_pages(entity, state, &mut outside.commands);
    }
    streamer.relocate(&mut terrains, &mut outside.commands);
    streamer.activate(&mut terrains, outside);
    streamer.make_room(&mut terrains);
    streamer.request(&mut terrains, outside);
    for (_, mut state, ..) in &mut terrains {
        let is_requested = streamer.cursor == streamer.planner.latest().ranked().len();
        let now_s = outside.time.elapsed_secs_f64();
        state.finish(
            is_requested,
            now_s,
            &streamer.settings,
            &mut outside.commands,
        );
    }
    streamer.last_frame = began.elapsed();
}

impl TerrainStreamer {
    fn take_settings(&mut self, settings: &TerrainStreaming) {
        if self.raw_settings.as_ref() == Some(settings) {
            return;
        }
        self.raw_settings = Some(settings.clone());
        self.settings = settings.checked(|error| error!("{error}; the default is used"));
        let tiles = self.settings.tiles().min(u64::from(u32::MAX)) as u32;
        self.pool.set_limit(self.settings.pages().min(tiles));
        self.must_plan = true;
    }

    /// Takes back the pages of states that are gone.
    fn count_lives(&mut self, lives: impl Iterator<Item = u64>) {
        let [now, before] = &mut self.lives;
        now.clear();
        now.extend(lives);
        if now != before {
            self.pool.reclaim(|instance| now.contains(&instance));
            self.must_plan = true;
        }
        self.lives.swap(0, 1);
    }

    fn plan(&mut self, terrains: &mut Terrains) {
        if !std::mem::take(&mut self.must_plan) {
            return;
        }
        self.plan += 1;
        self.cursor = 0;
        let capacity = self.pool.limit() as usize;
        let Self { order, planner, .. } = self;
        order.clear();
        order.extend(terrains.iter().map(|(entity, ..)| entity));
        // Queries have an order of their own.
        order.sort_unstable();
        let states = order.iter().filter_map(|&entity| terrains.get(entity).ok());
        let input: Vec<_> = states
            .map(|(_, state, ..)| PlanTerrain {
                lattice: &state.lattice,
                available: &state.available,
                resident: &state.residency.resident,
                eyes: &state.eyes,
                pins: &state.pins,
                root_levels: state.settings.root_levels,
            })
            .collect();
        let plan = planner.plan(&input, capacity, self.settings.lookahead_s);
        for (number, &entity) in (0..).zip(&*order) {
            let Ok((_, mut state, ..)) = terrains.get_mut(entity) else {
                continue;
            };
            let eyes = plan.eyes(number as usize);
            state.is_short_of_pages = plan.is_cut() && eyes.iter().any(|eye| eye.cut);
            let ranked = (0..).zip(plan.ranked());
            let own = ranked.filter(|(_, ranked)| ranked.terrain == number);
            state.take_plan(
                self.plan,
                own.map(|(rank, ranked)| (ranked.address, rank)),
                &mut self.cache,
            );
        }
    }

    fn free_pages(&mut self, terrain: Entity, state: &mut TerrainState, commands: &mut Commands) {
        let Self { pool, cache, .. } = self;
        let slots = &mut state.slots;
        let mut contents = Vec::new();
        state.residency.free_faded(|page, address| {
            pool.give_back(page);
            let Some(slot) = slots.get_mut(page as usize).and_then(Option::take) else {
                return;
            };
            slot.evict(terrain, address, commands);
            cache.keep(slot.handle);
            contents.push((address, slot.tile));
        });
        for (address, content) in contents {
            state.keep_edits(address, content);
        }
    }

    /// Moves tiles from pages that there shouldn't be any more to others.
    fn relocate(&mut self, terrains: &mut Terrains, commands: &mut Commands) {
        if self.pool.capacity() <= self.pool.limit() {
            return;
        }
        let mut moves = 0..self.settings.activations_per_frame();
        for (_, mut state, ..) in terrains {
            let state = &mut *state;
            while let Some(from) = state.residency.page_beyond(self.pool.limit())
                && moves.next().is_some()
                && let Some(to) = self.pool.take(state.instance())
            {
                state.residency.relocate(from, to);
                if let Some(slot) = state.slots.get_mut(from as usize).and_then(Option::take) {
                    commands.entity(slot.entity).try_insert(TilePage(to));
                    state.set_slot(to, slot);
                }
                self.pool.give_back(from);
            }
        }
    }

    /// Makes tiles resident that have loaded, the best first.
    fn activate(&mut self, terrains: &mut Terrains, outside: &mut Outside) {
        for _ in 0..self.settings.activations_per_frame() {
            let best = terrains.iter().filter_map(|(entity, state, ..)| {
                let (at, rank) = state.next_to_activate()?;
                Some((rank, entity, at))
            });
            let Some((rank, entity, at)) = best.min() else {
                return;
            };
            let Ok((_, mut state, _, _, edits)) = terrains.get_mut(entity) else {
                return;
            };
            let state = &mut *state;
            let address = state.loading[at].address;
            let Some(arrival) = state.loading[at].arrival.take() else {
                return;
            };
            let Some(content) = state.finish_arrival(address, arrival, edits.log()) else {
                // Edits were taken back in the meantime: it arrives once more.
                continue;
            };
            let instance = state.instance();
            let page = || self.pool.take(instance);
            let Some(page) = state.residency.activate(address, rank, page) else {
                // No page is free.
                state.loading[at].arrival = Some(state.kept(content, edits.log()));
                return;
            };
            self.activated += 1;
            let Loading { handle, .. } = state.loading.swap_remove(at);
            self.cache.forget(handle.id());
            state.spawn_tile(
                entity,
                page,
                address,
                handle,
                content,
                &mut outside.commands,
            );
        }
    }

    /// Sees to it that there are pages for the tiles that are on their way, as far as there are
    /// tiles that nobody wants.
    fn make_room(&mut self, terrains: &mut Terrains) {
        let (mut waiting, mut leaving) = (0, 0);
        for (_, state, ..) in terrains.iter() {
            waiting += state.loading.len();
            leaving += state.residency.leaving_count();
        }
        let used = self.pool.used() as usize;
        while self.pool.limit() as usize + leaving < used + waiting {
            let first = terrains.iter().filter_map(|(entity, state, ..)| {
                let (wanted_at, level, page) = state.residency.first_to_go()?;
                Some((wanted_at, level, page, entity))
            });
            let Some((.., page, entity)) = first.min() else {
                return;
            };
            if let Ok((_, mut state, ..)) = terrains.get_mut(entity) {
                state.residency.send_off(page);
            }
            leaving += 1;
        }
    }

    /// Asks for the best tiles that aren't there, and drops what memory doesn't hold.
    fn request(&mut self, terrains: &mut Terrains, outside: &Outside) {
        let loads = terrains.iter().map(|(_, state, ..)| {
            let busy = state
                .loading
                .iter()
                .filter(|loading| loading.arrival.is_none());
            [busy.count() + state.refreshing.len(), state.loading.len()]
        });
        let [mut busy, mut loading] = loads.fold([0, 0], |[a, b], [busy, all]| [a + busy, b + all]);
        let most = self.settings.loads_in_flight as usize;
        let now_s = outside.time.elapsed_secs_f64();
        let ranked = self.planner.latest().ranked();
        while busy < most
            && loading < 2 * most
            && let Some(ranked) = ranked.get(self.cursor)
        {
            let rank = self.cursor as u32;
            self.cursor += 1;
            let entity = self.order.get(ranked.terrain as usize);
            let Some(Ok((_, mut state, _, next, _))) =
                entity.map(|&entity| terrains.get_mut(entity))
            else {
                continue;
            };
            // A terrain that is about to be replaced loads nothing more.
            if next.is_none() && state.request(ranked.address, rank, now_s, outside) {
                busy += 1;
                loading += 1;
            }
        }
        for (_, mut state, ..) in &mut *terrains {
            busy += state.request_refreshed(most.saturating_sub(busy), now_s, &outside.server);
        }
        self.loading = loading;
        let tiles = usize::try_from(self.settings.tiles()).unwrap_or(usize::MAX);
        let taken = self.pool.used() as usize + loading;
        self.cache.shrink(tiles.saturating_sub(taken));
    }
}

impl Outside<'_, '_> {
    /// Tells states of tiles whose files have been read again.
    fn hand_out_changes(&mut self, terrains: &mut Terrains) {
        for change in self.changes.read() {
            let AssetEvent::Modified { id } = change else {
                continue;
            };
            let Some(tile) = self.tiles.get(*id) else {
                continue;
            };
            for (entity, mut state, _, mut next, edits) in &mut *terrains {
                let state = heir(&mut state, next.as_deref_mut());
                state.tile_changed(entity, *id, tile, edits.log(), &mut self.commands);
            }
        }
        for failure in self.failures.read() {
            let path = failure.path.to_string();
            for (entity, mut state, _, mut next, _) in &mut *terrains {
                let state = heir(&mut state, next.as_deref_mut());
                if state.is_holding(failure.id) {
                    let reason = reason_of(&failure.error, &path);
                    state.tile_change_failed(entity, failure.id, reason, &mut self.commands);
                }
            }
        }
    }
}

/// The state that files which change are told to: what is about to be replaced stays as it is.
fn heir<'a>(
    state: &'a mut TerrainState,
    next: Option<&'a mut NextTerrain>,
) -> &'a mut TerrainState {
    match next {
        Some(next) => &mut next.0,
        None => state,
    }
}

impl Slot {
    /// Tells the game that the tile goes.
    pub(super) fn evict(&self, terrain: Entity, address: TileAddress, commands: &mut Commands) {
        commands.trigger(TileEvicted {
            entity: terrain,
            tile: self.entity,
            address,
        });
        commands.entity(self.entity).try_despawn();
    }
}

impl TerrainState {
    /// Takes over the settings that may change at any time.
    fn take_settings(&mut self, settings: &TerrainSettings) {
        let path = &self.manifest_path;
        let checked = settings.checked(|error| error!("{path}: {error}; the default is used"));
        self.raw_settings = settings.clone();
        self.settings = TerrainSettings {
            leaf_level: self.settings.leaf_level,
            ..checked
        };
    }

    /// Takes over this terrain's part of a plan.
    fn take_plan(
        &mut self,
        plan: u64,
        wanted: impl Iterator<Item = (TileAddress, u32)> + Clone,
        cache: &mut TileCache,
    ) {
        self.planned_eyes.clone_from(&self.eyes);
        self.planned_pins.clone_from(&self.pins);
        self.wanted_count = wanted.clone().count();
        self.residency.apply_plan(plan, wanted.clone());
        for loading in &mut self.loading {
            loading.rank = UNWANTED;
        }
        if self.loading.is_empty() {
            return;
        }
        for (address, rank) in wanted {
            if let Some(loading) = self.loading.iter_mut().find(|l| l.address == address) {
                loading.rank = rank;
            }
        }
        // Loads that are no longer wanted are cancelled by dropping their handles.
        self.loading.retain(|loading| {
            let keeps = loading.rank != UNWANTED;
            if !keeps && loading.arrival.is_some() {
                cache.keep(loading.handle.clone());
            }
            keeps
        });
    }

    /// Sees which tiles have loaded, and which never will.
    fn poll_loads(
        &mut self,
        entity: Entity,
        log: Option<&EditLog>,
        settings: &TerrainStreaming,
        outside: &mut Outside,
    ) {
        let now_s = outside.time.elapsed_secs_f64();
        let mut at = 0;
        while at < self.loading.len() {
            let loading = &mut self.loading[at];
            if let Some(arrival) = &mut loading.arrival {
                arrival.poll();
                at += 1;
                continue;
            }
            let address = loading.address;
            let timeout_s = settings.load_timeout_s;
            let late = now_s - loading.since_s > f64::from(timeout_s);
            let reason = match outside.tiles.get(&loading.handle) {
                Some(_) if loading.is_stale && !late => None,
                Some(tile) => match tile.check(&self.manifest, address) {
                    Ok(()) => {
                        let arrival = self.arrive(address, tile, log);
                        self.loading[at].arrival = Some(arrival);
                        None
                    }
                    // Another terrain lay here before, whose tile is still in memory.
                    Err(_) if !loading.is_stale => {
                        loading.is_stale = true;
                        if let Some(path) = outside.server.get_path(&loading.handle) {
                            outside.server.reload(path);
                        }
                        None
                    }
                    Err(error) => Some(self.of_file(address, &error.to_string())),
                },
                None => match outside.server.load_state(&loading.handle) {
                    LoadState::Failed(error) => {
                        let path = self.tile_path(address);
                        Some(reason_of(&error, &path.to_string()))
                    }
                    _ if late => {
                        let path = self.tile_path(address);
                        Some(format!("{path} has not come within {timeout_s} s"))
                    }
                    _ => None,
                },
            };
            if let Some(reason) = reason {
                self.loading.swap_remove(at);
                self.give_up(address, entity, reason, settings, outside);
            } else {
                at += 1;
            }
        }
    }

    /// A message about a tile's file.
    pub(super) fn of_file(&self, address: TileAddress, what: &str) -> String {
        format!("{} can't be used: {what}", self.tile_path(address))
    }

    fn give_up(
        &mut self,
        address: TileAddress,
        entity: Entity,
        reason: String,
        settings: &TerrainStreaming,
        outside: &mut Outside,
    ) {
        self.must_plan = true;
        self.failures_version += 1;
        self.available.forbid(address);
        let now_s = outside.time.elapsed_secs_f64();
        let failure = self.failed.entry(address).or_insert_with(|| Failure {
            attempts: 0,
            retry_at_s: None,
            reason: String::new(),
        });
        failure.retry_at_s = Some(now_s + retry_after_s(settings.retry_s, failure.attempts));
        failure.attempts += 1;
        if failure.reason == reason {
            return;
        }
        failure.reason.clone_from(&reason);
        if address == self.root() && self.is_next {
            refuse_change(entity, reason.clone(), &mut outside.commands);
        } else if address == self.root() {
            error!("terrain {entity} can't be shown: {reason}");
            outside.commands.trigger(TerrainFailed {
                entity,
                reason: reason.clone(),
            });
        } else {
            warn!("tile {address} of terrain {entity} keeps its parent's shape: {reason}");
        }
        outside.commands.trigger(TileFailed {
            entity,
            address,
            reason,
        });
    }

    /// Lets tiles be asked for again whose time has come.
    pub(super) fn retry(&mut self, now_s: f64) {
        for (&address, failure) in &mut self.failed {
            if failure.retry_at_s.is_some_and(|at_s| at_s <= now_s) {
                failure.retry_at_s = None;
                self.available.permit(address);
                self.must_plan = true;
            }
        }
    }

    /// Sees to it that resident tiles whose files couldn't be read again are, from time to time.
    fn retry_residents(&mut self, settings: &TerrainStreaming, now_s: f64) {
        if !std::mem::take(&mut self.has_complaints) {
            return;
        }
        let after_s = retry_after_s(settings.retry_s, 1);
        let pages = (0..).zip(&mut self.slots);
        for (page, slot) in pages.filter_map(|(page, slot)| Some((page, slot.as_mut()?))) {
            if slot.complaint.is_empty() {
                continue;
            }
            self.has_complaints = true;
            if *slot.retry_at_s.get_or_insert(now_s + after_s) <= now_s {
                slot.retry_at_s = None;
                self.to_refresh.extend(self.residency.tile_on(page));
            }
        }
    }

    /// Where a tile's file lies.
    pub(super) fn tile_path(&self, address: TileAddress) -> AssetPath<'static> {
        let path = TerrainTile::path(address);
        AssetPath::from(self.manifest_path.path().with_file_name(path))
            .with_source(self.manifest_path.source().clone_owned())
    }

    /// The loaded tile that comes next, as its place among those on their way and its rank. One
    /// whose parent is still on its way waits, without holding up others.
    fn next_to_activate(&self) -> Option<(usize, u32)> {
        let root = self.root();
        (0..self.loading.len())
            .map(|at| (at, &self.loading[at]))
            .filter(|(_, loading)| {
                let address = loading.address;
                loading.is_ready()
                    && (address == root || self.residency.is_readable(address.parent()))
            })
            .map(|(at, loading)| (at, loading.rank))
            .min_by_key(|&(_, rank)| rank)
    }

    fn spawn_tile(
        &mut self,
        terrain: Entity,
        page: u32,
        address: TileAddress,
        handle: Handle<TerrainTile>,
        mut data: TileContent,
        commands: &mut Commands,
    ) {
        self.snapshot_long(&mut data);
        if self.failed.remove(&address).is_some() {
            self.failures_version += 1;
            info!("tile {address} of terrain {terrain} can be read now");
        }
        let tile = commands.spawn_empty().id();
        self.set_slot(page, Slot::new(tile, handle.clone(), data));
        self.tile_replaced(address, commands);
        let bounds = self.bounds(address);
        let is_root = address == self.root();
        commands.queue(move |world: &mut World| {
            // A terrain that was despawned in this very frame takes no more tiles.
            if world.get_entity(terrain).is_err() {
                world.despawn(tile);
                return;
            }
            if let Ok(mut entity) = world.get_entity_mut(tile) {
                entity.insert((TileOf(terrain), address, TileData(handle), TilePage(page)));
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

    /// Asks for a tile; says whether that was necessary.
    pub(super) fn request(
        &mut self,
        address: TileAddress,
        rank: u32,
        now_s: f64,
        outside: &Outside,
    ) -> bool {
        let known = self.pages().get(address).is_some()
            || self.loading.iter().any(|l| l.address == address);
        if known || !self.available.has(address) {
            return false;
        }
        // The game has asked for the manifest, wherever it lies; the tiles lie beside it.
        let path = self.tile_path(address);
        let builder = outside.server.load_builder().override_unapproved();
        let handle = builder.load(path.clone());
        // What is still in memory of a terrain whose files have changed may be an older one.
        let is_stale = self.was_refreshed && outside.tiles.contains(&handle);
        if is_stale {
            outside.server.reload(path);
        }
        self.loading.push(Loading {
            address,
            rank,
            handle,
            since_s: now_s,
            arrival: None,
            is_stale,
        });
        true
    }

    /// Brings the state's figures up to date at the end of a frame.
    fn finish(
        &mut self,
        is_requested: bool,
        now_s: f64,
        settings: &TerrainStreaming,
        commands: &mut Commands,
    ) {
        self.is_requested = is_requested;
        if !self.refreshing.is_empty() {
            // What has gone in the meantime doesn't come back changed, and a source that never answers
            // holds up nothing.
            let mut refreshing = std::mem::take(&mut self.refreshing);
            let timeout_s = f64::from(settings.load_timeout_s);
            refreshing.retain(|&(id, since_s)| now_s - since_s < timeout_s && self.is_holding(id));
            self.refreshing = refreshing;
        }
        while self.has_strays {
            let index = &self.manifest.index;
            let residents = &self.residency;
            let stray = residents.childless_where(|address| index.get(address).is_none());
            match stray {
                Some(page) => self.residency.send_off(page),
                None => {
                    let mut left = self.residency.residents();
                    self.has_strays = left.any(|(_, address)| index.get(address).is_none());
                    break;
                }
            }
        }
        let is_mixed = self.has_strays
            || self.has_complaints
            || !self.to_refresh.is_empty()
            || !self.refreshing.is_empty();
        if !is_mixed && std::mem::take(&mut self.has_wide_bounds) {
            self.reset_bounds(commands);
        }
        let short = self.eyes.iter().map(|eye| {
            let resident = &self.residency.resident;
            levels_short(&self.lattice, &self.available, resident, &eye.lod)
        });
        self.levels_short = short.max().unwrap_or(0);
        let is_complete = is_requested && self.loading.is_empty()
            || self.levels_short == 0 && !self.eyes.is_empty();
        if self.residency.is_appearing && self.is_ready() && is_complete {
            self.residency.is_appearing = false;
        }
    }
}
