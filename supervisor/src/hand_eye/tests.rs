use tesaki_rng::Rng;

use super::*;

/// Rows; value and standard deviation of the camera, and of the rose's centre; rejected rows; residuals.
type Oracle = (&'static [[f64; 10]], [(f64, f64); 7], [(f64, f64); 3], &'static [usize], [f64; 2]);
const ORACLE: Oracle = include!("../../../tests/oracles/data/hand_eye.in");

/// As in robots/knob-arm, but mounted slightly askew.
const CAMERA: HandEyeCamera =
    HandEyeCamera { position: [0.05, 0.004, -0.12], tilt: 0.175, pan: -0.03, turn: 0.06, focal: 140.0 };
/// In front of the base.
const ROSE: Rose = Rose { center: [0.93, 0.1, 0.15], normal: [1.0, 0.0, 0.0] };

fn settings() -> HandEyeSettings {
    HandEyeSettings::for_pictures([256, 240], 0.04)
}

/// Ranges of the motions of the hand: distance from the rose [m], offset relative to the camera's distance,
/// angles about the hand's axes [rad].
#[derive(Clone, Copy)]
struct Motions {
    distance: [f64; 2],
    aside: f64,
    turned: [f64; 3],
}

const FULL: Motions = Motions { distance: [0.04, 0.28], aside: 0.3, turned: [0.2, 0.2, 0.4] };

/// Returns the observations from a number of random poses, with normally distributed noise [px].
fn observations(number: usize, motions: Motions, noise: f64, seed: u64) -> Vec<Observation> {
    let mut rng = Rng::new(seed, 0);
    // The approach direction is the base's x, and the hand's x points upwards.
    let level = Matrix3::new(0.0, 0.0, 1.0, 0.0, -1.0, 0.0, 1.0, 0.0, 0.0);
    let level = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(level));
    let mut observations = Vec::new();
    for _ in 0..100 * number {
        let [near, far] = motions.distance;
        let distance = 0.5 * (near + far) + 0.5 * (far - near) * rng.symmetric();
        let aside = motions.aside * (distance + 0.1);
        let offset = Vector3::new(-distance, aside * rng.symmetric(), aside * rng.symmetric());
        let turn = UnitQuaternion::new(Vector3::from(motions.turned.map(|most| most * rng.symmetric())));
        let orientation = (level * turn).coords.into();
        let position = (Vector3::from(ROSE.center) + offset).into();
        let hand = Isometry3::from_parts(Translation3::from(position), level * turn);
        let Some(seen) = seen(&settings(), &CAMERA, &ROSE, &hand) else { continue };
        let mut noisy = |value: f64| value + noise * rng.normal();
        let center = seen.center.map(&mut noisy);
        observations.push(Observation { position, orientation, center, radius: noisy(seen.radius) });
        if observations.len() == number {
            break;
        }
    }
    observations
}

fn values(camera: &HandEyeCamera) -> [f64; 7] {
    let [x, y, z] = camera.position;
    [x, y, z, camera.tilt, camera.pan, camera.turn, camera.focal]
}

#[test]
fn exact_circles_give_the_exact_camera() {
    for (number, seed) in [(8, 1), (40, 2)] {
        let found = calibrate(&observations(number, FULL, 0.0, seed), &settings()).unwrap();
        for (found, truth) in values(&found.camera).into_iter().zip(values(&CAMERA)) {
            assert!((found - truth).abs() < 1e-6, "{found} instead of {truth}");
        }
        for axis in 0..3 {
            assert!((found.rose.center[axis] - ROSE.center[axis]).abs() < 1e-6);
            assert!((found.rose.normal[axis] - ROSE.normal[axis]).abs() < 1e-6);
        }
        assert!(found.rejected.is_empty() && found.residuals.iter().all(|residual| *residual < 1e-6));
    }
}

#[test]
fn noisy_circles_give_the_camera_within_its_standard_deviations() {
    let mut offsets = Vec::new();
    for seed in 1..=20 {
        let found = calibrate(&observations(40, FULL, 0.3, seed), &settings()).unwrap();
        let of_camera = values(&found.camera).into_iter().zip(values(&CAMERA)).zip(values(&found.deviation));
        let of_rose = found.rose.center.into_iter().zip(ROSE.center).zip(found.rose_deviation);
        offsets
            .extend(of_camera.chain(of_rose).map(|((found, truth), deviation)| (found - truth) / deviation));
        let [center, radius] = found.residuals;
        assert!((0.3..0.5).contains(&center) && (0.2..0.4).contains(&radius), "{center} {radius}");
    }
    let beyond = offsets.iter().filter(|offset| offset.abs() > 3.0).count();
    let rms = (offsets.iter().map(|offset| offset * offset).sum::<f64>() / 200.0).sqrt();
    assert!(offsets.len() == 200 && beyond <= 2 && (0.8..1.2).contains(&rms), "{beyond} beyond, {rms}");
}

#[test]
fn it_agrees_with_scipy_and_rejects_the_same_rows() {
    let (rows, camera, rose, rejected, residuals) = ORACLE;
    let observation = |row: &[f64; 10]| {
        let &[x, y, z, i, j, k, w, u, v, radius] = row;
        Observation { position: [x, y, z], orientation: [i, j, k, w], center: [u, v], radius }
    };
    let rows: Vec<Observation> = rows.iter().map(observation).collect();
    let found = calibrate(&rows, &settings()).unwrap();
    let indices: Vec<usize> = found.rejected.iter().map(|(row, _)| *row).collect();
    assert_eq!(indices, rejected);
    let found_values = values(&found.camera).into_iter().chain(found.rose.center);
    let deviations = values(&found.deviation).into_iter().chain(found.rose_deviation);
    for ((value, deviation), (other, expected)) in
        found_values.zip(deviations).zip(camera.into_iter().chain(rose))
    {
        assert!((value - other).abs() < 0.01 * expected, "{value} instead of {other} ± {expected}");
        assert!((deviation / expected - 1.0).abs() < 0.01, "± {deviation} instead of {expected}");
    }
    assert!(
        (0..2).all(|axis| (found.residuals[axis] - residuals[axis]).abs() < 1e-4),
        "{:?}",
        found.residuals
    );
}

#[test]
fn circles_of_the_knob_are_left_out() {
    for (every, seed) in [(20, 1), (5, 2), (4, 3)] {
        let mut rows = observations(40, FULL, 0.3, seed);
        let wrong: Vec<usize> = (0..40).step_by(every).collect();
        for &row in &wrong {
            // The other circle is nearer and smaller.
            let radius = rows[row].radius;
            rows[row].center[0] += 0.3 * radius;
            rows[row].center[1] -= 0.2 * radius;
            rows[row].radius = 0.85 * radius;
        }
        let found = calibrate(&rows, &settings()).unwrap();
        let rejected: Vec<usize> = found.rejected.iter().map(|(row, _)| *row).collect();
        assert_eq!(rejected, wrong);
        let offsets = values(&found.camera).into_iter().zip(values(&CAMERA));
        for ((found, truth), deviation) in offsets.zip(values(&found.deviation)) {
            assert!((found - truth).abs() < 3.5 * deviation, "{found} ± {deviation}: {truth}");
        }
    }
}

#[test]
fn a_camera_that_is_mounted_any_way_round_is_found() {
    for turn in [-1.4, 1.7, 3.0, 3.3, -2.6] {
        let camera = HandEyeCamera { turn, ..CAMERA };
        let mut rows = observations(20, FULL, 0.0, 1);
        for row in &mut rows {
            let hand = row.hand().unwrap();
            let Appearance { center, radius, .. } = seen(&settings(), &camera, &ROSE, &hand).unwrap();
            (row.center, row.radius) = (center, radius);
        }
        let found = calibrate(&rows, &settings()).unwrap();
        let off = (found.camera.turn - turn).sin();
        assert!(off.abs() < 1e-6, "{} instead of {turn}", found.camera.turn);
        found.table().unwrap();
    }
}

#[test]
fn the_table_tells_where_a_rose_before_the_hand_is() {
    let found = calibrate(&observations(40, FULL, 0.0, 1), &settings()).unwrap();
    let table = found.table().unwrap();
    for distance in [0.02, 0.05, 0.11, 0.2, 0.3] {
        let truth = CAMERA.ahead(&settings(), distance).unwrap();
        let (center, radius) = table.appearance(&[0.0, 0.0, single(distance)], 0.04);
        for (center, truth) in center.into_iter().zip(truth.center) {
            assert!((f64::from(center) - truth).abs() < 0.05, "{distance} m");
        }
        assert!((f64::from(radius) - truth.radius).abs() < 0.05, "{distance} m");
    }
    // The file is read back as it was written.
    let (read, findings) =
        tesaki_description::hand_eye::check(std::path::Path::new("hand_eye.toml"), &found.to_toml("a\ntest"));
    let read = read.unwrap_or_else(|| panic!("{findings:?}"));
    assert_eq!(read.size, Some([256, 240]));
    let place = [0.01, -0.02, 0.15];
    let [(one, radius), (other, other_radius)] =
        [&table, &read.table].map(|table| table.appearance(&place, 0.04));
    assert!(
        (0..2).all(|axis| (one[axis] - other[axis]).abs() < 1e-3) && (radius - other_radius).abs() < 1e-3
    );
}

#[expect(clippy::cast_possible_truncation, reason = "metres")]
fn single(value: f64) -> f32 {
    value as f32
}

#[test]
fn the_motion_that_is_missing_is_named() {
    let missing = |motions: Motions| match calibrate(&observations(40, motions, 0.3, 5), &settings()) {
        Err(HandEyeFailure::Undetermined { motions, deviation }) if deviation > MAX_DEVIATION => motions,
        other => panic!("{other:?}"),
    };
    let one_distance = Motions { distance: [0.15, 0.15], ..FULL };
    assert_eq!(missing(one_distance), [Motion::Approach]);
    assert_eq!(missing(Motions { aside: 0.0, ..one_distance }), [Motion::Approach]);
    let none = Motions { turned: [0.0; 3], ..FULL };
    assert_eq!(missing(none), [Motion::AboutY, Motion::AboutZ]);
    assert_eq!(missing(Motions { turned: [0.2, 0.0, 0.0], ..FULL }), [Motion::AboutZ]);
    assert_eq!(missing(Motions { turned: [0.0, 0.0, 0.4], ..FULL }), [Motion::AboutY]);
    assert_eq!(missing(Motions { aside: 0.0, ..none }).len(), 2);
    let still = missing(Motions { distance: [0.15, 0.15], aside: 0.0, ..none });
    assert!(still.len() > 2 && still.contains(&Motion::Approach), "{still:?}");
    let error = calibrate(&observations(40, none, 0.3, 5), &settings()).unwrap_err().to_string();
    assert!(
        error.contains("add pictures with the hand turned about its y, turned about its approach z"),
        "{error}"
    );
}

#[test]
fn what_cannot_be_is_refused() {
    let good = observations(20, FULL, 0.1, 1);
    assert_eq!(calibrate(&good[..5], &settings()), Err(HandEyeFailure::TooFew { got: 5 }));
    let refused = |change: &dyn Fn(&mut Observation), words: &str| {
        let mut rows = good.clone();
        change(&mut rows[7]);
        match calibrate(&rows, &settings()) {
            Err(HandEyeFailure::Row { row: 7, problem }) => assert!(problem.contains(words), "{problem}"),
            other => panic!("{words}: {other:?}"),
        }
    };
    refused(&|row| row.position[1] = f64::NAN, "a position of NaN m");
    refused(&|row| row.position[1] = 720.0, "a position of 720 m: is it in metres?");
    refused(&|row| row.orientation = [0.0; 4], "a quaternion of norm 0.0000");
    refused(&|row| row.orientation = [0.7; 4], "a quaternion of norm 1.4000: it must be 1");
    refused(&|row| row.center[0] = f64::INFINITY, "a centre at inf px");
    refused(&|row| row.radius = -3.0, "a radius of -3 px");
    // A rose that moves between pictures, and positions in other units.
    let mut moved = good.clone();
    let mut rng = Rng::new(1, 1);
    moved.iter_mut().for_each(|row| row.center = row.center.map(|place| place + 30.0 * rng.symmetric()));
    let error = calibrate(&moved, &settings()).unwrap_err();
    assert!(matches!(error, HandEyeFailure::NoFit { of: 20, .. }), "{error}");
    for (change, words) in [
        (HandEyeSettings { rose: 40.0, ..settings() }, "the radius of the rose [m] is 40"),
        (HandEyeSettings { focal: [f64::NAN; 2], ..settings() }, "the focal length [px] is NaN"),
        (HandEyeSettings { distances: [0.3, 0.02], ..settings() }, "the largest distance [m] is 0.02"),
        (HandEyeSettings { principal: [-1.0, 5.0], ..settings() }, "the principal point [px] is -1"),
        (HandEyeSettings { distances: [-0.2, 0.3], ..settings() }, "does not see a rose that is -0.2 m"),
    ] {
        let error = calibrate(&good, &change).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
}
