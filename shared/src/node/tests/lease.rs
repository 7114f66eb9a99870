//! Who commands, and requests that are lost or repeated.

use heapless::Vec;

use super::bench::{Bench, model, refusal};
use crate::control::ServoMode;
use crate::protocol::{Mode, Refusal, Reply, Request, SCHEMA_KEY, Stream};
use crate::task::joint_servo::JointCommand;
use crate::task::{TaskCommand, TaskConfig};

#[test]
fn a_new_model_does_not_cost_the_commander_its_lease() {
    let mut bench = Bench::new();
    bench.sensors.sequence = 5000;
    bench.tick();
    bench.command();
    assert_eq!(bench.push(&model()), Reply::Done);
    bench.send(8, 1, Request::Hello { schema: SCHEMA_KEY });
    let refused = Reply::Refused(Refusal::Commanded { by: 7 });
    assert_eq!(bench.send(8, 2, Request::TakeCommand { by_force: false }), refused);
    assert_eq!(bench.node.last_tick(), 5001);
    assert_eq!(bench.arm(), Reply::Refused(Refusal::NoSensors));
    bench.tick();
    assert_eq!(bench.arm(), Reply::Done);
}

#[test]
fn only_the_commander_moves_the_machine_but_anyone_may_look_and_stop_it() {
    let mut bench = Bench::armed(&model());
    bench.tick();
    let goal = || {
        Request::Task(TaskCommand::JointServo(JointCommand::Goal {
            positions: Vec::from_slice(&[0.0; 3]).unwrap(),
        }))
    };
    let other = 8;
    assert!(matches!(refusal(bench.send(other, 1, goal())), Refusal::SchemaMismatch { .. }));
    bench.send(other, 2, Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(refusal(bench.send(other, 3, goal())), Refusal::Commanded { by: 7 });
    for by_force in [false, true] {
        let take = Request::TakeCommand { by_force };
        assert_eq!(refusal(bench.send(other, 4, take)), Refusal::Commanded { by: 7 }, "armed");
    }
    let Reply::Status(status) = bench.send(other, 5, Request::ReadStatus) else { panic!() };
    assert_eq!(status.node.commander, Some(7));
    assert_eq!(bench.send(other, 6, Request::SetRate { stream: Stream::Telemetry, every: 1 }), Reply::Done);
    // The first client still agrees and commands, however many others come.
    for client in 100..120 {
        bench.send(client, 1, Request::Hello { schema: SCHEMA_KEY });
    }
    bench.send(other, 6, Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(bench.ask(goal()), Reply::Done);
    assert_eq!(bench.send(other, 7, Request::Stop), Reply::Done);
    assert_eq!(bench.node.mode(), Mode::Fault);
    assert_eq!(bench.send(other, 8, Request::TakeCommand { by_force: true }), Reply::Done);
    bench.ask(Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(refusal(bench.ask(goal())), Refusal::Commanded { by: other });
}

#[test]
fn requests_that_come_twice_or_late_change_nothing() {
    let mut bench = Bench::ready(&model());
    let arm = || Request::Enable(TaskConfig::JointServo(ServoMode::Pid));
    let first = bench.sequence + 1;
    assert_eq!(bench.ask(arm()), Reply::Done);
    assert_eq!(bench.send(7, first, arm()), Reply::Done, "its reply was lost");
    bench.ask(Request::Disable);
    assert_eq!(bench.send(7, first, arm()), Reply::Done, "an echo of what happened");
    assert_eq!(bench.node.mode(), Mode::Disabled, "and not armed again");
    assert_eq!(bench.ask(Request::ReleaseCommand), Reply::Done);
    assert_eq!(refusal(bench.send(7, first, arm())), Refusal::NotCommander);
    bench.command();
    assert!(matches!(refusal(bench.send(7, first, arm())), Refusal::Stale { .. }));
    assert_eq!(bench.node.mode(), Mode::Disabled);
}
