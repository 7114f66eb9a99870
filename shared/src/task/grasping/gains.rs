//! What the joints really give of a commanded torque, learnt from the force sensors.

use nalgebra::Vector3;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::PerFinger;
use super::tuning::{GAIN_LEARNING_RATE, GAIN_TORQUE, MAX_GAIN, MIN_GAIN};
use crate::math;
use crate::zip::zip;

/// Gains of the joints: true torque over commanded torque, as torque constants deviate from the model.
///
/// A joint at rest gives the torque of the measured contact force but for its friction: normalized least mean
/// squares, with a dead band of the friction (Ioannou and Sun, Robust Adaptive Control, section 8.4). Without
/// it, internal forces that grow with a load push the object away until the servos have learnt the
/// difference.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, Schema)]
pub(super) struct TorqueGains {
    gains: PerFinger<[f32; 3]>,
    /// Feed-forward torques of the last tick [N·m].
    feedforward: PerFinger<[f32; 3]>,
}

impl TorqueGains {
    /// Torque constants as in the model.
    pub const NOMINAL: Self = Self { gains: [[1.0; 3]; 3], feedforward: [[0.0; 3]; 3] };

    /// Learns from the torques of the measured forces [N·m] and the `efforts` of the joints, their torques
    /// beyond the feed-forward [N·m]. `friction` [N·m] is what the friction may take.
    pub fn learn(
        &mut self,
        sensed: &PerFinger<Vector3<f32>>,
        efforts: &PerFinger<[f32; 3]>,
        friction: &PerFinger<[f32; 3]>,
    ) {
        let fingers = zip((&mut self.gains, &self.feedforward, sensed, efforts, friction));
        for (gains, feedforward, sensed, efforts, friction) in fingers {
            for (gain, feedforward, &sensed, effort, &friction) in
                zip((gains, feedforward, sensed, efforts, friction))
            {
                *gain = learnt(*gain, feedforward + effort, sensed, friction);
            }
        }
    }

    /// The commands [N·m] with which the joints give these `torques` [N·m].
    pub fn commands(&mut self, torques: &PerFinger<Vector3<f32>>) -> PerFinger<[f32; 3]> {
        for (command, torques, gains) in zip((&mut self.feedforward, torques, &self.gains)) {
            for (command, torque, gain) in zip((command, torques, gains)) {
                *command = torque / gain;
            }
        }
        self.feedforward
    }
}

/// The gain of a joint after a tick with this commanded, sensed and friction torque [N·m].
#[inline(never)]
fn learnt(gain: f32, torque: f32, sensed: f32, friction: f32) -> f32 {
    let error = sensed - gain * torque;
    let error = error - math::clamp(error, -friction, friction);
    let rate = GAIN_LEARNING_RATE * torque / (torque * torque + GAIN_TORQUE * GAIN_TORQUE);
    math::clamp(gain + rate * error, MIN_GAIN, MAX_GAIN)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Joints that give 0.85 and 1.2 of what they are told, and one that carries nothing, with friction of
    /// 0.02 N·m against their loads: what is left of the error is what the friction may be, of 0.4 N·m.
    #[test]
    fn gains_are_learnt_but_for_the_friction() {
        let mut gains = TorqueGains::NOMINAL;
        let load = Vector3::new(0.4, -0.4, 0.0);
        let mut commands = [[0.0; 3]; 3];
        for _ in 0..1000 {
            commands = gains.commands(&[load; 3]);
            let [a, b, c] = commands[0];
            let sensed = Vector3::new(0.85 * a - 0.02, 1.2 * b + 0.02, 0.85 * c + 0.02);
            gains.learn(&[sensed; 3], &[[0.0; 3]; 3], &[[0.024; 3]; 3]);
        }
        for [a, b, c] in commands {
            assert!((0.85 * a - 0.02 - 0.4).abs() < 0.025, "{a}");
            assert!((1.2 * b + 0.02 + 0.4).abs() < 0.025, "{b}");
            assert!(c.abs() < 1e-6, "{c}");
        }
        // Within the friction nothing is learnt; a sensor that reads nothing leads to the bound.
        let before = gains.gains;
        gains.learn(
            &[Vector3::from(commands[0]).component_mul(&Vector3::from(before[0])); 3],
            &[[0.0; 3]; 3],
            &[[0.024; 3]; 3],
        );
        let learnt = gains.gains.iter().flatten().zip(before.iter().flatten());
        assert!(learnt.into_iter().all(|(after, before)| (after - before).abs() < 1e-6));
        for _ in 0..1000 {
            gains.commands(&[load; 3]);
            gains.learn(&[Vector3::zeros(); 3], &[[0.0; 3]; 3], &[[0.024; 3]; 3]);
        }
        for (gain, expected) in gains.gains[1].into_iter().zip([MIN_GAIN, MIN_GAIN, 1.0]) {
            assert!((gain - expected).abs() < 1e-6, "{gain}");
        }
    }
}
