//! The robot as data: joints, chains, motors, encoders, limits, gains.
//!
//! A [`RobotModel`] is stored and sent to a board. Its values may be invalid; [`RobotModel::validate`]
//! reports the first invalid joint and field. Only a validated model becomes a
//! [`Robot`](crate::robot::Robot).
//!
//! Glossary
//! - *joint*: one rotary degree of freedom together with the link that it moves;
//! - *chain*: joints in series from the base (a finger, an arm); chains split the joint list into consecutive
//!   runs;
//! - *joint frame*: the frame of a link, at its joint, as in URDF; at joint angle 0 its pose in the frame of
//!   the link before it is `origin`;
//! - *mimic joint*: a joint without motor that follows one with a motor, of the same chain or another;
//! - *reflected*: referred to the joint side of the gear.

mod error;
mod validate;

pub use error::{Field, ModelError, Problem};
pub(crate) use validate::{AXIS_TOLERANCE, CURRENT_MARGIN, JUMP_FACTOR};

use core::f32::consts::TAU;

use heapless::{String, Vec};
use nalgebra::{Isometry3, Matrix3};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::math::orientation;

/// Maximum number of joints of one node.
pub const MAX_JOINTS: usize = 16;
/// Maximum number of joints of one chain.
pub const MAX_CHAIN_JOINTS: usize = 7;
/// Maximum number of chains of one robot.
pub const MAX_CHAINS: usize = 6;
/// Maximum number of mimic joints of one robot: two for each of five fingers.
pub const MAX_MIMICS: usize = 10;
/// Maximum length of a name [bytes].
pub const MAX_NAME: usize = 32;

/// A robot as data: everything the control core knows about the machine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct RobotModel {
    /// Name of the robot, as in its URDF.
    pub name: String<MAX_NAME>,
    /// Acceleration of gravity in the base frame [m/s²], for instance `[0, 0, −9.81]` for an upright base.
    pub gravity: [f32; 3],
    /// The chains, in the order of the joints.
    pub chains: Vec<ChainModel, MAX_CHAINS>,
    /// The joints, chain after chain, each chain from base to tip.
    pub joints: Vec<JointModel, MAX_JOINTS>,
    /// Supervision limits and the reaction to faults.
    pub safety: Safety,
    /// Joints of the chains that have no motor.
    pub mimics: Vec<MimicJoint, MAX_MIMICS>,
    /// Strain gauges of a force sensor that the board converts itself; `None` without any, or if the sensors
    /// deliver wrenches.
    pub gauges: Option<Gauges>,
}

/// A run of consecutive joints in series.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ChainModel {
    /// Name of its tip (fingertip, hand): that of the link in the URDF.
    pub name: String<MAX_NAME>,
    /// Number of its own joints in [`RobotModel::joints`], at least 1; with its mimic joints at most
    /// [`MAX_CHAIN_JOINTS`].
    pub joints: u8,
    /// The tip's frame in the frame of the last joint.
    pub tip: Pose,
    /// Radius of a spherical tip centred on the tip's frame [m]; 0 for any other shape.
    pub tip_radius: f32,
    /// The force sensor between the last link and the tip, if any; none with a mimic joint.
    pub force_sensor: Option<ForceSensor>,
}

/// A joint without motor, coupled to another joint by a linkage: an outer joint that follows the inner one of
/// the same finger, or the first joints of fingers that one actuator spreads. Its angle = `multiplier` ·
/// angle of that joint + `offset` (`<mimic>` of URDF).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct MimicJoint {
    /// Its chain, as index into [`RobotModel::chains`].
    pub chain: u8,
    /// Number of joints of that chain before it, mimic joints included.
    pub place: u8,
    /// The joint that it follows, of the same chain or another one, as index into [`RobotModel::joints`].
    pub joint: u8,
    /// Ratio of the velocities; not 0.
    pub multiplier: f32,
    /// Its angle when the other joint is at 0 [rad].
    pub offset: f32,
    /// Joint frame in the frame of the link before it (of the base, for the first joint of a chain) at angle
    /// 0.
    pub origin: Pose,
    /// Axis of rotation in the joint frame; a unit vector.
    pub axis: [f32; 3],
    /// Mass distribution of the link behind it, in the joint frame.
    pub link: Inertial,
}

/// Coupling of a joint to a motor: its angle is `multiplier` · angle of a joint with a motor + `offset`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coupling {
    /// Index of the joint with a motor, in the list of joints that the owner of the coupling names.
    pub actuated: u8,
    /// Factor; 1 for the joint with the motor itself.
    pub multiplier: f32,
    /// Angle of the joint when that with the motor is at 0 [rad].
    pub offset: f32,
}

impl Coupling {
    /// The joint with the motor itself.
    pub const fn direct(actuated: u8) -> Self {
        Self { actuated, multiplier: 1.0, offset: 0.0 }
    }

    /// The joint's angle when that with the motor is at `angle` [rad].
    #[inline(always)]
    pub fn angle(&self, angle: f32) -> f32 {
        self.multiplier * angle + self.offset
    }
}

/// A joint of a chain.
#[derive(Clone, Copy, Debug)]
pub enum ChainJoint<'a> {
    /// A joint with a motor, and its index into [`RobotModel::joints`].
    Driven(usize, &'a JointModel),
    /// A joint without motor.
    Mimic(&'a MimicJoint),
}

impl<'a> ChainJoint<'a> {
    /// Joint frame, axis and mass distribution.
    pub const fn body(self) -> (&'a Pose, &'a [f32; 3], &'a Inertial) {
        match self {
            Self::Driven(_, JointModel { origin, axis, link, .. })
            | Self::Mimic(MimicJoint { origin, axis, link, .. }) => (origin, axis, link),
        }
    }

    /// Its coupling to a joint with a motor.
    pub const fn coupling(self) -> Coupling {
        match self {
            #[expect(clippy::cast_possible_truncation, reason = "at most 16")]
            Self::Driven(index, _) => Coupling::direct(index as u8),
            Self::Mimic(&MimicJoint { joint, multiplier, offset, .. }) => {
                Coupling { actuated: joint, multiplier, offset }
            }
        }
    }
}

/// A six-axis force sensor between the last link and the tip. It measures the wrench on the tip at the origin
/// and in the axes of the tip's frame.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ForceSensor {
    /// Force for one count [N].
    pub force_resolution: f32,
    /// Torque for one count [N·m].
    pub torque_resolution: f32,
    /// Magnitude of the count at which the sensor saturates.
    pub saturation: u32,
    /// Maximum force on the tip [N]; a larger one is a fault.
    pub force_limit: f32,
    /// Mass on the measuring side of the sensor [kg].
    pub mass: f32,
    /// Its centre of mass in the tip's frame [m].
    pub center_of_mass: [f32; 3],
}

/// Gauges of a six-axis force sensor.
pub const GAUGES: usize = 6;
/// Counts at the end of the range of a gauge's converter: 24 bits.
pub const GAUGE_END: f32 = 8_388_607.0;

/// The six strain gauges (full bridges) of a force sensor, converted by the board. Wrench = calibration
/// matrix · counts; the tare removes the residual offset.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Gauges {
    /// The chain of the sensor, as index into [`RobotModel::chains`].
    pub chain: u8,
    /// The calibration (decoupling) matrix, row by row: forces along x, y, z of the tip's frame [N], then
    /// torques [N·m], for one count of each gauge's converter at its gain.
    pub calibration_matrix: [[f32; GAUGES]; 6],
    /// Gain in front of the converter of each gauge: a power of two, at most 128.
    pub gains: [u8; GAUGES],
}

/// One rotary joint, the link that it moves, and the drive that moves it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct JointModel {
    /// Name, as in the URDF.
    pub name: String<MAX_NAME>,
    /// Joint frame in the frame of the link before it (of the base, for the first joint of a chain) at angle
    /// 0.
    pub origin: Pose,
    /// Axis of rotation in the joint frame; a unit vector.
    pub axis: [f32; 3],
    /// Mass distribution of the link, in the joint frame.
    pub link: Inertial,
    /// The drive.
    pub motor: Motor,
    /// Friction of joint and gear.
    pub friction: Friction,
    /// The angle sensor.
    pub encoder: Encoder,
    /// Limits of motion and torque.
    pub limits: JointLimits,
    /// Gains of the servo.
    pub servo: ServoGains,
}

impl JointModel {
    /// Largest torque: the smaller of its limit and the motor's torque at the largest current [N·m].
    pub const fn torque_limit(&self) -> f32 {
        self.limits.torque.min(self.motor.current_limit * self.motor.torque_constant)
    }
}

/// A position and an orientation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Pose {
    /// Position [m].
    pub translation: [f32; 3],
    /// Orientation as a unit quaternion, `[x, y, z, w]`.
    pub rotation: [f32; 4],
}

impl Pose {
    /// No translation and no rotation.
    pub const IDENTITY: Self = Self { translation: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0] };

    /// The pose as a transformation; its quaternion is taken as of norm 1.
    pub(crate) fn isometry(&self) -> Isometry3<f32> {
        Isometry3::from_parts(self.translation.into(), orientation(self.rotation))
    }
}

impl From<&Isometry3<f32>> for Pose {
    fn from(isometry: &Isometry3<f32>) -> Self {
        Self { translation: isometry.translation.vector.into(), rotation: isometry.rotation.coords.into() }
    }
}

/// Mass distribution of a link.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Inertial {
    /// Mass [kg]; 0 for a link without mass.
    pub mass: f32,
    /// Centre of mass in the joint frame [m].
    pub center_of_mass: [f32; 3],
    /// Inertia about the centre of mass, axes parallel to the joint frame:
    /// `[ixx, iyy, izz, ixy, ixz, iyz]` [kg·m²].
    pub inertia: [f32; 6],
}

impl Inertial {
    /// The inertia as a matrix.
    pub(crate) fn tensor(&self) -> Matrix3<f32> {
        let [ixx, iyy, izz, ixy, ixz, iyz] = self.inertia;
        Matrix3::new(ixx, ixy, ixz, ixy, iyy, iyz, ixz, iyz, izz)
    }
}

/// The drive of a joint: motor, gear, and the current loop in its amplifier.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Motor {
    /// Reflected inertia of rotor and gear [kg·m²].
    pub rotor_inertia: f32,
    /// Joint torque per current [N·m/A].
    pub torque_constant: f32,
    /// Largest current that is commanded [A]; a measured one that is more than a quarter higher is a fault.
    pub current_limit: f32,
    /// Current for one count of the current sensor [A].
    pub current_resolution: f32,
    /// Bandwidth of the inner (current) loop [Hz].
    pub bandwidth: f32,
    /// Delay from sampling the sensors to the onset of the new torque [s].
    pub delay: f32,
    /// Resistance of the winding, with brushes and power stage [Ω]; needed by boards that control the
    /// current.
    pub resistance: Option<f32>,
    /// Inductance of the winding [H]; needed by boards that control the current.
    pub inductance: Option<f32>,
}

/// Friction of a joint.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Friction {
    /// Coulomb friction [N·m].
    pub coulomb: f32,
    /// Viscous friction [N·m·s/rad].
    pub viscous: f32,
}

/// The angle sensor of a joint. Angle = (count − `zero`) · 2π / `counts_per_turn`, negated if
/// `reversed`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Encoder {
    /// Counts for one turn of the *joint*.
    pub counts_per_turn: f32,
    /// `true` when the count falls as the angle grows.
    pub reversed: bool,
    /// Count at angle 0, for an absolute encoder.
    pub zero: i32,
    /// `true` when the count is arbitrary after power-on: the joint must be homed before it can be enabled.
    pub relative: bool,
}

impl Encoder {
    /// Change of the angle per count [rad]; negative when the count falls as the angle grows.
    pub fn radians_per_count(&self) -> f32 {
        let magnitude = TAU / self.counts_per_turn;
        if self.reversed { -magnitude } else { magnitude }
    }
}

/// Limits of a joint. A command outside them is refused; a measurement outside them is a fault, of the angle
/// where it is outside by more than the following error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct JointLimits {
    /// Smallest angle [rad].
    pub lower: f32,
    /// Largest angle [rad].
    pub upper: f32,
    /// Largest speed [rad/s].
    pub velocity: f32,
    /// Largest torque [N·m].
    pub torque: f32,
    /// Fastest change of torque [N·m/s].
    pub torque_rate: f32,
    /// Largest distance between reference and joint [rad].
    pub following_error: f32,
}

impl JointLimits {
    /// Largest speed of a planned motion [rad/s]. The rest of the velocity limit is a margin for tracking.
    pub const fn planned_speed(&self) -> f32 {
        0.8 * self.velocity
    }
}

/// Gains of a joint servo in all its [modes](crate::control::ServoMode).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ServoGains {
    /// Time constant `T_f` of the trajectory filter `1/(T_f s + 1)²` [s].
    pub filter_time: f32,
    /// Gains of the PID.
    pub pid: PidGains,
    /// Gains of the observer mode.
    pub observer: ObserverGains,
    /// Dead band of the integrator while the reference is at rest [rad]. It prevents the stick-slip limit
    /// cycle (hunting) of integral action with Coulomb friction. The bare PID has none.
    pub rest_error: f32,
}

/// Gains of [`crate::control::Pid`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct PidGains {
    /// Proportional gain [N·m/rad].
    pub proportional: f32,
    /// Integral gain [N·m/(rad·s)].
    pub integral: f32,
    /// Derivative gain [N·m·s/rad].
    pub derivative: f32,
    /// Cut-off `ω` of the pseudo-differentiator `sω/(s + ω)` [rad/s].
    pub cutoff: f32,
}

/// Gains of [`crate::control::ErrorObserver`] and of the state feedback behind it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ObserverGains {
    /// Inertia that the feedback assumes [kg·m²]: rotor and the links that the joint moves.
    pub inertia: f32,
    /// Bandwidth of the position loop [rad/s].
    pub bandwidth: f32,
    /// Bandwidth of the observer [rad/s].
    pub observer_bandwidth: f32,
}

/// Supervision beyond the joints' own limits, and the reaction to faults.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Safety {
    /// Maximum time without a command while enabled [s]; at least one control period.
    pub command_timeout: f32,
    /// Reaction to a fault that leaves the sensors valid.
    pub reaction: Reaction,
    /// Damping torque per speed under [`Reaction::Damp`] [N·m·s/rad].
    pub damping: f32,
    /// Lowest supply voltage [V].
    pub supply_min: f32,
    /// Highest supply voltage [V].
    pub supply_max: f32,
}

/// Reaction to a fault, weakest first. Faults that [leave no
/// control](crate::fault::FaultCause::leaves_control), such as those of encoders and drives, always lead to
/// [`Reaction::Off`]; those of force sensors do not. A further fault during a reaction leads to a weaker one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Reaction {
    /// 0: no torque.
    Off,
    /// 1: damping torque, and gravity compensation.
    Damp,
    /// 2: a controlled stop as the running task needs it, then the position is held.
    Hold,
}

impl RobotModel {
    /// The mimic joints of a chain.
    pub fn mimics_of(&self, chain: usize) -> impl Iterator<Item = &MimicJoint> {
        self.mimics.iter().filter(move |mimic| usize::from(mimic.chain) == chain)
    }

    /// The gauges of the force sensor of a chain.
    pub fn gauges_of(&self, chain: usize) -> Option<&Gauges> {
        self.gauges.as_ref().filter(|gauges| usize::from(gauges.chain) == chain)
    }

    /// All joints of a chain of a validated model, base to tip.
    pub fn joints_of(&self, chain: usize) -> impl Iterator<Item = ChainJoint<'_>> {
        let mut own = self.chain_ranges().nth(chain).unwrap_or(0..0);
        (0..MAX_CHAIN_JOINTS).map_while(move |place| {
            if let Some(mimic) = self.mimics_of(chain).find(|mimic| usize::from(mimic.place) == place) {
                return Some(ChainJoint::Mimic(mimic));
            }
            let index = own.next()?;
            Some(ChainJoint::Driven(index, self.joints.get(index)?))
        })
    }

    /// The angles of all joints of a chain [rad], base to tip, at those of the joints with a motor. Missing
    /// ones count as 0.
    pub fn chain_angles(&self, chain: usize, angles: &[f32]) -> Vec<f32, MAX_CHAIN_JOINTS> {
        let angle = |joint: ChainJoint<'_>| {
            let coupling = joint.coupling();
            coupling.angle(angles.get(usize::from(coupling.actuated)).copied().unwrap_or(0.0))
        };
        self.joints_of(chain).map(angle).collect()
    }

    /// The joint's name, for messages; `"?"` when there is no such joint.
    pub fn joint_name(&self, joint: usize) -> &str {
        self.joints.get(joint).map_or("?", |joint| joint.name.as_str())
    }

    /// The chains as ranges of joint indices. Meaningful for a validated model.
    pub fn chain_ranges(&self) -> impl Iterator<Item = core::ops::Range<usize>> + '_ {
        let mut first = 0;
        self.chains.iter().map(move |chain| {
            let range = first..first + usize::from(chain.joints);
            first = range.end;
            range
        })
    }
}
