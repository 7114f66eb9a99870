//! Lines that several figures share.

use std::ops::Range;

use rapier3d::na::Vector3;

use super::{GraspLog, GraspSample};
use crate::report::{Line, Panel};

/// An axis by number and name.
pub type Axis = (usize, &'static str);

/// The axes of the hand.
pub const fn xyz() -> [Axis; 3] {
    [(0, "x"), (1, "y"), (2, "z")]
}

/// A panel with the three components of a vector, solid, in the hand's frame.
pub fn components(
    panel: Panel,
    log: &GraspLog,
    span: &Range<f64>,
    vector: impl Fn(&GraspSample) -> Vector3<f64>,
) -> Panel {
    with_axes(panel, log, span, vector, |(axis, name), times, values| Line::solid(name, axis, times, values))
}

/// The same for the targets of these components, dashed in the same colours.
pub fn component_targets(
    panel: Panel,
    log: &GraspLog,
    span: &Range<f64>,
    vector: impl Fn(&GraspSample) -> Vector3<f64>,
) -> Panel {
    with_axes(panel, log, span, vector, |(axis, name), times, values| {
        Line::dashed(format!("{name} target"), axis, times, values)
    })
}

/// A line for each axis, from times since the start of `span` [s] and the component.
fn with_axes(
    panel: Panel,
    log: &GraspLog,
    span: &Range<f64>,
    vector: impl Fn(&GraspSample) -> Vector3<f64>,
    line: impl Fn(Axis, Vec<f64>, Vec<f64>) -> Line,
) -> Panel {
    let samples = log.during(span);
    let times: Vec<f64> = samples.iter().map(|sample| sample.time - span.start).collect();
    xyz().into_iter().fold(panel, |panel, axis| {
        let values = samples.iter().map(|sample| vector(sample)[axis.0]).collect();
        panel.line(line(axis, times.clone(), values))
    })
}

/// Displacement of the object along an axis of the hand since the start of `span`: time since then [s], true
/// displacement and its reference [mm].
pub fn displacements(log: &GraspLog, span: &Range<f64>, axis: usize) -> [Vec<f64>; 3] {
    let samples = log.during(span);
    let start = samples.first();
    let position = |sample: &GraspSample| sample.position()[axis];
    let target = |sample: &GraspSample| sample.target[0][axis];
    let change = |value: &dyn Fn(&GraspSample) -> f64| {
        let zero = start.map_or(f64::NAN, value);
        samples.iter().map(|sample| 1e3 * (value(sample) - zero)).collect()
    };
    [samples.iter().map(|sample| sample.time - span.start).collect(), change(&position), change(&target)]
}
