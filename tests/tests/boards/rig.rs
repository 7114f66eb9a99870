//! The simulated hand with a box in front of it, and one board or three that control it.

use tesaki::control::ServoMode;
use tesaki::fault::FaultCause;
use tesaki::protocol::{SensorFlags, SensorFrame};
use tesaki::task::TaskConfig;
use tesaki::task::grasping::{GraspCommand, GraspPlan, GraspTelemetry, Phase};
use tesaki_description::grasp::load_placed;
use tesaki_description::robot::RobotFolder;
use tesaki_sim::boards;
use tesaki_sim::controller::{Controller, Native};
use tesaki_sim::plant::{ObjectTruth, Plant, PlantOptions};
use tesaki_sim::scenario::scene::around_object;
use tesaki_supervisor::Board;
use tesaki_supervisor::hand::{FingerBoard, HandError, MultiBoardHand};
use tesaki_tests::robot;

use super::links::Cable;

/// What happens to a board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Trouble {
    /// Nothing gets to the PC or comes from there.
    CutLink,
    /// Its outputs go off, whatever its reaction is.
    EmergencyStop,
    /// It reacts as its model says.
    LowSupply,
}

impl Trouble {
    pub fn cause(self) -> FaultCause {
        match self {
            Self::CutLink => FaultCause::CommandTimeout,
            Self::EmergencyStop => FaultCause::EmergencyStop,
            Self::LowSupply => FaultCause::SupplyLow,
        }
    }
}

/// The control of the hand.
enum Control<B> {
    One(Box<Native>),
    Three(Box<MultiBoardHand<Cable<B>>>),
}

/// A hand with open fingers, and a box between them.
pub struct Rig<B> {
    pub robot: RobotFolder,
    pub plan: GraspPlan,
    pub plant: Plant,
    control: Control<B>,
    pub sequence: u32,
    /// Which board has what trouble.
    pub trouble: Option<(usize, Trouble)>,
}

impl<B: FingerBoard + Controller> Rig<B> {
    pub fn new(seed: u64, boards: Option<[B; 3]>) -> Self {
        let robot = robot("hand3");
        let [grasp, object] = ["grasps/box.toml", "objects/box.toml"].map(|file| robot.path.join(file));
        let options = PlantOptions::mismatched(seed);
        let options = around_object(options, &robot.model, &grasp, Some(&object)).unwrap();
        let grasp = load_placed(&grasp).unwrap();
        let plant = Plant::of(&robot, &options).unwrap();
        let control = match boards {
            None => Control::One(Box::default()),
            Some(boards) => {
                let hand = MultiBoardHand::new(&robot.model, boards.map(Cable::new)).unwrap();
                Control::Three(Box::new(hand))
            }
        };
        let mut rig = Self { robot, plan: grasp.plan, plant, control, sequence: 0, trouble: None };
        rig.make_ready();
        rig
    }

    /// Model, homing, taring, arming.
    fn make_ready(&mut self) {
        match &mut self.control {
            Control::One(board) => {
                board.hello().unwrap();
                board.take_command(false).unwrap();
                board.push_model(&self.robot.model).unwrap();
            }
            Control::Three(hand) => hand.set_up().unwrap(),
        }
        self.machine();
        let angles: Vec<f32> = self.plant.homed_positions().iter().map(|&angle| angle as f32).collect();
        match &mut self.control {
            Control::One(board) => board.home(&angles).unwrap(),
            Control::Three(hand) => {
                let (fingers, _) = angles.as_chunks::<3>();
                hand.home(fingers.try_into().unwrap()).unwrap();
                let early = hand.enable(ServoMode::Observer).unwrap_err();
                assert!(matches!(early, HandError::NotTared { .. }), "{early}");
            }
        }
        for _ in 0..100 {
            self.machine();
        }
        match &mut self.control {
            Control::One(board) => {
                board.tare().unwrap();
                board.enable(TaskConfig::Grasping(())).unwrap();
            }
            Control::Three(hand) => {
                hand.tare().unwrap();
                self.machine();
                let Control::Three(hand) = &mut self.control else { return };
                hand.enable(ServoMode::Observer).unwrap();
            }
        }
    }

    /// Machine and boards advance by a tick.
    pub fn machine(&mut self) {
        self.sequence += 1;
        let trouble = self.trouble;
        match &mut self.control {
            Control::One(board) => {
                let actuators = board.tick(&self.plant.sensors(self.sequence)).unwrap();
                self.plant.apply(&actuators).unwrap();
            }
            Control::Three(hand) => {
                let boards = hand.boards_mut().map(|board| board as &mut dyn Controller);
                let spoil = |index, frame: &mut SensorFrame| match trouble {
                    Some((board, Trouble::EmergencyStop)) if board == index => {
                        frame.flags = SensorFlags(SensorFlags::EMERGENCY_STOP);
                    }
                    Some((board, Trouble::LowSupply)) if board == index => frame.supply = 15_000,
                    _ => {}
                };
                boards::tick(&self.robot.model, &mut self.plant, self.sequence, boards, spoil).unwrap();
            }
        }
    }

    /// One control period with the supervisor alive.
    pub fn tick(&mut self) -> Result<GraspTelemetry, HandError> {
        self.machine();
        match &mut self.control {
            Control::One(board) => {
                board.keep().unwrap();
                Ok(board.read_grasp().unwrap())
            }
            Control::Three(hand) => hand.step(),
        }
    }

    pub fn command(&mut self, command: &GraspCommand) {
        match &mut self.control {
            Control::One(board) => board.grasp(*command).unwrap(),
            Control::Three(hand) => hand.command(command).unwrap(),
        }
    }

    /// Goes on until the hand does this.
    pub fn until(&mut self, phase: Phase) -> GraspTelemetry {
        for _ in 0..2000 {
            let now = self.tick().unwrap();
            assert_eq!(now.failure, None, "tick {}", self.sequence);
            if now.phase == phase {
                return now;
            }
        }
        panic!("never {phase:?}");
    }

    pub fn wait(&mut self, ticks: u32) {
        for _ in 0..ticks {
            self.tick().unwrap();
        }
    }

    pub fn grasp(&mut self) {
        self.command(&GraspCommand::Grasp(self.plan));
        self.until(Phase::Hold);
    }

    pub fn go(&mut self, lift: f32, turn: f32) {
        let up = core::f32::consts::FRAC_1_SQRT_2 * lift;
        self.command(&GraspCommand::Move {
            translation: [up, 0.0, up],
            rotation: [0.0, turn, 0.0],
            duration: 1.0,
        });
    }

    pub fn box_now(&self) -> ObjectTruth {
        self.plant.object().unwrap()
    }

    pub fn hand(&mut self) -> &mut MultiBoardHand<Cable<B>> {
        match &mut self.control {
            Control::Three(hand) => hand,
            Control::One(_) => panic!("one board"),
        }
    }
}

pub fn natives() -> Option<[Native; 3]> {
    Some([Native::default(), Native::default(), Native::default()])
}

pub fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}
