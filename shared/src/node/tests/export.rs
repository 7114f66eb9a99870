//! Exports of the model and of the state.

use postcard_schema::Schema;
use postcard_schema::schema::{DataModelType, DataModelVariant, NamedType};

use super::bench::{Bench, model, refusal};
use crate::control::JointPoint;
use crate::model::{MAX_JOINTS, Reaction};
use crate::node::{JointState, MAX_STATE, Node, State};
use crate::protocol::{Fault, FaultCause, Item, Refusal, Reply, Request, Task};

#[test]
fn exports_are_whole_and_end_where_they_end() {
    let mut bench = Bench::ready(&model());
    let (bytes, _) = bench.export(Item::Model);
    assert_eq!(bytes, postcard::to_stdvec(&model()).unwrap());
    let length = bytes.len() as u32;
    let beyond = Request::ReadExport { offset: length };
    assert_eq!(refusal(bench.ask(beyond)), Refusal::NotExported { length });
    let Reply::Chunk { data, .. } = bench.ask(Request::ReadExport { offset: length - 5 }) else { panic!() };
    assert_eq!(data, bytes[bytes.len() - 5..]);
    let mut empty = Bench::new();
    empty.command();
    assert_eq!(refusal(empty.ask(Request::ReadExport { offset: 0 })), Refusal::NotExported { length: 0 });
    assert_eq!(refusal(empty.ask(Request::Export(Item::Model))), Refusal::NoModel);
}

#[test]
fn the_largest_state_can_be_exported() {
    let mut node = Node::new();
    let extreme = JointState::extreme();
    node.state.joints = [extreme; MAX_JOINTS];
    for _ in 0..20 {
        let (joint, value) = (Some(15), f32::MIN);
        node.record_fault(Fault { cause: FaultCause::Stop, joint, value, limit: value, tick: u32::MAX });
    }
    let length = postcard::to_stdvec(&node.state).unwrap().len();
    let longest = longest(State::SCHEMA);
    assert!(length < longest && longest <= MAX_STATE, "{length} {longest}");
    // Nothing is missing in what the types say.
    assert_eq!(longest_after(&Some(Reaction::Hold)), 2);
    assert_eq!(longest_after(&[JointPoint { position: 0.0, velocity: 0.0, acceleration: 0.0 }; 2]), 24);
    assert_eq!(longest_after(&Task::Grasp), 2);
    assert_eq!(longest_after(&crate::arm::tests::SOFT), 18 * 4 + 1 + 2 + 5 + 4 * 4);
    assert_eq!(longest_after(&(u32::MAX, u16::MAX, i32::MIN, true)), 5 + 3 + 5 + 1);
}

/// The longest encoding of the value's type, which is no shorter than the value's.
fn longest_after<T: Schema + serde::Serialize>(value: &T) -> usize {
    let longest = longest(T::SCHEMA);
    assert!(postcard::to_stdvec(value).unwrap().len() <= longest);
    longest
}

/// Most bytes that a value of a type takes; no list of a state has more than sixteen elements.
fn longest(of: &NamedType) -> usize {
    let fields = |fields: &[&postcard_schema::schema::NamedValue]| -> usize {
        fields.iter().map(|field| longest(field.ty)).sum()
    };
    let all = |types: &[&NamedType]| -> usize { types.iter().map(|of| longest(of)).sum() };
    match of.ty {
        DataModelType::Bool | DataModelType::U8 | DataModelType::I8 => 1,
        DataModelType::U16 | DataModelType::I16 => 3,
        DataModelType::U32 | DataModelType::I32 => 5,
        DataModelType::U64 | DataModelType::I64 => 10,
        DataModelType::F32 => 4,
        DataModelType::Unit | DataModelType::UnitStruct => 0,
        DataModelType::Option(of) => 1 + longest(of),
        DataModelType::NewtypeStruct(of) => longest(of),
        DataModelType::Seq(of) => 1 + 16 * longest(of),
        DataModelType::Tuple(types) | DataModelType::TupleStruct(types) => all(types),
        DataModelType::Struct(values) => fields(values),
        DataModelType::Enum(variants) => {
            let longest = |variant: &&postcard_schema::schema::NamedVariant| match variant.ty {
                DataModelVariant::UnitVariant => 0,
                DataModelVariant::NewtypeVariant(of) => longest(of),
                DataModelVariant::TupleVariant(types) => all(types),
                DataModelVariant::StructVariant(values) => fields(values),
            };
            1 + variants.iter().map(longest).max().unwrap_or(0)
        }
        other => panic!("a state has no {other:?}"),
    }
}
