//! Kinematics and dynamics of a robot, for many postures at once.

use std::path::PathBuf;
use std::time::Instant;

use nalgebra::{IsometryMatrix3, Quaternion, Translation3, UnitQuaternion, Vector3, Vector6};
use numpy::{PyArray1, PyArray2, PyArray3, PyArrayMethods as _, PyUntypedArrayMethods as _};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use tesaki::kinematics::{Chain, InverseKinematics, InverseKinematicsError, Posture, Target};
use tesaki::model::{ChainJoint, Coupling, MAX_CHAIN_JOINTS};
use tesaki::robot::Robot as CoreRobot;
use tesaki_description::robot::RobotFolder;

use crate::arrays::{Input, Length, contiguous, output, same_rows};
use crate::error::{FileError, file};

/// Maximum deviation of a quaternion's length from 1.
const LENGTH_TOLERANCE: f32 = 1e-2;

/// Poses and Jacobians.
type Forward<'py> = (Bound<'py, PyArray2<f32>>, Bound<'py, PyArray3<f32>>);

/// Angles found, and for each target whether it was reached, the distance [m] and the angle [rad] to it.
type Found<'py> = (
    Bound<'py, PyArray2<f32>>,
    Bound<'py, PyArray1<bool>>,
    Bound<'py, PyArray1<f32>>,
    Bound<'py, PyArray1<f32>>,
);

/// A robot from its folder (``robot.urdf`` and ``controller.toml``), with the kinematics and dynamics of the
/// control core, in single precision as on the board.
///
/// Postures come as an array ``q`` of shape (n, k): n postures of the k joints of one tip, in the order of
/// ``joints_of(tip)``. An array of float32 in C order is read in place; others are converted. Everything is
/// in the frame of the robot's base: m, rad, N, N·m, kg. Angles outside their limits are accepted.
///
/// Args:
///     folder: path of the robot's folder.
///
/// Raises:
///     FileError: all errors in the folder, by file and line.
#[pyclass(frozen, module = "tesaki")]
pub struct Robot {
    pub folder: RobotFolder,
    core: Box<CoreRobot>,
    /// The chain of each tip, with the rotors of its own joints.
    chains: Vec<Chain>,
}

/// A tip's chain with the joints that Python sees: those with a motor that move it. Mimic joints follow them.
struct Tip<'a> {
    chain: &'a Chain,
    name: &'a str,
    /// Names and limits [rad] of the joints that Python sees.
    joints: Vec<(&'a str, (f32, f32))>,
    /// The coupling of each joint of the chain, base to tip, to an index into `joints`.
    couplings: Vec<Coupling>,
}

impl Tip<'_> {
    fn count(&self) -> usize {
        self.joints.len()
    }

    fn shape(&self) -> [Length; 2] {
        [Length::Any("n"), Length::Just(self.count())]
    }

    /// Returns the meaning of an array of its joints, for messages.
    fn meaning(&self, quantity: &str) -> String {
        let names: Vec<&str> = self.joints.iter().map(|(name, _)| *name).collect();
        format!("{quantity} of the joints {} of {}", names.join(", "), self.name)
    }

    fn input<'py>(&self, value: &Bound<'py, PyAny>, name: &str, quantity: &str) -> PyResult<Input<'py>> {
        Input::new(value, name, &self.shape(), &self.meaning(quantity))
    }

    /// Returns the angles of the chain.
    fn angles(&self, q: &[f32]) -> [f32; MAX_CHAIN_JOINTS] {
        self.of_chain(|coupling| {
            coupling.angle(q.get(usize::from(coupling.actuated)).copied().unwrap_or(0.0))
        })
    }

    /// Returns the velocities or accelerations of the chain.
    fn rates(&self, values: &[f32]) -> [f32; MAX_CHAIN_JOINTS] {
        self.of_chain(|coupling| {
            coupling.multiplier * values.get(usize::from(coupling.actuated)).copied().unwrap_or(0.0)
        })
    }

    fn of_chain(&self, value: impl Fn(&Coupling) -> f32) -> [f32; MAX_CHAIN_JOINTS] {
        let mut values = [0.0; MAX_CHAIN_JOINTS];
        values.iter_mut().zip(&self.couplings).for_each(|(place, coupling)| *place = value(coupling));
        values
    }

    fn chain_joints(&self) -> usize {
        self.couplings.len()
    }

    /// Writes poses to `poses`, 7 numbers per posture, and Jacobians to `jacobians`, 6 k per posture; an
    /// empty slice is left out.
    fn forward(&self, q: &[f32], poses: &mut [f32], jacobians: &mut [f32]) {
        let count = self.count();
        let mut posture = Posture::default();
        let mut poses = poses.chunks_exact_mut(7);
        let mut jacobians = jacobians.chunks_exact_mut(6 * count);
        for q in q.chunks_exact(count) {
            self.chain.update_posture(&self.angles(q)[..self.chain_joints()], &mut posture);
            if let Some(pose) = poses.next() {
                pose.copy_from_slice(&flat(&posture));
            }
            if let Some(place) = jacobians.next() {
                let jacobian = posture.jacobian();
                for (row, place) in place.chunks_exact_mut(count).enumerate() {
                    place.fill(0.0);
                    for (joint, coupling) in self.couplings.iter().enumerate() {
                        place[usize::from(coupling.actuated)] += jacobian[(row, joint)] * coupling.multiplier;
                    }
                }
            }
        }
    }

    /// Returns the solver of the inverse kinematics, within the joints' limits.
    fn solver(&self) -> PyResult<InverseKinematics> {
        let limits = self.couplings.iter().map(|coupling| {
            let (_, (lower, upper)) = self.joints[usize::from(coupling.actuated)];
            let ends = [lower, upper].map(|angle| coupling.angle(angle));
            (ends[0].min(ends[1]), ends[0].max(ends[1]))
        });
        let limits: Vec<_> = limits.collect();
        let mut solver = InverseKinematics::try_new(&limits).map_err(|error| self.unsolvable(&error))?;
        let leaders: Vec<usize> = (0..self.count()).map(|column| self.leader(column)).collect();
        for (joint, coupling) in self.couplings.iter().enumerate() {
            let leader = leaders[usize::from(coupling.actuated)];
            if joint != leader {
                let led = self.couplings[leader];
                let multiplier = coupling.multiplier / led.multiplier;
                solver = solver
                    .with_mimic(joint, leader, multiplier, coupling.offset - multiplier * led.offset)
                    .map_err(|error| self.unsolvable(&error))?;
            }
        }
        Ok(solver)
    }

    /// Returns the first joint of the chain that `column` moves.
    fn leader(&self, column: usize) -> usize {
        self.couplings.iter().position(|coupling| usize::from(coupling.actuated) == column).unwrap_or(0)
    }

    fn unsolvable(&self, error: &dyn std::fmt::Debug) -> PyErr {
        PyValueError::new_err(format!("the joints of {}: {error:?}", self.name))
    }
}

/// Returns as many values as a chain can have joints; 0 beyond the given ones.
fn fixed(values: &[f32]) -> [f32; MAX_CHAIN_JOINTS] {
    let mut all = [0.0; MAX_CHAIN_JOINTS];
    all.iter_mut().zip(values).for_each(|(place, value)| *place = *value);
    all
}

/// Returns `x, y, z, qx, qy, qz, qw` with qw ≥ 0.
fn flat(posture: &Posture) -> [f32; 7] {
    let place = posture.tip().translation.vector;
    let [x, y, z, w]: [f32; 4] = UnitQuaternion::from_rotation_matrix(&posture.tip().rotation).coords.into();
    let sign = if w < 0.0 { -1.0 } else { 1.0 };
    [place.x, place.y, place.z, sign * x, sign * y, sign * z, sign * w]
}

#[pymethods]
impl Robot {
    #[new]
    fn new(folder: PathBuf) -> PyResult<Self> {
        let folder = RobotFolder::load(&folder).map_err(file)?;
        let mut core = Box::new(CoreRobot::NONE);
        core.configure(&folder.model).map_err(|error| FileError::new_err(error.to_string()))?;
        let chains = core.chains().iter().enumerate().map(|(index, config)| {
            // A mimic joint has no motor.
            let rotors = folder.model.joints_of(index).map(|joint| match joint {
                ChainJoint::Driven(_, joint) => joint.motor.rotor_inertia,
                ChainJoint::Mimic(_) => 0.0,
            });
            config.chain.clone().with_rotor_inertia(rotors)
        });
        Ok(Self { chains: chains.collect(), folder, core })
    }

    /// Its name.
    #[getter]
    fn name(&self) -> &str {
        &self.folder.model.name
    }

    /// Names of all joints, in the order of boards and recordings.
    #[getter]
    fn joints(&self) -> Vec<&str> {
        self.folder.model.joints.iter().map(|joint| joint.name.as_str()).collect()
    }

    /// Names of the tips.
    #[getter]
    fn tips(&self) -> Vec<&str> {
        self.folder.model.chains.iter().map(|chain| chain.name.as_str()).collect()
    }

    /// Limits of all joints, (joints, 2) [rad].
    #[getter]
    fn limits<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let joints = &self.folder.model.joints;
        output(py, [joints.len(), 2], |values| {
            for (place, joint) in values.chunks_exact_mut(2).zip(joints) {
                place.copy_from_slice(&[joint.limits.lower, joint.limits.upper]);
            }
        })
    }

    /// Names of the joints with a motor that move a tip, base to tip: the columns of ``q``. A joint without a
    /// motor (a mimic joint) has no column; its column is that of the joint that it follows.
    ///
    /// Args:
    ///     tip: name of the tip; needed where there are several.
    #[pyo3(signature = (tip=None))]
    fn joints_of(&self, tip: Option<&str>) -> PyResult<Vec<&str>> {
        Ok(self.tip(tip)?.joints.iter().map(|(name, _)| *name).collect())
    }

    /// Forward kinematics: poses of a tip, (n, 7): x, y, z [m] and the quaternion qx, qy, qz, qw with qw ≥ 0.
    ///
    /// Args:
    ///     q: (n, k) angles [rad].
    ///     tip: name of the tip; needed where there are several.
    #[pyo3(signature = (q, tip=None))]
    fn fk<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        tip: Option<&str>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let tip = self.tip(tip)?;
        let q = tip.input(q, "q", "angles")?;
        let values = q.values();
        output(py, [q.rows(), 7], |poses| tip.forward(values, poses, &mut []))
    }

    /// Geometric Jacobians of a tip, (n, 6, k): rows vx, vy, vz [m/s], wx, wy, wz [rad/s] for each rad/s.
    ///
    /// Args:
    ///     q: (n, k) angles [rad].
    ///     tip: name of the tip; needed where there are several.
    #[pyo3(signature = (q, tip=None))]
    fn jacobian<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        tip: Option<&str>,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let tip = self.tip(tip)?;
        let q = tip.input(q, "q", "angles")?;
        let values = q.values();
        output(py, [q.rows(), 6, tip.count()], |jacobians| tip.forward(values, &mut [], jacobians))
    }

    /// ``(fk(q), jacobian(q))``, computed together.
    ///
    /// Args:
    ///     q: (n, k) angles [rad].
    ///     tip: name of the tip; needed where there are several.
    #[pyo3(signature = (q, tip=None))]
    fn fk_jacobian<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        tip: Option<&str>,
    ) -> PyResult<Forward<'py>> {
        let tip = self.tip(tip)?;
        let q = tip.input(q, "q", "angles")?;
        let values = q.values();
        let poses = PyArray2::<f32>::zeros(py, [q.rows(), 7], false);
        let mut writing = poses.readwrite();
        let places = writing.as_slice_mut()?;
        let jacobians =
            output(py, [q.rows(), 6, tip.count()], |jacobians| tip.forward(values, places, jacobians))?;
        drop(writing);
        Ok((poses, jacobians))
    }

    /// Inverse kinematics: angles that bring a tip to places or poses. Searches within the joints' limits,
    /// each target from the previous angles.
    ///
    /// Args:
    ///     targets: (n, 3) places x, y, z [m], or (n, 7) poses with the quaternion qx, qy, qz, qw.
    ///     tip: name of the tip; needed where there are several.
    ///     start: (k,) angles from which the first search starts [rad]; the middle of the limits if not
    ///         given.
    ///
    /// Returns:
    ///     ``(q, reached, distance, angle)``: angles (n, k) [rad], whether each target was reached (n,), and
    ///     how far the tip is from it, (n,) [m] and (n,) [rad]. If it was not reached, the angles are the
    ///     best ones found.
    #[pyo3(signature = (targets, tip=None, start=None))]
    fn ik<'py>(
        &self,
        py: Python<'py>,
        targets: &Bound<'py, PyAny>,
        tip: Option<&str>,
        start: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Found<'py>> {
        let tip = self.tip(tip)?;
        let targets = contiguous(targets, "targets")?;
        let width = if targets.shape().get(1) == Some(&7) { 7 } else { 3 };
        let what = "places x, y, z, or (n, 7): poses x, y, z, qx, qy, qz, qw";
        let targets =
            Input::new(targets.as_any(), "targets", &[Length::Any("n"), Length::Just(width)], what)?;
        let start = start
            .map(|start| Input::new(start, "start", &[Length::Just(tip.count())], &tip.meaning("angles")))
            .transpose()?;
        let middle = tip.joints.iter().map(|(_, (lower, upper))| 0.5 * (lower + upper));
        let start = start.map_or_else(|| middle.collect(), |start| start.values().to_vec());
        let aims = targets.values().chunks_exact(width).enumerate().map(|(row, target)| aim(row, target));
        let aims: Vec<Target> = aims.collect::<PyResult<_>>()?;
        let solver = tip.solver()?;
        let (mut reached, mut distances, mut turns) = (Vec::new(), Vec::new(), Vec::new());
        let mut invalid = None;
        let angles = output(py, [aims.len(), tip.count()], |values| {
            let (count, chain_joints) = (tip.count(), tip.chain_joints());
            let mut q = tip.angles(&start);
            for (row, (place, aim)) in values.chunks_exact_mut(count).zip(&aims).enumerate() {
                let (found, report) = match solver.solve(tip.chain, aim, &mut q[..chain_joints]) {
                    Ok(report) => (true, report),
                    Err(InverseKinematicsError::NotReached(report)) => (false, report),
                    Err(InverseKinematicsError::NotFinite | InverseKinematicsError::Joints) => {
                        invalid = Some(row);
                        return;
                    }
                };
                reached.push(found);
                distances.push(report.position_error);
                turns.push(report.rotation_error);
                for (column, angle) in place.iter_mut().enumerate() {
                    let leader = tip.leader(column);
                    let coupling = tip.couplings[leader];
                    *angle = (q[leader] - coupling.offset) / coupling.multiplier;
                }
            }
        })?;
        if let Some(row) = invalid {
            return Err(PyValueError::new_err(format!(
                "targets: row {row} is not finite or too far to compute, or start is not finite"
            )));
        }
        let (distances, turns) = (PyArray1::from_vec(py, distances), PyArray1::from_vec(py, turns));
        Ok((angles, PyArray1::from_vec(py, reached), distances, turns))
    }

    /// Inverse dynamics by recursive Newton–Euler: torques of the joints, (n, k) [N·m], with the inertia of
    /// the tip's own rotors, without friction.
    ///
    /// Args:
    ///     q: (n, k) angles [rad].
    ///     qd: (n, k) velocities [rad/s]; 0 if not given.
    ///     qdd: (n, k) accelerations [rad/s²]; 0 if not given.
    ///     tip: name of the tip; needed where there are several.
    ///     gravity: (3,) [m/s²]; the robot's own if not given.
    ///     wrench: (n, 6) external force [N] and moment [N·m] on the tip, about its origin; 0 if not given.
    #[pyo3(signature = (q, qd=None, qdd=None, tip=None, *, gravity=None, wrench=None))]
    #[expect(clippy::too_many_arguments, reason = "named by who calls")]
    fn rnea<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        qd: Option<&Bound<'py, PyAny>>,
        qdd: Option<&Bound<'py, PyAny>>,
        tip: Option<&str>,
        gravity: Option<&Bound<'py, PyAny>>,
        wrench: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Bound<'py, PyArray2<f32>>> {
        let tip = self.tip(tip)?;
        let q = tip.input(q, "q", "angles")?;
        let qd = qd.map(|qd| tip.input(qd, "qd", "velocities")).transpose()?;
        let qdd = qdd.map(|qdd| tip.input(qdd, "qdd", "accelerations")).transpose()?;
        let six = [Length::Any("n"), Length::Just(6)];
        let wrench =
            wrench.map(|wrench| Input::new(wrench, "wrench", &six, "force and moment")).transpose()?;
        for (name, other) in [("qd", &qd), ("qdd", &qdd), ("wrench", &wrench)] {
            other.as_ref().map_or(Ok(()), |other| same_rows(name, other.rows(), "q", q.rows()))?;
        }
        let gravity = gravity
            .map(|gravity| Input::new(gravity, "gravity", &[Length::Just(3)], "x, y, z"))
            .transpose()?;
        let gravity = gravity.map_or(*self.core.gravity(), |gravity| Vector3::from(gravity.array()));
        let (count, rows) = (tip.count(), q.rows());
        let [q, qd, qdd] =
            [Some(&q), qd.as_ref(), qdd.as_ref()].map(|input| input.map_or(&[][..], |input| input.values()));
        let wrench = wrench.as_ref().map_or(&[][..], |wrench| wrench.values());
        output(py, [rows, count], |torques| {
            let none = [0.0; MAX_CHAIN_JOINTS];
            for (row, place) in torques.chunks_exact_mut(count).enumerate() {
                let part = |values: &'_ [f32], width: usize| {
                    fixed(values.get(row * width..(row + 1) * width).unwrap_or(&none[..width]))
                };
                let wrench = Vector6::from_column_slice(&part(wrench, 6)[..6]);
                let [q, qd, qdd] =
                    [tip.angles(&part(q, count)), tip.rates(&part(qd, count)), tip.rates(&part(qdd, count))];
                let joints = ..tip.chain_joints();
                let mut of_chain = [0.0; MAX_CHAIN_JOINTS];
                tip.chain.inverse_dynamics_with_wrench(
                    &gravity,
                    &wrench,
                    &q[joints],
                    &qd[joints],
                    &qdd[joints],
                    &mut of_chain[joints],
                );
                place.fill(0.0);
                for (torque, coupling) in of_chain.iter().zip(&tip.couplings) {
                    place[usize::from(coupling.actuated)] += coupling.multiplier * torque;
                }
            }
        })
    }

    /// Mass matrices, (n, k, k) [kg·m²], with the inertia of the tip's own rotors.
    ///
    /// Args:
    ///     q: (n, k) angles [rad].
    ///     tip: name of the tip; needed where there are several.
    #[pyo3(signature = (q, tip=None))]
    fn mass<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        tip: Option<&str>,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let tip = self.tip(tip)?;
        let q = tip.input(q, "q", "angles")?;
        let (count, values) = (tip.count(), q.values());
        output(py, [q.rows(), count, count], |matrices| {
            for (q, place) in values.chunks_exact(count).zip(matrices.chunks_exact_mut(count * count)) {
                let matrix = tip.chain.mass_matrix(&tip.angles(q)[..tip.chain_joints()]);
                place.fill(0.0);
                for (row, left) in tip.couplings.iter().enumerate() {
                    for (column, right) in tip.couplings.iter().enumerate() {
                        let part = left.multiplier * right.multiplier * matrix[(row, column)];
                        let [left, right] = [left, right].map(|coupling| usize::from(coupling.actuated));
                        place[left * count + right] += part;
                    }
                }
            }
        })
    }

    /// Measures the time of the loop of ``fk_jacobian`` in Rust alone, with Rust's own arrays [s], for its
    /// test.
    #[pyo3(signature = (q, tip=None))]
    fn _time_fk_jacobian<'py>(
        &self,
        py: Python<'py>,
        q: &Bound<'py, PyAny>,
        tip: Option<&str>,
    ) -> PyResult<f64> {
        let tip = self.tip(tip)?;
        let q = tip.input(q, "q", "angles")?.values().to_vec();
        Ok(py.detach(|| {
            let start = Instant::now();
            let rows = q.len() / tip.count();
            let (mut poses, mut jacobians) = (vec![0.0; 7 * rows], vec![0.0; 6 * q.len()]);
            tip.forward(&q, &mut poses, &mut jacobians);
            std::hint::black_box((poses, jacobians));
            start.elapsed().as_secs_f64()
        }))
    }

    fn __repr__(&self) -> String {
        let model = &self.folder.model;
        format!(
            "Robot({:?}, {} joints, tips {})",
            model.name.as_str(),
            model.joints.len(),
            self.tips().join(", ")
        )
    }
}

impl Robot {
    fn tip(&self, name: Option<&str>) -> PyResult<Tip<'_>> {
        let model = &self.folder.model;
        let index = match name {
            None if model.chains.len() == 1 => Some(0),
            None => None,
            Some(name) => model.chains.iter().position(|chain| chain.name == name),
        };
        let found = index.and_then(|index| Some((index, self.chains.get(index)?, model.chains.get(index)?)));
        let (index, chain, described) = found.ok_or_else(|| {
            let asked =
                name.map_or_else(|| "tip is missing".to_owned(), |name| format!("tip {name:?} is none"));
            PyValueError::new_err(format!("{asked}: {} has the tips {}", model.name, self.tips().join(", ")))
        })?;
        let mut columns = Vec::new();
        let couplings = model.joints_of(index).map(|joint| {
            let coupling = joint.coupling();
            let known = columns.iter().position(|actuated| *actuated == coupling.actuated);
            let column = known.unwrap_or_else(|| {
                columns.push(coupling.actuated);
                columns.len() - 1
            });
            #[expect(clippy::cast_possible_truncation, reason = "at most 7")]
            Coupling { actuated: column as u8, ..coupling }
        });
        let couplings = couplings.collect();
        let joints = columns.iter().filter_map(|joint| model.joints.get(usize::from(*joint)));
        let joints = joints.map(|joint| (joint.name.as_str(), (joint.limits.lower, joint.limits.upper)));
        Ok(Tip { chain, name: &described.name, joints: joints.collect(), couplings })
    }
}

/// Reads the target in a row of `targets`.
fn aim(row: usize, target: &[f32]) -> PyResult<Target> {
    let [x, y, z, qx, qy, qz, qw] = fixed(target);
    let position = Vector3::new(x, y, z);
    if target.len() < 7 {
        return Ok(Target::Position(position));
    }
    let quaternion = Quaternion::new(qw, qx, qy, qz);
    let length = quaternion.norm();
    if (length - 1.0).abs() > LENGTH_TOLERANCE {
        return Err(PyValueError::new_err(format!(
            "targets: the quaternion of row {row} has length {length}, not 1: check qx, qy, qz, qw and their order"
        )));
    }
    let rotation = UnitQuaternion::from_quaternion(quaternion).to_rotation_matrix();
    Ok(Target::Pose(IsometryMatrix3::from_parts(Translation3::from(position), rotation)))
}
