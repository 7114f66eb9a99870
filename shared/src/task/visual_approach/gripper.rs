//! The gripper: opening, closing until an object is between the fingers, holding it with a torque.

use nalgebra::Vector1;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::GripperSettings;
use crate::TICK;
use crate::control::JointPoint;
use crate::math::{abs, clamp};
use crate::robot::JointTarget;
use crate::signal::{MotionLimits, MotionTarget};

/// Effort at which the gripper has closed on an object, as a fraction of the holding torque.
const TOUCH: f32 = 0.25;
/// Times in which the holding torque rises and falls [s].
const BUILD_UP: f32 = 0.2;
const LET_GO: f32 = 0.04;
/// Damping of the joint under that torque, over its inertia and per period: fingers that spring back, or lose
/// the object, gain no speed.
const DAMPING: f32 = 0.3;
/// Time in which opening and closing reach their speed [s].
const START: f32 = 0.1;
/// The gripper is jammed if it needs more than this share of the holding torque to open, for this time [s],
/// or if it opens or closes for more than twice the nominal time plus this delay [s].
const RESISTANCE: f32 = 0.5;
const OVERLOAD: f32 = 0.1;
const DELAY: f32 = 1.0;
/// Distance from an end of the gripper's range that counts as reached, as a share of the range.
const AT_END: f32 = 0.02;

/// State of the gripper.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum GripperState {
    /// 0: it stands where it was when the task began.
    Still,
    /// 1: it opens.
    Opening,
    /// 2: it is open.
    Open,
    /// 3: it closes.
    Closing,
    /// 4: an object is between the fingers and is held with the torque of the settings.
    Holding,
    /// 5: it has closed without an object, or has lost it.
    Empty,
    /// 6: an obstacle stopped it while it opened or closed; it stands. Only the opposite command moves it
    /// again.
    Jammed,
}

/// The gripper's part of the task.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Gripper {
    pub state: GripperState,
    /// Torque with which it presses [N·m].
    press: f32,
    /// Whether the last command was to open.
    opens: bool,
    /// Time for which it has been opening or closing, and for which it has needed too large a torque [s].
    time: f32,
    overload: f32,
}

/// The gripper's joint in a tick.
pub struct GripperJoint<'a> {
    /// Measured angle [rad] and velocity [rad/s].
    pub position: f32,
    pub velocity: f32,
    /// Torque beyond the model [N·m].
    pub effort: f32,
    /// [kg·m²]
    pub inertia: f32,
    pub reference: JointPoint,
    pub target: &'a mut JointTarget,
}

impl Gripper {
    pub const STILL: Self =
        Self { state: GripperState::Still, press: 0.0, opens: false, time: 0.0, overload: 0.0 };

    pub fn open(&mut self) {
        let goes_on = matches!(self.state, GripperState::Opening | GripperState::Jammed) && self.opens;
        if !goes_on && self.state != GripperState::Open {
            self.start(GripperState::Opening);
        }
    }

    pub fn close(&mut self) {
        // A repeated command changes nothing, even before the leader has read that there is no object.
        let ended = matches!(self.state, GripperState::Empty | GripperState::Jammed) && !self.opens;
        let goes_on = ended || self.state == GripperState::Closing;
        if !goes_on && self.state != GripperState::Holding {
            self.start(GripperState::Closing);
        }
    }

    fn start(&mut self, state: GripperState) {
        (self.state, self.opens) = (state, state == GripperState::Opening);
        (self.time, self.overload) = (0.0, 0.0);
    }

    /// Sets the joint's target for a period.
    pub fn tick(&mut self, settings: &GripperSettings, joint: GripperJoint<'_>) {
        let GripperSettings { open, closed, speed, torque, .. } = *settings;
        let direction = if closed > open { 1.0 } else { -1.0 };
        let at = |end: f32| abs(joint.position - end) < AT_END * abs(closed - open);
        let is_jammed = self.is_jammed(settings, &joint);
        let mut restart = false;
        match self.state {
            GripperState::Opening if at(open) => self.state = GripperState::Open,
            GripperState::Closing if at(closed) => {
                self.state = GripperState::Empty;
                *joint.target = JointTarget::at(closed);
                return;
            }
            GripperState::Closing if joint.effort * direction > TOUCH * torque => {
                self.state = GripperState::Holding;
                // What the servo presses with becomes part of the torque, instead of remaining beside it.
                (self.press, restart) = (clamp(joint.effort, -torque, torque), true);
            }
            GripperState::Opening | GripperState::Closing if is_jammed => {
                self.state = GripperState::Jammed;
                // Resets the disturbance estimate of the servo, which it has pressed with.
                *joint.target = JointTarget { restart: true, ..JointTarget::at(joint.position) };
                return;
            }
            // An object that gives way or slips out is not held.
            GripperState::Holding if at(closed) || joint.velocity * direction > speed => {
                self.state = GripperState::Empty;
            }
            _ => {}
        }
        let (desired, time) = match self.state {
            GripperState::Holding => (torque * direction, BUILD_UP),
            _ => (0.0, LET_GO),
        };
        if desired != 0.0 || self.press != 0.0 {
            let step = torque * (TICK / time);
            self.press += clamp(desired - self.press, -step, step);
            // The servo's reference follows the joint, so that the servo does not work against the torque.
            let point = JointPoint { position: joint.position, velocity: 0.0, acceleration: 0.0 };
            let feedforward = self.press - DAMPING / TICK * joint.inertia * joint.velocity;
            *joint.target = if self.press == 0.0 {
                JointTarget::at(joint.position)
            } else {
                JointTarget { feedforward, restart, ..JointTarget::point(point) }
            };
            return;
        }
        let end = match self.state {
            GripperState::Still | GripperState::Empty | GripperState::Holding | GripperState::Jammed => {
                return;
            }
            GripperState::Opening | GripperState::Open => open,
            GripperState::Closing => closed,
        };
        let mut point = joint.reference.next();
        let limits = MotionLimits { speed, acceleration: speed / START };
        let target = MotionTarget {
            offset: Vector1::new(end - point.position),
            velocity: Vector1::zeros(),
            acceleration: Vector1::zeros(),
        };
        point.acceleration = limits.acceleration(&Vector1::new(point.velocity), &target).x;
        *joint.target = JointTarget::point(point);
    }

    /// Counts the time of opening or closing. Returns whether it takes too long.
    fn is_jammed(&mut self, settings: &GripperSettings, joint: &GripperJoint<'_>) -> bool {
        let GripperSettings { open, closed, speed, torque, .. } = *settings;
        // Only opening can be overloaded: closing ends at an object between the fingers.
        let opens = if closed > open { -1.0 } else { 1.0 };
        let is_overloaded = self.opens && joint.effort * opens > RESISTANCE * torque;
        self.time = (self.time + TICK).min(1e3);
        self.overload = if is_overloaded { self.overload + TICK } else { 0.0 };
        self.overload > OVERLOAD || self.time > 2.0 * abs(closed - open) / speed + DELAY
    }
}
