//! The behaviour that leads the task: look, centre, advance, grip, verify (Knob §4.5).

use heapless::Vec;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, UnitQuaternion, Vector3};

use super::rose::{KnobExpectation, Rim, RoseEstimate};
use super::{GripperState, HandMotion, MIN_SPEED, VisualApproachCommand, VisualApproachTelemetry};
use crate::math::{abs, sqrt};
use crate::model::Pose;
use crate::vision::{Circle, CircleSearch, HandEyeTable, Window};

/// Circles that are compared at the begin, and of these, as many must agree.
const FIRST_LOOKS: usize = 7;
const AGREEING: usize = 4;
/// They agree when their centres are this near, and their radii by this share [px; 1].
const SAME_CENTER: f32 = 4.0;
const SAME_RADIUS: f32 = 0.12;
/// One explanation of the circles is right when the other one costs so much more.
const DECIDED: f32 = 15.0;
/// Standing before what may be the knob, the likelier explanation is taken for right after this time [s].
const DECISION_TIME: f32 = 0.7;
/// Pictures in a row without the circle, after which it is lost.
const LOST: u8 = 15;
/// Arrived at the place to grip: way left [m].
const AT_GRIP: f32 = 2e-3;
/// After a contact next to the place to grip, which the hand believes to be so much farther at most [m], it grips.
const NEAR_GRIP: f32 = 0.015;
/// From where the rose is looked for in further tries, in the frame of the hand at the begin [m]: reflections and shadows
/// are others there.
const VIEWS: [[f32; 3]; 4] = [[0.03, 0.0, -0.02], [0.0, 0.03, 0.0], [0.0, -0.03, 0.02], [-0.02, 0.0, 0.0]];
/// When nothing was between the fingers, the hand goes on by as much, so often [m].
const DEEPER: f32 = 0.02;
const DEEPER_TRIES: u8 = 2;
/// The hand closes only when it knows the distance so well [m].
const DEPTH_ERROR: f32 = 0.015;
/// A grip is tried no sooner than this after the gripper begins to close [s].
const SETTLING: f32 = 0.4;

/// Settings of the behaviour.
#[derive(Clone, Debug, PartialEq)]
pub struct ApproachSettings {
    /// What the camera sees of a rose straight before the hand.
    pub table: HandEyeTable,
    /// What is known of the knob at the begin.
    pub expectation: KnobExpectation,
    /// Distance of the hand frame from the rim of the rose at which the gripper closes [m].
    pub grip_distance: f32,
    /// The hand comes no nearer to the rim until it is centred [m]: the length of the knob, and a margin.
    pub guard_distance: f32,
    /// It is centred within this distance from the axis of the approach through the rose [m].
    pub tolerance: f32,
    /// Speed of the hand up to the guard distance, and from there on [m/s].
    pub speed: f32,
    /// See above.
    pub near_speed: f32,
    /// Angle of the gripper while it holds the knob, from … to [rad].
    pub opening: [f32; 2],
    /// Way by which the hand pulls at what it holds [m]: it must be stopped before.
    pub pull: f32,
    /// Tries after the first one.
    pub retries: u8,
    /// Longest time of a phase [s].
    pub patience: f32,
}

/// A setting of the behaviour that is out of its range.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InvalidApproach {
    /// Its name, as in [`ApproachSettings`] and [`KnobExpectation`].
    pub name: &'static str,
    /// The value.
    pub value: f32,
    /// The least.
    pub lower: f32,
    /// The largest.
    pub upper: f32,
}

impl core::fmt::Display for InvalidApproach {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Self { name, value, lower, upper } = self;
        write!(f, "{name} is {value}; it must be {lower} to {upper}")
    }
}

impl core::error::Error for InvalidApproach {}

impl ApproachSettings {
    /// Checks the settings for a board whose hand is at most as fast as `speed` [m/s].
    ///
    /// # Errors
    /// The first one that is out of its range.
    pub fn validate(&self, speed: f32) -> Result<(), InvalidApproach> {
        let KnobExpectation { rose: [small, large], radius, length, distance: [near, far], aside } =
            self.expectation;
        for (name, value, lower, upper) in [
            ("rose", small, 0.005, 0.5),
            ("rose", large, small + 1e-4, 0.5),
            ("radius", radius, 0.002, large),
            ("length", length, 0.0, 1.0),
            ("distance", near, 0.01, 5.0),
            ("distance", far, near + 0.001, 5.0),
            ("aside", aside, 0.001, 1.0),
            ("grip_distance", self.grip_distance, 0.0, self.guard_distance),
            ("guard_distance", self.guard_distance, length + self.tolerance, near),
            ("tolerance", self.tolerance, 1e-4, 0.05),
            ("opening", self.opening[0], -100.0, 100.0),
            ("opening", self.opening[1], self.opening[0], 100.0),
            ("speed", self.speed, MIN_SPEED, speed),
            ("near_speed", self.near_speed, MIN_SPEED, self.speed),
            ("pull", self.pull, 1e-3, 0.1),
            ("retries", f32::from(self.retries), 0.0, 20.0),
            ("patience", self.patience, 0.5, 600.0),
        ] {
            if !(lower..=upper).contains(&value) {
                return Err(InvalidApproach { name, value, lower, upper });
            }
        }
        Ok(())
    }
}

/// Part of the behaviour.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Phase {
    /// The gripper opens, and the rose is looked for.
    Look,
    /// The hand goes before the knob.
    Center,
    /// The fingers go beside the knob.
    Advance,
    /// The gripper closes.
    Grip,
    /// The hand pulls at what it holds.
    Verify,
    /// It goes back for another try.
    Retreat,
    /// It holds the knob.
    Done,
    /// It has given up, and stands.
    Failed(Reason),
}

/// Why the behaviour has given up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// No rose was found.
    NotFound,
    /// It was lost on the way, again and again.
    Lost,
    /// A contact stopped the hand before it was at the knob.
    Blocked,
    /// The knob is out of the arm's reach.
    OutOfReach,
    /// Nothing was between the fingers, or it gave way to a pull.
    NotHeld,
    /// A phase took too long.
    Late,
}

impl core::fmt::Display for Reason {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::NotFound => "no rose was found in the pictures",
            Self::Lost => "the rose was lost on the way",
            Self::Blocked => "a contact stopped the hand before it was at the knob",
            Self::OutOfReach => "the knob is out of the arm's reach",
            Self::NotHeld => "nothing was between the fingers, or it gave way to a pull",
            Self::Late => "a part of the approach took too long",
        })
    }
}

/// What the behaviour asks for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Order {
    /// For the board.
    pub command: Option<VisualApproachCommand>,
    /// Whether pictures are needed.
    pub look: bool,
}

/// The master behaviour of the paper: what it sees and what the board reports in, commands out. It reads no clock and sends
/// nothing itself.
#[derive(Clone, Debug)]
pub struct Approach {
    settings: ApproachSettings,
    phase: Phase,
    /// Time in this phase [s].
    time: f32,
    /// Where the hand was at the begin.
    home: Option<Isometry3<f32>>,
    /// The first circles of a try.
    first: Vec<(Isometry3<f32>, Circle), FIRST_LOOKS>,
    /// What the circles may be: the likelier one first.
    rose: Vec<RoseEstimate, 2>,
    /// Pictures in a row without the circle.
    missed: u8,
    /// For how long the hand has been standing [s].
    standing: f32,
    /// Tries so far.
    tries: u8,
    /// How often the hand has gone on in this try, because nothing was between the fingers.
    deeper: u8,
    /// Why the last try ended.
    reason: Reason,
    /// Where the hand pulls to, or goes back to.
    goal: Vector3<f32>,
}

impl Approach {
    /// At the begin.
    pub const fn new(settings: ApproachSettings) -> Self {
        Self {
            settings,
            phase: Phase::Look,
            time: 0.0,
            home: None,
            first: Vec::new(),
            rose: Vec::new(),
            missed: 0,
            standing: 0.0,
            tries: 0,
            deeper: 0,
            reason: Reason::NotFound,
            goal: Vector3::new(0.0, 0.0, 0.0),
        }
    }

    /// What it does.
    pub const fn phase(&self) -> Phase {
        self.phase
    }

    /// Where the rose is, once it was found.
    pub fn rose(&self) -> Option<&RoseEstimate> {
        self.rose.first()
    }

    /// Tries that have ended without success.
    pub const fn tries(&self) -> u8 {
        self.tries
    }

    /// What to look for in a picture that was taken from `hand`.
    pub fn search(&self, hand: &Pose) -> CircleSearch {
        let (table, expectation) = (&self.settings.table, &self.settings.expectation);
        let hand = isometry(hand);
        // Undecided, each explanation may be the right one.
        let searches = self.rose.iter().map(|rose| rose.search(table, expectation, &hand));
        if let Some(search) = searches.reduce(|one, other| union(&one, &other)) {
            return search;
        }
        let expected = RoseEstimate::expected(expectation, &hand).search(table, expectation, &hand);
        let radius = |distance: f32, radius: f32| table.appearance(&[0.0, 0.0, distance], radius).1;
        let ([near, far], [small, large]) = (expectation.distance, expectation.rose);
        CircleSearch { radius: [radius(far, small), radius(near, large)], window: None, ..expected }
    }

    /// Takes what was found in a picture from `hand`.
    pub fn look(&mut self, hand: &Pose, circle: Option<&Circle>) {
        let hand = isometry(hand);
        if self.rose.is_empty() {
            let Some(circle) = circle.filter(|_| self.phase == Phase::Look) else { return };
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
        self.missed = if fits { 0 } else { self.missed.saturating_add(1) };
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

    /// Begins with the largest group of first circles that agree, once there are enough: they are the rose, or all the
    /// end of the knob.
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
        self.missed = 0;
    }

    /// Advances by `elapsed` [s] since the last call, with the board's newest report.
    pub fn update(&mut self, report: &VisualApproachTelemetry, elapsed: f32) -> Order {
        self.time += elapsed;
        self.standing += elapsed;
        let hand = isometry(&report.hand);
        let home = *self.home.get_or_insert(hand);
        if self.time > self.settings.patience && !matches!(self.phase, Phase::Done | Phase::Failed(_)) {
            let reason = if self.phase == Phase::Look { Reason::NotFound } else { Reason::Late };
            self.retry(reason, &home);
        }
        match self.phase {
            Phase::Look => self.begin_motion(report),
            Phase::Center | Phase::Advance => self.approach(report, &hand, &home),
            Phase::Grip => self.grip(report, &hand, &home),
            Phase::Verify => self.verify(report, &home),
            Phase::Retreat => self.retreat(report, &hand),
            Phase::Done => Order { command: None, look: false },
            Phase::Failed(_) => Order { command: Some(VisualApproachCommand::Stand), look: false },
        }
    }

    fn enter(&mut self, phase: Phase) {
        (self.phase, self.time) = (phase, 0.0);
    }

    /// Gives up this try: goes back for another one, or for good.
    fn retry(&mut self, reason: Reason, home: &Isometry3<f32>) {
        self.tries = self.tries.saturating_add(1);
        self.reason = reason;
        let [x, y, z] = VIEWS[usize::from(self.tries - 1) % VIEWS.len()];
        self.goal = (home * Point3::new(x, y, z)).coords;
        if self.phase == Phase::Retreat {
            self.enter(Phase::Failed(reason));
        } else {
            self.enter(Phase::Retreat);
        }
    }

    /// The knob was not held: it may be farther than it seems.
    fn miss(&mut self, home: &Isometry3<f32>) {
        if self.deeper < DEEPER_TRIES && self.rose.len() == 1 {
            self.deeper += 1;
            self.enter(Phase::Advance);
        } else {
            self.retry(Reason::NotHeld, home);
        }
    }

    fn begin_motion(&mut self, report: &VisualApproachTelemetry) -> Order {
        if !self.rose.is_empty() && report.gripper == GripperState::Open {
            self.enter(Phase::Center);
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
        if report.motion != HandMotion::Standing {
            self.standing = 0.0;
        } else if self.standing > DECISION_TIME {
            self.rose.truncate(1);
        }
        let ApproachSettings { guard_distance, tolerance, .. } = self.settings;
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
        // Once beside the knob, the hand stays there.
        let is_beside = distance < guard_distance - tolerance;
        let goes_on = may_advance || is_beside;
        let stop = if goes_on { grip_distance } else { guard_distance };
        // Until it is decided what the circles are, the hand does not come too near to either.
        let nearest = self
            .rose
            .iter()
            .map(|rose| hand.inverse_transform_point(&rose.place()).z)
            .fold(distance, f32::min);
        let place = rose.place() - ahead * (distance - nearest);
        if self.missed >= LOST && !is_beside {
            self.retry(Reason::Lost, home);
            return wait;
        }
        match report.motion {
            HandMotion::Blocked if distance < self.settings.grip_distance + NEAR_GRIP => {
                self.enter(Phase::Grip);
                return Order { command: Some(VisualApproachCommand::Close), look: false };
            }
            HandMotion::Blocked => {
                self.retry(Reason::Blocked, home);
                return wait;
            }
            HandMotion::Limited => {
                self.retry(Reason::OutOfReach, home);
                return wait;
            }
            HandMotion::Standing | HandMotion::Moving => {}
        }
        if goes_on && distance < grip_distance + AT_GRIP && report.motion == HandMotion::Standing {
            self.enter(Phase::Grip);
            return Order { command: Some(VisualApproachCommand::Close), look: false };
        }
        let phase = if goes_on && distance < guard_distance { Phase::Advance } else { Phase::Center };
        if phase != self.phase {
            self.enter(phase);
        }
        let position: Point3<f32> = place - ahead * stop;
        // Sideways and forward motion end together.
        let ApproachSettings { speed, near_speed, .. } = self.settings;
        let speed = if distance < guard_distance + 0.5 * tolerance { near_speed } else { speed };
        Order {
            command: Some(VisualApproachCommand::Move { position: position.coords.into(), speed }),
            look: true,
        }
    }

    fn grip(
        &mut self,
        report: &VisualApproachTelemetry,
        hand: &Isometry3<f32>,
        home: &Isometry3<f32>,
    ) -> Order {
        match report.gripper {
            GripperState::Empty => self.miss(home),
            GripperState::Holding if self.time > SETTLING => {
                let [least, most] = self.settings.opening;
                if !(least..=most).contains(&report.opening) {
                    // Something else is between the fingers, or the edge of the knob.
                    self.miss(home);
                    return Order { command: Some(VisualApproachCommand::Open), look: false };
                }
                self.goal = hand.translation.vector - home.rotation * Vector3::z() * self.settings.pull;
                self.enter(Phase::Verify);
            }
            _ => {}
        }
        Order { command: Some(VisualApproachCommand::Close), look: false }
    }

    fn verify(&mut self, report: &VisualApproachTelemetry, home: &Isometry3<f32>) -> Order {
        let speed = self.settings.near_speed;
        let pull = Order {
            command: Some(VisualApproachCommand::Move { position: self.goal.into(), speed }),
            look: false,
        };
        if report.gripper != GripperState::Holding {
            self.miss(home);
            return Order { command: Some(VisualApproachCommand::Open), look: false };
        }
        let went = sqrt((Vector3::from(report.hand.translation) - self.goal).norm_squared());
        match report.motion {
            HandMotion::Blocked if self.time > 0.1 => {
                self.enter(Phase::Done);
                Order { command: None, look: false }
            }
            HandMotion::Standing if went < 0.3 * self.settings.pull => {
                self.miss(home);
                Order { command: Some(VisualApproachCommand::Open), look: false }
            }
            _ => pull,
        }
    }

    fn retreat(&mut self, report: &VisualApproachTelemetry, hand: &Isometry3<f32>) -> Order {
        // The fingers open before the hand goes.
        if !matches!(report.gripper, GripperState::Open) {
            return Order { command: Some(VisualApproachCommand::Open), look: false };
        }
        // What it has hit ends a motion for good; another one may go on.
        if report.motion == HandMotion::Blocked {
            return Order { command: Some(VisualApproachCommand::Stand), look: false };
        }
        let left = sqrt((hand.translation.vector - self.goal).norm_squared());
        if left < 0.01 {
            if self.tries > self.settings.retries {
                self.enter(Phase::Failed(self.reason));
                return Order { command: Some(VisualApproachCommand::Stand), look: false };
            }
            self.rose.clear();
            (self.missed, self.deeper) = (0, 0);
            self.first.clear();
            self.enter(Phase::Look);
            return Order { command: None, look: true };
        }
        let speed = self.settings.speed;
        Order {
            command: Some(VisualApproachCommand::Move { position: self.goal.into(), speed }),
            look: false,
        }
    }
}

/// A search that finds what either finds.
fn union(one: &CircleSearch, other: &CircleSearch) -> CircleSearch {
    let radius = [one.radius[0].min(other.radius[0]), one.radius[1].max(other.radius[1])];
    let window = one.window.zip(other.window).map(|(one, other)| {
        let distance = |axis: usize| abs(one.center[axis] - other.center[axis]);
        Window { center: one.center, reach: one.reach.max(other.reach + distance(0).max(distance(1))) }
    });
    CircleSearch { radius, window, ..*one }
}

/// A pose of the wire.
fn isometry(pose: &Pose) -> Isometry3<f32> {
    let [x, y, z, w] = pose.rotation;
    let rotation = UnitQuaternion::new_unchecked(Quaternion::new(w, x, y, z));
    Isometry3::from_parts(Translation3::from(pose.translation), rotation)
}
