use core::fmt;

use heapless::Vec;
use nalgebra::Vector3;

use crate::math;

/// Maximum number of contacts of a grasp.
pub const MAX_CONTACTS: usize = 6;

/// The forces of a grasp's contacts on the object [N], in the order of the contacts.
pub type ContactForces = Vec<Vector3<f32>, MAX_CONTACTS>;

/// Minimum length of a normal; a shorter one has no direction.
const MIN_NORMAL_LENGTH: f32 = 1e-6;

/// A point contact with Coulomb friction: a normal force that can only push, and tangential forces inside the
/// friction cone. It transmits no moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    pub(super) position: Vector3<f32>,
    pub(super) normal: Vector3<f32>,
    pub(super) friction: f32,
    pub(super) limit: f32,
}

/// Why a [`Contact`] is invalid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InvalidContact {
    /// The position is not finite.
    Position,
    /// The normal is not finite, or 0.
    Normal,
    /// The coefficient of friction is negative or not finite.
    Friction(f32),
    /// The maximum normal force is not positive or not finite.
    Limit(f32),
}

impl Contact {
    /// A contact at `position` [m] with the object's surface, whose normal `normal` points into the object
    /// (of any length), with the coefficient of `friction` and at most `limit` of normal force [N].
    ///
    /// # Errors
    /// The first invalid value.
    pub fn try_new(
        position: Vector3<f32>,
        normal: Vector3<f32>,
        friction: f32,
        limit: f32,
    ) -> Result<Self, InvalidContact> {
        if !(position.x + position.y + position.z).is_finite() {
            return Err(InvalidContact::Position);
        }
        let length = math::norm(&normal);
        if !(length > MIN_NORMAL_LENGTH && length.is_finite()) {
            return Err(InvalidContact::Normal);
        }
        if !(friction >= 0.0 && friction.is_finite()) {
            return Err(InvalidContact::Friction(friction));
        }
        if !(limit > 0.0 && limit.is_finite()) {
            return Err(InvalidContact::Limit(limit));
        }
        Ok(Self { position, normal: normal / length, friction, limit })
    }

    /// Its position [m].
    pub const fn position(&self) -> &Vector3<f32> {
        &self.position
    }

    /// Its normal, a unit vector into the object.
    pub const fn normal(&self) -> &Vector3<f32> {
        &self.normal
    }

    /// Its coefficient of friction.
    pub const fn friction(&self) -> f32 {
        self.friction
    }

    /// The maximum normal force [N].
    pub const fn limit(&self) -> f32 {
        self.limit
    }

    /// The normal component of a `force`, and the magnitude of its tangential part [N].
    #[inline]
    pub(crate) fn components(&self, force: &Vector3<f32>) -> (f32, f32) {
        let normal = self.normal.dot(force);
        (normal, math::norm(&(force - self.normal * normal)))
    }

    /// `force` [N], scaled so that its normal component does not exceed the limit.
    pub fn limited(&self, force: &Vector3<f32>) -> Vector3<f32> {
        let normal = self.normal.dot(force);
        if normal > self.limit { force * (self.limit / normal) } else { *force }
    }
}

impl fmt::Display for InvalidContact {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Position => write!(f, "the position is not finite"),
            Self::Normal => write!(f, "the normal is not finite, or 0"),
            Self::Friction(value) => {
                write!(f, "the coefficient of friction is {value}; it must be finite and not negative")
            }
            Self::Limit(value) => {
                write!(f, "the maximum normal force is {value} N; it must be finite and positive")
            }
        }
    }
}

impl core::error::Error for InvalidContact {}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn invalid_values_are_refused_by_name() {
        let (here, up) = (Vector3::new(0.1, 0.0, 0.2), Vector3::new(0.0, 0.0, 2.0));
        assert_eq!(*Contact::try_new(here, up, 0.0, 1.0).unwrap().normal(), Vector3::z());
        let nan = Vector3::new(0.0, f32::NAN, 0.0);
        assert_eq!(Contact::try_new(nan, up, 0.5, 1.0), Err(InvalidContact::Position));
        assert_eq!(Contact::try_new(here, nan, 0.5, 1.0), Err(InvalidContact::Normal));
        assert_eq!(Contact::try_new(here, Vector3::zeros(), 0.5, 1.0), Err(InvalidContact::Normal));
        assert_eq!(Contact::try_new(here, up, -0.5, 1.0), Err(InvalidContact::Friction(-0.5)));
        assert!(matches!(Contact::try_new(here, up, f32::NAN, 1.0), Err(InvalidContact::Friction(_))));
        assert_eq!(Contact::try_new(here, up, 0.5, 0.0), Err(InvalidContact::Limit(0.0)));
        assert_eq!(Contact::try_new(here, up, 0.5, f32::INFINITY), Err(InvalidContact::Limit(f32::INFINITY)));
    }
}
