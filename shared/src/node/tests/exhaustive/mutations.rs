//! Nodes with an error that the search must find.

use crate::fault::{Fault, FaultCause};
use crate::node::Node;
use crate::node::clients::Clients;
use crate::node::optional::Optional;
use crate::protocol::{
    ActuatorFrame, BoardStatus, Mode, Refusal, Reply, Request, RequestFrame, SensorFlags, SensorFrame,
};

/// An error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mutation {
    /// Every command of the commander counts as new.
    NoNumbers,
    /// A repetition of the last command is executed.
    RepeatsCommands,
    /// A command that a newer one has overtaken is executed.
    AcceptsLateCommands,
    /// A repetition of the last `Keep` resets the command timeout.
    RepeatedKeepCounts,
    /// Numbers of former commanders are forgotten.
    ForgetsFormerCommanders,
    /// `Disable` and `Stop` do not count as the last command of their sender.
    DisableOverrulesNothing,
    /// Numbers of clients that do not command are forgotten.
    ForgetsOtherClients,
    /// Messages that a client sent before its hello are accepted after it.
    HelloOutdatesNothing,
    /// A repeated hello removes another client.
    HelloPushesOthersOut,
    /// The last command is still remembered after a quarter of the number range.
    RemembersForTooLong,
    /// A command that is too old to be remembered is answered with `Done`.
    AnswersForWhatItNeverExecuted,
    /// `Disable` and `Stop` are accepted from the commander only.
    DeafToStrangers,
    /// Every client commands.
    EverybodyCommands,
    /// Command is taken while enabled.
    TakesWhileEnabled,
    /// Command is released while enabled.
    ReleasesWhileEnabled,
    /// The lease never expires.
    LeaseNeverExpires,
    /// Command can be taken at any time, without force.
    LeaseAlwaysExpired,
    /// No command timeout.
    NoCommandTimeout,
    /// The command timeout is one tick late.
    LateCommandTimeout,
    /// The emergency stop is ignored while enabled.
    IgnoresEmergencyStop,
    /// An alarm of the last sensor frame does not prevent enabling.
    EnablesInAlarm,
    /// `Enable` clears a fault.
    EnablesInFault,
    /// Faults can be cleared without being read.
    ClearsUnreadFaults,
    /// A `Stop` after a fault is not recorded.
    LosesStopAfterFault,
    /// A fault is recorded twice.
    RecordsTwice,
    /// A fault is not recorded.
    RecordsNothing,
    /// `Disable` after a fault leaves the power stages on.
    DisableLeavesFaultsHeld,
    /// A reset changes nothing.
    ResetsNothing,
    /// Faults cannot be cleared.
    NeverClears,
}

/// All mutations.
pub const ALL: [Mutation; 29] = [
    Mutation::NoNumbers,
    Mutation::RepeatsCommands,
    Mutation::AcceptsLateCommands,
    Mutation::RepeatedKeepCounts,
    Mutation::ForgetsFormerCommanders,
    Mutation::DisableOverrulesNothing,
    Mutation::ForgetsOtherClients,
    Mutation::HelloOutdatesNothing,
    Mutation::HelloPushesOthersOut,
    Mutation::RemembersForTooLong,
    Mutation::AnswersForWhatItNeverExecuted,
    Mutation::DeafToStrangers,
    Mutation::EverybodyCommands,
    Mutation::TakesWhileEnabled,
    Mutation::ReleasesWhileEnabled,
    Mutation::LeaseNeverExpires,
    Mutation::LeaseAlwaysExpired,
    Mutation::NoCommandTimeout,
    Mutation::LateCommandTimeout,
    Mutation::IgnoresEmergencyStop,
    Mutation::EnablesInAlarm,
    Mutation::EnablesInFault,
    Mutation::ClearsUnreadFaults,
    Mutation::LosesStopAfterFault,
    Mutation::RecordsTwice,
    Mutation::RecordsNothing,
    Mutation::DisableLeavesFaultsHeld,
    Mutation::ResetsNothing,
    Mutation::NeverClears,
];

/// [`Node::handle`] with an error.
pub fn handle(mutation: Option<Mutation>, node: &mut Node, frame: &RequestFrame) -> Reply {
    use Mutation as M;
    let board = BoardStatus::default();
    let Some(mutation) = mutation else { return node.handle(frame, &board).reply };
    let mut frame = frame.clone();
    let old = node.state.clone();
    let commands = old.lease.commander() == Some(frame.client);
    let ahead = frame.sequence.wrapping_sub(old.lease.sequence).cast_signed();
    let is_command = matches!(
        frame.request,
        Request::Enable(_) | Request::Keep | Request::ClearFaults { .. } | Request::ReleaseCommand
    );
    let stops = matches!(frame.request, Request::Disable | Request::Stop);
    let enables = matches!(frame.request, Request::Enable(_));
    let clears = matches!(frame.request, Request::ClearFaults { .. });
    let hello = matches!(frame.request, Request::Hello { .. });
    let takes = matches!(frame.request, Request::TakeCommand { .. });
    let renumbered = match mutation {
        M::NoNumbers => commands && is_command,
        M::RepeatsCommands => commands && is_command && ahead == 0,
        M::AcceptsLateCommands => commands && is_command && ahead < 0,
        _ => false,
    };
    if renumbered {
        frame.sequence = old.lease.sequence.wrapping_add(1);
    }
    let state = &mut node.state;
    match mutation {
        M::DeafToStrangers if stops && !commands => return Reply::Done,
        M::NeverClears if clears => return Reply::Done,
        M::EverybodyCommands if is_command && !commands => state.lease.client = Some(frame.client),
        M::TakesWhileEnabled if takes => state.mode = Mode::Disabled,
        M::ReleasesWhileEnabled if frame.request == Request::ReleaseCommand => state.mode = Mode::Disabled,
        M::LeaseNeverExpires => state.lease.last_request = state.tick,
        M::LeaseAlwaysExpired => state.lease.last_request = state.tick.wrapping_sub(1000),
        M::EnablesInAlarm if enables && commands => state.alarm = Optional::None,
        M::EnablesInFault if enables => state.mode = Mode::Disabled,
        M::ClearsUnreadFaults if clears => state.faults_read = state.faults.total,
        _ => {}
    }
    let changed = state.mode;
    let reply = node.handle(&frame, &board).reply;
    let state = &mut node.state;
    match mutation {
        M::NoNumbers | M::RepeatsCommands | M::AcceptsLateCommands if renumbered => {
            state.lease.sequence = old.lease.sequence;
        }
        M::RepeatedKeepCounts if frame.request == Request::Keep && reply == Reply::Done => state.silence = 0,
        M::ForgetsOtherClients => {
            state.accepted.0.iter_mut().flatten().for_each(|(_, latest)| *latest = 0);
        }
        M::HelloOutdatesNothing if hello => {
            state.lease = old.lease;
            state.accepted.0.iter_mut().flatten().for_each(|(_, latest)| *latest = 0);
        }
        M::HelloPushesOthersOut if hello => {
            state.accepted.0.rotate_right(1);
            state.accepted.0[0] = state.accepted.0[1].take();
        }
        M::AnswersForWhatItNeverExecuted => {
            if let Optional::Some(Refusal::Stale { .. }) = state.lease.refusal {
                state.lease.refusal = Optional::None;
            }
        }
        M::ForgetsFormerCommanders => state.lease.former = Clients::NONE,
        M::DisableOverrulesNothing if stops => {
            (state.lease, state.accepted) = (old.lease, old.accepted);
        }
        M::RemembersForTooLong if !is_command && !takes && !stops => state.lease = old.lease,
        M::EverybodyCommands if is_command && !commands => state.lease = old.lease,
        M::TakesWhileEnabled | M::ReleasesWhileEnabled if state.mode == changed => state.mode = old.mode,
        M::EnablesInFault if state.mode == changed => state.mode = old.mode,
        M::EnablesInAlarm if reply != Reply::Done => state.alarm = old.alarm,
        M::LeaseNeverExpires | M::LeaseAlwaysExpired if !commands && reply != Reply::Done => {
            state.lease.last_request = old.lease.last_request;
        }
        M::ClearsUnreadFaults if clears && reply != Reply::Done => state.faults_read = old.faults_read,
        M::LosesStopAfterFault if frame.request == Request::Stop && old.mode == Mode::Fault => {
            state.faults.clone_from(&old.faults);
        }
        M::DisableLeavesFaultsHeld if frame.request == Request::Disable && state.mode == Mode::Fault => {
            state.reaction = old.reaction;
        }
        _ => record(mutation, node, old.faults.total),
    }
    reply
}

/// [`Node::tick`] with an error.
pub fn tick(mutation: Option<Mutation>, node: &mut Node, sensors: &SensorFrame) -> ActuatorFrame {
    use Mutation as M;
    let mut sensors = sensors.clone();
    let total = node.state.faults.total;
    let enabled = matches!(node.state.mode, Mode::Enabled(_));
    match mutation {
        Some(M::NoCommandTimeout) => node.state.silence = 0,
        Some(M::IgnoresEmergencyStop) if enabled => sensors.flags = SensorFlags(0),
        _ => {}
    }
    let before = node.clone();
    let mut frame = node.tick(&sensors);
    if let Some(mutation) = mutation {
        let last = node.faults().faults.last();
        let late = last.is_some_and(|fault| {
            fault.cause == FaultCause::CommandTimeout && fault.value < fault.limit + 0.015
        });
        if mutation == M::LateCommandTimeout && late && node.state.faults.total != total {
            *node = before;
            node.state.silence = node.state.silence.saturating_sub(1);
            frame = node.tick(&sensors);
            node.state.silence += 1;
        }
        record(mutation, node, total);
    }
    frame
}

/// Whether a reset is ignored.
pub fn resets_nothing(mutation: Option<Mutation>) -> bool {
    mutation == Some(Mutation::ResetsNothing)
}

/// Records a new fault too often, or not at all.
fn record(mutation: Mutation, node: &mut Node, total: u32) {
    let log = &mut node.state.faults;
    if log.total == total {
        return;
    }
    match mutation {
        Mutation::RecordsTwice => {
            let last: Option<Fault> = log.faults.last().copied();
            last.into_iter().for_each(|fault| log.record(fault));
        }
        Mutation::RecordsNothing => log.total = total,
        _ => {}
    }
}
