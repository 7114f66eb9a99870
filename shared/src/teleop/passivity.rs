use nalgebra::Vector3;

use crate::TICK;
use crate::math;

/// Slower than this, the handle stands still [m/s]: damping it would take no energy.
const STILL: f32 = 1e-4;

/// Energy is counted in pieces larger than this [J]: what a noisy place gives and takes again is none.
const QUANTUM: f32 = 1e-3;

/// One end of a delayed two-way link between a master and a slave: an observer of the energy that comes out there, and what
/// keeps that to what went in at the other end (time-domain passivity with the energies of both directions apart; Ryu,
/// Artigas and Preusche 2010).
///
/// Under hold, the work of a force over a control period is exactly the force times the way. Each end counts what goes in
/// ([`Port::given`], which travels to the other end beside the force or the position) and what comes out. The other end's
/// count arrives late, never early, so keeping to it keeps the whole link from making energy, whatever the delay.
///
/// - At the *master*, a force comes out: it is damped ([`Port::force`]).
/// - At the *slave*, a motion comes out: it waits until there is energy for it ([`Port::way`]).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Port {
    /// Energy that went in here so far [J].
    given: f32,
    /// Energy that came out here so far [J].
    taken: f32,
    /// Of that, what damping here took back [J].
    damped: f32,
    /// What came out, or if negative went in, and is not counted yet [J].
    pending: f32,
}

/// What a link may do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PortLimits {
    /// Most damping that the master's end adds [N·s/m]; less than the mass of handle and hand over a control period.
    pub damping: f32,
    /// Energy that may come out before any went in [J]: without it, a spring at the slave's end could not begin to be
    /// pressed.
    pub reserve: f32,
}

impl Port {
    /// Nothing went in or came out.
    pub const fn new() -> Self {
        Self { given: 0.0, taken: 0.0, damped: 0.0, pending: 0.0 }
    }

    /// Energy that went in here so far [J]: to be sent to the other end.
    pub const fn given(&self) -> f32 {
        self.given
    }

    /// What went in less what came out [J].
    pub const fn balance(&self) -> f32 {
        self.given - self.taken - self.pending + self.damped
    }

    /// What may still come out, with what is known of the other end [J].
    fn allowed(&self, limits: &PortLimits, received: f32) -> f32 {
        received + limits.reserve + self.damped - self.taken - self.pending
    }

    /// Counts a period in which the link pushed with `force` [N], in the mean, over a `way` [m], and with `damping` besides.
    pub fn count(&mut self, force: &Vector3<f32>, damping: &Vector3<f32>, way: &Vector3<f32>) {
        self.pending += force.dot(way);
        if self.pending > QUANTUM {
            self.taken += core::mem::take(&mut self.pending);
        } else if self.pending < -QUANTUM {
            self.given -= core::mem::take(&mut self.pending);
        }
        self.damped -= damping.dot(way);
    }

    /// The damping [N] to be added to `force` at the master's end, whose handle moves with `velocity` [m/s]; `received`: what
    /// has gone in at the other end, as far as it is known here [J].
    pub fn force(
        &self,
        limits: &PortLimits,
        received: f32,
        force: &Vector3<f32>,
        velocity: &Vector3<f32>,
    ) -> Vector3<f32> {
        let work = force.dot(velocity) * TICK;
        let excess = if work > 0.0 { work } else { 0.0 } - self.allowed(limits, received);
        let square = velocity.norm_squared();
        if excess <= 0.0 || square < STILL * STILL {
            return Vector3::zeros();
        }
        velocity * -math::clamp(excess / (square * TICK), 0.0, limits.damping)
    }

    /// How much of `way` [m] the slave's end may go while the link pushes there with `force` [N] at most.
    pub fn way(
        &self,
        limits: &PortLimits,
        received: f32,
        force: &Vector3<f32>,
        way: &Vector3<f32>,
    ) -> Vector3<f32> {
        let work = force.dot(way);
        let allowed = self.allowed(limits, received);
        if work <= 0.0 || work <= allowed {
            *way
        } else if allowed <= 0.0 {
            Vector3::zeros()
        } else {
            way * (allowed / work)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: PortLimits = PortLimits { damping: 50.0, reserve: 0.0 };

    /// A mass on a spring that is felt 60 ms late: without the ports its swings grow, with them they never hold more than
    /// what was put in.
    fn largest_swing(guarded: bool) -> f32 {
        let (mass, stiffness, delay) = (1.5_f32, 300.0_f32, 3);
        let (mut place, mut speed) = (Vector3::new(0.02_f32, 0.0, 0.0), Vector3::zeros());
        let (mut forward, mut back) = (vec![(place, 0.0); delay], vec![(Vector3::zeros(), 0.0); delay]);
        let (mut master, mut slave, mut reference) = (Port::new(), Port::new(), Vector3::zeros());
        let mut largest = 0.0_f32;
        for tick in 0..1000 {
            let (target, received): (Vector3<f32>, f32) = forward.remove(0);
            // The link pulls the spring.
            let way = target - reference;
            let way = if guarded { slave.way(&LIMITS, received, &(target * stiffness), &way) } else { way };
            let mean = (reference + way * 0.5) * stiffness;
            slave.count(&mean, &Vector3::zeros(), &way);
            reference += way;
            back.push((-reference * stiffness, slave.given()));
            let (force, received) = back.remove(0);
            let damping =
                if guarded { master.force(&LIMITS, received, &force, &speed) } else { Vector3::zeros() };
            let acceleration = (force + damping) / mass;
            let way = speed * TICK + acceleration * (0.5 * TICK * TICK);
            master.count(&force, &damping, &way);
            place += way;
            speed += acceleration * TICK;
            forward.push((place, master.given()));
            if tick > 100 {
                largest = largest.max(place.norm());
            }
        }
        largest
    }

    #[test]
    fn a_late_spring_makes_energy_only_without_the_ports() {
        let (free, guarded) = (largest_swing(false), largest_swing(true));
        assert!(free > 1.0, "{free}");
        assert!(guarded < 0.03, "{guarded}");
    }

    #[test]
    fn what_comes_out_is_what_went_in_at_the_other_end() {
        let mut port = Port::new();
        let (force, way) = (Vector3::new(2.0, 0.0, 0.0), Vector3::new(0.01, 0.0, 0.0));
        // 20 mJ are asked for, 5 mJ went in at the other end.
        let half = port.way(&LIMITS, 0.005, &force, &way);
        assert!((half.x - 0.0025).abs() < 1e-8);
        port.count(&force, &Vector3::zeros(), &half);
        assert_eq!(port.way(&LIMITS, 0.005, &force, &way), Vector3::zeros());
        // The other way it gives, and needs nobody's leave.
        assert_eq!(port.way(&LIMITS, 0.005, &force, &-way), -way);
        port.count(&force, &Vector3::zeros(), &-way);
        assert!((port.given() - 0.02).abs() < 1e-8 && (port.balance() - 0.015).abs() < 1e-8);
    }
}
