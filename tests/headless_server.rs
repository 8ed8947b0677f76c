//! A server and its clients have the same ground: as three processes, run as a stranger would run
//! them, and in one, where messages can be tampered with.

#[path = "../examples/sharing/mod.rs"]
mod sharing;
mod streaming_support;

use bevy::prelude::*;
use bevy::state::app::StatesPlugin;
use bevy_replicon::prelude::*;
use bevy_replicon_renet::RepliconRenetPlugins;
use bevy_tessera::edit::{
    Crater, EditDiff, EditLog, MergeEdits, Stamp, StampImage, TerrainEdits, UndoEdit,
};
use bevy_tessera::stream::TerrainRegion;
use bevy_tessera::terrain::Terrain;
use sharing::{
    EditNews, EditRequest, EditsKnown, Follower, Following, SharingFailed, SharingPlugin,
};
use std::io::{BufRead, BufReader, Read};
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use streaming_support::World3;

fn program() -> PathBuf {
    let mut path = std::env::current_exe().unwrap();
    path.pop();
    path.pop();
    path.join("examples").join("headless_server")
}

/// A process that doesn't outlive its test, however that ends.
struct Running {
    process: Child,
    said: JoinHandle<String>,
    complained: JoinHandle<String>,
}

impl Running {
    fn of(mut process: Child) -> Self {
        fn read(from: Option<impl Read + Send + 'static>) -> JoinHandle<String> {
            std::thread::spawn(move || {
                let mut text = String::new();
                let _ = from.map(|mut from| from.read_to_string(&mut text));
                text
            })
        }
        Self {
            said: read(process.stdout.take()),
            complained: read(process.stderr.take()),
            process,
        }
    }

    /// The exit code and what was printed, in and beside the standard output.
    fn end(mut self) -> (Option<i32>, String, String) {
        let started = Instant::now();
        let status = loop {
            if let Some(status) = self.process.try_wait().unwrap() {
                break Some(status);
            }
            if started.elapsed() > Duration::from_secs(150) {
                let _ = self.process.kill();
                break None;
            }
            std::thread::sleep(Duration::from_millis(10));
        };
        let said = self.said.join().unwrap();
        let complained = self.complained.join().unwrap();
        let status = status.unwrap_or_else(|| panic!("it hung: {said}\n{complained}"));
        (status.code(), said, complained)
    }
}

fn start(arguments: &[&str]) -> Child {
    let mut command = Command::new(program());
    command.args(arguments);
    let piped = command.stdout(Stdio::piped()).stderr(Stdio::piped());
    piped.spawn().unwrap()
}

fn run(arguments: &[&str]) -> (Option<i32>, String, String) {
    Running::of(start(arguments)).end()
}

/// The number after `ground`, of each line that holds `words`.
fn hashes(said: &str, words: &str) -> Vec<String> {
    let lines = said.lines().filter(|line| line.contains(words));
    lines
        .map(|line| {
            let (_, hash) = line.split_once("ground ").expect("a line about the ground");
            assert_eq!(hash.len(), 32, "{line}");
            hash.to_owned()
        })
        .collect()
}

#[test]
fn a_server_a_client_and_a_late_joiner_end_with_the_same_ground() {
    let (code, said, complained) = run(&["--headless"]);
    assert_eq!(code, Some(0), "{said}\n{complained}");
    assert!(!complained.contains("WARN"), "{complained}");
    let before = hashes(&said, "server: edit 0,");
    let after = hashes(&said, ": ends with edit");
    assert_eq!(after.len(), 3, "{said}");
    for name in ["server", "client", "late joiner"] {
        let line = format!("{name}: ends with edit");
        assert_eq!(hashes(&said, &line), after[..1], "{said}");
    }
    assert_eq!(before.len(), 1, "{said}");
    assert_ne!(before[0], after[0], "{said}");
    let late = said
        .lines()
        .find(|line| line.contains("late joiner: joined"));
    assert!(
        late.is_some_and(|line| line.ends_with("in 3 parts")),
        "{said}"
    );
}

#[test]
fn a_client_without_a_server_says_so_and_ends() {
    // Somebody's port, who answers nothing.
    let silent = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let port = silent.local_addr().unwrap().port().to_string();
    let (code, _, complained) = run(&["--role", "client", "--port", &port]);
    assert_eq!(code, Some(1), "{complained}");
    assert!(
        complained.contains("client: no server has answered for 6s: start one with"),
        "{complained}"
    );
}

#[test]
fn a_port_that_is_taken_is_refused_in_a_sentence() {
    let taken = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let port = taken.local_addr().unwrap().port().to_string();
    let (code, _, complained) = run(&["--role", "server", "--port", &port]);
    assert_eq!(code, Some(1), "{complained}");
    let sentence = format!("server: port {port} can't be used: ");
    assert!(complained.contains(&sentence), "{complained}");
}

#[test]
fn bad_arguments_are_refused_in_a_sentence() {
    for (arguments, code, expected) in [
        (&["--role", "judge"][..], 2, "--role is judge: write server"),
        (
            &["--port", "70000"][..],
            2,
            "--port is 70000: write a number",
        ),
        (&["--clients"][..], 2, "--clients needs a value after it"),
        (&["--fast"][..], 2, "--fast is no option"),
        (&["--terrain", "/nowhere"][..], 2, "holds no terrain.ron"),
        (&["--role", "client"][..], 1, "a client needs --port N"),
    ] {
        let (ended, _, complained) = run(arguments);
        assert_eq!(ended, Some(code), "{complained}");
        assert!(complained.contains(expected), "{arguments:?}: {complained}");
    }
}

/// Whether whoever started this process has it ignore Ctrl-C, as shells do in the background. So do
/// its children then.
#[cfg(unix)]
fn ignores_interrupts() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    ignored
        .and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok())
        .is_some_and(|mask| mask & 1 << (2 - 1) != 0)
}

#[cfg(unix)]
#[test]
fn clients_of_a_server_that_is_stopped_say_so_and_end() {
    if ignores_interrupts() {
        eprintln!("not tested: this process was told to ignore interrupts, and so is its server");
        return;
    }
    let mut server = start(&["--role", "server", "--clients", "0"]);
    let stdout = BufReader::new(server.stdout.take().unwrap());
    let mut lines = stdout.lines().map_while(Result::ok);
    let port = lines.find_map(|line| Some(line.split_once("listening on port ")?.1.to_owned()));
    let port = port.expect("the server says where it is");
    let mut client = start(&["--role", "client", "--port", &port]);
    let stdout = BufReader::new(client.stdout.take().unwrap());
    let mut said = stdout.lines().map_while(Result::ok);
    let has_joined = said.any(|line| line.contains("client: joined"));
    // What Ctrl-C does.
    let pid = server.id().to_string();
    let stopped = Command::new("kill").args(["-INT", &pid]).status();
    let (code, _, complained) = Running::of(client).end();
    assert!(has_joined && stopped.unwrap().success(), "{complained}");
    assert_eq!(code, Some(1), "{complained}");
    assert!(
        complained.contains("client: the server has gone before the play was over"),
        "{complained}"
    );
    let (code, _, complained) = Running::of(server).end();
    assert_eq!(code, Some(130), "{complained}");
}

/// What a client has been told of failures.
#[derive(Resource, Default)]
struct Failures(Vec<String>);

/// A server or a client in this process, all of whose ground is resident.
struct Peer {
    world: World3,
    terrain: Entity,
}

impl Peer {
    fn new() -> Self {
        let mut world = World3::in_app([400, 300], false, |app, _| {
            app.add_plugins((
                StatesPlugin,
                RepliconPlugins,
                RepliconRenetPlugins,
                SharingPlugin,
            ))
            .init_resource::<Failures>()
            .add_observer(
                |failed: On<SharingFailed>, mut failures: ResMut<Failures>| {
                    failures.0.push(failed.reason.clone());
                },
            );
        });
        let terrain = world.spawn(());
        let pin = Terrain::wait_for(terrain, TerrainRegion::EVERYTHING);
        world.app.world_mut().spawn(pin);
        world.settle(terrain);
        Self { world, terrain }
    }

    fn server() -> (Self, SocketAddr) {
        let mut server = Self::new();
        let port = sharing::host(&mut server.world.app, 0).unwrap();
        (server, SocketAddr::from((Ipv4Addr::LOCALHOST, port)))
    }

    fn join(&mut self, server: SocketAddr) {
        sharing::join(&mut self.world.app, server).unwrap();
    }

    fn trigger<'a>(&mut self, event: impl Event<Trigger<'a>: Default>) {
        self.world.app.world_mut().trigger(event);
        self.world.app.world_mut().flush();
    }

    fn crater(&mut self, number: u32) {
        let at = |by: u32| 20.0 + ((number * by) % 540) as f32;
        self.trigger(Crater::at(Vec3::new(at(37), 0.0, at(61))).radius(9.0));
    }

    fn log(&self) -> &EditLog {
        let edits = self.world.app.world().get::<TerrainEdits>(self.terrain);
        edits.and_then(TerrainEdits::log).expect("it has loaded")
    }

    fn hash(&self) -> u128 {
        let hash = self
            .world
            .state(self.terrain)
            .ground_hash(&TerrainRegion::EVERYTHING);
        hash.expect("all of it is resident")
    }

    fn following(&self) -> &Following {
        self.world.app.world().resource::<Following>()
    }

    fn failures(&self) -> &[String] {
        &self.world.app.world().resource::<Failures>().0
    }
}

/// Runs a server and a client until `done`.
fn run_until(
    what: &str,
    server: &mut Peer,
    client: &mut Peer,
    done: impl Fn(&Peer, &Peer) -> bool,
) {
    let started = Instant::now();
    while !done(server, client) {
        let (known, last) = (client.log().last_sequence(), server.log().last_sequence());
        assert!(
            started.elapsed() < Duration::from_secs(60),
            "never: {what}; the client has {known} of {last}: {:?}, {:?}",
            client.following(),
            client.failures()
        );
        server.world.frame();
        client.world.frame();
        std::thread::sleep(Duration::from_micros(200));
    }
}

fn run_until_equal(server: &mut Peer, client: &mut Peer) {
    run_until("equal logs", server, client, |server, client| {
        client.following().is_caught_up && client.log() == server.log()
    });
    assert_eq!(client.hash(), server.hash());
    assert!(client.failures().is_empty(), "{:?}", client.failures());
}

#[test]
fn a_late_joiner_gets_the_log_in_parts_and_new_edits_as_they_come() {
    let (mut server, address) = Peer::server();
    let baked = server.hash();
    for number in 0..600 {
        server.crater(number);
    }
    server.trigger(UndoEdit::default());
    let mut client = Peer::new();
    assert_eq!(client.hash(), baked);
    client.join(address);
    run_until_equal(&mut server, &mut client);
    assert_eq!(client.following().parts, 3);
    assert_ne!(client.hash(), baked);
    // From here on one by one, asked for or not.
    let world = client.world.app.world_mut();
    world.client_trigger(EditRequest::Redo);
    world.client_trigger(EditRequest::Crater {
        at: [300.0, 0.0, 200.0],
        radius_m: 15.0,
        seed: 1,
    });
    // No ground can have this one; the server goes on.
    world.client_trigger(EditRequest::Crater {
        at: [f32::NAN, 0.0, 200.0],
        radius_m: -3.0,
        seed: 1,
    });
    world.client_trigger(EditRequest::Undo);
    run_until(
        "four records more",
        &mut server,
        &mut client,
        |server, _| server.log().last_sequence() == 604,
    );
    server.crater(7);
    run_until_equal(&mut server, &mut client);
    assert_eq!(client.log().last_sequence(), 605);
}

#[test]
fn large_edits_travel_alone() {
    let (mut server, address) = Peer::server();
    let mut number = 1_u32;
    for _ in 0..4 {
        // Noise: nothing makes it shorter.
        let noise = (0..1024 * 1024).map(|_| {
            number = number.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            ((number >> 16) as i16).max(-32_767)
        });
        let image = StampImage {
            side: 1024,
            samples: noise.collect(),
        };
        server.trigger(Stamp::at(Vec3::new(300.0, 0.0, 200.0), image));
    }
    assert_eq!(server.log().last_sequence(), 4);
    let mut client = Peer::new();
    client.join(address);
    run_until_equal(&mut server, &mut client);
    assert_eq!(client.following().parts, 4);
}

#[test]
fn a_log_that_has_parted_from_the_servers_gives_way_to_it() {
    // As many records as the server, more, and fewer.
    for own in [3, 5, 2] {
        let (mut server, address) = Peer::server();
        let mut client = Peer::new();
        for number in 0..3 {
            server.crater(number);
        }
        for number in 0..own {
            client.crater(100 + number);
        }
        client.join(address);
        run_until_equal(&mut server, &mut client);
        assert_eq!(client.log().last_sequence(), 3);
    }
}

#[test]
fn a_client_that_misses_a_part_asks_for_it_again() {
    let (mut server, address) = Peer::server();
    let mut client = Peer::new();
    client.join(address);
    server.crater(1);
    run_until_equal(&mut server, &mut client);
    // Until the client's answer has arrived.
    for _ in 0..20 {
        server.world.frame();
        client.world.frame();
    }
    for number in 2..9 {
        server.crater(number);
    }
    // The server believes that the client has had these already.
    let world = server.world.app.world_mut();
    let mut followers = world.query_filtered::<Entity, With<Follower>>();
    let follower = followers.single(world).unwrap();
    server.trigger(FromClient {
        client_id: follower.into(),
        message: EditsKnown {
            sequence: 8,
            asks: false,
        },
    });
    server.crater(9);
    run_until_equal(&mut server, &mut client);
    assert_eq!(client.log().last_sequence(), 9);
}

#[test]
fn a_client_that_knows_more_than_its_server_starts_over() {
    let (mut server, address) = Peer::server();
    let mut client = Peer::new();
    for number in 0..3 {
        server.crater(number);
    }
    client.trigger(MergeEdits {
        terrain: None,
        diff: server.log().diff(0),
    });
    // Those that the server had made before it was set back.
    client.crater(100);
    client.crater(101);
    client.join(address);
    run_until_equal(&mut server, &mut client);
    assert_eq!(client.log().last_sequence(), 3);
}

#[test]
fn edits_of_another_terrain_are_refused_and_told() {
    let (mut server, address) = Peer::server();
    let mut client = Peer::new();
    client.join(address);
    server.crater(1);
    run_until_equal(&mut server, &mut client);
    let (ground, stamp) = (client.hash(), client.log().stamp());
    for tries in 0..3 {
        assert_eq!(client.failures().len(), 0, "after {tries} tries");
        client.trigger(EditNews {
            diff: EditDiff {
                stamp: stamp ^ 1,
                ..server.log().diff(0)
            },
            last: 1,
            starts_over: false,
        });
    }
    let [reason] = client.failures() else {
        panic!("{:?}", client.failures());
    };
    assert!(reason.contains("another terrain"), "{reason}");
    assert_ne!(client.hash(), ground, "its own edits have given way");
}
