#![allow(clippy::unwrap_used, reason = "tests")]

use tesaki_rng::Rng;

use super::choice::{Candidate, best};
use super::ellipse::Ellipse;
use super::judge::weigh;
use super::offset::{Context, INPUTS};
use super::refit::refined;
use super::*;
use crate::math;

const WIDTH: usize = 256;
const HEIGHT: usize = 240;

/// Images and their ground truth, by OpenCV and NumPy: width, height, expected radius from, to; true centre
/// x, y, radius; OpenCV's centre x, y, radius.
type Row = (usize, usize, f32, f32, f32, f32, f32, f32, f32, f32);
const ROWS: &[Row] = include!("../../../tests/oracles/data/find_circle.in");
const PIXELS: &[u8] = include_bytes!("../../../tests/oracles/data/find_circle.bin");

/// Candidates of pictures, by NumPy: index of the likeliest, its confidence; for each its circle, its
/// features and those of the end of a knob in front of it, and the log-odds.
type Judged = (usize, f32, &'static [([f32; 3], [f32; 16], Option<[f32; 12]>, f32)]);
const JUDGED: &[Judged] = include!("../../../tests/oracles/data/circle_choice.in");

/// The open rays of a ring, by NumPy: direction, inputs of the network, the distance of the rim [px], its
/// weight.
type Rays = &'static [([f32; 2], [f32; INPUTS], f32, f32)];
/// Radius [px] and flattening of an ellipse, the open rays, and the change of radius and centre [px].
#[allow(clippy::approx_constant, reason = "numbers that a program wrote")]
const RIM: (f32, [f32; 2], Rays, [f32; 3]) = include!("../../../tests/oracles/data/rim_offset.in");

/// An ellipse of one grey level.
struct Disc {
    center: [f32; 2],
    semi_axes: [f32; 2],
    grey: f32,
}

impl Disc {
    const fn round(x: f32, y: f32, radius: f32, grey: f32) -> Self {
        Self { center: [x, y], semi_axes: [radius, radius], grey }
    }

    fn covers(&self, x: f32, y: f32) -> bool {
        let (u, v) = ((x - self.center[0]) / self.semi_axes[0], (y - self.center[1]) / self.semi_axes[1]);
        u * u + v * v < 1.0
    }
}

/// Discs over a background with a slope, each pixel the mean of 8 × 8 points, with noise.
fn draw(discs: &[Disc], background: f32, noise: f64, seed: u64) -> Vec<u8> {
    let mut rng = Rng::new(seed, 0);
    let mut pixels = Vec::new();
    for y in 0..HEIGHT {
        for x in 0..WIDTH {
            let mut sum = 0.0;
            for sample in 0..64_u8 {
                let part = |index: u8| (f32::from(index) + 0.5) / 8.0 - 0.5;
                let (x, y) = (x as f32 + part(sample % 8), y as f32 + part(sample / 8));
                let top = discs.iter().rev().find(|disc| disc.covers(x, y));
                sum += top.map_or(background + 0.05 * x, |disc| disc.grey);
            }
            let grey = sum / 64.0 + (noise * rng.normal()) as f32;
            pixels.push(math::clamp(math::round(grey), 0.0, 255.0) as u8);
        }
    }
    pixels
}

fn find_in(pixels: &[u8], radius: [f32; 2], window: Option<Window>) -> Option<Circle> {
    let mut buffers = Box::new(CameraBuffers::new());
    let image = Image::try_new(pixels, WIDTH, HEIGHT).unwrap();
    find_circle(&image, &CircleSearch { radius, window, axis: None }, &mut buffers.scratch()).unwrap()
}

fn apart(one: [f32; 2], other: [f32; 2]) -> f32 {
    let [dx, dy] = [one[0] - other[0], one[1] - other[1]];
    math::sqrt(dx * dx + dy * dy)
}

fn assert_near(found: Option<Circle>, [x, y, radius]: [f32; 3], tolerance: f32) {
    let circle = found.unwrap();
    let errors = [circle.center[0] - x, circle.center[1] - y, circle.radius - radius];
    assert!(errors.iter().all(|error| error.abs() < tolerance), "{circle:?}, not ({x}, {y}), {radius}");
}

#[test]
fn a_disc_is_found_to_a_tenth_of_a_pixel_at_every_radius() {
    for (seed, radius) in (0..).zip([8.0, 15.3, 22.0, 31.7, 45.2, 60.1, 75.5, 90.0, 105.0]) {
        let disc = Disc::round(120.3, 118.8, radius, 170.0);
        let pixels = draw(&[disc], 100.0, 2.0, seed);
        assert_near(find_in(&pixels, [0.7 * radius, 1.3 * radius], None), [120.3, 118.8, radius], 0.12);
    }
}

#[test]
fn weak_noisy_discs_are_found() {
    for seed in 0..5 {
        let pixels = draw(&[Disc::round(90.6, 131.2, 40.0, 120.0)], 95.0, 6.0, seed);
        assert_near(find_in(&pixels, [25.0, 60.0], None), [90.6, 131.2, 40.0], 0.5);
    }
}

#[test]
fn the_ellipse_of_an_oblique_disc_is_found() {
    let disc = Disc { center: [130.2, 121.7], semi_axes: [50.0, 48.5], grey: 60.0 };
    let circle = find_in(&draw(&[disc], 130.0, 1.0, 1), [35.0, 70.0], None).unwrap();
    assert_near(Some(circle), [130.2, 121.7, math::sqrt(50.0 * 48.5)], 0.1);
    assert!(
        (circle.semi_axes[0] - 50.0).abs() < 0.2 && (circle.semi_axes[1] - 48.5).abs() < 0.2,
        "{circle:?}"
    );
    assert!(
        circle.angle.abs() < 0.1 || (circle.angle.abs() - core::f32::consts::PI).abs() < 0.1,
        "{circle:?}"
    );
}

#[test]
fn of_concentric_circles_the_outermost_is_found() {
    // The rose, and a knob with much more contrast that partly hides it.
    let rose = Disc::round(120.0, 110.0, 50.0, 130.0);
    let knob = Disc::round(126.0, 118.0, 36.0, 240.0);
    let pixels = draw(&[rose, knob], 100.0, 3.0, 1);
    assert_near(find_in(&pixels, [30.0, 70.0], None), [120.0, 110.0, 50.0], 0.3);
    // The depth excludes the rose.
    assert_near(find_in(&pixels, [30.0, 42.0], None), [126.0, 118.0, 36.0], 0.3);
}

/// A knob whose end is as large as its rose in the picture and hides four tenths of its rim: only the axis
/// distinguishes them.
#[test]
fn a_rose_behind_its_knob_is_found_along_the_axis() {
    let rose = Disc::round(126.0, 120.0, 26.0, 130.0);
    let knob = Disc::round(124.0, 136.0, 26.0, 60.0);
    let pixels = draw(&[rose, knob], 170.0, 2.0, 1);
    let image = Image::try_new(&pixels, WIDTH, HEIGHT).unwrap();
    let mut buffers = Box::new(CameraBuffers::new());
    // The vanishing point is (128, 90), the limit of rose and knob at infinity; known to 5 px.
    for center in [[128.0, 90.0], [132.0, 88.0], [125.0, 94.0]] {
        let axis = Some(Window { center, reach: 5.0 });
        let search = CircleSearch { radius: [19.0, 34.0], window: None, axis };
        let found = find_circle(&image, &search, &mut buffers.scratch()).unwrap();
        assert_near(found, [126.0, 120.0, 26.0], 0.5);
    }
    // Without a rose, only the end of the knob can be found.
    let pixels = draw(&[Disc::round(124.0, 136.0, 26.0, 60.0)], 170.0, 2.0, 1);
    let image = Image::try_new(&pixels, WIDTH, HEIGHT).unwrap();
    let axis = Some(Window { center: [128.0, 90.0], reach: 5.0 });
    let search = CircleSearch { radius: [19.0, 34.0], window: None, axis };
    assert_near(find_circle(&image, &search, &mut buffers.scratch()).unwrap(), [124.0, 136.0, 26.0], 0.3);
}

/// A rose on a door with its soft shadow, which is larger and has more contrast.
#[test]
fn a_soft_shadow_is_not_taken_for_the_rim() {
    let [shadow_x, shadow_y, shadow_radius] = [122.0, 116.0, 38.0_f32];
    for (seed, grey) in [(1, 150.0), (2, 175.0), (3, 45.0)] {
        let mut pixels = draw(&[], 130.0, 1.5, seed);
        let rose = draw(&[Disc::round(120.3, 110.8, 30.2, grey)], 0.0, 0.0, seed);
        for (index, pixel) in pixels.iter_mut().enumerate() {
            let [x, y] = [(index % WIDTH) as f32, (index / WIDTH) as f32];
            // From 60 % of the light to all of it within 12 px.
            let away = (apart([x, y], [shadow_x, shadow_y]) - shadow_radius) / 12.0 + 0.5;
            let light = 0.6 + 0.4 * math::clamp(away, 0.0, 1.0);
            let share = math::clamp((f32::from(rose[index]) - 0.05 * x) / (grey - 0.05 * x), 0.0, 1.0);
            *pixel = math::round(share * grey + (1.0 - share) * light * f32::from(*pixel)) as u8;
        }
        assert_near(find_in(&pixels, [22.0, 48.0], None), [120.3, 110.8, 30.2], 0.4);
    }
}

#[test]
fn a_circle_partly_outside_the_image_is_found() {
    let pixels = draw(&[Disc::round(30.4, 120.3, 45.0, 170.0)], 90.0, 2.0, 1);
    assert_near(find_in(&pixels, [30.0, 60.0], None), [30.4, 120.3, 45.0], 0.3);
}

#[test]
fn the_window_chooses_one_of_many_circles() {
    let places = [[60.0, 60.0], [180.0, 70.0], [70.0, 180.0], [190.0, 170.0]];
    let discs = places.map(|[x, y]| Disc::round(x, y, 30.0, 180.0));
    let pixels = draw(&discs, 100.0, 2.0, 1);
    for [x, y] in places {
        let window = Window { center: [x + 6.0, y - 5.0], reach: 10.0 };
        assert_near(find_in(&pixels, [25.0, 36.0], Some(window)), [x, y, 30.0], 0.15);
    }
    let nowhere = Window { center: [125.0, 120.0], reach: 10.0 };
    assert_eq!(find_in(&pixels, [25.0, 36.0], Some(nowhere)), None);
    // Without a window either of them is found.
    let any = find_in(&pixels, [25.0, 36.0], None).unwrap();
    assert!(places.iter().any(|[x, y]| apart(any.center, [*x, *y]) < 0.3), "{any:?}");
}

#[test]
fn without_a_circle_none_is_found() {
    for pixels in [vec![0; WIDTH * HEIGHT], vec![255; WIDTH * HEIGHT]] {
        assert_eq!(find_in(&pixels, [15.0, 90.0], None), None);
    }
    for seed in 0..5 {
        assert_eq!(find_in(&draw(&[], 120.0, 6.0, seed), [15.0, 90.0], None), None, "noise {seed}");
    }
    let edge: Vec<u8> = (0..WIDTH * HEIGHT).map(|index| if index % WIDTH < 100 { 40 } else { 200 }).collect();
    assert_eq!(find_in(&edge, [15.0, 90.0], None), None);
}

/// Random bytes and extreme settings give a result within the requested limits, or an error. The refinement
/// may pass the limits by 4 px.
#[test]
fn any_image_has_an_answer() {
    let mut rng = Rng::new(1, 0);
    let mut buffers = Box::new(CameraBuffers::new());
    for _ in 0..200 {
        let (width, height) = (32 + rng.below(225) as usize, 32 + rng.below(209) as usize);
        let step = 1 + rng.below(255) as u8;
        let pixels: Vec<u8> =
            (0..width * height).map(|_| (rng.next_u64() as u8 / step).wrapping_mul(step)).collect();
        let image = Image::try_new(&pixels, width, height).unwrap();
        let from = 5.0 + 20.0 * rng.uniform() as f32;
        let reach = 1.0 + 300.0 * rng.uniform() as f32;
        let center = [rng.below(width as u32 - 1) as f32, rng.below(height as u32 - 1) as f32];
        let window = rng.chance(0.5).then_some(Window { center, reach });
        let axis = rng.chance(0.5).then(|| {
            let [x, y] = [0; 2].map(|_| 1e3 * (rng.uniform() - 0.3) as f32);
            Window { center: [x, y], reach: 100.0 * rng.uniform() as f32 }
        });
        let search = CircleSearch { radius: [from, 0.75 * width.max(height) as f32], window, axis };
        match find_circle(&image, &search, &mut buffers.scratch()) {
            Ok(Some(circle)) => {
                assert!(
                    circle.radius >= from - 4.0 && (0.0..=1.0).contains(&circle.confidence),
                    "{circle:?}"
                );
            }
            Ok(None) => {}
            Err(error) => assert!(matches!(error, VisionError::Radius { .. }), "{error}"),
        }
    }
}

#[test]
fn bad_input_is_refused_with_its_limits() {
    assert_eq!(
        Image::try_new(&[0; 100], 10, 10).unwrap_err().to_string(),
        "an image of 10 × 10 pixels: each side must be 32 to 4096 pixels"
    );
    let error = Image::try_new(&[0; 100], 256, 240).unwrap_err();
    assert_eq!(error.to_string(), "100 grey values for an image of 61440 pixels: one is needed for each");
    let pixels = vec![0; WIDTH * HEIGHT];
    let image = Image::try_new(&pixels, WIDTH, HEIGHT).unwrap();
    let mut buffers = Box::new(CameraBuffers::new());
    let mut said = |radius, window: Option<([f32; 2], f32)>| {
        let window = window.map(|(center, reach)| Window { center, reach });
        find_circle(&image, &CircleSearch { radius, window, axis: None }, &mut buffers.scratch())
            .unwrap_err()
            .to_string()
    };
    for radius in [[4.0, 50.0], [50.0, 20.0], [20.0, 193.0], [f32::NAN, 50.0], [20.0, f32::INFINITY]] {
        assert!(said(radius, None).ends_with("the limits are 5 to 192 pixels in this image"), "{radius:?}");
    }
    for window in [([-1.0, 50.0], 10.0), ([50.0, 240.0], 10.0), ([50.0, 50.0], 0.5), ([50.0, f32::NAN], 5.0)]
    {
        assert!(said([20.0, 50.0], Some(window)).starts_with("window of "), "{window:?}");
    }
    let corner = Some(Window { center: [(WIDTH - 1) as f32, (HEIGHT - 1) as f32], reach: 10.0 });
    let search = CircleSearch { radius: [20.0, 50.0], window: corner, axis: None };
    assert!(find_circle(&image, &search, &mut buffers.scratch()).is_ok_and(|found| found.is_none()));
    let axis = Some(Window { center: [f32::NAN, 0.0], reach: 5.0 });
    let search = CircleSearch { radius: [20.0, 50.0], window: None, axis };
    let error = find_circle(&image, &search, &mut buffers.scratch()).unwrap_err();
    assert_eq!(
        error.to_string(),
        "axis within 5 pixels of (NaN, 0): it must be finite, and the reach not negative"
    );
    let mut short: Buffers<100, MAX_EDGES, { row_len(256) }> = Buffers::new();
    let search = CircleSearch { radius: [20.0, 50.0], window: None, axis: None };
    assert_eq!(
        find_circle(&image, &search, &mut short.scratch()).unwrap_err().to_string(),
        "the buffer `accumulator` has 100 elements, this image needs 15360"
    );
}

/// The image and all buffers leave room in the 128 kB of the microcontroller's main memory.
#[test]
fn image_and_buffers_fit_the_microcontroller() {
    let buffers = size_of::<CameraBuffers>();
    assert!(buffers <= 44 * 1024 && WIDTH * HEIGHT + buffers <= 106 * 1000, "{buffers}");
}

#[test]
fn what_an_independent_renderer_draws_is_found() {
    let (mut start, mut right, mut opencv) = (0, 0, 0);
    let mut buffers = Box::new(CameraBuffers::new());
    for &(width, height, from, to, x, y, radius, found_x, found_y, found_radius) in ROWS {
        let image = Image::try_new(&PIXELS[start..start + width * height], width, height).unwrap();
        start += width * height;
        let is_right = |center: [f32; 2], found: f32| {
            apart(center, [x, y]) < 0.1 * radius && (found - radius).abs() < 0.05 * radius
        };
        let search = CircleSearch { radius: [from, to], window: None, axis: None };
        let found = find_circle(&image, &search, &mut buffers.scratch()).unwrap();
        right += u32::from(found.is_some_and(|circle| is_right(circle.center, circle.radius)));
        opencv += u32::from(is_right([found_x, found_y], found_radius));
    }
    assert_eq!(start, PIXELS.len());
    assert!(right >= opencv && right >= 8, "{right} right, OpenCV {opencv}");
}

/// The weights are those of the fit, and the confidence is the probability by the logistic model.
#[test]
fn the_choice_is_that_of_the_fitted_model() {
    for (picture, &(likeliest, confidence, rows)) in JUDGED.iter().enumerate() {
        let mut candidates = Vec::new();
        for &([x, y, radius], features, behind, log_odds) in rows {
            let found = weigh(&features, behind.as_ref());
            assert!((found - log_odds).abs() < 2e-5 * (1.0 + log_odds.abs()), "{found}, not {log_odds}");
            let ellipse = Ellipse::circle([x, y], radius);
            candidates.push(Some(Candidate { ellipse, knob: None, log_odds: found }));
        }
        let (chosen, found) = best(&candidates).unwrap();
        assert_eq!(
            Some(chosen.ellipse),
            candidates[likeliest].map(|candidate| candidate.ellipse),
            "{picture}"
        );
        assert!((found - confidence).abs() < 2e-5, "picture {picture}: {found}, not {confidence}");
    }
    assert!(JUDGED.iter().any(|judged| judged.1 < 0.5) && JUDGED.iter().any(|judged| judged.1 > 0.9));
}

#[test]
fn the_network_and_its_ellipse_are_those_of_numpy() {
    let (radius, flattening, rays, change) = RIM;
    let seen = rays.iter().map(|(direction, inputs, ..)| (*direction, *inputs));
    let context = Context::new(seen.clone());
    for (direction, inputs, expected, weight) in rays {
        let (found, found_weight) = context.offset(*direction, inputs);
        assert!((found - expected).abs() < 1e-4, "{found}, not {expected} px");
        assert!((found_weight - weight).abs() < 1e-3 * weight, "{found_weight}, not {weight}");
    }
    // A cut and flat ring: a prior of another flattening than in the loss would move the centre.
    let near = Ellipse { center: [40.0, 50.0], radius, flattening };
    let found = refined(&near, seen).unwrap();
    let found = [found.radius - radius, found.center[0] - 40.0, found.center[1] - 50.0];
    for (found, change) in found.into_iter().zip(change) {
        assert!((found - change).abs() < 0.05, "{found}, not {change} px");
    }
}
