//! Detection of dead encoders and current senses by the equation of their motor's winding.

use tesaki::TICK;
use tesaki::control::Winding;
use tesaki::math;

/// Largest relative error of a resistance: that of copper rises by 0.4 % per kelvin.
const RESISTANCE_ERROR: f32 = 0.25;
/// Largest relative error of a back-EMF constant.
const CONSTANT_ERROR: f32 = 0.25;
/// Largest error of the change of a mean voltage [V], by converter and transistors.
const VOLTAGE_ERROR: f32 = 0.05;

/// Largest voltage across brushes, transistors and cables [V].
const DROP: f32 = 2.0;
/// Share of a voltage, due to current or velocity, that may be wrong in addition to `DROP`: a torque constant
/// may contain the efficiency of a gear, which a back-EMF constant does not.
const UNEXPLAINED: f32 = 0.5;
/// Consecutive periods with a voltage that is not explained until the current is not believed. A dead encoder
/// is found earlier.
const UNEXPLAINED_PERIODS: u8 = 3;

/// What contradicts the winding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Contradiction {
    /// The encoder has stopped while the motor turns.
    Encoder,
    /// No current explains the voltage: a current sense that is dead or reads too little, whose loop then
    /// drives without bound, or an open circuit.
    Current,
}

/// A control period of a motor that was driven throughout.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Period {
    /// Mean voltage [V].
    pub voltage: f32,
    /// Mean current [A].
    pub current: f32,
    /// Mean velocity of the joint by its encoder [rad/s].
    pub velocity: f32,
}

/// Compares a joint's encoder with the voltage that its motor induces.
///
/// Averaged over a period, a brushed motor has `v = R·i + k·ω`, except for `L·Δi/T`. Brushes, transistors and
/// a warm winding make `v − R·i` too inaccurate to give a velocity at low speed. Its change within a period
/// or two is accurate enough, as most of these errors stay the same. So if the encoder shows that the joint
/// has slowed down, the back-EMF must have fallen, too. If it has not, by more than the errors of all
/// constants explain, the encoder has stopped and not the joint.
///
/// A current that is measured too small has no upper bound: its loop raises the voltage to the limit. So a
/// voltage far beyond `R·i + k·ω` contradicts the current.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BackEmf {
    winding: Winding,
    /// One count of the encoder per control period, as a velocity [rad/s].
    count: f32,
    /// The last two periods, the last one first.
    past: [Option<Period>; 2],
    /// Consecutive periods with a voltage that is not explained.
    unexplained: u8,
}

impl BackEmf {
    /// Creates the comparison for a motor with this winding and an encoder of which one count is this `angle`
    /// [rad].
    pub fn new(winding: Winding, angle: f32) -> Self {
        Self { winding, count: math::abs(angle) / TICK, past: [None; 2], unexplained: 0 }
    }

    /// Takes the next period, `None` if the motor was not driven throughout. Returns what contradicts the
    /// winding.
    pub fn update(&mut self, period: Option<Period>) -> Option<Contradiction> {
        let [last, before] = self.past;
        self.past = [period, last];
        let is_unexplained = period.is_some_and(|now| self.is_unexplained(&now));
        self.unexplained = if is_unexplained { self.unexplained.saturating_add(1) } else { 0 };
        let now = period?;
        if [last, before].iter().flatten().any(|past| self.has_stopped_alone(past, &now)) {
            return Some(Contradiction::Encoder);
        }
        (self.unexplained >= UNEXPLAINED_PERIODS).then_some(Contradiction::Current)
    }

    /// Returns whether current and velocity of a period do not explain its voltage.
    fn is_unexplained(&self, now: &Period) -> bool {
        let (of_current, of_velocity) =
            (self.winding.resistance * now.current, self.winding.back_emf * now.velocity);
        let error = UNEXPLAINED * (math::abs(of_current) + math::abs(of_velocity)) + DROP;
        math::abs(now.voltage - of_current - of_velocity) > error
    }

    /// Returns whether the encoder has stopped since a `past` period, but the motor has not.
    fn has_stopped_alone(&self, past: &Period, now: &Period) -> bool {
        let direction = if past.velocity < 0.0 { -1.0 } else { 1.0 };
        let lost = direction * (past.velocity - now.velocity);
        // The voltage across the brushes changes with the sign of the current.
        if lost <= 0.0 || past.current * now.current < 0.0 {
            return false;
        }
        let Winding { resistance, inductance, back_emf } = self.winding;
        let current = now.current - past.current;
        let of_current = RESISTANCE_ERROR * resistance + 2.0 * inductance / TICK;
        // Each velocity has an error of up to one count.
        let of_velocity = CONSTANT_ERROR * lost + 2.0 * self.count;
        let error = of_current * math::abs(current) + back_emf * of_velocity + VOLTAGE_ERROR;
        let gained = direction * (now.voltage - past.voltage - resistance * current);
        gained + back_emf * lost > error
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Coreless with a gear; iron-core; both typical of data sheets.
    const WINDINGS: [Winding; 2] = [
        Winding { resistance: 10.6, inductance: 2.3e-4, back_emf: 0.5 },
        Winding { resistance: 1.0, inductance: 5e-4, back_emf: 0.1 },
    ];
    /// Inertia at the joint [kg·m²] and Coulomb friction [N·m].
    const MECHANICS: [(f64, f64); 2] = [(1.5e-3, 0.02), (4e-4, 0.01)];

    /// A joint under a PD servo, in steps of 50 µs. `errors`: of resistance, back-EMF constant and inertia.
    struct Joint {
        winding: Winding,
        inertia: f64,
        coulomb: f64,
        resistance: f64,
        constant: f64,
        angle: f64,
        velocity: f64,
        current: f64,
        /// Where a rigid stop is [rad].
        stop: f64,
        /// Angle by the encoder, and whether it is dead.
        encoder: f64,
        /// Angle of a count [rad].
        count: f64,
        is_dead: bool,
        watch: BackEmf,
        time: f64,
        last: f64,
        noise: u32,
    }

    impl Joint {
        fn new(kind: usize, errors: [f64; 3], counts_per_turn: f64) -> Self {
            let count = std::f64::consts::TAU / counts_per_turn;
            let winding = WINDINGS[kind];
            #[expect(clippy::cast_possible_truncation, reason = "a test")]
            let watch = BackEmf::new(winding, count as f32);
            let (inertia, coulomb) = MECHANICS[kind];
            Self {
                winding,
                inertia: inertia * (1.0 + errors[2]),
                coulomb,
                resistance: f64::from(winding.resistance) * (1.0 + errors[0]),
                constant: f64::from(winding.back_emf) * (1.0 + errors[1]),
                angle: 0.0,
                velocity: 0.0,
                current: 0.0,
                stop: f64::INFINITY,
                encoder: 0.0,
                count,
                is_dead: false,
                watch,
                time: 0.0,
                last: 0.0,
                noise: 1,
            }
        }

        fn noise(&mut self) -> f64 {
            self.noise = self.noise.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(self.noise >> 16) / 32768.0 - 1.0
        }

        /// Runs a control period towards an angle of `reference`, with a velocity. Returns what the watch
        /// reports. The encoder dies after the fraction `dies` of the period.
        fn period(&mut self, reference: f64, velocity: f64, dies: f64) -> Option<Contradiction> {
            let measured = (self.encoder - self.last) / 0.01;
            let torque = self.inertia * (900.0 * (reference - self.encoder) + 60.0 * (velocity - measured))
                + self.coulomb * if velocity == 0.0 { 0.0 } else { velocity.signum() };
            let target = (torque / f64::from(self.winding.back_emf)).clamp(-3.0, 3.0);
            self.last = self.encoder;
            let (mut voltages, mut currents) = (0.0, 0.0);
            for step in 0..200 {
                // A current loop that reaches its target within a millisecond.
                let voltage = (self.resistance * self.current
                    + self.constant * self.velocity
                    + 2e3 * f64::from(self.winding.inductance) * (target - self.current))
                    .clamp(-12.0, 12.0);
                voltages += voltage;
                currents += self.current;
                for _ in 0..10 {
                    let induced = self.constant * self.velocity;
                    self.current += 5e-6 / f64::from(self.winding.inductance)
                        * (voltage - self.resistance * self.current - induced);
                    let driving = self.constant * self.current;
                    let friction = if self.velocity == 0.0 {
                        driving.clamp(-self.coulomb, self.coulomb)
                    } else {
                        self.coulomb * self.velocity.signum()
                    };
                    let next = self.velocity + 5e-6 * (driving - friction) / self.inertia;
                    self.velocity = if next * self.velocity < 0.0 { 0.0 } else { next };
                    self.angle += 5e-6 * self.velocity;
                    if self.angle > self.stop {
                        (self.angle, self.velocity) = (self.stop, 0.0);
                    }
                }
                self.is_dead |= f64::from(step) >= 200.0 * dies;
                if !self.is_dead {
                    self.encoder = (self.angle / self.count).floor() * self.count;
                }
            }
            self.time += 0.01;
            let noise = [self.noise(), self.noise()];
            #[expect(clippy::cast_possible_truncation, reason = "a test")]
            let period = Period {
                voltage: (voltages / 200.0 + 0.01 * noise[0]) as f32,
                current: (currents / 200.0 + 0.001 * noise[1]) as f32,
                velocity: ((self.encoder - self.last) / 0.01) as f32,
            };
            self.watch.update(Some(period))
        }
    }

    /// Returns the errors of resistance, back-EMF constant and inertia.
    fn errors() -> impl Iterator<Item = [f64; 3]> {
        let two = [-0.2, 0.2];
        two.into_iter().flat_map(move |r| two.into_iter().flat_map(move |k| two.map(move |m| [r, k, m])))
    }

    /// Oscillations, reversals, and impacts on a rigid stop.
    #[test]
    fn an_encoder_that_lives_is_believed() {
        for (kind, errors) in (0..2).flat_map(|kind| errors().map(move |errors| (kind, errors))) {
            for (amplitude, frequency, stop) in
                [(0.3, 0.5, 1.0), (0.1, 3.0, 1.0), (0.5, 1.0, 0.4), (0.5, 2.0, 0.1), (0.02, 4.0, 1.0)]
            {
                for counts_per_turn in [1000.0, 4000.0, 65536.0] {
                    let mut joint = Joint::new(kind, errors, counts_per_turn);
                    joint.stop = stop;
                    let rate = std::f64::consts::TAU * frequency;
                    for _ in 0..1000 {
                        let phase = rate * joint.time;
                        let reference = (amplitude * phase.sin(), amplitude * rate * phase.cos());
                        let told = joint.period(reference.0, reference.1, 2.0);
                        let time = joint.time;
                        assert_eq!(
                            told, None,
                            "{kind} {errors:?} {amplitude} {frequency} {counts_per_turn} at {time}"
                        );
                    }
                }
            }
        }
    }

    /// At 1 and 3 rad/s with the gear, 5 and 15 rad/s without one, wherever in a period it dies.
    #[test]
    fn an_encoder_that_dies_in_motion_is_found_within_two_periods() {
        for (kind, errors) in (0..2).flat_map(|kind| errors().map(move |errors| (kind, errors))) {
            for (velocity, dies) in
                [1.0, 3.0].into_iter().flat_map(|v| (0..10).map(move |step| (v, f64::from(step) / 10.0)))
            {
                let velocity = if kind == 0 { velocity } else { 5.0 * velocity };
                let mut joint = Joint::new(kind, errors, 65536.0);
                let mut run = |periods: u32, dies: f64| {
                    (1..=periods).find(|_| {
                        let reference = velocity * joint.time;
                        let told = joint.period(reference, velocity, dies);
                        assert_ne!(told, Some(Contradiction::Current));
                        told.is_some()
                    })
                };
                assert_eq!(run(50, 2.0), None);
                let found = run(10, dies);
                assert!(found.is_some_and(|n| n <= 2), "{kind} {errors:?} {velocity} {dies}: {found:?}");
            }
        }
    }

    /// With 1 Ω and 0.1 V·s/rad, an encoder that stops at 10 rad/s claims that 1 V of back-EMF is gone, at
    /// least 0.75 V with the error of the constant; the voltage has an error of 0.05 V. So a voltage that
    /// falls by less than 0.7 V contradicts the encoder. If the current falls by 1 A, the voltage falls by
    /// another 1 V, with errors of 0.25 V from the resistance and 0.1 V from the inductance.
    #[test]
    fn by_hand() {
        let past = Period { voltage: 3.0, current: 2.0, velocity: 10.0 };
        let says = |voltage: f32, current: f32, velocity: f32| {
            let mut watch = BackEmf::new(WINDINGS[1], 0.0);
            assert_eq!(watch.update(Some(past)), None);
            watch.update(Some(Period { voltage, current, velocity })) == Some(Contradiction::Encoder)
        };
        assert!(says(2.31, 2.0, 0.0) && !says(2.29, 2.0, 0.0));
        assert!(says(1.66, 1.0, 0.0) && !says(1.64, 1.0, 0.0));
        assert!(!says(3.0, 2.0, 10.5), "faster");
        assert!(!says(3.0, -0.1, 0.0), "brushes");
        let mut watch = BackEmf::new(WINDINGS[1], 0.0);
        let stopped = Some(Period { velocity: 0.0, ..past });
        let told = [Some(past), None, stopped, None, None, stopped].map(|period| watch.update(period));
        assert_eq!(told, [None, None, Some(Contradiction::Encoder), None, None, None]);
    }

    /// With 1 Ω and 0.1 V·s/rad, 2 A and 10 rad/s explain 3 V with an error of 1.5 V, and brushes and
    /// transistors another 2 V.
    #[test]
    fn a_voltage_without_its_current_by_hand() {
        let explained = Period { voltage: 6.49, current: 2.0, velocity: 10.0 };
        let unexplained = Some(Period { voltage: 6.51, ..explained });
        let opposite = Some(Period { voltage: -6.51, current: -2.0, velocity: -10.0 });
        let mut watch = BackEmf::new(WINDINGS[1], 0.0);
        let mut told =
            |periods: &[Option<Period>]| periods.iter().fold(None, |_, period| watch.update(*period));
        assert_eq!(told(&[Some(explained); 10]), None);
        for between in [Some(explained), None] {
            assert_eq!(told(&[unexplained, unexplained, between, unexplained, unexplained]), None);
        }
        assert_eq!(told(&[unexplained, opposite, unexplained]), Some(Contradiction::Current));
    }
}
