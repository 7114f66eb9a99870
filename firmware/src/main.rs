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
    use tesaki_firmware::board::{Board, CurrentControl, Latch, SupervisorLine, ThisBoard};
    use tesaki_firmware::control::Periods;
    use tesaki_firmware::link::{Endpoint, Line, Lines, Storage};
    use tesaki_firmware::watchdog::{Background, Watchdog, tell_alive};
    use tesaki_firmware::{retained, stack};

    use super::{boot, crash, pac};
    use pac::Interrupt;

    /// Log entries of a tick: index of the second one, input, output.
    type TickLog = (u32, SensorFrame, ActuatorFrame);
    /// Capacity plus one of the queue of log entries. One tick every 10 ms; sending the longest takes 3 ms.
    const TICK_LOGS: usize = 8;

    /// Requests that are handled before telemetry and log get their turn.
    const REQUESTS: u32 = 8;

    type BoardLatch = <ThisBoard as Board>::Latch;
    /// Number of a period, and what the timer's interrupt has latched in it.
    type Sample = (u32, <BoardLatch as Latch>::Sample);

    #[shared]
    struct Shared {
        node: &'static mut Node,
        /// The last sample that the control task has not taken yet. It takes it directly after the instant:
        /// only a control task that is a period late can delay the next instant by its lock, less than a
        /// microsecond.
        sample: Option<Sample>,
        /// Statistics of the plant link, for the status.
        plant_statistics: tesaki::protocol::LinkStatistics,
        watchdog: Watchdog,
        board: ThisBoard,
        /// Whether sensors and drives are on the plant link. Set at boot.
        plant_link: bool,
    }

    #[local]
    struct Local {
        timer: pac::TIM2,
        latch: BoardLatch,
        current_control: <ThisBoard as Board>::CurrentControl,
        usart1: Line<pac::USART1>,
        usart2: Line<pac::USART2>,
        uart4: Line<pac::UART4>,
        supervisor: Endpoint,
        plant: Endpoint,
        status: BoardStatus,
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
        // SAFETY: the only call, and interrupts are off.
        unsafe { stack::paint() };
        let started = boot::start(cx.device, cx.core.SYST, cx.local.node);
        let boot::Started { uarts, timer, watchdog, board, latch, current_control, plant_link, status } =
            started;
        let Lines { usart1, usart2, uart4, supervisor, plant } = uarts.split(
            ThisBoard::SUPERVISOR,
            (cx.local.supervisor_link, Interrupt::EXTI1),
            (cx.local.plant_storage, Interrupt::EXTI0),
        );
        defmt::info!(
            "tesaki: capabilities {}, clock {}, reset {}",
            status.identity.capabilities,
            status.clock,
            status.reset
        );
        let (ticks_in, ticks_out) = cx.local.ticks.split();
        (
            Shared {
                node: cx.local.node,
                sample: None,
                plant_statistics: Default::default(),
                watchdog,
                board,
                plant_link,
            },
            Local {
                timer,
                latch,
                current_control,
                usart1,
                usart2,
                uart4,
                supervisor,
                plant,
                status,
                ticks_in,
                ticks_out,
            },
        )
    }

    #[idle(shared = [watchdog, &plant_link])]
    fn idle(mut cx: idle::Context) -> ! {
        loop {
            tell_alive();
            if *cx.shared.plant_link {
                cx.shared.watchdog.lock(|watchdog| watchdog.feed());
            }
            stack::scan();
            // The timer wakes it, if nothing else does.
            cortex_m::asm::wfi();
        }
    }

    /// The timer: the instant at which a control period begins. On the plant link it only wakes the idle
    /// loop.
    #[task(binds = TIM2, priority = 5, shared = [sample, &plant_link],
           local = [timer, latch, period: u32 = 0])]
    fn instant(mut cx: instant::Context) {
        cx.local.timer.sr().modify(|_, w| w.uif().clear_bit());
        if *cx.shared.plant_link {
            return;
        }
        let sample = cx.local.latch.latch();
        *cx.local.period = cx.local.period.wrapping_add(1);
        // One that was not taken shows as a gap in the numbers of the periods.
        cx.shared.sample.lock(|last| *last = Some((*cx.local.period, sample)));
        rtic::pend(Interrupt::EXTI0);
    }

    #[task(binds = ADC, priority = 4, local = [current_control])]
    fn currents(cx: currents::Context) {
        cx.local.current_control.on_sample();
    }

    #[task(binds = USART1, priority = 3, local = [usart1])]
    fn usart1(cx: usart1::Context) {
        // The handlers of lines that the board does not use are no part of the image.
        if matches!(ThisBoard::SUPERVISOR, SupervisorLine::Usart1) {
            cx.local.usart1.on_interrupt();
        }
    }

    #[task(binds = USART2, priority = 3, local = [usart2])]
    fn usart2(cx: usart2::Context) {
        if !ThisBoard::HAS_POWER_STAGES {
            cx.local.usart2.on_interrupt();
        }
    }

    #[task(binds = UART4, priority = 3, local = [uart4])]
    fn uart4(cx: uart4::Context) {
        if matches!(ThisBoard::SUPERVISOR, SupervisorLine::Uart4) {
            cx.local.uart4.on_interrupt();
        }
    }

    /// The supply of the microcontroller falls. It does not return.
    #[task(binds = PVD, priority = 7)]
    fn chip_supply(_: chip_supply::Context) {
        crash::end_by_low_supply()
    }

    /// Edges that switch the power stages off, on boards where no timer can, or that signal new data.
    #[task(binds = EXTI2, priority = 6)]
    fn first_edge(_: first_edge::Context) {
        ThisBoard::on_edge();
    }

    #[task(binds = EXTI4, priority = 6)]
    fn second_edge(_: second_edge::Context) {
        ThisBoard::on_edge();
    }

    /// Data of a converter, between two control periods.
    #[task(binds = EXTI3, priority = 2, shared = [board])]
    fn data(mut cx: data::Context) {
        cx.shared.board.lock(|board| board.on_data());
    }

    /// One control period, of the timer or of the plant link.
    #[task(binds = EXTI0, priority = 2, shared = [node, board, sample, plant_statistics, watchdog, &plant_link],
           local = [plant, periods: Periods = Periods::new(),
                    background: Background = Background::new(), ticks_in])]
    fn control(mut cx: control::Context) {
        let ticks = cx.local.ticks_in;
        if *cx.shared.plant_link {
            while let Some(result) = cx.local.plant.receive::<SensorFrame>() {
                if let Ok(sensors) = result {
                    let actuators = cx.shared.node.lock(|node| tick(node, sensors, ticks));
                    cx.local.plant.send(&actuators);
                    cx.local.plant.flush();
                }
            }
            let statistics = cx.local.plant.statistics();
            cx.shared.plant_statistics.lock(|shared| *shared = statistics);
            return;
        }
        let Some((period, sample)) = cx.shared.sample.lock(Option::take) else { return };
        let periods = cx.local.periods;
        let healthy = (cx.shared.board, cx.shared.node).lock(|board, node| {
            periods.run(board, node, period, &sample, |node, sensors| tick(node, sensors, ticks))
        });
        if cx.local.background.is_alive() && healthy {
            cx.shared.watchdog.lock(|watchdog| watchdog.feed());
        }
    }

    fn tick(node: &mut Node, sensors: SensorFrame, log: &mut Producer<'static, TickLog>) -> ActuatorFrame {
        let before = node.faults().total;
        let actuators = node.tick(&sensors);
        retain_later(node, before);
        let logged = node.is_logged();
        // The second condition always holds; it tells the compiler that the size, by which the queue divides,
        // is not zero.
        if logged && log.capacity() < TICK_LOGS {
            // If the queue is full, the gap in the indices tells the receiver how many entries are missing.
            let _ = log.enqueue((node.records(), sensors, actuators.clone()));
        }
        if logged || Stream::ALL.into_iter().any(|stream| node.is_due(stream)) {
            rtic::pend(Interrupt::EXTI1);
        }
        actuators
    }

    /// Retains the fault log if there are more faults than `before`. The node is the shared one, locked.
    fn retain_later(node: &Node, before: u32) {
        if node.faults().total != before {
            // SAFETY: whoever calls this holds the lock of the node, so there is only one at a time.
            unsafe { retained::retain_faults(node.faults(), node.fault_joints()) };
        }
    }

    /// Requests, telemetry and log.
    #[task(binds = EXTI1, priority = 1, shared = [node, board, plant_statistics],
           local = [supervisor, status, ticks_out, sent_tick: Option<u32> = None])]
    fn supervisor(mut cx: supervisor::Context) {
        let link = cx.local.supervisor;
        let ticks = cx.local.ticks_out;
        let status = &mut *cx.local.status;
        let refresh = |status: &mut BoardStatus, link: &Endpoint, plant| {
            (status.supervisor_link, status.plant) = (link.statistics(), plant);
            (status.stack_used, status.stack_size) = stack::usage();
        };
        let mut handled = 0;
        while handled < REQUESTS
            && let Some(result) = link.receive::<RequestFrame>()
        {
            handled += 1;
            tell_alive();
            if let Ok(request) = result {
                let plant = cx.shared.plant_statistics.lock(|statistics| *statistics);
                refresh(status, link, plant);
                let mut both = (&mut cx.shared.node, &mut cx.shared.board);
                let (reply, index, logged) = both.lock(|node, board| {
                    let before = node.faults().total;
                    let reply = node.handle_on(&request, status, &mut |model| board.configure(model));
                    retain_later(node, before);
                    (reply, node.records(), node.is_logged())
                });
                link.send(&FromBoard::Reply(reply));
                if logged {
                    send_ticks(link, ticks, index);
                    send_log(link, index, LogRecord::Request(request));
                }
                link.flush();
            }
        }
        if handled == REQUESTS {
            rtic::pend(Interrupt::EXTI1);
        }
        if cx.shared.node.lock(|node| node.is_due(Stream::Status)) {
            let plant = cx.shared.plant_statistics.lock(|statistics| *statistics);
            refresh(status, link, plant);
        }
        // Sends all streams of a tick together, and each tick once.
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
        link.flush();
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
