//! MCAP files, read back with the crate's reader.

use std::collections::BTreeMap;

use foxglove::Decode;
use foxglove::messages::Log;
use foxglove::messages::log::Level;
use mcap::records::Metadata;
use mcap::{MessageStream, Summary};
use serde_json::Value;

use crate::tiny_log::TinyLog;

/// Content of a file: encoded messages with their times by topic, and metadata records by name.
#[derive(PartialEq)]
pub(crate) struct McapFile {
    pub(crate) topics: BTreeMap<String, Vec<(u64, Vec<u8>)>>,
    pub(crate) metadata: BTreeMap<String, BTreeMap<String, String>>,
}

impl McapFile {
    pub(crate) fn of(log: &TinyLog, name: &str) -> Self {
        let bytes = std::fs::read(log.path(name)).unwrap();
        let mut topics: BTreeMap<String, Vec<(u64, Vec<u8>)>> = BTreeMap::new();
        let mut last = 0;
        for message in MessageStream::new(&bytes).unwrap().map(Result::unwrap) {
            let schema = message.channel.schema.as_ref().unwrap();
            assert!(schema.name.starts_with("foxglove.") && schema.encoding == "protobuf", "{}", schema.name);
            assert!(message.log_time >= last && message.log_time == message.publish_time);
            last = message.log_time;
            let of_topic = topics.entry(message.channel.topic.clone()).or_default();
            of_topic.push((message.log_time, message.data.into_owned()));
        }
        let summary = Summary::read(&bytes).unwrap().unwrap();
        let count: usize = topics.values().map(Vec::len).sum();
        assert_eq!(summary.stats.unwrap().message_count, count as u64);
        let record = |index| mcap::read::metadata(&bytes, index).unwrap();
        let named = |Metadata { name, metadata }| (name, metadata);
        Self { topics, metadata: summary.metadata_indexes.iter().map(record).map(named).collect() }
    }

    pub(crate) fn decoded<M: Decode>(&self, topic: &str) -> Vec<(u64, M)> {
        let messages = self.topics.get(topic).into_iter().flatten();
        messages.map(|(time, bytes)| (*time, M::decode(bytes.as_slice()).ok().unwrap())).collect()
    }

    /// Returns the messages of `/log`: time, level, source, text.
    pub(crate) fn events(&self) -> Vec<(u64, Level, String, String)> {
        let messages = self.decoded::<Log>("/log").into_iter();
        messages.map(|(time, log)| (time, log.level.try_into().unwrap(), log.name, log.message)).collect()
    }

    /// Returns the fields of a metadata record.
    pub(crate) fn json(&self, record: &str) -> Value {
        let fields = self.metadata[record].iter();
        fields.map(|(name, text)| (name.clone(), serde_json::from_str::<Value>(text).unwrap())).collect()
    }

    pub(crate) fn count(&self, topic: &str) -> usize {
        self.topics.get(topic).map_or(0, Vec::len)
    }
}
