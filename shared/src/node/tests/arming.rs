//! What the node needs before it arms.

use heapless::Vec;

use super::bench::{Bench, model, refusal};
use crate::fault::FaultCause;
use crate::protocol::{Mode, Refusal, Reply, Request, SCHEMA_KEY};
use crate::task::TaskKind;

#[test]
fn arms_only_when_everything_is_ready() {
    let mut bench = Bench::new();
    let mismatch = Refusal::SchemaMismatch { board: SCHEMA_KEY, firmware: crate::VERSION };
    assert_eq!(refusal(bench.arm()), mismatch);
    bench.ask(Request::Hello { schema: SCHEMA_KEY ^ 1 });
    assert_eq!(refusal(bench.arm()), mismatch);
    bench.ask(Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(refusal(bench.arm()), Refusal::NotCommander);
    bench.command();
    assert_eq!(refusal(bench.arm()), Refusal::NoModel);
    let mut relative = model();
    relative.joints[1].encoder.relative = true;
    assert_eq!(bench.push(&relative), Reply::Done);
    assert_eq!(refusal(bench.arm()), Refusal::NoSensors);
    bench.tick();
    assert_eq!(refusal(bench.arm()), Refusal::NotHomed { joint: 1 });
    let home = Request::Home { positions: Vec::from_slice(&[0.1, 0.2, 0.3]).unwrap() };
    assert_eq!(bench.ask(home), Reply::Done);
    assert!((bench.node.telemetry().joints[1].position - 0.2).abs() < 1e-4);
    bench.sensors.supply = 12_000;
    bench.tick();
    let Refusal::Unsafe(fault) = refusal(bench.arm()) else { panic!() };
    assert_eq!((fault.cause, fault.value, fault.limit), (FaultCause::SupplyLow, 12.0, 20.0));
    bench.sensors.supply = 24_000;
    bench.tick();
    assert_eq!(bench.arm(), Reply::Done);
    assert_eq!(refusal(bench.arm()), Refusal::WrongMode(Mode::Enabled(TaskKind::JointServo)));
}
