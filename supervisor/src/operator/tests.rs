//! Valid and invalid frames of a hand with the mean proportions.

use nalgebra::{Rotation3, UnitQuaternion, Vector3};
use tesaki::task::telexistence::FingertipPoint;
use tesaki::teleop::{FingerLinks, GloveSample, HUMAN_FINGERS, HumanFinger, HumanHand};
use tesaki_description::retargeting::Side;

use super::{FrameError, LANDMARKS, Landmarks, Observation, Tracker, TrackerSettings, Wearer};

/// First joints of a right hand [m], as in `robots/hand5`, and bones of each finger.
const JOINTS: [[f32; 3]; HUMAN_FINGERS] = [
    [0.010, 0.022, 0.020],
    [0.0, 0.025, 0.090],
    [0.0, 0.004, 0.092],
    [0.0, -0.016, 0.087],
    [0.0, -0.034, 0.078],
];
const BONES: [[f32; 3]; HUMAN_FINGERS] = [
    [0.0462, 0.0316, 0.0273],
    [0.0398, 0.0224, 0.0197],
    [0.0446, 0.0263, 0.0214],
    [0.0414, 0.0257, 0.0213],
    [0.0327, 0.0181, 0.0197],
];

/// Returns the landmarks of a right hand in its frame, with each joint of the four fingers bent by `bend`
/// [rad].
fn landmarks(bend: f32) -> [[f32; 3]; LANDMARKS] {
    let mut points = [[0.0; 3]; LANDMARKS];
    for finger in 0..HUMAN_FINGERS {
        let mut point = Vector3::from(JOINTS[finger]);
        points[1 + 4 * finger] = point.into();
        for (bone, length) in BONES[finger].iter().enumerate() {
            // Bent about y, from z towards x, out of the palm. The thumb points sideways.
            let angle = if finger == 0 { 0.3 } else { bend * (bone + 1) as f32 };
            let sideways = if finger == 0 { 0.84 } else { 0.0 };
            let (sine, cosine) = tesaki::math::sin_cos(angle);
            let direction = Vector3::new(sine, sideways, cosine).normalize();
            point += direction * *length;
            points[2 + 4 * finger + bone] = point.into();
        }
    }
    points
}

/// World landmarks that MediaPipe expects of its test pictures of right hands [0.1 mm].
const MEDIAPIPE: [[[i16; 3]; LANDMARKS]; 3] = include!("../../../tests/oracles/data/mediapipe_hands.in");

/// Transforms points into a camera's frame.
fn pictured(points: [[f32; 3]; LANDMARKS]) -> [[f32; 3]; LANDMARKS] {
    let rotation = Rotation3::from_euler_angles(1.1, -0.4, 2.0);
    points.map(|point| (rotation * Vector3::from(point) - Vector3::new(0.01, 0.02, 0.03)).into())
}

fn tracker(side: Side) -> Tracker {
    Tracker::try_new(TrackerSettings {
        side,
        rotation: UnitQuaternion::identity(),
        bandwidth: 5.0,
        max_gap: 0.2,
        wearer: None,
    })
    .unwrap()
}

fn seen(
    side: Side,
    points: [[f32; 3]; LANDMARKS],
    handedness: Option<Side>,
) -> Result<[Option<FingertipPoint>; HUMAN_FINGERS], FrameError> {
    tracker(side).add(0.0, &Observation::Landmarks(Some(Landmarks { points, handedness })))
}

fn mirrored(points: [[f32; 3]; LANDMARKS]) -> [[f32; 3]; LANDMARKS] {
    points.map(|[x, y, z]| [-x, y, z])
}

fn tips(bend: f32) -> [Option<[f32; 3]>; HUMAN_FINGERS] {
    [4, 8, 12, 16, 20].map(|index| Some(landmarks(bend)[index]))
}

#[test]
fn landmarks_in_any_pose_become_fingertips_in_the_hands_frame() {
    for bend in [0.0, 0.4, 0.9] {
        for (side, points) in
            [(Side::Right, landmarks(bend)), (Side::Left, landmarks(bend).map(|[x, y, z]| [x, -y, z]))]
        {
            let found = seen(side, pictured(points), Some(side)).unwrap();
            for (finger, tip) in found.iter().enumerate() {
                let tip = tip.unwrap();
                let (last, before) = (points[4 + 4 * finger], points[3 + 4 * finger]);
                let direction = (Vector3::from(last) - Vector3::from(before)).normalize();
                assert!(
                    (Vector3::from(tip.position) - Vector3::from(last)).norm() < 1e-5,
                    "{side:?} {finger}"
                );
                assert!((Vector3::from(tip.direction.unwrap()) - direction).norm() < 1e-4);
            }
        }
    }
}

#[test]
fn landmarks_of_mediapipe_are_those_of_right_hands() {
    for picture in MEDIAPIPE {
        let points = picture.map(|point| point.map(|x| 1e-4 * f32::from(x)));
        let found = seen(Side::Right, points, Some(Side::Right)).unwrap().map(|tip| tip.unwrap().position);
        // At least three fingers are bent: their tips are near the wrist, and not behind the palm.
        let bent = found[1..].iter().filter(|tip| tip[0] > -0.01 && tip[2] < 0.1);
        assert!(bent.count() >= 3, "{found:?}");
        assert_eq!(seen(Side::Left, points, None), Err(FrameError::OtherHand(Side::Right)));
        assert!(matches!(seen(Side::Right, points, Some(Side::Left)), Err(FrameError::Label { .. })));
        assert_eq!(seen(Side::Right, mirrored(points), None), Err(FrameError::OtherHand(Side::Left)));
    }
}

#[test]
fn the_settings_turn_the_fingertips_into_the_robots_frame() {
    let rotation = UnitQuaternion::from_euler_angles(0.3, -0.7, 2.0);
    let settings =
        TrackerSettings { side: Side::Right, rotation, bandwidth: 5.0, max_gap: 0.2, wearer: None };
    let found = Tracker::try_new(settings).unwrap().add(0.0, &Observation::Fingertips(tips(0.3))).unwrap();
    for (found, tip) in found.iter().zip(tips(0.3)) {
        let turned = rotation * Vector3::from(tip.unwrap());
        assert!((Vector3::from(found.unwrap().position) - turned).norm() < 1e-6);
    }
}

/// A mirrored bent hand is recognised as the other hand regardless of its label, a flat one only by its
/// label.
#[test]
fn the_other_hand_and_a_mirrored_one_are_told() {
    let bent = pictured(landmarks(0.4));
    for label in [None, Some(Side::Right)] {
        let error = seen(Side::Right, mirrored(bent), label).unwrap_err();
        assert_eq!(error, FrameError::OtherHand(Side::Left));
        assert!(error.to_string().contains("like those of a left hand"), "{error}");
        assert!(error.to_string().contains("do not flip"), "{error}");
    }
    assert_eq!(seen(Side::Left, bent, None), Err(FrameError::OtherHand(Side::Right)));
    for bend in [0.0, 0.4] {
        let error = seen(Side::Right, pictured(landmarks(bend)), Some(Side::Left)).unwrap_err();
        assert_eq!(error, FrameError::Label { label: Side::Left, bends_otherwise: bend > 0.0 });
        assert_eq!(error.to_string().contains("bends like the other"), bend > 0.0, "{error}");
    }
}

#[test]
fn landmarks_in_other_units_or_of_the_picture_are_told() {
    let bent = pictured(landmarks(0.4));
    for (scale, words) in [
        (100.0, "send positions in metres; a hand would have this in cm"),
        (1000.0, "would have this in mm"),
        (10.0, "would have this in dm"),
        (39.37, "would have this in inches"),
        (57.0, "would have this in inches or in cm"),
        (0.01, "not in the picture"),
    ] {
        let error = seen(Side::Right, bent.map(|point| point.map(|x| scale * x)), None).unwrap_err();
        assert!(matches!(error, FrameError::Size { .. }) && error.to_string().contains(words), "{error}");
    }
    // As MediaPipe's other landmarks: x, y in the picture; z relative to the wrist.
    let wrist = bent[0];
    let normalised = bent.map(|[x, y, z]| [0.5 + x, 0.5 + y, z - wrist[2]]);
    assert_eq!(seen(Side::Right, normalised, None), Err(FrameError::Normalised));
}

#[test]
fn landmarks_in_another_order_are_told() {
    let bent = pictured(landmarks(0.4));
    let swapped = |one: usize, other: usize, count: usize| {
        let mut points = bent;
        (0..count).for_each(|index| points.swap(one + index, other + index));
        seen(Side::Right, points, None).unwrap_err()
    };
    // Swapped index and middle finger, reversed fingers, and two swapped joints.
    assert!(matches!(
        swapped(5, 9, 4),
        FrameError::Order { finger: HumanFinger::Middle, what: "knuckle", .. }
    ));
    let reversed = std::array::from_fn(|index| {
        if index < 5 { bent[index] } else { bent[5 + 4 * (3 - (index - 5) / 4) + (index - 5) % 4] }
    });
    assert!(seen(Side::Right, reversed, None).is_err());
    assert!(matches!(swapped(6, 20, 1), FrameError::Bone { .. }), "{:?}", swapped(6, 20, 1));
    let mut broken = bent;
    broken[7][1] = f32::NAN;
    assert_eq!(seen(Side::Right, broken, None), Err(FrameError::NotFinite("landmark 7".to_owned())));
    let line = std::array::from_fn(|index| [0.01 * index as f32 - 0.1, 0.0, 0.0]);
    assert_eq!(seen(Side::Right, line, None), Err(FrameError::Flat));
}

#[test]
fn fingertips_that_are_not_of_a_hand_are_told() {
    let check = |change: &dyn Fn([f32; 3]) -> [f32; 3]| {
        let tips = tips(0.5).map(|tip| tip.map(change));
        tracker(Side::Right).add(0.0, &Observation::Fingertips(tips))
    };
    assert!(check(&|tip| tip).is_ok());
    for (scale, words) in [
        (100.0, "this in cm"),
        (1000.0, "in mm"),
        (39.37, "in inches or in cm"),
        (10.0, "in dm or in inches"),
        (0.05, "metres"),
    ] {
        let error = check(&|tip| tip.map(|x| scale * x)).unwrap_err();
        assert!(matches!(error, FrameError::Size { .. }) && error.to_string().contains(words), "{error}");
    }
    assert_eq!(check(&|[x, y, z]| [x, -y, z]), Err(FrameError::Reversed { follows: Side::Right }));
    assert!(matches!(check(&|[x, y, z]| [-x, y, z]), Err(FrameError::Behind { .. })));
    assert_eq!(check(&|[x, y, z]| [-x, -y, z]), Err(FrameError::Turned));
    let swapped = |one: usize, other: usize| {
        let mut tips = tips(0.1);
        tips.swap(one, other);
        tracker(Side::Right).add(0.0, &Observation::Fingertips(tips)).unwrap_err()
    };
    assert!(matches!(swapped(2, 4), FrameError::Order { finger: HumanFinger::Ring, what: "tip", .. }));
    assert!(matches!(swapped(0, 1), FrameError::Reach { finger: HumanFinger::Thumb, .. }));
    let mut broken = tips(0.1);
    broken[3] = Some([0.0, f32::INFINITY, 0.1]);
    let error = tracker(Side::Right).add(0.0, &Observation::Fingertips(broken)).unwrap_err();
    assert_eq!(error, FrameError::NotFinite("the tip of the ring finger".to_owned()));
    // A fist, a flat hand and crossed fingers are valid.
    for bend in [0.0, 1.2] {
        tracker(Side::Right).add(0.0, &Observation::Fingertips(tips(bend))).unwrap();
    }
    let mut crossed = tips(0.1);
    crossed[1].as_mut().unwrap()[1] -= 0.03;
    tracker(Side::Right).add(0.0, &Observation::Fingertips(crossed)).unwrap();
}

#[test]
fn time_that_does_not_rise_is_told_and_changes_nothing() {
    let mut tracker = tracker(Side::Right);
    let frame = Observation::Fingertips(tips(0.2));
    tracker.add(1.0, &frame).unwrap();
    for time in [1.0, 0.5] {
        assert_eq!(tracker.add(time, &frame), Err(FrameError::Time { time, before: 1.0 }));
    }
    assert!(matches!(tracker.add(f64::NAN, &frame), Err(FrameError::NotFinite(_))));
    tracker.add(1.1, &frame).unwrap();
    assert_eq!(tracker.gaps(), 0);
    tracker.add(1.4, &frame).unwrap();
    assert_eq!(tracker.gaps(), 1);
}

/// At constant velocity the position has no lag and the velocity is exact. At the start the velocity lags by
/// 2/ω.
#[test]
fn positions_and_velocities_are_filtered_as_stated() {
    let mut tracker = tracker(Side::Right);
    let (period, speed) = (1.0 / 60.0, 0.03_f32);
    let omega = 5.0 * core::f64::consts::TAU;
    let mut area = 0.0;
    for frame in 0..60 {
        let time = f64::from(frame) * period;
        let shift = speed * time as f32;
        let tips = tips(0.2).map(|tip| tip.map(|[x, y, z]| [x + shift, y, z]));
        let [_, index, ..] = tracker.add(time, &Observation::Fingertips(tips)).unwrap();
        let index = index.unwrap();
        area += (speed - index.velocity[0]) as f64 * period;
        if frame > 45 {
            assert!((index.velocity[0] - speed).abs() < 3e-4, "{}", index.velocity[0]);
            assert!((index.position[0] - tips[1].unwrap()[0]).abs() < 1e-4);
        }
    }
    // The area above the step response is speed · delay; sampling adds about half a period.
    let delay = area / f64::from(speed);
    assert!((delay - 2.0 / omega).abs() < period, "{delay} s, expected {} s", 2.0 / omega);
}

#[test]
fn a_fingertip_that_is_hidden_is_not_made_up_and_begins_anew() {
    let mut tracker = tracker(Side::Right);
    let mut hidden = tips(0.2);
    hidden[2] = None;
    for frame in 0..30 {
        let time = f64::from(frame) / 60.0;
        let given = if (5..25).contains(&frame) { hidden } else { tips(0.2) };
        let found = tracker.add(time, &Observation::Fingertips(given)).unwrap();
        assert_eq!(found[2].is_none(), (5..25).contains(&frame));
    }
    assert_eq!(tracker.add(0.6, &Observation::Landmarks(None)), Ok([None; HUMAN_FINGERS]));
}

/// The sensor on the back of the hand has an arbitrary orientation, which follows from the knuckles.
#[test]
fn a_glove_gives_the_fingertips_in_the_hands_frame() {
    let mount = UnitQuaternion::from_euler_angles(0.5, -1.2, 2.2);
    let shift = Vector3::new(0.01, -0.02, 0.03);
    let links = std::array::from_fn(|finger| {
        let base = mount * Vector3::from(JOINTS[finger]) + shift;
        let [a, b, c] = BONES[finger].map(|length| [0.0, 0.0, length]);
        FingerLinks([base.into(), a, b, c])
    });
    let hand = HumanHand::try_new(links).unwrap();
    let settings = TrackerSettings {
        side: Side::Right,
        rotation: UnitQuaternion::identity(),
        bandwidth: 5.0,
        max_gap: 0.2,
        wearer: Some(Wearer::try_new(hand, Side::Right).unwrap()),
    };
    // Each joint is bent by 0.4 rad about y of the hand, and the whole hand is rotated.
    let world = UnitQuaternion::from_euler_angles(0.2, 0.9, -0.6);
    let quaternion = |rotation: UnitQuaternion<f32>| Some(<[f32; 4]>::from(rotation.coords));
    let segment = |bend: f32| quaternion(world * UnitQuaternion::from_euler_angles(0.0, bend, 0.0));
    let sample = GloveSample {
        back: quaternion(world * mount.inverse()),
        segments: [[segment(0.4), segment(0.8), segment(1.2)]; HUMAN_FINGERS],
    };
    let mut tracker = Tracker::try_new(settings).unwrap();
    let found = tracker.add(0.0, &Observation::Glove(sample)).unwrap();
    for (finger, tip) in found.into_iter().enumerate().skip(1) {
        let expected = landmarks(0.4)[4 + 4 * finger];
        let tip = tip.unwrap();
        assert!((Vector3::from(tip.position) - Vector3::from(expected)).norm() < 1e-4, "{finger}: {tip:?}");
    }
    // A failed sensor hides its finger after it has been bridged; an invalid one makes the frame invalid.
    let mut lost = sample;
    lost.segments[2][1] = None;
    let found = (1..20).map(|frame| tracker.add(0.01 * f64::from(frame), &Observation::Glove(lost)).unwrap());
    let seen: Vec<bool> = found.map(|tips| tips[2].is_some()).collect();
    assert!(seen[0] && !seen[18]);
    let mut long = sample;
    long.segments[1][0] = Some([0.5; 4].map(|x| 2.0 * x));
    let error = tracker.add(0.3, &Observation::Glove(long)).unwrap_err();
    assert!(error.to_string().contains("segment 1 of the index finger is a quaternion of norm 2"), "{error}");
    // After a pause that the settings allow, but not the filter, it begins anew.
    let settings = TrackerSettings { max_gap: 2.0, ..settings };
    let mut patient = Tracker::try_new(settings).unwrap();
    for time in [0.0, 1.5, 1.6, 3.5] {
        patient.add(time, &Observation::Glove(sample)).unwrap();
    }
    // Links of another person, or a sensor that has slipped by half a turn.
    let mut slipped = sample;
    slipped.back = quaternion(world * UnitQuaternion::from_euler_angles(0.0, 0.0, 3.1) * mount.inverse());
    assert!(tracker.add(0.6, &Observation::Glove(slipped)).is_err());
}
