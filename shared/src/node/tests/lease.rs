//! The commander, and lost or repeated requests.

use heapless::Vec;

use super::rig::{Rig, model, refusal};
use crate::control::ServoMode;
use crate::protocol::{Mode, Refusal, Reply, Request, SCHEMA_KEY, Stream};
use crate::task::joint_servo::JointCommand;
use crate::task::{TaskCommand, TaskConfig};

#[test]
fn a_new_model_does_not_end_the_lease() {
    let mut rig = Rig::new();
    rig.sensors.sequence = 5000;
    rig.tick();
    rig.command();
    assert_eq!(rig.push(&model()), Reply::Done);
    rig.send(8, 1, Request::Hello { schema: SCHEMA_KEY });
    let refused = Reply::Refused(Refusal::Commanded { by: 7 });
    assert_eq!(rig.send(8, 2, Request::TakeCommand { by_force: false }), refused);
    assert_eq!(rig.node.last_tick(), 5001);
    assert_eq!(rig.enable(), Reply::Refused(Refusal::NoSensors));
    rig.tick();
    assert_eq!(rig.enable(), Reply::Done);
}

#[test]
fn only_the_commander_may_command_but_every_client_may_read_and_stop() {
    let mut rig = Rig::enabled(&model());
    rig.tick();
    let goal = || {
        Request::Task(TaskCommand::JointServo(JointCommand::Goal {
            positions: Vec::from_slice(&[0.0; 3]).unwrap(),
        }))
    };
    let other = 8;
    assert!(matches!(refusal(rig.send(other, 1, goal())), Refusal::SchemaMismatch { .. }));
    rig.send(other, 2, Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(refusal(rig.send(other, 3, goal())), Refusal::Commanded { by: 7 });
    for by_force in [false, true] {
        let take = Request::TakeCommand { by_force };
        assert_eq!(refusal(rig.send(other, 4, take)), Refusal::Commanded { by: 7 }, "enabled");
    }
    let Reply::Status(status) = rig.send(other, 5, Request::ReadStatus) else { panic!() };
    assert_eq!(status.node.commander, Some(7));
    assert_eq!(rig.send(other, 6, Request::SetRate { stream: Stream::Telemetry, every: 1 }), Reply::Done);
    // The commander keeps its hello and its lease, however many other clients come.
    for client in 100..120 {
        rig.send(client, 1, Request::Hello { schema: SCHEMA_KEY });
    }
    rig.send(other, 6, Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(rig.ask(goal()), Reply::Done);
    assert_eq!(rig.send(other, 7, Request::Stop), Reply::Done);
    assert_eq!(rig.node.mode(), Mode::Fault);
    assert_eq!(rig.send(other, 8, Request::TakeCommand { by_force: true }), Reply::Done);
    rig.ask(Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(refusal(rig.ask(goal())), Refusal::Commanded { by: other });
}

#[test]
fn repeated_and_late_requests_change_nothing() {
    let mut rig = Rig::ready(&model());
    let enable = || Request::Enable(TaskConfig::JointServo(ServoMode::Pid));
    let first = rig.sequence + 1;
    assert_eq!(rig.ask(enable()), Reply::Done);
    assert_eq!(rig.send(7, first, enable()), Reply::Done, "its reply was lost");
    rig.ask(Request::Disable);
    assert!(matches!(refusal(rig.send(7, first, enable())), Refusal::Stale { .. }), "it was overruled");
    assert_eq!(rig.node.mode(), Mode::Disabled, "not enabled again");
    assert_eq!(rig.ask(Request::ReleaseCommand), Reply::Done);
    assert_eq!(refusal(rig.send(7, first, enable())), Refusal::NotCommander);
    rig.command();
    assert!(matches!(refusal(rig.send(7, first, enable())), Refusal::Stale { .. }));
    assert_eq!(rig.node.mode(), Mode::Disabled);
}
