//! The course of a grasp: when a phase ends, what comes then, and when the object counts as lost.

use nalgebra::{IsometryMatrix3, Vector3};

use super::forces::{Forces, Grasped};
use super::plan::{ASSUMED_FRICTION, GraspPlan};
use super::pose::PoseMotion;
use super::state::Fingers;
use super::{Failure, GraspFault, GraspState, Hand, PerFinger, Phase};
use crate::TICK;
use crate::grasp::{Contact, WrenchInverse};
use crate::math;

/// Time in which the internal forces rise and fall [s].
const SQUEEZE_TIME: f32 = 0.5;
const OPEN_TIME: f32 = 0.3;
/// Ticks with the forces as wanted that end the squeeze.
const SETTLED_TICKS: u8 = 10;
/// Internal forces that are only fed forward are then shaken, less and less. Dry friction of the joints, which has taken up to
/// its whole size while the forces rose, is led round ever smaller loops of hysteresis and ends near none of it, as a magnet's
/// remanence in a fading alternating field. First all swing together by this share of what they should be; then, by a share of
/// the least of them, fingers 1 and 2 against each other, and their shares of what finger 3 presses with: forces in which
/// other joints take part. Less where a finger would meet its limit, or slide. Times and periods [s].
const SHAKE: f32 = 0.5;
const SHAKE_ACROSS: f32 = 0.2;
const SHAKE_TIME: f32 = 1.1;
const SHAKE_PERIOD: f32 = 0.06;
const ACROSS_PERIODS: [f32; 2] = [0.06, 0.08];
/// The squeeze has failed after this time [s].
const SQUEEZE_TIMEOUT: f32 = 3.0;
/// Change of the force by which fingers 1 and 2 rub while it rises, and while it falls [N/s]; and the distance that counts
/// as sliding [m].
const RUB_RATE: f32 = 0.5;
const RUB_END_RATE: f32 = 2.0;
const RUBBED: f32 = 6e-5;
/// Share of the rubbing force that stays when a finger slides: it stands at once.
const RUBBED_SHARE: f32 = 0.5;
/// Most friction that is counted on; more is not tried, nor for longer than this [s].
const MOST_FRICTION: f32 = 1.0;
const FEEL_TIMEOUT: f32 = 5.0;
/// Speed at which an object is lowered [m/s], how far at most [m], and the share of its weight that then must be carried
/// by something else; not looked at before this time [s], while the fingers start to move.
const LOWER_SPEED: f32 = 0.01;
const MOST_LOWERING: f32 = 0.05;
const CARRIED: f32 = 0.5;
const LOWER_START: f32 = 0.3;
/// As far above where it was grasped an object stands on nothing [m].
const LIFTED: f32 = 0.002;
/// Less than this share of the touch force is no contact, and so many ticks of that a lost object.
const NO_CONTACT: f32 = 0.15;
const LOST_TICKS: u8 = 10;
/// A change of the triangle of fingertips that no rolling makes, and a distance from where the object should be that means
/// that somebody took it [m].
const DEFORMED: f32 = 0.012;
const TAKEN: f32 = 0.015;

impl GraspState {
    /// Whether the object is still there.
    pub(super) fn watch(
        &mut self,
        plan: &GraspPlan,
        grasped: &Grasped<'_>,
        fingers: &Fingers<'_>,
        object: &IsometryMatrix3<f32>,
    ) -> Result<(), GraspFault> {
        if !matches!(self.phase, Phase::ProbeFriction | Phase::Hold | Phase::Move | Phase::Lower) {
            return Ok(());
        }
        let limit = NO_CONTACT * plan.touch_force;
        let (finger, force) = grasped.faintest();
        self.lost = if force < limit { self.lost.saturating_add(1) } else { 0 };
        if self.lost >= LOST_TICKS {
            return Err(GraspFault::Contact { finger, force, limit });
        }
        let distance = self.tracker.deformation(&fingers.tips);
        if distance > DEFORMED {
            return Err(GraspFault::Deformed { distance, limit: DEFORMED });
        }
        let away = object.translation.vector - self.motion.point().frame.translation.vector;
        let distance = math::sqrt(away.norm_squared());
        if distance > TAKEN {
            return Err(GraspFault::Moved { distance, limit: TAKEN });
        }
        Ok(())
    }

    /// Goes from phase to phase; returns forces besides those wanted for grip and load [N].
    pub(super) fn proceed(
        &mut self,
        hand: &Hand<'_>,
        plan: &GraspPlan,
        grasped: &Grasped<'_>,
        inverse: &WrenchInverse<'_>,
        fingers: &Fingers<'_>,
    ) -> PerFinger<Vector3<f32>> {
        match self.phase {
            Phase::Squeeze => return self.squeeze(plan, grasped, inverse, fingers),
            Phase::ProbeFriction => return self.rub(fingers),
            Phase::Move if self.motion.is_done() => self.enter(Phase::Hold),
            Phase::Lower => self.lower(hand),
            Phase::Open => self.share = math::clamp(self.share - TICK / OPEN_TIME, 0.0, 1.0),
            _ => {}
        }
        [Vector3::zeros(); 3]
    }

    fn squeeze(
        &mut self,
        plan: &GraspPlan,
        grasped: &Grasped<'_>,
        inverse: &WrenchInverse<'_>,
        fingers: &Fingers<'_>,
    ) -> PerFinger<Vector3<f32>> {
        let risen = self.elapsed() - SQUEEZE_TIME;
        let shakes = plan.only_feeds_forward();
        let contacts = grasped.map.contacts();
        let mut extra = [Vector3::zeros(); 3];
        let mut still = true;
        if shakes && (0.0..SHAKE_TIME).contains(&risen) {
            (self.share, still) = (1.0, false);
            extra = self.forces.swung(self.forces.swing(contacts, SHAKE) * shaking(risen, SHAKE_PERIOD));
        } else if shakes && (SHAKE_TIME..2.0 * SHAKE_TIME).contains(&risen) {
            still = false;
            let ways = across(contacts);
            let size = self.forces.swing_across(contacts, &ways, SHAKE_ACROSS * self.forces.least_internal());
            let [pair, split] = ACROSS_PERIODS.map(|period| size * shaking(risen - SHAKE_TIME, period));
            extra = ways.map(|[first, second]| first * pair + second * split);
        } else {
            self.share = math::clamp(self.share + TICK / SQUEEZE_TIME, 0.0, 1.0);
        }
        let settled =
            self.share >= 1.0 && still && (!plan.feedback || self.forces.is_settled(grasped, inverse));
        self.settled = if settled { self.settled.saturating_add(1) } else { 0 };
        if self.settled >= SETTLED_TICKS {
            // Without feedback the rubbing force would not be known well enough.
            let feels = plan.friction.is_none() && plan.feedback;
            (self.rub, self.distance) = (0.0, fingers.width());
            self.enter(if feels { Phase::ProbeFriction } else { Phase::Hold });
        } else if self.elapsed() > SQUEEZE_TIMEOUT {
            let (_, force) = grasped.faintest();
            self.fail(Failure::NoGrip { force, limit: SQUEEZE_TIMEOUT }, Phase::Open);
        }
        extra
    }

    /// Fingers 1 and 2 press towards each other, harder and harder, an internal force that moves nothing; until one of
    /// them slides.
    fn rub(&mut self, fingers: &Fingers<'_>) -> PerFinger<Vector3<f32>> {
        if self.settled == 0 {
            self.rub += RUB_RATE * TICK;
            let [first, second, _] = self.forces.ratios;
            let ratio = if first > second { first } else { second };
            if self.distance - fingers.width() > RUBBED || ratio > MOST_FRICTION {
                self.forces.friction = math::clamp(ratio, Forces::LEAST_FRICTION, MOST_FRICTION);
                self.rub *= RUBBED_SHARE;
                self.settled = 1;
            } else if self.elapsed() > FEEL_TIMEOUT {
                self.forces.friction = ASSUMED_FRICTION;
                self.settled = 1;
            }
        } else {
            self.rub -= RUB_END_RATE * TICK;
            if self.rub <= 0.0 {
                self.rub = 0.0;
                self.tracker.settle();
                self.enter(Phase::Hold);
            }
        }
        let [one, two, _] = fingers.tips;
        let push = (two - one) * (self.rub / fingers.width());
        [push, -push, Vector3::zeros()]
    }

    /// The part of the load that is against gravity [N].
    pub(super) fn weight_on(&self, hand: &Hand<'_>) -> f32 {
        let [x, y, z, ..] = self.forces.load;
        -down(hand).dot(&Vector3::new(x, y, z))
    }

    /// Whether the object is clearly above where it was grasped.
    pub(super) fn is_lifted(&self, hand: &Hand<'_>) -> bool {
        let moved = Vector3::from(self.tracker.object.translation) - Vector3::from(self.origin.translation);
        -down(hand).dot(&moved) > LIFTED
    }

    fn lower(&mut self, hand: &Hand<'_>) {
        if self.ticks == 1 {
            let now = self.motion.point().frame;
            let mut below = now;
            below.translation.vector += down(hand) * MOST_LOWERING;
            self.motion = PoseMotion::between(&now, &below, MOST_LOWERING / LOWER_SPEED);
        }
        if self.elapsed() > LOWER_START && self.weight_on(hand) < CARRIED * self.weight {
            self.motion.stop();
            self.enter(Phase::Open);
        } else if self.motion.is_done() {
            self.fail(Failure::NothingBelow { distance: MOST_LOWERING }, Phase::Hold);
        }
    }
}

/// An oscillation of this period that fades from 1 at a `time` of 0 to nothing [s]; 0 before and after.
fn shaking(time: f32, period: f32) -> f32 {
    if !(0.0..SHAKE_TIME).contains(&time) {
        return 0.0;
    }
    let (sine, _) = math::sin_cos(time * (core::f32::consts::TAU / period));
    (1.0 - time / SHAKE_TIME) * sine
}

/// Forces of each finger that together move nothing: fingers 1 and 2 press towards each other; and finger 1 more, finger 2 less
/// towards finger 3. PerFinger with 1 N, on the lines from contact to contact.
fn across(contacts: &[Contact]) -> PerFinger<[Vector3<f32>; 2]> {
    let [one, two, three] = contacts else { return [[Vector3::zeros(); 2]; 3] };
    let towards = |from: &Contact, to: &Contact| {
        let way = to.position() - from.position();
        way / math::sqrt(way.norm_squared())
    };
    let (pair, first, second) = (towards(one, two), towards(one, three), towards(two, three));
    [[pair, first], [-pair, -second], [Vector3::zeros(), second - first]]
}

/// Unit vector along gravity; 0 without.
fn down(hand: &Hand<'_>) -> Vector3<f32> {
    let size = math::sqrt(hand.gravity.norm_squared());
    if size > 0.0 { hand.gravity / size } else { Vector3::zeros() }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn forces_across_move_nothing() {
        // The paper's box. From finger 1 to finger 3 it is 98 mm along and 40 mm across: of 1 N 0.92585 N and 0.37790 N.
        let at = |x, y, normal| Contact::try_new(Vector3::new(x, y, 0.01), normal, 0.4, 9.0).unwrap();
        let along = Vector3::x();
        let contacts = [at(-0.049, 0.04, along), at(-0.049, -0.04, along), at(0.049, 0.0, -along)];
        let ways = across(&contacts);
        let wanted = [
            [[0.0, -1.0, 0.0], [0.925_85, -0.377_90, 0.0]],
            [[0.0, 1.0, 0.0], [-0.925_85, -0.377_90, 0.0]],
            [[0.0; 3], [0.0, 0.755_80, 0.0]],
        ];
        for (found, wanted) in ways.iter().flatten().zip(wanted.iter().flatten()) {
            assert!((found - Vector3::from(*wanted)).norm() < 1e-5, "{found} {wanted:?}");
        }
        // And of contacts that lie and point anywhere, about any place.
        let at = |x, y, z| Contact::try_new(Vector3::new(x, y, z), Vector3::new(y, z, x), 0.4, 9.0).unwrap();
        let contacts = [at(0.03, 0.05, -0.02), at(-0.06, 0.01, 0.04), at(0.02, -0.07, 0.03)];
        let ways = across(&contacts);
        let about = Vector3::new(0.3, -0.2, 0.1);
        for kind in 0..2 {
            let (mut force, mut moment) = (Vector3::zeros(), Vector3::zeros());
            for (contact, ways) in contacts.iter().zip(&ways) {
                force += ways[kind];
                moment += (contact.position() - about).cross(&ways[kind]);
            }
            assert!(force.norm() < 1e-6 && moment.norm() < 1e-6, "{force} {moment}");
            assert!(ways[0][kind].norm() > 0.99);
        }
    }

    #[test]
    fn shaking_fades_to_nothing_about_nothing() {
        for period in ACROSS_PERIODS {
            assert!(shaking(-TICK, period) == 0.0 && shaking(SHAKE_TIME, period) == 0.0);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a number of ticks")]
            let ticks = (SHAKE_TIME / TICK) as u16;
            let values: heapless::Vec<f32, 1000> =
                (0..ticks).map(|tick| shaking((f32::from(tick) + 0.01) * TICK, period)).collect();
            let most = |part: &[f32]| part.iter().fold(0.0, |most, value| f32::max(most, value.abs()));
            let (begin, end) = (most(&values[..12]), most(&values[values.len() - 8..]));
            assert!(begin > 0.8 && begin < 1.0 && end < 0.08, "{begin} {end}");
            let mean = values.iter().sum::<f32>() / f32::from(ticks);
            assert!(mean.abs() < 0.02, "{mean}");
        }
    }
}
