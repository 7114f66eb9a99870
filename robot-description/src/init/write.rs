//! The files, with unit and source behind each value.

use std::fmt::Write as _;
use std::path::Path;

use super::servo::{CURRENT_BANDWIDTH, CURRENT_DELAY, FrictionChoice, JointPlan};
use super::{GRAVITY, JointMotor, RobotTexts};
use crate::urdf::Urdf;

/// Column of the comments.
const COLUMN: usize = 34;

pub fn texts(path: &Path, text: &str, urdf: &Urdf, accepted: &[String], joints: &[JointPlan]) -> RobotTexts {
    let name = urdf.robot.name.clone();
    // Two hyphens would end the comment.
    let from = path.display().to_string().replace('-', "\u{2010}");
    let urdf_text = format!("{}\n<!-- Copied from {from} by `tesaki model init`. -->\n", text.trim_end());
    RobotTexts {
        controller: controller(&name, path, accepted, joints),
        plant: plant(&name, joints),
        urdf: urdf_text,
        joints: joints.iter().map(joint_motor).collect(),
        notes: notes(accepted, joints),
        name,
    }
}

fn joint_motor(joint: &JointPlan) -> JointMotor {
    JointMotor {
        joint: joint.name.clone(),
        motor: joint.motor.id,
        torque: joint.torque,
        reason: joint.reason.clone(),
    }
}

/// What the files have that the URDF has otherwise.
fn notes(accepted: &[String], joints: &[JointPlan]) -> Vec<String> {
    let mut notes = Vec::new();
    if !accepted.is_empty() {
        notes.push(format!("inertia replaced by the nearest that a body can have: {}", accepted.join(", ")));
    }
    let mut about = |good: &dyn Fn(&JointPlan) -> bool, what: &str| {
        let names: Vec<&str> = joints.iter().filter(|joint| good(joint)).map(|joint| &*joint.name).collect();
        if !names.is_empty() {
            let all = names.len() > 1 && names.len() == joints.len();
            notes.push(format!("{what}: {}", if all { "all joints".to_owned() } else { names.join(", ") }));
        }
    };
    let is = |choice: FrictionChoice| {
        move |joint: &JointPlan| joint.coulomb_choice == choice || joint.viscous_choice == choice
    };
    about(
        &is(FrictionChoice::TooLarge),
        "the URDF's friction would take most of the torque, the motor's is used",
    );
    about(&is(FrictionChoice::Missing), "the URDF has no friction, the motor's is used");
    about(&|joint| joint.urdf_effort <= 0.0, "the URDF has no effort limit, the motor's torque is used");
    about(
        &|joint| joint.urdf_effort > 1.001 * joint.torque,
        "the URDF's effort is more than the motor's torque, which is used",
    );
    about(
        &|joint| joint.too_fast.is_none() && joint.urdf_velocity > 1.001 * joint.velocity,
        "the URDF's velocity is more than the motor reaches, which is used",
    );
    let lowered = |joint: &JointPlan| (joint.too_fast, joint.urdf_velocity, joint.velocity);
    let mut told = Vec::new();
    for like @ (too_fast, urdf, velocity) in joints.iter().map(lowered) {
        let Some(reached) = too_fast.filter(|_| !told.contains(&like)) else { continue };
        told.push(like);
        let of = if urdf > 0.0 {
            format!("velocity {} rad/s of the URDF's <limit>", number(urdf))
        } else {
            format!("the motor's {} rad/s (the URDF's <limit> has no velocity)", number(reached))
        };
        let velocity = number(velocity);
        let what =
            format!("{of}: more than ticks of 10 ms can follow in this range, {velocity} rad/s is used");
        about(&|joint| lowered(joint) == like, &what);
    }
    about(
        &|joint| joint.load.gravity > 0.6 * joint.torque,
        "gravity takes more than 60 % of the torque: choose a stronger motor",
    );
    about(
        &|joint| joint.is_weak && joint.filter_time > SLOW,
        "the motor is weak for the inertia that it moves, a move over the range takes more than 15 s: choose a \
         stronger motor",
    );
    let mut supplies: Vec<f32> = joints.iter().map(|joint| joint.motor.supply).collect();
    supplies.sort_by(f32::total_cmp);
    supplies.dedup();
    if supplies.len() > 1 {
        notes.push(format!(
            "the motors need different supplies, {supplies:?} V, and a board watches only one: controller.toml has the \
             limits of the highest, `supply_min` and `supply_max`. Feed the other motors by converters, or choose motors for one \
             supply with --motor"
        ));
    }
    notes
}

/// A time constant of the trajectory filter that is told [s]: a move takes some nine of them.
const SLOW: f32 = 1.7;

/// A key with its value and what is to be said of it.
struct Entry {
    section: &'static str,
    key: &'static str,
    value: String,
    comment: String,
}

fn controller(name: &str, path: &Path, accepted: &[String], joints: &[JointPlan]) -> String {
    let mut text = format!(
        "# Settings of {name} that its URDF cannot express. SI units; gains are per inertia (see servo.pid).\n\
         # Written by `tesaki model init` for {}. Behind each value: its unit, and where it\n\
         # comes from. Replace what is assumed by what your robot has, then run `tesaki model check`.\n\n",
        path.display()
    );
    let vector: Vec<String> = GRAVITY.iter().map(|&part| number(part)).collect();
    line(
        &mut text,
        "gravity",
        &format!("[{}]", vector.join(", ")),
        "m/s², in the frame of the base; assumed: upright",
    );
    if !accepted.is_empty() {
        let names: Vec<String> = accepted.iter().map(|name| format!("{name:?}")).collect();
        let comment = "links whose inertia no body can have: the nearest possible one is used";
        line(&mut text, "accept_inertia", &format!("[{}]", names.join(", ")), comment);
    }
    text += "\n[safety]\n";
    let supply = joints.iter().map(|joint| joint.motor.supply).fold(0.0, f32::max);
    let damping = joints.iter().map(JointPlan::damping).fold(f32::INFINITY, f32::min);
    let safety = [
        ("command_timeout", number(0.1), "s without a command until the reaction; assumed".to_owned()),
        (
            "reaction",
            "\"hold\"".to_owned(),
            "strongest reaction to a fault: \"off\", \"damp\" or \"hold\"".to_owned(),
        ),
        (
            "damping",
            number(damping),
            "N·m·s/rad, for \"damp\"; computed: a quarter of the lightest inertia in 10 ms".to_owned(),
        ),
        ("supply_min", number(0.8 * supply), format!("V; motor: {} V less a fifth", number(supply))),
        ("supply_max", number(1.2 * supply), "V; a fifth more".to_owned()),
    ];
    for (key, value, comment) in safety {
        line(&mut text, key, &value, &comment);
    }
    let entries: Vec<Vec<Entry>> = joints.iter().map(of_joint).collect();
    let is_common = |entry: &Entry| {
        let same = |other: &Entry| {
            (other.section, other.key, &other.value, &other.comment)
                == (entry.section, entry.key, &entry.value, &entry.comment)
        };
        entries.iter().all(|joint| joint.iter().any(same))
    };
    if let Some(first) = entries.first() {
        text += "\n# All joints; [joints.NAME] below has what differs from joint to joint.";
        let common: Vec<&Entry> = first.iter().filter(|entry| is_common(entry)).collect();
        sections(&mut text, "joint", &common);
    }
    for (joint, entries) in joints.iter().zip(&entries) {
        let _ = write!(text, "\n# {}: {} ({})\n", joint.name, joint.motor.id, joint.motor.source);
        let _ = write!(text, "# {}", because(joint));
        let own: Vec<&Entry> = entries.iter().filter(|entry| !is_common(entry)).collect();
        sections(&mut text, &format!("joints.{}", key(&joint.name)), &own);
    }
    text
}

fn because(joint: &JointPlan) -> String {
    format!(
        "Motor {}. Gravity takes up to {:.3} N·m of {:.3} N·m.",
        joint.reason, joint.load.gravity, joint.torque
    )
}

/// Writes the entries with the heads of their sections.
fn sections(text: &mut String, prefix: &str, entries: &[&Entry]) {
    let mut section = "";
    for entry in entries {
        if entry.section != section {
            section = entry.section;
            let _ = write!(text, "\n[{prefix}.{section}]\n");
        }
        line(text, entry.key, &entry.value, &entry.comment);
    }
    if entries.is_empty() {
        text.push('\n');
    }
}

fn of_joint(joint: &JointPlan) -> Vec<Entry> {
    let mut entries = Vec::new();
    let mut add = |section, key, value: String, comment: String| {
        entries.push(Entry { section, key, value, comment });
    };
    let motor = &joint.motor;
    let n = number;
    add(
        "motor",
        "rotor_inertia",
        n(motor.rotor_inertia),
        format!("kg·m², through the gear; {}", motor.rotor_source),
    );
    add(
        "motor",
        "torque_constant",
        n(motor.torque_constant),
        format!("N·m/A at the joint; {}", motor.torque_source),
    );
    let current = motor.current;
    add("motor", "current_limit", n(current), format!("A; {} N·m at the joint", n(motor.torque())));
    add("motor", "current_resolution", n(current / 2000.0), "A a count; assumed: 12 bit".to_owned());
    add("motor", "bandwidth", n(CURRENT_BANDWIDTH), "Hz, of the current loop; assumed".to_owned());
    add("motor", "delay", n(CURRENT_DELAY), "s, from sampling to torque; assumed".to_owned());

    add(
        "encoder",
        "counts_per_turn",
        n(motor.counts_per_turn),
        format!("of the joint; {}", motor.encoder_source),
    );
    add("encoder", "reversed", "false".to_owned(), "assumed: counts rise with the angle".to_owned());
    add("encoder", "zero", "0".to_owned(), "count at angle 0; assumed".to_owned());
    let homed = if motor.relative { "must be homed after power-on" } else { "absolute" };
    add("encoder", "relative", motor.relative.to_string(), homed.to_owned());

    limits(joint, &mut add);
    friction(joint, &mut add);
    servo(joint, &mut add);
    entries
}

type Add<'a> = &'a mut dyn FnMut(&'static str, &'static str, String, String);

fn limits(joint: &JointPlan, add: Add<'_>) {
    let n = number;
    if (joint.urdf_velocity - joint.velocity).abs() > 1e-3 * joint.velocity {
        let why = if joint.too_fast.is_some() {
            "the most that ticks of 10 ms can follow in this range"
        } else {
            "motor without load"
        };
        let comment = format!("rad/s; {why}; the URDF has {}", n(joint.urdf_velocity));
        add("limits", "velocity", n(joint.velocity), comment);
    }
    if (joint.urdf_effort - joint.torque).abs() > 1e-3 * joint.torque {
        let comment = format!("N·m; motor; the URDF has {}", n(joint.urdf_effort));
        add("limits", "torque", n(joint.torque), comment);
    }
    add(
        "limits",
        "torque_rate",
        n(joint.torque_rate),
        format!(
            "N·m/s; computed: {} N·m in {:.0} ms",
            n(joint.torque),
            1e3 * joint.torque / joint.torque_rate
        ),
    );
    // The smallest of the other joints is the same number, or one rounded differently.
    let comment = if joint.following_error < 0.1499 {
        "rad; computed: half as much again as the range"
    } else {
        "rad; computed: twice the error with half of gravity and friction unknown, 0.15 to 0.5"
    };
    add("limits", "following_error", n(joint.following_error), comment.to_owned());
}

fn friction(joint: &JointPlan, add: Add<'_>) {
    let comment = |unit: &str, choice, urdf: f32| match choice {
        FrictionChoice::TooLarge => {
            format!(
                "{unit}; motor: {}; the URDF's {} is too much for it",
                joint.motor.friction_source,
                number(urdf)
            )
        }
        _ => format!("{unit}; motor: {}; the URDF has none", joint.motor.friction_source),
    };
    if joint.coulomb_choice != FrictionChoice::Urdf {
        let comment = comment("N·m", joint.coulomb_choice, joint.urdf_coulomb);
        add("friction", "coulomb", number(joint.coulomb), comment);
    }
    if joint.viscous_choice != FrictionChoice::Urdf {
        let comment = comment("N·m·s/rad", joint.viscous_choice, joint.urdf_viscous);
        add("friction", "viscous", number(joint.viscous), comment);
    }
}

fn servo(joint: &JointPlan, add: Add<'_>) {
    let n = number;
    let comment = format!(
        "s, of the trajectory filter; computed: over the whole range at most {} rad/s, half of the spare torque",
        n(joint.peak_velocity)
    );
    add("servo", "filter_time", n(joint.filter_time), comment);
    let comment = "rad; computed: 1.2 encoder counts, at least 7e-4: friction holds what is smaller";
    add("servo", "rest_error", n(joint.rest_error), comment.to_owned());
    let [smallest, largest, mean] = joint.inertia;
    let comment = format!(
        "kg·m²; computed, with rotors: geometric mean of {} (other joints free) and {} (held)",
        n(smallest),
        n(largest)
    );
    add("servo", "inertia", n(mean), comment);
    let [proportional, integral, derivative, cutoff] = joint.pid();
    add("servo.pid", "proportional", n(proportional), "1/s²; computed: bandwidth²".to_owned());
    add("servo.pid", "integral", n(integral), "1/s³; computed: bandwidth³/4".to_owned());
    add("servo.pid", "derivative", n(derivative), "1/s; computed: 2 bandwidth".to_owned());
    add("servo.pid", "cutoff", n(cutoff), "rad/s; computed: 4 bandwidth".to_owned());
    let slowed = if joint.slowed { "; slowed: faster, it would swing with other joints" } else { "" };
    let comment = format!(
        "rad/s; chosen for a ratio of inertias of {:.1}, {} counts a turn and the friction{slowed}",
        largest / smallest,
        n(joint.motor.counts_per_turn)
    );
    add("servo.observer", "bandwidth", n(joint.bandwidth), comment);
    add("servo.observer", "observer_bandwidth", n(joint.observer_bandwidth), "rad/s; likewise".to_owned());
}

/// A section and its values: key, value, comment.
type Section<'a> = (&'a str, &'a [(&'a str, f32, &'a str)]);

fn plant(name: &str, joints: &[JointPlan]) -> String {
    let most = |value: fn(&JointPlan) -> f32| joints.iter().map(value).fold(0.0, f32::max);
    let relative = joints.iter().any(|joint| joint.motor.relative);
    let coulomb = most(|joint| joint.coulomb);
    let current = most(|joint| joint.motor.current);
    let supply = most(|joint| joint.motor.supply);
    let step = joints.iter().map(JointPlan::step).fold(1e-3, f32::min);
    let vector: Vec<String> = GRAVITY.iter().map(|&part| number(part)).collect();
    let mut text = format!(
        "# The simulated machine {name}, in addition to robot.urdf and the motors and encoders of controller.toml.\n\
         # The controller never reads this file. SI units. Written by `tesaki model init`.\n\n"
    );
    line(
        &mut text,
        "gravity",
        &format!("[{}]", vector.join(", ")),
        "m/s², in the frame of the base; assumed: upright",
    );
    let homing =
        if relative { "rad; assumed: homed by hand" } else { "rad, of an absolute encoder; assumed" };
    let sections: [Section<'_>; 6] = [
        (
            "mismatch",
            &[
                ("spread", 0.2, "masses, friction, torque constants: each differs by up to 20 %; assumed"),
                ("homing_error", if relative { 0.002 } else { 5e-4 }, homing),
            ],
        ),
        (
            "friction",
            &[("paper", coulomb, "N·m, only for runs with `friction = paper`; the largest of the joints")],
        ),
        (
            "inner_loop",
            &[("bandwidth", 300.0, "Hz; as motor.bandwidth"), ("delay", 3e-4, "s; as motor.delay")],
        ),
        (
            "noise",
            &[
                (
                    "current",
                    current / 500.0,
                    "A, standard deviation; assumed: 0.2 % of the largest current limit",
                ),
                ("supply", 0.002 * supply, "V; assumed: 0.2 %"),
            ],
        ),
        ("supply", &[("voltage", supply, "V; motor")]),
        (
            "integration",
            &[("step", step, "s, sub-step; computed: rotor inertia over viscous friction, at most 1 ms")],
        ),
    ];
    for (section, entries) in sections {
        let _ = write!(text, "\n[{section}]\n");
        for (key, value, comment) in entries {
            line(&mut text, key, &number(*value), comment);
        }
    }
    text += "\n[posture]\n";
    for joint in joints {
        let (lower, upper) = joint.range;
        let comment =
            format!("rad at the start; 0, or within the limits {} to {}", number(lower), number(upper));
        line(&mut text, &key(&joint.name), &number(joint.start), &comment);
    }
    text
}

/// `key = value  # comment`
fn line(text: &mut String, key: &str, value: &str, comment: &str) {
    let setting = format!("{key} = {value}");
    let _ = writeln!(text, "{setting:<COLUMN$} # {comment}");
}

/// A name as a key of TOML.
fn key(name: &str) -> String {
    let bare = name.chars().all(|c| c.is_ascii_alphanumeric() || "-_".contains(c));
    if bare { name.to_owned() } else { format!("{name:?}") }
}

/// Four digits, or all of a whole number, as a number of TOML that is not whole by its type.
fn number(value: f32) -> String {
    if libm::fmodf(value, 1.0) == 0.0 {
        return format!("{value:?}");
    }
    let short: f32 = format!("{value:.3e}").parse().unwrap_or(value);
    format!("{short:?}")
}
