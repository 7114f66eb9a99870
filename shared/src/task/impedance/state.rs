use core::f32::consts::{PI, TAU};

use nalgebra::{IsometryMatrix3, Matrix3, Quaternion, UnitQuaternion, Vector3, Vector6};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::momentum::MomentumObserver;
use super::redundancy::{Joints, Resolver};
use super::settings::{ForceSource, ImpedanceSettings, InvalidSettings, Law, Redundancy};
use super::{ArmAngle, SetpointError};
use crate::TICK;
use crate::control::{ErrorObserver, Impedance, JointPoint, ObserverState};
use crate::kinematics::{Chain, ElbowSetpoint, Jacobian, PosePoint, Posture};
use crate::math::{self, abs};
use crate::model::{JointModel, MAX_CHAIN_JOINTS};
use crate::robot::{Measured, Robot};

/// Share of the way to a new impedance that is gone in a tick: no torque jumps.
const BLEND: f32 = 0.05;
/// A contact ends below this share of the contact force, or when so little is left of the force of the last tick: squares.
const CONTACT_ENDS: f32 = 4.0 / 9.0;
const LET_GO: f32 = 0.1;
/// In contact, disturbances are learnt at this share of the rate: the force that is measured comes late.
const CONTACT_LEARNING: f32 = 0.1;
/// And so much of the friction is compensated: more than there is would keep the tool trembling.
const CONTACT_FRICTION: f32 = 0.7;
/// At rest, an error smaller than this is left to the joints' own friction [rad].
const REST_ERROR: f32 = 1e-4;
/// At less than this speed the ideal arm is at rest [rad/s].
const REST_SPEED: f32 = 2e-3;
/// The norm of a unit quaternion is this near to 1.
const UNIT: f32 = 1e-3;
/// Farther off than this counts as this far [rad]: however the arm angle turns where it is hardly defined, near a vertical line
/// from shoulder to wrist, the elbow follows calmly.
const MAX_ELBOW_ERROR: f32 = 0.3;
/// Against nothing where the arm angle cannot be moved, as a square.
const STIFF_ANGLE: f32 = 1e-4;
/// So much of a joint's velocity limit is used.
const SPEED_SHARE: f32 = 0.6;
/// A joint comes to its limits no faster than this [1/s] times its distance from them.
const LIMIT_APPROACH: f32 = 5.0;
/// Iterations that find the sigma_min direction at the start.
const START_ITERATIONS: usize = 16;

/// What the control knows of the arm.
#[derive(Clone, Copy, Debug)]
pub struct Arm<'a> {
    /// Its joints.
    pub chain: &'a Chain,
    /// The same with their drives and their friction.
    pub joints: &'a [JointModel],
    /// Acceleration of gravity in the base frame [m/s²].
    pub gravity: &'a Vector3<f32>,
    /// Of each joint; with an inertia of 1, so that it works on accelerations, and for torques without a lag.
    pub observer: &'a ErrorObserver,
}

impl<'a> Arm<'a> {
    /// The arm that `robot` is; `None` unless it is a single chain of six or seven joints.
    pub fn of(robot: &'a Robot) -> Option<Self> {
        let [config] = robot.chains() else { return None };
        if config.chain.len() < 6 {
            return None;
        }
        Some(Self {
            chain: &config.chain,
            joints: &robot.model().joints,
            gravity: robot.gravity(),
            observer: robot.tracking()?,
        })
    }
}

/// What the arm senses.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ArmSense {
    /// Joint angles [rad].
    pub angles: [f32; MAX_CHAIN_JOINTS],
    /// Joint velocities [rad/s].
    pub velocities: [f32; MAX_CHAIN_JOINTS],
    /// Force and torque of the world on the tool at the tip's origin, in base axes, by the force sensor [N, N·m].
    pub wrench: [f32; 6],
}

impl ArmSense {
    /// Of a robot that is an arm. Entries beyond its joints mean nothing.
    pub fn of(measured: &Measured) -> Self {
        let mut sense = Self { wrench: measured.wrenches[0], ..Self::default() };
        let values = sense.angles.iter_mut().zip(&mut sense.velocities);
        for ((angle, velocity), measured) in values.zip(measured.positions.iter().zip(&measured.velocities)) {
            (*angle, *velocity) = (*measured.0, *measured.1);
        }
        sense
    }
}

/// What the joints are to do until the next tick.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ArmOutput {
    /// Where each joint should be now.
    pub points: [JointPoint; MAX_CHAIN_JOINTS],
    /// Acceleration beyond that of the point, to bring the joint there [rad/s²].
    pub feedback: [f32; MAX_CHAIN_JOINTS],
    /// Torques against what pushes the tool [N·m].
    pub torques: [f32; MAX_CHAIN_JOINTS],
    /// Share of the friction that is to be compensated.
    pub friction: f32,
}

/// What a supervisor sees of an arm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ImpedanceTelemetry {
    /// Position of the tool [m].
    pub position: [f32; 3],
    /// Its orientation as a unit quaternion, `[x, y, z, w]`.
    pub rotation: [f32; 4],
    /// The tool's place less its set-point, as the control had it in the last tick under impedance: translation and
    /// rotation vector [m, rad].
    pub error: [f32; 6],
    /// Force and torque of the world on the tool, in base axes, from the source that the settings name [N, N·m].
    pub wrench: [f32; 6],
    /// Whether that counted as a contact in that tick.
    pub contact: bool,
    /// Smallest singular value of the Jacobian that takes the tool, likewise: less than 0.06 is nearly singular.
    pub sigma_min: f32,
    /// Angle of the elbow: of the driven joint or of the arm [rad].
    pub elbow: f32,
}

impl ImpedanceTelemetry {
    /// Of no arm.
    pub const NONE: Self = Self {
        position: [0.0; 3],
        rotation: NOWHERE.rotation,
        error: [0.0; 6],
        wrench: [0.0; 6],
        contact: false,
        sigma_min: 0.0,
        elbow: 0.0,
    };
}

/// State of an arm's impedance control.
#[derive(Clone, Copy, Debug, Serialize, Deserialize, Schema)]
pub struct ImpedanceState {
    settings: ImpedanceSettings,
    /// As it is now, on the way to that of the settings.
    impedance: Impedance,
    set_point: PosePoint,
    elbow: ElbowSetpoint,
    /// Whether the elbow has no angle where the arm is: then it has no set-point either.
    no_angle: bool,
    /// The ideal arm: angles and velocities at the next tick.
    angles: [f32; MAX_CHAIN_JOINTS],
    velocities: [f32; MAX_CHAIN_JOINTS],
    observers: [ObserverState; MAX_CHAIN_JOINTS],
    contact: bool,
    /// Square of the force of the last tick [N²].
    force: f32,
    /// Velocity of the tool's point [m/s] and its acceleration [m/s²].
    velocity: [f32; 3],
    acceleration: [f32; 3],
    /// Weakest direction of the tool and its singular value.
    direction: [f32; 6],
    sigma_min: f32,
    /// For telemetry.
    error: [f32; 6],
    /// The force without a sensor: the observer, and what it said in the last tick.
    momentum: MomentumObserver,
    observed: [f32; 6],
}

impl ImpedanceState {
    /// Without settings.
    pub const NONE: Self = Self {
        settings: ImpedanceSettings::NONE,
        impedance: ImpedanceSettings::NONE.impedance,
        set_point: NOWHERE,
        elbow: ElbowSetpoint { angle: 0.0, velocity: 0.0, acceleration: 0.0 },
        no_angle: false,
        angles: [0.0; MAX_CHAIN_JOINTS],
        velocities: [0.0; MAX_CHAIN_JOINTS],
        observers: [ObserverState::new(); MAX_CHAIN_JOINTS],
        contact: false,
        force: 0.0,
        velocity: [0.0; 3],
        acceleration: [0.0; 3],
        direction: [1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
        sigma_min: 0.0,
        error: [0.0; 6],
        momentum: MomentumObserver::NONE,
        observed: [0.0; 6],
    };

    /// How the arm behaves from now on; a new impedance is approached within a second.
    ///
    /// # Errors
    /// The first thing that is wrong; nothing has changed then.
    pub fn configure(&mut self, arm: &Arm<'_>, settings: &ImpedanceSettings) -> Result<(), InvalidSettings> {
        settings.validate(arm.chain.len())?;
        let before = core::mem::replace(&mut self.settings, *settings);
        if before.law != settings.law {
            // The direct law learns nothing about disturbances, and what was learnt before it is out of date.
            self.observers = Self::NONE.observers;
        }
        if before.redundancy != settings.redundancy {
            // The elbow stays where it is.
            let posture = arm.chain.posture(&self.angles);
            let angle = self.elbow_angle(arm, &posture, &self.angles);
            self.elbow = ElbowSetpoint { angle, ..ElbowSetpoint::default() };
            self.find_sigma_min(&posture);
        }
        Ok(())
    }

    /// Begins at rest at these angles [rad], which are the set-point, too, with valid settings.
    pub fn begin(&mut self, arm: &Arm<'_>, settings: &ImpedanceSettings, angles: &[f32; MAX_CHAIN_JOINTS]) {
        self.clone_from(&Self::NONE);
        (self.settings, self.impedance, self.angles) = (*settings, settings.impedance, *angles);
        let posture = arm.chain.posture(angles);
        let tip = posture.tip();
        let rotation = UnitQuaternion::from_rotation_matrix(&tip.rotation);
        let position = tip.translation.vector.into();
        self.set_point = PosePoint { position, rotation: rotation.coords.into(), ..NOWHERE };
        self.elbow.angle = self.elbow_angle(arm, &posture, angles);
        self.find_sigma_min(&posture);
    }

    /// Sets where the tool and the elbow should be.
    ///
    /// # Errors
    /// What is wrong with it; the set-point stays what it was.
    pub fn set_target(
        &mut self,
        arm: &Arm<'_>,
        point: &PosePoint,
        elbow: &ElbowSetpoint,
    ) -> Result<(), SetpointError> {
        let settings = self.settings;
        let numbers =
            point.position.iter().chain(&point.rotation).chain(&point.velocity).chain(&point.acceleration);
        let of_elbow = [elbow.angle, elbow.velocity, elbow.acceleration];
        if !numbers.chain(&of_elbow).all(|number| number.is_finite()) {
            return Err(SetpointError::NotFinite);
        }
        let norm = math::sqrt(point.rotation.iter().map(|part| part * part).sum());
        if norm.is_nan() || abs(norm - 1.0) > UNIT {
            return Err(SetpointError::NotUnit { norm });
        }
        let posture = arm.chain.posture(&self.angles);
        // Neither now nor a tick later may it be out of reach: that bounds its speed and acceleration, too.
        for point in [point, &point.ahead()] {
            displacement(posture.tip(), point, &settings)?;
        }
        if settings.redundancy != Redundancy::None {
            let own = self.elbow_angle(arm, &posture, &self.angles);
            let (speed, [_, limit]) = (elbow.velocity + elbow.acceleration * TICK, settings.reach);
            for angle in [elbow.angle, elbow.angle + speed * TICK] {
                let value = abs(angle - own);
                // The shorter way round; more turns than one are none of an elbow's.
                let value = value.min(abs(value - TAU));
                if value.is_nan() || value > limit {
                    return Err(SetpointError::Elbow { value, limit });
                }
            }
        }
        (self.set_point, self.elbow) = (*point, *elbow);
        Ok(())
    }

    /// Acceleration of the tool's point since the last tick, as far as it is known [m/s²]: what the tool's own mass feels.
    pub fn acceleration(&self) -> Vector3<f32> {
        self.acceleration.into()
    }

    /// What a supervisor sees, given what the arm senses, and its posture there.
    pub fn telemetry(&self, arm: &Arm<'_>, sense: &ArmSense, posture: &Posture) -> ImpedanceTelemetry {
        let tip = posture.tip();
        ImpedanceTelemetry {
            position: tip.translation.vector.into(),
            rotation: UnitQuaternion::from_rotation_matrix(&tip.rotation).coords.into(),
            error: self.error,
            wrench: self.felt(sense).into(),
            contact: self.contact,
            sigma_min: self.sigma_min,
            elbow: self.elbow_angle(arm, posture, &sense.angles),
        }
    }

    /// One control period.
    ///
    /// # Errors
    /// Why the arm has to stop.
    pub fn tick(&mut self, arm: &Arm<'_>, sense: &ArmSense) -> Result<ArmOutput, SetpointError> {
        let settings = self.settings;
        self.impedance.blend_towards(&settings.impedance, BLEND);
        let wrench = self.felt(sense);
        if !wrench.iter().all(|value| value.is_finite()) {
            return Err(SetpointError::NotFinite);
        }
        let measured = self.feel_contact(&settings, &wrench);
        self.observe(arm, &settings, sense, measured);

        let posture = arm.chain.posture(&self.angles);
        let jacobian = posture.jacobian();
        let driven = driven(settings.redundancy);
        let mut direction = self.direction.into();
        let resolver = Resolver::new(jacobian, driven, &mut direction, &mut self.sigma_min);
        self.direction = direction.into();
        if let ForceSource::Observer { bandwidth } = settings.force {
            let resting = self.velocities.iter().all(|velocity| abs(*velocity) < REST_SPEED);
            self.momentum.update(arm, &sense.angles, &self.velocities, bandwidth, resting);
            self.observed = resolver.wrench(&self.momentum.torques()).into();
        }
        let wrench = self.felt(sense);

        let tip = posture.tip();
        let error = displacement(tip, &self.set_point, &settings)?;
        let matched = self.impedance.discretized();
        self.error = error.into();
        let velocities = Joints::from(self.velocities);
        let speed = jacobian * velocities;
        let velocity = speed - Vector6::from(self.set_point.velocity);
        let pushed = self.contact || settings.law == Law::Direct;
        let force = if pushed { wrench } else { Vector6::zeros() };
        let wanted = Vector6::from(self.set_point.acceleration)
            + match settings.law {
                Law::Direct => self.impedance.acceleration(&error, &velocity, &force),
                Law::ModelFollowing => matched.acceleration(&error, &velocity, &force),
            };
        let speed = speed.fixed_rows::<3>(0).into_owned();
        let linear = if pushed {
            (speed - Vector3::from(self.velocity)) * (1.0 / TICK)
        } else {
            wanted.fixed_rows::<3>(0).into_owned()
        };
        (self.velocity, self.acceleration) = (speed.into(), linear.into());
        let bias = posture.bias_acceleration(velocities.as_slice());
        let mut accelerations =
            self.resolve(arm, &settings, &posture, &resolver, &jacobian, &(wanted - bias));
        self.keep_within_limits(arm, &mut accelerations);

        let friction = match settings.law {
            Law::Direct => 0.0,
            Law::ModelFollowing if self.contact => CONTACT_FRICTION,
            Law::ModelFollowing => 1.0,
        };
        let against = jacobian.tr_mul(&-force);
        let mut command = ArmOutput { friction, ..ArmOutput::default() };
        command.torques = against.into();
        let states = self.angles.iter().zip(&self.velocities).zip(accelerations.iter());
        for (point, ((&position, &velocity), &acceleration)) in command.points.iter_mut().zip(states) {
            *point = JointPoint { position, velocity, acceleration };
        }
        if settings.law == Law::ModelFollowing {
            for (feedback, state) in command.feedback.iter_mut().zip(&self.observers) {
                *feedback = arm.observer.feedback(state);
            }
        }
        self.advance(&accelerations);
        Ok(command)
    }

    /// Closes the tick: what the limits added to the acceleration of each joint [rad/s²], and the mean torques of the motors
    /// until the next tick [N·m].
    pub fn applied(
        &mut self,
        arm: &Arm<'_>,
        added: &[f32; MAX_CHAIN_JOINTS],
        torques: &[f32; MAX_CHAIN_JOINTS],
    ) {
        self.momentum.push(torques);
        for (state, added) in self.observers.iter_mut().zip(added) {
            let wanted = arm.observer.feedback(state);
            arm.observer.predict(state, wanted + added);
        }
    }

    /// Whether the force would come from another source under these settings: that is decided before the arm is armed.
    pub fn changes_source(&self, settings: &ImpedanceSettings) -> bool {
        let source = |settings: &ImpedanceSettings| core::mem::discriminant(&settings.force);
        source(&self.settings) != source(settings)
    }

    /// What the observer of the force says now is what it says without contact. `false` if the force comes from a sensor.
    pub const fn tare(&mut self) -> bool {
        let observes = self.observes_force();
        if observes {
            self.momentum.tare();
        }
        observes
    }

    /// Whether the force is taken from the motors' torques.
    pub const fn observes_force(&self) -> bool {
        matches!(self.settings.force, ForceSource::Observer { .. })
    }

    /// What pushes the tool [N, N·m].
    fn felt(&self, sense: &ArmSense) -> Vector6<f32> {
        if self.observes_force() { self.observed.into() } else { sense.wrench.into() }
    }

    /// Whether something pushes the tool; returns whether the measured state counts: as long as something does, and once
    /// more when it ends.
    fn feel_contact(&mut self, settings: &ImpedanceSettings, wrench: &Vector6<f32>) -> bool {
        let force = wrench.fixed_rows::<3>(0).norm_squared();
        let before = core::mem::replace(&mut self.force, force);
        let limit = settings.contact_force * settings.contact_force;
        let contact = if self.contact {
            force > CONTACT_ENDS * limit && force > LET_GO * before
        } else {
            force > limit
        };
        core::mem::replace(&mut self.contact, contact) || contact
    }

    /// Compares the ideal arm with the real one. Where the measured state counts, the ideal arm is brought there.
    fn observe(&mut self, arm: &Arm<'_>, settings: &ImpedanceSettings, sense: &ArmSense, counts: bool) {
        if settings.law == Law::Direct {
            (self.angles, self.velocities) = (sense.angles, sense.velocities);
            return;
        }
        let ideal = self.angles.iter_mut().zip(&mut self.velocities);
        let joints = ideal.zip(&mut self.observers).zip(&sense.angles).take(arm.chain.len());
        for (((angle, velocity), state), measured) in joints {
            let error = *angle - measured;
            let resting = abs(*velocity) < REST_SPEED && abs(error) < REST_ERROR;
            let learning = match (resting, counts) {
                (true, _) => 0.0,
                (false, true) => CONTACT_LEARNING,
                (false, false) => 1.0,
            };
            arm.observer.correct(state, error, learning);
            if counts {
                let [error, rate] = state.error();
                *angle -= error;
                *velocity -= rate;
                state.reset_motion();
            }
        }
    }

    /// Joint accelerations for the tool's, and for the elbow.
    fn resolve(
        &mut self,
        arm: &Arm<'_>,
        settings: &ImpedanceSettings,
        posture: &Posture,
        resolver: &Resolver,
        jacobian: &Jacobian,
        tool: &Vector6<f32>,
    ) -> Joints {
        let bandwidth = settings.elbow_bandwidth;
        let velocities = Joints::from(self.velocities);
        let angle = match settings.redundancy {
            Redundancy::ArmAngle => ArmAngle::of(posture, arm.gravity),
            _ => None,
        };
        if let (Some(ArmAngle { angle, .. }), true) = (&angle, self.no_angle) {
            // It has one again, and stays where it is until it is led.
            self.elbow = ElbowSetpoint { angle: *angle, ..ElbowSetpoint::default() };
        }
        self.no_angle = angle.is_none();
        let elbow = self.elbow;
        let toward = |angle: f32, velocity: f32| {
            elbow.acceleration
                + 2.0 * bandwidth * (elbow.velocity - velocity)
                + bandwidth
                    * bandwidth
                    * math::clamp(shorter(elbow.angle - angle), -MAX_ELBOW_ERROR, MAX_ELBOW_ERROR)
        };
        if let Some(joint) = driven(settings.redundancy) {
            let of_joint = self.angles.get(joint).zip(self.velocities.get(joint));
            let (&angle, &velocity) = of_joint.unwrap_or((&0.0, &0.0));
            let own = toward(angle, velocity);
            let mut all = jacobian.column_iter();
            let Some(column) = all.nth(joint) else { return resolver.solve(tool) };
            let mut accelerations = resolver.solve(&(tool - column * own));
            accelerations.iter_mut().skip(joint).take(1).for_each(|value| *value = own);
            return accelerations;
        }
        let mut accelerations = resolver.solve(tool);
        if let Some(ArmAngle { angle, jacobian: row }) = angle {
            let missing = toward(angle, row.dot(&velocities)) - row.dot(&accelerations);
            let motion = resolver.null(&row);
            let size = row.dot(&motion);
            accelerations += motion * (missing * size / (size * size + STIFF_ANGLE));
        } else if arm.chain.len() == MAX_CHAIN_JOINTS {
            // Nothing tells the elbow where to be: what moves it calms down.
            accelerations -= resolver.null(&velocities) * (2.0 * bandwidth);
        }
        accelerations
    }

    /// Changes the joint accelerations, where the joints would come too near to their limits, or be too fast.
    fn keep_within_limits(&self, arm: &Arm<'_>, accelerations: &mut Joints) {
        let mut scale = 1.0_f32;
        let states = self.angles.iter().zip(&self.velocities);
        for ((&angle, &velocity), (acceleration, joint)) in
            states.zip(accelerations.iter_mut().zip(arm.joints))
        {
            let (limits, wanted) = (&joint.limits, velocity + TICK * *acceleration);
            let (least, most) =
                (LIMIT_APPROACH * (limits.lower - angle), LIMIT_APPROACH * (limits.upper - angle));
            let next = math::clamp(wanted, least, most);
            // Added, so that nothing is rounded where nothing is to be changed.
            *acceleration += (next - wanted) * (1.0 / TICK);
            let speed = SPEED_SHARE * limits.velocity;
            if abs(next) * scale > speed {
                scale = speed / abs(next);
            }
        }
        if scale < 1.0 {
            // All of them slower, so that the tool keeps its direction.
            for (acceleration, &velocity) in accelerations.iter_mut().zip(&self.velocities) {
                *acceleration = scale * *acceleration - (1.0 - scale) * velocity * (1.0 / TICK);
            }
        }
    }

    /// The ideal arm a period later, and the set-point, should no other come: it coasts to rest.
    fn advance(&mut self, accelerations: &Joints) {
        let velocities = Joints::from(self.velocities);
        add(&mut self.angles, &velocities, TICK);
        add(&mut self.angles, accelerations, 0.5 * TICK * TICK);
        add(&mut self.velocities, accelerations, TICK);
        self.set_point = self.set_point.coasted();
        self.elbow = self.elbow.coasted();
    }

    /// Of an arm at `angles`, which is `posture`.
    fn elbow_angle(&self, arm: &Arm<'_>, posture: &Posture, angles: &[f32; MAX_CHAIN_JOINTS]) -> f32 {
        match self.settings.redundancy {
            Redundancy::DrivenJoint { joint } => angles.get(usize::from(joint)).copied().unwrap_or(0.0),
            Redundancy::ArmAngle => ArmAngle::of(posture, arm.gravity).map_or(0.0, |arm| arm.angle),
            Redundancy::None => 0.0,
        }
    }

    fn find_sigma_min(&mut self, posture: &Posture) {
        let jacobian = posture.jacobian();
        let driven = driven(self.settings.redundancy);
        let mut direction = Vector6::repeat(math::sqrt(1.0 / 6.0));
        for _ in 0..START_ITERATIONS {
            let _ = Resolver::new(jacobian, driven, &mut direction, &mut self.sigma_min);
        }
        self.direction = direction.into();
    }
}

const NOWHERE: PosePoint = PosePoint {
    position: [0.0; 3],
    rotation: [0.0, 0.0, 0.0, 1.0],
    velocity: [0.0; 6],
    acceleration: [0.0; 6],
};

fn driven(redundancy: Redundancy) -> Option<usize> {
    match redundancy {
        Redundancy::DrivenJoint { joint } => Some(joint.into()),
        _ => None,
    }
}

fn add(values: &mut [f32; MAX_CHAIN_JOINTS], change: &Joints, factor: f32) {
    values.iter_mut().zip(change.iter()).for_each(|(value, change)| *value += factor * change);
}

/// The same angle within half a turn [rad].
fn shorter(angle: f32) -> f32 {
    if abs(angle) <= PI { angle } else { angle - TAU * math::round(angle / TAU) }
}

fn matrix(&[x, y, z, w]: &[f32; 4]) -> Matrix3<f32> {
    UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z)).to_rotation_matrix().into_inner()
}

/// The tool's place less the set-point: translation and the shorter rotation.
///
/// # Errors
/// It is beyond the reach.
fn displacement(
    tool: &IsometryMatrix3<f32>,
    point: &PosePoint,
    settings: &ImpedanceSettings,
) -> Result<Vector6<f32>, SetpointError> {
    let [far, twisted] = settings.reach;
    let way = tool.translation.vector - Vector3::from(point.position);
    let turn = math::rotation_vector(&(tool.rotation.matrix() * matrix(&point.rotation).transpose()));
    let (distance, angle) = (math::sqrt(way.norm_squared()), math::sqrt(turn.norm_squared()));
    if distance.is_nan() || distance > far {
        return Err(SetpointError::Distance { value: distance, limit: far });
    }
    if angle.is_nan() || angle > twisted {
        return Err(SetpointError::Rotation { value: angle, limit: twisted });
    }
    Ok(Vector6::new(way.x, way.y, way.z, turn.x, turn.y, turn.z))
}
