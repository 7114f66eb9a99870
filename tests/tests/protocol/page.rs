//! The examples and the tables of `docs/protocol.md`.

use std::collections::BTreeMap;

use tesaki::control::{ImpedanceTerm, ServoMode};
use tesaki::fault::FaultCause;
use tesaki::model::Reaction;
use tesaki::node::Node;
use tesaki::protocol::{FromBoard, Mode, Refusal, Reply, Request, SCHEMA_KEY, Stream};
use tesaki::robot::LimitRefusal;
use tesaki::task::TaskKind;
use tesaki::task::grasping::{
    Failure, GraspCommand, GraspRefusal, InternalForce, InvalidPlan, ObjectControl, Phase, PlanField,
};
use tesaki::task::impedance::{
    ForceSource, ImpedanceCommand, ImpedanceRefusal, InvalidSettings, Law, Redundancy, SetpointError,
};
use tesaki::task::joint_servo::{JointCommand, JointServoRefusal};

use super::golden::{golden, hex, parse};
use super::message::Message;
use super::messages::messages;
use super::values::{SCHEMA, finger, quiet_board};
use super::variants::Variants;

const PAGE: &str = include_str!("../../../docs/protocol.md");

/// The lines of the page's blocks of that kind.
fn blocks(kind: &str) -> Vec<&'static str> {
    let mut inside = false;
    let mut lines = Vec::new();
    for line in PAGE.lines() {
        if let Some(fence) = line.strip_prefix("```") {
            inside = fence == kind;
        } else if inside {
            lines.push(line);
        }
    }
    lines
}

#[test]
fn the_page_quotes_the_golden_bytes() {
    let golden: BTreeMap<_, _> = golden().into_iter().collect();
    let quoted = blocks("frames");
    assert!(quoted.len() >= 20, "only {} frames found in docs/protocol.md", quoted.len());
    for line in quoted {
        let (name, bytes) = parse(line);
        let expected = golden.get(name).unwrap_or_else(|| panic!("there is no golden frame {name}"));
        assert_eq!(hex(&bytes), hex(expected), "{name} in docs/protocol.md");
    }
}

/// What the numbers of the example client stand for; `xtask test` runs it against a board.
#[test]
fn the_example_client_knows_every_fault_and_every_refusal_of_the_joint_servo() {
    let client = include_str!("../../../docs/examples/client.py");
    let between = |from: &str, to: &str| client.split_once(from).unwrap().1.split_once(to).unwrap().0;
    assert_eq!(between("CAUSES = \"\"\"", "\"\"\"").split(';').count(), FaultCause::VARIANTS.len());
    for (list, variants) in [
        ("REFUSALS", Refusal::VARIANTS),
        ("LIMITS", LimitRefusal::VARIANTS),
        ("JOINT_SERVO_REFUSALS", JointServoRefusal::VARIANTS),
    ] {
        let entries = between(&format!("\n{list} = ["), "\n]").matches("\n    (").count();
        assert_eq!(entries, variants.len(), "{list} of docs/examples/client.py");
    }
}

#[test]
fn the_page_is_about_this_version_of_the_messages() {
    let key = format!("`{SCHEMA_KEY:016x}`");
    assert!(
        PAGE.contains(&key),
        "docs/protocol.md describes another version: bring it and oracles/protocol.py up to date, then write the key \
         {key} there"
    );
    for variants in [
        Request::VARIANTS,
        Reply::VARIANTS,
        Stream::VARIANTS,
        Mode::VARIANTS,
        TaskKind::VARIANTS,
        Refusal::VARIANTS,
        LimitRefusal::VARIANTS,
        FaultCause::VARIANTS,
        ServoMode::VARIANTS,
        JointCommand::VARIANTS,
        JointServoRefusal::VARIANTS,
        GraspCommand::VARIANTS,
        InternalForce::VARIANTS,
        ObjectControl::VARIANTS,
        Phase::VARIANTS,
        Failure::VARIANTS,
        GraspRefusal::VARIANTS,
        InvalidPlan::VARIANTS,
        PlanField::VARIANTS,
        ImpedanceCommand::VARIANTS,
        Law::VARIANTS,
        Redundancy::VARIANTS,
        ForceSource::VARIANTS,
        ImpedanceRefusal::VARIANTS,
        InvalidSettings::VARIANTS,
        ImpedanceTerm::VARIANTS,
        SetpointError::VARIANTS,
    ] {
        for (number, variant) in variants.iter().enumerate() {
            let row = format!("| {number} | `{}` |", variant.rsplit(':').next().unwrap());
            assert!(PAGE.contains(&row), "docs/protocol.md has no row {row:?}");
        }
    }
}

/// A node goes through the session of the page and says what the page says.
#[test]
fn the_session_of_the_page_happens_like_that() {
    let messages = messages();
    let mut node = Box::new(Node::new());
    let mut telemetry = 0;
    let mut replies = 0;
    for (name, _) in golden() {
        match &messages[name] {
            Message::Sensors(sensors) if name.contains("-session-") => {
                let actuators = Message::Actuators(node.tick(sensors));
                assert_eq!(actuators, messages[&name.replace("sensors", "actuators")], "{name}");
            }
            Message::Request(frame) if name.contains("-session-") => {
                // The page has a key of its own.
                let mut frame = frame.clone();
                if let Request::Hello { schema } = &mut frame.request {
                    assert_eq!(*schema, SCHEMA);
                    *schema = SCHEMA_KEY;
                }
                let mut reply = node.handle(&frame, &quiet_board());
                if let Reply::Hello { schema, .. } = &mut reply.reply {
                    *schema = SCHEMA;
                }
                let expected = &messages[&name.replace("request", "board")];
                assert_eq!(&Message::Board(FromBoard::Reply(reply)), expected, "{name}");
                replies += 1;
            }
            Message::Board(FromBoard::Telemetry(expected)) if name.contains("-session-") => {
                assert_eq!(&node.telemetry(), expected);
                telemetry += 1;
            }
            _ => {}
        }
    }
    assert_eq!((replies, telemetry), (14, 1));
    assert_eq!(node.robot().unwrap().model(), &finger(Reaction::Hold));
}
