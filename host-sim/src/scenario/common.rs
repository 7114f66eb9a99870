//! Common parts of all scenarios.

use std::ops::Range;

use tesaki::control::ServoMode;
use tesaki::model::RobotModel;
use tesaki::protocol::{Refusal, Request};
use tesaki::task::TaskConfig;
use tesaki_supervisor::{Board, BoardError};

use super::ScenarioError;
use crate::controller::{Controller, Watched};
use crate::motion::Motion;
use crate::plant::{CONTROL_PERIOD, Plant};

/// Control period [s].
pub const T: f64 = CONTROL_PERIOD;

/// The largest of the values. NaN if one of them is, which `f64::max` would hide, or if there is none: then a
/// metric misses its limit.
pub fn largest(values: impl IntoIterator<Item = f64>) -> f64 {
    let larger = |a: f64, b: f64| if a.is_nan() || b.is_nan() { f64::NAN } else { a.max(b) };
    values.into_iter().reduce(larger).unwrap_or(f64::NAN)
}

/// How many of the values pass until all that follow are within `band` of `rest`; `None` if one of them is
/// not a number.
pub fn unsettled(values: impl IntoIterator<Item = f64>, rest: f64, band: f64) -> Option<usize> {
    let mut count = 0;
    for (index, value) in values.into_iter().enumerate() {
        let distance = (value - rest).abs();
        if distance.is_nan() {
            return None;
        }
        if distance > band {
            count = index + 1;
        }
    }
    (!rest.is_nan()).then_some(count)
}

/// The samples of a time span [s], of a log with one for each control period; empty if it was not recorded to
/// its end.
pub fn during<'a, S>(samples: &'a [S], span: &Range<f64>) -> &'a [S] {
    let [from, to] = [span.start, span.end].map(|time| (time / T).round() as usize);
    samples.get(from..to).unwrap_or(&[])
}

/// The value in the middle, the upper one of two; NaN without values.
pub fn median(values: impl IntoIterator<Item = f64>) -> f64 {
    let mut values: Vec<f64> = values.into_iter().collect();
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

/// Sets up and enables the joint servos; returns the joint angles that it holds [rad].
pub fn prepare(
    controller: &mut Watched<'_>,
    plant: &mut Plant,
    model: &RobotModel,
    mode: ServoMode,
    motion: &mut Motion,
) -> Result<Vec<f32>, ScenarioError> {
    introduce(controller, model)?;
    tick(controller, plant, motion)?;
    let homed = home(controller, plant)?;
    tick(controller, plant, motion)?;
    controller.enable(TaskConfig::JointServo(mode))?;
    Ok(held(&homed, model))
}

/// One control period; returns its number.
pub fn tick(
    controller: &mut Watched<'_>,
    plant: &mut Plant,
    motion: &mut Motion,
) -> Result<u32, ScenarioError> {
    let sequence = motion.tick(&plant.truth());
    let actuators = controller.tick(&plant.sensors(sequence))?;
    plant.apply(&actuators)?;
    Ok(sequence)
}

/// Homes the controller; returns the joint angles that it is told [rad].
pub fn home(controller: &mut Watched<'_>, plant: &Plant) -> Result<Vec<f32>, BoardError> {
    let homed: Vec<f32> = plant.homed_positions().iter().map(|&angle| angle as f32).collect();
    controller.home(&homed)?;
    Ok(homed)
}

/// The joint angles that a controller holds which was homed so [rad]: the encoder rounds to whole counts.
pub fn held(homed: &[f32], model: &RobotModel) -> Vec<f32> {
    let rounded = homed.iter().zip(&model.joints).map(|(&angle, joint)| {
        let counts = f64::from(joint.encoder.counts_per_turn) / std::f64::consts::TAU;
        ((f64::from(angle) * counts).round() / counts) as f32
    });
    rounded.collect()
}

/// Takes command of the controller and gives it the model.
pub fn introduce(controller: &mut Watched<'_>, model: &RobotModel) -> Result<(), BoardError> {
    controller.hello()?;
    controller.take_command(false)?;
    controller.push_model(model)
}

/// Takes the board out of a fault.
pub fn clear_faults(board: &mut Watched<'_>) -> Result<(), BoardError> {
    let total = board.faults()?.total;
    board.request(Request::ClearFaults { total }).map(drop)
}

/// The error of a scenario whose controller stopped with a fault.
pub fn fault_error(
    controller: &mut Watched<'_>,
    model: &RobotModel,
    trial: &str,
    time: f64,
) -> ScenarioError {
    match controller.faults() {
        Ok(log) => {
            let fault = log.faults.last().map_or_else(String::new, |fault| fault.named(model).to_string());
            ScenarioError::Fault { trial: trial.to_owned(), time, fault }
        }
        Err(error) => error.into(),
    }
}

/// Why a request failed during a trial: the fault, where the controller refused it for being stopped.
pub fn request_error(
    controller: &mut Watched<'_>,
    model: &RobotModel,
    trial: &str,
    time: f64,
    error: BoardError,
) -> ScenarioError {
    match error {
        BoardError::Refused { refusal: Refusal::WrongMode(_), .. } => {
            fault_error(controller, model, trial, time)
        }
        other => other.into(),
    }
}

/// The text with its first letter in upper case.
pub fn capitalized(text: &str) -> String {
    let mut letters = text.chars();
    letters.next().map_or_else(String::new, |first| first.to_uppercase().chain(letters).collect())
}

/// A whole number, its thousands separated from 10 000 on: `2000`, `50 000`.
pub fn grouped(value: f64) -> String {
    let digits = format!("{value:.0}");
    match digits.split_at_checked(digits.len().saturating_sub(3)) {
        Some((thousands, rest)) if value >= 1e4 => format!("{thousands}\u{a0}{rest}"),
        _ => digits,
    }
}

#[cfg(test)]
pub mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]

    use std::path::Path;

    use super::{largest, median, unsettled};
    use crate::controller::{Native, Watched};
    use crate::law::LawFile;
    use crate::report::Metric;
    use crate::scenario::Setting;

    #[test]
    fn no_order_of_the_values_hides_what_is_not_a_number() {
        let nan = f64::NAN;
        assert!([[nan, 1.0, 2.0], [1.0, nan, 2.0], [1.0, 2.0, nan]].iter().all(|v| largest(*v).is_nan()));
        let bits = |value: f64| value.to_bits();
        assert!(bits(largest([1.0, 3.0, 2.0])) == bits(3.0) && bits(median([5.0, 1.0, 2.0])) == bits(2.0));
        assert!(bits(largest([-2.0, -1.0])) == bits(-1.0) && median([]).is_nan());
    }

    #[test]
    fn what_was_not_measured_misses_every_limit() {
        for value in [largest([]), largest([0.5, f64::NAN])] {
            let metrics = [
                Metric::at_most("", value, 1.0, ""),
                Metric::at_least("", value, 0.0, ""),
                Metric::within("", value, 1.0, ""),
                Metric::reported("", value, ""),
            ];
            assert!(metrics.iter().all(|metric| !metric.pass()), "{value}");
        }
    }

    #[test]
    fn values_settle_after_the_last_that_is_far_from_rest() {
        assert_eq!(unsettled([0.0, 2.0, 0.9, 1.1], 1.0, 0.2), Some(2));
        assert_eq!(unsettled([0.9, 1.1], 1.0, 0.2), Some(0));
        assert_eq!(unsettled([0.0, f64::NAN, 1.0], 1.0, 0.2), None);
        assert_eq!(unsettled([0.0, 1.0], f64::NAN, 0.2), None);
    }

    /// Runs a part of a scenario on a machine of the robot, under these laws of its folder.
    pub fn with_setting<R>(
        robot: &str,
        seed: u64,
        laws: &[&str],
        run: impl FnOnce(&mut Setting<'_, '_>) -> R,
    ) -> R {
        let robot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots").join(robot);
        let file = |name: &&str| LawFile {
            name: (*name).to_owned(),
            path: robot.join("laws").join(name).with_extension("toml"),
        };
        let laws: Vec<LawFile> = laws.iter().map(file).collect();
        let mut native = Native::default();
        let mut controller = Watched::new(&mut native, false);
        let plain = Setting::plain(&robot, &mut controller, seed, f64::INFINITY);
        run(&mut Setting { laws: &laws, ..plain })
    }
}
