use std::collections::BTreeMap;

use crate::{McapError, Sink, Topic};

/// A message for live viewers.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LiveMessage {
    /// Index of its topic in [`Live::topics`].
    pub topic: u16,
    /// Its time [ns since 1970].
    pub time: u64,
    /// The message in CDR.
    pub data: Vec<u8>,
}

/// Messages for live viewers: they wait here until they are taken.
#[derive(Debug, Default)]
pub struct Live {
    topics: Vec<Topic>,
    waiting: Vec<LiveMessage>,
    /// The last message of each topic that keeps it for late subscribers.
    kept: BTreeMap<u16, LiveMessage>,
}

impl Live {
    /// Returns the topics so far.
    pub fn topics(&self) -> &[Topic] {
        &self.topics
    }

    /// Returns the messages written since the last call.
    pub fn take(&mut self) -> Vec<LiveMessage> {
        std::mem::take(&mut self.waiting)
    }

    /// Returns the last message of a topic that keeps it for late subscribers.
    pub fn kept(&self, topic: u16) -> Option<&LiveMessage> {
        self.kept.get(&topic)
    }
}

impl Sink for Live {
    fn open(&mut self, topic: Topic) -> Result<u16, McapError> {
        let number = u16::try_from(self.topics.len()).map_err(|_| McapError::TooManyTopics)?;
        self.topics.push(topic);
        Ok(number)
    }

    fn write(&mut self, topic: u16, _sequence: u32, time: u64, data: &[u8]) -> Result<(), McapError> {
        let message = LiveMessage { topic, time, data: data.to_vec() };
        if self.topics.get(usize::from(topic)).is_some_and(|topic| topic.transient_local) {
            self.kept.insert(topic, message.clone());
        }
        self.waiting.push(message);
        Ok(())
    }
}
