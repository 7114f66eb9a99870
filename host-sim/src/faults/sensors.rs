//! Faults of sensors, supply and drives, applied to the frames between board and plant.

use std::collections::VecDeque;

use tesaki::protocol::{ActuatorFrame, SensorFrame};
use tesaki_rng::Rng;

use super::schedule::{Fault, Kind};

/// The plant link under faults.
pub struct PlantLink {
    rng: Rng,
    /// The last true frame.
    last: SensorFrame,
    /// Indices of the faults that freeze encoders, and the counts.
    stuck: Vec<(usize, i32)>,
    /// Commanded torques of the last ticks, the newest first.
    torques: VecDeque<Vec<f32>>,
    /// Number of ticks for which they are kept: the largest delay of a drive, and this tick.
    kept: usize,
}

impl PlantLink {
    /// The link in a run with these faults.
    pub fn new(rng: Rng, faults: &[Fault]) -> Self {
        let latest = faults.iter().map(|fault| fault.kind.lateness()).max().unwrap_or(0);
        let (last, kept) = (SensorFrame::default(), 1 + latest as usize);
        Self { rng, last, stuck: Vec::new(), torques: VecDeque::new(), kept }
    }

    /// Returns the frame that the board reads instead of `frame`.
    pub fn sense(&mut self, frame: &SensorFrame, faults: &[Fault], tick: u32) -> SensorFrame {
        let mut read = frame.clone();
        for (index, fault) in faults.iter().enumerate().filter(|(_, fault)| fault.acts(tick)) {
            let noise = self.rng.normal();
            match fault.kind {
                Kind::Stuck { joint } => {
                    let stuck = self.stuck.iter().find(|(of, _)| *of == index).map(|(_, count)| *count);
                    let before = self.last.encoders.get(joint).or(frame.encoders.get(joint));
                    let count = stuck.or(before.copied()).unwrap_or(0);
                    if stuck.is_none() {
                        self.stuck.push((index, count));
                    }
                    set(&mut read.encoders, joint, |_| count);
                }
                Kind::Jump { joint, counts } => {
                    set(&mut read.encoders, joint, |count| count.wrapping_add(counts));
                }
                Kind::Drift { joint, rate } => {
                    let drift = (rate * f64::from(tick - fault.begin)) as i32;
                    set(&mut read.encoders, joint, |count| count.wrapping_add(drift));
                }
                Kind::Noise { joint, counts } => {
                    let noise = (counts * noise).round() as i32;
                    set(&mut read.encoders, joint, |count| count.wrapping_add(noise));
                }
                Kind::Swapped { joint, other } if joint.max(other) < read.encoders.len() => {
                    read.encoders.swap(joint, other);
                }
                Kind::Saturation { sensor } => set(&mut read.forces, sensor, |_| [32_767, 0, 0, 0, 0, 0]),
                Kind::ForceLow { sensor } => set(&mut read.forces, sensor, |_| [0; 6]),
                Kind::Sag { voltage } | Kind::Surge { voltage } => {
                    read.supply = (1e3 * voltage).clamp(0.0, 65_535.0) as u16;
                }
                _ => {}
            }
        }
        self.last.clone_from(frame);
        read
    }

    /// Returns the frame that the drives execute instead of `frame`.
    pub fn drive(&mut self, frame: &ActuatorFrame, faults: &[Fault], tick: u32) -> ActuatorFrame {
        let mut driven = frame.clone();
        self.torques.push_front(frame.torques.to_vec());
        self.torques.truncate(self.kept);
        for fault in faults.iter().filter(|fault| fault.acts(tick)) {
            match fault.kind {
                Kind::Weak { joint, factor } => {
                    set(&mut driven.torques, joint, |torque| torque * factor as f32);
                }
                Kind::Reversed { joint } => set(&mut driven.torques, joint, |torque| -torque),
                Kind::Dead { joint } => set(&mut driven.torques, joint, |_| 0.0),
                Kind::Late { joint, late } => {
                    let before = self.torques.get(late as usize).and_then(|torques| torques.get(joint));
                    let before = before.copied().unwrap_or(0.0);
                    set(&mut driven.torques, joint, |_| before);
                }
                _ => {}
            }
        }
        driven
    }
}

fn set<T: Copy>(values: &mut [T], index: usize, change: impl FnOnce(T) -> T) {
    if let Some(value) = values.get_mut(index) {
        *value = change(*value);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sensed(kind: Kind, counts: &[[i32; 2]]) -> Vec<Vec<i32>> {
        let faults = [Fault { kind, begin: 1, ticks: Some(2) }];
        let mut link = PlantLink::new(Rng::new(1, 0), &faults);
        let read = |(tick, counts): (u32, &[i32; 2])| {
            let frame = SensorFrame { encoders: counts.iter().copied().collect(), ..SensorFrame::default() };
            link.sense(&frame, &faults, tick).encoders.to_vec()
        };
        (0..).zip(counts).map(read).collect()
    }

    #[test]
    fn encoders_fail_as_told_and_recover() {
        let counts = [[10, 0], [20, 0], [30, 0], [40, 0]];
        let first = |kind| sensed(kind, &counts).iter().map(|counts| counts[0]).collect::<Vec<_>>();
        assert_eq!(first(Kind::Stuck { joint: 0 }), [10, 10, 10, 40]);
        assert_eq!(first(Kind::Jump { joint: 0, counts: 5 }), [10, 25, 35, 40]);
        assert_eq!(first(Kind::Drift { joint: 0, rate: 7.0 }), [10, 20, 37, 40]);
        assert_eq!(first(Kind::Swapped { joint: 0, other: 1 }), [10, 0, 0, 40]);
    }

    #[test]
    fn drives_fail_as_told() {
        let driven = |kind, ticks: u8| {
            let faults = [Fault { kind, begin: 1, ticks: None }];
            let mut link = PlantLink::new(Rng::new(1, 0), &faults);
            let drive = |tick: u8| {
                let torques = [f32::from(tick) + 1.0].into_iter().collect();
                let frame = ActuatorFrame { sequence: 0, enabled: true, torques };
                link.drive(&frame, &faults, tick.into()).torques[0]
            };
            (0..ticks).map(drive).collect::<Vec<f32>>()
        };
        assert_eq!(driven(Kind::Weak { joint: 0, factor: 0.5 }, 4), [1.0, 1.0, 1.5, 2.0]);
        assert_eq!(driven(Kind::Reversed { joint: 0 }, 4), [1.0, -2.0, -3.0, -4.0]);
        assert_eq!(driven(Kind::Dead { joint: 0 }, 4), [1.0, 0.0, 0.0, 0.0]);
        assert_eq!(driven(Kind::Late { joint: 0, late: 2 }, 4), [1.0, 0.0, 1.0, 2.0]);
        assert_eq!(driven(Kind::Late { joint: 0, late: 20 }, 23)[18..], [0.0, 0.0, 1.0, 2.0, 3.0]);
    }
}
