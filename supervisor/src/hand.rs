//! A hand with one board per finger: grasp control ([`GraspState`]) runs on the PC.
//!
//! Each board controls the three joints of its finger ([`chain_model`]) and reads its fingertip's force
//! sensor. In each tick [`MultiBoardHand::step`] reads the measurements of all fingers and sends each board
//! joint set-points and feedforward torques ([`JointCommand::StreamTorques`]), which take effect one tick
//! later than on a single board.
//!
//! When a board is in fault, disabled or silent, the others are stopped at once and no more set-points are
//! sent: within the command timeout all three boards are in their model's reaction.

mod board;
mod contact;
mod error;
mod model;

use std::time::{Duration, Instant};

use tesaki::control::ServoMode;
use tesaki::kinematics::Posture;
use tesaki::model::RobotModel;
use tesaki::protocol::{Mode, Request, Stream, Telemetry, Tips};
use tesaki::task::grasping::{
    FINGERS, FingerSense, GraspCommand, GraspPlan, GraspState, GraspTelemetry, HandOutput, ObjectControl,
    PerFinger,
};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskConfig};
use tesaki_description::robot::chain_model;

pub use board::{FingerBoard, News};
pub use contact::angles_at;
pub use error::HandError;
pub use model::HandModel;

use crate::faults::FaultsBefore;
use crate::{BoardError, troubleshooting};

/// Steps without new data of a board after which its data are stale: this many telemetries may be lost in
/// succession.
pub const MAX_AGE: u32 = 3;
/// Maximum wait for the first telemetry of a board.
const FIRST_TELEMETRY_TIMEOUT: Duration = Duration::from_millis(300);

/// A board and the latest data of its finger.
struct FingerState<B> {
    name: String,
    board: B,
    model: RobotModel,
    /// The latest telemetry and tips, possibly of different ticks.
    telemetry: Option<Telemetry>,
    tips: Option<Tips>,
    /// The last tick with both telemetry and tips.
    tick: Option<u32>,
    measured: FingerMeasurement,
    tared: bool,
    /// Steps since that tick.
    age: u32,
    /// Its faults before it was enabled.
    before: FaultsBefore,
}

/// Measurements of a finger.
#[derive(Clone, Copy, Debug, Default)]
struct FingerMeasurement {
    /// Joint angles [rad].
    angles: [f32; 3],
    /// Force of the tip on the object, in base axes [N].
    force: [f32; 3],
}

/// Three boards with one finger each that hold an object together.
pub struct MultiBoardHand<B> {
    fingers: PerFinger<FingerState<B>>,
    model: HandModel,
    state: GraspState,
    steps: u32,
    enabled: bool,
}

impl<B: FingerBoard> MultiBoardHand<B> {
    /// Creates a hand of `robot`, whose chains are on these boards, in their order.
    ///
    /// # Errors
    /// The robot is not a hand of three fingers with force sensors.
    pub fn new(robot: &RobotModel, boards: PerFinger<B>) -> Result<Self, HandError> {
        let model = HandModel::try_new(robot)?;
        let mut index = 0;
        let fingers = boards.map(|board| {
            // `HandModel::try_new` has checked that there are three chains.
            let model = chain_model(robot, index).unwrap_or_else(|| robot.clone());
            index += 1;
            let name = model.chains.first().map_or_else(String::new, |chain| chain.name.to_string());
            FingerState {
                name,
                board,
                model,
                telemetry: None,
                tips: None,
                tick: None,
                measured: FingerMeasurement::default(),
                tared: false,
                age: 0,
                before: FaultsBefore::default(),
            }
        });
        Ok(Self { fingers, model, state: GraspState::NONE, steps: 0, enabled: false })
    }

    /// The boards, in the order of the fingers.
    pub fn boards(&self) -> PerFinger<&B> {
        self.fingers.each_ref().map(|finger| &finger.board)
    }

    /// The boards for direct requests, in the order of the fingers.
    pub fn boards_mut(&mut self) -> PerFinger<&mut B> {
        self.fingers.each_mut().map(|finger| &mut finger.board)
    }

    /// Telemetry as of the last step.
    pub fn telemetry(&self) -> GraspTelemetry {
        self.state.telemetry()
    }

    /// Whether the boards are enabled, as of the last step.
    pub const fn is_enabled(&self) -> bool {
        self.enabled
    }

    /// Greets the boards, takes command, and pushes each the model of its finger.
    ///
    /// # Errors
    /// The first board that fails, and why.
    pub fn set_up(&mut self) -> Result<(), HandError> {
        self.each(|finger| {
            finger.board.hello()?;
            finger.board.take_command(false)?;
            finger.board.push_model(&finger.model)?;
            finger.board.set_rate(Stream::Telemetry, 1)?;
            finger.board.set_rate(Stream::Tips, 1)
        })
    }

    /// Sets the current angles of the nine joints [rad].
    ///
    /// # Errors
    /// The first board that refuses, and why.
    pub fn home(&mut self, positions: &PerFinger<[f32; 3]>) -> Result<(), HandError> {
        let mut positions = positions.iter();
        self.each(|finger| finger.board.home(positions.next().map_or(&[], |angles| angles)))
    }

    /// Zeroes the force sensors; nothing may touch the tips.
    ///
    /// # Errors
    /// The first board that refuses, and why.
    pub fn tare(&mut self) -> Result<(), HandError> {
        self.each(|finger| finger.board.tare())
    }

    /// Enables all boards or none. The first [step](Self::step) must follow within the command timeout.
    ///
    /// # Errors
    /// The first board that refuses, is silent or was not tared.
    pub fn enable(&mut self, servo: ServoMode) -> Result<(), HandError> {
        let deadline = Instant::now() + FIRST_TELEMETRY_TIMEOUT;
        for finger in &mut self.fingers {
            (finger.tick, finger.age) = (None, 0);
            while finger.tick.is_none() {
                finger.listen()?;
                if finger.tick.is_none() && Instant::now() >= deadline {
                    return Err(HandError::Stale { board: finger.name.clone(), steps: 0 });
                }
            }
            if !finger.tared {
                return Err(HandError::NotTared { board: finger.name.clone() });
            }
            finger.before = finger.telemetry.as_ref().map_or(finger.before, FaultsBefore::from);
        }
        let enabled = self.each(|finger| finger.board.enable(TaskConfig::JointServo(servo)));
        // Telemetry that was sent before the boards were enabled may still arrive.
        let enabled = enabled.and_then(|()| {
            self.each(|finger| {
                (finger.telemetry, finger.tips) = (None, None);
                finger.board.listen().map(|_| ())
            })
        });
        if let Err(error) = enabled {
            self.disable();
            return Err(error);
        }
        self.state = GraspState::at(self.fingers.each_ref().map(|finger| finger.measured.angles));
        self.enabled = true;
        Ok(())
    }

    /// Carries out a grasp command.
    ///
    /// # Errors
    /// The command is refused; nothing has changed then.
    pub fn command(&mut self, command: &GraspCommand) -> Result<(), HandError> {
        if !self.enabled {
            return Err(HandError::NotEnabled);
        }
        match command {
            GraspCommand::Grasp(GraspPlan { control: ObjectControl::Wrench(_), .. }) => {
                return Err(HandError::WrenchControl);
            }
            GraspCommand::Grasp(GraspPlan { feedback: false, .. }) => return Err(HandError::OpenLoop),
            _ => {}
        }
        let speeds = self.model.planned_speeds();
        self.state.command(&self.model.hand(), &speeds, command).map_err(HandError::GraspRefusal)
    }

    /// Runs one control period: reads the measurements of all fingers, and sends each board its set-points.
    ///
    /// # Errors
    /// A board is in fault, disabled or silent, or refuses; or the object was lost. All boards have been
    /// stopped then.
    pub fn step(&mut self) -> Result<GraspTelemetry, HandError> {
        if !self.enabled {
            return Err(HandError::NotEnabled);
        }
        self.steps = self.steps.wrapping_add(1);
        match self.advance() {
            Ok(()) => Ok(self.telemetry()),
            Err(mut error) => {
                self.stop();
                self.add_fault(&mut error);
                Err(error)
            }
        }
    }

    fn advance(&mut self) -> Result<(), HandError> {
        for finger in &mut self.fingers {
            finger.age += 1;
            finger.listen()?;
            if finger.age > MAX_AGE {
                return Err(HandError::Stale { board: finger.name.clone(), steps: finger.age });
            }
        }
        let hand = self.model.hand();
        let sensed = self.fingers.each_ref().map(|finger| finger.measured);
        let postures: PerFinger<Posture> =
            std::array::from_fn(|finger| hand.fingers[finger].chain.posture(&sensed[finger].angles));
        let senses = std::array::from_fn(|finger| {
            let FingerMeasurement { angles, force } = sensed[finger];
            FingerSense { posture: &postures[finger], angles, force, efforts: None }
        });
        let command = self.state.tick(&hand, &senses).map_err(HandError::Lost)?;
        let guides = self.guides(&command);
        for (finger, guide) in self.fingers.iter_mut().zip(guides) {
            let board = || finger.name.clone();
            let posted = finger.board.post(guide);
            posted.map_err(|source| HandError::Board { board: board(), source })?;
        }
        Ok(())
    }

    /// The set-points for the boards.
    fn guides(&self, command: &HandOutput) -> PerFinger<Request> {
        let hand = self.model.hand();
        let mut guides = [Request::Keep, Request::Keep, Request::Keep];
        let fingers = hand.fingers.iter().zip(command.points.iter().zip(&command.torques));
        for (guide, (finger, (points, torques))) in guides.iter_mut().zip(fingers) {
            let torques = torques.iter().zip(&finger.torque_limits);
            *guide = Request::Task(TaskCommand::JointServo(JointCommand::StreamTorques {
                points: points.iter().copied().collect(),
                // A board refuses torques beyond the limits, whereas the servo of a single board would
                // saturate them.
                torques: torques.map(|(torque, limit)| torque.clamp(-limit, *limit)).collect(),
            }));
        }
        guides
    }

    /// Stops all boards at once with their model's reaction; no more set-points are sent.
    pub fn stop(&mut self) {
        self.enabled = false;
        for finger in &mut self.fingers {
            // A board that cannot be reached stops by its command timeout.
            let _ = finger.board.post(Request::Stop);
        }
    }

    /// Disables all boards: a held object falls.
    pub fn disable(&mut self) {
        self.enabled = false;
        for finger in &mut self.fingers {
            let _ = finger.board.post(Request::Disable);
        }
    }

    /// Reads the reason for the fault, after all boards have been stopped: that stop is recorded as another
    /// fault.
    fn add_fault(&mut self, error: &mut HandError) {
        let HandError::Fault { board, fault } = error else { return };
        if let Some(finger) = self.fingers.iter_mut().find(|finger| finger.name == *board)
            && let Ok(log) = finger.board.faults()
        {
            let cause = finger.before.later(&log).first().or(log.faults.last());
            *fault = cause.map(|cause| {
                format!("{}; see {}", cause.named(&finger.model), troubleshooting::fault(cause.cause))
            });
        }
    }

    fn each(
        &mut self,
        mut action: impl FnMut(&mut FingerState<B>) -> Result<(), BoardError>,
    ) -> Result<(), HandError> {
        for finger in &mut self.fingers {
            action(finger).map_err(|source| HandError::Board { board: finger.name.clone(), source })?;
        }
        Ok(())
    }
}

impl<B: FingerBoard> FingerState<B> {
    /// Updates from the data received from the board.
    fn listen(&mut self) -> Result<(), HandError> {
        let board = || self.name.clone();
        let news = self.board.listen().map_err(|source| HandError::Board { board: board(), source })?;
        if let Some(refusal) = news.refusal {
            if let source @ BoardError::Reset = BoardError::refused("move", refusal) {
                return Err(HandError::Board { board: board(), source });
            }
            return Err(HandError::Refused { board: board(), refusal });
        }
        self.telemetry = news.telemetry.or_else(|| self.telemetry.take());
        self.tips = news.tips.or_else(|| self.tips.take());
        match self.telemetry.as_ref().map(|telemetry| telemetry.mode) {
            Some(Mode::Fault) => return Err(HandError::Fault { board: board(), fault: None }),
            // `enable` updates nothing between the first tick and enabling.
            Some(Mode::Disabled) if self.tick.is_some() => {
                return Err(HandError::Disabled { board: board() });
            }
            _ => {}
        }
        let (Some(telemetry), Some(tips)) = (&self.telemetry, &self.tips) else { return Ok(()) };
        let tick = telemetry.tick;
        let newer = self.tick.is_none_or(|last| (1..1 << 31).contains(&tick.wrapping_sub(last)));
        let ([a, b, c], [tip]) = (&telemetry.joints[..], &tips.tips[..]) else { return Ok(()) };
        if tips.tick == tick && newer {
            self.measured = FingerMeasurement {
                angles: [a.position, b.position, c.position],
                // The sensor measures the force on the tip; the tip exerts the opposite one.
                force: tip.force.map(|force| -force),
            };
            (self.tick, self.age, self.tared) = (Some(tick), 0, tip.tared);
        }
        Ok(())
    }
}

const _: () = assert!(FINGERS == 3);
