//! A board on a modelled chip: the image that is flashed, with a simulated machine at its motors.
//!
//! The chip runs in a separate process (`chip/`), connected by [`tesaki_chip_link`]. Machine and chip advance
//! alternately by one sub-step of the physics: the chip is given the motion of the joints, and returns the
//! mean torques of its motors during that time. Thus a torque acts in the sub-step in which it is made, and
//! the chip sees an acceleration one sub-step late.

use std::io;
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};

use tesaki::protocol::codec::{Decoder, MAX_FRAME, encode};
use tesaki::protocol::{FromBoard, Reply, Request, RequestFrame};
use tesaki_chip_link::{Answer, Call, MOTORS, Motion, Terminals, receive, send};
use tesaki_description::plant::CONTROL_PERIOD_NS;
use tesaki_supervisor::{Board, BoardError};

use crate::image::Image;
use crate::plant::{Plant, PlantError};

/// The control period, and the time from power-on until the image answers [ps].
const PERIOD: u64 = 1000 * CONTROL_PERIOD_NS;
const BOOT: u64 = 10 * PERIOD;
/// A control period of the machine begins this long before the board samples its sensors, because the board's
/// interrupt may be late by some microseconds [ps].
const MARGIN: u64 = 20_000_000;
/// Longest wait for a reply [control periods].
const PATIENCE: u32 = 50;
/// The only client of the board.
const CLIENT: u32 = 1;

/// Why the board on the modelled chip does not run.
#[derive(Debug, thiserror::Error)]
pub enum ChipError {
    /// The program or the image does not exist.
    #[error("there is no {}: build it with `cargo xtask chip`", .0.display())]
    Missing(PathBuf),
    /// The file is no image, or not a whole one, or that of another board.
    #[error("{} is not an image of board-weact: {why}; `cargo xtask chip` builds it", image.display())]
    NotAnImage {
        /// The file.
        image: PathBuf,
        /// What it is.
        why: String,
    },
    /// The process ended, or what it said is no answer.
    #[error("the chip model stopped: {0}")]
    Link(#[from] io::Error),
    /// The machine failed.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The machine has other joints than the board has motors.
    #[error("this robot has {0} joints, the board exactly {MOTORS} motors: give another --robot")]
    Joints(usize),
    /// The image has started no control period.
    #[error("the image has begun no control period {} ms after its start", BOOT / 1_000_000_000)]
    Idle,
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
    /// Bytes that go to the board in the next sub-step.
    outgoing: Vec<u8>,
    reply: Option<(u16, Reply)>,
    /// Whether the power stages have been enabled; until then the joints are held.
    released: bool,
    /// Time since power-on, and the last control instant that the chip reported [ps].
    now: u64,
    instant: u64,
    /// Largest deviation of such an instant from its scheduled time [ps].
    worst_instant: u64,
    /// Torques of the last sub-step [N·m].
    torques: [f64; MOTORS],
}

/// Reads an image.
///
/// # Errors
/// The file is missing, or cannot be read.
pub fn read_image(path: &Path) -> Result<Vec<u8>, ChipError> {
    std::fs::read(path).map_err(|error| match error.kind() {
        io::ErrorKind::NotFound => ChipError::Missing(path.to_owned()),
        _ => ChipError::NotAnImage { image: path.to_owned(), why: error.to_string() },
    })
}

/// Whether the file is an image that drives the motors of the modelled chip.
fn check(path: &Path) -> Result<(), ChipError> {
    let image = read_image(path)?;
    let not_an_image = |why: &str| ChipError::NotAnImage { image: path.to_owned(), why: why.to_owned() };
    match Image::parse(&image).map_err(not_an_image)?.board.as_deref() {
        Some("weact") => Ok(()),
        Some(other) => Err(not_an_image(&format!("it is that of board-{other}"))),
        None => Err(not_an_image("it names no board with motors")),
    }
}

impl ChipBoard {
    /// Powers on a board with `image`, in a process of `program`. Its control periods begin with those of the
    /// caller.
    ///
    /// # Errors
    /// A file is missing, or the process ended.
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
        check(image)?;
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
        // Advances to the start of the next control period.
        let next = (board.instant + PERIOD - MARGIN).checked_sub(board.now).ok_or(ChipError::Idle)?;
        board.advance(next)?;
        Ok(board)
    }

    /// Advances the time while the machine stands still.
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

    /// Runs one control period of chip and machine. The board samples its sensors 20 µs after the period
    /// begins.
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

    /// Sends a request now, without waiting for the reply.
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

    /// Takes the reply to the last request, if it has come.
    pub fn reply(&mut self) -> Option<Reply> {
        self.reply.take_if(|(sequence, _)| *sequence == self.sequence).map(|(_, reply)| reply)
    }

    /// Torques of the motors in the last sub-step [N·m].
    pub const fn torques(&self) -> [f64; MOTORS] {
        self.torques
    }

    /// Largest deviation of the start of a control period from its scheduled time [µs].
    pub fn worst_instant(&self) -> f64 {
        self.worst_instant as f64 * 1e-6
    }
}

/// Runs control periods until the reply comes.
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
        // The process has printed the reason on standard error.
        answer.ok_or_else(|| io::Error::other("it ended").into())
    }
}

impl Drop for Process {
    fn drop(&mut self) {
        // The process may already have ended.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
