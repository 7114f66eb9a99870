//! Between the joints of a model and a board's brushed motors: what a robot needs, counts to velocities,
//! torques to currents.

use core::f32::consts::TAU;

use heapless::Vec;
use tesaki::TICK;
use tesaki::control::{InvalidCurrentLoop, Switching, Winding};
use tesaki::math;
use tesaki::model::{Field, JointModel, MAX_JOINTS, ModelError, Problem, RobotModel};

use crate::motors::{Command, Motor, Motors, SUM_RESOLUTION, Sensing, Totals};

/// What a joint needs every period.
#[derive(Clone, Copy, Debug)]
struct Joint {
    torque_constant: f32,
    current_resolution: f32,
    /// Angle of a count [rad].
    angle: f32,
    velocity: f32,
}

/// The last control period.
#[derive(Clone, Copy, Debug)]
struct Last<const N: usize> {
    period: u32,
    counts: [i32; N],
    totals: Totals<N>,
}

/// The joints of a robot on a board with `N` motors.
#[derive(Clone, Debug)]
pub struct Joints<const N: usize> {
    joints: Vec<Joint, N>,
    /// Periods of the current loops in a control period.
    periods: u32,
    last: Option<Last<N>>,
}

impl<const N: usize> Joints<N> {
    /// No robot yet. `periods`: those of the current loops in a control period.
    pub const fn new(periods: u32) -> Self {
        Self { joints: Vec::new(), periods, last: None }
    }

    /// Takes a robot.
    pub fn configure(&mut self, model: &RobotModel) {
        self.joints = model.joints.iter().take(N).map(Joint::new).collect();
        self.last = None;
    }

    /// Number of joints.
    pub fn count(&self) -> usize {
        self.joints.len()
    }

    /// One control period, from the encoders' `counts` and the `totals` of the current loops. Returns the
    /// mean currents [counts of the model]; `None` when the loops do not run at their rate: then nobody
    /// controls the currents.
    pub fn update(
        &mut self,
        period: u32,
        counts: [i32; N],
        totals: &Totals<N>,
    ) -> Option<Vec<i16, MAX_JOINTS>> {
        let last = self.last.replace(Last { period, counts, totals: *totals });
        let mut currents = Vec::new();
        let now = counts.into_iter().zip(totals.currents);
        for (index, (joint, (counts, total))) in self.joints.iter_mut().zip(now).enumerate() {
            let mut current = 0;
            if let Some(last) = &last {
                let elapsed = period.wrapping_sub(last.period);
                let samples = totals.periods.wrapping_sub(last.totals.periods);
                if samples.abs_diff(self.periods.wrapping_mul(elapsed)) > self.periods / 10 {
                    return None;
                }
                let (last_counts, last_total) = (last.counts[index], last.totals.currents[index]);
                #[expect(clippy::cast_precision_loss, reason = "changes of a period")]
                let [elapsed, change, sum, samples] = [
                    elapsed as f32,
                    counts.wrapping_sub(last_counts) as f32,
                    total.wrapping_sub(last_total) as f32,
                    samples as f32,
                ];
                joint.velocity = change * joint.angle / (elapsed * TICK);
                #[expect(clippy::cast_possible_truncation, reason = "saturates")]
                let count = (sum * SUM_RESOLUTION / samples / joint.current_resolution) as i16;
                current = count;
            }
            // Cannot fail: a board has no more joints than a frame.
            let _ = currents.push(current);
        }
        Some(currents)
    }

    /// Whether every motor's back-EMF is less than `voltage` [V]. Without a robot nothing is known, and it is
    /// not.
    pub fn are_slow(&self, voltage: f32) -> bool {
        let back_emf = |joint: &Joint| math::abs(joint.torque_constant * joint.velocity);
        self.last.is_some() && !self.joints.is_empty() && self.joints.iter().all(|j| back_emf(j) < voltage)
    }

    /// The currents for `torques` [N·m].
    pub fn command(&self, torques: &[f32]) -> Command<N> {
        let mut command = Command { currents: [0.0; N], velocities: [0.0; N] };
        let motors = command.currents.iter_mut().zip(&mut command.velocities);
        for ((current, velocity), (joint, torque)) in motors.zip(self.joints.iter().zip(torques)) {
            *current = torque / joint.torque_constant;
            *velocity = joint.velocity;
        }
        command
    }
}

impl Joint {
    fn new(joint: &JointModel) -> Self {
        let sign = if joint.encoder.reversed { -1.0 } else { 1.0 };
        Self {
            torque_constant: joint.motor.torque_constant,
            current_resolution: joint.motor.current_resolution,
            angle: sign * TAU / joint.encoder.counts_per_turn,
            velocity: 0.0,
        }
    }
}

/// The motors for a robot on these power stages. A current of `trip` times its limit is a fault of the power
/// stage; `wake` is the time until one works [s].
///
/// # Errors
/// What is missing, or what the current loop cannot do, by joint and field.
pub fn motors_for<const N: usize>(
    model: &RobotModel,
    sensing: Sensing,
    trip: f32,
    switching: &Switching,
    wake: f32,
) -> Result<Motors<N>, ModelError> {
    let mut motors = [None; N];
    for (index, (motor, joint)) in (0_u8..).zip(motors.iter_mut().zip(&model.joints)) {
        let needed = |field, value: Option<f32>| {
            value.ok_or(ModelError { joint: Some(index), field, value: 0.0, problem: Problem::Missing })
        };
        let winding = Winding {
            resistance: needed(Field::MotorResistance, joint.motor.resistance)?,
            inductance: needed(Field::MotorInductance, joint.motor.inductance)?,
            back_emf: joint.motor.torque_constant,
        };
        *motor = Some(Motor { winding, sensing, trip: trip * joint.motor.current_limit });
    }
    Motors::try_new(&motors, switching, wake).map_err(|(index, error)| {
        let InvalidCurrentLoop { field, value, limits: (lower, upper) } = error;
        let field = match field {
            "resistance" => Field::MotorResistance,
            "inductance" => Field::MotorInductance,
            _ => Field::TorqueConstant,
        };
        let problem = if value < lower { Problem::Below(lower) } else { Problem::BoardLimit(upper) };
        #[expect(clippy::cast_possible_truncation, reason = "a board has no more motors than a robot joints")]
        let joint = Some(index as u8);
        ModelError { joint, field, value, problem }
    })
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use core::f32::consts::FRAC_PI_2;

    use super::*;

    /// A joint as in the model: 1000 counts a turn, 0.5 N·m/A, a count of current is 1 mA.
    fn joints() -> Joints<2> {
        let joint =
            Joint { torque_constant: 0.5, current_resolution: 1e-3, angle: TAU / 1000.0, velocity: 0.0 };
        let reversed = Joint { angle: -joint.angle, ..joint };
        Joints { joints: [joint, reversed].into_iter().collect(), periods: 200, last: None }
    }

    /// By hand: 5 counts of 1000 in two periods of 10 ms are a half π a second; 400 samples of 0.3 A are
    /// 1 200 000 parts of 0.1 mA.
    #[test]
    fn velocities_and_mean_currents_by_hand() {
        let mut joints = joints();
        let totals = Totals { currents: [i32::MAX, -7], periods: u32::MAX - 10 };
        assert!(!joints.are_slow(1.0), "before anything was read");
        assert_eq!(joints.update(3, [i32::MAX, 2], &totals).unwrap(), [0, 0]);
        let totals = Totals { currents: [i32::MAX.wrapping_add(1_200_000), -1_200_007], periods: 389 };
        assert_eq!(joints.update(5, [i32::MAX.wrapping_add(5), 7], &totals).unwrap(), [300, -300]);
        let command = joints.command(&[1.0, -0.25]);
        let near = |found: [f32; 2], expected: [f32; 2]| {
            found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-5)
        };
        assert!(near(command.currents, [2.0, -0.5]), "{command:?}");
        assert!(near(command.velocities, [FRAC_PI_2, -FRAC_PI_2]), "{command:?}");
        assert!(joints.are_slow(0.79) && !joints.are_slow(0.78));
    }

    #[test]
    fn loops_that_do_not_run_at_their_rate_are_told() {
        for (samples, is_right) in [(179, false), (180, true), (220, true), (221, false), (0, false)] {
            let mut joints = joints();
            joints.update(1, [0; 2], &Totals { currents: [0; 2], periods: 0 }).unwrap();
            let told = joints.update(2, [0; 2], &Totals { currents: [0; 2], periods: samples });
            assert_eq!(told.is_some(), is_right, "{samples}");
        }
    }
}
