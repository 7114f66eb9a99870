//! An operator feels what the arm touches, through a link with a delay: does it come to rest, and does the
//! link make energy?

use rapier3d::na::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};
use tesaki::kinematics::{ElbowSetpoint, PosePoint};
use tesaki::task::impedance::ImpedanceSettings;
use tesaki::teleop::{PowerPort, PowerPortLimits};
use tesaki_supervisor::trajectory::minimum_jerk;

use super::arm::{ArmRig, ArmSample, ArmTrial, Machine, impedance, settings};
use super::common::grouped;
use super::grasping::{T, require_duration};
use super::{Outcome, Scenario, ScenarioError, Setting};
use crate::operator::{Link, LinkValues, MasterArm, MasterArmValues, OperatorHandMotion, Stroke};
use crate::plant::Wall;
use crate::report::{Column, Figure, Line, Metric, Panel, Summary, csv};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "arm7-bilateral",
    title: "Bilateral teleoperation against walls",
    about: "an operator presses the arm against walls of 200 to 50 000 N/m with force feedback, at delays of \
            0, 20 and 50 ms",
    robot: "arm7",
    duration: 62.0,
    lead: &[
        "An operator moves the handle of a master arm forward by 5 cm within 0.8 s and intends to stay \
         there. The seven-joint arm follows and meets a wall of 200, 2000 or 50 000 N/m after 2 cm. The \
         spring force of its impedance, K = 300 N/m, is reflected to the handle. The operator's arm is \
         compliant: 1.5 kg, 15 N·s/m, 300 N/m. The link delays each direction by 0, 20 or 50 ms. The arm \
         differs from the controller's model by up to 20 %.",
        "Time-domain passivity control: each end counts the energy that enters and leaves the link, and \
         limits what leaves to what has entered at the other end, by damping at the handle and by holding \
         back the arm's set-point. Either end may give 20 mJ in advance; what is owed beyond that is the \
         energy of the first contact, before either end could know of it. The ends count with the spring's \
         force; the metrics use the true forces and displacements of handle and wall. The handle has settled \
         when it stays within 2 mm of its final position. The last run is without passivity control.",
    ],
    run,
};

const CLEARANCE: f64 = 0.02;
const WAY: f64 = 0.05;
const BEGIN: f64 = 0.5;
const TIME: f64 = 0.8;
const STAY: f64 = 4.0;
const STIFFNESS: f64 = 300.0;
const WALLS: [f64; 3] = [200.0, 2000.0, 50_000.0];
const DELAYS: [f64; 3] = [0.0, 0.02, 0.05];
/// Of the wall [N·s/m].
const DAMPING: f64 = 20.0;
/// Most energy that the wall may get before the operator put it in: both reserves, that of the arm's own
/// motion, and what a first contact owes [mJ].
const MAX_ENERGY_MADE: f64 = 100.0;
/// The handle has settled within this [m].
const BAND: f64 = 0.002;
/// Without the reserve, what the first contact owes can keep the arm waiting.
/// The master's damping stays below what a hand of 1.5 kg with 10 ms of hold allows, 150 N·s/m.
const LIMITS: PowerPortLimits = PowerPortLimits { max_damping: 100.0, energy_reserve: 0.02 };

/// What was recorded in a tick, besides what the arm's log has.
#[derive(Clone, Copy)]
struct Tick {
    /// Of the handle along x, from the start [m].
    handle: f64,
    /// On the handle along x [N].
    force: f64,
    /// Energy in the link [J].
    energy: f64,
}

struct Run {
    wall: f64,
    delay: f64,
    guarded: bool,
    ticks: Vec<Tick>,
    samples: Vec<ArmSample>,
}

impl Run {
    /// How long after the stroke's end the handle was last off what it is at the end [s].
    fn settling_time(&self) -> f64 {
        let last = self.ticks.len().saturating_sub(20);
        let rest = self.ticks[last..].iter().map(|tick| tick.handle).sum::<f64>() / 20.0;
        let off = self.ticks.iter().rposition(|tick| (tick.handle - rest).abs() > BAND);
        off.map_or(0.0, |index| ((index + 1) as f64 * T - BEGIN - TIME).max(0.0))
    }

    /// Least energy that was in the link [J].
    fn min_energy(&self) -> f64 {
        self.ticks.iter().map(|tick| tick.energy).fold(f64::INFINITY, f64::min)
    }

    /// Most that the wall has got beyond what the operator had put in until then, by the true forces and ways
    /// [J].
    fn recorded(&self) -> f64 {
        let handle = self.ticks.windows(2).map(|pair| -pair[0].force * (pair[1].handle - pair[0].handle));
        let wall = self.samples.windows(2).map(|pair| {
            let way = pair[1].tool.position[0] - pair[0].tool.position[0];
            -pair[1].tool.wall_force[0] * way
        });
        let mut balance = 0.0;
        let balances = handle.zip(wall).map(|(given, got)| {
            balance += got - given;
            balance
        });
        balances.fold(0.0, f64::max)
    }

    fn name(&self) -> String {
        let guard = if self.guarded { "" } else { "_unguarded" };
        format!("wall_{}_delay_{}{guard}", self.wall, (1e3 * self.delay).round())
    }

    fn label(&self) -> String {
        let guard = if self.guarded { "" } else { ", no passivity control" };
        format!("{} N/m, {} ms{guard}", grouped(self.wall), (1e3 * self.delay).round())
    }

    fn table(&self) -> String {
        let series = |value: &dyn Fn(&Tick) -> f64| self.ticks.iter().map(value).collect::<Vec<f64>>();
        let time: Vec<f64> = (0..self.ticks.len()).map(|tick| tick as f64 * T).collect();
        let tool: Vec<f64> = self.samples.iter().map(|sample| sample.tool.position[0]).collect();
        let wall: Vec<f64> = self.samples.iter().map(|sample| -sample.tool.wall_force[0]).collect();
        csv(&[
            Column::new("time", "s", &time),
            Column::new("handle x", "m", &series(&|tick| tick.handle)),
            Column::new("force on handle x", "N", &series(&|tick| tick.force)),
            Column::new("energy in the link", "J", &series(&|tick| tick.energy)),
            Column::new("tool x", "m", &tool),
            Column::new("force into wall", "N", &wall),
        ])
    }
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    require_duration(&SCENARIO, setting)?;
    let mut rig = ArmRig::load(setting)?;
    let mut summary = Summary::new(SCENARIO.name, "", setting.seed);
    let mut runs = Vec::new();
    for delay in DELAYS {
        for wall in WALLS {
            runs.push(touch(setting, &mut rig, wall, delay, true)?);
        }
    }
    runs.push(touch(setting, &mut rig, WALLS[1], DELAYS[2], false)?);
    for run in &runs {
        add_metrics(&mut summary, run);
    }
    let tables = runs.iter().map(|run| (format!("{}.csv", run.name()), run.table())).collect();
    let figures = vec![handle(&runs), wall_force(&runs), handle_force(&runs), energy(&runs)];
    let summary = summary.ticks(u64::from(rig.motion.ticks()));
    Ok(Outcome { summary, figures, tables, motion: rig.motion })
}

/// What travels to the arm: where the handle is [m], and the energy that the operator has put in [µJ].
type Forth = (Vector3<f64>, i64);
/// What travels back: the force on the handle [N], and the energy that the arm has put in [µJ].
type Back = (Vector3<f32>, i64);

fn touch(
    setting: &mut Setting<'_, '_>,
    rig: &mut ArmRig,
    wall: f64,
    delay: f64,
    guarded: bool,
) -> Result<Run, ScenarioError> {
    let seed = setting.seed;
    let mut recorded = Run { wall, delay, guarded, ticks: Vec::new(), samples: Vec::new() };
    let heavy = ImpedanceSettings { impedance: impedance(3.5, 60.0, STIFFNESS as f32), ..settings(60.0) };
    let mut arm_trial = ArmTrial::begin(setting, rig, &recorded.label(), Machine::Mismatched, heavy)?;
    let (point, elbow) = arm_trial.start();
    let start = Vector3::from(point.position).map(f64::from);
    let place = [start.x + CLEARANCE, 0.0, 0.0];
    let surface =
        Wall { point: place, normal: [-1.0, 0.0, 0.0], stiffness: wall, damping: DAMPING, friction: 0.0 };
    arm_trial.plant.insert_wall(surface)?;

    let [x, y, z, w] = point.rotation.map(f64::from);
    let turn = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
    let middle = Isometry3::from_parts(Translation3::from(start), turn);
    let stroke =
        Stroke { begin: BEGIN, duration: TIME, shift: Vector3::new(WAY, 0.0, 0.0), turn: Vector3::zeros() };
    let motion = OperatorHandMotion::strokes(middle, vec![stroke]);
    let mut master = MasterArm::new(MasterArmValues::default(), &middle, seed);
    let link = LinkValues { delay, ..LinkValues::default() };
    let (mut forth, mut back) = (Link::<Forth>::new(link, seed), Link::<Back>::new(link, seed + 1000));
    let mut ends = Ends::new(start, elbow, point, guarded);
    for tick in 1..=((BEGIN + TIME + STAY) / T).round() as usize {
        let time = tick as f64 * T;
        let measured = master.run(&motion, time).last().map(|(_, pose)| Vector3::from(pose.position));
        ends.handle_moved(measured);
        forth.send(time, (ends.handle, ends.master.energy_in()));
        for packet in forth.receive(time) {
            (ends.target, ends.master_gave) = packet.message;
        }
        let arm = arm_trial.telemetry()?;
        let (at, pushed) = ends.lead(&arm.error, arm.contact);
        arm_trial.follow(at, ends.elbow)?;
        back.send(time, (pushed, ends.slave.energy_in()));
        for packet in back.receive(time) {
            (ends.force, ends.slave_gave) = packet.message;
        }
        let handle_force = ends.handle_force();
        master.reflect(handle_force.map(f64::from).into());
        recorded.ticks.push(Tick {
            handle: master.handle(&motion).pose.translation.vector.x - start.x,
            force: f64::from(handle_force.x),
            energy: 1e-6 * (ends.master.balance() + ends.slave.balance()) as f64,
        });
    }
    recorded.samples = arm_trial.end()?.0;
    Ok(recorded)
}

/// Both ends of the link.
struct Ends {
    master: PowerPort,
    slave: PowerPort,
    guarded: bool,
    elbow: ElbowSetpoint,
    point: PosePoint,
    /// Where the handle is, and its velocity.
    handle: Vector3<f64>,
    velocity: Vector3<f32>,
    /// On the handle: what came back, and the damping.
    force: Vector3<f32>,
    damping: Vector3<f32>,
    slave_gave: i64,
    /// Where the arm is to go, and where it was told to be.
    target: Vector3<f64>,
    reference: Vector3<f64>,
    /// The last way, and with what the link pushed the arm.
    way: Vector3<f32>,
    push: Vector3<f32>,
    master_gave: i64,
}

impl Ends {
    fn new(start: Vector3<f64>, elbow: ElbowSetpoint, point: PosePoint, guarded: bool) -> Self {
        let zero = Vector3::zeros();
        Self {
            master: PowerPort::new(),
            slave: PowerPort::new(),
            guarded,
            elbow,
            point,
            handle: start,
            velocity: zero,
            force: zero,
            damping: zero,
            slave_gave: 0,
            target: start,
            reference: start,
            way: zero,
            push: zero,
            master_gave: 0,
        }
    }

    /// The handle was measured again.
    fn handle_moved(&mut self, measured: Option<Vector3<f64>>) {
        let Some(measured) = measured else { return };
        let way = (measured - self.handle).map(|way| way as f32);
        self.master.account(&self.force, &self.damping, &way);
        (self.handle, self.velocity) = (measured, way / T as f32);
    }

    /// Where the arm is to be now, and the force that goes back.
    fn lead(&mut self, error: &[f32; 6], contact: bool) -> (PosePoint, Vector3<f32>) {
        let stiffness = STIFFNESS as f32;
        let [x, y, z, ..] = *error;
        // The link pulls the arm by the spring of its impedance, once that is pressed.
        let push = if contact { Vector3::new(x, y, z) * -stiffness } else { Vector3::zeros() };
        self.slave.account(&((push + self.push) * 0.5), &Vector3::zeros(), &self.way);
        let way = (self.target - self.reference).map(|way| way as f32);
        let after = if contact { push + way * stiffness } else { Vector3::zeros() };
        let way = if self.guarded {
            self.slave.limit_displacement(&LIMITS, self.master_gave, &after, &way)
        } else {
            way
        };
        (self.way, self.push) = (way, push);
        self.reference += way.map(f64::from);
        let mut at = self.point;
        at.position = self.reference.map(|place| place as f32).into();
        let velocity = way / T as f32;
        at.velocity = [velocity.x, velocity.y, velocity.z, 0.0, 0.0, 0.0];
        (at, -push)
    }

    /// What the handle feels.
    fn handle_force(&mut self) -> Vector3<f32> {
        self.damping = if self.guarded {
            self.master.damping_force(&LIMITS, self.slave_gave, &self.force, &self.velocity)
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
    let metric = if run.guarded {
        Metric::at_most(text, settling_time, 2.0, "s")
    } else {
        Metric::reported(text, settling_time, "s")
    };
    summary.insert(format!("{name}_settled"), metric);
    let text = format!("{label}: largest energy the wall received beyond the operator's input");
    let recorded = 1e3 * run.recorded();
    let metric = if run.guarded {
        Metric::at_most(text, recorded, MAX_ENERGY_MADE, "mJ")
    } else {
        Metric::reported(text, recorded, "mJ")
    };
    summary.insert(format!("{name}_made"), metric);
    let text = format!("{label}: largest energy owed by the link, as its ends count");
    summary.insert(format!("{name}_owed"), Metric::reported(text, -1e3 * run.min_energy(), "mJ"));
    let peak = run.samples.iter().map(|sample| -sample.tool.wall_force[0]).fold(f64::NAN, f64::max);
    summary.insert(format!("{name}_peak"), Metric::reported(format!("{label}: largest force"), peak, "N"));
}

/// A value of a run at the tick numbered so.
type Value = fn(&Run, usize) -> f64;

fn handle(runs: &[Run]) -> Figure {
    let caption = "Position of the handle, and where the operator intends it to be (dashed). A panel for \
                   each delay; the last one is without passivity control.";
    let value: Value = |run, index| 1e3 * run.ticks[index].handle;
    let mut figure = by_delay(timeline("Position of the handle", caption), ("position", "mm"), runs, value);
    let time: Vec<f64> =
        (0..((BEGIN + TIME + STAY) / T).round() as usize).map(|tick| tick as f64 * T).collect();
    let intended: Vec<f64> =
        time.iter().map(|time| 1e3 * WAY * minimum_jerk((time - BEGIN) / TIME)[0]).collect();
    for panel in &mut figure.panels {
        panel.lines.push(Line::dashed("operator's intention", Line::INK, time.clone(), intended.clone()));
    }
    figure
}

fn wall_force(runs: &[Run]) -> Figure {
    let caption = "True force on the wall. Dashed: the force of the springs of operator, impedance and wall \
                   in series. A panel for each wall; the last one is without passivity control.";
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
    let caption = "Energy that has entered the link minus that which has left it, as its ends count. Below \
                   zero the link owes energy.";
    let value: Value = |run, index| 1e3 * run.ticks[index].energy;
    by_delay(timeline("Energy in the link", caption), ("energy", "mJ"), runs, value)
}

fn timeline(title: &str, caption: &str) -> Figure {
    Figure::stacked(title, caption, "time", "s").phase(BEGIN, BEGIN + TIME, "operator moves").phase(
        BEGIN + TIME,
        BEGIN + TIME + STAY,
        "operator stays",
    )
}

fn line(run: &Run, name: String, colour: usize, value: Value) -> Line {
    let time = (0..run.ticks.len()).map(|tick| tick as f64 * T).collect();
    Line::solid(name, colour, time, (0..run.ticks.len()).map(|index| value(run, index)).collect())
}

/// A panel for each delay, and one without passivity control; a colour for each wall.
fn by_delay(mut figure: Figure, (quantity, unit): (&str, &str), runs: &[Run], value: Value) -> Figure {
    for (delay, guarded) in DELAYS.into_iter().map(|delay| (delay, true)).chain([(DELAYS[2], false)]) {
        let what = if guarded { "" } else { ", no passivity control" };
        let mut panel = Panel::new(format!("Delay {} ms{what}", (1e3 * delay).round()), quantity, unit);
        for (colour, wall) in WALLS.into_iter().enumerate() {
            if let Some(run) = find(runs, wall, delay, guarded) {
                panel = panel.line(line(run, format!("{} N/m", grouped(wall)), colour, value));
            }
        }
        figure = figure.panel(panel);
    }
    figure
}

/// A panel for each wall, and one without passivity control; a colour for each delay.
fn by_wall(mut figure: Figure, runs: &[Run], value: Value) -> Figure {
    for (wall, guarded) in WALLS.into_iter().map(|wall| (wall, true)).chain([(WALLS[1], false)]) {
        let what = if guarded { "" } else { ", no passivity control" };
        let mut panel = Panel::new(format!("Wall {} N/m{what}", grouped(wall)), "force", "N");
        for (colour, delay) in DELAYS.into_iter().enumerate() {
            if let Some(run) = find(runs, wall, delay, guarded) {
                panel = panel.line(line(run, format!("{} ms", (1e3 * delay).round()), colour, value));
            }
        }
        let compliance = 1.0 / MasterArmValues::default().impedance.stiffness + 1.0 / STIFFNESS + 1.0 / wall;
        let force = vec![(WAY - CLEARANCE) / compliance; 2];
        let time = vec![BEGIN + TIME, BEGIN + TIME + STAY];
        figure = figure.panel(panel.line(Line::dashed("springs in series", Line::INK, time, force)));
    }
    figure
}

fn find(runs: &[Run], wall: f64, delay: f64, guarded: bool) -> Option<&Run> {
    let same = |a: f64, b: f64| a.total_cmp(&b).is_eq();
    runs.iter().find(|run| same(run.wall, wall) && same(run.delay, delay) && run.guarded == guarded)
}
