//! Impedance control with a force estimate from the motor torques, in closed loop with a simulation of the
//! model.

use nalgebra::{SVector, Vector3, Vector6};

use super::arm::{ANGLES, arm_rig, configure, enable, set_encoders, telemetry};
use super::rig::Rig;
use crate::TICK;
use crate::kinematics::Chain;
use crate::model::{ForceSensor, RobotModel};
use crate::protocol::{ActuatorFrame, Mode, Reply, Request};
use crate::task::impedance::tests::{SOFT, arm7};
use crate::task::impedance::{ForceSource, ImpedanceSettings};

/// Integration steps per control period. The drives have a delay of one step.
const STEPS: u16 = 12;
/// Viscous friction [N·m·s/rad].
const VISCOUS: f32 = 0.05;
type JointVector = SVector<f32, 7>;

/// A wall perpendicular to the x axis of the base: a spring with little damping.
#[derive(Clone, Copy)]
pub(super) struct Wall {
    /// [m].
    pub x: f32,
    /// [N/m].
    pub stiffness: f32,
}

impl Wall {
    /// Force on a tool at `x` with a velocity along x [N].
    fn force(self, x: f32, velocity: f32) -> f32 {
        let depth = x - self.x;
        if depth > 0.0 { (-self.stiffness * depth - 20.0 * velocity).min(0.0) } else { 0.0 }
    }
}

pub(super) struct SimulatedArm {
    model: RobotModel,
    pub chain: Chain,
    pub rig: Rig,
    pub angles: JointVector,
    velocities: JointVector,
    torques: JointVector,
    pub wall: Option<Wall>,
    /// Unmodelled torques [N·m].
    pub disturbance: JointVector,
    /// Largest force on the wall [N] and speed of the tool [m/s] so far.
    pub max_force: f32,
    pub max_speed: f32,
}

impl SimulatedArm {
    pub fn enabled(settings: &ImpedanceSettings, force_sensor: Option<ForceSensor>) -> Self {
        let mut model = arm7();
        model.chains[0].force_sensor = force_sensor;
        for joint in &mut model.joints {
            (joint.friction.coulomb, joint.friction.viscous) = (0.0, VISCOUS);
            // A delay of one integration step.
            (joint.motor.delay, joint.motor.bandwidth) = (TICK / f32::from(STEPS), 1e4);
        }
        let mut rig = arm_rig(&model);
        if force_sensor.is_some() {
            assert_eq!(rig.ask(Request::Tare), Reply::Done);
        }
        assert_eq!(rig.ask(enable(*settings)), Reply::Done);
        let rotors = model.joints.iter().map(|joint| joint.motor.rotor_inertia);
        let chain = Chain::new(&model.joints, &model.chains[0].tip).with_rotor_inertia(rotors);
        let (angles, velocities, torques) =
            (JointVector::from(ANGLES), JointVector::zeros(), JointVector::zeros());
        let (wall, disturbance, max_force, max_speed) = (None, JointVector::zeros(), 0.0, 0.0);
        Self { model, chain, rig, angles, velocities, torques, wall, disturbance, max_force, max_speed }
    }

    /// Runs `ticks` under an external `force` on the tool [N].
    pub fn run(&mut self, ticks: u16, force: Vector3<f32>) {
        for _ in 0..ticks {
            self.tick(force);
            assert!(matches!(self.rig.node.mode(), Mode::Enabled(_)), "{:?}", self.rig.node.faults());
            assert_eq!(self.rig.ask(Request::Keep), Reply::Done);
        }
    }

    /// Position of the tool [m].
    pub fn tool(&self) -> Vector3<f32> {
        self.chain.posture(self.angles.as_slice()).tip().translation.vector
    }

    /// Kinetic energy [J].
    pub fn energy(&self) -> f32 {
        0.5 * self.velocities.dot(&(self.chain.mass_matrix(self.angles.as_slice()) * self.velocities))
    }

    /// Speed of the tool [m/s].
    pub fn speed(&self) -> f32 {
        let jacobian = self.chain.posture(self.angles.as_slice()).jacobian();
        (jacobian * self.velocities).fixed_rows::<3>(0).norm()
    }

    /// Force of the wall on the tool [N].
    pub fn wall_force(&self) -> Vector3<f32> {
        let posture = self.chain.posture(self.angles.as_slice());
        let velocity = posture.jacobian() * self.velocities;
        let x = posture.tip().translation.x;
        Vector3::x() * self.wall.map_or(0.0, |wall| wall.force(x, velocity.x))
    }

    /// Runs one tick under an external `force` on the tool [N], in addition to that of the wall.
    pub fn tick(&mut self, force: Vector3<f32>) {
        self.sense(force + self.wall_force());
        let output = self.rig.tick();
        self.advance(force, &output);
    }

    /// Sets the sensor values. `force` is that of the world on the tool [N].
    pub fn sense(&mut self, force: Vector3<f32>) {
        set_encoders(&mut self.rig, self.angles.as_slice());
        let Some(sensor) = &self.model.chains[0].force_sensor else { return };
        let to_tool = self.chain.posture(self.angles.as_slice()).tip().rotation.inverse();
        let counts = to_tool * force / sensor.force_resolution;
        // Noise: constant counts would be a fault.
        let noise = self.rig.sensors.sequence as i32 % 2;
        let [x, y, z] = <[f32; 3]>::from(counts).map(|value| value as i32 + noise);
        self.rig.sensors.forces[0] = [x, y, z, noise, noise, noise];
    }

    /// Moves the arm by one period.
    pub fn advance(&mut self, force: Vector3<f32>, output: &ActuatorFrame) {
        let gravity = Vector3::from(self.model.gravity);
        let commanded = JointVector::from_iterator(output.torques.iter().copied());
        for step in 0..STEPS {
            let torques = if step == 0 { self.torques } else { commanded };
            let mut bias = JointVector::zeros();
            let (angles, velocities) = (self.angles.as_slice(), self.velocities.as_slice());
            let rest = JointVector::zeros();
            self.chain.inverse_dynamics(&gravity, angles, velocities, rest.as_slice(), bias.as_mut_slice());
            let total = force + self.wall_force();
            let wrench = Vector6::new(total.x, total.y, total.z, 0.0, 0.0, 0.0);
            let jacobian = self.chain.posture(angles).jacobian();
            self.max_force = self.max_force.max(self.wall_force().norm());
            self.max_speed = self.max_speed.max((jacobian * self.velocities).fixed_rows::<3>(0).norm());
            let external = jacobian.tr_mul(&wrench);
            let mass = self.chain.mass_matrix(angles).cholesky().unwrap();
            let acceleration =
                mass.solve(&(torques + self.disturbance - bias - self.velocities * VISCOUS + external));
            self.velocities += acceleration * (TICK / f32::from(STEPS));
            self.angles += self.velocities * (TICK / f32::from(STEPS));
        }
        self.torques = commanded;
    }
}

#[test]
fn an_arm_without_a_force_sensor_yields_to_an_external_force() {
    let estimating =
        ImpedanceSettings { force: ForceSource::Observer { bandwidth: 30.0 }, contact_force: 3.0, ..SOFT };
    let mut arm = SimulatedArm::enabled(&estimating, None);
    // No effect: the observer tares itself once the arm has been at rest.
    assert_eq!(arm.rig.ask(Request::Tare), Reply::Done);
    arm.run(60, Vector3::zeros());
    let free = telemetry(&mut arm.rig);
    assert!(Vector6::from(free.wrench).amax() < 0.5 && !free.contact, "{free:?}");

    // 10 N, less the 3 N at which a contact begins, on a spring of 300 N/m.
    arm.run(250, Vector3::new(-10.0, 0.0, 0.0));
    let pushed = telemetry(&mut arm.rig);
    let error = Vector6::from(pushed.wrench) - Vector6::new(-10.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    assert!(error.amax() < 0.5 && pushed.contact, "{pushed:?}");
    let displacement = Vector3::from(pushed.position) - Vector3::from(free.position);
    assert!((displacement - Vector3::new(-7.0 / 300.0, 0.0, 0.0)).norm() < 2e-3, "{displacement}");

    arm.run(300, Vector3::zeros());
    let back = telemetry(&mut arm.rig);
    assert!(Vector6::from(back.wrench).amax() < 0.5 && !back.contact, "{back:?}");
    assert!((Vector3::from(back.position) - Vector3::from(free.position)).norm() < 1e-3, "{back:?}");

    // The force source cannot change while enabled.
    let with_sensor = ImpedanceSettings { force: ForceSource::Sensor, ..estimating };
    assert!(matches!(arm.rig.ask(configure(with_sensor)), Reply::Refused(_)));
    let slower = ImpedanceSettings { force: ForceSource::Observer { bandwidth: 20.0 }, ..estimating };
    assert_eq!(arm.rig.ask(configure(slower)), Reply::Done);
}

#[test]
fn the_load_of_a_contact_that_is_estimated_is_carried_once() {
    let estimating =
        ImpedanceSettings { force: ForceSource::Observer { bandwidth: 30.0 }, contact_force: 15.0, ..SOFT };
    let direction = Vector3::new(0.6, 0.0, 0.8);
    let mut arm = SimulatedArm::enabled(&estimating, None);
    arm.run(60, Vector3::zeros());
    let start = arm.tool();
    // 25 N within a second, for two seconds, and back to zero within a second.
    let forces = (0_i16..500).map(|tick| 0.25 * f32::from(tick.min(400 - tick).clamp(0, 100)));
    let (mut contacts, mut in_contact) = (0, false);
    for force in forces {
        arm.run(1, direction * force);
        let telemetry = telemetry(&mut arm.rig);
        contacts += i32::from(telemetry.contact && !in_contact);
        in_contact = telemetry.contact;
        // It never moves against the pull.
        let moved = (arm.tool() - start).dot(&direction);
        assert!(moved > -1e-3, "{moved} m under {force} N");
    }
    assert!(contacts == 1 && !in_contact, "{contacts}");
    assert!((arm.tool() - start).norm() < 1e-3);
}

#[test]
fn a_stopped_arm_goes_with_a_pull_that_is_estimated() {
    let estimating =
        ImpedanceSettings { force: ForceSource::Observer { bandwidth: 30.0 }, contact_force: 15.0, ..SOFT };
    let direction = Vector3::new(0.6, 0.0, 0.8);
    for before in [0.0_f32, 12.0] {
        let mut arm = SimulatedArm::enabled(&estimating, None);
        arm.run(60, Vector3::zeros());
        arm.run(100, direction * before);
        assert_eq!(arm.rig.ask(Request::Stop), Reply::Done);
        let start = arm.tool();
        for tick in 0..400_u16 {
            let force = (before + 0.25 * f32::from(tick)).min(25.0);
            arm.max_speed = 0.0;
            arm.tick(direction * force);
            let moved = (arm.tool() - start).dot(&direction);
            let speed = arm.max_speed;
            assert!(moved > -1e-3 && speed < 0.25, "{before} N, then {force} N: {moved} m, {speed} m/s");
        }
        let faults = arm.rig.node.faults();
        assert_eq!(faults.total, 1, "{faults:?}");
    }
}
