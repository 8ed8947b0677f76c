//! Terrains on disk and apps without a renderer, for the tests of streaming.
#![expect(dead_code, reason = "each test file uses its own part")]

use bevy::app::ScheduleRunnerPlugin;
use bevy::asset::{AssetApp, AssetPlugin};
use bevy::log::tracing::{self, Event, Subscriber, field};
use bevy::log::tracing_subscriber::{self, Layer, layer, prelude::*};
use bevy::prelude::*;
use bevy::time::TimeUpdateStrategy;
use bevy_tessera::stream::{TerrainState, TerrainStreamer, TileOf};
use bevy_tessera::terrain::{
    DensitySettings, INDEX_FILE, MANIFEST_FILE, MANIFEST_MAGIC, MANIFEST_VERSION, ManifestFile,
    Terrain, TerrainFailed, TerrainManifest, TerrainPinReady, TerrainPlugin, TerrainReady,
    TerrainReloadFailed, TileEvicted, TileFailed, TileLoaded, TileReloaded,
};
use bevy_tessera::tile::{
    DENSITY_STORED, DensityTile, ErrorTile, HeightTile, TILE_BORDER, TILE_STORED, TerrainTile,
    TileAddress, TileIndex, encode_tile, tile_path,
};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, Once, PoisonError};
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Height of level-0 sample `(x, z)` of the terrains that these tests make.
pub fn stored_height(x: u32, z: u32) -> u16 {
    let (x, z) = (f64::from(x), f64::from(z));
    let waves = (x / 97.0).sin() * (z / 71.0).cos() + 0.2 * (x / 13.0).sin();
    (20_000.0 + 4_000.0 * waves) as u16
}

/// Writes a terrain of `size` samples, 2 m apart, into `dir`.
pub fn write_terrain(dir: &Path, size: [u32; 2]) -> ManifestFile {
    write_terrain_of(dir, size, 0.01, &stored_height)
}

/// Writes a terrain of `size` samples, 2 m apart, whose stored heights a function gives.
pub fn write_terrain_of(
    dir: &Path,
    size: [u32; 2],
    height_step_m: f64,
    stored_height: &dyn Fn(u32, u32) -> u16,
) -> ManifestFile {
    let mut file = ManifestFile {
        format: MANIFEST_MAGIC.to_owned(),
        version: MANIFEST_VERSION,
        size,
        spacing_m: 2.0,
        height_min_m: -100.0,
        height_step_m,
        levels: ManifestFile::levels_for(size),
        density: DensitySettings::default(),
        index_crc32: 0,
    };
    let mut index = TileIndex::new(&file);
    for level in 0..file.levels {
        let [columns, rows] = file.tiles(level);
        for z in 0..rows {
            for x in 0..columns {
                let address = TileAddress::new(level, x, z);
                let tile = height_tile(size, address, stored_height);
                let children = address.children().into_iter().flatten();
                let range = children
                    .filter_map(|child| index.get(child))
                    .fold(tile.range(), |range, child| range.union(child));
                index.set(address, Some(range));
                let texels = vec![128; (DENSITY_STORED * DENSITY_STORED) as usize];
                let densities = DensityTile::from_samples(texels.into()).expect("35 x 35");
                write(
                    &dir.join(tile_path(address)),
                    &encode_tile(address, file.stamp(), &tile, &densities, &ErrorTile::flat()),
                );
            }
        }
    }
    let index = index.encode();
    // The index's own checksum field aside, the manifest names the CRC-32 of the whole file.
    file.index_crc32 = crc32(&index);
    write(&dir.join(INDEX_FILE), &index);
    let text = ron::to_string(&file).expect("a manifest is RON");
    write(&dir.join(MANIFEST_FILE), text.as_bytes());
    file
}

fn crc32(bytes: &[u8]) -> u32 {
    crc32fast::hash(bytes)
}

fn height_tile(
    size: [u32; 2],
    address: TileAddress,
    stored_height: &dyn Fn(u32, u32) -> u16,
) -> HeightTile {
    let (first_x, first_z) = address.first_sample();
    let mut samples = Vec::new();
    for row in 0..TILE_STORED {
        for column in 0..TILE_STORED {
            let at = |first: u32, offset: u32, last: u32| {
                let sample = (first + offset).saturating_sub(TILE_BORDER);
                (sample << address.level).min(last)
            };
            samples.push(stored_height(
                at(first_x, column, size[0] - 1),
                at(first_z, row, size[1] - 1),
            ));
        }
    }
    HeightTile::from_samples(samples.into()).expect("133 x 133")
}

fn write(path: &Path, bytes: &[u8]) {
    fs::create_dir_all(path.parent().expect("has a folder")).expect("folder");
    fs::write(path, bytes).expect("file");
}

/// What this crate has logged in this process, of all tests: the level and the text.
static LOG: Mutex<Vec<(tracing::Level, String)>> = Mutex::new(Vec::new());

struct Listener;

struct Text<'a>(&'a mut String);

impl field::Visit for Text<'_> {
    fn record_debug(&mut self, field: &field::Field, value: &dyn std::fmt::Debug) {
        if field.name() == "message" {
            *self.0 = format!("{value:?}");
        }
    }
}

impl<S: Subscriber> Layer<S> for Listener {
    fn on_event(&self, event: &Event<'_>, _context: layer::Context<'_, S>) {
        let meta = event.metadata();
        if meta.target().starts_with("bevy_tessera") {
            let mut text = String::new();
            event.record(&mut Text(&mut text));
            let mut log = LOG.lock().unwrap_or_else(PoisonError::into_inner);
            log.push((*meta.level(), text));
        }
    }
}

fn listen() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| tracing_subscriber::registry().with(Listener).init());
}

/// The levels of all lines logged by this crate that hold `words`.
pub fn logged(words: &str) -> Vec<tracing::Level> {
    let log = LOG.lock().unwrap_or_else(PoisonError::into_inner);
    let lines = log.iter().filter(|(_, text)| text.contains(words));
    lines.map(|(level, _)| *level).collect()
}

/// Everything that terrains have told, in order.
#[derive(Resource, Default, Debug)]
pub struct Told {
    pub ready: Vec<Entity>,
    pub loaded: Vec<TileAddress>,
    pub evicted: Vec<TileAddress>,
    pub tiles_failed: Vec<(TileAddress, String)>,
    pub failed: Vec<(Entity, String)>,
    pub reloaded: Vec<TileAddress>,
    pub reload_failed: Vec<String>,
    pub pins_ready: Vec<Entity>,
}

pub struct World3 {
    pub dir: TempDir,
    pub app: App,
}

impl World3 {
    /// A folder with a terrain of `size` samples in `alps`, and an app that can load it.
    pub fn new(size: [u32; 2]) -> Self {
        Self::in_app(size, false, |_, _| ())
    }

    /// The same, in an app that sees files change if it `watches`; `first` may do what must come
    /// before Bevy's asset plugin.
    pub fn in_app(size: [u32; 2], watches: bool, first: impl FnOnce(&mut App, &Path)) -> Self {
        let dir = tempfile::tempdir().expect("a temporary folder");
        write_terrain(&dir.path().join("alps"), size);
        let app = app(dir.path(), watches, first);
        Self { dir, app }
    }

    pub fn path(&self, inside: impl AsRef<Path>) -> PathBuf {
        self.dir.path().join("alps").join(inside)
    }

    pub fn manifest(&self) -> Handle<TerrainManifest> {
        self.app
            .world()
            .resource::<AssetServer>()
            .load("alps/terrain.ron")
    }

    /// Spawns the terrain with `extra` components.
    pub fn spawn(&mut self, extra: impl Bundle) -> Entity {
        let manifest = self.manifest();
        let terrain = (Terrain::new(manifest), extra);
        self.app.world_mut().spawn(terrain).id()
    }

    pub fn state(&self, terrain: Entity) -> &TerrainState {
        let state = self.app.world().get::<TerrainState>(terrain);
        state.expect("the manifest has loaded")
    }

    pub fn told(&self) -> &Told {
        self.app.world().resource::<Told>()
    }

    /// Runs frames until `done`, checking every terrain's promises after each.
    pub fn run_until(&mut self, what: &str, mut done: impl FnMut(&World) -> bool) {
        let start = Instant::now();
        while !done(self.app.world()) {
            assert!(
                start.elapsed() < Duration::from_secs(60),
                "never: {what}; {:?}",
                self.told()
            );
            self.frame();
            std::thread::sleep(Duration::from_micros(200));
        }
    }

    /// Runs one frame and checks every terrain's promises.
    pub fn frame(&mut self) {
        self.app.update();
        let world = self.app.world_mut();
        let mut tiles = world.query::<&TileOf>();
        let owners: Vec<_> = tiles.iter(world).map(|tile| tile.0).collect();
        let mut states = world.query::<(Entity, &TerrainState)>();
        let mut resident = 0;
        for (terrain, state) in states.iter(world) {
            resident += state.resident_count();
            if let Err(broken) = state.validate() {
                panic!("{broken}");
            }
            let tiles = owners.iter().filter(|&&owner| owner == terrain).count();
            assert_eq!(tiles, state.resident_count(), "one entity a resident tile");
        }
        let streamer = world.resource::<TerrainStreamer>();
        assert_eq!(
            streamer.pages_used() as usize,
            resident,
            "a page a resident tile"
        );
        assert!(resident <= streamer.page_numbers() as usize);
    }

    pub fn settle(&mut self, terrain: Entity) {
        // One frame for the views to follow what the test has just moved.
        self.frame();
        self.frame();
        self.run_until("settled", |world| {
            let state = world.get::<TerrainState>(terrain);
            state.is_some_and(TerrainState::is_settled)
        });
    }

    /// Manifests and tiles that are in memory.
    pub fn assets(&self) -> [usize; 2] {
        let world = self.app.world();
        [
            world.resource::<Assets<TerrainManifest>>().len(),
            world.resource::<Assets<TerrainTile>>().len(),
        ]
    }

    pub fn tile_entities(&mut self) -> usize {
        let world = self.app.world_mut();
        world.query::<&TileAddress>().iter(world).count()
    }
}

/// An app as a headless server has it: no window, no renderer.
pub fn app(assets: &Path, watches: bool, first: impl FnOnce(&mut App, &Path)) -> App {
    listen();
    let mut app = App::new();
    first(&mut app, assets);
    let text = |path: &Path| path.to_str().expect("a readable path").to_owned();
    let elsewhere = text(&assets.join("elsewhere"));
    app.add_plugins(MinimalPlugins.set(ScheduleRunnerPlugin::run_once()))
        .add_plugins(TransformPlugin)
        .register_asset_source(
            "worlds",
            bevy::asset::io::AssetSourceBuilder::platform_default(&elsewhere, None),
        )
        .add_plugins(AssetPlugin {
            file_path: text(assets),
            watch_for_changes_override: Some(watches),
            ..default()
        })
        .add_plugins(TerrainPlugin)
        .insert_resource(TimeUpdateStrategy::ManualDuration(Duration::from_millis(
            16,
        )))
        .init_resource::<Told>()
        .add_observer(|event: On<TerrainReady>, mut told: ResMut<Told>| {
            told.ready.push(event.entity);
        })
        .add_observer(
            |event: On<TileLoaded>, mut told: ResMut<Told>, tiles: Query<&TileAddress>| {
                let address = tiles.get(event.tile).expect("the tile's entity is there");
                assert_eq!(*address, event.address);
                told.loaded.push(event.address);
            },
        )
        .add_observer(
            |event: On<TileEvicted>, mut told: ResMut<Told>, tiles: Query<&TileAddress>| {
                let address = tiles.get(event.tile).expect("the tile's entity is there");
                assert_eq!(*address, event.address);
                told.evicted.push(event.address);
            },
        )
        .add_observer(|event: On<TileFailed>, mut told: ResMut<Told>| {
            told.tiles_failed
                .push((event.address, event.reason.clone()));
        })
        .add_observer(|event: On<TerrainFailed>, mut told: ResMut<Told>| {
            told.failed.push((event.entity, event.reason.clone()));
        })
        .add_observer(|event: On<TileReloaded>, mut told: ResMut<Told>| {
            told.reloaded.push(event.address);
        })
        .add_observer(|event: On<TerrainReloadFailed>, mut told: ResMut<Told>| {
            told.reload_failed.push(event.reason.clone());
        })
        .add_observer(|event: On<TerrainPinReady>, mut told: ResMut<Told>| {
            told.pins_ready.push(event.entity);
        });
    app.finish();
    app.cleanup();
    app
}
