//! A supervisor on the board's serial line: requests, and their replies.

use tesaki::model::RobotModel;
use tesaki::protocol::codec::{Decoder, MAX_FRAME, checksum, encode};
use tesaki::protocol::{
    ActuatorFrame, FromBoard, LogEntry, LogRecord, MODEL_CHUNK, Reply, Request, RequestFrame, SCHEMA_KEY,
    SensorFrame, Status, Tips,
};

use crate::SECOND;
use crate::cpu::Machine;

/// Time within which a reply must come.
const PATIENCE: u64 = SECOND / 2;
const STEP: u64 = SECOND / 10_000;

pub struct Client {
    decoder: Decoder,
    sequence: u16,
    reply: Option<(u16, Reply)>,
    /// The last sensor values and actuator frame that were logged.
    pub sensors: Option<SensorFrame>,
    pub actuators: Option<ActuatorFrame>,
    /// The last message about the tips.
    pub tips: Option<Tips>,
    /// Messages that were damaged.
    pub damaged: u32,
    /// Messages of telemetry.
    pub telemetry: u32,
}

impl Default for Client {
    fn default() -> Self {
        Self {
            decoder: Decoder::new(),
            sequence: 0,
            reply: None,
            sensors: None,
            actuators: None,
            tips: None,
            damaged: 0,
            telemetry: 0,
        }
    }
}

impl Client {
    /// Takes the messages that the board has sent.
    pub fn receive(&mut self, machine: &mut Machine) {
        for byte in std::mem::take(&mut machine.chip.supervisor().outgoing) {
            match self.decoder.push::<FromBoard>(byte) {
                Some(Ok(FromBoard::Reply(reply))) => self.reply = Some((reply.sequence, reply.reply)),
                Some(Ok(FromBoard::Log(LogEntry { record: LogRecord::Sensors(frame), .. }))) => {
                    self.sensors = Some(frame);
                }
                Some(Ok(FromBoard::Log(LogEntry { record: LogRecord::Actuators(frame), .. }))) => {
                    self.actuators = Some(frame);
                }
                Some(Ok(FromBoard::Tips(tips))) => self.tips = Some(tips),
                Some(Ok(FromBoard::Telemetry(_))) => self.telemetry += 1,
                Some(Err(_)) => self.damaged += 1,
                _ => {}
            }
        }
    }

    /// Sends a request without waiting for the reply.
    pub fn send(&mut self, machine: &mut Machine, request: Request) {
        self.sequence = self.sequence.wrapping_add(1);
        let mut frame = [0; MAX_FRAME];
        let message = RequestFrame { client: 7, sequence: self.sequence, request };
        let length = encode(&message, &mut frame).expect("fits");
        machine.chip.supervisor().incoming.extend(&frame[..length]);
    }

    /// Sends a request and returns its reply.
    ///
    /// # Errors
    /// No reply, or the chip has stopped.
    pub fn ask(&mut self, machine: &mut Machine, request: Request) -> Result<Reply, String> {
        self.send(machine, request);
        let end = machine.now() + PATIENCE;
        while machine.now() < end {
            machine.run(machine.now() + STEP)?;
            self.receive(machine);
            if let Some((_, reply)) = self.reply.take_if(|(sequence, _)| *sequence == self.sequence) {
                return Ok(reply);
            }
        }
        Err("no reply".to_owned())
    }

    /// Sends a request that must be granted.
    ///
    /// # Errors
    /// It was not granted.
    pub fn demand(&mut self, machine: &mut Machine, request: Request) -> Result<(), String> {
        match self.ask(machine, request)? {
            Reply::Done | Reply::Hello { schema: SCHEMA_KEY, .. } => Ok(()),
            other => Err(format!("{other:?}")),
        }
    }

    /// Reads the status.
    ///
    /// # Errors
    /// No reply.
    pub fn status(&mut self, machine: &mut Machine) -> Result<Status, String> {
        match self.ask(machine, Request::ReadStatus)? {
            Reply::Status(status) => Ok(status),
            other => Err(format!("{other:?}")),
        }
    }

    /// Greets, takes command and pushes a model.
    ///
    /// # Errors
    /// The reply that refuses it.
    pub fn push(&mut self, machine: &mut Machine, model: &RobotModel) -> Result<(), String> {
        match self.offer(machine, model)? {
            Reply::Done => Ok(()),
            other => Err(format!("{other:?}")),
        }
    }

    /// Greets, takes command and sends a model. Returns the board's reply to the complete model.
    ///
    /// # Errors
    /// No reply, or an earlier request was refused.
    pub fn offer(&mut self, machine: &mut Machine, model: &RobotModel) -> Result<Reply, String> {
        self.demand(machine, Request::Hello { schema: SCHEMA_KEY })?;
        self.demand(machine, Request::TakeCommand { by_force: true })?;
        let bytes = postcard::to_stdvec(model).map_err(|error| error.to_string())?;
        let begin = Request::ModelBegin { length: bytes.len() as u32, checksum: checksum(&bytes) };
        self.demand(machine, begin)?;
        for (index, chunk) in bytes.chunks(MODEL_CHUNK).enumerate() {
            let data = chunk.iter().copied().collect();
            self.demand(machine, Request::ModelChunk { offset: (index * MODEL_CHUNK) as u32, data })?;
        }
        self.ask(machine, Request::ModelCommit)
    }
}
