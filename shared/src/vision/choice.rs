//! The choice between candidate circles.

use super::ellipse::Ellipse;
#[cfg(feature = "test-support")]
use super::evidence::Evidence;
use super::find::CircleSearch;
use super::image::Image;
use super::judge::{Knob, log_odds};
#[cfg(feature = "test-support")]
use super::judge::{behind, features};
use super::knob::{hidden, roses};
use super::refit::{Rims, noise};
use super::ring::{FEW_RAYS, MAX_HALF, RAYS, Ring};
use super::starts::{MAX_CANDIDATES, Starts};
use crate::math;

/// Maximum number of circles that are tried as the end of a knob in front of a rose.
pub(super) const MAX_KNOBS: usize = 4;
/// Maximum number of roses that are fitted behind each.
const MAX_BEHIND: usize = 12;
/// Maximum number of candidates that are examined closely.
const MAX_CLOSE: usize = 8;
/// Candidates that differ by less in centre and radius lead to the same circle [px].
const REPEATED: [f32; 2] = [0.8, 0.6];
/// Circles that differ by less in centre and radius are the same one [px].
const SAME: [f32; 2] = [2.5, 2.0];

/// A candidate for the rose.
#[derive(Clone, Copy)]
pub(super) struct Candidate {
    pub ellipse: Ellipse,
    /// Index of the end of a knob in front of it.
    pub knob: Option<usize>,
    /// Logarithm of the likelihood ratio of this circle to no circle.
    pub log_odds: f32,
}

/// The search in a picture, stage by stage.
pub(super) struct Choice<'a> {
    image: &'a Image<'a>,
    search: &'a CircleSearch,
    noise: f32,
    /// Circles that may be the end of a knob, the clearest first.
    circles: [Option<Knob>; MAX_CANDIDATES],
    /// The likeliest first, as they were before [`Self::look_closer`].
    candidates: [Option<Candidate>; MAX_CLOSE],
}

impl<'a> Choice<'a> {
    pub fn new(image: &'a Image<'a>, search: &'a CircleSearch) -> Self {
        let noise = noise(image);
        Self { image, search, noise, circles: [None; MAX_CANDIDATES], candidates: [None; MAX_CLOSE] }
    }

    pub fn front(&self, knob: Option<usize>) -> Option<Ellipse> {
        knob.and_then(|knob| self.circles.get(knob).copied().flatten()).map(|knob| knob.ellipse)
    }

    fn log_odds(&self, ellipse: &Ellipse, knob: Option<usize>, rays: usize) -> f32 {
        let ring = Ring::new(self.image, ellipse, rays, (MAX_HALF, 1.0));
        let rim = ring.rim(self.noise, self.front(knob).as_ref());
        let knob = knob.and_then(|knob| self.circles.get(knob).and_then(Option::as_ref));
        log_odds(self.search, ellipse, &rim, knob)
    }

    /// Keeps the likeliest candidates, and only one for each circle.
    fn insert(&mut self, candidate: Candidate) {
        let is_same = |known: &Option<Candidate>| {
            known.is_some_and(|known| known.ellipse.is_near(&candidate.ellipse, REPEATED))
        };
        if let Some(place) = self.candidates.iter().position(is_same) {
            if self.candidates[place].is_some_and(|known| known.log_odds >= candidate.log_odds) {
                return;
            }
            self.candidates[place..].rotate_left(1);
            self.candidates[MAX_CLOSE - 1] = None;
        }
        let is_less =
            |known: &Option<Candidate>| known.is_none_or(|known| known.log_odds < candidate.log_odds);
        if let Some(place) = self.candidates.iter().position(is_less) {
            self.candidates[place..].rotate_right(1);
            self.candidates[place] = Some(candidate);
        }
    }

    /// Fits unoccluded circles.
    pub fn begin(&mut self, starts: &Starts) {
        let rims = self.rims(None);
        let mut circles = [None::<Knob>; MAX_CANDIDATES];
        for (place, ellipse) in circles.iter_mut().zip(rims.fit_all(&starts.list)) {
            let rim = Ring::new(self.image, &ellipse, FEW_RAYS, (MAX_HALF, 1.0)).rim(self.noise, None);
            *place = Some(Knob { ellipse, rim });
            if self.search.allows(&ellipse) {
                let log_odds = log_odds(self.search, &ellipse, &rim, None);
                self.insert(Candidate { ellipse, knob: None, log_odds });
            }
        }
        let rank = |circle: &Option<Knob>| {
            circle.as_ref().map_or(f32::MAX, |knob| knob.rim.jitter - knob.rim.common)
        };
        circles.sort_unstable_by(|one, other| rank(one).total_cmp(&rank(other)));
        self.circles = circles;
    }

    /// Fits circles that one of the others partly hides.
    pub fn look_behind(&mut self, knob: usize) {
        let Some(Some(front)) = self.circles.get(knob).copied() else { return };
        let behind = match &self.search.axis {
            Some(axis) => roses(self.image, self.search, axis, self.noise, &front.ellipse),
            None => hidden(&self.circles, &front),
        };
        let rims = self.rims(Some(&front.ellipse));
        for ellipse in rims.fit_all(&behind.list).take(MAX_BEHIND) {
            if self.search.allows(&ellipse) && ellipse.radius > 0.9 * front.ellipse.radius {
                let log_odds = self.log_odds(&ellipse, Some(knob), FEW_RAYS);
                self.insert(Candidate { ellipse, knob: Some(knob), log_odds });
            }
        }
    }

    /// Refits and re-evaluates the likeliest candidates on all rays.
    pub fn look_closer(&mut self) {
        for index in 0..MAX_CLOSE {
            let Some(mut candidate) = self.candidates[index] else { break };
            let front = self.front(candidate.knob);
            let closer = self.rims(front.as_ref()).closer(&candidate.ellipse);
            candidate.ellipse = self.allowed(closer, &candidate.ellipse);
            candidate.log_odds = self.log_odds(&candidate.ellipse, candidate.knob, RAYS);
            self.candidates[index] = Some(candidate);
        }
    }

    /// The likeliest circle with its confidence.
    pub fn best(&self) -> Option<(&Candidate, f32)> {
        best(&self.candidates)
    }

    /// The features on which the evaluation of each candidate is based.
    #[cfg(feature = "test-support")]
    pub fn evidence(&self) -> impl Iterator<Item = Evidence> + '_ {
        self.candidates.iter().flatten().map(|candidate| {
            let Candidate { ellipse, knob, log_odds } = candidate;
            let rim = Ring::new(self.image, ellipse, RAYS, (MAX_HALF, 1.0))
                .rim(self.noise, self.front(*knob).as_ref());
            let knob = knob.and_then(|knob| self.circles.get(knob).and_then(Option::as_ref));
            let fine = self.closest(candidate);
            Evidence {
                center: ellipse.center,
                radius: ellipse.radius,
                fine_center: fine.center,
                fine_radius: fine.radius,
                features: features(self.search, ellipse, &rim),
                behind: behind(self.search, ellipse, knob),
                log_odds: *log_odds,
            }
        })
    }

    /// Fits the ellipse of a candidate to the edge in fine steps.
    pub fn closest(&self, candidate: &Candidate) -> Ellipse {
        let front = self.front(candidate.knob);
        self.allowed(self.rims(front.as_ref()).closest(&candidate.ellipse), &candidate.ellipse)
    }

    /// Refines the ellipse of a candidate to a fraction of a pixel, which may take it over a limit of the
    /// search.
    pub fn refine(&self, candidate: &Candidate) -> Ellipse {
        let (near, front) = (self.closest(candidate), self.front(candidate.knob));
        self.rims(front.as_ref()).refine(&near).unwrap_or(near)
    }

    /// The image with the end of a knob in front of the rim.
    const fn rims<'b>(&self, front: Option<&'b Ellipse>) -> Rims<'b>
    where
        'a: 'b,
    {
        Rims { image: self.image, noise: self.noise, front }
    }

    /// A fitted ellipse if the search allows it, otherwise the one before.
    fn allowed(&self, fitted: Option<Ellipse>, before: &Ellipse) -> Ellipse {
        fitted.filter(|fitted| self.search.allows(fitted)).unwrap_or(*before)
    }
}

/// The likeliest candidate, and the probability of it and its near duplicates, given that at most one circle
/// is right.
pub(super) fn best(candidates: &[Option<Candidate>]) -> Option<(&Candidate, f32)> {
    let all = || candidates.iter().flatten();
    let best = all().max_by(|one, other| one.log_odds.total_cmp(&other.log_odds))?;
    let reference = best.log_odds.max(0.0);
    let (mut near, mut sum) = (0.0, math::exp(-reference));
    for other in all() {
        let likelihood = math::exp(other.log_odds - reference);
        sum += likelihood;
        if best.ellipse.is_near(&other.ellipse, SAME) {
            near += likelihood;
        }
    }
    Some((best, near / sum))
}
