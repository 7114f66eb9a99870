//! `calibrate camera`: the camera in a robot's hand.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use nalgebra::UnitQuaternion;
use serde_json::json;
use tesaki::kinematics::Chain;
use tesaki_description::hand_eye::FILE;
use tesaki_description::robot::RobotFolder;
use tesaki_supervisor::hand_eye::{
    self, HandEye, HandEyeCamera, HandEyeFailure, HandEyeSettings, Observation,
};

use crate::args::{CalibrateCamera, Options};
use crate::eval::table::{Row, Table};
use crate::failure::Failure;
use crate::find_circle::{self, Known, Picture};
use crate::output;

const POSE: [&str; 7] = ["x", "y", "z", "qx", "qy", "qz", "qw"];
const CIRCLE: [&str; 3] = ["u", "v", "radius"];
/// What the first search leaves open about a radius, over the radius that the distance gives.
const FIRST_REACH: f32 = 0.3;
/// What the later searches leave open about radius and centre, over the radius.
const REACHES: [f32; 2] = [0.15, 0.07];
/// What they leave open about the direction of the axis [rad].
const AXIS_REACH: f32 = 0.03;

/// Place [m] and quaternion of the hand.
type Pose = ([f64; 3], [f64; 4]);

/// A picture, its row, and the distance that is given for it [m].
struct View {
    row: usize,
    path: PathBuf,
    picture: Picture,
    distance: Option<f64>,
}

pub fn run(options: &Options, args: &CalibrateCamera) -> Result<(), Failure> {
    let default = args.robot.join(FILE);
    let out = args.out.as_deref().unwrap_or(&default);
    if args.out.is_none() && out.symlink_metadata().is_ok() {
        return Err(Failure::Usage(format!(
            "{0} exists: choose another file with --out FILE, or give --out {0} to replace it",
            out.display()
        )));
    }
    output::keep_input(out, "--out", &args.input, "--in")?;
    // An earlier result may be replaced.
    if out.file_name().is_none_or(|name| name != FILE) {
        output::keep_robot(out, &args.robot)?;
    }
    let robot = RobotFolder::load(&args.robot)?;
    let table = Table::read(&args.input)?;
    let poses = poses(options, &table, &robot)?;
    output::require_writable(out)?;
    let circles = CIRCLE.map(str::to_owned);
    let circles = table.all_or_none(&circles, "the plate in the picture [px]")?;
    let (found, skipped) = match (circles, table.column("image")) {
        (Some(_), Some(_)) => {
            let message = "columns image and u, v, radius: remove the ones that are not to be used";
            return Err(table.error(1, message));
        }
        (Some(columns), None) => {
            let Some(size) = args.size else {
                let message = "a table without pictures needs their size: give --size, for example 256x240";
                return Err(Failure::Usage(message.to_owned()));
            };
            let mut circles = Vec::new();
            for (index, row) in table.rows.iter().enumerate() {
                let [u, v, radius] = [0, 1, 2].map(|part| table.precise(row, columns[part]));
                circles.push((index, [u?, v?, radius?]));
            }
            (calibrate(&table, &poses, &circles, &settings(args, size))?, Vec::new())
        }
        (None, Some(column)) => of_pictures(options, args, &table, &poses, column)?,
        (None, None) => {
            let message = "no circles: add columns u, v, radius [px], or image with the pictures";
            return Err(table.error(1, message));
        }
    };
    found.table().map_err(|error| Failure::Other(format!("not calibrated: {error}")))?;
    output::save(out, &found.to_toml(&args.input.display().to_string()), |out| {
        report(options, &table, &found, &skipped, out)
    })
}

fn settings(args: &CalibrateCamera, size: [u32; 2]) -> HandEyeSettings {
    let usual = HandEyeSettings::for_pictures(size, args.rose);
    HandEyeSettings {
        principal: args.principal.unwrap_or(usual.principal),
        focal: args.focal.map_or(usual.focal, |focal| [focal, focal]),
        distances: args.distances,
        ..usual
    }
}

/// Pose of the hand in each row.
fn poses(options: &Options, table: &Table, robot: &RobotFolder) -> Result<Vec<Pose>, Failure> {
    if let Some(columns) = table.all_or_none(&POSE.map(str::to_owned), "pose of the hand")? {
        let pose = |row: &Row| -> Result<Pose, Failure> {
            let [x, y, z, i, j, k, w] = [0, 1, 2, 3, 4, 5, 6].map(|part| table.precise(row, columns[part]));
            Ok(([x?, y?, z?], [i?, j?, k?, w?]))
        };
        return table.rows.iter().map(pose).collect();
    }
    let model = &robot.model;
    let names: Vec<&str> = model.joints.iter().map(|joint| joint.name.as_str()).collect();
    let columns: Vec<Option<usize>> = names.iter().map(|name| table.column(name)).collect();
    if model.chains.len() != 1 {
        let message = format!("{} has several tips: give the pose of the hand in columns x … qw", model.name);
        return Err(table.error(1, &message));
    }
    if columns.iter().all(Option::is_none) {
        let message = format!(
            "no pose of the hand: add columns {}, or angles [rad] of the joints {}",
            POSE.join(", "),
            names.join(", ")
        );
        return Err(table.error(1, &message));
    }
    let missing: Vec<&str> =
        names.iter().zip(&columns).filter(|(_, column)| column.is_none()).map(|(name, _)| *name).collect();
    if !missing.is_empty() {
        output::notice(options, &format!("Without a column, taken to be at 0 rad: {}.", missing.join(", ")));
    }
    let chain = Chain::of_model(model, 0);
    let pose = |row: &Row| -> Result<Pose, Failure> {
        let angle = |column: &Option<usize>| column.map_or(Ok(0.0), |column| table.number(row, column));
        let angles: Vec<f32> = columns.iter().map(angle).collect::<Result<_, _>>()?;
        let posture = chain.posture(&model.chain_angles(0, &angles));
        let rotation = UnitQuaternion::from_rotation_matrix(&posture.tip().rotation);
        let (place, rotation): ([f32; 3], [f32; 4]) =
            (posture.tip().translation.vector.into(), rotation.coords.into());
        Ok((place.map(f64::from), rotation.map(f64::from)))
    };
    table.rows.iter().map(pose).collect()
}

/// Calibrates from circles in rows of the table.
fn calibrate(
    table: &Table,
    poses: &[Pose],
    circles: &[(usize, [f64; 3])],
    settings: &HandEyeSettings,
) -> Result<HandEye, Failure> {
    let observation = |&(row, [u, v, radius]): &(usize, [f64; 3])| {
        let (position, orientation) = poses[row];
        Observation { position, orientation, center: [u, v], radius }
    };
    let observations: Vec<Observation> = circles.iter().map(observation).collect();
    let mut found = hand_eye::calibrate(&observations, settings).map_err(|error| match error {
        HandEyeFailure::Row { row, problem } => {
            table.error(table.rows[circles[row].0].line, &format!("{problem}; mend or remove the row"))
        }
        error @ HandEyeFailure::Setting { .. } => Failure::Usage(error.to_string()),
        error => Failure::Other(format!("not calibrated: {error}")),
    })?;
    found.rejected.iter_mut().for_each(|(row, _)| *row = circles[*row].0);
    Ok(found)
}

/// Finds the circles in the pictures, first anywhere, then where the camera of the search before expects
/// them. Also returns the rows without a circle.
fn of_pictures(
    options: &Options,
    args: &CalibrateCamera,
    table: &Table,
    poses: &[Pose],
    column: usize,
) -> Result<(HandEye, Vec<usize>), Failure> {
    let views = views(args, table, column)?;
    let size = views.first().map_or([0; 2], |view| [view.picture.width, view.picture.height]);
    let settings = settings(args, size.map(|side| u32::try_from(side).unwrap_or(u32::MAX)));
    let around = |radius: f32, reach: f32| {
        let radius = Some([radius * (1.0 - reach), radius * (1.0 + reach)]);
        Known { radius, ..Known::default() }.within(size)
    };
    let first = |view: &View| {
        let focal = args.focal.zip(view.distance);
        let expected =
            focal.and_then(|(focal, distance)| around(single(focal * args.rose / distance), FIRST_REACH));
        Some(expected.unwrap_or_default())
    };
    let (circles, without) = search(table, &views, first)?;
    let picture = |row: usize| format!("{}, {}", place(table, row), views[row].path.display());
    let mut found = calibrate(table, poses, &circles, &settings).map_err(|error| match error {
        Failure::Other(mut message) => {
            if !without.is_empty() {
                let pictures: Vec<String> = without.iter().map(|row| picture(*row)).collect();
                let _ = write!(message, "\nno circle found in these pictures: {}", pictures.join("; "));
            }
            if args.focal.is_none() || table.column("distance").is_none() {
                message += "\na column distance and --focal help to find the plate in the pictures";
            }
            Failure::Other(message)
        }
        error => error,
    })?;
    let mut skipped = Vec::new();
    for reach in REACHES {
        let expected = |view: &View| {
            let (position, orientation) = poses[view.row];
            let seen = found.appearance(position, orientation)?;
            let radius = single(seen.radius);
            let [[u, v], axis] = [seen.center, seen.axis].map(|place| place.map(single));
            let is_inside = u >= 0.0 && v >= 0.0 && u < narrow(size[0] - 1) && v < narrow(size[1] - 1);
            Some(Known {
                window: is_inside.then_some([u, v, (reach * radius).max(2.0)]),
                axis: Some([axis[0], axis[1], AXIS_REACH * single(found.camera.focal)]),
                ..around(radius, reach)?
            })
        };
        let (circles, without) = search(table, &views, expected)?;
        found = calibrate(table, poses, &circles, &settings)?;
        skipped = without;
    }
    for row in &skipped {
        output::notice(options, &format!("{}: no circle found; skipped", picture(*row)));
    }
    Ok((found, skipped))
}

/// Reads the pictures.
fn views(args: &CalibrateCamera, table: &Table, column: usize) -> Result<Vec<View>, Failure> {
    let folder = args.input.parent().unwrap_or_else(|| Path::new(""));
    let mut size = args.size.map(|size| size.map(|side| side as usize));
    let mut views = Vec::new();
    for (index, row) in table.rows.iter().enumerate() {
        let wrong = |message: &str| table.error(row.line, &format!("column image: {message}"));
        if table.is_empty(row, column) {
            return Err(wrong("empty: name the picture, or remove the row"));
        }
        let path = folder.join(table.text(row, column));
        let picture = Picture::read(&path).map_err(|error| wrong(&error.to_string()))?;
        let [width, height] = *size.get_or_insert([picture.width, picture.height]);
        if [picture.width, picture.height] != [width, height] {
            let message = format!(
                "{} has {} × {} pixels, not {width} × {height}",
                path.display(),
                picture.width,
                picture.height
            );
            return Err(wrong(&message));
        }
        let given = table.column("distance").filter(|column| !table.is_empty(row, *column));
        let distance = given.map(|column| table.precise(row, column)).transpose()?;
        if let Some(distance) = distance.filter(|distance| *distance <= 0.0) {
            let message = format!("column distance: {distance} m: it must be above 0");
            return Err(table.error(row.line, &message));
        }
        views.push(View { row: index, path, picture, distance });
    }
    Ok(views)
}

type Circles = Vec<(usize, [f64; 3])>;

/// The circles in the pictures, and the rows without.
fn search(
    table: &Table,
    views: &[View],
    known: impl Fn(&View) -> Option<Known>,
) -> Result<(Circles, Vec<usize>), Failure> {
    let (mut circles, mut skipped) = (Vec::new(), Vec::new());
    for view in views {
        let found = match known(view) {
            Some(known) => {
                find_circle::search(&view.path.display().to_string(), &view.picture, &known)
                    .map_err(|error| {
                        table.error(table.rows[view.row].line, &format!("column image: {error}"))
                    })?
                    .0
            }
            None => None,
        };
        match found {
            Some(circle) => {
                let [u, v] = circle.center;
                circles.push((view.row, [u, v, circle.radius].map(f64::from)));
            }
            None => skipped.push(view.row),
        }
    }
    Ok((circles, skipped))
}

/// `line 7`
fn place(table: &Table, row: usize) -> String {
    format!("line {}", table.rows.get(row).map_or(0, |row| row.line))
}

#[expect(clippy::cast_possible_truncation, reason = "pixels and metres")]
const fn single(value: f64) -> f32 {
    value as f32
}

#[expect(clippy::cast_precision_loss, reason = "a side of a picture")]
const fn narrow(side: usize) -> f32 {
    side as f32
}

fn report(
    options: &Options,
    table: &Table,
    found: &HandEye,
    skipped: &[usize],
    out: Option<&Path>,
) -> Result<(), Failure> {
    let camera = |camera: &HandEyeCamera| {
        json!({
            "position": camera.position, "tilt": camera.tilt, "pan": camera.pan, "turn": camera.turn,
            "focal": camera.focal,
        })
    };
    let line = |row: usize| table.rows[row].line;
    let rejected: Vec<_> =
        found.rejected.iter().map(|(row, off)| json!({ "line": line(*row), "off": off })).collect();
    let rows: Vec<_> = found
        .rows
        .iter()
        .map(|row| output::exact(&(row.radius, row.center[0], row.center[1], row.distance)))
        .collect();
    let value = json!({
        "file": out.map(|out| out.display().to_string()),
        "circles": found.used,
        "camera": camera(&found.camera),
        "deviation": camera(&found.deviation),
        "rose": { "center": found.rose.center, "normal": found.rose.normal, "deviation": found.rose_deviation },
        "residuals": { "center": found.residuals[0], "radius": found.residuals[1] },
        "table_deviation": found.table_deviation,
        "rejected": rejected,
        "skipped": skipped.iter().map(|row| line(*row)).collect::<Vec<_>>(),
        "rows": rows,
    });
    output::result(options, &value, || {
        let mut text = found.summary();
        for (row, off) in &found.rejected {
            let _ = writeln!(text, "{}: {off:.1} px off; not used", place(table, *row));
        }
        text + &output::written_to(out)
    })
}
