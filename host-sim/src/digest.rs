//! A digest of all answers of a controller in a run, which detects any change of its behaviour.

use std::fmt::Display;

use serde::ser::{self, Impossible, Serialize, Serializer};
use sha2::{Digest, Sha256};
use tesaki::protocol::{ActuatorFrame, Reply};

/// SHA-256 over all actuator frames and replies of a run, in order.
///
/// Only *values* are hashed: numbers bit by bit (every NaN as the same), flags, lengths of lists, positions
/// of plain variants. Names, and the enum variants that wrap values, are not. So a renamed field, or a reply
/// that is sent in another message, does not change the digest, but a torque that differs in its last bit
/// does. Replies that depend on where the controller ran are excluded ([`Reply::Hello`], [`Reply::Status`],
/// exports), and so are [`Reply::Done`], whose effects show in the frames, and replies to requests that
/// nobody waits for.
#[derive(Clone, Debug, Default)]
pub struct FramesDigest(Sha256);

impl FramesDigest {
    /// Adds an actuator frame.
    pub fn frame(&mut self, frame: &ActuatorFrame) {
        self.add(0, frame);
    }

    /// Adds a reply, if it depends on the control core alone.
    pub fn reply(&mut self, reply: &Reply) {
        match reply {
            Reply::Hello { .. }
            | Reply::Status(_)
            | Reply::Exported { .. }
            | Reply::Chunk { .. }
            | Reply::Done => {}
            Reply::Refused(refusal) => self.add(2, refusal),
            other => self.add(3, other),
        }
    }

    /// The digest so far, as hexadecimal digits.
    pub fn hex(&self) -> String {
        format!("{:x}", self.0.clone().finalize())
    }

    fn add(&mut self, kind: u8, value: &impl Serialize) {
        self.0.update([kind]);
        value.serialize(Values(&mut self.0)).expect("the protocol's types are plain values");
    }
}

/// Hashes the values of whatever is serialised into it.
struct Values<'a>(&'a mut Sha256);

impl Values<'_> {
    fn each(&mut self, value: &(impl Serialize + ?Sized)) -> Result<(), Unsupported> {
        value.serialize(Values(self.0))
    }
}

/// A type that the protocol does not use.
#[derive(Debug, thiserror::Error)]
#[error("cannot hash this: {0}")]
struct Unsupported(String);

impl ser::Error for Unsupported {
    fn custom<T: Display>(text: T) -> Self {
        Self(text.to_string())
    }
}

/// Methods that hash a number by its bytes.
macro_rules! numbers {
    ($($method:ident: $ty:ty),*) => {
        $(fn $method(self, value: $ty) -> Result<(), Unsupported> {
            self.0.update(value.to_le_bytes());
            Ok(())
        })*
    };
}

impl<'a> Serializer for Values<'a> {
    type Ok = ();
    type Error = Unsupported;
    type SerializeSeq = Self;
    type SerializeTuple = Self;
    type SerializeTupleStruct = Self;
    type SerializeTupleVariant = Self;
    type SerializeMap = Impossible<(), Unsupported>;
    type SerializeStruct = Self;
    type SerializeStructVariant = Self;

    numbers!(serialize_i8: i8, serialize_i16: i16, serialize_i32: i32, serialize_i64: i64);
    numbers!(serialize_u8: u8, serialize_u16: u16, serialize_u32: u32, serialize_u64: u64);

    fn serialize_bool(self, value: bool) -> Result<(), Unsupported> {
        self.serialize_u8(value.into())
    }

    fn serialize_f32(self, value: f32) -> Result<(), Unsupported> {
        let value = if value.is_nan() { f32::NAN } else { value };
        self.serialize_u32(value.to_bits())
    }

    fn serialize_f64(self, value: f64) -> Result<(), Unsupported> {
        let value = if value.is_nan() { f64::NAN } else { value };
        self.serialize_u64(value.to_bits())
    }

    fn serialize_char(self, value: char) -> Result<(), Unsupported> {
        self.serialize_u32(value.into())
    }

    fn serialize_str(self, value: &str) -> Result<(), Unsupported> {
        self.serialize_bytes(value.as_bytes())
    }

    fn serialize_bytes(self, value: &[u8]) -> Result<(), Unsupported> {
        self.0.update((value.len() as u64).to_le_bytes());
        self.0.update(value);
        Ok(())
    }

    fn serialize_none(self) -> Result<(), Unsupported> {
        self.serialize_u8(0)
    }

    fn serialize_some<T: Serialize + ?Sized>(mut self, value: &T) -> Result<(), Unsupported> {
        self.0.update([1]);
        self.each(value)
    }

    fn serialize_unit(self) -> Result<(), Unsupported> {
        Ok(())
    }

    fn serialize_unit_struct(self, _: &'static str) -> Result<(), Unsupported> {
        Ok(())
    }

    fn serialize_unit_variant(self, _: &'static str, index: u32, _: &'static str) -> Result<(), Unsupported> {
        self.serialize_u32(index)
    }

    fn serialize_newtype_struct<T: Serialize + ?Sized>(
        mut self,
        _: &'static str,
        value: &T,
    ) -> Result<(), Unsupported> {
        self.each(value)
    }

    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        mut self,
        _: &'static str,
        _: u32,
        _: &'static str,
        value: &T,
    ) -> Result<(), Unsupported> {
        self.each(value)
    }

    fn serialize_seq(self, length: Option<usize>) -> Result<Self, Unsupported> {
        self.0.update((length.unwrap_or(usize::MAX) as u64).to_le_bytes());
        Ok(self)
    }

    fn serialize_tuple(self, _: usize) -> Result<Self, Unsupported> {
        Ok(self)
    }

    fn serialize_tuple_struct(self, _: &'static str, _: usize) -> Result<Self, Unsupported> {
        Ok(self)
    }

    fn serialize_tuple_variant(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self, Unsupported> {
        Ok(self)
    }

    fn serialize_map(self, _: Option<usize>) -> Result<Self::SerializeMap, Unsupported> {
        Err(ser::Error::custom("a map"))
    }

    fn serialize_struct(self, _: &'static str, _: usize) -> Result<Self, Unsupported> {
        Ok(self)
    }

    fn serialize_struct_variant(
        self,
        _: &'static str,
        _: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self, Unsupported> {
        Ok(self)
    }
}

/// Serialises the parts of a compound value, one after the other.
macro_rules! parts {
    ($($part:ident $method:ident ($($name:ident)?)),*) => {
        $(impl ser::$part for Values<'_> {
            type Ok = ();
            type Error = Unsupported;

            fn $method<T: Serialize + ?Sized>(
                &mut self,
                $($name: &'static str,)?
                value: &T,
            ) -> Result<(), Unsupported> {
                $(let _ = $name;)?
                self.each(value)
            }

            fn end(self) -> Result<(), Unsupported> {
                Ok(())
            }
        })*
    };
}

parts! {
    SerializeSeq serialize_element (),
    SerializeTuple serialize_element (),
    SerializeTupleStruct serialize_field (),
    SerializeTupleVariant serialize_field (),
    SerializeStruct serialize_field (name),
    SerializeStructVariant serialize_field (name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tesaki::protocol::Refusal;
    use tesaki::robot::LimitRefusal;

    fn frame(torques: &[f32]) -> ActuatorFrame {
        ActuatorFrame { sequence: 7, enabled: true, torques: torques.iter().copied().collect() }
    }

    fn digest(frame: &ActuatorFrame) -> String {
        let mut digest = FramesDigest::default();
        digest.frame(frame);
        digest.hex()
    }

    #[test]
    fn the_last_bit_of_a_torque_counts_and_where_the_controller_ran_does_not() {
        let one = frame(&[0.5, -0.25]);
        let other = frame(&[0.5, f32::from_bits((-0.25_f32).to_bits() + 1)]);
        assert_eq!(digest(&one), digest(&one.clone()));
        assert_ne!(digest(&one), digest(&other));
        assert_ne!(digest(&one), digest(&frame(&[0.5])));

        let mut hello = FramesDigest::default();
        hello.frame(&one);
        hello.reply(&Reply::Hello { schema: 1, identity: tesaki::protocol::Identity::default() });
        assert_eq!(hello.hex(), digest(&one));
        hello.reply(&Reply::Done);
        assert_eq!(hello.hex(), digest(&one));
        hello.reply(&Reply::Refused(Refusal::NoModel));
        assert_ne!(hello.hex(), digest(&one));
    }

    /// Computed by hand: kind 0, sequence 7, enabled, one torque of 1.0; then kind 2 and the refused joint 3
    /// with its numbers.
    #[test]
    fn values_are_hashed_without_names_and_wrappers() {
        let mut digest = FramesDigest::default();
        digest.frame(&frame(&[1.0]));
        digest.reply(&Reply::Refused(Refusal::Limit(LimitRefusal::TooFast {
            joint: 3,
            value: 2.0,
            limit: f32::NAN,
        })));
        let mut bytes = vec![0, 7, 0, 0, 0, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0x80, 0x3f];
        bytes.extend([2, 3, 0, 0, 0, 0x40, 0, 0, 0xc0, 0x7f]);
        assert_eq!(digest.hex(), format!("{:x}", Sha256::digest(&bytes)));
    }
}
