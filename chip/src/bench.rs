//! What is connected to the pins of a board: brushed motors with an encoder each, a supply and an emergency
//! stop, with the power stages between, three DRV8874 in PH/EN mode (`board-weact`) or those of `odrive.rs`
//! (`board-odrive`).
//!
//! Written from the datasheets of chip and power stage and from the board's wiring page, not from its driver.
//! No analogue effects: transistors switch at once, and the current mirror is exact except for the noise of
//! the converter.

use crate::force_sensor::ForceSensor;
use crate::gpio::Gpio;
use crate::odrive::{self, Odrive, Terminals};
use crate::pins::Pin;
use crate::spi::Sent;
use crate::tim1::{Level, Tim1};

/// Current at IPROPI per current of the motor.
const MIRROR: f64 = 450e-6;
const RESISTOR: f64 = 2490.0;
const REFERENCE: f64 = 3.3;
/// Ratio of the voltage divider at the supply.
const DIVIDER: f64 = 11.0;
/// Time to wake [s].
const WAKE: f64 = 1e-3;
/// Voltage of the body diodes through which the current of a sleeping stage decays [V].
const DIODES: f64 = 1.4;

const ENABLE: [(Pin, &str); 3] = [(Pin(1, 13), "CH1N"), (Pin(1, 14), "CH2N"), (Pin(1, 15), "CH3N")];
const PHASE: [Pin; 3] = [Pin(1, 0), Pin(1, 1), Pin(1, 10)];
const SLEEP: Pin = Pin(2, 5);
const TRIP: Pin = Pin(0, 6);
const STOP: Pin = Pin(2, 8);

/// A brushed motor with what it moves, seen from the joint.
#[derive(Clone, Copy, Debug)]
pub struct Motor {
    /// [Ω], [H].
    pub resistance: f64,
    pub inductance: f64,
    /// [N·m/A] and [V·s/rad].
    pub constant: f64,
    /// [kg·m²]; infinite if something else moves the joint: its velocity stays constant.
    pub inertia: f64,
    /// Coulomb friction [N·m] and viscous friction [N·m·s/rad].
    pub coulomb: f64,
    pub viscous: f64,
    /// Counts of the encoder per turn of the joint.
    pub counts: f64,
    /// External torque [N·m].
    pub load: f64,
    /// The joint cannot move.
    pub blocked: bool,
}

/// State of a motor.
#[derive(Clone, Copy, Debug, Default)]
pub struct State {
    /// [A], [rad/s], [rad].
    pub current: f64,
    pub velocity: f64,
    pub angle: f64,
    /// Integral of the motor's torque since power-on [N·m·s].
    pub impulse: f64,
    /// Whether the power stage applies a voltage to the motor.
    pub driven: bool,
    /// Direction of that voltage.
    positive: bool,
}

/// An encoder's pins, the timer that should count it, and its place among TIM2 to TIM5.
pub type Encoder = (Pin, Pin, &'static str, usize);
const ENCODERS: [Encoder; 3] =
    [(Pin(2, 6), Pin(2, 7), "TIM3", 1), (Pin(1, 6), Pin(1, 7), "TIM4", 2), (Pin(0, 0), Pin(0, 1), "TIM5", 3)];
const ODRIVE_ENCODERS: [Encoder; 2] = [(Pin(1, 4), Pin(1, 5), "TIM3", 1), (Pin(1, 6), Pin(1, 7), "TIM4", 2)];

pub struct Bench {
    /// The board is an ODrive, which has no third motor.
    pub odrive: Option<Odrive>,
    /// A force sensor at the tip, behind its converter.
    pub force_sensor: Option<ForceSensor>,
    pub motors: [Motor; 3],
    pub states: [State; 3],
    /// Voltage and inner resistance of the supply [V], [Ω].
    pub supply: f64,
    pub supply_resistance: f64,
    /// The emergency stop is pressed.
    pub stop: bool,
    /// A power stage pulls its nFAULT down.
    pub fault: bool,
    /// The encoders' cables are unplugged: their counts freeze.
    pub unplugged: [bool; 3],
    /// Current that is added to the measured one, such as by a short circuit [A].
    pub leak: [f64; 3],
    /// The wire of a motor's current sense is open: it reads 0.
    pub blind: [bool; 3],
    counts: [i64; 3],
    /// When the stages are awake; `None`: asleep.
    awake: Option<u64>,
    now: u64,
    noise: std::cell::Cell<u32>,
    /// The last time at which any stage drove.
    pub last_driven: u64,
}

impl Bench {
    pub fn new(motors: [Motor; 3], seed: u32) -> Self {
        Self {
            odrive: None,
            force_sensor: None,
            motors,
            states: [State::default(); 3],
            supply: 24.0,
            supply_resistance: 0.1,
            stop: false,
            fault: false,
            unplugged: [false; 3],
            leak: [0.0; 3],
            blind: [false; 3],
            counts: [0; 3],
            awake: None,
            now: 0,
            noise: std::cell::Cell::new(seed),
            last_driven: 0,
        }
    }

    /// Creates an ODrive with two motors.
    pub fn with_odrive([first, second]: [Motor; 2], seed: u32) -> Self {
        Self { odrive: Some(Odrive::default()), ..Self::new([first, second, second], seed) }
    }

    /// Returns whether the power stages are awake, or their gate drivers enabled.
    pub fn is_awake(&self) -> bool {
        self.awake.is_some()
    }

    /// Returns the encoders.
    pub fn encoders(&self) -> &'static [Encoder] {
        if self.odrive.is_some() { &ODRIVE_ENCODERS } else { &ENCODERS }
    }

    /// Returns the index of the supervisor's line among USART1, USART2, UART4.
    pub fn supervisor(&self) -> usize {
        if self.odrive.is_some() { 2 } else { 0 }
    }

    /// Exchanges a word over SPI1 or SPI3.
    pub fn exchange(&mut self, bus: &str, sent: &Sent, gpio: &Gpio, now: u64) -> u32 {
        match (&mut self.odrive, &mut self.force_sensor) {
            (Some(odrive), _) if bus == "SPI3" => odrive.exchange(sent, gpio, now),
            (None, Some(sensor)) if bus == "SPI1" => sensor.exchange(sent, gpio),
            _ => 0,
        }
    }

    /// Returns the next time at which something at the pins changes by itself.
    pub fn next(&self) -> u64 {
        self.force_sensor.as_ref().map_or(u64::MAX, ForceSensor::next)
    }

    /// Applies the immediate effects of the levels of outputs.
    pub fn observe(&mut self, gpio: &Gpio, now: u64) {
        if let Some(sensor) = &mut self.force_sensor {
            sensor.observe(gpio, now);
        }
        if let Some(odrive) = &mut self.odrive {
            odrive.observe(gpio, now);
            self.awake = (gpio.output(odrive::ENABLE) == Some(true)).then_some(0);
        }
    }

    /// Returns the counts of an encoder since power-on.
    pub fn counts(&self, motor: usize) -> i64 {
        self.counts[motor]
    }

    /// Returns the levels of the chip's inputs: resistors at the emergency stop, and open drains at the trip.
    pub fn inputs(&self, now: u64) -> [Option<(Pin, bool)>; 3] {
        if let Some(odrive) = &self.odrive {
            let fault = self.fault || odrive.tells_fault(now);
            return [Some((odrive::STOP, !self.stop)), Some((odrive::FAULT, !fault)), None];
        }
        let data = self.force_sensor.as_ref().and_then(ForceSensor::data_line);
        [Some((STOP, !self.stop)), Some((TRIP, !self.stop && !self.fault)), data]
    }

    /// Returns the supply voltage at the stages [V].
    fn voltage(&self) -> f64 {
        let drawn: f64 =
            self.states.iter().filter(|state| state.driven).map(|state| state.current.abs()).sum();
        self.supply - self.supply_resistance * drawn
    }

    /// Returns the level at a converter's channel as a fraction of full scale.
    pub fn analogue(&self, gpio: &Gpio, channel: u32) -> f64 {
        let volts = if let Some(odrive) = &self.odrive {
            let currents = [0, 1].map(|motor| self.states[motor].current + self.leak[motor]);
            odrive.volts(gpio, channel, currents, self.voltage(), self.now)
        } else {
            self.mirrored(gpio, channel)
        };
        // Uniform noise of ±1.5 counts.
        let random = self.noise.get().wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        self.noise.set(random);
        volts / REFERENCE + (f64::from(random >> 8) / f64::from(1 << 23) - 1.0) * 1.5 / 4095.0
    }

    /// Returns the voltage at a converter's channel of `board-weact`.
    fn mirrored(&self, gpio: &Gpio, channel: u32) -> f64 {
        let Some(port_pin) = channel.checked_sub(10).map(|number| Pin(2, number)) else { return 0.0 };
        if gpio.mode(port_pin) != crate::gpio::Mode::Analog {
            return 0.0;
        }
        match channel {
            10..=12 => {
                let motor = channel as usize - 10;
                let State { current, driven, positive, .. } = self.states[motor];
                // The mirror shows the low sides' currents from drain to source: the whole current while the
                // motor is shorted, and only a current in the direction of the voltage while it is driven.
                let along = if positive { current } else { -current };
                let current = if driven { along.max(0.0) } else { current.abs() };
                let reads = self.awake.is_some() && !self.blind[motor];
                let seen = if reads { current + self.leak[motor] } else { 0.0 };
                seen * MIRROR * RESISTOR
            }
            13 => self.voltage() / DIVIDER,
            _ => 0.0,
        }
    }

    /// Simulates the motors up to `now`, with the chip's outputs as they were since the last call.
    pub fn advance(&mut self, timers: [&Tim1; 2], gpio: &Gpio, now: u64, clock: u64) {
        if now <= self.now {
            return;
        }
        if let Some(mut odrive) = self.odrive.take() {
            self.advance_odrive(&mut odrive, timers, gpio, now, clock);
            self.odrive = Some(odrive);
            return;
        }
        let timer = timers[0];
        // An external resistor holds the line low while nothing drives it.
        let awake = gpio.output(SLEEP).unwrap_or(false);
        match (awake, self.awake) {
            (true, None) => self.awake = Some(self.now + (WAKE * 1e12) as u64),
            (false, _) => self.awake = None,
            _ => {}
        }
        let pulsed = ENABLE.map(|(pin, channel)| gpio.signal(pin) == Some(("TIM1", channel)));
        while self.now < now {
            let end = timer.next_edge(self.now, clock).min(now).max(self.now + 1);
            let middle = self.now + (end - self.now) / 2;
            let works = self.awake.is_some_and(|since| since <= middle);
            let seconds = (end - self.now) as f64 * 1e-12;
            let voltage = self.voltage();
            for motor in 0..3 {
                // While nothing drives the input, the stage's own resistor keeps it low.
                let on = pulsed[motor] && timer.complementary(motor, middle, clock) == Level::High
                    || gpio.output(ENABLE[motor].0) == Some(true);
                let positive = gpio.output(PHASE[motor]).unwrap_or(false);
                let sign = if positive { 1.0 } else { -1.0 };
                let driven = works && on;
                let volts = if driven {
                    Some(sign * voltage)
                } else if works {
                    Some(0.0)
                } else {
                    None
                };
                self.step(motor, volts, volts.is_some(), seconds);
                (self.states[motor].driven, self.states[motor].positive) = (driven, positive);
                if driven {
                    self.last_driven = end;
                }
            }
            self.now = end;
        }
    }

    fn advance_odrive(&mut self, odrive: &mut Odrive, timers: [&Tim1; 2], gpio: &Gpio, now: u64, clock: u64) {
        while self.now < now {
            let edge = timers.into_iter().map(|timer| timer.next_edge(self.now, clock)).min();
            let end = edge.unwrap_or(u64::MAX).min(now).max(self.now + 1);
            let middle = self.now + (end - self.now) / 2;
            let seconds = (end - self.now) as f64 * 1e-12;
            let supply = self.voltage();
            for motor in 0..2 {
                let current = self.states[motor].current;
                let chip = (gpio, timers, clock);
                match odrive.terminals(motor, current, supply, chip, [self.now, middle, end]) {
                    Terminals::Driven(volts) => self.step(motor, Some(volts), true, seconds),
                    Terminals::Blocked(volts) => self.step(motor, Some(volts), false, seconds),
                    Terminals::Open => self.step(motor, None, false, seconds),
                }
                self.states[motor].driven = odrive.is_driven(motor);
                if self.states[motor].driven {
                    self.last_driven = end;
                }
            }
            self.now = end;
        }
    }

    /// Simulates a motor with a voltage, or with `None` while the stage sleeps. While diodes conduct, the
    /// current does not reverse.
    fn step(&mut self, motor: usize, volts: Option<f64>, may_reverse: bool, seconds: f64) {
        let supply = self.voltage();
        let Motor { resistance, inductance, constant, inertia, coulomb, viscous, load, blocked, counts } =
            self.motors[motor];
        let state = &mut self.states[motor];
        let before = state.current;
        let emf = constant * state.velocity;
        // A sleeping stage feeds the current back through its diodes until there is none.
        let applied = volts.unwrap_or_else(|| -before.signum() * (supply + DIODES));
        let remains = (-resistance * seconds / inductance).exp();
        state.current = remains * before + (1.0 - remains) / resistance * (applied - emf);
        if !may_reverse && (before == 0.0 || state.current * before < 0.0) {
            state.current = 0.0;
        }
        let torque = constant * 0.5 * (before + state.current);
        state.impulse += torque * seconds;
        let torque = torque + load;
        if blocked {
            state.velocity = 0.0;
        } else if state.velocity == 0.0 && torque.abs() <= coulomb {
            // Stiction holds the joint.
        } else {
            let direction = if state.velocity == 0.0 { torque.signum() } else { state.velocity.signum() };
            let next = state.velocity
                + seconds * (torque - direction * coulomb - viscous * state.velocity) / inertia;
            // Friction stops a joint; it does not reverse it.
            state.velocity = if next * state.velocity < 0.0 { 0.0 } else { next };
        }
        state.angle += seconds * state.velocity;
        if !self.unplugged[motor] {
            self.counts[motor] = (state.angle / std::f64::consts::TAU * counts).floor() as i64;
        }
    }
}
