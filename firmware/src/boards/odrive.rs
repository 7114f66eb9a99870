//! ODrive v3.6 for 56 V: two brushed motors, each with a quadrature encoder, between the half bridges B and C
//! of its two stages.
//!
//! | pin | use |
//! |---|---|
//! | PA9, PA10 | TIM1 CH2, CH3: high sides of M0 B and C |
//! | PB14, PB15 | TIM1 CH2N, CH3N: low sides of M0 B and C |
//! | PC7, PC8 | TIM8 CH2, CH3: high sides of M1 B and C |
//! | PB0, PB1 | TIM8 CH2N, CH3N: low sides of M1 B and C |
//! | PA8, PB13, PC6, PA7 | gates of M0 A and M1 A: low, off |
//! | PB10, PB11 | gates of the brake resistor: low, off |
//! | PB12 | `EN_GATE` of both gate drivers DRV8301: low is off |
//! | PD2 | `nFAULT` of both gate drivers: EXTI2 |
//! | PC4 | GPIO5: emergency stop, EXTI4: low when pressed, or when its wire is broken |
//! | PC10, PC11, PC12 | SPI3 SCK, MISO, MOSI of the gate drivers |
//! | PC13, PC14 | their select lines, M0 and M1 |
//! | PB4, PB5 | TIM3: encoder M0 |
//! | PB6, PB7 | TIM4: encoder M1 |
//! | PC0, PC1 | currents of M0 B and C |
//! | PC3, PC2 | currents of M1 B and C |
//! | PA6 | supply, divided by 19 |
//! | PA0, PA1 | GPIO1, GPIO2: UART4 TX, RX: supervisor |
//!
//! The pins are those in the public header of the board (odriverobotics/ODrive,
//! `Firmware/Board/v3/Inc/main.h`). A motor is connected to the terminals B (positive) and C; A stays open.
//! The emergency stop is a contact from 3.3 V to GPIO5. There is no plant link.
//!
//! **No trip without the CPU.** No line of this board reaches a break input. Without the CPU, a gate driver
//! switches off only a half bridge that has an overcurrent. For everything else, including the emergency
//! stop, an interrupt of the highest priority pulls `EN_GATE` low.

use heapless::spsc::{Consumer, Producer, Queue};
use static_cell::ConstStaticCell;
use stm32f4xx_hal::gpio::{Input, Output as PinOutput, PB12, PC4, PD2, Pull, Speed};
use stm32f4xx_hal::hal_02::Qei as _;
use stm32f4xx_hal::pac::{self, TIM3, TIM4};
use stm32f4xx_hal::prelude::*;
use stm32f4xx_hal::qei::Qei;
use stm32f4xx_hal::rcc::Enable;
use tesaki::TICK;
use tesaki::control::Switching;
use tesaki::math;
use tesaki::model::{ModelError, RobotModel};
use tesaki::protocol::{ActuatorFrame, SensorFlags, SensorFrame};
use tesaki_drivers::counter::Counter;
use tesaki_drivers::drv8301::{Drv8301, Gain, GateCurrent, Settings, ShuntSense};
use tesaki_drivers::exchange::{LoopReport, Order, order_words, report_words};
use tesaki_drivers::gates::Gates;
use tesaki_drivers::handover::Handover;
use tesaki_drivers::joints::{MotorJoints, motors_for};
use tesaki_drivers::motors::{Motors, Output, PowerStages, Sensing};
use tesaki_drivers::offset::Offset;

use crate::board::{Board, CurrentControl, Equipment, Latch, Peripherals, Phase, SupervisorLine};
use crate::drivers::COUNT_RATE;
use crate::drivers::current_adc::{CurrentAdc, FULL_SCALE};
use crate::drivers::half_bridges::HalfBridges;
use crate::drivers::spi::{Device, Spi3OnC};

/// Number of motors.
const N: usize = 2;
/// Frequency of TIM1 and TIM8 [Hz].
const TIMER: f32 = 168e6;
/// Counts of half a pulse period: 20 kHz.
const RESOLUTION: u16 = 4200;
/// A duty takes effect in the middle of the pulse after the sample. Duties end 3.7 µs before the sample: the
/// amplifiers settle while all low sides are on.
const SWITCHING: Switching = Switching {
    period: 2.0 * RESOLUTION as f32 / TIMER,
    lag: 0.5,
    pulses: 1,
    resolution: RESOLUTION,
    max_duty: 0.85,
};
/// Reference of the converters and of the amplifiers [V].
const REFERENCE: f32 = 3.3;
/// A voltage of 0.25 V across a conducting transistor is an overcurrent: some 50 to 100 A, depending on
/// temperature.
const GATE_DRIVERS: Settings =
    Settings { gate_current: GateCurrent::High, overcurrent: 12, gain: Gain::Eighty };
const SENSE: ShuntSense =
    ShuntSense { shunt: 0.5e-3, gain: GATE_DRIVERS.gain, reference: REFERENCE, counts: FULL_SCALE };
/// Without current the amplifiers give half the reference, within this tolerance [counts]: 4 mV at their
/// inputs.
const OFFSET: Offset = Offset::new(FULL_SCALE / 2 + 1, 400);
/// A motor's current enters at one terminal and leaves at the other. A larger sum of both currents [counts],
/// 2 A, is a short circuit or a broken amplifier.
const MAX_SUM: f32 = 100.0;
/// Supply voltage per count [V].
const SUPPLY_RESOLUTION: f32 = REFERENCE * 19.0 / FULL_SCALE as f32;
/// A current of this many times its limit is a fault of the power stage.
const TRIP: f32 = 1.15;
/// Periods of the current loop in a control period.
const PERIODS: u32 = (TICK / SWITCHING.period + 0.5) as u32;
/// Back-EMF of a motor above which the gate drivers must not be woken [V].
const MAX_BACK_EMF: f32 = 5.0;

/// The board's equipment.
const EQUIPMENT: Equipment = Equipment {
    motors: N as u8,
    absolute_encoders: false,
    count_rate: COUNT_RATE,
    force_sensors: 0,
    current: 25.0,
    supply: 48.0,
};
// The amplifiers show every trip.
const _: () = assert!(TRIP * EQUIPMENT.current < SENSE.range());

/// From the control task to the current loops.
static ORDER: Handover<{ order_words(N) }> = Handover::new();
/// From the current loops to the control task.
static REPORT: Handover<{ report_words(N) }> = Handover::new();
/// New motors, from the control task to the current loops.
static NEW_MOTORS: ConstStaticCell<Queue<Motors<N>, 2>> = ConstStaticCell::new(Queue::new());

/// Lines of EXTI.
const FAULT_LINE: u32 = 1 << 2;
const STOP_LINE: u32 = 1 << 4;

/// See the module.
pub struct Odrive {
    emergency_stop: PC4<Input>,
    fault: PD2<Input>,
    gates: Gates<Device<Spi3OnC>, PB12<PinOutput>, N>,
    is_ready: bool,
    to_loops: Producer<'static, Motors<N>>,
    joints: MotorJoints<N>,
}

impl Board for Odrive {
    const CRYSTAL: u32 = 8_000_000;
    const HAS_POWER_STAGES: bool = true;
    const SUPERVISOR: SupervisorLine = SupervisorLine::Uart4;

    type Latch = Encoders;
    type CurrentControl = CurrentLoops;

    fn start(peripherals: Peripherals<'_>) -> (Self, Encoders, CurrentLoops) {
        let rcc = peripherals.rcc;
        let a = peripherals.gpioa.split(rcc);
        let b = peripherals.gpiob.split(rcc);
        let c = peripherals.gpioc.split(rcc);
        let d = peripherals.gpiod.split(rcc);
        // First of all: the gate drivers are asleep, and unused gates are off.
        let enable = b.pb12.into_push_pull_output();
        a.pa8.into_push_pull_output();
        b.pb13.into_push_pull_output();
        c.pc6.into_push_pull_output();
        a.pa7.into_push_pull_output();
        b.pb10.into_push_pull_output();
        b.pb11.into_push_pull_output();
        a.pa0.into_alternate::<8>();
        a.pa1.into_alternate::<8>().internal_resistor(Pull::Up);
        let emergency_stop = c.pc4.into_pull_down_input();
        let fault = d.pd2.into_pull_up_input();

        let up = Pull::Up;
        let encoder_0 = (
            b.pb4.into_alternate::<2>().internal_resistor(up),
            b.pb5.into_alternate::<2>().internal_resistor(up),
        );
        let encoder_1 = (
            b.pb6.into_alternate::<2>().internal_resistor(up),
            b.pb7.into_alternate::<2>().internal_resistor(up),
        );
        let encoders = Encoders(
            (Qei::new(peripherals.tim3, encoder_0, rcc), Counter::new()),
            (Qei::new(peripherals.tim4, encoder_1, rcc), Counter::new()),
        );
        crate::filter_encoders!(TIM3, TIM4);

        c.pc0.into_analog();
        c.pc1.into_analog();
        c.pc2.into_analog();
        c.pc3.into_analog();
        a.pa6.into_analog();
        let converters = (peripherals.adc1, peripherals.adc2, peripherals.adc3, peripherals.adc_common);
        let adc = CurrentAdc::start(converters, rcc, [&[10, 6], &[13, 11], &[12]]);
        let bridges = HalfBridges::start((peripherals.tim1, peripherals.tim8), rcc, RESOLUTION);
        // The outputs already idle low when they are connected to their pins.
        a.pa9.into_alternate::<1>();
        a.pa10.into_alternate::<1>();
        b.pb14.into_alternate::<1>();
        b.pb15.into_alternate::<1>();
        c.pc7.into_alternate::<3>();
        c.pc8.into_alternate::<3>();
        b.pb0.into_alternate::<3>();
        b.pb1.into_alternate::<3>();

        c.pc13.into_push_pull_output_in_state(true.into());
        c.pc14.into_push_pull_output_in_state(true.into());
        c.pc10.into_alternate::<6>().speed(Speed::High);
        c.pc11.into_alternate::<6>().internal_resistor(Pull::Down);
        c.pc12.into_alternate::<6>().speed(Speed::High);
        let devices = Device::start(peripherals.spi3, rcc, [13, 14]);
        let gates = Gates::new(devices.map(|device| Drv8301::new(device, GATE_DRIVERS)), enable);
        pac::SYSCFG::enable(rcc);
        connect_trips(&peripherals.syscfg, &peripherals.exti);

        let (to_loops, new_motors) = NEW_MOTORS.take().split();
        let joints = MotorJoints::new(PERIODS);
        let board = Self { emergency_stop, fault, gates, is_ready: false, to_loops, joints };
        let loops = CurrentLoops {
            adc,
            stages: Stages(bridges),
            motors: Motors::none(&SWITCHING, 0.0),
            new_motors,
            order: 0,
            learns: false,
            offsets: [OFFSET; 2 * N],
        };
        (board, encoders, loops)
    }

    // Not inlined: its memory on the stack is free when the robot is configured.
    #[inline(never)]
    fn configure(&mut self, model: &RobotModel) -> Result<(), ModelError> {
        EQUIPMENT.check(model)?;
        let motors = motors_for(model, Sensing::Signed, TRIP, &SWITCHING, 0.0)?;
        self.joints.configure(model);
        // The queue is full only if the current loop does not run, which `read` reports. Then nothing moves.
        let _ = self.to_loops.enqueue(motors);
        Ok(())
    }

    fn read(&mut self, period: u32, sample: &Sample) -> Option<SensorFrame> {
        // Not ready until everything was read.
        self.is_ready = false;
        let (_, words) = sample.measured?;
        let measured = LoopReport::<N>::from_words(&words);
        let mut frame = self.joints.update(period, sample.counts, &measured)?;
        let stopped = self.emergency_stop.is_low();
        if stopped {
            Self::off();
        }
        let may_wake = !stopped && self.joints.are_slow(MAX_BACK_EMF);
        self.is_ready = self.gates.update(may_wake);
        watch_fault_line(self.is_ready);
        if self.is_ready && self.fault.is_low() {
            // It may have been low since before its edges were watched.
            Self::off();
            self.is_ready = false;
        }
        let can_drive = self.is_ready && measured.is_ready && !measured.has_tripped;
        frame.flags.0 |= if stopped { SensorFlags::EMERGENCY_STOP } else { 0 };
        frame.flags.0 |= if can_drive { 0 } else { SensorFlags::POWER_STAGE };
        Some(frame)
    }

    fn write(&mut self, actuators: &ActuatorFrame) {
        let order = if actuators.enabled && self.is_ready {
            Order::Drive(self.joints.command(&actuators.torques))
        } else {
            HalfBridges::off();
            if self.is_ready { Order::Learn } else { Order::Off }
        };
        ORDER.write(order.words());
    }

    fn off() {
        sleep();
        HalfBridges::off();
    }

    fn on_edge() {
        Self::off();
        // SAFETY: ones clear bits in this register; the others stay.
        unsafe { (*pac::EXTI::ptr()).pr().write(|w| w.bits(FAULT_LINE | STOP_LINE)) };
    }
}

/// Sets whether an edge of `nFAULT` trips: the line may be low while the gate drivers wake.
fn watch_fault_line(is_watched: bool) {
    // SAFETY: only the control task changes the mask after the start.
    let exti = unsafe { &*pac::EXTI::ptr() };
    let mask = exti.imr().read().bits();
    if is_watched == (mask & FAULT_LINE != 0) {
        return;
    }
    // SAFETY: the bit of a line that the chip has; ones clear bits in the other register.
    unsafe {
        exti.pr().write(|w| w.bits(FAULT_LINE));
        exti.imr().write(|w| w.bits(mask ^ FAULT_LINE));
    }
}

/// Connects EXTI2 to the falling edge of PD2, and EXTI4 to that of PC4.
fn connect_trips(syscfg: &pac::SYSCFG, exti: &pac::EXTI) {
    // SAFETY: the ports of the lines, C is 2 and D is 3 (RM0090, 9.2); bits of lines that the chip has.
    unsafe {
        syscfg.exticr1().modify(|_, w| w.exti2().bits(3));
        syscfg.exticr2().modify(|_, w| w.exti4().bits(2));
        exti.ftsr().modify(|r, w| w.bits(r.bits() | FAULT_LINE | STOP_LINE));
        exti.imr().modify(|r, w| w.bits(r.bits() | STOP_LINE));
    }
}

/// Pulls `EN_GATE` low.
fn sleep() {
    // SAFETY: a single store that resets PB12.
    unsafe { (*pac::GPIOB::ptr()).bsrr().write(|w| w.bits(1 << 28)) };
}

/// A latched sample: the encoders, and the last measurement of the current loops.
#[derive(Clone, Copy)]
pub struct Sample {
    counts: [i32; N],
    measured: Option<(u32, [u32; report_words(N)])>,
}

/// The encoders' counters. They are extended here, and not when a sample is read, so that no late control
/// task loses a round of theirs.
pub struct Encoders((Qei<TIM3>, Counter), (Qei<TIM4>, Counter));

impl Latch for Encoders {
    type Sample = Sample;

    fn latch(&mut self) -> Sample {
        let Self((first, of_first), (second, of_second)) = self;
        let counts = [of_first.extend(first.count()), of_second.extend(second.count())];
        Sample { counts, measured: REPORT.read(0) }
    }
}

/// The power stages: one half bridge of a motor gives pulses, and the low side of the other is on.
struct Stages(HalfBridges);

impl PowerStages<N> for Stages {
    fn off(&mut self) {
        HalfBridges::off();
    }

    fn wake(&mut self) {}

    /// If a trip came before or meanwhile, the gate drivers are asleep: then the half bridges stay off, and
    /// the next sample reports the trip.
    fn enable_pulses(&mut self) {
        self.0.enable();
        // SAFETY: reading this register has no effect.
        if unsafe { (*pac::GPIOB::ptr()).odr().read().bits() & 1 << 12 == 0 } {
            HalfBridges::off();
        }
    }

    fn has_tripped(&self) -> bool {
        !self.0.are_on()
    }

    fn set(&mut self, outputs: &[Output; N]) {
        self.0
            .set(outputs.map(|Output { positive, counts }| if positive { [counts, 0] } else { [0, counts] }));
    }
}

/// The current loops, a sample at a time.
pub struct CurrentLoops {
    adc: CurrentAdc,
    stages: Stages,
    motors: Motors<N>,
    new_motors: Consumer<'static, Motors<N>>,
    /// Number of the last order.
    order: u32,
    learns: bool,
    /// Offsets of the amplifiers: B and C of M0, then of M1.
    offsets: [Offset; 2 * N],
}

impl CurrentControl for CurrentLoops {
    fn phase(&self) -> Option<Phase> {
        Some(self.stages.0.phase(RESOLUTION))
    }

    fn on_sample(&mut self) {
        let [[b0, supply], [b1, c0], [c1, _]] = self.adc.sample();
        self.motors.take_over(&mut self.new_motors, &mut self.stages);
        if let Some((number, words)) = ORDER.read(self.order) {
            self.order = number;
            let order = Order::from_words(&words);
            self.motors.command(order.command(), &mut self.stages);
            self.learns = order == Order::Learn;
            if order == Order::Off {
                self.offsets.iter_mut().for_each(Offset::forget);
            }
        }
        let counts = [b0, c0, b1, c1];
        for (offset, counts) in self.offsets.iter_mut().zip(counts) {
            if self.learns { offset.learn(counts) } else { offset.interrupt() }
        }
        // With their offsets, amplifiers may saturate below the trip.
        let [b0, c0, b1, c1] = core::array::from_fn(|amplifier| match counts[amplifier] {
            counts if SENSE.is_linear(counts) => self.offsets[amplifier].remove(counts),
            _ => f32::NAN,
        });
        self.motors.update(
            &[current(b0, c0), current(b1, c1)],
            f32::from(supply) * SUPPLY_RESOLUTION,
            &mut self.stages,
        );
        let is_ready = self.offsets.iter().all(Offset::is_known);
        REPORT.write(self.motors.report(is_ready).words());
    }
}

/// Returns a motor's current [A] from the currents out of its half bridges [counts], or NaN if those are NaN
/// or do not match. As in the board's own firmware (`Firmware/MotorControl/motor.cpp`), an output above the
/// middle is a current out of the half bridge.
fn current(b: f32, c: f32) -> f32 {
    if math::abs(b + c) <= MAX_SUM { 0.5 * (b - c) * SENSE.resolution() } else { f32::NAN }
}
