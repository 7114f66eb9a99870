//! A plant whose motors are driven from outside the simulator.

use super::error::PlantError;
use super::machine::Plant;

impl Plant {
    /// Advances by a sub-step ([`Plant::sub_step`]) under the given motor torques instead of those of its own
    /// drives [N·m]. Joints are assumed rigid.
    ///
    /// # Errors
    /// Torques for another number of joints, or one that is not a number; the plant has not moved then.
    pub fn step(&mut self, torques: &[f64]) -> Result<(), PlantError> {
        let (got, expected) = (torques.len(), self.drives.len());
        if got != expected {
            return Err(PlantError::Count { item: "the list of torques", got, expected });
        }
        if let Some((drive, &torque)) =
            self.drives.iter().zip(torques).find(|(_, torque)| !torque.is_finite())
        {
            #[expect(clippy::cast_possible_truncation, reason = "not a number in either size")]
            let torque = torque as f32;
            return Err(PlantError::NotFinite { joint: drive.joint.clone(), torque });
        }
        let torque_of = |&drive: &usize| torques.get(drive).copied().unwrap_or(0.0);
        self.world.step(self.drive_of.iter().map(torque_of));
        Ok(())
    }

    /// Sub-step of the physics [s].
    pub const fn sub_step(&self) -> f64 {
        self.values.integration.step
    }
}
