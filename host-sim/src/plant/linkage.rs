//! Linkages by which one motor moves joints of several fingers.
//!
//! Rapier's multibodies have no gear constraint. So a linkage is what it is in the machine, a stiff spring
//! with some damping: what it pulls at the joint that follows, it pulls back at the joint that drives, times
//! the ratio of their velocities, so that it makes and takes no energy but by its damping.

use super::error::PlantError;
use super::tree::Body;

/// Inertia of a linkage at the joint that follows [kg·m²]. It bounds the frequency of the spring for any
/// posture.
pub const INERTIA: f64 = 2e-5;
/// Stiffness at the joint that follows [N·m/rad]: 500 rad/s with [`INERTIA`], far below the 2000 rad/s at
/// which sub-steps of 1 ms become unstable. A finger of 40 g bends it by 3 mrad.
const STIFFNESS: f64 = 5.0;
/// Damping [N·m·s/rad]: a quarter of the critical one.
const DAMPING: f64 = 5e-3;

/// A joint that follows another: angle = `multiplier` · angle of the driving joint + `offset`.
#[derive(Clone, Copy, Debug)]
pub struct Linkage {
    /// Indices of the bodies behind both joints.
    pub follower: usize,
    pub driver: usize,
    pub multiplier: f64,
    pub offset: f64,
}

/// The linkages of a robot.
pub fn linkages(bodies: &[Body]) -> Result<Vec<Linkage>, PlantError> {
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
        Ok(Linkage { follower, driver, multiplier: *multiplier, offset: *offset })
    };
    mimics.map(linkage).collect()
}

impl Linkage {
    /// Torque at the joint that follows, for angles [rad] and velocities [rad/s] of driver and follower.
    pub fn torque(&self, driver: (f64, f64), follower: (f64, f64)) -> f64 {
        let stretch = self.multiplier * driver.0 + self.offset - follower.0;
        let rate = self.multiplier * driver.1 - follower.1;
        STIFFNESS * stretch + DAMPING * rate
    }
}
