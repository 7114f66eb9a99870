//! A board with three joints, and a supervisor.

pub mod acceptance;
pub mod odrive;

use std::path::PathBuf;

use tesaki::control::ServoMode;
use tesaki::fault::Fault;
use tesaki::model::{Field, Problem, RobotModel, Safety};
use tesaki::protocol::{Mode, Refusal, Reply, Request, Status};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskConfig, TaskKind};
use tesaki_chip::SECOND;
use tesaki_chip::bench::{Bench, Motor};
use tesaki_chip::client::Client;
use tesaki_chip::cpu::Machine;
use tesaki_chip::mistake::Mistake;

/// A gear motor at a joint of the finger of [`model`].
pub const MOTOR: Motor = Motor {
    resistance: 6.0,
    inductance: 2.4e-3,
    constant: 0.5,
    inertia: 2.2e-4,
    coulomb: 0.02,
    viscous: 0.002,
    counts: 65536.0,
    load: 0.0,
    blocked: false,
};

/// Returns a model of three joints without load.
pub fn model() -> RobotModel {
    let mut model = tesaki::test_support::finger();
    model.gravity = [0.0; 3];
    model.safety = Safety { command_timeout: 1.0, ..model.safety };
    for joint in &mut model.joints {
        joint.link.mass = 0.0;
        joint.link.inertia = [0.0; 6];
        joint.encoder.relative = true;
        joint.motor.resistance = Some(6.0);
        joint.motor.inductance = Some(2.4e-3);
    }
    model
}

/// Returns the image of a board: the file that `TESAKI_BOARD_ELF` names, with the board's name, or where the
/// xtask builds it.
pub fn image(board: &str) -> Vec<u8> {
    let image = std::env::var_os(format!("TESAKI_{}_ELF", board.to_uppercase())).map_or_else(
        || format!("../target/thumbv7em-none-eabihf/firmware/tesaki-firmware-board-{board}").into(),
        PathBuf::from,
    );
    std::fs::read(&image).unwrap_or_else(|error| panic!("{}: {error}", image.display()))
}

pub struct Rig {
    pub machine: Machine,
    pub client: Client,
    /// The model that is pushed.
    pub model: RobotModel,
    /// Time from a push, or from a fault, until the power stages can be enabled [s].
    pub wake: f64,
}

/// A change of the model that the board refuses, and joint, field and reason of the refusal.
pub type Refused = (fn(&mut RobotModel), Option<u8>, Field, Problem);

impl Rig {
    /// Pushes the model with each of these changes, which the board must refuse, and then without changes.
    pub fn refuses(&mut self, changes: &[Refused]) {
        for (change, joint, field, problem) in changes {
            let mut changed = self.model.clone();
            change(&mut changed);
            match self.client.offer(&mut self.machine, &changed).unwrap() {
                Reply::Refused(Refusal::Model(error)) => {
                    assert_eq!((error.joint, error.field, error.problem), (*joint, *field, *problem));
                }
                other => panic!("{field:?}: {other:?}"),
            }
            assert!(!self.machine.chip.bench.is_awake());
        }
        assert_eq!(self.client.offer(&mut self.machine, &self.model), Ok(Reply::Done));
    }

    /// Returns a board that has just started.
    pub fn boot() -> Self {
        Self::boot_with(&[])
    }

    pub fn boot_with(mistakes: &[Mistake]) -> Self {
        Self::boot_on(Bench::new([MOTOR; 3], 1), mistakes)
    }

    /// Returns a board that has just started, with this `bench` at its pins.
    pub fn boot_on(bench: Bench, mistakes: &[Mistake]) -> Self {
        Self::boot_image("weact", bench, mistakes, model(), 0.03)
    }

    pub fn boot_image(board: &str, bench: Bench, mistakes: &[Mistake], model: RobotModel, wake: f64) -> Self {
        let mut machine = Machine::load(&image(board), bench);
        machine.chip.mistakes = mistakes.to_vec();
        let mut rig = Self { machine, client: Client::default(), model, wake };
        // If the board cannot even start, later calls fail.
        let _ = rig.try_run(0.1);
        rig
    }

    /// Returns an enabled board whose motors and loads differ from the model: windings, inertia and friction
    /// by up to a fifth, the torque constant by a twentieth, and the supply by a tenth.
    pub fn deviating(seed: u32) -> Self {
        let mut state = seed.wrapping_mul(0x9E37_79B9);
        let mut within = |share: f64| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            1.0 + share * (f64::from(state >> 8) / f64::from(1 << 23) - 1.0)
        };
        let motors = [MOTOR; 3].map(|motor| Motor {
            resistance: motor.resistance * within(0.2),
            inductance: motor.inductance * within(0.2),
            constant: motor.constant * within(0.05),
            inertia: motor.inertia * within(0.2),
            coulomb: motor.coulomb * within(0.2),
            viscous: motor.viscous * within(0.2),
            ..motor
        });
        let mut bench = Bench::new(motors, seed);
        bench.supply *= within(0.1);
        let mut rig = Self::boot_on(bench, &[]);
        rig.enable().unwrap();
        rig
    }

    /// Returns a board whose supervisor has sent a greeting.
    pub fn greeted() -> Self {
        let mut rig = Self::boot();
        rig.client.demand(&mut rig.machine, Request::Hello { schema: tesaki::protocol::SCHEMA_KEY }).unwrap();
        rig
    }

    /// Returns a board that has a model, is homed, and is enabled at rest.
    pub fn enabled() -> Self {
        let mut rig = Self::boot();
        rig.enable().unwrap();
        rig
    }

    pub fn enable(&mut self) -> Result<(), String> {
        self.enable_with(&self.model.clone())
    }

    pub fn enable_with(&mut self, model: &RobotModel) -> Result<(), String> {
        self.client.push(&mut self.machine, model)?;
        self.try_run(self.wake)?;
        self.switch_on()
    }

    fn switch_on(&mut self) -> Result<(), String> {
        let states = self.machine.chip.bench.states.iter().take(self.model.joints.len());
        let positions = states.map(|state| state.angle as f32).collect();
        self.client.demand(&mut self.machine, Request::Home { positions })?;
        let config = TaskConfig::JointServo(ServoMode::Observer);
        self.client.demand(&mut self.machine, Request::Enable(config))?;
        self.try_run(0.05)
    }

    /// Clears the fault and enables again.
    pub fn recover(&mut self) -> Result<(), String> {
        let total = match self.client.ask(&mut self.machine, Request::ReadFaults)? {
            Reply::Faults(log) => log.total,
            other => return Err(format!("{other:?}")),
        };
        self.client.demand(&mut self.machine, Request::ClearFaults { total })?;
        self.switch_on()
    }

    /// Disables the interrupt of the control task: the timer continues, but nothing commands the motors.
    pub fn stop_control(&mut self) {
        self.machine.chip.nvic.enabled[0] &= !(1 << 6);
    }

    /// Replaces the first instruction of a handler by a jump to itself.
    pub fn hang(&mut self, interrupt: u32) {
        let handler = self.machine.word(0x0800_0000 + 4 * (16 + interrupt)) & !1;
        assert_eq!(handler % 4, 0, "the handler is not at a word");
        assert!(self.machine.patch(handler, 0xE7FE_E7FE));
    }

    pub fn running() -> Mode {
        Mode::Enabled(TaskKind::JointServo)
    }

    pub fn try_run(&mut self, seconds: f64) -> Result<(), String> {
        let until = self.machine.now() + (seconds * SECOND as f64) as u64;
        self.machine.run(until)?;
        self.client.receive(&mut self.machine);
        Ok(())
    }

    pub fn run(&mut self, seconds: f64) {
        self.try_run(seconds).unwrap();
    }

    pub fn ask(&mut self, request: Request) -> Reply {
        self.client.ask(&mut self.machine, request).unwrap()
    }

    pub fn status(&mut self) -> Status {
        self.client.status(&mut self.machine).unwrap()
    }

    pub fn faults(&mut self) -> Vec<Fault> {
        match self.ask(Request::ReadFaults) {
            Reply::Faults(log) => log.faults.into_iter().collect(),
            other => panic!("{other:?}"),
        }
    }

    pub fn goal_request(positions: &[f32]) -> Request {
        let positions = positions.iter().copied().collect();
        Request::Task(TaskCommand::JointServo(JointCommand::Goal { positions }))
    }

    pub fn goal<const N: usize>(&mut self, positions: [f32; N]) {
        let reply = self.ask(Self::goal_request(&positions));
        assert_eq!(reply, Reply::Done, "{:?}", self.faults());
    }

    /// Resets the command timeout, without waiting for the reply.
    pub fn keep(&mut self) {
        self.client.send(&mut self.machine, Request::Keep);
    }
}
