use super::choice::{Choice, MAX_KNOBS};
use super::edges::{Cells, EdgePoint, MAX_EDGES, edges, row_len};
use super::ellipse::Ellipse;
use super::error::VisionError;
use super::hough::{self, accumulator_len, maxima, radii_about, vote};
use super::image::Image;
use super::starts::{Start, Starts};
use crate::math;

/// Smallest radius [px].
pub(super) const MIN_RADIUS: f32 = 5.0;
/// Largest radius [px]: that of the last level.
const MAX_RADIUS: f32 = 400.0;
/// Radii at each level of the pyramid, in cells; the first level also has smaller ones.
const CELL_RADII: [usize; 2] = [6, 25];
/// Levels of the pyramid: cells of 2 to 16 px.
const LEVELS: core::ops::RangeInclusive<u32> = 1..=4;
/// Minimum confidence of a circle that is returned.
const MIN_CONFIDENCE: f32 = 0.1;
/// The end of a knob is searched down to this share of the smallest radius of a rose.
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

/// The circle to search for.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct CircleSearch {
    /// Expected range of the radius [px], from the distance of the camera by the arm's pose.
    pub radius: [f32; 2],
    /// A window about the last result; `None`: the whole image.
    pub window: Option<Window>,
    /// Vanishing point of the axis of the knob, that is, its direction by the arm's pose; it may lie outside
    /// the image. With it, a rose that the knob partly hides is found, too.
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
    /// Probability that this circle with an expected radius is right, see `docs/find-circle.md`.
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

/// Owned buffers: [`accumulator_len`] votes, a number of points, [`row_len`] row elements.
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

    /// Borrows all buffers.
    pub const fn scratch(&mut self) -> Scratch<'_> {
        Scratch { accumulator: &mut self.accumulator, points: &mut self.points, rows: &mut self.rows }
    }
}

impl<const A: usize, const P: usize, const R: usize> Default for Buffers<A, P, R> {
    fn default() -> Self {
        Self::new()
    }
}

/// Smallest and largest radius that [`find_circle`] finds in images of this size [px].
pub fn radius_limits(width: usize, height: usize) -> [f32; 2] {
    [MIN_RADIUS, (0.75 * width.max(height) as f32).min(MAX_RADIUS)]
}

impl CircleSearch {
    /// The part of the search with radii within `limits` [px]; `None` if there is none.
    pub fn within(self, limits: [f32; 2]) -> Option<Self> {
        let radius = [self.radius[0].max(limits[0]), self.radius[1].min(limits[1])];
        (radius[0] < radius[1]).then_some(Self { radius, ..self })
    }

    fn check(&self, image: &Image<'_>, scratch: &Scratch<'_>) -> Result<(), VisionError> {
        let (width, height) = (image.width(), image.height());
        let [_, limit] = radius_limits(width, height);
        let [from, to] = self.radius;
        let is_in = |place: f32, side: usize| (0.0..=(side - 1) as f32).contains(&place);
        if !(MIN_RADIUS <= from && from < to && to <= limit) {
            return Err(VisionError::Radius { from, to, limit });
        }
        if let Some(Window { center: [x, y], reach }) = self.axis
            && !(x.is_finite() && y.is_finite() && reach >= 0.0 && reach.is_finite())
        {
            return Err(VisionError::Axis { center: [x, y], reach });
        }
        if let Some(Window { center, reach }) = self.window
            && !(is_in(center[0], width) && is_in(center[1], height) && reach >= 1.0 && reach.is_finite())
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

    /// Radii that are searched at a level, in cells, if any.
    fn radii(&self, level: u32) -> Option<[usize; 2]> {
        let side = (1_u32 << level) as f32;
        let min = if level == *LEVELS.start() { 2 } else { CELL_RADII[0] };
        let from = ((KNOB_RADIUS * self.radius[0] / side) as usize).max(min);
        let to = ((self.radius[1] / side) as usize + 1).min(CELL_RADII[1]);
        (from < to).then_some([from, to])
    }

    /// Cells in which centres, and in which edge points, are searched at a level.
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
        // One more cell for the smoothing; for the edge points also the circle and Sobel's margin.
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

/// Finds the likeliest circle with an expected radius; `None` if there is no circle. The last refinement may
/// take centre and radius over the limits of the search by up to 4 px. The number of steps is bounded.
///
/// # Errors
/// [`VisionError`]: radii or a window outside the limits, a buffer that is too short.
pub fn find_circle(
    image: &Image<'_>,
    search: &CircleSearch,
    scratch: &mut Scratch<'_>,
) -> Result<Option<Circle>, VisionError> {
    let choice = choice(image, search, scratch)?;
    let Some((best, confidence)) = choice.best().filter(|(_, confidence)| *confidence >= MIN_CONFIDENCE)
    else {
        return Ok(None);
    };
    let ellipse = choice.refine(best);
    let (semi_axes, angle) = ellipse.axes();
    let Ellipse { center, radius, .. } = ellipse;
    Ok(Some(Circle { center, radius, semi_axes, angle, confidence }))
}

/// The evaluated candidates of a search.
pub(super) fn choice<'a>(
    image: &'a Image<'a>,
    search: &'a CircleSearch,
    scratch: &mut Scratch<'_>,
) -> Result<Choice<'a>, VisionError> {
    search.check(image, scratch)?;
    let mut starts = Starts::NONE;
    for level in LEVELS {
        if let Some(radii) = search.radii(level) {
            candidates(image, search, level, radii, scratch, &mut starts);
        }
    }
    let mut choice = Choice::new(image, search);
    choice.begin(&starts);
    for knob in 0..MAX_KNOBS {
        choice.look_behind(knob);
    }
    choice.look_closer();
    Ok(choice)
}

/// Finds the candidates of one level.
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
        radii_about(points, (x, y), radii, |hough::HoughCircle { x, y, radius, sectors }| {
            let center = [side * (x + 0.5) - 0.5, side * (y + 0.5) - 0.5];
            let ellipse = Ellipse::circle(center, side * radius);
            starts.insert(Start { ellipse, score: sectors as f32, side });
        });
    }
}
