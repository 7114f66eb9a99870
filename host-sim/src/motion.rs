//! The motion of a run, and its recording in MCAP.
//!
//! A scenario calls [`Motion::tick`] once per control period, and adds reference and further frames if it has
//! them:
//!
//! ```
//! use tesaki_sim::motion::{Motion, Transform};
//! # use tesaki_sim::plant::Truth;
//! # let (positions, velocities, torques, homing_errors) = (vec![0.5], vec![0.0], vec![0.1], vec![0.0]);
//! # let truth = Truth { positions, velocities, torques, homing_errors };
//! let mut motion = Motion::new(["elbow"]);
//! let sequence = motion.tick(&truth);
//! motion.reference(vec![0.6]);
//! motion.frame(Transform {
//!     parent: "palm".into(),
//!     child: "box".into(),
//!     translation: [0.0, 0.0, 0.1],
//!     rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
//! });
//! assert_eq!((sequence, motion.ticks()), (1, 1));
//! ```

use std::path::Path;

use rapier3d::na::Vector3;
use tesaki_description::frames::{Frames, Placed};
use tesaki_description::plant::{CONTROL_PERIOD, CONTROL_PERIOD_NS};
use tesaki_recording::{LogLevel, Marker, MarkerShape, McapError, Recording};

pub use tesaki_recording::Transform;

use tesaki_viewer::{Contact, Frame, Note, Object, Replay, Scene, Shape};

use crate::live_run::{EVERY, LiveRun};
use crate::plant::{Fixture, FixtureShape, ObjectValues, Plant, Shape as Solid, Truth};

/// Forces smaller than this are not shown [N].
const SHOWN_FORCE: f64 = 0.01;

/// The motion of a run, one sample per tick.
#[derive(Clone, Debug, Default)]
pub struct Motion {
    names: Vec<String>,
    samples: Vec<Sample>,
    objects: Vec<Object>,
    /// The live view of the run.
    live: Option<LiveRun>,
}

#[derive(Clone, Debug)]
struct Sample {
    truth: Truth,
    /// Empty if there is none.
    reference: Vec<f64>,
    frames: Vec<Transform>,
    notes: Vec<String>,
    contacts: Vec<Contact>,
}

impl Sample {
    /// Converts the sample for a page.
    fn shown(&self) -> tesaki_viewer::Sample {
        tesaki_viewer::Sample {
            positions: self.truth.positions.clone(),
            velocities: self.truth.velocities.clone(),
            torques: self.truth.torques.clone(),
            references: self.reference.clone(),
            frames: self
                .frames
                .iter()
                .map(|frame| Frame(frame.child.clone(), flat(frame.translation, frame.rotation_xyzw)))
                .collect(),
            contacts: self.contacts.clone(),
        }
    }
}

/// Reasons why the recording could not be written.
#[derive(Debug, thiserror::Error)]
pub enum MotionError {
    /// The robot's description is not a URDF.
    #[error("the URDF of the recording: {0}")]
    Urdf(#[from] urdf_rs::UrdfError),
    /// The file could not be written.
    #[error(transparent)]
    Mcap(#[from] McapError),
}

impl Motion {
    /// Creates a motion of joints with these names, in the order of all values.
    pub fn new(names: impl IntoIterator<Item: Into<String>>) -> Self {
        Self { names: names.into_iter().map(Into::into).collect(), ..Self::default() }
    }

    /// Also shows the motion in a live view, if there is one.
    #[must_use]
    pub fn shown_to(self, live: Option<&LiveRun>) -> Self {
        Self { live: live.cloned(), ..self }
    }

    /// Adds the state at the start of a control period; returns the number of the tick, from 1, as in the
    /// sensor frames.
    pub fn tick(&mut self, truth: &Truth) -> u32 {
        // Only now is the last sample complete.
        self.show_last();
        let truth = truth.clone();
        self.samples.push(Sample {
            truth,
            reference: Vec::new(),
            frames: Vec::new(),
            notes: Vec::new(),
            contacts: Vec::new(),
        });
        self.ticks()
    }

    /// Sends the last sample to the live view, if it is one of those that are shown; also for the end of a
    /// run.
    pub fn show_last(&self) {
        if let (Some(live), Some(last)) = (&self.live, self.samples.last())
            && (self.samples.len() - 1).is_multiple_of(EVERY)
        {
            live.sample(last.shown().rounded());
        }
    }

    fn add_object(&mut self, object: Object) {
        if let Some(live) = &self.live {
            live.object(object.clone());
        }
        self.objects.push(object);
    }

    /// Sets the joints' reference positions of the last tick [rad].
    pub fn reference(&mut self, positions: Vec<f64>) {
        if let Some(sample) = self.samples.last_mut() {
            sample.reference = positions;
        }
    }

    /// Adds a frame that is not a link of the robot to the last tick.
    pub fn frame(&mut self, frame: Transform) {
        if let Some(sample) = self.samples.last_mut() {
            sample.frames.push(frame);
        }
    }

    /// Adds a line of text to the last tick, which says what begins here.
    pub fn note(&mut self, text: impl Into<String>) {
        let time = f64::from(self.ticks().saturating_sub(1)) * CONTROL_PERIOD;
        let Some(sample) = self.samples.last_mut() else { return };
        let text = text.into();
        if let Some(live) = &self.live {
            live.note(Note { time, text: text.clone() });
        }
        sample.notes.push(text);
    }

    /// Adds the forces on the tips to the last tick: contacts with the object, else walls, holds and pushes.
    pub fn forces(&mut self, plant: &Plant) {
        let Some(sample) = self.samples.last_mut() else { return };
        let friction = plant.object().map_or(0.0, |object| object.friction);
        let on_object = plant.contacts().into_iter().enumerate().map(|(tip, contact)| Contact {
            tip,
            point: contact.point,
            force: contact.force,
            normal: contact.normal.map(|part| -part),
            friction,
        });
        sample.contacts = on_object.collect();
        if sample.contacts.is_empty() {
            let on_tips = plant.tips().into_iter().enumerate().map(|(tip, truth)| Contact {
                tip,
                point: truth.position,
                force: truth.force,
                normal: [0.0; 3],
                friction: 0.0,
            });
            sample.contacts = on_tips.collect();
        }
        sample.contacts.retain(|contact| Vector3::from(contact.force).norm() > SHOWN_FORCE);
    }

    /// Adds the object that is grasped from now on, in the frame `object` of each tick, with its support.
    pub fn object(&mut self, object: &ObjectValues, is_supported: bool) {
        let [x, y, z] = object.size;
        let shape = match object.shape {
            Solid::Box => Shape::Box(object.size),
            Solid::Cylinder => Shape::Cylinder([x / 2.0, z]),
            Solid::Wedge { top } => Shape::Wedge([x, y, z, top]),
        };
        let frame = Some("object".to_owned());
        let pose = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        self.add_object(Object { since: self.now(), frame, shape, pose });
        if let Some(support) = object.support.filter(|_| is_supported) {
            let ([x, y, z], [a, b, c, d]) = (support.position, support.orientation);
            let (shape, pose) = (Shape::Box(support.size), [x, y, z, a, b, c, d]);
            self.add_object(Object { since: self.now(), frame: None, shape, pose });
        }
    }

    /// Adds the fixed bodies that exist from now on.
    pub fn fixtures(&mut self, fixtures: &[Fixture]) {
        for fixture in fixtures {
            let shape = match fixture.shape {
                FixtureShape::Box { size } => Shape::Box(size),
                FixtureShape::Cylinder { radius, length }
                | FixtureShape::BevelledCylinder { radius, length, .. } => Shape::Cylinder([radius, length]),
            };
            let pose = flat(fixture.pose.translation.vector.into(), fixture.pose.rotation.coords.into());
            self.add_object(Object { since: self.now(), frame: None, shape, pose });
        }
    }

    /// Time of the next tick in a replay [s].
    fn now(&self) -> f64 {
        f64::from(self.ticks()) * CONTROL_PERIOD
    }

    /// Creates the replay for the page of a report.
    pub fn replay(&self, scene: Scene) -> Replay {
        let samples: Vec<_> = self.samples.iter().map(Sample::shown).collect();
        let mut replay = Replay::new(scene, CONTROL_PERIOD, &samples);
        replay.objects.clone_from(&self.objects);
        replay.notes = (0u32..)
            .zip(&self.samples)
            .flat_map(|(tick, sample)| sample.notes.iter().map(move |text| (tick, text)))
            .map(|(tick, text)| Note { time: f64::from(tick) * CONTROL_PERIOD, text: text.clone() })
            .collect();
        replay
    }

    /// Number of ticks.
    pub fn ticks(&self) -> u32 {
        u32::try_from(self.samples.len()).unwrap_or(u32::MAX)
    }

    /// Writes the motion as MCAP for ROS 2: `/robot_description`, `/tf_static`, in each tick `/joint_states`,
    /// `/tesaki/reference` and `/tf` with all moving links, and the bodies on `/tesaki/objects`. Times are
    /// simulated: tick `n` is at `n` times 10 ms. The same motion yields the same bytes.
    ///
    /// # Errors
    /// The text is not a URDF, or the file cannot be written.
    pub fn write(&self, path: &Path, urdf: &str) -> Result<(), MotionError> {
        let frames = Frames::of_urdf(&urdf_rs::read_from_string(urdf)?, &self.names);
        let mut recording = Recording::create(path, Some(urdf))?;
        let fixed: Vec<Transform> = frames.fixed().iter().map(transform).collect();
        if !fixed.is_empty() {
            recording.tf_static(0, &fixed)?;
        }
        let mut objects = self.objects.iter().peekable();
        for (sample, number) in self.samples.iter().zip(1..) {
            let time = number * CONTROL_PERIOD_NS;
            let Truth { positions, velocities, torques, .. } = &sample.truth;
            recording.joint_states(time, &self.names, positions, velocities, torques)?;
            if !sample.reference.is_empty() {
                recording.references(time, &self.names, &sample.reference, &[], &[])?;
            }
            let mut moving: Vec<Transform> = frames.moving(positions).iter().map(transform).collect();
            moving.extend_from_slice(&sample.frames);
            recording.tf(time, &moving)?;
            // As in a replay, the latest objects replace earlier ones.
            let since = objects.peek().map(|object| object.since);
            let mut markers = Vec::new();
            // An object added after tick n is shown from tick n + 1 on.
            let now = (number as f64 - 0.5) * CONTROL_PERIOD;
            while let Some(object) =
                objects.next_if(|object| Some(object.since) == since && object.since < now)
            {
                let id = i32::try_from(markers.len()).unwrap_or(i32::MAX);
                markers.push(marker(id, object, frames.base()));
            }
            if !markers.is_empty() {
                recording.objects(time, &markers)?;
            }
            for note in &sample.notes {
                recording.log(time, LogLevel::Info, "scenario", note)?;
            }
        }
        Ok(recording.finish()?)
    }
}

/// Joins position and quaternion.
const fn flat([x, y, z]: [f64; 3], [a, b, c, d]: [f64; 4]) -> [f64; 7] {
    [x, y, z, a, b, c, d]
}

fn transform(placed: &Placed) -> Transform {
    Transform {
        parent: placed.parent.clone(),
        child: placed.child.clone(),
        translation: placed.pose.translation.vector.into(),
        rotation_xyzw: placed.pose.rotation.coords.into(),
    }
}

/// Returns a viewer's marker for a body.
fn marker(id: i32, object: &Object, base: &str) -> Marker {
    let [x, y, z, a, b, c, d] = object.pose;
    let shape = match object.shape {
        Shape::Box(size) => MarkerShape::Box(size),
        Shape::Cylinder(size) => MarkerShape::Cylinder(size),
        Shape::Wedge(size) => MarkerShape::Triangles(wedge(size)),
    };
    // Grasped objects get a different colour from fixed bodies.
    let colour = if object.frame.is_some() { [0.85, 0.55, 0.2, 1.0] } else { [0.6, 0.6, 0.6, 0.8] };
    let frame = object.frame.as_deref().unwrap_or(base).to_owned();
    Marker { id, frame, pose: ([x, y, z], [a, b, c, d]), shape, colour }
}

/// Returns the surface of a cuboid whose width along x is scaled by `top` at its top.
fn wedge([x, y, z, top]: [f64; 4]) -> Vec<[f64; 3]> {
    let corner = |index: usize| {
        let sign = |bit: usize| if index >> bit & 1 == 0 { -0.5 } else { 0.5 };
        let width = if sign(2) > 0.0 { top * x } else { x };
        [sign(0) * width, sign(1) * y, sign(2) * z]
    };
    // Four corners of each face, counter-clockwise from outside; bit 0 is x, bit 1 is y, bit 2 is z.
    let faces = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [3, 2, 6, 7], [2, 0, 4, 6], [1, 3, 7, 5]];
    faces.into_iter().flat_map(|[a, b, c, d]| [a, b, c, a, c, d].map(corner)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_recording_holds_further_frames() {
        let truth = Truth {
            positions: vec![0.5],
            velocities: vec![0.0],
            torques: vec![0.1],
            homing_errors: vec![0.0],
        };
        let mut motion = Motion::new(["elbow"]);
        motion.tick(&truth);
        motion.frame(Transform {
            parent: "palm".into(),
            child: "grasped box".into(),
            translation: [0.0; 3],
            rotation_xyzw: [0.0, 0.0, 0.0, 1.0],
        });
        let file = tempfile::NamedTempFile::new().expect("there is room for a file");
        motion.write(file.path(), r#"<robot name="r"/>"#).expect("it can be written");
        let bytes = std::fs::read(file.path()).expect("it was written");
        assert!(bytes.windows(11).any(|part| part == b"grasped box"));
        let error = motion.write(file.path(), "<robot>").expect_err("half a robot").to_string();
        assert!(error.starts_with("the URDF of the recording: "), "{error}");
    }

    #[test]
    fn a_replay_shows_bodies_and_notes_at_their_times() {
        let robot = Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3");
        let robot = tesaki_description::robot::RobotFolder::load(&robot).expect("it is a robot folder");
        let support = Some(crate::plant::Support {
            size: [0.1, 0.1, 0.02],
            position: [0.0, 0.0, -0.04],
            orientation: [0.0, 0.0, 0.0, 1.0],
        });
        let cylinder = ObjectValues {
            shape: Solid::Cylinder,
            size: [0.06, 0.06, 0.1],
            mass: 0.1,
            friction: 0.5,
            friction_spread: 0.0,
            position: [0.0; 3],
            orientation: [0.0, 0.0, 0.0, 1.0],
            support,
        };
        let mut motion = Motion::new(["joint"]);
        motion.object(&cylinder, true);
        for tick in 0..40 {
            let positions = vec![f64::from(tick)];
            motion.tick(&Truth {
                positions,
                velocities: vec![0.0],
                torques: vec![0.0],
                homing_errors: vec![0.0],
            });
            if tick == 20 {
                motion.note("lifted");
                motion.object(&cylinder, false);
            }
        }
        let replay = motion.replay(Scene::new(&robot.model));
        let angles: Vec<f64> = replay.samples.iter().map(|sample| sample.positions[0]).collect();
        assert_eq!((replay.period, angles[..3].to_vec(), angles.len()), (0.02, vec![0.0, 2.0, 4.0], 20));
        assert_eq!(replay.notes, [Note { time: 0.2, text: "lifted".to_owned() }]);
        let bodies: Vec<(f64, bool)> =
            replay.objects.iter().map(|object| (object.since, object.frame.is_some())).collect();
        assert_eq!(
            bodies,
            [(0.0, true), (0.0, false), (0.21, true)],
            "the support goes in the tick after the note"
        );
        assert_eq!(replay.objects[0].shape, Shape::Cylinder([0.03, 0.1]));
    }

    #[test]
    fn the_surface_of_a_wedge_encloses_its_volume() {
        // Six times the volume of the tetrahedra with the origin, which is positive only if all faces point
        // outwards.
        let corners = wedge([0.06, 0.05, 0.1, 0.5]);
        let volumes: Vec<f64> = corners
            .chunks(3)
            .map(|c| Vector3::from(c[0]).cross(&Vector3::from(c[1])).dot(&Vector3::from(c[2])) / 6.0)
            .collect();
        assert_eq!(volumes.len(), 12);
        assert!(volumes.iter().all(|volume| *volume > 0.0), "{volumes:?}");
        let volume: f64 = volumes.iter().sum();
        assert!((volume - 0.045 * 0.05 * 0.1).abs() < 1e-15, "{volume}");
    }
}
