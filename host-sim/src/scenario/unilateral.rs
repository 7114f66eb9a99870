//! Unilateral teleoperation: an operator with a master arm and an elbow sensor, and the set-points of the
//! slave.

mod trace;

use rapier3d::na::Isometry3;
use tesaki::kinematics::{ElbowSetpoint, PosePoint};
use tesaki::teleop::{Follower, FollowerSettings, FollowerState, Instant, MasterSample};

pub use self::trace::{Trace, displacements};
use super::ScenarioError;
use super::arm::ArmTrial;
use super::common::T;
use crate::operator::{
    ElbowMotion, ElbowSensor, ElbowSensorValues, Link, LinkValues, MasterArm, MasterArmValues, MasterPose,
    OperatorHandMotion, Packet,
};
use crate::plant::isometry;

/// True pose of the tool.
pub fn tool_pose(arm_trial: &ArmTrial<'_, '_>) -> Isometry3<f64> {
    let now = arm_trial.plant.tips().swap_remove(0);
    isometry(now.position, now.orientation)
}

/// The operator, with the devices and their links.
pub struct Operator {
    pub motion: OperatorHandMotion,
    pub elbow: ElbowMotion,
    master: MasterArm,
    sensor: ElbowSensor,
    hand_link: Link<MasterPose>,
    elbow_link: Link<f64>,
}

impl Operator {
    /// An operator whose hand is at `start`.
    pub fn new(
        motion: OperatorHandMotion,
        elbow: ElbowMotion,
        link: LinkValues,
        seed: u64,
        start: &Isometry3<f64>,
    ) -> Self {
        Self {
            motion,
            elbow,
            master: MasterArm::new(MasterArmValues::default(), start, seed),
            sensor: ElbowSensor::new(ElbowSensorValues::default(), seed),
            hand_link: Link::new(link, seed.wrapping_mul(2)),
            elbow_link: Link::new(link, seed.wrapping_mul(2).wrapping_add(1)),
        }
    }

    /// The packets that have arrived by a time [s] since the last call.
    fn receive(&mut self, time: f64) -> (Vec<Packet<MasterPose>>, Vec<Packet<f64>>) {
        for (sampled, pose) in self.master.run(&self.motion, time) {
            self.hand_link.send(sampled, pose);
        }
        for (sampled, tilt) in self.sensor.run(&self.elbow, time) {
            self.elbow_link.send(sampled, tilt);
        }
        (self.hand_link.receive(time).collect(), self.elbow_link.receive(time).collect())
    }
}

/// Computes the arm's set-points from the received packets.
pub enum Slave {
    /// Estimates the hand's motion and predicts it to the present.
    Predicted(Follower, Box<FollowerState>),
    /// Takes the last sample as the equilibrium position of the spring.
    Sample(PosePoint, ElbowSetpoint),
}

impl Slave {
    /// Predicts, from `target` on.
    pub fn predicted((target, elbow): (PosePoint, ElbowSetpoint)) -> Self {
        let follower = Follower::try_new(FollowerSettings::HUMAN).expect("its own settings are valid");
        let state = FollowerState::at(target.position, target.rotation, elbow.angle);
        Self::Predicted(follower, Box::new(state))
    }

    /// Takes samples, at `target` before the first.
    pub const fn sample((target, elbow): (PosePoint, ElbowSetpoint)) -> Self {
        Self::Sample(target, elbow)
    }

    /// Takes what has arrived by a time [s].
    fn receive(&mut self, time: f64, operator: &mut Operator) {
        let (poses, tilts) = operator.receive(time);
        poses.iter().for_each(|pose| self.add_pose(time, pose));
        tilts.iter().for_each(|tilt| self.add_elbow(time, tilt));
    }

    fn add_pose(&mut self, time: f64, pose: &Packet<MasterPose>) {
        let MasterPose { position, orientation } = pose.message;
        let (position, rotation) = (position.map(|x| x as f32), orientation.map(|x| x as f32));
        match self {
            Self::Predicted(follower, state) => {
                let sample = MasterSample { time: instant(pose.time), position, rotation };
                // A sample that was overtaken is refused, and not needed.
                let _ = follower.add_sample(state, instant(time), &sample);
            }
            Self::Sample(target, _) => (target.position, target.rotation) = (position, rotation),
        }
    }

    fn add_elbow(&mut self, time: f64, tilt: &Packet<f64>) {
        let angle = tilt.message as f32;
        match self {
            Self::Predicted(follower, state) => {
                let _ = follower.add_elbow_sample(state, instant(time), instant(tilt.time), angle);
            }
            Self::Sample(_, elbow) => elbow.angle = angle,
        }
    }

    /// Opens or closes the clutch, which only a slave that predicts has.
    fn clutch(&mut self, time: f64, closed: bool) {
        if let Self::Predicted(follower, state) = self {
            if closed {
                follower.close_clutch(state, instant(time)).expect("samples arrive all the time");
            } else {
                follower.open_clutch(state);
            }
        }
    }

    /// The set-points of a tick.
    fn tick(&mut self, time: f64) -> (PosePoint, ElbowSetpoint) {
        match self {
            Self::Predicted(follower, state) => follower.tick(state, instant(time)),
            Self::Sample(target, elbow) => (*target, *elbow),
        }
    }
}

/// The operator leads the arm for `duration` [s] with the set-points of `slave`; its clutch opens or closes
/// at the times of `clutch` [s]. `observe` sees the time and each set-point of the tool.
pub fn lead(
    arm_trial: &mut ArmTrial<'_, '_>,
    slave: &mut Slave,
    operator: &mut Operator,
    duration: f64,
    clutch: &[(f64, bool)],
    mut observe: impl FnMut(&Operator, f64, &PosePoint),
) -> Result<(), ScenarioError> {
    let tick = |time: f64| (time / T).round() as usize;
    for number in 0..tick(duration) {
        let time = number as f64 * T;
        slave.receive(time, operator);
        for &(_, closed) in clutch.iter().filter(|(at, _)| tick(*at) == number) {
            slave.clutch(time, closed);
        }
        let (point, elbow) = slave.tick(time);
        observe(operator, time, &point);
        arm_trial.follow(point, elbow)?;
    }
    Ok(())
}

#[expect(clippy::cast_sign_loss, reason = "no time is negative")]
fn instant(time: f64) -> Instant {
    Instant((1e6 * time).round() as u32)
}
