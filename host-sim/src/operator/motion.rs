//! Trajectories of the operator's hand.

use core::f64::consts::{PI, TAU};

use rapier3d::na::{Isometry3, Translation3, UnitQuaternion, Vector3};
use tesaki::signal::MINIMUM_JERK_PEAK;
use tesaki_supervisor::trajectory::minimum_jerk;

use crate::purpose::Purpose;

/// Frequency band of the physiological tremor of an unsupported hand [Hz].
pub const TREMOR_BAND: [f64; 2] = [8.0, 12.0];
/// Number of sinusoids that compose the tremor of an axis.
const TREMOR_PARTS: usize = 12;

/// Pose and velocity of the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OperatorHandState {
    /// Position and orientation.
    pub pose: Isometry3<f64>,
    /// Velocity [m/s].
    pub velocity: Vector3<f64>,
    /// Angular velocity [rad/s].
    pub angular_velocity: Vector3<f64>,
}

/// A minimum-jerk motion from rest to rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stroke {
    /// Start time [s].
    pub begin: f64,
    /// Duration [s].
    pub duration: f64,
    /// Displacement [m].
    pub shift: Vector3<f64>,
    /// Rotation vector in the base frame [rad].
    pub turn: Vector3<f64>,
}

/// Parameters of seeded strokes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StrokeValues {
    /// The hand stays within this distance of its start along each axis [m].
    pub reach: f64,
    /// It stays within this angle of its initial orientation about each axis [rad].
    pub tilt: f64,
    /// Range of the peak speed of a stroke [m/s].
    pub speed: [f64; 2],
    /// Fraction of the strokes that return directly to the start of the one before.
    pub reversals: f64,
    /// Fraction of the strokes that are followed by a pause.
    pub pauses: f64,
    /// Range of the duration of a pause [s].
    pub pause: [f64; 2],
}

impl Default for StrokeValues {
    /// Unhurried reaching: 0.1 to 0.5 m/s within 10 cm and 0.3 rad.
    fn default() -> Self {
        Self { reach: 0.1, tilt: 0.3, speed: [0.1, 0.5], reversals: 0.3, pauses: 0.3, pause: [0.2, 0.8] }
    }
}

#[derive(Clone, Debug)]
enum Trajectory {
    Sine { amplitude: Vector3<f64>, frequency: f64, begin: f64, end: f64 },
    Strokes(Vec<Stroke>),
}

#[derive(Clone, Copy, Debug)]
struct Tremor {
    amplitude: Vector3<f64>,
    /// Angular frequency [rad/s].
    frequency: f64,
    phase: f64,
}

/// Trajectory of an operator's hand, as a function of time.
#[derive(Clone, Debug)]
pub struct OperatorHandMotion {
    start: Isometry3<f64>,
    trajectory: Trajectory,
    tremor: Vec<Tremor>,
}

impl OperatorHandMotion {
    /// Creates a sine about `start`; (0.1, 0, 0) m at 0.5 Hz in the paper's master-slave experiment. The
    /// amplitude rises within the first half period and falls within the last; before and after, the hand is
    /// at rest.
    pub const fn sine(
        start: Isometry3<f64>,
        amplitude: Vector3<f64>,
        frequency: f64,
        [begin, end]: [f64; 2],
    ) -> Self {
        Self { start, trajectory: Trajectory::Sine { amplitude, frequency, begin, end }, tremor: Vec::new() }
    }

    /// Creates a sequence of strokes, ordered by time.
    pub const fn strokes(start: Isometry3<f64>, strokes: Vec<Stroke>) -> Self {
        Self { start, trajectory: Trajectory::Strokes(strokes), tremor: Vec::new() }
    }

    /// Creates seeded strokes with pauses and reversals, from 0 to about `duration` [s].
    pub fn reaching(start: Isometry3<f64>, values: &StrokeValues, seed: u64, duration: f64) -> Self {
        let mut rng = Purpose::HandMotion.rng(seed);
        let mut within = move |[low, high]: [f64; 2]| low + (high - low) * (0.5 + 0.5 * rng.symmetric());
        let (mut strokes, mut time): (Vec<Stroke>, f64) = (Vec::new(), 0.0);
        let (mut place, mut tilt) = (Vector3::zeros(), Vector3::zeros());
        while time < duration {
            let back = strokes.last().filter(|_| within([0.0, 1.0]) < values.reversals);
            let (shift, turn) = match back {
                Some(last) => (-last.shift, -last.turn),
                None => (
                    Vector3::from_fn(|_, _| within([-values.reach, values.reach])) - place,
                    Vector3::from_fn(|_, _| within([-values.tilt, values.tilt])) - tilt,
                ),
            };
            let stroke_time = (f64::from(MINIMUM_JERK_PEAK) * shift.norm() / within(values.speed)).max(0.2);
            strokes.push(Stroke { begin: time, duration: stroke_time, shift, turn });
            (place, tilt, time) = (place + shift, tilt + turn, time + stroke_time);
            if within([0.0, 1.0]) < values.pauses {
                time += within(values.pause);
            }
        }
        Self::strokes(start, strokes)
    }

    /// Adds a tremor of 8 to 12 Hz, given its root mean square along each axis [m]; about 0.1 mm for an
    /// unsupported hand.
    #[must_use]
    pub fn with_tremor(mut self, rms: f64, seed: u64) -> Self {
        let mut rng = Purpose::Tremor.rng(seed);
        let [low, high] = TREMOR_BAND;
        let size = rms * libm::sqrt(2.0 / TREMOR_PARTS as f64);
        for axis in 0..3 {
            for part in 0..TREMOR_PARTS {
                // One frequency in each slice of the band: the sum has beats, and the given RMS value.
                let place = (part as f64 + 0.5 + 0.5 * rng.symmetric()) / TREMOR_PARTS as f64;
                let mut amplitude = Vector3::zeros();
                amplitude[axis] = size;
                let frequency = TAU * (low + (high - low) * place);
                self.tremor.push(Tremor { amplitude, frequency, phase: PI * rng.symmetric() });
            }
        }
        self
    }

    /// Returns the intended state of the hand at a time [s].
    pub fn at(&self, time: f64) -> OperatorHandState {
        let mut state = match &self.trajectory {
            Trajectory::Strokes(strokes) => self.in_strokes(strokes, time),
            Trajectory::Sine { amplitude, frequency, begin, end } => {
                let [displacement, speed] = sine(*frequency, time - begin, end - begin);
                self.moved(amplitude * displacement, amplitude * speed, Vector3::zeros(), Vector3::zeros())
            }
        };
        for Tremor { amplitude, frequency, phase } in &self.tremor {
            let angle = frequency * time + phase;
            state.pose.translation.vector += amplitude * libm::sin(angle);
            state.velocity += amplitude * (frequency * libm::cos(angle));
        }
        state
    }

    fn in_strokes(&self, strokes: &[Stroke], time: f64) -> OperatorHandState {
        let zero = Vector3::zeros();
        let (mut shift, mut velocity, mut turn, mut spin) = (zero, zero, zero, zero);
        for stroke in strokes.iter().take_while(|stroke| stroke.begin <= time) {
            let [fraction, rate, _] = minimum_jerk((time - stroke.begin) / stroke.duration);
            shift += stroke.shift * fraction;
            velocity += stroke.shift * (rate / stroke.duration);
            turn += stroke.turn * fraction;
            spin += stroke.turn * (rate / stroke.duration);
        }
        self.moved(shift, velocity, turn, spin)
    }

    /// Returns the state displaced from the start by a translation and a rotation vector, with their rates.
    fn moved(
        &self,
        shift: Vector3<f64>,
        velocity: Vector3<f64>,
        turn: Vector3<f64>,
        rate: Vector3<f64>,
    ) -> OperatorHandState {
        let rotation = UnitQuaternion::new(turn) * self.start.rotation;
        let pose = Isometry3::from_parts(Translation3::from(self.start.translation.vector + shift), rotation);
        OperatorHandState { pose, velocity, angular_velocity: angular_velocity(&turn, &rate) }
    }
}

/// Returns the angular velocity of a rotation vector that changes at a rate.
fn angular_velocity(turn: &Vector3<f64>, rate: &Vector3<f64>) -> Vector3<f64> {
    let angle = turn.norm();
    let (first, second) = if angle < 1e-4 {
        (0.5, 1.0 / 6.0)
    } else {
        let square = angle * angle;
        ((1.0 - libm::cos(angle)) / square, (angle - libm::sin(angle)) / (square * angle))
    };
    let across = turn.cross(rate);
    rate + across * first + turn.cross(&across) * second
}

/// Returns a sine of amplitude 1, with a rise and a fall of half a period each, and its rate.
fn sine(frequency: f64, time: f64, duration: f64) -> [f64; 2] {
    let ramp = 0.5 / frequency;
    let [up, up_rate, _] = minimum_jerk(time / ramp);
    let [down, down_rate, _] = minimum_jerk((duration - time) / ramp);
    let (size, rate) = (up * down, (up_rate * down - up * down_rate) / ramp);
    let (sine, cosine) = libm::sincos(TAU * frequency * time);
    [size * sine, rate * sine + size * TAU * frequency * cosine]
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;

    fn start() -> Isometry3<f64> {
        Isometry3::new(Vector3::new(0.36, 0.0, -0.3), Vector3::new(0.0, -1.5, 0.2))
    }

    /// Checks that velocities are the derivatives of the poses.
    fn check_velocities(motion: &OperatorHandMotion, duration: f64) {
        let step = 1e-5;
        for tick in 1..(duration * 50.0) as u32 {
            let time = f64::from(tick) * 0.02 + 0.0003;
            let (a, b, state) = (motion.at(time - step), motion.at(time + step), motion.at(time));
            let velocity = (b.pose.translation.vector - a.pose.translation.vector) / (2.0 * step);
            let spin = (b.pose.rotation * a.pose.rotation.inverse()).scaled_axis() / (2.0 * step);
            assert!((velocity - state.velocity).norm() < 1e-5, "{time}: {velocity} {state:?}");
            assert!((spin - state.angular_velocity).norm() < 1e-5, "{time}: {spin} {state:?}");
        }
    }

    #[test]
    fn the_papers_motion_goes_01_m_each_way_at_half_a_hertz_and_rests() {
        let motion = OperatorHandMotion::sine(start(), Vector3::new(0.1, 0.0, 0.0), 0.5, [1.0, 9.0]);
        let x = |time: f64| motion.at(time).pose.translation.x - 0.36;
        assert!(x(0.9).abs() < 1e-12 && x(9.1).abs() < 1e-12 && motion.at(9.5).velocity.norm() < 1e-12);
        // Peaks every second at the quarter and three quarters of the 2 s period.
        assert!((x(3.5) - 0.1).abs() < 1e-9 && (x(4.5) + 0.1).abs() < 1e-9 && (x(5.5) - 0.1).abs() < 1e-9);
        assert!((motion.at(5.0).velocity.x.abs() - 0.1 * PI).abs() < 1e-9);
        check_velocities(&motion, 10.0);
    }

    #[test]
    fn reaching_keeps_to_its_values() {
        let values = StrokeValues::default();
        let (mut reversed, mut all, mut paused) = (0, 0, 0);
        for seed in 0..20 {
            let motion = OperatorHandMotion::reaching(start(), &values, seed, 20.0);
            let Trajectory::Strokes(strokes) = &motion.trajectory else { panic!("strokes") };
            for pair in strokes.windows(2) {
                all += 1;
                reversed += i32::from((pair[0].shift + pair[1].shift).norm() < 1e-12);
                let pause = pair[1].begin - pair[0].begin - pair[0].duration;
                assert!(pause < 1e-9 || (0.2..=0.8).contains(&pause), "{pause}");
                paused += i32::from(pause > 1e-9);
            }
            for tick in 0..2000 {
                let state = motion.at(f64::from(tick) * 0.01);
                let off = state.pose.translation.vector - start().translation.vector;
                assert!(off.amax() <= 0.1 + 1e-9 && state.velocity.norm() <= 0.5 + 1e-9, "{state:?}");
            }
        }
        let fraction = |count: i32| f64::from(count) / f64::from(all);
        assert!(
            (fraction(reversed) - 0.3).abs() < 0.06 && (fraction(paused) - 0.3).abs() < 0.06,
            "{reversed} {paused} {all}"
        );
        check_velocities(&OperatorHandMotion::reaching(start(), &values, 1, 10.0), 10.0);
    }

    #[test]
    fn tremor_has_its_size_and_its_band() {
        let rest = OperatorHandMotion::strokes(start(), Vec::new());
        let motion = rest.with_tremor(1e-4, 7);
        let samples: Vec<f64> = (0..4000)
            .map(|n| motion.at(f64::from(n) * 0.005).pose.translation.y - start().translation.y)
            .collect();
        let total = samples.iter().map(|y| y * y).sum::<f64>();
        assert!(((total / 4000.0).sqrt() / 1e-4 - 1.0).abs() < 0.05, "{}", (total / 4000.0).sqrt());
        // A discrete Fourier transform over 20 s: lines every 0.05 Hz.
        let power = |line: usize| {
            let (mut re, mut im) = (0.0, 0.0);
            for (n, y) in samples.iter().enumerate() {
                let window = 1.0 - libm::cos(TAU * n as f64 / 4000.0);
                let (s, c) = libm::sincos(TAU * (line * n) as f64 / 4000.0);
                (re, im) = (re + window * y * c, im + window * y * s);
            }
            re * re + im * im
        };
        let (inside, outside) = (1..600).fold((0.0, 0.0), |(inside, outside), line| {
            let frequency = line as f64 * 0.05;
            let p = power(line);
            if (7.9..=12.1).contains(&frequency) { (inside + p, outside) } else { (inside, outside + p) }
        });
        assert!(outside < 1e-3 * inside, "{outside:e} {inside:e}");
        check_velocities(&motion, 1.0);
    }
}
