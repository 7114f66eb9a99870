//! The DDS participant: on this machine's loopback interface, or opened to networks.

use std::convert::Infallible;
use std::ffi::OsString;
use std::net::Ipv4Addr;
use std::os::fd::RawFd;

use byteorder::LittleEndian;
use nix::sys::socket::{SockType, SockaddrIn, getsockname, getsockopt, setsockopt, sockopt};
use rustdds::bytes::Bytes;
use rustdds::no_key::{
    DataWriter, Decode, DefaultDecoder, DeserializerAdapter, SerializerAdapter, SimpleDataReader,
};
use rustdds::policy::{Durability, History};
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, Duration, Publisher, QosPolicies, QosPolicyBuilder,
    RepresentationIdentifier, Subscriber, TopicKind,
};
use serde::Serialize;
use serde::de::DeserializeOwned;

/// How long a write may wait for a slow reader.
const MAX_BLOCKING: Duration = Duration::from_millis(20);
/// Minimum number of sockets of a participant, which receives unicast and multicast on two each and sends on
/// further ones.
const LEAST_SOCKETS: usize = 4;

/// Why there is no DDS.
#[derive(Debug, thiserror::Error)]
pub enum DdsError {
    /// The library could not create something.
    #[error("cannot create the DDS {what}: {error}")]
    Create {
        /// What could not be created.
        what: String,
        /// The reason.
        error: String,
    },
    /// The sockets cannot be kept on this machine.
    #[error(
        "cannot keep DDS on this machine's loopback interface ({0}), so nothing was opened. The kernel must \
         let a program bind its sockets to the interface `lo` (Linux 5.7 or newer; a container may forbid it). \
         --network ADDRESS opens them to networks instead"
    )]
    Loopback(String),
}

/// Writes messages that are already encoded.
pub type Writer = DataWriter<Vec<u8>, Encoded>;
/// Reads messages without decoding them.
pub type Reader = SimpleDataReader<Vec<u8>, Encoded>;

/// A message in CDR, little-endian, the byte order of every computer that runs ROS 2.
pub struct Encoded;

impl SerializerAdapter<Vec<u8>> for Encoded {
    type Error = Infallible;

    fn output_encoding() -> RepresentationIdentifier {
        RepresentationIdentifier::CDR_LE
    }

    fn to_bytes(value: &Vec<u8>) -> Result<Bytes, Infallible> {
        Ok(Bytes::copy_from_slice(value))
    }
}

impl DeserializerAdapter<Vec<u8>> for Encoded {
    type Error = Infallible;
    type Decoded = Vec<u8>;

    fn supported_encodings() -> &'static [RepresentationIdentifier] {
        &[RepresentationIdentifier::CDR_LE]
    }

    fn transform_decoded(decoded: Vec<u8>) -> Vec<u8> {
        decoded
    }
}

/// See [`Encoded`].
#[derive(Clone)]
pub struct Copied;

impl Decode<'_, Vec<u8>> for Copied {
    type Error = Infallible;

    fn decode_bytes(self, bytes: &[u8], _: RepresentationIdentifier) -> Result<Vec<u8>, Infallible> {
        Ok(bytes.to_vec())
    }
}

impl DefaultDecoder<Vec<u8>> for Encoded {
    type Decoder = Copied;
    const DECODER: Copied = Copied;
}

/// Encodes a message in CDR.
pub fn encode(message: &impl Serialize) -> Vec<u8> {
    // Fails only for types that CDR does not have, such as maps.
    cdr_encoding::to_vec::<_, LittleEndian>(message).unwrap_or_default()
}

/// Decodes a message from CDR; `None` if it is damaged.
pub fn decode<T: DeserializeOwned>(bytes: &[u8]) -> Option<T> {
    cdr_encoding::from_bytes::<T, LittleEndian>(bytes).ok().map(|(message, _)| message)
}

/// Returns the quality of service of a topic; all are reliable, which is the default of ROS 2.
pub fn qos(depth: i32, transient_local: bool) -> QosPolicies {
    QosPolicyBuilder::new()
        .reliable(MAX_BLOCKING)
        .durability(if transient_local { Durability::TransientLocal } else { Durability::Volatile })
        .history(History::KeepLast { depth })
        .build()
}

/// Returns the DDS name of a ROS 2 type: `std_msgs/msg/String` is `std_msgs::msg::dds_::String_`.
pub fn dds_type(name: &str) -> String {
    match name.rsplit_once('/') {
        Some((package, name)) => format!("{}::dds_::{name}_", package.replace('/', "::")),
        None => name.to_owned(),
    }
}

/// A participant in a domain.
pub struct Dds {
    participant: DomainParticipant,
    publisher: Publisher,
    subscriber: Subscriber,
}

impl Dds {
    /// Joins a domain. With the address of an interface in `network`, other machines can reach the
    /// participant.
    pub fn open(domain: u16, network: Option<Ipv4Addr>) -> Result<Self, DdsError> {
        let create = |what: &str, error: &dyn std::fmt::Display| DdsError::Create {
            what: what.to_owned(),
            error: error.to_string(),
        };
        let addresses = [Some(Ipv4Addr::LOCALHOST), network];
        let participant = DomainParticipantBuilder::new(domain)
            .with_only_networks(addresses.into_iter().flatten())
            .build()
            .map_err(|error| create("participant", &error))?;
        if network.is_none() {
            stay_on_loopback().map_err(DdsError::Loopback)?;
        }
        let none = QosPolicyBuilder::new().build();
        let publisher = participant.create_publisher(&none).map_err(|error| create("publisher", &error))?;
        let subscriber =
            participant.create_subscriber(&none).map_err(|error| create("subscriber", &error))?;
        Ok(Self { participant, publisher, subscriber })
    }

    /// Creates a writer of a topic, by its names in DDS.
    pub fn writer(&self, name: &str, kind: &str, qos: &QosPolicies) -> Result<Writer, DdsError> {
        let fail = |error: &dyn std::fmt::Display| DdsError::Create {
            what: format!("writer of {name}"),
            error: error.to_string(),
        };
        let topic = self.participant.create_topic(name.to_owned(), kind.to_owned(), qos, TopicKind::NoKey);
        let topic = topic.map_err(|error| fail(&error))?;
        self.publisher.create_datawriter_no_key(&topic, None).map_err(|error| fail(&error))
    }

    /// Creates a reader of a topic, by its names in DDS.
    pub fn reader(&self, name: &str, kind: &str, qos: &QosPolicies) -> Result<Reader, DdsError> {
        let fail = |error: &dyn std::fmt::Display| DdsError::Create {
            what: format!("reader of {name}"),
            error: error.to_string(),
        };
        let topic = self.participant.create_topic(name.to_owned(), kind.to_owned(), qos, TopicKind::NoKey);
        let topic = topic.map_err(|error| fail(&error))?;
        self.subscriber.create_simple_datareader_no_key(&topic, None).map_err(|error| fail(&error))
    }
}

/// Binds every UDP socket of this process to the loopback interface: the kernel drops packets from other
/// interfaces, and sends nothing to them. (The library listens on all interfaces, and its filter applies only
/// to what it announces.)
fn stay_on_loopback() -> Result<(), String> {
    let sockets = udp_sockets().map_err(|error| format!("/proc/self/fd: {error}"))?;
    if sockets.len() < LEAST_SOCKETS {
        return Err(format!("{} of at least {LEAST_SOCKETS} sockets found in /proc/self/fd", sockets.len()));
    }
    for socket in sockets {
        setsockopt(socket, sockopt::BindToDevice, &OsString::from("lo"))
            .map_err(|error| error.to_string())?;
    }
    Ok(())
}

/// Returns the UDP sockets of this process.
fn udp_sockets() -> std::io::Result<Vec<RawFd>> {
    let mut sockets = Vec::new();
    for entry in std::fs::read_dir("/proc/self/fd")? {
        let Some(socket) = entry?.file_name().to_str().and_then(|name| name.parse().ok()) else { continue };
        let is_datagram = getsockopt(socket, sockopt::SockType) == Ok(SockType::Datagram);
        if is_datagram && getsockname::<SockaddrIn>(socket).is_ok() {
            sockets.push(socket);
        }
    }
    Ok(sockets)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
pub mod tests {
    use std::net::UdpSocket;
    use std::os::fd::AsRawFd as _;
    use std::sync::{Mutex, MutexGuard, PoisonError};

    use super::*;

    /// Lets one test run at a time, because a participant binds all sockets of the process.
    pub fn alone() -> MutexGuard<'static, ()> {
        static ALONE: Mutex<()> = Mutex::new(());
        ALONE.lock().unwrap_or_else(PoisonError::into_inner)
    }

    #[test]
    fn types_have_the_names_that_ros_2_gives_them() {
        assert_eq!(dds_type("std_msgs/msg/String"), "std_msgs::msg::dds_::String_");
        assert_eq!(
            dds_type("control_msgs/action/FollowJointTrajectory_SendGoal_Request"),
            "control_msgs::action::dds_::FollowJointTrajectory_SendGoal_Request_"
        );
    }

    #[test]
    fn without_a_network_every_udp_socket_is_bound_to_the_loopback_interface() {
        let _alone = alone();
        let udp = UdpSocket::bind("127.0.0.1:0").unwrap();
        let tcp = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let (unix, _peer) = std::os::unix::net::UnixDatagram::pair().unwrap();
        let found = udp_sockets().unwrap();
        assert!(found.contains(&udp.as_raw_fd()), "{found:?}");
        assert!(!found.contains(&tcp.as_raw_fd()) && !found.contains(&unix.as_raw_fd()), "{found:?}");

        let device = |&socket: &RawFd| {
            let name = getsockopt(socket, sockopt::BindToDevice).unwrap();
            name.to_string_lossy().trim_end_matches('\0').to_owned()
        };
        let dds = Dds::open(231, Some(Ipv4Addr::LOCALHOST)).unwrap();
        assert!(udp_sockets().unwrap().iter().all(|socket| device(socket).is_empty()));
        drop(dds);
        let dds = Dds::open(231, None).unwrap();
        let _writer = dds.writer("rt/test", "std_msgs::msg::dds_::String_", &qos(1, false)).unwrap();
        let sockets = udp_sockets().unwrap();
        assert!(sockets.len() > LEAST_SOCKETS, "{sockets:?}");
        assert!(sockets.iter().all(|socket| device(socket) == "lo"), "{sockets:?}");
    }
}
