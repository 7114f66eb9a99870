//! Preconditions of enabling.

use heapless::Vec;

use super::rig::{Rig, model, refusal};
use crate::fault::FaultCause;
use crate::protocol::{Mode, Refusal, Reply, Request, SCHEMA_KEY};
use crate::task::TaskKind;

#[test]
fn enables_only_when_all_preconditions_hold() {
    let mut rig = Rig::new();
    let mismatch = Refusal::SchemaMismatch { board: SCHEMA_KEY, firmware: crate::VERSION };
    assert_eq!(refusal(rig.enable()), mismatch);
    rig.ask(Request::Hello { schema: SCHEMA_KEY ^ 1 });
    assert_eq!(refusal(rig.enable()), mismatch);
    rig.ask(Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(refusal(rig.enable()), Refusal::NotCommander);
    rig.command();
    assert_eq!(refusal(rig.enable()), Refusal::NoModel);
    let mut relative = model();
    relative.joints[1].encoder.relative = true;
    assert_eq!(rig.push(&relative), Reply::Done);
    assert_eq!(refusal(rig.enable()), Refusal::NoSensors);
    rig.tick();
    assert_eq!(refusal(rig.enable()), Refusal::NotHomed { joint: 1 });
    let home = Request::Home { positions: Vec::from_slice(&[0.1, 0.2, 0.3]).unwrap() };
    assert_eq!(rig.ask(home), Reply::Done);
    assert!((rig.node.telemetry().joints[1].position - 0.2).abs() < 1e-4);
    rig.sensors.supply = 12_000;
    rig.tick();
    let Refusal::Unsafe(fault) = refusal(rig.enable()) else { panic!() };
    assert_eq!((fault.cause, fault.value, fault.limit), (FaultCause::SupplyLow, 12.0, 20.0));
    rig.sensors.supply = 24_000;
    rig.tick();
    assert_eq!(rig.enable(), Reply::Done);
    assert_eq!(refusal(rig.enable()), Refusal::WrongMode(Mode::Enabled(TaskKind::JointServo)));
}
