//! `eval`: the control core's kinematics, dynamics and least grip for every row of a table.

mod contacts;
mod dynamics;
mod forward;
mod grip;
mod inverse;
mod proof;
pub mod table;

use std::io::{self, Write};
use std::path::Path;

use serde_json::{Value, json};
use tesaki_description::finding::{Finding, Matter};
use tesaki_description::urdf::{Drive, SerialPath, Urdf, UrdfError};

use crate::args::{Eval, Kinematics, Options};
use crate::failure::Failure;
use crate::output;
use table::{Row, Table};

/// A table of results as text.
#[derive(Default)]
pub struct Results {
    pub header: Vec<String>,
    pub rows: Vec<Vec<String>>,
    /// Notes for the user.
    pub notes: Vec<String>,
    pub used: Vec<String>,
}

/// A quantity of a robot.
#[derive(Clone, Copy)]
enum Quantity {
    Fk,
    Jacobian,
    Ik,
    Rnea,
    Mass,
    Bias,
}

pub fn run(options: &Options, eval: &Eval) -> Result<(), Failure> {
    match eval {
        Eval::Fk(asked) => kinematics(options, asked, Quantity::Fk),
        Eval::Jacobian(asked) => kinematics(options, asked, Quantity::Jacobian),
        Eval::Ik(asked) => kinematics(options, asked, Quantity::Ik),
        Eval::Rnea(asked) => kinematics(options, asked, Quantity::Rnea),
        Eval::Mass(asked) => kinematics(options, asked, Quantity::Mass),
        Eval::Bias(asked) => kinematics(options, asked, Quantity::Bias),
        Eval::Grip(asked) => grip::run(options, asked),
    }
}

fn kinematics(options: &Options, asked: &Kinematics, what: Quantity) -> Result<(), Failure> {
    let matters: &[Matter] = match what {
        // The inverse kinematics needs the limits of the joints on the paths, see below.
        Quantity::Fk | Quantity::Jacobian | Quantity::Bias | Quantity::Ik => &[],
        Quantity::Rnea | Quantity::Mass => &[Matter::Dynamics],
    };
    output::keep_input(&asked.output, "--out", &asked.input, "--in")?;
    output::keep_robot(&asked.output, &asked.robot)?;
    let (urdf, others) = Urdf::load(&asked.robot, matters)?;
    let table = Table::read(&asked.input)?;
    let tips = tips(&urdf, asked, what, &table)?;
    let paths = tips.iter().map(|tip| urdf.path(asked.base.as_deref(), tip));
    let paths: Vec<SerialPath> = paths.collect::<Result<_, _>>()?;
    let (wrong, others): (Vec<_>, Vec<_>) =
        others.into_iter().partition(|finding| spoils(finding, what, &paths));
    if !wrong.is_empty() {
        return Err(UrdfError::Wrong(wrong).into());
    }
    let mut results = match what {
        Quantity::Fk => forward::poses(&table, &paths)?,
        Quantity::Jacobian => forward::jacobians(&table, &paths)?,
        Quantity::Ik => inverse::angles(&table, &paths)?,
        Quantity::Rnea => dynamics::torques(&table, &paths)?,
        Quantity::Mass => dynamics::mass_matrices(&table, &paths)?,
        Quantity::Bias => dynamics::biases(&table, &paths)?,
    };
    results.notes.extend(unused(&table, &results.used));
    if !others.is_empty() {
        let path = urdf.path.display();
        let count = output::counted(others.len(), "problem");
        results.notes.push(format!("{count} elsewhere in the robot: see `tesaki model check {path}`"));
    }
    let tips: Vec<&str> = paths.iter().map(|path| path.tip.as_str()).collect();
    let text = format!("{}, tips {}", output::counted(results.rows.len(), "row"), tips.join(", "));
    let value = json!({ "rows": results.rows.len(), "tips": tips, "notes": results.notes });
    finish(options, &asked.output, &results, &text, &value)
}

/// Whether something is wrong with a joint on the paths, or with one that moves it. Limits matter to the
/// inverse kinematics alone; where masses matter, so do the joints that are fixed beside the path.
fn spoils(finding: &Finding, what: Quantity, paths: &[SerialPath]) -> bool {
    let is_on_the_way = || {
        let joints = paths.iter().flat_map(|path| &path.way);
        let drives = paths.iter().flat_map(|path| path.drives.iter().map(|drive| &drive.name));
        joints.chain(drives).any(|name| finding.is_about_joint(name))
    };
    match finding.matter {
        Matter::Kinematics => matches!(what, Quantity::Rnea | Quantity::Mass) || is_on_the_way(),
        Matter::Limits => matches!(what, Quantity::Ik) && is_on_the_way(),
        Matter::Dynamics => false,
    }
}

/// The tips to compute: those named; else those with columns (inverse kinematics), or all.
fn tips(urdf: &Urdf, asked: &Kinematics, what: Quantity, table: &Table) -> Result<Vec<String>, Failure> {
    if !asked.tip.is_empty() {
        return Ok(asked.tip.clone());
    }
    let base = asked.base.as_deref();
    let all = || urdf.tips(base).into_iter().map(str::to_owned).collect::<Vec<_>>();
    let tips: Vec<String> = match what {
        Quantity::Ik => {
            let is_link = |name: &&str| urdf.robot.links.iter().any(|link| link.name == *name);
            let names = table.headers().iter().filter_map(|header| header.strip_suffix(".x"));
            names.filter(is_link).map(str::to_owned).collect()
        }
        _ => all(),
    };
    match what {
        _ if !tips.is_empty() => Ok(tips),
        Quantity::Ik => {
            let message = "no targets: add columns TIP.x, TIP.y, TIP.z [m], and TIP.qx, .qy, .qz, .qw for an \
                orientation";
            Err(table.error(1, &format!("{message}; the tips are {}", all().join(", "))))
        }
        // The path from the base to itself fails with the problem of the base.
        _ => {
            urdf.path(base, base.unwrap_or(urdf.base()))?;
            Err(Failure::Other(format!("{}: the robot has no moving joint", urdf.path.display())))
        }
    }
}

/// The drives of all paths, each once.
fn drives(paths: &[SerialPath]) -> Vec<&Drive> {
    let mut drives: Vec<&Drive> = Vec::new();
    for drive in paths.iter().flat_map(|path| &path.drives) {
        if !drives.iter().any(|known| known.name == drive.name) {
            drives.push(drive);
        }
    }
    drives
}

/// The shortest digits that identify the number.
pub fn exact(value: f32) -> String {
    format!("{value:?}")
}

fn unused(table: &Table, used: &[String]) -> Option<String> {
    // A table over time has a column for it, which nobody takes for an argument.
    let is_unused = |header: &&String| *header != "time" && !used.contains(*header);
    let unused: Vec<&str> = table.headers().iter().filter(is_unused).map(String::as_str).collect();
    (!unused.is_empty()).then(|| format!("unused columns: {}", unused.join(", ")))
}

fn write(path: &Path, results: &Results) -> Result<(), Failure> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let lines = std::iter::once(&results.header).chain(&results.rows);
    for line in lines {
        writer.write_record(line).map_err(|error| Failure::Other(error.to_string()))?;
    }
    let text = writer.into_inner().map_err(|error| Failure::Other(error.to_string()))?;
    if path != Path::new("-") {
        return output::replace(path, text).map_err(Failure::written(path));
    }
    match io::stdout().write_all(&text).and_then(|()| io::stdout().flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Err(Failure::Pipe),
        other => other.map_err(Failure::file("standard output")),
    }
}

/// Writes the results and prints notes and a summary, to standard error if the results go to standard output.
pub fn finish(
    options: &Options,
    path: &Path,
    results: &Results,
    text: &str,
    value: &Value,
) -> Result<(), Failure> {
    write(path, results)?;
    if path == Path::new("-") {
        if options.json {
            output::complain(&value.to_string());
        }
        results.notes.iter().map(String::as_str).chain([text]).for_each(|line| output::notice(options, line));
        return Ok(());
    }
    results.notes.iter().for_each(|note| output::notice(options, note));
    output::result(options, value, || format!("{text} → {}", path.display()))
}
