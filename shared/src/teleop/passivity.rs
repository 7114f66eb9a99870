use nalgebra::Vector3;

use crate::TICK;
use crate::math;

/// Slower than this, the handle stands still [m/s]: damping it would take no energy.
const STILL: f32 = 1e-4;

/// Energy is counted in pieces larger than this [J]: what a noisy place gives and takes again is none.
const QUANTUM: f32 = 1e-3;

/// A microjoule [J].
const MICRO: f32 = 1e-6;

/// One end of a delayed two-way link between a master and a slave: an observer of the energy that comes out there, and what
/// keeps that to what went in at the other end (time-domain passivity with the energies of both directions apart; Ryu,
/// Artigas and Preusche 2010).
///
/// Under hold, the work of a force over a control period is exactly the force times the way. Each end counts what goes in
/// ([`Port::given`], which travels to the other end beside the force or the position) and what comes out. The other end's
/// count arrives late, never early, so keeping to it keeps the whole link from making energy, whatever the delay.
///
/// Counts grow for as long as the link is up, so they are whole microjoules: an `f32` of 16 kJ is off by a millijoule.
///
/// - At the *master*, a force comes out: it is damped ([`Port::force`]).
/// - At the *slave*, a motion comes out: it waits until there is energy for it ([`Port::way`]).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Port {
    /// Energy that went in here so far [µJ].
    given: i64,
    /// Energy that came out here so far [µJ].
    taken: i64,
    /// Of that, what damping here took back [µJ].
    damped: i64,
    /// What came out, or if negative went in, and is not counted yet [J].
    pending: f32,
    /// What damping took back, and is not counted yet [J].
    damping: f32,
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
        Self { given: 0, taken: 0, damped: 0, pending: 0.0, damping: 0.0 }
    }

    /// Energy that went in here so far [µJ]: to be sent to the other end.
    pub const fn given(&self) -> i64 {
        self.given
    }

    /// What went in less what came out [µJ].
    pub const fn balance(&self) -> i64 {
        let (counted, _) = split(self.damping - self.pending);
        self.less_taken(self.given).saturating_add(counted)
    }

    /// An energy less what came out and was not damped [µJ].
    const fn less_taken(&self, energy: i64) -> i64 {
        energy.saturating_sub(self.taken).saturating_add(self.damped)
    }

    /// What may still come out, with what is known of the other end [J].
    #[expect(clippy::cast_precision_loss, reason = "exact to a microjoule where little is left")]
    const fn allowed(&self, limits: &PortLimits, received: i64) -> f32 {
        self.less_taken(received) as f32 * MICRO + limits.reserve + self.damping - self.pending
    }

    /// Counts a period in which the link pushed with `force` [N], in the mean, over a `way` [m], and with `damping` besides.
    pub fn count(&mut self, force: &Vector3<f32>, damping: &Vector3<f32>, way: &Vector3<f32>) {
        self.pending += force.dot(way);
        if math::abs(self.pending) > QUANTUM {
            let (counted, rest) = split(self.pending);
            self.pending = rest;
            let of = if counted > 0 { &mut self.taken } else { &mut self.given };
            *of = of.saturating_add(counted.saturating_abs());
        }
        let (counted, rest) = split(self.damping - damping.dot(way));
        (self.damped, self.damping) = (self.damped.saturating_add(counted), rest);
    }

    /// The damping [N] to be added to `force` at the master's end, whose handle moves with `velocity` [m/s]; `received`: what
    /// has gone in at the other end, as far as it is known here [µJ].
    pub fn force(
        &self,
        limits: &PortLimits,
        received: i64,
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

    /// How much of `way` [m] the slave's end may go while the link pushes there with `force` [N] at most; `received` as in
    /// [`Port::force`].
    pub fn way(
        &self,
        limits: &PortLimits,
        received: i64,
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

/// An energy [J] as whole microjoules, and what is left of it [J].
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_precision_loss,
    reason = "saturates; what a period moves is exact enough"
)]
const fn split(energy: f32) -> (i64, f32) {
    let counted = (energy / MICRO) as i64;
    (counted, energy - counted as f32 * MICRO)
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
        let (mut forward, mut back) = (vec![(place, 0); delay], vec![(Vector3::zeros(), 0); delay]);
        let (mut master, mut slave, mut reference) = (Port::new(), Port::new(), Vector3::zeros());
        let mut largest = 0.0_f32;
        for tick in 0..1000 {
            let (target, received): (Vector3<f32>, i64) = forward.remove(0);
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
        let half = port.way(&LIMITS, 5000, &force, &way);
        assert!((half.x - 0.0025).abs() < 1e-8);
        port.count(&force, &Vector3::zeros(), &half);
        assert!(port.way(&LIMITS, 5000, &force, &way).norm() < 1e-8);
        // The other way it gives, and needs nobody's leave.
        assert_eq!(port.way(&LIMITS, 5000, &force, &-way), -way);
        port.count(&force, &Vector3::zeros(), &-way);
        assert!((port.given() - 20_000).abs() <= 1 && (port.balance() - 15_000).abs() <= 1, "{port:?}");
    }

    #[test]
    fn a_millijoule_counts_however_much_went_through_before() {
        let (mut one, mut other) = (Port::new(), Port::new());
        let (force, still) = (Vector3::new(1.0, 0.0, 0.0), Vector3::zeros());
        // 2 kW for ten seconds, or 3 W for two hours.
        for _ in 0..20_000 {
            one.count(&force, &still, &-force);
            other.count(&force, &still, &force);
        }
        let piece = force * 1.1e-3;
        (0..1000).for_each(|_| one.count(&force, &still, &-piece));
        let way = other.way(&LIMITS, one.given(), &force, &(force * 10.0));
        assert!((way.x - 1.1).abs() < 2e-3, "{way}");
        // And what damping takes back.
        (0..1000).for_each(|_| one.count(&still, &-force, &piece));
        let damped = one.balance() - one.given();
        assert!((damped - 1_100_000).abs() < 100, "{damped}");
    }
}
