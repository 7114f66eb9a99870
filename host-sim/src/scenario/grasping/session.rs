//! A hand that is told what to do with an object, tick by tick, and is watched.

use rapier3d::na::Vector3;
use tesaki::protocol::{Mode, Refusal, Request};
use tesaki::task::TaskConfig;
use tesaki::task::grasping::{GraspCommand, Phase};
use tesaki_supervisor::trajectory::minimum_jerk;
use tesaki_supervisor::{Board, BoardError};

use super::bench::{Bench, Held};
use super::{Log, Sample, T, UP};
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

/// A motion of the object that was asked for.
#[derive(Clone, Copy)]
struct Way {
    from: [Vector3<f64>; 2],
    to: [Vector3<f64>; 2],
    begin: f64,
}

impl Way {
    fn at(&self, time: f64) -> [Vector3<f64>; 2] {
        let [share, ..] = minimum_jerk((time - self.begin) / MOVE);
        [0, 1].map(|part| self.from[part] + (self.to[part] - self.from[part]) * share)
    }
}

/// One object, from the open hand to the end of what is done with it.
///
/// When the object is lost everything that follows is left out: the log ends there.
pub struct Session<'a, 'b> {
    controller: &'a mut Watched<'b>,
    bench: &'a mut Bench,
    progress: &'a dyn Fn(f64),
    duration: f64,
    pub plant: Plant,
    pub log: Log,
    armed: bool,
    phase: Phase,
    wanted: [Vector3<f64>; 3],
    way: Way,
    note: Option<String>,
}

impl<'a, 'b> Session<'a, 'b> {
    /// Homes, tares and grasps; returns when the object is held.
    pub fn begin(
        setting: &'a mut Setting<'_, 'b>,
        bench: &'a mut Bench,
        held: &Held<'_>,
    ) -> Result<Self, ScenarioError> {
        let (plan, plant) = bench.place(held)?;
        let zero = [Vector3::zeros(); 2];
        let mut session = Self {
            controller: &mut *setting.controller,
            bench,
            progress: setting.progress,
            duration: setting.duration,
            plant,
            log: Log { held: f64::NAN, friction: f64::NAN, ..Log::default() },
            armed: false,
            phase: Phase::Ready,
            wanted: [Vector3::repeat(f64::NAN); 3],
            way: Way { from: zero, to: zero, begin: 0.0 },
            note: Some(held.label.to_owned()),
        };
        introduce(session.controller, &session.bench.robot.model)?;
        session.tick()?;
        let homed: Vec<f32> = session.plant.homed_positions().iter().map(|&angle| angle as f32).collect();
        session.controller.home(&homed)?;
        session.wait(REST)?;
        session.controller.tare()?;
        session.controller.enable(TaskConfig::Grasping(()))?;
        (session.armed, session.log.samples) = (true, Vec::new());
        session.send("grasp", GraspCommand::Grasp(plan))?;
        session.until(Phase::Hold, GRASP_TIME)?;
        if session.log.lost.is_none() {
            session.log.held = session.log.now();
        }
        Ok(session)
    }

    /// The same, and then what it stands on is taken away.
    pub fn without_support(
        setting: &'a mut Setting<'_, 'b>,
        bench: &'a mut Bench,
        held: &Held<'_>,
    ) -> Result<Self, ScenarioError> {
        let mut session = Self::begin(setting, bench, held)?;
        session.note("the support is taken away");
        session.plant.remove_support();
        Ok(session)
    }

    /// One control period.
    fn tick(&mut self) -> Result<(), ScenarioError> {
        if self.log.lost.is_some() {
            return Ok(());
        }
        self.record();
        let sequence = self.bench.motion.ticks();
        let actuators = self.controller.tick(&self.plant.sensors(sequence))?;
        self.plant.apply(&actuators)?;
        if self.armed && self.log.samples.len().is_multiple_of(TALK_EVERY) {
            match self.controller.keep() {
                Err(BoardError::Refused { refusal: Refusal::WrongMode(_), .. }) => return self.lose(),
                other => other?,
            }
            self.look()?;
        }
        (self.progress)((f64::from(sequence) * T / self.duration).min(1.0));
        Ok(())
    }

    /// Writes down what is so now.
    fn record(&mut self) {
        let truth = self.plant.truth();
        let Some(object) = self.plant.object() else { return };
        let motion = &mut self.bench.motion;
        motion.tick(&truth);
        if let Some(note) = self.note.take() {
            motion.note(note);
        }
        let (translation, rotation_xyzw) = (object.position, object.orientation);
        let parent = self.bench.base().to_owned();
        let frame = Transform { parent, child: "object".to_owned(), translation, rotation_xyzw };
        self.bench.motion.frame(frame);
        let time = self.log.now();
        self.log.samples.push(Sample {
            time,
            object,
            contacts: self.plant.contacts(),
            joints: truth.positions,
            wanted: self.wanted,
            aim: self.way.at(time),
        });
    }

    /// Asks the controller how it goes.
    fn look(&mut self) -> Result<(), ScenarioError> {
        let grasp = self.controller.read_grasp()?;
        self.wanted = grasp.wanted.map(|force| Vector3::from(force).map(f64::from));
        self.log.friction = f64::from(grasp.friction);
        if grasp.phase != self.phase {
            self.phase = grasp.phase;
            self.log.phases.push((self.log.now(), grasp.phase));
            let failure = grasp.failure.map_or_else(String::new, |failure| format!(": {failure}"));
            self.note = Some(format!("the hand {}{failure}", grasp.phase));
        }
        Ok(())
    }

    /// The controller gave up.
    fn lose(&mut self) -> Result<(), ScenarioError> {
        let faults = self.controller.faults()?;
        let model = &self.bench.robot.model;
        let reason =
            faults.faults.last().map_or_else(|| "unknown".to_owned(), |f| f.named(model).to_string());
        self.log.lost = Some(format!("at {:.2} s: {reason}", self.log.now()));
        self.controller.ask("clear the faults", Request::ClearFaults { total: faults.total })?;
        Ok(())
    }

    /// Lets time pass [s].
    pub fn wait(&mut self, time: f64) -> Result<(), ScenarioError> {
        for _ in 0..(time / T).round() as usize {
            self.tick()?;
        }
        Ok(())
    }

    /// Lets time pass until the hand is in `phase`; if it is not within `most` [s], the object counts as lost.
    pub fn until(&mut self, phase: Phase, most: f64) -> Result<(), ScenarioError> {
        let end = self.log.now() + most;
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

    /// Tells the hand what to do.
    pub fn send(&mut self, note: &str, command: GraspCommand) -> Result<(), ScenarioError> {
        if self.log.lost.is_some() {
            return Ok(());
        }
        self.note = Some(note.to_owned());
        match self.controller.grasp(command) {
            Err(BoardError::Refused { refusal: Refusal::WrongMode(Mode::Fault), .. }) => self.lose(),
            Err(BoardError::Refused { refusal: Refusal::Task(refusal), .. }) => {
                self.log.lost = Some(format!("at {:.2} s: asked to {note}: {refusal}", self.log.now()));
                Ok(())
            }
            other => Ok(other?),
        }
    }

    /// Has the object brought to where it is so far from where it was grasped [m, rad], and returns when this begins [s].
    pub fn bring(&mut self, shift: [f64; 3], turn: [f64; 3]) -> Result<f64, ScenarioError> {
        let begin = self.log.now();
        self.way = Way { from: self.way.at(begin), to: [shift.into(), turn.into()], begin };
        let single = |values: [f64; 3]| values.map(|value| value as f32);
        let (translation, rotation) = (single(shift), single(turn));
        self.send("move", GraspCommand::Move { translation, rotation, duration: MOVE as f32 })?;
        Ok(begin)
    }

    /// Lifts the object off what it stands on and lets it come to rest; returns how far that is [m].
    pub fn lift(&mut self) -> Result<[f64; 3], ScenarioError> {
        let gravity = Vector3::from(self.bench.values.gravity);
        let up = (gravity * (-UP / gravity.norm())).into();
        self.bring(up, [0.0; 3])?;
        self.wait(MOVE + 1.0)?;
        Ok(up)
    }

    /// Where it should be is not known from now on.
    pub fn forget_aim(&mut self) {
        let unknown = [Vector3::repeat(f64::NAN); 2];
        self.way = Way { from: unknown, to: unknown, begin: 0.0 };
    }

    /// Writes a line into the recording.
    pub fn note(&mut self, text: &str) {
        self.note = Some(text.to_owned());
    }

    /// Switches the hand off; what was recorded.
    pub fn end(self) -> Result<Log, ScenarioError> {
        self.controller.disable()?;
        Ok(self.log)
    }
}
