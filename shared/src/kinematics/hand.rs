use core::fmt;

use heapless::Vec;
use nalgebra::{SVector, Vector3};

use super::{Chain, Posture};
use crate::math::{self, abs};
use crate::model::{ChainJoint, Coupling, JointModel, MAX_CHAIN_JOINTS, MAX_CHAINS, MAX_JOINTS, RobotModel};

/// Maximum number of fingers of a [`Hand`].
pub const MAX_FINGERS: usize = 5;

/// Angles of all actuated joints of a robot [rad].
pub type Angles = SVector<f32, MAX_JOINTS>;

/// The angle of `joint`; 0 if there is no such joint.
#[inline]
pub(super) fn angle(angles: &Angles, joint: u8) -> f32 {
    angles.as_slice().get(usize::from(joint)).copied().unwrap_or(0.0)
}

/// Sets the angle of `joint`, if there is such a joint.
#[inline]
pub(super) fn set_angle(angles: &mut Angles, joint: u8, value: f32) {
    if let Some(angle) = angles.as_mut_slice().get_mut(usize::from(joint)) {
        *angle = value;
    }
}

/// A finger: a chain, and the coupling of each of its joints.
#[derive(Clone, Debug)]
pub(super) struct HandFinger {
    /// Its chain, coupled joints included.
    pub(super) chain: Chain,
    /// Couplings of its joints, base to tip; the actuated joint is an index into `variables`.
    pub(super) joints: Vec<Coupling, MAX_CHAIN_JOINTS>,
    /// The actuated joints that move this finger; the shared one, if it is among them, is the last.
    pub(super) variables: Vec<u8, MAX_CHAIN_JOINTS>,
    /// The range of each of them.
    pub(super) ranges: Vec<Range, MAX_CHAIN_JOINTS>,
    /// Whether the last of `variables` also moves other fingers.
    pub(super) shares: bool,
    /// Direction in which the fingertip points, in the frame of the last link; a unit vector.
    pub(super) pointing: Vector3<f32>,
    /// Length of the stretched finger behind its first joint [m].
    pub(super) length: f32,
}

/// The range of an actuated joint [rad].
#[derive(Clone, Copy, Debug)]
pub(super) struct Range {
    pub(super) lower: f32,
    pub(super) upper: f32,
    pub(super) center: f32,
}

/// The posture of a finger, as needed by the inverse kinematics.
#[derive(Clone, Debug, Default)]
pub(super) struct FingerPosture {
    /// Axis (unit vector) and origin of each joint of the chain; origins relative to the first joint [m].
    pub(super) joints: [(Vector3<f32>, Vector3<f32>); MAX_CHAIN_JOINTS],
    /// Position of the tip relative to the first joint [m].
    pub(super) reach: Vector3<f32>,
    /// Direction in which the tip points, if requested.
    pub(super) pointing: Vector3<f32>,
}

/// Fingers on a common palm: serial chains, several of which may share one actuated joint, such as the
/// actuator that spreads the fingers of a hand. A validated configuration without state.
#[derive(Clone, Debug)]
pub struct Hand {
    pub(super) fingers: Vec<HandFinger, MAX_FINGERS>,
    /// Lower and upper limit of each actuated joint [rad], narrowed to what the coupled joints allow.
    pub(super) limits: Vec<(f32, f32), MAX_JOINTS>,
    /// The actuated joint that moves more than one finger.
    pub(super) shared: Option<u8>,
}

/// Why there is no [`Hand`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InvalidHand {
    /// No finger, or more than [`MAX_FINGERS`].
    Fingers,
    /// More actuated joints than a robot can have.
    TooMany,
    /// A limit is not finite, or the lower one is not below the upper one.
    Limits {
        /// The actuated joint.
        joint: u8,
    },
    /// A finger without joints, or with another number of couplings than joints.
    Couplings {
        /// The finger.
        finger: u8,
    },
    /// A coupling to a joint that does not exist, with a multiplier of 0, or with a multiplier or offset that
    /// is not finite.
    Coupling {
        /// The finger.
        finger: u8,
        /// The joint of its chain.
        joint: u8,
    },
    /// A coupled joint leaves its actuated joint no angle within the limits of both.
    CoupledLimits {
        /// The finger.
        finger: u8,
        /// The joint of its chain.
        joint: u8,
    },
    /// A second joint moves more than one finger: only one can.
    Shared {
        /// The actuated joint.
        joint: u8,
    },
    /// The direction of a fingertip is not a unit vector.
    Pointing {
        /// The finger.
        finger: u8,
    },
}

/// Description of one finger of a [`Hand`].
#[derive(Clone, Debug)]
pub struct FingerDescription<'a> {
    /// The chain, base to tip, coupled joints included, in the frame of the hand.
    pub chain: Chain,
    /// Coupling of each of its joints.
    pub couplings: &'a [Coupling],
    /// Limits of the coupled joints [rad], one entry for each joint of the chain; `None` where only the
    /// limits of the actuated joint apply.
    pub limits: &'a [Option<(f32, f32)>],
    /// Direction in which the fingertip points, in the tip's frame; a unit vector.
    pub pointing: [f32; 3],
}

impl Hand {
    /// The hand of `fingers` whose actuated joints have `limits` [rad].
    ///
    /// # Errors
    /// The first problem, with finger and joint.
    pub fn try_new<'a>(
        fingers: impl IntoIterator<Item = FingerDescription<'a>>,
        limits: &[(f32, f32)],
    ) -> Result<Self, InvalidHand> {
        let limits: Vec<(f32, f32), MAX_JOINTS> =
            Vec::from_slice(limits).map_err(|_| InvalidHand::TooMany)?;
        for (joint, (lower, upper)) in (0..).zip(&limits) {
            if !(lower.is_finite() && upper.is_finite() && lower < upper) {
                return Err(InvalidHand::Limits { joint });
            }
        }
        let mut hand = Self { fingers: Vec::new(), limits, shared: None };
        for (index, finger) in (0..).zip(fingers) {
            let finger = hand.finger(index, finger)?;
            hand.fingers.push(finger).map_err(|_| InvalidHand::Fingers)?;
        }
        if hand.fingers.is_empty() {
            return Err(InvalidHand::Fingers);
        }
        hand.find_shared()?;
        let Self { fingers, limits, .. } = &mut hand;
        for finger in fingers {
            let range = |joint: &u8| {
                let (lower, upper) = *limits.get(usize::from(*joint))?;
                Some(Range { lower, upper, center: 0.5 * (lower + upper) })
            };
            finger.ranges = finger.variables.iter().filter_map(range).collect();
        }
        Ok(hand)
    }

    /// The hand whose fingers are the chains of a validated model, in its order, with the thumb first for
    /// [retargeting](crate::teleop::Retargeting). `pointing`:
    /// direction of the fingertips in their frames, a unit vector. Its actuated joints stay inside the
    /// model's limits by `margin` [rad], or by a quarter of their range.
    ///
    /// # Errors
    /// There are more than [`MAX_FINGERS`] chains, or two joints that move several of them.
    pub fn of_model(model: &RobotModel, pointing: [f32; 3], margin: f32) -> Result<Self, InvalidHand> {
        let mut couplings: Vec<Vec<Coupling, MAX_CHAIN_JOINTS>, MAX_CHAINS> = Vec::new();
        for chain in 0..model.chains.len() {
            // A validated model has no more chains.
            let _ = couplings.push(model.joints_of(chain).map(ChainJoint::coupling).collect());
        }
        let range = |joint: &JointModel| {
            let (lower, upper) = (joint.limits.lower, joint.limits.upper);
            let margin = margin.min(0.25 * (upper - lower));
            (lower + margin, upper - margin)
        };
        let limits: Vec<(f32, f32), MAX_JOINTS> = model.joints.iter().map(range).collect();
        let fingers = couplings.iter().enumerate().map(|(chain, couplings)| FingerDescription {
            chain: Chain::of_model(model, chain),
            couplings,
            limits: [None; MAX_CHAIN_JOINTS].get(..couplings.len()).unwrap_or_default(),
            pointing,
        });
        Self::try_new(fingers, &limits)
    }

    /// Checks one finger and narrows the limits of its actuated joints.
    fn finger(&mut self, index: u8, finger: FingerDescription<'_>) -> Result<HandFinger, InvalidHand> {
        let FingerDescription { chain, couplings, limits, pointing } = finger;
        let pointing = Vector3::from(pointing);
        if abs(pointing.norm_squared() - 1.0).is_nan() || abs(pointing.norm_squared() - 1.0) > 1e-3 {
            return Err(InvalidHand::Pointing { finger: index });
        }
        if chain.is_empty() || chain.len() != couplings.len() || chain.len() != limits.len() {
            return Err(InvalidHand::Couplings { finger: index });
        }
        let (mut joints, mut variables) = (Vec::new(), Vec::<u8, MAX_CHAIN_JOINTS>::new());
        for (joint, (coupling, limit)) in (0..).zip(couplings.iter().zip(limits)) {
            let Coupling { actuated, multiplier, offset } = *coupling;
            let known = self.limits.get_mut(usize::from(actuated));
            let finite = multiplier.is_finite() && multiplier != 0.0 && offset.is_finite();
            let Some((lower, upper)) = known.filter(|_| finite) else {
                return Err(InvalidHand::Coupling { finger: index, joint });
            };
            if let Some((low, high)) = limit {
                let ends = [(low - offset) / multiplier, (high - offset) / multiplier];
                *lower = lower.max(ends[0].min(ends[1]));
                *upper = upper.min(ends[0].max(ends[1]));
                // Rejects NaN as well.
                if !(*lower < *upper && low <= high) {
                    return Err(InvalidHand::CoupledLimits { finger: index, joint });
                }
            }
            let slot = variables.iter().position(|&known| known == actuated).unwrap_or(variables.len());
            if slot == variables.len() {
                // Neither list can overflow: a chain has no more joints.
                let _ = variables.push(actuated);
            }
            #[expect(clippy::cast_possible_truncation, reason = "at most 7")]
            let _ = joints.push(Coupling { actuated: slot as u8, multiplier, offset });
        }
        let behind = chain.links.iter().skip(1).map(|link| &link.translation);
        let lengths = behind.chain([&chain.tip.translation.vector]).map(math::norm);
        let length = lengths.sum();
        let pointing = chain.tip.rotation * pointing;
        Ok(HandFinger { chain, joints, variables, ranges: Vec::new(), shares: false, pointing, length })
    }

    /// Finds the joint that moves more than one finger, and puts it last among the variables of each.
    fn find_shared(&mut self) -> Result<(), InvalidHand> {
        for joint in (0..).take(self.limits.len()) {
            let users = self.fingers.iter().filter(|finger| finger.variables.contains(&joint)).count();
            if users > 1 && self.shared.is_some() {
                return Err(InvalidHand::Shared { joint });
            }
            if users > 1 {
                self.shared = Some(joint);
            }
        }
        let Some(shared) = self.shared else { return Ok(()) };
        for finger in &mut self.fingers {
            let Some(slot) = finger.variables.iter().position(|&joint| joint == shared) else { continue };
            finger.shares = true;
            let last = finger.variables.len() - 1;
            finger.variables.swap(slot, last);
            for joint in &mut finger.joints {
                let own = usize::from(joint.actuated);
                #[expect(clippy::cast_possible_truncation, reason = "at most 7")]
                if own == slot {
                    joint.actuated = last as u8;
                } else if own == last {
                    joint.actuated = slot as u8;
                }
            }
        }
        Ok(())
    }

    /// Number of fingers.
    pub fn len(&self) -> usize {
        self.fingers.len()
    }

    /// Whether it has no finger: never.
    pub fn is_empty(&self) -> bool {
        self.fingers.is_empty()
    }

    /// Limits of the actuated joints [rad], narrowed to what the coupled joints allow.
    pub fn limits(&self) -> &[(f32, f32)] {
        &self.limits
    }

    /// The actuated joint that moves more than one finger.
    pub const fn shared(&self) -> Option<u8> {
        self.shared
    }

    /// The actuated joints that move a finger.
    pub fn actuated(&self, finger: usize) -> &[u8] {
        self.fingers.get(finger).map_or(&[], |finger| &finger.variables)
    }

    /// The posture of a finger at the angles of the actuated joints; `None` if there is no such finger.
    pub fn posture(&self, finger: usize, angles: &Angles) -> Option<Posture> {
        let finger = self.fingers.get(finger)?;
        Some(finger.chain.posture(&finger.angles(angles)))
    }

    /// Position of a fingertip [m] and the direction in which it points; `None` if there is no such finger.
    pub fn tip(&self, finger: usize, angles: &Angles) -> Option<(Vector3<f32>, Vector3<f32>)> {
        let finger = self.fingers.get(finger)?;
        let mut posture = FingerPosture::default();
        finger.update_posture(angles, true, &mut posture);
        Some((finger.chain.base() + posture.reach, posture.pointing))
    }

    /// The middle of the limits [rad].
    pub fn center(&self) -> Angles {
        let mut center = Angles::zeros();
        for (angle, (lower, upper)) in center.iter_mut().zip(&self.limits) {
            *angle = 0.5 * (lower + upper);
        }
        center
    }

    /// Limits angles to their ranges.
    pub fn limit(&self, angles: &mut Angles) {
        for (angle, &(lower, upper)) in angles.iter_mut().zip(&self.limits) {
            *angle = math::clamp(*angle, lower, upper);
        }
    }
}

impl HandFinger {
    /// Number of actuated joints that move this finger alone; they are the first of `variables`.
    #[inline]
    pub(super) fn own(&self) -> usize {
        self.variables.len() - usize::from(self.shares)
    }

    /// The angles of the joints of its chain at those of the actuated joints [rad].
    #[inline(always)]
    fn angles(&self, actuated: &Angles) -> [f32; MAX_CHAIN_JOINTS] {
        let mut own = [0.0; MAX_CHAIN_JOINTS];
        for (angle, joint) in own.iter_mut().zip(&self.joints) {
            let variable = self.variables.get(usize::from(joint.actuated));
            let actuated = variable.and_then(|&variable| actuated.get(usize::from(variable)));
            *angle = joint.angle(actuated.copied().unwrap_or(0.0));
        }
        own
    }

    /// Updates the posture for `angles` [rad] of the actuated joints; its pointing direction only if
    /// `directed`.
    pub(super) fn update_posture(&self, angles: &Angles, directed: bool, posture: &mut FingerPosture) {
        let FingerPosture { joints, reach, pointing } = posture;
        let mut places = joints.iter_mut();
        let rotation;
        (*reach, rotation) = self
            .chain
            .forward(&self.angles(angles), |joint| places.next().map(|place| *place = joint).is_some());
        if directed {
            *pointing = rotation * self.pointing;
        }
    }
}

impl fmt::Display for InvalidHand {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Fingers => write!(f, "a hand has 1 to {MAX_FINGERS} fingers"),
            Self::TooMany => write!(f, "a hand has at most {MAX_JOINTS} actuated joints"),
            Self::Limits { joint } => {
                write!(f, "actuated joint {joint}: limits must be finite, the lower one below the upper one")
            }
            Self::Couplings { finger } => {
                write!(f, "finger {finger}: it needs joints, and one coupling and limit for each")
            }
            Self::Coupling { finger, joint } => write!(
                f,
                "finger {finger}, joint {joint}: it must follow an actuated joint, by finite numbers and a \
                 multiplier that is not 0"
            ),
            Self::CoupledLimits { finger, joint } => write!(
                f,
                "finger {finger}, joint {joint}: its limits, and those of the joint that moves it, leave no angle"
            ),
            Self::Shared { joint } => {
                write!(f, "actuated joint {joint}: a second joint that moves several fingers; only one can")
            }
            Self::Pointing { finger } => {
                write!(f, "finger {finger}: the direction of its tip must be a unit vector")
            }
        }
    }
}

impl core::error::Error for InvalidHand {}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::indexing_slicing, clippy::cast_possible_truncation, reason = "tests")]
#[path = "hand_tests.rs"]
mod tests;
