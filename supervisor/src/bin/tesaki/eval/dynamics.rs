//! Joint states in, torques, mass matrices or bias accelerations out.

use nalgebra::{Vector3, Vector6};
use tesaki::kinematics::Chain;
use tesaki::model::MAX_CHAIN_JOINTS;
use tesaki_description::urdf::SerialPath;

use super::{Results, Row, Table, exact, forward};
use crate::failure::Failure;

/// Gravity when the table does not say [m/s²].
const GRAVITY: [f32; 3] = [0.0, 0.0, -9.81];

/// One tip.
struct Tip<'a> {
    path: &'a SerialPath,
    chain: Chain,
    velocity: Option<Vec<usize>>,
    acceleration: Option<Vec<usize>>,
    wrench: Option<Vec<usize>>,
    /// For each joint of the path, the column of its rotor.
    rotors: Vec<Option<usize>>,
}

/// The torque of every drive.
pub fn torques(table: &Table, paths: &[SerialPath]) -> Result<Results, Failure> {
    let tips = paths.iter().map(|path| {
        let mut tip = Tip::new(table, path)?;
        tip.velocity = tip.of_drives(table, "velocity", "velocity [rad/s]")?;
        tip.acceleration = tip.of_drives(table, "acceleration", "acceleration [rad/s²]")?;
        let wrench = ["fx", "fy", "fz", "mx", "my", "mz"].map(|part| format!("{}.{part}", path.tip));
        tip.wrench = table.all_or_none(&wrench, "wrench on the tip [N, N·m]: all six, or none")?;
        Ok(tip)
    });
    let tips: Vec<Tip<'_>> = tips.collect::<Result<_, Failure>>()?;
    let gravity =
        table.all_or_none(&["gx", "gy", "gz"].map(str::to_owned), "gravity [m/s²]: all three, or none")?;
    let header = paths
        .iter()
        .flat_map(|path| path.drives.iter().map(|drive| format!("{}.tau.{}", path.tip, drive.name)));
    let mut results = forward::compute(table, paths, header.collect(), |index, q, row, values| {
        let tip = &tips[index];
        let down = if gravity.is_some() { table.numbers(row, gravity.as_ref())? } else { GRAVITY };
        let qd = tip.joints(table, row, tip.velocity.as_ref())?;
        let qdd = tip.joints(table, row, tip.acceleration.as_ref())?;
        let wrench = Vector6::from(table.numbers::<6>(row, tip.wrench.as_ref())?);
        let (chain, mut torques) = (tip.chain(table, row)?, vec![0.0; q.len()]);
        chain.inverse_dynamics_with_wrench(&Vector3::from(down), &wrench, q, &qd, &qdd, &mut torques);
        let drives = 0..tip.path.drives.len();
        let sums = drives.map(|drive| {
            let torques = tip.path.joints.iter().zip(&torques).filter(|(joint, _)| joint.drive == drive);
            torques.map(|(joint, torque)| joint.multiplier * torque).sum()
        });
        tip.push(table, row, sums, values)
    })?;
    finish(&mut results, table, &tips, gravity);
    tell_masses(&mut results, paths);
    Ok(results)
}

/// The mass matrix of every tip's drives, row by row.
pub fn mass_matrices(table: &Table, paths: &[SerialPath]) -> Result<Results, Failure> {
    let tips: Vec<Tip<'_>> = paths.iter().map(|path| Tip::new(table, path)).collect::<Result<_, _>>()?;
    let header = paths.iter().flat_map(|path| {
        let names = || path.drives.iter().map(|drive| &drive.name);
        names().flat_map(move |row| names().map(move |column| format!("{}.{row}.{column}", path.tip)))
    });
    let mut results = forward::compute(table, paths, header.collect(), |index, q, row, values| {
        let tip = &tips[index];
        let (matrix, count) = (tip.chain(table, row)?.mass_matrix(q), tip.path.drives.len());
        // Joints move with their drives: Gᵀ M G.
        let joints =
            |drive| tip.path.joints.iter().enumerate().filter(move |(_, joint)| joint.drive == drive);
        let elements = (0..count * count).map(|element| {
            let pairs = joints(element / count)
                .flat_map(|left| joints(element % count).map(move |right| (left, right)));
            pairs.map(|((i, a), (j, b))| a.multiplier * b.multiplier * matrix[(i, j)]).sum()
        });
        tip.push(table, row, elements, values)
    })?;
    finish(&mut results, table, &tips, None);
    tell_masses(&mut results, paths);
    Ok(results)
}

/// The bias acceleration of every tip.
pub fn biases(table: &Table, paths: &[SerialPath]) -> Result<Results, Failure> {
    let tips = paths.iter().map(|path| {
        let mut tip = Tip { rotors: Vec::new(), ..Tip::new(table, path)? };
        let columns = path
            .drives
            .iter()
            .map(|drive| table.needed(&format!("{}.velocity", drive.name), "velocity [rad/s]"));
        tip.velocity = Some(columns.collect::<Result<_, _>>()?);
        Ok(tip)
    });
    let tips: Vec<Tip<'_>> = tips.collect::<Result<_, Failure>>()?;
    let parts = ["ax", "ay", "az", "alphax", "alphay", "alphaz"];
    let header = paths.iter().flat_map(|path| parts.map(|part| format!("{}.{part}", path.tip))).collect();
    let mut results = forward::compute(table, paths, header, |index, q, row, values| {
        let tip = &tips[index];
        let qd = tip.joints(table, row, tip.velocity.as_ref())?;
        let bias = tip.chain.posture(q).bias_acceleration(&qd);
        tip.push(table, row, bias.iter().copied(), values)
    })?;
    finish(&mut results, table, &tips, None);
    Ok(results)
}

impl<'a> Tip<'a> {
    fn new(table: &Table, path: &'a SerialPath) -> Result<Self, Failure> {
        let rotor = |name: &str| {
            let itself = path.drives.iter().any(|drive| drive.name == name);
            table.column(&format!("{name}.rotor_inertia")).filter(|_| itself)
        };
        let rotors = path.joints.iter().map(|joint| rotor(&joint.name)).collect();
        Ok(Self { path, chain: path.chain(), velocity: None, acceleration: None, wrench: None, rotors })
    }

    /// The columns of this kind for all drives, or none.
    fn of_drives(&self, table: &Table, kind: &str, what: &str) -> Result<Option<Vec<usize>>, Failure> {
        let names: Vec<String> =
            self.path.drives.iter().map(|drive| format!("{}.{kind}", drive.name)).collect();
        table.all_or_none(&names, &format!("{what} of each joint, or of none"))
    }

    /// What is in `columns` for the drives, for the joints.
    fn joints(&self, table: &Table, row: &Row, columns: Option<&Vec<usize>>) -> Result<Vec<f32>, Failure> {
        let drives = table.numbers::<MAX_CHAIN_JOINTS>(row, columns)?;
        let value = |drive: usize| drives.get(drive).copied().unwrap_or(0.0);
        Ok(self.path.joints.iter().map(|joint| joint.multiplier * value(joint.drive)).collect())
    }

    /// The chain with the rotors of this row.
    fn chain(&self, table: &Table, row: &Row) -> Result<Chain, Failure> {
        let rotor = |&column: &Option<usize>| {
            let Some(column) = column else { return Ok(0.0) };
            let inertia = table.number(row, column)?;
            if inertia < 0.0 {
                let name = table.header(column);
                return Err(table
                    .error(row.line, &format!("column {name}: {inertia} kg·m² is below 0: mend the value")));
            }
            Ok(inertia)
        };
        let rotors: Vec<f32> = self.rotors.iter().map(rotor).collect::<Result<_, _>>()?;
        Ok(self.chain.clone().with_rotor_inertia(rotors))
    }

    fn push(
        &self,
        table: &Table,
        row: &Row,
        results: impl Iterator<Item = f32>,
        values: &mut Vec<String>,
    ) -> Result<(), Failure> {
        for result in results {
            if !result.is_finite() {
                let message = format!(
                    "{}: a result is {result}, beyond single precision: values this large cannot be computed",
                    self.path.tip
                );
                return Err(table.error(row.line, &message));
            }
            values.push(exact(result));
        }
        Ok(())
    }

    fn used(&self) -> impl Iterator<Item = usize> {
        let columns = [&self.velocity, &self.acceleration, &self.wrench];
        columns.into_iter().flatten().flatten().chain(self.rotors.iter().flatten()).copied()
    }
}

fn finish(results: &mut Results, table: &Table, tips: &[Tip<'_>], gravity: Option<Vec<usize>>) {
    let used = tips.iter().flat_map(Tip::used).chain(gravity.into_iter().flatten());
    results.used.extend(used.map(|column| table.header(column).to_owned()));
}

/// Tells which masses are not in the results.
fn tell_masses(results: &mut Results, paths: &[SerialPath]) {
    for SerialPath { tip, joints, branches, .. } in paths {
        if joints.iter().all(|joint| joint.link.mass == 0.0) {
            results.notes.push(format!("{tip}: no link on the way to it has a mass"));
        }
        if !branches.is_empty() {
            results.notes.push(format!("{tip}: without what is behind {}", branches.join(", ")));
        }
    }
}
