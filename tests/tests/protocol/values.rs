//! Values of the messages.

use std::collections::BTreeMap;

use tesaki::control::{Impedance, ServoMode};
use tesaki::fault::FaultCause;
use tesaki::model::{
    ChainModel, Encoder, Friction, Inertial, JointLimits, JointModel, MAX_JOINTS, Motor, ObserverGains,
    PidGains, Pose, Reaction, RobotModel, Safety, ServoGains,
};
use tesaki::protocol::codec::FrameCounts;
use tesaki::protocol::{
    ActuatorFrame, BoardStatus, ClockSource, Identity, LinkStatistics, LogRecord, LogStart, Mode, NodeStatus,
    Request, RequestFrame, ResetCause, SensorFlags, SensorFrame, Status,
};
use tesaki::task::TaskKind;
use tesaki::task::grasping::{
    Failure, GraspPlan, GraspTelemetry, InternalForce, JointTargets, LoadSource, ObjectControl, ObjectFrame,
    Phase, PlannedContact, WrenchGains,
};
use tesaki::task::impedance::{ForceSource, ImpedanceSettings, ImpedanceTelemetry, Law, Redundancy};
use tesaki::task::telexistence::{
    FingertipPoint, FingertipSample, TelexistenceSettings, TelexistenceTelemetry,
};
use tesaki::task::visual_approach::{
    GripperSettings, GripperState, HandMotion, VisualApproachSettings, VisualApproachTelemetry,
};
use tesaki::teleop::RetargetSettings;

use super::variants::Variants;

pub const SCHEMA: u64 = 0x0123_4567_89ab_cdef;

/// The key of a state.
pub const STATE: u64 = 0xfedc_ba98_7654_3210;

pub const CLIENT: u32 = 0x00c0_ffee;

pub const IDENTITY: Identity = Identity {
    firmware: [0, 1, 0],
    image: [0x1f, 0x2e, 0x3d, 0x4c, 0x5b, 0x6a, 0x79, 0x88],
    board: [0x30, 0, 0x21, 0, 0x0d, 0x51, 0x36, 0x30, 0x34, 0x33, 0x38, 0x32],
    capabilities: 29,
};

pub const PID: ServoMode = ServoMode::Pid;

pub const OBSERVER: ServoMode = ServoMode::Observer;

pub const TASKS: [(TaskKind, &str); TaskKind::VARIANTS.len()] = [
    (TaskKind::JointServo, "joint-servo"),
    (TaskKind::Grasping, "grasping"),
    (TaskKind::Impedance, "impedance"),
    (TaskKind::Telexistence, "telexistence"),
    (TaskKind::VisualApproach, "visual-approach"),
];

/// Collects into the message's lists, which have a fixed capacity.
pub fn list<T, L: FromIterator<T>>(items: impl IntoIterator<Item = T>) -> L {
    items.into_iter().collect()
}

pub fn finger(reaction: Reaction) -> RobotModel {
    let knuckle = JointModel {
        name: "knuckle".try_into().unwrap(),
        origin: Pose { translation: [0.0, 0.0, 0.1], rotation: [0.0, 0.0, 0.0, 1.0] },
        axis: [0.0, 0.0, 1.0],
        link: Inertial {
            mass: 0.02,
            center_of_mass: [0.02, 0.0, 0.0],
            inertia: [1e-6, 5e-6, 5e-6, 0.0, 0.0, 0.0],
        },
        motor: Motor {
            rotor_inertia: 2e-4,
            torque_constant: 0.5,
            current_limit: 1.5,
            current_resolution: 1e-3,
            bandwidth: 300.0,
            delay: 3e-4,
            resistance: Some(6.0),
            inductance: None,
        },
        friction: Friction { coulomb: 0.02, viscous: 0.002 },
        encoder: Encoder { counts_per_turn: 65536.0, reversed: false, zero: -40, relative: true },
        limits: JointLimits {
            lower: -1.5,
            upper: 1.5,
            velocity: 8.0,
            torque: 0.6,
            torque_rate: 200.0,
            following_error: 0.25,
        },
        servo: ServoGains {
            filter_time: 0.2,
            pid: PidGains { proportional: 0.4, integral: 1.0, derivative: 0.01, cutoff: 30.0 },
            observer: ObserverGains { inertia: 2.1e-4, bandwidth: 50.0, observer_bandwidth: 100.0 },
            rest_error: 5e-4,
        },
    };
    let tip = ChainModel {
        name: "finger_tip".try_into().unwrap(),
        joints: 1,
        tip: Pose { translation: [0.0, 0.0, 0.05], rotation: [0.0, 0.0, 0.0, 1.0] },
        tip_radius: 0.0,
        force_sensor: None,
    };
    RobotModel {
        name: "finger".try_into().unwrap(),
        gravity: [0.0; 3],
        chains: list([tip]),
        joints: list([knuckle]),
        mimics: list([]),
        gauges: None,
        safety: Safety { command_timeout: 0.1, reaction, damping: 0.01, supply_min: 20.0, supply_max: 28.0 },
    }
}

const CONTACTS: [PlannedContact; 3] = [
    PlannedContact { position: [0.0625, 0.04, 0.125], normal: [1.0, 0.0, -0.5] },
    PlannedContact { position: [0.0625, -0.04, 0.125], normal: [1.0, 0.0, -0.5] },
    PlannedContact { position: [0.125, 0.0, 0.0625], normal: [-2.0, 0.0, 1.0] },
];

pub const BOX: GraspPlan = GraspPlan {
    contacts: CONTACTS,
    clearance: 0.01,
    touch_force: 0.1,
    friction: None,
    internal: InternalForce::LeastGrip { margin: 0.2, capacity_at_rest: 0.3, capacity_in_motion: 1.0 },
    force_limit: 9.0,
    feedback: true,
    control: ObjectControl::Differential(ServoMode::Observer),
    object_frame: ObjectFrame::Rolling,
    load: LoadSource::Measured,
    joint_targets: JointTargets::ClosedForm,
};

/// A plan with the longest encoding.
pub const LONGEST: GraspPlan = GraspPlan {
    contacts: [PlannedContact { position: [f32::MIN; 3], normal: [f32::MIN; 3] }; 3],
    clearance: f32::MIN,
    touch_force: f32::MIN,
    friction: Some(f32::MIN),
    internal: InternalForce::Pairwise { strengths: [f32::MIN; 3] },
    force_limit: f32::MIN,
    feedback: true,
    control: ObjectControl::Wrench(WrenchGains {
        position: [f32::MIN; 2],
        orientation: [f32::MIN; 2],
        damping: f32::MIN,
        compensated: true,
    }),
    object_frame: ObjectFrame::Triangle,
    load: LoadSource::Constant { mass: f32::MIN },
    joint_targets: JointTargets::Accumulated,
};

pub const HOLDING: GraspTelemetry = GraspTelemetry {
    phase: Phase::Hold,
    failure: None,
    position: [0.09, 0.0, 0.0625],
    orientation: [0.0, 0.375, 0.0, 0.927],
    load: [0.5, 0.0, 1.75, 0.0, -0.015_625, 0.0],
    target_forces: [[1.0, 0.0, 0.5], [1.0, 0.0, 0.5], [-1.5, 0.0, 0.75]],
    friction: 0.4375,
    slips: 300,
    overloaded: false,
};

pub const NO_GRASP: GraspTelemetry = GraspTelemetry {
    phase: Phase::Ready,
    failure: None,
    position: [0.0; 3],
    orientation: [0.0, 0.0, 0.0, 1.0],
    load: [0.0; 6],
    target_forces: [[0.0; 3]; 3],
    friction: 0.0,
    slips: 0,
    overloaded: false,
};

pub const PHASES: [(Phase, &str); Phase::VARIANTS.len()] = [
    (Phase::Ready, "ready"),
    (Phase::Approach, "approach"),
    (Phase::Touch, "touch"),
    (Phase::Squeeze, "squeeze"),
    (Phase::ProbeFriction, "probe-friction"),
    (Phase::Hold, "hold"),
    (Phase::Move, "move"),
    (Phase::Lower, "lower"),
    (Phase::Open, "open"),
];

pub const FAILURES: [(Failure, &str); Failure::VARIANTS.len()] = [
    (Failure::Obstructed { finger: 2, force: 0.75 }, "obstructed"),
    (Failure::NoObject { finger: 0, distance: 0.02 }, "no-object"),
    (Failure::NoGrip { force: 0.25, limit: 3.0 }, "no-grip"),
    (Failure::NoSupport { distance: 0.05 }, "no-support"),
    (Failure::OutOfReach { finger: 1 }, "out-of-reach"),
];

pub const YIELDING: ImpedanceSettings = ImpedanceSettings {
    impedance: Impedance::diagonal(
        [1.5, 1.5, 1.5, 0.0625, 0.0625, 0.0625],
        [7.5, 7.5, 7.5, 0.5, 0.5, 0.5],
        [300.0, 300.0, 300.0, 8.0, 8.0, 8.0],
    ),
    law: Law::ModelFollowing,
    redundancy: Redundancy::ArmAngle,
    elbow_bandwidth: 12.0,
    force: ForceSource::Sensor,
    contact_force: 1.5,
    max_deviation: [0.25, 1.5],
};

pub const PUSHED: ImpedanceTelemetry = ImpedanceTelemetry {
    position: [0.5, 0.0, -0.25],
    rotation: [0.0, 0.0, 0.0, 1.0],
    error: [0.0625, 0.0, 0.0, 0.0, 0.0, -0.125],
    wrench: [18.75, 0.0, 0.0, 0.0, 0.0, -1.0],
    contact: true,
    sigma_min: 0.15625,
    elbow: 0.25,
    derating: 1.5,
};

pub const FIVE_FINGERS: TelexistenceSettings = TelexistenceSettings {
    retargeting: RetargetSettings {
        follows: [0, 1, 2, 3, 4],
        weights: [1.0; 5],
        scale: 1.25,
        near: 0.0078125,
        far: 0.03125,
        operator_contact: 0.015625,
        robot_contact: 0.0,
        speeds: [4.0; MAX_JOINTS],
        tolerance: 0.000_976_562_5,
        directions: true,
    },
    servo_mode: ServoMode::Observer,
    acceleration: 64.0,
    max_sample_age: 0.25,
};

pub const THUMB_AND_INDEX: FingertipSample = FingertipSample {
    number: 300,
    age: 0.03125,
    tips: [
        Some(FingertipPoint {
            position: [0.0625, -0.125, 0.0],
            velocity: [0.0, 0.5, 0.0],
            direction: Some([1.0, 0.0, 0.0]),
        }),
        Some(FingertipPoint { position: [0.125, 0.0, 0.0625], velocity: [0.0; 3], direction: None }),
        None,
        None,
        None,
    ],
};

pub const REPRODUCED: TelexistenceTelemetry = TelexistenceTelemetry {
    samples: 300,
    ignored: 2,
    age: 1,
    errors: [0.0, 0.001_953_125, 0.0, 0.0, 0.0],
    missed: 2,
    unknown: 28,
    limited: 32,
};

pub const KNOB: VisualApproachSettings = VisualApproachSettings {
    chain: 0,
    gripper: GripperSettings { joint: 6, open: -0.75, closed: 0.25, speed: 2.0, torque: 0.5 },
    servo_mode: ServoMode::Pid,
    speed: 0.125,
    acceleration: 0.5,
    contact_force: 20.0,
    reach: 0.5,
};

const LEVEL: Pose = Pose { translation: [0.75, 0.0, 0.125], rotation: [0.0, 0.5, 0.0, 0.5] };

pub const APPROACHING: VisualApproachTelemetry = VisualApproachTelemetry {
    hand: LEVEL,
    latched: None,
    motion: HandMotion::Moving,
    remaining: 0.0625,
    force: [1.0, 0.0, -2.0],
    gripper: GripperState::Open,
    opening: -0.75,
};

pub const GRIPPING: VisualApproachTelemetry = VisualApproachTelemetry {
    hand: LEVEL,
    latched: Some((300, LEVEL)),
    motion: HandMotion::Standing,
    remaining: 0.0,
    force: [0.0; 3],
    gripper: GripperState::Jammed,
    opening: 0.25,
};

pub const MOTIONS: [(HandMotion, &str); HandMotion::VARIANTS.len()] = [
    (HandMotion::Standing, "standing"),
    (HandMotion::Moving, "moving"),
    (HandMotion::Blocked, "blocked"),
    (HandMotion::Limited, "limited"),
];

pub const GRIPPER_STATES: [(GripperState, &str); GripperState::VARIANTS.len()] = [
    (GripperState::Still, "still"),
    (GripperState::Opening, "opening"),
    (GripperState::Open, "open"),
    (GripperState::Closing, "closing"),
    (GripperState::Holding, "holding"),
    (GripperState::Empty, "empty"),
    (GripperState::Jammed, "jammed"),
];

pub const CAUSES: [FaultCause; FaultCause::VARIANTS.len()] = [
    FaultCause::CommandTimeout,
    FaultCause::PositionLimit,
    FaultCause::VelocityLimit,
    FaultCause::FollowingError,
    FaultCause::EncoderJump,
    FaultCause::EncoderStuck,
    FaultCause::NotFinite,
    FaultCause::LateTick,
    FaultCause::SensorCount,
    FaultCause::EmergencyStop,
    FaultCause::SupplyLow,
    FaultCause::SupplyHigh,
    FaultCause::OverCurrent,
    FaultCause::WatchdogReset,
    FaultCause::Panic,
    FaultCause::HardFault,
    FaultCause::ClockFallback,
    FaultCause::Stop,
    FaultCause::ForceSaturated,
    FaultCause::ForceStuck,
    FaultCause::ForceLimit,
    FaultCause::ObjectLost,
    FaultCause::ObjectMoved,
    FaultCause::ToolPositionError,
    FaultCause::ToolOrientationError,
    FaultCause::Runaway,
    FaultCause::ForceMismatch,
    FaultCause::EnergyGained,
    FaultCause::SensorsSilent,
    FaultCause::CrystalStopped,
    FaultCause::WrongCrystal,
    FaultCause::PowerStage,
    FaultCause::ForceSilent,
    FaultCause::ChipSupplyLow,
    FaultCause::BrownOutResetOff,
];

pub fn quiet_board() -> BoardStatus {
    BoardStatus { identity: IDENTITY, ..BoardStatus::default() }
}

pub fn statuses() -> BTreeMap<&'static str, Status> {
    let nobody = NodeStatus {
        mode: Mode::Disabled,
        model: "".try_into().unwrap(),
        model_checksum: 0,
        homed: 0,
        faults: 0,
        faults_read: true,
        commander: None,
        tick: 0,
        supply: 0.0,
    };
    let fault = NodeStatus {
        mode: Mode::Fault,
        model: "hand3".try_into().unwrap(),
        model_checksum: 0x89ab_cdef,
        homed: 511,
        faults: 18,
        faults_read: false,
        commander: Some(0x00de_cade),
        tick: 100_000,
        supply: 23.5,
    };
    let full = BoardStatus {
        identity: IDENTITY,
        clock: ClockSource::InternalPll,
        reset: ResetCause::Panic,
        last_words: "panicked at src/main.rs:7".try_into().unwrap(),
        stack_used: 2048,
        stack_size: 16384,
        supervisor_link: LinkStatistics {
            frames: FrameCounts { good: 1, overlong: 2, framing: 3, checksum: 4, malformed: 5 },
            receive_overflow: 6,
            receive_errors: 7,
            send_overflow: 8,
        },
        plant: LinkStatistics {
            frames: FrameCounts { good: 128, checksum: 16384, ..FrameCounts::default() },
            send_overflow: u32::MAX,
            ..LinkStatistics::default()
        },
    };
    let board = |clock, reset, words: &str| {
        let last_words = words.try_into().unwrap();
        Status { node: nobody.clone(), board: BoardStatus { clock, reset, last_words, ..quiet_board() } }
    };
    BTreeMap::from([
        ("nothing", board(ClockSource::Crystal, ResetCause::PowerOn, "")),
        ("fault", Status { node: fault, board: full }),
        ("watchdog", board(ClockSource::Internal, ResetCause::Watchdog, "")),
        ("hard-fault", board(ClockSource::Crystal, ResetCause::HardFault, &"w".repeat(96))),
        ("software", board(ClockSource::Crystal, ResetCause::Software, "")),
        ("crystal-stopped", board(ClockSource::InternalPll, ResetCause::CrystalStopped, "")),
        ("brown-out", board(ClockSource::Crystal, ResetCause::BrownOut, "")),
    ])
}

pub fn sensor_frame(
    sequence: u32,
    flags: u8,
    supply: u16,
    encoders: &[i32],
    currents: &[i16],
) -> SensorFrame {
    let (encoders, currents) = (list(encoders.iter().copied()), list(currents.iter().copied()));
    SensorFrame { sequence, flags: SensorFlags(flags), supply, encoders, currents, forces: list([]) }
}

/// A frame with the longest encoding.
pub fn full_sensors() -> SensorFrame {
    let full = sensor_frame(u32::MAX, 255, u16::MAX, &[i32::MIN; 16], &[i16::MIN; 16]);
    SensorFrame { forces: list([[i32::MIN; 6]; 6]), ..full }
}

pub fn records() -> [(&'static str, LogRecord); LogRecord::VARIANTS.len()] {
    let request = RequestFrame { client: CLIENT, sequence: 9, request: Request::Disable };
    let torques = list([0.25, -0.25]);
    [
        ("request", LogRecord::Request(request)),
        ("sensors", LogRecord::Sensors(sensor_frame(1234, 1, 24000, &[100, -100], &[5, -5]))),
        ("actuators", LogRecord::Actuators(ActuatorFrame { sequence: 1234, enabled: true, torques })),
        (
            "start",
            LogRecord::Start(LogStart { schema: SCHEMA, identity: IDENTITY, unix_time: 1_795_000_000 }),
        ),
        ("state", LogRecord::State { offset: 192, data: list([0, 1, 254, 255]) }),
        ("restore", LogRecord::Restore { length: 196, checksum: 0xdead_beef, key: STATE }),
        ("gap", LogRecord::Gap { missing: 300 }),
        ("end", LogRecord::End { ticks: 70_000 }),
    ]
}
