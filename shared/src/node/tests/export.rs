//! Exports of the model and of the state.

use super::force_sensors::SENSOR;
use super::rig::{Rig, model, refusal};
use crate::fault::{Fault, FaultCause};
use crate::model::{MAX_CHAINS, MAX_JOINTS};
use crate::node::export::Export;
use crate::node::force_sensor::ForceSensorState;
use crate::node::joint::JointState;
use crate::node::{MAX_MODEL, MAX_STATE, STATE_KEY};
use crate::protocol::{Item, Refusal, Reply, Request, SCHEMA_KEY};

#[test]
fn an_export_has_the_bytes_and_the_length_of_its_item() {
    let mut rig = Rig::ready(&model());
    let (bytes, _) = rig.export(Item::Model);
    assert_eq!(bytes, postcard::to_stdvec(&model()).unwrap());
    let length = bytes.len() as u32;
    let beyond = Request::ReadExport { offset: length };
    assert_eq!(refusal(rig.ask(beyond)), Refusal::NotExported { length });
    let Reply::Chunk { data, .. } = rig.ask(Request::ReadExport { offset: length - 5 }) else { panic!() };
    assert_eq!(data, bytes[bytes.len() - 5..]);
    let mut empty = Rig::new();
    empty.command();
    assert_eq!(refusal(empty.ask(Request::ReadExport { offset: 0 })), Refusal::NotExported { length: 0 });
    assert_eq!(refusal(empty.ask(Request::Export(Item::Model))), Refusal::NoModel);
}

/// The longest encoding: full lists, and numbers with the longest varints.
#[test]
fn the_largest_state_and_the_largest_model_can_be_exported() {
    let mut rig = Rig::ready(&model());
    let node = &mut rig.node;
    node.state.joints = [JointState::extreme(); MAX_JOINTS];
    node.state.force_sensors = [ForceSensorState::extreme(); MAX_CHAINS];
    for _ in 0..20 {
        let (joint, value) = (Some(15), f32::MIN);
        node.record_fault(Fault { cause: FaultCause::Stop, joint, value, limit: value, tick: u32::MAX });
    }
    let length = postcard::to_stdvec(&node.state).unwrap().len();
    assert!(length > 2500 && length <= MAX_STATE, "{length} of {MAX_STATE}");
    let (bytes, _) = rig.export(Item::State);
    assert_eq!(bytes.len(), postcard::to_stdvec(&rig.node.state).unwrap().len());

    let mut largest = model();
    largest.chains.clear();
    for chain in 0..MAX_CHAINS {
        let mut copy = model().chains[0].clone();
        copy.name = format!("chain-{chain:-<26}").as_str().try_into().unwrap();
        copy.force_sensor = Some(SENSOR);
        largest.chains.push(copy).unwrap();
    }
    let joint = largest.joints[0].clone();
    largest.joints.clear();
    for index in 0..MAX_JOINTS {
        let mut copy = joint.clone();
        copy.name = format!("joint-{index:-<26}").as_str().try_into().unwrap();
        copy.encoder.zero = i32::MIN;
        largest.joints.push(copy).unwrap();
    }
    let length = postcard::to_stdvec(&largest).unwrap().len();
    assert!(length > 2000 && length <= MAX_MODEL, "{length} of {MAX_MODEL}");
}

#[test]
fn an_export_longer_than_the_buffer_is_refused() {
    let mut export = Export::new();
    let long = std::vec![1_u8; MAX_STATE.max(MAX_MODEL) + 1];
    assert_eq!(export.begin(&long, 0, 0), Err(Refusal::NotExported { length: 0 }));
    assert_eq!(export.chunk(0), Err(Refusal::NotExported { length: 0 }));
}

#[test]
fn an_export_names_the_key_of_its_layout() {
    let mut rig = Rig::ready(&model());
    let Reply::Exported { key, .. } = rig.ask(Request::Export(Item::State)) else { panic!() };
    assert_eq!(key, STATE_KEY);
    assert_ne!(STATE_KEY, SCHEMA_KEY);
    let Reply::Exported { key, .. } = rig.ask(Request::Export(Item::Model)) else { panic!() };
    assert_eq!(key, SCHEMA_KEY);
}
