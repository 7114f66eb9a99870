use super::edges::{Cells, EdgePoint, MAX_EDGES, edges, row_len};
use super::ellipse::Ellipse;
use super::error::VisionError;
use super::hough::{Candidate, accumulator_len, maxima, radii_about, vote};
use super::image::Image;
use super::judge::{FEATURES, KNOB_FEATURES, Knob, features, knob_features, log_odds};
use super::knob::{hidden, roses};
use super::refit::{Rims, noise};
use super::ring::{MAX_HALF, RAYS, Ring};
use super::starts::{MAX_CANDIDATES, Start, Starts};
use crate::math;

/// Smallest radius [px].
pub(super) const MIN_RADIUS: f32 = 5.0;
/// Largest radius [px]: that of the last level.
const MAX_RADIUS: f32 = 400.0;
/// Radii of the levels of the pyramid, in cells; the first level takes smaller ones too.
const CELL_RADII: [usize; 2] = [6, 25];
/// Levels of the pyramid: cells of 2 to 16 px.
const LEVELS: core::ops::RangeInclusive<u32> = 1..=4;
/// Ends of knobs behind which a rose is looked for.
const MAX_KNOBS: usize = 5;
/// Circles that differ by less in centre and radius are the same one [px].
const SAME: [f32; 2] = [2.5, 2.0];
/// Least confidence of a circle that is found.
const MIN_CONFIDENCE: f32 = 0.2;
/// The end of a knob is looked for down to this part of the smallest radius of a rose.
const KNOB_RADIUS: f32 = 0.65;

/// Where the centre is expected: within `reach` of `center` along both axes.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Window {
    /// Centre [px].
    pub center: [f32; 2],
    /// Largest difference along x and y [px].
    pub reach: f32,
}

/// What is looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CircleSearch {
    /// The radius is expected from … to [px]: from the distance of the camera, as the arm's pose tells it.
    pub radius: [f32; 2],
    /// Near the last result; None searches the whole image.
    pub window: Option<Window>,
    /// Where the axis of the knob vanishes: the point of the image that shows its direction, as the arm knows
    /// it; its centre may lie outside the image. With it, a rose is also found that the knob hides in part.
    pub axis: Option<Window>,
}

/// A circle that was found: an ellipse, see the [module](super).
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Circle {
    /// Centre of the ellipse (x, y) [px].
    pub center: [f32; 2],
    /// Root of the product of the semi-axes [px].
    pub radius: f32,
    /// Semi-axes, the larger first [px].
    pub semi_axes: [f32; 2],
    /// Direction of the larger semi-axis, from x towards y [rad].
    pub angle: f32,
    /// Probability that this is the outermost circle that was looked for, see `docs/find-circle.md`.
    pub confidence: f32,
}

/// Buffers of a search.
#[derive(Debug)]
pub struct Scratch<'a> {
    /// Votes: at least [`accumulator_len`].
    pub accumulator: &'a mut [u16],
    /// Edge points: at least 256; [`MAX_EDGES`] are enough for a camera's image.
    pub points: &'a mut [EdgePoint],
    /// Rows of the reduced image: at least [`row_len`].
    pub rows: &'a mut [i16],
}

/// Owned buffers: of [`accumulator_len`], number of points, [`row_len`].
#[derive(Debug)]
pub struct Buffers<const A: usize, const P: usize, const R: usize> {
    accumulator: [u16; A],
    points: [EdgePoint; P],
    rows: [i16; R],
}

/// Buffers for images of 256 × 240 pixels.
pub type CameraBuffers = Buffers<{ accumulator_len(256, 240) }, MAX_EDGES, { row_len(256) }>;

impl<const A: usize, const P: usize, const R: usize> Buffers<A, P, R> {
    /// Empty buffers.
    pub const fn new() -> Self {
        Self { accumulator: [0; A], points: [EdgePoint::NONE; P], rows: [0; R] }
    }

    /// Lends all of them.
    pub const fn scratch(&mut self) -> Scratch<'_> {
        Scratch { accumulator: &mut self.accumulator, points: &mut self.points, rows: &mut self.rows }
    }
}

impl<const A: usize, const P: usize, const R: usize> Default for Buffers<A, P, R> {
    fn default() -> Self {
        Self::new()
    }
}

impl CircleSearch {
    fn check(&self, image: &Image<'_>, scratch: &Scratch<'_>) -> Result<(), VisionError> {
        let (width, height) = (image.width(), image.height());
        let limit = (0.75 * width.max(height) as f32).min(MAX_RADIUS);
        let [from, to] = self.radius;
        if !(MIN_RADIUS <= from && from < to && to <= limit) {
            return Err(VisionError::Radius { from, to, limit });
        }
        if let Some(Window { center: [x, y], reach }) = self.axis
            && !(x.is_finite() && y.is_finite() && reach >= 0.0 && reach.is_finite())
        {
            return Err(VisionError::Axis { center: [x, y], reach });
        }
        if let Some(Window { center, reach }) = self.window
            && !(image.contains(center[0], center[1], 0.0) && reach >= 1.0 && reach.is_finite())
        {
            return Err(VisionError::Window { center, reach });
        }
        let buffers = [
            ("accumulator", scratch.accumulator.len(), accumulator_len(width, height)),
            ("points", scratch.points.len(), 256),
            ("rows", scratch.rows.len(), row_len(width)),
        ];
        for (name, length, needed) in buffers {
            if length < needed {
                return Err(VisionError::Buffer { name, length, needed });
            }
        }
        Ok(())
    }

    /// Radii of a level, in cells, if any are looked for there.
    fn radii(&self, level: u32) -> Option<[usize; 2]> {
        let side = (1_u32 << level) as f32;
        let least = if level == *LEVELS.start() { 2 } else { CELL_RADII[0] };
        let from = ((KNOB_RADIUS * self.radius[0] / side) as usize).max(least);
        let to = ((self.radius[1] / side) as usize + 1).min(CELL_RADII[1]);
        (from < to).then_some([from, to])
    }

    /// Cells in which a level looks for centres and for edge points.
    fn cells(&self, image: &Image<'_>, level: u32, radius: usize) -> (Cells, Cells) {
        let size = [image.width() >> level, image.height() >> level];
        let all = Cells { from: [0; 2], to: size };
        let Some(window) = self.window else { return (all, all) };
        let around = |reach: f32| {
            let side = 1.0 / (1_u32 << level) as f32;
            let bound = |axis: usize, sign: f32| {
                (((window.center[axis] + sign * reach) * side) as usize).min(size[axis])
            };
            Cells {
                from: [bound(0, -1.0), bound(1, -1.0)],
                to: [(bound(0, 1.0) + 1).min(size[0]), (bound(1, 1.0) + 1).min(size[1])],
            }
        };
        // One cell more, for the smoothing; for the edge points, the circle and Sobel's margin.
        let cell = (1_u32 << level) as f32;
        let near = window.reach + 2.0 * cell;
        (around(near), around(near + (radius + 3) as f32 * cell))
    }

    pub(super) fn allows(&self, ellipse: &Ellipse) -> bool {
        let is_near = |window: &Window| {
            (0..2).all(|axis| math::abs(ellipse.center[axis] - window.center[axis]) <= window.reach)
        };
        ellipse.radius >= self.radius[0]
            && ellipse.radius <= self.radius[1]
            && self.window.as_ref().is_none_or(is_near)
    }
}

/// The outermost circle with an expected radius; None if there is no circle. At most a fixed number of steps.
///
/// # Errors
/// [`VisionError`]: radii or a window outside the limits, a buffer that is too short.
pub fn find_circle(
    image: &Image<'_>,
    search: &CircleSearch,
    scratch: &mut Scratch<'_>,
) -> Result<Option<Circle>, VisionError> {
    let mut candidates = Candidates::NONE;
    each_candidate(image, search, scratch, |candidate| candidates.push(candidate))?;
    let Some((best, confidence)) = candidates.best().filter(|(_, confidence)| *confidence >= MIN_CONFIDENCE)
    else {
        return Ok(None);
    };
    let rims = Rims { image, noise: noise(image), front: best.front.as_ref() };
    let ellipse = rims.refine(&best.ellipse).filter(|fine| search.allows(fine)).unwrap_or(best.ellipse);
    let (semi_axes, angle) = ellipse.axes();
    let Ellipse { center, radius, .. } = ellipse;
    Ok(Some(Circle { center, radius, semi_axes, angle, confidence }))
}

/// What may be the rose.
pub(super) struct Rose {
    pub ellipse: Ellipse,
    /// The end of a knob before it.
    pub front: Option<Ellipse>,
    pub features: [f32; FEATURES],
    pub knob_features: Option<[f32; KNOB_FEATURES]>,
}

/// Calls `found` with each of at most [`MAX_CANDIDATES`] · (1 + [`MAX_KNOBS`]) candidates: each circle, and
/// behind each circle that may be the end of a knob those that it hides in part.
pub(super) fn each_candidate(
    image: &Image<'_>,
    search: &CircleSearch,
    scratch: &mut Scratch<'_>,
    mut found: impl FnMut(&Rose),
) -> Result<(), VisionError> {
    search.check(image, scratch)?;
    let mut starts = Starts::NONE;
    for level in LEVELS {
        if let Some(radii) = search.radii(level) {
            candidates(image, search, level, radii, scratch, &mut starts);
        }
    }
    let noise = noise(image);
    let rim = |ellipse: &Ellipse, front: Option<&Ellipse>| {
        Ring::new(image, ellipse, RAYS, (MAX_HALF, 1.0)).rim(noise, front)
    };
    let mut circles = [None::<Knob>; MAX_CANDIDATES];
    let rims = Rims { image, noise, front: None };
    for (place, ellipse) in circles.iter_mut().zip(rims.fit_all(&starts.list)) {
        let rim = rim(&ellipse, None);
        *place = Some(Knob { ellipse, rim });
        if search.allows(&ellipse) {
            let features = features(search, &ellipse, &rim);
            found(&Rose { ellipse, front: None, features, knob_features: None });
        }
    }
    // The clearest first.
    let rank = |circle: &Option<Knob>| circle.as_ref().map_or(f32::MAX, |circle| circle.rim.jitter - circle.rim.common);
    circles.sort_unstable_by(|one, other| rank(one).total_cmp(&rank(other)));
    for knob in circles.iter().flatten().take(MAX_KNOBS) {
        let behind = match &search.axis {
            Some(axis) => roses(image, search, axis, noise, &knob.ellipse),
            None => hidden(&circles, knob),
        };
        let front = Some(knob.ellipse);
        let rims = Rims { image, noise, front: front.as_ref() };
        for ellipse in rims.fit_all(&behind.list) {
            if search.allows(&ellipse) && ellipse.radius > 0.9 * knob.ellipse.radius {
                let features = features(search, &ellipse, &rim(&ellipse, rims.front));
                let knob_features = search.axis.as_ref().map(|axis| knob_features(&ellipse, knob, axis));
                found(&Rose { ellipse, front, features, knob_features });
            }
        }
    }
    Ok(())
}

/// The candidates with their log odds.
struct Candidates {
    list: [(Ellipse, Option<Ellipse>, f32); MAX_CANDIDATES * (1 + MAX_KNOBS)],
    length: usize,
}

impl Candidates {
    const NONE: Self = Self {
        list: [(Ellipse::circle([0.0; 2], 0.0), None, 0.0); MAX_CANDIDATES * (1 + MAX_KNOBS)],
        length: 0,
    };

    fn push(&mut self, candidate: &Rose) {
        let odds = log_odds(&candidate.features, candidate.knob_features.as_ref());
        if let Some(place) = self.list.get_mut(self.length) {
            *place = (candidate.ellipse, candidate.front, odds);
            self.length += 1;
        }
    }

    /// The likeliest, and the probability of it and of those next to it: one of all is right, or none.
    fn best(&self) -> Option<(Best, f32)> {
        let list = self.list.get(..self.length)?;
        let &(ellipse, front, most) = list.iter().max_by(|one, other| one.2.total_cmp(&other.2))?;
        let reference = most.max(0.0);
        let (mut near, mut all) = (0.0, math::exp(-reference));
        for (other, _, odds) in list {
            let likelihood = math::exp(odds - reference);
            all += likelihood;
            if ellipse.is_near(other, SAME) {
                near += likelihood;
            }
        }
        Some((Best { ellipse, front }, near / all))
    }
}

struct Best {
    ellipse: Ellipse,
    front: Option<Ellipse>,
}

/// Candidates of one level.
fn candidates(
    image: &Image<'_>,
    search: &CircleSearch,
    level: u32,
    radii: [usize; 2],
    scratch: &mut Scratch<'_>,
    starts: &mut Starts,
) {
    let (centers, region) = search.cells(image, level, radii[1]);
    let count = edges(image, level, &region, scratch.rows, scratch.points);
    let Some(points) = scratch.points.get(..count) else { return };
    vote(points, &centers, radii, scratch.accumulator);
    let side = (1_u32 << level) as f32;
    for (x, y, votes) in maxima(&centers, scratch.accumulator) {
        if votes == 0 {
            break;
        }
        radii_about(points, (x, y), radii, |Candidate { x, y, radius, sectors }| {
            let center = [side * (x + 0.5) - 0.5, side * (y + 0.5) - 0.5];
            let ellipse = Ellipse::circle(center, side * radius);
            starts.insert(Start { ellipse, score: sectors as f32, side });
        });
    }
}
