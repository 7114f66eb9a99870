//! A client of a served board, in simulated time: it enables the joint servo, moves, and after each fault
//! reads and clears the log and enables again. Requests are repeated until they are answered.

use tesaki::control::ServoMode;
use tesaki::model::RobotModel;
use tesaki::protocol::{Refusal, Reply, Request, RequestFrame, SCHEMA_KEY};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskConfig};
use tesaki_description::robot::RobotFolder;

use super::shared_rig::SharedRig;
use crate::controller::Controller;
use crate::plant::{Plant, PlantOptions};
use crate::scenario::ScenarioError;
use tesaki_supervisor::Board;

/// A request is repeated after this time without answer [ticks].
const PATIENCE: u32 = 4;
/// A goal is sent so often [ticks].
const COMMAND_EVERY: u32 = 2;
/// After a fault the client waits before it enables again [ticks].
const RECOVERY: u32 = 40;
/// Amplitude of the motion [rad], and its period [ticks].
const AMPLITUDE: f64 = 0.3;
const PERIOD: f64 = 300.0;

/// What the client does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Step {
    Hello,
    TakeCommand,
    Home,
    Enable,
    Move,
    ReadFaults,
    ClearFaults(u32),
    /// Until a tick.
    Wait(u32),
}

struct Client {
    step: Step,
    /// The request without answer, and when it was sent.
    open: Option<(RequestFrame, u32)>,
    start: Vec<f32>,
}

impl Client {
    fn request(&self, homed: &[f32]) -> Option<Request> {
        Some(match self.step {
            Step::Hello => Request::Hello { schema: SCHEMA_KEY },
            Step::TakeCommand => Request::TakeCommand { by_force: true },
            Step::Home => Request::Home { positions: homed.iter().copied().collect() },
            Step::Enable => Request::Enable(TaskConfig::JointServo(ServoMode::Observer)),
            Step::ReadFaults => Request::ReadFaults,
            Step::ClearFaults(total) => Request::ClearFaults { total },
            Step::Move | Step::Wait(_) => return None,
        })
    }

    fn goal(&self, tick: u32) -> Request {
        let angle = AMPLITUDE * (std::f64::consts::TAU * f64::from(tick) / PERIOD).sin();
        let positions = self.start.iter().map(|start| start + angle as f32).collect();
        Request::Task(TaskCommand::JointServo(JointCommand::Goal { positions }))
    }

    /// The step after a reply.
    fn answer(&mut self, reply: &Reply, tick: u32) {
        self.step = match (self.step, reply) {
            (_, Reply::Refused(Refusal::SchemaMismatch { .. })) => Step::Hello,
            (Step::Move, Reply::Refused(Refusal::NotCommander | Refusal::Commanded { .. })) => {
                Step::TakeCommand
            }
            (Step::Move, Reply::Refused(_)) => Step::ReadFaults,
            (Step::Move, _) => Step::Move,
            (Step::Hello, _) => Step::TakeCommand,
            (Step::TakeCommand, Reply::Done) => Step::Home,
            (Step::Home, _) => Step::Enable,
            (Step::Enable, Reply::Done) => Step::Move,
            (Step::ReadFaults, Reply::Faults(log)) => Step::ClearFaults(log.total),
            (Step::ClearFaults(_), Reply::Done) => Step::Wait(tick + RECOVERY),
            _ => Step::Wait(tick + RECOVERY / 2),
        };
    }

    fn tick(&mut self, rig: &SharedRig, tick: u32, homed: &[f32]) {
        let mut rig = rig.lock();
        if !rig.is_commanded() {
            return;
        }
        if let Some((frame, sent)) = self.open.take() {
            match rig.take_reply(frame.sequence) {
                Some(reply) => self.answer(&reply, tick),
                // A later goal makes up for a lost one.
                None if self.step == Step::Move => {}
                None if tick - sent < PATIENCE => self.open = Some((frame, sent)),
                None => {
                    rig.send(&frame);
                    self.open = Some((frame, tick));
                }
            }
        }
        if self.step == Step::Wait(tick) {
            self.step = Step::TakeCommand;
        }
        if self.open.is_some() {
            return;
        }
        let request = match self.step {
            Step::Move if tick.is_multiple_of(COMMAND_EVERY) => Some(self.goal(tick)),
            _ => self.request(homed),
        };
        if let Some(request) = request {
            if self.step == Step::Home {
                self.start = homed.to_vec();
            }
            let frame = rig.own(request);
            rig.send(&frame);
            self.open = Some((frame, tick));
        }
    }
}

/// Serves a board until the run is over.
pub fn run(rig: &SharedRig, robot: &RobotFolder, seed: u64) -> Result<(), ScenarioError> {
    let plant = Plant::of(robot, &PlantOptions::mismatched(seed))?;
    let mut plant = plant.under(Some(rig.intervention()));
    let mut board = rig.clone();
    introduce(&mut board, &robot.model)?;
    let mut client = Client { step: Step::Hello, open: None, start: Vec::new() };
    for tick in 0.. {
        let actuators = board.tick(&plant.sensors(tick + 1))?;
        plant.apply(&actuators)?;
        let homed: Vec<f32> = plant.homed_positions().iter().map(|&angle| angle as f32).collect();
        client.tick(rig, tick, &homed);
    }
    Ok(())
}

fn introduce(board: &mut SharedRig, model: &RobotModel) -> Result<(), ScenarioError> {
    board.hello()?;
    board.take_command(false)?;
    Ok(board.push_model(model)?)
}
