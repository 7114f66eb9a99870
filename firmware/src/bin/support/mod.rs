//! Panic handler and robot model of the on-target programs.
#![allow(dead_code, reason = "each program uses its part")]

use core::panic::PanicInfo;

use cortex_m_semihosting::{debug, hprintln};
use heapless::Vec;
use tesaki::model::{
    ChainModel, Inertial, JointLimits, JointModel, Motor, ObserverGains, PidGains, Pose, Reaction,
    RobotModel, Safety, ServoGains,
};
use tesaki::node::Node;
use tesaki::protocol::codec::checksum;
use tesaki::protocol::{
    BoardStatus, MODEL_CHUNK, Reply, Request, RequestFrame, SCHEMA_KEY, SensorFlags, SensorFrame,
};
use tesaki::task::TaskConfig;

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    hprintln!("panicked: {}", info);
    debug::exit(debug::EXIT_FAILURE);
    loop {
        cortex_m::asm::nop();
    }
}

/// Returns a joint of the hand; axes alternate.
pub fn joint(index: usize) -> JointModel {
    const NAMES: [&str; 9] = ["j0", "j1", "j2", "j3", "j4", "j5", "j6", "j7", "j8"];
    let typical = tesaki::test_support::joint(NAMES[index]);
    JointModel {
        origin: Pose { translation: [0.01, 0.0, 0.04], ..Pose::IDENTITY },
        axis: if index.is_multiple_of(3) { [0.0, 0.0, 1.0] } else { [0.0, 1.0, 0.0] },
        link: Inertial {
            mass: 0.02,
            center_of_mass: [0.0, 0.0, 0.02],
            inertia: [5e-6, 5e-6, 1e-6, 0.0, 0.0, 0.0],
        },
        motor: Motor { current_limit: 1.4, ..typical.motor },
        limits: JointLimits { torque_rate: 60.0, following_error: 0.5, ..typical.limits },
        servo: ServoGains {
            pid: PidGains { proportional: 0.1, integral: 0.1, derivative: 0.001, ..typical.servo.pid },
            observer: ObserverGains { bandwidth: 20.0, observer_bandwidth: 40.0, ..typical.servo.observer },
            ..typical.servo
        },
        ..typical
    }
}

fn finger(name: &str) -> ChainModel {
    let tip = Pose { translation: [0.0, 0.0, 0.05], ..Pose::IDENTITY };
    ChainModel { name: name.try_into().expect("short"), joints: 3, tip, tip_radius: 0.0, force_sensor: None }
}

/// Returns a hand of three chains of three joints.
pub fn hand() -> RobotModel {
    RobotModel {
        name: "bench".try_into().expect("short"),
        gravity: [-6.9367, 0.0, -6.9367],
        chains: ["tip0", "tip1", "tip2"].into_iter().map(finger).collect(),
        joints: (0..9).map(joint).collect(),
        mimics: Vec::new(),
        gauges: None,
        safety: Safety {
            command_timeout: 10.0,
            reaction: Reaction::Hold,
            damping: 0.01,
            supply_min: 20.0,
            supply_max: 28.0,
        },
    }
}

/// Sends a request, which must not be refused, with the next `sequence` number.
pub fn ask(node: &mut Node, sequence: &mut u16, request: Request) {
    *sequence += 1;
    let frame = RequestFrame { client: 1, sequence: *sequence, request };
    let reply = node.handle(&frame, &BoardStatus::default()).reply;
    assert!(matches!(reply, Reply::Done | Reply::Hello { .. } | Reply::Faults(_)), "refused");
}

/// Takes command of a new node and gives it a model.
pub fn push(node: &mut Node, model: &RobotModel) {
    let mut bytes = [0; 4096];
    push_bytes(node, postcard::to_slice(model, &mut bytes).expect("fits"));
}

/// As [`push`], with the bytes of the model as they are sent.
pub fn push_bytes(node: &mut Node, bytes: &[u8]) {
    let sequence = &mut 0;
    ask(node, sequence, Request::Hello { schema: SCHEMA_KEY });
    ask(node, sequence, Request::TakeCommand { by_force: false });
    ask(node, sequence, Request::ModelBegin { length: bytes.len() as u32, checksum: checksum(bytes) });
    for (index, data) in bytes.chunks(MODEL_CHUNK).enumerate() {
        let data = Vec::from_slice(data).expect("fits");
        ask(node, sequence, Request::ModelChunk { offset: (index * MODEL_CHUNK) as u32, data });
    }
    ask(node, sequence, Request::ModelCommit);
}

/// Enables a node that has a model and was ticked.
pub fn enable(node: &mut Node, task: TaskConfig) {
    ask(node, &mut 100, Request::Enable(task));
}

/// Returns the sensors of [`hand`] at rest.
pub fn sensors(sequence: u32) -> SensorFrame {
    SensorFrame {
        sequence,
        flags: SensorFlags(0),
        supply: 24_000,
        encoders: [0; 9].into_iter().collect(),
        currents: [0; 9].into_iter().collect(),
        forces: Vec::new(),
    }
}
