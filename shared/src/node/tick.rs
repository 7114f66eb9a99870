use super::{Node, Robot, State};
use crate::TICK;
use crate::arm::ArmError;
use crate::control::{Actuation, JointPoint};
use crate::manipulation::{FINGERS, FingerSense, Loss};
use crate::math::abs;
use crate::model::{MAX_CHAIN_JOINTS, MAX_JOINTS, Reaction};
use crate::protocol::{ActuatorFrame, Fault, FaultCause, Mode, SensorFrame, Task};

impl Node {
    /// One control period: reads `sensors`, looks for faults, computes the torques.
    ///
    /// Bounded, without allocation, and without a way to panic.
    pub fn tick(&mut self, sensors: &SensorFrame) -> ActuatorFrame {
        self.state.records = self.state.records.wrapping_add(2);
        let found = self.observe(sensors);
        self.state.alarm = found;
        if let Some(fault) = found {
            self.fail(fault);
        }
        if let Some(fault) = self.watch() {
            self.fail(fault);
        }
        if let Mode::Armed(task @ (Task::Grasp | Task::Impedance)) = self.state.mode
            && let Some(fault) = self.perform(task)
        {
            self.fail(fault);
        }
        self.act();
        if let Some(fault) = self.find_not_finite() {
            self.fail(fault);
            self.release();
        }
        let enabled = match self.state.mode {
            Mode::Disarmed => false,
            Mode::Armed(_) => true,
            Mode::Fault => self.state.reaction != Reaction::Off,
        };
        ActuatorFrame {
            sequence: sensors.sequence,
            enabled,
            torques: self.for_each_joint(|joint| joint.torque),
        }
    }

    /// Takes over the sensors and says what is wrong with them.
    fn observe(&mut self, sensors: &SensorFrame) -> Option<Fault> {
        let tick = sensors.sequence;
        let last = core::mem::replace(&mut self.state.tick, tick);
        self.state.supply = sensors.supply;
        let robot = self.robot.loaded()?;
        let fault = |cause, joint, value, limit| Some(Fault { cause, joint, value, limit, tick });
        let expected = robot.joints.len();
        for got in [sensors.encoders.len(), sensors.currents.len()] {
            if got != expected {
                #[expect(clippy::cast_precision_loss, reason = "at most 16")]
                return fault(FaultCause::SensorCount, None, got as f32, expected as f32);
            }
        }
        let (got, expected) = (sensors.forces.len(), robot.force_sensors);
        if got != expected {
            #[expect(clippy::cast_precision_loss, reason = "at most 6")]
            return fault(FaultCause::SensorCount, None, got as f32, expected as f32);
        }
        let sensed = core::mem::replace(&mut self.state.sensed, true);
        let readings = robot.joints.iter().zip(&mut self.state.joints).zip(&sensors.encoders);
        if !sensed {
            readings.for_each(|((config, state), &count)| state.first_read(config, count));
            feel(robot, &mut self.state, sensors);
            return None;
        }
        let mut of_joint = None;
        for (index, (((config, state), &count), &current)) in (0..).zip(readings.zip(&sensors.currents)) {
            state.read(config, count);
            if of_joint.is_none() {
                of_joint = state.inspect(config, current).map(|found| (index, found));
            }
        }

        let of_tip = if expected == 0 { None } else { feel(robot, &mut self.state, sensors) };
        let safety = &robot.model().safety;
        let supply = f32::from(sensors.supply) / 1000.0;
        if sensors.flags.emergency_stop() {
            return fault(FaultCause::EmergencyStop, None, 1.0, 0.0);
        }
        if supply < safety.supply_min {
            return fault(FaultCause::SupplyLow, None, supply, safety.supply_min);
        }
        if supply > safety.supply_max {
            return fault(FaultCause::SupplyHigh, None, supply, safety.supply_max);
        }
        if let Some((index, (cause, value, limit))) = of_joint {
            return fault(cause, Some(index), value, limit);
        }
        if let Some((index, (cause, value, limit))) = of_tip {
            return fault(cause, Some(index), value, limit);
        }
        let elapsed = tick.wrapping_sub(last);
        if elapsed != 1 {
            #[expect(clippy::cast_precision_loss, reason = "a figure for people")]
            return fault(FaultCause::LateTick, None, elapsed.cast_signed() as f32, 1.0);
        }
        None
    }

    /// What is wrong with the control so far, while armed.
    fn watch(&mut self) -> Option<Fault> {
        let (Mode::Armed(_), Some(robot)) = (self.state.mode, self.robot.loaded()) else {
            return None;
        };
        let tick = self.state.tick;
        for (index, (config, state)) in (0..).zip(robot.joints.iter().zip(&self.state.joints)) {
            if let Some((cause, value, limit)) = state.supervise(config) {
                return Some(Fault { cause, joint: Some(index), value, limit, tick });
            }
        }
        self.state.silence = self.state.silence.saturating_add(1);
        #[expect(clippy::cast_precision_loss, reason = "exact for hours")]
        let silence = self.state.silence as f32 * TICK;
        let limit = robot.model().safety.command_timeout;
        if silence > limit + 0.5 * TICK {
            return Some(Fault {
                cause: FaultCause::CommandTimeout,
                joint: None,
                value: silence,
                limit,
                tick,
            });
        }
        None
    }

    /// What the joints are to do for a task beyond their own; the fault, if it cannot go on.
    #[inline(never)]
    fn perform(&mut self, task: Task) -> Option<Fault> {
        match task {
            Task::JointServo(_) => None,
            Task::Grasp => self.manipulate(),
            Task::Impedance => self.comply(),
        }
    }

    /// What the joints are to do for an object in the hand; the fault, if it was lost.
    #[inline(never)]
    fn manipulate(&mut self) -> Option<Fault> {
        let hand = self.robot.hand()?;
        let State { joints, tips, hand: state, drive, .. } = &mut self.state;
        let mut senses = [FingerSense::REST; FINGERS];
        for ((sense, joints), tip) in senses.iter_mut().zip(joints.chunks(3)).zip(&*tips) {
            let values = sense.angles.iter_mut().zip(&mut sense.velocities).zip(joints);
            values.for_each(|((angle, velocity), joint)| {
                (*angle, *velocity) = (joint.position, joint.velocity)
            });
            sense.force = tip.force.map(|force| -force);
        }
        match state.tick(&hand, &senses) {
            Ok(command) => {
                let of_fingers = command.points.iter().flatten().zip(command.torques.iter().flatten());
                for (joint, (point, torque)) in joints.iter_mut().zip(of_fingers) {
                    (joint.streamed, joint.feedforward) = (*point, *torque);
                }
                if command.drive == Actuation::Servo && (*drive != Actuation::Servo || state.forgets()) {
                    // The servos were not at work, or what they have learnt is the touch: they begin anew.
                    joints.iter_mut().for_each(|joint| joint.servo.restart(joint.position));
                }
                (*drive, self.state.streaming) = (command.drive, true);
                None
            }
            Err(loss) => {
                let (cause, finger, value, limit) = match loss {
                    Loss::Contact { finger, force, limit } => {
                        (FaultCause::ObjectLost, Some(finger), force, limit)
                    }
                    Loss::Deformed { distance, limit } | Loss::Moved { distance, limit } => {
                        (FaultCause::ObjectMoved, None, distance, limit)
                    }
                    Loss::NoFrame => (FaultCause::ObjectMoved, None, f32::INFINITY, 0.0),
                };
                let joint = finger.map(|finger| 3 * finger + 2);
                Some(Fault { cause, joint, value, limit, tick: self.state.tick })
            }
        }
    }

    /// What the joints are to do for the tool of an arm; the fault, if that is too far from where it should be.
    #[inline(never)]
    fn comply(&mut self) -> Option<Fault> {
        let arm = self.robot.arm()?;
        let sense = self.state.arm_sense();
        let State { joints, arm: state, drive, tick, .. } = &mut self.state;
        match state.tick(&arm, &sense) {
            Ok(command) => {
                let of_joints = command.points.iter().zip(&command.feedback).zip(&command.torques);
                for (joint, ((point, feedback), torque)) in joints.iter_mut().zip(of_joints) {
                    joint.reference = JointPoint { acceleration: point.acceleration + feedback, ..*point };
                    joint.feedforward = *torque;
                }
                *drive = Actuation::Acceleration { friction: command.friction };
                None
            }
            Err(error) => {
                let (cause, value, limit) = match error {
                    ArmError::Distance { value, limit } => (FaultCause::ToolAway, value, limit),
                    ArmError::Turn { value, limit } => (FaultCause::ToolTurned, value, limit),
                    _ => (FaultCause::NotFinite, f32::NAN, 0.0),
                };
                Some(Fault { cause, joint: None, value, limit, tick: *tick })
            }
        }
    }

    /// Computes the torques.
    fn act(&mut self) {
        let reaction = match self.state.mode {
            Mode::Disarmed => Reaction::Off,
            Mode::Armed(_) => Reaction::Hold,
            Mode::Fault => self.state.reaction,
        };
        match (reaction, self.robot.loaded()) {
            (Reaction::Off, _) | (_, None) => self.release(),
            (Reaction::Damp, Some(robot)) => {
                let damping = robot.model().safety.damping;
                for (config, state) in robot.joints.iter().zip(&mut self.state.joints) {
                    state.damp(config, damping);
                }
            }
            (Reaction::Hold, Some(robot)) => {
                if let Actuation::Acceleration { friction } = self.state.drive {
                    return accelerate(robot, &mut self.state, friction);
                }
                let joints = || robot.joints.iter();
                for (config, state) in joints().zip(&mut self.state.joints) {
                    state.advance(config, self.state.streaming);
                }
                let [mut q, mut qd, mut qdd, mut torques] = [[0.0; MAX_CHAIN_JOINTS]; 4];
                let mut first = 0;
                for (chain, _) in &robot.chains {
                    let states = self.state.joints.iter().skip(first);
                    for (((q, qd), qdd), state) in q.iter_mut().zip(&mut qd).zip(&mut qdd).zip(states) {
                        (*q, *qd, *qdd) = (
                            state.reference.position,
                            state.reference.velocity,
                            state.reference.acceleration,
                        );
                    }
                    chain.inverse_dynamics(&robot.gravity, &q, &qd, &qdd, &mut torques);
                    let states = self.state.joints.iter_mut().skip(first);
                    let all = joints().skip(first).zip(states).zip(torques).take(chain.len());
                    if let Actuation::Torque { damping, compensated } = self.state.drive {
                        for ((config, state), torque) in all {
                            state.push(config, damping, compensated, torque);
                        }
                    } else {
                        for ((config, state), torque) in all {
                            state.control(config, self.state.servo_mode, torque);
                        }
                    }
                    first += chain.len();
                }
            }
        }
    }

    fn release(&mut self) {
        self.state.joints.iter_mut().for_each(super::joint::JointState::release);
    }

    fn find_not_finite(&self) -> Option<Fault> {
        let (index, state) = (0..)
            .zip(self.state.joints.iter().take(self.robot.joints.len()))
            .find(|(_, joint)| !joint.torque.is_finite())?;
        let tick = self.state.tick;
        Some(Fault {
            cause: FaultCause::NotFinite,
            joint: Some(index),
            value: abs(state.torque),
            limit: 0.0,
            tick,
        })
    }
}

/// The torques that give the joints of an arm the accelerations of their references.
#[inline(never)]
fn accelerate(robot: &Robot, state: &mut State, friction: f32) {
    let Some(arm) = robot.arm() else { return };
    let [mut q, mut qd, mut qdd, mut torques, mut undone] = [[0.0; MAX_CHAIN_JOINTS]; 5];
    for (((q, qd), qdd), joint) in q.iter_mut().zip(&mut qd).zip(&mut qdd).zip(&state.joints) {
        let JointPoint { position, velocity, acceleration } = joint.reference;
        (*q, *qd, *qdd) = (position, velocity, acceleration);
    }
    arm.chain.inverse_dynamics(arm.gravity, &q, &qd, &qdd, &mut torques);
    let joints = robot.joints.iter().zip(&mut state.joints);
    for ((undone, torque), (config, joint)) in undone.iter_mut().zip(&mut torques).zip(joints) {
        [*undone, *torque] = joint.accelerate(config, friction, *torque);
    }
    state.arm.settle(&arm, &undone, &torques);
}

/// Reads the force sensors of the tips; says what is wrong with the first that is wrong: last joint of its chain, cause,
/// value, limit.
#[inline(never)]
fn feel(robot: &Robot, state: &mut State, sensors: &SensorFrame) -> Option<(u8, (FaultCause, f32, f32))> {
    let mut found = None;
    // What the sensor of an arm carries is also accelerated.
    let gravity = match state.mode {
        Mode::Armed(Task::Impedance) => robot.gravity - state.arm.acceleration(),
        _ => robot.gravity,
    };
    let (mut first, mut forces) = (0, sensors.forces.iter());
    let chains = robot.chains.iter().zip(&robot.model().chains).zip(&mut state.tips);
    for (((chain, _), model), tip) in chains {
        let start = first;
        first += chain.len();
        let Some(sensor) = &model.force_sensor else { continue };
        let Some(counts) = forces.next() else { break };
        let mut angles = [0.0; MAX_CHAIN_JOINTS];
        let joints = state.joints.iter().skip(start).take(chain.len());
        angles.iter_mut().zip(joints).for_each(|(angle, joint)| *angle = joint.position);
        let wrong = tip.read(sensor, counts, &chain.posture(&angles), &gravity);
        if found.is_none() {
            #[expect(clippy::cast_possible_truncation, reason = "at most 16 joints")]
            let last = first as u8 - 1;
            found = wrong.map(|wrong| (last, wrong));
        }
    }
    found
}

const _: () = assert!(MAX_JOINTS <= u8::MAX as usize);
