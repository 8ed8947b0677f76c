//! Over the Bevy Remote Protocol tools read what terrains do and set what they may be set to, and
//! nothing that a client sends makes a running app do anything else.

mod common;
#[path = "remote/set.rs"]
mod set_settings;
mod streaming_support;

use bevy::diagnostic::DiagnosticsStore;
use bevy::prelude::*;
use bevy::remote::http::RemoteHttpPlugin;
use bevy::remote::{BrpError, BrpResult, RemoteMethodSystemId, RemoteMethods, RemotePlugin};
use bevy_tessera::edit::{Crater, UndoEdit};
use bevy_tessera::remote::{
    TERRAIN_SET_METHOD, TERRAIN_STATS_METHOD, TERRAIN_STATS_WATCH_METHOD, TerrainRemotePlugin,
    TerrainSetting, TerrainStats,
};
use bevy_tessera::render::TerrainStatistics;
use bevy_tessera::stream::{PAGE_BYTES, TerrainStreamer};
use bevy_tessera::terrain::{Terrain, TerrainCamera, TerrainPlugin, TerrainSettings};
use bevy_tessera::tile::TileAddress;
use bevy_tessera::view::TerrainViews;
use serde_json::{Value, json};
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::time::{Duration, Instant};
use streaming_support::World3;

/// A port that was free just now.
fn free_port() -> u16 {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    listener.local_addr().unwrap().port()
}

/// Sends a request and leaves the answer to be read. The server may not listen yet.
fn post(port: u16, method: &str, parameters: &Value) -> TcpStream {
    let request = json!({"jsonrpc": "2.0", "id": 7, "method": method, "params": parameters});
    let body = request.to_string();
    let began = Instant::now();
    let mut stream = loop {
        match TcpStream::connect((Ipv4Addr::LOCALHOST, port)) {
            Ok(stream) => break stream,
            Err(error) if began.elapsed() > Duration::from_secs(20) => panic!("{error}"),
            Err(_) => std::thread::sleep(Duration::from_millis(5)),
        }
    };
    stream
        .set_read_timeout(Some(Duration::from_secs(30)))
        .unwrap();
    // In version 1.0 an answer ends with the connection, without chunks.
    let head = format!("POST / HTTP/1.0\r\nContent-Length: {}\r\n\r\n", body.len());
    stream.write_all((head + &body).as_bytes()).unwrap();
    stream
}

/// The JSON in an answer's body.
fn body(text: &str) -> Value {
    let (_, body) = text.split_once("\r\n\r\n").expect("a head and a body");
    serde_json::from_str(body).unwrap()
}

/// A server without a renderer, with a terrain and an eye, that listens.
struct Server {
    world: World3,
    port: u16,
    terrain: Entity,
    eye: Entity,
}

impl Server {
    fn start() -> Self {
        let port = free_port();
        let mut world = World3::in_app([300, 260], false, |app, _| {
            app.add_plugins(TerrainRemotePlugin)
                .add_plugins(RemotePlugin::default())
                .add_plugins(RemoteHttpPlugin::default().with_port(port));
        });
        let terrain = world.spawn(Name::new("alps"));
        let eye = (
            TerrainCamera::default(),
            Transform::from_xyz(200.0, 300.0, 150.0),
            Name::new("player"),
        );
        let eye = world.app.world_mut().spawn(eye).id();
        world.settle(terrain);
        Self {
            world,
            port,
            terrain,
            eye,
        }
    }

    /// Sends a request, runs the app until it is answered, and gives the whole answer.
    fn call(&mut self, method: &str, parameters: Value) -> Value {
        let (port, method) = (self.port, method.to_owned());
        let client = std::thread::spawn(move || {
            let mut text = String::new();
            let mut answer = post(port, &method, &parameters);
            answer.read_to_string(&mut text).map(|_| body(&text))
        });
        let began = Instant::now();
        while !client.is_finished() {
            assert!(began.elapsed() < Duration::from_secs(60), "no answer");
            self.world.frame();
            std::thread::sleep(Duration::from_micros(200));
        }
        client.join().unwrap().unwrap()
    }

    fn stats(&mut self) -> TerrainStats {
        let answer = self.call(TERRAIN_STATS_METHOD, Value::Null);
        serde_json::from_value(answer["result"].clone()).unwrap()
    }

    fn get<T: Component>(&self, entity: Entity) -> &T {
        self.world.app.world().get(entity).unwrap()
    }
}

/// Runs a method as Bevy's plugin does, without a connection.
fn ask(world: &mut bevy::ecs::world::World, method: &str, parameters: Value) -> BrpResult {
    let RemoteMethodSystemId::Instant(id) = *world
        .resource::<RemoteMethods>()
        .get(method)
        .expect("the method is there")
    else {
        panic!("{method} answers again and again");
    };
    world.run_system_with(id, Some(parameters)).unwrap()
}

fn set(world: &mut bevy::ecs::world::World, parameters: Value) -> Result<TerrainSetting, BrpError> {
    let answer = ask(world, TERRAIN_SET_METHOD, parameters)?;
    Ok(serde_json::from_value(answer).unwrap())
}

#[test]
fn stats_over_http_equal_the_components() {
    let mut server = Server::start();
    let crater = Crater::at(Vec3::new(200.0, 0.0, 150.0)).radius(6.0);
    for _ in 0..3 {
        server.world.app.world_mut().trigger(crater.clone());
    }
    server.world.app.world_mut().trigger(UndoEdit::default());
    let terrain = server.terrain;
    server.world.settle(terrain);
    let stats = server.stats();

    let [told] = &stats.terrains[..] else {
        panic!("{stats:?}");
    };
    let state = server.world.state(terrain);
    assert_eq!(told.entity, terrain);
    assert_eq!(told.name.as_deref(), Some("alps"));
    assert_eq!(told.manifest.as_deref(), Some("alps/terrain.ron"));
    assert_eq!(told.state, "settled");
    assert_eq!(told.size_samples, Some([300, 260]));
    assert_eq!(told.spacing_m, Some(2.0));
    assert_eq!(told.levels, Some(state.manifest().file.levels));
    let mut by_level = vec![0; usize::from(state.manifest().file.levels)];
    let app = &mut server.world.app;
    let tiles: Vec<_> = {
        let mut tiles = app.world_mut().query::<&TileAddress>();
        tiles.iter(app.world()).copied().collect()
    };
    for tile in tiles {
        by_level[usize::from(tile.level)] += 1;
    }
    assert!(by_level.iter().all(|&tiles| tiles > 0), "{by_level:?}");
    assert_eq!(told.tiles_resident, by_level);
    let state = server.world.state(terrain);
    assert_eq!(told.tiles_wanted, state.wanted_count());
    assert_eq!((told.tiles_loading, told.tiles_failed), (0, 0));
    assert_eq!(told.levels_short, state.levels_short());
    assert_eq!((told.edits, told.edits_undone), (2, 1));
    assert_eq!(told.last_sequence, 4);
    assert_eq!(told.settings["root_levels"], json!(2));

    let [told] = &stats.cameras[..] else {
        panic!("{stats:?}");
    };
    assert_eq!(told.entity, server.eye);
    assert_eq!(told.name.as_deref(), Some("player"));
    assert_eq!(told.settings["triangle_width_px"], json!(6.0));
    assert_eq!(told.settings["lod"]["reach"], json!(4.0));
    assert_eq!(told.settings["policy"], json!("TriangleWidth"));
    assert_eq!(told.refused, [""; 0]);
    let [view] = &told.views[..] else {
        panic!("{told:?}");
    };
    let views = server.get::<TerrainViews>(server.eye);
    assert_eq!(view.terrain, terrain);
    assert_eq!(view.eye_m, views.views[0].eye_m.to_array());
    assert_eq!(view.drawn, None);

    let told = stats.streaming.unwrap();
    let streamer = server.world.app.world().resource::<TerrainStreamer>();
    assert_eq!(told.pages_used, streamer.pages_used());
    assert_eq!(
        told.pages_used,
        stats.terrains[0].tiles_resident.iter().sum::<u32>()
    );
    assert_eq!(told.pages, streamer.pages());
    assert_eq!(told.page_bytes, PAGE_BYTES);
    assert_eq!(told.tiles_held, streamer.tiles_held());
    assert_eq!(told.settings["page_bytes"], json!(128 << 20));
}

#[test]
fn stats_say_what_is_missing_and_what_cant_be_used() {
    let mut server = Server::start();
    let terrain = server.terrain;
    // One that isn't there, one whose tile is gone, and settings that nobody can use.
    let nowhere = server.world.app.world_mut();
    let manifest = nowhere
        .resource::<AssetServer>()
        .load("nowhere/terrain.ron");
    let nowhere = nowhere.spawn(Terrain::new(manifest)).id();
    fs::create_dir(server.world.dir.path().join("hurt")).unwrap();
    for entry in ["terrain.ron", "tiles.index"] {
        let to = server.world.dir.path().join("hurt").join(entry);
        fs::copy(server.world.path(entry), to).unwrap();
    }
    let hurt = server.world.app.world_mut();
    let manifest = hurt.resource::<AssetServer>().load("hurt/terrain.ron");
    let hurt = hurt.spawn(Terrain::new(manifest)).id();
    let mut camera = server.world.app.world_mut().entity_mut(server.eye);
    camera.get_mut::<TerrainCamera>().unwrap().density = 2.0;
    server.world.run_until("both have failed", |world| {
        let state = world.get::<bevy_tessera::stream::TerrainState>(hurt);
        let has_failed = state.is_some_and(|state| state.failed().len() > 0);
        let server = world.resource::<AssetServer>();
        let manifest = &world.get::<Terrain>(nowhere).unwrap().manifest;
        has_failed && server.load_state(manifest).is_failed()
    });
    let stats = server.stats();
    let of = |entity| {
        let mut terrains = stats.terrains.iter();
        terrains.find(|told| told.entity == entity).unwrap()
    };
    assert_eq!(of(terrain).state, "settled");
    assert_eq!(of(nowhere).state, "failed");
    assert_eq!(of(nowhere).size_samples, None);
    assert_eq!(of(hurt).state, "starting");
    assert!(of(hurt).tiles_failed > 0);
    assert!(
        of(hurt)
            .failed_paths
            .contains(&"tile/2/0_0.tile".to_owned()),
        "{:?}",
        of(hurt).failed_paths
    );
    let refused = &stats.cameras[0].refused;
    assert!(refused[0].contains("density"), "{refused:?}");
}

#[test]
fn stats_come_again_and_again_where_they_are_watched() {
    let mut server = Server::start();
    let port = server.port;
    let client = std::thread::spawn(move || {
        let stream = post(port, TERRAIN_STATS_WATCH_METHOD, &json!({"every_s": 0.1}));
        let mut said = Vec::new();
        for line in BufReader::new(stream).lines() {
            if let Some(event) = line.unwrap().strip_prefix("data: ") {
                said.push(serde_json::from_str::<Value>(event).unwrap());
            }
            if said.len() == 3 {
                break;
            }
        }
        said
    });
    let (mut frames, began) = (0, Instant::now());
    while !client.is_finished() {
        assert!(began.elapsed() < Duration::from_secs(60), "no answer");
        server.world.frame();
        frames += 1;
        std::thread::sleep(Duration::from_millis(1));
    }
    let said = client.join().unwrap();
    assert_eq!(said.len(), 3);
    for answer in said {
        let stats: TerrainStats = serde_json::from_value(answer["result"].clone()).unwrap();
        assert_eq!(stats.terrains.len(), 1);
    }
    // 16 ms each: three answers span two tenths of a second at least.
    assert!(frames >= 12, "{frames}");
    for wrong in [json!({"every_s": 0}), json!({"every": 1}), json!(3)] {
        let stream = post(port, TERRAIN_STATS_WATCH_METHOD, &wrong);
        let client = std::thread::spawn(move || {
            let lines = BufReader::new(stream).lines().map(Result::unwrap);
            let errors = lines.filter(|line| line.starts_with("data: "));
            errors.take(2).collect::<Vec<_>>()
        });
        let mut frames = 0;
        while !client.is_finished() {
            server.world.frame();
            frames += 1;
            std::thread::sleep(Duration::from_millis(1));
        }
        let said = client.join().unwrap();
        assert_eq!(said.len(), 2);
        assert!(said[0].contains("every_s"), "{said:?}");
        // Once a second, not in every frame.
        assert!(frames > 60, "{frames}");
    }
}

#[test]
fn set_over_http_changes_what_it_names_and_nothing_else() {
    let mut server = Server::start();
    let before = server.get::<TerrainCamera>(server.eye).clone();
    let answer = server.call(
        TERRAIN_SET_METHOD,
        json!({"component": "TerrainCamera", "path": "triangle_width_px", "value": 8}),
    );
    assert_eq!(
        answer["result"],
        json!({
            "entity": server.eye.to_bits(),
            "component": "TerrainCamera",
            "path": "triangle_width_px",
            "old": 6.0,
            "new": 8.0,
        })
    );
    let after = server.get::<TerrainCamera>(server.eye).clone();
    let expected = TerrainCamera {
        triangle_width_px: 8.0,
        ..before
    };
    assert_eq!(after, expected);
    let answer = server.call(
        TERRAIN_SET_METHOD,
        json!({"component": "TerrainCamera", "path": "triangle_width_px", "value": 8000}),
    );
    let message = answer["error"]["message"].as_str().unwrap();
    assert_eq!(
        message,
        "TerrainCamera::triangle_width_px is 8000: use a number from 1 to 256"
    );
    assert_eq!(server.get::<TerrainCamera>(server.eye), &after);
}

#[test]
fn what_is_set_takes_effect() {
    let mut server = Server::start();
    let few =
        json!({"component": "TerrainStreaming", "path": "page_bytes", "value": 5 * PAGE_BYTES});
    let answer = server.call(TERRAIN_SET_METHOD, few);
    assert_eq!(answer["error"], Value::Null);
    let terrain = server.terrain;
    server.world.settle(terrain);
    assert_eq!(server.stats().streaming.unwrap().pages, 5);
}

#[test]
fn plugins_may_come_in_any_order_and_be_alone() {
    let has = |app: &App| {
        let methods = app.world().resource::<RemoteMethods>();
        [
            TERRAIN_STATS_METHOD,
            TERRAIN_STATS_WATCH_METHOD,
            TERRAIN_SET_METHOD,
        ]
        .map(|method| methods.get(method).is_some())
    };
    let mut app = App::new();
    app.add_plugins(MinimalPlugins)
        .add_plugins((RemotePlugin::default(), TerrainRemotePlugin));
    app.update();
    assert_eq!(has(&app), [true; 3]);
    let mut app = App::new();
    app.add_plugins(MinimalPlugins)
        .add_plugins((TerrainRemotePlugin, RemotePlugin::default()));
    app.update();
    assert_eq!(has(&app), [true; 3]);
    // Without terrains there is little to tell.
    let stats = ask(app.world_mut(), TERRAIN_STATS_METHOD, Value::Null).unwrap();
    let stats: TerrainStats = serde_json::from_value(stats).unwrap();
    assert!(stats.terrains.is_empty() && stats.streaming.is_none());

    // Bevy's plugin is missing: that is said, and all else goes on.
    let mut world = World3::in_app([300, 260], false, |app, _| {
        app.add_plugins(TerrainRemotePlugin);
    });
    world.frame();
    assert!(!streaming_support::logged("add Bevy's RemotePlugin").is_empty());
    // Terrains may be alone, too.
    let mut app = App::new();
    app.add_plugins((MinimalPlugins, TransformPlugin, AssetPlugin::default()))
        .add_plugins((TerrainRemotePlugin, TerrainPlugin, RemotePlugin::default()));
    app.update();
    assert_eq!(has(&app), [true; 3]);
}

#[test]
fn drawn_views_are_told_as_their_statistics_have_them() {
    let mut app = common::app::app(common::gpu::bundled(), false);
    app.add_plugins((RemotePlugin::default(), TerrainRemotePlugin));
    let mut kernels = common::gpu::Kernels::start_in(
        app,
        "jacksboro/terrain.ron",
        TerrainSettings::default(),
        UVec2::new(320, 200),
    );
    common::app::settle(&mut kernels.app, 400);
    for _ in 0..6 {
        kernels.app.update();
    }
    let world = kernels.app.world_mut();
    let stats = ask(world, TERRAIN_STATS_METHOD, Value::Null).unwrap();
    let stats: TerrainStats = serde_json::from_value(stats).unwrap();
    let statistics = world.get::<TerrainStatistics>(kernels.camera).unwrap();
    let view = statistics.terrains[&kernels.terrain];
    assert!(view.triangles > 0);
    let told = stats.cameras[0].views[0].drawn.unwrap();
    assert_eq!(stats.cameras[0].views[0].terrain, kernels.terrain);
    assert_eq!(told.faces, view.counters.faces);
    assert_eq!(told.culled_faces, view.counters.culled_faces);
    assert_eq!(told.vertices, view.vertices);
    assert_eq!(told.triangles, view.triangles);
    assert_eq!(told.wanted_vertices, view.wanted_vertices);
    assert_eq!(told.wanted_triangles, view.wanted_triangles);
    assert_eq!(told.room_vertices, view.room_vertices);
    assert_eq!(told.overflow, view.overflow);
    assert_eq!(told.width_scale, view.width_scale);

    let store = world.resource::<DiagnosticsStore>();
    let ours = store.iter().filter(|diagnostic| {
        let path = diagnostic.path().as_str();
        path.starts_with("terrain/")
    });
    let mut ours: Vec<_> = ours
        .map(|diagnostic| (diagnostic.path().as_str().to_owned(), diagnostic.value()))
        .collect();
    ours.sort_by(|one, other| one.0.cmp(&other.0));
    let told = stats.diagnostics.iter();
    let told: Vec<_> = told.map(|told| (told.path.clone(), told.value)).collect();
    assert!(ours.len() >= 8);
    assert_eq!(told, ours);
    let triangles = told.iter().find(|(path, _)| path == "terrain/triangles");
    assert_eq!(triangles.unwrap().1, Some(f64::from(view.triangles)));
}
