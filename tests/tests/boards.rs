//! A hand whose fingers have a board each: it does what the same hand on one board does, and all boards stop when one does.
#![allow(clippy::unwrap_used, clippy::cast_possible_truncation, clippy::disallowed_methods, reason = "tests")]

use std::cell::RefCell;
use std::io;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::{Duration, Instant};

use tesaki::control::ServoMode;
use tesaki::manipulation::{GraspCommand, GraspPlan, GraspTelemetry, ObjectControl, Phase, WrenchGains};
use tesaki::protocol::{ActuatorFrame, FaultCause, Mode, Reply, Request, SensorFlags, SensorFrame, Task};
use tesaki_description::grasp::load_placed;
use tesaki_description::robot::{RobotFolder, chain_model};
use tesaki_sim::boards;
use tesaki_sim::controller::{Controller, Native};
use tesaki_sim::grasp_scene::{on_support, open_posture};
use tesaki_sim::plant::{
    ContactTruth, Drive, Load, ObjectTruth, ObjectValues, Plant, PlantOptions, PlantValues,
};
use tesaki_sim::qemu::Qemu;
use tesaki_sim::virtual_board::VirtualBoard;
use tesaki_supervisor::hand::{FingerBoard, HandError, MultiBoardHand, News};
use tesaki_supervisor::{Board, BoardError, ByteLink, LinkBoard};

fn hand3() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../robots/hand3")
}

/// A board at a cable that can be cut, and what the board told its drives last.
struct Cable<B> {
    board: B,
    cut: bool,
    actuators: ActuatorFrame,
}

impl<B> Cable<B> {
    fn new(board: B) -> Self {
        Self { board, cut: false, actuators: ActuatorFrame::default() }
    }
}

impl<B: Board> Board for Cable<B> {
    fn request(&mut self, request: Request) -> Result<Reply, BoardError> {
        if self.cut { Err(BoardError::Timeout { seconds: 2.0 }) } else { self.board.request(request) }
    }
}

impl<B: FingerBoard> FingerBoard for Cable<B> {
    fn post(&mut self, request: Request) -> Result<(), BoardError> {
        if self.cut { Ok(()) } else { self.board.post(request) }
    }

    fn listen(&mut self) -> Result<News, BoardError> {
        if self.cut { Ok(News::default()) } else { self.board.listen() }
    }
}

impl<B: Controller> Controller for Cable<B> {
    fn tick(&mut self, sensors: &SensorFrame) -> Result<ActuatorFrame, BoardError> {
        self.actuators = self.board.tick(sensors)?;
        Ok(self.actuators.clone())
    }
}

/// Bytes to a board in this process and from it.
#[derive(Default)]
struct Wire {
    board: VirtualBoard,
    from_board: Vec<u8>,
}

/// The PC's end of a wire.
#[derive(Clone, Default)]
struct End(Rc<RefCell<Wire>>);

impl ByteLink for End {
    fn send(&mut self, bytes: &[u8]) -> io::Result<()> {
        let Wire { board, from_board } = &mut *self.0.borrow_mut();
        board.receive(bytes, from_board);
        Ok(())
    }

    fn receive(&mut self, buffer: &mut [u8], _: Instant) -> io::Result<usize> {
        let from_board = &mut self.0.borrow_mut().from_board;
        let length = from_board.len().min(buffer.len());
        buffer[..length].copy_from_slice(&from_board[..length]);
        from_board.drain(..length);
        Ok(length)
    }
}

/// A board that is spoken to as over a serial line, which loses what comes in some ticks.
struct Wired {
    link: LinkBoard<End>,
    end: End,
    /// From one tick that is lost to the next; 0: none is.
    lossy: u32,
}

impl Wired {
    fn new(lossy: u32) -> Self {
        let end = End::default();
        Self { link: LinkBoard::new(end.clone(), Duration::from_secs(2)), end, lossy }
    }
}

impl Board for Wired {
    fn request(&mut self, request: Request) -> Result<Reply, BoardError> {
        self.link.request(request)
    }
}

impl FingerBoard for Wired {
    fn post(&mut self, request: Request) -> Result<(), BoardError> {
        FingerBoard::post(&mut self.link, request)
    }

    fn listen(&mut self) -> Result<News, BoardError> {
        self.link.listen()
    }
}

impl Controller for Wired {
    fn tick(&mut self, sensors: &SensorFrame) -> Result<ActuatorFrame, BoardError> {
        let Wire { board, from_board } = &mut *self.end.0.borrow_mut();
        let before = from_board.len();
        let actuators = board.tick(sensors, from_board);
        if sensors.sequence.checked_rem(self.lossy) == Some(0) {
            from_board.truncate(before);
        }
        Ok(actuators)
    }
}

/// What happens to a board.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Trouble {
    /// Nothing gets to the PC or comes from there.
    CutLink,
    /// Its outputs go off, whatever its reaction is.
    EmergencyStop,
    /// It reacts as its model says.
    LowSupply,
}

impl Trouble {
    fn cause(self) -> FaultCause {
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
struct Rig<B> {
    robot: RobotFolder,
    plan: GraspPlan,
    plant: Plant,
    control: Control<B>,
    sequence: u32,
    /// Which board has what trouble.
    trouble: Option<(usize, Trouble)>,
}

impl<B: FingerBoard + Controller> Rig<B> {
    fn new(seed: u64, boards: Option<[B; 3]>) -> Self {
        let robot = RobotFolder::load(&hand3()).unwrap();
        let grasp = load_placed(&hand3().join("grasps/box.toml")).unwrap();
        let mut options = PlantOptions::mismatched(seed);
        options.posture = Some(open_posture(&robot.model, &grasp.plan).unwrap());
        let text = std::fs::read_to_string(hand3().join("objects/box.toml")).unwrap();
        options.object = Some(on_support(ObjectValues::from_toml(&text).unwrap(), &grasp));
        let drives: Vec<Drive> = robot.model.joints.iter().map(Drive::from).collect();
        let values = PlantValues::load(&hand3()).unwrap();
        let plant = Plant::new(&robot.urdf, &drives, &values, &options).unwrap();
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
                let early = hand.arm(ServoMode::Observer).unwrap_err();
                assert!(matches!(early, HandError::NotTared { .. }), "{early}");
            }
        }
        for _ in 0..100 {
            self.machine();
        }
        match &mut self.control {
            Control::One(board) => {
                board.tare().unwrap();
                board.arm(Task::Grasp).unwrap();
            }
            Control::Three(hand) => {
                hand.tare().unwrap();
                self.machine();
                let Control::Three(hand) = &mut self.control else { return };
                hand.arm(ServoMode::Observer).unwrap();
            }
        }
    }

    /// Machine and boards advance by a tick.
    fn machine(&mut self) {
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
    fn tick(&mut self) -> Result<GraspTelemetry, HandError> {
        self.machine();
        match &mut self.control {
            Control::One(board) => {
                board.keep().unwrap();
                Ok(board.read_grasp().unwrap())
            }
            Control::Three(hand) => hand.step(),
        }
    }

    fn command(&mut self, command: &GraspCommand) {
        match &mut self.control {
            Control::One(board) => board.grasp(*command).unwrap(),
            Control::Three(hand) => hand.command(command).unwrap(),
        }
    }

    /// Goes on until the hand does this.
    fn until(&mut self, phase: Phase) -> GraspTelemetry {
        for _ in 0..2000 {
            let now = self.tick().unwrap();
            assert_eq!(now.failure, None, "tick {}", self.sequence);
            if now.phase == phase {
                return now;
            }
        }
        panic!("never {phase:?}");
    }

    fn wait(&mut self, ticks: u32) {
        for _ in 0..ticks {
            self.tick().unwrap();
        }
    }

    fn grasp(&mut self) {
        self.command(&GraspCommand::Grasp(self.plan));
        self.until(Phase::Hold);
    }

    fn go(&mut self, lift: f32, turn: f32) {
        let up = core::f32::consts::FRAC_1_SQRT_2 * lift;
        self.command(&GraspCommand::Move {
            translation: [up, 0.0, up],
            rotation: [0.0, turn, 0.0],
            duration: 1.0,
        });
    }

    fn box_now(&self) -> ObjectTruth {
        self.plant.object().unwrap()
    }

    fn hand(&mut self) -> &mut MultiBoardHand<Cable<B>> {
        match &mut self.control {
            Control::Three(hand) => hand,
            Control::One(_) => panic!("one board"),
        }
    }
}

fn natives() -> Option<[Native; 3]> {
    Some([Native::default(), Native::default(), Native::default()])
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(&b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// Angle by which the box is turned about y [rad].
fn pitch(object: &ObjectTruth) -> f64 {
    let [_, y, _, w] = object.orientation;
    2.0 * y.atan2(w)
}

/// How far the box is from where it should be [m, rad] after lifting, turning, and turning back.
fn course<B: FingerBoard + Controller>(mut rig: Rig<B>) -> [f64; 4] {
    rig.grasp();
    let start = rig.box_now();
    let up = 0.01 * std::f64::consts::FRAC_1_SQRT_2;
    let lifted = [start.position[0] + up, start.position[1], start.position[2] + up];
    rig.go(0.01, 0.0);
    rig.wait(250);
    let of_lift = distance(rig.box_now().position, lifted);
    rig.go(0.01, 0.1);
    rig.wait(250);
    let of_turn = (pitch(&rig.box_now()) - pitch(&start) - 0.1).abs();
    rig.go(0.01, 0.0);
    rig.wait(250);
    let (of_return, of_angle) =
        (distance(rig.box_now().position, lifted), (pitch(&rig.box_now()) - pitch(&start)).abs());
    rig.command(&GraspCommand::PutDown);
    rig.until(Phase::Ready);
    assert!(rig.plant.contacts().iter().all(|contact| contact.normal_force() == 0.0));
    let weight = distance(rig.box_now().support_force, [0.0; 3]);
    assert!(weight > 0.15, "it does not stand on its support: {weight} N");
    [of_lift, of_turn, of_return, of_angle]
}

#[test]
fn three_boards_lift_turn_and_put_down_a_box_as_one_does() {
    for seed in 1..=2 {
        let one = course(Rig::<Native>::new(seed, None));
        let three = course(Rig::new(seed, natives()));
        println!("seed {seed}: [m, rad, m, rad] one {one:.5?} three {three:.5?}");
        for [of_lift, of_turn, of_return, of_angle] in [one, three] {
            assert!(of_lift < 2e-3 && of_return < 2e-3, "{of_lift} {of_return}");
            assert!(of_turn < 0.02 && of_angle < 0.02, "{of_turn} {of_angle}");
        }
    }
}

#[test]
fn over_a_wire_it_is_the_same_to_the_last_bit_and_lost_telemetry_costs_little() {
    let here = course(Rig::new(1, natives()));
    let wired = course(Rig::new(1, Some([0; 3].map(Wired::new))));
    assert_eq!(wired.map(f64::to_bits), here.map(f64::to_bits));
    // Each board's telemetry of another tick is lost, one in ten or so.
    let [of_lift, of_turn, of_return, of_angle] = course(Rig::new(1, Some([7, 11, 13].map(Wired::new))));
    println!("lossy: {of_lift:.5} {of_turn:.5} {of_return:.5} {of_angle:.5}");
    assert!(of_lift < 2e-3 && of_return < 2e-3, "{of_lift} {of_return}");
    assert!(of_turn < 0.02 && of_angle < 0.02, "{of_turn} {of_angle}");
}

/// The box is lifted, and perhaps being turned; something happens to board `index`: all boards stop in time, and hold the
/// box if all can.
fn lose(index: usize, moving: bool, trouble: Trouble) {
    let mut rig = Rig::new(3, natives());
    rig.grasp();
    rig.go(0.01, 0.0);
    rig.wait(150);
    if moving {
        rig.go(0.01, 0.1);
        rig.wait(40);
    }
    let before = rig.box_now().position;
    rig.hand().boards_mut()[index].cut = trouble == Trouble::CutLink;
    rig.trouble = Some((index, trouble));
    let (mut told, mut all_stopped) = (None, None);
    // The command timeout of 0.1 s and two ticks more; and a second.
    for tick in 1..=112 {
        rig.machine();
        if told.is_none() {
            told = rig.hand().step().err().map(|error| (tick, error));
        }
        if rig.hand().boards().iter().all(|cable| cable.board.node().mode() == Mode::Fault) {
            all_stopped = all_stopped.or(Some(tick));
        }
    }
    let (told, error) = told.unwrap();
    let case = format!("board {index}, moving {moving}, {trouble:?}");
    assert!(all_stopped.unwrap() <= 12, "{case}: {all_stopped:?}");
    let name = format!("finger{}_tip", index + 1);
    match &error {
        HandError::Stale { board, .. } => assert!(trouble == Trouble::CutLink && *board == name, "{error}"),
        HandError::Fault { board, fault } => {
            assert!(*board == name && fault.as_ref().unwrap().contains("fault"), "{error}");
        }
        _ => panic!("{case}: {error}"),
    }
    for (other, cable) in rig.hand().boards().iter().enumerate() {
        let cause = cable.board.node().faults().faults.last().unwrap().cause;
        assert_eq!(cause, if other == index { trouble.cause() } else { FaultCause::Stop }, "{case}");
        // The model's reaction is to hold.
        let off = other == index && trouble == Trouble::EmergencyStop;
        assert_eq!(cable.actuators.enabled, !off, "{case}: board {other}");
    }
    let moved = distance(rig.box_now().position, before);
    let normals: Vec<f64> = rig.plant.contacts().iter().map(|contact| contact.normal_force()).collect();
    println!(
        "{case}: told after {told} ticks ({error}), all stopped after {}; a second later the box has moved {:.2} mm, \
         normal forces {normals:.2?} N",
        all_stopped.unwrap(),
        1e3 * moved
    );
    if trouble != Trouble::EmergencyStop {
        assert!(
            moved < 0.002 && normals.iter().all(|force| *force > 0.05),
            "{case}: {moved} m, {normals:?} N"
        );
    }
    assert!(matches!(rig.hand().step(), Err(HandError::NotArmed)));
}

#[test]
fn a_cut_link_stops_all_boards_and_the_box_stays_in_the_hand() {
    lose(1, false, Trouble::CutLink);
    lose(2, true, Trouble::CutLink);
}

#[test]
fn a_board_in_fault_stops_the_others_and_the_box_stays_in_the_hand() {
    lose(0, false, Trouble::LowSupply);
    lose(2, true, Trouble::LowSupply);
    lose(1, false, Trouble::EmergencyStop);
}

/// Ticks from the one in which a contact begins to slide under a sudden weight to the ones in which the wanted grip and
/// the true one are a tenth firmer, and how far contacts slid [m].
fn react(mut rig: Rig<Native>) -> (u32, u32, f64) {
    // What rubbing would find without any error.
    rig.plan.friction = Some(rig.box_now().friction as f32);
    rig.grasp();
    rig.go(0.01, 0.0);
    rig.wait(200);
    let wanted =
        |now: &GraspTelemetry| now.wanted.iter().flatten().map(|part| part * part).sum::<f32>().sqrt();
    let pressed =
        |rig: &Rig<Native>| rig.plant.contacts().iter().map(ContactTruth::normal_force).sum::<f64>();
    let way =
        |rig: &Rig<Native>| rig.plant.contacts().iter().map(|contact| contact.slip_path).fold(0.0, f64::max);
    let now = rig.tick().unwrap();
    let (wanted_before, pressed_before, way_before) = (wanted(&now), pressed(&rig), way(&rig));
    rig.plant.load(Load { mass: 0.4, point: [0.0, 0.0, 0.03], ramp: 0.02 }).unwrap();
    let (mut slid, mut firmer, mut firm) = (None::<u32>, None::<u32>, None::<u32>);
    for tick in 0..100 {
        let now = rig.tick().unwrap();
        let slides =
            rig.plant.contacts().iter().any(|contact| distance(contact.slip_velocity, [0.0; 3]) > 5e-4);
        if slides {
            slid = slid.or(Some(tick));
        }
        if wanted(&now) > 1.1 * wanted_before {
            firmer = firmer.or(Some(tick));
        }
        if pressed(&rig) > 1.1 * pressed_before {
            firm = firm.or(Some(tick));
        }
    }
    let slid = slid.unwrap();
    (firmer.unwrap().saturating_sub(slid), firm.unwrap().saturating_sub(slid), way(&rig) - way_before)
}

#[test]
fn a_contact_that_begins_to_slide_is_answered_by_a_firmer_grip_within_three_ticks() {
    for seed in 1..=3 {
        let one = react(Rig::new(seed, None));
        let three = react(Rig::new(seed, natives()));
        println!(
            "seed {seed}: ticks until wanted and pressed firmer, m slid: one board {one:?}, three {three:?}"
        );
        assert!(one.0 <= 2 && one.1 <= 2, "{one:?}");
        assert!(three.0 <= 3 && three.1 <= 3, "{three:?}");
    }
}

#[test]
fn what_three_boards_cannot_do_is_said() {
    let mut rig = Rig::new(1, natives());
    let gains = WrenchGains { position: [50.0; 2], orientation: [0.1; 2], damping: 0.02, compensated: true };
    let plan = GraspPlan { control: ObjectControl::Wrench(gains), ..rig.plan };
    let refused = rig.hand().command(&GraspCommand::Grasp(plan)).unwrap_err();
    assert!(matches!(refused, HandError::WrenchControl), "{refused}");
    let refused = rig.hand().command(&GraspCommand::PutDown).unwrap_err();
    assert_eq!(refused.to_string(), "not possible while the hand is ready");
    rig.wait(3);
    rig.hand().boards_mut()[1].request(Request::Disarm).unwrap();
    let gone = rig.tick().unwrap_err();
    assert_eq!(gone.to_string(), "finger2_tip was disarmed by somebody else, or reset");
    assert!(!rig.hand().is_armed());
    assert_eq!(rig.hand().boards()[2].board.node().mode(), Mode::Fault);

    let finger = chain_model(&rig.robot.model, 0).unwrap();
    let none = MultiBoardHand::new(&finger, natives().unwrap()).map(|_| ()).unwrap_err();
    assert!(none.to_string().starts_with("hand3.finger1_tip is no hand that grasps"), "{none}");
    assert!(chain_model(&finger, 1).is_none());
}

fn image() -> PathBuf {
    std::env::var_os("TESAKI_ELF")
        .unwrap_or_else(|| panic!("TESAKI_ELF is not set: run `cargo xtask test`"))
        .into()
}

#[test]
#[ignore = "needs the firmware image: cargo xtask test"]
fn three_images_grasp_and_hold_a_box() {
    fn hold<B: FingerBoard + Controller>(boards: [B; 3]) -> ([f64; 3], GraspTelemetry) {
        let mut rig = Rig::new(1, Some(boards));
        rig.grasp();
        let start = rig.box_now().position;
        rig.wait(100);
        assert!(distance(rig.box_now().position, start) < 1e-3);
        (rig.box_now().position, rig.hand().telemetry())
    }
    let images = hold([(); 3].map(|()| Qemu::boot(&image()).unwrap()));
    assert_eq!(images.1.phase, Phase::Hold);
    assert_eq!(images, hold([(); 3].map(|()| Native::default())), "not the same as here, bit for bit");
}
