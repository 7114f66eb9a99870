use std::io;
use std::time::{Duration, Instant};

use tesaki::protocol::codec::{Decoder, MAX_FRAME, encode};
use tesaki::protocol::{FromBoard, Reply, Request, RequestFrame, Telemetry};

use crate::{Board, BoardError};

/// A two-way stream of bytes: serial port, socket, pseudo-terminal.
pub trait ByteLink {
    /// Sends all of `bytes`.
    ///
    /// # Errors
    /// When the link is gone.
    fn send(&mut self, bytes: &[u8]) -> io::Result<()>;

    /// Receives what is there, waiting for the first byte until `deadline`; 0 when none came.
    ///
    /// # Errors
    /// When the link is gone.
    fn receive(&mut self, buffer: &mut [u8], deadline: Instant) -> io::Result<usize>;
}

/// A board at the other end of a [`ByteLink`].
#[derive(Debug)]
pub struct LinkBoard<L> {
    link: L,
    decoder: Decoder,
    sequence: u16,
    timeout: Duration,
    telemetry: Option<Telemetry>,
}

impl<L: ByteLink> LinkBoard<L> {
    /// A board that answers within `timeout`.
    pub fn new(link: L, timeout: Duration) -> Self {
        Self { link, decoder: Decoder::new(), sequence: 0, timeout, telemetry: None }
    }

    /// Answers are waited for so long from now on.
    pub const fn set_timeout(&mut self, timeout: Duration) {
        self.timeout = timeout;
    }

    /// The last telemetry that came while waiting for replies, once.
    pub const fn take_telemetry(&mut self) -> Option<Telemetry> {
        self.telemetry.take()
    }
}

impl<L: ByteLink> Board for LinkBoard<L> {
    fn request(&mut self, request: Request) -> Result<Reply, BoardError> {
        self.sequence = self.sequence.wrapping_add(1);
        let sequence = self.sequence;
        let mut frame = [0; MAX_FRAME];
        let length = encode(&RequestFrame { sequence, request }, &mut frame).map_err(io::Error::other)?;
        self.link.send(&frame[..length])?;
        let deadline = Instant::now() + self.timeout;
        let mut buffer = [0; MAX_FRAME];
        loop {
            let received = self.link.receive(&mut buffer, deadline)?;
            if received == 0 {
                return Err(BoardError::Timeout { seconds: self.timeout.as_secs_f64() });
            }
            let mut answer = None;
            for &byte in &buffer[..received] {
                // Damaged frames are counted by the decoder; what is missing shows as a timeout.
                match self.decoder.push(byte) {
                    Some(Ok(FromBoard::Reply(reply))) if reply.sequence == sequence => {
                        answer = Some(reply.reply);
                    }
                    Some(Ok(FromBoard::Telemetry(telemetry))) => self.telemetry = Some(telemetry),
                    _ => {}
                }
            }
            if let Some(reply) = answer {
                return Ok(reply);
            }
        }
    }
}
