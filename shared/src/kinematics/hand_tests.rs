use super::*;
use tesaki_rng::Rng;

use crate::kinematics::tests::chain_of;
use crate::kinematics::{FingertipTarget, FingertipTargets, HandOptions};
use crate::model::Coupling;
use crate::test_support::{HAND5_LIMITS, hand5};

type Posture5 = ([f64; 16], [[f64; 3]; 5]);
type Frame5 = ([[f64; 3]; 5], [f64; 5], f64);

/// Postures and minima from an independent model (`tests/oracles/hand5_retarget.py`).
const ORACLE: (&[Posture5], &[Frame5]) = include!("../../../tests/oracles/data/hand5_retarget.in");

fn between(rng: &mut Rng, lower: f32, upper: f32) -> f32 {
    lower + (upper - lower) * rng.uniform() as f32
}

fn random_angles(rng: &mut Rng) -> Angles {
    let mut angles = Angles::zeros();
    for (angle, (lower, upper)) in angles.iter_mut().zip(HAND5_LIMITS) {
        *angle = between(rng, lower, upper);
    }
    angles
}

/// The tips of `fingers` at `angles` as targets.
fn targets(hand: &Hand, angles: &Angles, fingers: &[usize]) -> FingertipTargets {
    core::array::from_fn(|finger| {
        let (position, _) = hand.tip(finger, angles).filter(|_| fingers.contains(&finger))?;
        Some(FingertipTarget { position, weight: 1.0, direction: None })
    })
}

fn within_limits(hand: &Hand, angles: &Angles) -> bool {
    angles.iter().zip(hand.limits()).all(|(angle, (lower, upper))| lower <= angle && angle <= upper)
}

#[test]
fn the_tips_are_where_an_independent_model_has_them() {
    let hand = hand5();
    for (angles, tips) in ORACLE.0 {
        let angles = Angles::from(angles.map(|angle| angle as f32));
        for (finger, expected) in tips.iter().enumerate() {
            let (tip, _) = hand.tip(finger, &angles).unwrap();
            assert!((tip - Vector3::from(expected.map(|x| x as f32))).norm() < 1e-7, "{finger}: {tip}");
        }
    }
}

#[test]
fn every_finger_reaches_what_it_can_reach() {
    // For 100 000 targets per finger see `examples/hand_speed.rs`.
    let hand = hand5();
    let mut rng = Rng::new(21, 0);
    for round in 0..4000 {
        let goal = random_angles(&mut rng);
        for finger in 0..5 {
            let mut angles = hand.center();
            let report = hand.search(&targets(&hand, &goal, &[finger]), &HandOptions::default(), &mut angles);
            let (tip, _) = hand.tip(finger, &angles).unwrap();
            let error = (tip - hand.tip(finger, &goal).unwrap().0).norm();
            assert!(error < 5e-5 && within_limits(&hand, &angles), "{round} {finger}: {error} {report:?}");
        }
    }
}

#[test]
fn a_thumb_in_a_corner_of_its_range_is_found_from_the_middle() {
    // Most starts lead to a local minimum 0.1 mm beside it.
    let hand = hand5();
    let mut goal = hand.center();
    for (angle, corner) in
        goal.iter_mut().zip([-0.092_530_414, 1.044_545_3, 0.344_052_4, -0.091_459_595, -0.196_044_55])
    {
        *angle = corner;
    }
    let mut angles = hand.center();
    let report = hand.search(&targets(&hand, &goal, &[0]), &HandOptions::default(), &mut angles);
    let error = (hand.tip(0, &angles).unwrap().0 - hand.tip(0, &goal).unwrap().0).norm();
    assert!(error < 5e-5 && within_limits(&hand, &angles), "{error} {report:?}");
}

#[test]
fn a_search_that_begins_near_takes_few_steps() {
    // As `tests/oracles/peers_thumb.py`: each joint within 0.1 rad of a posture that reaches the target.
    let hand = hand5();
    let mut rng = Rng::new(26, 0);
    let mut evaluations = 0;
    for round in 0..2000 {
        let goal = random_angles(&mut rng);
        let mut angles = goal;
        angles.iter_mut().for_each(|angle| *angle += between(&mut rng, -0.1, 0.1));
        let report = hand.search(&targets(&hand, &goal, &[0]), &HandOptions::default(), &mut angles);
        let error = (hand.tip(0, &angles).unwrap().0 - hand.tip(0, &goal).unwrap().0).norm();
        assert!(error < 5e-5 && within_limits(&hand, &angles), "{round}: {error} {report:?}");
        evaluations += u32::from(report.evaluations);
    }
    // 3.4 on average; 5.2 if the joints move to the middle of their ranges.
    assert!(evaluations < 2000 * 4, "{evaluations}");
}

#[test]
fn the_whole_hand_reaches_tips_of_one_posture() {
    let hand = hand5();
    let mut rng = Rng::new(22, 0);
    for round in 0..4000 {
        let goal = random_angles(&mut rng);
        let mut angles = hand.center();
        hand.search(&targets(&hand, &goal, &[0, 1, 2, 3, 4]), &HandOptions::default(), &mut angles);
        for finger in 0..5 {
            let error = (hand.tip(finger, &angles).unwrap().0 - hand.tip(finger, &goal).unwrap().0).norm();
            assert!(error < 5e-5, "{round}: finger {finger} is {error} m off");
        }
    }
}

#[test]
fn tips_that_cannot_be_reached_together_are_missed_by_the_least() {
    let hand = hand5();
    let mut worst = 1.0_f64;
    for (number, (positions, weights, least)) in ORACLE.1.iter().enumerate() {
        let mut targets = FingertipTargets::default();
        for ((target, position), weight) in targets.iter_mut().zip(positions).zip(weights) {
            let position = Vector3::from(position.map(|x| x as f32));
            *target = Some(FingertipTarget { position, weight: *weight as f32, direction: None });
        }
        let mut angles = hand.center();
        let report = hand.search(&targets, &HandOptions::default(), &mut angles);
        // Computed from the angles, not as reported.
        let errors = targets.iter().enumerate().map(|(finger, target)| {
            let target = target.unwrap();
            f64::from(target.weight)
                * f64::from((hand.tip(finger, &angles).unwrap().0 - target.position).norm_squared())
        });
        let sum: f64 = errors.sum();
        assert!((sum - f64::from(report.weighted)).abs() < 1e-4 * sum, "{sum} {report:?}");
        assert!(within_limits(&hand, &angles));
        worst = worst.max(sum / least);
        assert!(sum > 0.999 * least, "frame {number}: better than the global search: {sum} {least}");
        assert!(sum < 1.01 * least, "frame {number}: {sum}, {least} possible");
    }
    assert!(worst < 1.01, "{worst}");
}

#[test]
fn directions_are_followed_where_positions_leave_them_free() {
    let hand = hand5();
    let mut rng = Rng::new(23, 0);
    for finger in 0..3 {
        let mut followed = 0;
        for _ in 0..500 {
            let goal = random_angles(&mut rng);
            let mut both = targets(&hand, &goal, &[finger]);
            let (place, direction) = hand.tip(finger, &goal).unwrap();
            both[finger].as_mut().unwrap().direction = Some(direction);
            let mut angles = hand.center();
            let options = HandOptions { restarts: 200, ..HandOptions::default() };
            hand.search(&both, &options, &mut angles);
            let (tip, pointing) = hand.tip(finger, &angles).unwrap();
            assert!((tip - place).norm() < 5e-5, "{finger}: {}", (tip - place).norm());
            followed += u32::from((pointing - direction).norm() < 0.5_f32.to_radians());
        }
        assert_eq!(followed, 500, "finger {finger}");
    }
    // A direction that cannot be reached does not move the tip.
    let goal = hand.center();
    let mut both = targets(&hand, &goal, &[0, 1, 2, 3, 4]);
    both.iter_mut().flatten().for_each(|target| target.direction = Some(-Vector3::z()));
    let mut angles = goal;
    hand.search(&both, &HandOptions::default(), &mut angles);
    for finger in 0..5 {
        let away = hand.tip(finger, &angles).unwrap().0 - hand.tip(finger, &goal).unwrap().0;
        assert!(away.norm() < 5e-5, "{finger}: {}", away.norm());
    }
}

#[test]
fn joints_that_follow_a_joint_of_their_own_finger_count_in_the_solution() {
    // As in tests/robots/inspire_right.urdf: yaw, pitch, and two joints that follow the pitch. The limits of
    // the mimic joints restrict the pitch to half a radian.
    let follow = |multiplier| Coupling { actuated: 1, multiplier, offset: 0.0 };
    let finger = FingerDescription {
        chain: chain_of("inspire_thumb"),
        couplings: &[Coupling::direct(0), Coupling::direct(1), follow(1.6), follow(2.4)],
        limits: &[None, None, Some((0.0, 0.8)), Some((0.0, 1.2))],
        pointing: [0.0, 0.0, 1.0],
    };
    let hand = Hand::try_new([finger], &[(-0.1, 1.3), (0.0, 0.6)]).unwrap();
    assert_eq!(hand.limits(), [(-0.1, 1.3), (0.0, 0.5)]);
    let chain = chain_of("inspire_thumb");
    let mut rng = Rng::new(24, 0);
    for _ in 0..300 {
        let (yaw, pitch) = (between(&mut rng, -0.1, 1.3), between(&mut rng, 0.0, 0.5));
        let place = chain.posture(&[yaw, pitch, 1.6 * pitch, 2.4 * pitch]).tip().translation.vector;
        let mut targets = FingertipTargets::default();
        targets[0] = Some(FingertipTarget { position: place, weight: 1.0, direction: None });
        let mut angles = hand.center();
        let report = hand.search(&targets, &HandOptions::default(), &mut angles);
        assert!(report.distance(0) < 5e-5, "{report:?}");
        assert!((angles[0] - yaw).abs() < 2e-3 && (angles[1] - pitch).abs() < 2e-3, "{angles}");
    }
}

#[test]
fn the_hand_of_a_model_stays_inside_its_limits() {
    let mut model = crate::test_support::finger();
    for joint in &mut model.joints {
        (joint.limits.lower, joint.limits.upper) = (-0.5, 0.7);
    }
    (model.joints[1].limits.lower, model.joints[1].limits.upper) = (0.1, 0.108);
    let hand = Hand::of_model(&model, [0.0, 0.0, 1.0], 0.005).unwrap();
    // The middle half of a range of 8 mrad.
    for ((lower, upper), expected) in hand.limits().iter().zip([(-0.495, 0.695), (0.102, 0.106)]) {
        assert!((lower - expected.0).abs() < 1e-6 && (upper - expected.1).abs() < 1e-6, "{lower} {upper}");
    }
}

#[test]
fn what_makes_no_hand_or_no_target_is_refused() {
    let finger = |couplings| FingerDescription {
        chain: chain_of("hand3_finger1"),
        couplings,
        limits: &[None; 3],
        pointing: [0.0, 0.0, 1.0],
    };
    let own = [0, 1, 2].map(Coupling::direct);
    let limits = [(-1.0, 1.0); 4];
    let refused = |finger, limits: &[(f32, f32)]| Hand::try_new([finger], limits).unwrap_err();
    assert_eq!(refused(finger(&own[..2]), &limits), InvalidHand::Couplings { finger: 0 });
    assert_eq!(refused(finger(&own), &limits[..2]), InvalidHand::Coupling { finger: 0, joint: 2 });
    assert_eq!(refused(finger(&own), &[(1.0, -1.0); 3]), InvalidHand::Limits { joint: 0 });
    let mut none = own;
    none[1].multiplier = 0.0;
    assert_eq!(refused(finger(&none), &limits), InvalidHand::Coupling { finger: 0, joint: 1 });
    let narrow = FingerDescription { limits: &[None, Some((2.0, 3.0)), None], ..finger(&own) };
    assert_eq!(refused(narrow, &limits), InvalidHand::CoupledLimits { finger: 0, joint: 1 });
    let two = Hand::try_new([finger(&own), finger(&own)], &limits).unwrap_err();
    assert_eq!(two, InvalidHand::Shared { joint: 1 });
    assert_eq!(Hand::try_new([], &limits).unwrap_err(), InvalidHand::Fingers);
    let blunt = FingerDescription { pointing: [f32::NAN, 0.0, 0.0], ..finger(&own) };
    assert_eq!(refused(blunt, &limits), InvalidHand::Pointing { finger: 0 });

    let hand = hand5();
    let mut bad = targets(&hand, &hand.center(), &[0, 1]);
    bad[1].as_mut().unwrap().position.x = f32::NAN;
    let mut angles = hand.center();
    let report = hand.search(&bad, &HandOptions::default(), &mut angles);
    assert!(report.weighted.is_nan() && angles == hand.center());
}
