//! Framing: `COBS(postcard(message) ‖ CRC-32) ‖ 0x00`.
//!
//! The CRC (CRC-32/ISO-HDLC, little endian) is checked before a byte of the message is interpreted. A zero byte
//! ends a frame and occurs nowhere else, so a receiver that joins in the middle, or that lost bytes, is in step again
//! at the next zero. Damaged frames are counted by kind and dropped.

use crc::{CRC_32_ISO_HDLC, Crc, Table};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize, de::DeserializeOwned};

/// Longest postcard encoding of a message in bytes.
pub const MAX_MESSAGE: usize = 320;
/// Longest frame in bytes, the closing zero included.
pub const MAX_FRAME: usize = MAX_MESSAGE + 4 + (MAX_MESSAGE + 4).div_ceil(254) + 1;

// A static, so that the table lies in flash once and is not copied to the stack at each use.
static CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

/// The checksum of frames and of pushed models: CRC-32/ISO-HDLC.
pub fn checksum(bytes: &[u8]) -> u32 {
    CRC.checksum(bytes)
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
    let mut buffer = [0; MAX_MESSAGE + 4];
    let length = postcard::to_slice(message, &mut buffer[..MAX_MESSAGE]).map_err(|_| TooLong)?.len();
    let crc = checksum(buffer.get(..length).ok_or(TooLong)?);
    buffer.get_mut(length..length + 4).ok_or(TooLong)?.copy_from_slice(&crc.to_le_bytes());
    let encoded = cobs::try_encode(buffer.get(..length + 4).ok_or(TooLong)?, frame).map_err(|_| TooLong)?;
    *frame.get_mut(encoded).ok_or(TooLong)? = 0;
    Ok(encoded + 1)
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

/// What a [`Decoder`] has seen since it was made.
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

    /// Takes one received byte. `None` until a frame ends; then its message, or what was wrong with it.
    #[inline]
    pub fn push<T: DeserializeOwned>(&mut self, byte: u8) -> Option<Result<T, FrameError>> {
        // Split so that the many bytes that end no frame never touch a place for a message.
        if self.feed(byte) { Some(self.decode()) } else { None }
    }

    /// Takes one received byte and says whether it ends a frame.
    #[inline]
    fn feed(&mut self, byte: u8) -> bool {
        if byte == 0 {
            return self.length > 0; // zeros between frames are padding
        }
        match self.buffer.get_mut(self.length) {
            Some(slot) => {
                *slot = byte;
                self.length += 1;
            }
            None => self.skipping = true,
        }
        false
    }

    #[inline(never)]
    fn decode<T: DeserializeOwned>(&mut self) -> Result<T, FrameError> {
        let length = core::mem::take(&mut self.length);
        let result = if core::mem::take(&mut self.skipping) {
            Err(FrameError::Overlong)
        } else {
            self.buffer.get_mut(..length).ok_or(FrameError::Overlong).and_then(open)
        };
        let count = match result {
            Ok(_) => &mut self.counts.good,
            Err(FrameError::Overlong) => &mut self.counts.overlong,
            Err(FrameError::Framing) => &mut self.counts.framing,
            Err(FrameError::Checksum) => &mut self.counts.checksum,
            Err(FrameError::Malformed) => &mut self.counts.malformed,
        };
        *count = count.wrapping_add(1);
        result
    }

    /// What has been received so far.
    pub const fn counts(&self) -> FrameCounts {
        self.counts
    }
}

/// Opens one frame (without its zero): COBS, then checksum, then the message, which must fill it exactly.
fn open<T: DeserializeOwned>(frame: &mut [u8]) -> Result<T, FrameError> {
    let length = cobs::decode_in_place(frame).map_err(|_| FrameError::Framing)?;
    let payload = frame.get(..length).ok_or(FrameError::Framing)?;
    let (message, crc) = payload.split_last_chunk::<4>().ok_or(FrameError::Framing)?;
    if checksum(message) != u32::from_le_bytes(*crc) {
        return Err(FrameError::Checksum);
    }
    match postcard::take_from_bytes(message) {
        Ok((value, [])) => Ok(value),
        _ => Err(FrameError::Malformed),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
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
        // Sequence 9 as a varint: 09; request 6 (Disarm): 06; CRC-32 of 09 06 from Python's zlib, low byte first:
        // 83 0c 78 79; no zero among the six bytes, so COBS puts a 7 in front.
        let bytes = encoded(&RequestFrame { sequence: 9, request: Request::Disarm });
        assert_eq!(bytes, [7, 9, 6, 0x83, 0x0c, 0x78, 0x79, 0]);
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
        stream.extend(encoded(&RequestFrame { sequence: 1, request: Request::Disarm }));
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
        use crate::model::MAX_JOINTS;
        use crate::protocol::{FromBoard, Mode, Telemetry};
        let list = || [f32::MIN; MAX_JOINTS].into_iter().collect();
        let telemetry = Telemetry {
            tick: u32::MAX,
            mode: Mode::Fault,
            faults: u32::MAX,
            positions: list(),
            velocities: list(),
            references: list(),
            torques: list(),
        };
        assert!(encoded(&FromBoard::Telemetry(telemetry)).len() <= MAX_FRAME);
        let data = [255; crate::protocol::MODEL_CHUNK].into_iter().collect();
        encoded(&RequestFrame {
            sequence: u16::MAX,
            request: Request::ModelChunk { offset: u32::MAX, data },
        });
    }
}
