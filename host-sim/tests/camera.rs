//! The hand-eye camera before the door.
#![allow(
    clippy::unwrap_used,
    clippy::indexing_slicing,
    clippy::cast_precision_loss,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "tests"
)]

use rapier3d::na::{Isometry3, Quaternion, Translation3, UnitQuaternion};
use tesaki_description::hand_eye::HandEyeFile;
use tesaki_sim::camera::{Camera, CameraValues, Circle, Ellipse, Finish, Optics, Scene, Texture, View};

type Row = ([f64; 3], [f64; 4], f64, f64, [[f64; 2]; 8], [f64; 2], [f64; 2]);
const ROWS: &[Row] = include!("../../tests/oracles/data/camera.in");

const CAMERA: Camera = Camera { width: 256, height: 240, focal: 140.0, principal: [127.5, 119.5] };

fn pose([x, y, z]: [f64; 3], [i, j, k, w]: [f64; 4]) -> Isometry3<f64> {
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, i, j, k));
    Isometry3::from_parts(Translation3::new(x, y, z), turn)
}

fn distance([x, y]: [f64; 2], [u, v]: [f64; 2]) -> f64 {
    (x - u).hypot(y - v)
}

fn folder() -> std::path::PathBuf {
    std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/knob-arm")
}

fn robot() -> CameraValues {
    CameraValues::load(&folder()).unwrap()
}

#[test]
fn points_and_ellipses_are_those_of_opencv() {
    for (position, turn, height, radius, points, center, semi_axes) in ROWS {
        let to_camera = pose(*position, *turn).inverse();
        let circle = Circle::about_z(*height, *radius).transformed(&to_camera);
        for (point, expected) in (0..8).zip(points) {
            let angle = f64::from(point) * core::f64::consts::FRAC_PI_4;
            let image = CAMERA.project(&circle.point(angle)).unwrap();
            assert!(distance(image, *expected) < 1e-5, "{image:?} {expected:?}");
        }
        let ellipse = circle.image(&CAMERA).unwrap();
        // OpenCV fits in single precision.
        assert!(distance(ellipse.center, *center) < 2e-3, "{ellipse:?} {center:?}");
        for (axis, expected) in ellipse.semi_axes.iter().zip(semi_axes) {
            assert!((axis - expected).abs() < 2e-3, "{ellipse:?} {semi_axes:?}");
        }
    }
}

/// A flat white rose on a black door, without lamps.
fn flat() -> Scene {
    let mut scene = Scene::draw(1);
    let matt = |diffuse| Finish { diffuse, specular: 0.0, along: 0.1, across: 0.1, stains: 0.0 };
    (scene.rose.thickness, scene.rose.chamfer, scene.rose.finish) = (2e-5, 0.0, matt(0.8));
    (scene.knob.radius, scene.knob.length, scene.knob.chamfer) = (1e-4, 3e-5, 0.0);
    (scene.knob.button, scene.knob.finish) = (0.0, matt(0.8));
    (scene.door.diffuse, scene.door.texture, scene.door.contrast) = (0.1, Texture::Paint, 0.0);
    scene.lamps.iter_mut().for_each(|lamp| lamp.brightness = 0.0);
    scene.windows.iter_mut().for_each(|window| window.1 = 0.0);
    scene.door.edge = 1.0;
    scene
}

/// Smoothed by 1 2 1 in both directions: interpolation between the pixels of a sharp edge is not exact.
fn smoothed(image: &[f32]) -> Vec<f32> {
    let around = |from: &[f32], step: usize| -> Vec<f32> {
        let at = |index: usize| from[index.min(from.len() - 1)];
        let mean =
            |index: usize| 0.25 * (at(index.saturating_sub(step)) + 2.0 * at(index) + at(index + step));
        (0..from.len()).map(mean).collect()
    };
    around(&around(image, 1), CAMERA.width)
}

/// Where the edge of a bright ellipse is, along the normal at an angle, off the ellipse [px]: by the integral
/// of the brightness from 4 px inside to 4 px outside.
fn edge(radiances: &[f32], ellipse: &Ellipse, angle: f64) -> f64 {
    let ([major, minor], turn) = (ellipse.semi_axes, ellipse.angle);
    let rotate = |[x, y]: [f64; 2]| [x * turn.cos() - y * turn.sin(), x * turn.sin() + y * turn.cos()];
    let [x, y] = rotate([major * angle.cos(), minor * angle.sin()]);
    let [nx, ny] = rotate([angle.cos() / major, angle.sin() / minor]);
    let norm = nx.hypot(ny);
    let at = |along: f64| {
        let [u, v] = [ellipse.center[0] + x + along * nx / norm, ellipse.center[1] + y + along * ny / norm];
        let (column, row) = (u.floor(), v.floor());
        let (right, down) = (u - column, v - row);
        let pixel = |dx: usize, dy: usize| {
            f64::from(radiances[(row as usize + dy) * CAMERA.width + column as usize + dx])
        };
        (1.0 - down) * ((1.0 - right) * pixel(0, 0) + right * pixel(1, 0))
            + down * ((1.0 - right) * pixel(0, 1) + right * pixel(1, 1))
    };
    const STEPS: i32 = 800;
    let (inside, outside) = (at(-4.0), at(4.0));
    let step = 8.0 / f64::from(STEPS);
    let sum: f64 = (0..STEPS).map(|index| at(-4.0 + (f64::from(index) + 0.5) * step) - outside).sum();
    sum * step / (inside - outside) - 4.0
}

#[test]
fn the_rendered_edge_of_the_rose_is_the_analytic_ellipse() {
    let scene = flat();
    for seed in 1..=6 {
        let pose = View::draw(seed).hand * robot().mount();
        let radiances = smoothed(&scene.radiances(&CAMERA, &pose, &[]));
        let ellipse = scene.rose_rim().transformed(&pose.inverse()).image(&CAMERA).unwrap();
        let angles = (0..90).map(|index| f64::from(index) * core::f64::consts::TAU / 90.0);
        // Pixel, smoothing and interpolation blur with the variances 1/12, 1/2 and 1/6 px², which draws the
        // edge of a disc inwards by the variance over the diameter.
        let bias = 0.75 / (2.0 * ellipse.radius());
        let errors: Vec<f64> = angles.map(|angle| edge(&radiances, &ellipse, angle) + bias).collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let largest = errors.iter().fold(0.0_f64, |largest, error| largest.max(error.abs()));
        assert!(mean.abs() < 0.02 && largest < 0.05, "seed {seed}: mean {mean}, largest {largest}");
    }
}

#[test]
fn the_hand_starts_where_the_rose_has_the_radius_of_the_papers_sample() {
    // Hand 15 cm before the knob's tip, rose 40 mm: R = 17 px (Knob section 4.4).
    let mut scene = Scene::draw(1);
    scene.rose.radius = 0.04;
    let pose = Isometry3::translation(0.0, 0.0, -0.21) * robot().mount();
    let rose = scene.truth(&Camera::of(&robot()), &pose, &[]).rose.unwrap();
    assert!((rose.radius - 17.0).abs() < 0.3, "{rose:?}");
    assert!((rose.center[0] - 127.5).abs() < 1e-6 && rose.center[1] < 119.5, "{rose:?}");
}

#[test]
fn the_knob_and_the_border_of_the_image_hide_parts_of_the_rose() {
    let scene = Scene::draw(1);
    let share = |up: f64, right: f64| {
        let pose = Isometry3::translation(up, right, -0.21) * robot().mount();
        scene.truth(&CAMERA, &pose, &[]).rose.unwrap().visible
    };
    // From high above, the knob stands before the lower part.
    assert!(share(0.1, 0.0) < share(-0.05, 0.0));
    // Half of the rose is beside an image that is 128 px wide from its middle: 0.3 m at a depth of about 0.33
    // m.
    let half = share(-0.05, 0.301);
    assert!((0.2..0.8).contains(&half), "{half}");
    assert!(share(-0.05, 0.5) < 1e-9);
}

#[test]
fn a_seed_means_the_same_picture_and_another_another() {
    let picture = |seed, number| {
        let (view, values) = (View::draw(seed), robot());
        let pose = view.hand * values.mount();
        let (optics, fingers) = (Optics::draw(seed), view.fingers(0.2));
        Scene::draw(seed).photograph(&Camera::of(&values), &optics, &pose, &fingers, (seed, number)).pixels
    };
    let first = picture(3, 0);
    assert!(first == picture(3, 0) && first != picture(4, 0));
    // The same but for the noise.
    let changed = first.iter().zip(picture(3, 1)).map(|(one, other)| one.abs_diff(other));
    assert!(changed.clone().any(|difference| difference > 0) && changed.max().unwrap() < 40);
}

#[test]
fn a_wrong_camera_file_says_what_and_where() {
    let folder = tempfile::tempdir().unwrap();
    let load = |text: &str| {
        std::fs::write(folder.path().join("camera.toml"), text).unwrap();
        CameraValues::load(folder.path()).unwrap_err().to_string()
    };
    let text = "size = [256, 240]\nfocal = 0.0\nprincipal = [127.5, 119.5]\nposition = [0.0, 0.0, 0.0]\ntilt = 0.1\n";
    assert!(load(text).contains("camera.toml:2: focal is 0: it must be above 0 [px]"), "{}", load(text));
    assert!(load("size = 3").contains("camera.toml:1: "), "{}", load("size = 3"));
    let missing = CameraValues::load(&folder.path().join("none")).unwrap_err().to_string();
    assert!(missing.contains("has a camera.toml in its folder"), "{missing}");
}

/// Knob section 4.5 needs the place of the rose in millimetres.
#[test]
fn the_calibrated_table_of_the_arm_is_that_of_its_camera() {
    let HandEyeFile { table, size } = tesaki_description::hand_eye::load(&folder()).unwrap();
    let values = robot();
    assert_eq!(size, Some(values.size));
    let (mut largest_center, mut largest_place) = (0.0_f64, 0.0_f64);
    for step in 0..=28 {
        let distance = 0.02 + 0.01 * f64::from(step);
        for rose in [0.035, 0.04, 0.045] {
            let circle = Circle::about_z(distance, rose).transformed(&values.mount().inverse());
            let truth = circle.image(&Camera::of(&values)).unwrap();
            let place = [0.0, 0.0, distance as f32];
            let (center, radius) = table.appearance(&place, rose as f32);
            largest_center = largest_center.max(self::distance(center.map(f64::from), truth.center));
            largest_center = largest_center.max((f64::from(radius) - truth.radius()).abs());
            let seen = tesaki::vision::Circle {
                center: truth.center.map(|place| place as f32),
                radius: truth.radius() as f32,
                semi_axes: truth.semi_axes.map(|axis| axis as f32),
                angle: 0.0,
                confidence: 1.0,
            };
            let located = table.locate(&seen, rose as f32);
            for (located, place) in located.into_iter().zip(place) {
                largest_place = largest_place.max(f64::from((located - place).abs()));
            }
        }
    }
    assert!(largest_center < 1.0 && largest_place < 2e-3, "{largest_center} px, {largest_place} m");
}
