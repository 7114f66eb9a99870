//! `find-circle`: the circle finder of the control core on pictures.

mod picture;

use std::path::Path;
use std::time::Instant;

use serde_json::{Value, json};
use tesaki::vision::{
    Circle, CircleSearch, EdgePoint, Image, MAX_EDGES, MIN_SIDE, Scratch, VisionError, Window,
    accumulator_len, find_circle, radius_limits, row_len,
};

use crate::args::{FindCircle, Options};
use crate::failure::Failure;
use crate::output::{self, keep_input};
pub use picture::Picture;
use picture::write_png;

/// Largest side of the picture that is searched [px]; larger pictures are reduced.
const MAX_SIDE: usize = 1000;

/// What is known about the circle in a picture [px]: radius from … to, and `X,Y,REACH` of its centre and of
/// the point where its axis vanishes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Known {
    pub radius: Option<[f32; 2]>,
    pub window: Option<[f32; 3]>,
    pub axis: Option<[f32; 3]>,
}

impl Known {
    /// What of it can be found in pictures of this size; `None` if nothing.
    #[expect(clippy::cast_precision_loss, reason = "pixels")]
    pub fn within(self, [width, height]: [usize; 2]) -> Option<Self> {
        let Some([from, to]) = self.radius else { return Some(self) };
        let factor = reduction(width, height);
        let [least, most] =
            radius_limits(width / factor, height / factor).map(|radius| radius * factor as f32);
        let radius = [from.max(least), to.min(most)];
        (radius[0] < radius[1]).then_some(Self { radius: Some(radius), ..self })
    }
}

/// How many times a picture is reduced.
fn reduction(width: usize, height: usize) -> usize {
    width.max(height).div_ceil(MAX_SIDE).max(1)
}

pub fn run(options: &Options, args: &FindCircle) -> Result<(), Failure> {
    if args.annotate.is_some() && args.images.len() > 1 {
        return Err(Failure::Usage("--annotate writes one picture: give one IMAGE".to_owned()));
    }
    if let Some(annotated) = &args.annotate {
        keep_input(annotated, "--annotate", &args.images[0], "IMAGE")?;
        if annotated.extension().is_none_or(|end| !end.eq_ignore_ascii_case("png")) {
            return Err(Failure::Usage(format!(
                "--annotate writes PNG: name it {}",
                annotated.with_extension("png").display()
            )));
        }
    }
    let (mut lines, mut values, mut failures) = (String::new(), Vec::new(), Vec::new());
    for path in &args.images {
        match find(path, args) {
            Ok((circle, milliseconds)) => {
                let name = path.display().to_string();
                lines += &(line(&name, circle.as_ref(), milliseconds) + "\n");
                values.push(object(&name, circle.as_ref(), milliseconds));
            }
            Err(failure) => failures.push(failure.to_string()),
        }
    }
    if !values.is_empty() {
        output::result(options, &json!({ "images": values }), || lines)?;
    }
    if failures.is_empty() { Ok(()) } else { Err(Failure::Other(failures.join("\n"))) }
}

/// The circle in a file, and the time that the search took [ms].
fn find(path: &Path, args: &FindCircle) -> Result<(Option<Circle>, f64), Failure> {
    let picture = Picture::read(path)?;
    let known = Known { radius: args.radius, window: args.window, axis: args.axis };
    let (circle, milliseconds) = search(&path.display().to_string(), &picture, &known)?;
    if let Some(annotated) = &args.annotate {
        annotate(annotated, &picture, circle.as_ref())?;
    }
    Ok((circle, milliseconds))
}

/// The circle in the picture, and the time that the search took [ms].
#[expect(clippy::cast_precision_loss, reason = "a small number")]
pub fn search(name: &str, picture: &Picture, known: &Known) -> Result<(Option<Circle>, f64), Failure> {
    let wrong = |error: &dyn std::fmt::Display| Failure::Other(format!("{name}: {error}"));
    let factor = reduction(picture.width, picture.height);
    let reduced = (factor > 1).then(|| picture.reduced(factor));
    let searched = reduced.as_ref().unwrap_or(picture);
    let image = Image::try_new(&searched.pixels, searched.width, searched.height).map_err(|error| match error {
        VisionError::Size { width, height } if factor > 1 => wrong(&format!(
            "a picture of {} × {} pixels: with a side of more than {MAX_SIDE} it is reduced, {factor} times, to \
             {width} × {height}, and each side must then have at least {MIN_SIDE}: cut out the surroundings of \
             the circle",
            picture.width, picture.height
        )),
        error => wrong(&error),
    })?;
    let scale = factor as f32;
    // The reduced pixel lies in the middle of those that it is the mean of.
    let offset = 0.5 * (scale - 1.0);
    let half = 0.5 * searched.width.min(searched.height) as f32;
    let [_, most] = radius_limits(searched.width, searched.height);
    let radius =
        known.radius.map_or([10.0_f32.min(0.5 * half), half.min(most)], |radius| radius.map(|r| r / scale));
    let reduced = |[x, y, reach]: [f32; 3]| Window {
        center: [(x - offset) / scale, (y - offset) / scale],
        reach: reach / scale,
    };
    let search = CircleSearch { radius, window: known.window.map(reduced), axis: known.axis.map(reduced) };
    let mut accumulator = vec![0; accumulator_len(searched.width, searched.height)];
    let mut points = vec![EdgePoint::NONE; MAX_EDGES.max(searched.pixels.len() / 48)];
    let mut rows = vec![0; row_len(searched.width)];
    let mut scratch = Scratch { accumulator: &mut accumulator, points: &mut points, rows: &mut rows };
    let start = Instant::now();
    let found = find_circle(&image, &search, &mut scratch).map_err(|error| {
        let note = if factor > 1 {
            format!(
                ". With a side of more than {MAX_SIDE} pixels the picture is reduced {factor} times: times \
                 {factor}, these are its own pixels"
            )
        } else {
            String::new()
        };
        wrong(&format!("{error}{note}"))
    })?;
    let milliseconds = start.elapsed().as_secs_f64() * 1e3;
    let enlarge = |circle: Circle| Circle {
        center: circle.center.map(|value| scale * value + offset),
        radius: scale * circle.radius,
        semi_axes: circle.semi_axes.map(|value| scale * value),
        ..circle
    };
    Ok((found.map(enlarge), milliseconds))
}

/// A result as text.
pub fn line(name: &str, circle: Option<&Circle>, milliseconds: f64) -> String {
    match circle {
        Some(Circle { center: [x, y], radius, confidence, .. }) => format!(
            "{name}: centre ({x:.2}, {y:.2}), radius {radius:.2} px, confidence {confidence:.2}, {milliseconds:.2} ms"
        ),
        None => format!("{name}: no circle, {milliseconds:.2} ms"),
    }
}

/// The same as JSON.
pub fn object(name: &str, circle: Option<&Circle>, milliseconds: f64) -> Value {
    let circle = circle.map(|circle| {
        json!({
            "center": output::exact(&circle.center),
            "radius": output::exact(&circle.radius),
            "semi_axes": output::exact(&circle.semi_axes),
            "angle": output::exact(&circle.angle),
            "confidence": output::exact(&circle.confidence),
        })
    });
    json!({ "image": name, "circle": circle, "milliseconds": milliseconds })
}

/// Writes the picture with the ellipse and its centre in red.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    clippy::cast_sign_loss,
    reason = "pixels"
)]
fn annotate(path: &Path, picture: &Picture, circle: Option<&Circle>) -> Result<(), Failure> {
    let mut pixels: Vec<u8> = picture.pixels.iter().flat_map(|&grey| [grey; 3]).collect();
    let mut dot = |x: f64, y: f64| {
        let (x, y) = (x.round(), y.round());
        if x >= 0.0 && y >= 0.0 && x < picture.width as f64 && y < picture.height as f64 {
            let start = 3 * (y as usize * picture.width + x as usize);
            pixels[start..start + 3].copy_from_slice(&[255, 0, 0]);
        }
    };
    if let Some(circle) = circle {
        let [x, y] = circle.center.map(f64::from);
        let [a, b] = circle.semi_axes.map(f64::from);
        let (sin, cos) = f64::from(circle.angle).sin_cos();
        let steps = (8.0 * a) as u32 + 8;
        for step in 0..steps {
            let (v, u) = (std::f64::consts::TAU * f64::from(step) / f64::from(steps)).sin_cos();
            dot(x + a * u * cos - b * v * sin, y + a * u * sin + b * v * cos);
        }
        for step in -3..=3 {
            dot(x + f64::from(step), y);
            dot(x, y + f64::from(step));
        }
    }
    write_png(path, picture.width, picture.height, &pixels)
}
