//! `identify`: torque constants and friction of a hand's joints.

mod joints;

use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serde_json::json;
use tesaki::model::RobotModel;
use tesaki::protocol::{FromBoard, Mode, Refusal, Reply, ReplyFrame, Request, Stream, Telemetry};
use tesaki::task::grasping::GraspTelemetry;
use tesaki_description::calibration::{Calibration, CalibrationFile};
use tesaki_description::{grasp, read_text};
use tesaki_supervisor::faults::FaultsBefore;
use tesaki_supervisor::identify::{
    Estimate, FailedGrip, Fit, Identification, Machine, Sense, Settings, board_in_head, identified, identify,
    update, with_head,
};
use tesaki_supervisor::{Board, BoardError};

use crate::args::{Identify, Options};
use crate::board_session::{BoardSession, hex, refused, require_homed};
use crate::failure::Failure;
use crate::grasp::suited;
use crate::motion::{LAST_WORD, gone};
use crate::output;

/// A set-point without telemetry in reply is sent again after this time, well below the command timeout.
const RETRY: Duration = Duration::from_millis(30);

pub fn run(options: &Options, args: &Identify) -> Result<(), Failure> {
    match &args.file {
        Some(file) => identify_hand(options, args, file),
        None => joints::run(options, args),
    }
}

fn identify_hand(options: &Options, args: &Identify, grasp: &Path) -> Result<(), Failure> {
    let plan = grasp::load(grasp)?;
    check_grips(args, grasp, plan.force_limit)?;
    let mut session = BoardSession::command(options)?;
    let model = session.model()?;
    let plan = suited(plan, grasp, &model)?;
    let node = session.board.status()?.node;
    session.require_no_fault(node.mode, Some(&model))?;
    require_homed(node.homed, &model)?;
    let tips = session.tips()?.tips;
    let mut sensors = model.chains.iter().zip(&tips).filter(|(chain, _)| chain.force_sensor.is_some());
    if let Some((chain, _)) = sensors.find(|(_, tip)| !tip.tared) {
        return Err(Failure::Refused(format!(
            "the force sensor of {} was not tared since the model was pushed or the joints were homed: `tesaki tare` \
             while nothing touches the tips",
            chain.name
        )));
    }
    let board = hex(&session.identity.board, "without a number");
    let mut file = open(&args.out, &model, &board)?;
    output::confirm(
        options,
        &format!(
            "Every joint of {} will be swept by ±{} rad; then the object described in {} will be grasped and moved. \
             Is the workspace clear?",
            model.name,
            args.amplitude,
            grasp.display()
        ),
    )?;
    let settings = Settings { amplitude: args.amplitude, strengths: args.grips.clone() };
    let mut machine = BoardMachine::new(session, options, &model, FaultsBefore::from(&node))?;
    let found = identify(&mut machine, &model, &plan, &settings);
    let disabled = if found.is_err() { machine.end() } else { Ok(()) };
    output::set_controls(false);
    let found = found.map_err(|failure| failure.named(&model));
    let Identification { fits, failed } = ended(found, disabled)?;
    let calibration = identified(&model, &fits);
    update(&mut file, &calibration, &model, &fits);
    let text = with_head(&file.to_string(), &model.name, &board);
    output::save(&args.out, &text, |out| {
        output::result(options, &report(&model, &fits, &failed, out), || table(&model, &fits, &failed, out))
    })
}

/// The calibration file of this robot, which can be written: checked before the measurements are at stake.
fn open(path: &Path, model: &RobotModel, board: &str) -> Result<CalibrationFile, Failure> {
    let file = CalibrationFile::open(path)?;
    if path.exists() {
        let own = Calibration::load(path)?.check_joints(model);
        own.map_err(|error| {
            Failure::Usage(format!(
                "{}: {error}; it is the calibration of another robot: choose another file with --out FILE",
                path.display()
            ))
        })?;
        let text = read_text(path).map_err(Failure::file(path))?;
        if let Some(other) = board_in_head(&text, &model.name).filter(|other| *other != board) {
            return Err(Failure::Usage(format!(
                "{} is the calibration of board {other}, and this is board {board}: choose another file with \
                 --out FILE",
                path.display()
            )));
        }
    }
    output::require_writable(path)?;
    Ok(file)
}

fn check_grips(args: &Identify, file: &Path, force_limit: f32) -> Result<(), Failure> {
    let different = args.grips.iter().skip(1).any(|&grip| (grip - args.grips[0]).abs() > 0.0);
    if !different || !args.grips.iter().all(|&grip| grip > 0.0 && grip <= force_limit) {
        return Err(Failure::Usage(format!(
            "--grips: give at least two different forces above 0 N and at most {} N (force_limit in {})",
            force_limit,
            file.display()
        )));
    }
    Ok(())
}

/// The results as JSON: `null` where nothing was identified, with the reason.
fn report(model: &RobotModel, fits: &[Fit], failed: &[FailedGrip], out: Option<&Path>) -> serde_json::Value {
    let number = |estimate: Estimate, scale: f64| json!({ "value": estimate.value * scale, "deviation": estimate.deviation * scale });
    let joints: serde_json::Map<String, serde_json::Value> = model
        .joints
        .iter()
        .zip(fits)
        .map(|(joint, fit)| {
            let scale = joint.motor.torque_constant.into();
            let why = fit.doubts().next();
            let value = json!({
                "torque_constant": fit.gain.ok().map(|gain| number(gain, scale)),
                "coulomb": fit.coulomb().ok().map(|coulomb| number(coulomb, 1.0)),
                "viscous": fit.viscous().ok().map(|viscous| number(viscous, 1.0)),
                "load_range": fit.load_range,
                "residual": fit.residual,
                "readings": fit.readings,
                "not_identified": why.map(|(what, why)| format!("{what}: {why}")),
            });
            (joint.name.to_string(), value)
        })
        .collect();
    let failed: Vec<_> = failed
        .iter()
        .map(|grip| json!({ "strength": output::exact(&grip.strength), "why": grip.failure.to_string() }))
        .collect();
    json!({ "file": out.map(|out| out.display().to_string()), "joints": joints, "failed_grips": failed })
}

fn table(model: &RobotModel, fits: &[Fit], failed: &[FailedGrip], out: Option<&Path>) -> String {
    let mut text = format!(
        "{:<18} {:>19} {:>17} {:>19} {:>12}\n",
        "joint", "constant [N·m/A]", "coulomb [mN·m]", "viscous [mN·m·s]", "load [N·m]"
    );
    let mut notes = String::new();
    for (joint, fit) in model.joints.iter().zip(fits) {
        let constant = f64::from(joint.motor.torque_constant);
        let gain = fit.gain.map_or_else(
            |_| "-".to_owned(),
            |gain| format!("{:.4} ± {:.4}", gain.value * constant, gain.deviation * constant),
        );
        let friction = |index: usize| {
            fit.friction.map_or_else(
                |_| "-".to_owned(),
                |friction| {
                    format!("{:.2} ± {:.2}", 1e3 * friction[index].value, 1e3 * friction[index].deviation)
                },
            )
        };
        let _ = writeln!(
            text,
            "{:<18} {gain:>19} {:>17} {:>19} {:>12.3}",
            joint.name.as_str(),
            friction(0),
            friction(1),
            fit.load_range
        );
        for (what, doubt) in fit.doubts() {
            let _ = writeln!(notes, "{}: {what} not identified: {doubt}", joint.name);
        }
    }
    text.push_str(&notes);
    for grip in failed {
        let _ = writeln!(text, "{grip}; the other grips were sufficient");
    }
    text + &saved(out)
}

/// Where the results are.
fn saved(out: Option<&Path>) -> String {
    out.map_or_else(
        || "not saved to a file".to_owned(),
        |out| {
            let out = out.display();
            format!("saved to {out}; use it with `tesaki model push ROBOT --calibration {out}`")
        },
    )
}

/// How an identification has ended, and whether the board could be disabled then.
fn ended<T>(found: Result<T, Failure>, disabled: Result<(), Failure>) -> Result<T, Failure> {
    match (found, disabled) {
        // After Ctrl-C it matters most whether the board is disabled.
        (Err(Failure::Interrupted(_)), Err(on)) => Err(on),
        // A board that was reset is off.
        (found, Err(Failure::Board(BoardError::Reset))) => found,
        (Err(failure), Err(on)) => Err(Failure::StillOn(Box::new(failure), Box::new(on))),
        (found, disabled) => found.and_then(|found| disabled.map(|()| found)),
    }
}

/// Why the board did not do what it was asked.
fn broken_off(error: BoardError) -> Failure {
    match error {
        BoardError::Interrupted => {
            Failure::Interrupted("the board is disabled; nothing was identified".to_owned())
        }
        error => error.into(),
    }
}

/// A connected board.
struct BoardMachine<'a> {
    session: BoardSession,
    options: &'a Options,
    model: &'a RobotModel,
    /// Faults of the board before.
    faults: FaultsBefore,
    interrupted: Arc<AtomicBool>,
    /// Whether telemetry of the enabled board has come: older telemetry may still arrive.
    seen_enabled: bool,
    /// Whether another program has disabled the board.
    is_lost: bool,
    /// Whether the board reacts to a fault as its model says, also to silence.
    reacts: bool,
    /// Telemetry whose tips have not come yet.
    telemetry: Option<Telemetry>,
}

impl<'a> BoardMachine<'a> {
    /// With the telemetry that an identification needs, and Ctrl-C handled from here on.
    fn new(
        mut session: BoardSession,
        options: &'a Options,
        model: &'a RobotModel,
        faults: FaultsBefore,
    ) -> Result<Self, Failure> {
        output::set_controls(true);
        let rates = [(Stream::Telemetry, 1), (Stream::Tips, 1)];
        rates.iter().try_for_each(|&(stream, every)| session.board.set_rate(stream, every))?;
        let interrupted = session.heed_interrupts()?;
        Ok(Self {
            session,
            options,
            model,
            faults,
            interrupted,
            seen_enabled: false,
            is_lost: false,
            reacts: false,
            telemetry: None,
        })
    }

    /// Another program has disabled the board.
    fn lost(&mut self) -> Failure {
        self.is_lost = true;
        Failure::Other("another program disabled the board: nothing was identified".to_owned())
    }

    /// Disables the board, if it is still this program's: what another one has enabled since is its own. One
    /// that reacts to a fault is left to it: disabled, a robot that it holds would fall.
    fn end(mut self) -> Result<(), Failure> {
        output::set_controls(false);
        if self.is_lost || self.reacts {
            return Ok(());
        }
        let begun = Instant::now();
        self.session.ignore_interrupts();
        self.session.board.set_timeout(self.options.timeout.min(LAST_WORD));
        self.session.board.disable().map_err(|error| match error {
            BoardError::Timeout { .. } => gone(begun.elapsed().as_secs_f64(), self.model),
            error => error.into(),
        })
    }
}

impl Machine for BoardMachine<'_> {
    type Error = Failure;

    fn ask(&mut self, action: &'static str, request: Request) -> Result<(), Failure> {
        if matches!(request, Request::Enable(_)) {
            self.seen_enabled = false;
        }
        self.session.board.ask(action, request).map_err(broken_off)
    }

    fn read_grasp(&mut self) -> Result<GraspTelemetry, Failure> {
        self.session.board.read_grasp().map_err(broken_off)
    }

    fn tick(&mut self, request: Request) -> Result<Sense, Failure> {
        let begun = Instant::now();
        while begun.elapsed() < self.options.timeout {
            if self.interrupted.load(Ordering::Relaxed) {
                return Err(broken_off(BoardError::Interrupted));
            }
            self.session.board.post(request.clone())?;
            let deadline = Instant::now() + RETRY;
            while let Some(event) = self.session.board.next_event(deadline)? {
                match event {
                    FromBoard::Telemetry(telemetry) => {
                        if telemetry.mode == Mode::Fault {
                            self.reacts = true;
                            self.session.ignore_interrupts();
                            let cause = self.session.fault_after(self.faults, Some(self.model));
                            return Err(Failure::Fault(cause));
                        }
                        if self.seen_enabled && telemetry.mode == Mode::Disabled {
                            return Err(self.lost());
                        }
                        self.seen_enabled |= matches!(telemetry.mode, Mode::Enabled(_));
                        self.telemetry = self.seen_enabled.then_some(telemetry);
                    }
                    FromBoard::Tips(tips) => {
                        if let Some(telemetry) =
                            self.telemetry.take_if(|telemetry| telemetry.tick == tips.tick)
                        {
                            return Ok(Sense { telemetry, tips });
                        }
                    }
                    // It can be another's only after it was disabled.
                    FromBoard::Reply(ReplyFrame {
                        reply:
                            Reply::Refused(
                                Refusal::NotCommander
                                | Refusal::Commanded { .. }
                                | Refusal::WrongMode(Mode::Disabled),
                            ),
                        ..
                    }) => return Err(self.lost()),
                    FromBoard::Reply(ReplyFrame { reply, .. }) => refused(&reply)?,
                    _ => {}
                }
            }
        }
        self.reacts = true;
        self.session.give_up();
        Err(Failure::Late(format!(
            "no data from the board for {} s: its command timeout has stopped it. Check cable and power (`tesaki doctor`)",
            self.options.timeout.as_secs_f64()
        )))
    }

    fn progress(&mut self, text: &str) {
        output::notice(self.options, text);
    }
}
