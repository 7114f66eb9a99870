//! The ports: modes, outputs, and levels of the pins.

use crate::pins::{self, Pin, Signal};

/// How a pin is set up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mode {
    Input,
    Output,
    Alternate(u32),
    Analog,
}

/// Ports A to I.
pub struct Gpio {
    /// Registers of a port, by offset / 4.
    ports: [[u32; 10]; 9],
    /// Externally driven pins, and their levels.
    driven: [(u32, u32); 9],
}

impl Gpio {
    pub(crate) fn new() -> Self {
        let mut ports = [[0; 10]; 9];
        // The debugger's pins are alternate functions after a reset.
        ports[0][0] = 0xA800_0000;
        ports[0][3] = 0x6400_0000;
        ports[1][0] = 0x0000_0280;
        ports[1][3] = 0x0000_0100;
        Self { ports, driven: [(0, 0); 9] }
    }

    /// Resets the ports; externally driven levels stay.
    pub fn reset(&mut self) {
        self.ports = Self::new().ports;
    }

    /// Drives a pin externally.
    pub fn drive(&mut self, Pin(port, number): Pin, level: bool) {
        let (pins, levels) = &mut self.driven[port];
        *pins |= 1 << number;
        *levels = *levels & !(1 << number) | u32::from(level) << number;
    }

    pub fn mode(&self, Pin(port, number): Pin) -> Mode {
        let registers = &self.ports[port];
        match registers[0] >> (2 * number) & 3 {
            0 => Mode::Input,
            1 => Mode::Output,
            2 => {
                let word = registers[8 + number as usize / 8];
                Mode::Alternate(word >> (4 * (number % 8)) & 15)
            }
            _ => Mode::Analog,
        }
    }

    /// Returns the pull resistor of a pin; 1: up, 2: down.
    pub fn pull(&self, Pin(port, number): Pin) -> u32 {
        self.ports[port][3] >> (2 * number) & 3
    }

    /// Returns the peripheral's signal at a pin, if it is set up for one.
    pub fn signal(&self, pin: Pin) -> Option<Signal> {
        match self.mode(pin) {
            Mode::Alternate(function) => pins::signal(pin, function),
            _ => None,
        }
    }

    /// Returns the level of an output; `None` if the port does not drive the pin.
    pub fn output(&self, pin: Pin) -> Option<bool> {
        (self.mode(pin) == Mode::Output).then(|| self.ports[pin.0][5] >> pin.1 & 1 == 1)
    }

    /// Returns the level that an input shows.
    pub fn input(&self, pin: Pin) -> bool {
        let (pins, levels) = self.driven[pin.0];
        if let Some(level) = self.output(pin) {
            level
        } else if pins >> pin.1 & 1 == 1 {
            levels >> pin.1 & 1 == 1
        } else {
            self.pull(pin) == 1
        }
    }

    pub fn read(&self, port: usize, offset: u32) -> Option<u32> {
        match offset {
            0x10 => Some((0..16).fold(0, |word, n| word | u32::from(self.input(Pin(port, n))) << n)),
            0x18 => Some(0),
            0x00..=0x24 => Some(self.ports[port][offset as usize / 4]),
            _ => None,
        }
    }

    pub fn write(&mut self, port: usize, offset: u32, value: u32) -> Option<()> {
        let registers = &mut self.ports[port];
        match offset {
            0x10 => {}
            // Setting has priority over resetting.
            0x18 => registers[5] = registers[5] & !(value >> 16) | value & 0xFFFF,
            0x00..=0x24 => registers[offset as usize / 4] = value,
            _ => return None,
        }
        Some(())
    }
}
