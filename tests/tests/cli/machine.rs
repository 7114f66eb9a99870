//! Every joint of a robot moves: on a board in this process, not in real time.

use std::path::Path;

use tesaki::control::ServoMode;
use tesaki::model::RobotModel;
use tesaki::protocol::{Refusal, Reply, Request, RequestFrame};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskConfig};
use tesaki_description::robot::RobotFolder;
use tesaki_sim::plant::{Plant, PlantOptions};
use tesaki_sim::virtual_board::VirtualBoard;

/// Control periods in which a move ends.
const MOVE: u32 = 1000;

/// A board with the model of a folder, homed, and its machine: not in real time, so that a busy computer
/// changes nothing.
struct Machine {
    board: VirtualBoard,
    plant: Plant,
    model: RobotModel,
    requests: u16,
    tick: u32,
}

impl Machine {
    #[expect(clippy::cast_possible_truncation, reason = "the controller works in single precision")]
    fn new(folder: &Path, seed: u64) -> Self {
        let robot = RobotFolder::load(folder).unwrap();
        let plant = Plant::of(&robot, &PlantOptions::mismatched(seed)).unwrap();
        let board = VirtualBoard::default();
        let mut machine = Self { board, plant, model: robot.model, requests: 0, tick: 0 };
        for request in tesaki_tests::set_up(&machine.model) {
            machine.grants(request);
        }
        machine.tick();
        let positions = machine.plant.homed_positions().into_iter().map(|angle| angle as f32).collect();
        machine.grants(Request::Home { positions });
        machine
    }

    fn ask(&mut self, request: Request) -> Reply {
        self.requests = self.requests.wrapping_add(1);
        let frame = RequestFrame { client: 1, sequence: self.requests, request };
        self.board.handle(frame, &mut Vec::new()).reply
    }

    #[track_caller]
    fn grants(&mut self, request: Request) {
        let reply = self.ask(request);
        assert!(!matches!(reply, Reply::Refused(_)), "{reply:?}");
    }

    fn tick(&mut self) {
        self.tick += 1;
        let actuators = self.board.tick(&self.plant.sensors(self.tick), &mut Vec::new());
        self.plant.configure_amplifiers(&self.model);
        self.plant.apply(&actuators).unwrap();
    }

    /// The joint angles [rad].
    fn angles(&self) -> Vec<f32> {
        self.board.node().telemetry().joints.iter().map(|joint| joint.position).collect()
    }

    /// Enables as soon as what fell after the last move is slow enough, moves to `goal` [rad] and disables.
    #[track_caller]
    fn moves(&mut self, goal: &[f32]) {
        let mut waited = 0;
        while let Reply::Refused(refusal) =
            self.ask(Request::Enable(TaskConfig::JointServo(ServoMode::Observer)))
        {
            assert!(matches!(refusal, Refusal::Unsafe(_)) && waited < MOVE, "{refusal}");
            waited += 1;
            self.tick();
        }
        let mut within = 0;
        for _ in 0..MOVE {
            let positions = heapless::Vec::from_slice(goal).unwrap();
            self.grants(Request::Task(TaskCommand::JointServo(JointCommand::Goal { positions })));
            self.tick();
            let near = self.angles().iter().zip(goal).all(|(angle, goal)| (angle - goal).abs() < 0.01);
            within = if near { within + 1 } else { 0 };
            if within == 10 {
                break;
            }
        }
        assert_eq!(within, 10, "{:?} instead of {goal:?}", self.angles());
        self.grants(Request::Disable);
        self.tick();
    }
}

/// Moves each joint to a quarter and to three quarters of its range, then all of them to the middle.
pub fn move_every_joint(folder: &Path, seed: u64) {
    let mut machine = Machine::new(folder, seed);
    let ranges: Vec<(f32, f32)> =
        machine.model.joints.iter().map(|joint| (joint.limits.lower, joint.limits.upper)).collect();
    let part = |part: f32, (lower, upper): (f32, f32)| lower + part * (upper - lower);
    for (joint, range) in ranges.iter().enumerate() {
        for where_to in [0.25, 0.75] {
            let within = |(angle, (lower, upper)): (f32, &(f32, f32))| angle.clamp(*lower, *upper);
            let mut goal: Vec<f32> = machine.angles().into_iter().zip(&ranges).map(within).collect();
            goal[joint] = part(where_to, *range);
            machine.moves(&goal);
        }
    }
    let middle: Vec<f32> = ranges.iter().map(|range| part(0.5, *range)).collect();
    machine.moves(&middle);
    assert_eq!(machine.board.node().faults().total, 0);
}

#[test]
fn the_arm_for_door_knobs_moves_every_joint() {
    for seed in 1..=3 {
        move_every_joint(&tesaki_tests::robot_folder("knob-arm"), seed);
    }
}
