//! A board's hand led by a stream of frames.

use std::cell::RefCell;
use std::fmt::Write as _;
use std::time::Instant;

use serde_json::json;
use tesaki::model::RobotModel;
use tesaki::protocol::{Request, TaskReport};
use tesaki::task::telexistence::{FingertipSample, TelexistenceCommand, TelexistenceTelemetry};
use tesaki::task::{TaskCommand, TaskConfig, TaskTelemetry};
use tesaki::teleop::HumanFinger;
use tesaki_description::retargeting::RetargetingSettings;
use tesaki_description::robot::RobotFolder;
use tesaki_supervisor::operator::{Fingertips, FrameError, Tracker};
use tesaki_supervisor::publication::require_own;

use super::source::{Source, tracker};
use super::tell_defaults;
use crate::args::{Options, Retarget};
use crate::failure::Failure;
use crate::feed::{Ending, Feed, MAX_TAKEN, RESTART};
use crate::motion::{End, KEEP_ALIVE, Motion, PERIOD};
use crate::output;

/// Where all vectors from the thumb's tip are off by more than this [m], the thumb's offset is likely to be
/// wrong.
const UNLIKE: f32 = 0.015;
/// What to do about a source that is a file.
const NO_FILE: &str = " (give a file by --in, without --live)";

pub fn run(options: &Options, args: &Retarget) -> Result<(), Failure> {
    let feed = match args.udp {
        Some(address) => Feed::udp(address, "frame", args.silence)?,
        None => Feed::standard_input("frame", args.silence),
    };
    let mut motion = Motion::begin(options)?;
    let settings = match &args.robot {
        Some(folder) => {
            // It may hold nothing but retargeting.toml.
            if folder.join("controller.toml").exists() {
                require_own(Some(&RobotFolder::load(folder)?), &motion.model)?;
            }
            let settings = RetargetingSettings::load(folder, &motion.model)?;
            tell_defaults(options, folder);
            settings
        }
        // There is no file in no folder.
        None => {
            output::notice(options, "without --robot DIR, whose retargeting.toml is read, defaults are used");
            RetargetingSettings::check("the settings".as_ref(), "", &motion.model).0.ok_or_else(|| {
                Failure::Usage(format!(
                    "the robot on the board, {}, is not a hand with two to five fingers",
                    motion.model.name
                ))
            })?
        }
    };
    let tracker = tracker(args, &settings)?;
    let mut stream = Stream::new(feed, Source::new(args), tracker, settings.task.max_sample_age);
    output::notice(
        options,
        &format!("waiting for the operator's hand at {}: hold it like the robot's", stream.feed.place),
    );
    let (begin, mut told) = (Instant::now(), None);
    motion.wait_until(|| {
        stream.take();
        let ending = stream.feed.ending();
        ending.map_or(Ok(()), |ending| Err(ending.before_enabling(NO_FILE)))?;
        let shows_thumb = stream.shows_thumb();
        let frames_come = stream.feed.seen > 0;
        if !shows_thumb && begin.elapsed() > args.silence && told.replace(frames_come) != Some(frames_come) {
            output::notice(options, &stream.lacks());
        }
        Ok(shows_thumb)
    })?;
    let warning = format!("{} will follow the operator's hand.", motion.model.name);
    output::confirm_lead(options, &warning, args.udp.is_none())?;
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
            stream.feed.ending().is_some()
        },
    );
    live.end();
    let end = end?;
    let stream = stream.into_inner();
    let ending = stream.feed.ending().filter(|_| end == End::Done);
    if end == End::Interrupted {
        motion.end(true)?;
    } else {
        let load = motion.load();
        if let Some(ending) = &ending {
            output::notice(options, &format!("{}: the hand keeps its position", ending.reason));
        }
        motion.stay(args.hold, args.no_hold, load.as_ref(), KEEP_ALIVE, |_| Request::Keep)?;
        motion.end(false)?;
    }
    let value =
        json!({ "frames": stream.feed.seen, "dropped": stream.feed.dropped, "gaps": stream.tracker.gaps() });
    output::result(options, &value, || {
        format!(
            "done: {} followed, {} dropped, {} too long to be bridged",
            output::counted(stream.feed.seen as usize, "frame"),
            stream.feed.dropped,
            output::counted(stream.tracker.gaps() as usize, "gap"),
        )
    })?;
    ending.map_or(Ok(()), Ending::after_enabling)
}

/// The frames of a source, checked and filtered.
struct Stream {
    feed: Feed<String>,
    source: Source,
    tracker: Tracker,
    /// Longest gap that is bridged [s].
    max_gap: f32,
    /// Of the last sample for the board.
    sample_number: u16,
    /// The newest fingertips that were not sent yet, with when they came, and their age then [s].
    latest: Option<(Instant, f32, Fingertips)>,
}

impl Stream {
    fn new(feed: Feed<String>, source: Source, tracker: Tracker, max_gap: f32) -> Self {
        Self { feed, source, tracker, max_gap, sample_number: 0, latest: None }
    }

    /// Takes the lines that have come.
    fn take(&mut self) {
        for _ in 0..MAX_TAKEN {
            match self.feed.next() {
                Some((_, text)) if text.trim().is_empty() => {}
                Some((arrived, text)) => self.add(arrived, &text),
                None => break,
            }
        }
    }

    fn add(&mut self, arrived: Instant, text: &str) {
        let tips = self.source.line(text).and_then(|frame| {
            if self.source.changed {
                // What came before was stray, and so is its time.
                self.restart();
            }
            let mut tips = self.tracker.add(frame.time, &frame.observation);
            if let Err(FrameError::Time { time, before }) = tips
                && time < before - RESTART
            {
                // So were those before, or the source has begun anew.
                self.restart();
                tips = self.tracker.add(frame.time, &frame.observation);
            }
            Ok((frame.time, tips.map_err(|error| error.to_string())?))
        });
        match tips {
            Ok((time, tips)) => {
                let age = self.feed.accept(arrived, time);
                self.check_gaps();
                self.latest = Some((arrived, age, tips));
            }
            Err(error) => self.feed.reject(arrived, &error),
        }
    }

    fn restart(&mut self) {
        self.tracker.restart();
        self.feed.forget_time();
    }

    /// Stamps in another unit make every frame a gap.
    fn check_gaps(&mut self) {
        let gaps = self.tracker.gaps();
        if gaps > 10 && 2 * gaps > self.feed.seen {
            self.feed.distrust(format!(
                "more than half of its frames come more than {} s after the one before by their time stamps: is `time` in \
                 seconds?",
                self.max_gap
            ));
        }
    }

    /// Whether the newest frame shows the thumb, without which no finger is led.
    fn shows_thumb(&self) -> bool {
        self.latest.is_some_and(|(_, _, tips)| tips[0].is_some())
    }

    /// What the hand waits for.
    fn lacks(&self) -> String {
        let place = &self.feed.place;
        if self.feed.seen > 0 {
            format!("frames come from {place}, but none shows the thumb, without which no finger is led")
        } else {
            format!("nothing has come from {place} yet: does what feeds it run?")
        }
    }

    /// The newest sample that was not sent yet.
    fn sample(&mut self, now: Instant) -> Option<FingertipSample> {
        self.take();
        let (arrived, age, tips) = self.latest.take()?;
        let age = (age + now.saturating_duration_since(arrived).as_secs_f32()).clamp(0.0, 1.0);
        let sample = FingertipSample { number: self.sample_number.wrapping_add(1), age, tips };
        if let Err(refusal) = sample.validate() {
            self.feed.reject(arrived, &refusal.to_string());
            return None;
        }
        self.sample_number = sample.number;
        Some(sample)
    }

    /// Rate of the source, and what the hand does not reproduce.
    fn one_line(&mut self, hand: &TelexistenceTelemetry, model: &RobotModel, now: Instant) -> String {
        let mut text = format!("{:.0} frames/s", self.feed.rate(now));
        for ((finger, chain), error) in model.chains.iter().enumerate().zip(hand.errors) {
            if hand.missed >> finger & 1 != 0 {
                let _ = write!(text, "; {} off by {:.1} mm", chain.name, 1e3 * error);
            }
        }
        let mut errors = hand.errors.iter().take(model.chains.len()).skip(1);
        if hand.limited == 0 && errors.all(|error| *error > UNLIKE) {
            text += " (did the operator's hand begin like the robot's?)";
        }
        let unknown = HumanFinger::ALL.into_iter().filter(|finger| hand.unknown >> *finger as u8 & 1 != 0);
        for finger in unknown.filter(|_| hand.samples > 0) {
            let _ = write!(text, "; {finger} unknown");
        }
        if self.feed.is_late() {
            text += "; frames are late by their time stamps";
        }
        if hand.ignored > 0 {
            let _ =
                write!(text, "; {} ignored by the board", output::counted(hand.ignored as usize, "sample"));
        }
        if self.feed.dropped > 0 {
            let _ = write!(text, "; {} dropped", output::counted(self.feed.dropped as usize, "frame"));
            if let Some(error) = self.feed.error() {
                let _ = write!(text, " ({error})");
            }
        }
        text
    }
}
