use serde::Serialize;

use crate::scene::Scene;

/// Maximum number of samples of a replay: longer ones are resampled, so that a report stays small.
const MAX_SAMPLES: usize = 2000;

/// The motion of a run, for the page of a report. Lengths in m, angles in rad, forces in N.
#[derive(Clone, Debug, Serialize)]
pub struct Replay {
    /// The robot.
    pub scene: Scene,
    /// Interval between samples [s].
    pub period: f64,
    /// Objects that are grasped, opened or leaned on. At any time, those with the latest [`Object::since`]
    /// are shown.
    pub objects: Vec<Object>,
    /// Notes on what begins when.
    pub notes: Vec<Note>,
    /// The samples, the first of them at time 0.
    pub samples: Vec<Sample>,
}

/// A body that is no link of the robot.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Object {
    /// Time from which it replaces earlier objects [s].
    pub since: f64,
    /// The frame in [`Sample::frames`] that it moves with; `None` for a fixed object.
    pub frame: Option<String>,
    /// Its shape.
    pub shape: Shape,
    /// Where it is, in that frame or in the base frame: position and unit quaternion.
    pub pose: [f64; 7],
}

/// Shape of an object.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Shape {
    /// A cuboid with these extents.
    Box([f64; 3]),
    /// A cylinder along z: radius and length.
    Cylinder([f64; 2]),
    /// A cuboid whose faces across x lean inwards: extents, and the ratio of the widths at top and bottom.
    Wedge([f64; 4]),
}

/// A line of text, and when it was written [s].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Note {
    /// When [s].
    pub time: f64,
    /// The text.
    pub text: String,
}

/// Where a frame is: its name, and its pose in the base frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Frame(pub String, pub [f64; 7]);

/// A force that acts on an object or on a tip, with the direction into the object and the coefficient of
/// friction (each 0 if unknown).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Contact {
    /// Index of the tip.
    pub tip: usize,
    /// Where it acts, in the base frame.
    pub point: [f64; 3],
    /// The force, in the base frame.
    pub force: [f64; 3],
    /// Unit vector along the axis of its friction cone; 0 without one.
    pub normal: [f64; 3],
    /// Coefficient of friction.
    pub friction: f64,
}

/// The state at one time.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Sample {
    /// Joint angles.
    #[serde(rename = "q")]
    pub positions: Vec<f64>,
    /// Joint velocities [rad/s].
    #[serde(rename = "v")]
    pub velocities: Vec<f64>,
    /// Torques [N·m].
    #[serde(rename = "u")]
    pub torques: Vec<f64>,
    /// References of the joints; empty where there are none.
    #[serde(rename = "r", skip_serializing_if = "Vec::is_empty")]
    pub references: Vec<f64>,
    /// Frames that are no links.
    #[serde(rename = "f", skip_serializing_if = "Vec::is_empty")]
    pub frames: Vec<Frame>,
    /// Contacts that bear a force.
    #[serde(rename = "c", skip_serializing_if = "Vec::is_empty")]
    pub contacts: Vec<Contact>,
}

impl Sample {
    /// Rounds to as many digits as a page can show.
    #[must_use]
    pub fn rounded(&self) -> Self {
        let all = |values: &[f64]| values.iter().copied().map(round).collect();
        let mut sample = self.clone();
        sample.positions = all(&self.positions);
        sample.velocities = all(&self.velocities);
        sample.torques = all(&self.torques);
        sample.references = all(&self.references);
        for Frame(_, pose) in &mut sample.frames {
            *pose = pose.map(round);
        }
        for contact in &mut sample.contacts {
            contact.point = contact.point.map(round);
            contact.force = contact.force.map(round);
            contact.normal = contact.normal.map(round);
            contact.friction = round(contact.friction);
        }
        sample
    }
}

/// Rounds to a tenth of a millimetre, milliradian or millinewton-metre.
fn round(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

impl Replay {
    /// Creates the replay of samples that are `period` apart [s], resampled to at most 50 per second and to
    /// what a page can hold.
    pub fn new(scene: Scene, period: f64, samples: &[Sample]) -> Self {
        let every = samples.len().div_ceil(MAX_SAMPLES).max(2);
        let samples: Vec<Sample> = samples.iter().step_by(every).map(Sample::rounded).collect();
        #[expect(clippy::cast_precision_loss, reason = "at most some thousand")]
        let period = period * every as f64;
        Self { scene, period, objects: Vec::new(), notes: Vec::new(), samples }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_run_is_thinned_and_keeps_its_time() {
        let scene = Scene {
            name: "point".to_owned(),
            gravity: [0.0; 3],
            joints: Vec::new(),
            driven: 0,
            tips: Vec::new(),
            solids: Vec::new(),
        };
        let samples: Vec<Sample> = (0..12_001)
            .map(|tick| Sample { positions: vec![f64::from(tick) + 0.123_456], ..Sample::default() })
            .collect();
        let replay = Replay::new(scene.clone(), 0.01, &samples);
        // Every seventh of 12 001 samples is kept: 1715 of them, 70 ms apart.
        assert_eq!((replay.samples.len(), replay.period), (1715, 0.07));
        assert_eq!(replay.samples[2].positions, [14.123_5]);
        let short = Replay::new(scene, 0.01, &samples[..100]);
        assert_eq!((short.samples.len(), short.period), (50, 0.02));
    }
}
