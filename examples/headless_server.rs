//! A server without a renderer, and clients that share its craters: one that is there from the start,
//! and one that joins late. In the end all have the same ground, and print its hash.
//!
//! ```sh
//! cargo run --release --features examples --example headless_server
//! ```
//!
//! That starts all three. By hand, from two terminals, with the port that the server prints:
//!
//! ```sh
//! cargo run --release --features examples --example headless_server -- --role server
//! cargo run --release --features examples --example headless_server -- --role client --port PORT
//! ```
//!
//! How edits travel is in `sharing/mod.rs`; here is what a game does with it.

mod kit;
mod sharing;

use bevy::app::{ScheduleRunnerPlugin, TerminalCtrlCHandlerPlugin};
use bevy::log::{Level, LogPlugin};
use bevy::prelude::*;
use bevy::state::app::StatesPlugin;
use bevy_replicon::prelude::*;
use bevy_replicon_renet::RepliconRenetPlugins;
use bevy_tessera::edit::{Crater, EditLog, RedoEdit, TerrainEdits, UndoEdit};
use bevy_tessera::stream::{TerrainRegion, TerrainState};
use bevy_tessera::terrain::{Terrain, TerrainFailed, TerrainPlugin};
use serde::{Deserialize, Serialize};
use sharing::{EditRequest, Follower, Following, SharingFailed, SharingPlugin};
use std::io::{BufRead, BufReader, Write};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::time::{Duration, Instant};

const USAGE: &str = "\
Without --role: a server, a client and a late joiner, and whether their grounds are equal.
Options:
  --role server|client   only one of them
  --port N               the server's port (a server's default is any that is free)
  --clients N            when so many clients have had their turn, the server ends the play
                         (default 1; 0 goes on until it is stopped)
  --name TEXT            what a client calls itself
  --terrain DIR          a baked terrain instead of the bundled one; the same everywhere
  --headless             nothing: there is never a window
  --help                 this text";

/// The ground that the server answers for, that everyone keeps resident, and whose hash is compared.
const GROUND: TerrainRegion = TerrainRegion::EVERYTHING;
/// A step of the game.
const FRAME: Duration = Duration::from_millis(10);
/// Longer than this a client doesn't wait for a server...
const CONNECT_AT_MOST: Duration = Duration::from_secs(6);
/// ...nor a server for its clients to have had their turn...
const PLAY_AT_MOST: Duration = Duration::from_secs(120);
/// ...nor for them to leave when it is over.
const LEAVE_AT_MOST: Duration = Duration::from_secs(5);
/// What the server blows into the ground before anyone else: more than fits into a message, so that
/// a late joiner gets the log in parts.
const BARRAGES: u32 = 15;
const CRATERS_PER_BARRAGE: u32 = 40;
/// What each client asks for.
const CLIENT_REQUESTS: u32 = 8;

fn main() -> AppExit {
    let arguments = match Arguments::from_words(std::env::args().skip(1)) {
        Ok(Some(arguments)) => arguments,
        Ok(None) => {
            println!("{USAGE}");
            return AppExit::Success;
        }
        Err(error) => {
            eprintln!("{error}\n{USAGE}");
            return AppExit::from_code(2);
        }
    };
    let played = match arguments.role {
        None => play(&arguments),
        Some(Role::Server) => serve(&arguments),
        Some(Role::Client) => follow(&arguments),
    };
    played.unwrap_or_else(|error| {
        eprintln!("{}: {error}", arguments.name());
        AppExit::error()
    })
}

/// Server to client: the play is over, and this is how the server's ground ended.
#[derive(Event, Resource, Clone, Copy, Serialize, Deserialize)]
struct PlayEnds {
    sequence: u64,
    hash: u128,
}

/// What this process is called in what it prints.
#[derive(Resource, Clone)]
struct Name(String);

/// Everything that servers and clients have in common: no window, no renderer, no GPU.
fn app(arguments: &Arguments) -> App {
    let mut app = App::new();
    let (assets, terrain) = kit::terrain(&kit::BATTLEFIELD, &arguments.for_kit());
    app.add_plugins((
        MinimalPlugins.set(ScheduleRunnerPlugin::run_loop(FRAME)),
        LogPlugin {
            level: Level::WARN,
            ..default()
        },
        AssetPlugin {
            file_path: assets,
            ..default()
        },
        // A server that is stopped tells its clients.
        TerminalCtrlCHandlerPlugin,
        TransformPlugin,
        StatesPlugin,
        TerrainPlugin,
    ))
    .add_plugins((RepliconPlugins, RepliconRenetPlugins, SharingPlugin))
    .add_server_event::<PlayEnds>(Channel::Ordered)
    .make_event_independent::<PlayEnds>()
    .insert_resource(kit::TerrainPath(terrain))
    .insert_resource(Name(arguments.name()))
    .add_systems(Startup, load)
    .add_systems(Update, report)
    .add_observer(give_up);
    app
}

fn load(mut commands: Commands, assets: Res<AssetServer>, path: Res<kit::TerrainPath>) {
    let terrain = commands.spawn(Terrain::new(assets.load(path.0.clone())));
    let terrain = terrain.id();
    commands.spawn(Terrain::wait_for(terrain, GROUND));
}

/// The last record of the terrain's log, and the hash of the ground as soon as all of it is resident.
fn ground(terrains: &Query<(&TerrainState, &TerrainEdits)>) -> Option<(u64, u128)> {
    let (state, edits) = terrains.single().ok()?;
    let sequence = edits.log().map(EditLog::last_sequence)?;
    Some((sequence, state.ground_hash(&GROUND)?))
}

/// Prints a line at once; `println!` panics where nobody reads any more.
fn say(name: &Name, text: &str) {
    let mut out = std::io::stdout().lock();
    let _ = writeln!(out, "{}: {text}", name.0);
    let _ = out.flush();
}

/// Prints the ground's hash before the first edit, and whenever there has been no edit for a second.
fn report(
    terrains: Query<(&TerrainState, &TerrainEdits)>,
    name: Res<Name>,
    mut seen: Local<Option<(u64, Instant)>>,
    mut reported: Local<Option<u64>>,
) {
    let log = terrains.single().ok().and_then(|(_, edits)| edits.log());
    let Some(sequence) = log.map(EditLog::last_sequence) else {
        return;
    };
    let since = match *seen {
        Some((seen, since)) if seen == sequence => since,
        _ => seen.insert((sequence, Instant::now())).1,
    };
    let is_quiet = sequence == 0 || since.elapsed() > Duration::from_secs(1);
    if *reported == Some(sequence) || !is_quiet {
        return;
    }
    if let Some((_, hash)) = ground(&terrains) {
        *reported = Some(sequence);
        say(&name, &format!("edit {sequence}, ground {hash:032x}"));
    }
}

/// Without a terrain there is no play; the log has said why.
fn give_up(_failed: On<TerrainFailed>, mut exit: MessageWriter<AppExit>) {
    exit.write(AppExit::error());
}

// What a server does.

/// How far the server's play is.
#[derive(Resource)]
struct Play {
    port: u16,
    clients: u32,
    started: Instant,
    is_open: bool,
    barrages: u32,
    ended: Option<Instant>,
}

/// How many requests have come from a client.
#[derive(Component, Default)]
struct Requests(u32);

fn serve(arguments: &Arguments) -> Result<AppExit, String> {
    let mut app = app(arguments);
    let port = arguments.port.unwrap_or(0);
    let port = sharing::host(&mut app, port).map_err(|error| {
        format!("port {port} can't be used: {error}; name another with --port, or none")
    })?;
    app.insert_resource(Play {
        port,
        clients: arguments.clients.unwrap_or(1),
        started: Instant::now(),
        is_open: false,
        barrages: 0,
        ended: None,
    })
    .register_required_components::<ConnectedClient, Requests>()
    .add_observer(count_requests)
    .add_systems(Update, (open, bombard, end, leave).chain().after(report));
    Ok(app.run())
}

/// Says where it can be found once the ground is there.
fn open(terrains: Query<(&TerrainState, &TerrainEdits)>, name: Res<Name>, mut play: ResMut<Play>) {
    if !play.is_open && ground(&terrains).is_some() {
        play.is_open = true;
        say(&name, &format!("listening on port {}", play.port));
    }
}

/// The server's own edits, as soon as somebody watches: some hundred craters, some taken back.
fn bombard(
    followers: Query<&Follower>,
    name: Res<Name>,
    mut play: ResMut<Play>,
    mut commands: Commands,
) {
    if !play.is_open || followers.is_empty() || play.barrages > BARRAGES {
        return;
    }
    play.barrages += 1;
    if play.barrages > BARRAGES {
        say(&name, "has made its craters");
        return;
    }
    let mut draw = Draw(play.barrages);
    for _ in 0..CRATERS_PER_BARRAGE {
        let at = draw.place();
        let radius_m = 2.0 + 8.0 * draw.next();
        commands.trigger(Crater::at(at).radius(radius_m).rough(0.4, draw.0));
    }
    if play.barrages.is_multiple_of(3) {
        commands.trigger(UndoEdit::default());
        commands.trigger(UndoEdit::default());
        commands.trigger(RedoEdit::default());
    }
}

fn count_requests(request: On<FromClient<EditRequest>>, mut clients: Query<&mut Requests>) {
    let client = request.client_id.entity();
    if let Some(mut requests) = client.and_then(|client| clients.get_mut(client).ok()) {
        requests.0 += 1;
    }
}

/// Ends the play when everyone has had their turn, and has all of the log.
fn end(
    clients: Query<(&Requests, &Follower)>,
    terrains: Query<(&TerrainState, &TerrainEdits)>,
    name: Res<Name>,
    mut play: ResMut<Play>,
    mut commands: Commands,
    mut exit: MessageWriter<AppExit>,
) {
    if play.clients == 0 || play.ended.is_some() {
        return;
    }
    if play.started.elapsed() > PLAY_AT_MOST {
        eprintln!(
            "{}: {} clients have not had their turn within {PLAY_AT_MOST:?}: ending without them",
            name.0, play.clients
        );
        exit.write(AppExit::error());
        return;
    }
    let log = terrains.single().ok().and_then(|(_, edits)| edits.log());
    let last = log.map_or(0, EditLog::last_sequence);
    let is_done = |(requests, follower): &(&Requests, &Follower)| {
        requests.0 >= CLIENT_REQUESTS && follower.known == last
    };
    let done = clients.iter().filter(is_done).count();
    if play.barrages <= BARRAGES || done < play.clients as usize {
        return;
    }
    let Some((sequence, hash)) = ground(&terrains) else {
        return;
    };
    play.ended = Some(Instant::now());
    say(&name, &ending(sequence, hash));
    commands.server_trigger(ToClients {
        targets: SendTargets::CLIENTS_ONLY,
        message: PlayEnds { sequence, hash },
    });
}

/// The line that the play is judged by.
fn ending(sequence: u64, hash: u128) -> String {
    format!("ends with edit {sequence}, ground {hash:032x}")
}

fn leave(
    clients: Query<(), With<ConnectedClient>>,
    play: Res<Play>,
    mut exit: MessageWriter<AppExit>,
) {
    let Some(ended) = play.ended else {
        return;
    };
    if clients.is_empty() || ended.elapsed() > LEAVE_AT_MOST {
        exit.write(AppExit::Success);
    }
}

// What a client does.

/// How far a client's play is.
#[derive(Resource)]
struct Turn {
    /// Since when it has been looking for the server, until it has found it.
    connecting: Option<Instant>,
    has_joined: bool,
    requests: u32,
    next: Instant,
}

fn follow(arguments: &Arguments) -> Result<AppExit, String> {
    let port = arguments.port.filter(|&port| port != 0);
    let port = port.ok_or("a client needs --port N: the server prints it")?;
    let mut app = app(arguments);
    let server = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
    sharing::join(&mut app, server).map_err(|error| format!("no socket can be opened: {error}"))?;
    app.insert_resource(Turn {
        connecting: Some(Instant::now()),
        has_joined: false,
        requests: 0,
        next: Instant::now(),
    })
    .add_observer(|ends: On<PlayEnds>, mut commands: Commands| {
        commands.insert_resource(*ends.event());
    })
    .add_observer(tell_failed)
    .add_systems(
        Update,
        (
            wait.run_if(not(in_state(ClientState::Connected))),
            ask.run_if(in_state(ClientState::Connected)),
            compare.run_if(resource_exists::<PlayEnds>),
        )
            .chain()
            .after(report),
    )
    .add_systems(OnExit(ClientState::Connected), tell_lost);
    Ok(app.run())
}

fn wait(name: Res<Name>, turn: Res<Turn>, mut exit: MessageWriter<AppExit>) {
    let since = turn.connecting;
    if since.is_some_and(|since| since.elapsed() > CONNECT_AT_MOST) {
        eprintln!(
            "{}: no server has answered for {CONNECT_AT_MOST:?}: start one with --role server, and \
             name the port that it prints",
            name.0
        );
        exit.write(AppExit::error());
    }
}

fn tell_lost(name: Res<Name>, ends: Option<Res<PlayEnds>>, mut exit: MessageWriter<AppExit>) {
    if ends.is_none() {
        eprintln!("{}: the server has gone before the play was over", name.0);
        exit.write(AppExit::error());
    }
}

fn tell_failed(failed: On<SharingFailed>, name: Res<Name>, mut exit: MessageWriter<AppExit>) {
    eprintln!(
        "{}: the server's edits can't be followed: {}",
        name.0, failed.reason
    );
    exit.write(AppExit::error());
}

/// Has its turn as soon as it has what the server had: some craters; one is taken back, and another
/// is taken back and made again.
fn ask(
    following: Res<Following>,
    terrains: Query<&TerrainEdits>,
    name: Res<Name>,
    mut turn: ResMut<Turn>,
    mut commands: Commands,
) {
    turn.connecting = None;
    if !following.is_caught_up || turn.requests >= CLIENT_REQUESTS || Instant::now() < turn.next {
        return;
    }
    if !turn.has_joined {
        turn.has_joined = true;
        let log = terrains.single().ok().and_then(TerrainEdits::log);
        let records = log.map_or(0, EditLog::len);
        let parts = match following.parts {
            1 => "one part".to_owned(),
            parts => format!("{parts} parts"),
        };
        say(&name, &format!("joined with {records} edits in {parts}"));
    }
    match turn.requests {
        3 => commands.client_trigger(EditRequest::Undo),
        5 => {
            // Sent together: what was taken back can't be made again once somebody else has made
            // an edit.
            commands.client_trigger(EditRequest::Undo);
            commands.client_trigger(EditRequest::Redo);
            turn.requests += 1;
        }
        number => {
            let seed = number ^ std::process::id();
            let mut draw = Draw(seed);
            commands.client_trigger(EditRequest::Crater {
                at: draw.place().into(),
                radius_m: 12.0,
                seed,
            });
        }
    }
    turn.requests += 1;
    turn.next = Instant::now() + Duration::from_millis(50);
}

/// The server is right by definition: a client whose ground differs says so, and fails.
fn compare(
    ends: Res<PlayEnds>,
    terrains: Query<(&TerrainState, &TerrainEdits)>,
    name: Res<Name>,
    mut waits: Local<Option<Instant>>,
    mut exit: MessageWriter<AppExit>,
) {
    let since = *waits.get_or_insert_with(Instant::now);
    // Some ground may still be streaming in.
    let Some((sequence, hash)) = ground(&terrains) else {
        if since.elapsed() > PLAY_AT_MOST {
            eprintln!("{}: its ground has not streamed in", name.0);
            exit.write(AppExit::error());
        }
        return;
    };
    say(&name, &ending(sequence, hash));
    exit.write(if (sequence, hash) == (ends.sequence, ends.hash) {
        AppExit::Success
    } else {
        eprintln!("{}: its ground is not the server's", name.0);
        AppExit::error()
    });
}

/// Numbers that look random.
struct Draw(u32);

impl Draw {
    /// From 0 to 1.
    fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (self.0 >> 8) as f32 / (1 << 24) as f32
    }

    /// Somewhere on the bundled terrain.
    fn place(&mut self) -> Vec3 {
        let x = 20.0 + 960.0 * self.next();
        Vec3::new(x, 40.0, 20.0 + 1000.0 * self.next())
    }
}

// All in one command.

/// Processes that don't outlive this one.
#[derive(Default)]
struct Processes(Vec<(String, Child)>);

impl Drop for Processes {
    fn drop(&mut self) {
        for (_, process) in &mut self.0 {
            // One that has ended by itself can't be ended any more, and needn't.
            let _ = process.kill();
            let _ = process.wait();
        }
    }
}

impl Processes {
    /// Starts this program in another role; what it prints is sent to `lines`, and nothing more than
    /// `None` when it prints no more.
    fn start(
        &mut self,
        name: &str,
        words: &[&str],
        terrain: Option<&PathBuf>,
        lines: &Sender<(String, Option<String>)>,
    ) -> Result<(), String> {
        let failed = |error| format!("{name} can't be started: {error}");
        let program = std::env::current_exe().map_err(failed)?;
        let mut command = Command::new(program);
        command.args(["--name", name]).args(words);
        if let Some(terrain) = terrain {
            command.arg("--terrain").arg(terrain);
        }
        let mut process = command.stdout(Stdio::piped()).spawn().map_err(failed)?;
        let stdout = process.stdout.take();
        self.0.push((name.to_owned(), process));
        let (name, lines) = (name.to_owned(), lines.clone());
        std::thread::spawn(move || {
            for line in stdout
                .into_iter()
                .flat_map(|out| BufReader::new(out).lines())
            {
                let Ok(line) = line else { break };
                let _ = lines.send((name.clone(), Some(line)));
            }
            let _ = lines.send((name, None));
        });
        Ok(())
    }

    /// Waits for a process that prints no more.
    fn finish(&mut self, name: &str) -> Result<(), String> {
        let process = self.0.iter_mut().find(|(of, _)| of == name);
        let ended = process.map(|(_, process)| process.wait());
        match ended {
            Some(Ok(status)) if status.success() => Ok(()),
            Some(Ok(status)) => Err(format!("{name} has failed ({status})")),
            Some(Err(error)) => Err(format!("{name} can't be waited for: {error}")),
            None => Ok(()),
        }
    }
}

fn play(arguments: &Arguments) -> Result<AppExit, String> {
    // Baked once, rather than by three processes at the same time.
    kit::terrain(&kit::BATTLEFIELD, &arguments.for_kit());
    let deadline = Instant::now() + PLAY_AT_MOST + LEAVE_AT_MOST;
    let (sender, lines) = channel();
    let mut processes = Processes::default();
    let terrain = arguments.terrain.as_ref();
    let port = arguments.port.unwrap_or(0).to_string();
    let server = ["--role", "server", "--clients", "2", "--port", &port];
    processes.start("server", &server, terrain, &sender)?;
    let mut port = String::new();
    let mut before = None;
    let mut endings = Vec::new();
    let mut running = 1;
    while running > 0 {
        let (name, line) = next_line(&lines, deadline)?;
        let Some(line) = line else {
            running -= 1;
            processes.finish(&name)?;
            continue;
        };
        say(&Name("play".to_owned()), &line);
        let said = line.strip_prefix(&format!("{name}: ")).unwrap_or(&line);
        if let Some(ground) = said.strip_prefix("edit 0, ") {
            before.get_or_insert_with(|| ground.to_owned());
        } else if let Some(ending) = said.strip_prefix("ends with ") {
            endings.push(ending.to_owned());
        } else if let Some(said) = said.strip_prefix("listening on port ") {
            said.clone_into(&mut port);
            let client = ["--role", "client", "--port", &port];
            processes.start("client", &client, terrain, &sender)?;
            running += 1;
        } else if said == "has made its craters" {
            let client = ["--role", "client", "--port", &port];
            processes.start("late joiner", &client, terrain, &sender)?;
            running += 1;
        }
    }
    let [first, others @ ..] = &endings[..] else {
        return Err("nobody has come to an end".to_owned());
    };
    if endings.len() != 3 || others.iter().any(|other| other != first) {
        return Err(format!("the grounds differ: {}", endings.join("; ")));
    }
    if before.is_none_or(|before| first.ends_with(&before)) {
        return Err("the ground is as it was before".to_owned());
    }
    println!("all three have the same ground: {first}");
    Ok(AppExit::Success)
}

fn next_line(
    lines: &Receiver<(String, Option<String>)>,
    deadline: Instant,
) -> Result<(String, Option<String>), String> {
    let left = deadline.saturating_duration_since(Instant::now());
    lines.recv_timeout(left).map_err(|error| match error {
        RecvTimeoutError::Timeout => "it has taken too long".to_owned(),
        RecvTimeoutError::Disconnected => "all processes have gone".to_owned(),
    })
}

// The command line.

#[derive(Clone, Copy)]
enum Role {
    Server,
    Client,
}

#[derive(Default)]
struct Arguments {
    role: Option<Role>,
    port: Option<u16>,
    clients: Option<u32>,
    name: Option<String>,
    terrain: Option<PathBuf>,
}

impl Arguments {
    fn from_words(mut words: impl Iterator<Item = String>) -> Result<Option<Self>, String> {
        let mut arguments = Self::default();
        while let Some(word) = words.next() {
            let mut value = || {
                words
                    .next()
                    .ok_or_else(|| format!("{word} needs a value after it"))
            };
            match word.as_str() {
                "--role" => {
                    arguments.role = Some(match value()?.as_str() {
                        "server" => Role::Server,
                        "client" => Role::Client,
                        other => return Err(format!("--role is {other}: write server or client")),
                    });
                }
                "--port" => arguments.port = Some(number(&word, &value()?)?),
                "--clients" => arguments.clients = Some(number(&word, &value()?)?),
                "--name" => arguments.name = Some(value()?),
                "--terrain" => {
                    let folder = PathBuf::from(value()?);
                    if !folder.join("terrain.ron").exists() {
                        return Err(format!(
                            "{} holds no terrain.ron: name a folder that `tessera bake` wrote",
                            folder.display()
                        ));
                    }
                    arguments.terrain = Some(folder);
                }
                "--headless" => {}
                "--help" | "-h" => return Ok(None),
                _ => return Err(format!("{word} is no option")),
            }
        }
        Ok(Some(arguments))
    }

    fn name(&self) -> String {
        let role = match self.role {
            None => "play",
            Some(Role::Server) => "server",
            Some(Role::Client) => "client",
        };
        self.name.clone().unwrap_or_else(|| role.to_owned())
    }

    fn for_kit(&self) -> kit::Arguments {
        kit::Arguments {
            terrain: self.terrain.clone(),
            ..default()
        }
    }
}

fn number<T: std::str::FromStr>(option: &str, text: &str) -> Result<T, String> {
    text.parse()
        .map_err(|_| format!("{option} is {text}: write a number that fits"))
}
