use core::fmt;

use crate::math;
use crate::{OutOfRange, TICK};

/// Gain as a share of that at which both poles of the closed loop are equal: two real poles, with little
/// overshoot even if the parameters of the winding are inexact. At 40 kHz and a lag of one period the
/// bandwidth is 1.6 kHz.
const GAIN_SHARE: f32 = 0.72;
/// Time for which a motor without commands is braked before its stage is switched off [s].
const BRAKING: f32 = 0.1;
/// Ticks without a command after which a motor is braked.
const SILENT_TICKS: f32 = 2.0;
/// Supply below which no duty is computed: the stage does not switch there [V].
const SUPPLY_MIN: f32 = 1.0;

/// The winding of a brushed motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Winding {
    /// Resistance, with brushes and bridge [Ω].
    pub resistance: f32,
    /// Inductance [H].
    pub inductance: f32,
    /// Back-EMF per velocity of the joint [V·s/rad]: the torque constant of motor and gear, without losses.
    pub back_emf: f32,
}

/// The supply of the power stages. All current loops of a sample share its reciprocal: a division takes as
/// long as a dozen multiplications.
#[derive(Clone, Copy, Debug)]
pub struct Supply {
    volts: f32,
    /// 1/V; 0 when the stages do not switch.
    inverse: f32,
}

impl From<f32> for Supply {
    /// A supply of `volts`.
    fn from(volts: f32) -> Self {
        if volts > SUPPLY_MIN {
            Self { volts, inverse: 1.0 / volts }
        } else {
            Self { volts: 0.0, inverse: 0.0 }
        }
    }
}

impl Supply {
    /// Returns the voltage [V]; 0 when the stages do not switch.
    pub const fn volts(&self) -> f32 {
        self.volts
    }
}

/// Switching of the power stage.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Switching {
    /// Period of the loop [s]; the current is sampled and the duty changed once per period.
    pub period: f32,
    /// Fraction of a period from a sample until the duty that is computed from it takes effect, at most 1.
    pub lag: f32,
    /// PWM pulses per period.
    pub pulses: u16,
    /// Timer counts of a duty of 1.
    pub resolution: u16,
    /// Largest duty [1]; the rest of the time is for sampling the current.
    pub max_duty: f32,
}

/// Command of the power stage for the next period.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StageCommand {
    /// PWM, in timer counts with the sign of the voltage.
    Duty(i16),
    /// Both low sides on: the motor is shorted.
    Brake,
    /// All switches off: the motor coasts.
    Off,
}

/// A parameter of a current loop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CurrentLoopField {
    /// Resistance of the [`Winding`].
    Resistance,
    /// Inductance of the [`Winding`].
    Inductance,
    /// Back-EMF of the [`Winding`].
    BackEmf,
    /// A field of [`Switching`].
    Switching,
}

impl fmt::Display for CurrentLoopField {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Resistance => "resistance",
            Self::Inductance => "inductance",
            Self::BackEmf => "back-EMF",
            Self::Switching => "switching",
        })
    }
}

/// Current loop of a brushed motor: a PI controller whose zero cancels the winding's pole, by exact
/// discretisation.
///
/// With `a = e^(−R·T/L)` the winding is `i⁺ = a·i + (1 − a)/R·v`; the controller `K·(z − a)/(z − 1)` with
/// `K = g·R/(1 − a)` leaves `g/(z − 1)`. A duty takes effect after the fraction `ℓ` of a period: the previous
/// duty contributes the share `s = (a^(1−ℓ) − a)/(1 − a)` of a period's input, and the characteristic
/// polynomial of the closed loop is `z² − (1 − g·(1 − s))·z + g·s`, whose poles are equal for
/// `g = 1/(1 + √s)²` (Åström, Wittenmark, *Computer-Controlled Systems*). The back-EMF is fed forward. The
/// duty is limited by the measured supply and rounded to timer counts; the integrator is conditioned on the
/// limited voltage, not on the rounded one, so that rounding errors are made up later.
///
/// It has its own command timeout: without a new command for two ticks the motor is braked, then its stage is
/// switched off.
///
/// ```
/// use tesaki::control::{CurrentLoop, CurrentLoopState, StageCommand, Switching, Winding};
/// let winding = Winding { resistance: 2.0, inductance: 1e-3, back_emf: 0.5 };
/// let switching = Switching { period: 25e-6, lag: 1.0, pulses: 1, resolution: 2000, max_duty: 0.95 };
/// let current_loop = CurrentLoop::try_new(&winding, &switching).unwrap();
/// let mut state = CurrentLoopState::new();
/// assert_eq!(current_loop.update(&mut state, 0.0, 12.0), StageCommand::Off);
/// // No current, but the back-EMF of 4 rad/s: 2 V of 12 V.
/// state.command(0.0, 4.0);
/// assert_eq!(current_loop.update(&mut state, 0.0, 12.0), StageCommand::Duty(333));
/// ```
#[derive(Clone, Copy, Debug)]
pub struct CurrentLoop {
    proportional: f32,
    /// Integral gain of a period.
    integral: f32,
    /// Share of the voltage cut off by the limits that leaves the integrator: `1 − a`.
    conditioning: f32,
    back_emf: f32,
    resolution: f32,
    /// Duty of a count.
    count: f32,
    max_counts: f32,
    /// Periods without a command until the motor is braked, and until its stage is off.
    brake_after: u32,
    off_after: u32,
}

/// State of a [`CurrentLoop`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CurrentLoopState {
    target: f32,
    velocity: f32,
    integral: f32,
    /// Periods since the last command.
    age: u32,
}

impl Default for CurrentLoopState {
    fn default() -> Self {
        Self::new()
    }
}

impl CurrentLoopState {
    /// Before the first command: the stage is off.
    pub const fn new() -> Self {
        Self { target: 0.0, velocity: 0.0, integral: 0.0, age: u32::MAX }
    }

    /// Sets a new command: `current` [A] at a joint velocity [rad/s].
    pub const fn command(&mut self, current: f32, velocity: f32) {
        self.target = current;
        self.velocity = velocity;
        self.age = 0;
    }

    /// Switches the stage off until the next command.
    pub const fn release(&mut self) {
        *self = Self::new();
    }
}

impl CurrentLoop {
    /// A loop for this winding.
    ///
    /// # Errors
    /// The first value that is outside its limits.
    pub fn try_new(winding: &Winding, switching: &Switching) -> Result<Self, OutOfRange<CurrentLoopField>> {
        let check = |field, value, min, max| OutOfRange::check(field, value, [min, max]);
        check(CurrentLoopField::Resistance, winding.resistance, 1e-3, 1e3)?;
        check(CurrentLoopField::Inductance, winding.inductance, 1e-6, 1.0)?;
        check(CurrentLoopField::BackEmf, winding.back_emf, 0.0, 100.0)?;
        check(CurrentLoopField::Switching, switching.period, 1e-6, 1e-3)?;
        check(CurrentLoopField::Switching, switching.lag, 0.0, 1.0)?;
        check(CurrentLoopField::Switching, f32::from(switching.pulses), 1.0, 100.0)?;
        check(CurrentLoopField::Switching, f32::from(switching.resolution), 100.0, 32_000.0)?;
        check(CurrentLoopField::Switching, switching.max_duty, 0.1, 1.0)?;
        let remains = math::exp(-winding.resistance * switching.period / winding.inductance);
        let before =
            math::exp(-winding.resistance * (1.0 - switching.lag) * switching.period / winding.inductance);
        let root = math::sqrt((before - remains) / (1.0 - remains));
        let gain = GAIN_SHARE / ((1.0 + root) * (1.0 + root));
        let resolution = f32::from(switching.resolution);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "20 000 to 120 000 at most"
        )]
        let periods = |time: f32| (time / switching.period + 0.5) as u32;
        Ok(Self {
            proportional: gain * winding.resistance / (1.0 - remains),
            integral: gain * winding.resistance,
            conditioning: 1.0 - remains,
            back_emf: winding.back_emf,
            resolution,
            count: 1.0 / resolution,
            max_counts: switching.max_duty * resolution,
            brake_after: periods(SILENT_TICKS * TICK),
            off_after: periods(SILENT_TICKS * TICK + BRAKING),
        })
    }

    /// Runs one period: computes the duty of the next period from the `measured` current [A] and the `supply`
    /// [V].
    #[inline]
    pub fn update(
        &self,
        state: &mut CurrentLoopState,
        measured: f32,
        supply: impl Into<Supply>,
    ) -> StageCommand {
        let Supply { volts, inverse } = supply.into();
        state.age = state.age.saturating_add(1);
        if state.age > self.brake_after {
            state.integral = 0.0;
            return if state.age > self.off_after { StageCommand::Off } else { StageCommand::Brake };
        }
        let error = state.target - measured;
        let requested = self.proportional * error + state.integral + self.back_emf * state.velocity;
        let counts = requested * inverse * self.resolution;
        if !counts.is_finite() {
            state.release();
            return StageCommand::Off;
        }
        let limited = math::clamp(counts, -self.max_counts, self.max_counts);
        #[expect(clippy::cast_possible_truncation, reason = "limited to 32 000")]
        let duty = (limited + if limited < 0.0 { -0.5 } else { 0.5 }) as i16;
        let applied = limited * volts * self.count;
        state.integral += self.integral * error + self.conditioning * (applied - requested);
        StageCommand::Duty(duty)
    }
}

#[cfg(test)]
#[allow(clippy::cast_possible_truncation, clippy::unwrap_used, clippy::type_complexity, reason = "tests")]
mod tests {
    use super::*;

    /// Name, resistance [Ω], inductance [H], back-EMF [V·s/rad], supply [V], and for each deviation of the
    /// winding: factors of resistance and inductance, `a`, `(1 − a)/R`, and the reference response.
    type Motor = (&'static str, [f32; 3], f32, &'static [(f32, f32, f64, f64, &'static [f64])]);

    const MOTORS: &[Motor] = include!("../../../tests/oracles/data/current_loop.in");
    const SWITCHING: Switching =
        Switching { period: 25e-6, lag: 1.0, pulses: 1, resolution: 2000, max_duty: 0.95 };

    /// A winding with its power stage: commands take effect one period later.
    struct Plant {
        a: f64,
        b: f64,
        current: f64,
        /// Between −1 and 1.
        duty: f64,
        emf: f64,
        supply: f64,
        noise: u32,
    }

    impl Plant {
        fn new(a: f64, b: f64, supply: f32) -> Self {
            Self { a, b, current: 0.0, duty: 0.0, emf: 0.0, supply: f64::from(supply), noise: 1 }
        }

        /// Runs one period; `deviation` [A] is the measurement error. Returns the current at its start.
        fn step(&mut self, current_loop: &CurrentLoop, state: &mut CurrentLoopState, deviation: f64) -> f64 {
            let sampled = self.current;
            let drive = current_loop.update(state, (sampled + deviation) as f32, self.supply as f32);
            self.current = self.a * self.current + self.b * (self.duty * self.supply - self.emf);
            self.duty = match drive {
                StageCommand::Duty(counts) => f64::from(counts) / 2000.0,
                StageCommand::Brake => 0.0,
                StageCommand::Off => panic!("coasting is not modelled"),
            };
            sampled
        }

        /// Random number between −1 and 1, uniform.
        fn random(&mut self) -> f64 {
            self.noise = self.noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(self.noise >> 8) / f64::from(1 << 23) - 1.0
        }
    }

    fn each(mut test: impl FnMut(&str, &CurrentLoop, f32, (f32, f32), Plant, &[f64])) {
        let mut windings = 0;
        for &(name, [resistance, inductance, back_emf], supply, deviations) in MOTORS {
            let winding = Winding { resistance, inductance, back_emf };
            let current_loop = CurrentLoop::try_new(&winding, &SWITCHING).unwrap();
            for &(r, l, a, b, response) in deviations {
                // A tenth of the current that the supply drives through the winding at standstill.
                let step = 0.1 * supply / resistance;
                test(name, &current_loop, step, (r, l), Plant::new(a, b, supply), response);
                windings += 1;
            }
        }
        assert_eq!(windings, 27);
    }

    #[test]
    fn steps_follow_the_reference_and_overshoot_by_a_tenth_at_most() {
        each(|name, current_loop, step, deviation, mut plant, response| {
            let mut state = CurrentLoopState::new();
            state.command(step, 0.0);
            let mut highest = 0.0_f64;
            // One count of the duty is 0.05 % of the supply, 0.5 % of the step.
            for &expected in response {
                let current = plant.step(current_loop, &mut state, 0.0) / f64::from(step);
                highest = highest.max(current);
                assert!((current - expected).abs() < 0.01, "{name} {deviation:?}: {current}, {expected}");
            }
            assert!(highest < 1.1, "{name} {deviation:?}: {highest}");
        });
    }

    #[test]
    fn a_kilohertz_passes_with_winding_and_measurement_off() {
        each(|name, current_loop, step, deviation, mut plant, _| {
            let mut state = CurrentLoopState::new();
            let (mut sine, mut cosine) = (0.0, 0.0);
            // 40 periods of 1 kHz are one sample each; the first ten settle.
            for sample in 0..1600_u32 {
                let phase = core::f64::consts::TAU * f64::from(sample % 40) / 40.0;
                let (s, c) = (libm::sin(phase), libm::cos(phase));
                state.command(step * s as f32, 0.0);
                // A 12-bit converter with five times the step as range: half a count, uniform.
                let noise = plant.random() * f64::from(step) * 5.0 / 4096.0;
                let current = plant.step(current_loop, &mut state, noise);
                if sample >= 400 {
                    (sine, cosine) = (sine + current * s, cosine + current * c);
                }
            }
            let amplitude = libm::hypot(sine, cosine) / 600.0 / f64::from(step);
            assert!(amplitude > 0.707, "{name} {deviation:?}: {amplitude}");
            assert!(amplitude < 1.15, "{name} {deviation:?}: {amplitude}");
        });
    }

    #[test]
    fn a_sag_of_the_supply_neither_moves_the_current_nor_winds_the_integrator_up() {
        each(|name, current_loop, step, deviation, mut plant, _| {
            let mut state = CurrentLoopState::new();
            let full = plant.supply;
            // The supply changes within a millisecond.
            let mut run = |plant: &mut Plant, supply: f64, periods| {
                let change = (supply - plant.supply) / 40.0;
                let (mut lowest, mut highest) = (f64::INFINITY, f64::NEG_INFINITY);
                for period in 0..periods {
                    plant.supply += if period < 40 { change } else { 0.0 };
                    state.command(step, 0.0);
                    let current = plant.step(current_loop, &mut state, 0.0) / f64::from(step);
                    (lowest, highest) = (lowest.min(current), highest.max(current));
                }
                (lowest, highest)
            };
            run(&mut plant, full, 400);
            // The voltage of the step is a tenth of the supply: 60 % of it suffice.
            let (lowest, highest) = run(&mut plant, 0.6 * full, 200);
            assert!(lowest > 0.98 && highest < 1.02, "{name} {deviation:?}: {lowest} to {highest}");
            // 5 % do not; the missing voltage is not made up afterwards.
            let (_, highest) = run(&mut plant, 0.05 * full, 2000);
            assert!(highest < 1.02, "{name} {deviation:?}: {highest}");
            let (_, highest) = run(&mut plant, full, 400);
            assert!(highest < 1.1, "{name} {deviation:?}: {highest}");
        });
    }

    #[test]
    fn the_back_emf_of_a_turning_motor_is_fed_forward() {
        each(|name, current_loop, step, deviation, mut plant, response| {
            let mut state = CurrentLoopState::new();
            // 40 % of the supply.
            plant.emf = 0.4 * plant.supply;
            plant.duty = 0.4;
            let velocity = plant.emf as f32 / current_loop.back_emf;
            state.command(step, velocity);
            for &expected in response {
                let current = plant.step(current_loop, &mut state, 0.0) / f64::from(step);
                assert!((current - expected).abs() < 0.01, "{name} {deviation:?}: {current}, {expected}");
            }
        });
    }

    #[test]
    fn without_commands_the_motor_is_braked_after_two_ticks_and_then_off() {
        let winding = Winding { resistance: 2.0, inductance: 1e-3, back_emf: 0.5 };
        let current_loop = CurrentLoop::try_new(&winding, &SWITCHING).unwrap();
        let mut state = CurrentLoopState::new();
        assert_eq!(current_loop.update(&mut state, 0.0, 12.0), StageCommand::Off);
        state.command(1.0, 0.0);
        // 20 ms are 800 periods, 100 ms of braking 4000.
        for period in 1..6000 {
            let drive = current_loop.update(&mut state, 0.5, 12.0);
            match period {
                ..=800 => assert!(matches!(drive, StageCommand::Duty(counts) if counts > 0), "{period}"),
                801..=4800 => assert_eq!(drive, StageCommand::Brake, "{period}"),
                _ => assert_eq!(drive, StageCommand::Off, "{period}"),
            }
        }
        // The integrator starts at 0 again.
        state.command(0.0, 0.0);
        assert_eq!(current_loop.update(&mut state, 0.0, 12.0), StageCommand::Duty(0));
    }

    #[test]
    fn what_is_no_number_switches_off_and_a_missing_supply_gives_no_duty() {
        let winding = Winding { resistance: 2.0, inductance: 1e-3, back_emf: 0.5 };
        let current_loop = CurrentLoop::try_new(&winding, &SWITCHING).unwrap();
        let mut state = CurrentLoopState::new();
        state.command(1.0, 0.0);
        assert_eq!(current_loop.update(&mut state, f32::NAN, 12.0), StageCommand::Off);
        assert_eq!(current_loop.update(&mut state, 0.0, 12.0), StageCommand::Off, "until the next command");
        state.command(1.0, 0.0);
        assert_eq!(current_loop.update(&mut state, 0.0, 0.0), StageCommand::Duty(0));
        let refused = CurrentLoop::try_new(&Winding { inductance: 0.0, ..winding }, &SWITCHING).unwrap_err();
        assert_eq!(refused.to_string(), "inductance is 0; it must be 0.000001 to 1");
    }
}
