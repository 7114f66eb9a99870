use super::joint::JointState;
use super::{Node, Robot};
use crate::model::Reaction;
use crate::protocol::{
    BoardStatus, Fault, FaultCause, Mode, NodeStatus, Refusal, Reply, ReplyFrame, Request, RequestFrame,
    SCHEMA_KEY, SetPoint, Task,
};

impl Node {
    /// Answers one request. A refused request changes nothing. `board` is what the board knows of itself.
    pub fn handle(&mut self, frame: &RequestFrame, board: &BoardStatus) -> ReplyFrame {
        let reply = self.answer(&frame.request, board).unwrap_or_else(Reply::Refused);
        ReplyFrame { sequence: frame.sequence, tick: self.tick.unwrap_or(0), reply }
    }

    fn answer(&mut self, request: &Request, board: &BoardStatus) -> Result<Reply, Refusal> {
        match request {
            Request::Hello { schema } => {
                self.agreed = *schema == SCHEMA_KEY;
                return Ok(Reply::Hello { schema: SCHEMA_KEY, firmware: board.firmware });
            }
            // Whoever it is and whatever they speak: these only make the machine safer.
            Request::Disarm => self.disarm(),
            Request::Stop => self.stop(),
            _ if !self.agreed => return Err(Refusal::SchemaMismatch { board: SCHEMA_KEY }),
            Request::ModelBegin { length, checksum } => {
                self.require_disarmed()?;
                self.transfer.begin(*length, *checksum)?;
            }
            Request::ModelChunk { offset, data } => {
                self.require_disarmed()?;
                self.transfer.chunk(*offset, data)?;
            }
            Request::ModelCommit => {
                self.require_disarmed()?;
                self.model_checksum = self.transfer.commit(&mut self.robot)?;
                for (config, state) in self.robot.joints.iter().zip(&mut self.joints) {
                    *state = JointState::of(config);
                }
                self.alarm = None;
                self.tick = None;
            }
            Request::Home { positions } => self.home(positions)?,
            Request::Arm { task } => self.arm(*task)?,
            Request::SetPoint(set_point) => self.set_point(set_point)?,
            Request::ReadStatus => {
                return Ok(Reply::Status { node: self.status(), board: board.clone() });
            }
            Request::ReadFaults => return Ok(Reply::Faults(self.faults.clone())),
            Request::ClearFaults { total } => {
                if *total != self.faults.total {
                    return Err(Refusal::FaultsUnread { total: self.faults.total });
                }
                if self.mode == Mode::Fault {
                    self.mode = Mode::Disarmed;
                }
            }
            Request::SetTelemetry { every } => self.telemetry_every = *every,
        }
        Ok(Reply::Done)
    }

    /// Outputs off. A fault stays until it was read and cleared.
    fn disarm(&mut self) {
        self.reaction = Reaction::Off;
        if self.mode != Mode::Fault {
            self.mode = Mode::Disarmed;
        }
    }

    fn stop(&mut self) {
        self.fail(Fault {
            cause: FaultCause::Stop,
            joint: None,
            value: 0.0,
            limit: 0.0,
            tick: self.tick.unwrap_or(0),
        });
    }

    fn require_disarmed(&self) -> Result<(), Refusal> {
        match self.mode {
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
        if self.tick.is_none() {
            return Err(Refusal::NoSensors);
        }
        for ((config, state), &position) in robot.joints.iter().zip(&mut self.joints).zip(positions) {
            state.home(config, position);
        }
        Ok(())
    }

    fn arm(&mut self, task: Task) -> Result<(), Refusal> {
        self.require_disarmed()?;
        let robot = self.robot.loaded().ok_or(Refusal::NoModel)?;
        if self.tick.is_none() {
            return Err(Refusal::NoSensors);
        }
        let states = self.joints.iter();
        if let Some((joint, _)) =
            (0..).zip(robot.joints.iter().zip(states)).find(|(_, (_, state))| !state.is_homed())
        {
            return Err(Refusal::NotHomed { joint });
        }
        if let Some(fault) = self.alarm {
            return Err(Refusal::Unsafe(fault));
        }
        let Task::JointServo(mode) = task;
        self.servo_mode = mode;
        for state in &mut self.joints {
            state.hold_still();
        }
        self.streaming = false;
        self.silence = 0;
        self.mode = Mode::Armed(task);
        Ok(())
    }

    fn set_point(&mut self, set_point: &SetPoint) -> Result<(), Refusal> {
        let Mode::Armed(_) = self.mode else {
            return Err(Refusal::WrongMode(self.mode));
        };
        match set_point {
            SetPoint::Goal { positions } => {
                let robot = robot_with(&self.robot, positions.len())?;
                for (index, (config, &position)) in (0..).zip(robot.joints.iter().zip(positions)) {
                    config.check_position(index, position)?;
                }
                for (state, &position) in self.joints.iter_mut().zip(positions) {
                    state.goal = position;
                }
                self.streaming = false;
            }
            SetPoint::Stream { points } => {
                let robot = robot_with(&self.robot, points.len())?;
                let states = self.joints.iter();
                for (index, ((config, state), point)) in
                    (0..).zip(robot.joints.iter().zip(states).zip(points))
                {
                    config.check_point(index, point, &state.reference)?;
                }
                for (state, &point) in self.joints.iter_mut().zip(points) {
                    state.streamed = point;
                }
                self.streaming = true;
            }
        }
        self.silence = 0;
        Ok(())
    }

    fn status(&self) -> NodeStatus {
        let (mut model, mut homed) = (heapless::String::new(), 0);
        if let Some(robot) = self.robot.loaded() {
            model = robot.model().name.clone();
            for (index, (_, state)) in robot.joints.iter().zip(&self.joints).enumerate() {
                homed |= u16::from(state.is_homed()) << index;
            }
        }
        NodeStatus {
            mode: self.mode,
            model,
            model_checksum: self.model_checksum,
            homed,
            faults: self.faults.total,
        }
    }
}

/// The robot, if a list of `got` values fits its joints.
fn robot_with(robot: &Robot, got: usize) -> Result<&Robot, Refusal> {
    let robot = robot.loaded().ok_or(Refusal::NoModel)?;
    let expected = robot.joints.len();
    if got == expected {
        return Ok(robot);
    }
    #[expect(clippy::cast_possible_truncation, reason = "lists and robots have at most 16 joints")]
    Err(Refusal::JointCount { got: got as u8, expected: expected as u8 })
}
