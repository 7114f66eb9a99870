//! The arm compared with MuJoCo.

use crate::arm::{Arm, JOINTS, hand};
use crate::hand::{frame_of, largest};
use tesaki_sim::plant::Wall;

type Joints = [f64; JOINTS];
/// Feed-forward torque, reference, and MuJoCo's joint positions, position of the hand's end and mean force of
/// the wall over the previous period, at the start of a control period.
type Row = (Joints, Joints, Joints, [f64; 3], [f64; 1]);
/// Name, stiffness and damping of the wall, rows.
type Case = (&'static str, Option<(f64, f64)>, &'static [Row]);
/// Stiffness, damping, motions: from `tests/oracles/arm_motion.py`.
const MOTIONS: ([Joints; JOINTS], [Joints; JOINTS], &[Case]) =
    include!("../../../tests/oracles/data/arm_motion.in");
/// x of the walls [m].
const WALL_X: f64 = 0.37;

/// Largest deviations from MuJoCo: of any joint [rad], of the hand [m], of the wall's force [N].
#[derive(Debug, Default)]
struct Worst {
    joint: f64,
    hand: f64,
    force: f64,
}

fn run(case: &Case, step: f64) -> Worst {
    let (stiffness, damping, _) = &MOTIONS;
    let &(_, wall, rows) = case;
    let mut plant = Arm::exact().posture(rows[0].2).step(step).build();
    if let Some((stiffness, damping)) = wall {
        let (point, normal) = ([WALL_X, 0.0, 0.0], [-1.0, 0.0, 0.0]);
        plant.insert_wall(Wall { point, normal, stiffness, damping, friction: 0.0 }).unwrap();
    }
    let (mut worst, mut before) = (Worst::default(), None);
    for (feedforward, reference, expected, place, [pressed]) in rows {
        let (at, end) = (plant.truth().positions, hand(&plant));
        worst.joint = worst.joint.max(largest((0..JOINTS).map(|joint| at[joint] - expected[joint])));
        let off = (0..3).map(|i| (end.position[i] - place[i]).powi(2)).sum::<f64>().sqrt();
        worst.hand = worst.hand.max(off);
        worst.force = worst.force.max((end.wall_force[0] - pressed).abs());
        let error: Joints = core::array::from_fn(|joint| reference[joint] - at[joint]);
        let rate: Joints =
            core::array::from_fn(|joint| (error[joint] - before.unwrap_or(error)[joint]) / 0.01);
        before = Some(error);
        let torque = |joint: usize| {
            let of = |matrix: &[Joints; JOINTS], by: &Joints| -> f64 {
                matrix[joint].iter().zip(by).map(|(gain, by)| gain * by).sum()
            };
            (feedforward[joint] + of(stiffness, &error) + of(damping, &rate)) as f32
        };
        plant.apply(&frame_of(&core::array::from_fn::<f32, JOINTS, _>(torque))).unwrap();
    }
    worst
}

/// The hand moves back by 3 cm, follows ±0.1 m at 0.5 Hz, stays in place while the elbow swings by 30°, and
/// hits walls of 50 kN/m and 200 N/m. The force is a mean over a control period, including that of the
/// impact.
#[test]
fn the_arm_moves_as_in_mujoco() {
    let bounds = [
        ("release", 1e-4, 1e-5, 0.0),
        ("follow", 5e-5, 6e-6, 0.0),
        ("elbow", 1.5e-4, 4e-5, 0.0),
        ("stiff wall", 5e-5, 1e-5, 1.2),
        ("soft wall", 1e-5, 3e-6, 0.05),
    ];
    for (case, (name, joint, hand, force)) in MOTIONS.2.iter().zip(bounds) {
        assert_eq!(case.0, name);
        let worst = run(case, 0.0005);
        assert!(worst.joint < joint && worst.hand < hand && worst.force <= force, "{name}: {worst:?}");
    }
}

/// A smaller sub-step reduces the error.
#[test]
fn the_error_of_the_arm_falls_with_the_step() {
    let elbow = &MOTIONS.2[2];
    let (coarse, fine) = (run(elbow, 0.001), run(elbow, 0.00025));
    assert!(fine.hand < 0.3 * coarse.hand, "{coarse:?} {fine:?}");
}
