//! Joint angles in, poses or Jacobians of the tips out.

use nalgebra::{Rotation3, UnitQuaternion};
use tesaki::kinematics::{Chain, Posture};
use tesaki_description::urdf::{PathJoint, SerialPath};

use super::{Results, Row, Table, drives, exact};
use crate::failure::Failure;

const ROWS: [&str; 6] = ["vx", "vy", "vz", "wx", "wy", "wz"];

/// Position and orientation of every tip.
pub fn poses(table: &Table, paths: &[SerialPath]) -> Result<Results, Failure> {
    let parts = ["x", "y", "z", "qx", "qy", "qz", "qw"];
    let header = paths.iter().flat_map(|path| parts.map(|part| format!("{}.{part}", path.tip))).collect();
    let chains: Vec<Chain> = paths.iter().map(SerialPath::chain).collect();
    compute(table, paths, header, |path, angles, _, values| {
        values.extend(pose(&chains[path].posture(angles)).map(exact));
        Ok(())
    })
}

/// `x, y, z, qx, qy, qz, qw` with qw ≥ 0.
fn pose(posture: &Posture) -> [f32; 7] {
    let (place, rotation) = (posture.tip().translation.vector, quaternion(&posture.tip().rotation));
    let [x, y, z, w] = rotation.coords.into();
    [place.x, place.y, place.z, x, y, z, w]
}

fn quaternion(rotation: &Rotation3<f32>) -> UnitQuaternion<f32> {
    let rotation = UnitQuaternion::from_rotation_matrix(rotation);
    if rotation.w < 0.0 { UnitQuaternion::new_unchecked(-rotation.into_inner()) } else { rotation }
}

/// The geometric Jacobian of every tip, in the columns of its drives.
pub fn jacobians(table: &Table, paths: &[SerialPath]) -> Result<Results, Failure> {
    let mut header = Vec::new();
    for path in paths {
        for row in ROWS {
            header.extend(path.drives.iter().map(|drive| format!("{}.{row}.{}", path.tip, drive.name)));
        }
    }
    let chains: Vec<Chain> = paths.iter().map(SerialPath::chain).collect();
    compute(table, paths, header, |index, angles, _, values| {
        let (path, jacobian) = (&paths[index], chains[index].posture(angles).jacobian());
        for row in 0..ROWS.len() {
            for drive in 0..path.drives.len() {
                // A mimic joint moves with its drive: the chain rule.
                let joints = path.joints.iter().enumerate().filter(|(_, joint)| joint.drive == drive);
                let sum = joints.map(|(column, joint)| joint.multiplier * jacobian[(row, column)]).sum();
                values.push(exact(sum));
            }
        }
        Ok(())
    })
}

/// `one` adds the values of a path, given by its index, at the angles of its joints in a row.
pub fn compute(
    table: &Table,
    paths: &[SerialPath],
    header: Vec<String>,
    mut one: impl FnMut(usize, &[f32], &Row, &mut Vec<String>) -> Result<(), Failure>,
) -> Result<Results, Failure> {
    let used: Vec<String> = drives(paths).iter().map(|drive| drive.name.clone()).collect();
    let columns = paths.iter().map(|path| {
        path.drives
            .iter()
            .map(|drive| table.needed(&drive.name, "angle [rad]"))
            .collect::<Result<Vec<_>, _>>()
    });
    let columns: Vec<Vec<usize>> = columns.collect::<Result<_, _>>()?;
    let mut watch = Watch::new(paths);
    let mut rows = Vec::new();
    for row in &table.rows {
        let mut values = Vec::new();
        for (index, (path, columns)) in paths.iter().zip(&columns).enumerate() {
            let angles = columns.iter().map(|&column| table.number(row, column));
            let angles = path.angles(&angles.collect::<Result<Vec<_>, _>>()?);
            watch.look(index, &angles, row);
            one(index, &angles, row, &mut values)?;
        }
        rows.push(values);
    }
    Ok(Results { header, rows, notes: watch.notes(table.rows.len()), used })
}

/// Counts angles outside limits.
struct Watch<'a> {
    joints: Vec<Watched<'a>>,
}

/// One joint, in the first path that has it.
struct Watched<'a> {
    path: usize,
    index: usize,
    joint: &'a PathJoint,
    outside: usize,
    first: u64,
}

impl<'a> Watch<'a> {
    fn new(paths: &'a [SerialPath]) -> Self {
        let mut joints: Vec<Watched<'_>> = Vec::new();
        for (path, one) in paths.iter().enumerate() {
            for (index, joint) in one.joints.iter().enumerate() {
                if !joints.iter().any(|known| known.joint.name == joint.name) {
                    joints.push(Watched { path, index, joint, outside: 0, first: 0 });
                }
            }
        }
        Self { joints }
    }

    fn look(&mut self, path: usize, angles: &[f32], row: &Row) {
        for watched in self.joints.iter_mut().filter(|watched| watched.path == path) {
            let (Some((lower, upper)), Some(angle)) = (watched.joint.limits, angles.get(watched.index))
            else {
                continue;
            };
            if *angle < lower || *angle > upper {
                if watched.outside == 0 {
                    watched.first = row.line;
                }
                watched.outside += 1;
            }
        }
    }

    fn notes(&self, rows: usize) -> Vec<String> {
        let outside = self.joints.iter().filter(|watched| watched.outside > 0);
        outside
            .map(|Watched { joint, outside, first, .. }| {
                let (lower, upper) = joint.limits.unwrap_or_default();
                format!(
                    "{}: {outside} of {rows} angles outside its limits {lower} to {upper} rad, first in line {first}; \
                     computed all the same",
                    joint.name
                )
            })
            .collect()
    }
}
