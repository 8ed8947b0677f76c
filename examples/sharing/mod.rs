//! Edits that a server and its clients share, over `bevy_replicon`; to be copied into games.
//!
//! The server makes all edits, and its log decides their order. Clients ask for edits, are sent what
//! the log has more than theirs, and [merge](MergeEdits) it: the same log makes the same ground on
//! every machine, to the bit, so nothing but the log has to travel.
//!
//! A client says how far it is ([`EditsKnown`]) when it joins, and after everything that it was sent.
//! The server sends it the next part then ([`EditNews`]), and never two at once. So whoever joins late
//! gets the whole log in parts, whoever is slow gets larger parts less often, and no queue grows.

use bevy::prelude::*;
use bevy_replicon::prelude::*;
use bevy_replicon_renet::netcode::{
    ClientAuthentication, NetcodeClientTransport, NetcodeServerTransport, ServerAuthentication,
    ServerConfig,
};
use bevy_replicon_renet::renet::ConnectionConfig;
use bevy_replicon_renet::{RenetChannelsExt, RenetClient, RenetServer};
use bevy_tessera::edit::{
    Crater, EditDiff, EditLog, MergeEdits, RedoEdit, TerrainEditRefused, TerrainEdits, UndoEdit,
};
use bevy_tessera::stream::TerrainState;
use serde::{Deserialize, Serialize};
use std::error::Error;
use std::net::{Ipv4Addr, SocketAddr, UdpSocket};
use std::time::SystemTime;

/// Records in a message at most...
const PART_RECORDS: usize = 256;
/// ...and bytes, but for one record that is larger: an image stamp may take some megabytes. Renet
/// ends connections on which more than 5 MB wait in a channel.
const PART_BYTES: usize = 64 * 1024;
/// What the two sides of a connection must agree on.
const PROTOCOL: u64 = 0x7465_7373_6572_6101;
const MOST_CLIENTS: usize = 16;

/// Client to server: changes that it wants to see on the ground. Metres of the world.
#[derive(Event, Clone, Debug, Serialize, Deserialize)]
pub enum EditRequest {
    Crater {
        at: [f32; 3],
        radius_m: f32,
        seed: u32,
    },
    /// Takes the newest edit back, whoever asked for it.
    Undo,
    /// Makes the one again that was taken back last.
    Redo,
}

/// Client to server: the last record that its log has.
#[derive(Event, Clone, Copy, Debug, Serialize, Deserialize)]
pub struct EditsKnown {
    pub sequence: u64,
    /// Whether an answer is wanted although there may be nothing new: on joining, and where
    /// something went wrong.
    pub asks: bool,
}

/// Server to client: what comes next in the log.
#[derive(Event, Clone, Debug, Serialize, Deserialize)]
pub struct EditNews {
    pub diff: EditDiff,
    /// The last record that the server has, for progress bars.
    pub last: u64,
    /// The client knows more than the server, one that was set back for example: it has to drop what
    /// it has.
    pub starts_over: bool,
}

/// On a client: its ground can't follow the server's.
#[derive(Event, Clone, Debug)]
pub struct SharingFailed {
    pub reason: String,
}

/// On the server, on every client that follows its edits.
#[derive(Component, Debug)]
pub struct Follower {
    /// The last record that the client says it has.
    pub known: u64,
    /// It has been sent a part, and hasn't answered yet.
    is_busy: bool,
    asks: bool,
}

/// On a client: how far it has come.
#[derive(Resource, Debug, Default)]
pub struct Following {
    /// Whether it has, or has had, everything that the server had.
    pub is_caught_up: bool,
    /// Messages with edits since it joined.
    pub parts: u32,
    has_asked: bool,
    /// How often in a row the log has refused what the server sent, and why it did.
    refusals: u32,
    reason: String,
}

/// A [`MergeEdits`] has been answered; the log should end here or later now.
#[derive(Event)]
struct Merged {
    until: u64,
    last: u64,
}

/// For servers and clients alike: what a process is follows from whether it [hosts](host) or
/// [joins](join). Needs `RepliconPlugins`, and one terrain.
pub struct SharingPlugin;

impl Plugin for SharingPlugin {
    fn build(&self, app: &mut App) {
        app.init_resource::<Following>()
            .add_client_event::<EditRequest>(Channel::Ordered)
            .add_client_event::<EditsKnown>(Channel::Ordered)
            .add_server_event::<EditNews>(Channel::Ordered)
            // Edits name no entities, and so needn't wait for any that are replicated.
            .make_event_independent::<EditNews>()
            .add_observer(edit_on_request)
            .add_observer(remember_follower)
            .add_observer(merge_news)
            .add_observer(remember_refusal)
            .add_observer(answer)
            .add_systems(
                PostUpdate,
                (
                    send_news
                        .before(ServerSystems::Send)
                        .run_if(in_state(ServerState::Running)),
                    ask_first
                        .before(ClientSystems::Send)
                        .run_if(in_state(ClientState::Connected)),
                ),
            )
            .add_systems(OnExit(ClientState::Connected), forget);
    }
}

/// The server's log is the only one that grows by commands. A game asks its rules here whether this
/// player may do that, and how often; numbers that make no crater are refused by the command.
fn edit_on_request(request: On<FromClient<EditRequest>>, mut commands: Commands) {
    match request.message {
        EditRequest::Crater { at, radius_m, seed } => {
            let crater = Crater::at(at.into()).radius(radius_m).rough(0.4, seed);
            commands.trigger(crater);
        }
        EditRequest::Undo => commands.trigger(UndoEdit::default()),
        EditRequest::Redo => commands.trigger(RedoEdit::default()),
    }
}

fn remember_follower(known: On<FromClient<EditsKnown>>, mut commands: Commands) {
    if let Some(client) = known.client_id.entity() {
        commands.entity(client).try_insert(Follower {
            known: known.sequence,
            is_busy: false,
            asks: known.asks,
        });
    }
}

fn send_news(
    mut followers: Query<(Entity, &mut Follower)>,
    terrains: Query<&TerrainEdits>,
    mut commands: Commands,
) {
    let Some(log) = terrains.single().ok().and_then(TerrainEdits::log) else {
        return;
    };
    let last = log.last_sequence();
    for (client, mut follower) in &mut followers {
        if follower.is_busy || (follower.known == last && !follower.asks) {
            continue;
        }
        let starts_over = follower.known > last;
        let since = match (starts_over, follower.asks) {
            (true, _) => 0,
            // With a record that the client has: if its own is another, the logs have parted, and
            // merging says so.
            (false, true) => follower.known.saturating_sub(1),
            (false, false) => follower.known,
        };
        follower.is_busy = true;
        follower.asks = false;
        commands.server_trigger(ToClients {
            targets: SendTargets::Single(client.into()),
            message: EditNews {
                diff: part(log, since),
                last,
                starts_over,
            },
        });
    }
}

/// What comes after a record, as much as a message should hold, and one record at least.
fn part(log: &EditLog, since: u64) -> EditDiff {
    let after = &log.records()[since as usize..];
    let mut count = after.len().min(PART_RECORDS);
    loop {
        let diff = EditDiff {
            stamp: log.stamp(),
            since,
            ops: after[..count].iter().map(|it| it.op.clone()).collect(),
        };
        let bytes = postcard::to_stdvec(&diff).map_or(0, |bytes| bytes.len());
        if bytes <= PART_BYTES || count <= 1 {
            return diff;
        }
        count /= 2;
    }
}

/// Joins as soon as there is a log that could grow.
fn ask_first(
    terrains: Query<&TerrainEdits>,
    mut following: ResMut<Following>,
    mut commands: Commands,
) {
    let log = terrains.single().ok().and_then(TerrainEdits::log);
    let Some(log) = log.filter(|_| !following.has_asked) else {
        return;
    };
    following.has_asked = true;
    commands.client_trigger(EditsKnown {
        sequence: log.last_sequence(),
        asks: true,
    });
}

fn forget(mut following: ResMut<Following>) {
    *following = Following::default();
}

fn merge_news(
    news: On<EditNews>,
    terrains: Query<(Entity, &TerrainState), With<TerrainEdits>>,
    mut following: ResMut<Following>,
    mut commands: Commands,
) {
    let Ok((terrain, state)) = terrains.single() else {
        // Once there is one again, it asks.
        following.has_asked = false;
        return;
    };
    following.parts += 1;
    following.reason.clear();
    if news.starts_over {
        let log = EditLog::new(&state.manifest().file);
        commands.entity(terrain).insert(TerrainEdits::new(log));
    }
    let diff = news.diff.clone();
    let until = diff.since + diff.ops.len() as u64;
    commands.trigger(MergeEdits {
        terrain: Some(terrain),
        diff,
    });
    commands.trigger(Merged {
        until,
        last: news.last,
    });
}

fn remember_refusal(refused: On<TerrainEditRefused>, mut following: ResMut<Following>) {
    following.reason.clone_from(&refused.reason);
}

/// Says how far the log is now, and gets it back on its feet where it isn't as far as it should be.
fn answer(
    merged: On<Merged>,
    mut terrains: Query<(&mut TerrainEdits, &TerrainState)>,
    mut following: ResMut<Following>,
    mut commands: Commands,
) {
    let Ok((mut edits, state)) = terrains.single_mut() else {
        return;
    };
    let sequence = edits.log().map_or(0, EditLog::last_sequence);
    if sequence >= merged.until && following.reason.is_empty() {
        following.refusals = 0;
        following.is_caught_up |= sequence >= merged.last;
        commands.client_trigger(EditsKnown {
            sequence,
            asks: false,
        });
        return;
    }
    following.refusals += 1;
    let reason = std::mem::take(&mut following.reason);
    match following.refusals {
        // Perhaps something was missing in between: once more, from the log's own end.
        1 => commands.client_trigger(EditsKnown {
            sequence,
            asks: true,
        }),
        // Perhaps the logs have parted: the server's takes the place of this one.
        2 => {
            *edits = TerrainEdits::new(EditLog::new(&state.manifest().file));
            commands.client_trigger(EditsKnown {
                sequence: 0,
                asks: true,
            });
        }
        _ => commands.trigger(SharingFailed { reason }),
    }
}

/// Makes this process the server, on a UDP port of this machine, and returns the port; 0 asks for
/// any that is free. To be called after everything that is sent has been registered.
///
/// Loopback and no encryption: on the internet, bind `Ipv4Addr::UNSPECIFIED` and use
/// `ServerAuthentication::Secure`.
pub fn host(app: &mut App, port: u16) -> Result<u16, Box<dyn Error>> {
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, port))?;
    let port = socket.local_addr()?.port();
    let config = ServerConfig {
        current_time: SystemTime::now().duration_since(SystemTime::UNIX_EPOCH)?,
        max_clients: MOST_CLIENTS,
        protocol_id: PROTOCOL,
        authentication: ServerAuthentication::Unsecure,
        public_addresses: Vec::new(),
    };
    let transport = NetcodeServerTransport::new(config, socket)?;
    let server = RenetServer::new(connection(app));
    app.insert_resource(server).insert_resource(transport);
    Ok(port)
}

/// Makes this process a client of a server. To be called after everything that is sent has been
/// registered, in the same order as on the server.
pub fn join(app: &mut App, server: SocketAddr) -> Result<(), Box<dyn Error>> {
    let now = SystemTime::now().duration_since(SystemTime::UNIX_EPOCH)?;
    let authentication = ClientAuthentication::Unsecure {
        // Several processes may start at the same time.
        client_id: now.as_nanos() as u64 ^ (u64::from(std::process::id()) << 40),
        protocol_id: PROTOCOL,
        server_addr: server,
        user_data: None,
    };
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
    let transport = NetcodeClientTransport::new(now, authentication, socket)?;
    let client = RenetClient::new(connection(app));
    app.insert_resource(client).insert_resource(transport);
    Ok(())
}

fn connection(app: &App) -> ConnectionConfig {
    let channels = app.world().resource::<RepliconChannels>();
    ConnectionConfig {
        server_channels_config: channels.server_configs(),
        client_channels_config: channels.client_configs(),
        ..default()
    }
}
