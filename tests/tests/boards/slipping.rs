//! Time that the grip needs to react to a contact that begins to slide.

use tesaki::task::grasping::GraspTelemetry;
use tesaki_sim::controller::Native;
use tesaki_sim::plant::{ContactTruth, Load};

use super::rig::{Rig, distance, natives};

/// Returns the ticks from the start of sliding under a sudden weight until the requested and the true grip
/// force have increased by a tenth, and the sliding distance of the contacts [m].
fn react(mut rig: Rig<Native>) -> (u32, u32, f64) {
    // The result of an error-free friction probe.
    rig.plan.friction = Some(rig.box_now().friction as f32);
    rig.grasp();
    rig.go(0.01, 0.0);
    rig.wait(200);
    let requested =
        |now: &GraspTelemetry| now.target_forces.iter().flatten().map(|part| part * part).sum::<f32>().sqrt();
    let pressed =
        |rig: &Rig<Native>| rig.plant.contacts().iter().map(ContactTruth::normal_force).sum::<f64>();
    let way =
        |rig: &Rig<Native>| rig.plant.contacts().iter().map(|contact| contact.slip_path).fold(0.0, f64::max);
    let now = rig.tick().unwrap();
    let (requested_before, pressed_before, way_before) = (requested(&now), pressed(&rig), way(&rig));
    rig.plant.load(Load { mass: 0.4, point: [0.0, 0.0, 0.03], ramp: 0.02 }).unwrap();
    let (mut slid, mut firmer, mut firm) = (None::<u32>, None::<u32>, None::<u32>);
    for tick in 0..100 {
        let now = rig.tick().unwrap();
        let slides =
            rig.plant.contacts().iter().any(|contact| distance(contact.slip_velocity, [0.0; 3]) > 5e-4);
        if slides {
            slid = slid.or(Some(tick));
        }
        if requested(&now) > 1.1 * requested_before {
            firmer = firmer.or(Some(tick));
        }
        if pressed(&rig) > 1.1 * pressed_before {
            firm = firm.or(Some(tick));
        }
    }
    let slid = slid.unwrap();
    (firmer.unwrap().saturating_sub(slid), firm.unwrap().saturating_sub(slid), way(&rig) - way_before)
}

#[test]
fn a_contact_that_begins_to_slide_is_answered_by_a_firmer_grip_within_three_ticks() {
    for seed in 1..=3 {
        let one = react(Rig::new(seed, None));
        let three = react(Rig::new(seed, natives()));
        println!(
            "seed {seed}: ticks until requested and pressed firmer, m slid: one board {one:?}, three {three:?}"
        );
        assert!(one.0 <= 2 && one.1 <= 2, "{one:?}");
        assert!(three.0 <= 3 && three.1 <= 3, "{three:?}");
    }
}
