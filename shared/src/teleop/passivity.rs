use core::fmt;

use nalgebra::Vector3;

use crate::math;
use crate::{OutOfRange, TICK};

/// Speed below which the handle is at rest [m/s]: damping dissipates no energy there.
const REST_SPEED: f32 = 1e-4;

/// Energy is counted in steps larger than this [J], so that measurement noise of the position adds nothing to
/// either count.
const QUANTUM: f32 = 1e-3;

/// A microjoule [J].
const MICRO: f32 = 1e-6;

/// One end of a delayed bilateral link: passivity observer and passivity controller with separate energies
/// for the two directions (time-domain passivity approach; Ryu, Artigas and Preusche 2010).
///
/// Under zero-order hold the work over a control period is exactly force times displacement. Each end counts
/// the energy that enters ([`PowerPort::energy_in`], sent to the other end with the force or position) and
/// the energy that leaves. The count of the other end arrives late and is therefore never too large, so
/// limiting the output to it keeps the link passive for any delay.
///
/// The counts are integers in microjoules: an `f32` at 16 kJ has a resolution of a millijoule only.
///
/// - At the *master* the output is a force: excess energy is dissipated by damping
///   ([`PowerPort::damping_force`]).
/// - At the *slave* the output is a displacement: it is limited to the available energy
///   ([`PowerPort::limit_displacement`]).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PowerPort {
    /// Energy that entered at this end [µJ].
    energy_in: i64,
    /// Energy that left at this end [µJ].
    energy_out: i64,
    /// Part of it dissipated by damping at this end [µJ].
    dissipated: i64,
    /// Net output not yet counted [J]; negative for input.
    uncounted_output: f32,
    /// Dissipated energy not yet counted [J].
    uncounted_damping: f32,
}

/// Limits of the passivity controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PowerPortLimits {
    max_damping: f32,
    /// Damping at the master while the link exerts a force there, independent of the energies [N·s/m]: 0 to
    /// `max_damping`. Without it a handle on a delayed spring oscillates until the reserve is used up.
    contact_damping: f32,
    energy_reserve: f32,
}

/// Maximum of the damping [N·s/m].
const MAX_DAMPING: f32 = 1e6;
/// Maximum of the energy reserve [J].
const MAX_RESERVE: f32 = 1e3;

/// Why the passivity controller is unsuitable for a link.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum UnsuitableLink {
    /// The damping would destabilise the handle [N·s/m].
    Damping {
        /// Maximum damping.
        value: f32,
        /// Exclusive upper bound.
        limit: f32,
    },
    /// The round-trip delay of the link is too long [s].
    Delay {
        /// Delay of both directions together.
        round_trip: f32,
        /// Maximum round-trip delay for the damping.
        limit: f32,
        /// Maximum stiffness for the damping and this delay [N/m].
        stiffness: f32,
    },
    /// A value is negative, zero where it must not be, or not finite.
    Invalid,
}

impl core::error::Error for UnsuitableLink {}

impl fmt::Display for UnsuitableLink {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Damping { value, limit } => write!(
                f,
                "a damping of {value} N·s/m destabilises the handle: below {limit} N·s/m, its mass over the control period"
            ),
            Self::Delay { round_trip, limit, .. } if *limit <= 0.0 => write!(
                f,
                "the damping cannot dissipate what a link of this stiffness makes even without delay, and it takes \
                 {round_trip} s there and back: less stiffness or more damping"
            ),
            Self::Delay { round_trip, limit, stiffness } => write!(
                f,
                "the link takes {round_trip} s there and back, and the damping is good for {limit} s: a shorter delay, or a \
                 stiffness of at most {stiffness} N/m"
            ),
            Self::Invalid => f.write_str(
                "mass, stiffness and maximum damping must be positive and finite, the delay and the handle's own \
                 damping finite and not negative",
            ),
        }
    }
}

impl PowerPortLimits {
    /// Limits without damping in contact, which [`PowerPortLimits::calm`] adds.
    ///
    /// `max_damping` is the maximum damping at the master [N·s/m], 0 to 10⁶. For stability it must be less
    /// than the mass of handle and hand over the control period, see [`PowerPortLimits::check_link`].
    /// `energy_reserve` is the energy that may leave before any has entered [J], 0 to 1000: it allows the
    /// slave to begin to compress a spring.
    ///
    /// # Errors
    /// The first value outside its range.
    pub const fn try_new(max_damping: f32, energy_reserve: f32) -> Result<Self, OutOfRange> {
        if !(max_damping >= 0.0 && max_damping <= MAX_DAMPING) {
            return Err(OutOfRange { field: "damping", value: max_damping, min: 0.0, max: MAX_DAMPING });
        }
        if !(energy_reserve >= 0.0 && energy_reserve <= MAX_RESERVE) {
            let field = "energy reserve";
            return Err(OutOfRange { field, value: energy_reserve, min: 0.0, max: MAX_RESERVE });
        }
        Ok(Self { max_damping, contact_damping: 0.0, energy_reserve })
    }

    /// Maximum damping at the master [N·s/m].
    pub const fn max_damping(&self) -> f32 {
        self.max_damping
    }

    /// The same limits with a maximum damping of at least `damping` [N·s/m], for a period in which the force
    /// is withheld: no damping that only cancels a force can push.
    #[must_use]
    pub const fn with_damping_up_to(self, damping: f32) -> Self {
        Self { max_damping: self.max_damping.max(damping), ..self }
    }

    /// Checks that the damping at the master can dissipate the energy that the link generates, for a handle
    /// with the hand's `mass` [kg] and its own damping [N·s/m], 0 for none, a slave whose set-point pulls
    /// with `stiffness` K [N/m], and a round-trip delay `round_trip` τ [s].
    ///
    /// At the handle the link acts as a spring with the delay τ + T/2, where T/2, half a control period, is
    /// due to the zero-order hold. With the damping b of port and handle together, its impedance has the real
    /// part `b − K·sin(ω(τ + T/2))/ω`, which is not negative if `b ≥ K·(τ + T/2)` (without delay: Colgate and
    /// Schenkel 1997). This holds at every frequency for the handle's own damping; the port's is sampled and
    /// held, and acts in this way far below the sampling frequency. Otherwise the port still counts the
    /// energy that it cannot dissipate, but the handle may oscillate.
    ///
    /// # Errors
    /// The value that is out of bounds, and the permitted one.
    pub fn check_link(
        &self,
        [mass, own_damping]: [f32; 2],
        stiffness: f32,
        round_trip: f32,
    ) -> Result<(), UnsuitableLink> {
        let positive = |value: f32| value.is_finite() && value > 0.0;
        let not_negative = |value: f32| value.is_finite() && value >= 0.0;
        let handle_is_valid = positive(mass) && not_negative(own_damping) && positive(self.max_damping);
        if !(handle_is_valid && positive(stiffness) && not_negative(round_trip)) {
            return Err(UnsuitableLink::Invalid);
        }
        let limit = mass / TICK;
        if self.max_damping >= limit {
            return Err(UnsuitableLink::Damping { value: self.max_damping, limit });
        }
        let damping = self.max_damping + own_damping;
        let limit = damping / stiffness - 0.5 * TICK;
        if round_trip > limit {
            let stiffness = damping / (round_trip + 0.5 * TICK);
            return Err(UnsuitableLink::Delay { round_trip, limit, stiffness });
        }
        Ok(())
    }

    /// Sets `contact_damping` so that a handle in contact comes to rest by itself, by the condition of
    /// [`PowerPortLimits::check_link`]: `K·(τ + T/2)` minus the handle's `own_damping` [N·s/m], 0 for none,
    /// with `stiffness` K [N/m] and `round_trip` τ [s]; at least 0, at most `max_damping`.
    #[must_use]
    pub const fn calm(self, own_damping: f32, stiffness: f32, round_trip: f32) -> Self {
        let damping = stiffness * (round_trip + 0.5 * TICK) - own_damping;
        Self { contact_damping: math::clamp(damping, 0.0, self.max_damping), ..self }
    }
}

impl PowerPort {
    /// A port through which no energy has passed yet.
    pub const fn new() -> Self {
        Self { energy_in: 0, energy_out: 0, dissipated: 0, uncounted_output: 0.0, uncounted_damping: 0.0 }
    }

    /// Energy that entered at this end [µJ]; send it to the other end.
    pub const fn energy_in(&self) -> i64 {
        self.energy_in
    }

    /// Energy that entered minus energy that left [µJ].
    pub const fn balance(&self) -> i64 {
        let (counted, _) = split(self.uncounted_damping - self.uncounted_output);
        self.net_of_output(self.energy_in).saturating_add(counted)
    }

    /// `energy` minus the undissipated output [µJ].
    const fn net_of_output(&self, energy: i64) -> i64 {
        energy.saturating_sub(self.energy_out).saturating_add(self.dissipated)
    }

    /// Energy that may still leave, given the last known input at the other end [J].
    #[expect(clippy::cast_precision_loss, reason = "exact to a microjoule where little is left")]
    const fn available_energy(&self, limits: &PowerPortLimits, received: i64) -> f32 {
        self.net_of_output(received) as f32 * MICRO + limits.energy_reserve + self.uncounted_damping
            - self.uncounted_output
    }

    /// Counts a control period with the mean link force `force` [N], the `displacement` [m], and the
    /// `damping` force [N]. Values that are not finite are not counted.
    pub fn account(&mut self, force: &Vector3<f32>, damping: &Vector3<f32>, displacement: &Vector3<f32>) {
        let [output, damped] = [force, damping].map(|force| force.dot(displacement));
        if !output.is_finite() || !damped.is_finite() {
            return;
        }
        self.uncounted_output += output;
        if math::abs(self.uncounted_output) > QUANTUM {
            let (counted, rest) = split(self.uncounted_output);
            self.uncounted_output = rest;
            let of = if counted > 0 { &mut self.energy_out } else { &mut self.energy_in };
            *of = of.saturating_add(counted.saturating_abs());
        }
        let (counted, rest) = split(self.uncounted_damping - damped);
        (self.dissipated, self.uncounted_damping) = (self.dissipated.saturating_add(counted), rest);
    }

    /// Damping force [N] to add to `force` at the master, whose handle moves with `velocity` [m/s]. It
    /// dissipates the excess of the energy that has left, with at least the `contact_damping` where there is
    /// a force. `received` is the last known input at the other end [µJ].
    pub fn damping_force(
        &self,
        limits: &PowerPortLimits,
        received: i64,
        force: &Vector3<f32>,
        velocity: &Vector3<f32>,
    ) -> Vector3<f32> {
        let work = force.dot(velocity) * TICK;
        let excess = if work > 0.0 { work } else { 0.0 } - self.available_energy(limits, received);
        let square = velocity.norm_squared();
        if square < REST_SPEED * REST_SPEED {
            return Vector3::zeros();
        }
        let min = if *force == Vector3::zeros() { 0.0 } else { limits.contact_damping };
        velocity * -math::clamp(excess / (square * TICK), min, limits.max_damping)
    }

    /// The part of the `displacement` [m] that the available energy allows at the slave under the link
    /// force `force` [N]; `received` as in [`PowerPort::damping_force`].
    pub fn limit_displacement(
        &self,
        limits: &PowerPortLimits,
        received: i64,
        force: &Vector3<f32>,
        displacement: &Vector3<f32>,
    ) -> Vector3<f32> {
        let work = force.dot(displacement);
        let allowed = self.available_energy(limits, received);
        if work <= 0.0 || work <= allowed {
            *displacement
        } else if allowed <= 0.0 {
            Vector3::zeros()
        } else {
            displacement * (allowed / work)
        }
    }
}

/// Splits an energy [J] into whole microjoules and the remainder [J].
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "saturates; what a period moves is exact enough"
)]
const fn split(energy: f32) -> (i64, f32) {
    let counted = (energy / MICRO) as i64;
    (counted, energy - counted as f32 * MICRO)
}

#[cfg(test)]
#[path = "passivity_tests.rs"]
mod tests;
