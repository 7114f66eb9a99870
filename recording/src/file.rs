use std::collections::BTreeMap;
use std::fs::File;
use std::io::Write;
use std::path::Path;

use ::mcap::records::{MessageHeader, Metadata};
use ::mcap::write::NoSeek;
use ::mcap::{Compression, WriteOptions, Writer};

use crate::ended_file::EndedFile;
use crate::{McapError, Publisher, Sink, Topic};

/// Interval of recorded time at which data are flushed to the operating system [ns].
const FLUSH_INTERVAL: u64 = 1_000_000_000;

/// Returns rosbag2's `offered_qos_profiles` for one reliable publisher. Policies are numbers, which every
/// version of rosbag2 reads; versions before Jazzy do not know names.
fn quality_of_service(depth: u32, transient_local: bool) -> String {
    let durability = if transient_local { 1 } else { 2 };
    let forever = "\n    sec: 9223372036\n    nsec: 854775807";
    format!(
        "- history: 1\n  depth: {depth}\n  reliability: 1\n  durability: {durability}\n  deadline:{forever}\n  \
         lifespan:{forever}\n  liveliness: 1\n  liveliness_lease_duration:{forever}\n  \
         avoid_ros_namespace_conventions: false"
    )
}

/// A recording being written. If the program dies, at most a second of recorded time is lost, and the file
/// has no index. If the recording is dropped without [`finish`](Publisher::finish), the file is completed,
/// but errors are ignored.
pub type Recording = Publisher<McapFile>;

/// A file in MCAP.
pub struct McapFile {
    writer: Writer<NoSeek<EndedFile>>,
    flushed: Option<u64>,
}

impl McapFile {
    fn create(path: &Path, compression: Option<Compression>) -> Result<Self, McapError> {
        let file =
            File::create(path).map_err(|source| McapError::Create { path: path.to_owned(), source })?;
        // Without seeking, chunks are written whole: one that is cut short is just missing.
        let writer = WriteOptions::new()
            .profile("ros2")
            .library(concat!("tesaki/", env!("CARGO_PKG_VERSION")))
            .compression(compression)
            .disable_seeking(true)
            .create(NoSeek::new(EndedFile::new(file)))?;
        Ok(Self { writer, flushed: None })
    }
}

impl Sink for McapFile {
    fn open(&mut self, topic: Topic) -> Result<u16, McapError> {
        let schema = self.writer.add_schema(topic.schema, "ros2msg", topic.definition.as_bytes())?;
        let metadata = BTreeMap::from([
            ("offered_qos_profiles".to_owned(), quality_of_service(topic.depth, topic.transient_local)),
            ("topic_type_hash".to_owned(), topic.hash.to_owned()),
        ]);
        Ok(self.writer.add_channel(schema, &topic.name, "cdr", &metadata)?)
    }

    fn write(&mut self, topic: u16, sequence: u32, time: u64, message: &[u8]) -> Result<(), McapError> {
        let header = MessageHeader { channel_id: topic, sequence, log_time: time, publish_time: time };
        self.writer.write_to_known_channel(&header, message)?;
        // A flush is also due if the clock was set back.
        if self.flushed.is_none_or(|flushed| time.abs_diff(flushed) >= FLUSH_INTERVAL) {
            self.flushed = Some(time);
            self.writer.flush()?;
        }
        Ok(())
    }
}

impl Recording {
    /// Starts the file `path`, replacing an existing one. The robot's URDF goes before all other messages.
    pub fn create(path: impl AsRef<Path>, urdf: Option<&str>) -> Result<Self, McapError> {
        Ok(Self::new(McapFile::create(path.as_ref(), None)?, urdf))
    }

    /// As [`create`](Self::create), with the data of each second compressed by zstd.
    #[cfg(feature = "zstd")]
    pub fn create_compressed(path: impl AsRef<Path>, urdf: Option<&str>) -> Result<Self, McapError> {
        Ok(Self::new(McapFile::create(path.as_ref(), Some(Compression::Zstd))?, urdf))
    }

    /// Writes metadata about the recording under a name.
    pub fn metadata(&mut self, name: &str, entries: BTreeMap<String, String>) -> Result<(), McapError> {
        self.sink.writer.write_metadata(&Metadata { name: name.to_owned(), metadata: entries })?;
        self.flush()
    }

    /// Flushes everything so far to the operating system.
    pub fn flush(&mut self) -> Result<(), McapError> {
        Ok(self.sink.writer.flush()?)
    }

    /// Ends the file with its summary and indexes.
    pub fn finish(mut self) -> Result<(), McapError> {
        self.write_description(0)?;
        self.sink.writer.finish()?;
        Ok(self.sink.writer.into_inner().flush().map_err(::mcap::McapError::from)?)
    }
}
