use nalgebra::{SVector, Vector3};

use crate::kinematics::Posture;
use crate::math;
use crate::model::MAX_CHAIN_JOINTS;

/// The elbow of a straight arm has no angle: its distance from the line of shoulder and wrist counts as this much [m].
const STRAIGHT: f32 = 0.01;

/// The joints whose origins are shoulder, elbow and wrist of a seven-joint arm.
const SHOULDER: usize = 0;
const ELBOW: usize = 3;
const WRIST: usize = 5;

/// The arm angle (swivel angle) of a seven-joint arm: by how much the plane through shoulder, elbow and wrist is turned
/// about the line from shoulder to wrist, from the vertical plane through that line, elbow down (Kreutz-Delgado, Long and
/// Seraji 1992).
#[derive(Clone, Copy, Debug)]
pub struct ArmAngle {
    /// The angle [rad]; 0 with the elbow down, positive when turned about the line towards the wrist.
    pub angle: f32,
    /// Its change by each joint.
    pub jacobian: SVector<f32, MAX_CHAIN_JOINTS>,
}

impl ArmAngle {
    /// Of a seven-joint arm in `posture`; `down` is a vector along gravity. `None` for another number of joints, or with the
    /// line from shoulder to wrist vertical, where no plane is the vertical one.
    pub fn of(posture: &Posture, down: &Vector3<f32>) -> Option<Self> {
        let [shoulder, elbow, wrist] = [SHOULDER, ELBOW, WRIST].map(|joint| posture.joint(joint));
        let (shoulder, elbow, wrist) = (shoulder?.1, elbow?.1, wrist?.1);
        posture.joint(MAX_CHAIN_JOINTS - 1)?;
        let (to_wrist, to_elbow) = (wrist - shoulder, elbow - shoulder);
        let length = math::sqrt(to_wrist.norm_squared());
        let axis = to_wrist / length;
        // The elbow's place off the line; that of gravity.
        let along = axis.dot(&to_elbow);
        let offset = to_elbow - axis * along;
        let slope = axis.dot(down);
        let vertical = down - axis * slope;
        let steep = vertical.norm_squared();
        if !(length > STRAIGHT && steep > 1e-3 * down.norm_squared()) {
            return None;
        }
        let angle = math::atan2(axis.dot(&vertical.cross(&offset)), vertical.dot(&offset));
        let size = math::sqrt(offset.norm_squared());
        let size = if size > STRAIGHT { size } else { STRAIGHT };
        // Across the plane: how the elbow moves when the angle grows.
        let across = axis.cross(&offset) / (size * size);
        // The line turns with the wrist: the elbow stays behind, and the vertical plane comes along.
        let of_wrist = axis.cross(&vertical) * (slope / (steep * length)) - across * (along / length);
        let mut row = SVector::<f32, MAX_CHAIN_JOINTS>::zeros();
        for (joint, value) in row.iter_mut().enumerate() {
            let Some((axis, origin)) = posture.joint(joint) else { break };
            // A joint moves what comes after it.
            if joint < ELBOW {
                *value += across.dot(&axis.cross(&(elbow - origin)));
            }
            if joint < WRIST {
                *value += of_wrist.dot(&axis.cross(&(wrist - origin)));
            }
        }
        Some(Self { angle, jacobian: row })
    }
}
