use nalgebra::{Matrix3, Vector3};

use super::*;
use crate::math;

/// Cases of `tests/oracles/hand5_calibration.py`; the data begin with a description of the columns.
type Case = (
    &'static str,
    f32,
    f32,
    f32,
    f32,
    &'static [([[f32; 4]; 4], [f32; 3])],
    [f32; 2],
    u8,
    f32,
    [[f32; 3]; 4],
    &'static [([[f32; 4]; 3], [f32; 3])],
    [[f32; 3]; 4],
);
#[allow(clippy::excessive_precision, reason = "printed by the oracle")]
const CASES: &[Case] = include!("../../../tests/oracles/data/hand5_calibration.in");

fn case(name: &str) -> &'static Case {
    CASES.iter().find(|case| case.0 == name).unwrap()
}

/// A sample in which all fingers have the orientations of one.
fn sample([back, segments @ ..]: &[[f32; 4]; 4]) -> GloveSample {
    GloveSample { back: Some(*back), segments: [segments.map(Some); HUMAN_FINGERS] }
}

fn index(quaternions: &[[f32; 4]; 4]) -> FingerRotations {
    FingerRotations::of(&sample(quaternions), HumanFinger::Index).unwrap()
}

fn settings(case: &Case) -> CalibrationSettings {
    CalibrationSettings { orientation_noise: case.1, marker_noise: case.2, forgetting: case.4 }
}

fn calibration(case: &Case) -> FingerCalibration {
    let mut calibration = FingerCalibration::try_new(HumanFinger::Index, &settings(case)).unwrap();
    if case.3 > 0.0 {
        let prior = LinkPrior { mean: FingerLinks(case.9), deviation: [case.3; 4] };
        calibration.add_prior(&prior).unwrap();
    }
    for (quaternions, marker) in case.5 {
        calibration.add_posture(&index(quaternions), *marker).unwrap();
    }
    calibration
}

/// Orientations of a probe, given relative to the back of the hand.
fn probe([first, second, third]: &[[f32; 4]; 3]) -> FingerRotations {
    index(&[[0.0, 0.0, 0.0, 1.0], *first, *second, *third])
}

fn distance(one: [f32; 3], other: [f32; 3]) -> f32 {
    (Vector3::from(one) - Vector3::from(other)).norm()
}

#[test]
fn links_rank_condition_and_residual_are_those_of_a_truncated_svd_in_double_precision() {
    for case in CASES {
        let (links, accuracy) = calibration(case).estimate().unwrap();
        assert_eq!(accuracy.rank, case.7, "{}", case.0);
        assert!(
            (accuracy.condition / (case.6[0] / case.6[1]) - 1.0).abs() < 1e-3,
            "{}: {accuracy:?}",
            case.0
        );
        assert!((accuracy.residual - case.8).abs() < 2e-6 + 1e-3 * case.8, "{}: {accuracy:?}", case.0);
        for (rotations, expected) in case.10 {
            let miss = distance(links.tip(&probe(rotations)), *expected);
            assert!(miss < 1e-5, "{}: {miss}", case.0);
        }
    }
    assert_eq!(CASES.len(), 7);
}

#[test]
fn without_noise_the_tip_is_exact_in_every_posture_although_the_rank_is_ten() {
    for name in ["exact, spread", "four poses"] {
        let case = case(name);
        let (links, accuracy) = calibration(case).estimate().unwrap();
        assert_eq!(accuracy.rank, 10);
        for (rotations, _) in case.10 {
            let truth = FingerLinks(case.11).tip(&probe(rotations));
            assert!(distance(links.tip(&probe(rotations)), truth) < 1e-4, "{name}");
        }
    }
}

/// The stated deviation bounds the errors of the probes, and is not ten times too large.
#[test]
fn the_stated_deviation_of_the_tip_is_that_of_its_errors() {
    for name in ["noise of means over a second", "forgetting"] {
        let case = case(name);
        let (links, accuracy) = calibration(case).solve().unwrap();
        let squares: f32 = case
            .10
            .iter()
            .map(|(rotations, _)| {
                let miss =
                    distance(links.tip(&probe(rotations)), FingerLinks(case.11).tip(&probe(rotations)));
                miss * miss
            })
            .sum();
        let rms = math::sqrt(squares / case.10.len() as f32);
        assert!(
            rms < 1.5 * accuracy.tip_deviation && rms > 0.1 * accuracy.tip_deviation,
            "{rms} {accuracy:?}"
        );
    }
}

#[test]
fn fingers_that_were_not_spread_are_refused_with_that_movement() {
    let error = calibration(case("exact, not spread")).solve().unwrap_err();
    let CalibrationError::MissingMovement { movement, deviation, .. } = error else { panic!("{error}") };
    assert_eq!(movement, FingerMovement { finger: HumanFinger::Index, movement: Movement::Spread });
    assert!(deviation > MAX_TIP_DEVIATION);
    assert_eq!(movement.to_string(), "spread the index finger sideways");
}

/// A finger whose joints rotate about y, with a base that spreads about z.
fn posture([base, spread, middle, end]: [f32; 4]) -> FingerRotations {
    let about_y = |angle| math::rotation_matrix(&Vector3::new(0.0, angle, 0.0));
    let spread = math::rotation_matrix(&Vector3::new(0.0, 0.0, spread));
    FingerRotations::from_joints([spread * about_y(base), about_y(middle), about_y(end)])
}

const LINKS: FingerLinks =
    FingerLinks([[0.09, 0.02, 0.0], [0.042, 0.0, -0.003], [0.025, 0.001, 0.0], [0.02, 0.0, -0.004]]);

/// Angles of 30 postures that move all joints.
fn all_movements() -> impl Iterator<Item = [f32; 4]> {
    (0..30_u8).map(|pose| {
        let at = |step: u8| f32::from(pose.wrapping_mul(step) % 30) / 30.0;
        [1.3 * at(7), 0.4 * at(11) - 0.2 * f32::from(pose.min(1)), 1.5 * at(1), at(1) + 0.3 * at(17)]
    })
}

#[test]
fn each_joint_that_did_not_move_is_named() {
    let still =
        [(0, Movement::BendBase), (1, Movement::Spread), (2, Movement::BendMiddle), (3, Movement::BendEnd)];
    for (joint, movement) in still {
        let mut calibration = FingerCalibration::try_new(
            HumanFinger::Ring,
            &CalibrationSettings { orientation_noise: 0.006, ..CalibrationSettings::DEFAULT },
        )
        .unwrap();
        for mut angles in all_movements() {
            angles[joint] = 0.0;
            let rotations = posture(angles);
            calibration.add_posture(&rotations, LINKS.tip(&rotations)).unwrap();
        }
        let error = calibration.solve().unwrap_err();
        let CalibrationError::MissingMovement { movement: missing, .. } = error else { panic!("{error}") };
        assert_eq!(missing, FingerMovement { finger: HumanFinger::Ring, movement });
    }
    let mut calibration = FingerCalibration::try_new(
        HumanFinger::Ring,
        &CalibrationSettings { orientation_noise: 0.006, ..CalibrationSettings::DEFAULT },
    )
    .unwrap();
    for angles in all_movements() {
        calibration.add_posture(&posture(angles), LINKS.tip(&posture(angles))).unwrap();
    }
    calibration.solve().unwrap();
}

#[test]
fn too_few_poses_and_poses_alike_are_refused() {
    let mut calibration =
        FingerCalibration::try_new(HumanFinger::Thumb, &CalibrationSettings::DEFAULT).unwrap();
    let rotations = posture([0.3, 0.0, 0.2, 0.1]);
    for postures in 0..8 {
        let expected = if postures < 4 {
            CalibrationError::TooFewPostures { finger: HumanFinger::Thumb, postures, min: 4 }
        } else {
            CalibrationError::PosturesAlike { finger: HumanFinger::Thumb }
        };
        assert_eq!(calibration.solve(), Err(expected));
        calibration.add_posture(&rotations, LINKS.tip(&rotations)).unwrap();
    }
}

#[test]
fn what_is_no_measurement_is_refused_by_name() {
    let mut calibration = HandCalibration::try_new(&CalibrationSettings::DEFAULT).unwrap();
    let before = calibration;
    let good = sample(&case("noise").5[0].0);
    let markers = [Some([0.1, 0.0, 0.0]); HUMAN_FINGERS];
    let third = GloveSensor::Segment(HumanFinger::Middle, 1);
    let broken = |quaternion| {
        let mut sample = good;
        sample.segments[2][1] = quaternion;
        sample
    };
    let norm = 0.5;
    for (quaternion, expected) in [
        (None, GloveError::Missing(third)),
        (Some([f32::NAN, 0.0, 0.0, 1.0]), GloveError::NotFinite(third)),
        (Some([0.0, 0.0, 0.0, norm]), GloveError::NotUnit { sensor: third, norm }),
    ] {
        assert_eq!(
            calibration.add_posture(&broken(quaternion), &markers),
            Err(CalibrationError::Glove(expected))
        );
        // The orientations of a finger without marker are not needed.
        let mut unmarked = markers;
        unmarked[2] = None;
        before.clone().add_posture(&broken(quaternion), &unmarked).unwrap();
    }
    for tip in [[f32::NAN, 0.0, 0.0], [f32::INFINITY, 0.0, 0.0], [90.0, 20.0, 0.0]] {
        let mut markers = markers;
        markers[4] = Some(tip);
        let error = calibration.add_posture(&good, &markers).unwrap_err();
        assert!(matches!(error, CalibrationError::Marker { finger: HumanFinger::Little, .. }), "{error}");
    }
    assert_eq!(calibration, before);
}

fn quaternion(rotation: &Matrix3<f32>) -> Option<[f32; 4]> {
    let rotation = nalgebra::Rotation3::from_matrix_unchecked(*rotation);
    Some(nalgebra::UnitQuaternion::from_rotation_matrix(&rotation).coords.into())
}

#[test]
fn swapped_markers_are_named() {
    let fill = |swap: bool| {
        let mut calibration = HandCalibration::try_new(&CalibrationSettings::DEFAULT).unwrap();
        let angles: [_; 30] = core::array::from_fn(|pose| all_movements().nth(pose).unwrap());
        for pose in 0..30 {
            let mut sample = GloveSample { back: Some([0.0, 0.0, 0.0, 1.0]), ..GloveSample::default() };
            let mut markers = [None; HUMAN_FINGERS];
            #[allow(clippy::needless_range_loop, reason = "of two arrays")]
            for finger in 0..HUMAN_FINGERS {
                // Each finger has the postures in a different order.
                let rotations = posture(angles[if pose == 0 { 0 } else { (pose * (finger + 1)) % 29 + 1 }]);
                sample.segments[finger] = rotations.0.each_ref().map(quaternion);
                markers[finger] = Some(LINKS.tip(&rotations));
            }
            if swap {
                markers.swap(1, 3);
            }
            calibration.add_posture(&sample, &markers).unwrap();
        }
        calibration
    };
    assert_eq!(fill(false).check_markers(), Ok(()));
    let error = fill(true).solve().unwrap_err();
    let CalibrationError::Swapped { finger, marker_of, .. } = error else { panic!("{error}") };
    assert_eq!([finger, marker_of], [HumanFinger::Index, HumanFinger::Ring]);
}

#[test]
fn filters_outside_their_ranges_are_refused() {
    let refused = |bandwidth, delay, hold| GloveFilter::try_new(bandwidth, delay, hold).unwrap_err().field;
    assert_eq!(GloveFilter::try_new(5.0 * core::f32::consts::TAU, 0.0, 0.1), Ok(GloveFilter::PROMPT));
    for bandwidth in [0.9, 1001.0, f32::NAN] {
        assert_eq!(refused(bandwidth, 0.0, 0.1), "bandwidth of the glove's filter");
    }
    for delay in [0.21, -0.1] {
        assert_eq!(refused(10.0, delay, 0.1), "delay of the glove's filter");
    }
    assert_eq!(refused(10.0, 0.2, 1.5), "time for which a sensor is bridged");
}

#[test]
fn a_filtered_fingertip_is_where_the_links_put_it_and_moves_as_it_does() {
    let hand = HumanHand::try_new([LINKS; HUMAN_FINGERS]).unwrap();
    let mut state = GloveFilterState::default();
    let filter = GloveFilter::try_new(100.0, 0.0, 0.1).unwrap();
    let period = 0.01;
    let at = |time: f32| {
        // The hand rotates as a whole, and each joint bends at a constant rate.
        let back = math::rotation_matrix(&Vector3::new(0.5 * time, 0.0, 1.0));
        let rotations = posture([0.8 * time, 0.2, 1.1 * time, 0.7 * time]);
        let segments = rotations.0.each_ref().map(|segment| quaternion(&(back * segment)));
        (rotations, GloveSample { back: quaternion(&back), segments: [segments; HUMAN_FINGERS] })
    };
    assert_eq!(
        hand.fingertips(&state)[0],
        Err(GloveError::Missing(GloveSensor::Back)),
        "before the first sample"
    );
    for step in 0..100_u8 {
        filter.update(&mut state, period, &at(period * f32::from(step)).1).unwrap();
    }
    let now = period * 99.0;
    let tip = hand.fingertips(&state)[1].unwrap();
    assert!(distance(tip.position, LINKS.tip(&at(now).0)) < 2e-4, "{tip:?}");
    let [before, after] = [now - 1e-2, now + 1e-2].map(|time| Vector3::from(LINKS.tip(&at(time).0)));
    let velocity: Vector3<f32> = (after - before) / 2e-2;
    assert!(distance(tip.velocity, velocity.into()) < 0.02 * velocity.norm(), "{tip:?} {velocity}");
    let last = at(now).0.0[2] * Vector3::from(LINKS.0[3]).normalize();
    assert!(distance(tip.direction, last.into()) < 5e-3);
    // A sensor that stops is bridged for a tenth of a second and then reported.
    let sensor = GloveSensor::Segment(HumanFinger::Index, 2);
    for step in 1..30_u8 {
        let mut sample = at(now + period * f32::from(step)).1;
        sample.segments[1][2] = None;
        assert_eq!(filter.update(&mut state, period, &sample), Err(GloveError::Missing(sensor)));
        let tips = hand.fingertips(&state);
        assert_eq!(tips[1].is_ok(), step <= 10, "{step}");
        assert!(tips[2].is_ok());
        if step == 5 {
            let truth = LINKS.tip(&at(now + 0.05).0);
            assert!(distance(tips[1].unwrap().position, truth) < 1e-3);
        }
    }
    assert!(filter.update(&mut state, f32::NAN, &at(now).1).is_err());
}

#[test]
fn links_that_no_hand_has_are_refused() {
    let mut links = [LINKS; HUMAN_FINGERS];
    links[4].0[1] = [0.4, 0.0, 0.0];
    let error = HumanHand::try_new(links).unwrap_err();
    assert_eq!((error.finger, error.link), (HumanFinger::Little, 1));
    links[4].0[1] = [f32::NAN; 3];
    assert!(HumanHand::try_new(links).is_err());
    links[4] = FingerLinks::default();
    assert_eq!(HumanHand::try_new(links).unwrap_err().link, 3);
}

/// A hand of 110 % of the mean proportions, with first joints displaced by a few millimetres: proximal end of
/// the metacarpal, splay, and bones as in the paper's table [mm].
fn large_hand() -> [FingerLinks; HUMAN_FINGERS] {
    let fingers: [([f32; 2], f32, [f32; 4]); HUMAN_FINGERS] = [
        ([20.0, 25.0], 45.0, [0.0, 46.22, 31.57, 27.34]),
        ([25.0, 14.0], 9.0, [68.12, 39.78, 22.38, 19.66]),
        ([25.0, 3.0], 2.0, [64.60, 44.63, 26.33, 21.35]),
        ([25.0, -9.0], -6.0, [58.00, 41.37, 25.65, 21.25]),
        ([25.0, -19.0], -13.0, [53.69, 32.74, 18.11, 19.69]),
    ];
    fingers.map(|([x, y], splay, bones)| {
        let (sine, cosine) = f64::from(splay).to_radians().sin_cos();
        let [metacarpal, bones @ ..] = bones.map(|bone| {
            let length = 1.1e-3 * bone;
            [length * cosine as f32, length * sine as f32, 0.0]
        });
        let base = [0.005 + 1.1e-3 * x + metacarpal[0], -0.003 + 1.1e-3 * y + metacarpal[1], 0.002];
        FingerLinks([base, bones[0], bones[1], bones[2]])
    })
}

fn relative_sample(rotations: &FingerRotations) -> GloveSample {
    let segments = rotations.0.each_ref().map(quaternion);
    GloveSample { back: Some([0.0, 0.0, 0.0, 1.0]), segments: [segments; HUMAN_FINGERS] }
}

/// Calibrated with markers on thumb, index and little finger.
fn three_markers(hand: &[FingerLinks; HUMAN_FINGERS]) -> HandCalibration {
    let settings = CalibrationSettings { orientation_noise: 0.002, ..CalibrationSettings::DEFAULT };
    let mut calibration = HandCalibration::try_new(&settings).unwrap();
    let flat = posture([0.0; 4]);
    for rotations in core::iter::once(flat).chain(all_movements().map(posture)) {
        let mut markers = hand.map(|links| Some(links.tip(&rotations)));
        markers[2] = None;
        markers[3] = None;
        calibration.add_posture(&relative_sample(&rotations), &markers).unwrap();
    }
    calibration
}

#[test]
fn fingers_without_marker_follow_from_the_size_and_the_place_of_the_others() {
    let hand = large_hand();
    let calibration = three_markers(&hand);
    let flat = relative_sample(&posture([0.0; 4]));
    assert!(matches!(
        calibration.solve(),
        Err(CalibrationError::TooFewPostures { finger: HumanFinger::Middle, postures: 0, .. })
    ));
    let solved = calibration.solve_with_proportions(&flat).unwrap();
    for (number, limit) in [(0, 5e-4), (1, 5e-4), (2, 2e-3), (3, 2e-3), (4, 5e-4)] {
        for rotations in all_movements().map(posture) {
            let miss = distance(solved[number].0.tip(&rotations), hand[number].tip(&rotations));
            assert!(miss < limit, "{number}: {miss}");
        }
        assert_eq!(solved[number].1.tip_deviation > MAX_TIP_DEVIATION, [2, 3].contains(&number));
    }
    let settings = CalibrationSettings { orientation_noise: 0.002, ..CalibrationSettings::DEFAULT };
    let mut one_marker = HandCalibration::try_new(&settings).unwrap();
    for rotations in all_movements().map(posture) {
        let markers = [Some(hand[0].tip(&rotations)), None, None, None, None];
        one_marker.add_posture(&relative_sample(&rotations), &markers).unwrap();
    }
    assert_eq!(one_marker.solve_with_proportions(&flat), Err(CalibrationError::TooFewFingers));
}

/// A ring finger whose knuckle is 8 mm from its position in the mean hand.
#[test]
fn touches_of_the_thumb_correct_the_proportions() {
    let mut hand = large_hand();
    hand[3].0[0][2] -= 0.008;
    let mut calibration = three_markers(&hand);
    let flat = relative_sample(&posture([0.0; 4]));
    let worst = |calibration: &HandCalibration| {
        let links = calibration.solve_with_proportions(&flat).unwrap()[3].0;
        let misses = all_movements().map(|angles| {
            let rotations = posture(angles);
            distance(links.tip(&rotations), hand[3].tip(&rotations))
        });
        misses.fold(0.0, f32::max)
    };
    let before = worst(&calibration);
    for angles in all_movements().step_by(3) {
        // The thumb is placed so that its tip is at the ring finger's.
        let rotations = posture(angles);
        let place = hand[3].tip(&rotations);
        calibration.finger_mut(HumanFinger::Ring).add_contact(&rotations, place, 2e-3).unwrap();
    }
    let after = worst(&calibration);
    assert!(before > 6e-3 && after < 2e-3, "{before} {after}");
    let mut fresh = HandCalibration::try_new(&CalibrationSettings::DEFAULT).unwrap();
    assert!(fresh.add_touch(HumanFinger::Ring, &flat, 2e-3).is_err(), "the thumb is not calibrated");
}
