//! Runs that reach every task.

use tesaki::protocol::{Request, RequestFrame};
use tesaki::task::TaskConfig;

/// A step that ticks repeatedly.
const RUN: [u8; 2] = [0, 64 + 63];

/// Returns runs of each robot and each task.
pub fn seeds() -> Vec<Vec<u8>> {
    let mut seeds = Vec::new();
    for robot in 0..3 {
        let homed = robot | 8;
        let mut add = |steps: &[&[u8]]| seeds.push([&[homed], &*steps.concat()].concat());
        for servo in 0..2 {
            add(&[&[6, servo], &[9, 0, 20, 20, 20, 20, 20, 20, 20, 20, 20], &RUN, &RUN, &[15, 0], &RUN]);
            add(&[
                &[6, servo],
                &RUN,
                &[9, 1, 1, 1, 1, 1, 1, 1, 1, 1],
                &RUN,
                &[15, 1],
                &RUN,
                &[8],
                &[6, servo],
            ]);
            add(&[&[6, servo], &RUN, &[9, 2], &RUN, &[1, 1, 0, 255, 255, 255, 127], &RUN, &[8], &RUN]);
            add(&[&[6, servo], &[9, 3], &RUN, &[1, 32, 5], &RUN, &[1, 16, 1], &RUN, &[15, 0], &[8], &RUN]);
        }
        // Model, export, commands of other clients.
        add(&[&[12, 1, 40, 0, 2], &RUN, &[13, 0], &[13, 1], &[6, 0], &RUN]);
        add(&[&[15, 4], &[15, 3], &[6, 0], &[2, 1, 1, 1], &[2, 255, 255], &RUN]);
        let other = RequestFrame { client: 2, sequence: 1, request: Request::TakeCommand { by_force: true } };
        let other = postcard::to_stdvec(&other).unwrap_or_default();
        add(&[&[6, 0], &RUN, &[5], &other, &RUN]);
        let enable = postcard::to_stdvec(&Request::Enable(TaskConfig::Grasping(()))).unwrap_or_default();
        add(&[&[4], &enable, &RUN]);
    }
    // Each way to hold the box.
    for how in [0_u8, 0x11, 0x22, 0x44, 0x68, 0xa0, 0xb2] {
        let grasp = [10, 1, how, 20, 20, 20, 20, 0, 0, 0, 0, 0, 0, 0];
        let steps: [&[u8]; 12] = [
            &[14],
            &[6, 2],
            &grasp,
            &RUN,
            &RUN,
            &RUN,
            &RUN,
            &RUN,
            &RUN,
            &[10, 3, 20, 0, 0, 0, 20],
            &RUN,
            &RUN,
        ];
        seeds.push([&[8], &*steps.concat()].concat());
    }
    let carry = [10, 3, 20, 0, 0, 0, 20, 0, 20];
    for end in [&[10, 4][..], &[10, 5], &[15, 1], &[15, 0], &carry] {
        let mut steps = vec![8, 14, 6, 2, 10, 0];
        (0..12).for_each(|_| steps.extend(RUN));
        steps.extend(end);
        (0..4).for_each(|_| steps.extend(RUN));
        seeds.push(steps);
    }
    // The arm, stretched and bent.
    let bent: Vec<u8> = (0..7)
        .flat_map(|joint| [1, 0x81, joint, 0, if joint == 3 { 200 } else { 20 + 9 * joint }, 0, 0])
        .collect();
    let bent = [&[1], &*bent, &RUN, &[15, 7]].concat();
    // Pushed, with every kind of settings.
    let push = [3, 0, 60, 200, 10, 5, 250, 1];
    for start in [&[9][..], &bent] {
        for how in [0_u8, 0x08, 0x18, 0x28, 0x48, 0x68, 0x80, 0x07] {
            let enable = [6, 4, how, 2, 30, 30, 30, 1];
            let target = [11, 1, 10, 250, 20, 1, 2, 3, 4];
            let configure = [11, 0, how ^ 0x38, 1, 20, 20];
            let steps: [&[u8]; 8] = [&enable, &RUN, &push, &RUN, &target, &RUN, &configure, &RUN];
            seeds.push([start, &*steps.concat()].concat());
        }
    }
    // So soft along or about an axis that the noise of the readings exceeds the permitted deviation.
    for enable in [[6, 4, 0x8c, 0, 136, 0, 0, 227, 0], [6, 4, 0x8c, 4, 136, 0, 0, 0, 157]] {
        seeds.push([&*bent, &enable, &RUN, &RUN].concat());
    }
    seeds
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use crate::node::{reached, seeds};

    #[test]
    fn the_runs_reach_the_phases_of_a_grasp_and_the_contact_of_an_arm() {
        let reached: BTreeSet<String> = seeds().iter().flat_map(|seed| reached(seed)).collect();
        for name in [
            "Approach",
            "Touch",
            "Squeeze",
            "ProbeFriction",
            "Hold",
            "Move",
            "Lower",
            "Open",
            "contact",
            "ToolPositionError",
            "ToolOrientationError",
        ] {
            assert!(reached.contains(name), "{name} is not in {reached:?}");
        }
    }
}
