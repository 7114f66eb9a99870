//! The firmware image: an RTIC application around [`tesaki::node::Node`]. The library describes the
//! priorities.

#![no_std]
#![no_main]

mod boot;
mod crash;

use stm32f4xx_hal::pac;

#[rtic::app(device = stm32f4xx_hal::pac, peripherals = true)]
mod app {
    use heapless::Vec;
    use heapless::spsc::{Consumer, Producer, Queue};
    use tesaki::node::Node;
    use tesaki::protocol::{
        ActuatorFrame, BoardStatus, FromBoard, LogEntry, LogRecord, RequestFrame, SensorFrame, Stream,
    };
    use tesaki_firmware::board::{Board, ThisBoard};
    use tesaki_firmware::link::{Endpoint, Storage, UartIsr};
    use tesaki_firmware::watchdog::Watchdog;
    use tesaki_firmware::{retained, stack};

    use super::{boot, pac};
    use pac::Interrupt;

    /// Log entries of a tick: index of the second one, input, output.
    type TickLog = (u32, SensorFrame, ActuatorFrame);
    /// Capacity plus one of the queue of log entries. One tick every 10 ms; sending the longest takes 3 ms.
    const TICK_LOGS: usize = 8;

    #[shared]
    struct Shared {
        node: &'static mut Node,
        /// Statistics of the plant link, for the status.
        plant_statistics: tesaki::protocol::LinkStatistics,
        watchdog: Watchdog,
    }

    #[local]
    struct Local {
        timer: pac::TIM2,
        /// Control periods since boot.
        periods: u32,
        supervisor_uart_isr: UartIsr<pac::USART1>,
        supervisor: Endpoint,
        plant_uart_isr: UartIsr<pac::USART2>,
        plant: Endpoint,
        board: ThisBoard,
        /// Last control period of the control task.
        last_period: u32,
        status: BoardStatus,
        retained_faults: u32,
        plant_link: bool,
        ticks_in: Producer<'static, TickLog>,
        ticks_out: Consumer<'static, TickLog>,
    }

    #[init(local = [
        node: Node = Node::new(),
        supervisor_link: Storage = Storage::new(),
        plant_storage: Storage = Storage::new(),
        ticks: Queue<TickLog, TICK_LOGS> = Queue::new(),
    ])]
    fn init(cx: init::Context) -> (Shared, Local) {
        stack::paint();
        let boot::Started { usart1, usart2, timer, watchdog, status } = boot::start(cx.device, cx.local.node);
        let (supervisor_uart_isr, supervisor) = cx.local.supervisor_link.split(usart1);
        let (plant_uart_isr, plant) = cx.local.plant_storage.split(usart2);
        defmt::info!(
            "tesaki: capabilities {}, clock {}, reset {}",
            status.identity.capabilities,
            status.clock,
            status.reset
        );
        let plant_link = boot::plant_link();
        let (ticks_in, ticks_out) = cx.local.ticks.split();
        let retained_faults = cx.local.node.faults().total;
        (
            Shared { node: cx.local.node, plant_statistics: Default::default(), watchdog },
            Local {
                timer,
                periods: 0,
                supervisor_uart_isr,
                supervisor,
                plant_uart_isr,
                plant,
                board: tesaki_firmware::board::BareBoard,
                last_period: 0,
                status,
                retained_faults,
                plant_link,
                ticks_in,
                ticks_out,
            },
        )
    }

    #[idle(shared = [watchdog])]
    fn idle(mut cx: idle::Context) -> ! {
        // Latched at boot.
        let plant_link = boot::plant_link();
        loop {
            if plant_link {
                cx.shared.watchdog.lock(|watchdog| watchdog.feed());
            }
            cortex_m::asm::wfi();
        }
    }

    /// The 10 ms timer.
    #[task(binds = TIM2, priority = 4, local = [timer, periods])]
    fn instant(cx: instant::Context) {
        cx.local.timer.sr().modify(|_, w| w.uif().clear_bit());
        *cx.local.periods = cx.local.periods.wrapping_add(1);
        boot::set_period(*cx.local.periods);
        rtic::pend(Interrupt::EXTI0);
    }

    #[task(binds = USART1, priority = 3, local = [supervisor_uart_isr])]
    fn supervisor_uart(cx: supervisor_uart::Context) {
        if cx.local.supervisor_uart_isr.on_interrupt() {
            rtic::pend(Interrupt::EXTI1);
        }
    }

    #[task(binds = USART2, priority = 3, local = [plant_uart_isr])]
    fn plant_uart(cx: plant_uart::Context) {
        if cx.local.plant_uart_isr.on_interrupt() {
            rtic::pend(Interrupt::EXTI0);
        }
    }

    /// One control period, of the timer or of the plant link.
    #[task(binds = EXTI0, priority = 2, shared = [node, plant_statistics, watchdog],
           local = [board, plant, last_period, plant_link, ticks_in])]
    fn control(mut cx: control::Context) {
        if *cx.local.plant_link {
            while let Some(result) = cx.local.plant.receive::<SensorFrame>() {
                if let Ok(sensors) = result {
                    let actuators = cx.shared.node.lock(|node| tick(node, sensors, cx.local.ticks_in));
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
            // The sequence number reveals a missed period; the node raises a fault.
            let actuators = cx.shared.node.lock(|node| tick(node, sensors, cx.local.ticks_in));
            cx.local.board.write(&actuators);
        }
        if on_time {
            cx.shared.watchdog.lock(|watchdog| watchdog.feed());
        }
    }

    fn tick(node: &mut Node, sensors: SensorFrame, log: &mut Producer<'static, TickLog>) -> ActuatorFrame {
        let faults = node.faults().total;
        let actuators = node.tick(&sensors);
        if node.faults().total != faults {
            retained::retain_faults(node.faults());
        }
        let logged = node.is_logged();
        if logged {
            // If the queue is full, the gap in the indices tells the receiver how many entries are missing.
            let _ = log.enqueue((node.records(), sensors, actuators.clone()));
        }
        if logged || Stream::ALL.into_iter().any(|stream| node.is_due(stream)) {
            rtic::pend(Interrupt::EXTI1);
        }
        actuators
    }

    /// Requests, telemetry and log.
    #[task(binds = EXTI1, priority = 1, shared = [node, plant_statistics],
           local = [supervisor, status, retained_faults, ticks_out, sent_tick: Option<u32> = None])]
    fn supervisor(mut cx: supervisor::Context) {
        let link = cx.local.supervisor;
        let ticks = cx.local.ticks_out;
        let status = &mut *cx.local.status;
        let refresh = |status: &mut BoardStatus, link: &Endpoint, plant| {
            (status.supervisor_link, status.plant) = (link.statistics(), plant);
            (status.stack_used, status.stack_size) = stack::usage();
        };
        while let Some(result) = link.receive::<RequestFrame>() {
            if let Ok(request) = result {
                let plant = cx.shared.plant_statistics.lock(|statistics| *statistics);
                refresh(status, link, plant);
                let (reply, faults, index, logged) = cx.shared.node.lock(|node| {
                    let reply = node.handle(&request, status);
                    if node.faults().total != *cx.local.retained_faults {
                        retained::retain_faults(node.faults());
                    }
                    (reply, node.faults().total, node.records(), node.is_logged())
                });
                *cx.local.retained_faults = faults;
                link.send(&FromBoard::Reply(reply));
                if logged {
                    send_ticks(link, ticks, index);
                    send_log(link, index, LogRecord::Request(request));
                }
                rtic::pend(Interrupt::USART1);
            }
        }
        if cx.shared.node.lock(|node| node.is_due(Stream::Status)) {
            let plant = cx.shared.plant_statistics.lock(|statistics| *statistics);
            refresh(status, link, plant);
        }
        // All streams of one tick, and each tick once.
        let sent_tick = &mut *cx.local.sent_tick;
        let (messages, index) = cx.shared.node.lock(|node| {
            let mut messages = Vec::<FromBoard, { Stream::ALL.len() }>::new();
            if sent_tick.replace(node.last_tick()) != Some(node.last_tick()) {
                for message in Stream::ALL.into_iter().filter_map(|stream| node.due(stream, status)) {
                    // Cannot fail: the capacity is the number of streams.
                    let _ = messages.push(message);
                }
            }
            (messages, node.records())
        });
        send_ticks(link, ticks, index);
        for message in &messages {
            link.send(message);
        }
        rtic::pend(Interrupt::USART1);
    }

    /// Sends the ticks before log entry `index`, so that entries are sent in order.
    fn send_ticks(link: &mut Endpoint, ticks: &mut Consumer<'static, TickLog>, index: u32) {
        while let Some(&(last, ..)) = ticks.peek()
            && index.wrapping_sub(last).cast_signed() >= 0
            && let Some((last, sensors, actuators)) = ticks.dequeue()
        {
            send_log(link, last.wrapping_sub(1), LogRecord::Sensors(sensors));
            send_log(link, last, LogRecord::Actuators(actuators));
        }
    }

    fn send_log(link: &mut Endpoint, index: u32, record: LogRecord) {
        link.send(&FromBoard::Log(LogEntry { index, record }));
    }
}
