use core::fmt;

use heapless::Vec;
use nalgebra::{IsometryMatrix3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::Posture;
use crate::math;
use crate::model::{AXIS_TOLERANCE, ChainJoint, Inertial, JointModel, MAX_CHAIN_JOINTS, Pose, RobotModel};

/// A serial chain of revolute joints with its mass distribution, preprocessed for computation.
///
/// Internally each joint frame is rotated so that its axis is z; a joint rotation then takes four
/// multiplications per vector. This is invisible from outside.
#[derive(Clone, Debug)]
pub struct Chain {
    pub(crate) links: Vec<Link, MAX_CHAIN_JOINTS>,
    /// The tip's frame in that of the last link.
    pub(crate) tip: IsometryMatrix3<f32>,
    /// Reflected inertia of each joint's rotor and gear [kg·m²]; empty if not included.
    pub(crate) rotor_inertia: Vec<f32, MAX_CHAIN_JOINTS>,
}

/// Why [`Chain::from_links`] returns no chain.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum InvalidChain {
    /// More links than a chain can have.
    TooMany,
    /// An axis is not a unit vector.
    Axis {
        /// The joint.
        joint: usize,
        /// Length of its axis.
        length: f32,
    },
}

impl fmt::Display for InvalidChain {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TooMany => write!(f, "a chain has at most {MAX_CHAIN_JOINTS} joints"),
            Self::Axis { joint, length } => {
                write!(f, "the axis of joint {joint} has length {length}; it must be a unit vector")
            }
        }
    }
}

impl core::error::Error for InvalidChain {}

/// One joint and its link; all in the link's own frame (joint axis z) unless stated.
#[derive(Clone, Debug)]
pub(crate) struct Link {
    /// Orientation of the joint frame at angle 0 in the frame of the link before it.
    pub rotation: Matrix3<f32>,
    /// Whether that is the identity, as between parallel axes.
    pub is_aligned: bool,
    /// Its origin there [m].
    pub translation: Vector3<f32>,
    /// Mass [kg].
    pub mass: f32,
    /// Centre of mass [m].
    pub center_of_mass: Vector3<f32>,
    /// Inertia about the centre of mass [kg·m²].
    pub inertia: Matrix3<f32>,
}

impl Link {
    /// Transforms `rotation` from the orientation of the link before to that of this link at `angle` [rad].
    #[inline(always)]
    pub fn turn(&self, rotation: &mut Matrix3<f32>, angle: f32) {
        if !self.is_aligned {
            *rotation = math::product(rotation, &self.rotation);
        }
        turn_about_z(rotation, angle);
    }
}

/// Rotates a frame about its own z by `angle` [rad].
#[inline(always)]
fn turn_about_z(rotation: &mut Matrix3<f32>, angle: f32) {
    let (sine, cosine) = math::sin_cos(angle);
    let (x, y) = (rotation.column(0).into_owned(), rotation.column(1).into_owned());
    rotation.set_column(0, &(x * cosine + y * sine));
    rotation.set_column(1, &(y * cosine - x * sine));
}

impl Chain {
    /// The chain of `joints`, base to tip, of a validated model; at most [`MAX_CHAIN_JOINTS`]. `tip`: the
    /// tip's frame in that of the last link. Without the rotors, which
    /// [`JointServo`](crate::control::JointServo) includes itself; [`Chain::with_rotor_inertia`] adds them.
    pub fn new(joints: &[JointModel], tip: &Pose) -> Self {
        Self::of_links(joints.iter().map(|joint| (&joint.origin, &joint.axis, &joint.link)), tip)
    }

    /// A chain of a validated model with all its joints, including those without motor; empty if the model
    /// has no such chain.
    pub fn of_model(model: &RobotModel, chain: usize) -> Self {
        let tip = model.chains.get(chain).map_or(&Pose::IDENTITY, |chain| &chain.tip);
        Self::of_links(model.joints_of(chain).map(ChainJoint::body), tip)
    }

    /// The chain of links given as in [`JointModel`]: joint frame in the frame of the link before, axis (a
    /// unit vector), mass distribution. `tip` as in [`Chain::new`].
    ///
    /// # Errors
    /// More than [`MAX_CHAIN_JOINTS`] links, or an axis that is not a unit vector.
    pub fn from_links<'a>(
        links: impl IntoIterator<Item = (&'a Pose, &'a [f32; 3], &'a Inertial), IntoIter: Clone>,
        tip: &Pose,
    ) -> Result<Self, InvalidChain> {
        let links = links.into_iter();
        for (joint, (_, axis, _)) in links.clone().enumerate() {
            if joint == MAX_CHAIN_JOINTS {
                return Err(InvalidChain::TooMany);
            }
            let length = math::norm(&Vector3::from(*axis));
            if length.is_nan() || math::abs(length - 1.0) > AXIS_TOLERANCE {
                return Err(InvalidChain::Axis { joint, length });
            }
        }
        Ok(Self::of_links(links, tip))
    }

    /// As [`Chain::from_links`], of at most [`MAX_CHAIN_JOINTS`] valid links.
    pub(crate) fn of_links<'a>(
        links: impl IntoIterator<Item = (&'a Pose, &'a [f32; 3], &'a Inertial)>,
        tip: &Pose,
    ) -> Self {
        let mut own = Vec::new();
        // Transforms vectors from the previous link's frame in the model to the frame used here.
        let mut previous = Matrix3::identity();
        for (origin, axis, inertial) in links {
            // The model's joint frame → the frame with z along the axis.
            let to_axis = align_with_z(&Vector3::from(*axis));
            let inertia = inertial.tensor();
            let rotation = previous * rotation(origin).matrix() * to_axis.transpose();
            let link = Link {
                rotation,
                is_aligned: rotation == Matrix3::identity(),
                translation: previous * Vector3::from(origin.translation),
                mass: inertial.mass,
                center_of_mass: to_axis * Vector3::from(inertial.center_of_mass),
                inertia: to_axis * inertia * to_axis.transpose(),
            };
            if own.push(link).is_err() {
                break; // a validated model has no longer chain
            }
            previous = to_axis;
        }
        let translation = Translation3::from(previous * Vector3::from(tip.translation));
        let rotation = Rotation3::from_matrix_unchecked(previous) * rotation(tip);
        Self {
            links: own,
            tip: IsometryMatrix3::from_parts(translation, rotation),
            rotor_inertia: Vec::new(),
        }
    }

    /// Adds the reflected inertia of rotor and gear [kg·m²] of each joint
    /// ([`Motor::rotor_inertia`](crate::model::Motor::rotor_inertia)) to the diagonal of the mass matrix.
    /// Gyroscopic effects of the rotors are neglected, as usual for large gear ratios.
    #[must_use]
    pub fn with_rotor_inertia(self, inertias: impl IntoIterator<Item = f32>) -> Self {
        Self { rotor_inertia: inertias.into_iter().take(self.links.len()).collect(), ..self }
    }

    /// Forward kinematics at angles `q` [rad]. Missing angles count as 0.
    pub fn posture(&self, q: &[f32]) -> Posture {
        let mut joints = Vec::new();
        // Cannot fail: there are no more links than places.
        let (reach, rotation) = self.forward(q, |joint| joints.push(joint).is_ok());
        Posture { joints, reach, tip: self.tip_frame(&reach, &rotation) }
    }

    /// [`Chain::posture`] in place: overwrites any posture, and avoids a move of 230 bytes.
    pub fn update_posture(&self, q: &[f32], posture: &mut Posture) {
        let Posture { joints, reach, tip } = posture;
        joints.clear();
        let rotation;
        (*reach, rotation) = self.forward(q, |joint| joints.push(joint).is_ok());
        *tip = self.tip_frame(reach, &rotation);
    }

    /// Calls `write` with axis and origin of each joint, base to tip; origins are relative to the first one.
    /// Returns the position of the tip, also relative to it, and the orientation of the last link.
    #[inline(always)]
    pub(super) fn forward(
        &self,
        q: &[f32],
        mut write: impl FnMut((Vector3<f32>, Vector3<f32>)) -> bool,
    ) -> (Vector3<f32>, Matrix3<f32>) {
        let (mut rotation, mut origin) = (Matrix3::identity(), Vector3::zeros());
        let mut links = self.links.iter().enumerate();
        let angle = |index: usize| q.get(index).copied().unwrap_or(0.0);
        if let Some((index, link)) = links.next() {
            rotation = link.rotation;
            turn_about_z(&mut rotation, angle(index));
            write((rotation.column(2).into_owned(), origin));
        }
        for (index, link) in links {
            origin += rotation * link.translation;
            link.turn(&mut rotation, angle(index));
            write((rotation.column(2).into_owned(), origin));
        }
        (origin + rotation * self.tip.translation.vector, rotation)
    }

    /// Origin of the first joint [m].
    pub(super) fn base(&self) -> Vector3<f32> {
        self.links.first().map_or_else(Vector3::zeros, |link| link.translation)
    }

    #[inline(always)]
    fn tip_frame(&self, reach: &Vector3<f32>, rotation: &Matrix3<f32>) -> IsometryMatrix3<f32> {
        let translation = Translation3::from(self.base() + reach);
        let rotation = Rotation3::from_matrix_unchecked(rotation * self.tip.rotation.matrix());
        IsometryMatrix3::from_parts(translation, rotation)
    }

    /// Number of joints.
    pub fn len(&self) -> usize {
        self.links.len()
    }

    /// Whether the chain has no joint.
    pub fn is_empty(&self) -> bool {
        self.links.is_empty()
    }
}

fn rotation(pose: &Pose) -> Rotation3<f32> {
    UnitQuaternion::from_quaternion(math::quaternion(pose.rotation)).to_rotation_matrix()
}

/// A rotation that maps the unit vector `axis` to z.
fn align_with_z(axis: &Vector3<f32>) -> Matrix3<f32> {
    // Rodrigues' formula with sin = |axis × z| and cos = axis · z; no angle is computed, so small ones keep
    // their significant digits.
    let rotation = |axis: &Vector3<f32>| {
        let cross = axis.cross(&Vector3::z()).cross_matrix();
        Matrix3::identity() + cross + cross * cross / (1.0 + axis.z)
    };
    if axis.z < 0.0 {
        // Rotate by π about x first: the formula is singular at −z.
        let half_turn = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
        rotation(&(half_turn * axis)) * half_turn
    } else {
        rotation(axis)
    }
}
