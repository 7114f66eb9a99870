use std::time::{Duration, Instant};

/// By how much the clocks of source and PC may drift apart [s/s].
const DRIFT: f64 = 1e-3;
/// A sample that by its time stamp comes later than this is too late for the board [s].
const LATE: f64 = 0.2;
/// After samples that are all late for this time, the stamps are taken to have jumped.
const JUMPED: Duration = Duration::from_secs(1);
/// Stamps that jump again within this time are none.
const STEADY: Duration = Duration::from_secs(30);
/// The rate of the source's clock is compared with that of the PC after this time.
const WINDOW: Duration = Duration::from_secs(2);
/// A clock that runs ahead of the PC's by more than this, twice in a row, is none [s/s].
const AHEAD: f64 = 1.1;

/// The clock of a source's time stamps, compared with that of the PC.
pub struct SourceClock {
    start: Instant,
    /// Clock of the PC less clock of the source for the samples that come soonest [s].
    offset: Option<f64>,
    /// When the last sample came.
    last: Option<Instant>,
    /// Since when all samples are late.
    late: Option<Instant>,
    /// When the stamps have jumped last.
    jumped: Option<Instant>,
    /// Arrival and time stamp [s] at the start of the window, and whether the clock ran ahead in the one
    /// before.
    window: Option<(Instant, f64, bool)>,
    /// What is wrong with the stamps.
    pub wrong: Option<String>,
}

impl SourceClock {
    pub const fn new(start: Instant) -> Self {
        Self { start, offset: None, last: None, late: None, jumped: None, window: None, wrong: None }
    }

    /// Forgets the stamps that have come.
    pub const fn forget(&mut self) {
        (self.offset, self.late, self.window) = (None, None, None);
    }

    /// Whether samples are late by their time stamps.
    pub const fn is_late(&self) -> bool {
        self.late.is_some()
    }

    /// How much later a sample comes than the soonest ones [s].
    #[expect(clippy::cast_possible_truncation, reason = "a short time")]
    pub fn age(&mut self, arrived: Instant, time: f64) -> f32 {
        let offset = arrived.duration_since(self.start).as_secs_f64() - time;
        let since = self.last.map_or(0.0, |before| arrived.duration_since(before).as_secs_f64());
        self.last = Some(arrived);
        self.check_rate(arrived, time);
        let mut soonest = self.offset.map_or(offset, |soonest| offset.min(soonest + DRIFT * since));
        if offset - soonest <= LATE {
            self.late = None;
        } else if arrived.duration_since(*self.late.get_or_insert(arrived)) > JUMPED {
            // A stamp was ahead, or the source has set its clock.
            let again = self.jumped.replace(arrived).is_some_and(|before| arrived - before < STEADY);
            if again {
                self.wrong = Some(format!(
                    "its time stamps fall behind the clock ({:.1} s late): is `time` in seconds?",
                    offset - soonest
                ));
            }
            (self.late, soonest) = (None, offset);
        }
        self.offset = Some(soonest);
        (offset - soonest) as f32
    }

    /// Notices a clock that runs ahead, which the soonest samples alone do not show. Samples that have waited
    /// to be taken come all at once, but only in one window.
    fn check_rate(&mut self, arrived: Instant, time: f64) {
        let (begin, first, before) = *self.window.get_or_insert((arrived, time, false));
        let elapsed = arrived.duration_since(begin);
        if elapsed < WINDOW {
            return;
        }
        let rate = (time - first) / elapsed.as_secs_f64();
        let ahead = rate > AHEAD;
        if ahead && before {
            self.wrong = Some(format!(
                "its time stamps run ahead of the clock (by {rate:.1} s in a second): is `time` in seconds?"
            ));
        }
        self.window = Some((arrived, time, ahead));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The ages of samples [s], and what is wrong in the end. Each has the time of its arrival and its stamp
    /// [s].
    fn ages(samples: impl Iterator<Item = (f64, f64)>) -> (Vec<f32>, Option<String>) {
        let start = Instant::now();
        let mut clock = SourceClock::new(start);
        let ages = samples
            .map(|(arrived, time)| clock.age(start + Duration::from_secs_f64(arrived), time))
            .collect();
        (ages, clock.wrong)
    }

    /// Samples 20 ms apart for some seconds, at a source whose clock has this rate.
    fn steady(seconds: u32, rate: f64) -> impl Iterator<Item = (f64, f64)> {
        (0..50 * seconds).map(move |index| (0.02 * f64::from(index), 700.0 + 0.02 * rate * f64::from(index)))
    }

    #[test]
    fn a_late_sample_has_its_age_and_the_offset_of_the_clocks_does_not_matter() {
        let (ages, wrong) = ages([(0.0, 50.0), (0.01, 50.01), (0.05, 50.02), (0.051, 50.03)].into_iter());
        let close = |age: Option<&f32>, expected: f32| age.is_some_and(|age| (age - expected).abs() < 1e-4);
        assert!(close(ages.get(2), 0.03) && close(ages.get(3), 0.021), "{ages:?}");
        assert!(wrong.is_none());
    }

    #[test]
    fn a_clock_that_runs_off_is_noticed_and_a_good_one_is_not() {
        for rate in [1.0, 1.0008, 0.9992] {
            let (ages, wrong) = ages(steady(120, rate));
            assert!(wrong.is_none() && ages.iter().all(|age| *age < 0.05), "{rate}: {wrong:?}");
        }
        for (rate, words) in [(1000.0, "run ahead of the clock"), (2.0, "run ahead"), (0.5, "fall behind")] {
            let (_, wrong) = ages(steady(10, rate));
            assert!(wrong.as_ref().is_some_and(|wrong| wrong.contains(words)), "{rate}: {wrong:?}");
        }
        // Half a minute that has waited, then steady.
        let waiting = (0..1500).map(|index| (0.0, 0.02 * f64::from(index)));
        let then = (0..500).map(|index| (0.02 * f64::from(index), 30.0 + 0.02 * f64::from(index)));
        assert_eq!(ages(waiting.chain(then)).1, None);
    }
}
