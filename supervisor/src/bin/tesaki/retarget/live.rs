//! A board's hand led by a stream of frames.

use std::cell::RefCell;
use std::fmt::Write as _;
use std::io::{self, BufRead, Read};
use std::net::{SocketAddr, UdpSocket};
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, SyncSender, TryRecvError, sync_channel};
use std::time::{Duration, Instant};

use serde_json::json;
use tesaki::model::RobotModel;
use tesaki::protocol::{Request, TaskReport};
use tesaki::task::telexistence::{FingertipSample, TelexistenceCommand, TelexistenceTelemetry};
use tesaki::task::{TaskCommand, TaskConfig, TaskTelemetry};
use tesaki::teleop::Finger;
use tesaki_description::retargeting::RetargetingSettings;
use tesaki_supervisor::operator::{Fingertips, Tracker};

use super::source::{Source, tracker};
use crate::args::{Options, Retarget};
use crate::board_session::interrupted;
use crate::failure::Failure;
use crate::motion::{End, KEEP_ALIVE, Motion};
use crate::output;

/// Period of the board's ticks: it takes over one sample in each.
const PERIOD: Duration = Duration::from_millis(10);
/// A source whose frames are all bad for this time has ended.
const BAD: Duration = Duration::from_millis(500);
/// By how much the clocks of source and PC may drift apart [s/s].
const CLOCK_DRIFT: f64 = 1e-3;
/// A frame that by its time stamp comes later than this is too late for the board [s].
const LATE: f32 = 0.2;
/// After frames that are all late for this time, the stamps are taken to have jumped.
const JUMPED: Duration = Duration::from_secs(1);
/// Stamps that jump again within this time are none.
const STEADY: Duration = Duration::from_secs(30);
/// Lines taken in a tick; a faster source waits.
const MAX_LINES: usize = 64;
/// Longest line [bytes].
const MAX_LINE: u64 = 1 << 16;

pub fn run(options: &Options, args: &Retarget) -> Result<(), Failure> {
    let (lines, place) = match args.udp {
        Some(address) => (receive(address)?, format!("UDP port {}", address.port())),
        None => (read(), "standard input".to_owned()),
    };
    let mut motion = Motion::begin(options)?;
    let settings = match &args.robot {
        Some(folder) => RetargetingSettings::load(folder, &motion.model)?,
        // There is no file in no folder.
        None => {
            RetargetingSettings::check("the settings".as_ref(), "", &motion.model).0.ok_or_else(|| {
                Failure::Usage(format!(
                    "{} on the board is no hand of two to five fingers",
                    motion.model.name
                ))
            })?
        }
    };
    let tracker = tracker(args, &settings)?;
    let mut stream = Stream::new(lines, place, Source::new(args), tracker, args.silence);
    output::notice(
        options,
        &format!("waiting for the operator's hand at {}: hold it like the robot's", stream.place),
    );
    let interrupted = interrupted()?;
    while !stream.shows_thumb() {
        if interrupted.load(Ordering::Relaxed) {
            output::notice(options, "\ninterrupted: nothing was enabled");
            return Ok(());
        }
        stream.take();
        if let Some(ending) = stream.ending() {
            return Err(ending.before_enabling(&stream));
        }
        // Also keeps command of the board.
        motion.positions()?;
        std::thread::sleep(PERIOD);
    }
    if let Some(ending) = stream.ending() {
        return Err(ending.before_enabling(&stream));
    }
    output::confirm(options, &format!("{} will follow the operator's hand. Continue?", motion.model.name))?;
    motion.enable(TaskConfig::Telexistence(settings.task))?;
    motion.announce_ctrl_c(motion.load().as_ref());
    let model = motion.model.clone();
    let stream = RefCell::new(stream);
    let mut live = output::Live::new(options);
    let end = motion.drive(
        PERIOD,
        |now| match stream.borrow_mut().sample(now) {
            Some(sample) => Request::Task(TaskCommand::Telexistence(TelexistenceCommand::Follow(sample))),
            None => Request::Keep,
        },
        |news, now| {
            let mut stream = stream.borrow_mut();
            if let Some(TaskReport { telemetry: TaskTelemetry::Telexistence(hand), .. }) = &news.task {
                live.show(&stream.one_line(hand, &model, now));
            }
            stream.ending().is_some()
        },
    );
    live.end();
    let end = end?;
    let stream = stream.into_inner();
    let ending = stream.ending().filter(|_| end == End::Done);
    if end == End::Interrupted {
        motion.end(true)?;
    } else {
        let load = motion.load();
        if let Some(ending) = &ending {
            output::notice(options, &format!("{}: the hand stays", ending.reason(&stream)));
        }
        motion.stay(args.hold, args.no_hold, load.as_ref(), KEEP_ALIVE, |_| Request::Keep)?;
        motion.end(false)?;
    }
    let value = json!({ "frames": stream.seen, "dropped": stream.dropped, "gaps": stream.tracker.gaps() });
    output::result(options, &value, || {
        format!(
            "done: {} followed, {} dropped, {} too long to be bridged",
            output::counted(stream.seen as usize, "frame"),
            stream.dropped,
            output::counted(stream.tracker.gaps() as usize, "gap"),
        )
    })?;
    ending.map_or(Ok(()), |ending| ending.after_enabling(&stream))
}

/// A line with the time of its arrival.
struct Line {
    arrived: Instant,
    text: io::Result<String>,
}

/// The lines of standard input.
fn read() -> Receiver<Line> {
    let (sender, lines) = sync_channel(MAX_LINES);
    std::thread::spawn(move || {
        let mut input = io::stdin().lock();
        while let Some(text) = line(&mut input)
            && send(&sender, text)
        {}
    });
    lines
}

/// The next line; `None` at the end.
fn line(input: &mut impl BufRead) -> Option<io::Result<String>> {
    let mut bytes = Vec::new();
    match input.take(MAX_LINE).read_until(b'\n', &mut bytes) {
        Ok(0) => None,
        Ok(length) if length as u64 == MAX_LINE && bytes.last() != Some(&b'\n') => {
            Some(Err(io::Error::other(format!("a line is longer than {MAX_LINE} bytes"))))
        }
        Ok(_) => Some(Ok(String::from_utf8_lossy(&bytes).into_owned())),
        Err(error) => Some(Err(error)),
    }
}

/// The lines of datagrams.
fn receive(address: SocketAddr) -> Result<Receiver<Line>, Failure> {
    let socket = UdpSocket::bind(address).map_err(Failure::file(format!("UDP port {address}")))?;
    let (sender, lines) = sync_channel(MAX_LINES);
    std::thread::spawn(move || {
        let mut datagram = vec![0; 1 << 16];
        loop {
            let received = socket.recv(&mut datagram);
            let text = received.map(|length| {
                String::from_utf8_lossy(datagram.get(..length).unwrap_or_default()).into_owned()
            });
            let alive = match text {
                Ok(text) => text.lines().all(|line| send(&sender, Ok(line.to_owned()))),
                Err(error) => {
                    send(&sender, Err(error));
                    false
                }
            };
            if !alive {
                break;
            }
        }
    });
    Ok(lines)
}

/// False if nobody takes lines any more.
fn send(sender: &SyncSender<Line>, text: io::Result<String>) -> bool {
    sender.send(Line { arrived: Instant::now(), text }).is_ok()
}

/// Why a stream has ended.
enum Ending {
    /// Its end.
    Closed,
    /// No line for too long.
    Silent,
    /// Bad frames only, and why.
    Bad(String),
}

impl Ending {
    fn reason(&self, stream: &Stream) -> String {
        let place = &stream.place;
        match self {
            Self::Closed => format!("{place} has ended"),
            Self::Silent => format!("{place} is silent for {} s", stream.silence.as_secs_f64()),
            Self::Bad(error) => format!("{place} gives no good frame any more; {error}"),
        }
    }

    fn before_enabling(&self, stream: &Stream) -> Failure {
        let hint = match self {
            Self::Closed => " (give a file by --in, without --live)",
            _ => "",
        };
        self.failure(format!("{}; nothing was enabled{hint}", self.reason(stream)))
    }

    /// The end of a stream that was followed is no failure.
    fn after_enabling(&self, stream: &Stream) -> Result<(), Failure> {
        match self {
            Self::Closed => Ok(()),
            _ => Err(self.failure(format!("{}; the board is disabled", self.reason(stream)))),
        }
    }

    fn failure(&self, told: String) -> Failure {
        match self {
            Self::Silent => Failure::Late(told),
            Self::Closed | Self::Bad(_) => Failure::Other(told),
        }
    }
}

/// The frames of a source, checked and filtered.
struct Stream {
    lines: Receiver<Line>,
    place: String,
    source: Source,
    tracker: Tracker,
    /// A tracker without frames.
    fresh: Tracker,
    silence: Duration,
    start: Instant,
    /// When the last line came.
    heard: Instant,
    /// Number of the last line.
    number: u64,
    /// Good frames.
    seen: u32,
    dropped: u32,
    /// Since when there are only bad frames, and what is wrong with the last one.
    bad: Option<(Instant, String)>,
    /// How the lines have ended.
    closed: Option<io::Result<()>>,
    /// Clock of the PC less clock of the source for the frames that come soonest [s].
    clock_offset: Option<f64>,
    /// Since when all frames are late.
    late: Option<Instant>,
    /// When the stamps have jumped last.
    jumped: Option<Instant>,
    /// What is wrong with the stamps.
    stamps: Option<String>,
    /// When the last good frame came.
    followed: Option<Instant>,
    /// Of the last sample for the board.
    sample_number: u16,
    /// The newest fingertips that were not sent yet, with when they came, and their age then [s].
    latest: Option<(Instant, f32, Fingertips)>,
    /// Good frames at the begin of the current second, and its begin; frames a second in the last one.
    second: (u32, Instant, f64),
}

impl Stream {
    fn new(
        lines: Receiver<Line>,
        place: String,
        source: Source,
        tracker: Tracker,
        silence: Duration,
    ) -> Self {
        let now = Instant::now();
        Self {
            lines,
            place,
            source,
            fresh: tracker.clone(),
            tracker,
            silence,
            start: now,
            heard: now,
            number: 0,
            seen: 0,
            dropped: 0,
            bad: None,
            closed: None,
            followed: None,
            sample_number: 0,
            clock_offset: None,
            late: None,
            jumped: None,
            stamps: None,
            latest: None,
            second: (0, now, 0.0),
        }
    }

    /// Takes the lines that have come.
    fn take(&mut self) {
        for _ in 0..MAX_LINES {
            match self.lines.try_recv() {
                Ok(Line { arrived, text }) => {
                    self.number += 1;
                    self.heard = arrived;
                    match text {
                        Ok(text) if text.trim().is_empty() => {}
                        Ok(text) => self.add(arrived, &text),
                        Err(error) => self.closed = Some(Err(error)),
                    }
                }
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => {
                    self.closed.get_or_insert(Ok(()));
                    break;
                }
            }
        }
    }

    fn add(&mut self, arrived: Instant, text: &str) {
        let tips = self.source.line(text).and_then(|frame| {
            if self.source.changed {
                // What came before was stray, and so is its time.
                self.tracker = self.fresh.clone();
                (self.clock_offset, self.late) = (None, None);
            }
            let tips = self.tracker.add(frame.time, &frame.observation).map_err(|error| error.to_string())?;
            Ok((frame.time, tips))
        });
        match tips {
            Ok((time, tips)) => {
                self.seen = self.seen.saturating_add(1);
                self.bad = None;
                let age = self.age(arrived, time);
                (self.followed, self.latest) = (Some(arrived), Some((arrived, age, tips)));
            }
            Err(error) => self.drop_frame(arrived, &error),
        }
    }

    fn drop_frame(&mut self, arrived: Instant, error: &str) {
        self.dropped = self.dropped.saturating_add(1);
        let since = self.bad.take().map_or(arrived, |(since, _)| since);
        self.bad = Some((since, format!("line {}: {error}", self.number)));
    }

    /// How much later a frame comes than the soonest ones [s].
    #[expect(clippy::cast_possible_truncation, reason = "a short time")]
    fn age(&mut self, arrived: Instant, time: f64) -> f32 {
        let offset = arrived.duration_since(self.start).as_secs_f64() - time;
        let since = self.followed.map_or(0.0, |before| arrived.duration_since(before).as_secs_f64());
        let mut soonest =
            self.clock_offset.map_or(offset, |soonest| offset.min(soonest + CLOCK_DRIFT * since));
        if offset - soonest <= f64::from(LATE) {
            self.late = None;
        } else if self.late.get_or_insert(arrived).elapsed() > JUMPED {
            // A stamp was ahead, or the source has set its clock.
            let again = self.jumped.replace(arrived).is_some_and(|before| arrived - before < STEADY);
            if again {
                self.stamps = Some(format!(
                    "its time stamps fall behind the clock ({:.1} s late): is `time` in seconds?",
                    offset - soonest
                ));
            }
            (self.late, soonest) = (None, offset);
        }
        self.clock_offset = Some(soonest);
        // Stamps in another unit.
        let gaps = self.tracker.gaps();
        if gaps > 10 && 2 * gaps > self.seen {
            self.stamps = Some(format!(
                "more than half of its frames come more than {LATE} s after the one before by their time stamps: is \
                 `time` in seconds?"
            ));
        }
        (offset - soonest) as f32
    }

    /// Whether the newest frame shows the thumb, without which no finger is led.
    fn shows_thumb(&self) -> bool {
        self.latest.is_some_and(|(_, _, tips)| tips[0].is_some())
    }

    /// The newest sample that was not sent yet.
    fn sample(&mut self, now: Instant) -> Option<FingertipSample> {
        self.take();
        let (arrived, age, tips) = self.latest.take()?;
        let age = (age + now.saturating_duration_since(arrived).as_secs_f32()).clamp(0.0, 1.0);
        let sample = FingertipSample { number: self.sample_number.wrapping_add(1), age, tips };
        if let Err(refusal) = sample.validate() {
            self.drop_frame(arrived, &refusal.to_string());
            return None;
        }
        self.sample_number = sample.number;
        Some(sample)
    }

    /// Why the stream has ended, if it has.
    fn ending(&self) -> Option<Ending> {
        if let Some(stamps) = &self.stamps {
            return Some(Ending::Bad(stamps.clone()));
        }
        match (&self.bad, &self.closed) {
            (Some((since, error)), closed)
                if self.heard.duration_since(*since) > BAD || (closed.is_some() && self.seen == 0) =>
            {
                Some(Ending::Bad(error.clone()))
            }
            (_, Some(Err(error))) => Some(Ending::Bad(error.to_string())),
            (_, Some(Ok(()))) => Some(Ending::Closed),
            // A source may take its time to begin.
            (_, None) => (self.seen > 0 && self.heard.elapsed() > self.silence).then_some(Ending::Silent),
        }
    }

    /// Rate of the source, and what the hand does not reproduce.
    fn one_line(&mut self, hand: &TelexistenceTelemetry, model: &RobotModel, now: Instant) -> String {
        let (seen, begin, _) = self.second;
        let elapsed = now.duration_since(begin);
        if elapsed >= Duration::from_secs(1) {
            self.second = (self.seen, now, f64::from(self.seen - seen) / elapsed.as_secs_f64());
        }
        let mut text = format!("{:.0} frames/s", self.second.2);
        for ((finger, chain), error) in model.chains.iter().enumerate().zip(hand.errors) {
            if hand.missed >> finger & 1 != 0 {
                let _ = write!(text, "; {} off by {:.1} mm", chain.name, 1e3 * error);
            }
        }
        let unknown = Finger::ALL.into_iter().filter(|finger| hand.unknown >> *finger as u8 & 1 != 0);
        for finger in unknown.filter(|_| hand.samples > 0) {
            let _ = write!(text, "; {finger} unknown");
        }
        if self.late.is_some() {
            text += "; frames are late by their time stamps";
        }
        if hand.ignored > 0 {
            let _ =
                write!(text, "; {} ignored by the board", output::counted(hand.ignored as usize, "sample"));
        }
        if self.dropped > 0 {
            let _ = write!(text, "; {} dropped", output::counted(self.dropped as usize, "frame"));
            if let Some((_, error)) = &self.bad {
                let _ = write!(text, " ({error})");
            }
        }
        text
    }
}
