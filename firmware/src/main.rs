//! The image that is flashed: an RTIC application around [`tesaki::node::Node`]. See the library for the priorities.

#![no_std]
#![no_main]

mod boot;
mod last_words;

use stm32f4xx_hal::pac;

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
mod app {
    use tesaki::node::Node;
    use tesaki::protocol::{ActuatorFrame, BoardStatus, FromBoard, RequestFrame, SensorFrame};
    use tesaki_firmware::board::{Board, ThisBoard};
    use tesaki_firmware::link::{Endpoint, Port, Storage};
    use tesaki_firmware::watchdog::Watchdog;
    use tesaki_firmware::{retained, stack};

    use super::{boot, pac};
    use pac::Interrupt;

    #[shared]
    struct Shared {
        node: &'static mut Node,
        /// The plant link as the control task sees it, for the status.
        plant_statistics: tesaki::protocol::LinkStatistics,
        watchdog: Watchdog,
    }

    #[local]
    struct Local {
        timer: pac::TIM2,
        /// Control periods since boot.
        periods: u32,
        supervisor_port: Port<pac::USART1>,
        supervisor: Endpoint,
        plant_port: Port<pac::USART2>,
        plant: Endpoint,
        board: ThisBoard,
        /// Control periods that the control task has seen.
        last_period: u32,
        status: BoardStatus,
        kept_faults: u32,
        plant_link: bool,
    }

    #[init(local = [
        node: Node = Node::new(),
        supervisor_link: Storage = Storage::new(),
        plant_storage: Storage = Storage::new(),
    ])]
    fn init(cx: init::Context) -> (Shared, Local) {
        stack::paint();
        let boot::Started { usart1, usart2, timer, watchdog, status } = boot::start(cx.device, cx.local.node);
        let (supervisor_port, supervisor) = cx.local.supervisor_link.split(usart1);
        let (plant_port, plant) = cx.local.plant_storage.split(usart2);
        defmt::info!(
            "tesaki: plant link {}, clock {}, reset {}",
            status.plant_link,
            status.clock,
            status.reset
        );
        let plant_link = status.plant_link;
        let kept_faults = cx.local.node.faults().total;
        (
            Shared { node: cx.local.node, plant_statistics: Default::default(), watchdog },
            Local {
                timer,
                periods: 0,
                supervisor_port,
                supervisor,
                plant_port,
                plant,
                board: tesaki_firmware::board::BareBoard,
                last_period: 0,
                status,
                kept_faults,
                plant_link,
            },
        )
    }

    #[idle(shared = [watchdog])]
    fn idle(mut cx: idle::Context) -> ! {
        // The strap is latched: what the boot found stays.
        let plant_link = boot::plant_link();
        loop {
            if plant_link {
                cx.shared.watchdog.lock(|watchdog| watchdog.feed());
            }
            cortex_m::asm::wfi();
        }
    }

    /// The 10 ms instant.
    #[task(binds = TIM2, priority = 4, local = [timer, periods])]
    fn instant(cx: instant::Context) {
        cx.local.timer.sr().modify(|_, w| w.uif().clear_bit());
        *cx.local.periods = cx.local.periods.wrapping_add(1);
        boot::set_period(*cx.local.periods);
        rtic::pend(Interrupt::EXTI0);
    }

    #[task(binds = USART1, priority = 3, local = [supervisor_port])]
    fn supervisor_uart(cx: supervisor_uart::Context) {
        if cx.local.supervisor_port.on_interrupt() {
            rtic::pend(Interrupt::EXTI1);
        }
    }

    #[task(binds = USART2, priority = 3, local = [plant_port])]
    fn plant_uart(cx: plant_uart::Context) {
        if cx.local.plant_port.on_interrupt() {
            rtic::pend(Interrupt::EXTI0);
        }
    }

    /// One control period: of the board's own timer, or of the plant link.
    #[task(binds = EXTI0, priority = 2, shared = [node, plant_statistics, watchdog],
           local = [board, plant, last_period, plant_link])]
    fn control(mut cx: control::Context) {
        if *cx.local.plant_link {
            while let Some(result) = cx.local.plant.receive::<SensorFrame>() {
                if let Ok(sensors) = result {
                    let actuators = cx.shared.node.lock(|node| tick(node, &sensors));
                    cx.local.plant.send(&actuators);
                    rtic::pend(Interrupt::USART2);
                }
            }
            let statistics = cx.local.plant.statistics();
            cx.shared.plant_statistics.lock(|shared| *shared = statistics);
            return;
        }
        let period = boot::period();
        let on_time = period == cx.local.last_period.wrapping_add(1);
        *cx.local.last_period = period;
        if let Some(sensors) = cx.local.board.read(period) {
            // A period that was missed shows in the sequence number, and the node makes a fault of it.
            let actuators = cx.shared.node.lock(|node| tick(node, &sensors));
            cx.local.board.write(&actuators);
        }
        if on_time {
            cx.shared.watchdog.lock(|watchdog| watchdog.feed());
        }
    }

    fn tick(node: &mut Node, sensors: &SensorFrame) -> ActuatorFrame {
        let faults = node.faults().total;
        let actuators = node.tick(sensors);
        if node.faults().total != faults {
            retained::keep_faults(node.faults());
        }
        if node.telemetry_due() {
            rtic::pend(Interrupt::EXTI1);
        }
        actuators
    }

    /// Requests and telemetry.
    #[task(binds = EXTI1, priority = 1, shared = [node, plant_statistics],
           local = [supervisor, status, kept_faults, told: Option<u32> = None])]
    fn supervisor(mut cx: supervisor::Context) {
        let link = cx.local.supervisor;
        while let Some(result) = link.receive::<RequestFrame>() {
            if let Ok(request) = result {
                let status = &mut *cx.local.status;
                status.supervisor_link = link.statistics();
                status.plant = cx.shared.plant_statistics.lock(|statistics| *statistics);
                (status.stack_used, status.stack_size) = stack::usage();
                let (reply, faults) = cx.shared.node.lock(|node| {
                    let reply = node.handle(&request, status);
                    if node.faults().total != *cx.local.kept_faults {
                        retained::keep_faults(node.faults());
                    }
                    (reply, node.faults().total)
                });
                *cx.local.kept_faults = faults;
                link.send(&FromBoard::Reply(reply));
                rtic::pend(Interrupt::USART1);
            }
        }
        let told = cx.local.told;
        let telemetry = cx.shared.node.lock(|node| node.telemetry_due().then(|| node.telemetry()));
        if let Some(telemetry) = telemetry
            && told.replace(telemetry.tick) != Some(telemetry.tick)
        {
            link.send(&FromBoard::Telemetry(telemetry));
            rtic::pend(Interrupt::USART1);
        }
    }
}
