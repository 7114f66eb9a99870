//! A board on a modelled chip: the image that is flashed, and at its motors a simulated machine.
//!
//! The chip runs in a process of its own (`chip/`), which [`tesaki_chip_link`] connects. Machine and chip
//! advance in turn by a sub-step of the physics: the chip is told how the joints move, and tells the mean
//! torques of its motors while they do. So the torque acts in the sub-step in which it is made, and the chip
//! sees an acceleration one sub-step late.

use std::io;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use tesaki::protocol::codec::{Decoder, MAX_FRAME, encode};
use tesaki::protocol::{FromBoard, Reply, Request, RequestFrame};
use tesaki_chip_link::{Answer, Call, MOTORS, Motion, Terminals, receive, send};
use tesaki_supervisor::{Board, BoardError};

use crate::plant::{Plant, PlantError};

/// The control period, and the time from power-on until the image answers [ps].
const PERIOD: u64 = 10_000_000_000;
const BOOT: u64 = 10 * PERIOD;
/// So long before the board samples its sensors a control period of the machine begins: its interrupt may be
/// late by some microseconds [ps].
const MARGIN: u64 = 20_000_000;
/// Longest wait for a reply [control periods].
const PATIENCE: u32 = 50;
/// The only client of the board.
const CLIENT: u32 = 1;

/// Why the board on the modelled chip does not run.
#[derive(Debug, thiserror::Error)]
pub enum ChipError {
    /// The program or the image is not there.
    #[error("there is no {}: build it with `cargo xtask chip`", .0.display())]
    Missing(PathBuf),
    /// The process ended, or what it said is no answer.
    #[error("the chip model stopped: {0}")]
    Link(#[from] io::Error),
    /// The machine.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The machine has other joints than the board has motors.
    #[error("this robot has {0} joints, the board exactly {MOTORS} motors: give another --robot")]
    Joints(usize),
    /// The chip was reset.
    #[error("the chip was reset by itself")]
    Reset,
    /// A control period did not begin when it should.
    #[error("a control period began {0:.1} µs beside its time")]
    Instant(f64),
}

impl From<ChipError> for BoardError {
    fn from(error: ChipError) -> Self {
        Self::Link(io::Error::other(error))
    }
}

/// Image, chip, and the machine at its motors.
pub struct ChipBoard {
    chip: Process,
    /// The machine.
    pub plant: Plant,
    decoder: Decoder,
    sequence: u16,
    /// What goes to the board in the next sub-step.
    outgoing: Vec<u8>,
    reply: Option<(u16, Reply)>,
    /// Whether the power stages have been awake: something holds the joints until then.
    released: bool,
    /// Time since power-on, and the last instant of a control period that the chip told [ps].
    now: u64,
    instant: u64,
    /// Largest distance of such an instant from its time [ps].
    worst_instant: u64,
    /// Torques of the last sub-step [N·m].
    torques: [f64; MOTORS],
}

impl ChipBoard {
    /// Powers `image` on, in a process of `program`. Its control periods begin with those of the caller.
    ///
    /// # Errors
    /// What is missing, or why the process ended.
    pub fn start(
        program: &Path,
        image: &Path,
        terminals: Terminals,
        plant: Plant,
    ) -> Result<Self, ChipError> {
        let joints = plant.factors().len();
        if joints != MOTORS {
            return Err(ChipError::Joints(joints));
        }
        let mut board = Self {
            chip: Process::start(program, image)?,
            plant,
            decoder: Decoder::new(),
            sequence: 0,
            outgoing: Vec::new(),
            reply: None,
            released: false,
            now: 0,
            instant: 0,
            worst_instant: 0,
            torques: [0.0; MOTORS],
        };
        board.chip.call(&Call::Start(terminals))?;
        board.advance(BOOT)?;
        // To where the next control period begins.
        let next = board.instant + PERIOD - MARGIN;
        board.advance(next - board.now)?;
        Ok(board)
    }

    /// Time passes, and the machine stands still.
    fn advance(&mut self, duration: u64) -> Result<(), ChipError> {
        let truth = self.plant.truth();
        let motion =
            |joint: usize| Motion { angle: truth.positions[joint], velocity: truth.velocities[joint] };
        let serial = std::mem::take(&mut self.outgoing);
        let call = Call::Advance { duration, joints: std::array::from_fn(motion), serial };
        let answer = self.chip.call(&call)?;
        self.now += duration;
        if answer.resets > 0 {
            return Err(ChipError::Reset);
        }
        self.released |= answer.awake;
        self.instant = answer.instant;
        self.torques = answer.torques;
        for byte in answer.serial {
            match self.decoder.push::<FromBoard>(byte) {
                Some(Ok(FromBoard::Reply(reply))) => self.reply = Some((reply.sequence, reply.reply)),
                Some(Err(error)) => {
                    return Err(io::Error::other(format!("damaged on the serial line: {error:?}")).into());
                }
                _ => {}
            }
        }
        Ok(())
    }

    /// One control period of chip and machine. The board samples its sensors 20 µs after its beginning.
    ///
    /// # Errors
    /// The process ended, or the period did not begin in time.
    pub fn period(&mut self) -> Result<(), ChipError> {
        let begin = self.now;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1 to 100")]
        let steps = (PERIOD as f64 * 1e-12 / self.plant.sub_step()).round() as u64;
        for step in 1..=steps {
            self.advance(begin + step * PERIOD / steps - self.now)?;
            if self.released {
                self.plant.step(&self.torques)?;
            }
        }
        let beside = self.instant.abs_diff(begin + MARGIN);
        self.worst_instant = self.worst_instant.max(beside);
        if beside > PERIOD / 100 {
            return Err(ChipError::Instant(beside as f64 * 1e-6));
        }
        Ok(())
    }

    /// Sends a request now, and does not wait.
    ///
    /// # Errors
    /// It is too long for a frame.
    pub fn post(&mut self, request: Request) -> Result<(), BoardError> {
        self.sequence = self.sequence.wrapping_add(1);
        let frame = RequestFrame { client: CLIENT, sequence: self.sequence, request };
        let mut bytes = [0; MAX_FRAME];
        let length = encode(&frame, &mut bytes).map_err(io::Error::other)?;
        self.outgoing.extend_from_slice(&bytes[..length]);
        Ok(())
    }

    /// The reply to the last request, if it has come.
    pub fn reply(&mut self) -> Option<Reply> {
        self.reply.take_if(|(sequence, _)| *sequence == self.sequence).map(|(_, reply)| reply)
    }

    /// Torques of the motors in the last sub-step [N·m].
    pub const fn torques(&self) -> [f64; MOTORS] {
        self.torques
    }

    /// Largest distance of the beginning of a control period from its time [µs].
    pub fn worst_instant(&self) -> f64 {
        self.worst_instant as f64 * 1e-6
    }
}

/// Control periods pass until the reply comes.
impl Board for ChipBoard {
    fn request(&mut self, request: Request) -> Result<Reply, BoardError> {
        self.post(request)?;
        for _ in 0..PATIENCE {
            self.period()?;
            if let Some(reply) = self.reply() {
                return Ok(reply);
            }
        }
        Err(BoardError::Timeout { seconds: f64::from(PATIENCE) * PERIOD as f64 * 1e-12 })
    }
}

/// The process with the modelled chip.
struct Process {
    child: Child,
    to: ChildStdin,
    from: ChildStdout,
}

impl Process {
    fn start(program: &Path, image: &Path) -> Result<Self, ChipError> {
        for file in [program, image] {
            if !file.is_file() {
                return Err(ChipError::Missing(file.to_owned()));
            }
        }
        let mut command = Command::new(program);
        let mut child = command.arg(image).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn()?;
        let gone = || io::Error::other("it has no standard input or output");
        let (to, from) = (child.stdin.take().ok_or_else(gone)?, child.stdout.take().ok_or_else(gone)?);
        Ok(Self { child, to, from })
    }

    fn call(&mut self, call: &Call) -> Result<Answer, ChipError> {
        send(&mut self.to, call)?;
        let answer = receive(&mut self.from)?;
        // Why, it has told on standard error.
        answer.ok_or_else(|| io::Error::other("it ended").into())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // It may have ended by itself.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
