use crate::hand::{Hand, JOINTS, frame, largest};

/// Feed-forward torque, reference and MuJoCo's position at the start of a control period.
type Row = ([f64; JOINTS], [f64; JOINTS], [f64; JOINTS]);
/// Name, gravity, viscous friction, stiffness, rows.
type Case = (&'static str, [f64; 3], f64, f64, &'static [Row]);
/// From `tests/oracles/plant_motion.py`.
const MOTIONS: &[Case] = include!("../../../tests/oracles/data/plant_motion.in");

/// Returns the largest deviation of the plant's positions from MuJoCo in a motion [rad].
fn distance(case: &Case, step: f64) -> f64 {
    let &(_, gravity, viscous, stiffness, rows) = case;
    let mut hand = Hand::exact().viscous(viscous).coulomb(0.0);
    hand.values.gravity = gravity;
    hand.values.integration.step = step;
    let mut plant = hand.build();
    let mut worst = 0.0;
    for (feedforward, reference, expected) in rows {
        let position = plant.truth().positions;
        worst = f64::max(worst, largest(position.iter().zip(expected).map(|(got, expected)| got - expected)));
        let torque = |joint: usize| feedforward[joint] + stiffness * (reference[joint] - position[joint]);
        plant.apply(&frame(core::array::from_fn(|joint| torque(joint) as f32))).unwrap();
    }
    worst
}

/// All nine joints move by 0.3 rad in 1 s, without gravity and friction (free) or with gravity and viscous
/// friction (servo), or by 0.8 rad in 0.4 s (fast).
#[test]
fn motions_agree_with_mujoco() {
    let bounds = [("free", 0.06e-3), ("servo", 0.01e-3), ("fast", 0.1e-3)];
    for (case, (name, bound)) in MOTIONS.iter().zip(bounds) {
        assert_eq!(case.0, name);
        let distance = distance(case, 0.001);
        assert!(distance < bound, "{name}: {:.4} mrad", 1e3 * distance);
    }
}

/// A smaller sub-step reduces the error.
#[test]
fn the_error_falls_with_the_step() {
    let fast = &MOTIONS[2];
    let (coarse, fine) = (distance(fast, 0.001), distance(fast, 0.00025));
    assert!(fine < 0.4 * coarse, "{coarse:e} {fine:e}");
}

/// Dimensions [m].
const L1: f64 = 0.039;
const L2: f64 = 0.046;
const L3: f64 = 0.05178;

/// Computes the position of a fingertip by the formulae of the paper, in the frame of the palm.
pub fn tip(finger: usize, [q1, q2, q3]: [f64; 3]) -> [f64; 3] {
    let r = L2 * q2.sin() + L3 * (q2 + q3).sin();
    let z = L1 + L2 * q2.cos() + L3 * (q2 + q3).cos();
    let (x, y) = (r * q1.cos(), r * q1.sin());
    match finger {
        0 => [x, 0.040 + y, 0.0375 + z],
        1 => [x, -0.040 + y, 0.0375 + z],
        _ => [0.025 + z, -y, 0.020 + x],
    }
}

/// Returns the position of a fingertip of the plant.
fn plant_tip(plant: &tesaki_sim::plant::Plant, finger: usize) -> [f64; 3] {
    let (place, [x, y, z, w]) = plant.link_pose(3 * finger + 2).unwrap();
    let axis = [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)];
    core::array::from_fn(|i| place[i] + L3 * axis[i])
}

#[test]
fn fingertips_are_where_the_formulae_say() {
    let mut hand = Hand::exact();
    for posture in [[0.0; 3], [0.4, -0.5, 1.2], [-0.9, 1.1, 0.3]] {
        hand.options.posture = Some(posture.repeat(3));
        let plant = hand.build();
        for finger in 0..3 {
            let (got, expected) = (plant_tip(&plant, finger), tip(finger, posture));
            assert!(largest((0..3).map(|i| got[i] - expected[i])) < 1e-7, "{finger}: {got:?} {expected:?}");
        }
    }
}

/// Pitch of the line from the middle of tips 1 and 2 to tip 3, and x of the tips' centroid.
#[test]
fn the_initial_posture_has_the_papers_numbers() {
    let plant = Hand::exact().build();
    let [one, two, three] = [0, 1, 2].map(|finger| plant_tip(&plant, finger));
    let middle: [f64; 3] = core::array::from_fn(|i| (one[i] + two[i]) / 2.0);
    let pitch = (middle[2] - three[2]).atan2(three[0] - middle[0]);
    assert!((pitch - 0.759).abs() < 0.0005, "{pitch}");
    let centroid = (one[0] + two[0] + three[0]) / 3.0;
    assert!((0.080..0.086).contains(&centroid), "{centroid}");
}

/// Every inertia in the URDF is that of the corresponding solid.
#[test]
fn inertias_are_those_of_the_solids() {
    let mut links = 0;
    for link in Hand::exact().urdf.robot.links.iter().filter(|link| link.inertial.mass.value > 0.0) {
        let (mass, inertia) = (link.inertial.mass.value, &link.inertial.inertia);
        let (across, along) = match link.visual[0].geometry {
            urdf_rs::Geometry::Cylinder { radius, length } => {
                (mass * (3.0 * radius * radius + length * length) / 12.0, mass * radius * radius / 2.0)
            }
            urdf_rs::Geometry::Sphere { radius } => {
                (0.4 * mass * radius * radius, 0.4 * mass * radius * radius)
            }
            ref other => panic!("{}: {other:?}", link.name),
        };
        for (got, expected) in [(inertia.ixx, across), (inertia.iyy, across), (inertia.izz, along)] {
            assert!((got - expected).abs() < 1e-3 * expected, "{}: {got:e}, not {expected:e}", link.name);
        }
        links += 1;
    }
    assert_eq!(links, 12);
}
