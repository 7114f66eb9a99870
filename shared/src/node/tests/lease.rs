//! The commander, and lost or repeated requests.

use heapless::Vec;

use super::rig::{Rig, model, refusal};
use crate::control::ServoMode;
use crate::node::Node;
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
    // The commander stays accepted and keeps its lease, however many other clients say hello.
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

fn enable() -> Request {
    Request::Enable(TaskConfig::JointServo(ServoMode::Pid))
}

fn take(by_force: bool) -> Request {
    Request::TakeCommand { by_force }
}

#[test]
fn a_disable_that_overtook_the_take_and_the_enable_of_a_new_client_overrules_both() {
    let mut rig = Rig::ready(&model());
    rig.ask(Request::ReleaseCommand);
    rig.send(8, 1, Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(rig.send(8, 4, Request::Disable), Reply::Done);
    assert_eq!(refusal(rig.send(8, 2, take(true))), Refusal::Stale { latest: 4 });
    assert_eq!(refusal(rig.send(8, 3, enable())), Refusal::NotCommander);
    assert_eq!(rig.node.mode(), Mode::Disabled);
    assert_eq!(rig.send(8, 5, take(false)), Reply::Done);
    assert_eq!(rig.send(8, 6, enable()), Reply::Done);
}

#[test]
fn what_was_refused_to_a_client_without_command_enables_nothing_when_it_arrives_again() {
    let mut rig = Rig::ready(&model());
    rig.send(8, 1, Request::Hello { schema: SCHEMA_KEY });
    let commanded = Refusal::Commanded { by: 7 };
    assert_eq!(refusal(rig.send(8, 2, take(false))), commanded);
    assert_eq!(refusal(rig.send(8, 3, enable())), commanded);
    rig.ask(Request::ReleaseCommand);
    assert_eq!(refusal(rig.send(8, 2, take(false))), Refusal::Stale { latest: 3 });
    assert_eq!(refusal(rig.send(8, 3, enable())), Refusal::NotCommander);
    assert_eq!(rig.node.mode(), Mode::Disabled);
    // A `TakeCommand` alone may be repeated until it is granted.
    assert_eq!(rig.send(8, 4, take(false)), Reply::Done);
}

#[test]
fn a_take_that_was_refused_may_be_repeated_but_makes_older_requests_stale() {
    let mut rig = Rig::ready(&model());
    rig.send(8, 1, Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(refusal(rig.send(8, 4, take(false))), Refusal::Commanded { by: 7 });
    assert_eq!(refusal(rig.send(8, 2, take(true))), Refusal::Stale { latest: 3 });
    rig.ask(Request::ReleaseCommand);
    assert_eq!(rig.send(8, 4, take(false)), Reply::Done);
    assert_eq!(refusal(rig.send(8, 3, enable())), Refusal::Stale { latest: 4 });
    assert_eq!(rig.node.mode(), Mode::Disabled);
}

#[test]
fn after_a_reset_and_a_new_hello_nothing_from_before_enables() {
    let mut rig = Rig::new();
    rig.command();
    rig.node = Node::new();
    assert!(matches!(refusal(rig.send(8, 2, take(true))), Refusal::SchemaMismatch { .. }));
    rig.command();
    assert_eq!(rig.push(&model()), Reply::Done);
    rig.tick();
    rig.ask(Request::ReleaseCommand);
    rig.send(8, 10, Request::Hello { schema: SCHEMA_KEY });
    // Requests that were sent and executed before the reset arrive again.
    assert_eq!(refusal(rig.send(8, 2, take(true))), Refusal::Stale { latest: 10 });
    assert_eq!(refusal(rig.send(8, 3, enable())), Refusal::NotCommander);
    // So does the old hello.
    rig.send(8, 1, Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(refusal(rig.send(8, 2, take(true))), Refusal::Stale { latest: 10 });
    assert_eq!(rig.send(8, 11, take(false)), Reply::Done);
}

#[test]
fn a_repeated_hello_pushes_no_other_client_out() {
    let mut rig = Rig::ready(&model());
    for client in [21, 22, 23, 24] {
        rig.send(client, 1, Request::Hello { schema: SCHEMA_KEY });
    }
    for _ in 0..5 {
        rig.send(24, 1, Request::Hello { schema: SCHEMA_KEY });
        rig.send(22, 1, Request::Hello { schema: SCHEMA_KEY });
    }
    for client in [21, 22, 23, 24] {
        assert!(matches!(rig.send(client, 2, Request::ReadStatus), Reply::Status(_)), "{client}");
    }
    // A fifth client replaces the one with the oldest hello.
    rig.send(25, 1, Request::Hello { schema: SCHEMA_KEY });
    assert!(matches!(refusal(rig.send(21, 3, Request::ReadStatus)), Refusal::SchemaMismatch { .. }));
    assert!(matches!(rig.send(23, 3, Request::ReadStatus), Reply::Status(_)));
    // A client whose new hello has another schema key is removed.
    rig.send(23, 4, Request::Hello { schema: SCHEMA_KEY ^ 1 });
    assert!(matches!(refusal(rig.send(23, 5, Request::ReadStatus)), Refusal::SchemaMismatch { .. }));
    rig.send(26, 1, Request::Hello { schema: SCHEMA_KEY });
    for client in [22, 24, 25, 26] {
        assert!(matches!(rig.send(client, 6, Request::ReadStatus), Reply::Status(_)), "{client}");
    }
}

/// The commanding program was replaced by another version with the same client number.
#[test]
fn a_commander_whose_hello_has_another_key_commands_no_more() {
    let mut rig = Rig::enabled(&model());
    rig.ask(Request::Hello { schema: SCHEMA_KEY ^ 1 });
    assert!(matches!(refusal(rig.ask(Request::Keep)), Refusal::SchemaMismatch { .. }));
    // Another client's hello does not restore it; while enabled no other client can take command.
    rig.send(8, 1, Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(refusal(rig.send(8, 2, take(true))), Refusal::Commanded { by: 7 });
    assert!(matches!(refusal(rig.ask(Request::ReadStatus)), Refusal::SchemaMismatch { .. }));
    // Its own does.
    rig.ask(Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(rig.ask(Request::Keep), Reply::Done);
    rig.ask(Request::Hello { schema: SCHEMA_KEY ^ 1 });
    assert_eq!(rig.ask(Request::Disable), Reply::Done);
    assert!(matches!(refusal(rig.ask(enable())), Refusal::SchemaMismatch { .. }));
    // The next commander is accepted by its own hello.
    assert_eq!(rig.send(8, 3, take(true)), Reply::Done);
    assert_eq!(rig.send(8, 4, enable()), Reply::Done);
}

#[test]
fn a_command_that_was_overtaken_by_a_quarter_of_the_numbers_is_not_answered_as_if_executed() {
    let mut rig = Rig::ready(&model());
    let number = rig.sequence.wrapping_add(20_000);
    rig.send(7, number, Request::ReadStatus);
    let latest = number - 1;
    assert_eq!(refusal(rig.send(7, latest, enable())), Refusal::Stale { latest });
    assert_eq!(rig.node.mode(), Mode::Disabled);
    assert_eq!(rig.send(7, number + 1, enable()), Reply::Done);
}

#[test]
fn a_program_that_restarts_with_its_old_client_number_can_disable_but_not_enable() {
    let mut rig = Rig::enabled(&model());
    let latest = rig.sequence;
    rig.send(7, 1, Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(refusal(rig.send(7, 2, take(true))), Refusal::Stale { latest });
    assert_eq!(rig.send(7, 3, Request::Disable), Reply::Done);
    assert_eq!(rig.node.mode(), Mode::Disabled);
    assert_eq!(refusal(rig.send(7, 4, enable())), Refusal::Stale { latest });
    assert!(!rig.tick().enabled);
    // With its own client number.
    rig.send(31, 1, Request::Hello { schema: SCHEMA_KEY });
    assert_eq!(rig.send(31, 2, take(true)), Reply::Done);
    assert_eq!(rig.send(31, 3, enable()), Reply::Done);
}
