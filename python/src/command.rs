//! Commands to tasks, as arrays.

use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tesaki::control::JointPoint;
use tesaki::kinematics::{ElbowSetpoint, PosePoint, TipPoint};
use tesaki::model::RobotModel;
use tesaki::task::TaskCommand;
use tesaki::task::grasping::GraspCommand;
use tesaki::task::impedance::ImpedanceCommand;
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::telexistence::{FingertipPoint, FingertipSample, TelexistenceCommand};
use tesaki::task::visual_approach::VisualApproachCommand;

use crate::arrays::{Input, Length};

/// A kind of commands.
#[derive(Clone, Copy)]
enum Kind {
    Joints,
    Points,
    Tips,
    Tool,
    Object,
    Fingertips,
    Hand,
    PutDown,
    OpenHand,
    Stand,
    Open,
    Close,
    Acknowledge,
}

/// The kinds of commands, with their names, and the shape and the meaning of their arrays.
///
/// `tesaki.COMMANDS` says the same in Python.
const KINDS: &[(Kind, &str, &[Length], &str)] = &[
    (Kind::Joints, "joints", &[Length::Any("joints")], "a goal for each joint [rad]"),
    (
        Kind::Points,
        "points",
        &[Length::Any("joints"), Length::Just(3)],
        "angle, velocity and acceleration of each joint",
    ),
    (
        Kind::Tips,
        "tips",
        &[Length::Any("tips"), Length::Just(9)],
        "position, velocity and acceleration of each tip",
    ),
    (
        Kind::Tool,
        "tool",
        &[Length::Just(22)],
        "position 3, quaternion x, y, z, w, twist 6, its derivative 6, and angle, velocity and acceleration of the elbow",
    ),
    (Kind::Object, "object", &[Length::Just(7)], "translation 3, rotation vector 3, and duration"),
    (
        Kind::Fingertips,
        "fingertips",
        &[Length::Just(5), Length::Just(6)],
        "position and velocity of each fingertip, NaN where unknown",
    ),
    (Kind::Hand, "hand", &[Length::Just(4)], "position 3, and speed"),
    (Kind::PutDown, "put_down", &[Length::Just(0)], "nothing"),
    (Kind::OpenHand, "open_hand", &[Length::Just(0)], "nothing"),
    (Kind::Stand, "stand", &[Length::Just(0)], "nothing"),
    (Kind::Open, "open", &[Length::Just(0)], "nothing"),
    (Kind::Close, "close", &[Length::Just(0)], "nothing"),
    (Kind::Acknowledge, "acknowledge", &[Length::Just(0)], "nothing"),
];

/// Decodes a command from its kind and numbers; `number` is that of a fingertip sample. With a `model` there
/// is a row for each of its joints or tips.
///
/// # Errors
/// There is no such kind, or the shape is wrong; the message names the argument `name`.
pub fn decode(
    kind: &str,
    name: &str,
    values: &Bound<'_, PyAny>,
    number: u16,
    model: Option<&RobotModel>,
) -> PyResult<TaskCommand> {
    let Some((kind, _, shape, what)) = KINDS.iter().find(|(_, known, ..)| *known == kind) else {
        let known: Vec<&str> = KINDS.iter().map(|(_, name, ..)| *name).collect();
        return Err(PyValueError::new_err(format!(
            "there is no command {kind:?}; the commands are {}",
            known.join(", ")
        )));
    };
    let known = |length: &Length| match (length, model) {
        (Length::Any("joints"), Some(model)) => Length::Just(model.joints.len()),
        (Length::Any("tips"), Some(model)) => Length::Just(model.chains.len()),
        _ => *length,
    };
    let shape: Vec<Length> = shape.iter().map(known).collect();
    let input = Input::new(values, name, &shape, what)?;
    let values = input.values();
    let too_many =
        || PyValueError::new_err(format!("{name}: {} rows are more than any board has", input.rows()));
    Ok(match kind {
        Kind::Joints => {
            let positions = heapless::Vec::from_slice(values).map_err(|_| too_many())?;
            TaskCommand::JointServo(JointCommand::Goal { positions })
        }
        Kind::Points => {
            let points: Vec<JointPoint> = values
                .chunks_exact(3)
                .map(|row| JointPoint { position: row[0], velocity: row[1], acceleration: row[2] })
                .collect();
            let points = heapless::Vec::from_slice(&points).map_err(|_| too_many())?;
            TaskCommand::JointServo(JointCommand::Stream { points })
        }
        Kind::Tips => {
            let tips: Vec<TipPoint> = values
                .chunks_exact(9)
                .map(|row| {
                    let [position, velocity, acceleration] = [0, 3, 6].map(|first| part(row, first));
                    TipPoint { position, velocity, acceleration }
                })
                .collect();
            let tips = heapless::Vec::from_slice(&tips).map_err(|_| too_many())?;
            TaskCommand::JointServo(JointCommand::StreamTips { tips })
        }
        Kind::Tool => TaskCommand::Impedance(ImpedanceCommand::SetTarget {
            point: PosePoint {
                position: part(values, 0),
                rotation: part(values, 3),
                velocity: part(values, 7),
                acceleration: part(values, 13),
            },
            elbow: ElbowSetpoint { angle: values[19], velocity: values[20], acceleration: values[21] },
        }),
        Kind::Object => TaskCommand::Grasping(GraspCommand::Move {
            translation: part(values, 0),
            rotation: part(values, 3),
            duration: values[6],
        }),
        Kind::Fingertips => {
            let tip = |finger: usize| {
                let [position, velocity] = [0, 3].map(|first| part(values, 6 * finger + first));
                (!position[0].is_nan()).then_some(FingertipPoint { position, velocity, direction: None })
            };
            let sample = FingertipSample { number, age: 0.0, tips: std::array::from_fn(tip) };
            TaskCommand::Telexistence(TelexistenceCommand::Follow(sample))
        }
        Kind::PutDown => TaskCommand::Grasping(GraspCommand::PutDown),
        Kind::OpenHand => TaskCommand::Grasping(GraspCommand::Open),
        Kind::Stand => TaskCommand::VisualApproach(VisualApproachCommand::Stand),
        Kind::Open => TaskCommand::VisualApproach(VisualApproachCommand::Open),
        Kind::Close => TaskCommand::VisualApproach(VisualApproachCommand::Close),
        Kind::Acknowledge => TaskCommand::VisualApproach(VisualApproachCommand::Acknowledge),
        Kind::Hand => TaskCommand::VisualApproach(VisualApproachCommand::Move {
            position: part(values, 0),
            speed: values[3],
        }),
    })
}

/// Returns a command's kind and numbers, with their shape; `None` for a command without such a form.
pub fn encode(command: &TaskCommand) -> Option<(&'static str, Vec<f32>, Vec<usize>)> {
    let plain = |kind| Some((kind, Vec::new(), vec![0]));
    match command {
        TaskCommand::JointServo(JointCommand::Goal { positions }) => {
            Some(("joints", positions.to_vec(), vec![positions.len()]))
        }
        TaskCommand::JointServo(JointCommand::Stream { points }) => {
            let rows = points.iter().flat_map(|point| [point.position, point.velocity, point.acceleration]);
            Some(("points", rows.collect(), vec![points.len(), 3]))
        }
        TaskCommand::JointServo(JointCommand::StreamTips { tips }) => {
            let rows = tips.iter().flat_map(|tip| [tip.position, tip.velocity, tip.acceleration]);
            Some(("tips", rows.flatten().collect(), vec![tips.len(), 9]))
        }
        TaskCommand::Impedance(ImpedanceCommand::SetTarget { point, elbow }) => {
            let mut values = Vec::with_capacity(22);
            values.extend(point.position);
            values.extend(point.rotation);
            values.extend(point.velocity);
            values.extend(point.acceleration);
            values.extend([elbow.angle, elbow.velocity, elbow.acceleration]);
            Some(("tool", values, vec![22]))
        }
        TaskCommand::Grasping(GraspCommand::Move { translation, rotation, duration }) => {
            let values = translation.iter().chain(rotation).chain([duration]);
            Some(("object", values.copied().collect(), vec![7]))
        }
        TaskCommand::Telexistence(TelexistenceCommand::Follow(sample)) => {
            let row = |tip: &Option<FingertipPoint>| {
                tip.map_or([[f32::NAN; 3]; 2], |tip| [tip.position, tip.velocity])
            };
            Some(("fingertips", sample.tips.iter().flat_map(row).flatten().collect(), vec![5, 6]))
        }
        TaskCommand::VisualApproach(VisualApproachCommand::Move { position, speed }) => {
            Some(("hand", position.iter().chain([speed]).copied().collect(), vec![4]))
        }
        TaskCommand::Grasping(GraspCommand::PutDown) => plain("put_down"),
        TaskCommand::Grasping(GraspCommand::Open) => plain("open_hand"),
        TaskCommand::VisualApproach(VisualApproachCommand::Stand) => plain("stand"),
        TaskCommand::VisualApproach(VisualApproachCommand::Open) => plain("open"),
        TaskCommand::VisualApproach(VisualApproachCommand::Close) => plain("close"),
        TaskCommand::VisualApproach(VisualApproachCommand::Acknowledge) => plain("acknowledge"),
        _ => None,
    }
}

/// Returns `N` numbers from `first` on. The shapes were checked.
fn part<const N: usize>(values: &[f32], first: usize) -> [f32; N] {
    std::array::from_fn(|index| values.get(first + index).copied().unwrap_or(f32::NAN))
}
