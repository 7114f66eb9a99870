use nalgebra::{SVector, Vector3};

use super::tuning::MIN_ELBOW_OFFSET;
use crate::kinematics::Posture;
use crate::math;
use crate::model::MAX_CHAIN_JOINTS;

/// Joints whose origins are shoulder, elbow and wrist of a seven-joint arm.
const SHOULDER: usize = 0;
const ELBOW: usize = 3;
const WRIST: usize = 5;

/// The arm angle (swivel angle) of a seven-joint arm: the rotation of the plane through shoulder, elbow and
/// wrist about the line from shoulder to wrist, relative to the vertical plane through that line
/// (Kreutz-Delgado, Long and Seraji 1992).
#[derive(Clone, Copy, Debug)]
pub struct ArmAngle {
    /// The angle [rad]: 0 with the elbow down, positive about the direction from shoulder to wrist.
    pub angle: f32,
    /// Its Jacobian: a row with one element per joint.
    pub jacobian: SVector<f32, MAX_CHAIN_JOINTS>,
}

impl ArmAngle {
    /// The arm angle of a seven-joint arm in `posture`; `down` is a vector along gravity. `None` for another
    /// number of joints, and where the line from shoulder to wrist is vertical: there is then no unique
    /// vertical plane.
    pub fn of(posture: &Posture, down: &Vector3<f32>) -> Option<Self> {
        let [shoulder, elbow, wrist] = [SHOULDER, ELBOW, WRIST].map(|joint| posture.joint(joint));
        let (shoulder, elbow, wrist) = (shoulder?.1, elbow?.1, wrist?.1);
        posture.joint(MAX_CHAIN_JOINTS - 1)?;
        let (to_wrist, to_elbow) = (wrist - shoulder, elbow - shoulder);
        let length = math::norm(&to_wrist);
        let axis = to_wrist / length;
        // Components of elbow position and gravity perpendicular to the line.
        let along = axis.dot(&to_elbow);
        let offset = to_elbow - axis * along;
        let slope = axis.dot(down);
        let vertical = down - axis * slope;
        let vertical_squared = vertical.norm_squared();
        if !(length > MIN_ELBOW_OFFSET && vertical_squared > 1e-3 * down.norm_squared()) {
            return None;
        }
        let angle = math::atan2(axis.dot(&vertical.cross(&offset)), vertical.dot(&offset));
        let distance = math::norm(&offset);
        let distance = if distance > MIN_ELBOW_OFFSET { distance } else { MIN_ELBOW_OFFSET };
        // Gradients of the angle by the positions of elbow and wrist. A motion of the wrist rotates the line,
        // and with it the vertical plane.
        let by_elbow = axis.cross(&offset) / (distance * distance);
        let by_wrist =
            axis.cross(&vertical) * (slope / (vertical_squared * length)) - by_elbow * (along / length);
        let mut row = SVector::<f32, MAX_CHAIN_JOINTS>::zeros();
        for (joint, value) in row.iter_mut().enumerate() {
            let Some((axis, origin)) = posture.joint(joint) else { break };
            // A joint moves only the links after it.
            if joint < ELBOW {
                *value += by_elbow.dot(&axis.cross(&(elbow - origin)));
            }
            if joint < WRIST {
                *value += by_wrist.dot(&axis.cross(&(wrist - origin)));
            }
        }
        Some(Self { angle, jacobian: row })
    }
}
