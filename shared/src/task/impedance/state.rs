mod redundancy;
mod stop;

use nalgebra::{IsometryMatrix3, Vector3, Vector6};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::contact::{joint_inertia, own_mass};
use super::derating::Derating;
use super::external_torque::ExternalTorqueEstimate;
use super::redundancy::{JointVector, Resolver};
use super::response::{in_axes, respond};
use super::setpoint::{
    ORIGIN, at_rest, check_deviation, check_elbow, check_numbers, check_point, pose_error, wrap_angle,
};
use super::settings::{ForceSource, ImpedanceSettings, Law, Redundancy};
use super::tuning::{
    CONTACT_DISTURBANCE_GAIN, CONTACT_FRICTION_COMPENSATION, CONTACT_HYSTERESIS_SQUARED,
    CONTACT_LOSS_SQUARED, CONTACT_REST_SPEED, FREE_BEFORE_READING, IMPEDANCE_BLEND, LIMIT_APPROACH_RATE,
    MAX_ELBOW_DISTANCE, MAX_TOOL_DISTURBANCE, MISMATCH_TICKS, PRESSING_REST_SPEED, REST_ERROR, REST_SPEED,
    SETPOINT_REST_SPEED, VELOCITY_LIMIT_FRACTION,
};
use super::{Arm, ArmMeasurement, ArmOutput, ImpedanceRefusal, SetpointError};
use crate::TICK;
use crate::control::{Impedance, JointPoint, ObserverState};
use crate::kinematics::{COAST_TIME, ElbowSetpoint, Jacobian, PosePoint};
use crate::math::{self, abs};
use crate::model::MAX_CHAIN_JOINTS;
use redundancy::driven_joint;
use stop::Release;

pub(super) use stop::Takeover;

/// State of the impedance control.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, Schema)]
pub struct ImpedanceState {
    settings: ImpedanceSettings,
    /// Impedance in effect, blended towards that of the settings.
    impedance: Impedance,
    setpoint: PosePoint,
    elbow_setpoint: ElbowSetpoint,
    /// Whether the arm angle is undefined in this posture. The elbow then has no set-point.
    arm_angle_undefined: bool,
    /// Joint angles and velocities of the reference arm at the next tick.
    angles: [f32; MAX_CHAIN_JOINTS],
    velocities: [f32; MAX_CHAIN_JOINTS],
    observers: [ObserverState; MAX_CHAIN_JOINTS],
    /// The disturbances that they estimated one and two ticks ago.
    earlier_disturbances: [[f32; MAX_CHAIN_JOINTS]; 2],
    /// Whether a stop has begun.
    halted: bool,
    release: Release,
    pub(super) contact: bool,
    /// Squared external force of the last tick [N²].
    squared_force: f32,
    pub(super) derating: Derating,
    /// Linear velocity [m/s] and acceleration [m/s²] of the tool.
    tool_velocity: [f32; 3],
    tool_acceleration: [f32; 3],
    /// Smallest singular value of the Jacobian, and its left singular vector.
    left_singular_vector: [f32; 6],
    pub(super) sigma_min: f32,
    /// For telemetry.
    pub(super) pose_error: [f32; 6],
    /// Force estimate without a sensor: its torques and its last wrench. The name of the field is part of the
    /// key of the state.
    momentum_observer: ExternalTorqueEstimate,
    estimated_wrench: [f32; 6],
    /// Squared acceleration of the tool that the disturbance observers compensate [m²/s⁴].
    tool_disturbance: f32,
    /// Consecutive ticks in which that was beyond its limit.
    mismatch_ticks: u8,
}

impl ImpedanceState {
    /// Before the first [`Self::begin`].
    pub const NONE: Self = Self {
        settings: ImpedanceSettings::NONE,
        impedance: ImpedanceSettings::NONE.impedance,
        setpoint: ORIGIN,
        elbow_setpoint: ElbowSetpoint { angle: 0.0, velocity: 0.0, acceleration: 0.0 },
        arm_angle_undefined: false,
        angles: [0.0; MAX_CHAIN_JOINTS],
        velocities: [0.0; MAX_CHAIN_JOINTS],
        observers: [ObserverState::new(); MAX_CHAIN_JOINTS],
        earlier_disturbances: [[0.0; MAX_CHAIN_JOINTS]; 2],
        halted: false,
        release: Release::NotNeeded,
        contact: false,
        squared_force: 0.0,
        derating: Derating::NONE,
        tool_velocity: [0.0; 3],
        tool_acceleration: [0.0; 3],
        left_singular_vector: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        sigma_min: 0.0,
        pose_error: [0.0; 6],
        momentum_observer: ExternalTorqueEstimate::NONE,
        estimated_wrench: [0.0; 6],
        tool_disturbance: 0.0,
        mismatch_ticks: 0,
    };

    /// Changes the settings. The impedance is blended in within a second.
    ///
    /// # Errors
    /// The first invalid setting, or a deviation of the tool that exceeds the new maximum; the state is
    /// unchanged then.
    pub fn configure(&mut self, arm: &Arm<'_>, settings: &ImpedanceSettings) -> Result<(), ImpedanceRefusal> {
        settings.validate(arm.chain.len()).map_err(ImpedanceRefusal::Settings)?;
        check_deviation(&self.pose_error.into(), settings).map_err(ImpedanceRefusal::Setpoint)?;
        let [old, new] = [&self.settings.impedance, &settings.impedance];
        // An accepted mass stays valid: near a singular posture the arm's own mass grows without bound.
        if (old.axes, old.free_mass()) != (new.axes, new.free_mass()) {
            let own_mass = own_mass(arm.chain, arm.joints, &self.angles, new.axes);
            settings.check_mass(&own_mass).map_err(ImpedanceRefusal::Settings)?;
        }
        let before = core::mem::replace(&mut self.settings, *settings);
        if before.law != settings.law {
            // The direct law estimates no disturbance, so an earlier estimate is out of date.
            self.forget_disturbances();
        }
        if before.redundancy != settings.redundancy {
            let posture = arm.chain.posture(&self.angles);
            self.hold_elbow(arm, &posture);
            self.initialize_singular_value(&posture);
        }
        if self.impedance.axes != settings.impedance.axes {
            let posture = arm.chain.posture(&self.angles);
            self.impedance = in_axes(&self.impedance, settings.impedance.axes, posture.tip());
        }
        Ok(())
    }

    /// Begins at rest with valid settings. The set-point is the pose at these joint angles [rad].
    pub fn begin(&mut self, arm: &Arm<'_>, settings: &ImpedanceSettings, angles: &[f32; MAX_CHAIN_JOINTS]) {
        self.clone_from(&Self::NONE);
        (self.settings, self.impedance, self.angles) = (*settings, settings.impedance, *angles);
        let posture = arm.chain.posture(angles);
        self.setpoint = at_rest(posture.tip());
        self.hold_elbow(arm, &posture);
        self.initialize_singular_value(&posture);
    }

    /// Sets the set-points of tool and elbow.
    ///
    /// # Errors
    /// Why they are invalid; the old set-points remain.
    pub fn set_target(
        &mut self,
        arm: &Arm<'_>,
        point: &PosePoint,
        elbow: &ElbowSetpoint,
    ) -> Result<(), SetpointError> {
        check_numbers(point, elbow)?;
        let posture = arm.chain.posture(&self.angles);
        // Both now and where it coasts to without a successor: this bounds velocity and acceleration, too.
        let rest = point.coasted_to_rest();
        let [_, max_angle] = self.settings.max_deviation;
        for point in [point, &rest] {
            check_point(posture.tip(), point, &self.settings)?;
        }
        // A turn by more than half a revolution ends where a smaller one does.
        let [.., x, y, z] = rest.velocity;
        let value = COAST_TIME * math::sqrt(x * x + y * y + z * z);
        if value > max_angle {
            return Err(SetpointError::Rotation { value, limit: max_angle });
        }
        if let Some(angle) = self.elbow_angle(arm, &posture, &self.angles) {
            let distance = elbow.angle - angle;
            // The arm angle has no end: the shorter rotation counts.
            let wraps =
                self.settings.redundancy == Redundancy::ArmAngle && abs(distance) <= MAX_ELBOW_DISTANCE;
            check_elbow(elbow, if wraps { wrap_angle(distance) } else { distance }, max_angle)?;
        }
        (self.setpoint, self.elbow_setpoint) = (*point, *elbow);
        Ok(())
    }

    /// Checks the pose error of the last tick.
    ///
    /// # Errors
    /// The tool is too far from its set-point.
    pub fn check_deviation(&self) -> Result<(), SetpointError> {
        check_deviation(&self.pose_error.into(), &self.settings)
    }

    /// Checks that the force sensor measures the forces on the tool. A contact that it does not measure
    /// appears as a disturbance `d`, `J·d` at the tool; the tracking would press against it.
    ///
    /// # Errors
    /// For `MISMATCH_TICKS` the tracking compensated more than `MAX_TOOL_DISTURBANCE`: disturbance and limit
    /// [m/s²].
    pub fn check_disturbance(&mut self) -> Result<(), (f32, f32)> {
        let is_mismatch = self.tool_disturbance > MAX_TOOL_DISTURBANCE * MAX_TOOL_DISTURBANCE;
        self.mismatch_ticks = if is_mismatch { self.mismatch_ticks.saturating_add(1) } else { 0 };
        if self.mismatch_ticks < MISMATCH_TICKS {
            return Ok(());
        }
        Err((math::sqrt(self.tool_disturbance), MAX_TOOL_DISTURBANCE))
    }

    /// Squared linear acceleration of the tool that the disturbance observers compensate [m²/s⁴]; 0 without a
    /// force sensor that should measure its cause, and in a stop, which may begin with any motion.
    fn squared_tool_disturbance(&self, settings: &ImpedanceSettings, jacobian: &Jacobian) -> f32 {
        if settings.law.direct().is_some() || self.estimates_force() || self.halted {
            return 0.0;
        }
        (jacobian.fixed_rows::<3>(0) * JointVector::from(self.disturbances())).norm_squared()
    }

    /// Estimated disturbances of the joints [rad/s²].
    pub(super) fn disturbances(&self) -> [f32; MAX_CHAIN_JOINTS] {
        self.observers.map(|observer| observer.disturbance())
    }

    /// Linear acceleration of the tool over the last period [m/s²]. The force sensor measures the inertial
    /// force of the tool's own mass under it.
    pub fn acceleration(&self) -> Vector3<f32> {
        self.tool_acceleration.into()
    }

    /// Runs one control period.
    ///
    /// # Errors
    /// Why the control must stop.
    pub fn tick(&mut self, arm: &Arm<'_>, measurement: &ArmMeasurement) -> Result<ArmOutput, SetpointError> {
        let settings = self.settings;
        self.impedance.blend_towards(&settings.impedance, IMPEDANCE_BLEND);
        let wrench = self.external_wrench(measurement);
        if !wrench.iter().all(|value| value.is_finite()) {
            return Err(SetpointError::NotFinite);
        }
        let force_before = self.squared_force;
        let use_measured_state = self.update_contact(arm, &settings, &wrench);
        self.derating.update(math::sqrt(self.squared_force), self.contact, settings.contact_force);
        self.update_reference(arm, &settings, measurement, use_measured_state);

        let posture = arm.chain.posture(&self.angles);
        let jacobian = posture.jacobian();
        self.tool_disturbance = self.squared_tool_disturbance(&settings, &jacobian);
        let mut left_singular_vector = self.left_singular_vector.into();
        let resolver = Resolver::new(
            &jacobian,
            driven_joint(settings.redundancy),
            &mut left_singular_vector,
            &mut self.sigma_min,
        );
        self.left_singular_vector = left_singular_vector.into();
        self.update_force_estimate(arm, &settings, measurement, &resolver);

        let error = pose_error(posture.tip(), &self.setpoint);
        self.pose_error = error.into();
        if self.release == Release::Moving {
            self.release(&error);
        }
        let wrench = self.external_wrench(measurement);
        let loaded = self.contact || settings.law.direct().is_some();
        let force = if loaded { wrench } else { Vector6::zeros() };
        let velocities = JointVector::from(self.velocities);
        let velocity = jacobian * velocities;
        let last = self.tool_velocity.into();
        self.derating.check_rebound(self.contact, &last, &velocity.fixed_rows::<3>(0).into_owned());
        let felt = if self.estimates_force() { beyond_contact_force(&settings, &force) } else { force };
        let mut acceleration = self.tool_command(&settings, posture.tip(), &error, &velocity, &felt);
        let is_lost = self.squared_force <= CONTACT_LOSS_SQUARED * force_before;
        let rested = velocities.amax() < CONTACT_REST_SPEED;
        if use_measured_state && !loaded && is_lost && rested && !self.estimates_force() {
            // The tool was released at rest some time before the reading: adds the velocity that it gained in
            // that time.
            acceleration *= 1.0 + FREE_BEFORE_READING / TICK;
        }
        let bias = posture.bias_acceleration(velocities.as_slice());
        let desired = self.resolve(arm, &settings, &posture, &resolver, &jacobian, &(acceleration - bias));
        let mut accelerations = desired;
        self.limit_accelerations(arm, &mut accelerations);
        let lost = desired - accelerations;
        if lost.amax() > 0.0 {
            acceleration -= jacobian * lost;
        }
        self.update_tool_motion(&velocity, &acceleration, loaded);
        let output = self.output(arm, &settings, jacobian.tr_mul(&-force).into(), &accelerations);
        self.advance(&accelerations);
        Ok(output)
    }

    /// Closes the tick: mean motor torques until the next tick [N·m], and accelerations that the limits added
    /// to those of the joints [rad/s²].
    pub fn applied(
        &mut self,
        arm: &Arm<'_>,
        torques: &[f32; MAX_CHAIN_JOINTS],
        added: &[f32; MAX_CHAIN_JOINTS],
    ) {
        self.momentum_observer.push(torques);
        for (state, added) in self.observers.iter_mut().zip(added) {
            let feedback = arm.observer.feedback(state);
            arm.observer.predict(state, feedback + added);
        }
    }

    /// Whether `settings` have another force source. It must not change while the arm is enabled.
    pub fn changes_source(&self, settings: &ImpedanceSettings) -> bool {
        let source = |settings: &ImpedanceSettings| core::mem::discriminant(&settings.force);
        source(&self.settings) != source(settings)
    }

    /// Tares the force estimate.
    pub const fn tare_estimate(&mut self) {
        self.momentum_observer.tare();
    }

    /// Whether the force is estimated from the motor torques.
    pub const fn estimates_force(&self) -> bool {
        matches!(self.settings.force, ForceSource::Observer { .. })
    }

    /// External wrench on the tool [N, N·m].
    pub(super) fn external_wrench(&self, measurement: &ArmMeasurement) -> Vector6<f32> {
        if self.estimates_force() { self.estimated_wrench.into() } else { measurement.wrench.into() }
    }

    /// Detects contact, with hysteresis; its begin revises the disturbance estimates. Returns whether the
    /// reference arm takes the measured state: during contact, and once more when it ends.
    fn update_contact(&mut self, arm: &Arm<'_>, settings: &ImpedanceSettings, wrench: &Vector6<f32>) -> bool {
        let force = wrench.fixed_rows::<3>(0).norm_squared();
        let before = core::mem::replace(&mut self.squared_force, force);
        let limit = settings.contact_force * settings.contact_force;
        let contact = match (self.release, self.contact) {
            (Release::Moving, _) => true,
            (Release::Done, _) => false,
            (Release::NotNeeded, true) => {
                force > CONTACT_HYSTERESIS_SQUARED * limit && force > CONTACT_LOSS_SQUARED * before
            }
            (Release::NotNeeded, false) => force > limit,
        };
        let was_contact = core::mem::replace(&mut self.contact, contact);
        if contact && !was_contact {
            if self.estimates_force() {
                self.hand_over_load(arm, wrench);
            } else {
                self.forget_impact();
            }
        }
        was_contact || contact
    }

    /// Begins anew with disturbances of 0.
    pub(super) const fn forget_disturbances(&mut self) {
        self.observers = Self::NONE.observers;
        self.earlier_disturbances = Self::NONE.earlier_disturbances;
    }

    /// Restores the disturbances that were estimated before an impact. The angles show it one or two ticks
    /// before the force, which is averaged over a shorter time or filtered. What the observers have learnt
    /// since then is the impact, and the arm would press with it.
    #[inline(never)]
    fn forget_impact(&mut self) {
        let [_, before] = self.earlier_disturbances;
        for (observer, before) in self.observers.iter_mut().zip(before) {
            observer.hand_over(observer.disturbance() - before);
        }
    }

    /// Begin of a contact whose `wrench` [N, N·m] is estimated: until now the disturbance observers carried
    /// it, and from now on the torques that balance it do. Carried twice, it would drive the tool against the
    /// person who pulls it. When the contact ends, the observers learn what is left of it: the estimate lags,
    /// and after a sudden end nothing is.
    #[inline(never)]
    fn hand_over_load(&mut self, arm: &Arm<'_>, wrench: &Vector6<f32>) {
        let torques = arm.chain.posture(&self.angles).jacobian().tr_mul(wrench);
        let accelerations = joint_inertia(arm.chain, arm.joints, &self.angles).solve(&torques);
        for (observer, acceleration) in self.observers.iter_mut().zip(accelerations.iter()) {
            // In a stop they do not learn, and the feedback of the error carries it; but in an impact that is
            // what brakes the arm.
            let disturbance = observer.disturbance();
            let carried = if self.halted { arm.observer.feedback(observer) } else { disturbance };
            observer.hand_over(disturbance - (carried + acceleration));
        }
    }

    /// Updates the disturbance observers with the tracking error of the reference arm. With
    /// `use_measured_state` the reference arm takes the measured state.
    fn update_reference(
        &mut self,
        arm: &Arm<'_>,
        settings: &ImpedanceSettings,
        measurement: &ArmMeasurement,
        use_measured_state: bool,
    ) {
        if settings.law.direct().is_some() {
            (self.angles, self.velocities) = (measurement.angles, measurement.velocities);
            return;
        }
        let [last, _] = self.earlier_disturbances;
        self.earlier_disturbances = [self.disturbances(), last];
        let senses_contact = use_measured_state && !self.estimates_force();
        let rest_speed = match (senses_contact, self.setpoints_rest()) {
            (true, true) => PRESSING_REST_SPEED,
            (true, false) => CONTACT_REST_SPEED,
            (false, _) => REST_SPEED,
        };
        let reference = self.angles.iter_mut().zip(&mut self.velocities);
        let joints = reference.zip(self.observers.iter_mut().zip(&measurement.angles));
        for ((angle, velocity), (observer, measured)) in joints.take(arm.chain.len()) {
            let error = *angle - measured;
            // In a stop the observer must not learn the force that holds the arm: the arm would press with
            // it.
            let at_rest = abs(*velocity) < rest_speed && (self.halted || abs(error) < REST_ERROR);
            let gain = match (at_rest, use_measured_state) {
                (true, _) => 0.0,
                (false, true) => CONTACT_DISTURBANCE_GAIN,
                (false, false) => 1.0,
            };
            arm.observer.correct(observer, error, gain);
            if use_measured_state {
                let [error, rate] = observer.error();
                *angle -= error;
                *velocity -= rate;
                observer.reset_motion();
            }
        }
    }

    /// Whether the set-points of tool and elbow are at rest.
    fn setpoints_rest(&self) -> bool {
        let speeds = self.setpoint.velocity.iter().chain([&self.elbow_setpoint.velocity]);
        speeds.into_iter().all(|speed| abs(*speed) < SETPOINT_REST_SPEED)
    }

    /// Updates the wrench estimate from the motor torques, if that is the source.
    fn update_force_estimate(
        &mut self,
        arm: &Arm<'_>,
        settings: &ImpedanceSettings,
        measurement: &ArmMeasurement,
        resolver: &Resolver,
    ) {
        if let ForceSource::Observer { bandwidth } = settings.force {
            // Encoders cannot show that the arm itself is as slow as that.
            let at_rest = self.velocities.iter().all(|velocity| abs(*velocity) < REST_SPEED)
                && measurement.velocities.iter().all(|velocity| abs(*velocity) < CONTACT_REST_SPEED);
            self.momentum_observer.update(arm, &measurement.angles, &self.velocities, bandwidth, at_rest);
            self.estimated_wrench = resolver.wrench(&self.momentum_observer.torques()).into();
        }
    }

    /// Acceleration of the `tool` under the target impedance.
    fn tool_command(
        &self,
        settings: &ImpedanceSettings,
        tool: &IsometryMatrix3<f32>,
        error: &Vector6<f32>,
        velocity: &Vector6<f32>,
        force: &Vector6<f32>,
    ) -> Vector6<f32> {
        let velocity_error = velocity - Vector6::from(self.setpoint.velocity);
        let acceleration = Vector6::from(self.setpoint.acceleration);
        let derating = self.derating.factor();
        if derating > 1.0 {
            // As if mass and damping were multiplied by the derating, apart from the discretisation.
            let [error, force] = [error, force].map(|value| value * (1.0 / derating));
            return acceleration
                + respond(&self.impedance, settings.law, tool, &error, &velocity_error, &force);
        }
        acceleration + respond(&self.impedance, settings.law, tool, error, &velocity_error, force)
    }

    /// Stores velocity and acceleration of the tool. Under load the commanded acceleration is not exact, so
    /// the difference quotient of the velocity is used.
    fn update_tool_motion(&mut self, velocity: &Vector6<f32>, command: &Vector6<f32>, loaded: bool) {
        let velocity = velocity.fixed_rows::<3>(0).into_owned();
        let acceleration = if loaded {
            (velocity - Vector3::from(self.tool_velocity)) * (1.0 / TICK)
        } else {
            command.fixed_rows::<3>(0).into_owned()
        };
        (self.tool_velocity, self.tool_acceleration) = (velocity.into(), acceleration.into());
    }

    /// Limits the joint accelerations so that the reference arm keeps to position and velocity limits.
    fn limit_accelerations(&self, arm: &Arm<'_>, accelerations: &mut JointVector) {
        let mut scale = 1.0_f32;
        let states = self.angles.iter().zip(&self.velocities);
        for ((&angle, &velocity), (acceleration, joint)) in
            states.zip(accelerations.iter_mut().zip(arm.joints))
        {
            let (limits, desired) = (&joint.limits, velocity + TICK * *acceleration);
            let lower = LIMIT_APPROACH_RATE * (limits.lower - angle);
            let upper = LIMIT_APPROACH_RATE * (limits.upper - angle);
            let next = math::clamp(desired, lower, upper);
            // As a difference: an unlimited acceleration keeps its exact bits.
            *acceleration += (next - desired) * (1.0 / TICK);
            let max_speed = VELOCITY_LIMIT_FRACTION * limits.velocity;
            if abs(next) * scale > max_speed {
                scale = max_speed / abs(next);
            }
        }
        if scale < 1.0 {
            // One scale for all joints keeps the direction of the tool.
            for (acceleration, &velocity) in accelerations.iter_mut().zip(&self.velocities) {
                *acceleration = scale * *acceleration - (1.0 - scale) * velocity * (1.0 / TICK);
            }
        }
    }

    /// Joint commands for the period. `torques` balance the external wrench [N·m].
    fn output(
        &self,
        arm: &Arm<'_>,
        settings: &ImpedanceSettings,
        torques: [f32; MAX_CHAIN_JOINTS],
        accelerations: &JointVector,
    ) -> ArmOutput {
        let friction = match settings.law {
            Law::Direct(law) => law.friction,
            Law::ModelFollowing if self.contact => CONTACT_FRICTION_COMPENSATION,
            Law::ModelFollowing => 1.0,
        };
        let mut output = ArmOutput { friction, torques, ..ArmOutput::default() };
        let states = self.angles.iter().zip(&self.velocities);
        let points = output.points.iter_mut().zip(accelerations.iter());
        for ((point, &acceleration), (&position, &velocity)) in points.zip(states) {
            *point = JointPoint { position, velocity, acceleration };
        }
        if settings.law.direct().is_none() {
            for (feedback, observer) in output.feedback.iter_mut().zip(&self.observers) {
                *feedback = arm.observer.feedback(observer);
            }
        }
        output
    }

    /// Integrates the reference arm over one period. Without a successor the set-points come to rest.
    fn advance(&mut self, accelerations: &JointVector) {
        let velocities = JointVector::from(self.velocities);
        add_scaled(&mut self.angles, &velocities, TICK);
        add_scaled(&mut self.angles, accelerations, 0.5 * TICK * TICK);
        add_scaled(&mut self.velocities, accelerations, TICK);
        self.setpoint = self.setpoint.coasted();
        self.elbow_setpoint = self.elbow_setpoint.coasted();
    }
}

/// The part of an estimated wrench to which the tool yields: that beyond the force at which a contact
/// begins. So it is at its set-point when a contact begins, and again before it ends; otherwise it would
/// press and let go again and again.
fn beyond_contact_force(settings: &ImpedanceSettings, wrench: &Vector6<f32>) -> Vector6<f32> {
    let Law::ModelFollowing = settings.law else { return *wrench };
    let force = math::norm(&wrench.fixed_rows::<3>(0));
    wrench * if force > settings.contact_force { 1.0 - settings.contact_force / force } else { 0.0 }
}

#[inline]
fn add_scaled(values: &mut [f32; MAX_CHAIN_JOINTS], change: &JointVector, factor: f32) {
    values.iter_mut().zip(change.iter()).for_each(|(value, change)| *value += factor * change);
}
