use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// An [`Option`] whose `None` is all zero. A `None` in a niche of `T` may not be, and one nonzero byte would
/// move the whole node from `.bss` to `.data`, which also takes flash.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
#[repr(u8)]
pub(super) enum Optional<T> {
    /// Nothing.
    #[default]
    None,
    /// A value.
    Some(T),
}

impl<T> Optional<T> {
    /// As an [`Option`].
    pub fn get(self) -> Option<T> {
        match self {
            Self::None => None,
            Self::Some(value) => Some(value),
        }
    }
}

impl<T> From<Option<T>> for Optional<T> {
    fn from(value: Option<T>) -> Self {
        value.map_or(Self::None, Self::Some)
    }
}
