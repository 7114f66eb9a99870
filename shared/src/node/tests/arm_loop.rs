//! An arm under impedance that feels by its motors, in a closed loop: the outputs move a machine as the model
//! says it is.

use nalgebra::{SVector, Vector3, Vector6};

use super::arm::{ANGLES, bench, configure, enable, seen, stand};
use super::bench::Bench;
use crate::TICK;
use crate::kinematics::Chain;
use crate::model::RobotModel;
use crate::protocol::{Mode, Reply, Request};
use crate::task::impedance::tests::{SOFT, arm7};
use crate::task::impedance::{ForceSource, ImpedanceSettings};

/// Steps of the machine in a control period; the drives follow after one of them.
const STEPS: u16 = 12;
const VISCOUS: f32 = 0.05;
type Joints = SVector<f32, 7>;

struct Machine {
    model: RobotModel,
    chain: Chain,
    bench: Bench,
    angles: Joints,
    velocities: Joints,
    torques: Joints,
}

impl Machine {
    fn armed(settings: &ImpedanceSettings) -> Self {
        let mut model = arm7();
        for joint in &mut model.joints {
            (joint.friction.coulomb, joint.friction.viscous) = (0.0, VISCOUS);
            // One step of the machine.
            (joint.motor.delay, joint.motor.bandwidth) = (TICK / f32::from(STEPS), 1e4);
        }
        let mut bench = bench(&model);
        assert_eq!(bench.ask(enable(*settings)), Reply::Done);
        let rotors = model.joints.iter().map(|joint| joint.motor.rotor_inertia);
        let chain = Chain::new(&model.joints, &model.chains[0].tip).with_rotor_inertia(rotors);
        let (angles, velocities, torques) = (Joints::from(ANGLES), Joints::zeros(), Joints::zeros());
        Self { model, chain, bench, angles, velocities, torques }
    }

    /// So many ticks while the world pushes the tool with `force` [N].
    fn run(&mut self, ticks: u16, force: Vector3<f32>) {
        let wrench = Vector6::new(force.x, force.y, force.z, 0.0, 0.0, 0.0);
        let gravity = Vector3::from(self.model.gravity);
        for _ in 0..ticks {
            stand(&mut self.bench, self.angles.as_slice());
            let output = self.bench.tick();
            assert!(matches!(self.bench.node.mode(), Mode::Enabled(_)), "{:?}", self.bench.node.faults());
            assert_eq!(self.bench.ask(Request::Keep), Reply::Done);
            let wanted = Joints::from_iterator(output.torques.iter().copied());
            for step in 0..STEPS {
                let torques = if step == 0 { self.torques } else { wanted };
                let mut bias = Joints::zeros();
                let (angles, velocities) = (self.angles.as_slice(), self.velocities.as_slice());
                self.chain.nonlinear_effects(&gravity, angles, velocities, bias.as_mut_slice());
                let push = self.chain.posture(angles).jacobian().tr_mul(&wrench);
                let mass = self.chain.mass_matrix(angles).cholesky().unwrap();
                let acceleration = mass.solve(&(torques - bias - self.velocities * VISCOUS + push));
                self.velocities += acceleration * (TICK / f32::from(STEPS));
                self.angles += self.velocities * (TICK / f32::from(STEPS));
            }
            self.torques = wanted;
        }
    }
}

#[test]
fn an_arm_without_a_force_sensor_yields_to_what_its_motors_feel() {
    let observing =
        ImpedanceSettings { force: ForceSource::Observer { bandwidth: 30.0 }, contact_force: 3.0, ..SOFT };
    let mut machine = Machine::armed(&observing);
    // Too early: the tare comes by itself, once the arm has rested.
    assert_eq!(machine.bench.ask(Request::Tare), Reply::Done);
    machine.run(60, Vector3::zeros());
    let free = seen(&mut machine.bench);
    assert!(Vector6::from(free.wrench).amax() < 0.5 && !free.contact, "{free:?}");

    // 10 N on a spring of 300 N/m: 33 mm.
    machine.run(250, Vector3::new(-10.0, 0.0, 0.0));
    let pushed = seen(&mut machine.bench);
    let wrong = Vector6::from(pushed.wrench) - Vector6::new(-10.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    assert!(wrong.amax() < 0.5 && pushed.contact, "{pushed:?}");
    let way = Vector3::from(pushed.position) - Vector3::from(free.position);
    assert!((way - Vector3::new(-10.0 / 300.0, 0.0, 0.0)).norm() < 3e-3, "{way}");

    machine.run(300, Vector3::zeros());
    let back = seen(&mut machine.bench);
    assert!(Vector6::from(back.wrench).amax() < 0.5 && !back.contact, "{back:?}");
    assert!((Vector3::from(back.position) - Vector3::from(free.position)).norm() < 1e-3, "{back:?}");

    // Another source while armed would forget what is in the way.
    let sensing = ImpedanceSettings { force: ForceSource::Sensor, ..observing };
    assert!(matches!(machine.bench.ask(configure(sensing)), Reply::Refused(_)));
    let slower = ImpedanceSettings { force: ForceSource::Observer { bandwidth: 20.0 }, ..observing };
    assert_eq!(machine.bench.ask(configure(slower)), Reply::Done);
}
