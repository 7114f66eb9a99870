//! Which faults of a board are new, and which of them are the cause of a stop.
//!
//! A stop in mode fault is recorded as another fault, so the last one in the log need not be the cause.

use std::cmp::Ordering;
use std::slice;
use std::time::{Duration, Instant};

use tesaki::fault::{Fault, FaultCause, FaultLog};
use tesaki::model::RobotModel;
use tesaki::protocol::{NodeStatus, Telemetry};

use crate::troubleshooting;

/// Number of faults of a board at a tick: later ones are new.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FaultsBefore {
    /// Their number since power-on.
    pub total: u32,
    /// The tick.
    pub tick: u32,
}

impl From<&Telemetry> for FaultsBefore {
    fn from(telemetry: &Telemetry) -> Self {
        Self { total: telemetry.faults, tick: telemetry.tick }
    }
}

impl From<&NodeStatus> for FaultsBefore {
    fn from(node: &NodeStatus) -> Self {
        Self { total: node.faults, tick: node.tick }
    }
}

impl FaultsBefore {
    /// Returns the new faults in `log`, the oldest first: that one is the cause, and the following ones may
    /// be consequences. Returns all if the board was switched off in between.
    pub fn later<'a>(&self, log: &'a FaultLog) -> &'a [Fault] {
        let Some(count) = log.total.checked_sub(self.total) else { return &log.faults };
        let faults = last(log, usize::try_from(count).unwrap_or(usize::MAX));
        // A stop that replaces another one counts too, so there may be fewer faults than counted. After a
        // reset, the ticks begin again and cannot be compared.
        let is_old = |fault: &&Fault| fault.tick.wrapping_sub(self.tick).cast_signed() < 0;
        if faults.last().as_ref().is_none_or(is_old) {
            return faults;
        }
        &faults[faults.iter().take_while(is_old).count()..]
    }

    /// Returns the fault that stopped a board: the first new one, else [those to blame](blamed).
    pub fn cause<'a>(&self, log: &'a FaultLog) -> &'a [Fault] {
        match self.later(log) {
            [] => blamed(log),
            [cause, ..] => slice::from_ref(cause),
        }
    }
}

/// For this time after the log was read, telemetry with fewer faults is ignored, because it was sent earlier.
const ON_ITS_WAY: Duration = Duration::from_secs(1);

/// Follows the faults of a board by its telemetry, so that each is reported once.
#[derive(Clone, Copy, Debug)]
pub struct FaultFollower {
    known: FaultsBefore,
    /// Time at which the log was read.
    read: Option<Instant>,
}

impl FaultFollower {
    /// Reports the faults after those of `known`.
    pub const fn new(known: FaultsBefore) -> Self {
        Self { known, read: None }
    }

    /// Returns whether the board's log must be read, because the telemetry counts other faults: more, or
    /// fewer after the board was switched off.
    pub fn is_due(&self, telemetry: &Telemetry) -> bool {
        match telemetry.faults.cmp(&self.known.total) {
            Ordering::Greater => true,
            Ordering::Equal => false,
            Ordering::Less => self.read.is_none_or(|read| read.elapsed() > ON_ITS_WAY),
        }
    }

    /// Returns the new faults in the log, which was read after the telemetry had arrived; they are then
    /// known.
    pub fn take<'a>(&mut self, telemetry: &Telemetry, log: &'a FaultLog) -> &'a [Fault] {
        let later = self.known.later(log);
        // The telemetry may count fewer.
        self.known = FaultsBefore { total: log.total, tick: telemetry.tick };
        self.read = Some(Instant::now());
        later
    }
}

/// Returns the faults that explain why a board is in fault: the last one, and if that is a stop also the one
/// before it, which may have caused the stop.
pub fn blamed(log: &FaultLog) -> &[Fault] {
    let is_stop = log.faults.last().is_some_and(|fault| fault.cause == FaultCause::Stop);
    last(log, if is_stop { 2 } else { 1 })
}

fn last(log: &FaultLog, count: usize) -> &[Fault] {
    &log.faults[log.faults.len().saturating_sub(count)..]
}

/// Describes a fault, with the joint's name if the model is known.
pub fn describe(fault: &Fault, model: Option<&RobotModel>) -> String {
    model.map_or_else(|| fault.to_string(), |model| fault.named(model).to_string())
}

/// Describes faults, the last one first, with the entries of the document that explain them.
pub fn explain(faults: &[Fault], model: Option<&RobotModel>) -> String {
    if faults.is_empty() {
        return "no fault is recorded".to_owned();
    }
    format!("{}\nSee {}", in_words(faults, model), entries(faults))
}

/// Describes faults, the last one first.
pub fn in_words(faults: &[Fault], model: Option<&RobotModel>) -> String {
    let texts: Vec<String> = faults.iter().rev().map(|fault| describe(fault, model)).collect();
    texts.join("; before it: ")
}

/// Returns the entries of the document that explain the faults, the last one first; the document itself if
/// there are none.
pub fn entries(faults: &[Fault]) -> String {
    let mut entries: Vec<String> =
        faults.iter().rev().map(|fault| troubleshooting::fault(fault.cause)).collect();
    entries.dedup();
    if entries.is_empty() { troubleshooting::DOCUMENT.to_owned() } else { entries.join(" and ") }
}

#[cfg(test)]
mod tests {
    use tesaki::protocol::Mode;

    use super::*;

    /// Creates a log whose last faults have these causes and ticks, with `total` faults since power-on.
    fn log(total: u32, faults: &[(FaultCause, u32)]) -> FaultLog {
        let fault = |&(cause, tick)| Fault { cause, joint: None, value: 0.0, limit: 0.0, tick };
        FaultLog { total, faults: faults.iter().map(fault).collect() }
    }

    #[track_caller]
    fn assert_later(before: (u32, u32), log: &FaultLog, ticks: &[u32]) {
        let before = FaultsBefore { total: before.0, tick: before.1 };
        let later: Vec<u32> = before.later(log).iter().map(|fault| fault.tick).collect();
        assert_eq!(later, ticks, "after {before:?}");
    }

    #[test]
    fn later_faults_are_those_that_were_not_counted_before() {
        use FaultCause::{EmergencyStop, FollowingError, Stop, SupplyLow};
        let three = log(3, &[(SupplyLow, 10), (FollowingError, 50), (Stop, 52)]);
        assert_later((0, 0), &three, &[10, 50, 52]);
        assert_later((1, 40), &three, &[50, 52]);
        assert_later((3, 60), &three, &[]);
        // Four more stops, each of which replaced the one before.
        let stopped = log(7, &[(SupplyLow, 10), (FollowingError, 50), (Stop, 300)]);
        assert_later((1, 40), &stopped, &[50, 300]);
        assert_later((3, 60), &stopped, &[300]);
        // A reset, which keeps the faults: their ticks belong to different times.
        let reset =
            log(5, &[(SupplyLow, 10), (FollowingError, 50), (Stop, 52), (EmergencyStop, 3), (Stop, 5)]);
        assert_later((3, 60), &reset, &[3, 5]);
        let cause = |total, tick| FaultsBefore { total, tick }.cause(&three).to_vec();
        assert_eq!(cause(1, 40), three.faults[1..2]);
        assert_eq!(cause(3, 60), three.faults[1..]);
        // A board that was switched off in between.
        assert_later((7, 9000), &three, &[10, 50, 52]);
        // More faults than the log holds.
        let full = log(40, &[(SupplyLow, 10); 16]);
        assert_eq!(FaultsBefore::default().later(&full).len(), 16);
        assert_later((0, 0), &FaultLog::new(), &[]);
    }

    #[test]
    fn each_fault_is_told_once_whatever_telemetry_is_still_on_its_way() {
        use FaultCause::{FollowingError, Stop, SupplyLow};
        let telemetry =
            |faults, tick| Telemetry { tick, mode: Mode::Fault, faults, joints: heapless::Vec::new() };
        let mut follower = FaultFollower::new(FaultsBefore { total: 1, tick: 40 });
        assert!(!follower.is_due(&telemetry(1, 41)));
        // The log is read when the telemetry counts the first of two faults.
        assert!(follower.is_due(&telemetry(2, 50)));
        let read = log(3, &[(SupplyLow, 10), (FollowingError, 50), (Stop, 52)]);
        assert_eq!(follower.take(&telemetry(2, 50), &read), &read.faults[1..]);
        assert!(!follower.is_due(&telemetry(2, 51)));
        assert!(!follower.is_due(&telemetry(3, 52)));
        // A board that was switched off in between.
        follower.read = Instant::now().checked_sub(2 * ON_ITS_WAY);
        assert!(follower.is_due(&telemetry(0, 5)));
        assert!(follower.take(&telemetry(0, 5), &FaultLog::new()).is_empty());
        assert!(follower.is_due(&telemetry(1, 9)));
    }

    #[test]
    fn a_stop_is_not_all_that_is_blamed() {
        use FaultCause::{FollowingError, Stop, SupplyLow};
        let causes = |log: &FaultLog| blamed(log).iter().map(|fault| fault.cause).collect::<Vec<_>>();
        let stopped = log(3, &[(SupplyLow, 10), (FollowingError, 50), (Stop, 52)]);
        assert_eq!(causes(&stopped), [FollowingError, Stop]);
        assert_eq!(causes(&log(2, &[(Stop, 10), (FollowingError, 50)])), [FollowingError]);
        assert_eq!(causes(&log(1, &[(Stop, 10)])), [Stop]);
        assert_eq!(causes(&FaultLog::new()), []);

        let text = explain(blamed(&stopped), None);
        let words = ["fault 17 in tick 52: stopped by the supervisor", "; before it: fault 3 in tick 50: "];
        let entries =
            "\nSee docs/troubleshooting.md#fault-17-stop and docs/troubleshooting.md#fault-3-followingerror";
        assert!(text.starts_with(words[0]) && text.contains(words[1]) && text.ends_with(entries), "{text}");
        assert_eq!(explain(&[], None), "no fault is recorded");
    }
}
