use super::force_sensor::{ForceSensorState, TARE_DELAY};
use super::joint::Joints;
use super::lease::Admitted;
use super::optional::Optional;
use super::state::Sensing;
use super::transfer::Committed;
use super::{Node, STATE_KEY};
use crate::fault::{Fault, FaultCause};
use crate::math::abs;
use crate::model::{MAX_CHAINS, ModelError, Reaction, RobotModel};
use crate::protocol::{
    BoardStatus, Item, Mode, NodeStatus, Refusal, Reply, ReplyFrame, Request, RequestFrame, SCHEMA_KEY,
    Status,
};
use crate::robot::{Actuation, Measured, Robot};
use crate::task::{Tareable, TaskCommand, TaskConfig, TaskState};

/// Share of its velocity limit above which a joint must not be enabled: the servo, whose reference starts at
/// rest, would overshoot.
const ENABLE_SPEED: f32 = 0.2;

impl Node {
    /// Answers one request. A refused request changes nothing. `board` is the board's part of the status.
    ///
    /// A client sends [`Hello`](Request::Hello) first, then [`TakeCommand`](Request::TakeCommand), the model
    /// ([`ModelBegin`](Request::ModelBegin), [`ModelChunk`](Request::ModelChunk),
    /// [`ModelCommit`](Request::ModelCommit)), and after the next tick [`Enable`](Request::Enable) and
    /// [`Task`](Request::Task) commands, or [`Keep`](Request::Keep), within the model's command timeout. A
    /// firmware with its own model is such a client, too: the log of its requests then replays.
    pub fn handle(&mut self, frame: &RequestFrame, board: &BoardStatus) -> ReplyFrame {
        self.handle_on(frame, board, &mut |_| Ok(()))
    }

    /// Answers one request on a board that cannot serve every robot: `configure` is called with a valid model
    /// before the node takes it over, and can refuse it. A replay does not know the board and takes that
    /// model: what the recorded node then did with an older model is reported as a difference.
    pub fn handle_on(
        &mut self,
        frame: &RequestFrame,
        board: &BoardStatus,
        configure: &mut dyn FnMut(&RobotModel) -> Result<(), ModelError>,
    ) -> ReplyFrame {
        self.state.records = self.state.records.wrapping_add(1);
        self.state.register(frame.client, frame.sequence);
        let reply = self.answer(frame, board, configure).unwrap_or_else(Reply::Refused);
        ReplyFrame { client: frame.client, sequence: frame.sequence, tick: self.state.tick, reply }
    }

    // Every request needs an answer: Clippy reports a wildcard, the compiler a missing request.
    #[deny(clippy::wildcard_enum_match_arm)]
    fn answer(
        &mut self,
        frame: &RequestFrame,
        board: &BoardStatus,
        configure: &mut dyn FnMut(&RobotModel) -> Result<(), ModelError>,
    ) -> Result<Reply, Refusal> {
        let client = frame.client;
        match &frame.request {
            Request::Hello { schema } => {
                self.state.set_accepted(client, frame.sequence, *schema == SCHEMA_KEY);
                self.state.overrule(client, frame.sequence);
                return Ok(Reply::Hello { schema: SCHEMA_KEY, identity: board.identity });
            }
            // From any client, also of another version: these requests only make the machine safer.
            Request::Disable => {
                self.state.overrule(client, frame.sequence);
                self.disable();
            }
            Request::Stop => {
                self.state.overrule(client, frame.sequence);
                self.stop();
            }
            _ if !self.state.is_accepted(client) => {
                return Err(Refusal::SchemaMismatch { board: SCHEMA_KEY, firmware: board.identity.firmware });
            }
            Request::TakeCommand { by_force } => {
                self.state.take(client, frame.sequence, *by_force)?;
            }
            Request::SetRate { stream, every } => {
                if let Some(rate) = self.state.rates.get_mut(*stream as usize) {
                    *rate = *every;
                }
            }
            Request::ReadStatus => return Ok(Reply::Status(self.status(board))),
            Request::ReadFaults => {
                self.state.faults_read = self.state.faults.total;
                return Ok(Reply::Faults(self.state.faults.clone()));
            }
            Request::ReadTask => return self.task_report().map(Reply::Task).ok_or(Refusal::NoTask),
            Request::Export(item) => return self.export(*item),
            Request::ReadExport { offset } => return self.export.chunk(*offset),
            Request::ModelBegin { .. }
            | Request::ModelChunk { .. }
            | Request::ModelCommit
            | Request::Home { .. }
            | Request::Tare
            | Request::Enable(_)
            | Request::Task(_)
            | Request::Keep
            | Request::ClearFaults { .. }
            | Request::ReleaseCommand => {
                match self.state.lease.admit(client, frame.sequence) {
                    Ok(Admitted::New) => {
                        let result = self.command(&frame.request, configure);
                        self.state.lease.remember(frame.sequence, result);
                        result?;
                    }
                    Ok(Admitted::Repeated(result)) => result?,
                    Err(refusal) => {
                        // A refused request must not be executed when it is repeated after the client has
                        // taken command.
                        self.state.outdate(client, frame.sequence);
                        return Err(refusal);
                    }
                }
            }
        }
        Ok(Reply::Done)
    }

    fn export(&mut self, item: Item) -> Result<Reply, Refusal> {
        let index = self.state.records;
        match item {
            Item::Model => {
                let robot = self.robot.loaded().ok_or(Refusal::NoModel)?;
                self.export.begin(robot.model(), index, SCHEMA_KEY)
            }
            Item::State => self.export.begin(&self.state, index, STATE_KEY),
        }
    }

    /// Executes a request of the commander. Inlined to save a stack frame: taking over a model is where the
    /// stack is deepest.
    #[inline(always)]
    #[deny(clippy::wildcard_enum_match_arm)]
    fn command(
        &mut self,
        request: &Request,
        configure: &mut dyn FnMut(&RobotModel) -> Result<(), ModelError>,
    ) -> Result<(), Refusal> {
        match request {
            Request::ModelBegin { length, checksum } => {
                self.require_disabled()?;
                self.transfer.begin(*length, *checksum)
            }
            Request::ModelChunk { offset, data } => {
                self.require_disabled()?;
                self.transfer.chunk(*offset, data)
            }
            Request::ModelCommit => self.commit_model(configure),
            Request::Home { positions } => self.home(positions),
            Request::Tare => self.tare(),
            Request::Enable(config) => self.enable(config),
            Request::Task(command) => self.task_command(command),
            Request::Keep => self.keep(),
            Request::ClearFaults { total } => self.clear_faults(*total),
            Request::ReleaseCommand => {
                if let Mode::Enabled(_) = self.state.mode {
                    return Err(Refusal::WrongMode(self.state.mode));
                }
                self.state.lease.release();
                Ok(())
            }
            // Answered before.
            Request::Hello { .. }
            | Request::Disable
            | Request::Stop
            | Request::TakeCommand { .. }
            | Request::SetRate { .. }
            | Request::ReadStatus
            | Request::ReadFaults
            | Request::ReadTask
            | Request::Export(_)
            | Request::ReadExport { .. } => Ok(()),
        }
    }

    fn commit_model(
        &mut self,
        configure: &mut dyn FnMut(&RobotModel) -> Result<(), ModelError>,
    ) -> Result<(), Refusal> {
        self.require_disabled()?;
        let Committed { checksum, same_encoders, names } =
            self.transfer.commit(&mut self.robot, configure)?;
        self.model_checksum = checksum;
        if core::mem::replace(&mut self.state.fault_joints, names) != names {
            // Joint indices of earlier faults refer to the old model.
            self.state.faults.faults.iter_mut().for_each(|fault| fault.joint = None);
        }
        let velocities = core::mem::replace(&mut self.state.measured, Measured::NONE).velocities;
        for (index, (config, state)) in self.robot.joints().iter().zip(&mut self.state.joints).enumerate() {
            let same = same_encoders >> index & 1 != 0;
            *state = state.configured(config, same);
            if same
                && let (Some(velocity), Some(known)) =
                    (self.state.measured.velocities.get_mut(index), velocities.get(index))
            {
                *velocity = *known;
            }
        }
        self.state.force_sensors = [ForceSensorState::new(); MAX_CHAINS];
        self.postures.clear();
        self.state.task.clone_from(&TaskState::NONE);
        self.state.has_task = false;
        self.state.alarm = Optional::None;
        self.state.sensing = Sensing::None;
        Ok(())
    }

    fn clear_faults(&mut self, total: u32) -> Result<(), Refusal> {
        if total != self.state.faults.total || self.state.faults_read != total {
            return Err(Refusal::FaultsUnread { total: self.state.faults.total });
        }
        if self.state.mode == Mode::Fault {
            self.state.mode = Mode::Disabled;
        }
        Ok(())
    }

    fn tare(&mut self) -> Result<(), Refusal> {
        let robot = self.robot.loaded().ok_or(Refusal::NoModel)?;
        let Tareable { sensors, estimate } = match self.state.mode {
            Mode::Disabled => Tareable { sensors: true, estimate: false },
            Mode::Enabled(_) => self.state.task.tareable(),
            Mode::Fault => Tareable { sensors: false, estimate: false },
        };
        if !sensors && !estimate {
            return Err(Refusal::WrongMode(self.state.mode));
        }
        let has_sensor = robot.force_sensors() != 0;
        if !has_sensor && self.state.mode == Mode::Disabled {
            return Err(Refusal::NoForceSensor);
        }
        self.require_homed(robot)?;
        if self.state.sensing != Sensing::Read || has_sensor && self.state.tare_delay > 0 {
            return Err(Refusal::NoSensors);
        }
        let mut states = robot.model().chains.iter().zip(&self.state.force_sensors);
        if states.any(|(chain, state)| chain.force_sensor.is_some_and(|config| !state.has_read(&config))) {
            // The alarm is this fault, or one that masks it.
            return Err(match self.state.alarm {
                Optional::Some(fault) => Refusal::Unsafe(fault),
                Optional::None => Refusal::NoSensors,
            });
        }
        if !has_sensor && !estimate {
            return Err(Refusal::NoForceSensor);
        }
        if estimate {
            self.state.task.tare_estimate();
        }
        let states = robot.model().chains.iter().zip(&mut self.state.force_sensors);
        for (index, (chain, state)) in states.enumerate().filter(|_| sensors) {
            if chain.force_sensor.is_some() {
                state.tare();
                self.state.measured.tared |= 1 << index;
            }
        }
        Ok(())
    }

    /// Switches the outputs off. A fault remains until it is read and cleared.
    fn disable(&mut self) {
        self.state.reaction = Reaction::Off;
        if self.state.mode != Mode::Fault {
            self.state.mode = Mode::Disabled;
        }
    }

    /// Stops the robot. A fault even when the outputs are off or another fault is active; otherwise a client
    /// that is about to clear and enable would miss the stop.
    fn stop(&mut self) {
        let tick = self.state.tick;
        let fault = Fault { cause: FaultCause::Stop, joint: None, value: 0.0, limit: 0.0, tick };
        match self.state.mode {
            Mode::Disabled if self.robot.loaded().is_none() => {}
            Mode::Disabled => {
                self.state.faults.record(fault);
                (self.state.mode, self.state.reaction) = (Mode::Fault, Reaction::Off);
            }
            Mode::Enabled(_) => self.fail(fault),
            Mode::Fault => self.stop_again(fault),
        }
    }

    /// Records a stop during a reaction, which continues unchanged.
    fn stop_again(&mut self, stop: Fault) {
        let faults = &mut self.state.faults;
        if faults.faults.last().is_some_and(|last| last.cause == FaultCause::Stop) {
            if self.state.faults_read != faults.total {
                // No client has read the earlier stop yet.
                return;
            }
            // Replaces it: repeated stops never push the cause of a fault out of the log.
            faults.faults.pop();
        }
        faults.record(stop);
    }

    fn require_disabled(&self) -> Result<(), Refusal> {
        match self.state.mode {
            Mode::Disabled => Ok(()),
            mode => Err(Refusal::WrongMode(mode)),
        }
    }

    fn require_homed(&self, robot: &Robot) -> Result<(), Refusal> {
        let mut states = (0..).zip(self.state.joints.iter().take(robot.joints().len()));
        let unknown = states.find(|(_, state)| !state.is_homed());
        unknown.map_or(Ok(()), |(joint, _)| Err(Refusal::NotHomed { joint }))
    }

    fn home(&mut self, positions: &[f32]) -> Result<(), Refusal> {
        self.require_disabled()?;
        let robot = self.robot.loaded().ok_or(Refusal::NoModel)?;
        robot.check_count(positions.len())?;
        for (index, (config, &position)) in (0..).zip(robot.joints().iter().zip(positions)) {
            config.check_position(index, position)?;
        }
        if self.state.sensing != Sensing::Read {
            return Err(Refusal::NoSensors);
        }
        for (mut joint, &position) in Joints::of(robot, &mut self.state).each().zip(positions) {
            // An absolute encoder knows its zero from the model.
            if joint.config.zero.is_none() {
                joint.home(position);
            }
        }
        self.postures.clear();
        // Homing changes the postures, with which the weight on the force sensors was compensated.
        self.state.measured.tared = 0;
        self.state.tare_delay = TARE_DELAY;
        Ok(())
    }

    fn enable(&mut self, config: &TaskConfig) -> Result<(), Refusal> {
        self.require_disabled()?;
        let robot = self.robot.loaded().ok_or(Refusal::NoModel)?;
        if self.state.sensing != Sensing::Read {
            return Err(Refusal::NoSensors);
        }
        self.require_homed(robot)?;
        if let Optional::Some(fault) = self.state.alarm {
            return Err(Refusal::Unsafe(fault));
        }
        if let Some(fault) = self.find_motion(robot) {
            return Err(Refusal::Unsafe(fault));
        }
        let tick = self.state.tick;
        for (index, joint) in (0..).zip(Joints::of(robot, &mut self.state).each()) {
            if let Some(found) = joint.check_still_dead() {
                return Err(Refusal::Unsafe(found.at(Some(index), tick)));
            }
        }
        TaskState::check(robot, &self.state.measured, config).map_err(Refusal::Task)?;
        self.state.targets.actuation = Actuation::Servo;
        Joints::of(robot, &mut self.state).each().for_each(|mut joint| joint.begin());
        let (task, io) = self.task_and_io();
        task.begin(io, config);
        self.state.halting = false;
        self.state.has_task = true;
        self.state.silence = 0;
        self.state.mode = Mode::Enabled(config.kind());
        Ok(())
    }

    /// The first joint that moves too fast to be enabled: every task begins at rest.
    fn find_motion(&self, robot: &Robot) -> Option<Fault> {
        let tick = self.state.tick;
        (0..).zip(robot.joints().iter().zip(&self.state.measured.velocities)).find_map(
            |(joint, (config, &value))| {
                let limit = ENABLE_SPEED * config.limits.velocity;
                let fault =
                    Fault { cause: FaultCause::VelocityLimit, joint: Some(joint), value, limit, tick };
                (value.is_nan() || abs(value) > limit).then_some(fault)
            },
        )
    }

    fn task_command(&mut self, command: &TaskCommand) -> Result<(), Refusal> {
        let Mode::Enabled(running) = self.state.mode else {
            return Err(Refusal::WrongMode(self.state.mode));
        };
        let (task, io) = self.task_and_io();
        if !task.command(io, command).map_err(Refusal::Task)? {
            return Err(Refusal::OtherTask(running));
        }
        self.state.silence = 0;
        Ok(())
    }

    fn keep(&mut self) -> Result<(), Refusal> {
        let Mode::Enabled(_) = self.state.mode else {
            return Err(Refusal::WrongMode(self.state.mode));
        };
        self.state.silence = 0;
        Ok(())
    }

    /// Status of node and board.
    pub fn status(&self, board: &BoardStatus) -> Status {
        let (mut model, mut homed) = (heapless::String::new(), 0);
        if let Some(robot) = self.robot.loaded() {
            model = robot.model().name.clone();
            for (index, state) in self.state.joints.iter().take(robot.joints().len()).enumerate() {
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
