//! The DDS participant: on this machine's loopback interface, or opened to networks.

use std::convert::Infallible;
use std::ffi::OsString;
use std::fs;
use std::io;
use std::net::Ipv4Addr;
use std::os::fd::RawFd;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Weak};
use std::{process, thread, time};

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

use tesaki_supervisor::output_queue;

use crate::session::say;

/// How long a write may wait for a slow reader: a few topics in each period of 10 ms must not delay the
/// set-points that the same thread sends.
const MAX_BLOCKING: Duration = Duration::from_millis(1);
/// Minimum number of sockets of a participant, which receives unicast and multicast on two each and sends on
/// further ones.
const LEAST_SOCKETS: usize = 4;
/// The threads of this process, each a folder.
const THREADS: &str = "/proc/self/task";
/// How the names of the library's threads begin.
const LIBRARY: &str = "RustDDS";
/// Number of threads of a participant: one sends and receives, one discovers.
const PARTICIPANT_THREADS: usize = 2;
/// Period in which the threads are watched.
const WATCH: time::Duration = time::Duration::from_millis(100);
/// Time that this program has for its end once a thread of the library has ended.
const LAST_TURNS: time::Duration = time::Duration::from_secs(5);

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
    /// The threads of the library cannot be watched.
    #[error("cannot watch the threads of DDS in {THREADS} ({0}), so nothing was opened")]
    Unwatched(String),
    /// A thread of the library has ended.
    #[error(
        "a thread of DDS has ended in this program, as happens when the process is paused (SIGSTOP, a debugger, \
         a suspended computer): requests no longer arrive. Start the program again"
    )]
    Ended,
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
    /// The folders of the library's threads.
    threads: Vec<PathBuf>,
    /// Exists as long as the threads are watched. It is the last field, so that it outlives the library.
    _watched: Arc<()>,
}

impl Dds {
    /// Joins a domain. With the address of an interface in `network`, other machines can reach the
    /// participant.
    pub fn open(domain: u16, network: Option<Ipv4Addr>) -> Result<Self, DdsError> {
        let create = |what: &str, error: &dyn std::fmt::Display| DdsError::Create {
            what: what.to_owned(),
            error: error.to_string(),
        };
        let unwatched = |error: io::Error| DdsError::Unwatched(error.to_string());
        let before = library_threads().map_err(unwatched)?;
        let addresses = [Some(Ipv4Addr::LOCALHOST), network];
        let participant = DomainParticipantBuilder::new(domain)
            .with_only_networks(addresses.into_iter().flatten())
            .build()
            .map_err(|error| create("participant", &error))?;
        let mut threads = library_threads().map_err(unwatched)?;
        threads.retain(|thread| !before.contains(thread));
        if threads.len() != PARTICIPANT_THREADS {
            let text = format!("{} of {PARTICIPANT_THREADS} found", threads.len());
            return Err(DdsError::Unwatched(text));
        }
        if network.is_none() {
            stay_on_loopback().map_err(DdsError::Loopback)?;
        }
        let none = QosPolicyBuilder::new().build();
        let publisher = participant.create_publisher(&none).map_err(|error| create("publisher", &error))?;
        let subscriber =
            participant.create_subscriber(&none).map_err(|error| create("subscriber", &error))?;
        let watched = Arc::new(());
        let (seen, own) = (Arc::downgrade(&watched), threads.clone());
        thread::Builder::new()
            .name("DDS watch".to_owned())
            .spawn(move || watch(&own, &seen))
            .map_err(|error| DdsError::Unwatched(error.to_string()))?;
        Ok(Self { participant, publisher, subscriber, threads, _watched: watched })
    }

    /// Checks that the library still works. Its threads end without a word when a wait for messages fails,
    /// also if it was only interrupted because the process was paused.
    ///
    /// # Errors
    /// When one of them has ended.
    pub fn check(&self) -> Result<(), DdsError> {
        if exist(&self.threads) { Ok(()) } else { Err(DdsError::Ended) }
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
fn udp_sockets() -> io::Result<Vec<RawFd>> {
    let mut sockets = Vec::new();
    for entry in fs::read_dir("/proc/self/fd")? {
        let Some(socket) = entry?.file_name().to_str().and_then(|name| name.parse().ok()) else { continue };
        let is_datagram = getsockopt(socket, sockopt::SockType) == Ok(SockType::Datagram);
        if is_datagram && getsockname::<SockaddrIn>(socket).is_ok() {
            sockets.push(socket);
        }
    }
    Ok(sockets)
}

fn exist(threads: &[PathBuf]) -> bool {
    threads.iter().all(|thread| thread.exists())
}

/// Ends the program some time after one of the library's threads, while they are `watched`: a call of the
/// library may then wait for ever. A board gets nothing from a program that waits, and stops by its timeout.
fn watch(threads: &[PathBuf], watched: &Weak<()>) {
    while watched.strong_count() > 0 {
        thread::sleep(WATCH);
        if !exist(threads) {
            thread::sleep(LAST_TURNS);
            if watched.strong_count() > 0 {
                say(&format!("tesaki-ros2: {}", DdsError::Ended));
                let _ = output_queue::flush(true);
                process::exit(1);
            }
        }
    }
}

/// Returns the folders of the library's threads in this process.
fn library_threads() -> io::Result<Vec<PathBuf>> {
    let mut threads = Vec::new();
    for entry in fs::read_dir(THREADS)? {
        let thread = entry?.path();
        if is_of_library(&thread) {
            threads.push(thread);
        }
    }
    Ok(threads)
}

fn is_of_library(thread: &Path) -> bool {
    // A thread that has just ended has no name.
    fs::read_to_string(thread.join("comm")).is_ok_and(|name| name.starts_with(LIBRARY))
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

    #[test]
    fn a_thread_of_the_library_that_has_ended_is_noticed() {
        let _alone = alone();
        let mut dds = Dds::open(231, None).unwrap();
        let other = Dds::open(231, None).unwrap();
        assert!(dds.check().is_ok() && dds.threads.iter().all(|thread| !other.threads.contains(thread)));
        let own = || Path::new("/proc").join(fs::read_link("/proc/thread-self").unwrap());
        let (tell, told) = std::sync::mpsc::channel();
        let (end, ended) = std::sync::mpsc::channel();
        let thread = thread::spawn(move || {
            tell.send(own()).unwrap();
            ended.recv().unwrap();
        });
        dds.threads.push(told.recv().unwrap());
        assert!(dds.check().is_ok());
        end.send(()).unwrap();
        thread.join().unwrap();
        // The kernel removes it a little later.
        let deadline = time::Instant::now() + time::Duration::from_secs(60);
        while dds.check().is_ok() {
            assert!(time::Instant::now() < deadline);
            thread::sleep(time::Duration::from_millis(1));
        }
        assert!(matches!(dds.check(), Err(DdsError::Ended)));
    }
}
