//! Scenarios, stepped from Python.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use numpy::{PyArray1, PyArrayMethods as _};
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::{PyDict, PyList};
use tesaki_description::robot::RobotFolder;
use tesaki_sim::scenario::{SCENARIOS, Scenario};
use tesaki_sim::stepped::{Halt, MachineTruth, Stepped, Turn, View};
use tesaki_supervisor::words::named;

use crate::arrays::output;
use crate::command::{decode, encode};
use crate::error::{SimulationError, file};
use crate::value::dictionary;

/// Control periods between two checks for Ctrl-C.
const STRETCH: usize = 200;

/// Returns all scenarios: dictionaries with ``name``, ``about``, ``robot`` (its folder in ``robots/``) and
/// ``duration`` [s].
#[pyfunction]
pub fn scenarios(py: Python<'_>) -> PyResult<Bound<'_, PyList>> {
    let list = PyList::empty(py);
    for scenario in SCENARIOS {
        let entry = PyDict::new(py);
        entry.set_item("name", scenario.name)?;
        entry.set_item("about", scenario.about)?;
        entry.set_item("robot", scenario.robot)?;
        entry.set_item("duration", scenario.duration)?;
        list.append(entry)?;
    }
    Ok(list)
}

/// A scenario that pauses in each control period of an enabled task; see ``tesaki.sim``.
///
/// ``begin()`` and each ``step()`` return the state as a dictionary, or ``None`` at the scenario's end, after
/// which ``summary()`` returns what it measured. A state contains
///
/// - what the board reports of its last tick: ``position``, ``velocity``, ``reference``, ``torque`` (joints,)
///   [rad, rad/s, rad, N·m], ``tip_position``, ``tip_force``, ``tip_torque`` (tips, 3) [m, N, N·m],
///   ``report`` (the task's telemetry), ``task`` and ``tick``;
/// - ``truth``: the plant's true state, which no sensor shows, a dictionary of arrays, ``None`` before the
///   machine has moved;
/// - ``scripted``: the command that the scenario is about to send, as ``(kind, values)``; ``None`` if it
///   sends nothing;
/// - ``refused``: why the board refused the last command of the caller;
/// - ``fault``: the fault that ends the trial;
/// - ``trial``, from 1;
/// - ``is_over``: the trial ends here, and a command now is not sent.
///
/// Args:
///     scenario: its name.
///     robot: path of the robot's folder.
///     seed: determines the machine's deviations and noise.
#[pyclass(frozen, module = "tesaki")]
pub struct Run {
    scenario: &'static Scenario,
    robot: RobotFolder,
    seed: u64,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    run: Option<Stepped>,
    /// Number of the next fingertip sample.
    sample: u16,
    summary: Option<String>,
}

#[pymethods]
impl Run {
    #[new]
    fn new(scenario: &str, robot: PathBuf, seed: i128) -> PyResult<Self> {
        let seed = u64::try_from(seed)
            .map_err(|_| PyValueError::new_err(format!("seed {seed}: it must be from 0 to {}", u64::MAX)))?;
        let scenario = Scenario::find(scenario).ok_or_else(|| {
            let known: Vec<&str> = SCENARIOS.iter().map(|scenario| scenario.name).collect();
            PyValueError::new_err(format!(
                "no scenario {scenario:?}; the scenarios are: {}",
                known.join(", ")
            ))
        })?;
        let robot = RobotFolder::load(&robot).map_err(file)?;
        Ok(Self { scenario, robot, seed, state: Mutex::default() })
    }

    /// Begins the scenario, or begins it again; returns its first state.
    fn begin<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDict>>> {
        self.turn(py, |state| {
            *state = State::default();
            let run = Stepped::begin(self.scenario, &self.robot.path, self.seed);
            let run = run.map_err(|error| error.to_string())?;
            let halt = run.wait();
            state.run = Some(run);
            Ok(halt)
        })
    }

    /// Advances by one control period; returns the state after it.
    ///
    /// Args:
    ///     kind: the command in place of the scenario's own, see ``tesaki.COMMANDS``; ``nothing`` sends no
    ///         command, ``None`` keeps the scenario's own.
    ///     values: the command's numbers.
    ///
    /// Raises:
    ///     SimulationError: why the scenario did not come to its end.
    #[pyo3(signature = (kind=None, values=None))]
    fn step<'py>(
        &self,
        py: Python<'py>,
        kind: Option<&str>,
        values: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Option<Bound<'py, PyDict>>> {
        let turn = match kind {
            None => Turn::Scripted,
            Some("nothing") => Turn::Nothing,
            Some(kind) => {
                let none = PyList::empty(py).into_any();
                let sample = self.with_state(py, |state| {
                    state.sample = state.sample.wrapping_add(1);
                    state.sample
                });
                let model = Some(&self.robot.model);
                Turn::Command(decode(kind, "action", values.unwrap_or(&none), sample, model)?)
            }
        };
        self.turn(py, |state| {
            let run =
                state.run.as_ref().ok_or_else(|| "the scenario has not begun, or has ended".to_owned())?;
            Ok(run.step(turn))
        })
    }

    /// Runs to the end with the scenario's own commands; begins the scenario if necessary.
    fn finish(&self, py: Python<'_>) -> PyResult<()> {
        if self.with_state(py, |state| state.run.is_none() && state.summary.is_none()) {
            self.begin(py)?;
        }
        while self.with_state(py, |state| state.run.is_some()) {
            self.turn(py, |state| {
                let run = state.run.as_ref().ok_or_else(|| "the scenario has ended".to_owned())?;
                let mut halt = run.step(Turn::Scripted);
                for _ in 1..STRETCH {
                    if matches!(halt, Halt::Ended(_)) {
                        break;
                    }
                    halt = run.step(Turn::Scripted);
                }
                Ok(halt)
            })?;
            // Ctrl-C.
            py.check_signals()?;
        }
        Ok(())
    }

    /// Returns what was measured, as JSON: the summary of ``cargo sim run --json``, and the tables as CSV;
    /// ``None`` before the end.
    fn summary(&self, py: Python<'_>) -> Option<String> {
        self.with_state(py, |state| state.summary.clone())
    }
}

impl Run {
    /// Uses the state while other Python threads run: who waits for it with the interpreter's lock would keep
    /// the one that has it from going on.
    fn with_state<T: Send>(&self, py: Python<'_>, run: impl FnOnce(&mut State) -> T + Send) -> T {
        py.detach(|| run(&mut self.state.lock().unwrap_or_else(PoisonError::into_inner)))
    }

    /// Lets the scenario run while other Python threads do too, and returns its new state.
    fn turn<'py>(
        &self,
        py: Python<'py>,
        go: impl FnOnce(&mut State) -> Result<Halt, String> + Send,
    ) -> PyResult<Option<Bound<'py, PyDict>>> {
        let view = self.with_state(py, |state| match go(state)? {
            Halt::At(view) => Ok(Some(view)),
            Halt::Ended(ended) => {
                state.run = None;
                let outcome = ended.map_err(|error| error.to_string())?;
                let told = serde_json::json!({ "summary": outcome.summary, "tables": outcome.tables });
                state.summary = Some(told.to_string());
                Ok(None)
            }
        });
        view.map_err(SimulationError::new_err::<String>)?
            .map(|view| shown(py, &view, &self.robot))
            .transpose()
    }
}

/// Returns a state as a dictionary.
fn shown<'py>(py: Python<'py>, view: &View, robot: &RobotFolder) -> PyResult<Bound<'py, PyDict>> {
    let state = PyDict::new(py);
    state.set_item("trial", view.trial)?;
    state.set_item("is_over", view.is_over)?;
    state.set_item("tick", view.telemetry.tick)?;
    state.set_item("task", view.task.to_string())?;
    let joints = &view.telemetry.joints;
    let one = |value: &dyn Fn(usize) -> f32| PyArray1::from_iter(py, (0..joints.len()).map(value));
    state.set_item("position", one(&|joint| joints[joint].position))?;
    state.set_item("velocity", one(&|joint| joints[joint].velocity))?;
    state.set_item("reference", one(&|joint| joints[joint].reference))?;
    state.set_item("torque", one(&|joint| joints[joint].torque))?;
    let tips = &view.tips.tips;
    let three = |value: &(dyn Fn(usize) -> [f32; 3] + Sync)| {
        output(py, [tips.len(), 3], |places| {
            places
                .chunks_exact_mut(3)
                .enumerate()
                .for_each(|(tip, place)| place.copy_from_slice(&value(tip)));
        })
    };
    state.set_item("tip_position", three(&|tip| tips[tip].position)?)?;
    state.set_item("tip_force", three(&|tip| tips[tip].force)?)?;
    state.set_item("tip_torque", three(&|tip| tips[tip].torque)?)?;
    let report = view.report.as_ref().map(|report| dictionary(py, &report.telemetry)).transpose()?;
    state.set_item("report", report)?;
    state.set_item("truth", view.truth.as_ref().map(|truth| true_state(py, truth)).transpose()?)?;
    let refused = view.refused.as_ref();
    let refused = refused.map(|refusal| named(refusal, &refusal.to_string(), Some(&robot.model)));
    state.set_item("refused", refused)?;
    state.set_item("fault", view.fault.as_ref().map(|fault| fault.named(&robot.model).to_string()))?;
    match view.scripted.as_ref().and_then(encode) {
        Some((kind, values, shape)) => {
            state.set_item("scripted", (kind, PyArray1::from_vec(py, values).reshape(shape)?))?;
        }
        None => state.set_item("scripted", py.None())?,
    }
    Ok(state)
}

/// Returns the true state of the plant as a dictionary of arrays.
fn true_state<'py>(py: Python<'py>, truth: &MachineTruth) -> PyResult<Bound<'py, PyDict>> {
    let state = PyDict::new(py);
    let list = |values: &[f64]| PyArray1::from_slice(py, values);
    state.set_item("position", list(&truth.joints.positions))?;
    state.set_item("velocity", list(&truth.joints.velocities))?;
    state.set_item("torque", list(&truth.joints.torques))?;
    let tips: Vec<f64> = truth.tips.iter().flat_map(|tip| tip.position).collect();
    state.set_item("tip_position", PyArray1::from_vec(py, tips).reshape([truth.tips.len(), 3])?)?;
    let forces: Vec<f64> = truth.tips.iter().flat_map(|tip| tip.force).collect();
    state.set_item("tip_force", PyArray1::from_vec(py, forces).reshape([truth.tips.len(), 3])?)?;
    if let Some(object) = &truth.object {
        state.set_item("object_position", list(&object.position))?;
        state.set_item("object_orientation", list(&object.orientation))?;
        let forces: Vec<f64> = truth.contacts.iter().flat_map(|contact| contact.force).collect();
        state
            .set_item("contact_force", PyArray1::from_vec(py, forces).reshape([truth.contacts.len(), 3])?)?;
    }
    Ok(state)
}
