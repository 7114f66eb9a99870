use core::fmt;

use nalgebra::{Vector3, Vector6};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::PerFinger;
use crate::control::ServoMode;
use crate::grasp::{InvalidContact, Contact, GraspMap, GripState, LeastGrip, GraspMapError, GripError, NormalGripError};

/// Friction assumed of contacts where it is to be felt, until then.
pub(super) const ASSUMED_FRICTION: f32 = 0.4;
/// The largest wrench that may remain of forces along the normals, over the forces.
pub(super) const NORMAL_TOLERANCE: f32 = 0.1;

/// What to grasp, where, and how.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct GraspPlan {
    /// Where the fingers are to touch, as far as known.
    pub contacts: PerFinger<PlannedContact>,
    /// How far in front of it a fingertip begins to feel for the surface, and how far behind it gives up [m].
    pub clearance: f32,
    /// A normal force that means contact [N].
    pub touch_force: f32,
    /// Coefficient of friction; `None`: the hand finds out by rubbing.
    pub friction: Option<f32>,
    /// How hard to grip.
    pub internal: InternalForce,
    /// Most force of a fingertip along the normal [N].
    pub force_limit: f32,
    /// Whether internal forces are corrected by the force sensors.
    pub feedback: bool,
    /// How the object is moved.
    pub control: ObjectControl,
}

/// Where a finger is to touch.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct PlannedContact {
    /// A point of the surface, in the base frame [m].
    pub position: [f32; 3],
    /// The surface's normal there, into the object; of any length.
    pub normal: [f32; 3],
}

/// The forces of the fingers against each other.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum InternalForce {
    /// 0: as little as holds the load ([`LeastGrip`]).
    Least {
        /// Share of the friction that stays unused.
        margin: f32,
        /// What each finger can hold along the surface at least, while the object is held still and while it is moved [N]: a
        /// load may grow by so much before the grip must, and joints that begin to move press by their friction more or
        /// less than they should. It presses with at least that over the coefficient of friction.
        least: f32,
        /// See `least`.
        moving: f32,
    },
    /// 1: along the normals (Hand3, section 5.3): the paper's form with one degree of freedom.
    Normal {
        /// The largest of the normal forces [N].
        strength: f32,
    },
    /// 2: between each two contacts, Hand3 (18): the form with three degrees of freedom.
    Pairwise {
        /// Of contacts 2 and 3, 1 and 3, 1 and 2 [N].
        strengths: [f32; 3],
    },
}

/// How an object is moved.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum ObjectControl {
    /// 0: the object's motion becomes that of the joints (Hand3 (21) to (25)), which their servos follow.
    Differential(ServoMode),
    /// 1: proportional and integral control of the object's pose gives the wrench on it, and damping of the joints (Hand3
    /// (19), (20)).
    Wrench(WrenchGains),
}

/// Gains of [`ObjectControl::Wrench`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct WrenchGains {
    /// Proportional and integral gain of the position [N/m, N/(m·s)].
    pub position: [f32; 2],
    /// Proportional and integral gain of the orientation [N·m/rad, N·m/(rad·s)].
    pub orientation: [f32; 2],
    /// Damping of the joints [N·m·s/rad].
    pub damping: f32,
    /// Whether weight and friction of the fingers are fed forward; the paper does not.
    pub compensated: bool,
}

/// What the supervisor asks of a hand.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum GraspCommand {
    /// 0: approach, touch, grasp and hold.
    Grasp(GraspPlan),
    /// 1: bring the object to where it is so far from where it was grasped.
    Move {
        /// Of the object frame's origin, in base axes [m].
        translation: [f32; 3],
        /// About the object frame's origin: rotation vector in base axes [rad].
        rotation: [f32; 3],
        /// Within this time [s].
        duration: f32,
    },
    /// 2: lower the object until something carries it, and let go.
    PutDown,
    /// 3: let go, here and now; on the way to an object: go back from it.
    Open,
}

/// Why a plan is none.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum InvalidPlan {
    /// 0: a number outside of what makes sense.
    Value {
        /// Which.
        field: PlanField,
        /// As given.
        value: f32,
        /// Smallest.
        lower: f32,
        /// Largest.
        upper: f32,
    },
    /// 1: the position or the normal of a contact is not finite, or the normal has no length.
    Contact {
        /// The finger, 0 to 2.
        finger: u8,
    },
    /// 2: two contacts are at the same place, or all are in line.
    NoTriangle,
    /// 3: no forces inside the friction cones balance each other: the normals point the same way, or past each other.
    CannotGrip,
    /// 4: forces along the normals do not balance.
    Unbalanced {
        /// What remains, over the forces.
        rest: f32,
    },
}

/// A number of a [`GraspPlan`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PlanField {
    /// 0
    Clearance,
    /// 1
    TouchForce,
    /// 2
    Friction,
    /// 3
    ForceLimit,
    /// 4
    Margin,
    /// 5
    Least,
    /// 6
    Strength,
    /// 7
    Gain,
}

impl PlanField {
    /// Its name and unit.
    const fn name(self) -> (&'static str, &'static str) {
        match self {
            Self::Clearance => ("clearance", "m"),
            Self::TouchForce => ("touch force", "N"),
            Self::Friction => ("coefficient of friction", ""),
            Self::ForceLimit => ("force limit", "N"),
            Self::Margin => ("margin of friction", ""),
            Self::Least => ("least force along the surface", "N"),
            Self::Strength => ("internal force", "N"),
            Self::Gain => ("gain", ""),
        }
    }
}

impl GraspPlan {
    /// Whether nothing corrects the internal forces: the joints' servos hold the places, and the forces are fed forward.
    pub(super) const fn only_feeds_forward(&self) -> bool {
        !self.feedback && matches!(self.control, ObjectControl::Differential(_))
    }

    /// Whether it makes sense, and whether its contacts can grip at all.
    ///
    /// # Errors
    /// The first thing that is wrong.
    pub fn validate(&self) -> Result<(), InvalidPlan> {
        let within = |field, value: f32, lower: f32, upper: f32| {
            if value >= lower && value <= upper {
                return Ok(());
            }
            Err(InvalidPlan::Value { field, value, lower, upper })
        };
        within(PlanField::Clearance, self.clearance, 0.001, 0.05)?;
        within(PlanField::ForceLimit, self.force_limit, 0.1, 100.0)?;
        within(PlanField::TouchForce, self.touch_force, 0.02, 0.5 * self.force_limit)?;
        if let Some(friction) = self.friction {
            within(PlanField::Friction, friction, 0.05, 3.0)?;
        }
        let strengths = match self.internal {
            InternalForce::Least { margin, least, moving } => {
                within(PlanField::Margin, margin, 0.0, 0.9)?;
                within(PlanField::Least, least, 0.0, self.force_limit)?;
                within(PlanField::Least, moving, least, self.force_limit)?;
                [0.0; 3]
            }
            InternalForce::Normal { strength } => [strength; 3],
            InternalForce::Pairwise { strengths } => strengths,
        };
        for strength in strengths {
            within(PlanField::Strength, strength, 0.0, self.force_limit)?;
        }
        if let ObjectControl::Wrench(gains) = self.control {
            let [p, i] = gains.position;
            let [r, s] = gains.orientation;
            for (gain, most) in [(p, 1e4), (i, 1e5), (r, 1e2), (s, 1e3), (gains.damping, 1.0)] {
                within(PlanField::Gain, gain, 0.0, most)?;
            }
        }
        self.can_grip()
    }

    fn can_grip(&self) -> Result<(), InvalidPlan> {
        let friction = self.friction.unwrap_or(ASSUMED_FRICTION);
        let mut contacts = heapless::Vec::<Contact, 3>::new();
        for (finger, contact) in (0..).zip(&self.contacts) {
            let (position, normal) = (contact.position.into(), contact.normal.into());
            let contact =
                Contact::try_new(position, normal, friction, self.force_limit).map_err(|error| {
                    let (field, value) = match error {
                        InvalidContact::Position | InvalidContact::Normal => return InvalidPlan::Contact { finger },
                        InvalidContact::Friction(value) => (PlanField::Friction, value),
                        InvalidContact::Limit(value) => (PlanField::ForceLimit, value),
                    };
                    InvalidPlan::Value { field, value, lower: 0.0, upper: f32::INFINITY }
                })?;
            let _ = contacts.push(contact); // three places for three contacts
        }
        let map = GraspMap::try_new(&contacts, Vector3::zeros()).map_err(|error| match error {
            GraspMapError::Coincident { .. } | GraspMapError::Contacts(_) | GraspMapError::Origin => InvalidPlan::NoTriangle,
        })?;
        if map.inverse().conditioning().rank < 6 {
            return Err(InvalidPlan::NoTriangle);
        }
        match self.internal {
            InternalForce::Normal { .. } => match map.normal_grip(NORMAL_TOLERANCE) {
                Ok(_) => Ok(()),
                Err(NormalGripError::Unbalanced { residual: rest }) => Err(InvalidPlan::Unbalanced { rest }),
                Err(NormalGripError::Ambiguous | NormalGripError::NotPushing { .. }) => {
                    Err(InvalidPlan::CannotGrip)
                }
            },
            InternalForce::Least { .. } | InternalForce::Pairwise { .. } => {
                let grip = LeastGrip::try_new(0.0, self.touch_force).map_err(|_| InvalidPlan::CannotGrip)?;
                match grip.solve(&map, &Vector6::zeros(), &mut GripState::default()) {
                    Ok(_) | Err(GripError::NotConverged { .. }) => Ok(()),
                    Err(_) => Err(InvalidPlan::CannotGrip),
                }
            }
        }
    }
}

impl fmt::Display for InvalidPlan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Value { field, value, lower, upper } => {
                let (name, unit) = field.name();
                let space = if unit.is_empty() { "" } else { " " };
                write!(f, "the {name} is {value}{space}{unit}; possible is {lower} to {upper}{space}{unit}")
            }
            Self::Contact { finger } => {
                write!(
                    f,
                    "the contact of finger {}: position or normal is not finite, or the normal has no length",
                    finger + 1
                )
            }
            Self::NoTriangle => write!(f, "the contacts are at the same place or in line"),
            Self::CannotGrip => write!(
                f,
                "no forces of the fingers balance each other within the friction: the normals must point towards each \
                 other"
            ),
            Self::Unbalanced { rest } => write!(
                f,
                "forces along the normals do not balance, {rest} of them remains: finger 3 must be opposite the middle \
                 between fingers 1 and 2, or another internal force be chosen"
            ),
        }
    }
}

impl core::error::Error for InvalidPlan {}

#[cfg(test)]
mod tests {
    use super::*;

    /// A box of 80 mm between fingers 1 and 2, 60 mm apart, and finger 3 opposite the middle between them.
    fn plan() -> GraspPlan {
        let contact = |position, normal| PlannedContact { position, normal };
        GraspPlan {
            contacts: [
                contact([-0.04, 0.03, 0.1], [2.0, 0.0, 0.0]),
                contact([-0.04, -0.03, 0.1], [1.0, 0.0, 0.0]),
                contact([0.04, 0.0, 0.1], [-0.5, 0.0, 0.0]),
            ],
            clearance: 0.01,
            touch_force: 0.1,
            friction: Some(0.5),
            internal: InternalForce::Least { margin: 0.2, least: 0.3, moving: 1.0 },
            force_limit: 9.0,
            feedback: true,
            control: ObjectControl::Differential(ServoMode::Observer),
        }
    }

    const NORMAL: InternalForce = InternalForce::Normal { strength: 2.0 };
    const PAIRWISE: InternalForce = InternalForce::Pairwise { strengths: [1.0, 1.0, 0.5] };
    const GAINS: WrenchGains =
        WrenchGains { position: [150.0, 300.0], orientation: [0.5, 1.0], damping: 0.03, compensated: true };

    fn wrench(change: fn(&mut WrenchGains)) -> ObjectControl {
        let mut gains = GAINS;
        change(&mut gains);
        ObjectControl::Wrench(gains)
    }

    #[test]
    fn plans_of_the_protocol_may_grip_and_move_in_every_way() {
        for internal in [plan().internal, NORMAL, PAIRWISE] {
            for control in [plan().control, ObjectControl::Wrench(GAINS)] {
                for friction in [Some(0.5), Some(3.0), None] {
                    assert_eq!(GraspPlan { internal, control, friction, ..plan() }.validate(), Ok(()));
                }
            }
        }
        // The limits themselves are within.
        let most = InternalForce::Least { margin: 0.9, least: 9.0, moving: 9.0 };
        let far = GraspPlan { clearance: 0.05, touch_force: 4.5, internal: most, ..plan() };
        assert_eq!(far.validate(), Ok(()));
        let none = InternalForce::Pairwise { strengths: [0.0; 3] };
        assert_eq!(GraspPlan { clearance: 0.001, internal: none, ..plan() }.validate(), Ok(()));
    }

    #[test]
    fn each_number_has_the_limits_that_the_protocol_names() {
        type Spoil = fn(&mut GraspPlan);
        let cases: &[(Spoil, PlanField, f32, f32, f32)] = &[
            (|p| p.clearance = 0.0, PlanField::Clearance, 0.0, 0.001, 0.05),
            (|p| p.clearance = 0.06, PlanField::Clearance, 0.06, 0.001, 0.05),
            (|p| p.force_limit = 200.0, PlanField::ForceLimit, 200.0, 0.1, 100.0),
            (|p| p.touch_force = 0.01, PlanField::TouchForce, 0.01, 0.02, 4.5),
            (|p| p.touch_force = 5.0, PlanField::TouchForce, 5.0, 0.02, 4.5),
            (|p| p.friction = Some(0.0), PlanField::Friction, 0.0, 0.05, 3.0),
            (|p| p.friction = Some(f32::INFINITY), PlanField::Friction, f32::INFINITY, 0.05, 3.0),
            (
                |p| p.internal = InternalForce::Least { margin: 1.0, least: 0.3, moving: 1.0 },
                PlanField::Margin,
                1.0,
                0.0,
                0.9,
            ),
            (
                |p| p.internal = InternalForce::Least { margin: 0.2, least: -0.5, moving: 1.0 },
                PlanField::Least,
                -0.5,
                0.0,
                9.0,
            ),
            (
                |p| p.internal = InternalForce::Least { margin: 0.2, least: 0.5, moving: 0.25 },
                PlanField::Least,
                0.25,
                0.5,
                9.0,
            ),
            (|p| p.internal = InternalForce::Normal { strength: 10.0 }, PlanField::Strength, 10.0, 0.0, 9.0),
            (
                |p| p.internal = InternalForce::Pairwise { strengths: [1.0, 1.0, -1.0] },
                PlanField::Strength,
                -1.0,
                0.0,
                9.0,
            ),
            (|p| p.control = wrench(|g| g.position[0] = -1.0), PlanField::Gain, -1.0, 0.0, 1e4),
            (|p| p.control = wrench(|g| g.position[1] = 2e5), PlanField::Gain, 2e5, 0.0, 1e5),
            (|p| p.control = wrench(|g| g.orientation[0] = 200.0), PlanField::Gain, 200.0, 0.0, 1e2),
            (|p| p.control = wrench(|g| g.orientation[1] = 2e3), PlanField::Gain, 2e3, 0.0, 1e3),
            (|p| p.control = wrench(|g| g.damping = 1.5), PlanField::Gain, 1.5, 0.0, 1.0),
        ];
        for &(spoil, field, value, lower, upper) in cases {
            let mut plan = plan();
            spoil(&mut plan);
            assert_eq!(plan.validate(), Err(InvalidPlan::Value { field, value, lower, upper }), "{plan:?}");
        }
        for spoil in [
            (|p| p.clearance = f32::NAN) as Spoil,
            |p| p.force_limit = f32::NAN,
            |p| p.touch_force = f32::NAN,
            |p| p.friction = Some(f32::NAN),
            |p| p.internal = InternalForce::Normal { strength: f32::NAN },
            |p| p.control = wrench(|gains| gains.damping = f32::NAN),
        ] {
            let mut plan = plan();
            spoil(&mut plan);
            assert!(
                matches!(plan.validate(), Err(InvalidPlan::Value { value, .. }) if value.is_nan()),
                "{plan:?}"
            );
        }
    }

    #[test]
    fn contacts_in_the_protocol_are_places_with_directions() {
        type Spoil = fn(&mut PlannedContact);
        for spoil in [
            (|c| c.position[1] = f32::NAN) as Spoil,
            |c| c.position[0] = f32::INFINITY,
            |c| c.normal = [0.0; 3],
            |c| c.normal[2] = f32::NAN,
        ] {
            for finger in 0..3_u8 {
                let mut plan = plan();
                spoil(&mut plan.contacts[usize::from(finger)]);
                assert_eq!(plan.validate(), Err(InvalidPlan::Contact { finger }), "{plan:?}");
            }
        }
    }

    #[test]
    fn the_protocol_calls_contacts_in_line_or_at_the_same_place_no_triangle() {
        for internal in [plan().internal, NORMAL, PAIRWISE] {
            let mut in_line = GraspPlan { internal, ..plan() };
            in_line.contacts[2].position = [-0.04, 0.0, 0.1];
            assert_eq!(in_line.validate(), Err(InvalidPlan::NoTriangle));
            let mut same = GraspPlan { internal, ..plan() };
            same.contacts[1].position = same.contacts[0].position;
            assert_eq!(same.validate(), Err(InvalidPlan::NoTriangle));
            same.contacts[2].position = same.contacts[0].position;
            assert_eq!(same.validate(), Err(InvalidPlan::NoTriangle));
        }
    }

    #[test]
    fn the_protocol_says_when_normals_cannot_grip() {
        for internal in [plan().internal, PAIRWISE] {
            let mut parallel = GraspPlan { internal, ..plan() };
            parallel.contacts[2].normal = [1.0, 0.0, 0.0];
            assert_eq!(parallel.validate(), Err(InvalidPlan::CannotGrip), "{internal:?}");
        }
        // From finger 3 to finger 1 it is 30 mm across and 80 mm along: a friction of 0.375 is enough to grip with
        // these two alone; with finger 3 60 mm beside the middle it is 90 mm across to the farther one.
        let mut beside = plan();
        beside.contacts[2].position[1] = 0.09;
        beside.friction = Some(0.05);
        assert_eq!(beside.validate(), Err(InvalidPlan::CannotGrip));
        beside.friction = Some(2.0);
        assert_eq!(beside.validate(), Ok(()));
    }

    #[test]
    fn the_normal_form_of_the_protocol_demands_forces_that_balance() {
        // Of normals of which two point one way and one across them, something remains.
        let mut across = GraspPlan { internal: NORMAL, ..plan() };
        across.contacts[2].normal = [-1.0, 0.0, 1.0];
        let Err(InvalidPlan::Unbalanced { rest }) = across.validate() else {
            panic!("{:?}", across.validate())
        };
        assert!(rest > NORMAL_TOLERANCE && rest < 1.0, "{rest}");
        // As far as measured contacts are off, it does.
        across.contacts[2].normal = [-1.0, 0.0, 0.05];
        assert_eq!(across.validate(), Ok(()));
        // Other forms do not need that.
        across.contacts[2].normal = [-1.0, 0.0, 0.3];
        assert!(matches!(across.validate(), Err(InvalidPlan::Unbalanced { .. })));
        assert_eq!(GraspPlan { internal: PAIRWISE, ..across }.validate(), Ok(()));
    }

    #[test]
    fn bad_plans_of_the_protocol_say_what_is_wrong_and_between_which_limits() {
        let value =
            |field, value, lower, upper| InvalidPlan::Value { field, value, lower, upper }.to_string();
        let texts = [
            (PlanField::Clearance, "the clearance is 2 m; possible is 0.5 to 1 m"),
            (PlanField::TouchForce, "the touch force is 2 N; possible is 0.5 to 1 N"),
            (PlanField::ForceLimit, "the force limit is 2 N; possible is 0.5 to 1 N"),
            (PlanField::Least, "the least force along the surface is 2 N; possible is 0.5 to 1 N"),
            (PlanField::Strength, "the internal force is 2 N; possible is 0.5 to 1 N"),
        ];
        for (field, text) in texts {
            assert_eq!(value(field, 2.0, 0.5, 1.0), text);
        }
        for (field, name) in [
            (PlanField::Friction, "coefficient of friction"),
            (PlanField::Margin, "margin of friction"),
            (PlanField::Gain, "gain"),
        ] {
            assert_eq!(value(field, 2.0, 0.5, 1.0), format!("the {name} is 2; possible is 0.5 to 1"));
        }
        assert_eq!(
            InvalidPlan::Contact { finger: 0 }.to_string(),
            "the contact of finger 1: position or normal is not finite, or the normal has no length"
        );
        assert_eq!(InvalidPlan::NoTriangle.to_string(), "the contacts are at the same place or in line");
        assert_eq!(
            InvalidPlan::CannotGrip.to_string(),
            "no forces of the fingers balance each other within the friction: the normals must point towards each other"
        );
        assert_eq!(
            InvalidPlan::Unbalanced { rest: 0.25 }.to_string(),
            "forces along the normals do not balance, 0.25 of them remains: finger 3 must be opposite the middle between \
             fingers 1 and 2, or another internal force be chosen"
        );
    }
}
