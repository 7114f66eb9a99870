//! Transfer and validation of a model.

use heapless::Vec;

use super::rig::{Rig, model, refusal};
use crate::model::{Field, ModelError, Problem, RobotModel};
use crate::protocol::{BoardStatus, MODEL_CHUNK, Refusal, Reply, Request, RequestFrame, codec};

#[test]
fn invalid_models_are_refused_by_joint_and_field() {
    type Change = fn(&mut RobotModel);
    let cases: &[(Change, Option<u8>, Field)] = &[
        (|m| m.joints[1].link.mass = -0.1, Some(1), Field::Mass),
        (|m| m.joints[2].link.inertia[0] = -1e-6, Some(2), Field::Inertia),
        (|m| m.joints[2].link.inertia = [1.0, 1.0, 3.0, 0.0, 0.0, 0.0], Some(2), Field::Inertia),
        (|m| m.joints[0].limits.upper = -2.0, Some(0), Field::LimitUpper),
        (|m| m.joints[0].axis = [0.0; 3], Some(0), Field::Axis),
        (|m| m.joints[0].motor.torque_constant = f32::NAN, Some(0), Field::TorqueConstant),
        (|m| m.joints[1].name = "base".try_into().unwrap(), Some(1), Field::Name),
        (|m| m.joints[1].name = "\u{1b}[2J".try_into().unwrap(), Some(1), Field::Name),
        (|m| m.name = "a\nb".try_into().unwrap(), None, Field::Name),
        (|m| m.chains[0].name = "tip\u{7}".try_into().unwrap(), Some(2), Field::ChainName),
        (|m| m.chains[0].joints = 4, None, Field::Chains),
        (|m| m.chains[0].joints = 8, None, Field::Chains),
        (|m| m.joints.clear(), None, Field::Joints),
        (|m| m.safety.supply_max = 10.0, None, Field::SupplyMax),
    ];
    for (change, joint, field) in cases {
        let mut rig = Rig::ready(&model());
        let mut invalid = model();
        change(&mut invalid);
        let Refusal::Model(error) = refusal(rig.push(&invalid)) else { panic!("{field:?}") };
        assert_eq!((error.joint, error.field), (*joint, *field));
        // The old model remains in use.
        assert_eq!(rig.enable(), Reply::Done);
    }
    let mut negative = model();
    negative.joints[0].limits.upper = -2.0;
    let error = negative.validate().unwrap_err();
    assert_eq!((error.value, error.problem), (-2.0, Problem::NotAbove(-1.5)));
    assert_eq!(error.to_string(), "joint 0: limits.upper = -2 must be above -1.5");
}

#[test]
fn a_fault_of_before_a_push_is_not_told_of_another_joint() {
    let mut rig = Rig::enabled(&model());
    rig.sensors.encoders[2] += 10_000;
    rig.tick();
    let joint = |rig: &Rig| rig.node.faults().faults.last().unwrap().joint;
    rig.clear_faults();
    let mut stiffer = model();
    stiffer.joints[2].limits.velocity = 5.0;
    assert_eq!(rig.push(&stiffer), Reply::Done);
    assert_eq!(joint(&rig), Some(2), "the same joints");
    let mut other = model();
    other.joints[2].name = "another".try_into().unwrap();
    assert_eq!(rig.push(&other), Reply::Done);
    assert_eq!((joint(&rig), rig.node.faults().total), (None, 1));
    // After a reset the joint is known only if the joints are unchanged.
    for (pushed, known) in [(&stiffer, Some(2)), (&other, None)] {
        let mut rig = Rig::enabled(&model());
        rig.sensors.encoders[2] += 10_000;
        rig.tick();
        let (log, joints) = (rig.node.faults().clone(), rig.node.fault_joints());
        let mut reset = Rig::new();
        reset.node.restore_faults(log, joints);
        reset.command();
        assert_eq!(joint(&reset), Some(2), "by its number, while there is no model");
        assert_eq!(reset.push(pushed), Reply::Done);
        assert_eq!((joint(&reset), reset.node.faults().total), (known, 1));
    }
}

#[test]
fn a_model_that_the_board_cannot_serve_is_refused_with_the_boards_reason() {
    let mut rig = Rig::ready(&model());
    let bytes = postcard::to_stdvec(&model()).unwrap();
    let length = bytes.len() as u32;
    rig.ask(Request::ModelBegin { length, checksum: codec::checksum(&bytes) });
    for (index, data) in bytes.chunks(MODEL_CHUNK).enumerate() {
        let data = Vec::from_slice(data).unwrap();
        assert_eq!(rig.ask(Request::ModelChunk { offset: (index * MODEL_CHUNK) as u32, data }), Reply::Done);
    }
    let two_motors = |model: &RobotModel| {
        assert_eq!(model.joints.len(), 3);
        let problem = Problem::BoardLimit(2.0);
        Err(ModelError { joint: Some(2), field: Field::Joints, value: 3.0, problem })
    };
    rig.sequence += 1;
    let commit = RequestFrame { client: rig.client, sequence: rig.sequence, request: Request::ModelCommit };
    let reply = rig.node.handle_on(&commit, &BoardStatus::default(), &mut { two_motors }).reply;
    let Refusal::Model(error) = refusal(reply) else { panic!() };
    assert_eq!(error.to_string(), "joint 2: joints = 3 is more than this board can do: 2");
    // The old model remains in use.
    assert_eq!(rig.enable(), Reply::Done);
}

#[test]
fn damaged_and_incomplete_transfers_are_refused() {
    let mut rig = Rig::ready(&model());
    let bytes = postcard::to_stdvec(&model()).unwrap();
    let chunk = |offset: usize| Request::ModelChunk {
        offset: offset as u32,
        data: Vec::from_slice(&bytes[offset..(offset + MODEL_CHUNK).min(bytes.len())]).unwrap(),
    };
    let length = bytes.len() as u32;
    let wrong_checksum = codec::checksum(&bytes) ^ 4;
    rig.ask(Request::ModelBegin { length, checksum: wrong_checksum });
    assert_eq!(rig.ask(chunk(0)), Reply::Done);
    assert!(matches!(refusal(rig.ask(chunk(2 * MODEL_CHUNK))), Refusal::ModelTransfer { received: 192, .. }));
    assert_eq!(rig.ask(chunk(0)), Reply::Done, "a repeated chunk is accepted");
    assert!(matches!(refusal(rig.ask(Request::ModelCommit)), Refusal::ModelTransfer { received: 192, .. }));
    for offset in (MODEL_CHUNK..bytes.len()).step_by(MODEL_CHUNK) {
        assert_eq!(rig.ask(chunk(offset)), Reply::Done);
    }
    assert!(matches!(refusal(rig.ask(Request::ModelCommit)), Refusal::ModelChecksum { .. }));
    assert!(matches!(
        refusal(rig.ask(Request::ModelBegin { length: 100_000, checksum: 0 })),
        Refusal::ModelUnreadable { length: 100_000, .. }
    ));
}

#[test]
fn a_joint_with_an_unchanged_encoder_stays_homed_through_a_change_of_the_model() {
    let mut relative = model();
    relative.joints.iter_mut().for_each(|joint| joint.encoder.relative = true);
    let mut rig = Rig::ready(&relative);
    rig.ask(Request::Home { positions: Vec::from_slice(&[0.1, 0.2, 0.3]).unwrap() });
    relative.joints[0].servo.pid.proportional *= 2.0;
    relative.joints[2].encoder.counts_per_turn *= 2.0;
    assert_eq!(rig.push(&relative), Reply::Done);
    rig.tick();
    assert_eq!(rig.node.status(&BoardStatus::default()).node.homed, 0b011);
    assert!((rig.node.telemetry().joints[1].position - 0.2).abs() < 1e-4);
    assert_eq!(refusal(rig.enable()), Refusal::NotHomed { joint: 2 });
}
