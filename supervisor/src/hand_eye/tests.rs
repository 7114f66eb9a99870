use tesaki_rng::Rng;

use super::*;

/// As in robots/knob-arm, but mounted a little askew.
const CAMERA: HandEyeCamera =
    HandEyeCamera { position: [0.05, 0.004, -0.12], tilt: 0.175, pan: -0.03, turn: 0.06, focal: 140.0 };
/// In front of the base.
const ROSE: Rose = Rose { center: [0.93, 0.1, 0.15], normal: [1.0, 0.0, 0.0] };

fn settings() -> HandEyeSettings {
    HandEyeSettings::for_pictures([256, 240], 0.04)
}

/// Ranges of the motions of the hand: distances before the rose [m], offset over the camera's distance, angles about
/// the hand's axes [rad].
#[derive(Clone, Copy)]
struct Motions {
    distance: [f64; 2],
    aside: f64,
    turned: [f64; 3],
}

const FULL: Motions = Motions { distance: [0.04, 0.28], aside: 0.3, turned: [0.2, 0.2, 0.4] };

/// What the camera sees from a number of random poses, with normally distributed noise [px].
fn observations(number: usize, motions: Motions, noise: f64, seed: u64) -> Vec<Observation> {
    let mut rng = Rng::new(seed, 0);
    // The approach along the base's x, the hand's x upwards.
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
            assert!((found - truth).abs() < 1e-6, "{:?}", found);
        }
        for axis in 0..3 {
            assert!((found.rose.center[axis] - ROSE.center[axis]).abs() < 1e-6);
            assert!((found.rose.normal[axis] - ROSE.normal[axis]).abs() < 1e-6);
        }
        assert!(found.rejected.is_empty() && found.residuals.iter().all(|residual| *residual < 1e-6));
    }
}

#[test]
fn outliers() {
    for (share, seed) in [(20, 1), (5, 2), (3, 3), (3, 4), (3, 5)] {
        let mut all = observations(40, FULL, 0.3, seed);
        for row in (0..40).step_by(share) {
            // The end of a knob: nearer, smaller.
            all[row].center[0] += 0.3 * all[row].radius;
            all[row].center[1] -= 0.2 * all[row].radius;
            all[row].radius *= 0.85;
        }
        match calibrate(&all, &settings()) {
            Ok(found) => {
                let ratio: Vec<f64> = values(&found.camera)
                    .iter()
                    .zip(values(&CAMERA))
                    .zip(values(&found.deviation))
                    .map(|((a, b), c)| (a - b) / c)
                    .collect();
                println!("{share}: {:?} {ratio:.2?}", found.rejected);
            }
            Err(error) => println!("{share}: {error}"),
        }
    }
}

#[test]
fn explore() {
    for (name, motions, number) in [
        ("full", FULL, 40),
        ("full 8", FULL, 8),
        ("full 6", FULL, 6),
        ("one distance", Motions { distance: [0.15, 0.15], ..FULL }, 40),
        ("one distance, not aside", Motions { distance: [0.15, 0.15], aside: 0.0, ..FULL }, 40),
        ("not aside", Motions { aside: 0.0, ..FULL }, 40),
        ("not turned", Motions { turned: [0.0; 3], ..FULL }, 40),
        ("x only", Motions { turned: [0.2, 0.0, 0.0], ..FULL }, 40),
        ("y only", Motions { turned: [0.0, 0.2, 0.0], ..FULL }, 40),
        ("z only", Motions { turned: [0.0, 0.0, 0.4], ..FULL }, 40),
        ("little", Motions { turned: [0.05; 3], ..FULL }, 40),
        ("one distance little", Motions { distance: [0.15, 0.15], turned: [0.05; 3], ..FULL }, 40),
        ("none", Motions { distance: [0.15, 0.15], turned: [0.0; 3], aside: 0.0 }, 40),
        ("only distance", Motions { turned: [0.0; 3], aside: 0.0, ..FULL }, 40),
    ] {
        for noise in [0.0, 0.3] {
            let start = std::time::Instant::now();
            match calibrate(&observations(number, motions, noise, 5), &settings()) {
                Ok(found) => {
                    let ratio: Vec<f64> = values(&found.camera)
                        .iter()
                        .zip(values(&CAMERA))
                        .zip(values(&found.deviation))
                        .map(|((a, b), c)| (a - b) / c)
                        .collect();
                    println!(
                        "{name} {noise}: {:?} table {:.4} rejected {:?} res {:.3?} ratio {ratio:.2?} {:?}",
                        values(&found.deviation),
                        found.table_deviation,
                        found.rejected,
                        found.residuals,
                        start.elapsed()
                    );
                }
                Err(error) => println!("{name} {noise}: {error} {:?}", start.elapsed()),
            }
        }
    }
}
