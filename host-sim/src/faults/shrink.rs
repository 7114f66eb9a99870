//! Shrinking: the smallest schedule that still fails.

use super::schedule::Schedule;

/// Maximum number of schedules that are tried.
const MAX_TRIES: usize = 60;

/// Returns the smallest schedule found that still `fails`: with fewer faults, shorter and smaller ones.
pub fn shrink(schedule: &Schedule, mut fails: impl FnMut(&Schedule) -> bool) -> Schedule {
    let mut smallest = schedule.clone();
    let mut tries = 0;
    loop {
        let smaller = candidates(&smallest).into_iter().find(|candidate| {
            tries += 1;
            tries <= MAX_TRIES && fails(candidate)
        });
        match smaller {
            Some(smaller) => smallest = smaller,
            None => return smallest,
        }
    }
}

/// Returns schedules that are one step smaller, the largest step first.
fn candidates(schedule: &Schedule) -> Vec<Schedule> {
    let mut smaller = Vec::new();
    if schedule.faults.len() > 1 {
        for index in 0..schedule.faults.len() {
            let mut candidate = schedule.clone();
            candidate.faults.remove(index);
            smaller.push(candidate);
        }
    }
    for (index, fault) in schedule.faults.iter().enumerate() {
        for kind in fault.kind.simpler() {
            let mut candidate = schedule.clone();
            candidate.faults[index].kind = kind;
            smaller.push(candidate);
        }
        if let Some(ticks) = fault.ticks.filter(|&ticks| ticks > 1) {
            let mut candidate = schedule.clone();
            candidate.faults[index].ticks = Some(ticks / 2);
            smaller.push(candidate);
        }
    }
    smaller
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::faults::schedule::{Fault, Kind};

    /// Only a jump of at least 100 counts fails, regardless of the other faults.
    #[test]
    fn a_schedule_shrinks_to_its_one_cause() {
        let fault = |kind, begin| Fault { kind, begin, ticks: Some(40) };
        let schedule = Schedule {
            faults: vec![
                fault(Kind::Cut, 100),
                fault(Kind::Jump { joint: 2, counts: 1500 }, 120),
                fault(Kind::Sag { voltage: 3.0 }, 130),
            ],
            ..Schedule::draw(1)
        };
        let mut runs = 0;
        let smallest = shrink(&schedule, |candidate| {
            runs += 1;
            let is_cause =
                |fault: &Fault| matches!(fault.kind, Kind::Jump { counts, .. } if counts.abs() >= 100);
            candidate.faults.iter().any(is_cause)
        });
        let kind = Kind::Jump { joint: 2, counts: 187 };
        let expected = vec![Fault { kind, begin: 120, ticks: Some(1) }];
        // 187 / 2 is below 100.
        assert_eq!(smallest.faults, expected);
        assert!(runs <= MAX_TRIES);
    }

    #[test]
    fn what_cannot_be_smaller_stays() {
        let kind = Kind::Killed;
        let schedule = Schedule { faults: vec![Fault { kind, begin: 9, ticks: None }], ..Schedule::draw(1) };
        assert_eq!(shrink(&schedule, |_| true), schedule);
    }
}
