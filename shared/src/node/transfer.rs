#![expect(
    clippy::cast_possible_truncation,
    reason = "no model is longer than MAX_MODEL bytes, no request longer than a frame"
)]

use heapless::Vec;

use super::export::MAX_MODEL;
use crate::model::{ModelError, RobotModel};
use crate::protocol::{Refusal, codec};
use crate::robot::Robot;

/// Transfer of a model to the board in chunks.
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

    /// Begins the transfer of `length` bytes.
    pub fn begin(&mut self, length: u32, checksum: u32) -> Result<(), Refusal> {
        let limit = MAX_MODEL as u32;
        if length == 0 || length > limit {
            return Err(Refusal::ModelUnreadable { length, limit });
        }
        self.bytes.clear();
        (self.length, self.checksum) = (length, checksum);
        Ok(())
    }

    /// Adds the chunk at `offset`. A repeated chunk replaces the first one.
    pub fn chunk(&mut self, offset: u32, data: &[u8]) -> Result<(), Refusal> {
        let received = self.bytes.len() as u32;
        let refusal = Refusal::ModelTransfer { received, announced: self.length };
        let end = offset.checked_add(data.len() as u32).ok_or(refusal)?;
        if end > self.length || offset > received {
            return Err(refusal);
        }
        self.bytes.truncate(offset as usize);
        self.bytes.extend_from_slice(data).map_err(|_| refusal)
    }

    /// Checks the complete model, asks the board, and configures `robot` with it.
    #[inline(never)]
    pub fn commit(
        &self,
        robot: &mut Robot,
        board: &mut dyn FnMut(&RobotModel) -> Result<(), ModelError>,
    ) -> Result<Committed, Refusal> {
        let length = self.bytes.len() as u32;
        if length != self.length || length == 0 {
            return Err(Refusal::ModelTransfer { received: length, announced: self.length });
        }
        let received = codec::checksum(&self.bytes);
        if received != self.checksum {
            return Err(Refusal::ModelChecksum { received, announced: self.checksum });
        }
        match postcard::take_from_bytes::<RobotModel>(&self.bytes) {
            Ok((model, [])) => {
                let mut same_encoders = 0;
                for (index, old) in robot.model().joints.iter().enumerate() {
                    let new = model.joints.get(index).filter(|new| new.name == old.name);
                    same_encoders |= u16::from(new.is_some_and(|new| new.encoder == old.encoder)) << index;
                }
                let names = model.joints.iter().fold(0_u32, |names, joint| {
                    names.rotate_left(1) ^ codec::checksum(joint.name.as_bytes())
                });
                robot.configure_on(&model, board).map_err(Refusal::Model)?;
                Ok(Committed { checksum: received, same_encoders, names })
            }
            _ => Err(Refusal::ModelUnreadable { length, limit: MAX_MODEL as u32 }),
        }
    }
}

/// Result of [`Transfer::commit`].
pub(super) struct Committed {
    /// The model's checksum.
    pub checksum: u32,
    /// Bit `i` is set when name and encoder of joint `i` are unchanged.
    pub same_encoders: u16,
    /// Checksum of the names of all joints.
    pub names: u32,
}
