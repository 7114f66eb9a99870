//! Contact of the impedance-controlled tool with walls from soft to stiff. Measures the settling time and the
//! force at rest.

use tesaki::task::impedance::{ForceSource, ImpedanceSettings};

use super::arm::{ArmLog, ArmRig, ArmTrial, Machine, impedance, motion, settings, shift};
use super::common::{T, grouped, unsettled};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::plant::Wall;
use crate::report::{Figure, Line, Metric, Panel, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "arm7-wall",
    title: "Contact of the arm with stiff and soft walls",
    about: "the set-point moves 3 cm into walls of 200 to 50 000 N/m and back, with and without a force \
            sensor",
    robot: "arm7",
    kind: Kind::SevenJointArm,
    files: &[],
    results: "docs/measurements.md#an-arm-under-impedance-control",
    duration: 36.0,
    shortest: None,
    laws: None,
    lead: &[
        "The set-point of the seven-joint arm's tool moves forward by 5 cm within half a second; a wall \
         stands in the way after 2 cm. The set-point stays for 2.5 seconds and returns. The impedance is M = \
         3.5 kg, the arm's own effective mass along this axis, B = 60 N·s/m and K = 300 N/m. The stiffness \
         of the wall is 200, 2000, 10 000 or 50 000 N/m, with little damping. The machine differs from the \
         controller's model by up to 20 %.",
        "At rest the contact force should be that of two springs in series, the impedance's and the wall's. \
         It has settled once it stays within 1 N of its final value. Two of the walls are then met without \
         the force sensor: the external force is then estimated from the motor torques. The estimate \
         cannot tell a contact from unmodelled friction and weight, so only an estimate above 6 N counts as \
         a contact, and the tool yields to what exceeds this.",
    ],
    run,
};

/// Distance of the wall from the start, and displacement of the set-point [m].
const CLEARANCE: f64 = 0.02;
const DISPLACEMENT: f64 = 0.05;
/// Time of each motion of the set-point, and time that it stays [s].
const TIME: f64 = 0.5;
const STAY: f64 = 2.5;
/// Stiffness of the arm's impedance [N/m].
const STIFFNESS: f64 = 300.0;
/// Stiffness of the walls [N/m].
const WALLS: [f64; 4] = [200.0, 2000.0, 10_000.0, 50_000.0];
/// Damping of the walls [N·s/m].
const DAMPING: f64 = 20.0;
/// The force has settled when it stays within this distance of its value at rest [N].
const SETTLING_BAND: f64 = 1.0;

/// Stiffness of the walls that are met without a force sensor [N/m].
const OBSERVED_WALLS: [f64; 2] = [2000.0, 10_000.0];
/// Bandwidth of the estimate of the external force [rad/s].
const OBSERVER_BANDWIDTH: f32 = 30.0;
/// Contact threshold of the observer [N]: above what unmodelled friction and weight make it estimate in free
/// motion.
const OBSERVER_THRESHOLD: f32 = 6.0;
/// Limit of the estimation error at rest [N].
const MAX_ESTIMATION_ERROR: f64 = 5.0;

/// The contact with one wall.
struct Contact {
    stiffness: f64,
    force: ForceSource,
    log: ArmLog,
    /// The controller's estimate of the contact force at rest [N].
    estimated: f64,
    /// When the set-point had arrived, when it began to return, and the end of the trial [s].
    arrived: f64,
    left: f64,
    end: f64,
}

impl Contact {
    const fn is_observed(&self) -> bool {
        matches!(self.force, ForceSource::Observer { .. })
    }

    fn name(&self) -> String {
        format!("{}_{}", if self.is_observed() { "observed" } else { "wall" }, self.stiffness)
    }

    fn label(&self) -> String {
        format!(
            "{} N/m{}",
            grouped(self.stiffness),
            if self.is_observed() { ", without a force sensor" } else { "" }
        )
    }

    /// Force into the wall [N].
    fn force(sample: &super::arm::ArmSample) -> f64 {
        -sample.tool.wall_force[0]
    }

    /// Force of the springs of impedance and wall in series, of which the first yields beyond what counts as
    /// a contact [N]. Homing errors of the joints shift the set-point and are not included.
    fn expected(&self) -> f64 {
        let threshold = if self.is_observed() { OBSERVER_THRESHOLD.into() } else { 0.0 };
        let force = (DISPLACEMENT - CLEARANCE) * STIFFNESS + threshold;
        force * self.stiffness / (STIFFNESS + self.stiffness)
    }

    /// The mean force in the last 0.2 s of rest [N].
    fn rest(&self) -> f64 {
        let samples = self.log.during(&(self.left - 0.2..self.left));
        samples.iter().map(Self::force).sum::<f64>() / samples.len() as f64
    }

    /// Time from the arrival of the set-point until the force stays near its value at rest [s]; NaN where
    /// that is less than half of the springs' force: there is no contact.
    fn settling_time(&self) -> f64 {
        let rest = self.rest();
        if rest < 0.5 * self.expected() {
            return f64::NAN;
        }
        let samples = self.log.during(&(0.0..self.left));
        match unsettled(samples.iter().map(Self::force), rest, SETTLING_BAND) {
            None => f64::NAN,
            Some(0) => 0.0,
            Some(number) => (samples[number - 1].time + T - self.arrived).max(0.0),
        }
    }

    fn peak(&self) -> f64 {
        self.log.largest(&(0.0..self.left), Self::force)
    }
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = ArmRig::load(setting)?;
    let mut summary = Summary::default();
    let (mut contacts, mut tables) = (Vec::new(), Vec::new());
    let sensed = WALLS.map(|stiffness| (stiffness, ForceSource::Sensor));
    let observed =
        OBSERVED_WALLS.map(|stiffness| (stiffness, ForceSource::Observer { bandwidth: OBSERVER_BANDWIDTH }));
    for (stiffness, force) in sensed.into_iter().chain(observed) {
        let contact = press_wall(setting, &mut rig, stiffness, force)?;
        tables.push((format!("{}.csv", contact.name()), contact.log.table()));
        contacts.push(contact);
    }
    for contact in &contacts {
        add_metrics(&mut summary, contact);
    }
    Ok(Outcome {
        summary,
        figures: vec![forces(&contacts), positions(&contacts)],
        tables,
        motion: rig.motion,
    })
}

fn press_wall(
    setting: &mut Setting<'_, '_>,
    rig: &mut ArmRig,
    stiffness: f64,
    force: ForceSource,
) -> Result<Contact, ScenarioError> {
    let mut contact = Contact {
        stiffness,
        force,
        log: ArmLog::default(),
        estimated: f64::NAN,
        arrived: 0.0,
        left: 0.0,
        end: 0.0,
    };
    let mut heavy =
        ImpedanceSettings { impedance: impedance(3.5, 60.0, STIFFNESS as f32), force, ..settings(60.0) };
    if contact.is_observed() {
        heavy.contact_force = OBSERVER_THRESHOLD;
    }
    let mut arm_trial = ArmTrial::begin(setting, rig, &contact.label(), Machine::Mismatched, heavy)?;
    let (point, elbow) = arm_trial.start();
    let surface = f64::from(point.position[0]) + CLEARANCE;
    let wall = Wall {
        point: [surface, 0.0, 0.0],
        normal: [-1.0, 0.0, 0.0],
        stiffness,
        damping: DAMPING,
        friction: 0.0,
    };
    arm_trial.plant.insert_wall(wall)?;
    arm_trial.wait(0.5)?;
    let move_setpoint = |arm_trial: &mut ArmTrial<'_, '_>, ends: [f64; 2]| {
        arm_trial.follow_path(TIME, |time| {
            let mut setpoint = point;
            shift(&mut setpoint, 0, motion(ends, time, TIME));
            (setpoint, elbow)
        })
    };
    move_setpoint(&mut arm_trial, [0.0, DISPLACEMENT])?;
    contact.arrived = arm_trial.log.now();
    arm_trial.wait(STAY)?;
    contact.left = arm_trial.log.now();
    contact.estimated = -f64::from(arm_trial.telemetry()?.wrench[0]);
    move_setpoint(&mut arm_trial, [DISPLACEMENT, 0.0])?;
    arm_trial.wait(1.0)?;
    contact.end = arm_trial.log.now();
    contact.log = arm_trial.end()?;
    Ok(contact)
}

fn add_metrics(summary: &mut Summary, contact: &Contact) {
    let name = |what: &str| format!("{}_{what}", contact.name());
    let label = contact.label();
    let text = format!("{label}: settling time of the force");
    let settling_time = contact.settling_time();
    if contact.is_observed() {
        summary.insert(name("settling_time"), Metric::reported(text, settling_time, "s"));
        let text = format!("{label}: estimated minus true force at rest");
        summary.insert(
            name("estimation_error"),
            Metric::within(text, contact.estimated - contact.rest(), MAX_ESTIMATION_ERROR, "N"),
        );
    } else {
        summary.insert(name("settling_time"), Metric::at_most(text, settling_time, 2.0, "s"));
    }
    let error = contact.rest() - contact.expected();
    let text =
        format!("{label}: force at rest minus {:.2} N, that of the springs in series", contact.expected());
    summary.insert(name("force_error_at_rest"), Metric::reported(text, error, "N"));
    summary
        .insert(name("force_peak"), Metric::reported(format!("{label}: largest force"), contact.peak(), "N"));
    let back = contact.log.during(&(contact.end - 0.1..contact.end));
    let error = back.last().map_or(f64::NAN, |sample| (sample.position() - sample.target).norm());
    let text = format!("{label}: position error after the return");
    summary.insert(name("error_after_return"), Metric::reported(text, 1e3 * error, "mm"));
}

/// A figure with the phases of the set-point, which are the same for all walls.
fn timeline(title: &str, caption: &str, contacts: &[Contact]) -> Figure {
    let figure = Figure::stacked(title, caption, "time", "s");
    let Some(contact) = contacts.first() else { return figure };
    figure
        .phase(contact.arrived - TIME, contact.arrived, "set-point forward")
        .phase(contact.arrived, contact.left, "at rest")
        .phase(contact.left, contact.left + TIME, "set-point back")
}

fn forces(contacts: &[Contact]) -> Figure {
    let caption = "True contact force, averaged over each control period. Dashed: the force of the two \
                   springs in series. Circles: begin and end of the contact.";
    let mut figure = timeline("Contact force", caption, contacts);
    for contact in contacts {
        let samples = contact.log.during(&(0.0..contact.end));
        let time: Vec<f64> = samples.iter().map(|sample| sample.time).collect();
        let force = samples.iter().map(Contact::force).collect();
        let expected = vec![contact.expected(); 2];
        let mut panel = Panel::new(contact.label(), "force", "N")
            .line(Line::solid("contact force", 0, time, force))
            .line(Line::dashed(
                "springs in series",
                Line::INK,
                vec![contact.arrived, contact.left],
                expected,
            ));
        let touches = |sample: &&super::arm::ArmSample| Contact::force(sample) > 0.0;
        for end in [samples.iter().find(touches), samples.iter().rev().find(touches)].into_iter().flatten() {
            panel = panel.mark(end.time, 0.0, "");
        }
        figure = figure.panel(panel);
    }
    figure
}

fn positions(contacts: &[Contact]) -> Figure {
    let caption = "Position of the tool normal to the wall, from its start, and the set-point (dashed).";
    let mut figure = timeline("Tool position", caption, contacts);
    for contact in contacts {
        let samples = contact.log.during(&(0.0..contact.end));
        let start = samples.first().map_or(f64::NAN, |sample| sample.target.x);
        let time: Vec<f64> = samples.iter().map(|sample| sample.time).collect();
        let position = samples.iter().map(|sample| 1e3 * (sample.position().x - start)).collect();
        let setpoint = samples.iter().map(|sample| 1e3 * (sample.target.x - start)).collect();
        let panel = Panel::new(contact.label(), "position", "mm")
            .rule(1e3 * CLEARANCE, "wall")
            .line(Line::solid("tool", 0, time.clone(), position))
            .line(Line::dashed("set-point", Line::INK, time, setpoint));
        figure = figure.panel(panel);
    }
    figure
}
