//! Framing: `COBS(postcard(message) ‖ CRC-32) ‖ 0x00`.
//!
//! The CRC (CRC-32/ISO-HDLC, little endian) is checked before the message is interpreted. A zero byte ends a
//! frame and occurs nowhere else, so a receiver synchronises at the next zero after a late start or lost
//! bytes. Damaged frames are counted by kind and dropped.

use core::mem::take;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use super::{ActuatorFrame, FromBoard, to_slice};

/// Longest postcard encoding of a message in bytes.
pub const MAX_MESSAGE: usize = 336;
/// Bytes of the checksum.
const CHECKSUM: usize = 4;
/// Longest run of a COBS group: a code byte and 254 others.
const GROUP: usize = 255;
/// Longest frame in bytes, the closing zero included.
pub const MAX_FRAME: usize = MAX_MESSAGE + CHECKSUM + (MAX_MESSAGE + CHECKSUM).div_ceil(GROUP - 1) + 1;

/// `CRC_TABLES[k][b]` is the checksum's change by byte `b` with `k` bytes behind it.
// A static, so that the tables lie in flash once and are not copied to the stack at each use.
static CRC_TABLES: [[u32; 256]; 4] = {
    let mut tables = [[0; 256]; 4];
    let mut byte = 0_u32;
    while byte < 256 {
        let mut value = byte;
        let mut bit = 0;
        while bit < 8 {
            value = (value >> 1) ^ if value & 1 == 1 { 0xedb8_8320 } else { 0 };
            bit += 1;
        }
        tables[0][byte as usize] = value;
        byte += 1;
    }
    let mut behind = 1;
    while behind < 4 {
        let mut byte = 0;
        while byte < 256 {
            let before = tables[behind - 1][byte];
            tables[behind][byte] = (before >> 8) ^ tables[0][(before & 0xff) as usize];
            byte += 1;
        }
        behind += 1;
    }
    tables
};

/// The checksum of frames and of pushed models: CRC-32/ISO-HDLC, that of zlib.
// Four bytes per step: half the instructions of the `crc` crate, which is the reference in the tests.
pub fn checksum(bytes: &[u8]) -> u32 {
    let [one, two, three, four] = &CRC_TABLES;
    let change = |table: &[u32; 256], byte: u8| table[usize::from(byte)];
    let step = |crc: u32, word: &[u8]| {
        let word = word.first_chunk().map_or(0, |word| u32::from_le_bytes(*word));
        let [a, b, c, d] = (crc ^ word).to_le_bytes();
        change(four, a) ^ change(three, b) ^ change(two, c) ^ change(one, d)
    };
    let (blocks, rest) = bytes.as_chunks::<8>();
    let mut crc = u32::MAX;
    for block in blocks {
        crc = step(step(crc, &block[..4]), &block[4..]);
    }
    for &byte in rest {
        crc = (crc >> 8) ^ change(one, crc.to_le_bytes()[0] ^ byte);
    }
    !crc
}

/// The message needs more than [`MAX_MESSAGE`] bytes or the buffer is shorter than its frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TooLong;

impl core::fmt::Display for TooLong {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "the message does not fit a frame of {MAX_FRAME} bytes")
    }
}

impl core::error::Error for TooLong {}

/// Writes `message` as one frame to the start of `frame` and returns the frame's length.
///
/// # Errors
/// [`TooLong`]; cannot happen with a buffer of [`MAX_FRAME`] bytes and the messages of [`super`].
pub fn encode<T: Serialize>(message: &T, frame: &mut [u8]) -> Result<usize, TooLong> {
    enclose(frame, |payload| to_slice(message, payload).ok())
}

/// Calls `write` with the place of a message's encoding in `frame`, and makes a frame of the bytes that it
/// has written. Returns the frame's length.
#[inline]
fn enclose(frame: &mut [u8], write: impl FnOnce(&mut [u8]) -> Option<usize>) -> Result<usize, TooLong> {
    // Behind the position of the first COBS code: COBS is applied in place.
    let payload = frame.get_mut(1..).ok_or(TooLong)?;
    let room = payload.len().min(MAX_MESSAGE);
    let length = write(payload.get_mut(..room).ok_or(TooLong)?).ok_or(TooLong)?;
    close(frame, length)
}

/// Makes a frame of an encoding of `length` bytes behind the first byte of `frame`.
fn close(frame: &mut [u8], length: usize) -> Result<usize, TooLong> {
    let (encoded, rest) =
        frame.get_mut(1..).and_then(|payload| payload.split_at_mut_checked(length)).ok_or(TooLong)?;
    *rest.first_chunk_mut::<CHECKSUM>().ok_or(TooLong)? = checksum(encoded).to_le_bytes();
    let end = stuff(frame, 1 + length + CHECKSUM).ok_or(TooLong)?;
    *frame.get_mut(end).ok_or(TooLong)? = 0;
    Ok(end + 1)
}

/// A message that a board sends. The image needs the encoding of its parts also for [exports], which the core
/// contains: encoded by the core, they are compiled once.
///
/// [exports]: super::Request::Export
pub trait Outgoing {
    /// As [`encode`].
    ///
    /// # Errors
    /// [`TooLong`], as there.
    fn encode(&self, frame: &mut [u8]) -> Result<usize, TooLong>;
}

impl Outgoing for ActuatorFrame {
    fn encode(&self, frame: &mut [u8]) -> Result<usize, TooLong> {
        encode(self, frame)
    }
}

impl Outgoing for FromBoard {
    fn encode(&self, frame: &mut [u8]) -> Result<usize, TooLong> {
        match self {
            // A hundred times a second: by inlined functions. The bytes are the same.
            Self::Telemetry(telemetry) => enclose(frame, |payload| {
                let message = (Self::TELEMETRY, telemetry);
                postcard::to_slice(&message, payload).ok().map(|bytes| bytes.len())
            }),
            _ => encode(self, frame),
        }
    }
}

/// COBS in place: the payload is `frame[1..end]`. Returns the new end; `None` without room for it.
fn stuff(frame: &mut [u8], mut end: usize) -> Option<usize> {
    let mut code = 0;
    loop {
        let max = end.min(code + GROUP);
        let next = find_zero(frame.get(code + 1..max)?).map_or(max, |run| code + 1 + run);
        *frame.get_mut(code)? = (next - code).to_le_bytes()[0];
        if next == end {
            return Some(end);
        }
        if next == code + GROUP {
            // A full group stands for no zero, so the code of the next group needs an additional byte.
            let group = frame.get_mut(next..=end).filter(|group| !group.is_empty())?;
            let mut carried = 0;
            for byte in group {
                carried = core::mem::replace(byte, carried);
            }
            end += 1;
        }
        code = next;
    }
}

/// The inverse, for a frame without zeros: returns the payload; `None` if the codes do not match the length.
fn unstuff(frame: &mut [u8]) -> Option<&[u8]> {
    let mut end = frame.len();
    let mut place = 0;
    let mut code = usize::from(*frame.first()?);
    loop {
        let next = place + code;
        if next >= end {
            return if next == end { frame.get(1..end) } else { None };
        }
        let following = usize::from(core::mem::replace(frame.get_mut(next)?, 0));
        if code == GROUP {
            // The code behind a full group stands for no zero: its byte is removed.
            let mut carried = 0;
            for byte in frame.get_mut(next..end)?.iter_mut().rev() {
                carried = core::mem::replace(byte, carried);
            }
            end -= 1;
            place = next - 1;
        } else {
            place = next;
        }
        code = following;
    }
}

/// Position of the first zero. Eight bytes per iteration.
#[inline]
fn find_zero(bytes: &[u8]) -> Option<usize> {
    // Sets the top bit of each byte that is zero, and perhaps of bytes above the first such one.
    let zeros = |[a, b, c, d]: [u8; 4]| {
        let word = u32::from_le_bytes([a, b, c, d]);
        word.wrapping_sub(0x0101_0101) & !word
    };
    let (blocks, rest) = bytes.as_chunks::<8>();
    for (index, &[a, b, c, d, e, f, g, h]) in blocks.iter().enumerate() {
        let (low, high) = (zeros([a, b, c, d]), zeros([e, f, g, h]));
        if (low | high) & 0x8080_8080 != 0 {
            let zeros = u64::from(low & 0x8080_8080) | u64::from(high & 0x8080_8080) << 32;
            return Some(8 * index + zeros.trailing_zeros() as usize / 8);
        }
    }
    Some(8 * blocks.len() + rest.iter().position(|&byte| byte == 0)?)
}

/// How a received frame was damaged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum FrameError {
    /// No zero byte for longer than [`MAX_FRAME`].
    Overlong,
    /// Not a COBS sequence, or too short for a checksum.
    Framing,
    /// The checksum does not match.
    Checksum,
    /// Intact, but not a message of this protocol.
    Malformed,
}

impl core::fmt::Display for FrameError {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Self::Overlong => write!(f, "the frame is longer than {MAX_FRAME} bytes"),
            Self::Framing => f.write_str("the frame is not a COBS sequence, or too short for its checksum"),
            Self::Checksum => f.write_str("the frame's checksum does not match"),
            Self::Malformed => f.write_str("the frame is intact, but not a message of this protocol"),
        }
    }
}

impl core::error::Error for FrameError {}

/// Counts of a [`Decoder`] since its creation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct FrameCounts {
    /// Intact messages.
    pub good: u32,
    /// See [`FrameError::Overlong`].
    pub overlong: u32,
    /// See [`FrameError::Framing`].
    pub framing: u32,
    /// See [`FrameError::Checksum`].
    pub checksum: u32,
    /// See [`FrameError::Malformed`].
    pub malformed: u32,
}

impl FrameCounts {
    /// Number of frames that gave no message.
    #[must_use]
    pub const fn damaged(&self) -> u32 {
        let Self { good: _, overlong, framing, checksum, malformed } = *self;
        overlong.wrapping_add(framing).wrapping_add(checksum).wrapping_add(malformed)
    }
}

/// Collects bytes into frames and frames into messages.
#[derive(Clone, Debug)]
pub struct Decoder {
    buffer: [u8; MAX_FRAME],
    length: usize,
    /// Set when a frame is too long, until its end.
    skipping: bool,
    counts: FrameCounts,
}

impl Default for Decoder {
    fn default() -> Self {
        Self::new()
    }
}

impl Decoder {
    /// An empty decoder.
    pub const fn new() -> Self {
        Self {
            buffer: [0; MAX_FRAME],
            length: 0,
            skipping: false,
            counts: FrameCounts { good: 0, overlong: 0, framing: 0, checksum: 0, malformed: 0 },
        }
    }

    /// Adds one received byte. Returns the message or its error at the end of a frame, else `None`.
    #[inline]
    pub fn push<T: DeserializeOwned>(&mut self, byte: u8) -> Option<Result<T, FrameError>> {
        // Split, so that bytes that do not end a frame need no memory for a message.
        if self.collect(&[byte]) { Some(self.message()) } else { None }
    }

    /// Takes received bytes up to the end of the first frame, and leaves the others in `bytes`. Returns
    /// `true` if a frame ends in them; decode it with [`message`](Self::message).
    pub fn take(&mut self, bytes: &mut &[u8]) -> bool {
        while let Some((frame, rest)) = find_zero(bytes).and_then(|end| bytes.split_at_checked(end)) {
            *bytes = rest.get(1..).unwrap_or_default();
            self.collect(frame);
            if self.collect(&[0]) {
                return true;
            }
        }
        self.collect(take(bytes));
        false
    }

    /// Stores a part of a frame, or registers its end, a zero. Returns whether a frame is complete.
    #[inline]
    fn collect(&mut self, bytes: &[u8]) -> bool {
        if let [0] = bytes {
            return self.length > 0; // zeros between frames are padding
        }
        let end = self.length.saturating_add(bytes.len());
        match self.buffer.get_mut(self.length..end) {
            Some(free) => {
                copy(free, bytes);
                self.length = end;
            }
            None => (self.skipping, self.length) = (true, MAX_FRAME),
        }
        false
    }

    /// Decodes the frame that [`take`](Self::take) completed.
    ///
    /// # Errors
    /// How the frame was damaged; without a frame, [`FrameError::Framing`].
    #[inline(never)]
    pub fn message<T: DeserializeOwned>(&mut self) -> Result<T, FrameError> {
        let length = take(&mut self.length);
        let opened = if take(&mut self.skipping) {
            Err(FrameError::Overlong)
        } else {
            self.buffer.get_mut(..length).ok_or(FrameError::Overlong).and_then(open)
        };
        let counts = &mut self.counts;
        let (error, count) = match opened {
            Ok(bytes) => {
                let mut bytes = postcard::Deserializer::from_bytes(bytes);
                if let Ok(message) = T::deserialize(&mut bytes)
                    && bytes.finalize().is_ok_and(<[u8]>::is_empty)
                {
                    counts.good = counts.good.wrapping_add(1);
                    return Ok(message);
                }
                (FrameError::Malformed, &mut counts.malformed)
            }
            Err(FrameError::Overlong) => (FrameError::Overlong, &mut counts.overlong),
            Err(FrameError::Framing) => (FrameError::Framing, &mut counts.framing),
            Err(FrameError::Checksum) => (FrameError::Checksum, &mut counts.checksum),
            Err(FrameError::Malformed) => (FrameError::Malformed, &mut counts.malformed),
        };
        *count = count.wrapping_add(1);
        Err(error)
    }

    /// Counts of the received frames.
    pub const fn counts(&self) -> FrameCounts {
        self.counts
    }
}

/// Opens one frame (without its zero): COBS, then checksum. Returns the bytes of the message.
fn open(frame: &mut [u8]) -> Result<&[u8], FrameError> {
    let payload = unstuff(frame).ok_or(FrameError::Framing)?;
    let length = payload.len().checked_sub(CHECKSUM).ok_or(FrameError::Framing)?;
    let (message, crc) = payload.split_at_checked(length).ok_or(FrameError::Framing)?;
    let crc = crc.first_chunk().ok_or(FrameError::Framing)?;
    if checksum(message) == u32::from_le_bytes(*crc) { Ok(message) } else { Err(FrameError::Checksum) }
}

/// Copies slices of equal length, four bytes per iteration: `copy_from_slice` copies byte by byte on the
/// microcontroller when the alignments differ.
#[inline]
fn copy(to: &mut [u8], from: &[u8]) {
    let (to, to_rest) = to.as_chunks_mut::<4>();
    let (from, from_rest) = from.as_chunks::<4>();
    for (to, from) in to.iter_mut().zip(from) {
        *to = *from;
    }
    for (to, from) in to_rest.iter_mut().zip(from_rest) {
        *to = *from;
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::cast_possible_truncation, reason = "tests")]
mod tests {
    use tesaki_rng::Rng;

    use super::*;
    use crate::protocol::{ActuatorFrame, Request, RequestFrame};

    fn frame() -> ActuatorFrame {
        let torques = [0.0, -0.25, 0.5].into_iter().collect();
        ActuatorFrame { sequence: 300, enabled: true, torques }
    }

    fn encoded<T: Serialize>(message: &T) -> Vec<u8> {
        let mut buffer = [0; MAX_FRAME];
        let length = encode(message, &mut buffer).unwrap();
        buffer[..length].to_vec()
    }

    fn decoded(bytes: &[u8]) -> Vec<Result<ActuatorFrame, FrameError>> {
        let mut decoder = Decoder::new();
        bytes.iter().filter_map(|&byte| decoder.push(byte)).collect()
    }

    #[test]
    fn a_frame_has_the_bytes_worked_out_by_hand() {
        // Client 1, sequence 9, request 1 (Disable), each a varint: 01 09 01; CRC-32 of them from Python's
        // zlib, low byte first: fa 38 46 58; no zero among the seven bytes, so COBS puts an 8 in front.
        let bytes = encoded(&RequestFrame { client: 1, sequence: 9, request: Request::Disable });
        assert_eq!(bytes, [8, 1, 9, 1, 0xfa, 0x38, 0x46, 0x58, 0]);
        // The check value of CRC-32/ISO-HDLC.
        assert_eq!(checksum(b"123456789"), 0xcbf4_3926);
    }

    #[test]
    fn every_single_flipped_bit_and_every_truncation_is_rejected() {
        let good = encoded(&frame());
        assert_eq!(decoded(&good), [Ok(frame())]);
        for byte in 0..good.len() {
            for bit in 0..8 {
                let mut bad = good.clone();
                bad[byte] ^= 1 << bit;
                bad.push(0);
                assert!(decoded(&bad).iter().all(Result::is_err), "byte {byte} bit {bit}");
            }
        }
        for length in 0..good.len() - 1 {
            let mut short = good[..length].to_vec();
            short.push(0);
            assert!(decoded(&short).iter().all(Result::is_err), "cut at {length}");
        }
    }

    #[test]
    fn is_in_step_again_after_noise_and_counts_what_it_dropped() {
        let mut stream = vec![0x55; 2 * MAX_FRAME];
        stream.push(0);
        stream.extend([3, 1, 0]); // says three bytes, is one
        stream.extend(encoded(&RequestFrame { client: 1, sequence: 1, request: Request::Disable }));
        stream.extend(encoded(&frame()));
        let mut decoder = Decoder::new();
        let results: Vec<Result<ActuatorFrame, _>> =
            stream.iter().filter_map(|&byte| decoder.push(byte)).collect();
        assert_eq!(results.last(), Some(&Ok(frame())));
        let counts = decoder.counts();
        assert_eq!((counts.good, counts.overlong, counts.framing, counts.malformed), (1, 1, 1, 1));
    }

    #[test]
    fn the_longest_messages_fit() {
        use crate::control::JointPoint;
        use crate::fault::{Fault, FaultCause, FaultLog, MAX_FAULTS};
        use crate::model::MAX_JOINTS;
        use crate::protocol::{
            FromBoard, JointTelemetry, LogEntry, LogRecord, Mode, Reply, ReplyFrame, Telemetry,
        };
        let value = f32::MIN;
        let joint = JointTelemetry { position: value, velocity: value, reference: value, torque: value };
        let joints = [joint; MAX_JOINTS].into_iter().collect();
        let telemetry = Telemetry { tick: u32::MAX, mode: Mode::Fault, faults: u32::MAX, joints };
        assert!(encoded(&FromBoard::Telemetry(telemetry)).len() <= MAX_FRAME);
        let data = [255; crate::protocol::MODEL_CHUNK].into_iter().collect();
        let (client, sequence) = (u32::MAX, u16::MAX);
        encoded(&RequestFrame { client, sequence, request: Request::ModelChunk { offset: u32::MAX, data } });
        let point = JointPoint { position: value, velocity: value, acceleration: value };
        let points = [point; MAX_JOINTS].into_iter().collect();
        let torques = [value; MAX_JOINTS].into_iter().collect();
        use crate::task::TaskCommand;
        use crate::task::joint_servo::JointCommand;
        let request = Request::Task(TaskCommand::JointServo(JointCommand::StreamTorques { points, torques }));
        let record = LogRecord::Request(RequestFrame { client, sequence, request });
        encoded(&FromBoard::Log(LogEntry { index: u32::MAX, record }));
        let mut log = FaultLog::new();
        for _ in 0..MAX_FAULTS {
            log.record(Fault {
                cause: FaultCause::Stop,
                joint: Some(255),
                value,
                limit: value,
                tick: u32::MAX,
            });
        }
        log.total = u32::MAX;
        let reply = ReplyFrame { client, sequence, tick: u32::MAX, reply: Reply::Faults(log) };
        encoded(&FromBoard::Reply(reply));
    }

    #[test]
    fn what_a_board_sends_has_the_bytes_of_postcard() {
        use crate::protocol::{FromBoard, JointTelemetry, Mode, Reply, ReplyFrame, Telemetry};
        let joint = JointTelemetry { position: 0.25, velocity: -1.0, reference: 0.0, torque: f32::MAX };
        let joints = [joint; 3].into_iter().collect();
        let telemetry = Telemetry { tick: 123_456, mode: Mode::Disabled, faults: 300, joints };
        let data = [0, 1, 255].into_iter().collect();
        let reply = Reply::Chunk { offset: u32::MAX, data };
        let reply = ReplyFrame { client: 128, sequence: 127, tick: 0, reply };
        for message in [FromBoard::Telemetry(telemetry), FromBoard::Reply(reply)] {
            let mut buffer = [0; MAX_FRAME];
            let length = message.encode(&mut buffer).unwrap();
            let payload = unstuff(&mut buffer[..length - 1]).unwrap();
            let (bytes, _) = payload.split_at(payload.len() - CHECKSUM);
            assert_eq!(bytes, postcard::to_stdvec(&message).unwrap());
            for room in 0..bytes.len() {
                assert_eq!(
                    to_slice(&message, &mut [0; MAX_MESSAGE][..room]),
                    Err(postcard::Error::SerializeBufferFull)
                );
                assert_eq!(message.encode(&mut [0; MAX_FRAME][..room]), Err(TooLong));
            }
        }
    }

    /// Random bytes with this percentage of zeros.
    fn noise(length: usize, zeros: u32, seed: u64) -> Vec<u8> {
        let mut rng = Rng::new(seed, 0);
        (0..length).map(|_| if rng.below(100) < zeros { 0 } else { (rng.below(255) + 1) as u8 }).collect()
    }

    #[test]
    fn cobs_and_checksum_agree_with_the_crates_of_that_name() {
        let crc = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC);
        for length in (0..40).chain(250..260).chain(500..520) {
            for zeros in [0, 1, 30, 100] {
                let payload = noise(length, zeros, length as u64 + 1000 * u64::from(zeros));
                assert_eq!(checksum(&payload), crc.checksum(&payload));
                if payload.is_empty() {
                    continue;
                }
                let mut frame = vec![0];
                frame.extend(&payload);
                frame.extend([0; 8]);
                let end = stuff(&mut frame, 1 + length).unwrap();
                assert_eq!(frame[..end], cobs::encode_vec(&payload), "{length} bytes, {zeros} % zeros");
                assert_eq!(unstuff(&mut frame[..end]), Some(&*payload));
            }
        }
    }

    #[test]
    fn frames_are_found_in_slices_as_byte_by_byte() {
        let mut stream = noise(3000, 3, 1);
        for _ in 0..20 {
            stream.extend(encoded(&frame()));
            stream.extend(noise(13, 30, 2));
            stream.push(0);
        }
        let mut by_byte = Decoder::new();
        let one: Vec<Result<ActuatorFrame, _>> =
            stream.iter().filter_map(|&byte| by_byte.push(byte)).collect();
        for step in [1, 7, 64, 5000] {
            let (mut decoder, mut all) = (Decoder::new(), Vec::new());
            for mut bytes in stream.chunks(step) {
                while decoder.take(&mut bytes) {
                    all.push(decoder.message::<ActuatorFrame>());
                }
            }
            assert_eq!((&all, decoder.counts()), (&one, by_byte.counts()), "{step} bytes at a time");
        }
        assert!(one.iter().filter(|result| result.is_ok()).count() >= 10);
    }
}
