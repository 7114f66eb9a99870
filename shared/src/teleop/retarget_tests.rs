use super::*;
use tesaki_rng::Rng;

use crate::kinematics::{Chain, FingerDescription};
use crate::model::{Coupling, Inertial, Pose};
use crate::teleop::RetargetField;
use crate::test_support::{HAND5_LIMITS, hand5};

const PERIOD: f32 = 0.01;

/// No speed limit.
const FREE: RetargetSettings = RetargetSettings { speeds: [1e3; MAX_JOINTS], ..RetargetSettings::DEFAULT };

fn retargeting(settings: RetargetSettings) -> Retargeting<'static> {
    let hand = Box::leak(Box::new(hand5()));
    settings.validate(hand).unwrap();
    Retargeting { hand, settings: Box::leak(Box::new(settings)) }
}

fn random_angles(rng: &mut Rng) -> Angles {
    let mut angles = Angles::zeros();
    for (angle, (lower, upper)) in angles.iter_mut().zip(HAND5_LIMITS) {
        *angle = lower + (upper - lower) * rng.uniform() as f32;
    }
    angles
}

/// An operator whose hand is the robot's, `size` times as large.
fn operator(angles: &Angles, size: f32) -> OperatorFingertips {
    let hand = hand5();
    let mut tips = OperatorFingertips::default();
    for finger in 0..5 {
        let (position, direction) = hand.tip(finger, angles).unwrap();
        tips.positions[finger] = Some(position * size);
        tips.directions[finger] = Some(direction);
    }
    tips
}

fn tip(angles: &Angles, finger: usize) -> Vector3<f32> {
    hand5().tip(finger, angles).unwrap().0
}

/// A working posture, in which the fingers oppose the thumb.
fn opposed(rng: &mut Rng) -> Angles {
    let mut angles = random_angles(rng);
    let mut set = |joint: usize, lower: f32, upper: f32| {
        angles[joint] = lower + (upper - lower) * rng.uniform() as f32;
    };
    set(0, 0.9, 1.5);
    set(1, 0.3, 0.8);
    set(3, -0.1, 0.6);
    set(4, 0.0, 0.8);
    for base in [6, 9, 12, 14] {
        set(base, 0.5, 1.0);
        set(base + 1, 0.5, 1.2);
    }
    angles
}

#[test]
fn thumb_and_vectors_are_those_of_the_operator() {
    let retargeting = retargeting(RetargetSettings { near: 0.0, far: 1e-3, ..FREE });
    let mut rng = Rng::new(31, 0);
    for _ in 0..500 {
        let goal = random_angles(&mut rng);
        let tips = operator(&goal, 1.0);
        let mut state = retargeting.begin(&retargeting.hand.center(), &Vector3::zeros());
        let report = retargeting.update(&mut state, &tips, PERIOD).unwrap();
        assert_eq!((report.missed, report.limited), (0, 0), "{report:?}");
        assert!((tip(&state.angles(), 0) - tip(&goal, 0)).norm() < 5e-5);
        for finger in 1..5 {
            let got = tip(&state.angles(), finger) - tip(&state.angles(), 0);
            let expected = tip(&goal, finger) - tip(&goal, 0);
            assert!((got - expected).norm() < 1e-4, "{finger}: {}", (got - expected).norm());
        }
    }
}

#[test]
fn the_initial_offset_shifts_the_thumb_and_leaves_the_vectors() {
    let retargeting = retargeting(FREE);
    let mut robot = retargeting.hand.center();
    robot[4] = 0.5;
    let operator_thumb = Vector3::new(0.07, 0.03, 0.08);
    let offset = retargeting.initial_offset(&robot, &operator_thumb);
    assert!((operator_thumb + offset - tip(&robot, 0)).norm() < 1e-6);
    // The operator's thumb moves by 4 mm: so does the robot's.
    let step = Vector3::new(0.003, -0.002, 0.001_732);
    let mut state = retargeting.begin(&robot, &offset);
    let mut tips = OperatorFingertips::default();
    tips.positions[0] = Some(operator_thumb + step);
    tips.positions[1] = Some(operator_thumb + step + tip(&robot, 1) - tip(&robot, 0) - step);
    retargeting.update(&mut state, &tips, PERIOD).unwrap();
    assert!((tip(&state.angles(), 0) - tip(&robot, 0) - step).norm() < 5e-5);
    assert!((tip(&state.angles(), 1) - tip(&robot, 1)).norm() < 1e-4);
    // Unknown fingers keep their joints, except for the one that all share.
    assert!(
        (8..16).filter(|&joint| joint > 8).all(|joint| (state.angles()[joint] - robot[joint]).abs() < 1e-9)
    );
}

/// Moves from one random posture to the next within half a second, at 100 frames per second.
fn path(rng: &mut Rng, frames: u16) -> Vec<Angles> {
    let (mut from, mut to) = (random_angles(rng), random_angles(rng));
    let at = |frame: u16| {
        if frame > 0 && frame.is_multiple_of(50) {
            (from, to) = (to, random_angles(rng));
        }
        let s = f32::from(frame % 50) / 50.0;
        from + (to - from) * (s * s * (3.0 - 2.0 * s))
    };
    (0..frames).map(at).collect()
}

#[test]
fn frames_of_a_control_period_end_in_time_and_lose_no_accuracy() {
    // Where a finger passes its stretched posture, directions use up evaluations that the positions need.
    for (directions, at_reach) in [(false, 2), (true, 15)] {
        let retargeting = retargeting(RetargetSettings { directions, ..FREE });
        let mut rng = Rng::new(37, 0);
        // Within reach, out of reach, and bent beyond what the joints allow.
        for (size, allowed) in [(1.0, at_reach), (1.1, 4000), (0.9, 4000)] {
            let path = path(&mut rng, 4000);
            let mut state = retargeting.begin_nearby(&path[0], &Vector3::zeros());
            let mut missed = 0;
            for angles in &path {
                let report = retargeting.update(&mut state, &operator(angles, size), PERIOD).unwrap();
                // Each finger is evaluated at least once.
                assert!(report.evaluations <= 33, "{report:?}");
                missed += u32::from(report.missed != 0);
            }
            // A finger that passes its stretched posture may need another frame.
            assert!(missed <= allowed, "{missed} of 4000");
        }
    }
}

/// A posture in which the tip of `finger` touches the thumb's.
fn pinching(rng: &mut Rng, finger: usize) -> Angles {
    let hand = hand5();
    let options = HandOptions { restarts: 2, ..HandOptions::default() };
    for _ in 0..5000 {
        let mut angles = opposed(rng);
        let mut targets = FingertipTargets::default();
        let position = tip(&angles, 0);
        targets[finger] = Some(FingertipTarget { position, weight: 1.0, direction: None });
        if hand.search(&targets, &options, &mut angles).distance(finger) < 2e-5 {
            return angles;
        }
    }
    panic!("no posture found")
}

#[test]
fn a_precision_pinch_stays_closed_whatever_the_other_fingers_do() {
    let retargeting = retargeting(FREE);
    let mut rng = Rng::new(32, 0);
    for round in 0..500 {
        let finger = 1;
        let mut tips = operator(&pinching(&mut rng, finger), 1.0);
        // The other fingers have other targets, some of them out of reach.
        let others = operator(&opposed(&mut rng), 1.1);
        for other in (1..5).filter(|&other| other != finger) {
            tips.positions[other] = others.positions[other];
        }
        let mut state = retargeting.begin(&opposed(&mut rng), &Vector3::zeros());
        let report = retargeting.update(&mut state, &tips, PERIOD).unwrap();
        let gap = (tip(&state.angles(), finger) - tip(&state.angles(), 0)).norm();
        assert!(gap < 5e-4, "{round}: gap {gap}, {report:?}");
    }
}

#[test]
fn the_pinch_of_a_hand_of_another_size_closes_or_is_told() {
    let retargeting = retargeting(FREE);
    let mut rng = Rng::new(36, 0);
    let mut closed = 0;
    for round in 0..500 {
        let size = 0.85 + 0.3 * rng.uniform() as f32;
        let mut tips = operator(&pinching(&mut rng, 1), size);
        tips.positions[1] = tips.positions[0];
        let mut state = retargeting.begin(&opposed(&mut rng), &Vector3::zeros());
        let report = retargeting.update(&mut state, &tips, PERIOD).unwrap();
        let gap = (tip(&state.angles(), 1) - tip(&state.angles(), 0)).norm();
        closed += u32::from(gap < 5e-4);
        assert!(gap < 5e-4 || report.missed & 0b10 != 0, "{round}: gap {gap}, {report:?}");
        assert!((report.distance(1) - gap).abs() < 1e-6);
    }
    assert!(closed >= 495, "{closed} of 500");
}

#[test]
fn tips_of_other_radius_touch_when_the_operators_do() {
    let settings = RetargetSettings { operator_contact: 0.014, robot_contact: 0.010, ..FREE };
    let retargeting = retargeting(settings);
    let mut rng = Rng::new(33, 0);
    for _ in 0..200 {
        let posture = pinching(&mut rng, 1);
        let mut tips = operator(&posture, 1.0);
        tips.positions[1] = tips.positions[1].map(|tip| tip + Vector3::new(0.0, 0.0, 0.03));
        let thumb = tips.positions[0].unwrap();
        let toward = (tips.positions[1].unwrap() - thumb).normalize();
        tips.positions[1] = Some(thumb + toward * 0.014);
        let mut state = retargeting.begin(&posture, &Vector3::zeros());
        retargeting.update(&mut state, &tips, PERIOD).unwrap();
        let distance = (tip(&state.angles(), 1) - tip(&state.angles(), 0)).norm();
        assert!((distance - 0.010).abs() < 5e-4, "{distance}");
    }
}

#[test]
fn tips_that_touch_keep_their_direction_in_noise() {
    let settings = RetargetSettings { robot_contact: 0.024, far: 0.08, ..FREE };
    let retargeting = retargeting(settings);
    let mut rng = Rng::new(37, 0);
    for round in 0..50 {
        let posture = pinching(&mut rng, 1);
        let mut tips = operator(&posture, 1.0);
        let thumb = tips.positions[0].unwrap();
        let mut state = retargeting.begin(&posture, &Vector3::zeros());
        let mut before: Option<Vector3<f32>> = None;
        for frame in 0..80_u8 {
            // The operator's index finger closes from 40 mm to the thumb and stays there, measured to half a
            // millimetre, at times exactly on the thumb.
            let distance = (0.04 - 1e-3 * f32::from(frame)).max(0.0);
            let noise = [0; 3].map(|_| 5e-4 * rng.symmetric() as f32);
            let noise = Vector3::from(noise) * if frame % 8 == 7 { 0.0 } else { 1.0 };
            tips.positions[1] = Some(thumb + Vector3::new(0.6, 0.0, 0.8) * distance + noise);
            let report = retargeting.update(&mut state, &tips, PERIOD).unwrap();
            let between = tip(&state.angles(), 1) - tip(&state.angles(), 0);
            if let Some(before) = before.filter(|_| frame > 45) {
                let jump = (between - before).norm();
                assert!(jump < 6e-3, "{round}, {frame}: {jump} m");
                assert!((between.norm() - 0.024).abs() < 1e-3, "{round}, {frame}: {between} {report:?}");
            }
            before = Some(between);
        }
    }
}

#[test]
fn a_closing_pinch_moves_the_joints_without_jumps() {
    let retargeting = retargeting(FREE);
    let mut rng = Rng::new(34, 0);
    for _ in 0..50 {
        // The index finger closes from 40 mm to the thumb and opens again, within 0.8 s.
        let posture = pinching(&mut rng, 1);
        let tips = operator(&posture, 1.0);
        let thumb = tips.positions[0].unwrap();
        let toward = Vector3::new(0.6, 0.0, 0.8);
        let mut state = retargeting.begin(&posture, &Vector3::zeros());
        let mut before: Option<Angles> = None;
        for frame in 0..=80 {
            let distance = 0.04 * (f32::from(u8::try_from(frame).unwrap()) / 40.0 - 1.0).abs();
            let mut tips = tips;
            tips.positions[1] = Some(thumb + toward * distance);
            retargeting.update(&mut state, &tips, PERIOD).unwrap();
            if let Some(before) = before {
                let step = (state.angles() - before).amax();
                // The tip moves by 1 mm per frame. A finger that is nearly stretched, or whose thumb yields,
                // needs the largest joint motion for it.
                assert!(step < 0.6, "frame {frame}: {step} rad");
            }
            before = Some(state.angles());
        }
    }
}

/// A thumb and a finger, each of two joints about x and y; both are spread by the first actuator.
fn hand_with_a_shared_thumb() -> Hand {
    const NO_MASS: Inertial = Inertial { mass: 0.0, center_of_mass: [0.0; 3], inertia: [0.0; 6] };
    const LIMITS: [(f32, f32); 3] = [(-1.0, 1.0), (-1.0, 1.5), (-1.0, 1.5)];
    let at = |y: f32, z: f32| Pose { translation: [0.0, y, z], ..Pose::IDENTITY };
    let spread = |multiplier| Coupling { actuated: 0, multiplier, offset: 0.0 };
    let couplings = [[spread(1.0), Coupling::direct(1)], [spread(-1.0), Coupling::direct(2)]];
    let fingers = [0.02, -0.02].into_iter().zip(&couplings).map(|(side, couplings)| {
        let links =
            [(&at(side, 0.0), &[1.0, 0.0, 0.0], &NO_MASS), (&at(0.0, 0.04), &[0.0, 1.0, 0.0], &NO_MASS)];
        FingerDescription {
            chain: Chain::of_links(links, &at(0.0, 0.03)),
            couplings,
            limits: &[None; 2],
            pointing: [0.0, 0.0, 1.0],
        }
    });
    Hand::try_new(fingers, &LIMITS).unwrap()
}

#[test]
fn a_joint_that_the_thumb_shares_keeps_its_speed_limit() {
    let hand = hand_with_a_shared_thumb();
    let settings = RetargetSettings { speeds: [6.0; MAX_JOINTS], ..RetargetSettings::DEFAULT };
    settings.validate(&hand).unwrap();
    let retargeting = Retargeting { hand: &hand, settings: &settings };
    let mut state = retargeting.begin(&Angles::zeros(), &Vector3::zeros());
    let mut tips = OperatorFingertips::default();
    let mut goal = Angles::zeros();
    goal[0] = 0.8;
    for finger in 0..2 {
        tips.positions[finger] = Some(hand.tip(finger, &goal).unwrap().0);
    }
    for _ in 0..10 {
        let before = state.angles()[0];
        retargeting.update(&mut state, &tips, PERIOD).unwrap();
        let speed = (state.angles()[0] - before).abs() / PERIOD;
        assert!(speed < 6.001, "{speed} rad/s");
    }
    assert!(state.angles()[0] > 0.3, "{}", state.angles()[0]);
}

#[test]
fn the_output_keeps_its_speed_limit_says_so_and_arrives() {
    let mut speeds = [4.0; MAX_JOINTS];
    speeds[5] = 1.0;
    let retargeting = retargeting(RetargetSettings { speeds, near: 0.0, far: 1e-3, ..FREE });
    let mut rng = Rng::new(35, 0);
    for _ in 0..50 {
        let goal = random_angles(&mut rng);
        let mut state = retargeting.begin(&retargeting.hand.center(), &Vector3::zeros());
        let mut limited = 0;
        for _ in 0..60 {
            let before = state.angles();
            let report = retargeting.update(&mut state, &operator(&goal, 1.0), PERIOD).unwrap();
            limited = report.limited;
            for joint in 0..16 {
                let step = (state.angles()[joint] - before[joint]).abs();
                assert!(step <= speeds[joint] * PERIOD * 1.0001, "{joint}: {step}");
                if report.limited & (1 << joint) == 0 {
                    assert!(step < speeds[joint] * PERIOD);
                }
            }
        }
        assert_eq!(limited, 0);
        let report = retargeting.update(&mut state, &operator(&goal, 1.0), PERIOD).unwrap();
        assert_eq!(report.missed, 0, "{report:?}");
    }
}

#[test]
fn what_cannot_be_reproduced_is_told_by_finger_and_distance() {
    let retargeting = retargeting(FREE);
    let mut state = retargeting.begin(&retargeting.hand.center(), &Vector3::zeros());
    let mut tips = operator(&retargeting.hand.center(), 1.0);
    // 0.3 m beyond the fingertips: the middle finger can only stretch.
    tips.positions[2] = Some(Vector3::new(0.0, 0.0, 0.5));
    let report = retargeting.update(&mut state, &tips, PERIOD).unwrap();
    assert_eq!(report.missed & 0b101, 0b100, "{report:?}");
    // Its base is 92 mm from the wrist, and the finger 92.31 mm long.
    assert!((report.distance(2) - (0.5 - 0.184_31)).abs() < 2e-3, "{report:?}");
}

#[test]
fn bad_input_is_refused_by_name_and_changes_nothing() {
    let retargeting = retargeting(FREE);
    let mut state = retargeting.begin(&retargeting.hand.center(), &Vector3::zeros());
    let before = state;
    for (finger, bad) in [(0, f32::NAN), (3, f32::INFINITY), (4, 2.0)] {
        let mut tips = operator(&retargeting.hand.center(), 1.0);
        tips.positions[usize::from(finger)].as_mut().unwrap().x = bad;
        assert_eq!(retargeting.update(&mut state, &tips, PERIOD), Err(InvalidFingertip { finger }));
    }
    let mut tips = operator(&retargeting.hand.center(), 1.0);
    tips.directions[1] = Some(Vector3::zeros());
    assert_eq!(retargeting.update(&mut state, &tips, PERIOD), Err(InvalidFingertip { finger: 1 }));
    assert_eq!(state, before);
    // If nothing is known, nothing moves.
    retargeting.update(&mut state, &OperatorFingertips::default(), PERIOD).unwrap();
    assert_eq!(state.angles(), before.angles());

    let refused = |settings: RetargetSettings| settings.validate(&hand5()).unwrap_err().field;
    assert_eq!(refused(RetargetSettings { follows: [1, 0, 2, 3, 4], ..FREE }), RetargetField::Follows);
    assert_eq!(
        refused(RetargetSettings { weights: [1.0, 0.0, 1.0, 1.0, 1.0], ..FREE }),
        RetargetField::Weights
    );
    assert_eq!(refused(RetargetSettings { scale: f32::NAN, ..FREE }), RetargetField::Scale);
    // A difference of 20 mm cannot be blended within 20 mm of approach without a reversal.
    assert_eq!(refused(RetargetSettings { robot_contact: 0.02, ..FREE }), RetargetField::Far);
}
