//! A hand whose fingers have a board each: what [`GraspState`] does on one board, done on the PC over three.
//!
//! Each board servoes the three joints of its finger
//! ([`chain_model`](tesaki_description::robot::chain_model)) and reads its fingertip's force sensor. Once a
//! tick [`MultiBoardHand::step`] takes what the fingers sense, and sends each board points and torques
//! ([`JointCommand::Guide`]), which act a tick later than they would on one board.
//!
//! When a board faults, is switched off, or is not heard, the others are stopped at once, and it gets no more
//! set-points: within the command timeout all three are in their model's reaction.

mod board;
mod error;
mod model;

use std::time::{Duration, Instant};

use tesaki::control::ServoMode;
use tesaki::kinematics::Posture;
use tesaki::model::RobotModel;
use tesaki::protocol::{Mode, Request, Stream, Telemetry, Tips};
use tesaki::task::grasping::{
    FINGERS, FingerSense, GraspCommand, GraspPlan, GraspState, GraspTelemetry, HandOutput, ObjectControl,
    PerFinger,
};
use tesaki::task::joint_servo::JointCommand;
use tesaki::task::{TaskCommand, TaskConfig};
use tesaki_description::robot::chain_model;

pub use board::{FingerBoard, News};
pub use error::HandError;
pub use model::HandModel;

use crate::BoardError;

/// Steps without news of a board after which its data are stale. So many telemetries may be lost in a row.
pub const MAX_AGE: u32 = 3;
/// Longest wait for the first telemetry of a board.
const FIRST: Duration = Duration::from_millis(300);

/// A board, and what is known of its finger.
struct Member<B> {
    name: String,
    board: B,
    model: RobotModel,
    /// What came last, of one tick or not.
    telemetry: Option<Telemetry>,
    tips: Option<Tips>,
    /// Of the last tick of which both came.
    tick: Option<u32>,
    sense: Sense,
    tared: bool,
    /// Steps since then.
    age: u32,
}

/// What a finger senses.
#[derive(Clone, Copy, Debug, Default)]
struct Sense {
    /// Joint angles [rad].
    angles: [f32; 3],
    /// Force of the tip on what it touches, in base axes [N].
    force: [f32; 3],
}

/// Three boards with a finger each, which hold one object.
pub struct MultiBoardHand<B> {
    members: PerFinger<Member<B>>,
    model: HandModel,
    state: GraspState,
    steps: u32,
    armed: bool,
}

impl<B: FingerBoard> MultiBoardHand<B> {
    /// A hand of `robot`, whose chains are on these boards, in their order.
    ///
    /// # Errors
    /// The robot is no hand of three fingers that feel.
    pub fn new(robot: &RobotModel, boards: PerFinger<B>) -> Result<Self, HandError> {
        let model = HandModel::try_new(robot)?;
        let mut index = 0;
        let members = boards.map(|board| {
            // There are three chains, or it would be no hand.
            let model = chain_model(robot, index).unwrap_or_else(|| robot.clone());
            index += 1;
            let name = model.chains.first().map_or_else(String::new, |chain| chain.name.to_string());
            Member {
                name,
                board,
                model,
                telemetry: None,
                tips: None,
                tick: None,
                sense: Sense::default(),
                tared: false,
                age: 0,
            }
        });
        Ok(Self { members, model, state: GraspState::NONE, steps: 0, armed: false })
    }

    /// The boards, in the order of the fingers.
    pub fn boards(&self) -> PerFinger<&B> {
        self.members.each_ref().map(|member| &member.board)
    }

    /// The same, to be used by hand.
    pub fn boards_mut(&mut self) -> PerFinger<&mut B> {
        self.members.each_mut().map(|member| &mut member.board)
    }

    /// What the hand does, as of the last step.
    pub fn telemetry(&self) -> GraspTelemetry {
        self.state.telemetry()
    }

    /// Whether the boards are armed, as far as known here.
    pub const fn is_armed(&self) -> bool {
        self.armed
    }

    /// Greets the boards, takes command of them, and gives each the model of its finger.
    ///
    /// # Errors
    /// The first board with which that does not work, and why.
    pub fn set_up(&mut self) -> Result<(), HandError> {
        self.each(|member| {
            member.board.hello()?;
            member.board.take_command(false)?;
            member.board.push_model(&member.model)?;
            member.board.set_rate(Stream::Telemetry, 1)?;
            member.board.set_rate(Stream::Tips, 1)
        })
    }

    /// Tells the boards at which angles [rad] the nine joints stand.
    ///
    /// # Errors
    /// The first board that refuses, and why.
    pub fn home(&mut self, positions: &PerFinger<[f32; 3]>) -> Result<(), HandError> {
        let mut positions = positions.iter();
        self.each(|member| member.board.home(positions.next().map_or(&[], |angles| angles)))
    }

    /// Nothing touches the tips: what their force sensors read now is taken off from now on.
    ///
    /// # Errors
    /// The first board that refuses, and why.
    pub fn tare(&mut self) -> Result<(), HandError> {
        self.each(|member| member.board.tare())
    }

    /// Arms all boards, or none. The first [step](Self::step) has to follow within the command timeout.
    ///
    /// # Errors
    /// The first board that refuses, is not heard or was not tared.
    pub fn arm(&mut self, servo: ServoMode) -> Result<(), HandError> {
        let deadline = Instant::now() + FIRST;
        for member in &mut self.members {
            (member.tick, member.age) = (None, 0);
            while member.tick.is_none() {
                member.listen()?;
                if member.tick.is_none() && Instant::now() >= deadline {
                    return Err(HandError::Stale { board: member.name.clone(), steps: 0 });
                }
            }
            if !member.tared {
                return Err(HandError::NotTared { board: member.name.clone() });
            }
        }
        let armed = self.each(|member| member.board.enable(TaskConfig::JointServo(servo)));
        if let Err(error) = armed {
            self.disarm();
            return Err(error);
        }
        // What was on its way while the boards were being armed still says otherwise.
        self.each(|member| {
            (member.telemetry, member.tips) = (None, None);
            member.board.listen().map(|_| ())
        })?;
        self.state = GraspState::at(self.members.each_ref().map(|member| member.sense.angles));
        self.armed = true;
        Ok(())
    }

    /// Tells the hand what to do next.
    ///
    /// # Errors
    /// Why it cannot; nothing has changed.
    pub fn command(&mut self, command: &GraspCommand) -> Result<(), HandError> {
        if !self.armed {
            return Err(HandError::NotArmed);
        }
        if let GraspCommand::Grasp(GraspPlan { control: ObjectControl::Wrench(_), .. }) = command {
            return Err(HandError::WrenchControl);
        }
        self.state.command(&self.model.hand(), command).map_err(HandError::GraspRefusal)
    }

    /// One control period: takes in what the fingers sense, and sends each board what to do next.
    ///
    /// # Errors
    /// A board is in fault, not armed or not heard, or refuses; or the object was lost. All boards have been
    /// told to stop then.
    pub fn step(&mut self) -> Result<GraspTelemetry, HandError> {
        if !self.armed {
            return Err(HandError::NotArmed);
        }
        self.steps = self.steps.wrapping_add(1);
        match self.advance() {
            Ok(()) => Ok(self.telemetry()),
            Err(mut error) => {
                self.stop();
                self.explain(&mut error);
                Err(error)
            }
        }
    }

    fn advance(&mut self) -> Result<(), HandError> {
        for member in &mut self.members {
            member.age += 1;
            member.listen()?;
            if member.age > MAX_AGE {
                return Err(HandError::Stale { board: member.name.clone(), steps: member.age });
            }
        }
        let hand = self.model.hand();
        let sensed = self.members.each_ref().map(|member| member.sense);
        let postures: PerFinger<Posture> =
            std::array::from_fn(|finger| hand.fingers[finger].chain.posture(&sensed[finger].angles));
        let senses = std::array::from_fn(|finger| {
            let Sense { angles, force } = sensed[finger];
            FingerSense { posture: &postures[finger], angles, force }
        });
        let command = self.state.tick(&hand, &senses).map_err(HandError::Lost)?;
        let guides = self.guides(&command);
        for (member, guide) in self.members.iter_mut().zip(guides) {
            let board = || member.name.clone();
            let posted = member.board.post(guide);
            posted.map_err(|source| HandError::Board { board: board(), source })?;
        }
        Ok(())
    }

    /// The command as set-points.
    fn guides(&self, command: &HandOutput) -> PerFinger<Request> {
        let hand = self.model.hand();
        let mut guides = [Request::Keep, Request::Keep, Request::Keep];
        let fingers = hand.fingers.iter().zip(command.points.iter().zip(&command.torques));
        for (guide, (finger, (points, torques))) in guides.iter_mut().zip(fingers) {
            let torques = torques.iter().zip(&finger.torque_limits);
            *guide = Request::Task(TaskCommand::JointServo(JointCommand::Guide {
                points: points.iter().copied().collect(),
                // A board refuses more than its joints have; on one board the servo would cut it off.
                torques: torques.map(|(torque, limit)| torque.clamp(-limit, *limit)).collect(),
            }));
        }
        guides
    }

    /// Tells all boards to stop at once with their model's reaction, and sends no more set-points.
    pub fn stop(&mut self) {
        self.armed = false;
        for member in &mut self.members {
            // Whom this does not reach, its command timeout stops.
            let _ = member.board.post(Request::Stop);
        }
    }

    /// Switches the outputs off: what is in the hand falls.
    pub fn disarm(&mut self) {
        self.armed = false;
        for member in &mut self.members {
            let _ = member.board.post(Request::Disable);
        }
    }

    /// Asks the board in fault for its fault, now that the others have been stopped.
    fn explain(&mut self, error: &mut HandError) {
        let HandError::Fault { board, fault } = error else { return };
        if let Some(member) = self.members.iter_mut().find(|member| member.name == *board)
            && let Ok(log) = member.board.faults()
        {
            *fault = log.faults.last().map(|last| last.named(&member.model).to_string());
        }
    }

    fn each(
        &mut self,
        mut action: impl FnMut(&mut Member<B>) -> Result<(), BoardError>,
    ) -> Result<(), HandError> {
        for member in &mut self.members {
            action(member).map_err(|source| HandError::Board { board: member.name.clone(), source })?;
        }
        Ok(())
    }
}

impl<B: FingerBoard> Member<B> {
    /// Takes what came from the board.
    fn listen(&mut self) -> Result<(), HandError> {
        let board = || self.name.clone();
        let news = self.board.listen().map_err(|source| HandError::Board { board: board(), source })?;
        if let Some(refusal) = news.refusal {
            return Err(HandError::Refused { board: board(), refusal });
        }
        self.telemetry = news.telemetry.or_else(|| self.telemetry.take());
        self.tips = news.tips.or_else(|| self.tips.take());
        match self.telemetry.as_ref().map(|telemetry| telemetry.mode) {
            Some(Mode::Fault) => return Err(HandError::Fault { board: board(), fault: None }),
            // Nobody listens between a first tick and arming.
            Some(Mode::Disabled) if self.tick.is_some() => {
                return Err(HandError::Disarmed { board: board() });
            }
            _ => {}
        }
        let (Some(telemetry), Some(tips)) = (&self.telemetry, &self.tips) else { return Ok(()) };
        let tick = telemetry.tick;
        let newer = self.tick.is_none_or(|last| (1..1 << 31).contains(&tick.wrapping_sub(last)));
        let ([a, b, c], [tip]) = (&telemetry.joints[..], &tips.tips[..]) else { return Ok(()) };
        if tips.tick == tick && newer {
            self.sense = Sense {
                angles: [a.position, b.position, c.position],
                // The tip feels what it touches; that feels the opposite.
                force: tip.force.map(|force| -force),
            };
            (self.tick, self.age, self.tared) = (Some(tick), 0, tip.tared);
        }
        Ok(())
    }
}

const _: () = assert!(FINGERS == 3);
