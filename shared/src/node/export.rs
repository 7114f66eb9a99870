use heapless::Vec;
use serde::Serialize;

use crate::protocol::{EXPORT_CHUNK, Refusal, Reply, codec};

/// Longest export in bytes: a model or a state of sixteen joints.
const MAX_EXPORT: usize = 4096;

/// A copy of something the node has, to be read piece by piece while the node goes on.
#[derive(Clone, Debug)]
pub(super) struct Export {
    bytes: [u8; MAX_EXPORT],
    length: usize,
}

impl Export {
    pub const fn new() -> Self {
        Self { bytes: [0; MAX_EXPORT], length: 0 }
    }

    /// Copies `item`.
    #[inline(never)]
    pub fn begin<T: Serialize>(&mut self, item: &T, index: u32) -> Reply {
        // Cannot fail: both items are shorter by their types (see the tests).
        self.length = postcard::to_slice(item, &mut self.bytes).map_or(0, |bytes| bytes.len());
        let bytes = self.bytes.get(..self.length).unwrap_or_default();
        #[expect(clippy::cast_possible_truncation, reason = "at most 4096")]
        Reply::Exported { length: self.length as u32, checksum: codec::checksum(bytes), index }
    }

    /// The piece at `offset`.
    pub fn chunk(&self, offset: u32) -> Result<Reply, Refusal> {
        #[expect(clippy::cast_possible_truncation, reason = "at most 4096")]
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
