//! The behaviour that guides the task: look, centre, advance, grip, verify (Knob §4.5).

use heapless::Vec;
use nalgebra::{Isometry3, Point3, Vector3};

use super::rose::{Rim, RoseEstimate};
use super::{ApproachPhase, ApproachSettings, Reason};
use crate::math::{abs, norm, sqrt};
use crate::model::Pose;
use crate::task::visual_approach::{
    GripperState, HandMotion, VisualApproachCommand, VisualApproachRefusal, VisualApproachTelemetry,
};
use crate::vision::{Circle, CircleSearch, Window};

/// Circles with less confidence are ignored.
const MIN_CONFIDENCE: f32 = 0.35;
/// Number of first circles that are compared, and how many of them must agree.
const FIRST_LOOKS: usize = 7;
const AGREEING: usize = 4;
/// Circles agree if their centres differ by less than this [px], and their radii by less than this share.
const SAME_CENTER: f32 = 4.0;
const SAME_RADIUS: f32 = 0.12;
/// One explanation of the circles is accepted when the cost of the other is higher by this amount.
const DECIDED: f32 = 15.0;
/// After the hand has waited for this time [s], within this distance of its target before the possible knob
/// [m], the likelier explanation is accepted.
const DECISION_PLACE: f32 = 5e-3;
const DECISION_TIME: f32 = 0.7;
/// The rose is lost after this time without a picture, or without the rose in one [s].
const LOST: f32 = 1.5;
/// Remaining distance at which the hand has arrived at the grip position [m].
const AT_GRIP: f32 = 2e-3;
/// A contact within this distance of the estimated grip position [m] starts the grip.
const NEAR_GRIP: f32 = 0.015;
/// Positions from which further tries look for the rose, in the frame of the hand at the start [m]:
/// reflections and shadows look different from there.
const VIEWS: [[f32; 3]; 4] = [[0.03, 0.0, -0.02], [0.0, 0.03, 0.0], [0.0, -0.03, 0.02], [-0.02, 0.0, 0.0]];
/// After an empty grip the hand advances by this distance [m], at most this often.
pub const DEEPER: f32 = 0.02;
pub const DEEPER_TRIES: u8 = 2;
/// Maximum standard deviation of the distance with which the hand advances [m].
const DEPTH_ERROR: f32 = 0.015;
/// The grip is tested by a pull once the fingers have stayed within this angle for this time [rad, s].
const FINGERS_REST: f32 = 0.01;
const SETTLING: f32 = 0.15;
/// A report may be older than the command that ended what it shows, up to this time [s].
const STALE: f32 = 0.2;
/// The grip is verified when the gripper still holds the knob this long after the pull was stopped [s].
const HELD: f32 = 0.2;
/// Number of motions in a phase that the board may refuse because of a contact that it has not reported yet.
const LATE_REPORTS: u8 = 5;
/// Distances from the goal within which the hand has withdrawn from the knob, and has retreated [m].
const WITHDRAWN: f32 = 3e-3;
const RETREATED: f32 = 0.01;
/// Number of contacts during the retreat with which the behaviour fails.
const MAX_BLOCKS: u8 = 2;

/// Output of the behaviour.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Order {
    /// Command for the board.
    pub command: Option<VisualApproachCommand>,
    /// Whether pictures are needed.
    pub look: bool,
}

/// The master behaviour of the paper: its inputs are circles and the board's reports, its outputs commands.
/// It reads no clock and sends nothing itself.
#[derive(Clone, Debug)]
pub struct Approach {
    settings: ApproachSettings,
    phase: ApproachPhase,
    /// Time in this phase [s]. Centring and advancing count as one.
    time: f32,
    /// Pose of the hand at the start.
    home: Option<Isometry3<f32>>,
    /// The first circles of a try.
    first: Vec<(Isometry3<f32>, Circle), FIRST_LOOKS>,
    /// Possible explanations of the circles, the likelier one first.
    rose: Vec<RoseEstimate, 2>,
    /// Time since the last picture, and since the last one that showed the rose [s], in phases that need
    /// pictures.
    blind: f32,
    missed: f32,
    /// Time for which the hand has been waiting before the knob [s].
    waiting: f32,
    /// Depth along the approach direction beyond which the fingers are beside the knob [m].
    beside: Option<f32>,
    /// Whether a motion was ordered in this phase, and whether the hand has moved since then.
    has_ordered: bool,
    has_moved: bool,
    /// A motion was refused because of a contact or of what limited the one before.
    was_refused: bool,
    /// Contacts, and refused motions, in this phase.
    blocks: u8,
    refused: u8,
    /// Opening of the fingers [rad], and time for which they have rested there [s].
    fingers: (f32, f32),
    /// Tries so far.
    tries: u8,
    /// How often the hand has advanced in this try after an empty grip.
    deeper: u8,
    /// Why the last try ended.
    reason: Reason,
    /// Position of the hand, and its goal while it pulls or retreats [m].
    hand: Vector3<f32>,
    goal: Vector3<f32>,
    /// First goal of a retreat: straight back from the knob [m].
    withdrawal: Option<Vector3<f32>>,
}

impl Approach {
    /// The behaviour at its start.
    pub const fn new(settings: ApproachSettings) -> Self {
        Self {
            settings,
            phase: ApproachPhase::Look,
            time: 0.0,
            home: None,
            first: Vec::new(),
            rose: Vec::new(),
            blind: 0.0,
            missed: 0.0,
            waiting: 0.0,
            beside: None,
            has_ordered: false,
            has_moved: false,
            was_refused: false,
            blocks: 0,
            refused: 0,
            fingers: (0.0, 0.0),
            tries: 0,
            deeper: 0,
            reason: Reason::NotFound,
            hand: Vector3::new(0.0, 0.0, 0.0),
            goal: Vector3::new(0.0, 0.0, 0.0),
            withdrawal: None,
        }
    }

    /// The present phase.
    pub const fn phase(&self) -> ApproachPhase {
        self.phase
    }

    /// Estimate of the rose; `None` until it is found.
    pub fn rose(&self) -> Option<&RoseEstimate> {
        self.rose.first()
    }

    /// Its settings.
    pub const fn settings(&self) -> &ApproachSettings {
        &self.settings
    }

    /// Number of remaining explanations of the circles.
    #[cfg(test)]
    pub(super) fn explanations(&self) -> usize {
        self.rose.len()
    }

    /// Tries that have ended without success.
    pub const fn tries(&self) -> u8 {
        self.tries
    }

    /// The circle to search for in a picture that was taken from `hand`, the pose of the hand frame in the
    /// base frame.
    pub fn search(&self, hand: &Pose) -> CircleSearch {
        let (table, expectation) = (&self.settings.table, &self.settings.expectation);
        let hand = hand.isometry();
        // Until it is decided, each explanation may be right.
        let searches = self.rose.iter().map(|rose| rose.search(table, expectation, &hand));
        if let Some(search) = searches.reduce(|one, other| union(&one, &other)) {
            return search;
        }
        let expected = RoseEstimate::expected(expectation, &hand).search(table, expectation, &hand);
        let radius = |distance: f32, radius: f32| table.appearance(&[0.0, 0.0, distance], radius).1;
        let ([near, far], [small, large]) = (expectation.distance, expectation.rose);
        CircleSearch { radius: [radius(far, small), radius(near, large)], window: None, ..expected }
    }

    /// Takes the circle that was found in a picture, if any; `hand` as in [`search`](Self::search). A circle
    /// whose confidence is below 0.35 counts as none.
    pub fn look(&mut self, hand: &Pose, circle: Option<&Circle>) {
        let circle = circle.filter(|circle| Self::is_credible(circle));
        let hand = hand.isometry();
        self.blind = 0.0;
        if self.rose.is_empty() {
            let Some(circle) = circle.filter(|_| self.phase == ApproachPhase::Look) else { return };
            if self.first.is_full() {
                self.first.remove(0);
            }
            let _ = self.first.push((hand, *circle));
            self.begin_estimates();
            return;
        }
        let ApproachSettings { table, expectation, .. } = &self.settings;
        let mut fits = false;
        if let Some(circle) = circle {
            for (index, rose) in self.rose.iter_mut().enumerate() {
                fits |= rose.update(table, expectation, &hand, circle).is_some() && index == 0;
            }
        }
        if fits {
            self.missed = 0.0;
        }
        if let [one, other] = &*self.rose {
            let ahead = other.cost() - one.cost();
            if ahead < 0.0 {
                self.rose.swap(0, 1);
            }
            if abs(ahead) > DECIDED {
                self.rose.truncate(1);
            }
        }
    }

    /// Whether [`look`](Self::look) takes the circle into account: its confidence is at least 0.35.
    pub fn is_credible(circle: &Circle) -> bool {
        circle.confidence >= MIN_CONFIDENCE
    }

    /// Creates the estimates from the largest group of first circles that agree, once it is large enough. One
    /// estimate assumes that they are all the rose, the other that they are all the end of the knob.
    fn begin_estimates(&mut self) {
        let agree = |one: &Circle, other: &Circle| {
            (0..2).all(|axis| abs(one.center[axis] - other.center[axis]) < SAME_CENTER)
                && abs(one.radius - other.radius) < SAME_RADIUS * one.radius
        };
        let group = |middle: &Circle| self.first.iter().filter(|(_, circle)| agree(middle, circle)).count();
        let Some((hand, middle)) = self.first.iter().max_by_key(|(_, circle)| group(circle)) else { return };
        if group(middle) < AGREEING {
            return;
        }
        let ApproachSettings { table, expectation, .. } = &self.settings;
        for rim in [Rim::Rose, Rim::Knob] {
            let mut rose = RoseEstimate::expected(expectation, hand);
            for (hand, circle) in self.first.iter().filter(|(_, circle)| agree(middle, circle)) {
                rose.assume(table, expectation, hand, circle, rim);
            }
            let _ = self.rose.push(rose);
        }
        self.missed = 0.0;
    }

    /// Handles a refused command. A refusal because of a contact that is not reported yet is expected; a
    /// target out of reach ends the try, others the behaviour.
    pub fn refused(&mut self, refusal: &VisualApproachRefusal) {
        if matches!(self.phase, ApproachPhase::Done | ApproachPhase::Failed(_)) {
            // It concerns a command from before the end.
            return;
        }
        self.refused = self.refused.saturating_add(1);
        match *refusal {
            // The pull was stopped by a contact before its motion was reported, or that contact is in the way
            // of the retreat.
            VisualApproachRefusal::Blocked { .. }
                if matches!(self.phase, ApproachPhase::Verify | ApproachPhase::Retreat) =>
            {
                self.was_refused = true
            }
            VisualApproachRefusal::Blocked { .. } if self.refused < LATE_REPORTS => {}
            VisualApproachRefusal::Blocked { .. } => self.retry(Reason::Blocked),
            VisualApproachRefusal::Target { .. } => self.retry(Reason::OutOfReach),
            refusal => self.enter(ApproachPhase::Failed(Reason::Refused(refusal))),
        }
    }

    /// Advances by `elapsed` [s] since the last call, with the board's newest report.
    pub fn update(&mut self, report: &VisualApproachTelemetry, elapsed: f32) -> Order {
        let hand = report.hand.isometry();
        let home = *self.home.get_or_insert(hand);
        self.hand = hand.translation.vector;
        if matches!(self.phase, ApproachPhase::Done | ApproachPhase::Failed(_)) {
            return self.ended();
        }
        self.time += elapsed;
        self.waiting += elapsed;
        self.blind += elapsed;
        self.missed += elapsed;
        self.has_moved |= self.has_ordered && report.motion == HandMotion::Moving;
        let looks =
            matches!(self.phase, ApproachPhase::Look | ApproachPhase::Center | ApproachPhase::Advance);
        let should_open = looks || self.phase == ApproachPhase::Retreat;
        let is_late = self.time > self.settings.patience;
        let is_jammed = report.gripper == GripperState::Jammed && self.time > STALE;
        if should_open && (is_jammed || is_late && report.gripper != GripperState::Open) {
            self.enter(ApproachPhase::Failed(Reason::Gripper));
        } else if looks && self.blind > LOST {
            self.retry(Reason::NoPictures);
        } else if is_late {
            self.retry(if self.phase == ApproachPhase::Look { Reason::NotFound } else { Reason::Late });
        }
        match self.phase {
            ApproachPhase::Look => self.begin_motion(report),
            ApproachPhase::Center | ApproachPhase::Advance => self.approach(report, &hand, &home),
            ApproachPhase::Grip => self.grip(report, &home, elapsed),
            ApproachPhase::Verify => self.verify(report),
            ApproachPhase::Retreat => self.retreat(report),
            ApproachPhase::Done | ApproachPhase::Failed(_) => self.ended(),
        }
    }

    fn ended(&self) -> Order {
        let command = (self.phase != ApproachPhase::Done).then_some(VisualApproachCommand::Stand);
        Order { command, look: false }
    }

    fn enter(&mut self, phase: ApproachPhase) {
        self.phase = phase;
        (self.time, self.waiting, self.blind, self.missed) = (0.0, 0.0, 0.0, 0.0);
        (self.has_ordered, self.has_moved, self.was_refused) = (false, false, false);
        (self.blocks, self.refused) = (0, 0);
        self.fingers = (0.0, 0.0);
    }

    /// Gives up this try: retreats for another one, or fails.
    fn retry(&mut self, reason: Reason) {
        let Some(home) = self.home.filter(|_| self.phase != ApproachPhase::Retreat) else {
            self.enter(ApproachPhase::Failed(reason));
            return;
        };
        self.tries = self.tries.saturating_add(1);
        self.reason = reason;
        let [x, y, z] = VIEWS[usize::from(self.tries - 1) % VIEWS.len()];
        self.goal = (home * Point3::new(x, y, z)).coords;
        let ahead = home.rotation * Vector3::z();
        let back = self.beside.map_or(0.0, |depth| ahead.dot(&self.hand) - depth);
        self.withdrawal = (back > 0.0).then(|| self.hand - ahead * back);
        self.enter(ApproachPhase::Retreat);
    }

    /// Handles a grip without the knob: it may be farther away than estimated, unless there was a contact.
    fn miss(&mut self, report: &VisualApproachTelemetry) -> Order {
        let is_free = report.motion != HandMotion::Blocked;
        if self.deeper < DEEPER_TRIES && self.rose.len() == 1 && is_free && self.phase == ApproachPhase::Grip
        {
            self.deeper += 1;
            self.enter(ApproachPhase::Advance);
        } else {
            self.retry(Reason::NotHeld);
        }
        Order { command: Some(VisualApproachCommand::Open), look: false }
    }

    fn begin_motion(&mut self, report: &VisualApproachTelemetry) -> Order {
        if !self.rose.is_empty() && report.gripper == GripperState::Open {
            self.enter(ApproachPhase::Center);
        }
        Order { command: Some(VisualApproachCommand::Open), look: true }
    }

    fn approach(
        &mut self,
        report: &VisualApproachTelemetry,
        hand: &Isometry3<f32>,
        home: &Isometry3<f32>,
    ) -> Order {
        let wait = Order { command: None, look: true };
        let ApproachSettings { guard_distance, tolerance, speed, near_speed, .. } = self.settings;
        let grip_distance = self.settings.grip_distance - f32::from(self.deeper) * DEEPER;
        let Some(rose) = self.rose.first() else { return wait };
        if report.gripper != GripperState::Open {
            return Order { command: Some(VisualApproachCommand::Open), look: true };
        }
        let seen = hand.inverse_transform_point(&rose.place());
        let distance = seen.z;
        let aside = sqrt(seen.x * seen.x + seen.y * seen.y);
        let ahead = home.rotation * Vector3::z();
        let is_known = rose.deviation(&ahead) < DEPTH_ERROR;
        let may_advance = aside < tolerance && is_known && self.rose.len() == 1;
        // Once beside the knob, the fingers stay there.
        if may_advance && distance < guard_distance - tolerance && self.beside.is_none() {
            self.beside = Some(ahead.dot(&self.hand));
        }
        let goes_on = may_advance || self.beside.is_some();
        let stop = if goes_on { grip_distance } else { guard_distance };
        // Until the explanation is decided, the hand keeps its distance from both.
        let nearest = self
            .rose
            .iter()
            .map(|rose| hand.inverse_transform_point(&rose.place()).z)
            .fold(distance, f32::min);
        let place = rose.place() - ahead * (distance - nearest);
        if self.missed > LOST && self.beside.is_none() {
            self.retry(Reason::Lost);
            return wait;
        }
        match report.motion {
            HandMotion::Blocked if distance < self.settings.grip_distance + NEAR_GRIP => {
                self.enter(ApproachPhase::Grip);
                return Order { command: Some(VisualApproachCommand::Close), look: false };
            }
            HandMotion::Blocked => {
                self.retry(Reason::Blocked);
                return wait;
            }
            HandMotion::Limited => {
                self.retry(Reason::OutOfReach);
                return wait;
            }
            HandMotion::Standing | HandMotion::Moving => {}
        }
        if goes_on && distance < grip_distance + AT_GRIP {
            if report.motion == HandMotion::Moving {
                // The hand still comes to rest at its target.
                return wait;
            }
            self.enter(ApproachPhase::Grip);
            return Order { command: Some(VisualApproachCommand::Close), look: false };
        }
        self.phase =
            if goes_on && distance < guard_distance { ApproachPhase::Advance } else { ApproachPhase::Center };
        let position: Vector3<f32> = (place - ahead * stop).coords;
        if (position - self.hand).norm_squared() > DECISION_PLACE * DECISION_PLACE {
            self.waiting = 0.0;
        } else if self.waiting > DECISION_TIME {
            self.rose.truncate(1);
        }
        // The motion is straight, so its sideways and forward parts end together.
        let speed = if distance < guard_distance + 0.5 * tolerance { near_speed } else { speed };
        let command = VisualApproachCommand::Move { position: position.into(), speed };
        Order { command: Some(command), look: true }
    }

    /// Whether the opening of the fingers is that on a knob.
    fn is_on_knob(&self, report: &VisualApproachTelemetry) -> bool {
        let [min, max] = self.settings.opening;
        (min..=max).contains(&report.opening)
    }

    fn grip(&mut self, report: &VisualApproachTelemetry, home: &Isometry3<f32>, elapsed: f32) -> Order {
        match report.gripper {
            GripperState::Empty | GripperState::Jammed => return self.miss(report),
            GripperState::Holding => {
                let (opening, time) = self.fingers;
                let rest = abs(report.opening - opening) < FINGERS_REST;
                self.fingers = if rest { (opening, time + elapsed) } else { (report.opening, 0.0) };
                if self.fingers.1 > SETTLING && !self.is_on_knob(report) {
                    // The fingers hold another object, or the side of the knob: advancing would not help.
                    self.retry(Reason::NotHeld);
                    return Order { command: Some(VisualApproachCommand::Open), look: false };
                }
                if self.fingers.1 > SETTLING {
                    self.goal = self.hand - home.rotation * Vector3::z() * self.settings.pull;
                    self.enter(ApproachPhase::Verify);
                    // The contact that ended the approach is no reason to refuse the pull, nor a proof.
                    return Order { command: Some(VisualApproachCommand::Acknowledge), look: false };
                }
            }
            _ => {}
        }
        Order { command: Some(VisualApproachCommand::Close), look: false }
    }

    fn verify(&mut self, report: &VisualApproachTelemetry) -> Order {
        let wait = Order { command: None, look: false };
        let has_ended = self.has_moved || self.was_refused;
        if has_ended && report.motion == HandMotion::Limited {
            self.retry(Reason::OutOfReach);
            return wait;
        }
        let gave_way = has_ended && report.motion == HandMotion::Standing;
        if gave_way || report.gripper != GripperState::Holding || !self.is_on_knob(report) {
            return self.miss(report);
        }
        if !has_ended {
            return self.move_to(self.goal, self.settings.near_speed);
        }
        if report.motion != HandMotion::Blocked {
            self.waiting = 0.0;
        }
        if self.waiting > HELD {
            self.enter(ApproachPhase::Done);
        }
        wait
    }

    fn retreat(&mut self, report: &VisualApproachTelemetry) -> Order {
        // The fingers open before the hand moves.
        if !matches!(report.gripper, GripperState::Open) {
            return Order { command: Some(VisualApproachCommand::Open), look: false };
        }
        // The contact that ended the try is behind, unless it ended the pull; there may be another one, which
        // is no longer reported once the hand has moved since.
        let is_stopped = match report.motion {
            HandMotion::Blocked => self.has_moved || self.was_refused,
            HandMotion::Limited => self.was_refused,
            HandMotion::Standing | HandMotion::Moving => false,
        };
        if is_stopped || self.refused >= LATE_REPORTS {
            (self.has_moved, self.was_refused) = (false, false);
            (self.refused, self.blocks) = (0, self.blocks + 1);
            if self.blocks >= MAX_BLOCKS {
                self.enter(ApproachPhase::Failed(Reason::Blocked));
                return self.ended();
            }
            return Order { command: Some(VisualApproachCommand::Acknowledge), look: false };
        }
        if self.has_moved && report.motion == HandMotion::Limited {
            self.enter(ApproachPhase::Failed(Reason::OutOfReach));
            return self.ended();
        }
        let left = |goal: &Vector3<f32>| norm(&(goal - self.hand));
        // First slowly straight back from the knob.
        self.withdrawal = self.withdrawal.filter(|goal| left(goal) > WITHDRAWN);
        let (goal, speed) = match self.withdrawal {
            Some(goal) => (goal, self.settings.near_speed),
            None => (self.goal, self.settings.speed),
        };
        if self.withdrawal.is_none() && left(&goal) < RETREATED {
            if self.tries > self.settings.retries {
                self.enter(ApproachPhase::Failed(self.reason));
                return self.ended();
            }
            self.rose.clear();
            self.first.clear();
            (self.deeper, self.beside) = (0, None);
            self.enter(ApproachPhase::Look);
            return Order { command: None, look: true };
        }
        self.move_to(goal, speed)
    }

    fn move_to(&mut self, position: Vector3<f32>, speed: f32) -> Order {
        self.has_ordered = true;
        let command = VisualApproachCommand::Move { position: position.into(), speed };
        Order { command: Some(command), look: false }
    }
}

/// A search that covers both searches.
fn union(one: &CircleSearch, other: &CircleSearch) -> CircleSearch {
    let radius = [one.radius[0].min(other.radius[0]), one.radius[1].max(other.radius[1])];
    let window = one.window.zip(other.window).map(|(one, other)| {
        let distance = |axis: usize| abs(one.center[axis] - other.center[axis]);
        Window { center: one.center, reach: one.reach.max(other.reach + distance(0).max(distance(1))) }
    });
    CircleSearch { radius, window, ..*one }
}
