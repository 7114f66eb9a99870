//! From reset to the first interrupt.

use stm32f4xx_hal::pac;
use tesaki::fault::{Fault, FaultCause};
use tesaki::node::Node;
use tesaki::protocol::{BoardStatus, ClockSource, Identity, LinkStatistics, ResetCause};
use tesaki_firmware::board::{
    Board, CurrentControl, Peripherals, Phase, SupervisorLine, ThisBoard, uses_plant_link,
};
use tesaki_firmware::chip_supply;
use tesaki_firmware::clock::{self, Clocks};
use tesaki_firmware::identity::identity;
use tesaki_firmware::link::{Uart, Uarts};
use tesaki_firmware::retained;
use tesaki_firmware::watchdog::Watchdog;

/// The PLL's input is 1 MHz, and the chip takes 4 to 26 MHz.
const _: () = assert!(
    ThisBoard::CRYSTAL.is_multiple_of(1_000_000)
        && 4_000_000 <= ThisBoard::CRYSTAL
        && ThisBoard::CRYSTAL <= 26_000_000
);

/// Resources of the RTIC tasks.
pub struct Started {
    pub uarts: Uarts,
    pub timer: pac::TIM2,
    pub watchdog: Watchdog,
    pub board: ThisBoard,
    pub latch: <ThisBoard as Board>::Latch,
    pub current_control: <ThisBoard as Board>::CurrentControl,
    /// Whether sensors and drives are on the plant link; fixed until the next reset.
    pub plant_link: bool,
    pub status: BoardStatus,
}

/// Initialises clock, watchdog, board, UARTs and timer, and records the cause of the reset in `node`.
pub fn start(device: pac::Peripherals, syst: cortex_m::peripheral::SYST, node: &mut Node) -> Started {
    let watchdog = Watchdog::start(device.IWDG);
    let mut rcc = device.RCC;
    let is_supplied = chip_supply::start(&rcc, &device.PWR, &device.EXTI, &watchdog);
    let measure = || clock::measure_crystal(&rcc, &device.TIM11);
    let clocks = if is_supplied {
        clock::bring_up(&rcc, &device.FLASH, ThisBoard::CRYSTAL, measure)
    } else {
        Clocks::SLOW
    };
    watchdog.feed();
    rcc.apb1enr().modify(|_, w| w.tim2en().set_bit());
    match ThisBoard::SUPERVISOR {
        SupervisorLine::Usart1 => rcc.apb2enr().modify(|_, w| w.usart1en().set_bit()),
        SupervisorLine::Uart4 => rcc.apb1enr().modify(|_, w| w.uart4en().set_bit()),
    };
    let flags = rcc.csr().read();
    let (by_watchdog, by_software) = (flags.wdgrstf().bit_is_set(), flags.sftrstf().bit_is_set());
    // The flag of a brown-out comes with every power-on, too (RM0090, 7.3.21).
    let by_power = flags.porrstf().bit_is_set();
    let by_brown_out = flags.borrstf().bit_is_set() && !by_power;
    let level = chip_supply::brown_out_level(&device.FLASH);
    rcc.csr().modify(|_, w| w.rmvf().set_bit());

    let mut identity = identity(&rcc, Identity::TASKS);

    let (mut board, latch, current_control) = ThisBoard::start(Peripherals {
        rcc: &mut rcc,
        clocks,
        exti: device.EXTI,
        syscfg: device.SYSCFG,
        syst,
        gpioa: device.GPIOA,
        gpiob: device.GPIOB,
        gpioc: device.GPIOC,
        gpiod: device.GPIOD,
        tim1: device.TIM1,
        tim3: device.TIM3,
        tim4: device.TIM4,
        tim5: device.TIM5,
        tim8: device.TIM8,
        adc1: device.ADC1,
        adc2: device.ADC2,
        adc3: device.ADC3,
        adc_common: device.ADC_COMMON,
        spi1: device.SPI1,
        spi2: device.SPI2,
        spi3: device.SPI3,
    });
    let plant_link = uses_plant_link(&mut board);
    identity.capabilities |= if plant_link { Identity::PLANT_LINK } else { 0 };
    identity.capabilities |= if ThisBoard::HAS_POWER_STAGES { Identity::POWER_STAGES } else { 0 };

    let uarts = Uarts { usart1: device.USART1, usart2: device.USART2, uart4: device.UART4 };
    match ThisBoard::SUPERVISOR {
        SupervisorLine::Usart1 => uarts.usart1.start(clocks.apb2, clocks.baud),
        SupervisorLine::Uart4 => uarts.uart4.start(clocks.apb1, clocks.baud),
    }
    if plant_link {
        board.connect_plant_link();
        rcc.apb1enr().modify(|_, w| w.usart2en().set_bit());
        // As in `chip_supply::start`.
        cortex_m::asm::dsb();
        uarts.usart2.start(clocks.apb1, clocks.baud);
    }
    let period = if plant_link { IDLE_PERIOD } else { PERIOD };
    start_timer(&device.TIM2, clocks.timer, period, || current_control.phase());

    // SAFETY: before the first interrupt.
    let crash = unsafe { retained::take_crash() };
    let reset = match &crash {
        _ if by_watchdog => ResetCause::Watchdog,
        Some(crash) => match crash.cause {
            FaultCause::Panic => ResetCause::Panic,
            FaultCause::CrystalStopped => ResetCause::CrystalStopped,
            FaultCause::ChipSupplyLow => ResetCause::BrownOut,
            _ => ResetCause::HardFault,
        },
        None if by_brown_out => ResetCause::BrownOut,
        None if by_software => ResetCause::Software,
        None => ResetCause::PowerOn,
    };
    // On the plant link the host controls time, so the accuracy of the clock does not matter.
    let clock_faults = if plant_link { [None; 2] } else { clock_faults(&clocks) };
    let watchdog_fault = by_watchdog.then_some((FaultCause::WatchdogReset, 0, 0));
    let crash_fault = crash.as_ref().map(|crash| (crash.cause, crash.place, 0));
    let brown_out = by_brown_out.then_some((FaultCause::ChipSupplyLow, 2, 0));
    let low_supply = (!is_supplied).then_some((FaultCause::ChipSupplyLow, 3, 0));
    // Its faults are those since power-on, even if the memory has kept older ones.
    // SAFETY: before the first interrupt.
    if !by_power && let Some((log, joints)) = unsafe { retained::faults() } {
        node.restore_faults(log, joints);
    }
    let is_told = node.faults().faults.iter().any(|fault| fault.cause == FaultCause::BrownOutResetOff);
    let unprotected = ThisBoard::HAS_POWER_STAGES && level < chip_supply::NEEDED_LEVEL && !is_told;
    let unprotected = unprotected.then_some((FaultCause::BrownOutResetOff, level, chip_supply::NEEDED_LEVEL));
    let own = [watchdog_fault, crash_fault, brown_out, low_supply, unprotected];
    record_faults(node, own.into_iter().chain(clock_faults).flatten());
    let status = BoardStatus {
        identity,
        clock: clocks.source,
        reset,
        last_words: crash.map(|crash| crash.text).unwrap_or_default(),
        stack_used: 0,
        stack_size: 0,
        supervisor_link: LinkStatistics::default(),
        plant: LinkStatistics::default(),
    };
    Started { uarts, timer: device.TIM2, watchdog, board, latch, current_control, plant_link, status }
}

/// A fault found at the start: cause, value and limit.
type StartFault = (FaultCause, u32, u32);

/// Returns the faults of the clocks.
fn clock_faults(clocks: &Clocks) -> [Option<StartFault>; 2] {
    let wrong_crystal =
        clocks.wrong_crystal.map(|measured| (FaultCause::WrongCrystal, measured, ThisBoard::CRYSTAL));
    let fallback = clocks.source != ClockSource::Crystal;
    [wrong_crystal, fallback.then_some((FaultCause::ClockFallback, clocks.source as u32, 0))]
}

/// Adds the faults found at the start.
fn record_faults(node: &mut Node, faults: impl Iterator<Item = StartFault>) {
    for (cause, value, limit) in faults {
        #[expect(
            clippy::cast_precision_loss,
            reason = "a line number, an address or a frequency, for display"
        )]
        node.record_fault(Fault { cause, joint: None, value: value as f32, limit: limit as f32, tick: 0 });
    }
    // SAFETY: before the first interrupt.
    unsafe { retained::retain_faults(node.faults(), node.fault_joints()) };
}

/// Period of the timer on the plant link [µs]: the idle loop wakes in time for the watchdog, whose timeout is
/// at least 68 ms.
const IDLE_PERIOD: u16 = 50_000;
/// The control period [µs].
const PERIOD: u16 = (tesaki::TICK * 1e6) as u16;

/// Time from a trigger of the converters to the instant of a control period [µs]. Both come from the same
/// PLL, and the control period is a multiple of that of the triggers, so it stays as it is set. Conversion
/// and current loops take some 11 µs after a trigger, of the 25 or 50 µs to the next: at this time the
/// instant neither interrupts them, nor falls on the end where it would see a sample more or a sample less.
const INSTANT: u32 = 18;

/// Starts the timer interrupt with `period` [µs], and, if `phase` returns that of the converters, [`INSTANT`]
/// after a trigger, to a microsecond.
fn start_timer(timer: &pac::TIM2, clock: u32, period: u16, phase: impl FnOnce() -> Option<Phase>) {
    timer.psc().write(|w| w.psc().set((clock / 1_000_000 - 1) as u16));
    timer.arr().write(|w| w.arr().set(u32::from(period) - 1));
    timer.egr().write(|w| w.ug().set_bit());
    timer.sr().modify(|_, w| w.uif().clear_bit());
    timer.dier().modify(|_, w| w.uie().set_bit());
    if let Some(Phase { since, period: pulse }) = phase() {
        // Counts of 168 MHz until the first such time, and microseconds.
        let left = (INSTANT * 168 + pulse - since.min(pulse)) % pulse.max(1) / 168;
        timer.cnt().write(|w| w.cnt().set(u32::from(period) - 1 - left));
    }
    timer.cr1().modify(|_, w| w.cen().set_bit());
}
