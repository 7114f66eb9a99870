//! `calibrate`: the links of an operator's fingers, and the camera in a robot's hand.

mod camera;

use std::fmt::Write as _;
use std::fs;
use std::path::Path;
use std::time::Duration;

use serde_json::{Value, json};
use tesaki::teleop::{
    CalibrationAccuracy, CalibrationError, CalibrationSettings, FingerLinks, GloveError, GloveSample,
    GloveSensor, HUMAN_FINGERS, HumanFinger,
};
use tesaki_supervisor::operator::{CalibrationGuide, HandPosture, Markers, OperatorFile, PostureDetector};

use crate::args::{Calibrate, CalibrateCommand, Options};
use crate::eval::table::Table;
use crate::failure::Failure;
use crate::feed::{EndingKind, Feed};
use crate::glove::{self, GloveColumns, PositionColumns};
use crate::output;

/// The calibration file, unless another one is named.
const DEFAULT_FILE: &str = "operator.toml";
/// A live source that gives nothing for this time is told.
const SILENCE: Duration = Duration::from_secs(5);

pub fn run(options: &Options, args: &Calibrate) -> Result<(), Failure> {
    if let Some(CalibrateCommand::Camera(args)) = &args.command {
        return camera::run(options, args);
    }
    let settings = CalibrationSettings {
        orientation_noise: args.orientation_noise.to_radians(),
        // 10 mm are a little more than the limit in single precision.
        marker_noise: (1e-3 * args.marker_noise).min(0.01),
        ..CalibrationSettings::DEFAULT
    };
    let mut guide =
        CalibrationGuide::try_new(&settings).map_err(|error| Failure::Usage(error.to_string()))?;
    let out = args.out.as_deref().unwrap_or(Path::new(DEFAULT_FILE));
    if args.out.is_none() && out.symlink_metadata().is_ok() {
        return Err(Failure::Usage(format!(
            "{DEFAULT_FILE} exists: choose another file with --out FILE, or give --out {DEFAULT_FILE} to replace it"
        )));
    }
    if let Some(postures) = &args.postures {
        output::keep_input(out, "--out", postures, "POSTURES")?;
    }
    let is_of_operator = |text: &String| toml::from_str::<OperatorFile>(text).is_ok();
    if out.is_file() && !fs::read_to_string(out).is_ok_and(|text| is_of_operator(&text)) {
        return Err(Failure::Usage(format!(
            "{} exists, and is no calibration of an operator: choose another file with --out FILE",
            out.display()
        )));
    }
    output::require_writable(out)?;
    match &args.postures {
        Some(path) => read_postures(path, &mut guide)?,
        None => lead(options, &mut guide)?,
    }
    let solved = guide.finish(args.proportions).map_err(|error| refused(&error, args.proportions))?;
    let file = OperatorFile::new(&args.name, &solved);
    output::save(out, &file.to_toml(), |out| {
        let fingers = named(&solved.map(|(_, accuracy)| accuracy_json(&accuracy)));
        let value = json!({
            "operator": args.name,
            "file": out.map(|out| out.display().to_string()),
            "postures": guide.postures(),
            "fingers": fingers,
        });
        output::result(options, &value, || table(&solved, out))
    })
}

/// The accuracy of each finger, and where the calibration is.
fn table(solved: &[(FingerLinks, CalibrationAccuracy); HUMAN_FINGERS], out: Option<&Path>) -> String {
    let mut text = String::from("finger   postures  rank  condition  residual  deviation of the tip\n");
    for (finger, (_, accuracy)) in HumanFinger::ALL.iter().zip(solved) {
        let CalibrationAccuracy { postures, rank, condition, residual, tip_deviation, .. } = accuracy;
        let [residual, deviation] = [residual, tip_deviation].map(|length| 1e3 * length);
        let inferred = if *postures == 0 { ", by proportions" } else { "" };
        let _ = writeln!(
            text,
            "{:<7} {postures:>6} {rank:>5} {condition:>10.1} {residual:>6.2} mm  {deviation:.2} mm{inferred}",
            finger.name()
        );
    }
    text + &output::written_to(out)
}

/// Why there is no calibration, and what to do.
fn refused(error: &CalibrationError, proportions: bool) -> Failure {
    let hint = match error {
        CalibrationError::TooFewPostures { finger, postures: 0, .. }
            if !proportions && *finger != HumanFinger::Thumb =>
        {
            "; or give --proportions to infer fingers without marker"
        }
        CalibrationError::MissingMovement { .. } => "; add postures that do",
        _ => "",
    };
    Failure::Other(format!("not calibrated: {error}{hint}"))
}

fn named(values: &[Value; HUMAN_FINGERS]) -> serde_json::Map<String, Value> {
    HumanFinger::ALL
        .iter()
        .zip(values)
        .map(|(finger, value)| (finger.name().to_owned(), value.clone()))
        .collect()
}

fn accuracy_json(accuracy: &CalibrationAccuracy) -> Value {
    json!({
        "postures": accuracy.postures,
        "rank": accuracy.rank,
        "condition": output::exact(&accuracy.condition),
        "residual": output::exact(&accuracy.residual),
        "tip_deviation": output::exact(&accuracy.tip_deviation),
        "weakest": accuracy.weakest.to_string(),
    })
}

/// Reads a table of postures.
fn read_postures(path: &Path, guide: &mut CalibrationGuide) -> Result<(), Failure> {
    let table = Table::read(path)?;
    let (glove, markers) =
        (GloveColumns::find(&table)?, PositionColumns::find(&table, "position of a marker [m]")?);
    let touch = table.column("touch");
    let mut touches = Vec::new();
    for row in &table.rows {
        let posture = HandPosture {
            orientations: glove.sample(&table, row)?,
            markers: markers.positions(&table, row)?,
        };
        let refused = |error| table.error(row.line, &format!("{error}; mend or remove the row"));
        match touch.map_or("", |column| table.text(row, column)) {
            "" => guide.add(&posture).map_err(refused)?,
            name => match HumanFinger::ALL[1..].iter().find(|finger| finger.name() == name) {
                Some(finger) => touches.push((row, *finger, posture.orientations)),
                None => {
                    let message = format!("column touch: {name:?}: write index, middle, ring or little");
                    return Err(table.error(row.line, &message));
                }
            },
        }
    }
    // They need a thumb that is calibrated.
    touches.into_iter().try_for_each(|(row, finger, orientations)| {
        let refused = |error| table.error(row.line, &format!("a touch of the {finger}: {error}"));
        guide.touch(finger, &orientations).map_err(refused)
    })
}

/// Guides through the postures while samples come from standard input.
fn lead(options: &Options, guide: &mut CalibrationGuide) -> Result<(), Failure> {
    let mut detector = PostureDetector::default();
    let tell = |guide: &CalibrationGuide, what: &str, next: Option<&str>| {
        let deviations = guide.estimates().map(|estimate| {
            estimate.map_or(Value::Null, |(_, accuracy)| output::exact(&accuracy.tip_deviation))
        });
        if options.json {
            let value = json!({
                "event": what, "postures": guide.postures(), "next": next,
                "tip_deviation": Value::Object(named(&deviations)),
            });
            return output::line(&value.to_string());
        }
        let quality =
            guide.estimates().iter().zip(HumanFinger::ALL).fold(String::new(), |text, (estimate, finger)| {
                match estimate {
                    Some((_, accuracy)) => {
                        format!("{text}  {} ±{:.1} mm", finger.name(), 1e3 * accuracy.tip_deviation)
                    }
                    None => text,
                }
            });
        output::notice(options, &format!("{what}{quality}"));
        next.map_or(Ok(()), |next| {
            output::notice(
                options,
                &format!("Posture {}: {next}; hold still for a second.", guide.postures() + 1),
            );
            Ok(())
        })
    };
    tell(guide, "No posture yet.", guide.instruction().as_deref())?;
    let mut feed = Feed::<String>::standard_input("sample", Duration::MAX).patient();
    // What is wrong is told once, until the next good sample or posture.
    let (mut told, mut told_why) = (false, false);
    loop {
        if let Some(ending) = feed.ending() {
            return match ending.kind {
                EndingKind::Closed => Ok(()),
                EndingKind::Silent | EndingKind::Bad => Err(Failure::Other(ending.reason)),
            };
        }
        let Some((arrived, line)) = feed.wait(SILENCE) else {
            if feed.ending().is_none() && !std::mem::replace(&mut told, true) {
                let what = format!("Nothing comes from {}: does what feeds it run?", feed.place);
                tell(guide, &what, guide.instruction().as_deref())?;
            }
            continue;
        };
        if line.trim().is_empty() {
            continue;
        }
        let (time, sample, markers) = match live_sample(&line) {
            Ok(sample) => sample,
            Err(error) => {
                feed.reject(arrived, &error);
                if !std::mem::replace(&mut told, true) {
                    let what = format!("Dropped: {}.", feed.error().unwrap_or_default());
                    tell(guide, &what, guide.instruction().as_deref())?;
                }
                continue;
            }
        };
        feed.count();
        told = false;
        let Some(posture) = detector.add(time, sample, markers) else {
            if let Some(why) = detector.hindrance().filter(|_| !std::mem::replace(&mut told_why, true)) {
                tell(guide, &format!("No posture can be found: {why}."), guide.instruction().as_deref())?;
            }
            continue;
        };
        told_why = false;
        if posture.markers.iter().all(Option::is_none) {
            let what = "A posture without a marker: give \"markers\" by finger, [x, y, z] in m.";
            tell(guide, what, guide.instruction().as_deref())?;
            continue;
        }
        match guide.add_live(&posture) {
            Ok(()) => {
                let next = guide.instruction();
                tell(
                    guide,
                    &format!("{}.", output::counted(guide.postures() as usize, "posture")),
                    next.as_deref(),
                )?;
                if next.is_none() {
                    return Ok(());
                }
            }
            Err(error) => {
                detector.again();
                tell(guide, &format!("Once more: {error}."), guide.instruction().as_deref())?;
            }
        }
    }
}

/// Time [s], orientations and markers of a line.
fn live_sample(line: &str) -> Result<(f64, GloveSample, Markers), String> {
    let (time, value) = glove::object(line)?;
    let mut keys = vec!["time", "back", "markers"];
    keys.extend(HumanFinger::ALL.map(HumanFinger::name));
    if let Some(key) = value
        .as_object()
        .into_iter()
        .flat_map(|object| object.keys())
        .find(|key| !keys.contains(&key.as_str()))
    {
        return Err(format!("there is no key {key:?}: the keys are {}", keys.join(", ")));
    }
    let orientations = glove::orientations(&value)?;
    // A mean over the posture would hide it.
    let wrong = GloveSensor::all().find_map(|sensor| match orientations.orientation(sensor) {
        Ok(_) | Err(GloveError::Missing(_)) => None,
        Err(error) => Some(error.to_string()),
    });
    wrong.map_or(Ok(()), Err)?;
    Ok((time, orientations, glove::positions(value.get("markers"), "marker")?))
}
