use postcard_schema::schema::{DataModelType, DataModelVariant, NamedType, NamedValue};

use crate::fault::MAX_FAULTS;
use crate::model::{MAX_CHAINS, MAX_JOINTS, MAX_NAME};

/// Maximum number of entries of a list of bounded length in a model or a state.
const MAX_LIST: usize = {
    let longest = if MAX_JOINTS > MAX_FAULTS { MAX_JOINTS } else { MAX_FAULTS };
    if longest > MAX_CHAINS { longest } else { MAX_CHAINS }
};

/// Bytes of the varint of a number with this many bits.
const fn varint(bits: usize) -> usize {
    bits.div_ceil(7)
}

/// The longest postcard encoding of a model or a state in bytes, from its schema, so that buffer sizes follow
/// from the types at compile time.
///
/// A schema does not contain the capacities of lists and strings: each counts as the longest in a model or a
/// state. Types whose encoding has no bound are a compile-time error.
pub const fn longest(of: &NamedType) -> usize {
    match of.ty {
        DataModelType::Bool | DataModelType::U8 | DataModelType::I8 => 1,
        DataModelType::U16 | DataModelType::I16 => varint(16),
        DataModelType::U32 | DataModelType::I32 => varint(32),
        DataModelType::U64 | DataModelType::I64 => varint(64),
        DataModelType::F32 => 4,
        DataModelType::F64 => 8,
        DataModelType::String => 1 + MAX_NAME,
        DataModelType::Unit | DataModelType::UnitStruct => 0,
        DataModelType::Option(inner) => 1 + longest(inner),
        DataModelType::NewtypeStruct(inner) => longest(inner),
        DataModelType::Seq(inner) => 1 + MAX_LIST * longest(inner),
        DataModelType::Tuple(types) | DataModelType::TupleStruct(types) => sum(types),
        DataModelType::Struct(fields) => fields_sum(fields),
        DataModelType::Enum(variants) => {
            let (mut max, mut index) = (0, 0);
            while index < variants.len() {
                let size = match variants[index].ty {
                    DataModelVariant::UnitVariant => 0,
                    DataModelVariant::NewtypeVariant(inner) => longest(inner),
                    DataModelVariant::TupleVariant(types) => sum(types),
                    DataModelVariant::StructVariant(fields) => fields_sum(fields),
                };
                max = if size > max { size } else { max };
                index += 1;
            }
            1 + max
        }
        _ => panic!("the encoding of this type has no bound"),
    }
}

const fn sum(types: &[&NamedType]) -> usize {
    let (mut sum, mut index) = (0, 0);
    while index < types.len() {
        sum += longest(types[index]);
        index += 1;
    }
    sum
}

const fn fields_sum(fields: &[&NamedValue]) -> usize {
    let (mut sum, mut index) = (0, 0);
    while index < fields.len() {
        sum += longest(fields[index].ty);
        index += 1;
    }
    sum
}

// The length of a list fits a byte, and so does that of a name.
const _: () = assert!(MAX_LIST < 128 && MAX_NAME < 128);

#[cfg(test)]
mod tests {
    use super::*;
    use heapless::{String, Vec};
    use postcard_schema::Schema;
    use serde::Serialize;

    #[derive(Serialize, Schema)]
    enum Choice {
        Small(u8),
        Large { number: i32, flag: Option<bool> },
    }

    #[derive(Serialize, Schema)]
    struct Everything {
        name: String<MAX_NAME>,
        numbers: [u32; 3],
        list: Vec<(i16, f32), MAX_JOINTS>,
        choice: Choice,
    }

    /// By hand: 1 + 32, 3 · 5, 1 + 16 · (3 + 4), 1 + (5 + 1 + 1); the longest value has exactly that length.
    #[test]
    fn bound_is_that_of_the_longest_value() {
        let mut name = String::new();
        (0..MAX_NAME).for_each(|_| name.push('n').expect("room"));
        let list = (0..MAX_JOINTS).map(|_| (i16::MIN, 1.0)).collect();
        let choice = Choice::Large { number: i32::MIN, flag: Some(true) };
        let value = Everything { name, numbers: [u32::MAX; 3], list, choice };
        assert_eq!(longest(Everything::SCHEMA), 33 + 15 + 113 + 8);
        assert_eq!(postcard::to_stdvec(&value).expect("plain").len(), 33 + 15 + 113 + 8);
        assert!(postcard::to_stdvec(&Choice::Small(1)).expect("plain").len() < 8);
    }
}
