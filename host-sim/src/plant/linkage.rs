//! Linkages through which one motor moves joints of several fingers.
//!
//! Rapier's multibodies have no gear constraint. A linkage is therefore modelled as what it is in the
//! machine, a stiff spring with some damping: the torque that it applies to the follower joint acts back on
//! the driving joint, times the ratio of their velocities, so that only its damping changes the energy.

use super::error::PlantError;
use super::tree::Body;
use super::values::LinkageValues;

/// Inertia of a linkage at the follower joint [kg·m²]. It bounds the frequency of the spring for any posture:
/// with the default stiffness to 500 rad/s, far below the 2000 rad/s at which sub-steps of 1 ms become
/// unstable.
pub const INERTIA: f64 = 2e-5;

/// A joint that follows another: angle = `multiplier` · angle of the driving joint + `offset`.
#[derive(Clone, Copy, Debug)]
pub struct Linkage {
    /// Indices of the bodies behind both joints.
    pub follower: usize,
    pub driver: usize,
    pub multiplier: f64,
    pub offset: f64,
    pub values: LinkageValues,
}

/// Collects the linkages of a robot.
pub fn linkages(bodies: &[Body], values: LinkageValues) -> Result<Vec<Linkage>, PlantError> {
    let mimics = bodies.iter().enumerate().filter_map(|(index, body)| Some((index, body.mimic.as_ref()?)));
    let linkage = |(follower, (name, multiplier, offset)): (usize, &(String, f64, f64))| {
        let driver = bodies.iter().position(|body| body.joint == *name && body.mimic.is_none());
        let driver = driver.ok_or_else(|| {
            let driven = bodies.iter().filter(|body| body.mimic.is_none());
            PlantError::UnknownJoint {
                item: "a mimic joint",
                joint: name.clone(),
                place: "the joints with a motor",
                known: driven.map(|body| body.joint.as_str()).collect::<Vec<_>>().join(", "),
            }
        })?;
        Ok(Linkage { follower, driver, multiplier: *multiplier, offset: *offset, values })
    };
    mimics.map(linkage).collect()
}

impl Linkage {
    /// Computes the torque at the follower joint from angles [rad] and velocities [rad/s] of driver and
    /// follower.
    pub fn torque(&self, driver: (f64, f64), follower: (f64, f64)) -> f64 {
        let stretch = self.multiplier * driver.0 + self.offset - follower.0;
        let rate = self.multiplier * driver.1 - follower.1;
        self.values.stiffness * stretch + self.values.damping * rate
    }
}
