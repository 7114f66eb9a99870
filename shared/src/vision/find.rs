use super::edges::{Cells, EdgePoint, MAX_EDGES, edges, row_len};
use super::ellipse::Ellipse;
use super::error::VisionError;
use super::hough::{Candidate, accumulator_len, maxima, radii_about, vote};
use super::image::Image;
use super::refit::{Fit, noise, refit};
use crate::math;

/// Smallest radius [px].
pub(super) const MIN_RADIUS: f32 = 5.0;
/// Largest radius [px]: that of the last level.
const MAX_RADIUS: f32 = 400.0;
/// Radii of the levels of the pyramid, in cells; the first level takes smaller ones too.
const CELL_RADII: [usize; 2] = [6, 25];
/// Levels of the pyramid: cells of 2 to 16 px.
const LEVELS: core::ops::RangeInclusive<u32> = 1..=4;
/// Least strength of the evidence for a circle.
const MIN_STRENGTH: f32 = 0.45;
/// Least strength of the evidence for a circle that hides others.
const FRONT_STRENGTH: f32 = 0.72;
/// Least number of rays on which a circle is judged.
const MIN_RAYS: u32 = 20;
/// Number of visible rays that is as good as all.
const MANY_RAYS: f32 = 40.0;
/// Distance of two fits to the same rim, over its radius.
const SAME_RIM: f32 = 0.12;
/// Most candidates that are fitted.
const MAX_CANDIDATES: usize = 14;

/// Where the centre is expected: within `reach` of `center` along both axes.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Window {
    /// Centre, inside the image [px].
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
        let from = ((self.radius[0] / side) as usize).max(least);
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

    fn allows(&self, ellipse: &Ellipse) -> bool {
        let is_near = |window: &Window| {
            (0..2).all(|axis| math::abs(ellipse.center[axis] - window.center[axis]) <= window.reach)
        };
        ellipse.radius >= self.radius[0]
            && ellipse.radius <= self.radius[1]
            && self.window.as_ref().is_none_or(is_near)
    }
}

/// A candidate at full resolution.
#[derive(Clone, Copy)]
struct Start {
    ellipse: Ellipse,
    score: f32,
    /// Side of a cell at its level [px].
    side: f32,
}

/// The best candidates, the best first.
struct Starts {
    list: [Option<Start>; MAX_CANDIDATES],
}

impl Starts {
    fn insert(&mut self, start: Start) {
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

/// The outermost circle with an expected radius; None if there is no circle. At most a fixed number of steps.
///
/// # Errors
/// [`VisionError`]: radii or a window outside the limits, a buffer that is too short.
pub fn find_circle(
    image: &Image<'_>,
    search: &CircleSearch,
    scratch: &mut Scratch<'_>,
) -> Result<Option<Circle>, VisionError> {
    search.check(image, scratch)?;
    let mut starts = Starts { list: [None; MAX_CANDIDATES] };
    for level in LEVELS {
        if let Some(radii) = search.radii(level) {
            candidates(image, search, level, radii, scratch, &mut starts);
        }
    }
    let noise = noise(image);
    let mut fits = [None::<Fit>; MAX_CANDIDATES];
    for (fit, start) in fits.iter_mut().zip(starts.list.iter().flatten()) {
        let (band, unit) =
            if start.side > 4.0 { (6, 0.25 * start.side) } else { (start.side as usize + 2, 1.0) };
        *fit = refit(image, &start.ellipse, band, unit, noise).filter(|fit| search.allows(&fit.ellipse));
    }
    Ok(outermost(&fits).map(|(fit, confidence)| {
        let (semi_axes, angle) = fit.ellipse.axes();
        Circle { center: fit.ellipse.center, radius: fit.ellipse.radius, semi_axes, angle, confidence }
    }))
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

/// The circle with the longest rim that is seen, of those with enough evidence, and its confidence: of
/// concentric ones the outermost. Of several fits to one rim, that with the most evidence.
fn outermost(fits: &[Option<Fit>]) -> Option<(Fit, f32)> {
    let mut strengths = [0.0; MAX_CANDIDATES];
    for (strength, fit) in strengths.iter_mut().zip(fits) {
        *strength = fit.as_ref().map_or(0.0, |fit| evidence(fit, fits));
    }
    let length = |(fit, strength): &(&Fit, f32)| strength * fit.ellipse.radius;
    let circles = || {
        let pairs = fits.iter().zip(strengths).filter_map(|(fit, strength)| Some((fit.as_ref()?, strength)));
        pairs.filter(|(_, strength)| *strength >= MIN_STRENGTH)
    };
    let (outer, _) = circles().max_by(|one, other| length(one).total_cmp(&length(other)))?;
    let same = circles().filter(|(fit, _)| distance(fit, outer) < SAME_RIM * outer.ellipse.radius);
    let (fit, strength) = same.max_by(|one, other| one.1.total_cmp(&other.1))?;
    Some((*fit, confidence(strength)))
}

/// Share of right answers by the strength of the evidence, measured on drawn door knobs; linear in between.
fn confidence(strength: f32) -> f32 {
    const SHARES: [(f32, f32); 6] =
        [(0.45, 0.4), (0.55, 0.7), (0.65, 0.83), (0.75, 0.88), (0.85, 0.91), (1.0, 0.97)];
    let above = SHARES.windows(2).find(|pair| matches!(pair, [_, (upper, _)] if strength <= *upper));
    match above {
        Some(&[(lower, from), (upper, to)]) => {
            from + (to - from) * math::clamp((strength - lower) / (upper - lower), 0.0, 1.0)
        }
        _ => SHARES[SHARES.len() - 1].1,
    }
}

/// Strength of the evidence for a circle, 0 to 1. Where the knob hides the rim of the rose, no rim is expected.
fn evidence(fit: &Fit, fits: &[Option<Fit>]) -> f32 {
    let front = fits.iter().flatten().filter(|front| is_in_front(front, fit));
    let hidden = front.fold(0, |hidden, front| hidden | fit.hidden_by(&front.ellipse));
    let open = fit.visible & !hidden;
    let mut strength = fit.strength(fit.visible);
    if open.count_ones() >= MIN_RAYS {
        strength = strength.max(fit.strength(open));
    }
    // Any edges fit a short arc.
    strength * (fit.visible.count_ones() as f32 / MANY_RAYS).min(1.0)
}

/// How far apart two circles are [px].
fn distance(one: &Fit, other: &Fit) -> f32 {
    let [dx, dy] = [0, 1].map(|axis| one.ellipse.center[axis] - other.ellipse.center[axis]);
    math::sqrt(dx * dx + dy * dy) + math::abs(one.ellipse.radius - other.ellipse.radius)
}

/// Whether one circle is the end of a cylinder that stands on the other: seen nearly all around, not much larger,
/// and at another place.
fn is_in_front(front: &Fit, fit: &Fit) -> bool {
    front.ellipse.radius < 1.1 * fit.ellipse.radius
        && distance(front, fit) > SAME_RIM * fit.ellipse.radius
        && front.strength(front.visible) > FRONT_STRENGTH
}
