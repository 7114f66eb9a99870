use core::fmt;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// A value outside its range.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct OutOfRange<F = &'static str> {
    /// What has the value.
    pub field: F,
    /// The value, in the unit of the field.
    pub value: f32,
    /// Minimum.
    pub min: f32,
    /// Maximum.
    pub max: f32,
}

impl<F> OutOfRange<F> {
    /// Checks that `value` is from `min` to `max`; NaN is outside.
    ///
    /// # Errors
    /// The value, if it is outside.
    pub fn check(field: F, value: f32, [min, max]: [f32; 2]) -> Result<(), Self> {
        if (min..=max).contains(&value) { Ok(()) } else { Err(Self { field, value, min, max }) }
    }
}

impl<F: fmt::Display> fmt::Display for OutOfRange<F> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { field, value, min, max } = self;
        write!(f, "{field} is {value}; it must be {min} to {max}")
    }
}

impl<F: fmt::Debug + fmt::Display> core::error::Error for OutOfRange<F> {}
