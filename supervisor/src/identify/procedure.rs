//! The motions that identify a hand: each joint to and fro in free motion, then an object held with a
//! stronger and a weaker grip, and moved so that every joint goes to and fro under load.

use nalgebra::{Vector3, Vector6};
use tesaki::control::ServoMode;
use tesaki::kinematics::Chain;
use tesaki::model::{MAX_CHAIN_JOINTS, ModelError, RobotModel};
use tesaki::protocol::{Mode, Request, Telemetry, Tips};
use tesaki::task::grasping::{
    Failure, GraspCommand, GraspPlan, GraspTelemetry, InternalForce, ObjectControl, Phase,
};
use tesaki::task::{TaskCommand, TaskConfig};
use tesaki_description::plant::CONTROL_PERIOD;

use super::regression::{Fit, Reading, fit};
use super::sweep::{Sweep, ranges, references};
use crate::BoardError;

/// Durations of a sweep from one end to the other [s]: two speeds, to separate viscous friction.
const SWEEPS: [f64; 2] = [1.0, 0.4];
/// Largest torque for a joint's inertia in a sweep, as a fraction of its limit.
const SWEEP_TORQUE: f64 = 0.075;
/// Sweeps to and fro at each.
const REPEATS: usize = 2;
/// Interval at which the grasp telemetry is read [ticks].
const ASK: usize = 5;
/// Time limit of a grasp, and of putting the object down [s].
const PHASE_TIMEOUT: f64 = 20.0;
/// Height by which the object is lifted off its support, and its later motion along each axis of the base
/// [m]; rotation [rad].
const LIFT: f64 = 0.010;
const SHIFT: f64 = 0.006;
const TURN: f64 = 0.06;
/// Duration of each such motion [s].
const MOTION: f64 = 0.8;
/// Coefficient of friction if the file has none; the identification does not probe it.
const FRICTION: f32 = 0.4;
/// Fraction of its velocity limit up to which the board is enabled, and the longest wait for that [ticks].
const SLOW: f32 = 0.2;
const REST: usize = 100;

/// Settings for an identification.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings {
    /// Amplitude of each joint's sweep to either side of its position [rad].
    pub amplitude: f64,
    /// The grips, each by its largest normal force [N].
    pub strengths: Vec<f32>,
}

impl Default for Settings {
    fn default() -> Self {
        Self { amplitude: 0.1, strengths: vec![2.0, 6.0, 4.0] }
    }
}

/// Readings after a tick.
#[derive(Clone, Debug)]
pub struct Sense {
    /// Telemetry of the joints.
    pub telemetry: Telemetry,
    /// Telemetry of the tips, in the same tick.
    pub tips: Tips,
}

/// A board, and the passage of time.
pub trait Machine {
    /// Reason for a failure.
    type Error: From<BoardError> + From<IdentifyError>;

    /// Sends the board a request, and waits for the reply.
    ///
    /// # Errors
    /// The board refuses.
    fn ask(&mut self, action: &'static str, request: Request) -> Result<(), Self::Error>;

    /// Reads the state of the grasp.
    ///
    /// # Errors
    /// The board refuses.
    fn read_grasp(&mut self) -> Result<GraspTelemetry, Self::Error>;

    /// Sends a set-point, and waits for the board's next readings.
    ///
    /// # Errors
    /// The board refuses, faults, or stops answering.
    fn tick(&mut self, request: Request) -> Result<Sense, Self::Error>;

    /// Reports the present step.
    fn progress(&mut self, text: &str);
}

/// Result of the identification.
#[derive(Clone, Debug, PartialEq)]
pub struct Identification {
    /// One result per joint.
    pub fits: Vec<Fit>,
    /// Grips that failed; the others were sufficient.
    pub failed: Vec<FailedGrip>,
}

/// A grip that failed: the hand opened, and the object stands where it was.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("a grip of {strength} N was not made: {failure}")]
pub struct FailedGrip {
    /// The grip [N].
    pub strength: f32,
    /// The failure.
    pub failure: Failure,
}

/// Reasons why nothing was identified.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum IdentifyError {
    /// The robot is not a hand that can grasp.
    #[error(
        "{robot} is not a hand that grasps: three fingers of three joints with a force sensor each are needed"
    )]
    NotAHand {
        /// Its name.
        robot: String,
    },
    /// The model is one that no board accepts.
    #[error(transparent)]
    Model(ModelError),
    /// A joint has no room.
    #[error(
        "{joint} stands at {position:.3} rad, and its range {lower:.3} to {upper:.3} rad has no room for a sweep of ±{amplitude} \
         rad: a smaller --amplitude"
    )]
    NoRoom {
        /// The joint.
        joint: String,
        /// Its position [rad].
        position: f64,
        /// Smallest angle [rad].
        lower: f64,
        /// Largest angle [rad].
        upper: f64,
        /// Requested amplitude [rad].
        amplitude: f64,
    },
    /// A joint needs more torque than it may use.
    #[error(
        "{joint} needs {torque:+.3} N·m beyond the weight of its links at {position:.3} rad, and may have {limit:.3} N·m: \
         nothing was identified. Does it touch something, or is its friction, or a link's mass, larger than the \
         model's? Free it, or allow more with --torque"
    )]
    Resisted {
        /// The joint.
        joint: String,
        /// Its position [rad].
        position: f64,
        /// The torque that it needs [N·m].
        torque: f64,
        /// The torque that it may use [N·m].
        limit: f64,
    },
    /// A force sensor measured a contact.
    #[error(
        "the force on {tip} changed by {force:.2} N, and may by {limit:.2} N: nothing was identified. Take away what it \
         touches; this identification needs no object"
    )]
    Touched {
        /// Name of the tip.
        tip: String,
        /// The change of the force [N].
        force: f64,
        /// The largest allowed change [N].
        limit: f64,
    },
    /// The hand did not reach the requested phase.
    #[error("with a grip of {strength} N the hand {phase}, and not as asked{}", because(.failure))]
    Grasp {
        /// The grip [N].
        strength: f32,
        /// The phase it is in.
        phase: Phase,
        /// The reason, if reported.
        failure: Option<Failure>,
    },
    /// There were too few different loads.
    #[error(
        "{}: two different grips are needed, and {made} could be made; others with --grips", list(.failed)
    )]
    TooFewGrips {
        /// The grips that failed.
        failed: Vec<FailedGrip>,
        /// Number of different grips that succeeded.
        made: usize,
    },
    /// Too many set-points did not come in time.
    #[error(
        "set-points came late in {irregular} of {ticks} ticks, and may in {limit}: nothing was identified, because the \
         torques after a late set-point say nothing about friction. This computer, or the link to the board, is too \
         busy: end other programs, and try again"
    )]
    Late {
        /// Number of ticks in which the board had no new set-point, or two at once.
        irregular: u32,
        /// Number of ticks since the start.
        ticks: u32,
        /// Number of such ticks that are permitted.
        limit: u32,
    },
    /// The board is no longer enabled.
    #[error("the board is {0}: nothing was identified")]
    Stopped(Mode),
}

fn because(failure: &Option<Failure>) -> String {
    failure.as_ref().map_or_else(String::new, |failure| format!(": {failure}"))
}

fn list(failed: &[FailedGrip]) -> String {
    failed.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
}

/// The kinematics of a chain, and the readings of its joints.
struct Finger {
    chain: Chain,
    /// The same chain once for each link, with only that link having weight.
    links: Vec<Chain>,
    first: usize,
    readings: Vec<Vec<Reading>>,
}

/// Collects readings as the machine moves.
struct Course<'a, M> {
    machine: &'a mut M,
    model: &'a RobotModel,
    fingers: Vec<Finger>,
    motion: usize,
    /// The last readings: their torques act until the next readings are taken.
    latest: Option<Sense>,
}

/// Identifies torque constants and friction of the joints of a hand; returns one result per joint. The hand
/// stands with open fingers around an object, homed and tared; `plan` describes the grasp.
///
/// First each joint is swept to and fro by itself ([`Settings::amplitude`]). Then the object is grasped,
/// lifted, shifted and turned to and fro, and put down, with each of the grips ([`Settings::strengths`]),
/// with force feedback. A failed grip is skipped if there are two others of different strengths.
///
/// # Errors
/// The machine's error, or what prevents the identification; the board may still be enabled then.
pub fn identify<M: Machine>(
    machine: &mut M,
    model: &RobotModel,
    plan: &GraspPlan,
    settings: &Settings,
) -> Result<Identification, M::Error> {
    let hand = model.chains.len() == 3
        && model.chains.iter().all(|chain| chain.joints == 3 && chain.force_sensor.is_some());
    if !hand {
        return Err(IdentifyError::NotAHand { robot: model.name.to_string() }.into());
    }
    let mut course = Course { machine, model, fingers: fingers(model), motion: 0, latest: None };
    course.sweep(settings.amplitude)?;
    let (mut made, mut failed) = (Vec::new(), Vec::new());
    for &strength in &settings.strengths {
        match course.grip(plan, strength)? {
            Ok(()) if !made.contains(&strength) => made.push(strength),
            Ok(()) => {}
            Err(failure) => {
                let grip = FailedGrip { strength, failure };
                course.machine.progress(&grip.to_string());
                failed.push(grip);
            }
        }
    }
    course.disable()?;
    if !failed.is_empty() && made.len() < 2 {
        return Err(IdentifyError::TooFewGrips { failed, made: made.len() }.into());
    }
    let readings = course.fingers.iter().flat_map(|finger| &finger.readings);
    Ok(Identification { fits: readings.map(|readings| fit(readings)).collect(), failed })
}

fn fingers(model: &RobotModel) -> Vec<Finger> {
    let chains = model.chains.iter().zip(model.chain_ranges());
    let finger = |(chain, range): (&tesaki::model::ChainModel, std::ops::Range<usize>)| {
        let joints = model.joints.get(range.clone()).unwrap_or_default();
        let alone = |link: usize| {
            let mut joints = joints.to_vec();
            for (index, joint) in joints.iter_mut().enumerate() {
                if index != link {
                    joint.link.mass = 0.0;
                    joint.link.inertia = [0.0; 6];
                }
            }
            Chain::new(&joints, &chain.tip)
        };
        Finger {
            chain: Chain::new(joints, &chain.tip),
            links: (0..joints.len()).map(alone).collect(),
            first: range.start,
            readings: vec![Vec::new(); joints.len()],
        }
    };
    chains.map(finger).collect()
}

impl Finger {
    /// Adds the readings that followed after `torques` [N·m] had acted.
    fn take(&mut self, motion: usize, gravity: &Vector3<f32>, torques: &[f32], sense: &Sense, chain: usize) {
        let count = self.readings.len();
        let joints: Vec<_> = sense.telemetry.joints.iter().skip(self.first).take(count).collect();
        let Some(tip) = sense.tips.tips.get(chain) else { return };
        if joints.len() < count {
            return;
        }
        let angles: Vec<f32> = joints.iter().map(|joint| joint.position).collect();
        let rest = [0.0; MAX_CHAIN_JOINTS];
        let mut loads = [0.0; MAX_CHAIN_JOINTS];
        let [fx, fy, fz] = tip.force;
        let [mx, my, mz] = tip.torque;
        let (none, wrench) = (Vector3::zeros(), Vector6::new(fx, fy, fz, mx, my, mz));
        self.chain.inverse_dynamics_with_wrench(&none, &wrench, &angles, &rest, &rest, &mut loads[..count]);
        let mut weights = [[0.0_f64; MAX_CHAIN_JOINTS]; MAX_CHAIN_JOINTS];
        for (link, chain) in self.links.iter().enumerate() {
            let mut torques = [0.0; MAX_CHAIN_JOINTS];
            chain.inverse_dynamics(gravity, &angles, &rest, &rest, &mut torques[..count]);
            for (weights, torque) in weights.iter_mut().zip(torques) {
                weights[link] = torque.into();
            }
        }
        for (index, readings) in self.readings.iter_mut().enumerate() {
            let Some(&torque) = torques.get(self.first + index) else { return };
            readings.push(Reading {
                motion,
                torque: torque.into(),
                load: loads[index].into(),
                velocity: joints[index].velocity.into(),
                acceleration: 0.0,
                weights: weights[index],
            });
        }
    }
}

impl<M: Machine> Course<'_, M> {
    fn tick(&mut self, request: Request) -> Result<(), M::Error> {
        let sense = self.machine.tick(request)?;
        let mode = sense.telemetry.mode;
        if !matches!(mode, Mode::Enabled(_)) {
            return Err(IdentifyError::Stopped(mode).into());
        }
        // A frame may have been lost: earlier torques do not belong to the present readings.
        let before =
            self.latest.take_if(|latest| sense.telemetry.tick == latest.telemetry.tick.wrapping_add(1));
        if let Some(Sense { telemetry, .. }) = before {
            let torques: Vec<f32> = telemetry.joints.iter().map(|joint| joint.torque).collect();
            let gravity = Vector3::from(self.model.gravity);
            for (chain, finger) in self.fingers.iter_mut().enumerate() {
                finger.take(self.motion, &gravity, &torques, &sense, chain);
            }
        }
        self.latest = Some(sense);
        Ok(())
    }

    /// Enables the board for the next motion, once no joint is too fast for that: a light joint may have
    /// broken away from friction with a jerk.
    fn enable(&mut self, task: TaskConfig) -> Result<(), M::Error> {
        for _ in 0..REST {
            let joints = self.latest.iter().flat_map(|sense| &sense.telemetry.joints);
            let mut joints = joints.zip(&self.model.joints);
            if joints.all(|(joint, model)| joint.velocity.abs() <= SLOW * model.limits.velocity) {
                break;
            }
            self.tick(Request::Keep)?;
        }
        if self.latest.take().is_some() {
            self.disable()?;
        }
        self.machine.ask("enable its outputs", Request::Enable(task))
    }

    fn disable(&mut self) -> Result<(), M::Error> {
        self.machine.ask("disable its outputs", Request::Disable)
    }

    /// Moves each joint to and fro by itself, with the others at rest.
    fn sweep(&mut self, amplitude: f64) -> Result<(), M::Error> {
        self.enable(TaskConfig::JointServo(ServoMode::Observer))?;
        self.tick(Request::Keep)?;
        let model = self.model;
        let start: Vec<f64> =
            self.latest.iter().flat_map(|sense| references(model, &sense.telemetry)).collect();
        let ranges = ranges(model, &start, amplitude)?;
        for (index, joint) in model.joints.iter().enumerate() {
            self.machine.progress(&format!("{} sweeps", joint.name));
            let sweep =
                Sweep { model, start: &start, ranges: &ranges, joints: &[index], torque: SWEEP_TORQUE };
            for leg in sweep.legs(&SWEEPS.map(|time| (time, REPEATS)), SWEEPS[0]) {
                self.motion += 1;
                leg.requests().try_for_each(|request| self.tick(request))?;
            }
        }
        Ok(())
    }

    /// Grasps the object, moves it to and fro, and puts it down; or returns why it could not be gripped.
    fn grip(&mut self, plan: &GraspPlan, strength: f32) -> Result<Result<(), Failure>, M::Error> {
        self.machine.progress(&format!("a grip of {strength} N"));
        let plan = GraspPlan {
            internal: InternalForce::Normal { strength },
            feedback: true,
            friction: Some(plan.friction.unwrap_or(FRICTION)),
            control: ObjectControl::Differential(ServoMode::Observer),
            ..*plan
        };
        self.enable(TaskConfig::Grasping(()))?;
        self.motion += 1;
        self.machine.ask("grasp", Request::Task(TaskCommand::Grasping(GraspCommand::Grasp(plan))))?;
        let (phase, failure) = self.wait_for(Phase::Hold)?;
        match failure {
            None if phase == Phase::Hold => {}
            // Only the forces were wrong, and the hand has released the object where it stood.
            Some(failure @ Failure::NoGrip { .. }) if phase == Phase::Ready => return Ok(Err(failure)),
            _ => return Err(IdentifyError::Grasp { strength, phase, failure }.into()),
        }
        let gravity = Vector3::from(self.model.gravity).map(f64::from);
        let up = if gravity.norm() > 0.0 { gravity * (-LIFT / gravity.norm()) } else { Vector3::zeros() };
        let still = Vector3::zeros();
        self.bring(up, still, strength)?;
        for axis in 0..3 {
            let unit = Vector3::ith(axis, 1.0);
            for way in [SHIFT, -SHIFT] {
                self.bring(up + unit * way, still, strength)?;
            }
            self.bring(up, still, strength)?;
            for way in [TURN, -TURN] {
                self.bring(up, unit * way, strength)?;
            }
            self.bring(up, still, strength)?;
        }
        self.motion += 1;
        self.machine
            .ask("put the object down", Request::Task(TaskCommand::Grasping(GraspCommand::PutDown)))?;
        self.until(Phase::Ready, strength)?;
        Ok(Ok(()))
    }

    fn bring(
        &mut self,
        translation: Vector3<f64>,
        rotation: Vector3<f64>,
        strength: f32,
    ) -> Result<(), M::Error> {
        self.motion += 1;
        #[expect(clippy::cast_possible_truncation, reason = "the board computes in single precision")]
        let single = |vector: Vector3<f64>| -> [f32; 3] { vector.map(|value| value as f32).into() };
        #[expect(clippy::cast_possible_truncation, reason = "the board computes in single precision")]
        let duration = MOTION as f32;
        let (translation, rotation) = (single(translation), single(rotation));
        let motion = GraspCommand::Move { translation, rotation, duration };
        self.machine.ask("move the object", Request::Task(TaskCommand::Grasping(motion)))?;
        self.until(Phase::Hold, strength)
    }

    /// Waits until the hand is in phase `expected`.
    fn until(&mut self, expected: Phase, strength: f32) -> Result<(), M::Error> {
        let (phase, failure) = self.wait_for(expected)?;
        if phase == expected && failure.is_none() {
            return Ok(());
        }
        Err(IdentifyError::Grasp { strength, phase, failure }.into())
    }

    /// Waits until the hand is in phase `expected`, or ready, or the timeout has passed.
    fn wait_for(&mut self, expected: Phase) -> Result<(Phase, Option<Failure>), M::Error> {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of ticks")]
        let limit = (PHASE_TIMEOUT / CONTROL_PERIOD) as usize;
        for tick in 1.. {
            self.tick(Request::Keep)?;
            if tick % ASK == 0 || tick >= limit {
                let GraspTelemetry { phase, failure, .. } = self.machine.read_grasp()?;
                if tick >= limit || phase == expected || phase == Phase::Ready {
                    return Ok((phase, failure));
                }
            }
        }
        unreachable!("there are so many ticks")
    }
}
