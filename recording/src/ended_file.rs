//! A file that is a valid MCAP file after every flush, so that every reader can open it even if its writer
//! was killed.

use std::fs::File;
use std::io::{BufWriter, Result, Seek, SeekFrom, Write};

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

/// Each flush writes an end after the data, which the next data overwrite.
pub struct EndedFile {
    file: BufWriter<File>,
    /// Whether [`END`] follows the data in the file.
    is_ended: bool,
    /// The last bytes written: data that end with the magic have their own end.
    last: [u8; MAGIC.len()],
}

impl EndedFile {
    pub fn new(file: File) -> Self {
        Self { file: BufWriter::new(file), is_ended: false, last: [0; MAGIC.len()] }
    }
}

impl Write for EndedFile {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        if self.is_ended {
            self.file.seek(BACK)?;
            self.is_ended = false;
        }
        let length = self.file.write(bytes)?;
        for &byte in bytes.iter().take(length).skip(length.saturating_sub(MAGIC.len())) {
            self.last.rotate_left(1);
            self.last[MAGIC.len() - 1] = byte;
        }
        Ok(length)
    }

    fn flush(&mut self) -> Result<()> {
        if !self.is_ended && self.last != MAGIC {
            self.file.write_all(&END)?;
            self.is_ended = true;
        }
        self.file.flush()
    }
}
