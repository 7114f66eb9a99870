//! A file that ends as an MCAP file should after every flush, so that every reader opens it when its writer
//! was killed.

use std::fs::File;
use std::io::{BufWriter, Result, Seek, SeekFrom, Write};

/// First and last bytes of an MCAP file.
const MAGIC: [u8; 8] = *b"\x89MCAP0\r\n";

/// What follows the data of a file without summary: the records `DataEnd` (0x0f, with 4 bytes) and `Footer`
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

/// From behind [`END`] to its start.
const BACK: SeekFrom = SeekFrom::Current(-50);

/// Each flush puts an end behind the data, and the next data overwrite it.
pub struct EndedFile {
    file: BufWriter<File>,
    /// Whether [`END`] stands in the file, behind the data.
    is_ended: bool,
    /// The last bytes written: a file that ends with the magic has an end of its own.
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
