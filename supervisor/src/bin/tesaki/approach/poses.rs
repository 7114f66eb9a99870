//! Where the hand was when a picture was exposed.

use std::collections::VecDeque;
use std::time::{Duration, Instant};

use nalgebra::{Quaternion, UnitQuaternion, Vector3};
use tesaki::model::Pose;
use tesaki::protocol::Telemetry;

/// So long poses are kept: longer than the age of any picture.
const MEMORY: Duration = Duration::from_millis(1200);
/// A picture that is exposed after the last telemetry, by this at most, is taken from there.
const AHEAD: Duration = Duration::from_millis(60);
/// Telemetries of which the soonest one tells when a tick of the board was.
const COMPARED: usize = 10;

/// The poses of the hand of late, by the clock of this PC.
pub struct Poses<F> {
    /// From the angles of the joints.
    hand: F,
    /// The first tick, and when its telemetry came.
    origin: Option<(u32, Instant)>,
    /// How much later than by the ticks since then the last telemetries came.
    delays: VecDeque<f64>,
    poses: VecDeque<(Instant, Pose)>,
}

impl<F: Fn(&[f32]) -> Option<Pose>> Poses<F> {
    pub const fn new(hand: F) -> Self {
        Self { hand, origin: None, delays: VecDeque::new(), poses: VecDeque::new() }
    }

    /// Takes a telemetry. What delays some of them, such as a link in use, does not count.
    pub fn add(&mut self, arrived: Instant, telemetry: &Telemetry) {
        let angles: Vec<f32> = telemetry.joints.iter().map(|joint| joint.position).collect();
        let Some(pose) = (self.hand)(&angles) else { return };
        let (first, start) = *self.origin.get_or_insert((telemetry.tick, arrived));
        let ticks = f64::from(telemetry.tick.wrapping_sub(first)) * f64::from(tesaki::TICK);
        let delay = arrived.saturating_duration_since(start).as_secs_f64() - ticks;
        if self.delays.len() == COMPARED {
            self.delays.pop_front();
        }
        self.delays.push_back(delay);
        let late = delay - self.delays.iter().copied().fold(delay, f64::min);
        // A board that was reset begins to count anew.
        let late = Duration::try_from_secs_f64(late).unwrap_or_default();
        let time = arrived.checked_sub(late).unwrap_or(arrived);
        if self.poses.back().is_none_or(|(last, _)| *last < time) {
            self.poses.push_back((time, pose));
        }
        while self.poses.front().is_some_and(|(old, _)| arrived.saturating_duration_since(*old) > MEMORY) {
            self.poses.pop_front();
        }
    }

    /// The pose at an instant, between those of two telemetries; `None` if it is not known.
    pub fn at(&self, time: Instant) -> Option<Pose> {
        let later = self.poses.iter().position(|(other, _)| *other >= time);
        let Some(later) = later else {
            let (last, pose) = self.poses.back()?;
            return (time.saturating_duration_since(*last) <= AHEAD).then_some(*pose);
        };
        let (end, to) = self.poses.get(later)?;
        if *end == time {
            return Some(*to);
        }
        let (begin, from) = self.poses.get(later.checked_sub(1)?)?;
        let part = (time - *begin).as_secs_f32() / (*end - *begin).as_secs_f32();
        Some(between(from, to, part))
    }
}

/// A pose between two that are near each other.
fn between(from: &Pose, to: &Pose, part: f32) -> Pose {
    let place = Vector3::from(from.translation).lerp(&Vector3::from(to.translation), part);
    let turn = |&[x, y, z, w]: &[f32; 4]| UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
    let rotation = turn(&from.rotation).nlerp(&turn(&to.rotation), part);
    Pose { translation: place.into(), rotation: rotation.coords.into() }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use tesaki::protocol::{JointTelemetry, Mode};

    use super::*;

    fn telemetry(tick: u32, position: f32) -> Telemetry {
        let joint = JointTelemetry { position, ..JointTelemetry::default() };
        Telemetry { tick, mode: Mode::Disabled, faults: 0, joints: [joint].into_iter().collect() }
    }

    /// The angle of the joint is the place along x.
    fn poses() -> Poses<impl Fn(&[f32]) -> Option<Pose>> {
        Poses::new(|angles: &[f32]| Some(Pose { translation: [angles[0], 0.0, 0.0], ..Pose::IDENTITY }))
    }

    #[test]
    fn a_hand_in_motion_is_found_between_two_telemetries_although_some_come_late() {
        let (mut poses, start) = (poses(), Instant::now());
        let at = |seconds: f64| start + Duration::from_secs_f64(seconds);
        for number in 0..50_u8 {
            // 20 ms apart, 0.1 m/s; every third one 8 ms late.
            let time = 0.02 * f64::from(number);
            let late = if number % 3 == 1 { 0.008 } else { 0.0 };
            poses.add(at(time + late), &telemetry(1000 + 2 * u32::from(number), 0.002 * f32::from(number)));
        }
        for time in [0.205, 0.531, 0.9] {
            let place = poses.at(at(time)).unwrap().translation[0];
            assert!((f64::from(place) - 0.1 * time).abs() < 1e-5, "{place} m at {time} s");
        }
        // The last one holds for a while; what is older than all is not known.
        assert!((poses.at(at(1.0)).unwrap().translation[0] - 0.098).abs() < 1e-6);
        assert!(poses.at(at(1.1)).is_none());
        assert!(poses.at(start - Duration::from_millis(1)).is_none());
    }
}
