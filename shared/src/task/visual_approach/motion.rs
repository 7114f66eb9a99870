//! Supervision of the hand's motion: contacts, arrival and rest.

use nalgebra::Vector3;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::contact::Sense;
use super::reference::Step;
use super::{HandMotion, MIN_SPEED, VisualApproachRefusal};
use crate::TICK;
use crate::math::norm;

/// The reference has arrived within this distance [m].
const ARRIVED: f32 = 5e-4;
/// A slower reference defines no direction of motion [m/s].
const SLOWEST: f32 = 1e-3;
/// The hand is at rest when it has stayed within this distance for this time: 2 mm/s [m, s].
const REST_DISTANCE: f32 = 2e-4;
const REST_TIME: f32 = 0.1;
/// After a contact the hand retreats by this distance [m].
const RELIEF: f32 = 2e-3;
/// After a retreat by this distance it may move towards the obstacle again [m].
const CLEAR: f32 = 0.01;
/// Share of a force against the motion that the estimate must show: below the first the hand stops, below the
/// second it is slower. The contact limit is scaled by this share, which also amplifies errors of the model.
pub const MIN_SHOWN: f32 = 0.5;
const WELL_SHOWN: f32 = 0.75;

/// The obstacle that ended a motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
struct Obstacle {
    /// Unit vector of the blocked motion.
    direction: [f32; 3],
    /// Position to which the hand retreats [m].
    place: [f32; 3],
}

impl Obstacle {
    /// Distance of a position beyond the retreat position, along the blocked direction [m].
    fn ahead(&self, place: &Vector3<f32>) -> f32 {
        Vector3::from(self.direction).dot(&(place - Vector3::from(self.place)))
    }
}

/// State of the motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct MotionState {
    pub motion: HandMotion,
    /// Distance from the measured hand to its target [m].
    pub remaining: f32,
    /// Target of the hand [m].
    pub target: [f32; 3],
    /// Whether its motion was ended and it waits for another target.
    is_ended: bool,
    obstacle: Option<Obstacle>,
    /// Direction of the last motion, or 0.
    direction: [f32; 3],
    /// Position at the start of the present rest [m], and its duration [s].
    rest: ([f32; 3], f32),
}

impl MotionState {
    pub const NONE: Self = Self {
        motion: HandMotion::Standing,
        remaining: 0.0,
        target: [0.0; 3],
        is_ended: false,
        obstacle: None,
        direction: [0.0; 3],
        rest: ([0.0; 3], 0.0),
    };

    /// Moves the hand, whose reference is at `place`, to a target.
    ///
    /// # Errors
    /// The target is beyond the obstacle that ended a motion.
    pub fn send(&mut self, place: &Vector3<f32>, target: &Vector3<f32>) -> Result<(), VisualApproachRefusal> {
        let ahead = self.obstacle.map_or(0.0, |obstacle| obstacle.ahead(target));
        if ahead > ARRIVED {
            return Err(VisualApproachRefusal::Blocked { ahead });
        }
        let way = target - place;
        let distance = norm(&way);
        if self.is_ended || self.motion == HandMotion::Standing && distance > ARRIVED {
            (self.motion, self.is_ended, self.rest.1) = (HandMotion::Moving, false, 0.0);
            self.direction = if distance > ARRIVED { (way / distance).into() } else { [0.0; 3] };
        }
        self.target = (*target).into();
        Ok(())
    }

    /// Brings the hand to rest at `place` [m], unless its motion was ended already.
    pub fn stand(&mut self, place: &Vector3<f32>) {
        if !self.is_ended {
            (self.target, self.motion) = ((*place).into(), HandMotion::Moving);
        }
    }

    /// Clears the obstacle: the leader has noticed it.
    pub const fn acknowledge(&mut self) {
        self.obstacle = None;
    }

    /// Updates the way of the measured `hand` [m] to its target.
    pub fn measure(&mut self, hand: &Vector3<f32>) {
        self.remaining = norm(&(Vector3::from(self.target) - hand));
    }

    /// Whether the hand waits for a target after its motion was ended.
    pub const fn is_ended(&self) -> bool {
        self.is_ended
    }

    /// Whether the present motion leads away from the last obstacle.
    fn leads_away(&self) -> bool {
        self.obstacle.is_some_and(|obstacle| {
            Vector3::from(obstacle.direction).dot(&Vector3::from(self.direction)) < 0.0
        })
    }

    /// The share of a force against the motion that the estimate shows; 1 while the hand retreats.
    fn shown(&self, sense: &Sense) -> f32 {
        let direction = Vector3::from(self.direction);
        let goes = self.motion != HandMotion::Standing && !self.is_ended && !self.leads_away();
        if goes && direction != Vector3::zeros() { sense.shown(&direction) } else { 1.0 }
    }

    /// Reduces the permitted `speed` [m/s] where the estimate shows contacts badly.
    pub fn speed(&self, speed: f32, sense: &Sense) -> f32 {
        let share = (self.shown(sense) - MIN_SHOWN) / (WELL_SHOWN - MIN_SHOWN);
        if share < 1.0 { speed.min((speed * share).max(MIN_SPEED)) } else { speed }
    }

    /// Supervises a period of motion: `step` of the reference, measured `hand` [m], `force` on it [N]. Ends
    /// the motion at a contact force of more than `limit` [N], and where the estimate could not show one.
    /// Returns `true` in the period in which it does.
    pub fn supervise(
        &mut self,
        step: &Step,
        hand: &Vector3<f32>,
        force: &Vector3<f32>,
        sense: &Sense,
        limit: f32,
    ) -> bool {
        let (place, time) = self.rest;
        let moved = (hand - Vector3::from(place)).norm_squared() > REST_DISTANCE * REST_DISTANCE;
        self.rest = if moved { ((*hand).into(), 0.0) } else { (place, (time + TICK).min(1.0)) };
        if self.obstacle.is_some_and(|obstacle| obstacle.ahead(hand) < -CLEAR) {
            self.obstacle = None;
        }
        if self.is_ended {
            return false;
        }
        let speed = norm(&step.velocity);
        if speed > SLOWEST {
            self.direction = (step.velocity / speed).into();
        }
        let direction = Vector3::from(self.direction);
        let shown = self.shown(sense);
        // Checked even if the reference has arrived: the servos may still press.
        if self.motion != HandMotion::Standing && force.dot(&direction) < -limit * shown {
            self.end(HandMotion::Blocked, hand - direction * RELIEF);
            return true;
        }
        if shown < MIN_SHOWN {
            self.end(HandMotion::Limited, *hand);
            return true;
        }
        let rests = self.rest.1 >= REST_TIME;
        self.motion = if rests && step.remaining < ARRIVED {
            HandMotion::Standing
        } else if rests && step.limited {
            HandMotion::Limited
        } else {
            HandMotion::Moving
        };
        false
    }

    fn end(&mut self, motion: HandMotion, place: Vector3<f32>) {
        (self.motion, self.is_ended) = (motion, true);
        self.target = place.into();
        self.obstacle = Some(Obstacle { direction: self.direction, place: self.target });
    }
}
