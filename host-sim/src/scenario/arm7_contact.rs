//! Which surface an impedance can bear: contacts under many settings, beside the condition of stability.

use tesaki::task::impedance::ImpedanceSettings;
use tesaki_description::impedance::own_mass_at;

use super::arm::{ArmRig, ArmSample, ArmTrial, Machine, impedance, motion, settings, shift};
use super::common::{T, clear_faults, grouped, largest};
use super::{Kind, Outcome, Scenario, ScenarioError, Setting};
use crate::plant::Wall;
use crate::report::{Figure, Line, Metric, Panel, Summary, Table};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "arm7-contact",
    title: "Impedances and the surfaces that they can bear",
    about: "the tool presses with 6 N on surfaces of 1000 to 50 000 N/m under masses, dampings and stiffnesses of which \
            half are unstable there until they are derated",
    robot: "arm7",
    kind: Kind::SevenJointArm,
    files: &[],
    results: "docs/measurements.md#an-arm-under-impedance-control",
    duration: 339.8,
    shortest: None,
    laws: None,
    lead: &[
        "The tool of the seven-joint arm moves 2 cm to a surface and presses with 6 N, along x, where the arm's own mass \
         is large, and along z, where it is small; under impedances whose masses are below and above the arm's own, of \
         small and of critical damping, soft and firm. The surface has 1000, 10 000 or 50 000 N/m and a damping of 20 \
         N·s/m. The machine differs from the controller's model by up to 20 %.",
        "docs/equations.md gives the condition of stability. Below its limit the impedance should remain as it was set; \
         above, the contact oscillates until mass and damping have been raised (derating). It has settled when, in the \
         last second, the force stays within 1 N of its mean, and this is at least half of that without friction. An \
         impedance that is much heavier than the arm multiplies the friction of its joints; there the force may move \
         slowly for longer.",
    ],
    run,
};

/// Distance of the surface from the start [m], and the force at rest on a rigid surface [N].
const CLEARANCE: f64 = 0.02;
const FORCE: f64 = 6.0;
/// Time before the motion, of the motion, and at rest [s].
const BEFORE: f64 = 0.2;
const TIME: f64 = 0.5;
const STAY: f64 = 3.5;
/// The force has settled when it stays within this distance of its mean [N].
const SETTLING_BAND: f64 = 1.0;
/// Masses [kg], damping ratios and stiffnesses [N/m] of the impedances.
const MASSES: [f32; 3] = [1.0, 1.5, 4.0];
const DAMPING_RATIOS: [f32; 2] = [0.5, 1.0];
const STIFFNESSES: [f32; 2] = [300.0, 1500.0];
/// An impedance that is heavier than the arm by more than this multiplies the friction of the joints as much.
const HEAVY: f64 = 3.0;
/// Stiffness and damping of the surfaces [N/m, N·s/m].
const SURFACES: [f64; 3] = [1000.0, 10_000.0, 50_000.0];
const DAMPING: f64 = 20.0;
/// The directions of the contacts: x and z.
const AXES: [(usize, &str); 2] = [(0, "x"), (2, "z")];

/// A contact.
struct Contact {
    axis: usize,
    settings: ImpedanceSettings,
    surface: f64,
    /// Mass of the impedance over the arm's own.
    mass_ratio: f64,
    /// Largest stiffness on which the condition holds [N/m].
    limit: f64,
    samples: Vec<ArmSample>,
    derating: f64,
}

impl Contact {
    /// Forces into the surface in the last second [N].
    fn forces(&self) -> Vec<f64> {
        let last = self.samples.len().saturating_sub((1.0 / T).round() as usize);
        self.samples[last..].iter().map(|sample| -sample.tool.wall_force[self.axis]).collect()
    }

    /// Mean force in the last second [N].
    fn mean(&self) -> f64 {
        let forces = self.forces();
        forces.iter().sum::<f64>() / forces.len() as f64
    }

    /// Largest distance of the force from its mean in the last second [N].
    fn unrest(&self) -> f64 {
        let mean = self.mean();
        largest(self.forces().iter().map(|force| (force - mean).abs()))
    }

    /// Whether the force has come to rest, and the tool still presses.
    fn has_settled(&self) -> bool {
        // Surface and impedance are springs in series.
        let stiffness = f64::from(self.settings.impedance.stiffness[self.axis]);
        let expected = FORCE * self.surface / (self.surface + stiffness);
        self.unrest() <= SETTLING_BAND && self.mean() > 0.5 * expected
    }

    fn is_borne(&self) -> bool {
        self.surface <= self.limit
    }
}

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = ArmRig::load(setting)?;
    let (mut contacts, mut faults) = (Vec::new(), Vec::new());
    for (axis, name) in AXES {
        for stiffness in STIFFNESSES {
            for ratio in DAMPING_RATIOS {
                for mass in MASSES {
                    for surface in SURFACES {
                        let damping = 2.0 * ratio * (mass * stiffness).sqrt();
                        let settings = ImpedanceSettings {
                            impedance: impedance(mass, damping, stiffness),
                            ..settings(damping)
                        };
                        let label = format!(
                            "along {name}: M {mass} kg, B {damping:.0} N·s/m, K {stiffness} N/m on {} N/m",
                            grouped(surface)
                        );
                        match press(setting, &mut rig, &label, axis, settings, surface) {
                            Ok(contact) => contacts.push(contact),
                            // A stop is safe, but it is no contact.
                            Err(fault @ ScenarioError::Fault { .. }) => {
                                clear_faults(setting.controller)?;
                                faults.push(fault.to_string());
                            }
                            Err(other) => return Err(other),
                        }
                    }
                }
            }
        }
    }
    let mut summary = Summary::default();
    let metric = Metric::at_most("contacts that a fault ended", faults.len() as f64, 0.0, "");
    summary.insert("faults", if faults.is_empty() { metric } else { metric.note(faults.join("; ")) });
    add_metrics(&mut summary, &contacts, faults.len());
    let tables = vec![("contacts.csv".to_owned(), table(&contacts))];
    Ok(Outcome { summary, figures: vec![figure(&contacts)], tables, motion: rig.motion })
}

fn press(
    setting: &mut Setting<'_, '_>,
    rig: &mut ArmRig,
    label: &str,
    axis: usize,
    settings: ImpedanceSettings,
    surface: f64,
) -> Result<Contact, ScenarioError> {
    let model = rig.robot.model.clone();
    let mut arm_trial = ArmTrial::begin(setting, rig, label, Machine::Mismatched, settings)?;
    let (point, elbow) = arm_trial.start();
    let angles: Vec<f32> = arm_trial.plant.truth().positions.iter().map(|&angle| angle as f32).collect();
    let own_mass = own_mass_at(&model, &angles, settings.impedance.axes)[axis];
    let limit = settings.max_contact_stiffness(axis, own_mass).into();
    let [mut place, mut normal] = [[0.0; 3]; 2];
    (place[axis], normal[axis]) = (f64::from(point.position[axis]) + CLEARANCE, -1.0);
    arm_trial.plant.insert_wall(Wall {
        point: place,
        normal,
        stiffness: surface,
        damping: DAMPING,
        friction: 0.0,
    })?;
    arm_trial.wait(BEFORE)?;
    let way = CLEARANCE + FORCE / f64::from(settings.impedance.stiffness[axis]);
    arm_trial.follow_path(TIME, |time| {
        let mut setpoint = point;
        shift(&mut setpoint, axis, motion([0.0, way], time, TIME));
        (setpoint, elbow)
    })?;
    arm_trial.wait(STAY)?;
    let derating = arm_trial.telemetry()?.derating.into();
    let mass_ratio = f64::from(settings.impedance.mass[axis] / own_mass);
    Ok(Contact { axis, settings, surface, mass_ratio, limit, samples: arm_trial.end()?.0, derating })
}

/// `ended`: the number of contacts that a fault ended. They have not settled, derated or not.
fn add_metrics(summary: &mut Summary, contacts: &[Contact], ended: usize) {
    // That none of no contacts is unsettled is no success.
    let of_none = if contacts.is_empty() { f64::NAN } else { 0.0 };
    let all = contacts.len() as f64;
    let count = |which: &dyn Fn(&&Contact) -> bool| of_none + contacts.iter().filter(which).count() as f64;
    let derated = count(&|contact| contact.derating > 1.0);
    summary.insert(
        "derated_unsettled",
        Metric::at_most(
            "derated contacts that have not settled, and those that a fault ended",
            count(&|contact| contact.derating > 1.0 && !contact.has_settled()) + ended as f64,
            0.0,
            "",
        )
        .note(format!("of {derated}, and {ended} that a fault ended")),
    );
    let heavy = |contact: &&Contact| contact.mass_ratio > HEAVY;
    for (key, text, which) in [
        ("unsettled", "other contacts that have not settled", false),
        ("heavy_unsettled", "the same with an impedance over three times as heavy as the arm", true),
    ] {
        let of = count(&|contact| contact.derating <= 1.0 && heavy(contact) == which);
        let value =
            count(&|contact| contact.derating <= 1.0 && heavy(contact) == which && !contact.has_settled());
        summary.insert(key, Metric::reported(text, value, "").note(format!("of {of}")));
    }
    let borne = count(&|contact| contact.is_borne());
    summary.insert(
        "derated_within",
        Metric::at_most(
            "contacts within the limit of the condition that were derated",
            count(&|contact| contact.is_borne() && contact.derating > 1.0),
            0.0,
            "",
        )
        .note(format!("of {borne}")),
    );
    summary.insert(
        "derated_beyond",
        Metric::reported(
            "contacts beyond the limit that were derated",
            count(&|contact| !contact.is_borne() && contact.derating > 1.0),
            "",
        )
        .note(format!("of {}", all - borne)),
    );
    let max = largest([1.0].into_iter().chain(contacts.iter().map(|contact| contact.derating)));
    summary.insert("derating", Metric::reported("largest derating", max, ""));
}

/// Derating over the ratio of the surface's stiffness to the limit.
fn figure(contacts: &[Contact]) -> Figure {
    let caption = "Each circle is a contact: over how many times the surface is as stiff as the condition allows \
                   (1 is the limit), the derating at the end, and the largest distance of the force from its mean in \
                   the last second. Left of 1 nothing should be derated.";
    let ratio = |contact: &Contact| (contact.surface / contact.limit.max(1.0)).log10();
    let mut derating = Panel::new("Derating", "mass and damping times", "");
    let mut unrest = Panel::new("Unrest", "force from its mean", "N").rule(SETTLING_BAND, "settled");
    let mut ends = [f64::INFINITY, f64::NEG_INFINITY];
    for contact in contacts {
        let x = ratio(contact);
        derating = derating.mark(x, contact.derating, "");
        unrest = unrest.mark(x, contact.unrest(), "");
        ends = [ends[0].min(x), ends[1].max(x)];
    }
    let line = |value: f64| Line::dashed("as set", Line::INK, ends.to_vec(), vec![value; 2]);
    Figure::stacked("Impedances on surfaces", caption, "log₁₀ of stiffness over limit", "")
        .event(0.0, "limit")
        .panel(derating.line(line(1.0)))
        .panel(unrest.line(Line::dashed("at rest", Line::INK, ends.to_vec(), vec![0.0; 2])))
}

fn table(contacts: &[Contact]) -> String {
    let mut table = Table::new(contacts);
    table
        .column("axis", "", |contact| contact.axis as f64)
        .column("mass", "kg", |contact| contact.settings.impedance.mass[contact.axis].into())
        .column("damping", "N·s/m", |contact| contact.settings.impedance.damping[contact.axis].into())
        .column("stiffness", "N/m", |contact| contact.settings.impedance.stiffness[contact.axis].into())
        .column("surface", "N/m", |contact| contact.surface)
        .column("limit", "N/m", |contact| contact.limit)
        .column("derating", "", |contact| contact.derating)
        .column("force from its mean", "N", Contact::unrest);
    table.csv()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_a_contact_nothing_passes() {
        let mut summary = Summary::default();
        add_metrics(&mut summary, &[], 0);
        let limited: Vec<bool> =
            summary.metrics().filter(|(_, metric)| metric.limit.is_some()).map(|(_, m)| m.pass()).collect();
        assert_eq!(limited, [false, false]);
    }
}
