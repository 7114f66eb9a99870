//! Arbitrary requests and sensor readings into the node.

use tesaki::protocol::{Reply, RequestFrame, SensorFlags};

use super::random::Random;
use super::requests::any_request;
use super::rig::Rig;
use super::{fuzz, model};

#[test]
fn the_node_keeps_its_limits_whatever_it_is_asked() {
    let model = model();
    fuzz("node", 500, |seed| {
        let mut random = Random(seed);
        let mut rig = Rig::new(&model, 24_000, seed);
        let mut sequences = [u32::from(rig.sequence), 0, 0];
        // Another model: valid, or spoilt in one byte.
        let mut other = model.clone();
        for joint in &mut other.joints {
            joint.limits.torque *= 0.5;
        }
        let mut pushed = postcard::to_stdvec(&other).unwrap();
        if random.one_in(2) {
            let at = random.below(pushed.len());
            pushed[at] ^= 1 << random.below(8);
        }
        for _ in 0..random.below(400) {
            if random.one_in(2) {
                let who = if random.one_in(6) { random.below(3) } else { 0 };
                // Late and repeated requests come, too.
                sequences[who] = match random.below(12) {
                    0 => sequences[who],
                    1 => sequences[who].wrapping_sub(random.below(5) as u32),
                    _ => sequences[who].wrapping_add(1),
                };
                let request = any_request(&mut random, &model, &pushed);
                let frame = RequestFrame { client: 1 + who as u32, sequence: sequences[who] as u16, request };
                let before = (
                    rig.node.mode(),
                    rig.node.telemetry(),
                    rig.node.robot().map(|robot| robot.model().clone()),
                );
                let reply = rig.send(frame.clone());
                if matches!(reply, Reply::Refused(_)) {
                    let after = (
                        rig.node.mode(),
                        rig.node.telemetry(),
                        rig.node.robot().map(|robot| robot.model().clone()),
                    );
                    assert_eq!(format!("{before:?}"), format!("{after:?}"), "seed {seed}: refused {frame:?}");
                }
                continue;
            }
            rig.sensors.sequence = rig.sensors.sequence.wrapping_add(if random.one_in(200) { 3 } else { 1 });
            for count in &mut rig.sensors.encoders {
                *count = count.wrapping_add(random.below(41) as i32 - 20);
            }
            if random.one_in(60) {
                let at = random.below(rig.sensors.encoders.len().max(1));
                if let Some(count) = rig.sensors.encoders.get_mut(at) {
                    *count = random.next() as i32;
                }
            }
            for counts in &mut rig.sensors.forces {
                counts[random.below(6)] = random.below(2000) as i32 - 1000;
                if random.one_in(300) {
                    counts[random.below(6)] = random.next() as i32;
                }
            }
            rig.sensors.flags = SensorFlags(u8::from(random.one_in(300)));
            rig.sensors.supply = if random.one_in(300) { random.next() as u16 } else { 24_000 };
            let mut frame = rig.sensors.clone();
            if random.one_in(300) {
                frame.encoders.truncate(random.below(9));
            }
            if random.one_in(300) {
                frame.currents.iter_mut().for_each(|current| *current = random.next() as i16);
            }
            rig.tick(frame);
        }
        rig.replay();
    });
}
