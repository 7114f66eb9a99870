//! The operator's hand, the glove that measures the orientations of its segments, and the markers on its
//! fingertips.

use core::f64::consts::TAU;

use rapier3d::na::{Rotation3, UnitQuaternion, Vector3};
use tesaki::teleop::{GloveSample, HUMAN_FINGERS, HumanFinger};
use tesaki_rng::Rng;
use tesaki_supervisor::trajectory::minimum_jerk;

use crate::purpose::Purpose;

/// Joint angles of a finger relative to the flat hand [rad]: base bent, base spread, middle bent, end bent.
pub type FingerAngles = [f64; 4];

/// Bone lengths [mm] as in `tesaki::teleop`'s proportions: mean of 66 adults (Buryanov and Kotiuk 2010), the
/// last one including soft tissue.
const BONES: [[f64; 4]; HUMAN_FINGERS] = [
    [0.0, 46.22, 31.57, 27.34],
    [68.12, 39.78, 22.38, 19.66],
    [64.60, 44.63, 26.33, 21.35],
    [58.00, 41.37, 25.65, 21.25],
    [53.69, 32.74, 18.11, 19.69],
];
/// Bases of the metacarpals [mm], distal, radial and dorsal of the wrist, and their splay [°]; estimates.
const METACARPALS: [[f64; 4]; HUMAN_FINGERS] = [
    [20.0, 25.0, -10.0, 45.0],
    [25.0, 14.0, 0.0, 9.0],
    [25.0, 3.0, 0.0, 2.0],
    [25.0, -9.0, 0.0, -6.0],
    [25.0, -19.0, 0.0, -13.0],
];
/// Ranges of the joints [°]: base bent, base spread, middle bent, end bent.
const FINGER_RANGE: [[f64; 2]; 4] = [[0.0, 80.0], [-12.0, 12.0], [0.0, 95.0], [0.0, 70.0]];
const THUMB_RANGE: [[f64; 2]; 4] = [[0.0, 40.0], [-20.0, 20.0], [0.0, 50.0], [0.0, 70.0]];

/// An operator's hand with rigid links and hinges: x distal, y toward the thumb, z dorsal.
#[derive(Clone, Debug)]
pub struct OperatorHand {
    fingers: [HandFinger; HUMAN_FINGERS],
}

#[derive(Clone, Debug)]
struct HandFinger {
    /// `l0` in the frame of the back of the hand, the others in the frames of their segments [m].
    links: [Vector3<f64>; 4],
    /// Orientation of the first segment in the flat hand.
    rest: UnitQuaternion<f64>,
    /// Axes of base bending, spreading, middle and end joint, in the frames of the segments before them.
    axes: [Vector3<f64>; 4],
    /// Orientations of the sensors on the segments.
    mounts: [UnitQuaternion<f64>; 3],
    /// Bending of the end joint per radian of the middle one.
    coupling: f64,
    range: [[f64; 2]; 4],
}

impl OperatorHand {
    /// Draws the hand of a seed. The standard deviation of the hand's size is 7 %, of bone ratios 5 %, of the
    /// positions of the first joints 3 mm, and of the link ends across the bone 1 mm; hinges are tilted by
    /// 4°, sensors by 5°. The end joint bends with 0.67 ± 0.08 of the middle one.
    pub fn random(seed: u64) -> Self {
        let mut rng = Purpose::OperatorHand.rng(seed);
        let size = 1.0 + 0.07 * rng.normal();
        let fingers = HumanFinger::ALL.map(|finger| {
            let thumb = finger == HumanFinger::Thumb;
            let [metacarpal, bones @ ..] = BONES[finger as usize];
            let [x, y, z, splay] = METACARPALS[finger as usize];
            let splay = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), splay.to_radians());
            let base = Vector3::new(x, y, z) + splay * Vector3::new(metacarpal, 0.0, 0.0);
            let mut vector = |deviation: f64| Vector3::from_fn(|_, _| deviation * rng.normal());
            let mut links = [size * 1e-3 * base + vector(3e-3); 4];
            for (link, bone) in links[1..].iter_mut().zip(bones) {
                let random = vector(1.0);
                *link = Vector3::new(
                    size * 1e-3 * bone * (1.0 + 0.05 * random.x),
                    1e-3 * random.y,
                    1e-3 * random.z,
                );
            }
            let mut tilted = |axis: Vector3<f64>| UnitQuaternion::from_scaled_axis(vector(0.07)) * axis;
            let axes = [Vector3::y(), Vector3::z(), Vector3::y(), Vector3::y()].map(&mut tilted);
            let mounts = [0; 3].map(|_| UnitQuaternion::from_scaled_axis(vector(0.087)));
            // The thumb bends across the palm.
            let opposed = Rotation3::from_euler_angles(-1.0, 0.3, 0.0);
            let rest = if thumb { splay * UnitQuaternion::from(opposed) } else { splay };
            let coupling = 0.67 + 0.08 * vector(1.0).x;
            let range =
                if thumb { THUMB_RANGE } else { FINGER_RANGE }.map(|range| range.map(f64::to_radians));
            HandFinger { links, rest, axes, mounts, coupling, range }
        });
        Self { fingers }
    }

    /// Returns the orientations of a finger's sensors, and the position of its tip [m], in the frame of the
    /// back of the hand.
    pub fn finger(
        &self,
        finger: HumanFinger,
        angles: &FingerAngles,
    ) -> ([UnitQuaternion<f64>; 3], Vector3<f64>) {
        let HandFinger { links, rest, axes, mounts, .. } = &self.fingers[finger as usize];
        let turn = |joint: usize| UnitQuaternion::from_scaled_axis(axes[joint] * angles[joint]);
        let first = rest * turn(1) * turn(0);
        let second = first * turn(2);
        let third = second * turn(3);
        let segments = [first, second, third];
        let tip = links[0] + (0..3).map(|k| segments[k] * links[k + 1]).sum::<Vector3<f64>>();
        (core::array::from_fn(|k| segments[k] * mounts[k]), tip)
    }

    /// Returns the posture whose fingertips are nearest to given ones [m], starting from half-bent fingers.
    pub fn imitate(&self, tips: &[Vector3<f64>; HUMAN_FINGERS]) -> [FingerAngles; HUMAN_FINGERS] {
        let half =
            core::array::from_fn(|number| self.fingers[number].range.map(|[low, high]| 0.5 * (low + high)));
        HumanFinger::ALL.into_iter().fold(half, |posture, finger| {
            let cost = |angles: &[FingerAngles; HUMAN_FINGERS]| {
                (self.tip(finger, angles) - tips[finger as usize]).norm() + self.strain(finger, angles)
            };
            self.descend(posture, &[finger], cost)
        })
    }

    /// Returns a posture in which the tip of the thumb touches that of a finger: the best of four coordinate
    /// descents from random postures. Skin and nail offset the tips from each other by a random 2 mm along
    /// each axis.
    fn pinch(&self, finger: HumanFinger, rng: &mut Rng) -> [FingerAngles; HUMAN_FINGERS] {
        let offset = Vector3::from_fn(|_, _| 2e-3 * rng.normal());
        let cost = |angles: &[FingerAngles; HUMAN_FINGERS]| {
            let gap = self.tip(finger, angles) - self.tip(HumanFinger::Thumb, angles) - offset;
            gap.norm() + self.strain(finger, angles)
        };
        let mut descend = || self.descend(self.posture(rng), &[HumanFinger::Thumb, finger], cost);
        let mut best = descend();
        for _ in 1..4 {
            let other = descend();
            if cost(&other) < cost(&best) {
                best = other;
            }
        }
        best
    }

    /// Position of a finger's tip [m].
    fn tip(&self, finger: HumanFinger, angles: &[FingerAngles; HUMAN_FINGERS]) -> Vector3<f64> {
        self.finger(finger, &angles[finger as usize]).1
    }

    /// Cost of bending an end joint independently of the middle one, which is not possible [m].
    fn strain(&self, finger: HumanFinger, angles: &[FingerAngles; HUMAN_FINGERS]) -> f64 {
        if finger == HumanFinger::Thumb {
            return 0.0;
        }
        let [_, _, middle, end] = angles[finger as usize];
        let apart = (end - self.fingers[finger as usize].coupling * middle).abs();
        0.02 * (apart - 0.14).max(0.0)
    }

    /// Minimises a cost over the joints of some fingers by coordinate descent.
    fn descend(
        &self,
        mut angles: [FingerAngles; HUMAN_FINGERS],
        fingers: &[HumanFinger],
        cost: impl Fn(&[FingerAngles; HUMAN_FINGERS]) -> f64,
    ) -> [FingerAngles; HUMAN_FINGERS] {
        let mut step = 0.3;
        while step > 1e-3 {
            let before = cost(&angles);
            for (n, joint) in
                fingers.iter().flat_map(|&finger| (0..4).map(move |joint| (finger as usize, joint)))
            {
                for change in [step, -step] {
                    let mut other = angles;
                    let [low, high] = self.fingers[n].range[joint];
                    other[n][joint] = (other[n][joint] + change).clamp(low, high);
                    if cost(&other) < cost(&angles) {
                        angles = other;
                    }
                }
            }
            if cost(&angles) > 0.99 * before {
                step *= 0.6;
            }
        }
        angles
    }

    /// Draws a random posture in which the fingers bend more or less together.
    fn posture(&self, rng: &mut Rng) -> [FingerAngles; HUMAN_FINGERS] {
        let common = [rng.uniform(), rng.uniform()];
        core::array::from_fn(|number| {
            let HandFinger { range, coupling, .. } = &self.fingers[number];
            let thumb = number == HumanFinger::Thumb as usize;
            let mut within = |joint: usize, common: Option<f64>| {
                let own = rng.uniform();
                let [low, high] = range[joint];
                low + (high - low) * common.map_or(own, |common| 0.5 * common + 0.5 * own)
            };
            let base = within(0, (!thumb).then_some(common[0]));
            let middle = within(2, (!thumb).then_some(common[1]));
            let spread = within(1, None);
            let end = within(3, None);
            if thumb {
                return [base, spread, middle, end];
            }
            // A bent finger can hardly be spread; the end joint follows the middle one within 8°.
            let spread = spread * (1.0 - base / 1.75);
            let [_, largest] = range[3];
            [base, spread, middle, (coupling * middle + 0.28 * (end / largest - 0.5)).max(0.0)]
        })
    }
}

/// A motion of the fingers: minimum-jerk movements between postures, with pauses.
#[derive(Clone, Debug)]
pub struct FingersMotion {
    /// Times at which each posture is reached and left [s].
    stops: Vec<([f64; 2], [FingerAngles; HUMAN_FINGERS])>,
    /// Amplitude of the rotation of the back of the hand [rad], and its phase.
    sway: [Vector3<f64>; 2],
}

impl FingersMotion {
    /// Creates a motion from the flat hand through `count` random postures: each movement takes `movement`
    /// [s], each posture is held for `hold` [s].
    pub fn random(
        hand: &OperatorHand,
        seed: u64,
        part: u64,
        count: usize,
        movement: [f64; 2],
        hold: f64,
    ) -> Self {
        let mut rng = Purpose::FingersMotion.rng(seed.wrapping_add(part << 32));
        let mut stops = vec![([0.0, hold], [[0.0; 4]; HUMAN_FINGERS])];
        let mut time = hold;
        for _ in 0..count {
            time += movement[0] + (movement[1] - movement[0]) * rng.uniform();
            stops.push(([time, time + hold], hand.posture(&mut rng)));
            time += hold;
        }
        let sway = [0.3, 3.0].map(|size| Vector3::from_fn(|_, _| size * rng.symmetric()));
        Self { stops, sway }
    }

    /// Returns the same motion with another first posture, and the other postures moved towards it;
    /// `fraction` of the distance remains.
    #[must_use]
    pub fn around(mut self, first: [FingerAngles; HUMAN_FINGERS], fraction: f64) -> Self {
        for (number, (_, posture)) in self.stops.iter_mut().enumerate() {
            let fraction = if number == 0 { 0.0 } else { fraction };
            for (angle, from) in posture.iter_mut().flatten().zip(first.iter().flatten()) {
                *angle = from + fraction * (*angle - from);
            }
        }
        self
    }

    /// Creates a motion as [`Self::random`], through postures in which the thumb touches one finger after
    /// another.
    pub fn pinches(
        hand: &OperatorHand,
        seed: u64,
        fingers: &[HumanFinger],
        movement: f64,
        hold: f64,
    ) -> Self {
        let mut rng = Purpose::Pinches.rng(seed);
        let mut motion = Self::random(hand, seed, 2, 0, [movement; 2], hold);
        for finger in fingers {
            let begin = motion.duration() + movement;
            motion.stops.push(([begin, begin + hold], hand.pinch(*finger, &mut rng)));
        }
        motion
    }

    /// Times at which each posture is reached and left [s].
    pub fn holds(&self) -> impl Iterator<Item = [f64; 2]> {
        self.stops.iter().map(|(hold, _)| *hold)
    }

    /// Duration [s].
    pub fn duration(&self) -> f64 {
        self.stops.last().map_or(0.0, |([_, end], _)| *end)
    }

    /// Returns the orientation of the back of the hand, and the joint angles, at a time [s].
    pub fn at(&self, time: f64) -> (UnitQuaternion<f64>, [FingerAngles; HUMAN_FINGERS]) {
        let next = self.stops.partition_point(|([reached, _], _)| *reached <= time);
        let ([_, left], from) = self.stops[next.saturating_sub(1)];
        let angles = match self.stops.get(next) {
            Some(([reached, _], to)) => {
                let [fraction, ..] = minimum_jerk((time - left) / (reached - left));
                let between =
                    |joint: usize, n: usize| from[n][joint] + fraction * (to[n][joint] - from[n][joint]);
                core::array::from_fn(|n| core::array::from_fn(|joint| between(joint, n)))
            }
            None => from,
        };
        let [size, phase] = self.sway;
        let sway = Vector3::from_fn(|axis, _| size[axis] * libm::sin(TAU * 0.2 * time + phase[axis]));
        (UnitQuaternion::from_scaled_axis(sway), angles)
    }
}

/// Errors of the glove's orientation sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GloveValues {
    /// Sampling rate [Hz].
    pub rate: f64,
    /// Root mean square of a sensor's error over all axes [rad]: a Gauss-Markov process.
    pub noise: f64,
    /// Bandwidth of the noise [Hz].
    pub bandwidth: f64,
    /// Root mean square of the drift about the vertical [rad]: a Gauss-Markov process with a time constant of
    /// one minute.
    pub drift: f64,
    /// A magnetic disturbance: its start and end [s], and the angle by which it rotates the sensors of the
    /// index finger about the vertical [rad].
    pub disturbance: Option<([f64; 2], f64)>,
    /// Probability that a sensor's sample is lost.
    pub dropouts: f64,
}

impl Default for GloveValues {
    /// 1.5° with a bandwidth of 10 Hz, at 100 samples per second.
    fn default() -> Self {
        Self {
            rate: 100.0,
            noise: 1.5_f64.to_radians(),
            bandwidth: 10.0,
            drift: 0.0,
            disturbance: None,
            dropouts: 0.01,
        }
    }
}

/// Noise and drift of one sensor [rad].
#[derive(Clone, Copy, Debug, Default)]
struct SensorError {
    noise: Vector3<f64>,
    drift: f64,
}

/// The glove: 16 orientation sensors.
#[derive(Clone, Debug)]
pub struct Glove {
    values: GloveValues,
    errors: [SensorError; 1 + 3 * HUMAN_FINGERS],
    count: u32,
    rng: Rng,
}

impl Glove {
    /// Creates a glove whose errors are in their steady state.
    pub fn new(values: GloveValues, seed: u64) -> Self {
        let mut rng = Purpose::Glove.rng(seed);
        let deviation = values.noise / libm::sqrt(3.0);
        let errors = core::array::from_fn(|_| SensorError {
            noise: Vector3::from_fn(|_, _| deviation * rng.normal()),
            drift: values.drift * rng.normal(),
        });
        Self { values, errors, count: 0, rng }
    }

    /// Takes the next sample: its time [s] and the orientations.
    pub fn sample(&mut self, hand: &OperatorHand, motion: &FingersMotion) -> (f64, GloveSample) {
        let GloveValues { rate, noise, bandwidth, drift, disturbance, dropouts } = self.values;
        let time = f64::from(self.count) / rate;
        self.count += 1;
        for error in &mut self.errors {
            // Exact discretisation of the Gauss-Markov processes.
            let decay = libm::exp(-TAU * bandwidth / rate);
            let driven = noise / libm::sqrt(3.0) * libm::sqrt(1.0 - decay * decay);
            error.noise = error.noise * decay + Vector3::from_fn(|_, _| driven * self.rng.normal());
            let decay = libm::exp(-1.0 / (60.0 * rate));
            error.drift = error.drift * decay + drift * libm::sqrt(1.0 - decay * decay) * self.rng.normal();
        }
        let (back, angles) = motion.at(time);
        let turned = |sensor: usize| match disturbance {
            Some(([begin, end], angle)) if (4..7).contains(&sensor) && time >= begin && time < end => angle,
            _ => 0.0,
        };
        let errors = self.errors;
        let mut measure = |sensor: usize, truth: UnitQuaternion<f64>| {
            let vertical = Vector3::new(0.0, 0.0, errors[sensor].drift + turned(sensor));
            let measured = UnitQuaternion::from_scaled_axis(errors[sensor].noise + vertical) * truth;
            let [x, y, z, w] = measured.coords.into();
            let lost = self.rng.chance(dropouts);
            (!lost).then_some([x, y, z, w].map(|component: f64| component as f32))
        };
        let mut sample = GloveSample { back: measure(0, back), ..GloveSample::default() };
        for (number, finger) in HumanFinger::ALL.into_iter().enumerate() {
            let (segments, _) = hand.finger(finger, &angles[number]);
            for (segment, orientation) in segments.into_iter().enumerate() {
                sample.segments[number][segment] = measure(1 + 3 * number + segment, back * orientation);
            }
        }
        (time, sample)
    }
}

/// Optical markers on the fingertips.
#[derive(Clone, Debug)]
pub struct FingertipMarkers {
    /// Standard deviation along each axis [m].
    pub noise: f64,
    /// Probability that a marker is hidden in a pose.
    pub occlusion: f64,
    rng: Rng,
}

impl FingertipMarkers {
    /// Markers with 0.3 mm of noise, a sixth of them hidden.
    pub fn new(seed: u64) -> Self {
        Self { noise: 3e-4, occlusion: 1.0 / 6.0, rng: Purpose::FingertipMarkers.rng(seed) }
    }

    /// Measures the visible markers, in the frame of the back of the hand [m].
    pub fn measure(
        &mut self,
        hand: &OperatorHand,
        angles: &[FingerAngles; HUMAN_FINGERS],
    ) -> [Option<[f32; 3]>; HUMAN_FINGERS] {
        core::array::from_fn(|number| {
            let (_, tip) = hand.finger(HumanFinger::ALL[number], &angles[number]);
            let measured = tip + Vector3::from_fn(|_, _| self.noise * self.rng.normal());
            let hidden = self.rng.chance(self.occlusion);
            (!hidden).then_some([measured.x, measured.y, measured.z].map(|component| component as f32))
        })
    }
}
