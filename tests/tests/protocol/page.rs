//! The examples and the tables of `docs/protocol.md`.

use std::collections::BTreeMap;

use tesaki::control::{ImpedanceAxes, ImpedanceTerm, ServoMode};
use tesaki::fault::FaultCause;
use tesaki::model::Reaction;
use tesaki::node::Node;
use tesaki::protocol::codec::checksum;
use tesaki::protocol::{FromBoard, LogRecord, Mode, Refusal, Reply, Request, SCHEMA_KEY, Stream};
use tesaki::robot::LimitRefusal;
use tesaki::task::TaskKind;
use tesaki::task::grasping::{
    Failure, GraspCommand, GraspRefusal, InternalForce, InvalidPlan, JointTargets, LoadSource, ObjectControl,
    ObjectFrame, Phase, PlanField,
};
use tesaki::task::impedance::{
    ForceSource, ImpedanceCommand, ImpedanceRefusal, InvalidImpedanceSettings, Law, Redundancy, SetpointError,
};
use tesaki::task::joint_servo::{JointCommand, JointServoRefusal};
use tesaki::task::telexistence::{InvalidTelexistenceSettings, TelexistenceCommand, TelexistenceRefusal};
use tesaki::task::visual_approach::{
    GripperState, HandMotion, VisualApproachCommand, VisualApproachField, VisualApproachRefusal,
};
use tesaki::teleop::RetargetField;

use super::golden::{golden, hex, parse};
use super::message::Message;
use super::messages::messages;
use super::values::{SCHEMA, finger, quiet_board};
use super::variants::Variants;

const PAGE: &str = include_str!("../../../docs/protocol.md");

/// Returns the lines of the page's blocks of that kind.
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

/// Returns the rows of the page's tables that begin with a number and a name in code.
fn tables() -> Vec<Vec<(usize, &'static str)>> {
    let mut tables = vec![Vec::new()];
    for line in PAGE.lines() {
        let mut cells = line.split(" | ");
        let number = cells.next().and_then(|cell| cell.strip_prefix("| ")?.parse().ok());
        let name = cells.next().and_then(|cell| cell.strip_prefix('`')?.strip_suffix('`'));
        match number.zip(name) {
            Some(row) => tables.last_mut().unwrap().push(row),
            None => tables.push(Vec::new()),
        }
    }
    tables
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

/// Returns the tables of frames byte by byte: the bytes of each row, on the line and before COBS.
fn frames_by_byte() -> Vec<Vec<[Vec<u8>; 2]>> {
    let mut tables: Vec<Vec<_>> = Vec::new();
    let mut is_inside = false;
    for line in PAGE.lines() {
        if line == "| frame | data | meaning |" {
            tables.push(Vec::new());
            is_inside = true;
        } else if !line.starts_with('|') {
            is_inside = false;
        } else if is_inside && !line.starts_with("|-") {
            let mut cells = line.split('|').skip(1);
            let mut bytes = || {
                let cell = cells.next().unwrap().trim().trim_matches('`');
                cell.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).unwrap()).collect()
            };
            tables.last_mut().unwrap().push([bytes(), bytes()]);
        }
    }
    tables
}

#[test]
fn the_frames_byte_by_byte_are_the_golden_ones_with_cobs_and_crc_undone() {
    let golden: BTreeMap<_, _> = golden().into_iter().collect();
    let tables = frames_by_byte();
    assert_eq!(tables.len(), 2);
    for (rows, name) in tables.iter().zip(["request-session-enable", "board-session-enable"]) {
        let [frame, data] =
            [0, 1].map(|column| rows.iter().flat_map(|row| row[column].clone()).collect::<Vec<_>>());
        assert_eq!(hex(&frame), hex(&golden[name]), "{name}");
        assert_eq!(hex(&cobs::decode_vec(&frame[..frame.len() - 1]).unwrap()), hex(&data), "{name}");
        let (message, crc) = data.split_at(data.len() - 4);
        let quoted = format!("CRC of the eight bytes above, `{:08x}`", checksum(message));
        assert!(PAGE.contains(&quoted) && message.len() == 8, "{name}: {quoted}");
        assert_eq!(crc, checksum(message).to_le_bytes(), "{name}");
        // Each row is a field, so both columns have the same bytes, except for COBS.
        let is_field = |row: &&[Vec<u8>; 2]| !row[1].is_empty() && row[1] != [0];
        assert!(rows.iter().filter(is_field).all(|[frame, data]| frame == data), "{name}");
    }
}

/// The meanings of the example client's numbers; `xtask test` runs it with a board.
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
        "docs/protocol.md describes another version: bring it and oracles/protocol.py up to date, then write \
         the key {key} there"
    );
    let tables = tables();
    for variants in [
        Request::VARIANTS,
        FromBoard::VARIANTS,
        LogRecord::VARIANTS,
        Reaction::VARIANTS,
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
        ObjectFrame::VARIANTS,
        LoadSource::VARIANTS,
        JointTargets::VARIANTS,
        Phase::VARIANTS,
        Failure::VARIANTS,
        GraspRefusal::VARIANTS,
        InvalidPlan::VARIANTS,
        PlanField::VARIANTS,
        ImpedanceCommand::VARIANTS,
        ImpedanceAxes::VARIANTS,
        Law::VARIANTS,
        Redundancy::VARIANTS,
        ForceSource::VARIANTS,
        ImpedanceRefusal::VARIANTS,
        InvalidImpedanceSettings::VARIANTS,
        ImpedanceTerm::VARIANTS,
        SetpointError::VARIANTS,
        TelexistenceCommand::VARIANTS,
        TelexistenceRefusal::VARIANTS,
        InvalidTelexistenceSettings::VARIANTS,
        RetargetField::VARIANTS,
        VisualApproachCommand::VARIANTS,
        HandMotion::VARIANTS,
        GripperState::VARIANTS,
        VisualApproachRefusal::VARIANTS,
        VisualApproachField::VARIANTS,
    ] {
        let variants = variants.iter().map(|variant| variant.rsplit(':').next().unwrap());
        let rows: Vec<_> = variants.enumerate().collect();
        assert!(tables.contains(&rows), "docs/protocol.md has no table of {rows:?}");
    }
}

/// A node runs through the session of the page and answers as shown.
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
                // The page has its own key.
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
