//! Places or poses of the tips in, joint angles out.

use std::f32::consts::TAU;

use nalgebra::{IsometryMatrix3, Quaternion, Translation3, UnitQuaternion, Vector3};
use tesaki::kinematics::{
    Chain, InvalidJoint, InverseKinematics, InverseKinematicsError, SolveReport, Target,
};
use tesaki_description::urdf::{Drive, SerialPath};

use super::{Results, Row, Table, exact};
use crate::failure::Failure;

/// How far a quaternion's length may be from 1.
const LENGTH_TOLERANCE: f32 = 1e-2;

/// The joint angles that bring every tip to its target.
pub fn angles(table: &Table, paths: &[SerialPath]) -> Result<Results, Failure> {
    separate(paths)?;
    let mut tips = paths.iter().map(|path| Tip::new(table, path)).collect::<Result<Vec<_>, _>>()?;
    let header = paths.iter().flat_map(header).collect();
    let mut rows = Vec::new();
    for row in &table.rows {
        let mut values = Vec::new();
        for tip in &mut tips {
            tip.solve(table, row, &mut values)?;
        }
        rows.push(values);
    }
    let missed = tips.iter().filter(|tip| tip.missed > 0);
    let note =
        |tip: &Tip<'_>| format!("{}: {} of {} targets not reached", tip.path.tip, tip.missed, rows.len());
    let notes = missed.map(note).collect();
    let used =
        tips.iter().flat_map(|tip| &tip.used).filter_map(|&column| table.headers().get(column)).cloned();
    Ok(Results { header, notes, used: used.collect(), rows })
}

fn header(path: &SerialPath) -> Vec<String> {
    let joints = path.drives.iter().map(|drive| drive.name.clone());
    let results = ["status", "position_error", "rotation_error", "iterations"];
    joints.chain(results.map(|result| format!("{}.{result}", path.tip))).collect()
}

/// No joint can bring two tips to places of their own.
fn separate(paths: &[SerialPath]) -> Result<(), Failure> {
    for (index, path) in paths.iter().enumerate() {
        for other in paths.iter().take(index) {
            if let Some(drive) = path.drives.iter().find(|drive| other.drives.contains(drive)) {
                return Err(Failure::Usage(format!(
                    "the tips {} and {} share the joint {}: name one with --tip, or start behind the joint with --base",
                    other.tip, path.tip, drive.name
                )));
            }
        }
    }
    Ok(())
}

/// One tip with its solver.
struct Tip<'a> {
    path: &'a SerialPath,
    chain: Chain,
    solver: InverseKinematics,
    position: [usize; 3],
    rotation: Option<[usize; 4]>,
    /// The column of each drive's start, where there is one.
    starts: Vec<Option<usize>>,
    used: Vec<usize>,
    /// Where each drive is.
    angles: Vec<f32>,
    missed: usize,
}

impl<'a> Tip<'a> {
    fn new(table: &Table, path: &'a SerialPath) -> Result<Self, Failure> {
        let needed = |part: &str, what| table.needed(&format!("{}.{part}", path.tip), what);
        let [x, y, z] = ["x", "y", "z"].map(|part| needed(part, "position of the tip [m]"));
        let position = [x?, y?, z?];
        let parts = ["qx", "qy", "qz", "qw"];
        let oriented = parts.iter().any(|part| table.column(&format!("{}.{part}", path.tip)).is_some());
        let rotation = if oriented {
            let [x, y, z, w] = parts.map(|part| needed(part, "all four of the quaternion, or none"));
            Some([x?, y?, z?, w?])
        } else {
            None
        };
        let starts: Vec<_> = path.drives.iter().map(|drive| table.column(&drive.name)).collect();
        let used = position
            .into_iter()
            .chain(rotation.into_iter().flatten())
            .chain(starts.iter().flatten().copied());
        Ok(Self {
            chain: path.chain(),
            solver: solver(path).map_err(|error| refused(path, error))?,
            position,
            rotation,
            used: used.collect(),
            starts,
            angles: path.drives.iter().map(middle).collect(),
            missed: 0,
            path,
        })
    }

    fn solve(&mut self, table: &Table, row: &Row, values: &mut Vec<String>) -> Result<(), Failure> {
        let target = self.target(table, row)?;
        for (angle, column) in self.angles.iter_mut().zip(&self.starts) {
            if let Some(column) = *column {
                *angle = table.number(row, column)?;
            }
        }
        let mut q = self.path.angles(&self.angles);
        let (status, solved) = match self.solver.solve(&self.chain, &target, &mut q) {
            Ok(solved) => ("reached", solved),
            Err(InverseKinematicsError::NotReached(nearest)) => ("not reached", nearest),
            Err(InverseKinematicsError::NotFinite | InverseKinematicsError::Joints) => {
                return Err(
                    table.error(row.line, &format!("{}: the target is too far to compute", self.path.tip))
                );
            }
        };
        self.missed += usize::from(status != "reached");
        for drive in 0..self.angles.len() {
            let leader = self.path.leader(drive);
            let joint = leader.and_then(|leader| Some((self.path.joints.get(leader)?, q.get(leader)?)));
            if let (Some((joint, q)), Some(angle)) = (joint, self.angles.get_mut(drive)) {
                *angle = (q - joint.offset) / joint.multiplier;
            }
        }
        values.extend(self.angles.iter().copied().map(exact));
        let SolveReport { position_error, rotation_error, iterations } = solved;
        values.extend([
            status.to_owned(),
            exact(position_error),
            exact(rotation_error),
            iterations.to_string(),
        ]);
        Ok(())
    }

    fn target(&self, table: &Table, row: &Row) -> Result<Target, Failure> {
        let [x, y, z] = self.position.map(|column| table.number(row, column));
        let position = Vector3::new(x?, y?, z?);
        let Some(columns) = self.rotation else { return Ok(Target::Position(position)) };
        let [x, y, z, w] = columns.map(|column| table.number(row, column));
        let quaternion = Quaternion::new(w?, x?, y?, z?);
        let length = quaternion.norm();
        if (length - 1.0).abs() > LENGTH_TOLERANCE {
            let message = format!(
                "{}: the quaternion has length {length}, not 1: check qx, qy, qz, qw and their order",
                self.path.tip
            );
            return Err(table.error(row.line, &message));
        }
        let rotation = UnitQuaternion::from_quaternion(quaternion).to_rotation_matrix();
        Ok(Target::Pose(IsometryMatrix3::from_parts(Translation3::from(position), rotation)))
    }
}

/// Where the first row starts.
fn middle(drive: &Drive) -> f32 {
    drive.limits.map_or(0.0, |(lower, upper)| 0.5 * (lower + upper))
}

/// The core's solver, whose mimic joints follow a joint of the same path.
fn solver(path: &SerialPath) -> Result<InverseKinematics, InvalidJoint> {
    let leaders: Vec<Option<usize>> = (0..path.drives.len()).map(|drive| path.leader(drive)).collect();
    let leader = |drive: usize| leaders.get(drive).copied().flatten();
    let limits = path.joints.iter().enumerate().map(|(index, joint)| {
        let (lower, upper) = joint.limits.unwrap_or((-TAU, TAU));
        let drive = path.drives.get(joint.drive);
        match (leader(joint.drive), drive.and_then(|drive| drive.limits)) {
            // It never moves.
            (None, _) => (joint.offset, joint.offset),
            // The joint that it mimics, which is not in this path, has limits of its own.
            (Some(leader), Some(drive)) if leader == index => {
                let ends = [drive.0, drive.1].map(|angle| joint.angle(angle));
                (lower.max(ends[0].min(ends[1])), upper.min(ends[0].max(ends[1])))
            }
            _ => (lower, upper),
        }
    });
    let mut solver = InverseKinematics::try_new(&limits.collect::<Vec<_>>())?;
    for (index, joint) in path.joints.iter().enumerate() {
        let Some(leader) = leader(joint.drive).filter(|&leader| leader != index) else { continue };
        let Some(first) = path.joints.get(leader) else { continue };
        let multiplier = joint.multiplier / first.multiplier;
        solver = solver.with_mimic(index, leader, multiplier, joint.offset - multiplier * first.offset)?;
    }
    Ok(solver)
}

fn refused(path: &SerialPath, error: InvalidJoint) -> Failure {
    let name = |joint: usize| path.joints.get(joint).map_or("?", |joint| joint.name.as_str());
    Failure::Other(match error {
        InvalidJoint::TooMany => format!("{}: more joints than a chain can have", path.tip),
        InvalidJoint::Limits { joint } => {
            let name = name(joint);
            format!(
                "joint {name}: no angle within its limits and those of what it mimics: mend <limit> or <mimic>"
            )
        }
        InvalidJoint::Mimic { joint } => {
            format!("joint {}: its <mimic> makes no sense: mend it", name(joint))
        }
        InvalidJoint::MimicLimits { joint } => {
            let name = name(joint);
            format!(
                "joint {name}: its limits and those of the joint that it mimics exclude each other: mend <limit>"
            )
        }
    })
}
