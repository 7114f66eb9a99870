use heapless::Vec;

use super::joint::JointState;
use super::lease::Admitted;
use super::tip::TipState;
use super::transfer::Committed;
use super::{Node, Robot};
use crate::arm::{ArmSettings, ArmState, ElbowPoint, ForceSource, PosePoint};
use crate::control::{Actuation, JointPoint, ServoMode};
use crate::kinematics::{FingerError, TipPoint};
use crate::manipulation::{FINGERS, GraspCommand, GraspPlan, HandState, ObjectControl};
use crate::model::{MAX_CHAINS, MAX_JOINTS, Reaction};
use crate::protocol::{
    BoardStatus, Fault, FaultCause, Item, Mode, NodeStatus, Refusal, Reply, ReplyFrame, Request,
    RequestFrame, SCHEMA_KEY, SetPoint, Status, Task,
};

impl Node {
    /// Answers one request. A refused request changes nothing. `board` is what the board knows of itself.
    pub fn handle(&mut self, frame: &RequestFrame, board: &BoardStatus) -> ReplyFrame {
        self.state.records = self.state.records.wrapping_add(1);
        self.state.lease.notice(frame.client, frame.sequence, self.state.tick);
        let reply = self.answer(frame, board).unwrap_or_else(Reply::Refused);
        ReplyFrame { client: frame.client, sequence: frame.sequence, tick: self.state.tick, reply }
    }

    fn answer(&mut self, frame: &RequestFrame, board: &BoardStatus) -> Result<Reply, Refusal> {
        let client = frame.client;
        let index = self.state.records;
        match &frame.request {
            Request::Hello { schema } => {
                self.state.agree(client, *schema == SCHEMA_KEY);
                return Ok(Reply::Hello { schema: SCHEMA_KEY, identity: board.identity });
            }
            // Whoever it is and whatever they speak: these only make the machine safer.
            Request::Disarm => self.disarm(),
            Request::Stop => self.stop(),
            _ if !self.state.agrees(client) => {
                return Err(Refusal::SchemaMismatch { board: SCHEMA_KEY, firmware: board.identity.firmware });
            }
            Request::TakeCommand { by_force } => {
                let armed = matches!(self.state.mode, Mode::Armed(_));
                self.state.lease.take(client, frame.sequence, *by_force, armed, self.state.tick)?;
            }
            Request::ReadStatus => return Ok(Reply::Status(self.status(board))),
            Request::ReadFaults => {
                self.state.faults_read = self.state.faults.total;
                return Ok(Reply::Faults(self.state.faults.clone()));
            }
            Request::ReadGrasp => return Ok(Reply::Grasp(self.grasp())),
            Request::ReadArm => return self.tool().map(Reply::Arm).ok_or(Refusal::NotAnArm),
            Request::SetRate { stream, every } => {
                if let Some(rate) = self.state.rates.get_mut(*stream as usize) {
                    *rate = *every;
                }
            }
            Request::Export(Item::Model) => {
                let robot = self.robot.loaded().ok_or(Refusal::NoModel)?;
                return Ok(self.export.begin(robot.model(), index));
            }
            Request::Export(Item::State) => return Ok(self.export.begin(&self.state, index)),
            Request::ReadExport { offset } => return self.export.chunk(*offset),
            // Spelled out, so that the compiler asks where a new request belongs.
            Request::ModelBegin { .. }
            | Request::ModelChunk { .. }
            | Request::ModelCommit
            | Request::Home { .. }
            | Request::Arm { .. }
            | Request::SetPoint(_)
            | Request::ClearFaults { .. }
            | Request::ReleaseCommand
            | Request::Tare
            | Request::Grasp(_)
            | Request::Impedance(_) => {
                if let Admitted::Repeated(result) = self.state.lease.admit(client, frame.sequence)? {
                    return result.map(|()| Reply::Done);
                }
                let result = self.command(&frame.request);
                self.state.lease.remember(frame.sequence, result);
                result?;
            }
        }
        Ok(Reply::Done)
    }

    /// Carries out what only the commander may ask for.
    fn command(&mut self, request: &Request) -> Result<(), Refusal> {
        match request {
            Request::ModelBegin { length, checksum } => {
                self.require_disarmed()?;
                self.transfer.begin(*length, *checksum)
            }
            Request::ModelChunk { offset, data } => {
                self.require_disarmed()?;
                self.transfer.chunk(*offset, data)
            }
            Request::ModelCommit => self.use_model(),
            Request::Home { positions } => self.home(positions),
            Request::Arm { task } => self.arm(*task),
            Request::SetPoint(set_point) => self.set_point(set_point),
            Request::ClearFaults { total } => self.clear_faults(*total),
            Request::Tare => self.tare(),
            Request::Grasp(command) => self.grasp_command(command),
            Request::Impedance(settings) => self.behave(settings),
            Request::ReleaseCommand => {
                if let Mode::Armed(_) = self.state.mode {
                    return Err(Refusal::WrongMode(self.state.mode));
                }
                self.state.lease.release();
                Ok(())
            }
            _ => Ok(()),
        }
    }

    fn use_model(&mut self) -> Result<(), Refusal> {
        self.require_disarmed()?;
        let Committed { checksum, same_encoders } = self.transfer.commit(&mut self.robot)?;
        self.model_checksum = checksum;
        for (index, (config, state)) in self.robot.joints.iter().zip(&mut self.state.joints).enumerate() {
            *state = state.configured(config, same_encoders >> index & 1 != 0);
        }
        self.state.tips = [TipState::new(); MAX_CHAINS];
        self.state.arm = ArmState::NONE;
        self.state.alarm = None;
        self.state.sensed = false;
        Ok(())
    }

    fn clear_faults(&mut self, total: u32) -> Result<(), Refusal> {
        if total != self.state.faults.total || self.state.faults_read != total {
            return Err(Refusal::FaultsUnread { total: self.state.faults.total });
        }
        if self.state.mode == Mode::Fault {
            self.state.mode = Mode::Disarmed;
        }
        Ok(())
    }

    fn tare(&mut self) -> Result<(), Refusal> {
        let robot = self.robot.loaded().ok_or(Refusal::NoModel)?;
        let observed = self.state.mode == Mode::Armed(Task::Impedance) && self.state.arm.tare();
        if robot.force_sensors == 0 && !observed {
            return Err(Refusal::NoForceSensor);
        }
        if !self.state.sensed {
            return Err(Refusal::NoSensors);
        }
        for (chain, state) in robot.model().chains.iter().zip(&mut self.state.tips) {
            if chain.force_sensor.is_some() {
                state.take_tare();
            }
        }
        Ok(())
    }

    /// Outputs off. A fault stays until it was read and cleared.
    fn disarm(&mut self) {
        self.state.reaction = Reaction::Off;
        if self.state.mode != Mode::Fault {
            self.state.mode = Mode::Disarmed;
        }
    }

    fn stop(&mut self) {
        self.fail(Fault {
            cause: FaultCause::Stop,
            joint: None,
            value: 0.0,
            limit: 0.0,
            tick: self.state.tick,
        });
    }

    fn require_disarmed(&self) -> Result<(), Refusal> {
        match self.state.mode {
            Mode::Disarmed => Ok(()),
            mode => Err(Refusal::WrongMode(mode)),
        }
    }

    fn home(&mut self, positions: &[f32]) -> Result<(), Refusal> {
        self.require_disarmed()?;
        let robot = robot_with(&self.robot, positions.len())?;
        for (index, (config, &position)) in (0..).zip(robot.joints.iter().zip(positions)) {
            config.check_position(index, position)?;
        }
        if !self.state.sensed {
            return Err(Refusal::NoSensors);
        }
        for ((config, state), &position) in robot.joints.iter().zip(&mut self.state.joints).zip(positions) {
            state.home(config, position);
        }
        Ok(())
    }

    fn arm(&mut self, task: Task) -> Result<(), Refusal> {
        self.require_disarmed()?;
        let robot = self.robot.loaded().ok_or(Refusal::NoModel)?;
        if !self.state.sensed {
            return Err(Refusal::NoSensors);
        }
        let states = self.state.joints.iter();
        if let Some((joint, _)) =
            (0..).zip(robot.joints.iter().zip(states)).find(|(_, (_, state))| !state.is_homed())
        {
            return Err(Refusal::NotHomed { joint });
        }
        if let Some(fault) = self.state.alarm {
            return Err(Refusal::Unsafe(fault));
        }
        match task {
            Task::JointServo(mode) => self.state.servo_mode = mode,
            Task::Grasp => {
                if robot.hand().is_none() {
                    return Err(Refusal::NotAHand);
                }
                if let Some(chain) = robot.untared(&self.state.tips) {
                    return Err(Refusal::NotTared { chain });
                }
                let mut angles = [[0.0; 3]; FINGERS];
                let joints = angles.iter_mut().flatten().zip(&self.state.joints);
                joints.for_each(|(angle, joint)| *angle = joint.position);
                self.state.hand = HandState::at(angles);
                self.state.servo_mode = ServoMode::Observer;
            }
            Task::Impedance => {
                let arm = robot.arm().ok_or(Refusal::NotAnArm)?;
                if !self.state.arm.observes_force()
                    && let Some(chain) = robot.untared(&self.state.tips)
                {
                    return Err(Refusal::NotTared { chain });
                }
                let angles = self.state.arm_sense().angles;
                self.state.arm.begin(&arm, &angles).map_err(Refusal::Arm)?;
                self.state.servo_mode = ServoMode::Observer;
            }
        }
        self.state.drive = Actuation::Servo;
        for state in &mut self.state.joints {
            state.hold_still();
        }
        self.state.streaming = false;
        self.state.silence = 0;
        self.state.mode = Mode::Armed(task);
        Ok(())
    }

    fn set_point(&mut self, set_point: &SetPoint) -> Result<(), Refusal> {
        match (self.state.mode, set_point) {
            (Mode::Armed(_), SetPoint::Keep) | (Mode::Armed(Task::Impedance), SetPoint::Pose { .. }) => {}
            (mode @ Mode::Armed(Task::JointServo(_)), SetPoint::Pose { .. }) => {
                return Err(Refusal::WrongMode(mode));
            }
            (Mode::Armed(Task::JointServo(_)), _) => {}
            (mode, _) => return Err(Refusal::WrongMode(mode)),
        }
        match set_point {
            SetPoint::Goal { positions } => {
                let robot = robot_with(&self.robot, positions.len())?;
                for (index, (config, &position)) in (0..).zip(robot.joints.iter().zip(positions)) {
                    config.check_position(index, position)?;
                }
                for (state, &position) in self.state.joints.iter_mut().zip(positions) {
                    (state.goal, state.feedforward) = (position, 0.0);
                }
                self.state.streaming = false;
            }
            SetPoint::Stream { points } => self.stream(points)?,
            SetPoint::Reach { tips } => self.stream(&self.joint_points(tips)?)?,
            SetPoint::Keep => {}
            SetPoint::Pose { point, elbow } => self.aim(point, elbow)?,
            SetPoint::Guide { points, torques } => {
                let robot = robot_with(&self.robot, torques.len())?;
                for (index, (config, &torque)) in (0..).zip(robot.joints.iter().zip(torques)) {
                    JointState::check_torque(config, index, torque)?;
                }
                self.stream(points)?;
                for (state, &torque) in self.state.joints.iter_mut().zip(torques) {
                    state.feedforward = torque;
                }
            }
        }
        self.state.silence = 0;
        Ok(())
    }

    /// What the hand is to do next.
    fn grasp_command(&mut self, command: &GraspCommand) -> Result<(), Refusal> {
        let Mode::Armed(Task::Grasp) = self.state.mode else {
            return Err(Refusal::WrongMode(self.state.mode));
        };
        let hand = self.robot.hand().ok_or(Refusal::NotAHand)?;
        self.state.hand.command(&hand, command).map_err(Refusal::Unable)?;
        if let GraspCommand::Grasp(GraspPlan { control: ObjectControl::Differential(mode), .. }) = command {
            self.state.servo_mode = *mode;
        }
        self.state.silence = 0;
        Ok(())
    }

    /// How the arm is to behave.
    fn behave(&mut self, settings: &ArmSettings) -> Result<(), Refusal> {
        let (Mode::Disarmed | Mode::Armed(Task::Impedance)) = self.state.mode else {
            return Err(Refusal::WrongMode(self.state.mode));
        };
        let arm = self.robot.arm().ok_or(Refusal::NotAnArm)?;
        if settings.force == ForceSource::Sensor && self.robot.force_sensors == 0 {
            return Err(Refusal::NoForceSensor);
        }
        if self.state.mode != Mode::Disarmed && self.state.arm.changes_source(settings) {
            return Err(Refusal::WrongMode(self.state.mode));
        }
        self.state.arm.configure(&arm, settings).map_err(Refusal::Settings)?;
        self.state.silence = 0;
        Ok(())
    }

    /// Where the arm's tool is to be.
    fn aim(&mut self, point: &PosePoint, elbow: &ElbowPoint) -> Result<(), Refusal> {
        let arm = self.robot.arm().ok_or(Refusal::NotAnArm)?;
        self.state.arm.aim(&arm, point, elbow).map_err(Refusal::Arm)
    }

    fn stream(&mut self, points: &[JointPoint]) -> Result<(), Refusal> {
        let robot = robot_with(&self.robot, points.len())?;
        let states = self.state.joints.iter();
        for (index, ((config, state), point)) in (0..).zip(robot.joints.iter().zip(states).zip(points)) {
            config.check_point(index, point, &state.reference)?;
        }
        for (state, &point) in self.state.joints.iter_mut().zip(points) {
            (state.streamed, state.feedforward) = (point, 0.0);
        }
        self.state.streaming = true;
        Ok(())
    }

    /// What the joints have to do for the tips.
    fn joint_points(&self, tips: &[TipPoint]) -> Result<Vec<JointPoint, MAX_JOINTS>, Refusal> {
        let robot = self.robot.loaded().ok_or(Refusal::NoModel)?;
        let expected = robot.chains.len();
        if tips.len() != expected {
            return Err(Refusal::TipCount { got: count(tips.len()), expected: count(expected) });
        }
        let mut points = Vec::new();
        for (chain, ((shape, finger), tip)) in (0..).zip(robot.chains.iter().zip(tips)) {
            let finger = finger.as_ref().ok_or(Refusal::FingerShapeError { chain })?;
            let first = points.len();
            let mut near = [0.0; 3];
            let states = self.state.joints.iter().skip(first);
            near.iter_mut().zip(states).for_each(|(near, state)| *near = state.reference.position);
            let angles = finger.nearest(&tip.position.into(), &near).map_err(|error| match error {
                FingerError::NotFinite => Refusal::TipNotFinite { chain },
                FingerError::OutOfReach { nearest } => Refusal::OutOfReach { chain, nearest: nearest.into() },
                FingerError::OutsideLimits { joint, value, lower, upper } => {
                    Refusal::OutsideLimits { joint: count(first) + joint, value, lower, upper }
                }
            })?;
            let (velocities, accelerations) =
                shape.posture(&angles).joint_motion(tip).ok_or(Refusal::Singular { chain })?;
            for ((position, velocity), acceleration) in angles.into_iter().zip(velocities).zip(accelerations)
            {
                // Cannot fail: there are no more joints than places.
                let _ = points.push(JointPoint { position, velocity, acceleration });
            }
        }
        Ok(points)
    }

    /// The state of node and board.
    pub fn status(&self, board: &BoardStatus) -> Status {
        let (mut model, mut homed) = (heapless::String::new(), 0);
        if let Some(robot) = self.robot.loaded() {
            model = robot.model().name.clone();
            for (index, (_, state)) in robot.joints.iter().zip(&self.state.joints).enumerate() {
                homed |= u16::from(state.is_homed()) << index;
            }
        }
        let node = NodeStatus {
            mode: self.state.mode,
            model,
            model_checksum: self.model_checksum,
            homed,
            faults: self.state.faults.total,
            faults_read: self.state.faults_read == self.state.faults.total,
            commander: self.state.lease.commander(),
            tick: self.state.tick,
            supply: f32::from(self.state.supply) / 1000.0,
        };
        Status { node, board: board.clone() }
    }
}

/// The robot, if a list of `got` values fits its joints.
fn robot_with(robot: &Robot, got: usize) -> Result<&Robot, Refusal> {
    let robot = robot.loaded().ok_or(Refusal::NoModel)?;
    let expected = robot.joints.len();
    if got == expected {
        return Ok(robot);
    }
    Err(Refusal::JointCount { got: count(got), expected: count(expected) })
}

#[expect(clippy::cast_possible_truncation, reason = "lists and robots have at most 16 joints")]
const fn count(joints: usize) -> u8 {
    joints as u8
}
