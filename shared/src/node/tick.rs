use core::ops::Range;

use super::Node;
use super::joint::{JointState, Joints};
use super::optional::Optional;
use crate::TICK;
use crate::control::{JointPoint, STALL_SPEED, ServoMode};
use crate::fault::{Fault, FaultCause};
use crate::math::abs;
use crate::model::{MAX_CHAIN_JOINTS, MAX_JOINTS, Reaction};
use crate::protocol::{ActuatorFrame, Mode, SensorFrame};
use crate::robot::{Actuation, JointSetpoint, Motion, Robot};
use crate::task::TaskFault;

/// A damped robot counts as driven by its torques above the kinetic energy of its mass at this speed [m/s].
/// Below it the robot may be coming to rest in a contact, unless the torques have added more than this share
/// of the energy that is tolerated in a stop.
const DRIVEN_SPEED: f32 = 0.2;
const DRIVEN_SHARE: f32 = 0.5;

/// Ticks at the start of a hold in which the braking joints drive each other by their inertia.
const BRAKING_TICKS: u32 = 3;

/// Ticks for which the servos adapt their disturbance estimates during a stop.
const SETTLING_TICKS: u32 = 30;

impl Node {
    /// Runs one control period: reads the sensors, checks for faults, runs the task, computes the torques.
    ///
    /// Bounded in time, without allocation and without panics.
    pub fn tick(&mut self, sensors: &SensorFrame) -> ActuatorFrame {
        self.state.records = self.state.records.wrapping_add(2);
        let alarm = self.read_sensors(sensors);
        self.state.alarm = Optional::from(alarm);
        if let Some(fault) = alarm {
            self.fail(fault);
        }
        // A stop that begins in this tick has no reference yet.
        let begins = self.state.mode == Mode::Fault && self.state.reacting_since == sensors.sequence;
        if !begins && let Some(fault) = self.check_control() {
            self.fail(fault);
        }
        if let Some(fault) = self.tick_task() {
            self.fail(fault);
        }
        self.compute_torques();
        let mut frame = ActuatorFrame { sequence: sensors.sequence, ..ActuatorFrame::default() };
        if !self.write_torques(&mut frame) {
            if let Some(fault) = self.find_not_finite() {
                self.fail(fault);
            }
            self.state.joints.iter_mut().for_each(JointState::forget);
            self.release();
            self.write_torques(&mut frame);
        }
        frame.enabled = matches!(self.state.mode, Mode::Enabled(_)) || self.is_stopping();
        frame
    }

    /// Writes the torques of the joints into the frame. Returns whether all of them are finite.
    #[inline]
    fn write_torques(&self, frame: &mut ActuatorFrame) -> bool {
        frame.torques.clear();
        let mut sum = 0.0;
        for joint in self.state.joints.iter().take(self.robot.joints().len()) {
            // 0 · ∞ and 0 · NaN are NaN, and so is the sum.
            sum += 0.0 * joint.torque;
            // Cannot fail: capacity for every joint. (`collect` would add a panic.)
            let _ = frame.torques.push(joint.torque);
        }
        sum == 0.0
    }

    /// Runs the task while it is enabled or brings the robot to rest. Returns the fault that stops it.
    fn tick_task(&mut self) -> Option<Fault> {
        if !self.ticks_task() {
            return None;
        }
        let (task, io) = self.task_and_io();
        let TaskFault { cause, joint, value, limit } = task.tick(io).err()?;
        Some(Fault { cause, joint, value, limit, tick: self.state.tick })
    }

    /// Computes the torques.
    fn compute_torques(&mut self) {
        let reaction = match self.state.mode {
            Mode::Disabled => Reaction::Off,
            Mode::Enabled(_) => Reaction::Hold,
            Mode::Fault => self.state.reaction,
        };
        match (reaction, self.robot.loaded()) {
            (Reaction::Off, _) | (_, None) => self.release(),
            (Reaction::Damp, Some(_)) => self.damp(),
            (Reaction::Hold, Some(_)) => match self.state.targets.actuation {
                Actuation::Acceleration { friction } => self.accelerate(friction),
                actuation if self.state.mode == Mode::Fault => self.hold(actuation),
                actuation => self.servo(actuation, true),
            },
        }
    }

    /// Computes the torques that hold the joints after a fault.
    #[cold]
    #[inline(never)]
    fn hold(&mut self, actuation: Actuation) {
        let mut before = [0.0; MAX_JOINTS];
        before.iter_mut().zip(&self.state.joints).for_each(|(before, joint)| *before = joint.torque);
        self.servo(actuation, !self.stays());
        let begins = self.state.tick.wrapping_sub(self.state.reacting_since) < BRAKING_TICKS;
        let halting = self.state.halting;
        let mut all = Joints::of(&self.robot, &mut self.state);
        let weight = all.weight();
        for (mut joint, (before, weight)) in all.each().zip(before.into_iter().zip(weight)) {
            if halting {
                joint.state.grips = joint.target.feedforward != 0.0;
            }
            joint.bound_hold(before, weight, begins);
        }
    }

    /// Whether the stop is complete and the joints hold their position. If the servos kept integrating, they
    /// would press ever harder against an obstacle, or because of a dead encoder.
    fn stays(&self) -> bool {
        self.state.tick.wrapping_sub(self.state.reacting_since) >= SETTLING_TICKS
            && self.references().iter().all(|reference| abs(reference.velocity) < STALL_SPEED)
    }

    /// The references of the robot's joints.
    fn references(&self) -> &[JointPoint] {
        self.state.references.get(..self.robot.joints().len()).unwrap_or_default()
    }

    /// Computes the torques of [`Actuation::Servo`] and [`Actuation::Torque`]. The servos adapt their
    /// disturbance estimates only if they `learn`.
    #[inline(never)]
    fn servo(&mut self, actuation: Actuation, learn: bool) {
        let robot = &self.robot;
        let mode = self.state.targets.servo_mode;
        let mut all = Joints::of(robot, &mut self.state);
        let mut all_advanced = true;
        all.each().for_each(|mut joint| all_advanced &= joint.advance());
        if !all_advanced {
            advance_far_or_braking(&mut all);
        }
        let coupled = robot.has_mimics().then(|| coupled_torques(robot, &mut all));
        let [mut q, mut qd, mut qdd, mut torques] = [[0.0; MAX_CHAIN_JOINTS]; 4];
        for config in robot.chains() {
            let (chain, joints) = (&config.chain, config.joints());
            if let Some(coupled) = &coupled {
                torques = of_joints(coupled, &joints);
            } else {
                let values = q.iter_mut().zip(&mut qd).zip(&mut qdd);
                let references = all.references.get(joints.clone()).unwrap_or_default();
                for (((q, qd), qdd), reference) in values.zip(references) {
                    (*q, *qd, *qdd) = (reference.position, reference.velocity, reference.acceleration);
                }
                chain.inverse_dynamics(robot.gravity(), &q, &qd, &qdd, &mut torques);
            }
            let of_chain = all.range(joints.start, joints.len()).zip(&torques);
            if let Actuation::Torque { damping, compensated } = actuation {
                of_chain.for_each(|(mut joint, &torque)| joint.push(damping, compensated, torque));
            } else if mode == ServoMode::BarePid {
                of_chain.for_each(|(mut joint, &torque)| joint.control_bare(torque, learn));
            } else {
                of_chain.for_each(|(mut joint, &torque)| joint.control(mode, torque, learn));
            }
        }
    }

    /// Computes damping torques, with gravity compensation at the measured angles.
    #[inline(never)]
    fn damp(&mut self) {
        let Some(robot) = self.robot.loaded() else { return };
        let begins = !core::mem::replace(&mut self.state.damped, true);
        let drove = self.state.reacts_to == FaultCause::EnergyGained;
        let has_driven = self.state.stop_energy.work > DRIVEN_SHARE * self.tolerated_energy();
        let mut all = Joints::of(robot, &mut self.state);
        let [mut power, mut energy, mut gain] = [0.0; 3];
        for joint in all.each() {
            let (velocity, inertia) = (*joint.velocity, joint.config.inertia);
            power += joint.target.feedforward * joint.state.change;
            energy += 0.5 * inertia * velocity * velocity;
            gain += inertia * velocity * (joint.state.change - velocity * TICK);
        }
        let moves = energy > 0.5 * robot.mass() * DRIVEN_SPEED * DRIVEN_SPEED;
        // Torques that press the robot against a wall do positive work while the wall slows it down: they do
        // not drive it.
        let driving = if begins { drove } else { power > 0.0 && gain > 0.0 && (moves || has_driven) };
        let weight = all.weight();
        all.each().zip(weight).for_each(|(mut joint, weight)| joint.damp(weight, begins, driving));
    }

    /// Computes the torques of [`Actuation::Acceleration`] by the inverse dynamics of each chain. Only for
    /// robots without mimic joints: the tasks that use it refuse others.
    #[inline(never)]
    fn accelerate(&mut self, friction: f32) {
        let robot = &self.robot;
        let mut all = Joints::of(robot, &mut self.state);
        let [mut mean, mut added] = [[0.0; MAX_JOINTS]; 2];
        let [mut q, mut qd, mut qdd, mut torques] = [[0.0; MAX_CHAIN_JOINTS]; 4];
        for config in robot.chains() {
            let (chain, joints) = (&config.chain, config.joints());
            let values = q.iter_mut().zip(&mut qd).zip(&mut qdd);
            for (((q, qd), qdd), joint) in values.zip(all.range(joints.start, joints.len())) {
                if let JointSetpoint::Point(point) = joint.target.setpoint {
                    *joint.reference = point;
                }
                let reference = *joint.reference;
                (*q, *qd, *qdd) = (reference.position, reference.velocity, reference.acceleration);
            }
            chain.inverse_dynamics(robot.gravity(), &q, &qd, &qdd, &mut torques);
            let results = mean.iter_mut().zip(&mut added).skip(joints.start);
            let of_chain = all.range(joints.start, joints.len()).zip(&torques);
            for ((mut joint, torque), (mean, added)) in of_chain.zip(results) {
                [*mean, *added] = joint.accelerate(friction, *torque);
            }
        }
        self.state.task.applied(&self.robot, &mean, &added);
    }

    /// Sets all torques to 0.
    fn release(&mut self) {
        self.state.joints.iter_mut().for_each(JointState::release);
        self.state.targets.joints.iter_mut().for_each(|target| target.feedforward = 0.0);
    }
}

/// Computes the torques for the references on a robot with mimic joints, by inverse dynamics [N·m].
#[cold]
#[inline(never)]
fn coupled_torques(robot: &Robot, joints: &mut Joints<'_>) -> [f32; MAX_JOINTS] {
    let mut motion = Motion::default();
    for (motion, reference) in motion.iter_mut().zip(joints.references.iter()) {
        *motion = [reference.position, reference.velocity, reference.acceleration];
    }
    robot.coupled_dynamics(&motion)
}

/// The torques of the joints of one chain.
#[cold]
fn of_joints(torques: &[f32; MAX_JOINTS], joints: &Range<usize>) -> [f32; MAX_CHAIN_JOINTS] {
    let mut own = [0.0; MAX_CHAIN_JOINTS];
    let all = torques.get(joints.clone()).unwrap_or_default();
    own.iter_mut().zip(all).for_each(|(own, torque)| *own = *torque);
    own
}

/// Advances the joints that have far goals or brake.
#[cold]
#[inline(never)]
fn advance_far_or_braking(joints: &mut Joints<'_>) {
    joints.each().for_each(|mut joint| joint.advance_far_or_braking());
}
