use thiserror::Error;

/// Why a plant cannot be built or driven.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum PlantError {
    /// A file of the robot cannot be used.
    #[error(transparent)]
    File(#[from] tesaki_description::FileError),
    /// A value of `plant.toml` or of the options is invalid.
    #[error("{field} is {value}: it must be {expected}")]
    Value {
        /// Table and key, as in the file.
        field: String,
        /// The value.
        value: f64,
        /// The allowed values.
        expected: &'static str,
    },
    /// A joint of a type that the plant does not simulate.
    #[error("joint {joint:?} is of type {kind}: use revolute (with limits), continuous or fixed joints")]
    JointType {
        /// The joint.
        joint: String,
        /// Its type.
        kind: String,
    },
    /// A joint whose axis has no direction.
    #[error("joint {joint:?} has the axis {axis:?}: give it a direction, such as \"0 0 1\"")]
    Axis {
        /// The joint.
        joint: String,
        /// Its axis.
        axis: [f64; 3],
    },
    /// A joint whose lower limit is not below its upper limit.
    #[error("joint {joint:?} has the limits {lower} to {upper} rad: `lower` must be below `upper`")]
    Limits {
        /// The joint.
        joint: String,
        /// Lower limit [rad].
        lower: f64,
        /// Upper limit [rad].
        upper: f64,
    },
    /// A moving link without a mass.
    #[error(
        "link {link:?}, moved by joint {joint:?}, has no mass, nor has anything fixed to it: \
         give it an <inertial> with a mass above 0"
    )]
    NoMass {
        /// The link.
        link: String,
        /// The joint that moves it.
        joint: String,
    },
    /// A moving link with a physically impossible inertia.
    #[error(
        "link {link:?}, moved by joint {joint:?}, has principal moments of inertia {moments:?} kg·m²: \
         each must be above 0 and at most the sum of the other two; check its <inertia>"
    )]
    Inertia {
        /// The link.
        link: String,
        /// The joint that moves it.
        joint: String,
        /// Principal moments about the centre of mass, with everything that is fixed to the link [kg·m²].
        moments: [f64; 3],
    },
    /// A joint of the URDF without a drive, or a drive or posture for a joint that does not exist.
    #[error("{item} names the joint {joint:?}, which {place} does not have; it has: {known}")]
    UnknownJoint {
        /// The item that names it.
        item: &'static str,
        /// The joint.
        joint: String,
        /// The place that should have it.
        place: &'static str,
        /// The joints that exist.
        known: String,
    },
    /// A tip that must touch an object but has no sphere.
    #[error("link {0:?} must touch an object but has no <sphere>: give it one, or remove the object")]
    NoSphere(String),
    /// Fixed bodies, but no link that can touch them.
    #[error(
        "there are fixtures, but no moving link has a <collision> with a box, cylinder or sphere: \
         give the hand one, or remove the fixtures"
    )]
    NoCollision,
    /// An object and fixed bodies, which the plant does not simulate together.
    #[error("there are an object and fixtures: a plant simulates only one of them; remove the other")]
    ObjectAndFixtures,
    /// A tip that the robot does not have.
    #[error("there is no tip number {tip}: the robot has {tips}, counted from 0")]
    NoTip {
        /// The requested tip.
        tip: usize,
        /// The number of tips.
        tips: usize,
    },
    /// Two drives for one joint.
    #[error("joint {0:?} has two drives: give it one")]
    TwoDrives(String),
    /// A list with the wrong number of joints.
    #[error("{item} has {got} joints and the plant has {expected}")]
    Count {
        /// The list.
        item: &'static str,
        /// Its length.
        got: usize,
        /// The plant's number of joints.
        expected: usize,
    },
    /// A torque that is not a number.
    #[error("the torque for joint {joint:?} is {torque}: a plant takes finite torques only")]
    NotFinite {
        /// The joint.
        joint: String,
        /// The torque [N·m].
        torque: f32,
    },
}

/// Checks that all `values` are `good`.
pub(super) fn check(
    field: &str,
    values: &[f64],
    good: impl Fn(f64) -> bool,
    expected: &'static str,
) -> Result<(), PlantError> {
    match values.iter().find(|&&value| !good(value)) {
        Some(&value) => Err(PlantError::Value { field: field.to_owned(), value, expected }),
        None => Ok(()),
    }
}
