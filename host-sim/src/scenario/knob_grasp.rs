//! An arm finds a door knob with the camera in its hand, approaches and grips it (Knob, sections 3 and 4).

use rapier3d::na::Isometry3;
use tesaki::behavior::{Approach, ApproachPhase, Order};
use tesaki::protocol::Refusal;
use tesaki::task::visual_approach::{GripperState, VisualApproachCommand, VisualApproachTelemetry};
use tesaki::task::{TaskConfig, TaskRefusal};
use tesaki::vision::{CameraBuffers, Circle, Image, find_circle, radius_limits};
use tesaki_description::approach::{self, ApproachFile};
use tesaki_description::robot::RobotFolder;
use tesaki_supervisor::{Board, BoardError};

use super::common::{T, clear_faults, home, introduce, largest, median, request_error};
use super::film::picture_panel;
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::camera::{self, Camera, CameraValues, CircleTruth};
use crate::controller::{Controller, Watched};
use crate::door::{KNOB, KnobDoor, hand_joints, hand_pose};
use crate::motion::{Motion, Transform};
use crate::plant::{Plant, PlantOptions};
use crate::report::{Figure, Line, Metric, Panel, Summary, Table};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "knob-grasp",
    title: "A door knob, found and gripped",
    about: "a camera in the hand leads an arm to a door knob, which it grips",
    robot: "knob-arm",
    kind: Kind::ArmWithGripper,
    files: &["approach.toml", "hand_eye.toml", "camera.toml"],
    results: "docs/measurements.md#door-knobs",
    duration: LONGEST * DOORS as f64,
    shortest: None,
    laws: None,
    lead: &[
        "An arm stands before a door, its base up to 50 mm and 3° from where it should be. A camera in its hand takes \
         ten pictures a second; the circle finder looks for the rose in each, which takes 60 ms; the behaviour \
         estimates from the circles where the rose is and how large, and sends the hand there. The hand goes on while a \
         picture is looked at. Before the knob it waits until it is centred, goes on beside it, closes the \
         gripper and pulls. Each run has ten doors, with other roses, surfaces, light and places of the base.",
        "The machine differs from the controller's model, its encoders have zero errors of up to 5 mrad, and its joints \
         give way. Door, rose and knob are rigid; the fingers have friction on them. *Gripped* means that both fingers \
         press on the knob with at least 5 N when the behaviour says so, and that it says so.",
    ],
    run,
};

/// Doors of a run.
const DOORS: usize = 10;
/// Longest time of a door [s].
const LONGEST: f64 = 30.0;
/// Ticks from picture to picture, and from a picture until its circle is known.
const PICTURE_TICKS: u32 = 10;
const LATENCY_TICKS: u32 = 6;
/// Ticks from one decision of the behaviour to the next.
const DECISION_TICKS: u32 = 2;
/// Least force of each finger on a knob that is gripped [N].
const GRIPPED: f64 = 5.0;
/// Pictures of the film strip.
const SHOWN: usize = 6;

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let robot = RobotFolder::load(setting.robot)?;
    let files = approach::load(setting.robot, &robot.model)?;
    let camera = CameraValues::load(setting.robot)?;
    let mut motion = setting.motion(&robot.model);
    let mut logs = Vec::new();
    for number in 0..DOORS {
        let machine = Machine { robot: &robot, files: &files, camera: &camera };
        let mut trial = Trial::begin(setting, &machine, number, &mut motion)?;
        match trial.go() {
            // The door is lost, the others are not.
            Err(ScenarioError::Fault { fault, .. }) => {
                trial.note(&fault);
                trial.log.ended_in_fault = true;
                clear_faults(trial.setting.controller)?;
            }
            result => result?,
        }
        logs.push(trial.log);
        (setting.progress)((number + 1) as f64 / DOORS as f64);
    }
    let summary = summary(&logs);
    let mut figures = Vec::new();
    if let Some(first) = logs.first() {
        figures = vec![film_strip(first, 0)?, film_strip(first, SHOWN / 2)?, approach_figure(first)];
    }
    let tables = vec![("doors.csv".to_owned(), table(&logs))];
    Ok(Outcome { summary, figures, tables, motion })
}

/// What all doors of a run share.
struct Machine<'a> {
    robot: &'a RobotFolder,
    files: &'a ApproachFile,
    camera: &'a CameraValues,
}

/// A picture, and the credible circle that was found in it.
#[derive(Clone, Debug)]
struct Picture {
    time: f64,
    image: camera::Image,
    truth: Option<CircleTruth>,
    found: Option<Circle>,
}

/// State of a decision.
#[derive(Clone, Copy, Debug)]
struct Sample {
    time: f64,
    /// Distance of the fingertips from the rim of the rose, and from the axis of the knob [m].
    distance: f64,
    aside: f64,
    /// Largest force of a link on door, rose or knob since the last decision, but for that of the grip [N].
    contact: f64,
}

/// What came of a door.
#[derive(Clone, Debug)]
struct Log {
    phase: ApproachPhase,
    /// Whether both fingers press on the knob at the end.
    gripped: bool,
    ended_in_fault: bool,
    time: f64,
    tries: u8,
    pictures: Vec<Picture>,
    samples: Vec<Sample>,
    /// Radius of the rose, and what it was believed to be in the end [m].
    radius: [f64; 2],
    /// When the gripper closed: distance from the rim, and from the axis [m].
    grip: Option<[f64; 2]>,
}

impl Log {
    fn succeeded(&self) -> bool {
        self.phase == ApproachPhase::Done && self.gripped
    }

    fn peak_force(&self) -> f64 {
        largest(self.samples.iter().map(|sample| sample.contact))
    }

    fn found(&self) -> usize {
        self.pictures.iter().filter(|picture| picture.found.is_some()).count()
    }
}

/// One door, from power-on to switching off.
struct Trial<'a, 'b, 'c> {
    setting: &'a mut Setting<'b, 'c>,
    machine: &'a Machine<'a>,
    motion: &'a mut Motion,
    plant: Plant,
    door: KnobDoor,
    /// Index of the tip that is the hand, and of the gripper's joint.
    hand: usize,
    gripper: usize,
    number: usize,
    approach: Approach,
    buffers: Box<CameraBuffers>,
    /// Largest contact force since the last decision [N].
    contact: f64,
    log: Log,
}

impl<'a, 'b, 'c> Trial<'a, 'b, 'c> {
    fn begin(
        setting: &'a mut Setting<'b, 'c>,
        machine: &'a Machine<'a>,
        number: usize,
        motion: &'a mut Motion,
    ) -> Result<Self, ScenarioError> {
        let robot = machine.robot;
        let seed = setting.seed.wrapping_add((number as u64 + 1) << 32);
        let mut options = PlantOptions::mismatched(setting.seed);
        let plant = Plant::of(robot, &options)?;
        let [hand, gripper] = hand_joints(&robot.model, &machine.files.task, &plant);
        let door = KnobDoor::draw(seed, &hand_pose(&plant, hand, gripper));
        options.fixtures = door.fixtures();
        let plant = Plant::of(robot, &options)?;
        motion.note(format!("door {}", number + 1));
        motion.fixtures(&options.fixtures);
        let log = Log {
            phase: ApproachPhase::Look,
            gripped: false,
            ended_in_fault: false,
            time: 0.0,
            tries: 0,
            pictures: Vec::new(),
            samples: Vec::new(),
            radius: [door.scene.rose.radius, f64::NAN],
            grip: None,
        };
        let mut trial = Self {
            plant: plant.under(setting.intervention.clone()),
            approach: Approach::new(machine.files.behavior.clone()),
            buffers: Box::default(),
            contact: 0.0,
            setting,
            machine,
            motion,
            door,
            hand,
            gripper,
            number,
            log,
        };
        introduce(trial.setting.controller, &robot.model)?;
        trial.step()?;
        home(trial.setting.controller, &trial.plant)?;
        trial.step()?;
        trial.setting.controller.enable(TaskConfig::VisualApproach(machine.files.task))?;
        Ok(trial)
    }

    /// Lets the behaviour lead the arm until it ends.
    fn go(&mut self) -> Result<(), ScenarioError> {
        let mut order = Order { command: None, look: true };
        // When the picture that is looked at was taken.
        let mut taken = None;
        let mut report = self.setting.controller.read_visual_approach()?;
        for tick in 0..(LONGEST / T) as u32 {
            self.log.time = f64::from(tick) * T;
            if order.look && taken.is_none() && tick % PICTURE_TICKS == 0 {
                self.take_picture()?;
                taken = Some(tick);
            }
            if taken.is_some_and(|taken| tick >= taken + LATENCY_TICKS) {
                let (number, picture) = (self.log.pictures.len(), self.log.pictures.last());
                let circle = picture.and_then(|picture| picture.found);
                // The pose must be that of this picture.
                if let Some((latched, hand)) = report.latched
                    && usize::from(latched) + 1 == number
                {
                    self.approach.look(&hand, circle.as_ref());
                }
                taken = None;
            }
            if tick % DECISION_TICKS == 0 {
                order = self.approach.update(&report, DECISION_TICKS as f32 * T as f32);
                if let Some(command) = order.command {
                    self.command(command)?;
                }
                self.sample(&report);
            }
            if matches!(self.approach.phase(), ApproachPhase::Done | ApproachPhase::Failed(_)) {
                break;
            }
            self.in_time(Board::keep)?;
            self.step()?;
            report = self.setting.controller.read_visual_approach()?;
            self.observe_contacts(&report);
        }
        self.log.phase = self.approach.phase();
        self.log.tries = self.approach.tries();
        self.log.gripped = self.finger_forces().iter().all(|force| *force >= GRIPPED);
        if let ApproachPhase::Failed(reason) = self.log.phase {
            self.note(&reason.to_string());
        }
        if let Some(rose) = self.approach.rose() {
            self.log.radius[1] = rose.radius().into();
        }
        self.setting.controller.disable()?;
        self.step()
    }

    /// Notes in the recording why the door was given up.
    fn note(&mut self, reason: &str) {
        self.motion.note(format!("door {}: {reason}", self.number + 1));
    }

    /// True pose of the hand in the door frame.
    fn true_hand(&self) -> Isometry3<f64> {
        self.door.pose.inverse() * hand_pose(&self.plant, self.hand, self.gripper)
    }

    /// Latches the pose of the hand, takes a picture and looks for the rose.
    fn take_picture(&mut self) -> Result<(), ScenarioError> {
        let number = self.log.pictures.len() as u16;
        self.in_time(|board| board.approach(VisualApproachCommand::Latch { number }))?;
        let latched = self.setting.controller.read_visual_approach()?.latched;
        let Some((_, latched)) = latched.filter(|(latched, _)| *latched == number) else { return Ok(()) };
        let hand = self.true_hand();
        let opening = self.plant.truth().positions[self.gripper];
        let image = self.door.photograph(self.machine.camera, &hand, opening, u32::from(number));
        let truth = self.door.truth(self.machine.camera, &hand, opening).rose;
        let search = self.approach.search(&latched);
        // A rose that is expected outside of the picture is not looked for.
        let is_outside = |center: [f32; 2]| !Camera::of(self.machine.camera).contains(center.map(f64::from));
        let search = search
            .within(radius_limits(image.width, image.height))
            .filter(|search| !search.window.is_some_and(|window| is_outside(window.center)));
        let found = match search {
            None => None,
            Some(search) => {
                let grey = Image::try_new(&image.pixels, image.width, image.height)?;
                find_circle(&grey, &search, &mut self.buffers.scratch())?.filter(Approach::is_credible)
            }
        };
        self.log.pictures.push(Picture { time: self.log.time, image, truth, found });
        Ok(())
    }

    fn sample(&mut self, report: &VisualApproachTelemetry) {
        let hand = self.true_hand().translation.vector;
        let (distance, aside) = (self.door.scene.rose_rim().center.z - hand.z, hand.x.hypot(hand.y));
        let contact = std::mem::take(&mut self.contact);
        self.log.samples.push(Sample { time: self.log.time, distance, aside, contact });
        if report.gripper == GripperState::Holding && self.log.grip.is_none() {
            self.log.grip = Some([distance, aside]);
        }
    }

    /// Notes the contact forces of the last control period. While the gripper closes, holds and opens, its
    /// own forces act on the knob.
    fn observe_contacts(&mut self, report: &VisualApproachTelemetry) {
        if matches!(report.gripper, GripperState::Still | GripperState::Open | GripperState::Empty) {
            let forces = self.plant.fixture_contacts().into_iter().map(|contact| contact.force.norm());
            self.contact = largest([self.contact].into_iter().chain(forces));
        }
    }

    /// Forces of both fingers on the knob [N].
    fn finger_forces(&self) -> [f64; 2] {
        let contacts = self.plant.fixture_contacts();
        ["left_finger", "right_finger"].map(|finger| {
            let on_knob = contacts.iter().filter(|contact| contact.fixture == KNOB && contact.link == finger);
            on_knob.map(|contact| contact.force.norm()).sum()
        })
    }

    /// Commands the board. What it refuses is the behaviour's to judge.
    fn command(&mut self, command: VisualApproachCommand) -> Result<(), ScenarioError> {
        match self.setting.controller.approach(command) {
            Err(BoardError::Refused {
                refusal: Refusal::Task(TaskRefusal::VisualApproach(refusal)), ..
            }) => {
                self.approach.refused(&refusal);
                Ok(())
            }
            result => self.in_time(|_| result),
        }
    }

    /// A request; when it is refused, the fault that is the reason.
    fn in_time(
        &mut self,
        request: impl FnOnce(&mut Watched<'c>) -> Result<(), BoardError>,
    ) -> Result<(), ScenarioError> {
        let door = format!("door {}", self.number + 1);
        request(self.setting.controller).map_err(|error| {
            let model = &self.machine.robot.model;
            request_error(self.setting.controller, model, &door, self.log.time, error)
        })
    }

    fn step(&mut self) -> Result<(), ScenarioError> {
        let sequence = self.motion.tick(&self.plant.truth());
        let [x, y, z, w] = self.door.pose.rotation.coords.into();
        self.motion.frame(Transform {
            parent: "base".into(),
            child: "door".into(),
            translation: self.door.pose.translation.vector.into(),
            rotation_xyzw: [x, y, z, w],
        });
        let actuators = self.setting.controller.tick(&self.plant.sensors(sequence))?;
        self.plant.apply(&actuators)?;
        Ok(())
    }
}

fn summary(logs: &[Log]) -> Summary {
    let mut summary = Summary::default();
    let share = |count: usize| 100.0 * count as f64 / logs.len().max(1) as f64;
    let gripped: Vec<&Log> = logs.iter().filter(|log| log.succeeded()).collect();
    summary.insert("gripped", Metric::at_least("Knobs that are gripped", share(gripped.len()), 99.0, "%"));
    let first = gripped.iter().filter(|log| log.tries == 0).count();
    summary
        .insert("first_try", Metric::reported("Knobs that are gripped at the first try", share(first), "%"));
    let claims = logs.iter().filter(|log| log.phase == ApproachPhase::Done && !log.gripped).count();
    let text = "Doors of which the behaviour says that it holds the knob, and does not";
    summary.insert("wrong_claims", Metric::at_most(text, share(claims), 0.0, "%"));
    let times: Vec<f64> = gripped.iter().map(|log| log.time).collect();
    summary.insert(
        "time",
        Metric::at_most("Time of an approach, median", median(times.iter().copied()), 10.0, "s"),
    );
    let longest = largest(times.iter().copied());
    summary.insert("longest", Metric::at_most("Longest time of an approach", longest, 10.0, "s"));
    let peak = largest(logs.iter().map(Log::peak_force));
    let text = "Largest force on door, rose and knob before the grip";
    summary.insert("contact", Metric::at_most(text, peak, 60.0, "N"));
    let grips =
        |which: usize| -> Vec<f64> { logs.iter().filter_map(|log| Some(1e3 * log.grip?[which])).collect() };
    let text = "Distance of the fingertips from the axis of the knob when they close, median";
    summary.insert("aside", Metric::reported(text, median(grips(1)), "mm"));
    let text = "Distance of the fingertips from the rim of the rose when they close, median";
    summary.insert("depth", Metric::reported(text, median(grips(0)), "mm"));
    let [found, pictures] =
        [Log::found, |log: &Log| log.pictures.len()].map(|count| logs.iter().map(count).sum::<usize>());
    let text = "Pictures in which a circle is found";
    summary.insert("found", Metric::reported(text, 100.0 * found as f64 / pictures.max(1) as f64, "%"));
    summary
}

/// Three of the pictures that are shown of a door.
fn film_strip(log: &Log, from: usize) -> Result<Figure, ScenarioError> {
    let caption = "What the camera saw on the way to the first door, with the true outline of the rose and the circle that \
                   was found.";
    let title = if from == 0 { "Film strip: the begin" } else { "Film strip: the end" };
    let mut figure = Figure::paths(title, caption, "x", "px");
    for index in from..from + SHOWN / 2 {
        let place = index * log.pictures.len().saturating_sub(1) / (SHOWN - 1);
        let Some(picture) = log.pictures.get(place) else { break };
        let title = format!("{:.1} s", picture.time);
        let panel = picture_panel(title, &picture.image, picture.truth.as_ref(), picture.found.as_ref())?;
        figure = figure.panel(panel);
    }
    Ok(figure)
}

/// Way of the hand to the first door.
fn approach_figure(log: &Log) -> Figure {
    let time: Vec<f64> = log.samples.iter().map(|sample| sample.time).collect();
    let values =
        |value: fn(&Sample) -> f64| log.samples.iter().map(|sample| 1e3 * value(sample)).collect::<Vec<_>>();
    let caption = "True distance of the fingertips from the rim of the rose and from the axis of the first door's knob.";
    Figure::stacked("The way of the hand", caption, "time", "s")
        .panel(Panel::new("From the rose", "distance", "mm").line(Line::solid(
            "rose",
            0,
            time.clone(),
            values(|sample| sample.distance),
        )))
        .panel(Panel::new("From the axis", "distance", "mm").line(Line::solid(
            "axis",
            1,
            time,
            values(|sample| sample.aside),
        )))
}

fn table(logs: &[Log]) -> String {
    let grip = |log: &Log, which: usize| log.grip.map_or(f64::NAN, |grip| grip[which]);
    let mut table = Table::new(logs);
    table
        .column("gripped", "", |log| f64::from(u8::from(log.succeeded())))
        .column("fault", "", |log| f64::from(u8::from(log.ended_in_fault)))
        .column("time", "s", |log| log.time)
        .column("tries", "", |log| f64::from(log.tries) + 1.0)
        .column("pictures", "", |log| log.pictures.len() as f64)
        .column("found", "", |log| log.found() as f64)
        .column("rose", "m", |log| log.radius[0])
        .column("estimated_rose", "m", |log| log.radius[1])
        .column("grip_distance", "m", |log| grip(log, 0))
        .column("grip_aside", "m", |log| grip(log, 1))
        .column("contact", "N", Log::peak_force);
    table.csv()
}
