//! Robots for the node, and sensors that read roughly what they should.

use std::f32::consts::TAU;
use std::path::Path;
use std::sync::OnceLock;

use tesaki::kinematics::Chain;
use tesaki::model::RobotModel;
use tesaki::node::Node;
use tesaki::protocol::{BoardStatus, Reply, RequestFrame, SensorFrame};
use tesaki::task::TaskTelemetry;
use tesaki::task::grasping::{GraspPlan, Phase};
use tesaki::task::impedance::ImpedanceSettings;
use tesaki_description::init::{InitOptions, RobotTexts, robot_texts};
use tesaki_description::robot::RobotFolder;
use tesaki_tests::{robot, robot_folder, set_up, zero_sensors};

use super::rig::Rig;

/// A one-joint robot.
pub const MINIMAL_URDF: &str = include_str!("minimal.urdf");

/// A robot with its model in a node that client 1 commands.
pub struct Machine {
    /// The model.
    pub model: RobotModel,
    /// Its postcard encoding.
    pub encoded: Vec<u8>,
    node: Node,
    /// Requests handled so far.
    sequence: u16,
    /// Supply voltage [mV].
    pub supply: u16,
}

/// Returns the texts of the folder of the one-joint robot.
pub fn minimal() -> &'static RobotTexts {
    static TEXTS: OnceLock<RobotTexts> = OnceLock::new();
    TEXTS.get_or_init(|| {
        robot_texts(Path::new("minimal.urdf"), MINIMAL_URDF, &InitOptions::default()).expect("it is a robot")
    })
}

/// Returns hand3, arm7, and the one-joint robot.
pub fn machines() -> &'static [Machine; 3] {
    static MACHINES: OnceLock<[Machine; 3]> = OnceLock::new();
    MACHINES.get_or_init(|| {
        let texts = minimal();
        let minimal = RobotFolder::parse(Path::new("minimal"), &texts.urdf, &texts.controller);
        let minimal = minimal.expect("it is a robot").model;
        [(robot("hand3").model, 24_000), (robot("arm7").model, 48_000), (minimal, 24_000)]
            .map(|(model, supply)| Machine::new(model, supply))
    })
}

/// Returns the grasp of a box by hand3.
pub fn box_plan() -> GraspPlan {
    static PLAN: OnceLock<GraspPlan> = OnceLock::new();
    *PLAN.get_or_init(|| {
        tesaki_description::grasp::load(&robot_folder("hand3").join("grasps/box.toml"))
            .expect("it is a grasp")
    })
}

/// Returns the soft impedance of arm7.
pub fn soft() -> ImpedanceSettings {
    static SETTINGS: OnceLock<ImpedanceSettings> = OnceLock::new();
    *SETTINGS.get_or_init(|| {
        let path = robot_folder("arm7").join("impedances/soft.toml");
        tesaki_description::impedance::load(&path, &machines()[1].model).expect("it is an impedance")
    })
}

impl Machine {
    fn new(model: RobotModel, supply: u16) -> Self {
        let mut node = Node::new();
        let mut sequence = 0;
        for request in set_up(&model) {
            sequence += 1;
            let reply = node.handle(&RequestFrame { client: 1, sequence, request }, &BoardStatus::default());
            assert!(!matches!(reply.reply, Reply::Refused(_)), "{reply:?}");
        }
        let encoded = postcard::to_stdvec(&model).expect("a model has an encoding");
        Self { model, encoded, node, sequence, supply }
    }

    /// Returns a node with this robot.
    pub fn rig(&self, repeat: bool) -> Rig {
        Rig::new(&self.node, self.sequence, zero_sensors(&self.model, self.supply), repeat)
    }
}

/// Moves the joints to where their references are, and presses the tips as the task requires. Constant
/// readings would be faults.
pub fn follow(rig: &mut Rig) {
    let tick = rig.sensors.sequence;
    let touching = tick % 100 > 50;
    // Pseudo-random, from 0 to 15.
    let noise =
        |place: usize| tick.wrapping_mul(0x9e37).wrapping_add(place.to_le_bytes()[0].into()) >> 3 & 15;
    let Some(robot) = rig.node.robot() else { return };
    let joints = rig.node.telemetry().joints;
    let model = robot.model();
    let encoders = rig.sensors.encoders.iter_mut().enumerate();
    for (((place, count), joint), config) in encoders.zip(&joints).zip(&model.joints) {
        let sign = if config.encoder.reversed { -1.0 } else { 1.0 };
        let turns = (joint.reference - joint.position) / TAU;
        #[expect(clippy::cast_possible_truncation, reason = "saturates")]
        let change = f64::from(turns * config.encoder.counts_per_turn * sign).round() as i32;
        *count = count.wrapping_add(change).wrapping_add_unsigned(noise(place) % 5).wrapping_sub(2);
    }
    for (place, count) in rig.sensors.forces.as_flattened_mut().iter_mut().enumerate() {
        *count = (*count & !15).wrapping_add_unsigned(noise(place));
    }
    let Some(TaskTelemetry::Grasping(grasp)) = rig.node.task_report().map(|report| report.telemetry) else {
        return;
    };
    let angles: Vec<f32> = joints.iter().map(|joint| joint.reference).collect();
    let chains = model.chains.iter().zip(model.chain_ranges()).zip(box_plan().contacts);
    for ((counts, ((chain, range), contact)), target) in
        rig.sensors.forces.iter_mut().zip(chains).zip(grasp.target_forces)
    {
        let push = match grasp.phase {
            Phase::Ready | Phase::Approach => [0.0; 3],
            Phase::Touch if touching => contact.normal,
            Phase::Touch => [0.0; 3],
            _ => target,
        };
        let posture = Chain::new(&model.joints[range.clone()], &chain.tip).posture(&angles[range]);
        let force = posture.tip().rotation.inverse_transform_vector(&push.into());
        for ((place, count), force) in counts.iter_mut().enumerate().zip(force.iter()) {
            #[expect(clippy::cast_possible_truncation, reason = "saturates")]
            let reading = (force * -1000.0) as i32;
            *count = reading.wrapping_add_unsigned(noise(place)).wrapping_sub(8);
        }
    }
}

/// Returns angles of hand3 at which the tips are some distance in front of the contacts of [`box_plan`].
pub fn before_the_box() -> &'static [f32] {
    static ANGLES: OnceLock<Vec<f32>> = OnceLock::new();
    ANGLES.get_or_init(|| {
        let model = &machines()[0].model;
        let contacts = model.chains.iter().zip(model.chain_ranges()).zip(box_plan().contacts);
        let angles = contacts.map(|((chain, range), contact)| {
            let joints = &model.joints[range];
            let limits = [0, 1, 2].map(|joint| (joints[joint].limits.lower, joints[joint].limits.upper));
            let finger = tesaki::kinematics::Finger::try_new(&Chain::new(joints, &chain.tip), limits);
            let place = [0, 1, 2].map(|axis| contact.position[axis] - 0.03 * contact.normal[axis]);
            finger.expect("a finger").nearest(&place.into(), &[0.0, 0.3, 0.7]).expect("within reach")
        });
        angles.flatten().collect()
    })
}

/// Corrupts a frame: each bit of `mask` spoils one kind of reading.
pub fn spoil(frame: &mut SensorFrame, mask: u8, input: &mut crate::input::Input<'_>) {
    if mask & 1 != 0 {
        let place = input.below(frame.encoders.len());
        frame
            .encoders
            .iter_mut()
            .skip(place)
            .take(1)
            .for_each(|count| *count = i32::from_le_bytes(input.bytes()));
    }
    if mask & 2 != 0 {
        let place = input.below(frame.currents.len());
        frame
            .currents
            .iter_mut()
            .skip(place)
            .take(1)
            .for_each(|count| *count = i16::from_le_bytes(input.bytes()));
    }
    if mask & 4 != 0 {
        let (place, axis) = (input.below(frame.forces.len()), input.below(6));
        let forces = frame.forces.iter_mut().skip(place).take(1);
        forces.for_each(|counts| counts[axis] = i32::from_le_bytes(input.bytes()));
    }
    if mask & 8 != 0 {
        frame.supply = u16::from_le_bytes(input.bytes());
    }
    if mask & 16 != 0 {
        frame.flags.0 = input.byte();
    }
    if mask & 32 != 0 {
        let jump = input.signed();
        frame.sequence = match jump {
            i8::MIN => u32::from_le_bytes(input.bytes()),
            jump => frame.sequence.wrapping_add_signed(jump.into()),
        };
    }
    if mask & 64 != 0 {
        let length = input.below(17);
        match input.below(3) {
            0 => frame.encoders.truncate(length),
            1 => frame.currents.truncate(length),
            _ => frame.forces.truncate(length),
        }
    }
}
