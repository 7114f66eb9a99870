use nalgebra::{Vector3, Vector6};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::plan::NORMAL_TOLERANCE;
use super::{InternalForce, PerFinger};
use crate::TICK;
use crate::grasp::{Contact, GraspMap, GripError, GripState, LeastGrip, ThreeFingers, WrenchInverse};
use crate::math::{self, abs};

/// Share of a new reading in the load.
const LOAD_SHARE: f32 = 0.5;
/// Share of a new reading in the load as it was: some 80 ms.
const PAST_SHARE: f32 = 0.12;
/// And in that which the object's weight is taken for: some 0.5 s.
const STEADY_SHARE: f32 = 0.02;
/// Share of the load that is fed forward, once nothing else carries it. All of it would let a heavy object float on joints that
/// are stronger than they are thought to be: what moves it, they feel.
const LOAD_FEEDFORWARD: f32 = 0.9;
/// A change of the load beyond this is no noise [N].
const SURGE_NOISE: f32 = 0.09;
/// What is held ready for a load that grows, over its growth since a while ago.
const SURGE_LEAD: f32 = 1.3;
/// Time in which what was held ready for a growing load is given up [s].
const SURGE_TIME: f32 = 0.25;
/// Rate at which measured internal forces correct the commanded ones [1/s].
const FEEDBACK_RATE: f32 = 30.0;
/// Most of that correction [N].
const MOST_FEEDBACK: f32 = 5.0;
/// The least grip is let be while it is firmer than wanted by no more than this share and this force [N]: forces that are
/// corrected for ever by joints with dry friction swing, and slide when they swing low.
const FIRM_SHARE: f32 = 0.1;
const FIRM: f32 = 0.05;
/// While a load grows each finger presses harder by this force for each newton that is held ready, at most by so much [N]:
/// dry friction of the joints takes the first of a force that rises.
const BRACE: f32 = 4.0;
const MOST_BRACE: f32 = 0.5;
/// A contact whose tangential force is more than this share of what friction gives is about to slide.
const NEAR_SLIDING: f32 = 0.97;
/// And by more than this, which may be noise [N].
const FORCE_NOISE: f32 = 0.05;
/// Share of a new reading in the ratio of tangential to normal force.
const RATIO_SHARE: f32 = 0.5;
/// A tip farther than this from where the others say has slid [m], if its tangential force is more than this share of what
/// friction gives.
const SLID: f32 = 6e-5;
const SLID_SHARE: f32 = 0.75;
/// After sliding, friction counts as this share of what was measured then.
const AFTER_SLIDING: f32 = 0.92;
/// And one slip takes no more from it than to this share.
const MOST_LOSS: f32 = 0.85;
/// Share of the internal forces that is added in each tick in which a contact slides, and the most of it.
const SLIP_SHARE: f32 = 0.5;
const MOST_RESERVE: f32 = 2.0;
/// Time in which that is given up [s].
const SLIP_TIME: f32 = 0.4;
/// Time in which a grip that is firmer than needed fades [s].
const RELEASE_TIME: f32 = 0.3;
/// Share of the load by which the least grip may be wrong: what is measured of the load is no better.
const GRIP_OPEN: f32 = 0.02;
/// Instructions that a tick may spend on the least grip; one step of the search it takes in any case.
const GRIP_BUDGET: u32 = 9_000;
/// Share of the friction that forces across the normals may take while they are shaken.
const SHAKEN_SHARE: f32 = 0.8;
/// Less normal force than this says nothing about friction [N].
const FAINT: f32 = 0.1;

/// Which forces the fingers are to have, and what they have.
#[derive(Clone, Debug, Serialize, Deserialize, Schema)]
pub(super) struct Forces {
    /// Wrench of the fingers on the object, about the object's origin: a mean of the last readings, and as it was a
    /// while ago [N, N·m].
    pub load: [f32; 6],
    past: [f32; 6],
    /// And for longer.
    steady: [f32; 6],
    /// What is held ready for a load that grows [N, N·m].
    surge: [f32; 6],
    /// Share of the internal forces that is added after a slip.
    reserve: f32,
    /// The internal forces that were found last [N], and the size of the load for which, moments counted as forces [N, N·m].
    base: PerFinger<[f32; 3]>,
    base_load: f32,
    /// Size of the internal forces of the last tick [N].
    firmness: f32,
    /// The coefficient of friction that is counted on.
    pub friction: f32,
    /// Wanted forces, and what the measured ones add to them [N].
    pub wanted: PerFinger<[f32; 3]>,
    correction: PerFinger<[f32; 3]>,
    /// Tangential over normal force of each contact.
    pub ratios: PerFinger<f32>,
    /// How far the tips were from where the others say, a tick ago [m].
    shifts: PerFinger<f32>,
    grip: GripState,
    /// No forces within the limits hold the load: the grip is as firm as allowed.
    pub overloaded: bool,
    /// Ticks in which a contact slid.
    pub slips: u16,
}

/// What the forces of a tick are computed from.
pub(super) struct Grasped<'a> {
    pub map: &'a GraspMap,
    /// Forces of the tips on the object [N].
    pub measured: &'a PerFinger<Vector3<f32>>,
    /// How far the tips are from where the others say [m].
    pub shifts: &'a PerFinger<f32>,
    pub internal: InternalForce,
    pub feedback: bool,
    /// Whether the fingers hold the object, and not yet, or no longer, only press on what stands by itself.
    pub held: bool,
    /// Whether nothing else carries it. What fingers and a support press against each other looks like a load, and a hand
    /// that answers it at once presses harder and harder.
    pub lifted: bool,
    /// Whether to grip as for a motion.
    pub firmly: bool,
    /// What the forces are made with.
    pub three: &'a ThreeFingers,
    /// Joint torques that they may take [N·m].
    pub torque_limits: PerFinger<[f32; 3]>,
}

impl Forces {
    /// Friction never counts as less.
    pub const LEAST_FRICTION: f32 = 0.15;

    /// Nothing is held.
    pub const NONE: Self = Self {
        load: [0.0; 6],
        past: [0.0; 6],
        steady: [0.0; 6],
        surge: [0.0; 6],
        reserve: 0.0,
        base: [[0.0; 3]; 3],
        base_load: 0.0,
        firmness: 0.0,
        friction: 0.0,
        wanted: [[0.0; 3]; 3],
        correction: [[0.0; 3]; 3],
        ratios: [0.0; 3],
        shifts: [0.0; 3],
        grip: GripState::START,
        overloaded: false,
        slips: 0,
    };

    /// Nothing is held yet of what has this coefficient of friction.
    pub const fn new(friction: f32) -> Self {
        Self { friction, ..Self::NONE }
    }

    /// Takes in what the force sensors read: the load, and whether a contact slides.
    pub fn feel(&mut self, grasped: &Grasped<'_>) {
        let load = if grasped.held { grasped.map.wrench(grasped.measured) } else { Vector6::zeros() };
        for (means, share) in
            [(&mut self.load, LOAD_SHARE), (&mut self.past, PAST_SHARE), (&mut self.steady, STEADY_SHARE)]
        {
            means.iter_mut().zip(&load).for_each(|(mean, reading)| *mean += share * (reading - *mean));
        }
        let decay = 1.0 - TICK / SURGE_TIME;
        let (mut change, mut held) = (0.0, 0.0);
        for ((load, past), surge) in self.load.iter().zip(&self.past).zip(&self.surge).take(3) {
            change += (load - past) * (load - past);
            held += surge * surge;
        }
        let grows = grasped.lifted
            && change > SURGE_NOISE * SURGE_NOISE
            && SURGE_LEAD * SURGE_LEAD * change > held * decay * decay;
        for (surge, (load, past)) in self.surge.iter_mut().zip(self.load.iter().zip(&self.past)) {
            *surge = if grows { SURGE_LEAD * (load - past) } else { *surge * decay };
        }
        self.reserve *= 1.0 - TICK / SLIP_TIME;
        let contacts = grasped.map.contacts().iter().zip(grasped.measured).zip(grasped.shifts);
        let mut any = false;
        for (((contact, force), &shift), (ratio, before)) in
            contacts.zip(self.ratios.iter_mut().zip(&mut self.shifts))
        {
            let normal = contact.normal().dot(force);
            let tangential = math::sqrt((force - contact.normal() * normal).norm_squared());
            let faint = normal < FAINT;
            *ratio += RATIO_SHARE * (if faint { 0.0 } else { tangential / normal } - *ratio);
            let slid = shift > SLID && shift > *before && *ratio > SLID_SHARE * self.friction;
            *before = shift;
            if slid && !faint && grasped.held {
                let least = MOST_LOSS * self.friction;
                let least = if least > Self::LEAST_FRICTION { least } else { Self::LEAST_FRICTION };
                self.friction = math::clamp(*ratio * AFTER_SLIDING, least, self.friction);
            }
            any |= slid || tangential > self.friction * NEAR_SLIDING * normal + FORCE_NOISE;
        }
        if any && grasped.held {
            self.slips = self.slips.saturating_add(1);
            self.reserve = math::clamp(self.reserve + SLIP_SHARE, 0.0, MOST_RESERVE);
        }
    }

    /// The forces wanted for the load, with `share` of the internal ones (0 to 1) and `extra` forces besides [N]. Returns
    /// the internal ones, corrected by what is measured of them: what the joints are to press with so that the grip is as
    /// wanted; and those that carry the load.
    pub fn want(
        &mut self,
        grasped: &Grasped<'_>,
        inverse: &WrenchInverse<'_>,
        share: f32,
        extra: &PerFinger<Vector3<f32>>,
    ) -> (PerFinger<Vector3<f32>>, PerFinger<Vector3<f32>>) {
        let map = grasped.map;
        let mut carried = [Vector3::zeros(); 3];
        if let Ok(found) = inverse.forces(&self.load.into()) {
            carried.iter_mut().zip(&found).for_each(|(carried, found)| *carried = *found);
        }
        let own = grasped.three.torques(&carried);
        let mut internal = self.internal(grasped, share, inverse, &own);
        let extra_share = room_for(map.contacts(), &internal, &carried, extra);
        let all = internal.iter_mut().zip(&carried).zip(extra).zip(map.contacts()).zip(&mut self.wanted);
        for ((((internal, carried), extra), contact), wanted) in all {
            // Nothing is crushed, whatever the internal force and the load are.
            let force = *internal + extra * extra_share + carried;
            let push = contact.normal().dot(&force);
            let scale = if push > contact.limit() { contact.limit() / push } else { 1.0 };
            *wanted = (force * scale).into();
            *internal = force * scale - carried;
        }
        let rests = matches!(grasped.internal, InternalForce::Least { .. }) && self.is_firm(grasped);
        if grasped.feedback && !rests {
            let missing = self.missing(grasped, inverse);
            let parts =
                self.correction.iter_mut().flatten().zip(missing.iter().flat_map(|force| force.iter()));
            for (correction, missing) in parts {
                let next = *correction + FEEDBACK_RATE * TICK * missing;
                *correction = math::clamp(next, -MOST_FEEDBACK, MOST_FEEDBACK);
            }
        }
        let mut corrected = internal;
        corrected.iter_mut().zip(&self.correction).for_each(|(force, more)| *force += Vector3::from(*more));
        let possible = grasped.share_of_torques(&corrected, &own, 1.0);
        if possible < 1.0 {
            // What the joints cannot is neither asked for nor added up.
            let all = corrected.iter_mut().zip(&internal).zip(&mut self.correction);
            all.for_each(|((force, internal), correction)| {
                *force *= possible;
                if grasped.feedback {
                    *correction = (*force - internal).into();
                }
            });
        }
        (corrected, carried)
    }

    /// Internal forces as planned, for the load that there is and may come; carrying it takes torques of `own` [N·m].
    fn internal(
        &mut self,
        grasped: &Grasped<'_>,
        share: f32,
        inverse: &WrenchInverse<'_>,
        own: &PerFinger<Vector3<f32>>,
    ) -> PerFinger<Vector3<f32>> {
        let map = grasped.map;
        let mut forces = [Vector3::zeros(); 3];
        self.overloaded = false;
        match grasped.internal {
            InternalForce::Least { margin, least, moving } => {
                let [x, y, z, ..] = self.surge;
                let brace = BRACE * math::sqrt(x * x + y * y + z * z);
                let brace = if brace < MOST_BRACE { brace } else { MOST_BRACE };
                let least = share * if grasped.firmly { moving } else { least } / self.friction + brace;
                let load = if grasped.lifted { self.load } else { self.past };
                let load = Vector6::from(load) + Vector6::from(self.surge);
                let size = math::sqrt(load.norm_squared());
                let mut more = 1.0 + self.reserve;
                let grip = LeastGrip::try_new(margin, least).map(|grip| grip.with_tolerance(GRIP_OPEN));
                match grip.map(|grip| grip.advance(map, &load, &mut self.grip, GRIP_BUDGET)) {
                    Ok(Ok(grip)) => {
                        forces.iter_mut().zip(&grip.forces).for_each(|(force, found)| *force = *found);
                        // Only the load that is there is carried; what is held ready for more is internal.
                        inverse.project_to_null_space(&mut forces);
                        (self.base, self.base_load) = (forces.map(Into::into), size);
                    }
                    Ok(Err(GripError::CannotHold(_) | GripError::Limit { .. })) => {
                        // As hard as allowed.
                        (self.overloaded, more) = (true, f32::MAX);
                    }
                    // While a search goes on, or at the very edge of what can be held, the last forces stay.
                    _ => {}
                }
                forces = self.base.map(Vector3::from);
                let strength = math::sqrt(forces.iter().map(Vector3::norm_squared).sum());
                if size > self.base_load && strength > f32::MIN_POSITIVE {
                    // They are for a smaller load.
                    let unit = if strength > self.base_load { strength } else { self.base_load };
                    more *= 1.0 + (size - self.base_load) / unit;
                }
                // A grip that became firm fades slowly: while a load goes, forces are not exact.
                let floor = self.firmness * (1.0 - TICK / RELEASE_TIME);
                if strength * more < floor && strength > f32::MIN_POSITIVE {
                    more = floor / strength;
                }
                let most = grasped.most(&forces, own, more);
                forces.iter_mut().for_each(|force| *force *= most);
                self.firmness = strength * most;
            }
            // Where contacts have moved so far that a form has no answer, the last one stays: nothing is let go.
            InternalForce::Normal { strength } => {
                if let Ok(grip) = map.normal_grip(NORMAL_TOLERANCE) {
                    let found = grip.forces(strength);
                    self.base.iter_mut().zip(&found).for_each(|(base, found)| *base = (*found).into());
                }
                forces = self.base.map(|force| Vector3::from(force) * share);
            }
            InternalForce::Pairwise { strengths } => {
                if let Ok(pairs) = map.pairwise() {
                    let found = pairs * Vector3::from(strengths);
                    let parts = found.as_slice().chunks_exact(3);
                    self.base.iter_mut().zip(parts).for_each(|(base, part)| base.copy_from_slice(part));
                }
                forces = self.base.map(|force| Vector3::from(force) * share);
            }
        }
        forces
    }

    /// The share of the load that is fed forward.
    pub const fn fed_forward(grasped: &Grasped<'_>) -> f32 {
        if grasped.lifted { LOAD_FEEDFORWARD } else { 0.0 }
    }

    /// What the fingers have carried for a while [N, N·m].
    pub fn weight(&self) -> Vector6<f32> {
        self.steady.into()
    }

    /// The smallest of the internal forces that were found last [N].
    pub fn least_internal(&self) -> f32 {
        let sizes = self.base.iter().map(|force| Vector3::from(*force).norm_squared());
        math::sqrt(sizes.fold(f32::INFINITY, |least, size| if size < least { size } else { least }))
    }

    /// This share of the internal forces that were found last [N].
    pub fn swung(&self, share: f32) -> PerFinger<Vector3<f32>> {
        self.base.map(|force| Vector3::from(force) * share)
    }

    /// By which share of themselves, at most `most`, the internal forces may swing to either side with no finger meeting
    /// its limit.
    pub fn swing(&self, contacts: &[Contact], mut most: f32) -> f32 {
        for (contact, force) in contacts.iter().zip(&self.base) {
            let push = contact.normal().dot(&Vector3::from(*force));
            most = at_most(most, push, contact.limit() - push);
        }
        most
    }

    /// By how much, at most `most` [N], forces besides the internal ones may swing along `ways`, each by itself and to either
    /// side, with no finger meeting its limit, and none coming near to sliding.
    pub fn swing_across(
        &self,
        contacts: &[Contact],
        ways: &PerFinger<[Vector3<f32>; 2]>,
        mut most: f32,
    ) -> f32 {
        let friction = SHAKEN_SHARE * self.friction;
        for ((contact, force), ways) in contacts.iter().zip(&self.base).zip(ways) {
            let parts = |force: &Vector3<f32>| {
                let along = contact.normal().dot(force);
                (along, math::sqrt((force - contact.normal() * along).norm_squared()))
            };
            let (push, held) = parts(&Vector3::from(*force));
            let [(along, beside), (more_along, more_beside)] = ways.each_ref().map(parts);
            let (along, beside) = (abs(along) + abs(more_along), beside + more_beside);
            most = at_most(most, along, contact.limit() - push);
            most = at_most(most, beside + friction * along, friction * push - held);
        }
        most
    }

    /// Whether every finger presses as hard as it should, and none much harder.
    fn is_firm(&self, grasped: &Grasped<'_>) -> bool {
        let contacts = grasped.map.contacts().iter().zip(grasped.measured).zip(&self.wanted);
        contacts.into_iter().all(|((contact, measured), wanted)| {
            let (wanted, measured) =
                (contact.normal().dot(&Vector3::from(*wanted)), contact.normal().dot(measured));
            measured >= wanted && measured < wanted * (1.0 + FIRM_SHARE) + FIRM
        })
    }

    /// Whether the internal forces are near the wanted ones, along the normals. What a support carries is none of theirs.
    pub fn is_settled(&self, grasped: &Grasped<'_>, inverse: &WrenchInverse<'_>) -> bool {
        let missing = self.missing(grasped, inverse);
        let contacts = grasped.map.contacts().iter().zip(&missing).zip(&self.wanted);
        contacts.into_iter().all(|((contact, missing), wanted)| {
            let wanted = contact.normal().dot(&Vector3::from(*wanted));
            abs(contact.normal().dot(missing)) < 0.1 * wanted + 0.1
        })
    }

    /// What the measured forces miss of the internal ones wanted [N].
    fn missing(&self, grasped: &Grasped<'_>, inverse: &WrenchInverse<'_>) -> PerFinger<Vector3<f32>> {
        let mut missing: PerFinger<Vector3<f32>> = self.wanted.map(Into::into);
        missing.iter_mut().zip(grasped.measured).for_each(|(missing, measured)| *missing -= measured);
        inverse.project_to_null_space(&mut missing);
        missing
    }
}

impl Grasped<'_> {
    /// How many times these internal `forces` [N] the fingers can press with, beside torques of `own` [N·m]; at most `more`.
    fn most(&self, forces: &PerFinger<Vector3<f32>>, own: &PerFinger<Vector3<f32>>, more: f32) -> f32 {
        let mut most = more;
        for (contact, force) in self.map.contacts().iter().zip(forces) {
            let push = contact.normal().dot(force);
            if push * most > contact.limit() {
                most = contact.limit() / push;
            }
        }
        self.share_of_torques(forces, own, most)
    }

    /// How many times these `forces` [N] the joints can make, beside torques of `own` [N·m]; at most `most`.
    fn share_of_torques(
        &self,
        forces: &PerFinger<Vector3<f32>>,
        own: &PerFinger<Vector3<f32>>,
        mut most: f32,
    ) -> f32 {
        let added = self.three.torques(forces);
        for ((own, added), limits) in own.iter().zip(&added).zip(&self.torque_limits) {
            for ((&own, &added), &limit) in own.iter().zip(added).zip(limits) {
                // In the direction in which the added torque goes.
                let room = limit - if added > 0.0 { own } else { -own };
                let room = if room > 0.0 { room } else { 0.0 };
                if abs(added) * most > room {
                    most = room / abs(added);
                }
            }
        }
        most
    }

    /// The finger with the least normal force, and that force [N].
    pub fn faintest(&self) -> (u8, f32) {
        let contacts = (0..).zip(self.map.contacts().iter().zip(self.measured));
        let forces = contacts.map(|(finger, (contact, force))| (finger, contact.normal().dot(force)));
        forces.fold((0, f32::INFINITY), |least, force| if force.1 < least.1 { force } else { least })
    }
}

/// The share of `extra` forces, the same for all fingers so that they move nothing, with which no finger meets its limit.
fn room_for(
    contacts: &[Contact],
    internal: &PerFinger<Vector3<f32>>,
    carried: &PerFinger<Vector3<f32>>,
    extra: &PerFinger<Vector3<f32>>,
) -> f32 {
    let mut share = 1.0;
    for (((contact, internal), carried), extra) in contacts.iter().zip(internal).zip(carried).zip(extra) {
        let room = contact.limit() - contact.normal().dot(&(internal + carried));
        share = at_most(share, contact.normal().dot(extra), room);
    }
    share
}

/// `value`, or less of it, so that `rate` times it takes no more than the `room`.
fn at_most(value: f32, rate: f32, room: f32) -> f32 {
    let room = if room > 0.0 { room } else { 0.0 };
    if value * rate > room { room / rate } else { value }
}

/// The grasp of contacts at `arms` from `origin` with these `normals`; `None` when they make none.
pub(super) fn grasp_map(
    origin: Vector3<f32>,
    arms: &PerFinger<Vector3<f32>>,
    normals: &PerFinger<Vector3<f32>>,
    friction: f32,
    limits: &PerFinger<f32>,
) -> Option<GraspMap> {
    let mut contacts = heapless::Vec::<Contact, 3>::new();
    for ((arm, normal), limit) in arms.iter().zip(normals).zip(limits) {
        let contact = Contact::try_new(origin + arm, *normal, friction, *limit).ok()?;
        contacts.push(contact).ok()?;
    }
    GraspMap::try_new(&contacts, origin).ok()
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// The paper's box, and fingers that press on it with the largest normal force `strength` [N].
    fn grasp(strength: f32, friction: f32) -> ([Contact; 3], Forces) {
        let at = |x, y, normal| Contact::try_new(Vector3::new(x, y, 0.0), normal, friction, 9.0).unwrap();
        let along = Vector3::x();
        let contacts = [at(-0.049, 0.04, along), at(-0.049, -0.04, along), at(0.049, 0.0, -along)];
        let half = 0.5 * strength;
        let base = [[half, 0.0, 0.0], [half, 0.0, 0.0], [-strength, 0.0, 0.0]];
        (contacts, Forces { base, ..Forces::new(friction) })
    }

    /// Fingers 1 and 2 towards each other, and towards finger 3, as 98 mm along and 40 mm across make it.
    fn ways() -> PerFinger<[Vector3<f32>; 2]> {
        let (along, across) = (0.925_85, 0.377_90);
        [
            [-Vector3::y(), Vector3::new(along, -across, 0.0)],
            [Vector3::y(), Vector3::new(-along, -across, 0.0)],
            [Vector3::zeros(), Vector3::new(0.0, 2.0 * across, 0.0)],
        ]
    }

    /// The box held by fingers whose joints push along the axes, 0.1 N·m for a newton, and make up to `torque` [N·m]; they press
    /// with `measured` [N].
    fn grasped<T>(torque: f32, measured: &PerFinger<Vector3<f32>>, act: impl FnOnce(&Grasped<'_>) -> T) -> T {
        let (contacts, _) = grasp(0.0, 0.5);
        let mut jacobian = crate::kinematics::Jacobian::zeros();
        (0..3).for_each(|axis| jacobian[(axis, axis)] = 0.1);
        act(&Grasped {
            map: &GraspMap::try_new(&contacts, Vector3::zeros()).unwrap(),
            measured,
            shifts: &[0.0; 3],
            internal: InternalForce::Least { margin: 0.2, least: 0.22, moving: 0.6 },
            feedback: true,
            held: true,
            lifted: true,
            firmly: false,
            three: &ThreeFingers::new(&[(jacobian, Vector3::zeros()); 3]),
            torque_limits: [[torque; 3]; 3],
        })
    }

    fn tick(forces: &mut Forces, torque: f32, measured: &PerFinger<Vector3<f32>>) -> PerFinger<Vector3<f32>> {
        grasped(torque, measured, |grasped| {
            forces.feel(grasped);
            forces.want(grasped, &grasped.map.inverse(), 1.0, &[Vector3::zeros(); 3]).0
        })
    }

    #[test]
    fn what_a_support_carries_is_no_force_that_is_missing() {
        let wanted = pressing(2.0, 0.0).map(Into::into);
        let forces = Forces { wanted, ..Forces::new(0.5) };
        let is_settled =
            |measured| grasped(1.0, &measured, |grasped| forces.is_settled(grasped, &grasped.map.inverse()));
        // Something pushes the box with 1.5 N, which the fingers share: they press against each other as they should.
        let [one, two, three] = pressing(2.0, 0.0);
        let pushed = Vector3::new(0.5, 0.0, 0.0);
        assert!(is_settled([one, two, three]));
        assert!(is_settled([one + pushed, two + pushed, three + pushed]));
        assert!(!is_settled([one * 0.7, two * 0.7, three * 0.7]));
    }

    /// Forces of fingers that press with `strength` and carry a `weight` [N].
    fn pressing(strength: f32, weight: f32) -> PerFinger<Vector3<f32>> {
        let [one, three] = [0.25, 0.5].map(|share| Vector3::new(0.0, 0.0, share * weight));
        let push = Vector3::new(strength, 0.0, 0.0);
        [one + push * 0.5, one + push * 0.5, three - push]
    }

    #[test]
    fn a_grip_that_is_firm_enough_is_let_be() {
        let (_, mut forces) = grasp(0.0, 0.5);
        // 0.22 N along the surface take 0.44 N of fingers 1 and 2, and finger 3 has both their forces against it.
        for _ in 0..300 {
            tick(&mut forces, 1.0, &pressing(0.9, 0.3));
        }
        let wanted = forces.wanted.map(|force| force[0]);
        assert!((wanted[0] - 0.44).abs() < 2e-3 && (wanted[2] + 0.88).abs() < 4e-3, "{wanted:?}");
        let correction = forces.correction;
        tick(&mut forces, 1.0, &pressing(0.98, 0.3));
        assert_eq!(correction, forces.correction);
        tick(&mut forces, 1.0, &pressing(1.2, 0.3));
        assert!(forces.correction[2][0] > correction[2][0], "released");
        let correction = forces.correction;
        tick(&mut forces, 1.0, &pressing(0.8, 0.3));
        assert!(forces.correction[2][0] < correction[2][0], "pressed harder");
    }

    #[test]
    fn a_load_that_grows_is_met_with_a_firmer_grip_at_once() {
        let (_, mut forces) = grasp(0.0, 0.5);
        for _ in 0..300 {
            tick(&mut forces, 1.0, &pressing(0.9, 0.3));
        }
        // 10 N/s, felt two ticks later.
        for weight in [0.4, 0.5] {
            tick(&mut forces, 1.0, &pressing(0.9, weight));
        }
        let wanted = forces.wanted.map(|force| force[0]);
        // By 4 N for each of the 0.12 N and more that are held ready, and without any, 0.5 N hold 0.63 N against 0.94 N.
        assert!(wanted[0] > 0.44 + 0.4 && wanted[2] < -0.88 - 0.8, "{wanted:?}");
    }

    #[test]
    fn what_the_joints_cannot_is_neither_asked_for_nor_added_up() {
        let (_, mut forces) = grasp(0.0, 0.5);
        // Of 3 N finger 3 carries a half, and has to press with 3.75 N, 0.375 N·m. Motors that are weaker than they say bring 3.2 N.
        let mut asked = 0.0;
        for _ in 0..300 {
            asked = tick(&mut forces, 0.4, &pressing(3.2, 3.0))[2].x;
            assert!(asked > -4.0001, "{asked}");
        }
        let correction = forces.correction[2][0];
        assert!((asked + 4.0).abs() < 1e-3 && (correction + 0.25).abs() < 0.02, "{asked} {correction}");
    }

    #[test]
    fn swinging_forces_meet_no_limit() {
        let (contacts, forces) = grasp(4.0, 0.4);
        assert!((forces.swing(&contacts, 0.5) - 0.5).abs() < 1e-6);
        // From 8 N to the limit of 9 N it is an eighth.
        let (contacts, forces) = grasp(8.0, 0.4);
        let share = forces.swing(&contacts, 0.5);
        assert!((share - 0.125).abs() < 1e-6, "{share}");
        let swung = forces.swung(share);
        assert!((swung[2] - Vector3::new(-1.0, 0.0, 0.0)).norm() < 1e-6, "{swung:?}");
        let (contacts, forces) = grasp(9.5, 0.4);
        assert!(forces.swing(&contacts, 0.5).abs() < 1e-6);

        // With a load, what is too much goes from all fingers alike: finger 3 has room for 0.5 N of 1 N.
        let carried = [Vector3::zeros(), Vector3::zeros(), Vector3::new(-0.5, 0.3, 0.0)];
        let (contacts, forces) = grasp(8.0, 0.4);
        let internal = forces.swung(1.0);
        let room = room_for(&contacts, &internal, &carried, &swung);
        assert!((room - 0.5).abs() < 1e-6, "{room}");
        // The other way there is room for all.
        let back = swung.map(|force| -force);
        assert!((room_for(&contacts, &internal, &carried, &back) - 1.0).abs() < 1e-6);
    }

    #[test]
    fn swinging_across_lets_nothing_slide() {
        let (contacts, forces) = grasp(4.0, 0.8);
        assert!((forces.swing_across(&contacts, &ways(), 0.4) - 0.4).abs() < 1e-6);
        // Of fingers 1 and 2, 0.8 · 0.05 · (2 − 0.92585 s) = 1.37790 s.
        let (contacts, forces) = grasp(4.0, 0.05);
        let size = forces.swing_across(&contacts, &ways(), 0.4);
        assert!((size - 0.056_540).abs() < 1e-5, "{size}");
        for signs in [[1.0, 1.0], [1.0, -1.0], [-1.0, 1.0], [-1.0, -1.0]] {
            for ((contact, force), ways) in contacts.iter().zip(&forces.base).zip(&ways()) {
                let force = Vector3::from(*force) + (ways[0] * signs[0] + ways[1] * signs[1]) * size;
                let push = contact.normal().dot(&force);
                let beside = (force - contact.normal() * push).norm();
                assert!(push < 9.0 && beside <= 0.8 * 0.05 * push + 1e-6, "{push} {beside}");
            }
        }
        // Much friction, little room: 9 N less 8.9 N over 0.92585.
        let (contacts, forces) = grasp(17.8, 1.0);
        let size = forces.swing_across(&contacts[..2], &ways(), 1.0);
        assert!((size - 0.108_01).abs() < 1e-4, "{size}");
    }
}
