//! A task's report for people, pages and recordings.

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use tesaki::task::TaskTelemetry;
use tesaki::task::grasping::{GraspPlan, GraspTelemetry, Phase};
use tesaki::task::impedance::ImpedanceTelemetry;
use tesaki::task::telexistence::TelexistenceTelemetry;
use tesaki::task::visual_approach::{GripperState, HandMotion, VisualApproachTelemetry};

use serde::Serialize;

/// Position and unit quaternion `[x, y, z, w]`.
pub type Pose = [f32; 7];

/// Smallest singular value below which an arm's Jacobian counts as nearly singular.
pub const SINGULAR: f32 = 0.06;

/// A task's report.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Its name.
    pub task: String,
    /// Its phase as text.
    pub phase: Option<String>,
    /// A frame that it controls.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frame: Option<Pose>,
    /// The set-point of that frame.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub target: Option<Pose>,
    /// Target force of each finger on the object [N].
    #[serde(skip_serializing_if = "Option::is_none")]
    pub forces: Option<Vec<[f32; 3]>>,
    /// Direction of each contact, into the object.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub normals: Option<Vec<[f32; 3]>>,
    /// Coefficient of friction.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub friction: Option<f32>,
    /// Whether the arm's Jacobian is nearly singular.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub nearly_singular: bool,
    /// Further numbers: name, value, unit.
    pub values: Vec<(&'static str, f32, &'static str)>,
}

/// The plan of a grasp that the page has started, and the orientation of the object frame when it was first
/// held.
#[derive(Clone, Copy, Debug)]
pub struct Grasped {
    /// The plan.
    pub plan: GraspPlan,
    at_grasp: Option<UnitQuaternion<f32>>,
}

impl Grasped {
    /// Creates a grasp that has just begun.
    pub const fn new(plan: GraspPlan) -> Self {
        Self { plan, at_grasp: None }
    }

    /// Returns the directions of the contacts, rotated with the object.
    fn normals(&mut self, grasp: &GraspTelemetry) -> Option<Vec<[f32; 3]>> {
        if !matches!(
            grasp.phase,
            Phase::Squeeze | Phase::ProbeFriction | Phase::Hold | Phase::Move | Phase::Lower
        ) {
            return None;
        }
        let now = quaternion(grasp.orientation);
        let turned = now * self.at_grasp.get_or_insert(now).inverse();
        let normal = |normal: [f32; 3]| (turned * Vector3::from(normal)).try_normalize(1e-6).map(Into::into);
        self.plan.contacts.iter().map(|contact| normal(contact.normal)).collect()
    }
}

/// Creates the report of a task for people and for the picture.
pub fn report(telemetry: &TaskTelemetry, grasped: Option<&mut Grasped>) -> Report {
    let report = match telemetry {
        TaskTelemetry::JointServo(_) => Report::default(),
        TaskTelemetry::Grasping(grasp) => of_grasp(grasp, grasped),
        TaskTelemetry::Impedance(tool) => of_tool(tool),
        TaskTelemetry::Telexistence(hand) => of_hand(hand),
        TaskTelemetry::VisualApproach(hand) => of_approach(hand),
    };
    Report { task: telemetry.kind().to_string(), ..report }
}

fn of_grasp(grasp: &GraspTelemetry, grasped: Option<&mut Grasped>) -> Report {
    let failure = grasp.failure.map_or_else(String::new, |failure| format!(": {failure}"));
    let holds = grasp.phase != Phase::Ready;
    let load = Vector3::from_column_slice(&grasp.load[..3]).norm();
    Report {
        phase: Some(format!("the hand {}{failure}", grasp.phase)),
        frame: holds.then(|| pose(grasp.position, grasp.orientation)),
        forces: holds.then(|| grasp.target_forces.to_vec()),
        normals: grasped.and_then(|grasped| grasped.normals(grasp)),
        friction: Some(grasp.friction).filter(|friction| *friction > 0.0),
        values: vec![
            ("friction", grasp.friction, ""),
            ("load", load, "N"),
            ("slips", f32::from(grasp.slips), "ticks"),
        ],
        ..Report::default()
    }
}

fn of_tool(tool: &ImpedanceTelemetry) -> Report {
    let [x, y, z, a, b, c] = tool.error;
    let position = Vector3::from(tool.position) - Vector3::new(x, y, z);
    let rotation = UnitQuaternion::from_scaled_axis(-Vector3::new(a, b, c)) * quaternion(tool.rotation);
    Report {
        phase: Some(if tool.contact { "the tool is in contact" } else { "the tool is free" }.to_owned()),
        frame: Some(pose(tool.position, tool.rotation)),
        target: Some(pose(position.into(), rotation.coords.into())),
        values: vec![
            ("deviation", 1e3 * norm(&tool.error), "mm"),
            ("force", norm(&tool.wrench), "N"),
            ("elbow", tool.elbow, "rad"),
            ("smallest singular value", tool.sigma_min, ""),
        ],
        nearly_singular: tool.sigma_min < SINGULAR,
        ..Report::default()
    }
}

fn of_hand(hand: &TelexistenceTelemetry) -> Report {
    let largest = hand.errors.iter().copied().fold(0.0, f32::max);
    Report {
        phase: Some("the hand follows the operator".to_owned()),
        values: vec![
            ("largest tip error", 1e3 * largest, "mm"),
            ("age of the sample", 10.0 * f32::from(hand.age), "ms"),
            ("joints held back", f32::from(u8::try_from(hand.limited.count_ones()).unwrap_or(u8::MAX)), ""),
        ],
        ..Report::default()
    }
}

fn of_approach(hand: &VisualApproachTelemetry) -> Report {
    let motion = match hand.motion {
        HandMotion::Standing => "the hand stands at its target",
        HandMotion::Moving => "the hand moves",
        HandMotion::Blocked => "a contact has stopped the hand",
        HandMotion::Limited => "limits of the joints hold the hand back",
    };
    let gripper = match hand.gripper {
        GripperState::Still => "the gripper stands",
        GripperState::Opening => "the gripper opens",
        GripperState::Open => "the gripper is open",
        GripperState::Closing => "the gripper closes",
        GripperState::Holding => "the gripper holds something",
        GripperState::Empty => "the gripper holds nothing",
        GripperState::Jammed => "the gripper is jammed",
    };
    Report {
        phase: Some(format!("{motion}; {gripper}")),
        frame: Some(pose(hand.hand.translation, hand.hand.rotation)),
        values: vec![
            ("way to the target", 1e3 * hand.remaining, "mm"),
            ("force", Vector3::from(hand.force).norm(), "N"),
            ("opening", hand.opening, "rad"),
        ],
        ..Report::default()
    }
}

/// Returns the norm of the linear part of a wrench or deviation [N or m].
fn norm(six: &[f32; 6]) -> f32 {
    Vector3::from_column_slice(&six[..3]).norm()
}

fn quaternion([x, y, z, w]: [f32; 4]) -> UnitQuaternion<f32> {
    UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z))
}

const fn pose([x, y, z]: [f32; 3], [a, b, c, d]: [f32; 4]) -> Pose {
    [x, y, z, a, b, c, d]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_set_point_of_the_tool_is_where_the_error_points_away_from() {
        // 0.2 rad about z beyond a set-point that stands 0.5 rad about z, and 10 mm along x.
        let half = |angle: f32| {
            let (sin, cos) = tesaki::math::sin_cos(0.5 * angle);
            [0.0, 0.0, sin, cos]
        };
        let tool = ImpedanceTelemetry {
            position: [0.41, 0.0, 0.3],
            rotation: half(0.7),
            error: [0.01, 0.0, 0.0, 0.0, 0.0, 0.2],
            ..ImpedanceTelemetry::NONE
        };
        let target = of_tool(&tool).target.expect("there is one");
        let [.., z, w] = half(0.5);
        let expected = [0.40, 0.0, 0.3, 0.0, 0.0, z, w];
        assert!(target.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{target:?}");
    }

    #[test]
    fn an_arm_that_is_nearly_singular_is_said_to_be() {
        for (sigma_min, expected) in [(0.158, false), (0.059, true)] {
            let report = of_tool(&ImpedanceTelemetry { sigma_min, ..ImpedanceTelemetry::NONE });
            let json = serde_json::to_value(&report).expect("it is plain");
            assert_eq!(json["nearly_singular"] == true, expected, "{json}");
        }
    }
}
