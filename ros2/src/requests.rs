//! Requests of clients: services, and goals of the action.

use std::time::{Duration, Instant};

use tesaki::control::ServoMode;
use tesaki::protocol::{Mode, Refusal, Request};
use tesaki::robot::Robot;
use tesaki::task::TaskConfig;
use tesaki_recording::LogLevel;
use tesaki_supervisor::faults::{self, FaultsBefore};
use tesaki_supervisor::gravity::Load;
use tesaki_supervisor::timing::FRESH;
use tesaki_supervisor::{Board as _, BoardError, LEASE_EXPIRES, angles};

use crate::action::Wish;
use crate::args::Options;
use crate::controller::{Controller, Outcome};
use crate::dds::{Dds, DdsError};
use crate::messages::{
    ErrorCode, Feedback, Goal, Header, Status, Time, TriggerRequest, TriggerResponse, Uuid,
    nanoseconds_since_1970,
};
use crate::node::{Enabled, Node};
use crate::service::{Caller, Service};
use crate::session::{Failure, describe, words};
use crate::trajectory::{Refused, named};

/// Period of the feedback on a goal, as that of joint_trajectory_controller.
const FEEDBACK: Duration = Duration::from_millis(50);

/// How soon command is requested again.
const RETRY: Duration = Duration::from_millis(50);
/// How soon it is told again that the board refuses points without a goal.
const AGAIN: Duration = Duration::from_secs(1);

/// What is answered to a request that may be older than a request to disable the board.
const OVERRULED: &str =
    "the board was asked to disable at the same time, so this was not carried out: ask again";

/// The services, by what they do.
#[derive(Clone, Copy)]
enum Asked {
    Disable,
    Enable,
    Tare,
    ClearFaults,
}

/// The services, all of them `std_srvs/Trigger`.
pub struct Services {
    enable: Service,
    disable: Service,
    tare: Service,
    clear_faults: Service,
    /// A request to disable the board that has been received, but is not yet carried out.
    disabling: Option<Caller>,
}

impl Services {
    /// Offers the services.
    pub fn offer(dds: &Dds, options: &Options) -> Result<Self, DdsError> {
        let offer = |name: &str| {
            Service::offer(dds, &options.full_name(&format!("tesaki/{name}")), "std_srvs/srv/Trigger")
        };
        Ok(Self {
            enable: offer("enable")?,
            disable: offer("disable")?,
            tare: offer("tare")?,
            clear_faults: offer("clear_faults")?,
            disabling: None,
        })
    }

    /// Returns the services in the order in which their requests are carried out.
    fn all(&mut self) -> [(Asked, &mut Service); 4] {
        [
            (Asked::Disable, &mut self.disable),
            (Asked::Enable, &mut self.enable),
            (Asked::Tare, &mut self.tare),
            (Asked::ClearFaults, &mut self.clear_faults),
        ]
    }

    /// Returns the next request, with the service that answers it. Disabling comes first.
    fn take(&mut self) -> Option<(Asked, Caller)> {
        if let Some(caller) = self.disabling.take() {
            return Some((Asked::Disable, caller));
        }
        self.all().into_iter().find_map(|(asked, service)| {
            let (caller, _) = service.take::<TriggerRequest>()?;
            Some((asked, caller))
        })
    }

    /// Returns whether a request to disable the board waits.
    fn is_disabling(&mut self) -> bool {
        if self.disabling.is_none() {
            self.disabling = self.disable.take::<TriggerRequest>().map(|(caller, _)| caller);
        }
        self.disabling.is_some()
    }

    fn of(&mut self, asked: Asked) -> &mut Service {
        match asked {
            Asked::Disable => &mut self.disable,
            Asked::Enable => &mut self.enable,
            Asked::Tare => &mut self.tare,
            Asked::ClearFaults => &mut self.clear_faults,
        }
    }

    /// Returns whether every answer has been sent.
    pub fn are_idle(&mut self) -> bool {
        self.all().into_iter().all(|(_, service)| service.is_idle())
    }
}

/// Why a service failed.
enum Undone {
    /// It was not carried out, for this reason.
    Refused(String),
    /// The node ends.
    Ended(Failure),
}

impl From<String> for Undone {
    fn from(reason: String) -> Self {
        Self::Refused(reason)
    }
}

impl From<Failure> for Undone {
    fn from(failure: Failure) -> Self {
        Self::Ended(failure)
    }
}

/// What a service did, or why it failed.
type Answer = Result<String, Undone>;

impl Node<'_> {
    /// Answers the services and carries out the requests of the action.
    pub fn serve(&mut self) -> Result<(), Failure> {
        let mut is_disabled = false;
        while let Some((asked, caller)) = self.services.take() {
            let answer = match asked {
                Asked::Disable => {
                    is_disabled = true;
                    self.stop()
                }
                // Which of the two came first is not known: they are on different topics.
                Asked::Enable if is_disabled => Err(OVERRULED.to_owned().into()),
                Asked::Enable => self.enable(),
                Asked::Tare => self.tare(),
                Asked::ClearFaults => self.clear_faults(),
            };
            let (level, message) = match &answer {
                Ok(text) => (LogLevel::Info, text.clone()),
                Err(Undone::Refused(reason)) => (LogLevel::Warn, reason.clone()),
                Err(Undone::Ended(failure)) => (LogLevel::Error, failure.to_string()),
            };
            let service = self.services.of(asked);
            let text = format!("{}: {message}", service.name());
            service.reply(caller, &TriggerResponse { success: answer.is_ok(), message });
            self.note(level, &text)?;
            if let Err(Undone::Ended(failure)) = answer {
                return Err(failure);
            }
        }
        if is_disabled && self.action.refuse_waiting() {
            self.note(LogLevel::Warn, &format!("a goal is refused: {OVERRULED}"))?;
        }
        // One at a time: checking a goal takes a while, in which nothing is received from the board.
        if let Some(wish) = self.action.take() {
            match wish {
                Wish::Cancel(ids) => ids.iter().try_for_each(|id| self.cancel(id))?,
                Wish::Goal(caller, id, goal) => match self.begin(&id, &goal) {
                    Ok(()) => self.action.accept(caller, id),
                    Err(refused) => {
                        self.action.refuse(caller);
                        self.note(LogLevel::Error, &format!("a goal is refused: {refused}"))?;
                    }
                },
            }
        }
        self.feed_back();
        Ok(())
    }

    /// Refuses new goals at the end.
    pub fn refuse_goals(&mut self) {
        if let Some(Wish::Goal(caller, ..)) = self.action.take() {
            self.action.refuse(caller);
        }
    }

    fn enable(&mut self) -> Answer {
        if self.enabled.is_some() {
            return Ok("enabled already".to_owned());
        }
        self.hold_here()?;
        self.take_command()?;
        // The joints may have moved while it waited for command.
        let held = self.hold_here().and_then(|held| {
            let enabled = self.session.board.enable(TaskConfig::JointServo(ServoMode::Observer));
            if let Err(error) = &enabled
                // A board whose answer was lost may be enabled.
                && !matches!(error, BoardError::Refused { .. } | BoardError::Reset)
            {
                let _ = self.session.board.post(Request::Disable);
            }
            enabled.map_err(|error| self.words(&error)).map(|()| held)
        });
        let (controller, faults, load) = held.inspect_err(|_| self.session.release_command())?;
        self.enabled = Some(Enabled::new(controller, faults));
        let falls = load.map_or_else(String::new, |load| format!("; {load}"));
        Ok(format!("enabled: the joints hold{falls}"))
    }

    /// Returns what holds the joints where they are, the faults so far, and what gravity does.
    fn hold_here(&mut self) -> Result<(Controller, FaultsBefore, Option<Load>), String> {
        let Some((model, _)) = &self.model else {
            return Err("the board has no model: push one with `tesaki model push ROBOT_FOLDER`".to_owned());
        };
        // With old angles, the joints would move to them.
        let telemetry = self.telemetry.as_ref().filter(|_| self.heard.elapsed() < FRESH);
        let Some(telemetry) = telemetry else {
            return Err("no telemetry from the board: where the joints are is not known".to_owned());
        };
        if telemetry.mode == Mode::Fault {
            let text = self.fault_text(None);
            let service = self.options.full_name("tesaki/clear_faults");
            return Err(format!("the board is in fault: {text}. Call {service} first"));
        }
        let mut robot = Box::new(Robot::NONE);
        robot.configure(model).map_err(|error| error.to_string())?;
        let positions = angles::measured(telemetry);
        let load = Load::at(model, &positions);
        Ok((Controller::hold(robot, &positions), telemetry.into(), load))
    }

    /// Takes command, also from a program that has gone, whose lease expires within a second. It publishes
    /// what the board sends meanwhile, and gives up when the board is to be disabled.
    fn take_command(&mut self) -> Result<(), Undone> {
        let deadline = Instant::now() + LEASE_EXPIRES;
        loop {
            match self.session.take_command() {
                Err(BoardError::Refused { refusal: Refusal::Commanded { .. }, .. })
                    if Instant::now() < deadline => {}
                other => return other.map_err(|error| self.words(&error).into()),
            }
            let pause = Instant::now() + RETRY;
            while Instant::now() < pause {
                self.listen()?;
                self.check_dds()?;
                self.send()?;
                if self.services.is_disabling() {
                    return Err(OVERRULED.to_owned().into());
                }
            }
        }
    }

    /// Runs the service `disable`, which works even if another program has command.
    fn stop(&mut self) -> Answer {
        self.disable("the board was disabled").map_err(|error| self.words(&error).into())
    }

    /// Describes an error of the board.
    fn words(&self, error: &BoardError) -> String {
        words(error, self.model.as_ref().map(|(model, _)| model), self.options)
    }

    /// Returns what gravity does to the robot now that its outputs are off, after a semicolon; empty if
    /// nothing.
    fn falls(&self) -> String {
        let known = self.model.as_ref().zip(self.telemetry.as_ref());
        let load = known.and_then(|((model, _), telemetry)| Load::measured(model, telemetry));
        load.map_or_else(String::new, |load| format!("; {load}"))
    }

    /// Disables the board and ends the goal, for the reason `why`.
    pub fn disable(&mut self, why: &str) -> Result<String, BoardError> {
        if let Some(enabled) = &mut self.enabled {
            enabled.asked_to_disable = true;
        }
        self.session.board.disable()?;
        if let Some(Enabled { goal: Some(goal), .. }) = self.enabled.take() {
            self.action.end(&goal, Status::Aborted, ErrorCode::InvalidGoal, why);
        }
        self.session.release_command();
        Ok(format!("disabled{}", self.falls()))
    }

    fn tare(&mut self) -> Answer {
        self.command(|node| node.session.board.tare())?;
        Ok("force sensors zeroed".to_owned())
    }

    fn clear_faults(&mut self) -> Answer {
        if self.enabled.is_some() {
            return Err("the board is enabled: disable it first".to_owned().into());
        }
        self.command(|node| {
            // It may have changed while the node waited for command.
            let is_fault = node.session.board.status()?.node.mode == Mode::Fault;
            let falls = node.falls();
            let log = node.session.board.faults()?;
            node.session.board.ask("clear the faults", Request::ClearFaults { total: log.total })?;
            if !is_fault {
                return Ok("no fault to clear".to_owned());
            }
            let model = node.model.as_ref().map(|(model, _)| model);
            Ok(format!("cleared: {}{falls}", describe(faults::blamed(&log), model)))
        })
    }

    /// Runs an operation that needs command of the board, which is then released unless the board is enabled.
    fn command<T>(&mut self, run: impl FnOnce(&mut Self) -> Result<T, BoardError>) -> Result<T, Undone> {
        self.take_command()?;
        let result = run(self);
        if self.enabled.is_none() {
            self.session.release_command();
        }
        result.map_err(|error| self.words(&error).into())
    }

    /// Begins a goal, in place of the present one.
    fn begin(&mut self, id: &Uuid, goal: &Goal) -> Result<(), Refused> {
        let invalid = |text: String| Err(Refused::new(ErrorCode::InvalidGoal, text));
        if self.action.knows(id) {
            return invalid("there is a goal with this ID".to_owned());
        }
        let defaults = self.options.defaults();
        let Some(enabled) = &mut self.enabled else {
            let is_fault = self.telemetry.as_ref().is_some_and(|telemetry| telemetry.mode == Mode::Fault);
            return if is_fault {
                let text = self.fault_text(None);
                invalid(format!("the board is in fault: {text}"))
            } else {
                let service = self.options.full_name("tesaki/enable");
                invalid(format!("the board is not enabled by this node: call {service} first"))
            };
        };
        enabled.controller.follow(goal, nanoseconds_since_1970(), &defaults)?;
        if let Some(before) = enabled.goal.replace(*id) {
            let text = "another goal came in its place";
            self.action.end(&before, Status::Canceled, ErrorCode::InvalidGoal, text);
        }
        Ok(())
    }

    fn cancel(&mut self, id: &Uuid) -> Result<(), Failure> {
        match &mut self.enabled {
            Some(enabled) if enabled.goal == Some(*id) => {
                enabled.controller.cancel();
                self.note(LogLevel::Info, "the goal is cancelled: the joints come to rest")
            }
            _ => Ok(()),
        }
    }

    /// Ends the goal with its outcome.
    pub fn end_goal(&mut self, outcome: &Outcome) -> Result<(), Failure> {
        let Some(goal) = self.enabled.as_mut().and_then(|enabled| enabled.goal.take()) else { return Ok(()) };
        let (status, code, text) = match outcome {
            Outcome::Succeeded => (Status::Succeeded, ErrorCode::Successful, "all joints have arrived"),
            Outcome::Canceled => {
                (Status::Canceled, ErrorCode::Successful, "cancelled: the joints are at rest")
            }
            Outcome::Failed(refused) => (Status::Aborted, refused.code, refused.reason.as_str()),
        };
        self.action.end(&goal, status, code, text);
        let level = if status == Status::Aborted { LogLevel::Error } else { LogLevel::Info };
        self.note(level, &format!("a goal has ended: {text}"))
    }

    /// Notes that the board is no longer enabled, or that nothing may be sent to it.
    pub fn forget_enabled(&mut self, why: &str) -> Result<(), Failure> {
        let Some(enabled) = self.enabled.take() else { return Ok(()) };
        if let Some(goal) = enabled.goal {
            self.action.end(&goal, Status::Aborted, ErrorCode::InvalidGoal, why);
        }
        self.session.release_command();
        self.note(LogLevel::Error, why)
    }

    /// Handles a refused point: the joints hold where the board has them, and the goal fails.
    pub fn hold_after(&mut self, refusal: &Refusal) -> Result<(), Failure> {
        let (Some(enabled), Some(telemetry)) = (&mut self.enabled, &self.telemetry) else { return Ok(()) };
        let text = match refusal {
            Refusal::Task(tesaki::task::TaskRefusal::JointServo(
                tesaki::task::joint_servo::JointServoRefusal::Limit(limit),
            ))
            | Refusal::Limit(limit) => named(limit, enabled.controller.robot()),
            other => other.to_string(),
        };
        let references: Vec<f32> = telemetry.joints.iter().map(|joint| joint.reference).collect();
        enabled.controller.hold_at(&references);
        let text = format!("the board refused a point of the trajectory: {text}");
        if enabled.goal.is_some() {
            return self.end_goal(&Outcome::Failed(Refused::new(ErrorCode::InvalidGoal, text)));
        }
        if enabled.complained.is_some_and(|complained| complained.elapsed() < AGAIN) {
            return Ok(());
        }
        enabled.complained = Some(Instant::now());
        self.note(LogLevel::Error, &text)
    }

    /// Sends feedback on the goal from time to time.
    fn feed_back(&mut self) {
        let (Some(enabled), Some(telemetry)) = (&mut self.enabled, &self.telemetry) else { return };
        let Some(goal_id) = enabled.goal.filter(|_| enabled.told.elapsed() >= FEEDBACK) else { return };
        let Some((joint_names, [desired, actual, error])) = enabled.controller.feedback(&telemetry.joints)
        else {
            return;
        };
        enabled.told = Instant::now();
        let header = Header { stamp: Time::now(), frame_id: String::new() };
        self.action.feed_back(&Feedback {
            goal_id,
            header,
            joint_names,
            desired,
            actual,
            error,
            ..Feedback::default()
        });
    }
}
