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

const CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISO_HDLC);

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
    pub fn push<T: DeserializeOwned>(&mut self, byte: u8) -> Option<Result<T, FrameError>> {
        if byte != 0 {
            match self.buffer.get_mut(self.length) {
                Some(slot) => {
                    *slot = byte;
                    self.length += 1;
                }
                None => self.skipping = true,
            }
            return None;
        }
        let length = core::mem::take(&mut self.length);
        let result = if core::mem::take(&mut self.skipping) {
            Err(FrameError::Overlong)
        } else if length == 0 {
            return None; // zeros between frames are padding
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
        Some(result)
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
