//! The bytes of a fault log, which boards keep over a reset.

use super::to_slice;
use crate::fault::FaultLog;

impl FaultLog {
    /// Bytes of the longest [encoding](Self::to_bytes): 16 faults of 16 bytes, their number and two of 5
    /// bytes, rounded up to words.
    pub const MAX_BYTES: usize = 268;

    /// Encodes the log and the checksum of its joints; `None` if the buffer is shorter than
    /// [`MAX_BYTES`](Self::MAX_BYTES) and than they need.
    pub fn to_bytes<'a>(&self, joints: u32, buffer: &'a mut [u8]) -> Option<&'a [u8]> {
        let length = to_slice(&(self, joints), buffer).ok()?;
        buffer.get(..length)
    }

    /// The inverse of [`to_bytes`](Self::to_bytes); `None` if these are no such bytes.
    pub fn from_bytes(bytes: &[u8]) -> Option<(Self, u32)> {
        postcard::from_bytes(bytes).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fault::{Fault, FaultCause, MAX_FAULTS};

    #[test]
    fn the_longest_log_has_a_place_for_its_bytes() {
        let mut log = FaultLog::new();
        let (value, limit) = (-1.0, f32::MIN_POSITIVE);
        let longest = Fault { cause: FaultCause::Stop, joint: Some(255), value, limit, tick: u32::MAX };
        (0..MAX_FAULTS).for_each(|_| log.record(longest));
        log.total = u32::MAX;
        let mut buffer = [0; FaultLog::MAX_BYTES];
        let bytes = log.to_bytes(u32::MAX, &mut buffer).expect("fits");
        assert!(bytes.len() + size_of::<u32>() > FaultLog::MAX_BYTES, "{}", bytes.len());
        assert_eq!(FaultLog::from_bytes(bytes), Some((log.clone(), u32::MAX)));
        assert_eq!(FaultLog::from_bytes(&bytes[..bytes.len() - 1]), None);
        assert_eq!(log.to_bytes(u32::MAX, &mut [0; 100]), None);
    }
}
