//! Contacts and a load in, the least grip out, or the proof that there is none.

use serde_json::json;
use tesaki::grasp::{Certificate, Contact, Grip, GripError, GripState, LeastGrip};

use super::contacts::{Columns, Grasp};
use super::{Results, Row, Table, exact, finish, proof, unused};
use crate::args::{self, Options};
use crate::failure::Failure;
use crate::output;

/// The verdicts, in the order in which they are counted.
const VERDICTS: [&str; 3] = ["held", "cannot-hold", "open"];

/// The core's answer to one row.
enum Answer {
    Held(Grip),
    CannotHold(Certificate),
    /// At the edge of what can be held, with what is missing to the load.
    Open(f32),
}

pub fn run(options: &Options, asked: &args::Grip) -> Result<(), Failure> {
    output::keep_input(&asked.output, "--out", &asked.input, "--in")?;
    let grip =
        LeastGrip::try_new(asked.margin, asked.min).map_err(|error| Failure::Usage(error.to_string()))?;
    let table = Table::read(&asked.input)?;
    let columns = Columns::find(&table, asked)?;
    let used = columns.used().map(|column| table.header(column).to_owned()).collect();
    let mut results = Results { header: header(&columns), rows: Vec::new(), notes: Vec::new(), used };
    let mut counts = [0_usize; VERDICTS.len()];
    for row in &table.rows {
        let grasp = columns.grasp(&table, row)?;
        let answer = answer(&grip, &grasp, &table, row)?;
        let verdict = match answer {
            Answer::Held(_) => 0,
            Answer::CannotHold(_) => 1,
            Answer::Open(_) => 2,
        };
        counts[verdict] += 1;
        let mut values = vec![VERDICTS[verdict].to_owned()];
        forces(&columns, &grasp, &answer, &mut values);
        let conditioning = *grasp.map.inverse().conditioning();
        let rest = match &answer {
            Answer::Held(grip) => exact(grip.residual),
            Answer::CannotHold(_) => String::new(),
            Answer::Open(rest) => exact(*rest),
        };
        values.extend([rest, conditioning.rank.to_string(), exact(conditioning.condition)]);
        if let Answer::CannotHold(certificate) = &answer {
            let proven = certificate.is_valid(&grip, &grasp.map, &grasp.load)
                && proof::holds(asked, &grasp, &certificate.twist);
            if !proven {
                results.notes.push(format!("line {}: the proof failed when it was checked anew", row.line));
            }
            values.extend(certificate.twist.iter().copied().map(exact));
            values.push(if proven { "checked" } else { "failed" }.to_owned());
        } else {
            values.extend([const { String::new() }; 7]);
        }
        results.rows.push(values);
    }
    results.notes.extend(unused(&table, &results.used));
    let [held, cannot, open] = counts;
    let rows = results.rows.len();
    let text = format!("{}: {held} held, {cannot} cannot-hold, {open} open", output::counted(rows, "row"));
    let value =
        json!({ "rows": rows, "held": held, "cannot_hold": cannot, "open": open, "notes": results.notes });
    finish(options, &asked.output, &results, &text, &value)
}

fn header(columns: &Columns<'_>) -> Vec<String> {
    let mut header = vec!["verdict".to_owned()];
    for contact in &columns.contacts {
        let i = contact.number;
        header.extend([
            format!("f{i}x"),
            format!("f{i}y"),
            format!("f{i}z"),
            format!("normal{i}"),
            format!("used{i}"),
        ]);
    }
    let rest = ["rest", "rank", "condition", "vx", "vy", "vz", "wx", "wy", "wz", "proof"];
    header.extend(rest.map(str::to_owned));
    header
}

/// The core's answer, which does not depend on the rows before.
fn answer(grip: &LeastGrip, grasp: &Grasp, table: &Table, row: &Row) -> Result<Answer, Failure> {
    let answer = match grip.solve(&grasp.map, &grasp.load, &mut GripState::default()) {
        Ok(grip) => Answer::Held(grip),
        Err(GripError::CannotHold(certificate)) => Answer::CannotHold(certificate),
        Err(GripError::NotConverged { residual } | GripError::Unfinished { residual }) => {
            Answer::Open(residual)
        }
        Err(error @ (GripError::NotFinite | GripError::Limit { .. })) => {
            return Err(table.error(row.line, &error.to_string()));
        }
    };
    let finite = match &answer {
        Answer::Held(grip) => {
            grip.forces.iter().flatten().chain([&grip.residual]).all(|value| value.is_finite())
        }
        Answer::CannotHold(certificate) => certificate.twist.iter().all(|value| value.is_finite()),
        Answer::Open(rest) => rest.is_finite(),
    };
    if finite {
        Ok(answer)
    } else {
        let message =
            "load, distances or limits are too large or too small to compute: check the units, m and N";
        Err(table.error(row.line, message))
    }
}

/// The forces of every contact that has columns, with normal force and used fraction of the friction limit.
fn forces(columns: &Columns<'_>, grasp: &Grasp, answer: &Answer, values: &mut Vec<String>) {
    for contact in &columns.contacts {
        let index = grasp.numbers.iter().position(|&number| number == contact.number);
        let found = index.and_then(|index| match answer {
            Answer::Held(grip) => grasp.map.contacts().get(index).zip(grip.forces.get(index)),
            _ => None,
        });
        match found {
            Some((contact, force)) => {
                values.extend(force.iter().copied().map(exact));
                values.extend(shares(contact, &(*force).into()).map(exact));
            }
            None => values.extend([const { String::new() }; 5]),
        }
    }
}

/// Normal force, and force across over the most that friction holds; 0 without friction or force.
fn shares(contact: &Contact, force: &[f32; 3]) -> [f32; 2] {
    let normal = contact.normal().cast::<f64>().normalize();
    let force = nalgebra::Vector3::from(*force).cast::<f64>();
    let along = normal.dot(&force);
    let across = (force - normal * along).norm();
    let most = f64::from(contact.friction()) * along;
    let used = if most > 0.0 { across / most } else { 0.0 };
    #[expect(clippy::cast_possible_truncation, reason = "digits")]
    [along as f32, used as f32]
}
