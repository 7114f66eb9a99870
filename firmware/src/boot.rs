//! From reset to the first interrupt.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use stm32f4xx_hal::pac;
use stm32f4xx_hal::prelude::*;
use tesaki::fault::{Fault, FaultCause};
use tesaki::node::Node;
use tesaki::protocol::{BoardStatus, ClockSource, Identity, LinkStatistics, ResetCause};
use tesaki_firmware::board::{Board, ThisBoard, uses_plant_link};
use tesaki_firmware::identity::identity;
use tesaki_firmware::watchdog::Watchdog;
use tesaki_firmware::{clock, retained, start_uart};

static PLANT_LINK: AtomicBool = AtomicBool::new(false);
static PERIOD: AtomicU32 = AtomicU32::new(0);

/// Whether the strap selected the plant link at boot.
pub fn plant_link() -> bool {
    PLANT_LINK.load(Ordering::Relaxed)
}

/// Control periods since boot.
pub fn period() -> u32 {
    PERIOD.load(Ordering::Relaxed)
}

/// Sets the number of control periods since boot.
pub fn set_period(period: u32) {
    PERIOD.store(period, Ordering::Relaxed);
}

/// Resources of the RTIC tasks.
pub struct Started {
    pub usart1: pac::USART1,
    pub usart2: pac::USART2,
    pub timer: pac::TIM2,
    pub watchdog: Watchdog,
    pub status: BoardStatus,
}

/// Initialises clock, watchdog, pins, UARTs and timer, and records the cause of the reset in `node`.
pub fn start(device: pac::Peripherals, node: &mut Node) -> Started {
    let watchdog = Watchdog::start(device.IWDG);
    let clocks = clock::bring_up(&device.RCC, &device.FLASH);
    device.RCC.apb1enr().modify(|_, w| w.tim2en().set_bit().usart2en().set_bit());
    device.RCC.apb2enr().modify(|_, w| w.usart1en().set_bit());
    let flags = device.RCC.csr().read();
    let (by_watchdog, by_software) = (flags.wdgrstf().bit_is_set(), flags.sftrstf().bit_is_set());
    device.RCC.csr().modify(|_, w| w.rmvf().set_bit());

    let mut identity = identity(&device.RCC, Identity::TASKS);

    let mut rcc = device.RCC.constrain();
    let gpio_a = device.GPIOA.split(&mut rcc);
    let gpio_b = device.GPIOB.split(&mut rcc);
    let _usart1_pins = (gpio_a.pa9.into_alternate::<7>(), gpio_a.pa10.into_alternate::<7>());
    let _usart2_pins = (gpio_a.pa2.into_alternate::<7>(), gpio_a.pa3.into_alternate::<7>());
    // Grounded: plant link. Open, with pull-up: sensors and drives of the board.
    let mut strap = gpio_b.pb12.into_pull_up_input();
    cortex_m::asm::delay(1000); // settling time of the pull-up
    let plant_link = uses_plant_link::<ThisBoard>(&mut strap);
    PLANT_LINK.store(plant_link, Ordering::Relaxed);
    identity.capabilities |= if plant_link { Identity::PLANT_LINK } else { 0 };
    identity.capabilities |= if ThisBoard::OWNS_GATE_DRIVERS { Identity::POWER_STAGES } else { 0 };

    start_uart!(device.USART1, clocks.usart1, clocks.baud);
    start_uart!(device.USART2, clocks.usart2, clocks.baud);
    let timer = device.TIM2;
    if !plant_link {
        start_timer(&timer, clocks.timer);
    }

    let crash = retained::take_crash();
    let reset = match &crash {
        _ if by_watchdog => ResetCause::Watchdog,
        Some(crash) if crash.cause() == FaultCause::Panic => ResetCause::Panic,
        Some(_) => ResetCause::HardFault,
        None if by_software => ResetCause::Software,
        None => ResetCause::PowerOn,
    };
    if let Some(log) = retained::faults() {
        node.restore_faults(log);
    }
    let mut record = |cause, value: u32| {
        #[expect(clippy::cast_precision_loss, reason = "a line number or an address, for display")]
        node.record_fault(Fault { cause, joint: None, value: value as f32, limit: 0.0, tick: 0 });
    };
    if by_watchdog {
        record(FaultCause::WatchdogReset, 0);
    }
    if let Some(crash) = &crash {
        record(crash.cause(), crash.place);
    }
    if clocks.source != ClockSource::Crystal && !plant_link {
        record(FaultCause::ClockFallback, clocks.source as u32);
    }
    retained::retain_faults(node.faults());
    let text = crash.as_ref().map_or("", |crash| crash.text());
    let status = BoardStatus {
        identity,
        clock: clocks.source,
        reset,
        last_words: text.try_into().unwrap_or_default(),
        stack_used: 0,
        stack_size: 0,
        supervisor_link: LinkStatistics::default(),
        plant: LinkStatistics::default(),
    };
    Started { usart1: device.USART1, usart2: device.USART2, timer, watchdog, status }
}

/// Starts the timer interrupt with a period of 10 ms.
fn start_timer(timer: &pac::TIM2, clock: u32) {
    timer.psc().write(|w| w.psc().set((clock / 1_000_000 - 1) as u16));
    timer.arr().write(|w| w.arr().set(9_999));
    timer.egr().write(|w| w.ug().set_bit());
    timer.sr().modify(|_, w| w.uif().clear_bit());
    timer.dier().modify(|_, w| w.uie().set_bit());
    timer.cr1().modify(|_, w| w.cen().set_bit());
}
