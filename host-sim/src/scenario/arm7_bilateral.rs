//! Bilateral teleoperation: the contact force of the arm is reflected to the operator over a delayed link.
//! Measures the settling time of the handle and the energy that the link generates.

use rapier3d::na::Vector3;
use tesaki::kinematics::{ElbowSetpoint, PosePoint};
use tesaki::task::impedance::ImpedanceSettings;
use tesaki::teleop::{PowerPort, PowerPortLimits};
use tesaki_description::law::arm::{StrokeTable, WallTable};
use tesaki_supervisor::trajectory::minimum_jerk;

use super::arm::{ArmRig, ArmSample, ArmTrial, Machine, impedance, pose, settings};
use super::common::{T, grouped, largest, unsettled};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::operator::{Link, LinkValues, MasterArm, MasterArmValues, OperatorHandMotion, Stroke};
use crate::plant::Wall;
use crate::report::{Column, Figure, Line, Metric, Panel, Summary, csv};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "arm7-bilateral",
    title: "Bilateral teleoperation against walls",
    about: "an operator presses the arm against walls of 200 to 50 000 N/m with force feedback, at delays of \
            0, 20 and 50 ms",
    robot: "arm7",
    kind: Kind::SevenJointArm,
    files: &[],
    results: "docs/measurements.md#walls-felt-from-afar",
    duration: 62.0,
    shortest: None,
    laws: None,
    lead: &[
        "An operator moves the handle of a master arm forward by 5 cm within 0.8 s and intends to stay \
         there. The seven-joint arm follows and meets a wall of 200, 2000 or 50 000 N/m after 2 cm. The \
         spring force of its impedance, K = 300 N/m, is reflected to the handle. The operator's arm is \
         compliant: 1.5 kg, 15 N·s/m, 300 N/m. The link delays each direction by 0, 20 or 50 ms. The arm \
         differs from the controller's model by up to 20 %.",
        "Time-domain passivity control: each port of the link counts the energy that enters and leaves there, \
         and limits its output to the energy that has entered at the other port, by damping at the handle \
         and by holding back the arm's set-point. While a force is reflected, the handle is damped as much \
         as the link's delay needs. In contact the arm's set-point has no velocity, so that only the spring \
         pulls the arm, whose energy is counted. Each port has a reserve of 20 mJ. A deficit beyond it is \
         the energy of the first contact, which neither port could know of in time. The ports count with \
         the spring's force; the metrics use the true forces and displacements of handle and wall. The \
         handle has settled when it stays within 2 mm of its final position. The last run is without \
         passivity control.",
    ],
    run,
};

/// The stroke of the operator.
const STROKE: StrokeTable = StrokeTable { shift: 0.05, turn: 0.0, time: 0.8, stay: 4.0 };
/// Start of the stroke [s].
pub(super) const BEGIN: f64 = 0.5;
/// Distance of the walls from the start [m].
const CLEARANCE: f64 = 0.02;
/// Stiffness of the arm's impedance [N/m].
const STIFFNESS: f32 = 300.0;
/// Stiffness of the walls [N/m].
const WALLS: [f64; 3] = [200.0, 2000.0, 50_000.0];
/// Delay of the link in each direction [s].
const DELAYS: [f64; 3] = [0.0, 0.02, 0.05];
/// Damping of the walls [N·s/m].
const DAMPING: f64 = 20.0;
/// Limit of the energy that the wall receives beyond the operator's input: the reserves of both ports, the
/// arm's kinetic energy, and the deficit of a first contact [mJ].
const MAX_ENERGY_GENERATED: f64 = 100.0;
/// The handle has settled when it stays within this distance of its final position [m].
const SETTLING_BAND: f64 = 0.002;
/// Without a reserve, the energy deficit of the first contact could hold back the arm's set-point for good.
/// The damping at the handle stays below 150 N·s/m, the stability limit for a hand of 1.5 kg and a zero-order
/// hold of 10 ms.
const LIMITS: PowerPortLimits = match PowerPortLimits::try_new(100.0, 0.02) {
    Ok(limits) => limits,
    Err(_) => panic!("within their ranges"),
};

/// State of master and link at the end of a control period.
#[derive(Clone, Copy)]
pub(super) struct LinkSample {
    /// Displacement of the handle along x from the start [m].
    pub handle: f64,
    /// Mean force on the handle along x in this period [N].
    pub force: f64,
    /// Energy in the link [J].
    pub energy: f64,
}

#[derive(Clone)]
pub(super) struct Run {
    wall: f64,
    pub stroke: StrokeTable,
    pub delay: f64,
    passivity_control: bool,
    pub ticks: Vec<LinkSample>,
    /// The arm at the same times.
    pub samples: Vec<ArmSample>,
}

impl Run {
    /// Nothing recorded yet, without passivity control.
    pub const fn new(stroke: StrokeTable, wall: f64, delay: f64) -> Self {
        Self { wall, stroke, delay, passivity_control: false, ticks: Vec::new(), samples: Vec::new() }
    }

    /// Time from the end of the stroke until the handle stays near its final position [s].
    pub fn settling_time(&self) -> f64 {
        let last = self.ticks.len().saturating_sub(20);
        let rest = self.ticks[last..].iter().map(|tick| tick.handle).sum::<f64>() / 20.0;
        let unsettled = unsettled(self.ticks.iter().map(|tick| tick.handle), rest, SETTLING_BAND);
        unsettled.map_or(f64::NAN, |ticks| (ticks as f64 * T - BEGIN - self.stroke.time).max(0.0))
    }

    /// Minimum of the energy in the link [J].
    fn min_energy(&self) -> f64 {
        -largest(self.ticks.iter().map(|tick| -tick.energy))
    }

    /// Largest energy that the wall has received beyond the operator's input, from the true forces and
    /// displacements [J].
    pub fn energy_generated(&self) -> f64 {
        let handle = self.ticks.windows(2).map(|pair| -pair[1].force * (pair[1].handle - pair[0].handle));
        let wall = self.samples.windows(2).map(|pair| {
            let displacement = pair[1].tool.position[0] - pair[0].tool.position[0];
            -pair[1].tool.wall_force[0] * displacement
        });
        let mut balance = 0.0;
        let balances = handle.zip(wall).map(|(input, output)| {
            balance += output - input;
            balance
        });
        largest([0.0].into_iter().chain(balances))
    }

    /// Times of ticks and samples [s].
    pub fn times(&self) -> Vec<f64> {
        (1..=self.ticks.len()).map(|tick| tick as f64 * T).collect()
    }

    fn name(&self) -> String {
        let control = if self.passivity_control { "" } else { "_without_passivity_control" };
        format!("wall_{}_delay_{}{control}", self.wall, (1e3 * self.delay).round())
    }

    fn label(&self) -> String {
        let control = if self.passivity_control { "" } else { ", no passivity control" };
        format!("{} N/m, {} ms{control}", grouped(self.wall), (1e3 * self.delay).round())
    }

    pub fn table(&self) -> String {
        let series = |value: &dyn Fn(&LinkSample) -> f64| self.ticks.iter().map(value).collect::<Vec<f64>>();
        let time = self.times();
        let tool: Vec<f64> = self.samples.iter().map(|sample| sample.tool.position[0]).collect();
        let wall: Vec<f64> = self.samples.iter().map(|sample| -sample.tool.wall_force[0]).collect();
        csv(&[
            Column::new("time", "s", &time),
            Column::new("handle x", "m", series(&|tick| tick.handle)),
            Column::new("force on handle x", "N", series(&|tick| tick.force)),
            Column::new("energy in the link", "J", series(&|tick| tick.energy)),
            Column::new("tool x", "m", &tool),
            Column::new("force into wall", "N", &wall),
        ])
    }
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = ArmRig::load(setting)?;
    let mut summary = Summary::default();
    let mut runs = Vec::new();
    let heavy = ImpedanceSettings { impedance: impedance(3.5, 60.0, STIFFNESS), ..settings(60.0) };
    for delay in DELAYS {
        for wall in WALLS {
            runs.push(press_wall(setting, &mut rig, heavy, (STROKE, surface(wall)), delay, true)?);
        }
    }
    runs.push(press_wall(setting, &mut rig, heavy, (STROKE, surface(WALLS[1])), DELAYS[2], false)?);
    for run in &runs {
        add_metrics(&mut summary, run);
    }
    let tables = runs.iter().map(|run| (format!("{}.csv", run.name()), run.table())).collect();
    let figures = vec![handle(&runs), wall_force(&runs), handle_force(&runs), energy(&runs)];
    Ok(Outcome { summary, figures, tables, motion: rig.motion })
}

/// Message to the arm: position of the handle [m], and energy that has entered at the master port [µJ].
type ForwardMessage = (Vector3<f64>, i64);
/// Message to the master: force on the handle [N], and energy that has entered at the slave port [µJ].
type BackwardMessage = (Vector3<f32>, i64);

/// A wall of a stiffness [N/m].
const fn surface(stiffness: f64) -> WallTable {
    WallTable { clearance: CLEARANCE, stiffness, damping: DAMPING }
}

/// The wall in front of a tool that is at `start`.
pub(super) fn wall_before(start: &Vector3<f64>, wall: &WallTable) -> Wall {
    Wall {
        point: [start.x + wall.clearance, 0.0, 0.0],
        normal: [-1.0, 0.0, 0.0],
        stiffness: wall.stiffness,
        damping: wall.damping,
        friction: 0.0,
    }
}

pub(super) fn press_wall(
    setting: &mut Setting<'_, '_>,
    rig: &mut ArmRig,
    settings: ImpedanceSettings,
    (stroke, wall): (StrokeTable, WallTable),
    delay: f64,
    passivity_control: bool,
) -> Result<Run, ScenarioError> {
    let seed = setting.seed;
    let mut recorded = Run { passivity_control, ..Run::new(stroke, wall.stiffness, delay) };
    let [stiffness, ..] = settings.impedance.stiffness;
    let mut arm_trial = ArmTrial::begin(setting, rig, &recorded.label(), Machine::Mismatched, settings)?;
    let (point, elbow) = arm_trial.start();
    let middle = pose(&point);
    let start = middle.translation.vector;
    arm_trial.plant.insert_wall(wall_before(&start, &wall))?;

    let motion = Stroke {
        begin: BEGIN,
        duration: stroke.time,
        shift: Vector3::new(stroke.shift, 0.0, 0.0),
        turn: Vector3::zeros(),
    };
    let motion = OperatorHandMotion::strokes(middle, vec![motion]);
    let mut master = MasterArm::new(MasterArmValues::default(), &middle, seed);
    let link = LinkValues { delay, ..LinkValues::default() };
    let mut forward = Link::<ForwardMessage>::new(link, seed);
    let mut backward = Link::<BackwardMessage>::new(link, seed.wrapping_add(1000));
    let mut ends = Ends::new(start, elbow, point, (stiffness, delay), passivity_control);
    let mut force = 0.0;
    for tick in 1..=((BEGIN + stroke.time + stroke.stay) / T).round() as usize {
        let time = tick as f64 * T;
        let measured = master.run(&motion, time).last().map(|(_, pose)| Vector3::from(pose.position));
        ends.update_handle(measured);
        forward.send(time, (ends.handle, ends.master.energy_in()));
        for packet in forward.receive(time) {
            (ends.target, ends.master_energy) = packet.message;
        }
        let arm = arm_trial.telemetry()?;
        let (setpoint, reflected) = ends.limit_setpoint(&arm.error, arm.contact);
        arm_trial.follow(setpoint, ends.elbow)?;
        backward.send(time, (reflected, ends.slave.energy_in()));
        for packet in backward.receive(time) {
            (ends.force, ends.slave_energy) = packet.message;
        }
        let handle_force = ends.handle_force();
        master.reflect(handle_force.map(f64::from).into());
        recorded.ticks.push(LinkSample {
            handle: master.handle(&motion).pose.translation.vector.x - start.x,
            force: std::mem::replace(&mut force, handle_force.x.into()),
            energy: 1e-6 * (ends.master.balance() + ends.slave.balance()) as f64,
        });
    }
    recorded.samples = arm_trial.end_without_start()?;
    Ok(recorded)
}

/// Both ends of the link, with their energy ports.
struct Ends {
    master: PowerPort,
    slave: PowerPort,
    limits: PowerPortLimits,
    passivity_control: bool,
    elbow: ElbowSetpoint,
    point: PosePoint,
    /// Of the arm's impedance [N/m].
    stiffness: f32,
    /// Position [m] and velocity [m/s] of the handle.
    handle: Vector3<f64>,
    velocity: Vector3<f32>,
    /// Reflected force on the handle, and the damping force that passivity control adds [N].
    force: Vector3<f32>,
    damping: Vector3<f32>,
    /// Energy that has entered at the slave port, as last received [µJ].
    slave_energy: i64,
    /// Received position of the handle, and set-point of the arm [m].
    target: Vector3<f64>,
    reference: Vector3<f64>,
    /// Last displacement of the set-point [m], and force of the link on the arm [N].
    displacement: Vector3<f32>,
    push: Vector3<f32>,
    /// Energy that has entered at the master port, as last received [µJ].
    master_energy: i64,
}

impl Ends {
    fn new(
        start: Vector3<f64>,
        elbow: ElbowSetpoint,
        point: PosePoint,
        (stiffness, delay): (f32, f64),
        passivity_control: bool,
    ) -> Self {
        let zero = Vector3::zeros();
        // What the operator's arm damps by itself is not known.
        let limits = LIMITS.calm(0.0, stiffness, 2.0 * delay as f32);
        Self {
            limits,
            master: PowerPort::new(),
            slave: PowerPort::new(),
            passivity_control,
            elbow,
            point,
            stiffness,
            handle: start,
            velocity: zero,
            force: zero,
            damping: zero,
            slave_energy: 0,
            target: start,
            reference: start,
            displacement: zero,
            push: zero,
            master_energy: 0,
        }
    }

    /// Takes a new measurement of the handle.
    fn update_handle(&mut self, measured: Option<Vector3<f64>>) {
        let Some(measured) = measured else { return };
        let displacement = (measured - self.handle).map(|part| part as f32);
        self.master.account(&self.force, &self.damping, &displacement);
        (self.handle, self.velocity) = (measured, displacement / T as f32);
    }

    /// The arm's set-point, limited by the passivity controller, and the force that is reflected.
    fn limit_setpoint(&mut self, error: &[f32; 6], contact: bool) -> (PosePoint, Vector3<f32>) {
        let stiffness = self.stiffness;
        let [x, y, z, ..] = *error;
        // In contact the link acts on the arm through the spring of its impedance.
        let push = if contact { Vector3::new(x, y, z) * -stiffness } else { Vector3::zeros() };
        self.slave.account(&((push + self.push) * 0.5), &Vector3::zeros(), &self.displacement);
        let desired = (self.target - self.reference).map(|part| part as f32);
        let push_after = if contact { push + desired * stiffness } else { Vector3::zeros() };
        let displacement = if self.passivity_control {
            self.slave.limit_displacement(&self.limits, self.master_energy, &push_after, &desired)
        } else {
            desired
        };
        (self.displacement, self.push) = (displacement, push);
        self.reference += displacement.map(f64::from);
        let mut setpoint = self.point;
        setpoint.position = self.reference.map(|part| part as f32).into();
        // In contact the damper of the impedance brakes the arm. Towards a moving set-point it would also
        // pull the arm, with energy that the port does not count.
        if !(contact && self.passivity_control) {
            let velocity = displacement / T as f32;
            setpoint.velocity = [velocity.x, velocity.y, velocity.z, 0.0, 0.0, 0.0];
        }
        (setpoint, -push)
    }

    /// Force on the handle, damping included [N].
    fn handle_force(&mut self) -> Vector3<f32> {
        self.damping = if self.passivity_control {
            self.master.damping_force(&self.limits, self.slave_energy, &self.force, &self.velocity)
        } else {
            Vector3::zeros()
        };
        self.force + self.damping
    }
}

fn add_metrics(summary: &mut Summary, run: &Run) {
    let (name, label) = (run.name(), run.label());
    let text = format!("{label}: settling time of the handle");
    let settling_time = run.settling_time();
    let metric = if run.passivity_control {
        Metric::at_most(text, settling_time, 2.0, "s")
    } else {
        Metric::reported(text, settling_time, "s")
    };
    summary.insert(format!("{name}_settling_time"), metric);
    let text = format!("{label}: largest energy the wall received beyond the operator's input");
    let generated = 1e3 * run.energy_generated();
    let metric = if run.passivity_control {
        Metric::at_most(text, generated, MAX_ENERGY_GENERATED, "mJ")
    } else {
        Metric::reported(text, generated, "mJ")
    };
    summary.insert(format!("{name}_energy_generated"), metric);
    let text = format!("{label}: largest energy deficit of the link, as its ports count");
    summary.insert(format!("{name}_energy_deficit"), Metric::reported(text, -1e3 * run.min_energy(), "mJ"));
    let peak = largest(run.samples.iter().map(|sample| -sample.tool.wall_force[0]));
    summary
        .insert(format!("{name}_force_peak"), Metric::reported(format!("{label}: largest force"), peak, "N"));
}

/// A value of a run at a tick.
type Value = fn(&Run, usize) -> f64;

fn handle(runs: &[Run]) -> Figure {
    let caption = "Position of the handle, and the position that the operator intends (dashed). One panel \
                   for each delay; the last one is without passivity control.";
    let value: Value = |run, index| 1e3 * run.ticks[index].handle;
    let mut figure = by_delay(timeline("Position of the handle", caption), ("position", "mm"), runs, value);
    let time: Vec<f64> =
        (0..((BEGIN + STROKE.time + STROKE.stay) / T).round() as usize).map(|tick| tick as f64 * T).collect();
    let intended: Vec<f64> =
        time.iter().map(|time| 1e3 * STROKE.shift * minimum_jerk((time - BEGIN) / STROKE.time)[0]).collect();
    for panel in &mut figure.panels {
        panel.lines.push(Line::dashed("operator's intention", Line::INK, time.clone(), intended.clone()));
    }
    figure
}

fn wall_force(runs: &[Run]) -> Figure {
    let caption = "True force on the wall. Dashed: the force of the springs of operator, impedance and wall \
                   in series. One panel for each wall; the last one is without passivity control.";
    by_wall(timeline("Force on the wall", caption), runs, |run, index| {
        run.samples.get(index).map_or(f64::NAN, |sample| -sample.tool.wall_force[0])
    })
}

fn handle_force(runs: &[Run]) -> Figure {
    let caption = "Force on the operator at the handle, damping included. Dashed: the force of the springs \
                   of operator, impedance and wall in series.";
    by_wall(timeline("Force at the handle", caption), runs, |run, index| -run.ticks[index].force)
}

fn energy(runs: &[Run]) -> Figure {
    let caption = "Energy that has entered the link minus the energy that has left it, as its ports count. \
                   Below zero the link has generated energy.";
    let value: Value = |run, index| 1e3 * run.ticks[index].energy;
    by_delay(timeline("Energy in the link", caption), ("energy", "mJ"), runs, value)
}

fn timeline(title: &str, caption: &str) -> Figure {
    let [end, last] = [BEGIN + STROKE.time, BEGIN + STROKE.time + STROKE.stay];
    Figure::stacked(title, caption, "time", "s").phase(BEGIN, end, "operator moves").phase(
        end,
        last,
        "operator stays",
    )
}

fn line(run: &Run, name: String, colour: usize, value: Value) -> Line {
    Line::solid(name, colour, run.times(), (0..run.ticks.len()).map(|index| value(run, index)).collect())
}

/// A panel for each delay, and one without passivity control; a colour for each wall.
fn by_delay(mut figure: Figure, (quantity, unit): (&str, &str), runs: &[Run], value: Value) -> Figure {
    for (delay, passivity_control) in
        DELAYS.into_iter().map(|delay| (delay, true)).chain([(DELAYS[2], false)])
    {
        let what = if passivity_control { "" } else { ", no passivity control" };
        let mut panel = Panel::new(format!("Delay {} ms{what}", (1e3 * delay).round()), quantity, unit);
        for (colour, wall) in WALLS.into_iter().enumerate() {
            if let Some(run) = find(runs, wall, delay, passivity_control) {
                panel = panel.line(line(run, format!("{} N/m", grouped(wall)), colour, value));
            }
        }
        figure = figure.panel(panel);
    }
    figure
}

/// A panel for each wall, and one without passivity control; a colour for each delay.
fn by_wall(mut figure: Figure, runs: &[Run], value: Value) -> Figure {
    for (wall, passivity_control) in WALLS.into_iter().map(|wall| (wall, true)).chain([(WALLS[1], false)]) {
        let what = if passivity_control { "" } else { ", no passivity control" };
        let mut panel = Panel::new(format!("Wall {} N/m{what}", grouped(wall)), "force", "N");
        for (colour, delay) in DELAYS.into_iter().enumerate() {
            if let Some(run) = find(runs, wall, delay, passivity_control) {
                panel = panel.line(line(run, format!("{} ms", (1e3 * delay).round()), colour, value));
            }
        }
        let compliance =
            1.0 / MasterArmValues::default().impedance.stiffness + 1.0 / f64::from(STIFFNESS) + 1.0 / wall;
        let force = vec![(STROKE.shift - CLEARANCE) / compliance; 2];
        let end = BEGIN + STROKE.time;
        let time = vec![end, end + STROKE.stay];
        figure = figure.panel(panel.line(Line::dashed("springs in series", Line::INK, time, force)));
    }
    figure
}

fn find(runs: &[Run], wall: f64, delay: f64, passivity_control: bool) -> Option<&Run> {
    let same = |a: f64, b: f64| a.total_cmp(&b).is_eq();
    runs.iter().find(|run| {
        same(run.wall, wall) && same(run.delay, delay) && run.passivity_control == passivity_control
    })
}
