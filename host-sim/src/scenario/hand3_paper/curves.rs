//! Errors of figures 11 and 15 over what the paper does not state, on one machine.

use super::curve::PAPER_FORCE;
use super::force::{hold, sensed};
use super::motion::{Record, estimated_pose, move_box, shift_errors};
use super::{Law, laws};
use crate::report::{Figure, Line, Metric, Panel, Summary};
use crate::scenario::grasping::GraspRig;
use crate::scenario::{Kind, Outcome, Scenario, ScenarioError, Setting, needs};

pub(super) const SCENARIO: Scenario = Scenario {
    name: "hand3-paper-curves",
    title: "What the errors of the Hand3 paper depend on",
    about: "figures 11 and 15 of the Hand3 paper under its law, over the efficiency of the joints and the integral gain",
    robot: "hand3",
    kind: Kind::GraspingHand,
    files: needs::BOX,
    results: "docs/papers/hand3.md",
    duration: 150.0,
    shortest: None,
    laws: Some(&["paper"]),
    lead: &[
        "The paper states neither how much of the motors' torques its joints lose nor its gains. Here its own law runs \
         again and again on the same machine while one of them changes, and all else stays as in `hand3-paper-force` \
         and `hand3-paper-motion`: the force of finger 1 (figure 11) over the fraction of the motors' torques that \
         reaches the joints, and the errors of the shifted box (figure 15) over the integral gain of its position.",
        "A transmission loses a part of the torque that it transmits, besides its Coulomb friction, and the controller \
         of the paper's law knows of neither.",
    ],
    run,
};

fn run(setting: &mut Setting<'_, '_>) -> Result<Outcome, ScenarioError> {
    let mut rig = GraspRig::load(setting)?;
    let laws = laws(setting, &rig.robot.model)?;
    let mut summary = Summary::default();
    let force = over_efficiency(setting, &mut rig, &laws, &mut summary)?;
    let shift = over_integral(setting, &mut rig, &laws, &mut summary)?;
    Ok(Outcome { summary, figures: vec![force, shift], tables: Vec::new(), motion: rig.motion })
}

/// Figure 11 on machines whose transmissions lose a part of the torque.
fn over_efficiency(
    setting: &mut Setting<'_, '_>,
    rig: &mut GraspRig,
    laws: &[Law],
    summary: &mut Summary,
) -> Result<Figure, ScenarioError> {
    let mut panel = Panel::new("Sensed force of finger 1", "force", "N")
        .rule(PAPER_FORCE, format!("paper {PAPER_FORCE} N"));
    let (drives, coulomb) = (rig.drives.clone(), rig.values.friction.paper);
    for (number, law) in laws.iter().enumerate() {
        if law.law.force.efficiency.is_empty() {
            continue;
        }
        let (mut efficiencies, mut forces) = (Vec::new(), Vec::new());
        for &efficiency in &law.law.force.efficiency {
            rig.drives.clone_from(&drives);
            rig.drives.iter_mut().for_each(|drive| drive.motor.torque_constant *= efficiency as f32);
            let log = hold(setting, rig, law, coulomb)?;
            let percent = 100.0 * efficiency;
            let text = format!("{}: sensed force of finger 1, efficiency {percent:.0} %", law.name);
            report(summary, law, &format!("force_at_{percent:.0}"), text, sensed(law, &log).norm(), "N");
            efficiencies.push(percent);
            forces.push(sensed(law, &log).norm());
        }
        panel = panel.line(Line::solid(law.law.title.as_str(), number, efficiencies, forces));
    }
    rig.drives = drives;
    let caption = "Force of finger 1 on the box by its tared sensor when 2 N are commanded, over the fraction of the \
                   motors' torques that reaches the joints, whose Coulomb friction stays. The Hand3 paper reads 0.89 N \
                   (figure 11).";
    let title = "Hand3 figure 11: force over the efficiency of the joints";
    Ok(Figure::stacked(title, caption, "efficiency of a joint", "%").panel(panel))
}

/// Figure 15 under laws that differ in the integral gain of the position.
fn over_integral(
    setting: &mut Setting<'_, '_>,
    rig: &mut GraspRig,
    laws: &[Law],
    summary: &mut Summary,
) -> Result<Figure, ScenarioError> {
    let mut errors = Panel::new("Error along x after each shift", "error", "mm")
        .rule(1.0, "paper +1 cm: 1 mm")
        .rule(2.0, "paper −1 cm: 2 mm");
    let mut pitch = Panel::new("Pitch, worst of four turns", "error", "mrad").rule(4.0, "paper 1–4 mrad");
    let mut drift = Panel::new("From the start, after both", "displacement", "mm")
        .rule(-3.0, "paper x")
        .rule(-5.0, "paper z");
    for (number, law) in laws.iter().enumerate() {
        let gains = &law.law.motion.integral;
        if gains.is_empty() {
            continue;
        }
        let mut values: [Vec<f64>; 5] = Default::default();
        for &gain in gains {
            let mut law = law.clone();
            let Some(changed) = law.law.motion.law.with_integral(gain) else { continue };
            law.law.motion.law = changed;
            let record = move_box(setting, rig, &law, &format!("integral gain {gain}"), &law.law.motion)?;
            let measured = ends(&law, &record);
            let parts = [
                ("shift1_error", "error along x of shift 1", "mm"),
                ("shift2_error", "error along x of shift 2", "mm"),
                ("from_start_x", "x after the shifts, from the start", "mm"),
                ("from_start_z", "z after the shifts, from the start", "mm"),
                ("pitch_error", "pitch error at rest, worst turn", "mrad"),
            ];
            for ((list, value), (key, text, unit)) in values.iter_mut().zip(measured).zip(parts) {
                list.push(value);
                let text = format!("{}: {text}, as the hand estimates it, K_i {gain} N/(m·s)", law.name);
                report(summary, &law, &format!("{key}_at_{gain:.0}"), text, value, unit);
            }
        }
        let [first, second, x, z, turned] = values;
        let line = |what: &str, colour, values| {
            Line::solid(
                format!("{}, {what}", law.law.title),
                (4 * number + colour) % Line::INK,
                gains.clone(),
                values,
            )
        };
        errors = errors.line(line("+1 cm", 0, first)).line(line("−1 cm", 1, second));
        drift = drift.line(line("x", 2, x)).line(line("z", 3, z));
        pitch = pitch.line(line("pitch", 0, turned));
    }
    let caption = "Errors of the box's position two seconds after each shift, its displacement from the start after \
                   both, and the error of the pitch after the turns before, as the hand estimates them, over K_i of the \
                   position. Horizontal lines: figures 14 and 15 of the Hand3 paper.";
    let title = "Hand3 figure 15: errors over the integral gain";
    Ok(Figure::stacked(title, caption, "integral gain of the position", "N/(m·s)")
        .panel(errors)
        .panel(drift)
        .panel(pitch))
}

/// Errors of the first two shifts along x, displacement by all along x and z [mm], and largest error of the
/// pitch after the turns [mrad], as the hand estimates them.
fn ends(law: &Law, record: &Record) -> [f64; 5] {
    let moved = record.displacements(estimated_pose);
    let mut errors = shift_errors(&law.law.motion, &moved);
    let [first, second] = [(); 2].map(|()| errors.next().unwrap_or(f64::NAN));
    let total = moved.iter().fold([0.0; 2], |[x, z], moved| [x + moved.x, z + moved.z]);
    [first, second, total[0], total[1], record.pitch_error(estimated_pose)]
}

/// Adds a value, unless the box was lost before it.
fn report(summary: &mut Summary, law: &Law, key: &str, text: String, value: f64, unit: &str) {
    if value.is_finite() {
        summary.insert(format!("{}_{key}", law.key), Metric::reported(text, value, unit));
    }
}
