use std::path::Path;
use tesaki::arm::*;
use tesaki::control::Impedance;
use tesaki::protocol::*;
use tesaki_sim::controller::{Controller, Native};
use tesaki_sim::plant::*;
use tesaki_supervisor::Board;
use tesaki_supervisor::robot::RobotFolder;
fn main() {
    let a: Vec<f64> = std::env::args().skip(1).map(|x| x.parse().unwrap()).collect();
    let (seed, axis, b, mr, br, kr, paper, mism) = (
        a[0] as u64,
        a[1] as usize,
        a[2] as f32,
        a[3] as f32,
        a[4] as f32,
        a[5] as f32,
        a[6] > 0.0,
        a[7] > 0.0,
    );
    let path = Path::new("robots/arm7");
    let robot = RobotFolder::load(path).unwrap();
    let mut values = PlantValues::load(path).unwrap();
    let mut model = robot.model.clone();
    let mut o = PlantOptions::mismatched(seed);
    if !mism {
        o.mismatch = false;
        o.coulomb = Some(0.02);
        model.joints.iter_mut().for_each(|j| j.friction.coulomb = 0.02);
    }
    let _ = &mut values;
    let drives: Vec<Drive> = model.joints.iter().map(Drive::from).collect();
    let mut plant = Plant::new(&robot.urdf, &drives, &values, &o).unwrap();
    let mut c = Native::default();
    c.hello().unwrap();
    c.take_command(false).unwrap();
    c.push_model(&model).unwrap();
    let mut seq = 0;
    let mut tick = |c: &mut Native, plant: &mut Plant| {
        seq += 1;
        let act = c.tick(&plant.sensors(seq)).unwrap();
        plant.apply(&act).unwrap();
        act
    };
    for _ in 0..50 {
        tick(&mut c, &mut plant);
    }
    c.tare().unwrap();
    let im = Impedance {
        mass: [1.5, 1.5, 1.5, mr, mr, mr],
        damping: [b, b, b, br, br, br],
        stiffness: [300.0, 300.0, 300.0, kr, kr, kr],
    };
    c.behave(ArmSettings {
        impedance: im,
        law: if paper { Law::Printed } else { Law::Following },
        redundancy: Redundancy::Driven { joint: 2 },
        elbow_bandwidth: 12.0,
        contact_force: 1.5,
        reach: [0.3, 1.5],
    })
    .unwrap();
    c.arm(Task::Impedance).unwrap();
    let t0 = c.read_arm().unwrap();
    for k in 0..400 {
        if k == 50 {
            let mut p = t0.position.map(f64::from);
            p[axis] += 0.03;
            plant.hold_tip(0, Hold::firm(p, t0.rotation.map(f64::from), 0.8)).unwrap();
        }
        if k == 199 {
            plant.release_tip(0, 0.009).unwrap();
        }
        let truth = plant.tips();
        let act = tick(&mut c, &mut plant);
        let t = c.read_arm().unwrap();
        if c.keep().is_err() {
            println!("{:?}", c.faults().unwrap().faults.last());
            break;
        }
        if a.len() < 9 || (k as f64 >= a[8] && (k as f64) < a[9]) {
            println!(
                "{k} {:.2?} F {:.1?} ft {:.1?} c{} e {:.2?} s {:.3} tq {:.1?} qd {:.2?}",
                [0, 1, 2].map(|i| 1e3 * (truth[0].position[i] - f64::from(t0.position[i]))),
                t.wrench,
                truth[0].force,
                t.contact as u8,
                t.error.map(|e| 1e3 * e),
                t.weakest,
                act.torques.as_slice(),
                c.node().telemetry().joints.iter().map(|j| j.velocity).collect::<Vec<_>>()
            );
        }
    }
}
