//! A file that is a valid MCAP file after every flush, so that every reader can open it even if its writer
//! was killed.

use std::fs::File;
use std::io::{BufWriter, Error, Result, Seek, SeekFrom, Write};

/// First and last bytes of an MCAP file.
const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";

/// The end of a file without summary, after the data: the records `DataEnd` (0x0f, with 4 bytes) and `Footer`
/// (0x02, with 20 bytes), all fields 0, and the magic.
const END: [u8; 50] = {
    let mut end = [0; 50];
    end[0] = 0x0f;
    end[1] = 4;
    end[13] = 0x02;
    end[14] = 20;
    let mut index = 0;
    while index < MAGIC.len() {
        end[42 + index] = MAGIC[index];
        index += 1;
    }
    end
};

/// Seeks from the end of [`END`] back to its start.
const BACK: SeekFrom = SeekFrom::Current(-50);

/// Each flush writes an end after the data, which the next data overwrite. After an error, as of a full disk,
/// the file has what it had at the last flush.
pub struct EndedFile {
    /// `None` after an error.
    file: Option<BufWriter<File>>,
    /// Number of bytes of data, and of those at the last flush.
    length: u64,
    flushed: u64,
    /// Whether [`END`] follows the data in the file.
    is_ended: bool,
    /// The last bytes written: data that end with the magic have their own end.
    last: [u8; MAGIC.len()],
}

impl EndedFile {
    pub fn new(file: File) -> Self {
        Self {
            file: Some(BufWriter::new(file)),
            length: 0,
            flushed: 0,
            is_ended: false,
            last: [0; MAGIC.len()],
        }
    }

    /// Does something with the file, unless there was an error before.
    fn attempt<T>(&mut self, action: impl FnOnce(&mut BufWriter<File>) -> Result<T>) -> Result<T> {
        let Some(file) = &mut self.file else { return Err(Error::other("it was ended by an error before")) };
        let result = action(file);
        if result.is_err()
            && let Some(file) = self.file.take()
        {
            // What is in the buffer is dropped.
            let (mut file, _) = file.into_parts();
            // The error that is returned is that of the data.
            let _ = file.set_len(self.flushed).and_then(|()| {
                file.seek(SeekFrom::Start(self.flushed))?;
                file.write_all(&END)
            });
        }
        result
    }
}

impl Write for EndedFile {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        let is_ended = std::mem::take(&mut self.is_ended);
        let length = self.attempt(|file| {
            if is_ended {
                file.seek(BACK)?;
            }
            file.write(bytes)
        })?;
        self.length += length as u64;
        for &byte in bytes.iter().take(length).skip(length.saturating_sub(MAGIC.len())) {
            self.last.rotate_left(1);
            self.last[MAGIC.len() - 1] = byte;
        }
        Ok(length)
    }

    fn flush(&mut self) -> Result<()> {
        let is_ended = self.is_ended || self.last == MAGIC;
        self.attempt(|file| {
            if !is_ended {
                file.write_all(&END)?;
            }
            file.flush()
        })?;
        self.is_ended |= !is_ended;
        self.flushed = self.length;
        Ok(())
    }
}
