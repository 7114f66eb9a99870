//! The peripherals at their addresses, with their clocks and interrupts, and the devices at the pins.
//!
//! Time is in picoseconds since power-on. A peripheral without clock ignores writes and reads as 0.

use std::collections::BTreeMap;

use crate::adc::Adc;
use crate::bench::Bench;
use crate::exti::{self, Exti};
use crate::gpio::Gpio;
use crate::iwdg::Iwdg;
use crate::mistake::Mistake;
use crate::nvic::Nvic;
use crate::pins::Pin;
use crate::rcc::Rcc;
use crate::spi::Spi;
use crate::supply::Supply;
use crate::tim1::Tim1;
use crate::timer::Timer;
use crate::usart::Usart;

/// Interrupts.
const IRQ_ADC: u32 = 18;
const IRQ_TIM1_UP: u32 = 25;
const IRQ_TIMERS: [u32; 4] = [28, 29, 30, 50];
const IRQ_USARTS: [u32; 3] = [37, 38, 52];
const IRQ_TIM11: u32 = 26;
const IRQ_TIM8_UP: u32 = 44;

/// The UARTs: name, bus, and the pins that the boards use.
const USARTS: [(&str, usize, Pin, Pin); 3] = [
    ("USART1", 2, Pin(0, 9), Pin(0, 10)),
    ("USART2", 1, Pin(0, 2), Pin(0, 3)),
    ("UART4", 1, Pin(0, 0), Pin(0, 1)),
];
/// The SPIs: name, and bus.
const SPIS: [(&str, usize); 2] = [("SPI1", 2), ("SPI3", 1)];
/// EXTICR1 of SYSCFG: selects the port of each EXTI line.
const EXTICR: u32 = 0x4001_3808;

pub struct Chip {
    pub nvic: Nvic,
    pub rcc: Rcc,
    /// The chip's own supply.
    pub supply: Supply,
    pub gpio: Gpio,
    /// USART1, USART2, UART4.
    pub usart: [Usart; 3],
    pub tim1: Tim1,
    pub tim8: Tim1,
    /// SPI1 and SPI3.
    spi: [Spi; 2],
    exti: Exti,
    /// TIM2 to TIM5.
    timers: [Timer; 4],
    tim11: Timer,
    adc: [Adc; 3],
    adc_prescaler: u32,
    pub iwdg: Iwdg,
    /// The devices at the pins.
    pub bench: Bench,
    /// Registers that only keep what is written, such as those of FLASH.
    kept: BTreeMap<u32, u32>,
    /// Accesses to unknown registers, by address.
    pub unknown: BTreeMap<u32, u64>,
    /// Changes that are applied to register writes.
    pub mistakes: Vec<Mistake>,
    /// Counts of the encoders that the timers have seen.
    turned: [i64; 3],
    pub now: u64,
}

/// Returns the enable register and bit of the peripheral at a base address; `None` if it always runs, or does
/// not exist.
fn clock(base: u32) -> Option<(usize, u32)> {
    Some(match base {
        0x4002_0000..=0x4002_2000 => (0x30, (base - 0x4002_0000) >> 10),
        0x4000_0000..=0x4000_0C00 => (0x40, base >> 10 & 3),
        0x4000_3C00 => (0x40, 15),
        0x4000_4400 => (0x40, 17),
        0x4000_4C00 => (0x40, 19),
        0x4000_7000 => (0x40, 28),
        0x4001_0000 => (0x44, 0),
        0x4001_0400 => (0x44, 1),
        0x4001_1000 => (0x44, 4),
        0x4001_3000 => (0x44, 12),
        0x4001_3800 => (0x44, 14),
        0x4001_4800 => (0x44, 18),
        _ => return None,
    })
}

impl Chip {
    pub fn new(bench: Bench) -> Self {
        Self {
            nvic: Nvic::new(),
            rcc: Rcc::new(Some(8_000_000)),
            supply: Supply::new(),
            gpio: Gpio::new(),
            usart: Default::default(),
            tim1: Tim1::new(),
            tim8: Tim1::new(),
            spi: Default::default(),
            exti: Exti::default(),
            timers: [u32::MAX, 0xFFFF, 0xFFFF, u32::MAX].map(Timer::new),
            tim11: Timer::new(0xFFFF),
            adc: Default::default(),
            adc_prescaler: 0,
            iwdg: Iwdg::new(),
            bench,
            kept: BTreeMap::new(),
            unknown: BTreeMap::new(),
            mistakes: Vec::new(),
            turned: [0; 3],
            now: 0,
        }
    }

    /// Resets the chip; `flag` is the cause in RCC_CSR. Time and the devices at the pins continue.
    pub fn reset(&mut self, flag: u32) {
        self.settle(self.now);
        self.rcc.reset(flag);
        self.supply.reset();
        self.gpio.reset();
        self.usart.iter_mut().for_each(Usart::reset);
        self.nvic = Nvic::new();
        self.tim1 = Tim1::new();
        self.tim8 = Tim1::new();
        self.spi = Default::default();
        self.exti = Exti::default();
        self.timers = [u32::MAX, 0xFFFF, 0xFFFF, u32::MAX].map(Timer::new);
        self.tim11 = Timer::new(0xFFFF);
        self.adc = Default::default();
        self.adc_prescaler = 0;
        self.iwdg = Iwdg::new();
        self.kept.clear();
    }

    /// Stops the crystal.
    pub fn stop_crystal(&mut self) {
        let now = self.now;
        self.settle(now);
        self.hold_timers(now);
        if self.rcc.stop_crystal() {
            self.nvic.pend_system(2);
        }
    }

    /// Returns the UART of the supervisor's line.
    pub fn supervisor(&mut self) -> &mut Usart {
        &mut self.usart[self.bench.supervisor()]
    }

    /// Returns a setting of the chip that the datasheet forbids, if any.
    pub fn violation(&self) -> Option<String> {
        let (hclk, wait_states) = (self.rcc.hclk(), self.kept.get(&0x4002_3C00).copied().unwrap_or(0) & 7);
        let converters = self.adc_clock();
        if hclk > self.supply.clock(wait_states.into()) {
            let volts = self.supply.volts;
            return Some(format!("{wait_states} wait states at {hclk} Hz and {volts:.2} V"));
        }
        if converters > 36_000_000 {
            return Some(format!("converters at {converters} Hz: 36 MHz at most"));
        }
        if let Some(violation) = self.bench.odrive.as_ref().and_then(|odrive| odrive.violation) {
            return Some(violation.to_owned());
        }
        (self.rcc.pclk(1) > 42_000_000 || self.rcc.pclk(2) > 84_000_000)
            .then(|| "a bus is too fast".to_owned())
    }

    /// Couples an edge of a power stage into the cables of all encoders, for `width` [ps].
    pub fn disturb_encoders(&mut self, width: u64) {
        self.settle(self.now);
        let clock = self.rcc.timers(1);
        self.timers.iter_mut().for_each(|timer| timer.disturb(width, clock));
    }

    fn hold_timers(&mut self, now: u64) {
        let clocks = [self.rcc.timers(1), self.rcc.timers(2)];
        self.timers.iter_mut().for_each(|timer| timer.hold(now, clocks[0]));
        self.tim11.hold(now, clocks[1]);
        self.tim1.hold(now, clocks[1]);
        self.tim8.hold(now, clocks[1]);
    }

    fn adc_clock(&self) -> u64 {
        self.rcc.pclk(2) / (2 * (u64::from(self.adc_prescaler) + 1))
    }

    /// Returns the next time at which something happens in the chip.
    pub fn next(&self) -> u64 {
        let timers = self.timers.iter().map(|timer| timer.next(self.rcc.timers(1)));
        let usarts = self.usart.iter().map(Usart::next);
        let fast = self.rcc.timers(2);
        let rest = [
            self.tim1.next(fast),
            self.tim8.next(fast),
            self.bench.next(),
            self.iwdg.end.unwrap_or(u64::MAX),
        ];
        let (adc, spi) = (self.adc.iter().map(Adc::next), self.spi.iter().map(Spi::next));
        timers.chain(usarts).chain(adc).chain(spi).chain(rest).min().unwrap_or(u64::MAX)
    }

    /// Simulates the devices at the pins up to `now`, with the outputs as they are.
    fn settle(&mut self, now: u64) {
        self.bench.advance([&self.tim1, &self.tim8], &self.gpio, now, self.rcc.timers(2));
        self.bench.observe(&self.gpio, now);
        for (index, &(first, second, timer, place)) in self.bench.encoders().iter().enumerate() {
            let counts = self.bench.counts(index);
            let edges = counts - std::mem::replace(&mut self.turned[index], counts);
            let mapped = || {
                self.gpio.signal(first) == Some((timer, "CH1"))
                    && self.gpio.signal(second) == Some((timer, "CH2"))
            };
            if edges != 0 && mapped() {
                self.timers[place].turn(edges);
            }
        }
        for (pin, level) in self.bench.inputs(now).into_iter().flatten() {
            self.gpio.drive(pin, level);
        }
        if self.exti.watched() != 0 {
            let levels = self.exti_levels() | u32::from(self.supply.is_low()) << 16;
            self.exti.set_levels(levels);
        }
        let trip =
            [Pin(0, 6), Pin(1, 12)].into_iter().find(|pin| self.gpio.signal(*pin) == Some(("TIM1", "BKIN")));
        let level = trip.map(|pin| self.gpio.input(pin));
        self.tim1.set_break_input(level);
    }

    /// Returns the levels of the watched EXTI lines.
    fn exti_levels(&self) -> u32 {
        let watched = self.exti.watched();
        let port = |line: u32| {
            let register = self.kept.get(&(EXTICR + line / 4 * 4)).copied().unwrap_or(0);
            (register >> (4 * (line % 4)) & 15) as usize
        };
        let lines = (0..16).filter(|line| watched >> line & 1 == 1);
        lines.fold(0, |levels, line| {
            let port = port(line);
            let is_high = port < 9 && self.gpio.input(Pin(port, line));
            levels | u32::from(is_high) << line
        })
    }

    /// Simulates everything up to `now`. Returns whether the watchdog resets the chip.
    pub fn advance(&mut self, now: u64) -> bool {
        self.now = now;
        self.settle(now);
        let (slow, fast) = (self.rcc.timers(1), self.rcc.timers(2));
        self.timers.iter_mut().for_each(|timer| timer.advance(now, slow));
        self.tim1.advance(now, fast);
        self.tim8.advance(now, fast);
        for (spi, (name, bus)) in self.spi.iter_mut().zip(SPIS) {
            while let Some(sent) = spi.advance(now, self.rcc.pclk(bus)) {
                let answer = self.bench.exchange(name, &sent, &self.gpio, now);
                spi.receive(answer);
            }
        }
        let (adc_clock, gpio, bench) = (self.adc_clock(), &self.gpio, &self.bench);
        let inputs = |channel: u32| bench.analogue(gpio, channel);
        for adc in &mut self.adc {
            adc.advance(now, adc_clock, &inputs);
        }
        let triggers = self.tim1.take_triggers();
        if triggers.iter().any(|&(rises, falls)| rises || falls) {
            for adc in &mut self.adc {
                adc.trigger(triggers, now, adc_clock, &inputs);
            }
        }
        for (usart, (name, bus, transmit, receive)) in self.usart.iter_mut().zip(USARTS) {
            usart.pins = (
                self.gpio.signal(transmit) == Some((name, "TX")),
                self.gpio.signal(receive) == Some((name, "RX")),
            );
            usart.advance(now, self.rcc.pclk(bus));
        }
        self.lines();
        self.iwdg.end.is_some_and(|end| end <= now)
    }

    /// Pends level-sensitive interrupts, while their line is high and they are not being served.
    fn lines(&mut self) {
        let timers = IRQ_TIMERS.into_iter().zip(self.timers.iter().map(Timer::line));
        let usarts = IRQ_USARTS.into_iter().zip(self.usart.iter().map(Usart::line));
        let adc = self.adc.iter().any(Adc::line);
        let rest = [
            (IRQ_ADC, adc),
            (IRQ_TIM1_UP, self.tim1.line()),
            (IRQ_TIM8_UP, self.tim8.line()),
            (IRQ_TIM11, self.tim11.line()),
        ];
        let edges = exti::INTERRUPTS.into_iter().map(|(number, lines)| (number, self.exti.line(lines)));
        for (number, high) in timers.chain(usarts).chain(rest).chain(edges) {
            if high && !self.nvic.is_active(number) {
                self.nvic.pend(number);
            }
        }
        if self.rcc.nmi() && !self.nvic.is_system_active(2) {
            self.nvic.pend_system(2);
        }
    }

    pub fn read(&mut self, address: u32, now: u64) -> u32 {
        self.now = now;
        let (base, offset) = (address & !0x3FF, address & 0x3FF);
        if clock(base).is_some_and(|(register, bit)| !self.rcc.enables(register, bit)) {
            return 0;
        }
        let (slow, fast) = (self.rcc.timers(1), self.rcc.timers(2));
        let crystal = (self.rcc.crystal, self.rcc.rtc_divider());
        let value = match base {
            0x4000_0000..=0x4000_0C00 => {
                self.settle(now);
                self.timers[base as usize >> 10 & 3].read(offset, now, slow, (None, 0))
            }
            0x4001_0000 => self.tim1.read(offset, now, fast),
            0x4001_0400 => self.tim8.read(offset, now, fast),
            0x4001_3C00 => self.exti.read(offset),
            0x4001_3000 => self.spi[0].read(offset),
            0x4000_3C00 => self.spi[1].read(offset),
            0x4001_4800 => self.tim11.read(offset, now, fast, crystal),
            0x4001_2000 if offset < 0x300 => {
                let index = offset as usize >> 8;
                if self.rcc.enables(0x44, 8 + index as u32) {
                    self.adc[index].read(offset & 0xFF)
                } else {
                    Some(0)
                }
            }
            0x4001_2000 if offset == 0x304 => Some(self.adc_prescaler << 16),
            0x4000_3000 => self.iwdg.read(offset),
            0x4000_4400 => self.usart[1].read(offset),
            0x4000_4C00 => self.usart[2].read(offset),
            0x4001_1000 => self.usart[0].read(offset),
            0x4002_0000..=0x4002_2000 => {
                self.settle(now);
                self.gpio.read((base as usize - 0x4002_0000) >> 10, offset)
            }
            0x4002_3800 => self.rcc.read(offset),
            0x4002_3C00 if offset == 0x14 => Some(self.supply.options()),
            0x4000_7000 => self.supply.read(offset),
            0x4002_3C00 | 0x4001_3800 => Some(self.kept.get(&address).copied().unwrap_or(0)),
            0xE000_E000..=0xE000_EC00 => self.nvic.read(address & 0xFFF),
            _ => None,
        };
        value.unwrap_or_else(|| {
            *self.unknown.entry(address).or_default() += 1;
            self.kept.get(&address).copied().unwrap_or(0)
        })
    }

    /// Returns a register as a narrow write sees it, without the side effects of reading it.
    pub fn peek(&mut self, address: u32, now: u64) -> u32 {
        const DATA: [u32; 5] = [0x4001_1004, 0x4000_4404, 0x4000_4C04, 0x4001_300C, 0x4000_3C0C];
        if DATA.contains(&address) { 0 } else { self.read(address, now) }
    }

    pub fn write(&mut self, address: u32, size: u32, value: u32, now: u64) {
        self.now = now;
        let value = self.mistakes.iter().fold(value, |value, mistake| mistake.apply(address, value));
        let (base, offset) = (address & !0x3FF, address & 0x3FF);
        if clock(base).is_some_and(|(register, bit)| !self.rcc.enables(register, bit)) {
            return;
        }
        let (slow, fast) = (self.rcc.timers(1), self.rcc.timers(2));
        let done = match base {
            0x4000_0000..=0x4000_0C00 => {
                self.settle(now);
                self.timers[base as usize >> 10 & 3].write(offset, value, now, slow)
            }
            0x4001_0000 => {
                self.settle(now);
                self.tim1.write(offset, value, now, fast)
            }
            0x4001_0400 => {
                self.settle(now);
                self.tim8.write(offset, value, now, fast)
            }
            0x4001_3C00 => {
                self.settle(now);
                let done = self.exti.write(offset, value);
                // A line that is newly watched has no edge.
                let levels = self.exti_levels() | u32::from(self.supply.is_low()) << 16;
                self.exti.begin(levels);
                done
            }
            0x4001_3000 => self.spi[0].write(offset, value, now, self.rcc.pclk(2)),
            0x4000_3C00 => self.spi[1].write(offset, value, now, self.rcc.pclk(1)),
            0x4001_4800 => self.tim11.write(offset, value, now, fast),
            0x4001_2000 if offset < 0x300 => {
                let index = offset as usize >> 8;
                if self.rcc.enables(0x44, 8 + index as u32) {
                    let (clock, gpio, bench) = (self.adc_clock(), &self.gpio, &self.bench);
                    self.adc[index]
                        .write(offset & 0xFF, value, now, clock, &|channel| bench.analogue(gpio, channel))
                } else {
                    Some(())
                }
            }
            0x4001_2000 if offset == 0x304 => {
                self.adc_prescaler = value >> 16 & 3;
                Some(())
            }
            0x4000_3000 => self.iwdg.write(offset, value, now),
            0x4000_4400 => self.usart[1].write(offset, value, now, self.rcc.pclk(1)),
            0x4000_4C00 => self.usart[2].write(offset, value, now, self.rcc.pclk(1)),
            0x4001_1000 => self.usart[0].write(offset, value, now, self.rcc.pclk(2)),
            0x4002_0000..=0x4002_2000 => {
                self.settle(now);
                let done = self.gpio.write((base as usize - 0x4002_0000) >> 10, offset, value);
                self.settle(now);
                done
            }
            0x4002_3800 => {
                self.hold_timers(now);
                self.rcc.write(offset, value)
            }
            0x4000_7000 => self.supply.write(offset, value),
            0x4002_3C00 | 0x4001_3800 => {
                self.kept.insert(address, value);
                Some(())
            }
            0xE000_E000..=0xE000_EC00 => self.nvic.write(address & 0xFFF, size, value),
            _ => None,
        };
        if done.is_none() {
            *self.unknown.entry(address).or_default() += 1;
            self.kept.insert(address, value);
        }
        self.lines();
    }
}
