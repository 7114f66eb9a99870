//! Tests that require the emulated board. Prints one line per test, then `N passed, N failed`.

#![no_std]
#![no_main]

use core::mem::MaybeUninit;
use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::peripheral::SCB;
use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::{entry, exception};
use cortex_m_semihosting::{debug, hprintln};
use tesaki::control::ServoMode;
use tesaki::fault::{Fault, FaultCause, FaultLog};
use tesaki::math;
use tesaki::model::{Field, ModelError, Problem, RobotModel};
use tesaki::node::Node;
use tesaki::protocol::codec::{MAX_FRAME, Outgoing, checksum};
use tesaki::protocol::{ActuatorFrame, ClockSource, Request, SensorFrame};
use tesaki::task::TaskConfig;
use tesaki::test_support::FORCE_SENSOR;
use tesaki_firmware::board::{Board, Equipment, Latch, NoCurrents, Peripherals, SupervisorLine};
use tesaki_firmware::clock::{bring_up, frequency};
use tesaki_firmware::control::Periods;
use tesaki_firmware::link::{RECEIVE_QUEUE, SEND_QUEUE, Storage, Uart};
use tesaki_firmware::pac::{Interrupt, flash, rcc};
use tesaki_firmware::retained::{Crash, Record, Word};
use tesaki_firmware::{retained, stack};

mod support;

/// Checksum of the joints of the retained faults.
const JOINTS: u32 = 0xf0e1_d2c3;

/// Name of a test, and its function.
type Test = (&'static str, fn() -> bool);

#[entry]
fn main() -> ! {
    // SAFETY: no interrupt is enabled yet.
    unsafe { stack::paint() };
    // The tests of retained memory need a reset: the second start checks what the first one retained.
    let second_start = retained_faults().is_some_and(|(log, _)| log.total == 2 && log.faults.len() == 2);
    if !second_start {
        let mut log = FaultLog::new();
        log.record(fault(FaultCause::EncoderJump, Some(4), 0.25));
        log.record(fault(FaultCause::CommandTimeout, None, 0.11));
        retain_faults(&log, JOINTS);
        let words = [
            Word::Text("a message of "),
            Word::Decimal(120),
            Word::Text(", "),
            Word::Decimal(0),
            Word::Text(", "),
            Word::Decimal(u32::MAX),
            Word::Text(" and "),
            Word::Hexadecimal(0x01AF_0009),
            Word::Text(", and of more than fits into the place that is kept for the last words"),
        ];
        // SAFETY: this program has no interrupt that uses the memory.
        unsafe { retained::retain_crash(FaultCause::Panic, 77, &words) };
        SCB::sys_reset();
    }
    let tests: &[Test] = &[
        ("faults survive a reset", faults_survive),
        ("the message of a crash survives a reset, truncated, and is returned once", crash_message_survives),
        ("sine and cosine have the bits that the host computed", sine_has_the_hosts_bits),
        ("square root and arc tangent have the bits that the host computed", libm_has_the_hosts_bits),
        ("memory is copied and cleared, and nothing beside it", memory_is_copied_and_cleared),
        ("memory that overlaps is moved", overlapping_memory_is_moved),
        ("the checksum is CRC-32", || checksum(b"123456789") == 0xcbf4_3926),
        ("a full receive queue counts what it loses", overflow_is_counted),
        ("noise on the line is counted", noise_is_counted),
        ("a frame that does not fit is not sent in part", no_partial_frames),
        ("the stack's use is measured, a part at a time", stack_is_measured),
        ("a record of another layout is not read", other_layouts_are_not_read),
        ("the longest fault log is retained", longest_log_is_retained),
        ("retaining the faults keeps no interrupt waiting", interrupts_are_not_kept_off),
        (
            "the watchdog is fed unless a period is late, or its sensors are silent after the outputs were on",
            periods_feed_the_watchdog_while_healthy,
        ),
        ("a board tells by joint and field what it lacks", equipment_is_checked),
        ("a crystal is measured by the internal oscillator", crystals_are_measured),
        ("only the board's crystal becomes the clock, under supervision", wrong_crystals_are_refused),
    ];
    let mut failed = 0;
    for (name, test) in tests {
        let passed = test();
        hprintln!("test {} ... {}", name, if passed { "ok" } else { "FAILED" });
        failed += usize::from(!passed);
    }
    hprintln!("{} passed, {} failed", tests.len() - failed, failed);
    debug::exit(if failed == 0 { debug::EXIT_SUCCESS } else { debug::EXIT_FAILURE });
    loop {
        cortex_m::asm::nop();
    }
}

fn fault(cause: FaultCause, joint: Option<u8>, value: f32) -> Fault {
    Fault { cause, joint, value, limit: 0.1, tick: 12 }
}

fn retain_faults(log: &FaultLog, joints: u32) {
    // SAFETY: this program has no interrupt that uses the memory.
    unsafe { retained::retain_faults(log, joints) }
}

fn retained_faults() -> Option<(FaultLog, u32)> {
    // SAFETY: this program has no interrupt that uses the memory.
    unsafe { retained::faults() }
}

fn take_crash() -> Option<Crash> {
    // SAFETY: this program has no interrupt that uses the memory.
    unsafe { retained::take_crash() }
}

fn faults_survive() -> bool {
    retained_faults().is_some_and(|(log, joints)| {
        joints == JOINTS
            && log.faults[0] == fault(FaultCause::EncoderJump, Some(4), 0.25)
            && log.faults[1] == fault(FaultCause::CommandTimeout, None, 0.11)
    })
}

fn crash_message_survives() -> bool {
    let Some(crash) = take_crash() else { return false };
    let start = "a message of 120, 0, 4294967295 and 0x01af0009, and of more than fits";
    crash.cause == FaultCause::Panic
        && crash.place == 77
        && crash.text.starts_with(start)
        && crash.text.len() == retained::MAX_TEXT
        && take_crash().is_none()
}

unsafe extern "C" {
    fn __aeabi_memcpy4(to: *mut u8, from: *const u8, bytes: usize);
    fn __aeabi_memcpy8(to: *mut u8, from: *const u8, bytes: usize);
    fn __aeabi_memclr4(at: *mut u8, bytes: usize);
    fn __aeabi_memclr8(at: *mut u8, bytes: usize);
    fn __aeabi_memmove4(to: *mut u8, from: *const u8, bytes: usize);
    fn __aeabi_memmove8(to: *mut u8, from: *const u8, bytes: usize);
}

/// Bytes as the compiler's memory functions expect them.
#[repr(align(8))]
struct Aligned([u8; 80]);

fn memory_is_copied_and_cleared() -> bool {
    let from = Aligned(core::array::from_fn(|index| index as u8 + 1));
    (0..=72).all(|bytes| {
        let is_copied = [__aeabi_memcpy4, __aeabi_memcpy8].into_iter().all(|copy| {
            let mut to = Aligned([0xA5; 80]);
            // SAFETY: both are aligned, and longer than `bytes`.
            unsafe { copy(to.0.as_mut_ptr(), from.0.as_ptr(), bytes) };
            to.0[..bytes] == from.0[..bytes] && to.0[bytes..].iter().all(|&byte| byte == 0xA5)
        });
        let is_cleared = [__aeabi_memclr4, __aeabi_memclr8].into_iter().all(|clear| {
            let mut at = Aligned([0xA5; 80]);
            // SAFETY: it is aligned, and longer than `bytes`.
            unsafe { clear(at.0.as_mut_ptr(), bytes) };
            at.0[..bytes].iter().all(|&byte| byte == 0) && at.0[bytes..].iter().all(|&byte| byte == 0xA5)
        });
        is_copied && is_cleared
    })
}

fn overlapping_memory_is_moved() -> bool {
    let before: [u8; 80] = core::array::from_fn(|index| index as u8 + 1);
    let places = || (0..=40).step_by(8);
    (0..=40).all(|bytes| {
        places().flat_map(|to| places().map(move |from| (to, from))).all(|(to, from)| {
            [__aeabi_memmove4, __aeabi_memmove8].into_iter().all(|move_bytes| {
                let mut memory = Aligned(before);
                let start = memory.0.as_mut_ptr();
                // SAFETY: both places are aligned, and `bytes` from them on lie in the memory.
                unsafe { move_bytes(start.add(to), start.add(from), bytes) };
                let expected = |place: usize| {
                    before[if (to..to + bytes).contains(&place) { place - to + from } else { place }]
                };
                (0..80).all(|place| memory.0[place] == expected(place))
            })
        })
    })
}

fn sine_has_the_hosts_bits() -> bool {
    sine_hash() == SINE_HASH
}

fn libm_has_the_hosts_bits() -> bool {
    math_hash() == MATH_HASH
}

include!("../../../tests/target_bits.in");

/// A simulated UART that receives one byte repeatedly and is never ready to send.
struct FakeUart {
    next: u8,
    lost: bool,
}

impl Uart for FakeUart {
    const INTERRUPT: Interrupt = Interrupt::USART3;

    fn start(&self, _clock: u32, _baud: u32) {}
    fn receive(&mut self) -> (Option<u8>, bool) {
        (Some(self.next), self.lost)
    }
    fn ready(&self) -> bool {
        false
    }
    fn send(&mut self, _byte: u8) {}
    fn interrupt_when_ready(&mut self, _enabled: bool) {}
}

macro_rules! link {
    ($script:expr) => {{
        static mut STORAGE: Storage = Storage::new();
        // SAFETY: each test has a storage of its own and runs once.
        unsafe { &mut *core::ptr::addr_of_mut!(STORAGE) }.split($script, Interrupt::EXTI0)
    }};
}

fn overflow_is_counted() -> bool {
    let (mut isr, endpoint) = link!(FakeUart { next: 7, lost: false });
    for _ in 0..RECEIVE_QUEUE + 9 {
        isr.on_interrupt();
    }
    endpoint.statistics().receive_overflow == 10
}

fn noise_is_counted() -> bool {
    let (mut isr, mut endpoint) = link!(FakeUart { next: 0, lost: true });
    for _ in 0..3 {
        isr.on_interrupt();
    }
    endpoint.receive::<u8>().is_none() && endpoint.statistics().receive_errors == 3
}

fn no_partial_frames() -> bool {
    let (_isr, mut endpoint) = link!(FakeUart { next: 0, lost: false });
    let torques = core::iter::repeat_n(0.1, 16).collect();
    let message = ActuatorFrame { sequence: u32::MAX, enabled: true, torques };
    let Ok(length) = message.encode(&mut [0; MAX_FRAME]) else { return false };
    // Those that fit into a queue that is not emptied.
    let fitting = (SEND_QUEUE - 1) / length;
    let sent = (0..fitting + 2).filter(|_| endpoint.send(&message)).count();
    sent == fitting && endpoint.statistics().send_overflow == 2
}

fn stack_is_measured() -> bool {
    // Enough calls to scan the whole stack.
    let scan = || (0..60).for_each(|_| stack::scan());
    scan();
    let (before, size) = stack::usage();
    let deep = dig(80);
    let unseen = stack::usage() == (before, size);
    scan();
    let (after, _) = stack::usage();
    size == 52 * 1024 && unseen && after >= before + 4000 && after < size && deep > 0
}

fn other_layouts_are_not_read() -> bool {
    let Some(record) = Record::<4>::new(&[3, 5], 7) else { return false };
    record.contents(7) == Some(&[3, 5])
        && record.contents(8).is_none()
        && Record::<4>::new(&[0; 5], 7).is_none()
}

fn longest_log_is_retained() -> bool {
    let mut log = FaultLog::new();
    let longest = Fault {
        cause: FaultCause::EncoderJump,
        joint: Some(255),
        value: -1.0,
        limit: f32::MIN_POSITIVE,
        tick: u32::MAX,
    };
    (0..2 * log.faults.capacity()).for_each(|_| log.record(longest));
    log.total = u32::MAX;
    retain_faults(&log, u32::MAX);
    log.faults.is_full() && retained_faults() == Some((log, u32::MAX))
}

/// Longest time from the counter's zero to its interrupt [1/168 MHz].
static LATENCY: AtomicU32 = AtomicU32::new(0);
static INTERRUPTS: AtomicU32 = AtomicU32::new(0);
/// Period of the interrupt: prime, so that it meets every instruction of a repeated call.
const PERIOD: u32 = 1009;

#[exception]
fn SysTick() {
    INTERRUPTS.fetch_add(1, Ordering::Relaxed);
    LATENCY.fetch_max(PERIOD - SYST::get_current(), Ordering::Relaxed);
}

fn interrupts_are_not_kept_off() -> bool {
    // SAFETY: no other code of this program uses the timer.
    let mut timer = unsafe { cortex_m::Peripherals::steal() }.SYST;
    let mut log = FaultLog::new();
    (0..16).for_each(|_| log.record(fault(FaultCause::EncoderJump, Some(4), 0.25)));
    timer.set_clock_source(SystClkSource::Core);
    timer.set_reload(PERIOD);
    timer.clear_current();
    timer.enable_interrupt();
    timer.enable_counter();
    (0..500).for_each(|_| retain_faults(&log, JOINTS));
    timer.disable_interrupt();
    timer.disable_counter();
    let instructions = LATENCY.load(Ordering::Relaxed) * 1000 / 168;
    hprintln!("     interrupts were off for at most {} instructions", instructions);
    // The handler itself takes some before it reads the counter.
    INTERRUPTS.load(Ordering::Relaxed) > 100 && instructions < 20
}

/// A board whose sensors can fall silent.
struct FakeBoard {
    silent: bool,
    enabled: bool,
}

static OFF: AtomicBool = AtomicBool::new(false);

impl Board for FakeBoard {
    const CRYSTAL: u32 = 8_000_000;
    const HAS_POWER_STAGES: bool = true;
    const SUPERVISOR: SupervisorLine = SupervisorLine::Usart1;
    type Latch = FakeLatch;
    type CurrentControl = NoCurrents;

    fn start(_: Peripherals<'_>) -> (Self, FakeLatch, NoCurrents) {
        (Self { silent: false, enabled: false }, FakeLatch, NoCurrents)
    }
    fn configure(&mut self, _: &RobotModel) -> Result<(), ModelError> {
        Ok(())
    }
    fn read(&mut self, period: u32, (): &()) -> Option<SensorFrame> {
        let sensors = support::sensors(period);
        (!self.silent).then_some(sensors)
    }
    fn write(&mut self, actuators: &ActuatorFrame) {
        self.enabled = actuators.enabled;
    }
    fn off() {
        OFF.store(true, Ordering::Relaxed);
    }
}

struct FakeLatch;

impl Latch for FakeLatch {
    type Sample = ();
    fn latch(&mut self) {}
}

fn periods_feed_the_watchdog_while_healthy() -> bool {
    static mut NODE: Node = Node::new();
    // SAFETY: this test runs once.
    let node = unsafe { &mut *core::ptr::addr_of_mut!(NODE) };
    let (mut board, mut periods) = (FakeBoard { silent: false, enabled: false }, Periods::new());
    let mut run = |board: &mut FakeBoard, node: &mut Node, period| {
        let healthy = periods.run(board, node, period, &(), |node, sensors| node.tick(&sensors));
        (healthy, board.enabled, node.faults().faults.last().map(|fault| fault.cause))
    };
    board.silent = true;
    let mut passed = run(&mut board, node, 1) == (true, false, None);
    support::push(node, &support::hand());
    // Without sensors nothing moves: a stop is a fault, and the board keeps its model and waits to be asked.
    passed &= run(&mut board, node, 2) == (true, false, None);
    support::ask(node, &mut 90, Request::Stop);
    passed &= run(&mut board, node, 3) == (true, false, Some(FaultCause::Stop));
    board.silent = false;
    support::ask(node, &mut 91, Request::ReadFaults);
    support::ask(node, &mut 92, Request::ClearFaults { total: 1 });
    passed &= run(&mut board, node, 4) == (true, false, Some(FaultCause::Stop));
    support::enable(node, TaskConfig::JointServo(ServoMode::Pid));
    passed &= run(&mut board, node, 5) == (true, true, Some(FaultCause::Stop));
    passed &= run(&mut board, node, 8) == (false, true, Some(FaultCause::LateTick));
    passed &= run(&mut board, node, 9) == (true, true, Some(FaultCause::LateTick));
    board.silent = true;
    OFF.store(false, Ordering::Relaxed);
    passed &= run(&mut board, node, 10) == (false, false, Some(FaultCause::SensorsSilent));
    // The joints may still move.
    support::ask(node, &mut 110, Request::Disable);
    passed &= run(&mut board, node, 11) == (false, false, Some(FaultCause::SensorsSilent));
    support::ask(node, &mut 111, Request::ReadFaults);
    support::ask(node, &mut 112, Request::ClearFaults { total: 3 });
    passed &= run(&mut board, node, 12) == (true, false, Some(FaultCause::SensorsSilent));
    passed && OFF.load(Ordering::Relaxed)
}

fn equipment_is_checked() -> bool {
    let equipment = Equipment {
        motors: 9,
        absolute_encoders: true,
        count_rate: 1e6,
        force_sensors: 0,
        current: 1.4,
        supply: 28.0,
    };
    let refused = |equipment: Equipment, change: fn(&mut RobotModel)| {
        let mut model = support::hand();
        change(&mut model);
        equipment.check(&model).err().map(|error| (error.joint, error.field, error.problem))
    };
    let sensor = |model: &mut RobotModel| {
        model.chains[1].force_sensor = Some(FORCE_SENSOR);
    };
    let unchanged = |_: &mut RobotModel| {};
    refused(equipment, unchanged).is_none()
        && refused(Equipment { motors: 3, ..equipment }, unchanged)
            == Some((Some(3), Field::Joints, Problem::BoardLimit(3.0)))
        && refused(Equipment { count_rate: 1e4, ..equipment }, unchanged)
            .is_some_and(|(joint, field, _)| (joint, field) == (Some(0), Field::CountsPerTurn))
        && refused(Equipment { absolute_encoders: false, ..equipment }, |model| {
            model.joints[0].encoder.relative = true;
        }) == Some((Some(1), Field::EncoderRelative, Problem::NotSupported))
        && refused(equipment, |model| model.joints[4].motor.current_limit = 1.5)
            == Some((Some(4), Field::CurrentLimit, Problem::BoardLimit(1.4)))
        && refused(equipment, sensor) == Some((Some(5), Field::ForceResolution, Problem::BoardLimit(0.0)))
        && refused(Equipment { supply: 27.0, ..equipment }, unchanged)
            == Some((None, Field::SupplyMax, Problem::BoardLimit(27.0)))
}

/// 16 intervals of 128 periods: with 8 MHz 256 µs, in which the internal oscillator counts to 4096.
fn crystals_are_measured() -> bool {
    // 12 MHz: 170.67 µs, 2730.67 counts; 25 MHz: 81.92 µs, 1310.7 counts.
    frequency(4096) == Some(8_000_000)
        && frequency(2731).is_some_and(|measured| measured.abs_diff(12_000_000) < 2_000)
        && frequency(1311).is_some_and(|measured| measured.abs_diff(25_000_000) < 6_000)
        && frequency(0).is_none()
}

fn wrong_crystals_are_refused() -> bool {
    const CRYSTAL_READY: u32 = 1 << 17;
    const CRYSTAL_ON: u32 = 1 << 16;
    const SUPERVISED: u32 = 1 << 19;
    const PLL_READY: u32 = 1 << 25;
    const FROM_CRYSTAL: u32 = 1 << 22;
    /// Returns what a chip with such oscillators ends up with: source, refused crystal, CR, PLLCFGR.
    fn end(ready: u32, crystal: u32, measured: Option<u32>) -> (ClockSource, Option<u32>, u32, u32) {
        // SAFETY: registers in ordinary memory; all their bits may be zero.
        let (rcc, flash) = unsafe {
            (
                MaybeUninit::<rcc::RegisterBlock>::zeroed().assume_init(),
                MaybeUninit::<flash::RegisterBlock>::zeroed().assume_init(),
            )
        };
        // SAFETY: as above. The system clock follows the PLL at once.
        unsafe {
            rcc.cr().write(|w| w.bits(ready));
            rcc.cfgr().write(|w| w.bits(0b1000));
        }
        let clocks = bring_up(&rcc, &flash, crystal, || measured);
        (clocks.source, clocks.wrong_crystal, rcc.cr().read().bits(), rcc.pllcfgr().read().bits())
    }
    let divider = |pll: u32| pll & 0x3F;
    let (source, wrong, control, pll) = end(CRYSTAL_READY | PLL_READY, 8_000_000, Some(8_200_000));
    let right = (source, wrong) == (ClockSource::Crystal, None)
        && control & (CRYSTAL_ON | SUPERVISED) == CRYSTAL_ON | SUPERVISED
        && (divider(pll), pll & FROM_CRYSTAL) == (8, FROM_CRYSTAL);
    let (source, _, _, pll) = end(CRYSTAL_READY | PLL_READY, 12_000_000, Some(11_900_000));
    let other = source == ClockSource::Crystal && divider(pll) == 12;
    let refused = [(Some(12_000_000), 12_000_000), (Some(7_100_000), 7_100_000), (None, 0)];
    let refused = refused.into_iter().all(|(measured, told)| {
        let (source, wrong, control, pll) = end(CRYSTAL_READY | PLL_READY, 8_000_000, measured);
        (source, wrong) == (ClockSource::InternalPll, Some(told))
            && control & (CRYSTAL_ON | SUPERVISED) == 0
            && (divider(pll), pll & FROM_CRYSTAL) == (16, 0)
    });
    let none = end(PLL_READY, 8_000_000, Some(8_000_000));
    let neither = end(0, 8_000_000, None);
    right
        && other
        && refused
        && (none.0, none.1) == (ClockSource::InternalPll, None)
        && (neither.0, neither.1) == (ClockSource::Internal, None)
}

#[inline(never)]
fn dig(depth: u32) -> u32 {
    let room = core::hint::black_box([depth; 32]);
    if depth == 0 { room[0] + 1 } else { dig(depth - 1) + room[3] }
}
