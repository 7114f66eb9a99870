//! A board in this process, with bytes in and bytes out as on the supervisor link of the firmware.

use tesaki::node::Node;
use tesaki::protocol::codec::{Decoder, MAX_FRAME, encode};
use tesaki::protocol::{
    ActuatorFrame, BoardStatus, FromBoard, LogEntry, LogRecord, ReplyFrame, RequestFrame, SensorFrame, Stream,
};

/// The control core with the supervisor link around it, without a microcontroller.
#[derive(Debug)]
pub struct VirtualBoard {
    node: Box<Node>,
    status: BoardStatus,
    decoder: Decoder,
}

impl Default for VirtualBoard {
    fn default() -> Self {
        Self { node: Box::new(Node::new()), status: BoardStatus::default(), decoder: Decoder::new() }
    }
}

impl VirtualBoard {
    /// The node.
    pub const fn node(&self) -> &Node {
        &self.node
    }

    /// Resets the board. Like a board's retained memory, it keeps the faults.
    pub fn reset(&mut self) {
        let (faults, joints) = (self.node.faults().clone(), self.node.fault_joints());
        *self = Self::default();
        self.node.restore_faults(faults, joints);
    }

    /// Takes bytes from the supervisor, and appends the board's replies to `out`.
    pub fn receive(&mut self, mut bytes: &[u8], out: &mut Vec<u8>) {
        while self.decoder.take(&mut bytes) {
            let request = self.decoder.message::<RequestFrame>();
            self.status.supervisor_link.frames = self.decoder.counts();
            if let Ok(request) = request {
                self.handle(request, out);
            }
        }
    }

    /// Answers one request.
    pub fn handle(&mut self, request: RequestFrame, out: &mut Vec<u8>) -> ReplyFrame {
        let reply = self.node.handle(&request, &self.status);
        send(&FromBoard::Reply(reply.clone()), out);
        if self.node.is_logged() {
            self.log(0, LogRecord::Request(request), out);
        }
        reply
    }

    /// Runs one control period; unsolicited messages of the board are appended to `out`.
    pub fn tick(&mut self, sensors: &SensorFrame, out: &mut Vec<u8>) -> ActuatorFrame {
        let actuators = self.node.tick(sensors);
        if self.node.is_logged() {
            self.log(1, LogRecord::Sensors(sensors.clone()), out);
            self.log(0, LogRecord::Actuators(actuators.clone()), out);
        }
        for stream in Stream::ALL {
            if let Some(message) = self.node.due(stream, &self.status) {
                send(&message, out);
            }
        }
        actuators
    }

    /// Sends a log entry. `before` is the number of entries from this one to the end of the log.
    fn log(&self, before: u32, record: LogRecord, out: &mut Vec<u8>) {
        let index = self.node.records().wrapping_sub(before);
        send(&FromBoard::Log(LogEntry { index, record }), out);
    }
}

fn send(message: &FromBoard, out: &mut Vec<u8>) {
    let mut frame = [0; MAX_FRAME];
    // Cannot fail, because every message of a board fits into a frame.
    let length = encode(message, &mut frame).unwrap_or(0);
    out.extend_from_slice(&frame[..length]);
}
