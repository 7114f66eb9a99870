use proptest::prelude::*;

use super::*;
use crate::model::{JointModel, Pose};
use crate::test_support::joint as test_joint;

const FREE: [(f32, f32); 3] = [(-PI, PI); 3];

/// Joints with these origins and axes, and the tip.
fn chain(joints: [([f32; 3], [f32; 3]); 3], tip: [f32; 3]) -> Chain {
    let joints = joints.map(|(translation, axis)| JointModel {
        origin: Pose { translation, ..Pose::IDENTITY },
        axis,
        ..test_joint("joint")
    });
    Chain::new(&joints, &Pose { translation: tip, ..Pose::IDENTITY })
}

/// Finger 1 of the three-finger hand (Hand3, figure 3), in its root's frame.
fn hand3() -> Chain {
    chain(
        [
            ([0.0; 3], [0.0, 0.0, 1.0]),
            ([0.0, 0.0, 0.039], [0.0, 1.0, 0.0]),
            ([0.0, 0.0, 0.046], [0.0, 1.0, 0.0]),
        ],
        [0.0, 0.0, 0.05178],
    )
}

fn finger(chain: &Chain, limits: [(f32, f32); 3]) -> Finger {
    Finger::try_new(chain, limits).unwrap()
}

fn close(a: &[f32; 3], b: &[f32; 3], tolerance: f32) -> bool {
    a.iter().zip(b).all(|(a, b)| abs(a - b) <= tolerance)
}

#[test]
fn the_papers_finger_by_hand() {
    // q = (30°, 20°, 40°): r = 46 sin 20° + 51.78 sin 60° = 60.5756 mm, z = 39 + 46 cos 20° + 51.78 cos 60° =
    // 108.1159.
    let point = Vector3::new(0.052_460_0, 0.030_287_8, 0.108_115_9);
    let finger = finger(&hand3(), FREE);
    let [swing, bend, curl] = [30.0_f32, 20.0, 40.0].map(f32::to_radians);
    // The other flexion branch on the same side: d = √(60.5756² + 69.1159²) = 91.9044, α = 48.7675°, so the
    // first link stands 90° − α + (90° − α − 20°) = 62.4651° off z, and the second bends back by 40°.
    let (other, back) = (62.465_07_f32.to_radians(), -40.0_f32.to_radians());
    let expected =
        [[swing, bend, curl], [swing, other, back], [swing - PI, -other, -back], [swing - PI, -bend, -curl]];
    let near = [swing, bend, curl];
    let found = finger.inverse(&point, &near).unwrap();
    assert_eq!(found.len(), 4);
    for expected in &expected {
        assert!(found.iter().any(|angles| close(angles, expected, 2e-5)), "{expected:?} not in {found:?}");
    }
    assert!(close(&found[0], &near, 2e-5));
    assert!(close(&finger.nearest(&point, &expected[2]).unwrap(), &expected[2], 2e-5));
}

#[test]
fn limits_choose_the_branch_and_name_the_joint() {
    let chain = hand3();
    let point = chain.posture(&[0.2, 0.5, 0.8]).tip.translation.vector;
    let curls = finger(&chain, [(-1.0, 1.0), (-1.2, 1.7), (0.0, 2.4)]);
    let found = curls.inverse(&point, &[0.0, 1.5, -0.8]).unwrap();
    assert!(found.len() == 1 && close(&found[0], &[0.2, 0.5, 0.8], 1e-5), "{found:?}");
    let backwards = finger(&chain, [(-1.0, 1.0), (-1.2, 1.7), (-2.4, 0.0)]);
    assert!(close(&backwards.nearest(&point, &[0.0; 3]).unwrap(), &[0.2, 1.349_97, -0.8], 1e-3));
    let narrow = finger(&chain, [(-1.0, 1.0), (-1.2, 0.4), (0.0, 2.4)]);
    let Err(FingerError::OutsideLimits { joint, value, lower, upper }) =
        narrow.nearest(&point, &[0.2, 0.4, 0.8])
    else {
        panic!()
    };
    assert!(abs(value - 0.5) < 1e-5, "{value} of {joint}");
    assert_eq!((joint, lower, upper), (1, -1.2, 0.4));
}

#[test]
fn what_is_out_of_reach_has_a_nearest_place() {
    let finger = finger(&hand3(), FREE);
    let error = |x, y, z| finger.nearest(&Vector3::new(x, y, z), &[0.0; 3]).unwrap_err();
    // Straight out at the height of the second joint: 46 + 51.78 = 97.78 mm.
    let FingerError::OutOfReach { nearest } = error(0.0, -0.2, 0.039) else { panic!() };
    assert!((nearest - Vector3::new(0.0, -0.097_78, 0.039)).norm() < 1e-7, "{nearest}");
    // Nearer to the second joint than the difference of the links, 5.78 mm.
    let FingerError::OutOfReach { nearest } = error(0.001, 0.0, 0.039) else { panic!() };
    assert!((nearest - Vector3::new(0.005_78, 0.0, 0.039)).norm() < 1e-7, "{nearest}");
    assert_eq!(error(f32::NAN, 0.0, 0.0), FingerError::NotFinite);
    assert_eq!(error(0.0, f32::INFINITY, 0.0), FingerError::NotFinite);
}

#[test]
fn the_straight_finger_and_its_axis_are_within_reach() {
    let chain = hand3();
    let finger = finger(&chain, FREE);
    let up = Vector3::new(0.0, 0.0, 0.136_78);
    let found = finger.nearest(&up, &[0.7, 0.1, 0.1]).unwrap();
    assert!(close(&found, &[0.7, 0.0, 0.0], 1e-3), "{found:?}");
    let on_axis = chain.posture(&[-0.4, -0.5, 0.939_966]).tip.translation.vector;
    assert!(on_axis.xy().norm() < 2e-5);
    let found = finger.nearest(&Vector3::new(0.0, 0.0, on_axis.z), &[-0.4, -0.5, 0.9]).unwrap();
    assert!(close(&found, &[-0.4, -0.5, 0.939_966], 1e-3), "{found:?}");
}

#[test]
fn where_the_finger_is_need_not_be_within_its_limits() {
    let chain = hand3();
    let finger = finger(&chain, [(-1.0, 1.0), (-1.2, 1.7), (-0.1, 2.4)]);
    let point = chain.posture(&[0.2, 0.5, 0.8]).tip.translation.vector;
    for near in [[1.000_02, 0.5, 0.8], [10.0, 0.0, 0.0], [0.0, 30.0, -7.0]] {
        assert!(close(&finger.nearest(&point, &near).unwrap(), &[0.2, 0.5, 0.8], 1e-5), "{near:?}");
    }
    assert_eq!(finger.nearest(&point, &[f32::NAN, 0.0, 0.0]), Err(FingerError::NotFinite));
    // On its axis any angle of the first joint is a solution, so its limit does not matter.
    let on_axis = Vector3::new(0.0, 0.0, 0.1);
    let found = finger.inverse(&on_axis, &[1.000_02, -0.5, 0.9]).unwrap();
    assert!(found.iter().all(|angles| abs(angles[0] - 1.0) < 1e-9), "{found:?}");
    assert_eq!(Finger::try_new(&chain, [(1.0, -1.0); 3]).unwrap_err(), FingerShapeError::Limits);
}

#[test]
fn nearly_equal_links_do_not_reach_where_they_fold() {
    let z = [0.0, 0.0, 1.0];
    let y = [0.0, 1.0, 0.0];
    let chain = chain([([0.0; 3], z), ([0.0; 3], y), ([0.0, 0.0, 0.500_4], y)], [0.0, 0.0, 0.499_6]);
    let Err(FingerError::OutOfReach { nearest }) =
        finger(&chain, FREE).nearest(&Vector3::new(0.0, 0.0, 1e-5), &[0.0, 0.0, 3.0])
    else {
        panic!()
    };
    assert!((nearest - Vector3::new(0.0, 0.0, 8e-4)).norm() < 1e-6, "{nearest}");
}

#[test]
fn other_shapes_are_told_what_is_wrong_with_them() {
    let z = [0.0, 0.0, 1.0];
    let y = [0.0, 1.0, 0.0];
    let up = [0.0, 0.0, 0.04];
    let refused = |joints, tip| Finger::try_new(&chain(joints, tip), FREE).unwrap_err();
    assert_eq!(refused([(up, z), (up, [0.0, 0.6, 0.8]), (up, y)], up), FingerShapeError::NotAcross);
    assert_eq!(refused([(up, z), (up, y), (up, [1.0, 0.0, 0.0])], up), FingerShapeError::NotParallel);
    assert_eq!(refused([(up, z), (up, y), (up, y)], [0.0, 0.001, 0.04]), FingerShapeError::NotPlanar);
    assert_eq!(refused([(up, z), ([0.0, 0.01, 0.0], y), (up, y)], up), FingerShapeError::NotPlanar);
    assert_eq!(refused([(up, z), (up, y), ([0.0; 3], y)], up), FingerShapeError::NoLength);
    let short = Chain::new(&[test_joint("joint")], &Pose::IDENTITY);
    assert_eq!(Finger::try_new(&short, FREE).unwrap_err(), FingerShapeError::Joints(1));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(4000))]

    /// For any shape with a closed form, of any size, frames, zero angles and directions, and any point
    /// within reach: the angles that generated the point are among the solutions, and every solution leads to
    /// the point.
    #[test]
    fn forward_and_inverse_belong_together(
        size in 0.01_f32..2.0,
        height in -0.5_f32..1.0,
        offset in prop_oneof![Just(0.0), -0.4_f32..0.4],
        links in [[-1.0_f32..1.0, -1.0_f32..1.0], [-1.0_f32..1.0, -1.0_f32..1.0]],
        (reversed, opposed) in (any::<bool>(), any::<bool>()),
        q in [-3.1_f32..3.1, -3.1_f32..3.1, -3.1_f32..3.1],
        near in [-3.1_f32..3.1, -3.1_f32..3.1, -3.1_f32..3.1],
    ) {
        let [first, second] = links.map(|[x, z]| [size * x, 0.0, size * z]);
        prop_assume!(links.iter().all(|[x, z]| x * x + z * z > 0.04));
        let across = |reversed: bool| [0.0, if reversed { -1.0 } else { 1.0 }, 0.0];
        let chain = chain(
            [
                ([size, -0.3 * size, 0.2], [0.0, 0.0, 1.0]),
                ([offset * size, 0.0, height * size], across(reversed)),
                (first, across(reversed ^ opposed)),
            ],
            second,
        );
        let finger = finger(&chain, FREE);
        let tip = |q: &[f32]| chain.posture(q).tip.translation.vector;
        let point = tip(&q);
        let found = finger.inverse(&point, &near).unwrap();
        for angles in &found {
            let miss = (tip(angles) - point).norm();
            // Some angles are just outside their limits.
            let tolerance = if angles.iter().any(|&angle| abs(angle) >= PI) { 4e-5 } else { 1e-5 };
            prop_assert!(miss < tolerance * size, "{miss} m at {angles:?}");
        }
        // Near the axis and the straight finger many angles lead to almost the same point.
        let radius = finger.root.inverse_transform_point(&Point3::from(point)).coords.xy().norm();
        let bent = q[2] * if opposed { -1.0 } else { 1.0 } + finger.bent;
        if radius > 0.05 * size && abs(libm::sinf(bent)) > 0.05 {
            prop_assert!(found.iter().any(|angles| close(angles, &q, 1e-3)), "{q:?} not in {found:?}");
            let nearest = finger.nearest(&point, &near).unwrap();
            let distance = |a: &[f32; 3]| a.iter().zip(&near).map(|(a, b)| (a - b) * (a - b)).sum::<f32>();
            let least = found.iter().map(distance).fold(f32::INFINITY, f32::min);
            prop_assert!(abs(distance(&nearest) - least) < 1e-3 * (1.0 + least), "{nearest:?} of {found:?}");
        }
    }
}
