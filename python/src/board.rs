//! A board over its link.

mod arguments;
mod conversation;

use std::path::PathBuf;
use std::time::{Duration, Instant};

use numpy::PyArray1;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use pyo3::types::PyDict;
use tesaki::model::RobotModel;
use tesaki::protocol::{FromBoard, Mode, Refusal, Request, Stream};
use tesaki::task::TaskCommand;
use tesaki::task::grasping::GraspCommand;
use tesaki::task::impedance::ImpedanceCommand;
use tesaki_description::{grasp, impedance};
use tesaki_recording::{McapError, Recording};
use tesaki_supervisor::arrival::{Arrival, farthest_joint};
use tesaki_supervisor::faults::FaultsBefore;
use tesaki_supervisor::port::{Address, Key, Reopening};
use tesaki_supervisor::publication::{Publication, require_own};
use tesaki_supervisor::words::{NOT_TAKEN_OVER, still_on};
use tesaki_supervisor::{Board as _, BoardError as Failure, LinkBoard};

use crate::arrays::output;
use crate::command::decode;
use crate::error::{BoardError, FaultError, FileError, RefusedError, board, board_of, file};
use crate::robot::Robot;
use crate::value::dictionary;
use arguments::seconds;
use conversation::await_event;

/// A controller board, real or served by ``cargo sim serve``.
///
/// Takes command of the board. As a context manager it disables an enabled board and releases command at the
/// end, also after an exception. It leaves a board in fault as it is: its outputs may hold the robot, which
/// ``disable()`` ends. A board that could not be disabled is an error, or a note of the exception under way.
///
/// An enabled board must hear from its commander: ``move``, ``wait`` and ``record`` ensure that while they
/// run, ``telemetry`` and ``tips`` while they wait for an answer. Nothing does so in between, on purpose: if
/// this program hangs or is killed, the board's command timeout (``safety.command_timeout``) stops the robot.
///
/// It must not be used by two threads at once.
///
/// Args:
///     port: ``auto``, a serial port, ``unix:///PATH`` or ``tcp://HOST:PORT``.
///     timeout: how long to wait for an answer [s].
///     take_over: replace another commander, unless the board is enabled.
///     key: file with the key of an encrypted TCP port.
///
/// Raises:
///     BoardError: no board, no answer, or another version of the protocol.
///     RefusedError: another program commands the board.
#[pyclass(module = "tesaki")]
pub struct Board {
    board: LinkBoard<Reopening>,
    model: Option<RobotModel>,
    is_open: bool,
    is_enabled: bool,
    /// Its faults before it was enabled.
    faults: FaultsBefore,
    /// Where `move` has led the joints [rad]; empty if something else was commanded since, or nothing.
    goals: Vec<f32>,
    /// Number of the last fingertip sample.
    sample: u16,
    timeout: Duration,
}

/// Disables an enabled board, however the program ends, if it can be reached. A board in fault stays as it
/// is.
impl Drop for Board {
    fn drop(&mut self) {
        if let Err(error) = self.leave() {
            let error = BoardError::new_err(still_on(error));
            Python::try_attach(|py| error.write_unraisable(py, None));
        }
    }
}

#[pymethods]
impl Board {
    #[new]
    #[pyo3(signature = (port="auto", *, timeout=1.0, take_over=false, key=None))]
    fn new(
        py: Python<'_>,
        port: &str,
        timeout: f64,
        take_over: bool,
        key: Option<PathBuf>,
    ) -> PyResult<Self> {
        let address: Address =
            port.parse().map_err(|error| PyValueError::new_err(format!("port: {error}")))?;
        let timeout = seconds("timeout", timeout)?;
        let key = key.map(|path| {
            Key::read(&path).map_err(|error| FileError::new_err(format!("{}: {error}", path.display())))
        });
        let key = key.transpose()?;
        py.detach(|| {
            let link =
                Reopening::open(address, key).map_err(|error| BoardError::new_err(error.to_string()))?;
            let mut link = LinkBoard::new(link, timeout);
            link.hello().map_err(board)?;
            link.await_command(take_over).map_err(|error| match error {
                Failure::Refused { refusal: Refusal::Commanded { .. }, .. } if take_over => {
                    RefusedError::new_err(NOT_TAKEN_OVER)
                }
                error => board(error),
            })?;
            let model = match link.model() {
                Ok(model) => Some(model),
                Err(Failure::Refused { refusal: Refusal::NoModel, .. }) => None,
                Err(error) => return Err(board(error)),
            };
            let (is_open, is_enabled, faults, sample) = (true, false, FaultsBefore::default(), 0);
            let goals = Vec::new();
            Ok(Self { board: link, model, is_open, is_enabled, faults, goals, sample, timeout })
        })
    }

    fn __enter__(slf: Py<Self>) -> Py<Self> {
        slf
    }

    #[pyo3(signature = (kind=None, error=None, trace=None))]
    fn __exit__(
        &mut self,
        py: Python<'_>,
        kind: Option<&Bound<'_, PyAny>>,
        error: Option<&Bound<'_, PyAny>>,
        trace: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<bool> {
        let _ = (kind, trace);
        if let Err(failure) = py.detach(|| self.leave()) {
            let text = still_on(failure);
            // An earlier exception says more, but not this.
            match error {
                None => return Err(BoardError::new_err(text)),
                // From Python 3.11 on.
                Some(error) if error.hasattr("add_note")? => {
                    error.call_method1("add_note", (text,))?;
                }
                Some(_) => py.import("warnings")?.call_method1("warn", (text,)).map(drop)?,
            }
        }
        Ok(false)
    }

    /// Disables the board and releases command. The board cannot be used afterwards.
    fn close(&mut self, py: Python<'_>) -> PyResult<()> {
        py.detach(|| self.leave()).map_err(|error| BoardError::new_err(still_on(error)))
    }

    /// Returns the board's status as a dictionary: ``node`` with mode, model, faults, supply [V], and
    /// ``board``.
    fn status<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let status = self.call(py, |link| link.status())?;
        dictionary(py, &status)
    }

    /// Names of the joints of the model on the board; empty without one.
    #[getter]
    fn joints(&self) -> Vec<String> {
        let joints = self.model.iter().flat_map(|model| &model.joints);
        joints.map(|joint| joint.name.to_string()).collect()
    }

    /// Name of the model on the board; ``None`` without one.
    #[getter]
    fn robot(&self) -> Option<String> {
        self.model.as_ref().map(|model| model.name.to_string())
    }

    /// Sends a robot's model and waits until the sensors have been read with it.
    ///
    /// Args:
    ///     robot: the robot whose model is sent, or the path of its folder.
    ///
    /// Raises:
    ///     FileError: all errors in the folder, by file and line.
    fn push(&mut self, py: Python<'_>, robot: &Bound<'_, PyAny>) -> PyResult<()> {
        let model = arguments::model(robot)?;
        self.call(py, |link| match link.push_model_and_sense(&model) {
            // It needs this, and has forgotten its commander.
            Err(Failure::Reset) => link.take_command(false).and_then(|()| link.push_model_and_sense(&model)),
            other => other,
        })?;
        self.model = Some(model);
        self.goals.clear();
        Ok(())
    }

    /// Tells the board where the joints are now, for relative encoders.
    ///
    /// Args:
    ///     angles: present angle of every joint by name [rad].
    fn home(&mut self, py: Python<'_>, angles: &Bound<'_, PyDict>) -> PyResult<()> {
        let names = self.joints();
        let mut positions = vec![f32::NAN; names.len()];
        self.named(angles, &mut positions)?;
        if let Some((name, _)) = names.iter().zip(&positions).find(|(_, angle)| angle.is_nan()) {
            return Err(PyValueError::new_err(format!(
                "angles: {name} is missing; all joints are homed at once"
            )));
        }
        self.call(py, |link| link.home(&positions))
    }

    /// Zeroes the force sensors; nothing may touch the tips.
    fn tare(&mut self, py: Python<'_>) -> PyResult<()> {
        self.call(py, |link| link.tare())
    }

    /// Starts a task and switches the outputs on.
    ///
    /// Args:
    ///     task: ``joints`` (joint servo), ``impedance``, ``grasping`` or ``telexistence``.
    ///     servo: of the joint servo: ``observer``, ``pid`` or ``bare-pid``.
    ///     file: needed by ``impedance``, an impedance file (``robots/arm7/impedances/soft.toml``; for six
    ///         joints ``docs/examples/soft_six_joints.toml``), and by ``telexistence``, the robot's folder.
    ///
    /// Raises:
    ///     RefusedError: the board is not ready; the message says what is missing.
    #[pyo3(signature = (task="joints", *, servo="observer", file=None))]
    fn enable(&mut self, py: Python<'_>, task: &str, servo: &str, file: Option<PathBuf>) -> PyResult<()> {
        let config = self.config(task, servo, file)?;
        self.faults = FaultsBefore::from(&self.call(py, |link| link.status())?.node);
        self.call(py, |link| {
            // Earlier messages belong to the time before.
            link.set_rate(Stream::Telemetry, 1)?;
            while link.next_event(Instant::now())?.is_some() {}
            Ok(())
        })?;
        // If the answer is lost, the board may be enabled: it is disabled in the end.
        self.goals.clear();
        let before = std::mem::replace(&mut self.is_enabled, true);
        let refused = self.call(py, |link| match link.enable(config) {
            Err(error @ (Failure::Refused { .. } | Failure::Reset)) => Ok(Some(error)),
            other => other.map(|()| None),
        })?;
        refused.map_or(Ok(()), |refusal| {
            self.is_enabled = before;
            Err(board_of(self.model.as_ref(), refusal))
        })
    }

    /// Ends the task and switches the outputs off. A robot under gravity falls unless it is supported.
    fn disable(&mut self, py: Python<'_>) -> PyResult<()> {
        self.call(py, |link| link.disable())?;
        self.is_enabled = false;
        Ok(())
    }

    /// Moves joints and waits until all have arrived; the joint servo must be enabled.
    ///
    /// Args:
    ///     goals: goal of each joint to be moved, by name [rad]; the others stay.
    ///     within: how long it may take [s]; 20 if not given.
    ///     tolerance: error at which a joint has arrived [rad]; 0.005 if not given.
    ///     relative: whether goals are relative to the present angles.
    ///
    /// Returns:
    ///     the largest remaining error [rad].
    ///
    /// Raises:
    ///     FaultError: the board stopped; the message says why.
    ///     BoardError: it took too long.
    #[pyo3(name = "move", signature = (goals, *, within=20.0, tolerance=0.005, relative=false))]
    fn move_joints(
        &mut self,
        py: Python<'_>,
        goals: &Bound<'_, PyDict>,
        within: f64,
        tolerance: f32,
        relative: bool,
    ) -> PyResult<f32> {
        let within = seconds("within", within)?;
        if !(tolerance > 0.0 && tolerance.is_finite()) {
            return Err(PyValueError::new_err(format!(
                "tolerance is {tolerance}: expected a positive angle in rad"
            )));
        }
        let names = self.joints();
        let limits = self.model.iter().flat_map(|model| &model.joints).map(|joint| joint.limits);
        let limits: Vec<(f32, f32)> = limits.map(|limits| (limits.lower, limits.upper)).collect();
        let now = self.telemetry_now(py)?;
        let here = |joint: usize| now.joints.get(joint).map_or(f32::NAN, |joint| joint.position);
        // The others keep their goals, or else their references: their angles may be a tolerance away.
        let stays = |(joint, (lower, upper)): (usize, &(f32, f32))| {
            let reference = || now.joints.get(joint).map_or(f32::NAN, |joint| joint.reference);
            self.goals.get(joint).copied().unwrap_or_else(|| reference().clamp(*lower, *upper))
        };
        let mut goal: Vec<f32> = limits.iter().enumerate().map(stays).collect();
        let mut asked = vec![f32::NAN; names.len()];
        self.named(goals, &mut asked)?;
        for (joint, asked) in asked.into_iter().enumerate().filter(|(_, asked)| !asked.is_nan()) {
            let (place, (lower, upper)) = (goal.get_mut(joint), limits[joint]);
            let Some(place) = place else { continue };
            *place = if relative { here(joint) + asked } else { asked };
            if !(lower..=upper).contains(place) {
                return Err(PyValueError::new_err(format!(
                    "{}: {place} rad is outside its limits {lower} to {upper} rad",
                    names[joint]
                )));
            }
        }
        let positions =
            heapless::Vec::from_slice(&goal).map_err(|_| board(Failure::TooManyJoints(goal.len())))?;
        let command = tesaki::task::joint_servo::JointCommand::Goal { positions };
        let command = Request::Task(TaskCommand::JointServo(command));
        self.goals.clone_from(&goal);
        let (mut arrival, mut farthest) = (Arrival::default(), (0, f32::INFINITY));
        let until = Instant::now() + within;
        self.drive(py, until, &command, |event| {
            let FromBoard::Telemetry(telemetry) = event else { return false };
            farthest = farthest_joint(telemetry, &goal);
            arrival.update(farthest.1, tolerance);
            arrival.has_come()
        })?;
        let (joint, error) = farthest;
        if !arrival.has_come() {
            let name = names.get(joint).map_or("", String::as_str);
            return Err(BoardError::new_err(format!(
                "{name} is still {error:.4} rad from its target after {} s (tolerance {tolerance} rad). Is the joint \
                 blocked, or within too short?",
                within.as_secs_f64()
            )));
        }
        Ok(error)
    }

    /// Sends one command to the running task, and returns at once.
    ///
    /// Args:
    ///     kind: what is commanded; see ``tesaki.COMMANDS`` for the kinds and the shapes of their values.
    ///     values: the numbers of the command.
    ///
    /// Raises:
    ///     RefusedError: the task refuses it; the previous command remains.
    #[pyo3(signature = (kind, values=None))]
    fn command(&mut self, py: Python<'_>, kind: &str, values: Option<&Bound<'_, PyAny>>) -> PyResult<()> {
        self.sample = self.sample.wrapping_add(1);
        let none = pyo3::types::PyList::empty(py).into_any();
        let command = decode(kind, "values", values.unwrap_or(&none), self.sample, self.model.as_ref())?;
        self.send(py, command)
    }

    /// Sends the next point of the trajectory of each fingertip; one per tick (10 ms).
    ///
    /// Args:
    ///     tips: (tips, 9) position [m], velocity [m/s] and acceleration [m/s²] of each tip.
    fn reach(&mut self, py: Python<'_>, tips: &Bound<'_, PyAny>) -> PyResult<()> {
        let command = decode("tips", "tips", tips, 0, self.model.as_ref())?;
        self.send(py, command)
    }

    /// Sends the next point of the trajectory of each joint, without the trajectory filter; one per tick (10
    /// ms).
    ///
    /// Args:
    ///     points: (joints, 3) angle [rad], velocity [rad/s] and acceleration [rad/s²] of each joint.
    fn stream(&mut self, py: Python<'_>, points: &Bound<'_, PyAny>) -> PyResult<()> {
        let command = decode("points", "points", points, 0, self.model.as_ref())?;
        self.send(py, command)
    }

    /// Grasps as specified by a grasp file; ``task()`` returns the phase. The task ``grasping`` must be
    /// enabled.
    ///
    /// Args:
    ///     file: grasp file, for example ``robots/hand3/grasps/box.toml``.
    fn grasp(&mut self, py: Python<'_>, file: PathBuf) -> PyResult<()> {
        let plan = grasp::load(&file).map_err(crate::error::file)?;
        self.send(py, TaskCommand::Grasping(GraspCommand::Grasp(plan)))
    }

    /// Changes the impedance of the enabled task ``impedance``.
    ///
    /// Args:
    ///     file: impedance file.
    fn configure_impedance(&mut self, py: Python<'_>, file: PathBuf) -> PyResult<()> {
        let settings = impedance::load(&file, self.known_model()?).map_err(crate::error::file)?;
        self.send(py, TaskCommand::Impedance(ImpedanceCommand::Configure(settings)))
    }

    /// Moves a hand to a person's fingertips. The task ``telexistence`` must be enabled.
    ///
    /// Args:
    ///     fingertips: (5, 6) position [m] and velocity [m/s] of each fingertip, thumb to little finger, in
    ///         the frame of the robot's hand; NaN where unknown.
    fn retarget(&mut self, py: Python<'_>, fingertips: &Bound<'_, PyAny>) -> PyResult<()> {
        self.sample = self.sample.wrapping_add(1);
        let command = decode("fingertips", "fingertips", fingertips, self.sample, self.model.as_ref())?;
        self.send(py, command)
    }

    /// Tells an enabled board that its commander is alive: needed at least every half command timeout if
    /// nothing else is sent.
    fn keep(&mut self, py: Python<'_>) -> PyResult<()> {
        self.call(py, |link| link.keep())
    }

    /// Waits, and keeps an enabled board alive meanwhile.
    ///
    /// Args:
    ///     duration: [s].
    ///
    /// Raises:
    ///     FaultError: the board stopped; the message says why.
    fn wait(&mut self, py: Python<'_>, duration: f64) -> PyResult<()> {
        let until = Instant::now() + seconds("duration", duration)?;
        self.drive(py, until, &Request::Keep, |_| false)
    }

    /// Returns the state of the joints: a dictionary with ``tick``, ``mode`` and the arrays ``position``
    /// [rad], ``velocity`` [rad/s], ``reference`` [rad] and ``torque`` [N·m], each (joints,).
    fn telemetry<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let telemetry = self.telemetry_now(py)?;
        let found = PyDict::new(py);
        found.set_item("tick", telemetry.tick)?;
        found.set_item("mode", telemetry.mode.to_string())?;
        let joints = &telemetry.joints;
        found.set_item("position", PyArray1::from_iter(py, joints.iter().map(|joint| joint.position)))?;
        found.set_item("velocity", PyArray1::from_iter(py, joints.iter().map(|joint| joint.velocity)))?;
        found.set_item("reference", PyArray1::from_iter(py, joints.iter().map(|joint| joint.reference)))?;
        found.set_item("torque", PyArray1::from_iter(py, joints.iter().map(|joint| joint.torque)))?;
        Ok(found)
    }

    /// Returns the state of the tips: a dictionary of arrays ``position`` [m], ``force`` [N] and ``torque``
    /// [N·m], each (tips, 3), and ``tared`` (tips,): where it is ``False``, force and torque contain the
    /// unknown zero of the sensor, or there is none; see ``tare()``.
    fn tips<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (timeout, keeps) = (self.timeout, self.is_enabled);
        let tips = self.call(py, |link| {
            link.set_rate(Stream::Tips, 1)?;
            // What came before is old.
            while link.next_event(Instant::now())?.is_some() {}
            let found = await_event(link, timeout, keeps, |event| match event {
                FromBoard::Tips(tips) => Some(tips),
                _ => None,
            });
            link.set_rate(Stream::Tips, 0)?;
            found
        })?;
        let tips = tips.ok_or_else(|| self.no_readings("telemetry of the tips"))?;
        let found = PyDict::new(py);
        let rows = |value: &(dyn Fn(usize) -> [f32; 3] + Sync)| {
            output(py, [tips.tips.len(), 3], |places| {
                places
                    .chunks_exact_mut(3)
                    .enumerate()
                    .for_each(|(tip, row)| row.copy_from_slice(&value(tip)));
            })
        };
        found.set_item("position", rows(&|tip| tips.tips[tip].position)?)?;
        found.set_item("force", rows(&|tip| tips.tips[tip].force)?)?;
        found.set_item("torque", rows(&|tip| tips.tips[tip].torque)?)?;
        found.set_item("tared", PyArray1::from_iter(py, tips.tips.iter().map(|tip| tip.tared)))?;
        Ok(found)
    }

    /// Returns the telemetry of the running task, or of the last one, as a dictionary.
    fn task<'py>(&mut self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let report = self.call(py, |link| link.read_task())?;
        dictionary(py, &report.telemetry)
    }

    /// Returns the faults since power-on in words, the oldest first. They then count as read.
    fn faults(&mut self, py: Python<'_>) -> PyResult<Vec<String>> {
        let log = self.call(py, |link| link.faults())?;
        Ok(log.faults.iter().map(|fault| self.described(fault)).collect())
    }

    /// Reads the faults and leaves the fault mode. A robot that was held loses its power. A board without a
    /// fault stays as it is.
    fn clear_faults(&mut self, py: Python<'_>) -> PyResult<Vec<String>> {
        let (log, mode) = self.call(py, |link| {
            let log = link.faults()?;
            link.ask("clear its faults", Request::ClearFaults { total: log.total })?;
            Ok((log, link.status()?.node.mode))
        })?;
        // A board without a fault stays enabled.
        self.is_enabled &= matches!(mode, Mode::Enabled(_));
        Ok(log.faults.iter().map(|fault| self.described(fault)).collect())
    }

    /// Records what the board sends, as MCAP for ROS 2; keeps an enabled board alive meanwhile.
    ///
    /// The recording contains, like that of ``tesaki record``: joints, references and links in each tick, the
    /// wrench on each tip with a tared sensor, the frame that the task controls and its set-point, phases and
    /// modes in words, and ``/diagnostics`` with the numbers of the task. It is complete even if a fault ends
    /// it.
    ///
    /// Args:
    ///     path: the file to write.
    ///     duration: [s].
    ///     robot: its URDF and names of links are put into the recording.
    ///     force: replace a file that exists.
    ///
    /// Returns:
    ///     the number of recorded ticks; ``tesaki.recordings.load`` reads them.
    ///
    /// Raises:
    ///     FileError: the file exists, or cannot be written.
    ///     ValueError: ``robot`` is not the board's robot.
    #[pyo3(signature = (path, duration, robot=None, *, force=false))]
    fn record(
        &mut self,
        py: Python<'_>,
        path: PathBuf,
        duration: f64,
        robot: Option<&Robot>,
        force: bool,
    ) -> PyResult<u32> {
        let wrong = |error: McapError| FileError::new_err(format!("{}: {error}", path.display()));
        let duration = seconds("duration", duration)?;
        let folder = robot.map(|robot| robot.folder.clone());
        if let Some(model) = &self.model {
            require_own(folder.as_ref(), model).map_err(|other| {
                PyValueError::new_err(format!(
                    "robot is {}, and the board's is {}: its URDF and the board's angles do not belong together",
                    other.folder, other.board
                ))
            })?;
        }
        let urdf = folder.as_ref().map(|folder| std::fs::read_to_string(folder.path.join("robot.urdf")));
        let urdf = urdf.transpose().map_err(file)?;
        if !force && path.exists() {
            return Err(FileError::new_err(format!(
                "{} exists: name another recording, or replace it with force=True",
                path.display()
            )));
        }
        // A board that does not answer costs no earlier recording.
        self.stream_recorded(py, true)?;
        let recording = match Recording::create(&path, urdf.as_deref()) {
            Ok(recording) => recording,
            Err(error) => {
                self.stream_recorded(py, false)?;
                return Err(wrong(error));
            }
        };
        let mut publication = Publication::new(recording, folder);
        // Nobody else pushes a model meanwhile, so any checksum will do.
        publication.use_model(self.model.as_ref().map(|model| (model, 0)));
        let (mut count, mut failed, mut last) = (0, None, None);
        let request = if self.is_enabled { Request::Keep } else { Request::ReadStatus };
        let until = Instant::now() + duration;
        let driven = self.drive(py, until, &request, |event| {
            let written = match event {
                FromBoard::Telemetry(telemetry) if last.replace(telemetry.tick) == Some(telemetry.tick) => {
                    Ok(())
                }
                FromBoard::Telemetry(telemetry) => {
                    count += 1;
                    publication.telemetry(telemetry)
                }
                FromBoard::Tips(tips) => publication.tips(tips),
                FromBoard::Task(task) => publication.task(task),
                FromBoard::Status(status) => publication.status(status),
                FromBoard::Reply(_) | FromBoard::Log(_) => Ok(()),
            };
            failed = written.err();
            failed.is_some()
        });
        let stopped = self.stream_recorded(py, false);
        if let Err(error) = &driven
            && error.is_instance_of::<FaultError>(py)
        {
            publication.fault(last.unwrap_or_default(), &error.value(py).to_string()).map_err(wrong)?;
        }
        publication.publisher.finish().map_err(wrong)?;
        failed.map_or(Ok(()), |error| Err(wrong(error)))?;
        driven.and(stopped)?;
        Ok(count)
    }

    fn __repr__(&self) -> String {
        let robot = self.model.as_ref().map_or("no model", |model| model.name.as_str());
        format!("Board({robot:?}, {} joints)", self.joints().len())
    }
}
