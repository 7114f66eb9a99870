//! WeAct STM32F405 core board with three carriers of the power stage DRV8874: three brushed motors with a
//! quadrature encoder each.
//!
//! | pin | use |
//! |---|---|
//! | PB13, PB14, PB15 | TIM1 CH1N to CH3N: `EN/IN1` of the power stages |
//! | PB0, PB1, PB10 | `PH/IN2` of the power stages: high for a positive torque |
//! | PC5 | `nSLEEP` of all power stages; a resistor to ground keeps them asleep until the boot |
//! | PA6 | TIM1 BKIN: low stops the pulses by hardware. `nFAULT` of all power stages, the emergency stop |
//! | PC8 | the emergency stop alone: low when pressed, or when its wire is broken |
//! | PC6, PC7 | TIM3: encoder 1 |
//! | PB6, PB7 | TIM4: encoder 2 |
//! | PA0, PA1 | TIM5: encoder 3 |
//! | PC0, PC1, PC2 | ADC1 to ADC3: currents, `CS` of the power stages (2.49 kΩ to ground) |
//! | PC3 | ADC1: supply, through 100 kΩ and 10 kΩ |
//! | PB3, PB4, PB5 | SPI1 SCK, MISO, MOSI of the force sensor's converter ADS131M06 |
//! | PA15, PC4 | its `CS` and `DRDY`, which is EXTI4 |
//! | PA9, PA10 | USART1 TX, RX: supervisor |
//!
//! The six gauges are full bridges, gauge 1 on channel 0 of the converter and so on; a fraction of their
//! supply is its reference (`REFIN`), and its clock is 8.192 MHz. Nothing measures the gauges' temperature.
//! Without a force sensor in the model its pins are unused and stay open.
//!
//! The wiring of carriers and emergency stop is in `firmware/README.md`. There is no plant link.

use cortex_m::peripheral::NVIC;
use heapless::spsc::{Consumer, Producer, Queue};
use static_cell::ConstStaticCell;
use stm32f4xx_hal::gpio::{Input, Output as PinOutput, PB0, PB1, PB10, PC8, Pull, Speed};
use stm32f4xx_hal::hal_02::Qei as _;
use stm32f4xx_hal::pac::{self, TIM3, TIM4, TIM5};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::qei::Qei;
use stm32f4xx_hal::rcc::Enable;
use tesaki::TICK;
use tesaki::control::Switching;
use tesaki::model::{ModelError, RobotModel};
use tesaki::protocol::{ActuatorFrame, SensorFlags, SensorFrame};
use tesaki_drivers::counter::Counter;
use tesaki_drivers::drv8874::{self, CurrentSense};
use tesaki_drivers::exchange::{LoopReport, Order, order_words, report_words};
use tesaki_drivers::gauges::ForceGauges;
use tesaki_drivers::handover::Handover;
use tesaki_drivers::joints::{MotorJoints, motors_for};
use tesaki_drivers::motors::{Motors, Output, PowerStages, Sensing};

use crate::board::{Board, CurrentControl, Equipment, Latch, Peripherals, Phase, SupervisorLine};
use crate::chip_supply;
use crate::drivers::COUNT_RATE;
use crate::drivers::current_adc::{CurrentAdc, FULL_SCALE};
use crate::drivers::pulses::Pulses;
use crate::drivers::spi::{Device, Spi1OnA};

/// Number of motors.
const N: usize = 3;
/// Frequency of TIM1 [Hz].
const TIMER: f32 = 168e6;
/// Counts of half a pulse period: 40 kHz. At 20 kHz a small coreless motor, with a time constant of 20 µs,
/// would lose most of its current between the pulse and the sample.
const RESOLUTION: u16 = 2100;
/// Pulses in a period of the current loops, which run at 20 kHz.
const PULSES: u16 = 2;
/// A duty takes effect in the middle of the pulse after the sample. Duties end 3.75 µs before the sample:
/// `CS` shows the magnitude of the current while the motor is shorted. A current that brakes flows through a
/// low side that begins to conduct with the end of the pulse, so `CS` shows it only after the delay of the
/// input, the dead time and the delay of the measurement, some 2.5 µs together; before, it shows 0. (SLVSF66
/// gives typical values only: measure it on the first board.)
const SWITCHING: Switching = Switching {
    period: 2.0 * PULSES as f32 * RESOLUTION as f32 / TIMER,
    lag: 0.5 / PULSES as f32,
    pulses: PULSES,
    resolution: RESOLUTION,
    max_duty: 0.7,
};
/// Reference of the converters [V].
const REFERENCE: f32 = 3.3;
const CURRENT_SENSE: CurrentSense =
    CurrentSense { resistor: 2490.0, reference: REFERENCE, counts: FULL_SCALE };
/// Supply voltage per count [V]: the divider is 11.
const SUPPLY_RESOLUTION: f32 = REFERENCE * 11.0 / FULL_SCALE as f32;
/// A current of this many times its limit is a fault of the power stage.
const TRIP: f32 = 1.15;
/// Periods of the current loop in a control period.
const PERIODS: u32 = (TICK / SWITCHING.period + 0.5) as u32;

/// The board's equipment.
const EQUIPMENT: Equipment = Equipment {
    motors: N as u8,
    absolute_encoders: false,
    count_rate: COUNT_RATE,
    force_sensors: 1,
    current: 2.5,
    supply: 36.0,
};
const _: () = assert!(EQUIPMENT.supply <= drv8874::SUPPLY_MAX);
// The current sense shows every trip.
const _: () = assert!(TRIP * EQUIPMENT.current < CURRENT_SENSE.range());

/// EXTI line on which the force sensor's converter signals new values.
const DATA_LINE: u32 = 1 << 4;

/// From the control task to the current loops.
static ORDER: Handover<{ order_words(N) }> = Handover::new();
/// From the current loops to the control task.
static REPORT: Handover<{ report_words(N) }> = Handover::new();
/// New motors, from the control task to the current loops.
static NEW_MOTORS: ConstStaticCell<Queue<Motors<N>, 2>> = ConstStaticCell::new(Queue::new());

/// See the module.
pub struct Weact {
    emergency_stop: PC8<Input>,
    to_loops: Producer<'static, Motors<N>>,
    joints: MotorJoints<N>,
    gauges: ForceGauges<Device<Spi1OnA>>,
}

impl Board for Weact {
    const CRYSTAL: u32 = 8_000_000;
    const HAS_POWER_STAGES: bool = true;
    const SUPERVISOR: SupervisorLine = SupervisorLine::Usart1;

    type Latch = Encoders;
    type CurrentControl = CurrentLoops;

    fn start(peripherals: Peripherals<'_>) -> (Self, Encoders, CurrentLoops) {
        let rcc = peripherals.rcc;
        let a = peripherals.gpioa.split(rcc);
        let b = peripherals.gpiob.split(rcc);
        let c = peripherals.gpioc.split(rcc);
        // First of all: the power stages are asleep.
        c.pc5.into_push_pull_output();
        a.pa9.into_alternate::<7>();
        a.pa10.into_alternate::<7>().internal_resistor(Pull::Up);
        a.pa6.into_alternate::<1>().internal_resistor(Pull::Down);
        let emergency_stop = c.pc8.into_pull_down_input();
        let directions =
            (b.pb0.into_push_pull_output(), b.pb1.into_push_pull_output(), b.pb10.into_push_pull_output());

        let up = Pull::Up;
        let encoder_1 = (
            c.pc6.into_alternate::<2>().internal_resistor(up),
            c.pc7.into_alternate::<2>().internal_resistor(up),
        );
        let encoder_2 = (
            b.pb6.into_alternate::<2>().internal_resistor(up),
            b.pb7.into_alternate::<2>().internal_resistor(up),
        );
        let encoder_3 = (
            a.pa0.into_alternate::<2>().internal_resistor(up),
            a.pa1.into_alternate::<2>().internal_resistor(up),
        );
        let encoders = Encoders(
            (Qei::new(peripherals.tim3, encoder_1, rcc), Counter::new()),
            (Qei::new(peripherals.tim4, encoder_2, rcc), Counter::new()),
            Qei::new(peripherals.tim5, encoder_3, rcc),
        );
        crate::filter_encoders!(TIM3, TIM4, TIM5);

        c.pc0.into_analog();
        c.pc1.into_analog();
        c.pc2.into_analog();
        c.pc3.into_analog();
        let converters = (peripherals.adc1, peripherals.adc2, peripherals.adc3, peripherals.adc_common);
        let adc = CurrentAdc::start(converters, rcc, [&[10, 13], &[11], &[12]]);
        let pulses = Pulses::start(peripherals.tim1, rcc, RESOLUTION);
        // The outputs already idle low when they are connected to their pins.
        b.pb13.into_alternate::<1>();
        b.pb14.into_alternate::<1>();
        b.pb15.into_alternate::<1>();

        a.pa15.into_push_pull_output_in_state(true.into());
        // With a slower edge of the clock, SPI1 at 84 MHz may keep the last bit of the byte before: an
        // erratum.
        b.pb3.into_alternate::<5>().speed(Speed::VeryHigh);
        b.pb4.into_alternate::<5>().internal_resistor(Pull::Down);
        b.pb5.into_alternate::<5>().speed(Speed::High);
        c.pc4.into_pull_up_input();
        let [converter] = Device::start(peripherals.spi1, rcc, [15]);
        pac::SYSCFG::enable(rcc);
        connect_data_line(&peripherals.syscfg, &peripherals.exti);

        let (to_loops, new_motors) = NEW_MOTORS.take().split();
        let stages = Stages { pulses, directions };
        let motors = Motors::none(&SWITCHING, drv8874::WAKE);
        let joints = MotorJoints::new(PERIODS);
        let gauges = ForceGauges::new(converter);
        let board = Self { emergency_stop, to_loops, joints, gauges };
        let loops = CurrentLoops { adc, samples: 0, stages, motors, new_motors, order: 0 };
        (board, encoders, loops)
    }

    // Not inlined: its memory on the stack is free when the robot is configured.
    #[inline(never)]
    fn configure(&mut self, model: &RobotModel) -> Result<(), ModelError> {
        EQUIPMENT.check(model)?;
        let motors = motors_for(model, Sensing::Magnitude, TRIP, &SWITCHING, drv8874::WAKE)?;
        let gauges = model.gauges.as_ref().and_then(|gauges| {
            let chain = model.chains.get(usize::from(gauges.chain))?;
            Some((chain.force_sensor.as_ref()?, gauges))
        });
        self.gauges.configure(gauges);
        self.joints.configure(model);
        // The queue is full only if the current loop does not run, which `read` reports. Then nothing moves.
        let _ = self.to_loops.enqueue(motors);
        Ok(())
    }

    fn read(&mut self, period: u32, sample: &Sample) -> Option<SensorFrame> {
        let force = self.gauges.update();
        watch_data_line(force.is_some());
        let (_, words) = sample.measured?;
        let measured = LoopReport::<N>::from_words(&words);
        let mut frame = self.joints.update(period, sample.counts, &measured)?;
        let stopped = self.emergency_stop.is_low();
        frame.flags.0 |= if stopped { SensorFlags::EMERGENCY_STOP } else { 0 };
        frame.flags.0 |= if measured.has_tripped || trip_is_active() { SensorFlags::POWER_STAGE } else { 0 };
        if let Some(fault) = force.and_then(|reading| reading.fault) {
            frame.flags = frame.flags.with_force_sensor(fault);
        }
        if let Some(reading) = force {
            // Cannot fail: the vector is empty.
            let _ = frame.forces.push(reading.wrench);
        }
        Some(frame)
    }

    fn write(&mut self, actuators: &ActuatorFrame) {
        let order = if actuators.enabled {
            Order::Drive(self.joints.command(&actuators.torques))
        } else {
            Self::off();
            Order::Off
        };
        ORDER.write(order.words());
    }

    fn off() {
        sleep();
        Pulses::off();
    }

    fn on_edge() {
        // SAFETY: ones clear bits in this register; the others stay.
        unsafe { (*pac::EXTI::ptr()).pr().write(|w| w.bits(DATA_LINE)) };
        // A line that oscillates must not keep the current loops waiting.
        watch_data_line(false);
        NVIC::pend(pac::Interrupt::EXTI3);
    }

    fn on_data(&mut self) {
        watch_data_line(self.gauges.on_ready());
    }
}

/// Connects EXTI4 to the falling edge of PC4, which is not watched yet.
fn connect_data_line(syscfg: &pac::SYSCFG, exti: &pac::EXTI) {
    // SAFETY: the port of the line, C is 2 (RM0090, 9.2); the bit of a line that the chip has.
    unsafe {
        syscfg.exticr2().modify(|_, w| w.exti4().bits(2));
        exti.ftsr().modify(|r, w| w.bits(r.bits() | DATA_LINE));
    }
}

/// Sets whether edges of the converter's line raise an interrupt.
fn watch_data_line(is_watched: bool) {
    let data = if is_watched { DATA_LINE } else { 0 };
    // SAFETY: the only other bit in the mask, that of the detector of the chip's supply, does not change
    // after boot. If `on_edge` interrupts this, then what is written here holds: it does not depend on the
    // bit that `on_edge` has changed. The chip has these lines.
    unsafe { (*pac::EXTI::ptr()).imr().modify(|r, w| w.bits(r.bits() & chip_supply::LINE | data)) };
}

/// Returns whether the trip line is active. The pin belongs to the timer, but its level can be read.
fn trip_is_active() -> bool {
    // SAFETY: reading this register has no effect.
    unsafe { (*pac::GPIOA::ptr()).idr().read().bits() & 1 << 6 == 0 }
}

/// Pulls `nSLEEP` low.
fn sleep() {
    // SAFETY: a single store that resets PC5.
    unsafe { (*pac::GPIOC::ptr()).bsrr().write(|w| w.bits(1 << 21)) };
}

/// A latched sample: the encoders, and the last measurement of the current loops.
#[derive(Clone, Copy)]
pub struct Sample {
    counts: [i32; N],
    measured: Option<(u32, [u32; report_words(N)])>,
}

/// The encoders' counters. Those of 16 bits are extended here, and not when a sample is read, so that no late
/// control task loses a round of theirs.
pub struct Encoders((Qei<TIM3>, Counter), (Qei<TIM4>, Counter), Qei<TIM5>);

impl Latch for Encoders {
    type Sample = Sample;

    fn latch(&mut self) -> Sample {
        let Self((first, of_first), (second, of_second), third) = self;
        let counts =
            [of_first.extend(first.count()), of_second.extend(second.count()), third.count().cast_signed()];
        Sample { counts, measured: REPORT.read(0) }
    }
}

/// The power stages.
struct Stages {
    pulses: Pulses,
    directions: (PB0<PinOutput>, PB1<PinOutput>, PB10<PinOutput>),
}

impl PowerStages<N> for Stages {
    fn off(&mut self) {
        Weact::off();
    }

    fn wake(&mut self) {
        // SAFETY: a single store that sets PC5.
        unsafe { (*pac::GPIOC::ptr()).bsrr().write(|w| w.bits(1 << 5)) };
    }

    fn enable_pulses(&mut self) {
        self.pulses.enable();
    }

    fn has_tripped(&self) -> bool {
        self.pulses.has_tripped()
    }

    fn set(&mut self, outputs: &[Output; N]) {
        let (first, second, third) = &mut self.directions;
        first.set_state(outputs[0].positive.into());
        second.set_state(outputs[1].positive.into());
        third.set_state(outputs[2].positive.into());
        self.pulses.set(outputs.map(|output| output.counts));
    }
}

/// The current loops, a sample at a time.
pub struct CurrentLoops {
    adc: CurrentAdc,
    /// Samples since the last period.
    samples: u16,
    stages: Stages,
    motors: Motors<N>,
    new_motors: Consumer<'static, Motors<N>>,
    /// Number of the last order.
    order: u32,
}

impl CurrentControl for CurrentLoops {
    fn phase(&self) -> Option<Phase> {
        Some(self.stages.pulses.phase(RESOLUTION))
    }

    fn on_sample(&mut self) {
        let [[first, supply], [second, _], [third, _]] = self.adc.sample();
        self.samples += 1;
        if self.samples < PULSES {
            return;
        }
        self.samples = 0;
        self.motors.take_over(&mut self.new_motors, &mut self.stages);
        if let Some((number, words)) = ORDER.read(self.order) {
            self.order = number;
            self.motors.command(Order::from_words(&words).command(), &mut self.stages);
        }
        let magnitudes = [first, second, third].map(|counts| f32::from(counts) * CURRENT_SENSE.resolution());
        self.motors.update(&magnitudes, f32::from(supply) * SUPPLY_RESOLUTION, &mut self.stages);
        REPORT.write(self.motors.report(true).words());
    }
}
