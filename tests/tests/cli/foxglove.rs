//! `tesaki share foxglove://…` seen by a client of Foxglove's protocol.

use std::collections::BTreeMap;
use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::net::TcpStream;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use serde_json::{Value, json};
use tungstenite::protocol::{Role, WebSocket};
use tungstenite::{Error, Message};

use super::server::{Server, arm7, hand3, signal};

struct Share {
    child: Child,
    host: String,
}

impl Share {
    fn start(server: &Server) -> Self {
        let folder = hand3();
        let arguments = ["share", "foxglove://localhost:0", "--robot", folder.to_str().unwrap()];
        let mut command = server.command(&arguments);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
        let mut line = String::new();
        BufReader::new(child.stdout.as_mut().unwrap()).read_line(&mut line).unwrap();
        let host = line.trim().strip_prefix("ws://").unwrap_or_else(|| panic!("{line}")).to_owned();
        Self { child, host }
    }

    /// Returns the head of the answer to a handshake, and the connection.
    fn dial(&self, headers: &str) -> (String, TcpStream) {
        let mut stream = TcpStream::connect(&self.host).unwrap();
        stream.set_read_timeout(Some(Duration::from_millis(200))).unwrap();
        let request = format!(
            "GET / HTTP/1.1\r\nHost: {}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\n\
             Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n{headers}\r\n",
            self.host
        );
        stream.write_all(request.as_bytes()).unwrap();
        let (mut head, deadline) = (Vec::new(), Instant::now() + Duration::from_secs(5));
        while !head.ends_with(b"\r\n\r\n") {
            let mut byte = [0];
            if stream.read(&mut byte).is_ok_and(|length| length == 1) {
                head.push(byte[0]);
            }
            assert!(Instant::now() < deadline, "no answer: {}", String::from_utf8_lossy(&head));
        }
        (String::from_utf8(head).unwrap(), stream)
    }

    fn open(&self) -> Client {
        let (head, stream) = self.dial("Sec-WebSocket-Protocol: foxglove.websocket.v1\r\n");
        assert!(head.contains(" 101 ") && head.contains("Protocol: foxglove.websocket.v1"), "{head}");
        Client { socket: WebSocket::from_raw_socket(stream, Role::Client, None), channels: BTreeMap::new() }
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        signal(&self.child, nix::sys::signal::Signal::SIGINT);
        let _ = self.child.wait();
    }
}

struct Client {
    socket: WebSocket<TcpStream>,
    /// Advertised channels, by topic.
    channels: BTreeMap<String, Value>,
}

impl Client {
    fn send(&mut self, value: &Value) {
        self.socket.send(Message::text(value.to_string())).unwrap();
    }

    /// Returns the next message in JSON (with `None`), or of a subscription: its time and its CDR.
    #[track_caller]
    fn next(&mut self, subscription: Option<u32>) -> (Value, u64, Vec<u8>) {
        let deadline = Instant::now() + Duration::from_secs(8);
        while Instant::now() < deadline {
            match self.socket.read() {
                Ok(Message::Text(text)) => {
                    let value: Value = serde_json::from_str(&text).unwrap();
                    for channel in value["channels"].as_array().into_iter().flatten() {
                        self.channels.insert(channel["topic"].as_str().unwrap().to_owned(), channel.clone());
                    }
                    if subscription.is_none() {
                        return (value, 0, Vec::new());
                    }
                }
                Ok(Message::Binary(bytes)) => {
                    assert_eq!(bytes[0], 1, "a message of a channel");
                    let id = u32::from_le_bytes(bytes[1..5].try_into().unwrap());
                    if subscription == Some(id) {
                        let time = u64::from_le_bytes(bytes[5..13].try_into().unwrap());
                        return (Value::Null, time, bytes[13..].to_vec());
                    }
                }
                Ok(_) | Err(Error::Io(_)) => {}
                Err(error) => panic!("{error}"),
            }
        }
        panic!("nothing came for {subscription:?}");
    }

    /// Waits until a topic is advertised, and returns its channel.
    #[track_caller]
    fn channel(&mut self, topic: &str) -> Value {
        while !self.channels.contains_key(topic) {
            self.next(None);
        }
        self.channels[topic].clone()
    }

    #[track_caller]
    fn subscribe(&mut self, id: u32, topic: &str) {
        let channel = self.channel(topic)["id"].clone();
        self.send(&json!({ "op": "subscribe", "subscriptions": [{ "id": id, "channelId": channel }] }));
    }

    /// Returns the next warning.
    #[track_caller]
    fn warned(&mut self) -> String {
        loop {
            let (value, ..) = self.next(None);
            if value["op"] == "status" {
                return value["message"].as_str().unwrap().to_owned();
            }
        }
    }
}

#[test]
fn the_model_of_another_robot_ends_the_sharing() {
    let server = Server::ready();
    let mut share = Share::start(&server);
    let mut client = share.open();
    client.channel("/joint_states");
    server.succeeds(&["model", "push", arm7().to_str().unwrap()]);
    let deadline = Instant::now() + Duration::from_secs(20);
    let status = loop {
        match share.child.try_wait().unwrap() {
            Some(status) => break status,
            None => assert!(Instant::now() < deadline, "the sharing goes on"),
        }
        std::thread::sleep(Duration::from_millis(50));
    };
    assert_eq!(status.code(), Some(2));
    std::mem::forget(share);
}

#[test]
fn foxglove_sees_the_robot_and_cannot_command_it() {
    let server = Server::ready();
    let share = Share::start(&server);
    let mut client = share.open();
    let (info, ..) = client.next(None);
    assert_eq!((&info["op"], &info["capabilities"]), (&json!("serverInfo"), &json!([])), "{info}");

    let channel = client.channel("/joint_states");
    assert_eq!((&channel["encoding"], &channel["schemaEncoding"]), (&json!("cdr"), &json!("ros2msg")));
    assert_eq!(channel["schemaName"], "sensor_msgs/msg/JointState");
    assert!(channel["schema"].as_str().unwrap().contains("float64[] position"));
    client.subscribe(7, "/joint_states");
    client.subscribe(8, "/tf");
    let (_, first, message) = client.next(Some(7));
    // CDR: stamp, an empty frame, the number of names, the length of the first name and that name.
    assert_eq!(message[..4], [0, 1, 0, 0]);
    assert_eq!(message[20..24], 9u32.to_le_bytes());
    assert_eq!(&message[28..41], b"finger1_swing");
    let (_, second, _) = client.next(Some(7));
    assert!((10_000_000..1_000_000_000).contains(&(second - first)), "{first} {second}");
    let (.., frames) = client.next(Some(8));
    assert!(frames.windows(7).any(|part| part == b"finger3"), "the links have the names of the URDF");

    // Earlier messages are kept for clients that connect late.
    let mut late = share.open();
    late.subscribe(1, "/robot_description");
    let (.., urdf) = late.next(Some(1));
    assert!(urdf.windows(6).any(|part| part == b"<robot"));
    late.subscribe(2, "/tf_static");
    let (.., fixed) = late.next(Some(2));
    assert!(fixed.windows(11).any(|part| part == b"finger2_tip"));

    for (nonsense, words) in [
        (json!({ "op": "subscribe", "subscriptions": [{ "id": 9, "channelId": 999 }] }), "no channel 999"),
        (
            json!({ "op": "advertise", "channels": [{ "id": 1, "topic": "/joint_commands" }] }),
            "only be looked at",
        ),
        (json!({ "op": "subscribe" }), "not understood"),
        (json!([1]), "not understood"),
    ] {
        late.send(&nonsense);
        let told = late.warned();
        assert!(told.contains(words), "{nonsense}: {told}");
    }
    late.send(&json!({ "op": "unsubscribe", "subscriptionIds": [1, 2, 77] }));
    // The other subscription continues.
    client.next(Some(7));

    for (headers, status) in [
        ("", " 400 "),
        ("Sec-WebSocket-Protocol: mqtt\r\n", " 400 "),
        ("Sec-WebSocket-Protocol: foxglove.sdk.v1\r\nOrigin: https://app.foxglove.dev\r\n", " 101 "),
        ("Sec-WebSocket-Protocol: foxglove.sdk.v1\r\nOrigin: https://evil.example\r\n", " 403 "),
    ] {
        let (head, _) = share.dial(headers);
        assert!(head.contains(status), "{headers}: {head}");
    }
    server.fails(&["share", "foxglove://0.0.0.0:0"], 2, &["ssh -L", "Foxglove"]);
    server.fails(&["share", &format!("foxglove://{}", share.host)], 1, &["another program listens there"]);
    server.fails(&["share", "foxglove://localhost"], 2, &["HOST:PORT"]);
    // The URDF of another robot would be drawn at the wrong angles.
    let other = arm7();
    let robot = ["--robot", other.to_str().unwrap()];
    let told = ["the board is hand3", "the folder of arm7"];
    server.fails(&[&["share", "foxglove://localhost:0"], &robot[..]].concat(), 2, &told);
    let name = server.folder.path().join("none");
    server.fails(&[&["record", name.to_str().unwrap()], &robot[..]].concat(), 2, &told);
    assert!(!name.with_extension("mcap").exists());
}
