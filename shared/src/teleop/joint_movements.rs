use nalgebra::{Matrix3, Vector3};

use super::human_hand::{FingerRotations, HumanFinger};
use crate::math::{self, Svd};

/// Statistics of a finger's joint movements in the postures: sums and scatter of the rotation vectors from
/// the first posture.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct JointMovements {
    pub first: Option<[Matrix3<f32>; 3]>,
    weight: f32,
    sum: [Vector3<f32>; 3],
    squares: [Matrix3<f32>; 3],
}

impl JointMovements {
    pub fn add(&mut self, rotations: &FingerRotations, forgetting: f32) {
        let joints = rotations.joints();
        let first = *self.first.get_or_insert(joints);
        self.weight = forgetting * self.weight + 1.0;
        let sums = self.sum.iter_mut().zip(&mut self.squares);
        for ((sum, squares), (first, rotation)) in sums.zip(first.iter().zip(&joints)) {
            let vector = math::rotation_vector(&(first.transpose() * rotation));
            *sum = *sum * forgetting + vector;
            *squares = *squares * forgetting + vector * vector.transpose();
        }
    }

    /// Principal axes of a joint's rotations, bending first, and the standard deviation about the bending
    /// axis.
    fn axes(&self, joint: usize) -> ([Vector3<f32>; 2], f32) {
        let weight = self.weight.max(1.0);
        let mean = self.sum[joint] / weight;
        let covariance = self.squares[joint] / weight - mean * mean.transpose();
        let svd = Svd::new(&covariance);
        let mut bend: Vector3<f32> = svd.right.column(0).into();
        // From the flat hand a finger bends in one direction only.
        if bend.dot(&mean) < 0.0 {
            bend = -bend;
        }
        ([bend, svd.right.column(1).into()], math::sqrt(svd.values[0]))
    }

    pub fn largest_deviation(&self) -> f32 {
        (0..3).fold(0.0, |largest, joint| self.axes(joint).1.max(largest))
    }

    /// The posture with angles from the first posture [rad]: base bent, base spread, middle bent, end bent.
    pub fn posture(&self, [base, spread, middle, end]: [f32; 4]) -> FingerRotations {
        let first = self.first.unwrap_or([Matrix3::identity(); 3]);
        let [([principal, second], _), ([middle_axis, _], _), ([end_axis, _], _)] =
            [0, 1, 2].map(|joint| self.axes(joint));
        // If the finger was spread but not bent at the palm, it is assumed to bend there about the axis of
        // the middle joint.
        let parallel = first[1] * middle_axis;
        let [bend_axis, spread_axis] = if math::abs(principal.dot(&parallel)) < 0.3 {
            [parallel, principal]
        } else {
            [principal, second]
        };
        let vectors = [bend_axis * base + spread_axis * spread, middle_axis * middle, end_axis * end];
        let mut joints = first;
        joints.iter_mut().zip(&vectors).for_each(|(joint, vector)| *joint *= math::rotation_matrix(vector));
        FingerRotations::from_joints(joints)
    }
}

/// Angles of a finger from the flat hand [°]: minimum, middle and maximum.
pub(super) struct JointRange {
    base: [f32; 3],
    spread: [f32; 3],
    middle: [f32; 3],
    end: [f32; 3],
    /// Bending of the end joint per bending of the middle one.
    coupling: f32,
}

impl JointRange {
    const FINGER: Self = Self {
        base: [0.0, 40.0, 80.0],
        spread: [-10.0, 0.0, 10.0],
        middle: [0.0, 45.0, 90.0],
        end: [-10.0, 0.0, 10.0],
        coupling: 2.0 / 3.0,
    };
    const THUMB: Self = Self {
        base: [0.0, 20.0, 40.0],
        spread: [-20.0, 0.0, 20.0],
        middle: [0.0, 25.0, 50.0],
        end: [0.0, 35.0, 70.0],
        coupling: 0.0,
    };

    pub const fn of(finger: HumanFinger) -> &'static Self {
        match finger {
            HumanFinger::Thumb => &Self::THUMB,
            _ => &Self::FINGER,
        }
    }

    /// Angles [rad] of levels 0 to 2.
    pub fn angles(&self, [base, spread, middle, end]: [usize; 4]) -> [f32; 4] {
        let (base, spread, middle, end) =
            (self.base[base], self.spread[spread], self.middle[middle], self.end[end]);
        [base, spread, middle, end + self.coupling * middle].map(f32::to_radians)
    }
}
