//! A scenario that is stepped from outside.
//!
//! A scenario is the commander of its own run, from power-on to the last metric. [`Stepped`] makes a
//! coroutine of it: machine, control core and experiment stand still in each control period of an enabled
//! task, where the scenario commands its task, or, if it commands nothing in this period, before the tick.
//! The caller sees the state ([`View`]) and either lets the scenario go on, or sends a command of its own in
//! place of the scenario's. What the experiment does beside that (walls, weights, the tool that is let go)
//! happens all the same.
//!
//! A run whose caller commands nothing, or only what the scenario commands, is the scenario's run, bit by
//! bit.
//!
//! The coroutine is a thread, as stable Rust has no other: scenario and caller never run at the same time,
//! and nothing depends on when the system wakes them.

use std::io;
use std::path::Path;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::{Builder, JoinHandle};

use tesaki::fault::Fault;
use tesaki::protocol::{
    ActuatorFrame, Mode, Refusal, Reply, Request, SensorFrame, TaskReport, Telemetry, Tips,
};
use tesaki::task::{TaskCommand, TaskKind};
use tesaki_supervisor::hand::{FingerBoard, News};
use tesaki_supervisor::{Board, BoardError};

use crate::controller::{Controller, Native, Watched};
use crate::law::{LawError, LawFile};
use crate::plant::{ContactTruth, Intervention, ObjectTruth, Plant, TipTruth, Truth};
use crate::scenario::{Outcome, Scenario, ScenarioError, Setting};

/// What the plant knows and no sensor tells, after the last control period.
#[derive(Clone, Debug)]
pub struct MachineTruth {
    /// The joints.
    pub joints: Truth,
    /// The tips.
    pub tips: Vec<TipTruth>,
    /// The object, if there is one.
    pub object: Option<ObjectTruth>,
    /// Contact of each tip with the object.
    pub contacts: Vec<ContactTruth>,
}

/// The state in which a scenario stands still.
#[derive(Clone, Debug)]
pub struct View {
    /// Which of the scenario's trials this is, from 1.
    pub trial: u32,
    /// Whether the trial ends here: the scenario disables the board, or there is a fault. What is commanded
    /// now is not sent.
    pub is_over: bool,
    /// The enabled task.
    pub task: TaskKind,
    /// What the scenario is about to command; `None`: nothing in this period.
    pub scripted: Option<TaskCommand>,
    /// The board's joints.
    pub telemetry: Telemetry,
    /// The board's tips.
    pub tips: Tips,
    /// The task's own telemetry.
    pub report: Option<TaskReport>,
    /// The machine; of the last one that moved, where a scenario has two. `None` before the first.
    pub truth: Option<MachineTruth>,
    /// Why the caller's last command was refused.
    pub refused: Option<Refusal>,
    /// The fault that ends the trial.
    pub fault: Option<Fault>,
}

/// Where a scenario stands.
#[expect(clippy::large_enum_variant, reason = "one at a time")]
pub enum Halt {
    /// In a control period.
    At(View),
    /// At its end: what it found, with the digest of all frames in its summary.
    Ended(Result<Box<Outcome>, SteppedError>),
}

/// Why a scenario did not come to its end.
#[derive(Debug, thiserror::Error)]
pub enum SteppedError {
    /// Its own reason.
    #[error(transparent)]
    Scenario(#[from] ScenarioError),
    /// A law that it compares.
    #[error(transparent)]
    Law(#[from] LawError),
    /// It was stepped beyond its end, or panicked.
    #[error("the scenario has ended: begin it again")]
    Over,
}

/// What is commanded in a control period.
#[expect(clippy::large_enum_variant, reason = "one at a time")]
#[derive(Clone, Debug, PartialEq)]
pub enum Turn {
    /// What the scenario commands.
    Scripted,
    /// Nothing.
    Nothing,
    /// This, in place of what the scenario commands.
    Command(TaskCommand),
}

/// A scenario that stands still.
pub struct Stepped {
    /// The caller's turns; `None` lets the scenario's thread end.
    turns: Option<SyncSender<Turn>>,
    halts: Receiver<Halt>,
    thread: Option<JoinHandle<()>>,
}

impl Stepped {
    /// Begins `scenario` with the robot in the folder `robot`, on the machine of `seed`.
    ///
    /// # Errors
    /// The system has no thread left.
    pub fn begin(scenario: &'static Scenario, robot: &Path, seed: u64) -> io::Result<Self> {
        let ((turns, turn), (halt, halts)) = (sync_channel(1), sync_channel(1));
        let robot = robot.to_path_buf();
        let run = move || {
            let ended = run(scenario, &robot, seed, halt.clone(), turn);
            // Nobody listens when the caller has gone.
            let _ = halt.send(Halt::Ended(ended.map(Box::new)));
        };
        let thread = Builder::new().name(scenario.name.to_owned()).spawn(run)?;
        Ok(Self { turns: Some(turns), halts, thread: Some(thread) })
    }

    /// Waits until the scenario stands still: once after the begin.
    pub fn wait(&self) -> Halt {
        self.halts.recv().unwrap_or(Halt::Ended(Err(SteppedError::Over)))
    }

    /// Goes on to where the scenario stands still again.
    pub fn step(&self, turn: Turn) -> Halt {
        match &self.turns {
            Some(turns) if turns.send(turn).is_ok() => self.wait(),
            _ => Halt::Ended(Err(SteppedError::Over)),
        }
    }
}

impl Drop for Stepped {
    fn drop(&mut self) {
        self.turns = None;
        if let Some(thread) = self.thread.take() {
            // A panic was told on standard error.
            let _ = thread.join();
        }
    }
}

fn run(
    scenario: &Scenario,
    robot: &Path,
    seed: u64,
    halts: SyncSender<Halt>,
    turns: Receiver<Turn>,
) -> Result<Outcome, SteppedError> {
    let truth = Arc::new(Mutex::new(None));
    let mut steered = Steered {
        native: Native::default(),
        halts,
        turns,
        truth: Arc::clone(&truth),
        task: None,
        trial: 0,
        is_replaced: None,
        refused: None,
    };
    scenario.check_robot(robot)?;
    let laws = LawFile::find(scenario, robot, &[])?;
    let mut watched = Watched::new(&mut steered, false);
    let plain = Setting::plain(robot, &mut watched, seed, scenario.duration);
    let intervention = Some(Arc::new(Mutex::new(Witness(truth))) as _);
    let mut setting = Setting { laws: &laws, intervention, ..plain };
    Ok(scenario.run(&mut setting)?)
}

/// Writes down the truth after each control period.
struct Witness(Arc<Mutex<Option<MachineTruth>>>);

impl Witness {
    fn look(&self, plant: &Plant) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(MachineTruth {
            joints: plant.truth(),
            tips: plant.tips(),
            object: plant.object(),
            contacts: plant.contacts(),
        });
    }
}

impl Intervention for Witness {
    fn attach(&mut self, plant: &mut Plant) {
        self.look(plant);
    }

    fn before(&mut self, _: &mut Plant, _: &mut ActuatorFrame) -> bool {
        true
    }

    fn after(&mut self, plant: &Plant) {
        self.look(plant);
    }
}

/// The control core, whose commander is the scenario or the caller.
struct Steered {
    native: Native,
    halts: SyncSender<Halt>,
    turns: Receiver<Turn>,
    truth: Arc<Mutex<Option<MachineTruth>>>,
    /// The enabled task.
    task: Option<TaskKind>,
    trial: u32,
    /// Whether the caller's command replaces the scenario's in this period; `None` before it was asked.
    is_replaced: Option<bool>,
    refused: Option<Refusal>,
}

impl Steered {
    /// Stands still once a period. Returns whether the caller commands in place of the scenario.
    fn stand(&mut self, scripted: Option<&TaskCommand>) -> Result<bool, BoardError> {
        let Some(task) = self.task else { return Ok(false) };
        if let Some(is_replaced) = self.is_replaced {
            return Ok(is_replaced);
        }
        let turn = self.give_turn(task, scripted, None, false)?;
        let is_replaced = turn != Turn::Scripted;
        self.is_replaced = Some(is_replaced);
        if let Turn::Command(command) = turn
            && let Reply::Refused(refusal) = self.native.request(Request::Task(command))?
        {
            self.refused = Some(refusal);
        }
        Ok(is_replaced)
    }

    /// Stands still at the end of a trial.
    fn end_trial(&mut self, fault: Option<Fault>) -> Result<(), BoardError> {
        let Some(task) = self.task.take() else { return Ok(()) };
        self.give_turn(task, None, fault, true).map(drop)
    }

    fn give_turn(
        &mut self,
        task: TaskKind,
        scripted: Option<&TaskCommand>,
        fault: Option<Fault>,
        is_over: bool,
    ) -> Result<Turn, BoardError> {
        let node = self.native.node();
        let view = View {
            trial: self.trial,
            is_over,
            task,
            scripted: scripted.cloned(),
            telemetry: node.telemetry(),
            tips: node.tips(),
            report: node.task_report(),
            truth: self.truth.lock().unwrap_or_else(PoisonError::into_inner).clone(),
            refused: self.refused.take(),
            fault,
        };
        let gone = || io::Error::new(io::ErrorKind::BrokenPipe, "the caller has ended the run");
        self.halts.send(Halt::At(view)).map_err(|_| gone())?;
        Ok(self.turns.recv().map_err(|_| gone())?)
    }

    /// What comes before a request; whether the caller's command has replaced it.
    fn before(&mut self, request: &Request) -> Result<bool, BoardError> {
        match request {
            Request::Task(command) => self.stand(Some(command)),
            Request::Disable => self.end_trial(None).map(|()| false),
            _ => Ok(false),
        }
    }
}

impl Board for Steered {
    fn request(&mut self, request: Request) -> Result<Reply, BoardError> {
        if self.before(&request)? {
            return Ok(Reply::Done);
        }
        let enabled = if let Request::Enable(config) = &request { Some(config.kind()) } else { None };
        let reply = self.native.request(request)?;
        if enabled.is_some() && reply == Reply::Done {
            (self.task, self.is_replaced, self.refused) = (enabled, None, None);
            self.trial += 1;
        }
        Ok(reply)
    }
}

impl FingerBoard for Steered {
    fn post(&mut self, request: Request) -> Result<(), BoardError> {
        if self.before(&request)? { Ok(()) } else { self.native.post(request) }
    }

    fn listen(&mut self) -> Result<News, BoardError> {
        self.native.listen()
    }
}

impl Controller for Steered {
    fn tick(&mut self, sensors: &SensorFrame) -> Result<ActuatorFrame, BoardError> {
        self.stand(None)?;
        self.is_replaced = None;
        let actuators = self.native.tick(sensors)?;
        if self.native.node().mode() == Mode::Fault {
            let fault = self.native.node().faults().faults.last().copied();
            self.end_trial(fault)?;
        }
        Ok(actuators)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn begin(scenario: &str) -> Stepped {
        let robots = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../robots"));
        let scenario = Scenario::find(scenario).unwrap();
        Stepped::begin(scenario, &robots.join(scenario.robot), 1).unwrap()
    }

    /// Steps a whole run and returns its digest.
    fn digest(mut choose: impl FnMut(&View) -> Turn) -> String {
        let run = begin("hand3-servo");
        let mut halt = run.wait();
        loop {
            halt = match halt {
                Halt::At(view) => run.step(choose(&view)),
                Halt::Ended(outcome) => return outcome.unwrap().summary.frames_sha256.unwrap(),
            }
        }
    }

    #[test]
    fn the_scenarios_own_commands_give_its_own_frames() {
        let mut native = Native::default();
        let mut watched = Watched::new(&mut native, false);
        let scenario = Scenario::find("hand3-servo").unwrap();
        let robot = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/hand3"));
        scenario.run(&mut Setting::plain(robot, &mut watched, 1, scenario.duration)).unwrap();
        let plain = watched.frames_sha256();
        assert_eq!(digest(|_| Turn::Scripted), plain, "untouched");
        let (mut trials, mut ends) = (0, 0);
        let own = digest(|view| {
            trials = view.trial;
            ends += u32::from(view.is_over);
            assert!(view.truth.is_some() && view.refused.is_none() && view.fault.is_none());
            view.scripted.clone().map_or(Turn::Nothing, Turn::Command)
        });
        assert_eq!((own, trials, ends), (plain, 4, 4), "its commands, sent by the caller");
    }

    #[test]
    fn a_command_of_the_caller_replaces_the_scenarios_and_a_refusal_is_told() {
        use tesaki::task::joint_servo::JointCommand;
        let run = begin("hand3-servo");
        let Halt::At(first) = run.wait() else { panic!("it has a first period") };
        let goal = |positions: &[f32]| {
            let positions = heapless::Vec::from_slice(positions).unwrap();
            Turn::Command(TaskCommand::JointServo(JointCommand::Goal { positions }))
        };
        let start: Vec<f32> = first.telemetry.joints.iter().map(|joint| joint.position).collect();
        let raised: Vec<f32> = start.iter().map(|angle| angle + 0.05).collect();
        let mut last = first;
        for _ in 0..100 {
            let Halt::At(view) = run.step(goal(&raised)) else { panic!("it goes on") };
            last = view;
        }
        for (joint, angle) in last.telemetry.joints.iter().zip(&raised) {
            assert!((joint.position - angle).abs() < 0.01, "{} rad instead of {angle}", joint.position);
        }
        let Halt::At(view) = run.step(goal(&[9.0; 9])) else { panic!("it goes on") };
        assert!(matches!(view.refused, Some(Refusal::Task(_))), "{:?}", view.refused);
        // Dropped in mid-run: the thread ends.
    }
}
