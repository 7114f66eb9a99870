//! The plant, and its interfaces for controllers and scenarios.

use rapier3d::na::Isometry3;
use tesaki::model::{MAX_CHAINS, MAX_JOINTS};
use tesaki::protocol::{ActuatorFrame, SensorFlags, SensorFrame};
use tesaki_description::plant::PlantProblem;
use tesaki_description::robot::RobotFolder;
use tesaki_description::urdf::Urdf;
use tesaki_rng::Rng;

use super::assembly::{JointValues, Parts};
use super::drive::{self, DriveState};
use super::end_effector::{Tip, tips};
use super::environment::{Hold, Wall};
use super::error::PlantError;
use super::factors::{self, JointFactors};
use super::fixture;
use super::force::ForceSensors;
use super::intervention::SharedIntervention;
use super::linkage;
use super::push::{Load, Push};
use super::tree::{self, Body};
use super::values::{Drive, Noise, PlantOptions, PlantValues, steps};
use super::world::World;
use crate::purpose::Purpose;
use tesaki_description::object::ObjectValues;

/// A simulated robot. Joints are in the order of its drives.
pub struct Plant {
    pub(super) world: World,
    pub(super) drives: Vec<DriveState>,
    /// Drive of each joint of the world.
    pub(super) drive_of: Vec<usize>,
    factors: Vec<JointFactors>,
    pub(super) forces: ForceSensors,
    pub(super) values: PlantValues,
    rng: Rng,
    ideal_sensors: bool,
    held: bool,
    emergency_stop: bool,
    pub(super) intervention: Option<SharedIntervention>,
}

impl Plant {
    /// Builds the plant of the robot in a folder, with the motors of its model and its `plant.toml`.
    ///
    /// # Errors
    /// What is wrong with URDF, values or options, and where.
    pub fn of(robot: &RobotFolder, options: &PlantOptions) -> Result<Self, PlantError> {
        let drives: Vec<Drive> = robot.model.joints.iter().map(Drive::from).collect();
        Self::new(&robot.urdf, &drives, &PlantValues::load(&robot.path)?, options)
    }

    /// Builds the plant of a robot.
    ///
    /// # Errors
    /// The URDF, the values or the options are invalid; the error says what is wrong, and where.
    pub fn new(
        urdf: &Urdf,
        drives: &[Drive],
        values: &PlantValues,
        options: &PlantOptions,
    ) -> Result<Self, PlantError> {
        if let Some(PlantProblem { field, value, expected }) = values.problems().into_iter().next() {
            return Err(PlantError::Value { field, value, expected });
        }
        check_count(drives)?;
        let bodies = tree::bodies(urdf)?;
        let drive_of = match_drives(&bodies, drives)?;
        check_names("plant.toml, [elasticity],", values.elasticity.keys(), drives)?;
        let posture = posture(values, options, drives)?;
        let spread = if options.mismatch { values.mismatch.spread } else { 0.0 };
        let factors = factors::draw(options.seed, spread, drives.len());

        let in_world_order = |index: usize| drive_of.get(index).copied().unwrap_or(index);
        let of_body =
            |index: usize| factors.get(in_world_order(index)).copied().unwrap_or(JointFactors::NONE);
        let of_joint = |(index, body): (usize, &Body)| {
            joint_values(body, drives.get(in_world_order(index)), &of_body(index), options)
        };
        let joints: Vec<JointValues> = bodies.iter().enumerate().map(of_joint).collect();
        let mut world_posture: Vec<f64> = (0..bodies.len())
            .map(|index| posture.get(in_world_order(index)).copied().unwrap_or(0.0))
            .collect();
        let linkages = linkage::linkages(&bodies, values.linkage)?;
        for linkage in &linkages {
            let angle = linkage.multiplier * world_posture[linkage.driver] + linkage.offset;
            world_posture[linkage.follower] = angle;
        }
        let world_factors: Vec<JointFactors> = (0..bodies.len()).map(of_body).collect();
        let parts =
            Parts { bodies: &bodies, values: &joints, factors: &world_factors, posture: &world_posture };
        let mut world = World::new(values.gravity, values.integration.step, &parts);
        world.insert_linkages(linkages);
        if let Some(problem) = options.object.as_ref().and_then(ObjectValues::problem) {
            let PlantProblem { field, value, expected } = problem;
            return Err(PlantError::Value { field: format!("object: {field}"), value, expected });
        }
        let object = options.object.as_ref().map(|object| (object, friction(object, options)));
        let mut tips = tips(&urdf.robot, &bodies);
        for tip in &mut tips {
            tip.mass *= of_body(tip.body).mass;
            tip.inertia *= of_body(tip.body).inertia;
        }
        if object.is_some() {
            check_spheres(&tips)?;
        }
        if object.is_some() && !options.fixtures.is_empty() {
            return Err(PlantError::ObjectAndFixtures);
        }
        world.insert_object(tips, object);
        if !options.fixtures.is_empty() {
            for (index, fixture) in options.fixtures.iter().enumerate() {
                fixture.validate(index)?;
            }
            let elements = fixture::elements(&urdf.robot, &bodies)?;
            if elements.is_empty() {
                return Err(PlantError::NoCollision);
            }
            world.insert_fixtures(&options.fixtures, elements);
        }
        let forces = ForceSensors::new(values.force_sensor, &world, options.seed, options.ideal_sensors);
        let drives = drive::states(drives, &bodies, &drive_of, &factors, values, options);
        Ok(Self {
            world,
            drives,
            drive_of,
            factors,
            forces,
            values: values.clone(),
            rng: Purpose::Noise.rng(options.seed),
            ideal_sensors: options.ideal_sensors,
            held: options.held_at_start,
            emergency_stop: false,
            intervention: None,
        })
    }

    /// Reads the board's sensors. Each reading draws new noise.
    pub fn sensors(&mut self, sequence: u32) -> SensorFrame {
        let half = self.values.integration.step / 2.0;
        let Noise { current, supply } = self.values.noise;
        let mut noise = |deviation: f64| if self.ideal_sensors { 0.0 } else { deviation * self.rng.normal() };
        let positions = in_drive_order(&self.drive_of, self.world.positions());
        let mut frame = SensorFrame {
            sequence,
            flags: SensorFlags(if self.emergency_stop { SensorFlags::EMERGENCY_STOP } else { 0 }),
            supply: counts(1e3 * (self.values.supply.voltage + noise(supply))),
            ..SensorFrame::default()
        };
        for (drive, position) in self.drives.iter().zip(positions) {
            // Never full, because the number of drives was checked.
            let _ = frame.encoders.push(drive.encoder_count(position));
            let _ = frame.currents.push(drive.current_count(half, noise(current)));
        }
        frame.forces = self.force_sensors().into_iter().take(MAX_CHAINS).collect();
        frame
    }

    /// Reads the force sensor of each tip: forces and torques along x, y and z of the frame of its link, in
    /// the counts of [`PlantValues::force_sensor`]. Empty for a robot without force sensors. Each reading
    /// draws new noise.
    ///
    /// A reading is the mean wrench on the tip at the origin of that frame over the window of the sensor:
    /// contact forces, weight and inertial forces of the tip.
    pub fn force_sensors(&mut self) -> Vec<[i32; 6]> {
        self.forces.counts()
    }

    /// Advances by one control period with the torques of `frame`.
    ///
    /// # Errors
    /// A frame for another number of joints, or a torque that is not a number; the plant has not moved then.
    pub fn apply(&mut self, frame: &ActuatorFrame) -> Result<(), PlantError> {
        match self.intervention.clone() {
            None => self.advance(frame),
            Some(intervention) => self.advance_under(&intervention, frame),
        }
    }

    /// Advances like [`Plant::apply`], but without an intervention.
    pub(super) fn advance(&mut self, frame: &ActuatorFrame) -> Result<(), PlantError> {
        let (got, expected) = (frame.torques.len(), self.drives.len());
        if got != expected {
            return Err(PlantError::Count { item: "the actuator frame", got, expected });
        }
        for (drive, &torque) in self.drives.iter().zip(&frame.torques) {
            if !torque.is_finite() {
                return Err(PlantError::NotFinite { joint: drive.joint.clone(), torque });
            }
        }
        let step = self.values.integration.step;
        let delay = self.values.inner_loop.delay + step / 2.0;
        for (drive, &torque) in self.drives.iter_mut().zip(&frame.torques) {
            drive.command(if frame.enabled { f64::from(torque) } else { 0.0 }, delay);
        }
        self.held &= !frame.enabled;
        if self.held {
            return Ok(());
        }
        let mut torques = vec![0.0; expected];
        self.world.begin_period();
        let steps = steps(&self.values);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "0 to steps")]
        let window = (self.forces.window() / step).round().max(1.0) as usize;
        for number in 0..steps {
            if number + window == steps {
                self.forces.begin_window(&self.world);
            }
            for (torque, drive) in torques.iter_mut().zip(&mut self.drives) {
                *torque = drive.advance(step);
            }
            let torque_of = |&drive: &usize| torques.get(drive).copied().unwrap_or(0.0);
            self.world.step(self.drive_of.iter().map(torque_of));
            self.forces.add(&self.world);
        }
        self.forces.finish(&self.world, window as f64 * step);
        Ok(())
    }

    /// Sets the torque constants by which the amplifiers convert torques into currents to those of `model`,
    /// as a board with that model does. Initially they are those of the drives that the plant was built with.
    /// The true torque constants do not change.
    pub fn configure_amplifiers(&mut self, model: &tesaki::model::RobotModel) {
        for drive in &mut self.drives {
            if let Some(joint) = model.joints.iter().find(|joint| joint.name == drive.joint.as_str()) {
                drive.set_nominal_constant(joint.motor.torque_constant.into());
            }
        }
    }

    /// Averaging window of the force sensors before a reading [s].
    pub fn force_window(&self) -> f64 {
        self.forces.window()
    }

    /// Sets the emergency stop that the sensors report. It does not act on the drives by itself.
    pub const fn press_emergency_stop(&mut self, pressed: bool) {
        self.emergency_stop = pressed;
    }

    /// Begins a push on the object, if there is one.
    ///
    /// # Errors
    /// An invalid value.
    pub fn push(&mut self, push: Push) -> Result<(), PlantError> {
        push.validate()?;
        let time = self.world.time();
        if let Some(disturbances) = self.world.disturbances() {
            disturbances.push(push, time);
        }
        Ok(())
    }

    /// Adds a weight to the object, if there is one.
    ///
    /// # Errors
    /// An invalid value.
    pub fn load(&mut self, load: Load) -> Result<(), PlantError> {
        load.validate()?;
        let time = self.world.time();
        if let Some(disturbances) = self.world.disturbances() {
            disturbances.load(load, time);
        }
        Ok(())
    }

    /// Removes all weights from the object within `ramp` [s].
    pub fn unload(&mut self, ramp: f64) {
        let time = self.world.time();
        if let Some(disturbances) = self.world.disturbances() {
            disturbances.unload(ramp, time);
        }
    }

    /// Inserts a wall for all tips.
    ///
    /// # Errors
    /// An invalid value.
    pub fn insert_wall(&mut self, wall: Wall) -> Result<(), PlantError> {
        wall.validate()?;
        self.world.environment_mut().insert_wall(wall);
        Ok(())
    }

    /// Removes all walls.
    pub fn remove_walls(&mut self) {
        self.world.environment_mut().remove_walls();
    }

    /// Begins to hold a tip; replaces an earlier hold.
    ///
    /// # Errors
    /// No such tip, or an invalid value.
    pub fn hold_tip(&mut self, tip: usize, hold: Hold) -> Result<(), PlantError> {
        hold.validate()?;
        let frame = self.tip_frame(tip)?;
        let time = self.world.time();
        self.world.environment_mut().hold(tip, hold, frame, time);
        Ok(())
    }

    /// Releases a tip after a time [s].
    ///
    /// # Errors
    /// No such tip.
    pub fn release_tip(&mut self, tip: usize, after: f64) -> Result<(), PlantError> {
        self.tip_frame(tip)?;
        let time = self.world.time();
        self.world.environment_mut().release(tip, time + after);
        Ok(())
    }

    /// Begins a push on a tip.
    ///
    /// # Errors
    /// No such tip, or an invalid value.
    pub fn push_tip(&mut self, tip: usize, push: Push) -> Result<(), PlantError> {
        push.validate()?;
        self.tip_frame(tip)?;
        let time = self.world.time();
        self.world.environment_mut().push(tip, push, time);
        Ok(())
    }

    fn tip_frame(&self, tip: usize) -> Result<Isometry3<f64>, PlantError> {
        self.world.tip_frame(tip).ok_or(PlantError::NoTip { tip, tips: self.world.tips().len() })
    }

    /// Removes the support of the object.
    pub fn remove_support(&mut self) {
        self.world.remove_support();
    }

    /// Returns the angles that homing would find now: true angle, deflection and homing error of each joint,
    /// added [rad].
    pub fn homed_positions(&self) -> Vec<f64> {
        let positions = in_drive_order(&self.drive_of, self.world.positions());
        self.drives
            .iter()
            .zip(positions)
            .map(|(drive, position)| position + drive.deflection() + drive.homing_error)
            .collect()
    }

    /// Deviation factors of each joint from the model.
    pub fn factors(&self) -> &[JointFactors] {
        &self.factors
    }

    /// Pose of the link that a joint moves (the joint frame) in the base frame: position [m] and orientation
    /// `[x, y, z, w]`. `None` for a joint that does not exist.
    pub fn link_pose(&self, joint: usize) -> Option<([f64; 3], [f64; 4])> {
        Some(self.world.body_pose(self.drive_of.iter().position(|&drive| drive == joint)?))
    }
}

/// Computes the parameters of a joint in the physics engine: the values of URDF and drive, times its factors.
pub(super) fn joint_values(
    body: &Body,
    drive: Option<&Drive>,
    factors: &JointFactors,
    options: &PlantOptions,
) -> JointValues {
    JointValues {
        rotor_inertia: drive.map_or(linkage::INERTIA, |drive| f64::from(drive.motor.rotor_inertia))
            * factors.rotor_inertia,
        coulomb: options.coulomb.unwrap_or(body.coulomb) * factors.coulomb,
        viscous: body.viscous * factors.viscous,
    }
}

/// Checks that there are no more drives than a board has joints.
fn check_count(drives: &[Drive]) -> Result<(), PlantError> {
    match drives.len() {
        0..=MAX_JOINTS => Ok(()),
        got => Err(PlantError::Count { item: "the list of drives", got, expected: MAX_JOINTS }),
    }
}

/// Checks that every tip that may touch an object has a sphere.
fn check_spheres(tips: &[Tip]) -> Result<(), PlantError> {
    match tips.iter().find(|tip| tip.radius <= 0.0) {
        Some(tip) => Err(PlantError::NoSphere(tip.link.clone())),
        None => Ok(()),
    }
}

/// Draws the coefficient of friction of an object's contacts.
fn friction(object: &ObjectValues, options: &PlantOptions) -> f64 {
    let spread = if options.mismatch { object.friction_spread } else { 0.0 };
    object.friction + spread * Purpose::Contact.rng(options.seed).symmetric()
}

/// Drive index of a joint without a drive.
const NO_DRIVE: usize = usize::MAX;

/// Finds the drive of each body's joint; [`NO_DRIVE`] for a joint that follows another.
fn match_drives(bodies: &[Body], drives: &[Drive]) -> Result<Vec<usize>, PlantError> {
    let list = |names: Vec<&str>| names.join(", ");
    for (index, drive) in drives.iter().enumerate() {
        if drives.iter().take(index).any(|other| other.joint == drive.joint) {
            return Err(PlantError::TwoDrives(drive.joint.clone()));
        }
        if !bodies.iter().any(|body| body.joint == drive.joint) {
            return Err(PlantError::UnknownJoint {
                item: "a drive",
                joint: drive.joint.clone(),
                place: "the URDF",
                known: list(bodies.iter().map(|body| body.joint.as_str()).collect()),
            });
        }
    }
    let find = |body: &Body| {
        if body.mimic.is_some() {
            return Ok(NO_DRIVE);
        }
        drives.iter().position(|drive| drive.joint == body.joint).ok_or_else(|| PlantError::UnknownJoint {
            item: "the URDF",
            joint: body.joint.clone(),
            place: "the list of drives",
            known: list(drives.iter().map(|drive| drive.joint.as_str()).collect()),
        })
    };
    bodies.iter().map(find).collect()
}

/// Checks that `item`, a section of `plant.toml`, names existing joints.
fn check_names<'a>(
    item: &'static str,
    names: impl Iterator<Item = &'a String>,
    drives: &[Drive],
) -> Result<(), PlantError> {
    let unknown = |name: &&String| !drives.iter().any(|drive| drive.joint == **name);
    match names.into_iter().find(unknown) {
        None => Ok(()),
        Some(joint) => Err(PlantError::UnknownJoint {
            item,
            joint: joint.clone(),
            place: "the robot",
            known: drives.iter().map(|drive| drive.joint.as_str()).collect::<Vec<_>>().join(", "),
        }),
    }
}

/// Returns the initial angles, in the order of the drives.
fn posture(values: &PlantValues, options: &PlantOptions, drives: &[Drive]) -> Result<Vec<f64>, PlantError> {
    check_names("plant.toml, [posture],", values.posture.keys(), drives)?;
    let posture = match &options.posture {
        Some(posture) if posture.len() == drives.len() => posture.clone(),
        Some(posture) => {
            return Err(PlantError::Count {
                item: "the posture",
                got: posture.len(),
                expected: drives.len(),
            });
        }
        None => drives.iter().map(|drive| values.posture.get(&drive.joint).copied().unwrap_or(0.0)).collect(),
    };
    for (drive, &angle) in drives.iter().zip(&posture) {
        if !angle.is_finite() {
            let field = format!("posture.{}", drive.joint);
            return Err(PlantError::Value { field, value: angle, expected: "a finite angle [rad]" });
        }
    }
    Ok(posture)
}

/// Sorts values of the world's joints into the order of the drives.
pub(super) fn in_drive_order(drive_of: &[usize], values: impl Iterator<Item = f64>) -> Vec<f64> {
    let drives = drive_of.iter().filter(|&&drive| drive != NO_DRIVE).count();
    let mut ordered = vec![f64::NAN; drives];
    for (&drive, value) in drive_of.iter().zip(values) {
        if let Some(slot) = ordered.get_mut(drive) {
            *slot = value;
        }
    }
    ordered
}

/// Rounds to whole counts of a sensor.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates, as a sensor does")]
fn counts(value: f64) -> u16 {
    libm::round(value) as u16
}
