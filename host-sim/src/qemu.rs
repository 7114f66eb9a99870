//! The shipped firmware image on an emulated STM32F405.

use std::fs::File;
use std::io::{self, Read, Write};
use std::os::unix::net::UnixStream;
use std::os::unix::process::CommandExt;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use tesaki::protocol::codec::{Decoder, MAX_FRAME, encode};
use tesaki::protocol::{ActuatorFrame, FromBoard, Identity, Reply, Request, SensorFrame, Stream};
use tesaki_supervisor::hand::{FingerBoard, News};
use tesaki_supervisor::{Board, BoardError, ByteLink, LinkBoard};

use crate::controller::Controller;
use crate::image::Image;

/// Longest wait for an answer of the emulated board; a busy machine emulates slowly.
const TIMEOUT: Duration = Duration::from_secs(20);
/// Time that one greeting waits for its answer.
const GREETING: Duration = Duration::from_millis(300);
/// Longest wait for QEMU to open its sockets.
const START: Duration = Duration::from_secs(20);
/// Name of the file for QEMU's standard error.
const ERRORS: &str = "errors";
/// Maximum length of the quoted part [bytes].
const MAX_QUOTED: u64 = 2000;

/// Reasons why the emulated board does not run.
#[derive(Debug, thiserror::Error)]
pub enum QemuError {
    /// The image does not exist.
    #[error("there is no firmware image at {0}: build it with `cargo xtask firmware`")]
    NoImage(PathBuf),
    /// The file is no image, or not a whole one.
    #[error("{} is not a firmware image: {why}; `cargo xtask firmware` builds that of board-bare", image.display())]
    NotAnImage {
        /// The file.
        image: PathBuf,
        /// What it lacks.
        why: &'static str,
    },
    /// QEMU is not installed.
    #[error(
        "cannot start qemu-system-arm: {0}; install QEMU for ARM (Debian: apt-get install qemu-system-arm)"
    )]
    NoQemu(io::Error),
    /// QEMU started and ended, or never opened its sockets.
    #[error("qemu-system-arm did not come up: {0}")]
    NotUp(String),
    /// The emulated board does not answer.
    #[error("the firmware in QEMU does not answer: {error}{}", quoted(errors))]
    Silent {
        /// The error of the link.
        #[source]
        error: BoardError,
        /// QEMU's output on standard error.
        errors: String,
    },
    /// The image belongs to a board without a plant link.
    #[error(
        "{} is the image of {board}, which does not answer on the plant link; give that of board-bare, which `cargo xtask firmware` \
         builds",
        image.display()
    )]
    OtherBoard {
        /// The image.
        image: PathBuf,
        /// The Cargo feature of its board.
        board: String,
    },
    /// A file could not be created.
    #[error("cannot prepare the emulated board: {0}")]
    Files(#[from] io::Error),
}

/// Formats QEMU's output as an addition to another message.
fn quoted(errors: &str) -> String {
    if errors.is_empty() { String::new() } else { format!("; qemu-system-arm says: {errors}") }
}

/// Settings of an emulated board.
#[derive(Clone, Copy, Debug, Default)]
pub struct Machine<'a> {
    /// Whether it sleeps while it waits, so that its timer does not run ahead of its clients. In lock step
    /// over the plant link, no timer matters.
    pub sleeps: bool,
    /// A file to which QEMU writes each access to an unimplemented peripheral, such as the watchdog and the
    /// pins.
    pub accesses: Option<&'a Path>,
    /// Whether QEMU ignores Ctrl-C in the terminal: the caller handles it, and drops the board.
    pub own_group: bool,
}

/// What is in the file of an image.
fn read(image: &Path) -> Result<Image, QemuError> {
    if !image.is_file() {
        return Err(QemuError::NoImage(image.to_owned()));
    }
    Image::parse(&std::fs::read(image)?).map_err(|why| QemuError::NotAnImage { image: image.to_owned(), why })
}

/// The shipped image in QEMU: requests on USART1, sensors and actuators on USART2, in lock step.
pub struct Qemu {
    board: LinkBoard<Socket>,
    plant: Socket,
    decoder: Decoder,
    /// Periods of the telemetry and of the tips' messages [ticks].
    rates: [u16; 2],
    /// Unsolicited messages.
    news: News,
    // Dropped last, in this order: the process before its folder.
    _process: Process,
    folder: tempfile::TempDir,
}

impl Qemu {
    /// Boots `image`, which must be of a board with a plant link, on the given machine, and waits until it
    /// answers.
    ///
    /// # Errors
    /// Something is missing; the error says what, and what to do.
    pub fn boot(image: &Path, machine: &Machine<'_>) -> Result<Self, QemuError> {
        let other =
            |board: &str| Err(QemuError::OtherBoard { image: image.to_owned(), board: board.to_owned() });
        let Image { board, is_of_tesaki } = read(image)?;
        if let Some(name) = board.filter(|name| name != "bare") {
            return other(&format!("board-{name}"));
        }
        let mut qemu = Self::boot_on(image, machine).map_err(|error| match error {
            QemuError::Silent { .. } if !is_of_tesaki => QemuError::NotAnImage {
                image: image.to_owned(),
                why: "it does not answer, and is not an image of tesaki",
            },
            error => error,
        })?;
        let status = qemu.status().map_err(|error| qemu.silent(error))?;
        if status.board.identity.capabilities & Identity::PLANT_LINK == 0 {
            return other("another board");
        }
        Ok(qemu)
    }

    /// Boots an image of any board.
    ///
    /// # Errors
    /// Something is missing; the error says what, and what to do.
    pub fn boot_on(image: &Path, machine: &Machine<'_>) -> Result<Self, QemuError> {
        read(image)?;
        let folder = tempfile::tempdir()?;
        let sockets = [folder.path().join("usart1"), folder.path().join("usart2")];
        let mut command = Command::new("qemu-system-arm");
        command.args(["-M", "netduinoplus2", "-display", "none"]);
        command.args([
            "-monitor",
            &format!("unix:{},server=on,wait=off", folder.path().join("monitor").display()),
        ]);
        // One instruction takes one nanosecond: the run is repeatable, and UART traffic stays fast.
        command.args(["-icount", if machine.sleeps { "shift=0,sleep=on" } else { "shift=0,sleep=off" }]);
        if let Some(file) = machine.accesses {
            command.args(["-d", "unimp", "-D"]).arg(file);
        }
        for (index, socket) in sockets.iter().enumerate() {
            let path = socket.display();
            command.args(["-chardev", &format!("socket,id=usart{index},path={path},server=on,wait=off")]);
            command.args(["-serial", &format!("chardev:usart{index}")]);
        }
        command.arg("-kernel").arg(image);
        // A pipe that is not read would block QEMU once it is full.
        let errors = File::create(folder.path().join(ERRORS))?;
        command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(errors);
        if machine.own_group {
            command.process_group(0);
        }
        let mut process = Process(command.spawn().map_err(QemuError::NoQemu)?);
        let deadline = Instant::now() + START;
        let mut connect = |socket| {
            let not_up = |why| QemuError::NotUp(format!("{why}{}", quoted(&errors_in(folder.path()))));
            process.connect(socket, deadline)?.map_err(not_up)
        };
        let (board, plant) = (connect(&sockets[0])?, connect(&sockets[1])?);
        let mut qemu = Self {
            board: LinkBoard::new(board, GREETING),
            plant,
            decoder: Decoder::new(),
            rates: [0; 2],
            news: News::default(),
            _process: process,
            folder,
        };
        qemu.greet(deadline).map_err(|error| qemu.silent(error))?;
        Ok(qemu)
    }

    /// Creates the error for a board that does not answer.
    fn silent(&self, error: BoardError) -> QemuError {
        QemuError::Silent { error, errors: errors_in(self.folder.path()) }
    }

    /// Presses the reset button and waits until the board answers again. The memory keeps its content.
    ///
    /// # Errors
    /// The board does not answer again.
    pub fn reset(&mut self) -> Result<(), BoardError> {
        self.rates = [0; 2];
        let mut monitor = UnixStream::connect(self.folder.path().join("monitor"))?;
        monitor.write_all(b"system_reset\n")?;
        // The monitor executes a line after reading it, and then prints its next prompt.
        monitor.set_read_timeout(Some(GREETING))?;
        let mut said = [0; 512];
        while monitor.read(&mut said).is_ok_and(|length| length > 0) {}
        self.greet(Instant::now() + START)
    }

    /// The supervisor link, for callers that implement the protocol themselves.
    pub fn link_mut(&mut self) -> &mut impl ByteLink {
        self.board.link_mut()
    }

    /// The plant link.
    pub fn plant_mut(&mut self) -> &mut impl ByteLink {
        &mut self.plant
    }

    /// Waits for the next unsolicited message of the board; `None` at the deadline.
    ///
    /// # Errors
    /// QEMU ended.
    pub fn next_event(&mut self, deadline: Instant) -> Result<Option<FromBoard>, BoardError> {
        self.board.next_event(deadline)
    }

    /// Receives the unsolicited messages after this tick, so that they are complete before the next one.
    fn hear(&mut self, tick: u32) -> Result<(), BoardError> {
        let mut due = self.rates.map(|every| tick.checked_rem(every.into()) == Some(0));
        let deadline = Instant::now() + TIMEOUT;
        while due != [false; 2] {
            let event = self.board.next_event(deadline)?;
            match event.ok_or(BoardError::Timeout { seconds: TIMEOUT.as_secs_f64() })? {
                FromBoard::Telemetry(telemetry) => {
                    due[0] &= telemetry.tick != tick;
                    self.news.telemetry = Some(telemetry);
                }
                FromBoard::Tips(tips) => {
                    due[1] &= tips.tick != tick;
                    self.news.tips = Some(tips);
                }
                event => self.news.take(event),
            }
        }
        Ok(())
    }

    /// Greets until there is an answer, because a UART that is not set up yet drops its input.
    fn greet(&mut self, deadline: Instant) -> Result<(), BoardError> {
        self.board.set_timeout(GREETING);
        while let Err(error) = self.hello() {
            if !matches!(error, BoardError::Timeout { .. }) || Instant::now() > deadline {
                return Err(error);
            }
        }
        self.board.set_timeout(TIMEOUT);
        Ok(())
    }
}

impl Board for Qemu {
    fn request(&mut self, request: Request) -> Result<Reply, BoardError> {
        match request {
            Request::SetRate { stream: Stream::Telemetry, every } => self.rates[0] = every,
            Request::SetRate { stream: Stream::Tips, every } => self.rates[1] = every,
            _ => {}
        }
        self.board.request(request)
    }
}

impl Qemu {
    /// Runs one control period while reading the supervisor link, whose bytes are appended to `out`. QEMU
    /// sends single bytes, and less than 300 of them fill the socket; the board would then block while
    /// sending, and not answer on the plant link.
    ///
    /// # Errors
    /// The board does not answer.
    pub fn tick_and_listen(
        &mut self,
        sensors: &SensorFrame,
        out: &mut Vec<u8>,
    ) -> Result<ActuatorFrame, BoardError> {
        self.send_sensors(sensors)?;
        let deadline = Instant::now() + TIMEOUT;
        loop {
            if let Some(actuators) = self.receive_actuators(sensors, Instant::now())? {
                return Ok(actuators);
            }
            if Instant::now() > deadline {
                return Err(BoardError::Timeout { seconds: TIMEOUT.as_secs_f64() });
            }
            self.listen_to_link(out)?;
        }
    }

    /// Appends the bytes received on the supervisor link to `out`.
    ///
    /// # Errors
    /// QEMU ended.
    pub fn listen_to_link(&mut self, out: &mut Vec<u8>) -> io::Result<()> {
        let mut buffer = [0; 4096];
        let length = self.board.link_mut().receive(&mut buffer, Instant::now())?;
        out.extend_from_slice(&buffer[..length]);
        Ok(())
    }

    fn send_sensors(&mut self, sensors: &SensorFrame) -> Result<(), BoardError> {
        let mut frame = [0; MAX_FRAME];
        let length = encode(sensors, &mut frame).map_err(io::Error::other)?;
        Ok(self.plant.send(&frame[..length])?)
    }

    /// Receives the answer to `sensors`, if its last byte arrives before the deadline.
    fn receive_actuators(
        &mut self,
        sensors: &SensorFrame,
        deadline: Instant,
    ) -> Result<Option<ActuatorFrame>, BoardError> {
        let mut buffer = [0; MAX_FRAME];
        loop {
            let received = self.plant.receive(&mut buffer, deadline)?;
            if received == 0 {
                return Ok(None);
            }
            for &byte in &buffer[..received] {
                match self.decoder.push::<ActuatorFrame>(byte) {
                    Some(Ok(actuators)) if actuators.sequence == sensors.sequence => {
                        return Ok(Some(actuators));
                    }
                    Some(Err(error)) => {
                        return Err(io::Error::other(format!("damaged actuator frame: {error:?}")).into());
                    }
                    _ => {}
                }
            }
        }
    }
}

impl Controller for Qemu {
    fn tick(&mut self, sensors: &SensorFrame) -> Result<ActuatorFrame, BoardError> {
        self.send_sensors(sensors)?;
        let actuators = self.receive_actuators(sensors, Instant::now() + TIMEOUT)?;
        let actuators = actuators.ok_or(BoardError::Timeout { seconds: TIMEOUT.as_secs_f64() })?;
        self.hear(sensors.sequence)?;
        Ok(actuators)
    }
}

/// In lock step: posted requests are handled before the next tick, and received messages belong to the last
/// one.
impl FingerBoard for Qemu {
    fn post(&mut self, request: Request) -> Result<(), BoardError> {
        if let Reply::Refused(refusal) = self.request(request)? {
            self.news.refuse(refusal);
        }
        Ok(())
    }

    fn listen(&mut self) -> Result<News, BoardError> {
        Ok(std::mem::take(&mut self.news))
    }
}

/// One of the emulated UARTs.
#[derive(Debug)]
struct Socket(UnixStream);

impl ByteLink for Socket {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        self.0.write_all(bytes)
    }

    fn receive(&mut self, buffer: &mut [u8], deadline: Instant) -> io::Result<usize> {
        let wait = deadline.saturating_duration_since(Instant::now()).max(Duration::from_millis(1));
        self.0.set_read_timeout(Some(wait))?;
        match self.0.read(buffer) {
            Ok(0) => Err(io::Error::new(io::ErrorKind::UnexpectedEof, "QEMU ended")),
            Err(error) if matches!(error.kind(), io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut) => {
                Ok(0)
            }
            // A signal, such as Ctrl-C, does not mean that the link failed.
            Err(error) if error.kind() == io::ErrorKind::Interrupted && Instant::now() < deadline => {
                self.receive(buffer, deadline)
            }
            Err(error) if error.kind() == io::ErrorKind::Interrupted => Ok(0),
            other => other,
        }
    }
}

/// The QEMU process, which is killed when this is dropped.
struct Process(Child);

impl Process {
    /// Connects to a socket that QEMU opens; returns the reason if it does not.
    fn connect(&mut self, path: &Path, deadline: Instant) -> io::Result<Result<Socket, String>> {
        loop {
            match UnixStream::connect(path) {
                Ok(stream) => return Ok(Ok(Socket(stream))),
                Err(error) if Instant::now() > deadline => return Ok(Err(error.to_string())),
                Err(_) => {}
            }
            if let Some(status) = self.0.try_wait()? {
                return Ok(Err(status.to_string()));
            }
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

/// Returns the beginning of QEMU's output on standard error.
fn errors_in(folder: &Path) -> String {
    let mut said = Vec::new();
    // If it cannot be read, nothing is quoted.
    let _ = File::open(folder.join(ERRORS)).and_then(|file| file.take(MAX_QUOTED).read_to_end(&mut said));
    String::from_utf8_lossy(&said).trim().to_owned()
}

impl Drop for Process {
    fn drop(&mut self) {
        // The process may already have ended.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}
