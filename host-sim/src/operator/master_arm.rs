//! The master arm: six joints that follow the operator's hand, measure its pose, and reflect forces.

use core::f64::consts::{FRAC_PI_2, TAU};

use rapier3d::na::{Isometry3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};
use tesaki_rng::Rng;

use super::{OperatorHandMotion, OperatorHandState, Sampling};
use crate::purpose::Purpose;

/// Longest integration step of the operator's arm [s].
const STEP: f64 = 5e-4;

/// Impedance of the operator's arm with the handle: mass, damper and spring between the intended and the
/// actual motion. Measured on people: 1–2 kg, 10–20 N·s/m, 200–500 N/m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Impedance {
    /// Mass [kg].
    pub mass: f64,
    /// Damping [N·s/m].
    pub damping: f64,
    /// Stiffness [N/m].
    pub stiffness: f64,
}

impl Impedance {
    /// Advances the deviation and its rate by a step under a force, with the implicit midpoint rule.
    fn advance(
        &self,
        deviation: &mut Vector3<f64>,
        rate: &mut Vector3<f64>,
        force: &Vector3<f64>,
        step: f64,
    ) {
        let Self { mass, damping, stiffness } = *self;
        let inertia = mass + step / 2.0 * (damping + step / 2.0 * stiffness);
        let before = *rate;
        let pull = force - before * damping - (*deviation + before * (step / 2.0)) * stiffness;
        *rate += pull * (step / inertia);
        *deviation += (before + *rate) * (step / 2.0);
    }
}

/// A master arm: a shoulder with two joints, an elbow, and a wrist with three joints whose axes intersect.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MasterArmValues {
    /// Lengths from shoulder to elbow and from elbow to wrist [m].
    pub links: [f64; 2],
    /// Length from wrist to handle [m].
    pub handle: f64,
    /// Position of the shoulder relative to the handle at the centre of its range [m].
    pub shoulder: [f64; 3],
    /// Encoder counts per revolution of a joint.
    pub counts_per_turn: f64,
    /// Standard deviation of a joint's reading before rounding [rad].
    pub noise: f64,
    /// Largest constant error of a joint [rad].
    pub zero_error: f64,
    /// Sampling rate [Hz].
    pub rate: f64,
    /// The operator's arm with the handle.
    pub impedance: Impedance,
    /// The operator's hand with the handle, about each axis [kg·m², N·m·s/rad, N·m/rad].
    pub rotation: Impedance,
    /// Largest reflected force of the motors [N].
    pub force_limit: f64,
    /// Largest reflected torque [N·m].
    pub torque_limit: f64,
}

impl Default for MasterArmValues {
    /// A light arm on a table to the right of the operator. Its rate of 240 Hz is not a multiple of a slave's
    /// rate.
    fn default() -> Self {
        Self {
            links: [0.32, 0.32],
            handle: 0.06,
            shoulder: [0.0, -0.42, -0.12],
            counts_per_turn: 65_536.0,
            noise: 2e-5,
            zero_error: 3e-4,
            rate: 240.0,
            impedance: Impedance { mass: 1.5, damping: 15.0, stiffness: 300.0 },
            rotation: Impedance { mass: 0.004, damping: 0.1, stiffness: 3.0 },
            force_limit: 30.0,
            torque_limit: 3.0,
        }
    }
}

/// Measured pose of the handle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MasterPose {
    /// Position [m].
    pub position: [f64; 3],
    /// Unit quaternion `[x, y, z, w]`.
    pub orientation: [f64; 4],
}

/// A master arm with the operator's arm at its handle.
///
/// In free motion the handle follows the intended motion of the hand exactly. A reflected force or torque
/// makes it deviate according to the operator's [`Impedance`].
#[derive(Clone, Debug)]
pub struct MasterArm {
    values: MasterArmValues,
    kinematics: Kinematics,
    zero_errors: [f64; 6],
    sampling: Sampling,
    rng: Rng,
    time: f64,
    /// Deviation from the intended motion [m], [m/s].
    deviation: Vector3<f64>,
    deviation_rate: Vector3<f64>,
    force: Vector3<f64>,
    /// Deviation of the orientation, a rotation vector in the axes of the base [rad], and its rate [rad/s].
    turn: Vector3<f64>,
    turn_rate: Vector3<f64>,
    torque: Vector3<f64>,
}

impl MasterArm {
    /// Creates an arm whose handle is at `middle` at the centre of its range, with a seeded sampling phase.
    pub fn new(values: MasterArmValues, middle: &Isometry3<f64>, seed: u64) -> Self {
        let mut rng = Purpose::MasterArm.rng(seed);
        let sampling = Sampling::new(values.rate, 0.5 + 0.5 * rng.symmetric());
        let zero_errors = [(); 6].map(|()| values.zero_error * rng.symmetric());
        let kinematics = Kinematics::new(&values, middle);
        let zero = Vector3::zeros();
        Self {
            values,
            kinematics,
            zero_errors,
            sampling,
            rng,
            time: 0.0,
            deviation: zero,
            deviation_rate: zero,
            force: zero,
            turn: zero,
            turn_rate: zero,
            torque: zero,
        }
    }

    /// Sets the reflected force [N]; its magnitude saturates at [`MasterArmValues::force_limit`]. Returns the
    /// saturated force.
    pub fn reflect(&mut self, force: [f64; 3]) -> [f64; 3] {
        self.force = Vector3::from(force).cap_magnitude(self.values.force_limit);
        self.force.into()
    }

    /// Sets the reflected torque [N·m], saturated like the force in [`Self::reflect`].
    pub fn reflect_torque(&mut self, torque: [f64; 3]) -> [f64; 3] {
        self.torque = Vector3::from(torque).cap_magnitude(self.values.torque_limit);
        self.torque.into()
    }

    /// Returns the true state of the handle while the operator intends `motion`.
    pub fn handle(&self, motion: &OperatorHandMotion) -> OperatorHandState {
        let mut state = motion.at(self.time);
        state.pose.translation.vector += self.deviation;
        state.velocity += self.deviation_rate;
        if self.turn != Vector3::zeros() {
            state.pose.rotation = UnitQuaternion::from_scaled_axis(self.turn) * state.pose.rotation;
        }
        state.angular_velocity += self.turn_rate;
        state
    }

    /// Advances to a time [s] and returns time [s] and pose of each sample. A pose out of reach is measured
    /// at the limit of the reach.
    pub fn run(&mut self, motion: &OperatorHandMotion, until: f64) -> Vec<(f64, MasterPose)> {
        let mut samples = Vec::new();
        while let Some(time) = self.sampling.next(until) {
            self.advance(time);
            let angles = self.kinematics.inverse(&self.handle(motion).pose);
            samples.push((time, self.measure(&angles)));
        }
        self.advance(until);
        samples
    }

    /// Integrates the operator's impedances under the reflected force and torque.
    fn advance(&mut self, until: f64) {
        let MasterArmValues { impedance, rotation, .. } = self.values;
        while self.time < until {
            let step = STEP.min(until - self.time);
            impedance.advance(&mut self.deviation, &mut self.deviation_rate, &self.force, step);
            rotation.advance(&mut self.turn, &mut self.turn_rate, &self.torque, step);
            // The last step ends exactly at `until`.
            self.time = if step < STEP { until } else { self.time + step };
        }
    }

    fn measure(&mut self, angles: &[f64; 6]) -> MasterPose {
        let count = TAU / self.values.counts_per_turn;
        let mut read = *angles;
        for (angle, zero) in read.iter_mut().zip(self.zero_errors) {
            let noisy = *angle + zero + self.values.noise * self.rng.normal();
            *angle = libm::round(noisy / count) * count;
        }
        let pose = self.kinematics.forward(&read);
        MasterPose { position: pose.translation.vector.into(), orientation: pose.rotation.coords.into() }
    }
}

/// Joint axes: z, y, y, then x, y and z. At zero angles the arm points along x of its base, which points from
/// the shoulder towards the operator's hand.
#[derive(Clone, Debug)]
struct Kinematics {
    base: Isometry3<f64>,
    links: [f64; 2],
    /// Pose of the handle in the frame of the last joint.
    handle: Isometry3<f64>,
}

impl Kinematics {
    /// Sets up the kinematics so that the wrist's angles are 0 with the handle at `middle`.
    fn new(values: &MasterArmValues, middle: &Isometry3<f64>) -> Self {
        let shoulder = Vector3::from(values.shoulder);
        let yaw = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), libm::atan2(-shoulder.y, -shoulder.x));
        let base = Isometry3::from_parts(Translation3::from(middle.translation.vector + shoulder), yaw);
        let mut arm = Self { base, links: values.links, handle: Isometry3::identity() };
        let wrist = base.inverse_transform_point(&Point3::from(middle.translation.vector)).coords;
        let reach = wrist - wrist.normalize() * values.handle;
        let forearm = base.rotation * arm.forearm_rotation(&arm.angles_of_wrist(&reach));
        let hand = middle.translation.vector - base.transform_point(&Point3::from(reach)).coords;
        let position = Translation3::from(forearm.inverse() * hand);
        arm.handle = Isometry3::from_parts(position, forearm.inverse() * middle.rotation);
        arm
    }

    fn forearm_rotation(&self, [yaw, lift, bend]: &[f64; 3]) -> UnitQuaternion<f64> {
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), *yaw)
            * UnitQuaternion::from_axis_angle(&Vector3::y_axis(), lift + bend)
    }

    /// Computes the first three joint angles from the position of the wrist in the frame of the base. Out of
    /// reach, the nearest reachable position counts.
    fn angles_of_wrist(&self, wrist: &Vector3<f64>) -> [f64; 3] {
        let [upper, fore] = self.links;
        let out = libm::hypot(wrist.x, wrist.y);
        let far = libm::hypot(out, wrist.z).clamp((upper - fore).abs() + 1e-9, upper + fore);
        let cosine = |a: f64, b: f64, c: f64| ((a * a + b * b - c * c) / (2.0 * a * b)).clamp(-1.0, 1.0);
        let bend = core::f64::consts::PI - libm::acos(cosine(upper, fore, far));
        let lift = -libm::atan2(wrist.z, out) - libm::acos(cosine(upper, far, fore));
        [libm::atan2(wrist.y, wrist.x), lift, bend]
    }

    fn forward(&self, angles: &[f64; 6]) -> Isometry3<f64> {
        let [yaw, lift, bend, x, y, z] = *angles;
        let [upper, fore] = self.links;
        let about = |axis, angle| UnitQuaternion::from_axis_angle(&axis, angle);
        let shoulder = about(Vector3::z_axis(), yaw) * about(Vector3::y_axis(), lift);
        let forearm = shoulder * about(Vector3::y_axis(), bend);
        let wrist = shoulder * Vector3::new(upper, 0.0, 0.0) + forearm * Vector3::new(fore, 0.0, 0.0);
        let turn = about(Vector3::x_axis(), x) * about(Vector3::y_axis(), y) * about(Vector3::z_axis(), z);
        self.base * Isometry3::from_parts(Translation3::from(wrist), forearm * turn) * self.handle
    }

    fn inverse(&self, handle: &Isometry3<f64>) -> [f64; 6] {
        let last = self.base.inverse() * handle * self.handle.inverse();
        let arm = self.angles_of_wrist(&last.translation.vector);
        let turn = Rotation3::from(self.forearm_rotation(&arm).inverse() * last.rotation);
        let y = libm::asin(turn[(0, 2)].clamp(-1.0, 1.0)).clamp(-FRAC_PI_2, FRAC_PI_2);
        let (x, z) = (libm::atan2(-turn[(1, 2)], turn[(2, 2)]), libm::atan2(-turn[(0, 1)], turn[(0, 0)]));
        let [yaw, lift, bend] = arm;
        [yaw, lift, bend, x, y, z]
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, reason = "tests")]
mod tests {
    use super::*;
    use crate::operator::StrokeValues;
    use crate::plant::isometry;

    fn middle() -> Isometry3<f64> {
        Isometry3::new(Vector3::new(0.36, 0.0, -0.3), Vector3::new(0.0, -FRAC_PI_2, 0.0))
    }

    fn pose(sample: &MasterPose) -> Isometry3<f64> {
        isometry(sample.position, sample.orientation)
    }

    /// Errors of position [m] and orientation [rad].
    type Error = (Vector3<f64>, Vector3<f64>);

    /// Returns the measurement errors of a run of 20 s.
    fn errors(values: MasterArmValues, seed: u64) -> Vec<Error> {
        let motion = OperatorHandMotion::reaching(middle(), &StrokeValues::default(), seed, 20.0);
        let samples = MasterArm::new(values, &middle(), seed).run(&motion, 20.0);
        assert!((4799..=4801).contains(&samples.len()), "{}", samples.len());
        let error = |(time, sample): &(f64, MasterPose)| {
            let (truth, got) = (motion.at(*time).pose, pose(sample));
            let turn = (got.rotation * truth.rotation.inverse()).scaled_axis();
            (got.translation.vector - truth.translation.vector, turn)
        };
        samples.iter().map(error).collect()
    }

    #[test]
    fn without_errors_the_arm_measures_the_truth() {
        let values = MasterArmValues {
            counts_per_turn: 1e13,
            noise: 0.0,
            zero_error: 0.0,
            ..MasterArmValues::default()
        };
        let arm = Kinematics::new(&values, &middle());
        let neutral = arm.inverse(&middle());
        assert!(neutral[3..].iter().all(|angle| angle.abs() < 1e-9), "{neutral:?}");
        for (position, turn) in errors(values, 2) {
            assert!(position.norm() < 1e-9 && turn.norm() < 1e-9, "{position} {turn}");
        }
    }

    /// Quantisation and noise of a joint: 34 µrad; with lever arms of up to 0.6 m, and six axes.
    #[test]
    fn quantisation_noise_and_zero_errors_have_their_sizes() {
        let deviation = (2e-5_f64.powi(2) + (TAU / 65_536.0).powi(2) / 12.0).sqrt();
        let values = MasterArmValues { zero_error: 0.0, ..MasterArmValues::default() };
        let found = errors(values, 5);
        let rms =
            |of: &dyn Fn(&Error) -> f64| (found.iter().map(of).sum::<f64>() / found.len() as f64).sqrt();
        let turn = rms(&|(_, turn)| turn.norm_squared());
        // The errors about six unit axes add up; at the handle the first three have lever arms of 0.26 to
        // 0.45 m.
        assert!((turn / (deviation * 6_f64.sqrt()) - 1.0).abs() < 0.1, "{turn:e} {deviation:e}");
        let position = rms(&|(position, _)| position.norm_squared());
        assert!(position > 0.35 * deviation && position < 0.45 * 3_f64.sqrt() * deviation, "{position:e}");
        let constant = errors(MasterArmValues { noise: 0.0, counts_per_turn: 1e13, ..values }, 5);
        assert!(constant.iter().all(|(position, _)| position.norm() < 1e-9));
        let off =
            errors(MasterArmValues { noise: 0.0, counts_per_turn: 1e13, ..MasterArmValues::default() }, 5);
        let largest = off.iter().fold(0.0_f64, |largest, (position, _)| largest.max(position.norm()));
        assert!(largest > 2e-5 && largest < 3.0 * 0.5 * 3e-4, "{largest:e}");
    }

    #[test]
    fn samples_are_not_locked_to_the_slaves_ticks() {
        let motion = OperatorHandMotion::strokes(middle(), Vec::new());
        let mut arm = MasterArm::new(MasterArmValues::default(), &middle(), 1);
        let mut counts = [0; 5];
        let mut times = Vec::new();
        for tick in 0..1000 {
            let samples = arm.run(&motion, f64::from(tick) * 0.01);
            counts[samples.len()] += 1;
            times.extend(samples.iter().map(|(time, _)| *time));
        }
        // 240 Hz: 2.4 samples per tick.
        assert!(counts[2] > 550 && counts[3] > 350 && counts[1] + counts[4] == 0, "{counts:?}");
        assert!(times.windows(2).all(|two| (two[1] - two[0] - 1.0 / 240.0).abs() < 1e-9));
        let phase =
            |seed| MasterArm::new(MasterArmValues::default(), &middle(), seed).run(&motion, 0.02)[0].0;
        assert!((phase(1) - phase(2)).abs() > 1e-5);
    }

    /// A step of force on mass, damper and spring, compared with the textbook's overshoot, period and final
    /// value.
    #[test]
    fn the_handle_deviates_as_the_operators_impedance_says() {
        let motion = OperatorHandMotion::strokes(middle(), Vec::new());
        let mut arm = MasterArm::new(MasterArmValues::default(), &middle(), 1);
        assert!((arm.reflect([0.0, 6.0, 0.0])[1] - 6.0).abs() < 1e-12, "not cut");
        let (mut peak, mut when) = (0.0, 0.0);
        for step in 1..5000 {
            let time = f64::from(step) * 0.001;
            arm.run(&motion, time);
            let deviation = arm.handle(&motion).pose.translation.y;
            if deviation > peak {
                (peak, when) = (deviation, time);
            }
        }
        let (rest, omega) = (6.0 / 300.0, (300.0_f64 / 1.5).sqrt());
        let zeta = 15.0 / (2.0 * 1.5 * omega);
        let damped = omega * (1.0 - zeta * zeta).sqrt();
        let overshoot = (-core::f64::consts::PI * zeta * omega / damped).exp();
        assert!((peak / rest - 1.0 - overshoot).abs() < 1e-3, "{peak} {overshoot}");
        assert!((when - core::f64::consts::PI / damped).abs() < 2e-3, "{when}");
        assert!((arm.handle(&motion).pose.translation.y - rest).abs() < 1e-6);
        let cut = Vector3::from(arm.reflect([0.0, 0.0, -50.0]));
        assert!((cut.z + 30.0).abs() < 1e-12);
    }
}
