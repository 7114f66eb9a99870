//! Gate drivers behind one enable line: they are woken, set up and watched, and put to sleep at the first
//! fault.

use embedded_hal::digital::StatefulOutputPin;
use embedded_hal::spi::SpiDevice;
use tesaki::TICK;

use crate::drv8301::{Drv8301, RESET_TIME, WAKE_TIME};

/// Control periods for which the drivers sleep, so that they forget all settings. The first may be cut short.
const SLEEP_PERIODS: u8 = 2;
const _: () = assert!(TICK * 1e6 * (SLEEP_PERIODS as f32 - 1.0) >= RESET_TIME);
/// Control periods until the drivers are awake. The first may be cut short.
const WAKE_PERIODS: u8 = 2;
const _: () = assert!(TICK * 1e6 * (WAKE_PERIODS as f32 - 1.0) >= WAKE_TIME);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    /// Asleep for at least this many more periods.
    Asleep(u8),
    Waking(u8),
    Ready,
}

/// `N` gate drivers that one line enables.
///
/// Code that finds a fault, in any context, pulls the line low. That alone switches the transistors off;
/// [`Gates::update`] notices it, and later wakes the drivers again with all their settings.
#[derive(Debug)]
pub struct Gates<S, E, const N: usize> {
    drivers: [Drv8301<S>; N],
    enable: E,
    phase: Phase,
}

impl<S: SpiDevice, E: StatefulOutputPin, const N: usize> Gates<S, E, N> {
    /// Creates sleeping drivers: `enable` must be low.
    pub const fn new(drivers: [Drv8301<S>; N], enable: E) -> Self {
        Self { drivers, enable, phase: Phase::Asleep(SLEEP_PERIODS) }
    }

    /// Runs one control period. Returns whether the drivers are set up and have no fault.
    ///
    /// They may not wake while `is_waking_allowed` is false: a DRV8301 that is enabled while a motor drives
    /// its terminals above 8.5 V may not start (SLOS719, 8.1.1).
    pub fn update(&mut self, is_waking_allowed: bool) -> bool {
        // A pin that cannot be read counts as low.
        let is_enabled = self.enable.is_set_high().unwrap_or(false);
        if !is_enabled && !matches!(self.phase, Phase::Asleep(_)) {
            self.phase = Phase::Asleep(SLEEP_PERIODS);
        }
        match self.phase {
            Phase::Asleep(0) if is_waking_allowed && self.enable.set_high().is_ok() => {
                self.phase = Phase::Waking(WAKE_PERIODS);
            }
            Phase::Asleep(periods) => self.phase = Phase::Asleep(periods.saturating_sub(1)),
            Phase::Waking(periods @ 2..) => self.phase = Phase::Waking(periods - 1),
            Phase::Waking(_) => self.finish(Drv8301::set_up),
            Phase::Ready => self.finish(Drv8301::check),
        }
        self.phase == Phase::Ready
    }

    /// Calls each driver, and puts all to sleep at the first error.
    fn finish<T>(&mut self, call: impl Fn(&mut Drv8301<S>) -> Result<(), T>) {
        if self.drivers.iter_mut().all(|driver| call(driver).is_ok()) {
            self.phase = Phase::Ready;
        } else {
            // If that fails, nothing else can be done here: the board does not use the drivers.
            let _ = self.enable.set_low();
            self.phase = Phase::Asleep(SLEEP_PERIODS);
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::cell::Cell;
    use std::convert::Infallible;

    use embedded_hal::digital::{ErrorType, OutputPin};
    use embedded_hal::spi;
    use embedded_hal::spi::Operation;

    use super::*;
    use crate::drv8301::{Gain, GateCurrent, Settings};

    /// The enable line, and a gate driver behind it.
    #[derive(Default)]
    struct Board {
        enabled: Cell<bool>,
        /// Control registers.
        control: Cell<[u16; 2]>,
        status: Cell<u16>,
        asked: Cell<u16>,
        words: Cell<u32>,
    }

    struct Line<'a>(&'a Board);
    struct Chip<'a>(&'a Board);

    impl ErrorType for Line<'_> {
        type Error = Infallible;
    }
    impl OutputPin for Line<'_> {
        fn set_low(&mut self) -> Result<(), Infallible> {
            self.0.enabled.set(false);
            self.0.control.set([0; 2]);
            Ok(())
        }
        fn set_high(&mut self) -> Result<(), Infallible> {
            self.0.enabled.set(true);
            Ok(())
        }
    }
    impl StatefulOutputPin for Line<'_> {
        fn is_set_high(&mut self) -> Result<bool, Infallible> {
            Ok(self.0.enabled.get())
        }
        fn is_set_low(&mut self) -> Result<bool, Infallible> {
            Ok(!self.0.enabled.get())
        }
    }
    impl spi::ErrorType for Chip<'_> {
        type Error = Infallible;
    }
    impl SpiDevice for Chip<'_> {
        fn transaction(&mut self, operations: &mut [Operation<'_, u8>]) -> Result<(), Infallible> {
            let [Operation::TransferInPlace(bytes)] = operations else { panic!("{operations:?}") };
            let word = u16::from_be_bytes([bytes[0], bytes[1]]);
            let address = self.0.asked.replace(word) >> 11 & 15;
            let [one, two] = self.0.control.get();
            let value = [self.0.status.get(), 1, one, two][usize::from(address)];
            if word >> 15 == 0 {
                let (one, two) = if word >> 11 == 2 { (word & 0x7FF, two) } else { (one, word & 0x7FF) };
                self.0.control.set([one, two]);
            }
            let answer = if self.0.enabled.get() { address << 11 | value } else { 0 };
            bytes.copy_from_slice(&answer.to_be_bytes());
            self.0.words.set(self.0.words.get() + 1);
            Ok(())
        }
    }

    const SETTINGS: Settings = Settings { gate_current: GateCurrent::Low, overcurrent: 3, gain: Gain::Forty };

    fn gates(board: &Board) -> Gates<Chip<'_>, Line<'_>, 1> {
        Gates::new([Drv8301::new(Chip(board), SETTINGS)], Line(board))
    }

    /// Returns the number of periods until the drivers are ready.
    fn wake(gates: &mut Gates<Chip<'_>, Line<'_>, 1>) -> u32 {
        (1..20).find(|_| gates.update(true)).unwrap()
    }

    #[test]
    fn they_are_asked_when_they_have_been_awake_for_a_whole_period() {
        let board = Board::default();
        let mut gates = gates(&board);
        while !board.enabled.get() {
            assert!(!gates.update(true));
        }
        assert!(!gates.update(true) && board.words.get() == 0);
        assert!(gates.update(true));
        // 0.25 A, latched shutdown, row 3; gain 40.
        assert_eq!(board.control.get(), [2 | 1 << 4 | 3 << 6, 2 << 2]);
    }

    #[test]
    fn they_sleep_while_a_motor_turns() {
        let board = Board::default();
        let mut gates = gates(&board);
        assert!((0..20).all(|_| !gates.update(false)) && !board.enabled.get());
        assert_eq!(wake(&mut gates), 3);
        // Once awake, they stay awake.
        assert!(gates.update(false));
    }

    #[test]
    fn what_is_wrong_puts_them_to_sleep_and_they_wake_with_their_settings() {
        let faults: [fn(&Board); 3] = [
            |board| board.status.set(0x401),
            // The gain is 10 again.
            |board| board.control.set([board.control.get()[0], 0]),
            // A trip in another context.
            |board| Line(board).set_low().unwrap(),
        ];
        for (index, fault) in faults.into_iter().enumerate() {
            let board = Board::default();
            let mut gates = gates(&board);
            wake(&mut gates);
            let settings = board.control.get();
            assert!((0..5).all(|_| gates.update(true)));
            fault(&board);
            assert!(!gates.update(true) && !board.enabled.get(), "{index}");
            board.status.set(0);
            wake(&mut gates);
            assert_eq!(board.control.get(), settings, "{index}");
        }
    }
}
