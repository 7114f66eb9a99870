use nalgebra::UnitQuaternion;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::setpoint::ORIGIN;
use super::{Arm, ArmMeasurement, ImpedanceState};
use crate::kinematics::Posture;

/// Telemetry of impedance control.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ImpedanceTelemetry {
    /// Measured position of the tool [m].
    pub position: [f32; 3],
    /// Measured orientation of the tool as a unit quaternion, `[x, y, z, w]`.
    pub rotation: [f32; 4],
    /// Pose error in the last tick of the control: displacement of the tool from its set-point, translation
    /// and rotation vector [m, rad].
    pub error: [f32; 6],
    /// External wrench on the tool, in base axes, from the configured source [N, N·m].
    pub wrench: [f32; 6],
    /// Whether the last tick of the control detected contact.
    pub contact: bool,
    /// Smallest singular value of the tool's Jacobian in the last tick of the control; nearly singular below
    /// 0.06.
    pub sigma_min: f32,
    /// Elbow angle: of the driven joint, or the arm angle [rad].
    pub elbow: f32,
    /// Factor by which mass and damping of the impedance are raised on a surface that is too stiff for it; 1
    /// if they are not.
    pub derating: f32,
}

impl ImpedanceTelemetry {
    /// Telemetry without an arm.
    pub const NONE: Self = Self {
        position: [0.0; 3],
        rotation: ORIGIN.rotation,
        error: [0.0; 6],
        wrench: [0.0; 6],
        contact: false,
        sigma_min: 0.0,
        elbow: 0.0,
        derating: 1.0,
    };
}

impl ImpedanceState {
    /// Telemetry for a measurement and the posture at its angles.
    pub fn telemetry(
        &self,
        arm: &Arm<'_>,
        measurement: &ArmMeasurement,
        posture: &Posture,
    ) -> ImpedanceTelemetry {
        let tip = posture.tip();
        ImpedanceTelemetry {
            position: tip.translation.vector.into(),
            rotation: UnitQuaternion::from_rotation_matrix(&tip.rotation).coords.into(),
            error: self.pose_error,
            wrench: self.external_wrench(measurement).into(),
            contact: self.contact,
            sigma_min: self.sigma_min,
            elbow: self.elbow_angle(arm, posture, &measurement.angles).unwrap_or(0.0),
            derating: self.derating.factor(),
        }
    }
}
