#![expect(
    clippy::cast_possible_truncation,
    reason = "no model is longer than 4096 bytes, no request longer than 320"
)]

use heapless::Vec;

use crate::model::RobotModel;
use crate::node::Robot;
use crate::protocol::{Refusal, codec};

/// Longest postcard encoding of a model in bytes.
const MAX_MODEL: usize = 4096;

/// A model on its way to the board, chunk by chunk.
#[derive(Clone, Debug)]
pub(super) struct Transfer {
    bytes: Vec<u8, MAX_MODEL>,
    length: u32,
    checksum: u32,
}

impl Transfer {
    pub const fn new() -> Self {
        Self { bytes: Vec::new(), length: 0, checksum: 0 }
    }

    /// A model of `length` bytes follows.
    pub fn begin(&mut self, length: u32, checksum: u32) -> Result<(), Refusal> {
        let limit = MAX_MODEL as u32;
        if length == 0 || length > limit {
            return Err(Refusal::ModelUnreadable { length, limit });
        }
        self.bytes.clear();
        (self.length, self.checksum) = (length, checksum);
        Ok(())
    }

    /// Takes the piece at `offset`; one that is there already is taken again.
    pub fn chunk(&mut self, offset: u32, data: &[u8]) -> Result<(), Refusal> {
        let received = self.bytes.len() as u32;
        let out_of_step = Refusal::ModelTransfer { received, announced: self.length };
        let end = offset.checked_add(data.len() as u32).ok_or(out_of_step)?;
        if end > self.length || offset > received {
            return Err(out_of_step);
        }
        self.bytes.truncate(offset as usize);
        self.bytes.extend_from_slice(data).map_err(|_| out_of_step)
    }

    /// Makes `robot` that of the finished model; returns the model's checksum.
    #[inline(never)]
    pub fn commit(&self, robot: &mut Robot) -> Result<u32, Refusal> {
        let length = self.bytes.len() as u32;
        if length != self.length || length == 0 {
            return Err(Refusal::ModelTransfer { received: length, announced: self.length });
        }
        let received = codec::checksum(&self.bytes);
        if received != self.checksum {
            return Err(Refusal::ModelChecksum { received, announced: self.checksum });
        }
        match postcard::take_from_bytes::<RobotModel>(&self.bytes) {
            Ok((model, [])) => robot.configure(&model).map(|()| received).map_err(Refusal::Model),
            _ => Err(Refusal::ModelUnreadable { length, limit: MAX_MODEL as u32 }),
        }
    }
}
