//! Purposes of random numbers.

use tesaki_rng::Rng;

/// Purpose of a random number. Each purpose has a separate stream, so that a new use never shifts the numbers
/// of another. The discriminants are part of every recorded seed: never reuse one.
#[derive(Clone, Copy)]
pub(crate) enum Purpose {
    Factors = 0,
    Homing = 1,
    PowerOn = 2,
    Noise = 3,
    Contact = 4,
    ForceSensors = 5,
    ForceNoise = 6,
    Placement = 7,
    HandMotion = 8,
    Tremor = 9,
    MasterArm = 10,
    ElbowSensor = 11,
    Link = 12,
    OperatorHand = 13,
    FingersMotion = 14,
    Glove = 15,
    FingertipMarkers = 16,
    Pinches = 17,
    HandPostures = 18,
    DoorScene = 19,
    Optics = 20,
    HandView = 21,
    ImageNoise = 22,
    CircleSearch = 23,
    CalibrationViews = 24,
    BasePlace = 25,
    Windings = 26,
    HandleSensor = 27,
}

impl Purpose {
    /// Creates the random numbers of a seed for this purpose.
    pub(crate) fn rng(self, seed: u64) -> Rng {
        Rng::new(seed, self as u64)
    }
}
