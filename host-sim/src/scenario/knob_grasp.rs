//! The arm finds a door knob with the camera in its hand, approaches and grips it (Knob, sections 3 and 4).

use rapier3d::na::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use tesaki::control::ServoMode;
use tesaki::task::TaskConfig;
use tesaki::task::visual_approach::{
    Approach, ApproachSettings, GripperSettings, HandMotion, KnobExpectation, Phase, VisualApproachCommand,
    VisualApproachSettings, VisualApproachTelemetry,
};
use tesaki::vision::{CameraBuffers, Circle, HandEyeRow, HandEyeTable, Image, find_circle};
use tesaki_description::robot::RobotFolder;
use tesaki_supervisor::Board;

use super::common::{T, fault_error, introduce, require_duration};
use super::{Outcome, Scenario, ScenarioError, Setting};
use crate::camera::{Camera, CameraValues, Optics, Scene, View};
use crate::controller::Controller;
use crate::motion::Motion;
use crate::plant::{Drive, Fixture, FixtureShape, Plant, PlantOptions, PlantValues};
use crate::purpose::Purpose;
use crate::report::{Figure, Metric, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "knob-grasp",
    title: "A door knob, found and grasped",
    about: "a camera in the hand leads an arm to a door knob, which it grips",
    robot: "knob-arm",
    duration: LONGEST * TRIALS as f64,
    lead: &[""],
    run,
};

/// Doors of a run.
const TRIALS: usize = 10;
/// Longest time of a trial [s].
const LONGEST: f64 = 30.0;
/// Ticks from picture to picture, and from a picture until its circle is known.
const PICTURE_TICKS: u32 = 10;
const LATENCY_TICKS: u32 = 6;
/// Ticks from one decision of the behaviour to the next.
const DECISION_TICKS: u32 = 2;
/// Distance of the fingertips from the door in the start posture, with the base where it should be [m].
const START: f64 = 0.21;
/// The base is displaced by as much along x and y [m], turned in heading and tilted about any axis by as much [rad].
const DISPLACEMENT: f64 = 0.05;
const TURN: f64 = 0.052_36;
/// Circles of less confidence are not believed.
const BELIEVED: f32 = 0.5;

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    require_duration(&SCENARIO, setting)?;
    let robot = RobotFolder::load(setting.robot)?;
    let values = PlantValues::load(setting.robot)?;
    let camera = CameraValues::load(setting.robot)?;
    let mut motion = Motion::new(robot.model.joints.iter().map(|joint| joint.name.as_str()));
    let summary = Summary::new(SCENARIO.name, "", setting.seed);
    let mut summary = summary;
    for trial in 0..TRIALS {
        if std::env::var("KNOBT").is_ok_and(|one| one != trial.to_string()) {
            continue;
        }
        let own = setting.seed.wrapping_add((trial as u64 + 1) << 32);
        let mut run = Trial::begin(setting, &robot, &values, &camera, own, &mut motion)?;
        let log = run.go()?;
        eprintln!("seed {} trial {trial}: {log:?}", setting.seed);
    }
    summary.insert("none", Metric::reported("none", 0.0, ""));
    let summary = summary.ticks(u64::from(motion.ticks()));
    Ok(Outcome { summary, figures: Vec::<Figure>::new(), tables: Vec::new(), motion })
}

/// What came of a trial.
#[derive(Clone, Debug)]
struct Log {
    phase: Phase,
    time: f64,
    tries: u8,
    pictures: usize,
    found: usize,
    /// Where the hand is in the door frame at the end [mm].
    hand: [f64; 3],
    /// Errors of the estimate: place in the door frame, radius [mm].
    rose: [f64; 4],
}

struct Trial<'a, 'b, 'c> {
    setting: &'a mut Setting<'b, 'c>,
    robot: &'a RobotFolder,
    motion: &'a mut Motion,
    plant: Plant,
    scene: Scene,
    camera: Camera,
    mount: Isometry3<f64>,
    optics: Optics,
    /// The door in the base frame.
    door: Isometry3<f64>,
    hand: usize,
    gripper: usize,
    own: u64,
    approach: Approach,
    buffers: Box<CameraBuffers>,
    /// Pictures and those that were found.
    pictures: u16,
    found: usize,
}

impl<'a, 'b, 'c> Trial<'a, 'b, 'c> {
    fn begin(
        setting: &'a mut Setting<'b, 'c>,
        robot: &'a RobotFolder,
        values: &PlantValues,
        camera: &CameraValues,
        own: u64,
        motion: &'a mut Motion,
    ) -> Result<Self, ScenarioError> {
        let drives: Vec<Drive> = robot.model.joints.iter().map(Drive::from).collect();
        let mut options = PlantOptions::mismatched(setting.seed);
        let plant = Plant::new(&robot.urdf, &drives, values, &options)?;
        let hand = plant.tips().iter().position(|tip| tip.link == "hand").unwrap_or(0);
        let gripper = robot.model.joints.iter().position(|joint| joint.name == "gripper").unwrap_or(0);
        let scene = Scene::draw(own);
        let start = hand_pose(&plant, hand, gripper);
        let door = base_in_door(&start, own).inverse();
        options.fixtures = fixtures(&scene, &door);
        let plant = Plant::new(&robot.urdf, &drives, values, &options)?;
        let plant = plant.under(setting.intervention.clone());
        motion.note("trial");
        let approach = Approach::new(approach_settings(camera));
        let mut trial = Self {
            setting,
            robot,
            motion,
            plant,
            scene,
            camera: camera.camera(),
            mount: camera.mount(),
            optics: Optics::draw(own),
            door,
            hand,
            gripper,
            own,
            approach,
            buffers: Box::default(),
            pictures: 0,
            found: 0,
        };
        introduce(trial.setting.controller, &robot.model)?;
        trial.step()?;
        let homed: Vec<f32> = trial.plant.homed_positions().iter().map(|&angle| angle as f32).collect();
        trial.setting.controller.home(&homed)?;
        trial.step()?;
        let settings = board_settings(gripper as u8);
        trial.setting.controller.enable(TaskConfig::VisualApproach(settings))?;
        Ok(trial)
    }

    /// Pose of the hand in the door frame.
    fn true_hand(&self) -> Isometry3<f64> {
        self.door.inverse() * hand_pose(&self.plant, self.hand, self.gripper)
    }

    fn go(&mut self) -> Result<Log, ScenarioError> {
        let mut pending: Option<(u32, Option<Circle>)> = None;
        let mut look = true;
        let mut tick = 0_u32;
        let mut report = self.setting.controller.read_visual_approach()?;
        while f64::from(tick) * T < LONGEST {
            if tick % PICTURE_TICKS == 0 && look && pending.is_none() {
                pending = Some((tick, self.picture()?));
            }
            if let Some((taken, circle)) = pending
                && tick >= taken + LATENCY_TICKS
            {
                if let Some((_, pose)) = report.latched {
                    self.approach.look(&pose, circle.as_ref());
                }
                pending = None;
            }
            if tick % DECISION_TICKS == 0 {
                let before = self.approach.phase();
                let order = self.approach.update(&report, f64::from(DECISION_TICKS) as f32 * T as f32);
                look = order.look;
                if let Some(command) = order.command {
                    self.send(tick, |board| board.approach(command))?;
                }
                if std::env::var("KNOB").is_ok()
                    && tick % 20 == 0
                    && let Some(rose) = self.approach.rose()
                {
                    let turn = UnitQuaternion::from_quaternion(Quaternion::new(
                        report.hand.rotation[3],
                        report.hand.rotation[0],
                        report.hand.rotation[1],
                        report.hand.rotation[2],
                    ));
                    let hand = Isometry3::from_parts(Translation3::from(report.hand.translation), turn);
                    let seen = hand.inverse_transform_point(&rose.place());
                    let dev = [Vector3::x(), Vector3::y(), Vector3::z()]
                        .map(|axis| 1e3 * rose.deviation(&(hand * axis)));
                    let door = rose.place().map(f64::from);
                    let place = self.door.inverse_transform_point(&door);
                    eprintln!(
                        "   {:.2} seen {:.1} {:.1} {:.1} dev {dev:.1?} door {:.1} {:.1} {:.1} r {:.1} ({:.1}) remaining {:.1} {:?}",
                        f64::from(tick) * T,
                        seen.x * 1e3,
                        seen.y * 1e3,
                        seen.z * 1e3,
                        place.x * 1e3,
                        place.y * 1e3,
                        place.z * 1e3,
                        rose.radius() * 1e3,
                        self.scene.rose.radius * 1e3,
                        report.remaining * 1e3,
                        report.motion
                    );
                }
                if std::env::var("KNOB").is_ok() && self.approach.phase() != before {
                    let hand = self.true_hand().translation.vector * 1e3;
                    eprintln!(
                        "{:.2} s {:?} → {:?}: hand {:.1} {:.1} {:.1} mm, {:?} force {:?} gripper {:?} {:.2}",
                        f64::from(tick) * T,
                        before,
                        self.approach.phase(),
                        hand.x,
                        hand.y,
                        hand.z,
                        report.motion,
                        report.force,
                        report.gripper,
                        report.opening
                    );
                }
            }
            if matches!(self.approach.phase(), Phase::Done | Phase::Failed(_)) {
                break;
            }
            self.send(tick, Board::keep)?;
            self.step()?;
            tick += 1;
            report = self.setting.controller.read_visual_approach()?;
        }
        let phase = self.approach.phase();
        let hand = self.true_hand().translation.vector * 1e3;
        let rose = self.approach.rose().map_or([f64::NAN; 4], |rose| {
            let place = rose.place().map(f64::from);
            let place = self.door.inverse_transform_point(&place);
            let rim = self.scene.rose_rim();
            [
                place.x * 1e3,
                place.y * 1e3,
                (place.z - rim.center.z) * 1e3,
                (f64::from(rose.radius()) - rim.radius) * 1e3,
            ]
        });
        self.setting.controller.disable()?;
        self.step()?;
        Ok(Log {
            phase,
            time: f64::from(tick) * T,
            tries: self.approach.tries(),
            pictures: self.pictures.into(),
            found: self.found,
            hand: hand.into(),
            rose,
        })
    }

    fn send(
        &mut self,
        tick: u32,
        request: impl FnOnce(&mut crate::controller::Watched<'c>) -> Result<(), tesaki_supervisor::BoardError>,
    ) -> Result<(), ScenarioError> {
        request(self.setting.controller).map_err(|error| {
            eprintln!("{error}");
            fault_error(self.setting.controller, &self.robot.model, "the trial", f64::from(tick) * T)
        })
    }

    /// Takes a picture and looks for the rose.
    fn picture(&mut self) -> Result<Option<Circle>, ScenarioError> {
        self.setting.controller.approach(VisualApproachCommand::Latch { number: self.pictures })?;
        let latched = self.setting.controller.read_visual_approach()?.latched;
        let Some((_, pose)) = latched else { return Ok(None) };
        let hand = self.true_hand();
        let angle = -0.25 * self.plant.truth().positions[self.gripper];
        let fingers = View { hand }.fingers(angle);
        let image = self.scene.photograph(
            &self.camera,
            &self.optics,
            &(hand * self.mount),
            &fingers,
            (self.own, self.pictures.into()),
        );
        self.pictures += 1;
        let mut search = self.approach.search(&pose);
        let image = Image::new(&image.pixels, image.width, image.height)?;
        // A rose that is expected outside of the image is not looked for there.
        if let Some(window) = &mut search.window {
            let inside = self.camera.contains(window.center.map(f64::from));
            if !inside {
                return Ok(None);
            }
        }
        let found = find_circle(&image, &search, &mut self.buffers.scratch())?;
        let found = found.filter(|circle| circle.confidence >= BELIEVED);
        self.found += usize::from(found.is_some());
        if std::env::var("KNOB2").is_ok() {
            let truth = self.scene.truth(&self.camera, &(hand * self.mount), &fingers).rose;
            eprintln!(
                "  z {:.0} truth {:.1?} knob {:.1?} found {:.1?}",
                hand.translation.z * 1e3,
                truth.map(|t| (t.center, t.radius, t.visible)),
                self.scene
                    .truth(&self.camera, &(hand * self.mount), &fingers)
                    .knob
                    .map(|t| (t.center, t.radius)),
                found.map(|f| (f.center, f.radius))
            );
        }
        Ok(found)
    }

    fn step(&mut self) -> Result<(), ScenarioError> {
        let sequence = self.motion.tick(&self.plant.truth());
        let actuators = self.setting.controller.tick(&self.plant.sensors(sequence))?;
        self.plant.apply(&actuators)?;
        Ok(())
    }
}

/// True pose of the hand frame in the base frame, as if the gripper stood at 0.
fn hand_pose(plant: &Plant, hand: usize, gripper: usize) -> Isometry3<f64> {
    let tips = plant.tips();
    let tip = &tips[hand];
    let [x, y, z, w] = tip.orientation;
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    let screw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -plant.truth().positions[gripper]);
    Isometry3::from_parts(Translation3::from(tip.position), turn * screw)
}

/// Coefficient of friction of rubber on metal, and on the door.
const FRICTION: f64 = 0.8;

/// Door, rose and knob in the base frame.
fn fixtures(scene: &Scene, door: &Isometry3<f64>) -> Vec<Fixture> {
    let at = |x: f64, y: f64, z: f64| door * Isometry3::translation(x, y, z);
    let (rose, knob) = (&scene.rose, &scene.knob);
    let [height, width, thickness] = [2.0, 0.9, 0.05];
    let middle = scene.door.side * (scene.door.edge - 0.5 * width);
    let cylinder = |radius: f64, length: f64| FixtureShape::Cylinder { radius, length };
    [
        ("door", FixtureShape::Box { size: [height, width, thickness] }, at(0.0, middle, 0.5 * thickness)),
        ("rose", cylinder(rose.radius, rose.thickness), at(0.0, 0.0, -0.5 * rose.thickness)),
        ("knob", cylinder(knob.radius, knob.length), at(0.0, 0.0, -0.5 * knob.length)),
    ]
    .map(|(name, shape, pose)| Fixture { name: name.to_owned(), shape, pose, friction: FRICTION })
    .into()
}

/// A base that is wrong by centimetres and degrees: its pose in the door frame.
fn base_in_door(start: &Isometry3<f64>, own: u64) -> Isometry3<f64> {
    let mut rng = Purpose::BasePlace.rng(own);
    let right = Isometry3::from_parts(Translation3::new(0.0, 0.0, -START), UnitQuaternion::identity())
        * start.inverse();
    let [x, y] = core::array::from_fn(|_| DISPLACEMENT * rng.symmetric());
    let [heading, tilt] = core::array::from_fn(|_| TURN * rng.symmetric());
    let direction = core::f64::consts::PI * rng.symmetric();
    let axis = Vector3::new(direction.cos(), direction.sin(), 0.0);
    let turn = UnitQuaternion::new(Vector3::z() * heading) * UnitQuaternion::new(axis * tilt);
    right * Isometry3::from_parts(Translation3::new(x, y, 0.0), turn)
}

fn board_settings(gripper: u8) -> VisualApproachSettings {
    VisualApproachSettings {
        chain: 0,
        gripper: GripperSettings { joint: gripper, open: -0.98, closed: 0.35, speed: 2.0, torque: 0.8 },
        servo_mode: ServoMode::Pid,
        speed: 0.15,
        acceleration: 0.5,
        contact_force: 18.0,
        reach: 0.5,
    }
}

fn approach_settings(camera: &CameraValues) -> ApproachSettings {
    let mount = camera.mount();
    let row = |distance: f64| {
        let rim = crate::camera::Circle::about_z(distance, 0.04);
        let ellipse = rim.transformed(&mount.inverse()).image(&camera.camera()).unwrap();
        HandEyeRow {
            radius: ellipse.radius() as f32,
            center: ellipse.center.map(|v| v as f32),
            distance: distance as f32,
        }
    };
    let rows: Vec<HandEyeRow> = (0..8).map(|i| row(0.30 - 0.04 * f64::from(i))).collect();
    ApproachSettings {
        table: HandEyeTable::try_new(0.04, camera.tilt as f32, 0.0, &rows).unwrap(),
        expectation: KnobExpectation {
            rose: [0.035, 0.045],
            radius: 0.025,
            length: 0.056,
            distance: [0.13, 0.28],
            aside: 0.06,
        },
        grip_distance: 0.022,
        guard_distance: 0.075,
        tolerance: 0.004,
        speed: 0.12,
        near_speed: 0.05,
        pull: 0.02,
        retries: 3,
        patience: 8.0,
    }
}
