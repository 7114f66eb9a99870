//! `grasp`: an object in the hand.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use serde_json::json;
use tesaki_description::grasp;
use tesaki_supervisor::Board;
use tesaki::protocol::{Request, TaskReport};
use tesaki::task::grasping::{Failure as Trouble, GraspCommand, GraspTelemetry, Phase};
use tesaki::task::{TaskConfig, TaskTelemetry};

use crate::args::{Grasp, Options, Run, Step};
use crate::board_session::{BoardSession, interrupted};
use crate::failure::Failure;
use crate::motion::{End, Motion};
use crate::output;

/// From one sign of life to the next: one for each tick of the board.
const PERIOD: Duration = Duration::from_millis(10);
/// Shortest motion of an object [s].
const SHORTEST: f32 = 1.0;
/// Longest motion of an object [s].
const LONGEST: f32 = 600.0;
/// A motion of minimum jerk is so many times as fast in its middle as on average.
const PEAK: f32 = 1.875;

pub fn run(options: &Options, command: &Grasp) -> Result<(), Failure> {
    match command {
        Grasp::Run(aim) => take(options, aim),
        Grasp::Status => status(options),
    }
}

fn take(options: &Options, aim: &Run) -> Result<(), Failure> {
    let plan = grasp::load(&aim.file)?;
    for (name, speed) in [("--speed", aim.speed), ("--turn-speed", aim.turn_speed)] {
        if !(speed > 0.0 && speed.is_finite()) {
            return Err(Failure::Usage(format!("{name} {speed}: a number above 0 is needed")));
        }
    }
    let mut motion = Motion::begin(options)?;
    let ways = ways(aim, &Vector3::from(motion.model.gravity))?;
    output::confirm(
        options,
        &format!("{} will grasp what is where {} says. Go on?", motion.model.name, aim.file.display()),
    )?;
    // From here on its telemetry comes, which tells of faults.
    motion.positions()?;
    motion.enable(TaskConfig::Grasping(()))?;
    let begun = Instant::now();
    let (tick, last) = match motion.grasp(GraspCommand::Grasp(plan)) {
        Ok(report) => report,
        Err(failure) => {
            motion.end(false)?;
            return Err(failure);
        }
    };
    let mut course =
        Course { options, motion, begun, tick, last, held_since: None, held_for: Duration::ZERO };
    course.tell();
    let result = course.go(&aim.file, &ways);
    course.end(&aim.file, result)
}

/// What to ask the hand for, and how long to wait then; `None`: until Ctrl-C.
struct Way {
    command: Option<GraspCommand>,
    wait: Option<Duration>,
}

/// The steps as commands, each with a time that keeps the speeds.
fn ways(aim: &Run, gravity: &Vector3<f32>) -> Result<Vec<Way>, Failure> {
    let up = if gravity.norm() > 0.0 { -gravity.normalize() } else { Vector3::z() };
    let (mut lift, mut shift, mut turn) = (0.0, Vector3::zeros(), Vector3::zeros());
    let mut ways = Vec::new();
    for step in &aim.steps {
        let (place, turned) = (up * lift + shift, turn);
        match *step {
            Step::Lift(height) => lift = height,
            Step::Shift(to) => shift = Vector3::from(to),
            Step::Turn(to) => turn = Vector3::from(to),
            Step::Hold(wait) => {
                ways.push(Way { command: None, wait });
                continue;
            }
        }
        let target = up * lift + shift;
        // The angle between two turns is at most that between their vectors.
        let needed =
            ((target - place).norm() / aim.speed).max((turn - turned).norm() / aim.turn_speed) * PEAK;
        let duration = needed.max(SHORTEST);
        if duration > LONGEST {
            return Err(Failure::Usage(format!(
                "a step would take {duration:.0} s, more than {LONGEST} s: a higher --speed or --turn-speed"
            )));
        }
        ways.push(Way {
            command: Some(GraspCommand::Move { translation: target.into(), rotation: turn.into(), duration }),
            wait: Some(Duration::ZERO),
        });
    }
    if ways.is_empty() {
        ways.push(Way { command: None, wait: None });
    }
    Ok(ways)
}

/// A grasp that goes on.
struct Course<'a> {
    options: &'a Options,
    motion: Motion<'a>,
    begun: Instant,
    /// The last report on the hand, and its tick.
    tick: u32,
    last: GraspTelemetry,
    /// When the hand held the object first, and for how long it has.
    held_since: Option<Instant>,
    held_for: Duration,
}

impl Course<'_> {
    /// Tells people what the hand does.
    fn tell(&self) {
        let seconds = self.begun.elapsed().as_secs_f32();
        output::notice(self.options, &format!("{seconds:6.2} s  the hand {}", self.last.phase));
    }

    fn command(&mut self, command: GraspCommand) -> Result<(), Failure> {
        let before = self.last.phase;
        (self.tick, self.last) = self.motion.grasp(command)?;
        if self.last.phase != before {
            self.tell();
        }
        Ok(())
    }

    /// Keeps the board going until `done`.
    fn follow(&mut self, mut done: impl FnMut(&GraspTelemetry, Instant) -> bool) -> Result<End, Failure> {
        let (options, begun) = (self.options, self.begun);
        let Self { motion, tick, last, held_since, held_for, .. } = self;
        motion.drive(
            PERIOD,
            |_| Request::Keep,
            |news, now| {
                // What was on its way when the hand was told something still says otherwise.
                if let Some(TaskReport { tick: told, telemetry: TaskTelemetry::Grasping(grasp) }) = &news.task
                    && told.wrapping_sub(*tick) < 1 << 31
                {
                    *tick = *told;
                    if grasp.phase != last.phase {
                        let seconds = (now - begun).as_secs_f32();
                        output::notice(options, &format!("{seconds:6.2} s  the hand {}", grasp.phase));
                    }
                    *last = *grasp;
                }
                if matches!(last.phase, Phase::Hold | Phase::Move | Phase::Lower) {
                    *held_for = now - *held_since.get_or_insert(now);
                }
                done(last, now)
            },
        )
    }

    /// Until the hand does nothing but stand or hold.
    fn settle(&mut self) -> Result<End, Failure> {
        self.follow(|grasp, _| matches!(grasp.phase, Phase::Ready | Phase::Hold))
    }

    /// The whole course, from the first touch to the last step.
    fn go(&mut self, file: &Path, ways: &[Way]) -> Result<End, Failure> {
        if self.settle()? == End::Interrupted {
            return Ok(End::Interrupted);
        }
        self.check(file)?;
        for way in ways {
            if let Some(command) = way.command {
                self.command(command)?;
                if self.settle()? == End::Interrupted {
                    return Ok(End::Interrupted);
                }
                self.check(file)?;
            }
            let until = way.wait.map(|wait| Instant::now() + wait);
            if until.is_none() {
                output::notice(self.options, "holding; Ctrl-C puts the object down");
            }
            if self.follow(|_, now| until.is_some_and(|until| now >= until))? == End::Interrupted {
                return Ok(End::Interrupted);
            }
        }
        Ok(End::Done)
    }

    fn check(&self, file: &Path) -> Result<(), Failure> {
        self.last.failure.map_or(Ok(()), |trouble| Err(Failure::Grasp(in_words(&trouble, file))))
    }

    /// Puts down what is in the hand, and switches off.
    fn end(mut self, file: &Path, result: Result<End, Failure>) -> Result<(), Failure> {
        let gone = |failure: &Failure| {
            !matches!(
                failure,
                Failure::Grasp(_) | Failure::Board(tesaki_supervisor::BoardError::Refused { .. })
            )
        };
        let interrupted_by = match result {
            Err(Failure::Fault(fault)) => return Err(self.fault(&fault)),
            Err(failure) if gone(&failure) => return Err(failure),
            Ok(End::Interrupted) => true,
            _ => false,
        };
        if interrupted_by {
            interrupted()?.store(false, Ordering::Relaxed);
            if !matches!(self.last.phase, Phase::Ready | Phase::Approach | Phase::Touch) {
                output::notice(
                    self.options,
                    "\nCtrl-C: puts the object down; once more: disarms, and it falls",
                );
            }
        }
        match self.put_away(file) {
            Err(Failure::Fault(fault)) => return Err(self.fault(&fault)),
            Err(failure) if gone(&failure) => return Err(failure),
            Err(failure) => {
                self.motion.end(false)?;
                return Err(result.err().unwrap_or(failure));
            }
            Ok(()) => {}
        }
        let (last, held_for) = (self.last, self.held_for.as_secs_f32());
        self.motion.end(interrupted_by)?;
        result?;
        let value = json!({
            "held_seconds": output::exact(&held_for),
            "friction": output::exact(&last.friction),
            "slips": last.slips,
        });
        output::result(self.options, &value, || {
            format!(
                "done: held for {held_for:.1} s, coefficient of friction {:.2}, a contact slid in {}",
                last.friction,
                output::counted(last.slips.into(), "tick"),
            )
        })
    }

    fn put_away(&mut self, file: &Path) -> Result<(), Failure> {
        match self.last.phase {
            Phase::Ready | Phase::Approach | Phase::Touch => return Ok(()),
            Phase::Squeeze | Phase::ProbeFriction => self.command(GraspCommand::Open)?,
            Phase::Hold => {}
            Phase::Move | Phase::Lower | Phase::Open => {
                if self.settle()? == End::Interrupted {
                    return Ok(());
                }
            }
        }
        if self.last.phase == Phase::Hold {
            self.command(GraspCommand::PutDown)?;
        }
        if self.settle()? == End::Interrupted || self.last.phase != Phase::Hold {
            return Ok(());
        }
        // Nothing below, or a finger at its end: only somebody who is there can say when to let go.
        output::notice(
            self.options,
            &self.last.failure.map_or_else(String::new, |trouble| in_words(&trouble, file)),
        );
        output::notice(self.options, "holding; Ctrl-C lets go");
        self.follow(|grasp, _| grasp.phase == Phase::Ready)?;
        interrupted()?.store(false, Ordering::Relaxed);
        let trouble = self.check(file);
        self.command(GraspCommand::Open)?;
        self.settle()?;
        trouble
    }

    /// A fault, and what it means for what is in the hand.
    fn fault(&self, fault: &str) -> Failure {
        if self.held_since.is_none() {
            return Failure::Fault(fault.to_owned());
        }
        Failure::Fault(format!(
            "{fault}\nWhat was in the hand has fallen, or the joints hold it with the model's reaction: `tesaki disarm` \
             lets go"
        ))
    }
}

/// What went wrong, and what to do.
fn in_words(trouble: &Trouble, file: &Path) -> String {
    let file = file.display();
    let advice = match trouble {
        Trouble::Obstructed { .. } => format!(
            "Is something in its way? It goes straight to the place in front of its [[contact]] in {file}: start with \
             the fingers open (`tesaki move`). With nothing in the way, tare again (`tesaki tare`)"
        ),
        Trouble::NothingThere { .. } => format!(
            "Is the object where [object] in {file} says? A larger clearance there lets the fingers feel farther"
        ),
        Trouble::NoGrip { .. } => format!(
            "Can the fingers press so hard? Compare force_limit and internal in {file} with the joints' torques, and see \
             whether the object gives way"
        ),
        Trouble::NothingBelow { .. } => "Put something under it, or take it with your hand".to_owned(),
        Trouble::OutOfReach { .. } => "Smaller steps, or grasp the object elsewhere".to_owned(),
    };
    format!("{trouble}. {advice}")
}

fn status(options: &Options) -> Result<(), Failure> {
    let mut session = BoardSession::open(options)?;
    let grasp = session.board.read_grasp()?;
    output::result(options, &output::exact(&grasp), || {
        let mut text = format!("the hand {}\n", grasp.phase);
        if let Some(trouble) = grasp.failure {
            let _ = writeln!(text, "{:<14} {trouble}", "went wrong");
        }
        if matches!(grasp.phase, Phase::Ready | Phase::Approach | Phase::Touch) {
            return text;
        }
        let list = |values: &[f32], digits: usize| {
            values.iter().map(|value| format!("{value:.digits$}")).collect::<Vec<_>>().join(", ")
        };
        let mut line = |name: &str, value: String| {
            let _ = writeln!(text, "{name:<14} {value}");
        };
        line("position", format!("{} m", list(&grasp.position, 4)));
        line("orientation", format!("{} (x, y, z, w)", list(&grasp.orientation, 4)));
        line("load", format!("{} N; {} N·m", list(&grasp.load[..3], 2), list(&grasp.load[3..], 3)));
        for (finger, force) in (1..).zip(&grasp.wanted) {
            let size = Vector3::from(*force).norm();
            line(&format!("finger {finger}"), format!("{size:.2} N wanted ({})", list(force, 2)));
        }
        line("friction", format!("{:.2}", grasp.friction));
        line("slips", output::counted(grasp.slips.into(), "tick"));
        if grasp.overloaded {
            line("overloaded", "no forces within the limits hold the load".to_owned());
        }
        text
    })
}
