//! Connects the joints of a model to a board's brushed motors: checks what the robot needs, and converts
//! counts to velocities and torques to currents.

use heapless::Vec;
use tesaki::OutOfRange;
use tesaki::TICK;
use tesaki::control::{CurrentLoopField, Switching, Winding};
use tesaki::math;
use tesaki::model::{Field, JointModel, ModelError, Motor as MotorModel, Problem, RobotModel};
use tesaki::protocol::{SensorFlags, SensorFrame};

use crate::back_emf::{BackEmf, Contradiction, Period};
use crate::exchange::LoopReport;
use crate::motors::{Command, Motor, Motors, SUM_RESOLUTION, Sensing, Totals, VOLTAGE_RESOLUTION};

/// Data of a joint for every period.
#[derive(Clone, Copy, Debug)]
struct Joint {
    torque_constant: f32,
    current_resolution: f32,
    /// Angle of one count [rad].
    angle: f32,
    velocity: f32,
    /// Present if the winding is known.
    back_emf: Option<BackEmf>,
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
pub struct MotorJoints<const N: usize> {
    joints: Vec<Joint, N>,
    /// Periods of the current loops in a control period.
    periods: u32,
    last: Option<Last<N>>,
    /// Whether the velocities are those of the last period.
    has_velocities: bool,
}

impl<const N: usize> MotorJoints<N> {
    /// Creates the joints without a robot. `periods` is the number of periods of the current loops in a
    /// control period.
    pub const fn new(periods: u32) -> Self {
        Self { joints: Vec::new(), periods, last: None, has_velocities: false }
    }

    /// Takes a robot.
    pub fn configure(&mut self, model: &RobotModel) {
        self.joints = model.joints.iter().take(N).map(Joint::new).collect();
        (self.last, self.has_velocities) = (None, false);
    }

    /// Runs one control period from the encoders' `counts` and what the current loops `measured`. Returns
    /// counts, mean currents, mean supply and an encoder or a current that contradicts its motor's winding
    /// ([`BackEmf`]), or `None` if the loops do not run at their rate: then nothing controls the currents.
    ///
    /// A single disturbed sample, such as of a power stage that switches, hardly changes the mean supply. A
    /// supply that tripped is reported itself.
    pub fn update(&mut self, period: u32, counts: [i32; N], measured: &LoopReport<N>) -> Option<SensorFrame> {
        let totals = &measured.totals;
        let last = self.last.replace(Last { period, counts, totals: *totals });
        self.has_velocities = false;
        let mut frame = SensorFrame {
            sequence: period,
            supply: measured.supply,
            encoders: counts.into_iter().take(self.joints.len()).collect(),
            ..SensorFrame::default()
        };
        let Some(last) = last else {
            frame.currents.resize_default(self.joints.len()).ok()?;
            return Some(frame);
        };
        let elapsed = period.wrapping_sub(last.period);
        let samples = totals.periods.wrapping_sub(last.totals.periods);
        if samples.abs_diff(self.periods.wrapping_mul(elapsed)) > self.periods / 10 {
            return None;
        }
        #[expect(clippy::cast_precision_loss, reason = "the sum of a period")]
        let sum = totals.supply.wrapping_sub(last.totals.supply) as f32;
        #[expect(clippy::cast_precision_loss, reason = "samples of a period")]
        let mean = sum * VOLTAGE_RESOLUTION / samples as f32;
        if !measured.supply_tripped {
            frame.supply = millivolts(mean);
        }
        let was_driven = totals.driven.wrapping_sub(last.totals.driven) == samples;
        let counts = changes(&counts, &last.counts);
        let sums = changes(&totals.currents, &last.totals.currents);
        let voltages = changes(&totals.voltages, &last.totals.voltages);
        let motors = counts.iter().zip(&sums).zip(&voltages);
        for (index, (joint, ((count, sum), voltage))) in (0..).zip(self.joints.iter_mut().zip(motors)) {
            #[expect(clippy::cast_precision_loss, reason = "changes of a period")]
            let (elapsed, samples) = (elapsed as f32, samples as f32);
            joint.velocity = count * joint.angle / (elapsed * TICK);
            let current = sum * SUM_RESOLUTION / samples;
            let voltage = voltage * VOLTAGE_RESOLUTION / samples;
            let driven = was_driven.then_some(Period { voltage, current, velocity: joint.velocity });
            match joint.back_emf.as_mut().and_then(|watch| watch.update(driven)) {
                // The first one is reported.
                Some(Contradiction::Encoder) if frame.flags.dead_encoder().is_none() => {
                    frame.flags.0 |= SensorFlags::of_dead_encoder(index);
                }
                Some(Contradiction::Current) => frame.flags.0 |= SensorFlags::POWER_STAGE,
                _ => {}
            }
            #[expect(clippy::cast_possible_truncation, reason = "saturates")]
            frame.currents.push((current / joint.current_resolution) as i16).ok()?;
        }
        self.has_velocities = true;
        Some(frame)
    }

    /// Returns whether every motor's back-EMF is known to be less than `voltage` [V]; false without a robot.
    pub fn are_slow(&self, voltage: f32) -> bool {
        let back_emf = |joint: &Joint| math::abs(joint.torque_constant * joint.velocity);
        self.has_velocities && !self.joints.is_empty() && self.joints.iter().all(|j| back_emf(j) < voltage)
    }

    /// Returns the command for `torques` [N·m].
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
        let angle = joint.encoder.radians_per_count();
        Self {
            torque_constant: joint.motor.torque_constant,
            current_resolution: joint.motor.current_resolution,
            angle,
            velocity: 0.0,
            back_emf: winding(&joint.motor).ok().map(|winding| BackEmf::new(winding, angle)),
        }
    }
}

/// Returns the winding of a motor, or the field that is missing.
fn winding(motor: &MotorModel) -> Result<Winding, Field> {
    Ok(Winding {
        resistance: motor.resistance.ok_or(Field::MotorResistance)?,
        inductance: motor.inductance.ok_or(Field::MotorInductance)?,
        back_emf: motor.torque_constant,
    })
}

/// Creates the motors for a robot on these power stages. A current of `trip` times its limit is a fault of
/// the power stage; `wake` is the time that a stage takes to wake [s].
///
/// # Errors
/// What is missing, or is outside the current loop's limits, by joint and field.
pub fn motors_for<const N: usize>(
    model: &RobotModel,
    sensing: Sensing,
    trip: f32,
    switching: &Switching,
    wake: f32,
) -> Result<Motors<N>, ModelError> {
    let mut motors = [None; N];
    for (index, (motor, joint)) in (0_u8..).zip(motors.iter_mut().zip(&model.joints)) {
        let missing = |field| ModelError { joint: Some(index), field, value: 0.0, problem: Problem::Missing };
        let winding = winding(&joint.motor).map_err(missing)?;
        *motor = Some(Motor { winding, sensing, trip: trip * joint.motor.current_limit });
    }
    Motors::try_new(&motors, model.safety.supply_max, switching, wake).map_err(|(index, error)| {
        let OutOfRange { field, value, min, max } = error;
        let field = match field {
            CurrentLoopField::Resistance => Field::MotorResistance,
            CurrentLoopField::Inductance => Field::MotorInductance,
            CurrentLoopField::BackEmf => Field::TorqueConstant,
            // The board's own settings are invalid, for all motors.
            CurrentLoopField::Switching => Field::Joints,
        };
        let problem = if value < min { Problem::Below(min) } else { Problem::BoardLimit(max) };
        #[expect(clippy::cast_possible_truncation, reason = "a board has no more motors than a robot joints")]
        let joint = Some(index as u8);
        ModelError { joint, field, value, problem }
    })
}

#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
const fn millivolts(volts: f32) -> u16 {
    (volts * 1000.0) as u16
}

/// Returns the changes of wrapping sums since the `last` period.
fn changes<const N: usize>(sums: &[i32; N], last: &[i32; N]) -> [f32; N] {
    #[expect(clippy::cast_precision_loss, reason = "changes of a period")]
    core::array::from_fn(|index| sums[index].wrapping_sub(last[index]) as f32)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use core::f32::consts::{FRAC_PI_2, TAU};

    use super::*;

    /// Returns two joints as in the model: 1000 counts per turn, 0.5 N·m/A, 1 mA per count of current.
    fn joints() -> MotorJoints<2> {
        let joint = Joint {
            torque_constant: 0.5,
            current_resolution: 1e-3,
            angle: TAU / 1000.0,
            velocity: 0.0,
            back_emf: None,
        };
        let reversed = Joint { angle: -joint.angle, ..joint };
        MotorJoints {
            joints: [joint, reversed].into_iter().collect(),
            periods: 200,
            last: None,
            has_velocities: false,
        }
    }

    /// Returns the same joints with windings of 1 Ω.
    fn watched() -> MotorJoints<2> {
        let mut joints = joints();
        let winding = Winding { resistance: 1.0, inductance: 1e-3, back_emf: 0.5 };
        joints.joints.iter_mut().for_each(|joint| joint.back_emf = Some(BackEmf::new(winding, joint.angle)));
        joints
    }

    /// Returns what is measured with these totals, and a supply of 11 V.
    fn measured(totals: Totals<2>) -> LoopReport<2> {
        LoopReport { totals, supply: 11_000, has_tripped: false, supply_tripped: false, is_ready: true }
    }

    /// By hand: 199 samples of 12 V and one of 40 V are 12.14 V. In the first period there is no mean, but a
    /// sample of 11 V; and a supply that tripped counts more than the mean.
    #[test]
    fn a_disturbed_sample_hardly_changes_the_supply() {
        let mut joints = joints();
        let totals = Totals { supply: u32::MAX - 7, ..Totals::new() };
        assert_eq!(joints.update(1, [0; 2], &measured(totals)).unwrap().supply, 11_000);
        let sum = 199 * 12_000 + 40_000;
        let totals = Totals { supply: totals.supply.wrapping_add(sum), periods: 200, ..totals };
        assert_eq!(joints.update(2, [0; 2], &measured(totals)).unwrap().supply, 12_140);
        let totals = Totals { supply: totals.supply.wrapping_add(sum), periods: 400, ..totals };
        let tripped = LoopReport { has_tripped: true, supply_tripped: true, ..measured(totals) };
        assert_eq!(joints.update(3, [0; 2], &tripped).unwrap().supply, 11_000);
    }

    /// By hand: 5 counts of 1000 in two periods of 10 ms are π/2 rad/s; 400 samples of 0.3 A are 1 200 000
    /// times 0.1 mA.
    #[test]
    fn velocities_and_mean_currents_by_hand() {
        let mut joints = joints();
        let totals = Totals { currents: [i32::MAX, -7], periods: u32::MAX - 10, ..Totals::new() };
        assert!(!joints.are_slow(1.0), "before anything was read");
        let first = joints.update(3, [i32::MAX, 2], &measured(totals)).unwrap();
        assert!(!joints.are_slow(1.0), "before anything has moved");
        assert!(first.currents == [0, 0] && first.encoders == [i32::MAX, 2], "{first:?}");
        let totals = Totals {
            currents: [i32::MAX.wrapping_add(1_200_000), -1_200_007],
            periods: 389,
            ..Totals::new()
        };
        let second = joints.update(5, [i32::MAX.wrapping_add(5), 7], &measured(totals)).unwrap();
        assert!(second.currents == [300, -300] && second.sequence == 5, "{second:?}");
        let command = joints.command(&[1.0, -0.25]);
        let near = |found: [f32; 2], expected: [f32; 2]| {
            found.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-5)
        };
        assert!(near(command.currents, [2.0, -0.5]), "{command:?}");
        assert!(near(command.velocities, [FRAC_PI_2, -FRAC_PI_2]), "{command:?}");
        assert!(joints.are_slow(0.79) && !joints.are_slow(0.78));
    }

    /// 5 V drive 1 A through 1 Ω at 8 rad/s and 0.5 V·s/rad. Then the second encoder stops, while voltage and
    /// current stay.
    #[test]
    fn an_encoder_that_stands_while_its_motor_turns_is_told() {
        let mut joints = watched();
        let mut totals = Totals::new();
        let counts = |period: i32| [13 * period, -13 * period.min(3)];
        for period in 0..5 {
            let frame = joints.update(period, counts(period.cast_signed()), &measured(totals)).unwrap();
            assert_eq!(frame.flags.dead_encoder(), (period == 4).then_some(1), "{period}");
            totals.currents = totals.currents.map(|sum| sum + 2_000_000);
            totals.voltages = totals.voltages.map(|sum| sum + 1_000_000);
            (totals.periods, totals.driven) = (totals.periods + 200, totals.driven + 200);
        }
        // If the motors are not driven throughout, nothing is known.
        totals.driven -= 1;
        let frame = joints.update(5, counts(5), &measured(totals)).unwrap();
        assert_eq!(frame.flags, SensorFlags(0));
    }

    /// The second motor's current reads 0 while its loop drives it with 5 V.
    #[test]
    fn a_voltage_without_a_current_is_a_fault_of_the_power_stage() {
        let mut joints = watched();
        let mut totals = Totals::new();
        for period in 0..5 {
            let frame = joints.update(period, [0; 2], &measured(totals)).unwrap();
            assert_eq!(frame.flags.0, if period > 2 { SensorFlags::POWER_STAGE } else { 0 }, "{period}");
            totals.currents[0] += 10_000_000;
            totals.voltages = totals.voltages.map(|sum| sum + 1_000_000);
            (totals.periods, totals.driven) = (totals.periods + 200, totals.driven + 200);
        }
    }

    #[test]
    fn loops_that_do_not_run_at_their_rate_are_told() {
        for (samples, is_right) in [(179, false), (180, true), (220, true), (221, false), (0, false)] {
            let mut joints = joints();
            joints.update(1, [0; 2], &measured(Totals::new())).unwrap();
            let told = joints.update(2, [0; 2], &measured(Totals { periods: samples, ..Totals::new() }));
            assert_eq!(told.is_some(), is_right, "{samples}");
        }
    }
}
