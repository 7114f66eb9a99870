//! A ROS 2 service over DDS: a topic of requests and a topic of replies.
//!
//! How a reply identifies its request depends on the caller's RMW, which is known from the vendor of its DDS,
//! the first bytes of every GUID. `rmw_cyclonedds_cpp` puts a header before request and reply: half a GUID
//! and a number, which are returned unchanged. All others, among them `rmw_fastrtps_cpp`, name the request in
//! the inline QoS of the reply (DDS-RPC, enhanced mapping).

use std::collections::{HashSet, VecDeque};
use std::time::{Duration, Instant};

use rustdds::rpc::SampleIdentity;
use rustdds::{DataWriterStatus, GUID, SequenceNumber, StatusEvented as _, WriteOptionsBuilder};
use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::dds::{Dds, DdsError, Reader, Writer, dds_type, decode, encode, qos};

/// The quality of service of services in ROS 2.
const DEPTH: i32 = 10;
/// Length of the header before the messages of `rmw_cyclonedds_cpp` [bytes].
const HEADER: usize = 16;
/// The vendor of Cyclone DDS.
const CYCLONE: [u8; 2] = [0x01, 0x10];
/// Maximum number of unreadable requests that are dropped at once.
const MAX_DAMAGED: usize = 100;
/// Time for which a reply waits for its caller's reader to be discovered.
const PATIENCE: Duration = Duration::from_secs(30);

/// Who asked, and how the reply must identify the request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Caller {
    /// The writer of the request.
    writer: GUID,
    request: SampleIdentity,
    header: Option<[u8; HEADER]>,
}

impl Caller {
    fn new(
        writer: GUID,
        number: SequenceNumber,
        related: Option<SampleIdentity>,
        body: &[u8],
    ) -> Option<Self> {
        let is_cyclone = writer.prefix.as_ref().starts_with(&CYCLONE);
        let header = match body.first_chunk::<HEADER>() {
            Some(header) if is_cyclone => Some(*header),
            None if is_cyclone => return None,
            _ => None,
        };
        // Fast DDS names the reader of the replies here, and leaves the number unset.
        let writer_guid = related
            .map(|related| related.writer_guid)
            .filter(|guid| *guid != GUID::GUID_UNKNOWN)
            .unwrap_or(writer);
        let sequence_number = related
            .map(|related| related.sequence_number)
            .filter(|number| i64::from(*number) > 0)
            .unwrap_or(number);
        Some(Self { writer, request: SampleIdentity { writer_guid, sequence_number }, header })
    }
}

/// A service.
pub struct Service {
    name: String,
    requests: Reader,
    replies: Writer,
    /// Discovered readers of the replies.
    readers: HashSet<GUID>,
    /// Replies to callers whose readers are not yet discovered.
    waiting: VecDeque<(Instant, Caller, Vec<u8>)>,
}

impl Service {
    /// Offers the service `name`, such as `/tesaki/enable`; its type is given without `_Request` and
    /// `_Response`, such as `std_srvs/srv/Trigger`.
    pub fn offer(dds: &Dds, name: &str, kind: &str) -> Result<Self, DdsError> {
        let qos = qos(DEPTH, false);
        let requests =
            dds.reader(&format!("rq{name}Request"), &dds_type(&format!("{kind}_Request")), &qos)?;
        let replies = dds.writer(&format!("rr{name}Reply"), &dds_type(&format!("{kind}_Response")), &qos)?;
        Ok(Self {
            name: name.to_owned(),
            requests,
            replies,
            readers: HashSet::new(),
            waiting: VecDeque::new(),
        })
    }

    /// Returns its name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the next request. Unreadable ones are dropped.
    pub fn take<T: DeserializeOwned>(&mut self) -> Option<(Caller, T)> {
        self.deliver();
        self.requests.drain_read_notifications();
        for _ in 0..MAX_DAMAGED {
            let sample = match self.requests.try_take_one() {
                Ok(Some(sample)) => sample,
                Ok(None) => return None,
                Err(_) => continue,
            };
            let related = sample.write_options.related_sample_identity();
            let caller = Caller::new(sample.writer_guid, sample.sequence_number, related, &sample.sample);
            let Some(caller) = caller else { continue };
            let body = sample.sample.get(caller.header.map_or(0, |header| header.len())..);
            if let Some(request) = body.and_then(decode) {
                return Some((caller, request));
            }
        }
        None
    }

    /// Answers a request.
    pub fn reply(&mut self, caller: Caller, reply: &impl Serialize) {
        let body = encode(reply);
        let bytes = caller.header.map_or_else(Vec::new, |header| header.to_vec());
        self.waiting.push_back((Instant::now(), caller, [bytes, body].concat()));
        self.deliver();
    }

    /// Returns whether no reply waits.
    pub fn is_idle(&mut self) -> bool {
        self.deliver();
        self.waiting.is_empty()
    }

    /// Sends the replies whose readers are known: a reader does not receive replies sent before its
    /// discovery.
    fn deliver(&mut self) {
        while let Some(status) = self.replies.try_recv_status() {
            if let DataWriterStatus::PublicationMatched { reader, current, .. } = status {
                if current.count_change() > 0 {
                    self.readers.insert(reader);
                } else {
                    self.readers.remove(&reader);
                }
            }
        }
        for _ in 0..self.waiting.len() {
            let Some((since, caller, bytes)) = self.waiting.pop_front() else { return };
            if self.readers.iter().any(|reader| reader.prefix == caller.writer.prefix) {
                let options = WriteOptionsBuilder::new().related_sample_identity(caller.request).build();
                // If it fails, the caller asks again.
                let _ = self.replies.write_with_options(bytes, options);
            } else if since.elapsed() < PATIENCE {
                self.waiting.push_back((since, caller, bytes));
            }
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::messages::{TriggerRequest, TriggerResponse};

    const TRIGGER: &str = "std_srvs/srv/Trigger";
    /// Longer than anything here takes.
    const FOREVER: Duration = Duration::from_secs(60);

    fn guid(vendor: [u8; 2], entity: u8) -> GUID {
        let mut bytes = [7; 16];
        bytes[..2].copy_from_slice(&vendor);
        bytes[15] = entity;
        GUID::from_bytes(bytes)
    }

    #[test]
    fn cyclone_puts_a_header_in_front_that_comes_back() {
        let writer = guid(CYCLONE, 3);
        let body: Vec<u8> = (0..17).collect();
        let caller = Caller::new(writer, SequenceNumber::from(5_i64), None, &body).unwrap();
        assert_eq!(caller.header.as_ref().map(|header| &header[..]), body.get(..16));
        // Too short for a header.
        assert_eq!(Caller::new(writer, SequenceNumber::from(5_i64), None, &body[..15]), None);
    }

    #[test]
    fn fast_dds_names_the_reader_of_its_replies_and_leaves_the_number_open() {
        let (writer, reader) = (guid([0x01, 0x0f], 3), guid([0x01, 0x0f], 4));
        let related =
            SampleIdentity { writer_guid: reader, sequence_number: SequenceNumber::from_high_low(-1, 0) };
        let caller = |related| Caller::new(writer, SequenceNumber::from(5_i64), related, &[0]).unwrap();
        let of = |writer_guid| SampleIdentity { writer_guid, sequence_number: SequenceNumber::from(5_i64) };
        assert_eq!((caller(Some(related)).request, caller(None).request), (of(reader), of(writer)));
        assert_eq!(caller(None).header, None);
    }

    #[test]
    fn a_reply_names_its_request_where_the_vendor_is_not_cyclone() {
        let _alone = crate::dds::tests::alone();
        let (here, there) = (Dds::open(230, None).unwrap(), Dds::open(230, None).unwrap());
        let mut service = Service::offer(&here, "/test/trigger", TRIGGER).unwrap();
        let qos = qos(DEPTH, false);
        let requests =
            there.writer("rq/test/triggerRequest", &dds_type(&format!("{TRIGGER}_Request")), &qos).unwrap();
        let replies =
            there.reader("rr/test/triggerReply", &dds_type(&format!("{TRIGGER}_Response")), &qos).unwrap();
        let deadline = Instant::now() + FOREVER;
        let mut sent = Vec::new();
        let reply = loop {
            assert!(Instant::now() < deadline);
            // Requests are lost until both ends have discovered each other.
            let options = WriteOptionsBuilder::new().build();
            sent.push(requests.write_with_options(vec![0], options).unwrap());
            if let Some((caller, TriggerRequest { .. })) = service.take() {
                service.reply(caller, &TriggerResponse { success: true, message: "done".to_owned() });
            }
            service.deliver();
            replies.drain_read_notifications();
            if let Ok(Some(reply)) = replies.try_take_one() {
                break reply;
            }
            std::thread::sleep(Duration::from_millis(20));
        };
        // Padded to a multiple of four bytes.
        let expected = encode(&TriggerResponse { success: true, message: "done".to_owned() });
        assert!(reply.sample.starts_with(&expected), "{:?}", reply.sample);
        assert!(sent.contains(&reply.write_options.related_sample_identity().unwrap()));
    }
}
