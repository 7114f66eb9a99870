//! The tool is led into walls from soft to stiff: does it come to rest there, and press as its impedance says?

use tesaki::kinematics::PosePoint;
use tesaki::task::impedance::{ForceSource, ImpedanceSettings};
use tesaki_supervisor::trajectory::minimum_jerk;

use super::arm::{Bench, Log, Machine, Session, impedance, settings};
use super::grasping::{T, require_duration};
use super::{Outcome, Scenario, ScenarioError, Setting};
use crate::plant::Wall;
use crate::report::{Figure, Line, Metric, Panel, Summary};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "arm7-wall",
    title: "An arm that meets walls",
    about: "the tool is led 3 cm into walls of 200 to 50 000 N/m, rests there, and comes back; also without a force sensor",
    robot: "arm7",
    duration: 36.0,
    lead: &[
        "The tool of the seven-joint arm is led forward by 5 cm within half a second, where a wall stands after 2 cm; it stays for \
         2.5 seconds and is led back. The impedance is M 3.5 kg, what the arm itself presents along this axis, B 60 N·s/m and \
         K 300 N/m. The wall's stiffness is 200, 2000, 10 000 or 50 000 N/m, with little damping. The machine differs from \
         the controller's model by up to 20 %.",
        "At rest the tool should press as the two springs say that are then in series. It has settled once the force stays within \
         a newton of what it is at the end. Two of the walls are met once more without the force sensor: a momentum observer finds \
         the force in the motors' torques. It cannot tell a push from friction and weight that the model does not know, so only what \
         is more than 6 N counts as a contact.",
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

/// The walls that are met without a force sensor [N/m], the bandwidth of the observer [rad/s] and what counts as a contact
/// then [N]: friction that the model does not know and weight that has moved must not.
const UNFELT: [f64; 2] = [2000.0, 10_000.0];
const BANDWIDTH: f32 = 30.0;
const DOUBT: f32 = 6.0;
/// What it may be wrong by at rest [N].
const MOST_DOUBT: f64 = 5.0;

/// One wall.
struct Contact {
    stiffness: f64,
    force: ForceSource,
    log: Log,
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
        format!("{} N/m{}", self.stiffness, if self.is_observed() { ", without a sensor" } else { "" })
    }

    /// Force into the wall [N].
    fn force(sample: &super::arm::Sample) -> f64 {
        -sample.tool.wall_force[0]
    }

    /// What the springs in series say [N]. The place of the tool's end is known as well as the joints' angles are.
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
    let mut bench = Bench::load(setting)?;
    let mut summary = Summary::new(SCENARIO.name, "", setting.seed);
    let (mut contacts, mut tables) = (Vec::new(), Vec::new());
    let sensed = WALLS.map(|stiffness| (stiffness, ForceSource::Sensor));
    let observed = UNFELT.map(|stiffness| (stiffness, ForceSource::Observer { bandwidth: BANDWIDTH }));
    for (stiffness, force) in sensed.into_iter().chain(observed) {
        let contact = meet(setting, &mut bench, stiffness, force)?;
        tables.push((format!("{}.csv", contact.name()), contact.log.table()));
        contacts.push(contact);
    }
    for contact in &contacts {
        add_metrics(&mut summary, contact);
    }
    let summary = summary.ticks(u64::from(bench.motion.ticks()));
    Ok(Outcome { summary, figures: vec![figure(&contacts)], tables, motion: bench.motion })
}

fn meet(
    setting: &mut Setting<'_, '_>,
    bench: &mut Bench,
    stiffness: f64,
    force: ForceSource,
) -> Result<Contact, ScenarioError> {
    let mut contact =
        Contact { stiffness, force, log: Log::default(), felt: f64::NAN, arrived: 0.0, left: 0.0, end: 0.0 };
    let mut heavy =
        ImpedanceSettings { impedance: impedance(3.5, 60.0, STIFFNESS as f32), force, ..settings(60.0) };
    if contact.is_observed() {
        heavy.contact_force = DOUBT;
    }
    let mut session = Session::begin(setting, bench, &contact.label(), Machine::Mismatched, heavy)?;
    let (point, elbow) = session.start();
    let place = f64::from(point.position[0]) + CLEARANCE;
    let wall = Wall {
        point: [place, 0.0, 0.0],
        normal: [-1.0, 0.0, 0.0],
        stiffness,
        damping: DAMPING,
        friction: 0.0,
    };
    session.plant.insert_wall(wall)?;
    session.wait(0.5)?;
    let lead = |session: &mut Session<'_, '_>, from: f64, to: f64| {
        for tick in 1..=(TIME / T).round() as usize {
            let [share, rate, change] = minimum_jerk(tick as f64 * T / TIME);
            let mut at: PosePoint = point;
            at.position[0] += (from + (to - from) * share) as f32;
            at.velocity[0] = ((to - from) * rate / TIME) as f32;
            at.acceleration[0] = ((to - from) * change / (TIME * TIME)) as f32;
            session.follow(at, elbow)?;
        }
        Ok::<_, ScenarioError>(session.log.now())
    };
    contact.arrived = lead(&mut session, 0.0, WAY)?;
    session.wait(STAY)?;
    contact.left = session.log.now();
    contact.felt = -f64::from(session.telemetry()?.wrench[0]);
    lead(&mut session, WAY, 0.0)?;
    session.wait(1.0)?;
    contact.end = session.log.now();
    contact.log = session.end()?;
    Ok(contact)
}

fn add_metrics(summary: &mut Summary, contact: &Contact) {
    let name = |what: &str| format!("{}_{what}", contact.name());
    let label = contact.label();
    let text = format!("{label}: until the force has settled");
    let settled = contact.settled();
    if contact.is_observed() {
        summary.insert(name("settled"), Metric::reported(text, settled, "s"));
        let text = format!("{label}: force felt at rest less the true one");
        summary.insert(name("felt"), Metric::within(text, contact.felt - contact.rest(), MOST_DOUBT, "N"));
    } else {
        summary.insert(name("settled"), Metric::at_most(text, settled, 2.0, "s"));
    }
    let error = contact.rest() - contact.expected();
    let text = format!("{label}: force at rest less {:.2} N, what the springs say", contact.expected());
    summary.insert(name("rest"), Metric::reported(text, error, "N"));
    summary.insert(name("peak"), Metric::reported(format!("{label}: largest force"), contact.peak(), "N"));
    let back = contact.log.during(&(contact.end - 0.1..contact.end));
    let off = back.last().map_or(f64::NAN, |sample| (sample.position() - sample.aim).norm());
    let text = format!("{label}: off its place after coming back");
    summary.insert(name("back"), Metric::reported(text, 1e3 * off, "mm"));
}

fn figure(contacts: &[Contact]) -> Figure {
    let caption =
        "What the wall takes from the tool, means over a control period. Dashed: what the two springs say.";
    let mut figure = Figure::stacked("Force into the wall", caption, "time", "s");
    for contact in contacts {
        let samples = contact.log.during(&(0.0..contact.end));
        let time: Vec<f64> = samples.iter().map(|sample| sample.time).collect();
        let force = samples.iter().map(Contact::force).collect();
        let expected = vec![contact.expected(); 2];
        let panel = Panel::new(contact.label(), "force", "N")
            .line(Line::solid("force", 0, time, force))
            .line(Line::dashed("springs", Line::INK, vec![contact.arrived, contact.left], expected));
        figure = figure.panel(panel);
    }
    figure
}
