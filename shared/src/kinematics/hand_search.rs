//! Search of a [`Hand`](super::Hand) beyond the nearest minimum: see [`super::hand_inverse`].

use super::hand::{Angles, MAX_FINGERS, angle, set_angle};
use super::hand_inverse::{InverseProblem, Iterate, Iterates};
use super::random_starts::RandomStarts;

/// Maximum number of the last iterations if the search found no start from which all targets are reached.
const MAX_FINAL_ITERATIONS: usize = 60;
/// Values of the shared joint from which a search starts.
const GRID: u8 = 7;
/// Starts of each finger at each of these values.
const FINGER_STARTS: u8 = 3;

impl InverseProblem<'_> {
    /// Searches beyond the local minimum. For a given angle of the shared joint the fingers are independent,
    /// so each can be searched alone: a grid over that angle, then all fingers together from its two best
    /// values; then random starts.
    pub(super) fn search(&self, points: &mut Iterates<'_>, evaluations: &mut u16) {
        let exact = InverseProblem { irreducible: f32::INFINITY, ..*self };
        exact.finish(points, MAX_FINAL_ITERATIONS, evaluations);
        if points.here.reached && points.here.directed {
            return;
        }
        let mut best = points.here.clone();
        exact.search_elsewhere(&mut best, points, evaluations);
        *points.here = best;
        exact.finish(points, MAX_FINAL_ITERATIONS, evaluations);
    }

    /// Descends from other starts until the targets are reached.
    fn search_elsewhere(&self, best: &mut Iterate, points: &mut Iterates<'_>, evaluations: &mut u16) {
        let mut starts = RandomStarts::new();
        // Returns whether the search ends.
        let try_from =
            |angles: &Angles, best: &mut Iterate, points: &mut Iterates<'_>, evaluations: &mut u16| {
                self.descend(angles, points, evaluations);
                if points.here.is_better_than(best) {
                    best.clone_from(points.here);
                }
                best.reached && best.directed || *evaluations >= self.options.evaluations
            };
        let shared = self.hand.shared.filter(|_| self.fingers().any(|(_, finger, _)| finger.shares));
        if let Some(shared) = shared {
            let mut two = [(f32::INFINITY, best.angles); 2];
            let (lower, upper) = self.limits(shared);
            for number in 0..GRID {
                let fraction = (f32::from(number) + 0.5) / f32::from(GRID);
                let mut angles = best.angles;
                set_angle(&mut angles, shared, lower + fraction * (upper - lower));
                let cost = self.fingers_alone(&mut angles, &mut starts, points, evaluations);
                if cost < two[0].0 {
                    two = [(cost, angles), two[0]];
                } else if cost < two[1].0 {
                    two[1] = (cost, angles);
                }
            }
            if two.iter().any(|(_, angles)| try_from(angles, best, points, evaluations)) {
                return;
            }
        }
        for _ in 0..self.options.restarts {
            let mut angles = best.angles;
            for (_, finger, _) in self.fingers() {
                for &joint in &finger.variables {
                    set_angle(&mut angles, joint, starts.angle(self.limits(joint)));
                }
            }
            if try_from(&angles, best, points, evaluations) {
                return;
            }
        }
    }

    /// Solves each finger alone at the angle of the shared joint in `angles`, from several starts. Returns
    /// the sum of the position costs.
    fn fingers_alone(
        &self,
        angles: &mut Angles,
        starts: &mut RandomStarts,
        points: &mut Iterates<'_>,
        evaluations: &mut u16,
    ) -> f32 {
        let mut sum = 0.0;
        let center = self.hand.center();
        for (index, finger, target) in self.fingers() {
            let mut targets = [None; MAX_FINGERS];
            if let Some(place) = targets.get_mut(index) {
                *place = Some(*target);
            }
            let alone = InverseProblem { targets: &targets, moves_shared: false, ..*self };
            let own = finger.own();
            let mut best: Option<Iterate> = None;
            for start in 0..FINGER_STARTS {
                let mut from = *angles;
                for &joint in finger.variables.iter().take(own) {
                    match start {
                        0 => {}
                        1 => set_angle(&mut from, joint, angle(&center, joint)),
                        _ => set_angle(&mut from, joint, starts.angle(self.limits(joint))),
                    }
                }
                alone.descend(&from, points, evaluations);
                if best.as_ref().is_none_or(|best| points.here.is_better_than(best)) {
                    best = Some(points.here.clone());
                }
            }
            if let Some(best) = best {
                sum += best.primary;
                *angles = best.angles;
            }
        }
        sum
    }
}
