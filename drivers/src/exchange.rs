//! Messages between the control task and the current loops, as the words of a
//! [`Handover`](crate::handover::Handover).

use crate::motors::{Command, Totals};

/// The control task's order to the current loops until its next period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order<const N: usize> {
    /// The motors are off, and the current measurement may sleep.
    Off,
    /// The motors are off, and the current measurement works: its offsets can be learnt.
    Learn,
    /// The motors are driven.
    Drive(Command<N>),
}

/// Returns the number of words of an [`Order`] to `motors` motors.
pub const fn order_words(motors: usize) -> usize {
    2 * motors + 1
}

impl<const N: usize> Order<N> {
    const OFF: u32 = 0;
    const LEARN: u32 = 1;
    const DRIVE: u32 = 2;

    /// Encodes the order as `W` words, which must be [`order_words`].
    pub fn words<const W: usize>(&self) -> [u32; W] {
        const { assert!(W == order_words(N)) }
        let mut words = [0; W];
        let mut rest = words.iter_mut();
        if let Some(first) = rest.next() {
            *first = match self {
                Self::Off => Self::OFF,
                Self::Learn => Self::LEARN,
                Self::Drive(_) => Self::DRIVE,
            };
        }
        if let Self::Drive(command) = self {
            let values = command.currents.iter().chain(&command.velocities);
            rest.zip(values).for_each(|(word, value)| *word = value.to_bits());
        }
        words
    }

    /// Decodes these words.
    pub fn from_words<const W: usize>(words: &[u32; W]) -> Self {
        const { assert!(W == order_words(N)) }
        let [what, values @ ..] = &words[..] else { return Self::Off };
        let mut values = values.iter().map(|word| f32::from_bits(*word));
        let mut next = |_| values.next().unwrap_or_default();
        match *what {
            Self::DRIVE => Self::Drive(Command {
                currents: core::array::from_fn(&mut next),
                velocities: core::array::from_fn(&mut next),
            }),
            Self::LEARN => Self::Learn,
            _ => Self::Off,
        }
    }

    /// Returns the command of [`Order::Drive`].
    pub const fn command(&self) -> Option<&Command<N>> {
        if let Self::Drive(command) = self { Some(command) } else { None }
    }
}

/// The measurements of the current loops.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LoopReport<const N: usize> {
    /// Totals since the start.
    pub totals: Totals<N>,
    /// The last sample of the supply [mV]; after a trip, the one at which it came.
    pub supply: u16,
    /// Whether the motors are off because of a trip.
    pub has_tripped: bool,
    /// Whether the supply was the cause.
    pub supply_tripped: bool,
    /// Whether the currents can be measured: their offsets, where there are any, are known.
    pub is_ready: bool,
}

/// Returns the number of words of [`LoopReport`] for `motors` motors.
pub const fn report_words(motors: usize) -> usize {
    2 * motors + 5
}

impl<const N: usize> LoopReport<N> {
    const TRIPPED: u32 = 1;
    const READY: u32 = 2;
    const SUPPLY_TRIPPED: u32 = 4;

    /// Encodes the measurements as `W` words, which must be [`report_words`].
    pub fn words<const W: usize>(&self) -> [u32; W] {
        const { assert!(W == report_words(N)) }
        let Totals { currents, voltages, supply, periods, driven } = &self.totals;
        let states = [
            (self.has_tripped, Self::TRIPPED),
            (self.is_ready, Self::READY),
            (self.supply_tripped, Self::SUPPLY_TRIPPED),
        ];
        let bits = states.iter().filter(|(holds, _)| *holds).map(|(_, bit)| bit).sum();
        let mut words = [0; W];
        let mut places = words.iter_mut();
        let mut put = |value| {
            if let Some(place) = places.next() {
                *place = value;
            }
        };
        currents.iter().for_each(|sum| put(sum.cast_unsigned()));
        voltages.iter().for_each(|sum| put(sum.cast_unsigned()));
        [*supply, *periods, *driven, self.supply.into(), bits].into_iter().for_each(put);
        words
    }

    /// Decodes these words.
    pub fn from_words<const W: usize>(words: &[u32; W]) -> Self {
        const { assert!(W == report_words(N)) }
        let mut words = words.iter().copied();
        let mut next = || words.next().unwrap_or_default();
        let totals = Totals {
            currents: core::array::from_fn(|_| next().cast_signed()),
            voltages: core::array::from_fn(|_| next().cast_signed()),
            supply: next(),
            periods: next(),
            driven: next(),
        };
        #[expect(clippy::cast_possible_truncation, reason = "it was of 16 bits")]
        let supply = next() as u16;
        let bits = next();
        let [has_tripped, is_ready, supply_tripped] =
            [Self::TRIPPED, Self::READY, Self::SUPPLY_TRIPPED].map(|bit| bits & bit != 0);
        Self { totals, supply, has_tripped, supply_tripped, is_ready }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_handed_over_arrives() {
        let command = Command { currents: [0.25, -1.5], velocities: [3.0, -0.0] };
        // IEEE 754, by hand: sign, exponent with a bias of 127, fraction.
        let words = [2, 0x3E80_0000, 0xBFC0_0000, 0x4040_0000, 0x8000_0000];
        assert_eq!(Order::Drive(command).words(), words);
        for order in [Order::Off, Order::Learn, Order::Drive(command)] {
            assert_eq!(Order::<2>::from_words(&order.words::<5>()), order);
        }
        assert_eq!(Order::Drive(command).command(), Some(&command));
        assert_eq!(Order::<2>::Learn.command(), None);
        // All zeros mean off.
        assert_eq!(Order::<2>::from_words(&[0; 5]), Order::Off);
        let totals =
            Totals { currents: [1, -2], voltages: [i32::MIN, 4], supply: 5, periods: u32::MAX, driven: 6 };
        for bits in 0..8 {
            let [has_tripped, is_ready, supply_tripped] = [1, 2, 4].map(|bit| bits & bit != 0);
            let measured = LoopReport { totals, supply: u16::MAX, has_tripped, supply_tripped, is_ready };
            assert_eq!(LoopReport::<2>::from_words(&measured.words::<9>()), measured);
        }
    }
}
