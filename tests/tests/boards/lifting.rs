//! A box that is lifted, turned and put down.

use tesaki::task::grasping::{GraspCommand, Phase};
use tesaki_sim::controller::{Controller, Native};
use tesaki_sim::plant::ObjectTruth;
use tesaki_supervisor::hand::FingerBoard;

use super::links::Wired;
use super::rig::{Rig, distance, natives};

/// Angle by which the box is turned about y [rad].
fn pitch(object: &ObjectTruth) -> f64 {
    let [_, y, _, w] = object.orientation;
    2.0 * y.atan2(w)
}

/// Returns the deviations of the box from its target [m, rad] after lifting, turning, and turning back.
fn course<B: FingerBoard + Controller>(mut rig: Rig<B>) -> [f64; 4] {
    rig.grasp();
    let start = rig.box_now();
    let up = 0.01 * std::f64::consts::FRAC_1_SQRT_2;
    let lifted = [start.position[0] + up, start.position[1], start.position[2] + up];
    rig.go(0.01, 0.0);
    rig.wait(250);
    let of_lift = distance(rig.box_now().position, lifted);
    rig.go(0.01, 0.1);
    rig.wait(250);
    let of_turn = (pitch(&rig.box_now()) - pitch(&start) - 0.1).abs();
    rig.go(0.01, 0.0);
    rig.wait(250);
    let (of_return, of_angle) =
        (distance(rig.box_now().position, lifted), (pitch(&rig.box_now()) - pitch(&start)).abs());
    rig.command(&GraspCommand::PutDown);
    rig.until(Phase::Ready);
    assert!(rig.plant.contacts().iter().all(|contact| contact.normal_force() == 0.0));
    let weight = distance(rig.box_now().support_force, [0.0; 3]);
    assert!(weight > 0.15, "it does not stand on its support: {weight} N");
    [of_lift, of_turn, of_return, of_angle]
}

#[test]
fn three_boards_lift_turn_and_put_down_a_box_as_one_does() {
    for seed in 1..=2 {
        let one = course(Rig::<Native>::new(seed, None));
        let three = course(Rig::new(seed, natives()));
        println!("seed {seed}: [m, rad, m, rad] one {one:.5?} three {three:.5?}");
        for [of_lift, of_turn, of_return, of_angle] in [one, three] {
            assert!(of_lift < 2e-3 && of_return < 2e-3, "{of_lift} {of_return}");
            assert!(of_turn < 0.02 && of_angle < 0.02, "{of_turn} {of_angle}");
        }
    }
}

#[test]
fn over_a_wire_it_is_the_same_to_the_last_bit_and_lost_telemetry_costs_little() {
    let here = course(Rig::new(1, natives()));
    let wired = course(Rig::new(1, Some([0; 3].map(Wired::new))));
    assert_eq!(wired.map(f64::to_bits), here.map(f64::to_bits));
    // Each board's telemetry is lost in different ticks, about one in ten.
    let [of_lift, of_turn, of_return, of_angle] = course(Rig::new(1, Some([7, 11, 13].map(Wired::new))));
    println!("lossy: {of_lift:.5} {of_turn:.5} {of_return:.5} {of_angle:.5}");
    assert!(of_lift < 2e-3 && of_return < 2e-3, "{of_lift} {of_return}");
    assert!(of_turn < 0.02 && of_angle < 0.02, "{of_turn} {of_angle}");
}
