//! A grasp trial: commands to the hand and the log of what happens.

use rapier3d::na::Vector3;
use tesaki::protocol::{Mode, Refusal, Request, Stream};
use tesaki::task::TaskConfig;
use tesaki::task::grasping::{GraspCommand, Phase};
use tesaki_supervisor::hand::FingerBoard;
use tesaki_supervisor::trajectory::minimum_jerk;
use tesaki_supervisor::{Board, BoardError};

use super::rig::{GraspRig, GraspedObject};
use super::{GraspEstimates, GraspLog, GraspSample, LIFT};
use crate::controller::{Controller, Watched};
use crate::motion::Transform;
use crate::plant::{ObjectValues, Plant, unit_quaternion};
use crate::scenario::common::{T, home, introduce};
use crate::scenario::{ScenarioError, Setting};

/// Ticks between two messages to the controller, which stops after ten ticks without one.
const MESSAGE_INTERVAL: usize = 5;
/// Time from homing to the tare, for the first readings of the force sensors [s].
pub(super) const REST: f64 = 1.0;
/// Time limit from the command to grasp until the object is held [s].
const MAX_GRASP_TIME: f64 = 20.0;
/// Time of each motion of an object [s].
pub const MOVE: f64 = 1.0;

/// A commanded motion of the object: displacement [m] and rotation vector [rad].
#[derive(Clone, Copy)]
struct ObjectTrajectory {
    from: [Vector3<f64>; 2],
    to: [Vector3<f64>; 2],
    begin: f64,
    duration: f64,
}

impl ObjectTrajectory {
    fn at(&self, time: f64) -> [Vector3<f64>; 2] {
        let [fraction, ..] = minimum_jerk((time - self.begin) / self.duration);
        [0, 1].map(|part| self.from[part] + (self.to[part] - self.from[part]) * fraction)
    }
}

/// A trial with one object, from the open hand to switching off.
///
/// When the object is lost, the log ends and the remaining commands have no effect.
pub struct GraspTrial<'a, 'b> {
    controller: &'a mut Watched<'b>,
    rig: &'a mut GraspRig,
    progress: &'a dyn Fn(f64),
    duration: f64,
    pub plant: Plant,
    pub log: GraspLog,
    enabled: bool,
    phase: Phase,
    estimates: GraspEstimates,
    /// Whether the force sensors are recorded.
    records_forces: bool,
    trajectory: ObjectTrajectory,
    note: Option<String>,
    object: ObjectValues,
}

impl<'a, 'b> GraspTrial<'a, 'b> {
    /// Homes, tares and grasps; returns when the object is held.
    pub fn begin(
        setting: &'a mut Setting<'_, 'b>,
        rig: &'a mut GraspRig,
        held: &GraspedObject<'_>,
    ) -> Result<Self, ScenarioError> {
        let (plan, plant) = rig.set_up(held)?;
        let (_, object) = rig.placed(held)?;
        rig.motion.object(&object, true);
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
            estimates: GraspEstimates::UNKNOWN,
            records_forces: held.records_forces,
            trajectory: ObjectTrajectory { from: zero, to: zero, begin: 0.0, duration: MOVE },
            note: Some(held.label.to_owned()),
            object,
        };
        introduce(grasp_trial.controller, &grasp_trial.rig.robot.model)?;
        if held.records_forces {
            grasp_trial.controller.set_rate(Stream::Tips, 1)?;
        }
        grasp_trial.tick()?;
        home(grasp_trial.controller, &grasp_trial.plant)?;
        grasp_trial.wait(REST)?;
        grasp_trial.controller.tare()?;
        grasp_trial.controller.enable(TaskConfig::Grasping(()))?;
        (grasp_trial.enabled, grasp_trial.log.samples) = (true, Vec::new());
        grasp_trial.send("grasp", GraspCommand::Grasp(plan))?;
        grasp_trial.wait_for_phase(Phase::Hold, MAX_GRASP_TIME)?;
        if grasp_trial.log.lost.is_none() {
            grasp_trial.log.held = grasp_trial.log.now();
        }
        Ok(grasp_trial)
    }

    /// Homes, tares and grasps, and then removes the support.
    pub fn without_support(
        setting: &'a mut Setting<'_, 'b>,
        rig: &'a mut GraspRig,
        held: &GraspedObject<'_>,
    ) -> Result<Self, ScenarioError> {
        let mut grasp_trial = Self::begin(setting, rig, held)?;
        grasp_trial.note("the support is removed");
        grasp_trial.plant.remove_support();
        grasp_trial.rig.motion.object(&grasp_trial.object, false);
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
        if self.records_forces {
            self.read_forces()?;
        }
        if self.enabled && self.log.samples.len().is_multiple_of(MESSAGE_INTERVAL) {
            match self.controller.keep() {
                Err(BoardError::Refused { refusal: Refusal::WrongMode(_), .. }) => return self.record_loss(),
                other => other?,
            }
            self.read_telemetry()?;
        }
        (self.progress)((f64::from(sequence) * T / self.duration).min(1.0));
        Ok(())
    }

    /// Adds the current state to the log and the recording.
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
        self.rig.motion.forces(&self.plant);
        let time = self.log.now();
        self.log.samples.push(GraspSample {
            time,
            object,
            contacts: self.plant.contacts(),
            joints: truth.positions,
            estimates: self.estimates,
            target: self.trajectory.at(time),
        });
    }

    /// Reads the tared force sensors, as the controller has them.
    fn read_forces(&mut self) -> Result<(), ScenarioError> {
        if let Some(tips) = self.controller.listen()?.tips {
            for (sensed, tip) in self.estimates.sensed_forces.iter_mut().zip(&tips.tips) {
                // The sensor measures the force on the tip; the object has the reaction.
                *sensed = -Vector3::from(tip.force).map(f64::from);
            }
        }
        Ok(())
    }

    /// Reads the controller's telemetry.
    fn read_telemetry(&mut self) -> Result<(), ScenarioError> {
        let grasp = self.controller.read_grasp()?;
        let estimates = &mut self.estimates;
        estimates.target_forces = grasp.target_forces.map(|force| Vector3::from(force).map(f64::from));
        estimates.position = Vector3::from(grasp.position).map(f64::from);
        estimates.orientation = unit_quaternion(grasp.orientation.map(f64::from));
        let [x, y, z, ..] = grasp.load.map(f64::from);
        estimates.load = Vector3::new(x, y, z);
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

    /// Simulates until the hand is in `phase`. If it is not within `max` [s], the object counts as lost.
    pub fn wait_for_phase(&mut self, phase: Phase, max: f64) -> Result<(), ScenarioError> {
        let end = self.log.now() + max;
        // The first telemetry after a command shows its phase.
        self.wait(MESSAGE_INTERVAL as f64 * T)?;
        while self.log.lost.is_none() && self.phase != phase {
            let is_over = self.log.now() > end || (phase != Phase::Ready && self.phase == Phase::Ready);
            if is_over {
                let Self { phase: current, .. } = self;
                let time = self.log.now();
                self.log.lost = Some(format!("at {time:.2} s: the hand {current}, not as commanded"));
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
                self.log.lost = Some(format!("at {:.2} s: {note} refused: {refusal}", self.log.now()));
                Ok(())
            }
            other => Ok(other?),
        }
    }

    /// Commands a displacement [m] and a rotation vector [rad] of the object relative to where it was
    /// grasped. Returns when the motion begins [s].
    pub fn move_object(&mut self, translation: [f64; 3], rotation: [f64; 3]) -> Result<f64, ScenarioError> {
        self.move_object_within(MOVE, translation, rotation)
    }

    /// The same, within `duration` [s].
    pub fn move_object_within(
        &mut self,
        duration: f64,
        translation: [f64; 3],
        rotation: [f64; 3],
    ) -> Result<f64, ScenarioError> {
        let begin = self.log.now();
        self.trajectory = ObjectTrajectory {
            from: self.trajectory.at(begin),
            to: [translation.into(), rotation.into()],
            begin,
            duration,
        };
        let single = |values: [f64; 3]| values.map(|value| value as f32);
        let (translation, rotation) = (single(translation), single(rotation));
        self.send("move", GraspCommand::Move { translation, rotation, duration: duration as f32 })?;
        Ok(begin)
    }

    /// Lifts the object off its support and waits until it is at rest. Returns its displacement [m].
    pub fn lift(&mut self) -> Result<[f64; 3], ScenarioError> {
        let gravity = Vector3::from(self.rig.values.gravity);
        let up = (gravity * (-LIFT / gravity.norm())).into();
        self.move_object(up, [0.0; 3])?;
        self.wait(MOVE + 1.0)?;
        Ok(up)
    }

    /// Makes the target of the object unknown from now on.
    pub fn clear_target(&mut self) {
        let unknown = [Vector3::repeat(f64::NAN); 2];
        self.trajectory = ObjectTrajectory { from: unknown, to: unknown, begin: 0.0, duration: MOVE };
    }

    /// Writes a line into the recording.
    pub fn note(&mut self, text: &str) {
        self.note = Some(text.to_owned());
    }

    /// Switches the hand off and returns the log.
    pub fn end(self) -> Result<GraspLog, ScenarioError> {
        if self.records_forces {
            self.controller.set_rate(Stream::Tips, 0)?;
        }
        self.controller.disable()?;
        Ok(self.log)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::controller::Native;

    /// Without yielding, this machine presses the box onto its support with 1 N, and the sum of the fingers'
    /// forces grows to 4.8 N.
    #[test]
    fn an_object_at_rest_on_its_support_is_not_gripped_harder_and_harder() {
        let robot = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/hand3"));
        let mut native = Native::default();
        let mut controller = Watched::new(&mut native, false);
        let mut setting = Setting::plain(robot, &mut controller, 5, 0.0);
        let mut rig = GraspRig::load(&setting).unwrap();
        let held = GraspedObject::new("box", "box");
        let mut grasp_trial = GraspTrial::begin(&mut setting, &mut rig, &held).unwrap();
        grasp_trial.wait(40.0).unwrap();
        let log = grasp_trial.end().unwrap();
        assert!(log.lost.is_none(), "{:?}", log.lost);
        let grip = |sample: &GraspSample| (0..3).map(|finger| sample.force(finger).norm()).sum();
        let largest = |from: f64, to: f64| log.largest(&(log.held + from..log.held + to), grip);
        let later = largest(20.0, 40.0);
        assert!(later < 2.0, "{later} N");
    }
}
