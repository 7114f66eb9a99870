//! `host-sim serve`: a simulated board in real time, for `tesaki` and other clients.

use std::io::{self, BufRead};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use rapier3d::na::Vector3;
use tesaki::model::{JointModel, RobotModel};
use tesaki::protocol::{ActuatorFrame, SensorFlags, SensorFrame};
use tesaki::robot::Robot;
use tesaki_output::{note, quoted};
use tesaki_supervisor::hub::Hub;
use tesaki_supervisor::{BoardError, ByteLink};

use crate::plant::{Hold, Plant, PlantError};
use crate::qemu::Qemu;
use crate::served_camera::ServedCamera;
use crate::virtual_board::VirtualBoard;

/// The control period.
const PERIOD: Duration = Duration::from_millis(10);
/// A larger delay than this is not made up for.
const MAX_DELAY: Duration = Duration::from_millis(100);

/// A board whose sensors and drives are simulated, and whose supervisor link is bytes.
pub trait ServedBoard {
    /// Passes bytes of the clients to the board, and appends the board's bytes to `out`.
    ///
    /// # Errors
    /// The board does not answer.
    fn exchange(&mut self, bytes: &[u8], out: &mut Vec<u8>) -> io::Result<()>;

    /// One control period.
    ///
    /// # Errors
    /// The board does not answer.
    fn tick(&mut self, sensors: &SensorFrame, out: &mut Vec<u8>) -> Result<ActuatorFrame, BoardError>;

    /// The model on the board, if it is known: its torque constants convert torques into currents.
    fn model(&self) -> Option<&RobotModel> {
        None
    }

    /// Presses the reset button.
    ///
    /// # Errors
    /// The board does not answer.
    fn reset(&mut self) -> Result<(), BoardError>;
}

impl ServedBoard for VirtualBoard {
    fn exchange(&mut self, bytes: &[u8], out: &mut Vec<u8>) -> io::Result<()> {
        self.receive(bytes, out);
        Ok(())
    }

    fn tick(&mut self, sensors: &SensorFrame, out: &mut Vec<u8>) -> Result<ActuatorFrame, BoardError> {
        Ok(self.tick(sensors, out))
    }

    fn model(&self) -> Option<&RobotModel> {
        self.node().robot().map(Robot::model)
    }

    fn reset(&mut self) -> Result<(), BoardError> {
        self.reset();
        Ok(())
    }
}

impl ServedBoard for Qemu {
    fn exchange(&mut self, bytes: &[u8], out: &mut Vec<u8>) -> io::Result<()> {
        if !bytes.is_empty() {
            self.link_mut().send(bytes)?;
        }
        self.listen_to_link(out)
    }

    fn tick(&mut self, sensors: &SensorFrame, out: &mut Vec<u8>) -> Result<ActuatorFrame, BoardError> {
        self.tick_and_listen(sensors, out)
    }

    fn reset(&mut self) -> Result<(), BoardError> {
        Self::reset(self)
    }
}

/// Why the simulated board stopped.
#[derive(Debug, thiserror::Error)]
pub enum ServeError {
    /// The link to the clients failed.
    #[error("the link to the clients failed: {0}")]
    Hub(#[from] io::Error),
    /// The board failed.
    #[error(transparent)]
    Board(#[from] BoardError),
    /// The plant failed.
    #[error(transparent)]
    Plant(#[from] PlantError),
}

/// Commands on standard input while the machine runs: they inject faults, and act on its tips.
pub const COMMANDS: &str = "  estop on|off           press or release the emergency stop
  supply VOLTS           change the supply voltage
  encoder JOINT COUNTS   make an encoder jump by this many counts
  freeze JOINT           freeze an encoder; again: release it
  reset                  press the board's reset button
  angles                 say how to home the machine where it is now, for example after it fell
  pull X Y Z | off       pull the first tip so far from where it is [m], as a person's arm does (500 N/m); let go
  wall X Y Z N/M | off   put up a wall of this stiffness, so far ahead of the tips [m]; take all walls away";

/// Stiffness and damping of the arm of a person who pulls [N/m, N·s/m].
const PULL: (f64, f64) = (500.0, 25.0);
/// Speed of a pull [m/s], and its shortest duration [s].
const PULL_SPEED: f64 = 0.05;
const MIN_PULL: f64 = 0.5;
/// Farthest pull, and farthest wall [m].
const FARTHEST: f64 = 1.0;
/// Stiffest wall [N/m].
const STIFFEST: f64 = 1e5;

/// A command.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Command {
    Fault(SensorFault),
    Reset,
    /// Say where the joints are.
    Angles,
    /// By so much [m].
    Pull(Vector3<f64>),
    LetGo,
    /// So far away [m], of this stiffness [N/m].
    Wall(Vector3<f64>, f64),
    NoWalls,
}

/// A fault to inject.
#[derive(Clone, Copy, Debug, PartialEq)]
enum SensorFault {
    EmergencyStop(bool),
    Supply(u16),
    Jump(usize, i32),
    Freeze(usize),
}

fn parse(line: &str, model: &RobotModel) -> Result<Option<Command>, String> {
    let joint = |name: &str| {
        model.joints.iter().position(|joint| joint.name == name).ok_or_else(|| {
            let names: Vec<&str> = model.joints.iter().map(|joint| joint.name.as_str()).collect();
            format!("there is no joint {name:?}; the joints are {}", names.join(", "))
        })
    };
    let words: Vec<&str> = line.split_whitespace().collect();
    let fault = match words[..] {
        [] => return Ok(None),
        ["estop", "on"] => SensorFault::EmergencyStop(true),
        ["estop", "off"] => SensorFault::EmergencyStop(false),
        ["supply", volts] => match volts.parse::<f32>() {
            Ok(volts) if (0.0..=65.0).contains(&volts) => SensorFault::Supply((volts * 1000.0) as u16),
            _ => return Err(format!("{volts:?} is not a voltage from 0 to 65 V")),
        },
        ["encoder", name, counts] => {
            let counts = counts.parse().map_err(|_| format!("{counts:?} is not a number of counts"))?;
            SensorFault::Jump(joint(name)?, counts)
        }
        ["freeze", name] => SensorFault::Freeze(joint(name)?),
        ["reset"] => return Ok(Some(Command::Reset)),
        ["angles"] => return Ok(Some(Command::Angles)),
        ["pull", "off"] => return Ok(Some(Command::LetGo)),
        ["pull", x, y, z] => return Ok(Some(Command::Pull(displacement([x, y, z])?))),
        ["wall", "off"] => return Ok(Some(Command::NoWalls)),
        ["wall", x, y, z, stiffness] => {
            let ahead = displacement([x, y, z])?;
            return match stiffness.parse::<f64>() {
                Ok(value) if value > 0.0 && value <= STIFFEST => Ok(Some(Command::Wall(ahead, value))),
                _ => Err(format!("{stiffness:?} is not a stiffness above 0, at most {STIFFEST} N/m")),
            };
        }
        ["help"] => return Err(format!("Commands:\n{COMMANDS}")),
        [name, ..] => {
            let line = line.trim();
            return Err(match COMMANDS.lines().find(|usage| usage.split_whitespace().next() == Some(name)) {
                Some(usage) => format!("{line:?} is not complete, or has too much. The command is:\n{usage}"),
                None => format!("unknown command {line:?}. The commands are:\n{COMMANDS}"),
            });
        }
    };
    Ok(Some(Command::Fault(fault)))
}

fn displacement(words: [&str; 3]) -> Result<Vector3<f64>, String> {
    let mut vector = Vector3::zeros();
    for (number, word) in vector.iter_mut().zip(words) {
        *number = word.parse().map_err(|_| format!("{word:?} is not a number of metres"))?;
    }
    let length = vector.norm();
    if length > 0.0 && length <= FARTHEST {
        Ok(vector)
    } else {
        Err(format!("{length} m is not above 0 and at most {FARTHEST} m"))
    }
}

/// What a command has done.
fn done(command: Command, faults: &SensorFaults, plant: &Plant, model: &RobotModel) -> String {
    let meters = |by: Vector3<f64>| format!("{}, {}, {} m", by.x, by.y, by.z);
    match command {
        Command::Fault(SensorFault::EmergencyStop(true)) => "the emergency stop is pressed".to_owned(),
        Command::Fault(SensorFault::EmergencyStop(false)) => "the emergency stop is released".to_owned(),
        Command::Fault(SensorFault::Supply(millivolts)) => {
            format!("the supply is {} V", f64::from(millivolts) / 1000.0)
        }
        Command::Fault(SensorFault::Jump(joint, counts)) => {
            format!("the encoder of {} has jumped by {counts} counts", model.joint_name(joint))
        }
        Command::Fault(SensorFault::Freeze(joint)) => {
            let frozen = faults.frozen.get(joint).copied().flatten().is_some();
            let state = if frozen { "is frozen" } else { "runs again" };
            format!("the encoder of {} {state}", model.joint_name(joint))
        }
        Command::Reset => "the board was reset: it has no model".to_owned(),
        Command::Angles => home_command(plant, model)
            .unwrap_or_else(|| "all encoders are absolute: there is nothing to home".to_owned()),
        Command::Pull(by) => format!(
            "a person pulls the first tip by {} from where it is, with 500 N/m; `pull off` lets it go",
            meters(by)
        ),
        Command::LetGo => "the first tip is let go".to_owned(),
        Command::Wall(ahead, stiffness) => {
            format!("a wall of {stiffness} N/m is {} ahead of the tips", meters(ahead))
        }
        Command::NoWalls => "the walls are taken away".to_owned(),
    }
}

/// What a person does to the machine.
fn touch(plant: &mut Plant, command: Command) -> Result<(), PlantError> {
    match command {
        Command::Pull(by) => {
            let Some(tip) = plant.tips().into_iter().next() else { return Ok(()) };
            let hold = Hold {
                position: (Vector3::from(tip.position) + by).into(),
                orientation: tip.orientation,
                ramp: (by.norm() / PULL_SPEED).max(MIN_PULL),
                stiffness: PULL.0,
                damping: PULL.1,
                rotational_stiffness: 0.0,
                rotational_damping: 0.0,
            };
            plant.hold_tip(0, hold)
        }
        Command::LetGo => plant.release_tip(0, 0.0),
        Command::Wall(ahead, stiffness) => plant.insert_wall_ahead(ahead.into(), ahead.norm(), stiffness),
        Command::NoWalls => {
            plant.remove_walls();
            Ok(())
        }
        Command::Fault(_) | Command::Reset | Command::Angles => Ok(()),
    }
}

/// Active faults of the sensors.
#[derive(Default)]
struct SensorFaults {
    emergency_stop: bool,
    supply: Option<u16>,
    offsets: Vec<i32>,
    frozen: Vec<Option<i32>>,
    last: Vec<i32>,
}

impl SensorFaults {
    fn inject(&mut self, fault: SensorFault, joints: usize) {
        self.offsets.resize(joints, 0);
        self.frozen.resize(joints, None);
        match fault {
            SensorFault::EmergencyStop(pressed) => self.emergency_stop = pressed,
            SensorFault::Supply(millivolts) => self.supply = Some(millivolts),
            SensorFault::Jump(joint, counts) => {
                self.offsets[joint] = self.offsets[joint].wrapping_add(counts)
            }
            SensorFault::Freeze(joint) => {
                let count = self.last.get(joint).copied().unwrap_or(0);
                self.frozen[joint] = if self.frozen[joint].is_none() { Some(count) } else { None };
            }
        }
    }

    fn apply(&mut self, frame: &mut SensorFrame) {
        if self.emergency_stop {
            frame.flags = SensorFlags(frame.flags.0 | SensorFlags::EMERGENCY_STOP);
        }
        frame.supply = self.supply.unwrap_or(frame.supply);
        for (index, count) in frame.encoders.iter_mut().enumerate() {
            *count = count.wrapping_add(self.offsets.get(index).copied().unwrap_or(0));
            *count = self.frozen.get(index).copied().flatten().unwrap_or(*count);
        }
        self.last = frame.encoders.to_vec();
    }
}

/// Longest line that is read [bytes].
const MAX_LINE: u64 = 1 << 10;

/// The lines of standard input, until it ends.
pub fn input_lines() -> Receiver<String> {
    let (sender, receiver) = channel();
    std::thread::spawn(move || {
        let mut input = io::stdin().lock();
        while let Some(line) = next_line(&mut input)
            && sender.send(line).is_ok()
        {}
    });
    receiver
}

/// `None` at the end. A line that is not UTF-8, or that is cut because it is too long, is not a command, and
/// does not end them.
fn next_line(input: &mut impl BufRead) -> Option<String> {
    let mut bytes = Vec::new();
    let length = io::Read::take(&mut *input, MAX_LINE).read_until(b'\n', &mut bytes).ok()?;
    let mut line = String::from_utf8_lossy(&bytes).into_owned();
    if length as u64 == MAX_LINE && bytes.last() != Some(&b'\n') {
        line.push('…');
        input.skip_until(b'\n').ok()?;
    }
    (length > 0).then_some(line)
}

/// Runs plant and board in real time until `stop` returns true, and the camera if there is one. A board that
/// is slower than real time runs as fast as it can. Executes the commands in `lines`, see [`COMMANDS`].
///
/// # Errors
/// Board, plant or the link to the clients failed.
pub fn serve(
    hub: &mut Hub,
    board: &mut dyn ServedBoard,
    plant: &mut Plant,
    model: &RobotModel,
    camera: Option<&ServedCamera>,
    lines: &Receiver<String>,
    stop: &dyn Fn() -> bool,
) -> Result<(), ServeError> {
    let mut sensor_faults = SensorFaults::default();
    let (mut requests, mut answers) = (Vec::new(), Vec::new());
    let mut sequence = 0_u32;
    let mut next = Instant::now();
    while !stop() {
        sequence = sequence.wrapping_add(1);
        let mut sensors = plant.sensors(sequence);
        sensor_faults.apply(&mut sensors);
        if let Some(camera) = camera {
            camera.tick(plant, sequence);
        }
        let actuators = board.tick(&sensors, &mut answers)?;
        let is_other = board.model().is_some_and(|own| {
            let names = own.joints.iter().map(|joint| &joint.name);
            !names.eq(model.joints.iter().map(|joint| &joint.name))
        });
        if actuators.torques.len() == model.joints.len() && !is_other {
            if let Some(model) = board.model() {
                plant.configure_amplifiers(model);
            }
            plant.apply(&actuators)?;
        } else {
            // A board without a model, or with another robot's model, applies no torques. Of the model on an
            // emulated board only the number of joints is known.
            let torques = model.joints.iter().map(|_| 0.0).collect();
            plant.apply(&ActuatorFrame { sequence, enabled: false, torques })?;
        }
        next += PERIOD;
        if next + MAX_DELAY < Instant::now() {
            next = Instant::now();
        }
        // At least once each tick: a machine that is too slow for real time serves its clients all the same.
        loop {
            hub.receive(&mut requests, next.min(Instant::now() + Duration::from_millis(1)))?;
            board.exchange(&requests, &mut answers)?;
            requests.clear();
            hub.broadcast(&answers);
            answers.clear();
            hub.messages().iter().for_each(|message| note!("{message}"));
            if Instant::now() >= next {
                break;
            }
        }
        for line in lines.try_iter() {
            match parse(&line, model) {
                Ok(Some(command)) => {
                    match command {
                        Command::Reset => board.reset()?,
                        Command::Fault(fault) => sensor_faults.inject(fault, model.joints.len()),
                        other => {
                            if let Err(error) = touch(plant, other) {
                                note!("{error}");
                                continue;
                            }
                        }
                    }
                    note!("{}", done(command, &sensor_faults, plant, model));
                }
                Ok(None) => {}
                Err(message) => note!("{message}"),
            }
        }
    }
    Ok(())
}

/// The angle to home a joint with. One at its stop may be beyond the limits by what the stop yields.
fn homed(joint: &JointModel, angle: f64) -> f64 {
    const YIELDED: f64 = 0.02;
    let [lower, upper] = [joint.limits.lower, joint.limits.upper].map(f64::from);
    // Towards the inside: the command has three decimals.
    let within = angle.max((1e3 * lower).ceil() / 1e3).min((1e3 * upper).floor() / 1e3);
    if (within - angle).abs() < YIELDED { within } else { angle }
}

/// The command that homes the machine in its current posture; `None` when all encoders are absolute.
pub fn home_command(plant: &Plant, model: &RobotModel) -> Option<String> {
    let angles = plant.homed_positions();
    let relative = model.joints.iter().zip(angles).filter(|(joint, _)| joint.encoder.relative);
    let words: Vec<String> = relative
        .map(|(joint, angle)| quoted(&format!("{}={:.3}", joint.name, homed(joint, angle))))
        .collect();
    (!words.is_empty()).then(|| format!("tesaki home {}", words.join(" ")))
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use std::path::Path;

    use tesaki_description::robot::RobotFolder;

    use super::*;
    use crate::plant::PlantOptions;

    #[test]
    fn a_line_that_is_not_utf_8_is_refused_and_ends_nothing() {
        let robot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3");
        let model = RobotFolder::load(&robot).unwrap().model;
        let mut input = &b"estop on\nestop \xff\n\nreset"[..];
        let lines = std::iter::from_fn(|| next_line(&mut input));
        let parsed: Vec<_> = lines.map(|line| parse(&line, &model)).collect();
        let [stop, bad, empty, reset] = &parsed[..] else { panic!("{parsed:?}") };
        assert_eq!(*stop, Ok(Some(Command::Fault(SensorFault::EmergencyStop(true)))));
        assert!(bad.as_ref().unwrap_err().contains("is not complete, or has too much"), "{bad:?}");
        assert_eq!((empty, reset), (&Ok(None), &Ok(Some(Command::Reset))));
    }

    #[test]
    fn a_line_without_an_end_is_cut_and_the_next_one_is_a_command() {
        let text = "x".repeat(100_000) + "\nestop on\n";
        let mut input = text.as_bytes();
        let long = next_line(&mut input).unwrap();
        assert!(long.len() < 2000 && long.ends_with('…'), "{} bytes", long.len());
        assert_eq!(next_line(&mut input).as_deref(), Some("estop on\n"));
        assert_eq!(next_line(&mut input), None);
    }

    #[test]
    fn what_a_command_has_done_is_told() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3");
        let robot = RobotFolder::load(&folder).unwrap();
        let model = &robot.model;
        let mut plant = Plant::of(&robot, &PlantOptions::mismatched(1)).unwrap();
        let mut faults = SensorFaults::default();
        for (line, told) in [
            ("supply 15", "the supply is 15 V"),
            ("encoder finger1_swing -90", "the encoder of finger1_swing has jumped by -90 counts"),
            ("freeze finger1_bend", "the encoder of finger1_bend is frozen"),
            ("freeze finger1_bend", "the encoder of finger1_bend runs again"),
            ("wall 0 0 0.02 2000", "a wall of 2000 N/m is 0, 0, 0.02 m ahead of the tips"),
        ] {
            let command = parse(line, model).unwrap().unwrap();
            if let Command::Fault(fault) = command {
                faults.inject(fault, model.joints.len());
            }
            assert_eq!(done(command, &faults, &plant, model), told);
        }
        // The joints have moved in between.
        let angles = parse("angles", model).unwrap().unwrap();
        let before = done(angles, &faults, &plant, model);
        for sequence in 0..20 {
            let torques = model.joints.iter().map(|_| 0.1).collect();
            plant.apply(&ActuatorFrame { sequence, enabled: true, torques }).unwrap();
        }
        let after = done(angles, &faults, &plant, model);
        assert!(
            before.starts_with("tesaki home finger1_swing=") && after.starts_with("tesaki home "),
            "{before}"
        );
        assert_ne!(before, after);
    }

    #[test]
    fn a_command_without_its_numbers_is_not_called_unknown() {
        let robot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3");
        let model = RobotFolder::load(&robot).unwrap().model;
        for (line, usage) in [("wall 1", "  wall X Y Z N/M | off   put up"), ("estop", "  estop on|off ")] {
            let said = parse(line, &model).unwrap_err();
            assert!(said.contains("is not complete") && said.contains(usage), "{said}");
            assert!(!said.contains("unknown") && said.lines().count() == 2, "{said}");
        }
        assert!(parse("walls 1", &model).unwrap_err().starts_with("unknown command \"walls 1\""));
    }
}
