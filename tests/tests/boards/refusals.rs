//! Requests that three boards cannot carry out together.

use tesaki::control::ServoMode;
use tesaki::protocol::{Mode, Request};
use tesaki::task::grasping::{GraspCommand, GraspPlan, ObjectControl, WrenchGains};
use tesaki_description::robot::chain_model;
use tesaki_supervisor::Board;
use tesaki_supervisor::hand::{HandError, MultiBoardHand};

use super::rig::{Rig, natives};

#[test]
fn what_three_boards_cannot_do_is_said() {
    let mut rig = Rig::new(1, natives());
    let gains = WrenchGains { position: [50.0; 2], orientation: [0.1; 2], damping: 0.02, compensated: true };
    let plan = GraspPlan { control: ObjectControl::Wrench(gains), ..rig.plan };
    let refused = rig.hand().command(&GraspCommand::Grasp(plan)).unwrap_err();
    assert!(matches!(refused, HandError::WrenchControl), "{refused}");
    let plan = GraspPlan { feedback: false, ..rig.plan };
    let refused = rig.hand().command(&GraspCommand::Grasp(plan)).unwrap_err();
    assert!(matches!(refused, HandError::OpenLoop), "{refused}");
    let refused = rig.hand().command(&GraspCommand::PutDown).unwrap_err();
    assert_eq!(refused.to_string(), "not possible while the hand is ready; see docs/troubleshooting.md#busy");
    rig.wait(3);
    rig.hand().boards_mut()[1].request(Request::Disable).unwrap();
    let gone = rig.tick().unwrap_err();
    assert_eq!(gone.to_string(), "finger2_tip was disabled by another program, or reset");
    assert!(!rig.hand().is_enabled());
    assert_eq!(rig.hand().boards()[2].board.node().mode(), Mode::Fault);

    let finger = chain_model(&rig.robot.model, 0).unwrap();
    let none = MultiBoardHand::new(&finger, natives().unwrap()).map(|_| ()).unwrap_err();
    assert!(none.to_string().starts_with("hand3.finger1_tip is not a hand for grasping"), "{none}");
    assert!(chain_model(&finger, 1).is_none());
}

#[test]
fn a_link_that_breaks_when_all_boards_are_enabled_leaves_none_enabled() {
    let mut rig = Rig::new(1, natives());
    rig.hand().disable();
    rig.machine();
    rig.hand().boards_mut()[1].breaks = true;
    let broken = rig.hand().enable(ServoMode::Observer).unwrap_err();
    assert!(matches!(&broken, HandError::Board { board, .. } if board == "finger2_tip"), "{broken}");
    let modes = rig.hand().boards().map(|cable| cable.board.node().mode());
    assert_eq!(modes, [Mode::Disabled; 3]);
    rig.hand().boards_mut()[1].breaks = false;
    rig.machine();
    rig.hand().enable(ServoMode::Observer).unwrap();
}
