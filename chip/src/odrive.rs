//! The devices at the pins of an ODrive v3.6 for 56 V: two stages of three half bridges behind gate drivers
//! DRV8301, shunts, a divider at the supply. Brushed motors are connected between the half bridges B and C.
//!
//! Written from the data sheets of chip and gate driver and from the public header of the board
//! (`Firmware/Board/v3/Inc/main.h`), not from its driver.

use crate::drv8301::Drv8301;
use crate::gpio::Gpio;
use crate::pins::Pin;
use crate::spi::Sent;
use crate::tim1::{Level, Tim1};

pub const ENABLE: Pin = Pin(1, 12);
pub const FAULT: Pin = Pin(3, 2);
pub const STOP: Pin = Pin(2, 4);
const SELECT: [Pin; 2] = [Pin(2, 13), Pin(2, 14)];
const SPI: [(Pin, &str); 3] = [(Pin(2, 10), "SCK"), (Pin(2, 11), "MISO"), (Pin(2, 12), "MOSI")];
/// Gates of the brake resistor.
const BRAKE: [Pin; 2] = [Pin(1, 10), Pin(1, 11)];
/// Gates of the high and of the low side, by motor and half bridge (A, B, C).
const GATES: [[[Pin; 2]; 3]; 2] = [
    [[Pin(0, 8), Pin(1, 13)], [Pin(0, 9), Pin(1, 14)], [Pin(0, 10), Pin(1, 15)]],
    [[Pin(2, 6), Pin(0, 7)], [Pin(2, 7), Pin(1, 0)], [Pin(2, 8), Pin(1, 1)]],
];
const TIMERS: [&str; 2] = ["TIM1", "TIM8"];
const CHANNELS: [[&str; 2]; 3] = [["CH1", "CH1N"], ["CH2", "CH2N"], ["CH3", "CH3N"]];
/// Shunt [Ω].
const SHUNT: f64 = 0.5e-3;
/// Reference of the amplifiers and of the converters [V].
const REFERENCE: f64 = 3.3;
const DIVIDER: f64 = 19.0;
/// Voltage of a body diode [V].
const DIODE: f64 = 0.7;
/// Minimum dead time between the gates of a half bridge [ps].
const PAUSE: u64 = 100_000;

/// A half bridge.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Bridge {
    High,
    Low,
    #[default]
    Off,
}

/// State of the terminals of a motor.
pub enum Terminals {
    /// A voltage from B to C [V].
    Driven(f64),
    /// The same, but diodes conduct: the current does not reverse.
    Blocked(f64),
    /// No current flows.
    Open,
}

#[derive(Clone, Debug)]
pub struct Odrive {
    pub drivers: [Drv8301; 2],
    /// Offsets at the inputs of the amplifiers of B and C, by motor [V].
    pub offsets: [[f64; 2]; 2],
    /// Dead amplifiers: their output stays in the middle.
    pub dead: [[bool; 2]; 2],
    /// The half bridges B and C of each motor.
    bridges: [[Bridge; 2]; 2],
    /// When each gate was on for the last time, by motor, half bridge and side.
    on: [[[u64; 2]; 3]; 2],
    /// A violation of what must never happen.
    pub violation: Option<&'static str>,
}

impl Default for Odrive {
    fn default() -> Self {
        Self {
            drivers: Default::default(),
            offsets: [[1.5e-3, -0.8e-3], [-2e-3, 0.4e-3]],
            dead: Default::default(),
            bridges: Default::default(),
            on: Default::default(),
            violation: None,
        }
    }
}

impl Odrive {
    /// Updates the lines of the gate drivers.
    pub fn observe(&mut self, gpio: &Gpio, now: u64) {
        let is_enabled = gpio.output(ENABLE) == Some(true);
        for (driver, select) in self.drivers.iter_mut().zip(SELECT) {
            driver.enable(is_enabled, now);
            driver.select(gpio.output(select) == Some(false), now);
        }
        if BRAKE.iter().any(|pin| gpio.output(*pin) == Some(true)) {
            self.violation = Some("the brake resistor is on");
        }
    }

    pub fn tells_fault(&self, now: u64) -> bool {
        self.drivers.iter().any(|driver| driver.tells_fault(now))
    }

    /// Exchanges a word over the bus, if the pins are set up for it.
    pub fn exchange(&mut self, sent: &Sent, gpio: &Gpio, now: u64) -> u32 {
        let [clock, answer, data] = SPI.map(|(pin, name)| gpio.signal(pin) == Some(("SPI3", name)));
        if !clock || !data {
            return 0;
        }
        let answers: Vec<u32> =
            self.drivers.iter_mut().filter_map(|driver| driver.exchange(sent, now)).collect();
        // Two selected drivers would work against each other.
        let [word] = answers[..] else { return 0 };
        if answer { word } else { 0 }
    }

    /// Returns the level of a gate's input, which a resistor in the gate driver holds low.
    fn is_on(gpio: &Gpio, timers: [&Tim1; 2], place: (usize, usize, usize), now: u64, clock: u64) -> bool {
        let (motor, bridge, side) = place;
        let pin = GATES[motor][bridge][side];
        let is_pulsed = gpio.signal(pin) == Some((TIMERS[motor], CHANNELS[bridge][side]));
        is_pulsed && timers[motor].outputs(bridge, now, clock)[side] == Level::High
            || gpio.output(pin) == Some(true)
    }

    /// Returns what is at the terminals of a motor with this current between two edges.
    pub fn terminals(
        &mut self,
        motor: usize,
        current: f64,
        supply: f64,
        (gpio, timers, clock): (&Gpio, [&Tim1; 2], u64),
        [begin, now, end]: [u64; 3],
    ) -> Terminals {
        for bridge in 0..3 {
            let gates = [0, 1].map(|side| Self::is_on(gpio, timers, (motor, bridge, side), now, clock));
            let drives = self.drivers[motor].drives(bridge, now);
            let last = self.on[motor][bridge];
            for (side, _) in gates.into_iter().enumerate().filter(|(_, is_on)| *is_on) {
                let other = last[1 - side];
                // It switches on: the other one must have been off for the dead time.
                let goes_on = last[side] < begin;
                if drives && goes_on && other != 0 && other + PAUSE > begin {
                    self.violation = Some("a half bridge without dead time");
                }
                self.on[motor][bridge][side] = end;
            }
            if gates == [true; 2] && drives {
                self.violation = Some("both sides of a half bridge are on");
            }
            match (bridge, gates) {
                (0, [false, false]) => {}
                (0, _) => self.violation = Some("a half bridge without motor is on"),
                _ => {
                    self.bridges[motor][bridge - 1] = match (drives, gates) {
                        (true, [true, false]) => Bridge::High,
                        (true, [false, true]) => Bridge::Low,
                        _ => Bridge::Off,
                    }
                }
            }
        }
        let volts = |bridge: Bridge, out: f64| match bridge {
            Bridge::High => Some(supply),
            Bridge::Low => Some(0.0),
            Bridge::Off if out > 0.0 => Some(-DIODE),
            Bridge::Off if out < 0.0 => Some(supply + DIODE),
            Bridge::Off => None,
        };
        let [b, c] = self.bridges[motor];
        match (volts(b, current), volts(c, -current)) {
            (Some(first), Some(second)) if b != Bridge::Off && c != Bridge::Off => {
                Terminals::Driven(first - second)
            }
            (Some(first), Some(second)) => Terminals::Blocked(first - second),
            _ => Terminals::Open,
        }
    }

    /// Returns whether a transistor is on.
    pub fn is_any_gate_on(&self) -> bool {
        self.bridges.iter().flatten().any(|bridge| *bridge != Bridge::Off)
    }

    /// Returns whether the supply drives a motor.
    pub fn is_driven(&self, motor: usize) -> bool {
        let [b, c] = self.bridges[motor];
        b != c && (b == Bridge::High || c == Bridge::High)
    }

    /// Returns the voltage at a converter's channel; `currents` flow from B to C.
    pub fn volts(&self, gpio: &Gpio, channel: u32, currents: [f64; 2], supply: f64, now: u64) -> f64 {
        let (pin, place) = match channel {
            6 => (Pin(0, 6), None),
            10 => (Pin(2, 0), Some((0, 0))),
            11 => (Pin(2, 1), Some((0, 1))),
            12 => (Pin(2, 2), Some((1, 1))),
            13 => (Pin(2, 3), Some((1, 0))),
            _ => return 0.0,
        };
        if gpio.mode(pin) != crate::gpio::Mode::Analog {
            return 0.0;
        }
        let Some((motor, bridge)) = place else { return supply / DIVIDER };
        let Some(gain) = self.drivers[motor].gain(now) else { return 0.0 };
        if self.dead[motor][bridge] {
            return 0.5 * REFERENCE;
        }
        let out = if bridge == 0 { currents[motor] } else { -currents[motor] };
        // Through the transistor of the low side, or through its diode.
        let conducts = match self.bridges[motor][bridge] {
            Bridge::Low => true,
            Bridge::Off => out > 0.0,
            Bridge::High => false,
        };
        let shunt = if conducts { SHUNT * out } else { 0.0 };
        let volts = 0.5 * REFERENCE + gain * (shunt + self.offsets[motor][bridge]);
        volts.clamp(0.0, REFERENCE)
    }
}
