//! A grasped box compared with MuJoCo, and with Coulomb's law where it slides.

use rapier3d::na::{Quaternion, UnitQuaternion};

use crate::grip::Grip;
use crate::hand::{JOINTS, frame, largest};
use crate::pinch::Pinch;
use tesaki_sim::plant::{ObjectTruth, Push};

/// Position and orientation of the box at the start of a control period.
type Pose = ([f64; 3], [f64; 4]);
/// Name, squeeze, height of the box above the tips; force, point, start, ramp and hold of a push; poses.
type PinchCase = (&'static str, f64, f64, [f64; 3], [f64; 3], f64, f64, f64, &'static [Pose]);
/// Feed-forward torque and reference of the joints, pose of the box, positions of the joints.
type HandRow = ([f64; JOINTS], [f64; JOINTS], [f64; 3], [f64; 4], [f64; JOINTS]);
/// From `tests/oracles/contact_sliding.py`.
const SLIDING: &[PinchCase] = include!("../../../tests/oracles/data/contact_sliding.in");
/// From `tests/oracles/contact_motion.py`.
const SWING: &[PinchCase] = include!("../../../tests/oracles/data/contact_pinch.in");
/// Stiffness, viscous friction, rows.
const HAND: (f64, f64, &[HandRow]) = include!("../../../tests/oracles/data/contact_hand.in");
const FRICTION: f64 = 0.6;

/// Largest deviation of position [m] and orientation [rad].
#[derive(Debug, Default)]
struct Worst {
    distance: f64,
    turn: f64,
}

impl Worst {
    fn compare(&mut self, got: &ObjectTruth, position: &[f64; 3], orientation: &[f64; 4]) {
        let off = (0..3).map(|i| (got.position[i] - position[i]).powi(2)).sum::<f64>().sqrt();
        let unit = |[x, y, z, w]: [f64; 4]| UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        self.distance = self.distance.max(off);
        self.turn = self.turn.max(unit(got.orientation).angle_to(&unit(*orientation)));
    }
}

fn pinch(case: &PinchCase, step: f64) -> Worst {
    let &(_, squeeze, above, force, point, begin, ramp, hold, rows) = case;
    let mut rig = Pinch::shifted(FRICTION, above, step);
    let mut worst = Worst::default();
    for (period, (position, orientation)) in rows.iter().enumerate() {
        if (period as f64 * 0.01 - begin).abs() < 1e-9 {
            rig.plant.push(Push { force, point, ramp, hold }).unwrap();
        }
        worst.compare(&rig.plant.object().unwrap(), position, orientation);
        rig.squeeze(squeeze, 1);
    }
    worst
}

/// Returns the deviation of the box, and the largest deviation of any joint [rad].
fn hand(step: f64) -> (Worst, f64) {
    let (stiffness, viscous, rows) = HAND;
    let mut rig = Grip::viscous(FRICTION, viscous, step);
    let (mut worst, mut joints) = (Worst::default(), 0.0);
    for (forward, reference, position, orientation, expected) in rows {
        let got = rig.plant.truth().positions;
        worst.compare(&rig.plant.object().unwrap(), position, orientation);
        joints = f64::max(joints, largest((0..JOINTS).map(|joint| got[joint] - expected[joint])));
        let torque = |joint: usize| forward[joint] + stiffness * (reference[joint] - got[joint]);
        rig.plant.apply(&frame(core::array::from_fn(|joint| torque(joint) as f32))).unwrap();
    }
    (worst, joints)
}

/// Bounds at 1 ms: position [m] and orientation [rad] while the box moves by 6.9, 1.9 and 3.3 mm, and turns
/// by 0.17 rad. Before it slides, it has sunk by 2 µm into the grip.
#[test]
fn a_pushed_box_slides_as_coulomb_says() {
    let bounds = [("slides", 1e-5, 1e-6), ("slides askew", 1e-5, 3e-4), ("slides and turns", 1e-5, 4e-4)];
    for (case, (name, distance, turn)) in SLIDING.iter().zip(bounds) {
        assert_eq!(case.0, name);
        let worst = pinch(case, 0.001);
        assert!(worst.distance < distance && worst.turn < turn, "{name}: {worst:?}");
    }
}

/// The box swings to 0.75 rad.
#[test]
fn a_pinched_box_swings_as_in_mujoco() {
    let [case] = SWING else { panic!() };
    let (coarse, fine) = (pinch(case, 0.001), pinch(case, 0.00025));
    assert!(coarse.distance < 8e-5 && coarse.turn < 1.5e-3, "{coarse:?}");
    assert!(fine.distance < 0.4 * coarse.distance, "{fine:?} {coarse:?}");
}

/// The box moves by 6.4 mm and turns by 0.13 rad; the tips roll on it.
#[test]
fn the_hand_moves_a_box_as_in_mujoco() {
    let (worst, joints) = hand(0.001);
    assert!(worst.distance < 1e-5 && worst.turn < 1e-4 && joints < 1e-4, "{worst:?} {joints:e}");
}
