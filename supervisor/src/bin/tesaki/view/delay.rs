//! How old the pictures on the pages are.

use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

use tesaki_description::plant::CONTROL_PERIOD;

/// Telemetries over which the soonest one is looked for: 10 s.
const WINDOW: usize = 500;

/// The ways from the board to this program, and from here to each page.
///
/// The clocks of board and PC are not the same. What comes soonest within some seconds has come as fast as a
/// reply does, which takes half of a round trip; all else is later by what its tick says.
#[derive(Debug, Default)]
pub struct Delay {
    begun: Option<Instant>,
    /// Time of arrival less time of the tick [s].
    offsets: VecDeque<f64>,
    board: f64,
    pages: BTreeMap<u64, f64>,
}

impl Delay {
    /// Telemetry of a tick has come.
    pub fn telemetry(&mut self, tick: u32, arrived: Instant, round_trip: Option<Duration>) {
        let begun = *self.begun.get_or_insert(arrived);
        let offset = (arrived - begun).as_secs_f64() - f64::from(tick) * CONTROL_PERIOD;
        // Its ticks begin anew after a reset.
        if self.offsets.back().is_some_and(|last| (last - offset).abs() > 1.0) {
            self.offsets.clear();
        }
        self.offsets.push_back(offset);
        if self.offsets.len() > WINDOW {
            self.offsets.pop_front();
        }
        let soonest = self.offsets.iter().copied().fold(f64::INFINITY, f64::min);
        self.board = offset - soonest + round_trip.map_or(0.0, |trip| trip.as_secs_f64() / 2.0);
    }

    /// A page has answered to a state `after` it was sent.
    pub fn page(&mut self, id: u64, after: Duration) {
        self.pages.insert(id, after.as_secs_f64() / 2.0);
    }

    /// A page has gone.
    pub fn forget(&mut self, id: u64) {
        self.pages.remove(&id);
    }

    /// From the tick to this program [ms].
    pub fn of_board(&self) -> f32 {
        milliseconds(self.board)
    }

    /// From here to a page [ms].
    pub fn of_page(&self, id: u64) -> f32 {
        milliseconds(self.pages.get(&id).copied().unwrap_or(0.0))
    }
}

#[expect(clippy::cast_possible_truncation, reason = "for people")]
fn milliseconds(seconds: f64) -> f32 {
    (seconds * 1e5).round() as f32 / 100.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_later_than_its_tick_is_older_and_pages_are_forgotten() {
        let begun = Instant::now();
        let mut delay = Delay::default();
        let trip = Some(Duration::from_millis(4));
        for (tick, millis, expected) in [(100, 0, 2.0), (102, 20, 2.0), (104, 47, 9.0), (106, 60, 2.0)] {
            delay.telemetry(tick, begun + Duration::from_millis(millis), trip);
            assert!((delay.of_board() - expected).abs() < 0.01, "tick {tick}: {} ms", delay.of_board());
        }
        delay.page(7, Duration::from_millis(6));
        assert!((delay.of_page(7) - 3.0).abs() < 0.01);
        delay.forget(7);
        assert!(delay.pages.is_empty() && delay.of_page(7) == 0.0);
        // After a reset.
        delay.telemetry(3, begun + Duration::from_secs(9), trip);
        assert!((delay.of_board() - 2.0).abs() < 0.01);
    }
}
