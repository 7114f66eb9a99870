use super::ellipse::Ellipse;
use crate::math;

/// Maximum number of candidates that are fitted.
pub(super) const MAX_CANDIDATES: usize = 14;

/// A candidate at full resolution.
#[derive(Clone, Copy)]
pub(super) struct Start {
    pub ellipse: Ellipse,
    pub score: f32,
    /// Side of a cell at its level [px].
    pub side: f32,
}

impl Start {
    /// Band in which the edge may be: number of steps to each side, of which a ring has at most four, and
    /// step size [px].
    pub fn band(&self) -> (usize, f32) {
        if self.side > 4.0 { (6, 0.25 * self.side) } else { (self.side as usize + 2, 1.0) }
    }
}

/// The best candidates, the best first.
pub(super) struct Starts {
    pub list: [Option<Start>; MAX_CANDIDATES],
}

impl Starts {
    pub const NONE: Self = Self { list: [None; MAX_CANDIDATES] };

    pub fn insert(&mut self, start: Start) {
        // The last candidate is the worst, and is never replaced by a worse one.
        if self.list.last().is_some_and(|last| rank(last) >= start.score) {
            return;
        }
        let is_same = |known: &Start| {
            let near = 0.06 * start.ellipse.radius + 1.5;
            let [dx, dy] =
                [0, 1].map(|axis| math::abs(known.ellipse.center[axis] - start.ellipse.center[axis]));
            dx < near && dy < near && math::abs(known.ellipse.radius - start.ellipse.radius) < near
        };
        if let Some(known) = self.list.iter_mut().flatten().find(|known| is_same(known)) {
            if known.score < start.score {
                *known = start;
                self.list.sort_unstable_by(|one, other| rank(other).total_cmp(&rank(one)));
            }
            return;
        }
        let place = self.list.iter().position(|known| rank(known) < start.score);
        if let Some(place) = place {
            self.list[place..].rotate_right(1);
            self.list[place] = Some(start);
        }
    }
}

fn rank(start: &Option<Start>) -> f32 {
    start.as_ref().map_or(-1.0, |start| start.score)
}
