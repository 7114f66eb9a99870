use heapless::Vec;
use postcard_schema::Schema;
use serde::Serialize;

use super::state::State;
use crate::model::RobotModel;
use crate::protocol::{EXPORT_CHUNK, Refusal, Reply, codec, longest, to_slice};

/// Longest postcard encoding of a [`State`] in bytes.
pub const MAX_STATE: usize = longest(State::SCHEMA);
/// Longest postcard encoding of a [`RobotModel`] in bytes.
pub const MAX_MODEL: usize = longest(RobotModel::SCHEMA);
/// Longest export in bytes.
const MAX_EXPORT: usize = if MAX_STATE > MAX_MODEL { MAX_STATE } else { MAX_MODEL };

/// A copy of the model or the state, read in chunks while the node continues.
#[derive(Clone, Debug)]
pub(super) struct Export {
    bytes: [u8; MAX_EXPORT],
    length: usize,
}

#[expect(clippy::cast_possible_truncation, reason = "no export is longer than MAX_EXPORT")]
impl Export {
    pub const fn new() -> Self {
        Self { bytes: [0; MAX_EXPORT], length: 0 }
    }

    /// Copies `item` after entry `index` of the log; `key` identifies its layout.
    #[inline(never)]
    pub fn begin<T: Serialize>(&mut self, item: &T, index: u32, key: u64) -> Result<Reply, Refusal> {
        self.length = 0;
        // Cannot fail: the buffer has the length of the longest encoding.
        self.length = to_slice(item, &mut self.bytes).map_err(|_| Refusal::NotExported { length: 0 })?;
        let checksum = codec::checksum(self.bytes.get(..self.length).unwrap_or_default());
        Ok(Reply::Exported { length: self.length as u32, checksum, index, key })
    }

    /// The chunk at `offset`.
    pub fn chunk(&self, offset: u32) -> Result<Reply, Refusal> {
        let refused = Refusal::NotExported { length: self.length as u32 };
        let first = usize::try_from(offset).map_err(|_| refused)?;
        let end = self.length.min(first.saturating_add(EXPORT_CHUNK));
        match self.bytes.get(first..end) {
            Some(bytes) if !bytes.is_empty() => {
                Ok(Reply::Chunk { offset, data: Vec::from_slice(bytes).map_err(|_| refused)? })
            }
            _ => Err(refused),
        }
    }
}
