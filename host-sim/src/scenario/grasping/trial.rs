//! A grasp trial: commands to the hand and the log of what happens.

use rapier3d::na::Vector3;
use tesaki::protocol::{Mode, Refusal, Request};
use tesaki::task::TaskConfig;
use tesaki::task::grasping::{GraspCommand, Phase};
use tesaki_supervisor::trajectory::minimum_jerk;
use tesaki_supervisor::{Board, BoardError};

use super::rig::{GraspRig, GraspedObject};
use super::{GraspLog, GraspSample, T, UP};
use crate::controller::{Controller, Watched};
use crate::motion::Transform;
use crate::plant::Plant;
use crate::scenario::common::introduce;
use crate::scenario::{ScenarioError, Setting};

/// Ticks from one message to the next: the controller gives up only after ten without.
const TALK_EVERY: usize = 5;
/// From homing to the tare, for the force sensors' first readings [s].
pub(super) const REST: f64 = 1.0;
/// Most time from the command to grasp until the object is held [s].
const GRASP_TIME: f64 = 20.0;
/// Time of each motion of an object [s].
pub const MOVE: f64 = 1.0;

/// A commanded motion of the object.
#[derive(Clone, Copy)]
struct ObjectPath {
    from: [Vector3<f64>; 2],
    to: [Vector3<f64>; 2],
    begin: f64,
}

impl ObjectPath {
    fn at(&self, time: f64) -> [Vector3<f64>; 2] {
        let [fraction, ..] = minimum_jerk((time - self.begin) / MOVE);
        [0, 1].map(|part| self.from[part] + (self.to[part] - self.from[part]) * fraction)
    }
}

/// One object, from the open hand to the end of what is done with it.
///
/// When the object is lost everything that follows is left out: the log ends there.
pub struct GraspTrial<'a, 'b> {
    controller: &'a mut Watched<'b>,
    rig: &'a mut GraspRig,
    progress: &'a dyn Fn(f64),
    duration: f64,
    pub plant: Plant,
    pub log: GraspLog,
    enabled: bool,
    phase: Phase,
    target_forces: [Vector3<f64>; 3],
    way: ObjectPath,
    note: Option<String>,
}

impl<'a, 'b> GraspTrial<'a, 'b> {
    /// Homes, tares and grasps; returns when the object is held.
    pub fn begin(
        setting: &'a mut Setting<'_, 'b>,
        rig: &'a mut GraspRig,
        held: &GraspedObject<'_>,
    ) -> Result<Self, ScenarioError> {
        let (plan, plant) = rig.set_up(held)?;
        let zero = [Vector3::zeros(); 2];
        let mut grasp_trial = Self {
            controller: &mut *setting.controller,
            rig,
            progress: setting.progress,
            duration: setting.duration,
            plant,
            log: GraspLog { held: f64::NAN, friction: f64::NAN, ..GraspLog::default() },
            enabled: false,
            phase: Phase::Ready,
            target_forces: [Vector3::repeat(f64::NAN); 3],
            way: ObjectPath { from: zero, to: zero, begin: 0.0 },
            note: Some(held.label.to_owned()),
        };
        introduce(grasp_trial.controller, &grasp_trial.rig.robot.model)?;
        grasp_trial.tick()?;
        let homed: Vec<f32> = grasp_trial.plant.homed_positions().iter().map(|&angle| angle as f32).collect();
        grasp_trial.controller.home(&homed)?;
        grasp_trial.wait(REST)?;
        grasp_trial.controller.tare()?;
        grasp_trial.controller.enable(TaskConfig::Grasping(()))?;
        (grasp_trial.enabled, grasp_trial.log.samples) = (true, Vec::new());
        grasp_trial.send("grasp", GraspCommand::Grasp(plan))?;
        grasp_trial.wait_for_phase(Phase::Hold, GRASP_TIME)?;
        if grasp_trial.log.lost.is_none() {
            grasp_trial.log.held = grasp_trial.log.now();
        }
        Ok(grasp_trial)
    }

    /// The same, and then what it stands on is taken away.
    pub fn without_support(
        setting: &'a mut Setting<'_, 'b>,
        rig: &'a mut GraspRig,
        held: &GraspedObject<'_>,
    ) -> Result<Self, ScenarioError> {
        let mut grasp_trial = Self::begin(setting, rig, held)?;
        grasp_trial.note("the support is taken away");
        grasp_trial.plant.remove_support();
        Ok(grasp_trial)
    }

    /// One control period.
    fn tick(&mut self) -> Result<(), ScenarioError> {
        if self.log.lost.is_some() {
            return Ok(());
        }
        self.record();
        let sequence = self.rig.motion.ticks();
        let actuators = self.controller.tick(&self.plant.sensors(sequence))?;
        self.plant.apply(&actuators)?;
        if self.enabled && self.log.samples.len().is_multiple_of(TALK_EVERY) {
            match self.controller.keep() {
                Err(BoardError::Refused { refusal: Refusal::WrongMode(_), .. }) => return self.record_loss(),
                other => other?,
            }
            self.read_telemetry()?;
        }
        (self.progress)((f64::from(sequence) * T / self.duration).min(1.0));
        Ok(())
    }

    /// Writes down what is so now.
    fn record(&mut self) {
        let truth = self.plant.truth();
        let Some(object) = self.plant.object() else { return };
        let motion = &mut self.rig.motion;
        motion.tick(&truth);
        if let Some(note) = self.note.take() {
            motion.note(note);
        }
        let (translation, rotation_xyzw) = (object.position, object.orientation);
        let parent = self.rig.base().to_owned();
        let frame = Transform { parent, child: "object".to_owned(), translation, rotation_xyzw };
        self.rig.motion.frame(frame);
        let time = self.log.now();
        self.log.samples.push(GraspSample {
            time,
            object,
            contacts: self.plant.contacts(),
            joints: truth.positions,
            target_forces: self.target_forces,
            target: self.way.at(time),
        });
    }

    /// Reads the controller's telemetry.
    fn read_telemetry(&mut self) -> Result<(), ScenarioError> {
        let grasp = self.controller.read_grasp()?;
        self.target_forces = grasp.target_forces.map(|force| Vector3::from(force).map(f64::from));
        self.log.friction = f64::from(grasp.friction);
        if grasp.phase != self.phase {
            self.phase = grasp.phase;
            self.log.phases.push((self.log.now(), grasp.phase));
            let failure = grasp.failure.map_or_else(String::new, |failure| format!(": {failure}"));
            self.note = Some(format!("the hand {}{failure}", grasp.phase));
        }
        Ok(())
    }

    /// Records the fault with which the controller stopped.
    fn record_loss(&mut self) -> Result<(), ScenarioError> {
        let faults = self.controller.faults()?;
        let model = &self.rig.robot.model;
        let reason =
            faults.faults.last().map_or_else(|| "unknown".to_owned(), |f| f.named(model).to_string());
        self.log.lost = Some(format!("at {:.2} s: {reason}", self.log.now()));
        self.controller.ask("clear the faults", Request::ClearFaults { total: faults.total })?;
        Ok(())
    }

    /// Simulates for a time [s].
    pub fn wait(&mut self, time: f64) -> Result<(), ScenarioError> {
        for _ in 0..(time / T).round() as usize {
            self.tick()?;
        }
        Ok(())
    }

    /// Lets time pass until the hand is in `phase`; if it is not within `max` [s], the object counts as lost.
    pub fn wait_for_phase(&mut self, phase: Phase, max: f64) -> Result<(), ScenarioError> {
        let end = self.log.now() + max;
        // A new command is seen in the first answer after it.
        self.wait(TALK_EVERY as f64 * T)?;
        while self.log.lost.is_none() && self.phase != phase {
            let over = self.log.now() > end || (phase != Phase::Ready && self.phase == Phase::Ready);
            if over {
                let Self { phase: now, .. } = self;
                self.log.lost = Some(format!("at {:.2} s: the hand {now} and not as asked", self.log.now()));
            }
            self.tick()?;
        }
        Ok(())
    }

    /// Sends a grasp command.
    pub fn send(&mut self, note: &str, command: GraspCommand) -> Result<(), ScenarioError> {
        if self.log.lost.is_some() {
            return Ok(());
        }
        self.note = Some(note.to_owned());
        match self.controller.grasp(command) {
            Err(BoardError::Refused { refusal: Refusal::WrongMode(Mode::Fault), .. }) => self.record_loss(),
            Err(BoardError::Refused { refusal: Refusal::Task(refusal), .. }) => {
                self.log.lost = Some(format!("at {:.2} s: asked to {note}: {refusal}", self.log.now()));
                Ok(())
            }
            other => Ok(other?),
        }
    }

    /// Has the object brought to where it is so far from where it was grasped [m, rad], and returns when this
    /// begins [s].
    pub fn move_object(&mut self, shift: [f64; 3], turn: [f64; 3]) -> Result<f64, ScenarioError> {
        let begin = self.log.now();
        self.way = ObjectPath { from: self.way.at(begin), to: [shift.into(), turn.into()], begin };
        let single = |values: [f64; 3]| values.map(|value| value as f32);
        let (translation, rotation) = (single(shift), single(turn));
        self.send("move", GraspCommand::Move { translation, rotation, duration: MOVE as f32 })?;
        Ok(begin)
    }

    /// Lifts the object off what it stands on and lets it come to rest; returns how far that is [m].
    pub fn lift(&mut self) -> Result<[f64; 3], ScenarioError> {
        let gravity = Vector3::from(self.rig.values.gravity);
        let up = (gravity * (-UP / gravity.norm())).into();
        self.move_object(up, [0.0; 3])?;
        self.wait(MOVE + 1.0)?;
        Ok(up)
    }

    /// Where it should be is not known from now on.
    pub fn forget_aim(&mut self) {
        let unknown = [Vector3::repeat(f64::NAN); 2];
        self.way = ObjectPath { from: unknown, to: unknown, begin: 0.0 };
    }

    /// Writes a line into the recording.
    pub fn note(&mut self, text: &str) {
        self.note = Some(text.to_owned());
    }

    /// Switches the hand off; what was recorded.
    pub fn end(self) -> Result<GraspLog, ScenarioError> {
        self.controller.disable()?;
        Ok(self.log)
    }
}
