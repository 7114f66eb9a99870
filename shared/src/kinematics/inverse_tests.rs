use super::*;
use tesaki_rng::Rng;

use crate::kinematics::tests::chain_of;

/// Random number from `lower` to `upper`.
fn between(rng: &mut Rng, lower: f32, upper: f32) -> f32 {
    lower + (upper - lower) * rng.uniform() as f32
}

/// Numbers of targets out of 1000 that are reached from a fixed start and from a start nearby. Checks each
/// solution.
fn reached(name: &str, limit: f32, position_only: bool, singular: &[usize]) -> (u32, u32) {
    let chain = chain_of(name);
    let limits = vec![(-limit, limit); chain.len()];
    let solver = InverseKinematics::try_new(&limits).unwrap();
    let mut rng = Rng::new(7, 0);
    let (mut fixed, mut near) = (0, 0);
    for _ in 0..1000 {
        let mut goal: std::vec::Vec<f32> =
            (0..chain.len()).map(|_| between(&mut rng, -limit, limit)).collect();
        singular.iter().for_each(|&joint| goal[joint] *= 0.003);
        let pose = *chain.posture(&goal).tip();
        let target =
            if position_only { Target::Position(pose.translation.vector) } else { Target::Pose(pose) };
        let beside: std::vec::Vec<f32> = goal.iter().map(|q| q + between(&mut rng, -0.1, 0.1)).collect();
        for (count, mut q) in [(&mut fixed, vec![0.3; chain.len()]), (&mut near, beside)] {
            if solver.solve(&chain, &target, &mut q).is_err() {
                continue;
            }
            *count += 1;
            assert!(q.iter().all(|angle| abs(*angle) <= limit));
            let tip = *chain.posture(&q).tip();
            assert!((tip.translation.vector - pose.translation.vector).norm() < 1.1e-5);
            assert!(position_only || (tip.rotation.matrix() - pose.rotation.matrix()).norm() < 2e-5);
        }
    }
    (fixed, near)
}

#[test]
fn reachable_targets_are_reached_also_near_singular_postures() {
    for (name, limit, position_only, singular) in [
        ("ur5e", 3.1, false, &[][..]),
        ("ur5e", 3.1, false, &[2, 4]),
        ("franka_panda", 2.8, false, &[]),
        ("kuka_iiwa14", 2.0, false, &[]),
        ("kinova_j2s6s200", 3.1, false, &[]),
        ("allegro_thumb", 1.2, true, &[]),
    ] {
        let (fixed, near) = reached(name, limit, position_only, singular);
        assert!(fixed >= 999 && near == 1000, "{name} {singular:?}: {fixed}, {near} of 1000");
    }
}

#[test]
fn mimic_joints_follow_their_joint() {
    // As in tests/robots/inspire_right.urdf: yaw, pitch, and two mimic joints of the pitch.
    let chain = chain_of("inspire_thumb");
    let solver = InverseKinematics::try_new(&[(-0.1, 1.3), (0.0, 0.6), (0.0, 0.8), (0.0, 1.2)]).unwrap();
    let solver = solver.with_mimic(2, 1, 1.6, 0.0).unwrap().with_mimic(3, 1, 2.4, 0.0).unwrap();
    // 0.8 / 1.6 = 1.2 / 2.4 = 0.5: the mimic joints restrict the range of the pitch.
    assert_eq!((solver.joints[1].lower, solver.joints[1].upper), (0.0, 0.5));
    let mut rng = Rng::new(3, 0);
    for _ in 0..300 {
        let mut goal = [0.0; MAX_CHAIN_JOINTS];
        for (angle, joint) in goal.iter_mut().zip(&solver.joints) {
            *angle = between(&mut rng, joint.lower, joint.upper);
        }
        solver.limit(&mut goal);
        let goal = &goal[..4];
        let target = Target::Position(chain.posture(goal).tip().translation.vector);
        let mut q = [0.1; 4];
        solver.solve(&chain, &target, &mut q).unwrap();
        assert!(abs(q[2] - 1.6 * q[1]) < 1e-6 && abs(q[3] - 2.4 * q[1]) < 1e-6, "{q:?}");
    }
}

#[test]
fn a_target_out_of_reach_ends_at_the_nearest_pose() {
    let chain = chain_of("allegro_index");
    let limits = [(-0.5, 0.5), (-0.2, 1.6), (-0.2, 1.7), (-0.2, 1.6)];
    let solver = InverseKinematics::try_new(&limits).unwrap();
    let far = Vector3::new(0.0, 0.0, 5.0);
    let mut q = [0.3; 4];
    let Err(InverseKinematicsError::NotReached(nearest)) =
        solver.solve(&chain, &Target::Position(far), &mut q)
    else {
        panic!()
    };
    let distance = |q: &[f32]| (chain.posture(q).tip().translation.vector - far).norm();
    assert!(abs(distance(&q) - nearest.position_error) < 1e-5);
    let mut rng = Rng::new(5, 0);
    let min = (0..20_000)
        .map(|_| distance(&limits.map(|(lower, upper)| between(&mut rng, lower, upper))))
        .fold(f32::INFINITY, f32::min);
    // The descent ends after a fixed number of iterations. For these samples the best random posture is 20 µm
    // nearer to the target, which is 5 m away.
    assert!(nearest.position_error < min + 1e-4, "{} {min}", nearest.position_error);
}

#[test]
fn a_target_that_was_reached_is_not_reported_as_missed() {
    let chain = chain_of("hand3_finger1");
    let options = SolverOptions { restarts: 0, ..SolverOptions::default() };
    let solver = InverseKinematics::try_new(&[(-1.0, 1.0), (-1.2, 1.7), (-0.1, 2.4)]).unwrap();
    for wrong in [-1e-5, f32::NAN, 2.0] {
        let refused = solver.clone().with_options(SolverOptions { position_tolerance: wrong, ..options });
        assert_eq!(refused.map_err(|error| error.field).err(), Some("position tolerance"));
    }
    let solver = solver.with_options(options).unwrap();
    let mut rng = Rng::new(11, 0);
    for _ in 0..1000 {
        let goal = [between(&mut rng, -1.0, 1.0), between(&mut rng, -1.2, 1.7), between(&mut rng, -0.1, 2.4)];
        let target = Target::Position(chain.posture(&goal).tip().translation.vector);
        let result = solver.solve(&chain, &target, &mut [0.0, 0.3, 1.0]);
        let Err(InverseKinematicsError::NotReached(nearest)) = result else { continue };
        assert!(nearest.position_error > options.position_tolerance, "{nearest:?}");
    }
    let nowhere = Target::Position(Vector3::new(1e19, 0.0, 0.0));
    assert_eq!(solver.solve(&chain, &nowhere, &mut [0.0; 3]), Err(InverseKinematicsError::NotFinite));
}

#[test]
fn invalid_input_is_refused_by_name() {
    let chain = chain_of("allegro_index");
    let refused = |limits: &[(f32, f32)]| InverseKinematics::try_new(limits).unwrap_err();
    assert_eq!(refused(&[(0.0, 1.0), (1.0, 0.0)]), InvalidJoint::Limits { joint: 1 });
    assert_eq!(refused(&[(f32::NAN, 1.0)]), InvalidJoint::Limits { joint: 0 });
    assert_eq!(refused(&[(0.0, 1.0); 8]), InvalidJoint::TooMany);
    let solver = InverseKinematics::try_new(&[(0.0, 1.0); 4]).unwrap();
    let mimic = |joint, of, multiplier| solver.clone().with_mimic(joint, of, multiplier, 0.0).unwrap_err();
    assert_eq!(mimic(1, 1, 1.0), InvalidJoint::Mimic { joint: 1 });
    assert_eq!(mimic(1, 9, 1.0), InvalidJoint::Mimic { joint: 1 });
    assert_eq!(mimic(1, 2, f32::NAN), InvalidJoint::Mimic { joint: 1 });
    let offset = solver.clone().with_mimic(3, 2, 1.0, 5.0).unwrap_err();
    assert_eq!(offset, InvalidJoint::MimicLimits { joint: 3 });
    assert_eq!(
        solver.clone().with_mimic(3, 2, 0.0, 5.0).unwrap_err(),
        InvalidJoint::MimicLimits { joint: 3 }
    );
    let twice = solver.clone().with_mimic(3, 2, 1.0, 0.0).unwrap();
    assert_eq!(twice.with_mimic(3, 1, 1.0, 0.0).unwrap_err(), InvalidJoint::Mimic { joint: 3 });
    let chained = solver.clone().with_mimic(3, 2, 1.0, 0.0).unwrap();
    assert_eq!(chained.with_mimic(2, 1, 1.0, 0.0).unwrap_err(), InvalidJoint::Mimic { joint: 2 });
    let nowhere = Target::Position(Vector3::new(f32::NAN, 0.0, 0.0));
    assert_eq!(solver.solve(&chain, &nowhere, &mut [0.0; 4]), Err(InverseKinematicsError::NotFinite));
    let here = Target::Position(Vector3::zeros());
    assert_eq!(solver.solve(&chain, &here, &mut [0.0; 3]), Err(InverseKinematicsError::Joints));
    assert_eq!(solver.solve(&chain, &here, &mut [f32::INFINITY; 4]), Err(InverseKinematicsError::NotFinite));
}
