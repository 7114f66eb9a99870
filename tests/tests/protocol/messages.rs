//! The messages of the golden frames.

use std::collections::BTreeMap;

use tesaki::model::Reaction;
use tesaki::protocol::{FromBoard, Reply, ReplyFrame, Request, RequestFrame};

use super::message::Message;
use super::values::{CLIENT, finger};

/// The messages of the golden file, by name.
#[derive(Default)]
pub struct Messages(pub BTreeMap<String, Message>);

impl Messages {
    pub fn add(&mut self, name: impl Into<String>, message: Message) {
        assert!(self.0.insert(name.into(), message).is_none());
    }

    pub fn request(&mut self, name: &str, request: Request) {
        self.request_by(name, CLIENT, 9, request);
    }

    pub fn request_by(&mut self, name: &str, client: u32, sequence: u16, request: Request) {
        self.add(format!("request-{name}"), Message::Request(RequestFrame { client, sequence, request }));
    }

    pub fn reply(&mut self, name: &str, reply: Reply) {
        self.reply_to(name, CLIENT, 9, 1234, reply);
    }

    pub fn reply_to(&mut self, name: &str, client: u32, sequence: u16, tick: u32, reply: Reply) {
        let reply = ReplyFrame { client, sequence, tick, reply };
        self.add(format!("board-{name}"), Message::Board(FromBoard::Reply(reply)));
    }
}

pub fn messages() -> BTreeMap<String, Message> {
    let mut messages = Messages::default();
    messages.requests();
    messages.refusals();
    messages.board();
    messages.streams();
    messages.records();
    messages.plant_link();
    messages.session();
    for (name, reaction) in [("off", Reaction::Off), ("damp", Reaction::Damp), ("hold", Reaction::Hold)] {
        messages.add(format!("model-{name}"), Message::Model(finger(reaction)));
    }
    messages.0
}
