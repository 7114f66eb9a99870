//! A board for tests in QEMU, which has no sensors and no drives: one joint is simulated, a bare rotor.
//!
//! It exercises what the plant link does not: the timer's interrupt, the latch, periods without sensors, and
//! the ways in which the outputs are switched off. The name of the robot's model selects what goes wrong half
//! a second after the joint was enabled:
//!
//! | model | what happens |
//! |---|---|
//! | `silent` | the sensors can no longer be read |
//! | `overflow` | the stack overflows |
//! | `crystal` | the interrupt for a stopped crystal is raised |
//! | `panic` | a panic |
//! | `instants` | nothing; the encoder shows by how much sampling intervals have varied [cycles of 168 MHz] |
//!
//! The power stage's line is PC5: low is off. QEMU logs what is written there.

use cortex_m::peripheral::{SCB, SYST, syst::SystClkSource};
use stm32f4xx_hal::gpio::Pull;
use stm32f4xx_hal::pac;
use stm32f4xx_hal::prelude::*;
use tesaki::TICK;
use tesaki::model::{ModelError, RobotModel};
use tesaki::protocol::{ActuatorFrame, SensorFlags, SensorFrame};

use crate::board::{Board, Equipment, Latch, NoCurrents, Peripherals, SupervisorLine};

/// Enabled periods after which something goes wrong.
const HEALTHY_PERIODS: u32 = 50;

/// The board's equipment.
const EQUIPMENT: Equipment = Equipment {
    motors: 1,
    absolute_encoders: true,
    count_rate: f32::INFINITY,
    force_sensors: 0,
    current: 10.0,
    supply: 60.0,
};

/// The defect that the model's name selects.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Defect {
    None,
    Silent,
    Overflow,
    Crystal,
    Panic,
    Instants,
}

/// See the module.
pub struct Emulated {
    defect: Defect,
    enabled: u32,
    /// Counts per radian, and inertia [kg·m²].
    counts: f32,
    inertia: f32,
    angle: f32,
    velocity: f32,
    torque: f32,
}

impl Board for Emulated {
    const CRYSTAL: u32 = 8_000_000;
    const HAS_POWER_STAGES: bool = true;
    const SUPERVISOR: SupervisorLine = SupervisorLine::Usart1;

    type Latch = Instants;
    type CurrentControl = NoCurrents;

    fn start(peripherals: Peripherals<'_>) -> (Self, Instants, NoCurrents) {
        let gpio_a = peripherals.gpioa.split(peripherals.rcc);
        gpio_a.pa9.into_alternate::<7>();
        gpio_a.pa10.into_alternate::<7>().internal_resistor(Pull::Up);
        let mut clock = peripherals.syst;
        clock.set_clock_source(SystClkSource::Core);
        clock.set_reload(0xFF_FFFF);
        clock.clear_current();
        clock.enable_counter();
        let (angle, velocity, torque) = (0.0, 0.0, 0.0);
        let board =
            Self { defect: Defect::None, enabled: 0, counts: 0.0, inertia: 1.0, angle, velocity, torque };
        (board, Instants { last: None, shortest: u32::MAX, longest: 0 }, NoCurrents)
    }

    /// Returns `true`: a board with power stages must ignore the strap.
    fn is_strapped(&mut self) -> bool {
        true
    }

    fn configure(&mut self, model: &RobotModel) -> Result<(), ModelError> {
        EQUIPMENT.check(model)?;
        if let Some(joint) = model.joints.first() {
            self.counts = joint.encoder.counts_per_turn / core::f32::consts::TAU;
            self.inertia = joint.motor.rotor_inertia;
        }
        self.defect = match model.name.as_str() {
            "silent" => Defect::Silent,
            "overflow" => Defect::Overflow,
            "crystal" => Defect::Crystal,
            "panic" => Defect::Panic,
            "instants" => Defect::Instants,
            _ => Defect::None,
        };
        Ok(())
    }

    fn read(&mut self, period: u32, variation: &u32) -> Option<SensorFrame> {
        if self.enabled > HEALTHY_PERIODS {
            match self.defect {
                Defect::Silent => return None,
                Defect::Overflow => overflow(period),
                // The chip's only source of this interrupt is the crystal's supervision.
                Defect::Crystal => set_pending(1 << 31),
                Defect::Panic => panic!("as the model asked"),
                Defect::None | Defect::Instants => {}
            }
        }
        self.velocity += self.torque / self.inertia * TICK;
        self.angle += self.velocity * TICK;
        // The count always changes: standing still under torque would be a fault.
        let noise = (period % 2) as i32;
        let count = (self.angle * self.counts) as i32 + noise;
        let count = if self.defect == Defect::Instants { *variation as i32 } else { count };
        Some(SensorFrame {
            sequence: period,
            flags: SensorFlags(0),
            supply: 24_000,
            encoders: [count].into_iter().collect(),
            currents: [0].into_iter().collect(),
            forces: heapless::Vec::new(),
        })
    }

    fn write(&mut self, actuators: &ActuatorFrame) {
        self.torque = actuators.torques.first().copied().unwrap_or(0.0);
        if actuators.enabled {
            self.enabled += 1;
            // SAFETY: a single store that sets PC5.
            unsafe { (*pac::GPIOC::ptr()).bsrr().write(|w| w.bits(1 << 5)) };
        } else {
            Self::off();
        }
    }

    fn off() {
        // SAFETY: a single store that resets PC5.
        unsafe { (*pac::GPIOC::ptr()).bsrr().write(|w| w.bits(1 << 21)) };
    }
}

/// Sets a bit of ICSR.
fn set_pending(bit: u32) {
    // SAFETY: a single store; zeros have no effect in this register.
    unsafe { (*SCB::PTR).icsr.write(bit) };
}

/// Recurses until the stack overflows.
#[inline(never)]
#[expect(unconditional_recursion, reason = "that is what it is for")]
fn overflow(depth: u32) {
    let room = core::hint::black_box([depth; 32]);
    overflow(room[3].wrapping_add(1));
    core::hint::black_box(room);
}

/// Measures the variation of the intervals between its calls.
pub struct Instants {
    last: Option<u32>,
    shortest: u32,
    longest: u32,
}

impl Latch for Instants {
    type Sample = u32;

    fn latch(&mut self) -> u32 {
        let now = SYST::get_current();
        if let Some(last) = self.last.replace(now) {
            let interval = last.wrapping_sub(now) & 0xFF_FFFF;
            self.shortest = self.shortest.min(interval);
            self.longest = self.longest.max(interval);
        }
        self.longest.saturating_sub(self.shortest)
    }
}
