//! `grasp`: grasping and moving an object.

use std::fmt::Write as _;
use std::path::Path;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use nalgebra::Vector3;
use serde_json::json;
use tesaki::model::RobotModel;
use tesaki::protocol::{Mode, Request, TaskReport};
use tesaki::signal::MINIMUM_JERK_PEAK;
use tesaki::task::grasping::{
    ASSUMED_FRICTION, Failure as GraspFailure, GraspCommand, GraspPlan, GraspTelemetry, Phase, PlannedContact,
};
use tesaki::task::{TaskConfig, TaskKind, TaskTelemetry};
use tesaki_description::grasp;
use tesaki_supervisor::hand::{HandModel, angles_at};
use tesaki_supervisor::{Board, BoardError, words};

use crate::args::{Grasp, Options, Run, Step};
use crate::board_session::{BoardSession, interrupted};
use crate::failure::Failure;
use crate::motion::{End, MAX_DURATION, Motion, PERIOD, check_distance};
use crate::output;

/// Below this height an object stands on its support [m].
const LIFTED: f32 = 0.002;
/// What other robots than hands for grasping can do.
pub const OTHERS: &str = "`tesaki move` moves the joints of any robot, `tesaki impedance` an arm";
/// Shortest motion of an object [s].
const MIN_DURATION: f32 = 1.0;

pub fn run(options: &Options, command: &Grasp) -> Result<(), Failure> {
    match command {
        Grasp::Run(args) => grasp_object(options, args),
        Grasp::Status => status(options),
    }
}

fn grasp_object(options: &Options, args: &Run) -> Result<(), Failure> {
    let plan = grasp::load(&args.file)?;
    let mut motion = Motion::begin(options)?;
    let plan = suited(plan, &args.file, &motion.model)?;
    let steps = timed_steps(args, &motion.model)?;
    output::confirm(
        options,
        &format!(
            "{} will grasp the object described in {}. Continue?",
            motion.model.name,
            args.file.display()
        ),
    )?;
    // Starts the telemetry, which reports faults.
    motion.positions()?;
    motion.enable(TaskConfig::Grasping(()))?;
    let begun = Instant::now();
    let probes = plan.friction.is_none();
    let (tick, last) = match motion.grasp(GraspCommand::Grasp(plan)) {
        Ok(report) => report,
        Err(failure) => {
            motion.end(false)?;
            return Err(failure);
        }
    };
    let mut course = Course {
        options,
        motion,
        begun,
        tick,
        last,
        held_since: None,
        held_for: Duration::ZERO,
        probes,
        was_overloaded: false,
        is_complete: false,
    };
    course.report_phase();
    let result = course.run(&args.file, &steps);
    course.end(&args.file, result)
}

/// Loads a plan and checks it for a robot.
pub fn load_for(file: &Path, model: &RobotModel) -> Result<GraspPlan, Failure> {
    suited(grasp::load(file)?, file, model)
}

/// A plan that was loaded before the robot was known, checked for it.
pub fn suited(plan: GraspPlan, file: &Path, model: &RobotModel) -> Result<GraspPlan, Failure> {
    HandModel::try_new(model).map_err(|error| Failure::Usage(format!("{error}; {OTHERS}")))?;
    match check_for(&plan, model) {
        Ok(()) => Ok(plan),
        Err(problem) => Err(Failure::Usage(format!("{}: {problem}", file.display()))),
    }
}

/// Checks a plan for a robot.
///
/// # Errors
/// What is too far away or, a line for each finger, out of a finger's reach, or would be a fault.
pub fn check_for(plan: &GraspPlan, model: &RobotModel) -> Result<(), String> {
    for (number, contact) in (1..).zip(&plan.contacts) {
        let distance = Vector3::from(contact.position).norm();
        check_distance(&format!("contact {number}"), distance, model)
            .map_err(|failure| failure.to_string())?;
    }
    reached(plan, model)?;
    let sensors = model.chains.iter().filter_map(|chain| Some((chain, chain.force_sensor.as_ref()?)));
    for (chain, sensor) in sensors {
        if plan.force_limit > sensor.force_limit {
            return Err(format!(
                "force_limit = {} N: more than {} N at {} is a fault of the robot, which drops the object; at most {} N",
                plan.force_limit, sensor.force_limit, chain.name, sensor.force_limit
            ));
        }
    }
    Ok(())
}

/// Checks that each finger can stand at its contact, and in front of it.
fn reached(plan: &GraspPlan, model: &RobotModel) -> Result<(), String> {
    let reaches = |finger: usize, contact: &PlannedContact, distance: f32| {
        angles_at(model, finger, contact, distance).unwrap_or(Ok([0.0; 3]))
    };
    // In another order, they may all be within reach.
    let order = [[0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]].into_iter().find(|order| {
        (0..).zip(order).all(|(finger, &contact)| reaches(finger, &plan.contacts[contact], 0.0).is_ok())
    });
    let mut problems = Vec::new();
    for (finger, (chain, contact)) in model.chains.iter().zip(&plan.contacts).enumerate() {
        let (tip, number) = (&chain.name, finger + 1);
        if let Err(why) = reaches(finger, contact, 0.0) {
            let order = order.map_or_else(String::new, |order| {
                let other = order[finger] + 1;
                format!("; contact {other} is within its reach: are they in the fingers' order?")
            });
            problems.push(format!("{tip} cannot stand at contact {number}: {why}{order}"));
        } else if let Err(why) = reaches(finger, contact, plan.clearance) {
            let distance = 1e3 * plan.clearance;
            problems.push(format!("{tip} cannot stand {distance:.1} mm in front of contact {number}: {why}"));
        }
    }
    if problems.is_empty() { Ok(()) } else { Err(problems.join("\n")) }
}

/// A step of the grasp.
struct TimedStep {
    /// As it was typed.
    text: String,
    command: Option<GraspCommand>,
    /// How long to hold afterwards; `None`: until Ctrl-C.
    wait: Option<Duration>,
    /// Whether it moves the object where that stood when it was grasped.
    on_support: bool,
}

/// Whether an object stands on its support at all these displacements from where it was grasped.
pub fn is_on_support(model: &RobotModel, displacements: &[Vector3<f32>]) -> bool {
    let up = Vector3::from(model.gravity).try_normalize(0.0).map(|down| -down);
    up.is_some_and(|up| displacements.iter().all(|displacement| displacement.dot(&up) < LIFTED))
}

/// The steps as commands, each with a duration that respects the maximum speeds.
fn timed_steps(args: &Run, model: &RobotModel) -> Result<Vec<TimedStep>, Failure> {
    let gravity = Vector3::from(model.gravity);
    let up = if gravity.norm() > 0.0 { -gravity.normalize() } else { Vector3::z() };
    let (mut lift, mut shift, mut turn) = (0.0, Vector3::zeros(), Vector3::zeros());
    let mut steps = Vec::new();
    let endless = args.steps.iter().position(|step| matches!(step, Step::Hold(None)));
    if endless.is_some_and(|index| index + 1 < args.steps.len()) {
        return Err(Failure::Usage(
            "hold without a time never ends, and the steps after it are never reached: give it a time, as in hold=5, or \
             put it last"
                .to_owned(),
        ));
    }
    for step in &args.steps {
        let (last_position, last_turn) = (up * lift + shift, turn);
        match *step {
            Step::Lift(height) => lift = height,
            Step::Shift(to) => shift = Vector3::from(to),
            Step::Turn(to) => turn = Vector3::from(to),
            Step::Hold(wait) => {
                steps.push(TimedStep { text: step.to_string(), command: None, wait, on_support: false });
                continue;
            }
        }
        let target = up * lift + shift;
        check_distance(&format!("the step {step}"), (target - last_position).norm(), model)?;
        // The angle between two rotations is at most the distance of their rotation vectors.
        let needed = ((target - last_position).norm() / args.speed)
            .max((turn - last_turn).norm() / args.turn_speed)
            * MINIMUM_JERK_PEAK;
        let duration = needed.max(MIN_DURATION);
        let moves = target.norm() + turn.norm() > 0.0;
        let on_support = moves && is_on_support(model, &[target, last_position]);
        if duration > MAX_DURATION {
            return Err(Failure::Usage(format!(
                "the step {step} would take {duration:.0} s, more than {MAX_DURATION} s: choose a higher --speed or --turn-speed"
            )));
        }
        steps.push(TimedStep {
            text: step.to_string(),
            command: Some(GraspCommand::Move { translation: target.into(), rotation: turn.into(), duration }),
            wait: Some(Duration::ZERO),
            on_support,
        });
    }
    if steps.is_empty() {
        let text = Step::Hold(None).to_string();
        steps.push(TimedStep { text, command: None, wait: None, on_support: false });
    }
    Ok(steps)
}

/// What is said of a friction that no probe has found.
const ASSUMED: &str = "the coefficient of friction is assumed; give `friction` in the file if it may be less";
/// What is said of a load that is too much.
const OVERLOADED: &str = "no contact forces within the limits hold the load";

/// A grasp in progress.
struct Course<'a> {
    options: &'a Options,
    motion: Motion<'a>,
    begun: Instant,
    /// The latest telemetry of the hand, and its tick.
    tick: u32,
    last: GraspTelemetry,
    /// When the hand first held the object, and for how long.
    held_since: Option<Instant>,
    held_for: Duration,
    /// Whether the friction is not given, and whether the load was at times more than the grip can hold.
    probes: bool,
    was_overloaded: bool,
    /// Whether all steps are carried out; a hold at their end goes on until Ctrl-C.
    is_complete: bool,
}

impl Course<'_> {
    /// Prints the current phase.
    fn report_phase(&self) {
        let seconds = self.begun.elapsed().as_secs_f32();
        output::notice(self.options, &format!("{seconds:6.2} s  the hand {}", self.last.phase));
    }

    /// Where Ctrl-C ends the wait for the answer, the command may or may not have been carried out.
    fn command(&mut self, command: GraspCommand) -> Result<End, Failure> {
        let before = self.last.phase;
        match self.motion.grasp(command) {
            Err(Failure::Interrupted(_)) => return Ok(End::Interrupted),
            report => (self.tick, self.last) = report?,
        }
        if self.last.phase != before {
            self.report_phase();
        }
        Ok(End::Done)
    }

    /// Sends keep-alive requests until `done`.
    fn follow(&mut self, mut done: impl FnMut(&GraspTelemetry, Instant) -> bool) -> Result<End, Failure> {
        let (options, begun) = (self.options, self.begun);
        let Self { motion, tick, last, held_since, held_for, probes, was_overloaded, .. } = self;
        motion.drive(
            PERIOD,
            |_| Request::Keep,
            |news, now| {
                // Telemetry sent before the last command may still arrive.
                if let Some(TaskReport { tick: told, telemetry: TaskTelemetry::Grasping(grasp) }) = &news.task
                    && told.wrapping_sub(*tick) < 1 << 31
                {
                    *tick = *told;
                    if grasp.phase != last.phase {
                        let seconds = (now - begun).as_secs_f32();
                        output::notice(options, &format!("{seconds:6.2} s  the hand {}", grasp.phase));
                        if last.phase == Phase::ProbeFriction && is_assumed(*probes, grasp) {
                            output::notice(options, &format!("{:11}no contact slid: {ASSUMED}", ""));
                        }
                    }
                    if grasp.overloaded && !std::mem::replace(was_overloaded, true) {
                        output::notice(options, &format!("{:11}overloaded: {OVERLOADED}", ""));
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

    /// Waits until the hand is ready or holds the object.
    fn wait_until_idle(&mut self) -> Result<End, Failure> {
        self.follow(|grasp, _| matches!(grasp.phase, Phase::Ready | Phase::Hold))
    }

    /// Grasps the object and carries out all steps.
    fn run(&mut self, file: &Path, steps: &[TimedStep]) -> Result<End, Failure> {
        if self.wait_until_idle()? == End::Interrupted {
            return Ok(End::Interrupted);
        }
        self.check(file)?;
        for (left, step) in (0..steps.len()).rev().zip(steps) {
            if step.on_support {
                let text = &step.text;
                output::notice(self.options, &format!("{text}: {}; `lift=0.01` first", words::ON_SUPPORT));
            }
            if let Some(command) = step.command {
                let end = self.command(command).map_err(|failure| of_step(&step.text, failure))?;
                if end == End::Interrupted || self.wait_until_idle()? == End::Interrupted {
                    return Ok(End::Interrupted);
                }
                self.check(file)?;
            }
            let until = step.wait.map(|wait| Instant::now() + wait);
            if until.is_none() {
                output::notice(self.options, "holding; Ctrl-C puts the object down");
                self.is_complete = left == 0;
            }
            if self.follow(|_, now| until.is_some_and(|until| now >= until))? == End::Interrupted {
                return Ok(End::Interrupted);
            }
        }
        self.is_complete = true;
        Ok(End::Done)
    }

    fn check(&self, file: &Path) -> Result<(), Failure> {
        self.last.failure.map_or(Ok(()), |failure| Err(Failure::Grasp(with_advice(&failure, file))))
    }

    /// Disables the board at once.
    fn let_go(self) -> Result<(), Failure> {
        self.motion.end(true)?;
        Err(Failure::Interrupted("an object that the hand still held falls".to_owned()))
    }

    /// Puts the object down and disables the board.
    fn end(mut self, file: &Path, result: Result<End, Failure>) -> Result<(), Failure> {
        let is_fatal = |failure: &Failure| {
            !matches!(
                failure,
                // Also when nobody reads the output any more, the object is put down.
                Failure::Grasp(_)
                    | Failure::Unread
                    | Failure::Stalled
                    | Failure::Refused(_)
                    | Failure::Board(BoardError::Refused { .. })
            )
        };
        let was_interrupted = match result {
            Err(Failure::Fault(fault)) => return Err(self.fault(&fault)),
            Err(failure) if is_fatal(&failure) => return Err(failure),
            Ok(End::Interrupted) => true,
            _ => false,
        };
        if was_interrupted {
            interrupted()?.store(false, Ordering::Relaxed);
            // Ctrl-C may have come before the answer to a command.
            match self.motion.read_grasp() {
                Ok(read) => (self.tick, self.last) = read,
                Err(Failure::Interrupted(_)) => return self.let_go(),
                Err(failure) => return Err(failure),
            }
            if !matches!(self.last.phase, Phase::Ready | Phase::Approach | Phase::Touch) {
                output::notice(
                    self.options,
                    "\nCtrl-C: putting the object down; Ctrl-C again disables at once, and the object falls",
                );
            }
        }
        match self.put_down(file) {
            Err(Failure::Fault(fault)) => return Err(self.fault(&fault)),
            Err(failure) if is_fatal(&failure) => return Err(failure),
            Ok(End::Interrupted) => return self.let_go(),
            Err(failure) => {
                self.motion.end(false)?;
                return Err(result.err().unwrap_or(failure));
            }
            Ok(End::Done) => {}
        }
        let (last, held_for, is_complete) = (self.last, self.held_for.as_secs_f32(), self.is_complete);
        self.motion.end(was_interrupted)?;
        result?;
        if !is_complete {
            return Err(Failure::Interrupted(
                "the steps were not completed; the board is disabled".to_owned(),
            ));
        }
        let is_assumed = is_assumed(self.probes, &last);
        let value = json!({
            "held_seconds": output::exact(&held_for),
            "friction": output::exact(&last.friction),
            "friction_assumed": is_assumed,
            "slips": last.slips,
            "overloaded": self.was_overloaded,
        });
        output::result(self.options, &value, || {
            format!(
                "done: held for {held_for:.1} s, coefficient of friction {:.2}{}, contacts slipped in {}",
                last.friction,
                if is_assumed { " (assumed)" } else { "" },
                output::counted(last.slips.into(), "tick"),
            )
        })?;
        if self.was_overloaded {
            return Err(Failure::Grasp(format!("the hand was overloaded: {OVERLOADED}")));
        }
        Ok(())
    }

    fn put_down(&mut self, file: &Path) -> Result<End, Failure> {
        match self.last.phase {
            Phase::Ready | Phase::Approach | Phase::Touch => return Ok(End::Done),
            Phase::Squeeze | Phase::ProbeFriction => {
                if self.command(GraspCommand::Open)? == End::Interrupted {
                    return Ok(End::Interrupted);
                }
            }
            Phase::Hold => {}
            Phase::Move | Phase::Lower | Phase::Open => {
                if self.wait_until_idle()? == End::Interrupted {
                    return Ok(End::Interrupted);
                }
            }
        }
        if self.last.phase == Phase::Hold && self.command(GraspCommand::PutDown)? == End::Interrupted {
            return Ok(End::Interrupted);
        }
        let end = self.wait_until_idle()?;
        if end == End::Interrupted || self.last.phase != Phase::Hold {
            return Ok(end);
        }
        // Nothing supports the object, or a finger is at its limit: the operator decides when to release it.
        output::notice(
            self.options,
            &self.last.failure.map_or_else(String::new, |failure| with_advice(&failure, file)),
        );
        output::notice(self.options, "holding; Ctrl-C releases the object");
        self.follow(|grasp, _| grasp.phase == Phase::Ready)?;
        interrupted()?.store(false, Ordering::Relaxed);
        let outcome = self.check(file);
        if self.command(GraspCommand::Open)? == End::Interrupted {
            return Ok(End::Interrupted);
        }
        let end = self.wait_until_idle()?;
        outcome.map(|()| end)
    }

    /// A fault, with its consequence for the object.
    fn fault(&self, fault: &str) -> Failure {
        if self.held_since.is_none() {
            return Failure::Fault(fault.to_owned());
        }
        Failure::Fault(format!(
            "{fault}\nThe object has fallen, or is still held if the model's reaction is `hold`: `tesaki disable` \
             releases it"
        ))
    }
}

/// A refusal of a step, which it names.
fn of_step(step: &str, failure: Failure) -> Failure {
    match failure {
        Failure::Board(BoardError::Refused { .. }) | Failure::Refused(_) => {
            Failure::Refused(format!("{step}: {failure}"))
        }
        other => other,
    }
}

/// Whether the hand has found no friction, and assumes one.
fn is_assumed(probes: bool, grasp: &GraspTelemetry) -> bool {
    probes && grasp.friction.to_bits() == ASSUMED_FRICTION.to_bits()
}

/// The failure with advice.
fn with_advice(failure: &GraspFailure, file: &Path) -> String {
    let file = file.display();
    let advice = match failure {
        GraspFailure::Obstructed { .. } => format!(
            "Is there an obstacle? The finger moves in a straight line to a position in front of its [[contact]] in \
             {file}: start with open fingers (`tesaki move`). If there is no obstacle, tare again (`tesaki tare`)"
        ),
        GraspFailure::NoObject { .. } => format!(
            "Is the object where [object] in {file} says? With a larger clearance there the fingers search farther"
        ),
        GraspFailure::NoGrip { .. } => format!(
            "Can the fingers exert this force? Compare force_limit and internal in {file} with the torque limits of the joints, \
             and check that the object is rigid"
        ),
        GraspFailure::NoSupport { .. } => "Put something under the object, or take it by hand".to_owned(),
        GraspFailure::OutOfReach { .. } => "Take smaller steps, or grasp the object elsewhere".to_owned(),
    };
    format!("{failure}. {advice}")
}

fn status(options: &Options) -> Result<(), Failure> {
    let mut session = BoardSession::open(options)?;
    let grasp = session.board.read_grasp()?;
    let mode = session.board.status()?.node.mode;
    // The board keeps the phase of the last grasp: at a fault, or when it was disabled.
    let ended = match mode {
        Mode::Enabled(TaskKind::Grasping) => None,
        Mode::Fault => {
            let model = session.model().ok();
            Some(format!("the grasp ended: the board is in fault: {}", session.fault(model.as_ref())))
        }
        mode => Some(format!("no grasp now: the board is {mode}")),
    };
    let mut value = output::exact(&grasp);
    value["mode"] = output::exact(&mode);
    output::result(options, &value, || {
        let mut text = match &ended {
            None => format!("the hand {}\n", grasp.phase),
            Some(ended) => format!("{ended}\nbefore that, the hand {}\n", grasp.phase),
        };
        if let Some(failure) = grasp.failure {
            let _ = writeln!(text, "{:<14} {failure}", "failure");
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
        for (finger, force) in (1..).zip(&grasp.target_forces) {
            let size = Vector3::from(*force).norm();
            line(&format!("finger {finger}"), format!("target {size:.2} N ({})", list(force, 2)));
        }
        line("friction", format!("{:.2}", grasp.friction));
        line("slips", output::counted(grasp.slips.into(), "tick"));
        if grasp.overloaded {
            line("overloaded", OVERLOADED.to_owned());
        }
        text
    })
}
