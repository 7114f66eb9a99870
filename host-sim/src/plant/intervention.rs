//! Interventions: external influences on a plant that the experiment does not know of.

use std::sync::{Arc, Mutex, PoisonError};

use rapier3d::na::{Point3, Vector3};
use tesaki::protocol::ActuatorFrame;

use super::environment::Wall;
use super::error::PlantError;
use super::machine::Plant;
use super::push::Push;

/// Observes a plant, changes the commands of its drives, and disturbs it.
pub trait Intervention: Send {
    /// Called when the plant has been built.
    fn attach(&mut self, plant: &mut Plant);

    /// Called before a control period with the torques of `frame`. Returns whether the plant moves; if not,
    /// the period is skipped.
    fn before(&mut self, plant: &mut Plant, frame: &mut ActuatorFrame) -> bool;

    /// Called after the period.
    fn after(&mut self, plant: &Plant);
}

/// An intervention with shared ownership.
pub type SharedIntervention = Arc<Mutex<dyn Intervention>>;

impl Plant {
    /// Puts the plant under an intervention, if there is one.
    #[must_use]
    pub fn under(mut self, intervention: Option<SharedIntervention>) -> Self {
        if let Some(shared) = &intervention {
            shared.lock().unwrap_or_else(PoisonError::into_inner).attach(&mut self);
        }
        self.intervention = intervention;
        self
    }

    pub(super) fn advance_under(
        &mut self,
        intervention: &SharedIntervention,
        frame: &ActuatorFrame,
    ) -> Result<(), PlantError> {
        let mut intervention = intervention.lock().unwrap_or_else(PoisonError::into_inner);
        let mut frame = frame.clone();
        if intervention.before(self, &mut frame) {
            self.advance(&frame)?;
            intervention.after(self);
        }
        Ok(())
    }

    /// End stops of each joint [rad]; `None` for one that turns without end.
    pub fn stops(&self) -> Vec<Option<[f64; 2]>> {
        self.drives.iter().map(|drive| drive.stops).collect()
    }

    /// Stiffness of the stiffest wall [N/m]; 0 without walls.
    pub fn wall_stiffness(&self) -> f64 {
        self.world.environment().stiffness()
    }

    /// Begins a push on the link that a joint moves.
    ///
    /// # Errors
    /// No such joint, or an invalid value.
    pub fn push_link(&mut self, joint: usize, push: Push) -> Result<(), PlantError> {
        push.validate()?;
        let body = self.drive_of.iter().position(|&drive| drive == joint);
        let expected = self.drives.len();
        let body = body.ok_or(PlantError::Count { item: "the pushed joint", got: joint, expected })?;
        self.world.push_link(body, push);
        Ok(())
    }

    /// Inserts a wall ahead of all tips in a direction, `clearance` from the tip that is nearest to it.
    ///
    /// # Errors
    /// No tip, or an invalid value.
    pub fn insert_wall_ahead(
        &mut self,
        direction: [f64; 3],
        clearance: f64,
        stiffness: f64,
    ) -> Result<(), PlantError> {
        let ahead = Vector3::from(direction).normalize();
        let reach = self.world.tips().iter().enumerate().filter_map(|(index, tip)| {
            let frame = self.world.tip_frame(index)?;
            Some((frame * Point3::from(tip.center)).coords.dot(&ahead) + tip.radius)
        });
        let reach = reach.max_by(f64::total_cmp).ok_or(PlantError::NoTip { tip: 0, tips: 0 })?;
        let (point, normal) = ((ahead * (reach + clearance)).into(), (-ahead).into());
        self.insert_wall(Wall { point, normal, stiffness, damping: 20.0, friction: 0.3 })
    }

    /// Whether a hold acts on a tip.
    pub fn is_held(&self) -> bool {
        self.world.environment().holds()
    }

    /// Removes the object, if there is one.
    pub fn remove_object(&mut self) {
        self.world.remove_object();
    }
}
