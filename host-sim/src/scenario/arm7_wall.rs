//! The tool is led into walls from soft to stiff: does it come to rest there, and press as its impedance
//! says?

use tesaki::kinematics::PosePoint;
use tesaki::task::impedance::{ForceSource, ImpedanceSettings};
use tesaki_supervisor::trajectory::minimum_jerk;

use super::arm::{ArmLog, ArmRig, ArmTrial, Machine, impedance, settings};
use super::common::grouped;
use super::grasping::{T, require_duration};
use super::{Outcome, Scenario, ScenarioError, Setting};
use crate::plant::Wall;
use crate::report::{Figure, Line, Metric, Panel, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "arm7-wall",
    title: "Contact of the arm with stiff and soft walls",
    about: "the set-point moves 3 cm into walls of 200 to 50 000 N/m and back, with and without a force \
            sensor",
    robot: "arm7",
    duration: 36.0,
    lead: &[
        "The set-point of the seven-joint arm's tool moves forward by 5 cm within half a second; a wall \
         stands in the way after 2 cm. The set-point stays for 2.5 seconds and returns. The impedance is M = \
         3.5 kg, the arm's own effective mass along this axis, B = 60 N·s/m and K = 300 N/m. The stiffness \
         of the wall is 200, 2000, 10 000 or 50 000 N/m, with little damping. The machine differs from the \
         controller's model by up to 20 %.",
        "At rest the contact force should be that of two springs in series, the impedance's and the wall's. \
         It has settled once it stays within 1 N of its final value. Two of the walls are then met without \
         the force sensor: a momentum observer estimates the external force from the motor torques. It \
         cannot tell a contact from unmodelled friction and weight, so only an estimate above 6 N counts as \
         a contact.",
    ],
    run,
};

/// The wall stands so far ahead, and the tool is led so far [m].
const CLEARANCE: f64 = 0.02;
const WAY: f64 = 0.05;
const TIME: f64 = 0.5;
const STAY: f64 = 2.5;
const STIFFNESS: f64 = 300.0;
const WALLS: [f64; 4] = [200.0, 2000.0, 10_000.0, 50_000.0];
/// Of the wall [N·s/m].
const DAMPING: f64 = 20.0;
/// A force this near to the last one counts as settled [N].
const BAND: f64 = 1.0;

/// The walls that are met without a force sensor [N/m], the bandwidth of the observer [rad/s] and what counts
/// as a contact then [N]: friction that the model does not know and weight that has moved must not.
const UNFELT: [f64; 2] = [2000.0, 10_000.0];
const BANDWIDTH: f32 = 30.0;
const DOUBT: f32 = 6.0;
/// What it may be wrong by at rest [N].
const MOST_DOUBT: f64 = 5.0;

/// One wall.
struct Contact {
    stiffness: f64,
    force: ForceSource,
    log: ArmLog,
    /// What the controller took the force for before the tool was led away [N].
    felt: f64,
    /// When the tool should have arrived, when it was led away again, and when that ended [s].
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

    /// What the springs in series say [N]. The place of the tool's end is known as well as the joints' angles
    /// are.
    fn expected(&self) -> f64 {
        (WAY - CLEARANCE) * STIFFNESS * self.stiffness / (STIFFNESS + self.stiffness)
    }

    /// The mean of the force in the last fifth of a second of rest [N].
    fn rest(&self) -> f64 {
        let samples = self.log.during(&(self.left - 0.2..self.left));
        samples.iter().map(Self::force).sum::<f64>() / samples.len() as f64
    }

    /// How long after its arrival the force was last off what it is at rest [s].
    fn settled(&self) -> f64 {
        let rest = self.rest();
        let samples = self.log.during(&(0.0..self.left));
        let off = samples.iter().rposition(|sample| (Self::force(sample) - rest).abs() > BAND);
        off.map_or(0.0, |index| (samples[index].time + T - self.arrived).max(0.0))
    }

    fn peak(&self) -> f64 {
        self.log.largest(&(0.0..self.left), Self::force)
    }
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    require_duration(&SCENARIO, setting)?;
    let mut rig = ArmRig::load(setting)?;
    let mut summary = Summary::new(SCENARIO.name, "", setting.seed);
    let (mut contacts, mut tables) = (Vec::new(), Vec::new());
    let sensed = WALLS.map(|stiffness| (stiffness, ForceSource::Sensor));
    let observed = UNFELT.map(|stiffness| (stiffness, ForceSource::Observer { bandwidth: BANDWIDTH }));
    for (stiffness, force) in sensed.into_iter().chain(observed) {
        let contact = meet(setting, &mut rig, stiffness, force)?;
        tables.push((format!("{}.csv", contact.name()), contact.log.table()));
        contacts.push(contact);
    }
    for contact in &contacts {
        add_metrics(&mut summary, contact);
    }
    let summary = summary.ticks(u64::from(rig.motion.ticks()));
    Ok(Outcome {
        summary,
        figures: vec![forces(&contacts), positions(&contacts)],
        tables,
        motion: rig.motion,
    })
}

fn meet(
    setting: &mut Setting<'_, '_>,
    rig: &mut ArmRig,
    stiffness: f64,
    force: ForceSource,
) -> Result<Contact, ScenarioError> {
    let mut contact = Contact {
        stiffness,
        force,
        log: ArmLog::default(),
        felt: f64::NAN,
        arrived: 0.0,
        left: 0.0,
        end: 0.0,
    };
    let mut heavy =
        ImpedanceSettings { impedance: impedance(3.5, 60.0, STIFFNESS as f32), force, ..settings(60.0) };
    if contact.is_observed() {
        heavy.contact_force = DOUBT;
    }
    let mut arm_trial = ArmTrial::begin(setting, rig, &contact.label(), Machine::Mismatched, heavy)?;
    let (point, elbow) = arm_trial.start();
    let place = f64::from(point.position[0]) + CLEARANCE;
    let wall = Wall {
        point: [place, 0.0, 0.0],
        normal: [-1.0, 0.0, 0.0],
        stiffness,
        damping: DAMPING,
        friction: 0.0,
    };
    arm_trial.plant.insert_wall(wall)?;
    arm_trial.wait(0.5)?;
    let lead = |arm_trial: &mut ArmTrial<'_, '_>, from: f64, to: f64| {
        for tick in 1..=(TIME / T).round() as usize {
            let [fraction, rate, change] = minimum_jerk(tick as f64 * T / TIME);
            let mut at: PosePoint = point;
            at.position[0] += (from + (to - from) * fraction) as f32;
            at.velocity[0] = ((to - from) * rate / TIME) as f32;
            at.acceleration[0] = ((to - from) * change / (TIME * TIME)) as f32;
            arm_trial.follow(at, elbow)?;
        }
        Ok::<_, ScenarioError>(arm_trial.log.now())
    };
    contact.arrived = lead(&mut arm_trial, 0.0, WAY)?;
    arm_trial.wait(STAY)?;
    contact.left = arm_trial.log.now();
    contact.felt = -f64::from(arm_trial.telemetry()?.wrench[0]);
    lead(&mut arm_trial, WAY, 0.0)?;
    arm_trial.wait(1.0)?;
    contact.end = arm_trial.log.now();
    contact.log = arm_trial.end()?;
    Ok(contact)
}

fn add_metrics(summary: &mut Summary, contact: &Contact) {
    let name = |what: &str| format!("{}_{what}", contact.name());
    let label = contact.label();
    let text = format!("{label}: settling time of the force");
    let settled = contact.settled();
    if contact.is_observed() {
        summary.insert(name("settled"), Metric::reported(text, settled, "s"));
        let text = format!("{label}: estimated minus true force at rest");
        summary.insert(name("felt"), Metric::within(text, contact.felt - contact.rest(), MOST_DOUBT, "N"));
    } else {
        summary.insert(name("settled"), Metric::at_most(text, settled, 2.0, "s"));
    }
    let error = contact.rest() - contact.expected();
    let text =
        format!("{label}: force at rest minus {:.2} N, that of the springs in series", contact.expected());
    summary.insert(name("rest"), Metric::reported(text, error, "N"));
    summary.insert(name("peak"), Metric::reported(format!("{label}: largest force"), contact.peak(), "N"));
    let back = contact.log.during(&(contact.end - 0.1..contact.end));
    let off = back.last().map_or(f64::NAN, |sample| (sample.position() - sample.target).norm());
    let text = format!("{label}: position error after the return");
    summary.insert(name("back"), Metric::reported(text, 1e3 * off, "mm"));
}

/// A figure with what the set-point does, which is the same at all walls.
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
                   springs in series. Circles: the contact begins and ends.";
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
