//! `follow`: an arm under impedance control, led by the poses of a hand.

mod lead;
mod master;
mod pace;
mod reflect;
mod source;

use std::cell::RefCell;
use std::sync::atomic::Ordering;
use std::thread;
use std::time::{Duration, Instant};

use tesaki::kinematics::Chain;
use tesaki::protocol::{Request, TaskReport};
use tesaki::robot::Robot;
use tesaki::task::impedance::{Arm, ImpedanceRefusal, ImpedanceSettings};
use tesaki::task::{TaskConfig, TaskRefusal, TaskTelemetry};
use tesaki::teleop::{Follower, FollowerSettings};
use tesaki_description::impedance;
use tesaki_supervisor::BoardError;

use crate::args::{Follow, Options, PoseSource};
use crate::board_session::interrupted;
use crate::failure::Failure;
use crate::feed::{Ending, Feed};
use crate::motion::{End, KEEP_ALIVE, Motion, News, PERIOD};
use crate::output;
use lead::Lead;
use reflect::Reflection;
use source::{Content, Entry, Source};

/// Time in which the set-point comes to rest behind an open clutch: from 1 m/s with 8 m/s², and its last
/// part.
const REST: Duration = Duration::from_millis(400);
/// What to do about a source that has nothing.
const NO_SAMPLES: &str = ". Does what feeds it run? A recording is given by --from file:FILE.csv";

pub fn run(options: &Options, args: &Follow) -> Result<(), Failure> {
    let settings =
        FollowerSettings { scale: args.scale, workspace: args.workspace, ..FollowerSettings::HUMAN };
    let follower = Follower::try_new(settings).map_err(|invalid| Failure::Usage(invalid.to_string()))?;
    let mut motion = Motion::begin(options)?;
    require_arm(&motion)?;
    let settings = impedance::load(&args.impedance, &motion.model)?;
    check_workspace(args, &mut motion)?;
    let source = Source::open(options, args, &mut motion, &settings)?;
    let mut lead = Lead::new(source, follower, args, &settings);
    output::notice(options, &format!("waiting for {}", lead.source.feed.place));
    motion.wait_until(|| {
        let is_there = lead.take();
        let ending = lead.source.feed.ending();
        ending.map_or(Ok(is_there), |ending| Err(ending.before_enabling(NO_SAMPLES)))
    })?;
    let reflects = args.reflect.as_ref().map_or_else(String::new, |file| {
        format!(
            " The master will be powered, too, and yield as specified in {}; at the end it falls unless it is supported.",
            file.display()
        )
    });
    let is_led_by_input = args.from == PoseSource::StandardInput;
    output::confirm_lead(
        options,
        &format!(
            "The tool of {} will follow {}, and yield as specified in {}.{reflects}",
            motion.model.name,
            lead.source.feed.place,
            args.impedance.display()
        ),
        is_led_by_input,
    )?;
    // The arm may have moved during the question.
    check_workspace(args, &mut motion)?;
    let commands = (!is_led_by_input).then(|| Feed::<String>::standard_input("command", args.silence));
    if args.reflect.is_some() {
        enable_master(options, &mut lead)?;
    }
    let port = motion.port().to_owned();
    let ending =
        lead_arm(options, args, motion, lead, settings, commands).map_err(|failure| match failure {
            // Two boards are at work.
            Failure::Board(_)
            | Failure::Fault(_)
            | Failure::Late(_)
            | Failure::Refused(_)
            | Failure::Other(_)
                if matches!(args.from, PoseSource::Board(_)) =>
            {
                Failure::OtherBoard(port, Box::new(failure.through(&options.port)))
            }
            failure => failure,
        })?;
    ending.map_or(Ok(()), Ending::after_enabling)
}

/// Enables the arm and leads it to the end; returns how the source has ended, if that was the cause.
fn lead_arm(
    options: &Options,
    args: &Follow,
    mut motion: Motion<'_>,
    mut lead: Lead,
    settings: ImpedanceSettings,
    commands: Option<Feed<String>>,
) -> Result<Option<Ending>, Failure> {
    motion.enable(TaskConfig::Impedance(settings))?;
    if args.reflect.is_some() {
        motion.ask_in_each_period();
    }
    lead.begin(&motion.impedance()?);
    motion.announce_ctrl_c(motion.load().as_ref());
    let mut session = Session { options, lead, commands, live: output::Live::new(options) };
    let until = args.duration.map(|duration| Instant::now() + duration);
    let end = session.drive(&mut motion, until)?;
    let ending = session.lead.source.feed.ending().filter(|_| end == End::Done && !has_passed(until));
    let why = match (&ending, end) {
        (Some(ending), _) => ending.reason.clone(),
        (None, End::Interrupted) => "Ctrl-C".to_owned(),
        (None, End::Done) => "the time is over".to_owned(),
    };
    session.lead.open(&why);
    if end == End::Interrupted {
        interrupted()?.store(false, Ordering::Relaxed);
    }
    let again = session.settle(&mut motion)?;
    session.live.end();
    let Session { lead, .. } = session;
    let (text, value) = lead.summary();
    // Nobody takes a master's samples any more: it is disabled, which takes time while the arm must be kept.
    let leader = thread::spawn(|| drop(lead));
    if end == End::Done && again == End::Done {
        let load = motion.load();
        motion.stay(args.stay.hold, args.stay.no_hold, load.as_ref(), KEEP_ALIVE, |_| Request::Keep)?;
    }
    motion.end(end == End::Interrupted || again == End::Interrupted)?;
    let _ = leader.join();
    output::result(options, &value, || text)?;
    Ok(ending)
}

fn has_passed(time: Option<Instant>) -> bool {
    time.is_some_and(|time| Instant::now() >= time)
}

/// The board says this too, but not before a source is there.
fn require_arm(motion: &Motion<'_>) -> Result<(), Failure> {
    let mut robot = Box::new(Robot::NONE);
    match robot.configure(&motion.model) {
        Ok(()) if Arm::of(&robot).is_some() => Ok(()),
        _ => Err(Failure::Usage(format!("{}: {}", motion.model.name, ImpedanceRefusal::NotAnArm))),
    }
}

/// Enables a master that is to feel the force.
fn enable_master(options: &Options, lead: &mut Lead) -> Result<(), Failure> {
    let begun = Instant::now();
    loop {
        // Where nobody takes its samples, the master waits.
        lead.take();
        let failure = match lead.source.reflection.as_ref().and_then(Reflection::enable_master) {
            Some(Ok(())) => return Ok(()),
            Some(Err(Failure::Board(BoardError::Interrupted))) => {
                return Err(Failure::Interrupted(
                    "the master was told to disable, and the arm was not enabled".to_owned(),
                ));
            }
            Some(Err(failure)) => failure,
            None if begun.elapsed() > options.timeout => Failure::Late("it does not answer".to_owned()),
            None => {
                thread::sleep(PERIOD);
                continue;
            }
        };
        return Err(Failure::OtherBoard(lead.source.feed.place.clone(), Box::new(failure)));
    }
}

/// The tool must be in the workspace when it begins to follow.
fn check_workspace(args: &Follow, motion: &mut Motion<'_>) -> Result<(), Failure> {
    // Also starts the telemetry, which reports faults.
    let angles = motion.positions()?;
    let Some(workspace) = &args.workspace else { return Ok(()) };
    let posture = Chain::of_model(&motion.model, 0).posture(&angles);
    let tool: [f32; 3] = posture.tip().translation.vector.into();
    if workspace.contains(&tool) {
        return Ok(());
    }
    let [x, y, z] = tool;
    Err(Failure::Usage(format!(
        "--workspace: the tool is at {x:.4}, {y:.4}, {z:.4} m, outside of the box: move the arm into it, or choose a box \
         around it"
    )))
}

/// An arm that is led.
struct Session<'a> {
    options: &'a Options,
    lead: Lead,
    /// Commands of the operator, where standard input is not the source.
    commands: Option<Feed<String>>,
    live: output::Live,
}

impl Session<'_> {
    /// Follows the source until it ends, or the time `until`.
    fn drive(&mut self, motion: &mut Motion<'_>, until: Option<Instant>) -> Result<End, Failure> {
        let session = RefCell::new(self);
        motion.drive(
            PERIOD,
            |now| {
                let mut session = session.borrow_mut();
                session.lead.take();
                session.obey();
                session.lead.tick(now)
            },
            |news, now| {
                let mut session = session.borrow_mut();
                session.hear(news, now);
                session.lead.source.feed.ending().is_some() || until.is_some_and(|until| now >= until)
            },
        )
    }

    /// Behind an open clutch: waits until the set-point rests.
    fn settle(&mut self, motion: &mut Motion<'_>) -> Result<End, Failure> {
        let until = Instant::now() + REST;
        let session = RefCell::new(self);
        motion.drive(
            PERIOD,
            |now| session.borrow_mut().lead.tick(now),
            |news, now| {
                session.borrow_mut().hear(news, now);
                now >= until
            },
        )
    }

    /// What the operator types.
    fn obey(&mut self) {
        while let Some((_, text)) = self.commands.as_mut().and_then(Feed::next) {
            match (text.trim(), Content::Line(text.clone()).read()) {
                ("", _) => {}
                ("closed", _) => self.lead.ask(true),
                ("open", _) => self.lead.ask(false),
                (_, Some(Ok(Entry::Clutch(closed)))) => self.lead.ask(closed),
                (other, _) => output::notice(
                    self.options,
                    &format!(
                        "standard input: unknown command {other:?}: type `closed` or `open` to work the clutch"
                    ),
                ),
            }
        }
    }

    fn hear(&mut self, news: &News, now: Instant) {
        if let Some(TaskReport { telemetry: TaskTelemetry::Impedance(tool), .. }) = &news.task {
            self.lead.heard(tool);
            let text = self.lead.one_line(now);
            self.live.show(&text);
        }
        if let Some(TaskRefusal::Impedance(ImpedanceRefusal::Setpoint(error))) = news.refused {
            self.lead.refused(error);
        }
        for event in self.lead.events.drain(..) {
            if self.options.json {
                // If nobody reads it, the next report says so.
                let _ = output::line(&event.value.to_string());
            } else {
                self.live.end();
                output::notice(self.options, &event.text);
            }
        }
    }
}
