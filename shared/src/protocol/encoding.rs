//! Postcard's encoding with functions that are called: inlined into every field of every message, as
//! [`postcard::to_slice`] does it, they take 20 KB of flash more.

use core::mem::take;

use postcard::ser_flavors::Flavor;
use postcard::{Error, Result};
use serde::Serialize;

/// Writes the postcard encoding of `value` to the start of `buffer` and returns its length.
///
/// # Errors
/// [`Error::SerializeBufferFull`].
pub fn to_slice<T: Serialize>(value: &T, buffer: &mut [u8]) -> Result<usize> {
    let length = buffer.len();
    let free = postcard::serialize_with_flavor(value, Free(buffer))?;
    Ok(length - free)
}

/// The part of a buffer behind what has been encoded.
struct Free<'a>(&'a mut [u8]);

impl Flavor for Free<'_> {
    /// Length of the free part.
    type Output = usize;

    #[inline(never)]
    fn try_push(&mut self, byte: u8) -> Result<()> {
        let (place, free) = take(&mut self.0).split_first_mut().ok_or(Error::SerializeBufferFull)?;
        (*place, self.0) = (byte, free);
        Ok(())
    }

    #[inline(always)]
    fn try_extend(&mut self, bytes: &[u8]) -> Result<()> {
        // Most are numbers of single precision.
        if let &[a, b, c, d] = bytes { self.push_word([a, b, c, d]) } else { self.push_all(bytes) }
    }

    fn finalize(self) -> Result<usize> {
        Ok(self.0.len())
    }
}

impl Free<'_> {
    #[inline(never)]
    fn push_word(&mut self, word: [u8; 4]) -> Result<()> {
        let (place, free) = take(&mut self.0).split_first_chunk_mut().ok_or(Error::SerializeBufferFull)?;
        (*place, self.0) = (word, free);
        Ok(())
    }

    #[inline(never)]
    fn push_all(&mut self, bytes: &[u8]) -> Result<()> {
        bytes.iter().try_for_each(|&byte| self.try_push(byte))
    }
}
