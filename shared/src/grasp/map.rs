use core::fmt;

use heapless::Vec;
use nalgebra::{SMatrix, Vector3, Vector6};

use super::{Contact, ContactForces, MAX_CONTACTS};
use crate::math::{self, halves, stack};

/// The grasp map `G`, moments in [N·m] about the grasp's origin: `w = G f`. Three columns per contact;
/// columns beyond the contacts are 0.
pub type GraspMatrix = SMatrix<f32, 6, { 3 * MAX_CONTACTS }>;

/// Contacts closer than this fraction of their mean distance from the centroid coincide.
const COINCIDENT: f32 = 1e-3;

/// The contacts of a grasp and the linear map between their forces and the wrench on the object.
///
/// For point contacts `G = [I … I; r₁^ … rₙ^]`, `D_oᵀ` of (Hand3 eq. 17). A wrench is `[force;
/// moment]`, a twist is `[v; ω]`, both about one `origin` and in the axes in which the contacts are given.
#[derive(Clone, Debug)]
pub struct GraspMap {
    pub(super) contacts: Vec<Contact, MAX_CONTACTS>,
    /// Positions relative to the centroid over `length`.
    pub(super) levers: ContactForces,
    /// The centroid, from the origin [m].
    pub(super) center: Vector3<f32>,
    /// The root mean square distance of the contacts from their centroid [m].
    pub(super) length: f32,
    origin: Vector3<f32>,
}

/// Why contacts have no grasp map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GraspMapError {
    /// The number of contacts is not 2 to [`MAX_CONTACTS`].
    Contacts(usize),
    /// The origin is not finite.
    Origin,
    /// Two contacts coincide.
    Coincident {
        /// Their indices.
        first: u8,
        /// See `first`.
        second: u8,
        /// Their distance [m].
        distance: f32,
    },
}

impl GraspMap {
    /// The grasp of 2 to 6 `contacts`, with wrenches and twists about `origin` [m].
    ///
    /// # Errors
    /// The contacts have no grasp map.
    pub fn try_new(contacts: &[Contact], origin: Vector3<f32>) -> Result<Self, GraspMapError> {
        let count = contacts.len();
        let contacts = match Vec::from_slice(contacts) {
            Ok(contacts) if count >= 2 => contacts,
            _ => return Err(GraspMapError::Contacts(count)),
        };
        if !(origin.x + origin.y + origin.z).is_finite() {
            return Err(GraspMapError::Origin);
        }
        #[expect(clippy::cast_precision_loss, reason = "2 to 6")]
        let inverse_count = 1.0 / count as f32;
        // Relative to the origin, so that a distant base costs no significant digits.
        let mut center = Vector3::zeros();
        contacts.iter().for_each(|contact| center += contact.position - origin);
        center *= inverse_count;
        let mut levers = ContactForces::new();
        let mut square = 0.0;
        for contact in &contacts {
            let lever = contact.position - origin - center;
            square += lever.norm_squared();
            let _ = levers.push(lever); // cannot fail: same capacity
        }
        let length = math::sqrt(square * inverse_count);
        let inverse = if length > f32::MIN_POSITIVE { 1.0 / length } else { 0.0 };
        levers.iter_mut().for_each(|lever| *lever *= inverse);
        for (second, lever) in (0_u8..).zip(&levers) {
            for (first, other) in (0..second).zip(&levers) {
                let square = (lever - other).norm_squared();
                if square < COINCIDENT * COINCIDENT || square.is_nan() {
                    let distance = math::sqrt(square) * length;
                    return Err(GraspMapError::Coincident { first, second, distance });
                }
            }
        }
        Ok(Self { contacts, levers, center, length, origin })
    }

    /// The contacts.
    pub fn contacts(&self) -> &[Contact] {
        &self.contacts
    }

    /// Reference point of wrenches and twists [m].
    pub const fn origin(&self) -> &Vector3<f32> {
        &self.origin
    }

    /// The length by which moments are divided wherever forces and moments are compared [m]: the root mean
    /// square distance of the contacts from their centroid.
    pub const fn length(&self) -> f32 {
        self.length
    }

    /// `G` [1; m], 6 × 3n.
    pub fn matrix(&self) -> GraspMatrix {
        let mut matrix = GraspMatrix::zeros();
        for (index, contact) in self.contacts.iter().enumerate().take(MAX_CONTACTS) {
            let lever = (contact.position - self.origin).cross_matrix();
            matrix.fixed_view_mut::<3, 3>(0, 3 * index).fill_with_identity();
            matrix.fixed_view_mut::<3, 3>(3, 3 * index).copy_from(&lever);
        }
        matrix
    }

    /// `w = G f` [N; N·m]: the wrench of the contacts' `forces` [N] on the object, (Hand3 eq. 17). Missing
    /// forces count as 0.
    pub fn wrench(&self, forces: &[Vector3<f32>]) -> Vector6<f32> {
        let (mut force, mut moment) = (Vector3::zeros(), Vector3::zeros());
        for (contact, contact_force) in self.contacts.iter().zip(forces) {
            force += contact_force;
            moment += (contact.position - self.origin).cross(contact_force);
        }
        stack([force, moment])
    }

    /// `Gᵀ V` [m/s]: the velocities of the contacts' points on an object that moves with `twist` [m/s;
    /// rad/s], the right side of (Hand3 eq. 13).
    pub fn velocities(&self, twist: &Vector6<f32>) -> ContactForces {
        let [linear, angular] = halves(twist);
        let velocity = |contact: &Contact| linear + angular.cross(&(contact.position - self.origin));
        self.contacts.iter().map(velocity).collect()
    }

    /// Force and moment about the centroid, the moment over `length` [N].
    pub(super) fn scaled(&self, wrench: &Vector6<f32>) -> (Vector3<f32>, Vector3<f32>) {
        let [force, moment] = halves(wrench);
        (force, (moment - self.center.cross(&force)) / self.length)
    }

    /// Wrench of the contacts' forces [N], scaled like [`Self::scaled`].
    pub(super) fn scaled_sum(&self, forces: &[Vector3<f32>]) -> (Vector3<f32>, Vector3<f32>) {
        let (mut force, mut moment) = (Vector3::zeros(), Vector3::zeros());
        for (lever, contact_force) in self.levers.iter().zip(forces) {
            force += contact_force;
            moment += lever.cross(contact_force);
        }
        (force, moment)
    }
}

impl fmt::Display for GraspMapError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Contacts(count) => write!(f, "{count} contacts; a grasp has 2 to {MAX_CONTACTS}"),
            Self::Origin => write!(f, "the origin is not finite"),
            Self::Coincident { first, second, distance } => {
                write!(f, "contacts {first} and {second} coincide: their distance is {distance} m")
            }
        }
    }
}

impl core::error::Error for GraspMapError {}
