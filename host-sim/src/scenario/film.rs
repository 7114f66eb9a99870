//! What a camera saw, for the page of a scenario.

use tesaki::vision::Circle;

use super::ScenarioError;
use crate::camera::{CircleTruth, Image};
use crate::report::{Line, Panel};

/// A picture with the true outline of the rose and the one that was found.
pub fn picture_panel(
    title: String,
    image: &Image,
    truth: Option<&CircleTruth>,
    found: Option<&Circle>,
) -> Result<Panel, ScenarioError> {
    let last = [image.width, image.height].map(|size| size as f64 - 0.5);
    let mut panel = Panel::new(title, "y", "px").picture(image.png()?, [-0.5, last[0]], [-0.5, last[1]]);
    if let Some(truth) = truth {
        let line = outline(truth.center, truth.semi_axes, truth.angle, last);
        panel = panel.line(Line::solid("true", 1, line.0, line.1));
    }
    if let Some(found) = found {
        let axes = found.semi_axes.map(f64::from);
        let line = outline(found.center.map(f64::from), axes, found.angle.into(), last);
        panel = panel.line(Line::solid("found", 0, line.0, line.1));
    }
    Ok(panel)
}

/// The part of an ellipse that is in the picture.
fn outline(
    [u, v]: [f64; 2],
    [long, short]: [f64; 2],
    angle: f64,
    [right, bottom]: [f64; 2],
) -> (Vec<f64>, Vec<f64>) {
    let (sin, cos) = angle.sin_cos();
    let points = (0..=90).map(|step| {
        let (y, x) = (f64::from(step) * core::f64::consts::TAU / 90.0).sin_cos();
        let (x, y) = (u + long * x * cos - short * y * sin, v + long * x * sin + short * y * cos);
        let is_inside = (0.0..right - 0.5).contains(&x) && (0.0..bottom - 0.5).contains(&y);
        if is_inside { (x, y) } else { (f64::NAN, f64::NAN) }
    });
    points.unzip()
}
