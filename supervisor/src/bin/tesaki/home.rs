//! The commands `home` and `tare`.

use serde_json::json;
use tesaki_supervisor::Board;

use crate::args::{Home, Options};
use crate::board_session::{BoardSession, notice_untared};
use crate::failure::Failure;
use crate::joints::{check_typed, each_once, find};
use crate::output;

pub fn home(options: &Options, args: &Home) -> Result<(), Failure> {
    let mut session = BoardSession::command(options)?;
    let model = session.model()?;
    let unit = if args.degrees { core::f32::consts::PI / 180.0 } else { 1.0 };
    let mut angles: Vec<Option<f32>> = vec![None; model.joints.len()];
    each_once(&args.joints, "joint")?;
    for (name, angle) in &args.joints {
        let (index, joint) = find(&model, name)?;
        if !joint.encoder.relative {
            output::notice(
                options,
                &format!("{name} has an absolute encoder and keeps the angle that it measures"),
            );
        }
        angles[index] = Some(angle * unit);
    }
    if !model.joints.iter().any(|joint| joint.encoder.relative) {
        let text = format!("all encoders of {} are absolute: there is nothing to home", model.name);
        return output::result(
            options,
            &json!({ "homed": {}, "no_longer_tared": [], "warnings": [] }),
            || text,
        );
    }
    let mut positions = Vec::new();
    let mut assumed = Vec::new();
    for (joint, angle) in model.joints.iter().zip(angles) {
        let angle = match (angle, args.others) {
            (Some(angle), _) => angle,
            // The board ignores the angle, but requires one that is possible.
            (None, _) if !joint.encoder.relative => 0.0_f32.clamp(joint.limits.lower, joint.limits.upper),
            (None, Some(others)) => {
                assumed.push(joint.name.as_str());
                others * unit
            }
            (None, None) => {
                return Err(Failure::Usage(format!(
                    "{} has no angle: name every joint, or give the others with --others",
                    joint.name
                )));
            }
        };
        check_typed(joint, angle, args.degrees)?;
        positions.push(angle);
    }
    let mut warnings = Vec::new();
    if let (Some(others), false) = (args.others, assumed.is_empty()) {
        let unit = if args.degrees { "°" } else { " rad" };
        let joints = assumed.join(", ");
        warnings.push(format!(
            "{joints} must stand at {others}{unit} now. From a wrong angle a joint runs into its stop"
        ));
    }
    for warning in &warnings {
        output::notice(options, &format!("warning: {warning}"));
    }
    output::confirm(options, "The current joint angles will be set to these values. Continue?")?;
    let tared = session.tared(&model)?;
    session.board.home(&positions)?;
    // What absolute encoders measure was not set.
    let relative = model.joints.iter().zip(&positions).filter(|(joint, _)| joint.encoder.relative);
    let set: serde_json::Map<_, _> =
        relative.map(|(joint, angle)| (joint.name.to_string(), output::exact(angle))).collect();
    output::result(
        options,
        &json!({ "homed": set, "no_longer_tared": tared, "warnings": warnings }),
        || format!("{} homed", output::counted(set.len(), "joint")),
    )?;
    notice_untared(options, "the joints were homed", &tared);
    Ok(())
}

pub fn tare(options: &Options) -> Result<(), Failure> {
    let mut session = BoardSession::command(options)?;
    output::confirm(options, "The force sensors will be set to zero. Is nothing touching the tips?")?;
    if let Err(error) = session.board.tare() {
        let failure = Failure::from(error);
        return Err(match session.model() {
            Ok(model) => failure.named(&model),
            Err(_) => failure,
        });
    }
    output::result(options, &json!({ "tared": true }), || "force sensors tared".to_owned())
}
