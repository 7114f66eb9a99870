//! Executed instructions of the core's hot paths, on the emulated Cortex-M4F with `-icount shift=0`: one
//! instruction is one nanosecond, and SysTick counts at 168 MHz. Prints `name instructions`, one per line.

#![no_std]
#![no_main]

use core::hint::black_box;

use cortex_m::peripheral::SYST;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::entry;
use cortex_m_semihosting::{debug, hprintln};
use heapless::Vec;
use nalgebra::{Vector3, Vector6};
use tesaki::control::{
    CurrentLoop, CurrentLoopState, JointPoint, Pid, PidState, ServoMode, StageCommand, Switching, Winding,
};
use tesaki::grasp::{Contact, GraspMap, GripError, GripState, LeastGrip};
use tesaki::kinematics::{Angles, Chain, Finger, FingerError, FingerSolutions, Hand};
use tesaki::math;
use tesaki::model::{PidGains, Pose};
use tesaki::node::Node;
use tesaki::protocol::codec::{Decoder, MAX_FRAME, Outgoing};
use tesaki::protocol::{FromBoard, JointTelemetry, Mode, Request, SensorFrame, Telemetry};
use tesaki::robot::Robot;
use tesaki::signal::{TrajectoryFilter, TrajectoryState};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::telexistence::{
    FingertipPoint, FingertipSample, TelexistenceCommand, TelexistenceSettings,
};
use tesaki::task::{TaskCommand, TaskConfig};
use tesaki::teleop::{OperatorFingertips, RetargetSettings, Retargeting};
use tesaki::test_support::hand5;
use tesaki_firmware as _;

mod support;

/// Calls per measurement. The command timeout of the model is longer than this many ticks.
const CALLS: u32 = 200;

/// Counts of an encoder of robots/inspire in a turn of the joint.
const COUNTS: f32 = 454_656.0;

/// SysTick counts down in 24 bits: a run must be shorter than 0.1 s of virtual time.
struct Stopwatch(SYST);

impl Stopwatch {
    /// Prints the executed instructions of one call of `body`, on average; the loop around it is not counted.
    fn measure(&mut self, name: &str, body: impl FnMut(f32)) {
        self.compare(name, body, |x| {
            black_box(x);
        });
    }

    /// Prints by how many executed instructions a call of `body` exceeds one of `baseline`. If the baseline
    /// calls an empty function in the same way, the difference is that of the function alone.
    fn compare(&mut self, name: &str, mut body: impl FnMut(f32), mut baseline: impl FnMut(f32)) {
        let empty = self.run(&mut baseline);
        let full = self.run(&mut body);
        let ticks = f64::from(full) - f64::from(empty);
        // Tenths, in whole numbers: formatting floats would need its own library.
        let tenths = (ticks * 1000.0 / 168.0 / f64::from(CALLS) * 10.0 + 0.5) as u32;
        hprintln!("{} {}.{}", name, tenths / 10, tenths % 10);
    }

    #[inline(never)]
    fn run(&mut self, body: &mut dyn FnMut(f32)) -> u32 {
        self.0.clear_current();
        let start = SYST::get_current();
        for call in 0..CALLS {
            body(black_box(0.001 * call as f32));
        }
        since(start)
    }
}

#[inline(never)]
fn pid_step(pid: &Pid, state: &mut PidState, reference: &JointPoint, measured: f32) -> f32 {
    let requested = pid.output(state, reference, measured);
    let applied = math::clamp(requested, -0.6, 0.6);
    pid.integrate(state, requested, applied, false);
    applied
}

/// An empty function with the signature of [`pid_step`]: the baseline of its measurement; likewise below.
#[inline(never)]
fn no_pid(pid: &Pid, state: &mut PidState, reference: &JointPoint, measured: f32) -> f32 {
    // SAFETY: an empty statement that the compiler must take for a use of all arguments.
    unsafe { core::arch::asm!("", in("r0") pid, in("r1") state, in("r2") reference, options(nostack)) };
    measured
}

#[inline(never)]
fn no_filter(filter: &TrajectoryFilter, state: &mut TrajectoryState, input: f32) -> f32 {
    // SAFETY: as above.
    unsafe { core::arch::asm!("", in("r0") filter, in("r1") state, options(nostack)) };
    input
}

#[inline(never)]
fn no_inverse(_: &Vector3<f32>, near: &[f32; 3]) -> Result<FingerSolutions, FingerError> {
    Ok(core::iter::once(*near).collect())
}

#[inline(never)]
fn no_nearest(_: &Vector3<f32>, near: &[f32; 3]) -> Result<[f32; 3], FingerError> {
    Ok(*near)
}

#[inline(never)]
fn no_sin_cos(x: f32) -> (f32, f32) {
    (x, x)
}

#[inline(never)]
fn filter_step(filter: &TrajectoryFilter, state: &mut TrajectoryState, input: f32) -> f32 {
    filter.update(state, input)
}

#[inline(never)]
fn sin_cos(x: f32) -> (f32, f32) {
    math::sin_cos(x)
}

#[entry]
fn main() -> ! {
    let mut systick = cortex_m::Peripherals::take().expect("taken once").SYST;
    systick.set_clock_source(SystClkSource::Core);
    systick.set_reload(0xFF_FFFF);
    systick.clear_current();
    systick.enable_counter();
    let mut watch = Stopwatch(systick);

    kernels(&mut watch);
    grasp(&mut watch);
    slices();
    follow_hand5();
    codec(&mut watch);

    // The RAM has no room for two nodes, nor the stack for one: the next ones are copied from flash.
    static mut NODE: Node = Node::new();
    static NEW: Node = Node::new();
    // SAFETY: the only reference, in the only thread.
    let node = unsafe { &mut *core::ptr::addr_of_mut!(NODE) };
    tick(&mut watch, node, "node_tick_9_pid", ServoMode::Pid);
    // SAFETY: both are whole nodes, and a node owns nothing outside itself.
    unsafe { core::ptr::copy_nonoverlapping(&NEW, node, 1) };
    tick(&mut watch, node, "node_tick_9_observer", ServoMode::Observer);
    // SAFETY: as above.
    unsafe { core::ptr::copy_nonoverlapping(&NEW, node, 1) };
    mimics(node);
    debug::exit(debug::EXIT_SUCCESS);
    loop {
        cortex_m::asm::nop();
    }
}

/// Measures control, dynamics and kinematics of a few joints.
///
/// Not inlined, so that its stack is free again when the node runs.
#[inline(never)]
fn kernels(watch: &mut Stopwatch) {
    let pid =
        Pid::new(black_box(&PidGains { proportional: 0.4, integral: 1.0, derivative: 0.01, cutoff: 30.0 }));
    let mut pid_state = PidState::at(0.0);
    let reference = black_box(JointPoint { position: 0.3, velocity: 0.1, acceleration: 0.0 });
    let mut idle_state = PidState::at(0.0);
    watch.compare(
        "pid",
        |x| {
            black_box(pid_step(&pid, &mut pid_state, &reference, x));
        },
        |x| {
            black_box(no_pid(&pid, &mut idle_state, &reference, x));
        },
    );
    let filter = TrajectoryFilter::new(black_box(0.2));
    let mut filter_state = TrajectoryState::at(0.0);
    let mut idle_state = TrajectoryState::at(0.0);
    watch.compare(
        "trajectory_filter",
        |x| {
            black_box(filter_step(&filter, &mut filter_state, x));
        },
        |x| {
            black_box(no_filter(&filter, &mut idle_state, x));
        },
    );
    watch.compare(
        "sin_cos",
        |x| {
            black_box(sin_cos(x * 20.0 - 2.0));
        },
        |x| {
            black_box(no_sin_cos(x * 20.0 - 2.0));
        },
    );

    let winding = Winding { resistance: 2.32, inductance: 0.24e-3, back_emf: 0.0234 };
    let switching = Switching { period: 25e-6, lag: 1.0, pulses: 1, resolution: 2000, max_duty: 0.95 };
    let current_loop = CurrentLoop::try_new(&black_box(winding), &switching).expect("a winding");
    let mut states = [CurrentLoopState::new(); 3];
    watch.measure("current_loop_3", |x| {
        for (state, current) in states.iter_mut().zip([x, -x, 2.0 * x]) {
            state.command(black_box(0.5), 10.0);
            let drive = current_loop.update(state, black_box(current), black_box(24.0));
            assert!(matches!(black_box(drive), StageCommand::Duty(_)));
        }
    });

    for (name, count) in [("inverse_dynamics_3", 3), ("inverse_dynamics_7", 7)] {
        let joints: Vec<_, 7> = (0..count).map(support::joint).collect();
        let chain = Chain::new(&joints, &Pose::IDENTITY);
        let gravity = Vector3::new(-6.9, 0.0, -6.9);
        let mut torques = [0.0; 7];
        watch.measure(name, |x| {
            let (q, qd, qdd) = ([x + 0.1; 7], [x - 0.2; 7], [3.0 * x; 7]);
            chain.inverse_dynamics(&gravity, black_box(&q), &qd, &qdd, &mut torques);
            black_box(&torques);
        });
    }

    let joints: Vec<_, 7> = (0..7).map(support::joint).collect();
    let arm = Chain::new(&joints, &Pose { translation: [0.0, 0.0, 0.1], ..Pose::IDENTITY })
        .with_rotor_inertia(joints.iter().map(|joint| joint.motor.rotor_inertia));
    watch.measure("inverse_dynamics_7_wrench", |x| {
        let (q, qd, qdd) = ([x + 0.1; 7], [x - 0.2; 7], [3.0 * x; 7]);
        let wrench = Vector6::new(1.0, x, 2.0, x, 0.1, 0.2);
        let (gravity, mut torques) = (Vector3::new(-6.9, 0.0, -6.9), [0.0; 7]);
        arm.inverse_dynamics_with_wrench(
            &gravity,
            black_box(&wrench),
            black_box(&q),
            &qd,
            &qdd,
            &mut torques,
        );
        black_box(&torques);
    });
    watch.measure("mass_matrix_7", |x| {
        black_box(arm.mass_matrix(black_box(&[x + 0.1; 7])));
    });
    watch.measure("forward_and_jacobian_7", |x| {
        let posture = arm.posture(black_box(&[x + 0.1; 7]));
        black_box((posture.tip(), &posture.jacobian()));
    });
    watch.measure("forward_7", |x| {
        black_box(arm.posture(black_box(&[x + 0.1; 7])));
    });
    let posture = arm.posture(&[0.3; 7]);
    watch.measure("bias_acceleration_7", |x| {
        black_box(black_box(&posture).bias_acceleration(&[x + 0.1; 7]));
    });

    let joints: Vec<_, 3> = (0..3).map(support::joint).collect();
    let chain = Chain::new(&joints, &Pose { translation: [0.01, 0.0, 0.05], ..Pose::IDENTITY });
    if let Ok(finger) = Finger::try_new(&chain, [(-1.5, 1.5); 3]) {
        let point = chain.posture(&[0.2, 0.4, 1.0]).tip().translation.vector;
        let near = [0.2, 0.4, 0.5];
        let at = |x| black_box(point + Vector3::new(0.02 * x, 0.0, 0.0));
        watch.compare(
            "finger_inverse",
            |x| assert!(black_box(&finger.inverse(&at(x), &near)).is_ok()),
            |x| assert!(black_box(&no_inverse(&at(x), &near)).is_ok()),
        );
        watch.compare(
            "finger_nearest",
            |x| assert!(black_box(&finger.nearest(&at(x), &near)).is_ok()),
            |x| assert!(black_box(&no_nearest(&at(x), &near)).is_ok()),
        );
    }
    watch.measure("atan2", |x| {
        black_box(math::atan2(black_box(x - 0.1), black_box(0.05)));
    });
}

/// Measures encoding and decoding of the largest telemetry.
#[inline(never)]
fn codec(watch: &mut Stopwatch) {
    let joint = |joint| {
        let value = 0.137 + 0.0213 * joint as f32;
        JointTelemetry {
            position: value,
            velocity: -3.1 * value,
            reference: 1.1 * value,
            torque: 0.7 * value,
        }
    };
    let telemetry = FromBoard::Telemetry(Telemetry {
        tick: 123_456,
        mode: Mode::Disabled,
        faults: 3,
        joints: (0..16).map(joint).collect(),
    });
    let mut decoder = Decoder::new();
    let mut frame = [0; MAX_FRAME];
    watch.measure("codec_largest_telemetry", |_| {
        let length = black_box(&telemetry).encode(&mut frame).unwrap_or(0);
        let mut bytes = frame.get(..length).unwrap_or_default();
        let ended = decoder.take(black_box(&mut bytes));
        assert!(ended && black_box(&decoder.message::<FromBoard>()).is_ok(), "not decoded");
    });
}

/// Returns the grasp map of the first `count` of six contacts of a hand whose tips have moved by `x`.
fn held(count: usize, x: f32, friction: f32) -> GraspMap {
    const PLACES: [([f32; 3], [f32; 3]); 6] = [
        ([0.09, 0.04, 0.085], [1.0, 0.1, 0.55]),
        ([0.09, -0.04, 0.083], [1.0, -0.05, 0.6]),
        ([0.15, 0.004, 0.12], [-1.0, 0.05, -0.6]),
        ([0.148, -0.03, 0.115], [-1.0, 0.1, -0.5]),
        ([0.085, 0.002, 0.09], [1.0, 0.0, 0.5]),
        ([0.12, 0.05, 0.1], [0.1, -1.0, 0.0]),
    ];
    let mut moved = Vector3::new(0.01 * x, 0.01 * x, 0.02 * x);
    let mut contacts = Vec::<_, 6>::new();
    for (position, normal) in PLACES.iter().take(count) {
        let position = Vector3::from(*position) + moved;
        let contact = Contact::try_new(position, (*normal).into(), friction, 10.0).expect("a contact");
        contacts.push(contact).expect("six places");
        moved.x = 0.0;
    }
    GraspMap::try_new(&contacts, Vector3::new(0.11, 0.0, 0.1)).expect("a grasp")
}

/// Measures the grasp map, its inverse, and the least grip: with a warm start, a cold start, and when no
/// forces hold the load.
fn grasp(watch: &mut Stopwatch) {
    watch.measure("grasp_map_3", |x| {
        black_box(held(3, black_box(x), 0.6));
    });
    let map = held(3, 0.0, 0.6);
    let load = |x: f32| black_box(Vector6::new(1.0 + x, 0.2 * x, 1.2, 0.01, 0.02 * x - 0.01, 0.0));
    watch.measure("grasp_inverse_3", |x| {
        assert!(black_box(&map.inverse().forces(&load(x))).is_ok());
    });
    watch.measure("internal_forces_3", |_| {
        black_box(&black_box(&map).internal_forces());
    });
    watch.measure("normal_grip_3", |_| {
        let _ = black_box(&black_box(&map).normal_grip(1.0));
    });
    let grip = LeastGrip::try_new(0.1, 0.05).expect("settings");
    // Contacts and load change in each call.
    for (count, warm, cold) in
        [(3, "least_grip_3_warm", "least_grip_3_cold"), (6, "least_grip_6_warm", "least_grip_6_cold")]
    {
        let mut state = GripState::default();
        watch.measure(warm, |x| {
            assert!(black_box(&grip.solve(&held(count, x, 0.6), &load(x), &mut state)).is_ok());
        });
        watch.measure(cold, |x| {
            let mut state = GripState::default();
            assert!(black_box(&grip.solve(&held(count, x, 0.6), &load(x), &mut state)).is_ok());
        });
    }
    // Too slippery; too heavy.
    for (name, friction, weight) in
        [("least_grip_3_infeasible", 0.03, 1.0), ("least_grip_3_too_heavy", 0.6, 20.0)]
    {
        watch.measure(name, |x| {
            let refused = grip.solve(&held(3, x, friction), &(load(x) * weight), &mut GripState::default());
            assert!(matches!(black_box(&refused), Err(GripError::CannotHold(_))));
        });
    }
}

type StoredContact = ([f32; 3], [f32; 3], f32, f32);

/// The grasps of the core's tests: margin, least normal force, load, contacts; the rest does not matter here.
#[allow(clippy::type_complexity)]
const CASES: &[(f32, f32, [f32; 6], &[StoredContact], Option<f32>, bool)] =
    include!("../../../tests/oracles/data/grip.in");

/// Measures the longest slice of the search for the least grip from a cold start: when forces hold the load,
/// when none do, and over all stored grasps by the number of their contacts.
fn slices() {
    let grip = LeastGrip::try_new(0.1, 0.05).expect("settings");
    let load = Vector6::new(1.0, 0.0, 1.2, 0.01, -0.01, 0.0);
    for (name, friction) in [("least_grip_3_slice_cold", 0.6), ("least_grip_3_slice_infeasible", 0.03)] {
        print_slice(name, longest_slice(&grip, &held(3, 0.0, friction), &load));
    }
    let mut worst = [0; 7];
    for (margin, least, load, contacts, ..) in CASES {
        let contacts: Vec<Contact, 6> = contacts
            .iter()
            .map(|&(position, normal, friction, limit)| {
                Contact::try_new(position.into(), normal.into(), friction, limit).expect("a contact")
            })
            .collect();
        let map = GraspMap::try_new(&contacts, Vector3::zeros()).expect("a grasp");
        let grip = LeastGrip::try_new(*margin, *least).expect("settings");
        let ticks = longest_slice(&grip, &map, &Vector6::from(*load));
        if let Some(worst) = worst.get_mut(contacts.len()) {
            *worst = ticks.max(*worst);
        }
    }
    let [_, _, two, three, four, five, six] = worst;
    print_slice("least_grip_2_slice_worst", two);
    print_slice("least_grip_3_slice_worst", three);
    print_slice("least_grip_4_slice_worst", four);
    print_slice("least_grip_5_slice_worst", five);
    print_slice("least_grip_6_slice_worst", six);
}

/// Budget of a call [instructions]: about four steps with three contacts.
const GRIP_BUDGET: u32 = 25_000;

/// Returns the duration of the longest call [ticks of up to 6 instructions].
fn longest_slice(grip: &LeastGrip, map: &GraspMap, load: &Vector6<f32>) -> u32 {
    let (mut state, mut longest) = (GripState::default(), 0);
    loop {
        let start = SYST::get_current();
        let result = grip.advance(map, black_box(load), &mut state, black_box(GRIP_BUDGET));
        longest = longest.max(since(start));
        if !matches!(black_box(&result), Err(GripError::Unfinished { .. })) {
            return longest;
        }
    }
}

fn print_slice(name: &str, ticks: u32) {
    hprintln!("{} {}.0", name, ticks * 1000 / 168);
}

/// Measures retargeting for the hand whose fingers share one motor.
#[inline(never)]
fn follow_hand5() {
    let hand = hand5();
    for (name, size, directions) in [
        ("retarget", 1.0, false),
        ("retarget_unreachable", 1.1, false),
        ("retarget_directions", 1.0, true),
        ("retarget_directions_unreachable", 1.1, true),
    ] {
        retargeting(name, &hand, size, directions, false);
    }
    retargeting("retarget_first_unreachable", &hand, 1.5, false, true);
    retargeting("retarget_first_directions_unreachable", &hand, 1.5, true, true);
}

/// Measures frames of a hand that follows an operator whose moving hand is `size` times as large, with or
/// without the directions of the fingertips: their mean and the longest. If `first`, each frame is the first
/// one, which begins with the hand stretched.
#[inline(never)]
fn retargeting(name: &str, hand: &Hand, size: f32, directions: bool, first: bool) {
    let settings = RetargetSettings { speeds: [1e3; 16], directions, ..RetargetSettings::DEFAULT };
    let retargeting = Retargeting { hand, settings: &settings };
    let begin = |angles: &Angles| retargeting.begin_nearby(angles, &Vector3::zeros());
    let mut state = begin(&hand.center());
    measure_frames(name, |frame| {
        if first {
            state = begin(&Angles::zeros());
        }
        let tips: [_; 5] = tips(hand, frame);
        let operator = OperatorFingertips {
            positions: tips.map(|tip| Some(tip?.0 * size)),
            directions: tips.map(|tip| Some(tip?.1)),
        };
        let start = SYST::get_current();
        let report = retargeting.update(&mut state, black_box(&operator), 0.01);
        let ticks = since(start);
        assert!(black_box(&report).is_ok(), "refused");
        ticks
    });
}

/// Returns position and direction of the fingertips while each joint swings about the middle of its range.
fn tips(hand: &Hand, frame: u16) -> [Option<(Vector3<f32>, Vector3<f32>)>; 5] {
    let mut angles = hand.center();
    for (joint, (angle, (lower, upper))) in (0_u8..).zip(angles.iter_mut().zip(hand.limits())) {
        let phase = (3.0 + 0.1 * f32::from(joint)) * 0.01 * f32::from(frame) + 1.7 * f32::from(joint);
        *angle += 0.35 * (upper - lower) * math::sin_cos(phase).0;
    }
    core::array::from_fn(|finger| hand.tip(finger, &angles))
}

/// Prints the instructions of 500 frames, their mean and the longest; `frame` runs one and returns its ticks.
fn measure_frames(name: &str, mut frame: impl FnMut(u16) -> u32) {
    const FRAMES: u16 = 500;
    let (mut longest, mut sum) = (0, 0);
    for number in 0..FRAMES {
        let ticks = frame(number);
        longest = longest.max(ticks);
        sum += u64::from(ticks);
    }
    let per_frame = (sum * 10_000 / 168 / u64::from(FRAMES)) as u32;
    hprintln!("{} {}.{}", name, per_frame / 10, per_frame % 10);
    hprintln!("{}_longest {}.0", name, u64::from(longest) * 1000 / 168);
}

/// Returns the ticks of SysTick since `start`.
fn since(start: u32) -> u32 {
    start.wrapping_sub(SYST::get_current()) & 0xFF_FFFF
}

/// Measures a hand whose six motors also move six mimic joints: retargeting of a frame, and the tick of a
/// node that follows an operator, retargeting included.
#[inline(never)]
fn mimics(node: &mut Node) {
    /// robots/inspire as it is sent; `tests/tests/telexistence.rs` checks that it is up to date.
    const INSPIRE: &[u8] = include_bytes!("support/inspire.model");
    support::push_bytes(node, INSPIRE);
    let hand = || node.robot().and_then(Robot::hand).expect("a hand");
    for (name, size) in [("retarget_mimics", 1.0), ("retarget_mimics_unreachable", 1.1)] {
        retargeting(name, hand(), size, false, false);
    }
    let center = hand().center();
    let mut sensors = SensorFrame { encoders: [0; 6].into_iter().collect(), ..support::sensors(1) };
    sensors.currents.truncate(6);
    node.tick(&sensors);
    let sequence = &mut 90;
    support::ask(node, sequence, Request::Home { positions: center.iter().take(6).copied().collect() });
    let mut settings = TelexistenceSettings::DEFAULT;
    settings.retargeting.speeds = [2.5; 16];
    support::enable(node, TaskConfig::Telexistence(settings));
    let sequence = &mut 200;
    measure_frames("node_tick_mimics_following", |number| {
        let hand = node.robot().and_then(Robot::hand).expect("a hand");
        let point = |(position, _): (Vector3<f32>, Vector3<f32>)| FingertipPoint {
            position: position.into(),
            velocity: [0.0; 3],
            direction: None,
        };
        let tips = tips(hand, number).map(|tip| tip.map(point));
        let sample = FingertipSample { number, age: 0.0, tips };
        let command = TaskCommand::Telexistence(TelexistenceCommand::Follow(sample));
        support::ask(node, sequence, Request::Task(command));
        // The joints are where their references are.
        sensors.sequence += 1;
        for ((count, joint), center) in sensors.encoders.iter_mut().zip(&node.telemetry().joints).zip(&center)
        {
            *count = ((joint.reference - center) * COUNTS / core::f32::consts::TAU) as i32;
        }
        let start = SYST::get_current();
        black_box(node.tick(black_box(&sensors)));
        since(start)
    });
    assert!(matches!(node.mode(), Mode::Enabled(_)), "the node left its task");
}

/// Measures the tick of a node with three chains of three joints, enabled and in motion.
fn tick(watch: &mut Stopwatch, node: &mut Node, name: &str, mode: ServoMode) {
    support::push(node, &support::hand());
    let mut sensors = support::sensors(1);
    node.tick(&sensors);
    support::enable(node, TaskConfig::JointServo(mode));
    let positions = [0.3; 9].into_iter().collect();
    let goal = Request::Task(TaskCommand::JointServo(JointCommand::Goal { positions }));
    support::ask(node, &mut 200, goal);
    watch.measure(name, |x| {
        sensors.sequence += 1;
        for count in &mut sensors.encoders {
            // Counts that stand still under torque would be a fault.
            *count = (x * 300.0) as i32 + (sensors.sequence % 2) as i32;
        }
        black_box(node.tick(black_box(&sensors)));
    });
    assert!(matches!(node.mode(), Mode::Enabled(_)), "the node left its task");
}
