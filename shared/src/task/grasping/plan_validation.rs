use nalgebra::{Vector3, Vector6};

use super::plan::{GraspPlan, InternalForce, InvalidPlan, LoadSource, ObjectControl, PlanField};
use super::tuning::{ASSUMED_FRICTION, MAX_FRICTION, MAX_MASS, NORMAL_TOLERANCE};
use crate::grasp::{
    Contact, GraspMap, GraspMapError, GripError, GripState, InvalidContact, LeastGrip, NormalGripError,
};

impl GraspPlan {
    /// Checks all values, and that a grip with these contacts exists.
    ///
    /// # Errors
    /// The first problem.
    pub fn validate(&self) -> Result<(), InvalidPlan> {
        within(PlanField::Clearance, self.clearance, 0.001, 0.05)?;
        within(PlanField::ForceLimit, self.force_limit, 0.1, 100.0)?;
        within(PlanField::TouchForce, self.touch_force, 0.02, 0.5 * self.force_limit)?;
        if let Some(friction) = self.friction {
            within(PlanField::Friction, friction, 0.05, 3.0)?;
        }
        let strengths = match self.internal {
            InternalForce::LeastGrip { margin, capacity_at_rest, capacity_in_motion } => {
                within(PlanField::Margin, margin, 0.0, 0.9)?;
                // Friction carries it under the largest normal force.
                let largest = self.friction.map_or(1.0, |friction| friction.min(1.0)) * self.force_limit;
                within(PlanField::Capacity, capacity_at_rest, 0.0, largest)?;
                within(PlanField::Capacity, capacity_in_motion, capacity_at_rest, largest)?;
                [0.0; 3]
            }
            InternalForce::Normal { strength } => [strength; 3],
            InternalForce::Pairwise { strengths } => strengths,
        };
        for strength in strengths {
            within(PlanField::Strength, strength, 0.0, self.force_limit)?;
        }
        if let LoadSource::Constant { mass } = self.load {
            within(PlanField::Mass, mass, 0.0, MAX_MASS)?;
        }
        if let ObjectControl::Wrench(gains) = self.control {
            let [p, i] = gains.position;
            let [r, s] = gains.orientation;
            for (gain, max) in [(p, 1e4), (i, 1e5), (r, 1e2), (s, 1e3), (gains.damping, 1.0)] {
                within(PlanField::Gain, gain, 0.0, max)?;
            }
        }
        self.check_grip()
    }

    /// Checks that the contacts define a frame, and that internal forces of the planned form exist.
    fn check_grip(&self) -> Result<(), InvalidPlan> {
        let map = self.grasp_map()?;
        if map.inverse().conditioning().rank < 6 {
            return Err(InvalidPlan::NoTriangle);
        }
        match self.internal {
            InternalForce::Normal { .. } => match map.normal_grip(NORMAL_TOLERANCE) {
                Ok(_) => Ok(()),
                Err(NormalGripError::Unbalanced { residual }) => Err(InvalidPlan::Unbalanced { residual }),
                Err(NormalGripError::Ambiguous | NormalGripError::NotPushing { .. }) => {
                    Err(InvalidPlan::CannotGrip)
                }
            },
            InternalForce::Pairwise { strengths } => {
                let pairs = map.pairwise().map_err(|_| InvalidPlan::NoTriangle)?;
                let forces = pairs * Vector3::from(strengths);
                // The friction is at most this, if it is probed.
                let friction = self.friction.unwrap_or(MAX_FRICTION);
                let holds = |(contact, force): (&Contact, &[f32])| {
                    let (normal, tangential) = contact.components(&Vector3::from_column_slice(force));
                    normal >= 0.0 && tangential <= friction * normal
                };
                let mut pressed = map.contacts().iter().zip(forces.as_slice().chunks_exact(3));
                if pressed.all(holds) { Ok(()) } else { Err(InvalidPlan::CannotGrip) }
            }
            InternalForce::LeastGrip { margin, .. } => {
                let grip =
                    LeastGrip::try_new(margin, self.touch_force).map_err(|_| InvalidPlan::CannotGrip)?;
                match grip.solve(&map, &Vector6::zeros(), &mut GripState::default()) {
                    Ok(_) | Err(GripError::NotConverged { .. }) => Ok(()),
                    Err(_) => Err(InvalidPlan::CannotGrip),
                }
            }
        }
    }

    fn grasp_map(&self) -> Result<GraspMap, InvalidPlan> {
        let friction = self.friction.unwrap_or(ASSUMED_FRICTION);
        let mut contacts = heapless::Vec::<Contact, 3>::new();
        for (finger, contact) in (0..).zip(&self.contacts) {
            let (position, normal) = (contact.position.into(), contact.normal.into());
            let contact =
                Contact::try_new(position, normal, friction, self.force_limit).map_err(|error| {
                    let (field, value) = match error {
                        InvalidContact::Position | InvalidContact::Normal => {
                            return InvalidPlan::Contact { finger };
                        }
                        InvalidContact::Friction(value) => (PlanField::Friction, value),
                        InvalidContact::Limit(value) => (PlanField::ForceLimit, value),
                    };
                    InvalidPlan::Value { field, value, lower: 0.0, upper: f32::INFINITY }
                })?;
            let _ = contacts.push(contact); // cannot fail: capacity for three
        }
        GraspMap::try_new(&contacts, Vector3::zeros()).map_err(|error| match error {
            GraspMapError::Coincident { .. } | GraspMapError::Contacts(_) | GraspMapError::Origin => {
                InvalidPlan::NoTriangle
            }
        })
    }
}

fn within(field: PlanField, value: f32, lower: f32, upper: f32) -> Result<(), InvalidPlan> {
    if value >= lower && value <= upper {
        return Ok(());
    }
    Err(InvalidPlan::Value { field, value, lower, upper })
}
