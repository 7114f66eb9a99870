//! The circle finder on pictures of a door knob (Knob, section 3).

use tesaki::vision::{CameraBuffers, Circle, CircleSearch, Image, find_circle};

use super::common::median;
use super::film::picture_panel;
use super::knob_pictures::{EMPTY, KnobPicture, KnobPictures};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::camera::{self, CameraValues, CircleTruth};
use crate::motion::Motion;
use crate::report::{Figure, Line, Metric, Panel, Summary, Table};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "knob-find",
    title: "The rose of a door knob",
    about: "a circle finder on rendered pictures of a door knob, and of a door without one",
    robot: "knob-arm",
    kind: Kind::Any,
    files: &["camera.toml"],
    results: "docs/measurements.md#door-knobs",
    duration: 6.0,
    shortest: Some(6.0),
    laws: None,
    lead: &[
        "A camera in the hand of an arm takes pictures of a door knob on its round plate, the rose, from 6 to 25 cm \
         before the door, aside and turned as a mobile base leaves it. Each seed is another door: size of the rose, \
         metal or plastic, wood or paint, light and its reflections; each picture has its own blur, noise and \
         exposure. The finder has to give the centre and the radius of the rose, not of the knob, and nothing \
         where there is no knob. It knows the distance from the door to 30 mm and the direction of the knob's \
         axis to 3°, as the arm's posture tells it.",
        "The outline of the rose is an ellipse in the picture: the centre is that of the ellipse, the radius the \
         root of the product of its semi-axes. A circle is *right* when its centre is within 3 px and its radius \
         within 2 px of the true ones. Pictures that show less than half of the outline may give nothing. No board \
         takes part.",
    ],
    run,
};

/// Pictures per second of the scenario's duration.
const RATE: f64 = 10.0;
/// A circle is right up to these errors of centre and radius [px].
const RIGHT: [f64; 2] = [3.0, 2.0];
/// Share of the outline from which on a picture has to give a circle.
const VISIBLE: f64 = 0.5;
/// Circles of less confidence are not believed.
const BELIEVED: f32 = 0.5;
/// Pictures of the film strip.
const SHOWN: usize = 6;

/// A picture and what was found in it.
struct Picture {
    distance: f64,
    image: camera::Image,
    truth: Option<CircleTruth>,
    /// In the whole image, and in a window about a prediction.
    found: [Option<Circle>; 2],
}

impl Picture {
    /// Errors of centre and radius [px].
    fn errors(&self, search: usize) -> Option<[f64; 2]> {
        let (truth, found) = (self.truth.as_ref()?, self.found[search].as_ref()?);
        let [dx, dy] = [0, 1].map(|axis| f64::from(found.center[axis]) - truth.center[axis]);
        Some([dx.hypot(dy), f64::from(found.radius) - truth.radius])
    }

    fn is_right(&self, search: usize) -> bool {
        self.errors(search).is_some_and(|[center, radius]| center <= RIGHT[0] && radius.abs() <= RIGHT[1])
    }

    /// Whether it shows enough of the rose.
    fn is_clear(&self) -> bool {
        self.truth.is_some_and(|truth| truth.visible >= VISIBLE)
    }
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let values = CameraValues::load(setting.robot)?;
    let count = (setting.duration * RATE) as usize;
    let mut buffers = Box::default();
    let mut pictures = Vec::new();
    for seen in KnobPictures::new(values, setting.seed, count) {
        pictures.push(search(seen, &mut buffers)?);
        (setting.progress)(pictures.len() as f64 / count as f64);
    }
    let (empty, mut pictures) = (pictures.split_off(count - EMPTY), pictures);
    pictures.sort_by(|one, other| other.distance.total_cmp(&one.distance));
    let summary = summary(&pictures, &empty);
    let figures = vec![
        film_strip(&pictures, 0, "Film strip: from far")?,
        film_strip(&pictures, SHOWN / 2, "Film strip: to near")?,
        errors(&pictures),
    ];
    let tables = vec![("pictures.csv".to_owned(), table(&pictures))];
    Ok(Outcome { summary, figures, tables, motion: Motion::new(Vec::<String>::new()) })
}

/// Looks for the rose in the whole image, and in the window about a prediction.
fn search(seen: KnobPicture, buffers: &mut CameraBuffers) -> Result<Picture, ScenarioError> {
    let KnobPicture { distance, image, truth, search, window } = seen;
    let whole = find(&image, &search, buffers)?;
    let near = match window {
        Some(window) => find(&image, &CircleSearch { window: Some(window), ..search }, buffers)?,
        None => None,
    };
    Ok(Picture { distance, image, truth, found: [whole, near] })
}

fn find(
    image: &camera::Image,
    search: &CircleSearch,
    buffers: &mut CameraBuffers,
) -> Result<Option<Circle>, ScenarioError> {
    let image = Image::try_new(&image.pixels, image.width, image.height)?;
    let found = find_circle(&image, search, &mut buffers.scratch())?;
    Ok(found.filter(|circle| circle.confidence >= BELIEVED))
}

fn summary(pictures: &[Picture], empty: &[Picture]) -> Summary {
    let mut summary = Summary::default();
    let clear = || pictures.iter().filter(|picture| picture.is_clear());
    let share = |number: usize, of: usize| 100.0 * number as f64 / of.max(1) as f64;
    for (search, key, label) in [(0, "whole", "Whole image"), (1, "window", "Window")] {
        let mut insert = |name: &str, metric: Metric| summary.insert(format!("{key}_{name}"), metric);
        let right = clear().filter(|picture| picture.is_right(search)).count();
        let text = format!("{label}: pictures with the right circle");
        insert("right", Metric::at_least(text, share(right, clear().count()), 99.0, "%"));
        let wrong =
            pictures.iter().filter(|picture| picture.found[search].is_some() && !picture.is_right(search));
        let text = format!("{label}: pictures with a wrong circle");
        insert("wrong", Metric::at_most(text, share(wrong.count(), pictures.len()), 1.0, "%"));
        let errors = |which: usize| {
            let right = pictures.iter().filter(|picture| picture.is_right(search));
            median(right.filter_map(|picture| picture.errors(search)).map(|errors| errors[which].abs()))
        };
        let text = format!("{label}: error of the centre, median");
        insert("center", Metric::at_most(text, errors(0), 0.3, "px"));
        let text = format!("{label}: error of the radius, median");
        insert("radius", Metric::at_most(text, errors(1), 0.1, "px"));
    }
    let found = empty.iter().filter(|picture| picture.found[0].is_some()).count();
    let text = "Doors without a knob in which a circle is found";
    summary.insert("empty_found", Metric::at_most(text, share(found, empty.len()), 1.0, "%"));
    summary
}

/// Three of the pictures that are shown, with the true and the found outline.
fn film_strip(pictures: &[Picture], from: usize, title: &str) -> Result<Figure, ScenarioError> {
    let caption = "What the camera saw at several distances of its lens from the door, with the true outline of the \
                   rose and the one that was found in the whole image.";
    let mut figure = Figure::paths(title, caption, "x", "px");
    for index in from..from + SHOWN / 2 {
        let Some(picture) = pictures.get(index * pictures.len().saturating_sub(1) / (SHOWN - 1)) else {
            break;
        };
        let title = format!("{:.0} mm", 1000.0 * picture.distance);
        let panel = picture_panel(title, &picture.image, picture.truth.as_ref(), picture.found[0].as_ref())?;
        figure = figure.panel(panel);
    }
    Ok(figure)
}

fn errors(pictures: &[Picture]) -> Figure {
    let right: Vec<&Picture> = pictures.iter().filter(|picture| picture.is_right(0)).rev().collect();
    let distance: Vec<f64> = right.iter().map(|picture| 1000.0 * picture.distance).collect();
    let values =
        |which: usize| right.iter().map(|p| p.errors(0).unwrap_or_default()[which]).collect::<Vec<_>>();
    let caption = "Of the right circles in whole images, over the distance of the lens from the door.";
    Figure::stacked("Errors of centre and radius", caption, "distance", "mm")
        .panel(Panel::new("Centre", "error", "px").rule(0.3, "limit of the median").line(Line::solid(
            "centre",
            0,
            distance.clone(),
            values(0),
        )))
        .panel(Panel::new("Radius", "error", "px").band(0.1, "limit of the median").line(Line::solid(
            "radius",
            1,
            distance,
            values(1),
        )))
}

fn table(pictures: &[Picture]) -> String {
    let truth = |value: fn(&CircleTruth) -> f64| {
        move |picture: &Picture| picture.truth.as_ref().map_or(f64::NAN, value)
    };
    let found = |value: fn(&Circle) -> f32| {
        move |picture: &Picture| picture.found[0].as_ref().map_or(f64::NAN, |circle| value(circle).into())
    };
    let mut table = Table::new(pictures);
    table
        .column("distance", "m", |picture| picture.distance)
        .column("visible", "", truth(|truth| truth.visible))
        .column("true_x", "px", truth(|truth| truth.center[0]))
        .column("true_y", "px", truth(|truth| truth.center[1]))
        .column("true_radius", "px", truth(|truth| truth.radius))
        .column("found_x", "px", found(|circle| circle.center[0]))
        .column("found_y", "px", found(|circle| circle.center[1]))
        .column("found_radius", "px", found(|circle| circle.radius))
        .column("confidence", "", found(|circle| circle.confidence));
    table.csv()
}
