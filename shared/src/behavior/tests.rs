//! The behaviour before a simulated door: a hand that follows its commands, and a camera whose circles are
//! computed point by point.

use heapless::Vec;
use nalgebra::Vector3;

use super::*;
use crate::math::sqrt;
use crate::model::Pose;
use crate::task::visual_approach::{
    GripperState, HandMotion, VisualApproachCommand, VisualApproachRefusal, VisualApproachSettings,
    VisualApproachTelemetry,
};
use crate::vision::{Circle, HandEyeRow, HandEyeTable};

const STEP: f32 = 0.02;
/// Focal length [px], height of the camera above the axis and its distance behind the fingertips [m].
const FOCAL: f32 = 140.0;
const CAMERA: [f32; 2] = [0.05, 0.12];

/// A rose seen by a camera without tilt from a hand at `hand`, whose axes are those of the door.
fn seen(rose: &Vector3<f32>, radius: f32, hand: &Vector3<f32>) -> Circle {
    let place = rose - hand;
    let scale = FOCAL / (place.z + CAMERA[1]);
    Circle {
        center: [127.5 + scale * place.y, 119.5 + scale * (CAMERA[0] - place.x)],
        radius: scale * radius,
        semi_axes: [scale * radius; 2],
        angle: 0.0,
        confidence: 1.0,
    }
}

fn settings() -> ApproachSettings {
    let row = |distance: f32| {
        let circle = seen(&Vector3::new(0.0, 0.0, distance), 0.04, &Vector3::zeros());
        HandEyeRow { radius: circle.radius, center: circle.center, distance }
    };
    ApproachSettings {
        table: HandEyeTable::try_new(0.04, [0.0; 3], &[row(0.3), row(0.1), row(0.02)]).expect("valid"),
        expectation: KnobExpectation {
            rose: [0.035, 0.045],
            radius: 0.025,
            length: 0.056,
            distance: [0.13, 0.28],
            aside: 0.06,
        },
        grip_distance: 0.022,
        guard_distance: 0.075,
        tolerance: 0.004,
        speed: 0.12,
        near_speed: 0.05,
        opening: [-0.1, 0.1],
        pull: 0.02,
        retries: 2,
        patience: 8.0,
    }
}

/// A hand in front of a door with a knob of 25 mm radius whose end is 56 mm from the rim of its rose.
struct World {
    approach: Approach,
    rose: Vector3<f32>,
    radius: f32,
    has_knob: bool,
    hand: Vector3<f32>,
    target: Vector3<f32>,
    speed: f32,
    motion: HandMotion,
    gripper: GripperState,
    /// Time until the gripper has finished its motion [s].
    working: f32,
    /// Direction in which a contact ended a motion, and where.
    obstacle: Option<[Vector3<f32>; 2]>,
    time: f32,
    /// State of the noise generator.
    random: u32,
    /// Simulated faults: the camera takes no pictures; the gripper is stuck; the held object slips out at
    /// once, or when it is pulled; the held object comes along, and the closing fingers touched it behind
    /// them; the hand cannot move once it holds an object; the hand is stuck beside the knob.
    is_blind: bool,
    is_stuck: bool,
    slips: bool,
    loses: bool,
    is_loose: bool,
    is_stalled: bool,
    is_wedged: bool,
    /// Whether it has been pressing since the last step, and the number of motions that a contact has ended.
    presses: bool,
    blocks: u8,
}

impl World {
    fn new() -> Self {
        Self {
            approach: Approach::new(settings()),
            rose: Vector3::new(0.03, -0.04, 0.22),
            radius: 0.043,
            has_knob: true,
            hand: Vector3::zeros(),
            target: Vector3::zeros(),
            speed: 0.1,
            motion: HandMotion::Standing,
            gripper: GripperState::Still,
            working: 0.0,
            obstacle: None,
            time: 0.0,
            random: 1,
            is_blind: false,
            is_stuck: false,
            slips: false,
            loses: false,
            is_loose: false,
            is_stalled: false,
            is_wedged: false,
            presses: false,
            blocks: 0,
        }
    }

    /// Random number from −1 to 1.
    fn noise(&mut self) -> f32 {
        self.random = self.random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f32::from((self.random >> 16) as u16) / 32_768.0 - 1.0
    }

    fn report(&self) -> VisualApproachTelemetry {
        VisualApproachTelemetry {
            hand: Pose { translation: self.hand.into(), rotation: [0.0, 0.0, 0.0, 1.0] },
            latched: None,
            motion: self.motion,
            remaining: (self.target - self.hand).norm(),
            force: [0.0; 3],
            gripper: self.gripper,
            opening: 0.0,
        }
    }

    /// The rose, with errors of half a pixel.
    fn rose_seen(&mut self) -> Circle {
        let mut circle = seen(&self.rose, self.radius, &self.hand);
        let noise = [self.noise(), self.noise(), self.noise()];
        circle.center = [circle.center[0] + 0.5 * noise[0], circle.center[1] + 0.5 * noise[1]];
        circle.radius += 0.5 * noise[2];
        circle
    }

    /// Position of the hand relative to the knob: distance of the fingertips from the rim of the rose, and
    /// from the axis.
    fn place(&self) -> [f32; 2] {
        let place = self.rose - self.hand;
        [place.z, sqrt(place.x * place.x + place.y * place.y)]
    }

    /// Runs the behaviour with the simulated camera until it ends.
    fn run(&mut self, mut camera: impl FnMut(&mut Self) -> Option<Circle>) -> ApproachPhase {
        for step in 0..5000 {
            let report = self.report();
            let order = self.approach.update(&report, STEP);
            if order.look && step % 5 == 0 {
                let circle = camera(self);
                if !self.is_blind {
                    self.approach.look(&report.hand, circle.as_ref());
                }
            }
            if let Some(command) = order.command {
                self.take(&command);
            }
            if matches!(self.approach.phase(), ApproachPhase::Done | ApproachPhase::Failed(_)) {
                return self.approach.phase();
            }
            self.step();
        }
        panic!("the behaviour never ends: {:?}", self.approach.phase());
    }

    fn take(&mut self, command: &VisualApproachCommand) {
        match *command {
            VisualApproachCommand::Move { position, speed } => {
                if self.is_stalled && self.gripper == GripperState::Holding {
                    self.motion = HandMotion::Blocked;
                    return;
                }
                let target = Vector3::from(position);
                let ahead = self.obstacle.map_or(0.0, |[direction, place]| direction.dot(&(target - place)));
                if ahead > 1e-3 {
                    self.approach.refused(&VisualApproachRefusal::Blocked { ahead });
                    return;
                }
                if self.motion != HandMotion::Blocked || target != self.target {
                    (self.target, self.speed, self.motion) = (target, speed, HandMotion::Moving);
                }
            }
            VisualApproachCommand::Open
                if !matches!(self.gripper, GripperState::Open | GripperState::Opening) =>
            {
                (self.gripper, self.working) = (GripperState::Opening, 0.3);
            }
            VisualApproachCommand::Close
                if matches!(
                    self.gripper,
                    GripperState::Open | GripperState::Still | GripperState::Opening
                ) =>
            {
                (self.gripper, self.working) = (GripperState::Closing, 0.5);
            }
            VisualApproachCommand::Acknowledge => (self.target, self.obstacle) = (self.hand, None),
            VisualApproachCommand::Stand => (self.target, self.motion) = (self.hand, HandMotion::Moving),
            _ => {}
        }
    }

    /// A contact ends the motion along `way`.
    fn block(&mut self, way: Vector3<f32>) {
        self.motion = HandMotion::Blocked;
        self.obstacle = Some([way.normalize(), self.hand]);
    }

    fn step(&mut self) {
        self.time += STEP;
        self.working -= STEP;
        let [distance, aside] = self.place();
        let was = self.gripper;
        if self.working < 0.0 {
            self.gripper = match self.gripper {
                GripperState::Opening if self.is_stuck => GripperState::Opening,
                GripperState::Opening => GripperState::Open,
                GripperState::Closing if self.has_knob && !self.slips && distance < 0.045 && aside < 0.02 => {
                    GripperState::Holding
                }
                GripperState::Closing => GripperState::Empty,
                GripperState::Holding if self.loses && self.motion == HandMotion::Blocked => {
                    GripperState::Empty
                }
                other => other,
            };
        }
        if self.is_loose && self.gripper == GripperState::Holding && was != GripperState::Holding {
            self.block(-Vector3::z());
        }
        self.obstacle =
            self.obstacle.filter(|[direction, place]| direction.dot(&(self.hand - place)) > -0.01);
        if self.motion != HandMotion::Moving {
            return;
        }
        let way = self.target - self.hand;
        let beside = distance < 0.05;
        assert!(!beside || self.speed <= self.approach.settings().near_speed, "{} m/s beside", self.speed);
        let is_held = self.gripper == GripperState::Holding && !self.is_loose && way.norm() > 1e-3;
        if is_held || self.is_wedged && beside && way.z < 0.0 {
            // A contact is detected in the next step.
            if self.presses {
                self.blocks += 1;
                self.block(way);
            }
            self.presses = !self.presses;
            return;
        }
        let step = self.speed * STEP;
        if way.norm() <= step {
            (self.hand, self.motion) = (self.target, HandMotion::Standing);
        } else {
            self.hand += way * (step / way.norm());
        }
        // The door stops the fingers.
        if self.place()[0] < 2e-3 {
            self.hand.z = self.rose.z - 2e-3;
            self.block(way);
        }
        // The open fingers pass a knob within 20 mm of their centre, and the palm stops at the door.
        let [distance, aside] = self.place();
        assert!(
            !self.has_knob || distance > 0.056 || aside < 0.02,
            "the fingers are in the knob: {aside} m aside"
        );
    }
}

#[test]
fn the_knob_is_held_within_ten_seconds() {
    let mut world = World::new();
    let phase = world.run(|world| Some(world.rose_seen()));
    assert_eq!(phase, ApproachPhase::Done);
    assert!(world.time < 10.0, "{} s", world.time);
    let [distance, aside] = world.place();
    assert!((0.01..0.035).contains(&distance) && aside < 3e-3, "{distance} m, {aside} m aside");
    let rose = world.approach.rose().expect("known");
    assert!((rose.radius() - 0.043).abs() < 1.5e-3, "{} m", rose.radius());
}

#[test]
fn circles_of_the_knob_in_place_of_the_rose_do_not_mislead() {
    let mut world = World::new();
    let phase = world.run(|world| {
        if world.noise() < -0.6 {
            let end = world.rose - Vector3::new(0.0, 0.0, 0.056);
            Some(seen(&end, 0.025, &world.hand))
        } else {
            Some(world.rose_seen())
        }
    });
    assert_eq!((phase, world.approach.tries()), (ApproachPhase::Done, 0));
}

#[test]
fn where_there_is_no_rose_the_hand_stays() {
    let mut world = World::new();
    assert_eq!(world.run(|_| None), ApproachPhase::Failed(Reason::NotFound));
    // It has looked from positions a few centimetres aside, and never moved towards the door.
    assert!(world.hand.norm() < 0.05 && world.hand.z < 0.021, "{:?}", world.hand);
}

#[test]
fn circles_of_little_confidence_count_as_none() {
    let see = |confidence: f32| {
        let mut world = World::new();
        world.run(|world| Some(Circle { confidence, ..world.rose_seen() }))
    };
    assert_eq!(see(0.349), ApproachPhase::Failed(Reason::NotFound));
    assert_eq!(see(0.35), ApproachPhase::Done);
    assert_eq!(see(f32::NAN), ApproachPhase::Failed(Reason::NotFound));
}

#[test]
fn circles_of_no_size_leave_the_estimate_as_it_is() {
    let ApproachSettings { table, expectation, .. } = settings();
    let hand = nalgebra::Isometry3::identity();
    let mut rose = RoseEstimate::expected(&expectation, &hand);
    let before = rose.clone();
    let circle = Circle { radius: 1e-30, ..seen(&Vector3::new(0.0, 0.0, 0.2), 0.04, &Vector3::zeros()) };
    for rim in [Rim::Rose, Rim::Knob] {
        rose.assume(&table, &expectation, &hand, &circle, rim);
    }
    assert_eq!((rose.place(), rose.radius(), rose.cost()), (before.place(), before.radius(), before.cost()));
}

#[test]
fn circles_that_jump_about_lead_nowhere() {
    let mut world = World::new();
    let phase = world.run(|world| {
        let center = [127.5 + 100.0 * world.noise(), 119.5 + 100.0 * world.noise()];
        let radius = 19.0 + 5.0 * world.noise();
        Some(Circle { center, radius, ..seen(&world.rose, world.radius, &world.hand) })
    });
    assert!(matches!(phase, ApproachPhase::Failed(Reason::NotFound | Reason::Lost)), "{phase:?}");
}

#[test]
fn a_rose_that_is_lost_is_looked_for_from_where_the_hand_began() {
    let mut world = World::new();
    let mut hidden_at = None;
    let phase = world.run(|world| {
        // Someone stands before it for four seconds.
        if world.place()[0] < 0.15 && hidden_at.is_none() {
            hidden_at = Some(world.time);
        }
        let hidden = hidden_at.is_some_and(|begin| world.time < begin + 4.0);
        if hidden { None } else { Some(world.rose_seen()) }
    });
    assert_eq!((phase, world.approach.tries()), (ApproachPhase::Done, 1));
}

#[test]
fn a_knob_that_is_not_there_is_not_held() {
    let mut world = World { has_knob: false, ..World::new() };
    let phase = world.run(|world| Some(world.rose_seen()));
    assert_eq!(phase, ApproachPhase::Failed(Reason::NotHeld));
    assert_eq!(world.approach.tries(), 3);
    // Back at its start.
    assert!(world.hand.norm() < 0.05, "{:?}", world.hand);
}

#[test]
fn what_the_hand_runs_into_ends_the_try() {
    let mut world = World::new();
    let phase = world.run(|world| {
        if world.place()[0] < 0.15 && world.motion == HandMotion::Moving && world.target.z > world.hand.z {
            world.motion = HandMotion::Blocked;
        }
        Some(world.rose_seen())
    });
    // Also during the retreat to the next position for pictures.
    assert!(matches!(phase, ApproachPhase::Failed(Reason::Blocked | Reason::Late)), "{phase:?}");
}

#[test]
fn a_refusal_that_comes_after_the_end_changes_nothing() {
    let mut world = World::new();
    assert_eq!(world.run(|world| Some(world.rose_seen())), ApproachPhase::Done);
    world.approach.refused(&VisualApproachRefusal::Target { distance: 1.0, reach: 0.5 });
    assert_eq!(world.run(|world| Some(world.rose_seen())), ApproachPhase::Done);
}

#[test]
fn from_beside_a_knob_that_is_not_held_the_hand_goes_straight_back_and_slowly() {
    // The simulation panics when the fingers hit the knob, or move fast beside it.
    let mut world = World { slips: true, ..World::new() };
    assert_eq!(world.run(|world| Some(world.rose_seen())), ApproachPhase::Failed(Reason::NotHeld));
    assert_eq!(world.approach.tries(), 3);
}

/// The contact that ended the pull is in the way of the retreat.
#[test]
fn a_knob_that_is_lost_in_the_pull_is_tried_again() {
    let mut world = World { loses: true, ..World::new() };
    assert_eq!(world.run(|world| Some(world.rose_seen())), ApproachPhase::Failed(Reason::NotHeld));
    assert_eq!(world.approach.tries(), 3);
}

#[test]
fn a_hand_that_is_held_fast_beside_the_knob_pulls_twice() {
    let mut world = World { slips: true, is_wedged: true, ..World::new() };
    assert_eq!(world.run(|world| Some(world.rose_seen())), ApproachPhase::Failed(Reason::Blocked));
    assert_eq!(world.blocks, 2);
}

#[test]
fn a_camera_that_dies_beside_the_knob_ends_the_try() {
    let mut world = World { slips: true, ..World::new() };
    let mut grips = 0;
    let phase = world.run(|world| {
        world.is_blind |= world.place()[0] < 0.045;
        grips += u8::from(world.gripper == GripperState::Closing);
        Some(world.rose_seen())
    });
    assert_eq!(phase, ApproachPhase::Failed(Reason::NoPictures));
    let mut world = World { is_blind: true, ..World::new() };
    assert_eq!(world.run(|_| None), ApproachPhase::Failed(Reason::NoPictures));
    assert!(world.time < 10.0, "{} s", world.time);
}

#[test]
fn a_contact_from_before_the_pull_is_no_proof_of_a_grip() {
    let mut world = World { is_stalled: true, ..World::new() };
    let phase = world.run(|world| Some(world.rose_seen()));
    assert!(matches!(phase, ApproachPhase::Failed(_)), "{phase:?}");
}

#[test]
fn a_contact_that_refuses_the_pull_is_no_proof_of_a_grip() {
    let mut world = World { is_loose: true, ..World::new() };
    assert_eq!(world.run(|world| Some(world.rose_seen())), ApproachPhase::Failed(Reason::NotHeld));
}

/// The report after the command to open still shows the gripper that jammed while it closed.
#[test]
fn a_gripper_that_jammed_is_opened_again_though_reports_are_late() {
    let mut approach = Approach::new(settings());
    let world = World::new();
    let mut report = world.report();
    report.gripper = GripperState::Open;
    for _ in 0..400 {
        if approach.phase() == ApproachPhase::Grip {
            break;
        }
        approach.look(&report.hand, Some(&seen(&world.rose, 0.04, &report.hand.translation.into())));
        if let Some(VisualApproachCommand::Move { position, .. }) = approach.update(&report, STEP).command {
            report.hand.translation = position;
        }
    }
    assert_eq!(approach.phase(), ApproachPhase::Grip);
    report.gripper = GripperState::Jammed;
    for _ in 0..3 {
        let order = approach.update(&report, STEP);
        assert_eq!(order.command, Some(VisualApproachCommand::Open));
    }
    report.gripper = GripperState::Open;
    approach.update(&report, STEP);
    assert!(!matches!(approach.phase(), ApproachPhase::Failed(_)), "{:?}", approach.phase());
}

#[test]
fn a_gripper_that_never_opens_is_named() {
    let mut world = World { is_stuck: true, ..World::new() };
    assert_eq!(world.run(|world| Some(world.rose_seen())), ApproachPhase::Failed(Reason::Gripper));
    let mut world = World { gripper: GripperState::Jammed, ..World::new() };
    let report = world.report();
    for _ in 0..11 {
        world.approach.update(&report, STEP);
    }
    assert_eq!(world.approach.phase(), ApproachPhase::Failed(Reason::Gripper));
}

#[test]
fn the_way_to_the_knob_has_one_deadline_however_often_it_is_centred_again() {
    let mut world = World { has_knob: false, ..World::new() };
    let (mut side, mut way, mut longest) = (0.012, 0.0_f32, 0.0_f32);
    // The rose seems to jump aside repeatedly.
    world.run(|world| {
        if world.time % 1.2 < 0.1 {
            side = -side;
        }
        way = if matches!(world.approach.phase(), ApproachPhase::Center | ApproachPhase::Advance) {
            way + 0.1
        } else {
            0.0
        };
        longest = longest.max(way);
        Some(seen(&(world.rose + Vector3::new(side, 0.0, 0.0)), world.radius, &world.hand))
    });
    assert!(longest < 8.3, "{longest} s");
}

#[test]
fn standing_before_the_knob_counts_anew_in_every_try() {
    let mut world = World::new();
    // The hand has stood for a long time before the rose is seen: both explanations must still be considered.
    let mut looks = 0;
    let mut explanations = Vec::<usize, 64>::new();
    world.run(|world| {
        looks += 1;
        if world.approach.phase() == ApproachPhase::Center {
            let _ = explanations.push(world.approach.explanations());
        }
        (looks > 15).then(|| world.rose_seen())
    });
    assert_eq!(explanations.first(), Some(&2));
    assert_eq!(explanations.last(), Some(&1));
}

#[test]
fn a_refused_command_ends_the_try_with_its_reason() {
    let begun = || {
        let mut world = World::new();
        let report = world.report();
        world.approach.update(&report, STEP);
        world.approach
    };
    let mut approach = begun();
    let speed = VisualApproachRefusal::Speed { value: 0.2, limit: 0.1 };
    approach.refused(&speed);
    assert_eq!(approach.phase(), ApproachPhase::Failed(Reason::Refused(speed)));
    let mut approach = begun();
    approach.refused(&VisualApproachRefusal::Target { distance: 0.6, reach: 0.5 });
    assert_eq!((approach.phase(), approach.tries()), (ApproachPhase::Retreat, 1));
    // A report of the contact may still be on its way.
    let mut approach = begun();
    for _ in 0..4 {
        approach.refused(&VisualApproachRefusal::Blocked { ahead: 0.1 });
        assert_eq!(approach.phase(), ApproachPhase::Look);
    }
    approach.refused(&VisualApproachRefusal::Blocked { ahead: 0.1 });
    assert_eq!(approach.phase(), ApproachPhase::Retreat);
}

#[test]
fn an_obstacle_that_is_no_longer_reported_is_acknowledged_in_the_retreat() {
    let mut world = World::new();
    world.gripper = GripperState::Open;
    let report = world.report();
    world.approach.update(&report, STEP);
    world.approach.refused(&VisualApproachRefusal::Target { distance: 0.6, reach: 0.5 });
    // The hand stands, and every motion is refused.
    let mut acknowledged = 0;
    for _ in 0..300 {
        match world.approach.update(&report, STEP).command {
            Some(VisualApproachCommand::Move { .. }) => {
                world.approach.refused(&VisualApproachRefusal::Blocked { ahead: 0.1 });
            }
            Some(VisualApproachCommand::Acknowledge) => acknowledged += 1,
            _ => {}
        }
    }
    assert_eq!(acknowledged, 1);
    assert_eq!(world.approach.phase(), ApproachPhase::Failed(Reason::Blocked));
}

#[test]
fn a_retreat_that_is_refused_after_a_limited_motion_goes_on() {
    let mut world = World::new();
    (world.gripper, world.motion) = (GripperState::Open, HandMotion::Limited);
    let report = world.report();
    world.approach.update(&report, STEP);
    world.approach.refused(&VisualApproachRefusal::Target { distance: 0.6, reach: 0.5 });
    assert_eq!(world.approach.phase(), ApproachPhase::Retreat);
    let mut acknowledged = 0;
    for _ in 0..20 {
        match world.approach.update(&report, STEP).command {
            Some(VisualApproachCommand::Move { .. }) if acknowledged == 0 => {
                world.approach.refused(&VisualApproachRefusal::Blocked { ahead: 0.02 });
            }
            Some(VisualApproachCommand::Acknowledge) => acknowledged += 1,
            _ => {}
        }
    }
    assert_eq!((acknowledged, world.approach.phase()), (1, ApproachPhase::Retreat));
}

#[test]
fn a_knob_beyond_the_reach_is_refused_by_name() {
    let task = VisualApproachSettings { speed: 0.15, reach: 0.5, ..VisualApproachSettings::DEFAULT };
    assert_eq!(settings().validate(&task), Ok(()));
    // 0.28 − 0.022 + 0.04 = 0.298 m ahead and 0.085 m aside: 0.31 m.
    let refused = settings().validate(&VisualApproachSettings { reach: 0.30, ..task }).expect_err("too far");
    assert_eq!(refused.field, "distance");
    assert!((refused.max - 0.2697).abs() < 1e-3, "{}", refused.max);
    assert_eq!(settings().validate(&VisualApproachSettings { reach: 0.32, ..task }), Ok(()));
    let mut aside = settings();
    for distance in [0.4, f32::NAN] {
        aside.expectation.aside = distance;
        let refused = aside.validate(&task).expect_err("too far aside");
        assert_eq!((refused.field, refused.max), ("aside", 0.25));
    }
}
