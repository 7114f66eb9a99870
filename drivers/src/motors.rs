//! Brushed motors on power stages with a direction and a pulse each: wake, current loops, trip, command
//! timeout.

use heapless::spsc::Consumer;
use tesaki::OutOfRange;
use tesaki::control::{
    CurrentLoop, CurrentLoopField, CurrentLoopState, StageCommand, Supply, Switching, Winding,
};
use tesaki::math;

use crate::current_sign::CurrentSign;
use crate::exchange::LoopReport;

/// Resolution of the sums of currents [A].
pub const SUM_RESOLUTION: f32 = 1e-4;
/// Resolution of the sums of voltages [V].
pub const VOLTAGE_RESOLUTION: f32 = 1e-3;

/// The reciprocals, as a product takes a tenth of the time of a quotient. In decimals they are exact.
const SUMS_PER_AMPERE: f32 = 1e4;
const SUMS_PER_VOLT: f32 = 1e3;

/// So many samples of the supply above its limit, one after the other, trip. A power stage that switches
/// disturbs a single one.
const HIGH_SAMPLES: u8 = 4;

/// How the power stage measures a current.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sensing {
    /// Its magnitude. [`CurrentSign`] finds the sign.
    Magnitude,
    /// The current itself.
    Signed,
}

/// A motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motor {
    /// Its winding.
    pub winding: Winding,
    /// How its current is measured.
    pub sensing: Sensing,
    /// Current above which all motors are switched off [A].
    pub trip: f32,
}

/// Output of a power stage until the next period.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Output {
    /// Whether the voltage is positive.
    pub positive: bool,
    /// Duty in timer counts; 0 shorts the motor.
    pub counts: u16,
}

/// The power stages of `N` motors, which sleep and wake together.
pub trait PowerStages<const N: usize> {
    /// Puts the stages to sleep: the motors coast, whatever the outputs are.
    fn off(&mut self);
    /// Wakes the stages, without pulses.
    fn wake(&mut self);
    /// Lets pulses pass until the hardware's trip stops them.
    fn enable_pulses(&mut self);
    /// Returns whether the hardware stopped the pulses.
    fn has_tripped(&self) -> bool;
    /// Sets the next duties, which take effect after [`Switching::lag`], and the directions, which take
    /// effect at once.
    fn set(&mut self, outputs: &[Output; N]);
}

/// Currents of a control period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command<const N: usize> {
    /// Currents [A].
    pub currents: [f32; N],
    /// Joint velocities, for the back-EMF [rad/s].
    pub velocities: [f32; N],
}

/// Sums of the measurements since the start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Totals<const N: usize> {
    /// Sums of the currents in [`SUM_RESOLUTION`]; they wrap.
    pub currents: [i32; N],
    /// Sums of the voltages in [`VOLTAGE_RESOLUTION`]; they wrap.
    pub voltages: [i32; N],
    /// Sum of the supply in [`VOLTAGE_RESOLUTION`]; it wraps.
    pub supply: u32,
    /// Number of periods; it wraps.
    pub periods: u32,
    /// Number of periods in which the motors were driven; it wraps.
    pub driven: u32,
}

impl<const N: usize> Totals<N> {
    /// Creates totals of zero.
    pub const fn new() -> Self {
        Self { currents: [0; N], voltages: [0; N], supply: 0, periods: 0, driven: 0 }
    }
}

impl<const N: usize> Default for Totals<N> {
    fn default() -> Self {
        Self::new()
    }
}

#[derive(Clone, Copy, Debug)]
struct Axis {
    current_loop: CurrentLoop,
    /// Present if only the magnitude is measured.
    sign: Option<CurrentSign>,
    /// Mean of the current as a multiple of a sample.
    ripple: f32,
    trip: f32,
    velocity: f32,
    state: CurrentLoopState,
    /// The last two duties [1], with the sign of the voltage.
    duties: [f32; 2],
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    Off,
    /// Waits this many periods until the power stages work.
    Waking(u16),
    Running,
    /// Switched off by a trip, until the next command to switch off.
    Tripped,
}

/// Drives the motors, a sample of their currents at a time.
///
/// The motors are off until the first command. The power stages get their time to wake before the first
/// pulse. A current beyond the trip, four samples of the supply above its limit, or a trip of the hardware
/// switches all motors off until [`Motors::command`] has been called with `None`. (Motors that brake can
/// raise the supply within a control period.) If commands stop, [`CurrentLoop`] first brakes, and then the
/// motors are switched off.
#[derive(Clone, Copy, Debug)]
pub struct Motors<const N: usize> {
    axes: [Option<Axis>; N],
    phase: Phase,
    wake_periods: u16,
    /// Supply above which all motors are switched off [V].
    supply_max: f32,
    /// The last sample of the supply [V]; after a trip, the one at which it came.
    supply: f32,
    /// Samples above `supply_max` until the last one, up to a trip.
    high_samples: u8,
    /// Duty of a count.
    count: f32,
    lag: f32,
    outputs: [Output; N],
    totals: Totals<N>,
}

/// Computes the mean current as a multiple of the current in the middle between two pulses.
///
/// While the motor is shorted, its current decays with the time constant of the winding, `i·e^(−t·R/L)`. Over
/// a period `T` of short pulses that is `sinh(x)/x` times the current in its middle, with `x = R·T/(2·L)`;
/// longer pulses leave less.
///
/// # Errors
/// The winding is faster than the pulses: its current would be gone before it is sampled.
fn ripple(winding: &Winding, switching: &Switching) -> Result<f32, OutOfRange<CurrentLoopField>> {
    let half = 0.5 * switching.period / f32::from(switching.pulses.max(1));
    let x = winding.resistance * half / winding.inductance;
    if x > 1.0 {
        return Err(OutOfRange {
            field: CurrentLoopField::Inductance,
            value: winding.inductance,
            min: winding.resistance * half,
            max: 1.0,
        });
    }
    // The next term of the series is 1/5040 at most.
    Ok(1.0 + x * x / 6.0 + x * x * x * x / 120.0)
}

impl<const N: usize> Motors<N> {
    /// Creates motors with these windings; a board may have more power stages than motors. `supply_max` is
    /// the supply above which all are switched off [V], `wake` the time that a power stage takes to wake [s].
    ///
    /// # Errors
    /// The motor and the value for which there is no current loop.
    pub fn try_new(
        motors: &[Option<Motor>; N],
        supply_max: f32,
        switching: &Switching,
        wake: f32,
    ) -> Result<Self, (usize, OutOfRange<CurrentLoopField>)> {
        let mut all = Self { supply_max, ..Self::none(switching, wake) };
        for (index, (axis, motor)) in all.axes.iter_mut().zip(motors).enumerate() {
            if let Some(Motor { winding, sensing, trip }) = *motor {
                let invalid = |error| (index, error);
                *axis = Some(Axis {
                    current_loop: CurrentLoop::try_new(&winding, switching).map_err(invalid)?,
                    sign: match sensing {
                        Sensing::Magnitude => Some(CurrentSign::new(&winding, switching.period)),
                        Sensing::Signed => None,
                    },
                    ripple: ripple(&winding, switching).map_err(invalid)?,
                    trip,
                    velocity: 0.0,
                    state: CurrentLoopState::new(),
                    duties: [0.0; 2],
                });
            }
        }
        Ok(all)
    }

    /// Creates power stages without motors, until [`take_over`](Self::take_over). `wake` as for
    /// [`try_new`](Self::try_new).
    pub fn none(switching: &Switching, wake: f32) -> Self {
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
        let wake_periods = (wake / switching.period) as u16 + 1;
        Self {
            axes: [None; N],
            phase: Phase::Off,
            wake_periods,
            supply_max: f32::INFINITY,
            supply: 0.0,
            high_samples: 0,
            count: 1.0 / f32::from(switching.resolution),
            lag: switching.lag,
            outputs: [Output::default(); N],
            totals: Totals::new(),
        }
    }

    /// Switches the motors off and replaces them, if there are `new` ones. The [`Totals`] continue.
    pub fn take_over(&mut self, new: &mut Consumer<'_, Self>, stages: &mut impl PowerStages<N>) {
        if let Some(other) = new.peek() {
            self.command(None, stages);
            *self = Self { totals: self.totals, ..*other };
            let _ = new.dequeue();
        }
    }

    /// Returns what was measured. `is_ready` tells whether the currents can be measured.
    pub fn report(&self, is_ready: bool) -> LoopReport<N> {
        let has_tripped = self.phase == Phase::Tripped;
        let supply_tripped = has_tripped && self.high_samples == HIGH_SAMPLES;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
        let supply = (self.supply * SUMS_PER_VOLT) as u16;
        LoopReport {
            totals: self.totals,
            // Rounded up: in millivolts, too, it is above the limit.
            supply: supply.saturating_add(supply_tripped.into()),
            has_tripped,
            supply_tripped,
            is_ready,
        }
    }

    /// Takes the command of a control period; `None` switches the motors off.
    pub fn command(&mut self, command: Option<&Command<N>>, stages: &mut impl PowerStages<N>) {
        let Some(Command { currents, velocities }) = command else {
            self.switch_off(Phase::Off, stages);
            return;
        };
        if self.phase == Phase::Off {
            stages.wake();
            self.phase = Phase::Waking(self.wake_periods);
        }
        for (axis, (&current, &velocity)) in self.axes.iter_mut().zip(currents.iter().zip(velocities)) {
            if let Some(axis) = axis {
                axis.velocity = velocity;
                axis.state.command(current, velocity);
            }
        }
    }

    /// Runs one period of the current loops from the measured currents [A] and the supply [V]. A current that
    /// is NaN trips.
    pub fn update(&mut self, measured: &[f32; N], supply: f32, stages: &mut impl PowerStages<N>) {
        self.totals.periods = self.totals.periods.wrapping_add(1);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "saturates; a supply has some volts"
        )]
        let supply_counts = (supply * SUMS_PER_VOLT) as u32;
        self.totals.supply = self.totals.supply.wrapping_add(supply_counts);
        if self.phase == Phase::Tripped {
            return;
        }
        self.supply = supply;
        let is_high = supply > self.supply_max;
        self.high_samples = if is_high { HIGH_SAMPLES.min(self.high_samples + 1) } else { 0 };
        match self.phase {
            Phase::Off | Phase::Tripped => {}
            Phase::Waking(0) => {
                stages.enable_pulses();
                self.phase = Phase::Running;
            }
            Phase::Waking(periods) => self.phase = Phase::Waking(periods - 1),
            Phase::Running => self.run(measured, supply, stages),
        }
    }

    fn run(&mut self, measured: &[f32; N], supply: f32, stages: &mut impl PowerStages<N>) {
        let supply = Supply::from(supply);
        let mut off = false;
        let mut tripped = stages.has_tripped() || self.high_samples == HIGH_SAMPLES;
        self.totals.driven = self.totals.driven.wrapping_add(1);
        let totals = self.totals.currents.iter_mut().zip(&mut self.totals.voltages);
        let axes = self.axes.iter_mut().zip(&mut self.outputs);
        for ((axis, output), (&measured, (total, total_voltage))) in axes.zip(measured.iter().zip(totals)) {
            let Some(axis) = axis else { continue };
            let [before, last] = axis.duties;
            let duty = self.lag * before + (1.0 - self.lag) * last;
            let voltage = duty * supply.volts();
            #[expect(clippy::cast_possible_truncation, reason = "saturates; a supply has some volts")]
            let counts = (voltage * SUMS_PER_VOLT) as i32;
            *total_voltage = total_voltage.wrapping_add(counts);
            let current = match &mut axis.sign {
                Some(sign) => sign.resolve(measured, voltage, axis.velocity),
                None => measured,
            };
            let current = axis.ripple * current;
            #[expect(
                clippy::cast_possible_truncation,
                reason = "saturates; a converter measures some amperes"
            )]
            let counts = (current * SUMS_PER_AMPERE) as i32;
            *total = total.wrapping_add(counts);
            // False for NaN.
            let is_permitted = math::abs(current) <= axis.trip;
            tripped |= !is_permitted;
            let duty = match axis.current_loop.update(&mut axis.state, current, supply) {
                StageCommand::Duty(duty) => duty,
                StageCommand::Brake => 0,
                StageCommand::Off => {
                    off = true;
                    0
                }
            };
            // The direction takes effect at once, during the pulse of the last duty, so it changes only when
            // there is no pulse.
            if duty != 0 && (duty > 0) != output.positive && output.counts != 0 {
                output.counts = 0;
            } else {
                output.positive = if duty == 0 { output.positive } else { duty > 0 };
                output.counts = duty.unsigned_abs();
            }
            let magnitude = f32::from(output.counts) * self.count;
            axis.duties = [last, if output.positive { magnitude } else { -magnitude }];
        }
        if tripped || off {
            self.switch_off(if tripped { Phase::Tripped } else { Phase::Off }, stages);
        } else {
            stages.set(&self.outputs);
        }
    }

    fn switch_off(&mut self, phase: Phase, stages: &mut impl PowerStages<N>) {
        stages.off();
        self.phase = phase;
        self.outputs = [Output::default(); N];
        stages.set(&self.outputs);
        for axis in self.axes.iter_mut().flatten() {
            axis.state.release();
            if let Some(sign) = &mut axis.sign {
                sign.reset();
            }
            axis.duties = [0.0; 2];
        }
    }
}

#[cfg(test)]
#[path = "motors_tests.rs"]
mod tests;
