//! `share foxglove://…`: the board for Foxglove, over its WebSocket protocol.
//!
//! <https://github.com/foxglove/ws-protocol>: the server tells its channels in JSON, a client subscribes to
//! some of them, and gets their messages in binary. Clients cannot publish, call or set anything.

use std::collections::BTreeMap;
use std::net::SocketAddr;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use serde::Deserialize;
use serde_json::json;
use tesaki::model::RobotModel;
use tesaki::protocol::{FromBoard, Request, Status, Telemetry};
use tesaki_description::robot::RobotFolder;
use tesaki_recording::{Live, LiveMessage, McapError, Publisher};
use tesaki_supervisor::Board as _;
use tesaki_supervisor::faults::{FaultFollower, describe};
use tesaki_supervisor::publication::{Publication, STREAMS, require_own};
use tesaki_supervisor::timing::SILENCE;
use tesaki_supervisor::words;
use tesaki_viewer::server::{Event, Server, Site};
use tungstenite::Message;

use crate::args::Options;
use crate::board_session::{BoardSession, interrupted};
use crate::failure::Failure;
use crate::model::urdf_text;
use crate::output;

/// How long the board is listened to before the clients are served, and the other way round.
const TURN: Duration = Duration::from_millis(5);
/// Without clients.
const IDLE: Duration = Duration::from_millis(20);
/// A message of a channel, in front of subscription, time and data.
const MESSAGE_DATA: u8 = 1;

const INDEX: &str = "<!doctype html><meta charset=utf-8><title>tesaki</title><p>This is for Foxglove: <em>Open \
                     connection</em>, <em>Foxglove WebSocket</em>, with this address behind <code>ws://</code>.\n";

static SITE: Site = Site {
    files: &[("/", "text/html; charset=utf-8", INDEX)],
    socket: "/",
    protocols: &["foxglove.sdk.v1", "foxglove.websocket.v1"],
    // Foxglove in a browser, and viewers that are served on this machine. They only look.
    origins: &["https://app.foxglove.dev", "http://localhost:", "http://127.0.0.1:"],
    name: "a board to Foxglove",
    choose: ": another program listens there; choose another port, as in foxglove://localhost:8766",
};

/// What a client says. Of channels that it should not have, it is told.
#[derive(Deserialize)]
#[serde(tag = "op", rename_all = "camelCase")]
enum Said {
    Subscribe {
        subscriptions: Vec<Subscription>,
    },
    #[serde(rename_all = "camelCase")]
    Unsubscribe {
        subscription_ids: Vec<u32>,
    },
    #[serde(other)]
    Other,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Subscription {
    id: u32,
    channel_id: u16,
}

/// A client.
#[derive(Default)]
struct Client {
    /// Channels that it knows, from the first on.
    told: usize,
    /// Channel of each of its subscriptions.
    subscriptions: BTreeMap<u32, u16>,
}

struct Share {
    session: BoardSession,
    server: Server,
    clients: BTreeMap<u64, Client>,
    publication: Publication<Live>,
    model: Option<(RobotModel, u32)>,
    faults: Option<FaultFollower>,
    /// Whether the streams are requested, and when telemetry came last.
    streams: bool,
    heard: Instant,
    /// Whether the clients know that it does not come.
    is_silent: bool,
}

pub fn share(options: &Options, listen: SocketAddr, robot: Option<&Path>) -> Result<(), Failure> {
    let interrupted = interrupted()?;
    let folder = robot.map(RobotFolder::load).transpose()?;
    let urdf = folder.as_ref().map(urdf_text).transpose()?;
    let server = Server::listen(listen, &SITE).map_err(|error| match error.kind() {
        std::io::ErrorKind::InvalidInput => Failure::Usage(error.to_string()),
        _ => Failure::Other(error.to_string()),
    })?;
    let mut session = BoardSession::open(options)?;
    match session.model() {
        Ok(model) => require_own(folder.as_ref(), &model)?,
        // One may be pushed later.
        Err(Failure::NoModel) => {}
        Err(failure) => return Err(failure),
    }
    let url = format!("ws://{}", server.address());
    let publisher = Publisher::new(Live::default(), urdf.as_deref());
    let mut share = Share {
        session,
        server,
        clients: BTreeMap::new(),
        publication: Publication::new(publisher, folder),
        model: None,
        faults: None,
        streams: false,
        heard: Instant::now(),
        is_silent: false,
    };
    output::result(options, &json!({ "url": url }), || {
        format!("{url}\nfor Foxglove: Open connection, Foxglove WebSocket. Ctrl-C stops sharing")
    })?;
    while !interrupted.load(Ordering::Relaxed) {
        share.turn()?;
    }
    if share.streams {
        share.request_streams(false)?;
    }
    Ok(())
}

impl Share {
    fn turn(&mut self) -> Result<(), Failure> {
        if self.streams == self.clients.is_empty() {
            self.request_streams(!self.streams)?;
        }
        let deadline = Instant::now() + if self.clients.is_empty() { IDLE } else { TURN };
        while let Some(event) = self.session.board.next_event(deadline)? {
            self.take(event)?;
        }
        for event in self.server.turn() {
            match event {
                Event::Opened(id) => self.greet(id),
                Event::Said(id, text) => self.obey(id, &text),
                Event::Closed(id) => {
                    self.clients.remove(&id);
                }
            }
        }
        self.send();
        if self.streams && self.heard.elapsed() > SILENCE {
            if !std::mem::replace(&mut self.is_silent, true) {
                let text = words::silence(self.session.is_open());
                self.clients.keys().for_each(|&id| warn(&mut self.server, id, text));
            }
            self.session.board.reconnect(STREAMS)?;
            self.heard = Instant::now();
        }
        Ok(())
    }

    fn request_streams(&mut self, requested: bool) -> Result<(), Failure> {
        for &(stream, every) in STREAMS {
            let every = if requested { every } else { 0 };
            self.session.board.post(Request::SetRate { stream, every })?;
        }
        (self.streams, self.heard, self.is_silent) = (requested, Instant::now(), false);
        Ok(())
    }

    fn take(&mut self, event: FromBoard) -> Result<(), Failure> {
        match event {
            FromBoard::Telemetry(telemetry) => self.telemetry(&telemetry)?,
            FromBoard::Tips(tips) => self.publication.tips(&tips).map_err(failure)?,
            FromBoard::Task(task) => self.publication.task(&task).map_err(failure)?,
            FromBoard::Status(status) => {
                self.read_model(&status)?;
                self.publication.status(&status).map_err(failure)?;
            }
            FromBoard::Reply(_) | FromBoard::Log(_) => {}
        }
        Ok(())
    }

    fn telemetry(&mut self, telemetry: &Telemetry) -> Result<(), Failure> {
        (self.heard, self.is_silent) = (Instant::now(), false);
        self.publication.telemetry(telemetry).map_err(failure)?;
        let faults = self.faults.get_or_insert_with(|| FaultFollower::new(telemetry.into()));
        if faults.is_due(telemetry) {
            let model = self.model.as_ref().map(|(model, _)| model);
            // Without an answer, the number says so again with the next telemetry.
            let Ok(log) = self.session.board.faults() else { return Ok(()) };
            for fault in faults.take(telemetry, &log) {
                self.publication.fault(telemetry.tick, &describe(fault, model)).map_err(failure)?;
            }
        }
        Ok(())
    }

    fn read_model(&mut self, status: &Status) -> Result<(), Failure> {
        self.session.board.update_model(&mut self.model, status)?;
        if let Some((model, _)) = &self.model {
            self.publication.require_own(model)?;
        }
        self.publication.use_model(self.model.as_ref().map(|(model, checksum)| (model, *checksum)));
        Ok(())
    }

    fn greet(&mut self, id: u64) {
        self.clients.insert(id, Client::default());
        let info = json!({
            "op": "serverInfo",
            "name": format!("tesaki {}", self.session.port),
            "capabilities": [],
            "supportedEncodings": ["cdr"],
            "metadata": { "ROS_DISTRO": "jazzy" },
        });
        self.server.send(id, info.to_string());
    }

    fn obey(&mut self, id: u64, text: &str) {
        let Some(client) = self.clients.get_mut(&id) else { return };
        match serde_json::from_str(text) {
            Ok(Said::Subscribe { subscriptions }) => {
                for Subscription { id: subscription, channel_id } in subscriptions {
                    if usize::from(channel_id) >= client.told {
                        warn(&mut self.server, id, &format!("there is no channel {channel_id}"));
                        continue;
                    }
                    client.subscriptions.insert(subscription, channel_id);
                    if let Some(message) = self.publication.publisher.sink().kept(channel_id) {
                        self.server.send(id, framed(subscription, message));
                    }
                }
            }
            Ok(Said::Unsubscribe { subscription_ids }) => {
                client.subscriptions.retain(|subscription, _| !subscription_ids.contains(subscription));
            }
            Ok(Said::Other) => warn(&mut self.server, id, "this board can only be looked at"),
            Err(error) => warn(&mut self.server, id, &format!("not understood: {error}")),
        }
    }

    /// Sends new channels and new messages.
    fn send(&mut self) {
        let live = self.publication.publisher.sink_mut();
        let messages = live.take();
        for (&id, client) in &mut self.clients {
            let channels: Vec<_> = (client.told..)
                .zip(live.topics().iter().skip(client.told))
                .map(|(id, topic)| {
                    json!({
                        "id": id,
                        "topic": topic.name,
                        "encoding": "cdr",
                        "schemaName": topic.schema,
                        "schema": topic.definition,
                        "schemaEncoding": "ros2msg",
                    })
                })
                .collect();
            if !channels.is_empty() {
                client.told = live.topics().len();
                self.server.send(id, json!({ "op": "advertise", "channels": channels }).to_string());
            }
            for message in &messages {
                for (&subscription, _) in
                    client.subscriptions.iter().filter(|(_, topic)| **topic == message.topic)
                {
                    self.server.send(id, framed(subscription, message));
                }
            }
        }
    }
}

/// A message as it goes to a subscriber.
fn framed(subscription: u32, message: &LiveMessage) -> Message {
    let mut bytes = vec![MESSAGE_DATA];
    bytes.extend(subscription.to_le_bytes());
    bytes.extend(message.time.to_le_bytes());
    bytes.extend(&message.data);
    Message::binary(bytes)
}

/// Tells a client what is wrong.
fn warn(server: &mut Server, id: u64, text: &str) {
    server.send(id, json!({ "op": "status", "level": 1, "message": text }).to_string());
}

fn failure(error: McapError) -> Failure {
    Failure::Other(error.to_string())
}
