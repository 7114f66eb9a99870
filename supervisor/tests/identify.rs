//! Calibrations: files that are written are read again; what is wrong with one is said in words.
#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::Path;
use std::process::Command;

use tesaki::control::ServoMode;
use tesaki::model::RobotModel;
use tesaki::protocol::{JointTelemetry, Mode, Request, Telemetry, TipTelemetry, Tips};
use tesaki::robot::Robot;
use tesaki::task::grasping::{Failure, GraspCommand, GraspState, GraspTelemetry, InternalForce, Phase};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskConfig};
use tesaki_description::calibration::{Calibration, CalibrationFile};
use tesaki_description::grasp;
use tesaki_description::robot::RobotFolder;
use tesaki_supervisor::BoardError;
use tesaki_supervisor::identify::{
    Estimate, Fit, FreeJoint, Identification, IdentifyError, JointSettings, Machine, NotIdentified, Reading,
    Sense, Settings, board_in_head, duration, identified, identified_free, identify, identify_joints, update,
    update_free, with_head,
};

const ROBOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/hand3");

fn fits() -> Vec<Fit> {
    let estimate = |value| Estimate { value, deviation: 0.001 };
    let known = Fit {
        gain: Ok(estimate(1.1)),
        friction: Ok([estimate(0.018), estimate(0.0025)]),
        load_range: 0.2,
        residual: 0.001,
        readings: 1000,
    };
    let unloaded = NotIdentified::Unloaded { load_range: 0.04, deviation: 0.03 };
    let mut fits = vec![known; 9];
    fits[0].gain = Err(unloaded);
    fits[8].friction = Err(NotIdentified::Implausible { what: "N·m of Coulomb friction", value: -0.1 });
    // Not more than its deviation.
    fits[7].friction = Ok([estimate(0.018), estimate(0.0)]);
    fits
}

#[test]
fn what_is_written_is_read_and_changes_the_model() {
    let mut model = RobotFolder::load(Path::new(ROBOT)).unwrap().model;
    let calibration = identified(&model, &fits());
    let mut file = CalibrationFile::default();
    update(&mut file, &calibration, &model, &fits());
    let text = with_head(&file.to_string(), "hand3", "7");
    assert!(text.starts_with("# hand3, board 7: what"), "{text}");
    assert_eq!((board_in_head(&text, "hand3"), board_in_head(&text, "hand4")), (Some("7"), None));
    assert!(
        text.contains("\n\n[joints.finger1_swing]  # torque constant is not identified, because"),
        "{text}"
    );
    assert!(
        text.contains("[joints.finger1_bend]\ntorque_constant = 0.55000  # N·m/A, ± 0.00050\n"),
        "{text}"
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("calibration.toml");
    std::fs::write(&path, text).unwrap();
    let text = std::fs::read_to_string(&path).unwrap();
    let uncertain = "[joints.finger3_bend]  # viscous friction is not identified, because 0.00 ± 1.00 mN·m·s/rad is not \
        larger than its standard deviation, and is not stored\ntorque_constant = 0.55000";
    assert!(text.contains(uncertain), "{text}");
    let read = Calibration::load(&path).unwrap();
    let folder_viscous = model.joints[7].friction.viscous;
    read.apply(&mut model).unwrap();
    assert!(folder_viscous > 0.0 && model.joints[7].friction.viscous.to_bits() == folder_viscous.to_bits());
    let [swing, bend, .., last] = model.joints.as_slice() else { panic!() };
    let near = |value: f32, wanted: f32| (value - wanted).abs() < 1e-6;
    assert!(near(swing.motor.torque_constant, 0.5) && near(swing.friction.coulomb, 0.018));
    assert!(near(bend.motor.torque_constant, 0.55) && near(bend.friction.viscous, 0.0025));
    assert!(near(last.motor.torque_constant, 0.55) && near(last.friction.coulomb, 0.02));
}

#[test]
fn a_file_keeps_its_comments_when_its_values_change() {
    let model = RobotFolder::load(Path::new(ROBOT)).unwrap().model;
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("calibration.toml");
    let text = "# hand3, board 5: what it was\n# Bought in May.\n\n# The motor was changed.\n[joints.finger1_swing]\n\
        torque_constant = 0.4\n# By hand.\ncoulomb = 0.5 # N·m\n";
    std::fs::write(&path, text).unwrap();
    let mut file = CalibrationFile::open(&path).unwrap();
    update(&mut file, &identified(&model, &fits()), &model, &fits());
    let text = with_head(&file.to_string(), "hand3", "7");
    assert!(text.starts_with("# hand3, board 7: what `tesaki"), "{text}");
    assert!(!text.contains("board 5") && !text.contains("0.4\n"), "{text}");
    for kept in [
        "standard deviations.\n# Bought in May.\n\n# The motor was changed.\n[joints.finger1_swing]  # torque constant is",
        "\n# By hand.\ncoulomb = 0.018000  # N·m, ± 0.001000\n",
    ] {
        assert!(text.contains(kept), "{kept:?} in {text}");
    }
    std::fs::write(&path, "[joint.finger1_swing]").unwrap();
    let said = CalibrationFile::open(&path).unwrap_err().to_string();
    assert!(said.contains("calibration.toml") && said.contains("unknown field `joint`"), "{said}");
}

#[test]
fn a_calibration_that_does_not_fit_changes_nothing() {
    let mut model = RobotFolder::load(Path::new(ROBOT)).unwrap().model;
    let before = model.clone();
    let mut complain = |text: &str| {
        let calibration: Calibration = toml::from_str(text).unwrap();
        calibration.apply(&mut model).unwrap_err().to_string()
    };
    let said = complain("[joints.finger4_bend]\ncoulomb = 0.02");
    assert!(said.contains("[joints.finger4_bend]") && said.contains("finger1_swing, finger1_bend"), "{said}");
    let said = complain("[joints.finger1_bend]\ncoulomb = 0.03\ntorque_constant = -0.5");
    assert!(
        said.contains("finger1_bend: motor.torque_constant = -0.5 N·m/A must be above 0 N·m/A"),
        "{said}"
    );
    let said = complain("[joints.finger1_bend]\ncoulomb = 0.61");
    assert!(said.contains("finger1_bend: Coulomb friction 0.61 N·m is not below the motor's"), "{said}");
    assert_eq!(model, before);
}

/// A hand on a line that loses frames. What its tips feel in a tick is what its joints were told a tick
/// before, and nothing else.
struct Stub {
    /// One frame in so many is lost.
    loses: u32,
    /// A grip that it cannot make [N], and what it says then.
    weak: Option<(f32, Failure)>,
    start: Vec<f32>,
    tick: u32,
    task: TaskConfig,
    phase: Phase,
    failure: Option<Failure>,
    /// For so many ticks after the object was put down, a joint jerks; until this tick it does.
    jerk: u32,
    jerks_until: u32,
    said: Vec<String>,
}

#[derive(Debug, thiserror::Error)]
enum Trouble {
    #[error(transparent)]
    Board(#[from] BoardError),
    #[error(transparent)]
    Identify(#[from] IdentifyError),
}

/// A force that differs from tick to tick as if by chance.
fn force(tick: u32) -> f32 {
    f32::from(u8::try_from((tick.wrapping_mul(2_654_435_761) >> 20) % 200).unwrap()) / 100.0 - 1.0
}

impl Machine for Stub {
    type Error = Trouble;

    fn ask(&mut self, _: &'static str, request: Request) -> Result<(), Trouble> {
        match request {
            Request::Enable(task) => {
                assert!(self.tick >= self.jerks_until, "a board refuses to be enabled in motion");
                self.task = task;
            }
            Request::Task(TaskCommand::Grasping(GraspCommand::Grasp(plan))) => {
                let InternalForce::Normal { strength } = plan.internal else { panic!("{plan:?}") };
                let weak = self.weak.filter(|(weak, _)| (weak - strength).abs() < 1e-6);
                self.failure = weak.map(|(_, failure)| failure);
                self.phase = if weak.is_some() { Phase::Ready } else { Phase::Hold };
            }
            Request::Task(TaskCommand::Grasping(GraspCommand::PutDown)) => {
                self.phase = Phase::Ready;
                self.jerks_until = self.tick + self.jerk;
            }
            _ => {}
        }
        Ok(())
    }

    fn read_grasp(&mut self) -> Result<GraspTelemetry, Trouble> {
        let telemetry = GraspState::NONE.telemetry();
        Ok(GraspTelemetry { phase: self.phase, failure: self.failure, ..telemetry })
    }

    fn tick(&mut self, _: Request) -> Result<Sense, Trouble> {
        self.tick += 1 + u32::from(self.tick.is_multiple_of(self.loses));
        let speed = if self.tick < self.jerks_until { 1.3 } else { 0.1 };
        let velocity = if (self.tick / 7).is_multiple_of(2) { speed } else { -speed };
        let torque = force(self.tick + 1);
        let joint = |&position: &f32| JointTelemetry { position, velocity, reference: position, torque };
        let tip = TipTelemetry { force: [0.0, 0.0, force(self.tick)], ..TipTelemetry::default() };
        let joints = self.start.iter().map(joint).collect();
        let telemetry =
            Telemetry { tick: self.tick, mode: Mode::Enabled(self.task.kind()), faults: 0, joints };
        Ok(Sense { telemetry, tips: Tips { tick: self.tick, tips: [tip; 3].into_iter().collect() } })
    }

    fn progress(&mut self, text: &str) {
        self.said.push(text.to_owned());
    }
}

fn stub(
    loses: u32,
    weak: Option<(f32, Failure)>,
    strengths: &[f32],
) -> (Stub, Result<Identification, Trouble>) {
    jerking_stub(0, loses, weak, strengths)
}

fn jerking_stub(
    jerk: u32,
    loses: u32,
    weak: Option<(f32, Failure)>,
    strengths: &[f32],
) -> (Stub, Result<Identification, Trouble>) {
    let model = RobotFolder::load(Path::new(ROBOT)).unwrap().model;
    let plan = grasp::load(&Path::new(ROBOT).join("grasps/box.toml")).unwrap();
    let middle = |joint: &tesaki::model::JointModel| 0.5 * (joint.limits.lower + joint.limits.upper);
    let mut stub = Stub {
        loses,
        weak,
        start: model.joints.iter().map(middle).collect(),
        tick: 0,
        task: TaskConfig::Grasping(()),
        phase: Phase::Ready,
        failure: None,
        jerk,
        jerks_until: 0,
        said: Vec::new(),
    };
    let settings = Settings { strengths: strengths.to_vec(), ..Settings::default() };
    let found = identify(&mut stub, &model, &plan, &settings);
    (stub, found)
}

/// A board refuses to be enabled with a joint at a fifth of its velocity limit.
#[test]
fn a_joint_that_jerks_when_the_object_was_put_down_does_not_end_the_identification() {
    let (line, found) = jerking_stub(20, u32::MAX, None, &[2.0, 6.0]);
    assert!(found.is_ok(), "{found:?}");
    assert!(line.jerks_until > 0);
}

#[test]
fn a_lost_frame_costs_a_reading_and_spoils_none() {
    let (_, all) = stub(u32::MAX, None, &[2.0, 6.0]);
    let (_, some) = stub(40, None, &[2.0, 6.0]);
    let (all, some) = (all.unwrap().fits, some.unwrap().fits);
    for (index, (all, some)) in all.iter().zip(&some).enumerate() {
        // The load of the first joint of a finger may be nearly none in this posture.
        if all.load_range > 1e-3 {
            assert!(all.residual < 1e-5 && some.residual < 1e-5, "{index}: {all:?} {some:?}");
        }
        let lost = all.readings - some.readings;
        assert!(lost > all.readings / 50 && lost < all.readings / 30, "{lost} of {}", all.readings);
    }
}

#[test]
fn a_grip_that_cannot_be_made_is_left_out_if_two_others_can() {
    let slack = Failure::NoGrip { force: 2.1, limit: 3.0 };
    let (line, found) = stub(u32::MAX, Some((6.0, slack)), &[2.0, 6.0, 4.0]);
    let found = found.unwrap();
    let [grip] = found.failed[..] else { panic!("{:?}", found.failed) };
    assert!((grip.strength - 6.0).abs() < 1e-6 && grip.failure == slack && found.fits.len() == 9);
    let said = grip.to_string();
    assert!(said.starts_with("a grip of 6 N was not made: the grip did not converge within 3 s"), "{said}");
    let at = line.said.iter().position(|text| *text == said).unwrap();
    assert_eq!(line.said[at + 1], "a grip of 4 N");
    // The same twice is one.
    for strengths in [&[2.0, 6.0][..], &[2.0, 6.0, 2.0], &[6.0, 4.0]] {
        let (_, found) = stub(u32::MAX, Some((6.0, slack)), strengths);
        let said = found.unwrap_err().to_string();
        let wanted = "two different grips are needed, and 1 could be made; others with --grips";
        assert!(said.starts_with("a grip of 6 N was not made") && said.ends_with(wanted), "{said}");
    }
    // Whatever else goes wrong ends it.
    let nothing = Failure::NoObject { finger: 1, distance: 0.02 };
    let (line, found) = stub(u32::MAX, Some((6.0, nothing)), &[2.0, 6.0, 4.0]);
    let said = found.unwrap_err().to_string();
    assert!(
        said.starts_with("with a grip of 6 N the hand is ready, and not as asked: finger 2 found no surface"),
        "{said}"
    );
    assert_eq!(line.said.last().unwrap(), "a grip of 6 N");
}

/// A hand whose joints follow at once, with friction by numbers; its drives make 1.25 of what they are told.
struct Follower {
    /// For the weight of its links.
    robot: Box<Robot>,
    position: Vec<f32>,
    /// Of the last set-point: velocity and acceleration.
    motion: Vec<[f32; 2]>,
    tick: u32,
    /// From this tick on a joint is blocked, or a tip is touched.
    blocked: u32,
    touched: u32,
    positions: Vec<(f32, f32)>,
    /// One set-point in so many comes too late for its tick, and is then overtaken by the next one.
    late: u32,
    said: Vec<String>,
}

const GAIN: f32 = 1.25;
/// N·m, N·m·s/rad, kg·m².
const FRICTION: [f32; 3] = [0.03, 0.004, 3e-5];

impl Machine for Follower {
    type Error = Trouble;

    fn ask(&mut self, _: &'static str, _: Request) -> Result<(), Trouble> {
        Ok(())
    }

    fn read_grasp(&mut self) -> Result<GraspTelemetry, Trouble> {
        Ok(GraspState::NONE.telemetry())
    }

    fn tick(&mut self, request: Request) -> Result<Sense, Trouble> {
        let is_late = (self.tick + 1).is_multiple_of(self.late);
        let leaps = self.tick > 0 && self.tick.is_multiple_of(self.late);
        if is_late {
            self.motion.fill([0.0; 2]);
        } else if let Request::Task(TaskCommand::JointServo(JointCommand::Stream { points })) = request {
            for ((position, motion), point) in self.position.iter_mut().zip(&mut self.motion).zip(&points) {
                (*position, *motion) = (point.position, [point.velocity, point.acceleration]);
            }
        }
        for ((low, high), &position) in self.positions.iter_mut().zip(&self.position) {
            (*low, *high) = (low.min(position), high.max(position));
        }
        self.tick += 1;
        let [coulomb, viscous, inertia] = FRICTION;
        let extra = if self.tick > self.blocked { 0.2 } else { 0.0 };
        let weights = self.robot.gravity_torques(&self.position);
        let joint = |((&position, &[velocity, acceleration]), weight): ((&f32, &[f32; 2]), f32)| {
            // Of the period that begins now, whose middle is half a period later.
            let velocity = velocity + 0.005 * acceleration;
            let own = weight + coulomb * velocity.signum() + viscous * velocity + inertia * acceleration;
            // The servo brakes, and then hurries.
            let kick = if is_late { -3.0 } else { f32::from(leaps) * 3.0 } * velocity.signum();
            JointTelemetry { position, velocity, reference: position, torque: own / GAIN + extra + kick }
        };
        let joints = self.position.iter().zip(&self.motion).zip(weights).map(joint).collect();
        let telemetry = Telemetry {
            tick: self.tick,
            mode: Mode::Enabled(TaskConfig::JointServo(ServoMode::Observer).kind()),
            faults: 0,
            joints,
        };
        let force = if self.tick > self.touched { [0.0, 1.5, 0.0] } else { [0.3, 0.0, 0.0] };
        let tip = TipTelemetry { force, ..TipTelemetry::default() };
        Ok(Sense { telemetry, tips: Tips { tick: self.tick, tips: [tip; 3].into_iter().collect() } })
    }

    fn progress(&mut self, text: &str) {
        self.said.push(text.to_owned());
    }
}

/// The self-test of hand3 with links of so many times their mass: the machine, its model and its readings.
fn self_test(
    mass: f32,
    change: impl FnOnce(&mut Follower),
) -> (Follower, RobotModel, Result<Vec<Vec<Reading>>, Trouble>) {
    let mut model = RobotFolder::load(Path::new(ROBOT)).unwrap().model;
    model.gravity = model.gravity.map(|gravity| mass * gravity);
    let mut robot = Box::new(Robot::NONE);
    robot.configure(&model).unwrap();
    let position: Vec<f32> =
        model.joints.iter().map(|joint| 0.5 * (joint.limits.lower + joint.limits.upper)).collect();
    let motion = vec![[0.0; 2]; position.len()];
    let positions = position.iter().map(|&position| (position, position)).collect();
    let (blocked, touched, late) = (u32::MAX, u32::MAX, u32::MAX);
    let said = Vec::new();
    let mut machine = Follower { robot, position, motion, tick: 0, blocked, touched, positions, late, said };
    change(&mut machine);
    let readings = identify_joints(&mut machine, &model, &JointSettings::default());
    (machine, model, readings)
}

fn found(model: &RobotModel, readings: &[Vec<Reading>], weighed: bool, known: Option<f32>) -> Vec<FreeJoint> {
    let joints = model.joints.iter().zip(readings);
    joints.map(|(joint, readings)| FreeJoint::identify(joint, readings, weighed, known)).collect()
}

#[test]
fn the_self_test_finds_friction_in_told_torque_and_keeps_the_limits() {
    // One joint stands at the end of its range.
    let (machine, model, readings) =
        self_test(0.0, |machine| (machine.position[4], machine.positions[4]) = (1.7, (1.7, 1.7)));
    let readings = readings.unwrap();
    let free = found(&model, &readings, false, None);
    for (found, (joint, &(low, high))) in free.iter().zip(model.joints.iter().zip(&machine.positions)) {
        let fit = found.friction.unwrap();
        let found = [fit.coulomb.value, fit.viscous.value, fit.inertia.value];
        for ((found, truth), tolerance) in found.iter().zip(FRICTION).zip([0.02, 0.02, 0.1]) {
            let told = f64::from(truth / GAIN);
            assert!((found / told - 1.0).abs() < tolerance, "{}: {found} {told}", joint.name);
        }
        assert!(fit.offset.value.abs() < 1e-4, "{fit:?}");
        assert!(
            low >= joint.limits.lower && high <= joint.limits.upper && high - low < 0.23,
            "{}: {low} {high}",
            joint.name
        );
    }
    let start: Vec<f64> = machine.position.iter().map(|&angle| angle.into()).collect();
    assert!(!machine.said.iter().any(|said| said.contains("late")), "{:?}", machine.said);
    let time = duration(&model, &start, &JointSettings::default()).unwrap();
    assert!(time < 20.0 && (time - f64::from(machine.tick) * 0.01).abs() < 0.1, "{time} {}", machine.tick);

    // A drive with another torque constant makes another torque of the same current.
    let constant = GAIN * model.joints[0].motor.torque_constant;
    let known = found(&model, &readings, false, Some(constant));
    for found in &known {
        let coulomb = found.friction.unwrap().coulomb.value;
        assert!((coulomb / f64::from(FRICTION[0]) - 1.0).abs() < 0.02, "{coulomb}");
    }
    let mut file: CalibrationFile = open("[joints.finger3_curl]\ntorque_constant = 0.625 # by hand\n");
    update_free(&mut file, &model, &known);
    let text = file.to_string();
    assert!(
        text.contains("[joints.finger3_curl]\ntorque_constant = 0.625 # by hand\ncoulomb = 0.029"),
        "{text}"
    );
    assert!(text.contains("[joints.finger1_curl]\ncoulomb = 0.029"), "{text}");
    // Without weight, no torque constant.
    let said = found(&model, &readings, true, None)[0].torque_constant.unwrap().unwrap_err().to_string();
    assert!(said.contains("weight of its links, at most 0.000 N·m, is too small"), "{said}");
}

/// 0.00 ± 1.00 mN·m·s/rad of a joint says nothing about its viscous friction.
#[test]
fn friction_that_is_not_larger_than_its_deviation_is_not_stored() {
    let (_, mut model, readings) = self_test(0.0, |_| {});
    let mut found = found(&model, &readings.unwrap(), false, None);
    for (found, value) in found.iter_mut().zip([0.0, 0.0005, 0.0011]) {
        found.friction.as_mut().unwrap().viscous = Estimate { value, deviation: 0.001 };
    }
    let mut file = open("[joints.finger1_bend]\nviscous = 0.004\n");
    update_free(&mut file, &model, &found);
    let text = file.to_string();
    let of = |joint: &str| {
        let table = text.split("[joints.").find(|table| table.starts_with(joint)).unwrap();
        table.lines().find(|line| line.starts_with("viscous"))
    };
    let names = [0, 1, 2].map(|joint: usize| model.joints[joint].name.to_string());
    let lines = names.each_ref().map(|name| of(name));
    // The first has that of its robot folder, the second the one that the file had.
    assert_eq!(lines[..2], [None, Some("viscous = 0.004")], "{text}");
    assert!(lines[2].is_some_and(|line| line.starts_with("viscous = 0.001100")), "{text}");
    assert!(text.contains("[joints.finger1_swing]\ncoulomb = "), "{text}");
    let folder = model.joints[0].friction.viscous;
    identified_free(&model, &found).apply(&mut model).unwrap();
    assert_eq!(model.joints[0].friction.viscous.to_bits(), folder.to_bits());
    let said = found[0].viscous().unwrap_err().to_string();
    assert!(said.contains("0.00 ± 1.00 mN·m·s/rad"), "{said}");
}

fn open(text: &str) -> CalibrationFile {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("calibration.toml");
    std::fs::write(&path, text).unwrap();
    CalibrationFile::open(&path).unwrap()
}

/// A light joint keeps the torque constant that the file has, and its friction is in the torque of that.
#[test]
fn weighed_links_tell_the_torque_constants_that_they_can() {
    let (_, mut model, readings) = self_test(10.0, |_| {});
    let mut readings = readings.unwrap();
    let told = model.joints[0].motor.torque_constant;
    // The first joint: as if its links weighed nothing.
    for reading in &mut readings[0] {
        reading.torque -= reading.weights.iter().sum::<f64>() / f64::from(GAIN);
        reading.weights.fill(0.0);
    }
    let found = found(&model, &readings, true, Some(GAIN * told));
    let mut constants = 0;
    for (joint, found) in model.joints.iter().zip(&found) {
        if let Ok(constant) = found.torque_constant.unwrap() {
            assert!(
                (constant.value / f64::from(GAIN * told) - 1.0).abs() < 0.01,
                "{}: {constant:?}",
                joint.name
            );
            constants += 1;
        }
        let fit = found.friction.unwrap();
        assert!((fit.coulomb.value / f64::from(FRICTION[0]) - 1.0).abs() < 0.02, "{}: {fit:?}", joint.name);
    }
    assert!(constants >= 3 && found[0].torque_constant.unwrap().is_err(), "{constants}");
    let mut file = open("[joints.finger1_swing]\ntorque_constant = 0.625\n");
    update_free(&mut file, &model, &found);
    let text = file.to_string();
    assert!(text.contains("[joints.finger1_swing]\ntorque_constant = 0.625\ncoulomb = 0.029"), "{text}");
    identified_free(&model, &found).apply(&mut model).unwrap();
    assert!((model.joints[0].motor.torque_constant - told).abs() < 1e-6);
    assert!((model.joints[1].motor.torque_constant / (GAIN * told) - 1.0).abs() < 0.01);
}

/// The self-test of a joint must not need, for its inertia, the torque that shows something in the way.
#[test]
fn heavy_joints_sweep_more_slowly() {
    let settings = JointSettings::default();
    for (robot, time) in [("hand3", 10.8), ("arm7", 25.2)] {
        let folder = Path::new(ROBOT).parent().unwrap().join(robot);
        let mut model = RobotFolder::load(&folder).unwrap().model;
        let start = vec![0.4; model.joints.len()];
        let usual = duration(&model, &start, &settings).unwrap();
        assert!((usual - time).abs() < 0.1, "{robot}: {usual} s");
        for joint in &mut model.joints {
            joint.servo.observer.inertia *= 1000.0;
        }
        let slow = duration(&model, &start, &settings).unwrap();
        assert!(slow > 1.5 * usual, "{robot}: {slow} s");
        let less = JointSettings { torque: 0.5 * settings.torque, ..settings };
        let ratio = duration(&model, &start, &less).unwrap() / slow;
        assert!((ratio - 2.0_f64.sqrt()).abs() < 0.01, "{robot}: {ratio}");
    }
}

#[test]
fn the_self_test_ends_where_something_is_in_the_way() {
    let (_, _, readings) = self_test(0.0, |machine| machine.blocked = 50);
    let said = readings.unwrap_err().to_string();
    assert!(said.starts_with("finger1_swing needs +0.2") && said.contains("may have 0.150 N·m"), "{said}");
    let (_, _, readings) = self_test(0.0, |machine| machine.touched = 50);
    let said = readings.unwrap_err().to_string();
    // From (0.3, 0, 0) to (0, 1.5, 0) N.
    assert!(said.contains("finger1_tip changed by 1.53 N, and may by 1.00 N"), "{said}");
}

/// A busy computer sends a set-point late: the reference stands still for a tick, then leaps, and so does the
/// torque. That is neither friction nor something in the way.
#[test]
fn late_set_points_are_named_and_do_not_count_as_readings() {
    let (machine, model, readings) = self_test(0.0, |machine| machine.late = 53);
    let told = machine.said.last().unwrap();
    let ticks = machine.tick - 1;
    // The stop and the leap.
    let irregular = 2 * (machine.tick / 53);
    assert_eq!(
        *told,
        format!(
            "set-points came late in {irregular} of {ticks} ticks: this computer is busy; the readings near them are \
             left out"
        )
    );
    for found in found(&model, &readings.unwrap(), false, None) {
        let fit = found.friction.unwrap();
        for (found, truth) in [(fit.coulomb.value, FRICTION[0]), (fit.viscous.value, FRICTION[1])] {
            assert!((found * f64::from(GAIN / truth) - 1.0).abs() < 0.02, "{found} {truth}");
        }
    }
    let (machine, _, readings) = self_test(0.0, |machine| machine.late = 20);
    let said = readings.unwrap_err().to_string();
    assert!(said.starts_with("set-points came late in ") && said.contains("end other programs"), "{said}");
    assert!(machine.tick > 100, "{}", machine.tick);
    // What is in the way is found all the same.
    let (_, _, readings) = self_test(0.0, |machine| (machine.late, machine.blocked) = (53, 50));
    let said = readings.unwrap_err().to_string();
    assert!(said.starts_with("finger1_swing needs +0.2"), "{said}");
}

/// Exit code and complaint of `tesaki`.
fn complaint(arguments: &[&str]) -> (i32, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_tesaki")).args(arguments).output().unwrap();
    (output.status.code().unwrap(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn the_command_line_says_what_is_wrong_before_anything_moves() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("calibration.toml");
    std::fs::write(&path, "[joints.finger1_bend]\ncolumb = 0.02\n").unwrap();
    let file = path.to_str().unwrap();
    let (code, said) = complaint(&["model", "push", ROBOT, "--calibration", file]);
    assert_eq!(code, 1, "{said}");
    assert!(said.contains(&format!("{file}:2: ")) && said.contains("columb"), "{said}");
    // That of another robot.
    std::fs::write(&path, "[joints.elbow]\ncoulomb = 0.02\n").unwrap();
    let (code, said) = complaint(&["model", "push", ROBOT, "--calibration", file]);
    assert_eq!(code, 1, "{said}");
    let told = [
        &*format!("{file}: [joints.elbow]: hand3 has no such joint"),
        "of another robot",
        "leave --calibration",
    ];
    assert!(told.iter().all(|words| said.contains(words)), "{said}");
    let grasp = concat!(env!("CARGO_MANIFEST_DIR"), "/../robots/hand3/grasps/box.toml");
    let (code, said) = complaint(&["identify", grasp, "--grips", "3"]);
    assert!(code == 2 && said.contains("at least two different forces above 0 N and at most 9 N"), "{said}");
    let (code, said) = complaint(&["identify", grasp, "--grips", "3,12"]);
    assert!(code == 2 && said.contains("at least two"), "{said}");
    let (code, said) = complaint(&["identify", grasp, "--grips", "3,3"]);
    assert!(code == 2 && said.contains("different"), "{said}");
    let (code, said) = complaint(&["identify", grasp, "--amplitude", "2"]);
    assert!(code == 2 && said.contains("0.03 to 0.5 rad"), "{said}");
}
